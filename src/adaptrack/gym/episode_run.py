"""The run of a car in an episode, as both environments with a single car use it."""

from __future__ import annotations

import math
from typing import Any

import gymnasium

from adaptrack.control.controllers import Controller
from adaptrack.drive.closed_loop import ClosedLoop
from adaptrack.drive.world import World
from adaptrack.gym.task import Episode, Task


class EpisodeRun:
    """A simulated run whose commands the environment passes in, one per control period, with its accumulated cost.

    Parameters
    ----------
    task
        Task of the environment.
    episode
        Car, road, profile and noise seed of the episode.
    controller
        Controller of the car, whose settings the simulation needs. The environment calls it and passes on its commands.
    """

    def __init__(self, task: Task, episode: Episode, controller: Controller) -> None:
        world = World.of(
            episode.plant, controller, episode.profile, task.driver, task.perception, task.failure
        )  # fmt: skip
        self.loop = ClosedLoop(world, episode.drive, episode.noise_seed)
        self._failure_cost = task.cost_of_failure(world.failure.distance)
        self._total = 0.0

    @property
    def terminated(self) -> bool:
        """Whether a failure has ended the episode."""
        return self.loop.ended

    @property
    def truncated(self) -> bool:
        """Whether the episode has come to the end of its drive."""
        return self.loop.instant == self.loop.signals.n and not self.terminated

    @property
    def over(self) -> bool:
        """Whether the episode has ended."""
        return self.terminated or self.truncated

    def drive_period(self, command: float, speed_cost: float = 0.0) -> float:
        """Drive one control period with a command (rad) and return its cost e^2 + w (change of command)^2 (m^2).

        A failure adds the failure cost of every remaining instant.

        Parameters
        ----------
        speed_cost
            Cost of speed and acceleration in this period (m^2), if the agent commands the acceleration.
        """
        loop = self.loop
        loop.send(command)
        cost = speed_cost + loop.cost
        cost += (loop.signals.n - loop.instant) * self._failure_cost if self.terminated else 0.0
        self._total += cost
        return cost

    @property
    def info(self) -> dict[str, Any]:
        """The ``info`` of ``step``: empty before the end, then the reason of a failure and the cost J (m^2)."""
        if not self.over:
            return {}
        reason, _ = self.loop.failure
        return {"failed": reason or "", "J": math.inf if reason else self._total / self.loop.signals.n}


def require_running(run: EpisodeRun | None) -> EpisodeRun:
    """Return a run that has not ended.

    Raises
    ------
    gymnasium.error.ResetNeeded
        When there is no run, or it has ended.
    """
    if run is None or run.over:
        raise gymnasium.error.ResetNeeded("call reset() first: no run has begun, or it is over.")
    return run

"""One car in its run: what both environments of a single car share."""

from __future__ import annotations

import math
from typing import Any

import gymnasium

from adaptrack.control.controllers import Controller
from adaptrack.drive.closed_loop import ClosedLoop, Sensed
from adaptrack.drive.world import World
from adaptrack.gym.task import Episode, Task


class Driven:
    """A run that is driven from outside, with what it costs."""

    def __init__(self, task: Task, episode: Episode, controller: Controller) -> None:
        world = World.of(
            episode.plant, controller, episode.profile, task.driver, task.known_as, task.failure
        )  # fmt: skip
        self.loop = ClosedLoop(world, episode.drive, episode.noise_seed)
        self._move_weight = world.profile.move_weight
        self._failure_cost = task.cost_of_failure(world.failure.distance)
        self._total = 0.0
        self.terminated = self.truncated = False
        self.sensed: Sensed = self._arrive()

    @property
    def over(self) -> bool:
        """Whether the episode is."""
        return self.terminated or self.truncated

    def drive(self, command: float) -> float:
        """Drive a period with a command (rad); what it costs (m^2): e^2 + w (change of command)^2.

        A failure adds the cost of all instants that are not driven.
        """
        loop = self.loop
        error, move = loop.error, command - loop.command
        cost = error * error + self._move_weight * move * move
        loop.send(command)
        loop.advance()
        self.sensed = self._arrive()
        cost += (loop.signals.n - loop.instant) * self._failure_cost if self.terminated else 0.0
        self._total += cost
        return cost

    def _arrive(self) -> Sensed:
        """Sense the next instant; a car whose state is not finite keeps its previous signals."""
        loop = self.loop
        sensed = loop.sense()
        self.terminated = loop.ended
        if loop.instant == loop.signals.n:
            self.terminated = loop.failure()[0] is not None
            self.truncated = not self.terminated
        return sensed

    @property
    def info(self) -> dict[str, Any]:
        """Return the ``info`` of ``step``."""
        if not self.over:
            return {}
        reason = self.loop.failure()[0]
        return {"failed": reason or "", "J": math.inf if reason else self._total / self.loop.signals.n}


def needs_reset(drive: Driven | None) -> Driven:
    """The run; `gymnasium.error.ResetNeeded` when there is none, or it is over."""
    if drive is None or drive.over:
        raise gymnasium.error.ResetNeeded("call reset() first: no run has begun, or it is over.")
    return drive

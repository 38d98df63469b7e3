"""Steer a car along its road."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from adaptrack.core.public import ObservationSpace, Resident, write_one_observation
from adaptrack.gym.single_car import Driven, needs_reset
from adaptrack.gym.spaces import (
    DISTANCES,
    checked_action,
    checked_distances,
    command_box,
    observation_box,
    observation_names,
)
from adaptrack.gym.task import Outside, Task

Array = NDArray[np.float64]


class PathTrackingEnv(gymnasium.Env):
    """`adaptrack/PathTracking-v0`: steer a car along its road, as `adaptrack.simulate` drives it.

    A step is a control period of the profile. Plant, steering actuator, sensors, dead time and failure rule are those
    of `simulate`: a fixed controller has the same run, to the bit.

    Action
    ------
    Box(1,), float64: steering command (rad), within the angle limit that all controllers have. Beyond it is clipped.

    Observation
    -----------
    Box(7 + 2 m,), float64, in this order (`names`); m: number of `distances`. What sensors give is late, noisy or
    missing as the profile says; a sample that is missing keeps its last value. All is clipped to its bounds.

    ==============  =======  ===============================================================================
    name            unit     meaning, bounds
    ==============  =======  ===============================================================================
    offset          m        measured y less y_ref, positive to the left, +-100
    heading_error   rad      measured heading less that of the road, +-pi
    yaw_rate        rad/s    measured, +-10
    speed           m/s      measured, 0 to 100
    wheel_angle     rad      measured angle of the front wheels, +-pi/2
    command         rad      the last command, +-pi/2
    pose_age        s        how old offset and heading error are, 0 to 600
    reference_dm    m        by how much the reference will have moved to the left when the car comes to
                             d metres ahead at its present speed (1 m/s at least), +-100; m columns
    curvature_dm    1/m      of the road d metres ahead of the car's foot, positive to the left, +-1; m columns
    ==============  =======  ===============================================================================

    Reward
    ------
    -(e^2 + w du^2) in m^2: e is the true offset from the reference at the instant of the action, du the change of the
    command, w the profile's `move_weight`. The sum over an episode is -n J, J being what tuning minimises. A failure
    adds what the rest of the road costs at the failure distance (`failure_cost` for each instant), so that failing
    early never pays.

    End
    ---
    terminated: the run has failed by the rule of `Failure`; truncated: the end of the road. Then info has `failed`
    ("" or "off-road", "spun", "not-finite") and `J` (m^2, inf when failed). `reset` says in info which car, road and
    noise seed were drawn: `simulate(plant, controller, drive, profile=..., seed=info["noise_seed"])` is the same
    run, drive being `Task.drive` of that road and car.

    Arguments
    ---------
    The fields of `Task` (car, road, profile, random_cars, ...), and distances: m, at which one looks ahead.
    ``reset(options=...)`` may choose `noise_seed`, `car_seed` and `road` (by number). One seed gives one run, on every
    machine of the same kind; without a seed the next episode draws other noise.

    Raises
    ------
    InvalidInput
        For arguments, options or actions that are not allowed.
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012 - gymnasium's own form

    def __init__(self, *, distances: Sequence[float] = DISTANCES, render_mode: str | None = None, **task: Any) -> None:
        self.task, self.render_mode = Task(**task), render_mode
        self.distances = checked_distances(distances)
        self.names = observation_names(self.distances)
        self.action_space, self.observation_space = command_box(self.task), observation_box(self.distances)
        self._driven: Driven | None = None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Begin an episode, see `gymnasium.Env.reset`; options: `noise_seed`, `car_seed`, `road`."""
        super().reset(seed=seed)
        episode = self.task.draw(self.np_random, options)
        self._driven = drive = Driven(self.task, episode, Outside(episode.profile.period))
        space = self.observation_space
        bounds = ObservationSpace(self.distances, space.low.copy(), space.high.copy())  # type: ignore[attr-defined]
        self._bounds = Resident(bounds)
        self._observed = np.zeros(len(self.names))
        return self._observe(drive), episode.info

    def step(self, action: Any) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """Drive a control period, see `gymnasium.Env.step`."""
        drive = needs_reset(self._driven)
        (command,) = checked_action(action, self.action_space).tolist()  # type: ignore[arg-type]
        cost = drive.drive(command)
        return self._observe(drive), -cost, drive.terminated, drive.truncated, drive.info

    def _observe(self, drive: Driven) -> Array:
        write_one_observation(drive.loop.place, self._bounds, self._observed)
        return self._observed.copy()

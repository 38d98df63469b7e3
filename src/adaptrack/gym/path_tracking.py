"""Environment in which an agent steers a car along its road."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from adaptrack.core.public import ObservationSpace, Resident, write_one_observation
from adaptrack.gym.episode_run import EpisodeRun, require_running
from adaptrack.gym.spaces import (
    DISTANCES,
    check_action,
    check_distances,
    command_box,
    observation_box,
    observation_names,
)
from adaptrack.gym.task import ExternalCommands, Task

Array = NDArray[np.float64]


class PathTrackingEnv(gymnasium.Env):
    """`adaptrack/PathTracking-v0`: steer a car along its road in the simulation of `adaptrack.simulate`.

    A step is one control period of the profile. Plant, steering actuator, sensors, dead time and failure rule are those
    of `simulate`. An agent that computes the commands of a controller therefore has the same run, to the bit.

    Action
    ------
    Box(1,), float64: steering command (rad), clipped to the angle limit that all controllers share.

    Observation
    -----------
    Box(7 + 2 n,), float64, with the columns below (`names`), where n is the number of `distances`. The profile
    determines delay, noise and missing samples of the sensors. A missing sample keeps its last value. Every column is
    clipped to its bounds.

    ==============  =======  ===============================================================================
    name            unit     meaning, bounds
    ==============  =======  ===============================================================================
    offset          m        measured y minus y_ref, positive to the left, +-100
    heading_error   rad      measured heading minus heading of the road, +-pi
    yaw_rate        rad/s    measured yaw rate, +-10
    speed           m/s      measured speed, 0 to 100
    wheel_angle     rad      measured angle of the front wheels, +-pi/2
    command         rad      last command, +-pi/2
    pose_age        s        age of offset and heading error, 0 to 600
    reference_<d>m  m        y_ref at d metres ahead minus present y_ref, positive to the left, +-100; n columns
    curvature_<d>m  1/m      curvature of the road d metres ahead, positive to the left, +-1; n columns
    ==============  =======  ===============================================================================

    The reference is a function of time. `reference_<d>m`, such as `reference_20m`, takes it at the time at which the
    car, at its present speed but at least 1 m/s, has driven d metres.

    Reward
    ------
    -(e^2 + w du^2) in m^2, with the true offset e from the reference at the instant of the action, the change du of the
    command and the profile's `move_weight` w. The sum over an episode of n steps is -n J, where J is the cost that the
    tuning commands minimise. A failure also subtracts `failure_cost` for each remaining instant, so an early failure is
    never cheaper than driving on.

    End
    ---
    A failure by the rule of `FailureLimits` sets `terminated`; the end of the road sets `truncated`. Then info contains

    - `failed`: "" for success, or "off-road", "spun" or "not-finite";
    - `J`: cost (m^2), infinite after a failure.

    The info of `reset` contains the car, the road and the noise seed. With `drive`, the result of `Task.drive` for this
    road and car, `simulate(plant, controller, drive, profile=..., seed=info["noise_seed"])` repeats the run.

    Parameters
    ----------
    distances
        Preview distances d (m).
    task
        The fields of `Task`: car, road, profile, random_cars, ...

    Raises
    ------
    InvalidInput
        For invalid arguments, options or actions.

    Notes
    -----
    ``reset(options=...)`` accepts `noise_seed`, `car_seed` and `road` (index). Episodes with equal seeds are equal on
    all machines of the same kind. Without a seed each episode draws new noise.
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012 - gymnasium's own form

    def __init__(self, *, distances: Sequence[float] = DISTANCES, render_mode: str | None = None, **task: Any) -> None:
        self.task, self.render_mode = Task(**task), render_mode
        self.distances = check_distances(distances)
        self.names = observation_names(self.distances)
        self.action_space, self.observation_space = command_box(self.task), observation_box(self.distances)
        self._run: EpisodeRun | None = None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Start an episode, see `gymnasium.Env.reset`; options: `noise_seed`, `car_seed`, `road`."""
        super().reset(seed=seed)
        episode = self.task.draw(self.np_random, options)
        self._run = run = EpisodeRun(self.task, episode, ExternalCommands(episode.profile.period))
        space = self.observation_space
        bounds = ObservationSpace(self.distances, space.low.copy(), space.high.copy())  # type: ignore[attr-defined]
        self._bounds = Resident(bounds)
        self._observation = np.zeros(len(self.names))
        return self._observe(run), episode.info

    def step(self, action: Any) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """Drive one control period, see `gymnasium.Env.step`."""
        run = require_running(self._run)
        (command,) = check_action(action, self.action_space).tolist()  # type: ignore[arg-type]
        cost = run.drive_period(command)
        return self._observe(run), -cost, run.terminated, run.truncated, run.info

    def _observe(self, run: EpisodeRun) -> Array:
        write_one_observation(run.loop.resident, self._bounds, self._observation)
        return self._observation.copy()

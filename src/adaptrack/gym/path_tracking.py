"""Environment in which an agent steers a car along its road."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from adaptrack.core.public import ObservationSpace, Resident, write_one_observation
from adaptrack.gym.acceleration import (
    ACCELERATION_WEIGHT,
    SPEED_WEIGHT,
    AccelerationInput,
    acceleration_bounds,
    task_of,
)
from adaptrack.gym.episode_run import EpisodeRun, require_running
from adaptrack.gym.spaces import (
    DISTANCES,
    box,
    check_action,
    check_distances,
    command_bounds,
    observation_bounds,
    observation_names,
)
from adaptrack.gym.task import ExternalCommands, Task

Array = NDArray[np.float64]


def joint_spaces(
    task: Task, distances: Array, speed: AccelerationInput | None
) -> tuple[spaces.Box, spaces.Box, tuple[str, ...]]:
    """Return the action and observation space of an agent that steers, and the names of its observed columns.

    Parameters
    ----------
    speed
        Acceleration input of an agent that also commands the acceleration.
    """
    actions, bounds, names = [command_bounds(task)], observation_bounds(distances), observation_names(distances)
    if speed is None:
        return box(actions), box(bounds), names
    return box([*actions, acceleration_bounds(task)]), box([*bounds, *speed.bounds]), (*names, *speed.names)


class PathTrackingEnv(gymnasium.Env):
    """`adaptrack/PathTracking-v0`: steer a car along its road in the simulation of `adaptrack.simulate`.

    A step is one control period of the profile. Plant, steering actuator, sensors, dead time and failure rule are those
    of `simulate`. An agent that computes the commands of a controller therefore has the same run, to the bit.

    Action
    ------
    Box(1,), float64: steering command (rad), clipped to the angle limit that all controllers share.

    With ``acceleration=True`` Box(2,): steering command (rad) and acceleration (m/s^2), positive forward, clipped to
    +- the largest force of brakes or drive over the mass. The force m (a + g sin(slope) + driving resistance), with the
    data sheet's values, is requested of the car's drive and brakes. Their dead time, lag, rate limit, gain and limits
    (`DriveActuator`, `BrakeActuator`) act as under a `SpeedControl`. Brakes hold a standing car while a <= 0.
    ``gymnasium.wrappers.RescaleAction(env, -1.0, 1.0)`` normalises both.

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

    With ``acceleration=True`` these columns follow. The plan is the planned speed of the road, or of the scenario.

    ==================  =====  ==================================================================================
    name                unit   meaning, bounds
    ==================  =====  ==================================================================================
    acceleration        m/s^2  last commanded acceleration, +-100
    planned_speed_<d>m  m/s    planned speed d metres ahead, 0 to 100; n columns. Without a road, the planned speed at
                               the time at which the car comes there
    ==================  =====  ==================================================================================

    Reward
    ------
    -(e^2 + w du^2) in m^2, with the true offset e from the reference at the instant of the action, the change du of the
    command and the profile's `move_weight` w. The sum over an episode of n steps is -n J, where J is the cost that the
    tuning commands minimise. A failure also subtracts `failure_cost` for each remaining instant, so an early failure is
    never cheaper than driving on. With ``acceleration=True`` each instant also costs
    `speed_weight` (v - v_plan)^2 + `acceleration_weight` da^2, with the true speed v, the plan v_plan at the car's
    place and the change da of the commanded acceleration.

    End
    ---
    A failure by the rule of `FailureLimits` sets `terminated`; the end of the road sets `truncated`. With
    ``acceleration=True`` the episode lasts as long as the plan of the road; an open road goes on straight beyond its
    end. Then info contains

    - `failed`: "" for success, or "off-road", "spun" or "not-finite";
    - `J`: cost (m^2), infinite after a failure.

    The info of `reset` contains the car, the road and the noise seed. With `drive`, the result of `Task.drive` for this
    road and car, `simulate(plant, controller, drive, profile=..., seed=info["noise_seed"])` repeats the run.

    Parameters
    ----------
    distances
        Preview distances d (m).
    acceleration
        Whether the agent also commands the acceleration. Then no `driver` is accepted.
    speed_weight, acceleration_weight
        Weights of squared speed error (s^2) and squared change of the acceleration (s^4) in the cost.
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

    def __init__(
        self,
        *,
        distances: Sequence[float] = DISTANCES,
        acceleration: bool = False,
        speed_weight: float = SPEED_WEIGHT,
        acceleration_weight: float = ACCELERATION_WEIGHT,
        render_mode: str | None = None,
        **task: Any,
    ) -> None:
        self.task, self.render_mode = task_of(acceleration, task), render_mode
        self.distances = check_distances(distances)
        speed = AccelerationInput(self.distances, speed_weight, acceleration_weight)
        self._speed = speed if acceleration else None
        self.action_space, self.observation_space, self.names = joint_spaces(self.task, self.distances, self._speed)
        self._run: EpisodeRun | None = None
        self._acceleration = np.zeros(1)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Start an episode, see `gymnasium.Env.reset`; options: `noise_seed`, `car_seed`, `road`."""
        super().reset(seed=seed)
        episode = self.task.draw(self.np_random, options)
        self._run = run = EpisodeRun(self.task, episode, ExternalCommands(episode.profile.period))
        space = self.observation_space
        bounds = ObservationSpace(self.distances, space.low.copy(), space.high.copy())  # type: ignore[attr-defined]
        self._bounds = Resident(bounds)
        self._observation = np.zeros(len(self.names))
        self._acceleration[:] = 0.0
        self._vehicle = episode.vehicle
        return self._observe(run), episode.info

    def step(self, action: Any) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """Drive one control period, see `gymnasium.Env.step`."""
        run = require_running(self._run)
        command, *accelerations = check_action(action, self.action_space).tolist()  # type: ignore[arg-type]
        speed_cost = 0.0
        if self._speed is not None:
            speed_cost = float(
                self._speed.request(np.array(accelerations), self._acceleration, self._vehicle, run.loop.run)[0]
            )
        cost = run.drive_period(command, speed_cost)
        return self._observe(run), -cost, run.terminated, run.truncated, run.info

    def _observe(self, run: EpisodeRun) -> Array:
        write_one_observation(run.loop.resident, self._bounds, self._observation)
        if self._speed is not None:
            self._speed.observe(self._acceleration, run.loop.run, self._observation[None])
        return self._observation.copy()

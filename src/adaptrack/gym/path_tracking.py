"""Environments in which an agent steers a car along its road, one car or many, and may command its acceleration."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from gymnasium import spaces

from adaptrack.base.checked import NotNegative, checked, reals
from adaptrack.base.errors import InvalidInput
from adaptrack.cars.vehicle import Vehicle
from adaptrack.control.controllers import Controller
from adaptrack.control.controllers.setup import world_and_belief
from adaptrack.core import public as core
from adaptrack.core.public import Array
from adaptrack.drive.closed_loop import ClosedLoop
from adaptrack.drive.world import RequestedForces
from adaptrack.gym.environment import CLIP_DISTANCE, CarBlock, SingleCarEnv, VectorEnv, box
from adaptrack.gym.task import Episode, ExternalCommands, Task

OBSERVATION_BOUNDS = {
    "offset": (-CLIP_DISTANCE, CLIP_DISTANCE), "heading_error": (-math.pi, math.pi), "yaw_rate": (-10.0, 10.0),
    "speed": (0.0, 100.0), "wheel_angle": (-math.pi / 2, math.pi / 2), "command": (-math.pi / 2, math.pi / 2),
    "pose_age": (0.0, 600.0),
}  # fmt: skip
"""Bounds of the columns of `core.simulation.episode.OBSERVATION`, SI units."""
PREVIEW_BOUNDS = {"reference": (-CLIP_DISTANCE, CLIP_DISTANCE), "curvature": (-1.0, 1.0)}
"""Bounds of a previewed reference (m) and of a previewed curvature (1/m)."""
DISTANCES = (0.0, 5.0, 10.0, 20.0, 40.0)
"""Default preview distances (m)."""
ACCELERATION_BOUNDS, PLANNED_SPEED_BOUNDS = (-100.0, 100.0), (0.0, 100.0)
"""Bounds of the last commanded acceleration (m/s^2) and of a planned speed (m/s) in an observation."""
SPEED_WEIGHT, ACCELERATION_WEIGHT = 0.01, 0.001
"""Default weights of the cost, s^2 and s^4: 1 m/s of speed error costs as much as an offset of 0.1 m."""


def check_distances(distances: Sequence[float]) -> Array:
    """Return the preview distances (m) as an array; `InvalidInput` unless they are finite and not negative."""
    metres = np.atleast_1d(reals("distances", distances)).copy()
    if not (np.isfinite(metres).all() and (metres >= 0.0).all()):
        raise InvalidInput(f"distances = {metres.tolist()!r} m: must be finite and not negative.")
    return metres


@checked
@dataclass(frozen=True)
class AccelerationInput:
    """Accelerations that agents command to the cars of a batch or run: requests, cost and observed columns."""

    distances: Any
    """(n,) m, preview distances of the planned speed"""
    speed_weight: Annotated[NotNegative, "s^2"] = SPEED_WEIGHT
    """of the squared speed error in the cost"""
    acceleration_weight: Annotated[NotNegative, "s^4"] = ACCELERATION_WEIGHT
    """of the squared change of the acceleration in the cost"""

    @property
    def columns(self) -> list[tuple[str, tuple[float, float]]]:
        """Names and bounds of the columns at the end of an observation."""
        planned = [(f"planned_speed_{distance:g}m", PLANNED_SPEED_BOUNDS) for distance in self.distances]
        return [("acceleration", ACCELERATION_BOUNDS), *planned]

    def request(self, accelerations: Array, last: Array, vehicle: Vehicle, run: Any) -> Array:
        """Request the accelerations (slots,) in m/s^2 of drive and brakes, and return the costs (slots,) in m^2.

        The force is mass times the acceleration, plus slope and driving resistance as the data sheet gives them. Where
        no driving is requested, the brakes hold a standing car. On a slope they also hold it until the drive does.

        Parameters
        ----------
        last
            Accelerations of the period before, which this method replaces.
        vehicle
            Data sheet of the cars.
        run
            Batch or run, `core.simulation.run.RunRecord`.
        """
        loop, signals = run.memory.drives, run.inputs.signals
        place = np.where(loop["located"] > 0, loop["place"], np.minimum(loop["sample"], signals.shape[2] - 1))
        grade = signals[run.inputs.scenario, core.SIGNAL.grade, place]
        slope = core.GRAVITY * grade / np.sqrt(1.0 + grade * grade)
        speed, mass = loop["speed"], run.settings.mass
        drag = 0.5 * vehicle.air_density * vehicle.frontal_area * vehicle.drag_coefficient
        rolling = vehicle.rolling_resistance * core.GRAVITY * np.clip(2.0 * speed, 0.0, 1.0)
        force = mass * (accelerations + rolling + slope) + drag * speed * np.abs(speed)
        stands, drives = np.abs(speed) < core.STANDING_SPEED, accelerations > 0.0
        holding_force = mass * (np.abs(slope) + core.HOLDING_DECELERATION - accelerations)
        holding = np.where(drives, mass * slope - loop["drive_force"], holding_force)
        loop["requested_force"] = np.where(stands & ~drives, 0.0, force)
        loop["requested_hold"] = np.where(stands, np.maximum(holding, 0.0), 0.0)
        true_speed = run.vehicles.block[core.PLANT_STATE.vx * core.SLOTS :][: loop.size]
        speed_error = true_speed - self._planned_speeds(loop["station"], np.zeros(1), run)[:, 0]
        change = accelerations - last
        last[:] = accelerations
        return self.speed_weight * speed_error * speed_error + self.acceleration_weight * change * change

    def observe(self, last: Array, run: Any, observations: Array) -> None:
        """Write the last columns of the observations (slots, columns): last acceleration and planned speeds ahead."""
        first = observations.shape[1] - 1 - len(self.distances)
        observations[:, first] = np.clip(last, *ACCELERATION_BOUNDS)
        speeds = self._planned_speeds(run.memory.drives["station_estimate"], self.distances, run)
        np.copyto(observations[:, first + 1 :], np.clip(speeds, *PLANNED_SPEED_BOUNDS), where=np.isfinite(speeds))

    def _planned_speeds(self, stations: Array, distances: Array, run: Any) -> Array:
        """Return the planned speeds (slots, n) in m/s at distances (n,) ahead of the cars' stations (slots,), in m.

        Without a road the plan is a function of time, and the car comes to a distance with its present speed.
        """
        loop, inputs = run.memory.drives, run.inputs
        speeds = np.empty((loop.size, len(distances)))
        for scenario in np.unique(inputs.scenario):
            cars = np.flatnonzero(inputs.scenario == scenario)
            plan = inputs.signals[scenario]
            if inputs.roads.of[scenario] >= 0:
                places, grid = stations[cars, None] + distances, plan[core.SIGNAL.station]
            else:
                approach = np.maximum(loop["speed"][cars], core.MIN_APPROACH_SPEED) * run.settings.period
                places = loop["instant"][cars, None] + distances / approach[:, None]
                grid = np.arange(plan.shape[1], dtype=np.float64)
            speeds[cars] = np.interp(places, grid, plan[core.SIGNAL.speed])
        return speeds


class _PathTracking:
    """Spaces of an agent that steers, and the controller that it replaces, for one car and for many."""

    task: Task
    names: tuple[str, ...]
    distances: Array
    _speed: AccelerationInput | None
    """Acceleration input of an agent that also commands the acceleration."""

    def _set_agent(
        self,
        distances: Sequence[float],
        acceleration: bool,
        speed_weight: float,
        acceleration_weight: float,
        task: dict[str, Any],
    ) -> tuple[spaces.Box, spaces.Box]:
        """Set task, distances and names of the columns; return the action and observation space of one car.

        Raises InvalidInput when a driver is given although the agent commands the acceleration.
        """
        if acceleration and "driver" in task:
            raise InvalidInput("driver: with acceleration=True the agent commands the speed: leave the driver out.")
        self.distances = check_distances(distances)
        speed = AccelerationInput(self.distances, speed_weight, acceleration_weight)
        self._speed = speed if acceleration else None
        self.task = Task(**task, driver=RequestedForces()) if acceleration else Task(**task)
        vehicle, plant, profile = self.task.base_car()
        _, period, belief = world_and_belief(vehicle, profile, None)
        actions, columns = [belief.bounds(period).angle], [*OBSERVATION_BOUNDS.items()]
        for signal, bounds in PREVIEW_BOUNDS.items():
            columns += [(f"{signal}_{distance:g}m", bounds) for distance in self.distances]
        if acceleration:
            powertrain = plant.powertrain
            largest = max(powertrain["brake_limit"], powertrain["traction_limit"]) / powertrain["mass"]
            actions.append((-largest, largest))
            columns += speed.columns
        self.names = tuple(name for name, _ in columns)
        return box(actions), box([bounds for _, bounds in columns])

    def _controller(self, episode: Episode) -> Controller:
        return ExternalCommands(episode.profile.period)


class PathTrackingEnv(_PathTracking, SingleCarEnv):
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
        agent = self._set_agent(distances, acceleration, speed_weight, acceleration_weight, task)
        super().__init__(agent, render_mode)
        self._acceleration = np.zeros(1)

    def _begin(self, episode: Episode) -> None:
        space = self.observation_space
        bounds = core.ObservationSpace(self.distances, space.low.copy(), space.high.copy())  # type: ignore[attr-defined]
        self._bounds = core.Resident(bounds)
        self._acceleration[:] = 0.0
        self._vehicle = episode.vehicle

    def _drive(self, loop: ClosedLoop, action: Array) -> float:
        command, *accelerations = action.tolist()
        speed_cost = 0.0
        if self._speed is not None:
            speed_cost = float(
                self._speed.request(np.array(accelerations), self._acceleration, self._vehicle, loop.run)[0]
            )
        return self._drive_period(loop, command, speed_cost)

    def _write_observation(self, loop: ClosedLoop) -> None:
        core.write_one_observation(loop.resident, self._bounds, self._observation)
        if self._speed is not None:
            self._speed.observe(self._acceleration, loop.run, self._observation[None])


class PathTrackingVectorEnv(_PathTracking, VectorEnv):
    """`adaptrack/PathTracking-v0` for many cars at once, compiled. Each car is specified as in `PathTrackingEnv`.

    On a single road, car i has the same run, to the bit, as `PathTrackingEnv` with its seed. With several roads, runs
    may differ from those of `PathTrackingEnv` for two reasons:

    - The road with the highest speed determines the number of integration steps on all roads.
    - Each road has its own perception errors of friction and wind (`perception`).

    A car whose episode has ended starts a new episode in the next step. That step ignores its action and gives reward 0
    (`AutoresetMode.NEXT_STEP`).

    Parameters
    ----------
    num_envs
        Number of cars.
    threads
        Number of threads that share the blocks of 32 cars. With random cars each block contains one car only, which
        takes longer.
    distances, acceleration, speed_weight, acceleration_weight, task
        As in `PathTrackingEnv`, except that a user's plant must not be written in Python.

    Raises
    ------
    InvalidInput
        For invalid arguments, options or actions.
    """

    def __init__(
        self,
        num_envs: int = 64,
        *,
        threads: int = 1,
        distances: Sequence[float] = DISTANCES,
        acceleration: bool = False,
        speed_weight: float = SPEED_WEIGHT,
        acceleration_weight: float = ACCELERATION_WEIGHT,
        **task: Any,
    ) -> None:
        agent = self._set_agent(distances, acceleration, speed_weight, acceleration_weight, task)
        super().__init__(num_envs, threads, agent)
        self._actions = np.zeros((self.num_envs, *self.single_action_space.shape))  # type: ignore[misc]
        self._accelerations = np.zeros(self.num_envs)

    def _schedule_start(self, block: CarBlock, car: int, episode: Episode) -> None:
        super()._schedule_start(block, car, episode)
        self._accelerations[car] = 0.0

    def _store_actions(self, actions: Array) -> None:
        self._actions[:] = actions

    def _drive(self, block: CarBlock) -> None:
        if self._speed is not None:
            states, last = self._episode_states[block.slots], self._accelerations[block.slots]
            cost = self._speed.request(self._actions[block.slots, 1], last, block.vehicle, block.episodes.run)
            states["cost"] += np.where(states["over"] == core.EPISODE_RUNS, cost, 0.0)
        block.episodes.run.controller.answer[:, 0] = self._actions[block.slots, 0]
        core.drive_on(block.resident)

    def _write_observations(self, block: CarBlock) -> None:
        core.write_observations(block.resident)
        if self._speed is not None:
            run, last = block.episodes.run, self._accelerations[block.slots]
            self._speed.observe(last, run, self._observations[block.slots])

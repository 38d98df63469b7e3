"""Simulation around a controller in one run, one control period at a time.

A control period has three steps: `ClosedLoop.sense` measures, `ClosedLoop.send` applies a command, and
`ClosedLoop.advance` moves the car. Between the first two, the caller chooses the command: a controller in `simulate`, a
learning agent in `gym`. Compiled runs call the same kernels (`core.loop.period`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from adaptrack.base.checked import real
from adaptrack.base.errors import InvalidInput
from adaptrack.base.registry import PluginCall
from adaptrack.cars.plant import SteppedPlant
from adaptrack.control.controllers import Controller
from adaptrack.control.estimation import FrictionWindEstimator
from adaptrack.control.scheduling.variables import SchedulingVariables
from adaptrack.control.speed_control import SpeedCommand, SpeedControl, SpeedController
from adaptrack.core.kernel import Resident
from adaptrack.core.loop import period as period_kernel
from adaptrack.core.loop import world as loop_kernel
from adaptrack.core.maths import portable
from adaptrack.core.models.contract import MEASUREMENT
from adaptrack.core.plants import contract, stepped
from adaptrack.core.plants.contract import vehicle_batch
from adaptrack.core.speed.speed_control import SPEED_REQUEST
from adaptrack.drive.world import Driver, RequestedForces, SpeedFollower, World, reason_of, warn_once
from adaptrack.road.road_ahead import RoadAhead, pack_roads
from adaptrack.scenario import RoadDrive, Scenario

Array = NDArray[np.float64]

LONGEST_SPEEDS_AHEAD = 120
"""Number of control instants for which a controller receives the speed ahead that the speed control allows."""
LONGEST_PREVIEW = 400
"""Number of control instants for which a controller in Python receives the planned speed."""
_REQUESTS = (
    "a SpeedCommand with acceleration (m/s^2), force (N) and hold (N); the force must be finite, the hold finite and "
    "at least 0"
)


class _SteppedVehicle:
    """A `SteppedPlant` with the steering actuator of the loop; slot 0 of a batch stores its motion."""

    def __init__(self, world: World, start: Array) -> None:
        assert isinstance(world.plant, SteppedPlant)
        self._plant, self._steering = world.plant, world.steering
        self._call = PluginCall(
            f"plant {world.plant.name!r}: step()", "six finite numbers: X, Y, yaw, v_x, v_y, yaw rate"
        )
        self._mass = world.plant.powertrain["mass"]
        actuator = np.array([self._steering.lag, self._steering.limit])
        self.batch = contract.vehicle_batch(stepped.STEPPED, actuator, np.append(start, 0.0)[None])
        world.plant.reset(start.copy())

    @property
    def _state(self) -> Array:
        """`contract.PLANT_STATE` of the vehicle; a view of the batch."""
        return self.batch.block[: contract.PLANT_STATES * contract.SLOTS : contract.SLOTS]

    @property
    def _input(self) -> Array:
        """`contract.PLANT_INPUT` of the vehicle; a view of the batch."""
        return self.batch.block[contract.PLANT_STATES * contract.SLOTS :: contract.SLOTS]

    def _angle(self, time: float) -> float:
        """Return the front-wheel angle (rad) after a time (s) with the current command."""
        command = min(max(float(self._input[0]), -self._steering.limit), self._steering.limit)
        angle = float(self._state[contract.PLANT_STATE.steering])
        if self._steering.lag <= 0.0:
            return command
        gap, limited = command - angle, 0.0
        if abs(gap) > self._steering.rate * self._steering.lag:  # at the rate limit until the gap is small enough
            limited = min(time, abs(gap) / self._steering.rate - self._steering.lag)
            gap -= math.copysign(self._steering.rate * limited, gap)
        return command - gap * portable.exp((limited - time) / self._steering.lag)

    def advance(self, steps: int, h: float) -> None:
        """Advance the vehicle by a number of integration steps of h (s)."""
        names, state, demand = contract.PLANT_INPUT, self._state, self._input
        force, acceleration = demand[names.force], demand[names.acceleration]
        target = force / self._mass if math.isnan(acceleration) else acceleration
        last = names.grade if self._plant.takes_grade else names.bank
        environment = demand[names.friction_front_left : last + 1].copy()
        before = state[:6].copy()
        for _ in range(steps):
            middle, after = self._angle(0.5 * h), self._angle(h)
            answer = self._call(self._plant.step, h, middle, float(target), environment)
            try:
                motion = np.asarray(answer, dtype=np.float64)
            except (TypeError, ValueError):
                raise self._call.refusal(answer) from None
            if motion.shape != (6,):
                raise self._call.refusal(answer)
            if not np.isfinite(motion).all():
                warn_once(f"adaptrack: the run ends: {self._call.refusal(answer)}")
            state[:6] = motion
            state[contract.PLANT_STATE.steering] = after if self._steering.lag > 0.0 else 0.0
        turn = 0.5 * (before[3] * before[5] + state[3] * state[5])
        change = state[4] - before[4]
        self.batch.states[0, stepped.LATERAL_ACCELERATION] = change / (steps * h) + turn - demand[names.bank]


@dataclass(frozen=True, slots=True)
class Sensed:
    """Signals at a control instant, as the controller receives them."""

    measured: Array
    """Measurements in the order of `core.models.contract.MEASUREMENT`; the next instant overwrites the array."""
    speed: float
    """Measured speed (m/s)."""
    reference: Array
    """Lateral reference y_ref at this instant and all later ones (m)."""
    variables: SchedulingVariables
    """Inputs of a scheduler at this instant."""


class ClosedLoop:
    """One closed-loop run. In each control period, call `sense`, `send` and `advance` in this order.

    A run is complete after ``signals.n`` periods; a failure ends it earlier (`ended`).

    Parameters
    ----------
    world
        Simulated car and its environment.
    scenario
        Scenario or road drive.
    seed
        Seed of the sensor noise.
    traced
        Whether to record the signals at every control instant.
    """

    def __init__(self, world: World, scenario: Scenario | RoadDrive, seed: int, traced: bool = False) -> None:
        self.world = world
        self.signals = scenario.sample(world.period)
        self.road: Any = getattr(scenario, "road", None)
        inputs = period_kernel.RunInputs(
            world.samples(self.signals, 0)[None], pack_roads([self.road]), np.zeros(1, np.int64), np.array([seed])
        )
        start, n = world.start(scenario, self.signals), self.signals.n
        self._stepped: _SteppedVehicle | None = None
        if isinstance(world.plant, SteppedPlant):
            self._stepped = _SteppedVehicle(world, start)
            vehicles = self._stepped.batch
        else:
            vehicles = vehicle_batch(world.plant.compiled, world.plant.packed(), start[None])
        self.run = world.loop(
            inputs, vehicles, world.settings(world.substeps(float(self.signals.speed.max()))),
            needs_variables=True, trace=period_kernel.traces(1, n, 0) if traced else None,
        )  # fmt: skip
        if isinstance(world.perception, FrictionWindEstimator):
            world.perception.reset(self.run.variable_estimator.memory)
        self.resident, self._span = Resident(self.run), Resident(period_kernel.RunSpan(n, 1, 0, 0.0))
        """`run` and the limits of its loop in the memory of the kernels."""
        period_kernel.begin_one(self.resident)
        self.speed_controller = _speed_follower(world, scenario)
        self.request: SpeedCommand | None = None
        """Last requests of the speed controller."""
        self._drives, self._references = self.run.memory.drives, inputs.signals[0, loop_kernel.SIGNAL.y_ref]

    @property
    def instant(self) -> int:
        """Index of the current control instant."""
        return int(self._drives["instant"][0])

    @property
    def command(self) -> float:
        """Last command (rad)."""
        return float(self._drives["command"][0])

    @property
    def error(self) -> float:
        """Y - y_ref (m) at the last call of `sense`."""
        return float(self._drives["error"][0])

    @property
    def ended(self) -> bool:
        """Whether a failure has ended the run."""
        return bool(self._drives["ended"][0] != loop_kernel.RUNNING)

    def sense(self) -> Sensed:
        """Check the run for a failure and return the signals at this instant.

        If the state of the car is not finite, the sensors repeat their last values.
        """
        period_kernel.sense_one(self._span, self.resident)
        if self.speed_controller is not None:
            memory, measured = self._drives[0], self.run.measured
            if isinstance(self.speed_controller, SpeedController):
                self.speed_controller.narrow_friction(measured, float(memory["speed"]), float(memory["command"]))
            call = PluginCall(f"driver {type(self.world.driver).__name__}: step()", _REQUESTS)
            request = self.request = call(
                self.speed_controller.step,
                float(memory["station_estimate"]), float(memory["speed"]), float(measured[MEASUREMENT.yaw_rate]),
            )  # fmt: skip
            try:
                _, force, hold = (real("", name, getattr(request, name)) for name in SPEED_REQUEST._fields[:3])
            except (AttributeError, InvalidInput):
                raise call.refusal(request) from None
            if not (math.isfinite(force) and 0.0 <= hold < math.inf):
                raise call.refusal(request)
            memory["requested_force"], memory["requested_hold"] = force, hold
        variables = SchedulingVariables(*self.run.variables.tolist())
        return Sensed(self.run.measured, float(self._drives["speed"][0]), self._references[self.instant :], variables)

    def estimate_friction(self, controller: Controller) -> None:
        """Let the speed control narrow its friction by the steering model of a controller."""
        if isinstance(self.speed_controller, SpeedController):
            self.speed_controller.estimate_friction(controller)

    def road_ahead(self, speed: float) -> RoadAhead:
        """Return the road ahead as measured, with the speed plan shifted to start at the current speed (m/s)."""
        if isinstance(self.speed_controller, SpeedController):
            planned = self.speed_controller.speeds_ahead(speed, LONGEST_SPEEDS_AHEAD)
            return RoadAhead(self.road, float(self._drives["station_estimate"][0]), planned)
        by_place = self.road is not None and self.world.driver is not None
        first = int(self._drives["place"][0]) if by_place else self.instant
        planned = self.signals.speed[first:][:LONGEST_PREVIEW]
        station = float(self._drives["station_estimate"][0])
        return RoadAhead(self.road, station, np.maximum(planned + (speed - planned[0]), 0.0))

    def send(self, command: float) -> bool:
        """Send a command (rad) to the steering. A command that is not finite ends the run and returns False."""
        if math.isfinite(command):
            period_kernel.send_one(command, command - self.command, self._span, self.resident)
            return True
        self._drives["ended"], self._drives["ended_at"] = loop_kernel.STATE_NOT_FINITE, self.instant * self.world.period
        return False

    def advance(self) -> None:
        """Move the car to the next control instant."""
        if self._stepped is None:
            period_kernel.move_one(self.resident)
            return
        (before, after), period = period_kernel.substeps_of(self.resident), self.world.period
        share = float(self.run.settings.dead_share)
        if before:
            self._stepped.advance(before, share * period / before)
            period_kernel.change_command_of_one(self.resident)
        self._stepped.advance(after, (1.0 - share) * period / after)

    def failure(self) -> tuple[str | None, float]:
        """Return the reason and time (s) of the failure of a finished run; None and NaN if it did not fail.

        A car that never came near its reference has also failed.
        """
        period_kernel.close_one(self.resident)
        return failure_of(int(self._drives["ended"][0]), float(self._drives["ended_at"][0]))


def _speed_follower(world: World, scenario: Scenario | RoadDrive) -> SpeedFollower | None:
    """The speed controller of a run, if the world has one.

    Raises
    ------
    InvalidInput
        When the scenario has no road.
    """
    driver = world.driver
    if driver is None or isinstance(driver, Driver | RequestedForces):
        return None
    if not isinstance(scenario, RoadDrive):
        raise InvalidInput(
            f"driver: a {type(driver).__name__} follows a plan along a road, and {scenario.name!r} has none: give a "
            "RoadDrive."
        )
    if isinstance(driver, SpeedControl):
        return SpeedController(driver, scenario.road, scenario.plan, world.period)
    call = PluginCall(
        f"method `begin` of the driver {type(driver).__name__}",
        "an object with the method step(station, speed, yaw_rate)",
    )
    follower: SpeedFollower = call(driver.begin, scenario.road, scenario.plan, world.period)
    if not callable(getattr(follower, "step", None)):
        raise call.refusal(follower)
    return follower


def failure_of(ended: int, at: float) -> tuple[str | None, float]:
    """Return the reason and time (s) of a failure for the kernels' code `ended`; None and NaN without failure."""
    reason = reason_of(ended)
    return reason, at if reason is not None else math.nan

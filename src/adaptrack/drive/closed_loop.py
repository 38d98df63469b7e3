"""Simulation of one run around a controller in Python: one that is called back, or the caller.

Plants and drivers in Python are called back as well. The run is that of compiled batches (`core.simulation.run`).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from adaptrack.base.checked import real
from adaptrack.base.errors import InvalidInput
from adaptrack.base.registry import PluginCall
from adaptrack.cars.plant import SteppedPlant
from adaptrack.control.controllers import Controller
from adaptrack.control.controllers.base import python_part
from adaptrack.control.estimation import FrictionWindEstimator
from adaptrack.control.scheduling.variables import SchedulingVariables
from adaptrack.control.speed_control import SpeedCommand, SpeedControl, SpeedController
from adaptrack.core.controllers.part import COMMON_ANSWER, STEP
from adaptrack.core.kernel import Resident, Signature, address_of
from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import Array
from adaptrack.core.member import CallBack
from adaptrack.core.models.contract import MEASUREMENT
from adaptrack.core.plants import contract, user
from adaptrack.core.plants.contract import vehicle_batch
from adaptrack.core.simulation import run as kernel
from adaptrack.core.simulation.world import ANSWERED, RUNNING, SIGNAL, STATE_NOT_FINITE
from adaptrack.core.speed.speed_control import SPEED_REQUEST
from adaptrack.drive.failure import failure_of
from adaptrack.drive.world import Driver, RequestedForces, SpeedDriver, SpeedFollower, World, warn_once
from adaptrack.road.road_ahead import RoadAhead, pack_roads
from adaptrack.scenario import RoadDrive, Scenario

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
        self.batch = contract.vehicle_batch(user.STEPPED, actuator, np.append(start, 0.0)[None])
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

    def advance(self, *words: Any) -> None:
        """Advance the vehicle by a number of integration steps of h (s), see `core.plants.contract.ADVANCE`."""
        steps, h = words[-2:]
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
        self.batch.states[0, user.LATERAL_ACCELERATION] = change / (steps * h) + turn - demand[names.bank]


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
    """One simulated run, from its first instant on (`core.simulation.run`).

    The controller is a function that the run calls back at every instant, or the caller: it reads `sensed` and gives
    its command to `send`, which drives on to the next instant. The run is complete after ``signals.n`` periods; a
    failure ends it earlier (`ended`).

    Parameters
    ----------
    world
        Simulated car and its environment.
    scenario
        Scenario or road drive.
    seed
        Seed of the sensor noise.
    controller
        Controller by whose steering model, and what it learns, a speed control narrows its friction. None: it does not.
    step
        Function that is called at every control instant and writes the answer (`answer`). None: the caller controls.
    traced
        Whether to record the signals at every control instant.

    Raises
    ------
    InvalidInput
        When a speed control is given for a scenario without a road.
    """

    def __init__(
        self, world: World, scenario: Scenario | RoadDrive, seed: int, controller: Controller | None = None,
        step: Callable[[], None] | None = None, traced: bool = False,
    ) -> None:  # fmt: skip
        self.world = world
        self.signals = scenario.sample(world.period)
        self.road: Any = getattr(scenario, "road", None)
        start, n = world.start(scenario, self.signals), self.signals.n
        inputs = kernel.RunInputs(
            world.samples(self.signals, 0)[None], pack_roads([self.road]), np.zeros(1, np.int64), np.array([seed]),
            np.array([n]),
        )  # fmt: skip
        self._calls_back: list[CallBack] = []
        self._car: _SteppedVehicle | None = None
        part = python_part(controller, None if step is None else self._called_back(lambda *_: step(), STEP))
        self.speed_control: SpeedController | None = None
        """Speed control of the run, if it has one."""
        self._follower: SpeedFollower | None = None
        self._request: SpeedCommand | None = None
        self._unconnected = world.run(
            inputs, self._vehicles(start), world.settings(world.substeps(float(self.signals.speed.max()))), part,
            needs_variables=True, asks=step is None, weight=world.profile.move_weight,
            trace=kernel.traces(1, n, part.answer.shape[1]) if traced else None,
            **self._speed_part(scenario, controller),
        )  # fmt: skip
        if isinstance(world.perception, FrictionWindEstimator):
            world.perception.reset(self._unconnected.variable_estimator.memory)
        self._connect()
        self._drives, self._references = self.run.memory.drives, inputs.signals[0, SIGNAL.y_ref]
        kernel.begin(1, self.resident)
        if step is None:
            self.roll_on(1)

    def _connect(self) -> None:
        """Let the run call the plant and the driver in Python."""
        run = self._unconnected
        if self._car is not None:
            advance = self._called_back(self._car.advance, contract.ADVANCE)
            run = run._replace(vehicles=run.vehicles._replace(advance=address_of(advance)))
        if self._follower is not None:
            ask = self._called_back(self._ask_follower, kernel.CONTROL_SPEED)
            run = run._replace(control_speed=address_of(ask))
        self.run = run
        self.resident = Resident(run)
        """`run` in the memory of the kernels."""

    def __getstate__(self) -> dict[str, Any]:
        return {**vars(self), "_calls_back": [], "run": None, "resident": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._connect()

    def _called_back(self, function: Callable[..., None], signature: Signature) -> CallBack:
        """Let the run call a function; if it raises an error, the run ends."""

        def call(*words: Any) -> None:
            try:
                function(*words)
            except BaseException:
                self._drives["ended"] = STATE_NOT_FINITE
                raise

        self._calls_back.append(CallBack(call, signature))
        return self._calls_back[-1]

    def _vehicles(self, start: Array) -> Any:
        """The car at its start, a batch of one (`core.plants.contract.Vehicles`)."""
        plant = self.world.plant
        if not isinstance(plant, SteppedPlant):
            return vehicle_batch(plant.compiled, plant.packed(), start[None])
        self._car = _SteppedVehicle(self.world, start)
        return self._car.batch

    def _speed_part(self, scenario: Scenario | RoadDrive, controller: Controller | None) -> dict[str, Any]:
        """Fields of the run that let a speed control, or a driver of your own, request the forces.

        Raises InvalidInput when the scenario has no road.
        """
        driver = self.world.driver
        if driver is None or isinstance(driver, Driver | RequestedForces):
            return {}
        if not isinstance(scenario, RoadDrive):
            raise InvalidInput(
                f"driver: a {type(driver).__name__} follows a plan along a road, and {scenario.name!r} has none: give "
                "a RoadDrive."
            )
        if not isinstance(driver, SpeedControl):
            self._follower = _follower(driver, scenario, self.world.period)
            return {}
        control = self.speed_control = SpeedController(driver, scenario.road, scenario.plan, self.world.period)
        if controller is not None:
            control.estimate_friction(controller)
            control.limit_speed(controller)
        return {
            "control_speed": address_of(kernel.control_planned_speed), "longitudinal": control.record,
            "speeds": np.zeros(LONGEST_SPEEDS_AHEAD),
        }  # fmt: skip

    def _ask_follower(self, *_: Any) -> None:
        """Let a driver of your own request the forces of the present period."""
        memory = self._drives[0]
        call = PluginCall(f"driver {type(self.world.driver).__name__}: step()", _REQUESTS)
        request = call(
            self._follower.step,  # type: ignore[union-attr]
            float(memory["station_estimate"]), float(memory["speed"]),
            float(self.run.measured[0, MEASUREMENT.yaw_rate]),
        )  # fmt: skip
        try:
            force, hold = [real("", name, getattr(request, name)) for name in SPEED_REQUEST._fields[:3]][1:]
        except (AttributeError, InvalidInput):
            raise call.refusal(request) from None
        if not (math.isfinite(force) and 0.0 <= hold < math.inf):
            raise call.refusal(request)
        self.request_forces(request)

    def request_forces(self, request: SpeedCommand) -> None:
        """Request the forces of the present period, for a run whose driver is in Python."""
        self._request, memory = request, self._drives[0]
        memory["requested_force"], memory["requested_hold"] = request.force, request.hold

    # -- a run --------------------------------------------------------------------------------------------------------
    def roll_on(self, periods: int) -> None:
        """Drive so many periods, or until the caller is to give its command; raise what a function has raised."""
        kernel.roll_on(periods, 1, self.resident)
        for called_back in self._calls_back:
            called_back.raise_error()

    def send(self, command: float) -> bool:
        """Send the caller's command (rad) to the steering, and drive on to the next instant.

        A command that is not finite ends the run and returns False.
        """
        self.answer[COMMON_ANSWER.command] = command
        self._drives["caller_state"] = ANSWERED
        self.roll_on(2)
        return math.isfinite(command)

    @property
    def answer(self) -> Array:
        """Answer of the controller, `core.controllers.part.COMMON_ANSWER` and what it has learned; a view."""
        return np.asarray(self.run.controller.answer[0])

    @property
    def instant(self) -> int:
        """Index of the current control instant."""
        return int(self._drives["instant"][0])

    @property
    def command(self) -> float:
        """Last command (rad)."""
        return float(self._drives["command"][0])

    @property
    def cost(self) -> float:
        """Squared error plus weighted squared change of the command of the last period (m^2)."""
        return float(self._drives["cost"][0])

    @property
    def ended(self) -> bool:
        """Whether a failure has ended the run."""
        return bool(self._drives["ended"][0] != RUNNING)

    @property
    def request(self) -> SpeedCommand | None:
        """Requests of the speed control, or of a driver of your own, at this instant."""
        return self._request if self.speed_control is None else self.speed_control.command

    @property
    def sensed(self) -> Sensed:
        """Signals at this instant. If the state of the car is not finite, the sensors repeat their last values."""
        variables = SchedulingVariables(*self.run.variables[0].tolist())
        reference = self._references[self.instant :]
        return Sensed(self.run.measured[0], float(self._drives["speed"][0]), reference, variables)

    def road_ahead(self, speed: float) -> RoadAhead:
        """Return the road ahead as measured, with the speed plan shifted to start at the current speed (m/s)."""
        station = float(self._drives["station_estimate"][0])
        if self.speed_control is not None:
            return RoadAhead(self.road, station, self.run.speeds)
        by_place = self.road is not None and self.world.driver is not None
        first = int(self._drives["place"][0]) if by_place else self.instant
        planned = self.signals.speed[first:][:LONGEST_PREVIEW]
        return RoadAhead(self.road, station, np.maximum(planned + (speed - planned[0]), 0.0))

    @property
    def failure(self) -> tuple[str | None, float]:
        """Reason and time (s) of the failure of a finished run; None and NaN if it did not fail."""
        return failure_of(int(self.run.result[0].ended), float(self.run.result[0].ended_at))


def _follower(driver: SpeedDriver, drive: RoadDrive, period: float) -> SpeedFollower:
    """Begin a run of a driver of your own."""
    call = PluginCall(
        f"method `begin` of the driver {type(driver).__name__}",
        "an object with the method step(station, speed, yaw_rate)",
    )
    follower: SpeedFollower = call(driver.begin, drive.road, drive.plan, period)
    if not callable(getattr(follower, "step", None)):
        raise call.refusal(follower)
    return follower

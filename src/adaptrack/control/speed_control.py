"""Speed control along a planned path: settings of the kernel `core.speed.speed_control`, and one run of it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from adaptrack.base.checked import Finite, Hint, checked, within
from adaptrack.base.errors import InvalidInput
from adaptrack.cars.vehicle import (
    BrakeActuator,
    DriveActuator,
    PedalMap,
    SteeringActuator,
    Vehicle,
    load_tyre,
    pack_plant,
)
from adaptrack.control.controllers import Controller
from adaptrack.control.kalman import KalmanFilter
from adaptrack.core.kernel import OK, Resident
from adaptrack.core.models.car import AXLES, POWERTRAIN, LearnedRow
from adaptrack.core.models.contract import MEASUREMENT
from adaptrack.core.physics.forces import GRAVITY
from adaptrack.core.physics.tyre import BRUSH_SHAPE
from adaptrack.core.speed import friction as friction_kernel
from adaptrack.core.speed import learning as learning
from adaptrack.core.speed import path as path_kernel
from adaptrack.core.speed import speed_control as kernel
from adaptrack.core.speed.place import SPEED_GRACE
from adaptrack.core.speed.speed_control import SPEED_REQUEST
from adaptrack.core.synthesis.car import resistance, usable_friction
from adaptrack.core.tracker import longitudinal as tracked_kernel
from adaptrack.core.tracker.records import LONGEST_GAP
from adaptrack.core.tracker.signals import STATUS
from adaptrack.road import Comfort, Road
from adaptrack.road.speed import packed, steering_limit

Array = NDArray[np.float64]
ASSUMABLE_FRICTION = (0.05, 1.5)
"""Lowest and highest coefficient of friction that may be assumed: wet ice, and racing tyres."""
TYRE_SHAPES, LEAST_SHAPE, MAX_SHAPE = {"unknown": 0.0, "brush": BRUSH_SHAPE, "file": math.nan}, 1.05, 2.0
"""Shapes of a tyre's curve by name, for the kernel; least and largest C of a Magic Formula with a peak."""
FRICTION_COUNT = 14
"""Hypotheses: coefficients of friction, evenly within the interval, each with both ends of an unknown shape."""
LONGEST_STEERING_DELAY = 1.0
"""s, of the steering and the samples together, for which commands are remembered."""
ASSUMED_KNOWLEDGE = {
    "delay_sigma": 0.01, "stiffness": 1.0, "stiffness_sigma": 0.1, "balance": 1.0, "balance_sigma": 0.05, "bias": 0.0,
    "bias_sigma": 0.005,
}  # fmt: skip
"""Entries of `core.models.car.LearnedRow` where the car file states the car and no controller learns it.
"""
FRICTION_SENSORS = [MEASUREMENT.vy, MEASUREMENT.yaw_rate, MEASUREMENT.lateral_acceleration]
"""Sensors whose variances an estimate has."""


class SpeedState(StrEnum):
    """State of the speed control."""

    OFF = "off"
    DRIVING = "driving"
    STOPPING = "stopping"
    """on the way to a stop"""
    STOPPED = "stopped"
    """standing at a stop, with hold pressure"""
    EMERGENCY = "emergency"
    """the stop is nearer than comfortable braking reaches"""


class SpeedLimit(StrEnum):
    """Cause that limits the requested speed or acceleration."""

    PLAN = "plan"
    COMFORT = "comfort"
    GRIP = "grip"
    """the assumed friction: of the bends ahead, or of what the axles have left"""
    STOP = "stop"
    PATH_END = "path end"
    FAULT = "fault"
    """no position or no speed: the car stops"""
    DRIVER = "driver"
    """a driver uses the pedals: the requests follow the motion of the car"""
    STEERING = "steering unknown"
    """the steering of the car is not known well enough to drive faster, see `Learner.first_top_speed`"""
    POWERTRAIN = "powertrain"
    """engine power, largest drive or brake force of the car"""
    BRAKE_FAULT = "brake fault"
    """the brakes have hardly any effect, or the drive pulls against them: the car brakes as in an emergency, until the
    brakes work or a driver uses the pedals"""
    DRIVE_FAULT = "drive fault"
    """the drive pulls without a request: the car stops, and stands until a driver uses the pedals"""


_STATES, _LIMITS = tuple(SpeedState), tuple(SpeedLimit)


class SpeedAction(StrEnum):
    """Action of the speed control after a call of a tracker, as `core.tracker.longitudinal` numbers them."""

    FOLLOW = "follow"
    SLOW = "slow"
    """follow the plan as long as the car can stand before the steering loses its estimate, otherwise brake for that"""
    COMFORT_STOP = "comfort stop"
    """stop with the deceleration of comfort, and keep the car at rest"""
    EMERGENCY_STOP = "emergency stop"
    """stop with the largest deceleration that friction allows, and keep the car at rest"""
    NONE = "none"
    """keep the requests in force for half a second of such calls, then stop before the steering loses its estimate"""


_ACTIONS = tuple(SpeedAction)
SPEED_ACTIONS = {
    status.replace("_", "-"): tuple(_ACTIONS[action] for action in actions)
    for status, actions in zip(STATUS._fields, tracked_kernel.STATUS_ACTIONS.tolist(), strict=True)
}
"""By status of a tracker: the action with a position of the last `BLIND_GRACE` (s) of the kernel, and without one.

A speed that is missing for so long leads to a comfort stop, whatever the status.
"""


class SpeedCommand(NamedTuple):
    """Requests of the speed control for the present period."""

    acceleration: float
    """m/s^2, dv/dt along the road, without gravity"""
    force: float
    """N, at the wheels, positive forward"""
    hold: float
    """N, of the brakes in addition to the force: pressure that holds the car at rest"""
    target_speed: float
    """m/s, where the request acts"""
    grip_used: float
    """-, acceleration of the car over what the assumed friction gives"""
    state: SpeedState
    limited_by: SpeedLimit
    friction_low: float = math.nan
    friction_high: float = math.nan
    """-: ends of the interval of the friction, as narrowed so far; low: largest steady lateral acceleration over g"""
    friction_age: float = math.nan
    """m, way since the tyres last showed the friction, at most 300 m: from there on the interval is the assumed one"""
    throttle: float = math.nan
    brake: float = math.nan
    """-, pedal positions (0 to 1) that give force and hold; NaN without a `PedalMap`"""


@checked
@dataclass(frozen=True)
class SpeedControl:
    """Speed controller of a car along its planned path: acceleration and force that follow the plan, and its stops.

    The plan is followed by place. Ahead of the car its speeds are lowered to what the assumed friction allows
    (governor); a request uses a share of what each axle has left in addition to its lateral force (guard).

    Parameters
    ----------
    car : Vehicle
        Mass, resistance, powertrain, axles; its sections ``[drive]`` and ``[brakes]`` give the delays that are assumed.
    friction : float or pair of float
        Friction of the road: a value that is certain, or the ends of an interval. The interval becomes narrower while
        the car drives near its grip, where the controller has a steering model; its low end counts.
    drive, brakes : optional
        Actuators whose delays are known; by default those of the car file, otherwise they are learned while driving, as
        are gain over mass and what disturbs the acceleration.
    pedals : PedalMap, optional
        Turns force and hold into pedal positions; by default that of the car file. An export to C or FMU does not hold
        it: apply your map to force and hold there.

    Raises
    ------
    InvalidInput
        When the friction is not in `ASSUMABLE_FRICTION`, or its interval is empty.
    """

    car: Vehicle
    friction: Annotated[
        Finite | tuple[Finite, Finite],
        Hint("or (low, high), at least {:g} and at most {:g}".format(*ASSUMABLE_FRICTION)),
    ] = 0.9
    drive: DriveActuator | None = None
    brakes: BrakeActuator | None = None
    gain: Annotated[Finite, within(0.1, 10.0), "1/s"] = 2.0
    governor: Annotated[Finite, within(0.1, 1.0)] = 0.9
    """of the friction that bends ahead may use"""
    guard: Annotated[Finite, within(0.1, 1.0)] = 0.85
    """of the force that each axle has left"""
    stop_jerk: Annotated[Finite, within(0.1, 20.0), "m/s^3"] = 2.0
    """at the end of a stop"""
    stop_at_end: bool = True
    """whether a `Tracker` stops at the end of an open path; a simulated drive ends as its plan does"""
    emergency: Annotated[Finite, within(1.0, 15.0), "m/s^2"] = 8.0
    """largest deceleration where a stop is too near for comfort"""
    pedals: PedalMap | None = None
    tyre_shape: float | str = "unknown"
    """curve of the tyres, for an interval of the friction: C of a Magic Formula (1.05 to 2), "brush", "file" (C of the
    tyre of the car file), or "unknown": between a brush and C = 1.9"""

    def __post_init__(self) -> None:
        if self.tyre_shape not in TYRE_SHAPES:
            is_number = isinstance(self.tyre_shape, int | float)
            if not is_number or not LEAST_SHAPE <= float(self.tyre_shape) <= MAX_SHAPE:
                raise InvalidInput(
                    f'SpeedControl: tyre_shape = {self.tyre_shape!r}: must be "unknown", "file", "brush", or C of a '
                    f"Magic Formula, at least {LEAST_SHAPE:g} and at most {MAX_SHAPE:g}."
                )
        low, high = self.friction_interval
        least, most = ASSUMABLE_FRICTION
        if not least <= low <= high <= most:
            raise InvalidInput(
                f"SpeedControl: friction = {self.friction!r}: must be a value such as 0.9, or (low, high) such as "
                f"(0.65, 0.9), at least {least:g} and at most {most:g}."
            )

    @property
    def friction_interval(self) -> tuple[float, float]:
        """Low and high end of the assumed friction."""
        return self.friction if isinstance(self.friction, tuple) else (self.friction, self.friction)

    @property
    def shape(self) -> float:
        """Shape of the tyre's curve for the kernel: that of a `core.physics.tyre.TyreCurve`, 0: unknown."""
        if self.tyre_shape == "file":
            return min(max(load_tyre(self.car.tyre).shape, LEAST_SHAPE), MAX_SHAPE)
        return float(TYRE_SHAPES.get(str(self.tyre_shape), self.tyre_shape))

    def settings(self, period: float, comfort: Comfort, patience: float = 0.0) -> Any:
        """Record of the kernel for a control period (s), the comfort of a plan and the patience (s) of the steering."""
        car = self.car
        low, high = (usable_friction(packed(car), steering_limit(car), friction) for friction in self.friction_interval)
        drag, rolling = resistance(car.air_density, car.frontal_area, car.drag_coefficient, car.rolling_resistance)
        drive, brakes, pedals = self.drive or car.drive, self.brakes or car.brakes, self.pedals or car.pedals
        traction_limit, brake_limit = car.traction_limit, car.brake_limit
        if pedals is not None:
            traction_limit = min(traction_limit, max(row[-1] for row in pedals.force))
            brake_limit = min(brake_limit, pedals.brake_force[-1])
        numbers = {field.name: getattr(car, field.name) for field in (*AXLES, *POWERTRAIN)}
        if "drive_front" in car.estimated:
            numbers["drive_front"] = 0.0  # the rear axle carries the least, and a car that loses it spins
        return kernel.SpeedSettings(
            **numbers | {"traction_limit": traction_limit, "brake_limit": brake_limit},
            period=period, drag=drag, rolling=rolling,
            accelerate=comfort.accelerate, brake=comfort.brake, emergency=self.emergency, stop_jerk=self.stop_jerk,
            friction=low, friction_high=high, straight_ratio=self.friction_interval[0] / low,
            governor=self.governor, guard=self.guard,
            drive_lag=drive.lag if drive else math.nan, drive_dead_time=drive.dead_time if drive else math.nan,
            brake_lag=brakes.lag if brakes else math.nan, brake_dead_time=brakes.dead_time if brakes else math.nan,
            gain=self.gain, patience=patience,
        )  # fmt: skip


def speed_path(path: Road, plan: Any, stop_at_end: bool) -> Any:
    """Plan of a road at even places, for the kernel; plan: with `s`, `speed` and `stops`, such as a `SpeedPlan`.

    Raises InvalidInput when a speed, a grade, a bank or a stop is not possible, or the speed is 0 away from a stop.
    """
    stops = np.array(plan.stops, dtype=float).reshape(-1, 2)
    arrays = path_kernel.PlanArrays(
        line=path.packed(), s=np.ascontiguousarray(plan.s), speed=np.ascontiguousarray(plan.speed),
        grade=path.grade.packed(), bank=path.bank.packed(),
        stops=stops[:, 0].copy(), seconds=stops[:, 1].copy(), stops_at_end=int(stop_at_end),
    )  # fmt: skip
    memory = np.zeros(path_kernel.speed_path_words(path.length, int(path.closed), len(stops)))
    status, number = path_kernel.write_speed_path(arrays, memory)
    if status != OK:
        raise InvalidInput(
            f"speed_path: entry {number} of the {path_kernel.PLAN_ARRAYS[status]} of the plan is not possible."
        )
    count = (memory.size - 2 * (len(stops) + 1)) // 4
    square, curvature, slope, bank = memory[: 4 * count].reshape(4, count)
    places, seconds = memory[4 * count : 4 * count + 2 * number].reshape(2, number)
    spacing = path.length / (count if path.closed else count - 1)
    return kernel.SpeedPath(square, curvature, slope, bank, places, seconds, spacing, path.length, int(path.closed))


class SpeedStart(NamedTuple):
    """Start of a speed control."""

    comfort: Comfort
    top_speed: float
    """m/s, largest speed of the plan: it decides how far ahead the governor looks"""
    patience: float = 0.0
    """s without a position, after which the steering has no estimate; 0: unlimited"""


def patience_of(controller: Controller) -> float:
    """s without a position, after which a controller behind a tracker has no estimate."""
    estimator = getattr(controller, "estimator", None)
    return float(estimator.patience) if isinstance(estimator, KalmanFilter) else LONGEST_GAP


def longitudinal_of(
    control: SpeedControl, period: float, start: SpeedStart, path: Any, controller: Controller | None = None
) -> Any:
    """A speed control at its start along a `SpeedPath` (`core.tracker.longitudinal.Longitudinal`).

    controller: by whose steering model it narrows an interval of friction; None: it does not.
    """
    settings = control.settings(period, start.comfort, start.patience)
    sample = kernel.SPEED_SAMPLE.new(1, acceleration=math.nan, top_speed=math.inf, grade=math.nan)
    memory, ahead = kernel.SPEED_MEMORY.new(1), np.zeros(horizon_cells(start.top_speed, settings))
    friction = friction_estimate(control, period, controller)
    longitudinal = tracked_kernel.Longitudinal(
        sample, memory, settings, path, speed_banks(settings, period), ahead, friction
    )
    tracked_kernel.longitudinal_begin(longitudinal)
    return longitudinal


def friction_estimate(control: SpeedControl, period: float, controller: Controller | None) -> Any:
    """An estimate of the friction by the steering model of a controller (`core.speed.friction.FrictionEstimate`).

    It has no hypotheses where the friction is certain, and without a steering model. period: s, of the control.
    """
    (low, high), nothing, knowledge = control.friction_interval, np.zeros(0), {}
    hypotheses, commands, plant, variances = 0, 0, nothing, nothing
    belief = None if controller is None else controller.belief
    if belief is not None and low < high:
        hypotheses, commands = FRICTION_COUNT, math.ceil(LONGEST_STEERING_DELAY / period) + 1
        rate = belief.rate.value if belief.lag.value > 0.0 else math.inf  # a rate limit acts on a lag
        plant = pack_plant(
            control.car, load_tyre(control.car.tyre), SteeringActuator(**{**belief.steering, "rate": rate})
        )
        estimator = getattr(controller, "estimator", None)
        filtering = estimator if isinstance(estimator, KalmanFilter) else KalmanFilter()
        variances = filtering.variances()[FRICTION_SENSORS]
        knowledge = {"lag": belief.lag.value, "dead_time": belief.delay, **ASSUMED_KNOWLEDGE}
    return friction_kernel.FrictionEstimate(
        friction_kernel.FRICTION_MEMORY.new(1), friction_kernel.FRICTION_HYPOTHESIS.new(hypotheses),
        np.zeros(commands), plant, period, variances, low, high, control.shape,
        friction_kernel.CERTAIN_RESERVE if "drive_front" in control.car.estimated else 0.0,
        LearnedRow(**dict.fromkeys(LearnedRow._fields, 0.0) | knowledge),
    )  # fmt: skip


def horizon_cells(top_speed: float, settings: Any) -> int:
    """How many cells the governor looks ahead for a top speed (m/s)."""
    return int(path_kernel.horizon_cells(top_speed, settings.brake, path_kernel.PLACE_SPACING))


def speed_banks(settings: Any, period: float) -> Any:
    """Banks of hypotheses for a control period (s): one of an actuator whose delays are known, all of another."""
    longest = learning.MAX_DEAD_TIME
    ages = SPEED_GRACE + SPEED_GRACE  # s, of a speed, and until the one before it
    sizes = []
    for lag, dead_time in (
        (settings.drive_lag, settings.drive_dead_time), (settings.brake_lag, settings.brake_dead_time)
    ):  # fmt: skip
        is_learned = math.isnan(lag)
        sizes.append(learning.LAG_HYPOTHESES * learning.DEAD_TIME_HYPOTHESES if is_learned else 1)
        longest = longest if is_learned else max(longest, dead_time)
    drive, brakes = (learning.ACTUATOR_HYPOTHESIS.new(size) for size in sizes)
    return learning.SpeedBanks(drive, brakes, np.zeros(2 * (math.ceil((longest + ages) / period) + 2)))


class SpeedController:
    """A speed control on its way along a path, called once a control period.

    patience: s without a position, after which the steering has no estimate; 0: unlimited.
    """

    def __init__(
        self, control: SpeedControl, path: Road, plan: Any, period: float, *, stop_at_end: bool = False,
        patience: float = 0.0,
    ) -> None:  # fmt: skip
        self.control, self._period, self._stop_at_end, self._patience = control, period, stop_at_end, patience
        self._controller: Any = None
        self._comfort = plan.comfort
        start = SpeedStart(plan.comfort, float(plan.speed.max()), patience)
        self._load(longitudinal_of(control, period, start, speed_path(path, plan, stop_at_end)))

    def _load(self, record: Any) -> None:
        """Let the kernels work on this record (`core.tracker.longitudinal.Longitudinal`)."""
        self.record, self._resident = record, Resident(record)

    def estimate_friction(self, controller: Controller) -> None:
        """Narrow an interval of friction by the steering model of a controller, or by what it learns, from now on."""
        friction = friction_estimate(self.control, self._period, controller)
        friction_kernel.begin_friction(friction)
        self._controller = controller
        self._load(self.record._replace(friction=friction))

    def narrow_behind(self, tracker: Any) -> None:
        """Narrow the friction at a control instant of a tracker (resident), before a step of its controller."""
        tracked_kernel.narrow_tracked_friction(tracker, self._learned, self._resident)

    @property
    def _learned(self) -> Array:
        """Memory of the controller's learner; empty where nothing is learned."""
        return np.zeros(0) if self._controller is None else self._controller.learner_memory

    def follow(self, path: Road, plan: Any, stop_at_end: bool | None = None) -> None:
        """Follow another plan from now on; what was learned of resistance, slope and friction stays.

        plan: a `SpeedPlan`, or s, speed, stops and comfort; stop_at_end: None: as before.
        """
        settings = self.record.settings
        if plan.comfort != self._comfort:
            self._comfort = plan.comfort
            settings = self.control.settings(self._period, plan.comfort, self._patience)
        stops = self._stop_at_end if stop_at_end is None else stop_at_end
        self._load(
            self.record._replace(
                settings=settings, path=speed_path(path, plan, stops),
                ahead=np.zeros(horizon_cells(float(plan.speed.max()), settings)),
            )
        )  # fmt: skip
        tracked_kernel.longitudinal_follow(self._resident)

    def step(
        self, station: float, speed: float, yaw_rate: float, *, acceleration: float = math.nan, driver: bool = False,
        blind_time: float = 0.0, grade: float = math.nan,
    ) -> SpeedCommand:  # fmt: skip
        """Return the requests for the present period.

        station: m, of the car on its path over all laps; speed: m/s; yaw_rate: rad/s; acceleration: m/s^2, along the
        car, without gravity. NaN: not measured. driver: whether a driver uses the pedals: the requests then follow the
        motion of the car, and nothing is learned; blind_time: s, since the last position; grade: dz/ds under the car,
        measured, positive uphill; NaN: that of the path.
        """
        sample = self.record.sample
        is_guided = math.isfinite(station)
        last = sample[0]
        sample[0] = (
            station, 0.0, 0.0, speed, 0.0, yaw_rate, acceleration, driver, is_guided, last.top_speed, blind_time, grade,
            1.0, last.is_timed, last.correction, last.correction_limit, last.rest_time,
        )  # fmt: skip
        tracked_kernel.speed_control_step(self._resident)
        return self.command

    def limit_speed(self, controller: Controller) -> None:
        """Limit the speed to `Learner.first_top_speed`, until a run finds that the delay of the steering is learned."""
        if controller.learner is not None:
            self.record.sample[0].top_speed = controller.learner.first_top_speed

    @property
    def governed_speed(self) -> float:
        """m/s, planned speed after the governor, of the cell of the path in which the car is."""
        return math.sqrt(float(self.record.ahead[0]))

    @property
    def top_speed(self) -> float:
        """m/s, up to which the steering is known."""
        return float(self.record.sample[0].top_speed)

    @property
    def blind_top_speed(self) -> float:
        """m/s, up to which the car can stand before the steering loses its estimate; inf: it never does.

        A car that loses its position brakes with the deceleration of comfort from `BLIND_GRACE` on, and from
        `COMFORT_GAP` on with at most `emergency` and what the guard leaves of the lowest assumed friction to a car of
        the mass in its file, each after the delay of its brakes. Delay and gain of the brakes count with `BLIND_SIGMAS`
        standard deviations, and `BLIND_MARGIN` (s) is left.
        """
        if self._patience <= 0.0:
            return math.inf
        brakes, settings = self.learned["brakes"], self.record.settings
        delay = brakes.lag + brakes.dead_time + kernel.BLIND_SIGMAS * brakes.delay_sigma + kernel.BLIND_MARGIN
        gain = min(max(brakes.ratio - kernel.BLIND_SIGMAS * brakes.ratio_sigma, 0.0), 1.0)
        grip = gain * self.control.guard * settings.friction * GRAVITY
        comfort_time = kernel.COMFORT_GAP - kernel.BLIND_GRACE
        strong_time = max(self._patience - kernel.COMFORT_GAP - delay, 0.0)
        return float(comfort_time * min(settings.brake, grip) + strong_time * min(self.control.emergency, grip))

    @property
    def command(self) -> SpeedCommand:
        """Requests in force."""
        row, pedals = np.empty(len(SPEED_REQUEST)), self.control.pedals or self.control.car.pedals
        tracked_kernel.write_requests(self.record, row, 0)
        acceleration, force, hold, target_speed, grip_used, state, cause, low, high, age = row.tolist()
        positions = (math.nan, math.nan)
        if pedals is not None:
            positions = pedals.positions(force, float(self.record.memory[0].speed), hold)
        return SpeedCommand(
            acceleration, force, hold, target_speed, grip_used, _STATES[int(state)], _LIMITS[int(cause)], low, high,
            age, *positions,
        )  # fmt: skip

    @property
    def learned(self) -> dict[str, Any]:
        """Estimates of ``drive`` and ``brakes``: `core.speed.learning.ActuatorBelief` of each."""
        return {name: learning.mean_of_bank(getattr(self.record.banks, name)) for name in ("drive", "brakes")}

    def release(self) -> None:
        """Leave the stop at which the car stands, whatever its time; at the end of a path it stays."""
        tracked_kernel.longitudinal_release(self._resident)

    def acknowledge_fault(self) -> None:
        """End a fault of brakes or drive, and the distrust of the measured speed: the car drives on."""
        tracked_kernel.longitudinal_acknowledge(self._resident)

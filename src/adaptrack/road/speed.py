"""The speed along a road: the fastest one that curvature, friction, bank, grade, comfort and powertrain allow.

`adaptrack.core.planning.speed` has the formulas and finds it; here are its inputs, its refusals, stops, a bounded jerk.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import lru_cache
from typing import Annotated, Any, NamedTuple

import numpy as np
import scipy  # loads its parts when they are first used
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from adaptrack.base.checked import Finite, NotNegative, Positive, checked, reals, within
from adaptrack.base.errors import InvalidInput
from adaptrack.base.files import Record
from adaptrack.base.limits import MAX_SPEED
from adaptrack.cars.vehicle import Domain, SteeringActuator, Vehicle, load_tyre, pack_plant
from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import Array
from adaptrack.core.planning import cornering as cornering_kernel
from adaptrack.core.planning import speed as kernel
from adaptrack.core.planning.cells import PLAN, plan_places
from adaptrack.core.planning.speed import STRAIGHT_CURVATURE as STRAIGHT_CURVATURE
from adaptrack.core.speed import plan as plan_kernel
from adaptrack.road.holdable_speed import HoldableSpeed, highest
from adaptrack.road.road import Road

PLAN_SPACING = 1.0
"""m, between the places at which the speed is planned, by default."""


class Comfort(Record):
    """How hard the road is driven."""

    lateral: float = Field(default=3.0, gt=0.0, le=50.0, description="m/s^2, felt sideways")
    accelerate: float = Field(default=2.0, gt=0.0, le=50.0, description="m/s^2")
    brake: float = Field(default=3.0, gt=0.0, le=50.0, description="m/s^2")
    jerk: float = Field(default=math.inf, gt=0.0, allow_inf_nan=True, description="m/s^3, along the road; inf: any")
    lateral_jerk: float = Field(
        default=10.0, gt=0.0, allow_inf_nan=True, description="m/s^3, v^3 d(curvature)/ds within elements; inf: any"
    )
    grip_share: float = Field(default=0.9, gt=0.0, le=1.0, description="-, of the friction that may be used")


DEFAULT_COMFORT = Comfort()
"""As most are driven."""


class Limit(StrEnum):
    """Bound of a planned speed at a place."""

    LATERAL = "lateral comfort"
    GRIP = "grip"
    CURVATURE_RATE = "curvature rate"
    SPEED_LIMIT = "speed limit"
    DOMAIN = "domain of the car"
    TOP_SPEED = "top speed"
    MARGINS = "margins of the controller"
    ENDS = "stop or end"
    ACCELERATE = "comfort in accelerating"
    POWER = "power"
    BRAKE = "comfort in braking"
    BRAKES = "brakes"
    JERK = "jerk"


_LIMITS = tuple(Limit[name.upper()] for name in kernel.SPEED_LIMIT._fields)


class Stretch(NamedTuple):
    """A part of a road on which one limit binds."""

    limit: Limit
    start: float
    """Start station (m)."""
    end: float
    """End station (m)."""


class Stop(NamedTuple):
    """A place to stop at."""

    s: float
    """Station (m)."""
    seconds: float = 0.0
    """how long to stand"""


@dataclass(frozen=True, eq=False)
class SpeedPlan:
    """A speed along a road; between its places v^2 is straight: the acceleration is constant."""

    s: Array
    """(n,) m"""
    speed: Array
    """(n,) m/s"""
    time: Array
    """(n,) s, of arrival, from the start"""
    duration: float
    """s, in all; of a lap on a closed road"""
    closed: bool
    comfort: Comfort
    binding: NDArray[np.int8] | None = None
    """(n - 1,) places in `Limit` of what bounds the speed from a place to the next; None where nothing did"""

    @property
    def stretches(self) -> list[Stretch]:
        """Stretches of the active speed bound, from start to end; none where the speed was not planned."""
        if self.binding is None:
            return []
        cuts = np.flatnonzero(np.diff(self.binding)) + 1
        first, last = np.concatenate([[0], cuts]), np.concatenate([cuts, [self.binding.size]])
        return [
            Stretch(_LIMITS[self.binding[i]], float(self.s[i]), float(self.s[j]))
            for i, j in zip(first.tolist(), last.tolist(), strict=True)
        ]

    @property
    def shares(self) -> dict[Limit, float]:
        """Which share of the road each limit binds, the largest first."""
        shares: dict[Limit, float] = {}
        for stretch in self.stretches:
            shares[stretch.limit] = shares.get(stretch.limit, 0.0) + (stretch.end - stretch.start) / float(self.s[-1])
        return dict(sorted(shares.items(), key=lambda item: -item[1]))

    @property
    def stops(self) -> list[Stop]:
        """Where the plan stands, and for how long; without the ends of an open road at which it just begins or ends."""
        stands = np.flatnonzero(self.speed[:-1] == 0.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            moving = np.diff(self.s) / (0.5 * (self.speed[1:] + self.speed[:-1]))
            seconds = np.maximum(np.round(np.diff(self.time) - moving, 9), 0.0)[stands]
        seconds[np.isnan(seconds)] = math.inf
        stops = map(Stop, self.s[stands].tolist(), seconds.tolist())
        return [stop for stop in stops if self.closed or stop.s > 0.0 or stop.seconds > 0.0]

    @property
    def acceleration(self) -> Array:
        """(n - 1,) m/s^2, along the road, between the places."""
        return 0.5 * np.diff(portable.square(self.speed)) / np.diff(self.s)

    def at(self, s: ArrayLike) -> Array:
        """The speed (m/s) at the arc lengths `s`: lap after lap, or constant beyond the ends of an open road."""
        place = reals("SpeedPlan.at: s", s)
        values = place.flatten()
        s, speed = np.ascontiguousarray(self.s), np.ascontiguousarray(self.speed)
        plan_kernel.planned_speeds(float(s[-1]) if self.closed else 0.0, s, speed, values)
        return np.asarray(values.reshape(place.shape)[()])

    def motion(self, time: ArrayLike) -> tuple[Array, Array]:
        """Station (m) and speed (m/s) at times (s) from the start: lap after lap, or at the end of an open road."""
        t = reals("SpeedPlan.motion: time", time)
        s, v = np.empty(t.size), np.empty(t.size)
        plan_kernel.plan_motion(self.packed(), t.flatten(), s, v)
        return np.asarray(s.reshape(t.shape)[()]), np.asarray(v.reshape(t.shape)[()])

    def packed(self) -> Any:
        """The plan as the record that `adaptrack.core` reads; read-only."""
        rows = (np.ascontiguousarray(column) for column in (self.s, self.speed, self.time))
        return plan_kernel.SpeedPlanRecord(*rows, self.duration, int(self.closed))


@checked
def plan_speed(
    road: Road,
    car: Vehicle | None = None,
    comfort: Comfort = DEFAULT_COMFORT,
    *,
    start: Annotated[NotNegative, "m/s"] | None = None,
    end: Annotated[NotNegative, "m/s"] | None = None,
    stops: Sequence[Stop | float] = (),
    top_speed: Annotated[Positive, "m/s", MAX_SPEED] | None = None,
    spacing: Annotated[Finite, within(0.01, 100.0), "m"] = PLAN_SPACING,
    holds: HoldableSpeed | None = None,
) -> SpeedPlan:
    """The fastest speed along a road; `SpeedPlan.stretches` say what bounds it where.

    Parameters
    ----------
    car : Vehicle, optional
        Its power, traction, brakes and resistance; without it comfort and friction alone bound the acceleration.
    start, end : float, optional
        Speed at the two ends of an open road. Left out they are free; the start is one that the car's power holds.
    stops : sequence of Stop or float
        Where to stand still, in m, and for how many seconds.
    top_speed : float, optional
        Beside the road's own limit. By default, where the road has none, the highest speed of the car's domain, or
        of the usual `Domain` without a car.
    spacing : float
        Largest distance of the places.
    holds : HoldableSpeed, optional
        Up to which speed and braking the margins of the controller hold (`adaptrack.analysis.holdable`).

    Raises
    ------
    InvalidInput
        When a stop is not on the road, a bend is tighter than the car can turn, a bank alone exceeds what is allowed
        sideways, a grade is steeper than drive, brakes or tyres can hold, or the speed at the start is too high to
        brake in time; the message says where.
    """
    try:
        halts = [Stop(*map(float, stop if isinstance(stop, tuple) else (stop,))) for stop in stops]
    except (TypeError, ValueError):
        raise InvalidInput(f"plan_speed: stops = {stops!r}: give places (m), or Stop(place, seconds).") from None
    for stop in halts:
        if not 0.0 <= stop.s <= road.length or not stop.seconds >= 0.0:
            raise InvalidInput(
                f"plan_speed: {stop}: must lie on the road, 0 to {road.length:.6g} m, for a time >= 0 s."
            )
    if road.closed and (start is not None or end is not None):
        raise InvalidInput("plan_speed: a closed road has no start and no end: leave both out, or give stops.")
    bounds = _bounds(comfort, car, start, end, top_speed, spacing)
    planning = _planning(road, bounds, car, halts)
    planning = _with_cells(planning, car, holds)
    status, place, value = kernel.fastest_speeds(planning)
    _refuse(planning, status, place, value)
    if math.isfinite(comfort.jerk):
        _soften(planning, road.closed)
    duration = kernel.plan_times(planning)
    kernel.plan_binding(planning)
    binding = planning.table[PLAN.binding, :-1].astype(np.int8)
    return _plan(planning.table, duration, road.closed, comfort, binding)


def unlimited(limit: Array) -> NDArray[np.bool_]:
    """Where a speed limit (m/s) is none: files write it as a speed that no car has."""
    return limit > MAX_SPEED.most


@checked
def constant_speed(road: Road, speed: Annotated[Positive, "m/s", MAX_SPEED]) -> SpeedPlan:
    """One speed all along a road, whatever its limits."""
    planning = _planning(road, _bounds(Comfort(), None), None, ())
    return _plan(planning.table, kernel.plan_constant(speed, planning), road.closed, Comfort())


def speed_limit_plan(road: Road) -> SpeedPlan:
    """The speed limit of a road as the speed along it, whatever else bounds the speed: that of a race line.

    Raises
    ------
    InvalidInput
        When a part of the road has no speed limit.
    """
    planning = _planning(road, _bounds(Comfort(), None), None, ())
    kernel.plan_cells(planning)
    limit = road.along("speed_limit", planning.table[PLAN.s])
    if unlimited(limit).any():
        raise InvalidInput(f"speed_limit_plan: road {road.name!r} has no speed limit: give load_road a speed_column.")
    planning.table[PLAN.square] = limit * limit
    return _plan(planning.table, kernel.plan_times(planning), road.closed, Comfort())


def _bounds(
    comfort: Comfort, car: Vehicle | None, start: float | None = None, end: float | None = None,
    top_speed: float | None = None, spacing: float = PLAN_SPACING,
) -> Any:  # fmt: skip
    """Return the bounds of a plan besides road and powertrain, for the kernels."""
    return kernel.SpeedBounds(
        **comfort.model_dump(),
        start=math.nan if start is None else start,
        end=math.nan if end is None else end,
        top_speed=math.nan if top_speed is None else top_speed,
        domain_speed=(Domain() if car is None else car.domain).speed[1],
        no_limit=MAX_SPEED.most,
        steering_limit=math.nan if car is None else steering_limit(car),
        spacing=spacing,
    )


def _planning(road: Road, bounds: Any, car: Vehicle | None, halts: Sequence[Stop]) -> Any:
    """A plan to be made, for the kernels (`core.planning.speed.Planning`); nothing of it is written."""
    stops, seconds = np.array(sorted(halts), dtype=np.float64).reshape(-1, 2).T.copy()
    route, none = road.route(), np.zeros(0)
    places = plan_places(route.line.start, bounds.spacing, stops, none)
    plant = none if car is None else packed(car)
    return kernel.Planning(
        route, bounds, plant, stops, seconds, none, np.zeros((0, 0)), np.zeros((len(PLAN), places))
    )  # fmt: skip


def _with_cells(planning: Any, car: Vehicle | None, holds: HoldableSpeed | None) -> Any:
    """The plan with what road, car and controller say between its places."""
    kernel.plan_cells(planning)
    table = planning.table[:, :-1]
    curvature, bank, friction = table[PLAN.curvature], table[PLAN.bank], table[PLAN.friction]
    if car is not None:
        table[PLAN.cornering] = cornering_limit(car, curvature, friction)
    if holds is None:
        return planning
    held_at, deceleration = holds.along(curvature, bank, friction)
    table[PLAN.margins] = highest(held_at, deceleration)
    return planning._replace(held_at=held_at, held=np.ascontiguousarray(deceleration))


def _refuse(planning: Any, status: int, k: int, value: float) -> None:
    """Refuse what `core.planning.speed.fastest_speeds` finds not possible at a place."""
    s, curvature, tilt = (float(planning.table[row, k]) for row in (PLAN.s, PLAN.curvature, PLAN.tilt))
    if status == kernel.CANNOT_TURN:
        raise InvalidInput(
            f"plan_speed: at s = {s:.6g} m the radius is {1.0 / abs(curvature):.3g} m, and this "
            "car cannot turn so tightly; correct the road there, or smooth it."
        )
    if status == kernel.TOO_STEEP:
        raise InvalidInput(
            f"plan_speed: at s = {s:.6g} m the bank alone pushes with {abs(tilt):.3g} m/s^2, and "
            f"{value:.3g} are allowed; allow more, or correct the bank."
        )
    if status in (kernel.START_TOO_FAST, kernel.END_TOO_FAST):
        name = "start" if status == kernel.START_TOO_FAST else "end"
        bound = getattr(planning.bounds, name)
        raise InvalidInput(f"plan_speed: {name} = {bound!r} m/s: must be at most {value:.4g} there.")
    if status in (kernel.TOO_WEAK, kernel.TOO_SLIPPERY):
        _refuse_slope(planning, status, k, value)
    if status == kernel.CANNOT_BRAKE:
        raise InvalidInput(
            f"plan_speed: start = {planning.bounds.start:g} m/s: a car cannot brake in time; start at {value:.4g} m/s "
            "at most."
        )


def _refuse_slope(planning: Any, status: int, k: int, force: float) -> None:
    """Refuse a grade on which a car comes to rest or slides, with its force over the mass (m/s^2)."""
    s, grade, slope = (float(planning.table[row, k]) for row in (PLAN.s, PLAN.grade, PLAN.slope))
    action, actuators = ("climbing", "the drive gives") if slope >= 0.0 else ("descending", "the brakes give")
    rolling = " and rolling resistance" if slope >= 0.0 and planning.car.size else ""
    giver = "the tyres give" if status == kernel.TOO_SLIPPERY else actuators
    raise InvalidInput(
        f"plan_speed: at s = {s:.6g} m the car cannot go on: {action} the grade of {grade:.3g} asks for "
        f"{abs(slope):.3g} m/s^2{rolling}, and {giver} {max(force, 0.0):.3g} m/s^2; correct the grade, or "
        + ("the friction." if status == kernel.TOO_SLIPPERY else "choose another car.")
    )


def _plan(
    table: Array, duration: float, closed: bool, comfort: Comfort, binding: NDArray[np.int8] | None = None
) -> SpeedPlan:
    s, speed, time = (table[row].copy() for row in (PLAN.s, PLAN.speed, PLAN.time))
    return SpeedPlan(s, speed, time, float(duration), closed, comfort, binding)


def _soften(planning: Any, closed: bool) -> None:
    """Replace the fastest v^2 by the fastest ones below with a bounded jerk, nearly: a linear programme.

    The jerk is v a' = v w''/2. With v at most the fastest, |w''| <= 2 jerk/v_fastest keeps it, as the bounds on a at
    the fastest speed keep those at a lower one; the least time is that of the largest sum of w ds/w_fastest^(3/2).
    At a stop the acceleration ends with the motion, as at the ends of a road.
    """
    jerk, start = planning.bounds.jerk, planning.bounds.start
    fastest, ds = planning.table[PLAN.square], np.diff(planning.table[PLAN.s])
    n = fastest.size
    v = np.sqrt(fastest)
    sparse = scipy.sparse
    slope = sparse.csr_array(sparse.diags_array([-1.0 / ds, 1.0 / ds], offsets=[0, 1], shape=(n - 1, n)))
    gap = 0.5 * (ds[:-1] + ds[1:])
    bend = sparse.csr_array(sparse.diags_array([-1.0 / gap, 1.0 / gap], offsets=[0, 1], shape=(n - 2, n - 1))) @ slope
    drive, brake = np.empty(n - 1), np.empty(n - 1)
    kernel.plan_accelerations(planning, drive, brake)
    share = 2.0 * jerk / np.maximum(np.maximum(v[1:-1], 0.5 * (v[:-2] + v[2:])), 0.1)
    moving = fastest[1:-1] > 0.0
    bend, share = bend[moving], share[moving]
    rows, bounds = [slope, -slope, bend, -bend], [np.maximum(2.0 * force, 0.0) for force in (drive, brake)]
    bounds += [share, share]
    if closed and fastest[0] > 0.0:
        seam = (slope[[0]] - slope[[n - 2]]) * (2.0 / (ds[0] + ds[-1]))
        rows += [seam, -seam]
        bounds += [share[:1], share[:1]]
    if closed:
        rows.append(sparse.csr_array(([1.0, -1.0], ([0, 0], [0, n - 1])), shape=(1, n)))
        bounds.append(np.zeros(1))
    worth = np.concatenate([ds, [ds[-1]]]) / portable.power(np.maximum(fastest, 1.0), 1.5)
    low = np.zeros(n)
    low[0] = 0.0 if math.isnan(start) else fastest[0] * (1.0 - 1e-9)
    below, most, ends = sparse.vstack(rows), np.concatenate(bounds), np.stack([low, fastest], axis=-1)
    solution = scipy.optimize.linprog(-worth, A_ub=below, b_ub=most, bounds=ends, method="highs")
    if solution.x is None:
        raise InvalidInput(
            f"plan_speed: no speed keeps a jerk of {jerk:g} m/s^3 from this start: allow more, or start slower."
        )
    fastest[:] = np.minimum(solution.x, fastest)


# -- cornering: the steady turn in which a tyre is at its peak, or the wheels at their limit -------------------------
def steering_limit(car: Vehicle) -> float:
    """rad, of the road wheels; where the car file does not say, the limit of the paper's table."""
    limit = car.steering.limit if car.steering is not None else None
    return cornering_kernel.STEERING_LIMIT if limit is None else limit


def cornering_limit(car: Vehicle, curvature: ArrayLike, friction: ArrayLike) -> Array:
    """The largest steady lateral acceleration (m/s^2) on bends, on a level road, see `adaptrack.core.planning`.

    curvature: (n,) 1/m; friction: (n,). The limit is 0 where the wheels cannot be turned far enough even at a crawl.
    """
    bends, frictions = np.broadcast_arrays(np.asarray(curvature, float), np.asarray(friction, float))
    accelerations = np.empty(bends.shape)
    for mu in np.unique(frictions):
        rows = frictions == mu
        limits = bends[rows]
        cornering_kernel.cornering_along(*_limits(car, float(mu)), limits)
        accelerations[rows] = limits
    return accelerations


@lru_cache(maxsize=64)
def packed(car: Vehicle) -> Array:
    """The car on its own tyre as kernels read it, `PLANT_PARAMETERS`; without an actuator."""
    return pack_plant(car, load_tyre(car.tyre), SteeringActuator.ideal())


@lru_cache(maxsize=64)
def _limits(car: Vehicle, friction: float) -> tuple[float, Array]:
    """The tightest curvature (1/m) that the wheels allow, and the limit at even ones up to it."""
    limits = np.empty(cornering_kernel.BENDS)
    return cornering_kernel.cornering_limits(packed(car), steering_limit(car), friction, limits), limits

"""The speed along a road: the fastest one that curvature, friction, bank, comfort and powertrain allow.

With w = v^2 the acceleration along the road is a = w'(s)/2; sideways tyres feel a_y = v^2 kappa - g sin(bank). Bounds:

    |a_y| <= min(comfort, grip),  grip = share mu g cos(bank);   -brake(w, s) <= a <= drive(w, s),

where friction leaves the largest b with b^2 + (a_y/(1 - b h/(g l)))^2 <= grip^2 to brake or accelerate with: the axle
at the distance l from the centre of mass to the *other* one is unloaded by b h/(g l) of its load, must carry its share
of a_y all the same, and a car whose rear cannot spins. Without a car h = 0, the friction circle.
The curvature may change no faster than v^3 |kappa'| = lateral jerk. Each bound falls as w grows, so the
fastest profile is found by one pass forward, with what the car can gain, and one backward, with what it can lose
(E. Velenis and P. Tsiotras, *Minimum-time travel for a vehicle with acceleration limits*, JOTA 138 (2008)).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import partial
from typing import Annotated, NamedTuple

import numpy as np
import scipy  # loads its parts when they are first used
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from adaptrack.base.checked import Finite, NotNegative, Positive, checked, reals, within
from adaptrack.base.errors import InvalidInput
from adaptrack.base.files import Record
from adaptrack.base.limits import SPEED
from adaptrack.cars.domain import Domain
from adaptrack.cars.vehicle import GRAVITY, Vehicle
from adaptrack.core.speed_plan import planned_speeds
from adaptrack.road.cornering import cornering_limit
from adaptrack.road.holdable import HoldableSpeed, highest
from adaptrack.road.road import Road
from adaptrack.road.segments import Array

SPACING = 1.0
"""m, between the places at which the speed is planned, by default."""
UNLOADINGS = 6
"""Steps of Newton's method."""
FLAT = 1e-9
"""1/m, a curvature that counts as none."""


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


USUAL = Comfort()
"""As most are driven."""


class Limit(StrEnum):
    """What bounds a planned speed at a place."""

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


_LIMITS = tuple(Limit)
_NUMBER = {limit: i for i, limit in enumerate(_LIMITS)}


class Stretch(NamedTuple):
    """A part of a road on which one limit binds."""

    limit: Limit
    start: float
    """m"""
    end: float
    """m"""


class Stop(NamedTuple):
    """A place to stop at."""

    s: float
    """m"""
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
        """What bounds the speed where, from the start to the end; none where it was not planned."""
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
        found: dict[Limit, float] = {}
        for each in self.stretches:
            found[each.limit] = found.get(each.limit, 0.0) + (each.end - each.start) / float(self.s[-1])
        return dict(sorted(found.items(), key=lambda item: -item[1]))

    @property
    def acceleration(self) -> Array:
        """(n - 1,) m/s^2, along the road, between the places."""
        return 0.5 * np.diff(self.speed**2) / np.diff(self.s)

    def at(self, s: ArrayLike) -> Array:
        """The speed (m/s) at the arc lengths `s`: lap after lap, or constant beyond the ends of an open road."""
        place = reals("SpeedPlan.at: s", s)
        found = place.flatten()
        s, speed = np.ascontiguousarray(self.s), np.ascontiguousarray(self.speed)
        planned_speeds(float(s[-1]) if self.closed else 0.0, s, speed, found)
        return np.asarray(found.reshape(place.shape)[()])

    def motion(self, time: ArrayLike) -> tuple[Array, Array]:
        """Station (m) and speed (m/s) at times (s) from the start: lap after lap, or at the end of an open road."""
        t = reals("SpeedPlan.motion: time", time)
        laps = np.floor(t / self.duration) if self.closed else np.zeros_like(t)
        inside = np.minimum(t - laps * self.duration, self.duration)
        k = np.clip(np.searchsorted(self.time, inside, side="right") - 1, 0, self.s.size - 2)
        moving = np.diff(self.s) / (0.5 * (self.speed[:-1] + self.speed[1:]))
        since = np.clip(inside - (self.time[k + 1] - moving[k]), 0.0, moving[k])  # after standing at k
        gained = self.acceleration[k] * since
        reached = inside >= self.time[-1]
        s = np.where(reached, self.s[-1], self.s[k] + (self.speed[k] + 0.5 * gained) * since)
        v = np.where(reached, self.speed[-1], self.speed[k] + gained)
        return s + laps * self.s[-1], np.maximum(v, 0.0)


@checked
def plan_speed(
    road: Road,
    car: Vehicle | None = None,
    comfort: Comfort = USUAL,
    *,
    start: Annotated[NotNegative, "m/s"] | None = None,
    end: Annotated[NotNegative, "m/s"] | None = None,
    stops: Sequence[Stop | float] = (),
    top_speed: Annotated[Positive, "m/s", SPEED] | None = None,
    spacing: Annotated[Finite, within(0.01, 100.0), "m"] = SPACING,
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
        sideways, or the speed at the start is too high to brake in time; the message says where.
    """
    halts = [stop if isinstance(stop, Stop) else Stop(float(stop)) for stop in stops]
    for stop in halts:
        if not 0.0 <= stop.s <= road.length or not 0.0 <= stop.seconds < math.inf:
            raise InvalidInput(
                f"plan_speed: {stop}: must lie on the road, 0 to {road.length:.6g} m, for a time >= 0 s."
            )
    if road.closed and (start is not None or end is not None):
        raise InvalidInput("plan_speed: a closed road has no start and no end: leave both out, or give stops.")
    cells = _Cells(road, car, comfort, _places(road, spacing, halts), holds)
    cells.end_with(top_speed)
    ceiling, named = cells.ceiling()
    for stop in halts:
        here = np.abs(cells.s - stop.s) < 1e-9
        ceiling[here], named[here] = 0.0, _NUMBER[Limit.ENDS]
    _impose_ends((ceiling, named), start, end)
    if road.closed:
        least = int(ceiling[-1] < ceiling[0]) * -1
        ceiling[[0, -1]], named[[0, -1]] = ceiling[least], named[least]
    elif start is None and car is not None:
        ceiling[0] = min(ceiling[0], cells.sustained(ceiling[0]))
    w = _passed(cells, ceiling, road.closed)
    if start is not None and w[0] < start * start * (1.0 - 1e-9):
        slower = math.sqrt(w[0])
        raise InvalidInput(
            f"plan_speed: start = {start:g} m/s: a car cannot brake in time; start at {slower:.4g} m/s at most."
        )
    if math.isfinite(comfort.jerk):
        w = _with_jerk(cells, w, comfort.jerk, road.closed, start)
    plan = _plan(cells.s, w, halts, road.closed, comfort)
    return replace(plan, binding=_binding(cells, w, ceiling, named))


def unlimited(limit: Array) -> NDArray[np.bool_]:
    """Where a speed limit (m/s) is none: files write it as a speed that no car has."""
    return limit > SPEED.most


@checked
def constant_speed(road: Road, speed: Annotated[Positive, "m/s", SPEED]) -> SpeedPlan:
    """One speed all along a road, whatever its limits."""
    s = _places(road, SPACING, ())
    return _plan(s, np.full(s.shape, speed**2), (), road.closed, Comfort())


def _impose_ends(bounds: tuple[Array, NDArray[np.int8]], start: float | None, end: float | None) -> None:
    ceiling, named = bounds
    for name, value, place in (("start", start, 0), ("end", end, -1)):
        if value is None:
            continue
        most = math.sqrt(ceiling[place])
        if value > most * (1.0 + 1e-9):
            raise InvalidInput(f"plan_speed: {name} = {value!r} m/s: must be at most {most:.4g} there.")
        ceiling[place], named[place] = value * value, _NUMBER[Limit.ENDS]


def _places(road: Road, spacing: float, halts: Sequence[Stop]) -> Array:
    """Even places, those where the shape changes, and the stops."""
    even = np.linspace(0.0, road.length, max(2, math.ceil(road.length / spacing)) + 1)
    s = np.union1d(np.union1d(even, road.table.start), [stop.s for stop in halts])
    kept = np.concatenate([[True], np.diff(s) > 1e-6 * spacing])
    kept[np.searchsorted(s, [stop.s for stop in halts])] = True
    s = s[kept]
    s[-1] = road.length
    return s


def _plan(s: Array, w: Array, halts: Sequence[Stop], closed: bool, comfort: Comfort) -> SpeedPlan:
    v = np.sqrt(np.maximum(w, 0.0))
    mean = 0.5 * (v[:-1] + v[1:])
    with np.errstate(divide="ignore"):
        steps = np.diff(s) / mean  # exact for a constant acceleration
    standing = np.zeros_like(s)
    for stop in halts:
        standing[np.argmin(np.abs(s - stop.s))] += stop.seconds
    time = np.concatenate([[0.0], np.cumsum(steps)])
    arrival = time + np.concatenate([[0.0], np.cumsum(standing)[:-1]])
    return SpeedPlan(s, v, arrival, float(arrival[-1] + standing[-1]), closed, comfort)


class _Cells:
    """What bounds the speed between neighbouring places, and at what."""

    def __init__(
        self, road: Road, car: Vehicle | None, comfort: Comfort, s: Array, holds: HoldableSpeed | None = None
    ) -> None:
        self.s, self.ds, self.car, self.comfort = s, np.diff(s), car, comfort
        first, last = road.table.at(s[:-1], 1).curvature, road.table.at(s[1:], -1).curvature
        self.curvature = np.where(np.abs(first) > np.abs(last), first, last)  # monotonous between: the larger end
        with np.errstate(divide="ignore", over="ignore"):
            swerve = (comfort.lateral_jerk * self.ds / np.abs(last - first)) ** (2.0 / 3.0)
        bank, friction = road.along("bank", 0.5 * (s[:-1] + s[1:])), road.friction.least(s[:-1], s[1:])
        self.tilt = GRAVITY * np.sin(bank)
        self.grip = comfort.grip_share * friction * GRAVITY * np.cos(bank)
        if car is not None:
            self.grip = np.minimum(self.grip, comfort.grip_share * cornering_limit(car, self.curvature, friction))
        self._refuse_steep()
        self.limit = (
            np.full(self.ds.shape, np.inf) if road.speed_limit is None else road.speed_limit.least(s[:-1], s[1:])
        )
        self.bounds = {
            Limit.LATERAL: self._bend(np.full(self.ds.shape, comfort.lateral)), Limit.GRIP: self._bend(self.grip),
            Limit.CURVATURE_RATE: swerve, Limit.SPEED_LIMIT: self.limit**2,
        }  # fmt: skip
        self._held: tuple[Array, Array] | None = None
        if holds is not None:
            self._held = holds.along(self.curvature, bank, friction)
            self.bounds[Limit.MARGINS] = highest(*self._held)

    def _refuse_steep(self) -> None:
        """A bend that is too tight for the car, or a bank alone that exceeds what is allowed sideways."""
        allowed = np.minimum(self.grip, self.comfort.lateral)
        steep = np.flatnonzero(np.abs(self.tilt) >= allowed)
        if not steep.size:
            return
        k = int(steep[0])
        if allowed[k] == 0.0:
            raise InvalidInput(
                f"plan_speed: at s = {self.s[k]:.6g} m the radius is {1.0 / abs(self.curvature[k]):.3g} m, and this "
                "car cannot turn so tightly; correct the road there, or smooth it."
            )
        raise InvalidInput(
            f"plan_speed: at s = {self.s[k]:.6g} m the bank alone pushes with {abs(self.tilt[k]):.3g} m/s^2, and "
            f"{allowed[k]:.3g} are allowed; allow more, or correct the bank."
        )

    def _bend(self, allowed: Array) -> Array:
        """v^2 at which a bend asks for what is allowed sideways (m/s^2)."""
        bent = np.abs(self.curvature) > FLAT
        pushed = allowed + np.sign(self.curvature) * self.tilt
        return np.where(bent, pushed / np.where(bent, np.abs(self.curvature), 1.0), np.inf)

    def end_with(self, top_speed: float | None) -> None:
        """Where speeds end that nothing else bounds: at a top speed (m/s), or where the car's domain does."""
        if top_speed is not None:
            self.bounds[Limit.TOP_SPEED] = np.full(self.ds.shape, top_speed**2)
            return
        end = (Domain() if self.car is None else self.car.domain).speed[1]
        self.bounds[Limit.DOMAIN] = np.where(unlimited(self.limit), end**2, np.inf)

    def ceiling(self) -> tuple[Array, NDArray[np.int8]]:
        """(n,) largest v^2 at each place, whatever comes before and after, and what bounds it: its place in `Limit`."""
        stacked = np.stack(list(self.bounds.values()))
        named = np.array([_NUMBER[limit] for limit in self.bounds], np.int8)[stacked.argmin(axis=0)]
        w = np.concatenate([[np.inf], stacked.min(axis=0), [np.inf]])
        names = np.concatenate([[0], named, [0]]).astype(np.int8)
        return np.minimum(w[:-1], w[1:]), np.where(w[:-1] <= w[1:], names[:-1], names[1:])

    def sustained(self, most: float) -> float:
        """The largest v^2, up to `most`, at which the car's power holds the speed at the start."""
        if self.drive(0, most) >= 0.0:
            return most
        low, high = 0.0, most
        for _ in range(60):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if self.drive(0, middle) >= 0.0 else (low, middle)
        return low

    def left(self, k: int, w: float, arm: float) -> float:
        """What friction leaves along the road (m/s^2): Newton's method from above on a convex function, to rounding.

        arm: m, from the centre of mass to the axle that gains load.
        """
        sideways, grip = abs(w * self.curvature[k] - self.tilt[k]), float(self.grip[k])
        if sideways >= grip:
            return 0.0
        b = math.sqrt(grip * grip - sideways * sideways)
        lever = 0.0 if self.car is None else self.car.cg_height / (GRAVITY * arm)
        if lever == 0.0:
            return b
        b = min(b, (1.0 - sideways / grip) / lever)
        if sideways < 1e-6 * grip:
            return b
        for _ in range(UNLOADINGS):
            rest = 1.0 - lever * b
            over = b * b + (sideways / rest) ** 2 - grip * grip
            b -= over / (2.0 * b + 2.0 * lever * sideways**2 / rest**3)
        return max(b, 0.0)

    def drives(self, k: int, w: float) -> tuple[float, float, float]:
        """What bounds the acceleration in a cell at v^2 = w: comfort, grip, power."""
        if self.car is None:
            return self.comfort.accelerate, self.left(k, w, 1.0), math.inf
        car, slowed = self.car, self.resistance(w)
        force = min(car.traction_limit, car.engine_power / math.sqrt(max(w, 1e-6)))
        return self.comfort.accelerate, self.left(k, w, car.lr) - slowed, force / car.mass - slowed

    def brakings(self, k: int, w: float) -> tuple[float, float, float, float]:
        """What bounds the deceleration there: comfort, grip, brakes, margins of the controller.

        What air and rolling add is left to the tyres as a reserve.
        """
        held = math.inf if self._held is None else max(float(np.interp(w, self._held[0], self._held[1][k])), 0.0)
        if self.car is None:
            return self.comfort.brake, self.left(k, w, 1.0), math.inf, held
        brakes = self.car.brake_limit / self.car.mass + self.resistance(w)
        return self.comfort.brake, self.left(k, w, self.car.lf), brakes, held

    def drive(self, k: int, w: float) -> float:
        """The largest acceleration in a cell at v^2 = w."""
        return min(self.drives(k, w))

    def brake(self, k: int, w: float) -> float:
        """The largest deceleration in a cell at v^2 = w."""
        return min(self.brakings(k, w))

    def resistance(self, w: float) -> float:
        """Deceleration by air and rolling (m/s^2), without wind."""
        if self.car is None:
            return 0.0
        air = 0.5 * self.car.air_density * self.car.frontal_area * self.car.drag_coefficient * w
        return air / self.car.mass + self.car.rolling_resistance * GRAVITY


def _passed(cells: _Cells, ceiling: Array, closed: bool) -> Array:
    """Forward, then backward; on a closed road once around before it counts."""
    w, n = ceiling.copy(), cells.ds.size
    for lap in range(2 if closed else 1):
        if lap:
            w[0] = w[-1] = min(w[0], w[-1])
        for k in range(n):
            w[k + 1] = min(w[k + 1], _next(w[k], w[k + 1], cells.ds[k], partial(cells.drive, k)))
    for lap in range(2 if closed else 1):
        if lap:
            w[0] = w[-1] = min(w[0], w[-1])
        for k in range(n - 1, -1, -1):
            w[k] = min(w[k], _next(w[k + 1], w[k], cells.ds[k], partial(cells.brake, k)))
    return w


_DRIVES = (Limit.ACCELERATE, Limit.GRIP, Limit.POWER)
_BRAKINGS = (Limit.BRAKE, Limit.GRIP, Limit.BRAKES, Limit.MARGINS)


def _binding(cells: _Cells, w: Array, ceiling: Array, named: NDArray[np.int8]) -> NDArray[np.int8]:
    """(n - 1,) places in `Limit` of what bounds v^2 = w in each cell.

    Where both of its ends are at their ceilings, that of the slower one; else what bounds the acceleration.
    """
    at_ceiling = w >= ceiling * (1.0 - 1e-6)
    found = np.where(w[:-1] <= w[1:], named[:-1], named[1:])
    for k in np.flatnonzero(~(at_ceiling[:-1] & at_ceiling[1:])).tolist():
        gains = w[k + 1] >= w[k]
        bounds, names = (cells.drives, _DRIVES) if gains or cells.drive(k, w[k]) < 0.0 else (cells.brakings, _BRAKINGS)
        most = np.minimum(bounds(k, w[k]), bounds(k, w[k + 1]))
        used = abs(w[k + 1] - w[k]) / (2.0 * cells.ds[k])
        soft = math.isfinite(cells.comfort.jerk) and used < 0.98 * most.min()
        found[k] = _NUMBER[Limit.JERK if soft else names[int(most.argmin())]]
    return found.astype(np.int8)


def _next(w: float, ceiling: float, ds: float, most: Callable[[float], float]) -> float:
    """v^2 a cell further, with what is possible at both of its ends."""
    reached = max(min(ceiling, w + 2.0 * ds * most(w)), 0.0)
    return max(min(reached, w + 2.0 * ds * most(reached)), 0.0)


def _with_jerk(cells: _Cells, fastest: Array, jerk: float, closed: bool, start: float | None) -> Array:
    """The fastest v^2 below `fastest` with a bounded jerk, nearly: a linear programme.

    The jerk is v a' = v w''/2. With v at most the fastest, |w''| <= 2 jerk/v_fastest keeps it, as the bounds on a at
    the fastest speed keep those at a lower one; the least time is that of the largest sum of w ds/w_fastest^(3/2).
    """
    n, ds = fastest.size, cells.ds
    v = np.sqrt(fastest)
    sparse = scipy.sparse
    slope = sparse.csr_array(sparse.diags_array([-1.0 / ds, 1.0 / ds], offsets=[0, 1], shape=(n - 1, n)))
    gap = 0.5 * (ds[:-1] + ds[1:])
    bend = sparse.csr_array(sparse.diags_array([-1.0 / gap, 1.0 / gap], offsets=[0, 1], shape=(n - 2, n - 1))) @ slope
    drive = np.array([2.0 * min(cells.drive(k, fastest[k]), cells.drive(k, fastest[k + 1])) for k in range(n - 1)])
    brake = np.array([2.0 * min(cells.brake(k, fastest[k]), cells.brake(k, fastest[k + 1])) for k in range(n - 1)])
    share = 2.0 * jerk / np.maximum(np.maximum(v[1:-1], 0.5 * (v[:-2] + v[2:])), 0.1)
    rows, bounds = [slope, -slope, bend, -bend], [np.maximum(drive, 0.0), brake, share, share]
    if closed:
        seam = (slope[[0]] - slope[[n - 2]]) * (2.0 / (ds[0] + ds[-1]))
        rows += [seam, -seam, sparse.csr_array(([1.0, -1.0], ([0, 0], [0, n - 1])), shape=(1, n))]
        bounds += [share[:1], share[:1], np.zeros(1)]
    worth = np.concatenate([ds, [ds[-1]]]) / np.maximum(fastest, 1.0) ** 1.5
    low = np.zeros(n)
    low[0] = 0.0 if start is None else fastest[0] * (1.0 - 1e-9)
    below, most, ends = sparse.vstack(rows), np.concatenate(bounds), np.stack([low, fastest], axis=-1)
    found = scipy.optimize.linprog(-worth, A_ub=below, b_ub=most, bounds=ends, method="highs")
    if found.x is None:
        raise InvalidInput(
            f"plan_speed: no speed keeps a jerk of {jerk:g} m/s^3 from this start: allow more, or start slower."
        )
    return np.minimum(found.x, fastest)

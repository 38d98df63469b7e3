"""What of a road a car cannot drive, named before anything drives."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from adaptrack.base.checked import checked, real
from adaptrack.base.errors import InvalidInput
from adaptrack.cars.vehicle import Vehicle
from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import Array
from adaptrack.core.physics.forces import GRAVITY
from adaptrack.road.road import Road
from adaptrack.road.speed import STRAIGHT_CURVATURE, SpeedPlan, cornering_limit, steering_limit, unlimited

CHECK_SPACING = 0.5
"""m, between the places that are looked at, beside those where the shape changes."""
SPEAKING_JUMP = 1e-3
"""1/m, from which on a jump of curvature is reported: 3 mrad at the wheels of a car."""

FAR_TIGHTER = 10.0
"""Times smaller than a car's smallest radius: no road is, one in kilometres may be."""

RIPPLE, MIN_SWINGS = 0.1, 4
"""m, to each side, up to which a line that swings is no road but noise, or half of the road's deviation if that is
more; and how many swings of the curvature in a row."""
SLOWED, FELT = 0.9, 0.25
"""Times the speed that the line without ripple allows, below which a plan is slowed; and the share of what is allowed
sideways that a swing must ask for."""

FindingKind = Literal["radius", "grip", "steering-rate", "width", "fold", "jump", "ripple", "domain"]


@dataclass(frozen=True)
class Finding:
    """Something about a road that a car, or its driver, must know."""

    kind: FindingKind
    start: float
    """Start station (m)."""
    end: float
    """End station (m)."""
    value: float
    """of the worst place: radius (m), lateral acceleration (g), steering rate (rad/s), width (m), curvature (1/m), or
    speed (m/s) of ripple and domain"""
    limit: float
    """Limit of the quantity."""
    text: str
    drivable: bool
    """Whether the road can be driven all the same."""


def smallest_radius(car: Vehicle) -> float:
    """Radius (m) of the tightest circle of the centre of mass at low speed: sqrt((L/tan delta)^2 + l_r^2)."""
    limit = steering_limit(car)
    return portable.hypot(car.wheelbase / portable.tan(limit), car.lr) if limit < 0.5 * math.pi else car.lr


@checked
def check_road(road: Road, car: Vehicle, speed: SpeedPlan | float | None = None) -> list[Finding]:
    """List the places of a road that a car cannot drive, then notes for the driver: the worst place of each stretch.

    Parameters
    ----------
    speed : SpeedPlan or float, optional
        At which it is driven, m/s; without it only the shape is checked.

    Raises
    ------
    InvalidInput
        When a speed is not positive.
    """
    if not isinstance(speed, SpeedPlan | None) and not 0.0 < real("check_road", "speed", speed) < math.inf:
        raise InvalidInput(f"check_road: speed = {speed!r} m/s: must be > 0.")
    places = _Places(road, speed)
    findings = [*_radius(places, car), *_width(places, car), *_fold(places), *_jumps(road, car)]
    if speed is not None:
        findings += [*_grip(places, car), *_steering_rate(places, car), *_domain(places, car)]
    if isinstance(speed, SpeedPlan):
        findings += [*_ripple(road, speed)]
    return sorted(findings, key=lambda finding: (finding.drivable, finding.start))


class _Places:
    """The road at many places; where the shape changes, on both sides."""

    def __init__(self, road: Road, speed: SpeedPlan | float | None) -> None:
        even = np.linspace(0.0, road.length, max(2, math.ceil(road.length / CHECK_SPACING)) + 1)
        joints = road.table.start
        s = np.concatenate([even, joints[:-1], joints[1:]])
        sides = np.concatenate([np.ones(even.size), np.ones(joints.size - 1), -np.ones(joints.size - 1)])
        order = np.lexsort([sides, s])
        self.s, self.road, self.planned = s[order], road, isinstance(speed, SpeedPlan)
        self.curvature = road.table.at(self.s, sides[order]).curvature
        self.speed = speed.at(self.s) if isinstance(speed, SpeedPlan) else np.full(s.shape, speed or 0.0, dtype=float)

    def stretches(self, over: NDArray[np.bool_], badness: Array) -> Iterator[tuple[slice, int]]:
        """The stretches of places at which something is over, and the worst place of each; gaps of 5 m are bridged."""
        index = np.flatnonzero(over)
        if index.size:
            cuts = np.flatnonzero(np.diff(self.s[index]) > 5.0) + 1
            for group in np.split(index, cuts):
                stretch = slice(int(group[0]), int(group[-1]) + 1)
                yield stretch, stretch.start + int(badness[stretch].argmax())


def _radius(places: _Places, car: Vehicle) -> Iterator[Finding]:
    least = smallest_radius(car)
    size = np.abs(places.curvature)
    for stretch, k in places.stretches(size * least > 1.0 + 1e-9, size):
        radius = 1.0 / size[k]
        yield _finding(
            places, stretch, "radius", radius, least, False,
            f"radius {radius:{'.1f' if radius >= 1.0 else '.2g'}} m at s = {places.s[k]:.0f} m, below this car's "
            f"{least:.1f} m" + ("; is the road in metres, or in kilometres?" if radius < least / FAR_TIGHTER else ""),
        )  # fmt: skip


def _grip(places: _Places, car: Vehicle) -> Iterator[Finding]:
    bank, friction, grade = (places.road.along(name, places.s) for name in ("bank", "friction", "grade"))
    felt = np.abs(portable.square(places.speed) * places.curvature - GRAVITY * portable.sin(bank)) / GRAVITY
    limit = np.minimum(friction, cornering_limit(car, places.curvature, friction) / GRAVITY) * portable.cos(bank)
    limit *= portable.cos(portable.atan(grade))
    for stretch, k in places.stretches(felt > limit, felt - limit):
        yield _finding(
            places, stretch, "grip", float(felt[k]), float(limit[k]), False,
            f"{felt[k]:.2g} g at {places.speed[k]:.3g} m/s, radius {1.0 / abs(places.curvature[k]):.0f} m "
            f"at s = {places.s[k]:.0f} m; friction and car give {limit[k]:.2g} g",
        )  # fmt: skip


def _steering_rate(places: _Places, car: Vehicle) -> Iterator[Finding]:
    """How fast the wheels must turn within the pieces: (L + K v^2) kappa'(s) v."""
    rate = car.steering.rate if car.steering is not None else None
    if rate is None:
        return
    step = np.diff(places.s, append=places.s[-1] + 1.0)
    change = np.diff(places.curvature, append=places.curvature[-1])
    slope = np.where(step > 1e-6, change / np.maximum(step, 1e-6), 0.0)
    needed = np.abs((car.wheelbase + car.understeer_gradient * portable.square(places.speed)) * slope * places.speed)
    for stretch, k in places.stretches(needed > rate, needed):
        yield _finding(
            places, stretch, "steering-rate", float(needed[k]), rate, False,
            f"the wheels must turn at {needed[k]:.2g} rad/s at {places.speed[k]:.3g} m/s at s = {places.s[k]:.0f} m; "
            f"this car's turn at {rate:.2g} rad/s",
        )  # fmt: skip


def _width(places: _Places, car: Vehicle) -> Iterator[Finding]:
    width = places.road.along("width_left", places.s) + places.road.along("width_right", places.s)
    track = max(car.track_front, car.track_rear)
    for stretch, k in places.stretches(width < track, -width):
        yield _finding(
            places, stretch, "width", float(width[k]), track, False,
            f"{width[k]:.2f} m wide at s = {places.s[k]:.0f} m, less than this car's track of {track:.2f} m",
        )  # fmt: skip


def _fold(places: _Places) -> Iterator[Finding]:
    """Where the inner edge passes the centre of curvature."""
    left, right = (places.road.along(name, places.s) for name in ("width_left", "width_right"))
    inside = np.where(places.curvature > 0.0, left, right)
    folded = inside * np.abs(places.curvature)
    for stretch, k in places.stretches(folded >= 1.0, folded):
        radius = 1.0 / abs(places.curvature[k])
        yield _finding(
            places, stretch, "fold", float(inside[k]), radius, True,
            f"{inside[k]:.1f} m to the inner edge at s = {places.s[k]:.0f} m, where the radius is {radius:.1f} m: "
            "the edge crosses itself",
        )  # fmt: skip


def _jumps(road: Road, car: Vehicle) -> Iterator[Finding]:
    jumps = road.curvature_jumps(SPEAKING_JUMP)
    if not jumps:
        return
    worst = max(jumps, key=lambda jump: abs(jump.after - jump.before))
    size = abs(worst.after - worst.before)
    step = math.degrees(car.wheelbase * size)
    count = f"{len(jumps)} jumps of curvature, the largest" if len(jumps) > 1 else "the curvature jumps,"
    yield Finding(
        "jump", jumps[0].s, jumps[-1].s, size, SPEAKING_JUMP,
        f"{count} by {size:.3g} 1/m at s = {worst.s:.0f} m: a step of {step:.2g} degrees at the wheels,"
        " which no car follows exactly; in Python, smooth_road(road) rounds it",
        True,
    )  # fmt: skip


def _domain(places: _Places, car: Vehicle) -> Iterator[Finding]:
    """Where a car is faster than its domain, and where that ends its plan because the road has no limit."""
    top = car.domain.speed[1]
    beyond, is_at_top = places.speed > top * (1.0 + 1e-9), places.speed > top * (1.0 - 1e-9)
    is_at_top &= ~beyond & places.planned & unlimited(places.road.along("speed_limit", places.s))
    for stretch, k in places.stretches(beyond, places.speed):
        yield _finding(
            places, stretch, "domain", places.speed[k], top, True,
            f"{places.speed[k]:.3g} m/s, beyond the domain of car {car.name!r}, which ends at {top:.3g} m/s",
        )  # fmt: skip
    if is_at_top.any():
        index = np.flatnonzero(is_at_top)
        yield _finding(
            places, slice(int(index[0]), int(index[-1]) + 1), "domain", top, top, True,
            f"the road has no speed limit: the plan ends at {top:.3g} m/s, with the domain of car {car.name!r}",
        )  # fmt: skip


def _ripple(road: Road, plan: SpeedPlan) -> Iterator[Finding]:
    """Where the curvature swings to and fro, moves the line by no more than noise would, and slows the plan."""
    s = np.linspace(0.0, road.length, max(2, math.ceil(road.length / CHECK_SPACING)) + 1)
    heading, curvature = road.at(s)[2:]
    moving = np.flatnonzero(np.abs(np.diff(curvature)) > STRAIGHT_CURVATURE)
    turns = moving[1:][np.diff(np.sign(np.diff(curvature)[moving])) != 0.0]  # from one extremum to the next a swing
    if turns.size <= MIN_SWINGS:
        return
    half, swing, first = np.diff(s[turns]), 0.5 * np.abs(np.diff(curvature[turns])), s[turns[:-1]]
    speed = np.minimum(plan.at(first), plan.at(s[turns[1:]]))
    allowed = np.minimum(plan.comfort.lateral, plan.comfort.grip_share * road.along("friction", first) * GRAVITY)
    straight = np.maximum(np.abs(np.diff(heading[turns])) / half, STRAIGHT_CURVATURE)
    calm = np.minimum(np.sqrt(allowed / straight), np.minimum(road.along("speed_limit", first), plan.speed.max()))
    jerk = 2.0 * (speed * speed * speed) * swing / half
    felt = np.maximum(speed * speed * swing / allowed, jerk / plan.comfort.lateral_jerk) > FELT
    small = swing * portable.square(half / math.pi) < max(RIPPLE, 0.5 * road.deviation)
    rows = np.flatnonzero(small & felt & (speed < SLOWED * calm))
    swings = [row for row in np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1) if row.size >= MIN_SWINGS]
    if swings:
        rows = np.concatenate(swings)
        worst = rows[speed[rows].argmin()]
        yield Finding(
            "ripple", float(first[rows[0]]), float(s[turns[rows[-1] + 1]]), float(speed[worst]), float(calm[worst]),
            f"over {half[rows].sum():.0f} m in all the curvature swings to and fro, by up to {swing[rows].max():.2g} "
            f"1/m, but moves the line by no more than noise moves points; it slows the plan, to {speed[worst]:.3g} m/s "
            f"at s = {first[worst]:.0f} m. Smooth the road (in Python, smooth_road(road)); if you bounded the "
            "deviation from its points (--max-deviation), allow more",
            True,
        )  # fmt: skip


def _finding(
    places: _Places, stretch: slice, kind: FindingKind, value: float, limit: float, drivable: bool, text: str
) -> Finding:
    s = places.s[stretch]
    return Finding(kind, float(s[0]), float(s[-1]), float(value), float(limit), text, drivable)

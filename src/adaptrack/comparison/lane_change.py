"""The lane-change tracks of ISO 3888: gates of cones, a line through them, margins to the cones, highest clean speed.

The tracks lie along x, the first cones at x = 0, the first lane's middle on y = 0, and swerve to the left. What could
be read of ISO 3888-1:2018 and ISO 3888-2:2011 are scope and general text, not the tables; lengths and widths are those
on which open programs agree (Project Chrono and others). Two things they do not agree on, and what is taken here:

* Part 1, offset of 3.5 m: between the right edges of the lanes 1 and 3. (Chrono: from the middle of lane 1 to the right
  edge of lane 3, which is half a lane's width more.)
* Part 2, width of the last lane: 1.3 b + 0.25 m, at least 3 m. (Chrono: 3 m.)

The right edges of the first and the last lane are in line. A run is clean when the body touches no cone and stays
within the lanes; driven off the throttle, from the first cones on.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import linprog
from scipy.sparse import csr_array, diags_array, eye_array, hstack, vstack

from adaptrack.base.checked import real
from adaptrack.base.errors import InvalidInput
from adaptrack.base.limits import MAX_SPEED
from adaptrack.cars.outline import Outline
from adaptrack.cars.vehicle import Vehicle
from adaptrack.core.plants.forces import GRAVITY
from adaptrack.drive.metrics import LANE_WIDTH
from adaptrack.road import Comfort, Road, SpeedPlan, fit_road

Array = NDArray[np.float64]
Pass = tuple[int, float, "Gate"]

APPROACH, RUN_OUT = 60.0, 60.0
"""m, straight road before the first and behind the last cones."""
LINE_SPACING = 0.5
"""m, between the points of the line through the gates."""
SHARPNESS_LENGTH = 4.0
"""m, weight of the change of curvature against the curvature in what that line minimises."""
BEND_WEIGHT = 0.002
"""Weight (1/m) of the integral of |y''| beside its largest value: the line does not weave where it need not."""
CONE_ROOM = 0.1
"""m, that it leaves between the body and the cones where it can."""
GRIP_USE = 0.9
"""Times mu g/v^2: `bend` of a line for a speed. Measured on four cars: with more they do not follow, with less the line
passes the cones more closely than it must."""
MOST_ROOM = 0.15
"""m, that it leaves at most."""
LEAST_ROOM = 0.07
"""m, that it leaves even where that takes sharper bends than allowed."""
ROOM_WEIGHT, EXCESS_WEIGHT = 1.0, 1e3
"""1/m^2 and 1: how much room counts against curvature (1/m) below and beyond the allowed one."""
BEYOND_FAILING = 8
"""Speeds of a grid, one after the other, that are not clean: then no faster one is tried."""
MARGIN_SPACING = 0.05
"""m, between the places at which margins are looked at."""


@dataclass(frozen=True)
class Gate:
    """One lane between cones."""

    start: float
    """m, along x"""
    end: float
    """m, along the track"""
    right: float
    """m, y of the right limit: the cones stand beyond it and touch it"""
    left: float
    """m, offset of the left cones from the track's centre line"""

    @property
    def width(self) -> float:
        """Width between the cones (m)."""
        return self.left - self.right

    @property
    def middle(self) -> float:
        """m, y"""
        return 0.5 * (self.left + self.right)


@dataclass(frozen=True)
class Track:
    """Gates one after the other."""

    name: str
    gates: tuple[Gate, ...]

    @property
    def length(self) -> float:
        """m, from the first cones to the last"""
        return self.gates[-1].end - self.gates[0].start

    @property
    def cones(self) -> Array:
        """(4 gates, 2) m: the cones at the ends of every lane, as points on its limits."""
        return np.array(
            [(x, y) for gate in self.gates for x in (gate.start, gate.end) for y in (gate.right, gate.left)]
        )


def iso_3888_1(width: float) -> Track:
    """The double lane change of ISO 3888-1 for a car's width (m): 125 m.

    Lanes of 15, 25 and 30 m with gaps of 30 and 25 m, 1.1 b + 0.25, 1.2 b + 0.25 and 1.3 b + 0.25 m wide.

    Raises
    ------
    InvalidInput
        When the width is not positive and at most 4 m.
    """
    first, middle, last = (factor * _width(width) + 0.25 for factor in (1.1, 1.2, 1.3))
    right = -0.5 * first
    return Track(
        "iso-3888-1",
        (
            Gate(0.0, 15.0, right, right + first),
            Gate(45.0, 70.0, right + 3.5, right + 3.5 + middle),
            Gate(95.0, 125.0, right, right + last),
        ),
    )


def iso_3888_2(width: float) -> Track:
    """The obstacle avoidance of ISO 3888-2 for a car's width (m): 61 m.

    Lanes of 12, 11 and 12 m with gaps of 13.5 and 12.5 m, 1.1 b + 0.25, b + 1 and 1.3 b + 0.25 (at least 3) m wide, the
    second 1 m to the left of the first.

    Raises
    ------
    InvalidInput
        When the width is not positive and at most 4 m.
    """
    b = _width(width)
    first, middle, last = 1.1 * b + 0.25, b + 1.0, max(1.3 * b + 0.25, 3.0)
    right, second = -0.5 * first, 0.5 * first + 1.0
    return Track(
        "iso-3888-2",
        (
            Gate(0.0, 12.0, right, right + first),
            Gate(25.5, 36.5, second, second + middle),
            Gate(49.0, 61.0, right, right + last),
        ),
    )


def _width(width: float) -> float:
    if not 0.0 < real("track", "width", width) <= 4.0:
        raise InvalidInput(f"track: width = {width!r} m: must be above 0 and at most 4.")
    return float(width)


# -- the line ---------------------------------------------------------------------------------------------------------
def track_road(
    track: Track, outline: Outline, room: float = CONE_ROOM, *, bend: float = math.inf, sideslip: float = 0.0
) -> Road:
    """A road along which the body passes all gates: the line for a controller to follow.

    The middles of the lanes ask for bends that no car can drive at speed; a driver uses the lanes' width. The line y(x)
    minimises max |y''| + 4 m max |y'''|, and a little of all |y''|, while the corners, and the sides where they pass
    cones, keep `room` to the limits: a linear programme in the small-angle form. It is straight until the centre of
    mass is between the first cones, anywhere in that lane, and in the last 10 m. The road starts `APPROACH` before the
    first cones; it is as wide as the gates, and 3.5 m more to both sides between them.

    Parameters
    ----------
    room
        m, between the body and the cones; with a `bend`, the most that is kept.
    bend
        1/m, > 0, bound on max |y''| + 4 m max |y'''|: the line keeps as much room as that allows. Where even
        `LEAST_ROOM` needs more, it keeps that and bends more, but no more than it must. Infinite: the room is kept
        whatever the bend.
    sideslip
        m, sideslip angle of the body over the curvature of the line: so much the body points out of the line.

    Raises
    ------
    InvalidInput
        When the body does not fit between the cones with that room, or the bend is not positive.
    """
    if not real("track_road", "bend", bend) > 0.0:
        raise InvalidInput(f"track_road: bend = {bend!r} 1/m: must be positive; inf: no bound.")
    x = np.arange(track.gates[0].start - APPROACH, track.gates[-1].end + RUN_OUT + 0.5 * LINE_SPACING, LINE_SPACING)
    n = x.size
    least = room if math.isinf(bend) else min(room, LEAST_ROOM)
    between_cones, limits = _cone_limits(_passes(track, outline, x), outline, n, sideslip)
    bends = _bends(n)
    within = csr_array(
        ([1.0, SHARPNESS_LENGTH, -1.0], ([0, 0, 0], [2 * n, 2 * n + 1, 2 * n + 3])), shape=(1, 2 * n + 4)
    )
    rows = vstack([bends, between_cones] + ([] if math.isinf(bend) else [within]))
    limits = np.concatenate([np.zeros(bends.shape[0]), limits, [] if math.isinf(bend) else [bend]])
    cost = np.concatenate(
        [np.zeros(n), np.full(n, BEND_WEIGHT * LINE_SPACING), [1.0, SHARPNESS_LENGTH, -ROOM_WEIGHT, EXCESS_WEIGHT]]
    )
    straight = np.concatenate([np.flatnonzero(x <= track.gates[0].start), np.arange(n - round(10.0 / LINE_SPACING), n)])
    bent = np.ones(n - 2, dtype=bool)
    bent[straight[straight < n - 2]] = False
    bounds = [(None, None)] * n + [(0.0, None if is_bent else 0.0) for is_bent in bent] + [(0.0, None)] * 4
    bounds += [(least, room), (0.0, None)]
    level = csr_array(([1.0, -1.0, 1.0, -1.0], ([0, 0, 1, 1], [0, 1, n - 2, n - 1])), shape=(2, 2 * n + 4))
    optimum = linprog(cost, A_ub=rows, b_ub=limits, A_eq=level, b_eq=np.zeros(2), bounds=bounds, method="highs")
    if optimum.x is None:
        raise InvalidInput(
            f"track_road: a body {outline.length:.2f} m long and {outline.width:.2f} m wide does not fit through "
            f"{track.name} with {least:g} m of room: ask for less room, or make the track for this car's width."
        )
    points = np.stack([x, optimum.x[:n]], axis=1)
    road = fit_road(points, max_deviation=0.005, closed=False, name=track.name, smoothest=True)
    return road.replace(**_widths(track, road))


def driven_line(track: Track, car: Vehicle, speed: float, friction: float = 0.9) -> Road:
    """`track_road` for a car at a speed (m/s): as far from the cones as its grip allows there.

    Bends are held to `GRIP_USE` mu g/v^2, and the body turns out of the line by the sideslip of a steady turn with
    linear tyres, (l_r - m l_f v^2/(2 C_r L)) times the curvature (Rajamani, *Vehicle Dynamics and Control*, 2nd ed.,
    section 3.2).

    Raises
    ------
    InvalidInput
        When the speed is not positive, or the body does not fit between the cones.
    """
    if not 0.0 < real("driven_line", "speed", speed) <= MAX_SPEED.most:
        raise InvalidInput(f"driven_line: speed = {speed!r} m/s: must be above 0 and at most {MAX_SPEED.most:g}.")
    slip = car.lr - car.mass * car.lf * speed**2 / (2.0 * car.stiffness_rear * car.wheelbase)
    return track_road(track, car.outline, MOST_ROOM, bend=GRIP_USE * friction * GRAVITY / speed**2, sideslip=slip)


def _bends(n: int) -> csr_array:
    """A u <= 0 in u = [y (n), |y''| (n), largest |y''|, largest |y'''|, room, excess]: what bounds the bends."""
    second = diags_array([1.0, -2.0, 1.0], offsets=[0, 1, 2], shape=(n - 2, n)) / LINE_SPACING**2
    third = diags_array([-1.0, 3.0, -3.0, 1.0], offsets=[0, 1, 2, 3], shape=(n - 3, n)) / LINE_SPACING**3
    size, none = eye_array(n - 2, n), csr_array((n - 3, n))
    largest, change = np.zeros((n - 2, 4)), np.zeros((n - 3, 4))
    largest[:, 0], change[:, 1] = -1.0, -1.0
    free = csr_array((n - 2, 4))
    rows = [hstack([sign * second, -size, free]) for sign in (1.0, -1.0)]
    rows += [hstack([sign * third, none, change]) for sign in (1.0, -1.0)]
    return csr_array(vstack([*rows, hstack([csr_array((n - 2, n)), size, largest])]))


def _cone_limits(passes: Sequence[Pass], outline: Outline, n: int, sideslip: float) -> tuple[csr_array, Array]:
    """A u <= b, u as in `_bends`: the body between the cones, with the room."""
    rows, limits = np.zeros((2 * len(passes), 2 * n + 4)), np.empty(2 * len(passes))
    for row, (place, ahead, gate) in enumerate(passes):
        lean = ahead * sideslip / LINE_SPACING**2
        axis = (
            -0.5 * ahead / LINE_SPACING - lean,
            1.0 + 2.0 * lean,
            0.5 * ahead / LINE_SPACING - lean,
        )  # y + ahead (y' - sideslip y'')
        for sign, side, at in ((1.0, gate.left, 2 * row), (-1.0, -gate.right, 2 * row + 1)):
            rows[at, place - 1 : place + 2] = sign * np.array(axis)
            rows[at, 2 * n + 2] = 1.0
            limits[at] = side - 0.5 * outline.width
    return csr_array(rows), limits


def _passes(track: Track, outline: Outline, x: Array) -> list[Pass]:
    """(grid point, distance ahead of it, gate): where a point of the body's axis must be within a gate.

    Both ends of the body while they are in a lane, and what is beside the cones at the lane's ends.
    """
    passes = []
    for gate in track.gates:
        for k in range(1, x.size - 1):
            for ahead in (outline.front, -outline.rear):
                if gate.start <= x[k] + ahead <= gate.end:
                    passes.append((k, ahead, gate))
            for cone in (gate.start, gate.end):
                if -outline.rear < cone - x[k] < outline.front:
                    passes.append((k, float(cone - x[k]), gate))
    return passes


def _widths(track: Track, road: Road) -> dict[str, tuple[list[float], list[float]]]:
    """Left and right width along the road: to the cones within the gates, 3.5 m more between them."""
    s = np.linspace(0.0, road.length, math.ceil(road.length / LINE_SPACING) + 1)
    line = road.at(s)
    widths: dict[str, tuple[list[float], list[float]]] = {}
    for name, sign, edge in (("width_left", 1.0, "left"), ("width_right", -1.0, "right")):
        places, values = [], []
        for gate in track.gates:
            start, end = np.interp([gate.start, gate.end], line.x, s)
            inside = np.concatenate([[start], s[(s > start + 0.01) & (s < end - 0.01)], [end]])
            width = np.maximum(sign * (getattr(gate, edge) - np.interp(inside, s, line.y)), 0.1)
            places += [start - 0.01, *inside.tolist(), end + 0.01]
            values += [width[0] + LANE_WIDTH, *width.tolist(), width[-1] + LANE_WIDTH]
        widths[name] = ([*map(float, places)], [*map(float, values)])
    return widths


def coasting_plan(track: Track, road: Road, car: Vehicle, speed: float) -> SpeedPlan:
    """The speed along a track's road: constant up to the first cones, then falling without throttle.

    By drag and rolling resistance alone, m v dv/ds = -(rho A c_d v^2/2 + f m g); what the bends take is left out.

    Parameters
    ----------
    road
        Of `track_road`.
    speed
        m/s, on entry.

    Raises
    ------
    InvalidInput
        When the speed is not positive, or the car stands before the end of the road.
    """
    if not 0.0 < real("coasting_plan", "speed", speed) <= MAX_SPEED.most:
        raise InvalidInput(f"coasting_plan: speed = {speed!r} m/s: must be above 0 and at most {MAX_SPEED.most:g}.")
    s = np.linspace(0.0, road.length, math.ceil(road.length / LINE_SPACING) + 1)
    entry = float(np.interp(track.gates[0].start, road.at(s).x, s))
    drag = 0.5 * car.air_density * car.frontal_area * car.drag_coefficient / car.mass
    rolling = car.rolling_resistance * GRAVITY
    gone = np.maximum(s - entry, 0.0)
    if drag > 0.0:
        square = speed**2 * np.exp(-2.0 * drag * gone) + rolling / drag * np.expm1(-2.0 * drag * gone)
    else:
        square = speed**2 - 2.0 * rolling * gone
    if square.min() <= 0.0:
        raise InvalidInput(f"coasting_plan: speed = {speed:g} m/s: the car stands before the end; enter faster.")
    v = np.sqrt(square)
    time = np.concatenate([[0.0], np.cumsum(np.diff(s) / (0.5 * (v[:-1] + v[1:])))])
    return SpeedPlan(s, v, time, float(time[-1]), False, Comfort())


# -- margins ----------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Clearance:
    """How near the body came to the limits and the cones; negative: beyond them."""

    margins: tuple[float, ...]
    """m, the least in each gate; -inf for one that was not driven through"""
    least: float
    """m, smallest clearance to a cone"""
    place: float
    """m, x of the centre of mass where it was"""

    @property
    def clean(self) -> bool:
        """Whether the body touched nothing."""
        return self.least >= 0.0


def clearance(track: Track, outline: Outline, x: ArrayLike, y: ArrayLike, yaw: ArrayLike) -> Clearance:
    """The margins of a driven line to the gates of a track.

    Two things count: the distance of the corners that are in a lane to its limits, and the signed distance of the cones
    at a lane's ends to the body, whose sides may touch them between the corners. Between the samples the car goes
    straight; places every 5 cm are looked at.

    Parameters
    ----------
    x, y, yaw : (n,) array
        m, m, rad (continuous), of the centre of mass in the track's axes, in the order driven.

    Raises
    ------
    InvalidInput
        When shapes differ, or there are fewer than two places.
    """
    places = [np.asarray(values, dtype=np.float64) for values in (x, y, yaw)]
    if places[0].ndim != 1 or places[0].size < 2 or any(values.shape != places[0].shape for values in places):
        raise InvalidInput(
            f"clearance: x, y, yaw have the shapes {[values.shape for values in places]}: must be (n,), n >= 2."
        )
    finite = np.isfinite(np.stack(places)).all(axis=0)
    count = int(np.argmin(finite)) if not finite.all() else finite.size
    if count < 2:
        return Clearance((-math.inf,) * len(track.gates), -math.inf, math.nan)
    cx, cy, turn = _finely(*(values[:count] for values in places))
    corners = outline.corners_at(cx, cy, turn)
    least = [_gate_margin(gate, outline, (cx, cy, turn), corners) for gate in track.gates]
    worst = int(np.argmin([margin for margin, _ in least]))
    return Clearance(tuple(margin for margin, _ in least), *least[worst])


def _finely(x: Array, y: Array, yaw: Array) -> tuple[Array, Array, Array]:
    """The line with places every `MARGIN_SPACING`."""
    gone = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(x), np.diff(y)))])
    even = np.linspace(0.0, gone[-1], max(2, math.ceil(gone[-1] / MARGIN_SPACING) + 1))
    return np.interp(even, gone, x), np.interp(even, gone, y), np.interp(even, gone, yaw)


def _gate_margin(
    gate: Gate, outline: Outline, places: tuple[Array, Array, Array], corners: Array
) -> tuple[float, float]:
    """The least margin (m) in a gate and the x (m) of the centre of mass there."""
    cx, cy, turn = places
    if (
        corners[0, :, 0].min() > gate.start
        or corners[-1, :, 0].max() < gate.start
        or corners[:, 2:, 0].max() < gate.end
    ):
        return -math.inf, float(cx[-1])  # not driven through, from one end to the other
    inside = (corners[..., 0] >= gate.start) & (corners[..., 0] <= gate.end)
    room = np.minimum(gate.left - corners[..., 1], corners[..., 1] - gate.right)
    margin = np.where(inside, room, np.inf).min(axis=1)
    for cone_x in (gate.start, gate.end):
        for cone_y in (gate.right, gate.left):
            margin = np.minimum(margin, _distance_to_outline(outline, cone_x - cx, cone_y - cy, turn))
    k = int(np.argmin(margin))
    return float(margin[k]), float(cx[k])


def _distance_to_outline(outline: Outline, dx: Array, dy: Array, yaw: Array) -> Array:
    """Signed distance (m) of points, given from the centre of mass, to the rectangle of the body; negative inside."""
    ahead = dx * np.cos(yaw) + dy * np.sin(yaw) - 0.5 * (outline.front - outline.rear)
    left = dy * np.cos(yaw) - dx * np.sin(yaw)
    beyond = np.abs(ahead) - 0.5 * outline.length, np.abs(left) - 0.5 * outline.width
    return np.hypot(*(np.maximum(excess, 0.0) for excess in beyond)) + np.minimum(np.maximum(*beyond), 0.0)


# -- the highest clean speed ------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class CleanSpeed:
    """The result of the search."""

    speed: float
    """m/s, clean, as all lower ones of the grid are; NaN when not even its lowest is clean"""
    failing: float
    """m/s, the lowest speed of the grid that was not clean; NaN when all are"""
    highest: float
    """m/s, the highest clean speed of the grid, above `failing` by luck; NaN when none is clean"""
    clearances: dict[float, Clearance]
    """by entry speed (m/s)"""


def scan_speeds(judge: Callable[[float], Clearance], speeds: Sequence[float]) -> CleanSpeed:
    """Drive a grid of entry speeds (m/s), increasing, from its lowest up: a faster drive may be clean where one is not.

    It ends when `BEYOND_FAILING` speeds one after the other were not clean.

    Raises
    ------
    InvalidInput
        When the speeds do not increase from above 0.
    """
    grid = [float(speed) for speed in speeds]
    if not grid or grid[0] <= 0.0 or any(b <= a for a, b in pairwise(grid)):
        raise InvalidInput(f"entry speeds = {speeds!r}: must increase from above 0 m/s.")
    clearances: dict[float, Clearance] = {}
    row = 0
    for speed in grid:
        clearances[speed] = judge(speed)
        row = 0 if clearances[speed].clean else row + 1
        if row >= BEYOND_FAILING:
            break
    clean = [speed for speed, margin in clearances.items() if margin.clean]
    failing = min((speed for speed, margin in clearances.items() if not margin.clean), default=math.nan)
    below = [speed for speed in clean if not speed > failing]
    return CleanSpeed(max(below, default=math.nan), failing, max(clean, default=math.nan), clearances)

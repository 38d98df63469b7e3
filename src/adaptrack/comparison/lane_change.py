"""Lane-change tracks of ISO 3888: gates of cones, a line through them, clearance to the cones, highest clean speed.

The tracks run along x and swerve to the left. The first cones stand at x = 0, and the first lane is centred on y = 0.
The authors could read only scope and general text of ISO 3888-1:2018 and ISO 3888-2:2011, not the tables. Lengths and
widths are therefore those on which open programs (Project Chrono and others) agree. They differ in two values:

* Offset of 3.5 m in part 1: here between the right edges of lanes 1 and 3; in Chrono from the middle of lane 1 to the
  right edge of lane 3, which is half a lane width more.
* Width of the last lane in part 2: here 1.3 b + 0.25 m, but at least 3 m; in Chrono 3 m.

The right edges of the first and the last lane are in line. A run is clean if the body touches no cone and stays within
the lanes. The car coasts from the first cones on.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field
from scipy.optimize import linprog
from scipy.sparse import csr_array, diags_array, eye_array, hstack, vstack

from adaptrack.base.checked import Bound, Positive, checked
from adaptrack.base.errors import InvalidInput
from adaptrack.base.limits import MAX_SPEED
from adaptrack.cars.outline import Outline
from adaptrack.cars.vehicle import Vehicle
from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import Array
from adaptrack.core.physics.forces import GRAVITY
from adaptrack.drive.metrics import LANE_WIDTH
from adaptrack.road import Comfort, Road, SpeedPlan, fit_road

Pass = tuple[int, float, "Gate"]
CarWidth = Annotated[Positive, Field(le=4.0), "m"]
Speed = Annotated[Positive, MAX_SPEED, "m/s"]

APPROACH, RUN_OUT = 60.0, 60.0
"""Lengths of straight road before the first cones and after the last cones (m)."""
LINE_SPACING = 0.5
"""Distance between the points of the line through the gates (m)."""
SHARPNESS_LENGTH = 4.0
"""Weight of max |y'''| relative to max |y''| in the objective of the line (m)."""
BEND_WEIGHT = 0.002
"""Weight of the integral of |y''| relative to max |y''| in the objective (1/m). It prevents needless weaving."""
CONE_ROOM = 0.1
"""Default distance between body and cones (m)."""
GRIP_USE = 0.9
"""Curvature bound of a line at speed v divided by mu g/v^2.

In tests with four cars, the cars cannot follow lines with a larger bound. A smaller bound brings the line needlessly
close to the cones.
"""
MOST_ROOM = 0.15
"""Largest distance between body and cones of a line with a curvature bound (m)."""
LEAST_ROOM = 0.07
"""Smallest distance between body and cones (m). The curvature bound is exceeded where necessary to keep it."""
ROOM_WEIGHT, EXCESS_WEIGHT = 1.0, 1e3
"""Weights in the objective of the distance to the cones (1/m^2), and of curvature above the bound (1)."""
BEYOND_FAILING = 8
"""Number of consecutive speeds that are not clean after which `scan_speeds` ends."""
MARGIN_SPACING = 0.05
"""Distance between the positions at which clearances are computed (m)."""


@dataclass(frozen=True)
class Gate:
    """One lane between cones."""

    start: float
    """x at which the lane begins (m)."""
    end: float
    """x at which the lane ends (m)."""
    right: float
    """y of the right limit of the lane (m), which the cones touch from outside."""
    left: float
    """y of the left limit of the lane (m), which the cones touch from outside."""

    @property
    def width(self) -> float:
        """The width between the cones (m)."""
        return self.left - self.right

    @property
    def middle(self) -> float:
        """The y of the centre of the lane (m)."""
        return 0.5 * (self.left + self.right)


@dataclass(frozen=True)
class Track:
    """A sequence of gates."""

    name: str
    gates: tuple[Gate, ...]

    @property
    def length(self) -> float:
        """The length from the first to the last cones (m)."""
        return self.gates[-1].end - self.gates[0].start

    @property
    def cones(self) -> Array:
        """The points x, y (m) at which cones touch the limits at the ends of every lane, (4 x gates, 2)."""
        return np.array(
            [(x, y) for gate in self.gates for x in (gate.start, gate.end) for y in (gate.right, gate.left)]
        )


@checked
def iso_3888_1(width: CarWidth) -> Track:
    """Return the double lane change of ISO 3888-1, 125 m long, for a car of width b (m).

    The lanes are 15, 25 and 30 m long and 1.1 b + 0.25, 1.2 b + 0.25 and 1.3 b + 0.25 m wide. The gaps between them are
    30 and 25 m long.
    """
    first, middle, last = (factor * width + 0.25 for factor in (1.1, 1.2, 1.3))
    right, second = -0.5 * first, -0.5 * first + 3.5
    lanes = (0.0, 15.0, right, first), (45.0, 70.0, second, middle), (95.0, 125.0, right, last)
    return Track("iso-3888-1", tuple(Gate(start, end, edge, edge + width) for start, end, edge, width in lanes))


@checked
def iso_3888_2(width: CarWidth) -> Track:
    """Return the obstacle avoidance of ISO 3888-2, 61 m long, for a car of width b (m).

    The lanes are 12, 11 and 12 m long and 1.1 b + 0.25, b + 1 and 1.3 b + 0.25 (at least 3) m wide. The gaps between
    them are 13.5 and 12.5 m long. The right limit of the second lane is 1 m to the left of the left limit of the first.
    """
    first, middle, last = 1.1 * width + 0.25, width + 1.0, max(1.3 * width + 0.25, 3.0)
    right, second = -0.5 * first, 0.5 * first + 1.0
    lanes = (0.0, 12.0, right, first), (25.5, 36.5, second, middle), (49.0, 61.0, right, last)
    return Track("iso-3888-2", tuple(Gate(start, end, edge, edge + width) for start, end, edge, width in lanes))


# -- the line through the gates ---------------------------------------------------------------------------------------
@checked
def track_road(
    track: Track, outline: Outline, room: float = CONE_ROOM, *, bend: Annotated[Bound, "1/m"] = math.inf,
    sideslip: float = 0.0,
) -> Road:  # fmt: skip
    """Return a road along which the body of a car passes all gates of a track.

    A line through the centres of the lanes would have bends that no car can drive at speed, so the line uses the width
    of the lanes. The line y(x) minimises max |y''| + 4 m max |y'''| and, with a small weight, the integral of |y''|.
    Its constraints are the distances of the corners to the lane limits, and of the sides to the cones. For small angles
    this is a linear programme.

    The line is straight until the centre of mass passes the first cones, and in its last 10 m. The road starts
    `APPROACH` before the first cones. It is as wide as the gates, and between them wider by 3.5 m on both sides.

    Parameters
    ----------
    track
        Gates of the track.
    outline
        Outline of the body.
    room
        Distance between body and cones (m). With a finite `bend` it is the largest one.
    bend
        Upper bound on max |y''| + 4 m max |y'''| (1/m). The distance to the cones is as large as the bound allows. If
        it would be less than `LEAST_ROOM`, the line exceeds the bound by as little as possible to keep `LEAST_ROOM`. An
        infinite value means no bound.
    sideslip
        Sideslip angle of the body divided by the curvature of the line (m).

    Raises
    ------
    InvalidInput
        When the body does not fit between the cones at this distance.
    """
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


@checked
def driven_line(track: Track, car: Vehicle, speed: Speed, friction: float = 0.9) -> Road:
    """Return `track_road` for a car at a speed: as far from the cones as its grip allows.

    The curvature bound is `GRIP_USE` mu g/v^2 with the speed v (m/s) and the friction coefficient mu. The sideslip
    angle is that of a steady turn with linear tyres, (l_r - m l_f v^2/(2 C_r L)) times the curvature (Rajamani,
    *Vehicle Dynamics and Control*, 2nd ed., section 3.2).

    Raises
    ------
    InvalidInput
        When the body does not fit between the cones.
    """
    slip = car.lr - car.mass * car.lf * (speed * speed) / (2.0 * car.stiffness_rear * car.wheelbase)
    return track_road(
        track, car.outline, MOST_ROOM, bend=GRIP_USE * friction * GRAVITY / (speed * speed), sideslip=slip
    )


def _bends(n: int) -> csr_array:
    """Return A of the constraints A u <= 0 on the derivatives of the line.

    The unknowns u are [y (n), |y''| (n), max |y''|, max |y'''|, room, excess].
    """
    second = diags_array([1.0, -2.0, 1.0], offsets=[0, 1, 2], shape=(n - 2, n)) / portable.square(LINE_SPACING)
    third = diags_array([-1.0, 3.0, -3.0, 1.0], offsets=[0, 1, 2, 3], shape=(n - 3, n)) / portable.power(
        LINE_SPACING, 3
    )
    size, none = eye_array(n - 2, n), csr_array((n - 3, n))
    largest, change = np.zeros((n - 2, 4)), np.zeros((n - 3, 4))
    largest[:, 0], change[:, 1] = -1.0, -1.0
    free = csr_array((n - 2, 4))
    rows = [hstack([sign * second, -size, free]) for sign in (1.0, -1.0)]
    rows += [hstack([sign * third, none, change]) for sign in (1.0, -1.0)]
    return csr_array(vstack([*rows, hstack([csr_array((n - 2, n)), size, largest])]))


def _cone_limits(passes: Sequence[Pass], outline: Outline, n: int, sideslip: float) -> tuple[csr_array, Array]:
    """Return A and b of the constraints A u <= b that keep the body between the cones, with u as in `_bends`."""
    rows, limits = np.zeros((2 * len(passes), 2 * n + 4)), np.empty(2 * len(passes))
    for row, (index, ahead, gate) in enumerate(passes):
        lean = ahead * sideslip / (LINE_SPACING * LINE_SPACING)
        axis = (
            -0.5 * ahead / LINE_SPACING - lean,
            1.0 + 2.0 * lean,
            0.5 * ahead / LINE_SPACING - lean,
        )  # y + ahead (y' - sideslip y'')
        for sign, side, i in ((1.0, gate.left, 2 * row), (-1.0, -gate.right, 2 * row + 1)):
            rows[i, index - 1 : index + 2] = sign * np.array(axis)
            rows[i, 2 * n + 2] = 1.0
            limits[i] = side - 0.5 * outline.width
    return csr_array(rows), limits


def _passes(track: Track, outline: Outline, x: Array) -> list[Pass]:
    """Return the points of the body's longitudinal axis that must lie within a gate.

    Each is (index of the grid point of the centre of mass, distance ahead of it (m), gate). They are both ends of the
    body while it is in a lane, and the points that pass the cones at the ends of the lane.
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
    """Return left and right width along the road (m): up to the cones in the gates, 3.5 m more between the gates."""
    s = np.linspace(0.0, road.length, math.ceil(road.length / LINE_SPACING) + 1)
    line = road.at(s)
    widths: dict[str, tuple[list[float], list[float]]] = {}
    for name, sign, edge in (("width_left", 1.0, "left"), ("width_right", -1.0, "right")):
        stations, values = [], []
        for gate in track.gates:
            start, end = np.interp([gate.start, gate.end], line.x, s)
            inside = np.concatenate([[start], s[(s > start + 0.01) & (s < end - 0.01)], [end]])
            width = np.maximum(sign * (getattr(gate, edge) - np.interp(inside, s, line.y)), 0.1)
            stations += [start - 0.01, *inside.tolist(), end + 0.01]
            values += [width[0] + LANE_WIDTH, *width.tolist(), width[-1] + LANE_WIDTH]
        widths[name] = ([*map(float, stations)], [*map(float, values)])
    return widths


@checked
def coasting_plan(track: Track, road: Road, car: Vehicle, speed: Speed) -> SpeedPlan:
    """Return the speed along a track's road: constant up to the first cones, then coasting.

    The car enters with a speed (m/s) and loses it by drag and rolling resistance, m v dv/ds = -(rho A c_d v^2/2 + f m
    g). The cornering resistance of the tyres is neglected. road: that of `track_road`. Raises InvalidInput when the car
    stops before the end of the road.
    """
    s = np.linspace(0.0, road.length, math.ceil(road.length / LINE_SPACING) + 1)
    entry = float(np.interp(track.gates[0].start, road.at(s).x, s))
    drag = 0.5 * car.air_density * car.frontal_area * car.drag_coefficient / car.mass
    rolling = car.rolling_resistance * GRAVITY
    coasted = np.maximum(s - entry, 0.0)
    if drag > 0.0:
        exponent = -2.0 * drag * coasted
        square = speed * speed * portable.exp(exponent) + rolling / drag * portable.expm1(exponent)
    else:
        square = speed * speed - 2.0 * rolling * coasted
    if square.min() <= 0.0:
        raise InvalidInput(f"coasting_plan: speed = {speed:g} m/s: the car stops before the end; enter faster.")
    v = np.sqrt(square)
    time = np.concatenate([[0.0], np.cumsum(np.diff(s) / (0.5 * (v[:-1] + v[1:])))])
    return SpeedPlan(s, v, time, float(time[-1]), False, Comfort())


# -- clearance --------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Clearance:
    """Smallest distances of the body to lane limits and cones; negative if the body crosses them."""

    margins: tuple[float, ...]
    """Smallest distance in each gate (m); -inf if the car did not drive through the gate."""
    least: float
    """Smallest distance in all gates (m)."""
    place: float
    """x of the centre of mass at the smallest distance (m)."""

    @property
    def clean(self) -> bool:
        """Whether the body touched no cone and no limit."""
        return self.least >= 0.0


def clearance(track: Track, outline: Outline, x: ArrayLike, y: ArrayLike, yaw: ArrayLike) -> Clearance:
    """Return the clearance of a driven line in the gates of a track.

    The clearance is the smaller one of two distances:

    - from the corners that are in a lane to its limits;
    - from the body to the cones at the ends of the lanes, which its sides may touch between the corners.

    The line is interpolated linearly every `MARGIN_SPACING`.

    Parameters
    ----------
    track
        Gates of the track.
    outline
        Outline of the body.
    x, y, yaw
        Poses of the centre of mass in the axes of the track (m, m, rad), in driving order, each (n,). The yaw angle is
        continuous.

    Raises
    ------
    InvalidInput
        For different shapes, or fewer than two poses.
    """
    poses = [np.asarray(values, dtype=np.float64) for values in (x, y, yaw)]
    if poses[0].ndim != 1 or poses[0].size < 2 or any(values.shape != poses[0].shape for values in poses):
        raise InvalidInput(
            f"clearance: x, y, yaw have the shapes {[values.shape for values in poses]}: must be (n,), n >= 2."
        )
    finite = np.isfinite(np.stack(poses)).all(axis=0)
    count = int(np.argmin(finite)) if not finite.all() else finite.size
    if count < 2:
        return Clearance((-math.inf,) * len(track.gates), -math.inf, math.nan)
    cx, cy, turn = _resampled_poses(*(values[:count] for values in poses))
    corners = outline.corners_at(cx, cy, turn)
    least = [_gate_margin(gate, outline, (cx, cy, turn), corners) for gate in track.gates]
    worst = int(np.argmin([margin for margin, _ in least]))
    return Clearance(tuple(margin for margin, _ in least), *least[worst])


def _resampled_poses(x: Array, y: Array, yaw: Array) -> tuple[Array, Array, Array]:
    """Return the poses at equal distances of about `MARGIN_SPACING` along the line."""
    distance = np.concatenate([[0.0], np.cumsum(portable.hypot(np.diff(x), np.diff(y)))])
    even = np.linspace(0.0, distance[-1], max(2, math.ceil(distance[-1] / MARGIN_SPACING) + 1))
    return np.interp(even, distance, x), np.interp(even, distance, y), np.interp(even, distance, yaw)


def _gate_margin(
    gate: Gate, outline: Outline, poses: tuple[Array, Array, Array], corners: Array
) -> tuple[float, float]:
    """Return the smallest distance in a gate (m) and the x of the centre of mass there (m)."""
    cx, cy, turn = poses
    if (
        corners[0, :, 0].min() > gate.start
        or corners[-1, :, 0].max() < gate.start
        or corners[:, 2:, 0].max() < gate.end
    ):
        return -math.inf, float(cx[-1])  # the car did not pass the whole gate
    inside = (corners[..., 0] >= gate.start) & (corners[..., 0] <= gate.end)
    room = np.minimum(gate.left - corners[..., 1], corners[..., 1] - gate.right)
    margin = np.where(inside, room, np.inf).min(axis=1)
    for cone_x in (gate.start, gate.end):
        for cone_y in (gate.right, gate.left):
            margin = np.minimum(margin, _distance_to_outline(outline, cone_x - cx, cone_y - cy, turn))
    k = int(np.argmin(margin))
    return float(margin[k]), float(cx[k])


def _distance_to_outline(outline: Outline, dx: Array, dy: Array, yaw: Array) -> Array:
    """Return the distance from the body's rectangle to points dx, dy relative to the centre of mass (m), < 0 inside."""
    ahead = dx * portable.cos(yaw) + dy * portable.sin(yaw) - 0.5 * (outline.front - outline.rear)
    left = dy * portable.cos(yaw) - dx * portable.sin(yaw)
    beyond = np.abs(ahead) - 0.5 * outline.length, np.abs(left) - 0.5 * outline.width
    return portable.hypot(*(np.maximum(excess, 0.0) for excess in beyond)) + np.minimum(np.maximum(*beyond), 0.0)


# -- the highest clean speed ------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class CleanSpeed:
    """Result of `scan_speeds`; speeds in m/s."""

    speed: float
    """Highest speed up to which all speeds of the grid are clean; NaN if the lowest is not clean."""
    failing: float
    """Lowest speed of the grid that is not clean; NaN if all are clean."""
    highest: float
    """Highest clean speed of the grid, which may lie above `failing`; NaN if none is clean."""
    clearances: dict[float, Clearance]
    """Clearance by entry speed."""


def scan_speeds(judge: Callable[[float], Clearance], speeds: Sequence[float]) -> CleanSpeed:
    """Drive at increasing entry speeds and return the clean ones.

    The scan goes on after a speed that is not clean, since a higher one may be clean. It ends after `BEYOND_FAILING`
    consecutive speeds that are not clean.

    Parameters
    ----------
    judge
        Function that drives at an entry speed (m/s) and returns the clearance.
    speeds
        Entry speeds (m/s), positive and increasing.

    Raises
    ------
    InvalidInput
        Unless the speeds are positive and increasing.
    """
    grid = [float(speed) for speed in speeds]
    if not grid or grid[0] <= 0.0 or any(b <= a for a, b in pairwise(grid)):
        raise InvalidInput(f"entry speeds = {speeds!r}: must increase from above 0 m/s.")
    clearances: dict[float, Clearance] = {}
    consecutive = 0
    for speed in grid:
        clearances[speed] = judge(speed)
        consecutive = 0 if clearances[speed].clean else consecutive + 1
        if consecutive >= BEYOND_FAILING:
            break
    clean = [speed for speed, margin in clearances.items() if margin.clean]
    failing = min((speed for speed, margin in clearances.items() if not margin.clean), default=math.nan)
    below = [speed for speed in clean if not speed > failing]
    return CleanSpeed(max(below, default=math.nan), failing, max(clean, default=math.nan), clearances)

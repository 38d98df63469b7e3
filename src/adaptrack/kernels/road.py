"""The foot of a point on the centre line of a road, and the road's point, heading and curvature at an arc length.

A centre line is a row of pieces; on each, position and heading are polynomials of u = (s - middle)/half, in a frame at
its middle. With t(s) the tangent, the foot of p is a zero of

    g(s) = (c(s) - p) . t(s),   g'(s) = 1 - kappa(s) e(s),   e = (p - c) . n,

with g' > 0: a local minimum of the distance. Newton's method within a bracket finds it: where g jumps (a kink that
rounding left) the bracket closes on the kink.
"""

from __future__ import annotations

import math

from numba import types

from .abi import INLINE, ROUTINE, float64, int_vector, matrix, njit, record, vector

Centreline = record("Centreline", ("start", "pieces", "numbers"))
"""start: (n + 1,) m, where each piece begins, and the end; pieces: (n, columns), see the places below;
numbers: length (m), whether closed (1 or 0), growth of the heading in a lap (rad)."""
CENTRELINE = types.NamedTuple((vector, matrix, vector), Centreline)

RoadAhead = record("RoadAhead", ("line", "station", "speeds"))
ROAD_AHEAD = types.NamedTuple((CENTRELINE, float64, vector), RoadAhead)
"""A centre line, the arc length (m) of the car's foot on it, and the speeds (m/s) that are planned for the control
instants from now on, the last one holding; a straight road has no pieces and no planned speeds."""

Roads = record("Roads", ("of", "numbers", "start", "pieces", "headings"))
ROADS = types.NamedTuple((int_vector, matrix, vector, matrix, vector), Roads)
"""Several centre lines behind each other: which of them each scenario has, -1 for a straight road (scenarios,); of
each, `NUMBERS` (roads, .); start and pieces as in `Centreline`; the heading (rad) every spacing (m), from 0 to the
length."""
NUMBERS = ("length", "closed", "lap_turn", "first_start", "first_piece", "count", "first_heading", "spacing")
_START, _PIECE, _COUNT, _HEADING, _SPACING = range(3, 8)

DEGREE = 11
HALF, X, Y, COS, SIN, HEADING, ALONG = range(7)
ACROSS = ALONG + DEGREE + 1
TURNED = ACROSS + DEGREE + 1
LENGTH, CLOSED, LAP_TURN = range(3)

STRIDE = 1.0
"""m, the longest step of a search: a bend of this radius is not stepped over."""
STEPS = 400
"""Steps of a search, so that it goes at most so many metres."""
CLOSE, ROUNDING = 1e-13, 2.0**-51
"""Tolerance of the foot: m, and as a share of the coordinates."""


@njit(**INLINE)
def piece_below(s, start):
    """The last piece that begins at or before s, 0 <= s <= length."""
    low, high = 0, start.size - 1
    while high - low > 1:
        middle = (low + high) // 2
        if start[middle] <= s:
            low = middle
        else:
            high = middle
    return low


@njit(**INLINE)
def point_of(u, row, pieces):
    """x, y (m), heading (rad) and curvature (1/m) of a piece at u."""
    along, across = pieces[row, ALONG + DEGREE], pieces[row, ACROSS + DEGREE]
    turned, slope = pieces[row, TURNED + DEGREE], 0.0
    for k in range(DEGREE - 1, -1, -1):
        along = along * u + pieces[row, ALONG + k]
        across = across * u + pieces[row, ACROSS + k]
        slope = slope * u + turned
        turned = turned * u + pieces[row, TURNED + k]
    cos, sin = pieces[row, COS], pieces[row, SIN]
    return (
        pieces[row, X] + cos * along - sin * across,
        pieces[row, Y] + sin * along + cos * across,
        pieces[row, HEADING] + turned,
        slope / pieces[row, HALF],
    )


@njit(**INLINE)
def point_at(s, road):
    """x, y (m), heading (rad) and curvature (1/m) at any arc length: lap after lap, or straight on beyond the ends."""
    length = road.numbers[LENGTH]
    laps = math.floor(s / length) if road.numbers[CLOSED] > 0.5 else 0.0
    inside = s - laps * length
    inside = min(max(inside, 0.0), length)
    row = piece_below(inside, road.start)
    u = (inside - road.start[row]) / road.pieces[row, HALF] - 1.0
    x, y, heading, curvature = point_of(u, row, road.pieces)
    beyond = s - laps * length - inside
    if beyond != 0.0:
        x, y, curvature = x + beyond * math.cos(heading), y + beyond * math.sin(heading), 0.0
    return x, y, heading + laps * road.numbers[LAP_TURN], curvature


@njit(**INLINE)
def foot_near(x, y, near, road):
    """Arc length, offset, heading and curvature of the first foot downhill in distance from the arc length `near`.

    The offset is NaN when there is none within the steps of a search.
    """
    s, low, high, reached = near, -math.inf, math.inf, False
    offset = heading = curvature = 0.0
    for _ in range(STEPS):
        px, py, heading, curvature = point_at(s, road)
        cos, sin = math.cos(heading), math.sin(heading)
        ahead = (px - x) * cos + (py - y) * sin
        offset = (y - py) * cos - (x - px) * sin
        if ahead > 0.0:
            high = s
        else:
            low = s
        tolerance = CLOSE + ROUNDING * (abs(s) + abs(x) + abs(y))
        if abs(ahead) <= tolerance or high - low <= tolerance:
            reached = True
            break
        slope = 1.0 - curvature * offset
        step = -ahead / slope if slope > 0.1 else -ahead
        target = s + min(max(step, -STRIDE), STRIDE)
        if target <= low or target >= high:
            target = 0.5 * (low + high)
        if target == s:
            reached = True
            break
        s = target
    return s, offset if reached else math.nan, heading, curvature


@njit(**INLINE)
def samples_of(row, pieces):
    """How many samples a piece has that are at most a stride apart."""
    return int(2.0 * pieces[row, HALF] / STRIDE) + 2


@njit(**INLINE)
def sample_of(k, count, row, road):
    """Arc length and point of a sample of a piece."""
    u = 2.0 * k / (count - 1.0) - 1.0
    px, py, _, _ = point_of(u, row, road.pieces)
    return road.start[row] + (u + 1.0) * road.pieces[row, HALF], px, py


@njit(**INLINE)
def nearest(x, y, road):
    """The arc length of the nearest foot on the whole road: a start for `foot_near`.

    The nearest point lies within half a stride of a sample, so only samples at most half a stride farther than the
    nearest one can lead to it.
    """
    length, closed = road.numbers[LENGTH], road.numbers[CLOSED] > 0.5
    least = math.inf
    for row in range(road.start.size - 1):
        count = samples_of(row, road.pieces)
        for k in range(count):
            _, px, py = sample_of(k, count, row, road)
            least = min(least, math.hypot(px - x, py - y))
    found, best = 0.0, math.inf
    for row in range(road.start.size - 1):
        count = samples_of(row, road.pieces)
        for k in range(count):
            s, px, py = sample_of(k, count, row, road)
            if math.hypot(px - x, py - y) > least + 0.5 * STRIDE:
                continue
            foot, _, _, _ = foot_near(x, y, s, road)
            if not closed:
                inside = min(max(foot, 0.0), length)
            else:
                inside = foot
            px, py, _, _ = point_at(inside, road)
            distance = math.hypot(px - x, py - y)
            if distance < best:
                found, best = foot, distance
    return found - math.floor(found / length) * length if closed else found


@njit(types.void(CENTRELINE, matrix, matrix), **ROUTINE)
def project_all(road, points, feet):
    """Write s, offset, heading and curvature of the foot of each row x, y, near of `points` to the rows of `feet`.

    near is NaN: the nearest foot of the whole road, see `nearest`.
    """
    for i in range(points.shape[0]):
        x, y, near = points[i, 0], points[i, 1], points[i, 2]
        if math.isnan(near):
            near = nearest(x, y, road)
        feet[i, 0], feet[i, 1], feet[i, 2], feet[i, 3] = foot_near(x, y, near, road)


@njit(types.void(CENTRELINE, vector, matrix), **ROUTINE)
def points_at(road, s, points):
    """Write x, y, heading and curvature at each arc length of `s` to the rows of `points`."""
    for i in range(s.size):
        points[i, 0], points[i, 1], points[i, 2], points[i, 3] = point_at(s[i], road)


# -- several roads, and what lies ahead -------------------------------------------------------------------------------
@njit(**INLINE)
def line_of(road, roads):
    """The centre line of one of several roads; without pieces for road -1."""
    if road < 0:
        return Centreline(roads.start[:0], roads.pieces[:0], roads.headings[:0])
    numbers = roads.numbers[road]
    first, piece, count = int(numbers[_START]), int(numbers[_PIECE]), int(numbers[_COUNT])
    return Centreline(roads.start[first : first + count + 1], roads.pieces[piece : piece + count], numbers)


@njit(**INLINE)
def heading_at(s, road, roads):
    """Heading (rad) at any arc length, a straight line between the entries of the table."""
    numbers = roads.numbers[road]
    length, spacing = numbers[LENGTH], numbers[_SPACING]
    laps = math.floor(s / length) if numbers[CLOSED] > 0.5 else 0.0
    place = min(max(s - laps * length, 0.0), length) / spacing
    cell = min(int(place), int(length / spacing + 0.5) - 1)
    first = int(numbers[_HEADING]) + cell
    near = roads.headings[first]
    return near + (place - cell) * (roads.headings[first + 1] - near) + laps * numbers[LAP_TURN]


@njit(**INLINE)
def bend_ahead(station, speeds, pace, lead, period, road, roads, bend):
    """Write how far (m) the road ahead lies to the left of its tangent here: at the time lead T, then every period T.

        dY/dt = v theta,   theta: heading of the road where the car will be, less its heading here

    A model whose heading and offset count from the path obeys the same equations as one in the frame of this tangent,
    in which the path is Y(t). The road is passed at the speeds (m/s) planned for the instants from now on, the last one
    holding, all shifted so that the first is `pace`: v (m/s) of the model.
    """
    here = heading_at(station, road, roads)
    last = speeds.size - 1
    excess = pace - speeds[0]
    whole = int(lead)
    y = before = time = 0.0
    s = station
    for j in range(whole + bend.size):
        step = period if j > 0 else (lead - whole) * period
        at = min(max(int(time / period), 0), last)
        s += max(speeds[at] + excess, 0.0) * step
        time += step
        after = heading_at(s, road, roads) - here
        y += 0.5 * pace * step * (before + after)
        before = after
        if j >= whole:
            bend[j - whole] = y


@njit(types.void(float64, vector, float64, float64, float64, types.int64, ROADS, vector), **ROUTINE)
def bend_of(station, speeds, pace, lead, period, road, roads, bend):
    """`bend_ahead`, for Python."""
    bend_ahead(station, speeds, pace, lead, period, road, roads, bend)

"""The foot of a point on the centre line of a road, and the road's point, heading and curvature at an arc length.

A centre line is a row of pieces; on each, position and heading are polynomials of u = (s - middle)/half, in a frame at
its middle. With t(s) the tangent, the foot of p is a zero of

    g(s) = (c(s) - p) . t(s),   g'(s) = 1 - kappa(s) e(s),   e = (p - c) . n,

with g' > 0: a local minimum of the distance. Newton's method within a bracket finds it: where g jumps (a kink that
rounding left) the bracket closes on the kink. A point beyond the centre of a bend has several feet there. Of these, and
of those on other branches, it is the nearest in arc length to where the foot was last.
"""

from __future__ import annotations

import math

from ..kernel import Place, exported, float64, inlined, int64, int_vector, matrix, record, several, vector, void
from ..maths.bits import whole
from ..maths.exact import ceil, floor
from ..maths.exponential import hypot
from ..maths.trigonometric import cos, sin

Centreline = record("Centreline", (("start", vector), ("pieces", matrix), ("numbers", vector)))
"""start: (n + 1,) m, where each piece begins, and the end; pieces: (n, columns), see the places below;
numbers: length (m), whether closed (1 or 0), growth of the heading in a lap (rad), bound of the curvature (1/m)."""

RoadAheadRecord = record("RoadAheadRecord", (("line", Centreline), ("station", float64), ("speeds", vector)))
"""A centre line, the arc length (m) of the car's foot on it, and the speeds (m/s) that are planned for the control
instants from now on, the last one holding; a straight road has no pieces and no planned speeds."""

LINE_NUMBERS = (
    "length", "closed", "lap_turn", "most_curvature", "first_start", "first_piece", "count", "first_heading", "spacing",
)  # fmt: skip
(
    LENGTH, CLOSED, LAP_TURN, MOST_CURVATURE, FIRST_START, FIRST_PIECE, COUNT, FIRST_HEADING, HEADING_SPACING,
) = range(len(LINE_NUMBERS))  # fmt: skip

POLYNOMIAL_DEGREE = 11
HALF_LENGTH, X, Y, COS, SIN, HEADING, ALONG_COEFFICIENTS = range(7)
ACROSS_COEFFICIENTS = ALONG_COEFFICIENTS + POLYNOMIAL_DEGREE + 1
TURN_COEFFICIENTS = ACROSS_COEFFICIENTS + POLYNOMIAL_DEGREE + 1
PIECE_COLUMNS = TURN_COEFFICIENTS + POLYNOMIAL_DEGREE + 1
"""Columns of a piece: half its length (m), the point, direction and heading at its middle; then the coefficients of
1, u, u^2, ... along and across that direction (m), and of the heading less that at the middle (rad)."""
Roads = record(
    "Roads",
    (
        ("of", int_vector, "scenarios"),  # which centre line each scenario has, -1 for a straight road
        ("numbers", matrix, "roads", len(LINE_NUMBERS)),
        ("start", vector, "starts"), ("pieces", matrix, "pieces", PIECE_COLUMNS),  # as in `Centreline`
        ("headings", vector, "headings"),  # rad, every spacing (m) from 0 to the length
    ),
)  # fmt: skip
"""Several centre lines behind each other."""

STRIDE = 1.0
"""m, the longest step of a search: a bend of this radius is not stepped over."""
MAX_WALK_STEPS = 400
"""Steps of a walk downhill, so that it goes at most so many metres."""
REACH = 400.0
"""m of arc length, within which a foot is looked for."""
STRIDE_HALVINGS = 50
"""Of a stride, in the search for the turning point of g."""
FOOT_TOLERANCE, FOOT_ROUNDING = 1e-13, 2.0**-51
"""Tolerance of the foot: m, and as a share of the coordinates."""
PRESENT_INSTANT = 0
"""The present control instant among those from now on."""
FLAT_SLOPE, SAME_FOOT = 1e-9, 1e-9
"""A slope of g that is 0 but for rounding, as everywhere for the centre of a circle; m, and as a share of the way, the
difference of feet that are one."""


@inlined
def last_between(value, ascending, low, high):
    """The last place before `high` whose number is at or below a value; `low`, which is not looked at, without one."""
    while high - low > 1:
        middle = (low + high) // 2
        if ascending[middle] <= value:
            low = middle
        else:
            high = middle
    return low


@inlined
def piece_below(s, start):
    """The last piece that begins at or before s, 0 <= s <= length."""
    return last_between(s, start, 0, start.size - 1)


@inlined
def point_of(u, row, pieces):
    """x, y (m), heading (rad) and curvature (1/m) of a piece at u."""
    along, across = pieces[row, ACROSS_COEFFICIENTS - 1], pieces[row, TURN_COEFFICIENTS - 1]  # the last coefficients
    turned, slope = pieces[row, PIECE_COLUMNS - 1], 0.0
    for k in range(POLYNOMIAL_DEGREE - 1, -1, -1):
        along = along * u + pieces[row, ALONG_COEFFICIENTS + k]
        across = across * u + pieces[row, ACROSS_COEFFICIENTS + k]
        slope = slope * u + turned
        turned = turned * u + pieces[row, TURN_COEFFICIENTS + k]
    tx, ty = pieces[row, COS], pieces[row, SIN]
    return (
        pieces[row, X] + tx * along - ty * across,
        pieces[row, Y] + ty * along + tx * across,
        pieces[row, HEADING] + turned,
        slope / pieces[row, HALF_LENGTH],
    )


@inlined
def point_at(s, road):
    """x, y (m), heading (rad) and curvature (1/m) at any arc length: lap after lap, or straight on beyond the ends."""
    length = road.numbers[LENGTH]
    laps = floor(s / length) if road.numbers[CLOSED] > 0.5 else 0.0
    inside = s - laps * length
    inside = min(max(inside, 0.0), length)
    row = piece_below(inside, road.start)
    u = (inside - road.start[row]) / road.pieces[row, HALF_LENGTH] - 1.0
    x, y, heading, curvature = point_of(u, row, road.pieces)
    beyond = s - laps * length - inside
    if beyond != 0.0:
        x, y, curvature = x + beyond * cos(heading), y + beyond * sin(heading), 0.0
    return x, y, heading + laps * road.numbers[LAP_TURN], curvature


@inlined
def _relation(s, x, y, road):
    """How far (m) the road's point at s is ahead of a point, offset (m) of the point there, heading and curvature."""
    px, py, heading, curvature = point_at(s, road)
    tx, ty = cos(heading), sin(heading)
    return (px - x) * tx + (py - y) * ty, (y - py) * tx - (x - px) * ty, heading, curvature


@inlined
def downhill(x, y, near, low, high, road):
    """Arc length, offset, heading and curvature of the first foot downhill in distance from the arc length `near`.

    The foot is looked for between `low` and `high` (m, infinite where nothing is known). The offset is NaN when there
    is none within the steps of a search.
    """
    s, reached = near, False
    offset = heading = curvature = 0.0
    for _ in range(MAX_WALK_STEPS):
        ahead, offset, heading, curvature = _relation(s, x, y, road)
        if ahead > 0.0:
            high = s
        else:
            low = s
        tolerance = FOOT_TOLERANCE + FOOT_ROUNDING * (abs(s) + abs(x) + abs(y))
        if abs(ahead) <= tolerance or high - low <= tolerance:
            reached = True
            break
        slope = 1.0 - curvature * offset
        step = -ahead / slope if slope > 0.1 else -ahead
        target = s + min(max(step, -STRIDE), STRIDE)
        if target <= low or target >= high or (slope <= 0.1 and high - low < STRIDE):
            target = 0.5 * (low + high)
        if target == s or math.isinf(target):  # the step is below the rounding of s
            reached = True
            break
        s = target
    return s, offset if reached else math.nan, heading, curvature


Ahead = record("Ahead", ("g", "slope"))
"""g(s) (m) and its derivative."""


@inlined
def ahead_at(s, x, y, road):
    """How far (m) the road's point at s is ahead of a point, along its tangent."""
    ahead, offset, _, curvature = _relation(s, x, y, road)
    return Ahead(ahead, 1.0 - curvature * offset)


@inlined
def bracket(low, high, before, after, x, y, road):
    """Two arc lengths between which g grows through 0 within a stride, and whether there are any.

    before, after: `Ahead` at the ends of the stride. Where g has one sign at both ends but turns back
    between them, its turning point is looked for: beyond 0 it parts a foot from a place that is the farthest around.
    """
    if before.g <= 0.0 < after.g:
        return low, high, True
    hill = before.g <= 0.0 and after.g <= 0.0 and before.slope > 0.0 > after.slope
    valley = before.g > 0.0 and after.g > 0.0 and before.slope < 0.0 < after.slope
    first, last = low, high
    if hill or valley:
        for _ in range(STRIDE_HALVINGS):
            middle = 0.5 * (first + last)
            distance = ahead_at(middle, x, y, road)
            if hill and distance.g > 0.0:
                return low, middle, True
            if valley and distance.g <= 0.0:
                return middle, high, True
            if (distance.slope > 0.0) == hill:
                first = middle
            else:
                last = middle
    return low, high, False


@exported(several(float64, float64, float64, float64)(float64, float64, float64, float64, Centreline))
def foot_about(x, y, near, reach, road):
    """Arc length, offset, heading and curvature of the foot nearest to `near` in arc length, within `reach` (m).

    Strides to both sides are searched. The offset is NaN, and the arc length `near`, where there is no foot.
    """
    station, offset = near, math.nan
    _, _, heading, curvature = point_at(near, road)
    start = ahead_at(near, x, y, road)
    for side in (1.0, -1.0):
        s, distance = near, start
        for k in range(whole(ceil(reach / STRIDE))):
            end = near + side * min((k + 1) * STRIDE, reach)
            there = ahead_at(end, x, y, road)
            if side > 0.0:
                low, high, grows = bracket(s, end, distance, there, x, y, road)
            else:
                low, high, grows = bracket(end, s, there, distance, x, y, road)
            if grows:
                foot, aside, direction, bend = downhill(x, y, 0.5 * (low + high), low, high, road)
                if abs(foot - near) <= reach:
                    station, offset, heading, curvature = foot, aside, direction, bend
                    reach = abs(station - near)
                break
            s, distance = end, there
    return station, offset, heading, curvature


@inlined
def foot_near(x, y, near, road):
    """Arc length, offset, heading and curvature of the foot that is nearest in arc length to `near`, within `REACH`.

    Downhill from `near` lies a foot. It is the nearest one if g' > 0 as far to the other side, too, which holds where
    the point is nearer than the tightest bend's centre. Elsewhere strides to both sides are searched. The offset is
    NaN, and the arc length `near`, where there is no foot.
    """
    s, offset, heading, curvature = downhill(x, y, near, -math.inf, math.inf, road)
    gone = abs(s - near)
    if (abs(offset) + 2.0 * gone) * road.numbers[MOST_CURVATURE] < 1.0:
        return s, offset, heading, curvature
    is_foot = 1.0 - curvature * offset > -FLAT_SLOPE
    reach = (1.0 - SAME_FOOT) * gone - SAME_FOOT if is_foot else REACH
    other, aside, direction, bend = foot_about(x, y, near, reach, road)
    if is_foot and math.isnan(aside):
        return s, offset, heading, curvature
    return other, aside, direction, bend


@inlined
def _rows_about(near, road):
    """The first piece within `REACH` of an arc length, and how many there are; all of them where it is NaN."""
    start, length, count = road.start, road.numbers[LENGTH], len(road.pieces)
    closed = road.numbers[CLOSED] > 0.5
    if not abs(near) < math.inf or (closed and length <= 2.0 * REACH):
        return 0, count
    low, high = near - REACH, near + REACH
    if closed:
        low, high = low - floor(low / length) * length, high - floor(high / length) * length
    first = piece_below(min(max(low, 0.0), length), start)
    last = piece_below(min(max(high, 0.0), length), start)
    if last < first or (last == first and high < low):  # around the seam
        last += count
    return first, min(last - first + 1, count)


@inlined
def _is_far(s, half, near, road):
    """Whether all of [s - half, s + half] is further than `REACH` from an arc length; never where that is NaN."""
    distance = s - near
    if road.numbers[CLOSED] > 0.5:
        distance -= floor(distance / road.numbers[LENGTH] + 0.5) * road.numbers[LENGTH]
    return abs(distance) > REACH + half


@exported(float64(float64, float64, float64, float64, float64, Centreline), name="nearest_foot")
def nearest(x, y, yaw, across, near, road):
    """The arc length of the foot on the whole road of least cost, its distance + across (1 - cos(yaw - heading)).

    across: m, by which a foot may be nearer where the road leads another way; 0: the nearest foot. near: m, only the
    road within `REACH` of it counts, and it is the answer where that has no foot; NaN: all of it. A part of the road of
    a length 2 h is no nearer than its middle less h: parts that may hold the foot are halved down to a stride.
    """
    start, pieces, length = road.start, road.pieces, road.numbers[LENGTH]
    least, station = math.inf, 0.0
    first, count = _rows_about(near, road)
    for j in range(first, first + count):
        row = j if j < len(pieces) else j - len(pieces)
        distance, middle = hypot(pieces[row, X] - x, pieces[row, Y] - y), start[row] + pieces[row, HALF_LENGTH]
        if distance < least and not _is_far(middle, 0.0, near, road):
            least, station = distance, middle
    most, best = least + 2.0 * across + FOOT_TOLERANCE + FOOT_ROUNDING * (abs(x) + abs(y) + least), math.inf
    if road.numbers[CLOSED] < 0.5:
        for end, side in ((0.0, 1.0), (length, -1.0)):
            px, py, heading, _ = point_at(end, road)
            ahead = (px - x) * cos(heading) + (py - y) * sin(heading)
            cost = hypot(px - x, py - y) + across * (1.0 - cos(yaw - heading))
            if side * ahead > 0.0 and cost < best and not _is_far(end, 0.0, near, road):
                station, best = end - ahead, cost
    for j in range(first, first + count):
        row = j if j < len(pieces) else j - len(pieces)
        half, k, level = pieces[row, HALF_LENGTH], 0, 0
        if hypot(pieces[row, X] - x, pieces[row, Y] - y) - half > min(most, best):
            continue
        while True:
            s = start[row] + (2 * k + 1) * half
            px, py, _, _ = point_at(s, road)
            if hypot(px - x, py - y) - half <= min(most, best) and not _is_far(s, half, near, road):
                if 2.0 * half > STRIDE:
                    half, k, level = 0.5 * half, 2 * k, level + 1
                    continue
                before, after = ahead_at(s - half, x, y, road), ahead_at(s + half, x, y, road)
                low, high, grows = bracket(s - half, s + half, before, after, x, y, road)
                if grows:
                    foot, offset, heading, _ = downhill(x, y, 0.5 * (low + high), low, high, road)
                    cost = abs(offset) + across * (1.0 - cos(yaw - heading))
                    if cost < best and not _is_far(foot, 0.0, near, road):
                        station, best = foot, cost
            k += 1
            while level > 0 and k % 2 == 0:
                half, k, level = 2.0 * half, k // 2, level - 1
            if level == 0:
                break
    if best == math.inf and abs(near) < math.inf:
        return near
    if road.numbers[CLOSED] < 0.5:
        return station
    station -= floor(station / length) * length
    return 0.0 if length - station <= SAME_FOOT else station  # the seam is the road's beginning


@exported(void(Centreline, matrix, matrix))
def project_all(road, points, feet):
    """Write s, offset, heading and curvature of the foot of each row x, y, near of `points` to the rows of `feet`.

    near is NaN: the nearest foot of the whole road, see `nearest`.
    """
    for i in range(len(points)):
        x, y, near = points[i, 0], points[i, 1], points[i, 2]
        if math.isnan(near):
            near = nearest(x, y, 0.0, 0.0, math.nan, road)
        feet[i, 0], feet[i, 1], feet[i, 2], feet[i, 3] = foot_near(x, y, near, road)


@exported(void(Centreline, vector, matrix))
def points_at(road, s, points):
    """Write x, y, heading and curvature at each arc length of `s` to the rows of `points`."""
    for i in range(s.size):
        points[i, 0], points[i, 1], points[i, 2], points[i, 3] = point_at(s[i], road)


@exported(void(Centreline, vector))
def headings_along(road, headings):
    """Write the heading (rad) at arc lengths evenly from 0 to the length."""
    pieces, length, last = road.pieces, road.numbers[LENGTH], headings.size - 1
    spacing = length / last
    for k in range(last):
        s = k * spacing
        row = piece_below(s, road.start)
        _, _, headings[k], _ = point_of((s - road.start[row]) / pieces[row, HALF_LENGTH] - 1.0, row, pieces)
    _, _, headings[last], _ = point_at(length, road)


# -- several roads, and what lies ahead -------------------------------------------------------------------------------
@inlined
def line_of(road, roads):
    """The centre line of one of several roads; without pieces for road -1."""
    if road < 0:
        return Centreline(roads.start[:0], roads.pieces[:0], roads.headings[:0])
    numbers = roads.numbers[road]
    first, piece, count = whole(numbers[FIRST_START]), whole(numbers[FIRST_PIECE]), whole(numbers[COUNT])
    return Centreline(roads.start[first : first + count + 1], roads.pieces[piece : piece + count], numbers)


@inlined
def heading_at(s, road, roads):
    """Heading (rad) at any arc length, a straight line between the entries of the table."""
    numbers = roads.numbers[road]
    length, spacing = numbers[LENGTH], numbers[HEADING_SPACING]
    laps = floor(s / length) if numbers[CLOSED] > 0.5 else 0.0
    place = min(max(s - laps * length, 0.0), length) / spacing
    cell = min(whole(place), whole(length / spacing + 0.5) - 1)
    first = whole(numbers[FIRST_HEADING]) + cell
    last = first + 1
    near, end = roads.headings[first], roads.headings[last]
    return near + (place - cell) * (end - near) + laps * numbers[LAP_TURN]


@inlined
def step_ahead(j, delay, period):
    """s, the j-th step ahead: first the share of a period in `delay` (periods), then whole periods."""
    return period if j > 0 else (delay - whole(delay)) * period


@inlined
def planned_speed(time, speeds, speed, period):
    """The speed (m/s) planned for some time (s) from now, shifted so that the first is `speed`; the last one holds."""
    at = min(max(whole(time / period), 0), speeds.size - 1)
    return max(speeds[at] + (speed - speeds[PRESENT_INSTANT]), 0.0)


@exported(void(float64, vector, float64, float64, float64, int64, Place(Roads), vector))
def bend_ahead(station, speeds, speed, delay, period, road, roads, bend):
    """Write how far (m) the road ahead lies to the left of its tangent here: after `delay` periods T, then every T.

        dY/dt = v theta,   theta: heading of the road where the car will be, less its heading here

    A model whose heading and offset count from the path obeys the same equations as one in the frame of this tangent,
    in which the path is Y(t). The road is passed at the speeds (m/s) planned for the instants from now on, the last one
    holding, all shifted so that the first is `speed`: v (m/s) of the model.
    """
    heading = heading_at(station, road, roads)
    first = whole(delay)
    y = before = time = 0.0
    s = station
    for j in range(first + bend.size):
        step = step_ahead(j, delay, period)
        s += planned_speed(time, speeds, speed, period) * step
        time += step
        after = heading_at(s, road, roads) - heading
        y += 0.5 * speed * step * (before + after)
        before = after
        if j >= first:
            bend[j - first] = y


@exported(void(float64, vector, float64, float64, float64, Centreline, vector, vector))
def points_ahead(station, speeds, speed, delay, period, line, offsets, points):
    """Write x, y (m) of a car at so many offsets (n,) from a road: 1, 2, ... periods after `delay` periods.

    It passes the road as in `bend_ahead`; a road without pieces is the x axis. points: x and y in turn (>= 2n,); the
    offsets may lie in its last n numbers.
    """
    first, s, time = whole(delay), station, 0.0
    for j in range(first + 1 + offsets.size):
        step = step_ahead(j, delay, period)
        s += planned_speed(time, speeds, speed, period) * step
        time += step
        if j > first:
            i, x, y, heading = j - first - 1, s, 0.0, 0.0
            if len(line.pieces) > 0:
                x, y, heading, _ = point_at(s, line)
            offset = offsets[i]
            points[2 * i], points[2 * i + 1] = x - offset * sin(heading), y + offset * cos(heading)

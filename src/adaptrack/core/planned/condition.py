"""Check a planned trajectory, and convert it to places of the centre of mass with times and speeds.

1. Points within `MERGING_DISTANCE` of each other are one place. It is a rest if the car stays for `MIN_REST` and is
   slower than `REST_SPEED`; a brief hesitation is none.
2. The trajectory ends where the car first drives backwards: at a negative speed, a cusp of the line, or motion against
   the yaw.
3. Places move from the tracked point to the centre of mass, along the yaw or else the tangent of the circle through
   three places. The speed v of a point that moves along the yaw becomes v sqrt(1 + (arm curvature)^2).
4. An unknown speed is that of the parabola s(t) through a place and those `SPAN` before and after it. It is exact for
   constant accelerations. The bound of twice the mean speed on either side prevents oscillations.

The times of places do not change. The square of the speed is linear between places. A car with these speeds arrives at
these times if the acceleration is constant, else to second order of the time between places.
"""

from __future__ import annotations

import math

from ..kernel import OK, columns, exported, float64, inlined, int64, matrix, record, several
from ..maths.bits import whole
from ..maths.exact import clip, sqrt, square
from ..maths.trigonometric import cos, sin
from ..roads.path import MAX_COORDINATE
from ..speed.path import MAX_PLAN_SPEED
from .records import NODE, POINT

REVERSE_AHEAD, BAD_NUMBER, FALLING_TIME, PLACE_JUMP, WRONG_YAW, WRONG_SPEED, TOO_FEW_NODES = range(1, 8)
"""Statuses of `condition`, in addition to `OK`: the nodes end where the car is to drive backwards; and refusals: a time
or place that is not finite or beyond `MAX_COORDINATE`; a decreasing time; a jump of the place; a yaw off the tangent;
a speed that contradicts the places; too few rows for the nodes."""
MERGING_DISTANCE = 0.05
"""m, least distance of places."""
REST_SPEED, MIN_REST = 0.05, 0.25
"""m/s, s: a car that is slower for at least so long is at rest."""
TANGENT_BASE, YAW_BASE = 0.5, 3.0
"""m, m: least distance of the places that determine a tangent, and of those that a yaw is compared with."""
MAX_YAW_ERROR, AXLE_REACH = 0.268, 3.0
"""Tangent of 15 degrees, the largest angle between yaw and motion. It adds to the angle due to an axle that lies so far
(m) behind the tracked point and moves along the yaw."""
MIN_SLIP_COSINE = 0.8
"""Least cosine of the angle between the yaw and the motion of the tracked point; a larger angle is due to noise."""
MAX_JUMP, JUMP_ACCELERATION = 0.8, 15.0
"""m, m/s^2: largest excess of a step over the way that the fastest of two steps on each side and this acceleration
explain."""
MERGING_TIME = 1e-3
"""s, within which points up to `MAX_JUMP` apart are one place."""
SPAN = 0.3
"""s, over which speeds are estimated."""
SPEED_SPAN, SPEED_SHARE, SPEED_TOLERANCE = 1.0, 0.15, 0.5
"""s, -, m/s: time over which specified speeds are compared with the places, and their largest difference."""

_WORK = columns("entry", "x", "y", "cos", "sin")  # of a node: index and place of its point, as in `POINT`, and heading
_Draft = record("Draft", (("points", matrix), ("nodes", matrix), ("work", matrix)))


# -- entries ----------------------------------------------------------------------------------------------------------
@inlined
def _is_specified(points, column):
    """Whether a column has a number other than 0."""
    k = 0
    while k < len(points) and not abs(points[k, column]) > 0.0:
        k += 1
    return k < len(points)


@inlined
def _check_numbers(points):
    """Return `OK`, or `BAD_NUMBER` or `FALLING_TIME` with the index of the entry."""
    for k in range(len(points)):
        is_near = abs(points[k, POINT.x]) <= MAX_COORDINATE and abs(points[k, POINT.y]) <= MAX_COORDINATE
        if not (math.isfinite(points[k, POINT.t]) and is_near):
            return BAD_NUMBER, k
        if k > 0 and points[k, POINT.t] < points[k - 1, POINT.t]:
            return FALLING_TIME, k
    return OK, 0


@inlined
def _length(x, y):
    """Length of a vector of moderate size."""
    return sqrt(x * x + y * y)


@inlined
def _gap(rows, first, last):
    """Distance (m) of the places of two entries of `POINT`, or of two nodes of `_WORK`."""
    return _length(rows[last, POINT.x] - rows[first, POINT.x], rows[last, POINT.y] - rows[first, POINT.y])


@inlined
def _find_wrong_speed(points, last):
    """Index of the entry from which on specified speeds contradict the places, up to the entry `last`; -1: none."""
    first, way = 0, 0.0
    for k in range(1, last + 1 if _is_specified(points, POINT.speed) else 0):
        time = points[k, POINT.t] - points[first, POINT.t]
        mean = 0.5 * (points[k - 1, POINT.speed] + points[k, POINT.speed])
        way += mean * (points[k, POINT.t] - points[k - 1, POINT.t])
        if time >= SPEED_SPAN:
            chord_speed = _gap(points, first, k) / time
            if abs(way / time - chord_speed) > SPEED_SHARE * max(chord_speed, way / time) + SPEED_TOLERANCE:
                return first
            first, way = k, 0.0
    return -1


@inlined
def _find_rest(points, first, count):
    """Return the indices of the entries that begin a rest, are its place, and end it; all `first`: no rest.

    The place is the entry at half the time within `MERGING_DISTANCE` of the first entry. The rest lasts from the first
    to the last entry whose distance from the place is at most the mean; if that is one entry, as long as the car
    is near, unless the way from point to point is too long for a rest.
    """
    begin, middle, last, radius, way = first, first, first, 0.0, 0.0
    while last + 1 < count and _gap(points, first, last + 1) <= MERGING_DISTANCE:
        way += _gap(points, last, last + 1)
        last += 1
    end = last
    while points[middle, POINT.t] - points[begin, POINT.t] < points[end, POINT.t] - points[middle, POINT.t]:
        middle += 1
    for _ in range(2):
        radius = 0.0
        for k in range(begin, end + 1):
            radius += _gap(points, middle, k) / (end + 1 - begin)
        while begin < middle and _gap(points, middle, begin) > radius:
            begin += 1
        while end > middle and _gap(points, middle, end) > radius:
            end -= 1
    if begin == end:
        begin, end, radius = first, last, 0.5 * way
    time = points[end, POINT.t] - points[begin, POINT.t]
    if time < MIN_REST or 2.0 * radius > REST_SPEED * time:
        return first, first, first
    return begin, middle, end


# -- nodes ------------------------------------------------------------------------------------------------------------
@inlined
def is_rest(nodes, k):
    """Whether the car stands at a node."""
    return nodes[k, NODE.leave] > nodes[k, NODE.arrive]


@inlined
def _time_to_next(nodes, k):
    """Time (s) from a node to the next one."""
    return nodes[k + 1, NODE.arrive] - nodes[k, NODE.leave]


@inlined
def _chord(work, first, last):
    """Vector (m, m) between the tracked points of two nodes."""
    return work[last, _WORK.x] - work[first, _WORK.x], work[last, _WORK.y] - work[first, _WORK.y]


@inlined
def _distant_node(work, k, step, base, count):
    """Index of the first node in steps of 1 or -1 from node k that is at least `base` (m) away; -1: none."""
    j = k + step
    while 0 <= j < count and _gap(work, k, j) < base:
        j += step
    return j if j < count else -1


@inlined
def _neighbours(work, k, count):
    """Indices of the nearest nodes before and after node k that are at least `TANGENT_BASE` away; -1: none."""
    return _distant_node(work, k, -1, TANGENT_BASE, count), _distant_node(work, k, 1, TANGENT_BASE, count)


@inlined
def _set_node(draft, k, place, begin, end, begins):
    """Write a node with the place and the times of arrival and departure of three entries."""
    points, work = draft.points, draft.work
    work[k, _WORK.entry], work[k, _WORK.x], work[k, _WORK.y] = place, points[place, POINT.x], points[place, POINT.y]
    draft.nodes[k, NODE.arrive] = begins + points[begin, POINT.t]
    draft.nodes[k, NODE.leave] = begins + points[end, POINT.t]


@inlined
def _write_times(draft, begins, count):
    """Write the nodes of the first `count` points with their times; return the number of nodes."""
    points, nodes, work = draft.points, draft.nodes, draft.work
    last, k = -1, 0
    while k < count:
        begin, place, end = _find_rest(points, k, count)
        before = whole(work[last, _WORK.entry]) if last >= 0 else 0
        is_at_once = points[place, POINT.t] - points[before, POINT.t] < MERGING_TIME
        is_near = last >= 0 and _gap(points, before, place) <= (MAX_JUMP if is_at_once else MERGING_DISTANCE)
        if is_near and begin < end and is_rest(nodes, last):
            nodes[last, NODE.leave] = begins + points[end, POINT.t]
        elif begin < end or not is_near:
            last = last if is_near else last + 1
            _set_node(draft, last, place, begin, end, begins)
        k = end + 1
    if last > 0 and not is_rest(nodes, last):
        _set_node(draft, last, count - 1, count - 1, count - 1, begins)
    return last + 1


@inlined
def _mean_speed(draft, k, count):
    """Mean speed (m/s) from a node to the next one; 0 beyond the ends."""
    if k < 0 or k + 1 >= count:
        return 0.0
    way = _gap(draft.work, k, k + 1)
    return way / max(_time_to_next(draft.nodes, k), way / (2.0 * MAX_PLAN_SPEED))


@inlined
def _find_jump(draft, count):
    """Index of the node behind a jump of the place; -1: none."""
    for k in range(count - 1):
        speed, time = _mean_speed(draft, k, count), _time_to_next(draft.nodes, k)
        nearby_speed = max(_mean_speed(draft, k - 1, count), _mean_speed(draft, k + 1, count))
        nearby_speed = max(_mean_speed(draft, k - 2, count), nearby_speed, _mean_speed(draft, k + 2, count))
        is_longer = (speed - nearby_speed - 0.5 * JUMP_ACCELERATION * time) * time > MAX_JUMP
        if not speed <= MAX_PLAN_SPEED or (count > 2 and is_longer):
            return k + 1
    return -1


@inlined
def _count_to_cusp(work, count):
    """Number of nodes up to the first cusp, where the direction turns by more than 120 degrees."""
    for k in range(1, count - 1):
        before, after = _neighbours(work, k, count)
        if before < 0 or after < 0:
            continue
        (x, y), (next_x, next_y) = _chord(work, before, k), _chord(work, k, after)
        if x * next_x + y * next_y < -0.5 * _length(x, y) * _length(next_x, next_y):
            cusp, farthest = k, 0.0
            for j in range(k + 1, after):
                next_x, next_y = _chord(work, k, j)
                if x * next_x + y * next_y > farthest:
                    cusp, farthest = j, x * next_x + y * next_y
            return cusp + 1
    return count


# -- headings ---------------------------------------------------------------------------------------------------------
@inlined
def _inverse_chord(work, k, j):
    """Vector (1/m) from node k to node j, divided by the square of its length; 0 if j is -1."""
    x, y = _chord(work, k, max(j, 0))
    length = _length(x, y)
    return (x / square(length), y / square(length)) if j >= 0 and length > 0.0 else (0.0, 0.0)


@inlined
def _tangent(work, k, before, after, count):
    """Tangent (unit vector) at a node of the circle through it and two nodes at least `TANGENT_BASE` away.

    before, after: `_neighbours`. Inversion about the node turns that circle into a straight line along the tangent.
    """
    if before < 0 and after < 0:
        before, after = 0, count - 1
    elif before < 0:
        before = _distant_node(work, after, 1, TANGENT_BASE, count)
    elif after < 0:
        after = _distant_node(work, before, -1, TANGENT_BASE, count)
    x, y = _inverse_chord(work, k, after)
    before_x, before_y = _inverse_chord(work, k, before)
    x, y = x - before_x, y - before_y
    size = max(_length(x, y), 1e-300)
    return x / size, y / size


@inlined
def _yaw_at(draft, k):
    """Specified yaw (rad) at a node."""
    return draft.points[whole(draft.work[k, _WORK.entry]), POINT.yaw]


@inlined
def _write_places(draft, arm, count):
    """Write headings and places of the centre of mass.

    The heading is the yaw or else the tangent. If both are unknown, the place is that of the tracked point.
    """
    work, has_yaws = draft.work, _is_specified(draft.points, POINT.yaw)
    for k in range(count):
        heading_cos, heading_sin, yaw = math.nan, math.nan, _yaw_at(draft, k)
        if has_yaws and math.isfinite(yaw):
            heading_cos, heading_sin = cos(yaw), sin(yaw)
        elif count > 1:
            before, after = _neighbours(work, k, count)
            heading_cos, heading_sin = _tangent(work, k, before, after, count)
        work[k, _WORK.cos], work[k, _WORK.sin] = heading_cos, heading_sin
        is_known = heading_cos == heading_cos
        draft.nodes[k, NODE.x] = work[k, _WORK.x] - (arm * heading_cos if is_known else 0.0)
        draft.nodes[k, NODE.y] = work[k, _WORK.y] - (arm * heading_sin if is_known else 0.0)


@inlined
def _curvature_between(work, first, last):
    """Curvature (1/m) of the arc between two nodes: change of the heading over the way of the tracked point."""
    before, after = work[first], work[last]
    turn = _length(after[_WORK.cos] - before[_WORK.cos], after[_WORK.sin] - before[_WORK.sin])
    sine = before[_WORK.cos] * after[_WORK.sin] - before[_WORK.sin] * after[_WORK.cos]
    return math.copysign(turn, sine) / max(_gap(work, first, last), MERGING_DISTANCE)


@inlined
def _check_yaw(draft, count):
    """Return `OK` and the last node, or `WRONG_YAW` or `REVERSE_AHEAD` (motion against the yaw) and the node there."""
    work = draft.work
    for k in range(count if _is_specified(draft.points, POINT.yaw) else 0):
        after = _distant_node(work, k, 1, YAW_BASE, count)
        if after >= 0 and math.isfinite(_yaw_at(draft, k)) and math.isfinite(_yaw_at(draft, after)):
            x, y = _chord(work, k, after)
            heading_cos = work[k, _WORK.cos] + work[after, _WORK.cos]
            heading_sin = work[k, _WORK.sin] + work[after, _WORK.sin]
            along, across = heading_cos * x + heading_sin * y, heading_cos * y - heading_sin * x
            axle = AXLE_REACH * _curvature_between(work, k, after) * abs(along)
            if not max(across - max(axle, 0.0), min(axle, 0.0) - across) <= MAX_YAW_ERROR * abs(along):
                return WRONG_YAW, k
            if along < 0.0:
                return REVERSE_AHEAD, k
    return OK, count - 1


# -- speeds -----------------------------------------------------------------------------------------------------------
@inlined
def _arc_from(draft, k, step, count):
    """Time (s), length (m) and last node of an arc: from node k in steps of 1 or -1 until `SPAN`, a rest or the end."""
    work, time, j = draft.work, 0.0, k
    while 0 <= j + step < count and time < SPAN and (j == k or not is_rest(draft.nodes, j)):
        time += _time_to_next(draft.nodes, min(j, j + step))
        j += step
    cosine = work[k, _WORK.cos] * work[j, _WORK.cos] + work[k, _WORK.sin] * work[j, _WORK.sin]
    return time, _gap(work, k, j) * (1.0 + (1.0 - cosine) / 12.0), j


@inlined
def _estimate_speed(draft, k, count):
    """Speed (m/s) at a node, of the parabola s(t) through it and two places; at most twice the mean speed to either."""
    if is_rest(draft.nodes, k):
        return 0.0
    step = 1 if k == 0 else -1
    time, way, neighbour = _arc_from(draft, k, step, count)
    mean = way / time
    if 0 < k < count - 1:
        next_time, next_way, _ = _arc_from(draft, k, 1, count)
        next_mean = next_way / next_time
        return min((mean * next_time + next_mean * time) / (time + next_time), 2.0 * min(mean, next_mean))
    if is_rest(draft.nodes, neighbour):
        return 2.0 * mean
    next_time, next_way, _ = _arc_from(draft, neighbour, step, count)
    change = (mean - next_way / next_time) * time / (time + next_time) if next_time > 0.0 else 0.0
    return clip(mean + change, 0.0, 2.0 * mean)


@inlined
def _write_speeds(draft, arm, count):
    """Write the speeds of the centre of mass at the nodes, specified or else estimated from the places."""
    points, nodes, work = draft.points, draft.nodes, draft.work
    has_speeds, has_curvatures = _is_specified(points, POINT.speed), _is_specified(points, POINT.curvature)
    for k in range(count):
        entry = whole(work[k, _WORK.entry])
        before, after = _neighbours(work, k, count)
        tangent_cos, tangent_sin = _tangent(work, k, before, after, count)
        slip_cos = work[k, _WORK.cos] * tangent_cos + work[k, _WORK.sin] * tangent_sin
        slip_sin = work[k, _WORK.cos] * tangent_sin - work[k, _WORK.sin] * tangent_cos
        if slip_cos < MIN_SLIP_COSINE:
            slip_cos, slip_sin = 1.0, 0.0
        curvature = _curvature_between(work, k if before < 0 else before, max(k, after))
        if has_curvatures and math.isfinite(points[entry, POINT.curvature]):
            curvature = points[entry, POINT.curvature]
        speed, path_speed = _estimate_speed(draft, k, count), points[entry, POINT.speed] / slip_cos
        if has_speeds and math.isfinite(path_speed) and (k == count - 1 or path_speed >= 0.5 * speed):
            speed = max(path_speed, 0.0)
        nodes[k, NODE.speed] = 0.0 if is_rest(nodes, k) else speed * _length(slip_cos, slip_sin - arm * curvature)


@inlined
def _is_stuck(nodes, k):
    """Whether a node and the next both have the speed 0."""
    return nodes[k, NODE.speed] + nodes[k + 1, NODE.speed] <= 0.0


@inlined
def _insert_moving_nodes(draft, count):
    """Insert a node in the middle between two of speed 0; return the number of nodes."""
    nodes, added = draft.nodes, 0
    for k in range(count - 1):
        added += 1 if _is_stuck(nodes, k) else 0
    total = count + added
    for k in range(count - 2, -1, -1):
        is_stuck, time = _is_stuck(nodes, k), _time_to_next(nodes, k)
        nodes[k + 1 + added, :] = nodes[k + 1]
        if is_stuck:
            nodes[k + added, NODE.x] = 0.5 * (nodes[k, NODE.x] + nodes[k + 1, NODE.x])
            nodes[k + added, NODE.y] = 0.5 * (nodes[k, NODE.y] + nodes[k + 1, NODE.y])
            nodes[k + added, NODE.arrive] = nodes[k + added, NODE.leave] = nodes[k, NODE.leave] + 0.5 * time
            nodes[k + added, NODE.speed] = 2.0 * _gap(draft.work, k, k + 1) / time
            added -= 1
    return total


@exported(several(int64, int64, int64)(matrix, float64, float64, matrix))
def condition(points, arm, begins, nodes):
    """Write the nodes (`NODE`) of a trajectory, rows of `POINT`; return a status, an entry, and the number of nodes.

    arm: m, from the centre of mass forwards to the tracked point; begins: s, time 0 of the trajectory on the clock of
    the tracker; nodes: at least 2 n + 2 rows for n points; the rows behind the result are scratch.

    `OK` comes with the last entry, `REVERSE_AHEAD` with that at which the car is to stop, a refusal with the
    faulty entry and 0 nodes. The trajectory ends with a rest, until infinity, if its last speed is below `REST_SPEED`;
    else it ends in motion. No points: 0 nodes. One node: the car stands; the next row has x and y 1 m ahead, NaN if the
    yaw is unknown.
    """
    n, forwards = len(points), 0
    status, entry = _check_numbers(points)
    if status != OK or n == 0:
        return status, entry, 0
    if len(nodes) < 2 * n + 2:
        return TOO_FEW_NODES, 0, 0
    while forwards < n and not points[forwards, POINT.speed] < -REST_SPEED:
        forwards += 1
    draft, work = _Draft(points, nodes, nodes[n + 1 :]), nodes[n + 1 :]
    placed = _write_times(draft, begins, max(forwards, 1))
    jump = _find_jump(draft, placed)
    if jump >= 0:
        return PLACE_JUMP, whole(work[jump, _WORK.entry]), 0
    count = _count_to_cusp(work, placed)
    _write_places(draft, arm, count)
    status, last = _check_yaw(draft, count)
    entry = whole(work[last, _WORK.entry])
    if status == WRONG_YAW:
        return status, entry, 0
    if forwards < n or last + 1 < placed:
        status = REVERSE_AHEAD
    if last > 0:
        contradiction = _find_wrong_speed(points, entry)
        if contradiction >= 0:
            return WRONG_SPEED, contradiction, 0
        _write_speeds(draft, arm, last + 1)
    if status == REVERSE_AHEAD or last == 0 or nodes[last, NODE.speed] < REST_SPEED:
        nodes[last, NODE.speed], nodes[last, NODE.leave] = 0.0, math.inf
    nodes[last + 1, NODE.x] = nodes[last, NODE.x] + work[last, _WORK.cos]
    nodes[last + 1, NODE.y] = nodes[last, NODE.y] + work[last, _WORK.sin]
    return status, entry, _insert_moving_nodes(draft, last + 1)

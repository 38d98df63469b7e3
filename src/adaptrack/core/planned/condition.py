"""A planned trajectory, checked, as places of the centre of mass with times and speeds.

1. Points within `MERGING_DISTANCE` of each other are one place. It is a time at rest if the car moves there more slowly
   than `REST_SPEED`: a hesitation is none.
2. The trajectory ends where the car first drives backwards: at a negative speed, a cusp of the line, or motion against
   the yaw.
3. Places move from the tracked point to the centre of mass, along the yaw or else the tangent of the circle through
   three places. The speed v of a point that moves along the yaw becomes v sqrt(1 + (arm curvature)^2).
4. A speed that is not given is that of the parabola s(t) through a place and those `SPAN` before and after it. It is
   exact for constant accelerations. At most twice the mean speed on either side, it never oscillates.

The times of places are kept. Speeds between which the square is straight arrive at these times if the acceleration is
constant, else to second order of the time between places.
"""

from __future__ import annotations

import math

from ..kernel import OK, columns, exported, float64, inlined, int64, matrix, record, several
from ..maths.bits import whole
from ..maths.exact import clip, sqrt, square
from ..maths.trigonometric import cos, sin
from ..roads.path import MAX_COORDINATE
from ..speed.path import MAX_PLAN_SPEED
from .records import GIVEN, NODE

REVERSE_AHEAD, BAD_NUMBER, FALLING_TIME, PLACE_JUMP, WRONG_YAW, WRONG_SPEED, TOO_FEW_NODES = range(1, 8)
"""Statuses of `condition`, in addition to `OK`: the nodes end where the car is to drive backwards; and refusals: a time
or place that is not finite or beyond `MAX_COORDINATE`; a time before the one before; a jump of the place; a yaw off the
tangent; a speed that the places contradict; too few rows for the nodes."""
MERGING_DISTANCE = 0.05
"""m, between places at least."""
REST_SPEED, MIN_REST = 0.05, 0.25
"""m/s, s: a slower car is at rest, if for so long."""
TANGENT_BASE, YAW_BASE = 0.5, 2.0
"""m, from a place at least to those that show its tangent; from a place to the next with which its yaw is compared."""
MAX_YAW_ERROR, AXLE_REACH = 0.268, 3.0
"""Tangent of 15 degrees, the largest angle between yaw and motion, in addition to the angle that an axle causes which
lies so far (m) behind the tracked point and moves along the yaw."""
MIN_SLIP_COSINE = 0.8
"""Least cosine of the angle between the yaw and the motion of the tracked point; a larger angle is due to noise."""
MAX_JUMP, JUMP_ACCELERATION = 0.5, 15.0
"""m, m/s^2: a step is longer by at most so much than the faster of the steps around it explains."""
SPAN = 0.3
"""s, over which speeds are estimated."""
SPEED_SPAN, SPEED_SHARE, SPEED_TOLERANCE = 1.0, 0.15, 0.5
"""s, -, m/s: over which given speeds are compared with the places, and their largest difference."""

_WORK = columns("entry", "x", "y", "cos", "sin")  # the point that is a node's place, of the tracked point, and heading
_Draft = record("Draft", (("points", matrix), ("nodes", matrix), ("work", matrix)))


# -- entries ----------------------------------------------------------------------------------------------------------
@inlined
def _is_given(points, column):
    """Whether a column has a number other than 0."""
    k = 0
    while k < len(points) and not abs(points[k, column]) > 0.0:
        k += 1
    return k < len(points)


@inlined
def _faulty_entry(points):
    """`OK`, or what is wrong with times and places, and the entry."""
    for k in range(len(points)):
        is_near = abs(points[k, GIVEN.x]) <= MAX_COORDINATE and abs(points[k, GIVEN.y]) <= MAX_COORDINATE
        if not (math.isfinite(points[k, GIVEN.t]) and is_near):
            return BAD_NUMBER, k
        if k > 0 and points[k, GIVEN.t] < points[k - 1, GIVEN.t]:
            return FALLING_TIME, k
    return OK, 0


@inlined
def _length(x, y):
    """The length of a vector of moderate size."""
    return sqrt(x * x + y * y)


@inlined
def _gap(points, first, last):
    """m, between the places of two entries."""
    return _length(points[last, GIVEN.x] - points[first, GIVEN.x], points[last, GIVEN.y] - points[first, GIVEN.y])


@inlined
def _wrong_speed(points, last):
    """The entry from which on the given speeds contradict the places, up to the entry `last`; -1 without one."""
    first, way = 0, 0.0
    for k in range(1, last + 1 if _is_given(points, GIVEN.speed) else 0):
        time = points[k, GIVEN.t] - points[first, GIVEN.t]
        mean = 0.5 * (points[k - 1, GIVEN.speed] + points[k, GIVEN.speed])
        way += mean * (points[k, GIVEN.t] - points[k - 1, GIVEN.t])
        if time >= SPEED_SPAN:
            by_places = _gap(points, first, k) / time
            if abs(way / time - by_places) > SPEED_SHARE * max(by_places, way / time) + SPEED_TOLERANCE:
                return first
            first, way = k, 0.0
    return -1


@inlined
def _find_rest(points, first, count):
    """The entries with which a rest begins, that is its place, and with which it ends; all `first` without a rest.

    The place is where the car is in the middle of its time within `MERGING_DISTANCE` of the first entry. The rest lasts
    from the first to the last entry that is no farther from there than the mean.
    """
    begin, middle, end, radius = first, first, first, 0.0
    while end + 1 < count and _gap(points, first, end + 1) <= MERGING_DISTANCE:
        end += 1
    while points[middle, GIVEN.t] - points[begin, GIVEN.t] < points[end, GIVEN.t] - points[middle, GIVEN.t]:
        middle += 1
    for _ in range(2):
        radius = 0.0
        for k in range(begin, end + 1):
            radius += _gap(points, middle, k) / (end + 1 - begin)
        while begin < middle and _gap(points, middle, begin) > radius:
            begin += 1
        while end > middle and _gap(points, middle, end) > radius:
            end -= 1
    time = points[end, GIVEN.t] - points[begin, GIVEN.t]
    if time < MIN_REST or 2.0 * radius > REST_SPEED * time:
        return first, first, first
    return begin, middle, end


# -- nodes ------------------------------------------------------------------------------------------------------------
@inlined
def _is_rest(nodes, k):
    return nodes[k, NODE.leave] > nodes[k, NODE.arrive]


@inlined
def _time(nodes, k):
    """s, from a node to the next one."""
    return nodes[k + 1, NODE.arrive] - nodes[k, NODE.leave]


@inlined
def _chord(work, first, last):
    """m, m, m: from a node to another one, and the length, of the tracked point."""
    x, y = work[last, _WORK.x] - work[first, _WORK.x], work[last, _WORK.y] - work[first, _WORK.y]
    return x, y, _length(x, y)


@inlined
def _distant_node(work, k, step, base, count):
    """The first node from k on, in steps of 1 or -1, that lies at least so far (m) from it; -1 without one."""
    j = k + step
    while 0 <= j < count:
        _, _, length = _chord(work, k, j)
        if length >= base:
            return j
        j += step
    return -1


@inlined
def _neighbours(work, k, count):
    """The nodes before and after one that lie at least `TANGENT_BASE` from it; -1 without one."""
    return _distant_node(work, k, -1, TANGENT_BASE, count), _distant_node(work, k, 1, TANGENT_BASE, count)


@inlined
def _set_node(draft, k, place, begin, end, begins):
    """Write a node: its place, and when it begins and ends, of three entries."""
    points, work = draft.points, draft.work
    work[k, _WORK.entry], work[k, _WORK.x], work[k, _WORK.y] = place, points[place, GIVEN.x], points[place, GIVEN.y]
    draft.nodes[k, NODE.arrive] = begins + points[begin, GIVEN.t]
    draft.nodes[k, NODE.leave] = begins + points[end, GIVEN.t]


@inlined
def _write_times(draft, begins, count):
    """Write the nodes of so many points, with their times; how many nodes."""
    points, nodes, work = draft.points, draft.nodes, draft.work
    n, k = 0, 0
    while k < count:
        begin, place, end = _find_rest(points, k, count)
        is_near = n > 0 and _gap(points, whole(work[max(n - 1, 0), _WORK.entry]), place) <= MERGING_DISTANCE
        if is_near and begin < end and _is_rest(nodes, n - 1):
            nodes[n - 1, NODE.leave] = begins + points[end, GIVEN.t]
        elif begin < end or not is_near:
            n = n if is_near else n + 1
            _set_node(draft, n - 1, place, begin, end, begins)
        k = end + 1
    if n > 1 and not _is_rest(nodes, n - 1):
        _set_node(draft, n - 1, count - 1, count - 1, count - 1, begins)
    return n


@inlined
def _pace(draft, k, count):
    """m/s, from a node to the next one; 0 beyond the ends."""
    if k < 0 or k + 1 >= count:
        return 0.0
    _, _, way = _chord(draft.work, k, k + 1)
    return way / max(_time(draft.nodes, k), way / (2.0 * MAX_PLAN_SPEED))


@inlined
def _jump(draft, count):
    """The node behind a jump of the place; -1 without one."""
    for k in range(count - 1):
        pace, time = _pace(draft, k, count), _time(draft.nodes, k)
        around = max(_pace(draft, k - 1, count), _pace(draft, k + 1, count))
        is_longer = (pace - around - 0.5 * JUMP_ACCELERATION * time) * time > MAX_JUMP
        if not pace <= MAX_PLAN_SPEED or (count > 2 and is_longer):
            return k + 1
    return -1


@inlined
def _nodes_to_cusp(work, count):
    """How many nodes there are up to the first cusp, where the direction turns by more than 120 degrees."""
    for k in range(1, count - 1):
        before, after = _neighbours(work, k, count)
        x, y, length = _chord(work, max(before, 0), k)
        next_x, next_y, next_length = _chord(work, k, max(after, 0))
        if before >= 0 and after >= 0 and x * next_x + y * next_y < -0.5 * length * next_length:
            cusp, farthest = k, 0.0
            for j in range(k + 1, after):
                next_x, next_y, _ = _chord(work, k, j)
                if x * next_x + y * next_y > farthest:
                    cusp, farthest = j, x * next_x + y * next_y
            return cusp + 1
    return count


# -- headings ---------------------------------------------------------------------------------------------------------
@inlined
def _mirrored(work, k, j):
    """1/m, 1/m: the vector from a node to another one over the square of its length; 0 without one."""
    x, y, length = _chord(work, k, max(j, 0))
    return (x / square(length), y / square(length)) if j >= 0 and length > 0.0 else (0.0, 0.0)


@inlined
def _tangent(work, k, count):
    """Cosine and sine of the heading at a node, of the circle through it and two nodes at least `TANGENT_BASE` away.

    Mirrored at a circle about the node, that circle is a straight line along the tangent.
    """
    before, after = _neighbours(work, k, count)
    if before < 0 and after < 0:
        before, after = 0, count - 1
    elif before < 0:
        before = _distant_node(work, after, 1, TANGENT_BASE, count)
    elif after < 0:
        after = _distant_node(work, before, -1, TANGENT_BASE, count)
    x, y = _mirrored(work, k, after)
    before_x, before_y = _mirrored(work, k, before)
    x, y = x - before_x, y - before_y
    size = max(_length(x, y), 1e-300)
    return x / size, y / size


@inlined
def _has_yaw(draft, k):
    return math.isfinite(draft.points[whole(draft.work[k, _WORK.entry]), GIVEN.yaw])


@inlined
def _write_places(draft, arm, count):
    """Write headings, yaw or else tangent, and places of the centre of mass; without both that of the tracked point."""
    work, is_given = draft.work, _is_given(draft.points, GIVEN.yaw)
    for k in range(count):
        heading_cos, heading_sin = math.nan, math.nan
        if is_given and _has_yaw(draft, k):
            yaw = draft.points[whole(work[k, _WORK.entry]), GIVEN.yaw]
            heading_cos, heading_sin = cos(yaw), sin(yaw)
        elif count > 1:
            heading_cos, heading_sin = _tangent(work, k, count)
        work[k, _WORK.cos], work[k, _WORK.sin] = heading_cos, heading_sin
        is_known = heading_cos == heading_cos
        draft.nodes[k, NODE.x] = work[k, _WORK.x] - (arm * heading_cos if is_known else 0.0)
        draft.nodes[k, NODE.y] = work[k, _WORK.y] - (arm * heading_sin if is_known else 0.0)


@inlined
def _turning(work, first, last):
    """1/m, curvature of the arc between two nodes by their headings, over the way of the tracked point."""
    _, _, length = _chord(work, first, last)
    before, after = work[first], work[last]
    turn = _length(after[_WORK.cos] - before[_WORK.cos], after[_WORK.sin] - before[_WORK.sin])
    left = before[_WORK.cos] * after[_WORK.sin] - before[_WORK.sin] * after[_WORK.cos]
    return math.copysign(turn, left) / max(length, MERGING_DISTANCE)


@inlined
def _check_yaw(draft, count):
    """`OK`, `WRONG_YAW`, or `REVERSE_AHEAD` for motion against the yaw; and the node."""
    work = draft.work
    for k in range(count if _is_given(draft.points, GIVEN.yaw) else 0):
        after = _distant_node(work, k, 1, YAW_BASE, count)
        if after >= 0 and _has_yaw(draft, k) and _has_yaw(draft, after):
            x, y, _ = _chord(work, k, after)
            heading_cos = work[k, _WORK.cos] + work[after, _WORK.cos]
            heading_sin = work[k, _WORK.sin] + work[after, _WORK.sin]
            along, across = heading_cos * x + heading_sin * y, heading_cos * y - heading_sin * x
            axle = AXLE_REACH * _turning(work, k, after) * abs(along)
            if not max(across - max(axle, 0.0), min(axle, 0.0) - across) <= MAX_YAW_ERROR * abs(along):
                return WRONG_YAW, k
            if along < 0.0:
                return REVERSE_AHEAD, k
    return OK, 0


# -- speeds -----------------------------------------------------------------------------------------------------------
@inlined
def _span(draft, k, step, count):
    """From a node in steps of 1 or -1 to one that is `SPAN` away, at rest or the end: s, m of the arc, its number."""
    work, time, j = draft.work, 0.0, k
    while 0 <= j + step < count and time < SPAN and (j == k or not _is_rest(draft.nodes, j)):
        time += _time(draft.nodes, min(j, j + step))
        j += step
    _, _, length = _chord(work, k, j)
    cosine = work[k, _WORK.cos] * work[j, _WORK.cos] + work[k, _WORK.sin] * work[j, _WORK.sin]
    return time, length * (1.0 + (1.0 - cosine) / 12.0), j


@inlined
def _speed_by_places(draft, k, count):
    """m/s, at a node, of the parabola s(t) through it and two places; at most twice the mean speed to either."""
    if _is_rest(draft.nodes, k):
        return 0.0
    step = 1 if k == 0 else -1
    time, way, near = _span(draft, k, step, count)
    mean = way / time
    if 0 < k < count - 1:
        next_time, next_way, _ = _span(draft, k, 1, count)
        next_mean = next_way / next_time
        return min((mean * next_time + next_mean * time) / (time + next_time), 2.0 * min(mean, next_mean))
    if _is_rest(draft.nodes, near):
        return 2.0 * mean
    next_time, next_way, _ = _span(draft, near, step, count)
    change = (mean - next_way / next_time) * time / (time + next_time) if next_time > 0.0 else 0.0
    return clip(mean + change, 0.0, 2.0 * mean)


@inlined
def _write_speeds(draft, arm, count):
    """Write the speeds of the nodes, as given or by their places, of the centre of mass."""
    points, nodes, work = draft.points, draft.nodes, draft.work
    has_speed, has_curvature = _is_given(points, GIVEN.speed), _is_given(points, GIVEN.curvature)
    for k in range(count):
        entry = whole(work[k, _WORK.entry])
        tangent_cos, tangent_sin = _tangent(work, k, count)
        slip_cos = work[k, _WORK.cos] * tangent_cos + work[k, _WORK.sin] * tangent_sin
        slip_sin = work[k, _WORK.cos] * tangent_sin - work[k, _WORK.sin] * tangent_cos
        if slip_cos < MIN_SLIP_COSINE:
            slip_cos, slip_sin = 1.0, 0.0
        before, after = _neighbours(work, k, count)
        curvature = _turning(work, k if before < 0 else before, max(k, after))
        if has_curvature and math.isfinite(points[entry, GIVEN.curvature]):
            curvature = points[entry, GIVEN.curvature]
        speed, given_speed = _speed_by_places(draft, k, count), points[entry, GIVEN.speed] / slip_cos
        if has_speed and math.isfinite(given_speed) and (k == count - 1 or given_speed >= 0.5 * speed):
            speed = max(given_speed, 0.0)
        nodes[k, NODE.speed] = 0.0 if _is_rest(nodes, k) else speed * _length(slip_cos, slip_sin - arm * curvature)


@inlined
def _is_stuck(nodes, k):
    """Whether a node and the next both have the speed 0."""
    return nodes[k, NODE.speed] + nodes[k + 1, NODE.speed] <= 0.0


@inlined
def _add_nodes(draft, count):
    """Add a node in the middle between two of speed 0; how many nodes there are then."""
    nodes, added = draft.nodes, 0
    for k in range(count - 1):
        added += 1 if _is_stuck(nodes, k) else 0
    total = count + added
    for k in range(count - 2, -1, -1):
        is_stuck, time, (_, _, way) = _is_stuck(nodes, k), _time(nodes, k), _chord(draft.work, k, k + 1)
        for j in range(len(NODE)):
            nodes[k + 1 + added, j] = nodes[k + 1, j]
            if is_stuck:
                nodes[k + added, j] = 0.5 * (nodes[k, j] + nodes[k + 1, j])
        if is_stuck:
            nodes[k + added, NODE.arrive] = nodes[k, NODE.leave] + 0.5 * time
            nodes[k + added, NODE.leave] = nodes[k + added, NODE.arrive]
            nodes[k + added, NODE.speed] = 2.0 * way / time
            added -= 1
    return total


@exported(several(int64, int64, int64)(matrix, float64, float64, matrix))
def condition(points, arm, begins, nodes):
    """Write the nodes (`NODE`) of a trajectory, rows of `GIVEN`; status, entry, and number of nodes.

    arm: m, from the centre of mass forwards to the tracked point; begins: s, time 0 of the trajectory on the clock of
    the tracker; nodes: at least 2 n + 2 rows for n points; the rows behind the result are scratch.

    `OK`, or `REVERSE_AHEAD` and the entry at which the car is to stop; or a refusal, the entry that is at fault, and 0.
    The trajectory ends with a rest, until infinity, if its last speed is below `REST_SPEED`; else it ends in motion.
    No points: 0 nodes. One node: the car stands; the next row has x and y 1 m ahead, NaN if the yaw is unknown.
    """
    n, forwards = len(points), 0
    status, entry = _faulty_entry(points)
    if status != OK or n == 0:
        return status, entry, 0
    if len(nodes) < 2 * n + 2:
        return TOO_FEW_NODES, 0, 0
    while forwards < n and not points[forwards, GIVEN.speed] < -REST_SPEED:
        forwards += 1
    draft, work = _Draft(points, nodes, nodes[n + 1 :]), nodes[n + 1 :]
    placed = _write_times(draft, begins, max(forwards, 1))
    jump = _jump(draft, placed)
    if jump >= 0:
        return PLACE_JUMP, whole(work[jump, _WORK.entry]), 0
    count = _nodes_to_cusp(work, placed)
    _write_places(draft, arm, count)
    status, node = _check_yaw(draft, count)
    if status == WRONG_YAW:
        return status, whole(work[node, _WORK.entry]), 0
    if status == REVERSE_AHEAD or forwards < n or count < placed:
        status, count = REVERSE_AHEAD, node + 1 if status == REVERSE_AHEAD else count
    entry = whole(work[count - 1, _WORK.entry])
    contradiction = _wrong_speed(points, entry) if count > 1 else -1
    if contradiction >= 0:
        return WRONG_SPEED, contradiction, 0
    last, ahead = nodes[count - 1], nodes[count]
    if count > 1:
        _write_speeds(draft, arm, count)
    if status == REVERSE_AHEAD or count == 1 or last[NODE.speed] < REST_SPEED:
        last[NODE.speed], last[NODE.leave] = 0.0, math.inf
    if count > 1:
        return status, entry, _add_nodes(draft, count)
    ahead[NODE.x], ahead[NODE.y] = last[NODE.x] + work[0, _WORK.cos], last[NODE.y] + work[0, _WORK.sin]
    return status, entry, 1

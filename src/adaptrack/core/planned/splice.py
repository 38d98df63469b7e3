"""Join the line of a new trajectory to the line that the car follows.

Both lines agree if their distance ahead of the car is explained by the uncertainty of its position and by the noise of
the points. The car then stays on its line, and fades to the new one some metres ahead. So noise of the points, and
plans that begin at a measured pose, do not move the line under the car. If the lines disagree, the new line counts at
once, and the tracker lets the offset of its reference decay (`core.tracker.planner`).
"""

from __future__ import annotations

import math

from ..kernel import inlined, record
from ..maths.exact import clip
from ..maths.exponential import hypot
from ..maths.trigonometric import cos, sin
from ..roads.path import MIN_PATH_POINTS
from ..roads.road import foot_near, point_at
from .condition import is_rest
from .records import NODE

CarOnLine = record("CarOnLine", ("x", "y", "yaw", "speed", "station"))
"""The car (m, m, rad, m/s) and its arc length (m) on the line that it follows; NaN: unknown."""

POINT_TIME, MIN_POINT_WAY, MAX_POINT_WAY = 0.15, 0.75, 3.0
"""s, m, m: time between the points of a line at the planned speed, and bounds of their distance."""
BEHIND_TIME, BEHIND_WAY = 0.5, 5.0
"""s, m: a line begins so far behind the car, because late samples lie behind it."""
OLD_LINE_TIME, OLD_LINE_WAY = 3.0, 5.0
"""s, m: as far ahead of the car, the line before is used while both agree."""
MIN_AGREEMENT_TIME, MIN_AGREEMENT_WAY = 0.4, 2.0
"""s, m: lines that agree for less disagree."""
FADE_TIME, FADE_WAY = 0.75, 3.0
"""s, m: length of the transition from one line to the other."""
AGREEMENT_SIGMAS, MIN_TOLERANCE = 3.0, 0.05
"""-, m: standard deviations of position and points by which lines that agree may differ, and the least tolerance."""
MIN_DISAGREEMENTS, DOUBT_FACTOR = 3, 2.0
"""Trajectories in a row that must disagree before they count, and the multiple of the tolerance up to which this holds.
One measured pose in a hundred is as far off, and so are plans that begin there."""
FRONT_ROOM = 8
"""Free rows of points before the first node, for `prepend_points`."""


@inlined
def _step_at(speed):
    """Distance (m) of points at a planned speed (m/s)."""
    return clip(POINT_TIME * speed, MIN_POINT_WAY, MAX_POINT_WAY)


@inlined
def thin_nodes(nodes, count):
    """Remove nodes that a line does not need, except places of rest; return how many remain."""
    end = 1
    for j in range(1, count):
        way = hypot(nodes[j, NODE.x] - nodes[end - 1, NODE.x], nodes[j, NODE.y] - nodes[end - 1, NODE.y])
        step, is_needed = _step_at(nodes[j, NODE.speed]), is_rest(nodes, j) or j == count - 1
        if way < step and not is_needed:
            continue
        if end > 1 and is_needed and way < 0.5 * step and not is_rest(nodes, end - 1):
            end -= 1
        nodes[end, :] = nodes[j]
        end += 1
    return end


@inlined
def project_nodes(nodes, count, near, line, feet):
    """Write the feet of nodes on a line, or on the straights beyond its ends: arc length and offset (m), (n, 2).

    near: m, arc length near which the first foot lies. Offsets of nodes without a foot are NaN.
    """
    s = near
    for j in range(count):
        x, y = nodes[j, NODE.x], nodes[j, NODE.y]
        if j > 0:
            s += hypot(x - nodes[j - 1, NODE.x], y - nodes[j - 1, NODE.y])
        s, feet[j, 1], _, _ = foot_near(x, y, s, line)
        feet[j, 0] = s


@inlined
def interpolate_offset(s, feet, count, first):
    """Offset (m) of the nodes at an arc length (m), and the node before; the search begins at node `first`."""
    while first < count - 2 and feet[first + 1, 0] <= s:
        first += 1
    way = feet[first + 1, 0] - feet[first, 0]
    share = clip((s - feet[first, 0]) / way, 0.0, 1.0) if way > 0.0 else 0.0
    return feet[first, 1] + share * (feet[first + 1, 1] - feet[first, 1]), first


@inlined
def _agreement_end(car, tolerance, feet, count, old_points):
    """Arc length (m) of the last point of the old line up to which both lines agree; -inf: they disagree."""
    longest, end, last_point = car.station + OLD_LINE_TIME * car.speed + OLD_LINE_WAY, -math.inf, -math.inf
    for j in range(count):
        if feet[j, 0] <= car.station:
            continue
        if end == longest or not abs(feet[j, 1]) <= tolerance:
            break
        end = min(feet[j, 0], longest)
    shortest = car.station + MIN_AGREEMENT_TIME * car.speed + MIN_AGREEMENT_WAY
    for i in range(len(old_points)):
        last_point = old_points[i, 2] if shortest < old_points[i, 2] <= end else last_point
    return last_point


@inlined
def confirmed_agreement_end(car, position_noise, noise, feet, count, old_points, memory):
    """Arc length (m) up to which the old line is used; a small disagreement must come several times in a row.

    position_noise, noise: m, standard deviations of a measured position and of the nodes; feet: (count, 2), see
    `project_nodes`; old_points: (n, 3), of the old line with their arc lengths. -inf: the new line counts at once.
    """
    tolerance = max(AGREEMENT_SIGMAS * position_noise, MIN_TOLERANCE) + AGREEMENT_SIGMAS * noise
    end = _agreement_end(car, tolerance, feet, count, old_points)
    memory.disagreed = 0 if end > -math.inf else memory.disagreed + 1
    if 0 < memory.disagreed < MIN_DISAGREEMENTS:
        end = _agreement_end(car, DOUBT_FACTOR * tolerance, feet, count, old_points)
    return end


@inlined
def write_points(nodes, count, feet, until, car, line, old_points, points):
    """Write the points (n, 2) of the old line up to an arc length (m), then the nodes; return the end of the rows.

    until: -inf: the nodes alone. Rows begin at `FRONT_ROOM`; feet and old_points: see `confirmed_agreement_end`.
    """
    end, segment = FRONT_ROOM, 0
    begin = car.station - BEHIND_WAY - BEHIND_TIME * car.speed - MAX_POINT_WAY
    fade = max(until - FADE_TIME * car.speed - FADE_WAY, car.station)
    if until > -math.inf and count > 1:
        for i in range(len(old_points)):
            s = old_points[i, 2]
            if not begin <= s <= until:
                continue
            offset, segment = interpolate_offset(s, feet, count, segment)
            share = clip((s - fade) / max(until - fade, 1e-9), 0.0, 1.0)
            offset *= share * share * (3.0 - 2.0 * share)  # the slope is 0 at both ends
            _, _, heading, _ = point_at(s, line)
            points[end, 0] = old_points[i, 0] - offset * sin(heading)
            points[end, 1] = old_points[i, 1] + offset * cos(heading)
            end += 1
    for j in range(count):
        x, y = nodes[j, NODE.x], nodes[j, NODE.y]
        if end > FRONT_ROOM:
            way = hypot(x - points[end - 1, 0], y - points[end - 1, 1])
            is_near = way < 0.5 * _step_at(nodes[j, NODE.speed])
            if (is_near or feet[j, 0] <= until) and j < count - 1:
                continue
            if is_near:
                end -= 1  # the line must end at the last node
        points[end, 0], points[end, 1] = x, y
        end += 1
    return end


@inlined
def _direction_at(k, points):
    """Direction of a line (unit vector) from a point to the next."""
    dx, dy = points[k + 1, 0] - points[k, 0], points[k + 1, 1] - points[k, 1]
    length = hypot(dx, dy)
    return dx / length, dy / length


@inlined
def prepend_points(car, nodes, end, points):
    """Extend a line straight back to behind the car, along its tangent; return its first row.

    nodes: a single node is followed by a point ahead of it, see `condition`; end: of the rows of `write_points`.
    """
    first, count = FRONT_ROOM, end - FRONT_ROOM
    x, y = points[first, 0], points[first, 1]
    dx, dy = nodes[1, NODE.x] - nodes[0, NODE.x], nodes[1, NODE.y] - nodes[0, NODE.y]
    if dx != dx:  # the trajectory has no yaw
        dx, dy = cos(car.yaw), sin(car.yaw)
    if count > 1:
        dx, dy = _direction_at(first, points)
    if count > 2:  # extrapolate the directions of two steps to the first point
        next_dx, next_dy = _direction_at(first + 1, points)
        dx, dy = 1.5 * dx - 0.5 * next_dx, 1.5 * dy - 0.5 * next_dy
    start = (x - car.x) * dx + (y - car.y) * dy if car.x == car.x else 0.0  # m, ahead of the car
    length, missing = start + BEHIND_WAY + BEHIND_TIME * car.speed, MIN_PATH_POINTS - count
    if length <= 0.0 and missing <= 0:
        return first
    added = min(max(MIN_PATH_POINTS, missing), FRONT_ROOM)
    step = max(length, BEHIND_WAY) / added
    for k in range(added):
        points[first - 1 - k, 0], points[first - 1 - k, 1] = x - (k + 1) * step * dx, y - (k + 1) * step * dy
    return first - added

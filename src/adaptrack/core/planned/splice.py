"""The line of a new trajectory, joined to the line that the car follows.

Where both lines agree ahead of the car, within what its position is known to and the noise of the points, the car stays
on the line before, and the new one begins behind a fade of some metres. So points with noise that come anew every
0.1 s, and plans that begin at a measured pose, do not move the line under the car. Where they do not agree the new line
counts at once; the tracker then lets the offset of its reference decay (`core.tracker.planner`).
"""

from __future__ import annotations

import math

from ..kernel import inlined, record
from ..maths.exact import clip
from ..maths.exponential import hypot
from ..maths.trigonometric import cos, sin
from ..roads.path import MIN_PATH_POINTS
from ..roads.road import foot_near, point_at
from .records import NODE

CarOnLine = record("CarOnLine", ("x", "y", "yaw", "speed", "station"))
"""The car (m, m, rad, m/s) and its arc length (m) on the line that it follows; NaN: there is no such line."""

STEP_TIME, SHORTEST_STEP, LONGEST_STEP = 0.15, 0.75, 3.0
"""s, m, m: distance of the points through which a line is made, as way at the planned speed."""
BEHIND_TIME, BEHIND = 0.5, 5.0
"""s, m: a line begins so far behind the car: late samples are behind it."""
KEPT_TIME, KEPT_WAY = 3.0, 5.0
"""s, m: as far ahead of the car, way at its speed and in addition, the line before is kept where both agree."""
LEAST_KEPT_TIME, LEAST_KEPT_WAY = 0.4, 2.0
"""s, m: where they agree for less, the new line counts at once."""
FADE_TIME, FADE_WAY = 0.75, 3.0
"""s, m: over which one becomes the other."""
AGREEMENT_SIGMAS, LEAST_AGREEMENT = 3.0, 0.05
"""-, m: standard deviations of position and points by which lines that agree may differ, and at least."""
DOUBTED, DOUBT = 3, 2.0
"""Trajectories in a row that must disagree before they are believed, while they differ by no more than this multiple:
one measured pose in a hundred is as far off, and so are plans that begin there."""
FRONT_ROOM = 8
"""Points that a line may get in front of its first node."""


@inlined
def tolerance_of(position_noise, noise):
    """Distance (m) up to which lines agree; m, m: standard deviations of a measured position and of points."""
    return max(AGREEMENT_SIGMAS * position_noise, LEAST_AGREEMENT) + AGREEMENT_SIGMAS * noise


@inlined
def step_at(speed):
    """Distance (m) of points at a planned speed (m/s)."""
    return clip(STEP_TIME * speed, SHORTEST_STEP, LONGEST_STEP)


@inlined
def thin(nodes, count):
    """Keep as many nodes as a line needs, and all places of rest; how many these are."""
    kept = 1
    for j in range(1, count):
        way = hypot(nodes[j, NODE.x] - nodes[kept - 1, NODE.x], nodes[j, NODE.y] - nodes[kept - 1, NODE.y])
        is_rest, is_last = nodes[j, NODE.leave] > nodes[j, NODE.arrive], j == count - 1
        step = step_at(nodes[j, NODE.speed])
        if way < step and not (is_rest or is_last):
            continue
        is_pushed = kept > 1 and (is_last or is_rest) and way < 0.5 * step
        if is_pushed and not nodes[kept - 1, NODE.leave] > nodes[kept - 1, NODE.arrive]:
            kept -= 1
        for i in range(len(NODE)):
            nodes[kept, i] = nodes[j, i]
        kept += 1
    return kept


@inlined
def project(nodes, count, near, line, feet):
    """Write the feet of nodes on a line: arc length and offset (m) to the rows of `feet`; beyond its ends on straights.

    near: m, arc length about which the first foot lies. Offsets are NaN where a node has no foot.
    """
    s = near
    for j in range(count):
        x, y = nodes[j, NODE.x], nodes[j, NODE.y]
        if j > 0:
            s += hypot(x - nodes[j - 1, NODE.x], y - nodes[j - 1, NODE.y])
        s, feet[j, 1], _, _ = foot_near(x, y, s, line)
        feet[j, 0] = s


@inlined
def _offset_at(s, feet, count, first):
    """Offset (m) of the nodes at an arc length (m), straight between them; the node from which to look on."""
    while first < count - 2 and feet[first + 1, 0] <= s:
        first += 1
    way = feet[first + 1, 0] - feet[first, 0]
    share = clip((s - feet[first, 0]) / way, 0.0, 1.0) if way > 0.0 else 0.0
    return feet[first, 1] + share * (feet[first + 1, 1] - feet[first, 1]), first


@inlined
def kept_until(car, tolerance, feet, count, old):
    """Arc length (m) on the line before up to which it is kept, one of its points; -inf: it is not kept.

    tolerance: m, by which lines that agree may differ; old: as in `join`.
    """
    end, last = car.station + KEPT_TIME * car.speed + KEPT_WAY, -math.inf
    for j in range(count):
        if feet[j, 0] <= car.station:
            continue
        if not abs(feet[j, 1]) <= tolerance:
            break
        last = min(feet[j, 0], end)
        if last == end:
            break
    until, least = -math.inf, car.station + LEAST_KEPT_TIME * car.speed + LEAST_KEPT_WAY
    for i in range(len(old)):
        until = old[i, 2] if least < old[i, 2] <= last else until
    return until


@inlined
def agreed_until(car, tolerance, feet, count, old, memory):
    """As `kept_until`, but a small disagreement counts only when it has come several times in a row."""
    until = kept_until(car, tolerance, feet, count, old)
    memory.disagreed = 0 if until > -math.inf else memory.disagreed + 1
    if 0 < memory.disagreed < DOUBTED:
        until = kept_until(car, DOUBT * tolerance, feet, count, old)
    return until


@inlined
def _fade(s, begin, end):
    """Share of the new line at an arc length (m) between two: its slope is 0 at both."""
    u = clip((s - begin) / max(end - begin, 1e-9), 0.0, 1.0)
    return u * u * (3.0 - 2.0 * u)


@inlined
def join(nodes, count, feet, until, car, line, old, points):
    """Write the points (n, 2) of a line: the one before up to an arc length (m), then the nodes; how many these are.

    until: -inf: the nodes alone. old: (n, 3), points of the line before with their arc lengths. The first rows of
    points (`FRONT_ROOM`) stay free.
    """
    written, first = FRONT_ROOM, 0
    begin = car.station - BEHIND - BEHIND_TIME * car.speed - LONGEST_STEP
    fade = max(until - FADE_TIME * car.speed - FADE_WAY, car.station)
    if until > -math.inf and count > 1:
        for i in range(len(old)):
            s = old[i, 2]
            if not begin <= s <= until:
                continue
            aside, first = _offset_at(s, feet, count, first)
            aside *= _fade(s, fade, until)
            _, _, heading, _ = point_at(s, line)
            points[written, 0], points[written, 1] = old[i, 0] - aside * sin(heading), old[i, 1] + aside * cos(heading)
            written += 1
    for j in range(count):
        x, y = nodes[j, NODE.x], nodes[j, NODE.y]
        if written > FRONT_ROOM:
            near = 0.5 * step_at(nodes[j, NODE.speed])
            is_near = hypot(x - points[written - 1, 0], y - points[written - 1, 1]) < near
            if (is_near or feet[j, 0] <= until) and j < count - 1:
                continue
            if is_near:
                written -= 1  # the last node is where the line ends
        points[written, 0], points[written, 1] = x, y
        written += 1
    return written


@inlined
def _direction(k, points):
    """Direction of a line (unit vector) from a point to the next."""
    dx, dy = points[k + 1, 0] - points[k, 0], points[k + 1, 1] - points[k, 1]
    way = hypot(dx, dy)
    return dx / way, dy / way


@inlined
def extend(car, nodes, written, points):
    """Let a line begin behind the car, straight along its tangent there: the first row that counts.

    nodes: of which a single one is followed by a point ahead of it; written: rows of points so far.
    """
    first = FRONT_ROOM
    x, y = points[first, 0], points[first, 1]
    dx, dy = nodes[1, NODE.x] - nodes[0, NODE.x], nodes[1, NODE.y] - nodes[0, NODE.y]
    if dx != dx:  # the yaw is not known: that of the car
        dx, dy = cos(car.yaw), sin(car.yaw)
    if written - first > 1:
        dx, dy = _direction(first, points)
    if written - first > 2:  # from the directions of two steps to that at the first point
        next_x, next_y = _direction(first + 1, points)
        dx, dy = 1.5 * dx - 0.5 * next_x, 1.5 * dy - 0.5 * next_y
    ahead = (x - car.x) * dx + (y - car.y) * dy if car.x == car.x else 0.0  # m, of the car
    needed, missing = ahead + BEHIND + BEHIND_TIME * car.speed, MIN_PATH_POINTS - (written - first)
    if needed <= 0.0 and missing <= 0:
        return first
    added = min(max(MIN_PATH_POINTS, missing), FRONT_ROOM)
    step = max(needed, BEHIND) / added
    for k in range(added):
        first -= 1
        points[first, 0], points[first, 1] = x - (k + 1) * step * dx, y - (k + 1) * step * dy
    return first

"""Follow the trajectories of a planner: write their lines, speeds and times, and detect a planner that falls silent.

`take_trajectory` writes a line with its speeds and times to a buffer of the caller. The caller lets the record of the
tracker refer to it, then calls `begin_trajectory`.
"""

from __future__ import annotations

import math

from ..controllers.contract import wrapped
from ..input_check.hypotheses import MISTAKES
from ..input_check.record import memory_of, report, settings_of
from ..kernel import (
    OK,
    Place,
    columns,
    exported,
    float64,
    inlined,
    int64,
    int_vector,
    matrix,
    record,
    several,
    shaped,
    vector,
    void,
)
from ..maths.exact import clip, square
from ..physics.forces import GRAVITY
from ..planned import clock, splice
from ..planned.condition import condition, is_rest
from ..planned.meant_line import FAR_SHARE, FAR_TIME, hides_error, remember_place
from ..planned.records import FALLBACK, NOBODY, NODE, PLANNER, POINT, STOP, PlannedSpeeds
from ..planned.timing import time_at
from ..roads.noise import noise_of, smooth_points
from ..roads.path import PATH_SCRATCH, cells_of, line_in, path_through, words_of
from ..roads.road import LENGTH, foot_near, nearest
from . import pose
from .records import ACROSS_PENALTY, TrackerRecord
from .take_call import tracker_follow

LINE_FLAW = 100
"""Added to a status of `roads.path.path_through`: no line can be fitted to the nodes."""
MIN_NODE_SPEED, MIN_PLACE_STEP = 0.1, 1e-3
"""m/s, m: least speed at a node that is no rest; least distance of two places of the speeds."""
LONGEST_WAIT, LENGTH_ROOM = 0.5, 100.0
"""s, m: longest time over which the car is extrapolated to the arrival of a trajectory; by how much a line may be
longer than its trajectory."""
MAX_REFERENCE_OFFSET = 1.0
"""m: the reference moves at once to a line that is farther from the line before."""
FIT_OFFSET, FIT_ANGLE, FIT_TIME = 1.0, math.radians(10.0), 1.0
"""m, rad, s: a fallback, or a planner that returns, must begin so near the car. Its first node may be ahead by this
offset and the way in this time."""
HARDEST_STOP = 8.0
"""m/s^2, largest deceleration of the car up to the end of a fallback."""
MIN_RETURNED = 3
"""Trajectories in a row that must fit the car before a planner that was silent drives again."""
KEPT_POINTS, TRAJECTORY_LENGTH = 256, 1000.0
"""-, m: points of the followed line that a program with fixed memory keeps, and the length of a trajectory for which it
has room."""

Arrival = record("Arrival", (("stamp", float64), ("time", float64), ("role", int64), ("is_urgent", int64)))
"""Arrival of a trajectory: stamp (s, on the planner's clock), time (s, on the tracker's), `PLANNER` or `FALLBACK`."""
PARTS = columns("points", "speeds", "stops", "speeds_at", "room", "stops_at", "path_at")
"""Parts of a buffer, which begins with the points (rows of x, y, arc length): numbers of points, of places of speeds
and of stops; where the columns of the speeds begin, `room` numbers each; where stops (m) and the path begin."""


# -- the buffer -------------------------------------------------------------------------------------------------------
Buffers = record(
    "Buffers",
    (
        ("points", matrix), ("nodes", matrix), ("feet", matrix), ("path_feet", matrix), ("speeds", PlannedSpeeds),
        ("stops", vector), ("path", vector),
    ),
)  # fmt: skip
"""Parts of a buffer: points of a line, nodes, feet on the line before and on the path, speeds, stops (m), a path."""
_SPEEDS_AT, _STOPS_AT, _PATH_AT = 12, 16, 17
"""Columns before these parts."""


@inlined
def _room_for(count, old_count):
    """Rows of each part of a buffer, for `count` planned points and `old_count` of the line before."""
    return splice.FRONT_ROOM + old_count + 2 * count + 2


@exported(int64(int64, int64, float64))
def trajectory_words(count, old_count, length):
    """Size of the buffer (numbers) for a trajectory with some number of points and some length (m).

    old_count: number of points of the followed line.
    """
    room = _room_for(count, old_count)
    return _PATH_AT * room + words_of(room + room // 4 + 16, cells_of(length + LENGTH_ROOM)) + PATH_SCRATCH * room


@inlined
def buffers_in(buffer, room):
    """Return the parts of a buffer."""
    points, nodes = shaped(buffer[: 3 * room], room, 3), shaped(buffer[3 * room : 8 * room], room, len(NODE))
    feet, path_feet = buffer[8 * room : 10 * room], buffer[10 * room : _SPEEDS_AT * room]
    speeds = shaped(buffer[_SPEEDS_AT * room : _STOPS_AT * room], 4, room)
    return Buffers(
        points, nodes, shaped(feet, room, 2), shaped(path_feet, room, 2),
        PlannedSpeeds(speeds[0], speeds[1], speeds[2], speeds[3]),
        buffer[_STOPS_AT * room : _PATH_AT * room], buffer[_PATH_AT * room :],
    )  # fmt: skip


# -- the car ----------------------------------------------------------------------------------------------------------
@inlined
def _extrapolate_car(time, tracker):
    """The car at a time (s) on the line that it follows (`CarOnLine`)."""
    m = tracker.memory[0]
    if m.started == 0:
        return splice.CarOnLine(math.nan, math.nan, 0.0, 0.0, math.nan)
    elapsed = clip(time - pose.time_of(m, tracker.settings[0].period), 0.0, LONGEST_WAIT)
    x, y, yaw = pose.carried(m, elapsed, pose.forward(m), m.yaw_rate)
    station = m.station + elapsed * pose.forward(m) if m.offset == m.offset else math.nan
    return splice.CarOnLine(x, y, yaw, pose.forward(m), station)


@inlined
def _nearest_station(car, line):
    """Arc length (m) of the point of a line that is nearest to the car, in its direction."""
    return nearest(car.x, car.y, car.yaw, ACROSS_PENALTY, math.nan, line)


@inlined
def _begins_at_car(car, nodes, line):
    """Whether the car is near a line and drives in its direction, and the first node is not far ahead."""
    if car.x != car.x:
        return False
    s = _nearest_station(car, line)
    _, offset, heading, _ = foot_near(car.x, car.y, s, line)
    first, _, _, _ = foot_near(nodes[0, NODE.x], nodes[0, NODE.y], s, line)
    is_ahead = first - s > FIT_OFFSET + FIT_TIME * car.speed
    return abs(offset) <= FIT_OFFSET and abs(wrapped(car.yaw - heading)) <= FIT_ANGLE and not is_ahead


@inlined
def _is_fit_fallback(friction, car, nodes, count, line):
    """Whether a fallback begins at the car, ends at rest far enough ahead, and needs at most a friction in its bends.

    friction: low end of the estimate; NaN: unknown.
    """
    if not _begins_at_car(car, nodes, line) or nodes[count - 1, NODE.leave] < math.inf:
        return False
    if square(car.speed) > 2.0 * HARDEST_STOP * (line.numbers[LENGTH] - _nearest_station(car, line) + FIT_OFFSET):
        return False
    s = 0.0
    for j in range(count):
        s, _, _, curvature = foot_near(nodes[j, NODE.x], nodes[j, NODE.y], s, line)
        if square(nodes[j, NODE.speed]) * abs(curvature) > friction * GRAVITY:
            return False
    return True


@inlined
def _must_wait(arrival, car, nodes, line, settings, memory):
    """Whether a planner that was silent must first send more trajectories in a row that begin at the car."""
    if memory.driven_by != FALLBACK and memory.driven_by != STOP:
        return False
    is_late = arrival.time - memory.arrival > settings.silence
    memory.returned = (0 if is_late else memory.returned) + 1 if _begins_at_car(car, nodes, line) else 0
    return memory.returned < MIN_RETURNED


# -- line and speeds --------------------------------------------------------------------------------------------------
@inlined
def _write_line(arrival, car, count, buffers, tracker):
    """Smooth and thin the nodes, join them to the followed line, and write the points and path of the result.

    Return `OK` or a status with `LINE_FLAW`, and the numbers of nodes and points.
    """
    planned, nodes, points, until = tracker.planned, buffers.nodes, buffers.points, -math.inf
    feet, path_feet, noise = buffers.feet, buffers.path_feet, noise_of(nodes[:count], False, buffers.path)
    if noise > 0.0:
        smooth_points(nodes[:count], False, noise, buffers.path)
    count = splice.thin_nodes(nodes, count)
    if car.station == car.station:
        splice.project_nodes(nodes, count, car.station, pose.line(tracker), feet)
        if arrival.role == PLANNER and arrival.is_urgent == 0:
            sigma = settings_of(tracker.check.settings, 0).position_noise
            until = splice.confirmed_agreement_end(car, sigma, noise, feet, count, planned.points, planned.memory[0])
    end = splice.write_points(nodes, count, feet, until, car, pose.line(tracker), planned.points, points)
    first = splice.prepend_points(car, nodes, end, points)
    flaw, _ = path_through(points[first:end], False, 0.0, buffers.path)
    if flaw != OK:
        return LINE_FLAW + flaw, count, 0
    line, _ = line_in(buffers.path)
    splice.project_nodes(points[first:end], end - first, 0.0, line, path_feet)
    for k in range(end - first):
        points[k, 0], points[k, 1], points[k, 2] = points[first + k, 0], points[first + k, 1], path_feet[k, 0]
    return OK, count, end - first


@inlined
def _write_speeds(count, line, buffers):
    """Write speeds and times of nodes along their line, and the stops (m); return the numbers of places and stops."""
    nodes, speeds, stops, feet = buffers.nodes, buffers.speeds, buffers.stops, buffers.path_feet
    k, length, stop_count = -1, line.numbers[LENGTH], 0
    splice.project_nodes(nodes, count, 0.0, line, feet)
    for j in range(count):
        node, place = nodes[j], length if j == count - 1 else clip(feet[j, 0], 0.0, length)
        speed = max(node[NODE.speed], MIN_NODE_SPEED)
        if j == 0 and place > MIN_PLACE_STEP:  # the line begins behind the trajectory
            speeds.s[0], speeds.speed[0] = 0.0, speed
            speeds.arrive[0] = speeds.leave[0] = node[NODE.arrive] - place / speed
            k = 0
        if k < 0 or place > speeds.s[k] + MIN_PLACE_STEP:
            k += 1
            speeds.s[k] = place
        speeds.arrive[k], speeds.leave[k] = node[NODE.arrive], node[NODE.leave]
        speeds.speed[k] = 0.0 if is_rest(nodes, j) else speed
    speeds.s[0] = 0.0
    for j in range(1, k + 1):
        if speeds.leave[j] > speeds.arrive[j]:
            stops[stop_count] = speeds.s[j]
            stop_count += 1
    return k + 1, stop_count


@inlined
def first_speeds(count, speeds):
    """The first `count` places of speeds (`PlannedSpeeds`)."""
    return PlannedSpeeds(speeds.s[:count], speeds.speed[:count], speeds.arrive[:count], speeds.leave[:count])


@inlined
def _shift_times(time, station, count, speeds):
    """Shift the times of the first `count` places so that a car at a station (m) is on time at a time (s)."""
    shift = time - time_at(station, first_speeds(count, speeds))
    for k in range(count):
        speeds.arrive[k], speeds.leave[k] = speeds.arrive[k] + shift, speeds.leave[k] + shift


# -- a trajectory -----------------------------------------------------------------------------------------------------
@inlined
def _checksum_of(points):
    """A number that differs for almost all trajectories of different times or poses."""
    total = 0.0
    for j in range(len(points)):
        for i in range(POINT.speed):
            total = points[j, i] - 0.9999 * total if points[j, i] == points[j, i] else total
    return total


@inlined
def _watch_meant_line(arrival, car, count, buffers, tracker):
    """Report a planner that hides the error of the controller, and store a place of this trajectory."""
    planned, nodes, feet = tracker.planned, buffers.nodes, buffers.feet
    memory, sigma = planned.memory[0], settings_of(tracker.check.settings, 0).position_noise
    if car.station == car.station and count > 1:
        elapsed = clip(arrival.time - memory.arrival, 0.0, 1.0)
        line_offset, _ = splice.interpolate_offset(car.station, feet, count, 0)
        if hides_error(car.x, car.y, tracker.memory[0].offset - line_offset, elapsed, sigma, planned.far, memory):
            report(memory_of(tracker.check.memory, 0), MISTAKES.plan_begins_at_car, abs(memory.meant_offset), 0.0, 0.0)
    time_ahead = min(FAR_TIME, FAR_SHARE * (nodes[count - 1, NODE.arrive] - arrival.time))
    if time_ahead > 0.0:
        k = 0
        while k < count - 1 and nodes[k, NODE.arrive] < arrival.time + time_ahead:
            k += 1
        remember_place(nodes[k, NODE.x], nodes[k, NODE.y], planned.far, memory)


@exported(several(int64, int64, int64)(matrix, Arrival, float64, Place(TrackerRecord), vector, int_vector))
def take_trajectory(points, arrival, friction, tracker, buffer, parts):
    """Convert a trajectory, `POINT` (n, 7), to a line with speeds and times in a buffer (`trajectory_words`).

    friction: low end of the estimate, for a fallback; NaN: unknown. parts: `PARTS`. Return a verdict of
    `planned.clock`, a status of `planned.condition` or one with `LINE_FLAW`, and the index of the point that it is
    about. The car goes on as before until `begin_trajectory`.
    """
    planned, checksum, is_fallback = tracker.planned, _checksum_of(points), arrival.role == FALLBACK
    settings, memory = planned.settings[0], planned.memory[0]
    if len(points) == 0:
        return clock.VERDICT.silent, OK, 0
    begins = arrival.time
    if not is_fallback:
        verdict, begins = clock.convert_stamp(arrival.stamp, arrival.time, settings, memory)
        if verdict != clock.VERDICT.taken:
            return verdict, OK, 0
        if memory.driven_by == PLANNER and checksum == memory.checksum:
            memory.stamp, memory.arrival = max(memory.stamp, arrival.stamp), arrival.time
            return clock.VERDICT.same, OK, 0
    room = _room_for(len(points), len(planned.points))
    buffers = buffers_in(buffer, room)
    nodes = buffers.nodes
    status, entry, count = condition(points, settings.tracked_arm, begins, nodes)
    if count == 0:
        return clock.VERDICT.taken, status, entry
    car = _extrapolate_car(arrival.time, tracker)
    flaw, count, point_count = _write_line(arrival, car, count, buffers, tracker)
    if flaw != OK:
        return clock.VERDICT.taken, flaw, 0
    line, _ = line_in(buffers.path)
    if is_fallback and not _is_fit_fallback(friction, car, nodes, count, line):
        return clock.VERDICT.unfit, OK, 0
    if not is_fallback and _must_wait(arrival, car, nodes, line, settings, memory):
        memory.stamp, memory.arrival = arrival.stamp, arrival.time
        return clock.VERDICT.waiting, OK, 0
    place_count, stop_count = _write_speeds(count, line, buffers)
    if is_fallback:
        _shift_times(arrival.time, _nearest_station(car, line), place_count, buffers.speeds)
    else:
        _watch_meant_line(arrival, car, count, buffers, tracker)
        memory.stamp, memory.arrival, memory.checksum = arrival.stamp, arrival.time, checksum
    parts[PARTS.points], parts[PARTS.speeds], parts[PARTS.stops] = point_count, place_count, stop_count
    parts[PARTS.speeds_at], parts[PARTS.stops_at] = _SPEEDS_AT * room, _STOPS_AT * room
    parts[PARTS.path_at], parts[PARTS.room] = _PATH_AT * room, room
    return clock.VERDICT.taken, status, entry


@exported(void(Arrival, Place(TrackerRecord)))
def begin_trajectory(arrival, tracker):
    """Start to follow the trajectory that `tracker` now refers to.

    The reference stays at its place and moves gradually to the new line; at once if the trajectory is urgent, or if the
    lines are far from each other.
    """
    m, memory = tracker.memory[0], tracker.planned.memory[0]
    old_offset = m.offset
    tracker_follow(math.nan, tracker)
    is_gradual = arrival.is_urgent == 0 and abs(m.offset - old_offset) <= MAX_REFERENCE_OFFSET
    m.aside = clip(m.aside + m.offset - old_offset, -MAX_REFERENCE_OFFSET, MAX_REFERENCE_OFFSET) if is_gradual else 0.0
    memory.driven_by, memory.debt, memory.is_leaving = arrival.role, 0.0, 0


@exported(void(Place(TrackerRecord)))
def leave_planner(tracker):
    """Stop following trajectories; the tracker follows a path without times."""
    clock.forget_planner(tracker.planned.memory[0])
    tracker.planned.memory[0].driven_by = NOBODY


@exported(int64(float64, Place(TrackerRecord)))
def watch_planner(time, tracker):
    """Return 1 if the planner has just fallen silent at a time (s): take a fallback, otherwise the car stops."""
    settings, memory = tracker.planned.settings[0], tracker.planned.memory[0]
    if memory.arrival == -math.inf:  # the tracker has just engaged
        memory.arrival = time
    if memory.driven_by != PLANNER or time - memory.arrival <= settings.silence:
        return 0
    memory.driven_by, memory.returned = STOP, 0
    return 1

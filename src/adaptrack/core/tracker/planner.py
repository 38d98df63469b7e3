"""A tracker that follows a planner: a trajectory becomes a line with speeds and times, and who drives when none comes.

`take_trajectory` writes what is to be followed into a memory of the caller, who lets the tracker's record lie there and
then calls `begin_trajectory`.
"""

from __future__ import annotations

import math

from ..controllers.contract import wrapped
from ..input_check.hypotheses import MISTAKES
from ..input_check.record import memory_of, report
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
from ..maths.exponential import hypot
from ..physics.forces import GRAVITY
from ..planned import clock, splice
from ..planned.condition import condition
from ..planned.meant_line import FAR_SHARE, FAR_TIME, hides_error, remember_place
from ..planned.records import FALLBACK, GIVEN, NODE, PLANNER, STOP, PlannedSpeeds
from ..planned.timing import time_at
from ..roads.noise import noise_of, smooth_points
from ..roads.path import PATH_SCRATCH, cells_of, line_in, path_through, words_of
from ..roads.road import LENGTH, foot_near, nearest
from . import pose
from .records import ACROSS_PENALTY, TrackerRecord
from .take_call import tracker_follow

LINE_FLAW = 100
"""Added to a status of `roads.path.path_through`: no line can be made of the nodes."""
LEAST_SPEED, LEAST_STEP = 0.1, 1e-3
"""m/s, of a node that is no rest; m, between two places of the speeds."""
LONGEST_WAIT, LENGTH_ROOM, SMOOTHING_WORDS = 0.5, 100.0, 14
"""s, by which the car is carried to the arrival of a trajectory at most; m, by which a line may be longer than its
trajectory; numbers for each node that smoothing needs."""
MOST_ASIDE = 1.0
"""m: a line that lies farther beside the one before is taken at once."""
FIT_OFFSET, FIT_ANGLE, FIT_TIME = 1.0, math.radians(10.0), 1.0
"""m, rad, s: a fallback, and a planner that returns, begin so near the car, and so far ahead at most as way."""
HARDEST_STOP = 8.0
"""m/s^2, with which a car may have to stop before the end of a fallback."""
RETURNED = 3
"""Trajectories in a row that fit, after which a planner that was silent drives again."""

Arrival = record("Arrival", (("stamp", float64), ("time", float64), ("role", int64), ("is_urgent", int64)))
"""Of a trajectory: stamp (s, on the planner's clock), time (s, on the tracker's), `PLANNER` or `FALLBACK`."""
PARTS = columns("points", "speeds", "stops", "speeds_at", "room", "stops_at", "path_at")
"""Parts of a memory: how many points (rows of x, y, arc length, at its beginning), places of speeds, and stops;
where the columns of the speeds begin, `room` numbers each; where stops (m) and the path begin."""


# -- the memory -------------------------------------------------------------------------------------------------------
Rooms = record(
    "Rooms",
    (
        ("points", matrix), ("nodes", matrix), ("feet", matrix), ("speeds", PlannedSpeeds), ("stops", vector),
        ("path", vector),
    ),
)  # fmt: skip
"""Parts of a memory: points of a line, at first nodes and their feet on the line before, speeds, stops, and a path."""


@inlined
def _most_nodes(count):
    """Nodes of so many given points, and room in which they are made."""
    return 2 * count + 2


@inlined
def _most_points(count, kept):
    """Points of a line through so many given points, and so many of the line before."""
    return splice.FRONT_ROOM + kept + _most_nodes(count)


@inlined
def _words_before_path(count, kept):
    """How many numbers come before the path."""
    return 3 * _most_points(count, kept) + (len(NODE) + 2) * _most_nodes(count) + 5 * (_most_nodes(count) + 2)


@exported(int64(int64, int64, float64))
def trajectory_words(count, kept, length):
    """How many numbers of memory a trajectory needs, of so many points and some length (m).

    kept: points of the line that is followed.
    """
    points = _most_points(count, kept)
    noise = SMOOTHING_WORDS * _most_nodes(count)
    line = words_of(points + points // 4 + 16, cells_of(length + LENGTH_ROOM)) + PATH_SCRATCH * points
    return _words_before_path(count, kept) + max(line, noise)


@inlined
def _rooms_in(memory, count, kept):
    """The parts of a memory."""
    points, nodes = _most_points(count, kept), _most_nodes(count)
    at_nodes = 3 * points
    at_feet = at_nodes + len(NODE) * nodes
    at_speeds, places = at_feet + 2 * nodes, nodes + 2
    at_stops = at_speeds + 4 * places
    speeds = PlannedSpeeds(
        memory[at_speeds : at_speeds + places], memory[at_speeds + places : at_speeds + 2 * places],
        memory[at_speeds + 2 * places : at_speeds + 3 * places], memory[at_speeds + 3 * places : at_stops],
    )  # fmt: skip
    return Rooms(
        shaped(memory[:at_nodes], points, 3), shaped(memory[at_nodes:at_feet], nodes, len(NODE)),
        shaped(memory[at_feet:at_speeds], nodes, 2), speeds, memory[at_stops : at_stops + places],
        memory[at_stops + places :],
    )  # fmt: skip


# -- the car ----------------------------------------------------------------------------------------------------------
@inlined
def _car_at(time, tracker):
    """The car at a time (s), on the line that it follows."""
    m = tracker.memory[0]
    if m.started == 0:
        return splice.CarOnLine(math.nan, math.nan, 0.0, 0.0, math.nan)
    since = clip(time - pose.time_of(m, tracker.settings[0].period), 0.0, LONGEST_WAIT)
    x, y, yaw = pose.carried(m, since, pose.forward(m), m.yaw_rate)
    station = m.station + since * pose.forward(m) if m.offset == m.offset else math.nan
    return splice.CarOnLine(x, y, yaw, pose.forward(m), station)


@inlined
def _fits(car, nodes, line):
    """Whether a line leads on from the car: it is near, in its direction, and its first node is not far ahead."""
    if car.x != car.x:
        return False
    s = nearest(car.x, car.y, car.yaw, ACROSS_PENALTY, math.nan, line)
    _, offset, heading, _ = foot_near(car.x, car.y, s, line)
    first, _, _, _ = foot_near(nodes[0, NODE.x], nodes[0, NODE.y], s, line)
    is_ahead = first - s > FIT_OFFSET + FIT_TIME * car.speed
    return abs(offset) <= FIT_OFFSET and abs(wrapped(car.yaw - heading)) <= FIT_ANGLE and not is_ahead


# -- speeds -----------------------------------------------------------------------------------------------------------
@inlined
def _write_speeds(nodes, count, line, speeds):
    """Write speeds and times of nodes along their line, from 0 to its length; how many places these are."""
    k, s, length = -1, 0.0, line.numbers[LENGTH]
    for j in range(count):
        node, is_rest = nodes[j], nodes[j, NODE.leave] > nodes[j, NODE.arrive]
        if j > 0:
            s += hypot(node[NODE.x] - nodes[j - 1, NODE.x], node[NODE.y] - nodes[j - 1, NODE.y])
        s, _, _, _ = foot_near(node[NODE.x], node[NODE.y], s, line)
        place = length if j == count - 1 else clip(s, 0.0, length)
        if j == 0 and place > LEAST_STEP:  # the line begins behind the trajectory
            speeds.s[0], speeds.speed[0] = 0.0, max(node[NODE.speed], LEAST_SPEED)
            speeds.arrive[0] = speeds.leave[0] = node[NODE.arrive] - place / speeds.speed[0]
            k = 0
        if k < 0 or place > speeds.s[k] + LEAST_STEP:
            k += 1
            speeds.s[k] = place
        speeds.arrive[k], speeds.leave[k] = node[NODE.arrive], node[NODE.leave]
        speeds.speed[k] = 0.0 if is_rest else max(node[NODE.speed], LEAST_SPEED)
    speeds.s[0] = 0.0
    return k + 1


@inlined
def _write_stops(count, speeds, stops):
    """Write the places (m) where the car is to stand; how many these are."""
    written = 0
    for k in range(1, count):
        if speeds.leave[k] > speeds.arrive[k]:
            stops[written] = speeds.s[k]
            written += 1
    return written


@inlined
def _is_no_fallback(friction, car, nodes, count, line):
    """Whether nodes do not end at rest, or end too near ahead of the car, or need more than a friction in their bends.

    friction: its low end; NaN: unknown.
    """
    s = nearest(car.x, car.y, car.yaw, ACROSS_PENALTY, math.nan, line)
    left = line.numbers[LENGTH] - s + FIT_OFFSET
    if nodes[count - 1, NODE.leave] < math.inf or square(car.speed) > 2.0 * HARDEST_STOP * left:
        return True
    s = 0.0
    for j in range(count):
        s, _, _, curvature = foot_near(nodes[j, NODE.x], nodes[j, NODE.y], s, line)
        if square(nodes[j, NODE.speed]) * abs(curvature) > friction * GRAVITY:
            return True
    return False


# -- a trajectory -----------------------------------------------------------------------------------------------------
@inlined
def _checksum_of(given):
    """A number that two trajectories share only if their times and poses are alike."""
    total = 0.0
    for j in range(len(given)):
        for i in range(GIVEN.speed):
            total = given[j, i] - 0.9999 * total if given[j, i] == given[j, i] else total
    return total


@inlined
def _smooth(nodes, count, scratch):
    """Smooth the noise of the places of nodes, and return it (m)."""
    noise = noise_of(nodes[:count], False, scratch)
    if noise > 0.0:
        smooth_points(nodes[:count], False, noise, scratch)
    return noise


@inlined
def _write_line(arrival, car, count, noise, rooms, tracker):
    """Write points and path of nodes, joined to the line that is followed; `OK` or what is wrong, and how many points.

    noise: m, of the nodes.
    """
    planned, until = tracker.planned, -math.inf
    if car.station == car.station:
        splice.project(rooms.nodes, count, car.station, pose.line(tracker), rooms.feet)
    if car.station == car.station and arrival.role == PLANNER and arrival.is_urgent == 0:
        tolerance = splice.tolerance_of(planned.settings[0].position_noise, noise)
        until = splice.agreed_until(car, tolerance, rooms.feet, count, planned.points, planned.memory[0])
    points = rooms.points
    end = splice.join(rooms.nodes, count, rooms.feet, until, car, pose.line(tracker), planned.points, points)
    first = splice.extend(car, rooms.nodes, end, points)
    flaw, _ = path_through(points[first:end], False, 0.0, rooms.path)
    if flaw != OK:
        return LINE_FLAW + flaw, 0
    line, s = _path(rooms), 0.0
    for k in range(end - first):
        x, y = points[first + k, 0], points[first + k, 1]
        if k > 0:
            s += hypot(x - points[k - 1, 0], y - points[k - 1, 1])
        s, _, _, _ = foot_near(x, y, s, line)
        points[k, 0], points[k, 1], points[k, 2] = x, y, s
    return OK, end - first


@inlined
def _path(rooms):
    """The line in a memory."""
    line, _ = line_in(rooms.path)
    return line


@inlined
def _waits(arrival, car, rooms, settings, memory):
    """Whether a planner that was silent has still to show that it is back: trajectories in a row that fit the car."""
    if memory.driven_by != FALLBACK and memory.driven_by != STOP:
        return False
    is_late = arrival.time - memory.arrival > settings.silence
    memory.returned = (0 if is_late else memory.returned) + 1 if _fits(car, rooms.nodes, _path(rooms)) else 0
    return memory.returned < RETURNED


@inlined
def _let_be_on_time(time, car, count, rooms):
    """Shift the times of so many places so that the car is on time, wherever it is, at a time (s)."""
    station, speeds = nearest(car.x, car.y, car.yaw, ACROSS_PENALTY, math.nan, _path(rooms)), rooms.speeds
    own = PlannedSpeeds(speeds.s[:count], speeds.speed[:count], speeds.arrive[:count], speeds.leave[:count])
    shift = time - time_at(station, own)
    for k in range(count):
        speeds.arrive[k], speeds.leave[k] = speeds.arrive[k] + shift, speeds.leave[k] + shift


@inlined
def _watch_meant_line(arrival, car, count, rooms, tracker):
    """Say it where the planner hides the error of the controller, and keep what this trajectory means."""
    planned, nodes = tracker.planned, rooms.nodes
    settings, memory = planned.settings[0], planned.memory[0]
    if car.station == car.station:
        beside = 0
        while beside < count - 1 and rooms.feet[beside + 1, 0] <= car.station:
            beside += 1
        elapsed = clip(arrival.time - memory.arrival, 0.0, 1.0)
        given_offset = tracker.memory[0].offset - rooms.feet[beside, 1]
        if hides_error(car.x, car.y, given_offset, elapsed, settings, planned.far, memory):
            inputs = memory_of(tracker.check.memory, 0)
            report(inputs, MISTAKES.plan_begins_at_car, abs(memory.meant_offset), 0.0, 0.0)
    ahead = min(FAR_TIME, FAR_SHARE * (nodes[count - 1, NODE.arrive] - arrival.time))
    if ahead > 0.0:
        far = 0
        while far < count - 1 and nodes[far, NODE.arrive] < arrival.time + ahead:
            far += 1
        remember_place(nodes[far, NODE.x], nodes[far, NODE.y], planned.far, memory)


@inlined
def _stamp(given, arrival, settings, memory):
    """A verdict by the stamp of a trajectory and by whether it is new, and its time 0 on the tracker's clock."""
    if len(given) == 0:
        return clock.SILENT, arrival.time
    if arrival.role != PLANNER:
        return clock.TAKEN, arrival.time
    verdict, begins = clock.place_stamp(arrival.stamp, arrival.time, settings, memory)
    if verdict == clock.TAKEN and memory.driven_by == PLANNER and _checksum_of(given) == memory.checksum:
        verdict = clock.SAME
    return verdict, begins


@exported(several(int64, int64, int64)(matrix, Arrival, float64, Place(TrackerRecord), vector, int_vector))
def take_trajectory(given, arrival, friction, tracker, memory, parts):
    """Take in a trajectory, `GIVEN` (n, 7), and write what is to be followed to a memory (`trajectory_words`).

    friction: low end now, for a fallback; NaN: unknown. parts: `PARTS`. Return a verdict of `planned.clock`, a status
    of `planned.condition`, or `LINE_FLAW` and more, and the number of the point that it is about. Nothing changes for
    the car before `begin_trajectory`.
    """
    planned = tracker.planned
    settings, own = planned.settings[0], planned.memory[0]
    verdict, begins = _stamp(given, arrival, settings, own)
    if verdict == clock.SAME:
        own.stamp, own.arrival = max(own.stamp, arrival.stamp), arrival.time
    if verdict != clock.TAKEN:
        return verdict, OK, 0
    rooms = _rooms_in(memory, len(given), len(planned.points))
    status, entry, count = condition(given, settings.tracked_arm, begins, rooms.nodes)
    if count == 0:
        return verdict, status, entry
    noise = _smooth(rooms.nodes, count, rooms.path)
    count, car = splice.thin(rooms.nodes, count), _car_at(arrival.time, tracker)
    flaw, points = _write_line(arrival, car, count, noise, rooms, tracker)
    if flaw != OK:
        return verdict, flaw, 0
    line = _path(rooms)
    is_fallback = arrival.role == FALLBACK
    if is_fallback and (not _fits(car, rooms.nodes, line) or _is_no_fallback(friction, car, rooms.nodes, count, line)):
        return clock.UNFIT, OK, 0
    if not is_fallback and _waits(arrival, car, rooms, settings, own):
        own.stamp, own.arrival = arrival.stamp, arrival.time
        return clock.WAITING, OK, 0
    places = _write_speeds(rooms.nodes, count, line, rooms.speeds)
    if is_fallback:
        _let_be_on_time(arrival.time, car, places, rooms)
    else:
        _watch_meant_line(arrival, car, count, rooms, tracker)
        own.stamp, own.arrival, own.checksum = arrival.stamp, arrival.time, _checksum_of(given)
    parts[PARTS.points], parts[PARTS.speeds], parts[PARTS.room] = points, places, rooms.speeds.s.size
    parts[PARTS.stops] = _write_stops(places, rooms.speeds, rooms.stops)
    parts[PARTS.path_at] = _words_before_path(len(given), len(planned.points))
    parts[PARTS.stops_at] = parts[PARTS.path_at] - rooms.stops.size
    parts[PARTS.speeds_at] = parts[PARTS.stops_at] - 4 * rooms.speeds.s.size
    return verdict, status, entry


@exported(void(Arrival, Place(TrackerRecord)))
def begin_trajectory(arrival, tracker):
    """Go over to the trajectory that `tracker` has now in place of another.

    The reference stays where it was, beside the new line, and comes to it gradually; where it is urgent, or the lines
    are far from each other, at once.
    """
    m, own = tracker.memory[0], tracker.planned.memory[0]
    before, near = m.offset, math.nan
    if m.started > 0 and pose.has_path(tracker):
        near = nearest(m.x, m.y, m.yaw, ACROSS_PENALTY, math.nan, pose.line(tracker))
    tracker_follow(near, tracker)
    aside = m.aside + m.offset - before
    m.aside = aside if arrival.is_urgent == 0 and abs(m.offset - before) <= MOST_ASIDE else 0.0
    m.aside = clip(m.aside, -MOST_ASIDE, MOST_ASIDE)
    own.driven_by, own.debt, own.is_leaving = arrival.role, 0.0, 0


@exported(void(Place(TrackerRecord)))
def leave_planner(tracker):
    """Follow no trajectory any more: the tracker goes over to a path without times."""
    clock.forget_planner(tracker.planned.memory[0])


@exported(int64(float64, Place(TrackerRecord)))
def watch_planner(now, tracker):
    """Whether the planner has fallen silent by a time (s): a fallback is now to be taken, else the car stops."""
    settings, own = tracker.planned.settings[0], tracker.planned.memory[0]
    if own.driven_by != PLANNER or now - own.arrival <= settings.silence:
        return 0
    own.driven_by, own.returned = STOP, 0
    return 1

"""A tracker that follows a planner: a trajectory becomes a line with speeds and times, and who drives when none comes.

`take_trajectory` writes what is to be followed into a memory of the caller, who lets the tracker's record lie there and
then calls `begin_trajectory`.
"""

from __future__ import annotations

import math

from ..controllers.contract import wrapped
from ..input_check.hypotheses import MISTAKES
from ..input_check.record import memory_of, report
from ..kernel import OK, Place, columns, exported, float64, inlined, int64, int_vector, matrix, record, several, shaped, vector, void
from ..maths.exact import clip, square
from ..physics.forces import GRAVITY
from ..planned import clock, splice
from ..planned.condition import condition
from ..planned.meant_line import FAR_SHARE, FAR_TIME, hides_error, remember_place
from ..planned.records import FALLBACK, NODE, PLANNER, STOP, PlannedSpeeds
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
LONGEST_WAIT = 0.5
"""s, by which the car is carried to the arrival of a trajectory at most."""
MOST_ASIDE = 1.0
"""m: a line that lies farther beside the one before is taken at once."""
FIT_OFFSET, FIT_ANGLE, FIT_TIME = 1.0, math.radians(10.0), 1.0
"""m, rad, s: a fallback, and a planner that returns, begin so near the car, and so far ahead at most as way."""
RETURNED = 3
"""Trajectories in a row that fit, after which a planner that was silent drives again."""

Arrival = record("Arrival", (("stamp", float64), ("time", float64), ("role", int64), ("is_urgent", int64)))
"""Of a trajectory: stamp (s, on the planner's clock), time (s, on the tracker's), `PLANNER` or `FALLBACK`."""
PARTS = columns("points", "speeds", "stops", "speeds_at", "room", "stops_at", "path_at")
"""Parts of a memory: how many points (rows of x, y, arc length, at its beginning), places of speeds and stops there are;
where the columns of the speeds begin, `room` numbers each; where stops (m) and the path begin."""


# -- the memory -------------------------------------------------------------------------------------------------------
@inlined
def _most_points(count, kept):
    """Points of a line through so many given points, and so many of the line before."""
    return splice.FRONT_ROOM + kept + _most_nodes(count)


@inlined
def _most_nodes(count):
    """Nodes of so many given points, and room in which they are made."""
    return 2 * count + 2


@exported(int64(int64, int64, float64))
def trajectory_words(count, kept, length):
    """How many numbers of memory a trajectory of so many points and some length (m) needs; kept: points of the line
    that is followed."""
    points, room = _most_points(count, kept), _most_nodes(count) + 2
    line = words_of(points + points // 4 + 16, cells_of(length + 100.0)) + PATH_SCRATCH * points
    return 3 * points + (len(NODE) + 2 + 5 + 14) * room + line


@inlined
def _speeds_in(memory, count):
    """Room for the speeds at so many places, in the order of `PlannedSpeeds`."""
    return PlannedSpeeds(
        memory[:count], memory[count : 2 * count], memory[2 * count : 3 * count], memory[3 * count : 4 * count]
    )


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
    k, s, length = 0, 0.0, line.numbers[LENGTH]
    speeds.s[0] = 0.0
    for j in range(count):
        node, is_rest = nodes[j], nodes[j, NODE.leave] > nodes[j, NODE.arrive]
        s, _, _, _ = foot_near(node[NODE.x], node[NODE.y], s, line)
        place = length if j == count - 1 else min(s, length)
        if j == 0 or place > speeds.s[k] + LEAST_STEP:
            k += 1
        speeds.s[k], speeds.arrive[k], speeds.leave[k] = place, node[NODE.arrive], node[NODE.leave]
        speeds.speed[k] = 0.0 if is_rest else max(node[NODE.speed], LEAST_SPEED)
    speeds.speed[0] = max(nodes[0, NODE.speed], LEAST_SPEED)
    speeds.arrive[0] = speeds.leave[0] = nodes[0, NODE.arrive] - speeds.s[1] / speeds.speed[0]
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
def _asks_too_much(friction, nodes, count, line):
    """Whether nodes need more than a friction (at its low end; NaN: unknown) in their bends."""
    s = 0.0
    for j in range(count):
        s, _, _, curvature = foot_near(nodes[j, NODE.x], nodes[j, NODE.y], s, line)
        if square(nodes[j, NODE.speed]) * abs(curvature) > friction * GRAVITY:
            return True
    return False


# -- a trajectory -----------------------------------------------------------------------------------------------------
@inlined
def _shape_of(given):
    """A number that two trajectories share only if they are alike."""
    shape = 0.0
    for j in range(len(given)):
        for i in range(4):
            shape = given[j, i] - 0.9999 * shape if given[j, i] == given[j, i] else shape
    return shape


@inlined
def _watch_meant_line(arrival, car, nodes, count, feet, tracker):
    """Say it where the planner hides the error of the controller, and keep what this trajectory means."""
    planned, m = tracker.planned, tracker.memory[0]
    settings, memory = planned.settings[0], planned.memory[0]
    if car.station == car.station:
        nearest_foot = 0
        while nearest_foot < count - 1 and feet[nearest_foot + 1, 0] <= car.station:
            nearest_foot += 1
        elapsed = clip(arrival.time - memory.arrival, 0.0, 1.0)
        given_offset = m.offset - feet[nearest_foot, 1]
        if hides_error(car.x, car.y, given_offset, elapsed, settings, planned.far, memory):
            inputs = memory_of(tracker.check.memory, 0)
            report(inputs, MISTAKES.plan_begins_at_car, abs(memory.meant_offset), 0.0, 0.0)
    span = nodes[count - 1, NODE.arrive] - arrival.time
    due, far = arrival.time + min(FAR_TIME, FAR_SHARE * span), 0
    while far < count - 1 and nodes[far, NODE.arrive] < due:
        far += 1
    if span > 0.0:
        remember_place(nodes[far, NODE.x], nodes[far, NODE.y], planned.far, memory)


@exported(several(int64, int64, int64)(matrix, Arrival, float64, Place(TrackerRecord), vector, int_vector))
def take_trajectory(given, arrival, friction, tracker, memory, parts):
    """Take in a trajectory, `GIVEN` (n, 7), and write what is to be followed to a memory (`trajectory_words`).

    friction: low end now, for a fallback; NaN: unknown. parts: `PARTS`. Return a verdict of `planned.clock`, a
    status of `planned.condition`, `OK` where the trajectory is possible, and the number of the point that is not.
    Nothing changes for the car before `begin_trajectory`.
    """
    planned, m = tracker.planned, tracker.memory[0]
    settings, own = planned.settings[0], planned.memory[0]
    if len(given) == 0:
        return clock.SILENT, OK, 0
    verdict, begins = clock.TAKEN, arrival.time
    if arrival.role == PLANNER:
        verdict, begins = clock.place_stamp(arrival.stamp, arrival.time, settings, own)
    if verdict != clock.TAKEN:
        return verdict, OK, 0
    if arrival.role == PLANNER and own.driven_by == PLANNER and _shape_of(given) == own.shape:
        own.stamp, own.arrival = max(own.stamp, arrival.stamp), arrival.time
        return clock.SAME, OK, 0
    most = _most_points(len(given), len(planned.points))
    points, rest = shaped(memory[: 3 * most], most, 3), memory[3 * most :]
    room = _most_nodes(len(given))
    nodes, rest = shaped(rest[: len(NODE) * room], room, len(NODE)), rest[len(NODE) * room :]
    feet, rest = shaped(rest[: 2 * room], room, 2), rest[2 * room :]
    places, rest = rest[: 4 * (room + 2)], rest[4 * (room + 2) :]
    stops, rest = rest[: room + 2], rest[room + 2 :]
    status, entry, count = condition(given, settings.tracked_arm, begins, nodes)
    if count == 0:
        return verdict, status, entry
    noise = noise_of(nodes[:count], False, rest)
    if noise > 0.0:
        smooth_points(nodes[:count], False, noise, rest)
    count = splice.thin(nodes, count)
    car, until = _car_at(arrival.time, tracker), -math.inf
    if car.station == car.station:
        centreline = pose.line(tracker)
        splice.project(nodes, count, car.station, centreline, feet)
        sigma = splice.AGREEMENT_SIGMAS
        tolerance = max(sigma * settings.position_noise, splice.LEAST_AGREEMENT) + sigma * noise
        if arrival.role == PLANNER and arrival.is_urgent == 0:
            until = splice.kept_until(car, tolerance, feet, count, planned.points)
    written = splice.join(nodes, count, feet, until, car, pose.line(tracker), planned.points, points)
    first = splice.extend(car, nodes, written, points)
    flaw, _ = path_through(points[first:written], False, 0.0, rest)
    if flaw != OK:
        return verdict, LINE_FLAW + flaw, 0
    line, _ = line_in(rest)
    s = 0.0
    for k in range(first, written):
        s, _, _, _ = foot_near(points[k, 0], points[k, 1], s, line)
        points[k, 2] = s
        points[k - first, 0], points[k - first, 1], points[k - first, 2] = points[k, 0], points[k, 1], s
    if arrival.role == FALLBACK:
        if not _fits(car, nodes, line) or _asks_too_much(friction, nodes, count, line):
            return clock.UNFIT, OK, 0
    elif own.driven_by == FALLBACK or own.driven_by == STOP:
        is_late = arrival.time - own.arrival > settings.silence
        own.returned = (0 if is_late else own.returned) + 1 if _fits(car, nodes, line) else 0
        if own.returned < RETURNED:
            own.stamp, own.arrival = arrival.stamp, arrival.time
            return clock.WAITING, OK, 0
    speeds = _speeds_in(places, room + 2)
    places_written = _write_speeds(nodes, count, line, speeds)
    if arrival.role == FALLBACK:  # on time, wherever the car is
        station = nearest(car.x, car.y, car.yaw, ACROSS_PENALTY, math.nan, line)
        shift = arrival.time - time_at(station, speeds)
        for k in range(places_written):
            speeds.arrive[k], speeds.leave[k] = speeds.arrive[k] + shift, speeds.leave[k] + shift
    else:
        _watch_meant_line(arrival, car, nodes, count, feet, tracker)
        own.stamp, own.arrival, own.shape = arrival.stamp, arrival.time, _shape_of(given)
    parts[PARTS.points], parts[PARTS.speeds] = written - first, places_written
    parts[PARTS.stops] = _write_stops(places_written, speeds, stops)
    parts[PARTS.path_at] = memory.size - rest.size
    parts[PARTS.stops_at] = parts[PARTS.path_at] - stops.size
    parts[PARTS.room] = room + 2
    parts[PARTS.speeds_at] = parts[PARTS.stops_at] - 4 * parts[PARTS.room]
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

"""Follow the trajectories of a planner in fixed memory: when the calls of `planner` are due, and what they change.

One of two buffers holds the followed trajectory; the next trajectory is written to the other buffer. Before the first
trajectory the tracker follows its own path.
"""

from __future__ import annotations

import math

from ..kernel import (
    OK,
    Field,
    Place,
    columns,
    copier,
    exported,
    float64,
    inlined,
    int64,
    int_matrix,
    int_vector,
    local,
    matrix,
    record,
    rows,
    several,
    shaped,
    vector,
    void,
)
from ..planned import condition
from ..planned.clock import VERDICT
from ..planned.meant_line import FAR_PLACES
from ..planned.records import FALLBACK, NODE, PLANNED_MEMORY, Planned
from ..planning.station_table import AlongRecord
from ..roads import path, road
from ..speed.path import (
    PLACE_SPACING,
    PLAN_MEMORY_TOO_SMALL,
    PlanArrays,
    cells_along,
    horizon_cells,
    write_speed_path,
)
from ..speed.speed_control import SpeedPath
from . import planner
from .longitudinal import Longitudinal, longitudinal_follow
from .planner import PARTS, Arrival
from .records import PlanRecord, TrackerRecord
from .signals import sample_of
from .step import Tracking, tracker_predict, tracker_step

_FLAWS = {
    "none": "",
    "bad_number": "its time or place is not finite, or beyond 1e8 m",
    "falling_time": "its time is less than that of the point before",
    "place_jump": "its place is a jump away from the point before",
    "wrong_yaw": "its yaw differs from the direction of motion by more than 15 degrees",
    "wrong_speed": "from there on the speeds contradict places and times",
    "no_line": "the places fold back",
    "too_long": "the way is longer than about 1,000 m",
    "too_fast": "the speeds are beyond those of the speed control",
    "moves_at_end": "it must end at rest, with a speed of 0",
}
FLAW = columns(*(Field(name, "", 0, meaning) for name, meaning in _FLAWS.items()))
"""Why a trajectory or a fallback is impossible."""
BAD_TRAJECTORY, BAD_FALLBACK = len(VERDICT), len(VERDICT) + 1
"""Verdicts in addition to `VERDICT`: the trajectory, or the fallback that came with it, is impossible."""

FOLLOWED_MEMORY = record(
    "FollowedMemory",
    (
        "half",  # row of the buffers that holds the followed trajectory; -1: none
        "stops",  # of its speed plan
        "horizon",  # cells that the speed control looks ahead
        "fallback_count", "fallback_urgent",  # points; 0: no fallback
        "fallback_time",  # s, when it arrived
    ),
    integers=("half", "stops", "horizon", "fallback_count", "fallback_urgent"),
)  # fmt: skip
"""The followed trajectory and its fallback."""

Followed = record(
    "Followed",
    (
        ("memory", rows(FOLLOWED_MEMORY)),  # (1,)
        ("buffers", matrix), ("parts", int_matrix),  # (2, n), (2, PARTS): see `planner.take_trajectory`
        ("plans", matrix),  # (2, n), see `write_speed_path`; (2, 0) without a speed control
        ("ahead", vector),  # as of `Longitudinal`, for the fastest trajectory; empty without a speed control
        ("road", int_vector),  # (1,), 0: the only road of a trajectory
        ("fallback", matrix),  # rows of `POINT`: as many as a trajectory may have
        ("memory_before", rows(PLANNED_MEMORY)),  # (1,), of the tracker before a trajectory is taken
    ),
)  # fmt: skip
"""Memory for the trajectories of a tracker."""
_copy_memory, _far_places = copier(PLANNED_MEMORY), local(2 * FAR_PLACES)


# -- the tracker along a trajectory -----------------------------------------------------------------------------------
@inlined
def _trajectory_in(half, followed):
    """The centre line, the table of headings and the speeds (`PlannedSpeeds`) of the trajectory in a buffer."""
    parts = followed.parts[half]
    buffers = planner.buffers_in(followed.buffers[half], parts[PARTS.room])
    line, headings = path.line_in(buffers.path)
    return line, headings, planner.first_speeds(parts[PARTS.speeds], buffers.speeds)


@inlined
def _speed_control_along(half, control, followed):
    """The speed control along the trajectory in a buffer."""
    line, _, _ = _trajectory_in(half, followed)
    length, plan, stops = line.numbers[road.LENGTH], followed.plans[half], followed.memory[0].stops
    cells = cells_along(length, False)
    end = 4 * cells
    speed_path = SpeedPath(
        plan[:cells], plan[cells : 2 * cells], plan[2 * cells : 3 * cells], plan[3 * cells : end],
        plan[end : end + stops], plan[end + stops : end + 2 * stops], length / (cells - 1), length, 0,
    )  # fmt: skip
    return Longitudinal(
        control.sample, control.memory, control.settings, speed_path, control.banks,
        followed.ahead[: followed.memory[0].horizon], control.friction,
    )  # fmt: skip


@inlined
def _tracker_along(half, tracker, followed):
    """The tracker along the trajectory in a buffer."""
    line, headings, speeds = _trajectory_in(half, followed)
    numbers = shaped(line.numbers, 1, len(road.LINE_NUMBERS))
    roads = road.Roads(followed.road, numbers, line.start, line.pieces, headings)
    planned, count = tracker.planned, followed.parts[half, PARTS.points]
    points = shaped(followed.buffers[half, : 3 * count], count, 3)
    return TrackerRecord(
        tracker.settings, tracker.memory, tracker.sample, roads, PlanRecord(speeds.s, speeds.speed), tracker.measured,
        tracker.speeds, tracker.request, tracker.tracked, tracker.variables, tracker.check,
        Planned(planned.settings, planned.memory, speeds, points, planned.far),
    )  # fmt: skip


@inlined
def tracking_along(tracking, followed):
    """A tracker with its controller along the followed trajectory, before the first one along its own path."""
    half, tracker, control = followed.memory[0].half, tracking.tracker, tracking.longitudinal
    if half >= 0:
        tracker = _tracker_along(half, tracking.tracker, followed)
        control = _speed_control_along(half, tracking.longitudinal, followed)
    return Tracking(tracker, tracking.controller, tracking.narrow_friction, tracking.control_speed, control)


# -- a trajectory -----------------------------------------------------------------------------------------------------
@inlined
def _flaw_of(status):
    """`FLAW` of a status of `planner.take_trajectory` or `condition`."""
    if condition.BAD_NUMBER <= status <= condition.WRONG_SPEED:  # these have the order of `FLAW`
        return status - condition.BAD_NUMBER + FLAW.bad_number
    if status == planner.LINE_FLAW + path.TOO_SMALL:
        return FLAW.too_long
    return FLAW.none if status == OK or status == condition.REVERSE_AHEAD else FLAW.no_line


@inlined
def _write_plan(half, tracking, followed):
    """Write the plan of the speed control for the trajectory in a buffer; `FLAW`."""
    if tracking.control_speed == 0:
        return FLAW.none
    parts, buffer = followed.parts[half], followed.buffers[half]
    line, _, speeds = _trajectory_in(half, followed)
    first, count, top_speed = parts[PARTS.stops_at], parts[PARTS.stops], 0.0
    stops, seconds = buffer[first : first + count], buffer[first + count : first + 2 * count]
    seconds[:] = math.inf  # the car leaves by the times
    level = AlongRecord(buffer[:0], buffer[:0], 0)
    plan = PlanArrays(line, speeds.s, speeds.speed, level, level, stops, seconds, 0)
    status, stop_count = write_speed_path(plan, followed.plans[half])
    for speed in speeds.speed:
        top_speed = max(top_speed, speed)
    horizon = horizon_cells(top_speed, tracking.longitudinal.settings.brake, PLACE_SPACING)
    if status == PLAN_MEMORY_TOO_SMALL:
        return FLAW.too_long
    if status != OK or horizon > followed.ahead.size:
        return FLAW.too_fast
    followed.memory[0].stops, followed.memory[0].horizon = stop_count, horizon
    return FLAW.none


@inlined
def _go_over(points, arrival, tracking, followed):
    """Follow a trajectory if it is taken; return the verdict, `FLAW` and the point that it is about.

    An impossible one changes nothing.
    """
    before, friction, far_before = tracking_along(tracking, followed), math.nan, _far_places()
    planned = tracking.tracker.planned
    if tracking.control_speed != 0:
        friction = tracking.longitudinal.friction.memory[0].low
    _copy_memory(planned.memory[0], followed.memory_before[0])
    far_before[:] = planned.far
    half = 1 if followed.memory[0].half == 0 else 0
    verdict, status, point = planner.take_trajectory(
        points, arrival, friction, before.tracker, followed.buffers[half], followed.parts[half]
    )
    flaw = _flaw_of(status)
    if flaw == FLAW.none and verdict == VERDICT.taken:
        followed.parts[half, PARTS.points] = min(followed.parts[half, PARTS.points], planner.KEPT_POINTS)
        flaw = _write_plan(half, tracking, followed)
    if flaw != FLAW.none:
        _copy_memory(followed.memory_before[0], planned.memory[0])
        planned.far[:] = far_before
    elif verdict == VERDICT.taken:
        followed.memory[0].half = half
        along = tracking_along(tracking, followed)
        if along.control_speed != 0:
            longitudinal_follow(along.longitudinal)
        planner.begin_trajectory(arrival, along.tracker)
    return verdict, flaw, point


@inlined
def _flaw_of_fallback(points, followed):
    """`FLAW` of a fallback, and the point that it is about."""
    buffer, count = followed.buffers[1 if followed.memory[0].half == 0 else 0], 2 * len(points) + 2
    nodes = shaped(buffer[: count * len(NODE)], count, len(NODE))
    status, point, end = condition.condition(points, 0.0, 0.0, nodes)
    if end == 0:
        return _flaw_of(status), point
    if nodes[end - 1, NODE.leave] < math.inf:
        return FLAW.moves_at_end, len(points) - 1
    return FLAW.none, 0


@exported(several(int64, int64, int64)(matrix, Arrival, matrix, int64, Place(Tracking), Place(Followed)))
def join_trajectory(points, arrival, fallback, fallback_urgent, tracking, followed):
    """Follow a trajectory if it is taken, and store its fallback, both `POINT` (n, 7).

    A fallback without points leaves the one before. Return the verdict, `FLAW` and the index of the point that it is
    about. After a flaw the car goes on as before.
    """
    memory, count = followed.memory[0], len(fallback)
    if count > 0:
        flaw, point = _flaw_of_fallback(fallback, followed)
        if flaw != FLAW.none:
            return BAD_FALLBACK, flaw, point
    verdict, flaw, point = _go_over(points, arrival, tracking, followed)
    if flaw != FLAW.none:
        return BAD_TRAJECTORY, flaw, point
    if count > 0 and (verdict == VERDICT.taken or verdict == VERDICT.same):
        followed.fallback[:count] = fallback
        memory.fallback_count, memory.fallback_urgent, memory.fallback_time = count, fallback_urgent, arrival.time
    return verdict, flaw, point


# -- calls ------------------------------------------------------------------------------------------------------------
@inlined
def watch_trajectory(time, tracking, followed):
    """Follow the fallback where the planner has fallen silent at a time (s), and a fresh fallback fits the car."""
    memory, tracker = followed.memory[0], tracking.tracker
    if planner.watch_planner(time, tracker) == 0 or memory.fallback_count == 0:
        return
    if time - memory.fallback_time <= tracker.planned.settings[0].fallback_age:
        arrival = Arrival(0.0, time, FALLBACK, memory.fallback_urgent)
        _go_over(followed.fallback[: memory.fallback_count], arrival, tracking, followed)


@exported(void(Place(Tracking), Place(Followed)))
def trajectory_step(tracking, followed):
    """`tracker_step` along the followed trajectory, or along the fallback of a planner that has fallen silent."""
    call = sample_of(tracking.tracker.sample, 0)
    time = call.now if call.now == call.now else call.t
    if math.isfinite(time):
        watch_trajectory(time, tracking, followed)
    tracker_step(tracking_along(tracking, followed))


@exported(several(int64, float64)(Place(Tracking), Place(Followed), vector))
def trajectory_predict(tracking, followed, points):
    """`tracker_predict` along the followed trajectory."""
    return tracker_predict(tracking_along(tracking, followed), points)

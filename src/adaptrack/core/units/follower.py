"""A controller that follows a planner, as a unit of co-simulation: `core.units.controller` with trajectories as inputs.

A step follows the trajectory of the inputs, with its fallback, if `trajectory_number` or `trajectory_stamp` has
changed. Then it calls the tracker. The results are those of `Tracker.follow` and `Tracker.step`, to the bit.

One of two buffers holds the followed trajectory; the next trajectory is written to the other buffer. Both are state.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

from ..kernel import (
    OK,
    Field,
    Place,
    columns,
    copier,
    exported,
    fields_of,
    inlined,
    int64,
    int_matrix,
    int_vector,
    matrix,
    record,
    rows,
    shaped,
    vector,
)
from ..maths.bits import whole
from ..planned import condition
from ..planned.clock import VERDICT
from ..planned.records import FALLBACK, NOBODY, NODE, PLANNED_MEMORY, PLANNER, POINT, Planned, PlannedSpeeds
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
from ..tracker import planner
from ..tracker.longitudinal import Longitudinal, longitudinal_follow
from ..tracker.records import PlanRecord, TrackerRecord
from ..tracker.signals import TRACKED
from ..tracker.step import Tracking
from .contract import REFUSED, outside
from .controller import STEERING_VALUE, engage, make_step

# -- values -----------------------------------------------------------------------------------------------------------
FOLLOWER_INPUTS = (
    Field("trajectory_count", "", 0, "points of the trajectory; 0: the planner is silent"),
    Field("fallback_count", "", 0, "points of the fallback that comes with the trajectory; 0: the one before stays"),
    Field("trajectory_number", "", 0, "number of the trajectory: a change hands it over at the next step"),
    Field("trajectory_stamp", "s", 0.0, "on the planner's clock, from which the times count; 0: the time of arrival. "
          "The clock of the unit is 0 at the start. A change hands the trajectory over at the next step"),
    Field("trajectory_urgent", "", False, "true: the trajectory counts at once, without a transition"),
    Field("fallback_urgent", "", False, "true: the fallback counts at once, without a transition"),
)  # fmt: skip
_INPUT = columns(*FOLLOWER_INPUTS)


def _numbered(names: Iterable[str]) -> str:
    """The numbers of names, as text."""
    return ", ".join(f"{i} {name.replace('_', ' ')}" for i, name in enumerate(names))


def _array(name: str, field: Field) -> Field:
    """The array of a quantity of points."""
    meaning = field.meaning.replace("NaN: unknown", "NaN, or 0 at all points: unknown")
    return field._replace(name=f"{name}_{field.name}", meaning=meaning)


FOLLOWER_ARRAYS = tuple(_array(name, field) for name in ("trajectory", "fallback") for field in fields_of(POINT))
"""Inputs behind `FOLLOWER_INPUTS`: arrays, one number for each point."""
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
_FLAW_STATUSES = (
    (condition.BAD_NUMBER, FLAW.bad_number), (condition.FALLING_TIME, FLAW.falling_time),
    (condition.PLACE_JUMP, FLAW.place_jump), (condition.WRONG_YAW, FLAW.wrong_yaw),
    (condition.WRONG_SPEED, FLAW.wrong_speed),
    (planner.LINE_FLAW + path.TOO_SMALL, FLAW.too_long),
)  # fmt: skip
_VERDICTS = (*VERDICT._fields, "impossible", "impossible_fallback")
NO_TRAJECTORY, BAD_TRAJECTORY, BAD_FALLBACK = -1, len(VERDICT), len(VERDICT) + 1
"""Verdicts in addition to `VERDICT`: none yet; the trajectory, or the fallback that came with it, is impossible."""
TARGET_OUTPUT = Field("target_speed", "m/s", 0.0, "planned one period ahead by the times; before the first trajectory "
                      "planned_speed_ahead")  # fmt: skip
"""Output of a unit without speed control, before `FOLLOWER_OUTPUTS`."""
FOLLOWER_OUTPUTS = (
    *fields_of(TRACKED)[TRACKED.late : TRACKED.driven_by + 1],
    Field("verdict", "", NO_TRAJECTORY, f"on the last trajectory: {_numbered(_VERDICTS)}; -1 none yet"),
    Field("flaw", "", 0, f"why it is impossible: {_numbered(_FLAWS)}"),
    Field("flaw_point", "", 0, "number of that point, from 1 on; the last one for a flaw of the whole way; 0: none"),
)  # fmt: skip
"""The last outputs of all."""
_OUTPUT = columns(*FOLLOWER_OUTPUTS)

# -- the record -------------------------------------------------------------------------------------------------------
FOLLOWED = record(
    "Followed",
    (
        "half",  # row of the buffers that holds the followed trajectory; -1: none
        "stops",  # of its speed plan
        "horizon",  # cells that the speed control looks ahead
        "number", "stamp",  # inputs with which the last trajectory was handed over
        "fallback_count", "fallback_urgent",  # points; 0: no fallback
        "fallback_time",  # s, when it arrived
    ),
    integers=("half", "stops", "horizon", "fallback_count", "fallback_urgent"),
)  # fmt: skip
"""The followed trajectory and its fallback."""

FollowerUnit = record(
    "FollowerUnit",
    (
        ("values", vector), ("kinds", int_vector), ("least", vector), ("most", vector), ("tracking", Tracking),
        ("points", vector),  # as of `controller.SteeringUnit`
        ("first", int64),  # place of `FOLLOWER_INPUTS`, behind all values of `controller.SteeringUnit`
        ("followed", rows(FOLLOWED)),  # (1,)
        ("buffers", matrix), ("parts", int_matrix),  # (2, n), (2, PARTS): see `planner.take_trajectory`
        ("plans", matrix),  # (2, n), see `write_speed_path`; (2, 0) without a speed control
        ("road", int_vector),  # (1,), 0: the only road of a trajectory
        ("arrived", matrix), ("fallback", matrix),  # rows of `POINT`: as many as a trajectory may have
        ("memory_before", rows(PLANNED_MEMORY)), ("far_before", vector),  # `Planned` before a trajectory is taken
    ),
)  # fmt: skip
"""A unit of co-simulation (see `contract`) whose tracking follows its own path until the first trajectory.

Its values are those of `controller.SteeringUnit`, then `FOLLOWER_INPUTS`, `FOLLOWER_ARRAYS`, without a speed control
`TARGET_OUTPUT`, and `FOLLOWER_OUTPUTS`."""
_copy_memory = copier(PLANNED_MEMORY)


@inlined
def _line_of(half, unit):
    """The centre line, and the table of headings, of the trajectory in a buffer."""
    return path.line_in(unit.buffers[half, unit.parts[half, planner.PARTS.path_at] :])


@inlined
def _speeds_of(half, unit):
    """`PlannedSpeeds` of the trajectory in a buffer."""
    parts = unit.parts[half]
    first, room, count = parts[planner.PARTS.speeds_at], parts[planner.PARTS.room], parts[planner.PARTS.speeds]
    columns_of_speeds = shaped(unit.buffers[half, first : first + 4 * room], 4, room)
    return PlannedSpeeds(
        columns_of_speeds[0, :count], columns_of_speeds[1, :count], columns_of_speeds[2, :count],
        columns_of_speeds[3, :count],
    )  # fmt: skip


@inlined
def _speed_path_of(half, unit):
    """`SpeedPath` of the trajectory in a buffer."""
    line, _ = _line_of(half, unit)
    length, plan, stops = line.numbers[road.LENGTH], unit.plans[half], unit.followed[0].stops
    cells = cells_along(length, False)
    end = 4 * cells
    return SpeedPath(
        plan[:cells], plan[cells : 2 * cells], plan[2 * cells : 3 * cells], plan[3 * cells : end],
        plan[end : end + stops], plan[end + stops : end + 2 * stops], length / (cells - 1), length, 0,
    )  # fmt: skip


@inlined
def _along_trajectory(half, unit):
    """The tracker along the trajectory in a buffer."""
    tracker, speeds = unit.tracking.tracker, _speeds_of(half, unit)
    line, headings = _line_of(half, unit)
    roads = road.Roads(unit.road, shaped(line.numbers, 1, len(road.LINE_NUMBERS)), line.start, line.pieces, headings)
    count = unit.parts[half, planner.PARTS.points]
    points = shaped(unit.buffers[half, : 3 * count], count, 3)
    planned = tracker.planned
    return TrackerRecord(
        tracker.settings, tracker.memory, tracker.sample, roads, PlanRecord(speeds.s, speeds.speed), tracker.measured,
        tracker.speeds, tracker.request, tracker.tracked, tracker.variables, tracker.check,
        Planned(planned.settings, planned.memory, speeds, points, planned.far),
    )  # fmt: skip


@inlined
def _tracking_of(unit):
    """The tracker with its controller along the followed trajectory, before the first one along its own path."""
    half, tracking = unit.followed[0].half, unit.tracking
    tracker, plan = tracking.tracker, tracking.longitudinal.path
    if half >= 0:
        tracker, plan = _along_trajectory(half, unit), _speed_path_of(half, unit)
    control = tracking.longitudinal
    longitudinal = Longitudinal(
        control.sample, control.memory, control.settings, plan, control.banks,
        control.ahead[: unit.followed[0].horizon], control.friction,
    )  # fmt: skip
    return Tracking(tracker, tracking.controller, tracking.narrow_friction, tracking.control_speed, longitudinal)


# -- a trajectory -----------------------------------------------------------------------------------------------------
@inlined
def _flaw_of(status):
    """`FLAW` of a status of `planner.take_trajectory` or `condition`."""
    if status == OK or status == condition.REVERSE_AHEAD:
        return FLAW.none
    for flaw_status, flaw in _FLAW_STATUSES:
        if status == flaw_status:
            return flaw
    return FLAW.no_line


@inlined
def _write_plan(half, unit):
    """Write the plan of the speed control for the trajectory in a buffer; `FLAW`."""
    if unit.tracking.control_speed == 0:
        return FLAW.none
    parts, buffer, speeds = unit.parts[half], unit.buffers[half], _speeds_of(half, unit)
    line, _ = _line_of(half, unit)
    first, count, top_speed = parts[planner.PARTS.stops_at], parts[planner.PARTS.stops], 0.0
    stops, seconds = buffer[first : first + count], buffer[first + count : first + 2 * count]
    seconds[:] = math.inf  # the car leaves by the times
    level = AlongRecord(buffer[:0], buffer[:0], 0)
    plan = PlanArrays(line, speeds.s, speeds.speed, level, level, stops, seconds, 0)
    status, stop_count = write_speed_path(plan, unit.plans[half])
    for speed in speeds.speed:
        top_speed = max(top_speed, speed)
    horizon = horizon_cells(top_speed, unit.tracking.longitudinal.settings.brake, PLACE_SPACING)
    if status == PLAN_MEMORY_TOO_SMALL:
        return FLAW.too_long
    if status != OK or horizon > unit.tracking.longitudinal.ahead.size:
        return FLAW.too_fast
    unit.followed[0].stops, unit.followed[0].horizon = stop_count, horizon
    return FLAW.none


@inlined
def _follow(points, arrival, unit):
    """Follow a trajectory if it is taken; return the verdict, `FLAW` and the point that it is about.

    An impossible one changes nothing.
    """
    tracking, followed = _tracking_of(unit), unit.followed[0]
    planned, friction = tracking.tracker.planned, math.nan
    if tracking.control_speed != 0:
        friction = tracking.longitudinal.friction.memory[0].low
    _copy_memory(planned.memory[0], unit.memory_before[0])
    unit.far_before[:] = planned.far
    half = 1 if followed.half == 0 else 0
    verdict, status, point = planner.take_trajectory(
        points, arrival, friction, tracking.tracker, unit.buffers[half], unit.parts[half]
    )
    flaw = _flaw_of(status)
    if flaw == FLAW.none and verdict == VERDICT.taken:
        unit.parts[half, planner.PARTS.points] = min(unit.parts[half, planner.PARTS.points], planner.KEPT_POINTS)
        flaw = _write_plan(half, unit)
    if flaw != FLAW.none:
        _copy_memory(unit.memory_before[0], planned.memory[0])
        planned.far[:] = unit.far_before
    elif verdict == VERDICT.taken:
        followed.half = half
        along = _tracking_of(unit)
        if along.control_speed != 0:
            longitudinal_follow(along.longitudinal)
        planner.begin_trajectory(arrival, along.tracker)
    return verdict, flaw, point if flaw < FLAW.no_line else len(points) - 1


@inlined
def _flaw_of_fallback(points, unit):
    """`FLAW` of a fallback, and the point that it is about."""
    buffer, count = unit.buffers[1 if unit.followed[0].half == 0 else 0], 2 * len(points) + 2
    nodes = shaped(buffer[: count * len(NODE)], count, len(NODE))
    status, point, end = condition.condition(points, 0.0, 0.0, nodes)
    if end == 0:
        return _flaw_of(status), point
    if nodes[end - 1, NODE.leave] < math.inf:
        return FLAW.moves_at_end, len(points) - 1
    return FLAW.none, 0


@inlined
def _write_points(numbers, count, points):
    """Write the first `count` points of arrays, one behind the other, to the rows of `POINT`, and return these rows."""
    for k in range(count):
        for j in range(len(POINT)):
            points[k, j] = numbers[j * len(points) + k]
    return points[:count]


@inlined
def _take_inputs(unit):
    """Follow the trajectory of the inputs if it is a new one; `OK` or `REFUSED`."""
    values, followed, size = unit.values, unit.followed[0], len(POINT) * len(unit.arrived)
    inputs, arrays = values[unit.first :], values[unit.first + len(_INPUT) :]
    stamp = inputs[_INPUT.trajectory_stamp] if math.isfinite(inputs[_INPUT.trajectory_stamp]) else 0.0
    if inputs[_INPUT.trajectory_number] == followed.number and stamp == followed.stamp:
        return OK
    followed.number, followed.stamp = inputs[_INPUT.trajectory_number], stamp
    outputs, time = values[values.size - len(_OUTPUT) :], values[STEERING_VALUE.time]
    count, is_urgent = whole(inputs[_INPUT.trajectory_count]), whole(inputs[_INPUT.trajectory_urgent])
    fallback_count, flaw, point, verdict = whole(inputs[_INPUT.fallback_count]), FLAW.none, 0, BAD_FALLBACK
    if fallback_count > 0:
        flaw, point = _flaw_of_fallback(_write_points(arrays[size:], fallback_count, unit.arrived), unit)
    if flaw == FLAW.none:
        points = _write_points(arrays, count, unit.arrived)
        verdict, flaw, point = _follow(points, planner.Arrival(stamp, time, PLANNER, is_urgent), unit)
        verdict = verdict if flaw == FLAW.none else BAD_TRAJECTORY
    if fallback_count > 0 and (verdict == VERDICT.taken or verdict == VERDICT.same):
        _write_points(arrays[size:], fallback_count, unit.fallback)
        followed.fallback_count, followed.fallback_time = fallback_count, time
        followed.fallback_urgent = whole(inputs[_INPUT.fallback_urgent])
    is_possible = flaw == FLAW.none
    outputs[_OUTPUT.verdict], outputs[_OUTPUT.flaw] = verdict, flaw
    outputs[_OUTPUT.flaw_point] = 0 if is_possible else point + 1
    return OK if is_possible else REFUSED


@inlined
def _watch_planner(unit):
    """Follow the fallback where the planner has fallen silent, and one is there that is fresh and fits the car."""
    followed, time, planned = unit.followed[0], unit.values[STEERING_VALUE.time], unit.tracking.tracker.planned
    if planner.watch_planner(time, unit.tracking.tracker) == 0 or followed.fallback_count == 0:
        return
    if time - followed.fallback_time <= planned.settings[0].fallback_age:
        arrival = planner.Arrival(0.0, time, FALLBACK, followed.fallback_urgent)
        _follow(unit.fallback[: followed.fallback_count], arrival, unit)


@inlined
def _write_outputs(unit):
    """Write the outputs behind those of the controller; where the car is not known the target speed stays."""
    values, memory = unit.values, unit.tracking.tracker.planned.memory[0]
    first = values.size - len(_OUTPUT)
    outputs = values[first:]
    outputs[_OUTPUT.late], outputs[_OUTPUT.driven_by] = memory.late, memory.driven_by
    if unit.tracking.control_speed != 0:
        return
    if memory.driven_by == NOBODY:
        values[first - 1] = values[STEERING_VALUE.planned_speed_ahead]
    elif math.isfinite(memory.target_speed):
        values[first - 1] = memory.target_speed


# -- calls ------------------------------------------------------------------------------------------------------------
@exported(int64(Place(FollowerUnit)))
def follower_begin(unit):
    """Read the parameters and engage; the status."""
    status = engage(unit.values[: unit.first], unit.least, unit.most, unit.points, _tracking_of(unit))
    _write_outputs(unit)
    return status


@exported(int64(Place(FollowerUnit)))
def follower_step(unit):
    """Take the trajectory of the inputs in, call the tracker, write the outputs, and go on by a period; the status.

    It is `REFUSED` for a trajectory or a fallback that is impossible: the car goes on as before.
    """
    first = unit.first
    invalid = outside(first, first + _INPUT.trajectory_number, unit.values, unit.least, unit.most)
    if invalid != OK:
        return invalid
    status = _take_inputs(unit)
    _watch_planner(unit)
    make_step(unit.values[:first], unit.points, _tracking_of(unit))
    _write_outputs(unit)
    return status

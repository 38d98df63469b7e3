"""A controller that follows a planner, as a unit of co-simulation: `core.units.controller` with trajectories as inputs.

A step follows the trajectory of the inputs, with its fallback, if `trajectory_number` or `trajectory_stamp` has
changed (`core.tracker.followed`). Then it calls the tracker. The results are those of `Tracker.follow` and
`Tracker.step`, to the bit.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

from ..kernel import OK, Field, Place, columns, exported, fields_of, inlined, int64, int_vector, matrix, record, vector
from ..maths.bits import whole
from ..planned.clock import VERDICT
from ..planned.records import NOBODY, PLANNER, POINT
from ..tracker.followed import FLAW, Followed, join_trajectory, tracking_along, watch_trajectory
from ..tracker.planner import Arrival
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
_VERDICTS = (*VERDICT._fields, "impossible", "impossible_fallback")
NO_TRAJECTORY = -1
"""Verdict before the first trajectory."""
TARGET_OUTPUT = Field("target_speed", "m/s", 0.0, "planned one period ahead by the times; before the first trajectory "
                      "planned_speed_ahead")  # fmt: skip
"""Output of a unit without speed control, before `FOLLOWER_OUTPUTS`."""
FOLLOWER_OUTPUTS = (
    *fields_of(TRACKED)[TRACKED.late : TRACKED.driven_by + 1],
    Field("verdict", "", NO_TRAJECTORY, f"on the last trajectory: {_numbered(_VERDICTS)}; -1 none yet"),
    Field("flaw", "", 0, f"why it is impossible: {_numbered(FLAW._fields)}"),
    Field("flaw_point", "", 0, "number of that point, from 1 on; the last one for a flaw of the whole way; 0: none"),
)  # fmt: skip
"""The last outputs of all."""
_OUTPUT = columns(*FOLLOWER_OUTPUTS)

# -- the record -------------------------------------------------------------------------------------------------------
FollowerUnit = record(
    "FollowerUnit",
    (
        ("values", vector), ("kinds", int_vector), ("least", vector), ("most", vector), ("tracking", Tracking),
        ("points", vector),  # as of `controller.SteeringUnit`
        ("first", int64),  # place of `FOLLOWER_INPUTS`, behind all values of `controller.SteeringUnit`
        ("followed", Followed),
        ("trajectory", matrix), ("fallback", matrix),  # of the inputs, rows of `POINT`: as many as there may be
        ("handed_over", vector),  # (2,), number and stamp of the last trajectory of the inputs
    ),
)  # fmt: skip
"""A unit of co-simulation (see `contract`) whose tracking follows its own path until the first trajectory.

Its values are those of `controller.SteeringUnit`, then `FOLLOWER_INPUTS`, `FOLLOWER_ARRAYS`, without a speed control
`TARGET_OUTPUT`, and `FOLLOWER_OUTPUTS`."""


# -- inputs and outputs -----------------------------------------------------------------------------------------------
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
    values, handed_over, size = unit.values, unit.handed_over, len(POINT) * len(unit.trajectory)
    inputs, arrays = values[unit.first :], values[unit.first + len(_INPUT) :]
    stamp = inputs[_INPUT.trajectory_stamp] if math.isfinite(inputs[_INPUT.trajectory_stamp]) else 0.0
    if inputs[_INPUT.trajectory_number] == handed_over[0] and stamp == handed_over[1]:
        return OK
    handed_over[0], handed_over[1] = inputs[_INPUT.trajectory_number], stamp
    count, is_urgent = whole(inputs[_INPUT.trajectory_count]), whole(inputs[_INPUT.trajectory_urgent])
    points = _write_points(arrays, count, unit.trajectory)
    fallback = _write_points(arrays[size:], whole(inputs[_INPUT.fallback_count]), unit.fallback)
    arrival = Arrival(stamp, values[STEERING_VALUE.time], PLANNER, is_urgent)
    fallback_urgent = whole(inputs[_INPUT.fallback_urgent])
    verdict, flaw, point = join_trajectory(points, arrival, fallback, fallback_urgent, unit.tracking, unit.followed)
    if FLAW.no_line <= flaw < FLAW.moves_at_end:
        point = count - 1
    outputs = values[values.size - len(_OUTPUT) :]
    outputs[_OUTPUT.verdict], outputs[_OUTPUT.flaw] = verdict, flaw
    outputs[_OUTPUT.flaw_point] = 0 if flaw == FLAW.none else point + 1
    return OK if flaw == FLAW.none else REFUSED


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
    tracking = tracking_along(unit.tracking, unit.followed)
    status = engage(unit.values[: unit.first], unit.least, unit.most, unit.points, tracking)
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
    watch_trajectory(unit.values[STEERING_VALUE.time], unit.tracking, unit.followed)
    make_step(unit.values[:first], unit.points, tracking_along(unit.tracking, unit.followed))
    _write_outputs(unit)
    return status

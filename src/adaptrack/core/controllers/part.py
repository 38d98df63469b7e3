"""A controller as a part of a loop: one record and three functions, whatever the controller is.

    begin       everything is forgotten, before the first step
    request     what a tracker asks for between two steps, see `REQUEST`
    step        one control period

The functions come by their addresses in the record, so that no loop knows the kind of its controller: `mpc_step` has
those of an MPC, `law` those of a control law. A step writes its answer to the row of the slot in `answer`, which begins
with `COMMON_ANSWER`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ..kernel import Caller, Place, address_of, columns, float64, inlined, int64, matrix, record, vector, void
from ..layout import allocate
from ..roads.road import Roads
from ..scheduling.schedule import ScheduleRecord, begin_schedule, schedule
from .contract import SITUATION
from .mpc import Functions, Mpc, MPCSizes

COMMON_ANSWER = columns("command", "command_change", "held")
"""Every controller's answer begins with these: rad, rad, 1 when there was nothing new to apply. Its diagnostics follow.
"""
REQUEST = columns(
    "restart",  # 1: begin anew; what was learned of the car stays
    "change",  # 1: another path lies under the car, by
    "turned", "shifted",  # rad, m: so much have heading and offset grown
    "late",  # s, age of a sample that is later than the controller's filter takes; NaN: none
)  # fmt: skip
"""What a tracker asks of its controller before its next step, in this order; who has done it sets it to zero.

The command in force is no request: each step is told it.
"""

Law = record(
    "Law",
    (
        ("function", int64),  # address of the law
        ("held", int64),  # place of the diagnostic ``held`` in its answer, 0: none
        ("preview", int64),  # 1: it sees the reference ahead
        ("has_vy", int64),  # 0: v_y is not measured, and taken as 0
        ("parameters", vector, "law_parameters"),
        ("memory", matrix, "slots", "law_memory"),
        ("situation", vector, "law_situation"),
        ("answer", vector, "law_answer"),  # command (rad) and diagnostics
    ),
)
"""A batch of controllers that are one function, see `contract`; empty for an MPC."""
ControllerPart = record(
    "ControllerPart",
    (
        ("begin", int64), ("request", int64), ("step", int64),  # addresses; 0: the caller of the loop is the controller
        ("beliefs", int64),  # column of an answer from which on it says what is learned; 0: nothing is learned
        ("plans", int64),  # 1: it predicts and plans moves, and its answer is a `mpc.MPC_ANSWER`
        ("takes_late", int64),  # periods by which its Kalman filter takes late samples; -1: it has none
        ("answer", matrix, "slots", "answer"),
        ("mpc", Mpc),
        ("functions", Functions),  # of the MPC
        ("law", Law),
        ("schedule", ScheduleRecord),  # without entries: none
        ("tuning", matrix, "slots", "tuning"),  # as used
        ("first_tuning", vector, "tuning"),  # before the schedule speaks
    ),
)  # fmt: skip
"""A batch of controllers, one for each slot."""

_CHOSEN = (
    "slots",
    "answer",  # columns of an answer; of an MPC it follows from its own sizes
    "law_parameters", "law_memory", "law_answer",  # numbers of the law, those that it remembers, those of its answer
    "integers", "numbers", "scratch",  # of the schedule
    "tuning",  # entries of the controller's tuning
)  # fmt: skip
_DERIVED = ("law_situation", "scheduled_slots")
ControllerSizes = record("ControllerSizes", (("mpc", MPCSizes), *_CHOSEN, *_DERIVED), integers=(*_CHOSEN, *_DERIVED))
"""The sizes of a `ControllerPart`. The slots of its MPC count only where it is one."""

_PLACE = Place(ControllerPart)
BEGIN = void(int64, float64, _PLACE)
"""``begin(slot, command, controller)``; command: rad, that a vehicle has at its start"""
APPLY = void(int64, vector, _PLACE)
"""``request(slot, requests, controller)``"""
STEP = void(int64, float64, float64, float64, int64, vector, vector, vector, Place(Roads), _PLACE)
"""``step(slot, speed, command, station, road, measured, reference, speeds, roads, controller)``

speed: m/s, as measured; command: rad, in force, which need not be the controller's own; station: m, of the car's foot
on the road; road: which of `roads`, -1: none; measured: `MEASUREMENT`; reference: y_ref (m) now and at the instants
that follow; speeds: m/s, planned for the instants from now on, empty without a road."""
_call_begin, _call_request, _call_step = Caller(BEGIN), Caller(APPLY), Caller(STEP)


@inlined
def complete_controller_sizes(sizes):
    """Write the sizes that follow from those that are chosen, and from those of an MPC, which are complete."""
    sizes.law_situation = len(SITUATION) if sizes.law_answer > 0 else 0
    sizes.scheduled_slots = sizes.slots if sizes.scratch > 0 else 0
    sizes.answer = max(sizes.answer, sizes.mpc.answers)


def controller_part(
    controller: Any, slots: int, sizes: Mapping[str, int], tuning: Any = (), begin: Any = None, request: Any = None,
    step: Any = None, **values: Any,
) -> Any:  # fmt: skip
    """A `ControllerPart` of a controller for `slots` slots before its first step, with what all controllers have.

    controller: of `adaptrack.control`, None: the caller of the loop; sizes: of its arrays, by their names in
    `ControllerSizes`; begin, request, step: kernels, None: the caller of the loop does it; values: other fields.
    """
    (row,) = ControllerSizes.new(1, slots=slots, tuning=len(tuning), **sizes)
    row.mpc.slots = slots
    complete_controller_sizes(row)
    takes_late = -1 if controller is None else controller.takes_late
    begin, request, step = address_of(begin), address_of(request), address_of(step)
    part = allocate(ControllerPart, row, begin=begin, request=request, step=step, takes_late=takes_late, **values)
    part.tuning[:], part.first_tuning[:] = tuning, tuning
    return part


@inlined
def begin_controller(slot, command, controller):
    """Let a controller forget everything; command: rad, that a vehicle has at its start."""
    if controller.begin != 0:
        _call_begin(controller.begin, slot, command, controller)


@inlined
def apply_requests(slot, request, controller):
    """Do what a tracker asks of a controller."""
    if request[REQUEST.restart] + request[REQUEST.change] > 0.5:
        _call_request(controller.request, slot, request, controller)
    if request[REQUEST.restart] > 0.5:
        begin_schedule(slot, controller.schedule)
        controller.tuning[slot, :] = controller.first_tuning
    request[REQUEST.restart] = request[REQUEST.change] = 0.0


@inlined
def control(slot, variables, speed, command, station, road, measured, reference, speeds, roads, controller):
    """One control period: the schedule chooses the tuning by the variables, then the controller answers, see `STEP`."""
    if controller.schedule.settings[0].n_entries > 0:
        schedule(slot, variables, controller.schedule, controller.tuning[slot])
    _call_step(controller.step, slot, speed, command, station, road, measured, reference, speeds, roads, controller)

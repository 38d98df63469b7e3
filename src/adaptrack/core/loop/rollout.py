"""Whole runs, compiled: the control periods of `period` over the slots of a batch, each a vehicle with its controller.

Plants and controllers come as compiled functions by their addresses, see `plants.contract` and `controllers.part`.
"""

from __future__ import annotations

import math

from ..controllers import mpc
from ..controllers.part import (
    COMMON_ANSWER,
    ControllerPart,
    ControllerSizes,
    begin_controller,
    complete_controller_sizes,
    control,
)
from ..kernel import Place, Row, exported, inlined, int64, int_matrix, record, void
from ..layout import sizer
from ..maths.bits import whole
from ..plants.contract import place_one
from ..qp import problem as qp
from . import period
from .period import LOOP_SIZES, RUN_LOOP, RunSpan, after_control, before_control, begin_slot, close, move
from .world import RUNNING, SIGNAL, plan_instant

RunRecord = record("RunRecord", (*RUN_LOOP, ("controller", ControllerPart)))
"""A batch of runs with their controllers."""
RunSizes = record("RunSizes", (*LOOP_SIZES, ("controller", ControllerSizes)), integers=LOOP_SIZES)
"""The sizes of a `RunRecord`."""
_write_sizes = sizer(RunRecord, RunSizes)


@exported(int64(Row(mpc.MPCSettings), Row(RunSizes), int_matrix), name="run_sizes")
def write_sizes(settings, sizes, table):
    """Write the sizes of the arrays of a `RunRecord` and how many there are, see `layout`.

    Completed are the sizes, and the settings where an MPC drives.
    """
    period.complete_loop_sizes(sizes)
    if sizes.controller.law_answer == 0:
        mpc.complete_sizes(settings, sizes.controller.mpc)
    complete_controller_sizes(sizes.controller)
    return _write_sizes(sizes, table)


# -- the controller ---------------------------------------------------------------------------------------------------
@inlined
def control_slot(slot, run):
    """The controller's step at the planned speeds; its answer is in its record."""
    drive, scenario = run.memory.drives[slot], run.inputs.scenario[slot]
    planned = run.inputs.signals[scenario, SIGNAL.speed]
    first = plan_instant(slot, run) if run.inputs.roads.of[scenario] >= 0 else planned.size
    control_along(slot, drive.instant, planned[first:], run)


@inlined
def control_along(slot, k, speeds, run):
    """The controller's step at instant k; speeds: m/s, at the instants from now on."""
    drive, scenario = run.memory.drives[slot], run.inputs.scenario[slot]
    reference = run.inputs.signals[scenario, SIGNAL.y_ref, k:]
    control(
        slot, run.variables, drive.speed, drive.command, drive.station_estimate, run.inputs.roads.of[scenario],
        run.measured, reference, speeds, run.inputs.roads, run.controller,
    )  # fmt: skip


# -- runs -------------------------------------------------------------------------------------------------------------
@inlined
def _count_answer(k, slot, run):
    """Count and trace what the controller answered at instant k."""
    result, answer, tuning = run.result[slot], run.controller.answer[slot], run.controller.tuning[slot]
    result.held += 1 if answer[COMMON_ANSWER.held] > 0.5 else 0
    if run.controller.plans > 0:
        status = whole(answer[mpc.MPC_ANSWER.qp_status])
        result.capped += 1 if status == qp.CAPPED else 0
        result.unsolved += 1 if status > qp.CAPPED else 0
        result.limited += 1 if answer[mpc.MPC_ANSWER.at_limit] > 0.5 else 0
        result.iterations += whole(answer[mpc.MPC_ANSWER.qp_iterations])
    if run.features.traces:
        row, size = run.trace.answer[slot, k], answer.size
        for j in range(size):
            row[j] = answer[j]
        for j in range(row.size - size):
            row[size + j] = tuning[j]


@inlined
def _drive_slot(k, slot, span, run):
    """Instant k of a run: the two halves of `period` around its controller."""
    before_control(slot, span, run)
    if run.memory.drives[slot].ended == RUNNING:
        control_slot(slot, run)
        answer_instant(k, slot, span, run)


@inlined
def answer_instant(k, slot, span, run):
    """Instant k of a run, once its controller has answered."""
    answer = run.controller.answer[slot]
    after_control(slot, answer[COMMON_ANSWER.command], answer[COMMON_ANSWER.command_change], span, run)
    _count_answer(k, slot, run)


@inlined
def end_slot(k, slot, span, run):
    """Close a run that ends at instant k before its time, and park its slot in its initial state."""
    close(slot, run)
    if span.segment > 0:
        first = max(k - 1, 0) // span.segment
        run.segments[slot, first:] = math.nan
        run.segments[slot, first] = math.inf
    place_one(slot, run.vehicles.start, run.vehicles.block, run.vehicles.states)


@exported(void(int64, Place(RunRecord)), name="begin_runs")
def begin(slots, run):
    """Everything as it is before the first instant, for the first `slots` slots.

    The models that an MPC holds stay.
    """
    run.segments[:, :] = 0.0
    for i in range(slots):
        begin_slot(i, run)
        begin_controller(i, run.memory.drives[i].command, run.controller)


@inlined
def control_all(span, run):
    """The present instant of all slots that are under way; how many drive on from it."""
    running = 0
    for i in range(span.slots):
        drive = run.memory.drives[i]
        k = drive.instant
        if drive.ended != RUNNING or k >= span.periods:
            continue
        _drive_slot(k, i, span, run)
        if drive.ended == RUNNING:
            running += 1
        else:
            end_slot(k, i, span, run)
    return running


@inlined
def close_all(span, run):
    """Close the runs that have come to their end."""
    for i in range(span.slots):
        if run.memory.drives[i].ended == RUNNING and run.memory.drives[i].instant >= span.periods:
            close(i, run)


@exported(int64(int64, RunSpan, Place(RunRecord)))
def roll_on(count, span, run):
    """Up to so many further periods of runs, from where `begin` or the last call left each; how many were driven.

    A run ends early when it has failed (`loop.judge`), or, as STOPPED, once its cost has reached its limit and can
    only grow. The cost of each segment is written to `segments`: inf for the one in which a run ends, NaN after.
    """
    periods = 0
    while periods < count and control_all(span, run) > 0:
        move(span.slots, run)
        periods += 1
    close_all(span, run)
    return periods


@exported(void(RunSpan, Place(RunRecord)))
def rollout(span, run):
    """Whole runs, from what `begin` left; see `roll_on`."""
    roll_on(span.periods, span, run)

"""Whole runs, compiled: the control periods of `period` over the slots of a batch, each a vehicle with its controller.

Plants, prediction models, estimators and control laws come as compiled functions (see their contracts); the MPC alone
is built in.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from . import period
from .controllers import mpc
from .controllers.contract import SITUATION, Situation, call_law
from .controllers.mpc_step import step_with
from .kernel import (
    Place,
    Row,
    address_of,
    columns,
    exported,
    inlined,
    int64,
    int_matrix,
    matrix,
    record,
    vector,
    void,
)
from .layout import allocate, put
from .loop import RUNNING, SIGNAL, plan_instant
from .maths.bits import whole
from .models.contract import MEASUREMENT
from .period import RUN_LOOP, RunSpan, after_control, before_control, begin_slot, close, move
from .plants.contract import place_one
from .qp import problem as qp
from .road import RoadAheadRecord, bend_ahead, line_of
from .schedule import ScheduleRecord, schedule, schedule_sizes

COMMON_ANSWER = columns("command", "command_change", "held")
"""Every controller's answer begins with these, as `mpc.MPC_ANSWER` does."""
COMMAND = 0
"""Where a control law answers its command; its diagnostics are behind."""

Law = record(
    "Law",
    (
        ("function", int64), ("parameters", vector), ("memory", matrix), ("situation", vector),
        ("law_answer", vector), ("answer", matrix), ("held", int64), ("preview", int64),
    ),
)  # fmt: skip
"""A batch of controllers that are not the MPC: address of the law; memory (slots, m); what the law answers
(1 + diagnostics,); its diagnostics behind the COMMON columns (slots, COMMON + diagnostics); place of the diagnostic
``held`` in a law's answer, 0 for none; whether the law sees the reference ahead."""

_PARTS = (
    *RUN_LOOP,
    ("mpc", mpc.Mpc),
    ("functions", mpc.Functions),  # of the MPC
    ("law", Law),
    ("schedule", ScheduleRecord),
    ("tuning", matrix),  # (slots, entries) of the controller, written by the scheduler if there is one
)
RunRecord = record("RunRecord", _PARTS)
"""A batch of runs with their controllers; measured: that of the MPC."""


RunCounts = record(
    "RunCounts",
    (
        ("loop", period.LoopCounts), ("mpc", mpc.MPCCounts),
        "law", "law_parameters", "law_memory", "diagnostics",  # 1: a law drives; its numbers, those that it remembers
        "integers", "numbers", "scratch",  # of the schedule, see `schedule.schedule_sizes`
        "tuning",  # entries of the controller's tuning
    ),
    integers=(
        "law", "law_parameters", "law_memory", "diagnostics", "integers", "numbers", "scratch", "tuning",
    ),
)  # fmt: skip
"""What the sizes of a `RunRecord` follow from beside the settings of its MPC. One that a law drives has a small MPC all
the same, of 4 states and 6 parameters."""


@inlined
def law_sizes(slots, parameters, memory, diagnostics, table, row):
    """Sizes of the arrays of `Law`, see `layout`."""
    row = put(table, row, parameters)
    row = put(table, row, slots, memory)
    row = put(table, row, len(SITUATION) if slots > 0 else 0)
    row = put(table, row, 1 + diagnostics if slots > 0 else 0)
    return put(table, row, slots, len(COMMON_ANSWER) + diagnostics if slots > 0 else 0)


@exported(int64(Row(mpc.MPCSettings), Row(RunCounts), int_matrix), name="run_sizes")
def sizes(settings, counts, table):
    """Write the sizes of the arrays of a `RunRecord` and how many there are, see `layout`; complete the MPC's settings.

    The two arrays `measured`, of the loop and of the MPC, are one.
    """
    slots = counts.loop.slots
    row = period.run_sizes(counts.loop, table, 0)
    mpc.complete_settings(settings, counts.mpc)
    row = mpc.mpc_sizes(settings, counts.mpc, table, row)
    law_slots = slots if counts.law > 0 else 0
    row = law_sizes(law_slots, counts.law_parameters, counts.law_memory, counts.diagnostics, table, row)
    row = schedule_sizes(slots, counts.integers, counts.numbers, counts.scratch, table, row)
    return put(table, row, slots, counts.tuning)


def no_law_batch() -> Any:
    """The laws of a batch that the MPC drives."""
    return allocate(Law, law_sizes, 0, 0, 0, 0)._replace(function=address_of(None))


def law_batch(slots: int, law: Any) -> Any:
    """Fresh control laws for `slots` slots, of a `CompiledController`."""
    diagnostics, parameters = law.diagnostic_names, np.array(law.parameters(), float)
    law_record = allocate(Law, law_sizes, slots, parameters.size, law.memory_size, len(diagnostics))
    law_record.parameters[:] = parameters
    held_place = 1 + diagnostics.index("held") if "held" in diagnostics else 0
    return law_record._replace(function=address_of(law.function), held=held_place, preview=int(law.preview))


# -- the controller ---------------------------------------------------------------------------------------------------
@inlined
def _apply_law(slot, reference, speeds, run):
    """A control law; a command that is not finite holds the last one."""
    drive, out, situation, measured = run.memory.drives[slot], run.law.answer[slot], run.law.situation, run.measured
    roads, scenario = run.inputs.roads, run.inputs.scenario[slot]
    road = RoadAheadRecord(line_of(roads.of[scenario], roads), drive.station_estimate, speeds)
    no_vy = run.settings.noise_vy == math.inf  # a car without a sensor of it
    current = Situation(
        0.0 if no_vy else measured[MEASUREMENT.vy],
        measured[MEASUREMENT.yaw],
        measured[MEASUREMENT.yaw_rate],
        measured[MEASUREMENT.y],
        drive.speed,
        drive.command,
    )
    for i in range(len(current)):
        situation[i] = current[i]
    answer = run.law.law_answer
    ahead = reference if run.law.preview > 0 else reference[:1]
    call_law(
        run.law.function, situation, ahead, road, run.tuning[slot], run.law.parameters, run.law.memory[slot], answer
    )  # fmt: skip
    usable = math.isfinite(answer[COMMAND])
    out[COMMON_ANSWER.command] = answer[COMMAND] if usable else drive.command
    out[COMMON_ANSWER.command_change] = out[COMMON_ANSWER.command] - drive.command
    out[COMMON_ANSWER.held] = 1.0 if not usable or (run.law.held > 0 and answer[run.law.held] > 0.5) else 0.0
    answered, recorded = answer[COMMAND + 1 :], out[len(COMMON_ANSWER) :]
    for i in range(recorded.size):
        recorded[i] = answered[i]


@inlined
def _see_bend(slot, speed, speeds, run):
    """Show the MPC the road ahead."""
    settings = run.mpc.settings
    road = run.inputs.roads.of[run.inputs.scenario[slot]]
    if road < 0:
        run.mpc.bend[:] = 0.0
        return
    bend_ahead(
        run.memory.drives[slot].station_estimate, speeds, max(speed, settings.speed_floor), mpc.delay_of(slot, run.mpc),
        settings.period, road, run.inputs.roads, run.mpc.bend,
    )  # fmt: skip


@inlined
def _speeds_ahead(slot, run):
    """Speeds (m/s) that are planned for the instants from now on; none without a road."""
    scenario = run.inputs.scenario[slot]
    speeds = run.inputs.signals[scenario, SIGNAL.speed]
    first = plan_instant(slot, run) if run.inputs.roads.of[scenario] >= 0 else speeds.size
    return (speeds[first:],)


@inlined
def control_slot(slot, run):
    """The controller's answer at the planned speeds."""
    (speeds,) = _speeds_ahead(slot, run)
    return _control_along(slot, speeds, run)


@inlined
def _control_along(slot, speeds, run):
    """The controller's answer; speeds: m/s, at the instants from now on."""
    k, speed = run.memory.drives[slot].instant, run.memory.drives[slot].speed
    reference = run.inputs.signals[run.inputs.scenario[slot], SIGNAL.y_ref, k:]
    if run.features.law:
        _apply_law(slot, reference, speeds, run)
        return (run.law.answer[slot],)
    if run.mpc.settings.curved > 0:
        _see_bend(slot, speed, speeds, run)
    step_with(slot, speed, reference, run.tuning[slot], run.mpc, run.functions)
    return (run.mpc.answer[slot],)


# -- runs -------------------------------------------------------------------------------------------------------------
@inlined
def _count_answer(k, slot, answer, run):
    """Count and trace what the controller answered at instant k."""
    result = run.result[slot]
    result.held += 1 if answer[COMMON_ANSWER.held] > 0.5 else 0
    if not run.features.law:
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
            row[size + j] = run.tuning[slot, j]


@inlined
def _drive_slot(k, slot, span, run):
    """Instant k of a run: the two halves of `period` around its controller."""
    before_control(slot, span, run)
    if run.memory.drives[slot].ended == RUNNING:
        (speeds,) = _speeds_ahead(slot, run)
        answer_instant(k, slot, speeds, span, run)


@inlined
def answer_instant(k, slot, speeds, span, run):
    """Instant k of a run from what its controller is given; speeds: m/s, at the instants from now on."""
    if run.features.variables:
        schedule(slot, run.variables, run.schedule, run.tuning[slot])
    (answer,) = _control_along(slot, speeds, run)
    after_control(slot, answer[COMMON_ANSWER.command], answer[COMMON_ANSWER.command_change], span, run)
    _count_answer(k, slot, answer, run)


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

    The models that the MPC holds stay.
    """
    run.segments[:, :] = 0.0
    for i in range(slots):
        begin_slot(i, run)
        mpc.forget(i, run.memory.drives[i].command, run.mpc)
    run.law.memory[:, :] = 0.0


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

"""One control period of runs, in two halves between which a controller stands.

    locate -> judge -> sense -> (look -> estimate friction and wind)      before_control
    control                                                                the controller's, compiled or in Python
    actuate -> note -> count                                               after_control
    advance                                                                move: all vehicles at once

`rollout` drives batches to their end, `episode` a few periods at a time, `closed_loop` one run around any controller.
"""

from __future__ import annotations

import math
from typing import Any

from .estimators import friction_wind
from .kernel import (
    Place,
    columns,
    cube,
    exported,
    float64,
    inlined,
    int64,
    int_vector,
    matrix,
    record,
    rows,
    several,
    vector,
    void,
)
from .layout import allocate, put
from .loop import (
    NEVER_ARRIVED,
    RUNNING,
    SIGNAL,
    STATE_NOT_FINITE,
    STOPPED,
    LoopSettings,
    Memory,
    actuate,
    change_command,
    forget,
    judge,
    locate,
    look,
    memory_sizes,
    sense,
    substeps_around_change,
    turn_steadily,
)
from .models.contract import MEASUREMENT
from .plants.contract import (
    PLANT_INPUTS,
    PLANT_STATES,
    Vehicles,
    advance,
    input_at,
    observe,
    place_one,
    state_at,
    vehicle_sizes,
)
from .road import LINE_NUMBERS, PIECE_COLUMNS, Roads
from .variables import VARIABLE_COLUMNS

FEATURES = (
    "late",  # sensors give what there was some time ago
    "variables",  # somebody looks at the scheduling variables
    "estimates",  # of which friction and wind are estimated
    "traces",  # what happens at every instant is kept
    "law",  # a control law drives, not the MPC
)
Features = record("Features", FEATURES, integers=FEATURES)
"""What a batch of runs does, 1 or 0."""

RESULT = record(
    "Result",
    (
        "squared_error",  # m^2, sum over the control instants of (Y - y_ref)^2; inf when the run has failed
        "squared_move",  # rad^2, sum of the squared changes of the command
        "largest_error",  # m
        "instants",  # control instants completed
        "ended",  # RUNNING when the run came to its end, else why it ended, see `loop`
        "ended_at",  # s
        "capped",  # steps whose QP stopped at its cap
        "unsolved",  # steps without a solution of the QP (infeasible, not finite, not convex)
        "held",  # steps whose controller had nothing new to apply
        "limited",  # steps at some limit
        "iterations",  # of the QP solver, summed
    ),
    integers=("instants", "ended", "capped", "unsolved", "held", "limited", "iterations"),
)
"""What is measured of each run."""

RunInputs = record("RunInputs", (("signals", cube), ("roads", Roads), ("scenario", int_vector), ("seeds", int_vector)))
"""Inputs of runs: signals (scenarios, SIGNAL, instants) and roads of the scenarios; the scenario and the noise seed of
each slot (slots,)."""

VariableEstimator = record(
    "VariableEstimator", (("parameters", vector), ("settings", vector), ("memory", rows(friction_wind.Memory)))
)
"""An estimator of friction and wind for the scheduler (see `estimators.friction_wind`): the vehicle that it believes
in, its settings, its memory (slots,)."""

TRACE_SIGNALS = columns("lateral_acceleration", "wheel_angle", "station", "offset", "heading_error")
"""Of an instant: `plants.contract.OBSERVED` under the new input (m/s^2, rad), then where the car is on its road (m, m,
rad)."""
Trace = record("Trace", (("state", cube), ("answer", cube), ("signals", cube)))
"""Of every instant: state (slots, periods, STATES), the controller's answer with the tuning as used (slots, periods,
.), TRACE_SIGNALS (slots, periods, TRACE_SIGNALS)."""

RUN_LOOP = (
    ("settings", LoopSettings),
    ("features", Features),
    ("vehicles", Vehicles),
    ("inputs", RunInputs),
    ("variable_estimator", VariableEstimator),
    ("measured", vector),  # (MEASURED,)
    ("variables", vector),  # (variables.VARIABLES,)
    ("memory", Memory),
    ("result", rows(RESULT)),  # (slots,)
    (
        "cost_limit",
        vector,
    ),  # (slots,) squared error plus weight times squared move that stop a run; NaN: none
    ("segments", matrix),  # (slots, .) cost of each segment of a run
    ("trace", Trace),
)
RunLoop = record("RunLoop", RUN_LOOP)
"""Runs around a controller. Kernels take it or a record that begins with its fields, such as `rollout.RunRecord`."""

RunSpan = record("RunSpan", ("periods", "slots", "segment", "weight"), integers=("periods", "slots", "segment"))
"""What is driven: control periods, slots in use, periods of a segment (0: none is counted), and the weight of the
squared moves in the cost (m^2/rad^2)."""


LoopCounts = record(
    "LoopCounts",
    (
        "slots", "parameters", "states",  # of the plant
        "scenarios", "samples", "roads", "starts", "pieces", "headings",  # of `RunInputs`: samples of each scenario
        "estimator_parameters", "estimator_settings",  # numbers of `VariableEstimator`; 0: nobody estimates
        "dead_whole", "past",  # periods and instants, see `loop.memory_sizes`
        "segments",  # of each run
        "traced", "answers",  # instants and columns of a trace; 0: none
        "requested",  # forces that are remembered, see `loop.Memory`
    ),
    integers=(
        "slots", "parameters", "states", "scenarios", "samples", "roads", "starts", "pieces", "headings",
        "estimator_parameters", "estimator_settings", "dead_whole", "past", "segments", "traced", "answers",
        "requested",
    ),
)  # fmt: skip
"""What the sizes of a `RunLoop` follow from."""


@inlined
def trace_sizes(slots, traced, answers, table, row):
    """Sizes of the arrays of `Trace`, see `layout`."""
    count = slots if traced > 0 else 0
    row = put(table, row, count, traced, PLANT_STATES)
    row = put(table, row, count, traced, answers)
    return put(table, row, count, traced, len(TRACE_SIGNALS))


@inlined
def run_sizes(counts, table, row):
    """Sizes of the arrays of a `RunLoop` (in `Run`, `measured` is that of the MPC), see `layout`."""
    slots = counts.slots
    row = vehicle_sizes(slots, counts.parameters, counts.states, table, row)
    row = put(table, row, counts.scenarios, len(SIGNAL), counts.samples)
    row = put(table, row, counts.scenarios)  # of
    row = put(table, row, counts.roads, len(LINE_NUMBERS))
    row = put(table, row, counts.starts)
    row = put(table, row, counts.pieces, PIECE_COLUMNS)
    row = put(table, row, counts.headings)
    for _ in range(2):  # scenario, seeds
        row = put(table, row, slots)
    row = put(table, row, counts.estimator_parameters)
    row = put(table, row, counts.estimator_settings)
    row = put(table, row, slots if counts.estimator_parameters > 0 else 0)
    row = put(table, row, len(MEASUREMENT))
    row = put(table, row, len(VARIABLE_COLUMNS))
    row = memory_sizes(slots, counts.dead_whole, counts.past, counts.requested, table, row)
    for _ in range(2):  # result, cost limit
        row = put(table, row, slots)
    row = put(table, row, slots, counts.segments)
    return trace_sizes(slots, counts.traced, counts.answers, table, row)


def no_trace() -> Any:
    """No trace."""
    return traces(0, 0, 0)


def traces(slots: int, periods: int, answers: int) -> Any:
    """Traces before the first instant, NaN, with so many columns of answers."""
    trace = allocate(Trace, trace_sizes, slots, periods, answers)
    for array in trace:
        array[:] = math.nan
    return trace


@inlined
def begin_slot(slot, run):
    """Before the first instant: the vehicle at its start in its steady turn, nothing remembered, nothing counted."""
    result, vehicles = run.result[slot], run.vehicles
    result.squared_error, result.squared_move, result.largest_error, result.instants = 0.0, 0.0, 0.0, 0
    result.ended, result.ended_at, result.capped, result.unsolved, result.held = RUNNING, 0.0, 0, 0, 0
    result.limited, result.iterations = 0, 0
    place_one(slot, vehicles.start, vehicles.block, vehicles.states)
    for j in range(PLANT_INPUTS):
        vehicles.block[input_at(j, slot)] = 0.0
    forget(slot, run.memory)
    turn_steadily(slot, run)


# -- until the controller knows all that it is given ------------------------------------------------------------------
@inlined
def before_control(slot, span, run):
    """From an instant until everything is known that the controller is given.

    A run that fails says so in `memory`; the instant at the end of the last period is not judged. Nothing is measured
    of a car whose state is not finite.
    """
    drive = run.memory.drives[slot]
    locate(slot, run)
    if drive.instant < span.periods:
        _judge_and_count(slot, span, run)
    if drive.ended == STATE_NOT_FINITE:
        return
    sense(slot, run)
    if run.features.variables:
        look(slot, run.measured, run)
    if run.features.estimates:
        _estimate_friction_and_wind(slot, run)


@inlined
def _judge_and_count(slot, span, run):
    """Judge the run; count its error, unless it ends here."""
    drive, result, block = run.memory.drives[slot], run.result[slot], run.vehicles.block
    k = drive.instant
    drive.error = drive.offset - run.inputs.signals[run.inputs.scenario[slot], SIGNAL.y_ref, drive.sample]
    drive.ended = judge(slot, run)
    if run.features.traces:
        for j in range(PLANT_STATES):
            run.trace.state[slot, k, j] = block[state_at(j, slot)]
    if drive.ended != RUNNING:
        drive.ended_at = k * run.settings.period
        return
    squared = drive.error * drive.error
    result.squared_error += squared
    if span.segment > 0:
        run.segments[slot, k // span.segment] += squared
    result.largest_error = max(result.largest_error, abs(drive.error))
    result.instants += 1


@inlined
def _estimate_friction_and_wind(slot, run):
    """Let the scheduling variables have friction and wind as they are estimated."""
    drive, estimator = run.memory.drives[slot], run.variable_estimator
    friction_wind.estimate(
        slot,
        run.measured,
        drive.speed,
        drive.command,
        math.nan,
        estimator.parameters,
        estimator.settings,
        estimator.memory,
    )
    run.variables[VARIABLE_COLUMNS.friction] = estimator.memory[slot].friction
    run.variables[VARIABLE_COLUMNS.wind] = estimator.memory[slot].wind


# -- from the controller's command on ---------------------------------------------------------------------------------
@inlined
def after_control(slot, command, change, span, run):
    """From the controller's command and its change (rad) until the vehicle is about to move.

    The run ends when its cost has reached its limit.
    """
    drive, result = run.memory.drives[slot], run.result[slot]
    actuate(slot, command, run)
    if run.features.traces:
        write_trace_signals(slot, run, run.trace.signals[slot, drive.instant])
    result.squared_move += change * change
    if span.segment > 0:
        run.segments[slot, drive.instant // span.segment] += span.weight * change * change
    if result.squared_error + span.weight * result.squared_move >= run.cost_limit[slot]:
        drive.ended = STOPPED
    drive.instant += 1
    drive.sample += 1


@inlined
def write_trace_signals(slot, run, row):
    """Write TRACE_SIGNALS: what is measured under the new input, and where the car is."""
    drive = run.memory.drives[slot]
    observe(slot, run.vehicles, row)
    row[TRACE_SIGNALS.station], row[TRACE_SIGNALS.offset] = drive.station, drive.offset
    row[TRACE_SIGNALS.heading_error] = drive.heading_error


@inlined
def move(slots, run):
    """Move the vehicles on to the next instant; within the period the next command begins to act."""
    world = run.settings
    before, after = substeps_around_change(world)
    if before > 0:
        advance(slots, before, world.dead_share * world.period / before, run.vehicles)
        change_command(slots, run)
    advance(slots, after, (1.0 - world.dead_share) * world.period / after, run.vehicles)


@inlined
def close(slot, run):
    """Say of a run that is over how it ended: one whose car never came near its reference has failed at once."""
    drive, result = run.memory.drives[slot], run.result[slot]
    if drive.arrived == 0 and drive.ended != STOPPED:
        drive.ended, drive.ended_at = NEVER_ARRIVED, 0.0
    result.ended, result.ended_at = drive.ended, drive.ended_at
    if drive.ended != RUNNING and drive.ended != STOPPED:
        result.squared_error = math.inf


# -- one run around a controller in Python ----------------------------------------------------------------------------
@exported(void(Place(RunLoop)))
def begin_one(run):
    """`begin_slot` of the only slot."""
    begin_slot(0, run)


@exported(void(RunSpan, Place(RunLoop)))
def sense_one(span, run):
    """`before_control` of the only slot."""
    before_control(0, span, run)


@exported(void(float64, float64, RunSpan, Place(RunLoop)))
def send_one(command, change, span, run):
    """`after_control` of the only slot."""
    after_control(0, command, change, span, run)


@exported(void(Place(RunLoop)))
def move_one(run):
    """`move`, of the only slot."""
    move(1, run)


@exported(void(Place(RunLoop)))
def close_one(run):
    """`close`, of the only slot."""
    close(0, run)


@exported(several(int64, int64)(Place(RunLoop)))
def substeps_of(run):
    """`loop.substeps_around_change`, for a plant that moves outside the kernels."""
    return substeps_around_change(run.settings)


@exported(void(Place(RunLoop)))
def change_command_of_one(run):
    """`loop.change_command`, of the only slot, for a plant that moves outside the kernels."""
    change_command(1, run)

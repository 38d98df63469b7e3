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

from ..estimators import friction_wind
from ..kernel import (
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
from ..layout import allocate
from ..models.contract import MEASUREMENT
from ..plants.contract import (
    PLANT_INPUTS,
    PLANT_STATES,
    Vehicles,
    advance,
    input_at,
    observe,
    place_one,
    state_at,
    work_states,
)
from ..roads.road import Roads
from ..scheduling.variables import VARIABLE_COLUMNS
from .world import (
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
    sense,
    substeps_around_change,
    turn_steadily,
)

FEATURES = (
    "late",  # sensors give what there was some time ago
    "variables",  # somebody looks at the scheduling variables
    "estimates",  # of which friction and wind are estimated
    "traces",  # what happens at every instant is kept
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

RunInputs = record(
    "RunInputs",
    (
        ("signals", cube, "scenarios", len(SIGNAL), "samples"), ("roads", Roads),  # of the scenarios
        ("scenario", int_vector, "slots"), ("seeds", int_vector, "slots"),  # of each slot
    ),
)  # fmt: skip

VariableEstimator = record(
    "VariableEstimator",
    (
        ("parameters", vector, "estimator_parameters"),  # of the vehicle that it assumes
        ("settings", vector, "estimator_settings"),
        ("memory", rows(friction_wind.Memory), "estimator_slots"),
    ),
)
"""An estimator of friction and wind for the scheduler, see `estimators.friction_wind`."""

TRACE_SIGNALS = columns("lateral_acceleration", "wheel_angle", "station", "offset", "heading_error")
"""Of an instant: `plants.contract.OBSERVED` under the new input (m/s^2, rad), then where the car is on its road (m, m,
rad)."""
Trace = record(
    "Trace",
    (
        ("state", cube, "traced_slots", "traced", PLANT_STATES),
        ("answer", cube, "traced_slots", "traced", "answers"),  # the controller's, then the tuning as used
        ("signals", cube, "traced_slots", "traced", len(TRACE_SIGNALS)),
    ),
)
"""Of every instant of each run."""

RUN_LOOP = (
    ("settings", LoopSettings),
    ("features", Features),
    ("vehicles", Vehicles),
    ("inputs", RunInputs),
    ("variable_estimator", VariableEstimator),
    ("measured", vector, len(MEASUREMENT)),
    ("variables", vector, len(VARIABLE_COLUMNS)),
    ("memory", Memory),
    ("result", rows(RESULT), "slots"),
    ("cost_limit", vector, "slots"),  # squared error plus weight times squared move that stop a run; NaN: none
    ("segments", matrix, "slots", "segments"),  # cost of each segment of a run
    ("trace", Trace),
)
RunLoop = record("RunLoop", RUN_LOOP)
"""Runs around a controller. Kernels take it or a record that begins with its fields, such as `rollout.RunRecord`."""

RunSpan = record("RunSpan", ("periods", "slots", "segment", "weight"), integers=("periods", "slots", "segment"))
"""What is driven: control periods, slots in use, periods of a segment (0: none is counted), and the weight of the
squared moves in the cost (m^2/rad^2)."""


CHOSEN_LOOP_SIZES = (
    "slots",
    "plant_parameters", "plant_states",  # of the plant
    "scenarios", "samples", "roads", "starts", "pieces", "headings",  # of `RunInputs`: samples of each scenario
    "estimator_parameters", "estimator_settings",  # numbers of `VariableEstimator`; 0: nobody estimates
    "dead_whole", "past",  # periods of dead time; instants that late sensors look back
    "segments",  # of each run
    "traced", "answers",  # instants and columns of a trace; 0: none
    "requested",  # forces that are remembered, 2 (whole periods of the longer dead time + 2)
)  # fmt: skip
DERIVED_LOOP_SIZES = ("work_states", "estimator_slots", "sent", "traced_slots")
LOOP_SIZES = (*CHOSEN_LOOP_SIZES, *DERIVED_LOOP_SIZES)
LoopSizes = record("LoopSizes", LOOP_SIZES, integers=LOOP_SIZES)
"""The sizes of a `RunLoop`: first those that are chosen, then those that follow from them."""


@inlined
def complete_loop_sizes(sizes):
    """Write the sizes that follow from those that are chosen."""
    sizes.work_states = work_states(sizes.plant_states)
    sizes.estimator_slots = sizes.slots if sizes.estimator_parameters > 0 else 0
    sizes.sent = sizes.dead_whole + 2
    sizes.traced_slots = sizes.slots if sizes.traced > 0 else 0


def run_loop(**chosen: Any) -> Any:
    """A `RunLoop` of zeros; chosen: `LoopSizes` that are not 0."""
    (sizes,) = LoopSizes.new(1, **chosen)
    complete_loop_sizes(sizes)
    return allocate(RunLoop, sizes)


def no_trace() -> Any:
    """No trace."""
    return traces(0, 0, 0)


def traces(slots: int, periods: int, answers: int) -> Any:
    """Traces before the first instant, NaN, with so many columns of answers."""
    trace = allocate(Trace, {"traced_slots": slots, "traced": periods, "answers": answers})
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

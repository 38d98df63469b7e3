"""Simulated runs: cars with their controllers in the order of `loop.period_of`, a batch of slots at a time.

    locate -> judge -> sense -> (look -> estimate friction and wind)       arrive
    (narrow the friction, speed control)                                   prepare
    (schedule) -> controller                                               control
    actuate -> count -> note                                               depart
    advance                                                                move: all cars at once

Plants, controllers and speed controls come as functions by their addresses, see `plants.contract`, `controllers.part`
and `CONTROL_SPEED`: compiled ones, or Python that is called back (`member.CallBack`). A caller may be the controller,
or may have a say before each step of one: then the run waits at every instant until it has answered (`features.asks`).
"""

from __future__ import annotations

import math
from typing import Any

from ..controllers import mpc, part
from ..controllers.part import COMMON_ANSWER
from ..estimators import friction_wind
from ..estimators.learning import BELIEF_COLUMNS, KNOWN_DELAY_SIGMA
from ..kernel import (
    Caller,
    Place,
    Row,
    columns,
    cube,
    exported,
    float64,
    inlined,
    int64,
    int_matrix,
    int_vector,
    matrix,
    record,
    rows,
    vector,
    void,
)
from ..layout import allocate, sizer
from ..loop import period_of
from ..maths.bits import whole
from ..models.contract import MEASUREMENT
from ..plants import contract as plants
from ..qp import problem as qp
from ..roads.road import Roads
from ..scheduling.functions import VARIABLE_COLUMNS
from ..speed.friction import narrow_friction
from ..speed.speed_control import governed_speeds
from ..tracker.longitudinal import Longitudinal, speed_control_step
from . import world
from .world import NOT_ASKED, RUNNING, SIGNAL, STOPPED

FEATURES = (
    "late",  # sensors give what there was some time ago
    "variables",  # somebody looks at the scheduling variables
    "estimates",  # of which friction and wind are estimated
    "traces",  # what happens at every instant is kept
    "asks",  # the caller is asked before each step of a controller; without the address of one it is the controller
    "window",  # signals begin at the present instant, and a run goes on after a failure
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
_clear_result = world.clearer(RESULT)

RunInputs = record(
    "RunInputs",
    (
        ("signals", cube, "scenarios", len(SIGNAL), "samples"), ("roads", Roads),  # of the scenarios
        ("scenario", int_vector, "slots"), ("seeds", int_vector, "slots"),  # of each slot
        ("periods", int_vector, "slots"),  # until its run comes to its end
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
        ("state", cube, "traced_slots", "traced", plants.PLANT_STATES),
        ("answer", cube, "traced_slots", "traced", "answers"),  # the controller's, then the tuning as used
        ("signals", cube, "traced_slots", "traced", len(TRACE_SIGNALS)),
    ),
)
"""Of every instant of each run."""

Frames = record(
    "Frames",
    (
        ("numbers", matrix, "frames", "columns"), ("predicted", matrix, "frames", "points"),
        ("moves", matrix, "frames", "moves"),
    ),
)  # fmt: skip
"""What `frame.show_period` writes of the last instants: instant k in row k modulo the number of rows."""

RunRecord = record(
    "RunRecord",
    (
        ("settings", world.LoopSettings),
        ("features", Features),
        ("vehicles", plants.Vehicles),
        ("inputs", RunInputs),
        ("variable_estimator", VariableEstimator),
        ("measured", matrix, "slots", len(MEASUREMENT)),
        ("variables", matrix, "slots", len(VARIABLE_COLUMNS)),
        ("memory", world.Memory),
        ("result", rows(RESULT), "slots"),
        ("cost_limit", vector, "slots"),  # squared error plus weight times squared move that stop a run; NaN: none
        ("weight", float64),  # m^2/rad^2, of squared moves in a cost
        ("segment", int64),  # periods of a segment; 0: none is counted
        ("segments", matrix, "slots", "segments"),  # cost of each segment of a run
        ("trace", Trace),
        ("controller", part.ControllerPart),
        ("control_speed", int64),  # address, see `CONTROL_SPEED`; 0: there is no speed control
        ("longitudinal", Longitudinal),  # of `control_planned_speed`, for one slot; else empty
        ("speeds", vector, "speeds"),  # m/s, room for the speeds from now on that it allows
        ("show", int64),  # address of `frame.show_period`; 0: nothing is shown
        ("frames", Frames),
    ),
)
"""A batch of runs with their controllers."""
CONTROL_SPEED = void(Place(RunRecord))
"""``control_speed(run)``: request the forces of the only slot (`world.EXTERNAL_FORCES`) before its controller steps."""
SHOW = void(int64, Place(RunRecord))
"""``show(slot, run)``: take what is to be seen of a period, before the car moves."""
_call_control_speed, _call_show = Caller(CONTROL_SPEED), Caller(SHOW)

CHOSEN_SIZES = (
    "slots",
    "plant_parameters", "plant_states",  # of the plant
    "scenarios", "samples", "roads", "starts", "pieces", "headings",  # of `RunInputs`: samples of each scenario
    "estimator_parameters", "estimator_settings",  # numbers of `VariableEstimator`; 0: nobody estimates
    "dead_whole", "past",  # periods of dead time; instants that late sensors look back
    "segments",  # of each run
    "traced", "answers",  # instants and columns of a trace; 0: none
    "requested",  # forces that are remembered, 2 (whole periods of the longer dead time + 2)
    "speeds", "frames", "columns", "points", "moves",  # of a run that is shown
)  # fmt: skip
DERIVED_SIZES = ("work_states", "estimator_slots", "sent", "traced_slots")
RUN_SIZES = (*CHOSEN_SIZES, *DERIVED_SIZES)
RunSizes = record("RunSizes", (*RUN_SIZES, ("controller", part.ControllerSizes)), integers=RUN_SIZES)
"""The sizes of a `RunRecord`: first those that are chosen, then those that follow from them."""
_write_sizes = sizer(RunRecord, RunSizes)


@inlined
def _complete_sizes(sizes):
    """Write the sizes that follow from those that are chosen."""
    sizes.work_states = plants.work_states(sizes.plant_states)
    sizes.estimator_slots = sizes.slots if sizes.estimator_parameters > 0 else 0
    sizes.sent = sizes.dead_whole + 2
    sizes.traced_slots = sizes.slots if sizes.traced > 0 else 0


@exported(int64(Row(mpc.MPCSettings), Row(RunSizes), int_matrix), name="run_sizes")
def write_sizes(settings, sizes, table):
    """Write the sizes of the arrays of a `RunRecord` and how many there are, see `layout`.

    Completed are the sizes, and the settings where an MPC drives.
    """
    _complete_sizes(sizes)
    if sizes.controller.law_answer == 0:
        mpc.complete_sizes(settings, sizes.controller.mpc)
    part.complete_controller_sizes(sizes.controller)
    return _write_sizes(sizes, table)


def new_run(sizes: dict[str, int], **given: Any) -> Any:
    """A `RunRecord` of zeros but for the fields that are given; sizes: `RunSizes` that are not 0."""
    (row,) = RunSizes.new(1, **sizes)
    _complete_sizes(row)
    return allocate(RunRecord, row, **given)


def traces(slots: int, periods: int, answers: int) -> Any:
    """Traces before the first instant, NaN, with so many columns of answers; (0, 0, 0): no trace."""
    trace = allocate(Trace, {"traced_slots": slots, "traced": periods, "answers": answers})
    for array in trace:
        array[:] = math.nan
    return trace


# -- arrive: until the controller knows all that it is given ----------------------------------------------------------
@inlined
def _arrive(slot, run):
    """At an instant, until everything is known that the controller is given; whether the run goes on.

    Where the caller is asked, it goes on at the instant at which it ends, too: that the caller may look at it.
    """
    drive = run.memory.drives[slot]
    if drive.caller_state == NOT_ASKED:
        if run.features.window > 0:
            drive.sample, drive.place, drive.departed, drive.standing = 0, 0, 0, 0
        _sense_instant(slot, run)
    return drive.ended == RUNNING or run.features.asks > 0


@inlined
def _sense_instant(slot, run):
    """Judge a run at its instant, and sense.

    A run that fails says so in `memory`; the instant at the end of the last period is not judged. Nothing is measured
    of a car whose state is not finite.
    """
    drive = run.memory.drives[slot]
    world.locate(slot, run)
    if drive.instant < run.inputs.periods[slot]:
        _judge_and_count(slot, run)
    if drive.ended == world.STATE_NOT_FINITE:
        return
    world.sense(slot, run)
    if run.features.variables:
        world.look(slot, run)
    if run.features.estimates:
        _estimate_friction_and_wind(slot, run)


@inlined
def _judge_and_count(slot, run):
    """Judge the run; count its error, unless it ends here."""
    drive, result, block = run.memory.drives[slot], run.result[slot], run.vehicles.block
    k = drive.instant
    drive.error = drive.offset - run.inputs.signals[run.inputs.scenario[slot], SIGNAL.y_ref, drive.sample]
    drive.ended = world.judge(slot, run)
    if run.features.traces:
        for j in range(plants.PLANT_STATES):
            run.trace.state[slot, k, j] = block[plants.state_at(j, slot)]
    if drive.ended != RUNNING:
        drive.ended_at = k * run.settings.period
        return
    squared = drive.error * drive.error
    result.squared_error += squared
    if run.segment > 0:
        run.segments[slot, k // run.segment] += squared
    result.largest_error = max(result.largest_error, abs(drive.error))
    result.instants += 1


@inlined
def _estimate_friction_and_wind(slot, run):
    """Let the scheduling variables have friction and wind as they are estimated."""
    drive, estimator, variables = run.memory.drives[slot], run.variable_estimator, run.variables[slot]
    friction_wind.estimate(
        slot, run.measured[slot], drive.speed, drive.command, math.nan, estimator.parameters, estimator.settings,
        estimator.memory,
    )  # fmt: skip
    variables[VARIABLE_COLUMNS.friction] = estimator.memory[slot].friction
    variables[VARIABLE_COLUMNS.wind] = estimator.memory[slot].wind


# -- prepare: the speed control, and the caller -----------------------------------------------------------------------
@inlined
def _prepare(slot, run):
    """Let the speed control request the forces; ask the caller. Whether the controller is to answer now."""
    drive = run.memory.drives[slot]
    if drive.caller_state == NOT_ASKED:
        if run.control_speed != 0 and drive.ended == RUNNING:
            _call_control_speed(run.control_speed, run)
        if run.features.asks > 0:
            drive.caller_state = world.ASKED
    if drive.caller_state == world.ASKED:
        return False
    drive.caller_state = NOT_ASKED
    return drive.ended == RUNNING


@exported(CONTROL_SPEED)
def control_planned_speed(run):
    """Step the speed control of the only slot; write its requests, and the governed speeds (m/s) from now on.

    It limits the speed to `sample.top_speed`, which `_control` ends.
    """
    longitudinal = run.longitudinal
    drive, measured, learned = run.memory.drives[0], run.measured[0], run.controller.mpc.informed.learned[0]
    sample, memory = longitudinal.sample[0], longitudinal.memory[0]
    narrow_friction(measured, drive.speed, drive.command, learned, longitudinal)
    measured[MEASUREMENT.friction] = longitudinal.friction.memory[0].least
    sample.station, sample.station_age, sample.offset = drive.station_estimate, 0.0, 0.0
    sample.speed, sample.speed_age, sample.is_guided, sample.periods = drive.speed, 0.0, 1.0, 1.0
    sample.yaw_rate = measured[MEASUREMENT.yaw_rate]
    speed_control_step(longitudinal)
    drive.requested_force, drive.requested_hold = memory.force, memory.hold
    governed_speeds(
        drive.speed, longitudinal.settings.period, longitudinal.path.spacing, longitudinal.ahead, run.speeds
    )  # fmt: skip


# -- control ----------------------------------------------------------------------------------------------------------
@inlined
def _control(slot, run):
    """The controller's step; its answer is in its record, where a caller that is the controller has written it."""
    drive, scenario, controller = run.memory.drives[slot], run.inputs.scenario[slot], run.controller
    if controller.step == 0:
        answer = controller.answer[slot]
        answer[COMMON_ANSWER.command_change] = answer[COMMON_ANSWER.command] - drive.command
        return
    signals, road = run.inputs.signals[scenario], run.inputs.roads.of[scenario]
    planned = signals[SIGNAL.speed]
    first = world.plan_instant(slot, run) if road >= 0 else planned.size
    speeds = run.speeds if run.speeds.size > 0 else planned[first:]
    part.control(
        slot, run.variables[slot], drive.speed, drive.command, drive.station_estimate, road, run.measured[slot],
        signals[SIGNAL.y_ref, drive.sample :], speeds, run.inputs.roads, controller,
    )  # fmt: skip
    if run.longitudinal.sample.size > 0 and controller.beliefs > 0:
        sigma = controller.beliefs + BELIEF_COLUMNS.belief_delay_sigma
        if controller.answer[slot, sigma] < KNOWN_DELAY_SIGMA:  # it knows the delay of its steering
            run.longitudinal.sample[0].top_speed = math.inf


# -- depart: from the controller's command on -------------------------------------------------------------------------
@inlined
def _depart(slot, run):
    """From the controller's answer until the vehicle is about to move.

    A run ends when its command is not finite, and when its cost has reached its limit.
    """
    drive, result, answer = run.memory.drives[slot], run.result[slot], run.controller.answer[slot]
    k, command, change = drive.instant, answer[COMMON_ANSWER.command], answer[COMMON_ANSWER.command_change]
    if not math.isfinite(command):
        drive.ended, drive.ended_at = world.STATE_NOT_FINITE, k * run.settings.period
        return
    world.actuate(slot, command, run)
    if run.features.traces:
        write_trace_signals(slot, run, run.trace.signals[slot, k])
    result.squared_move += change * change
    weighted = run.weight * change * change
    drive.cost = drive.error * drive.error + weighted
    if run.segment > 0:
        run.segments[slot, k // run.segment] += weighted
    if result.squared_error + run.weight * result.squared_move >= run.cost_limit[slot]:
        drive.ended = STOPPED
    drive.instant += 1
    drive.sample += 1
    _count_answer(k, slot, run)
    if run.show != 0 and drive.ended == RUNNING:
        _call_show(run.show, slot, run)


@inlined
def write_trace_signals(slot, run, row):
    """Write TRACE_SIGNALS: what is measured under the new input, and where the car is."""
    drive = run.memory.drives[slot]
    plants.observe(slot, run.vehicles, row)
    row[TRACE_SIGNALS.station], row[TRACE_SIGNALS.offset] = drive.station, drive.offset
    row[TRACE_SIGNALS.heading_error] = drive.heading_error


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
        row[:size], row[size:] = answer, tuning[: row.size - size]


_drive_period = period_of(_arrive, _prepare, _control, _depart)


# -- runs -------------------------------------------------------------------------------------------------------------
@inlined
def begin_slot(slot, run):
    """Before the first instant: the vehicle at its start in its steady turn, nothing remembered, nothing counted."""
    vehicles = run.vehicles
    _clear_result(run.result[slot])
    plants.place_one(slot, vehicles.start, vehicles.block, vehicles.states)
    for j in range(plants.PLANT_INPUTS):
        vehicles.block[plants.input_at(j, slot)] = 0.0
    world.forget(slot, run.memory)
    world.turn_steadily(slot, run)
    part.begin_controller(slot, run.memory.drives[slot].command, run.controller)


@exported(void(int64, Place(RunRecord)), name="begin_runs")
def begin(slots, run):
    """Everything as it is before the first instant, for the first `slots` slots.

    The models that an MPC holds stay.
    """
    run.segments[:, :] = 0.0
    for i in range(slots):
        begin_slot(i, run)


@inlined
def _move(slots, run):
    """Move the vehicles on to the next instant; within the period the next command begins to act."""
    settings = run.settings
    before, after = world.substeps_around_change(settings)
    if before > 0:
        plants.advance(slots, before, settings.dead_share * settings.period / before, run.vehicles)
        world.change_command(slots, run)
    plants.advance(slots, after, (1.0 - settings.dead_share) * settings.period / after, run.vehicles)


@inlined
def _close(slot, run):
    """Say of a run that is over how it ended: one whose car never came near its reference has failed at once."""
    drive, result = run.memory.drives[slot], run.result[slot]
    if drive.arrived == 0 and drive.ended != STOPPED:
        drive.ended, drive.ended_at = world.NEVER_ARRIVED, 0.0
    result.ended, result.ended_at = drive.ended, drive.ended_at
    if drive.ended != RUNNING and drive.ended != STOPPED:
        result.squared_error = math.inf


@inlined
def _end_slot(k, slot, run):
    """Close a run that ends at instant k before its time, and park its slot in its initial state."""
    _close(slot, run)
    if run.segment > 0:
        first = max(k - 1, 0) // run.segment
        run.segments[slot, first:] = math.nan
        run.segments[slot, first] = math.inf
    plants.place_one(slot, run.vehicles.start, run.vehicles.block, run.vehicles.states)


@inlined
def _drive_slot(slot, run):
    """One period of a slot that is under way; whether it drives on from it."""
    drive, periods = run.memory.drives[slot], run.inputs.periods[slot]
    k = drive.instant
    if drive.ended != RUNNING or k > periods or (k == periods and run.features.asks == 0):
        return False
    answered = _drive_period(slot, run)
    if drive.ended != RUNNING and run.features.window == 0:
        _end_slot(k, slot, run)
    return answered and drive.ended == RUNNING


@exported(int64(int64, int64, Place(RunRecord)))
def roll_on(count, slots, run):
    """Up to so many further periods of the first `slots` runs, from where `begin` or the last call left each.

    Returns how many were driven. It ends before when no run drives on: at their end, or until a caller who is asked has
    answered. A run ends early when it has failed (`world.judge`), or, as STOPPED, once its cost has reached its limit
    and can only grow. The cost of each segment is written to `segments`: inf where a run ends, NaN after.
    """
    periods = 0
    while periods < count:
        running = 0
        for i in range(slots):
            running += 1 if _drive_slot(i, run) else 0
        if running == 0:
            break
        _move(slots, run)
        periods += 1
    for i in range(slots):
        if run.memory.drives[i].ended == RUNNING and run.memory.drives[i].instant >= run.inputs.periods[i]:
            _close(i, run)
    return periods

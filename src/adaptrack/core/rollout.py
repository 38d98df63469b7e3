"""Whole runs, compiled: the control periods of `loop` over the slots of a batch, each a vehicle with its controller.

Plants, prediction models, estimators and control laws come as compiled functions (see their contracts); the MPC alone
is built in.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from .controllers import mpc
from .controllers.contract import SITUATION, Situation, call_law
from .estimators import friction_wind
from .kernel import Place, address_of, cube, exported, inlined, int64, int_vector, matrix, record, rows, vector, void
from .loop import (
    NEVER_ARRIVED,
    RUNNING,
    SETTINGS,
    SIGNAL,
    STOPPED,
    Memory,
    actuate,
    change_command,
    forget,
    judge,
    locate,
    look,
    sense,
    substeps_around_change,
)
from .maths.bits import whole
from .models.contract import MEASURED
from .plants.contract import (
    STATES,
    Vehicles,
    call_advance,
    call_observe,
    place,
    place_one,
    state_at,
)
from .qp import problem as qp
from .road import RoadAhead, Roads, bend_ahead, line_of
from .schedule import Schedule, schedule
from .variables import VARIABLES

COMMON = 3
"""Every controller's answer begins with command, command change and `held`, as `mpc.ANSWER` does."""

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
    whole=("instants", "ended", "capped", "unsolved", "held", "limited", "iterations"),
)
"""What is measured of each run."""

Given = record("Given", (("signals", cube), ("roads", Roads), ("scenario", int_vector), ("seeds", int_vector)))
"""What happens: signals (scenarios, SIGNAL, instants) and roads of the scenarios; which of them a slot drives, and its
noise seed (slots,)."""

Law = record(
    "Law",
    (
        ("parameters", vector), ("memory", matrix), ("situation", vector), ("own_answer", vector), ("answer", matrix),
        ("held", int64), ("preview", int64),
    ),
)  # fmt: skip
"""A batch of controllers that are not the MPC: memory (slots, m); what the law answers (1 + diagnostics,); that behind
the COMMON columns (slots, COMMON + diagnostics), (0, 0) where the MPC drives; place of the diagnostic ``held`` in a
law's answer, 0 for none; whether the law sees the reference ahead."""

Perceiving = record("Perceiving", (("parameters", vector), ("settings", vector), ("memory", matrix)))
"""An estimator of friction and wind for the scheduler (see `estimators.friction_wind`): the vehicle that it believes
in, its settings, its memory (slots, .); empty for none."""

Trace = record("Trace", (("state", cube), ("answer", cube), ("seen", cube)))
"""Of every instant: state (slots, periods, STATES), the controller's answer with the tuning as used (slots, periods,
.), lateral acceleration (m/s^2) and front-wheel angle (rad) under the new input, then where the car is on its
road: arc length and offset (m), heading error (rad) (slots, periods, 5). Empty for none."""

Members = record("Members", ("advance", "observe", "law"), whole=("advance", "observe", "law"))
"""Addresses of the plant's two functions and of the control law, see their contracts; 0: none."""

_PARTS = (
    ("settings", rows(SETTINGS)),  # (1,)
    ("members", Members),
    ("vehicles", Vehicles),
    ("given", Given),
    ("mpc", mpc.Mpc),
    ("functions", mpc.Functions),  # of the MPC
    ("law", Law),
    ("schedule", Schedule),
    ("perceiving", Perceiving),
    ("tuning", matrix),  # (slots, entries) of the controller, written by the scheduler if there is one
    ("variables", vector),  # (variables.VARIABLES,)
    ("memory", Memory),
    ("result", rows(RESULT)),  # (slots,)
    ("ceiling", vector),  # (slots,) sum of squared error plus weight times squared move at which a run stops
    ("segments", matrix),  # (slots, .) cost of each segment of a run; empty when not asked
    ("trace", Trace),
    ("seen", vector),  # (2,) scratch
)
Run = record("Run", _PARTS)
"""A batch of runs."""

Span = record("Span", ("periods", "slots", "segment", "weight"), whole=("periods", "slots", "segment"))
"""What is driven: control periods, slots in use, periods of a segment, and the weight of the squared moves in the cost
(m^2/rad^2)."""


def members(**compiled: Any) -> Any:
    """`Members`, from compiled functions by name."""
    return Members(*[address_of(compiled.get(name)) for name in Members._fields])


def no_law_batch() -> Any:
    """The laws of a batch that the MPC drives."""
    none = np.zeros(0)
    return Law(none, np.zeros((0, 0)), none, none, np.zeros((0, 0)), 0, 0)


def law_batch(slots: int, parameters: Any, memory: int, diagnostics: tuple[str, ...], preview: bool) -> Any:
    """Fresh control laws for `slots` slots; diagnostics: the names of what the law answers behind the command."""
    held = 1 + diagnostics.index("held") if "held" in diagnostics else 0
    return Law(
        np.array(parameters, float), np.zeros((slots, memory)), np.zeros(len(SITUATION)),
        np.zeros(1 + len(diagnostics)), np.zeros((slots, COMMON + len(diagnostics))), held, int(preview),
    )  # fmt: skip


def no_trace() -> Any:
    """No trace."""
    return Trace(*[np.zeros((0, 0, 0))] * 3)


# -- one control period -----------------------------------------------------------------------------------------------
@inlined
def sense_slot(k, slot, run):
    """What the sensors of a slot give at instant k; the measured speed."""
    measured, vehicles = run.mpc.measured, run.vehicles
    if run.settings[0].noise_lateral_acceleration < math.inf:
        call_observe(
            run.members.observe, vehicles.member, vehicles.parameters, vehicles.block, vehicles.states, vehicles.work,
            slot, run.seen,
        )  # fmt: skip
        measured[MEASURED.lateral_acceleration] = run.seen[0]
    return sense(k, slot, vehicles.block, run.settings, run.given.seeds[slot], run.memory, measured)


@inlined
def _schedule(k, slot, speed, run):
    """Let the scheduler, if there is one, write the slot's tuning."""
    if run.schedule.settings[0].n_inputs == 0:
        return
    look(k, speed, run.mpc.measured, run.given.signals, run.given.scenario[slot], run.variables)
    knowing = run.perceiving
    if knowing.settings.size > 0:
        friction_wind.estimate(
            slot, run.mpc.measured, speed, run.memory.own[slot].command, math.nan, knowing.parameters, knowing.settings,
            knowing.memory,
        )  # fmt: skip
        run.variables[VARIABLES.friction] = knowing.memory[slot, friction_wind.FRICTION_HAT]
        run.variables[VARIABLES.wind] = knowing.memory[slot, friction_wind.WIND_HAT]
    schedule(slot, run.variables, run.schedule, run.tuning[slot])


@inlined
def _apply_law(k, slot, speed, reference, run):
    """A control law at instant k; a command that is not finite holds the last one."""
    own, out, given, seen = run.memory.own[slot], run.law.answer[slot], run.law.situation, run.mpc.measured
    roads, scenario = run.given.roads, run.given.scenario[slot]
    first = k if roads.of[scenario] >= 0 else run.given.signals.shape[2]
    planned = run.given.signals[scenario, SIGNAL.speed, first:]
    road = RoadAhead(line_of(roads.of[scenario], roads), own.station, planned)
    no_vy = run.settings[0].noise_vy == math.inf  # a car without a sensor of it
    now = Situation(
        0.0 if no_vy else seen[MEASURED.vy],
        seen[MEASURED.yaw],
        seen[MEASURED.yaw_rate],
        seen[MEASURED.y],
        speed,
        own.command,
    )
    for i in range(len(now)):
        given[i] = now[i]
    found = run.law.own_answer
    ahead = reference if run.law.preview > 0 else reference[:1]
    call_law(
        run.members.law, given, ahead, road, run.tuning[slot], run.law.parameters, run.law.memory[slot], found
    )  # fmt: skip
    usable = math.isfinite(found[0])
    out[0] = found[0] if usable else own.command
    out[1] = out[0] - own.command
    out[2] = 1.0 if not usable or (run.law.held > 0 and found[run.law.held] > 0.5) else 0.0
    for i in range(1, found.size):
        out[COMMON - 1 + i] = found[i]


@inlined
def _see_bend(k, slot, speed, run):
    """Show the MPC the road ahead."""
    settings, scenario = run.mpc.settings[0], run.given.scenario[slot]
    road = run.given.roads.of[scenario]
    if road < 0:
        run.mpc.bend[:] = 0.0
        return
    bend_ahead(
        run.memory.own[slot].station, run.given.signals[scenario, SIGNAL.speed, k:], max(speed, settings.speed_floor),
        mpc.lead_of(slot, run.mpc), settings.period, road, run.given.roads, run.mpc.bend,
    )  # fmt: skip


@inlined
def control_slot(k, slot, speed, run):
    """The controller's answer at instant k."""
    reference = run.given.signals[run.given.scenario[slot], SIGNAL.y_ref, k:]
    if run.law.answer.size > 0:
        _apply_law(k, slot, speed, reference, run)
        return (run.law.answer[slot],)
    if run.mpc.bend.size > 0:
        _see_bend(k, slot, speed, run)
    mpc.step_with(slot, speed, reference, run.tuning[slot], run.mpc, run.functions)
    return (run.mpc.answer[slot],)


# -- what is measured of a run ----------------------------------------------------------------------------------------
@inlined
def begin_instant(k, slot, segment, run):
    """Judge the run; count the error at instant k, unless the run ends here."""
    own, found, block = run.memory.own[slot], run.result[slot], run.vehicles.block
    y_ref = run.given.signals[run.given.scenario[slot], SIGNAL.y_ref, k]
    locate(slot, block, run.settings, run.given.signals, run.given.scenario[slot], run.given.roads, run.memory)
    error = own.offset - y_ref
    if abs(error) <= run.settings[0].failure_distance:
        own.arrived = 1
    own.ended = judge(error, block, slot, run.settings, own.arrived > 0)
    if run.trace.state.size > 0:
        for j in range(STATES):
            run.trace.state[slot, k, j] = block[state_at(j, slot)]
    if own.ended != RUNNING:
        own.ended_at = k * run.settings[0].period
        return
    found.squared_error += error * error
    if run.segments.size > 0:
        run.segments[slot, k // segment] += error * error
    found.largest_error = max(found.largest_error, abs(error))
    found.instants += 1


@inlined
def _count_step(k, slot, answer, segment, weight, run):
    """Count what the controller answered at instant k; end the run when its cost has reached the ceiling."""
    found, change = run.result[slot], answer[1]
    found.squared_move += change * change
    if run.segments.size > 0:
        run.segments[slot, k // segment] += weight * change * change
    found.held += 1 if answer[COMMON - 1] > 0.5 else 0
    if run.law.answer.size == 0:
        status = whole(answer[mpc.ANSWER.qp_status])
        found.capped += 1 if status == qp.CAPPED else 0
        found.unsolved += 1 if status > qp.CAPPED else 0
        found.limited += 1 if answer[mpc.ANSWER.at_limit] > 0.5 else 0
        found.iterations += whole(answer[mpc.ANSWER.qp_iterations])
    if run.trace.state.size > 0:
        for j in range(answer.size):
            run.trace.answer[slot, k, j] = answer[j]
        for j in range(run.trace.answer.shape[2] - answer.size):
            run.trace.answer[slot, k, answer.size + j] = run.tuning[slot, j]
    if found.squared_error + weight * found.squared_move >= run.ceiling[slot]:
        run.memory.own[slot].ended = STOPPED


@inlined
def _note(k, slot, run):
    """Trace what an observer sees under the new input, and where the car is."""
    own, vehicles, row = run.memory.own[slot], run.vehicles, run.trace.seen[slot, k]
    call_observe(
        run.members.observe, vehicles.member, vehicles.parameters, vehicles.block, vehicles.states, vehicles.work,
        slot, row,
    )  # fmt: skip
    row[2], row[3], row[4] = own.station, own.offset, own.heading_error


@inlined
def end_slot(k, slot, segment, run):
    """Close a run that ends at instant k before its time, and park its slot in its initial state."""
    own, found = run.memory.own[slot], run.result[slot]
    found.ended, found.ended_at = own.ended, own.ended_at
    if own.ended != STOPPED:
        found.squared_error = math.inf
    if run.segments.size > 0:
        first = max(k - 1, 0) // segment
        run.segments[slot, first:] = math.nan
        run.segments[slot, first] = math.inf
    place_one(slot, run.vehicles.start, run.vehicles.block, run.vehicles.states)


@exported(void(int64, Place(Run)), name="begin_runs")
def begin(slots, run):
    """Everything as it is before the first instant, for the first `slots` slots.

    The models that the MPC holds stay.
    """
    place(slots, run.vehicles.start, run.vehicles.block, run.vehicles.states)
    run.segments[:, :] = 0.0
    for i in range(slots):
        found = run.result[i]
        forget(i, run.memory)
        found.squared_error, found.squared_move, found.largest_error, found.instants = 0.0, 0.0, 0.0, 0
        found.ended, found.ended_at, found.capped, found.unsolved, found.held = RUNNING, 0.0, 0, 0, 0
        found.limited, found.iterations = 0, 0
        mpc.forget(i, run.mpc)
    run.law.memory[:, :] = 0.0


@exported(void(Span, Place(Run)))
def rollout(span, run):
    """Whole runs, from what `begin` left.

    A run ends early when it has failed (`loop.judge`), or, as STOPPED, once its cost has reached its ceiling and can
    only grow. The cost of each segment is written to `segments`: inf for the one in which a run ends, NaN after.
    """
    periods, slots, segment, weight = span
    vehicles, settings, members = run.vehicles, run.settings[0], run.members
    block, states, work = vehicles.block, vehicles.states, vehicles.work
    before, after = substeps_around_change(run.settings)
    h = (1.0 - settings.dead_share) * settings.period / after
    for k in range(periods):
        running = 0
        for i in range(slots):
            if run.memory.own[i].ended != RUNNING:
                continue
            begin_instant(k, i, segment, run)
            if run.memory.own[i].ended != RUNNING:
                end_slot(k, i, segment, run)
                continue
            speed = sense_slot(k, i, run)
            _schedule(k, i, speed, run)
            (answer,) = control_slot(k, i, speed, run)
            actuate(k, i, answer[0], block, run.settings, run.given.signals, run.given.scenario[i], run.memory)
            if run.trace.seen.size > 0:
                _note(k, i, run)
            _count_step(k, i, answer, segment, weight, run)
            if run.memory.own[i].ended != RUNNING:
                end_slot(k, i, segment, run)
                continue
            running += 1
        if running == 0:
            break
        if before > 0:
            call_advance(
                members.advance, vehicles.member, vehicles.parameters, block, states, work, slots, before,
                settings.dead_share * settings.period / before,
            )  # fmt: skip
            change_command(slots, block, run.settings, run.memory)
        call_advance(members.advance, vehicles.member, vehicles.parameters, block, states, work, slots, after, h)
    for i in range(slots):
        if run.memory.own[i].arrived == 0 and run.result[i].ended != STOPPED:
            run.result[i].ended, run.result[i].ended_at, run.result[i].squared_error = NEVER_ARRIVED, 0.0, math.inf

"""The forward pass of a schedule: from the scheduling variables to the entries of a controller's tuning.

    clip the inputs to their domain -> evaluate the function of each entry -> hold within bounds -> guard

Inputs, entries and the guard are records of a fixed size; the functions, whose sizes differ, lie one behind the other
in `integers` and `numbers` (see `functions`).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..kernel import Place, exported, inlined, int64, int_vector, matrix, record, rows, vector, void
from ..layout import allocate
from ..maths.exact import clip, floor
from ..maths.exponential import power
from .functions import VARIABLE_COLUMNS, evaluate
from .guard import COUNTS, GUARD, MAP_AXES, MAX_ENTRIES, MEMORY, NC_ENTRY, NP_ENTRY, supervise

SCHEDULE_INPUT = record("Input", ("place", "low", "high"), integers=("place",))
"""Place of a variable in `VARIABLE_COLUMNS`, and its domain."""
ENTRY = record(
    "Entry",
    (
        "kind", "integers", "numbers",  # kind of its function, and where that begins
        "log10",  # whether the function gives log10 of the value
        "horizon",  # whether the value is rounded
        "low", "high",
    ),
    integers=("kind", "integers", "numbers", "log10", "horizon"),
)  # fmt: skip
SCHEDULE_SETTINGS = record(
    "Settings",
    (
        "n_inputs", "n_entries",  # no inputs: no scheduler
        "tunes_mpc",  # whether the entries are Np, Nc, Q, R
        ("inputs", (SCHEDULE_INPUT, len(VARIABLE_COLUMNS))), ("entries", (ENTRY, MAX_ENTRIES)), ("guard", GUARD),
    ),
    integers=("n_inputs", "n_entries", "tunes_mpc"),
)  # fmt: skip

ScheduleRecord = record(
    "ScheduleRecord",
    (
        ("settings", rows(SCHEDULE_SETTINGS), 1),
        ("memory", rows(MEMORY), "scheduled_slots"),  # of each run
        ("integers", int_vector, "integers"), ("numbers", vector, "numbers"),  # the packed functions
        ("scratch", vector, "scratch"),  # of the functions, and `SCHEDULE_SCRATCH` more; 0: no schedule
    ),
)  # fmt: skip
_Scratch = record("_Scratch", (("x", vector), ("values", vector), ("work", vector)))

SCHEDULE_SCRATCH = len(VARIABLE_COLUMNS) + MAX_ENTRIES + MAP_AXES
"""Reals of scratch that a schedule needs beside those of its functions."""


def no_schedule() -> Any:
    """Return the empty schedule of a run without a scheduler."""
    return allocate(ScheduleRecord, dict.fromkeys(("scheduled_slots", "integers", "numbers", "scratch"), 0))


def counted(memory: Any) -> Any:
    """(slots, COUNTS) what a schedule has counted in each run."""
    return np.stack([memory[name] for name in COUNTS], axis=-1)


@inlined
def begin_schedule(slot, plan):
    """Let a schedule forget a run; nothing without one."""
    if slot < len(plan.memory):
        row = plan.memory[slot]
        row.steps, row.clipped, row.broken, row.rate_limited, row.outside = 0, 0, 0, 0, 0
        row.off_reference, row.unstable, row.fallback, row.left, row.holding = 0, 0, 0, 0, 0


@inlined
def _parts(scratch):
    inputs, entries = len(VARIABLE_COLUMNS), MAX_ENTRIES
    return _Scratch(scratch[:inputs], scratch[inputs : inputs + entries], scratch[inputs + entries :])


@inlined
def _clip_inputs(variables, settings, x):
    """Write the inputs x, clipped to the domain. Returns whether one was clipped, was far outside, was no number."""
    clipped, is_far, broken = False, False, False
    slack = settings.guard.slack
    for d in range(settings.n_inputs):
        declared = settings.inputs[d]
        value = variables[declared.place]
        x[d] = clip(value, declared.low, declared.high)
        broken = broken or not math.isfinite(value)
        clipped = clipped or abs(value - x[d]) > 0.0
        is_far = is_far or abs(value - x[d]) > slack * (declared.high - declared.low)
    return clipped, is_far, broken


@inlined
def _evaluate_entries(x, plan, values, work):
    """Write the value of each entry at the inputs x, within its bounds. Returns whether one was no number."""
    settings = plan.settings[0]
    broken = False
    for s in range(settings.n_entries):
        entry = settings.entries[s]
        value = evaluate(entry.kind, x, plan.integers[entry.integers :], plan.numbers[entry.numbers :], work)
        if entry.log10 == 1:
            value = power(10.0, value)
        broken = broken or math.isnan(value)
        value = clip(value, entry.low, entry.high)
        values[s] = floor(value + 0.5) if entry.horizon == 1 else value
    if settings.tunes_mpc == 1:
        values[NC_ENTRY] = min(values[NC_ENTRY], values[NP_ENTRY])
    return broken


@exported(void(int64, vector, Place(ScheduleRecord), vector))
def schedule(slot, variables, plan, tuning):
    """Write the tuning (entries,) for the variables (see VARIABLES); of the MPC, horizons whole and Nc <= Np.

    Inputs are clipped to the domain. When one, or an output, is not a number, the guard takes its fallback; without a
    guard the last tuning is kept, and before a first one the tuning that is already there.
    """
    settings, memory = plan.settings[0], plan.memory[slot]
    x, values, work = _parts(plan.scratch)
    entries = settings.n_entries
    memory.steps += 1
    clipped, is_far, broken = _clip_inputs(variables, settings, x)
    if clipped:
        memory.clipped += 1
    if not broken:
        broken = _evaluate_entries(x, plan, values, work)
    if broken:
        memory.broken += 1
    if not broken:
        tuning[:entries] = values[:entries]
    elif settings.guard.used == 0:
        if memory.holding == 1:
            tuning[:entries] = memory.last[:entries]
        return
    if settings.guard.used == 1:
        supervise(variables, tuning, is_far or broken, settings.guard, memory, plan.integers, plan.numbers, work)
    memory.last[:entries] = tuning[:entries]
    memory.holding = 1


@exported(void(matrix, Place(ScheduleRecord), matrix))
def schedule_all(variables, plan, tunings):
    """Write the tuning (n, entries) for each of many variables (n, VARIABLES), each as at the first step of a run."""
    memory = plan.memory[0]
    for i in range(len(variables)):
        memory.left, memory.holding = 0, 0
        schedule(0, variables[i], plan, tunings[i])

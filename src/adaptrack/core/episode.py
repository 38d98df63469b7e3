"""Runs that are driven a few periods at a time: each slot of a batch has a clock of its own and begins anew by itself.

The control period is that of `rollout`, whose parts are called here; between two calls Python decides.
"""

from __future__ import annotations

from .controllers import mpc
from .kernel import Place, exported, inlined, matrix, record, rows, vector, void
from .loop import (
    NEVER_ARRIVED,
    NOT_FINITE,
    RUNNING,
    SIGNAL,
    actuate,
    change_command,
    forget,
    locate,
    substeps_around_change,
)
from .models.contract import MEASURED
from .plants.contract import INPUTS, call_advance, input_at, place_one
from .rollout import Run, begin_instant, end_slot, sense_slot
from .sight import Sight

EPISODE = record(
    "Episode",
    (
        "instant", "last",  # the present control instant, and that at which the run comes to its end
        "over",  # DRIVING, or why the episode is over
        "renewed",  # 1: `renew` begins it anew
        "due",  # 1: it has come to an instant that is not sensed yet
        "speed",  # m/s, as measured at the present instant
        "cost",  # m^2, of the periods of the last call
        "total",  # m^2, of all since the beginning
    ),
    whole=("instant", "last", "over", "renewed", "due"),
)  # fmt: skip
"""Where each slot is in its run."""
DRIVING, FAILED, ARRIVED = range(3)
"""Whether an episode is over: by a failure, or because the run has come to its end."""

Episodes = record(
    "Episodes",
    (
        ("run", Run), ("own", rows(EPISODE)), ("measured", matrix), ("sight", Sight), ("seen", matrix),
        ("weights", vector),
    ),
)  # fmt: skip
"""The batch; of each slot: where it is (slots,), what is measured at the present instant (slots, MEASURED), what is
seen of it (slots, columns) within bounds; weights: of squared moves in the cost of a step (m^2/rad^2), and what each
instant costs that a failed run does not drive (m^2)."""


@inlined
def _arrive(slot, episodes):
    """Judge the run of a slot at its present instant and take in what sensors give; one that is over is parked."""
    own, run = episodes.own[slot], episodes.run
    k, memory = own.instant, run.memory.own[slot]
    if k < own.last:
        begin_instant(k, slot, 1, run)
    else:
        locate(
            slot, run.vehicles.block, run.settings, run.given.signals, run.given.scenario[slot], run.given.roads,
            run.memory,
        )  # fmt: skip
    if memory.ended != NOT_FINITE:
        own.speed = sense_slot(k, slot, run)
        for j in range(len(MEASURED)):
            episodes.measured[slot, j] = run.mpc.measured[j]
    if memory.ended == RUNNING and k < own.last:
        return
    if memory.arrived == 0:
        memory.ended, memory.ended_at = NEVER_ARRIVED, 0.0
    own.over = ARRIVED if memory.ended == RUNNING else FAILED
    own.cost += (own.last - k) * episodes.weights[1]
    end_slot(k, slot, 1, run)


@exported(void(Place(Episodes)))
def arrive(episodes):
    """Sense, for all slots of an `Episodes` that have come to another instant."""
    for slot in range(episodes.own.size):
        if episodes.own[slot].due > 0:
            episodes.own[slot].due = 0
            _arrive(slot, episodes)


@inlined
def depart(slot, command, episodes):
    """Count what the present instant costs with a command (rad), and send it."""
    own, run = episodes.own[slot], episodes.run
    k, memory = own.instant, run.memory.own[slot]
    error = memory.offset - run.given.signals[run.given.scenario[slot], SIGNAL.y_ref, k]
    move = command - memory.command
    own.cost += error * error + episodes.weights[0] * move * move
    actuate(
        k, slot, command, run.vehicles.block, run.settings, run.given.signals, run.given.scenario[slot], run.memory
    )  # fmt: skip
    own.instant, own.due = k + 1, 1


@inlined
def move_on(episodes):
    """Move all vehicles on by a period; those whose run is over stay where they are parked."""
    run, slots = episodes.run, episodes.own.size
    vehicles, world = run.vehicles, run.settings[0]
    before, after = substeps_around_change(run.settings)
    if before > 0:
        call_advance(
            run.members.advance, vehicles.member, vehicles.parameters, vehicles.block, vehicles.states, vehicles.work,
            slots, before, world.dead_share * world.period / before,
        )  # fmt: skip
        change_command(slots, vehicles.block, run.settings, run.memory)
    call_advance(
        run.members.advance, vehicles.member, vehicles.parameters, vehicles.block, vehicles.states, vehicles.work,
        slots, after, (1.0 - world.dead_share) * world.period / after,
    )  # fmt: skip
    for slot in range(slots):
        if episodes.own[slot].over != DRIVING:
            place_one(slot, vehicles.start, vehicles.block, vehicles.states)


@exported(void(Place(Episodes)))
def renew(episodes):
    """Put the slots of an `Episodes` that are marked as renewed before the first instant of their scenarios."""
    run = episodes.run
    for slot in range(episodes.own.size):
        own, found = episodes.own[slot], run.result[slot]
        if own.renewed == 0:
            continue
        own.instant, own.over, own.renewed, own.due = 0, DRIVING, 0, 1
        own.speed, own.cost, own.total = 0.0, 0.0, 0.0
        found.squared_error, found.squared_move, found.largest_error, found.instants = 0.0, 0.0, 0.0, 0
        found.ended, found.ended_at = RUNNING, 0.0
        episodes.seen[slot, :] = 0.0
        place_one(slot, run.vehicles.start, run.vehicles.block, run.vehicles.states)
        for j in range(INPUTS):
            run.vehicles.block[input_at(j, slot)] = 0.0
        forget(slot, run.memory)
        mpc.forget(slot, run.mpc)
        if run.memory.past.size > 0:
            run.memory.past[slot, :] = 0.0

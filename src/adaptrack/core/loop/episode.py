"""Runs that are driven a few periods at a time: each slot of a batch has a clock of its own and begins anew by itself.

Between two calls of the kernels Python decides.
"""

from __future__ import annotations

from ..controllers.part import begin_controller
from ..kernel import Place, exported, float64, inlined, matrix, record, rows, void
from ..models.contract import MEASUREMENT
from ..plants.contract import place_one
from .observation import ObservationSpace
from .period import RunSpan, after_control, before_control, begin_slot, close, move
from .rollout import RunRecord
from .world import RUNNING, STATE_NOT_FINITE

EPISODE = record(
    "Episode",
    (
        "last",  # control instant at which the run comes to its end
        "over",  # DRIVING, or why the episode is over
        "renewed",  # 1: `renew` begins it anew
        "due",  # 1: it has come to an instant that is not sensed yet
        "cost",  # m^2, of the periods of the last call
        "total",  # m^2, of all since the beginning
    ),
    integers=("last", "over", "renewed", "due"),
)  # fmt: skip
"""Where each slot is in its run."""
EPISODE_RUNS, EPISODE_FAILED, EPISODE_ARRIVED = range(3)
"""Whether an episode is over: by a failure, or because the run has come to its end."""

Episodes = record(
    "Episodes",
    (
        ("run", RunRecord), ("states", rows(EPISODE)), ("measured", matrix), ("space", ObservationSpace),
        ("observations", matrix), ("move_weight", float64), ("failure_cost", float64),
    ),
)  # fmt: skip
"""The batch; of each slot: where it is (slots,), what is measured at the present instant (slots, MEASURED); the space
of observations, and the observation of each slot (slots, columns) within its bounds; weight of squared moves in the
cost of a step (m^2/rad^2), and what each instant costs that a failed run does not drive (m^2)."""


@inlined
def _span_of(slot, episodes):
    """Return the span of a slot's drive."""
    return RunSpan(episodes.states[slot].last, 1, 0, 0.0)


@inlined
def _arrive(slot, episodes):
    """Judge the run of a slot at its present instant and take in what sensors give; one that is over is parked."""
    episode, run = episodes.states[slot], episodes.run
    memory = run.memory.drives[slot]
    before_control(slot, _span_of(slot, episodes), run)
    if memory.ended != STATE_NOT_FINITE:
        for j in range(len(MEASUREMENT)):
            episodes.measured[slot, j] = run.measured[j]
    if memory.ended == RUNNING and memory.instant < episode.last:
        return
    close(slot, run)
    episode.over = EPISODE_ARRIVED if memory.ended == RUNNING else EPISODE_FAILED
    episode.cost += (episode.last - memory.instant) * episodes.failure_cost
    place_one(slot, run.vehicles.start, run.vehicles.block, run.vehicles.states)


@exported(void(Place(Episodes)))
def arrive(episodes):
    """Sense, for all slots of an `Episodes` that have come to another instant."""
    for slot in range(episodes.states.size):
        if episodes.states[slot].due > 0:
            episodes.states[slot].due = 0
            _arrive(slot, episodes)


@inlined
def depart(slot, command, episodes):
    """Count what the present instant costs with a command (rad), and send it."""
    episode, run = episodes.states[slot], episodes.run
    memory = run.memory.drives[slot]
    change = command - memory.command
    episode.cost += memory.error * memory.error + episodes.move_weight * change * change
    after_control(slot, command, change, _span_of(slot, episodes), run)
    episode.due = 1


@inlined
def move_on(episodes):
    """Move all vehicles on by a period; those whose run is over stay where they are parked."""
    vehicles, slots = episodes.run.vehicles, episodes.states.size
    move(slots, episodes.run)
    for slot in range(slots):
        if episodes.states[slot].over != EPISODE_RUNS:
            place_one(slot, vehicles.start, vehicles.block, vehicles.states)


@exported(void(Place(Episodes)))
def renew(episodes):
    """Put the slots of an `Episodes` that are marked as renewed before the first instant of their scenarios."""
    run = episodes.run
    for slot in range(episodes.states.size):
        episode = episodes.states[slot]
        if episode.renewed == 0:
            continue
        episode.over, episode.renewed, episode.due, episode.cost, episode.total = EPISODE_RUNS, 0, 1, 0.0, 0.0
        episodes.observations[slot, :] = 0.0
        begin_slot(slot, run)
        begin_controller(slot, run.memory.drives[slot].command, run.controller)

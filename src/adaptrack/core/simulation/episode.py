"""Runs that are driven a few periods at a time: each slot of a batch has a clock of its own and begins anew by itself.

Between two calls Python decides: it is asked before each step of a controller (`run.Features.asks`), and writes the
commands, or the tunings of an MPC.
"""

from __future__ import annotations

from ..estimators.learning import BELIEF_NAMES, BELIEFS_OFFSET
from ..kernel import Place, exported, float64, inlined, matrix, record, rows, void
from ..scheduling.functions import VARIABLE_COLUMNS
from .observation import ObservationSpace, bounded, keep, write_observation
from .run import RunRecord, begin_slot, roll_on
from .world import ANSWERED, RUNNING

EPISODE = record(
    "Episode",
    (
        "over",  # EPISODE_RUNS, or why the episode is over
        "renewed",  # 1: `renew` begins it anew
        "cost",  # m^2, of the periods of the last call
        "total",  # m^2, of all since the beginning
    ),
    integers=("over", "renewed"),
)  # fmt: skip
"""Where each slot is in its run."""
EPISODE_RUNS, EPISODE_FAILED, EPISODE_ARRIVED = range(3)
"""Whether an episode is over: by a failure, or because the run has come to its end."""

Episodes = record(
    "Episodes",
    (
        ("run", RunRecord), ("states", rows(EPISODE)), ("space", ObservationSpace), ("observations", matrix),
        ("failure_cost", float64),
    ),
)  # fmt: skip
"""The batch; of each slot: where it is (slots,); the space of observations, and the observation of each slot
(slots, columns) within its bounds; what each instant costs that a failed run does not drive (m^2)."""


@inlined
def _conclude(slot, episodes):
    """Add what the last period cost; see whether the run is over."""
    episode, run = episodes.states[slot], episodes.run
    drive, periods = run.memory.drives[slot], run.inputs.periods[slot]
    episode.cost += drive.cost
    if drive.ended == RUNNING and drive.instant < periods:
        return
    episode.over = EPISODE_ARRIVED if drive.ended == RUNNING else EPISODE_FAILED
    episode.cost += (periods - drive.instant) * episodes.failure_cost


@exported(void(Place(Episodes)))
def drive_on(episodes):
    """Drive a period, with the commands or tunings that the caller has written; those whose episode is over stand."""
    slots = episodes.states.size
    for slot in range(slots):
        if episodes.states[slot].over == EPISODE_RUNS:
            episodes.run.memory.drives[slot].caller_state = ANSWERED
    roll_on(2, slots, episodes.run)  # until all have come to their next instant
    for slot in range(slots):
        if episodes.states[slot].over == EPISODE_RUNS:
            _conclude(slot, episodes)


@exported(void(Place(Episodes)))
def renew(episodes):
    """Put the slots that are marked as renewed at the first instant of their scenarios."""
    slots = episodes.states.size
    for slot in range(slots):
        episode = episodes.states[slot]
        if episode.renewed > 0:
            episode.over, episode.cost, episode.total = EPISODE_RUNS, 0.0, 0.0
            episodes.observations[slot, :] = 0.0
            begin_slot(slot, episodes.run)
    roll_on(1, slots, episodes.run)
    for slot in range(slots):
        if episodes.states[slot].renewed > 0:
            episodes.states[slot].renewed = 0
            _conclude(slot, episodes)


@exported(void(Place(Episodes)))
def write_observations(episodes):
    """Write the observation of each slot (`observation.OBSERVATION`)."""
    for slot in range(episodes.states.size):
        write_observation(slot, episodes.run, episodes.space, episodes.observations[slot])


@exported(void(Place(Episodes)))
def write_variables(episodes):
    """Write the scheduling variables of each slot, and behind them what its MPC has learned."""
    run = episodes.run
    for slot in range(episodes.states.size):
        row, variables = episodes.observations[slot], run.variables[slot]
        for j in range(len(VARIABLE_COLUMNS)):
            keep(variables[j], row, j)
        keep(-variables[VARIABLE_COLUMNS.offset], row, VARIABLE_COLUMNS.offset)  # of the car, positive to the left
        if run.controller.beliefs > 0:
            learned = run.controller.mpc.informed.learned[slot]
            for j in range(len(BELIEF_NAMES)):
                keep(learned[BELIEFS_OFFSET + j], row, len(VARIABLE_COLUMNS) + j)
        bounded(row, episodes.space)

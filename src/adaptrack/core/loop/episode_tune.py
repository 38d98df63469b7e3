"""One period of a batch of runs whose MPC has the tuning that Python has chosen."""

from __future__ import annotations

from ..controllers.part import COMMON_ANSWER
from ..estimators.learning import BELIEF_NAMES, BELIEFS_OFFSET
from ..kernel import Place, exported, void
from ..models.contract import MEASUREMENT
from ..scheduling.variables import VARIABLE_COLUMNS
from .episode import EPISODE_RUNS, Episodes, depart, move_on
from .observation import bounded, keep
from .rollout import control_slot
from .world import look


@exported(void(Place(Episodes)))
def write_variables(episodes):
    """Write the scheduling variables of each slot, and behind them what its MPC has learned."""
    run = episodes.run
    for slot in range(episodes.states.size):
        row = episodes.observations[slot]
        look(slot, episodes.measured[slot], run)
        for j in range(len(VARIABLE_COLUMNS)):
            keep(run.variables[j], row, j)
        keep(-run.variables[VARIABLE_COLUMNS.offset], row, VARIABLE_COLUMNS.offset)  # of the car, positive to the left
        if run.controller.beliefs > 0:
            learned = run.controller.mpc.informed.learned[slot]
            for j in range(len(BELIEF_NAMES)):
                keep(learned[BELIEFS_OFFSET + j], row, len(VARIABLE_COLUMNS) + j)
        bounded(row, episodes.space)


@exported(void(Place(Episodes)))
def control(episodes):
    """Drive a period with the tunings of the batch, those whose episode is over excepted."""
    run = episodes.run
    for slot in range(episodes.states.size):
        if episodes.states[slot].over == EPISODE_RUNS:
            for j in range(len(MEASUREMENT)):
                run.measured[j] = episodes.measured[slot, j]
            control_slot(slot, run)
            depart(slot, run.controller.answer[slot, COMMON_ANSWER.command], episodes)
    move_on(episodes)

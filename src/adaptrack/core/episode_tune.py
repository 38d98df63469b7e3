"""One period of a batch of runs whose MPC has the tuning that Python has chosen."""

from __future__ import annotations

from .episode import DRIVING, Episodes, depart, move_on
from .estimators.learning import ANSWER, BELIEFS
from .kernel import Place, exported, void
from .loop import look
from .models.contract import MEASURED
from .observation import bounded, keep
from .rollout import COMMON, control_slot
from .variables import VARIABLES


@exported(void(Place(Episodes)))
def write_variables(episodes):
    """Write the scheduling variables of each slot, and behind them what its MPC has learned."""
    run = episodes.run
    for slot in range(episodes.own.size):
        row = episodes.observations[slot]
        look(slot, episodes.measured[slot], run)
        for j in range(len(VARIABLES)):
            keep(run.variables[j], row, j)
        if run.mpc.settings.learns > 0:
            for j in range(len(BELIEFS)):
                keep(run.mpc.informed.learned[slot, ANSWER + j], row, len(VARIABLES) + j)
        bounded(row, episodes.space)


@exported(void(Place(Episodes)))
def control(episodes):
    """Drive a period with the tunings of the batch, those whose episode is over excepted."""
    run = episodes.run
    for slot in range(episodes.own.size):
        if episodes.own[slot].over == DRIVING:
            for j in range(len(MEASURED)):
                run.measured[j] = episodes.measured[slot, j]
            (answer,) = control_slot(slot, run)
            depart(slot, answer[COMMON.command], episodes)
    move_on(episodes)

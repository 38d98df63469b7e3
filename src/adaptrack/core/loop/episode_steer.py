"""One period of a batch of runs that are steered from Python."""

from __future__ import annotations

from ..kernel import Place, exported, vector, void
from .episode import EPISODE_RUNS, Episodes, depart, move_on
from .observation import write_observation


@exported(void(Place(Episodes)))
def write_observations(episodes):
    """Write the observation of each slot (`observation.OBSERVATION`)."""
    for slot in range(episodes.states.size):
        write_observation(slot, episodes.measured[slot], episodes.run, episodes.space, episodes.observations[slot])


@exported(void(vector, Place(Episodes)))
def steer(commands, episodes):
    """Drive a period with the commands (slots,) rad, those whose episode is over excepted."""
    for slot in range(episodes.states.size):
        if episodes.states[slot].over == EPISODE_RUNS:
            depart(slot, commands[slot], episodes)
    move_on(episodes)

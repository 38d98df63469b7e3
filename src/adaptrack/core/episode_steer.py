"""One period of a batch of runs that are steered from Python."""

from __future__ import annotations

from .episode import DRIVING, Episodes, depart, move_on
from .kernel import Place, exported, vector, void
from .sight import see


@exported(void(Place(Episodes)))
def see_all(episodes):
    """Write what is seen of each slot (`sight.SEEN`)."""
    for slot in range(episodes.own.size):
        see(slot, episodes.measured[slot], episodes.run, episodes.sight, episodes.seen[slot])


@exported(void(vector, Place(Episodes)))
def steer(commands, episodes):
    """Drive a period with the commands (slots,) rad, those whose episode is over excepted."""
    for slot in range(episodes.own.size):
        if episodes.own[slot].over == DRIVING:
            depart(slot, commands[slot], episodes)
    move_on(episodes)

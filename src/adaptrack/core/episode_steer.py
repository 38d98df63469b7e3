"""One period of a batch of runs that are steered from Python."""

from __future__ import annotations

from .episode import DRIVING, Episodes, depart, move_on
from .kernel import Place, exported, vector, void
from .sight import Scene, see


@exported(void(Place(Episodes)))
def see_all(episodes):
    """Write what is seen of each slot (`sight.SEEN`)."""
    run = episodes.run
    scene = Scene(run.settings, run.given.signals, run.given.roads, run.given.scenario)
    for slot in range(episodes.own.size):
        own = episodes.own[slot]
        see(own.instant, slot, own.speed, episodes.measured[slot], scene, run.memory, episodes.sight, episodes.seen)


@exported(void(vector, Place(Episodes)))
def steer(commands, episodes):
    """Drive a period with the commands (slots,) rad, those whose episode is over excepted."""
    for slot in range(episodes.own.size):
        if episodes.own[slot].over == DRIVING:
            depart(slot, commands[slot], episodes)
    move_on(episodes)

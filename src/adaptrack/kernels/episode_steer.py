"""One period of a batch of runs that are steered from Python."""

from __future__ import annotations

from numba import types

from .abi import ROUTINE, int64, njit, vector
from .episode import DRIVING, depart, move_on, read_episodes
from .sight import Scene, see


@njit(types.void(int64), **ROUTINE)
def see_all(address):
    """Write what is seen of each slot (`sight.SEEN`)."""
    episodes = read_episodes(address)
    run = episodes.run
    scene = Scene(run.settings, run.given.signals, run.given.roads, run.given.scenario)
    for slot in range(episodes.own.size):
        own = episodes.own[slot]
        see(own.instant, slot, own.speed, episodes.measured[slot], scene, run.memory, episodes.sight, episodes.seen)


@njit(types.void(vector, int64), **ROUTINE)
def steer(commands, address):
    """Drive a period with the commands (slots,) rad, those whose episode is over excepted."""
    episodes = read_episodes(address)
    for slot in range(episodes.own.size):
        if episodes.own[slot].over == DRIVING:
            depart(slot, commands[slot], episodes)
    move_on(episodes)

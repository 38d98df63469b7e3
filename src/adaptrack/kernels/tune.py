"""A whole swarm on one operating point inside one compiled call: evaluate, learn, move; the particles are the slots."""

from __future__ import annotations

import math

from numba import types

from .abi import ROUTINE, float64, int64, int_vector, matrix, njit, record, vector
from .loop import STOPPED
from .rollout import MEMBERS, RUN, begin, rollout
from .swarm import LEADER_COST, PARTICLES, decode, learn, move
from .swarm import begin as begin_swarm

Trial = record("Trial", ("run", "periods", "weight", "noise"))
TRIAL = types.NamedTuple((RUN, int64, float64, int_vector), Trial)
"""What a tuning is tried on: a batch of runs, their control periods, the weight of the squared moves (m^2/rad^2), and
the noise seeds over which a cost is the mean."""

Search = record("Search", ("settings", "space", "swarm", "tunings", "costs", "best"))
SEARCH = types.NamedTuple((vector, matrix, PARTICLES, matrix, vector, vector), Search)
"""A swarm: its settings and space (see `swarm`), particles, scratch (particles, 4) and (particles,), and the best cost
after each generation (generations,), which is written."""


@njit(types.int64(matrix, vector, vector, int64, TRIAL, MEMBERS), **ROUTINE)
def evaluate(tunings, ceilings, costs, slots, trial, members):
    """Write the cost of each of the first `slots` tunings (.., 4): J = mean e^2 + weight * mean (change of command)^2.

    The mean of J over the noise seeds; inf when a run has failed, or was stopped because J cannot come out below its
    ceiling any more. Returns the control steps done. members: see `rollout.MEMBERS`.
    """
    run, periods, weight, noise = trial
    count = noise.size
    steps = 0
    for i in range(slots):
        costs[i] = 0.0
    for s in range(count):
        begin(slots, run)
        for i in range(slots):
            for j in range(tunings.shape[1]):
                run.tuning[i, j] = tunings[i, j]
            run.road.seeds[i] = noise[s]
            run.ceiling[i] = (ceilings[i] * count - costs[i]) * periods
            if not costs[i] < math.inf:
                run.memory[i].ended = STOPPED
        rollout(periods, slots, (weight, 1.0), run, members)
        for i in range(slots):
            found = run.result[i]
            steps += found.instants
            if found.ended != 0 or not costs[i] < math.inf:
                costs[i] = math.inf
            else:
                costs[i] += (found.squared_error + weight * found.squared_move) / periods
    for i in range(slots):
        costs[i] /= count
    return steps


@njit(types.UniTuple(int64, 2)(int64, int64, int64, SEARCH, TRIAL, MEMBERS), **ROUTINE)
def tune(seed, stream, slots, search, trial, members):
    """One run of the swarm (see `swarm`) over Np, Nc, Q, R; returns (evaluations, control steps done).

    On return search.swarm.leader is the best position and search.swarm.progress[LEADER_COST] its cost. The particles
    are driven `slots` at a time. A particle's run is stopped once it cannot improve on that particle's best: the swarm
    takes the same way as without, in less time.
    """
    steps = 0
    swarm, costs = search.swarm, search.costs
    begin_swarm(seed, stream, search.settings, search.space, swarm)
    generations, count = search.best.size, swarm.x.shape[0]
    for g in range(generations):
        decode(count, search.space, swarm.x, search.tunings)
        for first in range(0, count, slots):
            steps += evaluate(
                search.tunings[first:], swarm.best_costs[first:], costs[first:], min(slots, count - first), trial,
                members,
            )  # fmt: skip
        learn(costs, swarm)
        search.best[g] = swarm.progress[LEADER_COST]
        if g < generations - 1:
            move(g, seed, stream, search.settings, search.space, swarm)
    return generations * count, steps

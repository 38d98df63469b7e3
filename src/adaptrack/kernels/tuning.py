"""A whole swarm on one condition inside one compiled call: evaluate, learn, move; the particles are the lanes."""

from __future__ import annotations

import math

from numba import types

from .abi import ROUTINE, cube, float64, int64, int_vector, matrix, njit, vector
from .dynamics import PLANT_FUNCTION
from .loop import (
    ACTIVE,
    ANGLE,
    INSTANTS,
    INTEGRAL,
    KEPT,
    LOST,
    PREVIOUS,
    RUN_LOST,
    SCHEDULING,
    SQUARED_ERROR,
    SQUARED_MOVE,
    STARTED,
    STOPPED,
    WORKSPACE,
    rollout,
)
from .swarm import LEADER_COST, PARTICLES, begin, decode, learn, move

_RUN = (
    int64, int64, PLANT_FUNCTION, vector, vector, matrix, matrix, vector, vector, vector,
    cube, int_vector, int_vector, matrix, matrix, WORKSPACE, SCHEDULING, matrix, matrix, vector, matrix, matrix, cube,
)  # fmt: skip


@njit(types.int64(matrix, vector, int_vector, float64, vector, *_RUN), **ROUTINE)
def evaluate(
    tunings, ceilings, noise, price, costs,
    periods, lanes, derivative, p, block, states, plant_work, model, settings, loop,
    signals, scenario, seeds, memory, record, ws, plan, seen, start, left, stretches, result, trace,
):  # fmt: skip
    """Write the cost of each of the first `lanes` tunings (.., 4): J = mean e^2 + price * mean (change of command)^2.

    The mean of J over the noise seeds `noise`; inf when a run was lost, or stopped because J cannot come out below
    its ceiling any more. Returns the control steps done; `left` (lanes,) is scratch, the other arguments are
    those of `loop.rollout`.
    """
    count = noise.size
    steps = 0
    for i in range(lanes):
        costs[i] = 0.0
    for s in range(count):
        for i in range(lanes):
            own = memory[i]
            for j in range(4):
                own[PREVIOUS + j] = 0.0
            own[STARTED], own[ANGLE], own[INTEGRAL], own[ACTIVE], own[KEPT] = 0.0, 0.0, 0.0, 0.0, 0.0
            seeds[i] = noise[s]
            own[LOST] = 0.0 if costs[i] < math.inf else 1.0
            left[i] = (ceilings[i] * count - costs[i]) * periods
        rollout(
            periods, lanes, derivative, p, block, states, plant_work, model, settings, loop,
            signals, scenario, tunings, seeds, memory, record, ws, plan, seen, start, left, price,
            1, stretches, result, trace,
        )  # fmt: skip
        for i in range(lanes):
            steps += int(result[i, INSTANTS])
            if result[i, RUN_LOST] > 0.5 or result[i, STOPPED] > 0.5:
                costs[i] = math.inf
            else:
                costs[i] += (result[i, SQUARED_ERROR] + price * result[i, SQUARED_MOVE]) / periods
    for i in range(lanes):
        costs[i] /= count
    return steps


@njit(
    types.UniTuple(int64, 2)(
        int64, int64, vector, matrix, PARTICLES, matrix, vector, vector, int_vector, float64, *_RUN
    ),
    **ROUTINE,
)
def tune(
    seed, stream, swarm_settings, space, swarm, tunings, trace_of_costs, costs, noise, price,
    periods, lanes, derivative, p, block, states, plant_work, model, settings, loop,
    signals, scenario, seeds, memory, record, ws, plan, seen, start, left, stretches, result, trace,
):  # fmt: skip
    """One run of the swarm (see `swarm`) over Np, Nc, Q, R; returns (evaluations, control steps done).

    On return swarm.leader is the best position, swarm.progress[LEADER_COST] its cost, and trace_of_costs
    (generations,) the best cost after each generation; tunings (particles, 4) is scratch. The particles ride `lanes`
    at a time. A particle's run is stopped once it cannot improve on that particle's best: the swarm takes the same way
    as without, in less time.
    """
    steps = 0
    begin(seed, stream, swarm_settings, space, swarm)
    generations = trace_of_costs.size
    count = swarm.x.shape[0]
    for g in range(generations):
        decode(count, space, swarm.x, tunings)
        for first in range(0, count, lanes):
            steps += evaluate(
                tunings[first:], swarm.best_costs[first:], noise, price, costs[first:],
                periods, min(lanes, count - first), derivative, p, block, states, plant_work, model, settings, loop,
                signals, scenario, seeds, memory, record, ws, plan, seen, start, left, stretches, result, trace,
            )  # fmt: skip
        learn(costs, swarm)
        trace_of_costs[g] = swarm.progress[LEADER_COST]
        if g < generations - 1:
            move(g, seed, stream, swarm_settings, space, swarm)
    return generations * count, steps

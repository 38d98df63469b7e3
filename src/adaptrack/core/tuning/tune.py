"""The cost of tunings at one operating point, in one compiled call: the tunings are the slots of a batch of runs."""

from __future__ import annotations

import math

from ..kernel import Place, exported, int64, int_vector, matrix, record, vector
from ..simulation.run import RunRecord, begin, roll_on
from ..simulation.world import RUNNING, STOPPED

Trial = record("Trial", (("run", RunRecord), ("noise", int_vector)))
"""What a tuning is tried on: a batch of runs, whose slots are the most at a time, and the noise seeds over which a cost
is the mean."""

TuningCosts = record("TuningCosts", (("tunings", matrix), ("cost_limits", vector), ("costs", vector)))
"""Tunings (n, entries), the cost (n,) below which each must come out, and its cost (n,), which is written."""


@exported(int64(int64, int64, TuningCosts, Place(Trial)), name="evaluate_tunings")
def evaluate(first, slots, candidates, trial):
    """Write the cost of so many tunings from `first` on: J = mean e^2 + weight * mean (change of command)^2.

    The mean of J over the noise seeds; inf when a run has failed, or was stopped because J cannot come out below its
    limit any more. Returns the control steps done.
    """
    run, count, most = trial.run, trial.noise.size, 0
    tunings, cost_limits, costs = candidates.tunings[first:], candidates.cost_limits[first:], candidates.costs[first:]
    steps = 0
    _, entries = tunings.shape
    for i in range(slots):
        costs[i] = 0.0
        most = max(most, run.inputs.periods[i])
    for s in range(count):
        begin(slots, run)
        for i in range(slots):
            for j in range(entries):
                run.controller.tuning[i, j] = tunings[i, j]
            run.inputs.seeds[i] = trial.noise[s]
            run.cost_limit[i] = (cost_limits[i] * count - costs[i]) * run.inputs.periods[i]
            if not costs[i] < math.inf:
                run.memory.drives[i].ended = STOPPED
        roll_on(most, slots, run)
        for i in range(slots):
            result = run.result[i]
            steps += result.instants
            if result.ended != RUNNING or not costs[i] < math.inf:
                costs[i] = math.inf
            else:
                costs[i] += (result.squared_error + run.weight * result.squared_move) / run.inputs.periods[i]
    for i in range(slots):
        costs[i] /= count
    return steps

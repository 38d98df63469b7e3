"""Which inputs move the tuning of a schedule: total Sobol indices."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from adaptrack.control.scheduling.schedule import Schedule
from adaptrack.control.scheduling.variables import SchedulingVariables

Array = NDArray[np.float64]


def outputs_of(schedule: Schedule, x: Array) -> Array:
    """(n, 3) Np, Nc and log10 R/Q at inputs (n, D)."""
    rows = np.zeros((len(x), len(SchedulingVariables._fields)))
    rows[:, [SchedulingVariables._fields.index(name) for name in schedule.inputs]] = x
    Np, Nc, Q, R = schedule.batch(rows).T
    return np.column_stack([Np, Nc, np.log10(R / Q)])


def importance(schedule: Schedule, samples: int = 512, seed: int = 0) -> dict[str, float]:
    """In how much of the tuning's variance over the domain each input has a part: total Sobol index, 0..1.

    The mean over Np, Nc and log10 R/Q, by the estimator of M. J. W. Jansen, "Analysis of variance designs for model
    output" (1999).
    """
    rng = np.random.default_rng((seed, 0x50B0))
    low, high = schedule.domain.T
    x = rng.uniform(low, high, (samples, len(low)))
    here = outputs_of(schedule, x)
    variance = here.var(axis=0)
    found = {}
    for i, name in enumerate(schedule.inputs):
        moved = x.copy()
        moved[:, i] = rng.uniform(low[i], high[i], samples)
        change = ((outputs_of(schedule, moved) - here) ** 2).mean(axis=0) / 2.0
        found[name] = float(np.mean(np.divide(change, variance, out=np.zeros(3), where=variance > 0.0)))
    return found

"""Statistics of costs: geometric means, ratios with their 95 % intervals, and what moves a schedule's output.

A table and the sentence beside it take their intervals from `ratio`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from adaptrack.control.scheduling import Schedule, SchedulingVariables

Array = NDArray[np.float64]

RESAMPLES = 2000
"""Of a bootstrap."""


class Ratio(NamedTuple):
    """Geometric mean of one contender's cost over another's on the same runs, and its 95 % interval."""

    mean: float
    low: float
    high: float

    @property
    def verdict(self) -> str:
        """cheaper, dearer, or level: the interval holds 1."""
        return "cheaper" if self.high < 1.0 else "dearer" if self.low > 1.0 else "level"


def geometric_mean(costs: ArrayLike) -> float:
    """exp of the mean logarithm."""
    return float(np.exp(np.mean(np.log(costs))))


def ratio(costs: Array, others: Array, rng: np.random.Generator) -> Ratio:
    """The cost over that of another, run by run, both (runs,), with the percentile bootstrap interval of its mean.

    B. Efron, R. Tibshirani, "An Introduction to the Bootstrap" (1993), section 13.3; of the mean logarithm.
    """
    logs = np.log(costs / others)
    draws = resamples(rng, len(logs))
    low, high = np.percentile(np.exp(logs[draws].mean(axis=1)), [2.5, 97.5])
    return Ratio(float(np.exp(logs.mean())), float(low), float(high))


def resamples(rng: np.random.Generator, runs: int) -> NDArray[np.int64]:
    """(RESAMPLES, runs) the runs of each resample."""
    return rng.integers(0, runs, size=(RESAMPLES, runs))


def regret_percentiles(regret: Array) -> dict[str, float]:
    """p50, p90, p99 of the logarithms of a regret (runs,), and the worst."""
    logs = np.log(regret)
    p50, p90, p99 = np.exp(np.percentile(logs, [50, 90, 99]))
    return {"p50": float(p50), "p90": float(p90), "p99": float(p99), "worst": float(np.exp(logs.max()))}


def binned_geometric_mean(values: Array, x: Array, y: Array, cells: int) -> tuple[Array, Array, Array]:
    """Edges along x and y (cells + 1,), and the geometric mean of the values (n,) in each cell (cells, cells).

    Rows along y, columns along x; NaN where a cell holds none.
    """
    x_edges, y_edges = (np.histogram_bin_edges(each, cells) for each in (x, y))
    count = np.histogram2d(y, x, (y_edges, x_edges))[0]
    total = np.histogram2d(y, x, (y_edges, x_edges), weights=np.log(values))[0]
    mean = np.exp(np.divide(total, count, out=np.full(count.shape, np.nan), where=count > 0.0))
    return x_edges, y_edges, mean


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

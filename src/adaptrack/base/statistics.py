"""Statistics of measures: geometric means, and ratios with their 95 % bootstrap intervals."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from adaptrack.base.errors import InvalidInput
from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import Array

BOOTSTRAP_RESAMPLES, BOOTSTRAP_SEED = 2000, 0x9160
"""Number of bootstrap resamples, and the seed of their random numbers."""


class Ratio(NamedTuple):
    """Geometric mean of the ratio of a measure of two contenders on the same runs, with its 95 % interval."""

    mean: float
    low: float
    high: float

    @property
    def verdict(self) -> str:
        """Return whether the numerator is "cheaper" or "dearer", or "level" if the interval contains 1."""
        return "cheaper" if self.high < 1.0 else "dearer" if self.low > 1.0 else "level"


def geometric_mean(costs: ArrayLike) -> float:
    """Return the geometric mean of positive numbers."""
    return float(portable.exp(np.mean(portable.log(costs))))


def ratio(values: ArrayLike, references: ArrayLike) -> Ratio:
    """Return the geometric mean of values / references, with its 95 % percentile bootstrap interval.

    Each resample draws the entries of every axis with replacement, independently of the other axis. For cars and roads,
    drawing (car, road) pairs would give far too narrow an interval (A. B. Owen, "The pigeonhole bootstrap", Annals of
    Applied Statistics 1 (2007) 386-411). An axis of length 1 is not resampled. Arrays of one shape share their
    resamples.

    Parameters
    ----------
    values, references
        Positive measures of two contenders, (runs,) or (cars, roads). NaN marks a missing measurement.

    Raises
    ------
    InvalidInput
        When no entry was measured for both contenders.
    """
    logs = portable.log(np.asarray(values, dtype=float) / np.asarray(references, dtype=float))
    measured = np.isfinite(logs)
    if not measured.any():
        raise InvalidInput("ratio: the two contenders have no measured run in common.")
    total, count = _resampled_sums(np.where(measured, logs, 0.0)), _resampled_sums(measured.astype(float))
    means = total[count > 0.0] / count[count > 0.0]
    low, high = np.percentile(portable.exp(means), [2.5, 97.5])
    return Ratio(float(portable.exp(logs[measured].mean())), float(low), float(high))


def _resampled_sums(values: Array) -> Array:
    """Return the sum of the values in each resample (BOOTSTRAP_RESAMPLES,)."""
    first, *other_values = _weights(values.shape)
    total = portable.product(first, values.reshape(len(values), -1))
    for weights in other_values:
        total = (weights[..., None] * total.reshape(*weights.shape, -1)).sum(axis=1)
    return np.asarray(total[:, 0])


@lru_cache(maxsize=4)
def _weights(shape: tuple[int, ...]) -> list[Array]:
    """Return, for each axis, how often each resample draws each of its n entries (BOOTSTRAP_RESAMPLES, n)."""
    rng = np.random.default_rng(BOOTSTRAP_SEED)
    return [
        rng.multinomial(n, np.full(n, 1.0 / n), size=BOOTSTRAP_RESAMPLES).astype(float)
        if n > 1
        else np.ones((BOOTSTRAP_RESAMPLES, 1))
        for n in shape
    ]


def regret_percentiles(regret: Array) -> dict[str, float]:
    """Return the percentiles p50, p90 and p99 and the largest value ("worst") of a regret (runs,).

    The regret of a run is its cost divided by the cost of the reference contender on the same run. Percentiles are
    interpolated between logarithms.
    """
    logs = portable.log(regret)
    p50, p90, p99 = portable.exp(np.percentile(logs, [50, 90, 99]))
    return {"p50": float(p50), "p90": float(p90), "p99": float(p99), "worst": float(portable.exp(logs.max()))}


def binned_geometric_mean(values: Array, x: Array, y: Array, cells: int) -> tuple[Array, Array, Array]:
    """Return the geometric mean of values in each cell of a grid.

    Parameters
    ----------
    values
        Positive numbers, (n,).
    x, y
        Coordinates of the values, (n,).
    cells
        Number of cells along each axis.

    Returns
    -------
    x_edges, y_edges, mean
        Edges of the cells along x and y, each (cells + 1,), and the means (cells, cells). Rows run along y, columns
        along x; NaN marks an empty cell.
    """
    x_edges, y_edges = (np.histogram_bin_edges(coordinates, cells) for coordinates in (x, y))
    count = np.histogram2d(y, x, (y_edges, x_edges))[0]
    total = np.histogram2d(y, x, (y_edges, x_edges), weights=portable.log(values))[0]
    mean = portable.exp(np.divide(total, count, out=np.full(count.shape, np.nan), where=count > 0.0))
    return x_edges, y_edges, mean


class Interval(NamedTuple):
    """An estimate with its 95 % confidence interval."""

    value: float
    low: float
    high: float


def block_rms(squared: ArrayLike, block: ArrayLike) -> list[tuple[Interval, Ratio]]:
    """Return the RMS error of each contender, and the first contender's RMS error divided by it.

    Errors at neighbouring instants are correlated, so each resample draws whole blocks of instants. The blocks do not
    overlap, unlike those of H. R. Künsch, "The jackknife and the bootstrap for general stationary observations", Annals
    of Statistics 17 (1989) 1217-1241.

    Parameters
    ----------
    squared
        Squared errors of m contenders at the same n instants, (m, n).
    block
        Number of the block of each instant, whole numbers, (n,).

    Returns
    -------
    list of (Interval, Ratio)
        For each contender the RMS error, and the RMS error of the first contender divided by it. If a contender has no
        error at all in one of the resamples, its ratio is defined as 1.
    """
    values, block_index = np.atleast_2d(np.asarray(squared, dtype=float)), np.unique(block, return_inverse=True)[1]
    count = _resampled_sums(np.bincount(block_index).astype(float))
    means = [_resampled_sums(np.bincount(block_index, row).astype(float)) / count for row in values]
    results = []
    for row, mean in zip(values, means, strict=True):
        ratios = np.divide(
            [values[0].mean(), *means[0]], [row.mean(), *mean], out=np.ones(1 + mean.size), where=mean.all()
        )
        ends = (np.percentile(np.sqrt(mean_squares), [2.5, 97.5]).tolist() for mean_squares in (mean, ratios[1:]))
        rms, ratio = zip(np.sqrt([row.mean(), ratios[0]]).tolist(), ends, strict=True)
        results.append((Interval(rms[0], *rms[1]), Ratio(ratio[0], *ratio[1])))
    return results

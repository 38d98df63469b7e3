"""Statistics of measures: geometric means, and ratios with their 95 % bootstrap intervals."""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from adaptrack.base.errors import InvalidInput

Array = NDArray[np.float64]

BOOTSTRAP_RESAMPLES, BOOTSTRAP_SEED = 2000, 0x9160
"""Of a bootstrap."""


class Ratio(NamedTuple):
    """Geometric mean of a measure of one contender over another's on the same runs, and its 95 % interval."""

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


def ratio(values: ArrayLike, references: ArrayLike) -> Ratio:
    """The geometric mean of values over others, both (n,) or (n, m), with its 95 % percentile bootstrap interval.

    Every axis is a level that is drawn anew in each resample, independently of the other: runs; or cars and roads,
    where drawing their pairs would give far too narrow an interval (A. B. Owen, "The pigeonhole bootstrap", Annals of
    Applied Statistics 1 (2007) 386-411). An axis of length 1 is not drawn. Where either is NaN, nothing was measured.
    All ratios of one shape share their resamples.

    Raises
    ------
    InvalidInput
        When nothing was measured in common.
    """
    logs = np.log(np.asarray(values, dtype=float) / np.asarray(references, dtype=float))
    there = np.isfinite(logs)
    if not there.any():
        raise InvalidInput("ratio: the two were driven on nothing in common.")
    total, count = _resampled(np.where(there, logs, 0.0)), _resampled(there.astype(float))
    means = total[count > 0.0] / count[count > 0.0]
    low, high = np.percentile(np.exp(means), [2.5, 97.5])
    return Ratio(float(np.exp(logs[there].mean())), float(low), float(high))


def _resampled(values: Array) -> Array:
    """(RESAMPLES,) the sum of the values that each resample draws."""
    operands: list[Any] = [values, list(range(values.ndim))]
    for axis, weights in enumerate(_weights(values.shape)):
        operands += [weights, [values.ndim, axis]]
    return np.asarray(np.einsum(*operands, [values.ndim]))


@lru_cache(maxsize=4)
def _weights(shape: tuple[int, ...]) -> list[Array]:
    """(RESAMPLES, n) for each axis: how often each of its n entries is drawn."""
    rng = np.random.default_rng(BOOTSTRAP_SEED)
    return [
        rng.multinomial(n, np.full(n, 1.0 / n), size=BOOTSTRAP_RESAMPLES).astype(float)
        if n > 1
        else np.ones((BOOTSTRAP_RESAMPLES, 1))
        for n in shape
    ]


def regret_percentiles(regret: Array) -> dict[str, float]:
    """p50, p90, p99 of the logarithms of a regret (runs,), and the worst."""
    logs = np.log(regret)
    p50, p90, p99 = np.exp(np.percentile(logs, [50, 90, 99]))
    return {"p50": float(p50), "p90": float(p90), "p99": float(p99), "worst": float(np.exp(logs.max()))}


def binned_geometric_mean(values: Array, x: Array, y: Array, cells: int) -> tuple[Array, Array, Array]:
    """Edges along x and y (cells + 1,), and the geometric mean of the values (n,) in each cell (cells, cells).

    Rows along y, columns along x; NaN where a cell holds none.
    """
    x_edges, y_edges = (np.histogram_bin_edges(coordinates, cells) for coordinates in (x, y))
    count = np.histogram2d(y, x, (y_edges, x_edges))[0]
    total = np.histogram2d(y, x, (y_edges, x_edges), weights=np.log(values))[0]
    mean = np.exp(np.divide(total, count, out=np.full(count.shape, np.nan), where=count > 0.0))
    return x_edges, y_edges, mean


class Interval(NamedTuple):
    """A number with its 95 % interval."""

    value: float
    low: float
    high: float


def block_rms(squared: ArrayLike, block: ArrayLike) -> list[tuple[Interval, Ratio]]:
    """Root mean square of errors that were made side by side, and that of the first over it, each with its interval.

    squared: (m, n) squared errors of m contenders at n instants; block: (n,) whole numbers: instants of one block are
    drawn together, for errors that follow each other are alike (moving blocks: H. R. Künsch, "The jackknife and the
    bootstrap for general stationary observations", Annals of Statistics 17 (1989) 1217-1241; here they do not overlap).
    Over errors that are all 0 in a resample the ratio is 1.
    """
    values, place = np.atleast_2d(np.asarray(squared, dtype=float)), np.unique(block, return_inverse=True)[1]
    count = _resampled(np.bincount(place).astype(float))
    means = [_resampled(np.bincount(place, row).astype(float)) / count for row in values]
    results = []
    for row, mean in zip(values, means, strict=True):
        over = np.divide(
            [values[0].mean(), *means[0]], [row.mean(), *mean], out=np.ones(1 + mean.size), where=mean.all()
        )
        ends = (np.percentile(np.sqrt(mean_squares), [2.5, 97.5]).tolist() for mean_squares in (mean, over[1:]))
        rms, ratio = zip(np.sqrt([row.mean(), over[0]]).tolist(), ends, strict=True)
        results.append((Interval(rms[0], *rms[1]), Ratio(ratio[0], *ratio[1])))
    return results

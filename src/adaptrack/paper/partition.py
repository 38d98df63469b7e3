"""Partitions of an input space: where the membership functions of a fuzzy system start, and which rules join them.

A scatter partition puts one rule where the data are dense, so that the number of rules follows the data; a grid has one
rule for each combination of membership functions, so that it grows as (functions per input)^(inputs).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from adaptrack.base.checked import Positive, Share, checked, whole_number
from adaptrack.base.errors import InvalidInput
from adaptrack.core.maths import portable

Array = NDArray[np.float64]
RuleIndices = NDArray[np.intp]

MOST_GRID_RULES = 20_000
"""A grid with more rules than this is refused: its consequents would not fit in memory."""
DISTANCE_ROWS = 512
"""Rows whose distances to all others are held at once."""
TIE = 1e-9
"""Potentials that differ relatively by less are equal: rounding must not choose between them."""


class Clusters(NamedTuple):
    """Result of subtractive clustering."""

    centres: Array
    """(k, dims) points of the data, the densest first"""
    sigma: Array
    """(dims,) width of each cluster along each dimension, in the unit of the data"""


class Partition(NamedTuple):
    """M membership functions and R rules over D inputs."""

    owner: RuleIndices
    """(M,) the input that each function reads"""
    centre: Array
    """(M,) in the unit of that input"""
    sigma: Array
    """(M,) width of a Gaussian there, in the unit of that input"""
    rules: RuleIndices
    """(R, D) which function each rule asks of each input"""


@checked
def subtractive_clustering(
    points: Array,
    influence: Positive = 0.5,
    squash: Positive = 1.25,
    accept: Share = 0.5,
    reject: Share = 0.15,
    *,
    weight: Array | None = None,
) -> Clusters:
    """Centres of the dense regions of `points` (n, dims), each dimension scaled to the data's range.

    The potential of point i is P_i = sum_j exp(-4 |x_i - x_j|^2 / influence^2). The point with the highest potential is
    a centre; then P_i -= P* exp(-4 |x_i - x*|^2 / (squash influence)^2), and so on. With p = P*/(first P*), a point is
    taken if p > accept; if p < reject the search ends; between the two it is taken if p + (distance to the nearest
    centre)/influence >= 1, else passed over. Widths are sigma = influence range/sqrt(8).

    weight (n,): how often each point counts in P. Time grows with n^2, memory with n. Source: S. L. Chiu, *Fuzzy model
    identification based on cluster estimation*, J. Intelligent and Fuzzy Systems 2 (1994) 267-278.

    Raises
    ------
    InvalidInput
        When there are no points, or `reject` is above `accept`.
    """
    where = "subtractive_clustering"
    points = np.asarray(points, dtype=np.float64)
    if points.ndim != 2 or points.size == 0 or not np.isfinite(points).all():
        raise InvalidInput(f"{where}: points have shape {points.shape}: must be (n, dims), finite, at least one row.")
    if reject > accept:
        raise InvalidInput(f"{where}: reject = {reject!r}, accept = {accept!r}: must hold reject <= accept.")
    span = _span(points)
    unit = (points - points.min(axis=0)) / span
    potential = _potential(unit, influence, weight)
    first = float(potential.max())
    chosen: list[int] = []
    while len(chosen) < len(unit):
        best = int(np.flatnonzero(potential >= potential.max() * (1.0 - TIE))[0])
        share = float(potential[best]) / first
        if share < reject or share <= 0.0:
            break
        if share <= accept and chosen:
            nearest = math.sqrt(float(portable.square(unit[chosen] - unit[best]).sum(axis=1).min()))
            if share + nearest / influence < 1.0:
                potential[best] = 0.0
                continue
        chosen.append(best)
        distance = portable.square(unit - unit[best]).sum(axis=1)
        potential = potential - potential[best] * portable.exp(-4.0 / portable.square(squash * influence) * distance)
    return Clusters(points[chosen], influence * span / math.sqrt(8.0))


def scatter(
    x: Array, y: Array, influence: float, squash: float, accept: float, reject: float, *, weight: Array | None = None
) -> Partition:
    """One rule per cluster of the joint data (x, y), with a membership function of its own on each input.

    x (n, D) inputs, y (n,) target: both together, so that there are more rules where the target varies; weight (n,):
    how often each row counts.
    """
    clusters = subtractive_clustering(np.column_stack((x, y)), influence, squash, accept, reject, weight=weight)
    rules, dims = len(clusters.centres), x.shape[1]
    return Partition(
        owner=np.repeat(np.arange(dims), rules),
        centre=clusters.centres[:, :dims].T.ravel(),
        sigma=np.repeat(clusters.sigma[:dims], rules),
        rules=np.arange(rules)[:, np.newaxis] + rules * np.arange(dims),
    )


def grid(x: Array, n_mfs: int | Sequence[int]) -> Partition:
    """`n_mfs` functions evenly over the range of each input (one number, or one per input), and a rule for each cell.

    Neighbours cross at one half. x (n, D) inputs.

    Raises
    ------
    InvalidInput
        When the numbers do not fit the inputs, or the grid has more than `MOST_GRID_RULES` rules.
    """
    dims = x.shape[1]
    sizes = list(n_mfs) if isinstance(n_mfs, Sequence | np.ndarray) else [n_mfs] * dims
    if len(sizes) != dims:
        raise InvalidInput(f"grid: n_mfs = {n_mfs!r}: {len(sizes)} numbers for {dims} inputs; give one per input.")
    sizes = [whole_number("grid", "n_mfs", size) for size in sizes]
    if math.prod(sizes) > MOST_GRID_RULES:
        raise InvalidInput(
            f"grid: {' x '.join(map(str, sizes))} functions make {math.prod(sizes)} rules, at most {MOST_GRID_RULES} "
            "are allowed; take fewer functions, or partition='subtractive', whose rules follow the data."
        )
    low, span = x.min(axis=0), _span(x)
    centres, sigmas = [], []
    for start, width, size in zip(low, span, sizes, strict=True):
        gap = width / max(size - 1, 1)
        centres.append(start + (gap * np.arange(size) if size > 1 else np.array([width / 2])))
        sigmas.append(np.full(size, gap / (2.0 * math.sqrt(2.0 * portable.log(2.0)))))
    first = np.concatenate(([0], np.cumsum(sizes)[:-1]))
    cells = np.indices(sizes).reshape(dims, -1).T
    return Partition(np.repeat(np.arange(dims), sizes), np.concatenate(centres), np.concatenate(sigmas), cells + first)


def _span(points: Array) -> Array:
    """(dims,) range of each dimension; 1 for a dimension that does not vary."""
    span = np.ptp(points, axis=0)
    return np.where(span > 0.0, span, 1.0)


def _potential(unit: Array, influence: float, weight: Array | None) -> Array:
    """(n,) how many points are near each point, near ones counting more."""
    potential = np.empty(len(unit))
    squares = (unit * unit).sum(axis=1)
    for start in range(0, len(unit), DISTANCE_ROWS):
        rows = slice(start, start + DISTANCE_ROWS)
        distance = squares[rows, np.newaxis] + squares - 2.0 * unit[rows] @ unit.T
        near = portable.exp(-4.0 / (influence * influence) * np.maximum(distance, 0.0))
        potential[rows] = near.sum(axis=1) if weight is None else near @ weight
    return potential

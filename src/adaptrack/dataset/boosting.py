"""Gradient-boosted trees in NumPy: how well a strong learner predicts one number from a few.

Each tree is oblivious: all nodes of one depth ask the same question, so a tree of depth d has 2^d leaves that are
found by d comparisons. Sources: J. H. Friedman, *Stochastic gradient boosting*, CSDA 38 (2002); oblivious trees as in
L. Prokhorenkova et al., *CatBoost*, NeurIPS 2018. Here they measure data; they are not made to be deployed.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

BINS = 64
DEPTH = 5
TREES = 300
RATE = 0.1
"""Share of each tree's answer that is added (shrinkage)."""
SAMPLE = 0.5
"""Share of the rows from which each tree is grown."""
PULL = 3.0
"""Rows' worth of zero that each leaf's mean is drawn towards."""


class CrossValidated(NamedTuple):
    """How much a learner explains of rows that it has not seen."""

    r2: float
    """1 - (sum of squared errors)/(sum of squares about the mean); 0 where the mean is the best guess"""
    trees: int
    """how many trees were best"""
    predictions: Array
    """(n,) each by the learner that did not see its row"""


def cross_validate(x: Array, y: Array, folds: int = 5, seed: int = 0) -> CrossValidated:
    """k-fold cross-validation of boosted trees that predict y (n,) from x (n, features).

    The number of trees is the one that is best over all folds: one number chosen among 300, so that its R^2 flatters
    hardly. A y that is constant has R^2 = 0.
    """
    rng = np.random.default_rng(seed)
    bins = _binned(x)
    part = rng.permutation(np.arange(len(y)) % folds)
    stages = np.empty((TREES + 1, len(y)))
    for number in range(folds):
        test = part == number
        stages[:, test] = _boost(bins[~test], y[~test], bins[test], rng)
    errors = ((stages - y) ** 2).sum(axis=1)
    best = int(np.argmin(errors))
    spread = float(((y - y.mean()) ** 2).sum())
    return CrossValidated(max(0.0, 1.0 - float(errors[best]) / spread) if spread > 0.0 else 0.0, best, stages[best])


def _binned(x: Array) -> NDArray[np.intp]:
    """(n, features) the numbers of at most `BINS` intervals of equal population; equal values share one."""
    bins = np.empty(x.shape, dtype=np.intp)
    for j, column in enumerate(x.T):
        levels = np.unique(column)
        few = levels.size <= BINS
        edges = (levels[1:] + levels[:-1]) / 2 if few else np.quantile(column, np.arange(1, BINS) / BINS)
        bins[:, j] = np.searchsorted(edges, column, side="left")
    return bins


def _boost(bins: NDArray[np.intp], y: Array, unseen: NDArray[np.intp], rng: np.random.Generator) -> Array:
    """(TREES + 1, m) predictions for the unseen rows after each tree."""
    n, features = bins.shape
    size = max(1, round(SAMPLE * n))
    start = float(y.mean())
    own, answer = np.full(n, start), np.empty((TREES + 1, len(unseen)))
    answer[0] = start
    offset = np.arange(features) * BINS
    for tree in range(TREES):
        rows = rng.permutation(n)[:size]
        questions, values = _grow(bins[rows] + offset, (y - own)[rows], features)
        own += RATE * values[_leaf(bins, questions)]
        answer[tree + 1] = answer[tree] + RATE * values[_leaf(unseen, questions)]
    return answer


def _grow(cells: NDArray[np.intp], residual: Array, features: int) -> tuple[list[tuple[int, int]], Array]:
    """The questions (feature, last bin on the left) of one tree, and the value of each leaf."""
    leaf = np.zeros(len(residual), dtype=np.intp)
    questions: list[tuple[int, int]] = []
    width = features * BINS
    weights = np.repeat(residual, features)
    for depth in range(DEPTH):
        leaves = 1 << depth
        index = (leaf[:, np.newaxis] * width + cells).ravel()
        shape = (leaves, features, BINS)
        sums = np.bincount(index, weights, leaves * width).reshape(shape).cumsum(axis=2)
        counts = np.bincount(index, minlength=leaves * width).reshape(shape).cumsum(axis=2)
        right, others = sums[:, :, -1:] - sums, counts[:, :, -1:] - counts
        gain = (sums**2 / (counts + PULL) + right**2 / (others + PULL)).sum(axis=0)
        feature, last = divmod(int(np.argmax(gain)), BINS)
        questions.append((feature, last))
        leaf = 2 * leaf + (cells[:, feature] - feature * BINS > last)
    leaves = 1 << DEPTH
    return questions, np.bincount(leaf, residual, leaves) / (np.bincount(leaf, minlength=leaves) + PULL)


def _leaf(bins: NDArray[np.intp], questions: list[tuple[int, int]]) -> NDArray[np.intp]:
    leaf = np.zeros(len(bins), dtype=np.intp)
    for feature, last in questions:
        leaf = 2 * leaf + (bins[:, feature] > last)
    return leaf

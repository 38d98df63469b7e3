"""How much of a number a few others explain: cross-validated gradient-boosted trees, by scikit-learn.

Source: J. H. Friedman, *Greedy function approximation: a gradient boosting machine*, Ann. Stat. 29 (2001). Here trees
measure data: they are the ceiling for what is learned, and are not made to be deployed.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from sklearn.ensemble import HistGradientBoostingRegressor
from threadpoolctl import threadpool_limits

from adaptrack.base.errors import InvalidInput
from adaptrack.paper.data_set import DataSet
from adaptrack.paper.data_set_summary import TARGETS, targets
from adaptrack.paper.operating_points import canonical

Array = NDArray[np.float64]

TREES = 150
LEAVES = 16
"""of each tree, at most"""


class CrossValidated(NamedTuple):
    """How much a learner explains of rows that it was not trained on."""

    r2: float
    """1 - (sum of squared errors)/(sum of squares about the mean); 0 where the mean is the best guess"""
    trees: int
    """how many trees were best"""
    predictions: Array
    """(n,) each by the learner that did not see its row"""


def explained(dataset: DataSet, target: str, folds: int = 5, seed: int = 0) -> CrossValidated:
    """How much of a target the operating points explain: cross-validated R^2 of a strong learner.

    Only rows that a swarm searched count, without those where the run failed with every tuning; each is shown to the
    learner from its left side, so that left-right twins cannot stand on both sides of a fold.

    Raises
    ------
    InvalidInput
        For a target that is none of `TARGETS`, or fewer rows than ten per fold.
    """
    if target not in TARGETS:
        raise InvalidInput(f"target = {target!r}: must be one of {', '.join(map(repr, TARGETS))}.")
    rows = dataset.rows(dataset.computed & np.isfinite(dataset.costs))
    if len(rows) < 10 * folds:
        raise InvalidInput(f"{len(rows)} usable operating points are too few for {folds} folds: need {10 * folds}.")
    return cross_validate(canonical(rows.operating_points), targets(rows)[target], folds, seed)


def explained_shares(dataset: DataSet, progress: Callable[[str, int, int], None] | None = None) -> dict[str, float]:
    """R^2 of each target, see `explained`; none where there are too few rows.

    progress: called with ("describe", targets done, targets).
    """
    if np.count_nonzero(dataset.computed & np.isfinite(dataset.costs)) < 50:
        return {}
    shares: dict[str, float] = {}
    for number, target in enumerate(TARGETS):
        if progress is not None:
            progress("describe", number, len(TARGETS))
        shares[target] = explained(dataset, target).r2
    return shares


def cross_validate(x: Array, y: Array, folds: int = 5, seed: int = 0) -> CrossValidated:
    """k-fold cross-validation of boosted trees that predict y (n,) from x (n, features).

    The number of trees is the one that is best over all folds: one number chosen among 150, so that its R^2 flatters
    hardly. A y that is constant has R^2 = 0. The same numbers come out whatever the number of cores.
    """
    part = np.random.default_rng(seed).permutation(np.arange(len(y)) % folds)
    stages = np.empty((TREES + 1, len(y)))
    with threadpool_limits(1):  # the order of its sums depends on the number of threads
        for number in range(folds):
            test = part == number
            stages[0, test] = y[~test].mean()
            trees = HistGradientBoostingRegressor(max_iter=TREES, max_leaf_nodes=LEAVES, early_stopping=False)
            trees.fit(x[~test], y[~test])
            stages[1:, test] = list(trees.staged_predict(x[test]))
    errors = ((stages - y) ** 2).sum(axis=1)
    best = int(np.argmin(errors))
    spread = float(((y - y.mean()) ** 2).sum())
    return CrossValidated(max(0.0, 1.0 - float(errors[best]) / spread) if spread > 0.0 else 0.0, best, stages[best])

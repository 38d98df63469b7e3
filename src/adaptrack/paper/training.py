"""From a data set of tuned operating points to models of the tuning: the paper's section IV, with a hold-out.

One model for each slot of the tuning, each of the four numbers of an operating point. What is held out trains nothing
and chooses nothing; an operating point and its left-right twin are always on the same side.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from adaptrack.base.checked import checked
from adaptrack.base.errors import InvalidInput, did_you_mean
from adaptrack.base.progress import reports_progress
from adaptrack.control.controllers import ENTRIES
from adaptrack.control.controllers.compatibility import INCREMENTAL
from adaptrack.control.scheduling import Learned, Network, Schedule, Sugeno
from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import Array
from adaptrack.paper.anfis import ANFIS
from adaptrack.paper.data_set import DataSet
from adaptrack.paper.mlp import MLP
from adaptrack.paper.operating_points import POINT_NAMES, canonical, fold

MODEL_CLASSES: dict[str, type[MLP] | type[ANFIS]] = {"nn": MLP, "anfis": ANFIS}

TREES = 150
"""Boosted trees at most, see `ceiling`."""

TARGET_SLOTS = {"paper": ENTRIES, "ratio": ("Np", "Nc", "log10_ratio")}
"""The slots that are learned: of "paper" each number of the tuning as it is. Only R/Q changes the control law, so that
"ratio" learns its decimal logarithm instead of both."""


@dataclass(frozen=True, eq=False)
class Trained:
    """A model for each slot of the tuning, and how good they are."""

    model: str
    """"nn" or "anfis\""""
    targets: str
    """"paper" or "ratio", see `TARGET_SLOTS`"""
    inputs: tuple[str, ...]
    """the D columns of an operating point that the models see, in this order"""
    estimators: Mapping[str, MLP | ANFIS]
    """fitted, by slot"""
    domain: Array
    """(D, 2) lowest and highest value of each input in the rows trained on"""
    quality: list[dict[str, Any]]
    """A row per slot: slot, model; r2 and rmse on the hold-out; ceiling_r2 and ceiling_rmse there, see `train`;
    n_train, n_holdout; seconds that the training took; parameters; rules (of a fuzzy system); dead_share (of the rows,
    those at which a network's output is dead)"""
    provenance: dict[str, Any]
    """data set and its identity, hold-out, seed, options of the models"""

    @property
    def functions(self) -> dict[str, Network | Sugeno]:
        """The trained functions by slot: networks or Sugeno systems."""
        return {slot: _size_and_function(estimator)[1] for slot, estimator in self.estimators.items()}


@reports_progress("train")
@checked
def train(
    dataset: DataSet, model: str = "nn", targets: str = "paper", *, holdout: float = 0.2, seed: int = 0,
    progress: Callable[[str, int, int], None] | None = None, **options: Any,
) -> Trained:  # fmt: skip
    """Learn the best tuning of each operating point from a data set, one model per slot.

    model: "nn" for networks, "anfis" for fuzzy systems; targets: see `TARGET_SLOTS`; holdout: share of the operating
    points that is held out; seed: of the hold-out and of the models; progress: called with (what is learned, steps
    done, steps), two steps a slot; options: parameters of `MLP` or `ANFIS`, whose defaults are the paper's. Operating
    points where the run failed with every tuning teach nothing and are left out.

    The ceiling is what boosted trees reach on the same hold-out: a strong learner of another kind that is shown every
    operating point from its left side, and never the row that it predicts (5-fold cross-validation).

    Raises
    ------
    InvalidInput
        For an unknown model, target or option, an option that is not allowed, or too few points for a hold-out.
    """
    for argument, name, choices in (("model", model, MODEL_CLASSES), ("targets", targets, TARGET_SLOTS)):
        if name not in choices:
            raise InvalidInput(f"train: {argument} = {name!r}: must be one of {tuple(choices)}.")
    parameters = MODEL_CLASSES[model]().get_params()
    for name in options.keys() - parameters.keys():
        raise InvalidInput(
            f"train: {MODEL_CLASSES[model].__name__} has no option {name!r}. {did_you_mean(name, parameters)}"
        )
    options = {"random_state": seed, **options}
    report = progress or (lambda stage, steps_done, steps: None)
    learned, holdout_rows = dataset.rows(np.isfinite(dataset.costs)).split(holdout, seed)
    estimators: dict[str, MLP | ANFIS] = {}
    quality = []
    for number, slot in enumerate(TARGET_SLOTS[targets]):
        report(slot, 2 * number, 2 * len(TARGET_SLOTS[targets]))
        y, y_held = target(learned, slot), target(holdout_rows, slot)
        start = time.perf_counter()
        with threadpool_limits(1):  # the matrices are small: more threads only wait for each other
            estimators[slot] = MODEL_CLASSES[model](**options).fit(learned.operating_points, y)
        seconds = time.perf_counter() - start
        r2, rmse = score(y_held, estimators[slot].predict(holdout_rows.operating_points))
        report(f"{slot} by trees", 2 * number + 1, 2 * len(TARGET_SLOTS[targets]))
        best_r2, best_rmse = score(
            y_held, ceiling(learned.operating_points, y, holdout_rows.operating_points, y_held, seed)
        )
        quality.append({
            "slot": slot, "model": model, "r2": r2, "rmse": rmse, "ceiling_r2": best_r2, "ceiling_rmse": best_rmse,
            "n_train": len(y), "n_holdout": len(y_held), "seconds": seconds, **_size_and_function(estimators[slot])[0],
        })  # fmt: skip
    return Trained(
        model=model,
        targets=targets,
        inputs=POINT_NAMES,
        estimators=estimators,
        domain=np.column_stack((learned.operating_points.min(axis=0), learned.operating_points.max(axis=0))),
        quality=quality,
        provenance={
            "dataset": dataset.name,
            "identity": dataset.provenance.get("identity"),
            "holdout": holdout,
            "seed": seed,
            "options": options,
        },
    )


def _size_and_function(estimator: MLP | ANFIS) -> tuple[dict[str, Any], Network | Sugeno]:
    if isinstance(estimator, MLP):
        network = estimator.network_
        return {"parameters": network.n_parameters, "rules": None, "dead_share": float(estimator.dead_share_)}, network
    return {"parameters": estimator.n_parameters_, "rules": estimator.n_rules_, "dead_share": None}, estimator.system_


def target(dataset: DataSet, slot: str) -> Array:
    """(n,) what a slot should be on each operating point, see `TARGET_SLOTS`."""
    if slot == "log10_ratio":
        return portable.log10(dataset.ratios)
    return dataset.tunings[:, TARGET_SLOTS["paper"].index(slot)]


def score(y: Array, predicted: Array) -> tuple[float, float]:
    """R^2 and the root of the mean squared error; R^2 is 0 for a y (n,) that is constant."""
    squares, spread = float(portable.square(y - predicted).sum()), float(portable.square(y - y.mean()).sum())
    return 1.0 - squares / spread if spread > 0.0 else 0.0, math.sqrt(squares / len(y))


def ceiling(x: Array, y: Array, x_held: Array, y_held: Array, seed: int) -> Array:
    """(m,) predictions of boosted trees at the held-out operating points x_held (m, 4), see `train`."""
    points = np.vstack((x, x_held))
    families = fold(points)  # one row of each family: a twin would tell the trees the value to predict
    first = families.representatives
    predictions = _boosted_trees(canonical(points[first]), np.concatenate((y, y_held))[first], seed)
    return predictions[families.family[len(x) :]]


def _boosted_trees(x: Array, y: Array, seed: int, folds: int = 5) -> Array:
    """(n,) cross-validated predictions of y (n,) from x (n, features), by gradient-boosted trees.

    The number of trees is the best one over all folds.

    Source: J. H. Friedman, *Greedy function approximation: a gradient boosting machine*, Ann. Stat. 29 (2001).
    """
    from sklearn.ensemble import HistGradientBoostingRegressor

    fold_numbers = np.random.default_rng(seed).permutation(np.arange(len(y)) % folds)
    stages = np.empty((TREES + 1, len(y)))
    with threadpool_limits(1):  # the order of the sums depends on the number of threads
        for number in range(folds):
            test = fold_numbers == number
            stages[0, test] = y[~test].mean()
            trees = HistGradientBoostingRegressor(max_iter=TREES, max_leaf_nodes=16, early_stopping=False)
            trees.fit(x[~test], y[~test])
            stages[1:, test] = list(trees.staged_predict(x[test]))
    return stages[int(np.argmin(portable.square(stages - y).sum(axis=1)))]


# -- from trained models to a schedule --------------------------------------------------------------------------------
def trained_schedule(trained: Trained, dataset: DataSet) -> Schedule:
    """The functions learned from a data set as a schedule, within the bounds of the data set's search."""
    bounds = search_bounds(dataset)
    functions: dict[str, Any] = dict(trained.functions)
    if "log10_ratio" in functions:
        (q_low, q_high), (r_low, r_high) = bounds.pop("Q"), bounds["R"]
        bounds["R"] = (r_low / q_high, r_high / q_low)
    return Learned(functions, trained.inputs, trained.domain, bounds, trained.model, trained.provenance)


def search_bounds(dataset: DataSet) -> dict[str, tuple[float, float]]:
    """(low, high) of each entry of the tuning in the search behind a data set.

    Raises InvalidInput when the provenance does not contain the bounds.
    """
    search = dataset.provenance.get("settings", {}).get("search", {})
    if not set(ENTRIES) <= set(search):
        raise InvalidInput(f"data set {dataset.name!r}: its provenance does not contain the bounds of its search.")
    return {entry: (float(search[entry][0]), float(search[entry][1])) for entry in ENTRIES}


def purpose_of(dataset: DataSet) -> dict[str, Any]:
    """The car, profile and controller whose tunings a data set contains, for `Schedule.made_for`."""
    settings = dataset.provenance.get("settings", {})
    names = {"car": settings.get("vehicle"), "profile": settings.get("profile"), "tyre": settings.get("tyre")}
    purpose = {key: entry["name"] if isinstance(entry, Mapping) else entry for key, entry in names.items() if entry}
    controller = settings.get("controller", "as-written")  # data sets of earlier releases do not name the controller
    model = INCREMENTAL if controller == "as-written" else controller
    return {**purpose, "controller": {"kind": "MPC", "model": model}} if settings else {}

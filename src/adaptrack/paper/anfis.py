"""ANFIS: a first-order Sugeno system whose rules are learned from data, as a scikit-learn regressor.

The system itself, with the five layers of the paper's eqs. (24)-(27), is in `sugeno`.

Hybrid learning: given the memberships, the output is linear in the consequents (p, r), so that these are least squares;
the memberships then move along the gradient. Source: J.-S. R. Jang, *ANFIS: Adaptive-network-based fuzzy inference
system*, IEEE Trans. SMC 23 (1993) 665-685.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Annotated, Any, Literal, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field
from scipy import linalg
from scipy.special import expit
from sklearn.base import BaseEstimator, RegressorMixin
from sklearn.utils import check_random_state
from sklearn.utils.validation import check_is_fitted, validate_data

from adaptrack.base.checked import Count, Natural, NotNegative, Positive, check_parameters
from adaptrack.control.scheduling.functions import (
    BELL_CENTRE,
    BELL_SLOPE,
    BELL_WIDTH,
    Sugeno,
    bell_exponent,
    distance,
)
from adaptrack.core.maths import portable
from adaptrack.paper import partition as partitions
from adaptrack.paper.samples import held_out, mean, part, row_weights

Array = NDArray[np.float64]

NARROWEST = 0.01
"""Least width that training gives a membership function, in half ranges of its input."""
SLOPES = (0.5, 10.0)
"""Least and largest slope that training gives a bell; below the least its derivative is unbounded at the centre."""
STEP_INCREASE, STEP_DECREASE = 1.1, 0.9
"""Factors of the step after four drops of the error, and after two oscillations (Jang 1993)."""
PREDICTED_ROWS = 8192
"""Rows that are predicted at once."""


def design_matrix(strengths: Array, x: Array) -> Array:
    """(n, R (D + 1)) the matrix whose product with the consequents, row after row, is the output."""
    extended = np.column_stack((x, np.ones(len(x))))
    return (strengths[:, :, np.newaxis] * extended[:, np.newaxis, :]).reshape(len(x), -1)


def least_squares(a: Array, y: Array, penalty: float) -> Array:
    """(p,) the theta that minimises |a theta - y|^2 + penalty |theta|^2, with a (n, p), y (n,), penalty > 0.

    Solved by Cholesky in the smaller of the two dimensions, with one step of refinement against the data.
    """
    is_wide = a.shape[1] > a.shape[0]
    gram = a @ a.T if is_wide else a.T @ a
    gram[np.diag_indices_from(gram)] += penalty
    try:
        factor = linalg.cho_factor(gram, overwrite_a=True)
    except linalg.LinAlgError:  # the penalty vanishes in rounding: the slow and sure way
        root = math.sqrt(penalty) * np.eye(a.shape[1])
        return np.linalg.lstsq(np.vstack((a, root)), np.concatenate((y, np.zeros(a.shape[1]))), rcond=None)[0]
    if is_wide:
        dual = linalg.cho_solve(factor, y)
        dual += linalg.cho_solve(factor, y - a @ (a.T @ dual) - penalty * dual)
        return a.T @ dual
    theta = linalg.cho_solve(factor, a.T @ y)
    theta += linalg.cho_solve(factor, a.T @ (y - a @ theta) - penalty * theta)
    return theta


def premise_gradient(system: Sugeno, x: Array, y: Array, weight: Array | None = None) -> Array:
    """(M, 3) derivative of E = mean((output - y)^2)/2 by the premises, the consequents held; x (n, D), y (n,).

    weight (n,): of the rows in that mean.

    With s the normalised strengths: dE/d(log w_r) = mean(e s_r (f_r - output)); a membership function collects this
    from the rules that ask for it, times d(log mu)/d(width, slope, centre).
    """
    strengths = system.strengths(x)
    f = x @ system.consequents[:, :-1].T + system.consequents[:, -1]
    output = (strengths * f).sum(axis=1, keepdims=True)
    by_log_w = (output - y[:, np.newaxis]) * strengths * (f - output) / len(y)
    if weight is not None:
        by_log_w *= (weight / weight.mean())[:, np.newaxis]
    asks = np.zeros((system.n_rules, len(system.owner) + 1))
    for functions in system.rules.T:
        asks[np.arange(system.n_rules), functions] = 1.0
    by_log_mu = by_log_w @ asks[:, :-1]

    distances = distance(x, system)
    width, bell = system.premises[:, BELL_WIDTH], system.bell
    inwards = distances.copy()  # -d(log mu)/d(distance)
    by_slope = np.zeros_like(distances)
    if bell.any():
        t, slope = distances[:, bell], system.premises[bell, BELL_SLOPE]
        outside = expit(bell_exponent(t, slope))  # 1 - mu
        nonzero = np.where(t == 0.0, 1.0, t)
        inwards[:, bell] = np.where(t == 0.0, 0.0, 2.0 * slope * outside / nonzero)
        by_slope[:, bell] = np.where(t == 0.0, 0.0, -2.0 * outside * portable.log(np.abs(nonzero)))
    return np.column_stack(
        (
            (by_log_mu * inwards * distances).sum(axis=0) / width,
            (by_log_mu * by_slope).sum(axis=0),
            (by_log_mu * inwards).sum(axis=0) / width,
        )
    )


def adapt_step(step: float, errors: list[float]) -> float:
    """The step after the latest of `errors`, from which those before a change of step are then removed.

    Jang's two rules: four drops in a row make it larger, two oscillations (up, down, up, down) make it smaller.
    """
    drops = [after < before for before, after in pairwise(errors[-5:])]
    if drops == [True, True, True, True]:
        factor = STEP_INCREASE
    elif drops in ([True, False, True, False], [False, True, False, True]):
        factor = STEP_DECREASE
    else:
        return step
    del errors[:-1]
    return step * factor


class _Rows(NamedTuple):
    """Rows in the units of training: inputs z (n, D), target v (n,), weights (n,) or None."""

    z: Array
    v: Array
    weight: Array | None = None

    def rmse(self, system: Sugeno) -> float:
        """Root mean square error of a system's output on these rows."""
        return math.sqrt(float(mean(portable.square(system.predict(self.z) - self.v), self.weight)))


class _Scaling(NamedTuple):
    """Inputs and output in the units of training: z = (x - middle)/half, v = (y - mean)/spread."""

    middle: Array
    half: Array
    mean: float
    spread: float

    @classmethod
    def of(cls, x: Array, y: Array, weight: Array | None = None) -> _Scaling:
        centre = float(mean(y, weight))
        half = np.ptp(x, axis=0) / 2.0
        spread = float(y.std() if weight is None else math.sqrt(mean(portable.square(y - centre), weight)))
        small = spread <= 1e-14 * max(1e-300, float(np.abs(y).max()))  # a constant, but for the rounding of its mean
        middle = x.min(axis=0) + half
        return cls(middle, np.where(half > 0.0, half, 1.0), centre, 1.0 if small else spread)

    def scale(self, x: Array, y: Array) -> tuple[Array, Array]:
        return (x - self.middle) / self.half, (y - self.mean) / self.spread

    def unscale(self, system: Sugeno) -> Sugeno:
        """Return the system for inputs x and output y, from the system for z and v."""
        premises = system.premises.copy()
        premises[:, BELL_WIDTH] *= self.half[system.owner]
        premises[:, BELL_CENTRE] = premises[:, BELL_CENTRE] * self.half[system.owner] + self.middle[system.owner]
        slopes = system.consequents[:, :-1] / self.half
        constant = (system.consequents[:, -1] - slopes @ self.middle) * self.spread + self.mean
        return replace(system, premises=premises, consequents=np.column_stack((slopes * self.spread, constant)))


class ANFIS(RegressorMixin, BaseEstimator):  # type: ignore[misc]
    """Adaptive neuro-fuzzy inference system: a first-order Sugeno system, trained by Jang's hybrid rule.

    Parameters
    ----------
    partition : "subtractive" or "grid"
        Where rules start: one per cluster of the data (see `influence`), or one per cell of a grid (see `n_mfs`).
    membership : "gaussian" or "bell"
    n_mfs : int or sequence of int
        Grid: membership functions per input, one number for all or one for each.
    influence, squash, accept, reject : float
        Subtractive clustering, see `subtractive_clustering`; a smaller `influence` makes more rules.
    epochs : int
        Steps of the membership functions; 0 leaves them where the partition puts them.
    step : float
        Length of the first step, in half ranges of the inputs; adapted as it goes.
    ridge : float
        Penalty on the squares of the consequents, relative to the mean square of the columns that they multiply.
    prune : float
        Rules with less than this share of all firing strength are removed, before and after training; 0 keeps all.
    early_stopping : bool
        Hold out `validation_fraction` of the rows, keep the epoch that is best on them, and stop after `patience`
        epochs without a better one. Without it the epoch that is best on all rows is kept.
    random_state : int, RandomState or None
        Chooses the rows that are held out; nothing else is random.

    Attributes
    ----------
    system_ : Sugeno
        The trained system, in the units of the data.
    history_ : dict of str to array
        After each epoch, the first being the untrained partition: "train_rmse" and, with early stopping,
        "validation_rmse", in the unit of the target; "step" in half ranges.
    best_epoch_ : int
        The epoch whose system was kept.
    n_iter_ : int
        Steps made.
    input_range_, output_range_ : arrays (D, 2) and (2,)
        Least and largest value of each input and of the target in the data.
    input_names_ : list of str
        The columns of a data frame, the names in a file, or in1, in2, ...

    `fit` refuses parameters that are not allowed, as scikit-learn wants it.
    """

    def __init__(
        self,
        partition: Literal["subtractive", "grid"] = "subtractive",
        *,
        membership: Literal["gaussian", "bell"] = "gaussian",
        n_mfs: int | Sequence[int] = 3,
        influence: float = 0.5,
        squash: float = 1.25,
        accept: float = 0.5,
        reject: float = 0.15,
        epochs: Natural = 50,
        step: Positive = 0.01,
        ridge: Positive = 1e-8,
        prune: Annotated[NotNegative, Field(lt=1.0)] = 0.0,
        early_stopping: bool = False,
        validation_fraction: Annotated[Positive, Field(lt=1.0)] = 0.2,
        patience: Count = 20,
        random_state: Any = None,
    ) -> None:
        self.partition = partition
        self.membership = membership
        self.n_mfs = n_mfs
        self.influence = influence
        self.squash = squash
        self.accept = accept
        self.reject = reject
        self.epochs = epochs
        self.step = step
        self.ridge = ridge
        self.prune = prune
        self.early_stopping = early_stopping
        self.validation_fraction = validation_fraction
        self.patience = patience
        self.random_state = random_state

    @property
    def n_rules_(self) -> int:
        """Number of rules of the trained system."""
        return self.system_.n_rules

    @property
    def n_parameters_(self) -> int:
        """Number of learned numbers: premises and consequents."""
        return self.system_.n_parameters

    def fit(self, X: ArrayLike, y: ArrayLike, sample_weight: ArrayLike | None = None) -> Self:
        """Learn from the inputs X (n, D) and the target y (n,); `sample_weight` (n,): how often each row counts.

        A weight of 2 is a row given twice, of 0 one left out.
        """
        check_parameters(self)  # the partition checks its own
        x, target = validate_data(self, X, y, dtype=np.float64, y_numeric=True)
        target = np.asarray(target, dtype=np.float64)
        weight = row_weights("ANFIS", sample_weight, x)
        if weight is not None:
            x, target, weight = (array[weight > 0.0] for array in (x, target, weight))
        self.input_range_ = np.column_stack((x.min(axis=0), x.max(axis=0)))
        self.output_range_ = np.array([target.min(), target.max()])
        self.input_names_ = list(getattr(self, "feature_names_in_", _numbered(x.shape[1])))
        train, checked = np.arange(len(target)), np.arange(0)
        if self.early_stopping:
            train, checked = held_out(
                "ANFIS", len(target), self.validation_fraction, check_random_state(self.random_state)
            )
        train_weight, check_weight = part(weight, train), part(weight, checked)
        scaling = _Scaling.of(x[train], target[train], train_weight)
        z, v = scaling.scale(x, target)
        rows, checks = _Rows(z[train], v[train], train_weight), _Rows(z[checked], v[checked], check_weight)
        system, history = self._train(self._prune(self._start(rows), rows), rows, checks)
        lean = self._prune(system, rows)
        if lean is not system:
            system = self._conclude(lean, rows)
        self.system_ = scaling.unscale(system)
        self.history_ = {name: np.array(values) * scaling.spread for name, values in history.items() if values}
        self.history_["step"] /= scaling.spread
        decisive = self.history_["validation_rmse" if checked.size else "train_rmse"]
        self.best_epoch_, self.n_iter_ = int(np.argmin(decisive)), len(decisive) - 1
        return self

    def predict(self, X: ArrayLike) -> Array:
        """(n,) output of the system at the inputs X (n, D)."""
        check_is_fitted(self, "system_")
        x = validate_data(self, X, dtype=np.float64, reset=False)
        blocks = [self.system_.predict(x[start : start + PREDICTED_ROWS]) for start in range(0, len(x), PREDICTED_ROWS)]
        return np.concatenate(blocks)

    def _start(self, rows: _Rows) -> Sugeno:
        """The system that the partition gives, its consequents still zero."""
        z = rows.z
        if self.partition == "grid":
            partition = partitions.grid(z, self.n_mfs)
        else:
            partition = partitions.scatter(
                z, rows.v, self.influence, self.squash, self.accept, self.reject, weight=rows.weight
            )
        bell = self.membership == "bell"  # as wide at half its height as the Gaussian
        width = partition.sigma * math.sqrt(2.0 * portable.log(2.0)) if bell else partition.sigma
        slope = np.full(len(width), 2.0 if bell else 1.0)
        return Sugeno(
            owner=partition.owner,
            bell=np.full(len(width), bell),
            premises=np.column_stack((width, slope, partition.centre)),
            rules=partition.rules,
            consequents=np.zeros((len(partition.rules), z.shape[1] + 1)),
            weights=np.ones(len(partition.rules)),
        )

    def _prune(self, system: Sugeno, rows: _Rows) -> Sugeno:
        """Without the rules that hardly fire; the strongest rule stays in any case."""
        if self.prune == 0.0:
            return system
        mass = mean(system.strengths(rows.z), rows.weight)
        is_strong = mass >= min(self.prune, float(mass.max()))
        return system if is_strong.all() else system.keep(is_strong)

    def _conclude(self, system: Sugeno, rows: _Rows) -> Sugeno:
        """The system with the consequents that are best for its premises."""
        a, v = design_matrix(system.strengths(rows.z), rows.z), rows.v
        if rows.weight is not None:
            root = np.sqrt(rows.weight)
            a, v = a * root[:, np.newaxis], v * root
        penalty = self.ridge * float((a * a).sum()) / a.shape[1]
        theta = least_squares(a, v, penalty)
        return replace(system, consequents=theta.reshape(system.consequents.shape))

    def _train(self, system: Sugeno, rows: _Rows, checks: _Rows) -> tuple[Sugeno, dict[str, list[float]]]:
        """The best system of all epochs, and the history: least squares forwards, gradient backwards."""
        history: dict[str, list[float]] = {"train_rmse": [], "validation_rmse": [], "step": []}
        decisive = history["validation_rmse" if len(checks.z) else "train_rmse"]
        best, best_epoch, step, recent = system, 0, float(self.step), []
        for epoch in range(self.epochs + 1):
            system = self._conclude(system, rows)
            history["train_rmse"].append(rows.rmse(system))
            if len(checks.z):
                history["validation_rmse"].append(checks.rmse(system))
            history["step"].append(step)
            if epoch == 0 or decisive[epoch] < decisive[best_epoch]:
                best, best_epoch = system, epoch
            if epoch == self.epochs or (len(checks.z) and epoch - best_epoch >= self.patience):
                break
            recent.append(history["train_rmse"][-1])
            step = adapt_step(step, recent)
            gradient = premise_gradient(system, rows.z, rows.v, rows.weight)
            length = float(np.linalg.norm(gradient))
            if length == 0.0:
                break
            system = _moved(system, -step / length * gradient)
        return best, history


def _numbered(inputs: int) -> list[str]:
    return [f"in{i + 1}" for i in range(inputs)]


def _moved(system: Sugeno, change: Array) -> Sugeno:
    premises = system.premises + change
    premises[:, BELL_WIDTH] = np.maximum(premises[:, BELL_WIDTH], NARROWEST)
    premises[:, BELL_SLOPE] = np.clip(premises[:, BELL_SLOPE], *SLOPES)
    return replace(system, premises=premises)

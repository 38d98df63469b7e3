"""ANFIS: a first-order Sugeno system whose rules are learned from data, as a scikit-learn regressor.

The system itself, with the five layers of the paper's eqs. (24)-(27), is in `sugeno`. A partition of the input space
says where its membership functions start and which rules join them. A scatter partition puts one rule where the data
are dense, so that the number of rules follows the data. A grid has one rule for each combination of membership
functions, so that it grows as (functions per input)^(inputs).

Hybrid learning: given the memberships, the output is linear in the consequents (p, r), so that these are least squares;
the memberships then move along the gradient. Source: J.-S. R. Jang, *ANFIS: Adaptive-network-based fuzzy inference
system*, IEEE Trans. SMC 23 (1993) 665-685.
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass, replace
from itertools import pairwise
from typing import Annotated, Any, Literal, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field
from scipy import linalg
from scipy.special import expit
from sklearn.utils.validation import check_is_fitted, validate_data

from adaptrack.base.checked import Count, Natural, NotNegative, Positive, Share, checked, whole_number
from adaptrack.base.errors import InvalidInput
from adaptrack.base.files import write_atomically
from adaptrack.control.scheduling.functions import BELL_CENTRE, BELL_SLOPE, BELL_WIDTH, Sugeno, bell_exponent, distance
from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import Array
from adaptrack.paper.regressor import Regressor, Samples

# -- partitions of the input space ------------------------------------------------------------------------------------
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

    Neighbours cross at one half. x (n, D) inputs. Raises InvalidInput when the numbers do not fit the inputs, or the
    grid has more than `MOST_GRID_RULES` rules.
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


# -- the regressor ----------------------------------------------------------------------------------------------------
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


class _Scaling(NamedTuple):
    """From samples to the units of training: (x - middle)/half and (y - mean)/spread."""

    middle: Array
    half: Array
    mean: float
    spread: float

    @classmethod
    def of(cls, samples: Samples) -> _Scaling:
        x, y, weight = samples
        centre = float(np.average(y, weights=weight))
        half = np.ptp(x, axis=0) / 2.0
        spread = math.sqrt(np.average(portable.square(y - centre), weights=weight))
        small = spread <= 1e-14 * max(1e-300, float(np.abs(y).max()))  # a constant, but for the rounding of its mean
        middle = x.min(axis=0) + half
        return cls(middle, np.where(half > 0.0, half, 1.0), centre, 1.0 if small else spread)

    def scale(self, samples: Samples) -> Samples:
        """Return samples in the units of training."""
        return Samples((samples.x - self.middle) / self.half, (samples.y - self.mean) / self.spread, samples.weight)

    def unscale(self, system: Sugeno) -> Sugeno:
        """Return the system for inputs and output in the units of the data."""
        premises = system.premises.copy()
        premises[:, BELL_WIDTH] *= self.half[system.owner]
        premises[:, BELL_CENTRE] = premises[:, BELL_CENTRE] * self.half[system.owner] + self.middle[system.owner]
        slopes = system.consequents[:, :-1] / self.half
        constant = (system.consequents[:, -1] - slopes @ self.middle) * self.spread + self.mean
        return replace(system, premises=premises, consequents=np.column_stack((slopes * self.spread, constant)))


@dataclass(eq=False, repr=False)
class ANFIS(Regressor):
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

    partition: Literal["subtractive", "grid"] = "subtractive"
    _: KW_ONLY
    membership: Literal["gaussian", "bell"] = "gaussian"
    n_mfs: int | Sequence[int] = 3
    influence: float = 0.5
    squash: float = 1.25
    accept: float = 0.5
    reject: float = 0.15
    epochs: Natural = 50
    step: Positive = 0.01
    ridge: Positive = 1e-8
    prune: Annotated[NotNegative, Field(lt=1.0)] = 0.0
    early_stopping: bool = False
    validation_fraction: Annotated[Positive, Field(lt=1.0)] = 0.2
    patience: Count = 20
    random_state: Any = None

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
        samples, rows, checks, _ = self._samples(X, y, sample_weight)  # the partition checks its own parameters
        self.input_range_ = np.column_stack((samples.x.min(axis=0), samples.x.max(axis=0)))
        self.output_range_ = np.array([samples.y.min(), samples.y.max()])
        numbered = [f"in{i + 1}" for i in range(samples.x.shape[1])]
        self.input_names_ = list(getattr(self, "feature_names_in_", numbered))
        scaling = _Scaling.of(rows)
        rows, checks = scaling.scale(rows), scaling.scale(checks)
        system, history = self._train(self._prune(self._start(rows), rows), rows, checks)
        lean = self._prune(system, rows)
        if lean is not system:
            system = self._conclude(lean, rows)
        self.system_ = scaling.unscale(system)
        self.history_ = {name: np.array(values) * scaling.spread for name, values in history.items() if values}
        self.history_["step"] /= scaling.spread
        decisive = self.history_["validation_rmse" if len(checks.y) else "train_rmse"]
        self.best_epoch_, self.n_iter_ = int(np.argmin(decisive)), len(decisive) - 1
        return self

    def predict(self, X: ArrayLike) -> Array:
        """(n,) output of the system at the inputs X (n, D)."""
        check_is_fitted(self, "system_")
        x = validate_data(self, X, dtype=np.float64, reset=False)
        blocks = [self.system_.predict(x[start : start + PREDICTED_ROWS]) for start in range(0, len(x), PREDICTED_ROWS)]
        return np.concatenate(blocks)

    def _start(self, rows: Samples) -> Sugeno:
        """The system that the partition gives, its consequents still zero."""
        z = rows.x
        if self.partition == "grid":
            partition = grid(z, self.n_mfs)
        else:
            partition = scatter(z, rows.y, self.influence, self.squash, self.accept, self.reject, weight=rows.weight)
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

    def _prune(self, system: Sugeno, rows: Samples) -> Sugeno:
        """Without the rules that hardly fire; the strongest rule stays in any case."""
        if self.prune == 0.0:
            return system
        mass = np.average(system.strengths(rows.x), axis=0, weights=rows.weight)
        is_strong = mass >= min(self.prune, float(mass.max()))
        return system if is_strong.all() else system.keep(is_strong)

    def _conclude(self, system: Sugeno, rows: Samples) -> Sugeno:
        """The system with the consequents that are best for its premises."""
        a, v = design_matrix(system.strengths(rows.x), rows.x), rows.y
        if rows.weight is not None:
            root = np.sqrt(rows.weight)
            a, v = a * root[:, np.newaxis], v * root
        penalty = self.ridge * float((a * a).sum()) / a.shape[1]
        theta = least_squares(a, v, penalty)
        return replace(system, consequents=theta.reshape(system.consequents.shape))

    def _train(self, system: Sugeno, rows: Samples, checks: Samples) -> tuple[Sugeno, dict[str, list[float]]]:
        """The best system of all epochs, and the history: least squares forwards, gradient backwards."""
        history: dict[str, list[float]] = {"train_rmse": [], "validation_rmse": [], "step": []}
        decisive = history["validation_rmse" if len(checks.y) else "train_rmse"]
        best, best_epoch, step, recent = system, 0, float(self.step), []
        for epoch in range(self.epochs + 1):
            system = self._conclude(system, rows)
            history["train_rmse"].append(rows.rmse(system))
            if len(checks.y):
                history["validation_rmse"].append(checks.rmse(system))
            history["step"].append(step)
            if epoch == 0 or decisive[epoch] < decisive[best_epoch]:
                best, best_epoch = system, epoch
            if epoch == self.epochs or (len(checks.y) and epoch - best_epoch >= self.patience):
                break
            recent.append(history["train_rmse"][-1])
            step = adapt_step(step, recent)
            gradient = premise_gradient(system, rows.x, rows.y, rows.weight)
            length = float(np.linalg.norm(gradient))
            if length == 0.0:
                break
            system = _moved(system, -step / length * gradient)
        return best, history


def _moved(system: Sugeno, change: Array) -> Sugeno:
    premises = system.premises + change
    premises[:, BELL_WIDTH] = np.maximum(premises[:, BELL_WIDTH], NARROWEST)
    premises[:, BELL_SLOPE] = np.clip(premises[:, BELL_SLOPE], *SLOPES)
    return replace(system, premises=premises)


# -- text files of MATLAB's Fuzzy Logic Toolbox -----------------------------------------------------------------------
def write_fis(estimator: ANFIS, path: str | os.PathLike[str], name: str = "anfis") -> None:
    """Write a fitted `ANFIS` as a `.fis` file; every number is written so that it reads back exactly.

    Raises
    ------
    InvalidInput
        When the estimator is not fitted.
    StorageError
        When the file cannot be written.
    """
    if not hasattr(estimator, "system_"):
        raise InvalidInput("write_fis: the ANFIS is not fitted; call fit first.")
    write_atomically(path, _text(estimator, name).encode())


def _text(estimator: ANFIS, name: str) -> str:
    system: Sugeno = estimator.system_
    lines = [
        "[System]",
        f"Name='{_plain(name)}'",
        "Type='sugeno'",
        "Version=2.0",
        f"NumInputs={system.n_inputs}",
        "NumOutputs=1",
        f"NumRules={system.n_rules}",
        "AndMethod='prod'",
        "OrMethod='probor'",
        "ImpMethod='prod'",
        "AggMethod='sum'",
        "DefuzzMethod='wtaver'",
    ]
    number = np.zeros(len(system.owner) + 1, dtype=np.intp)  # within its input, from 1; the last one is what ANY finds
    for i, variable in enumerate(estimator.input_names_):
        members = np.flatnonzero(system.owner == i)
        number[members] = np.arange(1, len(members) + 1)
        lines += ["", f"[Input{i + 1}]", f"Name='{_plain(variable)}'", f"Range={_list(estimator.input_range_[i])}"]
        lines.append(f"NumMFs={len(members)}")
        for j, function in enumerate(members, start=1):
            bell = bool(system.bell[function])
            numbers = system.premises[function, [0, 1, 2] if bell else [0, 2]]
            lines.append(f"MF{j}='in{i + 1}mf{j}':'{'gbellmf' if bell else 'gaussmf'}',{_list(numbers)}")
    lines += ["", "[Output1]", "Name='out1'", f"Range={_list(estimator.output_range_)}", f"NumMFs={system.n_rules}"]
    for j, numbers in enumerate(system.consequents, start=1):
        lines.append(f"MF{j}='out1mf{j}':'linear',{_list(numbers)}")
    lines += ["", "[Rules]"]
    for j, (rule, weight) in enumerate(zip(number[system.rules], system.weights, strict=True), start=1):
        lines.append(f"{' '.join(map(str, rule))}, {j} ({_number(weight)}) : 1")
    return "\n".join(lines) + "\n"


def _plain(name: object) -> str:
    """A name without what would end it in the file."""
    return " ".join(str(name).replace("'", " ").split())


def _list(numbers: np.ndarray) -> str:
    return "[" + " ".join(_number(number) for number in numbers) + "]"


def _number(number: float) -> str:
    text = repr(float(number))
    return text.removesuffix(".0")

"""The common part of the paper's regressors: samples, weights of their rows, and rows held out to stop early."""

from __future__ import annotations

import math
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import BaseEstimator, RegressorMixin
from sklearn.utils import check_random_state
from sklearn.utils.validation import check_array, check_consistent_length, validate_data

from adaptrack.base.checked import check_parameters
from adaptrack.base.errors import InvalidInput
from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import Array

RowNumbers = NDArray[np.int64]


def row_weights(model: str, sample_weight: ArrayLike | None, x: Array) -> Array | None:
    """The weights (n,) of the rows of x (n, D), a number standing for all; None where all count alike.

    Raises InvalidInput for weights of another shape, for a negative one, and when none is positive.
    """
    if sample_weight is None:
        return None
    weights = np.asarray(sample_weight)
    if weights.ndim == 0:
        weights = np.full(len(x), weights)
    weight = check_array(weights, ensure_2d=False, dtype=np.float64, input_name="sample_weight")
    if weight.ndim != 1:
        raise InvalidInput(
            f"{model}: sample_weight has the shape {weight.shape}: Sample weights must be 1D array or scalar."
        )
    check_consistent_length(x, weight)
    if (weight < 0.0).any() or not weight.any():
        raise InvalidInput(
            f"{model}: sample_weight: a weight is negative, or all are zero: give none below 0 and one above."
        )
    return np.asarray(weight, dtype=np.float64)


def held_out(model: str, n: int, fraction: float, rng: np.random.RandomState) -> tuple[RowNumbers, RowNumbers]:
    """The rows to train on and the held-out rows of n: a `fraction` at random, at least one; both ascending.

    Raises InvalidInput when no row is left to train on.
    """
    count = max(1, round(fraction * n))
    if count >= n:
        raise InvalidInput(f"{model}: validation_fraction = {fraction!r} of {n} sample(s) leaves none.")
    order = rng.permutation(n)
    return np.sort(order[count:]), np.sort(order[:count])


class Samples(NamedTuple):
    """Inputs x (n, D), target y (n,), weights (n,) or None."""

    x: Array
    y: Array
    weight: Array | None = None

    def part(self, rows: Any) -> Self:
        """The samples in some rows."""
        return type(self)(self.x[rows], self.y[rows], None if self.weight is None else self.weight[rows])

    def rmse(self, function: Any) -> float:
        """Root mean square error of the output of a network or a fuzzy system on these samples."""
        return math.sqrt(np.average(portable.square(function.predict(self.x) - self.y), weights=self.weight))


class Regressor(RegressorMixin, BaseEstimator):  # type: ignore[misc]
    """A scikit-learn regressor with `early_stopping`, `validation_fraction` and `random_state`."""

    def _samples(
        self, X: ArrayLike, y: ArrayLike, sample_weight: ArrayLike | None
    ) -> tuple[Samples, Samples, Samples, np.random.RandomState]:
        """Check the arguments of `fit`: the samples with a positive weight, those to train on, those held out.

        The last value is the random state after the choice of the rows that are held out.
        """
        check_parameters(self)
        model = type(self).__name__
        x, target = validate_data(self, X, y, dtype=np.float64, y_numeric=True)
        samples = Samples(x, np.asarray(target, dtype=np.float64), row_weights(model, sample_weight, x))
        if samples.weight is not None:
            samples = samples.part(samples.weight > 0.0)
        rng = check_random_state(self.random_state)
        train, checked = np.arange(len(samples.y)), np.arange(0)
        if self.early_stopping:
            train, checked = held_out(model, len(samples.y), self.validation_fraction, rng)
        return samples, samples.part(train), samples.part(checked), rng

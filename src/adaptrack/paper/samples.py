"""Samples of a model: weights of the rows, and the rows that are held out to stop early."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.utils.validation import check_array, check_consistent_length

from adaptrack.base.errors import InvalidInput

Array = NDArray[np.float64]
RowNumbers = NDArray[np.int64]


def row_weights(model: str, sample_weight: ArrayLike | None, x: Array) -> Array | None:
    """The weights (n,) of the rows of x (n, D), a number standing for all; None where all count alike.

    Raises
    ------
    InvalidInput
        When one is negative, or none positive.
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


def part(weight: Array | None, rows: Any) -> Array | None:
    """The weights of some rows."""
    return None if weight is None else weight[rows]


def mean(values: Array, weight: Array | None) -> Any:
    """Down the rows of values (n, ...), each counting by its weight."""
    return values.mean(axis=0) if weight is None else np.average(values, axis=0, weights=weight)


def held_out(model: str, n: int, fraction: float, rng: np.random.RandomState) -> tuple[RowNumbers, RowNumbers]:
    """The rows to train on and the held-out rows of n: a `fraction` at random, at least one; both ascending.

    Raises
    ------
    InvalidInput
        When no row is left to train on.
    """
    count = max(1, round(fraction * n))
    if count >= n:
        raise InvalidInput(f"{model}: validation_fraction = {fraction!r} of {n} sample(s) leaves none.")
    order = rng.permutation(n)
    return np.sort(order[count:]), np.sort(order[:count])

"""A small feed-forward network: the plain arrays that `MLP` learns, and that run online."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from adaptrack.base.checked import real
from adaptrack.base.errors import InvalidInput
from adaptrack.control.scheduling.functions.function import Array, Function, Packed, read_array, register_function
from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import product
from adaptrack.core.scheduling import functions as kernel


@register_function
@dataclass(frozen=True, eq=False)
class Network(Function):
    """D inputs, hidden layers of sigmoid neurons, one output: eqs. (21)-(23) of the paper.

    H^1 = f(W^1 z), H^2 = f(W^2 H^1), O = g(W^3 H^2), each with a bias; f the sigmoid, g the ReLU, z the inputs scaled
    so that `low` and `high` become 0 and 1; the target is out_low + (out_high - out_low) O.

    Raises
    ------
    InvalidInput
        When the arrays do not fit each other, or a number is not finite.
    """

    low: Array
    """(D,) input that becomes 0"""
    high: Array
    """(D,) input that becomes 1"""
    weights: tuple[Array, ...]
    """of each layer, (inputs, neurons)"""
    biases: tuple[Array, ...]
    """of each layer, (neurons,)"""
    out_low: float
    """target at O = 0"""
    out_high: float
    """target at O = 1"""
    relu: bool = True
    """whether g is the ReLU, else the identity"""
    kind = "network"

    def __post_init__(self) -> None:
        width = len(self.low)
        fits = self.low.shape == self.high.shape == (width,) and len(self.weights) == len(self.biases) > 0
        for weights, biases in zip(self.weights, self.biases, strict=False):
            fits = fits and weights.shape == (width, len(biases)) and biases.ndim == 1
            width = len(biases)
        if not fits or width != 1:
            raise InvalidInput(
                "Network: the arrays do not fit each other; see the shapes in the class's documentation."
            )
        numbers = (self.low, self.high, *self.weights, *self.biases, np.array([self.out_low, self.out_high]))
        if not all(np.isfinite(array).all() for array in numbers):
            raise InvalidInput("Network: a weight, bias or scale is not finite.")
        if not (self.high > self.low).all():
            raise InvalidInput("Network: need low < high for every input.")

    @property
    def n_inputs(self) -> int:
        return len(self.low)

    @property
    def n_parameters(self) -> int:
        """Number of learned numbers: weights and biases."""
        return sum(array.size for array in (*self.weights, *self.biases))

    def predict(self, x: Array) -> Array:
        h = (x - self.low) / (self.high - self.low)
        for weights, biases in zip(self.weights[:-1], self.biases[:-1], strict=True):
            h = portable.logistic(product(h, weights) + biases)
        out = (product(h, self.weights[-1]) + self.biases[-1])[:, 0]
        if self.relu:
            out = np.maximum(out, 0.0)
        return self.out_low + (self.out_high - self.out_low) * out

    def pack(self) -> Packed:
        widths = [self.n_inputs, *map(len, self.biases)]
        numbers = [self.out_low, self.out_high - self.out_low, *self.low, *(1.0 / (self.high - self.low))]
        for weights, biases in zip(self.weights, self.biases, strict=True):
            numbers += np.vstack((weights, biases)).T.ravel().tolist()
        return Packed(kernel.NETWORK, [int(self.relu), len(self.biases), *widths], numbers, sum(widths))

    def shifted(self, by: float) -> Self:
        return replace(self, out_low=self.out_low + by, out_high=self.out_high + by)

    def blended(self, share: float, value: float) -> Self:
        complement, added = 1.0 - share, share * value
        return replace(self, out_low=complement * self.out_low + added, out_high=complement * self.out_high + added)

    def save(self) -> dict[str, Any]:
        return {
            "low": self.low.tolist(),
            "high": self.high.tolist(),
            "weights": [array.tolist() for array in self.weights],
            "biases": [array.tolist() for array in self.biases],
            "out_low": float(self.out_low),
            "out_high": float(self.out_high),
            "relu": bool(self.relu),
        }

    @classmethod
    def load(cls, saved: Mapping[str, Any]) -> Self:
        return cls(
            read_array(saved["low"]), read_array(saved["high"]), tuple(map(read_array, saved["weights"])),
            tuple(map(read_array, saved["biases"])), real("network", "out_low", saved["out_low"]),
            real("network", "out_high", saved["out_high"]), bool(saved["relu"]),
        )  # fmt: skip

"""A number: the same value for all inputs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from adaptrack.base.checked import Finite, checked
from adaptrack.control.scheduling.functions.function import Array, Function, Packed, register_function
from adaptrack.core.scheduling import functions as kernel


@register_function
@checked
@dataclass(frozen=True)
class Number(Function):
    """A constant function."""

    value: Finite
    kind = "number"

    @property
    def n_inputs(self) -> None:
        return None

    def predict(self, x: Array) -> Array:
        return np.full(len(x), self.value)

    def pack(self) -> Packed:
        return Packed(kernel.NUMBER, (), (self.value,), 0)

    def shifted(self, by: float) -> Self:
        return type(self)(self.value + by)

    def blended(self, share: float, value: float) -> Self:
        return type(self)((1.0 - share) * self.value + share * value)

    def save(self) -> dict[str, Any]:
        return {"value": self.value}

    @classmethod
    def load(cls, saved: Mapping[str, Any]) -> Self:
        return cls(saved["value"])

"""A number: the same value for all inputs."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from adaptrack.base.errors import InvalidInput, real
from adaptrack.control.scheduling.functions.function import Array, Function, Packed, register_function


@register_function
@dataclass(frozen=True)
class Number(Function):
    """The same value everywhere.

    Raises
    ------
    InvalidInput
        When it is not a finite number.
    """

    value: float
    kind = "number"

    def __post_init__(self) -> None:
        object.__setattr__(self, "value", real("function", "value", self.value))
        if not math.isfinite(self.value):
            raise InvalidInput(f"function: value = {self.value!r}: must be finite.")

    @property
    def n_inputs(self) -> None:
        return None

    def predict(self, x: Array) -> Array:
        return np.full(len(x), self.value)

    def pack(self) -> Packed:
        from adaptrack.core import functions

        return Packed(functions.NUMBER, (), (self.value,), 0)

    def shifted(self, by: float) -> Self:
        return type(self)(self.value + by)

    def blended(self, share: float, value: float) -> Self:
        return type(self)((1.0 - share) * self.value + share * value)

    def save(self) -> dict[str, Any]:
        return {"value": self.value}

    @classmethod
    def load(cls, saved: Mapping[str, Any]) -> Self:
        return cls(saved["value"])

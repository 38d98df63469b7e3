"""A quantity along a road (width, speed limit, friction, bank, grade): a table over the arc length."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import model_validator

from adaptrack.base.checked import real, reals
from adaptrack.base.errors import InvalidInput, format_value
from adaptrack.base.files import Record
from adaptrack.core.maths.portable import Array
from adaptrack.core.planning import station_table as kernel


class Along(Record):
    """Values at arc lengths: straight lines between them, or steps; constant before the first and after the last.

    Raises
    ------
    InvalidInput
        When there is no value, the two lists differ in length, or the arc lengths do not increase.
    """

    s: tuple[float, ...]
    """Stations (m)."""
    value: tuple[float, ...]
    kind: Literal["linear", "steps"] = "linear"
    """steps: a value holds from its arc length to the next"""

    @model_validator(mode="after")
    def _increases(self) -> Self:
        if not self.s or len(self.s) != len(self.value):
            raise ValueError(f"{len(self.s)} arc lengths and {len(self.value)} values; give as many, at least one.")
        if any(b <= a for a, b in zip(self.s, self.s[1:], strict=False)):
            raise ValueError("the arc lengths must increase; sort the values and remove repetitions.")
        return self

    @classmethod
    def constant(cls, value: float) -> Self:
        """Make a profile with one value everywhere."""
        return cls(s=(0.0,), value=(float(value),))

    @classmethod
    def through(cls, s: ArrayLike, value: ArrayLike, kind: Literal["linear", "steps"] = "linear") -> Self:
        """Through samples; of a level stretch only the ends are kept."""
        s, value = reals("Along: s", s), reals("Along: value", value)
        is_kept = np.ones(s.size, dtype=bool)
        if kind == "steps":
            is_kept[1:] = value[1:] != value[:-1]
        elif s.size > 2:
            is_kept[1:-1] = (value[:-2] != value[1:-1]) | (value[1:-1] != value[2:])
        return cls(s=tuple(s[is_kept].tolist()), value=tuple(value[is_kept].tolist()), kind=kind)

    def packed(self) -> Any:
        """The record that `adaptrack.core.planning` reads."""
        return kernel.AlongRecord(np.array(self.s), np.array(self.value), int(self.kind == "steps"))

    def at(self, s: ArrayLike) -> Array:
        """The values at the arc lengths `s` (m), in the shape of `s`."""
        stations = reals("Along.at: s", s)
        values = stations.flatten()
        kernel.along_values(self.packed(), values)
        return np.asarray(values.reshape(stations.shape)[()])

    def least(self, start: ArrayLike, end: ArrayLike) -> Array:
        """The smallest value between arc lengths `start` and `end`, (n,) each: at the ends and at what lies between."""
        ends = np.stack(np.broadcast_arrays(np.atleast_1d(start), np.atleast_1d(end))).astype(np.float64)
        minima = np.empty(ends.shape[1])
        kernel.along_least(self.packed(), ends[0], ends[1], minima)
        return minima

    def within(self, allowed: Callable[[Array], NDArray[np.bool_]], rule: str) -> None:
        """Refuse values that are not allowed; the InvalidInput states the first one, where it is, and the rule."""
        violations = np.flatnonzero(~allowed(np.array(self.value)))
        if violations.size:
            raise InvalidInput(f"{self.value[violations[0]]!r} at s = {self.s[violations[0]]:.6g} m: must be {rule}.")


def as_along(name: str, value: Along | float | tuple[ArrayLike, ArrayLike]) -> Along:
    """A number, a pair (arc lengths, values) or an `Along`; InvalidInput for anything else."""
    if isinstance(value, Along):
        return value
    try:
        if isinstance(value, tuple) and len(value) == 2:
            s, values = (tuple(reals(name, column).ravel().tolist()) for column in value)
            return Along(s=s, value=values)
        return Along.constant(real("Along", name, value))
    except InvalidInput as error:
        raise InvalidInput(
            f"{name} = {format_value(value)}: must be a number, a pair (arc lengths, values) or an Along: {error}"
        ) from None


NO_LIMIT = 1000.0
"""m/s, the speed limit where none is posted."""
ALONG_QUANTITIES = ("width_left", "width_right", "speed_limit", "friction", "bank", "grade")
"""What lies along a road."""


def alongs(values: dict[str, Any]) -> dict[str, Any]:
    """The values with every quantity along the road as an `Along`."""
    return {
        name: as_along(name, value) if name in ALONG_QUANTITIES and value is not None else value
        for name, value in values.items()
    }

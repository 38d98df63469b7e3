"""A table: values at the nodes of a grid."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal, Self

import numpy as np

from adaptrack.base.errors import InvalidInput
from adaptrack.control.scheduling.functions.function import Array, Function, Packed, read_array, register_function
from adaptrack.core.scheduling import functions as kernel


@register_function
@dataclass(frozen=True, eq=False)
class Table(Function):
    """Values at the nodes of a grid, held beyond its last nodes.

    Raises
    ------
    InvalidInput
        When the axes do not ascend, do not fit the values, or something is not finite.
    """

    axes: tuple[Array, ...]
    """the nodes along each input, ascending"""
    values: Array
    """one for each node, (len(axes[0]), len(axes[1]), ...)"""
    method: Literal["nearest", "multilinear"] = "multilinear"
    kind = "table"

    def __post_init__(self) -> None:
        object.__setattr__(self, "axes", tuple(np.asarray(axis, dtype=np.float64) for axis in self.axes))
        object.__setattr__(self, "values", np.ascontiguousarray(self.values, dtype=np.float64))
        if self.method not in ("nearest", "multilinear"):
            raise InvalidInput(f"Table: method = {self.method!r}: must be 'nearest' or 'multilinear'.")
        for axis in self.axes:
            if axis.ndim != 1 or not axis.size or not np.isfinite(axis).all() or (np.diff(axis) <= 0.0).any():
                raise InvalidInput(f"Table: an axis must be finite numbers that ascend, got {axis!r}.")
        shape = tuple(len(axis) for axis in self.axes)
        if not shape or self.values.shape != shape or not np.isfinite(self.values).all():
            raise InvalidInput(f"Table: needs finite values of shape {shape}, got {self.values.shape}.")

    @property
    def n_inputs(self) -> int:
        return len(self.axes)

    def predict(self, x: Array) -> Array:
        from scipy.interpolate import RegularGridInterpolator

        x = np.clip(x, *np.array([(axis[0], axis[-1]) for axis in self.axes]).T)
        varied_axes = [d for d, axis in enumerate(self.axes) if len(axis) > 1]  # an axis of one node says nothing
        values = self.values.squeeze()
        if not varied_axes:
            return np.full(len(x), float(values))
        method = "linear" if self.method == "multilinear" else "nearest"
        return np.asarray(
            RegularGridInterpolator([self.axes[d] for d in varied_axes], values, method)(x[:, varied_axes])
        )

    def pack(self) -> Packed:
        kind = kernel.NEAREST if self.method == "nearest" else kernel.MULTILINEAR
        nodes = np.concatenate(self.axes)
        return Packed(kind, [self.n_inputs, *self.values.shape], [*nodes, *self.values.ravel()], 2 * self.n_inputs)

    def shifted(self, by: float) -> Self:
        return replace(self, values=self.values + by)

    def blended(self, share: float, value: float) -> Self:
        return replace(self, values=(1.0 - share) * self.values + share * value)

    def save(self) -> dict[str, Any]:
        return {"axes": [axis.tolist() for axis in self.axes], "values": self.values.tolist(), "method": self.method}

    @classmethod
    def load(cls, saved: Mapping[str, Any]) -> Self:
        return cls(tuple(map(read_array, saved["axes"])), read_array(saved["values"]), saved["method"])

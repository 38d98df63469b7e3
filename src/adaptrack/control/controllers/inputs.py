"""What comes from outside, made into numbers that kernels take."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy import ndarray

from adaptrack.base.checked import FLOAT, reals
from adaptrack.base.errors import InvalidInput, format_value
from adaptrack.core.maths.portable import Array
from adaptrack.road.road_ahead import RoadAhead

MOST_WHEEL_ANGLE, MOST_CHANGE = 0.5 * np.pi, 1e3
"""rad; rad or m."""


def vector(name: str, values: Any, size: int | tuple[int, ...] | None = None, most: int | None = None) -> Array:
    """A writeable, contiguous float64 row; masked entries become NaN.

    size: how long it may be, None: any length but 0; most: only the first so many are read.
    A row that is fit already is given back as it is, not copied. `InvalidInput` for values that are not real numbers,
    or a wrong shape.
    """
    row = _row(name, values, (size,) if isinstance(size, int) else size, most)
    return row if row.flags.carray else row.copy()  # contiguous, aligned and writeable


def _row(name: str, values: Any, sizes: tuple[int, ...] | None, most: int | None) -> Array:
    """`vector`, wherever it stands."""
    if type(values) is ndarray and values.dtype is FLOAT and values.ndim == 1:
        row = values
    else:
        row = reals(name, values)
    if sizes is not None:
        if row.ndim != 1 or row.size not in sizes:
            expected = " or ".join(f"({length},)" for length in sizes)
            raise InvalidInput(f"{name}: shape {row.shape}, expected {expected}.")
    else:
        if row.ndim != 1:
            row = row.reshape(-1)
        if row.size == 0:
            raise InvalidInput(f"{name}: empty; give at least its present value.")
    return row if most is None or row.size <= most else row[:most]


class KernelInput:
    """Numbers that a kernel reads where they stand, and to which rows are copied.

    sizes: how long a row may be, None: any length but 0, of which only as many numbers are read as there is room for.
    """

    __slots__ = ("_longest", "_name", "_parts", "_sizes", "values")

    def __init__(self, name: str, values: Array, sizes: tuple[int, ...] | None = None) -> None:
        self.values, self._name, self._sizes = values, name, sizes
        self._longest = values.size if sizes is None else max(sizes)
        self._parts: dict[Any, Array] = {}

    def take(self, numbers: Any) -> int:
        """Copy a row; how many numbers of it are read. Raises as `vector`."""
        if type(numbers) is ndarray and numbers.dtype is FLOAT:
            part = self._parts.get(numbers.shape)
            if part is not None:  # a row of this shape has been checked before
                part[...] = numbers
                return len(part)
            if self._sizes is None and numbers.ndim == 1 and numbers.size > self._longest:
                self.values[...] = numbers[: self._longest]
                return self._longest
        row = _row(self._name, numbers, self._sizes, self._longest)
        part = self._parts[row.shape] = self.values[: row.size]
        part[...] = row
        return len(part)


def number(name: str, value: Any) -> float:
    """A real number as a float; beyond the largest one infinity. `InvalidInput` for anything else, truth values too."""
    if type(value) is float:
        return value
    row = reals(name, value)
    if row.shape != ():
        raise InvalidInput(f"{name} = {format_value(value)}: must be one number.")
    return float(row)


def finite(name: str, value: Any) -> float:
    """A finite number; `InvalidInput` for anything else."""
    result = number(name, value)
    if not np.isfinite(result):
        raise InvalidInput(f"{name} = {format_value(value)}: must be finite.")
    return result


def wheel_angle(name: str, value: Any) -> float:
    """An angle (rad) that road wheels can have, `MOST_WHEEL_ANGLE` to either side; `InvalidInput` for anything else."""
    angle = finite(name, value)
    if abs(angle) > MOST_WHEEL_ANGLE:
        raise InvalidInput(
            f"{name} = {format_value(value)} rad: no road wheel turns by more than {MOST_WHEEL_ANGLE:.4g} rad."
        )
    return angle


def change_of_path(heading: Any, offset: Any) -> tuple[float, float]:
    """By how much heading (rad) and offset (m) have grown against another path: less than `MOST_CHANGE`.

    `InvalidInput` for a number that is not finite, or so large that the controller had better begin anew.
    """
    turned, shifted = finite("change_path: heading", heading), finite("change_path: offset", offset)
    if max(abs(turned), abs(shifted)) >= MOST_CHANGE:
        change = f"{format_value(heading)} rad, {format_value(offset)} m"
        raise InvalidInput(f"change_path: {change}: too far from the path before; reset instead.")
    return turned, shifted


def road_ahead(value: Any) -> RoadAhead | None:
    """The road ahead of a car, None where it is straight; `InvalidInput` for anything else."""
    if not (value is None or isinstance(value, RoadAhead)):
        raise InvalidInput(
            f"road = {format_value(value)}: must be RoadAhead(road, station, speeds), or None: straight."
        )
    return value

"""What comes from outside, made into numbers that kernels take."""

from __future__ import annotations

from typing import Any

import numpy as np

from adaptrack.arguments import FLOAT, Array, reals
from adaptrack.errors import InvalidInput, shown
from adaptrack.road.ahead import RoadAhead

MOST_WHEEL_ANGLE, MOST_CHANGE = 0.5 * np.pi, 1e3
"""rad; rad or m."""


def vector(name: str, values: Any, size: int | tuple[int, ...] | None = None, most: int | None = None) -> Array:
    """A writeable, contiguous float64 row; masked entries become NaN.

    size: how long it may be, None: any length but 0; most: only the first so many are read.
    A row that is fit already is given back as it is, not copied.

    Raises
    ------
    InvalidInput
        When the values are not real numbers, or the shape is wrong.
    """
    if type(values) is np.ndarray and values.dtype is FLOAT and values.ndim == 1:
        row = values
    else:
        row = reals(name, values)
    if size is not None:
        fitting = (size,) if isinstance(size, int) else size
        if row.ndim != 1 or row.size not in fitting:
            expected = " or ".join(f"({length},)" for length in fitting)
            raise InvalidInput(f"{name}: shape {row.shape}, expected {expected}.")
    else:
        if row.ndim != 1:
            row = row.reshape(-1)
        if row.size == 0:
            raise InvalidInput(f"{name}: empty; give at least its present value.")
    if most is not None and row.size > most:
        row = row[:most]
    return row if row.flags.carray else row.copy()  # contiguous, aligned and writeable


def number(name: str, value: Any) -> float:
    """A real number as a float; beyond the largest one infinity. Truth values and text are none.

    Raises
    ------
    InvalidInput
        When it is no real number.
    """
    if type(value) is float:
        return value
    row = reals(name, value)
    if row.shape != ():
        raise InvalidInput(f"{name} = {shown(value)}: must be one number.")
    return float(row)


def finite(name: str, value: Any) -> float:
    """A finite number.

    Raises
    ------
    InvalidInput
        When it is none.
    """
    given = number(name, value)
    if not np.isfinite(given):
        raise InvalidInput(f"{name} = {shown(value)}: must be finite.")
    return given


def wheel_angle(name: str, value: Any) -> float:
    """An angle (rad) that road wheels can have: `MOST_WHEEL_ANGLE` to either side at most.

    Raises
    ------
    InvalidInput
        When it is none.
    """
    given = finite(name, value)
    if abs(given) > MOST_WHEEL_ANGLE:
        raise InvalidInput(f"{name} = {shown(value)} rad: no road wheel turns by more than {MOST_WHEEL_ANGLE:.4g} rad.")
    return given


def change_of_path(heading: Any, offset: Any) -> tuple[float, float]:
    """By how much heading (rad) and offset (m) have grown against another path: less than `MOST_CHANGE`.

    Raises
    ------
    InvalidInput
        When a number is not finite, or so large that the controller had better begin anew.
    """
    turned, shifted = finite("change_path: heading", heading), finite("change_path: offset", offset)
    if max(abs(turned), abs(shifted)) >= MOST_CHANGE:
        said = f"{shown(heading)} rad, {shown(offset)} m"
        raise InvalidInput(f"change_path: {said}: too far from the path before; reset instead.")
    return turned, shifted


def road_ahead(value: Any) -> RoadAhead | None:
    """The road ahead of a car, None where it is straight; `InvalidInput` for anything else."""
    if not (value is None or isinstance(value, RoadAhead)):
        raise InvalidInput(f"road = {shown(value)}: must be RoadAhead(road, station, speeds), or None: straight.")
    return value

"""What comes from outside, made into numbers that kernels take."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from adaptrack.errors import InvalidInput

Array = NDArray[np.float64]
FLOAT = np.dtype(np.float64)
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
        row = _converted(name, values)
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
    row = _converted(name, value)
    if row.shape != ():
        raise InvalidInput(f"{name} = {_short(value)}: must be one number.")
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
        raise InvalidInput(f"{name} = {value!r}: must be finite.")
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
        raise InvalidInput(f"{name} = {value!r} rad: no road wheel turns by more than {MOST_WHEEL_ANGLE:.4g} rad.")
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
        raise InvalidInput(f"change_path: {heading!r} rad, {offset!r} m: too far from the path before; reset instead.")
    return turned, shifted


def _converted(name: str, values: Any) -> Array:
    try:
        given = np.asarray(values)
        if given.dtype == object:  # whole numbers beyond 64 bits, decimals, fractions
            given = np.array([_as_float(value) for value in given.ravel()]).reshape(given.shape)
    except Exception:  # whatever an object of others raises when it is asked for its numbers
        given = np.empty(0, dtype=str)
    if given.dtype is FLOAT and isinstance(values, tuple | list):
        return given
    if given.dtype.kind not in "iuf":
        raise InvalidInput(f"{name} = {_short(values)}: must be real numbers.")
    with np.errstate(over="ignore"):  # wider than float64
        row = given.astype(np.float64)
    if isinstance(values, np.ma.MaskedArray):
        row[np.ma.getmaskarray(values)] = np.nan
    return row


def _as_float(value: Any) -> float:
    if isinstance(value, bool | str | bytes) or value is None:
        raise TypeError
    try:
        return float(value)
    except OverflowError:
        return np.inf if value > 0 else -np.inf


def _short(value: Any) -> str:
    try:
        text = repr(value)
    except Exception:
        text = f"<{type(value).__name__}>"
    return text if len(text) <= 80 else f"{text[:77]}..."

"""Numbers that come from outside, made into arrays of float64."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from adaptrack.base.errors import InvalidInput, shown

Array = NDArray[np.float64]
FLOAT = np.dtype(np.float64)


def reals(name: str, values: Any) -> Array:
    """`values` as float64, in their shape: masked entries become NaN, a number beyond the largest one infinity.

    An array of float64 is given back as it is, not copied.

    Raises
    ------
    InvalidInput
        When they are no real numbers (truth values and text are none), or rows are not of one length.
    """
    if type(values) is np.ndarray and values.dtype is FLOAT:
        return values
    try:
        given = np.asarray(values)
        if given.dtype == object:  # whole numbers beyond 64 bits, decimals, fractions
            given = np.array([_as_float(value) for value in given.ravel()]).reshape(given.shape)
    except Exception:  # whatever an object of others raises when it is asked for its numbers
        given = np.empty(0, dtype=str)
    if given.dtype is FLOAT and isinstance(values, tuple | list | float):
        return given
    if given.dtype.kind not in "iuf":
        raise InvalidInput(f"{name} = {shown(values)}: must be real numbers.")
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

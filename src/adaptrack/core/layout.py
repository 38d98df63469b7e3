"""How much memory the arrays of a record need, for every program that lays one out.

A table has a row for each array of the record, in the order of its words (`kernel.Resident`), records within it
included: the sizes of the array, zeros behind them. An array of n dimensions reads the first n sizes; any of them may
be 0. Numbers are float64 or int64 as the record says, rows of records as many words as the record has (`size_of`), all
C-contiguous, the last size running fastest. Row lengths that the kernels want padded (to multiples of
`maths.vectors.WIDTH`) are so in the table.

Every array begins at a multiple of `ALIGNMENT` bytes, and is zero before it is written to; two arrays do not overlap
but where a file says that they are one.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from .kernel import Array, Scalar, inlined

ALIGNMENT = 64
"""bytes, a cache line: loads of eight numbers then touch one, not two"""
SIZES = 4
"""Columns of a table."""


@inlined
def put(table, row, a, b=0, c=0, d=0):
    """Write the sizes of an array; the next row."""
    table[row, 0], table[row, 1], table[row, 2], table[row, 3] = a, b, c, d
    return row + 1


def arrays_of(kind: Any) -> int:
    """How many arrays a record has, those of records within it included."""
    kinds = kind.kinds.values()
    return sum(1 if isinstance(k, Array) else 0 if isinstance(k, Scalar) else arrays_of(k) for k in kinds)


def allocate(kind: Any, sizes: Any, *counts: Any) -> Any:
    """A record whose numbers and arrays are zero; sizes: what writes its rows, ``sizes(*counts, table, row)``."""
    table = np.zeros((arrays_of(kind), SIZES), np.int64)
    if sizes(*counts, table, 0) != len(table):
        raise AssertionError(f"{kind.__name__}: not every array has its sizes")
    return _laid(kind, iter(table.tolist()))


def _laid(kind: Any, sizes: Iterator[list[int]]) -> Any:
    values: list[Any] = []
    for field_kind in kind.kinds.values():
        if isinstance(field_kind, Array):
            values.append(aligned(tuple(next(sizes)[: field_kind.ndim]), field_kind.dtype))
        else:
            values.append(0 if isinstance(field_kind, Scalar) else _laid(field_kind, sizes))
    return kind(*values)


def aligned(shape: tuple[int, ...], dtype: Any = np.float64) -> Any:
    """A zeroed array that begins at a multiple of `ALIGNMENT`."""
    size = math.prod(shape) * np.dtype(dtype).itemsize
    raw = np.zeros(size + ALIGNMENT, np.uint8)
    start = -raw.ctypes.data % ALIGNMENT
    return raw[start : start + size].view(dtype).reshape(shape)

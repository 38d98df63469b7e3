"""How much memory the arrays of a record need, for every program that lays one out.

A record states the shape of each of its arrays, by numbers and by the names of sizes; a record of sizes holds these.
Where the record of sizes has a record under the name of a part, this holds the sizes of that part.

A table of sizes has a row for each array of the record, in the order of its words (`kernel.Resident`), records within
it included: the sizes of the array, zeros behind them. An array of n dimensions reads the first n sizes; any of them
may be 0. Numbers are float64 or int64 as the record says, rows of records as many words as the record has (`size_of`),
all C-contiguous, the last size running fastest. Row lengths that the kernels want padded (to multiples of
`maths.vectors.WIDTH`) are so in the table.

Every array begins at a multiple of `ALIGNMENT` bytes, and is zero before it is written to; two arrays do not overlap
but where a file says that they are one.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from .kernel import Array, written

ALIGNMENT = 64
"""bytes, a cache line: loads of eight numbers then touch one, not two"""
SIZES = 4
"""Columns of a table."""


def arrays_of(kind: Any) -> int:
    """How many arrays a record has, those of records within it included."""
    return len(list(_shapes(kind, kind, "")))


def sizer(kind: Any, sizes_kind: Any) -> Any:
    """An inlined function ``write(sizes, table)``: the table of sizes of a record, how many arrays it has.

    kind: the record; sizes_kind: the record of its sizes.
    """
    lines = []
    shapes = list(_shapes(kind, sizes_kind, "sizes."))
    for row, shape in enumerate(shapes):
        padded = [*shape, *["0"] * (SIZES - len(shape))]
        lines += [f"table[{row}, {column}] = {size}" for column, size in enumerate(padded)]
    return written(f"sizes_of_{kind.__name__}", "sizes, table", [*lines, f"return {len(shapes)}"], kind)


def _shapes(kind: Any, sizes_kind: Any, before: str) -> Iterator[list[str]]:
    """The shape of each array of a record, as text: numbers, and fields of the record of sizes."""
    for name, field_kind in kind.kinds.items():
        if isinstance(field_kind, Array):
            yield [f"{before}{size}" if isinstance(size, str) else str(size) for size in kind.shapes[name]]
        elif hasattr(field_kind, "kinds"):
            part = sizes_kind.kinds.get(name)
            is_part = hasattr(part, "kinds")
            yield from _shapes(field_kind, part if is_part else sizes_kind, f"{before}{name}." if is_part else before)


def allocate(kind: Any, sizes: Any, **given: Any) -> Any:
    """A record of zeros but for the fields that are given; an array that states no shape is empty.

    sizes: a row of the record of its sizes, or a dictionary.
    """
    names = _names_of(sizes)
    values: list[Any] = []
    for name, field_kind in kind.kinds.items():
        if name in given:
            values.append(given[name])
        elif isinstance(field_kind, Array):
            shape = [sizes[size] if isinstance(size, str) else size for size in kind.shapes[name]]
            values.append(aligned(shape or [0] * field_kind.ndim, field_kind.dtype))
        elif hasattr(field_kind, "kinds"):
            part = sizes[name] if name in names else sizes
            values.append(allocate(field_kind, part if _names_of(part) else sizes))
        else:
            values.append(0)
    return kind(*values)


def _names_of(sizes: Any) -> Any:
    """The names of a row of sizes; none of a dictionary or a number."""
    return () if isinstance(sizes, dict) else sizes.dtype.names or ()


def empty(kind: Any) -> Any:
    """A record whose numbers are zero and whose arrays have no entries."""
    values: list[Any] = []
    for field_kind in kind.kinds.values():
        if isinstance(field_kind, Array):
            values.append(np.zeros((0,) * field_kind.ndim, field_kind.dtype))
        else:
            values.append(empty(field_kind) if hasattr(field_kind, "kinds") else 0)
    return kind(*values)


def aligned(shape: Any, dtype: Any = np.float64) -> Any:
    """A zeroed array that begins at a multiple of `ALIGNMENT`."""
    if 0 in shape:
        return np.zeros(shape, dtype)
    size = math.prod(shape) * np.dtype(dtype).itemsize
    raw = np.zeros(size + ALIGNMENT, np.uint8)
    start = -raw.ctypes.data % ALIGNMENT
    return raw[start : start + size].view(dtype).reshape(shape)

"""Eight double-precision numbers as one value, so that short loops are vector code by construction.

The matrices of the quadratic programmes are tiny (5 to 20 columns). The compiler's loop vectoriser needs longer
loops and a proof that arrays do not overlap; here each operation is a vector instruction because it says so.
Rows are padded to a multiple of `VECTOR_WIDTH` (`padded`), and what stands in the padding never reaches a result.

    total = zeros()
    for k in range(n):
        total = fma8(splat(c[k]), load(A, k, b), total)   # c'A, columns b .. b+7
    store(out, 0, b, total)

Arithmetic is strict: each operation rounds once, `total` adds in a fixed order, so results do not depend on the
machine's vector width (processors without AVX-512 run the same operations in two or four halves).
Here they work on NumPy arrays of length eight, as they do in plain Python; for the compiler see `build/head.h`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..kernel import inlined, primitive

VECTOR_WIDTH = 8


@inlined
def padded(count: int) -> int:
    """The smallest multiple of `VECTOR_WIDTH` that is not below ``count``: the row length that arrays need."""
    return (count + VECTOR_WIDTH - 1) // VECTOR_WIDTH * VECTOR_WIDTH


_ieee = np.errstate(all="ignore")  # infinities and NaN pass in silence, as they do compiled


@primitive
def load(array: Any, *index: int) -> Any:
    """``array[..., i, j:j+8]``."""
    row, at = array[index[:-1]], index[-1]
    if at + VECTOR_WIDTH > row.shape[0]:
        raise IndexError(f"rows must be padded to a multiple of {VECTOR_WIDTH}")
    return row[at : at + VECTOR_WIDTH].copy()


@primitive
def store(array: Any, *index_and_value: Any) -> None:
    """``array[..., i, j:j+8] = value``."""
    *index, value = index_and_value
    row, at = array[tuple(index[:-1])], index[-1]
    row[at : at + VECTOR_WIDTH] = value


@primitive
def spread(array: Any, *index: int) -> Any:
    """The number ``array[..., i, j]`` in every entry (indices are not negative)."""
    return np.full(VECTOR_WIDTH, array[index])


@primitive
def splat(value: float) -> Any:
    """Fill a vector with one number."""
    return np.full(VECTOR_WIDTH, value)


@primitive
def zeros() -> Any:
    """Zero in every entry."""
    return np.zeros(VECTOR_WIDTH)


@primitive
@_ieee
def add(a: Any, b: Any) -> Any:
    """``a + b``, entry by entry."""
    return a + b


@primitive
@_ieee
def sub(a: Any, b: Any) -> Any:
    """``a - b``, entry by entry."""
    return a - b


@primitive
@_ieee
def mul(a: Any, b: Any) -> Any:
    """``a * b``, entry by entry."""
    return a * b


@primitive
@_ieee
def fma8(a: Any, b: Any, c: Any) -> Any:
    """``a*b + c`` with one rounding, entry by entry."""
    return a * b + c


@primitive
def lesser(a: Any, b: Any) -> Any:
    """``a if a < b else b``, entry by entry: a NaN in ``a`` is passed over."""
    return np.where(a < b, a, b)


@primitive
@_ieee
def div(a: Any, b: Any) -> Any:
    """``a / b``, entry by entry."""
    return a / b


@primitive
def larger(a: Any, b: Any) -> Any:
    """``a if a > b else b``, entry by entry: a NaN in ``a`` is passed over."""
    return np.where(a > b, a, b)


@primitive
def where_positive(a: Any, b: Any, c: Any) -> Any:
    """``b if a > 0 else c``, entry by entry."""
    return np.where(a > 0.0, b, c)


@primitive
def column(array: Any, count: int, first: int, j: int) -> Any:
    """``array[first:first+8, j]``, with zero for the rows from ``count`` on; needs ``first < count``."""
    return np.array([array[i, j] if i < count else 0.0 for i in range(first, first + VECTOR_WIDTH)])


@primitive
@_ieee
def totals(rows: Any) -> Any:
    """The eight sums of the entries of eight values, as one value: neighbours first, then pairs, then fours."""
    stack = np.stack(rows)
    pairs = stack[:, 0::2] + stack[:, 1::2]
    fours = pairs[:, 0::2] + pairs[:, 1::2]
    return fours[:, 0] + fours[:, 1]


@primitive
@_ieee
def total(a: Any) -> float:
    """The sum of the entries, always in the same order."""
    return float(((a[0] + a[4]) + (a[2] + a[6])) + ((a[1] + a[5]) + (a[3] + a[7])))


@primitive
def largest(a: Any) -> float:
    """The largest entry."""
    return float(np.max(a))


@primitive
def all_below_infinity(a: Any) -> bool:
    """Whether no entry is NaN or +inf."""
    return bool(np.all(a < np.inf))


@primitive
def with_entry(a: Any, i: int, value: float) -> Any:
    """``a`` with ``value`` as entry ``i``; ``a`` itself when there is no such entry."""
    a = a.copy()
    if 0 <= i < VECTOR_WIDTH:
        a[i] = value
    return a


@primitive
def keep_first(a: Any, count: int) -> Any:
    """The first ``count`` entries of ``a`` (any integer), zero in the others."""
    return np.where(np.arange(VECTOR_WIDTH) < count, a, 0.0)


@primitive
def smallest(a: Any) -> float:
    """The smallest entry."""
    return float(np.min(a))


@primitive
def keep_last(a: Any, start: int) -> Any:
    """The entries of ``a`` from ``start`` on (any integer), zero before."""
    return np.where(np.arange(VECTOR_WIDTH) >= start, a, 0.0)


@primitive
def first_equal(a: Any, value: float) -> int:
    """The first entry that equals ``value``; `VECTOR_WIDTH` when none does."""
    matches = np.flatnonzero(a == value)
    return int(matches[0]) if matches.size else VECTOR_WIDTH

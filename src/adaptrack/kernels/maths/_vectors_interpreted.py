"""The operations of `vectors` on NumPy arrays of length eight: what they are when the compiler is switched off."""

from __future__ import annotations

from typing import Any

import numpy as np

WIDTH = 8

_ieee = np.errstate(all="ignore")  # infinities and NaN pass in silence, as they do compiled


def load(array: Any, *index: int) -> Any:
    row, at = array[index[:-1]], index[-1]
    if at + WIDTH > row.shape[0]:
        raise IndexError(f"rows must be padded to a multiple of {WIDTH}")
    return row[at : at + WIDTH].copy()


def store(array: Any, *index_and_value: Any) -> None:
    *index, value = index_and_value
    row, at = array[tuple(index[:-1])], index[-1]
    row[at : at + WIDTH] = value


def spread(array: Any, *index: int) -> Any:
    return np.full(WIDTH, array[index])


def splat(value: float) -> Any:
    return np.full(WIDTH, value)


def zeros() -> Any:
    return np.zeros(WIDTH)


@_ieee
def add(a: Any, b: Any) -> Any:
    return a + b


@_ieee
def sub(a: Any, b: Any) -> Any:
    return a - b


@_ieee
def mul(a: Any, b: Any) -> Any:
    return a * b


@_ieee
def fma8(a: Any, b: Any, c: Any) -> Any:
    return a * b + c


def lesser(a: Any, b: Any) -> Any:
    return np.where(a < b, a, b)


@_ieee
def div(a: Any, b: Any) -> Any:
    return a / b


def larger(a: Any, b: Any) -> Any:
    return np.where(a > b, a, b)


def where_positive(a: Any, b: Any, c: Any) -> Any:
    return np.where(a > 0.0, b, c)


def column(array: Any, count: int, first: int, j: int) -> Any:
    return np.array([array[i, j] if i < count else 0.0 for i in range(first, first + WIDTH)])


@_ieee
def totals(rows: Any) -> Any:
    stack = np.stack(rows)
    pairs = stack[:, 0::2] + stack[:, 1::2]
    fours = pairs[:, 0::2] + pairs[:, 1::2]
    return fours[:, 0] + fours[:, 1]


@_ieee
def total(a: Any) -> float:
    return float(((a[0] + a[4]) + (a[2] + a[6])) + ((a[1] + a[5]) + (a[3] + a[7])))


def largest(a: Any) -> float:
    return float(np.max(a))


def all_below_infinity(a: Any) -> bool:
    return bool(np.all(a < np.inf))


def with_entry(a: Any, i: int, value: float) -> Any:
    a = a.copy()
    if 0 <= i < WIDTH:
        a[i] = value
    return a


def keep_first(a: Any, count: int) -> Any:
    return np.where(np.arange(WIDTH) < count, a, 0.0)


def smallest(a: Any) -> float:
    return float(np.min(a))


def keep_last(a: Any, start: int) -> Any:
    return np.where(np.arange(WIDTH) >= start, a, 0.0)


def first_equal(a: Any, value: float) -> int:
    found = np.flatnonzero(a == value)
    return int(found[0]) if found.size else WIDTH

"""Floats as bits: what the elementary functions need to know of the IEEE 754 binary64 format.

Bits are int64 in compiled code and unbounded integers with the compiler switched off: `float_of` takes the lowest 64
of them, so both agree where a shift pushes bits out at the top. Each function here is free of branches.
"""

from __future__ import annotations

import math
import struct
from typing import Any

import numpy as np

from ..kernel import inlined, primitive

ROUNDER = 1.5 * 2.0**52
"""``x + ROUNDER`` ends in the bits of the whole number nearest to x (ties to even), for |x| < 2^51."""

_MOST = 2.0**62


@primitive
def bits_of(x: float) -> int:
    """The bits of a float: sign, 11 of the exponent (its bias is 1023), 52 of the fraction."""
    return struct.unpack("<q", struct.pack("<d", x))[0]


@primitive
def float_of(bits: int) -> float:
    """The float of these 64 bits."""
    return struct.unpack("<d", struct.pack("<Q", bits & 0xFFFFFFFFFFFFFFFF))[0]


LARGEST_USUAL, LEAST_USUAL, ABOVE_ONE = 2.0**500, 2.0**-960, 1.0 + 2.0**-52
"""Of a product's factors and of what is added to it, of a product, and the float above 1, see `usual_sum`."""


def _bits(x: Any) -> Any:
    return np.array(x, np.float64).view(np.int64)


def _floats(number: Any) -> Any:
    value = number.view(np.float64)
    return value if value.ndim else float(value)


@primitive
def upper_half(x: Any) -> Any:
    """x, a float or eight of them, rounded to 26 bits: what it is less than x has 26, too. For |x| < 2^1023."""
    return _floats(np.asarray((_bits(x) + 2**26) & -(2**27)))


@primitive
def to_odd(x: Any, remainder: Any) -> Any:
    """x + rest rounded to odd, of floats or of eight at a time: x is their sum, and `rest` what its rounding dropped.

    Of the two floats around an inexact sum it is the one whose last bit is set.
    """
    number = _bits(x)
    step = ((number ^ _bits(remainder)) >> 63) | 1
    return _floats(np.where((np.asarray(remainder) != 0.0) & (number & 1 == 0), number + step, number))


@primitive
@np.errstate(all="ignore")
def usual_sum(a: Any, b: Any, c: Any, y: Any, beyond: Any) -> bool:
    """Whether |a| + |b| + |c| < 2^500, |a b| >= 2^-960 or a or b is zero, and y + beyond, which is exact, not halfway
    from y to the next float; of eight numbers each: of all.
    """
    near = (np.abs(a) + np.abs(b) + np.abs(c) < LARGEST_USUAL) & np.equal(y + beyond * ABOVE_ONE, y)
    product = np.abs(np.multiply(a, b)) >= LEAST_USUAL
    return bool(np.all(near & (product | (np.equal(a, 0.0) | np.equal(b, 0.0)))))


@inlined
def whole(x: float) -> int:
    """x without its fraction, as an integer; within +-2^62, NaN gives 0.

    So it is defined for every x. A processor's own conversion is not: each gives something else for what does not fit.
    """
    inside = x if abs(x) < _MOST else (0.0 if x != x else math.copysign(_MOST, x))
    return int(inside)


@inlined
def left(number: int, count: int) -> int:
    """number 2^count, for 0 <= count < 64; only the last six bits of count are looked at.

    So it is defined for every count, and the same on every processor, which a shift by more than the width is not. A
    shift by a number that is written out may stand by itself.
    """
    return number << (count & 63)


@inlined
def right(number: int, count: int) -> int:
    """The whole number below number/2^count, for 0 <= count < 64, as `left`."""
    return number >> (count & 63)


@inlined
def two_to(k: int) -> float:
    """2^k for -1022 <= k <= 1023."""
    return float_of((k + 1023) << 52)


@inlined
def scaled(x: float, k: int) -> float:
    """x 2^k for |k| <= 2044; rounded once if |x| is in [1, 2^53)."""
    half = k >> 1
    return x * two_to(half) * two_to(k - half)


@inlined
def negative(x: float) -> bool:
    """Whether the sign bit is set: of -0.0 it is."""
    return math.copysign(1.0, x) < 0.0


@inlined
def signed_if(x: float, odd: int) -> float:
    """x, or -x if the integer is odd."""
    return float_of(bits_of(x) ^ (odd << 63))

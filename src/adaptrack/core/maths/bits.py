"""Floats as bits: what the elementary functions need to know of the IEEE 754 binary64 format.

Bits are int64 in compiled code and unbounded integers with the compiler switched off: `float_of` takes the lowest 64
of them, so both agree where a shift pushes bits out at the top. Each function here is free of branches.
"""

from __future__ import annotations

import math
import struct

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

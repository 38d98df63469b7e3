"""Floats as bits: what the elementary functions need to know of the IEEE 754 binary64 format.

Bits are int64 in compiled code and unbounded integers with the compiler switched off: `float_of` takes the lowest 64
of them, so both agree where a shift pushes bits out at the top. Each function here is free of branches.
"""

from __future__ import annotations

import math
import struct
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from ..abi import INLINE, INTERPRETED, njit

CALLED: dict[str, Any] = {name: value for name, value in INLINE.items() if name != "forceinline"}
"""Options of the longer functions, which the optimiser may leave as calls. Python must not call them."""

ROUNDER = 1.5 * 2.0**52
"""``x + ROUNDER`` ends in the bits of the whole number nearest to x (ties to even), for |x| < 2^51."""

_MOST = 2.0**62


def _bits_in_python(x):
    return struct.unpack("<q", struct.pack("<d", x))[0]


def _float_in_python(bits):
    return struct.unpack("<d", struct.pack("<Q", bits & 0xFFFFFFFFFFFFFFFF))[0]


def _table_in_python(values):
    return lambda i: values[i]


if INTERPRETED:
    bits_of, float_of, table = _bits_in_python, _float_in_python, _table_in_python
else:

    @intrinsic
    def bits_of(typingctx, x):
        """The bits of a float: sign, 11 of the exponent (its bias is 1023), 52 of the fraction."""

        def codegen(context, builder, signature, args):
            x = context.cast(builder, args[0], signature.args[0], types.float64)
            return builder.bitcast(x, ir.IntType(64))

        return types.int64(x), codegen

    @intrinsic
    def float_of(typingctx, bits):
        """The float of these 64 bits."""

        def codegen(context, builder, signature, args):
            return builder.bitcast(args[0], ir.DoubleType())

        return types.float64(types.int64), codegen

    def table(values):
        """A kernel ``look_up(i)`` of constant whole numbers; i is not checked."""

        @intrinsic
        def look_up(typingctx, i):
            def codegen(context, builder, signature, args):
                word = ir.IntType(64)
                constant = ir.Constant(ir.ArrayType(word, len(values)), values)
                place = cgutils.global_constant(builder, "table", constant)
                return builder.load(builder.gep(place, [word(0), args[0]], inbounds=True))

            return types.int64(types.int64), codegen

        return look_up


@njit(**INLINE)
def whole(x: float) -> int:
    """x without its fraction, as an integer; within +-2^62, NaN gives 0.

    So it is defined for every x. A processor's own conversion is not: each gives something else for what does not fit.
    """
    inside = x if abs(x) < _MOST else (0.0 if x != x else math.copysign(_MOST, x))
    return int(inside)


@njit(**INLINE)
def two_to(k: int) -> float:
    """2^k for -1022 <= k <= 1023."""
    return float_of((k + 1023) << 52)


@njit(**INLINE)
def scaled(x: float, k: int) -> float:
    """x 2^k for |k| <= 2044; rounded once if |x| is in [1, 2^53)."""
    half = k >> 1
    return x * two_to(half) * two_to(k - half)


@njit(**INLINE)
def negative(x: float) -> bool:
    """Whether the sign bit is set: of -0.0 it is."""
    return math.copysign(1.0, x) < 0.0


@njit(**INLINE)
def signed_if(x: float, odd: int) -> float:
    """x, or -x if the integer is odd."""
    return float_of(bits_of(x) ^ (odd << 63))


@njit(**INLINE)
def soft_floor(x: float) -> float:
    """The largest whole number <= x, with the sign of x if zero; without the instruction that a processor may lack."""
    near = math.copysign((abs(x) + 2.0**52) - 2.0**52, x)
    below = math.copysign(near - 1.0 if near > x else near, x)
    return below if abs(x) < 2.0**52 else x


@njit(**INLINE)
def soft_ceil(x: float) -> float:
    """The smallest whole number >= x, with the sign of x if zero; without the instruction that a processor may lack."""
    return -soft_floor(-x)

"""Operations whose result is the exact one, rounded once: roots, whole numbers next to a float, remainders.

`fma`, `floor`, `ceil` and `sqrt` are instructions of a processor. Where it lacks one, the library has the `soft_` form
of that name instead. Those and the remainders compute in whole numbers: a finite float is m 2^e with a whole m below
2^53.
"""

from __future__ import annotations

import math

import numpy as np

from ..kernel import exported, float64, inlined, primitive, vector, void
from .bits import bits_of, left, negative, right, scaled, to_odd, upper_half, usual_sum
from .vectors import VECTOR_WIDTH, load, store

_FRACTION = 2**52 - 1
_LIMB = 54  # bits of a digit of long numbers
_DIGIT = 2**54 - 1
_HALF = 27  # bits of half a digit
_HALF_DIGIT = 2**27 - 1


@primitive
def floor(x: float) -> float:
    """The largest whole number <= x, as a float, with the sign of x if zero; x itself if it is not finite."""
    return float(np.floor(x))


@primitive
def ceil(x: float) -> float:
    """The smallest whole number >= x, as a float, with the sign of x if zero; x itself if it is not finite."""
    return float(np.ceil(x))


@primitive
def sqrt(x: float) -> float:
    """The square root; NaN below zero."""
    return math.sqrt(x) if x >= 0.0 else math.nan


@inlined
def clip(x: float, low: float, high: float) -> float:
    """x limited to [low, high]; NaN stays NaN."""
    below = low if x < low else x
    return high if below > high else below


@inlined
def square(x: float) -> float:
    """x x."""
    return x * x


@inlined
def _split(x):
    """(m, e) with |x| = m 2^e, for a finite x."""
    bits = bits_of(x)
    exponent = (bits >> 52) & 0x7FF
    if exponent == 0:
        return bits & _FRACTION, -1074
    return (bits & _FRACTION) | 2**52, exponent - 1075


@inlined
def _normal(x):
    """(m, e) with |x| = m 2^e and 2^52 <= m, for a finite x other than zero."""
    if abs(x) < 2.0**-1022:
        m, e = _split(x * 2.0**54)
        return m, e - 54
    return _split(x)


@exported(float64(float64, float64))
def fmod(x: float, y: float) -> float:
    """x - n y with the whole n next to x/y towards zero: exact, of x's sign. NaN for y = 0 and infinite x."""
    a, b = abs(x), abs(y)
    if not (a < math.inf and b > 0.0):  # also of NaN
        return math.nan
    if b != b:
        return math.nan
    if a < b:
        return x
    m, e = _split(x)
    divisor, least = _split(y)
    m = m % divisor
    while e > least:
        step = min(e - least, 10)  # m << 10 has 63 bits
        m = left(m, step) % divisor
        e -= step
    return math.copysign(scaled(float(m), least), x)


@exported(float64(float64, float64))
def modulo(a: float, b: float) -> float:
    """a % b as Python has it, of the sign of b; NaN for b = 0."""
    remainder = fmod(a, b)
    if remainder == 0.0:
        return math.copysign(0.0, b)
    return remainder + b if (remainder < 0.0) != (b < 0.0) else remainder


@exported(float64(float64))
def soft_floor(x: float) -> float:
    """The largest whole number <= x, with the sign of x if zero; without the instruction that a processor may lack."""
    near = math.copysign((abs(x) + 2.0**52) - 2.0**52, x)
    below = math.copysign(near - 1.0 if near > x else near, x)
    return below if abs(x) < 2.0**52 else x


@exported(float64(float64))
def soft_ceil(x: float) -> float:
    """The smallest whole number >= x, with the sign of x if zero; without the instruction that a processor may lack."""
    return -soft_floor(-x)


@inlined
def _length(m):
    """How many bits a whole number 0 <= m < 2^62 has."""
    if m < 2**53:
        return (bits_of(float(m)) >> 52) - 1022 if m > 0 else 0
    return (bits_of(float(m >> 10)) >> 52) - 1012


@inlined
def _product(a, b):
    """(high, low) with a b = high 2^54 + low, of whole numbers below 2^53."""
    a1, a0, b1, b0 = a >> _HALF, a & _HALF_DIGIT, b >> _HALF, b & _HALF_DIGIT
    middle = a1 * b0 + a0 * b1
    low = a0 * b0 + ((middle & _HALF_DIGIT) << _HALF)
    return a1 * b1 + (middle >> _HALF) + (low >> _LIMB), low & _DIGIT


@inlined
def _moved_left(high, low, count):
    """(high, low) 2^count, for a count of at most 107; the result fits."""
    if count >= _LIMB:
        return left(low, count - _LIMB), 0
    return left(high, count) | right(low, _LIMB - count), left(low, count) & _DIGIT


@inlined
def _moved_right(high, low, count):
    """(high, low) 2^-count, for count >= 0 and a number of at most 116 bits, not zero.

    The last bit is sticky: set if any that was moved out was. The sum of this and a number whose last two bits are zero
    then rounds as the exact sum does.
    """
    if count > 116:
        return 0, 1
    sticky = 0
    if count >= _LIMB:
        high, low, sticky, count = 0, high, low, count - _LIMB
    sticky |= low & (left(1, count) - 1)
    if count < _LIMB:
        low = right(low, count) | (left(high, _LIMB - count) & _DIGIT)
    else:
        low = right(low, count)
    return right(high, count), low | (1 if sticky != 0 else 0)


@exported(float64(float64, float64, float64))
def whole_fma(a: float, b: float, c: float) -> float:
    """`soft_fma` in whole numbers, for every argument."""
    product = a * b
    if product != product or abs(a) == math.inf or abs(b) == math.inf or a == 0.0 or b == 0.0 or c == 0.0:
        return product if c == 0.0 and a != 0.0 and b != 0.0 else product + c
    if not abs(c) < math.inf:
        return c
    ma, ea = _normal(a)
    mb, eb = _normal(b)
    m, e = _normal(c)
    minus, other = negative(a) != negative(b), negative(c)
    high, low = _product(ma, mb)
    # both in units of 2^unit, which leaves two zeros at the end of the larger
    unit = ea + eb - 2
    high, low = _moved_left(high, low, 2)
    distance = e - unit
    most = 62
    if distance > most:
        high, low = _moved_right(high, low, distance - most)
        unit, distance = e - most, most
    if distance >= 0:
        c_high, c_low = _moved_left(0, m, distance)
    else:
        c_high, c_low = _moved_right(0, m, -distance)
    # their sum or difference, by the sign of the larger
    if minus == other:
        high, low = high + c_high, low + c_low
    elif high > c_high or (high == c_high and low >= c_low):
        high, low = high - c_high, low - c_low
    else:
        high, low, minus = c_high - high, c_low - low, other
    high, low = high + (low >> _LIMB), low & _DIGIT
    if high == 0 and low == 0:
        return 0.0
    length = _LIMB + _length(high) if high > 0 else _length(low)
    # to 55 bits, the last of which stands for all below; fewer for a subnormal result
    drop = max(length - 55, -1076 - unit)
    if drop > 0:
        high, low = _moved_right(high, low, drop)
    else:
        high, low = _moved_left(high, low, -drop)
    m = (high << _LIMB) | low
    tail = m & 3
    m = (m >> 2) + (1 if tail == 3 or (tail == 2 and (m >> 2) & 1 == 1) else 0)
    answer = scaled(float(m), min(unit + drop + 2, 1100))
    return -answer if minus else answer


@inlined
def _exact_parts(a, b, c):
    """(s, rest, low) with a b + c = s - (rest + low), of floats or of eight at a time.

    The product is p - low, and the sum of p and c is s - rest, all exact (T. J. Dekker, A floating-point technique for
    extending the available precision, 1971; D. E. Knuth, The Art of Computer Programming 2, section 4.2.2). Either
    `rest` is zero, or it and `low` are below 2^-51 s. Where they are zero they are positive, so that s, less them,
    keeps its sign.
    """
    p = a * b
    a1, b1 = upper_half(a), upper_half(b)
    a0, b0 = a - a1, b - b1
    s = p + c
    c1 = s - p
    return s, ((s - c1) - p) + (c1 - c), (((p - a1 * b1) - a1 * b0) - a0 * b1) - a0 * b0


@inlined
def _rounded_to_odd(a, b, c):
    """a b + c, rounded once: what is left of the sum, rounded to odd, is taken off it (S. Boldo and G. Melquiond,
    Emulation of a FMA and correctly rounded sums, 2008).
    """
    s, remainder, low = _exact_parts(a, b, c)
    left_over = remainder + low
    low1 = left_over - remainder
    return s - to_odd(left_over, (remainder - (left_over - low1)) + (low - low1))


@inlined
def _fused(a, b, c):
    """(a b + c, rounded once; whether it is sure), of floats or of eight at a time: then of all.

    It is not where something overflows or digits underflow. Nor where what is left of the sum, rounded, makes it lie
    halfway between two floats: what that rounding dropped, which is less than its last digit, then decides.
    """
    s, remainder, low = _exact_parts(a, b, c)
    left_over = remainder + low
    y = s - left_over
    return y, usual_sum(a, b, c, y, (s - y) - left_over)


@exported(float64(float64, float64, float64))
def careful_fma(a: float, b: float, c: float) -> float:
    """`soft_fma`, for every argument: mostly not the fastest way."""
    return _rounded_to_odd(a, b, c) if usual_sum(a, b, c, 0.0, 0.0) else whole_fma(a, b, c)


@exported(float64(float64, float64, float64))
def soft_fma(a: float, b: float, c: float) -> float:
    """a b + c, rounded once to the nearest, ties to even: what IEEE 754 (2008, section 5.4.1) asks of `fma`."""
    y, sure = _fused(a, b, c)
    return y if sure else careful_fma(a, b, c)


@exported(void(vector, vector, vector, vector))
def soft_fma8(a, b, c, answer):
    """`soft_fma` of eight numbers each."""
    y, sure = _fused(load(a, 0), load(b, 0), load(c, 0))
    if sure:
        store(answer, 0, y)
    else:
        for i in range(VECTOR_WIDTH):
            answer[i] = careful_fma(a[i], b[i], c[i])


@exported(float64(float64))
def soft_sqrt(x: float) -> float:
    """The square root, rounded to the nearest; NaN below zero. Bit by bit, with the remainder as the sticky bit."""
    if not 0.0 < x < math.inf:
        return x if x == 0.0 or x > 0.0 else math.nan
    m, e = _normal(x)
    if e & 1 == 1:
        m, e = m << 1, e - 1
    # the root of m 2^54, of 54 bits: m is taken in two bits at a time, as in a long division
    root, remainder = 0, 0
    for i in range(54):
        pair = right(m, 52 - 2 * i) & 3 if i <= 26 else 0
        remainder, root = (remainder << 2) | pair, root << 1
        if remainder > 2 * root:
            remainder, root = remainder - (2 * root + 1), root + 1
    return scaled(float((root >> 1) + (1 if root & 1 == 1 else 0)), (e - 54) // 2 + 1)

"""Exponential, logarithms, powers and what is made of them, as C99 has them (annex F): at most one unit in the last
place off.

Arithmetic is that of IEEE 754 and exact multiply-adds, so every processor gives the same bits (but those of a NaN).
Where more than 53 bits are needed a number is the sum of two floats, with the error terms of Dekker (A floating-point
technique for extending the available precision, Numerische Mathematik 18, 1971). The coefficients were
computed by `elementary_coefficients.py` in the benchmarks of commit c623557.

`exp` is free of branches: loops that call it become vector instructions.
"""

from __future__ import annotations

import math

from ..kernel import exported, float64, fma, inlined
from .bits import ROUNDER, bits_of, float_of, negative, scaled, two_to
from .exact import floor, sqrt
from .polynomial import halves, seven, ten

_TINY = 2.0**-54
_HIGHEST, _LOWEST = 710.0, -746.0  # exp of the first is infinite, of the second zero
_LN_2, _LN_2_LOW = 0.6931471805598903, 5.497923018708371e-14  # 42 and 53 bits
_INVERSE_LN_2 = 1.4426950408889634
_INVERSE_LN_10, _INVERSE_LN_10_LOW = 0.4342944819032518, 1.098319650216765e-17
_TWO_THIRDS, _TWO_THIRDS_LOW = 0.6666666666666666, 3.700743415417188e-17
_ROOT_HALF = 0x3FE6A09E667F3BCD  # the bits of sqrt(1/2)

# (exp(r) - 1 - r - r^2/2)/r^3, |r| <= ln(2)/2; relative error 2^-63.8
_EXPONENTIAL = halves((
    0.16666666666666685, 0.041666666666666685, 0.008333333333315955, 0.001388888888887332, 0.00019841269898657093,
    2.4801587349060595e-05, 2.7557232875898035e-06, 2.755725199229993e-07, 2.511265401198411e-08,
    2.0921702372435563e-09,
))  # fmt: skip
# (2 atanh(s) - 2 s - 2 s^3/3)/s^5, of t = s^2, |s| <= (sqrt(2) - 1)^2; relative error 2^-66.2
_LOGARITHM = (
    0.4000000000000237, 0.2857142857005262, 0.22222222527208363, 0.18181783800570817, 0.15386780897865104,
    0.1325631622878917, 0.1320062266357733,
)  # fmt: skip


@inlined
def _halvings(x):
    """(k, r, rest) with x = k ln 2 + r + rest, |r| <= ln(2)/2, for |x| < 750.

    Cody and Waite's reduction (Software Manual for the Elementary Functions, 1980) by fused multiply-adds.
    """
    rounded = fma(x, _INVERSE_LN_2, ROUNDER)
    k = rounded - ROUNDER
    first = fma(-k, _LN_2, x)  # exact
    r = fma(-k, _LN_2_LOW, first)
    remainder = fma(-k, _LN_2_LOW, first - r)
    return (bits_of(rounded) & (2**52 - 1)) - 2**51, r, remainder


@inlined
def _exp_of(k, r, remainder):
    """2^k exp(r + rest), |r| <= 0.35, for a `rest` below one unit in the last place of r."""
    first = 1.0 + r
    small = fma(r * r, fma(r, ten(r, *_EXPONENTIAL), 0.5), first * remainder)
    return scaled(first + (((1.0 - first) + r) + small), k)


@inlined
def _inside(x):
    """x within what exp distinguishes; NaN stays NaN."""
    x = _LOWEST if x < _LOWEST else x
    return _HIGHEST if x > _HIGHEST else x


@inlined
def exp(x: float) -> float:
    """e^x: infinite above 709.78, zero below -745.13."""
    k, r, remainder = _halvings(_inside(x))
    return _exp_of(k, r, remainder)


@exported(float64(float64))
def tanh(x: float) -> float:
    """tanh(x) = u/(u + 2) with u = exp(2|x|) - 1, all in sums of two floats."""
    a = abs(x)
    if a != a or a < _TINY:
        return x
    if a > 22.0:
        return math.copysign(1.0, x)
    n, r, remainder = _halvings(2.0 * a)
    half = 0.5 * r
    square = half * r
    small = fma(remainder, r, remainder) + fma(half, r, -square) + r * r * r * ten(r, *_EXPONENTIAL)
    first = r + square
    unit = two_to(n)
    first, small = first * unit, (((r - first) + square) + small) * unit
    u = (unit - 1.0) + first
    small += ((unit - 1.0) - u) + first
    u, u_low = u + small, small + (u - (u + small))
    d = u + 2.0
    d_low = ((2.0 - d) + u if u < 2.0 else (u - d) + 2.0) + u_low
    q = u / d
    return math.copysign(q + (fma(-q, d, u) + (u_low - q * d_low)) / d, x)


@inlined
def _log_of(k, f, f_low):
    """k ln 2 + log(1 + f + f_low) as a sum of two floats, for sqrt(1/2) <= 1 + f <= sqrt(2); relative error 2^-64.

    log(1 + f) = 2 atanh(s) with s = f/(2 + f) (Muller, Elementary Functions, 3rd edition, 2016, chapter 5).
    """
    d = 2.0 + f
    d_low = (f - (d - 2.0)) + f_low
    inverse = 1.0 / d
    s = f * inverse
    s_low = (fma(-s, d, f) + fma(-s, d_low, f_low)) * inverse
    t = s * s
    t_low = fma(s, s, -t) + 2.0 * s * s_low
    cube = s * t
    cube_low = fma(s, t, -cube) + fma(s, t_low, s_low * t)
    third = _TWO_THIRDS * cube
    third_low = fma(_TWO_THIRDS, cube, -third) + fma(_TWO_THIRDS, cube_low, _TWO_THIRDS_LOW * cube)
    remainder = seven(t, *_LOGARITHM)
    fifth = cube * t * remainder
    tail = third + fifth
    tail_low = ((third - tail) + fifth) + fma(fma(cube, t_low, cube_low * t), remainder, third_low)
    double = 2.0 * s
    part = double + tail
    part_low = ((double - part) + tail) + fma(2.0, s_low, tail_low)
    leading = k * _LN_2  # exact
    total = leading + part
    low = ((leading - total) + part) + fma(k, _LN_2_LOW, part_low)
    hi = total + low
    return hi, (total - hi) + low


@inlined
def _parts(x):
    """(k, m) with x = 2^k m and sqrt(1/2) <= m < sqrt(2), for a finite x > 0."""
    small = x < 2.0**-1022
    bits = bits_of(x * 2.0**54 if small else x)
    k = (bits - _ROOT_HALF) >> 52
    return k - 54 if small else k, float_of(bits - (k << 52))


@inlined
def _log_as_sum(x):
    """log(x) as a sum of two floats, for a finite x > 0."""
    k, m = _parts(x)
    return _log_of(float(k), m - 1.0, 0.0)


@exported(float64(float64))
def log(x: float) -> float:
    """The natural logarithm; -inf at 0, NaN below."""
    if not 0.0 < x < math.inf:
        return -math.inf if x == 0.0 else (math.inf if x > 0.0 else math.nan)
    return _log_as_sum(x)[0]


@exported(float64(float64))
def log10(x: float) -> float:
    """The logarithm to the base 10; -inf at 0, NaN below."""
    if not 0.0 < x < math.inf:
        return -math.inf if x == 0.0 else (math.inf if x > 0.0 else math.nan)
    hi, low = _log_as_sum(x)
    product = hi * _INVERSE_LN_10
    return product + (fma(hi, _INVERSE_LN_10, -product) + fma(hi, _INVERSE_LN_10_LOW, low * _INVERSE_LN_10))


@exported(float64(float64))
def log1p(x: float) -> float:
    """log(1 + x), without the loss of digits near 0; -inf at -1, NaN below."""
    if abs(x) < _TINY:
        return x
    if not -1.0 < x < 2.0**60:
        return log(x) if x > 0.0 else (-math.inf if x == -1.0 else math.nan)
    u = 1.0 + x
    u_low = 1.0 - (u - x) if x > 1.0 else x - (u - 1.0)
    k, m = _parts(u)
    f, f_low = (x, 0.0) if k == 0 else (m - 1.0, u_low * two_to(-k))
    return _log_of(float(k), f, f_low)[0]


@inlined
def _is_odd(y):
    """Whether a finite y is an odd whole number."""
    return abs(y) < 2.0**53 and abs(y) - 2.0 * floor(0.5 * abs(y)) == 1.0


@exported(float64(float64, float64))
def power(x: float, y: float) -> float:
    """x^y, the exponential of y log(x), which is kept as a sum of two floats."""
    if y == 0.0 or x == 1.0:
        return 1.0
    if x != x or y != y:
        return math.nan
    a, b = abs(x), abs(y)
    if b == math.inf:
        return 1.0 if a == 1.0 else (math.inf if (a > 1.0) == (y > 0.0) else 0.0)
    sign = -1.0 if negative(x) and _is_odd(b) else 1.0
    if a == 0.0 or a == math.inf:
        return sign * (math.inf if (a > 1.0) == (y > 0.0) else 0.0)
    if x < 0.0 and b < 2.0**52 and b != floor(b):
        return math.nan
    y = math.copysign(min(b, 2.0**66), y)  # beyond it 0, 1 or infinity all the same
    hi, low = _log_as_sum(a)
    product = y * hi
    low = fma(y, hi, -product) + y * low
    k, r, remainder = _halvings(_inside(product))
    remainder += low if abs(product) < -_LOWEST else 0.0
    total = r + remainder
    return sign * _exp_of(k, total, remainder + (r - total))


@exported(float64(float64, float64))
def hypot(x: float, y: float) -> float:
    """sqrt(x^2 + y^2) without overflow; infinite if one is, whatever the other.

    Borges, An improved algorithm for hypot(a, b), 2019: the root's own error, from exact squares.
    """
    a, b = abs(x), abs(y)
    if a == math.inf or b == math.inf:
        return math.inf
    if a != a or b != b:
        return math.nan
    a, b = max(a, b), min(a, b)
    if b <= a * 2.0**-54:
        return a
    scale = 2.0**-600 if a > 2.0**500 else (2.0**600 if b < 2.0**-450 else 1.0)
    a, b = a * scale, b * scale
    h = sqrt(fma(a, a, b * b))
    square, first = h * h, a * a
    error = fma(-b, b, square - first) + (fma(h, h, -square) - fma(a, a, -first))
    return (h - error / (2.0 * h)) * (1.0 / scale)

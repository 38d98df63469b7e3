"""Sine, cosine, tangent and their inverses, as C99 has them (annex F): at most one unit in the last place off.

Arithmetic is that of IEEE 754 and exact multiply-adds, so every processor gives the same bits (but those of a NaN). The
coefficients were computed by `elementary_coefficients.py` in the benchmarks of commit c623557.

`sin`, `cos` and `tan` take any argument. Where loops are to become vector instructions see `fast`.
"""

from __future__ import annotations

import math

import numpy as np

from ..kernel import exported, float64, fma, inlined, int64, several
from .bits import ROUNDER, bits_of, left, negative, right, signed_if, two_to
from .exact import sqrt
from .polynomial import eleven, halves, six, twelve

MAX_NEAR_ANGLE = 1e5
"""rad; up to it `_reduce_near` reduces an argument"""

_TINY = 2.0**-28  # below it sin(x) = tan(x) = asin(x) = x
_TWO_OVER_PI = 2.0 / math.pi
_HALF_PI, _HALF_PI_LOW = 1.5707963267948966, 6.123233995736766e-17
_PI, _PI_LOW = 3.141592653589793, 1.2246467991473532e-16
_QUARTER_PI = 0.25 * _PI
_TAN_PI_8, _TAN_3_PI_8 = 0.41421356237309503, 2.414213562373095
# pi/2 in three parts, of 37, 37 and 53 bits: its product with a whole number below 2^16 is exact but for the last
_FIRST, _SECOND, _THIRD = 1.5707963267923333, 2.5633441515839558e-12, 1.0562999066987428e-23

# (sin(y)/y - 1)/y^2, of t = y^2, |y| <= pi/4; relative error 2^-57.9
_SINE = (
    -0.1666666666666663, 0.008333333333321976, -0.00019841269829525107, 2.755731360899387e-06,
    -2.505074680230245e-08, 1.5896212232510631e-10,
)  # fmt: skip
# (cos(y) - 1 + y^2/2)/y^4, of t = y^2, |y| <= pi/4; relative error 2^-64.0
_COSINE = (
    0.041666666666666595, -0.0013888888888873461, 2.480158728911982e-05, -2.75573142586856e-07,
    2.0875711707973604e-09, -1.1359097367080523e-11,
)  # fmt: skip
# (atan(z)/z - 1)/z^2, of t = z^2, |z| <= tan(pi/8); relative error 2^-59.3
_ARCTANGENT = halves((
    -0.33333333333333187, 0.19999999999951215, -0.14285714279995193, 0.11111110774690779, -0.09090897533501092,
    0.0769205661728733, -0.0666306677020241, 0.058476399881540575, -0.05038265409309135, 0.03804000391080192,
    -0.01788209264572132,
))  # fmt: skip
# (asin(z)/z - 1)/z^2, of t = z^2, |z| <= 1/2; relative error 2^-55.8
_ARCSINE = halves((
    0.16666666666665406, 0.07500000000335101, 0.04464285683105815, 0.03038195899692208, 0.0223717618113127,
    0.01735964424884176, 0.013885856581683516, 0.01216504090053214, 0.006546235643823274, 0.019478022070293,
    -0.016145358394133603, 0.03185833708891584,
))  # fmt: skip

_TWO_OVER_PI_WORDS = np.array([  # in words of 30 bits, the first two above the point
    0, 0, 683565275, 618938706, 670080351, 301282525, 808900773, 429114425, 17299781, 598466235, 827878857,
    115581988, 927694873, 154069513, 879003455, 568242635, 78028027, 679622133, 196006177, 244958978, 449936889,
    20550102, 241226958, 524929093, 1043265508, 674963448, 637532033, 427884274, 1011232104, 174923629, 228570057,
    1018207092, 1025047962, 509602349, 491384497, 1052663575, 754195687, 931811986, 983236311, 991033557, 874600460,
])  # fmt: skip
_MASK = 2**30 - 1


@inlined
def _word(i):
    return int(_TWO_OVER_PI_WORDS[i])


@inlined
def _reduce_near(x):
    """(n, y, low) with x = n pi/2 + y + low, |y| <= pi/4 and n modulo 2^51, for |x| <= LARGEST.

    Cody and Waite's reduction (Software Manual for the Elementary Functions, 1980) by fused multiply-adds.
    """
    rounded = fma(x, _TWO_OVER_PI, ROUNDER)
    k = rounded - ROUNDER
    remainder = fma(-k, _FIRST, x)  # exact
    y = fma(-k, _SECOND, remainder)
    low = fma(-k, _THIRD, fma(-k, _SECOND, remainder - y))
    return bits_of(rounded), y, low


@inlined
def _sine_of(y, low):
    """sin(y + low), |y| <= pi/4, as a sum of two floats, the second much smaller."""
    t = y * y
    return y, fma(y * t, six(t, *_SINE), fma(-0.5 * t, low, low))


@inlined
def _cosine_of(y, low):
    """cos(y + low), |y| <= pi/4, as a sum of two floats, the second much smaller."""
    t = y * y
    half = -0.5 * y
    first = fma(half, y, 1.0)
    return first, fma(half, y, 1.0 - first) + fma(t * t, six(t, *_COSINE), -(y * low))


@inlined
def _sine_at(n, y, low):
    """sin(n pi/2 + y + low)."""
    s, s_low = _sine_of(y, low)
    c, c_low = _cosine_of(y, low)
    sine, cosine = s + s_low, c + c_low
    return signed_if(cosine if n & 1 == 1 else sine, n >> 1)


@exported(several(int64, float64, float64)(float64), name="reduced_right_angle")
def _reduce_far(x):
    """Reduce the argument for any finite |x| >= 2^-6, in the form of `_reduce_near`.

    Payne and Hanek's reduction (Radian reduction for trigonometric functions, SIGNUM Newsletter 18(1), 1983): of the
    product of x with 2/pi, only those bits that are not multiples of 4, in whole numbers; 126 of them after the point.
    """
    bits = bits_of(x)
    exponent = ((bits >> 52) & 0x7FF) - 1075  # x is a whole number below 2^53 times 2^exponent
    m0, m1 = bits & _MASK, ((bits & (2**52 - 1)) | 2**52) >> 30
    i = (exponent + 58) // 30
    shift = exponent + 58 - 30 * i
    # columns of the product with seven words, from the lowest
    c = m0 * _word(i + 6) >> 30
    c += m0 * _word(i + 5) + m1 * _word(i + 6)
    p1, c = c & _MASK, c >> 30
    c += m0 * _word(i + 4) + m1 * _word(i + 5)
    p2, c = c & _MASK, c >> 30
    c += m0 * _word(i + 3) + m1 * _word(i + 4)
    p3, c = c & _MASK, c >> 30
    c += m0 * _word(i + 2) + m1 * _word(i + 3)
    p4, c = c & _MASK, c >> 30
    c += m0 * _word(i + 1) + m1 * _word(i + 2)
    p5, c = c & _MASK, c >> 30
    c += m0 * _word(i) + m1 * _word(i + 1)
    top = (c & _MASK) << 30 | p5  # its point lies above 58 - shift bits
    point = 58 - shift
    n = right(top, point)
    fraction = top & (left(1, point) - 1)
    above_half = right(fraction, point - 1)
    flip = -above_half  # all bits, if the fraction is counted down from the next whole number
    n += above_half
    fraction = (fraction ^ flip) & (left(1, point) - 1)
    p1, p2, p3, p4 = (p1 ^ flip) & _MASK, (p2 ^ flip) & _MASK, (p3 ^ flip) & _MASK, (p4 ^ flip) & _MASK
    # the fraction as a sum of two floats, in units of its last bit
    a, b = float(fraction >> 29) * 2.0**29, float(fraction & (2**29 - 1))
    first = a + b
    c, d = float(p4) * 2.0**-30, float(p3) * 2.0**-60
    second = c + d
    hi = first + second
    lo = ((first - hi) + second) + (((a - first) + b) + (((c - second) + d) + float(p2 << 23 | p1 >> 7) * 2.0**-113))
    y = hi * _HALF_PI
    low = fma(hi, _HALF_PI, -y) + fma(hi, _HALF_PI_LOW, lo * _HALF_PI)
    unit = math.copysign(two_to(-point), x) * (-1.0 if above_half == 1 else 1.0)
    return (-n if x < 0.0 else n), y * unit, low * unit


@inlined
def _reduced(x):
    """`_reduce_near` or `_reduce_far`; of what is not finite, NaN."""
    if abs(x) <= MAX_NEAR_ANGLE or not abs(x) < math.inf:
        return _reduce_near(x)
    return _reduce_far(x)


@exported(float64(float64))
def sin(x: float) -> float:
    """Sine of x (rad)."""
    if abs(x) < _TINY:
        return x
    n, y, low = _reduced(x)
    return _sine_at(n, y, low)


@exported(float64(float64))
def cos(x: float) -> float:
    """Cosine of x (rad)."""
    n, y, low = _reduced(x)
    return _sine_at(n + 1, y, low)


@exported(float64(float64))
def tan(x: float) -> float:
    """tan(x), the quotient of sine and cosine with the remainder of the division."""
    if abs(x) < _TINY:
        return x
    n, y, low = _reduced(x)
    s, s_low = _sine_of(y, low)
    c, c_low = _cosine_of(y, low)
    sine, cosine = s + s_low, c + c_low
    s_low, c_low = (s - sine) + s_low, (c - cosine) + c_low
    odd = n & 1 == 1
    a, a_low = (cosine, c_low) if odd else (sine, s_low)
    b, b_low = (sine, s_low) if odd else (cosine, c_low)
    q = a / b
    return signed_if(q + (fma(-q, b, a) + (a_low - q * b_low)) / b, n)


@inlined
def _angle_of(y, x):
    """arctan(y/x) for y >= 0 and x > 0, as a sum of two floats, the second much smaller.

    It is 0, pi/4 or pi/2 and the arctangent of a z within +-tan(pi/8), with the remainder of the division.
    """
    steep, flat = y > _TAN_3_PI_8 * x, not y > _TAN_PI_8 * x
    share = 1.0 if steep else (0.0 if flat else 0.5)
    a, b = (0.0 if steep else y), (0.0 if flat else x)
    numerator = a - b
    part = numerator - a
    numerator_low = (a - (numerator - part)) - (b + part)
    a, b = (0.0 if flat else y), (0.0 if steep else x)
    denominator = a + b
    part = denominator - a
    denominator_low = (a - (denominator - part)) + (b - part)
    inverse = 1.0 / denominator
    z = numerator * inverse
    t = z * z
    error = (fma(-z, denominator, numerator) + fma(-z, denominator_low, numerator_low)) * inverse
    error = error if abs(error) < 1.0 else 0.0  # of an infinite denominator: NaN
    error = fma(t, t - 1.0, 1.0) * error  # over 1 + t, to a hundredth of what the error is
    small = fma(z * t, eleven(t, *_ARCTANGENT), error)
    offset = share * _HALF_PI
    angle = offset + z
    return angle, ((offset - angle) + z) + fma(share, _HALF_PI_LOW, small)


@inlined
def arctangent_of_ratio(y: float, x: float) -> float:
    """arctan(y/x) for x > 0, in (-pi/2, pi/2)."""
    angle, low = _angle_of(abs(y), x)
    return math.copysign(angle + low, y)


@exported(float64(float64))
def atan(x: float) -> float:
    """Arctangent of x, in rad."""
    return arctangent_of_ratio(x, 1.0)


@exported(float64(float64, float64))
def atan2(y: float, x: float) -> float:
    """The angle of the point (x, y), in [-pi, pi]."""
    if x != x or y != y:
        return math.nan
    a, b, left = abs(y), abs(x), negative(x)
    if a == 0.0 or b == 0.0:
        return math.copysign(_HALF_PI if a > 0.0 else (_PI if left else 0.0), y)
    if a == math.inf and b == math.inf:
        return math.copysign(3.0 * _QUARTER_PI if left else _QUARTER_PI, y)
    largest = max(a, b)
    scale = 2.0**-200 if largest > 2.0**800 else (2.0**200 if largest < 2.0**-800 else 1.0)
    a, b = a * scale, b * scale
    if b == 0.0:
        return math.copysign(_HALF_PI, y)
    angle, low = _angle_of(a, b)
    if left:
        supplement = _PI - angle
        angle, low = supplement, ((_PI - supplement) - angle) + (_PI_LOW - low)
    return math.copysign(angle + low, y)


@exported(float64(float64))
def asin(x: float) -> float:
    """arcsin(x), NaN for |x| > 1."""
    a = abs(x)
    if not a <= 1.0:
        return math.nan
    if a < _TINY:
        return x
    if a < 0.5:
        t = x * x
        return fma(x * t, twelve(t, *_ARCSINE), x)
    if a == 1.0:
        return math.copysign(_HALF_PI, x)
    t = 0.5 * (1.0 - a)  # arcsin(a) = pi/2 - 2 arcsin(sqrt(t))
    s = sqrt(t)
    small = fma(s * t, twelve(t, *_ARCSINE), 0.5 * fma(-s, s, t) / s)
    angle = _HALF_PI - 2.0 * s
    return math.copysign(angle + (((_HALF_PI - angle) - 2.0 * s) + (_HALF_PI_LOW - 2.0 * small)), x)

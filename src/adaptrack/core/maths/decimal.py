"""A number rounded in the decimal system, as it is printed: so that a constant is the same as the one in a file."""

from __future__ import annotations

import math

from ..kernel import exported, float64, fma, inlined, int64
from .exact import floor

MOST_PLACES = 22
"""Powers of ten up to this one are floats exactly."""


@inlined
def _ten_to(places):
    power = 1.0
    for _ in range(places):
        power *= 10.0
    return power


@inlined
def _is_odd(n):
    return n - 2.0 * floor(0.5 * n) > 0.5


@exported(float64(float64, int64))
def to_places(x, places):
    """x to so many decimal places, -22 to 22, ties to even: correctly rounded, as by Python's ``round``.

    What has 2^52 or more units of the last place stays.
    """
    if not abs(x) < 2.0**52 or not -MOST_PLACES <= places <= MOST_PLACES:
        return x
    power, a = _ten_to(abs(places)), abs(x)
    if places >= 0:
        product = a * power
        if not product < 2.0**52:
            return x  # nothing to be rounded
        below = floor(product)
        beyond = (product - below - 0.5) + fma(a, power, -product)  # its sign is exact
        rounded = (below + 1.0 if beyond > 0.0 or (beyond == 0.0 and _is_odd(below)) else below) / power
    else:
        quotient = floor(a / power)
        remainder = fma(-quotient, power, a)
        if remainder < 0.0:
            quotient, remainder = quotient - 1.0, remainder + power
        beyond = remainder - 0.5 * power
        rounded = (quotient + 1.0 if beyond > 0.0 or (beyond == 0.0 and _is_odd(quotient)) else quotient) * power
    return math.copysign(rounded, x)


@exported(float64(float64, int64))
def to_digits(x, digits):
    """x to so many significant digits, as ``float(f"{x:.{digits}g}")``; what is not between 1e-15 and 1e15 stays."""
    a, places = abs(x), digits - 1
    if not 1e-15 < a < 1e15:
        return x
    power = 1.0
    while a >= power * 10.0 and places > -MOST_PLACES:
        power *= 10.0
        places -= 1
    power = 1.0
    while a * power < 1.0 and places < MOST_PLACES:
        power *= 10.0
        places += 1
    return to_places(x, places)

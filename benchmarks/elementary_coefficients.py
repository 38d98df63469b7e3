"""The polynomial coefficients of the elementary functions (`adaptrack.core.maths`), computed anew and printed.

    python benchmarks/elementary_coefficients.py

Each polynomial is a weighted least-squares fit at Chebyshev's points, which is within a small factor of the minimax
(Muller, Elementary Functions, 3rd edition, 2016, section 3.2). The coefficients are rounded to doubles one after the
other, each time with the rest fitted anew to what is left. The error printed is that of the rounded polynomial,
relative to the whole function: half a unit in the last place is between 2^-54 and 2^-53.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import mpmath as mp

mp.mp.prec = 1400
HALF_LN2 = mp.log(2) / 2


def series(terms: Callable[[int], Any], t: Any) -> Any:
    """The sum of ``terms(i) t**i``, for |t| < 1/2, in full precision."""
    total, power = mp.mpf(0), mp.mpf(1)
    for i in range(320):
        total, power = total + terms(i) * power, power * t
    return total


def sine(t: Any) -> Any:
    """(sin(y)/y - 1)/y^2 at t = y^2."""
    return series(lambda i: -((-1) ** i) / mp.factorial(2 * i + 3), t)


def cosine(t: Any) -> Any:
    """(cos(y) - 1 + y^2/2)/y^4 at t = y^2."""
    return series(lambda i: (-1) ** i / mp.factorial(2 * i + 4), t)


def arctangent(t: Any) -> Any:
    """(atan(z)/z - 1)/z^2 at t = z^2."""
    return series(lambda i: -((-1) ** i) / mp.mpf(2 * i + 3), t)


def arcsine(t: Any) -> Any:
    """(asin(z)/z - 1)/z^2 at t = z^2."""
    return series(lambda i: mp.binomial(2 * i + 2, i + 1) / (mp.mpf(4) ** (i + 1) * (2 * i + 3)), t)


def exponential(r: Any) -> Any:
    """(exp(r) - 1 - r - r^2/2)/r^3."""
    return series(lambda i: 1 / mp.factorial(i + 3), r)


def logarithm(t: Any) -> Any:
    """(2 atanh(s) - 2 s - 2 s^3/3)/s^5 at t = s^2."""
    return series(lambda i: 2 / mp.mpf(2 * i + 5), t)


S_LARGEST = (mp.sqrt(2) - 1) ** 2  # s = (m - 1)/(m + 1) at m = sqrt(2)
FITS: tuple[tuple[str, Any, Any, Any, int, Any], ...] = (
    # name, function, from, to, number of coefficients, its weight in the whole function
    ("SINE", sine, 0, (mp.pi / 4) ** 2, 6, lambda t: t),
    ("COSINE", cosine, 0, (mp.pi / 4) ** 2, 6, lambda t: t * t),
    ("ARCTANGENT", arctangent, 0, (mp.sqrt(2) - 1) ** 2, 11, lambda t: t),
    ("ARCSINE", arcsine, 0, mp.mpf(1) / 4, 12, lambda t: t),
    ("EXPONENTIAL", exponential, -HALF_LN2, HALF_LN2, 10, lambda r: r**3),
    ("LOGARITHM", logarithm, 0, S_LARGEST**2, 7, lambda t: t * t / 2),
)


Function = Callable[[Any], Any]


def rounded(function: Function, low: Any, high: Any, count: int, weight: Function) -> list[float]:
    """The coefficients of t^0, t^1, ... as doubles."""
    with mp.workprec(300):
        points = [mp.cos(mp.pi * (i + 0.5) / (3 * count)) for i in range(3 * count)]
        points = [(low + high) / 2 + (high - low) / 2 * each for each in points]
        rest, found = [function(t) for t in points], []
        for first in range(count):
            powers = mp.matrix([[weight(t) * t**i for i in range(first, count)] for t in points])
            fitted = mp.lu_solve(powers, mp.matrix([weight(t) * y for t, y in zip(points, rest, strict=True)]))
            found.append(float(fitted[0]))
            rest = [y - found[-1] * t**first for t, y in zip(points, rest, strict=True)]
        return found


def main() -> None:
    """Print every polynomial and its error, and the constants that are split into several doubles."""
    for name, function, low, high, count, weight in FITS:
        coefficients = rounded(function, low, high, count, weight)
        with mp.workprec(300):
            at = [low + (high - low) * mp.mpf(i) / 400 for i in range(401)]
            error = max(abs((mp.polyval(coefficients[::-1], t) - function(t)) * weight(t)) for t in at)
        print(f"_{name} = (  # relative error 2^{float(mp.log(error, 2)):.1f}")
        print("\n".join(f"    {each!r}," for each in coefficients) + "\n)")
    for name, value, bits in (
        ("pi/2", mp.pi / 2, (37, 37, 53)),
        ("pi/2", mp.pi / 2, (53, 53)),
        ("pi", mp.pi, (53, 53)),
        ("ln 2", mp.log(2), (42, 53)),
        ("1/ln 10", 1 / mp.log(10), (53, 53)),
        ("2/3", mp.mpf(2) / 3, (53, 53)),
    ):
        print(f"{name} in {bits} bits:", *(repr(each) for each in split(value, bits)))
    words = [int(mp.floor(mp.ldexp(2 / mp.pi, 30 * i))) & (2**30 - 1) for i in range(-1, 40)]
    print(f"2/pi in {len(words)} words of 30 bits, the first two above the point:", words)


def split(value: Any, bits: tuple[int, ...]) -> list[float]:
    """A constant as a sum of doubles; each is what is left of it, cut after so many bits."""
    parts = []
    for count in bits:
        unit = mp.mpf(2) ** (mp.floor(mp.log(abs(value), 2)) + 1 - count)
        parts.append(float(mp.nint(value / unit) * unit))
        value -= parts[-1]
    return parts


if __name__ == "__main__":
    main()

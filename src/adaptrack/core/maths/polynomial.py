"""Polynomials of a fixed number of coefficients, in ascending order: ``six(t, *COEFFICIENTS)``.

Horner's rule, each step a single rounding; the longer ones as even and odd part, ``ten(t, *HALVES)``, which halves the
chain of operations that wait for one another (Knuth, The Art of Computer Programming, volume 2, section 4.6.4).
"""

from __future__ import annotations

from ..kernel import fma, inlined


@inlined
def four(t, a, b, c, d):
    """a + b t + c t^2 + d t^3."""
    return fma(fma(fma(d, t, c), t, b), t, a)


@inlined
def five(t, a, b, c, d, e):
    """a + b t + ... + e t^4."""
    return fma(four(t, b, c, d, e), t, a)


@inlined
def six(t, a, b, c, d, e, f):
    """a + b t + ... + f t^5."""
    return fma(five(t, b, c, d, e, f), t, a)


@inlined
def seven(t, a, b, c, d, e, f, g):
    """a + b t + ... + g t^6."""
    return fma(six(t, b, c, d, e, f, g), t, a)


def halves(coefficients):
    """The even and the odd coefficients, as `ten`, `eleven` and `twelve` take them."""
    return tuple(coefficients[0::2]), tuple(coefficients[1::2])


@inlined
def ten(t, even, odd):
    """A polynomial of ten coefficients: five even ones, five odd ones."""
    square = t * t
    return fma(five(square, *odd), t, five(square, *even))


@inlined
def eleven(t, even, odd):
    """A polynomial of eleven coefficients: six even ones, five odd ones."""
    square = t * t
    return fma(five(square, *odd), t, six(square, *even))


@inlined
def twelve(t, even, odd):
    """A polynomial of twelve coefficients: six even ones, six odd ones."""
    square = t * t
    return fma(six(square, *odd), t, six(square, *even))

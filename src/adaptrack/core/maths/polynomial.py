"""Polynomials of a fixed number of coefficients, in ascending order: ``six(t, *COEFFICIENTS)``.

Horner's rule, each step a single rounding; the longer ones as even and odd part, which halves the chain of operations
that wait for one another (Knuth, The Art of Computer Programming, volume 2, section 4.6.4).
"""

from __future__ import annotations

from ..kernel import fma, inlined


@inlined
def five(t, a, b, c, d, e):
    """a + b t + ... + e t^4."""
    return fma(fma(fma(fma(e, t, d), t, c), t, b), t, a)


@inlined
def six(t, a, b, c, d, e, f):
    """a + b t + ... + f t^5."""
    return fma(five(t, b, c, d, e, f), t, a)


@inlined
def seven(t, a, b, c, d, e, f, g):
    """a + b t + ... + g t^6."""
    return fma(six(t, b, c, d, e, f, g), t, a)


@inlined
def ten(t, a, b, c, d, e, f, g, h, i, j):
    """a + b t + ... + j t^9."""
    square = t * t
    return fma(five(square, b, d, f, h, j), t, five(square, a, c, e, g, i))


@inlined
def eleven(t, a, b, c, d, e, f, g, h, i, j, k):
    """a + b t + ... + k t^10."""
    square = t * t
    return fma(five(square, b, d, f, h, j), t, six(square, a, c, e, g, i, k))


@inlined
def twelve(t, a, b, c, d, e, f, g, h, i, j, k, m):
    """a + b t + ... + m t^11."""
    square = t * t
    return fma(six(square, b, d, f, h, j, m), t, six(square, a, c, e, g, i, k))

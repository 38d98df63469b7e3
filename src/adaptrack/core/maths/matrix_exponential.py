"""The exponential of a small matrix Z and its integrals: phi_k(Z) = sum_i Z^i/(i+k)!, so phi_0 = exp(Z).

What dx/dt = A x + B u is after a time T under a held input needs no more: x(T) = phi_0(A T) x + T phi_1(A T) B u, its
integral over T is T phi_1 x + T^2 phi_2 B u, and so on. Matrices are (n, 8): rows are padded to the vector width.
"""

from __future__ import annotations

from ..kernel import inlined, local
from .bits import two_to
from .vectors import VECTOR_WIDTH, add, keep_first, load, mul, splat, spread, store, with_entry

TERMS = 13
"""Of the Taylor series: with a norm of at most 1/2 the remainder is below 1e-17."""
MOST_HALVINGS = 60
_rows = local(4, VECTOR_WIDTH)


@inlined
def _row(a, i, b):
    """Row i of A B: unfused, summed from the first product on."""
    n = a.shape[0]
    row = mul(spread(a, i, 0), load(b, 0, 0))
    for m in range(1, n):
        row = add(row, mul(spread(a, i, m), load(b, m, 0)))
    return keep_first(row, n)  # the compiler leaves out what is not kept


@inlined
def _copy(source, target):
    for i in range(target.shape[0]):
        store(target, i, 0, load(source, i, 0))


@inlined
def _scale(p, factor, q):
    """Q = factor P"""
    for i in range(p.shape[0]):
        store(q, i, 0, mul(load(p, i, 0), splat(factor)))


@inlined
def _step(z, p, share, q):
    """Q = Z P + share I"""
    for i in range(z.shape[0]):
        store(q, i, 0, add(_row(z, i, p), with_entry(splat(-0.0), i, share)))  # x - 0 is x, of either sign


@inlined
def _norm(z):
    """The largest sum of magnitudes in a column."""
    n, norm = z.shape[0], 0.0
    for j in range(n):
        column = abs(z[0, j])
        for i in range(1, n):
            column += abs(z[i, j])
        norm = max(norm, column)
    return norm


@inlined
def phi_functions(z, p0, p1, p2, p3):
    """Write phi_0(Z) .. phi_3(Z) by scaling, Taylor series and doubling; each (n, 8), as Z, n <= 4.

    Doubling formulas: Skaflestad & Wright, The scaling and modified squaring method for matrix functions
    related to the exponential, Applied Numerical Mathematics 59 (2009).
    """
    n, scaled, spare = z.shape[0], _rows()[: z.shape[0]], _rows()[: z.shape[0]]
    norm, halvings = _norm(z), 0
    while norm > 0.5 and halvings < MOST_HALVINGS:
        norm *= 0.5
        halvings += 1
    inverse_factorial, share = 1.0, splat(two_to(-halvings))
    for k in range(2, TERMS + 4):
        inverse_factorial /= k
    for i in range(n):
        store(scaled, i, 0, mul(share, load(z, i, 0)))
        store(p3, i, 0, with_entry(splat(0.0), i, inverse_factorial))
    for k in range(TERMS + 3, 3, -1):
        inverse_factorial *= k
        _step(scaled, p3, inverse_factorial, spare)
        _copy(spare, p3)
    _step(scaled, p3, 0.5, p2)
    _step(scaled, p2, 1.0, p1)
    _step(scaled, p1, 1.0, p0)
    twos = splat(2.0)
    for _ in range(halvings):
        for i in range(n):
            row = add(add(_row(p1, i, p2), load(p2, i, 0)), mul(load(p3, i, 0), twos))
            store(p3, i, 0, mul(row, splat(0.125)))
        for i in range(n):
            row = add(_row(p1, i, p1), mul(load(p2, i, 0), twos))
            store(p2, i, 0, mul(row, splat(0.25)))
        for i in range(n):
            store(spare, i, 0, mul(add(_row(p0, i, p1), load(p1, i, 0)), splat(0.5)))
        _copy(spare, p1)
        for i in range(n):
            store(spare, i, 0, _row(p0, i, p0))
        _copy(spare, p0)


@inlined
def integrals(m, time, s0, s1, s2, s3):
    """Write S_k = t^k phi_k(M t), k = 0 .. 3: exp(M t), its integral over a time t (s), the next one and the next.

    What dq/dt = M q + n u is after that time under a constant u is S_0 q + S_1 n u; its integral over the time is
    S_1 q + S_2 n u, and so on. Matrices (n, 8), n <= 4.
    """
    z = _rows()[: m.shape[0]]
    _scale(m, time, z)
    phi_functions(z, s0, s1, s2, s3)
    _scale(s1, time, s1)
    _scale(s2, time * time, s2)
    _scale(s3, time * time * time, s3)


@inlined
def apply(p, x, y):
    """y = P x, each (n,)"""
    for i in range(p.shape[0]):
        y[i] = 0.0
        for j in range(p.shape[0]):
            y[i] += p[i, j] * x[j]

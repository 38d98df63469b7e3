"""The inverses of E and of its Cholesky factor; the minimiser without rows."""

from __future__ import annotations

import math

from ..kernel import cube, exported, float64, inlined, int64, matrix, several
from ..maths.exact import sqrt
from ..maths.vectors import (
    VECTOR_WIDTH,
    fma8,
    keep_first,
    load,
    mul,
    padded,
    splat,
    spread,
    store,
    sub,
    with_entry,
    zeros,
)
from .operations import CORRECTED, MAX_REFINEMENTS, UNIT_ROUNDING, advance, exact_stationarity, trace
from .problem import INVERSE, NON_FINITE, NOT_CONVEX, SOLVED

CONDITION_LIMIT = 1e15
"""E is called singular beyond this bound on its condition number."""


@inlined
def _refusal(n, E):
    """Why a pivot is not positive."""
    for i in range(n):
        for j in range(n):
            if not math.isfinite(E[i, j]):
                return NON_FINITE
    return NOT_CONVEX


@inlined
def _eliminate(n, k, inverse):
    """Every row i != k: row_i -= (a_ik / pivot) row_k; a_ik itself becomes -a_ik / pivot, so its block comes last."""
    reciprocal = 1.0 / inverse[k, k]
    scale = splat(-reciprocal)
    middle = (k // VECTOR_WIDTH) * VECTOR_WIDTH
    for b in range(0, padded(n), VECTOR_WIDTH):
        if b != middle:
            row = mul(scale, load(inverse, k, b))
            for i in range(n):
                store(inverse, i, b, fma8(spread(inverse, i, k), row, load(inverse, i, b)))
            store(inverse, k, b, sub(zeros(), row))
    row = with_entry(mul(scale, load(inverse, k, middle)), k - middle, -reciprocal)
    for i in range(n):
        remaining = with_entry(load(inverse, i, middle), k - middle, 0.0)
        store(inverse, i, middle, fma8(spread(inverse, i, k), row, remaining))
    store(inverse, k, middle, sub(zeros(), row))


@exported(several(int64, float64)(int64, matrix, cube))
def factorise(n, E, factor):
    """Write the planes `INVERSE`: L^-1 (lower triangular, E = L L') and E^-1; returns (status, condition).

    Gauss-Jordan elimination of [E | I] in place, without pivoting: E^-1 is left, and row k of the right half, at the
    moment when it becomes the pivot row, is row k of L1^-1 in E = L1 D L1', so L^-1 = D^-1/2 L1^-1.
    ``condition`` = trace(E) trace(E^-1), between cond(E) and n^2 cond(E).
    Status: SOLVED; NOT_CONVEX when a pivot is not positive or ``condition`` exceeds `CONDITION_LIMIT`;
    NON_FINITE when E holds NaN or infinity.
    """
    width = padded(n)
    inverse_root, inverse = factor[INVERSE.root], factor[INVERSE.inverse]
    for i in range(n):
        for b in range(0, width, VECTOR_WIDTH):
            store(inverse, i, b, load(E, i, b))
    for k in range(n):
        pivot = inverse[k, k]
        if not 0.0 < pivot < math.inf:
            return _refusal(n, E), math.inf
        root = splat(sqrt(1.0 / pivot))
        for b in range(0, width, VECTOR_WIDTH):
            row = with_entry(keep_first(load(inverse, k, b), k - b), k - b, 1.0)
            store(inverse_root, k, b, mul(root, row))
        _eliminate(n, k, inverse)
    condition = trace(n, E) * trace(n, inverse)
    if not condition < CONDITION_LIMIT:
        return NOT_CONVEX, condition
    return SOLVED, condition


@inlined
def unconstrained(problem, factor, x, w):
    """``x = -E^-1 K``, refined (see Accuracy in `problem`); returns whether it is finite (not when K is not)."""
    n = problem.n
    width = padded(n)
    for b in range(0, width, VECTOR_WIDTH):
        store(x, b, zeros())
        s = zeros()
        for k in range(n):
            s = fma8(spread(problem.K, k), load(factor.inverse, k, b), s)
        store(w.step, b, keep_first(sub(zeros(), s), n - b))
    _, size, finite = advance(n, x, w.step)
    error = UNIT_ROUNDING * factor.condition * size
    for _ in range(MAX_REFINEMENTS):
        if not error > CORRECTED * max(1.0, size):
            break
        exact_stationarity(problem, 0, x, w)
        for b in range(0, width, VECTOR_WIDTH):
            s = zeros()
            for k in range(n):
                s = fma8(spread(w.residual, k), load(factor.inverse, k, b), s)
            store(w.step, b, keep_first(s, n - b))
        moved, size, finite = advance(n, x, w.step)
        error = UNIT_ROUNDING * factor.condition * moved
    return finite

"""What the methods share: sizes, the residual of stationarity, the slack of the rows, one step of x."""

from __future__ import annotations

import math

from ..kernel import inlined
from ..maths.vectors import (
    VECTOR_WIDTH,
    add,
    all_below_infinity,
    fma8,
    keep_last,
    larger,
    largest,
    load,
    mul,
    padded,
    splat,
    spread,
    store,
    sub,
    zeros,
)

CORRECTED = 1e-9
"""Refinement stops when the next correction of x would be below this part of max(1, |x|)."""
MAX_REFINEMENTS = 6
UNIT_ROUNDING = 2.0**-52


@inlined
def magnitude(a):
    """|a|, entry by entry."""
    return larger(a, sub(zeros(), a))


@inlined
def largest_magnitude(n, x):
    """max |x|."""
    size = zeros()
    for b in range(0, padded(n), VECTOR_WIDTH):
        size = larger(magnitude(load(x, b)), size)
    return largest(size)


@inlined
def trace(n, A):
    """The sum of the diagonal."""
    sum_of_diagonal = 0.0
    for i in range(n):
        sum_of_diagonal += A[i, i]
    return sum_of_diagonal


@inlined
def advance(n, x, step):
    """x += step; returns (max |step|, max |x|, whether x is finite)."""
    moved = zeros()
    size = zeros()
    finite = True
    for b in range(0, padded(n), VECTOR_WIDTH):
        change = load(step, b)
        new = add(load(x, b), change)
        store(x, b, new)
        moved = larger(magnitude(change), moved)
        size = larger(magnitude(new), size)
        finite &= all_below_infinity(magnitude(new))
    return largest(moved), largest(size), finite


@inlined
def stationarity(problem, q, x, w):
    """``w.residual = -(E x + K + N u)``, N the first q rows of ``w.normals``."""
    for b in range(0, padded(problem.n), VECTOR_WIDTH):
        s = load(problem.K, b)
        for k in range(problem.n):
            s = fma8(spread(x, k), load(problem.E, k, b), s)
        for k in range(q):
            s = fma8(spread(w.u, k), load(w.normals, k, b), s)
        store(w.residual, b, sub(zeros(), s))


@inlined
def exact_stationarity(problem, q, x, w):
    """Compute the gradient of the Lagrangian in twice the working precision."""
    for b in range(0, padded(problem.n), VECTOR_WIDTH):
        high = load(problem.K, b)
        low = zeros()
        for k in range(problem.n + q):
            if k < problem.n:
                row = load(problem.E, k, b)
                factor = spread(x, k)
            else:
                row = load(w.normals, k - problem.n, b)
                factor = spread(w.u, k - problem.n)
            product = mul(row, factor)
            remainder = fma8(row, factor, sub(zeros(), product))  # product + rest = row * factor exactly
            s = add(high, product)
            t = sub(s, high)
            low = add(low, add(add(sub(high, sub(s, t)), sub(product, t)), remainder))  # the rounding error of s
            high = s
        store(w.residual, b, sub(zeros(), add(high, low)))


@inlined
def find_gaps(problem, x, w):
    """``w.slack = M x - w.bounds``, positive where a row is violated; returns (largest, all finite)."""
    worst = splat(-math.inf)
    finite = True
    for b in range(0, padded(problem.m), VECTOR_WIDTH):
        image = zeros()
        for k in range(problem.n):
            image = fma8(spread(x, k), load(problem.Mt, k, b), image)
        s = sub(image, load(w.bounds, b))
        store(w.slack, b, s)
        worst = larger(s, worst)
        finite &= all_below_infinity(s) & all_below_infinity(magnitude(image))
    return largest(worst), finite


@inlined
def copy_bounds(problem, w):
    """``w.bounds = gamma``, and +inf in the padding."""
    for b in range(0, padded(problem.m), VECTOR_WIDTH):
        absent = keep_last(splat(math.inf), problem.m - b)
        store(w.bounds, b, add(load(problem.gamma, b), absent))

"""The active rows N of the dual active-set method, their factor and what is solved with it.

In the coordinates T, T E T' = I and T N = [R; 0] with the leading q rows T1 and the rest T2; R^-1 is kept explicitly.
T is updated by one Householder reflection (1958) per change of the active rows.
"""

from __future__ import annotations

import math

from ..kernel import inlined
from ..maths.exact import sqrt
from ..maths.vectors import (
    VECTOR_WIDTH,
    add,
    all_below_infinity,
    column,
    fma8,
    keep_first,
    keep_last,
    load,
    mul,
    padded,
    splat,
    spread,
    store,
    sub,
    total,
    totals,
    with_entry,
    zeros,
)
from .operations import advance, magnitude


@inlined
def set_entry(v, i, value):
    """``v[i] = value``, as eight entries: a lone number would make the next vector load wait."""
    b = i // VECTOR_WIDTH * VECTOR_WIDTH
    store(v, b, with_entry(load(v, b), i - b, value))


@inlined
def _four(A, i, v, width):
    """Rows i..i+3 of A times v, each as eight sums: more at once do not fit in the registers of AVX2."""
    s0 = s1 = s2 = s3 = zeros()
    for c in range(0, width, VECTOR_WIDTH):
        entries = load(v, c)
        s0 = fma8(load(A, i, c), entries, s0)
        s1 = fma8(load(A, i + 1, c), entries, s1)
        s2 = fma8(load(A, i + 2, c), entries, s2)
        s3 = fma8(load(A, i + 3, c), entries, s3)
    return s0, s1, s2, s3


@inlined
def _dots(count, A, v, width, out):
    """``out[i]`` = row i of A times v for i < count, else 0."""
    for b in range(0, width, VECTOR_WIDTH):
        sums = _four(A, b, v, width) + _four(A, b + 4, v, width)
        store(out, b, keep_first(totals(sums), count - b))


@inlined
def _combine(first, last, weights, A, b):
    """Entries b..b+7 of ``sum_i weights_i (row i of A)``, first <= i < last."""
    s = zeros()
    for i in range(first, last):
        s = fma8(spread(weights, i), load(A, i, b), s)
    return s


@inlined
def release_all(n, factor, w):
    """T = L^-1, no row active."""
    for b in range(0, padded(n), VECTOR_WIDTH):
        for i in range(n):
            store(w.T, i, b, load(factor.inverse_root, i, b))
        store(w.u, b, zeros())


@inlined
def take_row(problem, row, w):
    """a = the row of M; returns a'a."""
    squares = zeros()
    for b in range(0, padded(problem.n), VECTOR_WIDTH):
        a = column(problem.Mt, problem.n, b, row)
        store(w.a, b, a)
        squares = fma8(a, a, squares)
    return total(squares)


@inlined
def find_directions(n, q, w):
    """d = T a, z = T2' d2, r = R^-1 d1; returns d2'd2."""
    width = padded(n)
    _dots(n, w.T, w.a, width, w.d)
    squares = zeros()
    for b in range(0, width, VECTOR_WIDTH):
        d2 = keep_last(load(w.d, b), q - b)
        squares = fma8(d2, d2, squares)
        store(w.r, b, _combine(0, q, w.d, w.inverse_r, b))
        store(w.z, b, _combine(q, n, w.d, w.T, b))
    return total(squares)


@inlined
def activate(problem, q, row, square, multiplier, w):
    """``row`` joins as the last active one. At hand: a and its directions; ``square`` = d2'd2.

    A reflection of T2 maps d2 onto its first coordinate, rho; R^-1 gains the column (-r, 1)/rho.
    """
    n = problem.n
    norm = sqrt(square)
    head = w.d[q]
    rho = -math.copysign(norm, head)
    w.d[q] = head - rho
    beta = splat(-1.0 / (norm * (norm + abs(head))))
    scale = splat(-1.0 / rho)
    for b in range(0, padded(n), VECTOR_WIDTH):
        v = mul(beta, fma8(splat(-rho), load(w.T, q, b), load(w.z, b)))
        for i in range(q, n):
            store(w.T, i, b, fma8(spread(w.d, i), v, load(w.T, i, b)))
        minus_r = mul(scale, load(w.r, b))
        store(w.inverse_r, q, b, with_entry(minus_r, q - b, 1.0 / rho))
        store(w.normals, q, b, load(w.a, b))
    set_entry(w.active_bounds, q, problem.gamma[row])
    set_entry(w.u, q, multiplier)
    w.index[q] = row


@inlined
def _reflect(q, beta, v, A, b):
    """Entries b..b+7 of the first q rows of A: ``A += beta v (v'A)``."""
    image = mul(beta, _combine(0, q, v, A, b))
    for i in range(q):
        store(A, i, b, fma8(spread(v, i), image, load(A, i, b)))


@inlined
def release(n, q, place, w):
    """The active row at ``place`` leaves and the last active row takes its place; returns q - 1.

    A reflection of T1 turns its multiplier's row of R^-1 onto the last coordinate, which then belongs to T2.
    """
    width = padded(n)
    last = q - 1
    square = 0.0
    for c in range(q):
        h = w.inverse_r[c, place]
        w.step[c] = h
        square += h * h
    norm = sqrt(square)
    head = w.step[last]
    w.step[last] = head + math.copysign(norm, head)
    beta = splat(-1.0 / (norm * (norm + abs(head))))
    for b in range(0, width, VECTOR_WIDTH):
        _reflect(q, beta, w.step, w.T, b)
        _reflect(q, beta, w.step, w.inverse_r, b)
    for c in range(last):
        moved = w.inverse_r[c, last]
        for b in range(0, width, VECTOR_WIDTH):
            entry = with_entry(load(w.inverse_r, c, b), place - b, moved)
            store(w.inverse_r, c, b, with_entry(entry, last - b, 0.0))
    for b in range(0, width, VECTOR_WIDTH):
        store(w.normals, place, b, load(w.normals, last, b))
    set_entry(w.bounds, w.index[place], w.active_bounds[place])
    set_entry(w.active_bounds, place, w.active_bounds[last])
    set_entry(w.u, place, w.u[last])
    w.index[place] = w.index[last]
    return last


@inlined
def _find_misses(n, q, x, w, from_zero):
    """``r = gamma_A - N'x``, by how much the active rows are missed."""
    width = padded(n)
    if from_zero:
        for b in range(0, width, VECTOR_WIDTH):
            store(w.r, b, keep_first(load(w.active_bounds, b), q - b))
    else:
        _dots(q, w.normals, x, width, w.z)
        for b in range(0, width, VECTOR_WIDTH):
            store(w.r, b, keep_first(sub(load(w.active_bounds, b), load(w.z, b)), q - b))


@inlined
def newton(n, q, x, w, from_zero):
    """One Newton step on the equations of the active rows, for the residual at hand, from x = 0, u = 0 or (x, u).

        [E  N] [dx]   [-(K + E x + N u)]            dx = T' [y; c2],    y = R^-T (gamma_A - N'x),
        [N' 0] [du] = [gamma_A - N'x   ],           du = R^-1 (c1 - y), c = T (-(K + E x + N u)).

    Returns (max |dx|, max |x|, whether x and u are finite).
    """
    width = padded(n)
    _find_misses(n, q, x, w, from_zero)
    _dots(q, w.inverse_r, w.r, width, w.z)
    _dots(n, w.T, w.residual, width, w.d)
    for b in range(0, width, VECTOR_WIDTH):
        y = load(w.z, b)
        c = load(w.d, b)
        store(w.z, b, add(y, keep_last(c, q - b)))
        store(w.d, b, sub(c, y))
    finite = True
    for b in range(0, width, VECTOR_WIDTH):
        store(w.step, b, _combine(0, n, w.z, w.T, b))
        u = _combine(0, q, w.d, w.inverse_r, b)
        if from_zero:
            store(x, b, zeros())
        else:
            u = add(load(w.u, b), u)
        store(w.u, b, u)
        finite &= all_below_infinity(magnitude(keep_first(u, q - b)))
    moved, size, finite_x = advance(n, x, w.step)
    return moved, size, finite and finite_x


@inlined
def worst_multiplier(q, w):
    """(place, gap) of the active row with a negative multiplier whose release opens the widest gap; (-1, 0) if none.

    Without row i its slack would become -u_i / ((N'E^-1 N)^-1)_ii = -u_i / sum_c R^-1[i, c]^2.
    """
    place = -1
    widest = 0.0
    for i in range(q):
        u = w.u[i]
        if u < 0.0:
            square = 0.0
            for c in range(q):
                square += w.inverse_r[c, i] * w.inverse_r[c, i]
            gap = -u / square
            if gap > widest:
                place = i
                widest = gap
    return place, widest

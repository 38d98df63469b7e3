"""Strictly convex quadratic programmes, in the letters of the paper (eq. 17):

    minimise  1/2 x'E x + x'K   subject to   M x <= gamma,      E symmetric positive definite, n x n.

`factorise` (once for as long as E stays), then one of
`unconstrained`, the minimiser without rows; `active_set`, the exact solution; `hildreth`, the paper's procedure;
and `kkt_residual`, how optimal a pair (x, lam) is. Each returns a status.

Arrays
------
M is stored transposed: column j of ``Mt`` (n x m) is row j of M. Every array is C-contiguous float64 (``index``:
int64) and belongs to the caller; nothing is allocated here. Only the leading n (or m) entries count, but the length
of every row and vector is a multiple of 8 (`padded`). What stands in the padding is never part of a result, but it
must be finite (allocate with `aligned`, or zeros); ``lam`` comes back with zeros there. ``gamma[j] = inf`` says that
row j is absent.

``E (>=n, padded n)  K, x (padded n)  Mt (>=n, padded m)  gamma, lam (padded m)``; ``factor``, ``work``, ``rows`` and
``index`` have the shapes that `workspace_sizes` gives. Only ``factor`` (and, for a warm Hildreth, ``lam``) carries
anything from one call to the next.

Accuracy
--------
E may have a condition number up to 1e12 or so: double precision then loses five digits or more in every
solve. The residual E x + K + M'lam is therefore accumulated in twice the working precision (Dekker 1971; Ogita, Rump
and Oishi 2005, algorithm 4.3) and x is corrected with it until the correction is below 1e-9: the result is the
solution *for the given float64 data* to nearly full precision. With the compiler switched off the fused multiply-add
rounds twice, and the accuracy is that of plain double precision.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import boolean, types

from .abi import INLINE, ROUTINE, cube, float64, int64, int_vector, matrix, njit, vector
from .maths.vectors import (
    LANES,
    add,
    all_below_infinity,
    column,
    div,
    first_equal,
    first_lanes,
    fma8,
    larger,
    largest,
    last_lanes,
    lesser,
    load,
    mul,
    padded,
    smallest,
    splat,
    spread,
    store,
    sub,
    total,
    totals,
    where_positive,
    with_lane,
    zeros,
)

SOLVED = 0
CAPPED = 1
INFEASIBLE = 2
NOT_CONVEX = 3
NON_FINITE = 4

HILDRETH_SWEEPS = 38
"""Sweeps after which the authors' procedure stops."""
HILDRETH_TOLERANCE = 1e-7
"""The authors' procedure stops when a sweep changes the multipliers by less than this, squared and summed."""

CERTIFIED = 1e-9
"""Hildreth's result counts as solved when the rows hold to this part of 1 + |gamma_j|."""

CONDITION_LIMIT = 1e15
"""E is called singular beyond this bound on its condition number."""
VIOLATION = 1e-12
"""A row is violated when M_j x - gamma_j exceeds this part of |gamma_j| + sum |M_jk x_k| + NOISE |M_j| |x|."""
NOISE = 1e-2
DEPENDENT = 1e-12
"""A row depends on the active ones when this part of its length, measured by E^-1, is all that is new."""
CONTRADICTION = 1e-9
"""Dependent rows contradict each other when they miss by more than this part of their bounds."""
CORRECTED = 1e-9
"""Refinement stops when the next correction of x would be below this part of max(1, |x|)."""
REFINEMENTS = 6
ROUNDING = 2.0**-52

_ROTATED, _INVERSE_R, _NORMALS, _VECTORS = 0, 1, 2, 3  # the planes of `work`
_A, _D, _Z, _R, _U, _RESIDUAL, _STEP, _GAMMA, _RATIO = range(9)  # the rows of its plane of vectors
_SLACK, _BOUND, _DIAGONAL, _GRADIENT, _IMAGE = 0, 1, 2, 3, 4  # the rows of `rows`; V and H follow


def workspace_sizes(n_max: int, m_max: int, hildreth: bool = True) -> dict[str, tuple[int, ...]]:
    """Shapes of ``factor``, ``work``, ``rows`` and ``index`` for up to ``n_max`` variables and ``m_max`` rows.

    ``hildreth=False`` leaves out the m_max x m_max matrix H, which only `hildreth` needs.
    """
    width = padded(n_max)
    return {
        "factor": (2, n_max, width),
        "work": (4, max(width, 9), width),
        "rows": (_IMAGE + (n_max + m_max if hildreth else 0), padded(m_max)),
        "index": (max(n_max, m_max),),
    }


def aligned(shape: tuple[int, ...], dtype: Any = np.float64) -> Any:
    """A zeroed array that starts on a cache line: loads of eight numbers then touch one line, not two."""
    size = math.prod(shape)
    raw = np.zeros(size + LANES, dtype=dtype)
    start = (-raw.ctypes.data // raw.itemsize) % LANES
    return raw[start : start + size].reshape(shape)


@njit(types.Tuple((int64, float64))(int64, matrix, cube), **ROUTINE)
def factorise(n, E, factor):
    """``factor[0] = L^-1`` (lower triangular, E = L L') and ``factor[1] = E^-1``; returns (status, condition).

    Gauss-Jordan elimination of [E | I] in place, without pivoting: E^-1 is left, and row k of the right half, at the
    moment when it becomes the pivot row, is row k of L1^-1 in E = L1 D L1', so L^-1 = D^-1/2 L1^-1.
    ``condition`` = trace(E) trace(E^-1), between cond(E) and n^2 cond(E).
    Status: SOLVED; NOT_CONVEX when a pivot is not positive or ``condition`` exceeds `CONDITION_LIMIT`;
    NON_FINITE when E holds NaN or infinity.
    """
    width = padded(n)
    for i in range(n):
        for b in range(0, width, LANES):
            store(factor, 1, i, b, load(E, i, b))
    for k in range(n):
        pivot = factor[1, k, k]
        if not 0.0 < pivot < math.inf:
            for i in range(n):
                for j in range(n):
                    if not math.isfinite(E[i, j]):
                        return NON_FINITE, math.inf
            return NOT_CONVEX, math.inf
        reciprocal = 1.0 / pivot
        root = splat(math.sqrt(reciprocal))
        for b in range(0, width, LANES):
            row = with_lane(first_lanes(load(factor, 1, k, b), k - b), k - b, 1.0)
            store(factor, 0, k, b, mul(root, row))
        # Every row i != k: row_i -= (a_ik / pivot) row_k; a_ik itself becomes -a_ik / pivot, so its lanes come last.
        scale = splat(-reciprocal)
        middle = (k // LANES) * LANES
        for b in range(0, width, LANES):
            if b != middle:
                row = mul(scale, load(factor, 1, k, b))
                for i in range(n):
                    store(factor, 1, i, b, fma8(spread(factor, 1, i, k), row, load(factor, 1, i, b)))
                store(factor, 1, k, b, sub(zeros(), row))
        row = with_lane(mul(scale, load(factor, 1, k, middle)), k - middle, -reciprocal)
        for i in range(n):
            rest = with_lane(load(factor, 1, i, middle), k - middle, 0.0)
            store(factor, 1, i, middle, fma8(spread(factor, 1, i, k), row, rest))
        store(factor, 1, k, middle, sub(zeros(), row))
    trace = 0.0
    inverse_trace = 0.0
    for i in range(n):
        trace += E[i, i]
        inverse_trace += factor[1, i, i]
    condition = trace * inverse_trace
    if not condition < CONDITION_LIMIT:
        return NOT_CONVEX, condition
    return SOLVED, condition


@njit(**INLINE)
def _residual(n, q, E, K, x, work, exactly):
    """``work[_VECTORS, _RESIDUAL] = -(K + E x + N u)``; `exactly`: accumulated in twice the working precision."""
    if not exactly:
        for b in range(0, padded(n), LANES):
            s = load(K, b)
            for k in range(n):
                s = fma8(spread(x, k), load(E, k, b), s)
            for k in range(q):
                s = fma8(spread(work, _VECTORS, _U, k), load(work, _NORMALS, k, b), s)
            store(work, _VECTORS, _RESIDUAL, b, sub(zeros(), s))
        return
    for b in range(0, padded(n), LANES):
        high = load(K, b)
        low = zeros()
        for k in range(n + q):
            if k < n:
                row = load(E, k, b)
                factor = spread(x, k)
            else:
                row = load(work, _NORMALS, k - n, b)
                factor = spread(work, _VECTORS, _U, k - n)
            product = mul(row, factor)
            rest = fma8(row, factor, sub(zeros(), product))  # product + rest = row * factor exactly
            s = add(high, product)
            t = sub(s, high)
            low = add(low, add(add(sub(high, sub(s, t)), sub(product, t)), rest))  # what s has lost
            high = s
        store(work, _VECTORS, _RESIDUAL, b, sub(zeros(), add(high, low)))


@njit(**INLINE)
def _magnitude(a):
    return larger(a, sub(zeros(), a))


@njit(**INLINE)
def _size(n, x):
    """max |x|."""
    size = zeros()
    for b in range(0, padded(n), LANES):
        size = larger(_magnitude(load(x, b)), size)
    return largest(size)


@njit(**INLINE)
def _advance(n, x, work):
    """x += step; returns (max |step|, max |x|, whether x is finite)."""
    moved = zeros()
    size = zeros()
    finite = True
    for b in range(0, padded(n), LANES):
        step = load(work, _VECTORS, _STEP, b)
        new = add(load(x, b), step)
        store(x, b, new)
        moved = larger(_magnitude(step), moved)
        size = larger(_magnitude(new), size)
        finite &= all_below_infinity(_magnitude(new))
    return largest(moved), largest(size), finite


@njit(**INLINE)
def _unconstrained(n, E, K, factor, condition, x, work):
    width = padded(n)
    for b in range(0, width, LANES):
        store(x, b, zeros())
        s = zeros()
        for k in range(n):
            s = fma8(spread(K, k), load(factor, 1, k, b), s)
        store(work, _VECTORS, _STEP, b, first_lanes(sub(zeros(), s), n - b))
    moved, size, finite = _advance(n, x, work)
    error = ROUNDING * condition * size
    for _ in range(REFINEMENTS):
        if not error > CORRECTED * max(1.0, size):
            break
        _residual(n, 0, E, K, x, work, True)
        for b in range(0, width, LANES):
            s = zeros()
            for k in range(n):
                s = fma8(spread(work, _VECTORS, _RESIDUAL, k), load(factor, 1, k, b), s)
            store(work, _VECTORS, _STEP, b, first_lanes(s, n - b))
        moved, size, finite = _advance(n, x, work)
        error = ROUNDING * condition * moved
    return SOLVED if finite else NON_FINITE


@njit(int64(int64, matrix, vector, cube, float64, vector, cube), **ROUTINE)
def unconstrained(n, E, K, factor, condition, x, work):
    """``x = -E^-1 K``, the minimiser without constraints, refined (see Accuracy above).

    Status: SOLVED, or NON_FINITE when K (or E) holds NaN or infinity.
    """
    return _unconstrained(n, E, K, factor, condition, x, work)


@njit(**INLINE)
def _gaps(n, m, Mt, rows, x):
    """``rows[_SLACK] = M x - rows[_BOUND]``, positive where a row is violated; returns (largest, all finite)."""
    worst = splat(-math.inf)
    finite = True
    for b in range(0, padded(m), LANES):
        image = zeros()
        for k in range(n):
            image = fma8(spread(x, k), load(Mt, k, b), image)
        s = sub(image, load(rows, _BOUND, b))
        store(rows, _SLACK, b, s)
        worst = larger(s, worst)
        finite &= all_below_infinity(s) & all_below_infinity(_magnitude(image))
    return largest(worst), finite


@njit(**INLINE)
def _row_with(value, m, rows):
    """The first row whose slack equals ``value`` (there is one)."""
    row = 0
    for b in range(padded(m) - LANES, -1, -LANES):
        lane = first_equal(load(rows, _SLACK, b), value)
        row = b + lane if lane < LANES else row
    return row


@njit(**INLINE)
def _copy_bounds(m, gamma, rows):
    """``rows[_BOUND] = gamma``, and +inf in the padding."""
    for b in range(0, padded(m), LANES):
        store(rows, _BOUND, b, add(load(gamma, b), last_lanes(splat(math.inf), m - b)))


@njit(**INLINE)
def _dots(count, plane, source, target, width, work):
    """``work[_VECTORS, target, i]`` = row i of ``work[plane]`` times ``work[_VECTORS, source]``, i < count; else 0."""
    for b in range(0, width, LANES):
        s0 = s1 = s2 = s3 = s4 = s5 = s6 = s7 = zeros()
        for c in range(0, width, LANES):
            v = load(work, _VECTORS, source, c)
            s0 = fma8(load(work, plane, b, c), v, s0)
            s1 = fma8(load(work, plane, b + 1, c), v, s1)
            s2 = fma8(load(work, plane, b + 2, c), v, s2)
            s3 = fma8(load(work, plane, b + 3, c), v, s3)
            s4 = fma8(load(work, plane, b + 4, c), v, s4)
            s5 = fma8(load(work, plane, b + 5, c), v, s5)
            s6 = fma8(load(work, plane, b + 6, c), v, s6)
            s7 = fma8(load(work, plane, b + 7, c), v, s7)
        store(work, _VECTORS, target, b, first_lanes(totals(s0, s1, s2, s3, s4, s5, s6, s7), count - b))


@njit(**INLINE)
def _combine(first, last, weights, plane, b, work):
    """Lanes b..b+7 of ``sum_i weights_i (row i of work[plane])``, first <= i < last."""
    s = zeros()
    for i in range(first, last):
        s = fma8(spread(work, _VECTORS, weights, i), load(work, plane, i, b), s)
    return s


@njit(**INLINE)
def _set_vector(row, i, value, work):
    """``work[_VECTORS, row, i] = value``, as eight lanes: a lone number would make the next vector load wait."""
    b = i // LANES * LANES
    store(work, _VECTORS, row, b, with_lane(load(work, _VECTORS, row, b), i - b, value))


@njit(**INLINE)
def _set_bound(j, value, rows):
    """``rows[_BOUND, j] = value``, as eight lanes."""
    b = j // LANES * LANES
    store(rows, _BOUND, b, with_lane(load(rows, _BOUND, b), j - b, value))


@njit(**INLINE)
def _activate(n, q, p, bound, square, multiplier, work, index):
    """Row p joins the active set. At hand: a, d = T a, z = T2' d2, r = R^-1 d1; ``square`` = d2'd2.

    A reflection (Householder 1958) of T2 maps d2 onto its first coordinate, rho; R^-1 gains the column (-r, 1)/rho.
    """
    width = padded(n)
    norm = math.sqrt(square)
    head = work[_VECTORS, _D, q]
    rho = -math.copysign(norm, head)
    work[_VECTORS, _D, q] = head - rho
    beta = splat(-1.0 / (norm * (norm + abs(head))))
    scale = splat(-1.0 / rho)
    for b in range(0, width, LANES):
        w = fma8(splat(-rho), load(work, _ROTATED, q, b), load(work, _VECTORS, _Z, b))
        w = mul(beta, w)
        for i in range(q, n):
            store(work, _ROTATED, i, b, fma8(spread(work, _VECTORS, _D, i), w, load(work, _ROTATED, i, b)))
        minus_r = mul(scale, load(work, _VECTORS, _R, b))
        store(work, _INVERSE_R, q, b, with_lane(minus_r, q - b, 1.0 / rho))
        store(work, _NORMALS, q, b, load(work, _VECTORS, _A, b))
    _set_vector(_GAMMA, q, bound, work)
    _set_vector(_U, q, multiplier, work)
    index[q] = p


@njit(**INLINE)
def _release(n, q, place, work, rows, index):
    """The active row at ``place`` leaves and the last active row takes its place; returns q - 1.

    A reflection of T1 turns its multiplier's row of R^-1 onto the last coordinate, which then belongs to T2.
    """
    width = padded(n)
    last = q - 1
    square = 0.0
    for c in range(q):
        h = work[_INVERSE_R, c, place]
        work[_VECTORS, _STEP, c] = h
        square += h * h
    norm = math.sqrt(square)
    head = work[_VECTORS, _STEP, last]
    work[_VECTORS, _STEP, last] = head + math.copysign(norm, head)
    beta = splat(-1.0 / (norm * (norm + abs(head))))
    for b in range(0, width, LANES):
        for plane in (_ROTATED, _INVERSE_R):
            w = mul(beta, _combine(0, q, _STEP, plane, b, work))
            for i in range(q):
                store(work, plane, i, b, fma8(spread(work, _VECTORS, _STEP, i), w, load(work, plane, i, b)))
    for c in range(last):
        moved = work[_INVERSE_R, c, last]
        for b in range(0, width, LANES):
            kept = with_lane(load(work, _INVERSE_R, c, b), place - b, moved)
            store(work, _INVERSE_R, c, b, with_lane(kept, last - b, 0.0))
    for b in range(0, width, LANES):
        store(work, _NORMALS, place, b, load(work, _NORMALS, last, b))
    _set_bound(index[place], work[_VECTORS, _GAMMA, place], rows)
    _set_vector(_GAMMA, place, work[_VECTORS, _GAMMA, last], work)
    _set_vector(_U, place, work[_VECTORS, _U, last], work)
    index[place] = index[last]
    return last


@njit(**INLINE)
def _newton(n, q, x, work, from_zero):
    """One Newton step on the equations of the active set, for the residual at hand; from x = 0, u = 0 or from (x, u).

        [E  N] [dx]   [-(K + E x + N u)]            dx = T' [y; c2],    y = R^-T (gamma_A - N'x),
        [N' 0] [du] = [gamma_A - N'x   ],           du = R^-1 (c1 - y), c = T (-(K + E x + N u)).

    Returns (max |dx|, max |x|, whether x is finite).
    """
    width = padded(n)
    for b in range(0, width, LANES):
        gap = load(work, _VECTORS, _GAMMA, b)
        if not from_zero:
            store(work, _VECTORS, _STEP, b, load(x, b))
        store(work, _VECTORS, _R, b, first_lanes(gap, q - b))
    if not from_zero:
        _dots(q, _NORMALS, _STEP, _Z, width, work)
        for b in range(0, width, LANES):
            gap = sub(load(work, _VECTORS, _R, b), load(work, _VECTORS, _Z, b))
            store(work, _VECTORS, _R, b, first_lanes(gap, q - b))
    _dots(q, _INVERSE_R, _R, _Z, width, work)
    _dots(n, _ROTATED, _RESIDUAL, _D, width, work)
    for b in range(0, width, LANES):
        y = load(work, _VECTORS, _Z, b)
        c = load(work, _VECTORS, _D, b)
        store(work, _VECTORS, _Z, b, add(y, last_lanes(c, q - b)))
        store(work, _VECTORS, _D, b, sub(c, y))
    for b in range(0, width, LANES):
        store(work, _VECTORS, _STEP, b, _combine(0, n, _Z, _ROTATED, b, work))
        change = _combine(0, q, _D, _INVERSE_R, b, work)
        if from_zero:
            store(work, _VECTORS, _U, b, change)
            store(x, b, zeros())
        else:
            store(work, _VECTORS, _U, b, add(load(work, _VECTORS, _U, b), change))
    return _advance(n, x, work)


@njit(**INLINE)
def _polish(n, q, E, K, condition, x, work):
    """Newton steps on the active set, residuals in twice the working precision where the conditioning asks for it.

    Returns whether x is finite.
    """
    finite = True
    for _ in range(REFINEMENTS):
        _residual(n, q, E, K, x, work, ROUNDING * condition > CORRECTED)
        moved, size, finite = _newton(n, q, x, work, False)
        if not ROUNDING * condition * moved > CORRECTED * max(1.0, size):
            break
    return finite


@njit(**INLINE)
def _worst_multiplier(q, work):
    """(place, gap) of the active row with a negative multiplier whose release opens the widest gap; (-1, 0) if none.

    Without row i its slack would become -u_i / ((N'E^-1 N)^-1)_ii = -u_i / sum_c R^-1[i, c]^2.
    """
    place = -1
    widest = 0.0
    for i in range(q):
        u = work[_VECTORS, _U, i]
        if u < 0.0:
            square = 0.0
            for c in range(q):
                square += work[_INVERSE_R, c, i] ** 2
            gap = -u / square
            if gap > widest:
                place = i
                widest = gap
    return place, widest


@njit(**INLINE)
def _unrotate(n, factor, work):
    """T = L^-1, no row active."""
    for b in range(0, padded(n), LANES):
        for i in range(n):
            store(work, _ROTATED, i, b, load(factor, 0, i, b))
        store(work, _VECTORS, _U, b, zeros())


@njit(**INLINE)
def _adopt(n, guess, m, Mt, gamma, inverse_trace, work, rows, index):
    """Make the rows ``index[:guess]`` active one after the other, leaving out what is absent or dependent."""
    width = padded(n)
    q = 0
    for i in range(guess):
        p = index[i]
        if q == n or not (p < m and gamma[p] < math.inf):
            continue
        squares = zeros()
        for b in range(0, width, LANES):
            a = column(Mt, n, b, p)
            store(work, _VECTORS, _A, b, a)
            squares = fma8(a, a, squares)
        length = total(squares)
        _dots(n, _ROTATED, _A, _D, width, work)
        squares = zeros()
        for b in range(0, width, LANES):
            d2 = last_lanes(load(work, _VECTORS, _D, b), q - b)
            squares = fma8(d2, d2, squares)
            store(work, _VECTORS, _R, b, _combine(0, q, _D, _INVERSE_R, b, work))
            store(work, _VECTORS, _Z, b, _combine(q, n, _D, _ROTATED, b, work))
        square = total(squares)
        if not square > DEPENDENT * inverse_trace * length:  # a wide margin: this is only a guess
            continue
        _activate(n, q, p, gamma[p], square, 0.0, work, index)
        q += 1
    return q


@njit(**INLINE)
def _settle(n, q, K, x, work, rows, index):
    """x on the active rows and their multipliers; rows that pull the wrong way leave.

    Then (x, u) is optimal for the active rows alone: a point from which the dual method may start.
    """
    while q > 0:
        for b in range(0, padded(n), LANES):
            store(work, _VECTORS, _RESIDUAL, b, first_lanes(sub(zeros(), load(K, b)), n - b))
        _newton(n, q, x, work, True)
        place, _ = _worst_multiplier(q, work)
        if place < 0:
            break
        q = _release(n, q, place, work, rows, index)
    return q


@njit(
    types.UniTuple(int64, 3)(
        int64, int64, matrix, vector, matrix, vector, cube, float64, vector, vector, cube, matrix, int_vector, int64,
        types.boolean, int64,
    ),
    **ROUTINE,
)  # fmt: skip
def active_set(
    n, m, E, K, Mt, gamma, factor, condition, x, lam, work, rows, index, guess, kept, max_iterations
):  # fmt: skip
    """The exact solution by the dual active-set method (Goldfarb and Idnani 1983); (status, iterations, active rows).

    ``index[:guess]`` names rows that may well be active in the solution (0: none known); the answer does not depend
    on it. ``kept`` says that they are those which the last call returned, for the same E and M, and that ``work``
    is as it left it: their factor is then taken over instead of formed again. On return ``index`` begins with the
    active rows.

    From the unconstrained minimiser, the most violated row p is made active along the direction that keeps the
    active rows N active, as far as the multipliers u of those rows stay non-negative; a row whose multiplier
    reaches zero leaves. In the coordinates T (T E T' = I, T N = [R; 0], so T T' = E^-1 when q = 0):
    d = T a, z = T2' d2 (the step of x per unit of multiplier), r = R^-1 d1 (that of -u). T is updated by one
    Householder reflection per change of the active set, R^-1 explicitly.
    When no row is violated, (x, u) is polished on its active set; rows that then prove violated or superfluous
    are changed, and so on until nothing changes.

    Out: x, lam (multipliers of all rows). ``iterations`` counts steps and is capped by ``max_iterations``.
    Status: SOLVED; CAPPED (x is then the last iterate: not optimal); INFEASIBLE (no x satisfies the rows; x is
    meaningless); NON_FINITE when E, K, M hold NaN or infinity, or gamma NaN or -inf.
    """
    width = padded(n)
    depth = padded(m)
    for b in range(0, depth, LANES):
        store(lam, b, zeros())
    _copy_bounds(m, gamma, rows)
    inverse_trace = 0.0
    for i in range(n):
        inverse_trace += factor[1, i, i]

    q = 0
    if guess > 0:
        for i in range(guess):
            kept = kept and gamma[index[i]] < math.inf
        if kept:
            q = guess
            for i in range(q):
                work[_VECTORS, _GAMMA, i] = gamma[index[i]]
        else:
            _unrotate(n, factor, work)
            q = _adopt(n, guess, m, Mt, gamma, inverse_trace, work, rows, index)
        q = _settle(n, q, K, x, work, rows, index)
    if q > 0:
        for i in range(q):
            _set_bound(index[i], math.inf, rows)
        worst, finite = _gaps(n, m, Mt, rows, x)
        if not finite:
            return NON_FINITE, 0, 0
    else:
        if _unconstrained(n, E, K, factor, condition, x, work) != SOLVED:
            return NON_FINITE, 0, 0
        worst, finite = _gaps(n, m, Mt, rows, x)
        if not finite:
            return NON_FINITE, 0, 0
        if not worst > 0.0:
            return SOLVED, 0, 0
        _unrotate(n, factor, work)
    reach = max(1.0, _size(n, x))  # the numbers that cancel in M x are about as large as this
    floor = 1.0
    iterations = 0
    polished = q == 0
    doubtful = False
    rounds = 0
    tolerance = VIOLATION
    while True:
        # The most violated row, if any.
        p = -1
        bound = 0.0
        length = 0.0
        while worst > 0.0:
            row = _row_with(worst, m, rows)
            squares = zeros()
            sizes = zeros()
            for b in range(0, width, LANES):
                a = column(Mt, n, b, row)
                store(work, _VECTORS, _A, b, a)
                squares = fma8(a, a, squares)
                sizes = add(_magnitude(mul(a, load(x, b))), sizes)
            bound = gamma[row]
            length = total(squares)
            if worst > tolerance * (abs(bound) + total(sizes) + NOISE * math.sqrt(length) * reach):
                p = row
                break
            rows[_SLACK, row] = -math.inf  # satisfied but for rounding
            best = splat(-math.inf)
            for b in range(0, depth, LANES):
                best = larger(load(rows, _SLACK, b), best)
            worst = largest(best)

        if p < 0:
            if polished:
                break
            # No violated row: polish, drop the rows that pull the wrong way, look again.
            while True:
                if not _polish(n, q, E, K, condition, x, work):
                    return NON_FINITE, iterations, 0
                place, gap = _worst_multiplier(q, work)
                if place < 0 or gap <= 10.0 * tolerance:
                    break
                q = _release(n, q, place, work, rows, index)
                iterations += 1
                if iterations > max_iterations:
                    return CAPPED, iterations, 0
            for i in range(q):
                work[_VECTORS, _U, i] = max(0.0, work[_VECTORS, _U, i])
            reach = max(floor, _size(n, x))
            if doubtful:
                _copy_bounds(m, gamma, rows)
                for i in range(q):
                    _set_bound(index[i], math.inf, rows)
                doubtful = False
            polished = True
            rounds += 1
            if rounds > 2:
                tolerance *= 10.0
            worst, finite = _gaps(n, m, Mt, rows, x)
            continue
        polished = False

        # Make row p active.
        multiplier = 0.0
        while True:
            iterations += 1
            if iterations > max_iterations:
                return CAPPED, iterations, 0
            _dots(n, _ROTATED, _A, _D, width, work)
            squares = zeros()
            ratio = splat(math.inf)
            for b in range(0, width, LANES):
                d2 = last_lanes(load(work, _VECTORS, _D, b), q - b)
                squares = fma8(d2, d2, squares)
                r = _combine(0, q, _D, _INVERSE_R, b, work)
                store(work, _VECTORS, _R, b, r)
                u_over_r = where_positive(r, div(load(work, _VECTORS, _U, b), r), splat(math.inf))
                store(work, _VECTORS, _RATIO, b, u_over_r)
                ratio = lesser(u_over_r, ratio)
                store(work, _VECTORS, _Z, b, _combine(q, n, _D, _ROTATED, b, work))
            square = total(squares)
            partial = smallest(ratio)
            dependent = not square > DEPENDENT * DEPENDENT * inverse_trace * length
            full = math.inf if dependent else worst / square
            if dependent and partial == math.inf:
                # a = N r with r <= 0: then a'x >= r'gamma_A for every x that satisfies the active rows.
                scale = abs(bound) + math.sqrt(length) * reach
                for i in range(q):
                    scale += abs(work[_VECTORS, _R, i] * work[_VECTORS, _GAMMA, i])
                if worst > CONTRADICTION * scale:
                    return INFEASIBLE, iterations, 0
                _set_bound(p, math.inf, rows)  # rounding, or too early to say: look again at the polished x
                doubtful = True
                break
            step = min(partial, full)
            backwards = splat(-step)
            for b in range(0, width, LANES):
                u = load(work, _VECTORS, _U, b)
                store(work, _VECTORS, _U, b, fma8(backwards, load(work, _VECTORS, _R, b), u))
                if not dependent:
                    store(x, b, fma8(backwards, load(work, _VECTORS, _Z, b), load(x, b)))
            multiplier += step
            if full <= partial:
                _set_bound(p, math.inf, rows)
                _activate(n, q, p, bound, square, multiplier, work, index)
                q += 1
                break
            if not dependent:
                worst -= step * square
            place = 0
            for b in range(0, width, LANES):
                lane = first_equal(load(work, _VECTORS, _RATIO, b), partial)
                place = b + lane if lane < LANES else place
            q = _release(n, q, place, work, rows, index)
        worst, finite = _gaps(n, m, Mt, rows, x)
        if not finite:
            return NON_FINITE, iterations, 0

    for i in range(q):
        lam[index[i]] = work[_VECTORS, _U, i]
    return SOLVED, iterations, q


@njit(**INLINE)
def _holds(n, m, Mt, x, lam, rows):
    """Whether no row is violated, and none with a multiplier is slack, by more than CERTIFIED (1 + |gamma_j|)."""
    _gaps(n, m, Mt, rows, x)
    worst = splat(-math.inf)
    for b in range(0, padded(m), LANES):
        gap = load(rows, _SLACK, b)
        gap = where_positive(load(lam, b), _magnitude(gap), gap)
        allowed = mul(splat(CERTIFIED), add(splat(1.0), _magnitude(load(rows, _BOUND, b))))
        worst = larger(sub(gap, allowed), worst)
    return largest(worst) <= 0.0


@njit(**INLINE)
def _add_row_of_h(n, j, delta, depth, rows, index):
    """g += delta * (row j of H); the row is computed on its first use."""
    V = _IMAGE
    H = _IMAGE + n
    if index[j] == 0:
        index[j] = 1
        for b in range(0, depth, LANES):
            s = zeros()
            for i in range(n):
                s = fma8(spread(rows, V + i, j), load(rows, V + i, b), s)
            store(rows, H + j, b, s)
    scale = splat(delta)
    for b in range(0, depth, LANES):
        store(rows, _GRADIENT, b, fma8(scale, load(rows, H + j, b), load(rows, _GRADIENT, b)))


@njit(
    types.UniTuple(int64, 2)(
        int64, int64, matrix, vector, matrix, vector, cube, float64, vector, vector, cube, matrix, int_vector, int64,
        float64, boolean,
    ),
    **ROUTINE,
)  # fmt: skip
def hildreth(n, m, E, K, Mt, gamma, factor, condition, x, lam, work, rows, index, max_sweeps, tolerance, warm):
    """Hildreth's procedure (1957; Luenberger 1969, section 10.10; Wang 2009, section 2.4); returns (status, sweeps).

    The unconstrained minimiser is returned when it satisfies every row. Else, with H = M E^-1 M' and
    d = gamma + M E^-1 K, cyclic ascent of the dual: lam_i <- max(0, -(d_i + sum_{j != i} h_ij lam_j)/h_ii),
    until a sweep changes lam by less than ``tolerance`` (squared and summed) or ``max_sweeps`` are done;
    then x = -E^-1 (K + M' lam). ``warm`` starts from the ``lam`` given, else from zero.

    The gradient g = d + H lam is kept up to date, so a row costs one comparison unless its multiplier changes, and
    row i of H = V'V (V = L^-1 M') is computed when lam_i first changes.
    Status: SOLVED when it stopped by ``tolerance`` and the rows hold to `CERTIFIED`; CAPPED when it stopped by
    ``max_sweeps``, or by ``tolerance`` without that (the criterion knows nothing of the multipliers' scale, so alone
    it certifies nothing); NON_FINITE as in `active_set`. An infeasible problem ends CAPPED.
    """
    width = padded(n)
    depth = padded(m)
    if _unconstrained(n, E, K, factor, condition, x, work) != SOLVED:
        return NON_FINITE, 0
    _copy_bounds(m, gamma, rows)
    worst, finite = _gaps(n, m, Mt, rows, x)
    if not finite:
        return NON_FINITE, 0
    if not warm or not worst > 0.0:
        for b in range(0, depth, LANES):
            store(lam, b, zeros())
    if not worst > 0.0:
        return SOLVED, 0

    V = _IMAGE
    for b in range(0, depth, LANES):
        diagonal = zeros()
        for i in range(n):
            s = zeros()
            for k in range(i + 1):
                s = fma8(spread(factor, 0, i, k), load(Mt, k, b), s)
            store(rows, V + i, b, s)
            diagonal = fma8(s, s, diagonal)
        store(rows, _DIAGONAL, b, diagonal)
        store(rows, _GRADIENT, b, sub(zeros(), load(rows, _SLACK, b)))  # d = gamma - M x
    for j in range(m):
        index[j] = 0  # row j of H is not there yet
        if warm:
            lam[j] = max(0.0, lam[j])
            if lam[j] > 0.0:
                _add_row_of_h(n, j, lam[j], depth, rows, index)

    sweeps = 0
    status = CAPPED
    while sweeps < max_sweeps:
        sweeps += 1
        change = 0.0
        for j in range(m):
            old = lam[j]
            g = rows[_GRADIENT, j]
            if (old == 0.0 and g >= 0.0) or not rows[_DIAGONAL, j] > 0.0:
                continue
            new = max(0.0, old - g / rows[_DIAGONAL, j])
            delta = new - old
            if delta != 0.0:
                lam[j] = new
                change += delta * delta
                _add_row_of_h(n, j, delta, depth, rows, index)
        if change < tolerance:
            status = SOLVED
            break

    for i in range(n):
        s = zeros()
        for b in range(0, depth, LANES):
            s = fma8(load(rows, V + i, b), load(lam, b), s)
        work[_VECTORS, _D, i] = -total(s)
    for b in range(0, width, LANES):
        s = zeros()
        for i in range(n):
            s = fma8(spread(work, _VECTORS, _D, i), load(factor, 0, i, b), s)
        store(work, _VECTORS, _STEP, b, s)
    _, _, finite = _advance(n, x, work)
    if not finite:
        return NON_FINITE, sweeps
    if status == SOLVED and not _holds(n, m, Mt, x, lam, rows):
        status = CAPPED
    return status, sweeps


@njit(**INLINE)
def _not_less(a, b):
    """The larger of the two, and NaN if one of them is."""
    return b if a <= b or b != b else a


@njit(types.UniTuple(float64, 4)(int64, int64, matrix, vector, matrix, vector, vector, vector, cube), **ROUTINE)
def kkt_residual(n, m, E, K, Mt, gamma, x, lam, work):
    """How far (x, lam) is from optimal: (stationarity, primal, dual, complementarity), all zero at the solution.

        stationarity    = max |E x + K + M' lam| / (1 + largest of |E x|, |K|, |M' lam|)
        primal          = max_j (M_j x - gamma_j)^+ / (1 + max |M x|)
        dual            = max_j (-lam_j)^+ / (1 + max |lam|)
        complementarity = max_j lam_j |M_j x - gamma_j| / ((1 + max |lam|) (1 + max |M x|)),   gamma_j finite

    in max norms (the definitions of qpsolvers' residuals, each divided by one plus its largest term). Any of them is
    NaN or infinite when the problem or the pair is.
    """
    width = padded(n)
    depth = padded(m)
    stationarity = 0.0
    largest_term = 0.0
    for b in range(0, width, LANES):
        s = zeros()
        for k in range(n):
            s = fma8(spread(x, k), load(E, k, b), s)
        store(work, _VECTORS, _D, b, s)
    for k in range(n):
        s = zeros()
        for b in range(0, depth, LANES):
            s = fma8(load(Mt, k, b), load(lam, b), s)
        force = total(s)
        gradient = work[_VECTORS, _D, k]
        stationarity = _not_less(abs(gradient + K[k] + force), stationarity)
        largest_term = max(largest_term, abs(gradient), abs(K[k]), abs(force))

    primal = 0.0
    dual = 0.0
    complementarity = 0.0
    largest_image = 0.0
    largest_multiplier = 0.0
    for b in range(0, depth, LANES):
        s = zeros()
        for k in range(n):
            s = fma8(spread(x, k), load(Mt, k, b), s)
        store(work, _VECTORS, _STEP, 0, s)
        for lane in range(LANES):
            j = b + lane
            if j < m:
                image = work[_VECTORS, _STEP, lane]
                gap = image - gamma[j]
                largest_image = max(largest_image, abs(image))
                primal = _not_less(gap, primal)
                dual = _not_less(-lam[j], dual)
                if lam[j] > 0.0:
                    complementarity = _not_less(lam[j] * abs(gap), complementarity)
                    largest_multiplier = max(largest_multiplier, lam[j])
    return (
        stationarity / (1.0 + largest_term),
        primal / (1.0 + largest_image),
        dual / (1.0 + largest_multiplier),
        complementarity / ((1.0 + largest_multiplier) * (1.0 + largest_image)),
    )

"""The paper's solver: Hildreth's cyclic ascent of the dual."""

from __future__ import annotations

import math

from ..kernel import exported, inlined
from ..maths.vectors import (
    VECTOR_WIDTH,
    add,
    fma8,
    larger,
    largest,
    load,
    mul,
    padded,
    splat,
    spread,
    store,
    sub,
    total,
    where_positive,
    zeros,
)
from .factor import unconstrained
from .operations import advance, copy_bounds, find_gaps, magnitude
from .problem import CAPPED, HILDRETH, NON_FINITE, ROW_VECTORS, SOLVED, work_of

CERTIFIED = 1e-9
"""The result counts as solved when the rows hold to this part of 1 + |gamma_j|."""


@inlined
def _holds(problem, solution, w):
    """Whether no row is violated, and none with a multiplier is slack, by more than CERTIFIED (1 + |gamma_j|)."""
    find_gaps(problem, solution.x, w)
    worst = splat(-math.inf)
    for b in range(0, padded(problem.m), VECTOR_WIDTH):
        gap = load(w.slack, b)
        gap = where_positive(load(solution.lam, b), magnitude(gap), gap)
        allowed = mul(splat(CERTIFIED), add(splat(1.0), magnitude(load(w.bounds, b))))
        worst = larger(sub(gap, allowed), worst)
    return largest(worst) <= 0.0


@inlined
def _form_dual(problem, factor, V, w):
    """V = L^-1 M', the diagonal of H = V'V, and the gradient d = gamma - M x of the dual at lam = 0."""
    for b in range(0, padded(problem.m), VECTOR_WIDTH):
        diagonal = zeros()
        for i in range(problem.n):
            s = zeros()
            for k in range(i + 1):
                s = fma8(spread(factor.inverse_root, i, k), load(problem.Mt, k, b), s)
            store(V, i, b, s)
            diagonal = fma8(s, s, diagonal)
        store(w.diagonal, b, diagonal)
        store(w.gradient, b, sub(zeros(), load(w.slack, b)))


@inlined
def _change_multiplier(problem, j, delta, V, H, w):
    """g += delta * (row j of H); the row is computed on its first use."""
    depth = padded(problem.m)
    if w.index[j] == 0:
        w.index[j] = 1
        for b in range(0, depth, VECTOR_WIDTH):
            s = zeros()
            for i in range(problem.n):
                s = fma8(spread(V, i, j), load(V, i, b), s)
            store(H, j, b, s)
    scale = splat(delta)
    for b in range(0, depth, VECTOR_WIDTH):
        store(w.gradient, b, fma8(scale, load(H, j, b), load(w.gradient, b)))


@inlined
def _sweep(problem, lam, V, H, w):
    """lam_i <- max(0, lam_i - g_i/h_ii), one row after the other; the change, squared and summed."""
    change = 0.0
    for j in range(problem.m):
        old = lam[j]
        g = w.gradient[j]
        if (old == 0.0 and g >= 0.0) or not w.diagonal[j] > 0.0:
            continue
        new = max(0.0, old - g / w.diagonal[j])
        delta = new - old
        if delta != 0.0:
            lam[j] = new
            change += delta * delta
            _change_multiplier(problem, j, delta, V, H, w)
    return change


@inlined
def _minimiser(problem, factor, solution, V, w):
    """x = -E^-1 (K + M' lam), from x = -E^-1 K; returns whether it is finite."""
    n = problem.n
    for i in range(n):
        s = zeros()
        for b in range(0, padded(problem.m), VECTOR_WIDTH):
            s = fma8(load(V, i, b), load(solution.lam, b), s)
        w.d[i] = -total(s)
    for b in range(0, padded(n), VECTOR_WIDTH):
        s = zeros()
        for i in range(n):
            s = fma8(spread(w.d, i), load(factor.inverse_root, i, b), s)
        store(w.step, b, s)
    _, _, finite = advance(n, solution.x, w.step)
    return finite


@exported(HILDRETH)
def hildreth(problem, factor, solution, scratch, max_sweeps, tolerance, warm):
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
    n, m, lam, w = problem.n, problem.m, solution.lam, work_of(scratch)
    V, H = scratch.rows[ROW_VECTORS:], scratch.rows[ROW_VECTORS + n :]
    if not unconstrained(problem, factor, solution.x, w):
        return NON_FINITE, 0
    copy_bounds(problem, w)
    worst, finite = find_gaps(problem, solution.x, w)
    if not finite:
        return NON_FINITE, 0
    if not warm or not worst > 0.0:
        for b in range(0, padded(m), VECTOR_WIDTH):
            store(lam, b, zeros())
    if not worst > 0.0:
        return SOLVED, 0

    _form_dual(problem, factor, V, w)
    for j in range(m):
        w.index[j] = 0  # row j of H is not there yet
        if warm:
            lam[j] = max(0.0, lam[j])
            if lam[j] > 0.0:
                _change_multiplier(problem, j, lam[j], V, H, w)
    sweeps = 0
    converged = False
    while sweeps < max_sweeps and not converged:
        sweeps += 1
        converged = _sweep(problem, lam, V, H, w) < tolerance

    if not _minimiser(problem, factor, solution, V, w):
        return NON_FINITE, sweeps
    return SOLVED if converged and _holds(problem, solution, w) else CAPPED, sweeps

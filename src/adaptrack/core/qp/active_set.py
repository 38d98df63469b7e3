"""The exact solution by the dual active-set method of Goldfarb and Idnani (1983)."""

from __future__ import annotations

import math

from ..kernel import exported, inlined, record
from ..maths.exact import sqrt
from ..maths.vectors import (
    VECTOR_WIDTH,
    add,
    div,
    first_equal,
    fma8,
    keep_first,
    larger,
    largest,
    lesser,
    load,
    mul,
    padded,
    smallest,
    splat,
    store,
    sub,
    total,
    where_positive,
    zeros,
)
from .active_rows import activate, find_directions, newton, release, release_all, set_entry, take_row, worst_multiplier
from .factor import unconstrained
from .operations import (
    CORRECTED,
    MAX_REFINEMENTS,
    UNIT_ROUNDING,
    copy_bounds,
    exact_stationarity,
    find_gaps,
    largest_magnitude,
    magnitude,
    stationarity,
    trace,
)
from .problem import CAPPED, INFEASIBLE, NON_FINITE, SOLVE, SOLVED, work_of
from .residual import kkt_residual

VIOLATION = 1e-12
"""A row is violated when M_j x - gamma_j exceeds this part of |gamma_j| + sum |M_jk x_k| + NOISE |M_j| |x|."""
NOISE = 1e-2
DEPENDENT = 1e-12
"""A row depends on the active ones when this part of its length, measured by E^-1, is all that is new."""
CONTRADICTION = 1e-9
"""Dependent rows contradict each other when they miss by more than this part of their bounds."""

MAX_RESIDUAL = 1e-6
"""An answer whose accuracy is in doubt counts as solved when no scaled residual exceeds this."""
LARGE = 1e6
"""Where max |x| exceeds this, the terms of M x may cancel so far that their rounding exceeds `MAX_RESIDUAL`."""
DOUBTFUL_SIZE, HOPELESS_SIZE = 1e9, 1e12
"""Where trace(E^-1) max |K| is larger, so may be x without rows, and what cancels in M x: the accuracy is in doubt;
where it is `HOPELESS_SIZE`, a contradiction may be rounding as well."""
ILL_CONDITIONED = 1e13
"""Where the bound on the condition number exceeds this, refinement may end before x is accurate."""

Violation = record("Violation", ("row", "size", "length"), integers=("row",))
"""A violated row of M (-1: none), M_j x - gamma_j and M_j M_j'."""


# -- where to begin ---------------------------------------------------------------------------------------------------
@inlined
def _begin(problem, factor, solution, w, guess, is_warm):
    """x, u and the active rows to begin with: the guessed ones that do not pull the wrong way, or none.

    Returns (active rows, whether all is finite).
    """
    for b in range(0, padded(problem.m), VECTOR_WIDTH):
        store(solution.lam, b, zeros())
    q, finite = 0, True
    if guess > 0:
        q = _take_over(problem, factor, guess, is_warm, w)
        q, finite = _settle(problem, q, solution.x, w)
    if q == 0:
        finite = finite and unconstrained(problem, factor, solution.x, w)
    _bound_inactive_rows(problem, q, w)
    return q, finite


@inlined
def _bound_inactive_rows(problem, q, w):
    """Let all rows count but the active ones, those that were put off included."""
    copy_bounds(problem, w)
    for i in range(q):
        set_entry(w.bounds, w.index[i], math.inf)


@inlined
def _take_over(problem, factor, guess, is_warm, w):
    """Make the rows ``index[:guess]`` active; with the factor at hand when it is theirs. Returns how many are."""
    for i in range(guess):
        is_warm = is_warm and problem.gamma[w.index[i]] < math.inf
    if is_warm:
        for i in range(guess):
            w.active_bounds[i] = problem.gamma[w.index[i]]
        return guess
    release_all(problem.n, factor, w)
    return _adopt(problem, guess, trace(problem.n, factor.inverse), w)


@inlined
def _adopt(problem, guess, inverse_trace, w):
    """Make the rows ``index[:guess]`` active one after the other, leaving out what is absent or dependent."""
    q = 0
    for i in range(guess):
        row = w.index[i]
        if q == problem.n or not (row < problem.m and problem.gamma[row] < math.inf):
            continue
        length = take_row(problem, row, w)
        square = find_directions(problem.n, q, w)
        if not square > DEPENDENT * inverse_trace * length:  # a wide margin: this is only a guess
            continue
        activate(problem, q, row, square, 0.0, w)
        q += 1
    return q


@inlined
def _settle(problem, q, x, w):
    """x on the active rows and their multipliers; rows that pull the wrong way leave. (Active rows, all finite).

    Then (x, u) is optimal for the active rows alone: a point from which the dual method may start.
    """
    n = problem.n
    finite = True
    while q > 0:
        for b in range(0, padded(n), VECTOR_WIDTH):
            store(w.residual, b, keep_first(sub(zeros(), load(problem.K, b)), n - b))
        _, _, finite = newton(n, q, x, w, True)
        place, _ = worst_multiplier(q, w)
        if place < 0 or not finite:
            break
        q = release(n, q, place, w)
    return q, finite


# -- the most violated row becomes active -----------------------------------------------------------------------------
@inlined
def _most_violated(problem, x, w, worst, tolerance, reach):
    """The most violated row, the largest slack being ``worst``; a = this row. Rounding does not count."""
    while worst > 0.0:
        row = _row_with(worst, problem.m, w)
        length = take_row(problem, row, w)
        sizes = zeros()
        for b in range(0, padded(problem.n), VECTOR_WIDTH):
            sizes = add(magnitude(mul(load(w.a, b), load(x, b))), sizes)
        scale = abs(problem.gamma[row]) + total(sizes) + NOISE * sqrt(length) * reach
        if worst > tolerance * scale:
            return Violation(row, worst, length)
        w.slack[row] = -math.inf
        best = splat(-math.inf)
        for b in range(0, padded(problem.m), VECTOR_WIDTH):
            best = larger(load(w.slack, b), best)
        worst = largest(best)
    return Violation(-1, 0.0, 0.0)


@inlined
def _row_with(value, m, w):
    """The first row whose slack equals ``value`` (there is one)."""
    row = 0
    for b in range(padded(m) - VECTOR_WIDTH, -1, -VECTOR_WIDTH):
        entry = first_equal(load(w.slack, b), value)
        row = b + entry if entry < VECTOR_WIDTH else row
    return row


@inlined
def _make_active(problem, x, w, q, violation, reach, inverse_trace, left):
    """Steps until the violated row is active; (status, active rows, steps left, whether it was put off).

    It is put off when it depends on the active rows and misses by no more than rounding: look again at a polished x.
    """
    n = problem.n
    missing = violation.size
    multiplier = 0.0
    while True:
        left -= 1
        if left < 0:
            return CAPPED, q, left, False
        square = find_directions(n, q, w)
        partial = _find_ratios(n, w)
        dependent = not square > DEPENDENT * DEPENDENT * inverse_trace * violation.length
        full = math.inf if dependent else missing / square
        if dependent and partial == math.inf:
            set_entry(w.bounds, violation.row, math.inf)
            contradicts = _contradicts(problem, violation, missing, q, reach, w)
            return INFEASIBLE if contradicts else SOLVED, q, left, True
        step = min(partial, full)
        _move(n, step, dependent, x, w)
        multiplier += step
        if full <= partial:
            set_entry(w.bounds, violation.row, math.inf)
            activate(problem, q, violation.row, square, multiplier, w)
            return SOLVED, q + 1, left, False
        if not dependent:
            missing -= step * square
        q = release(n, q, _place_of(partial, n, w), w)


@inlined
def _find_ratios(n, w):
    """``ratios = u/r`` where r > 0, else inf; the smallest: the step at which a multiplier reaches zero."""
    smallest_ratio = splat(math.inf)
    for b in range(0, padded(n), VECTOR_WIDTH):
        r = load(w.r, b)
        ratio = where_positive(r, div(load(w.u, b), r), splat(math.inf))
        store(w.ratios, b, ratio)
        smallest_ratio = lesser(ratio, smallest_ratio)
    return smallest(smallest_ratio)


@inlined
def _place_of(ratio, n, w):
    """The last block's first place whose ratio this is."""
    place = 0
    for b in range(0, padded(n), VECTOR_WIDTH):
        entry = first_equal(load(w.ratios, b), ratio)
        place = b + entry if entry < VECTOR_WIDTH else place
    return place


@inlined
def _contradicts(problem, violation, missing, q, reach, w):
    """a = N r with r <= 0: then a'x >= r'gamma_A for every x that satisfies the active rows."""
    scale = abs(problem.gamma[violation.row]) + sqrt(violation.length) * reach
    for i in range(q):
        scale += abs(w.r[i] * w.active_bounds[i])
    return missing > CONTRADICTION * scale


@inlined
def _move(n, step, dependent, x, w):
    """u -= step r, x -= step z; x stays where the row depends on the active ones."""
    backwards = splat(-step)
    for b in range(0, padded(n), VECTOR_WIDTH):
        store(w.u, b, fma8(backwards, load(w.r, b), load(w.u, b)))
        if not dependent:
            store(x, b, fma8(backwards, load(w.z, b), load(x, b)))


# -- no row is violated -----------------------------------------------------------------------------------------------
@inlined
def _polish(problem, condition, q, x, w):
    """Newton steps on the active rows, residuals in twice the working precision where the conditioning asks for it.

    Returns whether x and u are finite.
    """
    finite = True
    for _ in range(MAX_REFINEMENTS):
        if UNIT_ROUNDING * condition > CORRECTED:
            exact_stationarity(problem, q, x, w)
        else:
            stationarity(problem, q, x, w)
        moved, size, finite = newton(problem.n, q, x, w, False)
        if not UNIT_ROUNDING * condition * moved > CORRECTED * max(1.0, size):
            break
    return finite


@inlined
def _polish_and_release(problem, condition, q, x, w, tolerance, left):
    """Polish (x, u) and release rows that pull the wrong way; (status, active rows, steps left)."""
    while True:
        if not _polish(problem, condition, q, x, w):
            return NON_FINITE, q, left
        place, gap = worst_multiplier(q, w)
        if place < 0 or gap <= 10.0 * tolerance:
            break
        q = release(problem.n, q, place, w)
        left -= 1
        if left < 0:
            return CAPPED, q, left
    for i in range(q):
        w.u[i] = max(0.0, w.u[i])
    return SOLVED, q, left


@inlined
def _distance(problem, factor):
    """How large the minimiser without rows may be, up to a factor n."""
    return trace(problem.n, factor.inverse) * largest_magnitude(problem.n, problem.K)


@inlined
def _verdict(problem, factor, solution, scratch, reach, tolerance, q):
    """SOLVED; CAPPED where the accuracy is in doubt and the optimality conditions do not hold to `MAX_RESIDUAL`.

    In doubt: q rows are active (their multipliers may be wrong where they leave no room at all), x is `LARGE`, the
    minimiser without rows `DOUBTFUL_SIZE`, E is `ILL_CONDITIONED`, or rows were called satisfied with a wider
    tolerance.
    """
    doubtful = q > 0 or reach > LARGE or factor.condition > ILL_CONDITIONED or tolerance > VIOLATION
    if not (doubtful or _distance(problem, factor) > DOUBTFUL_SIZE):
        return SOLVED
    stationary, primal, dual, complementary = kkt_residual(problem, solution, scratch)
    holds = (
        stationary <= MAX_RESIDUAL and primal <= MAX_RESIDUAL and dual <= MAX_RESIDUAL and complementary <= MAX_RESIDUAL
    )
    return SOLVED if holds else CAPPED


# -- the method -------------------------------------------------------------------------------------------------------
@exported(SOLVE)
def active_set(problem, factor, solution, scratch, guess, is_warm, max_iterations):
    """Write the exact solution to ``solution``; returns (status, iterations, active rows).

    ``index[:guess]`` names rows that may well be active in the solution (0: none known); the answer does not depend
    on it. ``kept`` says that they are those which the last call returned, for the same E and M, and that ``work``
    is as it left it: their factor is then taken over instead of formed again. On return ``index`` begins with the
    active rows.

    From the unconstrained minimiser, the most violated row p is made active along the direction that keeps the
    active rows N active, as far as the multipliers u of those rows stay non-negative; a row whose multiplier
    reaches zero leaves. In the coordinates T (T E T' = I, T N = [R; 0], so T T' = E^-1 when q = 0):
    d = T a, z = T2' d2 (the step of x per unit of multiplier), r = R^-1 d1 (that of -u).
    When no row is violated, (x, u) is polished on its active set; rows that then prove violated or superfluous
    are changed, and so on until nothing changes.

    ``iterations`` counts steps and is capped by ``max_iterations``.
    Status: SOLVED; CAPPED (x is then the last iterate: not optimal, or so large that double precision cannot tell);
    INFEASIBLE (no x satisfies the rows; x is meaningless); NON_FINITE when E, K, M hold NaN or infinity, or gamma NaN
    or -inf.
    """
    n, x, w = problem.n, solution.x, work_of(scratch)
    worst = 0.0
    q, finite = _begin(problem, factor, solution, w, guess, is_warm)
    if finite:
        worst, finite = find_gaps(problem, x, w)
    if not finite:
        return NON_FINITE, 0, 0
    reach = max(1.0, largest_magnitude(n, x))  # the numbers that cancel in M x are about as large as this
    if q == 0:
        if not worst > 0.0:
            return _verdict(problem, factor, solution, scratch, reach, VIOLATION, 0), 0, 0
        release_all(n, factor, w)

    inverse_trace = trace(n, factor.inverse)
    left, tolerance, rounds = max_iterations, VIOLATION, 0
    polished, doubtful = q == 0, False
    while True:
        violation = _most_violated(problem, x, w, worst, tolerance, reach)
        if violation.row >= 0:
            status, q, left, put_off = _make_active(problem, x, w, q, violation, reach, inverse_trace, left)
            polished, doubtful = False, doubtful or put_off
        elif not polished:
            status, q, left = _polish_and_release(problem, factor.condition, q, x, w, tolerance, left)
            if doubtful:
                _bound_inactive_rows(problem, q, w)
            reach = max(1.0, largest_magnitude(n, x))
            polished, doubtful = True, False
            rounds += 1
            if rounds > 2:
                tolerance *= 10.0
        else:
            break
        if status != SOLVED:
            if status == INFEASIBLE and _distance(problem, factor) > HOPELESS_SIZE:
                status = CAPPED  # what cancels in x is too large to tell
            return status, max_iterations - left, 0
        worst, finite = find_gaps(problem, x, w)
        if not finite:
            return NON_FINITE, max_iterations - left, 0

    for i in range(q):
        solution.lam[w.index[i]] = w.u[i]
    status = _verdict(problem, factor, solution, scratch, reach, tolerance, q)
    return status, max_iterations - left, q if status == SOLVED else 0

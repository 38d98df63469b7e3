"""How optimal a pair (x, lam) is."""

from __future__ import annotations

from ..kernel import exported, float64, inlined, several
from ..maths.vectors import VECTOR_WIDTH, fma8, load, padded, spread, store, total, zeros
from .problem import Problem, Scratch, SolutionRecord, work_of


@inlined
def _not_less(a, b):
    """The larger of the two, and NaN if one of them is."""
    return b if a <= b or b != b else a


@inlined
def _stationarity(problem, solution, w):
    """max |E x + K + M' lam| / (1 + largest of |E x|, |K|, |M' lam|)."""
    for b in range(0, padded(problem.n), VECTOR_WIDTH):
        s = zeros()
        for k in range(problem.n):
            s = fma8(spread(solution.x, k), load(problem.E, k, b), s)
        store(w.d, b, s)
    worst = 0.0
    largest_term = 0.0
    for k in range(problem.n):
        s = zeros()
        for b in range(0, padded(problem.m), VECTOR_WIDTH):
            s = fma8(load(problem.Mt, k, b), load(solution.lam, b), s)
        force = total(s)
        gradient = w.d[k]
        worst = _not_less(abs(gradient + problem.K[k] + force), worst)
        largest_term = max(largest_term, abs(gradient), abs(problem.K[k]), abs(force))
    return worst / (1.0 + largest_term)


@inlined
def _rows(problem, solution, w):
    """The other three: (primal, dual, complementarity)."""
    primal = 0.0
    dual = 0.0
    complementarity = 0.0
    largest_image = 0.0
    largest_multiplier = 0.0
    for b in range(0, padded(problem.m), VECTOR_WIDTH):
        s = zeros()
        for k in range(problem.n):
            s = fma8(spread(solution.x, k), load(problem.Mt, k, b), s)
        store(w.step, 0, s)
        for i in range(min(VECTOR_WIDTH, problem.m - b)):
            image, multiplier = w.step[i], solution.lam[b + i]
            gap = image - problem.gamma[b + i]
            largest_image = max(largest_image, abs(image))
            primal = _not_less(gap, primal)
            dual = _not_less(-multiplier, dual)
            if multiplier > 0.0:
                complementarity = _not_less(multiplier * abs(gap), complementarity)
                largest_multiplier = max(largest_multiplier, multiplier)
    return (
        primal / (1.0 + largest_image),
        dual / (1.0 + largest_multiplier),
        complementarity / ((1.0 + largest_multiplier) * (1.0 + largest_image)),
    )


@exported(several(float64, float64, float64, float64)(Problem, SolutionRecord, Scratch))
def kkt_residual(problem, solution, scratch):
    """How far (x, lam) is from optimal: (stationarity, primal, dual, complementarity), all zero at the solution.

        stationarity    = max |E x + K + M' lam| / (1 + largest of |E x|, |K|, |M' lam|)
        primal          = max_j (M_j x - gamma_j)^+ / (1 + max |M x|)
        dual            = max_j (-lam_j)^+ / (1 + max |lam|)
        complementarity = max_j lam_j |M_j x - gamma_j| / ((1 + max |lam|) (1 + max |M x|)),   gamma_j finite

    in max norms (the definitions of qpsolvers' residuals, each divided by one plus its largest term). Any of them is
    NaN or infinite when the problem or the pair is. Of ``scratch`` nothing is changed that a later call relies on.
    """
    w = work_of(scratch)
    primal, dual, complementarity = _rows(problem, solution, w)
    return _stationarity(problem, solution, w), primal, dual, complementarity

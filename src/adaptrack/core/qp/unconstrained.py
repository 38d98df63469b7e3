"""The minimiser without rows."""

from __future__ import annotations

from ..kernel import inlined
from ..maths.vectors import VECTOR_WIDTH, fma8, keep_first, load, padded, spread, store, sub, zeros
from .operations import CORRECTED, MAX_REFINEMENTS, UNIT_ROUNDING, advance, exact_stationarity


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

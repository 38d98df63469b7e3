"""From a discrete model to the condensed quadratic programme: eqs. (9) to (17), one paper equation per function.

Nothing here knows how many states a model has. Shapes: `free` is (n, stride) and holds, by columns of x, the rows of F
without its last column (which is one); `step` is (stride,), step[j] = C~ A~^j B~, the response to a unit move, so
Phi[i, j] = step[i - j].
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..kernel import boolean, exported, float64, inlined, int64, matrix, record, vector, void
from ..maths.exact import sqrt
from ..maths.vectors import VECTOR_WIDTH, add, fma8, keep_first, load, mul, padded, splat, spread, store, sub, zeros

Discrete = record(
    "Discrete",
    (
        ("a", matrix, "states", "states"), ("b", vector, "states"), ("c", vector, "states"), ("e", vector, "states"),
        ("row", vector, "states"), ("next_row", vector, "states"), ("sum", vector, "states"),
    ),
)  # fmt: skip
"""A model over one control period: A (n, n), B (n,), C (n,), E (n,), and scratch, three times (n,)."""


def discrete(a: Any, b: Any, c: Any) -> Any:
    """`Discrete` of a model without known input."""
    return Discrete(a, b, c, *np.zeros((4, len(b))))


@inlined
def _responses(n, horizon, of_next, model, free, step):
    """See `responses`; n: number of states."""
    row, following, total_row = model.row, model.next_row, model.sum
    for i in range(n):
        row[i] = model.c[i]
        total_row[i] = 0.0
    total = 0.0
    for j in range(horizon):
        product = row[0] * model.b[0]
        for i in range(1, n):
            product += row[i] * model.b[i]
        total += product
        step[j] = total
        for i in range(n):
            product = row[0] * model.a[0, i]
            for k in range(1, n):
                product += row[k] * model.a[k, i]
            following[i] = product
        for i in range(n):
            total_row[i] += row[i] if of_next else following[i]
            row[i] = following[i]
            free[i, j] = total_row[i]


@exported(void(int64, boolean, Discrete, matrix, vector))
def responses(horizon, of_next, model, free, step):
    """Eqs. (9), (10): fill `free` (n, >= horizon) and `step` (>= horizon) from A_k and B of eq. (8).

    With the augmented matrices of eq. (9), C~ A~^j = [C (A + .. + A^j), 1]: so row j of F is the running sum of
    C A^i, i = 1..j, and C~ A~^(j) B~ the running sum of C A^i B, i = 0..j. That is for the last increment of the state,
    x(k) - x(k-1); `of_next`: for the next one, x(k+1) - x(k), whose sums begin with i = 0 and end one earlier.
    """
    n = model.b.size
    if n == 4:  # the sizes of our own models as constants: their loops are unrolled
        _responses(4, horizon, of_next, model, free, step)
    elif n == 5:
        _responses(5, horizon, of_next, model, free, step)
    else:
        _responses(n, horizon, of_next, model, free, step)


@exported(void(int64, matrix, vector, float64, vector, vector))
def tracking_error(horizon, free, change, output, reference, error):
    """R_s - F x~: what the reference (horizon,) asks beyond the free response to x~ = [change (n,), output].

    Rows are padded to multiples of the vector width (see `maths.vectors`). Behind the horizon `error` is set to zero.
    """
    y = splat(output)
    for b in range(0, horizon, VECTOR_WIDTH):
        response = y
        for i in range(change.size):
            response = fma8(load(free, i, b), spread(change, i), response)
        store(error, b, keep_first(sub(load(reference, b), response), horizon - b))
    for b in range(padded(horizon), error.size, VECTOR_WIDTH):
        store(error, b, zeros())


@exported(void(int64, int64, vector, float64, float64, matrix))
def pulse_hessian(horizon, moves, step, q, r, hessian):
    """E = 2(Phi' Q Phi + R) of eqs. (11), (17) for the moves of eq. (10), from the step response.

    (Phi'Phi)[i, j] = sum_t step[t] step[t + i - j], t = 0..Np-1-i, i >= j: one sum for the last row, and one
    product more for each step up its diagonals. Only sums of products, so this is as accurate as the full product.
    """
    last = moves - 1
    for d in range(moves):
        ahead, total = step[last - d :], 0.0
        for t in range(horizon - last):
            total += step[t] * ahead[t]
        hessian[last, d] = total
    for i in range(last - 1, -1, -1):
        tail = step[horizon - 1 - i]
        for j in range(i + 1):
            hessian[i, j] = hessian[i + 1, j + 1] + tail * step[horizon - 1 - j]
    for i in range(moves):
        for j in range(i):
            value = 2.0 * q * hessian[i, j]
            hessian[i, j] = value
            hessian[j, i] = value
        hessian[i, i] = 2.0 * (q * hessian[i, i] + r)


@exported(void(int64, int64, vector, float64, vector, vector))
def pulse_gradient(horizon, moves, step, q, error, gradient):
    """K = -2 Phi' Q (R_s - F x~) of eq. (17) for the moves of eq. (10): K_i = -2 Q sum_t step[t] error[t + i].

    `error` is zero behind the horizon, for as many entries as `gradient` is long.
    """
    scale = splat(-2.0 * q)
    for b in range(0, moves, VECTOR_WIDTH):
        even = zeros()
        odd = zeros()
        for t in range(0, horizon - 1, 2):
            even = fma8(spread(step, t), load(error, t + b), even)
            odd = fma8(spread(step, t + 1), load(error, t + 1 + b), odd)
        if horizon % 2 == 1:
            even = fma8(spread(step, horizon - 1), load(error, horizon - 1 + b), even)
        store(gradient, b, mul(scale, add(even, odd)))


@exported(void(int64, int64, float64, matrix))
def laguerre_moves(samples, terms, pole, moves):
    """Discrete Laguerre functions: moves (terms, >= samples), so that the move at sample k is sum_i moves[i, k] eta_i.

    l(k + 1) = A_l l(k), l(0) = sqrt(b) [1, -a, a^2, ..], b = 1 - a^2 (Wang, Model Predictive Control System
    Design and Implementation Using MATLAB, 2009, eqs. 3.4-3.6); orthonormal over k = 0, 1, ...
    """
    b = 1.0 - pole * pole
    value = sqrt(b)
    for i in range(terms):
        moves[i, 0] = value
        value *= -pole
    for k in range(1, samples):
        # l_i(k) = a l_i(k-1) + b sum_{j < i} (-a)^(i-1-j) l_j(k-1), the sum kept as it grows
        below = 0.0
        for i in range(terms):
            moves[i, k] = pole * moves[i, k - 1] + b * below
            below = moves[i, k - 1] - pole * below


@exported(void(int64, int64, vector, matrix, matrix))
def laguerre_response(horizon, terms, step, moves, phi):
    """Phi L, transposed: phi (terms, >= horizon), the outputs' answer to each Laguerre function."""
    for i in range(terms):
        for j in range(horizon):
            phi[i, j] = 0.0
        for k in range(horizon):
            weight = moves[i, k]
            for j in range(k, horizon):
                phi[i, j] += weight * step[j - k]


@exported(void(int64, int64, matrix, float64, float64, matrix))
def condensed_hessian(horizon, terms, phi, q, r, hessian):
    """E = 2(Phi' Q Phi + R) of eqs. (11), (17) from phi = Phi' (terms, >= horizon); R weighs the coefficients."""
    for i in range(terms):
        for j in range(i + 1):
            total = 0.0
            for t in range(horizon):
                total += phi[i, t] * phi[j, t]
            hessian[i, j] = 2.0 * q * total
            hessian[j, i] = hessian[i, j]
        hessian[i, i] += 2.0 * r


@exported(void(int64, int64, matrix, float64, vector, vector))
def condensed_gradient(horizon, terms, phi, q, error, gradient):
    """K = -2 Phi' Q (R_s - F x~) of eq. (17) from phi = Phi' (terms, >= horizon)."""
    for i in range(terms):
        total = 0.0
        for t in range(horizon):
            total += phi[i, t] * error[t]
        gradient[i] = -2.0 * q * total

"""The prediction model and the condensed cost: eqs. (7) to (17), one paper equation per function.

The single-track model in x_c = [v_y, yaw, yaw rate, y] splits: the pair v = (v_y, yaw rate) obeys
dv/dt = M v + b u with a 2 x 2 matrix M, and yaw and y are integrals of it. So its exact zero-order-hold
discretisation needs only the functions phi_k(M T) of a 2 x 2 matrix, phi_k(Z) = sum_i Z^i/(i+k)!.

Shapes: `free` is (4, stride) and holds, by columns of x_c, the rows of F without its last column (which is one);
`step` is (stride,), step[j] = C~ A~^j B~, the response to a unit move, so Phi[i, j] = step[i - j].
"""

from __future__ import annotations

import math

from numba import types

from .abi import INLINE, ROUTINE, float64, int64, matrix, njit, vector
from .maths.vectors import WIDTH, add, fma8, keep_first, load, mul, padded, splat, spread, store, sub, zeros

MODEL_PARAMETERS = ("mass", "yaw_inertia", "lf", "lr", "stiffness_front", "stiffness_rear")
"""The prediction model's packed parameters: kg, kg m^2, m, m, N/rad and N/rad per tyre."""

_TAYLOR_TERMS = 13  # with a scaled norm of at most 1/2 the remainder is below 1e-17


@njit(**INLINE)
def _times(p, q):
    """Product of two 2 x 2 matrices, given by rows."""
    return (
        p[0] * q[0] + p[1] * q[2],
        p[0] * q[1] + p[1] * q[3],
        p[2] * q[0] + p[3] * q[2],
        p[2] * q[1] + p[3] * q[3],
    )


@njit(**INLINE)
def _add_identity(p, s):
    return (p[0] + s, p[1], p[2], p[3] + s)


@njit(**INLINE)
def _scale(p, s):
    return (p[0] * s, p[1] * s, p[2] * s, p[3] * s)


@njit(**INLINE)
def _add(p, q):
    return (p[0] + q[0], p[1] + q[1], p[2] + q[2], p[3] + q[3])


@njit(**INLINE)
def _phi(z):
    """phi_0 .. phi_3 of a 2 x 2 matrix by scaling, Taylor series and doubling.

    Doubling formulas: Skaflestad & Wright, The scaling and modified squaring method for matrix functions
    related to the exponential, Applied Numerical Mathematics 59 (2009).
    """
    norm = max(abs(z[0]) + abs(z[2]), abs(z[1]) + abs(z[3]))
    halvings = 0
    while norm > 0.5 and halvings < 60:
        norm *= 0.5
        halvings += 1
    z = _scale(z, 0.5**halvings)
    inverse_factorial = 1.0
    for k in range(2, _TAYLOR_TERMS + 4):
        inverse_factorial /= k
    p3 = (inverse_factorial, 0.0, 0.0, inverse_factorial)
    for k in range(_TAYLOR_TERMS + 3, 3, -1):
        inverse_factorial *= k
        p3 = _add_identity(_times(z, p3), inverse_factorial)
    p2 = _add_identity(_times(z, p3), 0.5)
    p1 = _add_identity(_times(z, p2), 1.0)
    p0 = _add_identity(_times(z, p1), 1.0)
    for _ in range(halvings):
        p3 = _scale(_add(_add(_times(p1, p2), p2), _scale(p3, 2.0)), 0.125)
        p2 = _scale(_add(_times(p1, p1), _scale(p2, 2.0)), 0.25)
        p1 = _scale(_add(_times(p0, p1), p1), 0.5)
        p0 = _times(p0, p0)
    return p0, p1, p2, p3


@njit(types.void(float64, vector, matrix, vector), **ROUTINE)
def linearise(speed, model, a, b):
    """Eq. (7): write A_c (4, 4) and B_c (4,) at a longitudinal speed (m/s, > 0)."""
    mass, inertia, lf, lr, cf, cr = model[0], model[1], model[2], model[3], model[4], model[5]
    a[:, :] = 0.0
    a[0, 0] = -2.0 * (cf + cr) / (mass * speed)
    a[0, 2] = -speed - 2.0 * (cf * lf - cr * lr) / (mass * speed)
    a[1, 2] = 1.0
    a[2, 0] = -2.0 * (cf * lf - cr * lr) / (inertia * speed)
    a[2, 2] = -2.0 * (cf * lf * lf + cr * lr * lr) / (inertia * speed)
    a[3, 0] = 1.0
    a[3, 1] = speed
    b[0] = 2.0 * cf / mass
    b[1] = 0.0
    b[2] = 2.0 * cf * lf / inertia
    b[3] = 0.0


@njit(types.void(float64, float64, vector, matrix, vector), **ROUTINE)
def discretise(speed, period, model, a, b):
    """Eq. (8): write A_k (4, 4) and B (4,) of eq. (7) under zero-order hold over `period` (s), exactly."""
    linearise(speed, model, a, b)
    b0, b1 = b[0], b[2]
    z = (a[0, 0] * period, a[0, 2] * period, a[2, 0] * period, a[2, 2] * period)
    p0, p1, p2, p3 = _phi(z)
    g1 = _scale(p1, period)
    g2 = _scale(p2, period * period)
    g3 = _scale(p3, period * period * period)
    a[0, 0], a[0, 2] = p0[0], p0[1]
    a[2, 0], a[2, 2] = p0[2], p0[3]
    a[1, 0], a[1, 1], a[1, 2] = g1[2], 1.0, g1[3]
    a[3, 0] = g1[0] + speed * g2[2]
    a[3, 1] = speed * period
    a[3, 2] = g1[1] + speed * g2[3]
    a[3, 3] = 1.0
    b[0] = g1[0] * b0 + g1[1] * b1
    b[1] = g2[2] * b0 + g2[3] * b1
    b[2] = g1[2] * b0 + g1[3] * b1
    b[3] = g2[0] * b0 + g2[1] * b1 + speed * (g3[2] * b0 + g3[3] * b1)


@njit(types.void(int64, matrix, vector, matrix, vector), **ROUTINE)
def responses(horizon, a, b, free, step):
    """Eqs. (9), (10): fill `free` (4, >= horizon) and `step` (>= horizon) from A_k and B of eq. (8).

    With the augmented matrices of eq. (9), C~ A~^j = [C (A + .. + A^j), 1]: so row j of F is the running sum of
    C A^i, i = 1..j, and C~ A~^(j) B~ the running sum of C A^i B, i = 0..j.
    """
    c0, c1, c2, c3 = 0.0, 0.0, 0.0, 1.0  # C A^i
    s0, s1, s2, s3 = 0.0, 0.0, 0.0, 0.0
    total = 0.0
    for j in range(horizon):
        total += c0 * b[0] + c1 * b[1] + c2 * b[2] + c3 * b[3]
        step[j] = total
        n0 = c0 * a[0, 0] + c1 * a[1, 0] + c2 * a[2, 0] + c3 * a[3, 0]
        n1 = c0 * a[0, 1] + c1 * a[1, 1] + c2 * a[2, 1] + c3 * a[3, 1]
        n2 = c0 * a[0, 2] + c1 * a[1, 2] + c2 * a[2, 2] + c3 * a[3, 2]
        n3 = c0 * a[0, 3] + c1 * a[1, 3] + c2 * a[2, 3] + c3 * a[3, 3]
        c0, c1, c2, c3 = n0, n1, n2, n3
        s0 += c0
        s1 += c1
        s2 += c2
        s3 += c3
        free[0, j] = s0
        free[1, j] = s1
        free[2, j] = s2
        free[3, j] = s3


@njit(types.void(int64, matrix, vector, float64, vector, vector), **ROUTINE)
def tracking_error(horizon, free, change, output, reference, error):
    """R_s - F x~: what the reference (horizon,) asks beyond the free response to x~ = [change (4,), output].

    Rows are padded to multiples of 8 (see `simd`). Behind the horizon `error` is set to zero, to its end.
    """
    d0, d1, d2, d3 = splat(change[0]), splat(change[1]), splat(change[2]), splat(change[3])
    y = splat(output)
    for b in range(0, horizon, WIDTH):
        response = fma8(load(free, 0, b), d0, y)
        response = fma8(load(free, 1, b), d1, response)
        response = fma8(load(free, 2, b), d2, response)
        response = fma8(load(free, 3, b), d3, response)
        store(error, b, keep_first(sub(load(reference, b), response), horizon - b))
    for b in range(padded(horizon), error.size, WIDTH):
        store(error, b, zeros())


@njit(types.void(int64, int64, vector, float64, float64, matrix), **ROUTINE)
def pulse_hessian(horizon, moves, step, q, r, hessian):
    """E = 2(Phi' Q Phi + R) of eqs. (11), (17) for the moves of eq. (10), from the step response.

    (Phi'Phi)[i, j] = sum_t step[t] step[t + i - j], t = 0..Np-1-i, i >= j: one sum for the last row, and one
    product more for each step up its diagonals. Only sums of products, so no accuracy is lost on the way.
    """
    last = moves - 1
    for d in range(moves):
        hessian[last, d] = 0.0
    for t in range(horizon - last):
        for d in range(moves):
            hessian[last, d] += step[t] * step[t + last - d]
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


@njit(types.void(int64, int64, vector, float64, vector, vector), **ROUTINE)
def pulse_gradient(horizon, moves, step, q, error, gradient):
    """K = -2 Phi' Q (R_s - F x~) of eq. (17) for the moves of eq. (10): K_i = -2 Q sum_t step[t] error[t + i].

    `error` is zero behind the horizon, for as many entries as `gradient` is long.
    """
    scale = splat(-2.0 * q)
    for b in range(0, moves, WIDTH):
        even = zeros()
        odd = zeros()
        for t in range(0, horizon - 1, 2):
            even = fma8(spread(step, t), load(error, t + b), even)
            odd = fma8(spread(step, t + 1), load(error, t + 1 + b), odd)
        if horizon % 2 == 1:
            even = fma8(spread(step, horizon - 1), load(error, horizon - 1 + b), even)
        store(gradient, b, mul(scale, add(even, odd)))


@njit(types.void(int64, int64, float64, matrix), **ROUTINE)
def laguerre_moves(samples, terms, pole, moves):
    """Discrete Laguerre functions: moves (terms, >= samples), so that the move at sample k is sum_i moves[i, k] eta_i.

    l(k + 1) = A_l l(k), l(0) = sqrt(b) [1, -a, a^2, ..], b = 1 - a^2 (Wang, Model Predictive Control System
    Design and Implementation Using MATLAB, 2009, eqs. 3.4-3.6); orthonormal over k = 0, 1, ...
    """
    b = 1.0 - pole * pole
    value = math.sqrt(b)
    for i in range(terms):
        moves[i, 0] = value
        value *= -pole
    for k in range(1, samples):
        # l_i(k) = a l_i(k-1) + b sum_{j < i} (-a)^(i-1-j) l_j(k-1), the sum kept as it grows
        below = 0.0
        for i in range(terms):
            moves[i, k] = pole * moves[i, k - 1] + b * below
            below = moves[i, k - 1] - pole * below


@njit(types.void(int64, int64, vector, matrix, matrix), **ROUTINE)
def laguerre_response(horizon, terms, step, moves, phi):
    """Phi L, transposed: phi (terms, >= horizon), the outputs' answer to each Laguerre function."""
    for i in range(terms):
        for j in range(horizon):
            phi[i, j] = 0.0
        for k in range(horizon):
            weight = moves[i, k]
            for j in range(k, horizon):
                phi[i, j] += weight * step[j - k]


@njit(types.void(int64, int64, matrix, float64, float64, matrix), **ROUTINE)
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


@njit(types.void(int64, int64, matrix, float64, vector, vector), **ROUTINE)
def condensed_gradient(horizon, terms, phi, q, error, gradient):
    """K = -2 Phi' Q (R_s - F x~) of eq. (17) from phi = Phi' (terms, >= horizon)."""
    for i in range(terms):
        total = 0.0
        for t in range(horizon):
            total += phi[i, t] * error[t]
        gradient[i] = -2.0 * q * total

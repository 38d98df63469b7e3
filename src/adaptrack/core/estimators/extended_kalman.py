"""The extended Kalman filter: what a filter's model does with its Jacobians is done here, once for all filters.

    predict   x = f(x),  P = F P F' + Q,  F = df/dx
    correct   s = h P h' + R,  x += P h' nu/s,  P -= P h' h P/s      nu: innovation of one sensor, h its row of dh/dx

P stays symmetric to the bit: what is done to an entry is done to its mirror image.

A model predicts x itself, adds Q, and names its states and sensors. Sensors are taken in one by one, so that nothing
has to be inverted. Rows are padded to the vector width, with zeros. Source: D. Simon, *Optimal State Estimation*
(2006), chapters 5, 6.1 (scalar updates) and 13.2.

**An estimator of a controller** (`ESTIMATE`) gives the state of the prediction model and a disturbance, from
measurements. The paper's controller needs none: its increments of the measured state are the *deadbeat* estimator,
whose disturbance explains the last measurement whole, d(k) = x(k) - A x(k-1) - B u(k-1), with A and B at the present
speed. The MPC keeps that form as it is; any other estimator gives x and d, and the MPC predicts from them:
Y = F [x(k+1) - x(k); y] with x(k+1) = A x + B u + d, F being that of the next increment (`condensing.responses`). The
deadbeat one needs the whole state measured.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

from ..kernel import Caller, float64, inlined, matrix, vector
from ..maths.exact import clip, sqrt
from ..maths.vectors import VECTOR_WIDTH, fma8, load, mul, splat, spread, store, sub, total, zeros
from ..member import member

IMPOSSIBLE_SIGNAL, IMPOSSIBLE_SPEED = 1e5, 1e3
"""No signal of a car is as large as this, in SI units: what is counts as missing. And no speed, m/s."""

ESTIMATE = float64(float64, vector, float64, matrix, vector, vector, vector, vector, vector)
"""``estimate(speed, measured, command, a, b, parameters, memory, x, d)``: the time (s) of dead reckoning, for which no
position has been taken in, 0 for a new one. It writes the state x (n,) and the disturbance d (n,), what every period
adds to it, from the speed (m/s), the measured quantities (`models.contract.MEASURED`), the
command given a period ago (rad), and A, B of the model at the present speed. x is the state at the time when the next
command begins to act: behind the dead time, for a model that has one. memory: the estimator's own numbers of this run,
zero before its first step. A measurement that is not finite is one that is missing."""
call_estimate = Caller(ESTIMATE)


@lru_cache(maxsize=64)
def compile_estimator(function: Any) -> Any:
    """A user's function as a member of `ESTIMATE`. It may return nothing: 0 s."""
    return member(function, ESTIMATE)


@inlined
def step_motion(lateral, yawing, step, slopes, count, x, mixed):
    """Move v_y and r, the first two states, on by a step (s), and write the first two rows of F (2, .) to `mixed`.

    The linearised trapezoidal rule (I - T/2 A) dx = T f with A = df/dx is stable at any speed. lateral, yawing: f, the
    rates of v_y (m/s^2) and r (rad/s^2); slopes: their derivatives by `count` states.
    """
    half = 0.5 * step
    a, b, c, d = half * slopes[0, 0], half * slopes[0, 1], half * slopes[1, 0], half * slopes[1, 1]
    scale = 1.0 / ((1.0 - a) * (1.0 - d) - b * c)
    vv, vr, rv, rr = (1.0 - d) * scale, b * scale, c * scale, (1.0 - a) * scale  # inverse of I - T/2 A
    slide, turn = step * lateral, step * yawing
    x[0] += vv * slide + vr * turn
    x[1] += rv * slide + rr * turn
    for j in range(count):
        slide, turn = step * slopes[0, j], step * slopes[1, j]
        mixed[0, j], mixed[1, j] = vv * slide + vr * turn, rv * slide + rr * turn
    mixed[0, 0] += 1.0
    mixed[1, 1] += 1.0


@inlined
def carry(mixed, shares, covariance, scratch):
    """P = F P F' of states of which the first mix and each other one keeps a share of itself.

    mixed: the first rows of F (m, .); shares: the diagonal of the others (n,), the first m of no account; covariance: P
    (n, .); scratch (m, .).
    """
    m, n, width = mixed.shape[0], covariance.shape[0], covariance.shape[1]
    for i in range(m):
        for b in range(0, width, VECTOR_WIDTH):
            row = zeros()
            for k in range(n):
                row = fma8(spread(mixed, i, k), load(covariance, k, b), row)
            store(scratch, i, b, row)
    for i in range(m):
        for j in range(i + 1):
            products = zeros()
            for b in range(0, width, VECTOR_WIDTH):
                products = fma8(load(scratch, i, b), load(mixed, j, b), products)
            covariance[i, j] = total(products)
            covariance[j, i] = covariance[i, j]
    for i in range(m, n):
        share = splat(shares[i])
        for b in range(0, width, VECTOR_WIDTH):
            store(covariance, i, b, mul(mul(share, load(shares, b)), load(covariance, i, b)))
        for j in range(m):
            covariance[i, j] = shares[i] * scratch[j, i]
            covariance[j, i] = covariance[i, j]


@inlined
def scatter(variance, h, covariance, cross):
    """The variance of an innovation, h P h' + R, R being that of the sensor's noise; writes P h' to `cross`."""
    n, width = covariance.shape[0], covariance.shape[1]
    for b in range(0, width, VECTOR_WIDTH):
        row = zeros()
        for i in range(n):
            if h[i] != 0.0:
                row = fma8(splat(h[i]), load(covariance, i, b), row)
        store(cross, b, row)
    for i in range(n):
        variance += h[i] * cross[i]
    return variance


@inlined
def bounded(innovation, variance, bound):
    """An innovation up to so many of its standard deviations: an outlier moves the state no further."""
    reach = bound * sqrt(variance)
    return clip(innovation, -reach, reach)


@inlined
def correct(innovation, variance, cross, x, covariance):
    """x += g nu/sqrt(s), P -= g g', g = P h'/sqrt(s), for an innovation nu of variance s.

    cross: P h' as `scatter` has left it; g after.
    """
    width, scale = covariance.shape[1], 1.0 / sqrt(variance)
    for b in range(0, width, VECTOR_WIDTH):
        store(cross, b, mul(splat(scale), load(cross, b)))
        store(x, b, fma8(splat(scale * innovation), load(cross, b), load(x, b)))
    for i in range(covariance.shape[0]):
        for b in range(0, width, VECTOR_WIDTH):
            store(covariance, i, b, sub(load(covariance, i, b), mul(spread(cross, i), load(cross, b))))

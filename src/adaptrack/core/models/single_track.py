"""The paper's prediction model: eqs. (7) and (8).

The single-track model in x_c = [v_y, yaw, yaw rate, y] splits: the pair v = (v_y, yaw rate) obeys
dv/dt = M v + b u with a 2 x 2 matrix M, and yaw and y are integrals of it. So its exact zero-order-hold
discretisation needs only the functions phi_k(M T) of a 2 x 2 matrix, phi_k(Z) = sum_i Z^i/(i+k)!.
"""

from __future__ import annotations

from ..kernel import exported, float64, inlined, matrix, record, unpacker, vector, void
from ..maths.bits import two_to
from .contract import DISCRETISE

STATES = ("vy", "yaw", "yaw_rate", "y")
"""x_c; the output is the last one."""
Parameters = record("Parameters", ("mass", "yaw_inertia", "lf", "lr", "stiffness_front", "stiffness_rear"))
"""kg, kg m^2, m, m, N/rad and N/rad per tyre."""
unpack = unpacker(Parameters)

_TAYLOR_TERMS = 13  # with a scaled norm of at most 1/2 the remainder is below 1e-17


@inlined
def _times(p, q):
    """Product of two 2 x 2 matrices, given by rows."""
    return (
        p[0] * q[0] + p[1] * q[2],
        p[0] * q[1] + p[1] * q[3],
        p[2] * q[0] + p[3] * q[2],
        p[2] * q[1] + p[3] * q[3],
    )


@inlined
def _add_identity(p, s):
    return (p[0] + s, p[1], p[2], p[3] + s)


@inlined
def _scale(p, s):
    return (p[0] * s, p[1] * s, p[2] * s, p[3] * s)


@inlined
def _add(p, q):
    return (p[0] + q[0], p[1] + q[1], p[2] + q[2], p[3] + q[3])


@inlined
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
    z = _scale(z, two_to(-halvings))
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


@exported(void(float64, vector, matrix, vector))
def linearise(speed, parameters, a, b):
    """Eq. (7): write A_c (4, 4) and B_c (4,) at a longitudinal speed (m/s, > 0)."""
    mass, inertia, lf, lr, cf, cr = unpack(parameters)
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


@exported(DISCRETISE, name="discretise_single_track")
def discretise(speed, period, parameters, a, b, e):
    """Eq. (8): write A_k (4, 4) and B (4,) of eq. (7) under zero-order hold over `period` (s), exactly; e (4,) is 0.

    The heading is that in the ground frame: a curved road does not act on it.
    """
    e[:] = 0.0
    linearise(speed, parameters, a, b)
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

"""The paper's prediction model: eqs. (7) and (8).

The single-track model in x_c = [v_y, yaw, yaw rate, y] splits: the pair v = (v_y, yaw rate) obeys
dv/dt = M v + b u with a 2 x 2 matrix M, and yaw and y are integrals of it. So its exact zero-order-hold
discretisation needs only the functions phi_k(M T) of a 2 x 2 matrix, phi_k(Z) = sum_i Z^i/(i+k)!.
"""

from __future__ import annotations

from ..kernel import columns, exported, float64, inlined, local, matrix, unpacker, vector, void
from ..maths.matrix_exponential import apply, integrals
from .car import SingleTrackCar
from .contract import DISCRETISE

SINGLE_TRACK_STATE = columns("vy", "yaw", "yaw_rate", "y")
"""x_c; the output is the last one."""
unpack = unpacker(SingleTrackCar)

_X, _Q = SINGLE_TRACK_STATE, columns("vy", "yaw_rate")
_square, _column = local(len(_Q), 8), local(len(_Q))


@exported(void(float64, vector, matrix, vector))
def linearise(speed, parameters, a, b):
    """Eq. (7): write A_c (4, 4) and B_c (4,) at a longitudinal speed (m/s, > 0)."""
    mass, inertia, lf, lr, cf, cr = unpack(parameters)
    a[:, :], b[:] = 0.0, 0.0
    a[_X.vy, _X.vy] = -2.0 * (cf + cr) / (mass * speed)
    a[_X.vy, _X.yaw_rate] = -speed - 2.0 * (cf * lf - cr * lr) / (mass * speed)
    a[_X.yaw, _X.yaw_rate] = 1.0
    a[_X.yaw_rate, _X.vy] = -2.0 * (cf * lf - cr * lr) / (inertia * speed)
    a[_X.yaw_rate, _X.yaw_rate] = -2.0 * (cf * lf * lf + cr * lr * lr) / (inertia * speed)
    a[_X.y, _X.vy], a[_X.y, _X.yaw] = 1.0, speed
    b[_X.vy], b[_X.yaw_rate] = 2.0 * cf / mass, 2.0 * cf * lf / inertia


@inlined
def _states(q, once, twice, speed):
    """(v_y, yaw, yaw rate, y) from q = (v_y, yaw rate), its integral over the period, and the next one."""
    return q[_Q.vy], once[_Q.yaw_rate], q[_Q.yaw_rate], once[_Q.vy] + speed * twice[_Q.yaw_rate]


@exported(DISCRETISE, name="discretise_single_track")
def discretise(speed, period, parameters, a, b, e):
    """Eq. (8): write A_k (4, 4) and B (4,) of eq. (7) under zero-order hold over `period` (s), exactly; e (4,) is 0.

    The heading is that in the ground frame: a curved road does not act on it.
    """
    m, command = _square(), _column()
    s0, s1, s2, s3 = _square(), _square(), _square(), _square()
    e[:] = 0.0
    linearise(speed, parameters, a, b)
    for i, row in ((_Q.vy, _X.vy), (_Q.yaw_rate, _X.yaw_rate)):
        command[i] = b[row]
        for j, column in ((_Q.vy, _X.vy), (_Q.yaw_rate, _X.yaw_rate)):
            m[i, j] = a[row, column]
    integrals(m, period, s0, s1, s2, s3)
    for j, column in ((_Q.vy, _X.vy), (_Q.yaw_rate, _X.yaw_rate)):
        states = _states(s0[:, j], s1[:, j], s2[:, j], speed)
        a[_X.vy, column], a[_X.yaw, column], a[_X.yaw_rate, column], a[_X.y, column] = states
    q, once, twice = _column(), _column(), _column()
    apply(s1, command, q)
    apply(s2, command, once)
    apply(s3, command, twice)
    b[_X.vy], b[_X.yaw], b[_X.yaw_rate], b[_X.y] = _states(q, once, twice, speed)
    a[_X.yaw, _X.yaw] = a[_X.y, _X.y] = 1.0
    a[_X.y, _X.yaw] = speed * period

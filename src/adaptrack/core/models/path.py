"""The path model: the single track with its steering lag as a state, a curved road and two disturbances as inputs.

    dv_y/dt   = -(C_f + C_r)/(m v) v_y - ((l_f C_f - l_r C_r)/(m v) + v) r + C_f/m delta + d_y
    dr/dt     = -(l_f C_f - l_r C_r)/(I_z v) v_y - (l_f^2 C_f + l_r^2 C_r)/(I_z v) r + l_f C_f/I_z delta + d_r
    ddelta/dt = (u - delta)/tau
    dpsi/dt   = r - w          psi: heading against the path; w: curvature of the path times speed (rad/s)
    dy/dt     = v_y + v psi    y: lateral offset from the path, positive to the left

C_f, C_r are those of an axle. The triple q = (v_y, r, delta) obeys dq/dt = M q + input, M 3 x 3, and psi and y are
integrals of it. So the exact zero-order-hold discretisation needs only phi_k(M T), k = 0..3, of a 3 x 3 matrix,
phi_k(Z) = sum_i Z^i/(i+k)!. Without lag delta is no state and enters as the input. Towards standstill the stiff tyres
turn the same equations into those of a kinematic bicycle, r = v delta/L; the exact exponential has no trouble with it.
"""

from __future__ import annotations

import math

from ..kernel import exported, float64, inlined, int64, record, unpacker, vector, void
from ..maths.bits import two_to
from ..maths.trigonometric import asin, tan
from ..plants.forces import GRAVITY
from .contract import DISCRETISE

Parameters = record("Parameters", ("mass", "yaw_inertia", "lf", "lr", "stiffness_front", "stiffness_rear", "lag"))
"""kg, kg m^2, m, m, N/rad and N/rad per tyre, s."""
unpack = unpacker(Parameters)
STIFFNESS_FRONT, STIFFNESS_REAR, LAG = (
    Parameters._fields.index(name) for name in ("stiffness_front", "stiffness_rear", "lag")
)
"""Places of what may be learned."""
SLOWEST = 3.0
"""m/s: slip angles are formed with at least this speed, for noise over a small one is no slip."""
MOST_SHARE = 0.9
"""Of the friction, that a road is thought to ask for at most: nobody knows the friction better."""
DISTURBANCES = 2
"""d_y (m/s^2) and d_r (rad/s^2)."""

_TERMS = 13  # with a scaled norm of at most 1/2 the remainder is below 1e-17


@inlined
def _times(p, q):
    """Product of two 3 x 3 matrices, given by rows."""
    return (
        p[0] * q[0] + p[1] * q[3] + p[2] * q[6],
        p[0] * q[1] + p[1] * q[4] + p[2] * q[7],
        p[0] * q[2] + p[1] * q[5] + p[2] * q[8],
        p[3] * q[0] + p[4] * q[3] + p[5] * q[6],
        p[3] * q[1] + p[4] * q[4] + p[5] * q[7],
        p[3] * q[2] + p[4] * q[5] + p[5] * q[8],
        p[6] * q[0] + p[7] * q[3] + p[8] * q[6],
        p[6] * q[1] + p[7] * q[4] + p[8] * q[7],
        p[6] * q[2] + p[7] * q[5] + p[8] * q[8],
    )


@inlined
def _add_identity(p, s):
    return (p[0] + s, p[1], p[2], p[3], p[4] + s, p[5], p[6], p[7], p[8] + s)


@inlined
def _scale(p, s):
    return (p[0] * s, p[1] * s, p[2] * s, p[3] * s, p[4] * s, p[5] * s, p[6] * s, p[7] * s, p[8] * s)


@inlined
def _add(p, q):
    return (
        p[0] + q[0], p[1] + q[1], p[2] + q[2], p[3] + q[3], p[4] + q[4], p[5] + q[5], p[6] + q[6], p[7] + q[7],
        p[8] + q[8],
    )  # fmt: skip


@inlined
def _phi(z):
    """phi_0 .. phi_3 of a 3 x 3 matrix by scaling, Taylor series and doubling.

    Doubling formulas: Skaflestad & Wright, The scaling and modified squaring method for matrix functions
    related to the exponential, Applied Numerical Mathematics 59 (2009).
    """
    norm = max(
        max(abs(z[0]) + abs(z[3]) + abs(z[6]), abs(z[1]) + abs(z[4]) + abs(z[7])), abs(z[2]) + abs(z[5]) + abs(z[8])
    )
    halvings = 0
    while norm > 0.5 and halvings < 60:
        norm *= 0.5
        halvings += 1
    z = _scale(z, two_to(-halvings))
    inverse_factorial = 1.0
    for k in range(2, _TERMS + 4):
        inverse_factorial /= k
    p3 = (inverse_factorial, 0.0, 0.0, 0.0, inverse_factorial, 0.0, 0.0, 0.0, inverse_factorial)
    for k in range(_TERMS + 3, 3, -1):
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


@inlined
def _apply(p, q):
    return (
        p[0] * q[0] + p[1] * q[1] + p[2] * q[2],
        p[3] * q[0] + p[4] * q[1] + p[5] * q[2],
        p[6] * q[0] + p[7] * q[1] + p[8] * q[2],
    )


@inlined
def _column(initial, once, twice, speed):
    """(v_y, psi, r, delta, y) from q, its integral and its double integral, each (3,)."""
    return (initial[0], once[1], initial[1], initial[2], once[0] + speed * twice[1])


@inlined
def _continuous(speed, c):
    """M by rows, and the columns by which u, d_y and d_r enter dq/dt."""
    cf, cr = 2.0 * c.stiffness_front, 2.0 * c.stiffness_rear
    turn = cf * c.lf - cr * c.lr
    lagging = c.lag > 0.0
    side, yawing = cf / c.mass, cf * c.lf / c.yaw_inertia
    rate = 1.0 / c.lag if lagging else 0.0
    m = (
        -(cf + cr) / (c.mass * speed), -speed - turn / (c.mass * speed), side if lagging else 0.0,
        -turn / (c.yaw_inertia * speed), -(cf * c.lf * c.lf + cr * c.lr * c.lr) / (c.yaw_inertia * speed),
        yawing if lagging else 0.0,
        0.0, 0.0, -rate,
    )  # fmt: skip
    command = (0.0, 0.0, rate) if lagging else (side, yawing, 0.0)
    return m, command


@inlined
def _columns(speed, period, c):
    """Under zero-order hold over `period`: the columns of A for v_y, r and delta, and those of u, d_y and d_r."""
    m, command = _continuous(speed, c)
    p0, p1, p2, p3 = _phi(_scale(m, period))
    g1, g2, g3 = _scale(p1, period), _scale(p2, period * period), _scale(p3, period * period * period)
    vy, r, delta = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
    return (
        _column(_apply(p0, vy), _apply(g1, vy), _apply(g2, vy), speed),
        _column(_apply(p0, r), _apply(g1, r), _apply(g2, r), speed),
        _column(_apply(p0, delta), _apply(g1, delta), _apply(g2, delta), speed),
        _column(_apply(g1, command), _apply(g2, command), _apply(g3, command), speed),
        _column(_apply(g1, vy), _apply(g2, vy), _apply(g3, vy), speed),
        _column(_apply(g1, r), _apply(g2, r), _apply(g3, r), speed),
    )


@exported(void(float64, float64, vector, int64, vector, int64, int64))
def discretise_rows(speed, period, parameters, stride, target, rows, column):
    """Write [A G] and B over `period` (s), exactly, to a flat array: for a filter that carries the disturbances.

    Entry (i, j) of [A G], (n, n + 2), goes to target[rows + stride i + j], that of B to target[column + i].
    speed: m/s, > 0. The states are [v_y, psi, r, delta, y], n = 5, without delta when the lag is 0, n = 4.
    """
    c = unpack(parameters)
    lagging = c.lag > 0.0
    n = 5 if lagging else 4
    of_vy, of_r, of_delta, of_u, of_dy, of_dr = _columns(speed, period, c)
    for i in range(n):
        from_top = i if i < 3 or lagging else 4
        row = rows + stride * i
        target[row], target[row + 1], target[row + 2] = of_vy[from_top], 0.0, of_r[from_top]
        if lagging:
            target[row + 3] = of_delta[from_top]
        target[row + n - 1] = 0.0
        target[row + n], target[row + n + 1] = of_dy[from_top], of_dr[from_top]
        target[column + i] = of_u[from_top]
    last = rows + stride * (n - 1)
    target[rows + stride + 1], target[last + 1], target[last + n - 1] = 1.0, speed * period, 1.0


@inlined
def lost(turn, friction, shape):
    """What tyres pull less (m/s^2, signed) than linear ones at the same slip in a steady turn of so many m/s^2.

    Each axle pulls its share F/F_z = turn/g. By the Magic Formula with E = 0 (Pacejka, eq. 4.E19) it slides under the
    angle at which a linear tyre would pull mu F_z C tan(asin(f)/C), f = F/(mu F_z).
    """
    most = friction * GRAVITY
    share = min(abs(turn) / most, MOST_SHARE)
    return -math.copysign(most * (shape * tan(asin(share) / shape) - share), turn)


@inlined
def _slid(slip, stiffness, load):
    """F^2/F_z (N) of an axle at a slip angle, F = C alpha <= F_z."""
    force = min(stiffness * abs(slip), load)
    return force * force / load


@inlined
def sliding(speed, vy, r, angle, parameters):
    """What the tyres pull (m/s^2); variances of dv_y/dt and dr/dt and their covariance when each axle's force deviates
    by F^2/F_z.

    In the brush model a tyre loses F^2/(3 mu F_z) to sliding, in first order (Pacejka, Tire and Vehicle Dynamics,
    3rd ed., section 3.2).
    """
    c = unpack(parameters)
    pace, weight = max(speed, SLOWEST), c.mass * GRAVITY / (c.lf + c.lr)
    stiff_front, stiff_rear = 2.0 * c.stiffness_front, 2.0 * c.stiffness_rear
    front_slip, rear_slip = angle - (vy + c.lf * r) / pace, (vy - c.lr * r) / pace
    front = _slid(front_slip, stiff_front, weight * c.lr) / c.mass
    rear = _slid(rear_slip, stiff_rear, weight * c.lf) / c.mass
    by_front, by_rear = front * front, rear * rear
    turning = c.mass / c.yaw_inertia
    pull = abs(stiff_front * front_slip - stiff_rear * rear_slip) / c.mass
    return (
        pull,
        by_front + by_rear,
        turning * turning * (c.lf * c.lf * by_front + c.lr * c.lr * by_rear),
        turning * (c.lf * by_front - c.lr * by_rear),
    )


@inlined
def lateral_acceleration_row(speed, parameters, n, target, row):
    """Write dv_y/dt + v r of the states (n,) to target[row:]; what a command adds to it (m/s^2 per rad)."""
    m, command = _continuous(speed, unpack(parameters))
    target[row], target[row + 1], target[row + 2] = m[0], 0.0, m[1] + speed
    if n == 5:
        target[row + 3] = m[2]
    target[row + n - 1] = 0.0
    return command[0]


@exported(void(vector, vector))
def write_turning(parameters, turning):
    """Write L, K, W, lr and the lag, see `controllers.feed_forward.TURNING`, to turning[:5]."""
    c = unpack(parameters)
    cf, cr, wheelbase = 2.0 * c.stiffness_front, 2.0 * c.stiffness_rear, c.lf + c.lr
    turning[0] = wheelbase
    turning[1] = c.mass * (c.lr * cr - c.lf * cf) / (wheelbase * cf * cr)
    turning[2] = ((cf + cr) * c.yaw_inertia + (c.lf * c.lf * cf + c.lr * c.lr * cr) * c.mass) / (cf * cr * wheelbase)
    turning[3], turning[4] = c.lr, c.lag


@exported(DISCRETISE, name="discretise_path")
def discretise(speed, period, parameters, a, b, e):
    """Eq. (8) for the path model: write A (n, n), B (n,) and E (n,), the column of w."""
    c = unpack(parameters)
    n = b.size
    of_vy, of_r, of_delta, of_u, _, _ = _columns(speed, period, c)
    for i in range(n):
        from_top = i if i < 3 or n == 5 else 4
        a[i, 0], a[i, 1], a[i, 2] = of_vy[from_top], 0.0, of_r[from_top]
        if n == 5:
            a[i, 3] = of_delta[from_top]
        a[i, n - 1] = 0.0
        b[i], e[i] = of_u[from_top], 0.0
    a[1, 1], a[n - 1, 1], a[n - 1, n - 1] = 1.0, speed * period, 1.0
    e[1], e[n - 1] = -period, -0.5 * speed * period * period

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

from ..kernel import Row, columns, exported, float64, inlined, local, matrix, record, vector, viewer, void
from ..maths.matrix_exponential import apply, integrals
from ..physics.forces import GRAVITY
from ..physics.tyre import reach_at
from .car import ACTUATOR_LAG, SINGLE_TRACK
from .contract import DISCRETISE

Parameters = record("Parameters", (*SINGLE_TRACK, ACTUATOR_LAG))
"""The car, and the lag of its steering."""
parameters_of = viewer(Parameters)
MIN_SLIP_SPEED = 3.0
"""m/s: slip angles are formed with at least this speed, for noise over a small one is no slip."""
MOST_SHARE = 0.9
"""Of the friction, that a road is thought to ask for at most: nobody knows the friction better."""
PATH_STATE = columns("vy", "yaw", "yaw_rate", "wheel_angle", "y", "side", "turn")
"""Places of v_y, psi, r, delta, y, d_y (m/s^2) and d_r (rad/s^2) in a filter, whether there is a lag or not."""
PATH_STATES = 5
"""The first of `PATH_STATE`; the others are disturbances."""

Turning = record(
    "Turning",
    (
        "wheelbase",  # m, L
        "understeer", "turning",  # rad s^2/m, K and W
        "lr",  # m
        "lag",  # s, of the steering
        "friction", "shape_factor",  # of the tyres as the estimator knows them, see `saturation`; 0: linear
    ),
)  # fmt: skip
"""How a car turns in, see `controllers.feed_forward`."""
turning_of = viewer(Turning)
_Q = columns("vy", "yaw_rate", "wheel_angle")
_square, _column = local(len(_Q), 8), local(len(_Q))
_transition, _response = local(PATH_STATES, 8), local(PATH_STATES)


@inlined
def _continuous(speed, c, m, command):
    """Write M and the column by which u enters dq/dt; those of d_y and d_r are unit vectors."""
    cf, cr = 2.0 * c.stiffness_front, 2.0 * c.stiffness_rear
    turn = cf * c.lf - cr * c.lr
    m[_Q.vy, _Q.vy] = -(cf + cr) / (c.mass * speed)
    m[_Q.vy, _Q.yaw_rate] = -speed - turn / (c.mass * speed)
    m[_Q.yaw_rate, _Q.vy] = -turn / (c.yaw_inertia * speed)
    m[_Q.yaw_rate, _Q.yaw_rate] = -(cf * c.lf * c.lf + cr * c.lr * c.lr) / (c.yaw_inertia * speed)
    side, yawing = cf / c.mass, cf * c.lf / c.yaw_inertia
    if c.lag > 0.0:
        m[_Q.vy, _Q.wheel_angle], m[_Q.yaw_rate, _Q.wheel_angle] = side, yawing
        m[_Q.wheel_angle, _Q.wheel_angle], command[_Q.wheel_angle] = -1.0 / c.lag, 1.0 / c.lag
    else:
        command[_Q.vy], command[_Q.yaw_rate] = side, yawing


@inlined
def _states(q, once, twice, speed):
    """(v_y, psi, r, delta, y) from q (3,), its integral over the period, and the next one."""
    return q[_Q.vy], once[_Q.yaw_rate], q[_Q.yaw_rate], q[_Q.wheel_angle], once[_Q.vy] + speed * twice[_Q.yaw_rate]


@inlined
def _write(column, f, j):
    """Write the states to column j of f."""
    for i in range(PATH_STATES):
        f[i, j] = column[i]


@inlined
def _hold(speed, period, c, f, b):
    """Write [A G] and B, see `discretise_disturbed`, to arrays of zeros; without lag delta is a state that stays."""
    m, command = _square(), _column()
    s0, s1, s2, s3 = _square(), _square(), _square(), _square()
    _continuous(speed, c, m, command)
    integrals(m, period, s0, s1, s2, s3)
    for j, state in (
        (_Q.vy, PATH_STATE.vy),
        (_Q.yaw_rate, PATH_STATE.yaw_rate),
        (_Q.wheel_angle, PATH_STATE.wheel_angle),
    ):
        _write(_states(s0[:, j], s1[:, j], s2[:, j], speed), f, state)
    for j, push in ((_Q.vy, PATH_STATE.side), (_Q.yaw_rate, PATH_STATE.turn)):
        _write(_states(s1[:, j], s2[:, j], s3[:, j], speed), f, push)
    f[PATH_STATE.yaw, PATH_STATE.yaw] = f[PATH_STATE.y, PATH_STATE.y] = 1.0
    f[PATH_STATE.y, PATH_STATE.yaw] = speed * period
    q, once, twice = _column(), _column(), _column()
    apply(s1, command, q)
    apply(s2, command, once)
    apply(s3, command, twice)
    column = _states(q, once, twice, speed)
    for i in range(PATH_STATES):
        b[i] = column[i]


@exported(void(float64, float64, Row(Parameters), matrix, vector))
def discretise_disturbed(speed, period, c, f, b):
    """Write [A G], G being the columns of the disturbances, and B over `period` (s), exactly: for a filter.

    f (5, .), b (5 and more,): by `PATH_STATE`; speed: m/s, > 0. Without lag the wheel angle is the command.
    """
    f[:, :] = 0.0
    _hold(speed, period, c, f, b)
    if not c.lag > 0.0:
        f[PATH_STATE.wheel_angle, PATH_STATE.wheel_angle], b[PATH_STATE.wheel_angle] = 0.0, 1.0


@inlined
def saturation(turn, friction, shape):
    """Loss of tyre pull (m/s^2, signed) against linear tyres at equal slip, in a steady turn of so many m/s^2.

    Each axle pulls its share F/F_z = turn/g, at the slip angle of a Magic Formula (`physics.tyre.reach_at`).
    """
    most = friction * GRAVITY
    share = min(abs(turn) / most, MOST_SHARE)
    return -math.copysign(most * (reach_at(share, shape) - share), turn)


@inlined
def _slid(slip, stiffness, load):
    """F^2/F_z (N) of an axle at a slip angle, F = C alpha <= F_z."""
    force = min(stiffness * abs(slip), load)
    return force * force / load


@inlined
def sliding(speed, vy, r, angle, c):
    """Tyre pull (m/s^2); variances and covariance of dv_y/dt and dr/dt for axle forces that deviate by F^2/F_z.

    In the brush model a tyre loses F^2/(3 mu F_z) to sliding, in first order (Pacejka, Tire and Vehicle Dynamics,
    3rd ed., section 3.2).
    """
    v, weight = max(speed, MIN_SLIP_SPEED), c.mass * GRAVITY / (c.lf + c.lr)
    stiff_front, stiff_rear = 2.0 * c.stiffness_front, 2.0 * c.stiffness_rear
    front_slip, rear_slip = angle - (vy + c.lf * r) / v, (vy - c.lr * r) / v
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
def lateral_acceleration_row(speed, c, h):
    """Write dv_y/dt + v r, as an accelerometer reads it, by `PATH_STATE` to h; without lag its angle is the command."""
    m, command = _square(), _column()
    _continuous(speed, c, m, command)
    h[PATH_STATE.vy], h[PATH_STATE.yaw_rate], h[PATH_STATE.side] = m[_Q.vy, _Q.vy], m[_Q.vy, _Q.yaw_rate] + speed, 1.0
    h[PATH_STATE.wheel_angle] = m[_Q.vy, _Q.wheel_angle] + command[_Q.vy]


@exported(void(vector, vector))
def write_turning(parameters, turning):
    """Write `Turning`, but for the tyres."""
    turn_in(parameters_of(parameters, 0), turning_of(turning, 0))


@inlined
def turn_in(c, t):
    """Write how a car turns in, but for the tyres."""
    cf, cr = 2.0 * c.stiffness_front, 2.0 * c.stiffness_rear
    t.wheelbase, t.lr, t.lag = c.lf + c.lr, c.lr, c.lag
    t.understeer = c.mass * (c.lr * cr - c.lf * cf) / (t.wheelbase * cf * cr)
    t.turning = ((cf + cr) * c.yaw_inertia + (c.lf * c.lf * cf + c.lr * c.lr * cr) * c.mass) / (cf * cr * t.wheelbase)


@inlined
def state_index(i, n):
    """Which of `PATH_STATE` is the i-th of n states: without lag there is no wheel angle among them."""
    return i if n == PATH_STATES or i < PATH_STATE.wheel_angle else i + 1


@exported(DISCRETISE, name="discretise_path")
def discretise(speed, period, parameters, a, b, e):
    """Eq. (8) for the path model: write A (n, n), B (n,) and E (n,), the column of w."""
    n, f, response = b.size, _transition(), _response()
    _hold(speed, period, parameters_of(parameters, 0), f, response)
    for i in range(n):
        for j in range(n):
            a[i, j] = f[state_index(i, n), state_index(j, n)]
        b[i], e[i] = response[state_index(i, n)], 0.0
    e[PATH_STATE.yaw], e[n - 1] = -period, -0.5 * speed * period * period

"""The parameters of pure pursuit, Stanley and LQR for a car; gains of the LQR by a Riccati equation."""

from __future__ import annotations

import math

from ..controllers import lqr, pure_pursuit, stanley
from ..controllers.contract import COMMON_PARAMETERS
from ..kernel import Row, exported, float64, inlined, int64, local, matrix, packer, record, vector, void
from ..maths.exact import square
from ..maths.exponential import exp, log
from ..maths.matrix_exponential import apply, integrals
from ..models.car import CarRow, SteeringRow
from .car import rear_slip_gradient, understeer_gradient

Common = record("Common", COMMON_PARAMETERS)
"""What the parameters of every law begin with."""
_begin = packer(Common)
PURSUIT, STANLEY = len(pure_pursuit.PARAMETERS), len(stanley.PARAMETERS)
STEERING_DELAY = 0.2
"""s, lag and dead time together of a steering of which nothing is known: published values are 0.1 to 0.5 s."""

MIN_GAIN_SPEED, MAX_GAIN_SPEED, GAIN_SPEED_COUNT = 1.0, 60.0, 21
"""m/s, between which gains are computed at so many speeds, evenly over log v; between them they are interpolated."""
GAIN_DECADES, GAIN_WEIGHTS = 2.0, 9
"""Gains are computed for so many q_e/r and q_heading/r, evenly over so many decades to either side of the own ones."""
MOST_DOUBLINGS = 60
CONVERGED = 1e-14
"""The sum of the magnitudes of a change of P, over that of P."""
LQR_NUMBERS = len(lqr.PARAMETERS) + GAIN_SPEED_COUNT * GAIN_WEIGHTS * GAIN_WEIGHTS * lqr.LQR_STATES
"""Numbers of the LQR."""
_N = lqr.LQR_STATES
_columns, _column, _square = local(_N, 8), local(_N), local(_N, _N)
_doubling = local(7 * _N * _N)


@exported(float64(Row(SteeringRow)))
def steering_delay(steering):
    """Lag and dead time (s) together as far as they are said, else `STEERING_DELAY`."""
    lag, dead = steering.lag, steering.dead_time
    if math.isnan(lag) and math.isnan(dead):
        return STEERING_DELAY
    return (0.0 if math.isnan(lag) else lag) + (0.0 if math.isnan(dead) else dead)


@exported(void(Row(CarRow), Row(Common), vector))
def pure_pursuit_parameters(car, common, parameters):
    """Write `controllers.pure_pursuit.PARAMETERS`."""
    _begin(parameters, 0, common)
    parameters[5], parameters[6] = car.lf + car.lr, car.lr


@exported(void(Row(CarRow), Row(Common), vector))
def stanley_parameters(car, common, parameters):
    """Write `controllers.stanley.PARAMETERS`: the front tyres slip by m l_r/(2 C_f L) for each m/s^2."""
    _begin(parameters, 0, common)
    parameters[5] = car.lf
    parameters[6] = car.mass * car.lr / (2.0 * car.stiffness_front * (car.lf + car.lr))


# -- LQR --------------------------------------------------------------------------------------------------------------
@exported(void(Row(CarRow), float64, matrix, vector))
def lqr_error_model(car, speed, a, b):
    """Write A (4, .) and B (4,) of dx/dt = A x + B delta for x = [e, de/dt, psi_e, dpsi_e/dt] on a straight path.

    e: m, to the left of the path; psi_e: rad, the car's heading less the path's; delta: rad; speed: v (m/s).
    Rajamani, *Vehicle Dynamics and Control*, 2nd ed., eq. (2.45).
    """
    m, inertia = car.mass, car.yaw_inertia
    front, rear = 2.0 * car.stiffness_front, 2.0 * car.stiffness_rear
    both, moment = front + rear, front * car.lf - rear * car.lr
    turning = front * square(car.lf) + rear * square(car.lr)
    for i in range(_N):
        b[i] = 0.0
        for j in range(a.shape[1]):
            a[i, j] = 0.0
    a[0, 1] = a[2, 3] = 1.0
    a[1, 1], a[1, 2], a[1, 3] = -both / (m * speed), both / m, -moment / (m * speed)
    a[3, 1], a[3, 2], a[3, 3] = -moment / (inertia * speed), moment / inertia, -turning / (inertia * speed)
    b[1], b[3] = front / m, front * car.lf / inertia


@exported(void(Row(CarRow), float64, float64, matrix, vector))
def sampled_error_model(car, period, speed, a, b):
    """`lqr_error_model` over one period (s) with the steering held, exactly: A (4, 4), B (4,)."""
    m, rates = _columns(), _column()
    s0, s1, s2, s3 = _columns(), _columns(), _columns(), _columns()
    lqr_error_model(car, speed, m, rates)
    integrals(m, period, s0, s1, s2, s3)
    apply(s1, rates, b)
    for i in range(_N):
        for j in range(_N):
            a[i, j] = s0[i, j]


@inlined
def _times(n, a, b, c):
    """C = A B, (n, n) in a row each."""
    for i in range(n):
        for j in range(n):
            total = 0.0
            for k in range(n):
                total += a[n * i + k] * b[n * k + j]
            c[n * i + j] = total


@inlined
def _exchange(n, i, j, a):
    for k in range(n):
        a[n * i + k], a[n * j + k] = a[n * j + k], a[n * i + k]


@inlined
def _solve(n, w, x, y):
    """X = W^-1 X and Y = W^-1 Y by elimination with the largest pivots; W (n, n) is overwritten."""
    for k in range(n):
        best = k
        for i in range(k + 1, n):
            if abs(w[n * i + k]) > abs(w[n * best + k]):
                best = i
        _exchange(n, k, best, w)
        _exchange(n, k, best, x)
        _exchange(n, k, best, y)
        for i in range(k + 1, n):
            share = w[n * i + k] / w[n * k + k]
            for j in range(k, n):
                w[n * i + j] -= share * w[n * k + j]
            for j in range(n):
                x[n * i + j] -= share * x[n * k + j]
                y[n * i + j] -= share * y[n * k + j]
    for i in range(n - 1, -1, -1):
        for j in range(n):
            for k in range(i + 1, n):
                x[n * i + j] -= w[n * i + k] * x[n * k + j]
                y[n * i + j] -= w[n * i + k] * y[n * k + j]
            x[n * i + j] /= w[n * i + i]
            y[n * i + j] /= w[n * i + i]


@inlined
def _add_turned(n, f, y, z, p):
    """P += F'Y; z: scratch. Sums of the magnitudes of what is added, and of P."""
    change, size = 0.0, 0.0
    for i in range(n):
        for j in range(n):
            total = 0.0
            for k in range(n):
                total += f[n * k + i] * y[n * k + j]
            z[n * i + j] = total
    for i in range(n * n):
        p[i] += z[i]
        change, size = change + abs(z[i]), size + abs(p[i])
    return change, size


@exported(int64(matrix, vector, matrix, matrix, vector))
def riccati(a, b, q, p, work):
    """Write P (n, n) of the discrete algebraic Riccati equation of x' = A x + B u with the cost sum x'Q x + u^2.

    A, Q (n, n), B (n,); work: 7 n^2 numbers. The doublings it took; 0: it does not converge, for the weights are
    further apart than float64 can tell.

        W = I + G P,   G += F W^-1 G F',   P += F' P W^-1 F,   F = F W^-1 F,   from F = A, G = B B', P = Q

    E. K.-W. Chu, H.-Y. Fan, W.-W. Lin, C.-S. Wang, *Structure-preserving algorithms for periodic discrete-time
    algebraic Riccati equations*, Int. J. Control 77 (2004).
    """
    n = b.size
    size = n * n
    f, g, w, solution = work[:size], work[size : 2 * size], work[2 * size : 3 * size], work[3 * size : 4 * size]
    x, y, z = work[4 * size : 5 * size], work[5 * size : 6 * size], work[6 * size : 7 * size]
    for i in range(n):
        for j in range(n):
            f[n * i + j], g[n * i + j], solution[n * i + j] = a[i, j], b[i] * b[j], q[i, j]
    for doublings in range(1, MOST_DOUBLINGS + 1):
        _times(n, g, solution, w)
        for i in range(n):
            w[n * i + i] += 1.0
        for i in range(size):
            x[i], y[i] = f[i], g[i]
        _solve(n, w, x, y)  # W^-1 F, W^-1 G
        _times(n, f, y, w)
        for i in range(n):  # G + F W^-1 G F'
            for j in range(n):
                total = 0.0
                for k in range(n):
                    total += w[n * i + k] * f[n * j + k]
                g[n * i + j] += total
        _times(n, solution, x, y)
        change, entries = _add_turned(n, f, y, z, solution)
        if not entries < math.inf:
            return 0
        if change <= CONVERGED * entries:
            for i in range(n):
                for j in range(n):
                    p[i, j] = solution[n * i + j]
            return doublings
        _times(n, f, x, w)
        for i in range(size):
            f[i] = w[i]
    return 0


@exported(void(matrix, vector, matrix, vector))
def lqr_feedback(a, b, p, gain):
    """Write the gains (n,), (1 + B'PB)^-1 B'PA."""
    n, denominator = b.size, 1.0
    for j in range(n):
        gain[j] = 0.0
    for i in range(n):
        row = 0.0
        for k in range(n):
            row += b[k] * p[k, i]
        denominator += row * b[i]
        for j in range(n):
            gain[j] += row * a[i, j]
    for j in range(n):
        gain[j] /= denominator


@exported(int64(Row(CarRow), Row(Common), vector, vector))
def lqr_parameters(car, common, tuning, parameters):
    """Write `controllers.lqr.PARAMETERS` and the grid of gains, `LQR_NUMBERS` numbers; tuning: `lqr.LQR_TUNING`.

    1; 0: there is no gain for weights so far apart.
    """
    _begin(parameters, 0, common)
    length, steps = car.lf + car.lr, GAIN_DECADES * log(10.0)
    e, heading = log(tuning[0] / tuning[2]) - steps, log(tuning[1] / tuning[2]) - steps
    weight_step = 2.0 * steps / (GAIN_WEIGHTS - 1)
    speed_step = log(MAX_GAIN_SPEED / MIN_GAIN_SPEED) / (GAIN_SPEED_COUNT - 1)
    parameters[5], parameters[6], parameters[7] = length, car.lr, understeer_gradient(car)
    parameters[8] = rear_slip_gradient(car)
    parameters[9], parameters[10], parameters[11] = log(MIN_GAIN_SPEED), speed_step, float(GAIN_SPEED_COUNT)
    parameters[12], parameters[13], parameters[14], parameters[15] = e, heading, weight_step, float(GAIN_WEIGHTS)
    grid, at, fine = parameters[len(lqr.PARAMETERS) :], 0, 1
    a, b, q, p, work = _square(), _column(), _square(), _square(), _doubling()
    for i in range(GAIN_SPEED_COUNT):
        sampled_error_model(car, common.period, exp(log(MIN_GAIN_SPEED) + i * speed_step), a, b)
        for j in range(GAIN_WEIGHTS):
            for k in range(GAIN_WEIGHTS):
                q[0, 0], q[2, 2] = exp(e + j * weight_step), exp(heading + k * weight_step)
                if riccati(a, b, q, p, work) == 0:
                    fine = 0
                lqr_feedback(a, b, p, grid[at : at + _N])
                at += _N
    return fine

"""The parameters of pure pursuit, Stanley and LQR for a car; gains of the LQR by a Riccati equation."""

from __future__ import annotations

import math

from ..controllers import lqr, pure_pursuit, stanley
from ..controllers.contract import COMMON_PARAMETERS
from ..kernel import Row, exported, float64, inlined, int64, local, matrix, packer, record, shaped, vector, void
from ..maths.exact import square
from ..maths.exponential import exp, log
from ..maths.matrices import largest_pivot, product, swap_rows, take_off
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
_doubling = local(6 * _N * _N)


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
def _solve(w, x, y):
    """X = W^-1 X and Y = W^-1 Y by elimination with the largest pivots; W (n, n) is overwritten."""
    n = w.shape[0]
    for k in range(n):
        pivot = largest_pivot(w, k)
        for rows in (w, x, y):
            swap_rows(rows, k, pivot)
        for i in range(k + 1, n):
            share = w[i, k] / w[k, k]
            take_off(w, i, share, k, k)
            take_off(x, i, share, k, 0)
            take_off(y, i, share, k, 0)
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            take_off(x, i, w[i, k], k, 0)
            take_off(y, i, w[i, k], k, 0)
        for j in range(n):
            x[i, j] /= w[i, i]
            y[i, j] /= w[i, i]


@inlined
def _add_turned(f, y, p):
    """P += F'Y. Sums of the magnitudes of what is added, and of P."""
    n, change, size = p.shape[0], 0.0, 0.0
    for i in range(n):
        for j in range(n):
            total = 0.0
            for k in range(n):
                total += f[k, i] * y[k, j]
            p[i, j] += total
            change, size = change + abs(total), size + abs(p[i, j])
    return change, size


@exported(int64(matrix, vector, matrix, matrix, vector))
def riccati(a, b, q, p, work):
    """Write P (n, n) of the discrete algebraic Riccati equation of x' = A x + B u with the cost sum x'Q x + u^2.

    A, Q (n, n), B (n,); work: 6 n^2 numbers at least. The doublings it took; 0: it does not converge, for the weights
    are further apart than float64 can tell.

        W = I + G P,   G += F W^-1 G F',   P += F' P W^-1 F,   F = F W^-1 F,   from F = A, G = B B', P = Q

    E. K.-W. Chu, H.-Y. Fan, W.-W. Lin, C.-S. Wang, *Structure-preserving algorithms for periodic discrete-time
    algebraic Riccati equations*, Int. J. Control 77 (2004).
    """
    n = b.size
    parts = shaped(work[: 6 * n * n], 6, n, n)
    f, g, w, solution, x, y = parts[0], parts[1], parts[2], parts[3], parts[4], parts[5]
    for i in range(n):
        for j in range(n):
            f[i, j], g[i, j], solution[i, j] = a[i, j], b[i] * b[j], q[i, j]
    for doublings in range(1, MOST_DOUBLINGS + 1):
        product(g, solution, w)
        for i in range(n):
            w[i, i] += 1.0
        x[:, :], y[:, :] = f, g
        _solve(w, x, y)  # W^-1 F, W^-1 G
        product(f, y, w)
        for i in range(n):  # G + F W^-1 G F'
            for j in range(n):
                total = 0.0
                for k in range(n):
                    total += w[i, k] * f[j, k]
                g[i, j] += total
        product(solution, x, y)
        change, entries = _add_turned(f, y, solution)
        if not entries < math.inf:
            return 0
        if change <= CONVERGED * entries:
            p[:, :] = solution
            return doublings
        product(f, x, w)
        f[:, :] = w
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

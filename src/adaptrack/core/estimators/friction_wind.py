"""Road friction and side wind from the signals of a car: one step of an extended Kalman filter.

The state z = [v_y (m/s), yaw rate r (rad/s), ln mu, w (m/s), ln s] is that of the single-track vehicle, with what it
meets: friction mu, wind w along +Y, and a factor s on the cornering stiffness of both axles.

    m (dv_y/dt + v_x r) = F_f cos(delta) + F_r + side force(v_y, w)
    I_z dr/dt           = l_f F_f cos(delta) - l_r F_r + yaw moment(v_y, w)

F(alpha, mu, s) is the tyre's law at the static load, alpha the slip angles of eqs. (3) and (4). ln mu, w and ln s are
first-order Gauss-Markov processes: without evidence they return to the nominal friction, to no wind and to the nominal
stiffness, and their standard deviations to the prior ones. Sources: D. Simon, *Optimal State Estimation* (2006),
chapter 13 (the filter); R. Rajamani, *Vehicle Dynamics and Control*, 2nd ed., chapter 2 (the vehicle).

What tells mu from w and s: wind pushes at all times, with force and moment in a fixed proportion; the stiffness acts in
proportion to the slip; friction takes away with the third power of the slip, so that it is seen near the limit alone.
"""

from __future__ import annotations

import math

from ..kernel import exported, float64, inlined, int64, matrix, record, several, unpacker, vector, void
from ..maths.bits import whole
from ..maths.exact import clip, sqrt
from ..maths.exponential import exp, hypot
from ..maths.fast import fast_arctangent_of_ratio, fast_cosine
from ..plants.forces import GRAVITY, SLIP_SPEED_FLOOR, wind_load
from ..plants.parameters import unpack
from ..plants.tyre import CURVED_MAGIC_FORMULA, LINEAR, MAGIC_FORMULA, lateral_force
from .contract import ABSURD

ESTIMATOR_SETTINGS = (
    "steps",  # predictions per control period
    "step",  # s, length of each
    "delay",  # 1: a command takes effect one period after its measurement, 0: at once
    "noise_vy",  # m/s, standard deviation of the measured lateral velocity, > 0
    "noise_yaw_rate",  # rad/s, likewise
    "noise_acceleration",  # m/s^2, likewise
    "drift_vy",  # m/s per step, standard deviation of what the model leaves out
    "drift_yaw_rate",  # rad/s per step
    "tyre_error",  # s per step, likewise of the impulse of an axle, over its force
    "log_friction",  # of the nominal friction
    "friction_spread",  # prior standard deviation of ln mu
    "friction_kept",  # share of a deviation of ln mu from nominal that is left after a step
    "wind_spread",  # m/s, prior standard deviation of w
    "wind_kept",
    "stiffness_spread",  # prior standard deviation of ln s
    "stiffness_kept",
    "log_least_friction",  # ln mu stays within these
    "log_most_friction",
    "most_wind",  # m/s, |w| stays below
)
"""An estimator's settings, fixed over a run, in this order."""
Settings = record("Settings", ESTIMATOR_SETTINGS)
_unpack_settings = unpacker(Settings)

N = 5
VY, YAW_RATE, LOG_FRICTION, WIND, LOG_STIFFNESS = range(N)
"""The state z."""

# What an estimator remembers, a row per slot: the state from 0 on, its covariance by rows, then
COVARIANCE = N
STARTED, ANGLE, WAITING, YAW, SPEED = range(COVARIANCE + N * N, COVARIANCE + N * N + 5)
"""0 before the first step; steering angle of the replica (rad); last command (rad); last yaw and speed."""
FRICTION_HAT, WIND_HAT, FRICTION_STD, WIND_STD = range(SPEED + 1, SPEED + 5)
"""What the step found: mu, w (m/s) and their standard deviations."""
_ROWS = WIND_STD + 1  # scratch: two rows of N, and one
_SEEN = _ROWS + 2 * N
_GAIN = _SEEN + N
MEMORY = _GAIN + N

UNKNOWN_MOTION = 1.0
"""Standard deviation of v_y (m/s) and yaw rate (rad/s) before the first measurement."""
TRUSTED = 4.0
"""Standard deviations of an innovation from which on it is an outlier."""
MOST_STIFFNESS = 3.0
"""Prior standard deviations within which ln s stays."""
_SLIP_STEP, _VELOCITY_STEP = 1e-5, 1e-2  # of the differences that stand for derivatives: rad, m/s


@inlined
def steered(angle, command, time, c):
    """The steering angle (rad) after a time (s) under a constant command: the exact flow of `steering_rate`.

    At the rate limit until the gap is rate times lag, then the gap decays exponentially.
    """
    target = clip(command, -c.steering_limit, c.steering_limit)
    gap = target - angle
    limited = 0.0
    if c.steering_lag > 0.0 and abs(gap) > c.steering_rate * c.steering_lag:
        limited = min(time, abs(gap) / c.steering_rate - c.steering_lag)
        gap -= math.copysign(c.steering_rate * limited, gap)
    return target - gap * exp((limited - time) / max(c.steering_lag, 1e-9))


@inlined
def _axle(slip, steer, load, friction, stiffness, c, law):
    """Force of an axle's two tyres (N) across the body, and its derivatives by slip angle, ln mu and ln s.

    steer: angle of the wheels to the body (rad). The Magic Formula is mu times a function of s slip/mu, the linear law
    is proportional to mu s slip: the derivative by the slip angle holds the other two.
    """
    across = fast_cosine(steer)
    force = 2.0 * across * lateral_force(slip, load, friction, stiffness, c, law)
    more = lateral_force(slip + _SLIP_STEP, load, friction, stiffness, c, law)
    less = lateral_force(slip - _SLIP_STEP, load, friction, stiffness, c, law)
    by_slip = across * (more - less) * (1.0 / _SLIP_STEP)
    by_stiffness = by_slip * slip
    return force, by_slip, (force if law == LINEAR else force - by_stiffness), by_stiffness


@exported(
    several(float64, float64, float64, float64)(float64, float64, float64, vector, vector), name="tyre_accelerations"
)
def accelerations(angle, yaw, vx, p, own):
    """Lateral (m/s^2) and yaw acceleration (rad/s^2) under a steering angle, and the forces of both axles (N).

    The derivatives of both accelerations by z are written to the rows of scratch. own: a row of memory, of which z is
    read; p: the vehicle, see `plants.parameters`.
    """
    c = unpack(p)
    law = LINEAR if c.tyre_linear > 0.5 else (MAGIC_FORMULA if c.curvature == 0.0 else CURVED_MAGIC_FORMULA)
    vy, r, wind = own[VY], own[YAW_RATE], own[WIND]
    friction, factor = exp(own[LOG_FRICTION]), exp(own[LOG_STIFFNESS])
    weight = 0.5 * c.mass * GRAVITY / (c.lf + c.lr)
    speed = max(vx, SLIP_SPEED_FLOOR)
    side_f, side_r = vy + c.lf * r, vy - c.lr * r
    slip_f = angle - fast_arctangent_of_ratio(side_f, speed)
    slip_r = -fast_arctangent_of_ratio(side_r, speed)
    stiff_f, stiff_r = factor * c.stiffness_front, factor * c.stiffness_rear
    front, front_slip, front_mu, front_s = _axle(slip_f, angle, weight * c.lr, friction, stiff_f, c, law)
    rear, rear_slip, rear_mu, rear_s = _axle(slip_r, 0.0, weight * c.lf, friction, stiff_r, c, law)
    front_vy = -front_slip * speed / (speed * speed + side_f * side_f)
    rear_vy = -rear_slip * speed / (speed * speed + side_r * side_r)

    side, moment, _ = wind_load(yaw, vx, vy, 0.0, wind, c)
    half = 1.0 / (2.0 * _VELOCITY_STEP)
    side_more, moment_more, _ = wind_load(yaw, vx, vy + _VELOCITY_STEP, 0.0, wind, c)
    side_less, moment_less, _ = wind_load(yaw, vx, vy - _VELOCITY_STEP, 0.0, wind, c)
    side_vy, moment_vy = (side_more - side_less) * half, (moment_more - moment_less) * half
    side_more, moment_more, _ = wind_load(yaw, vx, vy, 0.0, wind + _VELOCITY_STEP, c)
    side_less, moment_less, _ = wind_load(yaw, vx, vy, 0.0, wind - _VELOCITY_STEP, c)
    side_wind, moment_wind = (side_more - side_less) * half, (moment_more - moment_less) * half

    by_mass, by_inertia = 1.0 / c.mass, 1.0 / c.yaw_inertia
    own[_ROWS + VY] = (front_vy + rear_vy + side_vy) * by_mass
    own[_ROWS + YAW_RATE] = (c.lf * front_vy - c.lr * rear_vy) * by_mass
    own[_ROWS + LOG_FRICTION] = (front_mu + rear_mu) * by_mass
    own[_ROWS + WIND] = side_wind * by_mass
    own[_ROWS + LOG_STIFFNESS] = (front_s + rear_s) * by_mass
    own[_ROWS + N + VY] = (c.lf * front_vy - c.lr * rear_vy + moment_vy) * by_inertia
    own[_ROWS + N + YAW_RATE] = (c.lf * c.lf * front_vy + c.lr * c.lr * rear_vy) * by_inertia
    own[_ROWS + N + LOG_FRICTION] = (c.lf * front_mu - c.lr * rear_mu) * by_inertia
    own[_ROWS + N + WIND] = moment_wind * by_inertia
    own[_ROWS + N + LOG_STIFFNESS] = (c.lf * front_s - c.lr * rear_s) * by_inertia
    return (front + rear + side) * by_mass, (c.lf * front - c.lr * rear + moment) * by_inertia, front, rear


@exported(void(float64, float64, float64, vector, vector, vector))
def predict(angle, yaw, vx, p, settings, own):
    """Carry z and its covariance over one step, under the steering angle, yaw and speed of its middle.

    v_y and r by the linearised trapezoidal rule, (I - T/2 A) dx = T f with A = df/dx, stable at any speed; the others
    by their exact decay. Covariance: Phi P Phi' + Q with the Jacobian Phi of this map.
    """
    s = _unpack_settings(settings)
    lateral, yawing, front, rear = accelerations(angle, yaw, vx, p, own)
    own[_ROWS + YAW_RATE] -= vx  # from here on the row is that of dv_y/dt
    half = 0.5 * s.step
    a, b = half * own[_ROWS + VY], half * own[_ROWS + YAW_RATE]
    c, d = half * own[_ROWS + N + VY], half * own[_ROWS + N + YAW_RATE]
    scale = 1.0 / ((1.0 - a) * (1.0 - d) - b * c)
    vy_v, vy_r, r_v, r_r = (1.0 - d) * scale, b * scale, c * scale, (1.0 - a) * scale  # inverse of I - T/2 A
    slide, turn = s.step * (lateral - vx * own[YAW_RATE]), s.step * yawing
    own[VY] += vy_v * slide + vy_r * turn
    own[YAW_RATE] += r_v * slide + r_r * turn
    for j in range(N):
        upper, lower = s.step * own[_ROWS + j], s.step * own[_ROWS + N + j]
        own[_ROWS + j] = vy_v * upper + vy_r * lower + (1.0 if j == VY else 0.0)
        own[_ROWS + N + j] = r_v * upper + r_r * lower + (1.0 if j == YAW_RATE else 0.0)
    own[LOG_FRICTION] = s.log_friction + s.friction_kept * (own[LOG_FRICTION] - s.log_friction)
    own[WIND] *= s.wind_kept
    own[LOG_STIFFNESS] *= s.stiffness_kept

    kept = (0.0, 0.0, s.friction_kept, s.wind_kept, s.stiffness_kept)
    spread = (0.0, 0.0, s.friction_spread, s.wind_spread, s.stiffness_spread)
    for j in range(N):  # column by column, Phi P in the place of P
        upper, lower = 0.0, 0.0
        for i in range(N):
            upper += own[_ROWS + i] * own[COVARIANCE + N * i + j]
            lower += own[_ROWS + N + i] * own[COVARIANCE + N * i + j]
        own[COVARIANCE + j], own[COVARIANCE + N + j] = upper, lower
        for i in range(2, N):
            own[COVARIANCE + N * i + j] *= kept[i]
    for i in range(N):  # row by row, its product with Phi'
        row = COVARIANCE + N * i
        upper, lower = 0.0, 0.0
        for j in range(N):
            upper += own[_ROWS + j] * own[row + j]
            lower += own[_ROWS + N + j] * own[row + j]
        own[row], own[row + 1] = upper, lower
        for j in range(2, N):
            own[row + j] *= kept[j]
    v = unpack(p)
    front, rear = s.tyre_error * front, s.tyre_error * rear
    push = hypot(front, rear) / v.mass
    twist = hypot(v.lf * front, v.lr * rear) / v.yaw_inertia
    own[COVARIANCE] += s.drift_vy * s.drift_vy + push * push
    own[COVARIANCE + N + 1] += s.drift_yaw_rate * s.drift_yaw_rate + twist * twist
    own[COVARIANCE + N] += (v.lf * front * front - v.lr * rear * rear) / (v.mass * v.yaw_inertia)
    for i in range(2, N):
        own[COVARIANCE + (N + 1) * i] += spread[i] * spread[i] * (1.0 - kept[i] * kept[i])
    for i in range(N):
        for j in range(i):
            own[COVARIANCE + N * j + i] = own[COVARIANCE + N * i + j]


@exported(void(float64, float64, vector))
def correct(innovation, deviation, own):
    """Take in one scalar measurement h(z), of noise `deviation`; dh/dz stands in `own` from _SEEN on.

    z += K innovation and P -= K (P H')' with K = P H'/S, S = H P H' + deviation^2. Beyond `TRUSTED` standard deviations
    S grows with the innovation, so that an outlier moves no more than an innovation of that size (Huber's weight). What
    is absurd, or no number, changes nothing.
    """
    if not abs(innovation) < ABSURD:
        return
    variance = deviation * deviation
    for i in range(N):
        total = 0.0
        for j in range(N):
            total += own[COVARIANCE + N * i + j] * own[_SEEN + j]
        own[_GAIN + i] = total
        variance += total * own[_SEEN + i]
    variance *= max(1.0, abs(innovation) / (TRUSTED * sqrt(variance)))
    for i in range(N):
        gain = own[_GAIN + i] * (1.0 / variance)
        own[i] += gain * innovation
        for j in range(N):
            own[COVARIANCE + N * i + j] -= gain * own[_GAIN + j]


@exported(void(int64, vector, float64, float64, float64, vector, vector, matrix))
def estimate(slot, measured, speed, command, acceleration, p, settings, memory):
    """One step of the estimator of a slot, at a control instant before the controller's step.

    measured: x_c = [v_y, yaw, yaw rate, y]; speed: v_x (m/s); command: the controller's last steering command (rad);
    acceleration: measured lateral acceleration (m/s^2), NaN where there is no such sensor; p: the vehicle that the
    estimator believes in, packed as a plant (`plants.parameters`); settings: see ESTIMATOR_SETTINGS. A row of zeros
    in memory (slots, MEMORY) is an estimator before its first step; its row then holds the state and FRICTION_HAT, ...

    A measurement that is absurd or not a number is left out; in the place of yaw, speed or command the last one stands.
    A filter that has lost itself begins anew.
    """
    own = memory[slot]
    s = _unpack_settings(settings)
    yaw = measured[1] if abs(measured[1]) < ABSURD else own[YAW]
    speed = speed if abs(speed) < ABSURD else own[SPEED]
    command = command if abs(command) < ABSURD else own[WAITING]
    if own[STARTED] > 0.5 and abs(own[VY]) < ABSURD and abs(own[YAW_RATE]) < ABSURD:
        c = unpack(p)
        acting = own[WAITING] if s.delay > 0.5 else command
        for i in range(whole(s.steps)):
            share = (i + 0.5) / s.steps
            middle = steered(own[ANGLE], acting, 0.5 * s.step, c)
            own[ANGLE] = steered(own[ANGLE], acting, s.step, c)
            turned, driven = share * (yaw - own[YAW]), share * (speed - own[SPEED])
            predict(middle, own[YAW] + turned, own[SPEED] + driven, p, settings, own)
    else:
        own[: COVARIANCE + N * N] = 0.0
        own[STARTED] = 1.0
        own[LOG_FRICTION] = s.log_friction
        spread = (UNKNOWN_MOTION, UNKNOWN_MOTION, s.friction_spread, s.wind_spread, s.stiffness_spread)
        for i in range(N):
            own[COVARIANCE + (N + 1) * i] = spread[i] * spread[i]
    own[WAITING], own[YAW], own[SPEED] = command, yaw, speed

    for j in range(N):
        own[_SEEN + j] = 1.0 if j == VY else 0.0
    correct(measured[0] - own[VY], s.noise_vy, own)
    own[_SEEN + VY], own[_SEEN + YAW_RATE] = 0.0, 1.0
    correct(measured[2] - own[YAW_RATE], s.noise_yaw_rate, own)
    if abs(acceleration) < ABSURD:
        lateral, _, _, _ = accelerations(own[ANGLE], yaw, speed, p, own)
        for j in range(N):
            own[_SEEN + j] = own[_ROWS + j]
        correct(acceleration - lateral, s.noise_acceleration, own)

    own[LOG_FRICTION] = clip(own[LOG_FRICTION], s.log_least_friction, s.log_most_friction)
    own[WIND] = clip(own[WIND], -s.most_wind, s.most_wind)
    most = MOST_STIFFNESS * s.stiffness_spread
    own[LOG_STIFFNESS] = clip(own[LOG_STIFFNESS], -most, most)
    own[FRICTION_HAT], own[WIND_HAT] = exp(own[LOG_FRICTION]), own[WIND]
    own[FRICTION_STD] = own[FRICTION_HAT] * sqrt(own[COVARIANCE + (N + 1) * LOG_FRICTION])
    own[WIND_STD] = sqrt(own[COVARIANCE + (N + 1) * WIND])

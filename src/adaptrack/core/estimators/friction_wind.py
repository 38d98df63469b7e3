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
proportion to the slip; friction takes away with the third power of the slip, so that it shows near the limit alone.
"""

from __future__ import annotations

import math

from ..kernel import (
    Field,
    defaults,
    exported,
    float64,
    inlined,
    int64,
    local,
    matrix,
    record,
    rows,
    several,
    vector,
    viewer,
    void,
)
from ..maths.bits import whole
from ..maths.exact import clip, sqrt
from ..maths.exponential import exp, hypot
from ..maths.fast import fast_arctangent_of_ratio, fast_cosine
from ..maths.vectors import VECTOR_WIDTH
from ..models.car import unpack
from ..models.contract import MEASUREMENT
from ..physics.forces import GRAVITY, SLIP_SPEED_FLOOR, wind_load
from ..physics.tyre import LINEAR_TYRE, lateral_force, tyre_law
from .extended_kalman import IMPOSSIBLE_SIGNAL, carry, correct, scatter, step_motion

FrictionWindPrior = record("FrictionWindPrior", (
    Field("nominal_friction", "", 0.65, "median of friction, to which it returns without evidence"),
    Field("friction_spread", "", 0.33, "standard deviation of ln(friction): friction from 0.3 to 1"),
    Field("friction_time", "s", 8.0, "correlation time of friction"),
    Field("friction_range", "", (0.1, 1.5), "of the estimate"),
    Field("wind_spread", "m/s", 12.0, "standard deviation of the wind: gusts up to 30 m/s"),
    Field("wind_time", "s", 3.0, "correlation time of a gust"),
    Field("most_wind", "m/s", 60.0, "largest estimate to either side"),
    Field("stiffness_spread", "", 0.05, "standard deviation of ln(stiffness): how well tyres are known"),
    Field("stiffness_time", "s", 600.0, "correlation time of the stiffness, which hardly changes in a drive"),
    Field("tyre_error", "s^0.5", 0.02, "white noise on the lateral force of an axle, over that force"),
    Field("drift_vy", "m/s per s^0.5", 0.02, "random walk of the lateral velocity beyond the model"),
    Field("drift_yaw_rate", "rad/s per s^0.5", 0.006, "random walk of the yaw rate beyond the model"),
))  # fmt: skip
"""Constants of the estimator: ln(friction), wind and ln(stiffness) are Gauss-Markov processes."""
DEFAULT_PRIOR = defaults(FrictionWindPrior)

FrictionWindSettings = record("FrictionWindSettings", (
    ("prior", FrictionWindPrior),
    "steps",  # predictions per control period
    "step",  # s, length of each
    "delay",  # 1: a command takes effect one period after its measurement, 0: at once
    "noise_vy", "noise_yaw_rate", "noise_acceleration",  # m/s, rad/s, m/s^2: standard deviations of the sensors, > 0
    "drift_vy", "drift_yaw_rate",  # m/s, rad/s: standard deviations of what the model leaves out in a step
    "tyre_error",  # s, standard deviation of the impulse of an axle in a step, over its force
    "log_friction",  # of the nominal friction
    "log_least_friction", "log_most_friction",  # ln mu stays within these
    "friction_left", "wind_left", "stiffness_left",  # shares of a deviation that remain after a step
))  # fmt: skip
"""An estimator's settings, fixed over a run."""
_settings_of = viewer(FrictionWindSettings)

N = 5
VY_STATE, YAW_RATE_STATE, LOG_FRICTION, WIND_STATE, LOG_STIFFNESS = range(N)
"""Places in the state z."""

Memory = record("Memory", (
    "started",  # 0 before the first step
    "angle",  # rad, steering angle of the replica
    "waiting",  # rad, last command
    "yaw", "speed",  # rad, m/s: the last ones
    ("z", (float64, VECTOR_WIDTH)), ("covariance", (float64, N, VECTOR_WIDTH)),
    "friction", "wind", "friction_std", "wind_std",  # what the step found: mu, w (m/s), their standard deviations
))  # fmt: skip
"""What an estimator remembers."""
_states, _motion = local(VECTOR_WIDTH), local(2, VECTOR_WIDTH)

UNKNOWN_MOTION = 1.0
"""Standard deviation of v_y (m/s) and yaw rate (rad/s) before the first measurement."""
TRUSTED = 4.0
"""Standard deviations of an innovation from which on it is an outlier."""
MAX_STIFFNESS_SIGMAS = 3.0
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
    force_above = lateral_force(slip + _SLIP_STEP, load, friction, stiffness, c, law)
    force_below = lateral_force(slip - _SLIP_STEP, load, friction, stiffness, c, law)
    by_slip = across * (force_above - force_below) * (1.0 / _SLIP_STEP)
    by_stiffness = by_slip * slip
    return force, by_slip, (force if law == LINEAR_TYRE else force - by_stiffness), by_stiffness


@exported(
    several(float64, float64, float64, float64)(float64, float64, float64, vector, vector, matrix),
    name="tyre_accelerations",
)
def accelerations(angle, yaw, vx, p, z, slopes):
    """Lateral (m/s^2) and yaw acceleration (rad/s^2) under a steering angle, and the forces of both axles (N).

    The derivatives of both accelerations by z are written to slopes (2, 8); p: of the vehicle, `PlantParameters`.
    """
    c = unpack(p)
    law = tyre_law(c.tyre_linear > 0.5, c.curvature)
    vy, r, wind = z[VY_STATE], z[YAW_RATE_STATE], z[WIND_STATE]
    friction, factor = exp(z[LOG_FRICTION]), exp(z[LOG_STIFFNESS])
    weight = 0.5 * c.mass * GRAVITY / (c.lf + c.lr)
    speed = max(vx, SLIP_SPEED_FLOOR)
    side_f, side_r = vy + c.lf * r, vy - c.lr * r
    slip_f = angle - fast_arctangent_of_ratio(side_f, speed)
    slip_r = -fast_arctangent_of_ratio(side_r, speed)
    stiff_f, stiff_r = factor * c.stiffness_front, factor * c.stiffness_rear
    by_front, by_rear, by_side, by_moment = _states(), _states(), _states(), _states()
    front, slope_f, by_front[LOG_FRICTION], by_front[LOG_STIFFNESS] = _axle(
        slip_f, angle, weight * c.lr, friction, stiff_f, c, law
    )
    rear, slope_r, by_rear[LOG_FRICTION], by_rear[LOG_STIFFNESS] = _axle(
        slip_r, 0.0, weight * c.lf, friction, stiff_r, c, law
    )
    by_front[VY_STATE] = -slope_f * speed / (speed * speed + side_f * side_f)
    by_rear[VY_STATE] = -slope_r * speed / (speed * speed + side_r * side_r)
    by_front[YAW_RATE_STATE], by_rear[YAW_RATE_STATE] = c.lf * by_front[VY_STATE], -c.lr * by_rear[VY_STATE]

    side, moment, _ = wind_load(yaw, vx, vy, 0.0, wind, c)
    half = 1.0 / (2.0 * _VELOCITY_STEP)
    for state, dv, dw in ((VY_STATE, _VELOCITY_STEP, 0.0), (WIND_STATE, 0.0, _VELOCITY_STEP)):
        side_more, moment_more, _ = wind_load(yaw, vx, vy + dv, 0.0, wind + dw, c)
        side_less, moment_less, _ = wind_load(yaw, vx, vy - dv, 0.0, wind - dw, c)
        by_side[state], by_moment[state] = (side_more - side_less) * half, (moment_more - moment_less) * half

    by_mass, by_inertia = 1.0 / c.mass, 1.0 / c.yaw_inertia
    for j in range(N):
        slopes[VY_STATE, j] = (by_front[j] + by_rear[j] + by_side[j]) * by_mass
        slopes[YAW_RATE_STATE, j] = (c.lf * by_front[j] - c.lr * by_rear[j] + by_moment[j]) * by_inertia
    return (front + rear + side) * by_mass, (c.lf * front - c.lr * rear + moment) * by_inertia, front, rear


@inlined
def _added_variance(spread, left):
    """Variance that a step adds to a Gauss-Markov process of which a share is left after it."""
    return spread * spread * (1.0 - left * left)


@inlined
def _predict(angle, yaw, vx, p, s, m):
    """Carry z and its covariance over one step, under the steering angle, yaw and speed of its middle; s: settings.

    v_y and r by the linearised trapezoidal rule, the others by their exact decay. Covariance: Phi P Phi' + Q with the
    Jacobian Phi of this map.
    """
    z, P, slopes, mixed = m.z, m.covariance, _motion(), _motion()
    lateral, yawing, front, rear = accelerations(angle, yaw, vx, p, z, slopes)
    slopes[VY_STATE, YAW_RATE_STATE] -= vx  # from here on the row is that of dv_y/dt
    step_motion(lateral - vx * z[YAW_RATE_STATE], yawing, s.step, slopes, N, z, mixed)
    z[LOG_FRICTION] = s.log_friction + s.friction_left * (z[LOG_FRICTION] - s.log_friction)
    z[WIND_STATE] *= s.wind_left
    z[LOG_STIFFNESS] *= s.stiffness_left

    left = _states()
    left[LOG_FRICTION], left[WIND_STATE], left[LOG_STIFFNESS] = s.friction_left, s.wind_left, s.stiffness_left
    carry(mixed, left, P, _motion())
    v = unpack(p)
    front, rear = s.tyre_error * front, s.tyre_error * rear
    push = hypot(front, rear) / v.mass
    twist = hypot(v.lf * front, v.lr * rear) / v.yaw_inertia
    both = (v.lf * front * front - v.lr * rear * rear) / (v.mass * v.yaw_inertia)
    P[VY_STATE, VY_STATE] += s.drift_vy * s.drift_vy + push * push
    P[VY_STATE, YAW_RATE_STATE] += both
    P[YAW_RATE_STATE, VY_STATE] += both
    P[YAW_RATE_STATE, YAW_RATE_STATE] += s.drift_yaw_rate * s.drift_yaw_rate + twist * twist
    P[LOG_FRICTION, LOG_FRICTION] += _added_variance(s.prior.friction_spread, s.friction_left)
    P[WIND_STATE, WIND_STATE] += _added_variance(s.prior.wind_spread, s.wind_left)
    P[LOG_STIFFNESS, LOG_STIFFNESS] += _added_variance(s.prior.stiffness_spread, s.stiffness_left)


@inlined
def _take_in(innovation, deviation, h, m):
    """Correct z by a sensor of a standard deviation; h: derivatives of its reading over z.

    Beyond `TRUSTED` standard deviations the variance of the innovation grows with it, so that an outlier moves no more
    than an innovation of that size (Huber's weight). What is absurd, or no number, changes nothing.
    """
    if not abs(innovation) < IMPOSSIBLE_SIGNAL:
        return
    cross = _states()
    variance = scatter(deviation * deviation, h, m.covariance, cross)
    variance *= max(1.0, abs(innovation) / (TRUSTED * sqrt(variance)))
    correct(innovation, variance, cross, m.z, m.covariance)


@inlined
def _begin(s, m):
    """Before the first measurement."""
    spread = _states()
    spread[VY_STATE], spread[YAW_RATE_STATE] = UNKNOWN_MOTION, UNKNOWN_MOTION
    spread[LOG_FRICTION], spread[WIND_STATE] = s.prior.friction_spread, s.prior.wind_spread
    spread[LOG_STIFFNESS] = s.prior.stiffness_spread
    m.z[:], m.covariance[:, :] = 0.0, 0.0
    for i in range(N):
        m.covariance[i, i] = spread[i] * spread[i]
    m.z[LOG_FRICTION] = s.log_friction
    m.started = 1.0


@exported(void(int64, vector, float64, float64, float64, vector, vector, rows(Memory)))
def estimate(slot, measured, speed, command, acceleration, p, settings, memory):
    """One step of the estimator of a slot, at a control instant before the controller's step.

    measured: x_c = [v_y, yaw, yaw rate, y]; speed: v_x (m/s); command: the controller's last steering command (rad);
    acceleration: measured lateral acceleration (m/s^2), NaN where there is no such sensor; p: the vehicle that the
    estimator believes in, packed as a plant (`models.car.PlantParameters`); settings: numbers of
    `FrictionWindSettings`. A row of zeros in memory (slots,) is an estimator before its first step.

    A measurement that is absurd or not a number is left out; in the place of yaw, speed or command the last one stands.
    A filter whose state or variances are not finite begins anew.
    """
    m = memory[slot]
    z, P, s = m.z, m.covariance, _settings_of(settings, 0)
    yaw = measured[MEASUREMENT.yaw] if abs(measured[MEASUREMENT.yaw]) < IMPOSSIBLE_SIGNAL else m.yaw
    speed = speed if abs(speed) < IMPOSSIBLE_SIGNAL else m.speed
    command = command if abs(command) < IMPOSSIBLE_SIGNAL else m.waiting
    if m.started > 0.5 and abs(z[VY_STATE]) < IMPOSSIBLE_SIGNAL and abs(z[YAW_RATE_STATE]) < IMPOSSIBLE_SIGNAL:
        c = unpack(p)
        acting = m.waiting if s.delay > 0.5 else command
        for i in range(whole(s.steps)):
            share = (i + 0.5) / s.steps
            middle = steered(m.angle, acting, 0.5 * s.step, c)
            m.angle = steered(m.angle, acting, s.step, c)
            turned, gained = share * (yaw - m.yaw), share * (speed - m.speed)
            _predict(middle, m.yaw + turned, m.speed + gained, p, s, m)
    else:
        _begin(s, m)
    m.waiting, m.yaw, m.speed = command, yaw, speed

    for state, sensor, noise in (
        (VY_STATE, MEASUREMENT.vy, s.noise_vy),
        (YAW_RATE_STATE, MEASUREMENT.yaw_rate, s.noise_yaw_rate),
    ):
        h = _states()
        h[state] = 1.0
        _take_in(measured[sensor] - z[state], noise, h, m)
    if abs(acceleration) < IMPOSSIBLE_SIGNAL:
        slopes, h = _motion(), _states()
        lateral, _, _, _ = accelerations(m.angle, yaw, speed, p, z, slopes)
        for j in range(N):
            h[j] = slopes[VY_STATE, j]
        _take_in(acceleration - lateral, s.noise_acceleration, h, m)

    z[LOG_FRICTION] = clip(z[LOG_FRICTION], s.log_least_friction, s.log_most_friction)
    z[WIND_STATE] = clip(z[WIND_STATE], -s.prior.most_wind, s.prior.most_wind)
    most = MAX_STIFFNESS_SIGMAS * s.prior.stiffness_spread
    z[LOG_STIFFNESS] = clip(z[LOG_STIFFNESS], -most, most)
    m.friction, m.wind = exp(z[LOG_FRICTION]), z[WIND_STATE]
    m.friction_std = m.friction * sqrt(P[LOG_FRICTION, LOG_FRICTION])
    m.wind_std = sqrt(P[WIND_STATE, WIND_STATE])

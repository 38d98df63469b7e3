"""Innovations of a Kalman filter along a log: what the likelihood of a car's quantities is made of.

The filter's state is [v_y (m/s), yaw rate r (rad/s), relaxed slips s_f and s_r (-), yaw (rad), wind w and g
(m/s), push d (m/s^2)]. It is that of the single-track vehicle behind its steering:

    m (dv_y/dt + v r) = F_f(a_f) + F_r(a_r) + s (f(w_0) + f' w - v v_y) + m (d_0 + d + c v r)
    I_z dr/dt         = l_f F_f - l_r F_r + (t + s z) (f(w_0) + f' w - v v_y) + white noise
    ds_f/dt           = (v/sigma) (tan(delta) - (v_y + l_f r)/v - s_f),   a_f = delta - atan(tan(delta) - s_f)
    ds_r/dt           = (v/sigma) (-(v_y - l_r r)/v - s_r),               a_r = atan(s_r)
    ddelta/dt         = (gain command(t - dead time) + offset - delta)/lag

The lateral part of the front force is cos(delta) F_f, to which front wheels that keep the speed add up to
sin(delta) tan(delta) F_f: with the driven axle unknown, F_f lies in the middle.
F is the Magic Formula D sin(C atan(S a/(C D))) with the axle's stiffness S and D = mu m g times its share of the load
(Pacejka, *Tire and Vehicle Dynamics*, 3rd ed., eq. 4.E19); f = (v^2 + W^2) limit tanh(atan(W/v)/limit)
is the load of a side wind W, as in `physics.forces`. w and d are Gauss-Markov processes, w of second order
(T_1 dw/dt = g - w, T_2 dg/dt = -g + white noise), as gusts are more or less smooth (T_1 << T_2: not at all): what
no log tells of side wind and bank is noise of the process, without which estimates are biased by the driver's answer
to it and standard errors too small. c is the bank of bends. What is measured of the motion is late against the wheels:
the car then follows the wheels of that much earlier. delta
has no noise: it follows from the commands alone, in closed form, each held until the next; within a step it acts as
the straight line of the same mean and first moment (its mean alone makes the dead time of stiff cars 5 ms too long).
Sources: L. Ljung, *System Identification*, 2nd ed., section 7.4 (likelihood of innovations); D. Simon, *Optimal State
Estimation* (2006), chapters 5 and 13 (the filter).
"""

from __future__ import annotations

import math

from ..estimators.extended_kalman import carry, correct, scatter
from ..kernel import columns, exported, inlined, local, matrix, record, vector, viewer, void
from ..maths.bits import whole
from ..maths.exact import ceil, square
from ..maths.exponential import exp, tanh
from ..maths.matrix_exponential import apply, integrals
from ..maths.trigonometric import atan, cos, sin
from ..models.car import ACTUATOR_DEAD_TIME, ACTUATOR_LAG, ACTUATOR_RATE, BODY
from ..physics.forces import GRAVITY, SLIP_SPEED_FLOOR
from ..physics.tyre import curve, force_and_slope

Quantities = record("Quantities", (
    ACTUATOR_LAG, ACTUATOR_DEAD_TIME, ACTUATOR_RATE,  # of the steering
    "lateness",  # s, of all that is measured of the motion, against the wheels
    "gain", "offset",  # -, rad: road wheels over command
    "wheel_gain",  # -, road wheels over their measured angle
    "front", "rear",  # N/rad, cornering stiffness of the axles
    *BODY,
    "relaxation", "friction", "shape_factor",  # m, -, -: of the tyres
    "side", "moment", "wind_angle_limit",  # N s^2/m^2, N s^2/m: of the wind, s and t; rad
    "lever",  # m, by which the side force acts before where the car's moment has it
    "wind_mean", "wind_spread", "wind_time", "wind_rise",  # m/s, m/s, s, s: the gusts' longer and shorter time constant
    "push_mean", "push_spread", "push_time",  # m/s^2, m/s^2, s
    "superelevation",  # -, share of v r that the bank of bends gives
    "jolt",  # rad/s^2 per root Hz, white
    "noise_yaw_rate", "noise_vy", "noise_acceleration", "noise_yaw", "noise_wheel",  # rad/s, m/s, m/s^2, rad, rad
    "gyro_offset", "acceleration_offset", "wheel_offset",  # rad/s, m/s^2, rad
    "vy_ahead", "vy_turned",  # m, rad: place of the sensor of v_y before the centre of mass, its turn
))  # fmt: skip
"""A car, its sensors and what disturbs it."""
_quantities_of = viewer(Quantities)
LOG_ROW = columns(
    "time", "command", "speed", "yaw_rate", "vy", "acceleration", "yaw", "wheel", "begins", "used", "gusts"
)
"""Rows of a log: s, rad, m/s, then what is measured (NaN: not), then 1 where a segment begins, and 1 where the filter
takes the sample in (else it only predicts), and the factor on the spread of the wind's noise until the sample."""
OUTPUT = columns("yaw_rate", "vy", "acceleration", "yaw", "wheel")
"""What is predicted. The answer has a row for each innovation, then one for each of their variances, then `FOUND`."""
FOUND = columns("wind", "wheel_angle", "front_slip", "rear_slip")
"""m/s, rad, -, -: what the filter finds at each sample: gusts beside the mean, wheels, slips."""
IDENTIFICATION_ANSWER = 2 * len(OUTPUT) + len(FOUND)
_STATE = columns("vy", "yaw_rate", "slip_front", "slip_rear", "yaw", "wind", "gust", "push")
"""The first four obey dv/dt = M v + n_0 + n_1 t within a step. g is the gust that the wind w follows."""
_CAR, _MIXED, _N = 4, 6, len(_STATE)
_vector, _covariance, _transition = local(_N), local(_N, _N), local(_MIXED, _N)
_square, _column = local(_CAR, _N), local(_CAR)
FLOOR = 1e-10
"""Added to the variance of every measurement: 1e-5 of its unit, for logs of simulations without noise."""
TYPICAL_GUST = 12.0
"""m/s, at which the load of the gusts is linearised: f(W)/W is their slope."""
MAX_IDENTIFICATION_STEP = 0.051
"""s"""


@inlined
def _tyre(slip, load, stiffness, q):
    """Force (N) and slope (N/rad) of an axle; the slope is at least 2 % of that at no slip."""
    force, slope = force_and_slope(slip, curve(load, stiffness, q.friction, q.shape_factor))
    return force, max(slope, 0.02 * stiffness)


@inlined
def _steady_wind(speed, wind, limit):
    """(v^2 + W^2) times the angle of a side wind W (m/s), smoothly limited."""
    return (speed * speed + wind * wind) * limit * tanh(atan(wind / speed) / limit)


@inlined
def _move_wheels(angle, target, lag, rate, span):
    """Wheel angle (rad) after a time (s) towards a target; its integral (rad s) and first moment (rad s^2) over it."""
    gap, area, moment, begun = target - angle, 0.0, 0.0, 0.0
    limited = max(0.0, min(span, abs(gap) / rate - lag))
    if limited > 0.0:
        step = math.copysign(rate * limited, gap)
        area = (angle + 0.5 * step) * limited
        moment = (0.5 * angle + step / 3.0) * limited * limited
        angle += step
        gap -= step
        span -= limited
        begun = limited
    decay = exp(-span / lag)
    steady = target * span - gap * lag * (1.0 - decay)
    moment += begun * steady + 0.5 * target * span * span - gap * lag * (lag * (1.0 - decay) - span * decay)
    return target - gap * decay, area + steady, moment


@inlined
def _axles(q, x, angle):
    """Lateral force (N) and its slope over the state (N), front at a wheel angle (rad), and rear."""
    load, slip_rear = q.mass * GRAVITY / (q.lf + q.lr), x[_STATE.slip_rear]
    course = sin(angle) / cos(angle) - x[_STATE.slip_front]
    front, slope_front = _tyre(angle - atan(course), load * q.lr, q.front, q)
    rear, slope_rear = _tyre(atan(slip_rear), load * q.lf, q.rear, q)
    return front, slope_front / (1.0 + square(course)), rear, slope_rear / (1.0 + square(slip_rear))


@inlined
def _wind(q, speed):
    """Load of the mean wind and its slope over gusts, for `side` and `moment`."""
    slope = _steady_wind(speed, TYPICAL_GUST, q.wind_angle_limit) / TYPICAL_GUST
    return _steady_wind(speed, q.wind_mean, q.wind_angle_limit), slope


@inlined
def _turning(q):
    """Second moments of the wind's turning moment, as in `moment`."""
    return q.moment + q.side * q.lever


@inlined
def _start(q, k, log, x, p):
    """The state and covariance at the beginning of a segment."""
    x[:], p[:, :] = 0.0, 0.0
    rate, yaw = log[LOG_ROW.yaw_rate, k], log[LOG_ROW.yaw, k]
    x[_STATE.yaw_rate] = rate - q.gyro_offset if rate == rate else 0.0
    x[_STATE.yaw] = yaw if yaw == yaw else 0.0
    p[_STATE.vy, _STATE.vy] = 1.0
    p[_STATE.yaw_rate, _STATE.yaw_rate] = 0.05 * 0.05 + square(q.noise_yaw_rate)
    p[_STATE.slip_front, _STATE.slip_front] = p[_STATE.slip_rear, _STATE.slip_rear] = 0.05 * 0.05
    p[_STATE.yaw, _STATE.yaw] = square(q.noise_yaw) if yaw == yaw else 1e6
    calm = square(q.wind_spread)
    p[_STATE.wind, _STATE.wind], p[_STATE.gust, _STATE.gust] = calm, calm * (1.0 + q.wind_rise / q.wind_time)
    p[_STATE.wind, _STATE.gust] = p[_STATE.gust, _STATE.wind] = calm
    p[_STATE.push, _STATE.push] = square(q.push_spread)


@inlined
def _linearise(q, speed, slope_front, slope_rear, m):
    """Write M, of the first four states about their slips."""
    sigma = max(q.relaxation, 0.01)
    m[_STATE.vy, _STATE.vy] = -q.side * speed / q.mass  # relative wind
    m[_STATE.vy, _STATE.yaw_rate] = (q.superelevation - 1.0) * speed
    m[_STATE.vy, _STATE.slip_front], m[_STATE.vy, _STATE.slip_rear] = slope_front / q.mass, slope_rear / q.mass
    m[_STATE.yaw_rate, _STATE.vy] = -_turning(q) * speed / q.yaw_inertia
    m[_STATE.yaw_rate, _STATE.slip_front] = q.lf * slope_front / q.yaw_inertia
    m[_STATE.yaw_rate, _STATE.slip_rear] = -q.lr * slope_rear / q.yaw_inertia
    m[_STATE.slip_front, _STATE.vy] = m[_STATE.slip_rear, _STATE.vy] = -1.0 / sigma
    m[_STATE.slip_front, _STATE.yaw_rate], m[_STATE.slip_rear, _STATE.yaw_rate] = -q.lf / sigma, q.lr / sigma
    m[_STATE.slip_front, _STATE.slip_front] = m[_STATE.slip_rear, _STATE.slip_rear] = -speed / sigma


@inlined
def _predict(q, speed, h, angle, turning, gusts, x, p):
    """Move state and covariance on by h (s) at a speed (m/s), the wheels at a mean angle (rad) and turning (rad/s).

    gusts: factor on the spread of the wind's noise.
    """
    m, constant, ramp, air = _square(), _column(), _column(), _column()
    front, slope_front, rear, slope_rear = _axles(q, x, angle)
    rest_front, rest_rear = front - slope_front * x[_STATE.slip_front], rear - slope_rear * x[_STATE.slip_rear]
    steady, slope = _wind(q, speed)
    _linearise(q, speed, slope_front, slope_rear, m)
    constant[_STATE.vy] = (rest_front + rest_rear + q.side * steady) / q.mass + q.push_mean
    constant[_STATE.yaw_rate] = (q.lf * rest_front - q.lr * rest_rear + _turning(q) * steady) / q.yaw_inertia
    entering = speed / max(q.relaxation, 0.01)
    tangent, turning = sin(angle) / cos(angle), turning / square(cos(angle))
    constant[_STATE.slip_front], ramp[_STATE.slip_front] = entering * (tangent - 0.5 * h * turning), entering * turning
    air[_STATE.vy], air[_STATE.yaw_rate] = q.side * slope / q.mass, _turning(q) * slope / q.yaw_inertia

    s0, s1, s2, s3 = _square(), _square(), _square(), _square()
    by_constant, by_ramp, by_air = _column(), _column(), _column()
    integrals(m, h, s0, s1, s2, s3)
    apply(s1, constant, by_constant)
    apply(s2, ramp, by_ramp)
    apply(s1, air, by_air)
    f, previous, moved = _transition(), _vector(), _vector()
    kept_w, kept_g, kept_d = exp(-h / q.wind_rise), exp(-h / q.wind_time), exp(-h / q.push_time)
    time_difference = max(q.wind_time - q.wind_rise, 1e-4 * q.wind_time)
    rise = (kept_g - kept_w) * q.wind_time / time_difference
    for i in range(_CAR):
        for j in range(_CAR):
            f[i, j] = s0[i, j]
        f[i, _STATE.wind], f[i, _STATE.gust] = by_air[i] * 0.5 * (1.0 + kept_w), by_air[i] * 0.5 * rise
        f[i, _STATE.push] = s1[i, _STATE.vy] * 0.5 * (1.0 + kept_d)
        moved[i] = by_constant[i] + by_ramp[i]
    for j in range(_N):  # the yaw by the trapezoidal rule
        f[_STATE.yaw, j] = 0.5 * h * f[_STATE.yaw_rate, j]
    f[_STATE.yaw, _STATE.yaw_rate] += 0.5 * h
    f[_STATE.yaw, _STATE.yaw], moved[_STATE.yaw] = 1.0, 0.5 * h * moved[_STATE.yaw_rate]
    f[_STATE.wind, _STATE.wind], f[_STATE.wind, _STATE.gust] = kept_w, rise
    previous[_STATE.gust], previous[_STATE.push] = kept_g, kept_d

    for i in range(_MIXED):
        for j in range(_N):
            moved[i] += f[i, j] * x[j]
    for i in range(_N):
        x[i] = moved[i] if i < _MIXED else previous[i] * x[i]
    carry(f, previous, p, _transition())
    # stationary covariance calm [[1, 1], [1, both]], less what is left of it
    calm, both = square(q.wind_spread * gusts), 1.0 + q.wind_rise / q.wind_time
    p[_STATE.wind, _STATE.wind] += calm * (1.0 - kept_w * kept_w - rise * (2.0 * kept_w + both * rise))
    p[_STATE.gust, _STATE.gust] += calm * both * (1.0 - kept_g * kept_g)
    p[_STATE.wind, _STATE.gust] += calm * (1.0 - kept_g * (kept_w + both * rise))
    p[_STATE.gust, _STATE.wind] += calm * (1.0 - kept_g * (kept_w + both * rise))
    p[_STATE.push, _STATE.push] += square(q.push_spread) * (1.0 - kept_d * kept_d)
    p[_STATE.yaw_rate, _STATE.yaw_rate] += square(q.jolt) * h


@inlined
def _sense(sensor, q, speed, angle, x, h):
    """Expected reading of a sensor and the standard deviation of its noise; writes its row of the Jacobian to h.

    angle: of the wheels (rad)
    """
    h[:] = 0.0
    if sensor == OUTPUT.yaw_rate:
        h[_STATE.yaw_rate] = 1.0
        return x[_STATE.yaw_rate] + q.gyro_offset, q.noise_yaw_rate
    if sensor == OUTPUT.vy:
        h[_STATE.vy], h[_STATE.yaw_rate] = 1.0, q.vy_ahead
        return x[_STATE.vy] + q.vy_ahead * x[_STATE.yaw_rate] + q.vy_turned * speed, q.noise_vy
    if sensor == OUTPUT.yaw:
        h[_STATE.yaw] = 1.0
        return x[_STATE.yaw], q.noise_yaw
    front, slope_front, rear, slope_rear = _axles(q, x, angle)
    steady, slope = _wind(q, speed)
    h[_STATE.slip_front], h[_STATE.slip_rear] = slope_front / q.mass, slope_rear / q.mass
    h[_STATE.wind] = q.side * slope / q.mass
    force = front + rear + q.side * (steady + slope * x[_STATE.wind])
    return force / q.mass + q.acceleration_offset, q.noise_acceleration


@inlined
def _compare(q, k, log, angle, x, p, answer):
    """Compare the prediction with each measurement at sample k, and take it in; angle: of the wheels (rad)."""
    h, cross, speed = _vector(), _vector(), max(log[LOG_ROW.speed, k], SLIP_SPEED_FLOOR)
    for sensor in range(OUTPUT.wheel):
        measured = log[LOG_ROW.yaw_rate + sensor, k]
        if measured != measured:
            continue
        predicted, noise = _sense(sensor, q, speed, angle, x, h)
        innovation, variance = measured - predicted, scatter(noise * noise + FLOOR, h, p, cross)
        answer[sensor, k], answer[len(OUTPUT) + sensor, k] = innovation, variance
        if log[LOG_ROW.used, k] > 0.0:
            correct(innovation, variance, cross, x, p)


@inlined
def acting_row(acting, at, until, dead, times, begins):
    """Row of a segment that acts at a time (s), and when its successor does, at most `until` (s).

    acting: row from which on to search; dead: s, by which rows act late; begins: 1 where a segment begins.
    """
    last = times.size - 1
    while acting < last and begins[acting + 1] <= 0.0 and times[acting + 1] + dead <= at:
        acting += 1
    if acting < last and begins[acting + 1] <= 0.0:
        until = min(until, times[acting + 1] + dead)
    return acting, until


@inlined
def _steer(q, log, acting, angle, dead, start, h):
    """How the wheels move from a start (s) over h (s), commands acting a dead time (s) late, that at row `acting` now.

    The row that acts at the end, the angle (rad) there, the mean angle (rad) and the rate (rad/s) of the straight line.
    """
    until, lag, rate = start + h, max(q.lag, 1e-4), q.rate
    area, moment, at = 0.0, 0.0, start
    while at < until:
        acting, end = acting_row(acting, at, until, dead, log[LOG_ROW.time], log[LOG_ROW.begins])
        target = q.gain * log[LOG_ROW.command, acting] + q.offset
        angle, part, first = _move_wheels(angle, target, lag, rate, end - at)
        area += part
        moment += first + (at - start) * part
        at = end
    return acting, angle, area / h, (moment - 0.5 * h * area) * 12.0 / (h * h * h)


@inlined
def _measured(q, log, acting, at):
    """The row before a time (s), from row `acting` of its segment on, and the wheels on the straight line there."""
    time, command = log[LOG_ROW.time], log[LOG_ROW.command]
    acting, end = acting_row(acting, at, math.inf, 0.0, time, log[LOG_ROW.begins])
    angle = command[acting]
    if time[acting] < at and end < math.inf:
        angle += (at - time[acting]) / (end - time[acting]) * (command[acting + 1] - angle)
    return acting, q.gain * angle + q.offset


@exported(void(vector, matrix, matrix))
def innovations(quantities, log, answer):
    """Write innovations and their variances, NaN where nothing is measured, along a log.

    quantities: `Quantities`; log: rows as `LOG_ROW`, a column a sample; answer: (ANSWER, samples). Without a lag the
    commands are measured angles of the wheels.
    """
    q, x, p = _quantities_of(quantities, 0), _vector(), _covariance()
    samples, acting, angle = log.shape[1], 0, 0.0
    acting_here, wheels_now = 0, 0.0  # of the wheels as their sensor has them
    measured_angle = q.lag <= 0.0
    for k in range(samples):
        answer[:, k] = math.nan
        time = log[LOG_ROW.time, k]
        if log[LOG_ROW.begins, k] > 0.0:
            _start(q, k, log, x, p)
            acting = acting_here = k
            angle = wheels_now = q.gain * log[LOG_ROW.command, k] + q.offset
        else:
            before = log[LOG_ROW.time, k - 1]
            span = time - before
            steps = max(1, whole(ceil(span / MAX_IDENTIFICATION_STEP - 1e-9)))
            h = span / steps
            for step in range(steps):
                share, start = (step + 0.5) / steps, before + step * h
                if measured_angle:
                    acting, ending = _measured(q, log, acting, start + h - q.lateness)
                    mean, turning, angle = 0.5 * (angle + ending), (ending - angle) / h, ending
                else:
                    dead = q.dead_time + q.lateness
                    acting, angle, mean, turning = _steer(q, log, acting, angle, dead, start, h)
                speed = log[LOG_ROW.speed, k - 1] + share * (log[LOG_ROW.speed, k] - log[LOG_ROW.speed, k - 1])
                _predict(q, max(speed, SLIP_SPEED_FLOOR), h, mean, turning, log[LOG_ROW.gusts, k], x, p)
            if measured_angle:
                wheels_now = q.gain * log[LOG_ROW.command, k] + q.offset
            elif q.lateness == 0.0:
                acting_here, wheels_now = acting, angle
            else:
                acting_here, wheels_now, _, _ = _steer(q, log, acting_here, wheels_now, q.dead_time, before, span)
        _compare(q, k, log, angle, x, p, answer)
        count = 2 * len(OUTPUT)
        answer[count + FOUND.wind, k], answer[count + FOUND.wheel_angle, k] = x[_STATE.wind], wheels_now
        answer[count + FOUND.front_slip, k] = x[_STATE.slip_front]
        answer[count + FOUND.rear_slip, k] = x[_STATE.slip_rear]
        measured = log[LOG_ROW.wheel, k]
        if measured == measured:
            answer[OUTPUT.wheel, k] = measured - wheels_now / q.wheel_gain - q.wheel_offset
            answer[len(OUTPUT) + OUTPUT.wheel, k] = square(q.noise_wheel) + FLOOR

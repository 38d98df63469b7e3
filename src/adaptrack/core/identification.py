"""Innovations of a Kalman filter along a log: what the likelihood of a car's quantities is made of.

The filter's state is [v_y (m/s), yaw rate r (rad/s), relaxed slips a_f and a_r (rad), wind w and g (m/s), push d
(m/s^2), yaw (rad)]. It is that of the single-track vehicle behind its steering:

    m (dv_y/dt + v r) = F_f(a_f) + F_r(a_r) + s (f(w_0) + f' w - v v_y) + m (d_0 + d)
    I_z dr/dt         = l_f F_f - l_r F_r + t (f(w_0) + f' w - v v_y) + white noise
    da_f/dt           = (v/sigma) (delta - (v_y + l_f r)/v - a_f),   likewise at the rear
    ddelta/dt         = (gain command(t - dead time) + offset - delta)/lag

F is the Magic Formula D sin(C atan(S a/(C D))) with the axle's stiffness S and D = mu m g times its share of the load
(Pacejka, *Tire and Vehicle Dynamics*, 3rd ed., eq. 4.E19); f = (v^2 + W^2) limit tanh(atan(W/v)/limit)
is the load of a side wind W, as in `plants.forces`. w and d are Gauss-Markov processes, w of second order
(T dw/dt = g - w, T dg/dt = -g + white noise), as gusts are smooth: what no log tells of side wind and bank is noise of
the process, without which estimates are biased by the driver's answer to it and standard errors too small. delta
has no noise: it follows from the commands alone, in closed form, each held until the next; within a step it acts as
the straight line of the same mean and first moment (its mean alone makes the dead time of stiff cars 5 ms too long).
Sources: L. Ljung, *System Identification*, 2nd ed., section 7.4 (likelihood of innovations); D. Simon, *Optimal State
Estimation* (2006), chapters 5 and 13 (the filter).
"""

from __future__ import annotations

import math

import numpy as np

from .kernel import columns, cube, exported, inlined, matrix, vector, void
from .maths.bits import whole
from .maths.exact import ceil, square
from .maths.exponential import exp, tanh
from .maths.trigonometric import atan, cos, sin
from .plants.forces import GRAVITY, SLIP_SPEED_FLOOR

QUANTITY = columns(
    "lag", "dead_time", "rate",  # s, s, rad/s: of the steering
    "gain", "offset",  # -, rad: road wheels over command
    "front", "rear",  # N/rad, cornering stiffness of the axles
    "mass", "yaw_inertia", "lf", "lr",  # kg, kg m^2, m, m
    "relaxation", "friction", "shape",  # m, -, -: of the tyres
    "side", "moment", "wind_angle_limit",  # N s^2/m^2, N s^2/m: of the wind, s and t; rad
    "wind_mean", "wind_spread", "wind_time",  # m/s, m/s, s
    "push_mean", "push_spread", "push_time",  # m/s^2, m/s^2, s
    "jolt",  # rad/s^2 per root Hz, white
    "noise_yaw_rate", "noise_vy", "noise_acceleration", "noise_yaw", "noise_wheel",  # rad/s, m/s, m/s^2, rad, rad
    "gyro_offset", "acceleration_offset", "wheel_offset",  # rad/s, m/s^2, rad
)  # fmt: skip
"""A car, its sensors and what disturbs it: places in the vector of quantities."""
ROW = columns("time", "command", "speed", "yaw_rate", "vy", "acceleration", "yaw", "wheel", "begins", "seen", "gusts")
"""Rows of a log: s, rad, m/s, then what is measured (NaN: not), then 1 where a segment begins, and 1 where the filter
takes the sample in (else it only predicts), and the factor on the spread of the wind's noise until the sample."""
OUTPUT = columns("yaw_rate", "vy", "acceleration", "yaw", "wheel")
"""What is predicted. The answer has a row for each innovation, then one for each of their variances, then `FOUND`."""
FOUND = columns("wind", "wheel_angle", "front_slip", "rear_slip")
"""m/s, rad, rad, rad: what the filter finds at each sample: gusts beside the mean, wheels, slips."""
ANSWER = 2 * len(OUTPUT) + len(FOUND)
N = 8
VY, R, AF, AR, WIND, GUST, PUSH, YAW = range(N)
WORK = 7
"""Matrices (N, N) of scratch."""
FLOOR = 1e-10
"""Added to the variance of every measurement: 1e-5 of its unit, for logs of simulations without noise."""
TYPICAL_GUST = 12.0
"""m/s, at which the load of the gusts is linearised: f(W)/W is their slope."""
LONGEST_STEP = 0.051
"""s"""
_DEGREE = 7  # of the Taylor polynomial of the matrix exponential


@inlined
def _tyre(slip, stiffness, peak, shape):
    """Force (N) and slope (N/rad) of an axle."""
    z = stiffness * slip / (shape * peak)
    angle = shape * atan(z)
    return peak * sin(angle), max(stiffness * cos(angle) / (1.0 + z * z), 0.02 * stiffness)


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
    kept = exp(-span / lag)
    rest = target * span - gap * lag * (1.0 - kept)
    moment += begun * rest + 0.5 * target * span * span - gap * lag * (lag * (1.0 - kept) - span * kept)
    return target - gap * kept, area + rest, moment


@inlined
def _exponential(a, h, phi, psi, chi, term, spare):
    """phi = exp(a h), psi = its integral over h, both (4, 4); chi (4,): column `AF` of psi's integral over h.

    By scaling, a Taylor polynomial and doubling.
    """
    norm = 0.0
    for j in range(4):
        column = 0.0
        for i in range(4):
            column += abs(a[i, j])
        norm = max(norm, column)
    halvings = 0
    while norm * h > 0.5 and halvings < 30:
        h *= 0.5
        halvings += 1
    for i in range(4):
        for j in range(4):
            term[i, j] = h if i == j else 0.0
            psi[i, j] = term[i, j]
        chi[i] = 0.5 * h * term[i, AF]
    for k in range(2, _DEGREE + 1):
        for i in range(4):
            for j in range(4):
                total = 0.0
                for m in range(4):
                    total += term[i, m] * a[m, j]
                spare[i, j] = total * h / k
        for i in range(4):
            for j in range(4):
                term[i, j] = spare[i, j]
                psi[i, j] += term[i, j]
            chi[i] += term[i, AF] * h / (k + 1)
    for i in range(4):
        for j in range(4):
            total = 1.0 if i == j else 0.0
            for m in range(4):
                total += a[i, m] * psi[m, j]
            phi[i, j] = total
    for _ in range(halvings):
        for i in range(4):
            spare[0, i] = chi[i] + h * psi[i, AF]
            for m in range(4):
                spare[0, i] += phi[i, m] * chi[m]
        for i in range(4):
            chi[i] = spare[0, i]
        h *= 2.0
        for i in range(4):
            for j in range(4):
                total = psi[i, j]
                for m in range(4):
                    total += phi[i, m] * psi[m, j]
                spare[i, j] = total
        for i in range(4):
            for j in range(4):
                psi[i, j] = spare[i, j]
                total = 0.0
                for m in range(4):
                    total += phi[i, m] * phi[m, j]
                term[i, j] = total
        for i in range(4):
            for j in range(4):
                phi[i, j] = term[i, j]


@inlined
def _start(q, k, log, x, p):
    """The state and covariance at the beginning of a segment."""
    for i in range(N):
        x[i] = 0.0
        for j in range(N):
            p[i, j] = 0.0
    rate, yaw = log[ROW.yaw_rate, k], log[ROW.yaw, k]
    x[R] = rate - q[QUANTITY.gyro_offset] if rate == rate else 0.0
    x[YAW] = yaw if yaw == yaw else 0.0
    p[VY, VY], p[R, R] = 1.0, 0.05 * 0.05 + square(q[QUANTITY.noise_yaw_rate])
    p[AF, AF] = p[AR, AR] = 0.05 * 0.05
    calm = square(q[QUANTITY.wind_spread])
    p[WIND, WIND], p[WIND, GUST], p[GUST, WIND], p[GUST, GUST] = calm, calm, calm, 2.0 * calm
    p[PUSH, PUSH] = square(q[QUANTITY.push_spread])
    p[YAW, YAW] = square(q[QUANTITY.noise_yaw]) if yaw == yaw else 1e6


@inlined
def _predict(q, speed, h, angle, turning, gusts, x, p, work):
    """Move state and covariance on by h (s) at a speed (m/s), the wheels at a mean angle (rad) and turning (rad/s).

    gusts: factor on the spread of the wind's noise.
    """
    a, phi, psi, term, spare, whole, chi = work[0], work[1], work[2], work[3], work[4], work[5], work[6, 0]
    mass, inertia, lf, lr = q[QUANTITY.mass], q[QUANTITY.yaw_inertia], q[QUANTITY.lf], q[QUANTITY.lr]
    sigma, load = max(q[QUANTITY.relaxation], 0.01), q[QUANTITY.friction] * mass * GRAVITY / (lf + lr)
    front, slope_f = _tyre(x[AF], q[QUANTITY.front], load * lr, q[QUANTITY.shape])
    rear, slope_r = _tyre(x[AR], q[QUANTITY.rear], load * lf, q[QUANTITY.shape])
    for i in range(4):
        for j in range(4):
            a[i, j] = 0.0
    a[VY, VY], a[R, VY] = -q[QUANTITY.side] * speed / mass, -q[QUANTITY.moment] * speed / inertia  # relative wind
    a[VY, R], a[VY, AF], a[VY, AR] = -speed, slope_f / mass, slope_r / mass
    a[R, AF], a[R, AR] = lf * slope_f / inertia, -lr * slope_r / inertia
    a[AF, VY], a[AF, R], a[AF, AF] = -1.0 / sigma, -lf / sigma, -speed / sigma
    a[AR, VY], a[AR, R], a[AR, AR] = -1.0 / sigma, lr / sigma, -speed / sigma
    _exponential(a, h, phi, psi, chi, term, spare)
    rest_f, rest_r = front - slope_f * x[AF], rear - slope_r * x[AR]
    slope = _steady_wind(speed, TYPICAL_GUST, q[QUANTITY.wind_angle_limit]) / TYPICAL_GUST
    side, moment = q[QUANTITY.side] * slope / mass, q[QUANTITY.moment] * slope / inertia
    steady = _steady_wind(speed, q[QUANTITY.wind_mean], q[QUANTITY.wind_angle_limit])
    g0 = (rest_f + rest_r + q[QUANTITY.side] * steady) / mass + q[QUANTITY.push_mean]
    g1 = (lf * rest_f - lr * rest_r + q[QUANTITY.moment] * steady) / inertia
    g2, g3 = speed / sigma * (angle - 0.5 * h * turning), speed / sigma * turning
    kept_w, kept_d = exp(-h / q[QUANTITY.wind_time]), exp(-h / q[QUANTITY.push_time])
    rise = h / q[QUANTITY.wind_time] * kept_w
    mean_d = 0.5 * (1.0 + kept_d)
    for i in range(N):
        for j in range(N):
            whole[i, j] = 0.0
    for i in range(4):
        for j in range(4):
            whole[i, j] = phi[i, j]
        air = psi[i, 0] * side + psi[i, 1] * moment
        whole[i, WIND], whole[i, GUST] = air * 0.5 * (1.0 + kept_w), air * 0.5 * rise
        whole[i, PUSH] = psi[i, 0] * mean_d
    whole[WIND, WIND], whole[WIND, GUST], whole[GUST, GUST] = kept_w, rise, kept_w
    whole[PUSH, PUSH], whole[YAW, YAW] = kept_d, 1.0
    for j in range(N - 1):
        whole[YAW, j] = 0.5 * h * whole[R, j]
    whole[YAW, R] += 0.5 * h
    for i in range(N):
        total = 0.0
        for j in range(N):
            total += whole[i, j] * x[j]
        if i < 4:
            total += psi[i, 0] * g0 + psi[i, 1] * g1 + psi[i, 2] * g2 + chi[i] * g3
        term[0, i] = total
    term[0, YAW] += 0.5 * h * (psi[1, 0] * g0 + psi[1, 1] * g1 + psi[1, 2] * g2 + chi[1] * g3)
    for i in range(N):
        x[i] = term[0, i]
    for i in range(N):
        for j in range(N):
            total = 0.0
            for m in range(N):
                total += whole[i, m] * p[m, j]
            spare[i, j] = total
    for i in range(N):
        for j in range(i + 1):
            total = 0.0
            for m in range(N):
                total += spare[i, m] * whole[j, m]
            p[i, j] = total
            p[j, i] = total
    # stationary covariance calm [[1, 1], [1, 2]], less what is left of it
    calm = square(q[QUANTITY.wind_spread] * gusts)
    p[WIND, WIND] += calm * (1.0 - kept_w * kept_w - 2.0 * kept_w * rise - 2.0 * rise * rise)
    p[GUST, GUST] += calm * 2.0 * (1.0 - kept_w * kept_w)
    new = calm * (1.0 - kept_w * kept_w - 2.0 * rise * kept_w)
    p[WIND, GUST] += new
    p[GUST, WIND] += new
    p[PUSH, PUSH] += square(q[QUANTITY.push_spread]) * (1.0 - kept_d * kept_d)
    p[R, R] += square(q[QUANTITY.jolt]) * h


@inlined
def _take_in(innovation, variance, c, seen, x, p, gain):
    """Correct state and covariance by an innovation of a given variance; row c is that of the measurement."""
    if seen <= 0.0:
        return
    for i in range(N):
        total = 0.0
        for j in range(N):
            total += p[i, j] * c[j]
        gain[i] = total
    for i in range(N):
        x[i] += gain[i] / variance * innovation
    for i in range(N):
        for j in range(i + 1):
            p[i, j] -= gain[i] * gain[j] / variance
            p[j, i] = p[i, j]


@inlined
def _correct(q, k, log, x, p, work, answer):
    """Compare the prediction with each measurement at sample k, and take it in."""
    c, gain = work[0, 0], work[0, 1]
    seen, speed = log[ROW.seen, k], max(log[ROW.speed, k], SLIP_SPEED_FLOOR)
    mass, lf, lr = q[QUANTITY.mass], q[QUANTITY.lf], q[QUANTITY.lr]
    load = q[QUANTITY.friction] * mass * GRAVITY / (lf + lr)
    for which in range(4):
        measured = log[ROW.yaw_rate + which, k]
        if measured != measured:
            continue
        for i in range(N):
            c[i] = 0.0
        if which == OUTPUT.yaw_rate:
            c[R] = 1.0
            predicted, noise = x[R] + q[QUANTITY.gyro_offset], q[QUANTITY.noise_yaw_rate]
        elif which == OUTPUT.vy:
            c[VY] = 1.0
            predicted, noise = x[VY], q[QUANTITY.noise_vy]
        elif which == OUTPUT.acceleration:
            front, slope_f = _tyre(x[AF], q[QUANTITY.front], load * lr, q[QUANTITY.shape])
            rear, slope_r = _tyre(x[AR], q[QUANTITY.rear], load * lf, q[QUANTITY.shape])
            steady = _steady_wind(speed, q[QUANTITY.wind_mean], q[QUANTITY.wind_angle_limit])
            slope = _steady_wind(speed, TYPICAL_GUST, q[QUANTITY.wind_angle_limit]) / TYPICAL_GUST
            c[AF], c[AR], c[WIND] = slope_f / mass, slope_r / mass, q[QUANTITY.side] * slope / mass
            predicted = (front + rear + q[QUANTITY.side] * (steady + slope * x[WIND])) / mass
            predicted += q[QUANTITY.acceleration_offset]
            noise = q[QUANTITY.noise_acceleration]
        else:
            c[YAW] = 1.0
            predicted, noise = x[YAW], q[QUANTITY.noise_yaw]
        variance = noise * noise + FLOOR
        for i in range(N):
            for j in range(N):
                variance += c[i] * p[i, j] * c[j]
        innovation = measured - predicted
        answer[which, k], answer[len(OUTPUT) + which, k] = innovation, variance
        _take_in(innovation, variance, c, seen, x, p, gain)


@inlined
def _steer(q, log, acting, angle, start, h):
    """How the wheels move from a start (s) over h (s) behind the commands, of which the one at row `acting` acts.

    The row that acts at the end, the angle (rad) there, the mean angle (rad) and the rate (rad/s) of the straight line.
    """
    last, dead, until = log.shape[1] - 1, q[QUANTITY.dead_time], start + h
    lag, rate = max(q[QUANTITY.lag], 1e-4), q[QUANTITY.rate]
    area, moment, at = 0.0, 0.0, start
    while at < until:
        while acting < last and log[ROW.begins, acting + 1] <= 0.0 and log[ROW.time, acting + 1] + dead <= at:
            acting += 1
        end = until
        if acting < last and log[ROW.begins, acting + 1] <= 0.0:
            end = min(until, log[ROW.time, acting + 1] + dead)
        target = q[QUANTITY.gain] * log[ROW.command, acting] + q[QUANTITY.offset]
        angle, part, first = _move_wheels(angle, target, lag, rate, end - at)
        area += part
        moment += first + (at - start) * part
        at = end
    return acting, angle, area / h, (moment - 0.5 * h * area) * 12.0 / (h * h * h)


@inlined
def _follow(q, log, k, share, h):
    """Likewise of wheels on straight lines between measured angles; share: of the span, at the middle of the step."""
    span = log[ROW.time, k] - log[ROW.time, k - 1]
    turning = q[QUANTITY.gain] * (log[ROW.command, k] - log[ROW.command, k - 1]) / span
    mean = q[QUANTITY.gain] * log[ROW.command, k - 1] + share * span * turning + q[QUANTITY.offset]
    return mean + 0.5 * h * turning, mean, turning


@exported(void(vector, matrix, vector, matrix, cube, matrix))
def innovations(q, log, x, p, work, answer):
    """Write innovations and their variances, NaN where nothing is measured, along a log.

    q: see `QUANTITY`; log: rows as `ROW`, a column a sample; x (N,), p (N, N), work (WORK, N, N): scratch;
    answer: (ANSWER, samples). Without a lag the commands are measured angles of the wheels.
    """
    samples, acting, angle = log.shape[1], 0, 0.0
    measured_angle = q[QUANTITY.lag] <= 0.0
    for k in range(samples):
        for i in range(answer.shape[0]):
            answer[i, k] = math.nan
        now = log[ROW.time, k]
        if log[ROW.begins, k] > 0.0:
            _start(q, k, log, x, p)
            acting = k
            angle = q[QUANTITY.gain] * log[ROW.command, k] + q[QUANTITY.offset]
        else:
            before = log[ROW.time, k - 1]
            span = now - before
            steps = max(1, whole(ceil(span / LONGEST_STEP - 1e-9)))
            h = span / steps
            for step in range(steps):
                share = (step + 0.5) / steps
                if measured_angle:
                    angle, mean, turning = _follow(q, log, k, share, h)
                else:
                    acting, angle, mean, turning = _steer(q, log, acting, angle, before + step * h, h)
                speed = log[ROW.speed, k - 1] + share * (log[ROW.speed, k] - log[ROW.speed, k - 1])
                _predict(q, max(speed, SLIP_SPEED_FLOOR), h, mean, turning, log[ROW.gusts, k], x, p, work)
        _correct(q, k, log, x, p, work, answer)
        found = 2 * len(OUTPUT)
        answer[found + FOUND.wind, k], answer[found + FOUND.wheel_angle, k] = x[WIND], angle
        answer[found + FOUND.front_slip, k], answer[found + FOUND.rear_slip, k] = x[AF], x[AR]
        measured = log[ROW.wheel, k]
        if measured == measured:
            answer[OUTPUT.wheel, k] = measured - angle - q[QUANTITY.wheel_offset]
            answer[len(OUTPUT) + OUTPUT.wheel, k] = square(q[QUANTITY.noise_wheel]) + FLOOR


def scratch() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """State, covariance and scratch for `innovations`."""
    return np.zeros(N), np.zeros((N, N)), np.zeros((WORK, N, N))

"""Innovations of a Kalman filter of the speed along a log: the likelihood of drive, brakes and resistance.

The filter's state is [speed v (m/s), disturbance d (m/s^2)]:

    dv/dt = gain_d a_d - gain_b a_b - rolling - drag v^2 + d + white noise,   dd/dt = -d/T + white noise

a_d and a_b are the positive and the negative part of the request over the mass (m/s^2), each held until the next one,
behind its dead time and first-order lag (`force_actuator`), in closed form. d holds slope, wind and bends, of which no
log tells. Gain and mass are one number: only gain over mass acts on the speed. Source: L. Ljung, *System
Identification*, 2nd ed., section 7.4.
"""

from __future__ import annotations

import math

from ..kernel import columns, exported, inlined, matrix, record, vector, viewer, void
from ..maths.exact import square
from ..maths.exponential import exp
from ..physics.force_actuator import ForceActuator, force_response
from .steering import acting_row

DriveQuantities = record("DriveQuantities", (
    "drive_lag", "drive_dead_time", "drive_gain",  # s, s, -
    "brake_lag", "brake_dead_time", "brake_gain",  # s, s, -
    "drag", "rolling",  # 1/m, m/s^2: resistance over mass
    "push_spread", "push_time",  # m/s^2, s: of the disturbance
    "jolt", "noise_speed",  # m/s per root s, m/s
))  # fmt: skip
"""Drive, brakes, resistance and disturbance of a car, and the noise of its speed."""
_quantities_of = viewer(DriveQuantities)
DRIVE_ROW = columns("time", "request", "speed", "begins")
"""Rows of a log: s; m/s^2, requested force over mass; m/s, NaN where it is not compared; 1 where a segment begins."""
DRIVE_ANSWER = columns("innovation", "variance", "disturbance")
"""m/s, m^2/s^2, m/s^2 at each sample; the first two are NaN where no speed is compared."""

SPEED_ERROR = 0.005
"""m/s, of the speed of any sensor and model: for logs of simulations without noise."""


@inlined
def _respond(response, lag, dead, sign, acting, start, h, log):
    """Response (m/s^2) of an actuator to the requests of its sign over h (s) from a start (s): at the end, and mean.

    acting: row of the request that acts at the start; the one that acts at the end is returned first.
    """
    until, at, impulse = start + h, start, 0.0
    actuator = ForceActuator(0, 0.0, max(lag, 1e-4), math.inf, 1.0, math.inf)
    while at < until:
        acting, end = acting_row(acting, at, until, dead, log[DRIVE_ROW.time], log[DRIVE_ROW.begins])
        target = max(sign * log[DRIVE_ROW.request, acting], 0.0)
        response, mean = force_response(response, target, end - at, actuator)
        impulse += mean * (end - at)
        at = end
    return acting, response, impulse / h


@exported(void(vector, matrix, matrix))
def speed_innovations(quantities, log, answer):
    """Write innovations of the speed and their variances along a log, see `DRIVE_ANSWER`.

    quantities: `DriveQuantities`; log: rows as `DRIVE_ROW`, a column a sample. The speed is estimated afresh behind
    samples where it is not compared.
    """
    q = _quantities_of(quantities, 0)
    drive_row = brake_row = 0
    drive = brakes = speed = push = p_vv = p_vd = p_dd = 0.0
    is_estimated = False
    for k in range(log.shape[1]):
        answer[:, k] = math.nan
        measured = log[DRIVE_ROW.speed, k]
        if log[DRIVE_ROW.begins, k] > 0.0:
            drive_row = brake_row = k
            drive, brakes = max(log[DRIVE_ROW.request, k], 0.0), max(-log[DRIVE_ROW.request, k], 0.0)
            is_estimated = False
        else:
            start = log[DRIVE_ROW.time, k - 1]
            h = log[DRIVE_ROW.time, k] - start
            drive_row, drive, driving = _respond(drive, q.drive_lag, q.drive_dead_time, 1.0, drive_row, start, h, log)
            brake_row, brakes, braking = _respond(
                brakes, q.brake_lag, q.brake_dead_time, -1.0, brake_row, start, h, log
            )
            decay = exp(-h / q.push_time)
            reach = q.push_time * (1.0 - decay)  # s, by which the disturbance changes the speed
            slope = 1.0 - 2.0 * q.drag * speed * h
            resistance = q.rolling + q.drag * square(speed)
            speed += h * (q.drive_gain * driving - q.brake_gain * braking - resistance) + reach * push
            push *= decay
            p_vv = square(slope) * p_vv + 2.0 * slope * reach * p_vd + square(reach) * p_dd + square(q.jolt) * h
            p_vd = decay * (slope * p_vd + reach * p_dd)
            p_dd = square(decay) * p_dd + square(q.push_spread) * (1.0 - square(decay))
        if measured != measured:
            is_estimated = False
            continue
        noise = square(q.noise_speed) + square(SPEED_ERROR)
        if not is_estimated:
            is_estimated, speed, push, p_vv, p_vd, p_dd = True, measured, 0.0, noise, 0.0, square(q.push_spread)
            continue
        innovation, variance = measured - speed, p_vv + noise
        k_v, k_d = p_vv / variance, p_vd / variance
        speed += k_v * innovation
        push += k_d * innovation
        p_dd -= k_d * p_vd
        p_vd -= k_v * p_vd
        p_vv -= k_v * p_vv
        answer[DRIVE_ANSWER.innovation, k], answer[DRIVE_ANSWER.variance, k] = innovation, variance
        answer[DRIVE_ANSWER.disturbance, k] = push

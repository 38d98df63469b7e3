"""Learning of drive and brakes while driving: a bank of Kalman filters over lag and dead time for each of the two.

Each hypothesis predicts the speed from the requests of its dead time ago behind its lag:

    dv/dt = ratio a - resistance - slope + disturbance,   a: requested force over the mass of the car file, filtered

and estimates the ratio (gain of the actuator over the change of mass, which are not separable) and the disturbance
(slope, drag and wind that are not known, which are not separable either). Its weight follows from the likelihood of the
measured speeds, with forgetting. A bank learns while its actuator acts and the car moves; the ratio is observable only
in changes of force. Sign of a: positive forward for the drive and backward for the brakes.
"""

from __future__ import annotations

import math

from ..kernel import inlined, record, rows, vector
from ..maths.bits import whole
from ..maths.exact import clip, floor, sqrt, square
from ..maths.exponential import exp, log
from ..physics.forces import STANDING_SPEED

MAX_LAG, MAX_DEAD_TIME = 0.6, 0.4
"""s, ends of the prior ranges."""
LAG_HYPOTHESES, DEAD_TIME_HYPOTHESES = 5, 5
"""Hypotheses of each bank, evenly within these ranges."""
ACTUATOR_HYPOTHESIS = record(
    "ActuatorHypothesis",
    (
        "lag", "dead_time",  # s, s
        "filtered",  # m/s^2, requested force over mass behind dead time and lag
        "speed", "ratio", "disturbance",  # m/s, -, m/s^2: the estimate
        "p_speed", "p_speed_ratio", "p_speed_disturbance", "p_ratio", "p_ratio_disturbance", "p_disturbance",
        "score",  # logarithm of the weight
    ),
)  # fmt: skip
"""A hypothesis about drive or brakes, with its filter."""
ActuatorBelief = record(
    "ActuatorBelief",
    ("lag", "dead_time", "delay_sigma", "ratio", "ratio_sigma", "disturbance", "speed", "acting", "acting_sigma"),
)
"""Weighted mean of a bank: s, s, s (of lag plus dead time), -, -, m/s^2, m/s (filtered; NaN: none); acting: m/s^2,
filtered request, with the standard deviation by the unknown delays."""
SpeedBanks = record(
    "SpeedBanks", (("drive", rows(ACTUATOR_HYPOTHESIS)), ("brakes", rows(ACTUATOR_HYPOTHESIS)), ("requests", vector))
)
"""The two banks; requests: m/s^2, of the drive and then of the brakes, each the latest first."""

RATIO_SIGMA, DISTURBANCE_SIGMA = 0.2, 0.5
"""Standard deviations at the start: -, m/s^2."""
RATIO_DRIFT, DISTURBANCE_DRIFT, SPEED_DRIFT = 0.004, 0.12, 0.03
"""Random walks, after a second: -, m/s^2, m/s."""
SPEED_NOISE, SPEED_NOISE_SHARE = 0.02, 0.006
"""m/s, -: standard deviation of a measured speed, absolute and over the speed."""
DELAY_ERROR_TIME = 0.3
"""s, for which an error of the force of the other actuator by its unknown delays lasts."""
SETTLING_TIME = MAX_LAG + MAX_DEAD_TIME
"""s, after which nothing acts but the requests."""
EVIDENCE_TIME = 40.0
"""s of action, after which evidence about lag and dead time is forgotten."""
LEARNING_SPEED, LEAST_ACTION = 0.3, 0.5
"""m/s; m/s^2: below these nothing is learned of an actuator: a slight force and a slope look alike."""
LEAST_FORCE_RATIO, LARGEST_FORCE_RATIO = 0.4, 2.0
LEAST_RATIO_VARIANCE = 1e-12
"""Of a ratio."""
MAX_DISTURBANCE, SPEED_JUMP = 5.0, 1.0
"""m/s^2; m/s, by which a speed differs from the predicted one that shows no motion of a car: the filter restarts there.
"""
WHOLE = 1e-6
"""Periods, by which times may differ from whole ones."""
INNOVATION_BOUND = 4.0
"""Standard deviations up to which an innovation counts."""


@inlined
def begin_bank(lag, dead_time, bank):
    """Begin a bank: all hypotheses alike, or one at a known lag and dead time (s); NaN: not known."""
    for i in range(bank.size):
        h = bank[i]
        h.lag, h.dead_time = lag, dead_time
        if lag != lag:
            h.lag = MAX_LAG * (i % LAG_HYPOTHESES) / (LAG_HYPOTHESES - 1)
            h.dead_time = MAX_DEAD_TIME * (i // LAG_HYPOTHESES) / (DEAD_TIME_HYPOTHESES - 1)
        h.filtered, h.speed, h.ratio, h.disturbance, h.score = 0.0, math.nan, 1.0, 0.0, 0.0
        h.p_speed, h.p_speed_ratio, h.p_speed_disturbance = square(SPEED_NOISE), 0.0, 0.0
        h.p_ratio, h.p_ratio_disturbance, h.p_disturbance = square(RATIO_SIGMA), 0.0, square(DISTURBANCE_SIGMA)


@inlined
def mean_of_bank(bank):
    """Return the weighted mean of a bank as `ActuatorBelief`."""
    best = -math.inf
    for h in bank:
        best = max(best, h.score)
    total = lag = dead_time = delay_square = ratio = ratio_square = disturbance = speed = acting = acting_square = 0.0
    for h in bank:
        weight = exp(h.score - best)
        total += weight
        lag += weight * h.lag
        dead_time += weight * h.dead_time
        delay_square += weight * square(h.lag + h.dead_time)
        ratio += weight * h.ratio
        ratio_square += weight * (square(h.ratio) + h.p_ratio)
        disturbance += weight * h.disturbance
        speed += weight * h.speed
        acting += weight * h.filtered
        acting_square += weight * square(h.filtered)
    lag, dead_time, ratio = lag / total, dead_time / total, ratio / total
    delay_variance = max(delay_square / total - square(lag + dead_time), 0.0)
    ratio_variance = max(ratio_square / total - square(ratio), 0.0)
    acting_variance = max(acting_square / total - square(acting / total), 0.0)
    return ActuatorBelief(
        lag, dead_time, sqrt(delay_variance), ratio, sqrt(ratio_variance), disturbance / total, speed / total,
        acting / total, sqrt(acting_variance),
    )  # fmt: skip


@inlined
def _requested(offset, period, requests):
    """Mean request (m/s^2) of the period that ended an offset (s) ago."""
    periods = offset / period
    first = min(whole(floor(periods)), requests.size - 2)
    share = clip(periods - first, 0.0, 1.0)
    return (1.0 - share) * requests[first] + share * requests[first + 1]


@inlined
def _act(h, period, age, elapsed, requests):
    """Let the actuator of a hypothesis follow its requests over a time (s) that ended at an age (s); its mean (m/s^2).

    period: s, between two requests.
    """
    remaining, integral = elapsed, 0.0
    while remaining > 0.0:
        step = remaining if remaining < (1.0 + WHOLE) * period else period
        remaining -= step
        target = _requested(h.dead_time + age + max(remaining, 0.0), period, requests)
        if h.lag <= 0.0:
            h.filtered = target
            integral += step * target
            continue
        decay = exp(-step / h.lag)
        gap = target - h.filtered
        h.filtered = target - gap * decay
        integral += step * target - gap * (1.0 - decay) * h.lag
    return integral / elapsed


@inlined
def _restart_speed(h, speed):
    """Let the filter of a hypothesis be at a speed (m/s)."""
    h.speed = speed
    h.p_speed, h.p_speed_ratio, h.p_speed_disturbance = square(SPEED_NOISE), 0.0, 0.0


@inlined
def _update(h, acceleration, other_acceleration, other_sigma, speed, learns, period):
    """Predict and correct the filter of a hypothesis with a measured speed (m/s).

    acceleration: signed mean of its actuator (m/s^2); other_acceleration: m/s^2, of the other actuator, air, rolling
    and the known slope; other_sigma: m/s^2, its standard deviation by the unknown delays of the other actuator.
    """
    h.speed += period * (h.ratio * acceleration + other_acceleration + h.disturbance)
    innovation = speed - h.speed
    if abs(innovation) > SPEED_JUMP:
        _restart_speed(h, speed)
        return
    a, t = acceleration * period, period  # derivatives of the speed by ratio and disturbance
    p_v, p_vr, p_vd = h.p_speed, h.p_speed_ratio, h.p_speed_disturbance
    p_r, p_rd, p_d = max(h.p_ratio, LEAST_RATIO_VARIANCE), h.p_ratio_disturbance, h.p_disturbance
    unlearned = 0.0 if learns else p_r
    if not learns:  # the disturbance holds the error of the ratio: found at this acceleration, another one changes it
        dependence = p_rd / p_r
        p_v, p_vd, p_d = p_v - square(p_vr) / p_r, p_vd - p_vr * dependence, p_d - dependence * p_rd
        p_d += p_r * square(acceleration + dependence)
        p_vr = p_rd = p_r = 0.0
    v_r, v_d = p_vr + a * p_r + t * p_rd, p_vd + a * p_rd + t * p_d
    drift = square(SPEED_DRIFT) + DELAY_ERROR_TIME * square(other_sigma)
    v_v = p_v + a * p_vr + t * p_vd + a * v_r + t * v_d + drift * period
    p_d += square(DISTURBANCE_DRIFT) * period
    p_r = min(p_r + (square(RATIO_DRIFT) * period if learns else 0.0), square(RATIO_SIGMA))
    noise = square(SPEED_NOISE + SPEED_NOISE_SHARE * speed)
    spread = v_v + noise
    if learns:
        counted = min(square(innovation) / spread, square(INNOVATION_BOUND))
        h.score += -0.5 * (counted + log(spread)) - h.score * period / EVIDENCE_TIME
    limit = INNOVATION_BOUND * sqrt(spread)
    bounded = clip(innovation, -limit, limit)
    k_v, k_r, k_d = v_v / spread, v_r / spread, v_d / spread
    h.speed += k_v * bounded
    h.ratio = clip(h.ratio + k_r * bounded, LEAST_FORCE_RATIO, LARGEST_FORCE_RATIO)
    h.disturbance = clip(h.disturbance + k_d * bounded, -MAX_DISTURBANCE, MAX_DISTURBANCE)
    h.p_speed, h.p_speed_ratio, h.p_speed_disturbance = v_v - k_v * v_v, v_r - k_v * v_r, v_d - k_v * v_d
    h.p_ratio = p_r - k_r * v_r + unlearned
    h.p_ratio_disturbance = p_rd - k_r * v_d - unlearned * acceleration
    h.p_disturbance = p_d - k_d * v_d + unlearned * square(acceleration)


@inlined
def _run_bank(bank, sign, other, other_sigma, resistance, speed, learns, period, age, elapsed, requests):
    """One step of a bank; resistance: m/s^2, with slope.

    other, other_sigma: m/s^2, signed acceleration by the other actuator, and its standard deviation.

    A standing car shows nothing: its brakes may hold it against any force. Without a speed (NaN) the actuators act on;
    the filters restart at the next one.
    """
    for h in bank:
        mean = sign * _act(h, period, age, elapsed, requests)
        if speed != speed or h.speed != h.speed or speed <= STANDING_SPEED:
            _restart_speed(h, speed)
        else:
            _update(h, mean, other - resistance, other_sigma, speed, learns, elapsed)


@inlined
def _share_mass(ratio, bank):
    """Assume the ratio of the other actuator, which shares the mass of the car, until a bank has learned its own."""
    for h in bank:
        if h.p_ratio >= square(RATIO_SIGMA):
            h.ratio = ratio


@inlined
def _widen_disturbance(bank):
    """Let the disturbance be as uncertain as at the start."""
    for h in bank:
        explained = square(h.p_ratio_disturbance) / max(h.p_ratio, LEAST_RATIO_VARIANCE)  # by the ratio
        h.p_disturbance = max(h.p_disturbance, explained + square(DISTURBANCE_SIGMA))


@inlined
def learn_actuators(speed, resistance, period, age, elapsed, is_sure, is_settled, banks):
    """Take in a speed (m/s; NaN: none) of an age (s), a time (s) after the last one.

    resistance: m/s^2, of air, rolling and known slope; period: s, of the requests; is_sure: whether brakes and drive
    work: otherwise only the disturbance is learned; is_settled: whether the requests have acted alone for so long that
    nothing else does: otherwise the disturbance is that, and nothing that lasts.
    """
    drive, brakes = mean_of_bank(banks.drive), mean_of_bank(banks.brakes)
    count = banks.requests.size // 2
    moves = is_sure and is_settled and speed > LEARNING_SPEED
    drives = drive.acting > LEAST_ACTION > brakes.acting
    brakes_act = brakes.acting > LEAST_ACTION > drive.acting
    _share_mass(drive.ratio, banks.brakes)
    _run_bank(
        banks.drive, 1.0, -brakes.ratio * brakes.acting, brakes.ratio * brakes.acting_sigma, resistance, speed,
        moves and drives, period, age, elapsed, banks.requests[:count],
    )  # fmt: skip
    _run_bank(
        banks.brakes, -1.0, drive.ratio * drive.acting, drive.ratio * drive.acting_sigma, resistance, speed,
        moves and brakes_act, period, age, elapsed, banks.requests[count:],
    )  # fmt: skip
    if not is_settled:
        _widen_disturbance(banks.drive)
        _widen_disturbance(banks.brakes)


@inlined
def _decay(lag, period):
    """Share of a gap that a lag (s) leaves after a period (s)."""
    return exp(-period / lag) if lag > 0.0 else 0.0


@inlined
def predicted_motion(speed, age, duration, resistance, drive, brakes, period, banks):
    """Speed (m/s), way (m), and what drive and brakes do (m/s^2), a duration (s) after a time that lies an age (s) ago.

    drive, brakes: `ActuatorBelief` at that time; resistance: m/s^2, of air, rolling and known slope. The requests so
    far act, the last one on and on.
    """
    count = banks.requests.size // 2
    drive_decay, brake_decay = _decay(drive.lag, period), _decay(brakes.lag, period)
    external = (brakes.disturbance if brakes.acting > drive.acting else drive.disturbance) - resistance
    driving, braking, time, way = drive.acting, brakes.acting, 0.0, 0.0
    while time < duration - WHOLE * period:
        step = min(period, duration - time)
        if step < period:
            drive_decay, brake_decay = _decay(drive.lag, step), _decay(brakes.lag, step)
        time += step
        driving_target = _requested(max(drive.dead_time + age - time, 0.0), period, banks.requests[:count])
        braking_target = _requested(max(brakes.dead_time + age - time, 0.0), period, banks.requests[count:])
        driving_after = driving_target + (driving - driving_target) * drive_decay
        braking_after = braking_target + (braking - braking_target) * brake_decay
        mean_driving, mean_braking = 0.5 * (driving + driving_after), 0.5 * (braking + braking_after)
        driving, braking = driving_after, braking_after
        before = speed
        speed = max(speed + step * (drive.ratio * mean_driving - brakes.ratio * mean_braking + external), 0.0)
        way += 0.5 * step * (before + speed)
    return speed, way, driving, braking


@inlined
def repeat_requests(times, requests):
    """Let the requests in force have been requested so many times more."""
    for _ in range(times):
        remember(requests[0], requests[requests.size // 2], requests)


@inlined
def remember(driving, braking, requests):
    """Add the requests (m/s^2) of drive and brakes, the latest first."""
    for j in range(requests.size - 1, 0, -1):
        requests[j] = requests[j - 1]
    requests[0], requests[requests.size // 2] = driving, braking


@inlined
def remember_request(force, hold, mass, requests):
    """Add a requested force and a hold of the brakes (N) over the mass (kg) to the requests."""
    remember(max(force, 0.0) / mass, (max(-force, 0.0) + hold) / mass, requests)


@inlined
def forget_speeds(banks):
    """Let the filters of both banks restart at the next speed."""
    for bank in (banks.drive, banks.brakes):
        for h in bank:
            h.speed = math.nan


@inlined
def _settle_bank(bank, acceleration, speed):
    """Let every hypothesis be at a requested acceleration (m/s^2) and at a speed (m/s), as if it had been for long."""
    for h in bank:
        h.filtered = acceleration
        _restart_speed(h, speed)


@inlined
def settle_actuators(speed, acceleration, banks):
    """Restart the filters at a speed (m/s) and a requested force over mass (m/s^2), without learning from either."""
    count = banks.requests.size // 2
    driving, braking = max(acceleration, 0.0), max(-acceleration, 0.0)
    _settle_bank(banks.drive, driving, speed)
    _settle_bank(banks.brakes, braking, speed)
    banks.requests[:count], banks.requests[count:] = driving, braking

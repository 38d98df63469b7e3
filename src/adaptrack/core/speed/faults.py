"""Detection of brakes without effect and of a drive that pulls without a request.

A Kalman filter predicts the speed of a healthy car on an unknown slope, whose grade changes along the way. A fault
adds a signature to the innovations: lost brake force grows with the braking requested, the pull of a drive begins at
once. Each signature and its size are tested by a likelihood ratio (A. S. Willsky and H. L. Jones, A generalized
likelihood ratio approach to the detection and estimation of jumps in linear systems, IEEE Trans. Autom. Control 21,
1976), from the time on at which the fault begins to be more likely than a slope. While lost brake force is suspected,
the car brakes harder: a slope does not follow the brakes.
"""

from __future__ import annotations

import math

from ..kernel import inlined
from ..maths.exact import clip, sqrt, square
from ..maths.exponential import exp
from .learning import DISTURBANCE_SIGMA, INNOVATION_BOUND, LEARNING_SPEED, SPEED_DRIFT, SPEED_NOISE, SPEED_NOISE_SHARE

NO_FAULT, BRAKES_FAIL, DRIVE_STICKS = range(3)
"""Faults."""
SLOPE_RATE, GUST_RATE, SLOPE_WAY = 0.035, 0.1, 20.0
"""1/s^2, over the speed; m/s^3; m: standard deviation with which the disturbance changes along a road and by gusts, and
the way after which the change is another."""
LEAST_RATIO_SIGMA, LEAST_DELAY_SIGMA, DELAY_TIME = 0.07, 0.04, 0.25
"""-, s, s: least standard deviations of learned actuators; time for which an error of the delay lasts."""
LEAST_SPEED_SIGMA, NOISE_TIME = 0.025, 4.0
"""m/s, s: least standard deviation of a measured speed, and the time constant of its estimate."""
USUAL_RELATIVE_SIGMA, MAX_RELATIVE_SIGMA, LEAST_RELATIVE_SPEED = 0.01, 0.02, 1.0
"""-, -, m/s: usual and largest standard deviation of a measured speed, as a share of the speed, estimated above this
speed."""
LEAST_LOSS, LEAST_STUCK_PULL, LARGEST_PULL, REGAINED_SHARE = 0.4, 2.0, 8.0, 0.7
"""-, m/s^2, m/s^2, -: sizes of faults: shares of the brake force lost, pull; share of the loss that ends."""
SUSPICION, BRAKE_EVIDENCE, PULL_EVIDENCE, DOUBT = 3.0, 9.0, 12.0, 1.0
"""Logarithms of likelihood ratios, from which a fault is suspected and reported, and below which brakes work."""
PROBE = 2.0
"""m/s^2, additional braking while a loss is suspected."""
LARGEST_DISTURBANCE = 4.5
"""m/s^2, of a slope and wind that the map has the other way round."""
JUDGED_BRAKING, PROVING_BRAKING, PROVING_TIME = 0.3, 1.0, 1.0
"""m/s^2, m/s^2, s: braking from which brakes are judged; braking, and for how long, that shows that they work."""
FAULT_TOP_SPEED = 3.0
"""m/s, after a fault of the brakes, until a second braking has confirmed that they work."""


@inlined
def forget_faults(speed, disturbance, memory):
    """Restart the filter at a speed (m/s) and a disturbance (m/s^2); a fault stays."""
    memory.watched_speed, memory.watched_disturbance, memory.watched_rate = speed, disturbance, 0.0
    memory.p_watched, memory.p_watched_disturbance, memory.p_watched_rate = square(SPEED_NOISE), 0.0, 0.0
    memory.p_disturbance, memory.p_disturbance_rate = 4.0 * square(DISTURBANCE_SIGMA), 0.0
    memory.p_rate = square(GUST_RATE + SLOPE_RATE * abs(speed))
    _forget_loss(memory)
    _forget_pull(memory)


@inlined
def _forget_loss(memory):
    """Let a loss of brake force begin now."""
    memory.loss_speed = memory.loss_disturbance = memory.loss_rate = 0.0
    memory.loss_match = memory.loss_energy = memory.loss_evidence = 0.0


@inlined
def _forget_pull(memory):
    """Let a pull of 1 m/s^2 begin now."""
    memory.pull_speed, memory.pull_disturbance, memory.pull_rate = 0.0, 1.0, 0.0
    memory.pull_match = memory.pull_energy = memory.pull_evidence = 0.0


@inlined
def end_fault(memory):
    """End a fault, as a driver or an operator does who knows that the car is in order."""
    memory.fault, memory.lost_share, memory.on_probation, memory.proven_time = NO_FAULT, 0.0, 0.0, 0.0
    _forget_loss(memory)
    _forget_pull(memory)


@inlined
def is_suspected(memory):
    """Whether brakes or drive fail, or may."""
    return memory.fault != NO_FAULT or max(memory.loss_evidence, memory.pull_evidence) > SUSPICION


@inlined
def probing_deceleration(memory):
    """Deceleration (m/s^2) in addition to the requested one, while a loss of brake force is suspected."""
    return PROBE if memory.loss_evidence > SUSPICION else 0.0


@inlined
def top_speed_after_fault(memory):
    """Largest speed (m/s) until a second braking has confirmed that brakes work again."""
    return FAULT_TOP_SPEED if memory.on_probation > 0.0 else math.inf


@inlined
def _predict(speed, disturbance, rate, acceleration, decay, period):
    """Speed, disturbance and its rate after a period (s)."""
    return (
        speed + period * (acceleration + disturbance + 0.5 * period * rate),
        disturbance + period * rate,
        decay * rate,
    )


@inlined
def _test(match, energy, least, largest):
    """Likeliest size of a fault, and logarithm of its likelihood ratio."""
    size = clip(match / energy, least, largest) if energy > 0.0 else least
    return size, size * match - 0.5 * square(size) * energy


@inlined
def _measure_noise(speed, period, memory):
    """Estimate the variance of measured speeds from their second differences, and that relative to the speed."""
    if memory.speed_variance <= 0.0:
        memory.speed_variance = square(SPEED_NOISE + SPEED_NOISE_SHARE * speed)
        memory.relative_variance = square(USUAL_RELATIVE_SIGMA)
        memory.last_speed, memory.last_change = speed, 0.0
    change, share = speed - memory.last_speed, period / NOISE_TIME
    variance = square(change - memory.last_change) / 6.0
    memory.speed_variance += (variance - memory.speed_variance) * share
    memory.speed_variance = max(memory.speed_variance, square(LEAST_SPEED_SIGMA))
    if speed > LEAST_RELATIVE_SPEED:
        memory.relative_variance += (variance / square(speed) - memory.relative_variance) * share
    memory.last_speed, memory.last_change = speed, change


@inlined
def _speed_variance(speed, memory):
    """Variance of a measured speed (m/s).

    The noise of wheels grows with the speed: while a car accelerates, an estimate of its variance alone would lag.
    """
    relative_variance = min(memory.relative_variance, square(MAX_RELATIVE_SIGMA))
    return max(memory.speed_variance, relative_variance * square(speed))


@inlined
def watch_actuators(speed, resistance, drive, brakes, period, memory):
    """Update the filter and the fault in a memory of the speed control.

    speed: m/s; resistance: m/s^2, of air, rolling and known slope; drive, brakes: `speed_learning.ActuatorBelief`.
    """
    _measure_noise(speed, period, memory)
    if speed < LEARNING_SPEED:
        forget_faults(speed, brakes.disturbance if brakes.acting > drive.acting else drive.disturbance, memory)
        memory.driving_before, memory.braking_before = drive.acting, brakes.acting
        return
    if brakes.acting < JUDGED_BRAKING or memory.brake_ratio <= 0.0:
        memory.brake_ratio, memory.brake_ratio_sigma = brakes.ratio, max(brakes.ratio_sigma, LEAST_RATIO_SIGMA)
    effect = memory.brake_ratio * brakes.acting
    acceleration = drive.ratio * drive.acting - (1.0 - memory.lost_share) * effect - resistance
    decay = exp(-period * speed / SLOPE_WAY)
    v, d, r = _predict(
        memory.watched_speed, memory.watched_disturbance, memory.watched_rate, acceleration, decay, period
    )
    # covariance
    t, h = period, 0.5 * square(period)
    d_d, d_r = memory.p_disturbance, memory.p_disturbance_rate
    v_v = memory.p_watched + t * memory.p_watched_disturbance + h * memory.p_watched_rate
    v_d = memory.p_watched_disturbance + t * d_d + h * d_r
    v_r = memory.p_watched_rate + t * d_r + h * memory.p_rate
    d_d, d_r = d_d + t * d_r, d_r + t * memory.p_rate
    v_v, v_d, v_r = v_v + t * v_d + h * v_r, v_d + t * v_r, decay * v_r
    d_d, d_r = d_d + t * d_r, decay * d_r
    r_r = square(decay) * memory.p_rate + (1.0 - square(decay)) * square(GUST_RATE + SLOPE_RATE * speed)
    braking_change = abs(brakes.acting - memory.braking_before)
    driving_change = abs(drive.acting - memory.driving_before)
    d_d += square(memory.brake_ratio_sigma) * braking_change * (brakes.acting + memory.braking_before)
    d_d += square(max(drive.ratio_sigma, LEAST_RATIO_SIGMA)) * driving_change * (drive.acting + memory.driving_before)
    late = memory.brake_ratio * (brakes.acting_sigma + LEAST_DELAY_SIGMA * braking_change / period)
    late_drive = drive.ratio * (drive.acting_sigma + LEAST_DELAY_SIGMA * driving_change / period)
    v_v += (square(late) + square(late_drive)) * period * DELAY_TIME + square(SPEED_DRIFT) * period
    memory.driving_before, memory.braking_before = drive.acting, brakes.acting
    # correction
    spread = v_v + _speed_variance(speed, memory)
    bound = INNOVATION_BOUND * sqrt(spread)
    e = clip(speed - v, -bound, bound)
    k_v, k_d, k_r = v_v / spread, v_d / spread, v_r / spread
    memory.p_watched, memory.p_watched_disturbance = v_v - k_v * v_v, v_d - k_v * v_d
    memory.p_watched_rate = v_r - k_v * v_r
    memory.p_disturbance, memory.p_disturbance_rate, memory.p_rate = d_d - k_d * v_d, d_r - k_d * v_r, r_r - k_r * v_r
    memory.watched_speed, memory.watched_disturbance, memory.watched_rate = v + k_v * e, d + k_d * e, r + k_r * e
    # signatures
    v, d, r = _predict(memory.loss_speed, memory.loss_disturbance, memory.loss_rate, effect, decay, period)
    memory.loss_match, memory.loss_energy = memory.loss_match + e * v / spread, memory.loss_energy + v * v / spread
    memory.loss_speed, memory.loss_disturbance, memory.loss_rate = v - k_v * v, d - k_d * v, r - k_r * v
    v, d, r = _predict(memory.pull_speed, memory.pull_disturbance, memory.pull_rate, 0.0, decay, period)
    memory.pull_match, memory.pull_energy = memory.pull_match + e * v / spread, memory.pull_energy + v * v / spread
    memory.pull_speed, memory.pull_disturbance, memory.pull_rate = v - k_v * v, d - k_d * v, r - k_r * v
    least, largest = LEAST_LOSS, 1.0
    if memory.lost_share > 0.0:
        least, largest = -memory.lost_share, -REGAINED_SHARE * memory.lost_share
    loss, memory.loss_evidence = _test(memory.loss_match, memory.loss_energy, least, largest)
    _, memory.pull_evidence = _test(memory.pull_match, memory.pull_energy, LEAST_STUCK_PULL, LARGEST_PULL)
    if memory.loss_evidence <= 0.0 or brakes.acting < JUDGED_BRAKING:
        _forget_loss(memory)
    if memory.pull_evidence <= 0.0:
        _forget_pull(memory)
    _judge(loss, brakes.acting, period, memory)


@inlined
def _judge(loss, braking, period, memory):
    """Report or end a fault; loss: likeliest change of the lost share of the brake force."""
    if memory.pull_evidence > PULL_EVIDENCE and memory.pull_evidence > memory.loss_evidence:
        memory.fault = DRIVE_STICKS
    elif memory.loss_evidence > BRAKE_EVIDENCE:
        if memory.lost_share == 0.0:
            memory.fault = max(memory.fault, BRAKES_FAIL)
        memory.watched_speed += loss * memory.loss_speed
        memory.watched_disturbance += loss * memory.loss_disturbance
        memory.watched_rate += loss * memory.loss_rate
        memory.lost_share, memory.proven_time = 0.0 if memory.lost_share > 0.0 else loss, 0.0
        _forget_loss(memory)
        _forget_pull(memory)
    elif memory.watched_disturbance > LARGEST_DISTURBANCE:
        memory.fault = max(memory.fault, BRAKES_FAIL)
    if braking < JUDGED_BRAKING:
        memory.proven_time = 0.0
    elif memory.lost_share == 0.0 and braking > PROVING_BRAKING:
        memory.proven_time += period
    if memory.proven_time > PROVING_TIME and memory.loss_evidence < DOUBT and memory.fault != DRIVE_STICKS:
        memory.on_probation = 1.0 if memory.fault == BRAKES_FAIL else 0.0
        memory.fault, memory.proven_time = NO_FAULT, -math.inf

"""Speed and place of a car at the present instant, from samples that are late, repeated or missing.

A speed counts once, with its age: from then on it is carried to the present by the requests that act. A Kalman filter
of place and scale of the speed adds the way of each control period once, and is corrected by each newer position. An
observer of the speed of the positions alone finds a speed that contradicts them.
"""

from __future__ import annotations

from ..kernel import inlined
from ..maths.exact import clip, sqrt, square
from ..maths.exponential import exp

LEAST_ELAPSED = 0.1
"""Control periods by which a sample is newer than the last one."""
SPEED_GRACE = 0.5
"""s, age up to which a speed counts, and is carried."""
SCALE_SIGMA, SCALE_DRIFT, WAY_NOISE = 0.03, 0.0005, 0.02
"""-, 1/sqrt(m), m/sqrt(s): standard deviation of the scale of the speed at the start; random walks of scale and way."""
MAX_SCALE = 0.1
"""Largest error of the scale of the speed."""
LEAST_POSE_SIGMA, MAX_POSE_SIGMA, POSE_MEMORY = 0.01, 2.0, 5.0
"""m, m, s: bounds of the standard deviation of a measured place, and the time constant of its estimate."""
MANY_POSITIONS = 200
"""Positions from which their variance is known."""
POSE_BOUND, JUMP_SIGMAS, POSE_JUMP = 4.0, 6.0, 1.0
"""-, -, m: standard deviations up to which an innovation counts; beyond the others the filter of the place restarts."""
OBSERVER_TIME, OBSERVER_JUMP, OBSERVER_GAP = 0.3, 1.0, 1.0
"""s, m, s: time constant of the observer; a larger difference counts as a jump of so much; it restarts after a longer
time without a position."""
CONTRADICTION_SHARE, CONTRADICTION_SPEED, CONTRADICTION_TIME = 0.1, 1.0, 0.5
"""-, m/s, s: a speed that differs by more than both from that of the positions for so long is no speed."""
DOUBT_SHARE = 0.5
"""Of such a difference, from which brakes and drive are not judged by the speed."""
MAX_DISTRUST, AGREEMENT_TIME = 2, 10.0
"""Contradictions, after which the car stays until a driver drives; s of agreement, after which they are forgotten."""
CONTRADICTION_NOISE = 1.0
"""1/s, over the standard deviation of a measured place: further difference that its noise explains."""
BACKWARDS_SPEED = 0.3
"""m/s, of positions that move backwards, from which an unsigned speed is taken for one backwards."""
MOTION_SMOOTHING = 0.35
"""Share of a new measurement in the filtered acceleration."""
MAX_MEASURED_ACCELERATION = 20.0
"""m/s^2, to which measured accelerations are limited."""


@inlined
def is_speed_known(memory):
    """Whether there is a speed that is not too old and agrees with the positions."""
    return memory.speed_age <= SPEED_GRACE and memory.is_distrusted == 0


@inlined
def take_motion(acceleration, elapsed, before, memory):
    """Filter the acceleration of the car (m/s^2): the measured one; NaN: from two speeds (m/s), elapsed s apart."""
    if acceleration != acceleration:
        acceleration = (memory.measured_speed - before) / elapsed
    bounded = clip(acceleration, -MAX_MEASURED_ACCELERATION, MAX_MEASURED_ACCELERATION)
    memory.motion += MOTION_SMOOTHING * (bounded - memory.motion)


@inlined
def _count_contradiction(is_contradiction, observed_speed, dt, memory):
    """Count for how long (s) the speed has contradicted the positions; negative: for how long they agree.

    observed_speed: m/s, of the positions. The speed is distrusted until they have agreed for as long, but after
    `MAX_DISTRUST` times in a row until a driver drives.
    """
    if is_contradiction:
        memory.contradiction = min(max(memory.contradiction, 0.0) + dt, 2.0 * CONTRADICTION_TIME)
        if memory.contradiction >= CONTRADICTION_TIME and memory.is_distrusted == 0:
            memory.is_distrusted, memory.distrust = 1, memory.distrust + 1
    elif memory.contradiction > 0.0:
        memory.contradiction = max(memory.contradiction - dt, 0.0)
    elif memory.is_distrusted > 0:
        memory.is_distrusted = 1 if memory.distrust >= MAX_DISTRUST else 0
    elif observed_speed > 2.0 * CONTRADICTION_SPEED:
        memory.contradiction -= dt
        if memory.contradiction <= -AGREEMENT_TIME:
            memory.contradiction, memory.distrust = -AGREEMENT_TIME, 0


@inlined
def _speed_noise(memory):
    """Noise (m/s) of the speed of the positions."""
    return CONTRADICTION_NOISE * sqrt(memory.observer_variance)


@inlined
def _allowed_difference(memory):
    """Largest difference (m/s) between the speed of the positions and the measured one without a contradiction."""
    return max(CONTRADICTION_SHARE * abs(memory.measured_speed), CONTRADICTION_SPEED) + _speed_noise(memory)


@inlined
def is_speed_doubted(memory):
    """Whether the positions contradict the measured speed, or may soon."""
    is_observed = memory.observer_time <= OBSERVER_GAP
    doubts = is_observed and abs(memory.observed_excess) > DOUBT_SHARE * _allowed_difference(memory)
    return doubts or memory.contradiction > 0.0


@inlined
def compare_with_positions(place, age, projection, dt, memory):
    """Observe the speed of the positions, and for how long it has contradicted the measured one.

    place: m, where the car was an age (s) ago; NaN: no newer position; projection: way along the path over that of the
    car; dt: s, since the last call.
    """
    speed = (1.0 + memory.scale) * projection * memory.carried_speed
    memory.observed_place += (speed + memory.observed_excess) * dt
    memory.observer_time += dt
    if place == place:
        interval, memory.observer_time = memory.observer_time, 0.0
        observation = place + (speed + memory.observed_excess) * age
        error = observation - memory.observed_place
        if interval > OBSERVER_GAP:
            memory.observed_place, memory.observed_excess = observation, 0.0
        else:
            change = min(square(error - memory.observer_error), square(OBSERVER_JUMP))  # free of a wrong speed
            share = min(interval / POSE_MEMORY, 0.5)
            memory.observer_variance += (0.5 * change - memory.observer_variance) * share
            memory.observer_error = error
            decay = exp(-interval / OBSERVER_TIME)  # critically damped
            memory.observed_place += (1.0 if abs(error) > OBSERVER_JUMP else 1.0 - square(decay)) * error
            memory.observed_excess += square(1.0 - decay) / interval * clip(error, -OBSERVER_JUMP, OBSERVER_JUMP)
    if memory.observer_time > OBSERVER_GAP:
        return
    is_contradiction = memory.speed_age <= SPEED_GRACE and abs(memory.observed_excess) > _allowed_difference(memory)
    _count_contradiction(is_contradiction, abs(speed + memory.observed_excess), dt, memory)
    is_backwards = speed + memory.observed_excess < -BACKWARDS_SPEED - _speed_noise(memory)
    memory.direction = -1.0 if is_backwards and speed > 0.0 else 1.0


@inlined
def predict_place(way, dt, memory):
    """Add a way (m, of the measured speed) in a time (s) to the place."""
    memory.station += (1.0 + memory.scale) * way
    if way == 0.0:
        return
    p_sc = memory.p_station_scale + way * memory.p_scale
    memory.p_station += way * (memory.p_station_scale + p_sc) + square(WAY_NOISE) * dt
    memory.p_station_scale = p_sc
    memory.p_scale = min(memory.p_scale + square(SCALE_DRIFT) * abs(way), square(SCALE_SIGMA))


@inlined
def restart_place(place, memory):
    """Let the car be at a place (m); what is known of the scale of the speed stays."""
    memory.pose_variance = max(memory.pose_variance, square(LEAST_POSE_SIGMA))
    memory.station, memory.p_station, memory.p_station_scale = place, memory.pose_variance, 0.0
    if memory.is_placed == 0:
        memory.p_scale, memory.is_placed = square(SCALE_SIGMA), 1


@inlined
def correct_place(measured, interval, memory):
    """Correct place and scale by a measured place (m), an interval (s) after the last one.

    The variance of a measured place follows from the innovations. Where place and measurement disagree beyond what both
    allow, the filter restarts there.
    """
    memory.pose_place = measured
    if memory.is_placed == 0:
        restart_place(measured, memory)
        return
    innovation = measured - memory.station
    spread = memory.p_station + memory.pose_variance
    bound, memory.surprise = POSE_BOUND * sqrt(spread), square(innovation) / spread
    bounded = clip(innovation, -bound, bound)
    memory.is_placed = min(memory.is_placed + 1, MANY_POSITIONS)
    share = min(max(interval / POSE_MEMORY, 1.0 / (memory.is_placed + 20)), 0.5)
    variance = memory.pose_variance + (min(square(innovation), square(POSE_JUMP)) - spread) * share
    memory.pose_variance = clip(variance, square(LEAST_POSE_SIGMA), square(MAX_POSE_SIGMA))
    if abs(innovation) > max(JUMP_SIGMAS * sqrt(spread), POSE_JUMP):
        memory.jump = abs(innovation)
        restart_place(measured, memory)
        return
    k_s, k_c = memory.p_station / spread, memory.p_station_scale / spread
    memory.station += k_s * bounded
    memory.scale = clip(memory.scale + k_c * bounded, -MAX_SCALE, MAX_SCALE)
    memory.p_scale -= k_c * memory.p_station_scale
    memory.p_station, memory.p_station_scale = (1.0 - k_s) * memory.p_station, (1.0 - k_s) * memory.p_station_scale

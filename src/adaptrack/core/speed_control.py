"""Speed control along a planned path: governor, follower, stops and traction guard, once a control period.

    governor   lowers the squares of the planned speeds ahead to what the assumed friction leaves, and after a slide to
               less, by one backward pass
    follower   acceleration at the place where the request acts: the plan's, the error of the speed, a disturbance
    stop       before a stop constant jerk, so that speed and acceleration reach 0 together; hold pressure after it
    guard      a share of the force that each axle has left in addition to its lateral force; a car that slides, or
               that sways and has rear drive, gets less drive force, or none

The plan lies on an even grid of places. While a driver uses the pedals, the requests follow the motion of the car.
Without a position the car brakes so that it stands before the steering loses its estimate; without any estimate, or
without a speed, it stops with the deceleration of comfort.
"""

from __future__ import annotations

import math

from .actuator_faults import BRAKES_FAIL, NO_FAULT, forget_faults, watch_actuators
from .kernel import exported, float64, inlined, int64, record, vector, void
from .loop import STANDING_SPEED
from .maths.bits import whole
from .maths.exact import clip, floor, sqrt, square
from .maths.exponential import power
from .plants.forces import GRAVITY
from .speed_learning import (
    LEAST_ACTION,
    coming_motion,
    learn_actuators,
    mean_of_bank,
    remember_request,
    settle_actuators,
)
from .traction import LARGEST_BEND_SHARE, LEAST_BRAKING, axle_limits

SPEED_SETTINGS = (
    "period",  # s
    "mass", "lf", "lr", "cg_height", "drive_front", "brake_front",  # kg, m, m, m, -, -
    "engine_power", "traction_limit", "brake_limit",  # W, N, N
    "drag", "rolling",  # kg/m, force of the air over v^2; m/s^2
    "accelerate", "brake", "emergency", "stop_jerk",  # m/s^2, m/s^2, m/s^2, m/s^3
    "friction", "friction_high",  # -, assumed: the low and the high end of its interval, in a bend
    "straight_ratio",  # -, friction on a straight over that in a bend
    "governor", "guard",  # -, shares: of the friction sideways ahead; of what the axles have left now
    "drive_lag", "drive_dead_time", "brake_lag", "brake_dead_time",  # s, NaN: learned while driving
    "gain",  # 1/s
    "patience",  # s without a position, after which the steering has no estimate; 0: unlimited
)  # fmt: skip
SpeedSettings = record("SpeedSettings", SPEED_SETTINGS)
"""Car, comfort, friction and gains of a speed controller."""

SpeedPath = record(
    "SpeedPath",
    (
        ("square", vector), ("curvature", vector), ("slope", vector), ("bank", vector), ("stops", vector),
        ("seconds", vector), ("spacing", float64), ("length", float64), ("closed", int64),
    ),
)  # fmt: skip
"""A plan at even places (n,): squares of the speed (m^2/s^2), curvature (1/m), g sin(slope) and g sin(bank) (m/s^2);
stops (m, ascending) and how long to stand there (s); spacing and length (m); closed: 1 for a lap."""

SPEED_SAMPLE = record(
    "SpeedSample",
    (
        "station", "speed", "yaw_rate",  # m, over all laps; m/s; rad/s. NaN: no position, not measured
        "acceleration",  # m/s^2, measured along the car, without gravity; NaN: not measured
        "driver",  # 1: a driver uses the pedals
        "top_speed",  # m/s, up to which the steering of the car is known
        "blind_time",  # s, since the last position
        "grade",  # dz/ds under the car, measured, positive uphill; NaN: that of the path
        "elapsed",  # s, between the last two measured speeds; 0: a control period
    ),
)  # fmt: skip
"""What a speed controller is given once a control period."""

OFF, DRIVING, STOPPING, WAITING, EMERGENCY = range(5)
"""States."""
(
    BY_PLAN, BY_COMFORT, BY_GRIP, BY_STOP, BY_PATH_END, BY_FAULT, BY_DRIVER, BY_UNKNOWN_STEERING, BY_POWERTRAIN,
    BY_BRAKE_FAULT, BY_DRIVE_FAULT,
) = range(11)  # fmt: skip
"""Causes that limit the speed or the acceleration."""

SPEED_MEMORY = record(
    "SpeedMemory",
    (
        "state", "limited_by", "next_stop",  # the last one: of `SpeedPath.stops`, those of past laps included
        "standing",  # s, at the present stop
        "creeping",  # s, braked with a speed of nearly 0
        "acceleration", "force", "hold",  # m/s^2, N, N: requests in force; hold: of the brakes besides the force
        "target_speed", "grip_used",  # m/s, -: lateral and longitudinal acceleration over the assumed friction
        "speed", "station",  # m/s, m: last known, the station filtered
        "lateral",  # m/s^2, filtered
        "motion",  # m/s^2, acceleration of the car, filtered
        "handover",  # m/s^2, of the request beyond the follower's after a driver's; NaN: while one drives
        "speed_age",  # s, since a speed was measured
        "fault",  # see `actuator_faults`, and its filters:
        "working_speed", "working_disturbance",  # m/s, m/s^2: with brakes that work
        "brakeless_speed", "brakeless_disturbance",  # m/s, m/s^2: without brakes
        "time",  # s, of the last period behind a tracker
        "friction", "friction_high",  # -, ends of its interval, see `friction_estimate`; 0: those of the settings
        "brake_evidence", "drive_evidence", "watched_time",  # -, -, s: of faults, see `actuator_faults`
        "cautious_friction",  # -, at most the low end: of bends ahead and drive forces
        "scale",  # -, way along the path over that of the measured speed, less 1
        "p_station", "p_station_scale", "p_scale",  # m^2, m, -: covariance of station and scale
        "pose_variance",  # m^2, of a measured station
        "speed_time",  # s, of the last measured speed behind a tracker
        "slide", "sway",  # m/s^2, lateral acceleration by the yaw rate beyond friction and path, lowered with the time
    ),
    integers=("state", "limited_by", "next_stop", "fault"),
)  # fmt: skip
"""What a speed controller remembers, and its answer."""

LEAST_ELAPSED, LARGEST_ELAPSED = 0.5, 3.0
"""Control periods between two speeds: a loop that jitters skips some; after more the filters restart."""
MAX_PLAN_GRADE = 0.4
"""dz/ds of a plan; a measured grade beyond it, either way, counts as not measured."""
STOP_TOLERANCE, OVERSHOOT, REACHED = 0.5, 2.0, 0.03
"""m: a car that stands so near a stop has reached it; so far beyond it stays; the least remaining way."""
CREEPING_SPEED, CREEPING_TIME = 0.15, 1.0
"""m/s, s: a braked car that is so slow for so long stands; a sensor may have this offset."""
CREEP_STIFFNESS = 10.0
"""1/s^2, over the distance (m) from a stop: additional deceleration by the brakes that hold the car."""
EMERGENCY_RATIO = 1.4
"""Deceleration that a stop needs over that of comfort, from which braking is an emergency."""
STRAIGHT = 1e-5
"""1/m, below which a curvature limits no speed."""
LATERAL_SMOOTHING = 0.35
"""Share of a new measurement in the filtered lateral acceleration."""
SLIDE_TIME, SLIDE_CAUTION, LARGEST_SLIDE_SHARE = 5.0, 0.5, 0.4
"""s, in which a slide is forgotten; -, share of it that bends ahead do not use, and the largest of their grip."""
SWAY_TIME, SWAY_CAUTION, SWAY_MARGIN = 2.0, 3.0, 0.45
"""s, in which a sway is forgotten; -, factor with which it counts for a drive force at the rear; -, share of the
friction beyond what the path asks for, where it begins."""
HOLD_RESERVE = 1.0
"""m/s^2, by which the brakes hold more than the slope demands."""
HOLDING_LAGS = 2.0
"""Lags of the brakes, in addition to their dead time, after which they hold the car."""
START_RESERVE = 0.3
"""m/s^2, by which the drive carries more than an ascent before the brakes are released."""
LEAD_DISTANCE = 2.0
"""m, over which the acceleration of the plan is taken."""
BRAKE_CAUTION, KNOWN_DELAY = 2.0, 0.05
"""-, s: a stop begins earlier by the way in the caution times the standard deviation of the delay of the brakes beyond
that of known ones, chosen on 16 cars."""
STOP_SOFTENING = 0.6
"""1/s, by which the jerk of a stop decreases with the lag of the brakes, chosen on 40 cars."""
COMFORT_RESERVE = 1.2
"""Factor on the accelerations of comfort within which errors of the speed are corrected."""
MOTION_SMOOTHING = 0.35
"""Share of a new measurement in the filtered acceleration."""
HANDOVER_JERK = 5.0
"""m/s^3, with which a request goes from a driver's to less; to more with the jerk of stops."""
BLIND_GRACE = 0.5
"""s without a position or a speed, during which the plan is followed."""
BLIND_SHARE = 0.8
"""Of the deceleration of comfort: where a car without a position needs so much to stand in time, it brakes."""
SCALE_SIGMA, SCALE_DRIFT, WAY_NOISE = 0.02, 0.001, 0.02
"""-, 1/sqrt(m), m/sqrt(s): standard deviation of the scale of the speed at the start; random walks of scale and way."""
LEAST_POSE_SIGMA, POSE_MEMORY = 0.01, 5.0
"""m, s: least standard deviation of a measured station, and the time constant of its estimate."""
POSE_BOUND, POSE_JUMP = 4.0, 1.0
"""-, m: standard deviations up to which an innovation counts; beyond both a position has jumped."""
LEAST_SPEED_AHEAD = 0.3
"""m/s, with which a car is taken to go on at a stop ahead."""


# -- the path ---------------------------------------------------------------------------------------------------------
@inlined
def cell_at(place, path):
    """Return the cell of a place (m) on the grid, within an open path or around a closed one."""
    index = whole(floor(place / path.spacing))
    if path.closed > 0:
        return index % path.square.size
    return min(max(index, 0), path.square.size - 1)


@inlined
def _stop_place(k, path):
    """Station (m) of the k-th stop over all laps; inf beyond the last."""
    count = path.stops.size
    if count == 0 or (path.closed == 0 and k >= count):
        return math.inf
    return path.stops[k % count] + (k // count) * path.length


@inlined
def _square_at(place, station, path, ahead):
    """Governed square of the speed (m^2/s^2) at a place ahead of the station (m), linear between the cells."""
    offset = (place - floor(station / path.spacing) * path.spacing) / path.spacing
    first = min(max(whole(floor(offset)), 0), ahead.size - 2)
    return ahead[first] + clip(offset - first, 0.0, 1.0) * (ahead[first + 1] - ahead[first])


@inlined
def _axle_forces(friction, lateral, settings):
    """Largest driving and braking force (N) beside a lateral acceleration (m/s^2), at a friction in bends."""
    ratio = settings.straight_ratio
    return axle_limits(ratio * friction, settings.mass * GRAVITY, ratio * lateral, settings)


@inlined
def slope_of(grade):
    """Deceleration (m/s^2) by gravity on a grade (dz/ds, positive uphill)."""
    return GRAVITY * grade / sqrt(1.0 + square(grade))


# -- the governor -----------------------------------------------------------------------------------------------------
@inlined
def _govern(station, top_square, settings, path, memory, ahead):
    """Write the squares of the speeds (m^2/s^2) that friction and comfort allow at the cells from the station on.

    top_square: m^2/s^2, of the speed up to which the steering is known.
    """
    first, grip = whole(floor(station / path.spacing)), memory.friction * GRAVITY
    bend_grip = settings.governor * memory.cautious_friction * GRAVITY
    bend_grip -= min(SLIDE_CAUTION * memory.slide, LARGEST_SLIDE_SHARE * bend_grip)
    for j in range(ahead.size):
        cell = cell_at((first + j + 0.5) * path.spacing, path)
        square_speed, curvature = min(path.square[cell], top_square), path.curvature[cell]
        if abs(curvature) > STRAIGHT:
            tilt = path.bank[cell] if curvature > 0.0 else -path.bank[cell]
            square_speed = min(square_speed, max(bend_grip + tilt, 0.0) / abs(curvature))
        ahead[j] = square_speed
    for j in range(ahead.size - 2, -1, -1):
        if ahead[j] <= ahead[j + 1]:
            continue
        cell = cell_at((first + j + 0.5) * path.spacing, path)
        lateral = min(abs(ahead[j + 1] * path.curvature[cell] - path.bank[cell]), LARGEST_BEND_SHARE * grip)
        _, braking = _axle_forces(memory.friction, lateral, settings)
        deceleration = min(settings.guard * braking / settings.mass + path.slope[cell], settings.brake)
        ahead[j] = min(ahead[j], ahead[j + 1] + 2.0 * path.spacing * max(deceleration, LEAST_BRAKING))


# -- one period -------------------------------------------------------------------------------------------------------
@inlined
def _stopping_motion(way, lead, jerk, settings):
    """Speed (m/s) on the way (m) to a stop, and acceleration (m/s^2) there a lead (s) later.

    The deceleration of comfort is followed by a constant jerk (m/s^3), with which both reach 0 together.
    """
    if way <= 0.0:
        return 0.0, 0.0
    easing = settings.brake / jerk  # s, of the jerk
    easing_way = jerk * easing * easing * easing / 6.0
    if way >= easing_way:
        return sqrt(square(0.5 * settings.brake * easing) + 2.0 * settings.brake * (way - easing_way)), -settings.brake
    remaining = power(6.0 * way / jerk, 1.0 / 3.0)
    return 0.5 * jerk * remaining * remaining, -jerk * max(remaining - lead, 0.0)


@inlined
def _hold(slope, settings, memory):
    """Stand: no drive, and brakes that hold the slope with a reserve."""
    memory.acceleration, memory.force = 0.0, 0.0
    memory.hold = settings.mass * (abs(slope) + HOLD_RESERVE)
    memory.target_speed = 0.0


@inlined
def _resistance(speed, slope, settings):
    """Deceleration (m/s^2) by air, rolling and the known slope."""
    return settings.drag * speed * speed / settings.mass + settings.rolling * clip(2.0 * speed, 0.0, 1.0) + slope


@inlined
def _request(acceleration, speed, slope, lateral, drive, brakes, settings, memory):
    """Turn an acceleration (m/s^2) into a force (N) within powertrain, brakes and guard; note a bound as the cause.

    drive, brakes: `speed_learning.ActuatorBelief`.
    """
    braking_now = brakes.acting > drive.acting
    disturbance = brakes.disturbance if braking_now else drive.disturbance
    resistance = _resistance(speed, slope, settings) - disturbance
    tyres = acceleration + resistance  # m/s^2, of all tyres
    ratio = drive.ratio if tyres > 0.0 else brakes.ratio
    demand = settings.mass * tyres / ratio
    friction = memory.friction
    if memory.state == EMERGENCY:
        friction = memory.friction_high
    elif tyres > 0.0:
        sway = SWAY_CAUTION * (1.0 - settings.drive_front) * memory.sway
        lateral = (lateral + sway) * friction / memory.cautious_friction
    elif acceleration < -settings.brake:
        friction = 0.5 * (memory.friction + memory.friction_high)
    bend = min(lateral, LARGEST_BEND_SHARE * friction * GRAVITY) if tyres <= 0.0 else lateral
    driving, braking = _axle_forces(friction, bend, settings)
    powertrain = min(settings.traction_limit, settings.engine_power / max(speed, 1.0))
    strongest, weakest = settings.guard * driving, -max(settings.guard * braking, LEAST_BRAKING * settings.mass)
    force = clip(clip(demand, weakest, strongest), -settings.brake_limit, powertrain)
    memory.force, memory.acceleration = force, ratio * force / settings.mass - resistance
    if not weakest <= demand <= strongest:
        memory.limited_by = BY_GRIP
    elif force != demand:
        memory.limited_by = BY_POWERTRAIN


@inlined
def _stand(beyond, slope, lateral, drive, brakes, settings, memory):
    """Stand so far beyond a stop (m); until the brakes hold, the drive carries an ascent."""
    is_held = memory.standing > brakes.dead_time + HOLDING_LAGS * brakes.lag + brakes.delay_sigma
    cause = memory.limited_by
    _request(0.0, 0.0, slope, lateral, drive, brakes, settings, memory)
    force = memory.force
    _hold(slope, settings, memory)
    creep_reserve = CREEP_STIFFNESS * min(abs(beyond), STOP_TOLERANCE)
    memory.hold = min(memory.hold + settings.mass * creep_reserve, settings.brake_limit)
    memory.force, memory.limited_by = 0.0 if is_held or slope <= 0.0 else max(force, 0.0), cause


@inlined
def _count_creeping(speed, settings, memory):
    """Count the time for which a braked car has a speed (m/s) of nearly 0."""
    is_braked = memory.force < 0.0 or memory.hold > 0.0
    memory.creeping = memory.creeping + settings.period if is_braked and abs(speed) < CREEPING_SPEED else 0.0


@inlined
def _stands(speed, memory):
    """Whether a car of a speed (m/s) stands."""
    return speed < STANDING_SPEED or memory.creeping > CREEPING_TIME


@inlined
def _pass_stop(station, speed, settings, path, memory):
    """Count the time at a stop; go on to the next one when it is over, or the car is far beyond one that ends."""
    beyond = station - _stop_place(memory.next_stop, path)
    is_missed = beyond > OVERSHOOT and path.seconds[memory.next_stop % path.stops.size] < math.inf
    near = beyond >= -STOP_TOLERANCE and not is_missed
    if near and _stands(abs(speed), memory) and (memory.state == STOPPING or memory.state == EMERGENCY):
        memory.state, memory.standing = WAITING, 0.0
    if memory.state == WAITING:
        memory.standing += settings.period
        if memory.standing >= path.seconds[memory.next_stop % path.stops.size]:
            memory.next_stop += 1
            memory.state, memory.standing = DRIVING, 0.0
    elif is_missed:
        memory.next_stop += 1


@inlined
def _stop_cause(path, memory):
    """Cause of the next stop."""
    return BY_PATH_END if path.seconds[memory.next_stop % path.seconds.size] == math.inf else BY_STOP


@inlined
def _blind_deceleration(speed, blind_time, delay, settings):
    """Deceleration (m/s^2) with which a car stands before the steering loses its estimate; 0: none is needed yet.

    It is v over the time left less the delay (s) of the brakes.
    """
    if settings.patience <= 0.0 or blind_time <= BLIND_GRACE:
        return 0.0
    needed = speed / max(settings.patience - blind_time - delay, settings.period)
    return min(needed, settings.emergency) if needed > BLIND_SHARE * settings.brake else 0.0


@inlined
def _yield_to_driver(speed, slope, lateral, drive, brakes, settings, memory, banks):
    """Let the requests follow the motion that a driver gives to the car; nothing is learned."""
    memory.state, memory.handover = OFF, math.nan
    if speed < STANDING_SPEED:
        _hold(slope, settings, memory)
    else:
        memory.hold = 0.0
        _request(memory.motion, speed, slope, lateral, drive, brakes, settings, memory)
    memory.limited_by, memory.target_speed, memory.fault = BY_DRIVER, speed, NO_FAULT
    settle_actuators(speed, memory.force / settings.mass, banks)


@inlined
def _hand_over(demand, settings, memory):
    """Return the demand (m/s^2) with what is left of the acceleration that a driver has handed over."""
    if memory.handover != memory.handover:
        memory.handover = memory.acceleration - demand
    else:
        memory.handover -= clip(memory.handover, -settings.stop_jerk * settings.period, HANDOVER_JERK * settings.period)
    return demand + memory.handover


@inlined
def _stop_unguided(deceleration, speed, slope, lateral, drive, brakes, settings, memory):
    """Brake (m/s^2) to a standstill wherever the car is, and hold it there."""
    memory.handover = 0.0
    if _stands(speed, memory):
        _hold(slope, settings, memory)
        if memory.fault != NO_FAULT:
            memory.hold = settings.brake_limit
    else:
        memory.state = EMERGENCY if deceleration > EMERGENCY_RATIO * settings.brake else STOPPING
        memory.target_speed, memory.hold = 0.0, 0.0
        _request(-deceleration, speed, slope, lateral, drive, brakes, settings, memory)
    memory.limited_by = BY_FAULT
    if memory.fault != NO_FAULT:
        memory.force = min(memory.force, 0.0)
        memory.state, memory.limited_by = EMERGENCY, BY_BRAKE_FAULT if memory.fault == BRAKES_FAIL else BY_DRIVE_FAULT


@inlined
def _follow(station, speed, slope, top_square, lateral, drive, brakes, settings, path, memory, banks, ahead):
    """Follow the governed speeds and the next stop; write the requests."""
    braking_share = 1.0 if memory.force < 0.0 else 0.0
    if memory.force >= 0.0 and memory.acceleration < 0.0:  # on an ascent the drive takes over at the end of a stop
        braking_share = brakes.acting / max(brakes.acting + drive.acting, LEAST_ACTION)
    delay = drive.dead_time + braking_share * (brakes.dead_time - drive.dead_time)
    lag = drive.lag + braking_share * (brakes.lag - drive.lag)
    resistance = _resistance(speed, slope, settings)
    coming_speed, coming_way = coming_motion(speed, delay, resistance, drive, brakes, settings.period, banks)
    place = station + coming_way
    lead = place + coming_speed * lag
    target_square = _square_at(place, station, path, ahead)
    target = sqrt(max(target_square, 0.0))
    change = _square_at(lead + LEAD_DISTANCE, station, path, ahead) - _square_at(lead, station, path, ahead)
    acceleration = 0.5 * change / LEAD_DISTANCE
    memory.limited_by = BY_GRIP
    if target_square >= path.square[cell_at(place, path)] * 0.999:
        memory.limited_by = BY_PLAN
    elif target_square >= top_square * 0.999:
        memory.limited_by = BY_UNKNOWN_STEERING
    stop = _stop_place(memory.next_stop, path)
    jerk = settings.stop_jerk / (1.0 + STOP_SOFTENING * brakes.lag)
    caution_way = BRAKE_CAUTION * max(brakes.delay_sigma - KNOWN_DELAY, 0.0) * coming_speed
    stop_speed, stop_acceleration = _stopping_motion(stop - place - caution_way, lag, jerk, settings)
    if stop_speed < target or stop - place <= 0.0:
        memory.state, memory.limited_by = STOPPING, _stop_cause(path, memory)
        target = stop_speed
        acceleration = stop_acceleration
        is_far = stop - place > STOP_TOLERANCE
        if is_far and square(coming_speed) > 2.0 * EMERGENCY_RATIO * settings.brake * (stop - place):
            memory.state = EMERGENCY
    elif memory.state == STOPPING or memory.state == EMERGENCY:
        memory.state = DRIVING
    memory.target_speed = target
    if memory.state == EMERGENCY:
        memory.hold, memory.handover = 0.0, 0.0
        needed = 0.5 * square(coming_speed) / max(stop - place, REACHED)
        _request(-min(needed, settings.emergency), speed, slope, lateral, drive, brakes, settings, memory)
        return
    if memory.state == STOPPING and speed < STANDING_SPEED and stop - station < STOP_TOLERANCE:
        memory.standing = 0.0
        _stand(station - stop, slope, lateral, drive, brakes, settings, memory)
        return
    demand = acceleration + settings.gain * (target - coming_speed)
    bounded = clip(demand, -COMFORT_RESERVE * settings.brake, COMFORT_RESERVE * settings.accelerate)
    if bounded != demand and memory.limited_by == BY_PLAN:
        memory.limited_by = BY_COMFORT
    _request(_hand_over(bounded, settings, memory), speed, slope, lateral, drive, brakes, settings, memory)
    memory.hold = 0.0
    if memory.force > 0.0 and speed < STANDING_SPEED and drive.ratio * drive.acting < slope + START_RESERVE:
        memory.hold = settings.mass * (slope + HOLD_RESERVE) if slope > 0.0 else 0.0  # until the drive carries it


@inlined
def _locate(measured, way, settings, memory):
    """Predict the station by a way (m, of the measured speed) and correct it by a measured one (m; NaN: none).

    A Kalman filter of station and scale of the speed; the variance of a position follows from the innovations. While
    the control is off, or when the position jumps, the filter restarts at the measured station.
    """
    memory.station += (1.0 + memory.scale) * way
    p_ss, p_cc = memory.p_station, memory.p_scale
    p_sc = memory.p_station_scale + way * p_cc
    if way != 0.0:
        p_ss += way * (memory.p_station_scale + p_sc) + square(WAY_NOISE) * settings.period
        p_cc = min(p_cc + square(SCALE_DRIFT) * abs(way), square(SCALE_SIGMA))
    if measured == measured:
        innovation = measured - memory.station
        spread = p_ss + memory.pose_variance
        bound = POSE_BOUND * sqrt(spread)
        if memory.state == OFF or abs(innovation) > max(bound, POSE_JUMP):
            memory.pose_variance = max(memory.pose_variance, square(LEAST_POSE_SIGMA))
            memory.station, p_ss, p_sc, p_cc = measured, memory.pose_variance, 0.0, square(SCALE_SIGMA)
        else:
            innovation = clip(innovation, -bound, bound)
            k_s, k_c = p_ss / spread, p_sc / spread
            memory.station += k_s * innovation
            memory.scale += k_c * innovation
            change = (square(innovation) - spread) * settings.period / POSE_MEMORY
            memory.pose_variance = max(memory.pose_variance + change, square(LEAST_POSE_SIGMA))
            p_cc -= k_c * p_sc
            p_ss, p_sc = (1.0 - k_s) * p_ss, (1.0 - k_s) * p_sc
    memory.p_station, memory.p_station_scale, memory.p_scale = p_ss, p_sc, p_cc


@inlined
def _take_motion(sample, elapsed, settings, memory):
    """Take in a sample after a time (s); where speed, station or acceleration are missing, carry on the last ones."""
    before, is_first = memory.speed, memory.speed_age > 0.0 or (memory.state == OFF and memory.limited_by == BY_PLAN)
    if sample.speed == sample.speed:
        memory.speed, memory.speed_age = sample.speed, 0.0
    else:
        memory.speed_age += settings.period
        if memory.state != OFF:
            memory.speed = max(memory.speed + memory.acceleration * settings.period, 0.0)
    acceleration = sample.acceleration
    if acceleration != acceleration:
        acceleration = 0.0 if is_first else (memory.speed - before) / elapsed
    memory.motion += MOTION_SMOOTHING * (acceleration - memory.motion)
    _locate(sample.station, 0.5 * (before + memory.speed) * elapsed, settings, memory)


@inlined
def speed_control(sample, settings, path, memory, banks, ahead):
    """One control period: write state, requests and causes to the memory, and the governed squares to ahead.

    Drive and brakes are learned first, from the speed that the requests so far have made.

    sample: `SPEED_SAMPLE`; its grade replaces that of the path where the car is, not ahead of it; ahead: (n,), at the
    cells from the station on.
    """
    yaw_rate, top_square = sample.yaw_rate, square(sample.top_speed)
    if memory.friction <= 0.0:
        memory.friction, memory.friction_high = settings.friction, settings.friction_high
        memory.cautious_friction = settings.friction
    elapsed = max(sample.elapsed, LEAST_ELAPSED * settings.period) if sample.elapsed > 0.0 else settings.period
    is_gap = elapsed > LARGEST_ELAPSED * settings.period
    was_blind = memory.speed_age > 0.0 or is_gap
    _take_motion(sample, elapsed, settings, memory)
    station, speed = memory.station, memory.speed
    cell = cell_at(station, path)
    slope = slope_of(sample.grade) if abs(sample.grade) <= MAX_PLAN_GRADE else path.slope[cell]
    bend = abs(speed * speed * path.curvature[cell] - path.bank[cell])
    if yaw_rate == yaw_rate:
        memory.lateral += LATERAL_SMOOTHING * (abs(speed * yaw_rate - path.bank[cell]) - memory.lateral)
    memory.slide -= memory.slide * settings.period / SLIDE_TIME
    memory.slide = max(memory.slide, memory.lateral - memory.friction * GRAVITY)
    memory.sway -= memory.sway * settings.period / SWAY_TIME
    memory.sway = max(memory.sway, memory.lateral - bend - SWAY_MARGIN * memory.friction * GRAVITY)
    lateral = max(memory.lateral, bend)
    if memory.state == OFF:
        while _stop_place(memory.next_stop, path) < station - OVERSHOOT:
            memory.next_stop += 1
    is_driven = sample.driver > 0.0
    if memory.fault == BRAKES_FAIL:
        settle_actuators(speed, memory.force / settings.mass, banks)
    elif not is_driven:
        measured = math.nan if is_gap else sample.speed
        learn_actuators(measured, _resistance(speed, slope, settings), settings.period, elapsed, banks)
    drive, brakes = mean_of_bank(banks.drive), mean_of_bank(banks.brakes)
    if memory.state == OFF or memory.speed_age > 0.0 or was_blind:
        forget_faults(speed, 0.0, memory)
    else:
        watch_actuators(speed, _resistance(speed, slope, settings), drive, brakes, elapsed, memory)
    _count_creeping(speed, settings, memory)
    _govern(station, top_square, settings, path, memory, ahead)
    memory.grip_used = sqrt(square(memory.acceleration) + square(lateral)) / (memory.friction * GRAVITY)
    if is_driven:
        _yield_to_driver(speed, slope, lateral, drive, brakes, settings, memory, banks)
        return
    was_off = memory.state == OFF
    needed = 0.0 if was_off else _blind_deceleration(speed, sample.blind_time, brakes.lag + brakes.dead_time, settings)
    if sample.station != sample.station or memory.speed_age > BLIND_GRACE or memory.fault != NO_FAULT:
        needed = max(needed, settings.emergency if memory.fault == BRAKES_FAIL else settings.brake)
    if needed > 0.0:
        _stop_unguided(needed, speed, slope, lateral, drive, brakes, settings, memory)
        memory.state = OFF if was_off else memory.state
        remember_request(memory.force, memory.hold, settings.mass, banks.requests)
        return
    if was_off:
        memory.state = DRIVING
    _pass_stop(station, speed, settings, path, memory)
    if memory.state == WAITING:
        memory.limited_by = _stop_cause(path, memory)
        _stand(station - _stop_place(memory.next_stop, path), slope, lateral, drive, brakes, settings, memory)
        remember_request(memory.force, memory.hold, settings.mass, banks.requests)
        return
    _follow(station, speed, slope, top_square, lateral, drive, brakes, settings, path, memory, banks, ahead)
    remember_request(memory.force, memory.hold, settings.mass, banks.requests)


@exported(void(float64, float64, float64, vector, vector))
def governed_speeds(speed, period, spacing, ahead, speeds):
    """Write the speeds (m/s) at the coming control instants of a car that passes the cells ahead as they are governed.

    All are shifted so that the first one is the present speed (m/s); ahead: squares (m^2/s^2) every spacing (m).
    """
    first, way = sqrt(max(ahead[0], 0.0)), 0.0
    for i in range(speeds.size):
        planned = sqrt(max(ahead[min(whole(way / spacing), ahead.size - 1)], 0.0))
        speeds[i] = max(planned + speed - first, 0.0)
        way += max(planned, LEAST_SPEED_AHEAD) * period

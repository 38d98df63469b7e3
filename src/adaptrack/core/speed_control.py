"""Speed control along a planned path: governor, follower, stops and traction guard, once a control period.

    governor   lowers the squares of the planned speeds ahead to what the assumed friction leaves, by one backward pass
    follower   acceleration at the place where the request acts: the plan's, the error of the speed, a disturbance
    stop       before a stop constant jerk, so that speed and acceleration reach 0 together; hold pressure after it
    guard      a share of the force that each axle has left in addition to its lateral force

The plan lies on an even grid of places. Without a position the car stops with the deceleration of comfort.
"""

from __future__ import annotations

import math

from .kernel import exported, float64, inlined, int64, record, rows, vector, void
from .loop import STANDING_SPEED
from .maths.bits import whole
from .maths.exact import clip, floor, sqrt, square
from .maths.exponential import power
from .plants.forces import GRAVITY
from .speed_learning import SpeedBanks, begin_bank, learn_actuators, mean_of_bank, remember_request
from .traction import LARGEST_BEND_SHARE, LEAST_BRAKING, axle_limits

SPEED_SETTINGS = (
    "period",  # s
    "mass", "lf", "lr", "cg_height", "drive_front", "brake_front",  # kg, m, m, m, -, -
    "engine_power", "traction_limit", "brake_limit",  # W, N, N
    "drag", "rolling",  # kg/m, force of the air over v^2; m/s^2
    "accelerate", "brake", "emergency", "stop_jerk",  # m/s^2, m/s^2, m/s^2, m/s^3
    "friction", "friction_high",  # -, assumed: the low and the high end of its interval
    "governor", "guard",  # -, shares: of the friction sideways ahead; of what the axles have left now
    "drive_lag", "drive_dead_time", "brake_lag", "brake_dead_time",  # s, NaN: learned while driving
    "gain",  # 1/s
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
    ),
)  # fmt: skip
"""What a speed controller is given once a control period."""

OFF, DRIVING, STOPPING, WAITING, EMERGENCY = range(5)
"""States."""
BY_PLAN, BY_COMFORT, BY_GRIP, BY_STOP, BY_PATH_END, BY_FAULT = range(6)
"""Causes that limit the speed or the acceleration."""

SPEED_MEMORY = record(
    "SpeedMemory",
    (
        "state", "limited_by", "next_stop",  # the last one: of `SpeedPath.stops`, those of past laps included
        "standing",  # s, at the present stop
        "acceleration", "force", "hold",  # m/s^2, N, N: requests in force; hold: of the brakes besides the force
        "target_speed", "grip_used",  # m/s, -: lateral and longitudinal acceleration over the assumed friction
        "speed", "station",  # m/s, m: last known
        "lateral",  # m/s^2, filtered
    ),
    integers=("state", "limited_by", "next_stop"),
)  # fmt: skip
"""What a speed controller remembers, and its answer."""

STOP_TOLERANCE, OVERSHOOT, REACHED = 0.5, 2.0, 0.03
"""m: a car that stands so near a stop has reached it; so far beyond it stays; the least remaining way."""
EMERGENCY_RATIO = 1.4
"""Deceleration that a stop needs over that of comfort, from which braking is an emergency."""
STRAIGHT = 1e-5
"""1/m, below which a curvature limits no speed."""
LATERAL_SMOOTHING = 0.35
"""Share of a new measurement in the filtered lateral acceleration."""
HOLD_RESERVE = 1.0
"""m/s^2, by which the brakes hold more than the slope demands."""
LEAD_DISTANCE = 2.0
"""m, over which the acceleration of the plan is taken."""
BRAKE_CAUTION = 1.0
"""Standard deviations by which the delay of the brakes is assumed longer than its mean."""
STOP_LEAD = 0.1
"""Share of the lag by which a car comes nearer to its stop than its speed says, chosen on 60 cars: no bias."""
COMFORT_RESERVE = 1.2
"""Factor on the accelerations of comfort within which errors of the speed are corrected."""
LEAST_SPEED_AHEAD = 0.3
"""m/s, with which a car is taken to go on at a stop ahead."""


# -- the path ---------------------------------------------------------------------------------------------------------
@inlined
def _cell(place, path):
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


# -- the governor -----------------------------------------------------------------------------------------------------
@inlined
def _govern(station, settings, path, ahead):
    """Write the squares of the speeds (m^2/s^2) that friction and comfort allow at the cells from the station on."""
    first, grip = whole(floor(station / path.spacing)), settings.friction * GRAVITY
    for j in range(ahead.size):
        cell = _cell((first + j + 0.5) * path.spacing, path)
        square_speed, curvature = path.square[cell], path.curvature[cell]
        if abs(curvature) > STRAIGHT:
            tilt = path.bank[cell] if curvature > 0.0 else -path.bank[cell]
            square_speed = min(square_speed, max(settings.governor * grip + tilt, 0.0) / abs(curvature))
        ahead[j] = square_speed
    for j in range(ahead.size - 2, -1, -1):
        if ahead[j] <= ahead[j + 1]:
            continue
        cell = _cell((first + j + 0.5) * path.spacing, path)
        lateral = min(abs(ahead[j + 1] * path.curvature[cell] - path.bank[cell]), LARGEST_BEND_SHARE * grip)
        _, braking = axle_limits(settings.friction, settings.mass * GRAVITY, lateral, settings)
        deceleration = min(settings.guard * braking / settings.mass + path.slope[cell], settings.brake)
        ahead[j] = min(ahead[j], ahead[j + 1] + 2.0 * path.spacing * max(deceleration, LEAST_BRAKING))


# -- one period -------------------------------------------------------------------------------------------------------
@inlined
def _stopping_motion(way, settings):
    """Speed (m/s) and acceleration (m/s^2) on the way (m) to a stop: constant deceleration, then constant jerk."""
    if way <= 0.0:
        return 0.0, 0.0
    easing = settings.brake / settings.stop_jerk  # s, of the jerk
    easing_way = settings.stop_jerk * easing * easing * easing / 6.0
    if way >= easing_way:
        return sqrt(square(0.5 * settings.brake * easing) + 2.0 * settings.brake * (way - easing_way)), -settings.brake
    remaining = power(6.0 * way / settings.stop_jerk, 1.0 / 3.0)
    return 0.5 * settings.stop_jerk * remaining * remaining, -settings.stop_jerk * remaining


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
    """Turn an acceleration (m/s^2) into a force (N) within powertrain, brakes and guard; whether it was bounded.

    drive, brakes: `speed_learning.ActuatorBelief`.
    """
    braking_now = brakes.acting > drive.acting
    disturbance = brakes.disturbance if braking_now else drive.disturbance
    resistance = _resistance(speed, slope, settings) - disturbance
    tyres = acceleration + resistance  # m/s^2, of all tyres
    ratio = drive.ratio if tyres > 0.0 else brakes.ratio
    demand = settings.mass * tyres / ratio
    friction = settings.friction if memory.state != EMERGENCY else settings.friction_high
    bend = min(lateral, LARGEST_BEND_SHARE * friction * GRAVITY)
    driving, braking = axle_limits(friction, settings.mass * GRAVITY, bend, settings)
    strongest = min(settings.guard * driving, min(settings.traction_limit, settings.engine_power / max(speed, 1.0)))
    weakest = -min(max(settings.guard * braking, LEAST_BRAKING * settings.mass), settings.brake_limit)
    force = clip(demand, weakest, strongest)
    memory.force, memory.acceleration = force, ratio * force / settings.mass - resistance
    return force != demand


@inlined
def _pass_stop(station, speed, settings, path, memory):
    """Count the time at a stop; go on to the next one when it is over, or the car is far beyond it."""
    place = _stop_place(memory.next_stop, path)
    near = abs(speed) < STANDING_SPEED and -STOP_TOLERANCE <= station - place <= OVERSHOOT
    if near and (memory.state == STOPPING or memory.state == EMERGENCY):
        memory.state, memory.standing = WAITING, 0.0
    if memory.state == WAITING:
        memory.standing += settings.period
        if memory.standing >= path.seconds[memory.next_stop % path.stops.size]:
            memory.next_stop += 1
            memory.state, memory.standing = DRIVING, 0.0
    elif station - place > OVERSHOOT:
        memory.next_stop += 1


@inlined
def _follow(station, speed, lateral, drive, brakes, settings, path, memory, ahead):
    """Follow the governed speeds and the next stop; write the requests."""
    slope = path.slope[_cell(station, path)]
    delay, lag = drive.dead_time, drive.lag
    if memory.acceleration < 0.0:
        delay, lag = brakes.dead_time + BRAKE_CAUTION * brakes.delay_sigma, brakes.lag
    coming_speed = max(speed + memory.acceleration * delay, 0.0)
    place = station + 0.5 * (speed + coming_speed) * delay
    lead = place + coming_speed * lag
    target_square = _square_at(place, station, path, ahead)
    target = sqrt(max(target_square, 0.0))
    change = _square_at(lead + LEAD_DISTANCE, station, path, ahead) - _square_at(lead, station, path, ahead)
    acceleration = 0.5 * change / LEAD_DISTANCE
    memory.limited_by = BY_PLAN if target_square >= path.square[_cell(place, path)] * 0.999 else BY_GRIP
    stop = _stop_place(memory.next_stop, path)
    lag_way = STOP_LEAD * lag * coming_speed
    stop_speed, stop_acceleration = _stopping_motion(stop - place - lag_way, settings)
    if stop_speed < target or stop - place <= 0.0:
        is_end = path.seconds[memory.next_stop % path.stops.size] == math.inf
        memory.state, memory.limited_by = STOPPING, BY_PATH_END if is_end else BY_STOP
        target = stop_speed
        _, lead_acceleration = _stopping_motion(stop - lead, settings)
        acceleration = 0.5 * (stop_acceleration + lead_acceleration)
        is_far = stop - place > STOP_TOLERANCE
        if is_far and square(coming_speed) > 2.0 * EMERGENCY_RATIO * settings.brake * (stop - place):
            memory.state = EMERGENCY
    elif memory.state == STOPPING or memory.state == EMERGENCY:
        memory.state = DRIVING
    memory.target_speed = target
    if memory.state == EMERGENCY:
        memory.hold = 0.0
        needed = 0.5 * square(coming_speed) / max(stop - place, REACHED)
        _request(-min(needed, settings.emergency), speed, slope, lateral, drive, brakes, settings, memory)
        return
    if memory.state == STOPPING and speed < STANDING_SPEED and stop - station < STOP_TOLERANCE:
        _hold(slope, settings, memory)
        return
    demand = acceleration + settings.gain * (target - coming_speed)
    bounded = clip(demand, -COMFORT_RESERVE * settings.brake, COMFORT_RESERVE * settings.accelerate)
    if bounded != demand and memory.limited_by == BY_PLAN:
        memory.limited_by = BY_COMFORT
    if _request(bounded, speed, slope, lateral, drive, brakes, settings, memory):
        memory.limited_by = BY_GRIP
    memory.hold = 0.0
    if memory.force > 0.0 and speed < STANDING_SPEED and slope > 0.0:
        memory.hold = settings.mass * slope  # until the drive carries the slope


@inlined
def speed_control(sample, settings, path, memory, banks, ahead):
    """One control period: write state, requests and causes to the memory, and the governed squares to ahead.

    Drive and brakes are learned first, from the speed that the requests so far have made.

    sample: `SPEED_SAMPLE`; ahead: (n,), at the cells from the station on.
    """
    station, speed, yaw_rate = sample.station, sample.speed, sample.yaw_rate
    learnable = speed == speed
    if learnable:
        memory.speed = speed
    elif memory.state != OFF:
        memory.speed = max(memory.speed + memory.acceleration * settings.period, 0.0)
    speed = memory.speed
    is_located = station == station
    if is_located:
        memory.station = station
    else:
        memory.station += speed * settings.period
    station = memory.station
    cell = _cell(station, path)
    bend = abs(speed * speed * path.curvature[cell] - path.bank[cell])
    if yaw_rate == yaw_rate:
        memory.lateral += LATERAL_SMOOTHING * (abs(speed * yaw_rate - path.bank[cell]) - memory.lateral)
    lateral = max(memory.lateral, bend)
    if memory.state == OFF:
        memory.state = DRIVING
        while _stop_place(memory.next_stop, path) < station - OVERSHOOT:
            memory.next_stop += 1
    if learnable and memory.state != WAITING:
        learn_actuators(speed, _resistance(speed, path.slope[cell], settings), settings.period, banks)
    drive, brakes = mean_of_bank(banks.drive), mean_of_bank(banks.brakes)
    _govern(station, settings, path, ahead)
    memory.grip_used = sqrt(square(memory.acceleration) + square(lateral)) / (settings.friction * GRAVITY)
    if not is_located:
        memory.limited_by = BY_FAULT
        if speed < STANDING_SPEED:
            _hold(path.slope[cell], settings, memory)
            return
        memory.target_speed, memory.hold = 0.0, 0.0
        _request(-settings.brake, speed, path.slope[cell], lateral, drive, brakes, settings, memory)
        remember_request(memory.force / settings.mass, banks.requests)
        return
    _pass_stop(station, speed, settings, path, memory)
    if memory.state == WAITING:
        memory.limited_by = BY_STOP
        _hold(path.slope[cell], settings, memory)
        return
    _follow(station, speed, lateral, drive, brakes, settings, path, memory, ahead)
    remember_request(memory.force / settings.mass, banks.requests)


@exported(void(rows(SPEED_SAMPLE), rows(SPEED_MEMORY), SpeedSettings, SpeedPath, SpeedBanks, vector))
def speed_control_step(sample, memory, settings, path, banks, ahead):
    """One control period of the only controller, see `speed_control`."""
    speed_control(sample[0], settings, path, memory[0], banks, ahead)


@exported(void(SpeedSettings, SpeedBanks))
def speed_control_begin(settings, banks):
    """Forget what was learned of drive and brakes."""
    begin_bank(settings.drive_lag, settings.drive_dead_time, banks.drive)
    begin_bank(settings.brake_lag, settings.brake_dead_time, banks.brakes)
    banks.requests[:] = 0.0


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

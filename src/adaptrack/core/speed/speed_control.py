"""Speed control along a planned path: governor, follower, stops and traction guard, once a control period.

Order of precedence: fault, driver, blind, grip, stop, speed limit, comfort, clock.

    governor   lowers the squares of the planned speeds ahead to what the assumed friction leaves, and after a slide to
               less, by one backward pass; before that, the speeds of a timed trajectory are corrected by the clock
    follower   acceleration at the place where the request acts: the plan's, the error of the speed, a disturbance
    stop       before a stop constant jerk, so that speed and acceleration reach 0 together
    hold       at rest brakes that hold any usual slope, and more while the car rolls; they are released gradually
               while the drive takes over, and close again when the car rolls back
    guard      a share of the force that each axle has left in addition to its lateral force; a car that slides, or
               that sways and has rear drive, gets less drive force, or none

The plan lies on an even grid of places. While a driver uses the pedals, the requests follow the motion of the car.
Without a position the car brakes so that it stands before the steering loses its estimate; without any estimate, or
without a speed, it stops with the deceleration of comfort. Sign of a force: positive drives forward; negative is a
force of the brakes, which opposes the motion either way and never moves a standing car. So does the hold, at least 0,
in addition.
"""

from __future__ import annotations

import math

from ..kernel import Field, columns, fields_of, float64, inlined, int64, record, vector
from ..maths.bits import whole
from ..maths.exact import clip, floor, sqrt, square
from ..maths.exponential import power
from ..models.car import AXLES, POWERTRAIN
from ..models.contract import PERIOD_FIELD
from ..physics.forces import GRAVITY, LARGEST_BEND_SHARE, LEAST_BRAKING, STANDING_SPEED, axle_limits
from . import faults, learning, stops
from .place import (
    LEAST_ELAPSED,
    SPEED_GRACE,
    compare_with_positions,
    correct_place,
    is_speed_doubted,
    is_speed_known,
    predict_place,
    take_motion,
)

SpeedSettings = record("SpeedSettings", (
    PERIOD_FIELD,
    *AXLES,
    *POWERTRAIN,
    "drag", "rolling",  # kg/m, force of the air over v^2; m/s^2
    "accelerate", Field("brake", "m/s^2", 3.0, "deceleration of comfort", "(0, 50]"),  # m/s^2
    "emergency", "stop_jerk",  # m/s^2, m/s^3
    "friction", "friction_high",  # -, assumed: the low and the high end of its interval, in a bend
    "straight_ratio",  # -, friction on a straight over that in a bend
    "governor", "guard",  # -, shares: of the friction sideways ahead; of what the axles have left now
    *(Field(f"{part}_{name}", "s", math.nan, "unknown: learned while driving", "[0, 10]")
      for part in ("drive", "brake") for name in ("lag", "dead_time")),
    "gain",  # 1/s
    "patience",  # s without a position, after which the steering has no estimate; 0: unlimited
))  # fmt: skip
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
        "station", "station_age",  # m, over all laps, of a position that is newer than the last one, and s; NaN: none
        "offset",  # m, of the car to the left of the path
        "speed", "speed_age",  # m/s, negative backwards, and s; NaN: not measured
        "yaw_rate",  # rad/s; NaN: not measured
        "acceleration",  # m/s^2, measured along the car, without gravity; NaN: not measured
        "driver",  # 1: a driver uses the pedals
        "is_guided",  # 1: the plan may be followed; 0: the car stops
        "top_speed",  # m/s, up to which the steering of the car is known
        "blind_time",  # s, since the last position
        "grade",  # dz/ds under the car, measured, positive uphill; NaN: that of the path
        "periods",  # control periods since the last step
        "is_timed",  # 1: the plan is a planner's trajectory: its own decelerations are followed up to `emergency`
        "correction",  # m/s, of the planned speeds, by which the car keeps the times of the trajectory
        "correction_limit",  # m/s, speed that the correction never exceeds
        "rest_time",  # s, until the trajectory leaves the place of rest where the car is; 0: it does not rest there
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

SPEED_REQUEST = columns(
    Field("acceleration", "m/s^2", 0.0, "dv/dt along the road, without gravity; negative: slower"),
    Field("force", "N", 0.0, "at the wheels: positive drives forward; negative is a force of the brakes, which opposes "
          "the motion either way and never moves a standing car"),
    Field("hold", "N", 0.0, "never negative: an additional force of the brakes, which holds the car at rest"),
    Field("target_speed", "m/s", 0.0, "where the request acts"),
    Field("grip_used", "", 0.0, "acceleration of the car, in both directions, over what the assumed friction gives"),
    Field("speed_state", "", 0, "0 off, 1 driving, 2 stopping, 3 stopped, 4 emergency"),
    Field("limited_by", "", 0, "0 plan, 1 comfort, 2 grip, 3 stop, 4 path end, 5 fault, 6 driver, 7 steering unknown, "
          "8 powertrain, 9 brake fault, 10 drive fault"),
    Field("friction_low", "", 0.0, "low end of the interval of the friction, as narrowed so far: a one-sided 95 % "
          "bound of the largest steady lateral acceleration over g"),
    Field("friction_high", "", 0.0, "high end of the interval of the friction, as narrowed so far"),
    Field("friction_age", "m", 0.0, "way since the tyres last showed the friction, at most 300 m: from there on the "
          "interval is the assumed one"),
)  # fmt: skip
"""What a speed control requests in a control period."""

SPEED_MEMORY = record(
    "SpeedMemory",
    (
        *fields_of(SPEED_REQUEST)[: SPEED_REQUEST.friction_low],  # in force
        "standing",  # s, at the present stop
        "creeping",  # s, braked with a speed of nearly 0
        "speed", "station",  # m/s, m: of the car at present
        "lateral",  # m/s^2, filtered
        "motion",  # m/s^2, acceleration of the car, filtered
        "handover",  # m/s^2, of the request beyond the follower's after a driver's; NaN: while one drives
        "measured_speed", "speed_age",  # m/s, s: last measured speed, and its age now
        "lateness",  # s, mean age of the measured speeds when they come
        "settled",  # s, for which the requests have acted alone, without a driver
        "carried_speed",  # m/s, measured speed carried to the present, known or not
        "place_speed",  # m/s, measured speed carried to the present, unfiltered: it moves the station
        "fault",  # see `actuator_faults`, and its filter:
        "watched_speed", "watched_disturbance", "watched_rate",  # m/s, m/s^2, m/s^3: of a healthy car, and covariance:
        "p_watched", "p_watched_disturbance", "p_watched_rate", "p_disturbance", "p_disturbance_rate", "p_rate",
        "speed_variance", "last_speed", "last_change",  # m^2/s^2, m/s, m/s: of measured speeds
        "relative_variance",  # of measured speeds over their square
        "loss_speed", "loss_disturbance", "loss_rate", "loss_match", "loss_energy", "loss_evidence",
        "pull_speed", "pull_disturbance", "pull_rate", "pull_match", "pull_energy", "pull_evidence",
        "braking_before", "driving_before", "brake_ratio", "brake_ratio_sigma",
        "lost_share", "proven_time", "on_probation",  # -, s, -: see `actuator_faults`
        "friction", "friction_high",  # -, ends of its interval, see `friction_estimate`; 0: those of the settings
        "cautious_friction",  # -, at most the low end: of bends ahead and drive forces
        "scale",  # -, way along the path over that of the measured speed, less 1
        "p_station", "p_station_scale", "p_scale",  # m^2, m, -: covariance of station and scale
        "pose_variance",  # m^2, of a measured station
        "is_placed",  # positions so far, up to `speed_place.MANY_POSITIONS`; 0: the place is unknown
        "jump",  # m, by which the filter of the station has just restarted elsewhere; 0: it has not
        "surprise",  # -, square of the last innovation of the station over its variance
        "observed_place", "observed_excess", "observer_time",  # m, m/s, s: see `speed_place`
        "observer_error", "observer_variance",  # m, m^2: last innovation; variance of a measured place, by its changes
        "contradiction", "is_distrusted", "distrust",  # s, for which speed and positions contradict each other; 1: the
        # speed is not used; how often in a row
        "direction",  # -1: positions move backwards and the speed is positive; else 1
        "stop_place", "served_place",  # m: of the next stop and of the one served last; NaN: none
        "is_changed",  # 1: another path; its stops are to be matched
        "is_released",  # 1: the car may leave the stop at which it stands
        "travelled",  # m, since the car stood
        "is_braking",  # 1: the brakes act, 0: the drive does; either may rest
        "is_starting", "launch", "rolled",  # 1: the car starts; m/s^2: push beyond the estimated slope; least push
        "start_place", "pose_place",  # m: station at which it last stood; last measured one
        "rolling",  # m/s^2, additional hold of a car that rolls against its brakes
        "slide", "sway",  # m/s^2, lateral acceleration by the yaw rate beyond friction and path, lowered with the time
        "time", "instant", "began",  # s, -, s: behind a tracker, of the last step, and of the first control instant
        "call_time", "call_interval", "repeats",  # s, s, -, behind a tracker: of the last call with a newer time; usual
        # time between two calls; calls since then without a newer time
        "pose_time",  # s, behind a tracker, of the newest position
        "place_x", "place_y", "stop_x", "stop_y", "served_x", "served_y",  # m, behind a tracker, of the three places
    ),
    integers=(
        "speed_state", "limited_by", "fault", "is_placed", "is_changed", "is_released", "is_braking", "is_starting",
        "instant", "repeats", "is_distrusted", "distrust",
    ),
)  # fmt: skip
"""What a speed controller remembers, and its requests."""

MAX_PLAN_GRADE = 0.4
"""dz/ds of a plan; a measured grade beyond it, either way, counts as not measured."""
REACHED = 0.03
"""m, the least remaining way to a stop."""
AIMED_DISTANCE = 0.01
"""m, before a stop, at which a car that comes from farther away is to stand: beyond it is worse than short of it."""
CREEPING_SPEED, CREEPING_TIME = 0.15, 1.0
"""m/s, s: a braked car that is so slow for so long stands; a sensor may have this offset."""
CREEP_STIFFNESS, LARGEST_CREEP = 10.0, 0.5
"""1/s^2, m: additional deceleration by the brakes that hold the car, over its distance from a stop up to the largest.
"""
EMERGENCY_RATIO = 1.4
"""Deceleration that a stop needs over that of comfort, from which braking is an emergency."""
EXACT_SPEED = 3.0
"""m/s, at which the measured speed, whose noise grows with the speed, counts as much as the filtered one."""
STRAIGHT = 1e-5
"""1/m, below which a curvature limits no speed."""
LATERAL_SMOOTHING = 0.35
"""Share of a new measurement in the filtered lateral acceleration."""
LATENESS_SMOOTHING = 0.05
"""Share of a new age in the mean age of the samples."""
LATE_CAUTION, LARGEST_LATE_CAUTION = 4.0, 0.3
"""1/s, -: share of the friction that bends ahead and drive forces do not use, over the mean age of samples; at most."""
RATIO_CAUTION = 0.5
"""Standard deviations of the drive's gain over the mass, by which a drive force may be larger than it was requested."""
SLIDE_TIME, SLIDE_CAUTION, LARGEST_SLIDE_SHARE = 5.0, 0.5, 0.4
"""s, in which a slide is forgotten; -, share of it that bends ahead do not use, and the largest of their grip."""
SWAY_TIME, SWAY_CAUTION, SWAY_MARGIN = 2.0, 3.0, 0.45
"""s, in which a sway is forgotten; -, factor with which it counts for a drive force at the rear; -, share of the
friction beyond what the path asks for, where it begins."""
HOLD_AT_REST, HOLD_RESERVE = 2.5, 1.0
"""m/s^2: the brakes of a car at rest hold at least a slope of 25 %, and more than the estimated slope demands."""
HOLDING_RATE = 5.0
"""m/s^3, by which they come to hold it."""
ROLLING_RATE = 6.0
"""m/s^3, by which they hold more while the car rolls all the same."""
HOLDING_LAGS = 2.0
"""Lags of the brakes, in addition to their dead time, after which they hold the car."""
STARTED_SPEED, GENTLE_SPEED, SURE_SPEED, ROLLING_SPEED = 0.12, 0.08, 1.0, 0.08
"""m/s: a car has started, usually, before a short move, and whatever the noise of its positions; a car rolls back."""
START_RESERVE, LAUNCH_RATE, MAX_LAUNCH, ROLLED_RESERVE = 0.3, 1.5, 6.0, 0.5
"""m/s^2, m/s^3, m/s^2, m/s^2: the drive carries more than the estimated ascent before the brakes are released, and
more and more until the car moves; after it has rolled back, more than it then did."""
FULL_DRIVE_SHARE = 0.95
"""Of the largest drive force, from which the brakes are released whatever the slope."""
MOVED_WAY, MOVED_SIGMAS = 0.03, 3.0
"""m, -: way of the positions from which, with so many standard deviations of them, they show a motion."""
RELEASE_RATE, GENTLE_RELEASE_RATE, STARTED_RELEASE_RATE = 4.0, 1.0, 8.0
"""m/s^3, by which the brakes are released: usually, before a short move, and once the car has started."""
SHORT_MOVE, SHORT_MOVE_BRAKE = 1.5, 0.2
"""m, m/s^2: a way from standstill to a stop that is driven slowly, and its deceleration."""
GENTLE_LAUNCH, DESCENT = 0.15, 0.5
"""m/s^2, m/s^2: push while the brakes are released before a short move, and on a descent from which on the slope sets
the car going."""
START_SIGMAS = 2.0
"""Standard deviations by which the delays of drive and brakes may be shorter than estimated, so that a start by the
time is never early."""
LEAST_TARGET, LEAST_EARLY_TARGET = 0.3, 0.27
"""m/s, least speed to reach where no stop is ahead, so that a car leaves a place with a planned speed of 0: usually,
and of a car that is ahead of the times of its trajectory."""
CATCH_UP_SHARE = 0.75
"""Of the speed that is left up to the limit of a car that catches up: it approaches the limit more slowly than planned,
and so does not overshoot it."""
PASSED_CELLS = 2
"""Cells behind the car in which the deceleration of a trajectory still counts, so that it holds up to a stop."""
LEAD_DISTANCE, LEAD_TIME, LEAST_LEAD_DISTANCE = 2.0, 0.2, 0.1
"""m, s, m: way over which the acceleration of the plan is taken; on a trajectory the way in this time, within these
bounds."""
BRAKE_CAUTION, KNOWN_DELAY = 2.0, 0.05
"""-, s: a stop begins earlier by the way in the caution times the standard deviation of the delay of the brakes beyond
that of known ones, chosen on 16 cars."""
STOP_SOFTENING = 0.6
"""1/s, by which the jerk of a stop decreases with the lag of the brakes, chosen on 40 cars."""
COMFORT_RESERVE = 1.2
"""Factor on the accelerations of comfort within which errors of the speed are corrected."""
COASTING_BAND, STOPPING_BAND = 0.25, 0.08
"""m/s^2, of a demand, within which drive and brakes do not take turns: usually, and on the way to a stop."""
HANDOVER_JERK = 5.0
"""m/s^3, with which a request goes from a driver's to less; to more with the jerk of stops."""
BLIND_GRACE, COMFORT_GAP = 0.5, 1.2
"""s since the last position: up to the first the plan is followed, up to the second braking is comfortable."""
BLIND_SHARE = 0.8
"""Of the deceleration of comfort: where a car without a position needs so much to stand in time, it brakes."""
BLIND_SIGMAS, BLIND_MARGIN = 1.5, 0.25
"""-, s: standard deviations of delay and gain of the brakes, and time, that a car without a position allows for."""
MAX_LATERAL = 20.0
"""m/s^2, to which the lateral acceleration by the yaw rate is limited."""
LEAST_RADIUS_SHARE = 0.5
"""Of the radius of a bend of the path: least one of the way of a car inside it."""
LEAST_SPEED_AHEAD = 0.3
"""m/s, with which a car is taken to go on at a stop ahead."""

ControlPeriod = record(
    "ControlPeriod",
    ("duration", "slope", "lateral", "bend", ("drive", learning.ActuatorBelief), ("brakes", learning.ActuatorBelief)),
)
"""A control period: s; deceleration by the slope (m/s^2); larger of measured and planned lateral acceleration, and the
planned one until a drive force acts (m/s^2); the beliefs about drive and brakes, at present."""


# -- the path ---------------------------------------------------------------------------------------------------------
@inlined
def cell_at(place, path):
    """Return the cell of a place (m) on the grid, within an open path or around a closed one."""
    index = whole(floor(place / path.spacing))
    if path.closed > 0:
        return index % path.square.size
    return min(max(index, 0), path.square.size - 1)


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


@inlined
def _cautious_friction(memory):
    """Return the friction of bends ahead and of drive forces.

    Late samples show a swing of the car late. What is left for it counts from the middle of the friction's interval.
    """
    late = min(LATE_CAUTION * memory.lateness, LARGEST_LATE_CAUTION)
    return min(memory.cautious_friction, 0.5 * (1.0 - late) * (memory.friction + memory.friction_high))


# -- the governor -----------------------------------------------------------------------------------------------------
@inlined
def _planned_square(cell, sample, path):
    """Square of the planned speed (m^2/s^2) at a cell, corrected by the clock."""
    planned = path.square[cell]
    if sample.correction == 0.0:
        return planned
    speed = sqrt(planned)
    most = CATCH_UP_SHARE * max(sample.correction_limit - speed, 0.0)
    return square(max(speed + min(sample.correction, most), 0.0))


@inlined
def _planned_braking(k, settings, path):
    """Deceleration (m/s^2) of a trajectory behind a place of the grid, at least of comfort, at most `emergency`."""
    change = path.square[cell_at((k + 0.5) * path.spacing, path)] - path.square[cell_at((k + 1.5) * path.spacing, path)]
    return max(min(0.5 * change / path.spacing, settings.emergency), settings.brake)


@inlined
def _stop_braking(index, way, sample, settings, path, memory):
    """Deceleration (m/s^2) on the way (m) to a stop: of comfort, or the largest with which a trajectory stops there.

    Without times, and at the end of a path that the trajectory reaches with a speed, that of comfort; never more than
    `emergency`.
    """
    is_passed = index != stops.NO_STOP and stops.is_path_end(index, path) and path.square[path.square.size - 1] > 0.0
    if sample.is_timed <= 0.0 or index == stops.NO_STOP or is_passed:
        return settings.brake
    needed, stop = 0.0, memory.station + way
    stop_cell = whole(floor(stop / path.spacing))
    for k in range(min(whole(floor(memory.station / path.spacing)), stop_cell) - PASSED_CELLS, stop_cell):
        distance = stop - k * path.spacing
        needed = max(needed, 0.5 * path.square[cell_at((k + 0.5) * path.spacing, path)] / distance)
    return max(min(needed, settings.emergency), settings.brake)


@inlined
def _govern(sample, top_square, push, settings, path, memory, ahead):
    """Write the squares of the speeds (m^2/s^2) that friction, comfort and the next stop allow at the cells ahead.

    top_square: m^2/s^2, of the speed up to which the steering is known; push: m/s^2, of an unknown descent.
    """
    station = memory.station
    first, grip = whole(floor(station / path.spacing)), memory.friction * GRAVITY
    bend_grip = settings.governor * _cautious_friction(memory) * GRAVITY
    bend_grip -= min(SLIDE_CAUTION * memory.slide, LARGEST_SLIDE_SHARE * bend_grip)
    for j in range(ahead.size):
        cell = cell_at((first + j + 0.5) * path.spacing, path)
        square_speed, curvature = min(_planned_square(cell, sample, path), top_square), path.curvature[cell]
        if abs(curvature) > STRAIGHT:
            tilt = path.bank[cell] if curvature > 0.0 else -path.bank[cell]
            square_speed = min(square_speed, max(bend_grip + tilt, 0.0) / abs(curvature))
        ahead[j] = square_speed
    way = stops.way_to(memory.stop_place, station, path)
    if memory.speed_state != WAITING and 0.0 < way < (ahead.size - 2) * path.spacing:
        ahead[whole(way / path.spacing) + 2] = 0.0  # beyond the stop: its last metres have a law of their own
    for j in range(ahead.size - 2, -1, -1):
        if ahead[j] <= ahead[j + 1]:
            continue
        cell = cell_at((first + j + 0.5) * path.spacing, path)
        lateral = min(abs(ahead[j + 1] * path.curvature[cell] - path.bank[cell]), LARGEST_BEND_SHARE * grip)
        _, braking = _axle_forces(memory.friction, lateral, settings)
        strongest = _planned_braking(first + j, settings, path) if sample.is_timed > 0.0 else settings.brake
        deceleration = min(settings.guard * braking / settings.mass + path.slope[cell] - push, strongest)
        ahead[j] = min(ahead[j], ahead[j + 1] + 2.0 * path.spacing * max(deceleration, LEAST_BRAKING))


# -- one period -------------------------------------------------------------------------------------------------------
@inlined
def _stopping_motion(way, lead, jerk, braking):
    """Speed (m/s) on the way (m) to a stop, and acceleration (m/s^2) there a lead (s) later.

    The deceleration (m/s^2) is followed by a constant jerk (m/s^3), with which both reach 0 together.
    """
    if way <= 0.0:
        return 0.0, 0.0
    easing = braking / jerk  # s, of the jerk
    easing_way = jerk * easing * easing * easing / 6.0
    if way >= easing_way:
        return sqrt(square(0.5 * braking * easing) + 2.0 * braking * (way - easing_way)), -braking
    remaining = power(6.0 * way / jerk, 1.0 / 3.0)
    return 0.5 * jerk * remaining * remaining, -jerk * max(remaining - lead, 0.0)


@inlined
def _resistance(speed, slope, settings):
    """Deceleration (m/s^2) by air, rolling and the known slope."""
    return settings.drag * speed * speed / settings.mass + settings.rolling * clip(2.0 * speed, 0.0, 1.0) + slope


@inlined
def _request(acceleration, speed, period, settings, memory):
    """Turn an acceleration (m/s^2) into a force (N) within powertrain, brakes and guard; note a bound as the cause."""
    drive, brakes, lateral = period.drive, period.brakes, period.lateral
    disturbance = brakes.disturbance if memory.is_braking > 0 else drive.disturbance
    resistance = _resistance(speed, period.slope, settings) - disturbance
    tyres = acceleration + resistance  # m/s^2, of all tyres
    ratio = drive.ratio if tyres > 0.0 else brakes.ratio
    demand = settings.mass * tyres / ratio
    friction = memory.friction
    if memory.speed_state == EMERGENCY:
        friction = memory.friction_high
    elif tyres > 0.0:
        sway = SWAY_CAUTION * (1.0 - settings.drive_front) * memory.sway
        lateral = (max(lateral, period.bend) + sway) * friction / _cautious_friction(memory)
    elif acceleration < -settings.brake:
        friction = 0.5 * (memory.friction + memory.friction_high)
    bend = min(lateral, LARGEST_BEND_SHARE * friction * GRAVITY) if tyres <= 0.0 else lateral
    driving, braking = _axle_forces(friction, bend, settings)
    powertrain = min(settings.traction_limit, settings.engine_power / max(speed, 1.0))
    strongest = settings.guard * driving / (drive.ratio + RATIO_CAUTION * drive.ratio_sigma)  # the tyres have its ratio
    weakest = -max(settings.guard * braking, LEAST_BRAKING * settings.mass) / brakes.ratio
    force = clip(clip(demand, weakest, strongest), -settings.brake_limit, powertrain)
    force = min(force, 0.0) if memory.is_braking > 0 else max(force, 0.0)
    memory.force, memory.acceleration = force, ratio * force / settings.mass - resistance
    if not weakest <= demand <= strongest:
        memory.limited_by = BY_GRIP
    elif not -settings.brake_limit <= demand <= powertrain:
        memory.limited_by = BY_POWERTRAIN


@inlined
def _hold(beyond, period, settings, memory):
    """Stand: no drive; brakes that hold the estimated slope, at least any usual one, and more while the car rolls.

    beyond: m, of a stop; a car that creeps away from it is held more.
    """
    if memory.hold > 0.0 and abs(memory.speed) > CREEPING_SPEED:
        memory.rolling += ROLLING_RATE * period.duration
    memory.acceleration, memory.force, memory.target_speed = 0.0, 0.0, 0.0
    needed = max(abs(period.slope - period.brakes.disturbance), abs(period.slope)) + HOLD_RESERVE
    needed += CREEP_STIFFNESS * min(abs(beyond), LARGEST_CREEP)
    at_rest = HOLD_AT_REST
    if memory.speed_state != DRIVING and memory.speed_state != OFF:  # the car has just come to rest: no jolt
        at_rest = min(at_rest, memory.hold / settings.mass + HOLDING_RATE * period.duration)
    deceleration = max(needed, at_rest) / min(period.brakes.ratio, 1.0) + memory.rolling
    memory.hold = min(settings.mass * deceleration, settings.brake_limit)
    memory.is_braking, memory.is_starting, memory.travelled = 1, 0, 0.0


@inlined
def _stand(beyond, period, settings, memory):
    """Stand so far beyond a stop (m); until the brakes hold, the drive carries an ascent."""
    brakes, cause = period.brakes, memory.limited_by
    is_held = memory.standing > brakes.dead_time + HOLDING_LAGS * brakes.lag + brakes.delay_sigma
    memory.is_braking = 0
    _request(0.0, 0.0, period, settings, memory)
    force = memory.force
    _hold(beyond, period, settings, memory)
    memory.force, memory.limited_by = 0.0 if is_held or period.slope <= 0.0 else max(force, 0.0), cause


@inlined
def _stands(memory):
    """Whether the car stands, or rolls back."""
    return memory.speed < STANDING_SPEED or memory.creeping > CREEPING_TIME


# -- stops ------------------------------------------------------------------------------------------------------------
@inlined
def _dwell(sample, dt, path, memory):
    """Count the time at a stop; leave it when it is over, or the stop is no more, or the car was moved away.

    A planned rest is left as soon as the drive may have to push, see `_start`.
    """
    index = stops.stop_at(memory.stop_place, stops.SAME_PLACE, path)
    enough = max(stops.LEFT_DISTANCE, stops.LEFT_SIGMAS * sqrt(memory.p_station))
    way = stops.way_to(memory.stop_place, memory.station, path)
    if index == stops.NO_STOP or way > enough or (way < -enough and not stops.is_path_end(index, path)):
        memory.speed_state = DRIVING
        return
    memory.standing += dt
    is_released = memory.is_released > 0 or 0.0 < sample.rest_time <= learning.SETTLING_TIME
    is_released = is_released and not stops.is_path_end(index, path)
    if memory.standing >= path.seconds[index] or is_released:
        memory.speed_state, memory.served_place = DRIVING, memory.stop_place


@inlined
def _find_stop(sample, dt, path, memory):
    """Find the next stop: its index and the way to it (m); wait at one that the car has reached."""
    if memory.speed_state == WAITING:
        _dwell(sample, dt, path, memory)
    if memory.speed_state != WAITING:
        memory.is_released = 0
    stops.forget_served_stop(path, memory)
    is_stopping = memory.speed_state == STOPPING or memory.speed_state == EMERGENCY
    if memory.speed_state == WAITING:
        index = stops.stop_at(memory.stop_place, stops.SAME_PLACE, path)
        return index, stops.way_to(memory.stop_place, memory.station, path)
    index, way = stops.next_stop(is_stopping, path, memory)
    memory.stop_place = path.stops[index] if index != stops.NO_STOP else math.nan
    tolerance = stops.STOP_TOLERANCE if memory.travelled > stops.ARRIVAL_WAY else stops.NEAR_STOP
    if is_stopping and way <= tolerance and _stands(memory):
        memory.speed_state, memory.standing = WAITING, 0.0
    return index, way


@inlined
def _stop_cause(index, path):
    """Cause of a stop."""
    return BY_PATH_END if stops.is_path_end(index, path) else BY_STOP


# -- without guidance -------------------------------------------------------------------------------------------------
@inlined
def _blind_deceleration(blind_time, is_guided, delay, settings, memory):
    """Deceleration (m/s^2) with which a car stands before the steering loses its estimate; 0: none is needed yet.

    It is v over the time left less the delay (s) of the brakes; in a short gap, in which the steering has an estimate,
    it is at most that of comfort.
    """
    if settings.patience <= 0.0 or blind_time <= BLIND_GRACE:
        return 0.0
    needed = memory.speed / max(settings.patience - blind_time - delay, settings.period)
    is_short = blind_time <= COMFORT_GAP and is_guided > 0.0
    most = settings.brake if is_short else settings.emergency
    return min(needed, most) if needed > BLIND_SHARE * settings.brake else 0.0


@inlined
def acknowledge(memory):
    """End a fault, and the distrust of the measured speed, as a driver or an operator does."""
    faults.end_fault(memory)
    memory.contradiction, memory.is_distrusted, memory.distrust = 0.0, 0, 0


@inlined
def _yield_to_driver(period, settings, memory, banks):
    """Let the requests follow the motion that a driver gives to the car; nothing is learned."""
    memory.speed_state, memory.handover, memory.settled = OFF, math.nan, 0.0
    if memory.speed < STANDING_SPEED:
        _hold(0.0, period, settings, memory)
    else:
        memory.hold, memory.rolling, memory.rolled = 0.0, 0.0, 0.0
        memory.is_braking = 1 if memory.motion + _resistance(memory.speed, period.slope, settings) < 0.0 else 0
        _request(memory.motion, memory.speed, period, settings, memory)
    memory.limited_by, memory.target_speed = BY_DRIVER, memory.speed
    acknowledge(memory)
    learning.settle_actuators(memory.measured_speed, memory.force / settings.mass, banks)


@inlined
def _hand_over(demand, settings, memory):
    """Return the demand (m/s^2) with what is left of the acceleration that a driver or a start has handed over."""
    if memory.handover != memory.handover:
        memory.handover = memory.acceleration - demand
    else:
        memory.handover -= clip(memory.handover, -settings.stop_jerk * settings.period, HANDOVER_JERK * settings.period)
    return demand + memory.handover


@inlined
def _stop_unguided(deceleration, period, settings, memory):
    """Brake (m/s^2) to a standstill wherever the car is, and hold it there."""
    memory.handover = 0.0
    if _stands(memory):
        _hold(0.0, period, settings, memory)
        memory.speed_state = EMERGENCY if memory.speed_state == EMERGENCY else STOPPING
        if memory.fault != faults.NO_FAULT:
            memory.hold = settings.brake_limit
    else:
        memory.speed_state = EMERGENCY if deceleration > EMERGENCY_RATIO * settings.brake else STOPPING
        memory.target_speed, memory.hold, memory.is_braking = 0.0, 0.0, 1
        _request(-deceleration, memory.speed, period, settings, memory)
    memory.limited_by = BY_FAULT
    if memory.fault != faults.NO_FAULT:
        memory.force = min(memory.force, 0.0)
        memory.speed_state = EMERGENCY
        memory.limited_by = BY_BRAKE_FAULT if memory.fault == faults.BRAKES_FAIL else BY_DRIVE_FAULT


# -- along the plan ---------------------------------------------------------------------------------------------------
@inlined
def _moved(memory):
    """Whether positions show that the car has moved since its start: 1 forward, -1 back, 0: not clearly."""
    moved = memory.pose_place - memory.start_place
    bound = MOVED_WAY + MOVED_SIGMAS * sqrt(memory.observer_variance)
    return (1 if moved > bound else 0) - (1 if moved < -bound else 0)


@inlined
def _least_delay(belief):
    """Delay (s) of an actuator that it has at least."""
    return max(belief.dead_time + belief.lag - START_SIGMAS * belief.delay_sigma, 0.0)


@inlined
def _release_time(period, settings, memory):
    """Time (s) that a car needs at least from the first release of its brakes until it moves, see `_start`."""
    descent = max(period.drive.disturbance - _resistance(0.0, period.slope, settings), 0.0)
    surplus = max(memory.hold / settings.mass, HOLD_AT_REST) - descent - START_RESERVE - GENTLE_LAUNCH
    delayed = RELEASE_RATE * _least_delay(period.brakes) + LAUNCH_RATE * _least_delay(period.drive)
    return max(surplus + delayed, 0.0) / (RELEASE_RATE + LAUNCH_RATE)


@inlined
def _start(sample, way, period, settings, memory):
    """Push until the car moves, and release the brakes gradually once the drive carries the estimated slope.

    way: m, to the next stop. A car that rolls back is held again until the drive pushes more than before. At a planned
    rest the brakes hold until a car that is released cannot move before its time. Return whether the car has still to
    start.
    """
    if memory.is_starting == 0:
        _hold(0.0, period, settings, memory)
        memory.is_starting, memory.launch = 1, 0.0
    if abs(memory.speed) < STANDING_SPEED:
        memory.start_place = memory.station
    must_wait = sample.rest_time > _release_time(period, settings, memory)
    is_gentle, direction = way < SHORT_MOVE, _moved(memory)
    moves = memory.speed > (GENTLE_SPEED if is_gentle else STARTED_SPEED)
    is_sure = is_gentle or memory.speed > SURE_SPEED
    if moves and (direction > 0 or (is_sure and direction == 0)):
        memory.is_starting, memory.rolling, memory.rolled, memory.handover = 0, 0.0, 0.0, math.nan
        return False
    is_rolling = memory.speed < -ROLLING_SPEED or (abs(memory.speed) > ROLLING_SPEED and direction < 0)
    hold = memory.hold
    drive, resistance = period.drive, _resistance(0.0, period.slope, settings) - period.drive.disturbance
    push = max(resistance, 0.0) + START_RESERVE
    memory.limited_by, memory.is_braking = BY_PLAN, 0
    _request(push + memory.launch - resistance, 0.0, period, settings, memory)
    carried = push + memory.rolled
    if memory.limited_by != BY_PLAN:  # the drive has no more
        carried = min(carried, FULL_DRIVE_SHARE * drive.ratio * memory.force / settings.mass)
    force, acceleration = memory.force, memory.acceleration
    if is_rolling:
        memory.rolled = max(memory.rolled, memory.launch + ROLLED_RESERVE)
        _hold(0.0, period, settings, memory)
        hold, memory.is_starting = memory.hold, 1
    elif not moves and not must_wait and drive.ratio * drive.acting >= carried:
        hold = max(hold - (GENTLE_RELEASE_RATE if is_gentle else RELEASE_RATE) * period.duration * settings.mass, 0.0)
    if not moves:
        is_slow = must_wait or ((is_gentle or resistance < -DESCENT) and hold > 0.0 and memory.rolled == 0.0)
        memory.launch = min(memory.launch + LAUNCH_RATE * period.duration, GENTLE_LAUNCH if is_slow else MAX_LAUNCH)
    memory.is_braking, memory.force, memory.acceleration, memory.hold = 0, force, acceleration, hold
    return True


@inlined
def _braking_share(drive, brakes, memory):
    """Share of the brakes in the delay of a request: 1 where they act; at the end of a stop the drive takes over."""
    if memory.is_braking > 0:
        return 1.0
    share = brakes.acting / max(brakes.acting + drive.acting, learning.LEAST_ACTION)
    return share if memory.acceleration < 0.0 else 0.0


@inlined
def _aim(sample, index, way, stop_braking, top_square, resistance, period, settings, path, memory, banks, ahead):
    """Motion to request, for the place at which drive or brakes act.

    index, way, stop_braking: of the next stop, m to it, m/s^2 on the way. Return the acceleration (m/s^2), the speed
    to reach and the coming speed (m/s), the coming way to the stop (m), and the cause.
    """
    drive, brakes, station = period.drive, period.brakes, memory.station
    share = _braking_share(drive, brakes, memory)
    delay = drive.dead_time + share * (brakes.dead_time - drive.dead_time)
    lag = drive.lag + share * (brakes.lag - drive.lag)
    coming_speed, coming_way, _, _ = learning.predicted_motion(
        max(memory.speed, 0.0), 0.0, delay, resistance, drive, brakes, settings.period, banks
    )
    true_ratio = 1.0 + memory.scale  # of the speed over the measured one
    coming_way *= true_ratio
    place = station + coming_way
    lead = place + true_ratio * coming_speed * lag
    target_square = _square_at(place, station, path, ahead)
    least_target = max(LEAST_TARGET + min(sample.correction, 0.0), LEAST_EARLY_TARGET)
    target = max(sqrt(max(target_square, 0.0)), least_target)
    distance = LEAD_DISTANCE
    if sample.is_timed > 0.0:
        distance = clip(LEAD_TIME * coming_speed, LEAST_LEAD_DISTANCE, LEAD_DISTANCE)
    change = _square_at(lead + distance, station, path, ahead) - _square_at(lead, station, path, ahead)
    acceleration, cause = 0.5 * change / distance, BY_GRIP
    if target_square >= _planned_square(cell_at(place, path), sample, path) * 0.999:
        cause = BY_PLAN
    elif target_square >= top_square * 0.999:
        cause = BY_FAULT if memory.on_probation > 0.0 else BY_UNKNOWN_STEERING
    remaining_way = way - coming_way - (AIMED_DISTANCE if memory.travelled > stops.ARRIVAL_WAY else 0.0)
    jerk = settings.stop_jerk / (1.0 + STOP_SOFTENING * brakes.lag) * (stop_braking / settings.brake)
    caution_way = BRAKE_CAUTION * max(brakes.delay_sigma - KNOWN_DELAY, 0.0) * true_ratio * coming_speed
    stop_speed, stop_acceleration = _stopping_motion(remaining_way - caution_way, lag, jerk, stop_braking)
    if memory.travelled + way < SHORT_MOVE:
        slow = sqrt(2.0 * SHORT_MOVE_BRAKE * max(remaining_way, 0.0))
        if slow < stop_speed:
            stop_speed, stop_acceleration = slow, -SHORT_MOVE_BRAKE
    stop_speed, stop_acceleration = stop_speed / true_ratio, stop_acceleration / true_ratio
    if stop_speed < target or remaining_way <= 0.0:
        acceleration, target, cause = stop_acceleration, stop_speed, _stop_cause(index, path)
    return acceleration, target, coming_speed, remaining_way, cause


@inlined
def _come_to_rest(period, settings, memory):
    """Come to rest at once, and stand: the place of rest is where the trajectory begins."""
    memory.speed_state, memory.limited_by = STOPPING, BY_STOP
    if memory.is_starting > 0 or _stands(memory):
        memory.standing += period.duration
        _stand(0.0, period, settings, memory)
        return
    memory.standing, memory.target_speed, memory.hold, memory.is_braking = 0.0, 0.0, 0.0, 1
    deceleration = min(SHORT_MOVE_BRAKE + settings.gain * memory.speed, settings.brake)
    _request(-deceleration, memory.speed, period, settings, memory)


@inlined
def _follow(sample, index, way, top_square, period, settings, path, memory, banks, ahead):
    """Follow the governed speeds and the next stop; write the requests. index, way: of the stop, and m to it."""
    is_near = -math.inf < way < stops.NEAR_STOP and memory.travelled <= stops.ARRIVAL_WAY
    has_arrived = way <= stops.STOP_TOLERANCE < stops.ARRIVAL_WAY < memory.travelled
    if memory.speed < STANDING_SPEED and (is_near or has_arrived):
        memory.speed_state, memory.limited_by, memory.standing = STOPPING, _stop_cause(index, path), 0.0
        _stand(-way, period, settings, memory)
        return
    resistance = _resistance(memory.speed, period.slope, settings)
    rolls_back = memory.travelled < stops.ARRIVAL_WAY and _moved(memory) < 0
    is_at_start = memory.is_starting > 0 or memory.speed < STANDING_SPEED or rolls_back
    if way > stops.STOP_TOLERANCE and learning.SETTLING_TIME < sample.rest_time < math.inf:
        _come_to_rest(period, settings, memory)
        return
    if is_at_start and _start(sample, way, period, settings, memory):
        memory.speed_state, memory.limited_by = DRIVING, BY_PLAN
        return
    stop_braking = _stop_braking(index, way, sample, settings, path, memory)
    acceleration, target, coming_speed, remaining_way, cause = _aim(
        sample, index, way, stop_braking, top_square, resistance, period, settings, path, memory, banks, ahead
    )
    disturbance = period.brakes.disturbance if memory.is_braking > 0 else period.drive.disturbance
    tyres = acceleration + settings.gain * (target - coming_speed) + resistance - disturbance
    band = STOPPING_BAND if cause in (BY_STOP, BY_PATH_END) else COASTING_BAND
    if (tyres < -band and memory.is_braking == 0) or (tyres > band and memory.is_braking > 0):
        memory.is_braking = 1 - memory.is_braking
        acceleration, target, coming_speed, remaining_way, cause = _aim(
            sample, index, way, stop_braking, top_square, resistance, period, settings, path, memory, banks, ahead
        )
    memory.limited_by, memory.target_speed, memory.speed_state = cause, target, DRIVING
    memory.hold = max(memory.hold - STARTED_RELEASE_RATE * period.duration * settings.mass, 0.0)
    if cause in (BY_STOP, BY_PATH_END):
        memory.speed_state = STOPPING
        is_far = remaining_way > stops.STOP_TOLERANCE
        if is_far and square(coming_speed) > 2.0 * EMERGENCY_RATIO * stop_braking * remaining_way:
            memory.speed_state, memory.hold, memory.handover, memory.is_braking = EMERGENCY, 0.0, 0.0, 1
            needed = 0.5 * square(coming_speed) / max(remaining_way, REACHED)
            _request(-min(needed, settings.emergency), memory.speed, period, settings, memory)
            return
    demand = acceleration + settings.gain * (target - coming_speed)
    strongest = COMFORT_RESERVE * settings.brake
    if sample.is_timed > 0.0:
        k = whole(floor(memory.station / path.spacing))
        braking = max(_planned_braking(k, settings, path), _planned_braking(k - PASSED_CELLS, settings, path))
        braking = max(braking, stop_braking if cause in (BY_STOP, BY_PATH_END) else -acceleration)
        strongest = max(strongest, min(COMFORT_RESERVE * braking, settings.emergency))
    bounded = clip(demand, -strongest, COMFORT_RESERVE * settings.accelerate)
    if bounded != demand and memory.limited_by == BY_PLAN:
        memory.limited_by = BY_COMFORT
    bounded = _hand_over(bounded, settings, memory) - faults.probing_deceleration(memory)
    _request(bounded, memory.speed, period, settings, memory)


# -- one period -------------------------------------------------------------------------------------------------------
@inlined
def _slope_at(grade, path, memory):
    """Deceleration (m/s^2) by the slope under the car: by a measured grade, else by the path's."""
    return slope_of(grade) if abs(grade) <= MAX_PLAN_GRADE else path.slope[cell_at(memory.station, path)]


@inlined
def _learn(sample, dt, slope, settings, memory, banks):
    """Take in a speed that is newer than the last one; drive and brakes are learned from it, and watched."""
    memory.speed_age += dt
    elapsed = memory.speed_age - sample.speed_age
    is_known = sample.speed == sample.speed and sample.speed_age <= SPEED_GRACE
    if not (is_known and elapsed > LEAST_ELAPSED * settings.period):
        return
    before, is_first = memory.measured_speed, elapsed > SPEED_GRACE
    memory.measured_speed, memory.speed_age = sample.speed, sample.speed_age
    memory.lateness += LATENESS_SMOOTHING * (sample.speed_age - memory.lateness)
    if is_first:
        before, elapsed, memory.settled = sample.speed, SPEED_GRACE, 0.0
        learning.forget_speeds(banks)
    memory.settled += elapsed
    is_settled = memory.settled > learning.SETTLING_TIME
    is_believed = is_speed_known(memory) and not is_speed_doubted(memory)
    take_motion(sample.acceleration, elapsed, before, memory)
    resistance = _resistance(sample.speed, slope, settings)
    if sample.driver <= 0.0:
        is_held = memory.hold > 0.0 and abs(sample.speed) < CREEPING_SPEED  # a sensor may have this offset
        speed = 0.0 if is_held else sample.speed
        learning.learn_actuators(
            speed if is_believed else math.nan, resistance, settings.period, memory.speed_age, elapsed,
            not faults.is_suspected(memory), is_settled, banks,
        )  # fmt: skip
    if memory.speed_state == OFF or not is_settled or not is_believed:
        faults.forget_faults(sample.speed, 0.0, memory)
    else:
        drive, brakes = learning.mean_of_bank(banks.drive), learning.mean_of_bank(banks.brakes)
        faults.watch_actuators(sample.speed, resistance, drive, brakes, elapsed, memory)


@inlined
def _at_present(belief, acting):
    """The belief about an actuator whose present action (m/s^2) is `acting`."""
    return learning.ActuatorBelief(
        belief.lag, belief.dead_time, belief.delay_sigma, belief.ratio, belief.ratio_sigma, belief.disturbance,
        belief.speed, acting, belief.acting_sigma,
    )  # fmt: skip


@inlined
def _carry_speed(dt, slope, settings, memory, banks):
    """Carry the filtered speed to the present by the requests that act; drive and brakes at present.

    A speed that is too old, or contradicts the positions, goes on by the requested acceleration.
    """
    drive, brakes = learning.mean_of_bank(banks.drive), learning.mean_of_bank(banks.brakes)
    is_held = memory.hold > 0.0 and memory.measured_speed < STANDING_SPEED
    age = 0.0 if is_held else min(memory.speed_age, SPEED_GRACE)
    speed = brakes.speed if brakes.acting > drive.acting else drive.speed
    if speed != speed:
        speed = memory.measured_speed
    surplus = memory.measured_speed - speed
    speed += surplus / (1.0 + abs(speed) / EXACT_SPEED)
    surplus = memory.measured_speed - speed
    speed, _, driving, braking = learning.predicted_motion(
        max(speed, 0.0), age, age, _resistance(speed, slope, settings), drive, brakes, settings.period, banks
    )
    if not is_speed_known(memory):
        memory.speed = max(memory.speed + memory.acceleration * dt, 0.0)
    elif memory.measured_speed < 0.0:
        memory.speed = memory.measured_speed
    else:
        memory.speed = memory.direction * speed
    memory.carried_speed = memory.direction * (speed + surplus)
    memory.place_speed = memory.speed + (memory.direction * surplus if is_speed_known(memory) else 0.0)
    return _at_present(drive, driving), _at_present(brakes, braking)


@inlined
def _locate(sample, before, dt, path, memory):
    """Move the place of the car by the way in a time (s), and correct it by a newer position. before: m/s."""
    way = 0.5 * (before + memory.place_speed) * dt
    memory.travelled += abs(way)
    # along the path: less on the outside of a bend, more on the inside
    projection = 1.0 / max(1.0 - path.curvature[cell_at(memory.station, path)] * sample.offset, LEAST_RADIUS_SHARE)
    predict_place(projection * way, dt, memory)
    interval = memory.observer_time + dt
    compare_with_positions(sample.station, sample.station_age, projection, dt, memory)
    memory.jump = 0.0
    if sample.station == sample.station:
        age = sample.station_age
        way_since = memory.place_speed * age - 0.5 * memory.motion * age * age
        way_since *= (1.0 + memory.scale) * projection
        correct_place(sample.station + way_since, interval, memory)


@inlined
def _bend_ahead(way, path, memory, ahead):
    """Return the largest lateral acceleration (m/s^2) of the path, at governed speeds, on the way (m) ahead."""
    largest, first = 0.0, whole(floor(memory.station / path.spacing))
    for j in range(min(whole(way / path.spacing) + 1, ahead.size)):
        cell = cell_at((first + j + 0.5) * path.spacing, path)
        largest = max(largest, abs(ahead[j] * path.curvature[cell] - path.bank[cell]))
    return largest


@inlined
def _sense_lateral(yaw_rate, path, memory, dt):
    """Filter the lateral acceleration, slide and sway (m/s^2); return the larger of that measured and of the path's."""
    cell = cell_at(memory.station, path)
    bend = abs(memory.speed * memory.speed * path.curvature[cell] - path.bank[cell])
    if yaw_rate == yaw_rate:
        measured = min(abs(memory.speed * yaw_rate - path.bank[cell]), MAX_LATERAL)
        memory.lateral += LATERAL_SMOOTHING * (measured - memory.lateral)
    memory.slide -= memory.slide * dt / SLIDE_TIME
    memory.slide = max(memory.slide, memory.lateral - memory.friction * GRAVITY)
    memory.sway -= memory.sway * dt / SWAY_TIME
    memory.sway = max(memory.sway, memory.lateral - bend - SWAY_MARGIN * memory.friction * GRAVITY)
    return max(memory.lateral, bend)


@inlined
def speed_control(sample, settings, path, memory, banks, ahead):
    """One control period: write state, requests and causes to the memory, and the governed squares to ahead.

    Drive and brakes are learned first, from the speed that the requests so far have made.

    sample: `SPEED_SAMPLE`; its grade replaces that of the path where the car is, not ahead of it; ahead: (n,), at the
    cells from the station on.
    """
    top_square = square(min(sample.top_speed, faults.top_speed_after_fault(memory)))
    periods = max(whole(sample.periods), 1)
    if memory.friction <= 0.0:
        memory.friction, memory.friction_high = settings.friction, settings.friction_high
        memory.cautious_friction = settings.friction
    dt = periods * settings.period
    learning.repeat_requests(min(periods - 1, banks.requests.size // 2), banks.requests)
    if memory.is_changed > 0:
        stops.match_stops(path, memory)
        memory.is_changed = 0
    _learn(sample, dt, _slope_at(sample.grade, path, memory), settings, memory, banks)
    before = memory.place_speed if memory.is_placed > 0 else memory.measured_speed
    drive, brakes = _carry_speed(dt, _slope_at(sample.grade, path, memory), settings, memory, banks)
    _locate(sample, before, dt, path, memory)
    slope, lateral = _slope_at(sample.grade, path, memory), _sense_lateral(sample.yaw_rate, path, memory, dt)
    is_braked = memory.force < 0.0 or memory.hold > 0.0
    memory.creeping = memory.creeping + dt if is_braked and abs(memory.speed) < CREEPING_SPEED else 0.0
    _govern(sample, top_square, max(brakes.disturbance, 0.0), settings, path, memory, ahead)
    bend = _bend_ahead(max(memory.speed, 0.0) * (drive.dead_time + drive.lag), path, memory, ahead)
    period = ControlPeriod(dt, slope, lateral, bend, drive, brakes)
    memory.grip_used = sqrt(square(memory.acceleration) + square(lateral)) / (memory.friction * GRAVITY)
    if sample.driver > 0.0:
        _yield_to_driver(period, settings, memory, banks)
        return
    was_off = memory.speed_state == OFF
    needed, delay = 0.0, brakes.lag + brakes.dead_time + BLIND_SIGMAS * brakes.delay_sigma + BLIND_MARGIN
    if not was_off:
        needed = _blind_deceleration(sample.blind_time, sample.is_guided, delay, settings, memory)
    is_lost = sample.is_guided <= 0.0 or memory.is_placed == 0 or not is_speed_known(memory)
    if is_lost or memory.fault != faults.NO_FAULT:
        pull = max(memory.watched_disturbance, 0.0) if memory.fault == faults.DRIVE_STICKS else 0.0
        needed = max(needed, settings.emergency if memory.fault == faults.BRAKES_FAIL else settings.brake + pull)
    index, way = stops.NO_STOP, math.inf
    if needed <= 0.0:
        memory.speed_state = DRIVING if was_off else memory.speed_state
        index, way = _find_stop(sample, dt, path, memory)
        if index == stops.NO_STOP and path.closed == 0 and memory.station > path.length:
            needed = settings.brake  # beyond the end of the path
    if needed > 0.0:
        _stop_unguided(needed, period, settings, memory)
        memory.speed_state = OFF if was_off else memory.speed_state
    elif memory.speed_state == WAITING:
        memory.limited_by = _stop_cause(index, path)
        _stand(-way, period, settings, memory)
    else:
        _follow(sample, index, way, top_square, period, settings, path, memory, banks, ahead)
    learning.remember_request(memory.force, memory.hold, settings.mass, banks.requests)


@inlined
def governed_speeds(speed, period, spacing, ahead, speeds):
    """Write the speeds (m/s) at the coming control instants of a car that passes the cells ahead as they are governed.

    All are shifted so that the first one is the present speed (m/s); ahead: squares (m^2/s^2) every spacing (m).
    """
    first, way = sqrt(max(ahead[0], 0.0)), 0.0
    for i in range(speeds.size):
        planned = sqrt(max(ahead[min(whole(way / spacing), ahead.size - 1)], 0.0))
        speeds[i] = max(planned + speed - first, 0.0)
        way += max(planned, LEAST_SPEED_AHEAD) * period

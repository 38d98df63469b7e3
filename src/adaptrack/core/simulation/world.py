"""The pieces of a simulated control period: where the car is, whether its run has failed, sensors, driver, steering.

`run` has them in their order. They take a slot and its run (`run.RunRecord`), in which they read and write by name.
"""

from __future__ import annotations

import math

from ..kernel import columns, cube, inlined, local, matrix, record, rows, written
from ..maths.bits import whole
from ..maths.exact import ceil, clip, floor
from ..maths.exponential import hypot
from ..maths.random import counted_normal, counted_uniform
from ..maths.trigonometric import atan2
from ..models.car import AXLES, POWERTRAIN
from ..models.contract import MEASUREMENT, SENSOR_FIELDS
from ..physics import forces
from ..physics.force_actuator import ForceActuator, actuator_step
from ..physics.forces import GRAVITY
from ..plants import contract as plants
from ..plants.contract import PLANT_INPUT, PLANT_STATE
from ..roads.road import foot_near, line_of, point_at
from ..scheduling.functions import VARIABLE_COLUMNS
from ..tracker.signals import TRACKED

LoopSettings = record(
    "LoopSettings",
    (
        "period",  # s
        "substeps",  # Runge-Kutta steps per period
        "prescribed_speed",  # `DRIVER_FORCES`, `PRESCRIBED`, `PRESCRIBED_WITHOUT_ROAD` or `EXTERNAL_FORCES`
        "dead_whole", "dead_share",  # periods from an instant until its command acts: whole ones, and the share of one
        *SENSOR_FIELDS,
        "steering_lag", "steering_limit",  # s, rad, of the actuator
        "steering_bias",  # rad, what the wheels are turned beyond the command
        "driver_preview",  # s, how far ahead the driver looks at the speed profile
        "driver_integral",  # 1/s^2, gain on the integral of the speed error
        *POWERTRAIN,  # with the mass the driver turns acceleration into force
        "failure_distance",  # m, a run has failed when |Y - y_ref| exceeds this after it has once been within
        "failure_sideslip",  # rad, or the sideslip angle this
        *AXLES,  # with which the driver's traction guard finds the axle loads
        "understeer_gradient", "rear_slip_gradient",  # rad s^2/m, of the steady turn at the start; NaN: unknown
        "guard",  # -, share of what the axles have left beside their lateral forces that the driver uses; inf: any
        "drive_whole", "drive_share",  # of the drive, as `dead_whole` and `dead_share` of the steering
        "drive_lag", "drive_rate", "drive_gain",  # s, m/s^3, -
        "creep",  # m/s^2, of the drive at standstill without a request
        "brake_whole", "brake_share",  # of the brakes, as those of the drive
        "brake_lag", "brake_rate", "brake_gain",  # s, m/s^3, -
    ),
    integers=("substeps", "prescribed_speed", "dead_whole", "drive_whole", "brake_whole"),
)  # fmt: skip
"""The world around the controller, fixed over a run."""

DRIVER_FORCES, PRESCRIBED, PRESCRIBED_WITHOUT_ROAD, EXTERNAL_FORCES = range(4)
"""What moves a car: the forces that its driver requests; a speed that it follows exactly; that in scenarios without a
road, and forces on roads; forces that a speed control, or the caller, requests."""

LOOP_MEMORY = record(
    "Own",
    (
        "instant",  # the present control instant
        "sample",  # where it is in the signals
        "command",  # rad, the controller's last one
        "blind_until",  # s, no pose is measured before
        "integral",  # m, of the driver's speed error
        "arrived",  # 1 once the vehicle has been within the failure distance
        "ended",  # RUNNING, or why the run ended
        "ended_at",  # s
        *(TRACKED.field_settings[name] for name in ("offset", "heading_error")),
        "error",  # m, of the offset against its reference
        "speed",  # m/s, as measured at the present instant
        "station", "heading",  # m, rad, of its foot on a curved road
        "turned",  # rad, see `MEASUREMENT`
        "located",  # 1 once the foot is known
        "place",  # the instant at which the plan is where the car is
        "curvature",  # 1/m, of its road at the foot
        "drive_force", "brake_force",  # N, at the end of the last period
        "requested_force", "requested_hold",  # N, N: of a speed controller; hold: of the brakes besides the force
        "standing",  # instants for which the car has stood at a stop
        "departed",  # the first instant of the plan after the last stop that the car has left
        "speed_age",  # s, of the measured speed
        "pose_station",  # m, measured position along the road at the time of the measured pose; without a road x
        "station_estimate",  # m, the same carried forward to the present instant
        "path_heading",  # rad, heading of the road at this estimate
        "caller_state",  # NOT_ASKED, or what the caller has to do or has done at this instant
        "cost",  # m^2, of the last period
    ),
    integers=("instant", "sample", "arrived", "ended", "located", "place", "standing", "departed", "caller_state"),
)  # fmt: skip
"""What the loop remembers of each slot: its scalars."""


def clearer(kind):
    """An inlined function ``clear(row)``: sets all numbers of a row of a record to 0."""
    return written(f"clear_{kind.__name__}", "row", [f"row.{name} = 0" for name in kind._fields], kind)


_clear = clearer(LOOP_MEMORY)

NOT_ASKED, ASKED, ANSWERED = range(3)
"""Of a caller that is asked before each step of a controller: not at this instant; the run waits for it; it goes on."""
SENSED = 6
"""How many of `MEASUREMENT` are measured; the others are their ages."""
PAST_SIGNAL = columns(*MEASUREMENT._fields[:SENSED], "speed", "station")
"""Signals of an instant that late sensors look back to."""
Memory = record(
    "Memory",
    (
        ("drives", rows(LOOP_MEMORY), "slots"),
        ("sent", matrix, "slots", "sent"),  # rad, commands
        ("past", cube, "slots", "past", len(PAST_SIGNAL)),  # what there was to measure; empty: all sensors are prompt
        ("requested", matrix, "slots", "requested"),  # N, of the drive and, behind them, of the brakes
    ),
)
"""What the loop remembers of each slot; commands, past signals and forces the latest first."""
_SPEED, _SPEED_FLOOR, _STATION = range(SENSED, SENSED + 3)  # channels of normal numbers, after those of the sensors
_observed = local(len(plants.OBSERVED))
_JITTER, _DROPOUT, _LENGTH, _MISSING, _BIAS = range(5)  # streams of random numbers

RUNNING, OFF_ROAD, SPUN, STATE_NOT_FINITE, NEVER_ARRIVED, STOPPED = range(6)
"""Why a run ended: left its reference, spun, a state that is not finite, never came near; or too dear to go on."""
MIN_SPIN_SPEED = 1.0
"""m/s: below it sideslip is ill-defined, and a vehicle is not said to spin."""

SIGNAL = columns(
    "y_ref", "speed", "friction_front_left", "friction_front_right", "friction_rear_left", "friction_rear_right",
    "wind_x", "wind_y", "bank", "known_friction", "known_wind", "change", "acceleration", "station", "grade",
)  # fmt: skip
"""Rows of a scenario's samples. Friction and wind as they are known and the reference preview are scheduling variables;
station is where the plan is on a curved road (m); grade is dz/ds of the road, positive uphill."""
HOLDING_SPEED, HOLDING_DECELERATION = 0.3, 1.0
"""m/s, below which the driver holds a car at a stop; m/s^2, with which."""
CREEP_SPEED = 2.0
"""m/s, at which creeping has faded out."""
TOLERATED, CATCH_UP, MOST_CATCH_UP = 0.5, 2.0, 0.1
"""m, by which a car may be early or late on its plan; s, in which it makes up for the rest; share of the speed, at
most."""


# -- where the car is -------------------------------------------------------------------------------------------------
@inlined
def locate(slot, run):
    """Find the car on its road: offset and heading error against the path, the foot and the place in the plan."""
    drive, signals, scenario = run.memory.drives[slot], run.inputs.signals, run.inputs.scenario[slot]
    road = run.inputs.roads.of[scenario]
    car = plants.state_of(run.vehicles.block, slot)
    if road < 0:
        drive.offset, drive.heading_error = car.y, car.yaw
        return
    near = signals[scenario, SIGNAL.station, 0]
    if drive.located > 0:
        near = drive.station + car.vx * run.settings.period
    station, offset, heading, drive.curvature = foot_near(car.x, car.y, near, line_of(road, run.inputs.roads))
    drive.turned = heading - drive.heading if drive.located > 0 else 0.0
    drive.station, drive.offset, drive.heading, drive.located = station, offset, heading, 1
    turns = (car.yaw - heading) / (2.0 * math.pi)
    drive.heading_error = 2.0 * math.pi * (turns - floor(turns + 0.5))
    _, _, samples = signals.shape
    last, first = samples - 1, drive.departed
    while drive.place < last and signals[scenario, SIGNAL.station, drive.place + 1] <= station:
        if waits_at_stops(slot, run) and _is_stop(drive.place, drive, signals[scenario]):
            break
        drive.place += 1
    while drive.place > first and signals[scenario, SIGNAL.station, drive.place] > station:
        drive.place -= 1


@inlined
def is_prescribed(slot, run):
    """Whether a car follows its planned speed exactly, without forces along the road."""
    kind = run.settings.prescribed_speed
    return kind == PRESCRIBED or (kind == PRESCRIBED_WITHOUT_ROAD and run.memory.drives[slot].located == 0)


@inlined
def waits_at_stops(slot, run):
    """Whether the driver of the loop counts the seconds at a stop; a speed control counts them itself."""
    return not is_prescribed(slot, run) and run.settings.prescribed_speed != EXTERNAL_FORCES


@inlined
def _is_stop(place, drive, signals):
    """Whether the plan stands at an instant and the car has not yet waited there."""
    return place >= drive.departed and signals[SIGNAL.speed, place] <= 0.0


@inlined
def plan_instant(slot, run):
    """Instant of the plan that counts for a car: that of its place if a driver follows a road, else the present."""
    drive = run.memory.drives[slot]
    return drive.place if drive.located > 0 and not is_prescribed(slot, run) else drive.instant


# -- failure ----------------------------------------------------------------------------------------------------------
@inlined
def judge(slot, run):
    """Why a run has failed at this instant, RUNNING if it has not.

    Not finite: a state. Spun: a sideslip angle |atan2(v_y, v_x)| beyond the limit at 1 m/s or more. Off the road:
    the error against the reference beyond the distance, once the vehicle has arrived within it.
    """
    drive, block, world = run.memory.drives[slot], run.vehicles.block, run.settings
    car = plants.state_of(block, slot)
    within = abs(drive.error) <= world.failure_distance
    if within:
        drive.arrived = 1
    for row in range(PLANT_STATE.yaw_rate + 1):
        if not math.isfinite(block[plants.state_at(row, slot)]):
            return STATE_NOT_FINITE
    if not math.isfinite(car.steering):
        return STATE_NOT_FINITE
    if hypot(car.vx, car.vy) >= MIN_SPIN_SPEED and abs(atan2(car.vy, car.vx)) > world.failure_sideslip:
        return SPUN
    if drive.arrived > 0 and not within:
        return OFF_ROAD
    return RUNNING


# -- the controller's side --------------------------------------------------------------------------------------------
@inlined
def _noisy(value, noise, k, sensor, seed):
    """Return a sensor's reading: the value and its noise; NaN where there is no sensor."""
    if noise > 0.0:
        return value + noise * counted_normal(seed, k, sensor) if noise < math.inf else math.nan
    return value


@inlined
def _either(most, seed, stream, k):
    """A number uniform in +-most."""
    return most * (2.0 * counted_uniform(seed, stream, k, 0, 0) - 1.0)


@inlined
def _keep_past(k, station, drive, past, measured):
    """Add what there is to measure now to the instants before; at the first instant fill all of them with it."""
    instants, _ = past.shape
    for i in range(instants - 1, 0, -1):
        past[i, :] = past[i - 1]
    past[0, :SENSED] = measured[:SENSED]
    past[0, PAST_SIGNAL.speed], past[0, PAST_SIGNAL.station] = drive.speed, station
    if k == 0:
        for i in range(1, instants):
            past[i, :] = past[0]


@inlined
def _recall(sensor, instants, past):
    """Interpolate the measurable signals so many control instants ago."""
    first = whole(instants)
    near = past[first, sensor]
    return near + (instants - first) * (past[first + 1, sensor] - near)


@inlined
def _age_of(mean, change):
    """Age (s) of a sample: its mean and a change of it, 0 if the mean is 0."""
    return max(0.0, mean + change) if mean > 0.0 else 0.0


@inlined
def _make_late(k, world, seed, drive, past, measured):
    """Replace the present signals by late ones; return the late position along the road (m) and its age (s).

    One random number changes all ages, each by its spread: samples of equal mean age and spread are one message.
    """
    most, period = float(k), world.period  # nothing is older than the run
    draw = _either(1.0, seed, _JITTER, k)
    pose_change, motion_change = world.pose_age_spread * draw, world.motion_age_spread * draw
    pose_age, motion_age = _age_of(world.pose_age, pose_change), _age_of(world.motion_age, motion_change)
    station_age, speed_age = _age_of(world.station_age, pose_change), _age_of(world.speed_age, motion_change)
    for sensor in range(SENSED):
        posed = sensor == MEASUREMENT.yaw or sensor == MEASUREMENT.y
        instants = min((pose_age if posed else motion_age) / period, most)
        measured[sensor] = _recall(sensor, instants, past)
    drive.speed = _recall(PAST_SIGNAL.speed, min(speed_age / period, most), past)
    drive.pose_station = _recall(PAST_SIGNAL.station, min(pose_age / period, most), past)
    drive.speed_age = min(speed_age, most * period)
    measured[MEASUREMENT.pose_age] = min(pose_age, most * period)
    measured[MEASUREMENT.motion_age] = min(motion_age, most * period)
    return _recall(PAST_SIGNAL.station, min(station_age / period, most), past), min(station_age, most * period)


@inlined
def _leave_out(k, world, seed, drive, measured):
    """Samples that are missing, one by one or, of the pose, for a while."""
    time = k * world.period
    if world.missing > 0.0:
        for sensor in range(SENSED):
            if counted_uniform(seed, _MISSING, k, sensor, 0) < world.missing:
                measured[sensor] = math.nan
    if world.dropout_pause > 0.0:
        drawn = counted_uniform(seed, _DROPOUT, k, 0, 0) * world.dropout_pause
        if time >= drive.blind_until and drawn < world.period:
            span = world.dropout_most - world.dropout_least
            drive.blind_until = time + world.dropout_least + span * counted_uniform(seed, _LENGTH, k, 0, 0)
        if time < drive.blind_until:
            measured[MEASUREMENT.yaw], measured[MEASUREMENT.y] = math.nan, math.nan


@inlined
def _read_speed(k, world, seed, speed):
    """Return the reading (m/s) of a speed: with noise, in steps of the resolution, and 0 within the dead zone."""
    reading = speed + speed * _noisy(0.0, world.noise_speed, k, _SPEED, seed) if world.noise_speed > 0.0 else speed
    reading = _noisy(reading, world.noise_speed_floor, k, _SPEED_FLOOR, seed)
    if world.speed_resolution > 0.0:
        reading = world.speed_resolution * floor(reading / world.speed_resolution + 0.5)
    return 0.0 if abs(reading) < world.speed_dead_zone else reading


@inlined
def _estimate_station(slot, station, age, run):
    """Estimate the present position along the road from a measured one (m) of a known age (s) and the measured speed.

    If the position is missing, the estimate moves on with the speed. The measured heading error is relative to the
    road at the estimated position at the time of the pose, as in `tracker`.
    """
    drive, world, measured = run.memory.drives[slot], run.settings, run.measured[slot]
    k, seed = drive.instant, run.inputs.seeds[slot]
    if k == 0 or math.isfinite(measured[MEASUREMENT.y]):
        estimate = _noisy(station, world.noise_station, k, _STATION, seed) + age * drive.speed
    else:
        estimate = drive.station_estimate + world.period * drive.speed
    true_station = drive.pose_station
    drive.station_estimate = estimate
    drive.pose_station = estimate - measured[MEASUREMENT.pose_age] * drive.speed
    if drive.located > 0:
        line = line_of(run.inputs.roads.of[run.inputs.scenario[slot]], run.inputs.roads)
        _, _, true_heading, _ = point_at(true_station, line)
        _, _, pose_heading, _ = point_at(drive.pose_station, line)
        _, _, heading, _ = point_at(estimate, line)
        measured[MEASUREMENT.yaw] += true_heading - pose_heading
        measured[MEASUREMENT.turned] = heading - drive.path_heading if k > 0 else 0.0
        drive.path_heading = heading


@inlined
def sense(slot, run):
    """Write what the sensors of a slot's vehicle give: `models.contract.MEASUREMENT`, its speed and its station."""
    drive, world, measured = run.memory.drives[slot], run.settings, run.measured[slot]
    car = plants.state_of(run.vehicles.block, slot)
    k, seed = drive.instant, run.inputs.seeds[slot]
    if world.noise_lateral_acceleration < math.inf:
        observed = _observed()
        plants.observe(slot, run.vehicles, observed)
        measured[MEASUREMENT.lateral_acceleration] = observed[plants.OBSERVED.lateral_acceleration]
    measured[MEASUREMENT.vy] = car.vy
    measured[MEASUREMENT.yaw] = drive.heading_error
    measured[MEASUREMENT.yaw_rate] = car.yaw_rate
    measured[MEASUREMENT.y] = drive.offset
    measured[MEASUREMENT.turned] = drive.turned
    command, lag = plants.input_of(run.vehicles.block, slot).command, world.steering_lag
    measured[MEASUREMENT.wheel_angle] = forces.wheel_angle(car.steering, command, lag, world.steering_limit)
    measured[MEASUREMENT.pose_age], measured[MEASUREMENT.motion_age] = 0.0, 0.0
    station = drive.station if drive.located > 0 else car.x
    drive.speed, drive.speed_age, drive.pose_station = car.vx, 0.0, station
    late_station, station_age = station, 0.0
    if run.features.late:
        past = run.memory.past[slot]
        _keep_past(k, station, drive, past, measured)
        late_station, station_age = _make_late(k, world, seed, drive, past, measured)
    noises = (
        world.noise_vy, world.noise_yaw, world.noise_yaw_rate, world.noise_y, world.noise_wheel_angle,
        world.noise_lateral_acceleration,
    )  # fmt: skip
    for sensor in range(SENSED):
        measured[sensor] = _noisy(measured[sensor], noises[sensor], k, sensor, seed)
    if world.bias_yaw_rate > 0.0:
        measured[MEASUREMENT.yaw_rate] += _either(world.bias_yaw_rate, seed, _BIAS, MEASUREMENT.yaw_rate)
    if world.bias_wheel_angle > 0.0:
        measured[MEASUREMENT.wheel_angle] += _either(world.bias_wheel_angle, seed, _BIAS, MEASUREMENT.wheel_angle)
    _leave_out(k, world, seed, drive, measured)
    drive.speed = _read_speed(k, world, seed, drive.speed)
    if world.noise_station > 0.0 or world.station_age > 0.0:
        _estimate_station(slot, late_station, station_age, run)
    else:
        drive.station_estimate = station


@inlined
def look(slot, run):
    """Write the scheduling variables (`VARIABLE_COLUMNS`) of a slot."""
    drive, signals, scenario = run.memory.drives[slot], run.inputs.signals, run.inputs.scenario[slot]
    measured, variables = run.measured[slot], run.variables[slot]
    k = drive.sample
    y_ref = signals[scenario, SIGNAL.y_ref, k]
    variables[VARIABLE_COLUMNS.speed] = drive.speed
    variables[VARIABLE_COLUMNS.y_ref] = y_ref
    variables[VARIABLE_COLUMNS.friction] = signals[scenario, SIGNAL.known_friction, k]
    variables[VARIABLE_COLUMNS.wind] = signals[scenario, SIGNAL.known_wind, k]
    variables[VARIABLE_COLUMNS.change] = signals[scenario, SIGNAL.change, k]
    variables[VARIABLE_COLUMNS.acceleration] = signals[scenario, SIGNAL.acceleration, k]
    variables[VARIABLE_COLUMNS.offset] = y_ref - measured[MEASUREMENT.y]


# -- the vehicle's side -----------------------------------------------------------------------------------------------
@inlined
def value_at(instant, values):
    """A signal at an instant (control periods, with a fraction); its last value after its end."""
    first = min(whole(instant), values.size - 1)
    near = values[first]
    return near + (instant - floor(instant)) * (values[min(first + 1, values.size - 1)] - near)


@inlined
def _instant_of_place(drive, stations):
    """Instant of the plan, with a fraction, at which it is where the car is."""
    first = drive.place
    after = min(first + 1, stations.size - 1)
    if not stations[after] > stations[first]:
        return float(first)
    return first + clip((drive.station - stations[first]) / (stations[after] - stations[first]), 0.0, 1.0)


@inlined
def _stop_ahead(instant, drive, speeds):
    """First instant, up to another one, at which the plan stands and the car has not waited yet; -1: none."""
    for j in range(drive.place, min(whole(instant) + 1, speeds.size - 1) + 1):
        if j >= drive.departed and speeds[j] <= 0.0:
            return j
    return -1


@inlined
def _wait(stop, speed, drive, speeds):
    """Count the instants for which a car stands at a stop of its plan; after as many as planned it may depart."""
    if abs(speed) > forces.STANDING_SPEED:
        return
    planned = 0
    while stop + planned + 1 < speeds.size and speeds[stop + planned + 1] <= 0.0:
        planned += 1
    drive.standing += 1
    if drive.standing > planned:
        drive.departed, drive.standing = stop + planned + 1, 0
        drive.place = min(drive.departed, speeds.size - 1)


@inlined
def _guarded_limits(friction, slot, run):
    """Largest driving and braking forces (N) that the driver requests: a share of what each axle has left.

    Each axle carries its part of the lateral acceleration that the car has, or that the bend asks of it, whichever is
    larger.
    """
    world, drive = run.settings, run.memory.drives[slot]
    if not world.guard < math.inf:
        return math.inf, math.inf
    car, surroundings = plants.state_of(run.vehicles.block, slot), plants.input_of(run.vehicles.block, slot)
    vx, bank = car.vx, surroundings.bank
    _, cosine = forces.slope_sine_and_cosine(surroundings.grade)
    in_bend = min(abs(vx * vx * drive.curvature - bank), forces.LARGEST_BEND_SHARE * (friction * GRAVITY * cosine))
    lateral = max(abs(vx * car.yaw_rate - bank), in_bend)
    driving, braking = forces.axle_limits(friction, world.mass * GRAVITY * cosine, lateral, world)
    return world.guard * driving, max(world.guard * braking, forces.LEAST_BRAKING * world.mass)


@inlined
def _drive(slot, run):
    """Longitudinal force (N) that the driver requests: aims at the plan's speed a preview time ahead, with an integral.

    dv = (v_plan(a preview time ahead) - v_x)/T_p + K_i * integral of (v_plan - v_x), and the slope of the road. On a
    road the plan is followed by place: its speed where the car is counts, however late the car is, and at a stop the
    car waits as long as planned. Limited by engine power, traction, brakes and the guard, the integral standing still
    while a limit holds.
    """
    drive, world, signals = run.memory.drives[slot], run.settings, run.inputs.signals[run.inputs.scenario[slot]]
    speed, speeds = plants.state_of(run.vehicles.block, slot).vx, signals[SIGNAL.speed]
    instant = float(drive.sample)
    if drive.located > 0:
        instant = _instant_of_place(drive, signals[SIGNAL.station])
    ahead = instant + world.driver_preview / world.period
    stop = _stop_ahead(ahead, drive, speeds) if drive.located > 0 else -1
    target = value_at(ahead, speeds) if stop < 0 else 0.0
    sine, _ = forces.slope_sine_and_cosine(plants.input_of(run.vehicles.block, slot).grade)
    requested = world.mass * (
        (target - speed) / world.driver_preview + world.driver_integral * drive.integral + GRAVITY * sine
    )
    if stop >= 0:
        _wait(stop, speed, drive, speeds)
        if speed < HOLDING_SPEED:
            drive.integral = 0.0
            return -world.mass * (HOLDING_DECELERATION + GRAVITY * abs(sine))
    friction = signals[SIGNAL.known_friction, min(drive.place if drive.located > 0 else drive.sample, speeds.size - 1)]
    traction, braking = _guarded_limits(friction, slot, run)
    strongest = min(traction, min(world.traction_limit, world.engine_power / max(speed, 1.0)))
    force = clip(requested, -min(braking, world.brake_limit), strongest)
    if force == requested:
        drive.integral += (value_at(instant, speeds) - speed) * world.period
    return force


@inlined
def _move_pedals(request, hold, slot, run):
    """Let drive and brakes follow a requested force (N) over the period that begins; their mean forces (N).

    hold: N, of the brakes besides the force.
    """
    drive, world, requests = run.memory.drives[slot], run.settings, run.memory.requested[slot]
    speed = plants.state_of(run.vehicles.block, slot).vx
    remembered = requests.size // 2
    for j in range(requests.size - 1, 0, -1):
        requests[j] = requests[j - 1]
    requests[0], requests[remembered] = max(request, 0.0), max(-request, 0.0) + hold
    creep = world.mass * world.creep * clip(1.0 - speed / CREEP_SPEED, 0.0, 1.0)
    engine = ForceActuator(
        world.drive_whole, world.drive_share, world.drive_lag, world.drive_rate * world.mass, world.drive_gain,
        min(world.traction_limit, world.engine_power / max(speed, 1.0)),
    )  # fmt: skip
    brakes = ForceActuator(
        world.brake_whole, world.brake_share, world.brake_lag, world.brake_rate * world.mass, world.brake_gain,
        world.brake_limit,
    )  # fmt: skip
    drive.drive_force, driving = actuator_step(drive.drive_force, creep, requests[:remembered], world.period, engine)
    drive.brake_force, braking = actuator_step(drive.brake_force, 0.0, requests[remembered:], world.period, brakes)
    return driving, braking


@inlined
def _catch_up(speed, late):
    """Return the speed (m/s) that a car adds to its plan when it is late by a distance (m)."""
    beyond = late - clip(late, -TOLERATED, TOLERATED)
    return clip(beyond / CATCH_UP, -MOST_CATCH_UP * speed, MOST_CATCH_UP * speed)


@inlined
def _send(command, slot, world, sent):
    """Take a command into those that are on their way; the one that acts from this instant on."""
    for j in range(world.dead_whole + 1, 0, -1):
        sent[slot, j] = sent[slot, j - 1]
    sent[slot, 0] = command
    return sent[slot, world.dead_whole + (1 if world.dead_share > 0.0 else 0)]


@inlined
def actuate(slot, command, run):
    """Write the inputs of a slot's vehicle for the period that begins: steering, drive and brakes, road, wind.

    command: the controller's new one (rad); with a dead time, one before acts.
    """
    drive, block, world = run.memory.drives[slot], run.vehicles.block, run.settings
    signals, scenario, k = run.inputs.signals, run.inputs.scenario[slot], drive.sample
    vx = plants.state_of(block, slot).vx
    place = drive.place if drive.located > 0 else k
    for j in range(plants.ENVIRONMENT):
        sample = signals[scenario, SIGNAL.friction_front_left + j, place]
        block[plants.input_at(PLANT_INPUT.friction_front_left + j, slot)] = sample
    block[plants.input_at(PLANT_INPUT.grade, slot)] = signals[scenario, SIGNAL.grade, place]
    block[plants.input_at(PLANT_INPUT.command, slot)] = (
        _send(command, slot, world, run.memory.sent) + world.steering_bias
    )
    drive.command = command
    if is_prescribed(slot, run):
        _, _, samples = signals.shape
        following = signals[scenario, SIGNAL.speed, min(k + 1, samples - 1)]
        if drive.located > 0:
            following += _catch_up(following, signals[scenario, SIGNAL.station, k] - drive.station)
        block[plants.input_at(PLANT_INPUT.force, slot)], block[plants.input_at(PLANT_INPUT.brake, slot)] = 0.0, 0.0
        block[plants.input_at(PLANT_INPUT.acceleration, slot)] = (following - vx) / world.period
    else:
        if world.prescribed_speed == EXTERNAL_FORCES:
            driving, braking = _move_pedals(drive.requested_force, drive.requested_hold, slot, run)
        else:
            driving, braking = _move_pedals(_drive(slot, run), 0.0, slot, run)
        block[plants.input_at(PLANT_INPUT.force, slot)], block[plants.input_at(PLANT_INPUT.brake, slot)] = (
            driving - braking,
            braking,
        )
        block[plants.input_at(PLANT_INPUT.acceleration, slot)] = math.nan


@inlined
def substeps_around_change(world):
    """Integration steps of a period before and after the next command begins to act in it; world: `LoopSettings`."""
    if not world.dead_share > 0.0:
        return 0, world.substeps
    return (
        max(1, whole(ceil(world.dead_share * world.substeps - 1e-9))),
        max(1, whole(ceil((1.0 - world.dead_share) * world.substeps - 1e-9))),
    )


@inlined
def change_command(slots, run):
    """Let the next command act: with a dead time that is no whole number of periods, within a period."""
    world = run.settings
    for slot in range(slots):
        command = run.memory.sent[slot, world.dead_whole] + world.steering_bias
        run.vehicles.block[plants.input_at(PLANT_INPUT.command, slot)] = command


@inlined
def instants_back(oldest, period):
    """How many instants late sensors look back; oldest: s, age of the oldest sample."""
    return whole(ceil(oldest / period)) + 2 if oldest > 0.0 else 0


@inlined
def turn_steadily(slot, run):
    """Put a car that begins on a bend into its steady turn: slip, yaw rate, wheels, and the commands on their way.

    With v_x, the curvature k of the road and a = v_x^2 k less the pull of the bank: r = v_x k, the wheels stand at
    L k + K a, and the car moves at l_r k - W a to the left of its axis. One of unknown gradients begins straight.
    """
    world, memory, block = run.settings, run.memory, run.vehicles.block
    scenario = run.inputs.scenario[slot]
    road, signals = run.inputs.roads.of[scenario], run.inputs.signals[scenario]
    if road < 0 or math.isnan(world.understeer_gradient):
        return
    _, _, _, curvature = point_at(signals[SIGNAL.station, 0], line_of(road, run.inputs.roads))
    if curvature == 0.0 and signals[SIGNAL.bank, 0] == 0.0:
        return
    vx = plants.state_of(block, slot).vx
    pull = vx * vx * curvature - signals[SIGNAL.bank, 0]
    slip = world.lr * curvature - world.rear_slip_gradient * pull
    angle = (world.lf + world.lr) * curvature + world.understeer_gradient * pull
    angle = clip(angle, -world.steering_limit, world.steering_limit)
    block[plants.state_at(PLANT_STATE.yaw, slot)] -= atan2(slip, 1.0)
    block[plants.state_at(PLANT_STATE.vy, slot)] = vx * slip
    block[plants.state_at(PLANT_STATE.yaw_rate, slot)] = vx * curvature
    for row in range(PLANT_STATE.yaw, PLANT_STATE.yaw_rate + 1):
        run.vehicles.states[slot, row] = block[plants.state_at(row, slot)]
    block[plants.state_at(PLANT_STATE.steering, slot)] = angle if world.steering_lag > 0.0 else 0.0
    block[plants.input_at(PLANT_INPUT.command, slot)] = angle
    memory.sent[slot, :], memory.drives[slot].command = angle, angle


@inlined
def forget(slot, memory):
    """Set the memory of a slot to its values before the first instant: all numbers 0, `RUNNING` and `NOT_ASKED`."""
    _clear(memory.drives[slot])
    memory.sent[slot, :], memory.requested[slot, :] = 0.0, 0.0
    memory.past[slot, :, :] = 0.0

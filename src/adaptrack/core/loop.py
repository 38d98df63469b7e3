"""The pieces of a control period: where the car is, whether its run has failed, sensors, driver, steering.

`period` has them in their order. They take a slot and its run (`period.RunLoop`), in which they read and write by name.
"""

from __future__ import annotations

import math

from .kernel import columns, cube, inlined, local, matrix, record, rows
from .layout import put
from .maths.bits import whole
from .maths.exact import ceil, clip, floor
from .maths.exponential import hypot
from .maths.random import counted_normal, counted_uniform
from .maths.trigonometric import atan2
from .models.contract import MEASUREMENT
from .plants.contract import ENVIRONMENT, OBSERVED, PLANT_INPUT, PLANT_STATE, input_at, observe, state_at
from .plants.forces import wheel_angle
from .road import foot_near, line_of
from .variables import VARIABLE_COLUMNS

LoopSettings = record(
    "LoopSettings",
    (
        "period",  # s
        "substeps",  # Runge-Kutta steps per period
        "prescribed_speed",  # 1: v_x follows the profile exactly, 0: the driver and the powertrain move the vehicle
        "dead_whole", "dead_share",  # periods from an instant until its command acts: whole ones, and the share of one
        "noise_vy", "noise_yaw", "noise_yaw_rate", "noise_y",  # m/s, rad, rad/s, m, standard deviations; inf: no sensor
        "noise_wheel_angle", "noise_lateral_acceleration",  # rad, m/s^2
        "noise_speed",  # -, of the measured speed over the speed
        "bias_yaw_rate", "bias_wheel_angle",  # rad/s, rad: an error of the sensor that stays over a run is within this
        "pose_age", "pose_age_spread", "motion_age",  # s, how old yaw and y are, +- a spread; and the other samples
        "missing",  # -, share of the samples that are missing
        "dropout_pause", "dropout_least", "dropout_most",  # s, mean time between gaps of the pose, which last so long
        "steering_lag", "steering_limit",  # s, rad, of the actuator
        "steering_bias",  # rad, what the wheels are turned beyond the command
        "driver_preview",  # s, how far ahead the driver looks at the speed profile
        "driver_integral",  # 1/s^2, gain on the integral of the speed error
        "mass",  # kg, with which the driver turns acceleration into force
        "engine_power", "traction_limit", "brake_limit",  # W, N, N
        "failure_distance",  # m, a run has failed when |Y - y_ref| exceeds this after it has once been within
        "failure_sideslip",  # rad, or the sideslip angle this
    ),
    integers=("substeps", "prescribed_speed", "dead_whole"),
)  # fmt: skip
"""The world around the controller, fixed over a run."""

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
        "offset", "heading_error",  # m, rad, of the car against the path
        "error",  # m, of the offset against its reference
        "speed",  # m/s, as measured at the present instant
        "station", "heading",  # m, rad, of its foot on a curved road
        "turned",  # rad, see `MEASUREMENT`
        "located",  # 1 once the foot is known
        "place",  # the instant at which the plan is where the car is
    ),
    integers=("instant", "sample", "arrived", "ended", "located", "place"),
)  # fmt: skip
"""What the loop remembers of each slot: its scalars."""

Memory = record("Memory", (("own", rows(LOOP_MEMORY)), ("sent", matrix), ("past", cube)))
"""What the loop remembers of each slot (slots,): its scalars; commands, the latest first (slots, whole periods of dead
time + 2); what there was to measure at the last instants, the latest first (slots, instants, SENSED), empty where all
sensors are prompt."""
SENSED = 6
"""How many of `MEASUREMENT` are measured; the others are their ages."""
_observed = local(len(OBSERVED))
_JITTER, _DROPOUT, _LENGTH, _MISSING, _BIAS = range(5)  # streams of random numbers

RUNNING, OFF_ROAD, SPUN, STATE_NOT_FINITE, NEVER_ARRIVED, STOPPED = range(6)
"""Why a run ended: left its reference, spun, a state that is not finite, never came near; or too dear to go on."""
MIN_SPIN_SPEED = 1.0
"""m/s: below it sideslip is ill-defined, and a vehicle is not said to spin."""

SIGNAL = columns(
    "y_ref", "speed", "friction_front_left", "friction_front_right", "friction_rear_left", "friction_rear_right",
    "wind_x", "wind_y", "bank", "known_friction", "known_wind", "change", "acceleration", "station",
    "grade",
)  # fmt: skip
"""Rows of a scenario's samples. Friction and wind as they are known and the reference preview are scheduling variables;
station is where the plan is on a curved road (m); grade is dz/ds of the road, positive uphill."""
TOLERATED, CATCH_UP, MOST_CATCH_UP = 0.5, 2.0, 0.1
"""m, by which a car may be early or late on its plan; s, in which it makes up for the rest; share of the speed, at
most."""


# -- where the car is -------------------------------------------------------------------------------------------------
@inlined
def locate(slot, run):
    """Find the car on its road: offset and heading error against the path, the foot and the place in the plan."""
    drive, block = run.memory.own[slot], run.vehicles.block
    signals, scenario = run.given.signals, run.given.scenario[slot]
    road = run.given.roads.of[scenario]
    x, y, yaw = (
        block[state_at(PLANT_STATE.x, slot)],
        block[state_at(PLANT_STATE.y, slot)],
        block[state_at(PLANT_STATE.yaw, slot)],
    )
    if road < 0:
        drive.offset, drive.heading_error = y, yaw
        return
    near = signals[scenario, SIGNAL.station, 0]
    if drive.located > 0:
        near = drive.station + block[state_at(PLANT_STATE.vx, slot)] * run.settings.period
    station, offset, heading, _ = foot_near(x, y, near, line_of(road, run.given.roads))
    drive.turned = heading - drive.heading if drive.located > 0 else 0.0
    drive.station, drive.offset, drive.heading, drive.located = station, offset, heading, 1
    turns = (yaw - heading) / (2.0 * math.pi)
    drive.heading_error = 2.0 * math.pi * (turns - floor(turns + 0.5))
    _, _, samples = signals.shape
    last = samples - 1
    while drive.place < last and signals[scenario, SIGNAL.station, drive.place + 1] <= station:
        drive.place += 1
    while drive.place > 0 and signals[scenario, SIGNAL.station, drive.place] > station:
        drive.place -= 1


# -- failure ----------------------------------------------------------------------------------------------------------
@inlined
def judge(slot, run):
    """Why a run has failed at this instant, RUNNING if it has not.

    Not finite: a state. Spun: a sideslip angle |atan2(v_y, v_x)| beyond the limit at 1 m/s or more. Off the road:
    the error against the reference beyond the distance, once the vehicle has arrived within it.
    """
    drive, block, world = run.memory.own[slot], run.vehicles.block, run.settings
    within = abs(drive.error) <= world.failure_distance
    if within:
        drive.arrived = 1
    for row in range(PLANT_STATE.yaw_rate + 1):
        if not math.isfinite(block[state_at(row, slot)]):
            return STATE_NOT_FINITE
    if not math.isfinite(block[state_at(PLANT_STATE.steering, slot)]):
        return STATE_NOT_FINITE
    vx, vy = block[state_at(PLANT_STATE.vx, slot)], block[state_at(PLANT_STATE.vy, slot)]
    if hypot(vx, vy) >= MIN_SPIN_SPEED and abs(atan2(vy, vx)) > world.failure_sideslip:
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
def _keep_past(past, measured):
    """Add what there is to measure now to the instants before."""
    instants, _ = past.shape
    for i in range(instants - 1, 0, -1):
        for j in range(SENSED):
            past[i, j] = past[i - 1, j]
    for j in range(SENSED):
        past[0, j] = measured[j]


@inlined
def _recall(sensor, instants, past):
    """Interpolate the measurable signals so many control instants ago."""
    first = whole(instants)
    near = past[first, sensor]
    return near + (instants - first) * (past[first + 1, sensor] - near)


@inlined
def _make_late(k, world, seed, past, measured):
    """Replace what there is to measure now by what there was, as old as the sensors say."""
    most = float(k)  # nothing is older than the run
    age = max(0.0, world.pose_age + _either(world.pose_age_spread, seed, _JITTER, k))
    _keep_past(past, measured)
    if k == 0:
        for i in range(len(past)):
            for j in range(SENSED):
                past[i, j] = measured[j]
    for sensor in range(SENSED):
        posed = sensor == MEASUREMENT.yaw or sensor == MEASUREMENT.y
        instants = min((age if posed else world.motion_age) / world.period, most)
        measured[sensor] = _recall(sensor, instants, past)
    measured[MEASUREMENT.pose_age] = min(age, most * world.period)
    measured[MEASUREMENT.motion_age] = min(world.motion_age, most * world.period)


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
def sense(slot, run):
    """Write what the sensors of a slot's vehicle give, see `models.contract.MEASURED`, and the measured speed."""
    drive, block, world, measured = run.memory.own[slot], run.vehicles.block, run.settings, run.measured
    k, seed = drive.instant, run.given.seeds[slot]
    if world.noise_lateral_acceleration < math.inf:
        observed = _observed()
        observe(slot, run.vehicles, observed)
        measured[MEASUREMENT.lateral_acceleration] = observed[OBSERVED.lateral_acceleration]
    measured[MEASUREMENT.vy] = block[state_at(PLANT_STATE.vy, slot)]
    measured[MEASUREMENT.yaw] = drive.heading_error
    measured[MEASUREMENT.yaw_rate] = block[state_at(PLANT_STATE.yaw_rate, slot)]
    measured[MEASUREMENT.y] = drive.offset
    measured[MEASUREMENT.turned] = drive.turned
    measured[MEASUREMENT.wheel_angle] = wheel_angle(
        block[state_at(PLANT_STATE.steering, slot)], block[input_at(PLANT_INPUT.command, slot)],
        world.steering_lag, world.steering_limit,
    )  # fmt: skip
    measured[MEASUREMENT.pose_age], measured[MEASUREMENT.motion_age] = 0.0, 0.0
    if run.features.late:
        _make_late(k, world, seed, run.memory.past[slot], measured)
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
    speed = block[state_at(PLANT_STATE.vx, slot)]
    drive.speed = speed + speed * _noisy(0.0, world.noise_speed, k, SENSED, seed) if world.noise_speed > 0.0 else speed


@inlined
def look(slot, measured, run):
    """Write the scheduling variables (`VARIABLE_COLUMNS`) of a slot; measured: see `sense`."""
    drive, signals, scenario, variables = (
        run.memory.own[slot],
        run.given.signals,
        run.given.scenario[slot],
        run.variables,
    )
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
def _drive(k, speed, signals, scenario, settings, drive):
    """Longitudinal force (N) of the driver: aims at the profile's speed a preview time ahead, with an integral.

    dv = (v_ref(t + T_p) - v_x)/T_p + K_i * integral of (v_ref - v_x); limited by engine power, traction and brakes,
    the integral standing still while a limit holds.
    """
    _, _, samples = signals.shape
    last = samples - 1
    ahead = settings.driver_preview / settings.period
    j = min(k + whole(ahead), last)
    part = ahead - floor(ahead)
    near, following = signals[scenario, SIGNAL.speed, j], signals[scenario, SIGNAL.speed, min(j + 1, last)]
    target = near + part * (following - near)
    if drive.located > 0:
        target += _catch_up(target, signals[scenario, SIGNAL.station, k] - drive.station)
    driving_force = settings.mass * (
        (target - speed) / settings.driver_preview + settings.driver_integral * drive.integral
    )
    strongest = min(settings.traction_limit, settings.engine_power / max(speed, 1.0))
    force = clip(driving_force, -settings.brake_limit, strongest)
    if force == driving_force:
        drive.integral += (signals[scenario, SIGNAL.speed, k] - speed) * settings.period
    return force


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
    """Write the inputs of a slot's vehicle for the period that begins: steering, speed control, friction, wind.

    command: the controller's new one (rad); with a dead time, one before acts.
    """
    drive, block, world = run.memory.own[slot], run.vehicles.block, run.settings
    signals, scenario, k = run.given.signals, run.given.scenario[slot], drive.sample
    vx = block[state_at(PLANT_STATE.vx, slot)]
    block[input_at(PLANT_INPUT.command, slot)] = _send(command, slot, world, run.memory.sent) + world.steering_bias
    drive.command = command
    if world.prescribed_speed > 0:
        _, _, samples = signals.shape
        following = signals[scenario, SIGNAL.speed, min(k + 1, samples - 1)]
        if drive.located > 0:
            following += _catch_up(following, signals[scenario, SIGNAL.station, k] - drive.station)
        block[input_at(PLANT_INPUT.force, slot)] = 0.0
        block[input_at(PLANT_INPUT.acceleration, slot)] = (following - vx) / world.period
    else:
        block[input_at(PLANT_INPUT.force, slot)] = _drive(k, vx, signals, scenario, world, drive)
        block[input_at(PLANT_INPUT.acceleration, slot)] = math.nan
    place = drive.place if drive.located > 0 else k
    for j in range(ENVIRONMENT):
        block[input_at(PLANT_INPUT.friction_front_left + j, slot)] = signals[
            scenario, SIGNAL.friction_front_left + j, place
        ]


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
        run.vehicles.block[input_at(PLANT_INPUT.command, slot)] = (
            run.memory.sent[slot, world.dead_whole] + world.steering_bias
        )


@inlined
def memory_sizes(slots, dead_whole, past, table, row):
    """Sizes of the arrays of `Memory`, see `layout`; past: instants that late sensors look back."""
    row = put(table, row, slots)
    row = put(table, row, slots, dead_whole + 2)
    return put(table, row, slots, past, SENSED)


@inlined
def instants_back(oldest, period):
    """How many instants late sensors look back; oldest: s, age of the oldest sample."""
    return whole(ceil(oldest / period)) + 2 if oldest > 0.0 else 0


@inlined
def forget(slot, memory):
    """Back to before the first instant."""
    drive = memory.own[slot]
    drive.instant, drive.sample, drive.arrived, drive.ended = 0, 0, 0, RUNNING
    drive.command, drive.integral, drive.ended_at = 0.0, 0.0, 0.0
    drive.station, drive.turned, drive.located, drive.place, drive.blind_until, drive.speed = 0.0, 0.0, 0, 0, 0.0, 0.0
    memory.sent[slot, :] = 0.0
    memory.past[slot, :, :] = 0.0

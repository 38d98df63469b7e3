"""A car of the simulated world as a unit of co-simulation: a run whose controller and plan are inputs.

A step is what `drive.simulate` does between two steps of a controller, to the bit: the command is sent, the car moves
on by a period, it is sensed. Plan and environment are a window of the signals that begins at the present instant.
"""

from __future__ import annotations

import math

import numpy as np

from ..controllers.part import COMMON_ANSWER
from ..kernel import OK, Field, Place, columns, exported, inlined, int64, int_vector, local, record, vector
from ..maths.bits import whole
from ..maths.trigonometric import cos, sin
from ..models.contract import MEASUREMENT
from ..plants.contract import ENVIRONMENT, MOTION_STATES, OBSERVED, PLANT_STATE, observe, state_at
from ..roads.road import line_of, point_at
from ..simulation.run import RunRecord, begin_slot, roll_on
from ..simulation.world import ANSWERED, RUNNING, SIGNAL, STATE_NOT_FINITE
from .contract import NO_DELAY, UNIT_FAILED, outside

_SPEED, _PLACE, _ANGLE = "[0, 100]", "[-1e8, 1e8]", f"[-{math.pi}, {math.pi}]"
_FRICTION, _WIND, _FORCE = "[0.001, 3]", "[-100, 100]", "[-1e6, 1e6]"
CAR_CONSTANTS = (
    Field("time", "s", 0.0, "of the present instant"),
    Field("period", "s", 0.0, "of a step"),
    Field("speed_preview", "s", 0.0, "how far ahead speed_ahead is planned"),
)
PARAMETERS = (
    Field("seed", "", 0, "of all that the sensors draw: the same number gives the same drive", f"[0, {2**53}]"),
    Field("parallel_exchange", "", False, "true: the master exchanges in parallel, which stands for a period of the "
          "car's own delay", "[0, 1]"),
    Field("start_x", "m", 0.0, "position in the world at the start", _PLACE),
    Field("start_y", "m", 0.0, "position in the world at the start", _PLACE),
    Field("start_yaw", "rad", 0.0, "at the start, from the world's x axis, positive to the left", _PLACE),
    Field("start_speed", "m/s", 0.0, "along the car's axis at the start, in equilibrium", _SPEED),
    Field("start_station", "m", 0.0, "along the road, about which the car's foot is looked for at the start", _PLACE),
)  # fmt: skip
CAR_INPUTS = (
    Field("command", "rad", 0.0, "requested angle of the road wheels, positive to the left", _ANGLE),
    Field("speed", "m/s", 0.0, "planned for this instant", _SPEED),
    Field("speed_ahead", "m/s", 0.0, "planned for the time of speed_preview from now", _SPEED),
    Field("on_plan", "", False, "true: a car that is early or late against plan_station drives a little slower or "
          "faster", "[0, 1]"),
    Field("plan_station", "m", 0.0, "along the road, where the plan is at this instant", _PLACE),
    *(Field(f"friction_{wheel}", "", 0.9, "coefficient under the wheel", _FRICTION)
      for wheel in ("front_left", "front_right", "rear_left", "rear_right")),
    *(Field(f"wind_{axis}", "m/s", 0.0, "velocity of the air in the world", _WIND) for axis in "xy"),
    Field("bank", "m/s^2", 0.0, "what the pull of a banked road adds to dv_y/dt, positive to the left", "[-10, 10]"),
    Field("grade", "", 0.0, "dz/ds of the road, positive uphill", "[-0.4, 0.4]"),
    Field("force", "N", 0.0, "requested at the wheels, positive forward; acts in a car that is exported for a speed "
          "control", _FORCE),
    Field("hold", "N", 0.0, "of the brakes in addition to the force; acts in a car that is exported for a speed "
          "control", "[0, 1e6]"),
)  # fmt: skip
CAR_OUTPUTS = (
    Field("measured_x", "m", 0.0, "measured position in the world, measured_pose_age ago; NaN: missing"),
    Field("measured_y", "m", 0.0, "measured position in the world, measured_pose_age ago; NaN: missing"),
    Field("measured_yaw", "rad", 0.0, "measured yaw angle, measured_pose_age ago, positive to the left; NaN: missing"),
    Field("measured_offset", "m", 0.0, "from the road, measured_pose_age ago, positive to the left; NaN: missing"),
    Field("measured_heading_error", "rad", 0.0, "measured_yaw less the road's heading; NaN: missing"),
    Field("measured_pose_age", "s", 0.0, "how old measured position and yaw are"),
    Field("measured_speed", "m/s", 0.0, "measured speed along the car's axis, measured_speed_age ago"),
    Field("measured_vy", "m/s", 0.0, "lateral velocity, measured_motion_age ago, positive to the left; NaN: missing"),
    Field("measured_yaw_rate", "rad/s", 0.0, "measured_motion_age ago, positive to the left; NaN: missing"),
    Field("measured_wheel_angle", "rad", 0.0, "of the road wheels, measured_motion_age ago; NaN: missing"),
    Field("measured_lateral_acceleration", "m/s^2", 0.0, "of an accelerometer, measured_motion_age ago; NaN: missing"),
    Field("measured_motion_age", "s", 0.0, "how old measured vy, yaw rate, wheel angle and lateral acceleration are"),
    Field("x", "m", 0.0, "true position of the centre of mass in the world"),
    Field("y", "m", 0.0, "true position of the centre of mass in the world"),
    Field("yaw", "rad", 0.0, "true yaw angle, from the world's x axis, positive to the left"),
    Field("vx", "m/s", 0.0, "true velocity along the car's axes, x forward, y to the left"),
    Field("vy", "m/s", 0.0, "true velocity along the car's axes, x forward, y to the left"),
    Field("yaw_rate", "rad/s", 0.0, "true yaw rate, positive to the left"),
    Field("wheel_angle", "rad", 0.0, "true angle of the road wheels, positive to the left"),
    Field("lateral_acceleration", "m/s^2", 0.0, "true lateral acceleration, positive to the left"),
    Field("station", "m", 0.0, "along the road, of the car's foot on it, over all laps; without a road x"),
    Field("offset", "m", 0.0, "true distance from the road, positive to the left; without a road y"),
    Field("heading_error", "rad", 0.0, "true yaw angle less the road's heading"),
    Field("ended", "", 0, "0, or 2 once the car has spun"),
    Field("measured_speed_age", "s", 0.0, "how old the measured speed is"),
)  # fmt: skip
CAR_VALUE = columns(*CAR_CONSTANTS, *PARAMETERS, *CAR_INPUTS, *CAR_OUTPUTS)
"""The values of a car."""
_PARAMETER, _INPUT = CAR_VALUE.seed, CAR_VALUE.command
_OUTPUT = _INPUT + len(CAR_INPUTS)

CarUnit = record(
    "CarUnit",
    (
        ("values", vector), ("kinds", int_vector), ("least", vector), ("most", vector), ("run", RunRecord),
    ),
)  # fmt: skip
"""A unit of co-simulation (see `contract`), its values by `CAR_VALUE`; the run: one slot, one scenario, whose signals
are as many samples as the driver looks ahead."""

_observed = local(len(OBSERVED))
_MEASURED = ("pose_age", "vy", "yaw_rate", "wheel_angle", "lateral_acceleration", "motion_age")
_SOURCES = np.array([(getattr(MEASUREMENT, name), getattr(CAR_VALUE, f"measured_{name}")) for name in _MEASURED])
"""(signals, 2): places of a measured signal among what is measured, and among the values."""


@inlined
def _open_window(car):
    """Write what is planned and what surrounds the car to the signals from now on."""
    values, signals, drive = car.values, car.run.inputs.signals, car.run.memory.drives[0]
    signals[0, SIGNAL.speed, :] = values[CAR_VALUE.speed_ahead]
    signals[0, SIGNAL.speed, 0] = values[CAR_VALUE.speed]
    signals[0, SIGNAL.station, :] = math.inf  # the plan, whose place is the first sample, is not looked for
    signals[0, SIGNAL.station, 0] = values[CAR_VALUE.plan_station] if values[CAR_VALUE.on_plan] > 0.5 else drive.station
    for j in range(ENVIRONMENT):
        signals[0, SIGNAL.friction_front_left + j, 0] = values[CAR_VALUE.friction_front_left + j]
    signals[0, SIGNAL.grade, 0] = values[CAR_VALUE.grade]
    friction = 0.0  # the driver knows its mean
    for j in range(4):
        friction += values[CAR_VALUE.friction_front_left + j]
    signals[0, SIGNAL.known_friction, 0] = friction / 4.0


@inlined
def _go_on(car):
    """Go on to the next instant, and write the outputs there; the status."""
    values, run = car.values, car.run
    drive, block, measured = run.memory.drives[0], run.vehicles.block, run.measured[0]
    roll_on(2, 1, run)
    if drive.ended == STATE_NOT_FINITE:
        return UNIT_FAILED
    if drive.ended != RUNNING:
        values[CAR_VALUE.ended] = float(drive.ended)
    offset, error, station = measured[MEASUREMENT.y], measured[MEASUREMENT.yaw], drive.pose_station
    x, y, heading = station, 0.0, 0.0
    if drive.located > 0:
        x, y, heading, _ = point_at(station, line_of(run.inputs.roads.of[0], run.inputs.roads))
    values[CAR_VALUE.measured_x], values[CAR_VALUE.measured_y] = x - sin(heading) * offset, y + cos(heading) * offset
    values[CAR_VALUE.measured_yaw] = heading + error
    values[CAR_VALUE.measured_offset], values[CAR_VALUE.measured_heading_error] = offset, error
    values[CAR_VALUE.measured_speed], values[CAR_VALUE.measured_speed_age] = drive.speed, drive.speed_age
    for i in range(len(_SOURCES)):
        values[_SOURCES[i, 1]] = measured[_SOURCES[i, 0]]
    for j in range(MOTION_STATES):
        values[CAR_VALUE.x + j] = block[state_at(j, 0)]
    observed = _observed()
    observe(0, run.vehicles, observed)
    values[CAR_VALUE.lateral_acceleration] = observed[OBSERVED.lateral_acceleration]
    values[CAR_VALUE.wheel_angle] = observed[OBSERVED.wheel_angle]
    values[CAR_VALUE.station] = drive.station if drive.located > 0 else values[CAR_VALUE.x]
    values[CAR_VALUE.offset], values[CAR_VALUE.heading_error] = drive.offset, drive.heading_error
    values[CAR_VALUE.time] = float(drive.instant) * run.settings.period
    return OK


@exported(int64(Place(CarUnit)))
def car_begin(car):
    """Read the parameters, put the car at its start and sense it; the status."""
    values, run = car.values, car.run
    invalid = outside(_PARAMETER, _OUTPUT, values, car.least, car.most)
    if invalid != OK:
        return invalid
    if values[CAR_VALUE.parallel_exchange] > 0.5 and run.settings.dead_whole == 0:
        return NO_DELAY
    run.inputs.seeds[0] = whole(values[CAR_VALUE.seed])
    start = run.vehicles.start
    start[0, PLANT_STATE.x], start[0, PLANT_STATE.y] = values[CAR_VALUE.start_x], values[CAR_VALUE.start_y]
    start[0, PLANT_STATE.yaw], start[0, PLANT_STATE.vx] = values[CAR_VALUE.start_yaw], values[CAR_VALUE.start_speed]
    _open_window(car)
    run.inputs.signals[0, SIGNAL.station, 0] = values[CAR_VALUE.start_station]
    begin_slot(0, run)
    values[CAR_VALUE.ended] = float(RUNNING)
    return _go_on(car)


@exported(int64(Place(CarUnit)))
def car_step(car):
    """Send the command, move on by a period and sense; the status.

    With a parallel exchange the command is that of the instant before. It takes the place that it would have in the
    car's own delay, of which a period is left out.
    """
    values, run = car.values, car.run
    invalid = outside(_INPUT, _OUTPUT, values, car.least, car.most)
    if invalid != OK:
        return invalid
    command, drive = values[CAR_VALUE.command], run.memory.drives[0]
    drive.requested_force, drive.requested_hold = values[CAR_VALUE.force], values[CAR_VALUE.hold]
    if values[CAR_VALUE.parallel_exchange] > 0.5:
        run.memory.sent[0, 0] = command
    _open_window(car)
    run.controller.answer[0, COMMON_ANSWER.command] = command
    drive.caller_state, drive.ended = ANSWERED, RUNNING
    return _go_on(car)

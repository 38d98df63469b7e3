"""A controller with its tracker as a unit of co-simulation: a sample in, a command and what it is worth out.

A step is a call of the tracker at the present instant (`core.tracker.step`), to the bit.
"""

from __future__ import annotations

import math

from ..kernel import OK, Place, columns, exported, inlined, int64, int_vector, local, record, vector
from ..maths.bits import whole
from ..road import CLOSED
from ..speed_plan import planned_speeds
from ..tracker.records import TRACKED, TRACKER_SAMPLE
from ..tracker.step import Tracking, tracker_step
from ..tracker.take_call import tracker_engage
from .contract import outside

STEERING_CONSTANTS = (
    "time",  # s, of the present instant
    "period",  # s, of a step
    "expected_delay",  # s, from a sample until its command acts, as expected; an exchange in parallel is a period of it
)
PARAMETERS = (
    "start_wheel_angle",  # rad, of the road wheels at the start, positive to the left: the first command is near it
    "speed_preview",  # s, how far ahead planned_speed_ahead is planned; that of the car
)
STEERING_INPUTS = (
    "x", "y",  # m, m: position of the centre of mass in the world of the path
    "yaw",  # rad, yaw angle, from the world's x axis, positive to the left, wrapped or not
    "speed",  # m/s, along the car's axis, negative backwards
    "yaw_rate",  # rad/s, positive to the left
    "vy",  # m/s, lateral velocity, positive to the left
    "lateral_acceleration",  # m/s^2, positive to the left, without the pull of a bank
    "wheel_angle",  # rad, of the road wheels, positive to the left
    "age",  # s, how old the sample is
    "friction",  # -, coefficient of tyre and road, for a schedule
    "wind",  # m/s, velocity of the air to the left, for a schedule
    "pose_known",  # true: position and yaw angle are measured at this instant; a NaN is not known either
    "yaw_rate_known",  # true: yaw_rate is measured
    "vy_known",  # true: vy is measured
    "lateral_acceleration_known",  # true: lateral_acceleration is measured
    "wheel_angle_known",  # true: wheel_angle is measured
    "friction_known",  # true: friction is known
    "wind_known",  # true: wind is known
    "motion_age",  # s, how old speed, yaw_rate, vy, lateral_acceleration and wheel_angle are
    "motion_age_known",  # true: motion_age is used, and age belongs to the pose; false: age belongs to the whole sample
    "grade",  # -, dz/ds of the road under the car, positive uphill, for a speed control
    "grade_known",  # true: grade is measured; false: a speed control takes that of its plan
)  # fmt: skip
STEERING_OUTPUTS = (
    "command",  # rad, requested angle of the road wheels, positive to the left
    "status",  # 0 ok, 1 estimated, 2 held, 3 standing, 4 reverse, 5 off path, 6 end of path, 7 sliding
    "offset",  # m, of the car from the path, positive to the left; NaN without a position to go by
    "heading_error",  # rad, the car's heading less the path's; NaN without a position to go by
    "station",  # m, arc length of the car's foot on the path, over all laps; NaN without a position to go by
    "belief_state",  # of what is learned: 0 learning, 1 settled, 2 at the end of a range, 3 contradictory; -1 nothing
    "belief_at_bound",  # which learned quantity is at the end of its range, 0 none, -1 nothing is learned
    "suspect",  # sum of 1, 2, 4, ...: inputs that contradict each other
    "planned_speed",  # m/s, planned where the car is; without a plan the present speed
    "planned_speed_ahead",  # m/s, planned where the car will be after speed_preview
)  # fmt: skip
SPEED_OUTPUTS = (
    "acceleration",  # m/s^2, requested dv/dt along the road, without gravity
    "force",  # N, requested at the wheels, positive forward
    "hold",  # N, of the brakes in addition to the force: pressure that holds the car at rest
    "target_speed",  # m/s, where the request acts
    "grip_used",  # -, acceleration of the car over what the assumed friction gives
    "speed_state",  # 0 off, 1 driving, 2 stopping, 3 stopped, 4 emergency; see core.speed_control
    "limited_by",  # 0 plan, 1 comfort, 2 grip, 3 stop, 4 path end, 5 fault, 6 driver, ...: core.speed_control
    "friction_low", "friction_high",  # -, -: ends of the interval of the friction, as narrowed so far
)  # fmt: skip
"""Outputs of a unit with speed control, behind the others."""
STEERING_VALUE = columns(*STEERING_CONSTANTS, *PARAMETERS, *STEERING_INPUTS, *STEERING_OUTPUTS)
"""The values of a controller."""
SPEED_VALUE = columns(*STEERING_VALUE._fields, *SPEED_OUTPUTS)
"""The values of a controller with speed control."""
_PARAMETER, _INPUT = STEERING_VALUE.start_wheel_angle, STEERING_VALUE.x

_places = local(2)
SteeringUnit = record(
    "SteeringUnit",
    (("values", vector), ("kinds", int_vector), ("least", vector), ("most", vector), ("tracking", Tracking)),
)
"""A unit of co-simulation (see `contract`): its values by `STEERING_VALUE`, with a speed control by `SPEED_VALUE`."""


@inlined
def _value_if(value, flag):
    return value if flag > 0.5 else math.nan


@inlined
def _write_sample(values, sample):
    """Write the inputs as a call of the tracker."""
    pose = values[STEERING_VALUE.pose_known]
    time = values[STEERING_VALUE.time]
    age = values[STEERING_VALUE.age]
    sample[TRACKER_SAMPLE.t], sample[TRACKER_SAMPLE.now] = time - (age if math.isfinite(age) else 0.0), time
    sample[TRACKER_SAMPLE.x], sample[TRACKER_SAMPLE.y] = (
        _value_if(values[STEERING_VALUE.x], pose),
        _value_if(values[STEERING_VALUE.y], pose),
    )
    sample[TRACKER_SAMPLE.yaw], sample[TRACKER_SAMPLE.speed] = (
        _value_if(values[STEERING_VALUE.yaw], pose),
        values[STEERING_VALUE.speed],
    )
    sample[TRACKER_SAMPLE.yaw_rate] = _value_if(values[STEERING_VALUE.yaw_rate], values[STEERING_VALUE.yaw_rate_known])
    sample[TRACKER_SAMPLE.vy] = _value_if(values[STEERING_VALUE.vy], values[STEERING_VALUE.vy_known])
    sample[TRACKER_SAMPLE.lateral_acceleration] = _value_if(
        values[STEERING_VALUE.lateral_acceleration], values[STEERING_VALUE.lateral_acceleration_known]
    )
    sample[TRACKER_SAMPLE.wheel_angle] = _value_if(
        values[STEERING_VALUE.wheel_angle], values[STEERING_VALUE.wheel_angle_known]
    )
    sample[TRACKER_SAMPLE.friction] = _value_if(values[STEERING_VALUE.friction], values[STEERING_VALUE.friction_known])
    sample[TRACKER_SAMPLE.wind] = _value_if(values[STEERING_VALUE.wind], values[STEERING_VALUE.wind_known])
    sample[TRACKER_SAMPLE.motion_t] = time - _value_if(
        values[STEERING_VALUE.motion_age], values[STEERING_VALUE.motion_age_known]
    )
    sample[TRACKER_SAMPLE.grade] = _value_if(values[STEERING_VALUE.grade], values[STEERING_VALUE.grade_known])


@inlined
def _write_outputs(tracker, values):
    """Write the outputs."""
    tracked = tracker.tracked
    values[STEERING_VALUE.command], values[STEERING_VALUE.status] = tracked[TRACKED.command], tracked[TRACKED.status]
    values[STEERING_VALUE.offset], values[STEERING_VALUE.heading_error] = (
        tracked[TRACKED.offset],
        tracked[TRACKED.heading_error],
    )
    values[STEERING_VALUE.station], values[STEERING_VALUE.suspect] = tracked[TRACKED.station], tracked[TRACKED.suspect]
    values[STEERING_VALUE.belief_state] = tracked[TRACKED.belief_state]
    values[STEERING_VALUE.belief_at_bound] = tracked[TRACKED.belief_at_bound]
    _write_planned_speeds(tracker, values)


@inlined
def _write_planned_speeds(tracker, values):
    """Write the planned speeds; where the car is not known they stay."""
    plan, places = tracker.plan, _places()
    speed = max(values[STEERING_VALUE.speed], 0.0)
    places[0] = places[1] = speed
    if plan.s.size > 1:
        lap = plan.s[plan.s.size - 1] if tracker.path.numbers[0, CLOSED] > 0.5 else 0.0
        places[0] = values[STEERING_VALUE.station]
        places[1] = places[0] + speed * values[STEERING_VALUE.speed_preview]
        planned_speeds(lap, plan.s, plan.speed, places)
    for i in range(2):
        if math.isfinite(places[i]):
            values[STEERING_VALUE.planned_speed + i] = places[i]


@exported(int64(Place(SteeringUnit)))
def steering_begin(unit):
    """Read the parameters and engage; the status."""
    values, tracker = unit.values, unit.tracking.tracker
    invalid = outside(_PARAMETER, _INPUT, values, unit.least, unit.most)
    if invalid != OK:
        return invalid
    tracker_engage(values[STEERING_VALUE.start_wheel_angle], math.nan, tracker)
    values[STEERING_VALUE.time] = 0.0
    _write_outputs(tracker, values)
    return OK


@exported(int64(Place(SteeringUnit)))
def steering_step(unit):
    """Call the tracker with the inputs, write its outputs, and go on by a period; the status."""
    tracking, values = unit.tracking, unit.values
    _write_sample(values, tracking.tracker.sample)
    tracker_step(tracking)
    if tracking.control_speed != 0:
        _write_requests(tracking.longitudinal, values)
    _write_outputs(tracking.tracker, values)
    period = values[STEERING_VALUE.period]
    values[STEERING_VALUE.time] = (whole(values[STEERING_VALUE.time] / period + 0.5) + 1) * period
    return OK


@inlined
def _write_requests(longitudinal, values):
    """Write the requests of the speed control."""
    memory, friction = longitudinal.memory[0], longitudinal.friction.memory[0]
    values[SPEED_VALUE.acceleration], values[SPEED_VALUE.force] = memory.acceleration, memory.force
    values[SPEED_VALUE.hold], values[SPEED_VALUE.target_speed] = memory.hold, memory.target_speed
    values[SPEED_VALUE.grip_used] = memory.grip_used
    values[SPEED_VALUE.speed_state], values[SPEED_VALUE.limited_by] = float(memory.state), float(memory.limited_by)
    values[SPEED_VALUE.friction_low], values[SPEED_VALUE.friction_high] = friction.low, friction.high

"""A controller with its tracker as a unit of co-simulation: a sample in, a command and what it is worth out.

A step is a call of the tracker at the present instant (`core.tracker.step`), to the bit.
"""

from __future__ import annotations

import math

import numpy as np

from ..kernel import OK, Field, Place, columns, exported, fields_of, inlined, int64, int_vector, local, record, vector
from ..maths.bits import whole
from ..roads.road import CLOSED
from ..speed.plan import planned_speeds
from ..speed.speed_control import SPEED_REQUEST
from ..tracker.longitudinal import write_requests
from ..tracker.signals import TRACKED, TRACKER_SAMPLE, sample_of
from ..tracker.step import Tracking, tracker_predict, tracker_step
from ..tracker.take_call import tracker_engage
from .contract import outside

STEERING_CONSTANTS = (
    Field("time", "s", 0.0, "of the present instant"),
    Field("period", "s", 0.0, "of a step"),
    Field("expected_delay", "s", 0.0, "from a sample until its command acts, as expected; an exchange in parallel is a "
          "period of it"),
)  # fmt: skip
PARAMETERS = (
    Field("start_wheel_angle", "rad", 0.0, "of the road wheels at the start, positive to the left: the first command "
          "is near it", f"[-{math.pi / 2}, {math.pi / 2}]"),
    Field("speed_preview", "s", 0.0, "how far ahead planned_speed_ahead is planned; that of the car", "[0, 10]"),
)  # fmt: skip
INPUT_NAMES = {"lateral_velocity": "vy"}
"""Names of inputs that differ from those of the tracker's signals: as of the car's outputs."""
_SIGNALS = [field._replace(name=INPUT_NAMES.get(field.name, field.name)) for field in fields_of(TRACKER_SAMPLE)]


def _flag(field: Field) -> Field:
    """The input that tells whether a signal is measured."""
    return Field(f"{field.name}_known", "", False, f"true: {field.name} is measured")


_LATER = [
    Field("motion_age", "s", 0.0, "how old speed and all other signals of the motion are: age then is the pose's"),
    *_SIGNALS[TRACKER_SAMPLE.grade :],
]
STEERING_INPUTS = (
    *_SIGNALS[TRACKER_SAMPLE.x : TRACKER_SAMPLE.friction],
    Field("age", "s", 0.0, "how old the sample is"),
    *_SIGNALS[TRACKER_SAMPLE.friction : TRACKER_SAMPLE.motion_time],
    Field("pose_known", "", False, "true: position and yaw angle are measured; a NaN is not known either"),
    *map(_flag, _SIGNALS[TRACKER_SAMPLE.yaw_rate : TRACKER_SAMPLE.motion_time]),
    *(value for field in _LATER for value in (field, _flag(field))),
)
"""An optional signal has a flag. The first ones stand before their flags, each later one before its own. Longitudinal
acceleration and driver are no inputs."""
STEERING_OUTPUTS = (
    *fields_of(TRACKED)[: TRACKED.first_top_speed],
    Field("planned_speed", "m/s", 0.0, "planned where the car is; without a plan the present speed"),
    Field("planned_speed_ahead", "m/s", 0.0, "planned where the car will be after speed_preview"),
)
SPEED_OUTPUTS = fields_of(SPEED_REQUEST)
"""Outputs of a unit with speed control, behind the others."""
PREDICTION_OUTPUTS = (
    Field("predicted_count", "", 0, "points of the path on which the car is expected; 0: there is no prediction"),
    Field("predicted_delay", "s", 0.0, "from the sample to the first of these points; the others are a period apart"),
    Field("predicted_x", "m", 0.0, "expected position of the centre of mass in the world; NaN behind predicted_count"),
    Field("predicted_y", "m", 0.0, "expected position of the centre of mass in the world; NaN behind predicted_count"),
)
"""Outputs of a unit that predicts, the last of all; x and y are arrays, one number for each instant of the horizon."""
STEERING_VALUE = columns(*STEERING_CONSTANTS, *PARAMETERS, *STEERING_INPUTS, *STEERING_OUTPUTS)
"""The values of a controller."""
SPEED_VALUE = columns(*fields_of(STEERING_VALUE), *SPEED_OUTPUTS)
"""The values of a controller with speed control."""
_PARAMETER, _INPUT = STEERING_VALUE.start_wheel_angle, STEERING_VALUE.x

_PLACES = {field.name: place for place, field in enumerate(_SIGNALS)}
_FLAGS = {name: f"{name}_known" for name in _PLACES if f"{name}_known" in STEERING_VALUE._fields}
_FLAGS |= dict.fromkeys(("x", "y", "yaw"), "pose_known")
_SOURCES = np.array(
    [(_PLACES[name], getattr(STEERING_VALUE, name), getattr(STEERING_VALUE, flag)) for name, flag in _FLAGS.items()]
)
"""(signals, 3): places of an optional signal in the sample and among the values, and of its flag."""

_places = local(2)
SteeringUnit = record(
    "SteeringUnit",
    (
        ("values", vector), ("kinds", int_vector), ("least", vector), ("most", vector), ("tracking", Tracking),
        ("points", vector),  # x and y (m), in turn, of the predicted path; empty without predictions
    ),
)  # fmt: skip
"""A unit of co-simulation (see `contract`): its values by `STEERING_VALUE`, with a speed control by `SPEED_VALUE`, then
`PREDICTION_OUTPUTS`."""


@inlined
def _value_if(value, flag):
    return value if flag > 0.5 else math.nan


@inlined
def _write_sample(values, sample):
    """Write the inputs as a call of the tracker."""
    time, age, call = values[STEERING_VALUE.time], values[STEERING_VALUE.age], sample_of(sample, 0)
    call.t, call.now, call.speed = time - (age if math.isfinite(age) else 0.0), time, values[STEERING_VALUE.speed]
    call.motion_time = time - _value_if(values[STEERING_VALUE.motion_age], values[STEERING_VALUE.motion_age_known])
    for i in range(len(_SOURCES)):
        sample[_SOURCES[i, 0]] = _value_if(values[_SOURCES[i, 1]], values[_SOURCES[i, 2]])


@inlined
def _write_outputs(tracker, values):
    """Write the outputs; where the car is not known the planned speeds stay."""
    for i in range(TRACKED.first_top_speed):
        values[STEERING_VALUE.command + i] = tracker.tracked[i]
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


@inlined
def _write_prediction(values, points, tracking):
    """Write the predicted path to the end of the values."""
    horizon = points.size // 2
    if horizon == 0:
        return
    count, delay = tracker_predict(tracking, points)
    outputs = values[values.size - 2 * horizon - 2 :]
    outputs[0], outputs[1] = count, delay
    for i in range(horizon):
        x, y = points[2 * i], points[2 * i + 1]
        outputs[2 + i] = x if i < count else math.nan
        outputs[2 + horizon + i] = y if i < count else math.nan


@inlined
def engage(values, least, most, points, tracking):
    """Read the parameters and engage; the status. points: as in `SteeringUnit`."""
    tracker = tracking.tracker
    invalid = outside(_PARAMETER, _INPUT, values, least, most)
    if invalid != OK:
        return invalid
    tracker_engage(values[STEERING_VALUE.start_wheel_angle], math.nan, tracker)
    values[STEERING_VALUE.time] = 0.0
    _write_outputs(tracker, values)
    _write_prediction(values, points, tracking)
    return OK


@inlined
def make_step(values, points, tracking):
    """Call the tracker with the inputs, write its outputs, and go on by a period. points: as in `SteeringUnit`."""
    _write_sample(values, tracking.tracker.sample)
    tracker_step(tracking)
    if tracking.control_speed != 0:
        write_requests(tracking.longitudinal, values, SPEED_VALUE.acceleration)
    _write_outputs(tracking.tracker, values)
    _write_prediction(values, points, tracking)
    period = values[STEERING_VALUE.period]
    values[STEERING_VALUE.time] = (whole(values[STEERING_VALUE.time] / period + 0.5) + 1) * period


@exported(int64(Place(SteeringUnit)))
def steering_begin(unit):
    """Read the parameters and engage; the status."""
    return engage(unit.values, unit.least, unit.most, unit.points, unit.tracking)


@exported(int64(Place(SteeringUnit)))
def steering_step(unit):
    """Call the tracker with the inputs, write its outputs, and go on by a period; the status."""
    make_step(unit.values, unit.points, unit.tracking)
    return OK

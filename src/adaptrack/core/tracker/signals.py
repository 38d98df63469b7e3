"""Signals of a tracker, each defined once: the sample of a call, its answer, and its status.

From these tables follow the checks and the row of `control.tracker.Tracker.step`, the C structs, the variables of an
FMU and the columns of a log. A new signal is one more `Field` at the end of its table.
"""

from __future__ import annotations

import math

import numpy as np

from ..kernel import Field, columns, fields_of, record, viewer

MAX_POSITION, MAX_SIGNAL = 1e8, 1e3
"""m, from the origin; SI units: no position, and no speed, rate, acceleration or angle of a car is as large: what is
counts as not measured."""
_POSITION, _SIGNAL = (f"(-{limit:g}, {limit:g})" for limit in (MAX_POSITION, MAX_SIGNAL))

TRACKER_SAMPLE = columns(
    Field("t", "s", math.nan, "when the pose was taken, and the motion without a time of its own"),
    Field("now", "s", math.nan, "of the call, on the same clock; NaN: t"),
    Field("x", "m", math.nan, "of the centre of mass, in the world of the path", _POSITION),
    Field("y", "m", math.nan, "of the centre of mass, in the world of the path", _POSITION),
    Field("yaw", "rad", math.nan, "from the world's x axis, positive to the left, wrapped or not", _POSITION),
    Field("speed", "m/s", math.nan, "along the car's axis, negative backwards", _SIGNAL),
    Field("yaw_rate", "rad/s", math.nan, "positive to the left", _SIGNAL),
    Field("lateral_velocity", "m/s", math.nan, "of the centre of mass, positive to the left", _SIGNAL),
    Field("lateral_acceleration", "m/s^2", math.nan, "positive to the left, without the pull of a bank", _SIGNAL),
    Field("wheel_angle", "rad", math.nan, "of the road wheels, positive to the left; the first command is near it",
          _SIGNAL),
    Field("friction", "", math.nan, "of tyre and road, for a schedule and for the prediction in bends"),
    Field("wind", "m/s", math.nan, "of the air to the left, for a controller with a schedule"),
    Field("motion_time", "s", math.nan, "when speed and all other signals of the motion were taken; NaN: t"),
    Field("longitudinal_acceleration", "m/s^2", math.nan, "dv/dt without gravity, for a speed control", _SIGNAL),
    Field("driver", "", False, "1: a driver uses the pedals, for a speed control: it learns nothing, and its requests "
          "follow the motion of the car; 0 or NaN: no driver does"),
    Field("grade", "", math.nan, "dz/ds under the car, positive uphill, for a speed control: for requests and learning "
          "it replaces that of the plan; NaN: the plan's", "[-0.4, 0.4]"),
)  # fmt: skip
"""A call. What is not known is NaN; what is beyond its bounds is made NaN in `tracker_take`."""
MEASURED = TRACKER_SAMPLE._fields[TRACKER_SAMPLE.x : TRACKER_SAMPLE.friction]
"""Signals of the pose and the motion of a car, which every controller may use."""
TrackerSample = record("TrackerSample", fields_of(TRACKER_SAMPLE))
sample_of = viewer(TrackerSample)
"""A call as a record."""


def _limit(field: Field) -> float:
    """Magnitude from which a value counts as not measured; NaN: none."""
    high = field.ends[1]
    return math.nan if not field.bounds else high * (1.0 + 2.0**-52) if field.bounds.endswith("]") else high


SAMPLE_LIMITS = np.array([_limit(field) for field in fields_of(TRACKER_SAMPLE)])
"""(len(TRACKER_SAMPLE),), magnitudes from which a value counts as not measured; NaN: none."""

_STATUSES = {
    "ok": "a new position was used; a call between two instants has the status of the last one",
    "estimated": "no new position, or none to be believed: the command is that of the estimate",
    "held": "no position yet or for too long, no solution, or the car turns against its commands: the command before "
            "is held; stop the car, or steer by hand",
    "standing": "the car stands, its wheels stay at rest",
    "reverse": "the car drives backwards, which no controller here can: the wheels are left where they are",
    "off_path": "further from the path than `furthest`, or without a foot on it within 400 m of the last one (the "
                "offset is then NaN): a command is given all the same; stop the car, or give another path",
    "end": "beyond the end of an open path: it goes on straight; stop the car, or give another path",
    "sliding": "the car slides or spins, its sideslip is beyond 8.5 degrees and more than a rolling turn has: a "
               "command is given all the same, by a model that knows no sliding; slow down",
    "repeated": "at the time of the call before, or earlier: left out, the command is the same",
    "no_time": "neither t nor now is a time: left out",
}  # fmt: skip
STATUS = columns(*(Field(name, "", 0, meaning) for name, meaning in _STATUSES.items()))
"""What a call was."""
FOLLOWING, ESTIMATED, HELD, STANDS, REVERSE, OFF_PATH, BEYOND_END, CAR_SLIDES, REPEATED, NO_TIME = STATUS
NO_BELIEF = -1.0
"""The state of a belief where nothing is learned."""

TRACKED = columns(
    Field("command", "rad", math.nan, "angle of the road wheels to ask for, positive to the left; always finite"),
    Field("status", "", 0, ", ".join(f"{i} {name.replace('_', ' ')}" for i, name in enumerate(_STATUSES))),
    Field("offset", "m", math.nan, "of the car from the path, positive to the left; NaN without a position to go by"),
    Field("heading_error", "rad", math.nan, "the car's heading less the path's; NaN without a position to go by"),
    Field("station", "m", math.nan, "arc length of the car's foot on the path, over all laps; NaN without a position "
          "to go by"),
    Field("belief_state", "", 0, "of what is learned of the car: 0 learning, 1 settled, 2 at the end of a range, "
          "3 contradictory; -1 where nothing is learned"),
    Field("belief_at_bound", "", 0, "the learned quantity at the end of its range: 1 lag, 2 dead time, 3 stiffness, "
          "4 balance, 5 bias; 0 none, -1 where nothing is learned"),
    Field("suspect", "", 0, "sum of 1, 2, 4, ...: inputs that contradict each other, since the tracker engaged"),
    Field("first_top_speed", "m/s", math.nan, "below which to drive until the controller has learned its car; then, "
          "and without learning, infinite"),
    Field("late", "s", math.nan, "behind the times of the planned trajectory, negative: early; NaN without one"),
    Field("driven_by", "", 0, "0 nobody or a path without times, 1 planner, 2 its fallback, 3 nobody: the car stops"),
)  # fmt: skip
"""What a call gives."""

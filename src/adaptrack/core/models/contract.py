"""What a prediction model is to the controller: x(k+1) = A x(k) + B u(k) + E w(k), y(k) = C x(k).

A model is one compiled function; its size n, its output row C (n,) and the measured quantities that its states are
(`MEASUREMENT`, by place) stand beside it. u: steering command (rad); w: known input, curvature of the road times speed
(rad/s), which is zero on a straight road.

The sensors of a simulated car are defined here as well; a standard deviation of inf: no such sensor.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

from ..kernel import Caller, Field, columns, float64, matrix, vector, void
from ..member import member

MEASUREMENT = columns(
    "vy", "yaw", "yaw_rate", "y", "wheel_angle",  # m/s, rad, rad/s, m, rad: the states of a model are some of these
    "lateral_acceleration",  # m/s^2, of an accelerometer: it does not feel the pull of a banked road
    "pose_age", "motion_age",  # s, how old yaw and y are, and all others
    "turned",  # rad, heading of the path at the foot of the car now less that of a period ago
    "friction",  # of the road, that may be assumed at least; 0: unknown
)  # fmt: skip
"""What a controller is given; a missing signal is not finite. On a curved road yaw and y count from the path."""

PERIOD_FIELD = Field("period", "s", 0.05, "control period", "[1e-4, 10]")

DISCRETISE = void(float64, float64, vector, matrix, vector, vector)
"""``discretise(speed, period, parameters, a, b, e)``: write A (n, n), B (n,) and E (n,) of one control period (s) at a
speed (m/s, > 0)."""
call_discretise = Caller(DISCRETISE)


@lru_cache(maxsize=64)
def compile_model(function: Any) -> Any:
    """A user's function as a member of `DISCRETISE`."""
    return member(function, DISCRETISE)


_OFFSET = "each run draws one"
_NOISE = "standard deviation of the measured"
MEASURED_MOTION = (
    Field("noise_vy", "m/s", 0.0, f"{_NOISE} lateral velocity; inf: no such sensor", "[0, inf]"),
    Field("noise_yaw", "rad", 0.0, f"{_NOISE} yaw angle", "[0, inf]"),
    Field("noise_yaw_rate", "rad/s", 0.0, f"{_NOISE} yaw rate", "[0, inf]"),
    Field("noise_y", "m", 0.0, f"{_NOISE} lateral position", "[0, inf)"),
    Field("noise_wheel_angle", "rad", 0.0, f"{_NOISE} front-wheel angle", "[0, inf]"),
    Field("noise_lateral_acceleration", "m/s^2", math.inf, f"{_NOISE} lateral acceleration; inf: no such sensor",
          "[0, inf]"),
    Field("bias_yaw_rate", "rad/s", 0.0, f"largest constant offset of the measured yaw rate; {_OFFSET}", "[0, inf)"),
    Field("bias_wheel_angle", "rad", 0.0, f"largest constant offset of the measured wheel angle; {_OFFSET}",
          "[0, inf)"),
)  # fmt: skip
"""Sensors that the steering uses."""
SENSOR_FIELDS = (
    *MEASURED_MOTION,
    Field("noise_speed", "", 0.0, f"{_NOISE} speed, as a share of the speed", "[0, 1]"),
    Field("pose_age", "s", 0.0, "mean age of yaw and y when they arrive", "[0, 2]"),
    Field("pose_age_spread", "s", 0.0, "largest deviation of pose_age; the controller receives the age of each sample",
          "[0, 2]"),
    Field("motion_age", "s", 0.0, "mean age of yaw rate, lateral velocity and acceleration when they arrive",
          "[0, 2]"),
    Field("missing", "", 0.0, "share of the samples that are missing", "[0, 1)"),
    Field("dropout_pause", "s", 0.0, "mean pause between two dropouts of yaw and y; 0: no dropouts", "[0, inf)"),
    Field("dropout_least", "s", 0.0, "shortest dropout of yaw and y", "[0, 60]"),
    Field("dropout_most", "s", 0.0, "longest dropout of yaw and y", "[0, 60]"),
    Field("noise_station", "m", 0.0, f"{_NOISE} position along the road", "[0, 100]"),
    Field("station_age", "s", 0.0, "mean age of the position along the road (pose_age_spread applies); 0: none",
          "[0, 2]"),
    Field("noise_speed_floor", "m/s", 0.0, "standard deviation of a noise of the speed in addition to noise_speed",
          "[0, 10]"),
    Field("speed_resolution", "m/s", 0.0, "measured speeds are multiples of it; 0: continuous", "[0, 5]"),
    Field("speed_dead_zone", "m/s", 0.0, "lower speeds are measured as 0", "[0, 5]"),
    Field("speed_age", "s", 0.0, "mean age of the measured speed, which varies by motion_age_spread", "[0, 2]"),
    Field("motion_age_spread", "s", 0.0, "largest deviation of motion_age; controllers receive each age", "[0, 2]"),
)  # fmt: skip
"""All sensors: noise, ages and dropouts."""

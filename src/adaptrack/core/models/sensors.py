"""The sensors of a simulated car, each number defined once; a standard deviation of inf: no such sensor."""

from __future__ import annotations

import math

from ..kernel import Field

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

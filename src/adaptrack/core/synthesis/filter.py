"""The numbers of the Kalman filter (`estimators.kalman`) of a car with its sensors."""

from __future__ import annotations

import math

from ..estimators import kalman
from ..kernel import (
    Field,
    Row,
    copier,
    default_setter,
    defaults,
    exported,
    float64,
    inlined,
    int64,
    record,
    several,
    vector,
    void,
)
from ..maths.bits import whole
from ..maths.exact import floor, sqrt, square
from ..models.car import CarRow, SingleTrackCar
from .car import wind_turn
from .tuning import ControllerWorld

_LEAST = kalman.memory_size(0, 0)
_EACH, _LATE = kalman.memory_size(1, 0) - _LEAST, kalman.memory_size(0, 1) - _LEAST
MAX_SAMPLE_AGE, MAX_LEARNED_DEAD_TIME = 2.0, 5.0
"""s, largest age of a sample that is taken in, and largest dead time that may be learned."""
_NO_SENSOR = "inf: no such sensor"
Noise = record("Noise", (
    Field("vy", "m/s", 0.05, "of the lateral velocity", "[0, inf]", _NO_SENSOR),
    Field("yaw", "rad", 0.003, "of the yaw angle", "[0, inf]", _NO_SENSOR),
    Field("yaw_rate", "rad/s", 0.01, "of the yaw rate", "[0, inf]", _NO_SENSOR),
    Field("y", "m", 0.03, "of the lateral position", "[0, inf)",
          "without a measured lateral position there is no path tracking"),
    Field("wheel_angle", "rad", math.inf, "of the road wheels' angle", "[0, inf]", _NO_SENSOR),
    Field("lateral_acceleration", "m/s^2", math.inf, "of an accelerometer at the centre of gravity", "[0, inf]",
            _NO_SENSOR),
    Field("yaw_rate_offset", "rad/s", 0.0, "of a constant error of the yaw rate; 0: none is estimated", "[0, inf]"),
))  # fmt: skip
"""Standard deviations of the sensors, as the filter takes them in; the defaults are those of the profile `road`."""
DriftsRow = record("DriftsRow", (
    Field("vy", "m/s", 0.03, "of the lateral velocity", "[0, inf)"),
    Field("yaw", "rad", 0.001, "of the yaw angle", "[0, inf)"),
    Field("yaw_rate", "rad/s", 0.015, "of the yaw rate", "[0, inf)"),
    Field("y", "m", 0.01, "of the lateral position", "[0, inf)"),
    Field("wheel_angle", "rad", 0.01, "of the road wheels' angle", "[0, inf)"),
    Field("side", "m/s^2", 0.03, "of the lateral disturbance d_y: side wind, bank, a steering bias", "[0, inf)"),
    Field("turn", "rad/s^2", 0.05, "of the yaw disturbance d_r", "[0, inf)"),
    Field("wind", "m/s^2", 0.35, "of the part of d_y that side wind adds; it adds to d_r in proportion to the car's "
          "body", "[0, inf)"),
    Field("yaw_rate_offset", "rad/s", 0.0002, "of the offset of the yaw-rate sensor", "[0, inf)"),
    Field("sliding", "s^0.5", 0.2, "of the impulse of an axle over F^2/F_z, with F its force in the model and F_z "
          "its load. In the brush model sliding takes F^2/(3 mu F_z) away (Pacejka, Tire and Vehicle Dynamics, "
          "3rd ed., section 3.2), and mu is unknown", "[0, inf)"),
    Field("sliding_time", "s", 0.3, "duration of such a deviation: it moves an accelerometer by "
          "sliding F^2/F_z/(m sqrt(2 sliding_time))", "(0, inf)"),
    Field("grip", "m/s^2", 7.0, "largest pull of the tyres: disturbances are bounded by it, less the pull of the "
          "model", "[0, inf)"),
    Field("least_spare", "m/s^2", 0.5, "smallest bound of the disturbances", "(0, inf)"),
))  # fmt: skip
"""How fast the estimates may change beyond the model: standard deviations of random walks after one second."""
Filter = record("Filter", (
    ("noise", Noise), ("drifts", DriftsRow),
    Field("bound", "", 5.0, "standard deviations up to which an innovation counts, so that no outlier moves the "
          "estimate further", "(0, inf]", "inf: no bound"),
    Field("spread", "", (0.3, 0.3), "standard deviations of d_y (m/s^2) and d_r (rad/s^2) before the first sample",
          "[0, inf)"),
    Field("oldest", "s", 0.0, "age up to which samples are taken in where they belong", f"[0, {MAX_SAMPLE_AGE:g}]"),
    Field("patience", "s", 3.0, "for which the estimate continues without a measured position, before the "
          "controller holds", "[0, inf]", "inf: for ever"),
    Field("settling", "s", 10.0, "over which the offsets of accelerometer and wheel-angle sensor are averaged",
          "(0, inf]", "inf: no averaging"),
    Field("distrust", "", 10.0, "a sensor other than the pose is left out while the mean of its squared innovations "
          "over their variance, 1 for a correct filter, exceeds this", "(0, inf]", "inf: no sensor is left out"),
    Field("trust", "", 2.0, "the sensor is taken in again below this mean", "(0, inf]"),
    Field("window", "s", (0.5, 5.0), "over which that mean is taken: of a sensor in use, of one that is left out",
          "(0, inf)"),
    Field("friction", "", 0.9, "assumed friction of the tyres: in bends they pull less than linear ones",
          "(0, inf)"),
    Field("shape_factor", "", 1.3, "C of the tyres' Magic Formula; passenger-car tyres have C near 1.3 (Pacejka, "
          "Tire and Vehicle Dynamics, 3rd ed., section 4.3)", "(1, 2)"),
    Field("longest", "s", 0.0, "dead time that the model may be given while driving",
          f"[0, {MAX_LEARNED_DEAD_TIME:g}]"),
))  # fmt: skip
"""A Kalman filter of a path model."""
DEFAULT_DRIFTS = defaults(DriftsRow)
_copy_single_track, set_filter_defaults = copier(SingleTrackCar), default_setter(Filter)


@exported(void(Row(ControllerWorld), Row(Noise)))
def sensor_noise(world, noise):
    """Write the noise of a loop's sensors, as a filter knows them.

    A wheel-angle sensor that is off, or without noise, is left out: the model knows the angle better, or as well. An
    offset of the yaw rate within +- b has the standard deviation b/sqrt(3).
    """
    noise.vy, noise.yaw, noise.yaw_rate, noise.y = world.noise_vy, world.noise_yaw, world.noise_yaw_rate, world.noise_y
    off = world.bias_wheel_angle > 0.0 or world.noise_wheel_angle == 0.0
    noise.wheel_angle = math.inf if off else world.noise_wheel_angle
    noise.lateral_acceleration = world.noise_lateral_acceleration
    noise.yaw_rate_offset = world.bias_yaw_rate / sqrt(3.0)


@exported(several(int64, float64)(float64, float64))
def split_periods(time, period):
    """A time (s) in whole periods (s), and the share of one more."""
    whole_periods = floor(time / period + 1e-9)
    share = time / period - whole_periods
    return whole(whole_periods), share if share > 1e-9 else 0.0


@exported(void(Row(Noise), vector))
def sensor_variances(noise, variances):
    """Write the variances (6,) of the sensors, see `kalman.LEAST_NOISE`; inf: none."""
    least = kalman.LEAST_NOISE
    variances[0], variances[1] = square(max(noise.vy, least[0])), square(max(noise.yaw, least[1]))
    variances[2], variances[3] = square(max(noise.yaw_rate, least[2])), square(max(noise.y, least[3]))
    variances[4] = square(max(noise.wheel_angle, least[4]))
    variances[5] = square(max(noise.lateral_acceleration, least[5]))


@inlined
def _push_drift(drifts, car):
    """Variances of d_y and of d_r that a second adds, and their covariance: side wind pushes and turns."""
    turned = drifts.wind * wind_turn(car)
    return (
        square(drifts.side) + drifts.wind * drifts.wind, square(drifts.turn) + turned * turned, drifts.wind * turned,
    )  # fmt: skip


@exported(several(int64, int64)(Row(Filter), float64, float64))
def filter_periods(filtering, period, dead_time):
    """Whole periods of the longest dead time (s), and those that are gone through anew for late samples."""
    most = max(floor(dead_time / period + 1e-9), floor(filtering.longest / period + 1e-9))
    return whole(most), whole(floor(filtering.oldest / period + 0.5))


@exported(int64(int64, int64))
def filter_size(longest, late):
    """Numbers that the filter remembers, see `filter_periods`."""
    return _LEAST + _EACH * longest + _LATE * late


@exported(void(Row(Filter), Row(CarRow), float64, float64, float64, Row(kalman.FilterParameters)))
def filter_numbers(filtering, car, period, lag, dead_time, p):
    """Write the parameters of the filter for the path model with a lag and a dead time (s)."""
    drifts, noise = filtering.drifts, filtering.noise
    p.period, p.bias = period, 0.0
    whole_periods, p.share = split_periods(dead_time, period)
    longest, late = filter_periods(filtering, period, dead_time)
    p.periods, p.longest, p.late = float(whole_periods), float(longest), float(late)
    p.bound, p.patience = filtering.bound, filtering.patience / period
    p.distrust, p.trust = filtering.distrust, filtering.trust
    p.forgetting = min(1.0, period / filtering.window[0])
    p.regaining = min(1.0, period / filtering.window[1])
    p.settling = min(1.0, period / filtering.settling)
    sensor_variances(noise, p.variance)
    if not lag > 0.0:
        p.variance[4] = math.inf  # no such state
    side, turn, both = _push_drift(drifts, car)
    at = kalman.FILTER_STATE
    p.drift[at.vy], p.drift[at.yaw] = square(drifts.vy) * period, square(drifts.yaw) * period
    p.drift[at.yaw_rate], p.drift[at.y] = square(drifts.yaw_rate) * period, square(drifts.y) * period
    p.drift[at.wheel_angle] = square(drifts.wheel_angle) * period if lag > 0.0 else 0.0
    p.drift[at.side], p.drift[at.turn], p.drift_both = side * period, turn * period, both * period
    p.drift[at.offset] = square(drifts.yaw_rate_offset) * period if noise.yaw_rate_offset > 0.0 else 0.0
    p.sliding, p.sliding_time = square(drifts.sliding), drifts.sliding_time
    p.grip, p.least_spare = drifts.grip, drifts.least_spare
    p.friction, p.shape_factor = filtering.friction, filtering.shape_factor
    p.spread_side, p.spread_turn = square(filtering.spread[0]), square(filtering.spread[1])
    p.spread_offset = square(noise.yaw_rate_offset)
    _copy_single_track(car, p.model)
    p.model.lag = lag

"""The numbers of the Kalman filter (`estimators.kalman`) of a car with its sensors."""

from __future__ import annotations

import math

from ..estimators import kalman
from ..kernel import Row, exported, float64, inlined, int64, record, several, vector, void
from ..maths.bits import whole
from ..maths.exact import floor, sqrt, square
from .car import Car, wind_turn
from .tuning import World

_LEAST = kalman.memory_size(0, 0)
_EACH, _LATE = kalman.memory_size(1, 0) - _LEAST, kalman.memory_size(0, 1) - _LEAST
NOISE = ("vy", "yaw", "yaw_rate", "y", "wheel_angle", "lateral_acceleration")
"""The sensors, as the filter takes them in."""
Noise = record("Noise", (*NOISE, "yaw_rate_offset"))
"""m/s, rad, rad/s, m, rad, m/s^2, rad/s: standard deviations; inf: there is no such sensor. The last: of an error of
the yaw rate that stays, 0: there is none."""
Drifts = record(
    "Drifts",
    (
        "vy", "yaw", "yaw_rate", "y", "wheel_angle",  # m/s, rad, rad/s, m, rad
        "side", "turn", "wind",  # m/s^2, rad/s^2, m/s^2
        "yaw_rate_offset",  # rad/s
        "sliding", "sliding_time",  # s^0.5, s
        "grip", "least_spare",  # m/s^2
    ),
)  # fmt: skip
"""How fast what is estimated may change beside the model, see `adaptrack.control.kalman.Drifts`."""
Filter = record(
    "Filter",
    (
        ("noise", Noise), ("drifts", Drifts),
        "bound",  # standard deviations up to which an innovation counts
        "spread_side", "spread_turn",  # m/s^2, rad/s^2: of the disturbances before the first sample
        "oldest",  # s, of a sample that is taken in
        "patience", "settling",  # s
        "distrust", "trust",  # mean of squared innovations over their variance
        "window_taken_in", "window_left_out",  # s, over which that mean is taken
        "friction", "shape_factor",  # of the tyres
        "longest",  # s, dead time that the model may be given while driving
    ),
)  # fmt: skip
"""A filter, see `adaptrack.control.kalman.KalmanFilter`."""

USUAL_NOISE = Noise(0.05, 0.003, 0.01, 0.03, math.inf, math.inf, 0.0)
USUAL_DRIFTS = Drifts(
    vy=0.03, yaw=0.001, yaw_rate=0.015, y=0.01, wheel_angle=0.01, side=0.03, turn=0.05, wind=0.35,
    yaw_rate_offset=0.0002, sliding=0.2, sliding_time=0.3, grip=7.0, least_spare=0.5,
)  # fmt: skip
USUAL = Filter(
    noise=USUAL_NOISE, drifts=USUAL_DRIFTS, bound=5.0, spread_side=0.3, spread_turn=0.3, oldest=0.0, patience=3.0,
    settling=10.0, distrust=10.0, trust=2.0, window_taken_in=0.5, window_left_out=5.0, friction=0.9, shape_factor=1.3,
    longest=0.0,
)  # fmt: skip
"""What is taken where nobody says."""
_USUAL = tuple(map(float, (*USUAL_NOISE, *USUAL_DRIFTS, *USUAL[2:])))


@exported(void(vector))
def usual_filter(numbers):
    """Write `USUAL` to the numbers of a `Filter`."""
    for i in range(len(_USUAL)):
        numbers[i] = _USUAL[i]


@exported(void(Row(World), Row(Noise)))
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
def in_periods(time, period):
    """A time (s) in whole periods (s), and the share of one more."""
    whole_periods = floor(time / period + 1e-9)
    share = time / period - whole_periods
    return whole(whole_periods), share if share > 1e-9 else 0.0


@inlined
def _variance(deviation, least):
    return square(max(deviation, least))


@exported(void(Row(Noise), vector))
def sensor_variances(noise, found):
    """Write the variances (6,) of the sensors, see `kalman.LEAST_NOISE`; inf: none."""
    least = kalman.LEAST_NOISE
    found[0], found[1] = _variance(noise.vy, least[0]), _variance(noise.yaw, least[1])
    found[2], found[3] = _variance(noise.yaw_rate, least[2]), _variance(noise.y, least[3])
    found[4] = _variance(noise.wheel_angle, least[4])
    found[5] = _variance(noise.lateral_acceleration, least[5])


@exported(several(float64, float64, float64)(Row(Drifts), Row(Car)))
def push_drift(drifts, car):
    """Variances of d_y and of d_r that a second adds, and their covariance: side wind pushes and turns."""
    turned = drifts.wind * wind_turn(car)
    return (
        square(drifts.side) + drifts.wind * drifts.wind, square(drifts.turn) + turned * turned, drifts.wind * turned,
    )  # fmt: skip


@exported(several(int64, int64)(Row(Filter), float64, float64))
def filter_periods(own, period, dead_time):
    """Whole periods of the longest dead time (s), and those that are gone through anew for late samples."""
    most = max(floor(dead_time / period + 1e-9), floor(own.longest / period + 1e-9))
    return whole(most), whole(floor(own.oldest / period + 0.5))


@exported(int64(int64, int64))
def filter_size(longest, late):
    """Numbers that the filter remembers, see `filter_periods`."""
    return _LEAST + _EACH * longest + _LATE * late


@exported(void(Row(Filter), Row(Car), float64, float64, float64, vector))
def filter_numbers(own, car, period, lag, dead_time, numbers):
    """Write `kalman.Numbers` for the path model with a lag and a dead time (s)."""
    p = kalman.parameters_of(numbers, 0)
    drifts, noise = own.drifts, own.noise
    p.period, p.bias = period, 0.0
    whole_periods, p.share = in_periods(dead_time, period)
    longest, late = filter_periods(own, period, dead_time)
    p.whole, p.longest, p.late = float(whole_periods), float(longest), float(late)
    p.bound, p.patience, p.distrust, p.trust = own.bound, own.patience / period, own.distrust, own.trust
    p.forgetting = min(1.0, period / own.window_taken_in)
    p.regaining = min(1.0, period / own.window_left_out)
    p.settling = min(1.0, period / own.settling)
    sensor_variances(noise, p.variance)
    if not lag > 0.0:
        p.variance[4] = math.inf  # no such state
    side, turn, both = push_drift(drifts, car)
    at = kalman.STATE
    p.drift[at.vy], p.drift[at.yaw] = square(drifts.vy) * period, square(drifts.yaw) * period
    p.drift[at.yaw_rate], p.drift[at.y] = square(drifts.yaw_rate) * period, square(drifts.y) * period
    p.drift[at.wheel_angle] = square(drifts.wheel_angle) * period if lag > 0.0 else 0.0
    p.drift[at.side], p.drift[at.turn], p.drift_both = side * period, turn * period, both * period
    p.drift[at.offset] = square(drifts.yaw_rate_offset) * period if noise.yaw_rate_offset > 0.0 else 0.0
    p.sliding, p.sliding_time = square(drifts.sliding), drifts.sliding_time
    p.grip, p.least_spare = drifts.grip, drifts.least_spare
    p.friction, p.shape_factor = own.friction, own.shape_factor
    p.spread_side, p.spread_turn = square(own.spread_side), square(own.spread_turn)
    p.spread_offset = square(noise.yaw_rate_offset)
    c = p.model
    c.mass, c.yaw_inertia, c.lf, c.lr = car.mass, car.yaw_inertia, car.lf, car.lr
    c.stiffness_front, c.stiffness_rear, c.lag = car.stiffness_front, car.stiffness_rear, lag

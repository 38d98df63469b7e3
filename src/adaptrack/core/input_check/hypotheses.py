"""The hypotheses of each comparison: honest values, and the mistakes that are known.

Rows of `HYPOTHESES` are: 0 for an honest value, else 1 + the place of the mistake in `MISTAKES`; then up to three
parameters.
"""

from __future__ import annotations

import itertools
import math

import numpy as np

from .record import COMPARED, MISTAKES

DEGREE = math.pi / 180.0
_HONEST = -1
NEAR_ONE = (0.85, 0.95, 1.0, 1.05, 1.15)
_NONE = (0.0,)


def _clocks(late):
    """Of a rate that is summed: gain, and delay in s."""
    return [
        (_HONEST, NEAR_ONE, (-0.06, -0.03, 0.0, 0.03, 0.06)),
        (late, (0.95, 1.0, 1.05), (-0.25, -0.2, -0.15, 0.15, 0.2, 0.25)),
    ]


_WAY = [
    *_clocks(MISTAKES.speed_late),
    (MISTAKES.speed_in_km_h, (1 / 3.6,), _NONE),
    (MISTAKES.speed_in_miles_h, (0.447,), _NONE),
    (MISTAKES.speed_unit, (0.1, 0.6, 1.6, 2.2, 3.6, 10.0), _NONE),
]
_COURSE = [
    (_HONEST, (0.35, 0.5, 0.7, 0.85, 1.0, 1.2)),
    (MISTAKES.y_mirrored, (-1.0,)),
    (MISTAKES.yaw_in_degrees, (DEGREE,)),
]
_TURN = [
    _clocks(MISTAKES.yaw_late)[0],
    (MISTAKES.yaw_rate_sign, (-1.0,), _NONE),
    (MISTAKES.yaw_in_degrees_by_its_rate, (40.0, 57.3), _NONE),
    (MISTAKES.yaw_rate_in_degrees, (DEGREE,), _NONE),
    (MISTAKES.yaw_rate_unit, (0.1, 0.5, 2.0, 5.0, 10.0), _NONE),
]
_PULL = [
    (_HONEST, (0.5, 0.7, 1.0, 1.4, 1.8)),
    (MISTAKES.lateral_acceleration_sign, (-1.0,)),
    (MISTAKES.lateral_acceleration_in_g, (1 / 9.81,)),
]
_SLIPS = (0.3, 0.6, 1.0, 1.6, 2.5)
"""Of the rear tyres, over what is believed."""
_POINT = [  # shares of lr and lf that the point is ahead of the rear axle
    (_HONEST, (0.75, 1.0, 1.25), _NONE, _SLIPS),
    (MISTAKES.position_of_rear_axle, _NONE, _NONE, _SLIPS),
    (MISTAKES.position_of_front_axle, (1.0,), (1.0,), _SLIPS),
]
_LATERAL = [  # gain of v_y; shares of lr and lf that the point is ahead of the centre of mass
    (_HONEST, (0.8, 1.0, 1.2), (-0.3, 0.0, 0.3), _NONE),
    (MISTAKES.lateral_velocity_sign, (-1.0,), _NONE, _NONE),
    (MISTAKES.position_of_rear_axle, (1.0,), (-1.0,), _NONE),
    (MISTAKES.position_of_front_axle, (1.0,), _NONE, (1.0,)),
]
_TOO_SMALL = (MISTAKES.command_too_small, (0.0, DEGREE, 0.05))
_TOO_LARGE = (MISTAKES.command_too_large, (0.25, 0.4, 0.6, 0.8, 1.0, 1.25, 1.6))  # of wheels that are thrown about
_WHEEL = [
    (_HONEST, NEAR_ONE),
    (MISTAKES.wheel_angle_sign, (-1.0,)),
    (MISTAKES.wheel_angle_in_degrees, (57.3,)),
    (MISTAKES.wheel_angle_of_steering_wheel, (11.0, 14.0, 17.0, 20.0)),
    _TOO_SMALL,
    (MISTAKES.command_too_large, (0.7, 0.85, 1.0)),
]
GAINS = (0.25, 0.4, 0.6, 0.8, 1.0, 1.25, 1.6, 2.2, 3.2)
"""Of turning over what the believed car's steering asks for, that need not surprise."""
_AGAINST = (MISTAKES.steering_sign, (-0.4, -0.7, -1.0, -1.5, -2.5))
_KNOWN_CAR = [
    (_HONEST, GAINS),
    _TOO_SMALL,
    _TOO_LARGE,
    _AGAINST,
]
_UNKNOWN_CAR = [(_HONEST, (0.02, 0.05, 0.1, *GAINS, 6.0, 12.0, 24.0, 50.0)), _AGAINST]

_ALL = (_WAY, _COURSE, _TURN, _PULL, _POINT, _LATERAL, _WHEEL, _KNOWN_CAR, _UNKNOWN_CAR)
_rows = [[(1.0 + label, *each) for label, *grid in some for each in itertools.product(*grid)] for some in _ALL]
HYPOTHESES = np.array([(*row, 0.0, 0.0, 0.0)[:4] for some in _rows for row in some])
FIRST = tuple(itertools.accumulate((len(some) for some in _rows), initial=0))
"""Where the hypotheses of each comparison (`COMPARED`) begin; behind them those of the steering of an unknown car."""
UNKNOWN_STEERING = len(COMPARED)

"""The hypotheses of every comparison: honest values, and known mistakes; and how much evidence a mistake needs.

A comparison is a regression y = b1 x1 + b2 x2 + b3 x3 + intercept. Some have alternatives, whose regressors differ:
delays of the steering, or shifts of a clock. A hypothesis is a triple (b1, b2, b3) and the alternatives that it is for.
"""

from __future__ import annotations

import itertools
import math

import numpy as np

from ..kernel import columns
from .record import BANKS, COMPARED, DELAYS, GRAMS_OF, MISTAKES, SHIFTS, THROWN

DEGREE = math.pi / 180.0
EVIDENCE, SURE = 12.0, 5.0
"""Twice the logarithm of the likelihood ratio by which a mistake must beat every honest value; the same where other
measurements point to the mistake."""
HYPOTHESIS = columns("label", "b1", "b2", "b3", "first", "end", "evidence")
"""A row of `HYPOTHESES`. label: 0 for an honest value, else 1 + the place in `MISTAKES`; it applies to the alternatives
from first to before end."""
_HONEST = -1
_ALL = (0, BANKS * DELAYS)
_HONEST_WHEELS = (0, THROWN)
_TIMES_4, _TIMES_57 = (THROWN, THROWN + DELAYS), (THROWN + DELAYS, BANKS * DELAYS)
_NONE, _ONE = (0.0,), (1.0,)
NEAR_ONE = (0.85, 0.95, 1.0, 1.05, 1.15)
_AGREE, _APART = 1, 3
"""Shifts up to which clocks agree, and from which they are apart."""


def _rows(label, *grids, alternatives=_ALL, evidence=EVIDENCE):
    """Every combination of b1, b2 and b3 from their grids, as rows of `HYPOTHESES`."""
    grids = (*grids, _NONE, _NONE)[:3]
    return [(1.0 + label, *values, *alternatives, evidence) for values in itertools.product(*grids)]


_NEAR_CLOCKS = _rows(_HONEST, NEAR_ONE, (-0.06, -0.03, 0.0, 0.03, 0.06))  # gain; delay in s of a rate that is summed
_WAY = [
    *_NEAR_CLOCKS,
    *_rows(MISTAKES.speed_late, (0.95, 1.0, 1.05), (-0.25, -0.2, -0.15, 0.15, 0.2, 0.25)),
    *_rows(MISTAKES.speed_in_km_h, (1 / 3.6,)),
    *_rows(MISTAKES.speed_in_miles_h, (0.447,)),
    *_rows(MISTAKES.speed_unit, (0.1, 0.6, 1.6, 2.2, 3.6, 10.0)),
]
_MIRRORED = 4.0  # evidence where the course turns against the yaw: nothing honest looks like it
_COURSE = [
    *_rows(_HONEST, (0.35, 0.5, 0.7, 0.85, 1.0, 1.2)),
    *_rows(MISTAKES.y_mirrored, (-1.0,), evidence=_MIRRORED),
    *_rows(MISTAKES.yaw_in_degrees, (DEGREE,), evidence=_MIRRORED),
]
_TURN = [
    *_NEAR_CLOCKS,
    *_rows(MISTAKES.yaw_rate_sign, (-1.0,)),
    *_rows(MISTAKES.yaw_in_degrees_by_its_rate, (40.0, 57.3)),
    *_rows(MISTAKES.yaw_rate_in_degrees, (DEGREE,)),
    *_rows(MISTAKES.yaw_rate_unit, (0.1, 0.5, 2.0, 5.0, 10.0)),
]
_PULL = [
    *_rows(_HONEST, (0.5, 0.7, 1.0, 1.4, 1.8)),
    *_rows(MISTAKES.lateral_acceleration_sign, (-1.0,), evidence=5.0 * EVIDENCE),
    *_rows(MISTAKES.lateral_acceleration_in_g, (1 / 9.81,), evidence=5.0 * EVIDENCE),
]
_SLIPS = (0.3, 0.6, 1.0, 1.6, 2.5)  # of the rear tyres, relative to those of the car file
_POINT = [  # shares of lr and lf by which the point is ahead of the rear axle; slip
    *_rows(_HONEST, (0.75, 1.0, 1.25), _NONE, _SLIPS),
    *_rows(MISTAKES.position_of_rear_axle, _NONE, _NONE, _SLIPS),
    *_rows(MISTAKES.position_of_front_axle, _ONE, _ONE, _SLIPS),
]
_LATERAL = [  # gain of v_y; shares of lr and lf by which the point is ahead of the centre of mass
    *_rows(_HONEST, (0.8, 1.0, 1.2), (-0.3, 0.0, 0.3)),
    *_rows(MISTAKES.lateral_velocity_sign, (-1.0,)),
    *_rows(MISTAKES.position_of_rear_axle, _ONE, (-1.0,)),
    *_rows(MISTAKES.position_of_front_axle, _ONE, _NONE, _ONE),
]
# Steering: the gain of what the commands ask for, and what was in force before the first command.
_SWING = 1.5 * EVIDENCE  # a controller that begins to learn its car swings it, too
_WHEEL = [
    *_rows(_HONEST, NEAR_ONE, _ONE, alternatives=_HONEST_WHEELS),
    *_rows(MISTAKES.wheel_angle_sign, (-1.0,), _ONE, alternatives=_HONEST_WHEELS),
    *_rows(MISTAKES.wheel_angle_in_degrees, (57.3,), _ONE, alternatives=_HONEST_WHEELS),
    *_rows(MISTAKES.wheel_angle_of_steering_wheel, (11.0, 14.0, 17.0, 20.0), _ONE, alternatives=_HONEST_WHEELS),
    *_rows(MISTAKES.command_too_small, (0.0, DEGREE, 0.0625, 0.25), _ONE, alternatives=_HONEST_WHEELS),
    *_rows(MISTAKES.command_too_large, (0.85, 1.0, 1.2), _ONE, alternatives=_TIMES_4),
    *_rows(MISTAKES.command_too_large, (0.7, 0.85, 1.0), _ONE, alternatives=_TIMES_57),
]
GAINS = (0.25, 0.4, 0.6, 0.8, 1.0, 1.25, 1.6, 2.2, 3.2)
"""Honest ratios of the car's turning to that of a steady turn of the car file."""
_AGAINST = _rows(
    MISTAKES.steering_sign, (-0.4, -0.7, -1.0, -1.5, -2.5), _ONE, alternatives=_HONEST_WHEELS, evidence=1.3 * EVIDENCE
)
_KNOWN_CAR = [
    *_rows(_HONEST, GAINS, _ONE, alternatives=_HONEST_WHEELS),
    *_rows(MISTAKES.command_too_small, (0.0, DEGREE, 0.05), _ONE, alternatives=_HONEST_WHEELS, evidence=_SWING),
    *_rows(MISTAKES.command_too_large, (0.6, 0.8, 1.0, 1.25, 1.6), _ONE, alternatives=_TIMES_4, evidence=_SWING),
    *_rows(MISTAKES.command_too_large, GAINS[:7], _ONE, alternatives=_TIMES_57, evidence=_SWING),
    *_AGAINST,
]
_WIDE_GAINS = (0.02, 0.05, 0.1, *GAINS, 6.0, 12.0, 24.0, 50.0)
_UNKNOWN_CAR = [*_rows(_HONEST, _WIDE_GAINS, _ONE, alternatives=_HONEST_WHEELS), *_AGAINST]
_CENTRE = SHIFTS // 2
_CLOCK = [
    *_rows(_HONEST, NEAR_ONE, alternatives=(_CENTRE - _AGREE, _CENTRE + _AGREE + 1)),
    *_rows(MISTAKES.yaw_late, NEAR_ONE[1:4], alternatives=(0, _CENTRE - _APART + 1)),
    *_rows(MISTAKES.yaw_late, NEAR_ONE[1:4], alternatives=(_CENTRE + _APART, SHIFTS)),
]
_FORWARD = [  # the signal less dv/dt, over dv/dt
    *_rows(_HONEST, (-0.2, -0.1, 0.0, 0.1, 0.2)),
    *_rows(MISTAKES.longitudinal_acceleration_sign, (-1.9, -2.0, -2.1), evidence=SURE),
    *_rows(MISTAKES.longitudinal_acceleration_in_g, (1 / 9.81 - 1.0,), evidence=SURE),
]
_TABLES = (_WAY, _COURSE, _TURN, _PULL, _POINT, _LATERAL, _WHEEL, _KNOWN_CAR, _CLOCK, _FORWARD, _UNKNOWN_CAR)
HYPOTHESES = np.array([row for table in _TABLES for row in table])
FIRST = tuple(itertools.accumulate(map(len, _TABLES), initial=0))
"""Where the hypotheses of each comparison (`COMPARED`) begin; after them those of the steering of an unknown car."""
UNKNOWN_STEERING = len(COMPARED)
LEAST_EVIDENCE = tuple(
    min(row[HYPOTHESIS.evidence] for row in table if row[HYPOTHESIS.label] > 0.0) for table in _TABLES
)
FIRST_GRAM = tuple(itertools.accumulate(GRAMS_OF, initial=0))
"""Where the sums of each comparison's alternatives begin."""

RULE = columns("overlap", "intercept", "before")
"""Windows that share a sample; standard deviations, in the unit of y, of the intercept, and of what was in force before
the first command (x3 then; 0: x3 is a regressor like the others)."""
RULES = np.array([
    (4.0, 0.0, 0.0), (4.0, 0.012, 0.0), (4.0, 0.0, 0.0), (2.0, 0.5, 0.0), (4.0, 0.0, 0.0), (4.0, 0.0, 0.0),
    (2.0, 0.02, 0.07), (2.0, 0.06, 0.07), (4.0, 0.0, 0.0), (50.0, 0.3, 0.0),
])  # fmt: skip

"""Longitudinal acceleration against the change of the speed: sign, unit, and gravity that is left in."""

from __future__ import annotations

import math

from ..kernel import inlined
from .record import COMPARED, MISTAKES, SLOW, SUBJECTS, TICKS, T, is_reported, report
from .regression import compare, honest_misfit

SMOOTHING = 2.5
"""s, time constant behind which both are compared."""
LOOK_SIGMA, LOOK_SIGMA_SHARE, DIFFERENCE_SIGMA = 0.03, 0.01, 0.1
"""m/s, -, m/s^2: standard deviations of the mean speed of a look, absolute and over the speed, and of a difference."""
GRAVITY_EVIDENCE = 8.0
"""Squared misfit of every honest value from which the signal contains gravity."""


@inlined
def compare_forward(memory):
    """Compare longitudinal acceleration and speed at a look, both filtered alike."""
    last, is_wrong = memory.ticks[TICKS - 1], is_reported(memory, SUBJECTS.speed)
    if last[T.speed] < SLOW or memory.tick_count < 3 or is_wrong or not math.isfinite(last[T.forward]):
        memory.slow_speed, memory.slow_acceleration = last[T.speed], 0.0
        return
    share = last[T.time] / (SMOOTHING + last[T.time])
    memory.slow_speed += share * (last[T.speed] - memory.slow_speed)
    memory.slow_acceleration += share * (last[T.forward] - memory.slow_acceleration)
    change = (last[T.speed] - memory.slow_speed) / SMOOTHING
    difference = memory.slow_acceleration - change
    noise = DIFFERENCE_SIGMA + (LOOK_SIGMA + LOOK_SIGMA_SHARE * last[T.speed]) / SMOOTHING
    label = compare(memory, COMPARED.forward, change, 0.0, 0.0, difference, noise, last[T.time])
    if label == 0 and honest_misfit(memory, COMPARED.forward) > GRAVITY_EVIDENCE:
        label = memory.label[COMPARED.forward] = 1 + MISTAKES.longitudinal_acceleration_with_gravity
    if label > 0:
        report(memory, SUBJECTS.forward, label - 1, memory.slow_acceleration, change, 0.0)

"""Yaw and yaw rate of clocks that are apart: the change of one against the integral of the other of some time ago."""

from __future__ import annotations

import math

from ..kernel import inlined, local
from .hypotheses import NEAR_ONE
from .record import COMPARED, MISTAKES, SHIFT, SHIFTS, SUBJECTS, TICKS, WINDOW, T, say
from .regression import AGAIN, EVIDENCE, decide, pass_on

AGREE, APART = 1, 3
"""Shifts from none, up to which clocks agree, and from which they are apart."""
YAW = 0.005
"""rad, noise of a difference of two samples."""
_NONE = SHIFTS // 2
_integrals = local(TICKS, 2)


@inlined
def _at(t, which, integrals, own):
    """An integral at a time (s), a straight line between two looks."""
    i = TICKS - 2
    while i > 0 and own.ticks[i, T.t] > t:
        i -= 1
    start, end = own.ticks[i, T.t], own.ticks[i + 1, T.t]
    return integrals[i, which] + (t - start) / (end - start) * (integrals[i + 1, which] - integrals[i, which])


@inlined
def compare_clocks(own):
    """Name clocks of yaw and yaw rate that are apart."""
    if own.tick_count < TICKS:
        return
    integrals = _integrals()
    for i in range(1, TICKS):
        row = own.ticks[i]
        integrals[i, 0] = integrals[i - 1, 0] + row[T.turned]
        integrals[i, 1] = integrals[i - 1, 1] + row[T.yaw_rate] * row[T.time]
    start, end = own.ticks[TICKS - 1 - WINDOW, T.t], own.ticks[TICKS - 1, T.t]
    known = math.isfinite(integrals[TICKS - 1, 0] + integrals[TICKS - 1, 1])
    if not known or start - own.ticks[0, T.t] < _NONE * SHIFT:
        return
    time = own.ticks[TICKS - 1, T.time]
    left, weight = pass_on(own, COMPARED.clock, time), 1.0 / (YAW * YAW)
    honest = best = math.inf
    for k in range(SHIFTS):
        late = SHIFT * (k - _NONE)  # of the yaw rate
        of_yaw, of_rate = max(late, 0.0), max(-late, 0.0)
        y = _at(end - of_yaw, 0, integrals, own) - _at(start - of_yaw, 0, integrals, own)
        x = _at(end - of_rate, 1, integrals, own) - _at(start - of_rate, 1, integrals, own)
        row = own.shifted[k]
        row[0] = row[0] * left + weight * x * x
        row[1] = row[1] * left + weight * x * y
        row[2] = row[2] * left + weight * y * y
        for gain in NEAR_ONE:
            misfit = row[2] + gain * (gain * row[0] - 2.0 * row[1])
            if abs(k - _NONE) <= AGREE:
                honest = min(honest, misfit)
            elif abs(k - _NONE) >= APART and abs(gain - 1.0) < 0.1:
                best = min(best, misfit)
    if decide(own, COMPARED.clock, honest, 0, 1 + MISTAKES.yaw_late, best, 4.0, EVIDENCE, AGAIN) > 0:
        own.label[COMPARED.turn] = 1 + MISTAKES.yaw_late
        say(own, SUBJECTS.yaw_late, MISTAKES.yaw_late, 0.0, 0.0, 0.0)

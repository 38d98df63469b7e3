"""Whether the car slides, by its lateral velocity, or by how its positions move beside its yaw."""

from __future__ import annotations

import math

from ..controllers.contract import wrapped
from ..kernel import inlined
from ..maths.exponential import hypot
from ..maths.trigonometric import atan2
from .record import POSITION, SUBJECTS, TICK, TICKS, T, named

SLIDING, NOT_SLIDING, SLIDES = math.radians(8.5), math.radians(5.0), math.radians(4.5)
"""Sideslip from which the car slides, below which it no longer does, and of it what a rolling turn does not explain."""
RELEASE = 0.5
"""s, for which the sideslip must be small before the sliding is over."""


@inlined
def judge_sliding(own, settings):
    """Whether the car slides, at a look."""
    last, middle, before = own.ticks[TICKS - 1], own.ticks[TICKS - 2], own.ticks[TICKS - 3]
    unsure, looks = 0.0, 1
    if math.isfinite(last[T.vy]):
        own.sideslip = atan2(last[T.vy], last[T.speed])
    else:
        east, north = last[T.x] - before[T.x], last[T.y] - before[T.y]
        way = hypot(east, north)
        known = way > 1.0 and own.agreed > 10 and not named(own, SUBJECTS.course)
        unsure, looks = 1.5 * POSITION / max(way, 1e-3), 3  # a position that jumps is in two
        beside = wrapped(atan2(north, east) - (last[T.yaw] - 0.5 * (last[T.turned] + middle[T.turned])))
        own.sideslip = beside - own.mounting if known else math.nan
    measured = math.isfinite(last[T.yaw_rate])
    rate = last[T.yaw_rate] if measured else last[T.turned] / max(last[T.time], TICK)
    rolling = settings.lr * rate / last[T.speed]
    slip = abs(own.sideslip) - unsure
    if slip > SLIDING and abs(own.sideslip - rolling) - unsure > SLIDES:
        own.slips += 1
        own.calm = 0.0
        if own.slips >= looks:
            own.sliding = 1
        return
    own.slips = 0
    if own.sliding > 0:
        own.calm = 0.0 if slip > NOT_SLIDING else own.calm + last[T.time]
        own.sliding = 1 if own.calm < RELEASE else 0

"""Whether the car slides, by its lateral velocity, or by how its positions move beside its yaw."""

from __future__ import annotations

import math

from ..controllers.contract import wrapped
from ..kernel import inlined
from ..maths.exponential import hypot
from ..maths.trigonometric import atan2
from .record import POSITION, SUBJECTS, TICK, TICKS, T, is_reported

SLIDING, NOT_SLIDING, SKID = math.radians(8.5), math.radians(5.0), math.radians(4.5)
"""Sideslip from which the car slides, below which it no longer does, and of it what a rolling turn does not explain."""
RELEASE = 0.5
"""s, for which the sideslip must be small before the sliding is over."""


@inlined
def judge_sliding(memory, settings):
    """Whether the car slides, at a look."""
    last, middle, before = memory.ticks[TICKS - 1], memory.ticks[TICKS - 2], memory.ticks[TICKS - 3]
    unsure, looks = 0.0, 1
    if math.isfinite(last[T.vy]):
        memory.sideslip = atan2(last[T.vy], last[T.speed])
    else:
        east, north = last[T.x] - before[T.x], last[T.y] - before[T.y]
        way = hypot(east, north)
        known = way > 1.0 and memory.agreed > 10 and not is_reported(memory, SUBJECTS.course)
        unsure, looks = 1.5 * POSITION / max(way, 1e-3), 3  # a position that jumps is in two
        beside = wrapped(atan2(north, east) - (last[T.yaw] - 0.5 * (last[T.turned] + middle[T.turned])))
        memory.sideslip = beside - memory.mounting if known else math.nan
    measured = math.isfinite(last[T.yaw_rate])
    rate = last[T.yaw_rate] if measured else last[T.turned] / max(last[T.time], TICK)
    rolling = settings.lr * rate / last[T.speed]
    slip = abs(memory.sideslip) - unsure
    memory.skid = abs(memory.sideslip - rolling) - unsure
    if slip > SLIDING and memory.skid > SKID:
        memory.slips += 1
        memory.calm = 0.0
        if memory.slips >= looks:
            memory.sliding = 1
        return
    memory.slips = 0
    if memory.sliding > 0:
        memory.calm = 0.0 if slip > NOT_SLIDING else memory.calm + last[T.time]
        memory.sliding = 1 if memory.calm < RELEASE else 0

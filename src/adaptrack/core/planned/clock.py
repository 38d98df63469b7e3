"""Clocks of the planner and the tracker: convert stamps, and refuse those that are too old or in the future.

A stamp cannot separate the offset of two clocks from the delay of a message. Stamps in the accepted range therefore
count as those of one clock, unless the settings have an offset. Otherwise the offset is the least delay of the
arrivals.
"""

from __future__ import annotations

import math

from ..kernel import Field, columns, inlined
from ..maths.exact import clip
from .records import PLANNER

_VERDICTS = {
    "taken": "the car follows it",
    "same": "it repeats the followed trajectory with a new stamp",
    "older": "its stamp is older than that of the followed trajectory",
    "stale": "its stamp is older than the setting `oldest`, or of a different clock",
    "early": "its stamp is more than 0.1 s in the future, or of a different clock",
    "silent": "it has no points",
    "waiting": "the planner was silent: it drives again after three trajectories in a row that begin at the car",
    "unfit": "a fallback does not begin at the car, or needs more grip than is assumed",
}
VERDICT = columns(*(Field(name, "", 0, meaning) for name, meaning in _VERDICTS.items()))
"""Verdicts on a trajectory."""
MAX_STAMP_LEAD = 0.1
"""s, by which a stamp may be in the future; also the offset of two clocks from which it is reported."""
MIN_CONSISTENT_STAMPS = 3
"""Stamps in a row with a new offset, from which on this offset is used."""
MAX_CLOCK_DRIFT = 1e-4
"""s/s, of one clock relative to the other."""


@inlined
def forget_planner(memory):
    """Reset the memory of a planner: its last trajectory and the offset of the clocks."""
    memory.driven_by = min(memory.driven_by, PLANNER)  # which may send again before it counts as silent
    memory.late, memory.target_speed, memory.debt = math.nan, math.nan, 0.0
    memory.correction, memory.top_speed, memory.is_leaving = 0.0, math.inf, 0
    memory.clock_offset, memory.stamp, memory.arrival, memory.other_stamps = math.nan, -math.inf, -math.inf, 0
    memory.checksum, memory.disagreed, memory.returned, memory.far_count, memory.hidden = math.nan, 0, 0, 0, 0.0


@inlined
def _is_accepted(age, settings):
    """Whether a stamp of some age (s) is neither too old nor in the future."""
    return -MAX_STAMP_LEAD <= age <= settings.oldest


@inlined
def convert_stamp(stamp, arrival, settings, memory):
    """Return the verdict on a stamp (s), and the stamp on the tracker's clock (s); arrival: s, on the tracker's clock.

    A stamp of 0 or NaN stands for the time of arrival. Stamps beyond the accepted range are refused, until
    `MIN_CONSISTENT_STAMPS` in a row agree with each other. Then the planner has a new clock.
    """
    if stamp == 0.0 or stamp != stamp:
        return VERDICT.taken, arrival
    delay = arrival - stamp  # of the message, plus the offset of the clocks
    if _is_accepted(delay - memory.clock_offset, settings):  # the offset is estimated
        drift = MAX_CLOCK_DRIFT * clip(arrival - memory.arrival, 0.0, 1.0)
        memory.clock_offset = min(memory.clock_offset + drift, delay)
    offset = memory.clock_offset
    if offset != offset:
        offset = settings.clock_offset if settings.clock_offset == settings.clock_offset else 0.0
    age = delay - offset
    if _is_accepted(age, settings):
        memory.other_stamps = 0
        return VERDICT.older if stamp < memory.stamp else VERDICT.taken, stamp + offset
    is_consistent = memory.other_stamps > 0 and _is_accepted(delay - memory.other_offset, settings)
    memory.other_stamps = memory.other_stamps + 1 if is_consistent else 1
    memory.other_offset = min(memory.other_offset, delay) if is_consistent else delay
    if memory.other_stamps < MIN_CONSISTENT_STAMPS:
        return VERDICT.early if age < 0.0 else VERDICT.stale, arrival
    memory.clock_offset, memory.stamp, memory.other_stamps = memory.other_offset, -math.inf, 0
    return VERDICT.taken, stamp + memory.clock_offset

"""Stamps of a planner on the clock of the tracker: which trajectories are in time, and how much the clocks differ.

What two clocks differ by and what a message takes on its way cannot be told apart by stamps. So stamps that are in time
count as those of one clock, unless an offset is told; the offset of others is the least delay of their arrivals.
"""

from __future__ import annotations

import math

from ..kernel import inlined
from ..maths.exact import clip

(TAKEN, SAME, OLDER, STALE, EARLY, SILENT, WAITING, UNFIT) = range(8)
"""Verdicts on a trajectory: it is followed; it has the shape of the one that is followed; it is older than that; its
stamp is too old, or in the future; it has no points; the planner has been silent, and this is not yet enough; a
fallback does not begin at the car, asks for too much grip, or is stale."""
FUTURE = 0.1
"""s, by which a stamp may be in the future; and difference of two clocks from which it is named."""
CONSISTENT = 3
"""Stamps in a row of another clock, after which it is believed."""
CLOCK_DRIFT = 1e-4
"""s/s, by which two clocks may run apart."""


@inlined
def forget_planner(memory):
    """Begin without a trajectory, and without a clock of the planner."""
    memory.driven_by, memory.late, memory.target_speed, memory.debt = 0, math.nan, math.nan, 0.0
    memory.correction, memory.top_speed, memory.is_leaving = 0.0, math.inf, 0
    memory.clock_offset, memory.stamp, memory.arrival, memory.other_stamps = math.nan, -math.inf, -math.inf, 0
    memory.checksum, memory.disagreed, memory.returned, memory.far_count, memory.hidden = math.nan, 0, 0, 0, 0.0


@inlined
def _offset(settings, memory):
    """s, to add to the planner's stamps."""
    told = settings.clock_offset if settings.clock_offset == settings.clock_offset else 0.0
    return memory.clock_offset if memory.clock_offset == memory.clock_offset else told


@inlined
def place_stamp(stamp, arrival, settings, memory):
    """Return the verdict on a stamp (s) that arrives at a time (s), and that stamp on the tracker's clock.

    A stamp of 0, or none, is that of the arrival. Stamps that fit no clock so far are refused until so many in a row
    (`CONSISTENT`) agree with each other: it is another clock, or the planner has begun its own anew.
    """
    if stamp == 0.0 or stamp != stamp:
        return TAKEN, arrival
    delay = arrival - stamp  # of the message, and the offset of the clocks
    since = delay - memory.clock_offset
    if -FUTURE <= since <= settings.oldest:  # an offset that was found
        allowed = CLOCK_DRIFT * clip(arrival - memory.arrival, 0.0, 1.0)
        memory.clock_offset = min(memory.clock_offset + allowed, delay)
    offset = _offset(settings, memory)
    age = delay - offset
    if -FUTURE <= age <= settings.oldest:
        memory.other_stamps = 0
        return OLDER if stamp < memory.stamp else TAKEN, stamp + offset
    beyond = delay - memory.other_offset
    agrees = memory.other_stamps > 0 and -FUTURE <= beyond <= settings.oldest
    memory.other_stamps = memory.other_stamps + 1 if agrees else 1
    memory.other_offset = min(memory.other_offset, delay) if agrees else delay
    if memory.other_stamps < CONSISTENT:
        return EARLY if age < 0.0 else STALE, arrival
    memory.clock_offset, memory.stamp, memory.other_stamps = memory.other_offset, -math.inf, 0
    return TAKEN, stamp + memory.clock_offset

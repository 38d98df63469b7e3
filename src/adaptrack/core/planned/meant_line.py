"""Detect a planner that hides the error of the controller by starting each trajectory at the measured pose.

Trajectories of such a planner begin at the car and return to the intended line seconds ahead. The intended line is
therefore taken from places seconds ahead in earlier trajectories. The error is hidden if the car stays away from this
line while each new trajectory shows little offset.
"""

from __future__ import annotations

import math

from ..kernel import inlined
from ..maths.exact import clip
from ..maths.exponential import hypot

FAR_PLACES = 48
"""Number of places of the intended line that are stored."""
FAR_TIME, FAR_SHARE, FAR_STEP = 3.0, 0.8, 1.0
"""s, -, m: time ahead of a stored place, its largest share of the trajectory, and distance between two such places."""
OFFSET_TIME_CONSTANT = 0.7
"""s, of the filter of both offsets."""
MIN_HIDDEN_OFFSET, HIDDEN_SIGMAS, MAX_SHOWN_SHARE = 0.15, 3.0, 0.5
"""m, standard deviations of a measured position, -: an offset beyond the first two is hidden if the new trajectory
shows less than this share of it."""
MIN_HIDDEN_TIME = 2.5
"""s, for which an offset must be hidden before it is reported."""


@inlined
def _drop_oldest_places(count, places, memory):
    """Forget so many of the stored places."""
    for i in range(2 * (memory.far_count - count)):
        places[i] = places[i + 2 * count]
    memory.far_count -= count


@inlined
def remember_place(x, y, places, memory):
    """Store a place (m, m) of the intended line, unless it is near the last one."""
    end = 2 * memory.far_count
    if end > 0 and hypot(x - places[end - 2], y - places[end - 1]) < FAR_STEP:
        return
    if end == places.size:
        _drop_oldest_places(1, places, memory)
        end -= 2
    places[end], places[end + 1] = x, y
    memory.far_count += 1


@inlined
def _offset_from_places(x, y, places, memory):
    """Offset (m) of a point to the left of the line through the stored places; NaN before its start or after its end.

    Places well behind the point are forgotten.
    """
    offset, segment = math.nan, 0
    for k in range(memory.far_count - 1):
        start_x, start_y = places[2 * k], places[2 * k + 1]
        dx, dy = places[2 * k + 2] - start_x, places[2 * k + 3] - start_y
        length = hypot(dx, dy)
        along = ((x - start_x) * dx + (y - start_y) * dy) / length
        if 0.0 <= along <= length:
            offset, segment = ((y - start_y) * dx - (x - start_x) * dy) / length, k
    if segment > 1:
        _drop_oldest_places(segment - 1, places, memory)
    return offset


@inlined
def hides_error(x, y, trajectory_offset, elapsed, position_noise, places, memory):
    """Whether the trajectories have hidden an offset of the car at (x, y), in m, for `MIN_HIDDEN_TIME`.

    trajectory_offset: m, of the car from the newest trajectory; elapsed: s, since the trajectory before;
    position_noise: m, standard deviation of a measured position.
    """
    meant_offset = _offset_from_places(x, y, places, memory)
    if not math.isfinite(meant_offset + trajectory_offset):
        memory.hidden = 0.0
        return False
    share = clip(elapsed / OFFSET_TIME_CONSTANT, 0.0, 1.0)
    memory.meant_offset += share * (meant_offset - memory.meant_offset)
    memory.given_offset += share * (abs(trajectory_offset) - memory.given_offset)
    size = abs(memory.meant_offset)
    is_large = size > max(MIN_HIDDEN_OFFSET, HIDDEN_SIGMAS * position_noise)
    is_hidden = is_large and memory.given_offset < MAX_SHOWN_SHARE * size
    memory.hidden = memory.hidden + elapsed if is_hidden else 0.0
    return memory.hidden > MIN_HIDDEN_TIME

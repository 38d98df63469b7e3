"""Whether a planner hides the error of the controller: it begins each trajectory at the car, wherever that is.

The line that was meant is that of places seconds ahead in earlier trajectories, where these have come back to it. A car
that stays beside that line, while each new trajectory says that it is right, will not come back to it.
"""

from __future__ import annotations

import math

from ..kernel import inlined
from ..maths.exact import clip
from ..maths.exponential import hypot

FAR_PLACES = 48
"""Places ahead that are kept."""
FAR_TIME, FAR_SHARE, FAR_STEP = 3.0, 0.8, 1.0
"""s ahead, at most this share of a trajectory; m, between two places that are kept."""
MEANT_TIME = 0.7
"""s, time constant of the two offsets."""
HIDDEN_OFFSET, HIDDEN_SIGMAS, SHOWN_SHARE = 0.15, 3.0, 0.5
"""m, standard deviations of a position, -: a larger offset is hidden where the trajectory shows less than this share.
"""
HIDDEN_TIME = 2.5
"""s, for which it is hidden until it is reported."""


@inlined
def _drop(count, far, memory):
    """Forget the oldest places."""
    for i in range(2 * (memory.far_count - count)):
        far[i] = far[i + 2 * count]
    memory.far_count -= count


@inlined
def remember_place(x, y, far, memory):
    """Keep a place (m, m) that a trajectory means to reach in seconds."""
    last = 2 * memory.far_count
    if last > 0 and hypot(x - far[last - 2], y - far[last - 1]) < FAR_STEP:
        return
    if last == far.size:
        _drop(1, far, memory)
        last -= 2
    far[last], far[last + 1] = x, y
    memory.far_count += 1


@inlined
def _offset_from(x, y, far, memory):
    """Offset (m) of a point to the left of the line through the places; NaN where it is not beside it.

    Places that lie behind are forgotten.
    """
    offset, passed = math.nan, 0
    for k in range(memory.far_count - 1):
        ax, ay = far[2 * k], far[2 * k + 1]
        dx, dy = far[2 * k + 2] - ax, far[2 * k + 3] - ay
        way = hypot(dx, dy)
        along = ((x - ax) * dx + (y - ay) * dy) / way
        if 0.0 <= along <= way:
            offset, passed = ((y - ay) * dx - (x - ax) * dy) / way, k
    if passed > 1:
        _drop(passed - 1, far, memory)
    return offset


@inlined
def hides_error(x, y, given_offset, elapsed, settings, far, memory):
    """Whether trajectories have hidden an offset of the car for long; x, y: m, of the car.

    given_offset: m, of the car from the newest trajectory; elapsed: s, since the one before.
    """
    meant = _offset_from(x, y, far, memory)
    if not math.isfinite(meant + given_offset):
        memory.hidden = 0.0
        return False
    share = clip(elapsed / MEANT_TIME, 0.0, 1.0)
    memory.meant_offset += share * (meant - memory.meant_offset)
    memory.given_offset += share * (given_offset - memory.given_offset)
    least = max(HIDDEN_OFFSET, HIDDEN_SIGMAS * settings.position_noise)
    is_hidden = abs(memory.meant_offset) > least
    is_hidden = is_hidden and abs(memory.given_offset) < SHOWN_SHARE * abs(memory.meant_offset)
    memory.hidden = memory.hidden + elapsed if is_hidden else 0.0
    return memory.hidden > HIDDEN_TIME

"""Another path under way."""

from __future__ import annotations

from ..controllers.contract import wrapped
from ..kernel import Place, exported, float64, inlined, void
from .pose import find_on_path, has_path, hint, restart
from .records import REQUEST, TrackerRecord
from .signals import MAX_SIGNAL


@exported(void(float64, Place(TrackerRecord)))
def tracker_follow(near, tracker):
    """Go over to the path, and the plan, that `tracker` has now in place of another; what is learned of the car stays.

    near: m, the car's foot is looked for within 400 m of this arc length; NaN: on the whole path. The path had better
    begin behind the car, by the age of the oldest samples at least.
    """
    m = tracker.memory[0]
    hint(m, near)
    m.due, m.waiting, m.open = 0, 0, 0
    if m.started == 0:
        return
    if has_path(tracker):
        _go_over(tracker, m)
    else:
        restart(tracker, m)


@inlined
def _go_over(tracker, m):
    """Find the car on the path, and say by how much that moves it against the one before."""
    offset, heading_error = m.offset, m.heading_error
    find_on_path(tracker, m)
    request, shifted = tracker.request, m.offset - offset
    if abs(shifted) < MAX_SIGNAL:
        pending = request[REQUEST.change]  # 1: the controller has not heard yet of the path before
        request[REQUEST.turned] = wrapped(m.heading_error - heading_error) + pending * request[REQUEST.turned]
        request[REQUEST.shifted] = shifted + pending * request[REQUEST.shifted]
        request[REQUEST.change] = 1.0
    else:  # too far from one of them to say by how much
        restart(tracker, m)

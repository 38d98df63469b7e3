"""Drive by time along a planned trajectory: the place for a time, the lateness, and the speed that makes up for it.

    v = v_ref(s) + k (s_ref(t - debt) - s)

with s the place of the car, v_ref(s) the speed planned there and s_ref(t) the place planned for a time. Only the speed
along the path is corrected: a wrong time never moves the car sideways.
"""

from __future__ import annotations

import math

from ..kernel import Place, exported, float64, inlined, several, void
from ..maths.exact import clip, sqrt, square
from ..speed.plan import last_at
from ..speed.stops import OVERSHOOT, STOP_TOLERANCE
from .records import STOP, Planned, PlannedSpeeds

DEAD_ZONE = 0.2
"""m, between the car and its place by the time, within which nothing is corrected."""
CORRECTION_SHARE, LEAST_CORRECTION = 0.15, 0.3
"""-, m/s: largest correction over the planned speed; at least so much while the trajectory moves."""
MAX_CATCH_UP = 3.0
"""s, that is made up for; more shifts the times of the trajectory."""
LIMIT_TIME, LIMIT_WAY = 2.0, 5.0
"""s, m: way ahead and behind, at the planned speed and at least, in which the largest planned speed limits a car that
catches up."""
START_WAY = 0.05
"""m, behind a place of rest whose planned speed a car starts with that leaves it."""


@inlined
def speed_at(place, speeds):
    """Planned speed (m/s) at a place (m): between nodes its square is straight, beyond the ends it stays."""
    s, speed, k = speeds.s, speeds.speed, last_at(place, speeds.s)
    if k < 0 or k == s.size - 1:
        return speed[max(k, 0)]
    low, high = square(speed[k]), square(speed[k + 1])
    return sqrt(max(low + (high - low) * ((place - s[k]) / (s[k + 1] - s[k])), 0.0))


@inlined
def _speed_beyond(k, speeds):
    """Speed (m/s) of a trajectory beyond an end, a node: that of the end, where it is no creeping into a rest."""
    return speeds.speed[k] if speeds.speed[k] > LEAST_CORRECTION else 0.0


@exported(several(float64, float64)(float64, PlannedSpeeds))
def place_at(time, speeds):
    """Place (m) and speed (m/s) of a trajectory at a time (s): constant acceleration between nodes, rest at them.

    Beyond the ends it goes straight on at the last speed, see `_speed_beyond`. NaN, 0 without nodes.
    """
    s, speed, last = speeds.s, speeds.speed, speeds.s.size - 1
    if last < 0:
        return math.nan, 0.0
    k = last_at(time, speeds.arrive)
    if k < 0:
        return s[0] + _speed_beyond(0, speeds) * (time - speeds.arrive[0]), _speed_beyond(0, speeds)
    since = time - speeds.leave[k]
    if since <= 0.0 and speeds.leave[k] > speeds.arrive[k]:
        return s[k], 0.0
    if k == last:
        return s[k] + _speed_beyond(k, speeds) * since, _speed_beyond(k, speeds)
    share = since / (speeds.arrive[k + 1] - speeds.leave[k])
    both, gained = speed[k] + speed[k + 1], speed[k + 1] - speed[k]
    way = share * (2.0 * speed[k] + gained * share) / both if both > 0.0 else share
    return s[k] + way * (s[k + 1] - s[k]), speed[k] + gained * share


@exported(float64(float64, PlannedSpeeds))
def time_at(place, speeds):
    """Time (s) at which a trajectory is at a place (m), the inverse of `place_at`; at a place of rest that of arrival.

    Places beyond an end at rest have the time of arrival there. NaN without nodes.
    """
    s, speed, last = speeds.s, speeds.speed, speeds.s.size - 1
    if last < 0 or place != place:
        return math.nan
    k = max(last_at(place, s), 0)
    way, beyond = place - s[k], _speed_beyond(k, speeds)
    if way < 0.0 and beyond > 0.0:
        return speeds.arrive[k] + way / beyond
    if k == last and way > 0.0 and beyond > 0.0:
        return speeds.leave[k] + way / beyond
    if way <= 0.0 or k == last:
        return speeds.arrive[k]
    share, both = way / (s[k + 1] - s[k]), speed[k] + speed_at(place, speeds)
    if both > 0.0:
        share *= (speed[k] + speed[k + 1]) / both
    return speeds.leave[k] + share * (speeds.arrive[k + 1] - speeds.leave[k])


# -- places of rest ---------------------------------------------------------------------------------------------------
@inlined
def _leave_at(k, speeds):
    """Time (s) to leave a node; infinite at an end at rest."""
    return math.inf if k == speeds.s.size - 1 and not speeds.speed[k] > 0.0 else speeds.leave[k]


@inlined
def _is_rest(k, speeds):
    """Whether the trajectory stands at a node."""
    return not speeds.speed[k] > 0.0 or speeds.leave[k] > speeds.arrive[k]


@inlined
def _rest_between(low, high, speeds):
    """The last place of rest between two places (m); -1 without one. One at the end is at every place beyond it."""
    k = last_at(high, speeds.s)
    low = min(low, speeds.s[speeds.s.size - 1])
    while k >= 0 and speeds.s[k] >= low:
        if _is_rest(k, speeds):
            return k
        k -= 1
    return -1


@inlined
def _before_next_rest(reference, station, speeds):
    """Return a reference place (m), or the next place of rest where the car has not yet reached it."""
    for k in range(last_at(station + STOP_TOLERANCE, speeds.s) + 1, speeds.s.size):
        if speeds.s[k] >= reference:
            break
        if _is_rest(k, speeds):
            return speeds.s[k]
    return reference


# -- the law ----------------------------------------------------------------------------------------------------------
@inlined
def _lateness(time, station, speeds):
    """Time (s) by which a car at a station (m) is late, negative: early; 0 at a place of rest until it is to leave."""
    first = last = time_at(station, speeds)
    k = _rest_between(station - STOP_TOLERANCE, station + STOP_TOLERANCE, speeds)
    if k >= 0:
        first, last = min(first, speeds.arrive[k]), max(last, _leave_at(k, speeds))
    return time - clip(time, first, last)


@inlined
def _top_speed(station, planned_speed, speeds):
    """Largest planned speed (m/s) near a station (m)."""
    way = max(LIMIT_TIME * planned_speed, LIMIT_WAY)
    top = max(speed_at(station - way, speeds), speed_at(station + way, speeds))
    k = last_at(station + way, speeds.s)
    while k >= 0 and speeds.s[k] >= station - way:
        top = max(top, speeds.speed[k])
        k -= 1
    return top


@exported(void(float64, float64, float64, Place(Planned)))
def keep_time(time, station, speed, planned):
    """Write lateness, debt, correction, top speed and target speed of a car, and whether it is to leave, to the memory.

    time: s, on the tracker's clock; station, speed: m, m/s, of the car. Lateness beyond `MAX_CATCH_UP` becomes debt,
    which shrinks with the lateness. The reference place is never beyond the next place of rest: a late car arrives
    there as planned, and leaves by the time. Without nodes, a place or a time nothing is corrected.
    """
    settings, memory, speeds = planned.settings[0], planned.memory[0], planned.speeds
    memory.late, memory.correction, memory.target_speed, memory.is_leaving = math.nan, 0.0, math.nan, 0
    if speeds.s.size == 0 or not math.isfinite(time - station):
        return
    memory.late = _lateness(time, station, speeds)
    memory.debt = clip(memory.debt, memory.late - MAX_CATCH_UP, max(memory.late, 0.0))
    planned_speed = speed_at(station, speeds)
    limit = settings.speed_limit
    memory.top_speed = limit if limit == limit else _top_speed(station, planned_speed, speeds)
    reference, reference_speed = place_at(time - memory.debt, speeds)
    gap = _before_next_rest(reference, station, speeds) - station
    width = CORRECTION_SHARE * planned_speed
    if reference_speed > 0.0:
        width = max(width, LEAST_CORRECTION)
    correction = clip(settings.catch_up * (gap - clip(gap, -DEAD_ZONE, DEAD_ZONE)), -width, width)
    memory.correction = min(correction, max(memory.top_speed - planned_speed, 0.0))
    rest_node = _rest_between(station - OVERSHOOT, station + STOP_TOLERANCE, speeds)
    coming = station + max(0.0, speed) * settings.period
    if rest_node >= 0 and time - memory.debt >= _leave_at(rest_node, speeds):
        memory.is_leaving, coming = 1, max(coming, speeds.s[rest_node] + START_WAY)
    memory.target_speed = 0.0
    if memory.driven_by == STOP:
        memory.correction = 0.0
    elif rest_node == -1 or memory.is_leaving > 0 or coming < speeds.s[rest_node]:
        coming_speed = speed_at(coming, speeds)
        memory.target_speed = clip(coming_speed + memory.correction, 0.0, max(coming_speed, memory.top_speed))

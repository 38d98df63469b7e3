"""Follow the times of a planned trajectory: planned place, lateness, and the speed that reduces the lateness.

    v = v_ref(s) + k (s_ref(t - debt) - s)

with s the place of the car, v_ref(s) the speed planned there and s_ref(t) the place planned for a time. Only the speed
along the path is corrected: an error of time never moves the car sideways.
"""

from __future__ import annotations

import math

from ..kernel import Place, exported, float64, inlined, several, void
from ..maths.exact import clip
from ..speed.plan import last_at, speed_between
from ..speed.stops import OVERSHOOT, STOP_TOLERANCE
from .records import STOP, Planned, PlannedSpeeds

DEAD_ZONE, DEAD_ZONE_TIME = 0.2, 0.1
"""m, s: largest distance between the car and its planned place that is not corrected; while the trajectory moves, at
most the way in this time."""
CORRECTION_SHARE, LEAST_CORRECTION = 0.15, 0.3
"""-, m/s: bound of the correction as a share of the planned speed, and its least value while the trajectory moves."""
MAX_CATCH_UP = 3.0
"""s, largest lateness that is corrected; more shifts the times of the trajectory."""
LIMIT_TIME, LIMIT_WAY = 2.0, 5.0
"""s, m: way ahead and behind, at the planned speed and at least. The largest planned speed in it limits a car that
catches up."""
LIMIT_LEAD = 1.5
"""s, before a larger speed behind the car leaves this way, from which on it limits no more: the car slows down late."""
START_WAY = 0.05
"""m: a car that leaves a place of rest starts with the speed that is planned so far behind it."""


@inlined
def speed_at(place, speeds):
    """Planned speed (m/s) at a place (m): its square is linear between nodes; constant beyond the ends."""
    s, speed, k = speeds.s, speeds.speed, last_at(place, speeds.s)
    if k < 0 or k == s.size - 1:
        return speed[max(k, 0)]
    return speed_between(place, k, s, speed)


@inlined
def _end_speed(k, speeds):
    """Speed (m/s) at which a trajectory continues beyond its end node k; 0 for an end that is nearly at rest."""
    return speeds.speed[k] if speeds.speed[k] > LEAST_CORRECTION else 0.0


@exported(several(float64, float64)(float64, PlannedSpeeds))
def place_at(time, speeds):
    """Place (m) and speed (m/s) of a trajectory at a time (s), with constant acceleration between nodes.

    Beyond the ends it continues at the speed of the end. Without nodes: NaN and 0.
    """
    s, speed, last = speeds.s, speeds.speed, speeds.s.size - 1
    if last < 0:
        return math.nan, 0.0
    k = last_at(time, speeds.arrive)
    if k < 0:
        return s[0] + _end_speed(0, speeds) * (time - speeds.arrive[0]), _end_speed(0, speeds)
    since = time - speeds.leave[k]
    if since <= 0.0 and speeds.leave[k] > speeds.arrive[k]:
        return s[k], 0.0
    if k == last:
        return s[k] + _end_speed(k, speeds) * since, _end_speed(k, speeds)
    share = since / (speeds.arrive[k + 1] - speeds.leave[k])
    speed_sum, speed_change = speed[k] + speed[k + 1], speed[k + 1] - speed[k]
    way_share = share * (2.0 * speed[k] + speed_change * share) / speed_sum if speed_sum > 0.0 else share
    return s[k] + way_share * (s[k + 1] - s[k]), speed[k] + speed_change * share


@exported(float64(float64, PlannedSpeeds))
def time_at(place, speeds):
    """Time (s) at which a trajectory is at a place (m), the inverse of `place_at`; at a rest the time of arrival.

    Places beyond an end at rest have the time of arrival there. Without nodes: NaN.
    """
    s, speed, last = speeds.s, speeds.speed, speeds.s.size - 1
    if last < 0 or place != place:
        return math.nan
    k = max(last_at(place, s), 0)
    way, end_speed = place - s[k], _end_speed(k, speeds)
    if way < 0.0 and end_speed > 0.0:
        return speeds.arrive[k] + way / end_speed
    if k == last and way > 0.0 and end_speed > 0.0:
        return speeds.leave[k] + way / end_speed
    if way <= 0.0 or k == last:
        return speeds.arrive[k]
    share, speed_sum = way / (s[k + 1] - s[k]), speed[k] + speed_at(place, speeds)
    if speed_sum > 0.0:
        share *= (speed[k] + speed[k + 1]) / speed_sum
    return speeds.leave[k] + share * (speeds.arrive[k + 1] - speeds.leave[k])


# -- places of rest ---------------------------------------------------------------------------------------------------
@inlined
def _leave_at(k, speeds):
    """Time (s) of departure from a node; infinite at an end at rest."""
    return math.inf if k == speeds.s.size - 1 and not speeds.speed[k] > 0.0 else speeds.leave[k]


@inlined
def _is_rest(k, speeds):
    """Whether the trajectory stands at a node."""
    return not speeds.speed[k] > 0.0 or speeds.leave[k] > speeds.arrive[k]


@inlined
def _rest_between(low, high, speeds):
    """Last node of rest between two places (m), -1: none. An end at rest extends to all places beyond it."""
    k = last_at(high, speeds.s)
    low = min(low, speeds.s[speeds.s.size - 1])
    while k >= 0 and speeds.s[k] >= low:
        if _is_rest(k, speeds):
            return k
        k -= 1
    return -1


@inlined
def _before_next_rest(reference, station, speeds):
    """Return a reference place (m), limited to the next place of rest that the car has not reached."""
    for k in range(last_at(station + STOP_TOLERANCE, speeds.s) + 1, speeds.s.size):
        if speeds.s[k] >= reference:
            break
        if _is_rest(k, speeds):
            return speeds.s[k]
    return reference


# -- the law ----------------------------------------------------------------------------------------------------------
@inlined
def _lateness(time, station, speeds):
    """Lateness (s) of a car at a station (m), negative: early; 0 at a place of rest until it is to leave."""
    first = last = time_at(station, speeds)
    k = _rest_between(station - STOP_TOLERANCE, station + STOP_TOLERANCE, speeds)
    if k >= 0:
        first, last = min(first, speeds.arrive[k]), max(last, _leave_at(k, speeds))
    return time - clip(time, first, last)


@inlined
def _top_speed(station, planned_speed, speeds):
    """Speed (m/s) up to which a car at a station (m) catches up: the largest planned nearby."""
    way = max(LIMIT_TIME * planned_speed, LIMIT_WAY)
    first, last = station - way + LIMIT_LEAD * planned_speed, station + way
    top_speed = max(speed_at(first, speeds), speed_at(last, speeds))
    k = last_at(last, speeds.s)
    while k >= 0 and speeds.s[k] >= first:
        top_speed = max(top_speed, speeds.speed[k])
        k -= 1
    return top_speed


@exported(void(float64, float64, float64, Place(Planned)))
def keep_time(time, station, speed, planned):
    """Write lateness, debt, correction, top speed, target speed, and the time up to a departure to the memory.

    time: s, on the tracker's clock; station, speed: m, m/s, of the car. Lateness beyond `MAX_CATCH_UP` becomes debt,
    which shrinks with the lateness. The reference place is never beyond the next place of rest. So a late car arrives
    there at planned speeds, and leaves at the planned time. Without nodes, a place or a time nothing is corrected.
    """
    settings, memory, speeds = planned.settings[0], planned.memory[0], planned.speeds
    memory.late, memory.correction, memory.target_speed = math.nan, 0.0, math.nan
    memory.is_leaving, memory.rest_time = 0, 0.0
    if speeds.s.size == 0 or not math.isfinite(time - station):
        return
    memory.late = _lateness(time, station, speeds)
    memory.debt = clip(memory.debt, memory.late - MAX_CATCH_UP, max(memory.late, 0.0))
    planned_speed = speed_at(station, speeds)
    limit = settings.speed_limit
    memory.top_speed = limit if limit == limit else _top_speed(station, planned_speed, speeds)
    reference, reference_speed = place_at(time - memory.debt, speeds)
    gap = _before_next_rest(reference, station, speeds) - station
    bound, dead_zone = CORRECTION_SHARE * planned_speed, DEAD_ZONE
    if reference_speed > 0.0:
        bound, dead_zone = max(bound, LEAST_CORRECTION), min(dead_zone, DEAD_ZONE_TIME * planned_speed)
    correction = clip(settings.catch_up * (gap - clip(gap, -dead_zone, dead_zone)), -bound, bound)
    memory.correction = min(correction, max(memory.top_speed - planned_speed, 0.0))
    rest_node = _rest_between(station - OVERSHOOT, station + STOP_TOLERANCE, speeds)
    next_place = station + max(0.0, speed) * settings.period
    if rest_node >= 0:
        memory.rest_time = max(_leave_at(rest_node, speeds) - (time - memory.debt), 0.0)
        if memory.rest_time == 0.0:
            memory.is_leaving, next_place = 1, max(next_place, speeds.s[rest_node] + START_WAY)
    memory.target_speed = 0.0
    if memory.driven_by == STOP:
        memory.correction = 0.0
    elif rest_node == -1 or memory.is_leaving > 0 or next_place < speeds.s[rest_node]:
        next_speed = speed_at(next_place, speeds)
        memory.target_speed = clip(next_speed + memory.correction, 0.0, max(next_speed, memory.top_speed))

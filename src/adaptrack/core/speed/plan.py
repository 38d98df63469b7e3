"""The speed of a plan along a road: between its places the square of the speed is straight."""

from __future__ import annotations

import math

from ..kernel import exported, float64, inlined, int64, record, vector, void
from ..maths.exact import floor, sqrt, square
from ..roads.road import last_between

SpeedPlanRecord = record(
    "SpeedPlanRecord", (("s", vector), ("speed", vector), ("time", vector), ("duration", float64), ("closed", int64))
)
"""A plan: m, m/s and s of arrival at its places, s in all (of a lap, where closed is 1), standing at stops included."""


@inlined
def last_at(place, s):
    """The last of ascending s[k] <= `place`; -1 before the first, and for NaN."""
    return last_between(place, s, -1, s.size)


@inlined
def cell_from(place, k, s):
    """The last of ascending places s[k] <= `place` < s[n - 1]: strides that double from k on, then halves."""
    step = 1
    while k + step < s.size - 1 and s[k + step] <= place:
        k += step
        step *= 2
    while step > 1:
        step //= 2
        if k + step < s.size - 1 and s[k + step] <= place:
            k += step
    return k


@inlined
def speed_between(place, k, s, speed):
    """Speed (m/s) of a plan at a place between s[k] and s[k + 1] (m): its square is straight."""
    low, high = square(speed[k]), square(speed[k + 1])
    return sqrt((high - low) / (s[k + 1] - s[k]) * (place - s[k]) + low)


@exported(void(float64, vector, vector, vector))
def planned_speeds(lap, s, speed, places):
    """Replace arc lengths (m) by the speeds (m/s) that a plan has there; what is no number stays as it is.

    lap: m, of a closed road, which goes on lap after lap; 0: of an open one, constant beyond its ends.
    """
    last, k, before = s.size - 1, 0, math.inf
    for i in range(places.size):
        place = places[i]
        if lap > 0.0:
            place -= floor(place / lap) * lap
        if place <= s[0]:
            places[i] = sqrt(square(speed[0]))
        elif place >= s[last]:
            places[i] = sqrt(square(speed[last]))
        elif place == place:
            k = cell_from(place, k if place >= before else 0, s)
            before = place
            places[i] = speed_between(place, k, s, speed)


@inlined
def motion_at(time, plan):
    """Station (m) and speed (m/s) at a time (s) from the start: lap after lap, or at the end of an open road."""
    s, speed, last = plan.s, plan.speed, plan.s.size - 1
    laps = floor(time / plan.duration) if plan.closed > 0 else 0.0
    inside = min(time - laps * plan.duration, plan.duration)
    if inside >= plan.time[last]:
        return s[last] + laps * s[last], speed[last]
    k = max(last_at(inside, plan.time), 0)
    mean = 0.5 * (speed[k] + speed[k + 1])
    if not mean > 0.0:
        return s[k] + laps * s[last], 0.0
    moving = (s[k + 1] - s[k]) / mean
    since = min(max(inside - (plan.time[k + 1] - moving), 0.0), moving)  # after standing at k
    gained = 0.5 * (square(speed[k + 1]) - square(speed[k])) / (s[k + 1] - s[k]) * since
    return s[k] + (speed[k] + 0.5 * gained) * since + laps * s[last], max(speed[k] + gained, 0.0)


@exported(void(SpeedPlanRecord, vector, vector, vector))
def plan_motion(plan, times, stations, speeds):
    """Write stations (m) and speeds (m/s) at times (s), see `motion_at`."""
    for i in range(times.size):
        stations[i], speeds[i] = motion_at(times[i], plan)

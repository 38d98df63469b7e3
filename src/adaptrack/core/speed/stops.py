"""Stops of a plan: the next one ahead of a car is found from its place and from the stop that was served last.

A stop is known by its place, so that laps, gaps of the calls, a driver and another path change nothing.
"""

from __future__ import annotations

import math

from ..kernel import inlined
from ..maths.exact import floor, sqrt

OVERSHOOT = 2.0
"""m, by which a car that has slid past a stop stays there."""
NEAR_STOP, STOP_TOLERANCE, ARRIVAL_WAY = 0.15, 0.25, 1.0
"""m: a car that stands so near a stop has reached it; so near after it has driven this way."""
SAME_PLACE, MATCHING_DISTANCE, MATCHING_SIGMAS = 1e-3, 0.5, 3.0
"""m, m, -: two stops at one place; distance up to which stops of two paths are the same one, or standard deviations."""
LEFT_DISTANCE, LEFT_SIGMAS = 5.0, 5.0
"""m, -: a car that is so far before a served stop comes to it anew."""
NO_STOP = -1


@inlined
def way_to(place, station, path):
    """Way (m) from a station to a place, negative behind it; around a lap the shorter way."""
    way = place - station
    if path.closed > 0:
        way -= floor(way / path.length + 0.5) * path.length
    return way


@inlined
def is_path_end(k, path):
    """Whether a stop is the end of an open path, at which the car stays."""
    return path.closed == 0 and path.seconds[k] == math.inf and path.stops[k] >= path.length - NEAR_STOP


@inlined
def stop_at(place, distance, path):
    """Index of the stop that is nearest to a place (m) within a distance (m); `NO_STOP` without one."""
    nearest, index = distance, NO_STOP
    for k in range(path.stops.size):
        way = abs(way_to(path.stops[k], place, path))
        if way <= nearest:
            nearest, index = way, k
    return index


@inlined
def forget_served_stop(path, memory):
    """Forget the served stop once the car is clearly before it, or has gone halfway around the lap."""
    way = way_to(memory.served_place, memory.station, path)
    enough = max(LEFT_DISTANCE, LEFT_SIGMAS * sqrt(memory.p_station))
    if way > (min(enough, 0.25 * path.length) if path.closed > 0 else enough):
        memory.served_place = math.nan


@inlined
def next_stop(is_stopping, path, memory):
    """Index of the next stop that is not served, and the way to it (m); `NO_STOP` and inf without one.

    is_stopping: whether the car is stopping for the stop at `memory.stop_place`: one that has no end keeps it, however
    far it has slid. So does the end of an open path.
    """
    index, nearest = NO_STOP, math.inf
    served_way = way_to(memory.served_place, memory.station, path)
    for k in range(path.stops.size):
        way = way_to(path.stops[k], memory.station, path)
        is_kept = is_stopping and path.seconds[k] == math.inf and abs(path.stops[k] - memory.stop_place) < SAME_PLACE
        if way < -OVERSHOOT and not is_kept and not is_path_end(k, path):
            if path.closed == 0:
                continue
            way += path.length
        elif way <= served_way + SAME_PLACE:
            continue
        if way < nearest:
            index, nearest = k, way
    return index, nearest


@inlined
def match_stops(path, memory):
    """Find the stops that the car stands at and has served among those of another path."""
    distance = max(MATCHING_DISTANCE, MATCHING_SIGMAS * sqrt(memory.p_station))
    index = stop_at(memory.stop_place, distance, path)
    memory.stop_place = path.stops[index] if index != NO_STOP else math.nan
    index = stop_at(memory.served_place, distance, path)
    if index != NO_STOP:
        memory.served_place = path.stops[index]

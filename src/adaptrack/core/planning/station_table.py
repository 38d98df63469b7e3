"""A quantity along a road (friction, bank, grade, speed limit, width): a table over the arc length."""

from __future__ import annotations

import math

from ..kernel import exported, inlined, int64, matrix, record, vector, void
from ..maths.exact import floor
from ..maths.trigonometric import cos, sin
from ..roads.road import CLOSED, LENGTH, Centreline, point_at
from ..speed.plan import last_at

AlongRecord = record("AlongRecord", (("s", vector), ("value", vector), ("steps", int64)))
"""Values at ascending arc lengths (m): straight lines between them or, where steps is 1, each up to the next; constant
before the first and after the last. Without values: infinite everywhere."""

Route = record(
    "Route",
    (
        ("line", Centreline), ("friction", AlongRecord), ("bank", AlongRecord), ("speed_limit", AlongRecord),
        ("grade", AlongRecord),
    ),
)  # fmt: skip
"""A road as a plan reads it. bank: rad, positive where gravity pushes to the left; speed_limit: m/s; grade: dz/ds,
positive uphill."""


@inlined
def between(place, k, s, value):
    """The value at a place behind s[k], on a straight line to the next one; constant beyond the first and the last."""
    if k < 0:
        return value[0]
    if k >= s.size - 1:
        return value[k]
    return (value[k + 1] - value[k]) / (s[k + 1] - s[k]) * (place - s[k]) + value[k]


@inlined
def value_at(place, along):
    """The value at an arc length."""
    if along.s.size == 0:
        return math.inf
    k = last_at(place, along.s)
    if along.steps > 0:
        return along.value[max(k, 0)]
    return between(place, k, along.s, along.value)


@inlined
def least_between(start, end, along):
    """The smallest value from `start` to `end`: at the ends and at what lies between."""
    least, k = min(value_at(start, along), value_at(end, along)), last_at(end, along.s)
    while k >= 0 and along.s[k] >= start:
        least = min(least, along.value[k])
        k -= 1
    return least


@inlined
def on_lap(place, line):
    """An arc length on the first lap of a closed road; as it is on an open one."""
    length = line.numbers[LENGTH]
    return place - floor(place / length) * length if line.numbers[CLOSED] > 0.5 else place


@exported(void(AlongRecord, vector))
def along_values(along, places):
    """Replace arc lengths (m) by the values there."""
    for i in range(places.size):
        places[i] = value_at(places[i], along) if places[i] == places[i] else math.nan


@exported(void(AlongRecord, vector, vector, vector))
def along_least(along, starts, ends, least):
    """Write the smallest values between arc lengths (m)."""
    for i in range(least.size):
        least[i] = least_between(starts[i], ends[i], along)


@exported(void(Centreline, AlongRecord, AlongRecord, vector, matrix))
def road_edges(line, left, right, places, edges):
    """Write x, y of the left and x, y of the right edge (m) at each arc length of `places` to the rows of `edges`.

    left, right: m, from the centre line.
    """
    for i in range(places.size):
        x, y, heading, _ = point_at(places[i], line)
        across, along = cos(heading), -sin(heading)
        place = on_lap(places[i], line)
        near, right_edge = value_at(place, left), value_at(place, right)
        edges[i, 0], edges[i, 1] = x + near * along, y + near * across
        edges[i, 2], edges[i, 3] = x - right_edge * along, y - right_edge * across

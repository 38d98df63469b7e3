"""Plan at even places of its road: what the speed control reads, made from arrays in one memory of the caller."""

from __future__ import annotations

import math

from ..kernel import OK, exported, float64, inlined, int64, record, several, vector
from ..maths.bits import whole
from ..maths.exact import ceil, square
from ..maths.trigonometric import sin
from ..physics.forces import GRAVITY
from ..planning.station_table import AlongRecord, value_at
from ..roads.road import CLOSED, LENGTH, Centreline, point_at
from .plan import planned_speeds
from .speed_control import MAX_PLAN_GRADE, slope_of
from .stops import NEAR_STOP

PlanArrays = record(
    "PlanArrays",
    (
        ("line", Centreline), ("s", vector), ("speed", vector), ("grade", AlongRecord), ("bank", AlongRecord),
        ("stops", vector), ("seconds", vector), ("stops_at_end", int64),
    ),
)  # fmt: skip
"""A road and its plan: speeds (m/s) at arc lengths (m), between which the square is straight; grade (dz/ds, positive
uphill) and bank (rad, positive where gravity pushes to the left), empty for a level road; stops (m, ascending) and how
long to stand there (s); stops_at_end: 1: at the end of an open road the car stays, as after a last speed of 0."""

BAD_SPEED, BAD_GRADE, BAD_BANK, BAD_STOP, PLAN_MEMORY_TOO_SMALL = range(1, 6)
"""Statuses of `write_speed_path`: the array with the faulty entry, or a memory that is too small."""
PLAN_ARRAYS = {BAD_SPEED: "speeds", BAD_GRADE: "grades", BAD_BANK: "banks", BAD_STOP: "stops"}
"""Array that a status names."""
PLACE_SPACING = 0.5
"""m, between the places at most."""
MAX_PLAN_BANK, MAX_PLAN_SPEED = 1.4, 100.0
"""rad, m/s: limits of a plan, in addition to `MAX_PLAN_GRADE`."""
STANDSTILL_DISTANCE = 0.5
"""m, from a stop, within which a planned speed may be 0."""
LENGTH_TOLERANCE = 1.0
"""m, between the end of a plan and that of its road."""
INSIDE = 1.0 - 1e-12
"""Share of the length up to which a place is on the road, not beyond its end."""
HORIZON_BRAKING, HORIZON_MARGIN, LEAST_HORIZON = 2.0, 20.0, 4
"""m/s^2, m, cells: the governor looks ahead as far as a car needs that brakes so, and farther by the margin."""


@inlined
def cells_along(length, closed):
    """How many even places a road of some length (m) has."""
    return max(2, whole(ceil(length / PLACE_SPACING - 1e-9)) + (0 if closed else 1))


@exported(int64(float64, int64, int64))
def speed_path_words(length, closed, stops):
    """How many numbers of memory a plan needs along a road of some length (m), with so many stops."""
    return 4 * cells_along(length, closed > 0) + 2 * (stops + 1)


@exported(int64(float64, float64, float64))
def horizon_cells(top_speed, braking, spacing):
    """How many cells the governor looks ahead for a top speed (m/s), the braking of comfort (m/s^2), a spacing (m)."""
    way = square(top_speed) / (2.0 * min(braking, HORIZON_BRAKING)) + HORIZON_MARGIN
    return max(LEAST_HORIZON, whole(ceil(way / spacing)))


@inlined
def _faulty_along(along, largest):
    """The first faulty entry of a grade or a bank; -1 without one."""
    for i in range(along.s.size):
        is_ordered = i == 0 or along.s[i] > along.s[i - 1]
        if not (is_ordered and math.isfinite(along.s[i]) and abs(along.value[i]) <= largest):
            return i
    return -1


@inlined
def _is_at_stop(place, plan):
    """Whether a stop is near an arc length (m)."""
    nearest = math.inf
    for i in range(plan.stops.size):
        nearest = min(nearest, abs(plan.stops[i] - place))
    return nearest <= STANDSTILL_DISTANCE


@inlined
def _faulty_speed(plan, length, closed):
    """The first faulty entry of the speeds; -1 without one. The speed is 0 at stops and at ends of open roads only."""
    count = plan.s.size
    for i in range(count):
        place, speed = plan.s[i], plan.speed[i]
        is_ordered = place > plan.s[i - 1] if i > 0 else place == 0.0
        if not (is_ordered and math.isfinite(place) and 0.0 <= speed <= MAX_PLAN_SPEED):
            return i
        is_inside = i < count - 1 and (closed or i > 0)
        if speed == 0.0 and is_inside and not _is_at_stop(place, plan):
            return i
    if count > 1 and abs(plan.s[count - 1] - length) <= LENGTH_TOLERANCE:
        return -1
    return max(count - 1, 0)


@inlined
def _faulty_stop(plan, length):
    """The first faulty stop; -1 without one."""
    for i in range(plan.stops.size):
        place = plan.stops[i]
        is_ordered = i == 0 or place > plan.stops[i - 1]
        if not (is_ordered and 0.0 <= place <= length and plan.seconds[i] >= 0.0):
            return i
    return -1


@inlined
def _check(plan, length, closed):
    """`OK`, or which array is faulty, and the number of its entry."""
    for status, entry in (
        (BAD_STOP, _faulty_stop(plan, length)),
        (BAD_SPEED, _faulty_speed(plan, length, closed)),
        (BAD_GRADE, _faulty_along(plan.grade, MAX_PLAN_GRADE)),
        (BAD_BANK, _faulty_along(plan.bank, MAX_PLAN_BANK)),
    ):
        if entry >= 0:
            return status, entry
    return OK, 0


@exported(several(int64, int64)(PlanArrays, vector))
def write_speed_path(plan, memory):
    """Write squares of the speeds (m^2/s^2), curvatures (1/m), g sin(slope), g sin(bank) (m/s^2) at even places, then
    stops (m) and how long to stand there (s): the arrays of `core.speed.speed_control.SpeedPath`, one after the other.

    `OK` and the number of stops; or what is wrong, and the number of the entry.
    """
    length, closed = plan.line.numbers[LENGTH], plan.line.numbers[CLOSED] > 0.5
    status, entry = _check(plan, length, closed)
    if status != OK:
        return status, entry
    count, stops = cells_along(length, closed), plan.stops.size
    if memory.size < 4 * count + 2 * (stops + 1):
        return PLAN_MEMORY_TOO_SMALL, 0
    spacing = length / (count if closed else count - 1)
    squares, curvature = memory[:count], memory[count : 2 * count]
    slope, bank = memory[2 * count : 3 * count], memory[3 * count : 4 * count]
    for i in range(count):
        squares[i] = i * spacing
    planned_speeds(plan.s[plan.s.size - 1] if closed else 0.0, plan.s, plan.speed, squares)
    for i in range(count):
        place = i * spacing
        squares[i] = square(squares[i])
        _, _, _, curvature[i] = point_at(min(place, length * INSIDE), plan.line)
        grade = value_at(place, plan.grade) if plan.grade.s.size > 0 else 0.0
        slope[i] = slope_of(grade)
        bank[i] = GRAVITY * sin(value_at(place, plan.bank)) if plan.bank.s.size > 0 else 0.0
    is_end = not closed and (plan.stops_at_end > 0 or plan.speed[plan.s.size - 1] == 0.0)
    is_last = is_end and stops > 0 and plan.stops[stops - 1] >= length - NEAR_STOP  # one stop, which has no end
    ends = stops + 1 if is_end and not is_last else stops
    for i in range(stops):
        memory[4 * count + i], memory[4 * count + ends + i] = plan.stops[i], plan.seconds[i]
    if is_end and not is_last:
        memory[4 * count + stops] = length
    if is_end:
        memory[4 * count + 2 * ends - 1] = math.inf
    return OK, ends

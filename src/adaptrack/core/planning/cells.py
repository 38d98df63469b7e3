"""The places of a plan along a road, and what the road says between neighbouring ones.

Places lie evenly, where the shape of the road changes, and where to stop.
"""

from __future__ import annotations

import math

from ..kernel import columns, exported, float64, inlined, int64, vector
from ..maths.bits import whole
from ..maths.exact import ceil
from ..physics.forces import GRAVITY, slope_sine_and_cosine
from ..roads.road import HALF_LENGTH, POLYNOMIAL_DEGREE, TURN_COEFFICIENTS
from ..speed.plan import last_at
from .station_table import least_between, value_at

PLAN = columns(
    # at the places
    "s",  # m
    "speed",  # m/s
    "time",  # s, of arrival, from the start
    "square",  # m^2/s^2, of the speed
    "ceiling",  # m^2/s^2, the largest square, whatever comes before and after
    "named",  # what bounds it there, a place in `speed.SPEED_LIMIT`
    # between a place and the next; the last one's do not count
    "binding",  # what bounds the planned speed there, a place in `speed.SPEED_LIMIT`
    "first", "last",  # 1/m, curvature behind the place, and before the next
    "curvature",  # 1/m, the larger one of these: between them it is monotonous
    "bank",  # rad
    "friction",  # -, the smallest
    "speed_limit",  # m/s, the smallest; inf: none
    "cornering",  # m/s^2, that the car can corner with; inf: any
    "margins",  # m^2/s^2, square of the speed up to which the controller's margins hold; inf: any
    "tilt",  # m/s^2, pull of the bank to the left
    "grip",  # m/s^2, what may be used of the friction
    "grade",  # -, dz/ds, positive uphill
    "slope",  # m/s^2, deceleration by gravity, g sin(atan(grade))
    "cosine",  # -, of the slope
)  # fmt: skip
"""Rows of a plan's table."""
FINEST = 1e-3
"""m, between even places at least."""
TOGETHER = 1e-6
"""Share of the spacing within which two places are one: the stop, if one of them is a stop."""


@exported(int64(vector, float64, vector, vector))
def plan_places(start, spacing, stops, places):
    """Write ascending places (m) of a plan, as many as there is room for, and return their count.

    start: m, where the pieces of the road begin, and its end; spacing: m, of the even places at most; stops: m,
    ascending. 0: the length or the spacing is no number to make places of. A car may stand at the ends and at stops:
    between two of these there is always another place, at which it moves.
    """
    length = start[start.size - 1]
    if not (FINEST <= spacing < math.inf and 0.0 < length < math.inf):
        return 0
    cells = max(2, whole(ceil(length / spacing)))
    step, before, count, stood = length / cells, -math.inf, 0, False
    i, j, k = 0, 0, 0
    while i <= cells or j < start.size or k < stops.size:
        even = math.inf if i > cells else (length if i == cells else i * step)
        shape = start[j] if j < start.size else math.inf
        stop = stops[k] if k < stops.size else math.inf
        place = min(even, min(shape, stop))
        stands = stop == place or count == 0 or place == length
        is_new = place - before > TOGETHER * spacing
        if is_new and stands and stood:
            count = _append(0.5 * (before + place), count, places)
        if is_new:
            count = _append(place, count, places)
        elif stands and not stood:  # the stop takes the place of the one beside it
            count = _append(place, count - 1, places)
        if is_new or (stands and not stood):
            before, stood = place, stands
        i, j, k = i + (even == place), j + (shape == place), k + (stop == place)
    if count <= places.size:
        places[count - 1] = length
    return count


@inlined
def _append(place, count, places):
    """Write a place behind the first `count` ones, if there is room for it, and return their count."""
    if count < places.size:
        places[count] = place
    return count + 1


@inlined
def _curvature_at(place, row, line):
    """1/m, of a piece."""
    piece = line.pieces[row]
    u = (place - line.start[row]) / piece[HALF_LENGTH] - 1.0
    slope = POLYNOMIAL_DEGREE * piece[TURN_COEFFICIENTS + POLYNOMIAL_DEGREE]
    for k in range(POLYNOMIAL_DEGREE - 1, 0, -1):
        slope = slope * u + k * piece[TURN_COEFFICIENTS + k]
    return slope / piece[HALF_LENGTH]


@inlined
def write_cells(route, spacing, stops, table):
    """Write the places and what the road says between them; any cornering, and any margins.

    Stops (m) are moved to the places at which the car stands.
    """
    line, s, row = route.line, table[PLAN.s], 0
    plan_places(line.start, spacing, stops, s)
    for i in range(stops.size):
        k = min(last_at(stops[i], s), s.size - 2)
        stops[i] = s[k] if stops[i] - s[k] < s[k + 1] - stops[i] else s[k + 1]
    for k in range(s.size - 1):
        start, there = s[k], s[k + 1]
        while row + 1 < len(line.pieces) and line.start[row + 1] <= start:
            row += 1
        first = _curvature_at(start, row, line)
        while row + 1 < len(line.pieces) and line.start[row + 1] < there:
            row += 1
        last = _curvature_at(there, row, line)
        table[PLAN.first, k], table[PLAN.last, k] = first, last
        table[PLAN.curvature, k] = first if abs(first) > abs(last) else last
        table[PLAN.bank, k] = value_at(0.5 * (start + there), route.bank)
        grade = value_at(0.5 * (start + there), route.grade)
        sine, cosine = slope_sine_and_cosine(grade)
        table[PLAN.grade, k], table[PLAN.slope, k], table[PLAN.cosine, k] = grade, GRAVITY * sine, cosine
        table[PLAN.friction, k] = least_between(start, there, route.friction)
        table[PLAN.speed_limit, k] = least_between(start, there, route.speed_limit)
        table[PLAN.cornering, k] = table[PLAN.margins, k] = math.inf

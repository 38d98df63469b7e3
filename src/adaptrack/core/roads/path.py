"""A centre line through points without noise, such as a planner publishes, in memory of the caller.

A cubic spline over the length of the points' polygon, its third derivative continuous at the second point and at the
last but one ("not a knot"), or periodic: it goes through every point, with continuous curvature (C. de Boor, A
Practical Guide to Splines, 1978, chapter IV). From point to point it becomes pieces of `road`: polynomials of its
arc length. The speed |dc/dz| over a range of the parameter z is interpolated at Chebyshev nodes and integrated, the
arc lengths of the nodes of a piece are found by Newton's method, and position and heading are interpolated there. A
piece that misses the cubic by more than `FIT` between its nodes, or turns by more than 1 rad, is halved.

A short step magnifies the error of its points: an error e across a step h turns the curve by e/h over the long steps
around it. So points that are much nearer to each other than to the points around them count as one (`points_apart`).
The path goes through the first of them, unless that point is off the curve of the points around it: it then goes
through the place between them that is nearest to that curve.

The memory then holds a road alone as `road.Roads` has it: its numbers, pieces, where they begin, and headings.
"""

from __future__ import annotations

import math

import numpy as np

from ..kernel import (
    OK,
    boolean,
    exported,
    float64,
    inlined,
    int64,
    int_vector,
    local,
    matrix,
    several,
    shaped,
    vector,
    void,
)
from ..maths.bits import whole
from ..maths.exact import ceil, floor, sqrt
from ..maths.exponential import hypot
from ..maths.trigonometric import arctangent_of_ratio, atan2
from . import road
from .noise import index_on_lap, noise_of, smooth_points

TOO_FEW, POINT_NOT_FINITE, POINT_TOO_FAR, TOO_SHORT, PATH_KINK, TOO_SMALL = range(1, 7)
"""Statuses of `path_through`: a path; fewer points than `MIN_PATH_POINTS` apart from each other; a number that is not
finite; a coordinate beyond `MAX_COORDINATE`, or a point farther than `WIDEST` from the next one; a line shorter than
`MIN_PATH_LENGTH`; points that fold back on themselves; a memory that is too small."""
MIN_PATH_POINTS, MAX_COORDINATE, WIDEST, MIN_PATH_LENGTH = 4, 1e8, 1e4, 0.01
"""Points, m, m, m."""
GROUP_SHARE, GROUP_LENGTH = 0.5, 0.2
"""Points in a row count as one if their distance from the first is at most this share of the step on either side, and
at most this long (m)."""
GROUP_MISS = 0.002
"""1/m: a point that misses the curve of the points around it by more than this share of the product of the steps to
either side is off it. A cubic spline through such a point bends by 4.4 times as much: 114 m of radius."""

HEADING_INTERVAL = 0.5
"""m, at most, between the entries of a road's table of headings, from which an MPC reads what lies ahead."""
STRAIGHTER = 1.25
"""Times the length of their polygon that a path is expected to be long at most."""
PATH_SCRATCH = 8
"""Numbers for each point that are needed while a path is made."""
TURN = 1.0
"""rad, the largest turn of a piece: the remainder of its polynomials is then below 1e-16 of the length for an arc."""
FIT, CURVATURE_FIT, PIECE_ROUNDING = 1e-11, 1e-9, 1e-12
"""Largest errors of a piece: of its position, as a share of its length (or of 1 m); of its curvature, as a share of it
(or of 0.1/m); and of its heading (rad) by rounding."""
KINK_HALVINGS = 12
"""Of the way from a point to the next, before there counts as being a kink."""
JOINT = 1e-6
"""rad, the largest jump of the heading between two pieces, which rounding leaves."""
NEWTON = 7
"""Most steps; each squares the error, which begins within 1. An odd number, see `_write_places`."""

NODES = road.POLYNOMIAL_DEGREE + 1
_GRID = 2**20
_CHEBYSHEV = [round(-math.cos(math.pi * (k + 0.5) / NODES) * _GRID) for k in range(NODES)]  # of few digits: exact
_PLACES = np.array([k / _GRID for k in _CHEBYSHEV] + [0.0, -1.0, -0.93, -0.55, 0.21, 0.62, 0.96, 1.0])
"""Where a piece is looked at, -1 to 1: at its nodes, in its middle, and where else its fit is tested."""
_COUNT, _MIDDLE = _PLACES.size, NODES


def _lagrange(k):
    """The coefficients of the polynomial that is 1 at a node and 0 at the others; of whole numbers, rounded once."""
    product, scale = [1], 1
    for other in _CHEBYSHEV[:k] + _CHEBYSHEV[k + 1 :]:
        product = [a - other * b for a, b in zip([0, *product], [*product, 0], strict=True)]
        scale *= _CHEBYSHEV[k] - other
    return [coefficient * _GRID**j / scale for j, coefficient in enumerate(product)]


_BASIS = np.array([_lagrange(k) for k in range(NODES)])
_at_places, _of_nodes, _three, _four = local(_COUNT), local(NODES), local(3), local(4)


# -- the memory -------------------------------------------------------------------------------------------------------
@inlined
def cells_of(length):
    """Between the headings of a path of some length (m)."""
    return max(1, whole(ceil(length / HEADING_INTERVAL)))


@exported(int64(matrix, boolean))
def path_words(points, closed):
    """How many numbers of memory are enough for a path through points (n, 2); 0 for too few of them.

    For every step a piece, and a fourth more: enough where bends between two points are below about 1 rad.
    """
    count, length = len(points), 0.0
    if count < MIN_PATH_POINTS or points.shape[1] < 2:
        return 0
    for k in range(count if closed else count - 1):
        dx, dy = _step(points, k)
        length += hypot(dx, dy)
    cells = cells_of(STRAIGHTER * length if length <= WIDEST * count else 0.0)  # else `path_through` says what is wrong
    return PATH_SCRATCH * count + words_of(count + count // 4 + 16, cells)


@inlined
def words_of(count, cells):
    """The numbers of a path of so many pieces, and cells between headings."""
    return len(road.LINE_NUMBERS) + road.PIECE_COLUMNS * count + count + 1 + cells + 1


@inlined
def line_in(memory):
    """The centre line, and the table of headings, of the path that a memory holds."""
    first = len(road.LINE_NUMBERS)
    count, cells = whole(memory[road.COUNT]), cells_of(memory[road.LENGTH])
    start = first + road.PIECE_COLUMNS * count
    headings = start + count + 1
    pieces = shaped(memory[first:start], count, road.PIECE_COLUMNS)
    line = road.Centreline(memory[start:headings], pieces, memory[:first])
    return line, memory[headings : headings + cells + 1]


# -- the spline -------------------------------------------------------------------------------------------------------
@inlined
def _step(points, k):
    """From a point to the next one, that of the last being the first: m, m."""
    after = k + 1 if k + 1 < len(points) else 0
    return points[after, 0] - points[k, 0], points[after, 1] - points[k, 1]


@inlined
def _flaw(points, closed):
    """`OK`, or the status of points that make no path, and the number of the point."""
    count = len(points)
    if count < MIN_PATH_POINTS or points.shape[1] < 2:
        return TOO_FEW, count
    for k in range(count):
        size = max(abs(points[k, 0]), abs(points[k, 1]))
        if not abs(points[k, 0]) + abs(points[k, 1]) < math.inf:
            return POINT_NOT_FINITE, k
        if size > MAX_COORDINATE:
            return POINT_TOO_FAR, k
    for k in range(count if closed else count - 1):
        dx, dy = _step(points, k)
        if hypot(dx, dy) > WIDEST:
            return POINT_TOO_FAR, k
    return OK, 0


@inlined
def _group(points, first, last, before):
    """The last point of the group of points that begins with `first`, and the step (m) behind it; 0 at the end.

    last: number of the last point; before: m, the step to `first`, which does not count for the first point of all.
    """
    most = GROUP_LENGTH if first == 0 else min(GROUP_LENGTH, GROUP_SHARE * before)
    end, step, extent = first, 0.0, 0.0
    start = first if first < len(points) else 0  # the last point of a lap is its first one
    for k in range(first, last + 1):
        point = k if k < len(points) else 0
        extent = max(extent, hypot(points[point, 0] - points[start, 0], points[point, 1] - points[start, 1]))
        if extent > most:
            break
        after = 0.0
        if k < last:
            dx, dy = _step(points, k)
            after = hypot(dx, dy)
        if extent <= GROUP_SHARE * after or (k == last and first > 0):
            end, step = k, after
    return end, step


@inlined
def _miss(x, y, t, base, point_x, point_y):
    """The distance (m) of a point from the cubic through four points at t (m), positive to the left of the step from
    the point `base` to the next; and the product of the distances (m^2) from both, along that step.
    """
    length = t[base + 1] - t[base]
    ahead_x, ahead_y = (x[base + 1] - x[base]) / length, (y[base + 1] - y[base]) / length
    way = (point_x - x[base]) * ahead_x + (point_y - y[base]) * ahead_y
    off_x, off_y = point_x, point_y
    for j in range(4):
        weight = 1.0
        for i in range(4):
            if i != j:
                weight *= (t[base] + way - t[i]) / (t[j] - t[i])
        off_x, off_y = off_x - weight * x[j], off_y - weight * y[j]
    return ahead_x * off_y - ahead_y * off_x, abs(way * (length - way))


@inlined
def _place_in_group(points, rows, k, window, begin, end, first_choice):
    """The number of the point, with a fraction between two, at which a path meets its group k, points `begin` to `end`.

    rows: (n,) a point of each group; window: number of the first of the five groups with k that show the curve; usual:
    the point that the path meets unless it is off their curve. Numbers below 0 count from the end.
    """
    x, y, t, j = _four(), _four(), _four(), 0
    for group in range(window, window + 5):
        if group != k:
            row = index_on_lap(whole(rows[index_on_lap(group, rows.size)]), len(points))
            x[j], y[j] = points[row, 0], points[row, 1]
            t[j] = t[j - 1] + hypot(x[j] - x[j - 1], y[j] - y[j - 1]) if j > 0 else 0.0
            j += 1
    base = min(max(k - window - 1, 0), 2)
    least, product = _miss(x, y, t, base, points[first_choice, 0], points[first_choice, 1])
    place, before = float(first_choice), 0.0
    if abs(least) <= GROUP_MISS * product:
        return place
    least = 0.5 * abs(least)  # a curve that bends too much for four points misses all of a group alike
    for row in range(begin, end + 1):
        point = index_on_lap(row, len(points))
        miss, product = _miss(x, y, t, base, points[point, 0], points[point, 1])
        if row > begin and miss * before < 0.0:
            return row - 1 + before / (before - miss)
        if abs(miss) < least:
            place, least = float(row), abs(miss)
        before = miss
    return place


@exported(int64(matrix, boolean, vector))
def points_apart(points, closed, rows):
    """Write where a path meets points (n, 2) to `rows` (n,), and return how many: numbers of points in their order.

    Of a group of points that count as one (`GROUP_SHARE`) it is the first, at the end of an open path the last; or a
    place in the group, with a fraction between two points, if that one is off the curve of the points around them. On a
    lap the last points may belong to the first group: such a place has a number from -n on.
    """
    n = len(points)
    last = n if closed else n - 1  # that of a lap is its first point again
    count, first, before, stop = 0, 0, 0.0, n
    while first <= last:
        end, before = _group(points, first, last, before)
        if closed and first > 0 and end == last:
            stop = first
        else:
            rows[count] = float(first)
            count += 1
        first = end + 1
    for k in range(count):
        first, end = whole(rows[k]), (whole(rows[k + 1]) if k + 1 < count else stop) - 1
        first_choice = end if k > 0 and k == count - 1 and not closed else first
        begin = stop - n if closed and k == 0 else first
        window = k - 2 if closed else max(min(k - 2, count - 5), 0)
        rows[k] = float(first_choice)
        if begin < end and count >= 5:
            rows[k] = _place_in_group(points, rows[:count], k, window, begin, end, first_choice)
    return count


@inlined
def _write_steps(points, closed, lengths):
    """Write the lengths (m) of the steps of points that lie apart; `OK`, or the status of those that make no path."""
    count, total = len(points), 0.0
    if count < MIN_PATH_POINTS:
        return TOO_FEW, count
    for k in range(count if closed else count - 1):
        dx, dy = _step(points, k)
        lengths[k] = hypot(dx, dy)
        total += lengths[k]
    return (TOO_SHORT if total < MIN_PATH_LENGTH else OK), 0


@inlined
def _condition(points, closed, lengths, k):
    """An equation of the slopes (dx/ds, dy/ds) at a point, the one before it and the one after: their factors, and x
    and y of the right side: continuous curvature, or at an end no knot at the point beside it.
    """
    last = len(points) - 1
    if closed or 0 < k < last:
        before = k - 1 if k > 0 else last
        h, g = lengths[before], lengths[k]
        (ax, ay), (bx, by) = _step(points, before), _step(points, k)
        below, above = 3.0 * g / h, 3.0 * h / g
        return g, 2.0 * (h + g), h, below * ax + above * bx, below * ay + above * by
    near, inner = (0, 1) if k == 0 else (last - 1, last - 2)
    h, g = lengths[near], lengths[inner]
    (ax, ay), (bx, by) = _step(points, near), _step(points, inner)
    both = h + g
    first, second = (h + 2.0 * both) * g / (both * h), h * h / (both * g)
    spacing = 0.0 if k == 0 else both
    return spacing, g, both - spacing, first * ax + second * bx, first * ay + second * by


@inlined
def _write_slopes(points, closed, lengths, upper, x, y, border):
    """Write the slopes at the points to x and y: by elimination, of a lap with the last slope as a border."""
    count = len(points)
    rows = count - 1 if closed else count
    last = rows - 1
    for k in range(rows):
        below, on, above, right_x, right_y = _condition(points, closed, lengths, k)
        edge = 0.0
        if closed and k == 0:
            edge, below = -below, 0.0
        if closed and k == last:
            edge, above = edge - above, 0.0
        if k > 0:
            on -= below * upper[k - 1]
            right_x, right_y = right_x - below * x[k - 1], right_y - below * y[k - 1]
            edge -= below * border[k - 1]
        upper[k], border[k] = above / on, edge / on
        x[k], y[k] = right_x / on, right_y / on
    for k in range(last - 1, -1, -1):
        x[k], y[k] = x[k] - upper[k] * x[k + 1], y[k] - upper[k] * y[k + 1]
        border[k] -= upper[k] * border[k + 1]
    if closed:
        below, on, above, right_x, right_y = _condition(points, closed, lengths, rows)
        on += below * border[last] + above * border[0]
        x[rows] = (right_x - below * x[last] - above * x[0]) / on
        y[rows] = (right_y - below * y[last] - above * y[0]) / on
        for k in range(rows):
            x[k] += border[k] * x[rows]
            y[k] += border[k] * y[rows]


# -- a piece of it ----------------------------------------------------------------------------------------------------
@inlined
def _value(coefficients, u):
    """A polynomial at u."""
    value = coefficients[road.POLYNOMIAL_DEGREE]
    for k in range(road.POLYNOMIAL_DEGREE - 1, -1, -1):
        value = value * u + coefficients[k]
    return value


@inlined
def _interpolate(values, coefficients):
    """Write the coefficients of the polynomial through values at the nodes."""
    for j in range(NODES):
        coefficient = 0.0
        for k in range(NODES):
            coefficient += values[k] * _BASIS[k, j]
        coefficients[j] = coefficient


@inlined
def _write_places(x, y, z):
    """Write the parameters z, -1 to 1, of the places by arc length of a curve dx/dz = x1 + x2 z + x3 z^2, likewise y.

    Half of its length (m), and the largest error of that length (m), which counts Newton's last step in.
    """
    speed, rate, step, earlier = _at_places(), _of_nodes(), _at_places(), _at_places()
    for k in range(_COUNT):
        u = _PLACES[k]
        dx, dy = x[0] + u * (x[1] + u * x[2]), y[0] + u * (y[1] + u * y[2])
        speed[k] = sqrt(dx * dx + dy * dy)
        z[k] = u
    _interpolate(speed, rate)
    error = half = middle = 0.0
    for k in range(NODES, _COUNT):
        error = max(error, 2.0 * abs(_value(rate, _PLACES[k]) - speed[k]))
    for k in range(NODES):  # the length from 0 to z is the sum of rate z^(k+1)/(k+1)
        even = k % 2 == 0
        half += rate[k] / (k + 1) if even else 0.0
        middle += 0.0 if even else rate[k] / (k + 1)
    for n in range(NEWTON):
        if n % 2 == 1:  # an even number of steps before the last one: it repeats the places of two steps ago
            k = 0
            while k < _COUNT and z[k] == earlier[k]:
                k += 1
            if k == _COUNT:
                break
            earlier[:] = z
        for k in range(_COUNT):
            way = slope = 0.0
            for j in range(road.POLYNOMIAL_DEGREE, -1, -1):
                way = way * z[k] + rate[j] / (j + 1)
                slope = slope * z[k] + rate[j]
            step[k] = (middle + half * _PLACES[k] - way * z[k]) / slope
            z[k] += step[k]
    for k in range(_COUNT):
        error = max(error, abs(step[k]) * half) if abs(z[k]) < 2.0 else math.inf
    return half, error


@inlined
def _write_piece(x1, x2, x3, y1, y2, y3, piece):
    """Write a piece of the curve x1 z + x2 z^2 + x3 z^3, -1 <= z <= 1, likewise y, that lies about the curve's place
    at z = 0; whether it fits.
    """
    z, slopes_x, slopes_y = _at_places(), _three(), _three()
    slopes_x[0], slopes_x[1], slopes_x[2] = x1, 2.0 * x2, 3.0 * x3
    slopes_y[0], slopes_y[1], slopes_y[2] = y1, 2.0 * y2, 3.0 * y3
    half, error = _write_places(slopes_x, slopes_y, z)
    reach = max(2.0 * half, 1.0)
    if not (half > 0.0 and error <= FIT * reach):
        return False
    # about its middle, z = m, along the tangent there: a z + b z^2 + c z^3 and d z^2 + e z^3
    m = z[_MIDDLE]
    tx, ty = x1 + m * (2.0 * x2 + 3.0 * m * x3), y1 + m * (2.0 * y2 + 3.0 * m * y3)
    a = sqrt(tx * tx + ty * ty)
    if not a > 0.0:
        return False
    cosine, sine = tx / a, ty / a
    bend_x, bend_y = x2 + 3.0 * m * x3, y2 + 3.0 * m * y3
    b, d = cosine * bend_x + sine * bend_y, cosine * bend_y - sine * bend_x
    c, e = cosine * x3 + sine * y3, cosine * y3 - sine * x3
    along, across, turned, curvature = _at_places(), _at_places(), _at_places(), _at_places()
    ahead, aside = _at_places(), _at_places()
    for k in range(_COUNT):
        u = z[k] - m
        along[k], across[k] = u * (a + u * (b + u * c)), u * u * (d + u * e)
        ahead[k], aside[k] = a + u * (2.0 * b + 3.0 * u * c), u * (2.0 * d + 3.0 * u * e)
    for k in range(_COUNT):
        if not ahead[k] > 0.0:
            return False
    for k in range(_COUNT):  # loops without a way out, which compilers turn into vector operations
        turned[k] = arctangent_of_ratio(aside[k], ahead[k])
    for k in range(_COUNT):
        u, square = z[k] - m, ahead[k] * ahead[k] + aside[k] * aside[k]
        across_change = ahead[k] * (2.0 * d + 6.0 * u * e) - aside[k] * (2.0 * b + 6.0 * u * c)
        curvature[k] = across_change / (square * sqrt(square))
    for k in range(_COUNT):
        if not abs(turned[k]) <= TURN:
            return False
    _interpolate(along, piece[road.ALONG_COEFFICIENTS : road.ACROSS_COEFFICIENTS])
    _interpolate(across, piece[road.ACROSS_COEFFICIENTS : road.TURN_COEFFICIENTS])
    _interpolate(turned, piece[road.TURN_COEFFICIENTS : road.PIECE_COLUMNS])
    piece[road.ALONG_COEFFICIENTS] = 0.0  # the frame is at the middle
    piece[road.ACROSS_COEFFICIENTS] = 0.0
    piece[road.TURN_COEFFICIENTS] = 0.0
    miss_squares, bend_errors = _at_places(), _at_places()
    for k in range(NODES, _COUNT):
        u = _PLACES[k]
        off_x = _value(piece[road.ALONG_COEFFICIENTS : road.ACROSS_COEFFICIENTS], u) - along[k]
        off_y = _value(piece[road.ACROSS_COEFFICIENTS : road.TURN_COEFFICIENTS], u) - across[k]
        miss_squares[k] = off_x * off_x + off_y * off_y
        bent = 0.0
        for j in range(road.POLYNOMIAL_DEGREE, 0, -1):
            bent = bent * u + j * piece[road.TURN_COEFFICIENTS + j]
        bend_errors[k] = abs(bent / half - curvature[k])
    for k in range(NODES, _COUNT):
        allowed = CURVATURE_FIT * (abs(curvature[k]) + 0.1) + PIECE_ROUNDING / (2.0 * half)
        if not (miss_squares[k] <= (FIT * reach) * (FIT * reach) and bend_errors[k] <= allowed):
            return False
    piece[road.HALF_LENGTH], piece[road.COS], piece[road.SIN] = half, cosine, sine
    piece[road.HEADING] = atan2(sine, cosine)
    piece[road.X], piece[road.Y] = m * (x1 + m * (x2 + m * x3)), m * (y1 + m * (y2 + m * y3))
    return True


# -- the path ---------------------------------------------------------------------------------------------------------
@inlined
def _heading_at(piece, u):
    """rad, of the end of a piece."""
    return piece[road.HEADING] + _value(piece[road.TURN_COEFFICIENTS : road.PIECE_COLUMNS], u)


@inlined
def _turns(angle):
    """The whole turns (rad) that are nearest to an angle."""
    return 2.0 * math.pi * floor(angle / (2.0 * math.pi) + 0.5)


@inlined
def _jump(before, after):
    """rad, by which the heading of a piece begins beyond the end of another."""
    return _heading_at(after, -1.0) - _heading_at(before, 1.0)


@inlined
def _kinked(jump):
    """Whether a jump of the heading is more than whole turns."""
    return not abs(jump - _turns(jump)) <= JOINT


@inlined
def _write_step(x, y, begin_x, begin_y, end_x, end_y, pieces, first):
    """Write the pieces of a step (x, y) from (0, 0), of slopes at its begin and end (m); halved until its parts fit.

    `OK` and the number of the next piece; or what is wrong.
    """
    x2, x3 = 3.0 * x - (2.0 * begin_x + end_x), begin_x + end_x - 2.0 * x
    y2, y3 = 3.0 * y - (2.0 * begin_y + end_y), begin_y + end_y - 2.0 * y
    count, part, level, w = first, 0, 0, 0.5
    while level > 0 or part == 0:
        if count == len(pieces):
            return TOO_SMALL, count
        p, piece = (2 * part + 1) * w, pieces[count]
        fits = _write_piece(
            w * (begin_x + p * (2.0 * x2 + 3.0 * p * x3)), w * w * (x2 + 3.0 * p * x3), w * w * w * x3,
            w * (begin_y + p * (2.0 * y2 + 3.0 * p * y3)), w * w * (y2 + 3.0 * p * y3), w * w * w * y3, piece,
        )  # fmt: skip
        if not fits:
            if level == KINK_HALVINGS:
                return PATH_KINK, count
            part, level, w = 2 * part, level + 1, 0.5 * w
            continue
        piece[road.X] += p * (begin_x + p * (x2 + p * x3))
        piece[road.Y] += p * (begin_y + p * (y2 + p * y3))
        if count > 0:
            jump = _jump(pieces[count - 1], piece)
            piece[road.HEADING] -= _turns(jump)
            if _kinked(jump):
                return PATH_KINK, count
        count, part = count + 1, part + 1
        while level > 0 and part % 2 == 0:
            part, level, w = part // 2, level - 1, 2.0 * w
    return OK, count


@exported(several(int64, int64)(matrix, matrix, int_vector))
def write_cubics(steps, pieces, counts):
    """Write the pieces of cubics, and the number of pieces of each cubic.

    steps: (n, 6) m, of each cubic the vector from its begin to its end, then its slopes at begin and end over a
    parameter from 0 to 1. The pieces lie relative to the begin of their cubic. Returns `OK` and the number of pieces;
    or `TOO_SMALL` or `PATH_KINK`, and the number of the cubic that does not fit into `pieces` or has a cusp.
    """
    total = 0
    for k in range(len(steps)):
        status, count = _write_step(
            steps[k, 0], steps[k, 1], steps[k, 2], steps[k, 3], steps[k, 4], steps[k, 5], pieces[total:], 0
        )
        if status != OK:
            return status, k
        counts[k] = count
        total += count
    return OK, total


@exported(void(vector, matrix, boolean, vector))
def line_numbers(start, pieces, closed, numbers):
    """Write the numbers of a `Centreline`: length, whether closed, growth of the heading in a lap, most curvature."""
    last, most = len(pieces) - 1, 0.0
    for row in range(last + 1):
        slopes = 0.0
        for j in range(1, road.POLYNOMIAL_DEGREE + 1):
            slopes += j * abs(pieces[row, road.TURN_COEFFICIENTS + j])
        most = max(most, slopes / pieces[row, road.HALF_LENGTH])
    numbers[road.LENGTH], numbers[road.CLOSED] = start[last + 1], 1.0 if closed else 0.0
    numbers[road.MOST_CURVATURE] = most
    numbers[road.LAP_TURN] = -_turns(_jump(pieces[last], pieces[0])) if closed else 0.0


@inlined
def _write_points(points, rows, path_points):
    """Write the points (n, 2) at some numbers (`points_apart`), and these numbers, to the rows of `path_points`."""
    for k in range(len(path_points)):
        number = whole(floor(rows[k]))
        share, row = rows[k] - number, index_on_lap(number, len(points))
        path_points[k, 0], path_points[k, 1], path_points[k, 2] = points[row, 0], points[row, 1], row
        if share > 0.0:
            x, y = _step(points, row)
            path_points[k, 0], path_points[k, 1] = path_points[k, 0] + share * x, path_points[k, 1] + share * y


@exported(several(int64, int64)(matrix, boolean, float64, vector))
def path_through(points, closed, noise, memory):
    """Make the path through points (n, 2) of x, y (m), a lap if `closed`: it then ends before its start.

    noise: m, standard deviation of x and y, without which the points are taken; NaN: that of `noise_of`. `OK` and the
    number of pieces, for `line_in`; or what is wrong, and the number of the point: nothing that the memory then holds
    is to be used. The path goes through `points_apart`.
    """
    count, head, columns = len(points), len(road.LINE_NUMBERS), road.PIECE_COLUMNS
    scratch = memory.size - PATH_SCRATCH * count
    room = min((scratch - head) // columns, (memory.size - words_of(0, 1)) // (columns + 1))
    if count >= MIN_PATH_POINTS and room < count:
        return TOO_SMALL, 0
    status, flaw = _flaw(points, closed)
    if status != OK:
        return status, flaw
    lengths, x, y = memory[scratch:], memory[scratch + count :], memory[scratch + 2 * count :]
    upper, border, copies = memory[scratch + 3 * count :], memory[scratch + 4 * count :], memory[scratch + 5 * count :]
    count = points_apart(points, closed, lengths)
    path_points = shaped(copies[: 3 * count], count, 3)
    _write_points(points, lengths, path_points)
    if not noise >= 0.0:
        noise = noise_of(path_points, closed, lengths)
    if noise > 0.0 and count >= MIN_PATH_POINTS:
        smooth_points(path_points, closed, noise, memory[head:scratch])
    status, flaw = _write_steps(path_points, closed, lengths)
    if status != OK:
        return status, flaw
    _write_slopes(path_points, closed, lengths, upper, x, y, border)
    pieces = shaped(memory[head : head + columns * room], room, columns)
    n_written = 0
    for k in range(count if closed else count - 1):
        after, h = k + 1 if k + 1 < count else 0, lengths[k]
        dx, dy = _step(path_points, k)
        first = n_written
        status, n_written = _write_step(dx, dy, h * x[k], h * y[k], h * x[after], h * y[after], pieces, first)
        if status != OK:
            return status, whole(path_points[k, 2])
        for row in range(first, n_written):
            pieces[row, road.X] += path_points[k, 0]
            pieces[row, road.Y] += path_points[k, 1]
    if closed and _kinked(_jump(pieces[n_written - 1], pieces[0])):
        return PATH_KINK, 0
    start = memory[head + columns * n_written :]
    start[0] = 0.0
    for row in range(n_written):
        start[row + 1] = start[row] + 2.0 * pieces[row, road.HALF_LENGTH]
    cells = cells_of(start[n_written])
    if words_of(n_written, cells) > memory.size:
        return TOO_SMALL, len(points) - 1
    line_numbers(start[: n_written + 1], pieces[:n_written], closed, memory)
    memory[road.FIRST_START] = memory[road.FIRST_PIECE] = memory[road.FIRST_HEADING] = 0.0
    memory[road.COUNT], memory[road.HEADING_SPACING] = n_written, start[n_written] / cells
    line, headings = line_in(memory)
    road.headings_along(line, headings)
    return OK, n_written


@exported(several(int64, int64, int64, int64)(vector))
def path_parts(memory):
    """Return the parts of a path in the memory of `path.path_through`: pieces, places, starts and headings.

    There is one start more than pieces; the headings go on to the end of a part of `heading_count`.
    """
    count, first = whole(memory[road.COUNT]), len(road.LINE_NUMBERS)
    start = first + road.PIECE_COLUMNS * count
    return count, first, start, start + count + 1


@exported(int64(vector))
def heading_count(numbers):
    """Entries of the table of headings of a road of these numbers (`road.LINE_NUMBERS`)."""
    return cells_of(numbers[road.LENGTH]) + 1

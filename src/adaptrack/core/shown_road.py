"""A road for a program that shows it and drives on it: its edges, and its parts in the memory of `path_through`."""

from __future__ import annotations

from .kernel import exported, int64, matrix, several, vector, void
from .maths.bits import whole
from .maths.trigonometric import cos, sin
from .path import COLUMNS, cells_of
from .road import COUNT, LENGTH, NUMBERS, Centreline, point_at


@exported(void(Centreline, vector, vector, vector, matrix))
def edges_along(road, s, left, right, points):
    """Write x, y (m) of the centre line, of the left and of the right edge at arc lengths to the rows of points (n, 6).

    left, right: m, from the centre line to its edges there.
    """
    for i in range(s.size):
        x, y, heading, _ = point_at(s[i], road)
        ahead, across = cos(heading), sin(heading)
        points[i, 0], points[i, 1] = x, y
        points[i, 2], points[i, 3] = x - left[i] * across, y + left[i] * ahead
        points[i, 4], points[i, 5] = x + right[i] * across, y - right[i] * ahead


@exported(several(int64, int64, int64, int64)(vector))
def path_parts(memory):
    """Of a path in the memory of `path.path_through`: its pieces, and where they, their starts and the headings begin.

    There is one start more than pieces; the headings go on to the end of a part of `heading_count`.
    """
    count, first = whole(memory[COUNT]), len(NUMBERS)
    start = first + COLUMNS * count
    return count, first, start, start + count + 1


@exported(int64(vector))
def heading_count(numbers):
    """Entries of the table of headings of a road of these numbers (`road.NUMBERS`)."""
    return cells_of(numbers[LENGTH]) + 1

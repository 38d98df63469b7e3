"""The parts of a path in the memory of `path.path_through`, for a program that lays them into `road.Roads`."""

from __future__ import annotations

from ..kernel import exported, int64, several, vector
from ..maths.bits import whole
from .path import cells_of
from .road import COUNT, LENGTH, LINE_NUMBERS, PIECE_COLUMNS


@exported(several(int64, int64, int64, int64)(vector))
def path_parts(memory):
    """Return the parts of a path in the memory of `path.path_through`: pieces, places, starts and headings.

    There is one start more than pieces; the headings go on to the end of a part of `heading_count`.
    """
    count, first = whole(memory[COUNT]), len(LINE_NUMBERS)
    start = first + PIECE_COLUMNS * count
    return count, first, start, start + count + 1


@exported(int64(vector))
def heading_count(numbers):
    """Entries of the table of headings of a road of these numbers (`road.LINE_NUMBERS`)."""
    return cells_of(numbers[LENGTH]) + 1

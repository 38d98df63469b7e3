"""A centre line as polynomials of its arc length: what the compiled projection reads, tabulated from exact elements.

Every element (`segments`) is cut into pieces that turn by at most 1 rad. On each, position and heading are polynomials
of degree 11 in u = (s - middle)/half, -1 <= u <= 1, in a frame at its middle. Lines, arcs and clothoids keep their
exact heading, so their curvature is exact; a cubic is halved until its pieces fit (`core.roads.path`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.polynomial.polynomial import polyder, polyval
from numpy.typing import ArrayLike, NDArray

from adaptrack.base.errors import InvalidInput
from adaptrack.base.limits import TURNS, check_limit
from adaptrack.core.kernel import OK
from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import Array, product
from adaptrack.core.roads import road as kernel
from adaptrack.core.roads.path import TOO_SMALL, TURN, line_numbers, write_cubics
from adaptrack.core.roads.road import COS, HALF_LENGTH, HEADING, PIECE_COLUMNS, POLYNOMIAL_DEGREE, SIN, X, Y
from adaptrack.road.segments import Arc, Clothoid, Cubic, Line, Points, Pose, Segment, heading_integral

ALONG_POLYNOMIAL = slice(kernel.ALONG_COEFFICIENTS, kernel.ACROSS_COEFFICIENTS)
ACROSS_POLYNOMIAL = slice(kernel.ACROSS_COEFFICIENTS, kernel.TURN_COEFFICIENTS)
TURN_POLYNOMIAL = slice(kernel.TURN_COEFFICIENTS, PIECE_COLUMNS)
"""Columns of the polynomials of a piece: positions (m) along and across the frame at its middle, and heading (rad)."""
_U = portable.cos(np.pi * (np.arange(POLYNOMIAL_DEGREE + 1) + 0.5) / (POLYNOMIAL_DEGREE + 1))[::-1]
_TO_COEFFICIENTS = portable.inverse(np.vander(_U, increasing=True))


class Pieces(NamedTuple):
    """The pieces of a centre line, in their order."""

    start: Array
    """(n + 1,) m, arc length at the start of each piece, and at the end of the last"""
    pieces: Array
    """(n, COLUMNS)"""

    @property
    def length(self) -> float:
        """Length of the line (m)."""
        return float(self.start[-1])

    def packed(self, closed: bool) -> Any:
        """The record that `adaptrack.core.roads.road` reads."""
        start, pieces, numbers = *map(np.ascontiguousarray, self), np.empty(4)
        line_numbers(start, pieces, closed, numbers)
        return kernel.Centreline(start, pieces, numbers)

    def at(self, s: ArrayLike, sides: ArrayLike = 1) -> Points:
        """The points at the arc lengths `s`, 0 <= s <= length, in the shape of `s`.

        sides: where two pieces meet, 1 takes the one that begins there, -1 the one that ends.
        """
        s = np.asarray(s, dtype=np.float64)
        side = np.where(np.asarray(sides) > 0, 0.0, -1.0)
        after, before = np.searchsorted(self.start, s, "right"), np.searchsorted(self.start, s, "left")
        index = np.clip(np.where(side < 0.0, before, after) - 1, 0, len(self.pieces) - 1)
        piece = self.pieces[index]
        half = piece[..., HALF_LENGTH]
        return points_on_pieces(piece, (s - self.start[index]) / half - 1.0)

    def ends(self) -> tuple[Points, Points]:
        """The points at the start and at the end of every piece."""
        ones = np.ones(len(self.pieces))
        return points_on_pieces(self.pieces, -ones), points_on_pieces(self.pieces, ones)


def points_on_pieces(piece: Array, u: Array) -> Points:
    """The points of pieces, (..., COLUMNS), at u, (...)."""
    along = _polynomial(piece[..., ALONG_POLYNOMIAL], u)
    across = _polynomial(piece[..., ACROSS_POLYNOMIAL], u)
    cos, sin = piece[..., COS], piece[..., SIN]
    return Points(
        piece[..., X] + cos * along - sin * across,
        piece[..., Y] + sin * along + cos * across,
        piece[..., HEADING] + _polynomial(piece[..., TURN_POLYNOMIAL], u),
        _polynomial(polyder(piece[..., TURN_POLYNOMIAL], axis=-1), u) / piece[..., HALF_LENGTH],
    )


def _polynomial(coefficients: NDArray[Any], u: Array) -> Array:
    """Polynomials of coefficients (..., n) at u (...)."""
    return np.asarray(polyval(u, np.moveaxis(coefficients, -1, 0), tensor=False))


# -- from elements ----------------------------------------------------------------------------------------------------
def tabulate(segments: Sequence[Segment]) -> list[Pieces]:
    """The table of each element, in the element's own frame.

    Raises InvalidInput for a cubic with a point at which it stands still (a cusp).
    """
    cubics = [segment.powers for segment in segments if isinstance(segment, Cubic)]
    pieces, counts = _cubic_pieces(np.array(cubics).reshape(-1, 2, 4))
    rows = iter(np.split(pieces, np.cumsum(counts)))
    return [end_to_end(next(rows)) if isinstance(segment, Cubic) else _natural(segment) for segment in segments]


def _natural(segment: Line | Arc | Clothoid) -> Pieces:
    """Line, arc or clothoid: the heading is known, the position is the integral of its direction."""
    k0, k_end = segment.curvatures
    steepest = max(abs(k0), abs(k_end))
    check_limit(f"{segment.kind}, {segment.length:g} m long: its turn", segment.length * steepest, TURNS)
    count = max(1, int(np.ceil(segment.length * steepest / TURN)))
    start = np.linspace(0.0, segment.length, count + 1)
    half = 0.5 * np.diff(start)
    sharpness = (k_end - k0) / segment.length
    curvature = k0 + sharpness * (start[:-1] + half)
    pieces = np.zeros((count, PIECE_COLUMNS))
    pieces[:, HALF_LENGTH] = half
    pieces[:, TURN_POLYNOMIAL.start + 1] = curvature * half
    pieces[:, TURN_POLYNOMIAL.start + 2] = 0.5 * sharpness * (half * half)
    if isinstance(segment, Line):
        pieces[:, ALONG_POLYNOMIAL.start + 1] = half
    else:
        place = heading_integral(curvature[:, np.newaxis], sharpness, half[:, np.newaxis] * _U)  # at the nodes
        pieces[:, ALONG_POLYNOMIAL] = product(place.real, _TO_COEFFICIENTS.T)
        pieces[:, ACROSS_POLYNOMIAL] = product(place.imag, _TO_COEFFICIENTS.T)
        pieces[:, [ALONG_POLYNOMIAL.start, ACROSS_POLYNOMIAL.start]] = 0.0  # the frame is at the middle
    return _chained(start, pieces)


def _chained(start: Array, pieces: Array) -> Pieces:
    """Pieces of which each begins where, and as, the one before it ends; the first at the origin along x."""
    turns = _polynomial(pieces[:, TURN_POLYNOMIAL], np.array([[-1.0], [1.0]]))
    ends = np.cumsum(turns[1] - turns[0])
    pieces[:, HEADING] = np.concatenate([[0.0], ends[:-1]]) - turns[0]
    pieces[:, COS], pieces[:, SIN] = portable.cos(pieces[:, HEADING]), portable.sin(pieces[:, HEADING])
    first, last = points_on_pieces(pieces, np.full(len(pieces), -1.0)), points_on_pieces(pieces, np.ones(len(pieces)))
    for column, begins, stops in ((X, first.x, last.x), (Y, first.y, last.y)):
        pieces[:, column] = np.concatenate([[0.0], np.cumsum(stops - begins)[:-1]]) - begins
    return Pieces(start, pieces)


# -- from cubics ------------------------------------------------------------------------------------------------------
def cubic_line(powers: Array) -> tuple[Pieces, Array]:
    """The line of cubics one after the other, and the arc lengths (n + 1,) m at which they begin and end.

    powers: (n, 2, 4), coefficients (m) of x and y in 1, p, p^2, p^3, where p runs from 0 to 1 along each cubic. Raises
    InvalidInput when a cubic has a cusp.
    """
    pieces, counts = _cubic_pieces(powers)
    line = joined([end_to_end(pieces)])
    return line, line.start[np.concatenate([[0], np.cumsum(counts)])]


def _cubic_pieces(powers: Array) -> tuple[Array, NDArray[np.int64]]:
    """The pieces of cubics, and how many each has."""
    linear, square, cube = np.moveaxis(powers[:, :, 1:], -1, 0)
    steps = np.concatenate([linear + square + cube, linear, linear + 2.0 * square + 3.0 * cube], axis=1)
    counts, room = np.empty(len(powers), dtype=np.int64), len(powers) + 16
    status = TOO_SMALL
    while status == TOO_SMALL:
        room *= 2
        pieces = np.empty((room, PIECE_COLUMNS))
        status, last = write_cubics(steps, pieces, counts)
    if status != OK:
        raise InvalidInput(
            f"cubic {last} has a cusp: a cubic must have a direction everywhere; correct its coefficients."
        )
    pieces = pieces[:last]
    pieces[:, [X, Y]] += np.repeat(powers[:, :, 0], counts, axis=0)
    return pieces, counts


def end_to_end(pieces: Array) -> Pieces:
    """The pieces (n, COLUMNS) one after the other."""
    return Pieces(np.concatenate([[0.0], np.cumsum(2.0 * pieces[:, HALF_LENGTH])]), pieces)


# -- put together -----------------------------------------------------------------------------------------------------
def placed(table: Pieces, pose: Pose) -> Pieces:
    """The table with its origin at a pose."""
    pieces = table.pieces.copy()
    cos, sin = portable.cos(pose.heading), portable.sin(pose.heading)
    x, y = table.pieces[:, X], table.pieces[:, Y]
    pieces[:, X], pieces[:, Y] = pose.x + cos * x - sin * y, pose.y + sin * x + cos * y
    pieces[:, HEADING] += pose.heading
    pieces[:, COS], pieces[:, SIN] = portable.cos(pieces[:, HEADING]), portable.sin(pieces[:, HEADING])
    return Pieces(table.start, pieces)


def joined(tables: Sequence[Pieces]) -> Pieces:
    """Tables one after the other, each where it lies; the heading is made continuous."""
    pieces = np.concatenate([table.pieces for table in tables])
    lengths = np.concatenate([np.diff(table.start) for table in tables])
    start = np.concatenate([[0.0], np.cumsum(lengths)])
    turns = _polynomial(pieces[:, TURN_POLYNOMIAL], np.array([[-1.0], [1.0]]))
    gaps = (pieces[1:, HEADING] + turns[0, 1:]) - (pieces[:-1, HEADING] + turns[1, :-1])
    full_turns = np.cumsum(np.round(gaps / (2.0 * np.pi)))
    pieces[1:, HEADING] -= 2.0 * np.pi * full_turns
    return Pieces(start, pieces)


def sequence(tables: Sequence[Pieces], start: Pose, poses: Sequence[Pose | None] | None = None) -> Pieces:
    """Tables in their own frames, laid end to end from a pose; one with a pose in `poses` has its origin there."""
    laid, pose = [], start
    for k, table in enumerate(tables):
        first, last = (Pose(*map(float, table.at(s)[:3])) for s in (0.0, table.length))
        turn = pose.heading - first.heading
        x, y = _turned(first, turn)
        origin = (poses[k] if poses else None) or Pose(pose.x - x, pose.y - y, turn)
        turn = origin.heading
        laid.append(placed(table, origin))
        x, y = _turned(last, turn)
        pose = Pose(origin.x + x, origin.y + y, turn + last.heading)
    return joined(laid)


def _turned(pose: Pose, angle: float) -> tuple[float, float]:
    """The point of a pose turned about the origin."""
    cos, sin = portable.cos(angle), portable.sin(angle)
    return cos * pose.x - sin * pose.y, sin * pose.x + cos * pose.y

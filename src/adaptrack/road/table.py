"""A centre line as polynomials of its arc length: what the compiled projection reads, tabulated from exact elements.

Every element (`segments`), and a curve that runs beside one (`beside`), is cut into pieces that turn by at most 1 rad.
On each, position and heading are polynomials of degree 11 in u = (s - middle)/half, -1 <= u <= 1, in a frame at its
middle. Lines, arcs and clothoids keep their exact heading, so their curvature is exact; of what has no closed form
(cubics, lane offsets) a piece is halved until it fits, see `FIT`.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from adaptrack.base.errors import InvalidInput
from adaptrack.base.limits import TURNS, check_limit
from adaptrack.core.path import COLUMNS, CURVATURE_FIT, FIT, ROUNDING, TURN
from adaptrack.core.road import ACROSS, ALONG, COS, DEGREE, HALF, HEADING, SIN, TURNED, X, Y
from adaptrack.road.segments import Arc, Array, Clothoid, Cubic, Line, Points, Pose, Segment, heading_integral

TOGETHER = 1024
"""Cubics that are fitted at once: some megabytes."""
HALVINGS, MOST = 30, 50
"""How often a piece may be halved, and how many pieces may wait for it per curve, before the curve counts as having a
point without a direction."""

SHORTEST = 1e-4
"""m, a piece beside another that is shorter goes with its neighbour: editors leave elements of micrometres."""


_U = np.cos(np.pi * (np.arange(DEGREE + 1) + 0.5) / (DEGREE + 1))[::-1]
_TO_COEFFICIENTS = np.linalg.inv(np.vander(_U, increasing=True))
_CHECKED = np.array([-1.0, -0.93, -0.55, -0.13, 0.21, 0.62, 0.96, 1.0])
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(16)
_NODES, _WEIGHTS = 0.5 * (1.0 + _NODES), 0.5 * _WEIGHTS  # on 0..1


class Pieces(NamedTuple):
    """The pieces of a centre line, in their order."""

    start: Array
    """(n + 1,) m, arc length at the start of each piece, and at the end of the last"""
    pieces: Array
    """(n, COLUMNS)"""

    @property
    def length(self) -> float:
        """m"""
        return float(self.start[-1])

    @property
    def most_curvature(self) -> float:
        """1/m, that no curvature exceeds."""
        slopes = np.abs(self.pieces[:, TURNED + 1 : COLUMNS]) @ np.arange(1.0, DEGREE + 1)
        return float((slopes / self.pieces[:, HALF]).max())

    def at(self, s: ArrayLike, sides: ArrayLike = 1) -> Points:
        """The points at the arc lengths `s`, 0 <= s <= length, in the shape of `s`.

        sides: where two pieces meet, 1 takes the one that begins there, -1 the one that ends.
        """
        s = np.asarray(s, dtype=np.float64)
        side = np.where(np.asarray(sides) > 0, 0.0, -1.0)
        after, before = np.searchsorted(self.start, s, "right"), np.searchsorted(self.start, s, "left")
        index = np.clip(np.where(side < 0.0, before, after) - 1, 0, len(self.pieces) - 1)
        piece = self.pieces[index]
        half = piece[..., HALF]
        return of_pieces(piece, (s - self.start[index]) / half - 1.0)

    def ends(self) -> tuple[Points, Points]:
        """The points at the start and at the end of every piece."""
        one = np.ones(len(self.pieces))
        return of_pieces(self.pieces, -one), of_pieces(self.pieces, one)


def of_pieces(piece: Array, u: Array) -> Points:
    """The points of pieces, (..., COLUMNS), at u, (...)."""
    along = _horner(piece[..., ALONG:ACROSS], u)
    across = _horner(piece[..., ACROSS:TURNED], u)
    cos, sin = piece[..., COS], piece[..., SIN]
    return Points(
        piece[..., X] + cos * along - sin * across,
        piece[..., Y] + sin * along + cos * across,
        piece[..., HEADING] + _horner(piece[..., TURNED:COLUMNS], u),
        _horner_slope(piece[..., TURNED:COLUMNS], u) / piece[..., HALF],
    )


def _horner(coefficients: Array, u: Array) -> Array:
    value = coefficients[..., DEGREE]
    for k in range(DEGREE - 1, -1, -1):
        value = value * u + coefficients[..., k]
    return value


def _horner_slope(coefficients: Array, u: Array) -> Array:
    value = DEGREE * coefficients[..., DEGREE]
    for k in range(DEGREE - 1, 0, -1):
        value = value * u + k * coefficients[..., k]
    return value


# -- from elements ----------------------------------------------------------------------------------------------------
def tabulate(segments: Sequence[Segment]) -> list[Pieces]:
    """The table of each element, in the element's own frame.

    Raises
    ------
    InvalidInput
        For a cubic with a point at which it stands still (a cusp).
    """
    cubics = [segment for segment in segments if isinstance(segment, Cubic)]
    batches = (cubics[k : k + TOGETHER] for k in range(0, len(cubics), TOGETHER))
    fitted = itertools.chain.from_iterable(_of_curves(_Cubics(batch)) for batch in batches)
    return [next(fitted) if isinstance(segment, Cubic) else _natural(segment) for segment in segments]


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
    pieces = np.zeros((count, COLUMNS))
    pieces[:, HALF] = half
    pieces[:, TURNED + 1] = curvature * half
    pieces[:, TURNED + 2] = 0.5 * sharpness * half**2
    if isinstance(segment, Line):
        pieces[:, ALONG + 1] = half
    else:
        place = heading_integral(curvature[:, np.newaxis], sharpness, half[:, np.newaxis] * _U)
        _set_positions(pieces, place)
    return _chained(start, pieces)


def _set_positions(pieces: Array, place: NDArray[np.complex128]) -> None:
    """The polynomials through positions, along + i across, at the nodes."""
    pieces[:, ALONG:ACROSS] = place.real @ _TO_COEFFICIENTS.T
    pieces[:, ACROSS:TURNED] = place.imag @ _TO_COEFFICIENTS.T
    pieces[:, [ALONG, ACROSS]] = 0.0  # the frame is at the middle


def _chained(start: Array, pieces: Array) -> Pieces:
    """Pieces of which each begins where, and as, the one before it ends; the first at the origin along x."""
    turns = _horner(pieces[:, TURNED:COLUMNS], np.array([[-1.0], [1.0]]))
    ends = np.cumsum(turns[1] - turns[0])
    pieces[:, HEADING] = np.concatenate([[0.0], ends[:-1]]) - turns[0]
    pieces[:, COS], pieces[:, SIN] = np.cos(pieces[:, HEADING]), np.sin(pieces[:, HEADING])
    first, last = of_pieces(pieces, np.full(len(pieces), -1.0)), of_pieces(pieces, np.ones(len(pieces)))
    for column, begins, stops in ((X, first.x, last.x), (Y, first.y, last.y)):
        pieces[:, column] = np.concatenate([[0.0], np.cumsum(stops - begins)[:-1]]) - begins
    return Pieces(start, pieces)


# -- from curves without a closed form --------------------------------------------------------------------------------
class _State(NamedTuple):
    """Points of curves, and how fast their parameter p runs over them."""

    place: NDArray[np.complex128]
    """x + i y, m"""
    heading: Array
    """rad, of one turn"""
    curvature: Array
    """1/m"""
    speed: Array
    """m per unit of p"""


class _Curves(Protocol):
    """Many curves of one kind, each over a parameter p."""

    def ranges(self) -> tuple[NDArray[np.int64], Array, Array]:
        """For each range of p in order: its curve, its first and its last p."""

    def state(self, which: NDArray[np.int64], p: Array) -> _State:
        """The curves `which`, (n,), at p, (n, m)."""

    def speed(self, which: NDArray[np.int64], p: Array) -> Array:
        """The speed of `state` alone."""


class _Cubics:
    def __init__(self, cubics: Sequence[Cubic]) -> None:
        self._x = np.array([cubic.x for cubic in cubics])
        self._y = np.array([cubic.y for cubic in cubics])
        self._end = np.array([cubic.end for cubic in cubics])

    def ranges(self) -> tuple[NDArray[np.int64], Array, Array]:
        return np.arange(self._end.size), np.zeros_like(self._end), self._end

    def state(self, which: NDArray[np.int64], p: Array) -> _State:
        place, slope, bend = _cubic(self._coefficients(which), p)
        speed = np.abs(slope)
        with np.errstate(divide="ignore", invalid="ignore"):
            curvature = (np.conj(slope) * bend).imag / speed**3
        return _State(place, np.angle(slope), curvature, speed)

    def speed(self, which: NDArray[np.int64], p: Array) -> Array:
        c = self._coefficients(which)
        return np.abs(c[1] + p * (2.0 * c[2] + p * (3.0 * c[3])))

    def _coefficients(self, which: NDArray[np.int64]) -> NDArray[np.complex128]:
        return (self._x[which] + 1j * self._y[which]).T[:, :, np.newaxis]


class _Beside:
    """The curves at a lateral distance d(b) = d0 + d1 (b - b0) + ... from one, b: the arc length of that one.

    With its curvature k the tangent is ((1 - d k), d') in the frame of the curve, which gives heading and curvature.
    """

    def __init__(self, base: Pieces, first: Array, coefficients: Array) -> None:
        self._base, self._first, self._d = base, first, coefficients

    def ranges(self) -> tuple[NDArray[np.int64], Array, Array]:
        """Cut where the base has a new piece or the distance a new polynomial."""
        cuts = np.union1d(self._base.start, self._first)
        cuts = cuts[(cuts >= 0.0) & (cuts <= self._base.length)]
        cuts = cuts[np.concatenate([[True], np.diff(cuts) > SHORTEST])]
        cuts[-1] = self._base.length
        middle = 0.5 * (cuts[:-1] + cuts[1:])
        self._piece = np.searchsorted(self._base.start, middle, "right") - 1
        self._law = np.maximum(np.searchsorted(self._first, middle, "right") - 1, 0)
        return np.arange(middle.size), cuts[:-1], cuts[1:]

    def state(self, which: NDArray[np.int64], p: Array) -> _State:
        row, law = self._piece[which], self._law[which]
        piece = self._base.pieces[row][:, np.newaxis, :]
        half = piece[..., HALF]
        u = (p - self._base.start[row][:, np.newaxis]) / half - 1.0
        base = of_pieces(piece, u)
        sharpness = _horner_bend(piece[..., TURNED:COLUMNS], u) / half**2
        d, slope, bend = _cubic(self._d[law].T[:, :, np.newaxis], p - self._first[law][:, np.newaxis])
        ahead = 1.0 - d * base.curvature
        speed = np.hypot(ahead, slope)
        turning = bend * ahead + slope * (slope * base.curvature + d * sharpness)
        with np.errstate(divide="ignore", invalid="ignore"):
            curvature = (base.curvature + turning / speed**2) / speed
        place = base.x + 1j * base.y + 1j * d * np.exp(1j * base.heading)
        # Beyond the centre of curvature the curve would run backwards: its speed counts as zero, for `_of_curves`.
        return _State(place, base.heading + np.arctan2(slope, ahead), curvature, np.where(ahead > 0.0, speed, 0.0))

    def speed(self, which: NDArray[np.int64], p: Array) -> Array:
        return self.state(which, p).speed


def _cubic(c: NDArray[Any], b: Array) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """A cubic with the coefficients c, its slope and its second derivative."""
    value = c[0] + b * (c[1] + b * (c[2] + b * c[3]))
    return value, c[1] + b * (2.0 * c[2] + 3.0 * b * c[3]), 2.0 * c[2] + 6.0 * b * c[3]


def _horner_bend(coefficients: Array, u: Array) -> Array:
    value = DEGREE * (DEGREE - 1) * coefficients[..., DEGREE]
    for k in range(DEGREE - 1, 1, -1):
        value = value * u + k * (k - 1) * coefficients[..., k]
    return value


def beside(base: Pieces, first: ArrayLike, coefficients: ArrayLike) -> Pieces:
    """The curve at a lateral distance from another, as OpenDRIVE's lanes lie beside their reference line.

    Parameters
    ----------
    first : (m,) array
        m, where along the base each polynomial begins, increasing; the first one also holds before.
    coefficients : (m, 4) array
        Of 1, b, b^2, b^3, b counted from its `first`; positive to the left, m.

    Raises
    ------
    InvalidInput
        Where the curve passes the centre of curvature of its base: it would run backwards there.
    """
    curves = _Beside(base, np.asarray(first, dtype=np.float64), np.asarray(coefficients, dtype=np.float64))
    return joined(_of_curves(curves))


def _of_curves(curves: _Curves) -> list[Pieces]:
    """Fit pieces to curves, halving those that do not fit; one table per range, each in place.

    A piece that fits at `_CHECKED` points in position, curvature and length is kept.
    """
    which, low, high = curves.ranges()
    owner, count = np.arange(which.size), which.size
    bad = np.ones(count, dtype=bool)
    made: list[tuple[int, float, float, Array]] = []
    for _ in range(HALVINGS):
        with np.errstate(divide="ignore", invalid="ignore"):  # at a cusp, which does not fit
            pieces, length, fits = _fitted(curves, which, low, high)
        made += [(int(owner[k]), float(low[k]), float(length[k]), pieces[k]) for k in np.flatnonzero(fits)]
        bad = ~fits
        if not bad.any():
            break
        middle = 0.5 * (low[bad] + high[bad])
        owner, which = np.repeat(owner[bad], 2), np.repeat(which[bad], 2)
        low = np.stack([low[bad], middle], axis=1).ravel()
        high = np.stack([middle, high[bad]], axis=1).ravel()
        if low.size > MOST * count:
            bad = np.ones(1, dtype=bool)
            break
    if bad.any():
        raise InvalidInput(
            f"the curve has a cusp, or runs backwards, near its parameter {low[0]:.6g} (element {int(owner[0])}): "
            "a lane must stay on its side of the centre of curvature, and a cubic must not stand still."
        )
    made.sort(key=lambda piece: piece[:2])
    tables = []
    for _, mine in itertools.groupby(made, key=lambda piece: piece[0]):
        row = list(mine)
        start = np.concatenate([[0.0], np.cumsum([length for _, _, length, _ in row])])
        tables.append(Pieces(start, np.array([piece for *_, piece in row])))
    return tables


def _fitted(
    curves: _Curves, which: NDArray[np.int64], low: Array, high: Array
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Pieces over ranges of p, their lengths, and which of them fit."""
    middle = 0.5 * (low + high)
    whole = _lengths(curves, which, low, high[:, np.newaxis])[:, 0]
    length = _lengths(curves, which, low, middle[:, np.newaxis])[:, 0]
    length += _lengths(curves, which, middle, high[:, np.newaxis])[:, 0]
    u = np.concatenate([_U, [0.0], _CHECKED])
    p, solved = _parameters(curves, which, low, high, 0.5 * length[:, np.newaxis] * (1.0 + u))
    state = curves.state(which, p)
    n = DEGREE + 1
    mid, heading = state.place[:, n : n + 1], state.heading[:, n : n + 1]
    place = (state.place - mid) * np.exp(-1j * heading)
    turned = np.angle(np.exp(1j * (state.heading - heading)))
    pieces = np.zeros((low.size, COLUMNS))
    pieces[:, HALF], pieces[:, HEADING] = 0.5 * length, heading[:, 0]
    pieces[:, X], pieces[:, Y] = mid[:, 0].real, mid[:, 0].imag
    pieces[:, COS], pieces[:, SIN] = np.cos(heading[:, 0]), np.sin(heading[:, 0])
    _set_positions(pieces, place[:, :n])
    pieces[:, TURNED:COLUMNS] = turned[:, :n] @ _TO_COEFFICIENTS.T
    pieces[:, TURNED] = 0.0
    found = of_pieces(pieces[:, np.newaxis, :], _CHECKED[np.newaxis, :])
    checked = slice(n + 1, None)
    off = np.abs(found.x + 1j * found.y - state.place[:, checked]).max(axis=1)
    curvature = state.curvature[:, checked]
    allowed = CURVATURE_FIT * (np.abs(curvature) + 0.1) + ROUNDING / np.maximum(length, 1e-9)[:, np.newaxis]
    bent = (np.abs(found.curvature - curvature) / allowed).max(axis=1)
    reach = np.maximum(length, 1.0)
    fits = (off <= FIT * reach) & (bent <= 1.0) & (np.abs(turned).max(axis=1) <= TURN)
    fits &= (np.abs(whole - length) <= FIT * reach) & solved & (state.speed.min(axis=1) > 0.0)
    return pieces, length, fits


def _lengths(curves: _Curves, which: NDArray[np.int64], low: Array, p: Array) -> Array:
    """Arc length from `low`, (n,), to each p, (n, m)."""
    span = p - low[:, np.newaxis]
    at = low[:, np.newaxis, np.newaxis] + span[..., np.newaxis] * _NODES
    speed = curves.speed(which, at.reshape(low.size, -1)).reshape(at.shape)
    return span * (speed @ _WEIGHTS)


def _parameters(
    curves: _Curves, which: NDArray[np.int64], low: Array, high: Array, s: Array
) -> tuple[Array, NDArray[np.bool_]]:
    """The p at arc lengths s, (n, m), from `low` on, by Newton's method; and for which ranges it converged."""
    span = (high - low)[:, np.newaxis]
    p = low[:, np.newaxis] + span * s / np.maximum(s.max(axis=1, keepdims=True), 1e-300)
    for _ in range(12):
        speed = curves.speed(which, p)
        with np.errstate(divide="ignore", invalid="ignore"):
            step = (s - _lengths(curves, which, low, p)) / speed
        step = np.where(np.isfinite(step), step, 0.0)
        p = np.clip(p + step, low[:, np.newaxis], high[:, np.newaxis])
        if (np.abs(step) <= 1e-13 * span).all():
            break
    solved: NDArray[np.bool_] = np.all(np.abs(step) <= 1e-11 * span, axis=1)
    return p, solved


# -- put together -----------------------------------------------------------------------------------------------------
def placed(table: Pieces, pose: Pose) -> Pieces:
    """The table with its origin at a pose."""
    pieces = table.pieces.copy()
    cos, sin = np.cos(pose.heading), np.sin(pose.heading)
    x, y = table.pieces[:, X], table.pieces[:, Y]
    pieces[:, X], pieces[:, Y] = pose.x + cos * x - sin * y, pose.y + sin * x + cos * y
    pieces[:, HEADING] += pose.heading
    pieces[:, COS], pieces[:, SIN] = np.cos(pieces[:, HEADING]), np.sin(pieces[:, HEADING])
    return Pieces(table.start, pieces)


def joined(tables: Sequence[Pieces]) -> Pieces:
    """Tables one after the other, each where it lies; the heading is made continuous."""
    pieces = np.concatenate([table.pieces for table in tables])
    lengths = np.concatenate([np.diff(table.start) for table in tables])
    start = np.concatenate([[0.0], np.cumsum(lengths)])
    turns = _horner(pieces[:, TURNED:COLUMNS], np.array([[-1.0], [1.0]]))
    gaps = (pieces[1:, HEADING] + turns[0, 1:]) - (pieces[:-1, HEADING] + turns[1, :-1])
    whole = np.cumsum(np.round(gaps / (2.0 * np.pi)))
    pieces[1:, HEADING] -= 2.0 * np.pi * whole
    return Pieces(start, pieces)


def sequence(tables: Sequence[Pieces], start: Pose, poses: Sequence[Pose | None] | None = None) -> Pieces:
    """Tables in their own frames, laid end to end from a pose; one with a pose in `poses` has its origin there."""
    laid, here = [], start
    for k, table in enumerate(tables):
        first, last = (Pose(*(float(value) for value in point[:3])) for point in _both_ends(table))
        turn = here.heading - first.heading
        x, y = _turned(first, turn)
        origin = (poses[k] if poses else None) or Pose(here.x - x, here.y - y, turn)
        turn = origin.heading
        laid.append(placed(table, origin))
        x, y = _turned(last, turn)
        here = Pose(origin.x + x, origin.y + y, turn + last.heading)
    return joined(laid)


def _both_ends(table: Pieces) -> tuple[Points, Points]:
    return table.at(0.0), table.at(table.length)


def _turned(pose: Pose, angle: float) -> tuple[float, float]:
    """The point of a pose turned about the origin."""
    cos, sin = math.cos(angle), math.sin(angle)
    return cos * pose.x - sin * pose.y, sin * pose.x + cos * pose.y

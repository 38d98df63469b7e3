"""A smooth road through or near recorded points: a penalised cubic spline, its largest deviation stated and bounded.

The smoothing length (`smoothing`) is found by generalised cross-validation with the count of parameters taken 1.4
times, which seldom takes noise for road (Y.-J. Kim and C. Gu, Journal of the Royal Statistical Society B 66 (2004)).
The noise is then what is left, by its median, of which a few outliers are no part. The smoothing length is made shorter
until no point is farther from the curve than allowed: by the caller, or as noise may take it. The places of the points
are the arc lengths of their feet on the curve, found by fitting more than once.
"""

from __future__ import annotations

import itertools
import logging
import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, Any, NamedTuple

import numpy as np
import scipy  # loads its parts when they are first used
from numpy.typing import ArrayLike, NDArray

from adaptrack.base.checked import NotNegative, Positive, checked, reals
from adaptrack.base.errors import InvalidInput
from adaptrack.core.kernel import OK
from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import Array, product
from adaptrack.core.roads import noise as path_noise
from adaptrack.core.roads import path
from adaptrack.core.roads.path import MIN_PATH_POINTS, WIDEST
from adaptrack.core.roads.road import CLOSED, LENGTH, MOST_CURVATURE, project_all
from adaptrack.road.road import Road
from adaptrack.road.segments import MAX_COORDINATE, Cubic, Pose
from adaptrack.road.smoothing import LENGTHS, Smoother, grade_of_heights
from adaptrack.road.station_table import ALONG_QUANTITIES, alongs
from adaptrack.road.table import Pieces, cubic_line, placed

_log = logging.getLogger("adaptrack")

MAX_DEVIATION = 0.5
"""m, allowed at least unless another is given."""
MAX_NOISE_DEVIATIONS = 6.0
"""Standard deviations of the noise that are allowed, unless a distance is given."""
SPARSE = 50.0
"""m, the usual distance of two points in a row from which on a note asks whether they are in metres."""
MIN_ROAD_LENGTH = 1.0
"""m, the shortest road that is fitted."""
FITS = 3
"""How often the points find their places along the curve anew."""
SHORTEST_KNOTS = 0.5
"""m, the least distance of the knots to begin with: denser points are averaged by the fit."""
KNOT_REFINEMENTS = 3
"""How often the knots are put at half the distance when the curve cannot come as near as requested."""
ROUNDS = 3
"""How often outliers are looked for."""
LEAP = 3.0
"""Times the usual step, to points off the road; and times the way past them, there and back."""
GAP = 6.0
"""Times the usual step, from which on a step is a gap: third derivatives of a curve over it mean nothing."""
GAP_COSINE = 0.9
"""Least cosine of the angles between the gap of a lap at its start and the directions at both ends."""
WIDER_GAP = 2.0
"""Times the widest gap between points, up to which a lap is open at its start."""
PIECE_ANGLE, DIRECTION_STEPS = 1.2, 3
"""rad, between a gap and the directions over up to so many steps before and behind it: the points are two pieces."""
MAX_DETOUR = 1.6
"""Length of the curve over the distance of two points in a row: a half circle has 1.57."""
MIN_ROBUST_SMOOTHING = 6.0
"""Steps, the shortest smoothing length of a curve that does not follow outliers."""
MEASURABLE = 1.0 / 3.0
"""Parameters for each point, up to which what is left of the points is their noise."""
IN_A_ROW, SHARE = 5, 0.02
"""The most outliers in a row, and of all points."""
BESIDE, MET = 2, 4.0
"""Points on each side of outliers that the curve without these must meet, within so many standard deviations."""
MAX_NAMED_POINTS = 5
"""Points that a note names."""
FOLD = 8.0
"""rad from one knot to the next, if the tightest bend went on so far, at which a curve has a cusp or a loop."""


@checked
def fit_road(
    points: ArrayLike,
    *,
    max_deviation: Annotated[Positive, "m"] | None = None,
    closed: bool | None = None,
    smoothest: bool = False,
    height: ArrayLike | None = None,
    name: str = "points",
    **along: Any,
) -> Road:
    """A road with continuous curvature through or near points in the order in which they are driven.

    Parameters
    ----------
    points : (n, 2) array
        x, y in m. Where the record goes on beyond its start, the rest is left out.
    max_deviation : float, optional
        The largest distance of a point from the curve that is allowed. By default six standard deviations of
        the noise that is found, 0.5 m at least; outliers, a few points farther off than that, are then left out.
    closed : bool, optional
        Whether the road is a lap; by default so when the record comes back to its start in the same direction.
    smoothest : bool
        The smoothest curve that keeps `max_deviation`, instead of the one that cross-validation chooses.
    height : (n,) array, optional
        z (m) of the points; the slope of a smooth curve near it becomes the grade, unless `grade` is given.
    **along
        As in `Road.from_segments`, at arc lengths of the road; arrays (n,) are values at the points.

    Returns
    -------
    Road
        `deviation` is its largest distance (m) from a point that is not left out; `notes` say where, what was left
        out, and where a bound and not the noise chose the smoothing length.

    Raises
    ------
    InvalidInput
        When points are too few, not finite, all the same or too far apart, or no curve comes as near as requested.
    """
    points = _check_points("fit_road", points, MIN_ROAD_LENGTH)
    _check_pieces(points)
    count, lap, notes = _find_lap(points, closed)
    rows, distinct_points = _points_apart(points[:count], lap)
    record = _Record(distinct_points, rows, points[:count].mean(axis=0), lap)
    if smoothest:
        estimate, outliers = replace(_estimate(record), best=LENGTHS - 1), np.zeros(rows.size, dtype=bool)
    else:
        estimate, outliers = _cross_validated(record, max_deviation is None)
    bound = max_deviation
    if bound is None:
        bound = max(MAX_DEVIATION, MAX_NOISE_DEVIATIONS * np.nan_to_num(estimate.noise))
    fit = _bounded_fit(estimate, bound)
    notes += _gap_notes(fit, estimate.record)
    road, fitted = _road(fit, record), estimate.record.rows
    s = np.interp(np.arange(count), fitted, fit.along)
    values = dict(along)
    for key, value in along.items():
        if isinstance(value, np.ndarray) and value.shape == (len(points),):
            values[key] = _sort_by_arc_length(s, value[:count], road)
    if height is not None and "grade" not in along:
        heights = _check_heights(height, len(points))[:count]
        values["grade"], note = grade_of_heights(s, heights, road.length, record.closed)
        notes = [*notes, note]
    notes = [*_spacing_notes(points), *notes, *_outlier_notes(road, record, s[rows], outliers)]
    notes += [] if smoothest else _bound_notes(estimate, fit, bound)
    notes.append(_fit_note(fit, fitted))
    return replace(road, name=name, notes=tuple(notes), deviation=fit.deviation, **alongs(values))


@checked
def road_through(
    points: ArrayLike,
    *,
    closed: bool = False,
    noise: Annotated[NotNegative, "m"] | None = None,
    name: str = "points",
    **along: Any,
) -> Road:
    """A road through the points of a planner, many times as fast as `fit_road`.

    A cubic spline over the length of their polygon: continuous curvature, exact at points without noise. Points with
    noise are smoothed first (`core.roads.noise`). Exported controllers make the same road to the bit.

    Parameters
    ----------
    points : (n, 2) array
        x, y in m; a lap ends at or before its start. Points in a row count as one, the first, if their distance is at
        most a tenth of the step on either side and 0.2 m: such a step would turn the road by the error of its points.
    noise : float, optional
        Standard deviation of x and y; 0: the road goes through the points. By default it is estimated: 0 for points on
        a smooth curve, and for fewer than 16 points.
    closed, name, **along
        As in `Road.from_segments`.

    Returns
    -------
    Road
        `notes` name the points that were left out because they count as one with another, and the noise.
        `deviation` is the largest distance (m) of smoothed points from the road.

    Raises
    ------
    InvalidInput
        When points are too few, not finite, or fold back on themselves.
    """
    points = _check_points("road_through", points, path.MIN_PATH_LENGTH)
    size = path.path_words(points, closed)
    while True:
        memory = np.empty(size)
        status, place = path.path_through(points, closed, math.nan if noise is None else noise, memory)
        if status != path.TOO_SMALL:
            break
        size *= 2
    if status != OK:
        raise InvalidInput(f"road_through: {_FLAWS[status].format(place, WIDEST)}")
    line, _ = path.line_in(memory)
    rows, distinct_points = _points_apart(points, closed)
    source = "given" if noise is not None else "estimated"
    if noise is None:
        noise = path_noise.noise_of(distinct_points, closed, np.empty(rows.size))
    notes, deviation = _repetition_notes(points, rows), 0.0
    if noise > 0.0:
        deviation = _deviation(distinct_points, line)
        notes += (f"noise of {noise:.2g} m ({source}) smoothed: up to {deviation:.2g} m from a point",)
    table = Pieces(line.start.copy(), line.pieces.copy())
    return Road(name=name, table=table, closed=closed, notes=notes, deviation=deviation, **alongs(along))


def _deviation(points: Array, line: Any) -> float:
    """The largest distance (m) of points (n, 2) from a line along them."""
    places, feet = portable.hypot(*np.diff(points, axis=0, prepend=points[:1]).T).cumsum(), np.empty((len(points), 4))
    end = line.numbers[LENGTH] - (line.numbers[CLOSED] > 0.5) * portable.hypot(*(points[0] - points[-1]))
    project_all(line, np.column_stack([points, places * (end / places[-1])]), feet)
    return float(np.nanmax(np.abs(feet[:, 1])))


def _repetition_notes(points: Array, rows: NDArray[np.int64]) -> tuple[str, ...]:
    """A note on the points that a path leaves out, with the distance to the nearest one that it goes through."""
    repetitions = np.setdiff1d(np.arange(len(points)), rows)
    if repetitions.size == 0:
        return ()
    after = np.searchsorted(rows, repetitions)
    sides = np.stack([rows[after - 1], rows[after % rows.size]])
    distances = portable.hypot(*np.moveaxis(points[repetitions] - points[sides], -1, 0))
    nearest = np.take_along_axis(sides, distances.argmin(axis=0)[np.newaxis], axis=0)[0]
    texts = [
        f"point {row} ({distance:.3g} m from point {neighbour})"
        for row, neighbour, distance in zip(repetitions, nearest, distances.min(axis=0), strict=True)
    ]
    return (f"{repetitions.size} of {len(points)} points left out as repeated: {_first_few(texts)}",)


def _points_apart(points: Array, closed: bool) -> tuple[NDArray[np.int64], Array]:
    """Numbers (m,), and points (m, 2) beside them that stand for all points near to each other (`core.roads.path`)."""
    places = np.empty(len(points))
    places = places[: path.points_apart(points, closed, places)]
    low = np.floor(places).astype(np.int64)
    share = (places - low)[:, np.newaxis]
    between = (1.0 - share) * points[low] + share * points[(low + 1) % len(points)]
    rows = np.mod(np.rint(places).astype(np.int64), len(points))
    order = np.argsort(rows)
    return rows[order], between[order]


_FLAWS = {
    path.TOO_FEW: "{} points lie apart from each other: at least 4 are needed.",
    path.POINT_TOO_FAR: "point {} is more than {:g} m from the next one; correct or leave out the one that is wrong.",
    path.TOO_SHORT: "the points are too near one another; are x and y in metres?",
    path.PATH_KINK: "the points fold back on themselves behind point {}: "
    "no smooth road goes through them; use fit_road.",
}
"""Messages on points that `_check_points` lets pass."""


def smooth_road(road: Road, max_deviation: float = 0.1, spacing: float = 1.0) -> Road:
    """A road without jumps of curvature that stays within `max_deviation` (m) of points of another.

    spacing: m, between those points. What lies along the road stays where it is, in proportion to the length.

    Raises
    ------
    InvalidInput
        When no smooth curve stays as near.
    """
    count = max(8, math.ceil(road.length / spacing))
    s = np.linspace(0.0, road.length, count + 1)[: count if road.closed else count + 1]
    points = road.at(s)
    fitted = fit_road(
        np.stack([points.x, points.y], axis=-1), max_deviation=max_deviation, closed=road.closed, name=road.name,
        smoothest=True,
    )  # fmt: skip
    stretch = fitted.length / road.length
    along = {name: getattr(road, name) for name in ALONG_QUANTITIES}
    moved = {name: values and values.replace(s=tuple(stretch * s for s in values.s)) for name, values in along.items()}
    return replace(fitted, **moved)


def _check_points(where: str, points: ArrayLike, shortest: float) -> Array:
    """A copy of the points (n, 2); refuse anything that is no record of a road in metres, at least `shortest` long."""
    points = reals(f"{where}: points", points).copy()
    if points.ndim != 2 or points.shape[1] != 2 or len(points) < MIN_PATH_POINTS:
        raise InvalidInput(
            f"{where}: points have shape {points.shape}; give (n, 2) with n >= {MIN_PATH_POINTS}, x and y in m."
        )
    if not np.isfinite(points).all():
        row = int(np.argwhere(~np.isfinite(points))[0, 0])
        raise InvalidInput(f"{where}: point {row} is not finite; leave it out.")
    farthest, column = np.unravel_index(np.abs(points).argmax(), points.shape)
    if abs(points[farthest, column]) > MAX_COORDINATE:
        raise InvalidInput(
            f"{where}: point {farthest} has a coordinate of {points[farthest, column]:.3g} m: at most "
            f"{MAX_COORDINATE:g} m are allowed; correct it or leave it out."
        )
    steps = portable.hypot(*np.diff(points, axis=0).T)
    widest = int(steps.argmax())
    if steps[widest] > WIDEST:
        raise InvalidInput(
            f"{where}: point {widest} is {steps[widest]:.3g} m from the next one: at most {WIDEST:g} m are allowed; "
            "correct or leave out the one that is wrong."
        )
    if not steps[widest] > 0.0:
        raise InvalidInput(f"{where}: all points are the same; give a road with a length.")
    if steps.sum() < shortest:
        remedy = "are x and y in metres?"
        if np.abs(points).max() <= 180.0 and np.abs(points.mean(axis=0)).max() > 100.0 * steps.sum():
            remedy = "are they latitude and longitude? Convert them to x (east) and y (north) in metres."
        raise InvalidInput(
            f"{where}: the points make a line of {steps.sum():.3g} m: {shortest:g} m at least are needed; {remedy}"
        )
    return points


def _check_pieces(points: Array) -> None:
    """Refuse two pieces: a gap to which an end does not lead, or hardly and it is wider than the rest is long."""
    rows, points = _points_apart(points, False)
    steps = portable.hypot(*np.diff(points, axis=0).T)
    spikes = _find_spikes(points)
    for k in np.flatnonzero(steps > GAP * _usual_step(steps)):
        cosine = _cosine_over(points[: k + 1], points[k + 1 :])
        leads_aside = cosine < portable.cos(PIECE_ANGLE) and not spikes[k : k + 2].any()
        if leads_aside or (2.0 * steps[k] > steps.sum() and cosine < GAP_COSINE):
            raise InvalidInput(
                f"fit_road: behind point {rows[k]} a second piece begins, {steps[k]:.3g} m away: give one piece, or "
                "the points between."
            )


def _cosine_over(before: Array, behind: Array) -> float:
    """The cosine of the larger angle between a gap and the best of a few directions before and behind it."""
    gap, cosine = behind[0] - before[-1], 1.0
    for side in (before[-1] - before[-1 - DIRECTION_STEPS : -1], behind[1 : 1 + DIRECTION_STEPS] - behind[0]):
        sizes = portable.hypot(*side.T) * portable.hypot(*gap)
        cosines = product(side, gap)[sizes > 0.0] / sizes[sizes > 0.0]
        cosine = min(cosine, float(cosines.max(initial=-1.0)) if cosines.size else 1.0)
    return cosine


def _check_heights(height: ArrayLike, count: int) -> Array:
    heights = reals("fit_road: height", height)
    if heights.shape != (count,) or not np.isfinite(heights).all():
        raise InvalidInput(
            f"fit_road: height has shape {heights.shape}: give ({count},) finite numbers, z in m of each point."
        )
    return heights


def _spacing_notes(points: Array) -> list[str]:
    """A note on points far apart: a record in centimetres looks like that."""
    spacing = float(np.median(portable.hypot(*np.diff(points, axis=0).T)))
    if spacing <= SPARSE:
        return []
    note = f"the points are {spacing:.3g} m apart (median): are x and y in metres, or in centimetres?"
    _log.warning("adaptrack: %s", note)
    return [note]


def _gap_notes(fit: _Fit, record: _Record) -> list[str]:
    """A note on the gaps between points. A curve that makes a detour between two points is refused."""
    lap = np.append(fit.along, fit.along[0] + fit.table.length) if record.closed else fit.along
    chords = record.steps
    detours = np.diff(lap) - MAX_DETOUR * chords
    k = int(detours.argmax())
    if detours[k] > 2.0 * fit.deviation:
        raise InvalidInput(
            f"fit_road: between point {record.rows[k]} and the next one, {chords[k]:.3g} m away, the curve would be "
            f"{detours[k] + MAX_DETOUR * chords[k]:.3g} m long: give more points there."
        )
    if not record.has_gaps:
        return []
    k, gaps = int(chords.argmax()), int((chords > GAP * _usual_step(chords)).sum())
    widest = f", the widest of {gaps} gaps" if gaps > 1 else ""
    return [
        f"behind point {record.rows[k]} there are no points for {chords[k]:.3g} m{widest}: the road is a guess there"
    ]


def _fit_note(fit: _Fit, rows: NDArray[np.int64]) -> str:
    return (
        f"{rows.size} points; largest deviation {fit.deviation:.3g} m, at point {rows[fit.distances.argmax()]}; "
        f"root mean square {math.sqrt(np.mean(portable.square(fit.distances))):.3g} m; "
        f"smoothing length {fit.scale:.3g} m"
    )


def _bound_notes(estimate: _Estimate, fit: _Fit, bound: float) -> list[str]:
    """A note where the bound and not the noise chose the smoothing length."""
    scale = float(estimate.scales[estimate.best])
    if fit.scale >= scale:
        return []
    noise = "" if math.isnan(estimate.noise) else f" of {estimate.noise:.2g} m"
    return [
        f"the bound of {bound:.3g} m on the deviation, not the noise{noise}, chose the smoothing length; without it "
        f"that is {scale:.3g} m, up to {estimate.distances.max():.3g} m from a point"
    ]


def _outlier_notes(road: Road, record: _Record, s: Array, outliers: NDArray[np.bool_]) -> list[str]:
    """A note on the points that were left out, with their distances from the road at arc lengths s (n,) m."""
    foot, points = road.at(s[outliers]), record.points[outliers]
    distances = portable.hypot(foot.x - points[:, 0], foot.y - points[:, 1])
    texts = [
        f"at point {row} ({distance:.3g} m)" for row, distance in zip(record.rows[outliers], distances, strict=True)
    ]
    return [f"{len(texts)} of {outliers.size} points left out as outliers: {_first_few(texts)}"] if texts else []


def _first_few(texts: list[str]) -> str:
    remainder = [f"{len(texts) - MAX_NAMED_POINTS} more"] if len(texts) > MAX_NAMED_POINTS else []
    return ", ".join([*texts[:MAX_NAMED_POINTS], *remainder])


def _sort_by_arc_length(s: Array, values: Array, road: Road) -> tuple[Array, Array]:
    """Values at arc lengths s (n,) m in their order; of several at one place the last one counts."""
    if road.closed:
        s = np.mod(s, road.length)
    order = np.argsort(s, kind="stable")
    s, values = s[order], np.asarray(values, dtype=np.float64)[order]
    last = np.append(np.diff(s) > 1e-9, True)
    s, values = s[last], values[last]
    if road.closed:  # so that it is continuous over the seam
        s = np.concatenate([[s[-1] - road.length], s, [s[0] + road.length]])
        values = np.concatenate([[values[-1]], values, [values[0]]])
    return s, values


# -- the record -------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class _Record:
    """Points in the order in which they are driven."""

    points: Array
    """(n, 2) m"""
    rows: NDArray[np.int64]
    """(n,) their numbers"""
    origin: Array
    """(2,) m, about which they are fitted: keeps digits of far places"""
    closed: bool

    @cached_property
    def steps(self) -> Array:
        """The distances (m) of points in a row, on a lap also of the last from the first."""
        return portable.hypot(*np.diff(self.points, axis=0, append=self.points[:1]).T)[: None if self.closed else -1]

    @property
    def has_gaps(self) -> bool:
        """Whether some points in a row are much farther apart than usual."""
        return bool(self.steps.max() > GAP * _usual_step(self.steps))

    def without(self, out: NDArray[np.bool_]) -> _Record:
        """The record without some of its points."""
        return _Record(self.points[~out], self.rows[~out], self.origin, self.closed)


def _usual_step(steps: Array) -> float:
    """The median of the distances (m) of points in a row, without repetitions."""
    return float(np.median(steps[steps > 1e-3 * steps.mean()]))


def _find_lap(points: Array, closed: bool | None) -> tuple[int, bool, list[str]]:
    """The number of points that make the road, whether it is a lap, and notes.

    A lap is closed where the record is back in the direction of its start (within 60 degrees), within twice the median
    distance of its points, or 3 m, or a quarter of its extent if that is less than 3 m, having been farther away. So is
    one whose end leads straight to its start, over a gap at most twice as wide as another one in it.
    """
    steps = np.diff(points, axis=0)
    lengths = portable.hypot(steps[:, 0], steps[:, 1])
    spacing = _usual_step(lengths)
    distance = portable.hypot(*(points - points[0]).T)
    near = max(2.0 * spacing, min(3.0, 0.25 * float(distance.max())))
    s = np.concatenate([[0.0], np.cumsum(lengths)])
    start = points[int(np.searchsorted(s, min(near, 0.2 * s[-1])))] - points[0]
    back = np.flatnonzero((distance < near) & (np.maximum.accumulate(distance) > 1.5 * near))
    ahead = np.concatenate([steps, steps[-1:]])
    ahead[-1] = points[-1] - points[np.searchsorted(s, s[-1] - near, "right") - 1]
    with np.errstate(invalid="ignore"):
        aligned = product(ahead, start) > 0.5 * portable.hypot(*ahead.T) * portable.hypot(*start)
    passes = np.split(back, np.flatnonzero(np.diff(back) > 1) + 1)
    first = next((rows for rows in passes if aligned[rows].any()), np.empty(0, dtype=np.int64))
    leads = distance[-1] <= WIDER_GAP * lengths.max() and _cosine_over(points, points) > GAP_COSINE
    if not (first.size > 0 or leads if closed is None else closed):
        return len(points), False, []
    count = len(points)
    if first.size:  # the point before the start
        advance = product(points[first] - points[0], start) / portable.hypot(*start)
        before = first[advance < -1e-3 * spacing]
        count = int(before[-1]) + 1 if before.size else int(first[0])
    remaining_length = float(s[-1] - s[min(count, len(points) - 1)])
    notes = ["a closed lap"]
    if remaining_length > 2.0 * near:
        notes.append(f"the record goes on for {remaining_length:.0f} m beyond its start: left out")
    return count, True, notes


# -- the fit ----------------------------------------------------------------------------------------------------------
class _Fit(NamedTuple):
    """A curve near points, about the origin of their record."""

    scale: float
    """m, the smoothing length"""
    powers: Array
    """(count, 2, 4) m, its cubics"""
    table: Pieces
    along: Array
    """(n,) m, arc length of each point's foot"""
    distances: Array
    """(n,) m"""

    @property
    def deviation(self) -> float:
        """Deviation of the line from the points (m)."""
        return float(self.distances.max())


@dataclass(frozen=True)
class _Estimate:
    """The smoothing length that the noise of a record asks for."""

    record: _Record
    smoother: Smoother
    """with the points at their feet"""
    scales: Array
    """m, smoothing lengths, increasing"""
    best: int
    distances: Array
    """(n,) m, of the points from the curve of the best smoothing length"""
    noise: float
    """m, standard deviation of the points across the curve, whatever a few of them do; NaN: no estimate"""


def _cross_validated(record: _Record, robust: bool) -> tuple[_Estimate, NDArray[np.bool_]]:
    """The smoothing length that cross-validation chooses, and the outliers that it leaves out if it is robust."""
    outliers = _find_spikes(record.points) if robust else np.zeros(len(record.points), dtype=bool)
    estimate = _estimate(record.without(outliers))
    if not robust:
        return estimate, outliers
    for _ in range(ROUNDS):
        distances, noise = _robust_distances(estimate, record, outliers)
        is_outlier = distances > max(MAX_DEVIATION, MAX_NOISE_DEVIATIONS * noise)
        if (is_outlier == outliers).all() or is_outlier.mean() > SHARE:
            break
        outliers = is_outlier
        estimate = _estimate(record.without(outliers))
    lonely = _isolated(outliers, *_robust_distances(estimate, record, outliers))
    return (estimate if (lonely == outliers).all() else _estimate(record.without(lonely))), lonely


def _find_spikes(points: Array) -> NDArray[np.bool_]:
    """Mark short rows of points to which the record leaps, and from which it leaps back."""
    spikes = np.zeros(len(points), dtype=bool)
    steps = portable.hypot(*np.diff(points, axis=0).T)
    leaps = np.flatnonzero(steps > LEAP * scipy.ndimage.median_filter(steps, 4 * IN_A_ROW + 1, mode="nearest"))
    for there, back in itertools.pairwise(leaps):
        bridge = points[back + 1] - points[there]
        before = points[there] - points[max(int(there) - IN_A_ROW, 0)]
        after = points[back + 1 : back + 2 + IN_A_ROW][-1] - points[back + 1]
        is_bend = product(before, after) < 0.0
        if back - there <= IN_A_ROW and not is_bend and LEAP * portable.hypot(*bridge) < steps[there : back + 1].sum():
            spikes[there + 1 : back + 1] = True
    return spikes


def _robust_distances(estimate: _Estimate, record: _Record, out: NDArray[np.bool_]) -> tuple[Array, float]:
    """(n,) m, the distances of all points from a curve that is too smooth to follow a few, and the noise about it."""
    places = np.interp(record.rows, estimate.record.rows, estimate.smoother.places)
    scale = max(float(estimate.scales[estimate.best]), MIN_ROBUST_SMOOTHING * estimate.smoother.spacing)
    scales = [scale, *estimate.scales[estimate.scales > scale]]
    fit = _first_fit(estimate.smoother, scales, record.points - record.origin, places)
    return fit.distances, _noise(fit.distances[~out], estimate.smoother.score(fit.scale).used)


def _noise(distances: Array, used: float) -> float:
    """The standard deviation (m) of points about a curve, from the median of their distances."""
    return 1.4826 * float(np.median(distances)) / math.sqrt(max(1.0 - used / distances.size, 0.1))


def _isolated(out: NDArray[np.bool_], distances: Array, noise: float) -> NDArray[np.bool_]:
    """The outliers in short rows whose neighbours lie on the curve: not the points of a bend that it cuts."""
    lonely = np.zeros_like(out)
    rows = np.flatnonzero(out)
    for row in np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1):
        if 0 < row.size <= IN_A_ROW:
            neighbours = np.arange(max(row[0] - BESIDE, 0), min(row[-1] + BESIDE + 1, out.size))
            neighbours = neighbours[~out[neighbours]]
            lonely[row] = (distances[neighbours] <= MET * max(noise, MAX_DEVIATION / MAX_NOISE_DEVIATIONS)).all()
    return lonely


def _estimate(record: _Record) -> _Estimate:
    """The smoothing length and the places of the points, each from the other in turn."""
    points = record.points - record.origin
    polygon = np.concatenate([[0.0], np.cumsum(record.steps)])
    places, length = polygon[: len(points)], float(polygon[-1])
    spacing, order = max(length / len(points), SHORTEST_KNOTS), 3
    if record.has_gaps:
        spacing, order = max(0.5 * float(np.quantile(record.steps, 0.1)), SHORTEST_KNOTS), 2
    scales = portable.geomspace(0.5 * spacing, max(min(0.25 * length, 5000.0), spacing), LENGTHS)
    best = None
    for _ in range(FITS):
        smoother = Smoother(points, places, length, record.closed, spacing, order)
        fit = _first_fit(smoother, scales[smoother.best_scale(scales, best) :], points, places)
        best, places, length = int(np.searchsorted(scales, fit.scale)), fit.along, fit.table.length
        if not record.closed:
            places = places - places.min()
    used = smoother.score(fit.scale).used
    noise = _noise(fit.distances, used) if used < MEASURABLE * len(points) else math.nan
    smoother = Smoother(points, places, length, record.closed, spacing, order)
    return _Estimate(record, smoother, scales, int(np.searchsorted(scales, fit.scale)), fit.distances, noise)


def _first_fit(smoother: Smoother, scales: Iterable[float], points: Array, places: Array) -> _Fit:
    """The fit of the first smoothing length whose curve does not fold."""
    for scale in scales:
        fit = _fit_of(smoother, float(scale), points, places)
        if fit is not None:
            return fit
    raise InvalidInput("fit_road: the points fold back on themselves: give them in the order in which they are driven.")


def _fit_of(smoother: Smoother, scale: float, points: Array, places: Array) -> _Fit | None:
    """The curve of a smoothing length, with the feet of points near their places.

    None where it has a cusp, or turns as hard as only noise does.
    """
    powers = smoother.powers(scale)
    try:
        table, knots = cubic_line(powers)
    except InvalidInput:
        return None
    line = table.packed(smoother.closed)
    if line.numbers[MOST_CURVATURE] * table.length > FOLD * len(powers):
        return None
    laps = np.floor(places / smoother.length) if smoother.closed else np.zeros_like(places)
    parameters = np.linspace(0.0, smoother.length, knots.size)
    near = laps * table.length + np.interp(places - laps * smoother.length, parameters, knots)
    feet = np.empty((len(points), 4))
    project_all(line, np.column_stack([points, near]), feet)
    s, offset = feet[:, 0].copy(), np.where(np.isnan(feet[:, 1]), np.inf, feet[:, 1])
    beyond = 0.0 if smoother.closed else s - np.clip(s, 0.0, table.length)
    return _Fit(scale, powers, table, s, portable.hypot(offset, beyond))


def _bounded_fit(estimate: _Estimate, bound: float) -> _Fit:
    """The curve of the longest smoothing length, up to the one that the noise asks for, that keeps a bound."""
    smoother, scales, best = estimate.smoother, estimate.scales, estimate.best
    nearest, worst = float(estimate.distances.max()), int(estimate.distances.argmax())
    for refinement in range(KNOT_REFINEMENTS + 1):
        if refinement:
            longest = scales[best]
            smoother = smoother.finer()
            scales = portable.geomspace(0.5 * smoother.spacing, scales[-1], LENGTHS)
            best = int(np.searchsorted(scales, longest, "right")) - 1
        low, high, middle, fit = -1, best + 1, best, None
        while high - low > 1:
            trial = _fit_of(smoother, float(scales[middle]), smoother.points, smoother.places)
            deviation = math.inf if trial is None else trial.deviation
            if trial is not None and deviation < nearest:
                nearest, worst = deviation, int(trial.distances.argmax())
            low, high, fit = (middle, high, trial) if deviation <= bound else (low, middle, fit)
            middle = (low + high) // 2
        if fit is not None:
            return fit
    scatter = "" if math.isnan(estimate.noise) else f", which scatter by {estimate.noise:.2g} m"
    raise InvalidInput(
        f"fit_road: no smooth curve stays within max_deviation = {bound:.3g} m of the points{scatter}; one is "
        f"{nearest:.3g} m from point {estimate.record.rows[worst]}: allow more, or correct the points there."
    )


def _road(fit: _Fit, record: _Record) -> Road:
    """The road of a fit; each element in a frame at its begin keeps all digits."""
    starts = fit.powers[:, :, 0] + record.origin
    fit.powers[:, :, 0] = 0.0
    cubics = tuple(
        Cubic(x=tuple(x), y=tuple(y), start=(*start, 0.0))
        for (x, y), start in zip(fit.powers.tolist(), starts.tolist(), strict=True)
    )
    table = placed(fit.table, Pose(*record.origin.tolist()))
    return Road(name="points", table=table, closed=record.closed, elements=cubics)

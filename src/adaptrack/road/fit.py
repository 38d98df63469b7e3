"""A smooth road through or near recorded points: a penalised cubic spline, its largest deviation stated and bounded.

The curve c(t) = sum_j a_j B_j(t) (cubic B-splines on even knots) minimises

    sum_i |p_i - c(t_i)|^2 + (l/2 pi)^6/spacing * integral of |c'''(t)|^2 dt,

so that what is shorter than the smoothing length l counts as noise; c''' vanishes on parabolas, hence nearly on lines
and wide arcs, and clothoids pay little (P-splines: P. Eilers and B. Marx, *Flexible smoothing with B-splines and
penalties*, Statistical Science 11 (1996); the penalty is on third differences). l is found by generalised
cross-validation with the count of parameters taken 1.4 times, which seldom takes noise for road (Y.-J. Kim and C. Gu,
Journal of the Royal Statistical Society B 66 (2004)), and then made shorter until no point is farther from the curve
than allowed. The t_i are the arc lengths of the points' feet on the curve, found by fitting more than once.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy  # loads its parts when they are first used
from numpy.typing import ArrayLike

from adaptrack.arguments import reals
from adaptrack.errors import InvalidInput, real
from adaptrack.road.projection import feet_near
from adaptrack.road.road import Road, alongs
from adaptrack.road.segments import Array, Cubic, Pose, Segment
from adaptrack.road.table import Table, joined, placed, tabulate

MAX_DEVIATION = 0.5
"""m, allowed unless another is asked for."""
FEWEST = 4
"""Points."""
FITS = 3
"""How often the points find their places along the curve anew."""
SHORTEST_KNOTS = 0.5
"""m, the least distance of the knots to begin with: denser points are averaged by the fit."""
REFINEMENTS = 3
"""How often the knots are put at half the distance when the curve cannot come as near as asked."""
LENGTHS = 28
"""Smoothing lengths that cross-validation compares."""
CAUTION = 1.4
"""Factor on the number of parameters in cross-validation."""
EXACT_TRACE = 500
"""Up to so many parameters their number in use is computed exactly, else from random signs."""
PROBES = 24
"""Random signs, per point, of that estimate."""

_TO_POWERS = (
    np.array([[1.0, 4.0, 1.0, 0.0], [-3.0, 0.0, 3.0, 0.0], [3.0, -6.0, 3.0, 0.0], [-1.0, 3.0, -3.0, 1.0]]) / 6.0
)
"""Coefficients of 1, p, p^2, p^3 between two knots, 0 <= p <= 1, from the four B-splines that are not zero there."""


def fit_road(
    points: ArrayLike,
    *,
    max_deviation: float = MAX_DEVIATION,
    closed: bool | None = None,
    smoothest: bool = False,
    name: str = "points",
    **along: Any,
) -> Road:
    """A road with continuous curvature through or near points in the order in which they are driven.

    Parameters
    ----------
    points : (n, 2) array
        x, y in m. Where the record goes on beyond its start, the rest is left out.
    max_deviation : float
        m, the largest distance of a point from the curve that is allowed, > 0.
    closed : bool, optional
        Whether the road is a lap; by default so when the record comes back to its start in the same direction.
    smoothest : bool
        The smoothest curve that keeps `max_deviation`, instead of the one that cross-validation chooses.
    **along
        As in `Road.from_segments`, at arc lengths of the road; arrays (n,) are values at the points.

    Returns
    -------
    Road
        `deviation` is its largest distance (m) from a point; `notes` say where, and what was left out.

    Raises
    ------
    InvalidInput
        When points are too few, not finite or all the same, or no curve comes as near as asked.
    """
    points = _checked("fit_road", points)
    if not 0.0 < real("fit_road", "max_deviation", max_deviation) < math.inf:
        raise InvalidInput(f"fit_road: max_deviation = {max_deviation!r}: must be a distance > 0 m.")
    kept, lap, notes = _lap(points, closed)
    origin = points[:kept].mean(axis=0)
    record = _Record(points[:kept] - origin, lap)
    curve, length = _chosen(record, max_deviation, smoothest)
    notes = [*notes, _said(curve, length, kept)]
    values = {
        key: (curve.along, np.asarray(value, dtype=np.float64)[:kept])
        if isinstance(value, np.ndarray) and value.shape == (len(points),)
        else value
        for key, value in along.items()
    }
    moved = Pose(float(origin[0]), float(origin[1]), 0.0)
    return Road(
        name=name, table=placed(curve.road.table, moved), closed=lap, notes=tuple(notes), deviation=curve.deviation,
        elements=tuple(_moved(element, moved) for element in curve.road.elements),
        **alongs({key: _by_place(value, curve.road) for key, value in values.items()}),
    )  # fmt: skip


def road_through(points: ArrayLike, *, closed: bool = False, name: str = "points", **along: Any) -> Road:
    """A road through points without noise, such as a planner publishes, many times as fast as `fit_road`.

    A cubic spline over the length of their polygon: continuous curvature, exact at the points, no smoothing.

    Parameters
    ----------
    points : (n, 2) array
        x, y in m, no two alike in a row; a lap ends before its start.
    closed, name, **along
        As in `Road.from_segments`.

    Raises
    ------
    InvalidInput
        When points are too few, not finite, alike in a row, or fold back on themselves.
    """
    points = _checked("road_through", points)
    ring = np.concatenate([points, points[:1]]) if closed else points
    steps = np.hypot(*np.diff(ring, axis=0).T)
    if not steps.min() > 0.0:
        raise InvalidInput(f"road_through: point {int(steps.argmin())} comes twice; leave one out.")
    places = np.concatenate([[0.0], np.cumsum(steps)])
    spline = scipy.interpolate.CubicSpline(places, ring, bc_type="periodic" if closed else "not-a-knot")
    powers = spline.c[::-1].transpose(1, 2, 0) * steps[:, np.newaxis, np.newaxis] ** np.arange(4)
    cubics = _in_a_row(powers)
    return Road(name=name, table=_laid(cubics), closed=closed, elements=cubics, **alongs(along))


def _checked(where: str, points: ArrayLike) -> Array:
    points = reals(f"{where}: points", points).copy()
    if points.ndim != 2 or points.shape[1] != 2 or len(points) < FEWEST:
        raise InvalidInput(f"{where}: points have shape {points.shape}; give (n, 2) with n >= {FEWEST}, x and y in m.")
    if not np.isfinite(points).all():
        row = int(np.argwhere(~np.isfinite(points))[0, 0])
        raise InvalidInput(f"{where}: point {row} is not finite; leave it out.")
    return points


def _moved(element: Segment, by: Pose) -> Segment:
    assert element.start is not None
    x, y, heading = element.start
    return element.replace(start=(by.x + x, by.y + y, heading))


def _said(curve: _Fit, length: float, kept: int) -> str:
    wide = "" if math.isinf(length) else f"; smoothing length {length:.3g} m"
    return (
        f"{kept} points; largest deviation {curve.deviation:.3g} m, at point {curve.worst}; "
        f"root mean square {curve.rms:.3g} m{wide}"
    )


def _by_place(value: Any, road: Road) -> Any:
    """Values at points, in the order of their places along the road; the last of those at one place counts."""
    if not (isinstance(value, tuple) and isinstance(value[0], np.ndarray)):
        return value
    s, values = value
    if road.closed:
        s = np.mod(s, road.length)
    order = np.argsort(s, kind="stable")
    s, values = s[order], values[order]
    last = np.append(np.diff(s) > 1e-9, True)
    s, values = s[last], values[last]
    if road.closed:  # so that it is continuous over the seam
        s = np.concatenate([[s[-1] - road.length], s, [s[0] + road.length]])
        values = np.concatenate([[values[-1]], values, [values[0]]])
    return s, values


# -- the record -------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class _Record:
    """Points in the order in which they are driven, about the origin."""

    points: Array
    """(n, 2) m"""
    closed: bool

    def first_places(self) -> tuple[Array, float]:
        """The length of the polygon up to each point, and its whole."""
        steps = np.hypot(*np.diff(self.points, axis=0, append=self.points[:1]).T)
        places = np.concatenate([[0.0], np.cumsum(steps)])
        return places[:-1], float(places[-1] if self.closed else places[-2])


def _lap(points: Array, closed: bool | None) -> tuple[int, bool, list[str]]:
    """How many points make the road, whether it is a lap, and what there is to say about it.

    A lap is closed where the record is back within twice the usual distance of its points (3 m at least) of its start,
    in the direction of its start (within 60 degrees), after ten times that distance.
    """
    steps = np.diff(points, axis=0)
    lengths = np.hypot(steps[:, 0], steps[:, 1])
    if not lengths.max() > 0.0:
        raise InvalidInput("fit_road: all points are the same; give a road with a length.")
    usual = float(np.median(lengths[lengths > 1e-3 * lengths.max()]))
    near = max(2.0 * usual, 3.0)
    whole = np.concatenate([[0.0], np.cumsum(lengths)])
    start = points[int(np.searchsorted(whole, min(near, 0.2 * whole[-1])))] - points[0]
    distance = np.hypot(*(points - points[0]).T)
    back = (distance < near) & (whole > 10.0 * near)
    ahead = np.concatenate([steps, steps[-1:]])
    ahead[-1] = points[-1] - points[np.searchsorted(whole, whole[-1] - near)]
    with np.errstate(invalid="ignore"):
        same = (ahead @ start) > 0.5 * np.hypot(*ahead.T) * np.hypot(*start)
    passes = np.split(np.flatnonzero(back), np.flatnonzero(np.diff(np.flatnonzero(back)) > 1) + 1)
    first = next((each for each in passes if same[each].any()), np.empty(0, dtype=np.int64))
    if closed is None:
        closed = first.size > 0
    if not closed:
        return len(points), False, []
    kept = len(points)
    if first.size:  # the point before the start
        beside = (points[first] - points[0]) @ start / np.hypot(*start)
        before = first[beside < -1e-3 * usual]
        kept = int(before[-1]) + 1 if before.size else int(first[0])
    rest = float(whole[-1] - whole[kept - 1])
    said = ["a closed lap"]
    if rest > 2.0 * near:
        said.append(f"the record goes on for {rest:.0f} m beyond its start: left out")
    return kept, True, said


# -- the fit ----------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class _Fit:
    """A road near a record, and how near."""

    road: Road
    along: Array
    """(n,) m, arc length of each point's foot"""
    deviation: float
    """m"""
    worst: int
    rms: float
    """m"""


def _chosen(record: _Record, bound: float, smoothest: bool) -> tuple[_Fit, float]:
    """The fit by cross-validation, less smooth where the bound asks for it; and its smoothing length (m)."""
    places, length = record.first_places()
    nearest: _Fit | None = None
    for refinement in range(REFINEMENTS + 1):
        spacing = max(length / len(record.points), SHORTEST_KNOTS) / 2.0**refinement
        scales = np.geomspace(0.5 * spacing, max(min(0.25 * length, 5000.0), spacing), LENGTHS)
        for _ in range(FITS):
            system = _System(record, places, length, spacing)
            best = LENGTHS - 1 if smoothest else int(np.argmin([system.score(scale) for scale in scales]))
            best, found = _from(system, scales, best)
            places, length = _kept_in_order(found, record), found.road.length
        if not refinement or found.deviation < nearest.deviation:  # type: ignore[union-attr]
            nearest = found
        system = _System(record, places, length, spacing)
        kept = _bisected(system, scales, best, bound)
        if kept is not None:
            return kept
    assert nearest is not None
    raise InvalidInput(
        f"fit_road: no smooth curve stays within max_deviation = {bound:g} m of the points; one is "
        f"{nearest.deviation:.3g} m from point {nearest.worst}: allow more, or correct the points there."
    )


def _from(system: _System, scales: Array, first: int) -> tuple[int, _Fit]:
    """The fit of a smoothing length, or of the next longer one whose curve has no cusp."""
    for k in range(first, LENGTHS):
        with contextlib.suppress(InvalidInput):
            return k, system.fit(scales[k])
    raise InvalidInput("fit_road: the points fold back on themselves: give them in the order in which they are driven.")


def _bisected(system: _System, scales: Array, best: int, bound: float) -> tuple[_Fit, float] | None:
    """The fit of the longest smoothing length up to `best` that keeps the bound, and that length; None without one."""
    low, high, middle, kept = -1, best + 1, best, None
    while high - low > 1:
        try:
            found = system.fit(scales[middle])
            keeps = found.deviation <= bound
        except InvalidInput:  # a cusp
            keeps = False
        if keeps:
            low, kept = middle, (found, float(scales[middle]))
        else:
            high = middle
        middle = (low + high) // 2
    return kept


def _kept_in_order(found: _Fit, record: _Record) -> Array:
    """The places of the points for the next fit."""
    places = found.along - (0.0 if record.closed else found.along.min())
    return np.clip(places, 0.0, None) if not record.closed else places


class _System:
    """The normal equations of a record at given places, for any smoothing length."""

    def __init__(self, record: _Record, places: Array, length: float, spacing: float) -> None:
        self.record, self.length = record, max(length, float(places.max())) if not record.closed else length
        self.count = max(4, math.ceil(self.length / spacing))
        self.knot = self.length / self.count
        self.places = np.mod(places, self.length) if record.closed else places
        knots = self.knot * np.arange(-3, self.count + 4)
        self.knots = knots
        inside = np.clip(self.places, 0.0, self.length * (1.0 - 1e-15))
        basis = scipy.sparse.csr_array(scipy.interpolate.BSpline.design_matrix(inside, knots, 3))
        self.size = self.count if record.closed else self.count + 3
        self.basis = scipy.sparse.csc_array(basis @ self._wrap()) if record.closed else scipy.sparse.csc_array(basis)
        differences = _third_differences(self.count + 3)
        if record.closed:
            wrapped = self._wrap()
            differences = scipy.sparse.csr_array(differences @ wrapped)
        self.rough = scipy.sparse.csc_array(differences.T @ differences) / self.knot**5
        self.normal = scipy.sparse.csc_array(self.basis.T @ self.basis)
        self.right = self.basis.T @ record.points
        self.spacing = self.length / len(record.points)

    def _wrap(self) -> scipy.sparse.csr_array:
        """Coefficients of all B-splines from those of one lap."""
        n = self.count + 3
        rows = np.arange(n)
        return scipy.sparse.csr_array((np.ones(n), (rows, rows % self.count)), shape=(n, self.count))

    def _factor(self, scale: float) -> Any:
        from scipy.sparse.linalg import splu

        weight = (scale / (2.0 * math.pi)) ** 6 / self.spacing
        tiny = 1e-12 * scipy.sparse.diags_array(np.ones(self.size))  # knots between which no point lies
        return splu(scipy.sparse.csc_array(self.normal + weight * self.rough + tiny))

    def score(self, scale: float) -> float:
        """Generalised cross-validation: n RSS/(n - 1.4 trace)^2."""
        factor = self._factor(scale)
        n = len(self.record.points)
        residual = self.record.points - self.basis @ factor.solve(self.right)
        used = self._trace(factor)
        left = n - CAUTION * used
        return n * float((residual**2).sum()) / left**2 if left > 0.0 else math.inf

    def _trace(self, factor: Any) -> float:
        """How many parameters the fit uses: the trace of its hat matrix."""
        if self.size <= EXACT_TRACE:
            return float(np.trace(factor.solve(self.normal.toarray())))
        signs = np.random.default_rng(1).choice([-1.0, 1.0], (self.basis.shape[0], PROBES))
        return float((signs * (self.basis @ factor.solve(self.basis.T @ signs))).sum() / PROBES)

    def fit(self, scale: float) -> _Fit:
        """The road of a smoothing length, and how near it comes."""
        coefficients = self._factor(scale).solve(self.right)
        if self.record.closed:
            coefficients = coefficients[np.arange(self.count + 3) % self.count]
        cubics = self._cubics(coefficients)
        road = Road(name="fit", table=_laid(cubics), closed=self.record.closed, elements=cubics)
        return _measured(road, self.record, self.places * (road.length / self.length))

    def _cubics(self, coefficients: Array) -> tuple[Cubic, ...]:
        """The spline as a row of cubics, each in a frame at its own start: their coefficients then keep all digits."""
        corners = np.stack([coefficients[k : k + self.count] for k in range(4)])
        powers = np.einsum("ij,jkl->kli", _TO_POWERS, corners)
        return _in_a_row(powers)


def _in_a_row(powers: Array) -> tuple[Cubic, ...]:
    """Cubics from their coefficients (n, 2, 4), each in a frame at its own start."""
    start = powers[:, :, 0].tolist()
    powers[:, :, 0] = 0.0
    return tuple(
        Cubic(x=tuple(x), y=tuple(y), start=(*origin, 0.0))
        for (x, y), origin in zip(powers.tolist(), start, strict=True)
    )


def _laid(cubics: Sequence[Cubic]) -> Table:
    """The table of cubics where they lie."""
    return joined([placed(table, cubic.pose or Pose()) for table, cubic in zip(tabulate(cubics), cubics, strict=True)])


def _third_differences(n: int) -> scipy.sparse.csr_array:
    """(n - 3, n)."""
    stencil = [-1.0, 3.0, -3.0, 1.0]
    return scipy.sparse.csr_array(scipy.sparse.diags_array(stencil, offsets=[0, 1, 2, 3], shape=(n - 3, n)))


def _measured(road: Road, record: _Record, near: Array) -> _Fit:
    """How far the points are from the road: from their feet near these arc lengths; ends are ends."""
    x, y = record.points.T
    feet = feet_near(road, x, y, near).s
    inside = feet if record.closed else np.clip(feet, 0.0, road.length)
    foot = road.at(inside)
    away = np.hypot(foot.x - x, foot.y - y)
    worst = int(away.argmax())
    return _Fit(road, feet, float(away[worst]), worst, float(np.sqrt(np.mean(away**2))))

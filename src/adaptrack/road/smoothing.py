"""Penalised cubic splines near points or heights, for any smoothing length: their normal equations are bands.

The curve c(t) = sum_j a_j B_j(t) (cubic B-splines on even knots) minimises

    sum_i |p_i - c(t_i)|^2 + (l/2 pi)^6/spacing * integral of |c'''(t)|^2 dt,

so that what is shorter than the smoothing length l counts as noise; c''' vanishes on parabolas, hence nearly on lines
and wide arcs, and clothoids pay little (P-splines: P. Eilers and B. Marx, *Flexible smoothing with B-splines and
penalties*, Statistical Science 11 (1996); the penalty is on third differences). Over a gap between points such a curve
continues the curvature at its edges: it bulges. With gaps the penalty is therefore on second differences, of order 2:
(l/2 pi)^4/spacing * integral of |c''(t)|^2 dt. A curve as smooth as l needs no more than `KNOTS` knots in it.

The grade of a road is the slope of such a curve near its heights, with the smoothing length that cross-validation
chooses. The penalty leaves parabolas alone, the vertical curves of road design. Waves shorter than
`MIN_HEIGHT_SMOOTHING` count as noise, and so do the stairs of rounded heights, which cross-validation would take for
road.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import scipy  # loads its parts when they are first used
from numpy.typing import NDArray

from adaptrack.base.errors import InvalidInput
from adaptrack.base.limits import MAX_GRADE
from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import Array, product

KNOTS = 10.0
"""In a smoothing length, at most."""
COARSE = 3
"""Step in the smoothing lengths in which the search for the best one begins."""
LENGTHS = 28
"""Smoothing lengths that cross-validation compares."""
PARAMETER_PENALTY = 1.4
"""Factor on the number of parameters in cross-validation."""
EXACT_TRACE = 500
"""Up to so many parameters their number in use is computed exactly, else from random signs."""
PROBES = 50_000
"""Random signs of that estimate, two for each point at least."""
MIN_HEIGHT_SMOOTHING, MAX_HEIGHT_SMOOTHING = 10.0, 1000.0
"""m, the least and the largest smoothing length of heights; a shorter wave is roughness, not grade."""
STAIRS = 4.0
"""Smoothing length at least, over the median distance of two changes of the height."""

_TO_POWERS = (
    np.array([[1.0, 4.0, 1.0, 0.0], [-3.0, 0.0, 3.0, 0.0], [3.0, -6.0, 3.0, 0.0], [-1.0, 3.0, -3.0, 1.0]]) / 6.0
)
"""Coefficients of 1, p, p^2, p^3 between two knots, 0 <= p <= 1, from the four B-splines that are not zero there."""
_DIFFERENCES = {
    2: math.sqrt(0.5) * np.array([[1.0, -2.0, 1.0, 0.0], [0.0, 1.0, -2.0, 1.0]]),
    3: np.array([[-1.0, 3.0, -3.0, 1.0]]),
}
"""Differences of four coefficients in a row, by the order of the penalty; their squares are summed."""


class Score(NamedTuple):
    """How a smoothing length does in cross-validation."""

    value: float
    """m^2; the least is the best"""
    used: float
    """how many parameters the fit uses: the trace of its hat matrix"""


class Smoother:
    """Points (n, d) at places (n,) along a curve of some length, m; its knots are at least `spacing` apart.

    order: of the derivative that is penalised, 3, or 2 for points with gaps.
    """

    def __init__(
        self, points: Array, places: Array, length: float, closed: bool, spacing: float, order: int = 3
    ) -> None:
        self.points, self.places, self.closed, self.spacing, self.order = points, places, closed, spacing, order
        self.length = length if closed else max(length, float(places.max()))
        self._system: _System | None = None

    def finer(self) -> Smoother:
        """Return a smoother with knots at half the distance."""
        return Smoother(self.points, self.places, self.length, self.closed, 0.5 * self.spacing, self.order)

    def _system_at(self, scale: float) -> tuple[_System, Array]:
        """The equations that suit a smoothing length, and their factor."""
        count = max(4, math.ceil(self.length / max(self.spacing, scale / KNOTS)))
        if self._system is None or self._system.count != count:
            self._system = _System(self.points, self.places, self.length, self.closed, count, self.order)
        weight = portable.power(scale / (2.0 * math.pi), 2 * self.order) * len(self.points) / self.length
        return self._system, self._system.factor(weight)

    def powers(self, scale: float) -> Array:
        """The cubics (count, d, 4) of a smoothing length (m), as `table.cubic_line` reads them."""
        system, factor = self._system_at(scale)
        coefficients = portable.banded_solve(factor, system.right)
        corners = coefficients[system.column(np.arange(system.count)[:, np.newaxis] + np.arange(4))]
        return np.moveaxis(product(_TO_POWERS, corners), 1, 2)

    def fitted(self, scale: float) -> Array:
        """The curve of a smoothing length at the places, (n, d)."""
        system, factor = self._system_at(scale)
        return np.asarray(system.basis @ portable.banded_solve(factor, system.right))

    def score(self, scale: float) -> Score:
        """Generalised cross-validation: n RSS/(n - 1.4 trace)^2."""
        system, factor = self._system_at(scale)
        n, residual = len(self.points), self.points - self.fitted(scale)
        used = self._trace(system, factor)
        left = n - PARAMETER_PENALTY * used
        return Score(n * float((residual * residual).sum()) / (left * left) if left > 0.0 else math.inf, used)

    def best_scale(self, scales: Array, start: int | None = None) -> int:
        """The smoothing length with the least score, downhill from one, or from the least of a few."""
        scores: dict[int, float] = {}

        def score(k: int) -> float:
            if k not in scores:
                scores[k] = self.score(float(scales[k])).value
            return scores[k]

        best = min(range(0, scales.size, COARSE), key=score) if start is None else start
        while True:
            near = min(range(max(best - 1, 0), min(best + 2, scales.size)), key=score)
            if score(near) == score(best):
                return best
            best = near

    def _trace(self, system: _System, factor: Array) -> float:
        basis = system.basis
        if system.size <= EXACT_TRACE:
            normal = (basis.T @ basis).toarray()
            return float(np.trace(portable.banded_solve(factor, normal)))
        n = len(self.points)
        probes = max(2, round(PROBES / n))
        signs = np.random.default_rng(1).choice([-1.0, 1.0], (n, probes))
        solution = basis @ portable.banded_solve(factor, basis.T @ signs)
        return float((signs * solution).sum() / probes)


class _System:
    """The normal equations of one set of knots, for any weight of the penalty.

    The coefficients of an open curve are in their order, and each meets the three next ones. A ring is folded flat:
    its coefficients go there and back in turns, and each meets others at most six apart.
    """

    def __init__(self, points: Array, places: Array, length: float, closed: bool, count: int, order: int) -> None:
        self.closed, self.count, self.knot = closed, count, length / count
        self.size, self._width = (count, 6) if closed else (count + 3, 3)
        t = (np.mod(places, length) if closed else np.clip(places, 0.0, length)) / self.knot
        first = np.minimum(t.astype(np.int64), count - 1)
        values = product(np.vander(t - first, 4, increasing=True), _TO_POWERS)
        columns = self.column(first[:, np.newaxis] + np.arange(4))
        rows = np.repeat(np.arange(len(points)), 4)
        self.basis = scipy.sparse.csr_array((values.ravel(), (rows, columns.ravel())), shape=(len(points), self.size))
        self.right = self.basis.T @ points
        self._normal = self._squared(columns, values)
        corners = self.column(np.arange(count)[:, np.newaxis] + np.arange(4))
        rough = [self._squared(corners, np.broadcast_to(row, (count, 4))) for row in _DIFFERENCES[order]]
        self._rough = sum(rough) / portable.power(self.knot, 2 * order - 1)

    def column(self, spline: NDArray[np.int64]) -> NDArray[np.int64]:
        """Where the coefficients of B-splines stand."""
        if not self.closed:
            return spline
        turn = spline % self.count
        return np.where(turn < (self.count + 1) // 2, 2 * turn, 2 * (self.count - 1 - turn) + 1)

    def _squared(self, columns: NDArray[np.int64], values: Array) -> Array:
        """A^T A of a matrix with four entries in each row, as upper bands, see `maths.matrices`."""
        bands = np.zeros((self._width + 1) * self.size)
        for row in range(4):
            for other in range(4):
                i, j = columns[:, row], columns[:, other]
                upper = i <= j
                place = (self._width - (j - i)) * self.size + j
                products = values[:, row] * values[:, other]
                bands += np.bincount(place[upper], weights=products[upper], minlength=bands.size)
        return bands.reshape(self._width + 1, self.size)

    def factor(self, weight: float) -> Array:
        """Cholesky's, for a weight of the penalty."""
        bands = self._normal + weight * self._rough
        bands[-1] += 1e-12  # knots between which no point lies
        try:
            return portable.banded_factor(bands)
        except portable.LinAlgError:
            raise InvalidInput("fit_road: the points are too few, or too near to one another, for a curve.") from None


# -- heights ----------------------------------------------------------------------------------------------------------
def grade_of_heights(s: Array, height: Array, length: float, closed: bool) -> tuple[tuple[Array, Array], str]:
    """Arc lengths (m) along a road with the grade dz/ds there, from heights (n,) m at arc lengths s (n,) m; and a note.

    Raises InvalidInput when the heights rise or fall by more than `MAX_GRADE`.
    """
    places = np.mod(s, length) if closed else np.clip(s, 0.0, length)
    smoother = Smoother((height - height[0])[:, np.newaxis], places, length, closed, max(length / s.size, 0.5))
    shortest = max(MIN_HEIGHT_SMOOTHING, 0.5 * smoother.spacing, STAIRS * _stair_length(s, height))
    scales = portable.geomspace(shortest, max(min(0.25 * length, MAX_HEIGHT_SMOOTHING), shortest), LENGTHS)
    scale = float(scales[smoother.best_scale(scales)])
    powers = smoother.powers(scale)[:, 0]
    knot = length / len(powers)
    first = np.minimum((places / knot).astype(np.int64), len(powers) - 1)
    fitted = (powers[first] * np.vander(places / knot - first, 4, increasing=True)).sum(axis=1)
    deviation = float(np.sqrt(np.mean(portable.square(fitted - smoother.points[:, 0]))))
    slopes = [powers[:, 1], powers[:, 1] + powers[:, 2] + 0.75 * powers[:, 3]]  # at the knots, and between them
    last = powers[-1, 1] + 2.0 * powers[-1, 2] + 3.0 * powers[-1, 3]
    grade = np.append(np.stack(slopes, axis=-1), last) / knot
    stations = np.linspace(0.0, length, grade.size)
    k = int(np.abs(grade).argmax())
    if abs(grade[k]) > MAX_GRADE:
        raise InvalidInput(
            f"fit_road: the heights change by {grade[k]:.3g} m per metre at s = {stations[k]:.6g} m: at most "
            f"{MAX_GRADE} are possible; is z in m? Correct the heights, or leave them out."
        )
    return (stations, grade), (
        f"grade {100.0 * grade.min():.2g} to {100.0 * grade.max():.2g} % from heights; root mean square of their "
        f"deviation {deviation:.3g} m; smoothing length {scale:.3g} m"
    )


def _stair_length(s: Array, height: Array) -> float:
    """The median distance (m) of two changes of rounded heights; 0 where most heights differ from the one before."""
    changes = np.flatnonzero(np.diff(height))
    if changes.size < 2 or np.median(np.diff(changes)) < 2.0:
        return 0.0
    return float(np.median(np.abs(np.diff(s[changes]))))

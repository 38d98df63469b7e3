"""Penalised cubic splines near points of the plane, for any smoothing length: their normal equations are bands.

The curve c(t) = sum_j a_j B_j(t) (cubic B-splines on even knots) minimises

    sum_i |p_i - c(t_i)|^2 + (l/2 pi)^6/spacing * integral of |c'''(t)|^2 dt,

so that what is shorter than the smoothing length l counts as noise; c''' vanishes on parabolas, hence nearly on lines
and wide arcs, and clothoids pay little (P-splines: P. Eilers and B. Marx, *Flexible smoothing with B-splines and
penalties*, Statistical Science 11 (1996); the penalty is on third differences). A curve as smooth as l needs no more
than `KNOTS` knots in it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import scipy  # loads its parts when they are first used
from numpy.typing import NDArray

from adaptrack.base.errors import InvalidInput
from adaptrack.road.segments import Array

KNOTS = 10.0
"""In a smoothing length, at most."""
CAUTION = 1.4
"""Factor on the number of parameters in cross-validation."""
EXACT_TRACE = 500
"""Up to so many parameters their number in use is computed exactly, else from random signs."""
PROBES = 50_000
"""Random signs of that estimate, two for each point at least."""
STEPS = 30
"""The most steps of Newton's method to a foot."""
STRIDE = 1.0
"""m, the longest of them."""
SAMPLES = 8
"""Between two knots, where the direction of a curve is looked at."""
FOLD = 1.0
"""rad, from one sample to the next, at which a curve has a cusp or a loop."""

_TO_POWERS = (
    np.array([[1.0, 4.0, 1.0, 0.0], [-3.0, 0.0, 3.0, 0.0], [3.0, -6.0, 3.0, 0.0], [-1.0, 3.0, -3.0, 1.0]]) / 6.0
)
"""Coefficients of 1, p, p^2, p^3 between two knots, 0 <= p <= 1, from the four B-splines that are not zero there."""
_THIRD_DIFFERENCE = np.array([-1.0, 3.0, -3.0, 1.0])
_NODES: Array
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(4)


class Score(NamedTuple):
    """How a smoothing length does in cross-validation."""

    value: float
    """m^2; the least is the best"""
    used: float
    """how many parameters the fit uses: the trace of its hat matrix"""


class Smoother:
    """Points (n, 2) at places (n,) along a curve of some length, m; its knots are at least `spacing` apart."""

    def __init__(self, points: Array, places: Array, length: float, closed: bool, spacing: float) -> None:
        self.points, self.places, self.closed, self.spacing = points, places, closed, spacing
        self.length = length if closed else max(length, float(places.max()))
        self._system: _System | None = None

    def finer(self) -> Smoother:
        """The same with knots at half the distance."""
        return Smoother(self.points, self.places, self.length, self.closed, 0.5 * self.spacing)

    def _of(self, scale: float) -> tuple[_System, Array]:
        """The equations that suit a smoothing length, and their factor."""
        count = max(4, math.ceil(self.length / max(self.spacing, scale / KNOTS)))
        if self._system is None or self._system.count != count:
            self._system = _System(self.points, self.places, self.length, self.closed, count)
        weight = (scale / (2.0 * math.pi)) ** 6 * len(self.points) / self.length
        return self._system, self._system.factor(weight)

    def curve(self, scale: float) -> Curve:
        """The curve of a smoothing length (m)."""
        system, factor = self._of(scale)
        coefficients = scipy.linalg.cho_solve_banded((factor, False), system.right)
        corners = coefficients[system.column(np.arange(system.count)[:, np.newaxis] + np.arange(4))]
        return Curve(np.einsum("ij,kjl->kli", _TO_POWERS, corners), system.knot, self.closed)

    def score(self, scale: float) -> Score:
        """Generalised cross-validation: n RSS/(n - 1.4 trace)^2."""
        system, factor = self._of(scale)
        n = len(self.points)
        residual = self.points - system.basis @ scipy.linalg.cho_solve_banded((factor, False), system.right)
        used = self._trace(system, factor)
        left = n - CAUTION * used
        return Score(n * float((residual**2).sum()) / left**2 if left > 0.0 else math.inf, used)

    def _trace(self, system: _System, factor: Array) -> float:
        basis = system.basis
        if system.size <= EXACT_TRACE:
            normal = (basis.T @ basis).toarray()
            return float(np.trace(scipy.linalg.cho_solve_banded((factor, False), normal)))
        n = len(self.points)
        probes = max(2, round(PROBES / n))
        signs = np.random.default_rng(1).choice([-1.0, 1.0], (n, probes))
        found = basis @ scipy.linalg.cho_solve_banded((factor, False), basis.T @ signs)
        return float((signs * found).sum() / probes)


class _System:
    """The normal equations of one set of knots, for any weight of the penalty.

    The coefficients of an open curve are in their order, and each meets the three next ones. A ring is folded flat:
    its coefficients go there and back in turns, and each meets others at most six apart.
    """

    def __init__(self, points: Array, places: Array, length: float, closed: bool, count: int) -> None:
        self.closed, self.count, self.knot = closed, count, length / count
        self.size, self._width = (count, 6) if closed else (count + 3, 3)
        t = (np.mod(places, length) if closed else np.clip(places, 0.0, length)) / self.knot
        first = np.minimum(t.astype(np.int64), count - 1)
        values = (t - first)[:, np.newaxis] ** np.arange(4) @ _TO_POWERS
        columns = self.column(first[:, np.newaxis] + np.arange(4))
        rows = np.repeat(np.arange(len(points)), 4)
        self.basis = scipy.sparse.csr_array((values.ravel(), (rows, columns.ravel())), shape=(len(points), self.size))
        self.right = self.basis.T @ points
        self._normal = self._squared(columns, values)
        differences = self.column(np.arange(count)[:, np.newaxis] + np.arange(4))
        self._rough = self._squared(differences, np.broadcast_to(_THIRD_DIFFERENCE, (count, 4))) / self.knot**5

    def column(self, spline: NDArray[np.int64]) -> NDArray[np.int64]:
        """Where the coefficients of B-splines stand."""
        if not self.closed:
            return spline
        turn = spline % self.count
        return np.where(turn < (self.count + 1) // 2, 2 * turn, 2 * (self.count - 1 - turn) + 1)

    def _squared(self, columns: NDArray[np.int64], values: Array) -> Array:
        """A^T A of a matrix with four entries in each row, as the upper bands that LAPACK reads."""
        bands = np.zeros((self._width + 1) * self.size)
        for one in range(4):
            for other in range(4):
                i, j = columns[:, one], columns[:, other]
                upper = i <= j
                place = (self._width - (j - i)) * self.size + j
                found = values[:, one] * values[:, other]
                bands += np.bincount(place[upper], weights=found[upper], minlength=bands.size)
        return bands.reshape(self._width + 1, self.size)

    def factor(self, weight: float) -> Array:
        """Cholesky's, for a weight of the penalty."""
        bands = self._normal + weight * self._rough
        bands[-1] += 1e-12  # knots between which no point lies
        try:
            return np.asarray(scipy.linalg.cholesky_banded(bands))
        except np.linalg.LinAlgError:
            raise InvalidInput("fit_road: the points are too few, or too near to one another, for a curve.") from None


@dataclass(frozen=True, eq=False)
class Curve:
    """A cubic spline of the plane over a parameter t, m, that is nearly its arc length; straight beyond open ends."""

    powers: Array
    """(count, 2, 4): x and y between two knots, coefficients of 1, p, p^2, p^3, 0 <= p <= 1"""
    knot: float
    """m, from knot to knot"""
    closed: bool

    @property
    def length(self) -> float:
        """m, of the parameter"""
        return self.knot * len(self.powers)

    def at(self, t: Array) -> tuple[Array, Array, Array]:
        """Place (n, 2), slope and second derivative at t (n,)."""
        inside = np.mod(t, self.length) if self.closed else np.clip(t, 0.0, self.length)
        p = inside / self.knot
        piece = np.minimum(p.astype(np.int64), len(self.powers) - 1)
        p = (p - piece)[:, np.newaxis]
        a, b, c, d = np.moveaxis(self.powers[piece], -1, 0)
        slope = (b + p * (2.0 * c + 3.0 * p * d)) / self.knot
        beyond = np.zeros_like(t) if self.closed else t - inside
        bend = np.where(beyond[:, np.newaxis] == 0.0, (2.0 * c + 6.0 * p * d) / self.knot**2, 0.0)
        return a + p * (b + p * (c + p * d)) + beyond[:, np.newaxis] * slope, slope, bend

    def feet(self, points: Array, near: Array) -> tuple[Array, Array]:
        """t of the feet of points (n, 2) near others (n,), and the distances of the points from the curve (m)."""
        t, active = np.array(near), np.arange(near.size)
        for _ in range(STEPS):
            place, slope, bend = self.at(t[active])
            off = place - points[active]
            squared = np.maximum((slope**2).sum(axis=-1), 1e-12)
            grows = squared + (off * bend).sum(axis=-1)
            step = -(off * slope).sum(axis=-1) / np.where(grows > 0.1 * squared, grows, squared)
            t[active] += np.clip(step, -STRIDE, STRIDE)
            active = active[np.abs(step) > 1e-9]
            if not active.size:
                break
        inside = t if self.closed else np.clip(t, 0.0, self.length)
        return t, np.hypot(*(self.at(inside)[0] - points).T)

    @cached_property
    def _arc(self) -> scipy.interpolate.CubicHermiteSpline:
        """The arc length over t."""
        count = len(self.powers)
        middles = self.knot * np.arange(count)[:, np.newaxis] + 0.5 * self.knot * (1.0 + _NODES)
        growth = np.hypot(*self.at(middles.ravel())[1].T).reshape(middles.shape)
        knots = np.linspace(0.0, self.length, count + 1)
        ends = np.hypot(*self.at(knots)[1].T)
        arc = np.concatenate([[0.0], np.cumsum(0.5 * self.knot * (growth @ _WEIGHTS))])
        return scipy.interpolate.CubicHermiteSpline(knots, arc, ends)

    @property
    def arc_length(self) -> float:
        """m"""
        return float(self._arc(self.length))

    def arc_lengths(self, t: Array) -> Array:
        """m, at t (n,); beyond the ends of an open curve on its straight continuation."""
        if self.closed:
            laps = np.floor(t / self.length)
            return laps * self.arc_length + self._arc(t - laps * self.length)
        inside = np.clip(t, 0.0, self.length)
        return self._arc(inside) + (t - inside)

    @cached_property
    def folds(self) -> bool:
        """Whether it has a cusp, or turns as hard as only noise does."""
        t = np.linspace(0.0, self.length, SAMPLES * len(self.powers) + 1)
        slope = self.at(t)[1] @ np.array([1.0, 1j])
        return bool((np.abs(np.angle(slope[1:] * np.conj(slope[:-1]))) > FOLD).any())

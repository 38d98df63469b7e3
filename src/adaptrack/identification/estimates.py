"""Estimates of reported quantities, with intervals, from the optimum of a likelihood by the delta method."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import product
from adaptrack.identification.calibration import corrected
from adaptrack.identification.identified_car import Estimate
from adaptrack.identification.likelihood import InnovationLikelihood

Array = NDArray[np.float64]

ReportedRow = tuple[str, str, str, bool, Callable[[Array], float]]
"""Name, unit, meaning, whether it is positive, and how it follows from the quantities."""
NORMAL_90 = 1.6448536269514722
"""Half width of a 90 % interval in standard errors."""
FROM_ZERO = ("delay", "lag", "dead_time", "relaxation")
"""Last words of positive quantities that may be 0, which is infinitely far on the scale of a logarithm: below the prior
median, and below the value, they are linear."""
ESTIMATE_STEP = 1e-4
"""Of the differences, in spreads of the prior."""


def values_at(likelihood: InnovationLikelihood, rows: Sequence[ReportedRow], z: Array) -> Array:
    """Reported quantities at a point; logarithms of positive quantities."""
    values = likelihood.values(z)
    return np.array([portable.log(max(f(values), 1e-12)) if positive else f(values) for *_, positive, f in rows])


def slopes_at(likelihood: InnovationLikelihood, rows: Sequence[ReportedRow], z: Array) -> Array:
    """Derivatives of `values_at` over the free entries of z."""
    out = np.empty((len(rows), likelihood.free.size))
    for i, place in enumerate(likelihood.free):
        up, down = z.copy(), z.copy()
        up[place] += ESTIMATE_STEP
        down[place] -= ESTIMATE_STEP
        out[:, i] = (values_at(likelihood, rows, up) - values_at(likelihood, rows, down)) / (2.0 * ESTIMATE_STEP)
    return out


def estimates_at(
    likelihood: InnovationLikelihood, rows: Sequence[ReportedRow], z: Array, covariance: Array, wheels: float = 0.0
) -> tuple[dict[str, Estimate], Array]:
    """Reported quantities by the delta method, errors corrected; derivatives over free entries, scaled likewise.

    wheels: rad, angle of the road wheels in tight bends, see `corrected`
    """
    origin = np.zeros(z.size)
    jacobian = slopes_at(likelihood, rows, z)
    spread = np.sqrt(np.maximum((product(jacobian, covariance) * jacobian).sum(axis=1), 0.0))
    prior = np.sqrt(portable.square(slopes_at(likelihood, rows, origin)).sum(axis=1))
    centre, first = values_at(likelihood, rows, z), values_at(likelihood, rows, origin)
    wider, estimates = np.ones(len(rows)), {}
    for i, (name, unit, meaning, positive, _) in enumerate(rows):
        may_be_zero = positive and name.endswith(FROM_ZERO)
        is_low = may_be_zero and centre[i] < first[i]
        believed = prior[i] * (portable.exp(first[i] - centre[i]) if is_low else 1.0)
        value = portable.exp(centre[i]) if positive else float(centre[i])
        if spread[i] > 0.0:
            wider[i] = corrected(name, spread[i], value, positive, believed, wheels) / spread[i]
        error = float(spread[i] * wider[i])
        low = _end(value, -NORMAL_90 * error, positive, may_be_zero)
        high = _end(value, NORMAL_90 * error, positive, is_low)
        median, half = portable.exp(first[i]) if positive else float(first[i]), NORMAL_90 * float(prior[i])
        before = (_end(median, -half, positive, may_be_zero), _end(median, half, positive, False))
        left, shift, reach = 0.0, 0.0, 0.0
        if prior[i] > 0.0:
            left = float(error / believed)
            shift, *ends = (_distance(x, median, positive, may_be_zero) / float(prior[i]) for x in (value, low, high))
            reach = max(map(abs, ends))
        error *= value if positive else 1.0
        estimates[name] = Estimate(name, unit, meaning, value, error, low, high, before, left, shift, reach)
    return estimates, wider[:, None] * jacobian


def _end(value: float, distance: float, positive: bool, linear: bool) -> float:
    """A value moved by a distance: of its logarithm where it is positive, or of its share where it is linear, too."""
    if not positive:
        return float(value + distance)
    return float(value * (max(1.0 + distance, 0.0) if linear else portable.exp(min(distance, 700.0))))


def _distance(x: float, median: float, positive: bool, may_be_zero: bool) -> float:
    """From the median to a value: of its logarithm where it is positive, of its share below a median that may be 0."""
    if not positive:
        return x - median
    return x / median - 1.0 if may_be_zero and x < median else portable.log(x / median)

"""Estimates of reported quantities, with intervals, from the optimum of a likelihood by the delta method."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from adaptrack.core import portable
from adaptrack.core.portable import product
from adaptrack.identification.calibration import corrected
from adaptrack.identification.identified_car import Estimate
from adaptrack.identification.likelihood import InnovationLikelihood

Array = NDArray[np.float64]

ReportedRow = tuple[str, str, str, bool, Callable[[Array], float]]
"""Name, unit, meaning, whether it is positive, and how it follows from the quantities."""
NORMAL_90 = 1.6448536269514722
"""Half width of a 90 % interval in standard errors."""
FROM_ZERO = ("delay", "lag", "dead_time", "relaxation")
"""Last words of positive quantities that may be 0. On the scale of their logarithm 0 is infinitely far, so distances
below the value and below the prior median count on the scale of the value."""
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
    wider = np.ones(len(rows))
    for i, (name, _, _, positive, _) in enumerate(rows):
        if spread[i] > 0.0:
            value = portable.exp(centre[i]) if positive else float(centre[i])
            wider[i] = corrected(name, spread[i], value, positive, prior[i], wheels) / spread[i]
    spread *= wider
    estimates = {}
    for i, (name, unit, meaning, positive, _) in enumerate(rows):
        value, low, high = (_on_scale(centre[i], spread[i], end, name, positive) for end in (0.0, -1.0, 1.0))
        before = tuple(_on_scale(first[i], prior[i], end, name, positive) for end in (-1.0, 1.0))
        left, shift, reach = 0.0, 0.0, 0.0
        if prior[i] > 0.0:
            left = float(spread[i] / prior[i])
            shift, *ends = (_deviation(x, first[i], prior[i], name, positive) for x in (value, low, high))
            reach = max(map(abs, ends))
        error = float(spread[i]) * (value if positive else 1.0)
        estimates[name] = Estimate(name, unit, meaning, value, error, low, high, before, left, shift, reach)
    return estimates, wider[:, None] * jacobian


def _on_scale(centre: float, spread: float, end: float, name: str, positive: bool) -> float:
    """The centre of a 90 % interval (end 0) or one of its ends (-1, 1); of a logarithm where a quantity is positive."""
    if not positive:
        return float(centre + end * NORMAL_90 * spread)
    if end < 0.0 and name.endswith(FROM_ZERO):
        return math.exp(centre) * max(1.0 - NORMAL_90 * float(spread), 0.0)
    return math.exp(min(centre + end * NORMAL_90 * spread, 700.0))


def _deviation(x: float, first: float, prior: float, name: str, positive: bool) -> float:
    """Standard deviations of the prior from its median to a value."""
    if not positive:
        return float((x - first) / prior)
    ratio = x / math.exp(first)
    return float((ratio - 1.0 if ratio < 1.0 and name.endswith(FROM_ZERO) else math.log(ratio)) / prior)

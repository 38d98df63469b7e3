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
        ends = [centre[i] - NORMAL_90 * spread[i], centre[i] + NORMAL_90 * spread[i]]
        before = [first[i] - NORMAL_90 * prior[i], first[i] + NORMAL_90 * prior[i]]
        value, error = float(centre[i]), float(spread[i])
        if positive:
            value, error = portable.exp(value), error * portable.exp(value)
            ends, before = [portable.exp(e) for e in ends], [portable.exp(min(e, 700.0)) for e in before]
        left = float(spread[i] / prior[i]) if prior[i] > 0.0 else 0.0
        shift = float((centre[i] - first[i]) / prior[i]) if prior[i] > 0.0 else 0.0
        estimates[name] = Estimate(
            name, unit, meaning, value, error, float(ends[0]), float(ends[1]), (float(before[0]), float(before[1])),
            left, shift,
        )  # fmt: skip
    return estimates, wider[:, None] * jacobian

"""Estimates of reported quantities, with intervals, from the optimum of a likelihood by the delta method.

Intervals are wider than the likelihood says: a standard error s is replaced by sqrt((factor s)^2 + floor^2 +
(share |value|)^2). Floors and shares are what a longer log does not make smaller: the time between samples and its
steps, and the shape of the tyres' curve, of which only one number is fitted (a brush tyre at a quarter of its grip is
8 % softer than its slope at the origin, Pacejka, *Tire and Vehicle Dynamics*, 3rd ed., section 3.2). They grow with the
square of the wheels' angle in tight bends: there driving and braking forces, which no log of this kind holds, turn the
car, too.

The factors are such that 90 % intervals held the truth in 90 % of training logs: of a foreign plant
(`identifying_foreign.py` in the benchmarks of commit c623557, seeds from 40000), and for the steering offset and the
understeer gradient our windy drives (`identifying.py` there, seeds 1300 to 1359). Drive and brakes have floors alone,
for what slopes, bends and wheels that slip add to the speed. docs/identify.md says how well intervals hold on other
kinds of logs.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import Array, product
from adaptrack.identification.identified_car import Estimate
from adaptrack.identification.likelihood import Fit, InnovationLikelihood
from adaptrack.identification.quantities import Reported

Moments = Mapping[str, tuple[float, float]]
"""Mean and variance of quantities by name; of logarithms of positive quantities."""
NORMAL_90 = 1.6448536269514722
"""Half width of a 90 % interval in standard errors."""
FROM_ZERO = ("delay", "lag", "dead_time", "relaxation")
"""Last words of positive quantities that may be 0, which is infinitely far on the scale of a logarithm: below the prior
median, and below the value, they are linear."""
ESTIMATE_STEP = 1e-4
"""Of the differences, in spreads of the prior."""


class Correction(NamedTuple):
    """Correction of a standard error."""

    factor: float = 1.0
    floor: float = 0.0
    """in the unit of the quantity"""
    share: float = 0.0
    """of the value"""
    floor_in_bends: float = 0.0
    """in the unit of the quantity per rad^2 of the wheels"""
    share_in_bends: float = 0.0
    """of the value per rad^2 of the wheels"""


CORRECTIONS: Mapping[str, Correction] = {
    "delay": Correction(1.2, 0.003, floor_in_bends=0.05),
    "lag": Correction(1.2, 0.003, floor_in_bends=0.1),
    "dead_time": Correction(1.2, 0.003, floor_in_bends=0.1),
    "lateness": Correction(1.2, 0.003),
    "understeer_gradient": Correction(1.15, 1e-4, 0.05, 1e-3),
    "front": Correction(1.15, share=0.06, share_in_bends=2.0),
    "rear": Correction(1.15, share=0.06, share_in_bends=2.0),
    "offset": Correction(1.3),
    "vy_ahead": Correction(1.4),
    "relaxation": Correction(2.0, share_in_bends=6.0),
    "rate": Correction(share=0.03),
    "ratio": Correction(share=0.002),
    "angle_scale": Correction(share=0.02),
    "drive_lag": Correction(floor=0.005),
    "drive_dead_time": Correction(floor=0.005),
    "drive_gain": Correction(share=0.02),
    "brake_lag": Correction(floor=0.005),
    "brake_dead_time": Correction(floor=0.005),
    "brake_gain": Correction(share=0.02),
    "drag": Correction(share=0.05),
    "rolling": Correction(floor=0.01),
}
"""By the names of the estimates; those of the others are kept."""


def corrected(name: str, spread: float, value: float, positive: bool, before: float, wheels: float = 0.0) -> float:
    """The corrected standard error, at most what was believed before.

    spread, before: of a value, or of its logarithm where it is positive; wheels: rad, their angle in tight bends.
    """
    correction = CORRECTIONS.get(name, Correction())
    floor = correction.floor + correction.floor_in_bends * (wheels * wheels)
    share = correction.share + correction.share_in_bends * (wheels * wheels)
    unit = 1.0 / value if positive else 1.0
    return min(portable.hypot(correction.factor * spread, floor * unit, share * value * unit), max(before, spread))


def values_at(likelihood: InnovationLikelihood, rows: Sequence[Reported], z: Array) -> Array:
    """Reported quantities at a point; logarithms of positive quantities."""
    values = likelihood.values(z)
    return np.array([portable.log(max(f(values), 1e-12)) if positive else f(values) for *_, positive, f in rows])


def slopes_at(likelihood: InnovationLikelihood, rows: Sequence[Reported], z: Array) -> Array:
    """Derivatives of `values_at` over the free entries of z."""
    out = np.empty((len(rows), likelihood.free.size))
    for i, place in enumerate(likelihood.free):
        up, down = z.copy(), z.copy()
        up[place] += ESTIMATE_STEP
        down[place] -= ESTIMATE_STEP
        out[:, i] = (values_at(likelihood, rows, up) - values_at(likelihood, rows, down)) / (2.0 * ESTIMATE_STEP)
    return out


def estimates_of(fit: Fit[Any]) -> tuple[dict[str, Estimate], Array]:
    """Estimates of what is reported of a fit by the delta method, errors corrected, and their covariance.

    The covariance is that of logarithms for what is positive.
    """
    likelihood, rows, wheels = fit.likelihood, fit.likelihood.reported, fit.likelihood.tightest
    jacobian = slopes_at(likelihood, rows, fit.z)
    spread = _standard_errors(jacobian, fit.covariance)
    origin = np.zeros(fit.z.size)
    prior = np.sqrt(portable.square(slopes_at(likelihood, rows, origin)).sum(axis=1))
    centre, first = values_at(likelihood, rows, fit.z), values_at(likelihood, rows, origin)
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
    jacobian *= wider[:, None]
    return estimates, product(product(jacobian, fit.covariance), jacobian.T)


def moments_of(fit: Fit[Any]) -> Moments:
    """Moments of what is reported of a fit, errors corrected."""
    likelihood, rows, wheels = fit.likelihood, fit.likelihood.reported, fit.likelihood.tightest
    jacobian, mean = slopes_at(likelihood, rows, fit.z), values_at(likelihood, rows, fit.z)
    spread, before = _standard_errors(jacobian, fit.covariance), np.sqrt((jacobian * jacobian).sum(axis=1))
    moments = {}
    for i, (name, _, _, positive, _) in enumerate(rows):
        value = portable.exp(mean[i]) if positive else float(mean[i])
        error = corrected(name, spread[i], value, positive, before[i], wheels)
        moments[name] = float(mean[i]), float(error * error)
    return moments


def prior_of(fit: Fit[Any]) -> Moments:
    """Moments of the prior of what is reported of a fit, linearised at its point."""
    likelihood, rows = fit.likelihood, fit.likelihood.reported
    jacobian = slopes_at(likelihood, rows, fit.z)
    mean = values_at(likelihood, rows, fit.z) - product(jacobian, fit.z[likelihood.free])
    variance = np.sum(jacobian * jacobian, axis=1)
    return {row.name: (float(mean[i]), float(variance[i])) for i, row in enumerate(rows)}


def _standard_errors(jacobian: Array, covariance: Array) -> Array:
    return np.asarray(np.sqrt(np.maximum((product(jacobian, covariance) * jacobian).sum(axis=1), 0.0)))


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

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

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import product
from adaptrack.identification.identified_car import Estimate
from adaptrack.identification.likelihood import InnovationLikelihood
from adaptrack.identification.quantities import Quantity

Array = NDArray[np.float64]

ReportedRow = tuple[str, str, str, bool, Callable[[Array], float]]
"""Name, unit, meaning, whether it is positive, and how it follows from the quantities."""
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


def quantity_row(quantities: Sequence[Quantity], name: str, meaning: str = "") -> ReportedRow:
    """Row of a quantity that is reported as it is."""
    place = [quantity.name for quantity in quantities].index(name)
    quantity = quantities[place]
    is_positive = quantity.kind in ("positive", "from zero")
    return name, quantity.unit, meaning or quantity.meaning, is_positive, lambda v: float(v[place])


def delay_rows(
    quantities: Sequence[Quantity], prefix: str = "", lag: str = "", dead_time: str = "", positive: bool = True
) -> list[ReportedRow]:
    """Rows of lag and dead time of an actuator, with their meanings, from its delay and the share of the lag."""
    delay, share = ([quantity.name for quantity in quantities].index(prefix + name) for name in ("delay", "lag_share"))
    return [
        (f"{prefix}lag", "s", lag, positive, lambda v: float(v[share] * v[delay])),
        (f"{prefix}dead_time", "s", dead_time, positive, lambda v: float((1.0 - v[share]) * v[delay])),
    ]


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
    spread = _standard_errors(jacobian, covariance)
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


def moments_at(
    likelihood: InnovationLikelihood, rows: Sequence[ReportedRow], z: Array, covariance: Array, wheels: float
) -> Moments:
    """Moments of the reported quantities, errors corrected; arguments as of `estimates_at`."""
    jacobian, mean = slopes_at(likelihood, rows, z), values_at(likelihood, rows, z)
    spread, before = _standard_errors(jacobian, covariance), np.sqrt((jacobian * jacobian).sum(axis=1))
    moments = {}
    for i, (name, _, _, positive, _) in enumerate(rows):
        value = portable.exp(mean[i]) if positive else float(mean[i])
        error = corrected(name, spread[i], value, positive, before[i], wheels)
        moments[name] = float(mean[i]), float(error * error)
    return moments


def prior_moments_at(likelihood: InnovationLikelihood, rows: Sequence[ReportedRow], z: Array) -> Moments:
    """Moments of the prior of the reported quantities, linearised at a point."""
    jacobian = slopes_at(likelihood, rows, z)
    mean = values_at(likelihood, rows, z) - product(jacobian, z[likelihood.free])
    variance = np.sum(jacobian * jacobian, axis=1)
    return {row[0]: (float(mean[i]), float(variance[i])) for i, row in enumerate(rows)}


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

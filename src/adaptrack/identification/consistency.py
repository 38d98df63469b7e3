"""Whether what was found can be believed: against what was believed before, physics, and itself.

Stretches of a log, and logs of one car, each say something of the quantities that belong to the car. Freed of the
prior, which they share, what they say is independent, and its weighted scatter is chi-square (W. G. Cochran,
Biometrics 10 (1954) 101-129). Each is granted an error of the model beside that of its noise: tyres warm up, loads
shift, friction changes.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from adaptrack.cars.vehicle import Vehicle
from adaptrack.core.maths import portable
from adaptrack.core.physics.forces import GRAVITY
from adaptrack.identification.identified_car import Estimate
from adaptrack.identification.quantities import degrees_per_g

Array = NDArray[np.float64]

MAX_PRIOR_DEVIATIONS, MAX_REACH = 3.0, 3.5
"""Standard deviations of the prior, beyond which an estimate is not of such a car, and its interval says nothing."""
FALSE_ALARM_RATE = 0.01
"""Of a false alarm over all quantities that are compared (Bonferroni)."""
MODEL_ERRORS: Mapping[str, float] = {
    "delay": 0.015, "lag": 0.03, "dead_time": 0.03, "understeer_gradient": 0.0003, "front": 0.12, "rear": 0.12,
    "lf": 0.05, "ratio": 0.05, "angle_scale": 0.03, "rate": 0.2, "relaxation": 0.5,
}  # fmt: skip
"""Quantities of the car, which stretches and logs share, and the standard deviation that the model's errors add to
each: delays in s, K in rad s^2/m (0.17 deg/g), of the logarithm for the others."""
_ABSOLUTE = ("delay", "lag", "dead_time", "understeer_gradient")
MAX_SPREAD_LEFT = 0.8
"""Share of the prior's spread that must at most be left where a stretch or log has a say."""
AXLE_PLACE_RANGE, UNDERSTEER_RANGE, AXLE_STIFFNESS_RANGE = (0.3, 0.7), (-1.0, 8.0), (1.5, 100.0)
"""Of cars on four wheels: l_f over the wheelbase; understeer gradient, deg/g; cornering stiffness of an axle over its
load, 1/rad."""


class Moments(NamedTuple):
    """Estimates of the reported quantities from one stretch or log; logarithms of positive quantities, (m,) each."""

    mean: Array
    variance: Array


def implausible_estimates(estimates: Mapping[str, Estimate], car: Vehicle) -> list[str]:
    """Estimates that lie outside what was believed, or what any car has, in words."""
    messages = []
    for estimate in estimates.values():
        before = f"what was believed ({estimate.before[0]:.3g} to {estimate.before[1]:.3g})"
        if abs(estimate.shift) > MAX_PRIOR_DEVIATIONS and not estimate.name.startswith(("noise", "gyro")):
            messages.append(
                f"{estimate.name} {estimate.value:.3g} {estimate.unit} lies {abs(estimate.shift):.1f} "
                f"standard deviations from {before}"
            )
        elif estimate.reach > MAX_REACH and estimate.name in MODEL_ERRORS:
            messages.append(
                f"the interval of {estimate.name}, {estimate.low:.3g} to {estimate.high:.3g} {estimate.unit}, reaches "
                f"{estimate.reach:.1f} standard deviations from {before}"
            )
    return messages + _unphysical_quantities(estimates, car)


def _unphysical_quantities(estimates: Mapping[str, Estimate], car: Vehicle) -> list[str]:
    """Return the quantities outside physical bounds; a car file may still hold an unusual car."""
    wheelbase, lf = car.wheelbase, estimates["lf"].value
    lr = max(wheelbase - lf, 1e-3)
    load = car.mass * GRAVITY / wheelbase
    rows = (
        ("lf", "l_f over the wheelbase", "", 1.0 / wheelbase, AXLE_PLACE_RANGE),
        ("understeer_gradient", "understeer gradient", " deg/g", degrees_per_g(1.0), UNDERSTEER_RANGE),
        ("front", "stiffness of the front axle over its load", "/rad", 1.0 / (load * lr), AXLE_STIFFNESS_RANGE),
        ("rear", "stiffness of the rear axle over its load", "/rad", 1.0 / (load * lf), AXLE_STIFFNESS_RANGE),
    )
    return [
        f"{label} {scale * estimates[name].value:.3g}{unit}: no car has less than {low:g} or more than {high:g}"
        for name, label, unit, scale, (low, high) in rows
        if not low <= scale * estimates[name].value <= high
        and not estimates[name].before[0] <= estimates[name].value <= estimates[name].before[1]
    ]


def contradictions(subject: str, names: Sequence[str], prior: Moments, statements: Sequence[Moments]) -> list[str]:
    """Quantities in which stretches or logs (``subject``) contradict each other, in words.

    names: of the m quantities; those of `MODEL_ERRORS` are compared.
    """
    tests = []
    for i, name in enumerate(names):
        if name not in MODEL_ERRORS:
            continue
        freed = [
            _freed(prior.mean[i], prior.variance[i], statement.mean[i], statement.variance[i])
            for statement in statements
        ]
        informed = [(value, variance) for value, variance in freed if math.isfinite(variance)]
        if len(informed) > 1:
            tests.append((name, np.array(informed).T))
    messages = []
    for name, (values, variances) in tests:
        positive = name != "understeer_gradient"
        error = MODEL_ERRORS[name]
        if positive and name in _ABSOLUTE:
            error /= portable.exp(float(np.mean(values)))
        weights = 1.0 / (variances + error * error)
        scatter = float(np.sum(weights * portable.square(values - np.sum(weights * values) / weights.sum())))
        freedom, rate = values.size - 1, FALSE_ALARM_RATE / len(tests)
        if chi2.sf(scatter, freedom) < rate:
            numbers = ", ".join(_written(name, value) for value in values)
            messages.append(
                f"{subject} contradict each other on {name}: {numbers} (chi-square {scatter:.0f} "
                f"with {freedom} degrees of freedom; {chi2.isf(rate, freedom):.0f} is met by chance in "
                f"{100 * FALSE_ALARM_RATE:g} % of logs)"
            )
    return messages


def _freed(prior: float, prior_variance: float, mean: float, variance: float) -> tuple[float, float]:
    """Mean and variance of what was said without the prior; an infinite variance where next to nothing was."""
    if not 0.0 < variance < MAX_SPREAD_LEFT * MAX_SPREAD_LEFT * prior_variance:
        return mean, math.inf
    precision = 1.0 / variance - 1.0 / prior_variance
    return (mean / variance - prior / prior_variance) / precision, 1.0 / precision


def _written(name: str, value: float) -> str:
    if name == "understeer_gradient":
        return f"{degrees_per_g(value):.2f} deg/g"
    return f"{portable.exp(min(value, 700.0)):.3g}"

"""Whether estimates can be believed: against the prior, physics, and each other; and what a log cannot tell.

Stretches of a log, and logs of one car, each say something of the quantities that belong to the car. Freed of the
prior, which they share, what they say is independent, and its weighted scatter is chi-square (W. G. Cochran,
Biometrics 10 (1954) 101-129). Each is granted an error of the model beside that of its noise: tyres warm up, loads
shift, friction changes.

In a steady turn delta = L r/v + K v r. So a log tells the scale of its angle only as (angle scale x speed scale)/(scale
of the yaw rate) x true wheelbase/specified wheelbase, and it tells it from K where bends are driven at several speeds.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import islice
from typing import Any

import numpy as np
from scipy.stats import chi2

from adaptrack.cars.vehicle import Vehicle
from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import Array
from adaptrack.core.physics.forces import GRAVITY
from adaptrack.identification.estimates import Moments
from adaptrack.identification.hypotheses import INF, Case, find_cases
from adaptrack.identification.identified_car import HARDLY, Estimate, Validation, scale_correlations
from adaptrack.identification.likelihood import Fit, Likelihood
from adaptrack.identification.log import Log, window_mean
from adaptrack.identification.quantities import INDEX, degrees_per_g

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
BEND_YAW_RATE, BEND_HALF_WINDOW, MIN_BEND_TIME = 0.03, 2.0, 4.0
"""rad/s, mean yaw rate of a bend, above that of gusts, lane keeping and offsets; s to either side, over which it is
averaged; s of bends that a check needs."""
MAX_GAIN_SIGMA = 0.08
"""Standard deviation of ln(ratio) up to which a log can confirm or refute a ratio."""
RATIO_ERROR, RATIO_ERROR_SIGMAS = 0.2, 2.0
"""Least error of ln(ratio) that is refused, above what sensors and nominal ratios are off by, and in standard
deviations."""
LEAST_CORRELATION = 0.3
"""Of the scale of the steering angle with another estimate, from which it is reported."""
RATIO_SPREAD = (0.3, 0.1)
"""Of the logarithm of a steering ratio that is to be found: guessed from the log, or said by the car's file."""
UNKNOWN_RATIO = "cannot tell the ratio"
RATIO_LOOSE = 1.1
"""Factor within which a steering ratio is of use."""
HIGH_SPEED, LITTLE = 15.0, 0.3
"""m/s; m/s^2, RMS lateral acceleration below which there is hardly any steering."""
LOOSE_FACTOR = 1.25
"""Factor from which a stiffness is loose."""
TIGHT = 0.2
"""rad, of the road wheels, from which bends are said to be tight."""
SPLIT = 0.05
"""s, half width of the lag's interval from which the split of the delay is said to be open."""
EVEN_SPEED, COLOURED, POOR, HARD = 0.05, 0.1, 0.5, 4.0
"""Spread over mean of an even speed; autocorrelation of residuals; share of variance explained; m/s^2."""
IMPLAUSIBLE = (
    Case("deviation", MAX_PRIOR_DEVIATIONS, INF, "{name} {value:.3g} {unit} lies {deviation:.1f} standard deviations "
         "from {believed}"),
    Case("reached", MAX_REACH, INF, "the interval of {name}, {low:.3g} to {high:.3g} {unit}, reaches {reached:.1f} "
         "standard deviations from {believed}"),
)  # fmt: skip
"""Of an estimate: the first whose number lies in its range counts."""
RATIO_CASES = (
    Case("missing", 0.0, INF, f"{UNKNOWN_RATIO}: {{seconds:.0f}} s of bends, {MIN_BEND_TIME:g} s are needed; drive "
         "slow bends, or give --steering-ratio"),
    Case("spread_left", HARDLY, INF, f"{UNKNOWN_RATIO}: drive slow bends, or give --steering-ratio"),
    Case("factor", RATIO_LOOSE, INF, "steering ratio known within a factor {factor:.2f}: slow bends (below 10 m/s) "
         "tell it"),
)  # fmt: skip
"""Of a ratio that is to be found: the first whose number lies in its range counts."""
_UNCONFIRMED = (
    f"{UNKNOWN_RATIO}: the log cannot confirm that its angles are those of the road wheels, and understeer is known "
    "with their scale only: drive bends at two speeds"
)
SCALE_CASES = (
    Case("spread", MAX_GAIN_SIGMA, INF, _UNCONFIRMED),
    Case("missing", 0.0, INF, _UNCONFIRMED),
    Case("excess", 0.0, INF, "the steering ratio is wrong: the road wheels turn {gain:.2f} [{gain_low:.2f}, "
         "{gain_high:.2f}] times as far as the log says: {option}, or fit"),
    Case("differs", 0.0, INF, "the logged steering angle is {value:.3g} [{low:.3g}, {high:.3g}] times that of yaw "
         "rate, speed and wheelbase (correlations: {correlations}): read logs with {option}, and use this ratio "
         "between car and controller"),
)  # fmt: skip
"""Of the scale of the angles, where the ratio is specified: the same."""
FINDINGS = (
    Case("stiffness", LOOSE_FACTOR, INF, "{why}: stiffness known within a factor {stiffness:.2g}"),
    Case("balance", -INF, 0.5, "what the axles have in common is open, their balance is not: understeer gradient "
         "{gradient:.2g} deg/g within {within:.2g}"),
    Case("tightest", TIGHT, INF, "tight bends, wheels at {degrees:.0f} degrees: driving and braking forces, which the "
         "log lacks, turn the car too, so intervals are wider"),
    Case("lag", SPLIT, INF, "lag and dead time are known in sum ({delay:.3g} s), not how they share it: quick "
         "steering, or a measured wheel angle, tells them apart"),
    Case("gyro_clock", 0.0, INF, "cannot tell a late yaw rate from late wheels: delay is from the command to the "
         "logged yaw rate"),
    Case("command", -INF, 0.0, "no steering command in the log: cannot tell lag and dead time, they keep what was "
         "believed"),
    Case("speed_spread", -INF, EVEN_SPEED, "the speed hardly changes: steering offset, bank and gyro offset are known "
         "in sum only"),
    Case("hardest", HARD, INF, f"driven hard, above {HARD:g} m/s^2: stiffness rests on the tyres' curve too"),
    Case("autocorrelation", COLOURED, INF, "the residuals are not white (autocorrelation {largest:.2f}): intervals may "
         "be too narrow"),
    Case("explained", -INF, POOR, "simulated from the command alone, {percent:.0f} % of the yaw rate's variance is "
         "explained: the rest is wind, road, or a wrong column"),
)  # fmt: skip
"""What limits what is known of a car; all whose numbers lie in their ranges count."""


def implausible_estimates(estimates: Mapping[str, Estimate], car: Vehicle) -> list[str]:
    """Estimates that lie outside what was believed, or what any car has, in words."""
    messages: list[str] = []
    for name, estimate in estimates.items():
        believed = f"what was believed ({estimate.before[0]:.3g} to {estimate.before[1]:.3g})"
        deviation = math.nan if name.startswith(("noise", "gyro")) else abs(estimate.shift)
        reached = estimate.reach if name in MODEL_ERRORS else math.nan
        numbers = vars(estimate) | {"deviation": deviation, "reached": reached, "believed": believed}
        messages += [case.words for case in islice(find_cases(IMPLAUSIBLE, numbers), 1)]
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


def contradictions(subject: str, prior: Moments, statements: Sequence[Moments]) -> list[str]:
    """Quantities in which stretches or logs (``subject``) contradict each other, in words.

    Those of `MODEL_ERRORS` are compared.
    """
    tests = []
    for name in [name for name in prior if name in MODEL_ERRORS]:
        believed, spread = prior[name]
        stated = np.array([statement[name] for statement in statements if name in statement]).reshape(-1, 2)
        is_informed = (stated[:, 1] > 0.0) & (stated[:, 1] < MAX_SPREAD_LEFT * MAX_SPREAD_LEFT * spread)
        mean, variance = stated[is_informed].T
        if mean.size > 1:
            precision = 1.0 / variance - 1.0 / spread  # without the prior
            tests.append((name, (mean / variance - believed / spread) / precision, 1.0 / precision))
    messages = []
    for name, values, variances in tests:
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


def _written(name: str, value: float) -> str:
    if name == "understeer_gradient":
        return f"{degrees_per_g(value):.2f} deg/g"
    return f"{portable.exp(min(value, 700.0)):.3g}"


# -- steering ratio --------------------------------------------------------------------------------------------------
def _bend_time(log: Log) -> float:
    """Time (s) driven in bends."""
    measured = np.isfinite(log.yaw_rate)
    if not measured.any():
        return 0.0
    turning = np.abs(window_mean(log.time[measured], log.yaw_rate[measured], BEND_HALF_WINDOW)) > BEND_YAW_RATE
    return float(np.sum(turning)) / max(float(np.sum(measured)), 1.0) * log.driven_time


def _gain(fit: Fit[Likelihood]) -> tuple[float, float]:
    """Angle of the road wheels over that in the log, by the log alone, and the standard deviation of its logarithm."""
    place, prior = INDEX["gain"], float(fit.likelihood.spread[INDEX["gain"]])
    if place not in fit.likelihood.free:
        return 1.0, math.inf
    row = int(np.searchsorted(fit.likelihood.free, place))
    precision = max(1.0 / float(fit.covariance[row, row]) - 1.0, 1e-6)
    mean = prior * float(fit.z[place]) * (1.0 + 1.0 / precision)
    return portable.exp(min(max(mean, -5.0), 5.0)), prior / math.sqrt(precision)


def check_ratio(
    fit: Fit[Likelihood], estimates: dict[str, Estimate], covariance: Array
) -> tuple[dict[str, Estimate], list[str], tuple[str, ...]]:
    """The estimates that may be reported, what contradicts the steering ratio, and findings.

    covariance: of the estimates in their order
    """
    log, seconds, (gain, spread) = fit.likelihood.log, _bend_time(fit.likelihood.log), _gain(fit)
    name, cases = ("ratio", RATIO_CASES) if log.ratio_unknown else ("angle_scale", SCALE_CASES)
    if name not in estimates:
        return estimates, [], ()
    estimate, end = estimates[name], portable.exp(1.645 * min(spread, 1.0))
    related = [
        f"{other} {value:.2f}"
        for other, value in scale_correlations(estimates, covariance).items()
        if other == "understeer_gradient" or abs(value) >= LEAST_CORRELATION
    ]
    numbers = vars(estimate) | {
        "seconds": seconds, "missing": MIN_BEND_TIME - seconds, "factor": estimate.high / estimate.value,
        "spread": spread, "excess": abs(portable.log(gain)) - max(RATIO_ERROR, RATIO_ERROR_SIGMAS * spread),
        "gain": gain, "gain_low": gain / end, "gain_high": gain * end,
        "differs": not estimate.low <= 1.0 <= estimate.high, "correlations": ", ".join(related),
        "option": f"--steering-ratio {log.ratio * estimate.value:.3g}",
    }  # fmt: skip
    case = next(find_cases(cases, numbers), None)
    if case is None:
        return estimates, [], ()
    if case.number == "excess":
        return estimates, [case.words], ()
    is_open = log.ratio_unknown and case.number != "factor" and fit.likelihood.spread[INDEX["gain"]] == RATIO_SPREAD[0]
    if not is_open:
        return estimates, [], (case.words,)
    return {other: estimate for other, estimate in estimates.items() if other != name}, [case.words], ()


# -- what limits estimates --------------------------------------------------------------------------------------------
def findings(log: Log, estimates: Mapping[str, Estimate], validation: Validation) -> tuple[str, ...]:
    """Sentences: what limits what is known, each with what would help."""
    fast, sideways = log.speed > HIGH_SPEED, log.speed * np.nan_to_num(log.yaw_rate)
    idle = not fast.any() or math.sqrt(float(np.mean(portable.square(sideways[fast])))) < LITTLE
    stiffness = max(estimates[axle].high / estimates[axle].value for axle in ("front", "rear"))
    gradient, largest = estimates["understeer_gradient"], max(validation.autocorrelation, key=abs)
    numbers: dict[str, Any] = {
        "stiffness": stiffness,
        "why": f"hardly any steering above {HIGH_SPEED:g} m/s" if idle else "the log tells little of the tyres",
        "balance": gradient.spread_left if stiffness > LOOSE_FACTOR else math.nan,
        "gradient": degrees_per_g(gradient.value), "within": degrees_per_g(gradient.high - gradient.value),
        "tightest": log.tightest, "degrees": math.degrees(log.tightest),
        "gyro_clock": log.commanded and not np.isfinite(log.wheel).any(), "command": log.commanded,
        "speed_spread": float(np.std(log.speed)) / float(np.mean(log.speed)),
        "hardest": float(np.percentile(np.abs(sideways), 99)),
        "autocorrelation": abs(largest), "largest": largest,
        "explained": float(np.nan_to_num(validation.simulated)), "percent": 100 * validation.simulated,
    }  # fmt: skip
    if log.commanded:
        numbers |= {"lag": 0.5 * (estimates["lag"].high - estimates["lag"].low), "delay": estimates["delay"].value}
    return tuple(case.words for case in find_cases(FINDINGS, numbers))

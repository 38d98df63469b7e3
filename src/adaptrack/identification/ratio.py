"""Check of the steering ratio of a log, and of the scale of its steering angle. Only bends show them.

In a steady turn delta = L r/v + K v r. So a log tells the scale of its angle only as (angle scale x speed scale)/(scale
of the yaw rate) x true wheelbase/specified wheelbase, and it tells it from K where bends are driven at several speeds.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from adaptrack.core.maths import portable
from adaptrack.identification.identified_car import HARDLY, Estimate
from adaptrack.identification.likelihood import Likelihood
from adaptrack.identification.log import Log, window_mean
from adaptrack.identification.quantities import INDEX

Array = NDArray[np.float64]

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
UNKNOWN_RATIO = "cannot tell the ratio"
RATIO_LOOSE = 1.1
"""Factor within which a steering ratio is of use."""


class Gain(NamedTuple):
    """Angle of the road wheels over that in the log."""

    factor: float
    spread: float
    """standard deviation of its logarithm, from the log alone"""


def bend_time(log: Log) -> float:
    """Time (s) driven in bends."""
    measured = np.isfinite(log.yaw_rate)
    if not measured.any():
        return 0.0
    turning = np.abs(window_mean(log.time[measured], log.yaw_rate[measured], BEND_HALF_WINDOW)) > BEND_YAW_RATE
    return float(np.sum(turning)) / max(float(np.sum(measured)), 1.0) * log.driven_time


def gain_of(likelihood: Likelihood, z: Array, covariance: Array) -> Gain:
    """Gain of a log with a specified ratio, without its prior; covariance: of the free entries of the fit z."""
    place, prior = INDEX["gain"], float(likelihood.spread[INDEX["gain"]])
    if place not in likelihood.free:
        return Gain(1.0, math.inf)
    row = int(np.searchsorted(likelihood.free, place))
    precision = max(1.0 / float(covariance[row, row]) - 1.0, 1e-6)
    mean = prior * float(z[place]) * (1.0 + 1.0 / precision)
    return Gain(portable.exp(min(max(mean, -5.0), 5.0)), prior / math.sqrt(precision))


def check_scale(log: Log, scale: Estimate, gain: Gain, correlations: Mapping[str, float]) -> tuple[str, str]:
    """Return a contradiction of the specified ratio and a finding on the scale of its angles; either may be empty.

    correlations: of the scale with other estimates
    """
    ratio = f"--steering-ratio {log.ratio * scale.value:.3g}"
    if gain.spread > MAX_GAIN_SIGMA or bend_time(log) < MIN_BEND_TIME:
        return "", (
            f"{UNKNOWN_RATIO}: the log cannot confirm that its angles are those of the road wheels, and understeer is "
            "known with their scale only: drive bends at two speeds"
        )
    if abs(portable.log(gain.factor)) > max(RATIO_ERROR, RATIO_ERROR_SIGMAS * gain.spread):
        low, high = (gain.factor * portable.exp(side * 1.645 * gain.spread) for side in (-1.0, 1.0))
        return (
            f"the steering ratio is wrong: the road wheels turn {gain.factor:.2f} [{low:.2f}, {high:.2f}] times as far "
            f"as the log says: {ratio}, or fit"
        ), ""
    if scale.low <= 1.0 <= scale.high:
        return "", ""
    related = ", ".join(
        f"{name} {value:.2f}"
        for name, value in correlations.items()
        if name == "understeer_gradient" or abs(value) >= LEAST_CORRELATION
    )
    return "", (
        f"the logged steering angle is {scale.value:.3g} [{scale.low:.3g}, {scale.high:.3g}] times that of yaw rate, "
        f"speed and wheelbase (correlations: {related}): read logs with {ratio}, and use this ratio "
        "between car and controller"
    )


def check_fitted_ratio(log: Log, ratio: Estimate) -> tuple[bool, str]:
    """Return whether a fitted ratio is known, and a message."""
    seconds = bend_time(log)
    if seconds < MIN_BEND_TIME:
        return False, (
            f"{UNKNOWN_RATIO}: {seconds:.0f} s of bends, {MIN_BEND_TIME:g} s are needed; drive slow bends, or give "
            "--steering-ratio"
        )
    if ratio.spread_left > HARDLY:
        return False, f"{UNKNOWN_RATIO}: drive slow bends, or give --steering-ratio"
    factor = ratio.high / ratio.value
    if factor > RATIO_LOOSE:
        return True, f"steering ratio known within a factor {factor:.2f}: slow bends (below 10 m/s) tell it"
    return True, ""

"""Check of the steering ratio of a log. Only bends show it."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from adaptrack.core import portable
from adaptrack.identification.conventions import smoothed
from adaptrack.identification.identified_car import HARDLY, Estimate
from adaptrack.identification.likelihood import NEARLY, Likelihood
from adaptrack.identification.log import Log
from adaptrack.identification.quantities import INDEX, Prior

Array = NDArray[np.float64]

BEND_YAW_RATE, BEND_HALF_WINDOW, MIN_BEND_TIME = 0.03, 2.0, 4.0
"""rad/s, mean yaw rate of a bend, above that of gusts, lane keeping and offsets; s to either side, over which it is
averaged; s of bends that a check needs."""
MAX_GAIN_SIGMA = 0.08
"""Standard deviation of ln(ratio) up to which a log can confirm or refute a ratio."""
RATIO_ERROR, RATIO_ERROR_SIGMAS = 0.13, 2.0
"""Least error of ln(ratio) that is reported, and in standard deviations."""
GAIN_PRIOR_SIGMA = 0.5
"""Prior standard deviation of ln(gain) while the specified ratio is checked."""
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
    turning = np.abs(smoothed(log.time[measured], log.yaw_rate[measured], BEND_HALF_WINDOW)) > BEND_YAW_RATE
    return float(np.sum(turning)) / max(float(np.sum(measured)), 1.0) * log.driven_time


def gain_of(likelihood: Likelihood, z: Array) -> Gain:
    """Gain of a log with a specified ratio, from a fit in which the gain is free."""
    log = likelihood.log
    if log.commanded and likelihood.present["wheel"]:  # it was read with the same ratio
        log = replace(log, wheel=np.full(log.samples, math.nan))
    free_gain = Likelihood(log, likelihood.car, likelihood.beliefs | {"gain": Prior(1.0, GAIN_PRIOR_SIGMA)})
    free, spread = free_gain.free, free_gain.spread
    free_gain.take_gusts(likelihood)
    free_gain.free, free_gain.spread = free, spread
    place = int(np.searchsorted(free, INDEX["gain"]))
    optimum, evaluation = free_gain.fit(z, NEARLY)
    sigma = GAIN_PRIOR_SIGMA * math.sqrt(free_gain.covariance(evaluation)[place, place])
    log_sigma = 1.0 / math.sqrt(
        max(1.0 / (sigma * sigma) - 1.0 / (GAIN_PRIOR_SIGMA * GAIN_PRIOR_SIGMA), 1e-9)
    )  # without the prior
    mean = GAIN_PRIOR_SIGMA * float(optimum[INDEX["gain"]]) * (1.0 + portable.square(log_sigma / GAIN_PRIOR_SIGMA))
    return Gain(portable.exp(min(max(mean, -5.0), 5.0)), log_sigma)


def check_ratio(log: Log, gain: Gain) -> tuple[str, str]:
    """Return a contradiction of the specified ratio and the reason why there is no verdict; at least one is empty."""
    if gain.spread > MAX_GAIN_SIGMA or bend_time(log) < MIN_BEND_TIME:
        return "", f"{UNKNOWN_RATIO}: the log cannot confirm that its angles are those of the road wheels"
    if abs(portable.log(gain.factor)) <= max(RATIO_ERROR, RATIO_ERROR_SIGMAS * gain.spread):
        return "", ""
    low, high = (gain.factor * portable.exp(side * 1.645 * gain.spread) for side in (-1.0, 1.0))
    ratio = f": the ratio is {log.ratio / gain.factor:.3g}, not {log.ratio:.3g}" if log.ratio != 1.0 else ""
    return (
        f"the steering ratio is wrong: the road wheels turn {gain.factor:.2f} [{low:.2f}, {high:.2f}] times as far as "
        f"the log says{ratio}; --steering-ratio fit finds it"
    ), ""


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

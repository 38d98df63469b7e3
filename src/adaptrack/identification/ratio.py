"""What a log tells of the steering ratio: nothing without bends, and whether a given one is wrong."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from adaptrack.identification.conventions import smoothed
from adaptrack.identification.identified_car import HARDLY, Estimate
from adaptrack.identification.likelihood import NEARLY, Likelihood
from adaptrack.identification.log import Log
from adaptrack.identification.quantities import INDEX, Prior

Array = NDArray[np.float64]

BEND, HALF, LEAST_BENDS = 0.03, 2.0, 4.0
"""rad/s, mean yaw rate within +-s of an instant from which the car is in a bend, more than gusts, lane keeping and
offsets make; s of bends that tell a ratio."""
TELLS = 0.08
"""Standard deviation of ln(ratio) up to which a log tells whether a ratio is right."""
WRONG, SURE = 0.13, 2.0
"""Of ln(ratio), and of its standard deviations, from which it is wrong."""
FREED = 0.5
"""Spread of ln(gain) where the given ratio is put to the test."""
OPEN = "cannot tell the ratio"
RATIO_LOOSE = 1.1
"""Factor within which a steering ratio is of use."""


class Gain(NamedTuple):
    """By what the road wheels turn farther than the log says."""

    factor: float
    spread: float
    """standard deviation of its logarithm, as the log alone tells it"""


def bends(log: Log) -> float:
    """s of driving in bends."""
    known = np.isfinite(log.yaw_rate)
    if not known.any():
        return 0.0
    turning = np.abs(smoothed(log.time[known], log.yaw_rate[known], HALF)) > BEND
    return float(np.sum(turning)) / max(float(np.sum(known)), 1.0) * log.driven


def gain_of(likelihood: Likelihood, z: Array) -> Gain:
    """The gain of a log whose ratio was given, from a fit in which it is free."""
    log = likelihood.log
    if log.commanded and likelihood.present["wheel"]:  # which was read with the same ratio
        log = replace(log, wheel=np.full(log.samples, math.nan))
    each = Likelihood(log, likelihood.car, likelihood.beliefs | {"gain": Prior(1.0, FREED)})
    free, freed = each.free, each.spread
    each.take_gusts(likelihood)
    each.free, each.spread = free, freed
    place = int(np.searchsorted(free, INDEX["gain"]))
    there, at = each.fit(z, NEARLY)
    spread = FREED * math.sqrt(each.covariance(at)[place, place])
    data = 1.0 / math.sqrt(max(1.0 / spread**2 - 1.0 / FREED**2, 1e-9))
    mean = FREED * float(there[INDEX["gain"]]) * (1.0 + (data / FREED) ** 2)  # without the prior
    return Gain(math.exp(min(max(mean, -5.0), 5.0)), data)


def judged(log: Log, gain: Gain) -> tuple[str, str]:
    """What contradicts the given ratio, and what is open; one of both at most."""
    if gain.spread > TELLS or bends(log) < LEAST_BENDS:
        return "", f"{OPEN}: whether the logged angles are those of the road wheels rests on what was given"
    off = math.log(gain.factor)
    if abs(off) <= max(WRONG, SURE * gain.spread):
        return "", ""
    low, high = (gain.factor * math.exp(side * 1.645 * gain.spread) for side in (-1.0, 1.0))
    ratio = f": the ratio is {log.ratio / gain.factor:.3g}, not {log.ratio:.3g}" if log.ratio != 1.0 else ""
    return (
        f"the steering ratio is wrong: the road wheels turn {gain.factor:.2f} [{low:.2f}, {high:.2f}] times as far as "
        f"the log says{ratio}; --steering-ratio fit finds it"
    ), ""


def of_found(log: Log, ratio: Estimate) -> tuple[bool, str]:
    """Whether a ratio that was to be found is known, and what is said of it."""
    driven = bends(log)
    if driven < LEAST_BENDS:
        return False, (
            f"{OPEN}: {driven:.0f} s of bends, {LEAST_BENDS:g} s are needed; drive slow bends, or give --steering-ratio"
        )
    if ratio.spread_left > HARDLY:
        return False, f"{OPEN}: drive slow bends, or give --steering-ratio"
    factor = ratio.high / ratio.value
    if factor > RATIO_LOOSE:
        return True, f"steering ratio known within a factor {factor:.2f}: slow bends (below 10 m/s) tell it"
    return True, ""

"""What a log says of a car and what it cannot say, in words."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from adaptrack.core.maths import portable
from adaptrack.identification.identified_car import Estimate, Validation
from adaptrack.identification.log import Log
from adaptrack.identification.quantities import degrees_per_g

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


def findings(log: Log, estimates: Mapping[str, Estimate], validation: Validation) -> tuple[str, ...]:
    """Sentences: what limits what is known, each with what would help."""
    sentences = []
    fast = log.speed > HIGH_SPEED
    sideways = log.speed * np.nan_to_num(log.yaw_rate)
    stiff = [estimates["front"], estimates["rear"]]
    factor = max(estimate.high / estimate.value for estimate in stiff)
    if factor > LOOSE_FACTOR:
        idle = not fast.any() or math.sqrt(float(np.mean(portable.square(sideways[fast])))) < LITTLE
        why = f"hardly any steering above {HIGH_SPEED:g} m/s" if idle else "the log tells little of the tyres"
        sentences.append(f"{why}: stiffness known within a factor {factor:.2g}")
        gradient = estimates["understeer_gradient"]
        if gradient.spread_left < 0.5:
            within = degrees_per_g(gradient.high - gradient.value)
            sentences.append(
                f"what the axles have in common is open, their balance is not: understeer gradient "
                f"{degrees_per_g(gradient.value):.2g} deg/g within {within:.2g}"
            )
    if log.tightest > TIGHT:
        sentences.append(
            f"tight bends, wheels at {math.degrees(log.tightest):.0f} degrees: driving and braking forces, which the "
            "log lacks, turn the car too, so intervals are wider"
        )
    if log.commanded:
        lag = estimates["lag"]
        if 0.5 * (lag.high - lag.low) > SPLIT:
            sentences.append(
                f"lag and dead time are known in sum ({estimates['delay'].value:.3g} s), not how they share it: quick "
                "steering, or a measured wheel angle, tells them apart"
            )
        if not np.isfinite(log.wheel).any():
            sentences.append(
                "cannot tell a late yaw rate from late wheels: delay is from the command to the logged yaw rate"
            )
    else:
        sentences.append("no steering command in the log: cannot tell lag and dead time, they keep what was believed")
    if float(np.std(log.speed)) < EVEN_SPEED * float(np.mean(log.speed)):
        sentences.append("the speed hardly changes: steering offset, bank and gyro offset are known in sum only")
    if float(np.percentile(np.abs(sideways), 99)) > HARD:
        sentences.append(f"driven hard, above {HARD:g} m/s^2: stiffness rests on the tyres' curve too")
    largest = max(validation.autocorrelation, key=abs)
    if abs(largest) > COLOURED:
        sentences.append(f"the residuals are not white (autocorrelation {largest:.2f}): intervals may be too narrow")
    if not validation.simulated > POOR:
        sentences.append(
            f"simulated from the command alone, {100 * validation.simulated:.0f} % of the yaw rate's variance is "
            "explained: the rest is wind, road, or a wrong column"
        )
    return tuple(sentences)

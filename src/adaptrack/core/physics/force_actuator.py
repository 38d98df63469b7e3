"""Drive and brakes between a requested force and the wheels: dead time, gain, first-order lag behind a rate limit.

    dF/dt = clip((gain request - F)/lag, -rate, rate),   0 <= F <= limit

The request of a dead time ago is constant over a control period, or changes once in it. Between changes the response is
exact, and the plant feels its mean over the period: speeds at the control instants carry no error of integration.
"""

from __future__ import annotations

import math

from ..kernel import inlined, record
from ..maths.exact import clip
from ..maths.exponential import exp
from ..models.car import ACTUATOR_LAG

ForceActuator = record(
    "ForceActuator",
    (
        "dead_whole", "dead_share",  # control periods from a request until it acts: whole ones, and the share of one
        ACTUATOR_LAG,
        "rate",  # N/s, fastest change of the force; inf: no limit
        "gain",  # -, force that is reached over the force that is requested
        "limit",  # N, largest force
    ),
    integers=("dead_whole",),
)  # fmt: skip
"""The drive, or the brakes, of a simulated car."""


@inlined
def force_response(force, target, duration, actuator):
    """Force (N) after a time (s) under a constant target (N), and the mean force (N) until then."""
    if not (actuator.lag > 0.0 or actuator.rate < math.inf):
        return target, target
    gap, impulse, remaining = target - force, 0.0, duration
    lagging_gap = actuator.rate * actuator.lag  # N, below which the lag alone is slower than the rate limit
    if abs(gap) > lagging_gap:
        ramp_time = min(duration, (abs(gap) - lagging_gap) / actuator.rate)
        change = math.copysign(actuator.rate * ramp_time, gap)
        impulse = (force + 0.5 * change) * ramp_time
        force += change
        gap, remaining = target - force, duration - ramp_time
    if not (remaining > 0.0 and actuator.lag > 0.0):
        return force, (impulse + target * remaining) / duration
    decay = exp(-remaining / actuator.lag)
    return target - gap * decay, (impulse + target * remaining - gap * actuator.lag * (1.0 - decay)) / duration


@inlined
def actuator_step(force, floor, requests, period, actuator):
    """Force (N) at the end of a control period (s), and its mean (N).

    floor: N, that the actuator gives at least; requests: N, the latest first.
    A dead time that is no whole number of periods lets the request change within the period.
    """
    share, whole_periods = actuator.dead_share, actuator.dead_whole
    mean = 0.0
    if share > 0.0:
        target = clip(actuator.gain * requests[whole_periods + 1], floor, actuator.limit)
        force, mean = force_response(force, target, share * period, actuator)
    target = clip(actuator.gain * requests[whole_periods], floor, actuator.limit)
    force, mean_after = force_response(force, target, (1.0 - share) * period, actuator)
    return force, share * mean + (1.0 - share) * mean_after

"""The steering that a controller assumes, the source of each number, and its uncertainty."""

from __future__ import annotations

import math

from ..kernel import Field, Row, exported, float64, inlined, int64, record, void
from ..maths.exponential import hypot, log, power
from ..models.car import SteeringRow
from .car import KnownWithinRow
from .filter import DriftsRow

GIVEN, CAR_FILE, PROFILE, SLOW_ASSUMED, MEDIAN_TO_LEARN, FROM_EARLIER_DRIVE = range(6)
"""Sources of a number: the caller; the car file; the profile; none, so a slow published value is assumed; none, so
learning starts at the published median; an earlier drive."""
SteeringSource = record("SteeringSource", SteeringRow._fields, integers=SteeringRow._fields)
"""Source of each number of a steering."""
BeliefRow = record(
    "BeliefRow",
    (
        ("steering", SteeringRow),  # its rate is inf where there is no limit
        ("source", SteeringSource),
        "computation",  # s, from a measurement until its command is given
    ),
)
"""The steering that a controller assumes."""
MAX_DELAY, MAX_STIFFNESS, MAX_MASS = 1.0, 4.0, 0.9
"""s, -, -: largest uncertainties."""
UNCERTAINTY = (
    Field("lag", "s", 0.0, "of the steering's lag", f"[0, {MAX_DELAY:g}]"),
    Field("dead_time", "s", 0.0, "of the steering's dead time", f"[0, {MAX_DELAY:g}]"),
    Field("stiffness", "", 1.0, "factor on the cornering stiffness of an axle", f"[1, {MAX_STIFFNESS:g}]"),
    Field("mass", "", 0.0, "share of mass and yaw inertia", f"[0, {MAX_MASS:g}]"),
)
UncertaintyRow = record("UncertaintyRow", UNCERTAINTY)
"""By how much the belief may be wrong, to either side."""
CommandBounds = record("CommandBounds", ("move", "ahead", "angle"))
"""rad: of the change of a command in a period, of the command ahead of the wheels, of the command; to either side."""

MOST_STEERING_DELAY, PUBLISHED_COMPUTATION = 0.35, 0.05
"""s, lag and dead time together of a slow steering, and the computation time in front of it: together the longest that
opendbc lists for series cars, 0.1 to 0.4 s (`steerActuatorDelay`). Unknown steering parameters default to it, because a
delay assumed too short loses the car and one too long costs little. A shorter computation time lengthens the dead time.
"""
MIN_ASSUMED_LAG = 0.05
"""s, shortest lag that is assumed where only the dead time is known."""
LEAST_STEERING_RATE = 0.4
"""rad/s at the road wheels, the lowest of published rate limits (CommonRoad vehicle models, vehicle 2)."""
MOVE, ANGLE = math.pi / 12, math.pi / 6
"""rad, bounds of eqs. (13) and (14) in the paper's table."""
QUANTILE, TOLERATED_DELAY, MOST_CAUTION, USUAL_RATE = 0.95, 0.018, 16.0, 0.5
"""Of what a delay may be, the share that is not above what is believed; s, an error of the delay that doubles R; the
largest factor on R for it; rad/s, steering rate."""
WIDE_STIFFNESS, STIFFNESS_DRIFTS = 1.6, (3.0, 5.0)
"""Factor of the stiffness; by which, at it, the drifts of the disturbances are divided and that of sliding multiplied:
the best of 12 settings on 16 drives of each of six cars in `production`, known by mass and wheelbase alone."""


@inlined
def _first_known(caller, car, actuator):
    """The first known number and its source."""
    if not math.isnan(caller):
        return caller, GIVEN
    if not math.isnan(car):
        return car, CAR_FILE
    return actuator, SLOW_ASSUMED if math.isnan(actuator) else PROFILE


@exported(void(Row(SteeringRow), Row(SteeringRow), Row(SteeringRow), float64, Row(BeliefRow)))
def believe_steering(caller, car, actuator, computation, belief):
    """Write the belief about a steering: each number from its first source, a slow published value where it has none.

    caller: by the caller; car: of the car file; actuator: of the profile; computation: s. A known lag shortens an
    assumed dead time, and a known dead time an assumed lag.
    """
    steering, source = belief.steering, belief.source
    transport = max(PUBLISHED_COMPUTATION - computation, 0.0)
    lag, source.lag = _first_known(caller.lag, car.lag, actuator.lag)
    dead, source.dead_time = _first_known(caller.dead_time, car.dead_time, actuator.dead_time)
    rate, source.rate = _first_known(caller.rate, car.rate, actuator.rate)
    limit, source.limit = _first_known(caller.limit, car.limit, actuator.limit)
    steering.lag, steering.dead_time = lag, dead
    if source.lag == SLOW_ASSUMED:
        steering.lag = max(MOST_STEERING_DELAY - (0.0 if math.isnan(dead) else dead - transport), MIN_ASSUMED_LAG)
    if source.dead_time == SLOW_ASSUMED:
        steering.dead_time = transport + (0.0 if math.isnan(lag) else max(MOST_STEERING_DELAY - lag, 0.0))
    steering.rate = LEAST_STEERING_RATE if source.rate == SLOW_ASSUMED else rate
    steering.limit = ANGLE if source.limit == SLOW_ASSUMED else limit
    belief.computation = computation


@inlined
def is_unknown(source):
    """Whether a number is assumed."""
    return source in (SLOW_ASSUMED, MEDIAN_TO_LEARN)


@inlined
def is_cautious(belief):
    """Whether lag or dead time is assumed."""
    return is_unknown(belief.source.lag) or is_unknown(belief.source.dead_time)


@inlined
def _capped(value, most):
    return 0.0 if math.isnan(value) else min(value, most)


@inlined
def _largest(a, b):
    """The larger of two factors, 1 where both are unknown."""
    return max(1.0 if math.isnan(a) else a, 1.0 if math.isnan(b) else b)


@exported(void(Row(KnownWithinRow), Row(BeliefRow), Row(UncertaintyRow)))
def uncertainty_of_car(within, belief, unsure):
    """Write the uncertainty of the car file; that of lag and dead time only where the belief has them from there."""
    unsure.lag = _capped(within.steering_lag, MAX_DELAY) if belief.source.lag == CAR_FILE else 0.0
    unsure.dead_time = _capped(within.steering_dead_time, MAX_DELAY) if belief.source.dead_time == CAR_FILE else 0.0
    unsure.stiffness = min(_largest(within.stiffness_front, within.stiffness_rear), MAX_STIFFNESS)
    unsure.mass = min(_largest(within.mass, within.yaw_inertia) - 1.0, MAX_MASS)


@exported(float64(Row(UncertaintyRow)))
def caution_of(unsure):
    """Factor on R for an uncertainty."""
    delay = hypot(unsure.lag, unsure.dead_time) / TOLERATED_DELAY
    return min(1.0 + delay * delay, MOST_CAUTION) * unsure.stiffness * (1.0 + unsure.mass)


@inlined
def delay_margin(half):
    """Margin (s) that is added to a delay that is uniform within +- `half` (s)."""
    return (2.0 * QUANTILE - 1.0) * half


@exported(void(Row(UncertaintyRow), int64, Row(DriftsRow)))
def widen_drifts(unsure, measures_vy, drifts):
    """Let a filter drift as far as the belief may be wrong; measures_vy: 1: the lateral velocity is measured.

    A delay that is wrong puts the wheels elsewhere, by the steering rate times it. A stiffness that is wrong makes an
    error with the axle's force, as sliding does. Disturbances that follow it quickly close a loop of their own, which
    is unstable where nothing measures the lateral velocity: there they are followed more slowly, and the forces are
    trusted less, by `STIFFNESS_DRIFTS` at a factor of `WIDE_STIFFNESS` and by less below it.
    """
    drifts.wheel_angle = hypot(drifts.wheel_angle, USUAL_RATE * (unsure.lag + unsure.dead_time))
    if measures_vy > 0:
        return
    share = min(log(unsure.stiffness) / log(WIDE_STIFFNESS), 1.0)
    slower, wilder = power(STIFFNESS_DRIFTS[0], share), power(STIFFNESS_DRIFTS[1], share)
    drifts.side /= slower
    drifts.turn /= slower
    drifts.wind /= slower
    drifts.sliding *= wilder


@exported(void(Row(BeliefRow), float64, Row(CommandBounds)))
def bound_commands(belief, period, bounds):
    """Write the limits on a command: on its change the rate times a period (s), on its size the limit.

    The next command may be ahead of the wheels by the rate times lag and period: so far they follow within the rate.
    Behind a delay that is assumed, thus probably too long, bounded moves lose the car: the change has then the bound of
    the paper's table, as it has where there is no rate limit. A controller that learns the delay needs the bound, an
    unknown rate being `LEAST_STEERING_RATE`: wheels that turn at their limit are late by more than the delay, and of
    2,000 unknown cars that start at 20 to 30 m/s it loses 75 without the bound and 14 with it.
    """
    steering, source = belief.steering, belief.source
    assumed = source.lag == SLOW_ASSUMED or source.dead_time == SLOW_ASSUMED
    bounded = steering.rate < math.inf and not assumed
    bounds.move = steering.rate * period if bounded else MOVE
    bounds.ahead = steering.rate * (steering.lag + period) if bounded else 0.0
    bounds.angle = steering.limit

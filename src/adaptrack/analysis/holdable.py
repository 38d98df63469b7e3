"""Table of the largest braking in bends at which a controller keeps its stability margin, for `plan_speed`.

Braking shifts load from the rear axle to the front, so a neutral car oversteers. The controller's model neglects this.
The table contains modulus margins of the loop, linearised about steady turns with braking (`linearisation.Steady`). The
gains of the estimator are those in the turn, and so is the slope of the rear tyres in the prediction.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Annotated, Any

import numpy as np

from adaptrack.analysis.linearisation import EstimatorAt, laws, sampled_about, steady_turn
from adaptrack.analysis.stability import COARSE_ANGLES, modulus_margin
from adaptrack.base.checked import Positive, checked
from adaptrack.base.errors import InvalidInput
from adaptrack.base.limits import MAX_SPEED
from adaptrack.cars.plant import DualTrack
from adaptrack.cars.vehicle import Steering, Vehicle
from adaptrack.control.controllers import MPC
from adaptrack.core.controllers.informed import rear_slope
from adaptrack.core.maths import portable
from adaptrack.core.physics.forces import GRAVITY
from adaptrack.road.holdable_speed import HoldableSpeed
from adaptrack.road.speed import cornering_limit
from adaptrack.scenario.profile import Profile, load_profile

MAX_INSTABILITY_DURATION = 10.0
"""Longest time (s) during which an instability is considered."""
GUST_ACCELERATION = 1.0
"""Lateral acceleration (m/s^2) of a saloon at 30 m/s in a side gust of 15 m/s."""
UNMODELLED_SHARE = 0.25
"""Share of the lateral acceleration in a bend that the controller's model does not predict."""
MIN_TABLE_SPEED, TABLE_SPEED_RATIO = 10.0, 1.3
"""Lowest speed of the table (m/s), whose values also apply below it; ratio of neighbouring speeds."""
TABLE_FRICTIONS = (0.3, 0.6, 1.0)
"""Friction coefficients of the table."""
LATERAL_SHARES = (0.0, 0.25, 0.45, 0.65, 0.8, 0.95)
"""Lateral accelerations of the table / largest lateral acceleration of the car."""
BRAKING_SHARES = (0.0, 0.17, 0.34, 0.51)
"""Decelerations of the table / (mu g)."""
OUTSIDE_GRIP_MARGIN = -1.0
"""Margin that is assumed if braking exceeds the grip of the tyres in a turn."""


@checked
def holdable_speed(
    car: Vehicle,
    mpc: MPC,
    profile: str | Profile = "road",
    *,
    longest: Annotated[Positive, "s"] = MAX_INSTABILITY_DURATION,
) -> HoldableSpeed:
    """Compute the largest braking with a sufficient modulus margin, by speed, lateral acceleration and friction.

    Braking lasts some seconds only, so the loop may be slightly unstable meanwhile. Its margin is sufficient if a
    disturbance, in that time, does not grow to more than the remaining grip (`min_transient_margin`). The computation
    takes some seconds and is cached by car, controller and profile.

    Parameters
    ----------
    car
        The true car; its plant is `DualTrack`.
    mpc
        Controller with a constant tuning. A controller that learns is analysed with the slowest steering of its prior,
        both in the car and in the learned model.
    profile
        Sensors and steering of the true car. Sensor delays are neglected, which is slightly optimistic.
    longest
        Longest time (s) during which an instability is considered. A longer time allows less instability.
    """
    profile = load_profile(profile)
    if mpc.learner is not None:
        mpc, profile = _slowest_loop(mpc, profile)
    inputs = mpc.model, mpc.estimator, mpc.tuning, mpc.moves, mpc.speed_floor
    return _cached_speeds(car, _Loop(mpc, profile, inputs), longest)


@dataclass(frozen=True)
class _Loop:
    """A controller in a profile, as a key of a cache: equal if all inputs of the analysis are equal."""

    mpc: MPC = field(compare=False)
    profile: Profile
    inputs: tuple[Any, ...]
    """Model, estimator, tuning, moves and lowest speed of the controller."""


def _slowest_loop(mpc: MPC, profile: Profile) -> tuple[MPC, Profile]:
    """Return a controller with the slowest steering of its prior, and a profile with this steering."""
    belief = mpc.belief
    assert belief is not None
    assert mpc.learner is not None
    lag, dead_time = (high for _, high in mpc.learner.ranges)
    assumed = {name: value for name, value in belief.steering.items() if math.isfinite(value)}
    slow_steering = Steering(**assumed).replace(lag=lag, dead_time=dead_time)
    actuator = profile.steering.replace(lag=lag, dead_time=dead_time)
    slow = profile.replace(steering=actuator)
    return MPC(mpc.vehicle, mpc.tuning, profile=slow, belief=slow_steering, period=mpc.period), slow


@lru_cache(maxsize=16)
def _cached_speeds(car: Vehicle, loop: _Loop, longest: float) -> HoldableSpeed:
    mpc, profile = loop.mpc, loop.profile.without_sample_ages
    plant = DualTrack(car)
    lowest = max(MIN_TABLE_SPEED, mpc.speed_floor)
    ratio = max(top_speed(car) / lowest, TABLE_SPEED_RATIO)
    count = math.ceil(portable.log(ratio) / portable.log(TABLE_SPEED_RATIO)) + 1
    speeds = portable.geomspace(lowest, max(top_speed(car), TABLE_SPEED_RATIO * lowest), count).round(2).tolist()
    cornering = [float(cornering_limit(car, [0.0], [mu])[0]) for mu in TABLE_FRICTIONS]
    braking = np.empty((len(TABLE_FRICTIONS), len(speeds), len(LATERAL_SHARES)))
    for j, speed in enumerate(speeds):
        estimator = EstimatorAt(mpc, speed)
        for i, mu in enumerate(TABLE_FRICTIONS):
            times = [_instability_time(speed, share * mu * GRAVITY, longest) for share in BRAKING_SHARES]
            for k, share in enumerate(LATERAL_SHARES):
                lateral = share * cornering[i]
                margins = _margins(plant, (mpc, profile), estimator, (speed, mu, lateral))
                if margins is None:  # the turn needs more steering angle or grip than there is: no braking
                    braking[i, j, k] = min(braking[i, j, k - 1], 0.0)
                    continue
                growth = (cornering[i] - lateral) / (GUST_ACCELERATION + UNMODELLED_SHARE * lateral)
                limits = [min_transient_margin(growth, time, mpc.period) for time in times]
                braking[i, j, k] = _largest_braking(margins, limits)
    return HoldableSpeed(
        vehicle=car.name, profile=profile.name, steering=str(mpc.belief or ""), longest=longest,
        reserve=GUST_ACCELERATION, speeds=tuple(speeds), sideways=LATERAL_SHARES, frictions=TABLE_FRICTIONS,
        cornering=tuple(cornering), braking=tuple(tuple(map(tuple, plane)) for plane in braking.round(4).tolist()),
    )  # fmt: skip


def _margins(
    plant: DualTrack, loop: tuple[MPC, Profile], estimator: EstimatorAt, turn: tuple[float, float, float]
) -> Iterator[float] | None:
    """Return the modulus margin at each of `BRAKING_SHARES`, or None if the car cannot drive the turn.

    turn: speed (m/s), friction, lateral acceleration (m/s^2).
    """
    (mpc, profile), (speed, mu, lateral) = loop, turn
    try:
        without_braking = steady_turn(plant, speed, lateral, mu)
    except InvalidInput:
        return None
    # The gains of the estimator change slowly, so they are those of the turn before braking.
    turn_gains = estimator.with_turn_gains(without_braking.measured(plant, mpc.period), without_braking.steering)
    slope = rear_slope(lateral, mpc.estimator.tyres[0])
    law = laws(mpc, speed, mpc.tuning.as_array(), turn_gains, slope)

    def margin(share: float) -> float:
        try:
            steady = steady_turn(plant, speed, lateral, mu, share * mu * GRAVITY) if share > 0.0 else without_braking
        except InvalidInput:
            return OUTSIDE_GRIP_MARGIN
        return float(modulus_margin(sampled_about(plant, mpc.period, steady, profile), law, COARSE_ANGLES)[0])

    return map(margin, BRAKING_SHARES)


def _largest_braking(margins: Iterable[float], limits: Sequence[float]) -> float:
    """Return the deceleration / (mu g) at which the margin falls below its limit.

    The result is negative, margin minus limit, if the margin is too small without braking.
    """
    last_share, last_excess = 0.0, 0.0
    for share, margin, limit in zip(BRAKING_SHARES, margins, limits, strict=True):
        excess = margin - limit
        if excess < 0.0 and share == 0.0:
            return max(excess, OUTSIDE_GRIP_MARGIN)
        if excess < 0.0:
            return last_share + (share - last_share) * last_excess / (last_excess - excess)
        last_share, last_excess = share, excess
    return BRAKING_SHARES[-1]


def _instability_time(speed: float, braking: float, longest: float) -> float:
    """Return the effective time (s) of an instability that braking (m/s^2) from a speed (m/s) causes.

    The instability decreases with the speed and ends at half of it, so half of the time until then counts.
    """
    return min(0.25 * speed / braking, longest) if braking > 0.0 else longest


def min_transient_margin(growth: float, time: float, period: float) -> float:
    """Return the modulus margin, 0 or less, of a loop whose deviations grow by a factor `growth` in a time (s).

    With a spectral radius rho over a control period T (s), deviations grow by rho^(t/T). The margin of an unstable loop
    is -10 (rho - 1), see `stability.modulus_margin`.
    """
    return -10.0 * portable.expm1(portable.log(max(growth, 1.0)) * period / time)


def top_speed(car: Vehicle) -> float:
    """Return the highest speed (m/s) that the car reaches on a level road."""
    v = np.linspace(1.0, MAX_SPEED.most, 397)
    air = 0.5 * car.air_density * car.frontal_area * car.drag_coefficient * (v * v)
    resistance = air + car.rolling_resistance * car.mass * GRAVITY
    reachable = np.minimum(car.traction_limit, car.engine_power / v) >= resistance
    return float(v[reachable].max(initial=1.0))

"""How fast, and how hard braking, the margins of a controller hold on a bend: the table that `plan_speed` asks.

Braking shifts load from the rear axle to the front: a car that steers neutrally then oversteers, and the controller's
model does not know it. So the loop is linearised about steady turns in which the car brakes (`linearisation.Steady`),
its estimator with the gains that it has in such a turn, and the modulus margin is looked at.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from functools import lru_cache
from typing import Annotated

import numpy as np

from adaptrack.analysis.linearisation import EstimatorAt, Steady, laws, sampled_about
from adaptrack.analysis.stability import modulus_margin
from adaptrack.base.checked import Positive, checked
from adaptrack.base.errors import InvalidInput
from adaptrack.base.limits import MAX_SPEED
from adaptrack.cars.plant import DualTrack
from adaptrack.cars.vehicle import Steering, Vehicle
from adaptrack.control.controllers import MPC
from adaptrack.core.plants.forces import GRAVITY
from adaptrack.road.cornering import cornering_limit
from adaptrack.road.holdable_speed import HoldableSpeed
from adaptrack.scenario.profile import Profile, load_profile

MAX_INSTABILITY_DURATION = 10.0
"""s, for which an instability counts at most: braking lasts until the speed is half."""
DISTURBED, UNMODELLED = 1.0, 0.25
"""m/s^2, what a gust of 15 m/s from the side does to a saloon at 30 m/s; and which share of the lateral acceleration of
a bend the model misses: together the deviation that must not grow beyond the grip meanwhile."""
MIN_TABLE_SPEED, TABLE_SPEED_RATIO = 10.0, 1.3
"""m/s, of the table, below which its values hold as well; and of one speed to the next."""
TABLE_FRICTIONS = (0.3, 0.6, 1.0)
SIDEWAYS = (0.0, 0.25, 0.45, 0.65, 0.8, 0.95)
"""Lateral accelerations over the largest that the car can corner with."""
BRAKING_SHARES = (0.0, 0.17, 0.34, 0.51)
"""Decelerations over mu g, up to the first that is not held."""
BEYOND = -1.0
"""Margin where braking takes the car beyond its grip: there is no such turn."""
_ANGLES = np.geomspace(2e-3, np.pi, 192)  # rad per period, at which the loop gain is looked at


@checked
def holdable_speed(
    car: Vehicle,
    mpc: MPC,
    profile: str | Profile = "road",
    *,
    longest: Annotated[Positive, "s"] = MAX_INSTABILITY_DURATION,
) -> HoldableSpeed:
    """Up to which braking, by speed, lateral acceleration and friction, the modulus margin of the loop is enough.

    Braking lasts some seconds, and a loop that is unstable for so long need not lose the car: a disturbance must not
    grow, in that time, to more than the tyres have left (`borne`). It takes some seconds, once for each car, controller
    and profile.

    Parameters
    ----------
    car
        The true car; its plant is `DualTrack`.
    mpc
        The controller with its belief and its constant tuning. Of one that learns: as it is when it has learned that
        the steering is as slow as its prior allows, on a car whose steering is that.
    profile
        Sensors and steering of the true car; samples count as prompt, which is a little kinder than the truth.
    longest
        For which an instability counts at most; the longer, the less of it is borne.
    """
    loop = _slow_end(mpc, load_profile(profile)) if mpc.learner is not None else (mpc, load_profile(profile))
    return _cached_speeds(car, _Loop(*loop), longest)


class _Loop:
    """A controller in a profile; alike when everything that the analysis reads is."""

    def __init__(self, mpc: MPC, world: Profile) -> None:
        self.mpc, self.world = mpc, world
        self._alike = (mpc.model, mpc.estimator, mpc.tuning, mpc.moves, mpc.speed_floor, world)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Loop) and self._alike == other._alike

    def __hash__(self) -> int:
        return hash(self._alike)


def _slow_end(mpc: MPC, world: Profile) -> tuple[MPC, Profile]:
    """A controller that has learned the slowest steering of its prior, and the world in which that is true."""
    belief = mpc.belief
    assert belief is not None
    assert mpc.learner is not None
    lag, dead_time = (high for _, high in mpc.learner.ranges)
    rate = belief.rate.value if math.isfinite(belief.rate.value) else None
    slow_steering = Steering(lag=lag, dead_time=dead_time, rate=rate, limit=belief.limit.value)
    actuator = world.steering.replace(lag=lag, dead_time=dead_time)
    slow = world.replace(steering=actuator)
    return MPC(mpc.vehicle, mpc.tuning, profile=slow, belief=slow_steering, period=mpc.period), slow


@lru_cache(maxsize=16)
def _cached_speeds(car: Vehicle, loop: _Loop, longest: float) -> HoldableSpeed:
    mpc, world = loop.mpc, loop.world.without_sample_ages
    plant = DualTrack(car)
    lowest = max(MIN_TABLE_SPEED, mpc.speed_floor)
    count = max(
        2, math.ceil(math.log(max(top_speed(car) / lowest, TABLE_SPEED_RATIO)) / math.log(TABLE_SPEED_RATIO)) + 1
    )
    speeds = np.geomspace(lowest, max(top_speed(car), TABLE_SPEED_RATIO * lowest), count).round(2).tolist()
    cornering = [float(cornering_limit(car, [0.0], [mu])[0]) for mu in TABLE_FRICTIONS]
    braking = np.empty((len(TABLE_FRICTIONS), len(speeds), len(SIDEWAYS)))
    for j, speed in enumerate(speeds):
        at = EstimatorAt(mpc, speed)
        for i, mu in enumerate(TABLE_FRICTIONS):
            lasting = [_lasting(speed, share * mu * GRAVITY, longest) for share in BRAKING_SHARES]
            for k, share in enumerate(SIDEWAYS):
                lateral = share * cornering[i]
                margins = _margins(plant, (mpc, world), at, (speed, mu, lateral))
                if margins is None:  # tighter than the wheels can turn, or beyond the grip: no braking
                    braking[i, j, k] = min(braking[i, j, k - 1], 0.0)
                    continue
                room = (cornering[i] - lateral) / (DISTURBED + UNMODELLED * lateral)
                braking[i, j, k] = _braking(margins, [borne(room, time, mpc.period) for time in lasting])
    return HoldableSpeed(
        vehicle=car.name, profile=world.name, steering=str(mpc.belief or ""), longest=longest,
        reserve=DISTURBED, speeds=tuple(speeds), sideways=SIDEWAYS, frictions=TABLE_FRICTIONS,
        cornering=tuple(cornering), braking=tuple(tuple(map(tuple, plane)) for plane in braking.round(4).tolist()),
    )  # fmt: skip


def _margins(
    plant: DualTrack, loop: tuple[MPC, Profile], at: EstimatorAt, turn: tuple[float, float, float]
) -> Iterator[float] | None:
    """Modulus margin at each of `BRAKING_SHARES`; turn: m/s, friction, m/s^2 sideways. None without such a turn."""
    (mpc, world), (speed, mu, lateral) = loop, turn
    try:
        first = Steady.of(plant, speed, mu, lateral)
    except InvalidInput:
        return None
    # gains follow the forces, and those the turn: braking has only begun
    estimator = at.with_turn_gains(first.measured(plant, mpc.period), first.steering)
    law = laws(mpc, speed, mpc.tuning.as_array(), estimator)

    def margin(share: float) -> float:
        try:
            steady = Steady.of(plant, speed, mu, lateral, share * mu * GRAVITY) if share > 0.0 else first
        except InvalidInput:
            return BEYOND
        return float(modulus_margin(sampled_about(plant, mpc.period, steady, world), law, _ANGLES)[0])

    return map(margin, BRAKING_SHARES)


def _braking(margins: Iterable[float], least: Sequence[float]) -> float:
    """Deceleration over mu g at which the margin falls below the least; below 0 where it is less without braking."""
    before, holdable = 0.0, 0.0
    for share, margin, bound in zip(BRAKING_SHARES, margins, least, strict=True):
        over = margin - bound
        if over < 0.0:
            return max(over, BEYOND) if share == 0.0 else before + (share - before) * holdable / (holdable - over)
        before, holdable = share, over
    return BRAKING_SHARES[-1]


def _lasting(speed: float, braking: float, longest: float) -> float:
    """How long (s) the instability of braking (m/s^2) counts: it falls with the speed (m/s), to nothing at the half."""
    return min(0.25 * speed / braking, longest) if braking > 0.0 else longest


def borne(room: float, time: float, period: float) -> float:
    """Modulus margin, 0 or less, of a loop in which deviations grow by a factor of `room` in a time (s).

    With a spectral radius rho over a control period T (s) they grow by rho^(t/T); the margin of an unstable loop is
    -10 (rho - 1), see `stability.modulus_margin`.
    """
    return -10.0 * math.expm1(math.log(max(room, 1.0)) * period / time)


def top_speed(car: Vehicle) -> float:
    """The highest speed (m/s) that the car's power holds on a level road."""
    v = np.linspace(1.0, MAX_SPEED.most, 397)
    air = 0.5 * car.air_density * car.frontal_area * car.drag_coefficient * v**2
    holdable = np.minimum(car.traction_limit, car.engine_power / v) >= air + car.rolling_resistance * car.mass * GRAVITY
    return float(v[holdable].max(initial=1.0))

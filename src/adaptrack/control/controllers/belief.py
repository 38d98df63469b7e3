"""What an informed controller believes of its car's steering, and who says so."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Annotated, Literal, NamedTuple

from adaptrack.base.checked import Finite, checked, within
from adaptrack.base.errors import InvalidInput
from adaptrack.cars.vehicle import Steering, Vehicle
from adaptrack.control.controllers.base import LEAST_STEERING_RATE, MOST_STEERING_DELAY
from adaptrack.control.controllers.limits import Limits
from adaptrack.control.kalman import Drifts
from adaptrack.scenario.profile import Profile

ASSUMED = "nobody says, so the slow end of published values"
"""The source of what neither the caller, nor the car file, nor a profile says."""
TO_LEARN = "nobody says, so it is learned from the middle of published values"
"""The same of lag and dead time, for a controller that learns."""
UNKNOWN: Literal["unknown"] = "unknown"
"""As `belief`: neither the car's file nor the profile is to be believed about the steering."""
LEAST_LAG = 0.05
"""s, believed at least where only the dead time is known."""
_NAMES = {"lag": "s", "dead_time": "s", "computation": "s", "rate": "rad/s", "limit": "rad"}
QUANTILE, TOLERATED_DELAY, MOST_CAUTION, USUAL_RATE = 0.95, 0.018, 16.0, 0.5
"""Of what a delay may be, the share that is not above what is believed; s, an error of the delay that doubles R; the
largest factor on R for it; rad/s, steering rate."""

WIDE, STIFFNESS_DRIFTS = 1.6, (3.0, 5.0)
"""Factor of the stiffness; by which, at it, the drifts of the disturbances are divided and that of sliding multiplied:
the best of 12 settings on 16 drives of each of six cars in `production`, known by mass and wheelbase alone."""
MOST_DELAY, MOST_STIFFNESS, MOST_MASS = 1.0, 4.0, 0.9
"""Largest uncertainties: s, of a delay; -, factor of the stiffness; -, share of the mass."""
_FACTORS = ("mass", "yaw_inertia", "stiffness_front", "stiffness_rear")


def car_file(vehicle: Vehicle) -> str:
    """The source of what a car's file says."""
    return f"car file {vehicle.name}"


@checked
@dataclass(frozen=True)
class Uncertainty:
    """How far what is believed of the car may be wrong: by so much to either side.

    A delay that is believed too short loses the car, one that is believed too long costs little. So the controller
    believes the `QUANTILE` of what lag and dead time may be, its filter lets the wheels be where the model does not
    expect them, and the moves weigh more.
    """

    lag: Annotated[Finite, within(0.0, MOST_DELAY), "s"] = 0.0
    """of the steering's lag"""
    dead_time: Annotated[Finite, within(0.0, MOST_DELAY), "s"] = 0.0
    """of its dead time"""
    stiffness: Annotated[Finite, within(1.0, MOST_STIFFNESS)] = 1.0
    """factor by which the cornering stiffness of an axle may be larger or smaller"""
    mass: Annotated[Finite, within(0.0, MOST_MASS)] = 0.0
    """share by which mass and yaw inertia may be larger or smaller"""

    def late(self, half: float) -> float:
        """What is added to a delay (s) that may be wrong by `half` (s), all values being equally likely."""
        return (2.0 * QUANTILE - 1.0) * half

    @property
    def caution(self) -> float:
        """By which R is multiplied."""
        delay = math.hypot(self.lag, self.dead_time) / TOLERATED_DELAY
        return min(1.0 + delay**2, MOST_CAUTION) * self.stiffness * (1.0 + self.mass)

    def widened(self, drifts: Drifts, measures_vy: bool = True) -> Drifts:
        """Drifts of the filter where the belief may be wrong; measures_vy: whether the lateral velocity is measured.

        A delay that is wrong puts the wheels elsewhere, by the steering rate times it. A stiffness that is wrong makes
        an error with the axle's force, as sliding does. Disturbances that follow it quickly close a loop of their own,
        which is unstable where nothing measures the lateral velocity: there they are followed more slowly, and the
        forces are trusted less, by `STIFFNESS_DRIFTS` at a factor of `WIDE` and by less below it.
        """
        unknown = USUAL_RATE * (self.lag + self.dead_time)
        found = replace(drifts, wheel_angle=math.hypot(drifts.wheel_angle, unknown))
        if measures_vy:
            return found
        share = min(math.log(self.stiffness) / math.log(WIDE), 1.0)
        slower, wilder = (factor**share for factor in STIFFNESS_DRIFTS)
        changes = {name: getattr(found, name) / slower for name in ("side", "turn", "wind")}
        return replace(found, **changes, sliding=found.sliding * wilder)

    @classmethod
    def of_car(cls, vehicle: Vehicle, belief: Belief) -> Uncertainty:
        """What a car's file says in ``[known_within]``; none where it says nothing.

        Of lag and dead time only where the belief has them from the car's file as well.
        """
        said = vehicle.known_within
        if said is None:
            return cls()
        factors = {name: getattr(said, name) or 1.0 for name in _FACTORS}
        delays = {
            name: min(getattr(said, f"steering_{name}") or 0.0, MOST_DELAY)
            for name in ("lag", "dead_time")
            if getattr(belief, name).source == car_file(vehicle)
        }
        stiffness = max(factors["stiffness_front"], factors["stiffness_rear"])
        mass = max(factors["mass"], factors["yaw_inertia"]) - 1.0
        return cls(**delays, stiffness=min(stiffness, MOST_STIFFNESS), mass=min(mass, MOST_MASS))

    @classmethod
    def declared(cls, uncertainty: Uncertainty | None) -> Uncertainty:
        """The uncertainty that the caller gives; none where there is none."""
        if uncertainty is None:
            return cls()
        if not isinstance(uncertainty, Uncertainty):
            raise InvalidInput(f"uncertainty = {uncertainty!r}: must be an Uncertainty(lag=..., dead_time=...).")
        return uncertainty


class Said(NamedTuple):
    """A number, and who says it."""

    value: float
    source: str


@dataclass(frozen=True)
class Belief:
    """The steering as a controller believes it; every entry has a `value` and its `source`."""

    lag: Said
    """s, time constant of the first-order lag"""
    dead_time: Said
    """s, from a command until the wheels begin to move"""
    computation: Said
    """s, from a measurement until its command is given"""
    rate: Said
    """rad/s, fastest change of the angle; inf: no limit"""
    limit: Said
    """rad, largest angle to either side"""

    @property
    def delay(self) -> float:
        """From an instant until its command begins to act (s): computation and dead time."""
        return self.computation.value + self.dead_time.value

    @property
    def assumed(self) -> tuple[str, ...]:
        """The entries that nobody says."""
        return tuple(name for name in _NAMES if getattr(self, name).source in (ASSUMED, TO_LEARN))

    @property
    def is_cautious(self) -> bool:
        """Whether the delay of the steering, lag or dead time, is assumed."""
        return bool({"lag", "dead_time"} & set(self.assumed))

    def later(self, unsure: Uncertainty) -> Belief:
        """The belief with lag and dead time as long as they may be."""
        return replace(
            self,
            lag=self.lag._replace(value=self.lag.value + unsure.late(unsure.lag)),
            dead_time=self.dead_time._replace(value=self.dead_time.value + unsure.late(unsure.dead_time)),
        )

    def bounds(self, period: float) -> Limits:
        """Limits on the command: on its change the rate times a period (s), on its size the limit.

        The next command may be ahead of the wheels by the rate times lag and period: so far they follow within the
        rate.

        Behind a delay that is assumed, thus probably too long, bounded moves lose the car: the change has then the
        bound of the paper's table, as it has where there is no rate limit.
        """
        bounded = math.isfinite(self.rate.value) and not self.is_cautious
        fastest = self.rate.value * period if bounded else Limits().move[1]
        ahead = self.rate.value * (self.lag.value + period) if bounded else 0.0
        return Limits(move=(-fastest, fastest), ahead=ahead, angle=(-self.limit.value, self.limit.value))

    def __str__(self) -> str:
        parts: dict[str, list[str]] = {}
        for name, unit in _NAMES.items():
            said: Said = getattr(self, name)
            text = f"{said.value:.4g} {unit}" if math.isfinite(said.value) else "without limit"
            parts.setdefault(said.source, []).append(f"{name.replace('_', ' ')} {text}")
        return "; ".join(f"{', '.join(entries)} ({source})" for source, entries in parts.items())


GivenSteering = Steering | Literal["unknown"] | None
"""What a caller says of the steering: None leaves it to the car's file, and to the profile unless it is learned."""


def believed(vehicle: Vehicle, given: GivenSteering, profile: Profile, period: float, named: bool) -> Belief:
    """The belief about a car's steering: each number from the first that says it, `ASSUMED` where nobody does.

    given: by the caller, who comes first, then the car file, then the profile; `UNKNOWN`: nobody says anything; named:
    whether the profile's actuator is believed: not where only its sensors are taken by default, nor by a controller
    that learns, for which a profile is the simulated world.

    Raises
    ------
    InvalidInput
        When `given` is no `Steering`.
    """
    if not (isinstance(given, Steering | None) or given == UNKNOWN):
        raise InvalidInput(
            f"belief = {given!r}: must be a Steering(lag=..., dead_time=..., rate=..., limit=...), or {UNKNOWN!r}."
        )
    where = f"profile {profile.name}"
    actuator = {"lag": profile.steering.lag, "dead_time": profile.steering.dead_time, "rate": profile.steering.rate}
    actuator["limit"] = min(profile.steering.limit, Limits().angle[1])
    said: dict[str, Said] = {}
    for source, section in (("given", given), (car_file(vehicle), vehicle.steering)):
        for name in actuator:
            value = getattr(section, name, None)
            if value is not None:
                said.setdefault(name, Said(value, source))
    if given == UNKNOWN:
        said = {}
    elif named:
        said = {name: Said(value, where) for name, value in actuator.items()} | said
    return Belief(computation=Said(profile.delay * period, where), **{**_slow(said), **said})


def _slow(said: dict[str, Said]) -> dict[str, Said]:
    """The slow end of published values for each entry; what is said of lag or dead time is taken off the other."""
    lag, dead_time = (said[name].value if name in said else 0.0 for name in ("lag", "dead_time"))
    slow = {
        "lag": max(MOST_STEERING_DELAY - dead_time, LEAST_LAG),
        "dead_time": max(MOST_STEERING_DELAY - lag, 0.0) if "lag" in said else 0.0,
        "rate": LEAST_STEERING_RATE,
        "limit": Limits().angle[1],
    }
    return {name: Said(value, ASSUMED) for name, value in slow.items()}

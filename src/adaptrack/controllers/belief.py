"""What an informed controller believes of its car's steering, and who says so."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from adaptrack.controllers.base import LEAST_STEERING_RATE, MOST_STEERING_DELAY
from adaptrack.controllers.limits import Limits
from adaptrack.errors import InvalidInput
from adaptrack.profile import Profile
from adaptrack.vehicle import Steering, Vehicle

ASSUMED = "nobody says, so the slow end of published values"
"""The source of what neither the caller, nor the car file, nor a profile says."""
LEAST_LAG = 0.05
"""s, believed at least where only the dead time is known."""
_NAMES = {"lag": "s", "dead_time": "s", "computation": "s", "rate": "rad/s", "limit": "rad"}


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
        return tuple(name for name in _NAMES if getattr(self, name).source == ASSUMED)

    @property
    def is_cautious(self) -> bool:
        """Whether the delay of the steering, lag or dead time, is assumed."""
        return bool({"lag", "dead_time"} & set(self.assumed))

    def bounds(self, period: float) -> Limits:
        """Limits on the command: on its change the rate times a period (s), on its size the limit.

        The next command may lead the wheels by rate times lag, up to which the lag is linear.

        Behind a delay that is assumed, thus probably too long, bounded moves lose the car: the change has then the
        bound of the paper's table, as it has where there is no rate limit.
        """
        bounded = math.isfinite(self.rate.value) and not self.is_cautious
        fastest = self.rate.value * period if bounded else Limits().move[1]
        ahead = self.rate.value * self.lag.value if bounded else 0.0
        return Limits(move=(-fastest, fastest), ahead=ahead, angle=(-self.limit.value, self.limit.value))

    def __str__(self) -> str:
        parts: dict[str, list[str]] = {}
        for name, unit in _NAMES.items():
            said: Said = getattr(self, name)
            text = f"{said.value:.4g} {unit}" if math.isfinite(said.value) else "without limit"
            parts.setdefault(said.source, []).append(f"{name.replace('_', ' ')} {text}")
        return "; ".join(f"{', '.join(entries)} ({source})" for source, entries in parts.items())


def believed(vehicle: Vehicle, told: Steering | None, profile: Profile, period: float, named: bool) -> Belief:
    """The belief about a car's steering: each number from the first that says it, `ASSUMED` where nobody does.

    told: by the caller, who comes first, then the car file, then the profile; named: whether the profile was, or is
    only the one whose sensors are taken by default: then its actuator says nothing.

    Raises
    ------
    InvalidInput
        When `told` is no `Steering`.
    """
    if not isinstance(told, Steering | None):
        raise InvalidInput(f"belief = {told!r}: must be a Steering(lag=..., dead_time=..., rate=..., limit=...).")
    where = f"profile {profile.name}"
    actuator = {"lag": profile.steering.lag, "dead_time": profile.steering.dead_time, "rate": profile.steering.rate}
    actuator["limit"] = min(profile.steering.limit, Limits().angle[1])
    said: dict[str, Said] = {}
    for source, section in (("told", told), (f"car file {vehicle.name}", vehicle.steering)):
        for name in actuator:
            value = getattr(section, name, None)
            if value is not None:
                said.setdefault(name, Said(value, source))
    if named:
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

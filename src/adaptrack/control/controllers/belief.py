"""What an informed controller believes of its car's steering, and who says so."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Any, Literal, NamedTuple

from adaptrack.base.checked import Finite, checked, within
from adaptrack.base.errors import InvalidInput
from adaptrack.cars.vehicle import Steering, Vehicle
from adaptrack.control.controllers.limits import Limits
from adaptrack.control.kalman import Drifts
from adaptrack.core.synthesis import belief as kernel
from adaptrack.core.synthesis.car import Steering as SteeringRow
from adaptrack.core.synthesis.rows import row_of
from adaptrack.scenario.profile import Profile

ASSUMED = "nobody says, so the slow end of published values"
"""The source of what neither the caller, nor the car file, nor a profile says."""
TO_LEARN = "nobody says, so it is learned from the middle of published values"
"""The same of lag and dead time, for a controller that learns."""
AT_ONCE = "default"
"""The source of a computation time that neither the caller nor a profile specifies: 0 s."""
MOST_COMPUTATION = 1.0
"""s, longest computation time that a controller takes."""
UNKNOWN: Literal["unknown"] = "unknown"
"""As `belief`: neither the car's file nor the profile is to be believed about the steering."""
_NAMES = {"lag": "s", "dead_time": "s", "computation": "s", "rate": "rad/s", "limit": "rad"}
_STEERING = ("lag", "dead_time", "rate", "limit")
_SOURCES = {ASSUMED: kernel.ASSUMED, TO_LEARN: kernel.TO_LEARN}


def car_file(vehicle: Vehicle) -> str:
    """The source of what a car's file says."""
    return f"car file {vehicle.name}"


@checked
@dataclass(frozen=True)
class Uncertainty:
    """How far what is believed of the car may be wrong: by so much to either side.

    A delay that is believed too short loses the car, one that is believed too long costs little. So the controller
    believes a quantile of what lag and dead time may be (`core.synthesis.belief`), its filter lets the wheels be where
    the model does not expect them, and the moves weigh more.
    """

    lag: Annotated[Finite, within(0.0, kernel.MOST_DELAY), "s"] = 0.0
    """of the steering's lag"""
    dead_time: Annotated[Finite, within(0.0, kernel.MOST_DELAY), "s"] = 0.0
    """of its dead time"""
    stiffness: Annotated[Finite, within(1.0, kernel.MOST_STIFFNESS)] = 1.0
    """factor by which the cornering stiffness of an axle may be larger or smaller"""
    mass: Annotated[Finite, within(0.0, kernel.MOST_MASS)] = 0.0
    """share by which mass and yaw inertia may be larger or smaller"""

    @property
    def numbers(self) -> Any:
        """A row of `core.synthesis.belief.Uncertainty`."""
        return row_of(kernel.Uncertainty, self)

    @property
    def caution(self) -> float:
        """By which R is multiplied."""
        return float(kernel.caution_of(self.numbers))

    def widened(self, drifts: Drifts, measures_vy: bool = True) -> Drifts:
        """Drifts of the filter where the belief may be wrong, see `core.synthesis.belief.widen_drifts`.

        measures_vy: whether the lateral velocity is measured.
        """
        found = drifts.numbers
        kernel.widen_drifts(self.numbers, measures_vy, found)
        return Drifts.of(found)

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

    @property
    def numbers(self) -> Any:
        """A row of `core.synthesis.belief.Belief`, whose sources say what is assumed."""
        row = row_of(kernel.Belief, **{name: getattr(self, name).value for name in _NAMES})
        for name in _STEERING:
            row[f"{name}_source"] = _SOURCES.get(getattr(self, name).source, kernel.GIVEN)
        return row

    def bounds(self, period: float) -> Limits:
        """Limits on the command at a control period (s), see `core.synthesis.belief.bound_commands`."""
        found = row_of(kernel.Bounds)
        kernel.bound_commands(self.numbers, period, found)
        return limits_of(found)

    def __str__(self) -> str:
        parts: dict[str, list[str]] = {}
        for name, unit in _NAMES.items():
            said: Said = getattr(self, name)
            text = f"{said.value:.4g} {unit}" if math.isfinite(said.value) else "without limit"
            parts.setdefault(said.source, []).append(f"{name.replace('_', ' ')} {text}")
        return "; ".join(f"{', '.join(entries)} ({source})" for source, entries in parts.items())


GivenSteering = Steering | Literal["unknown"] | None
"""What a caller says of the steering: None leaves it to the car's file, and to the profile unless it is learned."""


def assumed_computation(seconds: float | None, profile: Profile, period: float, named: bool) -> Said:
    """Computation time (s) of a controller: the caller's, that of a named profile, or 0.

    seconds: the caller's, None if not specified; period: control period (s); named: whether the caller named the
    profile.
    """
    if seconds is not None:
        return Said(float(seconds), "given")
    return Said(profile.delay * period, f"profile {profile.name}") if named else Said(0.0, AT_ONCE)


def believed(vehicle: Vehicle, given: GivenSteering, profile: Profile, computation: Said, named: bool) -> Belief:
    """The belief about a car's steering: each number from the first that says it, `ASSUMED` where nobody does.

    given: by the caller, who comes first, then the car file, then the profile; `UNKNOWN`: nobody says anything;
    computation: `assumed_computation`; named: whether the profile's actuator is believed: not where only its sensors
    are taken by default, nor by a controller that learns, for which a profile is the simulated world.

    Raises
    ------
    InvalidInput
        When `given` is no `Steering`.
    """
    given, car, actuator = known_steering(vehicle, given, profile, named)
    found = row_of(kernel.Belief)
    kernel.believe_steering(given, car, actuator, computation.value, found)
    return belief_of(found, vehicle, profile, computation)


def known_steering(vehicle: Vehicle, given: GivenSteering, profile: Profile, named: bool) -> tuple[Any, Any, Any]:
    """What the caller, the car file and the profile say of a steering: rows of `core.synthesis.car.Steering`.

    Raises
    ------
    InvalidInput
        When `given` is no `Steering`.
    """
    if not (isinstance(given, Steering | None) or given == UNKNOWN):
        raise InvalidInput(
            f"belief = {given!r}: must be a Steering(lag=..., dead_time=..., rate=..., limit=...), or {UNKNOWN!r}."
        )
    nobody = given == UNKNOWN
    most = min(profile.steering.limit, kernel.ANGLE)
    return (
        row_of(SteeringRow, None if nobody else given), row_of(SteeringRow, None if nobody else vehicle.steering),
        row_of(SteeringRow, profile.steering, limit=most) if named and not nobody else row_of(SteeringRow),
    )  # fmt: skip


def belief_of(row: Any, vehicle: Vehicle, profile: Profile, computation: Said, seconds: float = 0.0) -> Belief:
    """The belief of a row of `core.synthesis.belief.Belief`; seconds: for which an earlier drive has learned."""
    names = {
        kernel.GIVEN: "given", kernel.CAR_FILE: car_file(vehicle), kernel.PROFILE: f"profile {profile.name}",
        kernel.LEARNED: f"learned before, in {seconds:.0f} s", **{code: name for name, code in _SOURCES.items()},
    }  # fmt: skip
    steering = {name: Said(float(row[name]), names[int(row[f"{name}_source"])]) for name in _STEERING}
    return Belief(**steering, computation=computation)


def limits_of(bounds: Any) -> Limits:
    """The limits of a row of `core.synthesis.belief.Bounds`."""
    move, ahead, angle = bounds.tolist()
    return Limits(move=(-move, move), ahead=ahead, angle=(-angle, angle))

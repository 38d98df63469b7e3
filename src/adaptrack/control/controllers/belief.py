"""The steering that an informed controller assumes, the source of each value, and its uncertainty."""

from __future__ import annotations

import math
from dataclasses import make_dataclass
from typing import Any, Literal, NamedTuple

from adaptrack.cars.vehicle import Steering, Vehicle
from adaptrack.control.controllers.limits import Limits
from adaptrack.control.settings import RecordSettings
from adaptrack.core.kernel import Field, row_of
from adaptrack.core.models.car import ACTUATOR_DEAD_TIME, ACTUATOR_LAG, ACTUATOR_LIMIT, ACTUATOR_RATE, STEERING
from adaptrack.core.models.car import SteeringRow as SteeringRow
from adaptrack.core.synthesis import belief as kernel
from adaptrack.scenario.profile import Profile

ASSUMED_SOURCE = "not given; a slow published value is assumed"
"""Source of a value that neither the caller, nor the car file, nor a profile gives."""
TO_LEARN_SOURCE = "not given; learning starts at the published median"
"""Source of an unknown lag or dead time of a controller that learns."""
DEFAULT = "default"
"""Source of a computation time that neither the caller nor a profile specifies: 0 s."""
MOST_COMPUTATION = 1.0
"""s, longest computation time that a controller takes."""
UNKNOWN: Literal["unknown"] = "unknown"
"""As `belief`: ignore what the car file and the profile say about the steering."""
_COMPUTATION = Field("computation", "s", 0.0, "from a measurement until its command is given")
_ENTRIES = (ACTUATOR_LAG, ACTUATOR_DEAD_TIME, _COMPUTATION, ACTUATOR_RATE, ACTUATOR_LIMIT)
_SOURCES = {ASSUMED_SOURCE: kernel.SLOW_ASSUMED, TO_LEARN_SOURCE: kernel.MEDIAN_TO_LEARN}


def car_file(vehicle: Vehicle) -> str:
    """Source of a value from the car file."""
    return f"car file {vehicle.name}"


class Uncertainty(RecordSettings, record=kernel.UncertaintyRow):
    """How far the assumed car may be wrong, to either side.

    A delay that is assumed too short loses the car, one that is assumed too long costs little. So the controller
    assumes a quantile of lag and dead time (`core.synthesis.belief`), its filter lets the wheels deviate from the
    model, and the moves weigh more.
    """

    @property
    def caution(self) -> float:
        """By which R is multiplied."""
        return float(kernel.caution_of(self.row))


class SourcedValue(NamedTuple):
    """A number and its source."""

    value: float
    source: str


_BeliefEntries: Any = make_dataclass("_BeliefEntries", [(field.name, SourcedValue) for field in _ENTRIES], frozen=True)


class Belief(_BeliefEntries):  # type: ignore[misc]
    """The steering that a controller assumes; each entry has a `value` and its `source`.

    lag, dead_time, rate and limit as in `core.models.car`, a rate of inf: no limit; computation: s, from a measurement
    until its command is given.
    """

    @property
    def steering(self) -> dict[str, float]:
        """The assumed numbers of the steering by name."""
        return {field.name: getattr(self, field.name).value for field in STEERING}

    @property
    def delay(self) -> float:
        """From an instant until its command begins to act (s): computation and dead time."""
        return float(self.computation.value + self.dead_time.value)

    @property
    def assumed(self) -> tuple[str, ...]:
        """The names of the unknown entries."""
        unknown = (ASSUMED_SOURCE, TO_LEARN_SOURCE)
        return tuple(field.name for field in _ENTRIES if getattr(self, field.name).source in unknown)

    @property
    def row(self) -> Any:
        """A row of `core.synthesis.belief.BeliefRow`, whose sources tell what is assumed."""
        row = kernel.BeliefRow.new(1, computation=self.computation.value)[0]
        for name, value in self.steering.items():
            row.steering[name], row.source[name] = value, _SOURCES.get(getattr(self, name).source, kernel.GIVEN)
        return row

    def bounds(self, period: float) -> Limits:
        """Limits on the command at a control period (s), see `core.synthesis.belief.bound_commands`."""
        bounds = row_of(kernel.CommandBounds)
        kernel.bound_commands(self.row, period, bounds)
        return limits_of(bounds)

    def __str__(self) -> str:
        parts: dict[str, list[str]] = {}
        for field in _ENTRIES:
            entry: SourcedValue = getattr(self, field.name)
            text = f"{entry.value:.4g} {field.unit}" if math.isfinite(entry.value) else "without limit"
            parts.setdefault(entry.source, []).append(f"{field.name.replace('_', ' ')} {text}")
        return "; ".join(f"{', '.join(entries)} ({source})" for source, entries in parts.items())


GivenSteering = Steering | Literal["unknown"] | None
"""A caller's steering; None: that of the car file, then that of the profile unless it is learned."""


def assumed_computation(seconds: float | None, profile: Profile, period: float, uses_actuator: bool) -> SourcedValue:
    """Computation time (s) of a controller: the caller's, that of a named profile, or 0.

    seconds: the caller's, None if not specified; period: control period (s); uses_actuator: whether
    the caller named the profile.
    """
    if seconds is not None:
        return SourcedValue(float(seconds), "given")
    return (
        SourcedValue(profile.delay * period, f"profile {profile.name}") if uses_actuator else SourcedValue(0.0, DEFAULT)
    )


def steering_rows(
    vehicle: Vehicle, steering: GivenSteering, profile: Profile, uses_actuator: bool
) -> tuple[Any, Any, Any]:
    """The steering of the caller, of the car file and of the profile: rows of `core.models.car.SteeringRow`.

    uses_actuator: whether the profile's actuator counts: not where only its sensors are taken by default, nor for a
    controller that learns, for which a profile is the simulated world. `UNKNOWN` as steering: no source counts.
    """
    if steering == UNKNOWN:
        return row_of(SteeringRow), row_of(SteeringRow), row_of(SteeringRow)
    limit = min(profile.steering.limit, kernel.ANGLE)
    actuator = row_of(SteeringRow, profile.steering, limit=limit) if uses_actuator else row_of(SteeringRow)
    return row_of(SteeringRow, steering), row_of(SteeringRow, vehicle.steering), actuator


def belief_of(row: Any, vehicle: Vehicle, profile: Profile, computation: SourcedValue, seconds: float = 0.0) -> Belief:
    """The belief of a row of `core.synthesis.belief.BeliefRow`; seconds: duration of the drives that taught it."""
    sources = {
        kernel.GIVEN: "given", kernel.CAR_FILE: car_file(vehicle), kernel.PROFILE: f"profile {profile.name}",
        kernel.FROM_EARLIER_DRIVE: f"learned before, in {seconds:.0f} s",
        **{code: source for source, code in _SOURCES.items()},
    }  # fmt: skip
    steering = {
        name: SourcedValue(float(row.steering[name]), sources[int(row.source[name])]) for name in SteeringRow._fields
    }
    return Belief(**steering, computation=computation)


def limits_of(bounds: Any) -> Limits:
    """The limits of a row of `core.synthesis.belief.CommandBounds`."""
    move, ahead, angle = bounds.tolist()
    return Limits(move=(-move, move), ahead=ahead, angle=(-angle, angle))

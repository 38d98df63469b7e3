"""What an identification found: estimates with their intervals, a validation, and the car that follows."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from adaptrack.base.errors import InvalidInput
from adaptrack.cars.vehicle import BrakeActuator, DriveActuator, KnownWithin, PedalMap, Steering, Tyre, Vehicle
from adaptrack.core.maths.portable import Array
from adaptrack.core.physics.forces import GRAVITY
from adaptrack.identification.log import Log

HARDLY = 0.7
"""Share of the earlier spread that is left where a log says next to nothing."""
FACTOR_ESTIMATES = {"stiffness_front": "front", "stiffness_rear": "rear"}
"""Of a car file's numbers, the estimates that they come from."""
_MARGINS = ("steering_lag", "steering_dead_time")


@dataclass(frozen=True)
class Estimate:
    """One quantity: what the log says of it, and what was believed before."""

    name: str
    unit: str
    meaning: str
    value: float
    standard_error: float
    """in the unit of the value, corrected as `calibration.CORRECTIONS` says"""
    low: float
    """lower end of the 90 % interval"""
    high: float
    before: tuple[float, float]
    """90 % interval of what was believed before"""
    spread_left: float
    """share of the spread that was believed before which is left: near 1 the log says nothing"""
    shift: float = 0.0
    """standard deviations of what was believed before, from there to the value"""
    reach: float = 0.0
    """the same to the farther end of the interval"""

    def to_dict(self) -> dict[str, object]:
        """Return the content of ``--json``."""
        return {
            "value": self.value, "unit": self.unit, "standard_error": self.standard_error, "low": self.low,
            "high": self.high, "before": list(self.before), "spread_left": self.spread_left, "shift": self.shift,
        }  # fmt: skip

    @property
    def interval(self) -> str:
        """Name and 90 % interval, in words."""
        return f"{self.name}: {self.low:.4g} to {self.high:.4g} {self.unit}"


def scale_correlations(estimates: Mapping[str, Estimate], covariance: Array) -> dict[str, float]:
    """Correlations of the scale of the steering angle with the other estimates; none where it is not estimated.

    covariance: of the estimates in their order
    """
    names, sigma = list(estimates), np.sqrt(np.diag(covariance))
    if "angle_scale" not in names:
        return {}
    place = names.index("angle_scale")
    values = covariance[place] / np.maximum(sigma * sigma[place], 1e-300)
    return {name: float(value) for name, value in zip(names, values, strict=True) if name != "angle_scale"}


@dataclass(frozen=True, eq=False)
class DriveIdentification:
    """Drive, brakes and resistance of a car as identified from logs of commands and the speed."""

    estimates: Mapping[str, Estimate]
    """with 90 % intervals; drive and brakes only where they act in the log"""
    findings: tuple[str, ...]
    """in words: what limits what is known"""
    believed: Vehicle
    """the car before the log"""
    command: str
    """``force_command``, ``acceleration_command`` or ``pedals``"""
    seconds: float
    """of driving in which the speed was compared"""
    pedals: PedalMap | None = None
    """where the logs have pedals instead of a command"""

    @property
    def car(self) -> Vehicle:
        """The car with its sections ``[drive]`` and ``[brakes]``, and what the log tells of resistance and pedals."""
        return self.added_to(self.believed)

    def added_to(self, car: Vehicle) -> Vehicle:
        """A car with these drive, brakes and resistance."""
        value = {name: float(f"{estimate.value:.5g}") for name, estimate in self.estimates.items()}
        changes: dict[str, Any] = {}
        sections: Sequence[tuple[str, str, type[DriveActuator | BrakeActuator]]] = (
            ("drive", "drive", DriveActuator), ("brake", "brakes", BrakeActuator),
        )  # fmt: skip
        for name, section, kind in sections:
            if f"{name}_gain" in value:
                parts = {part: value[f"{name}_{part}"] for part in ("lag", "dead_time", "gain")}
                changes[section] = (getattr(car, section) or kind()).replace(**parts)
        area = 0.5 * car.air_density * car.frontal_area / car.mass
        if self._tells("drag") and area > 0.0:
            changes["drag_coefficient"] = float(f"{max(value['drag'], 0.0) / area:.4g}")
        if self._tells("rolling"):
            changes["rolling_resistance"] = float(f"{max(value['rolling'], 0.0) / GRAVITY:.4g}")
        if self.pedals is not None:
            changes["pedals"] = self.pedals
        return car.replace(**changes)

    def _tells(self, name: str) -> bool:
        """Whether the log tells a resistance: behind an acceleration command some of it may be compensated."""
        return self.command == "force_command" and self.estimates[name].spread_left < HARDLY

    @property
    def comments(self) -> list[str]:
        """Lines of a car file: intervals and findings."""
        return [*(estimate.interval for estimate in self.estimates.values()), *self.findings]

    def to_toml(self, path: str | os.PathLike[str]) -> None:
        """Write the car as TOML, with intervals in comments; it gets the file's name.

        Raises StorageError when the file cannot be written.
        """
        self.car.to_toml(path, ["Drive and brakes identified from a log; 90 % intervals:", *self.comments])

    def to_dict(self) -> dict[str, object]:
        """Return the content of ``--json``."""
        return {
            "estimates": {name: estimate.to_dict() for name, estimate in self.estimates.items()},
            "findings": list(self.findings), "command": self.command, "seconds": self.seconds,
            "pedals": None if self.pedals is None else self.pedals.model_dump(),
        }  # fmt: skip


@dataclass(frozen=True)
class Validation:
    """How well the yaw rate is predicted on stretches that the fit did not see."""

    one_step: float
    """share of the variance that one-step predictions explain (1 is all)"""
    simulated: float
    """Share of the yaw rate's variance explained by a simulation from the command alone."""
    held_out: float
    """s, in all"""
    autocorrelation: tuple[float, ...]
    """of the fit's normalised innovations of the yaw rate, at lags 1 to 5"""


@dataclass(frozen=True, eq=False)
class Series:
    """Signals along the log for pictures, (n,) each."""

    time: Array
    measured: Array
    """Measured yaw rate (rad/s)."""
    simulated: Array
    """rad/s, from the command alone, begun anew at every segment"""
    innovations: Array
    """-, one-step errors of the yaw rate over their standard deviation"""
    held_out: NDArray[np.bool_]
    wheel_angle: Array
    """rad, of the road wheels as the fit has them"""


@dataclass(frozen=True, eq=False)
class Identification:
    """Result of `identify`: estimates with intervals, validation and the car file."""

    estimates: Mapping[str, Estimate]
    covariance: Array
    """of `estimates` in their order, logarithms for what is positive, (m, m)"""
    validation: Validation
    findings: tuple[str, ...]
    """in words: what the log shows, what it does not"""
    log: Log
    believed: Vehicle
    """the car before the log"""
    tyre_curve: Tyre
    """the tyre whose curve the car keeps"""
    computation: float
    """s, of the log's dead time, that is the controller's"""
    series: Series = field(repr=False)
    reasons: tuple[str, ...] = ()
    """in words: why it is not to be trusted; see `consistent`"""
    alone: tuple[Identification, ...] = field(default=(), repr=False)
    """of several logs, what each says by itself; `log`, `validation` and `series` are those of the longest"""

    drive: DriveIdentification | None = None
    """drive, brakes and resistance, where the logs have commands of acceleration or force"""

    @property
    def consistent(self) -> bool:
        """Whether the estimates fit what was believed, physics, and each other from stretch to stretch, log to log."""
        return not self.reasons

    def __getitem__(self, name: str) -> Estimate:
        """An estimate by its name."""
        return self.estimates[name]

    @property
    def car(self) -> Vehicle:
        """The car as the log has it: stiffness, l_f, steering; the rest, such as the yaw inertia, as believed."""
        value = {name: estimate.value for name, estimate in self.estimates.items()}
        steering = self.believed.steering or Steering()
        if self.log.commanded:
            dead_time = max(value["dead_time"] - self.computation, 0.0)
            steering = steering.replace(lag=value["lag"], dead_time=dead_time)
        if "rate" in value and self.estimates["rate"].spread_left < HARDLY:
            steering = steering.replace(rate=value["rate"])
        if "ratio" in value:
            steering = steering.replace(ratio=value["ratio"])
        elif self.log.ratio != 1.0 and "angle_scale" in value and self.estimates["angle_scale"].spread_left < HARDLY:
            steering = steering.replace(ratio=self.log.ratio * value["angle_scale"])
        believed = self.believed if self.drive is None else self.drive.added_to(self.believed)
        return believed.replace(
            stiffness_front=0.5 * value["front"], stiffness_rear=0.5 * value["rear"],
            lf=value["lf"], lr=self.believed.wheelbase - value["lf"],
            steering=steering if steering != Steering() else None,
        )  # fmt: skip

    @property
    def tyre(self) -> Tyre:
        """The believed car's tyre, scaled to the axle stiffness of `car` at its static loads; its curve is kept."""
        car, curve = self.car, self.tyre_curve
        front, rear = curve.stiffness_at(*car.static_loads)
        relaxation = self.estimates.get("relaxation")
        if relaxation is not None:
            curve = curve.replace(relaxation_length=min(relaxation.value, 10.0))
        return curve.replace(
            stiffness_front=curve.stiffness_front * car.stiffness_front / front,
            stiffness_rear=curve.stiffness_rear * car.stiffness_rear / rear,
        )

    def known_within(self) -> KnownWithin:
        """The 90 % intervals of what the log says, and what was known of the car before: for its file."""
        before = self.car.known_within or KnownWithin()
        factors = {
            name: max(estimate.high / estimate.value, estimate.value / estimate.low)
            for name, estimate in ((key, self.estimates[of]) for key, of in FACTOR_ESTIMATES.items())
            if estimate.low > 0.0
        }
        if self.log.commanded:
            for name in _MARGINS:
                delay = self.estimates[name.removeprefix("steering_")]
                factors[name] = max(delay.high - delay.value, delay.value - delay.low)
        if "ratio" in self.estimates:
            factors["steering_ratio"] = self.estimates["ratio"].high / self.estimates["ratio"].value
        limits = {name: min(value, 1.0 if name in _MARGINS else 10.0) for name, value in factors.items()}
        return before.replace(**{name: float(f"{value:.4g}") for name, value in limits.items()})

    def to_toml(self, path: str | os.PathLike[str], anyway: bool = False) -> None:
        """Write the car as TOML, and beside it its tyre (``-tyre`` behind the name), so that a plant has its stiffness.

        The car gets the file's name. Intervals stand in ``[known_within]`` and in comments. anyway: also when it is not
        `consistent`.

        Raises
        ------
        InvalidInput
            When it is not `consistent`; the message says why.
        StorageError
            When the file cannot be written.
        """
        if self.reasons and not anyway:
            raise InvalidInput(
                f"{os.fspath(path)}: not written, the identification is not consistent: {'; '.join(self.reasons)}. "
                "anyway=True (--anyway) writes it all the same."
            )
        tolerances, path = self.known_within(), Path(path)
        tyre_path = path.with_name(f"{path.stem}-tyre.toml")
        tyre_name = f"{self.tyre_curve.name}, scaled to the axles of {path.stem}"
        self.tyre.replace(name=tyre_path.stem, description=tyre_name).to_toml(tyre_path)
        car = self.car.replace(
            description="Identified from a log", tyre=str(tyre_path), known_within=tolerances,
            estimated=tuple(name for name in self.car.estimated if name not in FACTOR_ESTIMATES),
        )  # fmt: skip
        head = ["Identified from a log; 90 % intervals:", *(estimate.interval for estimate in self.estimates.values())]
        if self.computation:
            head.append(f"steering.dead_time is without {self.computation:g} s of the controller's computation")
        head += [f"not consistent: {reason}" for reason in self.reasons]
        head += [*self.findings, *(self.drive.comments if self.drive is not None else ())]
        car.to_toml(path, head)

    def to_dict(self) -> dict[str, object]:
        """Return the content of ``--json``."""
        return {
            "estimates": {name: estimate.to_dict() for name, estimate in self.estimates.items()},
            "angle_scale_correlations": scale_correlations(self.estimates, self.covariance),
            "validation": {
                "one_step_vaf": self.validation.one_step, "simulated_vaf": self.validation.simulated,
                "held_out": self.validation.held_out, "autocorrelation": list(self.validation.autocorrelation),
            },
            "consistent": self.consistent,
            "reasons": list(self.reasons),
            "findings": list(self.findings),
            "log": {
                "samples": self.log.samples, "period": self.log.period, "driven": self.log.driven_time,
                "segments": self.log.segments, "notes": list(self.log.notes),
            },
            "computation": self.computation,
            "drive": None if self.drive is None else self.drive.to_dict(),
            "alone": [identification.to_dict() for identification in self.alone],
        }  # fmt: skip

"""Profiles: simulated steering, sensors and computation time of a car, and the weight of steering in the cost."""

from __future__ import annotations

import os
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from pydantic import Field, field_validator, model_validator

from adaptrack.base.files import FieldRecord, build, read_toml
from adaptrack.cars.vehicle import BrakeActuator, DriveActuator, SteeringActuator, find_data, list_data
from adaptrack.core.kernel import row_of
from adaptrack.core.maths import portable
from adaptrack.core.models.contract import SENSOR_FIELDS
from adaptrack.core.synthesis.tuning import ControllerWorld

_AGES_BY_SPREAD = {"pose_age_spread": ("pose_age", "station_age"), "motion_age_spread": ("motion_age", "speed_age")}
"""Ages to which each spread applies. The spread does not apply to the second age if this age is 0."""


class Profile(FieldRecord, fields=SENSOR_FIELDS, after="preview"):
    """Simulated steering actuator, sensors and computation time of a car, and the weight of steering in the cost.

    Each profile is one TOML file, see `load_profile`.
    """

    name: str = Field(min_length=1, description="name of the profile in lists and tables")
    description: str = Field(default="", description="one sentence for lists")
    steering: SteeringActuator = Field(
        default_factory=SteeringActuator.ideal, description="lag, dead time, bias and limits of the steering"
    )
    drive: DriveActuator = Field(
        default_factory=DriveActuator, description="response of the driving force, unless the car file has one"
    )
    brakes: BrakeActuator = Field(
        default_factory=BrakeActuator, description="response of the braking force, unless the car file has one"
    )
    period: float = Field(default=0.1, gt=0, le=10, description="s, default control period of the controllers")
    delay: float = Field(
        default=0.0,
        ge=0,
        description="-, computation time between a measurement and its command, in control periods: 0 or 1",
    )
    preview: bool = Field(default=False, description="default for whether controllers know the reference ahead")
    move_weight: float = Field(
        default=0.0,
        ge=0,
        description="m^2/rad^2, weight w of steering activity in J = mean e^2 + w mean (change of command)^2",
    )
    if TYPE_CHECKING:

        def __init__(self, **values: Any) -> None: ...

    @field_validator("delay")
    @classmethod
    def _whole_periods(cls, delay: float) -> float:
        if delay not in (0.0, 1.0):
            raise ValueError(
                "must be 0 (each command acts at once) or 1 (each command acts one control period later); "
                "give the delay of the steering as dead_time (s) in the section [steering]."
            )
        return delay

    @model_validator(mode="after")
    def _ages_and_dropouts_fit(self) -> Self:
        for spread, (name, second_name) in _AGES_BY_SPREAD.items():
            width, age, second_age = getattr(self, spread), getattr(self, name), getattr(self, second_name)
            if width > age:
                raise ValueError(f"{spread} = {width:g} s: must not exceed {name} = {age:g} s.")
            if width > second_age > 0.0:
                raise ValueError(f"{second_name} = {second_age:g} s: must be 0, or at least {spread} = {width:g} s.")
        if self.dropout_least > self.dropout_most:
            raise ValueError(f"dropout_least = {self.dropout_least:g} s: must not exceed dropout_most.")
        return self

    @property
    def oldest(self) -> float:
        """Largest age of a sample on arrival (s)."""
        return max(
            max(getattr(self, name) for name in names) + getattr(self, spread)
            for spread, names in _AGES_BY_SPREAD.items()
        )

    @property
    def with_constant_ages(self) -> tuple[Self, ...]:
        """Return copies whose samples have the mean ages and the largest ages; one copy if the ages do not change."""
        spreads = dict.fromkeys(_AGES_BY_SPREAD, 0.0)
        largest = {
            name: getattr(self, name) + (getattr(self, spread) if getattr(self, name) > 0.0 else 0.0)
            for spread, names in _AGES_BY_SPREAD.items()
            for name in names
        }
        mean, oldest = self.replace(**spreads), self.replace(**spreads, **largest)
        return (mean,) if mean == oldest else (mean, oldest)

    @property
    def without_sample_ages(self) -> Self:
        """Return a copy whose samples arrive without delay, for analyses that neglect it."""
        ages = [name for spread, names in _AGES_BY_SPREAD.items() for name in (spread, *names)]
        return self.replace(**dict.fromkeys(ages, 0.0))

    @property
    def dead_time(self) -> float:
        """Time from a measurement until its command begins to act (s), at the period of this profile."""
        return self.delay * self.period + self.steering.dead_time

    def controller_world(self, period: float) -> Any:
        """Return what a controller must know of the profile, for its control period (s): record `ControllerWorld`."""
        return row_of(
            ControllerWorld,
            self,
            period=period,
            computation=self.delay * period,
            move_weight=self.move_weight * portable.square(self.period),
        )

    @property
    def noise(self) -> tuple[float, float, float, float]:
        """Standard deviations of the measured x_c = [v_y (m/s), yaw (rad), yaw rate (rad/s), y (m)]."""
        return self.noise_vy, self.noise_yaw, self.noise_yaw_rate, self.noise_y

    def to_toml(self, path: str | os.PathLike[str]) -> None:
        """Write the profile to a TOML file; the name of the file becomes the name of the profile.

        Raises
        ------
        StorageError
            When the file cannot be written.
        """
        super(Profile, self.replace(name=Path(path).stem)).to_toml(path)


def list_profiles() -> list[str]:
    """Return the sorted names of the built-in profiles."""
    return list_data("profiles")


def load_profile(profile: str | os.PathLike[str] | Profile) -> Profile:
    """Load a built-in profile by its name, or a profile from a TOML file whose keys are the fields of `Profile`.

    Text that ends in ``.toml`` or contains a directory is a path. A file without the key ``name`` names its profile
    after itself. A `Profile` is returned as it is.

    Raises
    ------
    UnknownName
        When no profile has this name.
    StorageError
        When the file cannot be read.
    ConfigError
        When the file is not TOML, or has unknown, missing or invalid values; the message lists all of them.
    """
    if isinstance(profile, Profile):
        return profile
    path = find_data("profiles", profile)
    return _shipped(path) if profile in list_profiles() else _read(path)


def _read(path: Path) -> Profile:
    return build(Profile, {"name": path.stem, **read_toml(path)}, path)


_shipped = cache(_read)

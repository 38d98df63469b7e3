"""Profiles: what stands between a controller and an ideal car, and what a test of it charges."""

from __future__ import annotations

import os
from functools import cache
from pathlib import Path

from pydantic import Field, field_validator

from adaptrack.files import Record, build, read_toml
from adaptrack.vehicle import SteeringActuator, find_data, list_data


class Profile(Record):
    """The simulated world around a car: its steering actuator, sensors and computer, and the weight of a test's cost.

    Each profile is one TOML file, see `load_profile`.

    Raises
    ------
    InvalidInput
        When a value is not allowed; the message names the key and what is.
    """

    name: str = Field(min_length=1, description="how lists and tables call the profile")
    description: str = Field(default="", description="one sentence for lists")
    steering: SteeringActuator = Field(
        default_factory=SteeringActuator.ideal, description="lag, rate limit and angle limit of the steering"
    )
    period: float = Field(
        default=0.1, gt=0, le=10, description="s, control period, unless the controller is told otherwise"
    )
    delay: float = Field(
        default=0.0, ge=0, description="-, control periods from a measurement until its command takes effect: 0 or 1"
    )
    preview: bool = Field(
        default=False, description="whether the controller knows the reference ahead, unless it is told otherwise"
    )
    noise_vy: float = Field(default=0.0, ge=0, description="m/s, standard deviation of the measured lateral velocity")
    noise_yaw: float = Field(default=0.0, ge=0, description="rad, standard deviation of the measured yaw angle")
    noise_yaw_rate: float = Field(default=0.0, ge=0, description="rad/s, standard deviation of the measured yaw rate")
    noise_y: float = Field(default=0.0, ge=0, description="m, standard deviation of the measured lateral position")
    move_weight: float = Field(
        default=0.0,
        ge=0,
        description="m^2/rad^2, weight w of steering activity in J = mean e^2 + w mean (change of command)^2",
    )

    @field_validator("delay")
    @classmethod
    def _whole_periods(cls, delay: float) -> float:
        if delay not in (0.0, 1.0):
            raise ValueError(
                "only 0 (a command acts at once) and 1 (it acts one period later) are simulated: "
                "give one of them, or change `period` so that the delay is one period."
            )
        return delay

    @property
    def noise(self) -> tuple[float, float, float, float]:
        """Standard deviations of the measured x_c = [v_y (m/s), yaw (rad), yaw rate (rad/s), y (m)]."""
        return self.noise_vy, self.noise_yaw, self.noise_yaw_rate, self.noise_y

    def to_toml(self, path: str | os.PathLike[str]) -> None:
        """Write the profile as TOML; the new one has the file's name.

        Raises
        ------
        StorageError
            When the file cannot be written.
        """
        super(Profile, self.replace(name=Path(path).stem)).to_toml(path)


def list_profiles() -> list[str]:
    """The names that `load_profile` knows, sorted."""
    return list_data("profiles")


def load_profile(profile: str | os.PathLike[str] | Profile) -> Profile:
    """The named profile, the one that a TOML file describes (keys: the fields of `Profile`), or the given one.

    Text is a path when it ends in ``.toml`` or holds a directory; without the key ``name``, the file's own name is
    taken.

    Raises
    ------
    UnknownName
        When no profile has this name.
    StorageError
        When the file cannot be read.
    ConfigError
        When it is not TOML, or holds an unknown, missing or impossible value; all of them are in the message.
    """
    if isinstance(profile, Profile):
        return profile
    path = find_data("profiles", profile)
    return _shipped(path) if profile in list_profiles() else _read(path)


@cache
def _shipped(path: Path) -> Profile:
    return _read(path)


def _read(path: Path) -> Profile:
    return build(Profile, {"name": path.stem, **read_toml(path)}, path)

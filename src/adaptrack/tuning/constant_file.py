"""A constant tuning as a file: what was found, for which controller, car and profile."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

from pydantic import Field, model_validator

from adaptrack.analysis.holdable import holdable_speed
from adaptrack.base.errors import InvalidInput
from adaptrack.base.files import LISTED, Record, build, read_toml
from adaptrack.cars.vehicle import Vehicle
from adaptrack.control.controllers import MPC, Controller, about_controller, get_controller
from adaptrack.road.holdable_speed import HoldableSpeed
from adaptrack.scenario.profile import Profile


class ConstantTuning(Record):
    """A tuning that was found for a controller on a car in a profile.

    Raises
    ------
    InvalidInput
        When a value is not allowed; the message names the key and what is.
    """

    controller: str = Field(description="registered name")
    vehicle: str = Field(min_length=1, description="name of the car that it was found on")
    profile: str = Field(min_length=1, description="name of the profile, likewise")
    period: float = Field(gt=0, le=10, description="s, control period, likewise: horizons are in periods")
    roads: Annotated[tuple[str, ...], LISTED] = Field(default=(), description="names of the roads, likewise")
    noise_seeds: Annotated[tuple[int, ...], LISTED] = Field(default=(), description="of the search: judge with others")
    command: str = Field(default="", description="the command line that made it")
    belief: str = Field(default="", description="of the controller about the steering, when it was found")
    tuning: dict[str, float] = Field(description="the controller's tuning entries")
    holds: HoldableSpeed | None = Field(
        default=None, description="speeds and braking that the controller holds with it, see `HoldableSpeed`"
    )

    @model_validator(mode="after")
    def _is_known(self) -> ConstantTuning:
        about_controller(self.controller)
        return self

    def make(
        self, car: Vehicle, profile: Profile, period: float, preview: bool, computation: float | None = None
    ) -> Controller:
        """The controller with this tuning; computation: as for `MPC`.

        Raises
        ------
        InvalidInput
            When the entries are not those of the controller, or their values make none.
        """
        offered = {"period": period, "preview": preview, "computation": computation}
        controller = get_controller(self.controller, car, profile=profile, offered=offered)
        if set(self.tuning) != set(controller.tuning_names):
            entries, names = ", ".join(self.tuning), ", ".join(controller.tuning_names)
            raise InvalidInput(f"tuning of {self.controller!r}: entries {entries}: must be {names}.")
        return controller.with_tuning(self.tuning)

    def holding(self, car: Vehicle, profile: Profile) -> ConstantTuning:
        """Return the file with `holds`, for a controller that can be analysed: an `MPC` (some seconds)."""
        controller = self.make(car, profile, self.period, profile.preview)
        if not isinstance(controller, MPC) or controller.scheduler is not None:
            return self
        return self.replace(holds=holdable_speed(car, controller, profile))

    def label(self, path: str | os.PathLike[str]) -> str:
        """How tables call it, read from this file."""
        return f"{self.controller}, {Path(path).stem}"

    def mismatches(self, car: str, profile: str, period: float) -> list[str]:
        """A clause for each of car, profile and period that is another than the file names."""
        clauses = [
            f"was found for the {key} {file_name!r}, not {name!r}"
            for key, file_name, name in (("car", self.vehicle, car), ("profile", self.profile, profile))
            if file_name != name
        ]
        if self.period != period:
            clauses.append(f"was found for a control period of {self.period:g} s, not {period:g} s")
        return clauses


def load_tuning(path: str | os.PathLike[str]) -> ConstantTuning:
    """Read the file of a constant tuning.

    Raises
    ------
    StorageError
        When the file cannot be read.
    ConfigError
        When it is not TOML, or holds an unknown, missing or impossible value.
    """
    return build(ConstantTuning, read_toml(path), Path(path))

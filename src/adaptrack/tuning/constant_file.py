"""File format of a constant tuning, with the controller, car and profile for which it was found."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, model_validator

from adaptrack.analysis.holdable import holdable_speed
from adaptrack.base.errors import InvalidInput
from adaptrack.base.files import LISTED, Record, build, read_toml
from adaptrack.cars.vehicle import Vehicle
from adaptrack.control.controllers import Controller, about_controller, get_controller
from adaptrack.road.holdable_speed import HoldableSpeed
from adaptrack.scenario.profile import Profile


class ConstantTuning(Record):
    """Constant tuning of a controller, with the car, profile and roads of the search.

    Raises
    ------
    InvalidInput
        For an invalid value; the message names the key and the accepted values.
    """

    controller: str = Field(description="registered name of the controller")
    vehicle: str = Field(min_length=1, description="name of the car in the search")
    profile: str = Field(min_length=1, description="name of the profile in the search")
    period: float = Field(gt=0, le=10, description="s, control period in the search; horizons are in periods")
    roads: Annotated[tuple[str, ...], LISTED] = Field(default=(), description="names of the roads in the search")
    noise_seeds: Annotated[tuple[int, ...], LISTED] = Field(
        default=(), description="noise seeds of the search; a comparison needs different ones"
    )
    command: str = Field(default="", description="command line that wrote the file")
    belief: str = Field(default="", description="steering parameters that the controller assumed in the search")
    tuning: dict[str, float] = Field(description="tuning entries of the controller")
    holds: HoldableSpeed | None = Field(
        default=None, description="largest braking (m/s^2) at which the stability margins suffice, see `HoldableSpeed`"
    )

    @model_validator(mode="after")
    def _is_known(self) -> ConstantTuning:
        about_controller(self.controller)
        return self

    def make(
        self, car: Vehicle, profile: Profile, period: float, preview: bool, computation: float | None = None
    ) -> Controller:
        """Return the controller with this tuning.

        Parameters
        ----------
        car, profile
            Car and profile for which the controller is built.
        period
            Control period (s).
        preview
            Whether the controller receives the road ahead.
        computation
            Computation time (s), as for `MPC`.

        Raises
        ------
        InvalidInput
            When the entries are not those of the controller, or it does not accept their values.
        """
        optional = {"period": period, "preview": preview, "computation": computation}
        controller = get_controller(self.controller, car, profile=profile, optional=optional)
        if set(self.tuning) != set(controller.tuning_names):
            entries, names = ", ".join(self.tuning), ", ".join(controller.tuning_names)
            raise InvalidInput(f"tuning of {self.controller!r}: entries {entries}: must be {names}.")
        return controller.with_tuning(self.tuning)

    def with_holdable_speed(self, car: Vehicle, profile: Profile) -> ConstantTuning:
        """Return a copy with the largest braking `holds`, which takes some seconds.

        If the controller is no `MPC`, or has a scheduler, the result is this object itself.
        """
        controller: Any = self.make(car, profile, self.period, profile.preview)
        if not controller.has_horizons or controller.scheduler is not None:
            return self
        return self.replace(holds=holdable_speed(car, controller, profile))

    def label(self, path: str | os.PathLike[str]) -> str:
        """Return the label in tables of the tuning that was read from a file."""
        return f"{self.controller}, {Path(path).stem}"

    def mismatches(self, car: str, profile: str, period: float) -> list[str]:
        """Return a clause for each of car, profile and control period (s) that differs from the file."""
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
        When it is not TOML, or has an unknown key, a missing key or an invalid value.
    """
    return build(ConstantTuning, read_toml(path), Path(path))

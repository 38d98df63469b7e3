"""Configuration of a comparison: controllers, cars, roads and profiles, and the effort of each search."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import Field, model_validator

from adaptrack.base.errors import InvalidInput, UnknownName, did_you_mean
from adaptrack.base.files import LISTED, SHIPPED, Record, build, read_toml
from adaptrack.cars.plant import Plant, SteppedPlant, get_plant
from adaptrack.cars.vehicle import Vehicle, load_vehicle
from adaptrack.control.controllers import About, Controller, about_controller, get_controller
from adaptrack.drive.world import ROAD_DRIVER, Driver
from adaptrack.road import Comfort, load_road, plan_speed
from adaptrack.road.generate import ROAD_KINDS
from adaptrack.scenario import RoadDrive, Scenario, load_scenario, random_drive
from adaptrack.scenario.library import list_scenarios
from adaptrack.scenario.profile import Profile, load_profile
from adaptrack.tuning.constant import LEAST_TUNINGS
from adaptrack.tuning.constant_file import load_tuning

COMPARISONS = SHIPPED / "comparisons"
PERIODS_OF_A_LOOP = 1500
"""Control periods of a drive, for estimates of time."""

Names = Annotated[tuple[str, ...], LISTED, Field(min_length=1)]
SeedNumbers = Annotated[tuple[int, ...], LISTED, Field(min_length=1)]


def is_tuning_file(contender: str) -> bool:
    """Whether a contender is the .toml file of a tuning, and not a registered controller."""
    return contender.endswith(".toml")


def about_contender(contender: str) -> About:
    """Properties of a registered controller, or of the controller in the file of a tuning, which is not tuned again.

    Raises
    ------
    UnknownName
        When no controller has this name.
    StorageError
        When the file cannot be read.
    """
    if is_tuning_file(contender):
        return replace(about_controller(load_tuning(contender).controller), tunable=False)
    return about_controller(contender)


class ComparisonConfig(Record):
    """Controllers, cars, roads and profiles of a comparison, and the effort of tuning."""

    name: str = Field(min_length=1, description="of the comparison")
    contenders: Names = Field(description="controllers, see `adaptrack list controllers`, or .toml files of tunings")
    cars: Names = Field(description="name or file of a car, with its plant: `van`, `my-car.toml/single-track`")
    profiles: Names = Field(description="names or files of profiles")
    training: Names = Field(description="roads of the search, see `roads`")
    roads: Names = Field(
        description="roads of the judgement: a kind of generated roads and its seed (`country:3`, with @6 driven at "
        "6 m/s^2), `random-drive:3`, the name of a scenario, or a file"
    )
    length: float = Field(default=2000.0, ge=100, le=100_000, description="m, of generated roads")
    training_length: float = Field(default=1000.0, ge=100, le=100_000, description="m, of those of the search")
    duration: float = Field(default=60.0, ge=1, le=3600, description="s, of random drives")
    seeds: SeedNumbers = Field(default=(0, 1, 2, 3, 4), description="noise seeds of the judgement")
    training_seeds: SeedNumbers = Field(default=(1000,), description="noise seeds of the search")
    budget: int = Field(default=200, ge=0, description="closed loops of each search; 0: none, defaults alone")
    prescribed_speed: bool = Field(
        default=False, description="whether cars follow their planned speed exactly, without forces along the road"
    )
    entry_speeds: bool = Field(default=True, description="whether ISO 3888-2 is driven")

    @model_validator(mode="after")
    def _can_be_done(self) -> Self:
        loops = len(self.training) * len(self.training_seeds)
        if self.budget and self.budget < LEAST_TUNINGS * loops:
            raise ValueError(
                f"budget = {self.budget}: a tuning takes {loops} closed loops (training roads times noise seeds): "
                f"give at least {LEAST_TUNINGS * loops}, or 0."
            )
        shared = set(self.seeds) & set(self.training_seeds)
        if shared:
            raise ValueError(f"training_seeds: {min(shared)} is a noise seed of the judgement as well.")
        repeated = set(self.training) & set(self.roads)
        if repeated:
            raise ValueError(f"training: {min(repeated)!r} is a road of the judgement as well.")
        for name in self.contenders:
            about_contender(name)
        return self

    @property
    def driver(self) -> Driver | None:
        """Driver of the cars on roads; None where the speed is prescribed."""
        return None if self.prescribed_speed else ROAD_DRIVER

    @property
    def cells(self) -> list[Cell]:
        """Every controller on every car in every profile."""
        return [
            Cell(contender, car, profile)
            for profile in dict.fromkeys(self.profiles)
            for car in dict.fromkeys(self.cars)
            for contender in dict.fromkeys(self.contenders)
        ]

    def loops(self, cell: Cell) -> int:
        """Closed loops of a cell, roughly: those of the search and of the judgement, without entry speeds."""
        search = self.budget if about_contender(cell.contender).tunable else 0
        return search + (2 if search else 1) * len(self.roads) * len(self.seeds)

    def seconds(self, cells: Sequence[Cell]) -> float:
        """s, how long cells take on one core, roughly: `PERIODS_OF_A_LOOP` steps a loop."""
        return sum(self.loops(cell) * PERIODS_OF_A_LOOP * about_contender(cell.contender).step_time for cell in cells)


@dataclass(frozen=True)
class Cell:
    """One controller on one car in one profile, by name."""

    contender: str
    car: str
    profile: str

    @property
    def label(self) -> str:
        """For progress and file names."""
        return f"{self.profile}, {self.car}, {self.contender}"


def list_comparisons() -> dict[str, str]:
    """Names of the shipped comparisons, with the first comment line of each."""
    return {
        path.stem: path.read_text(encoding="utf-8").splitlines()[0].lstrip("# ")
        for path in sorted(COMPARISONS.glob("*.toml"))
    }


def load_comparison(name_or_path: str | os.PathLike[str], **changes: Any) -> ComparisonConfig:
    """Load a shipped comparison by name, or one from a TOML file with the fields of `ComparisonConfig`.

    changes: fields to replace.

    Raises
    ------
    UnknownName
        When no comparison has the name.
    StorageError
        When the file cannot be read.
    ConfigError
        When a key is unknown, missing or not allowed.
    """
    text = os.fspath(name_or_path)
    if text.endswith(".toml"):
        path = Path(text)
    elif text in list_comparisons():
        path = COMPARISONS / f"{text}.toml"
    else:
        raise UnknownName(
            f"no comparison is named {text!r}. {did_you_mean(text, list_comparisons())} A file is given by its .toml "
            "path."
        )
    return build(ComparisonConfig, {"name": path.stem, **read_toml(path), **changes}, path)


# -- cars and roads ---------------------------------------------------------------------------------------------------
@dataclass(frozen=True, eq=False)
class ControllerSetting:
    """Car, profile and period that a controller is made for."""

    car: Vehicle
    plant: Plant | SteppedPlant
    profile: Profile

    def controller(self, name: str) -> Controller:
        """A registered controller for it, which knows the road ahead and the period.

        Raises
        ------
        InvalidInput
            When it was made for another car or profile.
        """
        offered = {"period": self.profile.period, "preview": True}
        return get_controller(name, self.car, profile=self.profile, offered=offered)


def load_setting(car: str, profile: str) -> ControllerSetting:
    """A car by `car` or `car/plant`, in a profile.

    Raises
    ------
    AdaptrackError
        When car, plant or profile cannot be had.
    """
    parts = re.fullmatch(r"(?P<car>.+\.toml|[^/]+)(/(?P<plant>[^/]+))?", car)
    if parts is None:
        raise InvalidInput(f"car {car!r}: must be a name or a .toml file, with /PLANT behind it or without.")
    vehicle = load_vehicle(parts["car"])
    plant = get_plant(parts["plant"] or "dual-track", vehicle)
    return ControllerSetting(vehicle, plant, load_profile(profile))


def load_drive(name: str, car: Vehicle, length: float, duration: float) -> Scenario | RoadDrive:
    """A road of a comparison, see `ComparisonConfig.roads`; its speed planned for the car.

    Raises
    ------
    AdaptrackError
        When there is no such road, or the car cannot be driven along it.
    """
    where, _, lateral = name.rpartition("@") if re.search(r"@[\d.]+$", name) else (name, "", "")
    kind, _, seed = where.partition(":")
    if seed and not seed.isdecimal():
        raise InvalidInput(f"road {name!r}: the seed behind ':' must be a whole number.")
    if kind == "random-drive":
        return random_drive(int(seed or 0), duration, **car.domain.drive_options)
    if where in list_scenarios():
        return load_scenario(where)
    road = load_road(kind, seed=int(seed or 0), length=length) if kind in ROAD_KINDS else load_road(where)
    comfort = Comfort(lateral=float(lateral)) if lateral else Comfort()
    return RoadDrive(road, plan_speed(road, car, comfort), name=name)

"""Configuration of a comparison: controllers, cars, roads, profiles, and the budget of each search."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, Self

from pydantic import Field, model_validator

from adaptrack.base.errors import InvalidInput
from adaptrack.base.files import LISTED, Record, build, read_toml
from adaptrack.cars.plant import Plant, SteppedPlant, get_plant
from adaptrack.cars.vehicle import Vehicle, find_data, list_data, load_vehicle
from adaptrack.comparison.table import WITH
from adaptrack.control.controllers import About, Controller, about_controller, get_controller
from adaptrack.control.speed_control import SpeedControl
from adaptrack.drive.drivers import make_driver
from adaptrack.drive.planner import make_planner
from adaptrack.drive.world import ROAD_DRIVER, Driver
from adaptrack.road import Comfort, Stop, load_road, plan_speed
from adaptrack.road.generate import ROAD_KINDS
from adaptrack.scenario import RoadDrive, Scenario, load_scenario, random_drive
from adaptrack.scenario.library import list_scenarios
from adaptrack.scenario.profile import Profile, load_profile
from adaptrack.tuning.constant import MIN_TUNINGS, load_tuning

PERIODS_PER_DRIVE = 1500
"""Assumed number of control periods of a drive, for estimates of the computation time."""

STEP_TIME = 1e-3
"""Assumed computation time of a control period with a driver, which often needs Python at every step (s)."""
STOP_DURATION = 2.0
"""Time for which cars stand at stops (s)."""

Friction = Annotated[float, Field(gt=0.0, le=3.0)]
Names = Annotated[tuple[str, ...], LISTED, Field(min_length=1)]
SeedNumbers = Annotated[tuple[int, ...], LISTED, Field(min_length=1)]


def is_tuning_file(contender: str) -> bool:
    """Whether a contender is the .toml file of a tuning; otherwise it is the name of a registered controller."""
    return contender.endswith(".toml")


def about_contender(contender: str) -> About:
    """Return the properties of a contender's controller. One with a tuning from a file is not tuned again.

    Raises UnknownName for an unregistered name, and StorageError when the file cannot be read.
    """
    if is_tuning_file(contender):
        return replace(about_controller(load_tuning(contender).controller), tunable=False)
    return about_controller(contender)


class ComparisonConfig(Record):
    """Controllers, cars, roads and profiles of a comparison, and the budget of each search.

    Each controller is tuned on the training roads. Default and tuned controllers are then compared on the test roads.
    """

    name: str = Field(min_length=1, description="name of the comparison")
    contenders: Names = Field(description="controllers, see `adaptrack list controllers`, or .toml files of tunings")
    cars: Names = Field(
        description="names or files of cars, optionally with a plant: `van`, `my-car.toml/single-track`"
    )
    profiles: Names = Field(description="names or files of profiles")
    training: Names = Field(description="training roads of the search, in the form of `roads`")
    roads: Names = Field(
        description="test roads: a kind of generated road and its seed (`country:3`; `country:3@6` plans bends at "
        "6 m/s^2), a random drive and its seed (`random-drive:3`), the name of a scenario, or a file"
    )
    length: float = Field(default=2000.0, ge=100, le=100_000, description="m, length of generated test roads")
    training_length: float = Field(
        default=1000.0, ge=100, le=100_000, description="m, length of generated training roads"
    )
    duration: float = Field(default=60.0, ge=1, le=3600, description="s, duration of random drives")
    seeds: SeedNumbers = Field(default=(0, 1, 2, 3, 4), description="noise seeds of the test drives")
    training_seeds: SeedNumbers = Field(default=(1000,), description="noise seeds of the search")
    budget: int = Field(
        default=200, ge=0, description="simulated drives of each search; 0 compares default tunings only"
    )
    prescribed_speed: bool = Field(
        default=False, description="whether cars follow their planned speed exactly, without forces along the road"
    )
    entry_speeds: bool = Field(
        default=True, description="whether ISO 3888-2 is driven, if neither drivers nor frictions are compared"
    )
    drivers: Annotated[tuple[str, ...], LISTED] = Field(
        default=(),
        description="drivers that move the cars, each with every controller, see `adaptrack list drivers`, with "
        "options as in `speed-control:friction=0.6:0.9`; empty for the default driver",
    )
    planner: str = Field(
        default="",
        description="settings of a simulated planner that all controllers follow, each with a speed control, such as "
        "`period=0.1,delay=0.3,start=pose`; empty: they follow the road",
    )
    frictions: Annotated[tuple[Friction, ...], LISTED] = Field(
        default=(),
        description="true frictions of the test roads, not used by plans; controllers and drivers assume 0.9",
    )
    stops: Annotated[tuple[float, ...], LISTED] = Field(
        default=(), description="m, places on each test road where cars stand for 2 s"
    )
    jerk: float | None = Field(default=None, gt=0.0, description="m/s^3, limit of the planned jerk on test roads")

    @model_validator(mode="after")
    def _can_be_done(self) -> Self:
        drives = len(self.training) * len(self.training_seeds)
        if self.budget and self.budget < MIN_TUNINGS * drives:
            raise ValueError(
                f"budget = {self.budget}: a tuning takes {drives} drives (training roads times noise seeds): "
                f"give at least {MIN_TUNINGS * drives}, or 0."
            )
        shared_seeds = set(self.seeds) & set(self.training_seeds)
        if shared_seeds:
            raise ValueError(f"training_seeds: {min(shared_seeds)} is a noise seed of the test drives as well.")
        shared_roads = set(self.training) & set(self.roads)
        if shared_roads:
            raise ValueError(f"training: {min(shared_roads)!r} is a test road as well.")
        for name in self.contenders:
            about_contender(name)
        if self.drivers and (self.budget or self.prescribed_speed):
            raise ValueError("drivers: need budget = 0 and no prescribed_speed, which is the driver 'prescribed'.")
        for driver in self.drivers:
            mover = make_driver(driver, load_setting(self.cars[0], self.profiles[0]).car)
            if self.planner and not isinstance(mover, SpeedControl):
                raise ValueError(f"planner: does not drive with {driver!r}: choose a driver such as speed-control.")
        if self.planner and (self.budget or self.prescribed_speed):
            raise ValueError("planner: needs budget = 0 (--budget 0) and no prescribed_speed.")
        make_planner(self.planner)
        return self

    @property
    def driver(self) -> Driver | None:
        """Driver of the cars on roads; None where the speed is prescribed."""
        return None if self.prescribed_speed else ROAD_DRIVER

    @property
    def cells(self) -> list[Cell]:
        """The combinations of every controller and driver with every car, profile and true friction."""
        return [
            Cell(contender, car, profile, driver, friction)
            for profile in dict.fromkeys(self.profiles)
            for friction in dict.fromkeys(self.frictions or (None,))
            for car in dict.fromkeys(self.cars)
            for contender in dict.fromkeys(self.contenders)
            for driver in dict.fromkeys(self.drivers or ("",))
        ]

    def loops(self, cell: Cell) -> int:
        """Return the approximate number of drives of a cell, in the search and the test, without entry speeds."""
        search = self.budget if about_contender(cell.contender).tunable else 0
        return search + (2 if search else 1) * len(self.roads) * len(self.seeds)

    def seconds(self, cells: Sequence[Cell]) -> float:
        """Return the approximate computation time of cells on one core (s)."""
        step_times = [STEP_TIME if cell.driver else about_contender(cell.contender).step_time for cell in cells]
        return PERIODS_PER_DRIVE * sum(self.loops(cell) * time for cell, time in zip(cells, step_times, strict=True))


@dataclass(frozen=True)
class Cell:
    """Names of one combination of controller, car and profile, with driver and true friction if they are compared."""

    contender: str
    car: str
    profile: str
    driver: str = ""
    friction: float | None = None

    @property
    def entries(self) -> dict[str, Any]:
        """The fields by name, without those that are not compared."""
        return {name: value for name, value in vars(self).items() if value}

    @property
    def condition(self) -> str:
        """The profile, with the true friction if it is compared."""
        return self.profile if self.friction is None else f"{self.profile}, friction {self.friction:g}"

    @property
    def label(self) -> str:
        """The label of the cell in progress reports and file names."""
        return f"{self.condition}, {self.car}, {self.with_driver(self.contender)}"

    def with_driver(self, controller: str) -> str:
        """Return the name of a controller, with the driver if drivers are compared."""
        return f"{controller}{WITH}{self.driver}" if self.driver else controller


def list_comparisons() -> dict[str, str]:
    """Return the first comment line of each shipped comparison, by name."""
    files = {name: find_data("comparisons", name) for name in list_data("comparisons")}
    return {name: file.read_text(encoding="utf-8").splitlines()[0].lstrip("# ") for name, file in files.items()}


def load_comparison(name_or_path: str | os.PathLike[str], **changes: Any) -> ComparisonConfig:
    """Load a shipped comparison by name, or one from a TOML file.

    Parameters
    ----------
    name_or_path
        Name, or path of a file.
    changes
        Fields of `ComparisonConfig` that replace those of the file.

    Raises
    ------
    UnknownName
        For an unknown name.
    StorageError
        When the file cannot be read.
    ConfigError
        For an unknown key, a missing key or an invalid value.
    """
    path = find_data("comparisons", name_or_path)
    return build(ComparisonConfig, {"name": path.stem, **read_toml(path), **changes}, path)


# -- cars and roads ---------------------------------------------------------------------------------------------------
@dataclass(frozen=True, eq=False)
class ControllerSetting:
    """Car, plant and profile for which a controller is built."""

    car: Vehicle
    plant: Plant | SteppedPlant
    profile: Profile

    def controller(self, name: str) -> Controller:
        """Return a registered controller for this car and profile, with preview of the road.

        Raises InvalidInput when the controller belongs to a different car or profile.
        """
        optional = {"period": self.profile.period, "preview": True}
        return get_controller(name, self.car, profile=self.profile, optional=optional)


def load_setting(car: str, profile: str) -> ControllerSetting:
    """Return a car with its plant and profile.

    car: name or .toml file of a car, optionally followed by a slash and the name of a plant; profile: name or file.
    Raises AdaptrackError when car, plant or profile does not exist or cannot be read.
    """
    parts = re.fullmatch(r"(?P<car>.+\.toml|[^/]+)(/(?P<plant>[^/]+))?", car)
    if parts is None:
        raise InvalidInput(f"car {car!r}: must be a name or a .toml file, optionally followed by /PLANT.")
    vehicle = load_vehicle(parts["car"])
    plant = get_plant(parts["plant"] or "dual-track", vehicle)
    return ControllerSetting(vehicle, plant, load_profile(profile))


def load_drive(
    name: str, car: Vehicle, length: float, duration: float, *, friction: float | None = None,
    stops: Sequence[float] = (), jerk: float | None = None,
) -> Scenario | RoadDrive:  # fmt: skip
    """Return the drive on a road, named as in `ComparisonConfig.roads`, with a speed that is planned for a car.

    length: m, of a generated road; duration: s, of a random drive; friction: true friction of a road, which the plan
    does not use; stops: m, places where the car stands for `STOP_DURATION`; jerk: m/s^3, limit of the planned one.
    Raises AdaptrackError when the road does not exist, or no speed can be planned along it.
    """
    where, _, lateral = name.rpartition("@") if re.search(r"@[\d.]+$", name) else (name, "", "")
    kind, _, seed = where.partition(":")
    if seed and not seed.isdecimal():
        raise InvalidInput(f"road {name!r}: the seed after ':' must be a whole number.")
    if kind == "random-drive":
        return random_drive(int(seed or 0), duration, **car.domain.drive_options)
    if where in list_scenarios():
        return load_scenario(where)
    road = load_road(kind, seed=int(seed or 0), length=length) if kind in ROAD_KINDS else load_road(where)
    comfort = Comfort(**{"lateral": float(lateral)} if lateral else {}, jerk=jerk or math.inf)
    plan = plan_speed(road, car, comfort, stops=[Stop(place, STOP_DURATION) for place in stops])
    return RoadDrive(road if friction is None else road.replace(friction=friction), plan, name=name)

"""What is driven in an episode: car, road, world and noise, drawn for each episode from what the user allows."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from adaptrack.base.checked import real, whole_number
from adaptrack.base.errors import InvalidInput, format_value
from adaptrack.cars.plant import DualTrack, Plant, SteppedPlant, get_plant
from adaptrack.cars.vehicle import Vehicle, load_vehicle
from adaptrack.comparison.config import load_drive, load_setting
from adaptrack.control.controllers import CompiledController
from adaptrack.drive.failure import DISTANCE, Failure
from adaptrack.drive.world import ROAD_DRIVER, Driver, KnownAs
from adaptrack.identification import CarRanges, random_car
from adaptrack.identification.random_cars import BASES
from adaptrack.scenario import RoadDrive, Scenario
from adaptrack.scenario.profile import Profile, load_profile

SEED_LIMIT = 2**31
"""Seeds of noise and cars are drawn below it."""
CHOICES = ("noise_seed", "car_seed", "road")
"""What ``reset(options={...})`` may choose for an episode."""


@dataclass(frozen=True, eq=False)
class Episode:
    """Road, car, profile and seeds of one drive."""

    vehicle: Vehicle
    plant: Plant | SteppedPlant
    profile: Profile
    drive: Scenario | RoadDrive
    road: int
    """which of the roads of the task"""
    noise_seed: int
    car_seed: int | None
    """of a random car"""

    @property
    def info(self) -> dict[str, Any]:
        """Return the ``info`` of ``reset``."""
        drawn = {} if self.car_seed is None else {"car_seed": self.car_seed}
        return {"car": self.vehicle.name, "road": self.drive.name, "noise_seed": self.noise_seed, **drawn}


@dataclass(frozen=True, kw_only=True)
class Task:
    """From what the episodes of an environment are drawn.

    Raises
    ------
    InvalidInput
        When a part is of a wrong kind, or parts do not fit each other.
    UnknownName, StorageError, ConfigError
        When a car, a road or a profile cannot be had.
    """

    car: str | Vehicle | Plant | SteppedPlant | None = None
    """name or file of a car, with its plant if it is not dual-track (`van`, `van/single-track`, `my-car.toml`), a
    `Vehicle`, or a plant with a `vehicle`, such as ``UserPlant(..., vehicle=car)``; by default `paper`. Of random cars:
    the shipped car about which they are drawn, by default those of `random_car`"""
    road: str | Scenario | RoadDrive | Sequence[str | Scenario | RoadDrive] = "country:1"
    """a kind of generated road with its seed (`country:3`, `mountain:2@4` with bends at 4 m/s^2), `random-drive:3`, the
    name of a scenario, a file, a `Scenario` or a `RoadDrive`; of several each episode draws one"""
    profile: str | Profile = "road"
    random_cars: bool | CarRanges = False
    """each episode draws a car of its own, with its own steering and sensor noise (`random_car`), from these ranges"""
    driver: Driver | None = ROAD_DRIVER
    """None: the speed follows its plan exactly"""
    known_as: KnownAs = None
    """how friction and wind are known"""
    failure: Failure | None = None
    """when a run has failed, by default as the car's domain says"""
    failure_cost: float | None = None
    """m^2, what each instant costs that a failed run does not drive; by default the square of the failure distance"""
    length: float = 1000.0
    """m, of generated roads"""
    duration: float = 60.0
    """s, of random drives"""
    _drives: dict[tuple[int, str], Scenario | RoadDrive] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )

    def __post_init__(self) -> None:
        object.__setattr__(self, "profile", load_profile(self.profile))
        if isinstance(self.road, str | Scenario | RoadDrive):
            object.__setattr__(self, "road", (self.road,))
        if not isinstance(self.road, Sequence) or not self.road:
            raise InvalidInput(f"road = {self.road!r}: must be a road or a sequence of at least one.")
        for name in self.road:
            if not isinstance(name, str | Scenario | RoadDrive):
                raise InvalidInput(f"road = {name!r}: must be a name, a file, a Scenario or a RoadDrive.")
        if self.randomised and not isinstance(self.car, str | None):
            raise InvalidInput(f"random_cars: car = {self.car!r}: must be the name of a shipped car, or left out.")
        if self.failure_cost is not None and not 0.0 <= real("failure_cost", "m^2", self.failure_cost) < math.inf:
            raise InvalidInput(f"failure_cost = {self.failure_cost!r} m^2: must be finite and not negative.")
        self.draw(np.random.default_rng(0), None)  # what cannot be had is said at once

    @property
    def world(self) -> Profile:
        """The profile; that of a random car differs in steering and noise."""
        assert isinstance(self.profile, Profile)  # since __post_init__
        return self.profile

    @property
    def roads(self) -> tuple[str | Scenario | RoadDrive, ...]:
        """Roads named by ``road``."""
        return tuple(self.road)  # type: ignore[arg-type]

    @property
    def randomised(self) -> bool:
        """Whether each episode has a car of its own."""
        return self.random_cars is not False

    def draw(self, rng: np.random.Generator, options: dict[str, Any] | None) -> Episode:
        """An episode; options: what it must have, see `CHOICES`.

        What the options choose is drawn all the same, so that the rest is what it was.

        Raises
        ------
        InvalidInput
            When an option is unknown or not allowed.
        """
        chosen = dict(options or {})
        unknown = set(chosen) - set(CHOICES)
        if unknown:
            raise InvalidInput(f"reset: options: {sorted(unknown)[0]!r} is unknown; known are {', '.join(CHOICES)}.")
        drawn = {name: int(rng.integers(most)) for name, most in self._most().items()}
        for name, value in chosen.items():
            if name not in drawn:
                raise InvalidInput(f"reset: options: {name!r}: this environment does not draw one.")
            drawn[name] = whole_number("reset: options", name, value, least=0)
            if drawn[name] >= self._most()[name]:
                raise InvalidInput(f"reset: options: {name} = {value!r}: must be below {self._most()[name]}.")
        return self._episode(drawn)

    def _most(self) -> dict[str, int]:
        cars = {"car_seed": SEED_LIMIT} if self.randomised else {}
        return {"road": len(self.roads), **cars, "noise_seed": SEED_LIMIT}

    def _episode(self, drawn: dict[str, int]) -> Episode:
        road_index, seed, noise = drawn["road"], drawn.get("car_seed"), drawn["noise_seed"]
        if seed is None:
            vehicle, plant, profile = self.known_car()
            return Episode(vehicle, plant, profile, self.drive(road_index, vehicle), road_index, noise, None)
        ranges = self.random_cars if isinstance(self.random_cars, CarRanges) else None
        bases = BASES if self.car is None else (str(self.car),)
        car = random_car(seed, bases=bases, profile=self.world, ranges=ranges)
        plant, drive = DualTrack(car.vehicle, car.tyre), self.drive(road_index, load_vehicle(car.base))
        return Episode(car.vehicle, plant, car.profile, drive, road_index, noise, seed)

    def known_car(self) -> tuple[Vehicle, Plant | SteppedPlant, Profile]:
        """The car, its plant and its world where they are not drawn."""
        car = "paper" if self.car is None else self.car
        if isinstance(car, str):
            setting = load_setting(car, self.world)  # type: ignore[arg-type]
            return setting.car, setting.plant, self.world
        if isinstance(car, Vehicle):
            return car, get_plant("dual-track", car), self.world
        vehicle = getattr(car, "vehicle", None)
        if not isinstance(car, Plant | SteppedPlant) or not isinstance(vehicle, Vehicle):
            raise InvalidInput(
                f"car = {format_value(car)}: must be a name, a file, a Vehicle, or a plant whose `vehicle` is one, "
                "such as UserPlant(..., vehicle=load_vehicle(name)): the speed along the road is planned for it."
            )
        return vehicle, car, self.world

    def drive(self, road_index: int, vehicle: Vehicle) -> Scenario | RoadDrive:
        """One of the roads, its speed planned for a vehicle: of a random car the one about which it is drawn."""
        road = self.roads[road_index]
        if not isinstance(road, str):
            return road
        if (road_index, vehicle.name) not in self._drives:
            self._drives[road_index, vehicle.name] = load_drive(road, vehicle, self.length, self.duration)
        return self._drives[road_index, vehicle.name]

    def cost_of_failure(self, distance: float) -> float:
        """m^2, of each instant that a failed run does not drive, by the failure distance (m)."""
        return min(distance, DISTANCE) ** 2 if self.failure_cost is None else float(self.failure_cost)


class Outside(CompiledController):
    """Stands where a controller would: the commands come from outside."""

    tuning_names, diagnostic_names, memory_size = (), (), 0

    def __init__(self, period: float) -> None:
        super().__init__({}, period=period)

    @property
    def name(self) -> str:
        return "steered from outside"

    @property
    def function(self) -> Any:
        return None

    def own_parameters(self) -> tuple[float, ...]:
        return ()

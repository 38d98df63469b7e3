"""Task of an environment: the cars, roads, profile and noise from which it draws each episode."""

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
from adaptrack.core.public import portable
from adaptrack.drive.failure import DISTANCE, FailureLimits
from adaptrack.drive.world import ROAD_DRIVER, Driver, PerceptionSource, RequestedForces
from adaptrack.identification import CarRanges, random_car
from adaptrack.identification.random_cars import BASES
from adaptrack.scenario import RoadDrive, Scenario
from adaptrack.scenario.profile import Profile, load_profile

SEED_LIMIT = 2**31
"""Upper limit, excluded, of random seeds of noise and cars."""
RESET_OPTIONS = ("noise_seed", "car_seed", "road")
"""Keys of ``reset(options={...})``."""


@dataclass(frozen=True, eq=False)
class Episode:
    """Car, road, profile and seeds of one episode."""

    vehicle: Vehicle
    plant: Plant | SteppedPlant
    profile: Profile
    drive: Scenario | RoadDrive
    road: int
    """Index of the road in `Task.roads`."""
    noise_seed: int
    car_seed: int | None
    """Seed of the random car, None without random cars."""

    @property
    def info(self) -> dict[str, Any]:
        """The ``info`` of ``reset``: names of car and road, and the seeds."""
        car_seed = {} if self.car_seed is None else {"car_seed": self.car_seed}
        return {"car": self.vehicle.name, "road": self.drive.name, "noise_seed": self.noise_seed, **car_seed}


@dataclass(frozen=True, kw_only=True)
class Task:
    """Cars, roads, profile and rules of the episodes of an environment.

    Raises
    ------
    InvalidInput
        For a value of a wrong type, or values that are incompatible with each other.
    UnknownName, StorageError, ConfigError
        When a car, a road or a profile does not exist or cannot be read.
    """

    car: str | Vehicle | Plant | SteppedPlant | None = None
    """Car of all episodes, by default `paper`. It is one of

    - the name or file of a car, followed by its plant unless that is dual-track (`van`, `van/single-track`,
      `my-car.toml`);
    - a `Vehicle`;
    - a plant with an attribute `vehicle`, such as ``UserPlant(..., vehicle=car)``.

    With `random_cars` it is the name of the shipped car whose parameters are varied. By default these are the cars that
    `random_car` varies.
    """
    road: str | Scenario | RoadDrive | Sequence[str | Scenario | RoadDrive] = "country:1"
    """Road of all episodes, or several roads from which each episode draws one. A road is one of

    - a kind of generated road and its seed (`country:3`), optionally with the lateral acceleration in bends
      (`mountain:2@4`: 4 m/s^2);
    - a random drive and its seed (`random-drive:3`);
    - the name of a scenario, or a file;
    - a `Scenario` or a `RoadDrive`.
    """
    profile: str | Profile = "road"
    """Steering, sensors, control period and cost weights, or the name of a shipped profile."""
    random_cars: bool | CarRanges = False
    """Whether each episode draws a new car with its own steering and sensor noise, or the ranges to draw from."""
    driver: Driver | RequestedForces | None = ROAD_DRIVER
    """Speed control of the car; None if the speed follows its plan exactly."""
    perception: PerceptionSource = None
    """How the controller perceives friction and wind, as in `adaptrack.simulate`."""
    failure: FailureLimits | None = None
    """Rule by which a run fails; None for the rule of the car's domain."""
    failure_cost: float | None = None
    """Cost of each remaining instant after a failure (m^2); None for the square of the failure distance."""
    length: float = 1000.0
    """Length of generated roads (m)."""
    duration: float = 60.0
    """Duration of random drives (s)."""
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
        if self.failure_cost is not None and not 0.0 <= real("Task", "failure_cost", self.failure_cost) < math.inf:
            raise InvalidInput(f"failure_cost = {self.failure_cost!r} m^2: must be finite and not negative.")
        self.draw(np.random.default_rng(0), None)  # raises for cars and roads that cannot be loaded

    @property
    def base_profile(self) -> Profile:
        """The loaded profile; random cars change its steering and noise."""
        assert isinstance(self.profile, Profile)  # since __post_init__
        return self.profile

    @property
    def roads(self) -> tuple[str | Scenario | RoadDrive, ...]:
        """The road, or the roads, as a tuple."""
        return tuple(self.road)  # type: ignore[arg-type]

    @property
    def randomised(self) -> bool:
        """Whether each episode draws a new car."""
        return self.random_cars is not False

    def draw(self, rng: np.random.Generator, options: dict[str, Any] | None) -> Episode:
        """Draw an episode.

        Parameters
        ----------
        rng
            Source of the random numbers. Values that `options` specify are drawn as well and then replaced, so an
            option does not change the other values.
        options
            Specified values by key of `RESET_OPTIONS`.

        Raises
        ------
        InvalidInput
            For an unknown option or an invalid value.
        """
        specified = dict(options or {})
        unknown = set(specified) - set(RESET_OPTIONS)
        if unknown:
            names = ", ".join(RESET_OPTIONS)
            raise InvalidInput(f"reset: options: {sorted(unknown)[0]!r} is unknown; known are {names}.")
        values = {name: int(rng.integers(limit)) for name, limit in self._upper_limits().items()}
        for name, value in specified.items():
            if name not in values:
                raise InvalidInput(f"reset: options: {name!r}: this environment does not draw one.")
            values[name] = whole_number("reset: options", name, value, least=0)
            if values[name] >= self._upper_limits()[name]:
                raise InvalidInput(f"reset: options: {name} = {value!r}: must be below {self._upper_limits()[name]}.")
        return self._episode(values)

    def _upper_limits(self) -> dict[str, int]:
        """Return the upper limit, excluded, of each random value of an episode, in the order of drawing."""
        cars = {"car_seed": SEED_LIMIT} if self.randomised else {}
        return {"road": len(self.roads), **cars, "noise_seed": SEED_LIMIT}

    def _episode(self, values: dict[str, int]) -> Episode:
        road_index, seed, noise = values["road"], values.get("car_seed"), values["noise_seed"]
        if seed is None:
            vehicle, plant, profile = self.base_car()
            return Episode(vehicle, plant, profile, self.drive(road_index, vehicle), road_index, noise, None)
        ranges = self.random_cars if isinstance(self.random_cars, CarRanges) else None
        bases = BASES if self.car is None else (str(self.car),)
        car = random_car(seed, bases=bases, profile=self.base_profile, ranges=ranges)
        plant, drive = DualTrack(car.vehicle, car.tyre), self.drive(road_index, load_vehicle(car.base))
        return Episode(car.vehicle, plant, car.profile, drive, road_index, noise, seed)

    def base_car(self) -> tuple[Vehicle, Plant | SteppedPlant, Profile]:
        """Return the car of the task, before any random change, with its plant and profile."""
        car = "paper" if self.car is None else self.car
        if isinstance(car, str):
            setting = load_setting(car, self.base_profile)  # type: ignore[arg-type]
            return setting.car, setting.plant, self.base_profile
        if isinstance(car, Vehicle):
            return car, get_plant("dual-track", car), self.base_profile
        vehicle = getattr(car, "vehicle", None)
        if not isinstance(car, Plant | SteppedPlant) or not isinstance(vehicle, Vehicle):
            raise InvalidInput(
                f"car = {format_value(car)}: must be a name, a file, a Vehicle, or a plant whose `vehicle` is one, "
                "such as UserPlant(..., vehicle=load_vehicle(name)): the speed along the road is planned for it."
            )
        return vehicle, car, self.base_profile

    def drive(self, road_index: int, vehicle: Vehicle) -> Scenario | RoadDrive:
        """Return the drive on a road at the speed that is planned for a vehicle.

        Parameters
        ----------
        road_index
            Index of the road in `roads`.
        vehicle
            Car of the episode; for a random car the shipped car from which it was varied.
        """
        road = self.roads[road_index]
        if not isinstance(road, str):
            return road
        if (road_index, vehicle.name) not in self._drives:
            self._drives[road_index, vehicle.name] = load_drive(road, vehicle, self.length, self.duration)
        return self._drives[road_index, vehicle.name]

    def cost_of_failure(self, distance: float) -> float:
        """Return the cost of each remaining instant after a failure (m^2), for a failure distance (m)."""
        return portable.square(min(distance, DISTANCE)) if self.failure_cost is None else float(self.failure_cost)


class ExternalCommands(CompiledController):
    """Placeholder for the controller of a run whose commands come from an agent."""

    tuning_names, diagnostic_names, memory_size = (), (), 0

    def __init__(self, period: float) -> None:
        super().__init__({}, period=period)

    @property
    def name(self) -> str:
        return "external commands"

    @property
    def function(self) -> Any:
        return None

    def part(self, slots: int, room: Any = None, *, curved: bool = True, has_vy: bool = True) -> Any:
        return super().part(slots, room, curved=curved, has_vy=has_vy)._replace(step=0)  # the caller is the controller

    def own_parameters(self) -> tuple[float, ...]:
        return ()

"""A side-by-side: controllers x cars x roads x profiles, all tuned with the same effort, judged on what none saw.

A cell is one controller on one car in one profile. Its tuning is sought on the training roads with a given number of
closed loops, for a plant that takes long on the car's twin (`plant.twin_of`); then the default and the tuned controller
drive the roads of the judgement with each noise seed, and enter the obstacle avoidance of ISO 3888-2 as fast as they
can. Every run gives one row.
"""

from __future__ import annotations

import math
import re
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, Any, Self

import numpy as np
from pydantic import Field, model_validator

from adaptrack.base.errors import InvalidInput, MissingExtra
from adaptrack.base.files import LISTED, Record
from adaptrack.cars.plant import Plant, SteppedPlant, get_plant, twin_of, usual_plant
from adaptrack.cars.vehicle import Vehicle, load_vehicle
from adaptrack.comparison.contenders import Contender
from adaptrack.comparison.manoeuvres import LaneChangeTest, entry_speed, iso_3888_2
from adaptrack.comparison.roads import check_fits
from adaptrack.control.controllers import MPC, About, Controller, about_controller, get_controller
from adaptrack.drive.metrics import compute_metrics
from adaptrack.drive.path_metrics import PathRecord, path_metrics
from adaptrack.drive.trajectory import Trajectory
from adaptrack.road import Comfort, Road, load_road, plan_speed
from adaptrack.road.generate import KINDS
from adaptrack.scenario import RoadDrive, Scenario, load_scenario, random_drive
from adaptrack.scenario.library import list_scenarios
from adaptrack.scenario.profile import Profile, load_profile
from adaptrack.tuning.constant import LEAST_TUNINGS, seek_constant
from adaptrack.tuning.pso import SwarmSettings
from adaptrack.tuning.runs import Retuned, RunSet

Progress = Callable[[str, int, int], None]

PERIODS_OF_A_LOOP = 1500
"""Control periods of a drive, for estimates of time."""
MOST_PARTICLES = 20
"""Of a search; with fewer tunings, so many that the swarm has some generations."""


Names = Annotated[tuple[str, ...], LISTED, Field(min_length=1)]
Numbers = Annotated[tuple[int, ...], LISTED, Field(min_length=1)]


class SideBySide(Record):
    """What is compared, and with what effort each controller is tuned."""

    name: str = Field(min_length=1, description="of the comparison")
    contenders: Names = Field(description="names, see `adaptrack compare --list`")
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
    seeds: Numbers = Field(default=(0, 1, 2, 3, 4), description="noise seeds of the judgement")
    training_seeds: Numbers = Field(default=(1000,), description="noise seeds of the search")
    budget: int = Field(default=200, ge=0, description="closed loops of each search; 0: none, defaults alone")
    entry_speeds: bool = Field(default=True, description="whether ISO 3888-2 is driven")
    slow_cars: Names | None = Field(default=None, description="cars of contenders in Python; by default all")
    slow_roads: Names | None = Field(default=None, description="roads of their judgement, likewise")
    slow_seeds: Numbers | None = Field(default=None, description="noise seeds of their judgement, likewise")
    costly_seeds: Numbers | None = Field(
        default=None, description="noise seeds of the judgement on plants that take long (CommonRoad's), by default all"
    )
    slow_budget: int = Field(default=0, ge=0, description="closed loops of their search; 0: defaults alone")

    @model_validator(mode="after")
    def _can_be_done(self) -> Self:
        each = len(self.training) * len(self.training_seeds)
        for key in ("budget", "slow_budget"):
            budget = getattr(self, key)
            if budget and budget < LEAST_TUNINGS * each:
                raise ValueError(
                    f"{key} = {budget}: a tuning takes {each} closed loops (training roads times their noise seeds): "
                    f"give at least {LEAST_TUNINGS * each}, or 0."
                )
        shared = set(self.seeds) & set(self.training_seeds)
        if shared:
            raise ValueError(f"training_seeds: {min(shared)} is a noise seed of the judgement as well.")
        seen = set(self.training) & set(self.roads)
        if seen:
            raise ValueError(f"training: {min(seen)!r} is a road of the judgement as well.")
        for name in self.contenders:
            about_controller(name)
        return self

    @property
    def cells(self) -> list[Cell]:
        """Every controller on every car in every profile."""
        return [
            Cell(contender, car, profile)
            for profile in dict.fromkeys(self.profiles)
            for car in dict.fromkeys(self.cars)
            for contender in dict.fromkeys(self.contenders)
            if about_controller(contender).compiled or car in (self.slow_cars or self.cars)
        ]

    def of(self, entry: About) -> SideBySide:
        """What is asked of an entry: one in Python may have fewer roads, seeds and closed loops."""
        if entry.compiled:
            return self
        roads, seeds = self.slow_roads or self.roads, self.slow_seeds or self.seeds
        return self.replace(roads=roads, seeds=seeds, budget=self.slow_budget)

    def loops(self, cell: Cell) -> int:
        """Closed loops of a cell, roughly: those of the search and of the judgement, without entry speeds."""
        entry = about_controller(cell.contender)
        asked = self.of(entry)
        searched = asked.budget if entry.tunable else 0
        return searched + (2 if searched else 1) * len(asked.roads) * len(asked.seeds)

    def seconds(self, cells: Sequence[Cell]) -> float:
        """s, how long cells take on one core, roughly: `PERIODS_OF_A_LOOP` steps a loop."""
        return sum(self.loops(cell) * PERIODS_OF_A_LOOP * about_controller(cell.contender).step_time for cell in cells)


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


# -- cars and roads ---------------------------------------------------------------------------------------------------
@dataclass(frozen=True, eq=False)
class Setting:
    """What a controller is made for."""

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


def load_setting(car: str, profile: str) -> Setting:
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
    body = get_plant(parts["plant"] or usual_plant(vehicle), vehicle)
    return Setting(vehicle, body, load_profile(profile))


def load_trip(name: str, car: Vehicle, length: float, duration: float) -> Scenario | RoadDrive:
    """A road of a side-by-side, see `SideBySide.roads`; its speed planned for the car.

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
    road = load_road(kind, seed=int(seed or 0), length=length) if kind in KINDS else load_road(where)
    comfort = Comfort(lateral=float(lateral)) if lateral else Comfort()
    return RoadDrive(road, plan_speed(road, car, comfort), name=name)


@lru_cache(maxsize=4)
def _run_sets(task: SideBySide, car: str, profile: str) -> tuple[Setting, RunSet, RunSet]:
    """What all controllers on a car in a profile share: the runs of the search and those of the judgement."""
    setting = load_setting(car, profile)
    mpc = MPC(setting.car, profile=setting.profile, preview=True)
    made = []
    searched = twin_of(setting.car) if setting.plant.costly else setting.plant
    parts = (searched, task.training, task.training_length), (setting.plant, task.roads, task.length)
    for plant, names, length in parts:
        trips = [load_trip(name, setting.car, length, task.duration) for name in names]
        made.append(RunSet(plant, mpc, trips, setting.profile))
    return setting, made[0], made[1]


@lru_cache(maxsize=4)
def _obstacle(car: str, profile: str) -> LaneChangeTest | None:
    """The obstacle avoidance of ISO 3888-2 with a car; None where it is not driven compiled, or does not fit."""
    setting = load_setting(car, profile)
    if not isinstance(setting.plant, Plant):
        return None
    track = iso_3888_2(setting.car.outline.width)
    return LaneChangeTest(setting.car, setting.plant, track, setting.profile, _roads=_lines(car))


@lru_cache(maxsize=16)
def _lines(car: str) -> dict[float, Road]:
    """The driven lines of a car by entry speed, which all profiles share."""
    return {}


# -- a cell -----------------------------------------------------------------------------------------------------------
def run_cell(task: SideBySide, cell: Cell) -> dict[str, Any]:
    """Tune and judge one controller on one car in one profile.

    Returns
    -------
    dict
        Plain JSON: `rows`, one for each run; `tunings`, `entry_speed` (m/s) by tuning; `not_entered`: why ISO 3888-2
        was not driven; `loops` that the search took, `seconds`; `left_out`: why nothing was driven.

    Raises
    ------
    AdaptrackError
        When the car, the profile or a road cannot be had.
    """
    begun = time.perf_counter()
    entry = about_controller(cell.contender)
    task = task.of(entry)
    setting, training, judged = _run_sets(task, cell.car, cell.profile)
    if setting.plant.costly and task.costly_seeds:
        task = task.replace(seeds=task.costly_seeds)
    found: dict[str, Any] = {
        "rows": [],
        "tunings": {},
        "entry_speed": {},
        "not_entered": "",
        "loops": 0,
        "left_out": "",
    }
    try:
        own = setting.controller(cell.contender)
        check_fits(Contender(cell.contender, own), judged)
    except (InvalidInput, MissingExtra) as error:
        return found | {"left_out": str(error), "seconds": 0.0}
    drivers: dict[str, Controller] = {"scheduled" if own.scheduler else "default": own}
    if entry.tunable and task.budget:
        swarm = _swarm(task.budget, len(training) * len(task.training_seeds))
        sought = seek_constant(training, own, swarm, noise_seeds=task.training_seeds)
        found["loops"] = swarm.evaluations * len(training) * len(task.training_seeds)
        drivers["tuned"] = judged.controller_of(Retuned(own, list(sought.tuning.values())))
        found["tunings"] = {"default": sought.default, "tuned": sought.tuning}
    for tuning, driver in drivers.items():
        about = {"contender": cell.contender, "tuning": tuning, "car": cell.car, "profile": cell.profile}
        found["rows"] += _rows(task, setting, judged, driver, about)
        try:
            found["entry_speed"][tuning] = _entry_speed(task, cell, entry, driver)
        except InvalidInput as error:
            found["not_entered"] = str(error)
    return found | {"seconds": time.perf_counter() - begun}


def _swarm(budget: int, each: int) -> SwarmSettings:
    """A swarm that spends at most so many closed loops; a tuning takes `each` of them."""
    tunings = budget // each
    particles = min(MOST_PARTICLES, max(5, round(math.sqrt(tunings))))
    return SwarmSettings(particles=particles, generations=max(1, tunings // particles))


def _rows(
    task: SideBySide, setting: Setting, runs: RunSet, driver: Controller, about: Mapping[str, str]
) -> list[dict[str, Any]]:
    """The measures of every run."""
    made = []
    for road, driven in zip(task.roads, runs.trajectories(driver, task.seeds), strict=True):
        for seed, run in zip(task.seeds, driven, strict=True):
            made.append({**about, "road": road, "seed": seed, **_measures(setting, runs, run)})
    return made


def _measures(setting: Setting, runs: RunSet, run: Trajectory) -> dict[str, Any]:
    """Of one run; errors, comfort and steering until its end or failure, None where there is nothing to measure."""
    whole = compute_metrics(run, failure=runs.failure)
    found: dict[str, Any] = {
        "cost": runs.failed_cost if whole.failed else whole.cost,
        "failed": whole.failed, "reason": whole.failed_reason or "",
        "failed_at": float(whole.failed_at) if whole.failed else None,
    }  # fmt: skip
    record = PathRecord.from_trajectory(run)
    seen = None if record is None else path_metrics(record, setting.car.outline).to_dict()
    return found | {name: None if seen is None else seen[kept] for name, kept in MEASURES.items()}


MEASURES = {
    "rms_error": "rms_offset", "p95_error": "p95_offset", "max_error": "max_offset", "max_corner": "max_corner_error",
    "steering_rate": "rms_command_rate", "acceleration": "max_acceleration_r79", "jerk": "max_jerk_r79",
    "duration": "duration",
}  # fmt: skip
"""Columns of a row, and the `PathMetrics` that they hold."""


def _entry_speed(task: SideBySide, cell: Cell, entry: About, driver: Controller) -> float | None:
    """m/s, the highest clean entry speed into ISO 3888-2; 0 where none is clean, None where it was not driven."""
    track = _obstacle(cell.car, cell.profile) if task.entry_speeds and entry.compiled else None
    if track is None:
        return None
    found = entry_speed(track, cell.contender, driver, SPEEDS)
    return float(found.found.speed) if math.isfinite(found.found.speed) else 0.0


SPEEDS = tuple((np.arange(26.0, 91.0, 2.0) / 3.6).tolist())
"""m/s, the grid of entry speeds."""


def columns(cells: Sequence[Mapping[str, Any]]) -> dict[str, np.ndarray]:
    """The rows of all cells as columns; NaN where nothing was measured."""
    rows = [row for cell in cells for row in cell["rows"]]
    if not rows:
        raise InvalidInput("compare: no contender drove: see why each was left out.")
    made = {}
    for name in rows[0]:
        values = [row[name] for row in rows]
        texts = isinstance(values[0], str)
        made[name] = np.array(values) if texts else np.array([np.nan if v is None else v for v in values], dtype=float)
    return made

"""Runs of a comparison on cars, roads and profiles: the cells, and a folder that stores the finished ones.

A cell is the tuning and the test of one controller, or of one with a driver, on one car. The search for the tuning
drives the training roads a limited number of times. If the plant is costly, the search uses the car's twin
(`plant.twin_of`). The default and the tuned controller then drive the test roads with each noise seed; every such run
gives one row. Both also drive the obstacle avoidance of ISO 3888-2 at increasing entry speeds.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from adaptrack import __version__
from adaptrack.base import files
from adaptrack.base.errors import InvalidInput, MissingExtra, StorageError
from adaptrack.base.progress import ProgressCall
from adaptrack.cars.outline import Outline
from adaptrack.cars.plant import Plant, SteppedPlant, fingerprint, twin_of
from adaptrack.comparison.compare import RUN, Contender, as_column, check_fits, measure_runs
from adaptrack.comparison.config import (
    Cell,
    ComparisonConfig,
    ControllerSetting,
    about_contender,
    is_tuning_file,
    load_drive,
    load_setting,
)
from adaptrack.comparison.entry_speed import LaneChangeTest, entry_speed
from adaptrack.comparison.lane_change import iso_3888_2
from adaptrack.comparison.table import Comparison, label_of
from adaptrack.control.controllers import MPC, About, Controller
from adaptrack.control.estimation import Perception
from adaptrack.control.speed_control import SpeedControl
from adaptrack.core.library import kernels_hash
from adaptrack.drive.drivers import check_forces, make_driver
from adaptrack.drive.planner import PlannedController, make_planner
from adaptrack.drive.speed_measures import SPEED_MEASURES
from adaptrack.scenario import RoadDrive
from adaptrack.tuning.constant import load_tuning, search_constant
from adaptrack.tuning.pso import SwarmSettings, is_tunable
from adaptrack.tuning.runs import RunSet

# -- one cell ---------------------------------------------------------------------------------------------------------
MAX_PARTICLES = 20
"""Largest number of particles of a search. A small budget gets fewer particles, so that some generations are left."""
ASSUMED_SURFACE = Perception(friction=0.9)
"""Friction that controllers and drivers assume if the true one is compared."""


@lru_cache(maxsize=8)
def _run_sets(
    task: ComparisonConfig, car: str, profile: str, driver: str, friction: float | None
) -> tuple[ControllerSetting, RunSet | None, RunSet]:
    """Return the setting, the training runs (None without a budget) and the test runs of all controllers."""
    setting = load_setting(car, profile)
    mpc = MPC(setting.car, profile=setting.profile, preview=True)

    def load_runs(plant: Plant | SteppedPlant, names: Sequence[str], length: float, **options: Any) -> RunSet:
        drives = [load_drive(name, setting.car, length, task.duration, **options) for name in names]
        if (driver or any(options.values())) and not all(isinstance(drive, RoadDrive) for drive in drives):
            raise InvalidInput("roads: drivers, frictions, stops and a limit of the jerk need roads, not scenarios.")
        mover = make_driver(driver, setting.car) if driver else task.driver
        if driver and mover is not None:
            check_forces(plant)
        perception = None if friction is None else ASSUMED_SURFACE
        return RunSet(plant, mpc, drives, setting.profile, driver=mover, perception=perception)

    training = None
    if task.budget:
        plant = twin_of(setting.car) if setting.plant.costly else setting.plant
        training = load_runs(plant, task.training, task.training_length)
    options = {"friction": friction, "stops": task.stops, "jerk": task.jerk}
    return setting, training, load_runs(setting.plant, task.roads, task.length, **options)


@lru_cache(maxsize=4)
def _obstacle(car: str, profile: str) -> LaneChangeTest | None:
    """Return the obstacle avoidance of ISO 3888-2 for a car, or None if its plant is stepped in Python."""
    setting = load_setting(car, profile)
    if not isinstance(setting.plant, Plant):
        return None
    track = iso_3888_2(setting.car.outline.width)
    return LaneChangeTest(setting.car, setting.plant, track, setting.profile)


def run_cell(task: ComparisonConfig, cell: Cell) -> dict[str, Any]:
    """Tune and test one controller on one car in one profile; return values that JSON can represent.

    - `rows`: one for each test run;
    - `tunings`: default and best tuning;
    - `entry_speed`: highest clean entry speed (m/s) by label;
    - `not_entered`: reason why ISO 3888-2 was not driven;
    - `loops`: number of simulated drives of the search;
    - `seconds`: computation time (s);
    - `left_out`: reason why nothing was driven.

    Raises AdaptrackError when the car, the profile or a road cannot be loaded.
    """
    start_time = time.perf_counter()
    properties = about_contender(cell.contender)
    setting, training, test = _run_sets(task, cell.car, cell.profile, cell.driver, cell.friction)
    result: dict[str, Any] = {
        "rows": [], "tunings": {}, "entry_speed": {}, "not_entered": "", "loops": 0, "left_out": "",
    }  # fmt: skip
    try:
        controller, tuning = _make_controller(task, cell, setting)
        check_fits(Contender(cell.contender, controller), test)
    except (InvalidInput, MissingExtra) as error:
        return result | {"left_out": str(error), "seconds": 0.0}
    controllers = {tuning: controller}
    if training is not None and properties.tunable and is_tunable(controller):
        swarm = _swarm(task.budget, len(training) * len(task.training_seeds))
        best = search_constant(training, controller, swarm, noise_seeds=task.training_seeds)
        result["loops"] = swarm.evaluations * len(training) * len(task.training_seeds)
        result["tunings"] = {"default": best.default, "tuned": best.tuning}
        controllers["tuned"] = controller.with_tuning(best.tuning)
    name = load_tuning(cell.contender).controller if is_tuning_file(cell.contender) else cell.contender
    for tuning, controller in controllers.items():
        names = {"contender": cell.with_driver(name), "tuning": tuning, "car": cell.car, "profile": cell.condition}
        result["rows"] += [names | row for row in _test_rows(task, cell, test, controller, setting.car.outline)]
        try:
            result["entry_speed"][label_of(name, tuning)] = _entry_speed(task, cell, properties, controller)
        except InvalidInput as error:
            result["not_entered"] = str(error)
    return result | {"seconds": time.perf_counter() - start_time}


def _test_rows(
    task: ComparisonConfig, cell: Cell, test: RunSet, controller: Controller, outline: Outline
) -> list[dict[str, Any]]:
    """Return one row for each test run: road, noise seed and `MEASURES`, with a driver `SPEED_MEASURES` as well."""
    measures = (*MEASURES, *SPEED_MEASURES) if cell.driver else MEASURES
    if task.planner:
        speed: Any = test.driver if cell.driver else SpeedControl(controller.vehicle)  # drivers are speed controls
        controller = PlannedController(controller, speed, make_planner(task.planner))
    rows = measure_runs(test, controller, task.seeds, outline, with_driver=bool(cell.driver))
    return [
        {"road": road, "seed": seed, **{name: row[name] for name in measures}}
        for road, runs in zip(task.roads, rows, strict=True)
        for seed, row in zip(task.seeds, runs, strict=True)
    ]


def _make_controller(task: ComparisonConfig, cell: Cell, setting: ControllerSetting) -> tuple[Controller, str]:
    """Return the controller of a cell before any search, and its kind of tuning: "default", "scheduled" or a file.

    Raises InvalidInput when a scheduler or a tuning file belongs to a different car or profile, or its search used
    noise seeds of the test.
    """
    if not is_tuning_file(cell.contender):
        controller = setting.controller(cell.contender)
        return controller, "scheduled" if controller.scheduler else "default"
    file, profile = load_tuning(cell.contender), setting.profile
    mismatches = file.mismatches(setting.car.name, profile.name, profile.period)
    if set(file.noise_seeds) & set(task.seeds):
        mismatches.append("was found with noise seeds of this comparison")
    if mismatches:
        raise InvalidInput(f"{cell.contender}: {'; '.join(mismatches)}.")
    return file.make(setting.car, profile, profile.period, preview=True), cell.contender


MEASURES = ("cost", "failed", "reason", "failed_at", *RUN)
"""Measures of a run in the rows of a cell."""


def _swarm(budget: int, drives_per_tuning: int) -> SwarmSettings:
    """Return the settings of a swarm that simulates at most `budget` drives."""
    tunings = budget // drives_per_tuning
    particles = min(MAX_PARTICLES, max(5, round(math.sqrt(tunings))))
    return SwarmSettings(particles=particles, generations=max(1, tunings // particles))


def _entry_speed(task: ComparisonConfig, cell: Cell, properties: About, controller: Controller) -> float | None:
    """Return the highest clean entry speed into ISO 3888-2 (m/s), 0 if none is clean, None if it is not driven."""
    is_driven = task.entry_speeds and properties.compiled and not (cell.driver or cell.friction or task.planner)
    test = _obstacle(cell.car, cell.profile) if is_driven else None
    if test is None:
        return None
    speed = entry_speed(test, cell.contender, controller, ENTRY_SPEEDS).scan.speed
    return float(speed) if math.isfinite(speed) else 0.0


ENTRY_SPEEDS = tuple((np.arange(26.0, 91.0, 2.0) / 3.6).tolist())
"""Entry speeds that are driven (m/s)."""


# -- all cells --------------------------------------------------------------------------------------------------------
REFERENCES = ("informed, tuned", "informed, default")
"""Labels of preferred reference contenders. A comparison without them uses its first contender."""
COMPARISON_FORMAT, COMPARISON_VERSION, RUNS_FILE = "adaptrack comparison", 1, "runs.parquet"
MEASURE_UNITS = {"cost": "m^2", "failed_at": "s", **{name: unit for name, (_, unit) in RUN.items()}, **SPEED_MEASURES}
"""Units of the columns of a comparison; the others have none."""


@dataclass(frozen=True, eq=False)
class Compared:
    """Result of a comparison: all its runs."""

    task: ComparisonConfig
    cells: dict[Cell, dict[str, Any]]
    """Result of `run_cell` for each cell."""

    @cached_property
    def columns(self) -> dict[str, NDArray[Any]]:
        """The rows of all cells as columns by name, with NaN for missing measures.

        Raises
        ------
        InvalidInput
            When no cell has a row.
        """
        rows = [row for cell in self.cells.values() for row in cell["rows"]]
        if not rows:
            reasons = "; ".join(dict.fromkeys(cell["left_out"] for cell in self.cells.values()))
            raise InvalidInput(f"compare: no contender can drive here: {reasons}")
        return {name: as_column([row[name] for row in rows]) for name in rows[0]}

    @cached_property
    def profile_comparisons(self) -> dict[str, Comparison]:
        """The comparison of the runs in each profile, by `Cell.condition`."""
        columns = self.columns
        return {
            profile: Comparison.from_columns(
                {name: values[columns["profile"] == profile] for name, values in columns.items()}, REFERENCES
            )
            for profile in dict.fromkeys(columns["profile"].tolist())
        }

    @property
    def failed_runs(self) -> list[dict[str, Any]]:
        """The rows of the failed runs: contender, car, profile, road, noise seed, reason and time of failure (s)."""
        return [
            {
                "label": label_of(row["contender"], row["tuning"]),
                **{key: row[key] for key in ("car", "profile", "road", "seed", "reason", "failed_at")},
            }
            for cell in self.cells.values()
            for row in cell["rows"]
            if row["failed"]
        ]

    @property
    def left_out(self) -> dict[Cell, str]:
        """The cells that were not driven, with the reason."""
        return {cell: result["left_out"] for cell, result in self.cells.items() if result["left_out"]}

    def entry_speeds(self, profile: str) -> dict[str, dict[str, float]]:
        """Return the highest clean entry speed into ISO 3888-2 (m/s) by contender and car, 0 if none is clean."""
        speeds: dict[str, dict[str, float]] = {}
        for cell, result in self.cells.items():
            if cell.profile == profile:
                for label, speed in result["entry_speed"].items():
                    if speed is not None:
                        speeds.setdefault(label, {})[cell.car] = speed
        return speeds

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write all runs as rows of a Parquet file.

        Raises
        ------
        StorageError
            When the file cannot be written.
        """
        columns = [
            files.ParquetColumn(name, MEASURE_UNITS.get(name, "-"), values) for name, values in self.columns.items()
        ]
        metadata = {"task": self.task.model_dump(mode="json"), "adaptrack": __version__}
        files.write_atomically(path, files.encode_parquet(COMPARISON_FORMAT, COMPARISON_VERSION, columns, metadata))


def run_comparison(
    task: ComparisonConfig, out: str | os.PathLike[str] | None = None, *, progress: ProgressCall | None = None
) -> Compared:
    """Drive all cells of a comparison.

    Parameters
    ----------
    task
        Configuration of the comparison.
    out
        Folder for the results. Cells that it already contains for equal settings are read instead of driven.
    progress
        Function called with (cell, cells done, cells in all).

    Raises
    ------
    AdaptrackError
        When a car, a profile, a road or the folder cannot be used.
    """
    results = {}
    for number, cell in enumerate(task.cells):
        if progress is not None:
            progress(cell.label, number, len(task.cells))
        results[cell] = run_cell(task, cell) if out is None else _resume_cell(task, Path(out), cell)
    compared = Compared(task, results)
    if out is not None:
        compared.save(Path(out) / RUNS_FILE)
    return compared


def _resume_cell(task: ComparisonConfig, folder: Path, cell: Cell) -> dict[str, Any]:
    """Return the result of a cell that a folder contains for equal settings and software, or drive and store it."""
    software = {"adaptrack": __version__, "kernels": kernels_hash(), "numpy": np.__version__}
    text = json.dumps([_cell_settings(task, cell), software], sort_keys=True)
    identity = hashlib.sha256(text.encode()).hexdigest()
    file = folder / "cells" / f"{files.safe_name(cell.label)}.json"
    if file.exists():
        content = files.read_json(file)
        if not isinstance(content, Mapping) or set(content) != {"identity", "result"}:
            raise StorageError(f"{file}: not the file of a cell. Remove it to continue.")
        if content["identity"] == identity:
            return dict(content["result"])
    result = run_cell(task, cell)
    files.make_folder(file.parent)
    files.write_json(file, {"identity": identity, "result": result})
    return result


def _cell_settings(task: ComparisonConfig, cell: Cell) -> dict[str, Any]:
    """Return everything that the result of a cell depends on, except the software."""
    settings = task.model_dump(mode="json", exclude={"name", "contenders", "drivers", "cars", "profiles", "frictions"})
    setting = load_setting(cell.car, cell.profile)
    settings |= cell.entries | {
        "about_car": setting.car.model_dump(mode="json"), "about_profile": setting.profile.model_dump(mode="json"),
        "plant": fingerprint(setting.plant),
    }  # fmt: skip
    if is_tuning_file(cell.contender):
        settings["tuning_file"] = load_tuning(cell.contender).model_dump(mode="json")
    return settings

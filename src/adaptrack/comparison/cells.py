"""A cell of a comparison: one controller on one car in one profile, tuned, and judged on what no search has met.

The tuning is sought on the training roads with a given number of closed loops, for a plant that takes long on the car's
twin (`plant.twin_of`); then the default and the tuned controller drive the roads of the judgement with each noise seed,
and enter the obstacle avoidance of ISO 3888-2 as fast as they can. Every run gives one row.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from adaptrack.base.errors import InvalidInput, MissingExtra
from adaptrack.cars.outline import Outline
from adaptrack.cars.plant import Plant, SteppedPlant, twin_of
from adaptrack.comparison.compare import check_fits
from adaptrack.comparison.config import (
    Cell,
    ComparisonConfig,
    ControllerSetting,
    about_contender,
    is_tuning_file,
    load_drive,
    load_setting,
)
from adaptrack.comparison.contenders import Contender
from adaptrack.comparison.entry_speed import LaneChangeTest, entry_speed
from adaptrack.comparison.lane_change import iso_3888_2
from adaptrack.comparison.measures import RUN, as_column, measure_runs
from adaptrack.comparison.table import label_of
from adaptrack.control.controllers import MPC, About, Controller
from adaptrack.road import Road
from adaptrack.tuning.constant import seek_constant
from adaptrack.tuning.constant_file import load_tuning
from adaptrack.tuning.pso import SwarmSettings
from adaptrack.tuning.runs import RunSet
from adaptrack.tuning.spaces import is_tunable

MAX_PARTICLES = 20
"""Of a search; fewer for a small budget, so that the swarm has some generations."""


@lru_cache(maxsize=4)
def _run_sets(task: ComparisonConfig, car: str, profile: str) -> tuple[ControllerSetting, RunSet | None, RunSet]:
    """Setting, runs of the search (None without a budget) and runs of the judgement, shared by all controllers."""
    setting = load_setting(car, profile)
    mpc = MPC(setting.car, profile=setting.profile, preview=True)

    def load_runs(plant: Plant | SteppedPlant, names: Sequence[str], length: float) -> RunSet:
        drives = [load_drive(name, setting.car, length, task.duration) for name in names]
        return RunSet(plant, mpc, drives, setting.profile, driver=task.driver)

    training = None
    if task.budget:
        plant = twin_of(setting.car) if setting.plant.costly else setting.plant
        training = load_runs(plant, task.training, task.training_length)
    return setting, training, load_runs(setting.plant, task.roads, task.length)


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


def run_cell(task: ComparisonConfig, cell: Cell) -> dict[str, Any]:
    """Tune and judge one controller on one car in one profile.

    Returns
    -------
    dict
        Plain JSON: `rows`, one for each run; `tunings`; `entry_speed` (m/s) by label; `not_entered`: why ISO 3888-2 was
        not driven; `loops` of the search; `seconds`; `left_out`: why nothing was driven.

    Raises
    ------
    AdaptrackError
        When the car, the profile or a road cannot be loaded.
    """
    begun = time.perf_counter()
    entry = about_contender(cell.contender)
    setting, training, judgement = _run_sets(task, cell.car, cell.profile)
    result: dict[str, Any] = {
        "rows": [], "tunings": {}, "entry_speed": {}, "not_entered": "", "loops": 0, "left_out": "",
    }  # fmt: skip
    try:
        controller, tuning = _make_controller(task, cell, setting)
        check_fits(Contender(cell.contender, controller), judgement)
    except (InvalidInput, MissingExtra) as error:
        return result | {"left_out": str(error), "seconds": 0.0}
    drivers = {tuning: controller}
    if training is not None and entry.tunable and is_tunable(controller):
        swarm = _swarm(task.budget, len(training) * len(task.training_seeds))
        best = seek_constant(training, controller, swarm, noise_seeds=task.training_seeds)
        result["loops"] = swarm.evaluations * len(training) * len(task.training_seeds)
        result["tunings"] = {"default": best.default, "tuned": best.tuning}
        drivers["tuned"] = controller.with_tuning(best.tuning)
    name = load_tuning(cell.contender).controller if is_tuning_file(cell.contender) else cell.contender
    for tuning, driver in drivers.items():
        identity = {"contender": name, "tuning": tuning, "car": cell.car, "profile": cell.profile}
        result["rows"] += [identity | row for row in _judge(task, judgement, driver, setting.car.outline)]
        try:
            result["entry_speed"][label_of(name, tuning)] = _entry_speed(task, cell, entry, driver)
        except InvalidInput as error:
            result["not_entered"] = str(error)
    return result | {"seconds": time.perf_counter() - begun}


def _judge(task: ComparisonConfig, judgement: RunSet, driver: Controller, outline: Outline) -> list[dict[str, Any]]:
    """One row for each run of the judgement: road, noise seed and `MEASURES`."""
    return [
        {"road": road, "seed": seed, **{name: row[name] for name in MEASURES}}
        for road, runs in zip(task.roads, measure_runs(judgement, driver, task.seeds, outline), strict=True)
        for seed, row in zip(task.seeds, runs, strict=True)
    ]


def _make_controller(task: ComparisonConfig, cell: Cell, setting: ControllerSetting) -> tuple[Controller, str]:
    """The controller of a cell before any search, and the name of its tuning: default, scheduled, or a file.

    Raises
    ------
    InvalidInput
        When the controller or its tuning was made for another car or profile, or was tuned on noise of the judgement.
    """
    if not is_tuning_file(cell.contender):
        controller = setting.controller(cell.contender)
        return controller, "scheduled" if controller.scheduler else "default"
    file, profile = load_tuning(cell.contender), setting.profile
    faults = file.mismatches(setting.car.name, profile.name, profile.period)
    if set(file.noise_seeds) & set(task.seeds):
        faults.append("was found with noise seeds of this comparison")
    if faults:
        raise InvalidInput(f"{cell.contender}: {'; '.join(faults)}.")
    return file.make(setting.car, profile, profile.period, preview=True), cell.contender


MEASURES = ("cost", "failed", "reason", "failed_at", *RUN)
"""Measures of a run in the results."""


def _swarm(budget: int, loops: int) -> SwarmSettings:
    """A swarm that spends at most `budget` closed loops; a tuning takes `loops` of them."""
    tunings = budget // loops
    particles = min(MAX_PARTICLES, max(5, round(math.sqrt(tunings))))
    return SwarmSettings(particles=particles, generations=max(1, tunings // particles))


def _entry_speed(task: ComparisonConfig, cell: Cell, entry: About, driver: Controller) -> float | None:
    """m/s, the highest clean entry speed into ISO 3888-2; 0 where none is clean, None where it was not driven."""
    track = _obstacle(cell.car, cell.profile) if task.entry_speeds and entry.compiled else None
    if track is None:
        return None
    speed = entry_speed(track, cell.contender, driver, ENTRY_SPEEDS).scan.speed
    return float(speed) if math.isfinite(speed) else 0.0


ENTRY_SPEEDS = tuple((np.arange(26.0, 91.0, 2.0) / 3.6).tolist())
"""m/s, the grid of entry speeds."""


def columns(cells: Sequence[Mapping[str, Any]]) -> dict[str, NDArray[Any]]:
    """The rows of all cells as columns; NaN where nothing was measured."""
    rows = [row for cell in cells for row in cell["rows"]]
    if not rows:
        reasons = "; ".join(dict.fromkeys(cell["left_out"] for cell in cells))
        raise InvalidInput(f"compare: no contender can drive here: {reasons}")
    return {name: as_column([row[name] for row in rows]) for name in rows[0]}

"""Tune a controller on given roads, and judge the tuning with noise that the search did not use."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

from adaptrack.base.errors import InvalidInput
from adaptrack.comparison.compare import compare
from adaptrack.comparison.config import ControllerSetting, load_drive
from adaptrack.comparison.contenders import Contender
from adaptrack.comparison.table import Comparison
from adaptrack.control.controllers import MPC, Controller, about_controller, list_controllers
from adaptrack.drive.world import ROAD_DRIVER
from adaptrack.tuning.constant import Sought, seek_constant, swarm_within
from adaptrack.tuning.constant_file import ConstantTuning
from adaptrack.tuning.pso import SwarmSettings
from adaptrack.tuning.runs import RunSet
from adaptrack.tuning.spaces import search_space

SEARCH_SEEDS = (1000, 1001)
"""Noise seeds of the search; those of every judgement count from 0."""
JUDGEMENT_SEEDS = (0, 1, 2)
RANDOM_DRIVE_DURATION = 60.0
"""s of random drives."""


@dataclass(frozen=True, eq=False)
class TunedOnRoads:
    """A tuning that a search found on given roads."""

    file: ConstantTuning
    search: Sought
    judgement: Comparison
    """of the contenders "default" and "tuned" """
    loops: int
    """closed loops of the search"""
    seconds: float


def tune_on_roads(
    setting: ControllerSetting, roads: Sequence[str], controller: str, *, length: float = 2000.0,
    loops: int | None = None, prescribed_speed: bool = False, command: str = "",
    progress: Callable[[str, int, int], None] | None = None,
) -> TunedOnRoads:  # fmt: skip
    """Find the tuning of a controller with the lowest mean cost on given roads.

    Parameters
    ----------
    roads
        See `load_drive`.
    length
        m, of generated roads.
    controller
        Registered name.
    loops
        Closed loops that the search may drive; by default 300 tunings on each road and noise seed.
    prescribed_speed
        Whether the car follows its planned speed exactly, without forces along the road.
    command
        The command line, for the file.
    progress
        Called with (what, generations done, generations).

    Raises
    ------
    InvalidInput
        When the controller has no tuning to search, or the loops are too few.
    """
    show = progress or (lambda work, steps, of: None)
    begun = time.perf_counter()
    driver = _tunable_controller(setting, controller)
    drives = [load_drive(name, setting.car, length, RANDOM_DRIVE_DURATION) for name in dict.fromkeys(roads)]
    runs = RunSet(
        setting.plant, MPC(setting.car, profile=setting.profile, preview=True), drives, setting.profile,
        driver=None if prescribed_speed else ROAD_DRIVER,
    )  # fmt: skip
    loops_per_tuning = len(runs) * len(SEARCH_SEEDS)
    swarm = SwarmSettings() if loops is None else swarm_within(loops, loops_per_tuning)
    search = seek_constant(
        runs, driver, swarm, noise_seeds=SEARCH_SEEDS, progress=partial(show, f"tune {controller}")
    )  # fmt: skip
    show("speeds that the tuning can hold", 0, 1)
    file = ConstantTuning(
        controller=controller, belief=driver.belief_at_first, vehicle=setting.car.name, profile=setting.profile.name,
        period=setting.profile.period, roads=tuple(str(drive.name) for drive in drives), noise_seeds=SEARCH_SEEDS,
        command=command, tuning=search.tuning,
    ).holding(setting.car, setting.profile)  # fmt: skip
    pair = [Contender("default", driver), Contender("tuned", driver.with_tuning(search.tuning))]
    show("judgement", 0, 1)
    judgement = compare(runs, pair, JUDGEMENT_SEEDS, "default", outline=setting.car.outline)
    return TunedOnRoads(
        file, search, judgement, swarm.evaluations * loops_per_tuning, time.perf_counter() - begun
    )  # fmt: skip


def _tunable_controller(setting: ControllerSetting, name: str) -> Controller:
    """The controller with its default tuning; refused if it has no search space."""
    if not about_controller(name).tunable:
        tunable = ", ".join(other for other in list_controllers() if about_controller(other).tunable)
        raise InvalidInput(f"--controller {name}: its tuning is fixed; tunable controllers: {tunable}.")
    controller = setting.controller(name)
    search_space(controller)
    return controller

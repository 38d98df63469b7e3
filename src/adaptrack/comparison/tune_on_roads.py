"""Tuning of a controller for specified roads, and its test with noise that the search did not use."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

from adaptrack.base.errors import InvalidInput
from adaptrack.comparison.compare import Contender, compare
from adaptrack.comparison.config import ControllerSetting, load_drive
from adaptrack.comparison.table import Comparison
from adaptrack.control.controllers import MPC, Controller, about_controller, list_controllers
from adaptrack.drive.world import ROAD_DRIVER
from adaptrack.tuning.constant import ConstantSearch, ConstantTuning, search_constant, swarm_within
from adaptrack.tuning.pso import SwarmSettings, search_space
from adaptrack.tuning.runs import RunSet

SEARCH_SEEDS = (1000, 1001)
"""Noise seeds of the search. Tests use seeds from 0 upwards."""
TEST_SEEDS = (0, 1, 2)
"""Noise seeds of the test."""
RANDOM_DRIVE_DURATION = 60.0
"""Duration of random drives (s)."""


@dataclass(frozen=True, eq=False)
class TunedOnRoads:
    """Result of `tune_on_roads`."""

    file: ConstantTuning
    """Content of the tuning file."""
    search: ConstantSearch
    """Result of the search."""
    judgement: Comparison
    """Test of the contenders "default" and "tuned"."""
    loops: int
    """Number of simulated drives of the search."""
    seconds: float
    """Computation time (s)."""


def tune_on_roads(
    setting: ControllerSetting, roads: Sequence[str], controller: str, *, length: float = 2000.0,
    loops: int | None = None, prescribed_speed: bool = False, command: str = "",
    progress: Callable[[str, int, int], None] | None = None,
) -> TunedOnRoads:  # fmt: skip
    """Find the tuning of a registered controller with the lowest mean cost on roads, named as in `ComparisonConfig`.

    length: m, of generated roads; loops: largest number of simulated drives of the search, None for 300 tunings on each
    road with each noise seed; prescribed_speed: whether the car follows its planned speed exactly, without forces along
    the road; command: command line, which is stored in the file; progress: called with (stage, steps done, steps).
    Raises InvalidInput for a controller without a search space, or too few drives.
    """
    report = progress or (lambda stage, steps_done, steps: None)
    start_time = time.perf_counter()
    default_controller = _tunable_controller(setting, controller)
    drives = [load_drive(name, setting.car, length, RANDOM_DRIVE_DURATION) for name in dict.fromkeys(roads)]
    runs = RunSet(
        setting.plant, MPC(setting.car, profile=setting.profile, preview=True), drives, setting.profile,
        driver=None if prescribed_speed else ROAD_DRIVER,
    )  # fmt: skip
    loops_per_tuning = len(runs) * len(SEARCH_SEEDS)
    swarm = SwarmSettings() if loops is None else swarm_within(loops, loops_per_tuning)
    search = search_constant(
        runs, default_controller, swarm, noise_seeds=SEARCH_SEEDS, progress=partial(report, f"tune {controller}")
    )  # fmt: skip
    report("speeds at which the tuning is stable", 0, 1)
    file = ConstantTuning(
        controller=controller, belief=default_controller.belief_at_first, vehicle=setting.car.name,
        profile=setting.profile.name, period=setting.profile.period, roads=tuple(str(drive.name) for drive in drives),
        noise_seeds=SEARCH_SEEDS, command=command, tuning=search.tuning,
    ).with_holdable_speed(setting.car, setting.profile)  # fmt: skip
    tuned_controller = default_controller.with_tuning(search.tuning)
    contenders = [Contender("default", default_controller), Contender("tuned", tuned_controller)]
    report("test", 0, 1)
    judgement = compare(runs, contenders, TEST_SEEDS, "default", outline=setting.car.outline)
    return TunedOnRoads(
        file, search, judgement, swarm.evaluations * loops_per_tuning, time.perf_counter() - start_time
    )  # fmt: skip


def _tunable_controller(setting: ControllerSetting, name: str) -> Controller:
    """Return a controller with its default tuning; raises `InvalidInput` if it has no search space."""
    if not about_controller(name).tunable:
        tunable = ", ".join(other for other in list_controllers() if about_controller(other).tunable)
        raise InvalidInput(f"--controller {name}: its tuning is fixed; tunable controllers: {tunable}.")
    controller = setting.controller(name)
    search_space(controller)
    return controller

"""`adaptrack compare`: compare controllers on cars, roads and profiles with equal noise and equal tuning effort."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from adaptrack.base.errors import InvalidInput
from adaptrack.cli import note_progress, options, show
from adaptrack.cli.next_step import add_command, drive_words
from adaptrack.cli.options import argument, json_flag, option, option_group, option_words
from adaptrack.cli.road import ROADS_HELP

if TYPE_CHECKING:
    from adaptrack.base.result import Result
    from adaptrack.comparison.config import ComparisonConfig
    from adaptrack.comparison.run import Compared


@option_group
class CompareOptions:
    """Options of `adaptrack compare`."""

    road: list[str] | None = argument(
        "ROAD",
        "Test roads. country:3 is the country road with seed 3; lap:1@6 is driven with up to 6 m/s² lateral "
        f"acceleration. Also a scenario, {ROADS_HELP}",
        show_default=False,
    )
    controller: list[str] | None = option("NAME", "Controller: see `list controllers`; may be repeated.")
    tuning: list[str] | None = option("FILE", "Tuning file of `tune`; may be repeated.")
    vehicle: list[str] | None = option(
        "CAR[/PLANT]",
        "Car: see `list cars`, or a .toml file. PLANT: dual-track (default) or single-track. May be repeated.",
    )
    profile: list[str] | None = option("NAME", "See `list profiles`, or a .toml file; may be repeated.")
    driver: list[str] | None = option("NAME", "Driver of the speed, by forces: see `list drivers`; may be repeated.")
    planner: str | None = options.planner_option()
    budget: int | None = option("N", "Simulated runs per tuning search; 0: no search.", min=0)
    length: float | None = options.road_length_option()
    seeds: int | None = option("N", "Number of noise seeds in the test.", hidden=True, min=1, max=1000)
    config: str | None = option(
        "NAME", "See `list comparisons`, or a .toml file; default: `quick`; with ROAD `roads`, --driver `drivers`."
    )
    prescribed_speed: bool = options.prescribed_speed_flag()
    lane_change: Literal["iso3888-1", "iso3888-2"] | None = option(
        None, "Find the highest entry speed of this lane change without touching a cone."
    )
    out: Path | None = option("FOLDER", "Folder for the page and all runs; a repeated command continues in it.")
    plugin: list[str] | None = options.plugin_option()
    as_json: bool = json_flag()

    @property
    def changes(self) -> dict[str, Any]:
        """Fields of the configuration that options replace."""
        values = {
            "cars": self.vehicle, "roads": self.road, "profiles": self.profile, "length": self.length,
            "budget": self.budget, "seeds": None if self.seeds is None else list(range(self.seeds)),
            "prescribed_speed": self.prescribed_speed or None, "drivers": self.driver,
            "planner": self.planner,
        }  # fmt: skip
        return {key: value for key, value in values.items() if value is not None}


@options.grouped
def compare(settings: CompareOptions) -> None:
    """Compare controllers and drivers on roads, cars and profiles.

    All controllers drive the same roads with the same noise. With --budget, a search on training roads also
    tunes each controller. A controller ranks above another if the 95 % interval of their error ratio
    excludes 1; drivers have no rank. Failed runs are counted in the table; the exit code is 0.
    """
    options.load_plugins(settings.plugin)
    options.make_page_folder(settings.out)
    result = _compare_on_roads(settings) if settings.lane_change is None else _compare_lane_change(settings)
    show.say_result(result, settings.as_json, settings.out)


# -- roads ------------------------------------------------------------------------------------------------------------
def _compare_on_roads(settings: CompareOptions) -> Result:
    from adaptrack.comparison.run import run_comparison
    from adaptrack.results.compare import compare_drivers_result, compare_result

    task = _load_task(settings)
    loops, seconds = sum(map(task.loops, task.cells)), max(60.0, task.seconds(task.cells))
    size = f"{len(task.cells)} combinations, about {loops:,} simulated runs, about {show.duration(seconds)} on one core"
    show.say(f"adaptrack: {task.name}: {size}", aside=True)
    if settings.out is None:
        note_progress("Results are only saved with --out.")
    else:
        note_progress(f"Finished runs are in {settings.out}: run the command again to continue.")
    with show.progress("compare") as advance:
        compared = run_comparison(task, settings.out, progress=advance)
    make_result = compare_drivers_result if task.drivers else compare_result
    return add_command(make_result(compared), "compare", **_facts(settings, compared))


def _load_task(settings: CompareOptions) -> ComparisonConfig:
    """Load the configuration and apply the options."""
    from adaptrack.comparison.config import load_comparison
    from adaptrack.drive.drivers import check_driver_name

    default = "drivers" if settings.driver else "roads" if settings.road else "quick"
    name, changes = settings.config or default, settings.changes
    for driver in settings.driver or ():
        check_driver_name(driver)
    options.make_planner(settings.planner)
    if settings.controller or settings.tuning:
        controllers = settings.controller or load_comparison(name, **changes).contenders
        changes["contenders"] = [*controllers, *(settings.tuning or ())]
    return load_comparison(name, **changes)


def _facts(settings: CompareOptions, compared: Compared) -> dict[str, Any]:
    """Return the facts for the next command: first car and road, last profile and its best controller."""
    from adaptrack.comparison.table import standing_rows

    task, car, plant = compared.task, compared.task.cars[0], ""
    if re.search(r"/[\w-]+$", car):
        car, _, plant = car.rpartition("/")
    plant_words, plugins = (["--plant", plant] if plant else []), option_words(settings, "plugin")
    condition, comparison = list(compared.profile_comparisons.items())[-1]
    best = {} if task.drivers else standing_rows(comparison)[0]
    return {
        "has_drivers": task.drivers, "is_tuned": best.get("tuning") == "tuned", "best": best.get("contender"),
        "drive": [*drive_words(task.roads[0], settings.length), "--vehicle", car, *plant_words, *plugins],
        "tune": [car, "--road", task.roads[0], *plant_words], "plugins": plugins,
        "profile": task.profiles[-1] if task.drivers else condition.partition(", friction ")[0],
    }  # fmt: skip


# -- lane changes -----------------------------------------------------------------------------------------------------
def _compare_lane_change(settings: CompareOptions) -> Result:
    from adaptrack.comparison.entry_speed import compare_entry_speeds
    from adaptrack.results.lane_change import lane_change_result

    name = str(settings.lane_change)
    unused = {
        "ROAD": settings.road, "--tuning": settings.tuning, "--config": settings.config, "--length": settings.length,
        "--seeds": settings.seeds, "--budget": settings.budget, "--driver": settings.driver,
        "--planner": settings.planner,
    }  # fmt: skip
    options_without_use = [option for option, value in unused.items() if value]
    if options_without_use:
        raise InvalidInput(
            f"--lane-change {name}: {options_without_use[0]} has no effect: leave it out (--budget 0: do not tune)."
        )
    with show.progress(name) as advance:
        runs = list(compare_entry_speeds(
            name, settings.vehicle or ["paper"], settings.profile or ["road"], settings.controller,
            tuned=settings.budget != 0, progress=advance,
        ))  # fmt: skip
    car = (settings.vehicle or ["paper"])[0]
    return add_command(lane_change_result(name, runs), "compare --lane-change", car=car)

"""`adaptrack compare`: compare controllers on cars, roads and profiles with equal noise and equal tuning effort."""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Option

from adaptrack.base.errors import InvalidInput
from adaptrack.cli import interrupt, options, show
from adaptrack.cli.next_step import command, drive_words, next_line
from adaptrack.cli.road import ROADS_HELP

if TYPE_CHECKING:
    from adaptrack.base.result import Result
    from adaptrack.comparison.config import ComparisonConfig
    from adaptrack.comparison.run import Compared


class LaneChangeName(StrEnum):
    """Lane changes of ISO 3888."""

    iso3888_1 = "iso3888-1"
    iso3888_2 = "iso3888-2"


@dataclass(frozen=True, kw_only=True)
class CompareOptions:
    """Options of `adaptrack compare`."""

    road: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="ROAD", show_default=False,
            help="Test roads. country:3 is the country road with seed 3; lap:1@6 is driven with up to 6 m/s² lateral "
            f"acceleration. Also a scenario, {ROADS_HELP}",
        ),
    ] = None  # fmt: skip
    controller: Annotated[
        list[str] | None,
        Option("--controller", metavar="NAME", help="Controller: see `list controllers`; may be repeated."),
    ] = None
    tuning: Annotated[
        list[str] | None,
        Option("--tuning", metavar="FILE", help="Tuning file of `tune`; may be repeated."),
    ] = None
    vehicle: Annotated[
        list[str] | None,
        Option(
            "--vehicle",
            metavar="CAR[/PLANT]",
            help="Car: see `list cars`, or a .toml file. PLANT: dual-track (default) or single-track. May be repeated.",
        ),
    ] = None
    profile: Annotated[
        list[str] | None,
        Option("--profile", metavar="NAME", help="See `list profiles`, or a .toml file; may be repeated."),
    ] = None
    driver: Annotated[
        list[str] | None,
        Option("--driver", metavar="NAME", help="Driver of the speed, by forces: see `list drivers`; may be repeated."),
    ] = None
    budget: Annotated[
        int | None, Option("--budget", metavar="N", min=0, help="Simulated runs per tuning search; 0: no search.")
    ] = None
    length: Annotated[
        float | None, Option("--length", metavar="M", hidden=True, help="Length of generated roads (m); default: 2000.")
    ] = None
    seeds: Annotated[
        int | None,
        Option("--seeds", metavar="N", hidden=True, min=1, max=1000, help="Number of noise seeds in the test."),
    ] = None
    config: Annotated[
        str | None,
        Option(
            "--config", metavar="NAME",
            help="See `list comparisons`, or a .toml file; default: `quick`; with ROAD `roads`, --driver `drivers`.",
        ),
    ] = None  # fmt: skip
    prescribed_speed: options.PrescribedSpeed = False
    lane_change: Annotated[
        LaneChangeName | None,
        Option("--lane-change", help="Find the highest entry speed of this lane change without touching a cone."),
    ] = None
    out: Annotated[
        Path | None,
        Option("--out", metavar="FOLDER", help="Folder for the page and all runs; a repeated command continues in it."),
    ] = None
    plugin: options.Plugin = None
    as_json: options.Json = False

    @property
    def changes(self) -> dict[str, Any]:
        """Fields of the configuration that options replace."""
        values = {
            "cars": self.vehicle, "roads": self.road, "profiles": self.profile, "length": self.length,
            "budget": self.budget, "seeds": None if self.seeds is None else list(range(self.seeds)),
            "prescribed_speed": self.prescribed_speed or None, "drivers": self.driver,
        }  # fmt: skip
        return {key: value for key, value in values.items() if value is not None}


@options.grouped
def compare(settings: CompareOptions) -> None:
    """Compare controllers and drivers on roads, cars and profiles.

    All controllers drive the same roads with the same noise. With --budget, a search on training roads also
    tunes each controller. A controller ranks above another if the 95 % interval of their error ratio
    excludes 1; drivers have no rank. Failed runs are counted in the table; the exit code is 0.
    """
    from adaptrack.results.page import write_result

    options.load_plugins(settings.plugin)
    options.make_page_folder(settings.out)
    result = _compare_on_roads(settings) if settings.lane_change is None else _compare_lane_change(settings)
    page = None if settings.out is None else write_result(settings.out, result)
    show.say_result(result, settings.as_json, page)


# -- roads ------------------------------------------------------------------------------------------------------------
def _compare_on_roads(settings: CompareOptions) -> Result:
    from adaptrack.comparison.run import run_comparison
    from adaptrack.results.compare import compare_result
    from adaptrack.results.compare_drivers import compare_drivers_result

    task = _load_task(settings)
    loops, seconds = sum(map(task.loops, task.cells)), max(60.0, task.seconds(task.cells))
    size = f"{len(task.cells)} combinations, about {loops:,} simulated runs, about {show.duration(seconds)} on one core"
    show.say(f"adaptrack: {task.name}: {size}", aside=True)
    if settings.out is None:
        interrupt.note_progress("Results are only saved with --out.")
    else:
        interrupt.note_progress(f"Finished runs are in {settings.out}: run the command again to continue.")
    with show.progress("compare") as advance:
        compared = run_comparison(task, settings.out, progress=advance)
    make_result = compare_drivers_result if task.drivers else compare_result
    return make_result(compared, command=options.command_line(), next_step=next_line(*_next_step(settings, compared)))


def _load_task(settings: CompareOptions) -> ComparisonConfig:
    """Load the configuration and apply the options."""
    from adaptrack.comparison.config import load_comparison
    from adaptrack.drive.drivers import check_driver_name

    default = "drivers" if settings.driver else "roads" if settings.road else "quick"
    name, changes = settings.config or default, settings.changes
    for driver in settings.driver or ():
        check_driver_name(driver)
    if settings.controller or settings.tuning:
        controllers = settings.controller or load_comparison(name, **changes).contenders
        changes["contenders"] = [*controllers, *(settings.tuning or ())]
    return load_comparison(name, **changes)


def _next_step(settings: CompareOptions, compared: Compared) -> tuple[str, str]:
    """Suggest to drive or tune the best controller of the last profile on the first road with the first car."""
    from adaptrack.comparison.table import standing_rows

    task, plugins = compared.task, [word for name in settings.plugin or () for word in ("--plugin", name)]
    car, plant = task.cars[0], list[str]()
    if re.search(r"/[\w-]+$", car):
        car, _, name = car.rpartition("/")
        plant = ["--plant", name]
    drive = ("drive", *drive_words(task.roads[0], settings.length), "--vehicle", car, *plant, *plugins)
    if task.drivers:
        return "drive with the speed control", command(*drive, "--profile", task.profiles[-1], "--speed-control")
    condition, comparison = list(compared.profile_comparisons.items())[-1]
    best = standing_rows(comparison)[0]
    where = "--controller", best["contender"], "--profile", condition.partition(", friction ")[0]
    if best["tuning"] == "tuned":
        return "tune it for a road", command(
            "tune", car, "--road", task.roads[0], *plant, *where, *plugins, "--out", "tuned"
        )
    return "drive it", command(*drive, *where)


# -- lane changes -----------------------------------------------------------------------------------------------------
def _compare_lane_change(settings: CompareOptions) -> Result:
    from adaptrack.comparison.entry_speed import EntrySpeed, compare_entry_speeds
    from adaptrack.results.lane_change import lane_change_result

    name = str(settings.lane_change)
    unused = {
        "ROAD": settings.road,
        "--tuning": settings.tuning,
        "--config": settings.config,
        "--length": settings.length,
        "--seeds": settings.seeds,
        "--budget": settings.budget,
        "--driver": settings.driver,
    }
    options_without_use = [option for option, value in unused.items() if value]
    if options_without_use:
        raise InvalidInput(
            f"--lane-change {name}: {options_without_use[0]} has no effect: leave it out (--budget 0: do not tune)."
        )
    runs: list[EntrySpeed] = []
    with show.progress(name) as advance:
        for run in compare_entry_speeds(
            name, settings.vehicle or ["paper"], settings.profile or ["road"], settings.controller,
            tuned=settings.budget != 0, progress=advance,
        ):  # fmt: skip
            runs.append(run)
    drive = command("drive", "country", "--vehicle", (settings.vehicle or ["paper"])[0])
    return lane_change_result(name, runs, command=options.command_line(), next_step=next_line("drive a road", drive))

"""`adaptrack manoeuvre`: the lane changes of ISO 3888, driven by controllers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Option

from adaptrack.base.errors import InvalidInput
from adaptrack.cli import options, show
from adaptrack.cli.controllers import ControllerSettings, make_controller
from adaptrack.cli.next_step import again, command, say_next
from adaptrack.cli.show import Column

if TYPE_CHECKING:
    from adaptrack.cars.plant import Plant
    from adaptrack.cars.vehicle import Vehicle
    from adaptrack.comparison.entry_speed import EntrySpeed


class Name(StrEnum):
    """Lane changes of ISO 3888."""

    double_lane_change = "double-lane-change"
    obstacle_avoidance = "obstacle-avoidance"


CONTROLLERS = ("informed", "lqr", "pure-pursuit", "stanley")
"""Unless some are named."""
LANE_CHANGES = {
    "double-lane-change": ("iso-3888-1", range(60, 171, 2), 80.0),
    "obstacle-avoidance": ("iso-3888-2", range(24, 91), 45.0),
}
"""The track, the entry speeds (km/h) that are tried, and the one at which controllers are tuned, by name."""
TITLES = {
    "double-lane-change": "Double lane change, after ISO 3888-1",
    "obstacle-avoidance": "Obstacle avoidance, after ISO 3888-2",
}
COLUMNS = (
    Column("vehicle", "car"),
    Column("controller", "controller"),
    Column("clean", "clean to", "km/h", "whole"),
    Column("highest_clean", "highest", "km/h", "whole"),
    Column("tuned_clean", "tuned, to", "km/h", "whole"),
    Column("tuned_highest_clean", "highest", "km/h", "whole"),
)


@dataclass(frozen=True, kw_only=True)
class ManoeuvreOptions:
    """Options of `adaptrack manoeuvre`."""

    name: Annotated[Name, typer.Argument(metavar="NAME", show_choices=False, help="Which one, see above.")]
    vehicle: Annotated[
        list[str] | None,
        Option("--vehicle", metavar="CAR", help="Name (see `vehicles`) or .toml file, by default paper; several."),
    ] = None
    controller: Annotated[
        list[str] | None,
        Option("--controller", metavar="NAME", help="informed, lqr, pure-pursuit, stanley [default: all four], ..."),
    ] = None
    profile: options.Profile = "road"
    tune: Annotated[bool, Option("--tune/--no-tune", help="Also with a tuning searched on the track.")] = True
    friction: Annotated[float, Option("--friction", metavar="MU", help="Of all wheels.")] = 0.9
    plant: options.Plant = "dual-track"
    tyre: options.Tyre = None
    plugin: options.Plugin = None
    out: Annotated[Path | None, Option("--out", metavar="FOLDER", help="Folder for a picture of each car.")] = None
    as_json: options.Json = False


@options.grouped
def manoeuvre(given: ManoeuvreOptions) -> None:
    """Find the highest entry speed of a lane change.

    double-lane-change (part 1) and obstacle-avoidance (part 2), for several cars and controllers.
    """
    from adaptrack.comparison.entry_speed import LaneChangeTest, entry_speeds
    from adaptrack.comparison.lane_change import TRACKS
    from adaptrack.results.answers import of_lane_changes
    from adaptrack.scenario.profile import load_profile

    options.load_plugins(given.plugin)
    cars = [_compiled(given, name) for name in dict.fromkeys(given.vehicle or ["paper"])]
    track, grid, tune_at = LANE_CHANGES[given.name]
    if given.out is not None:
        options.make_folder(given.out)
    profile = load_profile(given.profile)
    rows: list[dict[str, Any]] = []
    pictures: list[Path] = []
    with show.progress(given.name, len(cars)) as advance:
        for car, plant in cars:
            test = LaneChangeTest(car, plant, TRACKS[track](car.outline.width), profile, given.friction)
            settings = ControllerSettings(car, profile, profile.period, preview=True)
            controllers = [make_controller(name, settings) for name in dict.fromkeys(given.controller or CONTROLLERS)]
            runs: list[EntrySpeed] = []
            speeds = [speed / 3.6 for speed in grid]
            for run in entry_speeds(test, controllers, speeds, tune_at / 3.6 if given.tune else None):
                runs.append(run)
                advance(car.name, min(len(runs), 2 * len(controllers) - 1), 2 * len(controllers))
            advance(car.name, 1, 1)
            rows += [run.row for run in runs]
            if given.out is not None:
                pictures.append(_draw(given.out, given.name, runs))
    if given.as_json:
        about = {"manoeuvre": given.name, "profile": profile.name, "tuned_at": tune_at if given.tune else None}
        show.say_json(about | {"rows": rows})
    else:
        show.say(of_lane_changes(rows))
        show.table(TITLES[given.name], COLUMNS if given.tune else COLUMNS[:4], _beside(rows))
        show.say(
            f"Clean to: all entry speeds of the grid up to there, {grid[1] - grid[0]:g} km/h apart, from {grid[0]:g};"
        )
        show.say("highest: of all that were tried. The worst of three noise seeds counts.")
        if given.tune:
            show.say(f"Tuned: the best of a small search at {tune_at:g} km/h, with other seeds.")
    for file in pictures:
        show.say(f"Picture: {file}", aside=given.as_json)
    if not given.as_json:
        say_next(*_next_step(given))


def _compiled(given: ManoeuvreOptions, name: str) -> tuple[Vehicle, Plant]:
    """A car and its plant, which must be compiled."""
    from adaptrack.cars.plant import Plant

    car, plant = options.car_and_plant(name, given.plant, given.tyre)
    if not isinstance(plant, Plant):
        raise InvalidInput(f"--plant {given.plant}: {given.name} needs a compiled plant, not one in Python.")
    return car, plant


def _next_step(given: ManoeuvreOptions) -> tuple[str, str]:
    """What to do after a lane change, and the command."""
    if given.out is None:
        return "to see the fastest clean runs as pictures", again("--out", str(given.name))
    return "to drive a road", command("drive", "country", "--vehicle", (given.vehicle or ["paper"])[0])


def _draw(out: Path, name: str, runs: Sequence[EntrySpeed]) -> Path:
    """One picture for a car: each controller where it is faster, with its own tuning or tuned."""
    from adaptrack.base.files import safe_names, write_atomically
    from adaptrack.results.draw import picture_png
    from adaptrack.results.lane_change import lane_change_picture

    best: dict[str, EntrySpeed] = {}
    for run in runs:
        before = best.get(run.name)
        if before is None or not math.isfinite(before.found.speed) or run.found.speed > before.found.speed:
            best[run.name] = run
    (file,) = safe_names([f"{name}-{runs[0].test.car.name}"])
    write_atomically(out / f"{file}.png", picture_png(lane_change_picture(list(best.values()))))
    return out / f"{file}.png"


def _beside(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """A row for each car and controller: with its own tuning, and beside it tuned."""
    lines: dict[tuple[str, str], dict[str, Any]] = {}
    shown = ("clean", "highest_clean")
    for row in rows:
        line = lines.setdefault(
            (row["vehicle"], row["controller"]),
            {"vehicle": row["vehicle"], "controller": row["controller"]} | {f"tuned_{key}": None for key in shown},
        )
        line |= {f"tuned_{key}" if row["tuned"] else key: row[key] for key in shown}
    return list(lines.values())

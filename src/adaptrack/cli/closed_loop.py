"""The manoeuvres of `adaptrack manoeuvre` that a controller drives: through cones, and from beside a path."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from adaptrack.base.errors import InvalidInput
from adaptrack.cli import options, show
from adaptrack.cli.show import Column
from adaptrack.cli.simulate import ControllerSettings, make_controller

if TYPE_CHECKING:
    from adaptrack.cars.plant import Plant
    from adaptrack.cars.vehicle import Vehicle
    from adaptrack.comparison.manoeuvres import EntrySpeed, LaneStart
    from adaptrack.control.controllers import Controller
    from adaptrack.scenario.profile import Profile

CONTROLLERS = ("informed", "lqr", "pure-pursuit", "stanley")
"""Unless some are named."""
LANE_CHANGES = {
    "double-lane-change": ("iso-3888-1", np.arange(60.0, 171.0, 2.0), 80.0),
    "obstacle-avoidance": ("iso-3888-2", np.arange(24.0, 91.0, 1.0), 45.0),
}
"""The track, the entry speeds (km/h) that are tried, and the one at which controllers are tuned, by name."""
TITLES = {
    "double-lane-change": "Double lane change, after ISO 3888-1",
    "obstacle-avoidance": "Obstacle avoidance, after ISO 3888-2",
    "curvature-step": "Step of curvature (our own)",
    "lane-drift": "Drift out of the lane, after Euro NCAP",
    "lane-recovery": "Recovery from beside the path (our own)",
}
SPEED_COLUMNS = (
    Column("vehicle", "car"),
    Column("controller", "controller"),
    Column("clean", "clean to", "km/h", "whole"),
    Column("highest_clean", "highest", "km/h", "whole"),
    Column("tuned_clean", "tuned, to", "km/h", "whole"),
    Column("tuned_highest_clean", "highest", "km/h", "whole"),
)
START_COLUMNS = (
    Column("vehicle", "car"),
    Column("controller", "controller"),
    Column("largest_corner", "corner", "m", 3),
    Column("crossing", "across", "m", 2),
    Column("settling_time", "settled", "s", 3),
    Column("last_offset", "end e", "m", 2),
    Column("largest_acceleration", "a_y", "m/s²", 3),
    Column("result", "result"),
)


@dataclass(frozen=True)
class ManoeuvreSettings:
    """What a closed-loop manoeuvre is driven with."""

    cars: Sequence[tuple[Vehicle, Plant]]
    controllers: Sequence[str]
    profile: Profile
    friction: float | None
    """None: 0.9"""
    tune: bool
    out: Path | None
    """folder for the pictures"""

    def controllers_of(self, car: Vehicle) -> list[tuple[str, Controller]]:
        """By name, in the profile, with preview."""
        settings = ControllerSettings(car, self.profile, self.profile.period, preview=True)
        return [make_controller(name, settings) for name in dict.fromkeys(self.controllers)]


def drive_lane_change(name: str, driven: ManoeuvreSettings, as_json: bool) -> None:
    """Find and print the highest clean entry speeds."""
    from adaptrack.comparison.manoeuvres import TRACKS, LaneChangeTest, entry_speeds
    from adaptrack.results.answers import of_lane_changes

    track_name, grid, tune_at = LANE_CHANGES[name]
    if driven.out is not None:
        options.make_folder(driven.out)
    rows: list[dict[str, Any]] = []
    pictures: list[Path] = []
    count = len(driven.cars)
    with show.progress(name, count) as advance:
        for car, plant in driven.cars:
            track = TRACKS[track_name](car.outline.width)
            test = LaneChangeTest(
                car, plant, track, driven.profile, 0.9 if driven.friction is None else driven.friction
            )
            controllers = driven.controllers_of(car)
            runs: list[EntrySpeed] = []
            speeds = [float(each) / 3.6 for each in grid]
            for run in entry_speeds(test, controllers, speeds, tune_at / 3.6 if driven.tune else None):
                runs.append(run)
                advance(car.name, min(len(runs), 2 * len(controllers) - 1), 2 * len(controllers))
            advance(car.name, 1, 1)
            rows += [run.row for run in runs]
            if driven.out is not None:
                pictures.append(_draw(driven.out, name, runs))
    if as_json:
        about = {"manoeuvre": name, "profile": driven.profile.name, "tuned_at": tune_at if driven.tune else None}
        show.say_json(about | {"rows": rows})
        _say_pictures(pictures, aside=True)
        return
    show.say(of_lane_changes(rows))
    show.table(TITLES[name], SPEED_COLUMNS if driven.tune else SPEED_COLUMNS[:4], _beside(rows))
    show.say(f"Clean to: all entry speeds of the grid up to there, {grid[1] - grid[0]:g} km/h apart, from {grid[0]:g};")
    show.say("highest: of all that were tried. The worst of three noise seeds counts.")
    if driven.tune:
        show.say(f"Tuned: the best of a small search at {tune_at:g} km/h, with other seeds.")
    _say_pictures(pictures, aside=False)


def _say_pictures(files: Sequence[Path], aside: bool) -> None:
    for file in files:
        show.say(f"Picture: {file}", aside=aside)


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


def drive_start(name: str, driven: ManoeuvreSettings, given: dict[str, float], as_json: bool) -> bool:
    """Drive and print a manoeuvre that starts beside a path or meets a step of curvature; whether all passed."""
    from adaptrack.comparison.manoeuvres import drive_lane_start
    from adaptrack.results.answers import of_starts

    if driven.out is not None:
        raise InvalidInput(f"--out has no meaning for {name}: leave it out.")
    rows = []
    with show.progress(name, len(driven.cars)) as advance:
        for car, plant in driven.cars:
            start = _start(name, car, given)
            if driven.friction is not None:
                start = _with_friction(start, driven.friction)
            for label, controller in driven.controllers_of(car):
                run = drive_lane_start(start, plant, controller, car.outline, driven.profile)
                rows.append({"vehicle": car.name, "controller": label} | run.row)
            advance(car.name, 1, 1)
    if as_json:
        about = {"manoeuvre": name, "profile": driven.profile.name, "speed": start.speed, "criterion": start.source}
        show.say_json(about | {"rows": rows})
    else:
        shown = [{**row, "result": row["failed"] or ("passed" if row["passed"] else "too far")} for row in rows]
        show.say(of_starts(rows))
        show.table(f"{TITLES[name]}: {start.speed:.3g} m/s, corner at most {start.limit:.3g} m", START_COLUMNS, shown)
        show.say(f"Criterion: {start.source}.")
        show.say("Settled: |e| within 0.1 m from then on. The worst of three noise seeds counts.")
    return all(row["passed"] for row in rows)


def _start(name: str, car: Vehicle, given: dict[str, float]) -> LaneStart:
    from adaptrack.comparison.manoeuvres import curvature_step_start, lane_drift, lane_recovery

    if name == "curvature-step":
        return curvature_step_start(given.get("radius", 50.0), speed=given.get("speed"))
    given_speed = {"speed": given["speed"]} if "speed" in given else {}
    return lane_drift(car.outline, **given_speed) if name == "lane-drift" else lane_recovery(car.outline, **given_speed)


def _with_friction(start: LaneStart, friction: float) -> LaneStart:
    from dataclasses import replace

    return replace(start, road=start.road.replace(friction=friction))

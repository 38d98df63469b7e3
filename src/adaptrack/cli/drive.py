"""`adaptrack drive`: along a road with controllers; the metrics, and a page that replays it."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Option

from adaptrack.cli import interrupt, options, show
from adaptrack.cli import road as roads
from adaptrack.cli.next_step import again, command, instead, say_next
from adaptrack.cli.simulate import (
    FAILED,
    ControllerSettings,
    keep_learned,
    learning_of,
    make_controller,
    measured_row,
    tell_belief,
    tell_learned,
    tell_open_qps,
    tell_stiffness,
)
from adaptrack.results.console import print_table

if TYPE_CHECKING:
    from adaptrack.cars.vehicle import Vehicle
    from adaptrack.control.controllers import Controller
    from adaptrack.control.models import PredictionModel
    from adaptrack.drive.predicted import PredictedPaths
    from adaptrack.drive.trajectory import Trajectory
    from adaptrack.road.holdable import HoldableSpeed
    from adaptrack.scenario import RoadDrive

SLOWER = 0.7
"""Times the speed, or the lateral acceleration, that is tried after a failure."""

SHOWN = (
    "rms_offset", "p95_offset", "max_offset", "max_corner", "max_corner_error", "in_lane", "max_acceleration",
    "max_jerk_r79", "prediction_error_half", "prediction_error_one", "step_us_p50", "step_us_p999",
)  # fmt: skip
"""Measures on the page."""
OTHER_UNITS = {"prediction_error_half": "m", "prediction_error_one": "m", "step_us_p50": "µs", "step_us_p999": "µs"}
"""Of those that are not `PathMetrics`."""


@dataclass(frozen=True, kw_only=True)
class DriveOptions:
    """Options of `adaptrack drive`."""

    road: roads.RoadName
    controller: Annotated[
        list[str] | None,
        Option(
            "--controller",
            metavar="NAME",
            help="informed [default], standard, lqr, pure-pursuit, stanley, or a registered one; may be repeated.",
        ),
    ] = None
    tuning: Annotated[
        list[Path] | None, Option("--tuning", metavar="FILE", help="Tuning that `tune` found; may be repeated.")
    ] = None
    car: options.CarAndPlant
    profile: options.Profile = "road"
    route: roads.RoadOptions
    laps: Annotated[int, Option("--laps", metavar="N", min=1, help="Of a closed road.")] = 1
    wind: Annotated[float, Option("--wind", metavar="V", hidden=True, help="Along the world's y axis (m/s).")] = 0.0
    start_offset: Annotated[
        float, Option("--start-offset", metavar="M", hidden=True, help="From the centre line, to the left (m).")
    ] = 0.0
    drive: options.DriveSettings


@options.grouped
def drive(given: DriveOptions) -> None:
    """Drive along a road: recorded, OpenDRIVE or generated.

    The speed is planned from curvature, friction and the car, unless --speed gives one. A drive that leaves the road,
    spins or is not finite is printed as FAILED; the exit code is then 3.
    """
    from adaptrack.base.files import safe_names
    from adaptrack.drive.predicted import PredictedPaths
    from adaptrack.drive.simulate import simulate
    from adaptrack.drive.world import Driver
    from adaptrack.results.road import limits_in_words
    from adaptrack.scenario import RoadDrive
    from adaptrack.scenario.profile import load_profile

    how, as_json = given.drive, given.drive.as_json
    car, plant = given.car.load()
    how.make_places()
    world = load_profile(given.profile)
    checked = given.route.look(given.road, car, world, _kept(given))
    route = RoadDrive(checked.road, checked.plan, laps=given.laps, wind=given.wind, start_offset=given.start_offset)
    settings = ControllerSettings(
        car, world, world.period if how.period is None else how.period, preview=True, learning=learning_of(how)
    )
    usual = [] if given.tuning else [settings.usual]
    controllers = [make_controller(name, settings) for name in dict.fromkeys(given.controller or usual)]
    for found in dict.fromkeys(given.tuning or []):
        controllers.append(tuned(found, settings))
        _certify_elsewhere(found, controllers[-1][1], settings, plant, how.allow_failed)
    checked.warn()
    files = safe_names(f"{route.name}-{label}" for label, _ in controllers)
    runs = []
    with show.progress("drive", len(controllers)) as advance:
        for file, (label, each) in zip(files, controllers, strict=True):
            step = partial(advance, label)
            paths = None if how.out is None else PredictedPaths()
            run = simulate(
                plant, each, route, profile=world, driver=Driver() if how.driver else None, seed=how.seed,
                predicted=paths, progress=step,
            )  # fmt: skip
            runs.append(_Run(label, route, car, run, each.model, paths))
            if how.out is not None:
                _keep(run, how.out / f"{file}.parquet")
    rows = [run.row for run in runs]
    failed = any(row["failed"] for row in rows)
    _print(route, rows, as_json)
    if not as_json and (words := limits_in_words(route.plan)):
        show.say(words)
    for label, each in controllers:
        tell_belief(label, each, plant, world, as_json)
        tell_learned(label, each, as_json)
    if failed:
        tell_stiffness(car, plant, as_json)
    else:
        keep_learned(how.learned, controllers, as_json)
    if how.out is not None:
        show.say(f"Page: {_write_page(how.out, runs, how.png)}", aside=as_json)
    if not as_json:
        assumed = any(each.learner is None and each.belief is not None and each.belief.is_cautious
                      for _, each in controllers)  # fmt: skip
        say_next(*_next_step(given, rows, checked.drivable, assumed))
    if failed and not how.allow_failed:
        raise typer.Exit(FAILED)


def _next_step(given: DriveOptions, rows: Sequence[dict[str, Any]], drivable: bool, assumed: bool) -> tuple[str, str]:
    """What to do after a drive, and the command; drivable: the road, for this car; assumed: the steering's delay."""
    route, how = given.route, given.drive
    here = ("--vehicle", given.car.vehicle, *route.words)
    away = any(row["failed"] or row.get("in_lane", 1.0) < 1.0 for row in rows)
    if away and not drivable:
        return "to see what of the road cannot be driven", command("road", "check", given.road, *here)
    if away and route.speed is not None:
        return "to stay in the lane, drive more slowly", instead("--speed", round(SLOWER * route.speed, 1))
    if away:
        comfort = SLOWER * (3.0 if route.lateral_acceleration is None else route.lateral_acceleration)
        return "to stay in the lane, drive more slowly", instead("--lateral-acceleration", round(comfort, 2))
    if assumed and not (how.learn or how.learned):
        return "as nobody says how late the steering is, let it be learned", again("--learn")
    if how.out is None:
        return "to see the drive on a page", again("--out", "drive")
    if given.tuning:
        judged = ("--vehicle", given.car.vehicle, "--profile", given.profile, "--tuning", given.tuning[0])
        return "to judge the tuning with other noise", command("compare", given.road, *judged)
    best = min(rows, key=lambda row: row["mse"])["controller"]
    where = ("--profile", given.profile, "--controller", best, "--out", "tuned")
    return f"tune {best} for this road", command("tune", given.car.vehicle, "--road", given.road, *where)


def _kept(given: DriveOptions) -> HoldableSpeed | None:
    """What the first tuning's file says of the speeds that it holds."""
    from adaptrack.tuning.constant_file import load_tuning

    return next((load_tuning(file).holds for file in given.tuning or []), None)


def tuned(file: Path, settings: ControllerSettings) -> tuple[str, Controller]:
    """The controller of a tuning's file, and how tables call it; a word where it was found for something else."""
    from adaptrack.tuning.constant_file import load_tuning

    kept = load_tuning(file)
    for clause in kept.mismatches(settings.car.name, settings.profile.name, settings.period):
        show.say(f"Warning, {file}: {clause}.", aside=True)
    loop = settings.period, settings.preview, settings.computation
    return kept.label(file), kept.make(settings.car, settings.profile, *loop)


def _certify_elsewhere(
    file: Path, controller: Controller, settings: ControllerSettings, plant: Any, allowed: bool
) -> None:
    """The certificate of an MPC's constant that was found for another car, see `new_car`."""
    from adaptrack.cli.new_car import judge
    from adaptrack.control.controllers import MPC
    from adaptrack.tuning.constant_file import load_tuning

    made_for, car = load_tuning(file).vehicle, settings.car
    if made_for != car.name and isinstance(controller, MPC):
        clause = f"{file}, found for the car {made_for!r}, on {car.name!r}"
        judge(clause, controller.tuning, (controller, plant, car, settings.profile), allowed)


def _keep(run: Trajectory, file: Path) -> None:
    """Save a drive as soon as it is driven."""
    run.save(file)
    interrupt.kept(f"Finished drives are in {file.parent}, without a page. Run the command again.")


@dataclass(frozen=True)
class _Run:
    """A drive of one controller."""

    label: str
    route: RoadDrive
    car: Vehicle
    run: Trajectory
    model: PredictionModel | None
    """of the controller, if it has one"""
    predicted: PredictedPaths | None
    """for the page, if there is to be one"""

    @property
    def found_in(self) -> str:
        """Of a tuning, from which file; empty for other controllers."""
        _, comma, file = self.label.partition(", ")
        return comma + file

    @cached_property
    def row(self) -> dict[str, Any]:
        """What --json says of it: as `simulate`, with the measures of a path."""
        import numpy as np

        from adaptrack.drive.path_metrics import PathRecord, path_metrics

        record = PathRecord.from_trajectory(self.run)
        measures = {} if record is None else path_metrics(record, self.car.outline).to_dict()
        station = self.run.road["station"]
        row = measured_row(self.label, self.run, self.model) | measures
        if record is not None:
            row |= {"rms_error": measures["rms_offset"], "max_abs_error": measures["max_offset"]}
        known = station[np.isfinite(station)]
        row["driven_length"] = float(known[-1] - known[0]) if known.size else 0.0
        row["road_length"] = self.route.length
        return row


def _print(route: RoadDrive, rows: Sequence[dict[str, Any]], as_json: bool) -> None:
    from adaptrack.results.answers import length, of_drives
    from adaptrack.results.drive import console_table
    from adaptrack.results.road import limits_record

    for row in rows:
        if row["failed"]:
            show.say_failed(
                f"{route.name}, {row['controller']}: at {row['failed_at']:.2f} s, s = {row['driven_length']:.0f} m, "
                f"the vehicle {row['failed_because']}.",
                aside=as_json,
            )
    if as_json:
        show.say_json({"rows": rows, "limits": limits_record(route.plan)})
    else:
        if not all(row["failed"] for row in rows):
            show.say(of_drives(rows, length(route.length)))
        title = f"{route.name}, {route.length:.0f} m, {route.plan.speed.min():.3g}-{route.plan.speed.max():.3g} m/s"
        print_table(console_table(title, rows))
    for row in rows:
        tell_open_qps(row, as_json)


def _write_page(out: Path, runs: Sequence[_Run], png: bool) -> Path:
    from adaptrack.drive.failure import find_failure
    from adaptrack.drive.path_metrics import PathMetrics
    from adaptrack.results.drive import write_drive_page
    from adaptrack.results.record import DriveRecord, Measure

    units = {each.name: each.metadata["unit"] for each in dataclasses.fields(PathMetrics)} | OTHER_UNITS
    with show.progress("write the page"):
        records = []
        for each in runs:
            row = each.row
            measures = [Measure(name, row[name], units[name]) for name in SHOWN if row.get(name) is not None]
            failed = find_failure(each.run)
            record = DriveRecord.from_trajectory(
                each.run, each.route.road, each.car, failed=failed, metrics=measures, predicted=each.predicted
            )
            records.append(dataclasses.replace(record, controller=record.controller + each.found_in))
        return write_drive_page(out, records, command=options.command_line(), png=png)

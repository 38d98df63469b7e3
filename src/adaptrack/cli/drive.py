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
from adaptrack.cli.show import Column
from adaptrack.cli.simulate import (
    FAILED,
    Asked,
    asked_learning,
    keep_learned,
    make_controller,
    measured_row,
    tell_belief,
    tell_open_qps,
    tell_stiffness,
)

if TYPE_CHECKING:
    from adaptrack.cars.vehicle import Vehicle
    from adaptrack.control.controllers import Controller
    from adaptrack.control.models import PredictionModel
    from adaptrack.drive.trajectory import Trajectory
    from adaptrack.scenario import RoadDrive

COLUMNS = (
    Column("controller", "controller"),
    Column("rms_error", "RMS e", "m", show.digits(3)),
    Column("max_abs_error", "max |e|", "m", show.digits(3)),
    Column("max_corner_error", "corner", "m", show.digits(3)),
    Column("in_lane", "in lane", "%", show.percent),
    Column("max_acceleration", "max a_y", "m/s²", show.digits(3)),
    Column("driven_length", "driven", "m", show.whole),
    Column("result", "result"),
)

SHOWN = (
    "rms_offset", "p95_offset", "max_offset", "max_corner", "in_lane", "max_acceleration", "max_jerk_r79",
    "prediction_error_half", "prediction_error_one", "step_us_p50", "step_us_p999",
)  # fmt: skip
"""Measures on the page."""
OTHER_UNITS = {"prediction_error_half": "m", "prediction_error_one": "m", "step_us_p50": "µs", "step_us_p999": "µs"}
"""Of those that are not `PathMetrics`."""

Tunings = Annotated[
    list[Path] | None, Option("--tuning", metavar="FILE", help="Tuning that `tune ROAD` found; may be repeated.")
]


@options.grouped
def drive(
    road: roads.RoadName,
    asked: roads.RoadOptions,
    vehicle: options.Vehicle = "paper",
    controller: Annotated[
        list[str] | None,
        Option(metavar="NAME", help="informed [default], standard, lqr, pure-pursuit, stanley, or a registered one."),
    ] = None,
    tuning: Tunings = None,
    profile: options.Profile = "road",
    laps: Annotated[int, Option("--laps", min=1, help="Of a closed road.")] = 1,
    wind: Annotated[float, Option("--wind", help="Along the world's y axis (m/s).")] = 0.0,
    offset: Annotated[float, Option("--start-offset", help="From the centre line, to the left (m).")] = 0.0,
    heading: Annotated[float, Option("--start-heading", help="Against the road, to the left (rad).")] = 0.0,
    plant: options.Plant = "dual-track",
    tyre: options.Tyre = None,
    driver: Annotated[bool, Option("--driver/--perfect-speed", help="Powertrain and driver, or exact speed.")] = False,
    period: Annotated[float | None, Option(help="Control period (s); by default the profile's.")] = None,
    learn: options.Learn = False,
    learned: options.LearnedFile = None,
    seed: Annotated[int, Option("--seed", help="Of the sensor noise.")] = 0,
    out: Annotated[Path | None, Option(help="Folder for the page with the replay, and the trajectories.")] = None,
    png: options.Png = False,
    allow_failed: Annotated[
        bool,
        Option(
            "--allow-failed",
            help=f"Exit code 0, not {FAILED}, after a failure; drives a --tuning that is unstable on this car.",
        ),
    ] = False,
    plugin: options.Plugin = None,
    as_json: options.Json = False,
) -> None:
    """Drive along a road: a .csv file of x, y, an OpenDRIVE file, or a generated one.

    The speed is planned from curvature, friction and the car, unless --speed gives one. A drive that leaves the road,
    spins or is not finite is printed as FAILED; the exit code is then 3.
    """
    from adaptrack.base.files import safe_names
    from adaptrack.drive.simulate import simulate
    from adaptrack.drive.world import Driver
    from adaptrack.scenario import RoadDrive
    from adaptrack.scenario.profile import load_profile

    options.load_plugins(plugin)
    car, body = options.car_and_plant(vehicle, plant, tyre)
    options.make_page_folder(out, png)
    options.make_place(learned)
    seen = asked.look(road, car)
    world = load_profile(profile)
    trip = RoadDrive(seen.road, seen.plan, laps=laps, wind=wind, start_offset=offset, start_heading=heading)
    who = Asked(car, world, world.period if period is None else period, preview=True,
                learning=asked_learning(learn, learned))  # fmt: skip
    usual = [] if tuning else [who.usual]
    controllers = [make_controller(name, who) for name in dict.fromkeys(controller or usual)]
    for found in dict.fromkeys(tuning or []):
        controllers.append(tuned(found, who, as_json))
        _certify_elsewhere(found, controllers[-1][1], who, body, (allow_failed, as_json))
    seen.warn(as_json)
    files = safe_names(f"{trip.name}-{label}" for label, _ in controllers)
    runs = []
    with show.progress("drive", len(controllers)) as advance:
        for file, (label, each) in zip(files, controllers, strict=True):
            step = partial(advance, label)
            run = simulate(body, each, trip, profile=world, driver=Driver() if driver else None, seed=seed,
                           progress=step)  # fmt: skip
            runs.append(_Run(label, trip, car, run, each.model))
            if out is not None:
                _keep(run, out / f"{file}.parquet")
    rows = [run.row for run in runs]
    if not any(row["failed"] for row in rows):
        keep_learned(learned, controllers, as_json)
    if out is not None:
        show.say(f"Page: {_write_page(out, runs, png)}", aside=as_json)
    _print(trip, rows, as_json)
    for label, each in controllers:
        tell_belief(label, each, body, world, as_json)
    if any(row["failed"] for row in rows):
        tell_stiffness(car, body, as_json)
        if not allow_failed:
            raise typer.Exit(FAILED)


def tuned(file: Path, who: Asked, aside: bool) -> tuple[str, Controller]:
    """The controller of a tuning's file, and how tables call it; a word where it was found for something else."""
    from adaptrack.tuning.constant_file import load_tuning

    kept = load_tuning(file)
    for clause in kept.mismatches(who.car.name, who.profile.name, who.period):
        show.say(f"Warning, {file}: {clause}.", aside=aside)
    return kept.label(file), kept.make(who.car, who.profile, who.period, who.preview)


def _certify_elsewhere(file: Path, controller: Controller, who: Asked, body: Any, said: tuple[bool, bool]) -> None:
    """The certificate of an MPC's constant that was found for another car; said: allowed, aside, see `new_car`."""
    from adaptrack.cli.new_car import judge
    from adaptrack.control.controllers import MPC
    from adaptrack.tuning.constant_file import load_tuning

    made_for = load_tuning(file).vehicle
    if made_for != who.car.name and isinstance(controller, MPC):
        clause = f"{file}, found for the car {made_for!r}, on {who.car.name!r}"
        judge(clause, controller.tuning, (controller, body, who.car, who.profile), *said)


def _keep(run: Trajectory, file: Path) -> None:
    """Save a drive as soon as it is driven."""
    run.save(file)
    interrupt.kept(f"Finished drives are in {file.parent}, without a page. Run the command again.")


@dataclass(frozen=True)
class _Run:
    """A drive of one controller."""

    label: str
    trip: RoadDrive
    car: Vehicle
    run: Trajectory
    model: PredictionModel | None
    """of the controller, if it has one"""

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
        row["road_length"] = self.trip.length
        return row


def _print(trip: RoadDrive, rows: Sequence[dict[str, Any]], as_json: bool) -> None:
    if as_json:
        show.say_json({"rows": rows})
    else:
        title = f"{trip.name}, {trip.length:.0f} m, {trip.plan.speed.min():.3g}-{trip.plan.speed.max():.3g} m/s"
        show.table(title, COLUMNS, [{**row, "result": "failed" if row["failed"] else "ok"} for row in rows])
    for row in rows:
        if row["failed"]:
            show.say_failed(
                f"{trip.name}, {row['controller']}: at {row['failed_at']:.2f} s, s = {row['driven_length']:.0f} m, "
                f"the vehicle {row['failed_because']}.",
                aside=as_json,
            )
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
            record = DriveRecord.from_trajectory(each.run, each.trip.road, each.car, failed=failed, metrics=measures)
            records.append(dataclasses.replace(record, controller=record.controller + each.found_in))
        return write_drive_page(out, records, command=options.command_line(), png=png)

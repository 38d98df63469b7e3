"""`adaptrack drive`: simulate drives through scenarios or along a road; print measures and write a page."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

import adaptrack as at
from adaptrack.base.errors import InvalidInput
from adaptrack.base.result import Column, Result, ResultTable
from adaptrack.cli import controllers, note_progress, options, show
from adaptrack.cli.next_step import next_line
from adaptrack.cli.options import flag, json_flag, option, option_group, option_words
from adaptrack.cli.places import DrivenPlaces, PlaceOptions

if TYPE_CHECKING:
    from adaptrack.results import Run

STIFFNESS_MISMATCH = 1.25
"""Ratio of tyre stiffness to model stiffness from which the notes of a failed run mention it."""


@option_group
class DriveSettings:
    """Options for the simulation of a closed loop and for the saved files."""

    prescribed_speed: bool = options.prescribed_speed_flag()
    speed_control: bool = flag("Road: control the speed, with governor and stops.")
    planner: str | None = options.planner_option()
    period: float | None = option("S", "Control period (s); default: the profile's.", hidden=True)
    learn: bool = flag("Learn steering delay and bias, and tyre stiffness.")
    learned: Path | None = option("FILE", "Like --learn; start from this TOML file and update it.")
    seed: int = options.noise_seed_option()
    out: Path | None = option("FOLDER", "Folder for the page and the trajectories.")
    png: bool = flag("With --out: also write the pictures as PNG files.", hidden=True)
    allow_failed: bool = flag("Exit with code 0 after a failed run, and also drive unstable loops.", hidden=True)
    as_json: bool = json_flag()


@option_group
class DriveOptions:
    """Options of `adaptrack drive`."""

    controller: list[str] | None = option(
        "NAME", "See `list controllers`; also standard (published MPC); may be repeated; default: informed."
    )
    tuning: list[Path] | None = option("FILE", "Tuning file of `tune`; may be repeated.")
    scheduler: str | None = options.scheduler_option()
    car: options.CarAndPlant
    place: PlaceOptions
    published: controllers.PublishedOptions
    drive: DriveSettings


@options.grouped
def drive(arguments: DriveOptions) -> None:
    """Simulate drives through scenarios or along a road.

    On a road, the speed is planned for the car unless --speed sets it. A run fails if the car leaves the road or spins,
    or if a value is not finite. The exit code is then 3.
    """
    from adaptrack.tuning.constant import load_tuning

    settings = arguments.drive
    car, plant = arguments.car.load()
    options.make_page_folder(settings.out, settings.png)
    options.make_place(settings.learned)
    places = arguments.place.load(car, load_tuning(arguments.tuning[0]).holds if arguments.tuning else None)
    loop = DrivenLoop(car, plant, places, _make_controllers(arguments, places, car, plant))
    places.warn(car)
    runs = list(_drive(settings, loop, arguments.place.route.assumed_interval))
    rows = [measured_row(run, places) for run in runs]
    failed = any(row["failed"] for row in rows)
    for row in rows:
        if row["failed"]:
            where = "" if row["driven_length"] is None else f", s = {row['driven_length']:.0f} m,"
            failure = f"at {row['failed_at']:.2f} s{where} the vehicle {row['failed_because']}"
            show.say_failed(f"{row['scenario']}, {row['controller']}: {failure}.", aside=settings.as_json)
    result = _result(arguments, loop, runs, rows)
    show.say_result(result, settings.as_json, settings.out, png=settings.png)
    if not failed:
        controllers.save_learned(settings.learned, loop.drivers, settings.as_json)
    if failed and not settings.allow_failed:
        raise typer.Exit(options.EXIT_FAILED)


@dataclass(frozen=True)
class DrivenLoop:
    """Car model of the controllers, simulated plant, scenarios or road, and controllers with their labels."""

    car: at.Vehicle
    plant: Any
    places: DrivenPlaces
    drivers: Sequence[tuple[str, at.Controller]]


# -- controllers and runs ---------------------------------------------------------------------------------------------
def _make_controllers(
    arguments: DriveOptions, places: DrivenPlaces, car: at.Vehicle, plant: Any
) -> list[tuple[str, at.Controller]]:
    """Make the controllers with their labels; certify those that were made for a different car."""
    world, published, scheduler = places.profile, arguments.published, arguments.scheduler
    preview = True if places.road is not None else world.preview
    settings = controllers.ControllerSettings(
        car=car, profile=world, tuning=published.tuning, moves=published.make_moves(), solver=published.solver,
        period=world.period if arguments.drive.period is None else arguments.drive.period,
        preview=preview if published.preview is None else published.preview,
        schedule=None if scheduler is None else at.load_scheduler(scheduler),
        label="" if scheduler is None else Path(scheduler).stem if scheduler.endswith(".json") else scheduler,
        learning=controllers.make_learning(arguments.drive.learn, arguments.drive.learned),
    )  # fmt: skip
    default = [] if arguments.tuning else [settings.default_name]
    drivers: list[tuple[str, Any]] = [
        controllers.make_controller(name, settings) for name in dict.fromkeys(arguments.controller or default)
    ]
    for label, controller in drivers:
        if controller.has_horizons:
            controllers.certify_meeting(label, controller, plant, car, world, arguments.drive.allow_failed)
    for file in dict.fromkeys(arguments.tuning or []):
        drivers.append(controllers.make_tuned(file, settings))
        controllers.certify_tuned(file, drivers[-1][1], settings, plant, arguments.drive.allow_failed)
    return drivers


def _make_driver(
    settings: DriveSettings, loop: DrivenLoop, friction: tuple[float, float] | None
) -> at.Driver | at.SpeedControl | None:
    """Return what moves the car along its plan; None for a prescribed speed.

    Speed control and planner need a road whose speed is not prescribed, else InvalidInput is raised.
    """
    from adaptrack.drive.world import ROAD_DRIVER

    if not settings.speed_control and settings.planner is None:
        return None if settings.prescribed_speed else ROAD_DRIVER
    if settings.prescribed_speed or loop.places.road is None:
        name = "--speed-control" if settings.planner is None else "--planner"
        raise InvalidInput(
            f"{name}: needs a road, and forces that move the car: name a road, without --prescribed-speed."
        )
    return at.SpeedControl(loop.car) if friction is None else at.SpeedControl(loop.car, friction=friction)


def _drive(settings: DriveSettings, loop: DrivenLoop, friction: tuple[float, float] | None) -> Iterator[Run]:
    """Simulate all drives with all controllers; save each trajectory at once.

    friction: interval that driver and schedules assume, these its lower end; None for that of the road.
    """
    from adaptrack.base.files import safe_names
    from adaptrack.drive.planner import PlannedController
    from adaptrack.drive.predicted_paths import PredictedPaths
    from adaptrack.results import Run

    places, out = loop.places, settings.out
    perception = None if friction is None else at.Perception(friction=friction[0])
    driver = _make_driver(settings, loop, friction)
    planner = options.make_planner(settings.planner)
    pairs = [(drive, *labelled) for drive in places.drives for labelled in loop.drivers]
    files = safe_names(f"{drive.name}-{label}" for drive, label, _ in pairs)
    where = f"their trajectories are in {out}, without a page" if out else "nothing was written"
    with show.progress("drive", len(pairs)) as advance:
        for i, (file, (drive, label, controller)) in enumerate(zip(files, pairs, strict=True), 1):
            paths = None if out is None or places.road is None else PredictedPaths()
            in_loop: at.Controller = controller
            if planner is not None and isinstance(driver, at.SpeedControl):
                in_loop = PlannedController(controller, driver, planner)
            run = at.simulate(
                loop.plant, in_loop, drive, profile=places.profile, driver=driver, perception=perception,
                seed=settings.seed, predicted=paths, progress=partial(advance, f"{drive.name}, {label}"),
            )  # fmt: skip
            if out is not None:
                run.save(out / f"{file}.parquet")
            note_progress(f"{i} of {len(pairs)} runs were finished; {where}. Run the command again.")
            measures = at.compute_metrics(run, model=controller.model, outline=loop.car.outline)
            road, plan = (None, None) if places.road is None else (places.road.road, places.road.plan)
            yield Run(run, label, measures, road, loop.car, paths, None if driver is None else plan)


# -- output -----------------------------------------------------------------------------------------------------------
def measured_row(run: Run, places: DrivenPlaces) -> dict[str, Any]:
    """Return a run for --json: its conditions, `failed` (reason or null), `failed_at` (s) and its measures."""
    import numpy as np

    trajectory, meta = run.trajectory, run.trajectory.meta
    measures = run.measures.as_row()
    del measures["failed"]
    reason, clause = measures.pop("failed_reason"), measures.pop("failed_because")
    stations = trajectory.road.get("station", np.empty(0))
    finite = stations[np.isfinite(stations)]
    return {
        "scenario": trajectory.name_of("scenario"),
        "controller": run.label,
        **{key: trajectory.name_of(key) for key in ("vehicle", "plant", "tyre")},
        **{key: meta[key] for key in ("profile", "preview", "speed", "seed")},
        "period": trajectory.period,
        **{key.lower(): value for key, value in meta["tuning"].items()},
        **{key: meta["control"].get(key) for key in ("moves", "scheduler", "solver", "belief", "learning")},
        "failed": reason or None,
        "failed_at": measures.pop("failed_at"),
        "failed_because": clause or None,
        "driven_length": float(finite[-1] - finite[0]) if finite.size else None,
        "road_length": None if places.road is None else places.drives[0].length,  # type: ignore[union-attr]
        **measures,
        **{key: None if value is None or not math.isfinite(value) else value for key, value in run.following.items()},
        "stops": [{**stop._asdict(), "error": None if math.isnan(stop.error) else stop.error} for stop in run.stops],
    }


def _result(arguments: DriveOptions, loop: DrivenLoop, runs: Sequence[Run], rows: Sequence[dict[str, Any]]) -> Result:
    """Return the result with learned quantities, notes on speed, steering and QPs, and the next command."""
    from adaptrack.results.drive import drive_result
    from adaptrack.results.road import limits_in_words, limits_record

    result = drive_result(runs, rows, command=options.command_line())
    plan = None if loop.places.road is None else loop.places.road.plan
    notes = [] if plan is None else [limits_in_words(plan)]
    notes += [note for label, controller in loop.drivers for note in _steering_notes(label, controller, loop)]
    notes += [
        f"{row['scenario']}, {row['controller']}: {row['qp_capped'] + row['qp_failed']:,} of {row['driven']:,} QPs "
        "not solved."
        for row in rows if row["qp_capped"] + row["qp_failed"]
    ]  # fmt: skip
    notes += _stiffness_notes(loop) if result.failed else []
    tables = [_learned_table(*labelled) for labelled in loop.drivers if labelled[1].learner is not None]
    limits = None if plan is None else limits_record(plan)
    return replace(
        result, tables=[*result.tables, *tables], notes=[note for note in notes if note],
        record={"rows": rows, "limits": limits}, next_step=next_line("drive", **_facts(arguments, loop, rows)),
    )  # fmt: skip


def _learned_table(label: str, controller: Any) -> ResultTable:
    """Return a table of the learned quantities with their intervals."""
    columns = (
        Column("quantity", "quantity"), Column("value", "value", "", 3), Column("low", "90 % from", "", 3),
        Column("high", "to", "", 3), Column("unit", "unit"),
    )  # fmt: skip
    car = controller.learned()
    title = f"Learned by {label} in {car.seconds:.0f} s; learning state: {controller.belief_in_words}"
    return ResultTable(f"{label} learned", title, columns, [row._asdict() for row in car.intervals], brief=True)


def _steering_notes(label: str, controller: at.Controller, loop: DrivenLoop) -> list[str]:
    """Describe the controller's steering model, and the simulated steering if it differs."""
    belief, profile = controller.belief, loop.places.profile
    if belief is None:
        return []
    learns = f" {controller.learns}; it starts from" if controller.learner is not None else ""
    notes = [f"Steering model of the controller {label}:{learns} {belief}."]
    actuator = getattr(loop.plant, "steering", None) or profile.steering
    delay = profile.delay * controller.period + actuator.dead_time
    simulated = (actuator.lag, delay, actuator.rate)
    if not all(map(math.isclose, (belief.lag.value, belief.delay, belief.rate.value), simulated)):
        notes.append(
            f"The simulated steering differs: lag {actuator.lag:.4g} s, {delay:.4g} s from measurement to wheels, "
            f"rate {actuator.rate:.4g} rad/s."
        )
    return notes


def _stiffness_notes(loop: DrivenLoop) -> list[str]:
    """Suggest a remedy if tyre and model of a failed car differ in stiffness."""
    car, tyre = loop.car, getattr(loop.plant, "tyre", None)
    if tyre is None:
        return []
    from adaptrack.core.maths import portable  # NumPy, which --help does not need

    if max(abs(portable.log(factor)) for factor in car.stiffness_factors(tyre)) < portable.log(STIFFNESS_MISMATCH):
        return []
    matched = car.matched_to(tyre)
    return [
        f"The stiffness of car {car.name!r} is {car.stiffness_front:.0f} N/rad (front tyre) and "
        f"{car.stiffness_rear:.0f} N/rad (rear tyre), but that of the simulated tyre {tyre.name!r} is "
        f"{matched.stiffness_front:.0f} and {matched.stiffness_rear:.0f} N/rad. Write these values to "
        "stiffness_front and stiffness_rear in the car file (in Python: car.matched_to(tyre)), or choose another tyre."
    ]


def _facts(arguments: DriveOptions, loop: DrivenLoop, rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return the facts for the next command."""
    place, checked, car = arguments.place, loop.places.road, arguments.car
    is_off_lane = checked is not None and any(row["failed"] or (row.get("in_lane") or 0.0) < 1.0 for row in rows)
    best = min(rows, key=lambda row: math.inf if row["mse"] is None else row["mse"])["controller"]
    road = None if checked is None else _comparable_road(arguments)
    profile, tunings = option_words(place, "profile"), arguments.tuning or []
    return {
        "is_blocked": is_off_lane and checked and not checked.drivable, "is_off_lane": is_off_lane,
        "has_no_page": arguments.drive.out is None, "is_scenario": checked is None, "scheduler": arguments.scheduler,
        "has_tuning": road and tunings, "is_tunable": road and _is_tunable(best, loop),
        "road": place.names[0], "route": option_words(place.route), "slower": place.route.slower,
        "test_road": road, "vehicle": car.vehicle, "plant": car.plant, "car": option_words(car),
        "profile": profile, "tuning": tunings[:1], "best": best, "seed": arguments.drive.seed + 1,
        "loop": [
            *profile, *option_words(place.route, "length"), *option_words(arguments.drive, "prescribed_speed"),
            *option_words(car, "plugin"),
        ],
    }  # fmt: skip


def _comparable_road(arguments: DriveOptions) -> str | None:
    """The road with its seed and comfort as `tune` and `compare` name it; None where they lack an option of it."""
    place, settings = arguments.place, arguments.drive
    seed, lateral = place.route.road_seed, place.route.lateral_acceleration
    route = replace(place.route, road_seed=None, lateral_acceleration=None, length=None)
    unknown = (place.laps, place.wind, place.start_offset, arguments.car.tyre, settings.period, settings.learned)
    if option_words(route) or any(value is not None for value in unknown) or option_words(arguments.published):
        return None
    if settings.speed_control or settings.planner is not None or settings.learn:
        return None
    return f"{place.names[0]}{f':{seed}' if seed else ''}{'' if lateral is None else f'@{lateral:g}'}"


def _is_tunable(name: str, loop: DrivenLoop) -> bool:
    """Whether `tune` accepts a driven controller by its label."""
    from adaptrack.control.controllers import about_controller
    from adaptrack.tuning.pso import is_tunable

    return name in at.list_controllers() and about_controller(name).tunable and is_tunable(dict(loop.drivers)[name])

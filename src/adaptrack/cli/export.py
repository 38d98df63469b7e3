"""`adaptrack export`: export controllers as a C library, as FMUs, and as a page for the browser."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import typer

import adaptrack as at
from adaptrack.base.errors import InvalidInput
from adaptrack.cli import options, show
from adaptrack.cli import road as roads
from adaptrack.cli.next_step import say_next
from adaptrack.cli.options import flag, json_flag, option, option_group

app = typer.Typer(
    help="Export controllers: C library, FMUs, page for the browser.", no_args_is_help=True, rich_markup_mode=None
)


@option_group
class ExportedController:
    """Options for the exported controller and the road of its recorded drive."""

    controller: str | None = option("NAME", "Controller: see `list controllers`; default: informed.")
    tuning: Path | None = option("FILE", "Tuning file of `tune`.")
    scheduler: str | None = options.scheduler_option()
    car: options.CarAndPlant
    road: str = option("ROAD", f"Road of the recorded drive: {roads.ROADS_HELP}", "country")
    road_seed: int | None = option("N", "Seed of a generated road.")
    speed: float | None = option("V", "Constant speed (m/s); default: planned.")
    speed_control: bool = flag("Export the speed control too: acceleration, force, stops at planned places.")
    assumed_friction: str | None = options.assumed_friction_option()
    profile: str = options.profile_option("road")
    learn: bool = flag("Let the informed controller learn; default if the car file has no lag and dead time.")
    learned: Path | None = option("FILE", "Like --learn, starting from this TOML file.")

    @property
    def route(self) -> roads.RoadOptions:
        """The options of the road."""
        return roads.RoadOptions(speed=self.speed, road_seed=self.road_seed, assumed_friction=self.assumed_friction)

    def make_speed_control(self, car: at.Vehicle) -> at.SpeedControl | None:
        """Make the speed control; None without --speed-control, which an assumed friction needs."""
        friction = self.route.assumed_interval
        if self.speed_control:
            return at.SpeedControl(car) if friction is None else at.SpeedControl(car, friction=friction)
        if friction is not None:
            raise InvalidInput("--assumed-friction: is an assumption of the speed control; add --speed-control.")
        return None

    def make(self, car: at.Vehicle, world: at.Profile, computation: float | None = None) -> at.Controller:
        """Make the controller; computation: computation time (s), by default that of the profile."""
        from adaptrack.cli.controllers import ControllerSettings, make_controller, make_learning, make_tuned

        if self.tuning is not None and (self.controller or self.scheduler):
            raise InvalidInput(
                "--tuning: the tuning file names its controller; leave out --controller and --scheduler."
            )
        if self.learned is not None and not self.learned.exists():
            raise InvalidInput(f"--learned {self.learned}: the file does not exist; `drive --learned` writes it.")
        settings = ControllerSettings(
            car, world, world.period, preview=True,
            learning=make_learning(self.learn or self._has_unknown_delay(car), self.learned),
            schedule=None if self.scheduler is None else at.load_scheduler(self.scheduler),
            label=self.scheduler or "", computation=computation,
        )  # fmt: skip
        if self.tuning is not None:
            return make_tuned(self.tuning, settings)[1]
        return make_controller(self.controller or settings.default_name, settings)[1]

    def _has_unknown_delay(self, car: at.Vehicle) -> bool:
        """Whether neither the options nor the car file determine the steering delay; the profile only simulates one."""
        if self.tuning or self.learned or self.scheduler or self.controller not in (None, "informed"):
            return False
        return car.steering is None or car.steering.lag is None or car.steering.dead_time is None


# -- C library --------------------------------------------------------------------------------------------------------
@app.command("c")
@options.grouped
def export_c(
    *,
    out: Path = option("FOLDER", "Folder for the library.", ...),
    exported: ExportedController,
    computation: float = option(
        "S", "Time from calling the library until it returns the command (s).", 0.0, min=0.0, max=1.0
    ),
    planner: bool = flag("Follow a planner's trajectories too: their times, replans, silence and fallback."),
    room: tuple[int, int] | None = option(
        "NP NC", "Largest horizons of constants that the library may load later.", hidden=True
    ),
    as_json: bool = json_flag(),
) -> None:
    """Export a controller as a C library.

    The folder contains C99 sources, the constants of the controller, and a recorded drive of one minute. The command
    make check in the folder compiles the sources and verifies that they repeat this drive. The export itself needs no
    compiler. The library needs neither Python nor adaptrack.
    """
    from dataclasses import asdict

    from adaptrack.export.tracking import refuse

    car, plant = exported.car.load()
    world = at.load_profile(exported.profile)
    controller = exported.make(car, world, computation)
    speed = exported.make_speed_control(car)
    refuse(controller)
    options.make_folder(out)
    checked = exported.route.look(exported.road, car, world)
    with show.progress("record a drive"):
        files = at.export_c(
            controller, out, road=checked.road, plan=checked.plan, plant=plant, profile=world, room=room, speed=speed,
            following=at.Following() if planner else None,
        )  # fmt: skip
    if as_json:
        show.say_json({**asdict(files), "folder": str(files.folder), "backups": list(map(str, files.backups))})
        return
    show.say(f"{controller.name}: {files.folder}")
    show.say(
        f"Constants {files.constants_size:,} bytes, tracker {files.memory_size:,}, saved state {files.state_size:,}."
    )
    if speed is not None:
        low, high = speed.friction_interval
        interval = f" to {high:g}" if high > low else ""
        show.say(f"Speed control: assumed friction {low:g}{interval}.")
    if controller.belief_at_first:
        show.say(f"Steering model: {controller.belief_at_first}.")
    if files.failed:
        show.say(f"Warning: on the recorded drive, {files.failed}. Lower --speed, or choose a different --road.")
    show.say_backups(files.backups)
    say_next("export c", folder=files.folder)


# -- FMUs -------------------------------------------------------------------------------------------------------------
@app.command("fmu")
@options.grouped
def export_fmu(
    *,
    out: Path = option("FOLDER", "Folder for car.fmu and controller.fmu.", ...),
    exported: ExportedController,
    fmi: Literal["2.0", "3.0"] = option(None, "Version of the Functional Mock-up Interface.", "3.0"),
    platform: list[str] | None = option(
        "NAME", "Platform of a binary: linux, linux-aarch64, windows, macos; default: this one; may be repeated."
    ),
    prescribed_speed: bool = options.prescribed_speed_flag(),
    planner: bool = flag("Follow a planner's trajectories too, which are inputs of the controller."),
    trajectory_points: int = option("N", "Points of a trajectory at most, with --planner.", 100, min=2, max=1000),
    as_json: bool = json_flag(),
) -> None:
    """Export a controller and a car as two FMUs for co-simulation.

    The FMUs need neither Python nor adaptrack. The compiler of the package ziglang makes their binaries, at the first
    export for a platform.
    """
    from adaptrack.export import fmu_build
    from adaptrack.export.fmu import write_fmu
    from adaptrack.export.units import car_unit, controller_unit

    platforms = tuple(dict.fromkeys(platform or (fmu_build.own_platform(),)))
    fmu_build.check_platforms(platforms)
    car, plant = exported.car.load()
    world = at.load_profile(exported.profile)
    controller = exported.make(car, world)
    checked = exported.route.look(exported.road, car, world)
    route = at.RoadDrive(checked.road, checked.plan)
    speed = exported.make_speed_control(car)
    driver = speed or (None if prescribed_speed else at.Driver())
    preview = driver.preview if isinstance(driver, at.Driver) else None
    units = (
        controller_unit(
            controller, checked.road, checked.plan, speed_preview=preview, speed=speed,
            following=at.Following() if planner else None, trajectory_points=trajectory_points,
        ),
        car_unit(plant, route, profile=world, driver=driver, period=controller.period),  # type: ignore[arg-type]
    )  # fmt: skip
    options.make_folder(out)
    files = [out / f"{unit.name}.fmu" for unit in units]
    with show.progress("compile"):
        for name in platforms:
            fmu_build.binary(name)
    with show.replacing(*files, aside=as_json):
        for unit, file in zip(units, files, strict=True):
            write_fmu(unit, file, fmi, platforms)
    if as_json:
        names = list(map(str, files))
        show.say_json({"files": names, "fmi": fmi, "period": controller.period, "platforms": platforms})
        return
    show.say(f"FMI {fmi}, for {' and '.join(platforms)}, a step is {controller.period:g} s")
    for unit, file in zip(units, files, strict=True):
        show.say(f"{file}: {unit.title}, {file.stat().st_size:,} bytes")


# -- page -------------------------------------------------------------------------------------------------------------
@app.command("page")
@options.grouped
def export_page(
    *,
    out: Path = option("FILE", "HTML file of the page.", ...),
    vehicle: str = options.vehicle_option("midsize-sedan"),
    road: str = option("ROAD", f"oval, {roads.ROADS_HELP}", "mountain"),
    speed: float | None = options.speed_option(),
    lateral_acceleration: float | None = options.lateral_acceleration_option(),
    profile: str = option("NAME", "paper, road, production or production-bus.", "road"),
    controller: list[str] | None = option(
        "NAME", "One or two of informed, learning, published, lqr, ...; default: informed."
    ),
    seed: int = options.noise_seed_option(),
    planner: str | None = options.planner_option(),
    as_json: bool = json_flag(),
) -> None:
    """Export an interactive simulation as one HTML file.

    The page runs the kernels of adaptrack in the browser, without Python and without a network connection. The options
    are the initial settings; you can change all of them on the page.
    """
    options.make_place(out, ".html")
    with show.replacing(out, aside=as_json):
        page = at.export_page(
            out, vehicle=vehicle, road=road, speed=speed, lateral_acceleration=lateral_acceleration, profile=profile,
            controllers=controller or ["informed"], seed=seed,
            planner=options.make_planner(planner),
        )  # fmt: skip
    size = page.stat().st_size
    if as_json:
        show.say_json({"file": str(page), "bytes": size})
        return
    show.say(f"{page}: {size:,} bytes")
    say_next("export page", page=page)

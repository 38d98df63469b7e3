"""`adaptrack export c`: export a controller as a C library that needs neither Python nor adaptrack."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Option

from adaptrack.base.errors import InvalidInput
from adaptrack.cli import options, show
from adaptrack.cli import road as roads
from adaptrack.cli.next_step import next_line

if TYPE_CHECKING:
    from adaptrack.cars.vehicle import Vehicle
    from adaptrack.control.controllers import Controller
    from adaptrack.control.speed_control import SpeedControl
    from adaptrack.scenario.profile import Profile

app = typer.Typer(
    help="Export controllers: C library, FMUs, page for the browser.", no_args_is_help=True, rich_markup_mode=None
)


@dataclass(frozen=True, kw_only=True)
class ExportedController:
    """Options for the exported controller and the road of its recorded drive."""

    controller: Annotated[
        str | None,
        Option("--controller", metavar="NAME", help="Controller: see `list controllers`; default: informed."),
    ] = None
    tuning: Annotated[Path | None, Option("--tuning", metavar="FILE", help="Tuning file of `tune`.")] = None
    scheduler: Annotated[
        str | None,
        Option("--scheduler", metavar="NAME", help="Schedule: see `list schedules`, or a .json file of `paper train`."),
    ] = None
    car: options.CarAndPlant
    road: Annotated[str, Option("--road", metavar="ROAD", help=f"Road of the recorded drive: {roads.ROADS_HELP}")] = (
        "country"
    )
    road_seed: Annotated[int | None, Option("--road-seed", metavar="N", help="Seed of a generated road.")] = None
    speed: Annotated[float | None, Option("--speed", metavar="V", help="Constant speed (m/s); default: planned.")] = (
        None
    )
    speed_control: Annotated[
        bool,
        Option("--speed-control", help="Export the speed control too: acceleration, force, stops at planned places."),
    ] = False
    assumed_friction: options.AssumedFriction = None
    profile: options.ProfileOption = "road"
    learn: Annotated[
        bool,
        Option(
            "--learn",
            help="Let the informed controller learn; default if the car file has no lag and dead time.",
        ),
    ] = False
    learned: Annotated[
        Path | None, Option("--learned", metavar="FILE", help="Like --learn, starting from this TOML file.")
    ] = None

    def checked_road(self, car: Vehicle, world: Profile) -> roads.CheckedRoad:
        """Load and check the road and its speed plan."""
        return self._road_options.look(self.road, car, world)

    @property
    def _road_options(self) -> roads.RoadOptions:
        return roads.RoadOptions(speed=self.speed, road_seed=self.road_seed, assumed_friction=self.assumed_friction)

    def make_speed_control(self, car: Vehicle) -> SpeedControl | None:
        """Make the speed control; None without --speed-control.

        Raises
        ------
        InvalidInput
            When a friction is assumed without it.
        """
        from adaptrack.control.speed_control import SpeedControl

        friction = self._road_options.assumed_interval
        if self.speed_control:
            return SpeedControl(car) if friction is None else SpeedControl(car, friction=friction)
        if friction is not None:
            raise InvalidInput("--assumed-friction: is an assumption of the speed control; add --speed-control.")
        return None

    def make(self, car: Vehicle, world: Profile, computation: float | None = None) -> Controller:
        """Make the controller; computation: computation time (s), by default that of the profile.

        Raises
        ------
        InvalidInput
            When the options contradict each other.
        """
        from adaptrack.cli.controllers import ControllerSettings, make_controller, make_learning, make_tuned
        from adaptrack.control.scheduling import load_scheduler

        if self.tuning is not None and (self.controller or self.scheduler):
            raise InvalidInput(
                "--tuning: the tuning file names its controller; leave out --controller and --scheduler."
            )
        if self.learned is not None and not self.learned.exists():
            raise InvalidInput(f"--learned {self.learned}: the file does not exist; `drive --learned` writes it.")
        settings = ControllerSettings(
            car, world, world.period, preview=True,
            learning=make_learning(self.learn or self._has_unknown_delay(car), self.learned),
            schedule=None if self.scheduler is None else load_scheduler(self.scheduler),
            label=self.scheduler or "", computation=computation,
        )  # fmt: skip
        if self.tuning is not None:
            return make_tuned(self.tuning, settings)[1]
        return make_controller(self.controller or settings.default_name, settings)[1]

    def _has_unknown_delay(self, car: Vehicle) -> bool:
        """Whether neither the options nor the car file determine the steering delay; the profile only simulates one."""
        if (
            self.tuning is not None
            or self.learned is not None
            or self.scheduler
            or self.controller not in (None, "informed")
        ):
            return False
        return car.steering is None or car.steering.lag is None or car.steering.dead_time is None


@dataclass(frozen=True, kw_only=True)
class ExportOptions:
    """Options of `adaptrack export c`."""

    out: Annotated[Path, Option("--out", metavar="FOLDER", help="Folder for the library.")]
    exported: ExportedController
    computation: Annotated[
        float,
        Option(
            "--computation",
            metavar="S",
            min=0.0,
            max=1.0,
            help="Time from calling the library until it returns the command (s).",
        ),
    ] = 0.0
    target: Annotated[
        list[str] | None,
        Option("--target", metavar="NAME", help="Target processor; default: this computer; may be repeated."),
    ] = None
    objects: Annotated[
        Path | None,
        Option(
            "--objects",
            metavar="FOLDER",
            help="Folder with kernels of other processors; `make targets` builds them in a source checkout.",
        ),
    ] = None
    room: Annotated[
        tuple[int, int] | None,
        Option(
            "--room",
            metavar="NP NC",
            hidden=True,
            help="Largest horizons of constants that the library may load later.",
        ),
    ] = None
    as_json: options.Json = False


@app.command("c")
@options.grouped
def export_c(arguments: ExportOptions) -> None:
    """Export a controller as a C library.

    The folder contains a C header, compiled kernels, the constants of the controller, and a recorded drive of one
    minute. The command make check in the folder verifies that the library repeats this drive. You need no compiler for
    the export. The library needs neither Python nor adaptrack.
    """
    from dataclasses import asdict

    from adaptrack.export.c_library import export_c as export
    from adaptrack.export.c_library import kernel_files
    from adaptrack.export.tracking import refuse
    from adaptrack.scenario.profile import load_profile

    car, plant = arguments.exported.car.load()
    world = load_profile(arguments.exported.profile)
    controller = arguments.exported.make(car, world, arguments.computation)
    speed = arguments.exported.make_speed_control(car)
    refuse(controller)
    kernel_files(arguments.target or (), arguments.objects)
    options.make_folder(arguments.out)
    checked = arguments.exported.checked_road(car, world)
    with show.progress("record a drive"):
        files = export(
            controller, arguments.out, targets=arguments.target or (), road=checked.road, plan=checked.plan,
            plant=plant, profile=world, room=arguments.room, objects=arguments.objects, speed=speed,
        )  # fmt: skip
    if arguments.as_json:
        show.say_json({**asdict(files), "folder": str(files.folder), "backups": list(map(str, files.backups))})
        return
    show.say(f"{controller.name} for {', '.join(files.targets)}: {files.folder}")
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
    show.say(next_line("to verify that it matches Python", shlex.join(["make", "-C", str(files.folder), "check"])))

"""`adaptrack tune`: find the best constant tuning for a car, on random drives or on selected roads."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

import adaptrack as at
from adaptrack.base.errors import InvalidInput
from adaptrack.cli import note_progress, options, show
from adaptrack.cli.next_step import add_command, drive_words
from adaptrack.cli.options import argument, json_flag, option, option_group, option_words
from adaptrack.cli.road import ROADS_HELP

if TYPE_CHECKING:
    from adaptrack.base.result import Result

TUNING_FILE = "tuning.toml"
"""Name of the tuning file in the output folder."""


@option_group
class TuneOptions:
    """Options of `adaptrack tune`."""

    car: str = argument("CAR", "Car: see `list cars`, or a .toml file.", ...)
    out: Path = option("FOLDER", "Folder for the tuning and the car file.", ...)
    road: list[str] | None = option(
        "ROAD", f"Tune on this road; may be repeated: country:3 (country with seed 3), a scenario, {ROADS_HELP}"
    )
    profile: str = options.profile_option("road")
    speed: str | None = option("LOW..HIGH", "Speed range of random drives (m/s); default: that of the car.")
    friction: str | None = option("LOW..HIGH", "Friction range of random drives; default: that of the car.")
    controller: str | None = option("NAME", "With --road: see `list controllers`; default: informed.")
    length: float | None = options.road_length_option()
    runs: int | None = option("N", "With --road: simulated runs of the search; default: enough for 300 tunings.", min=1)
    prescribed_speed: bool = options.prescribed_speed_flag()
    plant: str = options.plant_option()
    plugin: list[str] | None = options.plugin_option()
    as_json: bool = json_flag()


@options.grouped
def tune(settings: TuneOptions) -> None:
    """Find the best constant tuning for a car.

    Without --road, the command tunes the informed controller. It finds the speeds and frictions at which a tuning is
    stable, searches on random drives, tests the result on new drives and certifies it. The car file written to FOLDER
    has only the stable speeds and frictions. The exit code is 3 if a test drive fails or the loop is unstable.

    With --road, it tunes any controller on these roads, then compares the default and the new tuning with different
    noise. Failed runs are counted; the exit code is 0.
    """
    options.load_plugins(settings.plugin)
    _check_options(settings)
    options.make_folder(settings.out)
    note_progress("An interrupted search saves nothing.")
    result = _tune_on_roads(settings) if settings.road else _tune_car(settings)
    show.say_result(result, settings.as_json)
    if result.failed:
        raise typer.Exit(options.EXIT_FAILED)


def _check_options(settings: TuneOptions) -> None:
    """Raise InvalidInput for a road in place of the car, and for options that do not apply."""
    from adaptrack.road import ROAD_KINDS
    from adaptrack.road.load import ROAD_ENDINGS

    if settings.car in ROAD_KINDS or Path(settings.car).suffix in {*ROAD_ENDINGS} - {".toml"}:
        raise InvalidInput(
            f"tune {settings.car}: is a road; give the car first: tune CAR --road {settings.car} --out FOLDER."
        )
    names = ("speed", "friction") if settings.road else ("controller", "runs", "length")
    remedy = "leave out --road" if settings.road else "name roads with --road"
    unused = [name for name in names if getattr(settings, name) is not None]
    if unused:
        raise InvalidInput(f"tune: --{unused[0]} does not apply: {remedy}.")


def _tune_car(settings: TuneOptions) -> Result:
    from adaptrack.results.tuning import tuned_car_result
    from adaptrack.tuning.constant import ConstantTuning

    speed, friction = _pair("--speed", settings.speed), _pair("--friction", settings.friction)
    with show.progress("tune") as advance:
        tuned = at.tune(
            settings.car, settings.profile, plant=settings.plant, speed=speed, friction=friction, progress=advance
        )
    car, summary = tuned.controller.model.vehicle.replace(domain=tuned.domain), tuned.summary()
    car_file, tuning_file = settings.out / f"{car.name}.toml", settings.out / TUNING_FILE
    car.to_toml(car_file)
    ConstantTuning(
        controller="informed", vehicle=car.name, profile=tuned.profile.name, period=tuned.profile.period,
        command=options.command_line(), belief=summary["belief"], tuning=summary["tuning"],
    ).to_toml(tuning_file)  # fmt: skip
    files = {"car_file": str(car_file), "tuning_file": str(tuning_file)}
    return _add_command(tuned_car_result(tuned, files), settings, ["country"], car_file, tuning_file)


def _tune_on_roads(settings: TuneOptions) -> Result:
    from adaptrack.comparison.config import ControllerSetting
    from adaptrack.comparison.tune_on_roads import tune_on_roads
    from adaptrack.results.tuning import tuned_roads_result

    car = at.load_vehicle(settings.car)
    setting = ControllerSetting(car, at.get_plant(settings.plant, car), at.load_profile(settings.profile))
    name = settings.controller or "informed"
    with show.progress(f"tune {name}") as advance:
        tuned = tune_on_roads(
            setting, settings.road or (), name, length=settings.length or 2000.0, loops=settings.runs,
            prescribed_speed=settings.prescribed_speed, command=options.command_line(), progress=advance,
        )  # fmt: skip
    file = settings.out / TUNING_FILE
    tuned.file.to_toml(file)
    road = drive_words((settings.road or ["country"])[0], settings.length)
    return _add_command(tuned_roads_result(tuned, str(file)), settings, road, settings.car, file)


def _add_command(result: Result, settings: TuneOptions, road: list[str], car: str | Path, tuning: Path) -> Result:
    """Return a result with the current command line and the suggestion to drive a road with the tuning."""
    loop = option_words(settings, "plant", "prescribed_speed", "plugin")
    words = [*road, "--vehicle", car, "--profile", settings.profile, *loop]
    return add_command(result, "tune", drive=words, tuning=tuning)


def _pair(option: str, text: str | None) -> tuple[float, float] | None:
    """Parse a range such as 5..25; None without the option."""
    if text is None:
        return None
    try:
        low, high = (float(number) for number in text.split(".."))
    except ValueError:
        raise InvalidInput(f"{option} {text}: must be LOW..HIGH, such as 5..25.") from None
    return low, high

"""`adaptrack adapt`: the constant tuning of the controller for a car, and its certificate."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Argument, Option

from adaptrack.base.errors import AdaptrackError, InvalidInput
from adaptrack.cli import options, show
from adaptrack.cli.next_step import command, say_next
from adaptrack.cli.simulate import FAILED

if TYPE_CHECKING:
    from adaptrack.tuning.car import TunedCar

CONSTANT = "constant.toml"
"""The file of the tuning."""


@dataclass(frozen=True, kw_only=True)
class AdaptOptions:
    """Options of `adaptrack adapt`."""

    car: Annotated[list[str], Argument(metavar="CAR", help="Name (see `vehicles`) or .toml file.")]
    out: Annotated[Path, Option("--out", metavar="DIR", help="Folder for the car's file and its constant tuning.")]
    profile: options.Profile = "road"
    speed: Annotated[
        str | None, Option("--speed", metavar="LOW..HIGH", help="m/s: 5..25; by default its domain's.")
    ] = None
    friction: Annotated[
        str | None, Option("--friction", metavar="LOW..HIGH", help="0.4..1; by default its domain's.")
    ] = None
    plant: Annotated[
        str | None,
        Option("--plant", metavar="NAME", hidden=True, help="What is driven; by default the car as a dual track."),
    ] = None
    plugin: options.Plugin = None
    as_json: options.Json = False


@options.grouped
def adapt(given: AdaptOptions) -> None:
    """Find a car's constant tuning.

    In seconds: which speeds and frictions can be held, the best tuning of a search, unseen drives, certificate. The
    folder then holds the car with the domain that can be held, and the tuning for `drive --tuning`.

    The exit code is 3 when the car leaves the road with its constant, or the certificate finds that loop unstable.
    """
    from adaptrack.tuning.car import tune

    options.load_plugins(given.plugin)
    car = _one(given.car)
    speed, friction = _pair("--speed", given.speed), _pair("--friction", given.friction)
    options.make_folder(given.out)
    with show.progress("tune") as advance:
        tuned = tune(car, given.profile, plant=given.plant, speed=speed, friction=friction, progress=advance)
    vehicle = _write(tuned, given.out)
    if given.as_json:
        show.say_json(tuned.summary())
    else:
        show.say(f"{tuned.answer} {tuned.verdict}")
        own = ("--vehicle", vehicle, "--profile", given.profile, "--tuning", given.out / CONSTANT)
        say_next("with its constant", command("drive", "ROAD", *own))
    if not tuned.passed:
        raise typer.Exit(FAILED)


def _write(tuned: TunedCar, out: Path) -> Path:
    """Write the car with the domain that can be held, and the tuning; the path of the car's file."""
    from adaptrack.tuning.constant_file import ConstantTuning

    vehicle, found = tuned.controller.model.vehicle.replace(domain=tuned.domain), tuned.summary()
    file = out / f"{vehicle.name}.toml"
    vehicle.to_toml(file)
    ConstantTuning(
        controller="informed", vehicle=vehicle.name, profile=tuned.profile.name, period=tuned.profile.period,
        command=options.command_line(), belief=found["belief"], tuning=found["tuning"],
    ).to_toml(out / CONSTANT)  # fmt: skip
    return file


def _one(names: list[str]) -> str:
    """The car; a word for whoever gives a road."""
    from adaptrack.cars.vehicle import load_vehicle

    if len(names) == 1:
        try:
            load_vehicle(names[0])
        except AdaptrackError:
            if not _is_road(names[0]):
                raise
        else:
            return names[0]
    named = " ".join(names)
    raise InvalidInput(
        f"adapt {named}: takes one car. For the best tuning on given roads: adaptrack tune {named} --out tuning.toml."
    )


def _is_road(name: str) -> bool:
    from adaptrack.road import KINDS, load_road

    if name in KINDS:
        return True
    try:
        load_road(name)
    except AdaptrackError:
        return False
    return True


def _pair(option: str, text: str | None) -> tuple[float, float] | None:
    """5..25 as two numbers; None where the option is left out."""
    if text is None:
        return None
    try:
        low, high = (float(each) for each in text.split(".."))
    except ValueError:
        raise InvalidInput(f"{option} {text}: must be LOW..HIGH, such as 5..25.") from None
    return low, high

"""`adaptrack adapt`: the whole chain for a car, from its constant tuning to schedulers that are judged."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Argument, Option

from adaptrack.base.errors import AdaptrackError, InvalidInput, StorageError
from adaptrack.cli import adaptation, comparison, options, show
from adaptrack.cli.next_step import command, say_next
from adaptrack.cli.simulate import FAILED

if TYPE_CHECKING:
    from adaptrack.learning.adaptation.config import AdaptationConfig
    from adaptrack.studies.tune_car import TunedCar

CONFIGURATION, FOUND, CONSTANT, REQUESTED = "adaptation.toml", "found.toml", "constant.toml", "asked.toml"
"""Files of a folder: the configuration, which is written last; what was found of the constant; it; the options."""


@dataclass(frozen=True, kw_only=True)
class AdaptOptions:
    """Options of `adaptrack adapt`."""

    car: Annotated[
        list[str] | None, Argument(metavar="CAR", help="Name (see `vehicles`) or .toml file.", show_default=False)
    ] = None
    out: Annotated[Path, Option("--out", metavar="DIR", help="Folder of the chain; one that was interrupted goes on.")]
    quick: Annotated[bool, Option("--quick", help="Some minutes of work, for a first look.")] = False
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
    workers: options.Workers = None
    config: Annotated[str | None, Option("--config", hidden=True, help="Gone: see `adaptation`.")] = None
    as_json: options.Json = False


@options.grouped
def adapt(given: AdaptOptions) -> None:
    """Tune a car: its constant, then schedulers, judged.

    First, in seconds, which speeds and frictions can be held, the best tuning of a search, unseen drives, certificate;
    then the chain by the configuration that follows, which is kept in the folder (`adaptrack adaptation`).

    Failed runs are part of the result: they are counted for each contender, and the exit code is 0; it is 3 when the
    car leaves the road with its constant, or the certificate finds that loop unstable; also when the chain is gone on
    with.
    """
    if given.config is not None or not given.car:
        name = given.config or "NAME"
        raise InvalidInput(
            f"adapt: name a car; a configuration has its own command: adaptrack adaptation {name} --out {given.out}."
        )
    options.load_plugins(given.plugin)
    requested = {
        "car": _one(given.car), "profile": given.profile, "quick": given.quick, "plant": given.plant,
        "plugin": given.plugin or None, "speed": _pair("--speed", given.speed),
        "friction": _pair("--friction", given.friction),
    }  # fmt: skip
    settings, kept = _of_car(requested, given.out)
    made, page = adaptation.run_chain(settings, given.out, given.workers)
    words = f"{kept['vehicle']}: {kept['verdict']}"
    if given.as_json:
        show.say(f"{words}\nSchedulers: {given.out / 'schedulers'}\nPage: {page}", aside=True)
    else:
        show.say(_answer(kept, made))
        show.say(f"{words}\n")
    comparison.print_comparison(made, given.as_json)
    if not given.as_json:
        show.say(f"Schedulers: {given.out / 'schedulers'}\nPage: {page}")
        say_next(*_next(given, made, kept))
    if not kept["passed"]:
        raise typer.Exit(FAILED)


def _answer(kept: dict[str, Any], made: Any) -> str:
    """What the constant brings, and what a schedule brings beside it."""
    return " ".join(filter(None, (kept.get("answer"), comparison.answer(made))))


def _next(given: AdaptOptions, made: Any, kept: dict[str, Any]) -> tuple[str, str]:
    """Drive with the constant, or compare the schedule that is worth it with it on one's roads."""
    out = given.out
    where = ("ROAD", "--vehicle", out / f"{kept['vehicle']}.toml", "--profile", given.profile)
    constant, worthy = ("--tuning", out / CONSTANT), comparison.worthy_schedule(made)
    if worthy is None:
        return "with its constant", command("drive", *where, *constant)
    file = out / "schedulers" / f"{worthy}.json"
    return "both on a road of yours", command("evaluate", *where, *constant, "--schedulers", file)


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
        f"adapt {named}: takes one car; schedulers are learned on random drives, not on given roads. For roads seek "
        f"one tuning: adaptrack tune {named} --out tuning.toml; and compare, a scheduler too: adaptrack evaluate "
        f"{named} --tuning tuning.toml --schedulers NAME."
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


def _of_car(requested: dict[str, Any], out: Path) -> tuple[AdaptationConfig, dict[str, Any]]:
    """The configuration of a car's adaptation, and what was found of its constant: from the folder, or made first."""
    from adaptrack.learning.adaptation.config import load_adaptation

    options.make_folder(out)
    if (out / CONFIGURATION).exists():
        _check_same(out, requested)
        show.say(f"adaptrack: goes on with {out / CONFIGURATION}", aside=True)
    else:
        tuned = _tuned(requested)
        show.say(f"{requested['car']}: {tuned.verdict}\n", aside=True)
        _write(requested, tuned, out)
    return load_adaptation(out / CONFIGURATION), _kept(out)


def _tuned(requested: dict[str, Any]) -> TunedCar:
    """The constant of a car."""
    from adaptrack.studies.tune_car import tune

    domain = {key: requested[key] for key in ("plant", "speed", "friction")}
    with show.progress("tune") as advance:
        return tune(requested["car"], requested["profile"], **domain, progress=advance)


def _write(requested: dict[str, Any], tuned: TunedCar, out: Path) -> Path:
    """What was requested and found, and the configuration that follows from it, whose path is returned."""
    from adaptrack.base.files import write_toml
    from adaptrack.learning.adaptation.for_car import DrivenSetup, write_configuration
    from adaptrack.tuning.constant_file import ConstantTuning

    vehicle = tuned.controller.model.vehicle.replace(domain=tuned.domain)
    own, found = out / f"{vehicle.name}.toml", tuned.summary()
    vehicle.to_toml(own)
    ConstantTuning(
        controller="informed", vehicle=vehicle.name, profile=tuned.profile.name, period=tuned.profile.period,
        command=options.command_line(), belief=found["belief"], tuning=found["tuning"],
    ).to_toml(out / CONSTANT)  # fmt: skip
    write_toml(out / REQUESTED, _plain(requested))
    write_toml(
        out / FOUND,
        {"vehicle": vehicle.name, "answer": tuned.answer, **{key: found[key] for key in ("passed", "verdict")}},
    )
    driven = DrivenSetup(requested["plant"] or "dual-track", tuple(requested["plugin"] or ()), tuned.costly)
    constant, quick = tuned.tuning, requested["quick"]
    return write_configuration(out, own, requested["profile"], tuned.domain, constant, quick=quick, driven=driven)


def _kept(out: Path) -> dict[str, Any]:
    """What was found of the constant before.

    Raises
    ------
    StorageError
        When the file is gone, or says something else.
    """
    from adaptrack.base.files import read_toml

    found = read_toml(out / FOUND)
    if not (isinstance(found.get("passed"), bool) and {"vehicle", "verdict"} <= set(found)):
        raise StorageError(f"{out / FOUND}: does not say whether the constant passed: give another folder.")
    return found


def _plain(requested: dict[str, Any]) -> dict[str, Any]:
    return {
        key: list(value) if isinstance(value, tuple) else value for key, value in requested.items() if value is not None
    }


def _check_same(out: Path, requested: dict[str, Any]) -> None:
    from adaptrack.base.files import read_toml

    before = read_toml(out / REQUESTED) if (out / REQUESTED).exists() else {}
    if before != _plain(requested):
        raise InvalidInput(
            f"{out} holds the chain of {before.get('car', 'something else')} with other options: give another folder, "
            "or the same options to go on."
        )

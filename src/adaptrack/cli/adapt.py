"""`adaptrack adapt`: the whole chain, for a car or by a configuration."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Argument, Option

from adaptrack.base.errors import AdaptrackError, InvalidInput, StorageError
from adaptrack.cli import comparison, interrupt, options, show
from adaptrack.cli.simulate import FAILED

if TYPE_CHECKING:
    from adaptrack.learning.adaptation.config import AdaptationConfig
    from adaptrack.studies.tune_car import TunedCar

CONFIGURATION, FOUND = "adaptation.toml", "found.toml"
"""Files of a folder: the configuration, which is written last, and what was found of the constant."""


@options.grouped
def adapt(
    out: Annotated[Path, Option(help="Folder of the chain; one that was interrupted goes on.")],
    car: Annotated[
        list[str] | None,
        Argument(metavar="CAR", help="Name (see `vehicles`) or .toml file; else see --config.", show_default=False),
    ] = None,
    config: Annotated[
        str | None,
        Option(help="Name (road, informed-road, ...) or .toml file; by default what ships for controller and profile."),
    ] = None,
    controller: options.Tuned = None,
    profile: options.OtherProfile = None,
    speed: Annotated[
        str | None, Option("--speed", metavar="LOW..HIGH", help="Of CAR, m/s: 5..25; by default its domain's.")
    ] = None,
    friction: Annotated[
        str | None, Option("--friction", metavar="LOW..HIGH", help="Of CAR: 0.4..1; by default its domain's.")
    ] = None,
    plant: Annotated[
        str | None,
        Option(
            "--plant",
            hidden=True,
            help="Of CAR, what is driven: dual-track [default], single-track, or a registered plant.",
        ),
    ] = None,
    plugin: options.Plugin = None,
    quick: Annotated[bool, Option("--quick", help="Of CAR: some minutes of work, for a first look.")] = False,
    workers: options.Workers = None,
    as_json: options.Json = False,
) -> None:
    """The whole chain: tune, learn schedulers, guard them, evaluate them on roads nobody trained on.

    For a CAR first its constant tuning, in seconds: which speeds and frictions can be held, the best tuning of a
    search, unseen drives, certificate. The configuration that follows from it is kept in the folder.

    Failed runs are part of the result: they are counted for each contender, and the exit code is 0; it is 3 when CAR
    leaves the road with its constant, or the certificate finds that loop unstable; also when the chain is gone on with.
    """
    from adaptrack.studies.adapt import adapt as run

    given = {
        "--speed": speed, "--friction": friction, "--plant": plant, "--plugin": plugin, "--quick": quick or None,
    }  # fmt: skip
    passed = True
    if car:
        if config is not None or controller is not None:
            raise InvalidInput("adapt CAR: makes its own configuration: leave out --config and --controller.")
        options.load_plugins(plugin)
        asked = {
            "car": _one(car), "profile": profile or "road", "quick": quick, "plant": plant, "plugin": plugin or None,
            "speed": _pair("--speed", speed), "friction": _pair("--friction", friction),
        }  # fmt: skip
        settings, passed = _of_car(asked, out, as_json)
    else:
        told = [name for name, value in given.items() if value is not None]
        if told:
            raise InvalidInput(f"{', '.join(told)}: of a CAR: name one, or give a configuration its numbers.")
        settings = comparison.study(config, controller, profile)
        options.make_folder(out)
    interrupt.kept(f"Finished chunks and schedulers are kept in {out}: run the command again to go on.")
    with show.progress("adapt") as advance:
        made = run(settings, out, workers=workers, progress=advance)
    page = comparison.write_page(out, made)
    show.say(f"Schedulers: {out / 'schedulers'}\nReport: {page}", aside=as_json)
    comparison.print_comparison(made, as_json)
    if not passed:
        raise typer.Exit(FAILED)


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
    """5..25 as two numbers; None where nothing is asked for."""
    if text is None:
        return None
    try:
        low, high = (float(each) for each in text.split(".."))
    except ValueError:
        raise InvalidInput(f"{option} {text}: must be LOW..HIGH, such as 5..25.") from None
    return low, high


def _of_car(asked: dict[str, Any], out: Path, aside: bool) -> tuple[AdaptationConfig, bool]:
    """The configuration of a car's adaptation, and whether its constant has passed: from the folder, or made first."""
    from adaptrack.learning.adaptation.config import load_adaptation

    options.make_folder(out)
    if (out / CONFIGURATION).exists():
        _check_same(out, asked)
        show.say(f"adaptrack: goes on with {out / CONFIGURATION}", aside=True)
        kept = _kept(out)
        show.say(f"{kept['vehicle']}: {kept['verdict']}\n", aside=aside)
        return load_adaptation(out / CONFIGURATION), bool(kept["passed"])
    tuned = _tuned(asked)
    show.say(f"{asked['car']}: {tuned.verdict}\n", aside=aside)
    return load_adaptation(_write(asked, tuned, out)), tuned.passed


def _tuned(asked: dict[str, Any]) -> TunedCar:
    """The constant of a car."""
    from adaptrack.studies.tune_car import tune

    told = {key: asked[key] for key in ("plant", "speed", "friction")}
    with show.progress("tune") as advance:
        return tune(asked["car"], asked["profile"], **told, progress=advance)


def _write(asked: dict[str, Any], tuned: TunedCar, out: Path) -> Path:
    """What was asked and found, and the configuration that follows from it, whose path is returned."""
    from adaptrack.base.files import write_toml
    from adaptrack.cars.plant import usual_plant
    from adaptrack.learning.adaptation.for_car import DrivenSetup, write_configuration
    from adaptrack.tuning.constant_file import ConstantTuning

    vehicle = tuned.controller.model.vehicle.replace(domain=tuned.domain)
    own, found = out / f"{vehicle.name}.toml", tuned.summary()
    vehicle.to_toml(own)
    ConstantTuning(
        controller="informed", vehicle=vehicle.name, profile=tuned.profile.name, period=tuned.profile.period,
        command=options.command_line(), tuning=found["tuning"],
    ).to_toml(out / "constant.toml")  # fmt: skip
    write_toml(out / "asked.toml", _plain(asked))
    write_toml(out / FOUND, {"vehicle": vehicle.name, **{key: found[key] for key in ("passed", "verdict")}})
    driven = DrivenSetup(asked["plant"] or usual_plant(vehicle), tuple(asked["plugin"] or ()), tuned.costly)
    constant, quick = tuned.tuning, asked["quick"]
    return write_configuration(out, own, asked["profile"], tuned.domain, constant, quick=quick, driven=driven)


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


def _plain(asked: dict[str, Any]) -> dict[str, Any]:
    return {
        key: list(value) if isinstance(value, tuple) else value for key, value in asked.items() if value is not None
    }


def _check_same(out: Path, asked: dict[str, Any]) -> None:
    from adaptrack.base.files import read_toml

    before = read_toml(out / "asked.toml") if (out / "asked.toml").exists() else {}
    if before != _plain(asked):
        raise InvalidInput(
            f"{out} holds the chain of {before.get('car', 'something else')} with other options: give another folder, "
            "or the same options to go on."
        )

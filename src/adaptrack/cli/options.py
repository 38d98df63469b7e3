"""The options that commands share, each declared once; and what follows from them."""

from __future__ import annotations

import dataclasses
import functools
import inspect
import shlex
import sys
from collections.abc import Callable, Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_type_hints

import typer
from typer import Option

from adaptrack.base.errors import InvalidInput, StorageError
from adaptrack.base.limits import WORKERS, Limit, check_limit
from adaptrack.base.registry import import_plugin

if TYPE_CHECKING:
    from adaptrack.cars.plant import Plant as PlantOf
    from adaptrack.cars.plant import SteppedPlant
    from adaptrack.cars.vehicle import Vehicle as Car


class MovesName(StrEnum):
    """Parametrisations of the moves."""

    pulse = "pulse"
    laguerre = "laguerre"


class ModelName(StrEnum):
    """Models that learn a tuning."""

    nn = "nn"
    anfis = "anfis"


class TunedName(StrEnum):
    """Controllers whose tuning is sought."""

    informed = "informed"
    as_written = "as-written"


class TargetsName(StrEnum):
    """What they learn."""

    paper = "paper"
    ratio = "ratio"


def at_most(limit: Limit, least: int = 1) -> Callable[[typer.CallbackParam, int | None], int | None]:
    """A callback that refuses a count outside its bounds by the name of its option."""

    def check(option: typer.CallbackParam, value: int | None) -> int | None:
        if value is not None:
            name = max(option.opts, key=len)
            if value < least:
                raise InvalidInput(f"{name} = {value}: must be a whole number, at least {least}.")
            check_limit(name, value, limit)
        return value

    return check


def count_of(what: str, limit: Limit) -> typer.models.OptionInfo:
    """An option that counts something, from 1 to its bound."""
    return Option(callback=at_most(limit), help=f"{what}, {limit.range}.")


Vehicle = Annotated[str, Option("--vehicle", help="Name (see `vehicles`) or .toml file.")]
Plant = Annotated[str, Option("--plant", help="What is driven: single-track, dual-track, or a registered plant.")]
Plugin = Annotated[
    list[str] | None,
    Option("--plugin", metavar="MODULE", help="Python module to import first: what it registers has a name."),
]
Tyre = Annotated[str | None, Option("--tyre", help="Name (see `vehicles`) or .toml file; by default the vehicle's.")]
Learn = Annotated[
    bool, Option("--learn", help="Let the informed controller learn delay, stiffness and bias while it drives.")
]
LearnedFile = Annotated[
    Path | None,
    Option("--learned", metavar="FILE", help="Learn, beginning with what this TOML file holds, and write it again."),
]
Profile = Annotated[
    str, Option("--profile", metavar="NAME", help="paper: ideal; road: steering lag, noise, delay; or a .toml file.")
]
Tuned = Annotated[
    TunedName | None,
    Option(
        "--controller",
        help="Whose tuning is sought: informed, the MPC that knows its car; as-written, the paper's. By default the "
        "configuration's.",
    ),
]
OtherProfile = Annotated[
    str | None, Option("--profile", metavar="NAME", help="Instead of the configuration's: paper, road, production, ...")
]
Png = Annotated[bool, Option("--png", help="With --out: the pictures as PNG files for print, too.")]
Json = Annotated[bool, Option("--json", help="One JSON object on standard output, nothing else.")]
Data = Annotated[str, Option("--data", help="Name (see `dataset list`), file, or folder of a campaign.")]
DataSetName = Annotated[
    str, typer.Argument(metavar="NAME", help="Name (see `dataset list`), file, or folder of a campaign.")
]
Page = Annotated[Path | None, Option("--out", help="Folder for the page and its pictures.")]
LearningSeed = Annotated[int, Option("--seed", min=0, help="Of the hold-out and of the first weights.")]
Workers = Annotated[
    int | None,
    Option("--workers", callback=at_most(WORKERS), help="Threads of the campaign, by default one per core."),
]
Threads = Annotated[int | None, Option("--threads", callback=at_most(WORKERS), help="By default one per core.")]


def grouped(command: Callable[..., None]) -> Callable[..., None]:
    """A command whose parameters that are dataclasses of options take each of their fields as an option of its own.

    So options that several commands share are listed once.
    """
    hints = get_type_hints(command, include_extras=True)
    groups: dict[str, Any] = {}
    parameters: list[inspect.Parameter] = []
    for name, parameter in inspect.signature(command).parameters.items():
        if dataclasses.is_dataclass(hints[name]):
            groups[name] = hints[name]
            own = get_type_hints(hints[name], include_extras=True)
            added = [(each.name, own[each.name], each.default) for each in dataclasses.fields(hints[name])]
        else:
            added = [(name, hints[name], parameter.default)]
        parameters += [
            inspect.Parameter(key, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=hint)
            for key, hint, default in added
        ]

    def run(**given: Any) -> None:
        for name, group in groups.items():
            given[name] = group(**{each.name: given.pop(each.name) for each in dataclasses.fields(group)})
        command(**given)

    functools.update_wrapper(run, command)
    run.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    run.__annotations__ = {each.name: each.annotation for each in parameters}
    return run


def load_plugins(modules: Sequence[str] | None) -> None:
    """Import modules, from where Python looks for them or from the folder at hand.

    Raises
    ------
    InvalidInput
        When there is no such module.
    """
    if modules and "" not in sys.path:
        sys.path.append("")
    for name in modules or ():
        missing = f"--plugin {name}: there is no such module in the Python path or in this folder."
        import_plugin(name, InvalidInput(missing))


def car_and_plant(vehicle: str, plant: str, tyre: str | None) -> tuple[Car, PlantOf | SteppedPlant]:
    """The car that the controller knows, and the plant that is driven."""
    from adaptrack.cars.plant import get_plant
    from adaptrack.cars.vehicle import load_vehicle

    car = load_vehicle(vehicle)
    return car, get_plant(plant, car, tyre)


def make_folder(path: Path) -> None:
    """A folder that can be written to.

    Raises
    ------
    StorageError
        When there can be none.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
        probe = path / ".writable"
        probe.touch()
        probe.unlink()
    except (OSError, ValueError) as error:  # ValueError: a path with NUL
        raise StorageError(f"{path}: cannot be written to: {getattr(error, 'strerror', None) or error}.") from error


def make_place(file: Path | None) -> None:
    """`make_folder` for a file that is written when the work is done, if one is asked for.

    Raises
    ------
    StorageError
        When its folder cannot be written to, or the file is a folder.
    """
    if file is None:
        return
    make_folder(file.parent)
    if file.is_dir():
        raise StorageError(f"{file}: cannot be written to: is a folder; name a file.")


def make_page_folder(out: Path | None, png: bool = False) -> None:
    """`make_folder`, where a page is asked for.

    Raises
    ------
    InvalidInput
        When PNG files are asked for and no page.
    StorageError
        As `make_folder`.
    """
    if png and out is None:
        raise InvalidInput("--png: needs a folder, --out.")
    if out is not None:
        make_folder(out)


def command_line() -> str:
    """The command line at hand."""
    return shlex.join(["adaptrack", *sys.argv[1:]])

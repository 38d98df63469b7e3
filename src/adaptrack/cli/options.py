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
from typing import TYPE_CHECKING, Annotated, Any, get_args, get_type_hints

import typer
from typer import Option

from adaptrack.base.errors import InvalidInput, StorageError
from adaptrack.base.limits import WORKERS, RequestLimit, check_limit
from adaptrack.base.registry import import_plugin

if TYPE_CHECKING:
    from adaptrack.cars.plant import Plant as PlantOf
    from adaptrack.cars.plant import SteppedPlant
    from adaptrack.cars.vehicle import Vehicle as Car


EXIT_FAILED = 3
"""The exit code when a run failed."""


class MovesName(StrEnum):
    """Parametrisations of the moves."""

    pulse = "pulse"
    laguerre = "laguerre"


class ModelName(StrEnum):
    """Models that learn a tuning."""

    nn = "nn"
    anfis = "anfis"


class TargetsName(StrEnum):
    """Quantities that a model learns."""

    paper = "paper"
    ratio = "ratio"


def at_most(limit: RequestLimit, least: int = 1) -> Callable[[typer.CallbackParam, int | None], int | None]:
    """A callback that refuses a count outside its bounds by the name of its option."""

    def check(option: typer.CallbackParam, value: int | None) -> int | None:
        if value is not None:
            name = max(option.opts, key=len)
            if value < least:
                raise InvalidInput(f"{name} = {value}: must be a whole number, at least {least}.")
            check_limit(name, value, limit)
        return value

    return check


VehicleOption = Annotated[str, Option("--vehicle", metavar="CAR", help="Car: see `list cars`, or a .toml file.")]
PlantOption = Annotated[
    str,
    Option("--plant", metavar="NAME", hidden=True, help="Driven plant: single-track, dual-track, or a registered one."),
]
Plugin = Annotated[
    list[str] | None,
    Option("--plugin", metavar="MODULE", hidden=True, help="Python module to import first; it registers names."),
]
TyreOption = Annotated[
    str | None,
    Option("--tyre", metavar="TYRE", hidden=True, help="Tyre: see `list tyres`, or a .toml file; default: the car's."),
]
ProfileOption = Annotated[
    str, Option("--profile", metavar="NAME", help="paper: ideal; road: steering lag, noise, delay; or a .toml file.")
]
Speed = Annotated[float | None, Option("--speed", metavar="V", help="Constant speed (m/s); default: planned.")]
LateralAcceleration = Annotated[
    float | None, Option("--lateral-acceleration", metavar="A", help="Limit of the planned speed (m/s²); default: 3.")
]
OtherProfile = Annotated[str | None, Option("--profile", metavar="NAME", help="Profile; default: the configuration's.")]
Png = Annotated[bool, Option("--png", hidden=True, help="With --out: also write the pictures as PNG files.")]
Json = Annotated[bool, Option("--json", help="One JSON object on standard output, nothing else.")]
Data = Annotated[
    str, Option("--data", metavar="NAME", help="Data set: paper-grid, road-sobol, a file, or the folder of a campaign.")
]
Page = Annotated[Path | None, Option("--out", metavar="FOLDER", help="Folder for the page and its pictures.")]
LearningSeed = Annotated[int, Option("--seed", min=0, help="Seed of the hold-out and of the first weights.")]
Workers = Annotated[
    int | None,
    Option(
        "--workers",
        metavar="N",
        hidden=True,
        callback=at_most(WORKERS),
        help="Worker processes; default: one per core.",
    ),
]


@dataclasses.dataclass(frozen=True)
class CarAndPlant:
    """Options for the car of the controller and the driven plant."""

    vehicle: VehicleOption = "paper"
    plant: PlantOption = "dual-track"
    tyre: TyreOption = None
    plugin: Plugin = None

    def load(self) -> tuple[Car, PlantOf | SteppedPlant]:
        """Both, after the plugins."""
        load_plugins(self.plugin)
        return car_and_plant(self.vehicle, self.plant, self.tyre)


PrescribedSpeed = Annotated[
    bool,
    Option("--prescribed-speed", hidden=True, help="Follow the planned speed exactly, without forces along the road."),
]


@dataclasses.dataclass(frozen=True)
class DriveSettings:
    """How a closed loop is driven, and what is kept of it."""

    prescribed_speed: PrescribedSpeed = False
    period: Annotated[
        float | None, Option("--period", metavar="S", hidden=True, help="Control period (s); default: the profile's.")
    ] = None
    learn: Annotated[bool, Option("--learn", help="Learn delay, stiffness and bias while driving.")] = False
    learned: Annotated[
        Path | None,
        Option("--learned", metavar="FILE", help="Learn; start from this TOML file and update it."),
    ] = None
    seed: Annotated[int, Option("--seed", hidden=True, help="Seed of the sensor noise.")] = 0
    out: Annotated[Path | None, Option("--out", metavar="FOLDER", help="Folder for the page and the trajectories.")] = (
        None
    )
    png: Png = False
    allow_failed: Annotated[
        bool,
        Option(
            "--allow-failed",
            hidden=True,
            help="Exit code 0 after a failed run; drive also unstable loops.",
        ),
    ] = False
    as_json: Json = False

    def make_places(self) -> None:
        """Make the folders of what is kept; `StorageError` where nothing can be written."""
        make_page_folder(self.out, self.png)
        make_place(self.learned)


def grouped(command: Callable[..., None]) -> Callable[..., None]:
    """A command for typer: each parameter that is a record of options becomes the options that are its fields.

    Records may hold records. An option that is declared hidden is one that few need: `--help` leaves it out, and
    `--help-all`, which a command with such options gets, shows it.
    """
    hints = get_type_hints(command, include_extras=True)
    declared: list[inspect.Parameter] = []
    for name, parameter in inspect.signature(command).parameters.items():
        if dataclasses.is_dataclass(hints[name]):
            declared += _fields(hints[name])
        else:
            declared.append(_declared(name, hints[name], parameter.default))
    if any(_is_hidden(option.annotation) for option in declared):
        declared.append(_declared("help_all", HelpAll, False))

    def run(**values: Any) -> None:
        values.pop("help_all", None)
        command(**{name: _read_value(hint, name, values) for name, hint in hints.items() if name != "return"})

    functools.update_wrapper(run, command)
    run.__signature__ = inspect.Signature(declared)  # type: ignore[attr-defined]
    run.__annotations__ = {option.name: option.annotation for option in declared}
    return run


def _declared(name: str, hint: Any, default: Any) -> inspect.Parameter:
    if default is dataclasses.MISSING:
        default = inspect.Parameter.empty
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=hint)


def _fields(record: Any) -> list[inspect.Parameter]:
    """The options of a record, those of the records in it where these stand."""
    hints = get_type_hints(record, include_extras=True)
    parameters: list[inspect.Parameter] = []
    for field in dataclasses.fields(record):
        inner = dataclasses.is_dataclass(hints[field.name])
        parameters += _fields(hints[field.name]) if inner else [_declared(field.name, hints[field.name], field.default)]
    return parameters


def _read_value(hint: Any, name: str, values: dict[str, Any]) -> Any:
    """The value of a parameter, out of those that were parsed: itself, or a record of them."""
    if not dataclasses.is_dataclass(hint):
        return values.pop(name)
    hints = get_type_hints(hint, include_extras=True)
    return hint(
        **{field.name: _read_value(hints[field.name], field.name, values) for field in dataclasses.fields(hint)}
    )  # type: ignore[operator]


def _is_hidden(hint: Any) -> bool:
    return any(isinstance(part, typer.models.OptionInfo) and part.hidden for part in get_args(hint))


def _show_all(context: typer.Context, is_requested: bool) -> None:
    """The help with the options that few need."""
    if is_requested:
        for parameter in context.command.params:
            parameter.hidden = False  # type: ignore[attr-defined]  # of options; arguments are shown in any case
        typer.echo(context.get_help())
        raise typer.Exit


HelpAll = Annotated[
    bool,
    Option("--help-all", is_eager=True, callback=_show_all, help="Show this message with the rarely used options."),
]


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
    """`make_folder` for a file that is written when the work is done, if one is given.

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
    """`make_folder`, where a page is to be written.

    Raises
    ------
    InvalidInput
        When PNG files are wanted and no page.
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

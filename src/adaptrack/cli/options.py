"""Options that several commands share, and functions that evaluate them."""

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
    """Return an option callback that raises InvalidInput for counts outside `least` to the limit."""

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
    Option(
        "--plant", metavar="NAME", hidden=True, help="Simulated plant: single-track, dual-track, or a registered plant."
    ),
]
Plugin = Annotated[
    list[str] | None,
    Option(
        "--plugin", metavar="MODULE", hidden=True, help="Python module that registers further names; may be repeated."
    ),
]
TyreOption = Annotated[
    str | None,
    Option("--tyre", metavar="TYRE", hidden=True, help="Tyre: see `list tyres`, or a .toml file; default: the car's."),
]
ProfileOption = Annotated[
    str,
    Option(
        "--profile",
        metavar="NAME",
        help="Simulated steering and sensors. paper: ideal; road: lag, noise, delay; or a .toml file.",
    ),
]
Speed = Annotated[float | None, Option("--speed", metavar="V", help="Constant speed (m/s); default: planned speed.")]
AssumedFriction = Annotated[
    str | None,
    Option(
        "--assumed-friction", metavar="MU|LOW:HIGH", hidden=True,
        help="Assumed friction; plan and driver use the lower end of an interval, a speed control narrows it while "
        "driving. Default: the road's, of an exported speed control 0.9.",
    ),
]  # fmt: skip
LateralAcceleration = Annotated[
    float | None,
    Option("--lateral-acceleration", metavar="A", help="Lateral acceleration limit (m/s²); default: 3."),
]
OtherProfile = Annotated[
    str | None, Option("--profile", metavar="NAME", help="Profile; default: that of the campaign.")
]
Png = Annotated[bool, Option("--png", hidden=True, help="With --out: also write the pictures as PNG files.")]
Json = Annotated[bool, Option("--json", help="Print the result as JSON.")]
Data = Annotated[
    str, Option("--data", metavar="NAME", help="Data set: paper-grid, road-sobol, a file, or the folder of a campaign.")
]
Page = Annotated[Path | None, Option("--out", metavar="FOLDER", help="Folder for the page and its pictures.")]
LearningSeed = Annotated[int, Option("--seed", min=0, help="Seed of the held-out set and the initial weights.")]
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
    """Options for the car model of the controller and the simulated plant."""

    vehicle: VehicleOption = "paper"
    plant: PlantOption = "dual-track"
    tyre: TyreOption = None
    plugin: Plugin = None

    def load(self) -> tuple[Car, PlantOf | SteppedPlant]:
        """Load car and plant, after importing the plugins."""
        load_plugins(self.plugin)
        return car_and_plant(self.vehicle, self.plant, self.tyre)


PrescribedSpeed = Annotated[
    bool,
    Option("--prescribed-speed", hidden=True, help="Follow the planned speed exactly, without forces along the road."),
]


@dataclasses.dataclass(frozen=True)
class DriveSettings:
    """Options for the simulation of a closed loop and for the saved files."""

    prescribed_speed: PrescribedSpeed = False
    speed_control: Annotated[
        bool,
        Option("--speed-control", help="Road: control the speed, with governor and stops."),
    ] = False
    period: Annotated[
        float | None, Option("--period", metavar="S", hidden=True, help="Control period (s); default: the profile's.")
    ] = None
    learn: Annotated[bool, Option("--learn", help="Learn steering delay and bias, and tyre stiffness.")] = False
    learned: Annotated[
        Path | None,
        Option("--learned", metavar="FILE", help="Like --learn; start from this TOML file and update it."),
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
            help="Exit with code 0 after a failed run, and also drive unstable loops.",
        ),
    ] = False
    as_json: Json = False

    def make_places(self) -> None:
        """Make the folders of all output files, or raise `StorageError`."""
        make_page_folder(self.out, self.png)
        make_place(self.learned)


def grouped(command: Callable[..., None]) -> Callable[..., None]:
    """Convert a command with dataclass parameters to a typer command with one option per dataclass field.

    Dataclasses may be nested. Rarely used options are declared hidden. `--help` omits them. Commands with hidden
    options also get the option `--help-all`, which shows them.
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
    """Return the options of a dataclass, with nested dataclasses expanded in place."""
    hints = get_type_hints(record, include_extras=True)
    parameters: list[inspect.Parameter] = []
    for field in dataclasses.fields(record):
        inner = dataclasses.is_dataclass(hints[field.name])
        parameters += _fields(hints[field.name]) if inner else [_declared(field.name, hints[field.name], field.default)]
    return parameters


def _read_value(hint: Any, name: str, values: dict[str, Any]) -> Any:
    """Take the value of a parameter from the parsed values; for a dataclass, build it from them."""
    if not dataclasses.is_dataclass(hint):
        return values.pop(name)
    hints = get_type_hints(hint, include_extras=True)
    return hint(
        **{field.name: _read_value(hints[field.name], field.name, values) for field in dataclasses.fields(hint)}
    )  # type: ignore[operator]


def _is_hidden(hint: Any) -> bool:
    return any(isinstance(part, typer.models.OptionInfo) and part.hidden for part in get_args(hint))


def _show_all(context: typer.Context, is_requested: bool) -> None:
    """Print the help with the hidden options."""
    if is_requested:
        for parameter in context.command.params:
            parameter.hidden = False  # type: ignore[attr-defined]  # of options; arguments are shown in any case
        typer.echo(context.get_help())
        raise typer.Exit


HelpAll = Annotated[
    bool,
    Option("--help-all", is_eager=True, callback=_show_all, help="Show this message with all options."),
]


def load_plugins(modules: Sequence[str] | None) -> None:
    """Import modules from the Python path or from the current folder.

    Raises
    ------
    InvalidInput
        When a module does not exist.
    """
    if modules and "" not in sys.path:
        sys.path.append("")
    for name in modules or ():
        missing = f"--plugin {name}: no such module in the Python path or in the current folder."
        import_plugin(name, InvalidInput(missing))


def car_and_plant(vehicle: str, plant: str, tyre: str | None) -> tuple[Car, PlantOf | SteppedPlant]:
    """Load the car model of the controller and make the simulated plant."""
    from adaptrack.cars.plant import get_plant
    from adaptrack.cars.vehicle import load_vehicle

    car = load_vehicle(vehicle)
    return car, get_plant(plant, car, tyre)


def make_folder(path: Path) -> None:
    """Make a folder and check that files can be written to it.

    Raises
    ------
    StorageError
        When the folder cannot be made or written to.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
        probe = path / ".writable"
        probe.touch()
        probe.unlink()
    except (OSError, ValueError) as error:  # ValueError: a path with NUL
        raise StorageError(f"{path}: cannot be written to: {getattr(error, 'strerror', None) or error}.") from error


def make_place(file: Path | None) -> None:
    """Make the folder of an output file, unless `file` is None.

    Raises
    ------
    StorageError
        When its folder cannot be written to, or what is there may not be replaced (`check_replaceable`).
    """
    from adaptrack.base.files import check_replaceable

    if file is None:
        return
    make_folder(file.parent)
    check_replaceable(file)


def make_page_folder(out: Path | None, png: bool = False) -> None:
    """Make the folder of a page, unless `out` is None.

    Raises
    ------
    InvalidInput
        When PNG files are requested without a page.
    StorageError
        When the folder cannot be made or written to, or has the page of another program.
    """
    from adaptrack.base.files import PAGE_FILE

    if png and out is None:
        raise InvalidInput("--png: needs a folder, --out.")
    if out is not None:
        make_folder(out)
        make_place(out / PAGE_FILE)


def command_line() -> str:
    """Return the current command line."""
    return shlex.join(["adaptrack", *sys.argv[1:]])

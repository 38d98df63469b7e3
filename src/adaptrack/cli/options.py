"""Declaration of options as fields of classes, options that several commands share, and their evaluation."""

from __future__ import annotations

import dataclasses
import functools
import inspect
import shlex
import sys
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar, dataclass_transform, get_args, get_type_hints

import typer

import adaptrack as at
from adaptrack.base.errors import InvalidInput, StorageError
from adaptrack.base.registry import import_plugin

if TYPE_CHECKING:
    from adaptrack.drive.planner import SimulatedPlanner

Group = TypeVar("Group")

EXIT_FAILED = 3
"""The exit code when a run failed, or when measurements contradict each other."""


# -- declarations -----------------------------------------------------------------------------------------------------
def option(metavar: str | None, help: str, default: Any = None, *, names: Sequence[str] = (), **settings: Any) -> Any:
    """Declare an option: the default of an argument of a command, or of a field of an `option_group`.

    default: ``...`` if the option is required; names: by default that of the argument; settings: as for `typer.Option`.
    """
    return _declare(default, names=tuple(names), metavar=metavar, help=help, **settings)


def flag(help: str, **settings: Any) -> Any:
    """Declare an option without a value; arguments as for `option`."""
    return option(None, help, False, **settings)


def argument(metavar: str, help: str, default: Any = None, **settings: Any) -> Any:
    """Declare a positional argument; arguments as for `option`, settings as for `typer.Argument`."""
    return _declare(default, names=None, metavar=metavar, help=help, **settings)


def _declare(default: Any, **settings: Any) -> Any:
    return dataclasses.field(default=dataclasses.MISSING if default is ... else default, metadata=settings)


@dataclass_transform(kw_only_default=True, frozen_default=True)
def option_group(cls: type[Group]) -> type[Group]:
    """Make a class of options that several functions need: its fields are options, or other groups."""
    return dataclasses.dataclass(frozen=True, kw_only=True)(cls)


def option_names(name: str, field: dataclasses.Field[Any]) -> tuple[str, ...]:
    """Names of an option, such as ``--lateral-acceleration``; none for an argument."""
    names = field.metadata["names"]
    return () if names is None else names or (f"--{name.replace('_', '-')}",)


def option_words(group: Any, *names: str) -> list[str]:
    """Return the options of a group that differ from their defaults, as words of a command line.

    names: fields of these options; all if there are none.
    """
    words = list[str]()
    for field in dataclasses.fields(group):
        value = getattr(group, field.name)
        if dataclasses.is_dataclass(value):
            words += option_words(value, *names)
        elif (
            value not in (None, field.default)
            and option_names(field.name, field)
            and (not names or field.name in names)
        ):
            on, _, off = option_names(field.name, field)[0].partition("/")
            if isinstance(value, bool):
                words.append(on if value else off)
            elif isinstance(value, list):
                words += [word for entry in value for word in (on, str(entry))]
            else:
                words += [on, *map(str, value if isinstance(value, tuple) else (value,))]
    return words


def grouped(command: Callable[..., None]) -> Callable[..., None]:
    """Convert a function to a typer command with one option for each argument and for each field of its groups.

    Rarely used options are declared hidden. `--help` omits them. Commands with hidden options also get the option
    `--help-all`, which shows them.
    """
    declared = _parameters(command)
    if any(get_args(parameter.annotation)[1].hidden for parameter in declared):
        declared.append(_parameter("help_all", HelpAll, False))

    def run(**values: Any) -> None:
        command(**_read(command, values))

    functools.update_wrapper(run, command)
    run.__signature__ = inspect.Signature(declared)  # type: ignore[attr-defined]
    run.__annotations__ = {parameter.name: parameter.annotation for parameter in declared}
    return run


def _is_group(hint: Any) -> bool:
    return dataclasses.is_dataclass(hint)


def _declarations(owner: Any) -> list[tuple[str, Any, Any]]:
    """Name, type and declaration of each argument of a command or field of a group; a group has no declaration."""
    hints = get_type_hints(owner)
    if _is_group(owner):
        return [(field.name, hints[field.name], field) for field in dataclasses.fields(owner)]
    return [(name, hints[name], parameter.default) for name, parameter in inspect.signature(owner).parameters.items()]


def _parameters(owner: Any) -> list[inspect.Parameter]:
    """Return the options of a command or group, with its groups expanded in place."""
    parameters = list[inspect.Parameter]()
    for name, hint, field in _declarations(owner):
        if _is_group(hint):
            parameters += _parameters(hint)
            continue
        settings = {key: value for key, value in field.metadata.items() if key != "names"}
        names = option_names(name, field)
        info = typer.Option(*names, **settings) if names else typer.Argument(**settings)
        parameters.append(_parameter(name, Annotated[hint, info], field.default))
    return parameters


def _parameter(name: str, hint: Any, default: Any) -> inspect.Parameter:
    if default is dataclasses.MISSING:
        default = inspect.Parameter.empty
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=hint)


def _read(owner: Any, values: dict[str, Any]) -> dict[str, Any]:
    """Return the arguments of a command or group from the parsed values."""
    return {
        name: hint(**_read(hint, values)) if _is_group(hint) else values[name] for name, hint, _ in _declarations(owner)
    }


def _show_all(context: typer.Context, is_requested: bool) -> None:
    """Print the help with the hidden options."""
    if is_requested:
        for parameter in context.command.params:
            parameter.hidden = False  # type: ignore[attr-defined]  # of options; arguments are shown in any case
        typer.echo(context.get_help())
        raise typer.Exit


HelpAll = Annotated[
    bool,
    typer.Option("--help-all", is_eager=True, callback=_show_all, help="Show this message with all options."),
]


# -- shared options ---------------------------------------------------------------------------------------------------
vehicle_option = partial(option, "CAR", "Car: see `list cars`, or a .toml file.")
plant_option = partial(
    option, "NAME", "Simulated plant: single-track, dual-track, or a registered plant.", "dual-track", hidden=True
)
plugin_option = partial(option, "MODULE", "Python module that registers further names; may be repeated.", hidden=True)
profile_option = partial(
    option, "NAME", "Simulated steering and sensors. paper: ideal; road: lag, noise, delay; or a .toml file."
)
scheduler_option = partial(option, "NAME", "Schedule: see `list schedules`, or a .json file of `paper train`.")
speed_option = partial(option, "V", "Constant speed (m/s); default: planned speed.")
assumed_friction_option = partial(
    option,
    "MU|LOW:HIGH",
    "Assumed friction; plan and driver use the lower end of an interval, a speed control narrows it while driving. "
    "Default: the road's, of an exported speed control 0.9.",
    hidden=True,
)
lateral_acceleration_option = partial(option, "A", "Lateral acceleration limit (m/s²); default: 3.")
road_length_option = partial(option, "M", "Length of generated roads (m); default: 2000.", hidden=True)
noise_seed_option = partial(option, None, "Seed of the sensor noise.", 0, hidden=True)
planner_option = partial(
    option,
    "SETTINGS",
    "Road: follow the trajectories of a simulated planner, such as period=0.1,delay=0.3,jitter=0.05,start=pose.",
    hidden=True,
)
prescribed_speed_flag = partial(flag, "Follow the planned speed exactly, without forces along the road.", hidden=True)
page_option = partial(option, "FOLDER", "Folder for the page and its pictures.")
json_flag = partial(flag, "Print the result as JSON.", names=["--json"])


@option_group
class CarAndPlant:
    """Options for the car model of the controller and the simulated plant."""

    vehicle: str = vehicle_option("paper")
    plant: str = plant_option()
    tyre: str | None = option("TYRE", "Tyre: see `list tyres`, or a .toml file; default: the car's.", hidden=True)
    plugin: list[str] | None = plugin_option()

    def load(self) -> tuple[at.Vehicle, at.Plant | at.SteppedPlant]:
        """Load the car model of the controller and make the simulated plant, after importing the plugins."""
        load_plugins(self.plugin)
        car = at.load_vehicle(self.vehicle)
        return car, at.get_plant(self.plant, car, self.tyre)


def load_plugins(modules: Sequence[str] | None) -> None:
    """Import modules from the Python path or from the current folder; InvalidInput if one does not exist."""
    if modules and "" not in sys.path:
        sys.path.append("")
    for name in modules or ():
        missing = f"--plugin {name}: no such module in the Python path or in the current folder."
        import_plugin(name, InvalidInput(missing))


def make_planner(text: str | None) -> SimulatedPlanner | None:
    """Return the planner of the option ``--planner``, None without it; raises `InvalidInput` for its settings."""
    from adaptrack.drive import planner  # NumPy, which --help does not need

    if text is not None and not text.strip():
        raise InvalidInput("--planner '': has no settings: give at least one, such as period=0.1, or leave it out.")
    return None if text is None else planner.make_planner(text)


# -- output files -----------------------------------------------------------------------------------------------------
def make_folder(path: Path) -> None:
    """Make a folder; StorageError if it cannot be made or written to."""
    try:
        path.mkdir(parents=True, exist_ok=True)
        probe = path / ".writable"
        probe.touch()
        probe.unlink()
    except (OSError, ValueError) as error:  # ValueError: a path with NUL
        raise StorageError(f"{path}: cannot be written to: {getattr(error, 'strerror', None) or error}.") from error


def make_place(file: Path | None, ending: str = "", option: str = "--out") -> None:
    """Make the folder of an output file, unless `file` is None.

    Raises InvalidInput if the name of the file, which an option states, ends differently, and StorageError if its
    folder cannot be written to, or what is there may not be replaced (`check_replaceable`).
    """
    from adaptrack.base.files import check_replaceable

    if file is None:
        return
    if ending not in ("", file.suffix) and not file.is_dir():
        raise InvalidInput(f"{option} {file}: give a file name that ends in {ending}, such as {file.stem}{ending}.")
    make_folder(file.parent)
    check_replaceable(file)


def make_page_folder(out: Path | None, png: bool = False) -> None:
    """Make the folder of a page, unless `out` is None; see `make_place`. PNG files need a page."""
    from adaptrack.base.files import PAGE_FILE

    if png and out is None:
        raise InvalidInput("--png: needs a folder, --out.")
    if out is not None:
        make_folder(out)
        make_place(out / PAGE_FILE)


def command_line() -> str:
    """Return the current command line."""
    return shlex.join(["adaptrack", *sys.argv[1:]])

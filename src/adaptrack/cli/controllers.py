"""Controllers from the options of a command line: their tuning, moves, schedule and learned car."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Option

from adaptrack.base.errors import InvalidInput, UnknownName, did_you_mean
from adaptrack.cli import options, show

if TYPE_CHECKING:
    from adaptrack.cars.vehicle import Vehicle
    from adaptrack.control.controllers import Controller, Learning, Moves, Tuning
    from adaptrack.control.scheduling import Schedule
    from adaptrack.scenario.profile import Profile

INFORMED_NAME, STANDARD_NAME, AS_WRITTEN, AS_RELEASED = "informed", "standard", "as-written", "as-released"


@dataclass(frozen=True)
class PublishedOptions:
    """Tuning and moves of the published MPC, and of the informed one where they are given."""

    np_: Annotated[int | None, Option("--np", hidden=True, help="Prediction horizon (periods); standard: 35.")] = None
    nc: Annotated[int | None, Option("--nc", hidden=True, help="Control horizon (periods); standard: 8.")] = None
    q: Annotated[
        float | None, Option("--q", hidden=True, help="Weight of the tracking error (1/m^2); standard: 10.")
    ] = None
    r: Annotated[float | None, Option("--r", hidden=True, help="Weight of the moves (1/rad^2); standard: 0.01.")] = None
    moves: Annotated[
        options.MovesName, Option("--moves", hidden=True, help="pulse: eq. (10); laguerre: Laguerre functions.")
    ] = options.MovesName.pulse
    laguerre_pole: Annotated[
        float, Option("--laguerre-pole", hidden=True, help="Pole a of the Laguerre functions.")
    ] = 0.95
    laguerre_terms: Annotated[int, Option("--laguerre-terms", hidden=True, help="Number of Laguerre functions.")] = 10
    solver: Annotated[
        str, Option("--solver", metavar="NAME", hidden=True, help="QP solver: active-set or hildreth")
    ] = "active-set"
    preview: Annotated[
        bool | None,
        Option("--preview/--no-preview", hidden=True, help="Know the reference ahead; scenarios: as the profile says."),
    ] = None

    @property
    def tuning(self) -> dict[str, Any]:
        """The entries that are given, by name."""
        entries = {"Np": self.np_, "Nc": self.nc, "Q": self.q, "R": self.r}
        return {name: value for name, value in entries.items() if value is not None}

    def make_moves(self) -> Moves:
        """The moves as the MPC takes them."""
        from adaptrack.control.controllers import Moves

        return Moves(self.moves.value, self.laguerre_pole, self.laguerre_terms)


@dataclass(frozen=True)
class ControllerSettings:
    """The car, profile and options that make a controller."""

    car: Vehicle
    profile: Profile
    period: float
    """Control period (s)."""
    preview: bool
    tuning: dict[str, Any] = field(default_factory=dict)
    """the entries that are given, by name"""
    moves: Moves | None = None
    """None: pulses"""
    solver: str = "active-set"
    schedule: Schedule | None = None
    label: str = ""
    """the scheduler's name in tables: as on the command line"""
    learning: Learning | None = None
    computation: float | None = None
    """s; None: of the profile"""

    @property
    def default_name(self) -> str:
        """The controller that drives unless one is named."""
        from adaptrack.control.controllers.compatibility import is_for_published

        if self.schedule is not None:
            return STANDARD_NAME if is_for_published(self.schedule.made_for) else INFORMED_NAME
        laguerre = self.moves is not None and self.moves.kind != "pulse"
        return STANDARD_NAME if self.tuning or laguerre else INFORMED_NAME

    @property
    def most_moves(self) -> int:
        """The largest control horizon for which the MPC makes room."""
        return max(20, 0 if self.schedule is None else self.schedule.largest[1])

    def tuned(self, base: Tuning) -> Tuning:
        """A tuning with the entries that are given."""
        return replace(base, **self.tuning)


def make_controller(name: str, settings: ControllerSettings) -> tuple[str, Controller]:
    """A controller by its name, and its label in tables: an MPC, or one that is registered.

    Raises
    ------
    UnknownName
        For a name that no controller has.
    InvalidInput
        When the options contradict each other.
    """
    from adaptrack.control.controllers import Moves, Tuning, get_controller, list_controllers, published_mpc

    chosen = settings.moves or Moves.pulses()
    moves = {STANDARD_NAME: chosen, AS_WRITTEN: Moves.pulses(), AS_RELEASED: Moves.laguerre(0.95, chosen.terms)}
    registered = [other for other in list_controllers() if other not in moves]
    if name in registered:
        offered = {key: getattr(settings, key) for key in ("period", "preview", "computation")}
        arguments = _informed_arguments(settings, chosen) if name == INFORMED_NAME else _no_schedule(name, settings)
        label = settings.label if settings.schedule is not None else name
        return label, get_controller(name, settings.car, profile=settings.profile, offered=offered, **arguments)
    if name not in moves:
        raise UnknownName(f"no controller is named {name!r}. {did_you_mean(name, [*moves, *registered])}")
    tuning = settings.tuned(Tuning())
    mpc = published_mpc(
        settings.car, tuning, period=settings.period, moves=moves[name], preview=settings.preview,
        solver=settings.solver, scheduler=settings.schedule, most_moves=max(tuning.Nc, settings.most_moves),
    )  # fmt: skip
    if not settings.label:
        return name, mpc
    return settings.label if name == STANDARD_NAME else f"{settings.label}-{name}", mpc


def _informed_arguments(settings: ControllerSettings, moves: Moves) -> dict[str, Any]:
    """The arguments of the informed MPC, beyond those that every controller is offered."""
    from adaptrack.control.controllers import informed_tuning
    from adaptrack.control.controllers.compatibility import is_for_published

    arguments: dict[str, Any] = {"moves": moves, "solver": settings.solver}
    if settings.learning is not None:
        arguments["learning"] = settings.learning
    if settings.schedule is not None:
        if is_for_published(settings.schedule.made_for):
            raise InvalidInput(
                f"--scheduler {settings.label}: tunes the published MPC; controller 'informed' takes none, "
                "--controller standard does."
            )
        arguments |= {"scheduler": settings.schedule, "most_moves": settings.most_moves}
    if settings.tuning:
        arguments["tuning"] = settings.tuned(informed_tuning(settings.profile, settings.period))
    return arguments


def _no_schedule(name: str, settings: ControllerSettings) -> dict[str, Any]:
    """No arguments; refused where a scheduler is given."""
    if settings.schedule is not None:
        raise InvalidInput(f"--scheduler {settings.label}: tunes the MPC; controller {name!r} takes none.")
    return {}


def make_tuned(file: Path, settings: ControllerSettings) -> tuple[str, Controller]:
    """The controller of a tuning's file, and its label in tables; warns where it was found for something else."""
    from adaptrack.tuning.constant_file import load_tuning

    tuning = load_tuning(file)
    for clause in tuning.mismatches(settings.car.name, settings.profile.name, settings.period):
        show.say(f"Warning, {file}: {clause}.", aside=True)
    loop = settings.period, settings.preview, settings.computation
    return tuning.label(file), tuning.make(settings.car, settings.profile, *loop)


def certify_tuned(
    file: Path, controller: Controller, settings: ControllerSettings, plant: Any, allow_unstable: bool
) -> None:
    """Certify an MPC's constant that was found for another car, see `new_car`."""
    from adaptrack.cli.new_car import judge
    from adaptrack.control.controllers import MPC
    from adaptrack.tuning.constant_file import load_tuning

    made_for, car = load_tuning(file).vehicle, settings.car
    if made_for != car.name and isinstance(controller, MPC):
        clause = f"{file}, found for the car {made_for!r}, on {car.name!r}"
        judge(clause, controller.tuning, (controller, plant, car, settings.profile), allow_unstable)


def make_learning(learn: bool, file: Path | None) -> Learning | None:
    """The learning of the informed controller, starting from the file if it exists; None: it does not learn."""
    from adaptrack.control.controllers import Learning, load_learned_car

    if not (learn or file is not None):
        return None
    return Learning(start=load_learned_car(file) if file is not None and file.exists() else None)


def save_learned(file: Path | None, controllers: Sequence[tuple[str, Controller]], aside: bool) -> None:
    """Write the car that the informed controller has learned to the file, if there is one, for the next drive."""
    if file is None:
        return
    for _, controller in controllers:
        if controller.learner is not None:
            controller.learned().to_toml(file)  # type: ignore[attr-defined]
            show.say(f"Learned: {file}", aside=aside)

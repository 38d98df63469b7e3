"""Controllers from the options of a command line, with tuning, schedule and learned car."""

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
    """Options for tuning and move parametrisation of the published and the informed MPC."""

    np_: Annotated[
        int | None, Option("--np", hidden=True, help="Prediction horizon (periods); default of standard: 35.")
    ] = None
    nc: Annotated[
        int | None, Option("--nc", hidden=True, help="Control horizon (periods); default of standard: 8.")
    ] = None
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
        Option(
            "--preview/--no-preview",
            hidden=True,
            help="Whether controllers know the reference ahead; default: on roads, or if set in the profile.",
        ),
    ] = None

    @property
    def tuning(self) -> dict[str, Any]:
        """Tuning entries on the command line, by name."""
        from adaptrack.control.controllers.tuning import ENTRIES

        values = zip(ENTRIES, (self.np_, self.nc, self.q, self.r), strict=True)
        return {name: value for name, value in values if value is not None}

    def make_moves(self) -> Moves:
        """Return the move parametrisation for the MPC."""
        from adaptrack.control.controllers import Moves

        return Moves(self.moves.value, self.laguerre_pole, self.laguerre_terms)


@dataclass(frozen=True)
class ControllerSettings:
    """Car, profile and options of a controller."""

    car: Vehicle
    profile: Profile
    period: float
    """Control period (s)."""
    preview: bool
    tuning: dict[str, Any] = field(default_factory=dict)
    """Tuning entries on the command line, by name."""
    moves: Moves | None = None
    """Parametrisation of the moves; None for pulses."""
    solver: str = "active-set"
    schedule: Schedule | None = None
    label: str = ""
    """Name of the schedule in tables, as on the command line."""
    learning: Learning | None = None
    computation: float | None = None
    """Computation time (s); None for that of the profile."""

    @property
    def default_name(self) -> str:
        """Name of the default controller for these options."""
        from adaptrack.control.controllers.compatibility import is_for_published

        if self.schedule is not None:
            return STANDARD_NAME if is_for_published(self.schedule.made_for) else INFORMED_NAME
        laguerre = self.moves is not None and self.moves.kind != "pulse"
        return STANDARD_NAME if self.tuning or laguerre else INFORMED_NAME

    @property
    def most_moves(self) -> int:
        """Largest control horizon of the MPC (periods)."""
        return max(20, 0 if self.schedule is None else self.schedule.largest[1])

    def tuned(self, base: Tuning) -> Tuning:
        """Return the tuning with the entries of the command line."""
        return replace(base, **self.tuning)


def make_controller(name: str, settings: ControllerSettings) -> tuple[str, Controller]:
    """Return the label and the controller of a name: an MPC or a registered controller.

    Raises
    ------
    UnknownName
        When no controller has this name.
    InvalidInput
        When the options contradict each other.
    """
    from adaptrack.control.controllers import Moves, Tuning, get_controller, list_controllers, published_mpc

    chosen = settings.moves or Moves.pulses()
    moves = {STANDARD_NAME: chosen, AS_WRITTEN: Moves.pulses(), AS_RELEASED: Moves.laguerre(0.95, chosen.terms)}
    registered = [other for other in list_controllers() if other not in moves]
    if name in registered:
        optional = {key: getattr(settings, key) for key in ("period", "preview", "computation")}
        arguments = _informed_arguments(settings, chosen) if name == INFORMED_NAME else _no_schedule(name, settings)
        label = settings.label if settings.schedule is not None else name
        return label, get_controller(name, settings.car, profile=settings.profile, optional=optional, **arguments)
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
    """Return the arguments of the informed MPC in addition to those of every controller."""
    from adaptrack.control.controllers import informed_tuning
    from adaptrack.control.controllers.compatibility import is_for_published

    arguments: dict[str, Any] = {"moves": moves, "solver": settings.solver}
    if settings.learning is not None:
        arguments["learning"] = settings.learning
    if settings.schedule is not None:
        if is_for_published(settings.schedule.made_for):
            raise InvalidInput(f"--scheduler {settings.label}: made for the published MPC: use --controller standard.")
        arguments |= {"scheduler": settings.schedule, "most_moves": settings.most_moves}
    if settings.tuning:
        arguments["tuning"] = settings.tuned(informed_tuning(settings.profile, settings.period))
    return arguments


def _no_schedule(name: str, settings: ControllerSettings) -> dict[str, Any]:
    """Return no arguments; raise InvalidInput if a schedule is given."""
    if settings.schedule is not None:
        raise InvalidInput(
            f"--scheduler {settings.label}: schedules tune an MPC; leave the option out for controller {name!r}."
        )
    return {}


def make_tuned(file: Path, settings: ControllerSettings) -> tuple[str, Controller]:
    """Return the label and the controller of a tuning file; warn if it was made for different conditions."""
    from adaptrack.tuning.constant import load_tuning

    tuning = load_tuning(file)
    for clause in tuning.mismatches(settings.car.name, settings.profile.name, settings.period):
        show.say(f"Warning, {file}: {clause}.", aside=True)
    loop = settings.period, settings.preview, settings.computation
    return tuning.label(file), tuning.make(settings.car, settings.profile, *loop)


def certify_tuned(file: Path, controller: Any, settings: ControllerSettings, plant: Any, allow_unstable: bool) -> None:
    """Certify the constant tuning of an MPC that was found for a different car, see `new_car`."""
    from adaptrack.cli.new_car import judge
    from adaptrack.tuning.constant import load_tuning

    made_for, car = load_tuning(file).vehicle, settings.car
    if made_for != car.name and controller.has_horizons:
        clause = f"{file}, found for the car {made_for!r}, on {car.name!r}"
        judge(clause, controller.tuning, (controller, plant, car, settings.profile), allow_unstable)


def make_learning(learn: bool, file: Path | None) -> Learning | None:
    """Return the learning settings of the informed controller, which start from `file` if it exists; None without."""
    from adaptrack.control.controllers import Learning, load_learned_car

    if not (learn or file is not None):
        return None
    return Learning(start=load_learned_car(file) if file is not None and file.exists() else None)


def save_learned(file: Path | None, controllers: Sequence[tuple[str, Controller]], aside: bool) -> None:
    """Write the learned car of the informed controller to a file for the next drive, unless `file` is None."""
    if file is None:
        return
    for _, controller in controllers:
        if controller.learner is not None:
            controller.learned().to_toml(file)  # type: ignore[attr-defined]
            show.say(f"Learned: {file}", aside=aside)

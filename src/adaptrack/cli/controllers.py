"""Controllers from the options of a command line, with tuning, schedule and learned car."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import adaptrack as at
from adaptrack.base.errors import InvalidInput, UnknownName, did_you_mean
from adaptrack.cli import show
from adaptrack.cli.options import option, option_group

INFORMED_NAME, STANDARD_NAME, AS_WRITTEN, AS_RELEASED = "informed", "standard", "as-written", "as-released"
CERTIFIED_LEVELS = (9, 3)
"""Numbers of speeds and frictions in the certificate for a different car."""


@option_group
class PublishedOptions:
    """Options for tuning and move parametrisation of the published and the informed MPC."""

    np_: int | None = option(
        None, "Prediction horizon (periods); default of standard: 35.", names=["--np"], hidden=True
    )
    nc: int | None = option(None, "Control horizon (periods); default of standard: 8.", hidden=True)
    q: float | None = option(None, "Weight of the tracking error (1/m^2); standard: 10.", hidden=True)
    r: float | None = option(None, "Weight of the moves (1/rad^2); standard: 0.01.", hidden=True)
    moves: Literal["pulse", "laguerre"] = option(
        None, "pulse: eq. (10); laguerre: Laguerre functions.", "pulse", hidden=True
    )
    laguerre_pole: float = option(None, "Pole a of the Laguerre functions.", 0.95, hidden=True)
    laguerre_terms: int = option(None, "Number of Laguerre functions.", 10, hidden=True)
    solver: str = option("NAME", "QP solver: active-set or hildreth", "active-set", hidden=True)
    preview: bool | None = option(
        None,
        "Whether controllers know the reference ahead; default: on roads, or if set in the profile.",
        names=["--preview/--no-preview"],
        hidden=True,
    )

    @property
    def tuning(self) -> dict[str, Any]:
        """Tuning entries on the command line, by name."""
        from adaptrack.control.controllers.tuning import ENTRIES

        values = zip(ENTRIES, (self.np_, self.nc, self.q, self.r), strict=True)
        return {name: value for name, value in values if value is not None}

    def make_moves(self) -> at.Moves:
        """Return the move parametrisation for the MPC."""
        return at.Moves(self.moves, self.laguerre_pole, self.laguerre_terms)


@dataclass(frozen=True)
class ControllerSettings:
    """Car, profile and options of a controller."""

    car: at.Vehicle
    profile: at.Profile
    period: float
    """Control period (s)."""
    preview: bool
    tuning: dict[str, Any] = field(default_factory=dict)
    """Tuning entries on the command line, by name."""
    moves: at.Moves | None = None
    """Parametrisation of the moves; None for pulses."""
    solver: str = "active-set"
    schedule: at.Schedule | None = None
    label: str = ""
    """Name of the schedule in tables, as on the command line."""
    learning: at.Learning | None = None
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

    def tuned(self, base: at.Tuning) -> at.Tuning:
        """Return the tuning with the entries of the command line."""
        return replace(base, **self.tuning)


def make_controller(name: str, settings: ControllerSettings) -> tuple[str, at.Controller]:
    """Return the label and the controller of a name: an MPC or a registered controller.

    Raises UnknownName for a different name, and InvalidInput for options that contradict each other.
    """
    chosen = settings.moves or at.Moves.pulses()
    moves = {STANDARD_NAME: chosen, AS_WRITTEN: at.Moves.pulses(), AS_RELEASED: at.Moves.laguerre(0.95, chosen.terms)}
    registered = [other for other in at.list_controllers() if other not in moves]
    if name in registered:
        optional = {key: getattr(settings, key) for key in ("period", "preview", "computation")}
        arguments = _informed_arguments(settings, chosen) if name == INFORMED_NAME else {}
        if settings.schedule is not None and name != INFORMED_NAME:
            raise InvalidInput(
                f"--scheduler {settings.label}: schedules tune an MPC; leave the option out for controller {name!r}."
            )
        label = settings.label if settings.schedule is not None else name
        return label, at.get_controller(name, settings.car, profile=settings.profile, optional=optional, **arguments)
    if name not in moves:
        raise UnknownName(f"no controller is named {name!r}. {did_you_mean(name, [*moves, *registered])}")
    tuning = settings.tuned(at.Tuning())
    mpc = at.published_mpc(
        settings.car, tuning, period=settings.period, moves=moves[name], preview=settings.preview,
        solver=settings.solver, scheduler=settings.schedule, most_moves=max(tuning.Nc, settings.most_moves),
    )  # fmt: skip
    if not settings.label:
        return name, mpc
    return settings.label if name == STANDARD_NAME else f"{settings.label}-{name}", mpc


def _informed_arguments(settings: ControllerSettings, moves: at.Moves) -> dict[str, Any]:
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


def make_tuned(file: Path, settings: ControllerSettings) -> tuple[str, at.Controller]:
    """Return the label and the controller of a tuning file; warn if it was made for different conditions."""
    from adaptrack.tuning.constant import load_tuning

    tuning = load_tuning(file)
    for clause in tuning.mismatches(settings.car.name, settings.profile.name, settings.period):
        show.say(f"Warning, {file}: {clause}.", aside=True)
    loop = settings.period, settings.preview, settings.computation
    return tuning.label(file), tuning.make(settings.car, settings.profile, *loop)


def make_learning(learn: bool, file: Path | None) -> at.Learning | None:
    """Return the learning settings of the informed controller, which start from `file` if it exists; None without."""
    if not (learn or file is not None):
        return None
    return at.Learning(start=at.load_learned_car(file) if file is not None and file.exists() else None)


def save_learned(file: Path | None, controllers: Sequence[tuple[str, at.Controller]], aside: bool) -> None:
    """Write the learned car of the informed controller to a file for the next drive, unless `file` is None."""
    if file is None:
        return
    for _, controller in controllers:
        if controller.learner is not None:
            controller.learned().to_toml(file)  # type: ignore[attr-defined]
            show.say(f"Learned: {file}", aside=aside)


# -- certificates for a different car ---------------------------------------------------------------------------------
def certify_meeting(label: str, mpc: at.MPC, plant: Any, car: at.Vehicle, world: at.Profile, allowed: bool) -> None:
    """Certify a scheduled MPC whose schedule was made for a different car than the modelled or the simulated one.

    label: name of the schedule in messages; allowed: whether an unstable loop is only a warning. Schedules without a
    car, or for this car, are not certified.
    """
    from adaptrack.control.controllers.compatibility import car_of

    schedule = mpc.scheduler
    if not isinstance(schedule, at.Schedule):
        return
    made_for = schedule.made_for.get("car")
    other_cars = [name for name in dict.fromkeys((car_of(mpc.model), car_of(plant))) if name not in (None, made_for)]
    if made_for is not None and other_cars:
        clause = f"scheduler {label!r}, made for the car {made_for!r}, on {' and '.join(map(repr, other_cars))}"
        _judge(clause, schedule, (mpc, plant, car, world), allowed)


def certify_tuned(file: Path, controller: Any, settings: ControllerSettings, plant: Any, allow_unstable: bool) -> None:
    """Certify the constant tuning of an MPC that was found for a different car, see `certify_meeting`."""
    from adaptrack.tuning.constant import load_tuning

    made_for, car = load_tuning(file).vehicle, settings.car
    if made_for != car.name and controller.has_horizons:
        clause = f"{file}, found for the car {made_for!r}, on {car.name!r}"
        _judge(clause, controller.tuning, (controller, plant, car, settings.profile), allow_unstable)


def _judge(
    clause: str, tuning: at.Schedule | at.Tuning, loop: tuple[at.MPC, Any, at.Vehicle, at.Profile], allowed: bool
) -> None:
    """Certify a schedule or a tuning over the domain of a car and print the verdict; clause: start of the message.

    Raises InvalidInput if the loop is unstable when driving straight, unless that is allowed.
    """
    from adaptrack.analysis.certify import certify
    from adaptrack.analysis.stability import linear_twin

    mpc, plant, car, world = loop
    domain = {"speed": car.domain.speed, "friction": car.domain.friction}
    with show.progress("certify for this car") as advance:
        certificate = certify(
            tuning, linear_twin(plant, car, car.domain), mpc, world.without_sample_ages, domain=domain,
            levels=CERTIFIED_LEVELS, progress=advance,
        )  # fmt: skip
    clause += f": certificate over the domain of {car.name!r}: {certificate.verdict}"
    if not certificate.passed and not allowed:
        raise InvalidInput(f"{clause} To drive it anyway, use --allow-failed.")
    show.say(f"Warning, {clause}", aside=True)

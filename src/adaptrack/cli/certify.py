"""`adaptrack certify`: is the loop stable with everything that a scheduler can ask for? What can be held at all?"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Option

from adaptrack.base.errors import InvalidInput, UnknownName, did_you_mean
from adaptrack.cli import options, show
from adaptrack.cli.controllers import INFORMED_NAME, STANDARD_NAME
from adaptrack.cli.next_step import command, next_line, repeat_command_with
from adaptrack.cli.show import Column

if TYPE_CHECKING:
    from adaptrack.analysis.certify import Certificate
    from adaptrack.analysis.feasibility import Feasibility
    from adaptrack.base.result import Result
    from adaptrack.cars.vehicle import Vehicle
    from adaptrack.control.controllers import MPC
    from adaptrack.control.scheduling import Schedule

UNSTABLE = 1
"""The exit code when a loop is unstable, driving straight, or a domain cannot be held."""
BEST_COLUMNS = (
    Column("held", "held"),
    Column("speed", "speed", "m/s", 3),
    Column("friction", "friction", "", 3),
    Column("Np", "Np", "", 3),
    Column("Nc", "Nc", "", 3),
    Column("ratio", "R/Q", "m²/rad²", 3),
    Column("modulus_margin", "modulus\nmargin", "", 3),
)
"""Of the table of what can be held."""


@dataclass(frozen=True, kw_only=True)
class CertifyOptions:
    """Options of `adaptrack certify`."""

    scheduler: Annotated[
        str | None,
        typer.Argument(help="Schedule: see `list schedules`, or a .json file; default: the constant tuning."),
    ] = None
    controller: Annotated[
        str | None,
        Option(
            "--controller",
            metavar="NAME",
            help="informed: MPC with a steering model [default]; standard: the paper's "
            "[default with a scheduler that was made for it].",
        ),
    ] = None
    profile: options.ProfileOption = "road"
    car: options.CarAndPlant
    speed: Annotated[
        tuple[float, float] | None, Option("--speed", metavar="LOW HIGH", help="Lowest and highest speed (m/s).")
    ] = None
    friction: Annotated[
        tuple[float, float] | None, Option("--friction", metavar="LOW HIGH", help="Lowest and highest friction.")
    ] = None
    mismatch: Annotated[
        bool,
        Option(
            "--mismatch", help="Also with a lag error of 0.1 s, dead time of one period, stiffness x 1.6, mass 30 %."
        ),
    ] = False
    feasible: Annotated[bool, Option("--feasible", help="Show the speeds and frictions that some tuning can hold.")] = (
        False
    )
    out: Annotated[Path | None, Option("--out", metavar="FOLDER", help="Folder for the page with the maps.")] = None
    as_json: options.Json = False

    @property
    def domain(self) -> dict[str, tuple[float, float]]:
        """The ends that are given."""
        ends = {"speed": self.speed, "friction": self.friction}
        return {name: interval for name, interval in ends.items() if interval is not None}


@options.grouped
def certify(arguments: CertifyOptions) -> None:
    """Compute stability and margins of a loop over its domain.

    The verdict is on driving straight: exit code 1 when a point is unstable there. Points that are unstable in a hard
    turn are counted beside it, as a warning. With --feasible: exit code 1 when a point can be held by no tuning.
    """
    from adaptrack.cars.plant import SteppedPlant
    from adaptrack.control.scheduling import load_scheduler
    from adaptrack.results.certificate import certificate_result
    from adaptrack.scenario.profile import load_profile

    scheduler, profile, out = arguments.scheduler, arguments.profile, arguments.out
    car, plant = arguments.car.load()
    schedule = None if scheduler is None else load_scheduler(scheduler)
    if isinstance(plant, SteppedPlant):
        raise InvalidInput(
            f"--plant {arguments.car.plant}: is stepped in Python; a certificate needs equations that it can linearise."
        )
    mpc = _controller(arguments.controller, car, profile, schedule)
    mpc.warn_of(schedule, load_profile(profile).name, plant)
    if arguments.feasible:
        if scheduler is not None or out is not None:
            raise InvalidInput(
                "--feasible: looks at every tuning and writes no page: leave out the scheduler and --out."
            )
        _tell_feasible(plant, mpc, profile, arguments.domain, arguments.mismatch, arguments.as_json)
        return
    certificate = _certificate(schedule, plant, mpc, profile, arguments.domain, arguments.mismatch, out)
    result = certificate_result(certificate, options.command_line(), next_line(*_next_step(arguments, certificate)))
    show.say_result(result, arguments.as_json, None if out is None else _write_page(out, result))
    if not certificate.passed:
        _tell_worst(certificate)
        raise typer.Exit(UNSTABLE)


def _next_step(arguments: CertifyOptions, certificate: Certificate) -> tuple[str, str]:
    """Suggest the next command after a certificate, with the reason."""
    car = ("--vehicle", arguments.car.vehicle, "--profile", arguments.profile)
    if not certificate.passed:
        return "to see which speeds and frictions any tuning can hold", command("certify", "--feasible", *car)
    if not arguments.mismatch:
        return "to see what a car that differs from its model leaves of the margins", repeat_command_with("--mismatch")
    if arguments.out is None:
        return "to see where the margins are thin on a page", repeat_command_with("--out", "certificate")
    scheduler = () if arguments.scheduler is None else ("--scheduler", arguments.scheduler)
    return "to drive it", command("drive", "general-trajectory", *car, *scheduler)


def _controller(name: str | None, car: Vehicle, profile: str, schedule: Schedule | None) -> MPC:
    """The MPC by name, with horizons as long as the schedule asks for."""
    from adaptrack.control.controllers import MPC, published_mpc
    from adaptrack.control.controllers.compatibility import is_for_published
    from adaptrack.scenario.profile import load_profile

    if name is None:
        name = STANDARD_NAME if schedule is not None and is_for_published(schedule.made_for) else INFORMED_NAME
    longest, most = (60, 20) if schedule is None else schedule.largest
    sizes: dict[str, Any] = {"longest_horizon": max(60, longest), "most_moves": max(20, most)}
    if name == INFORMED_NAME:
        return MPC(car, profile=profile, **sizes)
    if name != STANDARD_NAME:
        raise UnknownName(
            f"no controller to certify is named {name!r}. {did_you_mean(name, [INFORMED_NAME, STANDARD_NAME])}"
        )
    return published_mpc(car, period=load_profile(profile).period, **sizes)


def _certificate(
    schedule: Schedule | None, plant: Any, mpc: MPC, profile: str, domain: dict[str, tuple[float, float]],
    mismatch: bool, out: Path | None,
) -> Certificate:  # fmt: skip
    from adaptrack.analysis.certify import certify as look
    from adaptrack.analysis.linearisation import usual_mismatches

    if out is not None:
        options.make_folder(out)
    against = usual_mismatches(mpc.period) if mismatch else ()
    sought = mpc.tuning if schedule is None else schedule
    with show.progress("certify") as advance:
        return look(sought, plant, mpc, profile, domain=domain, mismatches=against, progress=advance)


def _write_page(out: Path, result: Result) -> Path:
    from adaptrack.results.page import write_result

    with show.progress("write the page"):
        return write_result(out, result)


def _tell_worst(certificate: Certificate) -> None:
    """The verdict with the worst point, where it failed."""
    at = max(certificate.worst_points(len(certificate.points)), key=lambda point: point["radius"] or math.inf)
    show.say_failed(
        f"{certificate.verdict} The worst: {at['speed']:g} m/s on friction {at['friction']:g}, with Np = {at['Np']:g}, "
        f"Nc = {at['Nc']:g}, Q = {at['Q']:g}, R = {at['R']:g}: spectral radius {at['radius'] or math.inf:.4f}.",
        aside=True,
    )


def _tell_feasible(
    plant: Any, mpc: MPC, profile: str, domain: dict[str, tuple[float, float]], mismatch: bool, as_json: bool
) -> None:
    """Print which points can be held; exit code 1 if some cannot."""
    from adaptrack.analysis.feasibility import feasibility
    from adaptrack.analysis.linearisation import usual_mismatches

    against = usual_mismatches(mpc.period) if mismatch else ()
    with show.progress("feasible"):
        result: Feasibility = feasibility(plant, mpc, profile, mismatches=against, **domain)  # type: ignore[arg-type]
    if as_json:
        show.say_json(result.summary())
    else:
        from adaptrack.results.certificate import with_ratio

        title = "The best tuning at each speed and friction, by the modulus margin"
        show.table(title, BEST_COLUMNS, with_ratio(result.summary()["rows"]))
        if mpc.belief is not None:
            show.say(f"Note: belief: {mpc.belief_at_first}.")
    if result.passed and not as_json:
        show.say(result.verdict)
    if not result.passed:
        show.say_failed(result.verdict, aside=True)
        raise typer.Exit(UNSTABLE)

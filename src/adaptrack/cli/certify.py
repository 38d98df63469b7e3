"""`adaptrack certify`: stability and margins of the control loop with all tunings of a schedule."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

import adaptrack as at
from adaptrack.base.errors import InvalidInput, UnknownName, did_you_mean
from adaptrack.cli import options, show
from adaptrack.cli.controllers import INFORMED_NAME, STANDARD_NAME
from adaptrack.cli.next_step import add_command
from adaptrack.cli.options import argument, flag, json_flag, option, option_group, option_words
from adaptrack.cli.show import Column

if TYPE_CHECKING:
    from adaptrack.analysis.linearisation import Mismatch

UNSTABLE = 1
"""Exit code if the loop is unstable when driving straight, or if no tuning is stable at some speed and friction."""


@option_group
class CertifiedLoop:
    """Options for the control loop that is certified, and for its domain."""

    controller: str | None = option(
        "NAME",
        "informed: MPC with steering model and state estimator; standard: published MPC. Default: informed, or the "
        "controller for which the schedule was made.",
    )
    profile: str = options.profile_option("road")
    car: options.CarAndPlant
    speed: tuple[float, float] | None = option("LOW HIGH", "Lowest and highest speed (m/s).")
    friction: tuple[float, float] | None = option("LOW HIGH", "Lowest and highest friction.")
    mismatch: bool = flag(
        "Also certify cars that differ from the model: lag by 0.1 s, dead time by one period, stiffness by a factor of "
        "1.6, mass by 30 %."
    )

    @property
    def domain(self) -> dict[str, Any]:
        """Ranges of speed and friction on the command line, by name."""
        ends = {"speed": self.speed, "friction": self.friction}
        return {name: interval for name, interval in ends.items() if interval is not None}

    def mismatches(self, mpc: at.MPC) -> Sequence[Mismatch]:
        """Cars that differ from the model of the MPC; none without --mismatch."""
        from adaptrack.analysis.linearisation import usual_mismatches

        return usual_mismatches(mpc.period) if self.mismatch else ()


@options.grouped
def certify(
    *,
    scheduler: str | None = argument("[SCHEDULE]", "See `list schedules`, or a .json file; default: constant tuning."),
    loop: CertifiedLoop,
    feasible: bool = flag("Instead, find the best tuning at each speed and friction."),
    out: Path | None = option("FOLDER", "Folder for the page with maps of the margins."),
    as_json: bool = json_flag(),
) -> None:
    """Compute stability and margins of the control loop.

    The loop is linearised at many speeds and frictions, by default over the ranges in the car file. The exit code is 1
    if the loop is unstable anywhere when driving straight. Unstable loops in a hard turn only cause a warning.

    With --feasible, the command instead finds the best tuning at each speed and friction. The exit code is then 1 if
    the best modulus margin is below 0.1 anywhere.
    """
    from adaptrack.analysis.certify import certify as compute_certificate
    from adaptrack.results.certificate import certificate_result

    car, plant = loop.car.load()
    schedule = None if scheduler is None else at.load_scheduler(scheduler)
    if isinstance(plant, at.SteppedPlant):
        raise InvalidInput(f"--plant {loop.car.plant}: this plant has no equations that a certificate can linearise.")
    mpc = _controller(loop.controller, car, loop.profile, schedule)
    mpc.warn_of(schedule, at.load_profile(loop.profile).name, plant)
    if feasible:
        if scheduler is not None or out is not None:
            raise InvalidInput("--feasible: leave out the schedule and --out; it tests all tunings and writes no page.")
        _print_feasible(plant, mpc, loop, as_json)
        return
    options.make_page_folder(out)
    with show.progress("certify") as advance:
        certificate = compute_certificate(
            mpc.tuning if schedule is None else schedule, plant, mpc, loop.profile, domain=loop.domain,
            mismatches=loop.mismatches(mpc), progress=advance,
        )  # fmt: skip
    result = add_command(
        certificate_result(certificate), "certify", is_unstable=not certificate.passed,
        has_one_car=not loop.mismatch, has_no_page=out is None, loop=option_words(loop), car=option_words(loop.car),
        profile=loop.profile, schedule=None if scheduler is None else ["--scheduler", scheduler],
        controller=option_words(loop, "controller"),
    )  # fmt: skip
    show.say_result(result, as_json, out)
    if not certificate.passed:
        point = max(certificate.worst_points(len(certificate.points)), key=lambda point: point["radius"] or math.inf)
        tuning = ", ".join(f"{name} = {point[name]:g}" for name in ("Np", "Nc", "Q", "R"))
        show.say_failed(
            f"{certificate.verdict} Worst: {point['speed']:g} m/s on friction {point['friction']:g}, with {tuning}: "
            f"spectral radius {point['radius'] or math.inf:.4f}.",
            aside=True,
        )
        raise typer.Exit(UNSTABLE)


def _controller(name: str | None, car: at.Vehicle, profile: str, schedule: at.Schedule | None) -> at.MPC:
    """Make the MPC of this name with horizons that are long enough for the schedule."""
    from adaptrack.control.controllers.compatibility import is_for_published

    if name is None:
        name = STANDARD_NAME if schedule is not None and is_for_published(schedule.made_for) else INFORMED_NAME
    longest, most = (60, 20) if schedule is None else schedule.largest
    sizes: dict[str, Any] = {"longest_horizon": max(60, longest), "most_moves": max(20, most)}
    if name == INFORMED_NAME:
        return at.MPC(car, profile=profile, **sizes)
    if name != STANDARD_NAME:
        raise UnknownName(
            f"no controller to certify is named {name!r}. {did_you_mean(name, [INFORMED_NAME, STANDARD_NAME])}"
        )
    return at.published_mpc(car, period=at.load_profile(profile).period, **sizes)


def _print_feasible(plant: Any, mpc: at.MPC, loop: CertifiedLoop, as_json: bool) -> None:
    """Print the best tuning at each speed and friction; exit code 1 if no tuning is good enough somewhere."""
    from adaptrack.analysis.feasibility import feasibility

    with show.progress("feasible") as advance:
        result = feasibility(
            plant, mpc, loop.profile, mismatches=loop.mismatches(mpc), progress=advance, **loop.domain
        )  # fmt: skip
    if as_json:
        show.say_json(result.summary())
    else:
        from adaptrack.results.certificate import CERTIFICATE_COLUMNS, with_ratio

        names = ("speed", "friction", "Np", "Nc", "ratio", "modulus_margin")
        columns = [Column("held", "Stable"), *(column for column in CERTIFICATE_COLUMNS if column.name in names)]
        title = "Tuning with the largest modulus margin at each speed and friction"
        show.table(title, columns, with_ratio(result.summary()["rows"]))
        if mpc.belief is not None:
            show.say(f"Steering model of the controller: {mpc.belief_at_first}.")
    if result.passed and not as_json:
        show.say(result.verdict)
    if not result.passed:
        show.say_failed(result.verdict, aside=True)
        raise typer.Exit(UNSTABLE)

"""`adaptrack certify`: is the loop stable with everything that a scheduler can ask for?"""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Option

from adaptrack.cli import options, show
from adaptrack.cli.show import Column
from adaptrack.errors import InvalidInput

if TYPE_CHECKING:
    from adaptrack.certify import Certificate

UNSTABLE = 1
"""The exit code when a loop is unstable, driving straight."""

COLUMNS = (
    Column("driving", "driving"),
    Column("guard", "guard"),
    Column("speed", "speed", "m/s", show.digits(3)),
    Column("friction", "friction", "", show.digits(3)),
    Column("Np", "Np", "", show.digits(3)),
    Column("Nc", "Nc", "", show.digits(3)),
    Column("ratio", "R/Q", "m²/rad²", show.digits(3)),
    Column("radius", "spectral\nradius"),
    Column("delay", "delay", "s", show.digits(3)),
    Column("modulus_margin", "modulus\nmargin", "", show.digits(3)),
)

TITLES = {"straight": "driving straight (the verdict)", "turn": "in a hard turn (no verdict)"}
"""By way of driving."""


def certify(
    scheduler: Annotated[str, typer.Argument(help="Name (see `schedulers`) or .json file (see `train`).")],
    profile: options.Profile = "road",
    vehicle: options.Vehicle = "paper",
    plant: options.Plant = "dual-track",
    tyre: options.Tyre = None,
    plugin: options.Plugin = None,
    out: Annotated[Path | None, Option(help="Folder for the page with the maps.")] = None,
    as_json: options.Json = False,
) -> None:
    """Map spectral radius, gain and delay margins over the operating domain.

    The verdict is on driving straight: exit code 1 when a point is unstable there. Points that are unstable in a hard
    turn are counted beside it, as a warning.
    """
    from adaptrack.certify import certify as look
    from adaptrack.controllers import published_mpc
    from adaptrack.plant import SteppedPlant
    from adaptrack.profile import load_profile
    from adaptrack.scheduling import load_scheduler

    options.load_plugins(plugin)
    schedule = load_scheduler(scheduler)
    car, body = options.car_and_plant(vehicle, plant, tyre)
    if isinstance(body, SteppedPlant):
        raise InvalidInput(
            f"--plant {plant}: is stepped in Python; a certificate needs equations that it can linearise."
        )
    longest, most = schedule.largest
    mpc = published_mpc(
        car, period=load_profile(profile).period, longest_horizon=max(60, longest), most_moves=max(20, most)
    )
    if out is not None:
        options.make_folder(out)
    with show.progress("certify") as advance:
        found = look(schedule, body, mpc, profile, progress=advance)
    if out is not None:
        show.say(f"Report: {_write_page(out, found)}", aside=as_json)
    if as_json:
        show.say_json({**found.summary(), "rows": found.rows()})
    else:
        _print(found)
    _tell_verdict(found, as_json)
    if not found.passed:
        raise typer.Exit(UNSTABLE)


def _write_page(out: Path, found: Certificate) -> Path:
    from adaptrack.report.certificate import write_certificate

    with show.progress("write the page"):
        return write_certificate(out, found, command=options.command_line())


def _print(found: Certificate) -> None:
    """The points with the smallest modulus margin, for each way of driving, with the guard and without."""
    from adaptrack.certify import DRIVING

    sweeps = [(found.guarded is not None, found.counted)]
    if found.guarded is not None:
        sweeps.append((False, found.bare))
    for driving in DRIVING:
        points = [
            {"guard": guard, **point} for guard, sweep in sweeps for point in found.worst_points(5, sweep, driving)
        ]
        rows = [{**point, "ratio": point["R"] / point["Q"] if point["Q"] else None} for point in points]
        show.table(f"{found.scheduler}, {TITLES[driving]}: the points nearest to instability", COLUMNS, rows)


def _tell_verdict(found: Certificate, as_json: bool) -> None:
    """The sentence that stands on the page and in the JSON; with the worst point when it failed."""
    if found.passed:
        if not as_json:
            show.say(found.verdict)
        return
    at = max(found.worst_points(len(found.points)), key=lambda point: point["radius"] or math.inf)
    show.say_failed(
        f"{found.verdict} The worst: {at['speed']:g} m/s on friction {at['friction']:g}, with Np = {at['Np']:g}, "
        f"Nc = {at['Nc']:g}, Q = {at['Q']:g}, R = {at['R']:g}: spectral radius {at['radius'] or math.inf:.4f}.",
        aside=True,
    )

"""`adaptrack identify`: identify a car from logs of driving and write a car file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Option

from adaptrack.base.errors import InvalidInput
from adaptrack.cli import options, show
from adaptrack.cli.columns import ColumnOptions
from adaptrack.cli.next_step import command, option_words, repeat_command_with, say_next

if TYPE_CHECKING:
    from adaptrack.identification import Reading

NOT_CONSISTENT = 3
"""Exit code if estimates contradict each other or the initial car."""


@dataclass(frozen=True, kw_only=True)
class IdentifyOptions:
    """Options of `adaptrack identify`."""

    logs: Annotated[
        list[Path],
        typer.Argument(
            metavar="LOG", help="Log (.csv, .parquet, or from `drive --out`); several logs must be of the same car."
        ),
    ]
    car: Annotated[
        str | None,
        Option("--car", metavar="CAR", help="Initial car: see `list cars`, or a .toml file."),
    ] = None
    mass: Annotated[
        float | None, Option("--mass", metavar="KG", help="Mass (kg); with --wheelbase instead of --car.")
    ] = None
    wheelbase: Annotated[
        float | None, Option("--wheelbase", metavar="M", help="Wheelbase (m); with --mass instead of --car.")
    ] = None
    log_columns: ColumnOptions
    computation: Annotated[
        float | None,
        Option(
            "--computation",
            metavar="S",
            hidden=True,
            help="Computation time of the logged controller (s), part of the dead time.",
        ),
    ] = None
    out: Annotated[
        Path | None,
        Option("--out", metavar="FILE", help="Car file to write (.toml); its tyre file is written to the same folder."),
    ] = None
    anyway: Annotated[
        bool, Option("--anyway", help="Write --out and exit with code 0 even if the estimates are inconsistent.")
    ] = False
    longitudinal: Annotated[bool, Option("--longitudinal", help="Identify drive, brakes and pedal map only.")] = False
    page: Annotated[Path | None, Option("--page", metavar="FILE", help="Page to write (.html).")] = None
    as_json: options.Json = False


@options.grouped
def identify(arguments: IdentifyOptions) -> None:
    """Identify a car from logs of driving.

    The command estimates steering delay, tyre stiffness, offsets and noise, each with a 90 % interval. A log needs
    time, speed, yaw rate, and steering command or wheel angle, at 10 Hz or more. With acceleration_command (m/s^2),
    force_command (N), or throttle and brake (0 to 1) it also gives drive and brakes.

    The exit code is 3 if estimates of logs, or of parts of a log, contradict each other or the initial car.
    """
    from adaptrack.identification import identify as fit
    from adaptrack.identification.consistency import implausible_estimates
    from adaptrack.results.identify import identification_result, write_identification_page

    out, page, as_json = arguments.out, arguments.page, arguments.as_json
    if out is not None and out.suffix != ".toml":
        raise InvalidInput(f"--out {out}: a car file ends in .toml.")
    if page is not None and page.suffix != ".html":
        raise InvalidInput(f"--page {page}: a page ends in .html.")
    reading = arguments.log_columns.reading
    options.make_place(out)
    if arguments.longitudinal:
        _identify_drive(arguments, reading)
        return
    options.make_place(page)
    with show.progress("identify") as advance:
        identified = fit(
            list(arguments.logs), arguments.car, mass=arguments.mass, wheelbase=arguments.wheelbase, reading=reading,
            computation=arguments.computation, progress=advance,
        )  # fmt: skip
    show.say_result(identification_result(identified), as_json)
    for reason in identified.reasons:
        show.say_failed(f"not consistent: {reason}.", aside=as_json)
    refused = not (identified.consistent or arguments.anyway)
    is_implausible = refused and any(
        implausible_estimates(fit.estimates, fit.believed) for fit in (identified, *identified.alone)
    )
    if out is not None and not refused:
        with show.replacing(out, out.with_name(f"{out.stem}-tyre.toml"), aside=as_json):
            identified.to_toml(out, anyway=arguments.anyway)
        show.say(f"Car: {out}", aside=as_json)
    elif out is not None:
        remedy = "an estimate is implausible" if is_implausible else "use --anyway to write it"
        show.say(f"{out} was not written; {remedy}.", aside=as_json)
    if page is not None:
        show.say(f"Page: {write_identification_page(identified, page, options.command_line())}", aside=as_json)
    if not as_json:
        say_next(*_next_step(arguments, identified.findings, refused, is_implausible))
    if refused:
        raise typer.Exit(NOT_CONSISTENT)


def _identify_drive(arguments: IdentifyOptions, reading: Reading) -> None:
    """Identify drive, brakes and resistance only."""
    from adaptrack.identification import identify_drive
    from adaptrack.results.identify import drive_identification_result

    out = arguments.out
    if arguments.car is None or arguments.page is not None:
        raise InvalidInput("--longitudinal: needs --car, whose mass turns force into acceleration, and has no page.")
    identified = identify_drive(list(arguments.logs), arguments.car, reading=reading)
    show.say_result(drive_identification_result(identified), arguments.as_json)
    if out is not None:
        with show.replacing(out, aside=arguments.as_json):
            identified.to_toml(out)
        show.say(f"Car: {out}", aside=arguments.as_json)
    if not arguments.as_json and out is None:
        say_next("to keep the car", repeat_command_with("--out", "my-car.toml"))
    elif not arguments.as_json:
        say_next("to drive it", command("drive", "country", "--vehicle", out, "--speed-control"))


def _next_step(
    arguments: IdentifyOptions, findings: Sequence[str], refused: bool, is_implausible: bool
) -> tuple[str, str]:
    """Suggest the next command for an identified car.

    findings: what limits it; refused: not consistent; is_implausible: an estimate that no such car has.
    """
    if (findings or refused) and arguments.page is None:
        return "to see the contradictions on a page", repeat_command_with("--page", "identified.html")
    if is_implausible:
        car = () if arguments.car is None else ("--vehicle", arguments.car)
        words = (arguments.logs[0], *car, *option_words(arguments.log_columns))
        return "to find signals that contradict each other", command("check-loop", *words)
    if refused:
        return "to write the car anyway", repeat_command_with(
            *([] if arguments.out else ["--out", "my-car.toml"]), "--anyway"
        )
    if arguments.out is None:
        return "to keep the car", repeat_command_with("--out", "my-car.toml")
    return "to drive it", command("drive", "country", "--vehicle", arguments.out)

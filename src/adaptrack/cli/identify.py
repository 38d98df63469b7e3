"""`adaptrack identify`: from logs of driving to a car file, with what is known of each number."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer
from typer import Option

from adaptrack.base.errors import InvalidInput
from adaptrack.cli import options, show
from adaptrack.cli.columns import ColumnOptions
from adaptrack.cli.next_step import command, repeat_command_with, say_next

NOT_CONSISTENT = 3
"""The exit code of an identification that contradicts itself or what was believed."""


@dataclass(frozen=True, kw_only=True)
class IdentifyOptions:
    """Options of `adaptrack identify`."""

    logs: Annotated[
        list[Path],
        typer.Argument(metavar="LOG", help="Log of the car (.csv, .parquet, from `drive --out`); several allowed."),
    ]
    car: Annotated[
        str | None,
        Option("--car", metavar="CAR", help="Initial car: see `list cars`, or a .toml file."),
    ] = None
    mass: Annotated[float | None, Option("--mass", metavar="KG", help="Mass, instead of --car.")] = None
    wheelbase: Annotated[float | None, Option("--wheelbase", metavar="M", help="Wheelbase, instead of --car.")] = None
    log_columns: ColumnOptions
    computation: Annotated[
        float | None,
        Option("--computation", metavar="S", hidden=True, help="Part of the dead time that the controller causes."),
    ] = None
    out: Annotated[
        Path | None,
        Option("--out", metavar="FILE", help="Car file to write (.toml); its tyre goes into the same folder."),
    ] = None
    anyway: Annotated[
        bool, Option("--anyway", help="Write --out and exit with 0 even if the logs are inconsistent.")
    ] = False
    page: Annotated[Path | None, Option("--page", metavar="FILE", help="Page to write (.html).")] = None
    as_json: options.Json = False


@options.grouped
def identify(arguments: IdentifyOptions) -> None:
    """Identify a car from a log of driving.

    Steering delay, tyre stiffness, offsets, noise. The log needs time, speed, yaw rate and a steering command (or a
    measured wheel angle), 10 Hz and up. Each number comes with its interval. Several logs are of one car. Where logs,
    stretches of one, or a log and what was believed contradict each other, the exit code is 3.
    """
    from adaptrack.identification import identify as fit
    from adaptrack.results.identify import identification_result, write_identification_page

    out, page, as_json = arguments.out, arguments.page, arguments.as_json
    if out is not None and out.suffix != ".toml":
        raise InvalidInput(f"--out {out}: a car file ends in .toml.")
    if page is not None and page.suffix != ".html":
        raise InvalidInput(f"--page {page}: a page ends in .html.")
    reading = arguments.log_columns.reading
    options.make_place(out)
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
    if out is not None and not refused:
        identified.to_toml(out, anyway=arguments.anyway)
        show.say(f"Car: {out}", aside=as_json)
    elif out is not None:
        show.say(f"{out} is not written: --anyway writes it all the same.", aside=as_json)
    if page is not None:
        show.say(f"Page: {write_identification_page(identified, page, options.command_line())}", aside=as_json)
    if not as_json:
        say_next(*_next_step(arguments, identified.findings, refused))
    if refused:
        raise typer.Exit(NOT_CONSISTENT)


def _next_step(arguments: IdentifyOptions, findings: Sequence[str], refused: bool) -> tuple[str, str]:
    """Suggest the next command for an identified car; findings: what limits it; refused: not consistent."""
    if (findings or refused) and arguments.page is None:
        return "to look at what does not fit", repeat_command_with("--page", "identified.html")
    if refused:
        return "to keep the car all the same", repeat_command_with(
            *([] if arguments.out else ["--out", "my-car.toml"]), "--anyway"
        )
    if arguments.out is None:
        return "to keep the car", repeat_command_with("--out", "my-car.toml")
    return "to drive it", command("drive", "country", "--vehicle", arguments.out)

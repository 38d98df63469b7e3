"""`adaptrack shadow`: run estimator and learning on logs of a driver, without steering."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Option

from adaptrack.cli import options, show
from adaptrack.cli.columns import ColumnOptions, parts
from adaptrack.cli.next_step import command, next_line, option_words, repeat_command_with
from adaptrack.cli.options import EXIT_FAILED

if TYPE_CHECKING:
    from adaptrack.identification.shadow import Shadow


@dataclass(frozen=True, kw_only=True)
class ShadowOptions:
    """Options of `adaptrack shadow`."""

    log: Annotated[
        list[Path], typer.Argument(metavar="LOG...", help="Logs of one car, the oldest first (.csv, .parquet).")
    ]
    vehicle: options.VehicleOption
    path: Annotated[
        str | None,
        Option(
            "--path", metavar="ROAD", help="Road that the controller follows; default: smoothed x and y of the log."
        ),
    ] = None
    log_columns: ColumnOptions
    without: Annotated[
        list[str] | None,
        Option("--without", metavar="SIGNAL,...", help="Signals to ignore: vy, acceleration, wheel, x, y, yaw."),
    ] = None
    profile: options.ProfileOption = "road"
    computation: Annotated[
        float | None,
        Option("--computation", metavar="S", hidden=True, help="Part of the dead time that the controller causes."),
    ] = None
    out: options.Page = None
    as_json: options.Json = False


@options.grouped
def shadow(arguments: ShadowOptions) -> None:
    """Test the learning controller on logs of a human driver.

    The controller does not steer; it only learns the car from the log. The report has the learned values, the errors of
    predicted yaw rate and position, and the warnings of the controller. The exit code is 3 if the learned values are
    implausible because measurements contradict them.
    """
    from adaptrack.identification.shadow import shadow as run
    from adaptrack.results.page import write_result
    from adaptrack.results.shadow import shadow_result

    options.make_page_folder(arguments.out)
    with show.progress("shadow", len(arguments.log)) as advance:
        report = run(
            arguments.log, arguments.vehicle, path=arguments.path, reading=arguments.log_columns.reading,
            without=parts(arguments.without), profile=arguments.profile, computation=arguments.computation,
            progress=advance,
        )  # fmt: skip
    result = shadow_result(report, options.command_line(), next_line(*_next_step(arguments, report)))
    page = None if arguments.out is None else write_result(arguments.out, result)
    show.say_result(result, arguments.as_json, page)
    if not report.believable:
        raise typer.Exit(EXIT_FAILED)


def _next_step(arguments: ShadowOptions, report: Shadow) -> tuple[str, str]:
    """Suggest the next command after a shadow run, with the reason."""
    if report.spoiling:
        return "to leave out the contradictory signals", repeat_command_with("--without", ",".join(report.spoiling))
    if arguments.out is None:
        return "to see the estimates over time", repeat_command_with("--out", "shadow")
    computation = () if arguments.computation is None else ("--computation", arguments.computation)
    words = (*arguments.log, "--car", arguments.vehicle, *option_words(arguments.log_columns), *computation)
    if report.believable:
        return "to keep the car", command("identify", *words, "--out", "my-car.toml")
    return "to identify the car from the log", command("identify", *words)

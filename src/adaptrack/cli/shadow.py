"""`adaptrack shadow`: estimator and learner over logs of a driver; nothing is steered."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Option

from adaptrack.cli import options, show
from adaptrack.cli.columns import ColumnOptions, parts
from adaptrack.cli.next_step import command, next_line, repeat_command_with
from adaptrack.cli.options import EXIT_FAILED

if TYPE_CHECKING:
    from adaptrack.identification.shadow import Shadow


@dataclass(frozen=True, kw_only=True)
class ShadowOptions:
    """Options of `adaptrack shadow`."""

    log: Annotated[
        list[Path], typer.Argument(metavar="LOG...", help="Logs of one car in their order (.csv, .parquet).")
    ]
    vehicle: options.VehicleOption
    path: Annotated[
        str | None,
        Option("--path", metavar="ROAD", help="Road to follow; default: x and y of the log, smoothed."),
    ] = None
    log_columns: ColumnOptions
    without: Annotated[
        list[str] | None,
        Option("--without", metavar="SIGNAL,...", help="Signals to leave out: vy, acceleration, wheel, x, y, yaw."),
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
    """Run the estimator over logs of a driver, without steering.

    What the learning controller would believe of the car, how well it predicts yaw rate and position, what it would
    have warned of. Exit code 3 when the belief is not believable.
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
        return "to leave out what does not fit", repeat_command_with("--without", ",".join(report.spoiling))
    if arguments.out is None:
        return "to see it over time", repeat_command_with("--out", "shadow")
    if report.believable:
        return "to keep the car", command(
            "identify", arguments.log[0], "--car", arguments.vehicle, "--out", "my-car.toml"
        )
    return "to see what the log tells of the car", command("identify", arguments.log[0], "--car", arguments.vehicle)

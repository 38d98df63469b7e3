"""`adaptrack shadow`: estimator and learner over logs of a driver; nothing is steered."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Option

from adaptrack.cli import options, show
from adaptrack.cli.columns import ColumnOptions, parts
from adaptrack.cli.next_step import again, command, next_line
from adaptrack.cli.options import FAILED

if TYPE_CHECKING:
    from adaptrack.identification.shadow import Shadow


@dataclass(frozen=True, kw_only=True)
class ShadowOptions:
    """Options of `adaptrack shadow`."""

    log: Annotated[list[Path], typer.Argument(metavar="LOG...", help="Of one car, in their order: .csv or .parquet.")]
    vehicle: options.Vehicle
    path: Annotated[
        str | None,
        Option("--path", metavar="ROAD", help="That was to be followed; by default x and y of the log, smoothed."),
    ] = None
    log_columns: ColumnOptions
    without: Annotated[
        list[str] | None,
        Option("--without", metavar="SIGNAL,...", help="Not used: vy, acceleration, wheel, x, y, yaw."),
    ] = None
    profile: options.Profile = "road"
    computation: Annotated[
        float | None,
        Option("--computation", metavar="S", hidden=True, help="Of the dead time in the log, the controller's own."),
    ] = None
    out: options.Page = None
    as_json: options.Json = False


@options.grouped
def shadow(given: ShadowOptions) -> None:
    """Run over logs of a driver and steer nothing.

    What the learning controller would believe of the car, how well it predicts yaw rate and position, what it would
    have warned of. Exit code 3 when the belief is not believable.
    """
    from adaptrack.identification.shadow import shadow as run
    from adaptrack.results.page import write_result
    from adaptrack.results.shadow import shadow_result

    options.make_page_folder(given.out)
    with show.progress("shadow", len(given.log)) as advance:
        found = run(
            given.log, given.vehicle, path=given.path, reading=given.log_columns.reading,
            without=parts(given.without), profile=given.profile, computation=given.computation, progress=advance,
        )  # fmt: skip
    result = shadow_result(found, options.command_line(), next_line(*_next_step(given, found)))
    page = None if given.out is None else write_result(given.out, result)
    show.say_result(result, given.as_json, page)
    if not found.believable:
        raise typer.Exit(FAILED)


def _next_step(given: ShadowOptions, found: Shadow) -> tuple[str, str]:
    """What to do with what was found, and the command."""
    if found.spoiling:
        return "to leave out what does not fit", again("--without", ",".join(found.spoiling))
    if given.out is None:
        return "to see it over time", again("--out", "shadow")
    if found.believable:
        return "to keep the car", command("identify", given.log[0], "--car", given.vehicle, "--out", "my-car.toml")
    return "to see what the log tells of the car", command("identify", given.log[0], "--car", given.vehicle)

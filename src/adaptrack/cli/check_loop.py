"""`adaptrack check-loop`: which inputs of a loop contradict each other, from its log."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer
from typer import Option

from adaptrack.cli import options, show
from adaptrack.cli.columns import ColumnOptions
from adaptrack.cli.next_step import command, say_next

CONTRADICTED = 3
"""The exit code when inputs contradict each other."""


@dataclass(frozen=True, kw_only=True)
class CheckLoopOptions:
    """Options of `adaptrack check-loop`."""

    log: Annotated[Path, typer.Argument(metavar="LOG", help="Of Tracker(record=...), or any that `identify` reads.")]
    vehicle: Annotated[
        str | None, Option("--vehicle", metavar="CAR", help="Name (see `list cars`) or .toml file, for sizes.")
    ] = None
    log_columns: ColumnOptions
    as_json: options.Json = False


@options.grouped
def check_loop(given: CheckLoopOptions) -> None:
    """Say which inputs of a loop contradict each other.

    Sign, unit, frame and clock of time, position, yaw, speed, yaw rate, lateral velocity and acceleration, wheel angle
    and command. Exit code 3 where some do.
    """
    from adaptrack.cars.vehicle import load_vehicle
    from adaptrack.identification.loop_check import check_loop as check
    from adaptrack.identification.reading import read_columns
    from adaptrack.results.check_loop import check_result

    read = read_columns(given.log, given.log_columns.reading)
    found = check(read, None if given.vehicle is None else load_vehicle(given.vehicle))
    show.say_result(check_result(found, str(given.log), read.notes), given.as_json)
    if found.contradictions:
        raise typer.Exit(CONTRADICTED)
    if not given.as_json:
        say_next("to identify the car", command("identify", given.log, "--car", given.vehicle or "CAR"))

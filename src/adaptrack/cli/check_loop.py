"""`adaptrack check-loop`: find inputs of a control loop that contradict each other, from its log."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer
from typer import Option

from adaptrack.cli import options, show
from adaptrack.cli.columns import ColumnOptions
from adaptrack.cli.next_step import command, option_words, say_next

EXIT_CONTRADICTED = 3
"""Exit code if inputs contradict each other."""


@dataclass(frozen=True, kw_only=True)
class CheckLoopOptions:
    """Options of `adaptrack check-loop`."""

    log: Annotated[
        Path,
        typer.Argument(
            metavar="LOG", help="Log of the loop (.csv, .parquet), or a file of adaptrack.Tracker(record=...)."
        ),
    ]
    vehicle: Annotated[
        str | None,
        Option("--vehicle", metavar="CAR", help="Car, for its dimensions: see `list cars`, or a .toml file."),
    ] = None
    log_columns: ColumnOptions
    as_json: options.Json = False


@options.grouped
def check_loop(arguments: CheckLoopOptions) -> None:
    """Find contradictory inputs of a control loop in its log.

    The check finds wrong signs, units, reference frames and time stamps. It compares position, yaw, speed, yaw rate,
    lateral velocity, lateral acceleration, wheel angle and steering command with each other. It compares the change of
    speed with longitudinal acceleration and with commands of acceleration or force, and reports whether this
    acceleration possibly contains gravity. The exit code is 3 if signals contradict each other, and 2 if no signals
    could be compared.
    """
    from adaptrack.base.errors import InvalidInput
    from adaptrack.cars.vehicle import load_vehicle
    from adaptrack.identification.loop_check import check_loop as check_log
    from adaptrack.identification.reading import read_columns
    from adaptrack.results.check_loop import check_result

    columns = read_columns(arguments.log, arguments.log_columns.reading)
    check = check_log(columns, None if arguments.vehicle is None else load_vehicle(arguments.vehicle))
    if not check.contradictions and not check.compared:
        reason = check.limit or "no two signals are related."
        raise InvalidInput(
            f"log: no signals could be compared: {reason} Drive bends, and log speed with x, y and yaw, or yaw rate "
            "with the command."
        )
    show.say_result(check_result(check, str(arguments.log), columns.notes), arguments.as_json)
    if check.contradictions:
        raise typer.Exit(EXIT_CONTRADICTED)
    if not arguments.as_json and arguments.vehicle is not None:
        words = (arguments.log, "--car", arguments.vehicle, *option_words(arguments.log_columns))
        say_next("to identify the car", command("identify", *words))

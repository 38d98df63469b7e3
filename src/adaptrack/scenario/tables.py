"""Reader of scenarios in CSV tables."""

from __future__ import annotations

import csv
import math
import os

import numpy as np

from adaptrack.base.errors import ConfigError, InvalidInput, did_you_mean
from adaptrack.base.files import is_number, read_bytes, table_lines
from adaptrack.scenario.shapes import Array
from adaptrack.scenario.signals import HIGHEST_FRICTION

FRICTION_COLUMNS = (
    ("friction",),
    ("friction_left", "friction_right"),
    ("friction_front_left", "friction_front_right", "friction_rear_left", "friction_rear_right"),
)
"""The three choices of friction columns: one for all wheels, one per side, or one per wheel."""

_ALL_COLUMNS = ("t", "y_ref", "speed", "wind_x", "wind_y", *(name for names in FRICTION_COLUMNS for name in names))
_ROAD_COLUMNS = {"x", "y", "x_m", "y_m"}


def _check_header(header: list[str]) -> None:
    """Raise InvalidInput unless the header names the columns of a scenario."""
    if "t" not in header and (_ROAD_COLUMNS & {name.lower() for name in header} or all(map(is_number, header))):
        raise InvalidInput(
            "the table holds points of a road, but a scenario needs the time t: to drive along the road, use "
            "RoadDrive(load_road(FILE), speed)."
        )
    for name in header:
        if name not in _ALL_COLUMNS:
            raise InvalidInput(f"unknown column {name!r}. {did_you_mean(name, _ALL_COLUMNS)}")
    ways = [names for names in FRICTION_COLUMNS if set(names) & set(header)]
    if len(ways) > 1:
        raise InvalidInput(f"the friction is given twice, by {ways[0][0]!r} and by {ways[1][0]!r}; keep one of them.")
    expected = ["t", "y_ref", "speed", *(ways or FRICTION_COLUMNS)[0], "wind_y"]
    missing = [name for name in expected if name not in header]
    if missing:
        raise InvalidInput(f"column {missing[0]!r} is missing; the columns must be {', '.join(expected)}.")


def read_scenario_table(path: str | os.PathLike[str]) -> dict[str, Array]:
    """Read the columns of a scenario's CSV file (see `Scenario.from_csv`) into arrays by name.

    Raises
    ------
    StorageError
        When the file cannot be read.
    ConfigError
        When the header or a number is invalid; the message names the line.
    """
    lines = _lines(path)
    (first, header), rows = lines[0], lines[1:]
    where = f"{os.fspath(path)}, line {first}"
    if len(header) == 1 and ";" in header[0]:
        raise ConfigError(f"{where}: the columns are separated by ';'; write ',' between them and '.' in numbers.")
    doubled = [name for name in header if header.count(name) > 1]
    if doubled:
        raise ConfigError(f"{where}: the column {doubled[0]!r} appears twice; remove one.")
    try:
        _check_header(header)
    except InvalidInput as error:
        raise ConfigError(f"{where}: {error}") from None
    if len(rows) < 2:
        raise ConfigError(f"{os.fspath(path)}: at least two rows of numbers are needed; there are {len(rows)}.")
    table = np.empty((len(rows), len(header)))
    for k, (line, row) in enumerate(rows):
        where = f"{os.fspath(path)}, line {line}"
        if len(row) != len(header):
            raise ConfigError(f"{where}: {len(row)} cells, but the header has {len(header)} columns.")
        table[k] = [_number(where, name, cell) for name, cell in zip(header, row, strict=True)]
    t = table[:, header.index("t")]
    is_unsorted = np.diff(t) <= 0.0
    if is_unsorted.any():
        k = int(is_unsorted.argmax())
        raise ConfigError(
            f"{os.fspath(path)}, line {rows[k + 1][0]}: t = {float(t[k + 1])!r} does not come after "
            f"t = {float(t[k])!r} in line {rows[k][0]}; sort the rows by time and remove repetitions."
        )
    return {name: table[:, j].copy() for j, name in enumerate(header)}


def _lines(path: str | os.PathLike[str]) -> list[tuple[int, list[str]]]:
    """Return the numbers and cells of the lines of a CSV file, without empty lines and comments."""
    numbered, _ = table_lines(os.fspath(path), read_bytes(path), "strict")
    try:
        lines = [(number, [cell.strip() for row in csv.reader([line]) for cell in row]) for number, line in numbered]
    except csv.Error as error:
        raise ConfigError(f"{os.fspath(path)}: not a CSV file: {error}.") from error
    lines = [(number, row) for number, row in lines if any(row)]
    if not lines:
        raise ConfigError(f"{os.fspath(path)}: empty; its first line must name the columns.")
    return lines


def _number(where: str, name: str, cell: str) -> float:
    """Return the number in a cell of the column `name`, or raise ConfigError if the column cannot hold it."""
    try:
        number = float(cell)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise ConfigError(f"{where}: {name} = {cell!r} is not a finite number; correct it or remove the row.")
    if name == "speed" and number < 0.0:
        raise ConfigError(f"{where}: speed = {cell!r} must be >= 0 m/s.")
    if name.startswith("friction") and not 0.0 < number <= HIGHEST_FRICTION:
        raise ConfigError(f"{where}: {name} = {cell!r} must be a coefficient such as 0.8, > 0 and at most 3.")
    return number

"""Roads from CSV files: x, y and what lies along, with or without a header."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from adaptrack.base.errors import ConfigError, InvalidInput, did_you_mean
from adaptrack.base.files import is_number, printable, read_bytes
from adaptrack.core.path import FEWEST
from adaptrack.road.fit import fit_road
from adaptrack.road.road import Road
from adaptrack.road.segments import Array

COLUMNS = {
    "x": ("x", "x_m", "pos_x", "x_ref_m"),
    "y": ("y", "y_m", "pos_y", "y_ref_m"),
    "width_right": ("width_right", "w_tr_right_m", "width_right_m"),
    "width_left": ("width_left", "w_tr_left_m", "width_left_m"),
    "speed_limit": ("speed_limit", "speed_limit_mps"),
    "friction": ("friction", "mu"),
    "bank": ("bank", "bank_rad", "banking_rad"),
}
"""What a column may be called. Columns of other names are left out, and said."""

DEGREES = ("lat", "lon", "latitude", "longitude", "lng")
_WITHOUT_HEADER = {2: ("x", "y"), 4: ("x", "y", "width_right", "width_left")}


class PointsFile(NamedTuple):
    """The numbers of a file."""

    points: Array
    """(n, 2) m"""
    along: dict[str, Array]
    """(n,) each, by the names of `Road.from_segments`"""
    lines: tuple[int, ...]
    """(n,) the line of the file that holds each point"""
    notes: tuple[str, ...]


def road_from_csv(path: str | os.PathLike[str], **options: Any) -> Road:
    """A road through or near the points of a CSV file, see `read_points` and `fit_road`, whose options these are.

    Raises
    ------
    StorageError
        When the file cannot be read.
    ConfigError
        When it holds no road; the message names the line and the remedy.
    """
    table = read_points(path)
    try:
        road = fit_road(table.points, **({"name": Path(path).stem, **table.along} | options))
    except InvalidInput as error:
        message = re.sub(r"point (\d+)", lambda found: f"line {table.lines[int(found[1])]}", str(error))
        raise ConfigError(f"{os.fspath(path)}: {message.removeprefix('fit_road: ')}") from None
    notes = [
        re.sub(r"at point (\d+)", lambda found: f"in line {table.lines[int(found[1])]}", text) for text in road.notes
    ]
    return road.replace(notes=(*notes, *table.notes))


def read_points(path: str | os.PathLike[str]) -> PointsFile:
    """The points of a CSV file, one per line, in the order in which they are driven; x and y in m.

    Separated by ``,``, ``;``, tabs or blanks. Lines that are empty or begin with ``#`` are skipped; the last of them
    before the numbers, or the first other line, may be a header (`COLUMNS`). Without one, two columns are x, y and four
    x, y, width to the right, width to the left. Points that repeat the one before are left out.

    Raises
    ------
    StorageError
        When the file cannot be read.
    ConfigError
        When it is no such table; the message names the line and the remedy.
    """
    where = os.fspath(path)
    header, rows = _split(where, _text(path))
    if len(rows) < FEWEST:
        raise ConfigError(f"{where}: {len(rows)} lines of numbers; a road needs at least {FEWEST} points.")
    names = _names(where, header, len(rows[0][1]))
    numbers = np.empty((len(rows), len(names)))
    for k, (line, cells) in enumerate(rows):
        if len(cells) != len(names):
            raise ConfigError(f"{where}, line {line}: {len(cells)} columns, where {len(names)} are expected.")
        numbers[k] = [_number(where, line, cell, wanted=bool(name)) for cell, name in zip(cells, names, strict=True)]
    columns = {name: numbers[:, k] for k, name in enumerate(names) if name}
    points = np.stack([columns.pop("x"), columns.pop("y")], axis=-1)
    moved = np.concatenate([[True], np.any(np.diff(points, axis=0) != 0.0, axis=1)])
    return PointsFile(
        points[moved],
        {name: values[moved] for name, values in columns.items()},
        tuple(line for (line, _), kept in zip(rows, moved, strict=True) if kept),
        _notes(header, names, int((~moved).sum())),
    )


def _text(path: str | os.PathLike[str]) -> str:
    try:
        return read_bytes(path).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ConfigError(f"{os.fspath(path)}: not a CSV text in UTF-8: {error}.") from error


def _notes(header: Sequence[str], names: Sequence[str], repeated: int) -> tuple[str, ...]:
    left_out = [title for title, name in zip(header, names, strict=False) if not name]
    said = [f"columns left out: {printable(', '.join(left_out))}"] if left_out else []
    return (*said, f"{repeated} repeated points left out") if repeated else tuple(said)


def _split(where: str, text: str) -> tuple[list[str], list[tuple[int, list[str]]]]:
    """The cells of the header, empty without one, and of the lines of numbers, with the number of each line."""
    header: list[str] = []
    rows: list[tuple[int, list[str]]] = []
    for line, content in enumerate(text.splitlines(), start=1):
        content = content.strip()
        cells = _cells(content.lstrip("# \t"))
        if not content or (content.startswith("#") and (rows or _column_of(cells[0] if cells else "") is None)):
            continue
        if content.startswith("#") or (not rows and not header and not is_number(cells[0])):
            header = cells
        else:
            rows.append((line, cells))
    return header, rows


def _cells(content: str) -> list[str]:
    separator = next((mark for mark in ";,\t" if mark in content), None)
    return [cell.strip().strip('"') for cell in content.split(separator)]


def _column_of(title: str) -> str | None:
    """The quantity that a column's title names."""
    plain = re.sub(r"\s*[\[(].*", "", title).strip().lower()
    return next((name for name, titles in COLUMNS.items() if plain in titles), None)


def _names(where: str, header: Sequence[str], count: int) -> list[str]:
    """What each column holds; empty for one that is left out."""
    if not header:
        if count not in _WITHOUT_HEADER:
            raise ConfigError(
                f"{where}: {count} columns without a header; give x,y or x,y,width_right,width_left, or name them: "
                f"{', '.join(COLUMNS)}."
            )
        return list(_WITHOUT_HEADER[count])
    names = [_column_of(title) or "" for title in header]
    if {title.strip().lower() for title in header} & set(DEGREES):
        raise ConfigError(f"{where}: latitude and longitude; convert them to x (east) and y (north) in m first.")
    for name in ("x", "y"):
        if names.count(name) != 1:
            hint = "there are two of them" if names.count(name) else did_you_mean(name, header)
            raise ConfigError(f"{where}: one column must be {name!r} or {name + '_m'!r}: {hint}")
    doubled = [name for name in names if name and names.count(name) > 1]
    if doubled:
        raise ConfigError(f"{where}: two columns say {doubled[0]!r}; remove one.")
    return names


def _number(where: str, line: int, cell: str, wanted: bool) -> float:
    if not wanted:
        return 0.0
    if not is_number(cell) or not math.isfinite(float(cell)):
        raise ConfigError(
            f"{where}, line {line}: {printable(cell)!r} is not a finite number; correct or remove the line."
        )
    return float(cell)

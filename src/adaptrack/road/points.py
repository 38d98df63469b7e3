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
from adaptrack.base.limits import MAX_SPEED
from adaptrack.core.path import MIN_PATH_POINTS
from adaptrack.road.fit import fit_road
from adaptrack.road.road import Road
from adaptrack.road.segments import Array

POINT_COLUMNS = {
    "x": ("x", "x_m", "pos_x", "x_ref_m"),
    "y": ("y", "y_m", "pos_y", "y_ref_m"),
    "width_right": ("width_right", "w_tr_right_m", "width_right_m"),
    "width_left": ("width_left", "w_tr_left_m", "width_left_m"),
    "speed_limit": ("speed_limit", "speed_limit_mps"),
    "friction": ("friction", "mu"),
    "bank": ("bank", "bank_rad", "banking_rad"),
    "grade": ("grade",),
    "height": ("z", "z_m", "elevation", "elevation_m"),
}
"""What a column may be called. Columns of other names are left out, and said."""
COLUMN_UNITS = {
    "x": ("m",),
    "y": ("m",),
    "width_right": ("m",),
    "width_left": ("m",),
    "speed_limit": ("m/s", "mps"),
    "friction": ("-", "1"),
    "bank": ("rad",),
    "grade": ("m/m", "-", "1"),
    "height": ("m",),
}
"""Units that may stand in brackets behind the name of a column."""
NAME = r"[A-Za-z_\u00c0-\uffff][^\s:=]*(?: [^\s:=]+){0,2}"
"""A name in a commented header: one to three words; a pattern of Python and of JavaScript."""
FOREIGN_SPEED = r"km|kph|mph|mile|knot|fps"
"""Parts of the name of a speed column that is not in m/s."""

FOREIGN_GRADE = r"^(grade|gradient|slope|incline).*(%|percent|per_cent|pct|deg)"
"""Names of a column of grades that are not dz/ds."""

DEGREE_COLUMNS = ("lat", "lon", "latitude", "longitude", "lng")
WITHOUT_HEADER = {2: ("x", "y"), 4: ("x", "y", "width_right", "width_left")}
"""The columns of a file without a header, by their number."""


class _Header(NamedTuple):
    """The names of the columns."""

    where: str
    """file and line"""
    titles: list[str]
    """empty in a file without a header"""
    commented: bool = False


class PointsFile(NamedTuple):
    """The numbers of a file."""

    points: Array
    """(n, 2) m"""
    along: dict[str, Array]
    """(n,) each, by the names of `Road.from_segments`; `height` (m)"""
    lines: tuple[int, ...]
    """(n,) the line of the file that holds each point"""
    notes: tuple[str, ...]


def road_from_csv(path: str | os.PathLike[str], *, speed_column: str | None = None, **options: Any) -> Road:
    """A road through or near the points of a CSV file; for its options see `read_points` and `fit_road`.

    Raises
    ------
    StorageError
        When the file cannot be read.
    ConfigError
        When it holds no road; the message names the line and the remedy.
    """
    table = read_points(path, speed_column)
    try:
        road = fit_road(table.points, **({"name": Path(path).stem, **table.along} | options))
    except InvalidInput as error:
        message = re.sub(r"point (\d+)", lambda match: f"line {table.lines[int(match[1])]}", str(error))
        raise ConfigError(f"{os.fspath(path)}: {message.removeprefix('fit_road: ')}") from None
    notes = [
        re.sub(r"at point (\d+)", lambda match: f"in line {table.lines[int(match[1])]}", text) for text in road.notes
    ]
    return road.replace(notes=(*notes, *table.notes))


def read_points(path: str | os.PathLike[str], speed_column: str | None = None) -> PointsFile:
    """The points of a CSV file, one per line, in the order in which they are driven; x and y in m.

    Cells are separated by ``;``, tabs, ``,`` or blanks; except in files with commas between cells, the decimal mark may
    be a comma. The first line may be a header (`POINT_COLUMNS`), and so may a line behind ``#`` above the numbers whose
    cells are names; of several the last that names x and y. A header without x and y is refused. Without a header, two
    columns are x, y and four x, y, width to the right, width to the left. Repeated points are left out. A column
    `grade` (dz/ds) is used before the slope of the heights `z` (m).

    Parameters
    ----------
    speed_column : str, optional
        Name of the column that becomes the speed limit (m/s), such as the speed of a race line.

    Raises
    ------
    StorageError
        When the file cannot be read.
    ConfigError
        When it is no such table; the message names the line and the remedy.
    """
    where = os.fspath(path)
    header, rows = _split(where, _text(path))
    if len(rows) < MIN_PATH_POINTS:
        raise ConfigError(f"{where}: {len(rows)} lines of numbers; a road needs at least {MIN_PATH_POINTS} points.")
    names = _names(header, len(rows[0][1]), speed_column)
    numbers = np.empty((len(rows), len(names)))
    for k, (line, cells) in enumerate(rows):
        if len(cells) != len(names):
            raise ConfigError(f"{where}, line {line}: {len(cells)} columns, where {len(names)} are expected.")
        numbers[k] = [
            _number(where, line, cell, is_required=bool(name)) for cell, name in zip(cells, names, strict=True)
        ]
    columns = {name: numbers[:, k] for k, name in enumerate(names) if name}
    if speed_column is not None:
        _check_speeds(where, speed_column, columns["speed_limit"], [line for line, _ in rows])
    points = np.stack([columns.pop("x"), columns.pop("y")], axis=-1)
    moved = np.concatenate([[True], np.any(np.diff(points, axis=0) != 0.0, axis=1)])
    return PointsFile(
        points[moved],
        {name: values[moved] for name, values in columns.items()},
        tuple(line for (line, _), is_kept in zip(rows, moved, strict=True) if is_kept),
        _notes(header.titles, names, int((~moved).sum())),
    )


def _text(path: str | os.PathLike[str]) -> str:
    try:
        return read_bytes(path).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ConfigError(f"{os.fspath(path)}: not a CSV text in UTF-8: {error}.") from error


def _notes(titles: Sequence[str], names: Sequence[str], repeated: int) -> tuple[str, ...]:
    omitted = [title for title, name in zip(titles, names, strict=False) if not name]
    notes = [f"columns left out: {printable(', '.join(omitted))}"] if omitted else []
    return (*notes, f"{repeated} repeated points left out") if repeated else tuple(notes)


def _split(where: str, text: str) -> tuple[_Header, list[tuple[int, list[str]]]]:
    """The header, and the cells of the lines of numbers, with the number of each line."""
    header = None
    remarks: list[tuple[int, str]] = []
    rows: list[tuple[int, list[str]]] = []
    blanks = False
    for line, content in enumerate(map(str.strip, text.splitlines()), start=1):
        plain = content.lstrip("# \t")
        if not plain or (content.startswith("#") and rows):
            continue
        if content.startswith("#"):
            remarks.append((line, plain))
        elif rows or header or _is_number(_cells(plain)[0]):
            rows.append((line, _cells(plain)))
            blanks = _separator(plain) is None
        else:
            header = _Header(f"{where}, line {line}", _cells(plain))
    return header or _commented_header(where, remarks, len(rows[0][1]) if rows else 0, blanks), rows


def _commented_header(where: str, remarks: Sequence[tuple[int, str]], columns: int, blanks: bool) -> _Header:
    """The commented line that names the columns: the last with x and y, or else the last whose cells are names.

    blanks: whether blanks separate the numbers; a remark in words separated by blanks is then a header if there are as
    many words as columns.
    """
    complete, incomplete = [], []
    for line, plain in remarks:
        titles = _cells(plain)
        header = _Header(f"{where}, line {line}", titles, commented=True)
        fits = len(titles) == columns
        if fits and {"x", "y"} <= {_column_of(title) for title in titles}:
            complete.append(header)
        elif len(titles) > 1 and all(re.fullmatch(NAME, _plain(title)) for title in titles):
            incomplete += [header] if _separator(plain) or (fits and blanks) else []
    return next(reversed(complete or incomplete), _Header(where, []))


def _separator(content: str) -> str | None:
    """The mark between the cells of a line; None: blanks."""
    return next((mark for mark in ";\t," if mark in content), None)


def _cells(content: str) -> list[str]:
    return [cell.strip().strip('"') for cell in content.split(_separator(content))]


def _is_number(cell: str) -> bool:
    return is_number(cell.replace(",", "."))


def _plain(title: str) -> str:
    """A column's title without its unit."""
    return re.sub(r"\s*[\[(].*", "", title).strip().lower()


def _column_of(title: str) -> str | None:
    """The quantity that a column's title names."""
    return next((name for name, titles in POINT_COLUMNS.items() if _plain(title) in titles), None)


def _names(header: _Header, count: int, speed_column: str | None) -> list[str]:
    """The quantity in each column; empty for a column that is left out."""
    where, titles = header.where, header.titles
    if not titles:
        if count not in WITHOUT_HEADER or speed_column is not None:
            raise ConfigError(
                f"{where}: {count} columns without a header; give x,y or x,y,width_right,width_left, or name them: "
                f"{', '.join(POINT_COLUMNS)}."
            )
        return list(WITHOUT_HEADER[count])
    names = [_column_of(title) or "" for title in titles]
    if {_plain(title) for title in titles} & set(DEGREE_COLUMNS):
        raise ConfigError(f"{where}: latitude and longitude; convert them to x (east) and y (north) in m first.")
    if speed_column is not None:
        names = ["" if name == "speed_limit" else name for name in names]
        names[_place_of(speed_column, header)] = "speed_limit"
    for name in ("x", "y"):
        if names.count(name) != 1:
            hint = "there are two of them." if names.count(name) else did_you_mean(name, titles)
            remedy = " If this line is a remark, remove it." if header.commented else ""
            raise ConfigError(f"{where}: one column must be {name!r} or {name + '_m'!r}: {hint}{remedy}")
    doubled = [name for name in names if name and names.count(name) > 1]
    if doubled:
        raise ConfigError(f"{where}: two columns say {doubled[0]!r}; remove one.")
    if "grade" in names:  # it counts before the slope of the heights
        names = ["" if name == "height" else name for name in names]
    for title, name in zip(titles, names, strict=True):
        _check_unit(where, title, name)
    return names


def _place_of(speed_column: str, header: _Header) -> int:
    """The place of the column that the caller names."""
    name = speed_column.strip().lower()
    places = [k for k, title in enumerate(header.titles) if name in (title.lower(), _plain(title))]
    if len(places) != 1:
        hint = "there are two of them." if places else did_you_mean(speed_column, header.titles)
        raise ConfigError(f"{header.where}: no single column is {speed_column!r}: {hint}")
    if re.search(FOREIGN_SPEED, header.titles[places[0]].lower()):
        raise ConfigError(f"{header.where}: column {header.titles[places[0]]!r}: must be in m/s; convert it.")
    return places[0]


def _check_unit(where: str, title: str, name: str) -> None:
    """Refuse a column that is used and whose title states a different unit, and grades that are not dz/ds."""
    if re.search(FOREIGN_GRADE, title.lower()):
        raise ConfigError(
            f"{where}: column {printable(title)!r}: a grade must be dz/ds; divide per cent by 100 and name the column "
            "'grade'."
        )
    unit = re.search(r"[\[(]\s*([^\])]*?)\s*[\])]", title)
    if name and unit and unit[1].lower() not in ("", *COLUMN_UNITS[name]):
        raise ConfigError(f"{where}: column {printable(title)!r}: must be in {COLUMN_UNITS[name][0]}; convert it.")


def _check_speeds(where: str, column: str, speeds: Array, lines: Sequence[int]) -> None:
    """Refuse speeds that no car drives."""
    for k in np.flatnonzero(~((speeds > 0.0) & (speeds <= MAX_SPEED.most)))[:1]:
        raise ConfigError(
            f"{where}, line {lines[k]}: {column} = {speeds[k]:g}: must be > 0 and at most {MAX_SPEED.most:g} m/s; "
            "correct or remove the line."
        )


def _number(where: str, line: int, cell: str, is_required: bool) -> float:
    if not is_required:
        return 0.0
    if not _is_number(cell) or not math.isfinite(float(cell.replace(",", "."))):
        raise ConfigError(
            f"{where}, line {line}: {printable(cell)!r} is not a finite number; correct or remove the line."
        )
    return float(cell.replace(",", "."))

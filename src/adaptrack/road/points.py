"""Roads from CSV files: x, y and what lies along, with or without a header."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from adaptrack.base.errors import ConfigError, InvalidInput, did_you_mean
from adaptrack.base.files import NumberedLines, finite_number, is_number, printable, read_bytes, table_lines
from adaptrack.base.limits import MAX_SPEED
from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import Array
from adaptrack.core.roads.path import MIN_PATH_POINTS
from adaptrack.road.fit import SPARSE, fit_road
from adaptrack.road.road import Road

POINT_COLUMNS = {
    "x": ("x", "x_m", "pos_x", "x_ref_m", "wp_x", "waypoint_x", "pose_x", "position_x", "position.x", "utm_x",
          "pose.position.x", "field.pose.position.x", "field.pose.pose.position.x", "easting", "easting_m", "east"),
    "y": ("y", "y_m", "pos_y", "y_ref_m", "wp_y", "waypoint_y", "pose_y", "position_y", "position.y", "utm_y",
          "pose.position.y", "field.pose.position.y", "field.pose.pose.position.y", "northing", "northing_m", "north"),
    "width_right": ("width_right", "w_tr_right_m", "width_right_m"),
    "width_left": ("width_left", "w_tr_left_m", "width_left_m"),
    "speed_limit": ("speed_limit", "speed_limit_mps"),
    "friction": ("friction", "mu"),
    "bank": ("bank", "bank_rad", "banking_rad"),
    "grade": ("grade",),
    "height": ("z", "z_m", "elevation", "elevation_m"),
}  # fmt: skip
"""What a column may be called. Columns of other names are left out, with a note."""
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
SPEED = r"(v|vx|vel|velocity)([ _-]?(ref|mps|m/s|ms|x))*|.*speed.*"
"""Names of a column that may hold speeds."""
WIDEST_SIDE = 30.0
"""m: without a header, a column of more is no width."""
MIN_WIDE_LENGTH, MIN_WIDE_RADIUS = 2e4, 8e3
"""m: a road of points far apart that is so long has a tighter bend, if it has one, unless it is in millimetres."""

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

    Raises StorageError when the file cannot be read, and ConfigError, with line and remedy, when it holds no road.
    """
    table = read_points(path, speed_column)
    try:
        road = fit_road(table.points, **({"name": Path(path).stem, **table.along} | options))
    except InvalidInput as error:
        message = re.sub(r"point (\d+)", lambda match: f"line {table.lines[int(match[1])]}", str(error))
        raise ConfigError(f"{os.fspath(path)}: {message.removeprefix('fit_road: ')}") from None
    _check_size(os.fspath(path), road, table.points)
    notes = [
        re.sub(r"(at|behind) point (\d+)", lambda match: f"{_WORDS[match[1]]} line {table.lines[int(match[2])]}", text)
        for text in road.notes
    ]
    return road.replace(notes=(*notes, *table.notes))


_WORDS = {"at": "in", "behind": "behind"}


def _check_size(where: str, road: Road, points: Array) -> None:
    """Refuse a road that turns, but only as wide as one in millimetres that is read in metres."""
    spacing = float(np.median(portable.hypot(*np.diff(points, axis=0).T)))
    line = road.at(np.linspace(0.0, road.length, points.shape[0]))
    radius = 1.0 / max(float(np.abs(line.curvature).max()), 1e-9)
    if spacing > SPARSE and road.length > MIN_WIDE_LENGTH and MIN_WIDE_RADIUS < radius < road.length:
        raise ConfigError(
            f"{where}: the road is {1e-3 * road.length:.3g} km long, without a bend below {1e-3 * radius:.3g} km of "
            "radius: x and y are in millimetres or centimetres; convert them to metres."
        )


def read_points(path: str | os.PathLike[str], speed_column: str | None = None) -> PointsFile:
    """The points of a CSV file, one per line, in the order in which they are driven; x and y in m.

    Cells are separated by ``;``, tabs, ``,`` or blanks; except in files with commas between cells, the decimal mark may
    be a comma. The first line may be a header (`POINT_COLUMNS`), and so may a line behind ``#``, ``%`` or ``//`` above
    the numbers whose cells are names; of several the last that names x and y. A header without x and y is refused.
    Without a header, two columns are x, y and four x, y, width to the right, width to the left. Repeated points are
    left out. A column `grade` (dz/ds) is used before the slope of the heights `z` (m). Widths are distances: if all of
    a column are below 0, their signs are dropped. A speed of 0 in the first or last lines becomes half the next speed.

    speed_column: name of the column that becomes the speed limit (m/s), such as the speed of a race line. Raises
    StorageError when the file cannot be read, and ConfigError, with line and remedy, when it is no such table.
    """
    where = os.fspath(path)
    header, rows = split_header(where, *table_lines(where, read_bytes(path), "strict"))
    if len(rows) < MIN_PATH_POINTS:
        raise ConfigError(f"{where}: {len(rows)} lines of numbers; a road needs at least {MIN_PATH_POINTS} points.")
    names = _names(header, len(split_cells(rows[0][1])), speed_column)
    numbers = np.empty((len(rows), len(names)))
    for k, (line, text) in enumerate(rows):
        cells = split_cells(text)
        if len(cells) != len(names):
            raise ConfigError(f"{where}, line {line}: {len(cells)} columns, where {len(names)} are expected.")
        numbers[k] = [
            _number(where, line, cell, is_required=bool(name)) for cell, name in zip(cells, names, strict=True)
        ]
    lines = np.array([line for line, _ in rows])
    notes = _notes(header.titles, names)
    if speed_column is not None:
        extent, note = _driven_rows(numbers[:, names.index("speed_limit")])
        numbers, lines = numbers[extent], lines[extent]
        notes += [note] if note else []
    moved = np.append(True, np.any(np.diff(numbers[:, [names.index("x"), names.index("y")]], axis=0) != 0.0, axis=1))
    if not moved.all():
        notes.append(f"{(~moved).sum()} repeated points left out")
    numbers, lines = numbers[moved], lines[moved]
    columns = {name: numbers[:, k] for k, name in enumerate(names) if name}
    if speed_column is not None:
        _check_speeds(where, speed_column, columns["speed_limit"], lines)
    notes += _read_widths(where, header, columns)
    points = np.stack([columns.pop("x"), columns.pop("y")], axis=-1)
    return PointsFile(points, columns, tuple(lines.tolist()), tuple(notes))


def _driven_rows(speeds: Array) -> tuple[slice, str]:
    """The rows from the last of the standing car at the start to the first at the end; speeds 0 there are replaced."""
    moving = np.flatnonzero(speeds)
    if moving.size == 0 or (speeds[0] != 0.0 and speeds[-1] != 0.0):
        return slice(None), ""
    first, last = max(int(moving[0]) - 1, 0), min(int(moving[-1]) + 1, speeds.size - 1)
    for end, neighbour in ((first, moving[0]), (last, moving[-1])):
        speeds[end] = speeds[end] or 0.5 * speeds[neighbour]
    return slice(first, last + 1), "speed 0 at the start or the end: read as half the speed beside it"


def _read_widths(where: str, header: _Header, columns: dict[str, Array]) -> list[str]:
    """Make distances of widths that are below 0 all along, and return notes; refuse unnamed columns of no widths."""
    notes = []
    for name in [name for name in ("width_right", "width_left") if name in columns]:
        if not header.titles and not ((columns[name] > 0.0) & (columns[name] <= WIDEST_SIDE)).all():
            raise ConfigError(
                f"{where}: the last two of four columns without a header are no widths ({name} from "
                f"{columns[name].min():g} to {columns[name].max():g} m): name the columns: {', '.join(POINT_COLUMNS)}."
            )
        if (columns[name] < 0.0).all():
            columns[name] = -columns[name]
            notes.append(f"{name} is below 0 all along: read as distances")
    if not header.titles and "width_right" in columns:
        notes.append("four columns without a header: read as x, y, width to the right, width to the left")
    return notes


def _notes(titles: Sequence[str], names: Sequence[str]) -> list[str]:
    omitted = [title for title, name in zip(titles, names, strict=False) if title and not name]
    speeds = [t for t in omitted if re.fullmatch(SPEED, plain_title(t)) and not re.search(FOREIGN_SPEED, t.lower())]
    notes = [f"columns left out: {printable(', '.join(omitted))}"] if omitted else []
    if speeds and "speed_limit" not in names:
        notes.append(f"to drive at the speeds of a column: --speed-column {printable(speeds[0])}")
    return notes


def split_header(where: str, lines: NumberedLines, remarks: NumberedLines) -> tuple[_Header, NumberedLines]:
    """The header, in the first line or the remarks above it, and the lines of numbers."""
    if not lines:
        return _Header(where, []), lines
    line, text = lines[0]
    if not is_number(split_cells(text)[0].replace(",", ".")):
        return _Header(f"{where}, line {line}", split_cells(text)), lines[1:]
    above = [remark for remark in remarks if remark[0] < line]
    return _commented_header(where, above, len(split_cells(text)), _separator(text.strip()) is None), lines


def _commented_header(where: str, remarks: NumberedLines, columns: int, blanks: bool) -> _Header:
    """The commented line that names the columns: the last with x and y, or else the last whose cells are names.

    blanks: whether blanks separate the numbers; a remark in words separated by blanks is then a header if there are as
    many words as columns.
    """
    complete, incomplete = [], []
    for line, plain in remarks:
        titles = split_cells(plain)
        header = _Header(f"{where}, line {line}", titles, commented=True)
        fits = len(titles) == columns
        if fits and {"x", "y"} <= {_column_of(title) for title in titles}:
            complete.append(header)
        elif len(titles) > 1 and all(re.fullmatch(NAME, plain_title(title)) for title in titles):
            incomplete += [header] if _separator(plain) or (fits and blanks) else []
    return next(reversed(complete or incomplete), _Header(where, []))


def _separator(content: str) -> str | None:
    """The mark between the cells of a line; None: blanks."""
    return next((mark for mark in ";\t|," if mark in content), None)


def split_cells(content: str) -> list[str]:
    """The cells of a line, without blanks and quotation marks around them."""
    content = content.strip()
    return [cell.strip().strip('"') for cell in content.split(_separator(content))]


def plain_title(title: str) -> str:
    """A column's title without its unit."""
    return re.sub(r"\s*[\[(].*", "", title).strip().lower()


def bracketed_unit(title: str) -> str:
    """The unit in brackets in a column's title, in lower case; empty without one."""
    unit = re.search(r"[\[(]\s*([^\])]*?)\s*[\])]", title)
    return unit[1].lower() if unit else ""


def _column_of(title: str) -> str | None:
    """The quantity that a column's title names."""
    return next((name for name, titles in POINT_COLUMNS.items() if plain_title(title) in titles), None)


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
    if {plain_title(title) for title in titles} & set(DEGREE_COLUMNS):
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
    places = [k for k, title in enumerate(header.titles) if name in (title.lower(), plain_title(title))]
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
    if name and bracketed_unit(title) not in ("", *COLUMN_UNITS[name]):
        raise ConfigError(f"{where}: column {printable(title)!r}: must be in {COLUMN_UNITS[name][0]}; convert it.")


def _check_speeds(where: str, column: str, speeds: Array, lines: NDArray[np.int64]) -> None:
    """Refuse speeds that no car drives."""
    for k in np.flatnonzero(~((speeds > 0.0) & (speeds <= MAX_SPEED.most)))[:1]:
        raise ConfigError(
            f"{where}, line {lines[k]}: {column} = {speeds[k]:g}: must be > 0 and at most {MAX_SPEED.most:g} m/s; "
            "correct or remove the line."
        )


def _number(where: str, line: int, cell: str, is_required: bool) -> float:
    number = finite_number(cell.replace(",", ".")) if is_required else 0.0
    if number is None:
        raise ConfigError(
            f"{where}, line {line}: {printable(cell)!r} is not a finite number; correct or remove the line."
        )
    return number

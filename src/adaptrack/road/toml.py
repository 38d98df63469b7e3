"""The file of a road, in TOML: elements or points, and what lies along.

    name = "bend"
    speed_limit = 20.0                # m/s

    [friction]                        # a number, or values at arc lengths
    s = [0.0, 80.0]                   # m
    value = [0.9, 0.3]
    kind = "steps"

    [[elements]]
    kind = "line"                     # line, arc, clothoid, cubic: the fields of adaptrack.road.Line, ...
    length = 50.0

    [[elements]]
    kind = "arc"
    length = 60.0
    curvature = 0.02

A line beside elements, such as a lane, and one through points have no elements: they are written as the polynomials
of their pieces.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np
from pydantic import BeforeValidator, Field, model_validator

from adaptrack.base.errors import ConfigError, InvalidInput
from adaptrack.base.files import Record, as_tuples, build, read_toml, write_toml
from adaptrack.core.maths import portable
from adaptrack.core.roads.road import COS, HALF_LENGTH, HEADING, PIECE_COLUMNS, POLYNOMIAL_DEGREE, SIN, X, Y
from adaptrack.road.fit import MAX_DEVIATION, fit_road
from adaptrack.road.road import Road
from adaptrack.road.segments import MAX_COORDINATE, MAX_ELEMENT_LENGTH, MIN_ELEMENT_LENGTH, Segment
from adaptrack.road.station_table import ALONG_QUANTITIES, Along, alongs
from adaptrack.road.table import ACROSS_POLYNOMIAL, ALONG_POLYNOMIAL, TURN_POLYNOMIAL, Pieces, end_to_end


def _quantity(value: Any) -> Any:
    """A number as a table of one value."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        return {"s": (0.0,), "value": (value,)}
    if not isinstance(value, dict | Along):
        raise ValueError("must be a number, or a table of s (m) and value.")
    return value


AlongValue = Annotated[Along, BeforeValidator(_quantity)]
PieceCoefficients = Annotated[
    tuple[Annotated[float, Field(ge=-MAX_ELEMENT_LENGTH, le=MAX_ELEMENT_LENGTH)], ...],
    Field(
        min_length=POLYNOMIAL_DEGREE + 1,
        max_length=POLYNOMIAL_DEGREE + 1,
        description="of 1, u, u^2, ..., -1 <= u <= 1 along the piece",
    ),
]


class Piece(Record):
    """A piece of a centre line that is no element, see `adaptrack.road.table`."""

    half: float = Field(ge=MIN_ELEMENT_LENGTH, le=MAX_ELEMENT_LENGTH, description="m, half of its length")
    x: float = Field(ge=-MAX_COORDINATE, le=MAX_COORDINATE, description="m, at its middle")
    y: float = Field(ge=-MAX_COORDINATE, le=MAX_COORDINATE, description="m")
    heading: float = Field(ge=-MAX_ELEMENT_LENGTH, le=MAX_ELEMENT_LENGTH, description="rad, at its middle")
    along: PieceCoefficients
    """Coefficients along the road (m)."""
    across: PieceCoefficients
    """Coefficients across the road (m)."""
    turned: PieceCoefficients
    """rad, the heading less that at the middle"""


_COLUMNS: dict[str, Any] = {
    "half": HALF_LENGTH, "x": X, "y": Y, "heading": HEADING,
    "along": ALONG_POLYNOMIAL, "across": ACROSS_POLYNOMIAL, "turned": TURN_POLYNOMIAL,
}  # fmt: skip
"""Columns of the table of a centre line that the fields of a `Piece` hold."""


class RoadFile(Record):
    """Content of a road file."""

    name: str | None = Field(default=None, description="by default that of the file")
    closed: bool | None = Field(default=None, description="a lap; by default not, points: as found")
    deviation: float = Field(default=0.0, ge=0.0, description="m, from the points that it was fitted to")
    notes: tuple[str, ...] = Field(default=(), description="what its first reader had to say")
    max_deviation: float | None = Field(default=None, gt=0.0, description="m, of points from the curve near them")
    width_left: AlongValue | None = Field(default=None, description="m, from the centre line to the left edge")
    width_right: AlongValue | None = Field(default=None, description="m, to the right edge")
    speed_limit: AlongValue | None = Field(default=None, description="m/s")
    friction: AlongValue | None = Field(default=None, description="coefficient of all wheels")
    bank: AlongValue | None = Field(default=None, description="rad, positive where gravity pushes to the left")
    grade: AlongValue | None = Field(default=None, description="dz/ds, positive uphill, 0.05 for 5 per cent")
    points: tuple[tuple[float, float], ...] | None = Field(default=None, description="x, y (m), as they are driven")
    elements: tuple[Segment, ...] | None = None
    pieces: tuple[Piece, ...] | None = None

    @model_validator(mode="after")
    def _says_one_line(self) -> Self:
        line_kinds = [name for name in ("elements", "points", "pieces") if getattr(self, name)]
        if len(line_kinds) != 1:
            stated = " and ".join(line_kinds) or "neither elements nor points"
            raise ValueError(f"{stated}: give the centre line once, as [[elements]] or as points.")
        if self.max_deviation is not None and self.points is None:
            raise ValueError("max_deviation is for points; remove it.")
        return self


def road_from_toml(path: str | os.PathLike[str], **along: Any) -> Road:
    """The road of a TOML file; along: as in `Road.from_segments`, in place of what the file says.

    Raises StorageError when the file cannot be read, and ConfigError, with key, value and remedy, when it describes no
    road.
    """
    where = os.fspath(path)
    file = build(RoadFile, as_tuples(read_toml(path)), where)
    values = {key: getattr(file, key) for key in ALONG_QUANTITIES if getattr(file, key) is not None}
    values |= {"name": file.name or Path(path).stem} | along
    try:
        return _build_road(file, values)
    except InvalidInput as error:
        raise ConfigError(f"{where}: {error}") from None


def _build_road(file: RoadFile, values: dict[str, Any]) -> Road:
    if file.points:
        bound = MAX_DEVIATION if file.max_deviation is None else file.max_deviation
        return fit_road(np.array(file.points), closed=file.closed, max_deviation=bound, **values)
    closed = bool(file.closed)
    if file.elements:
        road = Road.from_segments(file.elements, closed=closed, **values)
    else:
        road = Road(table=_table_of(file.pieces or ()), closed=closed, **alongs(values))
    return road.replace(notes=file.notes, deviation=file.deviation)


def _table_of(road_pieces: Sequence[Piece]) -> Pieces:
    """The table of pieces one behind the other."""
    pieces = np.zeros((len(road_pieces), PIECE_COLUMNS))
    for row, piece in zip(pieces, road_pieces, strict=True):
        for name, columns in _COLUMNS.items():
            row[columns] = getattr(piece, name)
    pieces[:, COS], pieces[:, SIN] = portable.cos(pieces[:, HEADING]), portable.sin(pieces[:, HEADING])
    return end_to_end(pieces)


def write_road(path: str | os.PathLike[str], road: Road) -> None:
    """Write the file of a road."""
    data: dict[str, Any] = {"name": road.name, "closed": road.closed}
    if road.deviation:
        data["deviation"] = road.deviation
    if road.notes:
        data["notes"] = road.notes
    along = {name: getattr(road, name) for name in ALONG_QUANTITIES}
    data |= {name: _plain(values) for name, values in along.items() if values is not None}
    if road.elements:
        data["elements"] = [element.model_dump(exclude_none=True) for element in road.elements]
    else:
        data["pieces"] = [
            {name: row[columns].tolist() for name, columns in _COLUMNS.items()} for row in road.table.pieces
        ]
    write_toml(path, data, {name: field.description or "" for name, field in RoadFile.model_fields.items()})


def _plain(along: Along) -> Any:
    return along.value[0] if len(along.value) == 1 else along.model_dump()

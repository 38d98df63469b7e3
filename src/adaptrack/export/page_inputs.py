"""Cars as the page saves and reads them, and the keys, ranges, defaults and columns by which it checks its input.

`page/inputs.js` reads cars and points by it, so no range and no name is written twice.
"""

from __future__ import annotations

import math
import typing
from typing import Any, Literal

import numpy as np
from pydantic.fields import FieldInfo

from adaptrack.base.checked import allowed
from adaptrack.base.files import Record
from adaptrack.cars import data_sheet
from adaptrack.cars.vehicle import MAX_DOMAIN, Body, Domain, KnownWithin, Steering, Tyre, Vehicle, load_tyre
from adaptrack.core.kernel import OK
from adaptrack.core.roads import path
from adaptrack.core.synthesis import car, plant
from adaptrack.road.points import COLUMN_UNITS, DEGREE_COLUMNS, NAME, POINT_COLUMNS, WITHOUT_HEADER

SECTIONS: dict[str, type[Record]] = {
    "": Vehicle,
    "steering": Steering,
    "body": Body,
    "known_within": KnownWithin,
    "domain": Domain,
    "tyre": Tyre,
}
"""Sections of a car file, and the tyre's own file."""
MAX_PAGE_POINTS = 20_000
DRIVE = {
    "time": "time", "command": "command", "wheel": "wheel_angle", "speed": "vx", "yaw_rate": "yaw_rate", "vy": "vy",
    "acceleration": "lateral_acceleration", "yaw": "yaw", "x": "x", "y": "y",
}  # fmt: skip
"""Columns of a drive's CSV, as `identify` and `shadow` call them (SI units), and of a page's frames."""
ANSWERS = {
    "complete_car": {name: getattr(car, name) for name in (
        "OK", "MASS_OUTSIDE", "WHEELBASE_OUTSIDE", "TOO_MUCH_LOAD", "AXLES_DISAGREE")},
    "car_flaw": {"OK": OK},
    "overhangs": {"OK": OK},
    "path_through": {name: getattr(path, name) for name in (
        "OK", "TOO_FEW", "POINT_NOT_FINITE", "POINT_TOO_FAR", "TOO_SHORT", "PATH_KINK", "TOO_SMALL")},
}  # fmt: skip
"""What these kernels answer, by name."""
_BOUNDS = ("gt", "ge", "lt", "le")
_ROWS = {("tyre", "kind"): "linear", ("tyre", "shape"): "shape_factor"}
"""Keys that have another name in a row of the kernels: NumPy's records have attributes of these names."""


def car_fields() -> dict[str, Any]:
    """Return the fields of a car file as plain data for JSON.

    ``sections``: by name, of the car's own numbers ``""``, a list of tables: ``key``; ``kind``: number, text, texts,
    choice, range (two numbers that rise); ``row``: its name in the row of a kernel; ``words``: of a choice, whose
    number is its place; ``meaning``, with the unit; ``allowed``: in words; ``bounds``: gt, ge, lt, le, those there are;
    ``required``; ``default``, None: what is left out is not known.
    ``tyre``: of the car of a data sheet, as in `page_car`. ``sheet``: ranges of mass (kg) and wheelbase (m), body
    styles. ``points``: how a road is given. ``drive``: `DRIVE`. ``answers``: `ANSWERS`.
    """
    sections = {name: [_field(name, key, field) for key, field in kind.model_fields.items() if not _is_section(field)]
                for name, kind in SECTIONS.items()}  # fmt: skip
    return {
        "sections": sections,
        "most": MAX_DOMAIN,
        "tyre": _tyre(load_tyre(Vehicle.model_fields["tyre"].default)),
        "sheet": {
            "mass": list(car.MASSES), "wheelbase": list(car.WHEELBASES),
            "body_styles": list(data_sheet.BODY_STYLES),
        },
        "points": {
            "columns": {name: list(POINT_COLUMNS[name]) for name in ("x", "y")}, "degrees": list(DEGREE_COLUMNS),
            "name": NAME, "units": COLUMN_UNITS["x"], "without_header": WITHOUT_HEADER,
            "fewest": path.MIN_PATH_POINTS, "most": MAX_PAGE_POINTS, "farthest": path.MAX_COORDINATE,
            "widest": path.WIDEST, "shortest": path.MIN_PATH_LENGTH,
        },
        "drive": DRIVE,
        "answers": ANSWERS,
    }  # fmt: skip


def page_car(vehicle: Vehicle, tyre: Tyre | None = None) -> dict[str, Any]:
    """A car as the page saves and reads it, plain data for JSON; tyre: instead of the one that the car names."""
    sections = ("steering", "body", "known_within", "domain")
    return plain({
        "name": vehicle.name, "description": vehicle.description,
        "numbers": {key: value for key, value in vehicle.model_dump().items() if isinstance(value, float)},
        **{key: None if getattr(vehicle, key) is None else getattr(vehicle, key).model_dump() for key in sections},
        "tyre": _tyre(tyre or load_tyre(vehicle.tyre)),
    })  # fmt: skip


def _tyre(tyre: Tyre) -> dict[str, Any]:
    """A tyre with its row of `core.synthesis.plant.TyreRow` by name; None for NaN."""
    row = tyre.numbers
    numbers = {name: None if math.isnan(row[name]) else row[name].item() for name in plant.TyreRow._fields}
    return {"name": tyre.name, "numbers": numbers}


def plain(value: Any) -> Any:
    """Data as JSON has it: lists for tuples, text for numbers that are not finite."""
    if isinstance(value, dict):
        return {key: plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [plain(entry) for entry in value]
    if isinstance(value, float) and not math.isfinite(value):
        return "NaN" if math.isnan(value) else "Infinity" if value > 0.0 else "-Infinity"
    return value.item() if isinstance(value, np.generic) else value


def _is_section(field: FieldInfo) -> bool:
    kinds = typing.get_args(field.annotation) or (field.annotation,)
    return any(kind in SECTIONS.values() for kind in kinds)


def _field(section: str, key: str, field: FieldInfo) -> dict[str, Any]:
    kinds = [kind for kind in typing.get_args(field.annotation) if kind is not type(None)]
    kind = field.annotation if field.annotation in (str, float) or len(kinds) != 1 else kinds[0]
    meaning, default = field.description or "", field.get_default(call_default_factory=True)
    description = {
        "key": key, "kind": _kind(field.annotation, kind), "row": _ROWS.get((section, key), key),
        "meaning": meaning, "allowed": allowed(field),
        "required": field.is_required() and key != "name",
        "default": None if field.is_required() or default is None else plain(default),
        "bounds": {
            bound: getattr(constraint, bound) for bound in _BOUNDS for constraint in field.metadata
            if getattr(constraint, bound, None) is not None
        },
    }  # fmt: skip
    if description["kind"] == "choice":
        description["words"] = list(typing.get_args(field.annotation))
    return description


def _kind(annotation: Any, kind: Any) -> str:
    if kind is float:
        return "number"
    if kind is str:
        return "text"
    if typing.get_origin(annotation) is Literal:
        return "choice"
    return "range" if typing.get_args(annotation) == (float, float) else "texts"

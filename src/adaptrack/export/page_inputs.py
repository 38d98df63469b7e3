"""What a page may be given, from the records that check it here: keys, units, ranges, defaults, names of columns.

`page/inputs.js` reads car files and points by it; so no range and no name is written twice.
"""

from __future__ import annotations

import math
import re
import typing
from typing import Any, Literal

from pydantic.fields import FieldInfo

from adaptrack.base.checked import allowed
from adaptrack.base.files import Record
from adaptrack.cars import data_sheet
from adaptrack.cars.domain import MOST, Domain
from adaptrack.cars.known_within import KnownWithin
from adaptrack.cars.vehicle import FASTEST_RATE, Body, Steering, Tyre, Vehicle, list_tyres, load_tyre
from adaptrack.core import path
from adaptrack.core.synthesis import car, plant
from adaptrack.road.points import COLUMN_UNITS, COLUMNS, DEGREES, NAME, WITHOUT_HEADER

SECTIONS: dict[str, type[Record]] = {
    "": Vehicle,
    "steering": Steering,
    "body": Body,
    "known_within": KnownWithin,
    "domain": Domain,
    "tyre": Tyre,
}
"""Sections of a car file; of the tyre's own file, which a page takes as a section as well."""
LARGEST = {"car file": 1_000_000, "csv": 20_000_000}
"""bytes of a file"""
MOST_POINTS = 20_000
DRIVE = {
    "time": "time", "command": "command", "wheel": "wheel_angle", "speed": "vx", "yaw_rate": "yaw_rate", "vy": "vy",
    "acceleration": "lateral_acceleration", "yaw": "yaw", "x": "x", "y": "y",
}  # fmt: skip
"""Columns of a drive's CSV, as `identify` and `shadow` call them (SI units), and of a page's frames."""
ANSWERS = {
    "complete_car": {name: getattr(car, name) for name in (
        "COMPLETE", "MASS_OUTSIDE", "WHEELBASE_OUTSIDE", "TOO_MUCH_LOAD", "AXLES_DISAGREE")},
    "car_flaw": {name: getattr(car, name) for name in ("ONE_CAR", "INERTIA_ODD", "FRONT_ODD", "REAR_ODD")},
    "overhangs": {name: getattr(plant, name) for name in ("HOLDS", "AXLE_OUTSIDE", "LENGTH_DISAGREES")},
    "path_through": {name: getattr(path, name) for name in (
        "OK", "TOO_FEW", "NOT_FINITE", "TOO_FAR", "TWICE", "TOO_SHORT", "KINK", "TOO_SMALL")},
}  # fmt: skip
"""What these kernels answer, by name."""
_BOUNDS = ("gt", "ge", "lt", "le")
_ROWS = {("tyre", "kind"): "linear", ("tyre", "shape"): "shape_factor"}
"""Keys that have another name in a row of the kernels: NumPy's records have attributes of these names."""


def car_fields() -> dict[str, Any]:
    """What a car file may hold, plain data for JSON.

    ``sections``: by name, of the car's own numbers ``""``, a list of tables: ``key``; ``kind``: number, text, texts,
    choice, range (two numbers that rise); ``row``: its name in the row of a kernel; ``words``: of a choice, whose
    number is its place; ``unit``; ``meaning``; ``allowed``: in words; ``bounds``: gt, ge, lt, le, those there are;
    ``infinite``: whether inf is a number here; ``required``; ``default``, None: what is left out is not known.
    ``tyres``: by name, numbers as in `synthesis.plant.Tyre`. ``sheet``: ranges of mass (kg) and wheelbase (m), body
    styles. ``flaws``: bounds of ratios that kernels judge. ``points``: how a road is given. ``drive``:
    `DRIVE`. ``answers``: `ANSWERS`. ``largest``: bytes of a file.
    """
    sections = {name: [_field(name, key, each) for key, each in kind.model_fields.items() if not _is_section(each)]
                for name, kind in SECTIONS.items()}  # fmt: skip
    return {
        "sections": sections,
        "most": MOST,
        "fastest_rate": FASTEST_RATE,
        "tyres": {name: tyre_numbers(load_tyre(name)) for name in list_tyres()},
        "sheet": {
            "mass": list(data_sheet.MASSES), "wheelbase": list(data_sheet.WHEELBASES),
            "body_styles": list(data_sheet.BODY_STYLES),
        },
        "flaws": {"inertias": list(car.INERTIAS), "stiffnesses": list(car.STIFFNESSES), "matching": plant.MATCHING},
        "points": {
            "columns": {name: list(COLUMNS[name]) for name in ("x", "y")}, "degrees": list(DEGREES), "name": NAME,
            "units": COLUMN_UNITS["x"], "without_header": WITHOUT_HEADER,
            "fewest": path.FEWEST, "most": MOST_POINTS, "farthest": path.FARTHEST, "widest": path.WIDEST,
            "same": path.SAME, "shortest": path.SHORTEST,
        },
        "drive": DRIVE,
        "answers": ANSWERS,
        "largest": LARGEST,
    }  # fmt: skip


def tyre_numbers(tyre: Tyre) -> dict[str, Any]:
    """A row of `core.synthesis.plant.Tyre` by name; None for NaN."""
    row = tyre.numbers
    return {name: None if math.isnan(row[name]) else row[name].item() for name in plant.Tyre._fields}


def _is_section(field: FieldInfo) -> bool:
    kinds = typing.get_args(field.annotation) or (field.annotation,)
    return any(kind in SECTIONS.values() for kind in kinds)


def _field(section: str, key: str, field: FieldInfo) -> dict[str, Any]:
    kinds = [kind for kind in typing.get_args(field.annotation) if kind is not type(None)]
    kind = field.annotation if field.annotation in (str, float) or len(kinds) != 1 else kinds[0]
    meaning, default = field.description or "", field.get_default(call_default_factory=True)
    made = {
        "key": key, "kind": _kind(field.annotation, kind), "row": _ROWS.get((section, key), key),
        "unit": _unit(meaning), "meaning": meaning, "allowed": allowed(field),
        "required": field.is_required() and key != "name",
        "default": None if field.is_required() or default is None else _plain(default),
        "infinite": any(getattr(each, "allow_inf_nan", False) for each in field.metadata),
        "bounds": {
            bound: getattr(each, bound) for bound in _BOUNDS for each in field.metadata
            if getattr(each, bound, None) is not None
        },
    }  # fmt: skip
    if made["kind"] == "choice":
        made["words"] = list(typing.get_args(field.annotation))
    return made


def _kind(annotation: Any, kind: Any) -> str:
    if kind is float:
        return "number"
    if kind is str:
        return "text"
    if typing.get_origin(annotation) is Literal:
        return "choice"
    return "range" if typing.get_args(annotation) == (float, float) else "texts"


def _unit(meaning: str) -> str:
    """What a description begins with, where it names a unit; else nothing."""
    return next((unit for unit in _UNITS if re.match(f"{re.escape(unit)}(?![a-z^/])", meaning)), "")


_UNITS = (
    "kg m^2", "kg/m^3", "kg", "m^2", "m/s", "m", "s", "N/rad", "N", "W", "rad/s", "rad", "1/rad", "-",
)  # fmt: skip


def _plain(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value

"""How well the numbers of a car are known: by a factor, or by so much to either side."""

from __future__ import annotations

import math
from typing import Any

from adaptrack.base.files import FieldRecord
from adaptrack.core.models.car import CAR, OUTLINE, STEERING, STEERING_WHEEL_RATIO

FACTOR = "-, factor"
"""How the description of a key begins whose uncertainty is a factor; that of another begins with its unit."""
_MARGINS = {
    "lf": 5.0, "track_front": 5.0, "track_rear": 5.0, "cg_height": 5.0, "drive_front": 1.0, "brake_front": 1.0,
    "length": 10.0, "width": 5.0, "front_overhang": 5.0, "rear_overhang": 5.0, "steering_lag": 1.0,
    "steering_dead_time": 1.0,
}  # fmt: skip
"""Largest margins; the other tolerances are factors."""


def _tolerance(name: str, field: Any) -> Any:
    """The field of the tolerance of a number."""
    margin = _MARGINS.get(name)
    if margin is None:
        meaning = f"factor by which it may be larger or smaller: {field.meaning}"
        return field._replace(name=name, unit="", default=math.nan, meaning=meaning, bounds="[1, 10]")
    meaning = f"by which it may differ to either side: {field.meaning}"
    return field._replace(name=name, default=math.nan, meaning=meaning, bounds=f"[0, {margin:g}]")


_CAR = tuple(_tolerance(field.name, field) for field in (*CAR, *OUTLINE) if field.name != "lr")
_STEERING = tuple(_tolerance(f"steering_{field.name}", field) for field in (*STEERING, STEERING_WHEEL_RATIO))


class KnownWithin(FieldRecord, fields=(*_CAR, *_STEERING), optional=True):
    """How far the numbers of a car may be off: the section ``[known_within]`` of a car file.

    A factor f says that the true value lies between value/f and f value; a margin d, between value - d and value + d.
    Keys are those of the car, of its ``[steering]`` with ``steering_`` in front. What is left out is not said.
    """

    @classmethod
    def is_factor(cls, name: str) -> bool:
        """Whether the uncertainty of a key is a factor, not a margin."""
        return (cls.model_fields[name].description or "").startswith(FACTOR)

    def clause(self, name: str) -> str:
        """A factor as "x/÷ 1.3", a margin as "± 0.05 m"; empty where nothing is said."""
        value = getattr(self, name, None)
        if value is None:
            return ""
        if self.is_factor(name):
            return f"x/÷ {value:.3g}"
        unit = (type(self).model_fields[name].description or "").split(",")[0]
        return f"± {value:.3g}" + ("" if unit == "-" else f" {unit}")

"""Surroundings of the car: friction under each wheel, and wind."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field, model_validator

from adaptrack.base.errors import InvalidInput
from adaptrack.base.files import Record, build
from adaptrack.scenario.shapes import Array, Constant, Shape, Signal, as_shape
from adaptrack.scenario.signals import HIGHEST_FRICTION

WHEELS = {
    "all": (0, 1, 2, 3),
    "left": (0, 2),
    "right": (1, 3),
    "front": (0, 1),
    "rear": (2, 3),
    "front-left": (0,),
    "front-right": (1,),
    "rear-left": (2,),
    "rear-right": (3,),
}
"""Columns of `Signals.friction` by name."""


class Wind(Record):
    """Wind velocity in the world frame (m/s): ``x`` along +X (forward at the start), ``y`` along +Y (left).

    Wind from the right has ``y`` > 0. The lateral wind v_w of the paper is ``y``.
    """

    x: Signal = Constant(value=0.0)
    y: Signal = Constant(value=0.0)

    def at(self, t: ArrayLike) -> Array:
        """Return the wind velocities (..., 2) in m/s at the times `t` (s)."""
        return np.stack([self.x.at(t), self.y.at(t)], axis=-1)

    def mirrored(self) -> Wind:
        """Return the wind with left and right exchanged."""
        return self.replace(y=self.y.scaled(-1.0))

    def table(self) -> Any:
        """Return the entry of a scenario file for this wind."""
        if self.x == Constant(value=0.0):
            return self.y.table()
        return {"x": self.x.table(), "y": self.y.table()}


def as_wind(value: Any) -> Wind:
    """Convert a lateral wind (number or shape), a pair [x, y] or a table {x, y} to a `Wind`."""
    if isinstance(value, Wind):
        return value
    if isinstance(value, Mapping) and "shape" not in value:
        return build(Wind, value, "wind")
    if isinstance(value, list | tuple):
        if len(value) != 2:
            raise InvalidInput("wind: give one lateral wind, or the pair [x, y].")
        return Wind(x=as_shape(value[0]), y=as_shape(value[1]))
    return Wind(y=as_shape(value))


def as_friction(value: Any) -> tuple[Shape, ...]:
    """Convert one friction for all wheels, [left, right] or one per wheel to a tuple of shapes."""
    if not isinstance(value, list | tuple):
        return (as_shape(value),)
    if len(value) not in (1, 2, 4):
        raise InvalidInput("give one value, [left, right], or [front-left, front-right, rear-left, rear-right].")
    return tuple(as_shape(shape) for shape in value)


class Patch(Record):
    """Different friction under the named ``wheels`` from time ``start`` until time ``end`` (s)."""

    start: Annotated[float, Field(description="s")]
    end: Annotated[float, Field(description="s")]
    friction: Annotated[float, Field(gt=0.0, le=HIGHEST_FRICTION)]
    wheels: Literal["all", "left", "right", "front", "rear", "front-left", "front-right", "rear-left", "rear-right"] = (
        "all"
    )

    @model_validator(mode="after")
    def _check_times(self) -> Self:
        if not self.end > self.start:
            raise InvalidInput(f"the patch ends at {self.end!r} s; it must end after its start at {self.start!r} s.")
        return self

    def mirrored(self) -> Patch:
        """Return the patch with left and right exchanged."""
        swap = {"left": "right", "right": "left"}
        return self.replace(wheels=re.sub("left|right", lambda side: swap[side[0]], self.wheels))


def as_patches(value: Any) -> tuple[Patch, ...]:
    """Convert a list of tables to a tuple of patches."""
    if not isinstance(value, list | tuple):
        raise InvalidInput("give a list of patches.")
    return tuple(patch if isinstance(patch, Patch) else build(Patch, patch, "patch") for patch in value)

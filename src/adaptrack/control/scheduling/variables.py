"""The scheduling variables: what a scheduler looks at to choose a tuning. They are defined here and nowhere else."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from adaptrack.base.checked import real
from adaptrack.base.errors import InvalidInput, format_value
from adaptrack.control.controllers.inputs import vector
from adaptrack.core.maths.portable import Array
from adaptrack.core.planning.drive import LOOK_AHEAD as LOOK_AHEAD
from adaptrack.core.planning.drive import reference_ahead


class Variable(NamedTuple):
    """One scheduling variable."""

    label: str
    """how tables and figures call it"""
    unit: str
    low: float
    """lowest value of the package's operating domain, in `unit`"""
    high: float
    """highest value there"""
    meaning: str


VARIABLES: dict[str, Variable] = {
    "speed": Variable("Speed", "m/s", 3.0, 30.0, "longitudinal velocity v_x"),
    "y_ref": Variable("Lateral reference", "m", -15.0, 15.0, "lateral reference now"),
    "friction": Variable("Friction", "–", 0.3, 1.0, "mean of the four wheels"),
    "wind": Variable("Side wind", "m/s", -30.0, 30.0, "velocity of the air along +Y, v_w"),
    "change": Variable(
        "Reference change ahead",
        "m",
        0.0,
        8.0,
        "largest |y_ref(t + s) - y_ref(t)| over the next `LOOK_AHEAD` seconds s",
    ),
    "acceleration": Variable(
        "Acceleration ahead", "m/s²", 0.0, 3.5, "largest |second derivative of y_ref| over the same time"
    ),
    "offset": Variable("Offset", "m", -5.0, 5.0, "y_ref - y"),
}
"""By name, in the order of `SchedulingVariables`."""


class SchedulingVariables(NamedTuple):
    """The scheduling variables at a control instant, see `VARIABLES`.

    The first four are the paper's; `reference_preview` computes `change` and `acceleration` from a planned reference.
    """

    speed: float
    y_ref: float
    friction: float
    wind: float
    change: float = 0.0
    acceleration: float = 0.0
    offset: float = 0.0


def complete(variables: Sequence[float]) -> SchedulingVariables:
    """Given variables in the order of `VARIABLES`, all of them: what may be left out at the end is zero.

    Raises InvalidInput when one of the first four is missing, there are too many, or one is not a number (NaN and
    infinity are numbers here: a scheduler answers them).
    """
    if isinstance(variables, SchedulingVariables):
        return variables
    try:
        return SchedulingVariables(*[real("scheduling variables", "value", value) for value in variables])
    except (TypeError, ValueError):
        raise InvalidInput(
            f"scheduling variables {format_value(variables)}: need {len(VARIABLES)} numbers, {', '.join(VARIABLES)}; "
            "the last three may be left out."
        ) from None


def reference_preview(reference: ArrayLike, period: float, instants: int = 1) -> tuple[Array, Array]:
    """`change` (m) and `acceleration` (m/s^2), each (instants,), at the first control instants.

    reference: y_ref (m) at the instants, one `period` (s) apart; beyond its end it goes straight on.
    """
    y = vector("reference", reference)
    change, acceleration = np.empty(instants), np.empty(instants)
    reference_ahead(period, y, change, acceleration)
    return change, acceleration

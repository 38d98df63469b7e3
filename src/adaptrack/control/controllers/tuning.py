"""What may be tuned of the MPC, and what a scheduler may answer."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import astuple
from typing import Annotated, Any, Self

import numpy as np

from adaptrack.base.checked import Count, real
from adaptrack.base.errors import InvalidInput
from adaptrack.base.limits import CONTROL_HORIZON, PREDICTION_HORIZON
from adaptrack.control.controllers.base import Policy
from adaptrack.control.settings import RecordSettings
from adaptrack.core.controllers.mpc import MPCTuning
from adaptrack.core.maths.portable import Array

ENTRIES = MPCTuning._fields
"""The MPC's named tuning entries."""
HORIZONS = ENTRIES[:2]
"""Entries of the MPC that are whole numbers."""


class Tuning(RecordSettings, record=MPCTuning):
    """Horizons and weights of the MPC; only R/Q changes the control law. The defaults are the paper's table.

    Raises
    ------
    InvalidInput
        When the control horizon is longer than the prediction horizon.
    """

    Np: Annotated[Count, PREDICTION_HORIZON]
    Nc: Annotated[Count, CONTROL_HORIZON]

    def __post_init__(self) -> None:
        if self.Nc > self.Np:
            raise InvalidInput(f"Tuning: Nc = {self.Nc} > Np = {self.Np}: the control horizon must not be longer.")

    def as_array(self) -> Array:
        """[Np, Nc, Q, R] as floats."""
        return np.array(astuple(self), dtype=float)

    def as_policy(self) -> Policy:
        """Return the policy that drives runs with their MPC and this tuning."""
        return Policy(tunings=self.as_array())

    @classmethod
    def of(cls, values: Iterable[float]) -> Self:
        """Return the tuning of four numbers, in the order of `ENTRIES`; horizons are rounded."""
        entries = zip(ENTRIES, values, strict=True)
        return cls(**{name: round(value) if name in HORIZONS else value for name, value in entries})


def read_tuning(answer: Any, entries: Sequence[str] = ENTRIES) -> tuple[float, ...]:
    """The finite numbers that a scheduler answered, one for each entry: of a `Tuning` or of a sequence of numbers.

    Raises InvalidInput for any other answer: None, text, too few or too many numbers, NaN, infinity.
    """
    entry_values = answer.as_array() if hasattr(answer, "as_array") else answer
    try:
        values = tuple(entry_values)
    except TypeError:
        values = ()
    if len(values) != len(entries):
        raise InvalidInput(f"scheduler: answered {answer!r}: must be a Tuning or the numbers {', '.join(entries)}.")
    numbers = [real("scheduler", name, value) for name, value in zip(entries, values, strict=True)]
    if not all(map(math.isfinite, numbers)):
        raise InvalidInput(f"scheduler: answered {tuple(numbers)}: {', '.join(entries)} must be finite.")
    return tuple(numbers)

"""What may be tuned of the MPC, and what a scheduler may answer."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from adaptrack.base.checked import real, whole_number
from adaptrack.base.errors import InvalidInput
from adaptrack.base.limits import CONTROL_HORIZON, PREDICTION_HORIZON, check_limit
from adaptrack.core.synthesis.tuning import PAPER_TUNING

Array = NDArray[np.float64]

ENTRIES = ("Np", "Nc", "Q", "R")
"""The MPC's named tuning entries."""


@dataclass(frozen=True)
class Tuning:
    """Horizons and weights of the MPC; the defaults are the paper's table.

    Raises
    ------
    InvalidInput
        Unless 1 <= Nc <= Np are integers, Q >= 0 and R > 0 are finite.
    """

    Np: int = PAPER_TUNING.Np
    """prediction horizon (control periods)"""
    Nc: int = PAPER_TUNING.Nc
    """control horizon (control periods)"""
    Q: float = PAPER_TUNING.Q
    """1/m^2, weight of the tracking error"""
    R: float = PAPER_TUNING.R
    """1/rad^2, weight of the moves; only R/Q changes the control law"""

    def __post_init__(self) -> None:
        for name in ("Np", "Nc"):
            object.__setattr__(self, name, whole_number("Tuning", name, getattr(self, name)))
        for name in ("Q", "R"):
            object.__setattr__(self, name, real("Tuning", name, getattr(self, name)))
        check_limit("Tuning: Np", self.Np, PREDICTION_HORIZON)
        check_limit("Tuning: Nc", self.Nc, CONTROL_HORIZON)
        if self.Nc > self.Np:
            raise InvalidInput(f"Tuning: Nc = {self.Nc} > Np = {self.Np}: the control horizon must not be longer.")
        if not 0.0 <= self.Q < math.inf:
            raise InvalidInput(f"Tuning: Q = {self.Q!r}: must be finite and not negative.")
        if not 0.0 < self.R < math.inf:
            raise InvalidInput(f"Tuning: R = {self.R!r}: must be finite and positive (the QP is not convex else).")

    def as_array(self) -> Array:
        """[Np, Nc, Q, R] as floats."""
        return np.array([self.Np, self.Nc, self.Q, self.R], dtype=float)


def read_tuning(answer: Any, entries: Sequence[str] = ENTRIES) -> tuple[float, ...]:
    """The finite numbers that a scheduler answered, one for each entry: of a `Tuning` or of a sequence of numbers.

    Raises
    ------
    InvalidInput
        When the answer is anything else: None, text, too few or too many numbers, NaN, infinity.
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

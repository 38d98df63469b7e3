"""What may be tuned of the MPC, and what a scheduler may answer."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import astuple, make_dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from adaptrack.base.checked import real, whole_number
from adaptrack.base.errors import InvalidInput
from adaptrack.base.limits import CONTROL_HORIZON, PREDICTION_HORIZON, check_limit
from adaptrack.control.controllers.base import Policy
from adaptrack.core.controllers.mpc import MPC_TUNING_FIELDS, MPCTuning

Array = NDArray[np.float64]

ENTRIES = MPCTuning._fields
"""The MPC's named tuning entries."""
HORIZONS = ENTRIES[:2]
"""Entries of the MPC that are whole numbers."""
_Entries: Any = make_dataclass(
    "_Entries", [(field.name, float, field.default) for field in MPC_TUNING_FIELDS], frozen=True,
    namespace={"__post_init__": lambda self: None},
)  # fmt: skip


class Tuning(_Entries):  # type: ignore[misc]
    """Horizons and weights of the MPC; the defaults are the paper's table.

    Np and Nc are the prediction and the control horizon (control periods), Q (1/m^2) weighs the tracking error and R
    (1/rad^2) the moves; only R/Q changes the control law.

    Raises
    ------
    InvalidInput
        Unless 1 <= Nc <= Np are integers, Q >= 0 and R > 0 are finite.
    """

    def __post_init__(self) -> None:
        for name in ENTRIES:
            check = whole_number if name in HORIZONS else real
            object.__setattr__(self, name, check("Tuning", name, getattr(self, name)))
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

"""What a scheduler answers: the entries of a controller's tuning."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from adaptrack.errors import InvalidInput, real

ENTRIES = ("Np", "Nc", "Q", "R")
"""The entries of the MPC's tuning, see `Tuning`."""


def read_tuning(answer: Any, entries: Sequence[str] = ENTRIES) -> tuple[float, ...]:
    """The finite numbers that a scheduler answered, one for each entry: of a `Tuning` or of a sequence of numbers.

    Raises
    ------
    InvalidInput
        When the answer is anything else: None, text, too few or too many numbers, NaN, infinity.
    """
    given = answer.as_array() if hasattr(answer, "as_array") else answer
    try:
        values = tuple(given)
    except TypeError:
        values = ()
    if len(values) != len(entries):
        raise InvalidInput(f"scheduler: answered {answer!r}: must be a Tuning or the numbers {', '.join(entries)}.")
    numbers = []
    for name, value in zip(entries, values, strict=True):
        try:
            numbers.append(real("scheduler", name, value))
        except OverflowError:
            numbers.append(math.inf)
    if not all(map(math.isfinite, numbers)):
        raise InvalidInput(f"scheduler: answered {tuple(numbers)}: {', '.join(entries)} must be finite.")
    return tuple(numbers)

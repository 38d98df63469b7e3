"""Which rows a model trains on and which it holds out to know when to stop."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from adaptrack.base.errors import InvalidInput

Integers = NDArray[np.int64]


def held_out(model: str, n: int, fraction: float, rng: np.random.RandomState) -> tuple[Integers, Integers]:
    """The rows of n to train on and those held out, a `fraction` at random, one at least; each in ascending order.

    Raises
    ------
    InvalidInput
        When none would be left to train on.
    """
    held = max(1, round(fraction * n))
    if held >= n:
        raise InvalidInput(f"{model}: validation_fraction = {fraction!r} of {n} sample(s) leaves none.")
    order = rng.permutation(n)
    return np.sort(order[held:]), np.sort(order[:held])

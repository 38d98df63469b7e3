"""When a run counts as failed."""

from __future__ import annotations

import math
from dataclasses import dataclass

from adaptrack.errors import InvalidInput, real


@dataclass(frozen=True)
class Failure:
    """A run has failed once the car is off the road, has spun, or its state is not finite.

    Raises
    ------
    InvalidInput
        When the distance is not positive, or the sideslip not within (0, pi/2].
    """

    distance: float = 5.0
    """m, off the road: |Y - y_ref| is larger"""
    sideslip: float = math.pi / 4.0
    """rad, spun: |atan(v_y/v_x)| is larger"""

    def __post_init__(self) -> None:
        if not real("Failure", "distance", self.distance) > 0.0:
            raise InvalidInput(f"Failure: distance = {self.distance!r} m: must be positive.")
        if not 0.0 < real("Failure", "sideslip", self.sideslip) <= math.pi / 2.0:
            raise InvalidInput(f"Failure: sideslip = {self.sideslip!r} rad: must be in (0, pi/2].")

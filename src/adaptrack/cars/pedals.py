"""Pedals of a car: the force at the wheels that throttle and brake give, and the pedals that a force needs."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from adaptrack.base.files import LISTED, Record

COASTING_SHARE = 0.01
"""Of the largest brake force: up to so far below the force of the coasting car, a request presses no pedal."""
Numbers = Annotated[tuple[float, ...], LISTED]
"""Values at the points of a table; a list in TOML."""


class PedalMap(Record):
    """Static map between pedals and forces at the wheels: the section ``[pedals]`` of a car file.

    Forces are those of drive and brakes alone, without air drag, rolling resistance and slope. Between its points the
    map is linear; beyond them it is constant. Lag and dead time are those of the sections ``[drive]`` and ``[brakes]``.
    """

    speed: Numbers = Field(description="m/s, of the rows of force")
    throttle: Numbers = Field(description="-, pedal positions of the columns of force, from 0 to at most 1")
    force: Annotated[tuple[Numbers, ...], LISTED] = Field(
        description="N, at the wheels, a row for each speed; at throttle 0 creep (> 0) or engine braking (< 0)"
    )
    brake: Numbers = Field(description="-, pedal positions of brake_force, from 0 to at most 1")
    brake_force: Numbers = Field(description="N, at the wheels, from 0")

    @model_validator(mode="after")
    def _force_rises_with_the_pedals(self) -> Self:
        for name in ("speed", "throttle", "brake"):
            points = getattr(self, name)
            if not points or points[0] < 0.0 or any(after <= before for before, after in pairwise(points)):
                raise ValueError(f"{name} must begin with a value of at least 0 and rise from value to value.")
            if name != "speed" and not 0.0 == points[0] < points[-1] <= 1.0:
                raise ValueError(f"{name} must begin with 0 and end at most at 1; divide per cent by 100.")
        if len(self.force) != len(self.speed) or self.brake_force[:1] != (0.0,):
            raise ValueError("force must have a row for each speed, and brake_force must begin with 0.")
        rows = [(f"force at {speed:g} m/s", row, "throttle") for speed, row in zip(self.speed, self.force, strict=True)]
        for name, forces, pedal in (*rows, ("brake_force", self.brake_force, "brake")):
            falls = any(after < before for before, after in pairwise(forces))
            if len(forces) != len(getattr(self, pedal)) or falls or forces[0] >= forces[-1]:
                raise ValueError(
                    f"{name} is {', '.join(f'{force:g}' for force in forces)} N: give a value for each position of "
                    f"{pedal}, none below the one before it, and the last above the first."
                )
        return self

    def drive_forces(self, speed: float) -> NDArray[np.float64]:
        """Return the forces (N) at the points of the throttle, at a speed (m/s)."""
        return np.array([np.interp(speed, self.speed, column) for column in zip(*self.force, strict=True)])

    def force_at(self, throttle: float, brake: float, speed: float) -> float:
        """Return the force (N) at the wheels, positive forward, of throttle and brake (0 to 1) at a speed (m/s)."""
        driving = np.interp(throttle, self.throttle, self.drive_forces(speed))
        return float(driving - np.interp(brake, self.brake, self.brake_force))

    def positions(self, force: float, speed: float, hold: float = 0.0) -> tuple[float, float]:
        """Return throttle and brake (0 to 1) that give a force (N) at a speed (m/s).

        A force above that of the coasting car needs the throttle, a force below it the brakes. They begin to act
        `COASTING_SHARE` below it, and act fully from twice that on, so that the pedals do not alternate.

        hold: N, of the brakes in addition
        """
        drive_forces = self.drive_forces(speed)
        missing = float(drive_forces[0]) - force
        throttle = float(np.interp(force, drive_forces, self.throttle)) if missing < 0.0 else 0.0
        braking = hold + max(min(missing, 2.0 * (missing - COASTING_SHARE * self.brake_force[-1])), 0.0)
        return throttle, float(np.interp(braking, self.brake_force, self.brake)) if braking > 0.0 else 0.0

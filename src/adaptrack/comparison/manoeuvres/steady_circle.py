"""Steady circular driving, after ISO 4138: how much the wheels must turn for how much lateral acceleration.

Two of the standard's methods, on a circle of constant radius and at constant speed. It has no limits to pass.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from adaptrack.base.checked import real
from adaptrack.base.errors import InvalidInput
from adaptrack.cars.plant import Plant, SteppedPlant
from adaptrack.cars.vehicle import GRAVITY, Vehicle
from adaptrack.comparison.manoeuvres.open_loop import DEGREE, SteadyTurns, Surroundings, find_turns

Array = NDArray[np.float64]

STEP = 0.5
"""m/s^2 between turns: ISO 4138 wants no more."""
HIGHEST = 12.0
"""m/s^2, up to which turns are looked for."""
RADIUS = 100.0
"""m, the standard's preferred circle."""
COARSE = 0.01
"""s, sampling: only where a turn settles counts."""


@dataclass(frozen=True, eq=False)
class SteadyCircle:
    """The turns of one test that were found steady, in steps of the lateral acceleration."""

    method: Literal["constant radius", "constant speed"]
    held: float
    """m or m/s, what is constant"""
    wheelbase: float
    """m"""
    turns: SteadyTurns
    understeer_gradient: Array
    """(m,) rad s^2/m, K: slope of the wheel angle over the lateral acceleration, less that of the Ackermann angle"""

    @property
    def highest(self) -> float:
        """m/s^2, the largest lateral acceleration of a steady turn that was found."""
        return float(self.turns.lateral_acceleration[-1])

    def gradient_at(self, lateral_acceleration: float) -> float:
        """K (rad s^2/m) at a lateral acceleration (m/s^2); NaN beyond the turns that were found."""
        known = self.turns.lateral_acceleration
        if not 0.99 * known[0] <= lateral_acceleration <= 1.01 * known[-1]:  # v^2/R of v_x is not quite what is felt
            return math.nan
        return float(np.interp(lateral_acceleration, known, self.understeer_gradient))

    def rows(self) -> list[dict[str, Any]]:
        """One turn each, in degrees where the field speaks of them."""
        turns = self.turns
        return [
            {
                "lateral_acceleration": float(turns.lateral_acceleration[k]),
                "speed": float(turns.speed[k]),
                "wheel_angle": float(turns.wheel_angle[k] / DEGREE),
                "sideslip": float(turns.sideslip[k] / DEGREE),
                "yaw_rate": float(turns.yaw_rate[k] / DEGREE),
                "understeer_gradient": float(self.understeer_gradient[k] / DEGREE * GRAVITY),
            }
            for k in range(turns.speed.size)
        ]

    def summary(self) -> dict[str, Any]:
        """K at 2 and 4 m/s^2 (degrees per g), and the highest lateral acceleration (m/s^2)."""
        return {
            "understeer_gradient_2": self.gradient_at(2.0) / DEGREE * GRAVITY,
            "understeer_gradient_4": self.gradient_at(4.0) / DEGREE * GRAVITY,
            "highest_lateral_acceleration": self.highest,
        }


def steady_circle(
    car: Vehicle,
    plant: Plant | SteppedPlant,
    *,
    radius: float | None = None,
    speed: float | None = None,
    step: float = STEP,
    surroundings: Surroundings | None = None,
) -> SteadyCircle:
    """Steady turns to the left, up to the last lateral acceleration that the plant can hold.

    Parameters
    ----------
    car
        Its wheelbase counts for the Ackermann angle, its linear model for where to look first.
    radius
        m, of the circle of the centre of mass: the method with constant radius, 100 m unless a speed is given.
    speed
        m/s: the method with constant speed.
    step
        m/s^2 between turns.

    Raises
    ------
    InvalidInput
        When both or impossible values are given, or no turn is steady.
    """
    if radius is not None and speed is not None:
        raise InvalidInput("steady_circle: give a radius or a speed, not both.")
    held = speed if speed is not None else RADIUS if radius is None else radius
    for name, value in (("radius" if speed is None else "speed", held), ("step", step)):
        if not 0.0 < real("steady_circle", name, value) < math.inf:
            raise InvalidInput(f"steady_circle: {name} = {value!r}: must be positive and finite.")
    given = surroundings or Surroundings(period=COARSE)
    wanted = step * np.arange(1, max(2, math.floor(HIGHEST / step)) + 1)
    if speed is None:
        found = find_turns(car, plant, np.sqrt(wanted * held), wanted, given, radius=held)
    else:
        found = find_turns(car, plant, held, wanted, given)
    missing = np.flatnonzero(np.isnan(found.wheel_angle))
    count = int(missing[0]) if missing.size else wanted.size
    if count < 2:
        raise InvalidInput(
            f"steady_circle: fewer than two steady turns at {held:g} {'m' if speed is None else 'm/s'} in steps of "
            f"{step:g} m/s^2: the plant has no steady turn there, or needs another radius or speed."
        )
    turns = SteadyTurns(*(each[:count] for each in vars(found).values()))
    ackermann = 0.0 if speed is None else car.wheelbase / held**2
    slope = np.gradient(turns.wheel_angle, turns.lateral_acceleration) - ackermann
    return SteadyCircle("constant radius" if speed is None else "constant speed", held, car.wheelbase, turns, slope)

"""What a controller with the true parameters knows of its car: tyres as the plant's, steering as the actuator's."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Self

from adaptrack.base.checked import real
from adaptrack.base.errors import InvalidInput
from adaptrack.cars.vehicle import Steering, Tyre, Vehicle, load_tyre
from adaptrack.control.controllers.belief import Belief
from adaptrack.control.controllers.limits import Limits
from adaptrack.control.controllers.setup import world_and_belief
from adaptrack.core.public import GRAVITY
from adaptrack.scenario.profile import Profile

LINEAR_PEAK = 1e9
"""N, D of a linear tyre: its Magic Formula is straight to nine digits at any slip."""


@dataclass(frozen=True, eq=False)
class KnownCar:
    """A car, its axles on their tyres' curve at static load, its steering, and the profile that it drives in."""

    vehicle: Vehicle
    tyre: Tyre
    friction: float
    """coefficient that the tyres are thought to have"""
    profile: Profile
    belief: Belief
    period: float
    """s, control period"""

    @classmethod
    def of(
        cls, where: str, vehicle: Vehicle, profile: str | Profile | None, belief: Steering | None,
        tyre: Tyre | str | None, friction: float, period: float | None, computation: float | None = None,
    ) -> Self:  # fmt: skip
        """Arguments as for `MPPI`; where: who asks, for messages.

        Raises
        ------
        InvalidInput
            For arguments that describe no car.
        """
        world, control_period, said = world_and_belief(vehicle, profile, belief, period, computation)
        if not 0.0 < real(where, "friction", friction) < math.inf:
            raise InvalidInput(f"{where}: friction = {friction!r}: must be positive and finite.")
        known = tyre if isinstance(tyre, Tyre) else load_tyre(vehicle.tyre if tyre is None else tyre)
        return cls(vehicle, known, float(friction), world, said, control_period)

    @property
    def limits(self) -> Limits:
        """On moves and angle, as the steering has them."""
        return self.belief.bounds(self.period)

    @property
    def stiffness(self) -> tuple[float, float]:
        """Slope of the front and of the rear axle's force (N/rad) at the origin."""
        front, rear = self.tyre.stiffness_at(*self.vehicle.static_loads)
        factor = self.friction if self.tyre.kind == "linear" else 1.0
        return 2.0 * factor * front, 2.0 * factor * rear

    @property
    def peaks(self) -> tuple[float, float]:
        """D of the front and of the rear axle (N): mu F_z (1 - d (q - 1)), see `Tyre`."""
        if self.tyre.kind == "linear":
            return LINEAR_PEAK, LINEAR_PEAK
        front, rear = (self._peak(load) for load in self.vehicle.static_loads)
        return front, rear

    def _peak(self, load: float) -> float:
        loss = self.tyre.friction_load_sensitivity * (load / self.tyre.nominal_load - 1.0)
        return 2.0 * self.friction * load * max(1.0 - loss, 0.1)

    @property
    def curve(self) -> tuple[float, float]:
        """C and E of the tyres."""
        return (1.0, 0.0) if self.tyre.kind == "linear" else (self.tyre.shape, self.tyre.curvature)

    @property
    def grip(self) -> float:
        """m/s^2, what the tyres can pull at most."""
        return GRAVITY * self.friction

    def describe(self) -> dict[str, Any]:
        """For provenance."""
        return {
            "vehicle": self.vehicle.name, "tyre": self.tyre.name, "friction": self.friction,
            "belief": str(self.belief),
        }  # fmt: skip

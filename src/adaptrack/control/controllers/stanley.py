"""The Stanley law."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from adaptrack.base.checked import checked
from adaptrack.cars.vehicle import VehicleArgument
from adaptrack.control.controllers.base import Array, CompiledController, TuningBounds, steering_delay
from adaptrack.control.controllers.limits import LimitsArgument
from adaptrack.core.controllers import stanley as kernel
from adaptrack.core.synthesis import laws


class Stanley(CompiledController):
    """The law of the car that won the DARPA Grand Challenge of 2005, with a dead-time term.

        delta = psi_e + m l_r/(2 C_f L) v^2 kappa + atan(gain e/(softening + v)) + yaw_rate_gain (v kappa - r)

    psi_e: heading of the path less the car's; e: offset of the path from the front axle, positive to the left; kappa:
    curvature of the path; the second term is the slip of the front tyres in the turn. G. M. Hoffmann, C. J. Tomlin,
    M. Montemerlo, S. Thrun, *Autonomous Automobile Trajectory Tracking for Off-Road Driving*, American Control
    Conference 2007; their damping of the steering servo is left out, because the wheel's angle is not measured here.

    The dead-time term is ours: psi_e and e are those that the present motion (v_x, v_y, yaw rate) leads to after
    `dead_time`, against the path there.

    gain: 1/s; softening: m/s; yaw_rate_gain: s; dead_time: s, None for the lag and dead time of the vehicle's steering
    (0.2 s where nothing is known); the rest: see `CompiledController`.
    """

    is_exportable = True
    tuning_bounds: Mapping[str, TuningBounds] = {
        "gain": TuningBounds(0.1, 10.0, relative=True),
        "softening": TuningBounds(0.1, 10.0, relative=True),
        "yaw_rate_gain": TuningBounds(0.0, 0.3),
        "dead_time": TuningBounds(0.0, 0.6),
    }

    @checked
    def __init__(
        self,
        vehicle: VehicleArgument,
        *,
        gain: float = 1.0,
        softening: float = 1.0,
        yaw_rate_gain: float = 0.05,
        dead_time: float | None = None,
        period: float = 0.1,
        limits: LimitsArgument | None = None,
        preview: bool = False,
    ) -> None:
        self.vehicle = vehicle
        self.tuning_names, self.diagnostic_names = kernel.STANLEY_TUNING, kernel.STANLEY_DIAGNOSTICS
        self.memory_size = kernel.MEMORY
        tuning = {
            "gain": gain,
            "softening": softening,
            "yaw_rate_gain": yaw_rate_gain,
            "dead_time": steering_delay(vehicle) if dead_time is None else dead_time,
        }
        super().__init__(tuning, period=period, limits=limits, preview=preview)

    @property
    def name(self) -> str:
        return "Stanley"

    @property
    def function(self) -> Any:
        return kernel.stanley

    def own_parameters(self) -> Array:
        return self._made_by(laws.stanley_parameters, laws.STANLEY)

    def describe(self) -> dict[str, Any]:
        return {**super().describe(), "law": "stanley", "vehicle": self.vehicle.name}

"""Pure pursuit."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

from adaptrack.base.checked import Hint, NotNegative, Positive, checked
from adaptrack.base.errors import InvalidInput
from adaptrack.cars.vehicle import VehicleArgument
from adaptrack.control.controllers.base import Array, CompiledController, TuningBounds
from adaptrack.control.controllers.limits import LimitsArgument
from adaptrack.core.controllers import pure_pursuit as kernel
from adaptrack.core.synthesis import laws


class PurePursuit(CompiledController):
    """Pure pursuit: steer the arc that leads the rear axle to a point of the path ahead.

        delta = atan(2 L sin(alpha)/l_d)

    alpha: angle from the car's axis to the target; l_d: distance from the rear axle to it; L: wheelbase. The target is
    the point of the path that lies max(lookahead_time v, lookahead_min) ahead of the centre of gravity. Tyre slip is
    not modelled. R. C. Coulter, *Implementation of the Pure Pursuit Path Tracking Algorithm*, CMU-RI-TR-92-01, 1992;
    a look-ahead that grows with the speed is common practice.

    Arguments: see `CompiledController`.
    """

    is_exportable = True
    tuning_bounds: Mapping[str, TuningBounds] = {
        "lookahead_time": TuningBounds(0.1, 1.5),
        "lookahead_min": TuningBounds(1.0, 10.0),
    }

    @checked
    def __init__(
        self,
        vehicle: VehicleArgument,
        *,
        lookahead_time: Annotated[NotNegative, "s"] = 0.6,
        lookahead_min: Annotated[Positive, "m", Hint("a standing car has no target else")] = 4.0,
        period: float = 0.1,
        limits: LimitsArgument | None = None,
        preview: bool = False,
    ) -> None:
        self.vehicle = vehicle
        self.tuning_names, self.diagnostic_names = kernel.PURSUIT_TUNING, kernel.PURSUIT_DIAGNOSTICS
        self.memory_size = kernel.MEMORY
        tuning = {"lookahead_time": lookahead_time, "lookahead_min": lookahead_min}
        super().__init__(tuning, period=period, limits=limits, preview=preview)

    def check_tuning(self, tuning: Mapping[str, float]) -> dict[str, float]:
        """See `Controller.check_tuning`; the least distance must be positive."""
        if tuning["lookahead_min"] == 0.0:
            raise InvalidInput("PurePursuit: lookahead_min = 0.0 m: must be positive, or a standing car has no target.")
        return super().check_tuning(tuning)

    @property
    def name(self) -> str:
        return "pure pursuit"

    @property
    def function(self) -> Any:
        return kernel.pure_pursuit

    def own_parameters(self) -> Array:
        return self._made_by(laws.pure_pursuit_parameters, laws.PURSUIT)

    def describe(self) -> dict[str, Any]:
        return {**super().describe(), "law": "pure-pursuit", "vehicle": self.vehicle.name}

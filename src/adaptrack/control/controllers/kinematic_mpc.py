"""Kinematic MPC with steering lag and dead time."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from adaptrack.base.checked import Count, Positive, checked
from adaptrack.base.errors import InvalidInput
from adaptrack.cars.vehicle import Steering, VehicleArgument
from adaptrack.control.controllers.base import FIXED_TUNING, TWO_DECADES, CompiledController, TuningBounds
from adaptrack.control.controllers.limits import LimitsArgument
from adaptrack.control.controllers.setup import ComputationArgument, PeriodArgument, world_and_belief
from adaptrack.core.controllers import kinematic_mpc as kernel
from adaptrack.core.maths.portable import Array
from adaptrack.scenario.profile import Profile

AUTOWARE_WEIGHTS = {
    "lateral_error": 1.0,
    "heading_error": 0.0,
    "heading_error_v2": 0.3,
    "steering": 1.0,
    "steering_v2": 0.25,
    "lateral_jerk": 0.1,
    "steering_rate": 0.0,
    "steering_acceleration": 1e-6,
    "terminal_lateral_error": 1.0,
    "terminal_heading_error": 0.1,
}
"""As Autoware ships them (`lateral_controller_defaults.param.yaml`); units in `core.controllers.kinematic_mpc`."""
CUTOFF = 3.0
"""Hz, of the filter on the command, likewise."""
AUTOWARE_STAGES, AUTOWARE_STAGE_LENGTH = 50, 0.1
"""Stages of the horizon and the length (s) of one, likewise."""
MOST_STAGES = 100


class KinematicMPC(CompiledController):
    """MPC on the kinematic single track with first-order steering lag and dead time, after Autoware.

    The states are the errors of the rear axle and the wheel angle, linearised about the curvature of each stage; the
    measured pose is rolled through the commands on their way. Equations and cost: `core.controllers.kinematic_mpc`;
    what is Autoware's and what is left out: docs/worth.md. Autoware Universe, *MPC Lateral Controller* and *Model
    predictive control algorithm* (documentation of `autoware_mpc_lateral_controller`); J. M. Snider, *Automatic
    Steering Methods for Autonomous Automobile Path Tracking*, CMU-RI-TR-09-08, 2009, section 2.2.

    weights: by name, see `AUTOWARE_WEIGHTS`, those not given as Autoware ships them; cutoff: Hz, of the second-order
    Butterworth filter on the command, 0 for none; stages, step (s): the horizon. profile, belief, computation (s): what
    it knows of steering, sensors and loop, as for `MPC`; period (s), preview, limits: by default the profile's, and
    those of the belief. It does not use the lateral velocity or the yaw rate.

    Raises
    ------
    InvalidInput
        For a weight that is unknown, negative or not finite, weights without any on the steering, or arguments that
        make no controller.
    """

    name, law_name = "kinematic MPC", "kinematic-mpc"
    function = staticmethod(kernel.kinematic_mpc)
    tuning_names, diagnostic_names = kernel.KINEMATIC_TUNING, kernel.KINEMATIC_DIAGNOSTICS
    # of its weights only the ratios to that of the lateral error count
    tuning_bounds: Mapping[str, TuningBounds] = {
        **dict.fromkeys(("lateral_error", "heading_error", "steering_rate", "steering_acceleration"), FIXED_TUNING),
        **dict.fromkeys(("heading_error_v2", "steering", "steering_v2", "lateral_jerk"), TWO_DECADES),
        **dict.fromkeys(("terminal_lateral_error", "terminal_heading_error", "cutoff"), FIXED_TUNING),
    }

    @checked
    def __init__(
        self,
        vehicle: VehicleArgument,
        *,
        cutoff: float = CUTOFF,
        stages: Annotated[Count, Field(le=MOST_STAGES)] = AUTOWARE_STAGES,
        step: Annotated[Positive, "s"] = AUTOWARE_STAGE_LENGTH,
        profile: str | Profile | None = None,
        belief: Steering | None = None,
        computation: ComputationArgument | None = None,
        period: PeriodArgument | None = None,
        limits: LimitsArgument | None = None,
        preview: bool | None = None,
        **weights: float,
    ) -> None:
        self.vehicle = vehicle
        world, period, self.belief = world_and_belief(vehicle, profile, belief, period, computation)
        self.pose_age = 0.0 if profile is None else world.pose_age
        self.stages, self.step_length = stages, step
        tuning = {**_all_weights(weights), "cutoff": cutoff}
        behind = (self.pose_age + self.belief.delay) / period
        self.memory_size = kernel.memory_size(self.stages, behind)
        preview = world.preview if preview is None else preview
        super().__init__(tuning, period=period, limits=limits or self.belief.bounds(period), preview=preview)

    def check_tuning(self, tuning: Mapping[str, float]) -> dict[str, float]:
        """See `Controller.check_tuning`; one of the weights of the steering must be positive."""
        entries = super().check_tuning(tuning)
        if not entries["steering"] + entries["steering_v2"] > 0.0:
            raise InvalidInput(
                "KinematicMPC: steering, steering_v2: one of them must be positive, so that H is definite."
            )
        return entries

    def own_parameters(self) -> Array:
        car, belief = self.vehicle, self.belief
        head = (car.wheelbase, car.lr, belief.lag.value, belief.delay, self.pose_age, self.stages, self.step_length)
        return np.concatenate([head, kernel.limit_rows(self.stages).reshape(-1)])

    def describe(self) -> dict[str, Any]:
        horizon = {"stages": self.stages, "step": self.step_length}
        return super().describe() | {"belief": str(self.belief), "pose_age": self.pose_age} | horizon


def _all_weights(weights: Mapping[str, float]) -> dict[str, float]:
    unknown = [name for name in weights if name not in AUTOWARE_WEIGHTS]
    if unknown:
        raise InvalidInput(
            f"KinematicMPC: {', '.join(unknown)}: no weight of it; known are {', '.join(AUTOWARE_WEIGHTS)}."
        )
    return {**AUTOWARE_WEIGHTS, **weights}

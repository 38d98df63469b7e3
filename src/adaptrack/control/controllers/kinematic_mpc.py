"""Kinematic MPC with steering lag and dead time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from adaptrack.base.checked import Count, Positive, checked
from adaptrack.base.errors import InvalidInput
from adaptrack.cars.vehicle import Steering, VehicleArgument
from adaptrack.control.controllers.base import FIXED_TUNING, TWO_DECADES, Array, CompiledController, TuningBounds
from adaptrack.control.controllers.limits import LimitsArgument
from adaptrack.control.controllers.setup import LoopSetup
from adaptrack.control.qp import QP
from adaptrack.core.controllers import kinematic_mpc as kernel
from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import product
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
        computation: float | None = None,
        period: float | None = None,
        limits: LimitsArgument | None = None,
        preview: bool | None = None,
        **weights: float,
    ) -> None:
        self.vehicle = vehicle
        setup = LoopSetup.of("KinematicMPC", vehicle, profile, belief, period, preview, limits, computation)
        self.belief, self.pose_age = setup.belief, setup.pose_age
        self.stages, self.step_length = stages, step
        tuning = {**_all_weights(weights), "cutoff": cutoff}
        behind = (self.pose_age + self.belief.delay) / setup.period
        self.memory_size = kernel.memory_size(self.stages, behind)
        super().__init__(tuning, period=setup.period, limits=setup.limits, preview=setup.preview)

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

    def problem(
        self, state: Sequence[float], speeds: Array, curvatures: Array, inputs: tuple[float, float] = (0.0, 0.0)
    ) -> QP:
        """The quadratic programme of a step, densely and slowly: what the compiled law solves.

        state: [e (m), theta (rad), delta (rad)] at the end of the dead time; speeds (m/s), curvatures (1/m): of the
        stages; inputs: those of the last two steps (rad), the latest first.
        """
        E, K = self._tracking(np.array(state, dtype=float), speeds, curvatures)
        for rows, constant, weights in self._changes(np.asarray(speeds, dtype=float), *inputs):
            E += product(rows.T, weights[:, None] * rows)
            K += product(rows.T, weights * constant)
        return QP((E + E.T) / 2.0, K, *self._rows(inputs[0]))

    def _tracking(self, x: Array, speeds: Array, curvatures: Array) -> tuple[Array, Array]:
        """Hessian and gradient of what errors and inputs cost."""
        n, t = self.stages, self.tuning
        into, E, K = np.zeros((3, n)), np.zeros((n, n)), np.zeros(n)  # into: what the inputs add to the state
        car = self.vehicle.wheelbase, self.belief.lag.value
        for i, (v, curvature) in enumerate(zip(speeds, curvatures, strict=True)):
            A, B, w, steady = kinematic_model(*car, v, curvature, self.step_length, self.limits.angle)
            x, into = product(A, x) + w, product(A, into)
            into[:, i] += B
            end = "terminal_" if i == n - 1 else ""
            heading = t[f"{end}heading_error"] + t["heading_error_v2"] * (v * v)
            Q = np.diag([t[f"{end}lateral_error"], heading, 0.0])
            E += product(product(into.T, Q), into)
            K += product(product(into.T, Q), x)
            weight = t["steering"] + t["steering_v2"] * (v * v)
            E[i, i] += weight
            K[i] -= weight * steady
        return E, K

    def _changes(self, speeds: Array, before: float, earlier: float) -> list[tuple[Array, Array, Array]]:
        """First and second differences of the inputs over time, D u + d, and their weights: D, d, weights."""
        n, t, h = self.stages, self.tuning, self.step_length
        durations = np.full(n, h)
        durations[0] = self.period  # the first input comes a control period after the last one
        rate, constant = (np.eye(n) - np.eye(n, k=-1)) / durations[:, None], np.zeros(n)
        constant[0] = -before / self.period
        bend = (rate - np.vstack([np.zeros(n), rate[:-1]])) / durations[:, None]
        bent = (constant - np.concatenate([[(before - earlier) / self.period], constant[:-1]])) / durations
        weights = np.full(n, t["steering_rate"])
        weights[1:] += t["lateral_jerk"] * portable.square(speeds[:-1])
        return [(rate, constant, weights), (bend, bent, np.full(n, t["steering_acceleration"]))]

    def _rows(self, before: float) -> tuple[Array, Array]:
        """M and gamma of the limits on the inputs and on their changes."""
        n, (low, high) = self.stages, self.limits.angle
        change, share, first = np.eye(n) - np.eye(n, k=-1), np.full(n, self.step_length / self.period), np.zeros(n)
        share[0], first[0] = 1.0, before
        least, most = (np.array(self.limits.move)[:, None] * share) + first
        M = np.vstack([np.eye(n), -np.eye(n), change, -change])
        return M, np.concatenate([np.full(n, high), np.full(n, -low), most, -least])

    def describe(self) -> dict[str, Any]:
        horizon = {"stages": self.stages, "step": self.step_length}
        return super().describe() | {"belief": str(self.belief), "pose_age": self.pose_age} | horizon


def kinematic_model(
    wheelbase: float, lag: float, speed: float, curvature: float, time: float, angles: tuple[float, float]
) -> tuple[Array, Array, Array, float]:
    """A (3, 3), B (3,), w (3,) of x' = A x + B u + w for x = [e, theta, delta], and delta_r (rad).

    Over a time (s) with the input held, linearised about delta_r = atan(L kappa), within the angles (rad).
    """
    steady = float(np.clip(portable.atan(wheelbase * curvature), *angles))
    slope = 1.0 / portable.square(portable.cos(steady))
    block = np.zeros((5, 5))
    block[0, 1] = speed
    block[1, 2] = speed / wheelbase * slope
    block[1, 4] = speed / wheelbase * (portable.tan(steady) - steady * slope) - speed * curvature
    if lag > 0.0:
        block[2, 2], block[2, 3] = -1.0 / lag, 1.0 / lag
    else:  # the wheels are where the input is
        block[1, 3], block[1, 2] = block[1, 2], 0.0
    moved = portable.exponential_of(block * time)
    A, B, w = moved[:3, :3], moved[:3, 3], moved[:3, 4]
    if lag == 0.0:
        A[2, 2], B[2] = 0.0, 1.0
    return A, B, w, steady


def _all_weights(weights: Mapping[str, float]) -> dict[str, float]:
    unknown = [name for name in weights if name not in AUTOWARE_WEIGHTS]
    if unknown:
        raise InvalidInput(
            f"KinematicMPC: {', '.join(unknown)}: no weight of it; known are {', '.join(AUTOWARE_WEIGHTS)}."
        )
    return {**AUTOWARE_WEIGHTS, **weights}

"""Optimal preview control: LQR whose gains see the curvature ahead."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from adaptrack.base.checked import checked, real
from adaptrack.base.errors import InvalidInput
from adaptrack.cars.vehicle import Steering, Vehicle, VehicleArgument
from adaptrack.control.controllers.base import FIXED_TUNING, TWO_DECADES, CompiledController, TuningBounds
from adaptrack.control.controllers.laws import GAIN_SPEEDS, WEIGHT_FACTORS, WEIGHTS_TOO_FAR_APART
from adaptrack.control.controllers.limits import LimitsArgument
from adaptrack.control.controllers.setup import ComputationArgument, PeriodArgument, world_and_belief
from adaptrack.control.models import PathModel
from adaptrack.core.controllers import preview_lqr as kernel
from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import Array, product
from adaptrack.core.synthesis import laws
from adaptrack.scenario.profile import Profile

CURVATURE_PREVIEW = 3.0
"""s, how far ahead of the end of the dead time the curvature counts."""


class PreviewLQR(CompiledController):
    """Linear-quadratic regulator with optimal preview of the curvature, on the path model with steering lag.

    Where `LQR` adds the steering of the steady turn, this one knows how the car gets there: gains on every coming
    change of the curvature follow from the same Riccati equation as those on the state, which is rolled through the
    commands on their way. Equations and sources: `core.controllers.preview_lqr`. On a bend that goes on it steers
    the steady turn of the linear car.

    q_e: 1/m^2, weight of the offset; q_heading: 1/rad^2, of the heading against that of the steady turn; r: 1/rad^2,
    of the steering beyond the steady turn's; all positive. ahead: s, how far the curvature is known. profile, belief,
    computation (s): what it knows of steering, sensors and loop, as for `MPC`; period (s), preview, limits: by default
    the profile's, and those of the belief. A lateral velocity that is not measured counts as 0.

    Raises
    ------
    InvalidInput
        For a weight that is not positive and finite, or arguments that make no controller.
    """

    name, law_name = "preview LQR", "preview-lqr"
    function = staticmethod(kernel.preview_lqr)
    diagnostic_names = kernel.PREVIEW_DIAGNOSTICS
    positive: ClassVar[tuple[str, ...]] = ("q_e", "q_heading", "r")
    tuning_bounds: Mapping[str, TuningBounds] = {
        "q_e": TWO_DECADES,
        "q_heading": TWO_DECADES,
        "r": FIXED_TUNING,
    }  # only the ratios to r count

    @checked
    def __init__(
        self,
        vehicle: VehicleArgument,
        *,
        q_e: float = 1.0,
        q_heading: float = 100.0,
        r: float = 100.0,
        ahead: float = CURVATURE_PREVIEW,
        profile: str | Profile | None = None,
        belief: Steering | None = None,
        computation: ComputationArgument | None = None,
        period: PeriodArgument | None = None,
        limits: LimitsArgument | None = None,
        preview: bool | None = None,
    ) -> None:
        self.vehicle = vehicle
        world, period, self.belief = world_and_belief(vehicle, profile, belief, period, computation)
        self.pose_age = 0.0 if profile is None else world.pose_age
        if not period <= real("PreviewLQR", "ahead", ahead) <= 10.0:
            raise InvalidInput(f"PreviewLQR: ahead = {ahead!r} s: must be from a control period to 10.")
        self.previewed = round(ahead / period)
        self._model = PathModel(vehicle, period, self.belief.lag.value)
        behind = self.belief.delay / period
        self.memory_size = kernel.memory_size(self._model.n, self.previewed, behind)
        tuning = {"q_e": q_e, "q_heading": q_heading, "r": r}
        preview = world.preview if preview is None else preview
        super().__init__(tuning, period=period, limits=limits or self.belief.bounds(period), preview=preview)

    def own_parameters(self) -> Array:
        car, t, belief = self.vehicle, self.tuning, self.belief
        e, heading, steps = t["q_e"] / t["r"], t["q_heading"] / t["r"], portable.log(WEIGHT_FACTORS)
        head = (
            car.wheelbase, car.lr, car.understeer_gradient, car.rear_slip_gradient,
            belief.lag.value, belief.delay, self.pose_age, self.previewed, portable.log(GAIN_SPEEDS[0]),
            portable.log(GAIN_SPEEDS[-1] / GAIN_SPEEDS[0]) / (len(GAIN_SPEEDS) - 1), len(GAIN_SPEEDS),
            portable.log(e) + steps[0], portable.log(heading) + steps[0], steps[1] - steps[0], len(steps),
        )  # fmt: skip
        grid = _grid(self._model, self.previewed, e, heading)
        return np.concatenate([head, self._model.parameters(), grid.reshape(-1)])

    def describe(self) -> dict[str, Any]:
        loop = {"belief": str(self.belief), "pose_age": self.pose_age}
        return super().describe() | loop | {"previewed": self.previewed}


def steady_turn(vehicle: Vehicle, speed: float, n: int) -> tuple[Array, float]:
    """X (n,) and U: the path model's state in the steady turn, and its steering (rad), for curvature times speed 1.

    Rajamani, *Vehicle Dynamics and Control*, 2nd ed., eqs. (3.12)-(3.15). n: 5 with the wheel angle as a state, else 4.
    """
    heading = vehicle.rear_slip_gradient * speed - vehicle.lr / speed
    steering = vehicle.wheelbase / speed + vehicle.understeer_gradient * speed
    return np.array([-speed * heading, heading, 1.0, *([steering] if n == 5 else []), 0.0]), steering


def preview_gains(A: Array, B: Array, X: Array, q_e: ArrayLike, q_heading: ArrayLike, count: int) -> Array:
    """(..., n + count): -K, then g_0, g_1, ..., see `core.controllers.preview_lqr`, with r = 1.

    A (..., n, n), B and X (..., n) of the path model, the heading its second state and the offset its last; weights for
    every model. Raises InvalidInput when the weights are further apart than float64 can tell.
    """
    n, Q, P, K = B.shape[-1], np.zeros(A.shape), np.empty(A.shape), np.empty(B.shape)
    Q[..., 1, 1], Q[..., -1, -1] = q_heading, q_e
    work = np.empty(6 * n * n)
    with np.errstate(all="ignore"):  # of the interpreted kernel: what overflows is answered by a status
        for i in np.ndindex(B.shape[:-1]):
            if laws.riccati(A[i], B[i], Q[i], P[i], work) == 0:
                raise InvalidInput(WEIGHTS_TOO_FAR_APART)
            laws.lqr_feedback(A[i], B[i], P[i], K[i])
    closed = A - B[..., :, None] * K[..., None, :]
    gains = np.empty((*K.shape[:-1], n + count))
    gains[..., :n] = -K
    column, later = B[..., None], product(P, X[..., None])
    denominator = 1.0 + (column * product(P, column)).sum(axis=-2)[..., 0]
    for j in range(count):
        gains[..., n + j] = (column * later).sum(axis=-2)[..., 0] / denominator
        later = product(np.moveaxis(closed, -1, -2), later)
    return gains


@lru_cache(maxsize=64)
def _grid(model: PathModel, previewed: int, q_e: float, q_heading: float) -> Array:
    """Gains (speeds, weights, weights, n + previewed)."""
    k, n = len(WEIGHT_FACTORS), model.n
    models = [model.discrete(speed) for speed in GAIN_SPEEDS]
    turns = [steady_turn(model.vehicle, speed, n)[0] for speed in GAIN_SPEEDS]
    A = np.broadcast_to(np.array([A for A, _, _ in models])[:, None, None], (len(GAIN_SPEEDS), k, k, n, n))
    B = np.broadcast_to(np.array([B[:, 0] for _, B, _ in models])[:, None, None], (len(GAIN_SPEEDS), k, k, n))
    X = np.broadcast_to(np.array(turns)[:, None, None], B.shape)
    return preview_gains(A, B, X, q_e * WEIGHT_FACTORS[:, None], q_heading * WEIGHT_FACTORS, previewed)

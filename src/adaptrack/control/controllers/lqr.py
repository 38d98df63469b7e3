"""LQR with curvature feed-forward."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import lru_cache
from typing import Annotated, Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from adaptrack.base.checked import Positive, checked
from adaptrack.base.errors import InvalidInput
from adaptrack.cars.vehicle import Vehicle
from adaptrack.control.controllers.base import (
    DECADES,
    FIXED,
    Array,
    Bounds,
    CompiledController,
    known_vehicle,
    steering_delay,
)
from adaptrack.control.controllers.limits import Limits
from adaptrack.core.controllers import lqr as kernel

SPEEDS = np.geomspace(1.0, 60.0, 21)
"""m/s, where gains are computed; between them they are interpolated over log v."""
WEIGHT_FACTORS = 10.0 ** np.arange(-2.0, 2.25, 0.5)
"""Of q_e/r and q_heading/r, about the controller's own: where gains are computed for weights that change."""

MOST_DOUBLINGS = 60


class LQR(CompiledController):
    """Linear-quadratic regulator about the steady turn of the path, with curvature feed-forward.

    With the lateral errors x = [e, v_y + v psi_e, psi_e, r - v kappa] of `error_model`, the steering is

        delta = (L + K v^2) kappa - gain (x - x_ss),   x_ss = [0, 0, (m l_f v^2/(2 C_r L) - l_r) kappa, 0]

    L: wheelbase; K: understeer gradient; kappa: curvature of the path; x_ss: the errors of the steady turn, in which
    the car's heading differs from the path's. gain minimises sum q_e e^2 + q_heading psi_e^2 + r delta^2 for the model
    sampled at the control period. R. Rajamani, *Vehicle Dynamics and Control*, 2nd ed., eqs. (2.45), (3.12)-(3.15).
    Lag and dead time of the steering are not part of the model; the feed-forward looks `preview_time` ahead for them.

    q_e, q_heading, r: only their ratios count; preview_time: s, None for the lag and dead time of the
    vehicle's steering (0.2 s where nothing is known); the rest: see `CompiledController`.
    """

    # only the ratios to r count; gains are tabulated over two decades to either side of its own
    positive: ClassVar[tuple[str, ...]] = ("q_e", "q_heading", "r")
    tuning_bounds: Mapping[str, Bounds] = {
        "q_e": DECADES,
        "q_heading": DECADES,
        "r": FIXED,
        "preview_time": Bounds(0.0, 0.6),
    }

    @checked
    def __init__(
        self,
        vehicle: Vehicle,
        *,
        q_e: Annotated[Positive, "1/m^2"] = 1.0,
        q_heading: Annotated[Positive, "1/rad^2"] = 100.0,
        r: Annotated[Positive, "1/rad^2"] = 1000.0,
        preview_time: float | None = None,
        period: float = 0.1,
        limits: Limits | None = None,
        preview: bool = False,
    ) -> None:
        self.vehicle = known_vehicle("LQR", vehicle)
        self.tuning_names, self.diagnostic_names = kernel.TUNING, kernel.DIAGNOSTICS
        self.memory_size = kernel.MEMORY
        tuning = {
            "q_e": q_e,
            "q_heading": q_heading,
            "r": r,
            "preview_time": steering_delay(vehicle) if preview_time is None else preview_time,
        }
        super().__init__(tuning, period=period, limits=limits, preview=preview)

    @property
    def name(self) -> str:
        return "LQR with curvature feed-forward"

    @property
    def function(self) -> Any:
        return kernel.lqr

    def own_parameters(self) -> Array:
        car, t = self.vehicle, self.tuning
        e, heading = t["q_e"] / t["r"], t["q_heading"] / t["r"]
        steps = np.log(WEIGHT_FACTORS)
        head = (
            car.wheelbase,
            car.lr,
            car.understeer_gradient,
            car.mass * car.lf / (2.0 * car.stiffness_rear * car.wheelbase),
            math.log(SPEEDS[0]),
            math.log(SPEEDS[-1] / SPEEDS[0]) / (len(SPEEDS) - 1),
            len(SPEEDS),
            math.log(e) + steps[0],
            math.log(heading) + steps[0],
            steps[1] - steps[0],
            len(steps),
        )
        return np.concatenate([head, _grid(car, self.period, e, heading).reshape(-1)])

    def gain_at(self, speed: float) -> Array:
        """The feedback gain (4,) of the controller's own weights at a speed (m/s), not interpolated."""
        A, B = sampled_error_model(self.vehicle, self.period, speed)
        return lqr_gain(A, B, self.tuning["q_e"] / self.tuning["r"], self.tuning["q_heading"] / self.tuning["r"])

    def describe(self) -> dict[str, Any]:
        return {**super().describe(), "law": "lqr", "vehicle": self.vehicle.name}


def error_model(vehicle: Vehicle, speed: float) -> tuple[Array, Array]:
    """A (4, 4) and B (4,) of dx/dt = A x + B delta for x = [e, de/dt, psi_e, dpsi_e/dt] on a straight path.

    e: m, to the left of the path; psi_e: rad, the car's heading less the path's; delta: rad; speed: v (m/s).
    Rajamani, *Vehicle Dynamics and Control*, 2nd ed., eq. (2.45).
    """
    m, inertia, lf, lr = vehicle.mass, vehicle.yaw_inertia, vehicle.lf, vehicle.lr
    front, rear = 2.0 * vehicle.stiffness_front, 2.0 * vehicle.stiffness_rear
    both, moment, turning = front + rear, front * lf - rear * lr, front * lf**2 + rear * lr**2
    A = np.array(
        [
            [0.0, 1.0, 0.0, 0.0],
            [0.0, -both / (m * speed), both / m, -moment / (m * speed)],
            [0.0, 0.0, 0.0, 1.0],
            [0.0, -moment / (inertia * speed), moment / inertia, -turning / (inertia * speed)],
        ]
    )
    return A, np.array([0.0, front / m, 0.0, front * lf / inertia])


def sampled_error_model(vehicle: Vehicle, period: float, speed: float) -> tuple[Array, Array]:
    """`error_model` over one period (s) with the steering held."""
    from scipy.linalg import expm

    block = np.zeros((5, 5))
    block[:4, :4], block[:4, 4] = error_model(vehicle, speed)
    sampled = expm(block * period)
    return sampled[:4, :4], sampled[:4, 4]


def lqr_gain(A: Array, B: Array, q_e: ArrayLike, q_heading: ArrayLike) -> Array:
    """The gains (..., 4) that minimise sum q_e e^2 + q_heading psi_e^2 + delta^2 for x' = A x + B delta.

    A (..., 4, 4) and B (..., 4), one weight of each kind for every model; errors as of `riccati`.
    """
    A, B = np.asarray(A, dtype=float), np.asarray(B, dtype=float)
    Q = np.zeros_like(A)
    Q[..., 0, 0], Q[..., 2, 2] = q_e, q_heading
    return feedback(A, B, riccati(A, B, Q))


def riccati(A: Array, B: Array, Q: Array) -> Array:
    """P (..., n, n) of the discrete algebraic Riccati equation of x' = A x + B u with the cost sum x'Q x + u^2.

    A, Q (..., n, n), B (..., n). By doubling (E. K.-W. Chu, H.-Y. Fan, W.-W. Lin, C.-S. Wang, *Structure-preserving
    algorithms for periodic discrete-time algebraic Riccati equations*, Int. J. Control 77, 2004).

    Raises
    ------
    InvalidInput
        When the iteration does not converge: weights further apart than float64 can tell.
    """
    F, G, P = A, B[..., :, None] * B[..., None, :], Q.copy()
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(MOST_DOUBLINGS):
            W = np.eye(A.shape[-1]) + G @ P
            step = np.linalg.solve(W, F)
            turned = np.swapaxes(F, -1, -2)
            change = turned @ P @ step
            G, P, F = G + F @ np.linalg.solve(W, G) @ turned, P + change, F @ step
            if np.all(np.abs(change).max((-1, -2)) <= 1e-14 * np.abs(P).max((-1, -2))):
                return P
    raise InvalidInput("LQR: no gain for weights (over r) so far apart: bring q_e, q_heading and r nearer.")


def feedback(A: Array, B: Array, P: Array) -> Array:
    """The gains (..., n), (1 + B'PB)^-1 B'PA."""
    BP = np.einsum("...i,...ij->...j", B, P)
    return np.einsum("...i,...ij->...j", BP, A) / (1.0 + np.einsum("...i,...i->...", BP, B))[..., None]


@lru_cache(maxsize=64)
def _grid(vehicle: Vehicle, period: float, q_e: float, q_heading: float) -> Array:
    """Gains (speeds, weights, weights, 4)."""
    n = len(WEIGHT_FACTORS)
    models = [sampled_error_model(vehicle, period, speed) for speed in SPEEDS]
    A = np.broadcast_to(np.array([A for A, _ in models])[:, None, None], (len(SPEEDS), n, n, 4, 4))
    B = np.broadcast_to(np.array([B for _, B in models])[:, None, None], (len(SPEEDS), n, n, 4))
    return lqr_gain(A, B, q_e * WEIGHT_FACTORS[:, None], q_heading * WEIGHT_FACTORS)

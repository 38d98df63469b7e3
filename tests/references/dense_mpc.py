"""The quadratic programmes of both MPCs from dense matrices, one equation a function: what the kernels condense."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.linalg import expm, solve_discrete_are, toeplitz

from adaptrack.control.controllers.kinematic_mpc import KinematicMPC
from adaptrack.control.controllers.laws import LQR
from adaptrack.control.controllers.preview_lqr import PreviewLQR, preview_gains, steady_turn
from adaptrack.control.models import PredictionModel
from adaptrack.control.qp import QP
from adaptrack.core.synthesis import laws

Array = npt.NDArray[np.float64]


# -- the paper's MPC ---------------------------------------------------------------------------------------------------
def prediction(model: PredictionModel, speed: float, Np: int, Nc: int) -> tuple[Array, Array]:
    """Eq. (10): F (Np, n+1) and Phi (Np, Nc) with Y = F x~ + Phi dU, rows being the outputs at k+1 .. k+Np.

    By eq. (9), whose state x~ (n+1,) is the change of x, and y.
    """
    a, b, c = model.discrete(speed)
    a, b = np.block([[a, np.zeros((model.n, 1))], [c @ a, np.eye(1)]]), np.vstack([b, c @ b])
    row, free, response = np.eye(model.n + 1)[-1:], np.empty((Np, model.n + 1)), np.empty(Np)
    for i in range(Np):
        response[i] = (row @ b).item()  # C~ A~^i B~
        row = row @ a
        free[i] = row
    return free, toeplitz(response, np.zeros(Nc))


def cost(reference: Array, outputs: Array, moves: Array, Q: float, R: float) -> float:
    """Eq. (11): J = (R_s - Y)' Q (R_s - Y) + dU' R dU, with scalar weights."""
    error = reference - outputs
    return float(Q * error @ error + R * moves @ moves)


def quadratic(
    model: PredictionModel, speed: float, x: Array, reference: Array, Np: int, Nc: int, Q: float, R: float
) -> tuple[Array, Array]:
    """Eq. (17) of the cost: E = 2(Phi' Q Phi + R) and K = -2 Phi' Q (R_s - F x~), shapes (Nc, Nc) and (Nc,).

    x: x~ = [change of x (n), y], shape (n+1,); reference: R_s, shape (Np,); moves: the Nc pulses of eq. (10).
    """
    free, phi = prediction(model, speed, Np, Nc)
    return 2 * (Q * phi.T @ phi + R * np.eye(Nc)), -2 * Q * phi.T @ (reference - free @ x)


def limit_matrix(Nc: int) -> Array:
    """M of eq. (16) for limits on moves and angle, shape (4 Nc, Nc).

    Four rows a sample: the move, its negative, the angle (the sum of moves so far), its negative.
    """
    move, angle = np.eye(Nc), np.tri(Nc)
    return np.stack([move, -move, angle, -angle], axis=1).reshape(4 * Nc, Nc)


def limit_bounds(Nc: int, angle: float, limits: Any) -> Array:
    """gamma of eq. (16) in the order of `limit_matrix`, shape (4 Nc,); angle: u(k-1) (rad); limits: a `Limits`."""
    (low, high), (least, most) = limits.move, limits.angle
    return np.tile([high, -low, most - angle, angle - least], Nc)


# -- gains of the LQR controllers --------------------------------------------------------------------------------------
def lqr_gain_at(controller: LQR, speed: float) -> Array:
    """The feedback gain (4,) of the controller's own weights at a speed (m/s), not interpolated."""
    A, B, tuning = np.zeros((4, 4)), np.zeros(4), controller.tuning
    laws.sampled_error_model(controller.vehicle.numbers, controller.period, speed, A, B)
    Q = np.diag([tuning["q_e"], 0.0, tuning["q_heading"], 0.0]) / tuning["r"]
    P = solve_discrete_are(A, B[:, None], Q, np.eye(1))
    return B @ P @ A / (1.0 + B @ P @ B)


def preview_gains_at(controller: PreviewLQR, speed: float) -> Array:
    """The gains (n + previewed,) of the controller's own weights at a speed (m/s), not interpolated.

    On the deviation of the state from the steady turn (with its sign in the steering), then on the changes of
    curvature times speed (rad/s) from each period to the next.
    """
    A, B, _ = controller._model.discrete(speed)
    X, _ = steady_turn(controller.vehicle, speed, len(A))
    tuning = controller.tuning
    return preview_gains(
        A, B[:, 0].copy(), X, tuning["q_e"] / tuning["r"], tuning["q_heading"] / tuning["r"], controller.previewed
    )


# -- the kinematic MPC -------------------------------------------------------------------------------------------------
def kinematic_problem(
    controller: KinematicMPC, state: Sequence[float], speeds: Array, curvatures: Array,
    inputs: tuple[float, float] = (0.0, 0.0),
) -> QP:  # fmt: skip
    """The quadratic programme of a step.

    state: [e (m), theta (rad), delta (rad)] at the end of the dead time; speeds (m/s), curvatures (1/m): of the
    stages; inputs: those of the last two steps (rad), the latest first.
    """
    E, K = _tracking(controller, np.array(state, dtype=float), speeds, curvatures)
    for rows, constant, weights in _changes(controller, np.asarray(speeds, dtype=float), *inputs):
        E += rows.T @ (weights[:, None] * rows)
        K += rows.T @ (weights * constant)
    return QP((E + E.T) / 2.0, K, *_rows(controller, inputs[0]))


def _tracking(controller: KinematicMPC, x: Array, speeds: Array, curvatures: Array) -> tuple[Array, Array]:
    """Hessian and gradient of what errors and inputs cost."""
    n, t = controller.stages, controller.tuning
    into, E, K = np.zeros((3, n)), np.zeros((n, n)), np.zeros(n)  # into: what the inputs add to the state
    car = controller.vehicle.wheelbase, controller.belief.lag.value
    for i, (v, curvature) in enumerate(zip(speeds, curvatures, strict=True)):
        A, B, w, steady = kinematic_model(*car, v, curvature, controller.step_length, controller.limits.angle)
        x, into = A @ x + w, A @ into
        into[:, i] += B
        end = "terminal_" if i == n - 1 else ""
        heading = t[f"{end}heading_error"] + t["heading_error_v2"] * v * v
        Q = np.diag([t[f"{end}lateral_error"], heading, 0.0])
        E += into.T @ Q @ into
        K += into.T @ Q @ x
        weight = t["steering"] + t["steering_v2"] * v * v
        E[i, i] += weight
        K[i] -= weight * steady
    return E, K


def _changes(
    controller: KinematicMPC, speeds: Array, before: float, earlier: float
) -> list[tuple[Array, Array, Array]]:
    """First and second differences of the inputs over time, D u + d, and their weights: D, d, weights."""
    n, t, period = controller.stages, controller.tuning, controller.period
    durations = np.full(n, controller.step_length)
    durations[0] = period  # the first input comes a control period after the last one
    rate, constant = (np.eye(n) - np.eye(n, k=-1)) / durations[:, None], np.zeros(n)
    constant[0] = -before / period
    bend = (rate - np.vstack([np.zeros(n), rate[:-1]])) / durations[:, None]
    bent = (constant - np.concatenate([[(before - earlier) / period], constant[:-1]])) / durations
    weights = np.full(n, t["steering_rate"])
    weights[1:] += t["lateral_jerk"] * speeds[:-1] ** 2
    return [(rate, constant, weights), (bend, bent, np.full(n, t["steering_acceleration"]))]


def _rows(controller: KinematicMPC, before: float) -> tuple[Array, Array]:
    """M and gamma of the limits on the inputs and on their changes."""
    n, (low, high) = controller.stages, controller.limits.angle
    change, first = np.eye(n) - np.eye(n, k=-1), np.zeros(n)
    share = np.full(n, controller.step_length / controller.period)
    share[0], first[0] = 1.0, before
    least, most = (np.array(controller.limits.move)[:, None] * share) + first
    M = np.vstack([np.eye(n), -np.eye(n), change, -change])
    return M, np.concatenate([np.full(n, high), np.full(n, -low), most, -least])


def kinematic_model(
    wheelbase: float, lag: float, speed: float, curvature: float, time: float, angles: tuple[float, float]
) -> tuple[Array, Array, Array, float]:
    """A (3, 3), B (3,), w (3,) of x' = A x + B u + w for x = [e, theta, delta], and delta_r (rad).

    Over a time (s) with the input held, linearised about delta_r = atan(L kappa), within the angles (rad).
    """
    steady = float(np.clip(np.arctan(wheelbase * curvature), *angles))
    slope = 1.0 / np.cos(steady) ** 2
    block = np.zeros((5, 5))
    block[0, 1] = speed
    block[1, 2] = speed / wheelbase * slope
    block[1, 4] = speed / wheelbase * (np.tan(steady) - steady * slope) - speed * curvature
    if lag > 0.0:
        block[2, 2], block[2, 3] = -1.0 / lag, 1.0 / lag
    else:  # the wheels are where the input is
        block[1, 3], block[1, 2] = block[1, 2], 0.0
    moved = expm(block * time)
    A, B, w = moved[:3, :3], moved[:3, 3], moved[:3, 4]
    if lag == 0.0:
        A[2, 2], B[2] = 0.0, 1.0
    return A, B, w, steady

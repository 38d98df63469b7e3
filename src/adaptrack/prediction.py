"""The prediction model of the MPC, one equation of the paper per method.

This is the readable form: matrices of NumPy, any horizons, nothing cached. The controller runs the compiled form in
`kernels.prediction`; a test demands that both give the same QP.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from adaptrack.errors import InvalidInput, real
from adaptrack.vehicle import Vehicle

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PredictionModel:
    """Linear single-track model in x_c = [v_y, yaw, yaw rate, y], re-discretised at each speed.

    vehicle: mass, inertia, axle distances and cornering stiffness per tyre; period: control period Ts (s).
    Heading is taken as small: dy/dt = v_y + v_x yaw (the paper's A_c), while the plant uses eq. (5).

    Raises
    ------
    InvalidInput
        When the period, a speed or a horizon is not positive and finite.
    """

    vehicle: Vehicle
    period: float = 0.1

    def __post_init__(self) -> None:
        if not 0.0 < real("PredictionModel", "period", self.period) < np.inf:
            raise InvalidInput(f"period = {self.period!r} s: must be positive and finite.")

    def packed(self) -> Array:
        """The parameters in the order of `kernels.prediction.MODEL_PARAMETERS`, shape (6,)."""
        from adaptrack.kernels.prediction import MODEL_PARAMETERS

        return np.array([getattr(self.vehicle, name) for name in MODEL_PARAMETERS], dtype=float)

    def continuous(self, speed: float) -> tuple[Array, Array, Array]:
        """Eq. (7): A_c (4, 4), B_c (4, 1), C_c (1, 4) at a longitudinal speed (m/s)."""
        if not 0.0 < speed < np.inf:
            raise InvalidInput(
                f"speed = {speed!r} m/s: must be positive and finite, A_c of eq. (7) is singular at standstill; "
                "the controller floors the speed (MPC(speed_floor=...))."
            )
        v = self.vehicle
        cf, cr = 2 * v.stiffness_front, 2 * v.stiffness_rear
        a = np.array(
            [
                [-(cf + cr) / (v.mass * speed), 0, -speed - (cf * v.lf - cr * v.lr) / (v.mass * speed), 0],
                [0, 0, 1, 0],
                [
                    -(cf * v.lf - cr * v.lr) / (v.yaw_inertia * speed),
                    0,
                    -(cf * v.lf**2 + cr * v.lr**2) / (v.yaw_inertia * speed),
                    0,
                ],
                [1, speed, 0, 0],
            ]
        )
        b = np.array([[cf / v.mass], [0], [cf * v.lf / v.yaw_inertia], [0]])
        return a, b, np.array([[0.0, 0.0, 0.0, 1.0]])

    def discrete(self, speed: float) -> tuple[Array, Array, Array]:
        """Eq. (8): A_k (4, 4), B (4, 1), C (1, 4), exact under zero-order hold over the period."""
        from adaptrack.kernels.prediction import discretise

        self.continuous(speed)  # refuses a bad speed
        a, b = np.empty((4, 4)), np.empty(4)
        discretise(speed, self.period, self.packed(), a, b)
        return a, b[:, None], np.array([[0.0, 0.0, 0.0, 1.0]])

    def augmented(self, speed: float) -> tuple[Array, Array, Array]:
        """Eq. (9): A~ (5, 5), B~ (5, 1), C~ (1, 5) in x~ = [change of x_c, y], with the move as input."""
        a, b, c = self.discrete(speed)
        return (
            np.block([[a, np.zeros((4, 1))], [c @ a, np.eye(1)]]),
            np.vstack([b, c @ b]),
            np.hstack([np.zeros((1, 4)), np.eye(1)]),
        )

    def prediction(self, speed: float, Np: int, Nc: int) -> tuple[Array, Array]:
        """Eq. (10): F (Np, 5) and Phi (Np, Nc) with Y = F x~ + Phi dU, rows being the outputs at k+1 .. k+Np."""
        if not 1 <= Nc <= Np:
            raise InvalidInput(f"Np = {Np}, Nc = {Nc}: need 1 <= Nc <= Np.")
        a, b, c = self.augmented(speed)
        free, phi = np.empty((Np, 5)), np.zeros((Np, Nc))
        row = c
        for i in range(Np):
            response = (row @ b).item()  # C~ A~^i B~
            for j in range(min(Nc, Np - i)):
                phi[i + j, j] = response
            row = row @ a
            free[i] = row
        return free, phi

    def cost(self, reference: ArrayLike, outputs: ArrayLike, moves: ArrayLike, Q: float, R: float) -> float:
        """Eq. (11): J = (R_s - Y)' Q (R_s - Y) + dU' R dU, with scalar weights."""
        error = np.asarray(reference, float) - np.asarray(outputs, float)
        change = np.asarray(moves, float)
        return float(Q * error @ error + R * change @ change)

    def quadratic(
        self,
        speed: float,
        x: ArrayLike,
        reference: ArrayLike,
        Np: int,
        Nc: int,
        Q: float,
        R: float,
        basis: ArrayLike | None = None,
    ) -> tuple[Array, Array]:
        """Eq. (17) of the cost: E = 2(Phi' Q Phi + R) and K = -2 Phi' Q (R_s - F x~), shapes (n, n) and (n,).

        x: x~ = [change of x_c (4), y], shape (5,); reference: R_s, shape (Np,); basis: L (Np, n) of moves
        dU = L eta over the whole horizon, by default the Nc pulses of eq. (10). R weighs eta.
        """
        free, phi = self._response(speed, Np, Nc, basis)
        error = np.asarray(reference, float) - free @ np.asarray(x, float)
        return 2 * (Q * phi.T @ phi + R * np.eye(phi.shape[1])), -2 * Q * phi.T @ error

    def feedback(
        self, speed: float, Np: int, Nc: int, Q: float, R: float, basis: ArrayLike | None = None
    ) -> tuple[Array, Array]:
        """The control law far from all limits: du = k_r R_s - k_x x~, shapes (Np,) and (5,); arguments as above."""
        free, phi = self._response(speed, Np, Nc, basis)
        gain = np.linalg.solve(Q * phi.T @ phi + R * np.eye(phi.shape[1]), Q * phi.T)
        first = gain[0] if basis is None else np.asarray(basis, float)[0] @ gain
        return first, first @ free

    def _response(self, speed: float, Np: int, Nc: int, basis: ArrayLike | None) -> tuple[Array, Array]:
        if basis is None:
            return self.prediction(speed, Np, Nc)
        free, phi = self.prediction(speed, Np, Np)
        return free, phi @ np.asarray(basis, float)


def laguerre_basis(Np: int, terms: int, pole: float) -> Array:
    """L (Np, terms): the first discrete Laguerre functions with `pole` in [0, 1), one in each column."""
    from adaptrack.kernels.prediction import laguerre_moves

    rows = np.zeros((terms, Np))
    laguerre_moves(Np, terms, pole, rows)
    return rows.T.copy()


def limit_matrix(Nc: int) -> Array:
    """M of eq. (16) for limits on moves and angle, shape (4 Nc, Nc).

    Four rows a sample: the move, its negative, the angle (the sum of moves so far), its negative.
    """
    rows = np.zeros((4 * Nc, Nc))
    for i in range(Nc):
        rows[4 * i, i], rows[4 * i + 1, i] = 1.0, -1.0
        rows[4 * i + 2, : i + 1], rows[4 * i + 3, : i + 1] = 1.0, -1.0
    return rows


def limit_bounds(Nc: int, angle: float, limits: Any) -> Array:
    """gamma of eq. (16) in the order of `limit_matrix`, shape (4 Nc,); angle: u(k-1) (rad); limits: `mpc.Limits`."""
    (low, high), (least, most) = limits.move, limits.angle
    return np.tile([high, -low, most - angle, angle - least], Nc)

"""One step of the MPC a second time: matrix exponential, a simulated model, least squares. Nothing is condensed.

The decision variables are found by least squares on the stacked residuals of eq. (11), which squares no condition
number; the model's response is simulated, never multiplied out.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.linalg import expm

from adaptrack.cars.vehicle import Vehicle

Array = npt.NDArray[np.float64]


def continuous(car: Vehicle, speed: float) -> tuple[Array, Array]:
    """A_c (4, 4) and B_c (4,) of eq. (7), from the forces of eqs. (1)-(4) by differentiating them.

    x_c = [v_y, yaw, yaw rate, y]; every tyre pushes with C (delta - (v_y + l r)/v), front l = lf, rear l = -lr.
    """
    a, b = np.zeros((4, 4)), np.zeros(4)
    for place, stiffness, steered in ((car.lf, car.stiffness_front, 1.0), (-car.lr, car.stiffness_rear, 0.0)):
        push = 2 * stiffness * np.array([-1 / speed, 0.0, -place / speed, 0.0])
        a[0] += push / car.mass
        a[2] += place * push / car.yaw_inertia
        b[0] += 2 * stiffness * steered / car.mass
        b[2] += 2 * stiffness * steered * place / car.yaw_inertia
    a[0, 2] -= speed
    a[1, 2] = 1.0
    a[3, 0], a[3, 1] = 1.0, speed
    return a, b


def discrete(car: Vehicle, speed: float, period: float) -> tuple[Array, Array]:
    """A_k (4, 4) and B (4,) of eq. (8): zero-order hold by scipy's matrix exponential."""
    a, b = continuous(car, speed)
    exponential = np.zeros((5, 5))
    exponential[:4, :4], exponential[:4, 4] = a, b
    exponential = expm(exponential * period)
    return exponential[:4, :4], exponential[:4, 4]


def outputs(car: Vehicle, speed: float, period: float, before: Array, current: Array, moves: Array) -> Array:
    """y at the instants after now, simulated: x(k+1) = x(k) + A (x(k) - x(k-1)) + B (u(k) - u(k-1)).

    before, now: x_c one instant ago and now; moves: u(k) - u(k-1), u(k+1) - u(k), ...
    """
    a, b = discrete(car, speed, period)
    result = []
    for move in moves:
        before, current = current, current + a @ (current - before) + b * move
        result.append(current[3])
    return np.array(result)


def laguerre(samples: int, terms: int, pole: float) -> Array:
    """Columns are discrete Laguerre functions, from their z-transforms by long division.

    L_i(z) = sqrt(1 - a^2)/(1 - a/z) * ((1/z - a)/(1 - a/z))^(i-1).
    """
    columns = np.zeros((samples, terms))
    impulse = np.zeros(samples)
    impulse[0] = 1.0

    def divided(signal: Array) -> Array:  # by (1 - a/z)
        out = np.zeros(samples)
        for k in range(samples):
            out[k] = signal[k] + (pole * out[k - 1] if k else 0.0)
        return out

    function = divided(impulse) * np.sqrt(1 - pole**2)
    for i in range(terms):
        columns[:, i] = function
        delayed = np.concatenate([[0.0], function[:-1]])
        function = divided(delayed - pole * function)
    return columns


def unconstrained_move(
    car: Vehicle,
    speed: float,
    period: float,
    before: Array,
    current: Array,
    reference: Array,
    q: float,
    r: float,
    basis: Array,
) -> float:
    """First move that minimises eq. (11) without limits; basis (Np, n): dU = basis eta, R weighs eta."""
    horizon, count = basis.shape
    free = outputs(car, speed, period, before, current, np.zeros(horizon))
    unforced = np.zeros(4)
    effect = np.column_stack([outputs(car, speed, period, unforced, unforced, basis[:, i]) for i in range(count)])
    stacked = np.vstack([np.sqrt(q) * effect, np.sqrt(r) * np.eye(count)])
    target = np.concatenate([np.sqrt(q) * (reference - free), np.zeros(count)])
    eta = np.linalg.lstsq(stacked, target, rcond=None)[0]
    return float(basis[0] @ eta)

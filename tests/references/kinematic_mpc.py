"""The kinematic MPC written down without matrices: a simulation of the stages and its cost; independent of the package.

The weights are those of Autoware's `mpc_lateral_controller`; the model its eq. (12), linearised about atan(L kappa).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
SUBSTEPS = 64


def moved(state: Array, u: float, v: float, curvature: float, time: float, car: tuple[float, float]) -> Array:
    """The state [e, theta, delta] after a time (s), by Runge-Kutta steps; car: wheelbase (m), lag (s) > 0."""
    wheelbase, lag = car
    steady = math.atan(wheelbase * curvature)

    def rate(x: Array) -> Array:
        tangent = math.tan(steady) + (x[2] - steady) / math.cos(steady) ** 2
        return np.array([v * x[1], v * tangent / wheelbase - v * curvature, (u - x[2]) / lag])

    h = time / SUBSTEPS
    for _ in range(SUBSTEPS):
        k1 = rate(state)
        k2 = rate(state + 0.5 * h * k1)
        k3 = rate(state + 0.5 * h * k2)
        k4 = rate(state + h * k3)
        state = state + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    return state


def cost(
    inputs: Sequence[float], state: Array, road: tuple[Array, Array], times: tuple[float, float],
    car: tuple[float, float], weights: dict[str, float], last: tuple[float, float],
) -> float:  # fmt: skip
    """Half the cost of the inputs (rad).

    road: speeds and curvatures of the stages; times: stage and control period (s); last: the last two inputs, the
    latest first.
    """
    speeds, curvatures = road
    h, period = times
    total = 0.0
    for i, (u, v, curvature) in enumerate(zip(inputs, speeds, curvatures, strict=True)):
        state = moved(state, u, v, curvature, h, car)
        final = i == len(inputs) - 1
        total += weights["terminal_lateral_error" if final else "lateral_error"] * state[0] ** 2
        total += weights["terminal_heading_error" if final else "heading_error"] * state[1] ** 2
        total += weights["heading_error_v2"] * (v * state[1]) ** 2
        steady = math.atan(car[0] * curvature)
        total += (weights["steering"] + weights["steering_v2"] * v * v) * (u - steady) ** 2
    u, (before, earlier) = np.array(inputs), last
    rates = np.concatenate([[(u[0] - before) / period], np.diff(u) / h])
    total += weights["lateral_jerk"] * float(np.sum((speeds[:-1] * rates[1:]) ** 2))
    total += weights["steering_rate"] * float(np.sum(rates**2))
    bends = np.concatenate([[(rates[0] - (before - earlier) / period) / period], np.diff(rates) / h])
    total += weights["steering_acceleration"] * float(np.sum(bends**2))
    return 0.5 * total


def derivatives(f, n: int) -> tuple[Array, Array]:
    """Hessian and gradient at 0 of a quadratic function of n numbers, exactly but for rounding."""
    zero, unit = np.zeros(n), np.eye(n)
    at_zero = f(zero)
    single = np.array([(f(unit[i]), f(-unit[i])) for i in range(n)])
    gradient = 0.5 * (single[:, 0] - single[:, 1])
    hessian = np.empty((n, n))
    for i in range(n):
        for j in range(n):
            hessian[i, j] = f(unit[i] + unit[j]) - single[i, 0] - single[j, 0] + at_zero
    return hessian, gradient

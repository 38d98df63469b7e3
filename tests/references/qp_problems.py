"""Quadratic programmes to test solvers on, drawn from the paper's MPC; independent of the package."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.linalg import expm

Array = npt.NDArray[np.float64]


def drawn_mpc_problem(rng: np.random.Generator) -> tuple[Array, Array, Array, Array]:
    """E, K, M, gamma of the paper's MPC (eqs. 9-17) in a random condition, states up to absurd ones."""
    speed, period = rng.uniform(1.0, 30.0), rng.uniform(0.05, 0.1)
    horizon = int(rng.integers(1, 56))
    moves = int(rng.integers(1, min(horizon, 18) + 1))
    q, r = 10.0 ** rng.uniform(-1.0, 1.0), 10.0 ** rng.uniform(-3.0, -1.0)
    response, free = _prediction(speed, period, horizon)
    phi = np.zeros((horizon, moves))
    for j in range(moves):
        phi[j:, j] = response[: horizon - j]
    samples = np.eye(moves)  # the moves in terms of the variables
    if rng.random() < 0.3:  # Laguerre: N coefficients stand for the moves of the whole horizon
        terms = int(rng.integers(1, min(horizon, 10) + 1))
        functions = _laguerre(float(rng.choice([0.75, 0.95])), terms, horizon)
        lower = np.zeros((horizon, horizon))
        for j in range(horizon):
            lower[j:, j] = response[: horizon - j]
        phi, samples = lower @ functions, functions[:moves]
    n = phi.shape[1]

    wild = 10.0 ** rng.uniform(-2.0, 1.0)  # from a millimetre to a state no car survives
    state = wild * rng.normal(size=5) * [0.3, 0.05, 0.1, 0.5, 3.0]
    error = wild * 3.0 * rng.normal() - free @ state
    E = 2.0 * (q * phi.T @ phi + r * np.eye(n))
    K = -2.0 * q * phi.T @ error
    angle = rng.uniform(-np.pi / 6, np.pi / 6)
    sums = np.cumsum(samples, axis=0)
    M = np.vstack([samples, -samples, sums, -sums])
    gamma = np.concatenate([np.full(2 * moves, np.pi / 12), np.full(moves, np.pi / 6 - angle),
                            np.full(moves, np.pi / 6 + angle)])  # fmt: skip
    if rng.random() < 0.2:  # soft limits on y: one slack variable for all of them
        width = 10.0 ** rng.uniform(-1.0, 1.0)
        E = np.block([[E, np.zeros((n, 1))], [np.zeros((1, n)), np.array([[2.0 * 10.0 ** rng.uniform(2.0, 5.0)]])]])
        K = np.append(K, 0.0)
        rows = np.vstack([phi, -phi])
        M = np.block([[M, np.zeros((len(M), 1))], [rows, -np.ones((len(rows), 1))]])
        y = free @ state
        gamma = np.concatenate([gamma, width - y, width + y])
    return (E + E.T) / 2.0, K, M, gamma


def _prediction(speed: float, period: float, horizon: int) -> tuple[Array, Array]:
    """Step response of y to one move, and F of eq. (10), for the paper's car and the augmented model (9)."""
    mass, inertia, lf, lr, cf, cr = 1575.0, 2875.0, 1.2, 1.6, 19e3, 33e3
    a, b = np.zeros((5, 5)), np.zeros(5)
    a[0] = [-2 * (cf + cr) / (mass * speed), 0, -speed - 2 * (cf * lf - cr * lr) / (mass * speed), 0, 2 * cf / mass]
    a[1, 2] = 1.0
    a[2] = [-2 * (cf * lf - cr * lr) / (inertia * speed), 0, -2 * (cf * lf**2 + cr * lr**2) / (inertia * speed), 0,
            2 * cf * lf / inertia]  # fmt: skip
    a[3, :2] = 1.0, speed
    held = expm(a * period)
    a4, b4 = held[:4, :4], held[:4, 4]
    augmented = np.zeros((5, 5))
    augmented[:4, :4], augmented[4, :4], augmented[4, 4] = a4, a4[3], 1.0
    b = np.append(b4, b4[3])
    response, free, row = np.zeros(horizon), np.zeros((horizon, 5)), np.eye(5)[4]
    for i in range(horizon):
        response[i] = row @ b
        row = row @ augmented
        free[i] = row
    return response, free


def _laguerre(pole: float, terms: int, samples: int) -> Array:
    """Discrete Laguerre functions, one column each."""
    beta = 1.0 - pole * pole
    step = np.eye(terms) * pole
    for i in range(terms):
        for j in range(i):
            step[i, j] = beta * (-pole) ** (i - j - 1)
    value = np.sqrt(beta) * (-pole) ** np.arange(terms)
    result = np.zeros((samples, terms))
    for k in range(samples):
        result[k] = value
        value = step @ value
    return result


def drawn_problem(rng: np.random.Generator, n: int, m: int) -> tuple[Array, Array, Array, Array]:
    """A well-conditioned problem without structure; x = 0 satisfies its rows."""
    root = rng.normal(size=(n, n))
    E = root @ root.T + np.eye(n)
    return (E + E.T) / 2.0, 5.0 * rng.normal(size=n), rng.normal(size=(m, n)), rng.uniform(0.0, 1.0, size=m)

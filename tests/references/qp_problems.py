"""Quadratic programmes to test solvers on: some with known solutions, others drawn, as from the paper's MPC."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from adaptrack.cars.vehicle import load_vehicle
from adaptrack.control.models import SingleTrackModel
from adaptrack.control.qp import QP
from references.dense_mpc import prediction
from references.mpc import laguerre

Array = npt.NDArray[np.float64]


def known_problems() -> Iterator[tuple[str, QP, Array]]:
    """The battery: (what it tests, problem, its exact solution), the solutions by hand or by construction."""
    identity = np.eye(2)
    K = np.array([-3.0, -3.0])
    yield "no rows at all", QP(identity, K), np.array([3.0, 3.0])
    yield "no row reached", QP(identity, K, identity, np.array([4.0, 4.0])), np.array([3.0, 3.0])
    yield "one bound active", QP(identity, K, identity, np.array([1.0, 4.0])), np.array([1.0, 3.0])
    yield "an absent row (gamma = inf)", QP(identity, K, identity, np.array([np.inf, 1.0])), np.array([3.0, 1.0])
    twice = np.array([[1.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    yield "the same row twice", QP(identity, K, twice, np.ones(3)), np.array([1.0, 1.0])
    corner = np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
    yield "three rows through one corner", QP(identity, K, corner, np.array([1.0, 1.0, 2.0])), np.array([1.0, 1.0])
    both = np.array([[1.0, 0.0], [-1.0, 0.0]])
    yield "a row and its opposite: an equality", QP(identity, K, both, np.array([1.0, -1.0])), np.array([1.0, 3.0])
    yield "a row that holds without force", QP(identity, K, identity, np.array([3.0, 1.0])), np.array([3.0, 1.0])


def ill_conditioned_problem() -> tuple[QP, Array]:
    """A QP with cond(E) = 7.8e11 whose data and solution are dyadic, so that float64 holds both exactly.

    E = 2^30 v v' + 2^-3 I with v = (1..6); rows x_j <= gamma_j as in a controller; K = -E x* - M' lam*.
    """
    v = np.arange(1.0, 7.0)
    E = 2.0**30 * np.outer(v, v) + 2.0**-3 * np.eye(6)
    M = np.vstack([np.eye(6), -np.eye(6)])
    x = np.array([0.25, -0.125, 0.0625, 0.25, -0.25, 0.03125])
    lam = np.zeros(12)
    lam[[0, 3, 10]] = 2.0, 0.5, 1.0  # x_0 and x_3 at +1/4, x_4 at -1/4
    return QP(E, -(E @ x) - M.T @ lam, M, np.full(12, 0.25)), x


def drawn_mpc_problem(rng: np.random.Generator) -> tuple[Array, Array, Array, Array]:
    """E, K, M, gamma of the paper's MPC (eqs. 9-17) in a random condition, states up to absurd ones."""
    speed, period = rng.uniform(1.0, 30.0), rng.uniform(0.05, 0.1)
    horizon = int(rng.integers(1, 56))
    moves = int(rng.integers(1, min(horizon, 18) + 1))
    q, r = 10.0 ** rng.uniform(-1.0, 1.0), 10.0 ** rng.uniform(-3.0, -1.0)
    free, lower = prediction(SingleTrackModel(load_vehicle("paper"), period), speed, horizon, horizon)
    phi = lower[:, :moves]
    samples = np.eye(moves)  # the moves in terms of the variables
    if rng.random() < 0.3:  # Laguerre: N coefficients stand for the moves of the whole horizon
        terms = int(rng.integers(1, min(horizon, 10) + 1))
        functions = laguerre(horizon, terms, float(rng.choice([0.75, 0.95])))
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


def drawn_problem(rng: np.random.Generator, n: int, m: int) -> tuple[Array, Array, Array, Array]:
    """A well-conditioned problem without structure; x = 0 satisfies its rows."""
    root = rng.normal(size=(n, n))
    E = root @ root.T + np.eye(n)
    return (E + E.T) / 2.0, 5.0 * rng.normal(size=n), rng.normal(size=(m, n)), rng.uniform(0.0, 1.0, size=m)

"""Random problems of every kind that troubles solvers: the exact method's answers proved in exact arithmetic."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from adaptrack.control.qp import QP, QPStatus, get_qp_solver
from references.qp_exact import exact_residual, reference_solve
from references.qp_problems import drawn_problem

SOLVER = get_qp_solver()


def easy(rng, n, m):
    """Most rows are far away."""
    E, K, M, gamma = drawn_problem(rng, n, m)
    return E, K, M, gamma + 10.0 * rng.random(m)


def limited(rng, n, m):
    """The free minimiser is far outside."""
    E, K, M, gamma = drawn_problem(rng, n, m)
    return E, 100.0 * K, M, gamma


def nearly_infeasible(rng, n, m):
    """Rows and their opposites a hair apart, around a common point."""
    E, K, M, _ = drawn_problem(rng, n, m)
    centre = M @ rng.normal(size=n)
    width = 10.0 ** rng.uniform(-9.0, -1.0, size=m)
    return E, K, np.vstack([M, -M]), np.concatenate([centre + width, width - centre])


def ill_conditioned(rng, n, m):
    """cond(E) up to 1e10."""
    _, K, M, gamma = drawn_problem(rng, n, m)
    Q, _ = np.linalg.qr(rng.normal(size=(n, n)))
    E = (Q * 10.0 ** rng.uniform(-10.0, 0.0, size=n)) @ Q.T
    return (E + E.T) / 2.0, K, M, gamma


def degenerate(rng, n, m):
    """Rows that repeat and sum others, many of them through one point."""
    E, K, _, _ = drawn_problem(rng, n, m)
    M = rng.integers(-1, 2, size=(m, n)).astype(float)
    point = rng.integers(-2, 3, size=n).astype(float)
    return E, K, M, M @ point + rng.choice([0.0, 0.0, 1.0], size=m)


@pytest.mark.parametrize("kind", [easy, limited, nearly_infeasible, ill_conditioned, degenerate])
@settings(max_examples=25)
@given(seed=st.integers(0, 2**32 - 1), n=st.integers(1, 12), m=st.integers(0, 30))
def test_the_exact_method_solves_every_feasible_problem(kind, seed, n, m):
    rng = np.random.default_rng(seed)
    qp = QP(*kind(rng, n, m))
    cold = SOLVER.solve(qp)
    assert cold.status is QPStatus.SOLVED
    assert exact_residual(qp.E, qp.K, qp.M, qp.gamma, cold.x, cold.lam) < 1e-11
    nearby = SOLVER.solve(QP(qp.E, qp.K + 0.1 * rng.normal(size=n), qp.M, qp.gamma))
    warm = SOLVER.solve(qp, nearby)
    assert exact_residual(qp.E, qp.K, qp.M, qp.gamma, warm.x, warm.lam) < 1e-11


@settings(max_examples=25)
@given(seed=st.integers(0, 2**32 - 1), n=st.integers(1, 8), m=st.integers(0, 20))
def test_its_minimiser_is_the_reference_to_twelve_digits(seed, n, m):
    qp = QP(*limited(np.random.default_rng(seed), n, m))
    solution = SOLVER.solve(qp)
    reference = reference_solve(qp.E, qp.K, qp.M, qp.gamma, np.flatnonzero(solution.lam > 0.0))
    np.testing.assert_allclose(solution.x, reference.x, atol=1e-12 * max(1.0, np.abs(reference.x).max()))

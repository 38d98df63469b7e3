"""The compiled solvers of the quadratic programme, against exact solutions and the textbook's words."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from adaptrack.control.qp import QP, QPStatus, Workspace, kkt_residuals
from adaptrack.core.qp import problem as kernels
from adaptrack.core.qp.active_set import active_set
from adaptrack.core.qp.residual import kkt_residual
from references import qp_hildreth as textbook
from references.qp_exact import Infeasible, reference_solve
from references.qp_problems import drawn_mpc_problem, drawn_problem, ill_conditioned_problem

pytestmark = pytest.mark.kernels

ENOUGH = 1000


def solve(qp, workspace=None, cap=ENOUGH, guess=None):
    """Status, x, lam and iterations of the exact solver."""
    workspace = workspace or Workspace()
    assert workspace.load(qp) is QPStatus.SOLVED
    status, iterations = workspace.active_set(cap, guess)
    return status, *workspace.result(), iterations


def sweep(qp, sweeps=38, tolerance=1e-7, start=None):
    """Status, x, lam and sweeps of Hildreth's procedure."""
    workspace = Workspace()
    assert workspace.load(qp, hildreth=True) is QPStatus.SOLVED
    status, count = workspace.hildreth(sweeps, tolerance, start)
    return status, *workspace.result(), count


def whole_numbers(seed, n, m):
    """A small problem in whole numbers: parallel, repeated, zero and contradicting rows abound."""
    rng = np.random.default_rng(seed)
    root = rng.integers(-2, 3, size=(n, n)).astype(float)
    E = root.T @ root + np.eye(n) * float(rng.choice([1.0, 0.125]))
    M = rng.integers(-1, 2, size=(m, n)).astype(float)
    return QP(E, rng.integers(-5, 6, size=n).astype(float), M, rng.integers(-1, 4, size=m).astype(float))


# -- the factor -------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("n", [1, 2, 7, 8, 9, 16, 17, 21])
def test_the_factor_holds_the_inverses_of_e_and_of_its_cholesky_factor(n, rng):
    qp = QP(*drawn_problem(rng, n, 1))
    workspace = Workspace()
    assert workspace.load(qp) is QPStatus.SOLVED
    root, inverse = workspace.factor.inverse_root[:n, :n], workspace.factor.inverse[:n, :n]
    np.testing.assert_allclose(root @ qp.E @ root.T, np.eye(n), atol=1e-11)
    np.testing.assert_allclose(inverse @ qp.E, np.eye(n), atol=1e-11)
    assert np.array_equal(root, np.tril(root))
    condition = np.linalg.cond(qp.E)
    assert condition * (1 - 1e-9) <= workspace.factor.condition <= n * n * condition * (1 + 1e-9)


@pytest.mark.parametrize("E", [[[1.0, 2.0], [2.0, 1.0]], [[0.0, 0.0], [0.0, 1.0]], [[1.0, 1.0], [1.0, 1.0 + 1e-16]]])
def test_a_hessian_that_is_not_positive_definite_is_refused(E):
    assert Workspace().load(QP(np.array(E), np.ones(2))) is QPStatus.NOT_CONVEX


# -- the exact solver -------------------------------------------------------------------------------------------------


@pytest.mark.compiled
def test_at_a_condition_of_8e11_the_solution_is_exact_to_rounding():
    qp, x = ill_conditioned_problem()
    assert 1e11 < np.linalg.cond(qp.E) < 1e12
    status, solution, _, _ = solve(qp)
    assert status is QPStatus.SOLVED
    np.testing.assert_allclose(solution, x, rtol=1e-13)
    free = QP(qp.E, qp.K)
    reference = reference_solve(qp.E, qp.K, free.M, free.gamma)
    np.testing.assert_allclose(solve(free)[1], reference.x, atol=1e-10)  # the data allow 1e-4


@pytest.mark.compiled
def test_the_first_move_is_within_1e_6_rad_of_the_exact_one_on_hard_mpc_problems(rng):
    limited = 0
    for _ in range(400):
        qp = QP(*drawn_mpc_problem(rng))
        status, x, lam, _ = solve(qp)
        reference = reference_solve(qp.E, qp.K, qp.M, qp.gamma, np.flatnonzero(lam > 0.0))
        assert status is QPStatus.SOLVED
        assert abs(x[0] - reference.x[0]) <= max(1e-6, reference.bound)
        limited += len(reference.active) > 0
    assert limited > 250


@given(seed=st.integers(0, 2**32 - 1), n=st.integers(1, 6), m=st.integers(0, 20))
def test_degenerate_and_contradicting_rows_are_told_apart(seed, n, m):
    qp = whole_numbers(seed, n, m)
    status, x, lam, _ = solve(qp)
    try:
        reference = reference_solve(qp.E, qp.K, qp.M, qp.gamma, np.flatnonzero(lam > 0.0))
    except Infeasible:
        assert status is QPStatus.INFEASIBLE
    else:
        assert status is QPStatus.SOLVED
        np.testing.assert_allclose(x, reference.x, atol=1e-10 * max(1.0, np.abs(reference.x).max()))


def test_a_kept_factor_leads_to_the_same_solution(rng):
    E, K, M, gamma = drawn_problem(rng, 9, 30)
    workspace, active = Workspace(), 0
    for _ in range(30):
        qp = QP(E, K + 3.0 * rng.normal(size=9), M, gamma + rng.uniform(0.0, 0.3, size=30))
        if active == 0:
            workspace.load(qp)
        workspace.problem.K[:9], workspace.problem.gamma[:30] = qp.K, qp.gamma
        status, _, active = active_set(
            workspace.problem, workspace.factor, workspace.solution, workspace.scratch, active, active > 0, ENOUGH
        )
        assert status == kernels.SOLVED
        np.testing.assert_allclose(workspace.result()[0], solve(qp)[1], atol=1e-12)


def test_neither_the_padding_nor_earlier_problems_reach_the_result(rng):
    used = Workspace()
    solve(QP(*drawn_problem(rng, 20, 90)), used)
    for n, m in ((3, 11), (12, 40), (8, 0)):
        qp = QP(*drawn_problem(rng, n, m))
        _, x, lam, _ = solve(qp)
        for array in (*used.problem[2:], *used.factor[:2], *used.solution, *used.scratch[:2]):
            array[...] = 1e6 * rng.normal(size=array.shape)
        _, y, mu, _ = solve(qp, used)
        assert np.array_equal(x, y)
        assert np.array_equal(lam, mu)


def test_the_problem_and_its_factor_are_left_as_they_were(rng):
    workspace = Workspace()
    workspace.load(QP(*drawn_problem(rng, 7, 25)), hildreth=True)
    inputs = (*workspace.problem[2:], *workspace.factor[:2])
    before = [array.copy() for array in inputs]
    workspace.active_set(ENOUGH)
    workspace.hildreth(38, 1e-7, None)
    for array, copy in zip(inputs, before, strict=True):
        assert np.array_equal(array, copy)


def test_the_iteration_cap_is_a_status(rng):
    qp = QP(*drawn_problem(rng, 10, 60))
    assert solve(qp)[3] > 2
    assert solve(qp, cap=2)[0] is QPStatus.CAPPED


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("name", ["E", "K", "M", "gamma"])
@pytest.mark.parametrize("method", ["active-set", "hildreth"])
def test_data_that_are_not_finite_are_a_status(name, value, method, rng):
    if name == "gamma" and value == np.inf:
        return  # an absent row
    arrays = dict(zip(("E", "K", "M", "gamma"), drawn_problem(rng, 5, 12), strict=True))
    for place in (0, arrays[name].size // 2, arrays[name].size - 1):
        broken = {key: array.copy() for key, array in arrays.items()}
        broken[name].flat[place] = value
        workspace = Workspace()
        status = workspace.load(QP.unchecked(**broken), hildreth=True)
        if name == "E":
            assert status is QPStatus.NON_FINITE
            continue
        status, _ = workspace.active_set(ENOUGH) if method == "active-set" else workspace.hildreth(38, 1e-7, None)
        assert status is QPStatus.NON_FINITE


@pytest.mark.parametrize("is_kept", [True, False], ids=["kept factor", "guessed rows"])
@pytest.mark.parametrize("n", range(1, 21))
def test_with_as_many_active_rows_as_variables_a_gradient_that_is_not_finite_is_a_status(n, is_kept, rng):
    # x then follows from the rows alone: only the multipliers tell.
    E, _, _, _ = drawn_problem(rng, n, 1)
    rows = np.vstack([np.eye(n), -np.eye(n)])
    solvable = QP(E, -E @ np.ones(n) - 10.0, rows, np.ones(2 * n))  # x = 1, each multiplier 10
    for place in {0, n // 2, n - 1}:
        for value in (np.nan, np.inf, -np.inf):
            w = Workspace()
            w.load(solvable)
            status, _, active = active_set(w.problem, w.factor, w.solution, w.scratch, 0, False, ENOUGH)
            assert (status, active) == (kernels.SOLVED, n)
            w.problem.K[place] = value
            status, _, active = active_set(w.problem, w.factor, w.solution, w.scratch, active, is_kept, ENOUGH)
            assert (status, active) == (kernels.NON_FINITE, 0)
            w.problem.K[:n] = solvable.K
            status, _, _ = active_set(w.problem, w.factor, w.solution, w.scratch, active, is_kept, ENOUGH)
            assert status == kernels.SOLVED


@pytest.mark.compiled
def test_a_solution_too_large_for_double_precision_is_capped_and_never_called_solved(rng):
    # Large coefficients of nearly dependent functions cancel in M x: their rounding exceeds what a row allows.
    capped = 0
    time = np.linspace(0.0, 1.0, 12)
    functions = np.exp(-np.outer(time, 0.3 * np.arange(1, 9)))
    rows = np.vstack([functions, -functions])
    for _ in range(300):
        size = 10.0 ** rng.uniform(0.0, 16.0)
        phi = rng.normal(size=(20, 8)) * 10.0 ** rng.uniform(-4.0, 0.0)
        qp = QP(phi.T @ phi + 1e-6 * np.eye(8), -phi.T @ rng.normal(size=20) * size, rows, np.full(24, 0.25))
        status, x, lam, _ = solve(qp)
        assert status in (QPStatus.SOLVED, QPStatus.CAPPED)
        if status is QPStatus.SOLVED:
            assert kkt_residuals(qp, x, lam).worst < 2e-6
        capped += status is QPStatus.CAPPED
    assert 0 < capped < 200


# -- Hildreth's procedure ---------------------------------------------------------------------------------------------
def test_hildreth_is_the_textbooks_procedure_sweep_by_sweep(rng):
    for n, m in ((1, 2), (5, 20), (10, 40)):
        qp = QP(*drawn_problem(rng, n, m))
        for sweeps in (1, 2, 7, 38):
            x, lam, count = textbook.hildreth(qp.E, qp.K, qp.M, qp.gamma, sweeps)
            _, y, mu, counted = sweep(qp, sweeps)
            np.testing.assert_allclose(y, x, atol=1e-10)
            np.testing.assert_allclose(mu, lam, atol=1e-10)
            assert counted == count


@pytest.mark.compiled
def test_what_hildreth_calls_solved_is_solved(rng):
    capped = 0
    for _ in range(500):
        qp = QP(*drawn_mpc_problem(rng))
        status, x, _, _ = sweep(qp)
        capped += status is QPStatus.CAPPED
        if status is QPStatus.SOLVED:
            assert abs(x[0] - solve(qp)[1][0]) < 1e-6
    assert capped > 100  # the paper's procedure seldom converges on hard problems, and says so here


def test_multipliers_so_small_that_the_papers_criterion_is_blind_do_not_count_as_solved():
    # With lam of the order 1e-5 every sweep "changes nothing", though the row is violated throughout.
    E = 1e-5 * np.array([[1.0, 0.999], [0.999, 1.0]])
    qp = QP(E, -E @ np.array([3.0, 3.0]), np.eye(2), np.array([1.0, 1.5]))
    status, x, _, sweeps = sweep(qp)
    assert sweeps < 38
    assert status is QPStatus.CAPPED
    assert np.abs(x - solve(qp)[1]).max() > 1e-3


# -- residuals and statuses -------------------------------------------------------------------------------------------
@given(seed=st.integers(0, 2**32 - 1), n=st.integers(1, 12), m=st.integers(0, 30))
def test_the_compiled_residuals_equal_the_readable_ones(seed, n, m):
    rng = np.random.default_rng(seed)
    E, K, M, gamma = drawn_problem(rng, n, m)
    gamma[rng.random(m) < 0.2] = np.inf
    qp = QP(E, K, M, gamma)
    workspace = Workspace()
    workspace.load(qp)
    x, lam = rng.normal(size=n), np.where(np.isfinite(gamma), rng.normal(size=m), 0.0)
    workspace.solution.x[:n], workspace.solution.lam[:m] = x, lam
    computed = kkt_residual(workspace.problem, workspace.solution, workspace.scratch)
    np.testing.assert_allclose(computed, kkt_residuals(qp, x, lam), rtol=1e-10, atol=1e-14)


@pytest.mark.parametrize("name", ["E", "K", "Mt", "gamma", "x", "lam"])
def test_a_nan_reaches_the_residuals(name, rng):
    w = Workspace()
    w.load(QP(*drawn_problem(rng, 4, 10)))
    w.active_set(ENOUGH)
    getattr(w.solution if name in ("x", "lam") else w.problem, name).flat[0] = np.nan
    residuals = kkt_residual(w.problem, w.solution, w.scratch)
    assert np.isnan(residuals).any()

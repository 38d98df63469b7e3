"""Every solver keeps the contract of `QPSolver`, and an answer that is not certified is finished, applied or held."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from adaptrack import Tuning, load_vehicle, published_mpc
from adaptrack.base.errors import InvalidInput, UnknownName
from adaptrack.control.qp import (
    QP,
    ActiveSet,
    Attempt,
    Hildreth,
    QPSolver,
    QPStatus,
    get_qp_solver,
    kkt_residuals,
    newton_distance,
)
from references.daqp import Daqp
from references.qp_exact import exact_residual, reference_solve
from references.qp_problems import drawn_mpc_problem, drawn_problem, ill_conditioned_problem, known_problems

SOLVERS = {"active-set": ActiveSet, "hildreth": Hildreth, "daqp": Daqp}
CONTRADICTION = QP(np.eye(2), np.array([-3.0, -3.0]), np.array([[1.0, 0.0], [-1.0, 0.0]]), np.array([1.0, -2.0]))

every_solver = pytest.mark.parametrize("name", SOLVERS)


@pytest.fixture
def slow_to_converge():
    """A problem on which Hildreth's procedure reaches its cap far from the solution."""
    rng = np.random.default_rng(1)
    while True:
        qp = QP(*drawn_mpc_problem(rng))
        capped = get_qp_solver("hildreth", on_uncertified="apply").solve(qp)
        if capped.status is QPStatus.CAPPED and abs(capped.x[0] - get_qp_solver().solve(qp).x[0]) > 0.01:
            return qp


# -- the contract -----------------------------------------------------------------------------------------------------
@pytest.mark.compiled
@every_solver
def test_known_problems_are_solved_cold_and_warm_with_the_same_bits_each_time(name):
    solver = SOLVERS[name]()
    for label, qp, x in known_problems():
        solution = solver.solve(qp)
        assert solution.solved, label
        np.testing.assert_allclose(solution.x, x, atol=1e-6, err_msg=label)
        assert np.array_equal(solver.solve(qp).x, solution.x), label
        np.testing.assert_allclose(solver.solve(qp, solution).x, x, atol=1e-6, err_msg=label)


@every_solver
def test_what_has_no_solution_is_a_status_and_nothing_to_steer_by(name):
    E, K, M, gamma = np.eye(2), np.array([-3.0, -3.0]), np.eye(2), np.ones(2)
    solver = SOLVERS[name]()
    for qp in (CONTRADICTION, QP(E, K, np.array([[0.0, 0.0], [1.0, 0.0]]), np.array([-1.0, 1.0]))):
        assert solver.solve(qp).status in (QPStatus.INFEASIBLE, QPStatus.CAPPED)
        assert not solver.solve(qp).usable
    assert solver.solve(CONTRADICTION).iterations > 0
    assert not solver.solve(QP(np.array([[1.0, 2.0], [2.0, 1.0]]), K, M, gamma)).solved
    for entry in range(4):
        arrays = [array.copy() for array in (E, K, M, gamma)]
        arrays[entry].flat[0] = np.nan
        assert not solver.solve(QP.unchecked(*arrays)).usable
    assert "limits" in QPStatus.INFEASIBLE.sentence


@every_solver
def test_the_solvers_agree_where_the_conditioning_lets_them(name, rng):
    solver, exact = SOLVERS[name](), ActiveSet()
    for _ in range(20):
        qp = QP(*drawn_problem(rng, 8, 24))
        solution = solver.solve(qp)
        assert solution.solved, solution.message
        np.testing.assert_allclose(solution.x, exact.solve(qp).x, atol=1e-6)


@every_solver
def test_a_solution_carries_its_residuals(name, rng):
    qp = QP(*drawn_problem(rng, 5, 15))
    solution = SOLVERS[name]().solve(qp)
    assert solution.residuals == kkt_residuals(qp, solution.x, solution.lam)
    assert solution.residuals.worst < 1e-6
    assert solution.solver == name
    assert solution.iterations >= 0
    assert solution.message


class Answering(QPSolver):
    """A solver that gives the same attempt for every problem."""

    name = "answering"

    def __init__(self, attempt, **options):
        super().__init__(**options)
        self.answer = attempt

    def attempt(self, qp, warm_start=None):
        return self.answer


def askew(**options):
    """Misses the solution of `ill_conditioned_problem` by 3e-3 rad, along which E has its least eigenvalue."""
    qp, x = ill_conditioned_problem()
    lam = np.zeros(qp.m)
    lam[[0, 3, 10]] = 2.0, 0.5, 1.0
    x = x + np.array([0.0, 3e-3, -2e-3, 0.0, 0.0, 0.0])
    return Answering(Attempt(QPStatus.SOLVED, x, lam, 1), **options)


def test_a_result_that_its_residuals_contradict_is_not_solved(rng):
    boaster = Answering(Attempt(QPStatus.SOLVED, np.ones(5), np.zeros(15), 1), on_uncertified="hold")
    solution = boaster.solve(QP(*drawn_problem(rng, 5, 15)))
    assert (solution.status, solution.usable) == (QPStatus.CAPPED, False)
    assert "answering reported a solution" in solution.message


def test_small_residuals_alone_do_not_make_a_solution():
    qp, _ = ill_conditioned_problem()
    solution = askew(on_uncertified="apply").solve(qp)
    assert solution.residuals.worst < 1e-9
    assert solution.status is QPStatus.CAPPED
    assert "about 3.0e-03 rad from the true one" in solution.message
    assert not askew(on_uncertified="hold").solve(qp).usable


def test_a_newton_step_measures_how_far_x_is_from_the_solution(rng):
    for _ in range(20):
        qp = QP(*drawn_problem(rng, 8, 24))
        solution = get_qp_solver().solve(qp)
        assert newton_distance(qp, solution.x, solution.lam) < 1e-10
        distance = 1e-5 * rng.normal(size=8)
        measured = newton_distance(qp, solution.x + distance, solution.lam)
        assert measured == pytest.approx(np.abs(distance).max(), rel=0.2)


# -- Hildreth's policy ------------------------------------------------------------------------------------------------


@pytest.mark.compiled
def test_hildreth_may_apply_or_hold_instead_and_says_capped(slow_to_converge):
    applied = get_qp_solver("hildreth", on_uncertified="apply").solve(slow_to_converge)
    assert applied.status is QPStatus.CAPPED
    assert applied.usable
    held_solution = get_qp_solver("hildreth", on_uncertified="hold").solve(slow_to_converge)
    assert held_solution.status is QPStatus.CAPPED
    assert not held_solution.usable
    assert np.isnan(held_solution.x).all()
    assert "exact solver" in held_solution.message


@pytest.mark.parametrize("options", [{"max_sweeps": 0}, {"tolerance": -1.0}, {"tolerance": np.nan},
                                     {"on_uncertified": "hope"}])  # fmt: skip
def test_hildreth_refuses_options_without_meaning(options):
    with pytest.raises(InvalidInput, match=next(iter(options))):
        get_qp_solver("hildreth", **options)


# -- what is not certified --------------------------------------------------------------------------------------------
def test_the_exact_method_finishes_what_a_solver_is_not_sure_of():
    qp, _ = ill_conditioned_problem()
    solver = askew()
    for count in (1, 2):
        solution = solver.solve(qp)
        assert solution.solved
        np.testing.assert_allclose(solution.x, ActiveSet().solve(qp).x, rtol=1e-12)
        assert (solution.solver, solution.finished_by, solution.finishes) == ("answering", "active-set", count)
        assert "the exact method finished" in solution.message


@pytest.mark.parametrize("solver", [Hildreth(), Daqp(), Answering(Attempt(QPStatus.INFEASIBLE))])
def test_with_any_solver_no_step_of_a_controller_is_held(solver):
    car = load_vehicle("paper")
    ours, exact = (
        published_mpc(car, Tuning(35, 8, 10.0, 0.01), solver=solver),
        published_mpc(car, Tuning(35, 8, 10.0, 0.01)),
    )
    for k in range(40):
        state, reference = [0.0, 0.01 * k, 0.0, 0.02 * k], [np.sin(0.3 * k)]
        expected, command = exact.step(state, 20.0, reference), ours.step(state, 20.0, reference)
        assert command.status is QPStatus.SOLVED
        assert not command.held
        assert abs(command.move - expected.move) < 1e-4


def test_a_claim_of_infeasibility_is_not_believed(rng):
    qp, claim = QP(*drawn_problem(rng, 5, 15)), Attempt(QPStatus.INFEASIBLE)
    assert Answering(claim).solve(qp).solved
    assert Answering(claim, on_uncertified="apply").solve(qp).status is QPStatus.INFEASIBLE


# -- the problem ------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(("change", "complaint"), [
    ({"E": np.eye(3)}, r"E has shape \(3, 3\)"),
    ({"K": np.zeros((2, 1))}, "K has 2 dimension"),
    ({"K": np.zeros(0)}, "at least one variable"),
    ({"M": np.ones((2, 3))}, r"M has shape \(2, 3\)"),
    ({"gamma": np.ones(5)}, r"must be \(5, 2\)"),
    ({"E": np.array([[1.0, 0.5], [0.0, 1.0]])}, "not symmetric"),
    ({"E": np.array([[np.nan, 0.0], [0.0, 1.0]])}, r"E holds nan at \[0, 0\]"),
    ({"K": np.array([0.0, np.inf])}, r"K holds inf at \[1\]"),
    ({"M": np.array([[1.0, -np.inf]]), "gamma": np.ones(1)}, "M holds -inf"),
    ({"gamma": np.array([np.nan, 1.0])}, "gamma holds NaN or -inf"),
    ({"gamma": np.array([-np.inf, 1.0])}, "gamma holds NaN or -inf"),
    ({"K": ["a", "b"]}, "must be real numbers"),
])  # fmt: skip
def test_a_malformed_problem_is_refused_with_the_reason(change, complaint):
    arrays = {"E": np.eye(2), "K": np.ones(2), "M": np.eye(2), "gamma": np.ones(2)} | change
    with pytest.raises(InvalidInput, match=complaint):
        QP(**arrays)


def test_a_problem_keeps_its_own_read_only_copies():
    K = np.ones(2)
    qp = QP(np.eye(2), K, np.eye(2), np.ones(2))
    K[0] = 7.0
    assert qp.K[0] == 1.0
    with pytest.raises(ValueError, match="read-only"):
        qp.K[0] = 7.0
    with pytest.raises(dataclasses.FrozenInstanceError):
        qp.K = K
    assert (qp.n, qp.m, qp.cost([1.0, 1.0])) == (2, 2, 3.0)


# -- by name ----------------------------------------------------------------------------------------------------------
def test_a_name_makes_a_solver_and_a_misspelt_one_is_answered_with_the_nearest():
    assert isinstance(get_qp_solver(), ActiveSet)
    assert isinstance(get_qp_solver("hildreth", max_sweeps=7), Hildreth)
    with pytest.raises(UnknownName, match="Did you mean 'hildreth'"):
        get_qp_solver("hildret")


# -- the corpus -------------------------------------------------------------------------------------------------------
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

"""Every solver keeps the contract; the checker admits those that do and names the clause that others break."""

import dataclasses

import numpy as np
import pytest

from adaptrack import Tuning, load_vehicle, published_mpc
from adaptrack.base.errors import ContractError, InvalidInput, MissingExtra, UnknownName
from adaptrack.control.qp import (
    QP,
    Attempt,
    QPSolver,
    QPStatus,
    Solution,
    check_qp_solver,
    get_qp_solver,
    kkt_residuals,
    list_qp_solvers,
    register_qp_solver,
    registry,
)
from adaptrack.control.qp.active_set import ActiveSet
from adaptrack.control.qp.check import ill_conditioned_problem
from adaptrack.control.qp.solver import newton_distance
from references.qp_problems import drawn_mpc_problem, drawn_problem

NAMES = ("active-set", "clarabel", "daqp", "hildreth", "osqp", "piqp")
EXTRAS = ("clarabel", "osqp", "piqp")

every_solver = pytest.mark.parametrize("name", NAMES)


@pytest.fixture
def infeasible():
    return QP(np.eye(2), np.array([-3.0, -3.0]), np.array([[1.0, 0.0], [-1.0, 0.0]]), np.array([1.0, -2.0]))


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
def test_the_documented_solvers_are_registered():
    assert set(NAMES) <= set(list_qp_solvers())
    assert isinstance(get_qp_solver(), ActiveSet)


@pytest.mark.compiled
@every_solver
def test_every_solver_keeps_the_contract(name):
    check_qp_solver(get_qp_solver(name))


@pytest.mark.parametrize("policy", ["exact", "apply", "hold"])
@pytest.mark.compiled
def test_hildreth_keeps_the_contract_under_each_policy(policy):
    check_qp_solver(get_qp_solver("hildreth", on_uncertified=policy))


@every_solver
def test_the_solvers_agree_where_the_conditioning_lets_them(name, rng):
    solver, exact = get_qp_solver(name), get_qp_solver()
    for _ in range(20):
        qp = QP(*drawn_problem(rng, 8, 24))
        solution = solver.solve(qp)
        assert solution.solved, solution.message
        np.testing.assert_allclose(solution.x, exact.solve(qp).x, atol=1e-6)


@pytest.mark.compiled
def test_the_exact_solver_agrees_with_daqp_on_mpc_problems(rng):
    ours, theirs = get_qp_solver("active-set"), get_qp_solver("daqp")
    for _ in range(500):
        qp = QP(*drawn_mpc_problem(rng))
        a, b = ours.solve(qp), theirs.solve(qp)
        assert a.solved
        assert b.solved
        assert abs(a.x[0] - b.x[0]) < 1e-5


@every_solver
def test_infeasible_is_a_status_with_a_remedy(name, infeasible):
    solution = get_qp_solver(name).solve(infeasible)
    assert solution.status in (QPStatus.INFEASIBLE, QPStatus.CAPPED)
    assert not solution.usable
    assert "limits" in QPStatus.INFEASIBLE.sentence


@every_solver
def test_a_solution_carries_its_residuals(name, rng):
    qp = QP(*drawn_problem(rng, 5, 15))
    solution = get_qp_solver(name).solve(qp)
    assert solution.residuals == kkt_residuals(qp, solution.x, solution.lam)
    assert solution.residuals.worst < 1e-6
    assert solution.solver == name
    assert solution.iterations >= 0
    assert solution.message


def test_a_result_that_its_residuals_contradict_is_not_solved(rng):
    class Boaster(ActiveSet):
        name = "boaster"

        def attempt(self, qp, warm_start=None):
            return Attempt(QPStatus.SOLVED, np.ones(qp.n), np.zeros(qp.m), 1)

    solution = Boaster().solve(QP(*drawn_problem(rng, 5, 15)))
    assert solution.status is QPStatus.CAPPED
    assert not solution.usable
    assert "boaster reported a solution" in solution.message


@pytest.mark.parametrize("name", EXTRAS)
def test_small_residuals_alone_do_not_make_a_solution(name):
    # At cond(E) = 8e11 these back-ends stop with residuals of 1e-9 and x off by 3e-3 to 0.1 rad.
    qp, _ = ill_conditioned_problem()
    solution = get_qp_solver(name, on_uncertified="hold").solve(qp)
    assert solution.residuals.worst < 1e-6
    assert solution.status is QPStatus.CAPPED
    assert not solution.usable


def test_a_newton_step_measures_how_far_x_is_from_the_solution(rng):
    for _ in range(20):
        qp = QP(*drawn_problem(rng, 8, 24))
        solution = get_qp_solver().solve(qp)
        assert newton_distance(qp, solution.x, solution.lam) < 1e-10
        away = 1e-5 * rng.normal(size=8)
        measured = newton_distance(qp, solution.x + away, solution.lam)
        assert measured == pytest.approx(np.abs(away).max(), rel=0.2)


# -- Hildreth's policy ------------------------------------------------------------------------------------------------
@pytest.mark.compiled
def test_by_default_the_exact_method_finishes_what_hildreth_could_not(slow_to_converge):
    solution = get_qp_solver("hildreth").solve(slow_to_converge)
    exact = get_qp_solver("active-set").solve(slow_to_converge)
    assert solution.solved
    assert "the exact method finished" in solution.message
    np.testing.assert_allclose(solution.x, exact.x, atol=1e-9)


@pytest.mark.compiled
def test_hildreth_may_apply_or_hold_instead_and_says_capped(slow_to_converge):
    applied = get_qp_solver("hildreth", on_uncertified="apply").solve(slow_to_converge)
    assert applied.status is QPStatus.CAPPED
    assert applied.usable
    held = get_qp_solver("hildreth", on_uncertified="hold").solve(slow_to_converge)
    assert held.status is QPStatus.CAPPED
    assert not held.usable
    assert np.isnan(held.x).all()
    assert "exact solver" in held.message


@pytest.mark.parametrize("options", [{"max_sweeps": 0}, {"tolerance": -1.0}, {"tolerance": np.nan},
                                     {"on_uncertified": "hope"}])  # fmt: skip
def test_hildreth_refuses_options_without_meaning(options):
    with pytest.raises(InvalidInput, match=next(iter(options))):
        get_qp_solver("hildreth", **options)


# -- what is not certified --------------------------------------------------------------------------------------------
class _Idle(QPSolver):
    """Gives up at once, with an iterate."""

    name = "idle"
    accuracy = 1e-6

    def attempt(self, qp, warm_start=None):
        return Attempt(QPStatus.CAPPED, np.full(qp.n, 0.5), np.zeros(qp.m), 3)


@pytest.mark.parametrize("name", EXTRAS)
def test_the_exact_method_finishes_what_a_back_end_is_not_sure_of(name):
    qp, _ = ill_conditioned_problem()
    solver = get_qp_solver(name)
    for count in (1, 2):
        solution = solver.solve(qp)
        assert solution.solved
        np.testing.assert_allclose(solution.x, get_qp_solver().solve(qp).x, rtol=1e-12)
        assert (solution.solver, solution.finished_by, solution.finishes) == (name, "active-set", count)
        assert "the exact method finished" in solution.message


@pytest.mark.parametrize("name", [*EXTRAS, "daqp", "hildreth"])
def test_with_any_back_end_no_step_of_a_controller_is_held(name):
    car = load_vehicle("paper")
    ours, exact = (
        published_mpc(car, Tuning(35, 8, 10.0, 0.01), solver=name),
        published_mpc(car, Tuning(35, 8, 10.0, 0.01)),
    )
    for k in range(40):
        state, reference = [0.0, 0.01 * k, 0.0, 0.02 * k], [np.sin(0.3 * k)]
        expected, command = exact.step(state, 20.0, reference), ours.step(state, 20.0, reference)
        assert command.status is QPStatus.SOLVED
        assert not command.held
        assert abs(command.move - expected.move) < 1e-4


def test_an_answer_of_ones_own_solver_is_finished_applied_or_held(rng):
    qp = QP(*drawn_problem(rng, 5, 15))
    finished = _Idle().solve(qp)
    assert finished.solved
    assert (finished.finished_by, finished.finishes) == ("active-set", 1)
    applied = _Idle(on_uncertified="apply").solve(qp)
    assert applied.status is QPStatus.CAPPED
    assert applied.usable
    assert (applied.finished_by, applied.finishes) == ("idle", 0)
    held = _Idle(on_uncertified="hold").solve(qp)
    assert held.status is QPStatus.CAPPED
    assert not held.usable
    check_qp_solver(_Idle())


def test_a_claim_of_infeasibility_is_not_believed(rng):
    class Pessimist(_Idle):
        def attempt(self, qp, warm_start=None):
            return Attempt(QPStatus.INFEASIBLE)

    qp = QP(*drawn_problem(rng, 5, 15))
    assert Pessimist().solve(qp).solved
    assert Pessimist(on_uncertified="apply").solve(qp).status is QPStatus.INFEASIBLE


def test_an_infeasible_problem_stays_infeasible_when_the_exact_method_finishes(infeasible):
    solution = _Idle().solve(infeasible)
    assert solution.status is QPStatus.INFEASIBLE
    assert not solution.usable


@every_solver
def test_a_policy_without_meaning_is_refused(name):
    if name != "active-set":
        with pytest.raises(InvalidInput, match="on_uncertified"):
            get_qp_solver(name, on_uncertified="hope")


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


# -- the registry -----------------------------------------------------------------------------------------------------
def test_a_misspelt_name_is_answered_with_the_nearest():
    with pytest.raises(UnknownName, match="Did you mean 'hildreth'"):
        get_qp_solver("hildret")


def test_a_missing_library_is_answered_with_the_command_that_installs_it(monkeypatch):
    for name in EXTRAS:
        monkeypatch.setitem(__import__("sys").modules, name, None)
        with pytest.raises(MissingExtra, match=r"pip install 'adaptrack\[solvers\]'"):
            get_qp_solver(name)


def test_the_libraries_are_loaded_only_when_their_solver_is_asked_for(run_python):
    code = f"import sys, adaptrack.control.qp; print([n for n in {(*EXTRAS, 'daqp')!r} if n in sys.modules])"
    assert run_python(code=code).strip() == "[]"


@pytest.fixture
def clean_registry(monkeypatch):
    monkeypatch.setattr(registry._registry, "factories", dict(registry._registry.factories))


@pytest.mark.usefixtures("clean_registry")
def test_anybodys_solver_can_be_registered_by_name():
    class Mine(ActiveSet):
        name = "mine"

    register_qp_solver("mine", Mine)
    assert "mine" in list_qp_solvers()
    assert isinstance(get_qp_solver("mine", max_iterations=7), Mine)
    register_qp_solver("by-path", "adaptrack.control.qp.active_set:ActiveSet")
    assert isinstance(get_qp_solver("by-path"), ActiveSet)


@pytest.mark.usefixtures("clean_registry")
@pytest.mark.parametrize(("name", "factory"), [("daqp", ActiveSet), ("", ActiveSet), ("new", 3), ("new", "no colon")])
def test_a_registration_without_sense_is_refused(name, factory):
    with pytest.raises(InvalidInput):
        register_qp_solver(name, factory)


# -- the checker ------------------------------------------------------------------------------------------------------
class _Breaker(QPSolver):
    """The exact solver with one clause broken by `spoil`."""

    name = "breaker"
    accuracy = 1e-6

    def __init__(self):
        self.inner = ActiveSet()
        self.calls = 0

    def attempt(self, qp, warm_start=None):
        return self.inner.attempt(qp, warm_start)

    def solve(self, qp, warm_start=None):
        self.calls += 1
        return self.spoil(qp, super().solve(qp, warm_start), warm_start)

    def spoil(self, qp, solution, warm_start):
        return solution


def _breaker(spoil):
    return type("Broken", (_Breaker,), {"spoil": spoil})()


def _writes(self, qp, solution, warm_start):
    qp.K.setflags(write=True)
    qp.K[0] += 1.0
    return solution


def _wanders(self, qp, solution, warm_start):
    return dataclasses.replace(solution, x=solution.x + 1e-12 * self.calls)


def _raises(self, qp, solution, warm_start):
    if solution.status is QPStatus.INFEASIBLE:
        raise RuntimeError("primal infeasible")
    return solution


def _is_wrong(self, qp, solution, warm_start):
    return dataclasses.replace(solution, x=solution.x + 1e-3)


def _trusts_the_warm_start(self, qp, solution, warm_start):
    return solution if warm_start is None else dataclasses.replace(solution, x=solution.x + 1e-7 * (solution.x > 2.0))


def _is_silent(self, qp, solution, warm_start):
    zeros = dataclasses.replace(solution, x=np.zeros(qp.n), lam=np.zeros(qp.m), status=QPStatus.SOLVED)
    return solution if solution.solved else zeros


def _is_inaccurate(self, qp, solution, warm_start):
    return dataclasses.replace(solution, x=solution.x + 1e-5) if qp.n == 6 else solution


def _returns_a_tuple(self, qp, solution, warm_start):
    return solution.x, solution.lam


def _has_negative_multipliers(self, qp, solution, warm_start):
    return dataclasses.replace(solution, lam=-solution.lam - 1e-9)


def _hides_who_finished(self, qp, solution, warm_start):
    return dataclasses.replace(solution, finishes=solution.finishes + 1)


@pytest.mark.compiled
@pytest.mark.parametrize(("spoil", "clause"), [
    (_writes, "wrote to the problem"),
    (_wanders, "other bits"),
    (_raises, "raised RuntimeError .* return a status"),
    (_is_wrong, "optimality conditions miss|misses the known solution"),
    (_is_silent, "optimality conditions miss"),
    (_is_inaccurate, "misses by|conditions miss"),
    (_returns_a_tuple, "not a Solution"),
    (_has_negative_multipliers, "multiplier is negative"),
    (_hides_who_finished, "not counted"),
])  # fmt: skip
def test_the_checker_names_the_clause_that_a_solver_breaks(spoil, clause):
    with pytest.raises(ContractError, match=f"breaker.*({clause})"):
        check_qp_solver(_breaker(spoil))


@pytest.mark.compiled
def test_the_checker_admits_the_unbroken_one():
    check_qp_solver(_Breaker())


def test_the_checker_wants_a_solver_with_a_name_and_an_accuracy():
    with pytest.raises(ContractError, match="not a QPSolver"):
        check_qp_solver(object())
    with pytest.raises(ContractError, match="accuracy"):
        check_qp_solver(type("Vague", (_Breaker,), {"accuracy": 0})())
    with pytest.raises(ContractError, match="no name"):
        check_qp_solver(type("Nameless", (_Breaker,), {"name": ""})())


def test_the_ill_conditioned_problem_of_the_checker_is_stated_exactly():
    qp, x = ill_conditioned_problem()
    exact = [sum(int(e * 8) * int(v * 32) for e, v in zip(row, x, strict=True)) for row in qp.E]  # in 1/256
    pressed = np.array([2.0, 0.0, 0.0, 0.5, -1.0, 0.0])
    assert [-e / 256 - p for e, p in zip(exact, pressed, strict=True)] == qp.K.tolist()


def test_solutions_are_plain_records(rng):
    solution = get_qp_solver().solve(QP(*drawn_problem(rng, 3, 4)))
    assert isinstance(solution, Solution)
    assert {f.name for f in dataclasses.fields(solution)} == {
        "x", "lam", "status", "residuals", "iterations", "solver", "message", "finished_by", "finishes",
    }  # fmt: skip

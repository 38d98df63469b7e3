"""The checker that admits a QP solver: ours and anybody's."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from adaptrack.base.checked import checked
from adaptrack.base.errors import AdaptrackError, ContractError, InvalidInput
from adaptrack.control.qp.problem import QP, Array, QPStatus, Solution, kkt_residuals
from adaptrack.control.qp.solver import QPSolver

WELL_CONDITIONED = 1e-6
"""Accuracy of x (rad) that every solver owes on a well-conditioned problem."""
DEGENERATE = 1e-4
"""The same where a row holds with equality but without force: interior-point methods then find only half the digits."""


def known_problems() -> Iterator[tuple[str, QP, Array]]:
    """The battery: (what it tests, problem, its exact solution), the solutions by hand or by construction."""
    one = np.eye(2)
    K = np.array([-3.0, -3.0])
    yield "no rows at all", QP(one, K), np.array([3.0, 3.0])
    yield "no row reached", QP(one, K, one, np.array([4.0, 4.0])), np.array([3.0, 3.0])
    yield "one bound active", QP(one, K, one, np.array([1.0, 4.0])), np.array([1.0, 3.0])
    yield "an absent row (gamma = inf)", QP(one, K, one, np.array([np.inf, 1.0])), np.array([3.0, 1.0])
    twice = np.array([[1.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    yield "the same row twice", QP(one, K, twice, np.ones(3)), np.array([1.0, 1.0])
    corner = np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
    yield "three rows through one corner", QP(one, K, corner, np.array([1.0, 1.0, 2.0])), np.array([1.0, 1.0])
    both = np.array([[1.0, 0.0], [-1.0, 0.0]])
    yield "a row and its opposite: an equality", QP(one, K, both, np.array([1.0, -1.0])), np.array([1.0, 3.0])
    yield "a row that holds without force", QP(one, K, one, np.array([3.0, 1.0])), np.array([3.0, 1.0])


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


@checked
def check_qp_solver(solver: QPSolver) -> None:
    """Test ``solver`` against the contract of `QPSolver`; raise `ContractError` naming the clause it breaks.

    Solves a battery of problems with known solutions, some of them infeasible, ill-conditioned or not finite.
    ``solver.accuracy`` is what it promises on the ill-conditioned one.
    """
    if not isinstance(solver, QPSolver):
        raise ContractError(f"{type(solver).__name__} is not a QPSolver: derive it from adaptrack.control.qp.QPSolver.")
    name = getattr(solver, "name", None)
    if not isinstance(name, str) or not name:
        raise ContractError(f"{type(solver).__name__} has no name: set the class attribute `name`.")
    accuracy = getattr(solver, "accuracy", None)
    if not isinstance(accuracy, float) or not 0.0 < accuracy <= 1.0:
        raise ContractError(f"{name}: `accuracy` is {accuracy!r}; state a float in (0, 1] rad.")

    for label, qp, x in known_problems():
        tolerance = DEGENERATE if "without force" in label else WELL_CONDITIONED
        solution = _solve(solver, qp, label)
        _require(solution.solved, name, label, f"status {solution.status.name} instead of SOLVED")
        _near(solver, solution, x, tolerance, label)
        again = _solve(solver, qp, label)
        _require(bool(np.array_equal(solution.x, again.x)), name, label, "the second solve gave other bits")
        warm = _solve(solver, qp, label, solution)
        _near(solver, warm, x, tolerance, f"{label}, warm start")

    qp, x = ill_conditioned_problem()
    label = "cond(E) = 8e11"
    solution = _solve(solver, qp, label)
    if solution.status is not QPStatus.CAPPED:  # saying "I could not" is honest
        _require(solution.solved, name, label, f"status {solution.status.name}")
        _require(
            abs(solution.x[0] - x[0]) <= accuracy, name, label,
            f"x[0] misses by {abs(solution.x[0] - x[0]):.1e}, more than the promised {accuracy:.1e}",
        )  # fmt: skip

    one, K = np.eye(2), np.array([-3.0, -3.0])
    for label, rows, gamma in (
        ("two rows that contradict each other", [[1.0, 0.0], [-1.0, 0.0]], [1.0, -2.0]),
        ("an impossible row 0 <= -1", [[0.0, 0.0], [1.0, 0.0]], [-1.0, 1.0]),
    ):
        solution = _solve(solver, QP(one, K, np.array(rows), np.array(gamma)), label)
        _require(
            solution.status in (QPStatus.INFEASIBLE, QPStatus.CAPPED), name, label,
            f"status {solution.status.name}: an infeasible problem must say so",
        )  # fmt: skip

    indefinite = QP(np.array([[1.0, 2.0], [2.0, 1.0]]), K, one, np.ones(2))
    _require(not _solve(solver, indefinite, "E not positive definite").solved, name, "E not positive definite",
             "it claims to have solved a problem that has no solution")  # fmt: skip

    nan, plain = float("nan"), (one, K, one, np.ones(2))
    for position, what in enumerate(("E", "K", "M", "gamma")):
        arrays = [a.copy() for a in plain]
        arrays[position].flat[0] = nan
        broken = QP.unchecked(*arrays)
        label = f"NaN in {what}"
        try:
            solution = solver.solve(broken)
        except InvalidInput:
            continue
        except Exception as error:
            raise ContractError(f"{name}, {label}: raised {type(error).__name__}: {error}") from error
        _require(not solution.solved and not solution.usable, name, label, "it returned an x to steer by")


def _require(condition: bool, name: str, label: str, complaint: str) -> None:
    if not condition:
        raise ContractError(f"{name}, {label}: {complaint}.")


def _near(solver: QPSolver, solution: Solution, x: Array, tolerance: float, label: str) -> None:
    error = float(np.abs(solution.x - x).max())
    _require(error <= tolerance, solver.name, label, f"x misses the known solution by {error:.1e}")


def _solve(solver: QPSolver, qp: QP, label: str, warm_start: Solution | None = None) -> Solution:
    """Solve, and test the clauses that hold for every problem."""
    before = [a.copy() for a in (qp.E, qp.K, qp.M, qp.gamma)]
    finishes = solver.finishes
    try:
        solution = solver.solve(qp, warm_start)
    except AdaptrackError as error:
        raise ContractError(f"{solver.name}, {label}: raised {type(error).__name__}: {error}") from error
    except Exception as error:
        raise ContractError(
            f"{solver.name}, {label}: raised {type(error).__name__} ({error}); return a status instead."
        ) from error

    def demand(condition: bool, complaint: str) -> None:
        _require(condition, solver.name, label, complaint)

    demand(isinstance(solution, Solution), f"returned {type(solution).__name__}, not a Solution")
    demand(isinstance(solution.status, QPStatus), "status is not a QPStatus")
    demand(solution.x.shape == (qp.n,), f"x has shape {solution.x.shape}, not ({qp.n},)")
    demand(solution.lam.shape == (qp.m,), f"lam has shape {solution.lam.shape}, not ({qp.m},)")
    demand(solution.iterations >= 0, "iterations is negative")
    demand(bool(solution.message), "the message is empty")
    others = ("active-set",) if solver.on_uncertified == "exact" else ()
    demand(solution.finished_by in (solver.name, *others), f"finished by {solution.finished_by!r}, not by itself")
    counted = int(solution.finished_by != solver.name)
    demand(solution.finishes - finishes == counted, "an answer finished by the exact method is not counted once")
    after = (qp.E, qp.K, qp.M, qp.gamma)
    same: Callable[[Array, Array], bool] = np.array_equal
    demand(all(same(a, b) for a, b in zip(before, after, strict=True)), "it wrote to the problem's arrays")
    if solution.solved:
        demand(bool(np.isfinite(solution.x).all()), "solved, but x is not finite")
        demand(bool((solution.lam >= 0.0).all()), "a multiplier is negative")
        worst = kkt_residuals(qp, solution.x, solution.lam).worst
        demand(worst <= WELL_CONDITIONED, f"solved, but the optimality conditions miss by {worst:.1e}")
    return solution

"""The quadratic programme behind each control step, and the solvers that answer it.

from adaptrack.control.qp import QP, get_qp_solver

solution = get_qp_solver("active-set").solve(QP(E, K, M, gamma))
solution.x, solution.status.sentence, solution.residuals
"""

from adaptrack.control.qp.check import check_qp_solver
from adaptrack.control.qp.problem import QP, Attempt, QPStatus, Residuals, Solution, kkt_residuals
from adaptrack.control.qp.registry import get_qp_solver, list_qp_solvers, register_qp_solver
from adaptrack.control.qp.solver import QPSolver

__all__ = [
    "QP",
    "Attempt",
    "QPSolver",
    "QPStatus",
    "Residuals",
    "Solution",
    "check_qp_solver",
    "get_qp_solver",
    "kkt_residuals",
    "list_qp_solvers",
    "register_qp_solver",
]

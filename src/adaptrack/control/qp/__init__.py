"""The quadratic programme behind each control step, and the solvers that answer it.

from adaptrack.control.qp import QP, get_qp_solver

solution = get_qp_solver("active-set").solve(QP(E, K, M, gamma))
solution.x, solution.status.sentence, solution.residuals
"""

from typing import Any

from adaptrack.base.checked import checked
from adaptrack.base.errors import UnknownName, did_you_mean
from adaptrack.control.qp.problem import QP, Attempt, QPStatus, Residuals, Solution, kkt_residuals
from adaptrack.control.qp.solver import ActiveSet, Hildreth, QPSolver

QP_SOLVERS: dict[str, type[QPSolver]] = {ActiveSet.name: ActiveSet, Hildreth.name: Hildreth}


@checked
def get_qp_solver(name: str = ActiveSet.name, **options: Any) -> QPSolver:
    """Return a new solver, "active-set" or "hildreth"; ``options`` go to its class.

    Raises `UnknownName`, with the nearest name.
    """
    if name not in QP_SOLVERS:
        raise UnknownName(f"There is no QP solver {name!r}. {did_you_mean(name, QP_SOLVERS)}")
    return QP_SOLVERS[name](**options)


__all__ = [
    "QP",
    "ActiveSet",
    "Attempt",
    "Hildreth",
    "QPSolver",
    "QPStatus",
    "Residuals",
    "Solution",
    "get_qp_solver",
    "kkt_residuals",
]

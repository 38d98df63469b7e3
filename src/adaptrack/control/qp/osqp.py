"""OSQP (Stellato et al. 2020): operator splitting."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from scipy import sparse

from adaptrack.base.errors import InvalidInput
from adaptrack.control.qp.problem import QP, Attempt, QPStatus, Solution
from adaptrack.control.qp.solver import (
    OnUncertified,
    QPSolver,
    all_multipliers,
    present_rows,
    require,
    unfit_status,
)


class Osqp(QPSolver):
    """OSQP with eps_abs = eps_rel = 1e-10 (its default: 1e-3) and up to 200,000 iterations.

    A first-order method: on ill-conditioned problems it often ends CAPPED. ``settings`` overrides OSQP's settings.
    ``on_uncertified``: see `QPSolver`.
    """

    name: ClassVar[str] = "osqp"
    accuracy: ClassVar[float] = 1e-3

    def __init__(self, on_uncertified: OnUncertified = "exact", **settings: Any) -> None:
        super().__init__(on_uncertified)
        require("osqp", self.name)
        self._settings = {
            "verbose": False, "eps_abs": 1e-10, "eps_rel": 1e-10, "max_iter": 200_000,
            "adaptive_rho_interval": 50,  # by iterations, not by the clock: the same problem gives the same bits
            **settings,
        }  # fmt: skip

    def attempt(self, qp: QP, warm_start: Solution | None = None) -> Attempt:
        """See `QPSolver.attempt`."""
        if (unfit := unfit_status(qp)) is not None:
            return Attempt(unfit)
        rows, M, gamma = present_rows(qp)
        names = self._library.SolverStatus
        statuses = {
            names.OSQP_SOLVED: QPStatus.SOLVED,
            names.OSQP_PRIMAL_INFEASIBLE: QPStatus.INFEASIBLE,
            names.OSQP_PRIMAL_INFEASIBLE_INACCURATE: QPStatus.INFEASIBLE,
            names.OSQP_NON_CVX: QPStatus.NOT_CONVEX,
        }
        problem = self._library.OSQP()
        try:
            problem.setup(
                P=sparse.csc_matrix(np.triu(qp.E)), q=np.array(qp.K), A=sparse.csc_matrix(M),
                l=np.full(len(rows), -np.inf), u=gamma, **self._settings,
            )  # fmt: skip
            if warm_start is not None and np.isfinite(warm_start.x).all() and warm_start.x.shape == (qp.n,):
                problem.warm_start(x=warm_start.x, y=warm_start.lam[rows])
            result = problem.solve(raise_error=False)
        except (ValueError, self._library.OSQPException) as error:
            raise InvalidInput(f"osqp refuses the problem or its settings: {error}") from error
        status = statuses.get(result.info.status_val, QPStatus.CAPPED)
        if status not in (QPStatus.SOLVED, QPStatus.CAPPED):
            return Attempt(status, iterations=result.info.iter)
        return Attempt(status, np.array(result.x), all_multipliers(qp, rows, result.y), result.info.iter)

"""Clarabel (Goulart and Chen 2024): an interior-point method with a homogeneous embedding."""

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
    unfit_status,
)


class Clarabel(QPSolver):
    """Clarabel with tol_feas = tol_gap_abs = tol_gap_rel = 1e-11 (its default: 1e-8), one thread.

    ``settings`` overrides Clarabel's settings; ``on_uncertified``: see `QPSolver`.
    """

    name: ClassVar[str] = "clarabel"
    accuracy: ClassVar[float] = 1e-3

    def __init__(self, on_uncertified: OnUncertified = "exact", **settings: Any) -> None:
        super().__init__(on_uncertified)
        known = self._library.DefaultSettings()
        tight = {"verbose": False, "max_threads": 1, "tol_feas": 1e-11, "tol_gap_abs": 1e-11, "tol_gap_rel": 1e-11}
        self._settings = {**tight, **settings}
        for key in self._settings:
            if not hasattr(known, key):
                raise InvalidInput(f"clarabel has no setting {key!r}.")

    def attempt(self, qp: QP, warm_start: Solution | None = None) -> Attempt:
        """See `QPSolver.attempt`. The warm start is not used: an interior-point method cannot."""
        if (unfit := unfit_status(qp)) is not None:
            return Attempt(unfit)
        library = self._library
        own = library.DefaultSettings()
        for key, value in self._settings.items():
            setattr(own, key, value)
        rows, M, gamma = present_rows(qp)
        cones = [library.NonnegativeConeT(len(rows))] if len(rows) else []
        solver = library.DefaultSolver(
            sparse.csc_matrix(np.triu(qp.E)), np.array(qp.K), sparse.csc_matrix(M), gamma, cones, own
        )
        result = solver.solve()
        statuses = {
            str(library.SolverStatus.Solved): QPStatus.SOLVED,
            str(library.SolverStatus.AlmostSolved): QPStatus.SOLVED,  # where 1e-11 is out of reach; residuals decide
            str(library.SolverStatus.PrimalInfeasible): QPStatus.INFEASIBLE,
            str(library.SolverStatus.AlmostPrimalInfeasible): QPStatus.INFEASIBLE,
        }
        status = statuses.get(str(result.status), QPStatus.CAPPED)
        if status not in (QPStatus.SOLVED, QPStatus.CAPPED):
            return Attempt(status, iterations=result.iterations)
        lam = all_multipliers(qp, rows, np.array(result.z))
        return Attempt(status, np.array(result.x), lam, result.iterations)

"""PIQP (Schwan et al. 2023): a proximal interior-point method."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

from adaptrack.base.errors import InvalidInput
from adaptrack.control.qp.problem import QP, Attempt, QPStatus, Solution
from adaptrack.control.qp.solver import (
    OnUncertified,
    QPSolver,
    all_multipliers,
    present_rows,
    unfit_status,
)


class Piqp(QPSolver):
    """PIQP (dense) with eps_abs = 1e-10 and eps_rel = 1e-11 (its defaults: 1e-8 and 1e-9).

    ``settings`` overrides PIQP's settings; ``on_uncertified``: see `QPSolver`.
    """

    name: ClassVar[str] = "piqp"
    accuracy: ClassVar[float] = 1e-3

    def __init__(self, on_uncertified: OnUncertified = "exact", **settings: Any) -> None:
        super().__init__(on_uncertified)
        self._settings = {"eps_abs": 1e-10, "eps_rel": 1e-11, **settings}
        known = self._library.DenseSolver().settings
        for key in self._settings:
            if not hasattr(known, key):
                raise InvalidInput(f"piqp has no setting {key!r}.")

    def attempt(self, qp: QP, warm_start: Solution | None = None) -> Attempt:
        """See `QPSolver.attempt`. The warm start is not used: an interior-point method cannot."""
        if (unfit := unfit_status(qp)) is not None:
            return Attempt(unfit)
        rows, M, gamma = present_rows(qp)
        solver = self._library.DenseSolver()
        for key, value in self._settings.items():
            setattr(solver.settings, key, value)
        limits = (M, None, gamma) if len(rows) else (None, None, None)
        solver.setup(np.array(qp.E), np.array(qp.K), None, None, *limits)
        flag = solver.solve()
        statuses = {
            self._library.PIQP_SOLVED: QPStatus.SOLVED,
            self._library.PIQP_PRIMAL_INFEASIBLE: QPStatus.INFEASIBLE,
        }
        status = statuses.get(flag, QPStatus.CAPPED)
        iterations = solver.result.info.iter
        if status not in (QPStatus.SOLVED, QPStatus.CAPPED):
            return Attempt(status, iterations=iterations)
        lam = np.asarray(solver.result.z_u) if len(rows) else np.zeros(0)
        return Attempt(status, np.array(solver.result.x), all_multipliers(qp, rows, lam), iterations)

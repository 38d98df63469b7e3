"""DAQP (Arnstrom, Bemporad and Axehill 2022): a dual active-set solver in C, the independent peer of our own."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

from adaptrack.control.qp.problem import QP, Attempt, QPStatus, Solution
from adaptrack.control.qp.solver import OnUncertified, QPSolver, all_multipliers, is_finite, present_rows, require

_STATUS = {
    1: QPStatus.SOLVED,
    2: QPStatus.SOLVED,
    -1: QPStatus.INFEASIBLE,
    -5: QPStatus.NOT_CONVEX,
    -6: QPStatus.INFEASIBLE,
}
"""DAQP's exit flags; the others (cycling, iteration limit) are CAPPED."""

_NO_LOWER_BOUND = -1e30


class Daqp(QPSolver):
    """DAQP with tolerances tightened from 1e-6 to 1e-11 (primal) and from 1e-12 to 1e-14 (dual).

    It works in plain double precision: at cond(E) ~ 1e11 its x[0] is good to about 1e-6 rad.
    ``settings`` overrides DAQP's settings (``primal_tol``, ``dual_tol``, ``iter_limit``, ...).
    ``on_uncertified``: see `QPSolver`.
    """

    name: ClassVar[str] = "daqp"
    accuracy: ClassVar[float] = 1e-4

    def __init__(self, on_uncertified: OnUncertified = "exact", **settings: Any) -> None:
        super().__init__(on_uncertified)
        require("daqp", self.name)
        self._settings = {"primal_tol": 1e-11, "dual_tol": 1e-14, "iter_limit": 10_000, **settings}

    def attempt(self, qp: QP, warm_start: Solution | None = None) -> Attempt:
        """See `QPSolver.attempt`. The warm start is not used: DAQP starts from scratch as quickly."""
        if not is_finite(qp):
            return Attempt(QPStatus.NON_FINITE)
        rows, M, gamma = present_rows(qp)
        x, _, flag, info = self._library.solve(
            np.array(qp.E), np.array(qp.K), M, gamma, np.full(len(rows), _NO_LOWER_BOUND),
            np.zeros(len(rows), dtype=np.int32), **self._settings,
        )  # fmt: skip
        status = _STATUS.get(flag, QPStatus.CAPPED)
        if status not in (QPStatus.SOLVED, QPStatus.CAPPED):
            return Attempt(status, iterations=info["iterations"])
        return Attempt(status, np.array(x), all_multipliers(qp, rows, info["lam"]), info["iterations"])

"""DAQP (Arnstrom, Bemporad and Axehill 2022): a dual active-set solver in C, the oracle of our own."""

from __future__ import annotations

from typing import ClassVar

import daqp
import numpy as np

from adaptrack.control.qp import QP, Attempt, QPSolver, QPStatus, Solution

_STATUS = {
    1: QPStatus.SOLVED, 2: QPStatus.SOLVED, -1: QPStatus.INFEASIBLE, -5: QPStatus.NOT_CONVEX, -6: QPStatus.INFEASIBLE,
}  # fmt: skip
"""DAQP's exit flags; the others (cycling, iteration limit) are CAPPED."""

_NO_LOWER_BOUND = -1e30


class Daqp(QPSolver):
    """DAQP with tolerances tightened from 1e-6 to 1e-11 (primal) and from 1e-12 to 1e-14 (dual).

    It works in plain double precision: at cond(E) ~ 1e11 its x[0] is good to about 1e-6 rad.
    """

    name: ClassVar[str] = "daqp"

    def attempt(self, qp: QP, warm_start: Solution | None = None) -> Attempt:
        """See `QPSolver.attempt`. The warm start is not used: DAQP starts from scratch as quickly."""
        finite = all(np.isfinite(array).all() for array in (qp.E, qp.K, qp.M))
        if not finite or not (qp.gamma > -np.inf).all():
            return Attempt(QPStatus.NON_FINITE)
        rows = np.flatnonzero(qp.gamma < np.inf)
        x, _, flag, info = daqp.solve(
            np.array(qp.E), np.array(qp.K), np.ascontiguousarray(qp.M[rows]), qp.gamma[rows],
            np.full(len(rows), _NO_LOWER_BOUND), np.zeros(len(rows), dtype=np.int32),
            primal_tol=1e-11, dual_tol=1e-14, iter_limit=10_000,
        )  # fmt: skip
        status = _STATUS.get(flag, QPStatus.CAPPED)
        if status not in (QPStatus.SOLVED, QPStatus.CAPPED):
            return Attempt(status, iterations=info["iterations"])
        lam = np.zeros(qp.m)
        lam[rows] = np.maximum(info["lam"], 0.0)
        return Attempt(status, np.array(x), lam, info["iterations"])

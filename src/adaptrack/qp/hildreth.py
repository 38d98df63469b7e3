"""The paper's solver: Hildreth's procedure, and what to do when it has not converged."""

from __future__ import annotations

from typing import ClassVar, Literal, get_args

import numpy as np

from adaptrack.errors import InvalidInput
from adaptrack.qp.kernel import Workspace
from adaptrack.qp.problem import QP, QPStatus, Solution
from adaptrack.qp.solver import QPSolver

OnUncertified = Literal["exact", "apply", "hold"]


class Hildreth(QPSolver):
    """Hildreth's cyclic dual ascent (1957), with the paper's cap and tolerance.

    Parameters
    ----------
    max_sweeps : sweeps over all rows; 38 in the authors' code
    tolerance : stop when a sweep changes the multipliers by less, squared and summed; 1e-7 in the authors' code
    on_uncertified : when the result is not certified (cap reached, or rows violated though the multipliers rest):
        ``"exact"``: the exact active-set method finishes (the default);
        ``"apply"``: hand the iterate on with the status CAPPED (what the authors' code does, without saying so);
        ``"hold"``: the status CAPPED and x = NaN, so that the controller holds its safe angle.

    A warm start begins from its multipliers.
    """

    name: ClassVar[str] = "hildreth"
    accuracy: ClassVar[float] = 1e-6

    def __init__(self, max_sweeps: int = 38, tolerance: float = 1e-7, on_uncertified: OnUncertified = "exact") -> None:
        if not max_sweeps >= 1:
            raise InvalidInput(f"max_sweeps is {max_sweeps}; at least 1 is needed.")
        if not (np.isfinite(tolerance) and tolerance >= 0.0):
            raise InvalidInput(f"tolerance is {tolerance}; a number >= 0 is needed.")
        if on_uncertified not in get_args(OnUncertified):
            raise InvalidInput(f"on_uncertified is {on_uncertified!r}; choose 'exact', 'apply' or 'hold'.")
        self.max_sweeps = int(max_sweeps)
        self.tolerance = float(tolerance)
        self.on_uncertified = on_uncertified
        self._workspace = Workspace()

    def solve(self, qp: QP, warm_start: Solution | None = None) -> Solution:
        """See `QPSolver.solve`; ``iterations`` counts sweeps (plus the exact method's steps where it finished)."""
        workspace = self._workspace
        status = workspace.load(qp, hildreth=True)
        if status is not QPStatus.SOLVED:
            return self._answer(qp, status, None, None, 0)
        start = None
        if warm_start is not None and warm_start.lam.shape == (qp.m,) and np.isfinite(warm_start.lam).all():
            start = warm_start.lam
        status, sweeps = workspace.hildreth(self.max_sweeps, self.tolerance, start)
        message = ""
        if status is QPStatus.CAPPED and self.on_uncertified == "exact":
            status, steps = workspace.active_set(1000)
            message = f"Not certified after {sweeps} sweeps; the exact method finished. {status.sentence}"
            sweeps += steps
        keep = status is QPStatus.SOLVED or (status is QPStatus.CAPPED and self.on_uncertified == "apply")
        x, lam = workspace.result() if keep else (None, None)
        return self._answer(qp, status, x, lam, sweeps, message, certified=True)

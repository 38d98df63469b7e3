"""The paper's solver: Hildreth's procedure, and what to do when it has not converged."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from adaptrack.base.checked import Count, NotNegative, checked
from adaptrack.control.qp.kernel import Workspace
from adaptrack.control.qp.problem import QP, Attempt, QPStatus, Solution
from adaptrack.control.qp.solver import OnUncertified, QPSolver


class Hildreth(QPSolver):
    """Hildreth's cyclic dual ascent (1957), with the paper's cap and tolerance.

    Parameters
    ----------
    max_sweeps : sweeps over all rows; 38 in the authors' code
    tolerance : stop when a sweep changes the multipliers by less, squared and summed; 1e-7 in the authors' code
    on_uncertified : see `QPSolver`; ``"apply"`` is what the authors' code does, without saying so. Not certified: cap
        reached, or rows violated though the multipliers rest

    A warm start begins from its multipliers.
    """

    name: ClassVar[str] = "hildreth"

    @checked
    def __init__(
        self, max_sweeps: Count = 38, tolerance: NotNegative = 1e-7, on_uncertified: OnUncertified = "exact"
    ) -> None:
        super().__init__(on_uncertified)
        self.max_sweeps, self.tolerance = max_sweeps, tolerance
        self._workspace = Workspace()

    def attempt(self, qp: QP, warm_start: Solution | None = None) -> Attempt:
        """See `QPSolver.attempt`; ``iterations`` counts sweeps."""
        status = self._workspace.load(qp, hildreth=True)
        if status is not QPStatus.SOLVED:
            return Attempt(status)
        start = None
        if warm_start is not None and warm_start.lam.shape == (qp.m,) and np.isfinite(warm_start.lam).all():
            start = warm_start.lam
        status, sweeps = self._workspace.hildreth(self.max_sweeps, self.tolerance, start)
        return Attempt(status, *self._workspace.result(), sweeps, certified=status is QPStatus.SOLVED)

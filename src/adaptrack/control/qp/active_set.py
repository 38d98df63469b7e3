"""The default: the package's own exact dual active-set method."""

from __future__ import annotations

from typing import ClassVar

from adaptrack.base.checked import whole_number
from adaptrack.control.qp.kernel import Workspace
from adaptrack.control.qp.problem import QP, Attempt, Solution
from adaptrack.control.qp.solver import EXACT_SOLVER, QPSolver


class ActiveSet(QPSolver):
    """Goldfarb and Idnani's dual active-set method (1983), its result refined in twice the working precision.

    ``max_iterations``: changes of the active set at most, by default `core.qp.problem.CHANGES` (n + m). The method ends
    by itself, within a few tens for the controller's problems; the cap is for the unforeseen. An MPC in the kernels
    holds to it, too: a capped step follows the last plan. A warm start begins from its active rows. It is the method
    that finishes what others leave uncertified; its own such answers leave nothing to apply.
    """

    name: ClassVar[str] = EXACT_SOLVER

    def __init__(self, max_iterations: int | None = None) -> None:
        super().__init__(on_uncertified="hold")
        self.max_iterations = (
            None if max_iterations is None else whole_number("ActiveSet", "max_iterations", max_iterations)
        )
        self._workspace = Workspace()

    def attempt(self, qp: QP, warm_start: Solution | None = None) -> Attempt:
        """See `QPSolver.attempt`."""
        return self._workspace.solve_exactly(qp, warm_start, self.max_iterations)

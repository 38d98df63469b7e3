"""The default: the package's own exact dual active-set method."""

from __future__ import annotations

from typing import ClassVar

from adaptrack.errors import InvalidInput
from adaptrack.qp.kernel import Workspace
from adaptrack.qp.problem import QP, QPStatus, Solution
from adaptrack.qp.solver import Attempt, QPSolver


class ActiveSet(QPSolver):
    """Goldfarb and Idnani's dual active-set method (1983), its result refined in twice the working precision.

    ``max_iterations``: changes of the active set, default 1000. The method ends by itself, within a few tens for
    the controller's problems; the cap is for the unforeseen. A warm start begins from its active rows. It is the
    method that finishes what others leave uncertified; its own such answers leave nothing to apply.
    """

    name: ClassVar[str] = "active-set"
    accuracy: ClassVar[float] = 1e-9

    def __init__(self, max_iterations: int = 1000) -> None:
        if not max_iterations >= 1:
            raise InvalidInput(f"max_iterations is {max_iterations}; at least 1 is needed.")
        super().__init__(on_uncertified="hold")
        self.max_iterations = int(max_iterations)
        self._workspace = Workspace()

    def attempt(self, qp: QP, warm_start: Solution | None = None) -> Attempt:
        """See `QPSolver.attempt`."""
        status = self._workspace.load(qp)
        if status is not QPStatus.SOLVED:
            return Attempt(status)
        guess = None if warm_start is None or warm_start.lam.shape != (qp.m,) else warm_start.lam
        status, iterations = self._workspace.active_set(self.max_iterations, guess)
        if status is not QPStatus.SOLVED:
            return Attempt(status, iterations=iterations)
        return Attempt(status, *self._workspace.result(), iterations, certified=True)

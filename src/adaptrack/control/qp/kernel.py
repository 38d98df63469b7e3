"""From validated problems to the padded arrays of the kernels and back."""

from __future__ import annotations

import numpy as np

from adaptrack.control.qp.problem import QP, Array, Attempt, QPStatus, Solution
from adaptrack.core.layout import aligned
from adaptrack.core.maths.vectors import padded
from adaptrack.core.qp import problem as kernels
from adaptrack.core.qp.active_set import active_set
from adaptrack.core.qp.factor import factorise
from adaptrack.core.qp.hildreth import hildreth


class Workspace:
    """The kernels' arrays, grown when a larger problem comes, and the factor of the last E."""

    def __init__(self) -> None:
        self._n = self._m = -1
        self._with_h = False

    def load(self, qp: QP, hildreth: bool = False) -> QPStatus:
        """Copy the problem in and factorise E: the status of the factorisation."""
        n, m = qp.n, qp.m
        if n > self._n or m > self._m or (hildreth and not self._with_h):
            self._grow(max(n, self._n), max(m, self._m), hildreth or self._with_h)
        E, Mt = self._E, self._Mt
        E[:n, :n] = qp.E
        self._K[:n] = qp.K
        Mt[:n, :m] = qp.M.T
        self._gamma[:m] = qp.gamma
        self.problem = kernels.Problem(n, m, E, self._K, Mt, self._gamma)
        status, condition = factorise(n, E, self._inverses)
        self.factor = kernels.factor_of(self._inverses, condition)
        return QPStatus(status)

    def _grow(self, n: int, m: int, with_h: bool) -> None:
        self._n, self._m, self._with_h = n, m, with_h
        inverses, work, rows, index = kernels.workspace_sizes(n, m, with_h)
        width, depth = padded(n), padded(m)
        self._E, self._Mt = aligned((n, width)), aligned((n, depth))
        self._K, self._gamma = aligned((width,)), aligned((depth,))
        self._inverses = aligned(inverses)
        self.solution = kernels.SolutionRecord(aligned((width,)), aligned((depth,)))
        self.scratch = kernels.Scratch(aligned(work), aligned(rows), aligned((index,), np.int64))

    def solve_exactly(self, qp: QP, warm_start: Solution | None = None, max_iterations: int | None = None) -> Attempt:
        """Solve ``qp`` by the exact method, starting from the active rows of an earlier solution if there is one.

        max_iterations: changes of the active set at most, by default `CHANGES` (n + m).
        """
        status = self.load(qp)
        if status is not QPStatus.SOLVED:
            return Attempt(status)
        guess = None if warm_start is None or warm_start.lam.shape != (qp.m,) else warm_start.lam
        most = kernels.CHANGES * (qp.n + qp.m) if max_iterations is None else max_iterations
        status, iterations = self.active_set(most, guess)
        if status is not QPStatus.SOLVED:
            return Attempt(status, iterations=iterations)
        return Attempt(status, *self.result(), iterations, certified=True)

    def active_set(self, max_iterations: int, guess: Array | None = None) -> tuple[QPStatus, int]:
        """Run the exact solver, from the active rows of the multipliers ``guess`` if given: status and iterations."""
        is_warm = 0
        if guess is not None:
            likely = np.flatnonzero(guess > 0.0)[: self.problem.n]
            is_warm = len(likely)
            self.scratch.index[:is_warm] = likely
        status, iterations, _ = active_set(
            self.problem, self.factor, self.solution, self.scratch, is_warm, False, max_iterations
        )
        return QPStatus(status), iterations

    def hildreth(self, max_sweeps: int, tolerance: float, start: Array | None) -> tuple[QPStatus, int]:
        """Run Hildreth's procedure from the multipliers ``start``, or from zero: status and sweeps."""
        if start is not None:
            self.solution.lam[: self.problem.m] = start
        status, sweeps = hildreth(
            self.problem, self.factor, self.solution, self.scratch, max_sweeps, tolerance, start is not None
        )
        return QPStatus(status), sweeps

    def result(self) -> tuple[Array, Array]:
        """Copies of x and lam."""
        return self.solution.x[: self.problem.n].copy(), self.solution.lam[: self.problem.m].copy()

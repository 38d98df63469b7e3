"""From validated problems to the padded arrays of the kernels and back."""

from __future__ import annotations

import numpy as np

from adaptrack.kernels import qp as kernels
from adaptrack.kernels.maths.vectors import padded
from adaptrack.qp.problem import QP, Array, QPStatus


class Workspace:
    """The kernels' arrays, grown when a larger problem comes, and the factor of the E seen last."""

    def __init__(self) -> None:
        self._n = self._m = -1
        self._with_h = False

    def load(self, qp: QP, hildreth: bool = False) -> QPStatus:
        """Copy the problem in and factorise E: the status of the factorisation."""
        n, m = qp.n, qp.m
        if n > self._n or m > self._m or (hildreth and not self._with_h):
            self._n, self._m, self._with_h = max(n, self._n), max(m, self._m), hildreth or self._with_h
            shapes = kernels.workspace_sizes(self._n, self._m, self._with_h)
            width, depth = padded(self._n), padded(self._m)
            self.E, self.Mt = kernels.aligned((self._n, width)), kernels.aligned((self._n, depth))
            self.K, self.x = kernels.aligned((width,)), kernels.aligned((width,))
            self.gamma, self.lam = kernels.aligned((depth,)), kernels.aligned((depth,))
            self.factor, self.work = kernels.aligned(shapes["factor"]), kernels.aligned(shapes["work"])
            self.rows, self.index = kernels.aligned(shapes["rows"]), np.zeros(shapes["index"], dtype=np.int64)
        self.E[:n, :n] = qp.E
        self.K[:n] = qp.K
        self.Mt[:n, :m] = qp.M.T
        self.gamma[:m] = qp.gamma
        self.n, self.m = n, m
        status, self.condition = kernels.factorise(n, self.E, self.factor)
        return QPStatus(status)

    def active_set(self, max_iterations: int, guess: Array | None = None) -> tuple[QPStatus, int]:
        """Run the exact solver, from the active rows of the multipliers ``guess`` if given: status and iterations."""
        known = 0
        if guess is not None:
            likely = np.flatnonzero(guess > 0.0)[: self.n]
            known = len(likely)
            self.index[:known] = likely
        status, iterations, _ = kernels.active_set(
            self.n, self.m, self.E, self.K, self.Mt, self.gamma, self.factor, self.condition, self.x, self.lam,
            self.work, self.rows, self.index, known, False, max_iterations,
        )  # fmt: skip
        return QPStatus(status), iterations

    def hildreth(self, max_sweeps: int, tolerance: float, start: Array | None) -> tuple[QPStatus, int]:
        """Run Hildreth's procedure from the multipliers ``start``, or from zero: status and sweeps."""
        if start is not None:
            self.lam[: self.m] = start
        status, sweeps = kernels.hildreth(
            self.n, self.m, self.E, self.K, self.Mt, self.gamma, self.factor, self.condition, self.x, self.lam,
            self.work, self.rows, self.index, max_sweeps, tolerance, start is not None,
        )  # fmt: skip
        return QPStatus(status), sweeps

    def result(self) -> tuple[Array, Array]:
        """Copies of x and lam."""
        return self.x[: self.n].copy(), self.lam[: self.m].copy()

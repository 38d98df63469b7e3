"""The contract between the controller and whatever solves its quadratic programme."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar

import numpy as np

from adaptrack.qp.problem import QP, Array, QPStatus, Residuals, Solution, kkt_residuals

ACCEPTED = 1e-6
"""A solver's "solved" is believed when no scaled residual exceeds this; else the status is CAPPED."""
NEAR = 1e-4
"""... and when a Newton step moves x by no more than this (rad): at cond(E) ~ 1e11 small residuals prove little."""


class QPSolver(ABC):
    """Solves one QP at a time.

    A subclass names itself, states the accuracy of x[0] that it promises when E is ill-conditioned (cond(E) ~ 1e11;
    rad) and implements `solve`. The contract, which `adaptrack.qp.check_qp_solver` tests:

    * `solve` returns a `Solution` for every QP; it raises nothing for infeasible, capped or non-finite problems;
    * it does not write to the problem's arrays;
    * without a warm start, the same problem gives the same bits;
    * a warm start (an earlier `Solution` of a problem of the same shape) may change the effort, not the answer.

    A solver may keep a workspace between calls, so each thread needs its own.
    """

    name: ClassVar[str]
    accuracy: ClassVar[float]

    @abstractmethod
    def solve(self, qp: QP, warm_start: Solution | None = None) -> Solution:
        """The minimiser of ``qp``, or a status that says why there is none."""

    def _answer(
        self,
        qp: QP,
        status: QPStatus,
        x: Array | None,
        lam: Array | None,
        iterations: int,
        message: str = "",
        certified: bool = False,
    ) -> Solution:
        """A `Solution` with its residuals.

        "Solved" is not taken on trust unless ``certified``: where `ACCEPTED` or `NEAR` contradict it, the status
        becomes CAPPED and nothing is left to apply.
        """
        residuals = Residuals(*[float("nan")] * 4)
        if x is not None and lam is not None:
            residuals = kkt_residuals(qp, x, lam)
            if status is QPStatus.SOLVED and not certified:
                away = newton_distance(qp, x, lam)
                if not (residuals.worst <= ACCEPTED and away <= NEAR):
                    status, x = QPStatus.CAPPED, None
                    message = (
                        f"{self.name} reported a solution whose optimality conditions miss by {residuals.worst:.1e} "
                        f"and which is about {away:.1e} rad from the true one."
                    )
        if x is None or lam is None:
            x, lam = np.full(qp.n, np.nan), np.full(qp.m, np.nan)
        return Solution(x, lam, status, residuals, int(iterations), self.name, message or status.sentence)


def newton_distance(qp: QP, x: Array, lam: Array) -> float:
    """How far a Newton step on the equations of the rows that press would move x: an estimate of its error (rad).

    A row presses when its multiplier outweighs its slack, each relative to its kind.
    """
    slack = qp.gamma - qp.M @ x
    there = np.isfinite(slack)
    relative = np.abs(slack[there]) / (1.0 + np.abs(qp.gamma[there]))
    pressing = np.flatnonzero(there)[lam[there] / (1.0 + lam.max(initial=0.0)) > relative]
    N, n, q = qp.M[pressing], qp.n, len(pressing)
    kkt = np.zeros((n + q, n + q))
    kkt[:n, :n], kkt[:n, n:], kkt[n:, :n] = qp.E, N.T, N
    right = np.concatenate([-(qp.E @ x + qp.K + N.T @ lam[pressing]), slack[pressing]])
    scale = 1.0 / np.sqrt(np.maximum(np.abs(kkt).max(axis=1), np.finfo(float).tiny))
    try:
        step = scale * np.linalg.solve(kkt * scale[:, None] * scale[None, :], scale * right)
    except np.linalg.LinAlgError:  # rows that depend on each other: the shortest of the possible steps
        step = scale * np.linalg.lstsq(kkt * scale[:, None] * scale[None, :], scale * right)[0]
    return float(np.abs(step[:n]).max())


def is_finite(qp: QP) -> bool:
    """Whether the data are usable: no NaN, no infinity except +inf in gamma."""
    return bool(
        np.isfinite(qp.E).all()
        and np.isfinite(qp.K).all()
        and np.isfinite(qp.M).all()
        and (qp.gamma > -np.inf).all()  # false for NaN, too
    )


def is_convex(qp: QP) -> bool:
    """Whether E has a Cholesky factor: asked before back-ends that would settle for a stationary point."""
    try:
        np.linalg.cholesky(qp.E)
    except np.linalg.LinAlgError:
        return False
    return True


def present_rows(qp: QP) -> tuple[np.ndarray, Array, Array]:
    """Indices, M and gamma of the rows that have a bound."""
    rows = np.flatnonzero(qp.gamma < np.inf)
    return rows, np.ascontiguousarray(qp.M[rows]), np.ascontiguousarray(qp.gamma[rows])


def all_multipliers(qp: QP, rows: np.ndarray, lam: Array) -> Array:
    """Multipliers of all rows: those given, not below zero, and zero for absent rows."""
    result = np.zeros(qp.m)
    result[rows] = np.maximum(lam, 0.0)
    return result

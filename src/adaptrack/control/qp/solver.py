"""The contract between the controller and whatever solves its quadratic programme."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar, Literal

import numpy as np

from adaptrack.base.checked import checked
from adaptrack.control.qp.kernel import Workspace
from adaptrack.control.qp.problem import QP, Array, Attempt, QPStatus, Residuals, Solution, kkt_residuals
from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import product

ACCEPTED = 1e-6
"""A solver's "solved" is believed when no scaled residual exceeds this; else the answer is not certified."""
MAX_NEWTON_STEP = 1e-4
"""... and when a Newton step moves x by no more than this (rad): at cond(E) ~ 1e11 small residuals prove little."""

EXACT_SOLVER = "active-set"
"""The solver that finishes what others leave: `Workspace.solve_exactly` under its name."""

OnUncertified = Literal["exact", "apply", "hold"]


class QPSolver(ABC):
    """Solves one QP at a time.

    A subclass names itself and implements `attempt`. `solve` tests what it found and acts on what is not certified.
    The contract:

    * `solve` returns a `Solution` for every QP; it raises nothing for infeasible, capped or non-finite problems;
    * it does not write to the problem's arrays;
    * without a warm start, the same problem gives the same bits;
    * a warm start (an earlier `Solution` of a problem of the same shape) may change the effort, not the answer.

    Parameters
    ----------
    on_uncertified : what becomes of an answer that is neither certified as solved nor about data that are not finite:
        ``"exact"``: the exact active-set method finishes (the default);
        ``"apply"``: hand the iterate on with the status CAPPED;
        ``"hold"``: its status, and x = NaN, so that the controller has no move to apply.

    A solver may keep a workspace between calls, so each thread needs its own.
    """

    name: ClassVar[str]
    on_uncertified: OnUncertified = "exact"
    finishes: int = 0
    """How many answers the exact method has finished so far."""
    _exact: Workspace | None = None

    @checked
    def __init__(self, on_uncertified: OnUncertified = "exact") -> None:
        self.on_uncertified = on_uncertified

    @abstractmethod
    def attempt(self, qp: QP, warm_start: Solution | None = None) -> Attempt:
        """Run the method on ``qp``; the status says how it ended."""

    def solve(self, qp: QP, warm_start: Solution | None = None) -> Solution:
        """The minimiser of ``qp``, or a status that says why there is none."""
        attempt = self._tested(qp, self.attempt(qp, warm_start))
        if self.on_uncertified == "exact" and attempt.status not in (QPStatus.SOLVED, QPStatus.NON_FINITE):
            return self._finished(qp, attempt)
        return self._solution(qp, attempt, self.name)

    def _tested(self, qp: QP, attempt: Attempt) -> Attempt:
        """Return the attempt; its status is CAPPED where `ACCEPTED` or `MAX_NEWTON_STEP` contradict "solved"."""
        if attempt.status is not QPStatus.SOLVED or attempt.certified:
            return attempt
        if (
            attempt.x is None
            or attempt.lam is None
            or not (np.isfinite(attempt.x).all() and np.isfinite(attempt.lam).all())
        ):
            return attempt._replace(status=QPStatus.CAPPED, x=None)
        worst = kkt_residuals(qp, attempt.x, attempt.lam).worst
        newton_step = newton_distance(qp, attempt.x, attempt.lam)
        if worst <= ACCEPTED and newton_step <= MAX_NEWTON_STEP:
            return attempt
        message = (
            f"{self.name} reported a solution whose optimality conditions miss by {worst:.1e} "
            f"and which is about {newton_step:.1e} rad from the true one."
        )
        return attempt._replace(status=QPStatus.CAPPED, message=message)

    def _finished(self, qp: QP, attempt: Attempt) -> Solution:
        """Polish the attempt by the exact method."""
        self._exact = self._exact or Workspace()
        self.finishes += 1
        exact = self._exact.solve_exactly(qp)
        why = attempt.message or f"{self.name} ended with {attempt.status.name} after {attempt.iterations} iterations."
        message = f"{why} Not certified: the exact method finished. {exact.message or exact.status.sentence}"
        exact = exact._replace(iterations=attempt.iterations + exact.iterations, message=message)
        return self._solution(qp, exact, EXACT_SOLVER)

    def _solution(self, qp: QP, attempt: Attempt, finished_by: str) -> Solution:
        """The answer with its residuals, and NaN where there is nothing to apply."""
        x, lam = attempt.x, attempt.lam
        residuals = Residuals(*[float("nan")] * 4)
        if x is not None and lam is not None:
            residuals = kkt_residuals(qp, x, lam)
        applied = attempt.status is QPStatus.SOLVED or (
            attempt.status is QPStatus.CAPPED and self.on_uncertified == "apply"
        )
        if x is None or lam is None or not applied:
            x, lam = np.full(qp.n, np.nan), np.full(qp.m, np.nan)
        message = attempt.message or attempt.status.sentence
        return Solution(
            x, lam, attempt.status, residuals, int(attempt.iterations), self.name, message, finished_by, self.finishes
        )


def newton_distance(qp: QP, x: Array, lam: Array) -> float:
    """How far a Newton step on the equations of the rows that press would move x: an estimate of its error (rad).

    A row presses when its multiplier outweighs its slack, each relative to its kind.
    """
    slack = qp.gamma - product(qp.M, x)
    there = np.isfinite(slack)
    relative = np.abs(slack[there]) / (1.0 + np.abs(qp.gamma[there]))
    pressing = np.flatnonzero(there)[lam[there] / (1.0 + lam.max(initial=0.0)) > relative]
    N, n, q = qp.M[pressing], qp.n, len(pressing)
    kkt = np.zeros((n + q, n + q))
    kkt[:n, :n], kkt[:n, n:], kkt[n:, :n] = qp.E, N.T, N
    right = np.concatenate([-(product(qp.E, x) + qp.K + product(N.T, lam[pressing])), slack[pressing]])
    scale = 1.0 / np.sqrt(np.maximum(np.abs(kkt).max(axis=1), np.finfo(float).tiny))
    try:
        step = scale * portable.solve(kkt * scale[:, None] * scale[None, :], scale * right)
    except portable.LinAlgError:  # rows that depend on each other: the shortest of the possible steps
        step = scale * product(portable.pseudo_inverse(kkt * scale[:, None] * scale[None, :]), scale * right)
    return float(np.abs(step[:n]).max())

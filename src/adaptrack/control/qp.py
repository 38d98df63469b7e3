"""The quadratic programme behind each control step, its solution, and the solvers that find it.

    minimise  1/2 x'E x + x'K   subject to   M x <= gamma        E symmetric positive definite

In the controller x holds the moves (or the coefficients of their Laguerre functions), in radians.

    solution = get_qp_solver("active-set").solve(QP(E, K, M, gamma))
    solution.x, solution.status.sentence, solution.residuals
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from adaptrack.base.checked import Count, NotNegative, checked, reals
from adaptrack.base.errors import InvalidInput, UnknownName, did_you_mean
from adaptrack.core.layout import aligned
from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import Array, product
from adaptrack.core.maths.vectors import padded
from adaptrack.core.qp import problem as kernels
from adaptrack.core.qp.active_set import active_set
from adaptrack.core.qp.factor import factorise
from adaptrack.core.qp.hildreth import hildreth

SYMMETRY = 1e-9
"""E may differ from its transpose by this part of its largest entry; the symmetric part is kept."""


class QPStatus(IntEnum):
    """How a solve ended; the numbers are those of the kernels."""

    SOLVED = 0
    CAPPED = 1
    INFEASIBLE = 2
    NOT_CONVEX = 3
    NON_FINITE = 4

    @property
    def sentence(self) -> str:
        """The outcome and its remedy as a sentence."""
        return _SENTENCES[self]


_SENTENCES = {
    QPStatus.SOLVED: "Solved: the optimality conditions hold.",
    QPStatus.CAPPED: (
        "Stopped before the optimality conditions held: allow more iterations, or use the exact solver ('active-set')."
    ),
    QPStatus.INFEASIBLE: (
        "No x satisfies every row of M x <= gamma: widen the limits that contradict each other "
        "(often a previous angle outside its own limits), or make the limits on y soft."
    ),
    QPStatus.NOT_CONVEX: (
        "E is not positive definite to working precision: give the moves a positive weight R, "
        "or drop variables that nothing determines."
    ),
    QPStatus.NON_FINITE: (
        "E, K, M or gamma holds NaN or an infinity (gamma may hold +inf, a row that is absent): "
        "check the measured state and the reference."
    ),
}


@dataclass(frozen=True, eq=False)
class QP:
    """A strictly convex quadratic programme.

    Parameters
    ----------
    E : (n, n), symmetric positive definite
    K : (n,)
    M : (m, n); m may be 0
    gamma : (m,); ``+inf`` says that the row is absent

    The arrays are copied, checked and made read-only. Raises `InvalidInput` for wrong shapes, NaN, infinities (other
    than ``+inf`` in gamma) or an unsymmetric E. Whether E is positive definite is found when it is factorised
    (`QPStatus.NOT_CONVEX`).
    """

    E: Array
    K: Array
    M: Array = field(default_factory=lambda: np.zeros((0, 0)))
    gamma: Array = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        E = _array("E", self.E, 2)
        K = _array("K", self.K, 1)
        n = len(K)
        if n == 0:
            raise InvalidInput("K is empty: a QP needs at least one variable.")
        if E.shape != (n, n):
            raise InvalidInput(f"E has shape {E.shape}; K has {n} entries, so E must be ({n}, {n}).")
        gamma = _array("gamma", self.gamma, 1)
        M = np.asarray(self.M, dtype=float)
        M = np.zeros((0, n)) if M.size == 0 and len(gamma) == 0 else _array("M", M, 2)
        if M.shape != (len(gamma), n):
            raise InvalidInput(f"M has shape {M.shape}; with {n} variables and {len(gamma)} bounds in gamma it must be "
                               f"({len(gamma)}, {n}).")  # fmt: skip
        for name, array in (("E", E), ("K", K), ("M", M)):
            if not np.isfinite(array).all():
                raise InvalidInput(f"{name} holds {_first_bad(array)}: check the state, the reference and the weights.")
        if np.isnan(gamma).any() or np.isneginf(gamma).any():
            raise InvalidInput("gamma holds NaN or -inf: a bound is a number, or +inf where there is none.")
        gap = float(np.abs(E - E.T).max())
        if gap > SYMMETRY * float(np.abs(E).max()):
            raise InvalidInput(f"E is not symmetric (E - E' reaches {gap:.3g}); pass (E + E')/2.")
        E = (E + E.T) / 2 if gap else E
        for name, array in (("E", E), ("K", K), ("M", M), ("gamma", gamma)):
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    @classmethod
    def unchecked(cls, E: Array, K: Array, M: Array, gamma: Array) -> QP:
        """Build the problem without copies and checks; the caller guarantees the arrays."""
        qp = object.__new__(cls)
        for name, array in (("E", E), ("K", K), ("M", M), ("gamma", gamma)):
            object.__setattr__(qp, name, array)
        return qp

    @property
    def n(self) -> int:
        """How many variables."""
        return len(self.K)

    @property
    def m(self) -> int:
        """How many rows."""
        return len(self.gamma)

    def cost(self, x: npt.ArrayLike) -> float:
        """``1/2 x'E x + x'K``."""
        x = np.asarray(x, dtype=float)
        return float(product(product(0.5 * x, self.E), x) + product(x, self.K))


def _array(name: str, value: npt.ArrayLike, dimensions: int) -> Array:
    array = np.array(reals(name, value), order="C")
    if array.ndim != dimensions:
        raise InvalidInput(f"{name} has {array.ndim} dimension(s), not {dimensions}.")
    return array


def _first_bad(array: Array) -> str:
    where = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
    return f"{array[where]} at {list(where)}"


class Residuals(NamedTuple):
    """The violation of each optimality condition, scaled; all zero at the solution. See `kkt_residuals`."""

    stationarity: float
    primal: float
    dual: float
    complementarity: float

    @property
    def worst(self) -> float:
        """The largest of the four; NaN if one is."""
        return float(np.max(self))


def kkt_residuals(qp: QP, x: npt.ArrayLike, lam: npt.ArrayLike) -> Residuals:
    """How far (x, lam) is from the solution, in max norms:

        stationarity    = |E x + K + M' lam| / (1 + largest of |E x|, |K|, |M' lam|)
        primal          = max_j (M_j x - gamma_j)^+ / (1 + |M x|)
        dual            = max_j (-lam_j)^+ / (1 + |lam|)
        complementarity = max_j lam_j^+ |M_j x - gamma_j| / ((1 + |lam|) (1 + |M x|))

    The kernels compute the same (`adaptrack.core.qp.residual`); rows with gamma = inf and lam = 0 do not count.
    """
    x, lam = np.asarray(x, dtype=float), np.asarray(lam, dtype=float)
    with np.errstate(invalid="ignore", over="ignore"):
        image, gradient, force = product(qp.M, x), product(qp.E, x), product(qp.M.T, lam)
        pressed = lam > 0.0
        gap = image - qp.gamma
        terms = 1.0 + max(np.abs(v).max(initial=0.0) for v in (gradient, qp.K, force))
        reach = 1.0 + np.abs(image).max(initial=0.0)
        weight = 1.0 + lam.max(initial=0.0)
        return Residuals(
            float(np.abs(gradient + qp.K + force).max() / terms),
            float(gap.max(initial=0.0) / reach),
            float((-lam).max(initial=0.0) / weight),
            float((lam[pressed] * np.abs(gap[pressed])).max(initial=0.0) / (weight * reach)),
        )


@dataclass(frozen=True, eq=False)
class Solution:
    """The minimiser that a solver returns, with multipliers and status.

    ``x`` (n,), the moves in rad; NaN when there is nothing to apply. ``lam`` (m,), the rows' multipliers, >= 0.
    ``residuals`` as `kkt_residuals` defines them; ``iterations`` in the solver's own unit; ``message``: a sentence.
    ``finished_by``: the method that gave x, ``solver`` itself or "active-set" where its own answer was not certified;
    ``finishes``: how many answers of this solver the exact method has finished so far, this one included.
    """

    x: Array
    lam: Array
    status: QPStatus
    residuals: Residuals
    iterations: int
    solver: str
    message: str
    finished_by: str
    finishes: int

    @property
    def solved(self) -> bool:
        """Whether x is the solution, certified."""
        return self.status is QPStatus.SOLVED

    @property
    def usable(self) -> bool:
        """Whether x may steer: solved, or an uncertified x that the solver was configured to hand on."""
        return self.status in (QPStatus.SOLVED, QPStatus.CAPPED) and bool(np.isfinite(self.x).all())


class Attempt(NamedTuple):
    """The raw result of one method, before it is tested and polished."""

    status: QPStatus
    x: Array | None = None
    """(n,); None: nothing"""
    lam: Array | None = None
    """(m,) multipliers, >= 0"""
    iterations: int = 0
    certified: bool = False
    """whether the method has proved "solved" itself; it is tested otherwise"""
    message: str = ""
    """instead of the status's sentence"""


# -- solvers -----------------------------------------------------------------------------------------------------------
ACCEPTED = 1e-6
"""A solver's "solved" is believed when no scaled residual exceeds this; else the answer is not certified."""
MAX_NEWTON_STEP = 1e-4
"""... and when a Newton step moves x by no more than this (rad): at cond(E) ~ 1e11 small residuals prove little."""

EXACT_SOLVER = "active-set"
"""The solver that finishes what others leave: `Workspace.solve_exactly` under its name."""

OnUncertified = Literal["exact", "apply", "hold"]


class Workspace:
    """The padded arrays of the kernels, grown when a larger problem comes, and the factor of the last E."""

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


class ActiveSet(QPSolver):
    """Goldfarb and Idnani's dual active-set method (1983), its result refined in twice the working precision.

    ``max_iterations``: changes of the active set at most, by default `core.qp.problem.CHANGES` (n + m). The method ends
    by itself, within a few tens for the controller's problems; the cap is for the unforeseen. An MPC in the kernels
    holds to it, too: a capped step follows the last plan. A warm start begins from its active rows. It is the method
    that finishes what others leave uncertified; its own such answers leave nothing to apply.
    """

    name: ClassVar[str] = EXACT_SOLVER

    @checked
    def __init__(self, max_iterations: Count | None = None) -> None:
        super().__init__(on_uncertified="hold")
        self.max_iterations = max_iterations
        self._workspace = Workspace()

    def attempt(self, qp: QP, warm_start: Solution | None = None) -> Attempt:
        return self._workspace.solve_exactly(qp, warm_start, self.max_iterations)


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


QP_SOLVERS: dict[str, type[QPSolver]] = {ActiveSet.name: ActiveSet, Hildreth.name: Hildreth}


@checked
def get_qp_solver(name: str = ActiveSet.name, **options: Any) -> QPSolver:
    """Return a new solver, "active-set" or "hildreth"; ``options`` go to its class.

    Raises `UnknownName`, with the nearest name.
    """
    if name not in QP_SOLVERS:
        raise UnknownName(f"There is no QP solver {name!r}. {did_you_mean(name, QP_SOLVERS)}")
    return QP_SOLVERS[name](**options)

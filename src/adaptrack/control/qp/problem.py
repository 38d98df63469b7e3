"""The quadratic programme of the paper's eq. (17), its solution, and how far a pair (x, lam) is from it.

    minimise  1/2 x'E x + x'K   subject to   M x <= gamma        E symmetric positive definite

In the controller x holds the moves (or the coefficients of their Laguerre functions), in radians.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from adaptrack.base.checked import reals
from adaptrack.base.errors import InvalidInput
from adaptrack.core.maths.portable import product

Array = npt.NDArray[np.float64]

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

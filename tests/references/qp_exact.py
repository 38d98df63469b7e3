"""The solution of a strictly convex QP to as many digits as asked, and the proof that it is the solution.

Independent of the package: exact integer arithmetic decides, floating point only proposes. Every float64 of the
problem is an integer multiple of 2**-SCALE; residuals and slacks are computed in Python integers, so without any
rounding. A point that satisfies the Karush-Kuhn-Tucker conditions of a strictly convex QP *is* its minimiser, so a
pair (x, lam) whose conditions hold to 1e-30 needs no trust in whoever proposed its active set.

    minimise 1/2 x'E x + x'K  subject to  M x <= gamma

`reference_solve` refines the equations of the proposed active set (float64 LU, exact residuals), exchanges rows that
prove violated or superfluous, and falls back on a dual active-set method in mpmath (Goldfarb and Idnani 1983) that
proposes nothing but computes with 80 digits.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import mpmath
import numpy as np
import numpy.typing as npt
from scipy.linalg import LinAlgWarning, lu_factor, lu_solve

Array = npt.NDArray[np.float64]

SCALE = 320
"""Fixed-point numbers are integer multiples of 2**-320 (about 5e-97): finer than any double that matters here."""


@dataclass(frozen=True)
class Reference:
    """x and lam rounded to float64; ``residual``: the largest violation of the KKT conditions, relative to their terms;
    ``bound``: the first-order change of x_0 when every datum changes by half a unit in its last place.
    """

    x: Array
    lam: Array
    active: tuple[int, ...]
    residual: float
    bound: float
    exact: bool  # whether the mpmath fall-back was needed


class Infeasible(Exception):
    """No x satisfies the rows."""


def _fixed(a: npt.ArrayLike) -> npt.NDArray[np.object_]:
    """Floats as exact fixed-point integers."""

    def convert(value: float) -> int:
        numerator, denominator = float(value).as_integer_ratio()
        return (numerator << SCALE) // denominator

    return np.vectorize(convert, otypes=[object])(np.asarray(a, dtype=float))


def _floats(a: npt.NDArray[np.object_], scale: int) -> Array:
    """Fixed-point integers as floats, correctly rounded by Python's integer division."""
    unit = 1 << scale
    return np.array([int(v) / unit for v in a], dtype=float)


class _Exact:
    """The problem in integers."""

    def __init__(self, E: Array, K: Array, M: Array, gamma: Array) -> None:
        self.E, self.K, self.M, self.gamma = E, K, M, gamma
        self.present = np.flatnonzero(np.isfinite(gamma))
        self.Ei, self.Ki = _fixed(E), _fixed(K)
        self.Mi = _fixed(M) if M.size else np.zeros(M.shape, dtype=object)
        self.gi = _fixed(np.where(np.isfinite(gamma), gamma, 0.0)) if gamma.size else np.zeros(0, dtype=object)

    def refine(self, active: list[int], digits: int) -> tuple[npt.NDArray, npt.NDArray] | None:
        """x and u (integers) on an active set, or None where float64 cannot even start (dependent rows)."""
        n, q = len(self.K), len(active)
        N = self.M[active]
        kkt = np.zeros((n + q, n + q))
        kkt[:n, :n], kkt[:n, n:], kkt[n:, :n] = self.E, N.T, N
        scale = np.ones(n + q)
        for _ in range(3):  # symmetric equilibration
            largest = np.abs(kkt * scale[:, None] * scale[None, :]).max(axis=1)
            if not np.all(largest > 0):
                return None
            scale /= np.sqrt(largest)
        scale = 2.0 ** np.round(np.log2(scale))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", LinAlgWarning)  # dependent rows: handled below
            lu = lu_factor(kkt * scale[:, None] * scale[None, :], check_finite=False)
        if np.abs(np.diag(lu[0])).min() < 1e-17:
            return None
        x, u = np.zeros(n, dtype=object), np.zeros(q, dtype=object)
        Ni, gi = self.Mi[active], self.gi[active]
        previous = np.inf
        for _ in range(60):
            top = -(self.Ki << SCALE) - self.Ei.dot(x) - (Ni.T.dot(u) if q else 0)
            bottom = (gi << SCALE) - Ni.dot(x) if q else np.zeros(0, dtype=object)
            right = np.concatenate([_floats(top, 2 * SCALE), _floats(bottom, 2 * SCALE)])
            size = float(np.abs(right * scale).max())
            if size == 0.0:
                return x, u
            step = scale * lu_solve(lu, right * scale, check_finite=False)
            if not np.all(np.isfinite(step)):
                return None
            x, u = x + _fixed(step[:n]), (u + _fixed(step[n:]) if q else u)
            if np.abs(step).max() < 10.0**-digits:
                return x, u
            moved = float(np.abs(step / scale).max())
            if moved > 0.5 * previous and previous < 1e-3:
                return None
            previous = moved
        return None

    def slack(self, x: npt.NDArray) -> Array:
        """M x - gamma, -inf for absent rows; the rounding to float comes last."""
        result = np.full(len(self.gamma), -np.inf)
        p = self.present
        if p.size:
            result[p] = _floats(self.Mi[p].dot(x) - (self.gi[p] << SCALE), 2 * SCALE)
        return result

    def stationarity(self, x: npt.NDArray, lam: npt.NDArray) -> Array:
        residual = self.Ei.dot(x) + (self.Ki << SCALE)
        if len(lam):
            residual = residual + self.Mi.T.dot(lam)
        return _floats(residual, 2 * SCALE)


def reference_solve(
    E: Array, K: Array, M: Array, gamma: Array, guess: npt.ArrayLike = (), digits: int = 30
) -> Reference:
    """The minimiser, verified: every KKT condition holds to ``10**-digits`` (absolute, in the problem's units).

    ``guess``: indices of the rows believed active, from any solver. Raises `Infeasible`.
    """
    problem = _Exact(E, K, M, gamma)
    tiny = 10.0**-digits
    active = [int(i) for i in np.asarray(guess, dtype=int)]
    visited: set[tuple[int, ...]] = set()
    while tuple(sorted(active)) not in visited and len(visited) < 50 and len(active) <= len(K):
        visited.add(tuple(sorted(active)))
        refined = problem.refine(active, digits + 5)
        if refined is None:
            break
        x, u = refined
        multipliers = _floats(u, SCALE) if len(u) else np.zeros(0)
        slack = problem.slack(x)
        if active:
            slack[active] = 0.0
        if multipliers.size and multipliers.min() < -tiny:
            active.pop(int(multipliers.argmin()))
        elif slack.size and slack.max() > tiny:
            active.append(int(slack.argmax()))
        else:
            return _certificate(problem, x, u, active, exact=False)
    x_mp, u_mp, active = _dual_active_set(problem, 80)
    x, u = _from_mpmath(x_mp), _from_mpmath(u_mp)
    return _certificate(problem, x, u, active, exact=True)


def exact_residual(E: Array, K: Array, M: Array, gamma: Array, x: Array, lam: Array) -> float:
    """The largest violation of the KKT conditions by the float64 pair (x, lam), evaluated without rounding.

    Each is relative to one plus the sum of the sizes of its terms; complementarity to the largest multiplier as well.
    """
    problem = _Exact(E, K, M, gamma)
    xi = _fixed(x)
    lami = _fixed(lam) if len(lam) else np.zeros(0, dtype=object)
    terms = 1.0 + np.abs(E) @ np.abs(x) + np.abs(K) + (np.abs(M).T @ np.abs(lam) if len(lam) else 0.0)
    worst = [float((np.abs(problem.stationarity(xi, lami)) / terms).max())]
    if len(lam):
        point = problem.present
        slack = problem.slack(xi)[point] / (1.0 + np.abs(M[point]) @ np.abs(x) + np.abs(gamma[point]))
        worst += [float(slack.max(initial=0.0)), float((-lam).max() / (1.0 + np.abs(lam).max()))]
        worst += [float((lam[point] * np.abs(slack)).max(initial=0.0) / (1.0 + lam.max()))]
        worst += [float(np.delete(lam, point).max(initial=0.0))]
    return max(worst)


def _certificate(
    problem: _Exact, x: npt.NDArray, u: npt.NDArray, active: list[int], exact: bool, tiny: float = 1e-25
) -> Reference:
    """Check every KKT condition in integers; the result, with the bound that float64 data allow."""
    lam = np.zeros(len(problem.gamma), dtype=object)
    lam[active] = u
    x_f, lam_f = _floats(x, SCALE), _floats(lam, SCALE) if len(lam) else np.zeros(0)
    slack = problem.slack(x)
    forces = np.abs(problem.E) @ np.abs(x_f) + np.abs(problem.K)
    forces = forces + (np.abs(problem.M).T @ np.abs(lam_f) if len(lam_f) else 0.0)
    residual = float((np.abs(problem.stationarity(x, lam)) / (1.0 + forces)).max())
    if slack.size:
        residual = max(residual, float(slack.max()), float((-lam_f).max(initial=0.0)))
    if active:
        residual = max(residual, float(np.abs(slack[active]).max()))
    if not residual < tiny:
        raise AssertionError(f"the reference could not be verified: residual {residual:.1e}")
    return Reference(x_f, lam_f, tuple(active), residual, _data_bound(problem, x_f, lam_f, active), exact)


def _data_bound(problem: _Exact, x: Array, lam: Array, active: list[int]) -> float:
    """First-order bound on |dx_0| when E, K, M and gamma each change by half a unit in the last place (2**-53).

    dx = S (dE x + dK + dN u) + Y (dgamma - dN' x): [S Y] is the top of the inverse of [E N; N' 0].
    """
    n, q = len(x), len(active)
    N, u = problem.M[active], lam[active]
    kkt = np.zeros((n + q, n + q))
    kkt[:n, :n], kkt[:n, n:], kkt[n:, :n] = problem.E, N.T, N
    scale = 1.0 / np.sqrt(np.maximum(np.abs(kkt).max(axis=1), 1e-300))
    try:
        unit = np.zeros(n + q)
        unit[0] = scale[0]
        row = scale * np.linalg.solve(kkt * scale[:, None] * scale[None, :], unit)
    except np.linalg.LinAlgError:
        return float("inf")
    forces = np.abs(problem.E) @ np.abs(x) + np.abs(problem.K) + np.abs(N).T @ np.abs(u)
    bounds = np.abs(problem.gamma[active]) + np.abs(N) @ np.abs(x)
    return float(2.0**-53 * (np.abs(row[:n]) @ forces + np.abs(row[n:]) @ bounds))


# -------------------------------------------------------------------------------------------------------- fall-back


def _from_mpmath(values: list[mpmath.mpf]) -> npt.NDArray[np.object_]:
    with mpmath.workdps(200):
        return np.array([int(mpmath.nint(mpmath.ldexp(v, SCALE))) for v in values], dtype=object)


def _dual_active_set(problem: _Exact, digits: int) -> tuple[list[mpmath.mpf], list[mpmath.mpf], list[int]]:
    """Goldfarb and Idnani's method with every solve done afresh in ``digits`` digits: slow, and hard to get wrong."""
    with mpmath.workdps(digits):
        n = len(problem.K)
        tiny = mpmath.mpf(10) ** (-digits // 2)
        E = mpmath.matrix(problem.E.tolist())
        K = mpmath.matrix(problem.K.tolist())
        rows = [mpmath.matrix(r.tolist()) for r in problem.M]
        gamma = [mpmath.mpf(float(g)) for g in problem.gamma]
        lower = mpmath.cholesky(E)

        def solve(b: mpmath.matrix) -> mpmath.matrix:  # L^-1 b
            out = mpmath.matrix(n, 1)
            for i in range(n):
                out[i] = (b[i] - sum(lower[i, k] * out[k] for k in range(i))) / lower[i, i]
            return out

        def back(b: mpmath.matrix) -> mpmath.matrix:  # L^-T b
            out = mpmath.matrix(n, 1)
            for i in reversed(range(n)):
                out[i] = (b[i] - sum(lower[k, i] * out[k] for k in range(i + 1, n))) / lower[i, i]
            return out

        images = [solve(r) for r in rows]  # in these coordinates E is the identity
        z = -solve(K)
        bounds = gamma
        active: list[int] = []
        u: list[mpmath.mpf] = []
        for _ in range(40 * (n + len(rows)) + 40):
            slack = [
                (mpmath.fdot(images[j], z) - bounds[j])
                if j not in active and mpmath.isfinite(bounds[j])
                else -mpmath.inf
                for j in range(len(rows))
            ]
            p = max(range(len(rows)), key=lambda j: slack[j]) if rows else -1
            if p < 0 or slack[p] <= tiny * (1 + abs(bounds[p])):
                x = back(z)
                return list(x), u, active
            multiplier = mpmath.mpf(0)
            while True:
                a = images[p]
                if active:
                    gram = mpmath.matrix(len(active), len(active))
                    right = mpmath.matrix(len(active), 1)
                    for i, ai in enumerate(active):
                        right[i] = mpmath.fdot(images[ai], a)
                        for k, ak in enumerate(active):
                            gram[i, k] = mpmath.fdot(images[ai], images[ak])
                    r = mpmath.lu_solve(gram, right)
                else:
                    r = mpmath.matrix(0, 1)
                direction = a.copy()
                for i, ai in enumerate(active):
                    direction -= images[ai] * r[i]
                square = mpmath.fdot(direction, direction)
                violation = mpmath.fdot(a, z) - bounds[p]
                dependent = square <= tiny * mpmath.fdot(a, a)
                ratios = [(u[i] / r[i], i) for i in range(len(active)) if r[i] > tiny]
                partial, place = min(ratios) if ratios else (mpmath.inf, -1)
                full = mpmath.inf if dependent else violation / square
                if dependent and not ratios:
                    raise Infeasible
                step = min(partial, full)
                if not dependent:
                    z -= direction * step
                u = [u[i] - step * r[i] for i in range(len(active))]
                multiplier += step
                if full <= partial:
                    active.append(p)
                    u.append(multiplier)
                    break
                active.pop(place)
                u.pop(place)
        raise AssertionError("the reference did not terminate")

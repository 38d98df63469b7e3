"""Hildreth's procedure exactly as the textbooks print it, with nothing saved: the oracle of the efficient kernel.

Luenberger, Optimization by Vector Space Methods (1969), section 10.10; Wang, Model Predictive Control System Design
(2009), section 2.4. Written from the formulas.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def hildreth(
    E: Array,
    K: Array,
    M: Array,
    gamma: Array,
    max_sweeps: int = 38,
    tolerance: float = 1e-7,
    start: Array | None = None,
) -> tuple[Array, Array, int]:
    """(x, lam, sweeps)."""
    x = -np.linalg.solve(E, K)
    lam = np.zeros(len(gamma)) if start is None else np.array(start)
    if not (M @ x > gamma).any():
        return x, np.zeros(len(gamma)), 0
    H = M @ np.linalg.solve(E, M.T)
    d = gamma + M @ np.linalg.solve(E, K)
    sweeps = 0
    while sweeps < max_sweeps:
        sweeps += 1
        previous = lam.copy()
        for i in range(len(lam)):
            coupling = sum(H[i, j] * lam[j] for j in range(len(lam)) if j != i)
            lam[i] = max(0.0, -(d[i] + coupling) / H[i, i])
        if ((lam - previous) ** 2).sum() < tolerance:
            break
    return -np.linalg.solve(E, K + M.T @ lam), lam, sweeps

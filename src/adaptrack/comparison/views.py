"""The ranking of contenders in a comparison whose runs are measured in full."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from adaptrack.comparison.table import Comparison


def standing_rows(comparison: Comparison) -> list[dict[str, Any]]:
    """One row for each contender, from the best RMS error to the worst.

    Ratios to the reference with their intervals, ranks (see `Comparison.ranks`); RMS of the runs' RMS errors, median of
    their 95th percentiles, largest corner error (m), RMS steering rate (rad/s), 95th percentile of the lateral
    accelerations and jerks (m/s^2, m/s^3).
    """
    ranks = comparison.ranks()
    rows = [_standing(comparison, name, ranks[name]) for name in comparison.contenders]
    return sorted(rows, key=lambda row: (row["rank"], row["rms_ratio"]))


def _standing(comparison: Comparison, name: str, rank: int) -> dict[str, Any]:
    over, cost = comparison.ratio(name, comparison.reference, "rms_error"), comparison.ratio(name, comparison.reference)
    role, failed = comparison.role(name), comparison.of(name, "failed")
    return {
        "contender": role.controller, "tuning": role.tuning, "label": name, "rank": rank,
        "rms_ratio": over.mean, "rms_low": over.low, "rms_high": over.high,
        "cost_ratio": cost.mean, "cost_low": cost.low, "cost_high": cost.high,
        "rms_error": _rms(comparison.of(name, "rms_error")),
        "p95_error": _percentile(comparison.of(name, "p95_error"), 50.0),
        "max_corner": _percentile(comparison.of(name, "max_corner"), 100.0),
        "steering_rate": _rms(comparison.of(name, "steering_rate")),
        "acceleration": _percentile(comparison.of(name, "acceleration"), 95.0),
        "jerk": _percentile(comparison.of(name, "jerk"), 95.0),
        "runs": int(np.isfinite(failed).sum()), "failures": int(np.nansum(failed)),
    }  # fmt: skip


def _rms(values: NDArray[Any]) -> float:
    return float(np.sqrt(np.nanmean(values**2))) if np.isfinite(values).any() else float("nan")


def _percentile(values: NDArray[Any], percent: float, missing: float = float("nan")) -> float:
    return float(np.nanpercentile(values, percent)) if np.isfinite(values).any() else missing

"""Rows of tables on a comparison whose runs are measured in full."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from adaptrack.comparison.table import Comparison


def road_rows(made: Comparison) -> list[dict[str, Any]]:
    """One row for each contender on roads: its cost and the ratio to the reference (95 % interval), errors, failures.

    `cost_mean` is the mean J (m^2) over roads and noise seeds, which `tune_constant` minimises; `rms_error` and
    `p95_error` (m) are of the steps of all runs, `max_...` the largest of any; `failed` says where, when and why.
    """
    kept = ("contender", "controller", "cost_geomean", "regret_geomean", "regret_low", "regret_high")
    rows = []
    for row in made.rows():
        name = row["contender"]
        failed = failed_runs(made, name)
        rows.append({
            **{key: row[key] for key in kept},
            "cost_mean": float(np.mean(made.of(name, "cost"))),
            **made.overall[name],
            "max_abs_error": _percentile(made.of(name, "max_error"), 100.0, np.inf),
            "max_corner_error": _percentile(made.of(name, "max_corner"), 100.0, np.inf),
            "runs": made.of(name, "cost").size,
            "failures": len(failed),
            "failed": failed,
        })  # fmt: skip
    return rows


def failed_runs(made: Comparison, name: str) -> list[dict[str, Any]]:
    """The failed runs of a contender: road, noise seed, reason, when (s), and "the vehicle ..."."""
    reason, at, because = (made.of(name, measure) for measure in ("reason", "failed_at", "because"))
    return [
        {"road": made.roads[j], "seed": made.seeds[k], "reason": str(reason[i, j, k]), "at": float(at[i, j, k]),
         "because": str(because[i, j, k])}
        for i, j, k in zip(*np.nonzero(made.of(name, "failed")), strict=True)
    ]  # fmt: skip


def standing_rows(made: Comparison) -> list[dict[str, Any]]:
    """One row for each contender on cars and roads, from the best RMS error to the worst.

    Ratios to the reference with their intervals, ranks (see `Comparison.ranks`); RMS of the runs' RMS errors, median of
    their 95th percentiles, largest corner error (m), RMS steering rate (rad/s), 95th percentile of the lateral
    accelerations and jerks (m/s^2, m/s^3).
    """
    ranks = made.ranks()
    rows = [_standing(made, name, ranks[name]) for name in made.contenders]
    return sorted(rows, key=lambda row: (row["rank"], row["rms_ratio"]))


def _standing(made: Comparison, name: str, rank: int) -> dict[str, Any]:
    over, cost = made.ratio(name, made.reference, "rms_error"), made.ratio(name, made.reference)
    role, failed = made.role(name), made.of(name, "failed")
    return {
        "contender": role.controller, "tuning": role.tuning, "label": name, "rank": rank,
        "rms_ratio": over.mean, "rms_low": over.low, "rms_high": over.high,
        "cost_ratio": cost.mean, "cost_low": cost.low, "cost_high": cost.high,
        "rms_error": _rms(made.of(name, "rms_error")), "p95_error": _percentile(made.of(name, "p95_error"), 50.0),
        "max_corner": _percentile(made.of(name, "max_corner"), 100.0),
        "steering_rate": _rms(made.of(name, "steering_rate")),
        "acceleration": _percentile(made.of(name, "acceleration"), 95.0),
        "jerk": _percentile(made.of(name, "jerk"), 95.0),
        "runs": int(np.isfinite(failed).sum()), "failures": int(np.nansum(failed)),
    }  # fmt: skip


def _rms(values: NDArray[Any]) -> float:
    return float(np.sqrt(np.nanmean(values**2))) if np.isfinite(values).any() else float("nan")


def _percentile(values: NDArray[Any], which: float, missing: float = float("nan")) -> float:
    return float(np.nanpercentile(values, which)) if np.isfinite(values).any() else missing

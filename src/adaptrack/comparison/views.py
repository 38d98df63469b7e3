"""Ranking of contenders in a comparison with all measures of `measures.RUN`, and the measures of whole drivers."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from adaptrack.comparison.config import WITH
from adaptrack.comparison.table import Comparison, label_of


def standing_rows(comparison: Comparison) -> list[dict[str, Any]]:
    """Return one row for each contender, sorted by the rank of its RMS error.

    A row contains, over all runs of the contender:

    - the rank (see `Comparison.ranks`), and the ratios of RMS error and cost to the reference with their intervals;
    - the RMS of the RMS errors, the median of the 95th percentiles of the error and the largest corner error (m);
    - the RMS steering rate (rad/s);
    - the 95th percentiles of lateral acceleration (m/s^2) and jerk (m/s^3);
    - the numbers of runs and failures.
    """
    ranks = comparison.ranks()
    rows = [_standing(comparison, name, ranks[name]) for name in comparison.contenders]
    return sorted(rows, key=lambda row: (row["rank"], row["rms_ratio"]))


def _standing(comparison: Comparison, name: str, rank: int) -> dict[str, Any]:
    rms, cost = comparison.ratio(name, comparison.reference, "rms_error"), comparison.ratio(name, comparison.reference)
    role, failed = comparison.role(name), comparison.of(name, "failed")
    return {
        "contender": role.controller, "tuning": role.tuning, "label": name, "rank": rank,
        "rms_ratio": rms.mean, "rms_low": rms.low, "rms_high": rms.high,
        "cost_ratio": cost.mean, "cost_low": cost.low, "cost_high": cost.high,
        "rms_error": _rms(comparison.of(name, "rms_error")),
        "p95_error": _percentile(comparison.of(name, "p95_error"), 50.0),
        "max_corner": _percentile(comparison.of(name, "max_corner"), 100.0),
        "steering_rate": _rms(comparison.of(name, "steering_rate")),
        "acceleration": _percentile(comparison.of(name, "acceleration"), 95.0),
        "jerk": _percentile(comparison.of(name, "jerk"), 95.0),
        "runs": int(np.isfinite(failed).sum()), "failures": int(np.nansum(failed)),
    }  # fmt: skip


def driver_rows(comparison: Comparison) -> list[dict[str, Any]]:
    """Return one row for each controller with a driver, in the order of the comparison, without a rank.

    A row contains the numbers of runs and failures, and `DRIVER_SUMMARIES` of the runs that did not fail.
    """
    rows = []
    for name in comparison.contenders:
        failed, role = comparison.of(name, "failed"), comparison.role(name)
        controller, _, driver = role.controller.partition(WITH)
        row: dict[str, Any] = {
            "label": name, "controller": controller if role.tuning == "default" else label_of(controller, role.tuning),
            "driver": driver, "runs": int(np.isfinite(failed).sum()), "failures": int(np.nansum(failed)),
        }  # fmt: skip
        for measure, summary in DRIVER_SUMMARIES.items():
            values = comparison.of(name, measure)[failed == 0.0]
            row[measure] = float(summary(values[np.isfinite(values)])) if np.isfinite(values).any() else None
        rows.append(row)
    return rows


def _rms(values: NDArray[Any]) -> float:
    return float(np.sqrt(np.nanmean(values * values))) if np.isfinite(values).any() else float("nan")


def _percentile(values: NDArray[Any], percent: float, missing: float = float("nan")) -> float:
    return float(np.nanpercentile(values, percent)) if np.isfinite(values).any() else missing


DRIVER_SUMMARIES: dict[str, Callable[[NDArray[Any]], Any]] = {
    "time_lost": lambda values: round(float(np.mean(values)), 2) + 0.0,  # a control period is 0.05 s
    "way_driven": np.mean, "speed_error": _rms, "rms_error": _rms, "max_error": np.max,
    "longitudinal_jerk": partial(_percentile, percent=95.0), "used_grip": np.max, "stop_error": np.max,
}  # fmt: skip
"""Function that summarises a measure over the runs."""

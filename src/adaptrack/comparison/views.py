"""Ranking of contenders in a comparison with all measures of `measures.RUN`, and the measures of whole drivers."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

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
    """Return one row for each controller with a driver, without a rank, in the order of the comparison.

    A row contains over the runs that did not fail, with None where there is none:

    - the means of `time_lost`, `way_driven`, `longitudinal_jerk` (m/s^3) and the lateral `jerk` (m/s^3);
    - the RMS of `speed_error` (m/s) and `rms_error` (m);
    - the largest `max_error` (m), `used_grip` and `stop_error` (m), and the sum of `missed_stops`;

    and the numbers of runs and failures.
    """
    return [_driver_row(comparison, name) for name in comparison.contenders]


def _driver_row(comparison: Comparison, name: str) -> dict[str, Any]:
    failed, tuning = comparison.of(name, "failed"), comparison.role(name).tuning
    controller, driver = (str(max(comparison.of(name, field).ravel())) for field in ("controller", "driver"))
    return {
        "controller": controller if tuning in ("default", "scheduled") else label_of(controller, tuning),
        "driver": driver, "label": name, "runs": int(np.isfinite(failed).sum()), "failures": int(np.nansum(failed)),
        **{
            measure: float(summary(values)) if values.size else None
            for measure, summary in DRIVER_SUMMARIES.items()
            for entries in [comparison.of(name, measure)[failed == 0.0]]
            for values in [entries[np.isfinite(entries)]]
        },
    }  # fmt: skip


def _rms(values: NDArray[Any]) -> float:
    return float(np.sqrt(np.nanmean(values**2))) if np.isfinite(values).any() else float("nan")


def _percentile(values: NDArray[Any], percent: float, missing: float = float("nan")) -> float:
    return float(np.nanpercentile(values, percent)) if np.isfinite(values).any() else missing


DRIVER_SUMMARIES: dict[str, Callable[[NDArray[Any]], Any]] = {
    "time_lost": np.mean, "way_driven": np.mean, "speed_error": _rms, "rms_error": _rms, "max_error": np.max,
    "longitudinal_jerk": np.mean, "jerk": np.mean, "used_grip": np.max, "stop_error": np.max, "missed_stops": np.sum,
}  # fmt: skip
"""Summary over the runs of each measure in `driver_rows`."""

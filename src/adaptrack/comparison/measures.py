"""Measures of the runs of a comparison: cost, failure, errors and comfort, and how a driver followed the plan."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from adaptrack.cars.outline import Outline
from adaptrack.drive.metrics import PathRecord, compute_metrics, path_metrics
from adaptrack.drive.speed_measures import speed_measures
from adaptrack.drive.trajectory import Trajectory
from adaptrack.scenario import RoadDrive, Scenario
from adaptrack.tuning.runs import PolicyArgument, RunSet

Array = NDArray[np.float64]

RUN = {
    "rms_error": "rms_error", "p95_error": "p95_error", "max_error": "max_abs_error", "max_corner": "max_corner_error",
    "steering_rate": "steering_rate_rms", "acceleration": "lateral_acceleration_r79", "jerk": "jerk_r79",
    "duration": "duration",
}  # fmt: skip
"""Measures of a run up to its end or failure, with the name of each in `Metrics` and `path_metrics`.

Units in this order: m, m, m, m, rad/s, m/s^2, m/s^3, s.
"""


def measure_runs(
    runs: RunSet, policy: PolicyArgument, seeds: Sequence[int], outline: Outline, *, with_driver: bool = False
) -> list[list[dict[str, Any]]]:
    """Drive every run with every noise seed, as `RunSet.trajectories` does, and return all measures.

    These are for each run and seed `cost` (m^2), `failed`, `reason`, `failed_at` (s) and the measures of `RUN`; None
    for a measure that does not exist. outline: of the car, whose corners are measured; with_driver: whether to add
    `speed_measures`, which need drives along roads.
    """
    return [
        [_run_measures(run, runs, outline, drive if with_driver else None) for run in road]
        for drive, road in zip(runs.scenarios, runs.trajectories(policy, seeds), strict=True)
    ]


def _run_measures(
    run: Trajectory, runs: RunSet, outline: Outline, drive: Scenario | RoadDrive | None
) -> dict[str, Any]:
    metrics, record = compute_metrics(run, failure=runs.failure), PathRecord.from_trajectory(run)
    path = None if record is None else path_metrics(record, outline).as_row()
    return {
        "cost": runs.failed_cost if metrics.failed else metrics.cost,
        "failed": metrics.failed,
        "reason": metrics.failed_reason or "",
        "failed_at": float(metrics.failed_at) if metrics.failed else None,
        **{name: None if path is None else path[key] for name, key in RUN.items()},
        **(speed_measures(run, drive.road, drive.plan) if isinstance(drive, RoadDrive) else {}),
    }


def as_cells(rows: Sequence[Sequence[dict[str, Any]]]) -> dict[str, NDArray[Any]]:
    """Return the result of `measure_runs` as an array (runs, seeds) for each measure, with NaN for None."""
    return {name: as_column([row[name] for road in rows for row in road]).reshape(len(rows), -1) for name in rows[0][0]}


def as_column(values: Sequence[Any]) -> NDArray[Any]:
    """Return values as an array of text, or of numbers with NaN for None."""
    if isinstance(values[0], str):
        return np.array(values)
    return np.array([np.nan if value is None else value for value in values], dtype=float)

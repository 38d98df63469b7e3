"""What is measured of a run in a comparison, and of all runs of a contender together."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from adaptrack.cars.outline import Outline
from adaptrack.drive.metrics import PathRecord, compute_metrics, path_metrics
from adaptrack.drive.trajectory import Trajectory
from adaptrack.tuning.runs import Policy, RunSet

Array = NDArray[np.float64]

RUN = {
    "rms_error": "rms_error", "p95_error": "p95_error", "max_error": "max_abs_error", "max_corner": "max_corner_error",
    "steering_rate": "steering_rate_rms", "acceleration": "lateral_acceleration_r79", "jerk": "jerk_r79",
    "duration": "duration",
}  # fmt: skip
"""Measures of a run until its end or failure, and the `Metrics` that they are: m, m, m, m, rad/s, m/s^2, m/s^3,
s."""
OVERALL = ("rms_error", "p95_error")
"""Of the steps of all runs together: RMS and 95th percentile of the offset (m) of the centre of mass."""


def measure_runs(
    runs: RunSet, policy: Policy, seeds: Sequence[int], outline: Outline
) -> tuple[list[list[dict[str, Any]]], dict[str, float]]:
    """Drive every run with every noise seed, and measure it in full.

    outline: of the car, for the errors of its corners.

    Returns
    -------
    rows
        For each run and seed: `cost` (m^2), `failed`, `reason`, `failed_at` (s), `because` (to complete "the vehicle
        ..."), and `RUN`; None where there is nothing to measure.
    overall
        See `OVERALL`; infinite where nothing was driven.
    """
    rows, offsets = [], []
    for road in runs.trajectories(policy, seeds):  # type: ignore[arg-type]
        records = [PathRecord.from_trajectory(run) for run in road]
        rows.append([_measured(run, record, runs, outline) for run, record in zip(road, records, strict=True)])
        offsets += [np.abs(record.offset) for record in records if record is not None]
    e = np.concatenate(offsets) if offsets else np.array([np.inf])
    return rows, {"rms_error": float(np.sqrt(np.mean(e**2))), "p95_error": float(np.percentile(e, 95.0))}


def _measured(run: Trajectory, record: PathRecord | None, runs: RunSet, outline: Outline) -> dict[str, Any]:
    whole = compute_metrics(run, failure=runs.failure)
    path = None if record is None else path_metrics(record, outline).as_row()
    return {
        "cost": runs.failed_cost if whole.failed else whole.cost,
        "failed": whole.failed,
        "reason": whole.failed_reason or "",
        "failed_at": float(whole.failed_at) if whole.failed else None,
        "because": whole.failed_because or "",
        **{name: None if path is None else path[kept] for name, kept in RUN.items()},
    }


def as_cells(rows: Sequence[Sequence[dict[str, Any]]]) -> dict[str, NDArray[Any]]:
    """By measure, (runs, seeds): the rows of `measure_runs`; NaN for None."""
    return {name: as_column([row[name] for road in rows for row in road]).reshape(len(rows), -1) for name in rows[0][0]}


def as_column(values: Sequence[Any]) -> NDArray[Any]:
    """Texts, or numbers with NaN for None."""
    if isinstance(values[0], str):
        return np.array(values)
    return np.array([np.nan if each is None else each for each in values], dtype=float)

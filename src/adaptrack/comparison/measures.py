"""Measures of the runs of a comparison: cost, failure, errors and comfort, and how a driver followed the plan."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from adaptrack.cars.outline import Outline
from adaptrack.core import portable
from adaptrack.core.public import GRAVITY, STANDING_SPEED
from adaptrack.drive.failure import MIN_JUDGED_SPEED
from adaptrack.drive.metrics import PathRecord, compute_metrics, path_metrics
from adaptrack.drive.signal_statistics import mean_square, r79
from adaptrack.drive.trajectory import Trajectory
from adaptrack.scenario import RoadDrive, Scenario
from adaptrack.tuning.runs import Policy, RunSet

Array = NDArray[np.float64]

RUN = {
    "rms_error": "rms_error", "p95_error": "p95_error", "max_error": "max_abs_error", "max_corner": "max_corner_error",
    "steering_rate": "steering_rate_rms", "acceleration": "lateral_acceleration_r79", "jerk": "jerk_r79",
    "duration": "duration",
}  # fmt: skip
"""Measures of a run up to its end or failure, with the name of each in `Metrics` and `path_metrics`.

Units in this order: m, m, m, m, rad/s, m/s^2, m/s^3, s.
"""
DRIVER_MEASURES = {
    "time_lost": "s", "way_driven": "-", "speed_error": "m/s", "longitudinal_jerk": "m/s^3", "used_grip": "-",
    "stop_error": "m",
}  # fmt: skip
"""Measures of `driver_measures` with their units."""
STOP_DISTANCE = 8.0
"""Largest distance from a stop at which a standing car stops for it, and error of a stop that is passed (m)."""


def measure_runs(
    runs: RunSet, policy: Policy, seeds: Sequence[int], outline: Outline, *, with_driver: bool = False
) -> list[list[dict[str, Any]]]:
    """Drive every run with every noise seed and return all measures.

    Parameters
    ----------
    runs, policy, seeds
        As for `RunSet.trajectories`.
    outline
        Outline of the car, whose corners are measured.
    with_driver
        Whether to add `driver_measures`; all runs must then be drives along roads.

    Returns
    -------
    list of list of dict
        For each run and seed `cost` (m^2), `failed`, `reason`, `failed_at` (s) and the measures of `RUN`; None for a
        measure that does not exist.
    """
    return [
        [_run_measures(run, runs, outline, drive if with_driver else None) for run in road]
        for drive, road in zip(runs.scenarios, runs.trajectories(policy, seeds), strict=True)  # type: ignore[arg-type]
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
        **(driver_measures(run, drive) if isinstance(drive, RoadDrive) else {}),
    }


def driver_measures(run: Trajectory, drive: RoadDrive) -> dict[str, Any]:
    """Return how a car followed the speed plan of a road, up to the end of its run or its failure.

    Returns
    -------
    dict
        None for a measure that does not exist:

        - `time_lost`: delay at the place where the run ends (s);
        - `way_driven`: distance at the end of the run, relative to the planned distance;
        - `speed_error`: RMS of the difference from the speed planned for the place (m/s), where this is 1 m/s or more;
        - `longitudinal_jerk`: largest longitudinal jerk by UN R79 (m/s^3);
        - `used_grip`: largest acceleration of the centre of gravity divided by true friction times gravity;
        - `stop_error`: largest distance from a stop at which the car first stood (m), `STOP_DISTANCE` without standing.
    """
    station, speed, plan = run.road["station"], run.vx, drive.plan
    is_finite = np.isfinite(station) & np.isfinite(speed) & np.isfinite(run.lateral_acceleration)
    end = len(run) if is_finite.all() else int(is_finite.argmin())
    if end < 2:
        return dict.fromkeys(DRIVER_MEASURES)
    t, station, speed = run.t[:end], station[:end], speed[:end]
    planned_speed = plan.at(station)
    is_judged = planned_speed >= MIN_JUDGED_SPEED
    acceleration = np.gradient(speed, t) - run.vy[:end] * run.yaw_rate[:end]
    grip = GRAVITY * drive.road.along("friction", station)
    stop_errors = []
    for stop in plan.stops:
        is_standing = (speed < STANDING_SPEED) & (np.abs(station - stop.s) < STOP_DISTANCE)
        if is_standing.any():
            stop_errors.append(abs(float(station[is_standing.argmax()] - stop.s)))
        elif station[-1] > stop.s + STOP_DISTANCE:
            stop_errors.append(STOP_DISTANCE)
    return {
        "time_lost": float(t[-1] - np.interp(station[-1], plan.s, plan.time)),
        "way_driven": float(station[-1] / plan.motion(t[-1])[0]),
        "speed_error": math.sqrt(mean_square((speed - planned_speed)[is_judged])) if is_judged.any() else None,
        "longitudinal_jerk": r79(t, acceleration)[1],
        "used_grip": float(np.max(portable.hypot(acceleration, run.lateral_acceleration[:end]) / grip)),
        "stop_error": max(stop_errors, default=None),
    }


def as_cells(rows: Sequence[Sequence[dict[str, Any]]]) -> dict[str, NDArray[Any]]:
    """Return the result of `measure_runs` as an array (runs, seeds) for each measure, with NaN for None."""
    return {name: as_column([row[name] for road in rows for row in road]).reshape(len(rows), -1) for name in rows[0][0]}


def as_column(values: Sequence[Any]) -> NDArray[Any]:
    """Return values as an array of text, or of numbers with NaN for None."""
    if isinstance(values[0], str):
        return np.array(values)
    return np.array([np.nan if value is None else value for value in values], dtype=float)

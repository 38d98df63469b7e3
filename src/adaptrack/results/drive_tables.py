"""The measures of closed-loop runs as tables: a row per controller and setting, the best value bold."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from adaptrack.base.result import Column, ResultTable, Row, select_entries
from adaptrack.drive.metrics import Metrics, published_mse
from adaptrack.drive.trajectory import Trajectory
from adaptrack.results.record import DriveRecord
from adaptrack.results.words import number, title_of


@dataclass(frozen=True)
class Shown:
    """A run with its name on the page and its measures."""

    label: str
    trajectory: Trajectory
    metrics: Metrics
    drive: DriveRecord | None = None
    """the run along its road, for the road from above and the replay"""


_CONTROLLER = Column("label", "Controller")
_BOLD = "Bold: the smallest, among the runs that did not fail."

TRACKING_COLUMNS = (
    Column("mse", "MSE", "m²", 3),
    Column("paper", "Paper", "m²", "given"),
    Column("ratio", "Ours", "/ paper", 3),
    Column("rms_error", "RMS |e|", "m", 3),
    Column("p95_error", "p95 |e|", "m", 3, "95th percentile of the error"),
    Column("max_abs_error", "Max |e|", "m", 3),
    Column("max_corner_error", "Corner", "max, m", 3),
    Column("in_lane", "In lane", "% of time", "percent"),
    Column("outcome", "Failed"),
)
EFFORT_COLUMNS = (
    _CONTROLLER,
    Column("heading_rms", "Heading RMS", "rad (°)", "degrees"),
    Column("heading_max", "Heading max", "rad (°)", "degrees"),
    Column("steering_rms", "Command RMS", "rad (°)", "degrees"),
    Column("steering_rate_rms", "Command rate RMS", "rad/s (°/s)", "degrees"),
    Column("reversals", "Reversals", "1/min", 3),
    Column("lateral_acceleration_rms", "Lateral acc. RMS", "m/s²", 3),
    Column("lateral_acceleration_max", "Lateral acc. max", "m/s²", 3),
    Column("jerk_rms", "Jerk RMS", "m/s³", 3),
    Column("jerk_r79", "Jerk R79", "m/s³", 3),
    Column("cost", "Cost J", "m²", 3),
)
SOLVER_COLUMNS = (
    _CONTROLLER,
    Column("at_change_limit", "Δu limit", "% of steps", "percent"),
    Column("at_angle_limit", "u limit", "% of steps", "percent"),
    Column("at_output_limit", "y limit", "% of steps", "percent"),
    Column("qp_solved", "QPs", "solved"),
    Column("qp_capped", "QPs", "capped"),
    Column("qp_failed", "QPs", "failed"),
    Column("held", "Held", "steps"),
    Column("dead_reckoning", "No position", "steps"),
    Column("dead_reckoning_max", "No position", "longest, s", 3),
    Column("qp_residual_max", "KKT residual", "largest", "power"),
    Column("qp_iterations_mean", "Iterations", "mean", 3),
    Column("prediction_error_half", "Prediction", "0.5 s, m", 3),
    Column("prediction_error_one", "Prediction", "1 s, m", 3),
    Column("step_us_p50", "Step p50", "µs", 3),
    Column("step_us_p99", "Step p99", "µs", 3),
    Column("step_us_p999", "Step p99.9", "µs", 3),
    Column("step_us_max", "Step max", "µs", 3),
)
OPTIONAL_COLUMNS = (
    "paper", "ratio", "p95_error", "max_corner_error", "in_lane", "reversals", "jerk_r79", "dead_reckoning",
    "dead_reckoning_max", "prediction_error_half", "prediction_error_one",
)  # fmt: skip
"""Columns that are omitted if no run has a value."""
BELIEF_STATE_COLUMNS = (
    _CONTROLLER,
    Column("belief_learning", "Learning", "%", "percent"),
    Column("belief_settled", "Settled", "%", "percent"),
    Column("belief_at_bound", "At a bound", "%", "percent"),
    Column("belief_contradictory", "Contradictory", "%", "percent"),
    Column("belief_state", "At the end"),
)
DRIVE_COLUMNS = (
    Column("scenario", "driven"),
    Column("controller", "controller"),
    Column("rms_error", "RMS e", "m", 3),
    Column("max_abs_error", "max |e|", "m", 3),
    Column("max_corner_error", "corner |e|", "m", 3),
    Column("in_lane", "in lane", "%", "percent"),
    Column("result", "result"),
)
_TROUBLES = ("qp_capped", "qp_failed", "held")
"""Counts that should be zero."""


def run_rows(runs: Sequence[Shown]) -> list[dict[str, Any]]:
    """A row for each run of a scenario: its measures, its tuning and the paper's error."""
    errors = [run.metrics.mse for run in runs if not run.metrics.failed]
    smallest = min(errors) if errors and len(runs) > 1 else None
    return [_row(run) | {"best": not run.metrics.failed and run.metrics.mse == smallest} for run in runs]


def _row(run: Shown) -> dict[str, Any]:
    metrics, paper = run.metrics, published_mse(run.trajectory)
    row = {field.name: getattr(metrics, field.name) for field in dataclasses.fields(metrics)}
    if "qp_status" not in run.trajectory.diagnostics:  # the controller solves no QP
        row |= dict.fromkeys(("qp_solved", "qp_capped", "qp_failed"))
    return row | {
        "label": run.label, "paper": paper, "ratio": None if paper is None else metrics.mse / paper,
        "dead_reckoning": metrics.dead_reckoning or None,
        "outcome": f"at {metrics.failed_at:.1f} s" if metrics.failed else "no",
        "tuning": {name: _range(_driven_values(run.trajectory, name)) for name in run.trajectory.tuning},
    }  # fmt: skip


def scenario_tables(name: str, runs: Sequence[Shown]) -> list[ResultTable]:
    """Tracking, effort, solver and belief of the runs of one scenario or road; the tables are named after it."""
    entries = _entries(runs)
    rows = [row | {f"tuning {key}": row["tuning"].get(key) for key in entries} for row in run_rows(runs)]
    bold = select_entries(rows, ["mse", "rms_error"], lambda row: row["best"])
    failed = select_entries(rows, ["outcome"], lambda row: row["failed"])
    tracking = [_CONTROLLER, *_with_values(TRACKING_COLUMNS, rows)]
    tracking += [Column(f"tuning {key}", key, unit, "given") for key, unit in entries.items()]
    troubles = [select_entries(rows, [key], lambda row, key=key: bool(row[key])) for key in _TROUBLES]
    tables = [
        ResultTable(f"{name} tracking", "Tracking", tracking, rows, _BOLD if bold else "", best=bold, alert=failed),
        ResultTable(f"{name} effort", "Heading, effort and comfort", _with_values(EFFORT_COLUMNS, rows), rows),
        ResultTable(f"{name} solver", "Limits, solver and time", _with_values(SOLVER_COLUMNS, rows), rows,
                    "A dash: not measured.", alert=frozenset().union(*troubles)),
    ]  # fmt: skip
    learners = [row for row in rows if row["belief_state"]]
    if learners:
        title = "State of the learned quantities, share of the time"
        tables.append(ResultTable(f"{name} belief", title, BELIEF_STATE_COLUMNS, learners))
    return tables


def _with_values(columns: Sequence[Column], rows: Sequence[Row]) -> list[Column]:
    """The columns without those that are optional and have no value."""
    return [
        column
        for column in columns
        if column.name not in OPTIONAL_COLUMNS or any(_exists(row[column.name]) for row in rows)
    ]


def _exists(value: Any) -> bool:
    return value is not None and not (isinstance(value, float) and math.isnan(value))


def overview_table(scenarios: Mapping[str, Sequence[Shown]]) -> ResultTable:
    """The MSE of every controller on every scenario, with the paper's."""
    labels = list(dict.fromkeys(run.label for runs in scenarios.values() for run in runs))
    rows: list[dict[str, Any]] = [{"label": label} for label in labels]
    columns, best, failed = [_CONTROLLER], set(), set()
    for name, runs in scenarios.items():
        mse, paper = f"mse {name}", f"paper {name}"
        measured = {row["label"]: row for row in run_rows(runs)}
        columns.append(Column(mse, title_of(name), "MSE, m²", 3))
        if any(row["paper"] is not None for row in measured.values()):
            columns.append(Column(paper, "Paper", "m²", "given"))
        for i, label in enumerate(labels):
            row = measured.get(label, {"mse": None, "paper": None, "failed": False, "best": False})
            rows[i] |= {mse: f"{number(row['mse'])} (failed)" if row["failed"] else row["mse"], paper: row["paper"]}
            best |= {(i, mse)} if row["best"] else set()
            failed |= {(i, mse)} if row["failed"] else set()
    return ResultTable(
        "overview", "Mean square tracking error", columns, rows, _BOLD if best else "", best=frozenset(best),
        alert=frozenset(failed),
    )  # fmt: skip


def console_table(title: str, rows: Sequence[Row]) -> ResultTable:
    """The table that the console prints; rows: the measures of each run, with `scenario` and `controller`."""
    empty = dict.fromkeys(column.name for column in DRIVE_COLUMNS)  # a run of one instant has no measures of its path
    table_rows = [{**empty, **row, "result": "failed" if row["failed"] else "ok"} for row in rows]
    return ResultTable("console", title, DRIVE_COLUMNS, table_rows, brief=True)


def _entries(runs: Iterable[Shown]) -> dict[str, str]:
    """The tuning entries of the runs and their units, as a reader writes them."""
    powers = str.maketrans("-23", "–²³")
    units = {name: run.trajectory.units[f"tuning.{name}"] for run in runs for name in run.trajectory.tuning}
    return {name: "" if unit == "-" else unit.replace("^", "").translate(powers) for name, unit in units.items()}


def _driven_values(run: Trajectory, name: str) -> NDArray[Any]:
    """The finite values of a tuning entry while the controller acted."""
    values = np.asarray(run.tuning.get(name, np.full(len(run), np.nan)), dtype=float)[np.isfinite(run.command)]
    return values[np.isfinite(values)]


def _range(values: NDArray[Any]) -> float | tuple[float, float] | None:
    """The value of a constant entry or the range of an adapted one; whole numbers as int."""
    if not values.size:
        return None
    low, high = (int(end) if end.is_integer() else end for end in (float(values.min()), float(values.max())))
    return low if low == high else (low, high)

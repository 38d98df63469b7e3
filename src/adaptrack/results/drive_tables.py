"""Tables of the measures of closed-loop runs, with a row per controller and the best value bold."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from adaptrack.base.result import Column, ResultTable, Row, select_entries
from adaptrack.drive.metrics import Metrics, published_mse
from adaptrack.drive.speed_measures import StopMeasure
from adaptrack.drive.trajectory import Trajectory
from adaptrack.results.record import DriveRecord
from adaptrack.results.words import number, title_of


@dataclass(frozen=True)
class Shown:
    """A run with its label and its measures."""

    label: str
    trajectory: Trajectory
    metrics: Metrics
    drive: DriveRecord | None = None
    """The run along its road, for the map and the replay."""
    following: Row = field(default_factory=dict)
    """Measures of how the speed plan was followed (`speed_measures`); empty where no driver followed one."""
    stops: Sequence[StopMeasure] = ()


_CONTROLLER = Column("label", "Controller")
_CORNER_ERROR = "largest distance of a corner of the car from the path, minus half the width of the car"
_BOLD = "Bold: smallest value of the runs that did not fail."

TRACKING_COLUMNS = (
    Column("mse", "MSE", "m²", 3),
    Column("paper", "MSE in paper", "m²", "given"),
    Column("ratio", "MSE", "/ paper", 3, "MSE divided by that of the paper"),
    Column("rms_error", "RMS error", "m", 3),
    Column("p95_error", "95 % error", "m", 3, "95th percentile of the error"),
    Column("max_abs_error", "Max. error", "m", 3),
    Column(
        "max_corner_error",
        "Max. corner error",
        "m",
        3,
        "largest distance of a corner from the path, minus half the width",
    ),
    Column("in_lane", "In lane", "% of time", "percent"),
    Column("outcome", "Failed"),
)
EFFORT_COLUMNS = (
    _CONTROLLER,
    Column("heading_rms", "RMS heading error", "rad (°)", "degrees"),
    Column("heading_max", "Max. heading error", "rad (°)", "degrees"),
    Column("steering_rms", "RMS command", "rad (°)", "degrees"),
    Column("steering_rate_rms", "RMS command rate", "rad/s (°/s)", "degrees"),
    Column("reversals", "Steering reversals", "1/min", 3),
    Column("lateral_acceleration_rms", "RMS lateral acceleration", "m/s²", 3),
    Column("lateral_acceleration_max", "Max. lateral acceleration", "m/s²", 3),
    Column("jerk_rms", "RMS lateral jerk", "m/s³", 3),
    Column("jerk_r79", "Max. jerk by UN R79", "m/s³", 3),
    Column("cost", "Cost J", "m²", 3),
)
SOLVER_COLUMNS = (
    _CONTROLLER,
    Column("at_change_limit", "Limit on Δu active", "% of steps", "percent"),
    Column("at_angle_limit", "Limit on u active", "% of steps", "percent"),
    Column("at_output_limit", "Limit on y active", "% of steps", "percent"),
    Column("qp_solved", "Solved QPs"),
    Column("qp_capped", "QPs at iteration limit"),
    Column("qp_failed", "Failed QPs"),
    Column("held", "No new command", "steps"),
    Column("dead_reckoning", "No position measured", "steps"),
    Column("dead_reckoning_max", "Longest time without position", "s", 3),
    Column("qp_residual_max", "Max. KKT residual", "", "power"),
    Column("qp_iterations_mean", "Mean QP iterations", "", 3),
    Column("prediction_error_half", "RMS prediction error, 0.5 s", "m", 3),
    Column("prediction_error_one", "RMS prediction error, 1 s", "m", 3),
    Column("step_us_p50", "Median step time", "µs", 3),
    Column("step_us_p99", "99 % step time", "µs", 3),
    Column("step_us_p999", "99.9 % step time", "µs", 3),
    Column("step_us_max", "Max. step time", "µs", 3),
)
SPEED_COLUMNS = (
    _CONTROLLER,
    Column("speed_error", "RMS speed error", "m/s", 3, "difference from the speed planned for the place"),
    Column("time_lost", "Late at the end", "s", 3, "delay against the plan at the place where the run ends"),
    Column("stop_error", "Max. stop error", "m", 3, "largest distance from a stop; 8 m: passed without standing"),
    Column("longitudinal_jerk", "Max. longitudinal jerk", "m/s³", 3, "by UN R79"),
    Column("used_grip", "Max. used grip", "", 3, "acceleration divided by true friction times gravity"),
)
STOP_COLUMNS = (
    _CONTROLLER,
    Column("place", "Stop", "at s, m", 4),
    Column(
        "error", "Error", "m", 2, "where the car first stood, minus the place of the stop; a dash: it did not stand"
    ),
    Column("stood", "Stood", "s", 3),
    Column("seconds", "Planned", "s", 3),
)
OPTIONAL_COLUMNS = (
    "paper", "ratio", "p95_error", "max_corner_error", "in_lane", "reversals", "jerk_r79", "dead_reckoning",
    "dead_reckoning_max", "prediction_error_half", "prediction_error_one",
)  # fmt: skip
"""Columns that are omitted if no run has a value."""
BELIEF_STATE_COLUMNS = (
    _CONTROLLER,
    Column("belief_learning", "Learning", "% of time", "percent"),
    Column("belief_settled", "Settled", "% of time", "percent"),
    Column("belief_at_bound", "At a bound", "% of time", "percent"),
    Column("belief_contradictory", "Contradictory", "% of time", "percent"),
    Column("belief_state", "State at the end"),
)
DRIVE_COLUMNS = (
    Column("scenario", "drive"),
    Column("controller", "controller"),
    Column("rms_error", "RMS error", "m", 3),
    Column("max_abs_error", "max error", "m", 3),
    Column("max_corner_error", "corners", "m", 3, _CORNER_ERROR),
    Column("in_lane", "in lane", "%", "percent", "share of time with all corners in the lane"),
    Column("result", "result"),
)
_TROUBLES = ("qp_capped", "qp_failed", "held")
"""Counts that should be zero."""


def run_rows(runs: Sequence[Shown]) -> list[dict[str, Any]]:
    """Return a row for each run of a scenario with its measures, its tuning and the paper's MSE."""
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
    """Return tables of tracking, effort, solver and learning state of the runs of one scenario or road."""
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
        ResultTable(f"{name} solver", "Limits, solver and step time", _with_values(SOLVER_COLUMNS, rows), rows,
                    "A dash means that the value was not measured.", alert=frozenset().union(*troubles)),
    ]  # fmt: skip
    followers = [run for run in runs if run.following]
    speeds = [{"label": run.label, **run.following} for run in followers]
    stops = [{"label": run.label, **stop._asdict()} for run in followers for stop in run.stops]
    tables += [ResultTable(f"{name} speed", "Speed", SPEED_COLUMNS, speeds)] if speeds else []
    tables += [ResultTable(f"{name} stops", "Stops", STOP_COLUMNS, stops)] if stops else []
    learners = [row for row in rows if row["belief_state"]]
    if learners:
        title = "Learning state, share of time"
        tables.append(ResultTable(f"{name} belief", title, BELIEF_STATE_COLUMNS, learners))
    return tables


def _with_values(columns: Sequence[Column], rows: Sequence[Row]) -> list[Column]:
    """Return the columns without optional columns that have no value."""
    return [
        column
        for column in columns
        if column.name not in OPTIONAL_COLUMNS or any(_exists(row[column.name]) for row in rows)
    ]


def _exists(value: Any) -> bool:
    return value is not None and not (isinstance(value, float) and math.isnan(value))


def overview_table(scenarios: Mapping[str, Sequence[Shown]]) -> ResultTable:
    """Return a table of the MSE of every controller on every scenario, and the paper's MSE."""
    labels = list(dict.fromkeys(run.label for runs in scenarios.values() for run in runs))
    rows: list[dict[str, Any]] = [{"label": label} for label in labels]
    columns, best, failed = [_CONTROLLER], set(), set()
    for name, runs in scenarios.items():
        mse, paper = f"mse {name}", f"paper {name}"
        measured = {row["label"]: row for row in run_rows(runs)}
        columns.append(Column(mse, title_of(name), "MSE, m²", 3))
        if any(row["paper"] is not None for row in measured.values()):
            columns.append(Column(paper, "MSE in paper", "m²", "given"))
        for i, label in enumerate(labels):
            row = measured.get(label, {"mse": None, "paper": None, "failed": False, "best": False})
            rows[i] |= {mse: f"{number(row['mse'])} (failed)" if row["failed"] else row["mse"], paper: row["paper"]}
            best |= {(i, mse)} if row["best"] else set()
            failed |= {(i, mse)} if row["failed"] else set()
    return ResultTable(
        "overview", "Mean square error (MSE)", columns, rows, _BOLD if best else "", best=frozenset(best),
        alert=frozenset(failed),
    )  # fmt: skip


def console_table(title: str, rows: Sequence[Row]) -> ResultTable:
    """Return the table for the console; rows: measures of each run with `scenario` and `controller`."""
    empty = dict.fromkeys(column.name for column in DRIVE_COLUMNS)  # a run of one instant has no path measures
    table_rows = [{**empty, **row, "result": "failed" if row["failed"] else "ok"} for row in rows]
    return ResultTable("console", title, DRIVE_COLUMNS, table_rows, brief=True)


def _entries(runs: Iterable[Shown]) -> dict[str, str]:
    """Return the tuning entries of the runs with their units in typographic form."""
    powers = str.maketrans("-23", "–²³")
    units = {name: run.trajectory.units[f"tuning.{name}"] for run in runs for name in run.trajectory.tuning}
    return {name: "" if unit == "-" else unit.replace("^", "").translate(powers) for name, unit in units.items()}


def _driven_values(run: Trajectory, name: str) -> NDArray[Any]:
    """Return the finite values of a tuning entry at instants with a command."""
    values = np.asarray(run.tuning.get(name, np.full(len(run), np.nan)), dtype=float)[np.isfinite(run.command)]
    return values[np.isfinite(values)]


def _range(values: NDArray[Any]) -> float | tuple[float, float] | None:
    """Return the value of a constant tuning entry, or the range of a variable one; whole numbers as int."""
    if not values.size:
        return None
    low, high = (int(end) if end.is_integer() else end for end in (float(values.min()), float(values.max())))
    return low if low == high else (low, high)

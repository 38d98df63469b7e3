"""The measures of closed-loop runs as tables: a row per controller and setting."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from adaptrack.base.result import Column, ResultTable, Row, where
from adaptrack.drive.metrics import Metrics, published_mse
from adaptrack.drive.trajectory import Trajectory
from adaptrack.results.words import capital, describe, number, recorded, title_of


@dataclass(frozen=True)
class Shown:
    """A run with its name on the page and its measures."""

    label: str
    trajectory: Trajectory
    metrics: Metrics


Settings = Mapping[str, Sequence[Shown]]
"""The runs of one scenario: what tells a setting from the others, in words -> its runs."""

_CONTROLLER = Column("label", "Controller")
_BOLD = "Bold: the smallest MSE of a setting, among the runs that did not fail."

TRACKING = (
    Column("mse", "MSE", "m²", 3),
    Column("paper", "Paper", "m²", "given"),
    Column("ratio", "Ours", "/ paper", 3),
    Column("rms_error", "RMS error", "m", 3),
    Column("max_abs_error", "Max |error|", "m", 3),
    Column("outcome", "Failed"),
)
EFFORT = (
    _CONTROLLER,
    Column("heading_rms", "Heading RMS", "rad (°)", "degrees"),
    Column("heading_max", "Heading max", "rad (°)", "degrees"),
    Column("steering_rms", "Command RMS", "rad (°)", "degrees"),
    Column("steering_rate_rms", "Command rate RMS", "rad/s (°/s)", "degrees"),
    Column("lateral_acceleration_rms", "Lateral acc. RMS", "m/s²", 3),
    Column("lateral_acceleration_max", "Lateral acc. max", "m/s²", 3),
    Column("jerk_rms", "Jerk RMS", "m/s³", 3),
    Column("cost", "Cost J", "m²", 3),
)
SOLVER = (
    _CONTROLLER,
    Column("at_change_limit", "Δu limit", "% of steps", "percent"),
    Column("at_angle_limit", "u limit", "% of steps", "percent"),
    Column("at_output_limit", "y limit", "% of steps", "percent"),
    Column("qp_solved", "QPs", "solved"),
    Column("qp_capped", "QPs", "capped"),
    Column("qp_failed", "QPs", "failed"),
    Column("held", "Held", "steps"),
    Column("dead_reckoning", "No position", "steps"),
    Column("qp_residual_max", "KKT residual", "largest", "power"),
    Column("qp_iterations_mean", "Iterations", "mean", 3),
    Column("step_us_p50", "Step p50", "µs", 3),
    Column("step_us_p99", "Step p99", "µs", 3),
    Column("step_us_p999", "Step p99.9", "µs", 3),
    Column("step_us_max", "Step max", "µs", 3),
)
_TROUBLES = ("qp_capped", "qp_failed", "held")
"""Counts that should be zero."""


def rows_of(settings: Settings) -> list[dict[str, Any]]:
    """A row for each run of a scenario: its measures, its tuning and the paper's error beside its own."""
    best = _best(settings)
    return [_row(run, words, id(run) in best) for words, runs in settings.items() for run in runs]


def _row(run: Shown, words: str, best: bool) -> dict[str, Any]:
    metrics, paper = run.metrics, published_mse(run.trajectory)
    row = {field.name: getattr(metrics, field.name) for field in dataclasses.fields(metrics)}
    if "qp_status" not in run.trajectory.diagnostics:  # the controller solves no QP
        row |= {name: None for name in row if name in ("qp_solved", "qp_capped", "qp_failed")}
    return row | {
        "label": run.label, "setting": capital(words), "cost": metrics.cost, "best": best, "paper": paper,
        "ratio": None if paper is None else metrics.mse / paper,
        "outcome": f"at {metrics.failed_at:.1f} s" if metrics.failed else "no",
        "tuning": {name: _range(_driven(run.trajectory, name)) for name in run.trajectory.tuning},
    }  # fmt: skip


def scenario_tables(name: str, settings: Settings) -> list[ResultTable]:
    """Tracking, effort and solver of the runs of one scenario; each table is named after it."""
    shown = [run for runs in settings.values() for run in runs]
    entries = _entries(shown)
    rows = [row | {f"tuning {key}": row["tuning"].get(key) for key in entries} for row in rows_of(settings)]
    bold = where(rows, ["mse"], lambda row: row["best"])
    paper = any(row["paper"] is not None for row in rows)
    tracking = [_CONTROLLER, *(each for each in TRACKING if paper or each.name not in ("paper", "ratio"))]
    tracking += [Column(f"tuning {key}", key, unit, "given") for key, unit in entries.items()]
    reckoned = any(row["dead_reckoning"] for row in rows)
    solver = [each for each in SOLVER if reckoned or each.name != "dead_reckoning"]
    troubles = [where(rows, [key], _positive(key)) for key in _TROUBLES]
    return [
        ResultTable(f"{name} tracking", "Tracking", tracking, rows, _BOLD if bold else "", "setting", bold,
                    where(rows, ["outcome"], lambda row: row["failed"])),
        ResultTable(f"{name} effort", "Heading, effort and comfort", EFFORT, rows, group="setting"),
        ResultTable(f"{name} solver", "Limits, solver and time", solver, rows, _about_times(shown), "setting",
                    alert=frozenset().union(*troubles)),
    ]  # fmt: skip


def overview_table(scenarios: Mapping[str, Settings]) -> ResultTable:
    """The MSE of every controller and setting on every scenario, beside the paper's."""
    rows: dict[tuple[str, str], dict[str, Any]] = {}
    empty = {f"{kind} {name}": None for name in scenarios for kind in ("mse", "paper", "best", "failed")}
    for name, settings in scenarios.items():
        for row in rows_of(settings):
            mine = rows.setdefault((row["setting"], row["label"]), {**empty, "setting": row["setting"]})
            mse = f"{number(row['mse'])} (failed)" if row["failed"] else row["mse"]
            mine |= {"label": row["label"], f"mse {name}": mse, f"paper {name}": row["paper"],
                     f"best {name}": row["best"], f"failed {name}": row["failed"]}  # fmt: skip
    columns = [_CONTROLLER]
    for name in scenarios:
        columns += [
            Column(f"mse {name}", title_of(name), "MSE, m²", 3),
            Column(f"paper {name}", "Paper", "m²", "given"),
        ]
    found = list({words: None for words, _ in rows})
    shown = [rows[key] for words in found for key in rows if key[0] == words]
    bold = frozenset().union(*(where(shown, [f"mse {name}"], _entry(f"best {name}")) for name in scenarios))
    failed = frozenset().union(*(where(shown, [f"mse {name}"], _entry(f"failed {name}")) for name in scenarios))
    return ResultTable(
        "overview", "Mean square tracking error", columns, shown, _BOLD if bold else "", "setting", bold, failed
    )


def differences_table(runs: Sequence[Shown], entries: Sequence[tuple[str, str]]) -> ResultTable:
    """Provenance entries (key, head) in which the runs differ."""
    columns = [Column("label", "Run"), *(Column(key, head) for key, head in entries)]
    rows = [
        {"label": run.label} | {key: describe(recorded(run.trajectory.meta, key)) for key, _ in entries} for run in runs
    ]
    return ResultTable("differences", "Where the runs differ", columns, rows)


def _entry(name: str) -> Callable[[Row], Any]:
    return lambda row: row[name]


def _positive(name: str) -> Callable[[Row], bool]:
    return lambda row: bool(row[name])


def _best(settings: Settings) -> set[int]:
    """The ids of the runs with the smallest MSE of their setting; none where there is no choice."""
    found = set()
    for runs in settings.values():
        kept = [run for run in runs if not run.metrics.failed]
        if len(runs) > 1 and kept:
            found.add(id(min(kept, key=lambda run: run.metrics.mse)))
    return found


def _entries(shown: Iterable[Shown]) -> dict[str, str]:
    """The tuning entries of the runs and their units, as a reader writes them."""
    powers = str.maketrans("-23", "–²³")
    units = {name: run.trajectory.units[f"tuning.{name}"] for run in shown for name in run.trajectory.tuning}
    return {name: "" if unit == "-" else unit.replace("^", "").translate(powers) for name, unit in units.items()}


def _driven(run: Trajectory, name: str) -> NDArray[Any]:
    """A tuning entry of the run, as long as it was driven."""
    values = np.asarray(run.tuning.get(name, np.full(len(run), np.nan)), dtype=float)[np.isfinite(run.command)]
    return values[np.isfinite(values)]


def _range(values: NDArray[Any]) -> float | tuple[float, float] | None:
    """One value where it stayed, the range where it was adapted; whole numbers as such."""
    if not values.size:
        return None
    low, high = (int(each) if each.is_integer() else each for each in (float(values.min()), float(values.max())))
    return low if low == high else (low, high)


def _about_times(shown: Sequence[Shown]) -> str:
    untimed = [run.label for run in shown if np.isnan(run.metrics.step_us_p50)]
    if len(untimed) == len(shown):
        return "Step times were not measured."
    return "A dash: not measured." if untimed else ""


def outcomes_table(title: str, columns: Sequence[Column], rows: Sequence[Row]) -> ResultTable:
    """What the console shows of runs, each with its `result`: failed or ok."""
    shown = [{**row, "result": "failed" if row["failed"] else "ok"} for row in rows]
    return ResultTable("console", title, columns, shown, brief=True)

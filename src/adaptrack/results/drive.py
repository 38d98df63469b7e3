"""Result of simulated drives through scenarios or along a road, with tables, pictures, provenance and replay."""

from __future__ import annotations

import dataclasses
import json
import math
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from adaptrack.base.errors import InvalidInput
from adaptrack.base.files import safe_names
from adaptrack.base.result import Column, Picture, Result, ResultTable, Row, best_entries, select_entries
from adaptrack.cars.vehicle import Vehicle
from adaptrack.drive.failure import DISTANCE, MIN_JUDGED_SPEED
from adaptrack.drive.metrics import Metrics, compute_metrics, published_mse
from adaptrack.drive.predicted_paths import PredictedPaths
from adaptrack.drive.speed_measures import StopMeasure, measure_stops, speed_measures
from adaptrack.drive.trajectory import Trajectory
from adaptrack.results import run_pictures, words
from adaptrack.results.marks import strokes
from adaptrack.results.record import DEFAULT_DRAWN_CAR, DrawnCar, DriveRecord, above_picture, on_road
from adaptrack.road import Road, SpeedPlan
from adaptrack.scenario.profile import load_profile


@dataclass(frozen=True)
class Run:
    """A run for the page, with its label, measures, road and car."""

    trajectory: Trajectory
    label: str = ""
    """Name in legends and tables; the controller's name if empty."""
    metrics: Metrics | None = None
    """Measures of the run; computed if None."""
    road: Road | None = None
    """Road of the drive; with a road, the page has a map and a replay."""
    car: Vehicle | DrawnCar = DEFAULT_DRAWN_CAR
    """The car that is drawn on the road."""
    predicted: PredictedPaths | None = None
    """The paths that `simulate` recorded, for the replay."""
    plan: SpeedPlan | None = None
    """Plan that a driver followed along the road; with it, the page has speed error, lost time and stops."""

    @cached_property
    def measures(self) -> Metrics:
        """Measures of the run."""
        outline = None if self.car is DEFAULT_DRAWN_CAR else self.car.outline
        return self.metrics or compute_metrics(self.trajectory, outline=outline)

    @cached_property
    def drive(self) -> DriveRecord | None:
        """The run along its road, for the map and the replay."""
        if self.road is None:
            return None
        return DriveRecord.from_trajectory(self.trajectory, self.road, self.car, self.predicted)

    @cached_property
    def following(self) -> Row:
        """Measures of how the speed plan was followed (`speed_measures`); empty without a plan."""
        is_planned = self.road is not None and self.plan is not None
        return speed_measures(self.trajectory, self.road, self.plan) if is_planned else {}  # type: ignore[arg-type]

    @cached_property
    def stops(self) -> Sequence[StopMeasure]:
        """Stops of the speed plan; none without a plan."""
        return () if self.plan is None else measure_stops(self.trajectory, self.plan)


def drive_result(
    runs: Sequence[Run | Trajectory], rows: Sequence[Row] = (), *, title: str = "", command: str = ""
) -> Result:
    """Return the result of closed-loop runs.

    Runs are grouped by scenario or road; equal labels are numbered. A label keeps its colour in all pictures. rows:
    measures of all runs by name, for console and JSON; title: by default the names of scenarios and controllers;
    command: the command line that repeats the runs. Raises InvalidInput when there is no run, or when runs with a road
    use different roads.
    """
    if not runs:
        raise InvalidInput("runs: give at least one run.")
    scenarios = group_runs([run if isinstance(run, Run) else Run(run) for run in runs])
    labelled_runs = [run for group in scenarios.values() for run in group]
    line_styles = strokes(run.label for run in labelled_runs)
    stems = dict(zip(scenarios, safe_names(map(words.slug, scenarios)), strict=True))
    failed = [_failure(run) for run in labelled_runs if run.measures.failed]
    first = labelled_runs[0].trajectory
    return Result(
        kind="drive",
        title=title or _title(scenarios),
        answer=_answer(labelled_runs),
        record={"rows": list(rows)},
        tables=[
            overview_table(scenarios),
            *(table for name, group in scenarios.items() for table in scenario_tables(name, group)),
            *([console_table(f"Profile {first.name_of('profile')}", rows)] if rows else []),
        ],
        pictures=_pictures(scenarios, stems, line_styles),
        failed=bool(failed),
        headline=_failure_headline(failed, len(labelled_runs)),
        values={
            "scenarios": [_section(name, group, stems[name]) for name, group in scenarios.items()],
            "failed_runs": failed, "shown": labelled_runs,
            "records": json.dumps({
                f"{i}. {run.label}, {run.trajectory.name_of('scenario')}": run.trajectory.meta
                for i, run in enumerate(labelled_runs, 1)
            }, indent=1, ensure_ascii=False),
            "drives": {run.label: run.drive for run in labelled_runs if run.drive is not None},
            "limits": {"slow": MIN_JUDGED_SPEED, "distance": DISTANCE, "creeping": run_pictures.CREEPING,
                       "road_weight": load_profile("road").move_weight},
        },
        command=command,
        created=max(str(run.trajectory.meta.get("created", "")) for run in labelled_runs),
    )  # fmt: skip


def write_drive_page(
    out_dir: str | os.PathLike[str],
    runs: Sequence[Run | Trajectory],
    *,
    title: str = "",
    command: str = "",
    png: bool = True,
) -> Path:
    """Write the page on `runs` and its PNG files into `out_dir`; return the page's path.

    Parameters are those of `drive_result`; png: whether to write the PNG files.

    Raises
    ------
    InvalidInput
        When `drive_result` raises it.
    StorageError
        When the files cannot be written, see `page.write_result`.
    """
    from adaptrack.results.page import write_result

    return write_result(out_dir, drive_result(runs, title=title, command=command), png=png)


# -- groups -----------------------------------------------------------------------------------------------------------
def group_runs(runs: Sequence[Run]) -> dict[str, list[Run]]:
    """Group runs by scenario, in their order, with measures and distinct labels."""
    groups: dict[str, list[Run]] = {}
    for run in runs:
        label = words.legible(run.label) or words.controller_name(run.trajectory.name_of("controller"))
        trajectory = run.trajectory if run.road is None else on_road(run.trajectory, run.road)
        group = groups.setdefault(run.trajectory.name_of("scenario"), [])
        group.append(replace(run, label=label, trajectory=trajectory))
    for group in groups.values():
        labels = [run.label for run in group]
        for i, label in enumerate(labels):
            if labels.count(label) > 1:
                group[i] = replace(group[i], label=f"{label} no. {labels[:i].count(label) + 1}")
    return groups


# -- headlines --------------------------------------------------------------------------------------------------------
def _title(scenarios: Mapping[str, Sequence[Run]]) -> str:
    """Return the names of scenarios and controllers, or their number if there are many."""
    labels = dict.fromkeys(run.label for group in scenarios.values() for run in group)
    return f"{words.few([words.title_of(name) for name in scenarios], 'scenario')}: {words.few(labels, 'controller')}"


def _answer(runs: Sequence[Run]) -> str:
    """Describe the run with the smallest RMS error; for several scenarios, give the largest error of all runs."""
    completed = [run for run in runs if not run.measures.failed]
    failed = f"{len(runs) - len(completed)} of {len(runs)} runs failed."
    if not completed:
        return failed
    best = min(completed, key=lambda run: run.measures.mse)
    errors = f"{words.length(best.measures.rms_error)} RMS error, largest {words.length(best.measures.max_abs_error)}."
    if best.following:
        errors += f" {_speed_answer(best)}"
    if len(runs) == 1:
        return errors
    if len({run.trajectory.name_of("scenario") for run in runs}) > 1:
        return f"Largest error {words.length(max(run.measures.max_abs_error for run in completed))}. {failed}"
    return f"{best.label}: {errors} {failed}"


def _speed_answer(run: Run) -> str:
    """Give speed error, stops and lost time of a run that followed a speed plan."""
    errors, speed, lost = [abs(stop.error) for stop in run.stops], *map(run.following.get, ("speed_error", "time_lost"))
    missed = sum(map(math.isnan, errors))
    parts = [] if speed is None else [f"{speed:.2g} m/s RMS speed error"]
    if errors and missed:
        parts.append(f"{missed} of {words.counted(len(errors), 'stop')} passed without standing")
    elif errors:
        parts.append(f"{words.counted(len(errors), 'stop')}, largest error {words.length(max(errors))}")
    parts += [] if lost is None else [f"{abs(lost):.2g} s {'late' if lost >= 0.0 else 'early'}"]
    return f"{'; '.join(parts)}." if parts else ""


def _failure(run: Run) -> dict[str, str]:
    """Return name, time and reason of a failed run."""
    where = "" if run.drive is None else f", at s = {words.number(float(run.drive.run.road['station'][-1]), 4)} m"
    name = f"{words.title_of(run.trajectory.name_of('scenario'))}, {run.label}"
    return {"name": name, "at": f"{run.measures.failed_at:.1f} s{where}", "because": run.measures.failed_because}


def _failure_headline(failed: Sequence[Mapping[str, str]], runs: int) -> str:
    """Return the start of the page's heading; empty if no run failed."""
    if failed and runs == 1:
        return f"Failed at {failed[0]['at']}: the vehicle {failed[0]['because']}"
    return f"{words.number(len(failed))} of {words.number(runs)} runs failed" if failed else ""


# -- pictures ---------------------------------------------------------------------------------------------------------
def _pictures(
    scenarios: Mapping[str, Sequence[Run]], stems: Mapping[str, str], line_styles: run_pictures.Strokes
) -> list[Picture]:
    """Draw the main picture (map of the road, or error in the first scenario), then pictures of all signals."""
    groups = {name: {run.label: run.trajectory for run in group} for name, group in scenarios.items()}
    drives = {run.label: run.drive for group in scenarios.values() for run in group if run.drive is not None}
    first = next(iter(groups.values()))
    error = replace(run_pictures.error_panel(run_pictures.prepare_runs(first, line_styles)), title="")
    key = [(label, line_styles[label]) for label in first] if len(first) > 1 else []
    pictures = [above_picture(drives) if drives else Picture("verdict", "", [error], key)]
    if not any(run.road for runs in groups.values() for run in runs.values()):
        speeds = {words.title_of(name): runs for name, runs in groups.items()}
        pictures.append(run_pictures.speed_picture(speeds, line_styles))
    for name, runs in groups.items():
        pictures += _signal_pictures(runs, line_styles, stems[name])
    return pictures


def _signal_pictures(runs: Mapping[str, Trajectory], line_styles: run_pictures.Strokes, stem: str) -> list[Picture]:
    """Draw tracking, conditions and learned quantities of the runs of one scenario or road."""
    pictures = [run_pictures.tracking_picture(runs, line_styles, f"{stem}-tracking")]
    if any("governed_speed" in run.diagnostics for run in runs.values()):
        pictures.append(run_pictures.speed_control_picture(runs, line_styles, f"{stem}-speed"))
    conditions = run_pictures.conditions_picture(runs, line_styles, f"{stem}-conditions")
    if conditions.panels[2:] or not any(run.road for run in runs.values()):
        pictures.append(conditions)
    if any(run_pictures.learned_quantities(run) for run in runs.values()):
        pictures.append(run_pictures.learned_picture(runs, line_styles, f"{stem}-learned"))
    return pictures


# -- the page ---------------------------------------------------------------------------------------------------------
def _section(name: str, group: Sequence[Run], stem: str) -> dict[str, Any]:
    """Return name and conditions of the page section on one scenario or road."""
    runs = [run.trajectory for run in group]
    conditions = {
        signal: np.concatenate([getattr(run, signal) for run in runs]) for signal in ("vx", "friction", "wind")
    }
    return {"name": name, "title": words.title_of(name), "stem": stem, "first": group[0], **conditions}


# -- tables -----------------------------------------------------------------------------------------------------------
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
    Column("max_corner_error", "Max. corner error", "m", 3, _CORNER_ERROR),
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


def _row(run: Run) -> dict[str, Any]:
    """Return a row with the measures of a run, its tuning and the paper's MSE."""
    metrics, paper = run.measures, published_mse(run.trajectory)
    row = {field.name: getattr(metrics, field.name) for field in dataclasses.fields(metrics)}
    if "qp_status" not in run.trajectory.diagnostics:  # the controller solves no QP
        row |= dict.fromkeys(("qp_solved", "qp_capped", "qp_failed"))
    return row | {
        "label": run.label, "paper": paper, "ratio": None if paper is None else metrics.mse / paper,
        "dead_reckoning": metrics.dead_reckoning or None,
        "outcome": f"at {metrics.failed_at:.1f} s" if metrics.failed else "no",
        "tuning": {name: _range(run.trajectory, name) for name in run.trajectory.tuning},
    }  # fmt: skip


def scenario_tables(name: str, runs: Sequence[Run]) -> list[ResultTable]:
    """Return tables of tracking, effort, solver and learning state of the runs of one scenario or road."""
    entries = _entries(runs)
    rows = [row | {f"tuning {key}": row["tuning"].get(key) for key in entries} for row in map(_row, runs)]
    bold = best_entries(rows, {"mse": min, "rms_error": min}, competes=lambda row: not row["failed"])
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
    present = {key for row in rows for key, value in row.items() if value is not None and value == value}  # not NaN
    return [column for column in columns if column.name not in OPTIONAL_COLUMNS or column.name in present]


def overview_table(scenarios: Mapping[str, Sequence[Run]]) -> ResultTable:
    """Return a table of the MSE of every controller on every scenario, and the paper's MSE."""
    rows: dict[str, dict[str, Any]] = {}
    columns = [_CONTROLLER]
    for name, runs in scenarios.items():
        papers = {run.label: published_mse(run.trajectory) for run in runs}
        columns.append(Column(f"mse {name}", words.title_of(name), "MSE, m²", 3))
        if any(paper is not None for paper in papers.values()):
            columns.append(Column(f"paper {name}", "MSE in paper", "m²", "given"))
        for run in runs:
            row = rows.setdefault(run.label, {"label": run.label})
            error = {"mse": run.measures.mse, "failed": run.measures.failed}
            row |= {f"mse {name}": error, f"paper {name}": papers[run.label]}
    empty = dict.fromkeys(column.name for column in columns)
    return errors_table(
        "overview", "Mean square error (MSE)", columns, [empty | row for row in rows.values()], "", _BOLD
    )


def errors_table(
    name: str, title: str, columns: Sequence[Column], rows: Sequence[Row], group: str = "", note: str = "",
    competes: Callable[[Row], Any] = bool,
) -> ResultTable:  # fmt: skip
    """Return a table whose entries that are runs show their mean square error, the best of column and group in bold.

    Runs have `mse`, `failed` (number of failed runs) and, if there are several, `runs`. competes: condition that runs
    in bold must fulfil, in addition to that they did not fail.
    """
    runs = [{key: run for key, run in row.items() if isinstance(run, Mapping)} for row in rows]
    errors = [
        {group: row.get(group)} | {key: run["mse"] for key, run in cells.items() if not run["failed"] and competes(run)}
        for row, cells in zip(rows, runs, strict=True)
    ]
    best = best_entries(errors, dict.fromkeys((column.name for column in columns), min), group)
    failed = frozenset((i, key) for i, cells in enumerate(runs) for key, run in cells.items() if run["failed"])
    table_rows = [
        {**row, **{key: _error(run) for key, run in cells.items()}} for row, cells in zip(rows, runs, strict=True)
    ]
    return ResultTable(name, title, columns, table_rows, note if best else "", group, best, failed)


def _error(run: Row) -> Any:
    """The mean square error of a run, or the words that it failed, or how many of several failed."""
    if not run["failed"]:
        return run["mse"]
    several = run.get("runs", 1) > 1
    return f"failed, {run['failed']} of {run['runs']}" if several else f"{words.number(run['mse'])} (failed)"


def console_table(title: str, rows: Sequence[Row]) -> ResultTable:
    """Return the table for the console; rows: measures of each run with `scenario` and `controller`."""
    empty = dict.fromkeys(column.name for column in DRIVE_COLUMNS)  # a run of one instant has no path measures
    table_rows = [{**empty, **row, "result": "failed" if row["failed"] else "ok"} for row in rows]
    return ResultTable("console", title, DRIVE_COLUMNS, table_rows, brief=True)


def _entries(runs: Iterable[Run]) -> dict[str, str]:
    """Return the tuning entries of the runs with their units in typographic form."""
    powers = str.maketrans("-23", "–²³")
    units = {name: run.trajectory.units[f"tuning.{name}"] for run in runs for name in run.trajectory.tuning}
    return {name: "" if unit == "-" else unit.replace("^", "").translate(powers) for name, unit in units.items()}


def _range(run: Trajectory, name: str) -> float | tuple[float, float] | None:
    """Return the value of a constant tuning entry, or the range of a variable one; whole numbers as int.

    Only finite values at instants with a command count.
    """
    values = np.asarray(run.tuning[name], dtype=float)
    values = values[np.isfinite(run.command) & np.isfinite(values)]
    if not values.size:
        return None
    low, high = (int(end) if end.is_integer() else end for end in (float(values.min()), float(values.max())))
    return low if low == high else (low, high)

"""The measures of closed-loop runs as tables: a row per controller and setting."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from adaptrack.drive.failure import DISTANCE, SLOW
from adaptrack.drive.metrics import Metrics, published_mse
from adaptrack.drive.trajectory import Trajectory
from adaptrack.results.figures import CREEPING
from adaptrack.results.page import Cell, Head, Section, Table, Terms
from adaptrack.results.words import describe, number, percent, recorded, scientific, span, title_of
from adaptrack.scenario.profile import load_profile


@dataclass(frozen=True)
class Shown:
    """A run with its name on the page and its measures."""

    label: str
    trajectory: Trajectory
    metrics: Metrics


Settings = Mapping[str, Sequence[Shown]]
"""The runs of one scenario: what tells a setting from the others, in words -> its runs."""

_Column = tuple[Head, Callable[[Shown], Cell | str]]
_CONTROLLER = Head("Controller", is_text=True)
_BOLD = "Bold: the smallest MSE of a setting, among the runs that did not fail."


def overview_table(scenarios: Mapping[str, Settings]) -> Table:
    """The MSE of every controller and setting on every scenario, beside the paper's."""
    rows: dict[str, dict[str, dict[str, Shown]]] = {}
    best = set()
    for scenario, settings in scenarios.items():
        best |= _best(settings)
        for words, runs in settings.items():
            for run in runs:
                rows.setdefault(words, {}).setdefault(run.label, {})[scenario] = run
    heads = [_CONTROLLER]
    for scenario in scenarios:
        heads += [Head(title_of(scenario), "MSE, m²"), Head("Paper", "m²")]
    body: list[Sequence[Cell | str] | str] = []
    for words, labels in rows.items():
        body += [_heading(words)] if words else []
        for label, found in labels.items():
            cells = [cell for scenario in scenarios for cell in _mse_and_published(found.get(scenario), best)]
            body.append([label, *cells])
    return Table("Mean square tracking error", heads, body, _BOLD if best else "")


def tracking_table(settings: Settings) -> Table:
    """Tuning and tracking of the runs of one scenario, beside the paper's MSE."""
    shown = [run for runs in settings.values() for run in runs]
    best = _best(settings)
    return _table("Tracking", settings, _tracking_columns(shown, best), _BOLD if best else "")


def effort_table(settings: Settings) -> Table:
    """Heading, steering effort and comfort of the runs of one scenario."""
    return _table("Heading, effort and comfort", settings, _EFFORT)


def solver_table(settings: Settings) -> Table:
    """Limits, QPs and times of the runs of one scenario."""
    shown = [run for runs in settings.values() for run in runs]
    columns = [each for each in _SOLVER if each is not _RECKONED or any(run.metrics.dead_reckoning for run in shown)]
    return _table("Limits, solver and time", settings, columns, _about_times(shown))


def differences_table(runs: Sequence[Shown], entries: Sequence[tuple[str, str]]) -> Table:
    """Provenance entries (key, head) in which the runs differ."""
    heads = ["Run", *(head for _, head in entries)]
    body = [[run.label, *(describe(recorded(run.trajectory.meta, key)) for key, _ in entries)] for run in runs]
    return Table("Where the runs differ", [Head(head, is_text=True) for head in heads], body)


def reading() -> Section:
    """What the columns, and the small words above some panels, mean."""
    road = f"{load_profile('road').move_weight:g}"
    meanings = (
        ("MSE", "mean of e² over the control instants, e = Y − y_ref: the paper's measure"),
        ("Heading", f"heading minus the reference's, atan2(dy_ref/dt, v_x), where v_x ≥ {SLOW:g} m/s"),
        (
            "Failed",
            f"left the road (more than {DISTANCE:g} m from the reference, if its car's file gives no other distance), "
            "spun, or reached a state that is not finite",
        ),
        ("Command", "RMS of the commanded road-wheel angle u, and of its change per second"),
        ("Cost J", f"mean e² + w · mean Δu², which tuning minimises; w = 0, in the road profile {road} m²/rad²"),
        ("Δu, u, y limit", "share of the control periods in which a limit (13), (14), (15) of the paper was active"),
        ("QPs", "solved to tolerance; capped: stopped at the iteration cap; failed: without an answer"),
        ("Held", "control periods in which a safe steering angle was held, for want of a usable solution"),
        ("No position", "control periods that were steered on the estimate, no new position having been taken in"),
        ("Step", "wall-clock time of one control step: median, 99th percentile, slowest"),
        ("start", f"above a panel: the range before {CREEPING:g} m/s is reached, where it would flatten all the rest"),
        ("□ held", "above a panel: squares mark the steps in which a safe steering angle was held"),
    )
    return Section("How to read this page", [Terms(meanings)])


def _table(caption: str, settings: Settings, columns: Sequence[_Column], note: str = "") -> Table:
    body: list[Sequence[Cell | str] | str] = []
    for words, runs in settings.items():
        body += [_heading(words)] if words else []
        body += [[run.label, *(cell(run) for _, cell in columns)] for run in runs]
    return Table(caption, [_CONTROLLER, *(head for head, _ in columns)], body, note)


def _heading(words: str) -> str:
    return words[:1].upper() + words[1:]


def _measure(text: str, unit: str, name: str) -> _Column:
    return Head(text, unit), lambda run: number(getattr(run.metrics, name))


def _angle(text: str, unit: str, name: str) -> _Column:
    """Radians, with degrees in brackets."""

    def shown(run: Shown) -> str:
        value = getattr(run.metrics, name)
        return f"{number(value)} ({number(float(np.degrees(value)))})"

    return Head(text, f"{unit} ({unit.replace('rad', '°')})"), shown


def _share(text: str, name: str) -> _Column:
    return Head(text, "% of steps"), lambda run: percent(getattr(run.metrics, name))


def _trouble(text: str, unit: str, name: str) -> _Column:
    """A count that should be zero."""
    return Head(text, unit), lambda run: Cell(_count(run, name), warn=getattr(run.metrics, name) > 0)


def _count(run: Shown, name: str) -> str:
    """A count; a dash for one of QPs where the controller solves none."""
    none = name.startswith("qp_") and "qp_status" not in run.trajectory.diagnostics
    return "–" if none else number(getattr(run.metrics, name))


def _tracking_columns(shown: Sequence[Shown], best: set[int]) -> list[_Column]:
    published = {id(run): published_mse(run.trajectory) for run in shown}

    def ratio(run: Shown) -> str:
        known = published[id(run)]
        return "–" if known is None else number(run.metrics.mse / known)

    paper: list[_Column] = [
        (Head("Paper", "m²"), lambda run: _published(published[id(run)])),
        (Head("Ours", "/ paper"), ratio),
    ]
    return [
        (Head("MSE", "m²"), lambda run: Cell(number(run.metrics.mse), strong=id(run) in best)),
        *(paper if any(known is not None for known in published.values()) else []),
        _measure("RMS error", "m", "rms_error"),
        _measure("Max |error|", "m", "max_abs_error"),
        (Head("Failed"), lambda run: _failed(run.metrics)),
        *(_tuning(name, unit) for name, unit in _entries(shown).items()),
    ]


_EFFORT: Sequence[_Column] = (
    _angle("Heading RMS", "rad", "heading_rms"),
    _angle("Heading max", "rad", "heading_max"),
    _angle("Command RMS", "rad", "steering_rms"),
    _angle("Command rate RMS", "rad/s", "steering_rate_rms"),
    _measure("Lateral acc. RMS", "m/s²", "lateral_acceleration_rms"),
    _measure("Lateral acc. max", "m/s²", "lateral_acceleration_max"),
    _measure("Jerk RMS", "m/s³", "jerk_rms"),
    _measure("Cost J", "m²", "cost"),
)

_RECKONED: _Column = (Head("No position", "steps"), lambda run: _count(run, "dead_reckoning"))
_SOLVER: Sequence[_Column] = (
    _share("Δu limit", "at_change_limit"),
    _share("u limit", "at_angle_limit"),
    _share("y limit", "at_output_limit"),
    (Head("QPs", "solved"), lambda run: _count(run, "qp_solved")),
    _trouble("QPs", "capped", "qp_capped"),
    _trouble("QPs", "failed", "qp_failed"),
    _trouble("Held", "steps", "held"),
    _RECKONED,
    (Head("KKT residual", "largest"), lambda run: scientific(run.metrics.qp_residual_max)),
    _measure("Iterations", "mean", "qp_iterations_mean"),
    _measure("Step p50", "µs", "step_us_p50"),
    _measure("Step p99", "µs", "step_us_p99"),
    _measure("Step p99.9", "µs", "step_us_p999"),
    _measure("Step max", "µs", "step_us_max"),
)


def _best(settings: Settings) -> set[int]:
    """The ids of the runs with the smallest MSE of their setting; none where there is no choice."""
    found = set()
    for runs in settings.values():
        kept = [run for run in runs if not run.metrics.failed]
        if len(runs) > 1 and kept:
            found.add(id(min(kept, key=lambda run: run.metrics.mse)))
    return found


def _mse_and_published(run: Shown | None, best: set[int]) -> tuple[Cell, Cell]:
    if run is None:
        return Cell("–"), Cell("–")
    failed = run.metrics.failed
    mse = Cell(number(run.metrics.mse) + (" (failed)" if failed else ""), strong=id(run) in best, warn=failed)
    return mse, Cell(_published(published_mse(run.trajectory)))


def _published(value: float | None) -> str:
    return "–" if value is None else f"{value:g}"


def _failed(metrics: Metrics) -> Cell:
    return Cell(f"at {metrics.failed_at:.1f} s", warn=True) if metrics.failed else Cell("no")


def _entries(shown: Sequence[Shown]) -> dict[str, str]:
    """The tuning entries of the runs and their units, as a reader writes them."""
    powers = str.maketrans("-23", "–²³")
    units = {name: run.trajectory.units[f"tuning.{name}"] for run in shown for name in run.trajectory.tuning}
    return {name: "" if unit == "-" else unit.replace("^", "").translate(powers) for name, unit in units.items()}


def _tuning(name: str, unit: str) -> _Column:
    """One value where it stayed, the range where it was adapted."""
    return Head(name, unit), lambda run: span(_driven(run.trajectory, name), to="–")


def _driven(run: Trajectory, name: str) -> NDArray[Any]:
    """A tuning entry of the run, as long as it was driven."""
    return run.tuning.get(name, np.full(len(run), np.nan))[np.isfinite(run.command)]


def _about_times(shown: Sequence[Shown]) -> str:
    untimed = [run.label for run in shown if np.isnan(run.metrics.step_us_p50)]
    if len(untimed) == len(shown):
        return "Step times were not measured."
    return "A dash: not measured." if untimed else ""

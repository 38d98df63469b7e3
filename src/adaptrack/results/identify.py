"""Results of an identification and of a check for contradictory inputs."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from adaptrack.base.files import write_atomically
from adaptrack.base.result import Column, Panel, Picture, Result, ResultTable, Row, select_entries
from adaptrack.identification import DriveIdentification, Estimate, Identification
from adaptrack.identification.loop_check import LoopCheck
from adaptrack.identification.quantities import degrees_per_g
from adaptrack.results.marks import DASHED, MUTED, SERIES, ColourScale, Stroke, speed_map
from adaptrack.results.run_pictures import turning_part
from adaptrack.results.words import capital, number

if TYPE_CHECKING:
    from matplotlib.axes import Axes

IntervalEnds = tuple[float, float]
_MEASURED: Stroke = {"color": SERIES[0], "linestyle": "-"}
_SIMULATED: Stroke = {"color": SERIES[1], "linestyle": "-"}
_SECONDS = 30.0
"""Length of the part of the log in the first picture (s)."""
_UNITS = {"N/rad": ("kN/rad", 1e-3), "rad": ("°", 180.0 / math.pi), "rad s^2/m": ("°/g", degrees_per_g(1.0)),
          "kg m^2": ("kg m²", 1.0), "m/s^2": ("m/s²", 1.0), "-": ("", 1.0)}  # fmt: skip
_NAMES = {
    "delay": "Delay of the steering", "lag": "Lag", "dead_time": "Dead time", "front": "Front axle",
    "rear": "Rear axle", "offset": "Steering offset", "push_mean": "Mean bank acceleration",
    "lf": "Front axle to centre of gravity", "rate": "Rate limit of the steering", "ratio": "Steering ratio",
}  # fmt: skip
_FIRST = ("delay", "understeer_gradient", "front", "rear", "offset")

QUANTITY_COLUMNS = (
    Column("label", "Quantity"),
    Column("unit", "Unit"),
    Column("value", "Value", show=3),
    Column("interval", "90 % interval", show=3),
    Column("before", "Initial interval", show=3),
    Column("says", "Information in the log"),
    Column("meaning", "Meaning"),
)
ESTIMATE_COLUMNS = QUANTITY_COLUMNS[:5]
"""Of estimates on the console, and of learned values."""


def identification_result(identification: Identification, command: str = "") -> Result:
    """Return the result of an identification; its record is that of `Identification.to_dict`."""
    log, checked = identification.log, identification.validation
    simulated = f"{100 * checked.simulated:.1f} % in a simulation from the command"
    explained = f"the model explains {100 * checked.one_step:.1f} % of the yaw-rate variance one step ahead"
    findings = (*identification.findings, *(identification.drive.findings if identification.drive else ()))
    logs = f"{len(identification.alone)} logs" if identification.alone else "a log"
    return Result(
        kind="identification",
        title=f"Car identified from {logs}: {identification.believed.name}",
        answer=f"{_first(identification)}. On {checked.held_out:.0f} s of held-out data, {explained} and {simulated}.",
        record=identification.to_dict(),
        tables=_tables(identification),
        notes=[f"{capital(sentence)}." for sentence in (*log.notes, *findings)],
        pictures=[_measured_and_simulated(identification), _residuals(identification), _excited(identification)],
        failed=not (identification.consistent and checked.simulated > 0.5),
        headline="" if identification.consistent else "Not consistent",
        values={
            "checked": checked, "log": log, "drawn_seconds": _SECONDS, "rate": 1.0 / log.period,
            "believed": identification.believed,
            "findings": [f"{capital(finding)}." for finding in findings],
            "reasons": [f"{capital(reason)}." for reason in identification.reasons],
            "first": [_estimate_row(identification[name]) for name in _FIRST if name in identification.estimates],
        },
        command=command,
    )  # fmt: skip


def _first(identification: Identification) -> str:
    """Return the most important estimates in words."""
    rows = [_estimate_row(identification[name]) for name in _FIRST[:2] if name in identification.estimates]
    words = [f"{row['label'].lower()} {row['value']:.3g} ± {row['half']:.2g} {row['unit']}" for row in rows]
    return capital(", ".join(words)) if words else "The log determines neither delay nor understeer gradient"


def write_identification_page(identification: Identification, path: str | os.PathLike[str], command: str = "") -> Path:
    """Write the page as one file and return its path; StorageError when the file cannot be written."""
    from adaptrack.results.page import render_result

    write_atomically(path, render_result(identification_result(identification, command)).encode())
    return Path(path)


def quantity_row(name: str, unit: str, value: float, interval: IntervalEnds, before: IntervalEnds) -> dict[str, Any]:
    """Return a row of `ESTIMATE_COLUMNS` in the units of the page; before: 90 % interval before the log."""
    unit, factor = _UNITS.get(unit, (unit, 1.0))
    return {
        "label": capital(_NAMES.get(name, name.replace("_", " "))), "unit": unit, "value": value * factor,
        "interval": (interval[0] * factor, interval[1] * factor), "before": (before[0] * factor, before[1] * factor),
    }  # fmt: skip


def _estimate_row(estimate: Estimate) -> dict[str, Any]:
    """Return a row of `QUANTITY_COLUMNS`, and half the width of the interval."""
    row = quantity_row(estimate.name, estimate.unit, estimate.value, (estimate.low, estimate.high), estimate.before)
    low, high = row["interval"]
    says = "much" if estimate.spread_left < 0.2 else "some" if estimate.spread_left < 0.7 else "little"
    return row | {"half": 0.5 * (high - low), "says": says, "meaning": estimate.meaning}


def _tables(identification: Identification) -> list[ResultTable]:
    log = identification.log
    drive = identification.drive.estimates if identification.drive is not None else {}
    estimates = [
        estimate for estimate in (*identification.estimates.values(), *drive.values()) if estimate.spread_left > 0.0
    ]  # all others keep their initial values
    rows = [_estimate_row(estimate) for estimate in estimates]
    title = f"{log.driven_time:.0f} s of driving, {log.samples} samples at {1.0 / log.period:.0f} Hz"
    best = select_entries(rows, ["value"], lambda row: True)
    brief = [column.name for column in ESTIMATE_COLUMNS]
    return [
        ResultTable("quantities", f"Quantities from {title}", QUANTITY_COLUMNS, rows, best=best, brief=brief),
        *_log_tables(identification),
    ]


def drive_identification_result(identification: DriveIdentification) -> Result:
    """Return the result of `identify_drive`; its record is that of `DriveIdentification.to_dict`."""
    names = [
        name for name, key in (("drive", "drive_gain"), ("brakes", "brake_gain")) if key in identification.estimates
    ]
    rows = [_estimate_row(estimate) for estimate in identification.estimates.values()]
    pedals = "pedal map, " if identification.pedals is not None else ""
    title = f"{capital(pedals + ' and '.join(names))} identified from {identification.seconds:.0f} s of driving"
    return Result(
        kind="drive-identification", title=title, answer=f"{title}, relative to {identification.believed.name}.",
        record=identification.to_dict(), tables=[ResultTable("console", title, ESTIMATE_COLUMNS, rows, brief=True)],
        notes=[f"{capital(sentence)}." for sentence in identification.findings],
    )  # fmt: skip


def _log_tables(identification: Identification) -> list[ResultTable]:
    """Return a table of the estimates from each log alone; none for a single log."""
    rows: list[Row] = []
    for name in identification.estimates:
        estimates = [log_identification.estimates.get(name) for log_identification in identification.alone]
        intervals = [
            (estimate.low, estimate.high) if estimate and estimate.spread_left > 0.0 else None for estimate in estimates
        ]
        if any(intervals):
            each_log = {f"log_{i + 1}": interval for i, interval in enumerate(intervals)}
            rows.append({"quantity": name.replace("_", " "), "unit": identification[name].unit} | each_log)
    columns = [Column(f"log_{i + 1}", f"Log {i + 1}", show=3) for i in range(len(identification.alone))]
    if not identification.alone:
        return []
    title = "90 % intervals from each log alone"
    return [
        ResultTable("logs", title, (Column("quantity", "Quantity"), *columns, Column("unit", "Unit")), rows, brief=True)
    ]  # fmt: skip


def _measured_and_simulated(identification: Identification) -> Picture:
    series = identification.series
    part = turning_part(series.time, series.measured, _SECONDS)

    def draw(axes: Axes) -> None:
        axes.plot(series.time[part], series.measured[part], **_MEASURED, linewidth=0.9)
        axes.plot(series.time[part], series.simulated[part], **_SIMULATED)
        axes.set(xlabel="Time (s)", ylabel="Yaw rate (rad/s)")

    words = "Measured yaw rate, and simulation from the command alone, in the part with the most turning."
    key = [("measured", _MEASURED), ("simulated", _SIMULATED)]
    return Picture("yaw_rate", "", [Panel("Yaw rate", draw, words)], key)


def _residuals(identification: Identification) -> Picture:
    series, correlation = identification.series, identification.validation.autocorrelation
    bound = 2.0 / math.sqrt(max(int(np.isfinite(series.innovations).sum()), 1))

    def draw_bounds(axes: Axes, bound: float) -> None:
        for level in (-bound, bound):
            axes.axhline(level, linewidth=0.8, color=MUTED, linestyle=DASHED)

    def draw_errors(axes: Axes) -> None:
        axes.plot(series.time, series.innovations, ".", color=SERIES[0], markersize=1.2, zorder=5)
        draw_bounds(axes, 2.0)
        axes.set(xlabel="Time (s)", ylabel="Error/σ")

    def draw_correlation(axes: Axes) -> None:
        axes.bar(np.arange(len(correlation)) + 1, correlation, 0.6, color=SERIES[0])
        axes.grid(False, axis="x")
        draw_bounds(axes, bound)
        axes.set(xlabel="Lag (samples)", ylabel="Autocorrelation", ylim=(-0.3, 0.3))

    errors, lags = (
        "One-step errors of the yaw rate, divided by their standard deviation.",
        "Autocorrelation at lags 1 to 5 with the bounds of white noise.",
    )
    panels = [
        Panel("One-step errors", draw_errors, errors), Panel("Autocorrelation of the errors", draw_correlation, lags)
    ]  # fmt: skip
    return Picture("residuals", "", panels)


def _excited(identification: Identification) -> Picture:
    log, angle = identification.log, np.degrees(identification.series.wheel_angle)
    most = max(float(np.percentile(np.abs(angle), 99.5)), 0.1)
    counts, speeds, angles = np.histogram2d(log.speed, np.clip(angle, -most, most), bins=(24, 25))
    seconds = np.where(counts > 0.0, counts * log.period, np.nan)
    scale = ColourScale(float(np.nanmin(seconds)), float(np.nanmax(seconds)), "Time (s)", log=True)

    def draw_acceleration(axes: Axes) -> None:
        axes.plot(log.speed, log.speed * log.yaw_rate, ".", color=SERIES[0], markersize=1.2, zorder=5)
        axes.set(xlabel="Speed (m/s)", ylabel="Speed × yaw rate (m/s²)")

    longest = f"Recorded time at each speed and wheel angle, up to {number(scale.high)} s."
    panels = [
        speed_map("Speed and steering", (speeds, angles), seconds.T, scale, "Wheel angle (°)", longest),
        Panel("Lateral acceleration", draw_acceleration, "Speed times yaw rate, for each speed."),
    ]
    return Picture("excited", "", panels)


# -- contradictory inputs ---------------------------------------------------------------------------------------------
INPUT_CHECK_COLUMNS = (
    Column("compared", "compared signals"),
    Column("seconds", "time", "s", meaning="driving time in which both signals could be compared"),
    Column("verdict", "verdict"),
)


def check_result(check: LoopCheck, log: str, notes: tuple[str, ...] = ()) -> Result:
    """Return the result with the contradictions of a log and all comparisons."""
    rows = [comparison._asdict() for comparison in check.comparisons]
    sliding = (f"The car slid for {check.sliding:.1f} s.",) if check.sliding else ()
    answer = f"No contradictions in {check.compared} of {len(rows)} comparisons; the others lack a log column or bends."
    if check.contradictions:
        answer = f"Inputs contradict each other. {check.contradictions[0]}"
    return Result(
        kind="check-loop",
        title=f"Inputs of a loop: {log}",
        answer=answer,
        record={"log": log, "seconds": check.seconds, "sliding": check.sliding,
                "contradictions": list(check.contradictions), "possibilities": list(check.possibilities),
                "compared": rows},
        tables=[ResultTable("console", f"{check.seconds:.0f} s of {log}", INPUT_CHECK_COLUMNS, rows, brief=True)],
        notes=[*check.contradictions[1:], *check.possibilities, *(f"{note}." for note in notes), *sliding],
        failed=bool(check.contradictions),
    )  # fmt: skip

"""The result of an identification: how well the car is known, measured against simulated, what was excited."""

from __future__ import annotations

import math
import os
from pathlib import Path

import numpy as np

from adaptrack.base.files import write_atomically
from adaptrack.base.result import (
    BACKGROUND,
    REFERENCE,
    SERIES,
    Axis,
    Bars,
    Column,
    Dots,
    Guide,
    HeatMap,
    Panel,
    Picture,
    Polyline,
    Result,
    ResultTable,
    Row,
    Scale,
    Stroke,
    where,
)
from adaptrack.identification import Estimate, Identification
from adaptrack.identification.quantities import degrees_per_g
from adaptrack.results.words import capital, number

MEASURED, SIMULATED = Stroke(SERIES[0]), Stroke(SERIES[1])
SHOWN = 30.0
"""s of the log that the first picture shows: those with the most turning."""
_UNITS = {"N/rad": ("kN/rad", 1e-3), "rad": ("°", 180.0 / math.pi), "rad s^2/m": ("°/g", degrees_per_g(1.0)),
          "kg m^2": ("kg m²", 1.0), "m/s^2": ("m/s²", 1.0), "-": ("", 1.0)}  # fmt: skip
_NAMES = {
    "delay": "Delay of the steering", "lag": "Lag", "dead_time": "Dead time", "front": "Front axle",
    "rear": "Rear axle", "offset": "Steering offset", "push_mean": "Bank, mean push", "lf": "l_f",
    "rate": "Rate limit of the steering", "ratio": "Steering ratio",
}  # fmt: skip
_FIRST = ("delay", "understeer_gradient", "front", "rear", "offset")

CONSOLE = (
    Column("quantity", "quantity"),
    Column("value", "value"),
    Column("low", "90 % from"),
    Column("high", "to"),
    Column("unit", "unit"),
    Column("before", "believed before"),
)
PAGE = (
    Column("label", "Quantity"),
    Column("unit", "Unit"),
    Column("value", "Value", show=3),
    Column("interval", "90 % interval", show=3),
    Column("before", "Believed before", show=3),
    Column("says", "The log says"),
    Column("meaning", "Meaning"),
)


def identification_result(found: Identification, command: str = "") -> Result:
    """An identification as a result; its record is that of `Identification.to_dict`."""
    log, checked = found.log, found.validation
    simulated = f"{100 * checked.simulated:.1f} % simulated from the command"
    explained = f"{100 * checked.one_step:.1f} % of the yaw rate's variance is explained one step ahead"
    return Result(
        kind="identification",
        title=f"A car from {f'{len(found.alone)} logs' if found.alone else 'a log'}: {found.believed.name}",
        answer=f"{_first(found)}; on {checked.held_out:.0f} s held out {explained}, {simulated}.",
        record=found.to_dict(),
        tables=_tables(found),
        notes=[f"{capital(each)}." for each in (*log.notes, *found.findings)],
        pictures=[_measured_and_simulated(found), _residuals(found), _excited(found)],
        failed=not (found.consistent and checked.simulated > 0.5),
        headline="" if found.consistent else "Not consistent",
        values={
            "checked": checked, "log": log, "believed": found.believed, "rate": 1.0 / log.period,
            "findings": [f"{capital(each)}." for each in found.findings],
            "reasons": [f"{capital(each)}." for each in found.reasons],
            "first": [_in_units(found[name]) for name in _FIRST if name in found.estimates],
        },
        command=command,
    )  # fmt: skip


def _first(found: Identification) -> str:
    """Return the most important estimates as a headline."""
    shown = [_in_units(found[name]) for name in _FIRST[:2] if name in found.estimates]
    said = [f"{each['label'].lower()} {each['value']:.3g} ± {each['half']:.2g} {each['unit']}" for each in shown]
    return capital(", ".join(said)) if said else "Nothing was found of delay and understeer"


def write_identification_page(found: Identification, path: str | os.PathLike[str], command: str = "") -> Path:
    """Write the page as one file; its path.

    Raises
    ------
    StorageError
        When it cannot be written.
    """
    from adaptrack.results.page import render_result

    write_atomically(path, render_result(identification_result(found, command)).encode())
    return Path(path)


def _in_units(each: Estimate) -> Row:
    """An estimate in the units that a reader has."""
    unit, factor = _UNITS.get(each.unit, (each.unit, 1.0))
    return {
        "label": capital(_NAMES.get(each.name, each.name.replace("_", " "))),
        "unit": unit,
        "value": each.value * factor,
        "interval": (each.low * factor, each.high * factor),
        "half": 0.5 * (each.high - each.low) * factor,
        "before": (each.before[0] * factor, each.before[1] * factor),
        "says": "much" if each.spread_left < 0.2 else "some" if each.spread_left < 0.7 else "next to nothing",
        "meaning": each.meaning,
    }


def _tables(found: Identification) -> list[ResultTable]:
    log = found.log
    known = [each for each in found.estimates.values() if each.spread_left > 0.0]  # the others stay as believed
    plain = [
        {
            "quantity": each.name.replace("_", " "), "value": each.value, "low": each.low, "high": each.high,
            "unit": each.unit, "before": f"{each.before[0]:.3g} to {each.before[1]:.3g}",
        }
        for each in known
    ]  # fmt: skip
    rows = [_in_units(each) for each in known]
    title = f"{log.driven:.0f} s of driving, {log.samples} samples at {1.0 / log.period:.0f} Hz"
    return [
        ResultTable("console", title, CONSOLE, plain, brief=True),
        ResultTable(
            "quantities", "Quantities with their 90 % intervals", PAGE, rows,
            best=where(rows, ["value"], lambda row: True),
        ),
        *_of_each_log(found),
    ]  # fmt: skip


def _of_each_log(found: Identification) -> list[ResultTable]:
    """Table of the estimates from each single log."""
    rows: list[Row] = []
    for name in found.estimates:
        own = [each.estimates.get(name) for each in found.alone]
        intervals = [(each.low, each.high) if each and 0.0 < each.spread_left < 1.0 else None for each in own]
        if any(intervals):
            each_log = {f"log_{i + 1}": interval for i, interval in enumerate(intervals)}
            rows.append({"quantity": name.replace("_", " "), "unit": found[name].unit} | each_log)
    columns = [Column(f"log_{i + 1}", f"Log {i + 1}", show=3) for i in range(len(found.alone))]
    if not found.alone:
        return []
    title = "90 % intervals of each log by itself"
    return [
        ResultTable("logs", title, (Column("quantity", "Quantity"), *columns, Column("unit", "Unit")), rows, brief=True)
    ]  # fmt: skip


def _measured_and_simulated(found: Identification) -> Picture:
    series = found.series
    turning = np.nan_to_num(series.measured) ** 2
    total = np.concatenate([[0.0], np.cumsum(turning)])
    ends = np.searchsorted(series.time, series.time + SHOWN, side="right")
    first = int(np.argmax(total[ends] - total[np.arange(turning.size)]))
    part = slice(first, int(ends[first]))
    panel = Panel(
        "Yaw rate", Axis("Time (s)"), Axis("Yaw rate (rad/s)"),
        [
            Polyline(series.time[part], series.measured[part], MEASURED, width=0.9),
            Polyline(series.time[part], series.simulated[part], SIMULATED),
        ],
        "Measured and simulated from the command alone, in the stretch with most turning.",
    )  # fmt: skip
    caption = (
        f"The {SHOWN:.0f} s with the most turning. Simulated from the command alone, without wind: what differs slowly "
        "is wind and road."
    )
    return Picture("yaw_rate", caption, [panel], [("measured", MEASURED), ("simulated", SIMULATED)])


def _residuals(found: Identification) -> Picture:
    series, correlation = found.series, found.validation.autocorrelation
    dashed = Stroke(BACKGROUND.colour, REFERENCE.dash)
    bound = 2.0 / math.sqrt(max(int(np.isfinite(series.innovations).sum()), 1))
    panels = [
        Panel(
            "One-step errors", Axis("Time (s)"), Axis("Error / its σ"),
            [Dots(series.time, series.innovations, marker="point", size=1.2), Guide("y", (-2.0, 2.0), dashed)],
            "Errors of the yaw rate over their standard deviation.",
        ),
        Panel(
            "Are they white?", Axis("Lag (samples)"), Axis("Autocorrelation", -0.3, 0.3),
            [
                Bars(np.arange(len(correlation) + 1) + 0.5, correlation, fill=0.6),
                Guide("y", (-bound, bound), dashed),
            ],
            "Autocorrelation at lags 1 to 5 with the bounds of white noise.",
        ),
    ]  # fmt: skip
    return Picture(
        "residuals", "One step ahead, in standard deviations; dashed: ±2σ, and the bounds of white noise.", panels
    )


def _excited(found: Identification) -> Picture:
    log, angle = found.log, np.degrees(found.series.wheel_angle)
    most = max(float(np.percentile(np.abs(angle), 99.5)), 0.1)
    seconds, x, y = np.histogram2d(log.speed, np.clip(angle, -most, most), bins=(24, 25))
    seconds = np.where(seconds > 0.0, seconds * log.period, np.nan)
    scale = Scale(float(np.nanmin(seconds)), float(np.nanmax(seconds)), "Time (s)", log=True)
    panels = [
        Panel(
            "Speed and steering", Axis("Speed (m/s)"), Axis("Wheel angle (°)"), [HeatMap(x, y, seconds.T, scale)],
            f"How long the log was at each speed and wheel angle, up to {number(scale.high)} s.",
        ),
        Panel(
            "Lateral acceleration", Axis("Speed (m/s)"), Axis("Speed × yaw rate (m/s²)"),
            [Dots(log.speed, log.speed * log.yaw_rate, marker="point", size=1.2)],
            "Speed times yaw rate over the speed.",
        ),
    ]  # fmt: skip
    caption = "Where the log has been: stiffness shows in steering at speed, the delay in quick steering anywhere."
    return Picture("excited", caption, panels)

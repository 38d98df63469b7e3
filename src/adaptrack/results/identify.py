"""The page of an identification: how well the car is known, measured against simulated, what was excited."""

from __future__ import annotations

import math
import os
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm

from adaptrack.base.files import write_atomically
from adaptrack.identification import Estimate, Identification
from adaptrack.identification.quantities import degrees_per_g
from adaptrack.results import style
from adaptrack.results.maps import COLOURS
from adaptrack.results.page import Cell, Head, Panel, Picture, Section, Table, Terms, Verbatim, Verdict, render
from adaptrack.results.words import number, percent

MEASURED, SIMULATED = style.Stroke(style.SERIES[0]), style.Stroke(style.SERIES[1])
SHOWN = 30.0
"""s of the log that the first picture shows: those with the most turning."""
_UNITS = {"N/rad": ("kN/rad", 1e-3), "rad": ("°", 180.0 / math.pi), "rad s^2/m": ("°/g", degrees_per_g(1.0)),
          "kg m^2": ("kg m²", 1.0), "m/s^2": ("m/s²", 1.0), "-": ("", 1.0)}  # fmt: skip
_WORDS = {
    "delay": "Delay of the steering", "lag": "Lag", "dead_time": "Dead time", "front": "Front axle",
    "rear": "Rear axle", "offset": "Steering offset", "push_mean": "Bank, mean push", "lf": "l_f",
    "rate": "Rate limit of the steering", "ratio": "Steering ratio",
}  # fmt: skip
_FIRST = ("delay", "understeer_gradient", "front", "rear", "offset")


def write_identification_page(found: Identification, path: str | os.PathLike[str], command: str = "") -> Path:
    """Write the page as one file; its path.

    Raises
    ------
    StorageError
        When it cannot be written.
    """
    sections = [
        Section("Verdict", [_verdict(found)]),
        Section("What is known", [_table(found), *_findings(found)]),
        Section("Residuals", [_residuals(found)]),
        Section("What was excited", [_excited(found)]),
        Section("How it was made", [_made(found), *([Verbatim(command)] if command else [])]),
    ]
    title = f"A car from a log: {found.believed.name}"
    write_atomically(path, render(sections, title=title).encode())
    return Path(path)


def _in_words(each: Estimate) -> tuple[str, str, float]:
    """Name, unit and factor to it, as a reader has them."""
    unit, factor = _UNITS.get(each.unit, (each.unit, 1.0))
    name = _WORDS.get(each.name, each.name.replace("_", " "))
    return name[:1].upper() + name[1:], unit, factor


def _verdict(found: Identification) -> Verdict:
    checked = found.validation
    poor = not checked.simulated > 0.5
    text = (
        f"{percent(checked.simulated)} % of the yaw rate's variance is explained by the car that was found, on "
        f"{checked.held_out:.0f} s that it was not fitted to"
    )
    entries = []
    for name in _FIRST:
        if name in found.estimates:
            label, unit, factor = _in_words(found[name])
            each = found[name]
            half = 0.5 * (each.high - each.low) * factor
            entries.append((label, f"{number(each.value * factor)} ± {number(half, 2)} {unit}"))
    return Verdict(text, Terms(entries), _measured_and_simulated(found), failed=poor)


def _measured_and_simulated(found: Identification) -> Picture:
    series = found.series
    turning = np.nan_to_num(series.measured) ** 2
    total = np.concatenate([[0.0], np.cumsum(turning)])
    ends = np.searchsorted(series.time, series.time + SHOWN, side="right")
    first = int(np.argmax(total[ends] - total[np.arange(turning.size)]))
    window = slice(first, int(ends[first]))

    def draw(axes: Axes) -> None:
        axes.plot(series.time[window], series.measured[window], color=MEASURED.colour, linewidth=0.9)
        axes.plot(series.time[window], series.simulated[window], color=SIMULATED.colour)
        axes.set_xlabel("Time (s)")
        axes.set_ylabel("Yaw rate (rad/s)")

    panel = Panel("Yaw rate", draw, "Measured and simulated from the command alone, in the stretch with most turning.")
    caption = (
        f"The {SHOWN:.0f} s with the most turning. Simulated from the command alone, without wind: what differs slowly "
        "is wind and road."
    )
    return Picture(caption, [panel.drawing()], (("measured", MEASURED), ("simulated", SIMULATED)))


def _table(found: Identification) -> Table:
    rows: list[list[Cell | str]] = []
    for each in found.estimates.values():
        if each.told <= 0.0:  # kept as it was believed
            continue
        label, unit, factor = _in_words(each)
        rows.append([
            label, unit, Cell(number(each.value * factor), strong=True), f"{number(each.low * factor)} to "
            f"{number(each.high * factor)}", f"{number(each.before[0] * factor)} to {number(each.before[1] * factor)}",
            _said(each.told), each.meaning,
        ])  # fmt: skip
    heads = [
        Head("Quantity", is_text=True), Head("Unit", is_text=True), Head("Value"), Head("90 % interval"),
        Head("Believed before"), Head("The log says", is_text=True), Head("Meaning", is_text=True),
    ]  # fmt: skip
    return Table("Quantities with their 90 % intervals", heads, rows)


def _said(told: float) -> str:
    return "much" if told < 0.2 else "some" if told < 0.7 else "next to nothing"


def _findings(found: Identification) -> list[str]:
    return [f"{sentence[:1].upper()}{sentence[1:]}." for sentence in found.findings]


def _residuals(found: Identification) -> Picture:
    series = found.series

    def along(axes: Axes) -> None:
        axes.plot(series.time, series.innovations, ".", color=MEASURED.colour, markersize=1.2)
        for level in (-2.0, 2.0):
            axes.axhline(level, color=style.MUTED, linewidth=0.8, linestyle=style.REFERENCE.dash)
        axes.set_xlabel("Time (s)")
        axes.set_ylabel("Error / its σ")

    def coloured(axes: Axes) -> None:
        lags = np.arange(1, len(found.validation.autocorrelation) + 1)
        axes.bar(lags, found.validation.autocorrelation, color=MEASURED.colour, width=0.6)
        bound = 2.0 / math.sqrt(max(int(np.isfinite(series.innovations).sum()), 1))
        for level in (-bound, bound):
            axes.axhline(level, color=style.MUTED, linewidth=0.8, linestyle=style.REFERENCE.dash)
        axes.set_ylim(-0.3, 0.3)
        axes.set_xlabel("Lag (samples)")
        axes.set_ylabel("Autocorrelation")

    panels = [
        Panel("One-step errors", along, "Errors of the yaw rate over their standard deviation."),
        Panel("Are they white?", coloured, "Autocorrelation at lags 1 to 5 with the bounds of white noise."),
    ]
    caption = "One step ahead, in standard deviations; dashed: ±2σ, and the bounds of white noise."
    return Picture(caption, [panel.drawing() for panel in panels])


def _excited(found: Identification) -> Picture:
    log, series = found.log, found.series

    def both(axes: Axes) -> None:
        angle = np.degrees(series.wheel_angle)
        most = max(float(np.percentile(np.abs(angle), 99.5)), 0.1)
        _, _, _, picture = axes.hist2d(
            log.speed, np.clip(angle, -most, most), bins=(24, 25), norm=LogNorm(), cmap=COLOURS, weights=np.full(
                log.samples, log.period))  # fmt: skip
        axes.figure.colorbar(picture, ax=axes, label="Time (s)")
        axes.set_xlabel("Speed (m/s)")
        axes.set_ylabel("Wheel angle (°)")

    def sideways(axes: Axes) -> None:
        axes.plot(log.speed, log.speed * log.yaw_rate, ".", color=MEASURED.colour, markersize=1.2)
        axes.set_xlabel("Speed (m/s)")
        axes.set_ylabel("Speed × yaw rate (m/s²)")

    panels = [
        Panel("Speed and steering", both, "How long the log was at each speed and wheel angle."),
        Panel("Lateral acceleration", sideways, "Speed times yaw rate over the speed."),
    ]
    caption = "Where the log has been: stiffness shows in steering at speed, the delay in quick steering anywhere."
    return Picture(caption, [panel.drawing() for panel in panels])


def _made(found: Identification) -> Terms:
    log, checked = found.log, found.validation
    return Terms([
        ("Log", f"{log.driven:.0f} s of driving in {log.segments} segments, {log.samples} samples, "
                f"{1.0 / log.period:.0f} Hz"),
        ("Read as", "; ".join(log.notes) or "named columns in SI units"),
        ("Before the log", f"{found.believed.name}: {number(found.believed.mass)} kg, wheelbase "
                           f"{number(found.believed.wheelbase)} m"),
        ("Held out", f"every fourth 10 s: {percent(checked.one_step)} % of the variance explained one step ahead, "
                     f"{percent(checked.simulated)} % simulated from the command"),
    ])  # fmt: skip

"""Result of a certificate: stability and margins of the control loop over its whole operating range."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from adaptrack.analysis.certify import DRIVING_CASES, Certificate, Driving, Sweep
from adaptrack.analysis.stability import Margins
from adaptrack.base.result import Column, Panel, Picture, Result, ResultTable, Row, select_entries
from adaptrack.control.scheduling import VARIABLES, SchedulingVariables
from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import Array
from adaptrack.results import marks
from adaptrack.results.words import number

THIN_MODULUS = 0.25
"""Modulus margin below which an answer calls it thin; textbooks ask for at least 0.5."""
_WORST = 8
"""Number of worst points in the table, for driving straight and for the hard turn."""
_STROKES: dict[Driving, marks.Stroke] = {
    "straight": {"color": marks.SERIES[0], "linestyle": "-"},
    "turn": {"color": marks.SERIES[1], "linestyle": marks.LONG_DASHES},
}
_NAMES: dict[Driving, str] = {"straight": "Driving straight", "turn": "In a hard turn"}

MARGIN_COLUMNS = (
    Column("name", "Scheduler"),
    Column("points", "Points"),
    Column("unstable", "Unstable"),
    Column("radius", "Largest spectral radius", show=4),
    Column("gain_up", "Smallest gain margin up", show=3),
    Column("gain_down", "Largest gain margin down", show=3),
    Column("delay", "Smallest delay margin", "ms", show=3),
    Column("modulus_margin", "Smallest modulus margin", show=3),
)
CERTIFICATE_COLUMNS = (
    Column("speed", "Speed", "m/s", 3),
    Column("friction", "Friction", "", 3),
    Column("Np", "Np", "", "whole"),
    Column("Nc", "Nc", "", "whole"),
    Column("ratio", "R/Q", "m²/rad²", 3),
    Column("radius", "Spectral\nradius"),
    Column("gain_up", "Gain\nup", "", 3, "factor on the steering command at which the loop becomes unstable"),
    Column("gain_down", "Gain\ndown", "", 3, "factor on the steering command at which the loop becomes unstable"),
    Column("delay", "Delay", "ms", 3, "additional delay at which the loop becomes unstable"),
    Column("modulus_margin", "Modulus\nmargin", "", 3),
)
MISMATCH_COLUMNS = (
    Column("mismatch", "Difference"), Column("unstable", "Unstable", "", "whole"), *CERTIFICATE_COLUMNS[:6],
    *CERTIFICATE_COLUMNS[8:],
)  # fmt: skip

_RADIUS = marks.ColourScale(0.8, 1.02, "Spectral radius (–)", colours="cividis_r")
_MODULUS = marks.ColourScale(0.0, 1.0, "Modulus margin (–)")
_UP = marks.ColourScale(1.0, 20.0, "Gain margin up (factor)", log=True)
_DOWN = marks.ColourScale(0.0, 1.0, "Gain margin down (factor)", colours="cividis_r")
_DELAY = marks.ColourScale(1.0, 1000.0, "Delay margin (ms)", log=True)


def certificate_result(certificate: Certificate) -> Result:
    """Return the result of a certificate; its record holds the summary and every point."""
    sweeps = _sweeps(certificate)
    worst = certificate.counted.straight.extremes
    maps = [
        _margin_maps(certificate, f"{file}{'-turn' * (driving == 'turn')}", f"{name}, {_NAMES[driving].lower()}",
                     getattr(sweep, driving))
        for (name, sweep), file in zip(sweeps, ("margins", "margins-bare"), strict=False) for driving in DRIVING_CASES
    ]  # fmt: skip
    mismatched = certificate.mismatched or {}
    return Result(
        kind="certificate",
        title=f"Certificate of {certificate.scheduler}: {certificate.plant}, profile {certificate.profile}",
        answer=_answer(certificate),
        record={**certificate.summary(), "rows": certificate.rows()},
        tables=[_worst(certificate), *_margin_tables(certificate)],
        notes=[f"Steering model of the controller: {certificate.belief}."] if certificate.belief else [],
        pictures=[_modulus(certificate, worst["modulus_margin"]), *maps, _tunings(certificate)],
        failed=not certificate.passed,
        values={
            "certificate": certificate, "worst": worst, "maps": [picture.name for picture in maps],
            "unstable_cars": sum(bool((margins.radius >= 1.0).any()) for margins in mismatched.values()),
        },
    )  # fmt: skip


def _answer(certificate: Certificate) -> str:
    """The verdict; for a stable loop preceded by its smallest margins when driving straight."""
    if not certificate.passed:
        return certificate.verdict
    (worst,), delay = certificate.worst_points(1), float(certificate.counted.straight.delay.min())
    modulus, at = worst["modulus_margin"], f"at {worst['speed']:.3g} m/s on friction {worst['friction']:.2g}"
    thin = []
    if delay < certificate.period:
        thin.append(f"{1000.0 * delay:.0f} ms of delay, where a control period is {1000.0 * certificate.period:.0f} ms")
    if modulus < THIN_MODULUS:
        thin.append(f"a modulus margin of {modulus:.2g} {at}, where 0.5 is usual")
    if thin:
        return f"Stable, but with thin margins: {' and '.join(thin)}. {certificate.verdict}"
    return f"Stable; the smallest modulus margin is {modulus:.2g}, {at}. {certificate.verdict}"


# -- tables -----------------------------------------------------------------------------------------------------------
def _sweeps(certificate: Certificate) -> list[tuple[str, Sweep]]:
    if certificate.guarded is None:
        return [("Without a guard", certificate.bare)]
    return [("With the guard", certificate.guarded), ("Without the guard", certificate.bare)]


def with_ratio(points: Sequence[Row]) -> list[dict[str, Any]]:
    """Add R/Q to points, the only part of Q and R that acts on the control law; None if Q is 0."""
    return [{**point, "ratio": point["R"] / point["Q"] if point["Q"] else None} for point in points]


def _point_rows(points: Sequence[Row]) -> list[dict[str, Any]]:
    """Return rows of `CERTIFICATE_COLUMNS`: with R/Q, delays in ms, and infinite margins, which JSON has as None."""
    rows = with_ratio(points)
    for row in rows:
        row |= {key: math.inf for key in ("gain_up", "gain_down", "delay") if row[key] is None}
        row["delay"] *= 1000.0
    return rows


def _margin_tables(certificate: Certificate) -> list[ResultTable]:
    rows = [
        _extremes(name, getattr(sweep, driving)) | {"driving": _NAMES[driving]}
        for driving in DRIVING_CASES for name, sweep in _sweeps(certificate)
    ]  # fmt: skip
    title = "Worst value of every margin over all points"
    tables = [ResultTable("margins", title, MARGIN_COLUMNS, rows, group="driving", alert=_unstable(rows))]
    if certificate.mismatched:
        cars = [_extremes(name, margins) for name, margins in certificate.mismatched.items()]
        columns = (Column("name", "True car"), *MARGIN_COLUMNS[1:])
        tables.append(ResultTable("mismatched", title, columns, cars, alert=_unstable(cars)))
        title = "Points of cars that differ from the model with the smallest modulus margin"
        points = _point_rows(certificate.mismatched_rows())
        tables.append(ResultTable("worst mismatched", title, MISMATCH_COLUMNS, points, brief=True))
    return tables


def _extremes(name: str, margins: Margins) -> dict[str, Any]:
    worst = margins.extremes
    counts = {"points": len(margins.radius), "unstable": int((margins.radius >= 1.0).sum())}
    return {"name": name, **counts, **worst, "delay": 1000.0 * worst["delay"]}


def _unstable(rows: Sequence[Row]) -> frozenset[tuple[int, str]]:
    return select_entries(rows, ["unstable", "radius"], lambda row: row["unstable"] > 0)


def _worst(certificate: Certificate) -> ResultTable:
    names = SchedulingVariables._fields
    varied = [
        Column(name, variable.label, variable.unit, 3) for name, variable in VARIABLES.items()
        if name not in ("speed", "friction") and np.ptp(certificate.points[:, names.index(name)]) > 0.0
    ]  # fmt: skip
    rows = [
        {**point, "part": f"{name}, {_NAMES[driving].lower()}"}
        for name, sweep in _sweeps(certificate)
        for driving in DRIVING_CASES
        for point in _point_rows(certificate.worst_points(_WORST, sweep, driving))
    ]
    columns = [*CERTIFICATE_COLUMNS[:2], *varied, *CERTIFICATE_COLUMNS[2:]]
    unstable = select_entries(rows, ["radius"], lambda row: row["radius"] is None or row["radius"] >= 1.0)
    title = f"{certificate.scheduler}: points with the smallest modulus margin"
    note = "Only driving straight counts for the verdict; the hard turn is a warning."
    return ResultTable("worst", title, columns, rows, note, "part", alert=unstable, brief=True)


# -- pictures ---------------------------------------------------------------------------------------------------------
def _modulus(certificate: Certificate, least: float) -> Picture:
    def draw(axes: marks.Axes) -> None:
        dots: dict[str, Any] = {"marker": "o", "markersize": 3.5} if len(certificate.speeds) < 12 else {}
        for driving, stroke in _STROKES.items():
            margin = getattr(certificate.counted, driving).modulus_margin.reshape(len(certificate.speeds), -1)
            low, high = margin.min(axis=1), margin.max(axis=1)
            axes.fill_between(certificate.speeds, low, high, color=stroke["color"], **marks.BAND)
            axes.plot(certificate.speeds, low, **stroke, **dots)
        axes.axhline(0.0, linewidth=0.9, **marks.SHARED_STROKE)
        axes.set(xlabel="Speed (m/s)", ylabel="Modulus margin (–)")

    panel = Panel("Modulus margin over the speed", draw, f"Driving straight: at least {number(least)}.")
    return Picture("modulus", "", [panel], [(_NAMES[driving], stroke) for driving, stroke in _STROKES.items()])


def _margin_maps(certificate: Certificate, name: str, title: str, margins: Margins) -> Picture:
    """The maps of one way of driving; a cross marks a cell with an unstable point."""
    unstable = np.asarray(certificate.cells(margins.radius >= 1.0).max(axis=2))
    maps = [
        (_RADIUS, certificate.cells(margins.radius).max(axis=2)),
        (_MODULUS, certificate.cells(margins.modulus_margin).min(axis=2)),
        (_UP, certificate.cells(margins.gain_up).min(axis=2)),
        (_DOWN, certificate.cells(margins.gain_down).max(axis=2)),
        (_DELAY, 1000.0 * certificate.cells(margins.delay).min(axis=2)),
    ]
    panels = [_map(certificate, _narrow_scale(scale, values), values, unstable) for scale, values in maps]
    crosses = " A cross marks a cell with an unstable point." if unstable.any() else ""
    caption = (
        f"{title}. Worst value over all other scheduling variables. Dark is worse; each map has its own scale.{crosses}"
    )
    return Picture(name, caption, panels, file=f"{name}.png", columns=3, row_height=2.0)


def _tunings(certificate: Certificate) -> Picture:
    Np, Nc, Q, R = certificate.counted.tunings.T
    with np.errstate(divide="ignore"):
        ratio = portable.log10(R) - portable.log10(Q)
    panels = []
    for symbol, values, integer in (("$N_p$ (periods)", Np, True), ("$N_c$ (periods)", Nc, True),
                                  (r"$\log_{10} R/Q$ (R/Q in m²/rad²)", ratio, False)):  # fmt: skip
        cells = np.median(certificate.cells(values), axis=2)
        finite = cells[np.isfinite(cells)]
        low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 0.0)
        middle, span = (low + high) / 2.0, max(high - low, 2.0 if integer else 0.2)
        scale = marks.ColourScale(middle - span / 2.0, middle + span / 2.0, symbol, integer=integer)
        panels.append(_map(certificate, scale, cells))
    if certificate.guarded is not None:
        share = 100.0 * certificate.cells(certificate.fallback).mean(axis=2)
        panels.append(_map(certificate, marks.ColourScale(0.0, 100.0, "Fallback tuning (% of points)"), share))
    columns = len(panels) if len(panels) < 4 else 2
    return Picture("tunings", "", panels, file="tunings.png", columns=columns, row_height=2.0)


def _narrow_scale(scale: marks.ColourScale, values: Array) -> marks.ColourScale:
    """Narrow a scale to the 2nd to 98th percentile of the values, within its bounds."""
    finite = values[np.isfinite(values)]
    if not finite.size:
        return scale
    low, high = np.clip(np.percentile(finite, (2.0, 98.0)), scale.low, scale.high)
    least = 0.1 * high if scale.log else 0.02 * (scale.high - scale.low)  # equal values have one colour
    if high - low < least:
        low, high = max(scale.low, low - least), min(scale.high, high + least)
    return replace(scale, low=float(low), high=float(high))


def _map(
    certificate: Certificate, scale: marks.ColourScale, values: Array, unstable: NDArray[np.bool_] | None = None
) -> Panel:
    """A map of values over speed and friction, crossed where unstable; both (speeds, frictions)."""
    low, high = float(values.min()), float(values.max())
    slack = 1e-9 * (scale.high - scale.low)
    below, above = low < scale.low - slack, high > scale.high + slack
    beyond = "both" if below and above else "min" if below else "max" if above else "neither"
    bar = replace(scale, label="", beyond=beyond)  # type: ignore[arg-type]

    i, j = np.nonzero(np.zeros(values.shape, bool) if unstable is None else unstable)
    edges = marks.edges_around(certificate.speeds), marks.edges_around(certificate.frictions)
    return marks.speed_map(
        scale.label, edges, np.clip(values, scale.low, scale.high).T, bar, "Friction (–)",
        f"{number(low)} to {number(high)}.", crosses=(certificate.speeds[i], certificate.frictions[j]),
    )  # fmt: skip

"""The result of a certificate: stability and margins of a scheduler's loop over its whole operating domain."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from adaptrack.analysis.certify import DRIVING_CASES, Certificate, Driving, Sweep, extremes
from adaptrack.analysis.stability import Margins
from adaptrack.base.result import (
    NEUTRAL,
    SERIES,
    Axis,
    Column,
    Dots,
    Guide,
    HeatMap,
    Panel,
    Picture,
    Polyline,
    Result,
    ResultTable,
    Ribbon,
    Row,
    Scale,
    Stroke,
    where,
)
from adaptrack.control.scheduling import SchedulingVariables
from adaptrack.results.answers import of_certificate
from adaptrack.results.maps import edges_around
from adaptrack.results.words import INPUTS, number

Array = NDArray[np.float64]

_WORST = 8
"""Points of the page's table of the worst, for each way of driving."""
_STROKES: dict[Driving, Stroke] = {"straight": Stroke(SERIES[0]), "turn": Stroke(SERIES[1], "long")}
_NAMES: dict[Driving, str] = {"straight": "Driving straight", "turn": "In a hard turn"}
_TITLES: dict[Driving, str] = {
    "straight": "driving straight (the verdict)", "turn": "in a hard turn (no verdict)"
}  # fmt: skip

MARGINS = (
    Column("name", "Scheduler"),
    Column("points", "Points"),
    Column("unstable", "Unstable"),
    Column("radius", "Largest radius", show=4),
    Column("gain_up", "Least gain margin up", show=3),
    Column("gain_down", "Largest gain margin down", show=3),
    Column("delay", "Least delay margin", "ms", show=3),
    Column("modulus_margin", "Least modulus margin", show=3),
)
CONSOLE = (
    Column("driving", "driving"),
    Column("guard", "guard"),
    Column("speed", "speed", "m/s", 3),
    Column("friction", "friction", "", 3),
    Column("Np", "Np", "", 3),
    Column("Nc", "Nc", "", 3),
    Column("ratio", "R/Q", "m²/rad²", 3),
    Column("radius", "spectral\nradius"),
    Column("delay", "delay", "s", 3),
    Column("modulus_margin", "modulus\nmargin", "", 3),
)
MISMATCHED = (Column("mismatch", "the car has"), Column("unstable", "unstable", "", "whole"), *CONSOLE[2:])

_RADIUS = Scale(0.8, 1.02, "Spectral radius (–)", reversed=True)
_MODULUS = Scale(0.0, 1.0, "Modulus margin (–)")
_UP = Scale(1.0, 20.0, "Gain margin up (factor)", log=True)
_DOWN = Scale(0.0, 1.0, "Gain margin down (factor)", reversed=True)
_DELAY = Scale(1.0, 1000.0, "Delay margin (ms)", log=True)


def certificate_result(found: Certificate, command: str = "", next_step: str = "") -> Result:
    """A certificate as a result; its record holds the summary and every point.

    command: the command line that makes it again; next_step: what to do next, with the command.
    """
    sweeps = _sweeps(found)
    worst, turn = extremes(found.counted.straight), int(found.counted.unstable_in_turn.sum())
    maps = [
        _margin_maps(found, f"{file}{'-turn' * (driving == 'turn')}", f"{name}, {_NAMES[driving].lower()}",
                     getattr(sweep, driving))
        for (name, sweep), file in zip(sweeps, ("margins", "margins-bare"), strict=False) for driving in DRIVING_CASES
    ]  # fmt: skip
    mismatched = found.mismatched or {}
    return Result(
        kind="certificate",
        title=f"Certificate of {found.scheduler}: {found.plant}, profile {found.profile}",
        answer=of_certificate(found),
        record={**found.summary(), "rows": found.rows()},
        tables=[*_console_tables(found), *_margin_tables(found), _worst(found)],
        notes=[f"belief: {found.belief}."] if found.belief else [],
        pictures=[_modulus(found, worst["modulus_margin"]), *maps, _tunings(found)],
        failed=not found.passed,
        values={
            "found": found, "points": len(found.points), "unstable": int(found.counted.unstable.sum()), "worst": worst,
            "turn": turn, "maps": [each.name for each in maps], "mismatched": len(mismatched),
            "unstable_cars": sum(bool((margins.radius >= 1.0).any()) for margins in mismatched.values()),
            "unguarded": None if found.guarded is None else int(found.bare.unstable.sum()),
            "fallback": None if found.guarded is None else float(found.fallback.mean()),
        },
        command=command,
        next_step=next_step,
    )  # fmt: skip


# -- tables -----------------------------------------------------------------------------------------------------------
def _sweeps(found: Certificate) -> list[tuple[str, Sweep]]:
    if found.guarded is None:
        return [("Without a guard", found.bare)]
    return [("With the guard", found.guarded), ("Without the guard", found.bare)]


def with_ratio(points: Sequence[Row]) -> list[dict[str, Any]]:
    """Points with R/Q, which alone acts on the control law; None where Q is 0."""
    return [{**point, "ratio": point["R"] / point["Q"] if point["Q"] else None} for point in points]


def _console_tables(found: Certificate) -> list[ResultTable]:
    """The points with the smallest modulus margin, for each way of driving, with the guard and without."""
    sweeps = [(found.guarded is not None, found.counted)]
    sweeps += [(False, found.bare)] if found.guarded is not None else []
    tables = []
    for driving in DRIVING_CASES:
        points = [{"guard": on, **point} for on, sweep in sweeps for point in found.worst_points(5, sweep, driving)]
        title = f"{found.scheduler}, {_TITLES[driving]}: the points nearest to instability"
        tables.append(ResultTable(f"nearest_{driving}", title, CONSOLE, with_ratio(points), brief=True))
    if found.mismatched:
        title = f"{found.scheduler}, driving straight with another car: the points nearest to instability"
        rows = with_ratio(found.mismatched_rows())
        tables.append(ResultTable("nearest_mismatched", title, MISMATCHED, rows, brief=True))
    return tables


def _margin_tables(found: Certificate) -> list[ResultTable]:
    rows = [
        _extremes(name, getattr(sweep, driving)) | {"driving": _NAMES[driving]}
        for driving in DRIVING_CASES for name, sweep in _sweeps(found)
    ]  # fmt: skip
    title = "The worst of every margin, over all points"
    tables = [ResultTable("margins", title, MARGINS, rows, group="driving", alert=_unstable(rows))]
    if found.mismatched:
        cars = [_extremes(name, margins) for name, margins in found.mismatched.items()]
        columns = (Column("name", "True car"), *MARGINS[1:])
        tables.append(ResultTable("mismatched", title, columns, cars, alert=_unstable(cars)))
    return tables


def _extremes(name: str, margins: Margins) -> dict[str, Any]:
    worst = extremes(margins)
    counts = {"points": len(margins.radius), "unstable": int((margins.radius >= 1.0).sum())}
    return {"name": name, **counts, **worst, "delay": 1000.0 * worst["delay"]}


def _unstable(rows: Sequence[Row]) -> frozenset[tuple[int, str]]:
    return where(rows, ["unstable", "radius"], lambda row: row["unstable"] > 0)


def _worst(found: Certificate) -> ResultTable:
    names = SchedulingVariables._fields
    varied = [
        name for name in INPUTS
        if name not in ("speed", "friction") and np.ptp(found.points[:, names.index(name)]) > 0.0
    ]  # fmt: skip
    columns = [
        Column("speed", "Speed", "m/s", 3),
        Column("friction", "Friction", "", 3),
        *(Column(name, *INPUTS[name], 3) for name in varied),
        Column("Np", "Np"),
        Column("Nc", "Nc"),
        Column("ratio", "R/Q", "m²/rad²", 3),
        Column("radius", "Radius", "", 4),
        Column("gain_up", "Gain up", "", 3),
        Column("gain_down", "Gain down", "", 3),
        Column("delay", "Delay", "ms", 3),
        Column("modulus_margin", "Modulus margin", "", 3),
    ]
    rows = [
        _point(point) | {"part": f"{name}, {_NAMES[driving].lower()}"}
        for name, sweep in _sweeps(found)
        for driving in DRIVING_CASES
        for point in found.worst_points(_WORST, sweep, driving)
    ]
    unstable = where(rows, ["radius"], lambda row: row["radius"] >= 1.0)
    return ResultTable(
        "worst", "The points with the smallest modulus margin", columns, rows, group="part", alert=unstable
    )


def _point(point: Row) -> dict[str, Any]:
    up, down, delay = (math.inf if point[name] is None else point[name] for name in ("gain_up", "gain_down", "delay"))
    return {
        **point, "Np": int(point["Np"]), "Nc": int(point["Nc"]), "gain_up": up, "gain_down": down,
        "delay": 1000.0 * delay, "ratio": point["R"] / point["Q"] if point["Q"] > 0.0 else math.inf,
    }  # fmt: skip


# -- pictures ---------------------------------------------------------------------------------------------------------
def _modulus(found: Certificate, least: float) -> Picture:
    marks: list[Any] = []
    for driving, stroke in _STROKES.items():
        margin = found.cells(getattr(found.counted, driving).modulus_margin).reshape(len(found.speeds), -1)
        low, high = margin.min(axis=1), margin.max(axis=1)
        marks += [
            Ribbon(found.speeds, low, high, stroke.colour),
            Polyline(found.speeds, low, stroke, markers=len(found.speeds) < 12),
        ]
    panel = Panel(
        "Modulus margin over the speed", Axis("Speed (m/s)"), Axis("Modulus margin (–)"),
        [*marks, Guide("y", [0.0], NEUTRAL, 0.9)], f"Driving straight at least {number(least)}.",
    )  # fmt: skip
    caption = (
        "Smallest distance of the loop gain from −1; unstable below 0. Line: the least of all frictions and other "
        "scheduling variables; band: up to the largest."
    )
    return Picture("modulus", caption, [panel], [(_NAMES[driving], stroke) for driving, stroke in _STROKES.items()])


def _margin_maps(found: Certificate, name: str, title: str, margins: Margins) -> Picture:
    """The maps of one way of driving; a cross marks a cell with an unstable point."""
    bad = np.asarray(found.cells(margins.radius >= 1.0).max(axis=2))
    drawn = [
        (_RADIUS, found.cells(margins.radius).max(axis=2)),
        (_MODULUS, found.cells(margins.modulus_margin).min(axis=2)),
        (_UP, found.cells(margins.gain_up).min(axis=2)),
        (_DOWN, found.cells(margins.gain_down).max(axis=2)),
        (_DELAY, 1000.0 * found.cells(margins.delay).min(axis=2)),
    ]
    panels = [_map(found, _around(scale, values), values, bad) for scale, values in drawn]
    crosses = " A cross marks a cell with an unstable point." if bad.any() else ""
    caption = (
        f"{title}. The worst over all other scheduling variables; dark is bad, on a scale of each map's own.{crosses}"
    )
    return Picture(name, caption, panels, file=f"{name}.png", columns=3, row_height=2.0)


def _tunings(found: Certificate) -> Picture:
    Np, Nc, Q, R = found.counted.tunings.T
    with np.errstate(divide="ignore"):
        ratio = np.log10(R) - np.log10(Q)
    panels = []
    for symbol, values, whole in (("$N_p$ (periods)", Np, True), ("$N_c$ (periods)", Nc, True),
                                  (r"$\log_{10} R/Q$ (R/Q in m²/rad²)", ratio, False)):  # fmt: skip
        cells = np.median(found.cells(values), axis=2)
        finite = cells[np.isfinite(cells)]
        low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 0.0)
        middle, span = (low + high) / 2.0, max(high - low, 2.0 if whole else 0.2)
        panels.append(_map(found, Scale(middle - span / 2.0, middle + span / 2.0, symbol, whole=whole), cells))
    caption = "The scheduler's tuning: median over all other scheduling variables."
    if found.guarded is not None:
        share = 100.0 * found.cells(found.fallback).mean(axis=2)
        panels.append(_map(found, Scale(0.0, 100.0, "On the fallback (%)"), share))
        caption = f"{caption[:-1]}, the guard's fallback included where it acts; and how often it does."
    return Picture("tunings", caption, panels, file="tunings.png", columns=len(panels) if len(panels) < 4 else 2,
                   row_height=2.0)  # fmt: skip


def _around(scale: Scale, values: Array) -> Scale:
    """Colours that tell these values apart: from their 2nd to their 98th percentile, within the scale's bounds."""
    finite = values[np.isfinite(values)]
    if not finite.size:
        return scale
    low, high = np.clip(np.percentile(finite, (2.0, 98.0)), scale.low, scale.high)
    least = 0.1 * high if scale.log else 0.02 * (scale.high - scale.low)  # equal values have one colour
    if high - low < least:
        low, high = max(scale.low, low - least), min(scale.high, high + least)
    return replace(scale, low=float(low), high=float(high))


def _map(found: Certificate, scale: Scale, values: Array, unstable: NDArray[np.bool_] | None = None) -> Panel:
    """values, unstable: (speeds, frictions)."""
    low, high = float(values.min()), float(values.max())
    slack = 1e-9 * (scale.high - scale.low)
    below, above = low < scale.low - slack, high > scale.high + slack
    beyond = "both" if below and above else "min" if below else "max" if above else "neither"
    cells = HeatMap(
        edges_around(found.speeds), edges_around(found.frictions), np.clip(values, scale.low, scale.high).T,
        replace(scale, label="", beyond=beyond),  # type: ignore[arg-type]
    )  # fmt: skip
    i, j = np.nonzero(np.zeros(values.shape, bool) if unstable is None else unstable)
    crosses = Dots(found.speeds[i], found.frictions[j], SERIES[1], "cross", 4.5, scales=False)
    return Panel(
        scale.label, Axis("Speed (m/s)"), Axis("Friction (–)"), [cells, crosses],
        f"{number(low)} to {number(high)}.",
    )  # fmt: skip

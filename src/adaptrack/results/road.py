"""Result of a road check: summary, places that the car cannot drive, and pictures of the road."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from adaptrack.base.result import Column, Panel, Picture, Result, ResultTable, Row
from adaptrack.core.maths import portable
from adaptrack.results import marks
from adaptrack.results.words import data_text, length
from adaptrack.road import Finding, Road, SpeedPlan

LINE_POINTS = 4000
"""Points of the drawn line."""

SUMMARY_COLUMNS = (Column("what", "quantity"), Column("value", "value"), Column("unit", "unit"))
SUMMARY_TITLES = {
    "length": ("length", "m"), "closed": ("closed lap", ""), "smallest_radius": ("smallest radius", "m"),
    "curvature_jumps": ("jumps of the curvature", ""), "largest_grade": ("largest grade (uphill)", ""),
    "least_grade": ("smallest grade (downhill)", ""), "deviation": ("largest distance from the points", "m"),
    "slowest": ("lowest planned speed", "m/s"), "fastest": ("highest planned speed", "m/s"),
    "duration": ("planned duration", "s"),
}  # fmt: skip
"""Title and unit of the entries of the summary."""
LIMIT_COLUMNS = (
    Column("limit", "limit"), Column("share", "share of road", "%"), Column("from", "longest part from", "m"),
    Column("to", "to", "m"),
)  # fmt: skip
PLACE_COLUMNS = (Column("from", "from", "m"), Column("to", "to", "m"), Column("what", "finding"))


def road_result(road: Road, plan: SpeedPlan, findings: Sequence[Finding] = ()) -> Result:
    """Return a road, its planned speed and the parts that cannot be driven as a result."""
    barred = [finding for finding in findings if not finding.drivable]
    summary = _summary(road, plan)
    quantities = [{"what": title, "value": summary[key], "unit": unit} for key, (title, unit) in SUMMARY_TITLES.items()]
    places: dict[bool, list[Row]] = {False: [], True: []}
    for finding in findings:
        places[finding.drivable].append({"from": finding.start, "to": finding.end, "what": finding.text})
    tables = [
        ResultTable("summary", road.name, SUMMARY_COLUMNS, quantities, brief=True),
        ResultTable("limits", "Limits of the planned speed", LIMIT_COLUMNS, _longest(plan), brief=True),
        ResultTable("barred", "Places that the car cannot drive", PLACE_COLUMNS, places[False], brief=True),
        ResultTable("notes", "Notes", PLACE_COLUMNS, places[True], brief=True),
    ]
    return Result(
        kind="road",
        title=road.name,
        answer=_answer(summary, len(barred)),
        record={
            **summary, "drivable": not barred, "notes": list(road.notes), "limits": limits_record(plan),
            "rows": [asdict(finding) for finding in findings],
        },
        tables=tables,
        notes=road.notes,
        pictures=[road_picture(road, plan, findings)],
        failed=bool(barred),
    )  # fmt: skip


def _answer(summary: Mapping[str, Any], barred: int) -> str:
    """Drivability, length, bends and speeds of a road; barred: number of places that cannot be driven."""
    radius = summary["smallest_radius"]
    bends = "straight" if radius is None else f"tightest radius {length(radius)}"
    speeds = " to ".join(dict.fromkeys(f"{summary[end]:.3g}" for end in ("slowest", "fastest"))) + " m/s"
    slopes = [100.0 * summary[name] for name in ("least_grade", "largest_grade")]
    grades = f", grades {slopes[0]:.2g} to {slopes[1]:.2g} %" if any(slopes) else ""
    description = f"{length(summary['length'])}, {bends}{grades}, {speeds}, {summary['duration']:.0f} s"
    if barred:
        return f"The road cannot be driven at {barred} {'place' if barred == 1 else 'places'} ({description})."
    return f"The road can be driven: {description}."


def limits_record(plan: SpeedPlan) -> dict[str, Any]:
    """Return the shares and stretches of the bounds of a planned speed, from start to end; for JSON."""
    return {
        "shares": {limit.value: share for limit, share in plan.shares.items()},
        "stretches": [
            {"limit": stretch.limit.value, "start": stretch.start, "end": stretch.end} for stretch in plan.stretches
        ],
    }


def _longest(plan: SpeedPlan) -> list[dict[str, Any]]:
    """A row for each limit of the speed, with its share and its longest stretch."""
    rows = []
    for limit, share in plan.shares.items():
        stretches = [stretch for stretch in plan.stretches if stretch.limit == limit]
        longest = max(stretches, key=lambda stretch: stretch.end - stretch.start)
        rows.append({"limit": limit.value, "share": round(100.0 * share, 1), "from": longest.start, "to": longest.end})
    return rows


def limits_in_words(plan: SpeedPlan) -> str:
    """The limits of the speed with their shares of the road; empty if the speed was not planned."""
    limits = ", ".join(f"{limit} {100 * share:.0f} %" for limit, share in plan.shares.items() if share >= 0.005)
    return f"Speed limited by: {limits} of the road." if limits else ""


def _summary(road: Road, plan: SpeedPlan) -> dict[str, Any]:
    bends = np.abs(road.at(plan.s).curvature).max()
    grades = road.along("grade", plan.s)
    return {
        "road": road.name,
        "length": road.length,
        "closed": road.closed,
        "smallest_radius": 1.0 / float(bends) if bends > 0.0 else None,
        "curvature_jumps": len(road.curvature_jumps()),
        "largest_grade": float(grades.max()),
        "least_grade": float(grades.min()),
        "deviation": road.deviation,
        "slowest": float(plan.speed.min()),
        "fastest": float(plan.speed.max()),
        "duration": plan.duration,
    }


def road_picture(road: Road, plan: SpeedPlan, findings: Sequence[Finding] = ()) -> Picture:
    """From above, coloured by the speed, with curvature and speed along it; places that cannot be driven are marked."""
    s = np.linspace(0.0, road.length, LINE_POINTS)
    barred = [finding for finding in findings if not finding.drivable]

    def draw_along(axes: marks.Axes, values: Any, label: str) -> None:
        axes.plot(s, values, color=marks.SERIES[0])
        for finding in barred:
            end = max(finding.end, finding.start + 0.003 * road.length)
            axes.axvspan(finding.start, end, color=marks.SERIES[1], alpha=0.3, linewidth=0.0)
        axes.set(xlabel="Distance along the road (m)", xlim=(0.0, road.length), ylabel=label)

    def draw_speed(axes: marks.Axes) -> None:
        draw_along(axes, plan.at(s), "Speed (m/s)")
        if road.speed_limit is not None:
            axes.plot(s, road.along("speed_limit", s), color=marks.MUTED, linestyle=marks.DASHED)
        axes.set_ylim(bottom=0.0)

    lap = "lap of " if road.closed else ""
    title = data_text(f"{road.name}: {lap}{road.length:.0f} m, {plan.duration:.0f} s")
    curvature, grade = road.at(s).curvature, 100.0 * road.along("grade", s)
    panels = [
        Panel(title, lambda axes: _draw_from_above(axes, road, plan, s, barred), "Map of the road.", height=4.0),
        Panel("Curvature", lambda axes: draw_along(axes, curvature, "Curvature (1/m)"), "Curvature along the road."),
        Panel("Speed", draw_speed, "Planned speed along the road."),
    ]
    if grade.any():
        words = "Grade along the road, positive uphill."
        panels.append(Panel("Grade", lambda axes: draw_along(axes, grade, "Grade (%)"), words))
    caption = "Map of the road, coloured by the planned speed; curvature and speed along the road."
    return Picture("road", caption, panels, file="road.png", columns=1, row_height=1.25)


def _draw_from_above(axes: marks.Axes, road: Road, plan: SpeedPlan, s: np.ndarray, barred: Sequence[Finding]) -> None:
    points, speed = road.at(s), plan.at(s)
    for edge in road.edges(s):
        axes.plot(*edge.T, **marks.BACKGROUND_STROKE, linewidth=0.5)
    slowest, fastest = float(speed.min()), float(speed.max())
    scale = marks.ColourScale(slowest, max(fastest, slowest + 0.1), "Speed (m/s)")
    marks.draw_coloured_line(axes, points.x, points.y, speed[:-1], scale)
    places = [road.at(0.5 * (finding.start + finding.end)) for finding in barred]
    x, y = [float(place.x) for place in places], [float(place.y) for place in places]
    axes.plot(x, y, "x", color=marks.SERIES[1], markersize=8.0, markeredgewidth=1.5, zorder=5)
    arrow = 0.03 * portable.hypot(float(np.ptp(points.x)), float(np.ptp(points.y)))
    start = road.at(0.0)
    tail, heading = (float(start.x), float(start.y)), float(start.heading)
    tip = tail[0] + arrow * portable.cos(heading), tail[1] + arrow * portable.sin(heading)
    axes.annotate("", tip, tail, arrowprops={"arrowstyle": "-|>", "color": marks.INK, "linewidth": 1.5})
    axes.set(xlabel="x (m)", ylabel="y (m)")
    axes.set_aspect("equal", adjustable="datalim")

"""The picture of a road: from above, coloured by the speed, and curvature and speed along it."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from adaptrack.results import style
from adaptrack.results.maps import COLOURS
from adaptrack.road import Finding, Road, SpeedPlan

SAMPLES = 4000
"""Points of the drawn line."""


def road_figure(road: Road, plan: SpeedPlan, findings: Sequence[Finding] = ()) -> Figure:
    """A figure of a road; places that cannot be driven are marked."""
    s = np.linspace(0.0, road.length, SAMPLES)
    with style.styled():
        figure = Figure(figsize=(style.PAGE_WIDTH, 7.4))
        above, bend, pace = figure.subplots(3, 1, height_ratios=[4.0, 1.0, 1.0])
        _from_above(above, road, plan, s, findings)
        above.set_title(style.data_text(_title(road, plan)))
        bend.plot(s, road.at(s).curvature, color=style.SERIES[0])
        bend.set_ylabel("Curvature (1/m)")
        pace.plot(s, plan.at(s), color=style.SERIES[0])
        if road.speed_limit is not None:
            pace.plot(s, road.along("speed_limit", s), color=style.MUTED, linestyle=style.REFERENCE.dash)
        pace.set_ylim(bottom=0.0)
        pace.set_ylabel("Speed (m/s)")
        pace.set_xlabel("Along the road (m)")
        for axes in (bend, pace):
            axes.set_xlim(0.0, road.length)
            for each in findings:
                if not each.drivable:
                    axes.axvspan(
                        each.start, max(each.end, each.start + 0.003 * road.length), color=style.SERIES[1], alpha=0.3
                    )
    return figure


def _title(road: Road, plan: SpeedPlan) -> str:
    lap = "lap of " if road.closed else ""
    return f"{road.name}: {lap}{road.length:.0f} m, {plan.duration:.0f} s"


def _from_above(axes: Axes, road: Road, plan: SpeedPlan, s: np.ndarray, findings: Sequence[Finding]) -> None:
    left, right = road.edges(s)
    for edge in (left, right):
        axes.plot(edge[:, 0], edge[:, 1], color=style.MUTED, linewidth=0.5)
    points = road.at(s)
    line = np.stack([points.x, points.y], axis=-1)
    speed = plan.at(s)
    spread = Normalize(float(speed.min()), max(float(speed.max()), float(speed.min()) + 0.1))
    strokes = LineCollection(list(np.stack([line[:-1], line[1:]], axis=1)), cmap=COLOURS, norm=spread, linewidths=2.0)
    strokes.set_array(speed[:-1])
    axes.add_collection(strokes)
    axes.figure.colorbar(strokes, ax=axes, label="Speed (m/s)", shrink=0.7)
    marks = [road.at(0.5 * (each.start + each.end)) for each in findings if not each.drivable]
    axes.plot([float(m.x) for m in marks], [float(m.y) for m in marks], "x", color=style.SERIES[1], markersize=8)
    ahead = 0.03 * math.hypot(*np.ptp(line, axis=0))
    start = road.at(0.0)
    axes.annotate(
        "", (float(start.x + ahead * np.cos(start.heading)), float(start.y + ahead * np.sin(start.heading))),
        (float(start.x), float(start.y)), arrowprops={"arrowstyle": "-|>", "color": style.INK, "linewidth": 1.5},
    )  # fmt: skip
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.05)
    axes.set_xlabel("x (m)")
    axes.set_ylabel("y (m)")


def road_png(road: Road, plan: SpeedPlan, findings: Sequence[Finding] = ()) -> bytes:
    """The figure as a PNG file."""
    return style.png(road_figure(road, plan, findings))

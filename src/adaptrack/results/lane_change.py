"""The picture of a lane change through cones: what the corners of the car swept at the highest clean speed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from adaptrack.comparison.manoeuvres import EntrySpeed
from adaptrack.results import style
from adaptrack.results.words import legible

BEFORE, BEHIND = 12.0, 14.0
"""m, of road shown before the first and behind the last cones."""
BETWEEN = 6.0
"""m, between the outlines that are drawn."""


def lane_change_figure(runs: Sequence[EntrySpeed]) -> Figure:
    """A panel for each controller on one track: cones, lanes, the corners of all seeds, the outline now and then.

    The speed shown is the highest up to which all drives are clean; where none is clean, the lowest of the grid.
    """
    with style.styled():
        figure, panels = style.grid_figure(len(runs), 1, 1.35)
        for axes, run in zip(panels, runs, strict=True):
            _panel(axes, run)
        panels[-1].set_xlabel("x (m)")
    return figure


def lane_change_png(runs: Sequence[EntrySpeed]) -> bytes:
    """The figure as a PNG file."""
    return style.png(lane_change_figure(runs))


def _panel(axes: Axes, run: EntrySpeed) -> None:
    track, outline = run.test.track, run.test.car.outline
    for gate in track.gates:
        for side in (gate.right, gate.left):
            axes.plot([gate.start, gate.end], [side, side], color=style.MUTED, linewidth=0.7)
    axes.plot(*track.cones.T, "^", color=style.SERIES[1], markersize=4, zorder=3)
    for poses in run.poses:
        corners = outline.corners_at(*poses.T)
        for number, colour, width in ((2, 2, 1.6), (3, 2, 1.6), (0, 0, 0.7), (1, 0, 0.7)):  # rear, then front
            axes.plot(*corners[:, number].T, color=style.SERIES[colour], linewidth=width)
    first = run.poses[0]
    known = first[np.isfinite(first).all(axis=1)]
    for x in np.arange(track.gates[0].start - BEFORE, track.gates[-1].end + BEHIND, BETWEEN):
        place = known[int(np.argmin(np.abs(known[:, 0] - x)))]
        front_left, front_right, rear_left, rear_right = outline.corners_at(*place)
        body = np.array([front_left, front_right, rear_right, rear_left])
        axes.add_patch(Polygon(body, closed=True, fill=False, edgecolor=style.INK, linewidth=0.4, alpha=0.5))
    axes.set_xlim(track.gates[0].start - BEFORE, track.gates[-1].end + BEHIND)
    low, high = min(gate.right for gate in track.gates), max(gate.left for gate in track.gates)
    axes.set_ylim(low - 0.8, high + 0.8)
    axes.set_ylabel("y (m)")
    axes.set_title(legible(style.data_text(_title(run))))


def _title(run: EntrySpeed) -> str:
    who = f"{run.test.car.name}, {run.name}{', tuned' if run.tuned else ''}"
    row = run.row
    if row["clean"] is None:
        return f"{who}: not clean at {3.6 * min(run.found.tried):.0f} km/h"
    return f"{who}: clean up to {row['clean']:.0f} km/h"

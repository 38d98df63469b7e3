"""The picture of a lane change through cones: what the corners of the car swept at the highest clean speed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from adaptrack.base.result import BACKGROUND, SERIES, Axis, Dots, Mark, Panel, Picture, Polygon, Polyline, Stroke
from adaptrack.comparison.entry_speed import EntrySpeed
from adaptrack.results.words import data_text

BEFORE, BEHIND = 12.0, 14.0
"""m, of road shown before the first and behind the last cones."""
BETWEEN = 6.0
"""m, between the outlines that are drawn."""
_CORNERS = ((2, SERIES[2], 1.6), (3, SERIES[2], 1.6), (0, SERIES[0], 0.7), (1, SERIES[0], 0.7))
"""Of the outline, with colour and width [pt]: the rear ones, then the front ones over them."""


def lane_change_picture(runs: Sequence[EntrySpeed]) -> Picture:
    """A panel for each controller on one track: cones, lanes, the corners of all seeds, the outline now and then.

    The speed shown is the highest up to which all drives are clean; where none is clean, the lowest of the grid.
    """
    caption = "Cones, lanes, and what the corners of the car swept."
    return Picture("lane_change", caption, list(map(_panel, runs)), columns=1, row_height=1.35)


def _panel(run: EntrySpeed) -> Panel:
    gates = run.test.track.gates
    start, end = gates[0].start - BEFORE, gates[-1].end + BEHIND
    low, high = min(gate.right for gate in gates), max(gate.left for gate in gates)
    title = _title(run)
    return Panel(
        data_text(title), Axis("x (m)", start, end), Axis("y (m)", low - 0.8, high + 0.8), _marks(run, start, end),
        f"What the corners of the car swept: {title}.",
    )  # fmt: skip


def _marks(run: EntrySpeed, start: float, end: float) -> list[Mark]:
    track, outline = run.test.track, run.test.car.outline
    marks: list[Mark] = [
        Polyline([gate.start, gate.end], [side, side], BACKGROUND, 0.7)
        for gate in track.gates for side in (gate.right, gate.left)
    ]  # fmt: skip
    marks.append(Dots(track.cones[:, 0], track.cones[:, 1], SERIES[1], "triangle", 4.0))
    for poses in run.poses:
        corners = outline.corners_at(*poses.T)
        marks += [
            Polyline(corners[:, corner, 0], corners[:, corner, 1], Stroke(colour), width)
            for corner, colour, width in _CORNERS
        ]
    first = run.poses[0]
    known = first[np.isfinite(first).all(axis=1)]
    for x in np.arange(start, end, BETWEEN):
        place = known[int(np.argmin(np.abs(known[:, 0] - x)))]
        front_left, front_right, rear_left, rear_right = outline.corners_at(*place)
        corners = np.array([front_left, front_right, rear_right, rear_left])
        marks.append(Polygon(corners[:, 0], corners[:, 1], "ink", width=0.4, opacity=0.5))
    return marks


def _title(run: EntrySpeed) -> str:
    label = f"{run.test.car.name}, {run.name}{', tuned' if run.tuned else ''}"
    row = run.row
    if row["clean"] is None:
        return f"{label}: not clean at {3.6 * min(run.found.tried):.0f} km/h"
    return f"{label}: clean up to {row['clean']:.0f} km/h"

"""The result of lane changes through cones: entry speeds, and pictures of the highest clean ones."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from adaptrack.base.files import safe_names
from adaptrack.base.result import Column, Panel, Picture, Result, ResultTable
from adaptrack.comparison.entry_speed import LANE_CHANGES, EntrySpeed
from adaptrack.results.marks import BACKGROUND_STROKE, INK, SERIES
from adaptrack.results.words import data_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes

TITLES = {
    "iso3888-1": "Double lane change, after ISO 3888-1",
    "iso3888-2": "Obstacle avoidance, after ISO 3888-2",
}
LANE_CHANGE_COLUMNS = (
    Column("vehicle", "Car"),
    Column("profile", "Profile"),
    Column("controller", "Controller"),
    Column("clean", "Clean up to", "km/h", "whole"),
    Column("highest_clean", "Highest clean", "km/h", "whole"),
    Column("tuned_clean", "Tuned: clean up to", "km/h", "whole"),
    Column("tuned_highest_clean", "Tuned: highest clean", "km/h", "whole"),
)
_NOTE = (
    "A run is clean if the car touches no cone with any of three noise seeds. Clean up to: all tested entry speeds "
    "up to this one are clean. Highest clean: fastest clean entry speed. Tuned: best tuning of a small search at one "
    "speed, with different seeds. Friction 0.9."
)

CAPTION = "Cones, lanes, and what the corners of the car swept."
ROAD_BEFORE, ROAD_BEHIND = 12.0, 14.0
"""m, of road shown before the first and behind the last cones."""
OUTLINE_DISTANCE = 6.0
"""m, between the outlines that are drawn."""
_CORNERS = ((2, SERIES[2], 1.6), (3, SERIES[2], 1.6), (0, SERIES[0], 0.7), (1, SERIES[0], 0.7))
"""Corners of the outline with colour and width (pt): the rear ones, then the front ones over them."""


def lane_change_result(name: str, runs: Sequence[EntrySpeed]) -> Result:
    """Entry speeds of a lane change of `LANE_CHANGES`, and a picture for each car and profile."""
    rows = [run.row for run in runs]
    fastest = max(rows, key=lambda row: row["clean"] or 0.0)
    tests = {id(run.test): [other for other in runs if other.test is run.test] for run in runs}
    files = safe_names(f"{tests[key][0].test.car.name}-{tests[key][0].test.profile.name}" for key in tests)
    tuned_at = LANE_CHANGES[name].tuned_at if any(run.tuned for run in runs) else None
    return Result(
        kind="lane-change",
        title=TITLES[name],
        answer=f"Highest clean entry speed: {fastest['clean'] or 0.0:.0f} km/h, {fastest['controller']} with "
        f"{fastest['vehicle']}.",
        record={"lane_change": name, "tuned_at": tuned_at, "rows": rows},
        tables=[_table(rows)],
        pictures=[
            Picture(file, CAPTION, list(map(_panel, _fastest_runs(group))), (), f"{file}.png", 1, row_height=1.35)
            for file, group in zip(files, tests.values(), strict=True)
        ],
    )


def _table(rows: Sequence[dict[str, Any]]) -> ResultTable:
    """A row for each car, profile and controller, with default and tuned speeds."""
    speeds = ("clean", "highest_clean")
    lines: dict[tuple[str, ...], dict[str, Any]] = {}
    for row in rows:
        names = {key: row[key] for key in ("vehicle", "profile", "controller")}
        line = lines.setdefault(tuple(names.values()), names | {f"tuned_{key}": None for key in speeds})
        line |= {f"tuned_{key}" if row["tuned"] else key: row[key] for key in speeds}
    table, best = list(lines.values()), set()
    for i, line in enumerate(table):
        rivals = [
            other for other in table if (other["vehicle"], other["profile"]) == (line["vehicle"], line["profile"])
        ]
        fastest = max(other[key] or 0.0 for other in rivals for key in ("clean", "tuned_clean"))
        best |= {(i, key) for key in ("clean", "tuned_clean") if line[key] == fastest}
    columns = LANE_CHANGE_COLUMNS if any(row["tuned"] for row in rows) else LANE_CHANGE_COLUMNS[:5]
    return ResultTable("speeds", "Entry speeds", columns, table, _NOTE, best=frozenset(best), brief=True)


def _fastest_runs(runs: Sequence[EntrySpeed]) -> list[EntrySpeed]:
    """The faster run of each controller: with its default tuning, or tuned."""
    fastest: dict[str, EntrySpeed] = {}
    for run in runs:
        other = fastest.get(run.name)
        if other is None or not np.isfinite(other.scan.speed) or run.scan.speed > other.scan.speed:
            fastest[run.name] = run
    return list(fastest.values())


def _panel(run: EntrySpeed) -> Panel:
    """A controller on a track: cones, lanes, paths of the corners for all seeds, some outlines.

    The speed shown is the highest up to which all drives are clean; where none is clean, the lowest of the grid.
    """
    clean, lowest = run.row["clean"], 3.6 * min(run.scan.clearances)
    speed = f"not clean at {lowest:.0f} km/h" if clean is None else f"clean up to {clean:.0f} km/h"
    title = f"{run.test.car.name}, {run.name}{', tuned' if run.tuned else ''}: {speed}"
    return Panel(data_text(title), partial(_draw_run, run=run), f"What the corners of the car swept: {title}.")


def _draw_run(axes: Axes, run: EntrySpeed) -> None:
    track, outline = run.test.track, run.test.car.outline
    start, end = track.gates[0].start - ROAD_BEFORE, track.gates[-1].end + ROAD_BEHIND
    for gate in track.gates:
        for side in (gate.right, gate.left):
            axes.plot([gate.start, gate.end], [side, side], **BACKGROUND_STROKE, linewidth=0.7)
    axes.plot(track.cones[:, 0], track.cones[:, 1], "^", color=SERIES[1], markersize=4.0, zorder=5)
    for poses in run.poses:
        corners = outline.corners_at(*poses.T)
        for corner, colour, width in _CORNERS:
            axes.plot(corners[:, corner, 0], corners[:, corner, 1], color=colour, linewidth=width)
    first = run.poses[0]
    finite = first[np.isfinite(first).all(axis=1)]
    for x in np.arange(start, end, OUTLINE_DISTANCE):
        pose = finite[int(np.argmin(np.abs(finite[:, 0] - x)))]
        corners = outline.corners_at(*pose)[[0, 1, 3, 2]]
        axes.fill(*corners.T, edgecolor=INK, facecolor="none", linewidth=0.4, alpha=0.5, zorder=1)
    low, high = min(gate.right for gate in track.gates), max(gate.left for gate in track.gates)
    axes.set(xlabel="x (m)", xlim=(start, end), ylabel="y (m)", ylim=(low - 0.8, high + 0.8))

"""Pictures of drives along a road: the road from above with the driven line, and what happened along it."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure
from numpy.typing import NDArray

from adaptrack.base.errors import InvalidInput
from adaptrack.results import style
from adaptrack.results.page import Panel, printed
from adaptrack.results.record import Array, DriveRecord
from adaptrack.results.words import controller_name, span
from adaptrack.road import Road

Drives = Mapping[str, DriveRecord]
"""Label -> drive, in the order of the legend."""

MOST = 2400
"""Instants of a curve: more are thinned to the smallest and the largest of each of half as many parts."""

PIECES = 1500
"""Pieces of the coloured line."""

COLOURS = LinearSegmentedColormap.from_list("offset", ["#3b8fd0", "#8f9db0", "#e69f00", "#e2600c", "#c4231c"])
"""Of |e|: blue, amber, red; to be seen on light and on dark ground."""

SAGITTA, LONGEST = 0.01, 20.0
"""m: how far a chord of a drawn edge may lie beside its arc, and how long it is at most."""


def labelled(drives: Sequence[DriveRecord]) -> dict[str, DriveRecord]:
    """The drives under distinct labels: the controllers' names, numbered where they are equal.

    Raises
    ------
    InvalidInput
        When there is no drive, or they are not on one road.
    """
    if not drives:
        raise InvalidInput("a page or picture of drives needs at least one.")
    if any(drive.road is not drives[0].road for drive in drives):
        raise InvalidInput("drives beside each other must be on one road: give each the same Road object.")
    names = [controller_name(drive.controller) for drive in drives]
    return {
        f"{name} no. {names[:i].count(name) + 1}" if names.count(name) > 1 else name: drive
        for i, (name, drive) in enumerate(zip(names, drives, strict=True))
    }


def scale_of(drives: Sequence[DriveRecord]) -> float:
    """m, the |e| at the end of the colours: a round number above 95 % of each drive's, 0.05 m or more."""
    high = max(0.05, *(drive.p95_offset for drive in drives))
    decade = 10.0 ** math.floor(math.log10(high))
    return next(step * decade for step in (1.0, 2.0, 5.0, 10.0) if step * decade >= high * (1.0 - 1e-9))


def outline_stations(road: Road, start: float, end: float) -> Array:
    """Arc lengths (m) from `start` to `end` at which the road's edges are drawn: closer together in bends.

    Chords of an arc of curvature kappa that lie within `SAGITTA` of it are sqrt(8 SAGITTA/kappa) long.
    """
    s = np.linspace(start, end, max(3, math.ceil(end - start) + 1))
    density = np.maximum(np.sqrt(np.abs(road.at(s).curvature) / (8.0 * SAGITTA)), 1.0 / LONGEST)
    count = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]) * np.diff(s))])
    evenly = np.interp(np.linspace(0.0, count[-1], max(3, math.ceil(count[-1]) + 1)), count, s)
    changes = np.array([*road.width_left.s, *road.width_right.s])
    return np.union1d(evenly, changes[(changes > start) & (changes < end)])


def road_span(drives: Sequence[DriveRecord]) -> tuple[float, float]:
    """m, m: the part of the road to draw; of an open one also what was driven beyond its ends."""
    road = drives[0].road
    if road.closed:
        return 0.0, road.length
    low, high = (float(pick([pick(drive.station) for drive in drives])) for pick in (np.min, np.max))
    return min(0.0, low), max(road.length, high)


def above_figure(drives: Sequence[DriveRecord], width: float = style.PAGE_WIDTH, tallest: float = 5.0) -> Figure:
    """The road from above with the driven line coloured by |e|; a panel a drive, two beside each other.

    width, tallest: inch, of the figure, and of a row of panels where the road is not flatter.

    Raises
    ------
    InvalidInput
        When there is no drive, or they are not on one road.
    """
    shown = labelled(drives)
    columns = 1 if len(shown) == 1 else 2
    rows = -(-len(shown) // columns)
    with style.styled():
        figure = style.ShownFigure(figsize=(width, rows * _row_height(drives, width / columns, tallest)))
        panels = list(figure.subplots(rows, columns, squeeze=False).flat)
        for spare in panels[len(shown) :]:
            spare.remove()
        draw_above(drives, panels[: len(shown)])
        for axes, label in zip(panels, shown if len(shown) > 1 else (), strict=False):
            axes.set_title(style.data_text(label))
    return figure


def _row_height(drives: Sequence[DriveRecord], width: float, tallest: float) -> float:
    """inch, of a panel as wide as that (inch) that the road fills, within bounds."""
    road = drives[0].road
    points = road.at(outline_stations(road, *road_span(drives)))
    wide, high = (float(np.ptp(values)) for values in points[:2])
    return min(max(0.75 * width * high / max(wide, 1.0) + 0.8, 0.45 * width), tallest)


def draw_above(drives: Sequence[DriveRecord], panels: Sequence[Axes]) -> None:
    """Draw each drive from above on its axes, and the bar of their colours beside all."""
    norm = Normalize(0.0, scale_of(drives))
    for axes, drive in zip(panels, drives, strict=True):
        strokes = _draw_above(axes, drive, norm, road_span(drives))
    beyond = max(drive.max_offset for drive in drives) > scale_of(drives)
    panels[0].figure.colorbar(
        strokes, ax=list(panels), label="|e| (m)", shrink=0.8, aspect=30, pad=0.02,
        extend="max" if beyond else "neither",
    )  # fmt: skip


def _draw_above(axes: Axes, drive: DriveRecord, norm: Normalize, ends: tuple[float, float]) -> LineCollection:
    road = drive.road
    left, right = road.edges(outline_stations(road, *ends))
    surface = np.concatenate([left, right[::-1]])
    axes.fill(surface[:, 0], surface[:, 1], facecolor=style.GRID, edgecolor="none", zorder=1)
    for edge in (left, right):
        axes.plot(edge[:, 0], edge[:, 1], color=style.MUTED, linewidth=0.6, zorder=2)
    pick = np.unique(np.linspace(0, len(drive) - 1, PIECES + 1).astype(int))
    worst = np.maximum.reduceat(np.abs(drive.offset), pick[:-1])
    line = np.stack([drive.x[pick], drive.y[pick]], axis=-1)
    pieces = list(np.stack([line[:-1], line[1:]], axis=1))
    strokes = LineCollection(pieces, cmap=COLOURS, norm=norm, linewidths=2.0, capstyle="round", zorder=3)
    strokes.set_array(worst)
    axes.add_collection(strokes)
    axes.plot(drive.x[0], drive.y[0], "o", color=style.INK, markersize=4, zorder=4)
    axes.annotate("start", (drive.x[0], drive.y[0]), (5, 5), textcoords="offset points", fontsize=8.0)
    if drive.failed:
        axes.plot(drive.x[-1], drive.y[-1], "x", color=style.INK, markersize=8, markeredgewidth=2.0, zorder=5)
        axes.annotate("failed", (drive.x[-1], drive.y[-1]), (6, -10), textcoords="offset points", fontsize=8.0)
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.06)
    axes.set_xlabel("x (m)")
    axes.set_ylabel("y (m)")
    return strokes


def along_panels(drives: Drives) -> list[Panel]:
    """e, steering, speed and lateral acceleration over the station, each drive in its stroke."""
    strokes = style.strokes(drives)

    def panel(title: str, label: str, name: str, draw: Callable[[Axes], None]) -> Panel:
        ranges = "; ".join(f"{key}: {span(getattr(drive, name))}" for key, drive in drives.items())
        return Panel(title, partial(_draw_along, label, drives, strokes, draw), f"{label}, over the station. {ranges}.")

    def curves(name: str) -> Callable[[Axes], None]:
        return lambda axes: _curves(axes, drives, strokes, name)

    def steered(axes: Axes) -> None:
        if len(drives) == 1:
            _curves(axes, drives, {key: style.BACKGROUND for key in drives}, "command", linewidth=0.8)
        _curves(axes, drives, strokes, "steering")
        style.degrees_at_the_right(axes)

    return [
        panel("Offset", "Offset e (m)", "offset", partial(_offsets, drives=drives, strokes=strokes)),
        panel("Steering", "Wheel angle (rad)", "steering", steered),
        panel("Speed", "Speed (m/s)", "speed", partial(_speeds, drives=drives, strokes=strokes)),
        panel("Lateral acceleration", "Lateral acc. (m/s²)", "lateral_acceleration", curves("lateral_acceleration")),
    ]


def along_figure(drives: Sequence[DriveRecord]) -> Figure:
    """e, steering and speed over the station, one below the other, for print.

    Raises
    ------
    InvalidInput
        When there is no drive, or they are not on one road.
    """
    shown = labelled(drives)
    return printed(along_panels(shown)[:3], 1, 1.7, along_key(shown) if len(shown) > 1 else ())


def along_key(drives: Drives) -> list[tuple[str, style.Stroke]]:
    """The legend of the panels along the road."""
    planned = any(drive.planned_speed is not None for drive in drives.values())
    return [*style.strokes(drives).items(), *([("Planned speed", style.REFERENCE)] if planned else [])]


LEARNED = {
    "delay": ("Lag and dead time", "Delay (s)", "s"), "lag": ("Steering lag", "Lag (s)", "s"),
    "stiffness": ("Stiffness over mass, of the model's", "Factor (–)", ""),
    "bias": ("Steering bias", "Bias (rad)", "rad"), "bank": ("Pull of the bank", "Pull (m/s²)", "m/s²"),
    "friction": ("Friction", "μ (–)", ""),
}  # fmt: skip
"""Learned quantities that are drawn: title, label and unit."""


def learned_panels(drives: Drives) -> list[Panel]:
    """Each learned quantity over time, with one standard deviation to either side and, in simulation, the truth."""
    shown = {key: drive for key, drive in drives.items() if drive.learned}
    strokes = style.strokes(drives)
    return [
        Panel(title, partial(_draw_learned, name, label, shown, strokes),
              "; ".join(f"{key}: {drive.learned[name].mean[-1]:.3g} {unit} in the end" for key, drive in shown.items()))
        for name, (title, label, unit) in LEARNED.items() if shown
    ]  # fmt: skip


def learned_figure(drives: Sequence[DriveRecord]) -> Figure:
    """The learned quantities, two beside each other, for print.

    Raises
    ------
    InvalidInput
        When no controller has learned.
    """
    shown = labelled(drives)
    panels = learned_panels(shown)
    if not panels:
        raise InvalidInput("a picture of what was learned needs a controller that learns: MPC(car, learning=...).")
    return printed(panels, 2, 1.9, learned_key(shown))


def learned_key(drives: Drives) -> list[tuple[str, style.Stroke]]:
    """The legend of the learned quantities."""
    strokes = style.strokes(drives)
    learners = [(key, strokes[key]) for key, drive in drives.items() if drive.learned]
    known = any(each.truth is not None for drive in drives.values() for each in drive.learned.values())
    return [*learners, *([("Truth", style.REFERENCE)] if known else [])]


def _draw_learned(name: str, label: str, drives: Drives, strokes: Mapping[str, style.Stroke], axes: Axes) -> None:
    """One learned quantity."""
    for key, drive in drives.items():
        learnt, stroke = drive.learned[name], strokes[key]
        keep = thinned(learnt.mean)
        time = drive.time[keep]
        axes.fill_between(time, learnt.low[keep], learnt.high[keep], color=stroke.colour, alpha=0.2, linewidth=0.0)
        axes.plot(time, learnt.mean[keep], color=stroke.colour, linestyle=stroke.dash)
        if learnt.truth is not None:
            look: dict[str, Any] = {"color": style.REFERENCE.colour, "linestyle": style.REFERENCE.dash}
            axes.plot(drive.time, learnt.truth, linewidth=1.0, **look)
    axes.set_ylabel(label)
    axes.set_xlabel("Time (s)")


def _draw_along(
    label: str, drives: Drives, strokes: Mapping[str, style.Stroke], draw: Callable[[Axes], None], axes: Axes
) -> None:
    """What all panels along the road have, about what one of them shows."""
    axes.axhline(0.0, color=style.MUTED, linewidth=0.7)
    draw(axes)
    axes.set_ylabel(label)
    axes.set_xlabel("Station s (m)")
    low, high = road_ends(drives)
    axes.set_xlim(low, high + 0.04 * (high - low))  # the last number stays whole
    for key, drive in drives.items():
        if drive.failed:
            axes.axvline(float(drive.station[-1]), color=strokes[key].colour, linewidth=1.0, linestyle=(0, (1.2, 1.6)))


def road_ends(drives: Drives) -> tuple[float, float]:
    """m, m: the stations that were driven, at least 1 m."""
    low = min(float(drive.station.min()) for drive in drives.values())
    return low, max(low + 1.0, max(float(drive.station.max()) for drive in drives.values()))


def _curves(axes: Axes, drives: Drives, strokes: Mapping[str, style.Stroke], name: str, **how: Any) -> None:
    for key, drive in drives.items():
        values = getattr(drive, name)
        keep = thinned(values)
        look = {"color": strokes[key].colour, "linestyle": strokes[key].dash} | how
        axes.plot(drive.station[keep], values[keep], **look)


def _offsets(axes: Axes, drives: Drives, strokes: Mapping[str, style.Stroke]) -> None:
    """The offsets; how a failed drive left the road does not flatten the rest."""
    _curves(axes, drives, strokes, "offset")
    if any(drive.failed for drive in drives.values()):
        high = max(3.0 * d.p95_offset if d.failed else 1.2 * d.max_offset for d in drives.values())
        low, top = axes.get_ylim()
        axes.set_ylim(max(low, -high), min(top, high))


def _speeds(axes: Axes, drives: Drives, strokes: Mapping[str, style.Stroke]) -> None:
    _curves(axes, drives, strokes, "speed")
    planned = [drive for drive in drives.values() if drive.planned_speed is not None]
    for drive in sorted(planned, key=lambda drive: -drive.station[-1])[:1]:
        keep = thinned(drive.planned_speed)  # type: ignore[arg-type]
        look: dict[str, Any] = {"color": style.REFERENCE.colour, "linestyle": style.REFERENCE.dash, "linewidth": 1.0}
        axes.plot(drive.station[keep], drive.planned_speed[keep], **look)  # type: ignore[index]
    axes.set_ylim(bottom=min(0.0, axes.get_ylim()[0]) if any(d.speed.min() < 0.0 for d in drives.values()) else 0.0)


def thinned(values: Array, most: int = MOST) -> NDArray[np.int64]:
    """The indices of a curve to draw: all, or the smallest and the largest of each of `most`/2 parts, and the ends."""
    if values.size <= most:
        return np.arange(values.size)
    edges = np.linspace(0, values.size, most // 2 + 1).astype(int)
    parts = itertools.pairwise(edges)
    extremes = [a + int(pick(values[a:b])) for a, b in parts for pick in (np.argmin, np.argmax)]
    return np.unique([0, *extremes, values.size - 1])

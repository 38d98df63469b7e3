"""Pictures of drives along a road: the road from above with the driven line, and what happened along it."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from adaptrack.base.errors import InvalidInput
from adaptrack.base.result import (
    BACKGROUND,
    REFERENCE,
    Axis,
    ColouredLine,
    Dots,
    Guide,
    Mark,
    Panel,
    Picture,
    Polygon,
    Polyline,
    Remark,
    Ribbon,
    Scale,
    Stroke,
    strokes,
)
from adaptrack.results.record import Array, DriveRecord
from adaptrack.results.words import controller_name, data_text, span
from adaptrack.road import Road

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Drives = Mapping[str, DriveRecord]
"""Label -> drive, in the order of the legend."""

MOST = 2400
"""Instants of a curve: more are thinned to the smallest and the largest of each of half as many parts."""

PIECES = 1500
"""Pieces of the coloured line."""

SAGITTA, LONGEST = 0.01, 20.0
"""m: how far a chord of a drawn edge may lie beside its arc, and how long it is at most."""

ON_PAGE, BESIDE = (5.2, 4.0), (2.7, 4.0)
"""inch, width and largest height of the road from above on the page: alone, and beside others."""
IN_PRINT = (7.2, 5.0)
"""inch, likewise, of the whole figure."""

LEARNED = {
    "delay": ("Lag and dead time", "Delay (s)", "s"), "lag": ("Steering lag", "Lag (s)", "s"),
    "stiffness": ("Stiffness over mass, of the model's", "Factor (–)", ""),
    "bias": ("Steering bias", "Bias (rad)", "rad"), "bank": ("Pull of the bank", "Pull (m/s²)", "m/s²"),
    "friction": ("Friction", "μ (–)", ""),
}  # fmt: skip
"""Learned quantities that are drawn: title, label and unit."""


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


# -- from above -------------------------------------------------------------------------------------------------------
def above_picture(drives: Drives) -> Picture:
    """The road from above with the driven line coloured by |e|; a panel a drive, two beside each other."""
    shown, alone = list(drives.values()), len(drives) == 1
    ends, scale = road_span(shown), Scale(0.0, scale_of(shown), "|e| (m)", colours="deviation")
    if max(drive.max_offset for drive in shown) > scale.high:
        scale = Scale(0.0, scale.high, scale.label, colours="deviation", beyond="max")
    panels = [
        Panel(
            "" if alone else data_text(key), Axis("x (m)"), Axis("y (m)"), _from_above(drive, scale, ends),
            f"The road from above with the driven line. {key}: |e| up to {span(np.array([drive.max_offset]))} m.",
            to_scale=True,
        )
        for key, drive in drives.items()
    ]  # fmt: skip
    failed = " A cross marks where a drive failed." if any(drive.failed for drive in shown) else ""
    caption = (
        "The road from above, the driven line coloured by the offset |e| of the centre of mass from the centre line."
    )
    width, tallest = ON_PAGE if alone else BESIDE
    columns = 1 if alone else 2
    return Picture(
        "above", caption + failed, panels, file="above.png", columns=columns,
        row_height=_row_height(shown, IN_PRINT[0] / columns, IN_PRINT[1]),
        size=(width, _row_height(shown, width, tallest)),
    )  # fmt: skip


def _row_height(drives: Sequence[DriveRecord], width: float, tallest: float) -> float:
    """inch, of a panel as wide as that (inch) that the road fills, within bounds."""
    road = drives[0].road
    points = road.at(outline_stations(road, *road_span(drives)))
    wide, high = (float(np.ptp(values)) for values in points[:2])
    return min(max(0.75 * width * high / max(wide, 1.0) + 0.8, 0.45 * width), tallest)


def _from_above(drive: DriveRecord, scale: Scale, ends: tuple[float, float]) -> list[Mark]:
    left, right = drive.road.edges(outline_stations(drive.road, *ends))
    surface = np.concatenate([left, right[::-1]])
    pick = np.unique(np.linspace(0, len(drive) - 1, PIECES + 1).astype(int))
    worst = np.maximum.reduceat(np.abs(drive.offset), pick[:-1])
    x, y = float(drive.x[0]), float(drive.y[0])
    marks: list[Mark] = [
        Polygon(surface[:, 0], surface[:, 1], ground="grid"),
        *(Polyline(edge[:, 0], edge[:, 1], BACKGROUND, width=0.6) for edge in (left, right)),
        ColouredLine(drive.x[pick], drive.y[pick], worst, scale),
        Dots([x], [y], "ink", size=4.0),
        Remark(x, y, "start"),
    ]
    if drive.failed:
        x, y = float(drive.x[-1]), float(drive.y[-1])
        marks += [Dots([x], [y], "ink", "cross", 8.0), Remark(x, y, "failed", (6.0, -10.0))]
    return marks


# -- along the road ---------------------------------------------------------------------------------------------------
def along_picture(drives: Drives) -> Picture:
    """e, steering, speed and lateral acceleration over the station, each drive in its stroke."""
    alone = len(drives) == 1
    panels = _along_panels(drives)
    caption = "Offset e (left positive), steering, speed and lateral acceleration over the station."
    caption += " Front wheels in blue, command in grey." if alone else " Steering is the angle of the front wheels."
    caption += " Dotted: where a drive failed." if any(drive.failed for drive in drives.values()) else ""
    planned = any(drive.planned_speed is not None for drive in drives.values())
    key = [*strokes(drives).items(), *([("Planned speed", REFERENCE)] if planned else [])]
    return Picture("along", caption, panels, key, file="along.png", columns=1, row_height=1.7, print_panels=panels[:3])


def _along_panels(drives: Drives) -> list[Panel]:
    own = strokes(drives)

    def panel(title: str, label: str, name: str, up: Axis, marks: Sequence[Mark]) -> Panel:
        ranges = "; ".join(f"{key}: {span(getattr(drive, name))}" for key, drive in drives.items())
        every = [Guide("y", [0.0], width=0.7), *marks, *_failed(drives, own)]
        return Panel(title, _station(drives), up, every, f"{label}, over the station. {ranges}.")

    steered = _curves(drives, own, "steering")
    if len(drives) == 1:
        steered = [*_curves(drives, dict.fromkeys(drives, BACKGROUND), "command", 0.8), *steered]
    offset, wheels, speed, lateral = "Offset e (m)", "Wheel angle (rad)", "Speed (m/s)", "Lateral acc. (m/s²)"
    backwards = any(drive.speed.min() < 0.0 for drive in drives.values())
    return [
        panel("Offset", offset, "offset", Axis(offset, most=_most(drives)), _curves(drives, own, "offset")),
        panel("Steering", wheels, "steering", Axis(wheels, degrees=True), steered),
        panel("Speed", speed, "speed", Axis(speed, low=None if backwards else 0.0),
              [*_curves(drives, own, "speed"), *_planned(drives)]),
        panel("Lateral acceleration", lateral, "lateral_acceleration", Axis(lateral),
              _curves(drives, own, "lateral_acceleration")),
    ]  # fmt: skip


def road_ends(drives: Drives) -> tuple[float, float]:
    """m, m: the stations that were driven, at least 1 m."""
    low = min(float(drive.station.min()) for drive in drives.values())
    return low, max(low + 1.0, max(float(drive.station.max()) for drive in drives.values()))


def _station(drives: Drives) -> Axis:
    low, high = road_ends(drives)
    return Axis("Station s (m)", low, high + 0.04 * (high - low))  # the last number stays whole


def _curves(drives: Drives, own: Mapping[str, Stroke], name: str, width: float = 1.3) -> list[Mark]:
    curves: list[Mark] = []
    for key, drive in drives.items():
        values = getattr(drive, name)
        keep = thinned(values)
        curves.append(Polyline(drive.station[keep], values[keep], own[key], width))
    return curves


def _failed(drives: Drives, own: Mapping[str, Stroke]) -> list[Mark]:
    return [
        Guide("x", [float(drive.station[-1])], Stroke(own[key].colour, "dotted"), 1.0)
        for key, drive in drives.items() if drive.failed
    ]  # fmt: skip


def _most(drives: Drives) -> float | None:
    """m, of the axis of offsets: how a failed drive left the road does not flatten the rest."""
    if not any(drive.failed for drive in drives.values()):
        return None
    return max(3.0 * drive.p95_offset if drive.failed else 1.2 * drive.max_offset for drive in drives.values())


def _planned(drives: Drives) -> list[Mark]:
    planned = [(drive, drive.planned_speed) for drive in drives.values() if drive.planned_speed is not None]
    if not planned:
        return []
    farthest, speed = max(planned, key=lambda each: each[0].station[-1])
    keep = thinned(speed)
    return [Polyline(farthest.station[keep], speed[keep], REFERENCE, 1.0)]


# -- what was learned -------------------------------------------------------------------------------------------------
def learned_picture(drives: Drives) -> Picture:
    """Each learned quantity over time, with one standard deviation to either side and, in simulation, the truth."""
    shown, own = {key: drive for key, drive in drives.items() if drive.learned}, strokes(drives)
    panels = [
        Panel(title, Axis("Time (s)"), Axis(label), _learnt(name, shown, own),
              "; ".join(f"{key}: {drive.learned[name].mean[-1]:.3g} {unit} in the end" for key, drive in shown.items()))
        for name, (title, label, unit) in LEARNED.items() if shown
    ]  # fmt: skip
    known = any(each.truth is not None for drive in shown.values() for each in drive.learned.values())
    caption = "What was learned of the car while driving. Band: one standard deviation to either side"
    caption += "; dashed: the simulated truth." if known else "."
    key = [*((name, own[name]) for name in shown), *([("Truth", REFERENCE)] if known else [])]
    return Picture("learned", caption, panels, key, file="learned.png", row_height=1.9)


def _learnt(name: str, drives: Drives, own: Mapping[str, Stroke]) -> list[Mark]:
    """One learned quantity."""
    marks: list[Mark] = []
    for key, drive in drives.items():
        learnt = drive.learned[name]
        keep = thinned(learnt.mean)
        time = drive.time[keep]
        marks += [
            Ribbon(time, learnt.low[keep], learnt.high[keep], own[key].colour),
            Polyline(time, learnt.mean[keep], own[key]),
        ]
        if learnt.truth is not None:
            marks.append(Polyline(drive.time, learnt.truth, REFERENCE, 1.0))
    return marks


# -- figures ----------------------------------------------------------------------------------------------------------
def above_figure(drives: Sequence[DriveRecord]) -> Figure:
    """The road from above with the driven line coloured by |e|; a panel a drive, two beside each other.

    Raises
    ------
    InvalidInput
        When there is no drive, or they are not on one road.
    """
    from adaptrack.results.draw import print_figure

    return print_figure(above_picture(labelled(drives)))


def along_figure(drives: Sequence[DriveRecord]) -> Figure:
    """e, steering and speed over the station, one below the other, for print.

    Raises
    ------
    InvalidInput
        When there is no drive, or they are not on one road.
    """
    from adaptrack.results.draw import print_figure

    return print_figure(along_picture(labelled(drives)))


def learned_figure(drives: Sequence[DriveRecord]) -> Figure:
    """The learned quantities, two beside each other, for print.

    Raises
    ------
    InvalidInput
        When no controller has learned.
    """
    from adaptrack.results.draw import print_figure

    picture = learned_picture(labelled(drives))
    if not picture.panels:
        raise InvalidInput("a picture of what was learned needs a controller that learns: MPC(car, learning=...).")
    return print_figure(picture)


def thinned(values: Array, most: int = MOST) -> NDArray[np.int64]:
    """The indices of a curve to draw: all, or the smallest and the largest of each of `most`/2 parts, and the ends."""
    if values.size <= most:
        return np.arange(values.size)
    edges = np.linspace(0, values.size, most // 2 + 1).astype(int)
    parts = itertools.pairwise(edges)
    extremes = [a + int(pick(values[a:b])) for a, b in parts for pick in (np.argmin, np.argmax)]
    return np.unique([0, *extremes, values.size - 1])

"""A run along its road (pose, offset, steering, speed), the road from above with the driven line, and the replay."""

from __future__ import annotations

import base64
import dataclasses
import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.resources import files
from typing import Any, Self

import numpy as np
from markupsafe import Markup

from adaptrack.base.checked import real
from adaptrack.base.errors import InvalidInput
from adaptrack.base.presentation import printable
from adaptrack.base.result import Panel, Picture
from adaptrack.cars.outline import Outline
from adaptrack.cars.vehicle import Vehicle
from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import Array
from adaptrack.core.simulation.run import TRACE_SIGNALS
from adaptrack.drive.failure import Failed, find_failure
from adaptrack.drive.predicted_paths import PredictedPaths
from adaptrack.drive.trajectory import Trajectory
from adaptrack.results import marks
from adaptrack.results.words import data_text, span
from adaptrack.road import Road
from adaptrack.road.road_ahead import foot_near


@dataclass(frozen=True)
class DrawnCar:
    """A car from above, about its centre of mass.

    Raises
    ------
    InvalidInput
        When a length is not positive.
    """

    outline: Outline
    lf: float
    """m, centre of mass to front axle"""
    lr: float
    """m, centre of mass to rear axle"""
    track_front: float
    """m, between the front wheels"""
    track_rear: float
    """m, between the rear wheels"""

    def __post_init__(self) -> None:
        for name in ("lf", "lr", "track_front", "track_rear"):
            if not 0.0 < real("DrawnCar", name, getattr(self, name)) < math.inf:
                raise InvalidInput(f"DrawnCar: {name} = {getattr(self, name)!r} m: must be positive and finite.")

    @classmethod
    def of(cls, car: Vehicle) -> Self:
        """The body and the axles of a car."""
        return cls(car.outline, car.lf, car.lr, car.track_front, car.track_rear)


DEFAULT_DRAWN_CAR = DrawnCar(Outline(2.15, 2.3, 1.8, ("length", "front_overhang", "width")), 1.3, 1.4, 1.55, 1.55)
"""The car that is drawn if none is specified."""


@dataclass(frozen=True, eq=False)
class DriveRecord:
    """One drive along a road."""

    road: Road
    run: Trajectory
    """The run with its place on the road, up to the first instant that is not finite."""
    shape: DrawnCar
    failure: Failed | None
    predicted: PredictedPaths | None = None
    """The paths that the controller predicted; None if they were not recorded."""

    @classmethod
    def from_trajectory(
        cls,
        run: Trajectory,
        road: Road,
        car: Vehicle | DrawnCar = DEFAULT_DRAWN_CAR,
        predicted: PredictedPaths | None = None,
    ) -> Self:
        """A recorded run along its road.

        Where the run knows its road (`Trajectory.road`) that is taken; otherwise its positions are projected onto the
        road, each from the foot of the one before it. car: what is drawn; predicted: the paths that `simulate` kept:
        the replay draws them. Raises InvalidInput when fewer than two instants are finite.
        """
        placed = on_road(run, road)
        finite = np.isfinite([read(placed) for read, _ in REPLAYED_SIGNALS.values()]).all(axis=0)
        end = int(finite.argmin()) if not finite.all() else len(run)
        if end < 2:
            raise InvalidInput("a drive along a road must have at least two instants with finite numbers.")
        drawn = placed if end == len(run) else placed.between(end=float(run.t[end]))
        shape = car if isinstance(car, DrawnCar) else DrawnCar.of(car)
        return cls(road, drawn, shape, find_failure(placed), predicted or None)

    @property
    def offset(self) -> Array:
        """(n,) m, e: from the centre line to the centre of mass, positive to the left"""
        return self.run.road["offset"]

    @property
    def p95_offset(self) -> float:
        """m, 95th percentile of |e|."""
        return float(np.percentile(np.abs(self.offset), 95.0))

    @property
    def max_offset(self) -> float:
        """m, largest |e|."""
        return float(np.abs(self.offset).max())


REPLAYED_SIGNALS: dict[str, tuple[Callable[[Trajectory], Array], float]] = {
    "time": (lambda run: run.t, 1e-3),
    "station": (lambda run: run.road["station"], 1e-2),
    "x": (lambda run: run.X, 1e-3),
    "y": (lambda run: run.Y, 1e-3),
    "yaw": (lambda run: run.psi, 1e-4),
    "speed": (lambda run: run.vx, 1e-2),
    "offset": (lambda run: run.road["offset"], 1e-3),
    "steering": (lambda run: run.steering, 1e-4),
    "command": (lambda run: run.command, 1e-4),
    "planned_speed": (lambda run: run.road.get("planned_speed", run.v_ref), 1e-2),
}
"""Signals that the replay shows of a run on a road, (n,), in SI units and rad, positive to the left, and the units to
which they are rounded."""


def on_road(run: Trajectory, road: Road) -> Trajectory:
    """A run with its place on a road (`Trajectory.road`): its own, or the projection of its positions."""
    if run.road:
        return run
    feet = np.full((len(run), 4), np.nan)
    near = None
    for i, (x, y) in enumerate(zip(run.X, run.Y, strict=True)):
        if not np.isfinite(x + y):
            break
        foot = road.project(x, y) if near is None else foot_near(road, x, y, near)
        if not np.isfinite(foot.offset):
            break
        feet[i] = foot.s, foot.offset, foot.heading, foot.curvature
        near = float(foot.s)
    feet[:, 2] = np.remainder(run.psi - feet[:, 2] + np.pi, 2.0 * np.pi) - np.pi
    names = (*TRACE_SIGNALS._fields[TRACE_SIGNALS.station :], "curvature")
    return dataclasses.replace(run, road=dict(zip(names, feet.T, strict=True)))


# -- the road from above ----------------------------------------------------------------------------------------------
Drives = Mapping[str, DriveRecord]
"""Label -> drive, in the order of the legend."""

PIECES = 1500
"""Pieces of the coloured line."""

SAGITTA, LONGEST_CHORD = 0.01, 20.0
"""m: largest distance of a drawn edge's chord from its arc, and the longest chord."""

ON_PAGE, IN_COLUMNS, IN_PRINT = (5.2, 4.0), (2.7, 4.0), (7.2, 5.0)
"""inch, width and largest height of the road from above: alone on the page, one of several, and a printed figure."""


def offset_scale(drives: Sequence[DriveRecord]) -> float:
    """The |e| (m) at the end of the colours: a round number above the largest of the drives that did not fail.

    Where all failed, above their 95th percentiles, since a car that left the road may be anywhere; at least 0.05.
    """
    completed = [drive.max_offset for drive in drives if drive.failure is None]
    high = max(0.05, *(completed or [drive.p95_offset for drive in drives]))
    decade = portable.power(10.0, math.floor(portable.log10(high)))
    steps = (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0)
    return next(step * decade for step in steps if step * decade >= high * (1.0 - 1e-9))


def outline_stations(road: Road, start: float, end: float) -> Array:
    """Arc lengths (m) from `start` to `end` at which the road's edges are drawn: closer together in bends.

    Chords of an arc of curvature kappa that lie within `SAGITTA` of it are sqrt(8 SAGITTA/kappa) long.
    """
    s = np.linspace(start, end, max(3, math.ceil(end - start) + 1))
    density = np.maximum(np.sqrt(np.abs(road.at(s).curvature) / (8.0 * SAGITTA)), 1.0 / LONGEST_CHORD)
    count = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]) * np.diff(s))])
    evenly = np.interp(np.linspace(0.0, count[-1], max(3, math.ceil(count[-1]) + 1)), count, s)
    changes = np.array([*road.width_left.s, *road.width_right.s])
    return np.union1d(evenly, changes[(changes > start) & (changes < end)])


def road_span(drives: Sequence[DriveRecord]) -> tuple[float, float]:
    """Start and end (m) of the drawn part of the road, including drives beyond the ends of an open one."""
    road = drives[0].road
    if road.closed:
        return 0.0, road.length
    low, high = (float(pick([pick(drive.run.road["station"]) for drive in drives])) for pick in (np.min, np.max))
    return min(0.0, low), max(road.length, high)


def above_picture(drives: Drives) -> Picture:
    """The road from above with the driven line coloured by |e|; a panel a drive, two in a row.

    Raises InvalidInput when there is no drive, or they are not on one road.
    """
    records, alone = list(drives.values()), len(drives) == 1
    if not records:
        raise InvalidInput("a page or picture of drives needs at least one.")
    if any(drive.road is not records[0].road for drive in records):
        raise InvalidInput("drives on one page must share their road: give all of them the same Road object.")
    ends, high = road_span(records), offset_scale(records)
    beyond = max(drive.max_offset for drive in records) > high
    scale = marks.ColourScale(0.0, high, "|e| (m)", colours="deviation", beyond="max" if beyond else "neither")
    panels = [
        Panel(
            "" if alone else data_text(label), partial(_draw_from_above, drive=drive, scale=scale, ends=ends),
            f"The road from above with the driven line. {label}: |e| up to {span(np.array([drive.max_offset]))} m.",
        )
        for label, drive in drives.items()
    ]  # fmt: skip
    width, tallest = ON_PAGE if alone else IN_COLUMNS
    columns = 1 if alone else 2
    return Picture(
        "above", "", panels, file="above.png", columns=columns,
        row_height=_row_height(records, IN_PRINT[0] / columns, IN_PRINT[1]),
        size=(width, _row_height(records, width, tallest)),
    )  # fmt: skip


def _row_height(drives: Sequence[DriveRecord], width: float, tallest: float) -> float:
    """inch, of a panel of that width (inch) that the road fills, within bounds."""
    road = drives[0].road
    points = road.at(outline_stations(road, *road_span(drives)))
    x_range, y_range = (float(np.ptp(values)) for values in points[:2])
    return min(max(0.75 * width * y_range / max(x_range, 1.0) + 0.8, 0.45 * width), tallest)


def _draw_from_above(axes: marks.Axes, drive: DriveRecord, scale: marks.ColourScale, ends: tuple[float, float]) -> None:
    left, right = drive.road.edges(outline_stations(drive.road, *ends))
    surface = np.concatenate([left, right[::-1]])
    axes.fill(*surface.T, facecolor=marks.PALE, edgecolor="none", linewidth=0.6, zorder=1)
    for edge in (left, right):
        axes.plot(*edge.T, **marks.BACKGROUND_STROKE, linewidth=0.6)
    x, y = drive.run.X, drive.run.Y
    pick = np.unique(np.linspace(0, x.size - 1, PIECES + 1).astype(int))
    worst = np.maximum.reduceat(np.abs(drive.offset), pick[:-1])
    marks.draw_coloured_line(axes, x[pick], y[pick], worst, scale)
    axes.plot(x[0], y[0], "o", color=marks.INK, markersize=4.0, zorder=5)
    axes.annotate("start", (x[0], y[0]), (5.0, 5.0), textcoords="offset points", fontsize=8.0)
    if drive.failure is not None:
        axes.plot(x[-1], y[-1], "x", color=marks.INK, markersize=8.0, markeredgewidth=1.5, zorder=5)
        axes.annotate("failed", (x[-1], y[-1]), (6.0, -10.0), textcoords="offset points", fontsize=8.0)
    axes.set(xlabel="x (m)", ylabel="y (m)")
    axes.set_aspect("equal", adjustable="datalim")


# -- the replay -------------------------------------------------------------------------------------------------------
# A column is rounded to a unit, its first differences are stored in the fewest bytes that hold them, and the bytes
# stand in the page as base64. What draws them is shared with the page on which one drives (`adaptrack/export/page`).

PERIOD = 0.05
"""s, between the samples of a replay, which joins them by straight lines; a record may be denser."""

SPEED_SIGNALS = (
    "governed_speed", "longitudinal_acceleration", "grip_used", "friction_low", "friction_high", "friction",
)  # fmt: skip
"""Columns of a drive with a speed control, with the true friction (m/s, m/s^2, -)."""

SPEED_SIGNAL_UNIT = 1e-3

PREDICTED_UNIT = 1e-2
"""m, to which predicted points are rounded."""

SHADES = 9
"""Colours of the trail, from no deviation to the largest."""

SCRIPTS = ("history.js", "transport.js", "viewer.js", "plots.js")
STYLE = "viewer.css"
"""Files of `adaptrack/export/page` that draw a drive on both pages."""


def replay_values(drives: Drives) -> dict[str, Any]:
    """Return what the template `replay.html.j2` needs for drives on one road: data, script and style. A page holds one.

    Raises InvalidInput when a signal jumps by more than 2^31 of its units, 2,000 km for positions.
    """
    data = replay_data(drives)
    # JSON inside an element: "<" could end it, an escape cannot
    json_text = json.dumps(data, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    page, templates = files("adaptrack.export") / "page", files("adaptrack.results") / "templates"
    scripts = [*(page / name for name in SCRIPTS), templates / "replay.js"]
    script = "\n".join(file.read_text(encoding="utf-8") for file in scripts)
    return {
        **data, "json": Markup(json_text), "script": Markup(script), "style": Markup((page / STYLE).read_text("utf-8")),
        "beyond": max(drive.max_offset for drive in drives.values()) > data["top"],
    }  # fmt: skip


def replay_data(drives: Drives) -> dict[str, Any]:
    """Return the data of the replay: the road's edges, the colour scale, and each car with outline and columns."""
    from matplotlib.colors import to_hex

    records, colours = list(drives.values()), marks.deviation_colours()
    return {
        "road": _road(records[0].road, road_span(records)),
        "top": offset_scale(records),
        "shades": [to_hex(colours(share)) for share in np.linspace(0.0, 1.0, SHADES)],
        "period": round(float(np.median(np.diff(records[0].run.t[sample_indices(records[0])]))), 6),
        "cars": [_car(label, drive) for label, drive in drives.items()],
    }


def pack_column(values: Array, unit: float) -> dict[str, Any]:
    """A column as its first value and the first differences, in whole units, little-endian, in 1, 2 or 4 bytes each.

    Raises InvalidInput when a difference does not fit.
    """
    units = np.rint(values / unit).astype(np.int64)
    steps = np.diff(units, prepend=units[:1])
    size = next((n for n in (1, 2, 4) if np.abs(steps).max() < 2 ** (8 * n - 1)), None)
    if size is None:
        raise InvalidInput(f"replay: a signal jumps by {np.abs(steps).max() * unit:.3g} from one sample to the next.")
    coded = base64.b64encode(steps.astype(f"<i{size}").tobytes()).decode()
    return {"first": int(units[0]), "unit": unit, "size": size, "bytes": coded}


def sample_indices(drive: DriveRecord) -> np.ndarray:
    """The indices of the instants that the replay holds: the first of each `PERIOD`, and the last of all."""
    time = drive.run.t
    due = np.floor((time - time[0]) / PERIOD + 1e-6)
    return np.unique([*np.flatnonzero(np.diff(due, prepend=-1.0) > 0.0), time.size - 1])


def _road(road: Road, ends: tuple[float, float]) -> dict[str, Any]:
    s = outline_stations(road, *ends)
    left, right = road.edges(s)
    points = road.at(s)
    lines = {"x": points.x, "y": points.y, "left_x": left[:, 0], "left_y": left[:, 1]} | {
        "right_x": right[:, 0], "right_y": right[:, 1],
    }  # fmt: skip
    return {"name": road.name, "closed": road.closed} | {name: pack_column(line, 1e-2) for name, line in lines.items()}


def _car(label: str, drive: DriveRecord) -> dict[str, Any]:
    keep, shape = sample_indices(drive), drive.shape
    columns = {name: (read(drive.run), unit) for name, (read, unit) in REPLAYED_SIGNALS.items()}
    columns["yaw"] = np.unwrap(columns["yaw"][0]), columns["yaw"][1]
    columns |= {name: (values, SPEED_SIGNAL_UNIT) for name, values in _speed_signals(drive.run).items()}
    return {
        "name": printable(label),
        "failed": None if drive.failure is None else drive.failure.time,
        "outline": {
            "front": shape.outline.front, "rear": shape.outline.rear, "width": shape.outline.width,
            "lf": shape.lf, "lr": shape.lr, "track_front": shape.track_front, "track_rear": shape.track_rear,
        },
        "columns": {name: pack_column(values[keep], unit) for name, (values, unit) in columns.items()},
        "predicted": None if drive.predicted is None else _predicted(drive.predicted, drive, keep),
    }  # fmt: skip


def _speed_signals(run: Trajectory) -> dict[str, Array]:
    """Those of `SPEED_SIGNALS` that are finite; none without a speed control."""
    if "governed_speed" not in run.diagnostics:
        return {}
    signals = {"friction": run.friction.mean(axis=1), **run.diagnostics}
    columns = {name: np.asarray(signals[name], dtype=float) for name in SPEED_SIGNALS}
    return {name: values for name, values in columns.items() if np.isfinite(values).all()}


def _predicted(paths: PredictedPaths, drive: DriveRecord, keep: np.ndarray) -> dict[str, Any] | None:
    """Predicted paths in the car's axes, from the last sample at or before each, where their numbers change slowly."""
    run = drive.run
    usable = np.isfinite(paths.points).all(axis=(1, 2)) & (paths.time <= run.t[-1] + 1e-9)
    samples = np.searchsorted(run.t[keep], paths.time[usable] + 1e-9, side="right") - 1
    at, rows = np.unique(samples, return_index=True)
    if not at.size or at[0] < 0:
        return None
    instants = keep[at]
    gap = paths.points[usable][rows] - np.stack([run.X[instants], run.Y[instants]], axis=-1)[:, None]
    c, s = portable.cos(run.psi[instants])[:, None], portable.sin(run.psi[instants])[:, None]
    ahead, left = c * gap[..., 0] + s * gap[..., 1], c * gap[..., 1] - s * gap[..., 0]
    points = [
        {"ahead": pack_column(a, PREDICTED_UNIT), "left": pack_column(b, PREDICTED_UNIT)}
        for a, b in zip(ahead.T, left.T, strict=True)
    ]
    every = int(np.median(np.diff(at))) if at.size > 1 else 1
    return {"at": pack_column(at, 1), "every": every, "points": points}

"""The replay of drives: their data, packed for a page, and the part of the page that plays them.

A column is rounded to a unit, its first differences are stored in the fewest bytes that hold them, and the bytes stand
in the page as base64. What draws them is shared with the page on which one drives (`adaptrack/export/page`).
"""

from __future__ import annotations

import base64
import json
from importlib.resources import files
from typing import Any

import numpy as np
from markupsafe import Markup

from adaptrack.base.errors import InvalidInput
from adaptrack.base.presentation import printable
from adaptrack.core.maths import portable
from adaptrack.drive.predicted_paths import PredictedPaths
from adaptrack.drive.trajectory import Trajectory
from adaptrack.results import record
from adaptrack.results.marks import deviation_colours
from adaptrack.road import Road

PERIOD = 0.05
"""s, between the samples of a replay, which joins them by straight lines; a record may be denser."""

REPLAY_UNITS = {
    "time": 1e-3, "station": 1e-2, "x": 1e-3, "y": 1e-3, "yaw": 1e-4, "speed": 1e-2, "offset": 1e-3, "steering": 1e-4,
    "command": 1e-4, "planned_speed": 1e-2,
}  # fmt: skip
"""The units to which the columns of a replay (`record.REPLAYED_SIGNALS`) are rounded (s, m, rad, m/s)."""

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


def replay_values(drives: record.Drives) -> dict[str, Any]:
    """Return what the template `replay.html.j2` needs for drives on one road: data, script and style. A page holds one.

    Raises
    ------
    InvalidInput
        When a signal jumps by more than 2^31 of its units, 2,000 km for positions.
    """
    data = replay_data(drives)
    # JSON inside an element: "<" could end it, an escape cannot
    json_text = json.dumps(data, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    script = "\n".join([*map(_shared, SCRIPTS), _text("adaptrack.results", "templates", "replay.js")])
    return {
        **data, "json": Markup(json_text), "script": Markup(script), "style": Markup(_shared(STYLE)),
        "beyond": max(drive.max_offset for drive in drives.values()) > data["top"],
    }  # fmt: skip


def replay_data(drives: record.Drives) -> dict[str, Any]:
    """Return the data of the replay: the road's edges, the colour scale, and each car with outline and columns."""
    from matplotlib.colors import to_hex

    records, colours = list(drives.values()), deviation_colours()
    return {
        "road": _road(records[0].road, record.road_span(records)),
        "top": record.offset_scale(records),
        "shades": [to_hex(colours(share)) for share in np.linspace(0.0, 1.0, SHADES)],
        "period": round(float(np.median(np.diff(records[0].run.t[sample_indices(records[0])]))), 6),
        "cars": [_car(label, drive) for label, drive in drives.items()],
    }


def pack_column(values: record.Array, unit: float) -> dict[str, Any]:
    """A column as its first value and the first differences, in whole units, little-endian, in 1, 2 or 4 bytes each.

    Raises
    ------
    InvalidInput
        When a difference does not fit.
    """
    units = np.rint(values / unit).astype(np.int64)
    steps = np.diff(units, prepend=units[:1])
    size = next((n for n in (1, 2, 4) if np.abs(steps).max() < 2 ** (8 * n - 1)), None)
    if size is None:
        raise InvalidInput(f"replay: a signal jumps by {np.abs(steps).max() * unit:.3g} from one sample to the next.")
    coded = base64.b64encode(steps.astype(f"<i{size}").tobytes()).decode()
    return {"first": int(units[0]), "unit": unit, "size": size, "bytes": coded}


def sample_indices(drive: record.DriveRecord) -> np.ndarray:
    """The indices of the instants that the replay holds: the first of each `PERIOD`, and the last of all."""
    time = drive.run.t
    due = np.floor((time - time[0]) / PERIOD + 1e-6)
    return np.unique([*np.flatnonzero(np.diff(due, prepend=-1.0) > 0.0), time.size - 1])


def _text(room: str, *path: str) -> str:
    return files(room).joinpath(*path).read_text(encoding="utf-8")


def _shared(name: str) -> str:
    return _text("adaptrack.export", "page", name)


def _road(road: Road, ends: tuple[float, float]) -> dict[str, Any]:
    s = record.outline_stations(road, *ends)
    left, right = road.edges(s)
    points = road.at(s)
    lines = {"x": points.x, "y": points.y, "left_x": left[:, 0], "left_y": left[:, 1]} | {
        "right_x": right[:, 0], "right_y": right[:, 1],
    }  # fmt: skip
    return {"name": road.name, "closed": road.closed} | {name: pack_column(line, 1e-2) for name, line in lines.items()}


def _car(label: str, drive: record.DriveRecord) -> dict[str, Any]:
    keep, shape = sample_indices(drive), drive.shape
    columns = {name: read(drive.run) for name, read in record.REPLAYED_SIGNALS.items()}
    columns |= {"yaw": np.unwrap(columns["yaw"])} | _speed_signals(drive.run)
    return {
        "name": printable(label),
        "failed": None if drive.failure is None else drive.failure.time,
        "outline": {
            "front": shape.outline.front, "rear": shape.outline.rear, "width": shape.outline.width,
            "lf": shape.lf, "lr": shape.lr, "track_front": shape.track_front, "track_rear": shape.track_rear,
        },
        "columns": {
            name: pack_column(values[keep], REPLAY_UNITS.get(name, SPEED_SIGNAL_UNIT))
            for name, values in columns.items()
        },
        "predicted": None if drive.predicted is None else _predicted(drive.predicted, drive, keep),
    }  # fmt: skip


def _speed_signals(run: Trajectory) -> dict[str, record.Array]:
    """Those of `SPEED_SIGNALS` that are finite; none without a speed control."""
    if "governed_speed" not in run.diagnostics:
        return {}
    signals = {"friction": run.friction.mean(axis=1), **run.diagnostics}
    columns = {name: np.asarray(signals[name], dtype=float) for name in SPEED_SIGNALS}
    return {name: values for name, values in columns.items() if np.isfinite(values).all()}


def _predicted(paths: PredictedPaths, drive: record.DriveRecord, keep: np.ndarray) -> dict[str, Any] | None:
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

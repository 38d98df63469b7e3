"""A log at control instants, beside the path that was driven or was to be followed."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from adaptrack.base.errors import AdaptrackError, InvalidInput
from adaptrack.cars.vehicle import Vehicle
from adaptrack.control.recording import LOG_NAMES
from adaptrack.core.maths import portable
from adaptrack.core.models.contract import MEASUREMENT
from adaptrack.core.tracker.records import ACROSS_PENALTY
from adaptrack.drive.trajectory import Trajectory
from adaptrack.identification.log import LEAST_GAP, Log, is_rising, log_of
from adaptrack.identification.reading import Columns, Reading, read_columns
from adaptrack.road import Road, fit_road
from adaptrack.road.road_ahead import foot_near, foot_of_car

Array = NDArray[np.float64]
LogSource = str | os.PathLike[str] | Mapping[str, Any]

MOTION = [name for name in MEASUREMENT._fields[: MEASUREMENT.pose_age] if name not in ("yaw", "y")]
"""Measured signals of the motion of the car."""
ON_GRID = 1e-6
"""Share of a period within which a sample is that of an instant."""
POINTS, LARGEST_STEP = 0.25, 5.0
"""s of driving, and m at most, between the points through which a log's own path is fitted."""


@dataclass(frozen=True, eq=False)
class ReadLog:
    """A log with its columns; before: the command (rad) before the first sample, where it is known."""

    name: str
    columns: Columns
    log: Log
    before: float | None

    @classmethod
    def of(cls, source: LogSource, car: Vehicle, reading: Reading) -> ReadLog:
        run, before = None if isinstance(source, Mapping) else _trajectory(source), None
        columns = read_columns(source, reading if run is None else Reading())
        if run is not None:
            columns.values.update(vy=run.vy, yaw=run.psi, x=run.X, y=run.Y)
            before = float(run.command[0] - run.command_change[0])
        if columns.ratio_unknown:
            raise InvalidInput(f"{columns.source}: angles of the steering wheel: say --steering-ratio R.")
        log = log_of(columns.values, car.wheelbase, columns.notes, columns.commanded)
        return cls(os.path.basename(columns.source), columns, log, before)

    @property
    def period(self) -> float:
        """s, median between samples"""
        return round(self.log.period, 4)

    def has_signal(self, name: str) -> bool:
        """Whether a signal is logged."""
        return bool(np.isfinite(self.columns.values.get(name, np.nan)).any())

    def without(self, names: Sequence[str]) -> ReadLog:
        """Return a copy without signals."""
        blank = np.full(self.log.samples, math.nan)
        remaining = {name: values for name, values in self.columns.values.items() if name not in names}
        gone: dict[str, Any] = {name: blank for name in names if name in ("vy", "acceleration", "wheel", "yaw")}
        return replace(self, columns=replace(self.columns, values=remaining), log=replace(self.log, **gone))

    def segments(self, period: float, path: Road | None) -> Iterator[InstantSamples]:
        """Each piece between gaps and halts at the control instants."""
        log, first = self.log, np.flatnonzero(self.log.begins)
        raw = [self.columns.values.get(name, np.zeros(0)) for name in ("time", "x", "y")]
        for i, j in zip(first, np.append(first[1:], log.samples), strict=True):
            t = log.time[i:j]
            grid = t[0] + period * np.arange(math.floor((t[-1] - t[0]) / period + ON_GRID) + 1)
            speed, yaw = (_sample_at(grid, t, values[i:j], period) for values in (log.speed, log.yaw))
            measured = np.zeros((grid.size, len(MEASUREMENT)))
            measured[:, [MEASUREMENT.yaw, MEASUREMENT.y]] = math.nan
            for name in MOTION:
                values = getattr(log, LOG_NAMES.get(name, name))[i:j]
                measured[:, getattr(MEASUREMENT, name)] = _sample_at(grid, t, values, period)
            command = log.command[i:j][np.searchsorted(t, grid + ON_GRID * period, side="right") - 1]
            before = self.before if i == 0 and self.before is not None else float(command[0])
            samples = InstantSamples(grid, speed, command, before, measured)
            if raw[1].size and raw[2].size:
                x, y = (_sample_at(grid, raw[0], values, period) for values in raw[1:])
                samples = samples.along(_smoothed_path(x, y, speed) if path is None else path, (x, y, yaw))
            yield samples


def _trajectory(source: str | os.PathLike[str]) -> Trajectory | None:
    """The trajectory in a file; None: it is another log."""
    try:
        return Trajectory.load(source)
    except AdaptrackError:
        return None


def _sample_at(grid: Array, time: Array, values: Array, period: float) -> Array:
    """Values at instants: the sample of an instant, else on the line between its neighbours; NaN in holes."""
    usable = is_rising(np.where(np.isfinite(values), time, math.nan))
    t, v = time[usable], values[usable]
    if t.size < 2:
        return np.full(grid.size, math.nan)
    after = np.clip(np.searchsorted(t, grid - ON_GRID * period), 1, t.size - 1)
    resampled = np.interp(grid, t, v, math.nan, math.nan)
    resampled[t[after] - t[after - 1] > max(3.0 * float(np.median(np.diff(t))), LEAST_GAP)] = math.nan
    for near in (after - 1, after):
        there = np.abs(t[near] - grid) <= ON_GRID * period
        resampled[there] = v[near[there]]
    return resampled


def _smoothed_path(x: Array, y: Array, speed: Array) -> Road | None:
    """The path that was driven, smoothed; None where it is too short."""
    points = np.column_stack([x, y])[np.isfinite(x) & np.isfinite(y)]
    way = np.concatenate([[0.0], np.cumsum(portable.hypot(*np.diff(points, axis=0).T))])
    step = min(POINTS * float(np.median(speed)), LARGEST_STEP)
    try:
        return fit_road(points[np.unique(np.searchsorted(way, np.arange(0.0, way[-1], step)))], closed=False)
    except InvalidInput:
        return None


@dataclass(frozen=True, eq=False)
class InstantSamples:
    """n control instants in a row."""

    time: Array
    speed: Array
    command: Array
    """(n,) rad, given at the instant"""
    before: float
    """rad, the command before the first"""
    measured: Array
    """(n, .) by `MEASUREMENT`; yaw and y against the path"""
    path: Road | None = None
    station: Array | None = None
    """(n,) m, of the feet on the path"""

    def along(self, path: Road | None, place: tuple[Array, Array, Array]) -> InstantSamples:
        """Return a copy with the path added; place: x, y (m), yaw (rad), (n,) each."""
        x, y, yaw = place
        begin = int(np.argmax(np.isfinite(x + y)))
        if path is None or not math.isfinite(x[begin] + y[begin]):
            return self
        measured, station, period = self.measured.copy(), np.zeros(x.size), float(self.time[1] - self.time[0])
        course = np.where(np.isfinite(yaw), yaw, portable.atan2(np.gradient(y), np.gradient(x)))
        near = foot_of_car(path, x[begin], y[begin], float(np.nan_to_num(course[begin])), ACROSS_PENALTY)
        for k in range(x.size):
            foot = foot_near(path, x[k], y[k], near)
            if math.isfinite(foot.offset):
                near, measured[k, MEASUREMENT.y] = float(foot.s), float(foot.offset)
                measured[k, MEASUREMENT.yaw] = math.remainder(yaw[k] - float(foot.heading), 2.0 * math.pi)
            station[k], near = near, near + self.speed[k] * period
        heading = path.at(station).heading
        measured[:, MEASUREMENT.turned] = np.diff(heading, prepend=heading[0])
        return replace(self, measured=measured, path=path, station=station)

    def left(self, k: int) -> float:
        """m, of the path ahead at an instant; inf for a lap."""
        if self.path is None or self.station is None or self.path.closed:
            return math.inf
        return self.path.length - float(self.station[k])

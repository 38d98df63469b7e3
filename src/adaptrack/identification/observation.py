"""A log at control instants, and what filter and learner of a controller that steers nothing predict of its car.

From the state and the belief of an instant the car is predicted `TIMES`, with the commands and speeds that followed, by

    learned   the path model (`core.models.path`) with the belief of that instant, its disturbances held
    held      the filtered yaw rate and lateral velocity, held
    first     the same model and filter as the first, with the belief before the first sample
    steady    r = v delta/(L + K v^2) and v_y = (l_r - m l_f v^2/(C_r L)) r of the car's file, delta behind the first
              belief's steering (R. Rajamani, *Vehicle Dynamics and Control*, 2nd ed., section 3.3)
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from adaptrack.base.errors import InvalidInput
from adaptrack.cars.vehicle import Vehicle
from adaptrack.control.controllers import MPC
from adaptrack.control.kalman import KalmanFilter
from adaptrack.control.models import PathModel
from adaptrack.control.recording import LOG_NAMES
from adaptrack.core.estimators import kalman
from adaptrack.core.estimators import learning as kernel
from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import product
from adaptrack.core.models.contract import MEASUREMENT
from adaptrack.core.models.path import PATH_STATES, discretise_disturbed
from adaptrack.core.tracker.records import ACROSS_PENALTY
from adaptrack.drive.prediction import TIMES
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
InstantIndices = NDArray[np.int64]
Predicted = dict[tuple[str, str, float], Array]
"""(predictor, quantity, s ahead) -> (n,), at the instants that it is for; NaN where nothing was predicted"""

PREDICTOR_NAMES = {
    "learned": "learned model", "held": "constant yaw rate", "first": "initial model", "steady": "steady turn",
}  # fmt: skip
PREDICTORS = tuple(PREDICTOR_NAMES)
PREDICTED_QUANTITIES = ("yaw_rate", "y")
PREDICTION_SPACING = 0.1
"""s, at least, between the instants from which is predicted."""
_STATE, _N = kalman.FILTER_STATE, len(kalman.FILTER_STATE)
_MODEL = slice(_N + 1, _N + 8)
_WHOLE, _SHARE, _BIAS, LEFT_OUT = range(_N + 8, _N + 12)
"""Places in `Observer.state_row`, behind the states of the filter and the saturation."""


# -- log --------------------------------------------------------------------------------------------------------------
@dataclass(frozen=True, eq=False)
class ReadLog:
    """A log with its columns; before: the command (rad) before the first sample, where it is known."""

    name: str
    columns: Columns
    log: Log
    before: float | None

    @classmethod
    def of(cls, source: LogSource, car: Vehicle, reading: Reading) -> ReadLog:
        columns, before = read_columns(source, reading), None
        if (run := columns.run) is not None:
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


# -- predictions ------------------------------------------------------------------------------------------------------
class Observer:
    """Filter and learner of a controller, without what steers; one that does not learn keeps the first belief."""

    def __init__(self, mpc: MPC, learns: bool = True) -> None:
        model, estimator = mpc.model, mpc.estimator
        assert isinstance(model, PathModel)
        assert isinstance(estimator, KalmanFilter)
        assert mpc.learner is not None
        self.learner, self.learns, self.size = mpc.learner, learns, estimator.memory_size(model)
        self.car, self.filter = model.parameters(), estimator.parameters(model)
        self.learning, self.known = mpc.learner.parameters(), mpc.learner.fresh()
        self.unused, self.a = np.zeros((3, model.n)), np.zeros((model.n, model.n))
        self.restart()

    def restart(self) -> None:
        """Before the first sample of a drive; what was learned stays."""
        self.memory, self.known = np.zeros(self.size), self.learner.restart_memory(self.known)

    def take(self, speed: float, measured: Array, command: float) -> None:
        """An instant: speed (m/s), what is measured, the command (rad) that was applied since the last one.

        As `core.controllers.informed` lets a controller take it.
        """
        if self.learns:
            omitted = int(kalman.memory_of(self.memory, 0).excluded)
            kernel.learn(speed, measured, command, omitted, self.learning, self.known)
            if not np.isfinite(self.beliefs).all():
                self.known = self.learner.fresh()
            kernel.believe(self.learning, self.known, self.car, self.filter, self.memory)
        b, x, d = self.unused
        kalman.kalman(speed, measured, command, self.a, b, self.filter, self.memory, x, d)

    @property
    def beliefs(self) -> Array:
        """By `BELIEFS`."""
        return self.known[kernel.BELIEFS_OFFSET : kernel.BELIEFS_OFFSET + len(kernel.BELIEF_NAMES)]

    def state_row(self) -> Array:
        """Return z, saturation, the model, dead time in periods, bias and the number of the omitted sensor."""
        m, p = kalman.memory_of(self.memory, 0), kalman.parameters_of(self.filter, 0)
        return np.array([*m.z, m.saturation, *self.car, p.periods, p.share, p.bias, m.excluded])


def predicted(samples: InstantSamples, ours: Array, first: Array, mpc: MPC, tell: Callable[[float], None]) -> Predicted:
    """Predict from every `PREDICTION_SPACING` s of a segment.

    ours, first: (n, .) of `Observer.state_row`, with and without learning; tell: takes the share of the work on
    the segment that is done, of which this is the second half.
    """
    n, period, steps = samples.time.size, mpc.period, {round(ahead / mpc.period): ahead for ahead in TIMES}
    start = np.arange(0, max(n - max(steps), 0), math.ceil(PREDICTION_SPACING / period - 1e-6))
    starts = {"learned": ours[start], "first": first[start]}
    z = {name: starts["learned" if name in ("learned", "held") else "first"][:, :_N].copy() for name in PREDICTORS}
    for name, observed in starts.items():
        z[name][:, _STATE.side] += observed[:, _N]  # what tyres pull less in the bend at hand
    z["steady"][:, _STATE.offset] = 0.0
    predictions = {
        (name, quantity, ahead): np.full(n, math.nan)
        for name in z
        for quantity in PREDICTED_QUANTITIES
        for ahead in TIMES
    }
    for j in range(max(steps)):
        tell(0.5 + 0.5 * j / max(steps))
        k = start + j
        for name, observed in starts.items():
            _roll(z[name], samples, k, observed, period)
        _turn_steadily(z["steady"], samples.speed[k], z["first"][:, _STATE.wheel_angle], mpc.vehicle)
        for name in ("held", "steady"):
            _carry(z[name], samples, k, period)
        for name, state in z.items() if j + 1 in steps else ():
            predictions[name, "yaw_rate", steps[j + 1]][k + 1] = state[:, _STATE.yaw_rate] + state[:, _STATE.offset]
            predictions[name, "y", steps[j + 1]][k + 1] = state[:, _STATE.y] if samples.path is not None else math.nan
    return predictions


def _roll(z: Array, samples: InstantSamples, k: InstantIndices, rows: Array, period: float) -> None:
    """Move states z (m, .) from the instants k (m,) on by a period, with the commands that act behind the dead time."""
    f, b, u = np.zeros((k.size, PATH_STATES, _N)), np.zeros((k.size, _N)), samples.command
    for i, speed in enumerate(samples.speed[k].tolist()):
        discretise_disturbed(speed, period, rows[i, _MODEL], f[i], b[i])
    newer, share = k - rows[:, _WHOLE].astype(np.int64), rows[:, _SHARE]
    command = (1.0 - share) * u[np.maximum(newer, 0)] + share * u[np.maximum(newer - 1, 0)] + rows[:, _BIAS]
    z[:, :PATH_STATES] = product(f, z[..., None])[..., 0] + b[:, :PATH_STATES] * command[:, None]
    turned = samples.measured[k + 1, MEASUREMENT.turned]
    z[:, _STATE.yaw] -= turned
    z[:, _STATE.y] -= 0.5 * samples.speed[k] * period * turned


def _carry(z: Array, samples: InstantSamples, k: InstantIndices, period: float) -> None:
    """Move heading and offset alone on by a period, with the lateral velocity and the yaw rate in z."""
    turned = period * z[:, _STATE.yaw_rate] - samples.measured[k + 1, MEASUREMENT.turned]
    z[:, _STATE.y] += period * (z[:, _STATE.vy] + samples.speed[k] * (z[:, _STATE.yaw] + 0.5 * turned))
    z[:, _STATE.yaw] += turned


def _turn_steadily(z: Array, speed: Array, wheel_angle: Array, car: Any) -> None:
    """Write yaw rate and lateral velocity of the steady turn at a speed (m/s) and a wheel angle (rad)."""
    front, rear, wheelbase = 2.0 * car.stiffness_front, 2.0 * car.stiffness_rear, car.wheelbase
    understeer = car.mass * (car.lr * rear - car.lf * front) / (wheelbase * front * rear)
    z[:, _STATE.yaw_rate] = speed * wheel_angle / (wheelbase + understeer * (speed * speed))
    z[:, _STATE.vy] = (car.lr - car.mass * car.lf * (speed * speed) / (rear * wheelbase)) * z[:, _STATE.yaw_rate]

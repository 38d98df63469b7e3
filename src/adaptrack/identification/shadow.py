"""Shadow mode: the estimator and the learner of a controller run over logs of a driver and steer nothing.

At every control instant they are given what the log measured, and its command (or, without one, the measured wheel
angle) as the one applied. From the state and the belief of an instant the car is predicted `TIMES`, with the commands
and speeds that followed, by

    learned   the path model (`core.models.path`) with the belief of that instant, its disturbances held
    held      the filtered yaw rate and lateral velocity, held
    first     the same model and filter as the first, with the belief before the first sample
    steady    r = v delta/(L + K v^2) and v_y = (l_r - m l_f v^2/(C_r L)) r of the car's file, delta behind the first
              belief's steering (R. Rajamani, *Vehicle Dynamics and Control*, 2nd ed., section 3.3)

What came is compared with it; intervals are those of a bootstrap over blocks of `INTERVAL_BLOCK`.
"""

from __future__ import annotations

import itertools
import math
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from adaptrack.base.checked import NotNegative, checked
from adaptrack.base.errors import InvalidInput, did_you_mean
from adaptrack.base.progress import ProgressCall, reports_progress
from adaptrack.base.statistics import Interval, Ratio, block_rms
from adaptrack.cars.vehicle import Vehicle, load_vehicle
from adaptrack.control.controllers import MPC, BeliefState, LearnedCar, Learning, Uncertainty
from adaptrack.control.controllers.belief import UNKNOWN, GivenSteering
from adaptrack.control.controllers.informed import DEFAULT_PROFILE
from adaptrack.control.controllers.learned_car import UNKNOWN_CAR
from adaptrack.control.kalman import SENSORS, KalmanFilter
from adaptrack.control.models import PathModel
from adaptrack.control.recording import LOG_NAMES
from adaptrack.core.estimators import kalman
from adaptrack.core.estimators import learning as kernel
from adaptrack.core.estimators.learning import SHORTEST_LAG
from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import Array, product
from adaptrack.core.models.contract import MEASUREMENT
from adaptrack.core.models.path import PATH_STATES, discretise_disturbed
from adaptrack.core.roads.road import nearest
from adaptrack.core.synthesis.learner import PUBLISHED_MEDIAN
from adaptrack.core.tracker.records import ACROSS_PENALTY
from adaptrack.drive.prediction import TIMES
from adaptrack.identification.log import HOLE_PERIODS, LEAST_GAP, Log, is_rising, log_of
from adaptrack.identification.loop_check import check_loop
from adaptrack.identification.reading import Columns, Reading, Source, read_logs
from adaptrack.road import Road, fit_road, load_road
from adaptrack.road.road_ahead import RoadAhead, foot_near
from adaptrack.scenario.profile import Profile, load_profile

Flags = NDArray[np.bool_]

INTERVAL_BLOCK = 10.0
"""s, of the blocks from which intervals are drawn."""
FAST_STEERING_QUANTILE = 2.0 / 3.0
"""Quantile of the mean steering rate within a prediction above which its steering is in the fastest third."""
SHADOW_PREVIEW = 4.0
"""s, of the road ahead that the controller is shown."""
LEAST_SPAN, IN_THE_END = 1.0, 10.0
"""s, of what is warned of; s, the end of a log, whose belief is judged."""
MAX_CONTRADICTED_SHARE = 0.1
"""Share of the end in which a contradiction makes the belief doubtful: it passes as the belief becomes less certain."""
STILL_OPEN = 0.5
"""Share of the first standard deviation of the delay above which the log has report little of it."""
WORSE = 1.1
"""Times the error of a simpler predictor, with 95 %, from which what was learned is doubted."""
OMITTABLE_SIGNALS = (("vy",), ("x", "y", "yaw"), ("vy", "x", "y", "yaw"), ("acceleration",))
"""Signals without which the logs are gone through again where the learned model is not best, or is doubted;"""
SPOILT = 0.9
"""they are named where fewer logs are doubted, or the error is below so many times that with them."""
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


class Warned(NamedTuple):
    """A warning, its total duration and the time of its first instant (s); NaN if it concerns the whole log."""

    what: str
    seconds: float
    first: float


class Prediction(NamedTuple):
    """How well a predictor predicted a quantity."""

    predictor: str
    quantity: str
    """yaw_rate (rad/s), or y (m), the offset from the path"""
    ahead: float
    """Prediction horizon (s)."""
    part: str
    """all, or fastest: the third of the log with the fastest steering"""
    rms: Interval
    ours: Ratio
    """RMS of ``learned`` over that of this predictor"""


@dataclass(frozen=True, eq=False)
class ShadowLog:
    """Result of one log, at n control instants."""

    source: str
    time: Array
    """(n,) s, from the log's beginning"""
    command: Array
    """(n,) rad, of the driver: the one applied"""
    proposed: Array
    """(n,) rad, of the controller, one step from where the driver has brought the car; NaN without a path"""
    beliefs: Mapping[str, Array]
    """(n,) each, by the names of `core.estimators.learning.BELIEF_NAMES`"""
    measured: Mapping[str, Array]
    """(n,) yaw_rate (rad/s) and y (m)"""
    predicted: Predicted
    predictions: tuple[Prediction, ...]
    warnings: tuple[Warned, ...]
    doubts: tuple[str, ...]
    """why the belief is not to be believed; none: it is"""
    bounds: tuple[str, ...]
    """of what the truth may lie beyond its range, in the end"""
    notes: tuple[str, ...]
    before: LearnedCar
    """The belief before the first log."""
    learned: LearnedCar

    @property
    def verdict(self) -> str:
        """not believable, at a bound, still learning (the log tells little of the delay), or believable"""
        if self.doubts or self.bounds:
            return "not believable" if self.doubts else "at a bound"
        return "still learning" if self.learned.delay_sigma > STILL_OPEN * self.before.delay_sigma else "believable"

    def of(self, quantity: str, ahead: float, part: str = "all") -> dict[str, Prediction]:
        """By predictor; none where nothing was predicted."""
        return {
            prediction.predictor: prediction
            for prediction in self.predictions
            if prediction[1:4] == (quantity, ahead, part)
        }


@dataclass(frozen=True, eq=False)
class Shadow:
    """Logs in their order; what was learned of one is the belief before the next."""

    car: Vehicle
    period: float
    """s, of the control instants"""
    logs: tuple[ShadowLog, ...]
    spoiling: tuple[str, ...] = ()
    """signals that spoil the belief: they contradict the others, or are not those of the centre of gravity"""

    @property
    def believable(self) -> bool:
        """Whether no log gives a reason to doubt the belief."""
        return not any(log.doubts for log in self.logs)


@reports_progress("shadow")
@checked
def shadow(
    logs: Source | Sequence[Source],
    car: str | os.PathLike[str] | Vehicle,
    *,
    path: str | os.PathLike[str] | Road | None = None,
    reading: Reading | None = None,
    without: Sequence[str] = (),
    profile: str | Profile = DEFAULT_PROFILE,
    belief: GivenSteering = None,
    uncertainty: Uncertainty | None = None,
    learning: Learning | None = None,
    computation: Annotated[NotNegative, Field(lt=1.0), "s"] | None = None,
    progress: ProgressCall | None = None,
) -> Shadow:
    """Run estimator and learner of ``MPC(car, learning=...)`` over logs; nothing is steered.

    Parameters
    ----------
    logs
        As for `identify`, one or several of one car in the order in which they were driven. Position (x, y) and
        heading (yaw) are used where they are logged.
    car
        What is believed of the car before the first log.
    path
        That was to be followed, as `load_road` takes it, or a `Road`. By default x and y of each log, smoothed.
    reading
        Columns, units, signs and steering ratio, where they are not as the names say.
    without
        Signals that are not to be used: vy, acceleration, wheel, x, y, yaw.
    profile
        Whose control period and sensors the controller has: of a sensor that it lacks, the column is not used. Logs
        with fewer samples are gone through at their own period.
    belief, uncertainty, learning
        As for `MPC`. By default what the car's file says of its steering, or nothing.
    computation
        Of the dead time in the log, what lies in the controller's computation: one period, or 0. By default what the
        profile of an own trajectory says, else 0.

    Raises
    ------
    StorageError
        When a file cannot be read.
    InvalidInput
        When a log lacks a signal, is too short or hardly steered.
    """
    vehicle = car if isinstance(car, Vehicle) else load_vehicle(car)
    read = [ReadLog.of(columns, vehicle) for columns in read_logs(logs, reading)]
    removable = sorted({name for names in OMITTABLE_SIGNALS for name in names} | {"wheel"})
    for name in without:
        if name not in removable:
            raise InvalidInput(
                f"shadow: without {name!r}: must be of {', '.join(removable)}. {did_you_mean(name, removable)}"
            )
    late = read[0].columns.computation if computation is None else computation
    world = load_profile(profile)
    periods = (round(log.log.period, 4) for log in read)  # medians between samples
    world = world.replace(period=max(world.period, *periods), delay=float(late > 0.0))
    commanded = all(log.log.commanded for log in read)
    steering = vehicle.steering if commanded else None  # a measured wheel is behind the steering
    if uncertainty is None and not commanded:
        uncertainty = replace(UNKNOWN_CAR, lag=max(UNKNOWN_CAR.lag, PUBLISHED_MEDIAN[0] - SHORTEST_LAG))
    if belief is None and (steering is None or (steering.lag is None and steering.dead_time is None)):
        belief = UNKNOWN
    mpc = MPC(vehicle, profile=world, belief=belief, uncertainty=uncertainty, learning=learning or Learning())
    road = path if isinstance(path, Road | None) else load_road(os.fspath(path))
    show = progress or (lambda *_: None)
    shadow_logs = _all(read, road, mpc, without, show)
    spoiling = () if without else _spoiling(read, road, mpc, shadow_logs, show)
    return Shadow(vehicle, mpc.period, shadow_logs, spoiling)


def _all(
    read: Sequence[ReadLog], road: Road | None, mpc: MPC, without: Sequence[str], show: ProgressCall
) -> tuple[ShadowLog, ...]:  # fmt: skip
    """All logs, one after the other, from the first belief on."""
    mpc.reset()
    observers = Observer(mpc), Observer(mpc, learns=False), mpc
    shadow_logs = []
    for read_log in read:
        stage = read_log.name + (f" without {', '.join(without)}" if without else "")
        shadow_logs.append(_gone_through(read_log.without(without), road, observers, partial(show, stage)))
    return tuple(shadow_logs)


def _spoiling(
    read: Sequence[ReadLog], road: Road | None, mpc: MPC, shadow_logs: Sequence[ShadowLog], show: ProgressCall
) -> tuple[str, ...]:  # fmt: skip
    """Return the `OMITTABLE_SIGNALS` without which fewer logs are doubted, or the learned model errs less.

    They are searched where a log is doubted, or a different predictor predicts the yaw rate better.
    """

    def errors(log: ShadowLog) -> dict[str, float]:
        return {name: error.rms.value for name, error in log.of("yaw_rate", TIMES[-1]).items()}

    def amiss(logs: Sequence[ShadowLog]) -> tuple[int, float]:
        error = portable.hypot(*(compared["learned"] for compared in map(errors, logs) if compared))
        return sum(bool(log.doubts or log.bounds) for log in logs), error

    doubted, error = amiss(shadow_logs)
    best: tuple[str, ...] = ()
    compared_errors = [errors(log) for log in shadow_logs]
    if not doubted and all(compared["learned"] <= other for compared in compared_errors for other in compared.values()):
        return best
    for names in OMITTABLE_SIGNALS:
        signals = [read_log.columns.values.get(name, np.nan) for read_log in read for name in names]
        if all(np.isfinite(values).any() for values in signals):
            fewer, left = amiss(_all(read, road, mpc, names, show))
            if (fewer < doubted and left < error / SPOILT) or (fewer <= doubted and left < SPOILT * error):
                doubted, error, best = fewer, left, names
    return best


def _gone_through(
    read: ReadLog, path: Road | None, observers: tuple[Observer, Observer, MPC], report: Callable[[int, int], None]
) -> ShadowLog:
    """One log; report: (instants done, in all)."""
    mpc, gone, sample_count = observers[2], [], 0
    parts = list(read.segments(mpc.period, path))
    total = sum(part.time.size for part in parts)
    for samples in parts:
        for observer in observers:
            observer.restart()
        tell = partial(_tell, report, sample_count, samples.time.size, total)
        beliefs, ours, first, proposed = _watched(samples, observers, tell)
        gone.append(
            {"time": samples.time, "command": samples.command, "proposed": proposed, "left out": ours[:, LEFT_OUT]}
            | {name: samples.measured[:, getattr(MEASUREMENT, name)] for name in PREDICTED_QUANTITIES}
            | dict(zip(kernel.BELIEF_NAMES, beliefs.T, strict=True))
            | predicted(samples, ours, first, mpc, tell)
        )
        sample_count += samples.time.size
        report(sample_count, total)
    path_notes = [] if parts[0].path is None else [f"beside a path of {parts[0].path.length:.0f} m"]
    if not read.log.commanded:
        path_notes += ["here the delay is that from the measured wheel to the logged yaw rate"]
    records = {key: np.concatenate([part[key] for part in gone]) for key in gone[0]}
    return _summarise_log(read, records, path_notes, observers)


def _tell(report: Callable[[int, int], None], previous: int, current: int, total: int, share: float) -> None:
    """Report the progress: the `previous` instants and a share of the `current` ones are done, of `total`."""
    report(previous + int(share * current), total)


def _watched(
    samples: InstantSamples, observers: tuple[Observer, Observer, MPC], tell: Callable[[float], None]
) -> tuple[Array, Array, Array, Array]:
    """Go through a segment's instants: beliefs, `Observer.state_row` of both (n, .), the controller's commands (n,)."""
    ours, first, mpc = observers
    applied, rows, horizon = samples.before, [], mpc.tuning.Np * mpc.period
    preview = round(SHADOW_PREVIEW / mpc.period)
    for k, speed in enumerate(samples.speed.tolist()):
        measured, proposed = samples.measured[k], math.nan
        ours.take(speed, measured, applied)
        first.take(speed, measured, applied)
        if samples.path is not None and samples.station is not None:
            ahead = RoadAhead(samples.path, float(samples.station[k]), samples.speed[k : k + preview])
            mpc.applied(applied)
            answer = mpc.step(measured, speed, np.zeros(1), road=ahead)
            proposed = math.nan if answer.held or samples.left(k) < speed * horizon else answer.angle
        rows.append((ours.beliefs.copy(), ours.state_row(), first.state_row(), proposed))
        applied = float(samples.command[k])
        if k % 256 == 255:
            tell(0.5 * k / samples.time.size)
    beliefs, of_ours, of_first, commands = (np.array(column) for column in zip(*rows, strict=True))
    return beliefs, of_ours, of_first, commands


# -- what comes of it -------------------------------------------------------------------------------------------------
def _summarise_log(
    read: ReadLog, records: Mapping[Any, Array], path_notes: Sequence[str], observers: tuple[Observer, Observer, MPC]
) -> ShadowLog:
    """Summarise a log; records: its signals at the control instants."""
    ours, first, mpc = observers
    time = records["time"] - read.log.time[0]
    expected = {key: values for key, values in records.items() if isinstance(key, tuple)}
    measured = {name: records[name] for name in PREDICTED_QUANTITIES}
    predictions = tuple(_compared(time, records["command"], measured, expected, mpc.period))
    bounds = {
        f"{name.replace('_', ' ')} at the end of its range": records["belief_at_bound"] == i + 1
        for i, name in enumerate(kernel.QUANTITIES_BOUNDED)
    }
    contradictory = {"the belief fits no car within its ranges": records["belief_state"] == BeliefState.CONTRADICTORY}
    silent = {
        f"{name.replace('_', ' ')} left out by the filter": records["left out"] == i + 1
        for i, name in enumerate(SENSORS)
    }
    sentences = check_loop(read.columns, mpc.vehicle).contradictions
    contradictions = [Warned(sentence.rstrip("."), math.nan, 0.0) for sentence in sentences]
    late = time > time[-1] - IN_THE_END
    spans = [
        Warned(message, float(mpc.period * there.sum()), float(time[np.argmax(there)]))
        for message, there in (contradictory | bounds | silent).items()
        if mpc.period * there.sum() >= LEAST_SPAN
    ]
    doubts = [contradiction.what for contradiction in contradictions]
    doubts += _lasting_messages(contradictory, late, MAX_CONTRADICTED_SHARE)
    doubts += _lasting_messages(silent, np.ones_like(late), 0.5)
    worse = [prediction for prediction in predictions if prediction.ours.low > WORSE]
    better = dict.fromkeys(prediction.predictor for prediction in worse if prediction.quantity == "yaw_rate")
    doubts += [f"the {PREDICTOR_NAMES[name]} predicts the yaw rate better" for name in better]
    return ShadowLog(
        source=read.name, time=time, command=records["command"], proposed=records["proposed"],
        beliefs={name: records[name] for name in kernel.BELIEF_NAMES}, measured=measured, predicted=expected,
        predictions=predictions, warnings=(*contradictions, *spans), doubts=tuple(doubts),
        bounds=tuple(_lasting_messages(bounds, late, 0.5)), notes=(*read.log.notes, *path_notes),
        before=first.learner.learned(first.known),
        learned=ours.learner.learned(ours.known),
    )  # fmt: skip


def _compared(
    time: Array, command: Array, measured: Mapping[str, Array], expected: Predicted, period: float
) -> Iterator[Prediction]:
    """RMS errors of the predictors, where all of them predicted what was measured."""
    turned = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(command, prepend=command[:1])))])
    block = (time // INTERVAL_BLOCK).astype(np.int64)
    for quantity, value in measured.items():
        for ahead in TIMES:
            squared = portable.square(np.array([expected[name, quantity, ahead] - value for name in PREDICTORS]))
            there = np.isfinite(squared).all(axis=0)
            if np.unique(block[there]).size < 2:
                continue
            steered = turned[1:] - turned[np.maximum(np.arange(time.size) + 1 - round(ahead / period), 0)]
            fastest = there & (steered >= np.quantile(steered[there], FAST_STEERING_QUANTILE))
            for part, chosen in (("all", there), ("fastest", fastest)):
                for predictor, (rms, ours) in zip(
                    PREDICTORS, block_rms(squared[:, chosen], block[chosen]), strict=True
                ):
                    yield Prediction(predictor, quantity, ahead, part, rms, ours)


def _lasting_messages(flags: Mapping[str, Flags], late: Flags, share: float) -> list[str]:
    """Return the messages that hold for more than a `share` of the `late` instants."""
    return [message for message, there in flags.items() if there[late].mean() > share]


# -- log --------------------------------------------------------------------------------------------------------------
@dataclass(frozen=True, eq=False)
class ReadLog:
    """A log with its columns; before: the command (rad) before the first sample, where it is known."""

    name: str
    columns: Columns
    log: Log
    before: float | None

    @classmethod
    def of(cls, columns: Columns, car: Vehicle) -> ReadLog:
        before = None
        if (run := columns.run) is not None:
            columns.values.update(vy=run.vy, yaw=run.psi, x=run.X, y=run.Y)
            before = float(run.command[0] - run.command_change[0])
        if columns.ratio_unknown:
            raise InvalidInput(f"{columns.source}: angles of the steering wheel: say --steering-ratio R.")
        log = log_of(columns.values, car.wheelbase, columns.notes, columns.commanded)
        return cls(os.path.basename(columns.source), columns, log, before)

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
    resampled[t[after] - t[after - 1] > max(HOLE_PERIODS * float(np.median(np.diff(t))), LEAST_GAP)] = math.nan
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
        start = x[begin], y[begin], float(np.nan_to_num(course[begin]))
        near = float(nearest(*start, ACROSS_PENALTY, math.nan, path.packed()))
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
    keys = itertools.product(PREDICTORS, PREDICTED_QUANTITIES, TIMES)
    predictions = {key: np.full(n, math.nan) for key in keys}
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

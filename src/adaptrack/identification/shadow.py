"""Shadow mode: the estimator and the learner of a controller run over logs of a driver and steer nothing.

At every control instant they are given what the log measured, and its command (or, without one, the measured wheel
angle) as the one applied. What they predict (`observing`) is compared with what came; intervals are those of a
bootstrap over blocks of `BLOCK`.
"""

from __future__ import annotations

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
from adaptrack.base.progress import ProgressCall, tells
from adaptrack.base.statistics import Interval, Ratio, block_rms
from adaptrack.cars.vehicle import Vehicle, load_vehicle
from adaptrack.control.controllers import MPC, BeliefState, LearnedCar, Learning, Uncertainty
from adaptrack.control.controllers.belief import UNKNOWN, GivenSteering
from adaptrack.control.controllers.informed import DEFAULT_PROFILE
from adaptrack.control.controllers.learned import UNKNOWN_CAR
from adaptrack.control.kalman import SENSORS
from adaptrack.core.estimators import learning as kernel
from adaptrack.core.estimators.learning import SHORTEST_LAG
from adaptrack.core.models.contract import MEASUREMENT
from adaptrack.core.synthesis.learner import PUBLISHED_MEDIAN
from adaptrack.drive.prediction import TIMES
from adaptrack.identification.instants import LogSource, ReadLog, Samples
from adaptrack.identification.loop_check import check_loop
from adaptrack.identification.reading import Reading
from adaptrack.identification.shadow_predictions import LEFT_OUT, PREDICTORS, QUANTITIES, Observer, Predicted, predicted
from adaptrack.road import Road, load_road
from adaptrack.road.ahead import RoadAhead
from adaptrack.scenario.profile import Profile, load_profile

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

BLOCK = 10.0
"""s, of the blocks from which intervals are drawn."""
FASTEST = 2.0 / 3.0
"""Quantile of the mean steering rate within a prediction above which its steering is in the fastest third."""
PREVIEW = 4.0
"""s, of the road ahead that the controller is shown."""
LEAST_SPAN, IN_THE_END = 1.0, 10.0
"""s, of what is warned of; s, the end of a log, whose belief is judged."""
CONTRADICTED = 0.1
"""Share of the end in which a contradiction makes the belief doubtful: it passes as the belief becomes less certain."""
STILL_OPEN = 0.5
"""Share of the first standard deviation of the delay above which the log has report little of it."""
WORSE = 1.1
"""Times the error of a simpler predictor, with 95 %, from which what was learned is doubted."""
SIMPLER = {"held": "the yaw rate held", "first": "the first belief", "steady": "the steady turn"}
OPTIONAL: tuple[tuple[str, ...], ...] = (("vy",), ("x", "y", "yaw"), ("vy", "x", "y", "yaw"), ("acceleration",))
"""Signals without which the logs are gone through again where the learned model is not best, or is doubted;"""
SPOILT = 0.9
"""they are named where fewer logs are doubted, or the error is below so many times that with them."""


class Warned(NamedTuple):
    """What would have been warned of: for how long in all, and from when on first (s); NaN: of the whole log."""

    what: str
    seconds: float
    first: float


class Prediction(NamedTuple):
    """How well a predictor predicted a quantity."""

    predictor: str
    quantity: str
    """yaw_rate (rad/s), or y (m), the offset from the path"""
    ahead: float
    """s"""
    part: str
    """all, or fastest: the third of the log with the fastest steering"""
    rms: Interval
    ours: Ratio
    """RMS of ``learned`` over that of this predictor"""


@dataclass(frozen=True, eq=False)
class ShadowLog:
    """What came of one log, at n control instants."""

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
    """what was believed before the first log"""
    learned: LearnedCar

    @property
    def verdict(self) -> str:
        """not believable, at a bound, still learning (the log tells little of the delay), or believable"""
        if self.doubts or self.bounds:
            return "not believable" if self.doubts else "at a bound"
        return "still learning" if self.learned.delay_sigma > STILL_OPEN * self.before.delay_sigma else "believable"

    def of(self, quantity: str, ahead: float, part: str = "all") -> dict[str, Prediction]:
        """By predictor; none where nothing was predicted."""
        return {each.predictor: each for each in self.predictions if each[1:4] == (quantity, ahead, part)}


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
        return not any(each.doubts for each in self.logs)


@tells("shadow")
@checked
@checked
def shadow(
    logs: LogSource | Sequence[LogSource],
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
    sources = [logs] if isinstance(logs, str | os.PathLike | Mapping) else list(logs)
    vehicle = car if isinstance(car, Vehicle) else load_vehicle(car)
    read = [ReadLog.of(each, vehicle, reading or Reading()) for each in sources]
    if not read:
        raise InvalidInput("shadow: give one log at least.")
    known = sorted({name for names in OPTIONAL for name in names} | {"wheel"})
    for name in without:
        if name not in known:
            raise InvalidInput(f"shadow: without {name!r}: must be of {', '.join(known)}. {did_you_mean(name, known)}")
    late = read[0].columns.computation if computation is None else computation
    world = load_profile(profile)
    world = world.replace(period=max(world.period, *(each.period for each in read)), delay=float(late > 0.0))
    commanded = all(each.log.commanded for each in read)
    said = vehicle.steering if commanded else None  # a measured wheel is behind the steering
    if uncertainty is None and not commanded:
        uncertainty = replace(UNKNOWN_CAR, lag=max(UNKNOWN_CAR.lag, PUBLISHED_MEDIAN[0] - SHORTEST_LAG))
    if belief is None and (said is None or (said.lag is None and said.dead_time is None)):
        belief = UNKNOWN
    mpc = MPC(vehicle, profile=world, belief=belief, uncertainty=uncertainty, learning=learning or Learning())
    road = path if isinstance(path, Road | None) else load_road(os.fspath(path))
    show = progress or (lambda *_: None)
    found = _all(read, road, mpc, without, show)
    amiss = not without and any(each.doubts or each.bounds or not _is_best(each) for each in found)
    return Shadow(vehicle, mpc.period, found, _spoiling(read, road, mpc, found, show) if amiss else ())


def _all(
    read: Sequence[ReadLog], road: Road | None, mpc: MPC, without: Sequence[str], show: ProgressCall
) -> tuple[ShadowLog, ...]:  # fmt: skip
    """All logs, one after the other, from the first belief on."""
    mpc.reset()
    observers = Observer(mpc), Observer(mpc, learns=False), mpc
    found = []
    for each in read:
        stage = each.name + (f" without {', '.join(without)}" if without else "")
        found.append(_gone_through(each.without(without), road, observers, partial(show, stage)))
    return tuple(found)


def _is_best(log: ShadowLog) -> bool:
    """Whether no other predictor predicts the yaw rate better at the farther time."""
    found = log.of("yaw_rate", TIMES[-1])
    return all(found["learned"].rms.value <= each.rms.value for each in found.values())


def _spoiling(
    read: Sequence[ReadLog], road: Road | None, mpc: MPC, found: Sequence[ShadowLog], show: ProgressCall
) -> tuple[str, ...]:  # fmt: skip
    """The signals of `OPTIONAL` without which fewer logs are doubted, or the learned model errs less; none: no such."""

    def amiss(logs: Sequence[ShadowLog]) -> tuple[int, float]:
        compared = [each.of("yaw_rate", TIMES[-1]) for each in logs]
        error = math.hypot(*(each["learned"].rms.value for each in compared if each))
        return sum(bool(each.doubts or each.bounds) for each in logs), error

    doubted, error = amiss(found)
    best: tuple[str, ...] = ()
    for names in OPTIONAL:
        if all(each.has(name) for each in read for name in names):
            fewer, left = amiss(_all(read, road, mpc, names, show))
            if (fewer < doubted and left < error / SPOILT) or (fewer <= doubted and left < SPOILT * error):
                doubted, error, best = fewer, left, names
    return best


def _gone_through(
    read: ReadLog, path: Road | None, observers: tuple[Observer, Observer, MPC], report: Callable[[int, int], None]
) -> ShadowLog:
    """One log; report: (instants done, in all)."""
    mpc, gone, done = observers[2], [], 0
    parts = list(read.segments(mpc.period, path))
    total = sum(each.time.size for each in parts)
    for samples in parts:
        for each in observers:
            each.restart()
        tell = partial(_tell, report, done, samples.time.size, total)
        beliefs, ours, first, proposed = _watched(samples, observers, tell)
        gone.append(
            {"time": samples.time, "command": samples.command, "proposed": proposed, "left out": ours[:, LEFT_OUT]}
            | {name: samples.measured[:, getattr(MEASUREMENT, name)] for name in QUANTITIES}
            | dict(zip(kernel.BELIEF_NAMES, beliefs.T, strict=True))
            | predicted(samples, ours, first, mpc, tell)
        )
        done += samples.time.size
        report(done, total)
    beside = [] if parts[0].path is None else [f"beside a path of {parts[0].path.length:.0f} m"]
    beside += [] if read.log.commanded else ["here the delay is that from the measured wheel to the logged yaw rate"]
    return _judged(read, {key: np.concatenate([each[key] for each in gone]) for key in gone[0]}, beside, observers)


def _tell(report: Callable[[int, int], None], done: int, here: int, total: int, share: float) -> None:
    """Tell how far the work is: instants done before those `here`, a share of which is done, and in all."""
    report(done + int(share * here), total)


def _watched(
    samples: Samples, observers: tuple[Observer, Observer, MPC], tell: Callable[[float], None]
) -> tuple[Array, Array, Array, Array]:
    """Go through the instants of a segment: beliefs, `Observer.now` of both (n, .), the controller's command (n,)."""
    ours, first, mpc = observers
    applied, rows, horizon = samples.before, [], mpc.tuning.Np * mpc.period
    preview = round(PREVIEW / mpc.period)
    for k, speed in enumerate(samples.speed.tolist()):
        measured, proposed = samples.measured[k], math.nan
        ours.take(speed, measured, applied)
        first.take(speed, measured, applied)
        if samples.path is not None and samples.station is not None:
            ahead = RoadAhead(samples.path, float(samples.station[k]), samples.speed[k : k + preview])
            mpc.applied(applied)
            answer = mpc.step(measured, speed, np.zeros(1), road=ahead)
            proposed = math.nan if answer.held or samples.left(k) < speed * horizon else answer.angle
        rows.append((ours.beliefs.copy(), ours.now(), first.now(), proposed))
        applied = float(samples.command[k])
        if k % 256 == 255:
            tell(0.5 * k / samples.time.size)
    beliefs, of_ours, of_first, commands = (np.array(each) for each in zip(*rows, strict=True))
    return beliefs, of_ours, of_first, commands


# -- what comes of it -------------------------------------------------------------------------------------------------
def _judged(
    read: ReadLog, found: Mapping[Any, Array], beside: Sequence[str], observers: tuple[Observer, Observer, MPC]
) -> ShadowLog:
    """A log that was gone through; found: its signals at the control instants."""
    ours, first, mpc = observers
    time = found["time"] - read.log.time[0]
    expected = {key: values for key, values in found.items() if isinstance(key, tuple)}
    measured = {name: found[name] for name in QUANTITIES}
    predictions = tuple(_compared(time, found["command"], measured, expected, mpc.period))
    bounds = _at_bounds(found)
    contradictory = {"the belief fits no car within its ranges": found["belief_state"] == BeliefState.CONTRADICTORY}
    silent = {
        f"{name.replace('_', ' ')} left out by the filter": found["left out"] == i + 1 for i, name in enumerate(SENSORS)
    }
    contradictions = list(_contradictions(read, mpc.vehicle))
    late = time > time[-1] - IN_THE_END
    doubts = [each.what for each in contradictions] + _held(contradictory, late, CONTRADICTED)
    doubts += _held(silent, np.ones_like(late), 0.5)
    better = {each.predictor for each in predictions if each.quantity == "yaw_rate" and each.ours.low > WORSE}
    doubts += [f"{words} predicts the yaw rate better" for name, words in SIMPLER.items() if name in better]
    return ShadowLog(
        source=read.name, time=time, command=found["command"], proposed=found["proposed"],
        beliefs={name: found[name] for name in kernel.BELIEF_NAMES}, measured=measured, predicted=expected,
        predictions=predictions, warnings=(*contradictions, *_spans(contradictory | bounds | silent, time, mpc.period)),
        doubts=tuple(doubts), bounds=tuple(_held(bounds, late, 0.5)), notes=(*read.log.notes, *beside),
        before=first.learner.learned(first.known),
        learned=ours.learner.learned(ours.known),
    )  # fmt: skip


def _contradictions(read: ReadLog, car: Vehicle) -> Iterator[Warned]:
    """Inputs that contradict each other."""
    for sentence in check_loop(read.columns, car).contradictions:
        yield Warned(sentence.rstrip("."), math.nan, 0.0)


def _compared(
    time: Array, command: Array, measured: Mapping[str, Array], expected: Predicted, period: float
) -> Iterator[Prediction]:
    """RMS errors of the predictors, where all of them predicted what was measured."""
    turned = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(command, prepend=command[:1])))])
    block = (time // BLOCK).astype(np.int64)
    for quantity, value in measured.items():
        for ahead in TIMES:
            squared = np.array([expected[name, quantity, ahead] - value for name in PREDICTORS]) ** 2
            there = np.isfinite(squared).all(axis=0)
            if np.unique(block[there]).size < 2:
                continue
            steered = turned[1:] - turned[np.maximum(np.arange(time.size) + 1 - round(ahead / period), 0)]
            fastest = there & (steered >= np.quantile(steered[there], FASTEST))
            for part, chosen in (("all", there), ("fastest", fastest)):
                for predictor, (rms, ours) in zip(
                    PREDICTORS, block_rms(squared[:, chosen], block[chosen]), strict=True
                ):
                    yield Prediction(predictor, quantity, ahead, part, rms, ours)


def _at_bounds(found: Mapping[Any, Array]) -> dict[str, Flags]:
    """(n,) whether the belief is at a bound, by which that is in words."""
    return {
        f"{name.replace('_', ' ')} at the end of its range": found["belief_at_bound"] == i + 1
        for i, name in enumerate(kernel.QUANTITIES_BOUNDED)
    }


def _held(flags: Mapping[str, Flags], late: Flags, share: float) -> list[str]:
    """What held for more than a share of the end, or of all."""
    return [what for what, there in flags.items() if there[late].mean() > share]


def _spans(flags: Mapping[str, Flags], time: Array, period: float) -> Iterator[Warned]:
    """What held for `LEAST_SPAN` or longer in all."""
    for what, there in flags.items():
        if period * there.sum() >= LEAST_SPAN:
            yield Warned(what, float(period * there.sum()), float(time[np.argmax(there)]))

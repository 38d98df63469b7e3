"""A log of driving in SI units, without outliers and cut into segments.

A long log is used in fewer samples: means of neighbouring samples, and the stretches with most lateral acceleration.

An outlier is impossible or isolated: its distance from the trimmed range of its neighbours is several times that range,
many times the noise, and a good share of the range of the signal. On a steep flank the same holds for its height above
both neighbours, compared with the steps around it. The median rule of F. R. Hampel (J. American Statistical Association
69 (1974) 383-393) finds outliers in sharp manoeuvres where there are none.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import rank_filter

from adaptrack.base.errors import InvalidInput
from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import Array

Rows = NDArray[np.bool_]

LOG_SIGNALS = ("command", "speed", "yaw_rate", "vy", "acceleration", "yaw", "wheel")
"""Of a `Log`, beside its time."""
MIN_LOG_SPEED = 1.5
"""m/s, below which samples are left out: slip angles are ill-defined."""
SHORTEST_PERIOD, LONGEST_PERIOD = 5e-4, 0.12
"""s, of the samples, least (of a short log) and most."""
GAP_PERIODS, HOLE_PERIODS, LEAST_GAP = 5.0, 3.0, 0.3
"""A pause longer than so many periods, and than so long (s), begins a new segment; a longer hole is not filled."""
LEAST_SEGMENT, LEAST_DRIVEN = 3.0, 20.0
"""s, of driving, in one piece and in all."""
LEAST_ACCELERATION = 0.1
"""m/s^2, RMS of the lateral acceleration that the steering asks for, below which nothing is excited."""
MAX_SAMPLES, SHORTENED = 15_000, 10_000
"""Samples up to which a log is used as it is, and at most of a shortened one, whose fit takes up to 45 s."""
MEAN_PERIOD, STRETCH_LENGTH = 0.05, 30.0
"""s, between the samples of a longer log, at most; of its stretches."""
IMPOSSIBLE_VALUE, IMPOSSIBLE_YAW = 1e3, 1e5
"""SI units, rad: no speed, rate, acceleration or angle of a car is as large; a heading counts all turns."""
LEAST_DISTANCES: Mapping[str, float] = {
    "command": 0.05, "speed": 1.0, "yaw_rate": 0.05, "vy": 0.5, "acceleration": 1.0, "yaw": 0.05, "wheel": 0.05,
}  # fmt: skip
"""SI units, by which an outlier lies outside the range of its neighbours at least."""
NEIGHBOUR_RANGES, NOISE_SIGMAS, SIGNAL_SHARE, COMMAND_SHARE = 3.0, 10.0, 0.2, 2.0
"""Distance of an outlier, at least: in ranges of its neighbours; in standard deviations of the noise, or steps of a
quantised signal; in ranges of the whole signal. A command was sent as logged, so only a distant one is an outlier."""
LONGEST_OUTLIER, LONGEST_CONSTANT = 0.1, 2.0
"""s, of outliers in a row; of a constant value, which counts as one sample."""
NEIGHBOURS, PASSES = 5, 10
"""To either side, at least; largest number of searches."""
MAX_OUTLIER_SHARE = 0.05
"""Share of a signal from which on the column is wrong, not the sample: outliers then hide each other."""
LEAST_CHANGES, HELD_SHARE, LONGEST_HELD = 100, 0.9, 0.25
"""Changes of a signal, share of them at even distances, and s between them, of a signal that is called held."""
UNDERSTEER, STEERING_RESPONSE_TIME, STEERED_SHARE = 0.003, 1.0, 0.25
"""rad s^2/m, of an ordinary car; s, in which a car responds to its steering; change of the expected yaw rate during
which a gyro is stuck, over its range."""


@dataclass(frozen=True, eq=False)
class Log:
    """n samples in SI units and radians, ISO 8855: yaw rate and steering positive to the left. NaN: not measured.

    `log_of` makes one and refuses what nothing can be learned from.
    """

    time: Array
    """(n,) s, increasing"""
    command: Array
    """(n,) rad, steering command, held until the next sample; where there is none, the measured wheel angle"""
    speed: Array
    """(n,) m/s, forward"""
    yaw_rate: Array
    """(n,) rad/s"""
    vy: Array
    """(n,) m/s, lateral velocity of the centre of gravity"""
    acceleration: Array
    """(n,) m/s^2, as an accelerometer at the centre of gravity reads it"""
    yaw: Array
    """(n,) rad, not wrapped"""
    wheel: Array
    """(n,) rad, measured angle of the road wheels"""
    begins: Rows
    """(n,) whether a segment begins with the sample"""
    commanded: bool = True
    """whether `command` is one, rather than a measured angle"""
    ratio: float = 1.0
    """-, by which the logged angle was divided to give `command`"""
    ratio_unknown: bool = False
    """whether that ratio is a guess, which a measured wheel angle does not share"""
    notes: tuple[str, ...] = ()
    """Sentences on dropped rows and on the reading of columns."""

    @property
    def samples(self) -> int:
        """Number of samples."""
        return int(self.time.size)

    @property
    def period(self) -> float:
        """s, median between samples"""
        return float(np.median(np.diff(self.time)))

    @property
    def tightest(self) -> float:
        """rad, angle of the road wheels that 1 % of the samples exceed."""
        return float(np.percentile(np.abs(self.command - np.median(self.command)), 99))

    @property
    def segments(self) -> int:
        """Pieces between gaps and halts."""
        return int(self.begins.sum())

    @property
    def driven_time(self) -> float:
        """s, of all segments"""
        return float(np.sum(np.diff(self.time)[~self.begins[1:]]))

    def at(self, rows: NDArray[np.int64] | slice, begins: Rows) -> Log:
        """Some samples; begins: whether a segment begins with each."""
        signals: dict[str, Any] = {name: getattr(self, name)[rows] for name in ("time", *LOG_SIGNALS)}
        return replace(self, begins=begins, **signals)


def log_of(
    columns: dict[str, Array], wheelbase: float, notes: tuple[str, ...] = (), commanded: bool = True
) -> Log:  # fmt: skip
    """A log of raw columns: ``time``, ``speed``, ``yaw_rate``, ``command`` or ``wheel`` or both; others may be there.

    Repeated rows are dropped, outliers and what a stuck gyro gives are left out; short holes in command and speed are
    filled; gaps and halts cut the log. wheelbase (m): of the car, for what the steering asks of it. commanded: whether
    ``command`` is one, not a measured angle.

    Raises InvalidInput when a signal is missing, never a number or mostly outliers, the gyro is stuck, times go back,
    samples are too rare, the car stands all the time, the log is too short, or hardly steered.
    """
    require_columns(columns, "time", "speed", "yaw_rate")
    _require_steering(columns)
    time = columns["time"]
    messages = list(notes)
    keep = is_rising(time)
    back = np.isfinite(time[1:]) & np.isfinite(time[:-1]) & (np.diff(time) < -1e-9)
    if back.any():
        raise InvalidInput(f"log: time goes back at row {int(np.flatnonzero(back)[0]) + 2}: sort or split the log.")
    if not keep.all():
        messages.append(f"{int((~keep).sum())} rows that repeat a time, or have none, are left out")
    data = {name: columns[name][keep] if name in columns else np.full(int(keep.sum()), np.nan) for name in LOG_SIGNALS}
    time = time[keep]
    if time.size < 50:
        raise InvalidInput(f"log: {time.size} rows with a time of their own: too few; {LEAST_DRIVEN:g} s are needed.")
    period = check_times(time)
    if not np.isfinite(data["command"]).any():
        commanded = False
        data["command"] = data["wheel"].copy()
        data["wheel"] = np.full(time.size, np.nan)
    if not commanded:
        messages.append("no steering command, only a measured angle: lag and dead time cannot be found")
    _without_outliers(time, data, commanded, messages)
    hole = max(HOLE_PERIODS * period, LEAST_GAP)
    is_known, command = np.isfinite(data["command"]), data["command"]
    data["command"] = (
        hold_values(time, time[is_known], command[is_known], hole) if commanded else _filled(time, command, hole)
    )
    data["speed"] = _filled(time, data["speed"], hole)
    _without_stuck(time, data, wheelbase, messages)
    data["yaw"] = unwrapped(data["yaw"])
    log = _cut(time, data, max(GAP_PERIODS * period, LEAST_GAP), commanded, messages)
    _refuse_idle(log, wheelbase)
    return log


def check_times(time: Array) -> float:
    """s, the median between increasing times (s).

    Raises InvalidInput when the samples are too rare, or nearer to each other than those of any car.
    """
    period = float(np.median(np.diff(time)))
    span = float(time[-1] - time[0])
    if period < SHORTEST_PERIOD and span < LEAST_DRIVEN:
        raise InvalidInput(
            f"log: {span:.2g} s of log, {1e6 * period:.3g} microseconds between samples: is the time in s? If so, say "
            "--units time=s (ms, us, ns)."
        )
    if period > LONGEST_PERIOD:
        raise InvalidInput(
            f"log: a sample every {period:g} s (median): 10 Hz and up is needed. If the times are not seconds, say "
            "so: --units time=ms (us, ns)."
        )
    return period


def _without_outliers(time: Array, data: dict[str, Array], commanded: bool, notes: list[str]) -> None:
    """Make outliers NaN, and say so."""
    for name in LOG_SIGNALS:
        kind = "wheel" if name == "command" and not commanded else name
        outliers = find_outliers(kind, time, data[name])
        if count := int(outliers.sum()):
            samples = "sample is an outlier" if count == 1 else "samples are outliers"
            first = _first(time, data[name], outliers)
            notes.append(f"{kind}: {count} {samples}, left out (the first: {first})")
            data[name] = np.where(outliers, np.nan, data[name])


def _without_stuck(time: Array, data: dict[str, Array], wheelbase: float, notes: list[str]) -> None:
    """Make the yaw rate of a gyro that is stuck NaN, and say so; refuse it where hardly any other is left."""
    yaw_rate = data["yaw_rate"]
    stuck = find_stuck(time, yaw_rate, data["command"], data["speed"], wheelbase)
    if not stuck.any():
        return
    period = float(np.median(np.diff(time[np.isfinite(yaw_rate)])))
    message = f"yaw_rate holds {yaw_rate[stuck][0]:.4g} while the car is steered, {period * stuck.sum():.3g} s in all"
    left = np.where(stuck, np.nan, yaw_rate)
    if period * np.isfinite(left).sum() < LEAST_DRIVEN:
        raise InvalidInput(f"log: {message}: the gyro is stuck, or the column is another (--columns yaw_rate=NAME).")
    data["yaw_rate"] = left
    notes.append(f"{message}: left out, the gyro was stuck")


def require_columns(columns: Mapping[str, Array], *names: str) -> None:
    """Raise `InvalidInput` where a column does not exist or holds no number; it names the option that mends it."""
    for name in names:
        if name not in columns:
            raise InvalidInput(f"log: no column for {name}: name it, --columns {name}=NAME.")
        if not np.isfinite(columns[name]).any():
            raise InvalidInput(f"log: the column for {name} never holds a number.")


def _require_steering(columns: Mapping[str, Array]) -> None:
    """Check that there is a command or a wheel angle, which holds numbers."""
    steering = [name for name in ("command", "wheel") if name in columns]
    if not steering:
        raise InvalidInput("log: no column for the steering: name it, --columns command=NAME or wheel=NAME.")
    if not any(np.isfinite(columns[name]).any() for name in steering):
        require_columns(columns, steering[0])


def hold_values(instants: Array, time: Array, values: Array, longest: float) -> Array:
    """Values at instants (s), each from its time (s) until the next one, for at most so long (s); else NaN."""
    last = np.searchsorted(time, instants + 1e-9, side="right") - 1
    return np.where((last >= 0) & (instants - time[last] <= longest), values[last], np.nan)


def _filled(time: Array, values: Array, longest: float) -> Array:
    """Values with straight lines over holes of at most so long (s)."""
    rows = np.flatnonzero(np.isfinite(values))
    inside = np.interp(time, time[rows], values[rows])
    after = np.clip(np.searchsorted(rows, np.arange(values.size)), 0, rows.size - 1)
    before = np.clip(np.searchsorted(rows, np.arange(values.size), side="right") - 1, 0, rows.size - 1)
    near = time[rows[after]] - time[rows[before]] <= longest
    return np.where(np.isfinite(values) | near, inside, np.nan)


def unwrapped(angle: Array, turn: float = 2.0 * math.pi) -> Array:
    """(n,) angle without its jumps by a turn, in units of that; NaN stays."""
    is_known = np.isfinite(angle)
    out = np.full_like(angle, np.nan)
    out[is_known] = np.unwrap(angle[is_known], period=turn)
    return out


def is_rising(time: Array) -> Rows:
    """(n,) whether a time is later than all before it; NaN is not."""
    later = np.isfinite(time)
    later[later] = np.diff(np.maximum.accumulate(time[later]), prepend=-np.inf) > 0.0
    return later


def segment_starts(begins: Rows) -> NDArray[np.int64]:
    """(n,) row with which the segment of each sample begins."""
    return np.maximum.accumulate(np.where(begins, np.arange(begins.size), 0))


def window_mean(time: Array, values: Array, half: float = 0.5) -> Array:
    """(n,) mean within +-half (s) of each sample."""
    total = np.concatenate([[0.0], np.cumsum(values)])
    low, high = np.searchsorted(time, time - half), np.searchsorted(time, time + half, side="right")
    return (total[high] - total[low]) / (high - low)


def _cut(time: Array, data: dict[str, Array], gap: float, commanded: bool, notes: list[str]) -> Log:
    """Segments between gaps and halts; those that are too short are left out."""
    driving = np.isfinite(data["command"]) & np.isfinite(data["speed"]) & (data["speed"] > MIN_LOG_SPEED)
    if not driving.any():
        raise InvalidInput(f"log: the car never drives faster than {MIN_LOG_SPEED:g} m/s: its steering shows nothing.")
    rows = np.flatnonzero(driving)
    pieces = np.split(rows, np.flatnonzero((np.diff(rows) > 1) | (np.diff(time[rows]) > gap)) + 1)
    pieces = [piece for piece in pieces if time[piece[-1]] - time[piece[0]] >= LEAST_SEGMENT]
    rows = np.concatenate([rows[:0], *pieces])
    begins = np.isin(rows, [piece[0] for piece in pieces])
    seconds = float(np.sum(np.diff(time[rows])[~begins[1:]]))
    if seconds < LEAST_DRIVEN:
        raise InvalidInput(
            f"log: {seconds:.3g} s of driving in pieces of {LEAST_SEGMENT:g} s and more: at least {LEAST_DRIVEN:g} s "
            "are needed, and a minute or two are better."
        )
    if begins.sum() > 1:
        notes.append(f"gaps and halts cut it into {int(begins.sum())} segments")
    signals: dict[str, Any] = {name: data[name][rows] for name in LOG_SIGNALS}
    return Log(time=time[rows], begins=begins, commanded=commanded, notes=tuple(notes), **signals)


def _refuse_idle(log: Log, wheelbase: float) -> None:
    """A log that is hardly steered holds nothing but noise."""
    steered = log.command - np.median(log.command)
    acceleration = float(
        np.sqrt(np.mean(portable.square(portable.square(np.clip(log.speed, 0.0, 15.0)) * steered / wheelbase)))
    )
    if not math.isfinite(acceleration) or acceleration < LEAST_ACCELERATION:
        raise InvalidInput(
            f"log: hardly any steering: it asks for {acceleration:.2g} m/s^2 (RMS); drive bends and lane changes, or "
            "check the unit of the steering column (--units)."
        )


# -- outliers ---------------------------------------------------------------------------------------------------------
def noise_of(values: Array) -> float:
    """First guess of the noise of a sensor: third differences hold little else. NaN without samples."""
    third = np.diff(values, 3)
    third = third[np.isfinite(third)]
    return float(np.median(np.abs(third))) / 0.6745 / math.sqrt(20.0) if third.size else math.nan


def find_outliers(name: str, time: Array, values: Array) -> Rows:
    """Find the samples (n,) of a signal that are infinite, impossible or far from their neighbours.

    Raises InvalidInput when a large share of the signal are outliers.
    """
    limit = IMPOSSIBLE_YAW if name == "yaw" else IMPOSSIBLE_VALUE
    outliers = np.abs(values) >= limit
    for _ in range(PASSES):
        rows = np.flatnonzero(np.isfinite(values) & ~outliers)
        if rows.size <= 2 * NEIGHBOURS:
            break
        remaining = np.unwrap(values[rows]) if name == "yaw" else values[rows]
        isolated = rows[_find_isolated(name, time[rows], remaining)]
        outliers[isolated] = True
        if not isolated.size:
            break
    share = outliers.sum() / max(int((~np.isnan(values)).sum()), 1)
    if share > MAX_OUTLIER_SHARE:
        raise InvalidInput(
            f"log: {100 * share:.0f} % of {name} are outliers (the first: {_first(time, values, outliers)}): check its "
            f"column (--columns {name}=NAME) and its unit (--units)."
        )
    return outliers


def find_stuck(time: Array, yaw_rate: Array, steering: Array, speed: Array, wheelbase: float) -> Rows:
    """Find where (n,) the yaw rate is constant for long although the car is steered.

    The change of the expected yaw rate v delta/(L + K v^2) is compared with its range, so the unit does not matter.
    """
    expected = speed * steering / (wheelbase + UNDERSTEER * (speed * speed))
    measured, outliers = np.flatnonzero(np.isfinite(yaw_rate)), np.zeros(time.size, bool)
    if not measured.size or not np.isfinite(expected).any():
        return outliers
    levels = np.unique(yaw_rate[measured])
    steps = float(np.diff(levels).min() / (levels[-1] - levels[0])) if levels.size > 1 else 0.0
    least = max(STEERED_SHARE, 3.0 * steps) * (np.nanmax(expected) - np.nanmin(expected))
    for first, last in zip(*_runs(yaw_rate[measured]), strict=True):
        start, end = time[measured[first]], time[measured[last]]
        if end - start >= LONGEST_CONSTANT:
            steered = expected[(time >= start) & (time <= end - STEERING_RESPONSE_TIME) & np.isfinite(expected)]
            if steered.size and np.ptp(steered) > least:
                outliers[measured[first : last + 1]] = True
    return outliers


def find_samples(time: Array, values: Array) -> tuple[Rows, str]:
    """Find the rows (n,) in which a signal on a faster raster was sampled, and how the others were filled, in words.

    A held signal repeats its last value, an interpolated one its last slope. The words are empty for neither.
    """
    finite = np.isfinite(time) & np.isfinite(values)
    rows = np.flatnonzero(finite)
    if rows.size <= LEAST_CHANGES or not np.any(np.diff(values[rows])):
        return finite, ""
    x, step = values[rows], np.diff(values[rows])
    quantum = max(float(np.abs(step[step != 0.0]).min()), 1e-9 * float(np.ptp(x)))
    changes = np.flatnonzero(step) + 1
    gaps = np.diff(changes)
    every = int(np.quantile(gaps, 0.1)) if gaps.size else 1
    quantised = float(np.median(np.abs(step[changes - 1]))) <= 2.0 * quantum
    words = "changes only every"
    if every < 2 or (quantised and np.mean(gaps % every == 0) < HELD_SHARE):
        bends = np.abs(np.diff(x, 2)) > 3.0 * quantum
        changes = np.flatnonzero(bends & ~np.append(False, bends[:-1])) + 1
        gaps = np.diff(changes)
        every = int(np.median(gaps)) if gaps.size else 1
        words = "is interpolated between every"
        if not gaps.size or np.mean(np.abs(gaps - every) <= 1) < HELD_SHARE:
            return finite, ""
    if changes.size < LEAST_CHANGES or not 2 <= every <= LONGEST_HELD / float(np.median(np.diff(time[rows]))):
        return finite, ""
    begin = np.concatenate([[0], changes])
    length = np.diff(np.append(begin, rows.size))
    place = np.arange(rows.size) - np.repeat(begin, length)
    is_sample = (place % every == 0) & ((place == 0) | (np.repeat(length, length) - place > every // 2))
    sampled = np.zeros(time.size, bool)
    sampled[rows[is_sample]] = True
    return sampled, f"{words} {every} rows"


def _first(time: Array, values: Array, outliers: Rows) -> str:
    row = int(np.flatnonzero(outliers)[0])
    return f"{values[row]:.4g} at {time[row]:.4g} s"


def _runs(values: Array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """First and last rows of each stretch of one value."""
    first = np.flatnonzero(np.append(True, values[1:] != values[:-1]))
    return first, np.append(first[1:], values.size) - 1


def _find_isolated(name: str, time: Array, values: Array) -> Rows:
    """Find the values (n,) that are far from those before and after them; a constant stretch counts as one value."""
    first, last = _runs(values)
    x, durations = values[first], time[last] - time[first]
    if x.size <= 2 * NEIGHBOURS:
        return np.zeros(values.size, bool)
    trimmed = 1 + max(1, round(LONGEST_OUTLIER / float(np.median(np.diff(time[first])))))
    size = min(2 * max(NEIGHBOURS, math.ceil(2.5 * trimmed)) + 1, x.size - 1)
    low, high = (rank_filter(x, rank, size=size, mode="mirror") for rank in (trimmed, -1 - trimmed))
    step = float(np.diff(np.unique(x)).min())
    extent = (COMMAND_SHARE if name == "command" else SIGNAL_SHARE) * float(high.max() - low.min())
    least = max(LEAST_DISTANCES[name], NOISE_SIGMAS * max(noise_of(x), step), extent)
    beyond = np.maximum(x - high, low - x)
    isolated = (beyond > least) & (beyond > NEIGHBOUR_RANGES * (high - low))
    isolated[1:-1] |= _spikes(np.diff(x), trimmed, size, least)
    return np.repeat(isolated & (durations <= LONGEST_CONSTANT), last - first + 1)


def _spikes(steps: Array, trimmed: int, size: int, least: float) -> Rows:
    """Find the values (n - 2,) above or below both neighbours by more than the steps around them.

    steps: (n - 1,) from each value to the next.
    """
    largest_steps = rank_filter(np.abs(steps), -1 - 2 * trimmed, size=size, mode="mirror")
    height = np.where(steps[:-1] * steps[1:] < 0.0, np.minimum(np.abs(steps[:-1]), np.abs(steps[1:])), 0.0)
    return (height > least) & (height > NEIGHBOUR_RANGES * np.maximum(largest_steps[:-1], largest_steps[1:]))


# -- long logs ------------------------------------------------------------------------------------------------------
def shorten_log(log: Log) -> Log:
    """The log as it is up to `MAX_SAMPLES` samples, else in at most `SHORTENED`, with a note.

    A command is averaged over the time for which the new one is held, other signals about the new instant, so that
    neither moves against the other.
    """
    rows = int(MEAN_PERIOD / log.period + 1e-6)
    if log.samples <= MAX_SAMPLES:
        return log
    if rows > 1:
        note = f"{log.samples} samples: means of {rows} each are used"
        log = replace(_average_rows(log, rows), notes=(*log.notes, note))
    if log.samples <= SHORTENED:
        return log
    duration, selection = log.driven_time, _select_turning(log)
    note = f"of {duration:.0f} s of driving, the {selection.driven_time:.0f} s with most lateral acceleration are used"
    return replace(selection, notes=(*selection.notes, note))


def _average_rows(log: Log, rows: int) -> Log:
    """A log with means of some rows each."""
    first = np.flatnonzero((np.arange(log.samples) - segment_starts(log.begins)) % rows == 0)
    means: dict[str, Any] = {}
    segment = np.cumsum(log.begins)
    for name in LOG_SIGNALS:
        shift = 0 if name == "command" and log.commanded else rows // 2
        total, count = np.zeros(first.size), np.zeros(first.size)
        for offset in range(rows):
            place = np.clip(first + offset - shift, 0, log.samples - 1)
            value = getattr(log, name)[place]
            present = np.isfinite(value) & (segment[place] == segment[first])
            total, count = total + np.where(present, value, 0.0), count + present
        means[name] = np.where(count > 0, total / np.maximum(count, 1), np.nan)
    return replace(log, time=log.time[first], begins=log.begins[first], **means)


def _select_turning(log: Log) -> Log:
    """The stretches with the largest mean square of the lateral acceleration, `SHORTENED` samples in all."""
    number = np.cumsum(log.begins) * 1_000_000 + np.floor(log.time / STRETCH_LENGTH).astype(np.int64)
    _, stretch, sizes = np.unique(number, return_inverse=True, return_counts=True)
    sideways = np.nan_to_num(log.speed * log.yaw_rate)
    order = np.argsort(-np.bincount(stretch, sideways * sideways) / sizes, kind="stable")
    stretches = order[np.cumsum(sizes[order]) <= SHORTENED]
    rows = np.flatnonzero(np.isin(stretch, stretches))
    begins = log.begins[rows] | (np.diff(rows, prepend=-2) > 1)
    return log.at(rows, begins)

"""Outliers of a log: impossible values, values far from their neighbours, a stuck gyro.

A value is isolated when its distance from the trimmed range of its neighbours is several times that range, many times
the noise, and a good share of the range of the signal. On a steep flank the same holds for its height above both
neighbours, compared with the steps around it. The median rule of F. R. Hampel (J. American Statistical Association 69
(1974) 383-393) finds outliers in sharp manoeuvres where there are none.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import rank_filter

from adaptrack.base.errors import InvalidInput

Array = NDArray[np.float64]
Rows = NDArray[np.bool_]

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


def noise_of(values: Array) -> float:
    """First guess of the noise of a sensor: third differences hold little else. NaN without samples."""
    third = np.diff(values, 3)
    third = third[np.isfinite(third)]
    return float(np.median(np.abs(third))) / 0.6745 / math.sqrt(20.0) if third.size else math.nan


def find_outliers(name: str, time: Array, values: Array) -> Rows:
    """Find the samples (n,) of a signal that are infinite, impossible or far from their neighbours.

    Raises
    ------
    InvalidInput
        When a large share of the signal are outliers.
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


def outlier_note(name: str, time: Array, values: Array, outliers: Rows) -> str:
    """Return a note on the outliers of a signal."""
    count = int(outliers.sum())
    samples = "sample is an outlier" if count == 1 else "samples are outliers"
    return f"{name}: {count} {samples}, left out (the first: {_first(time, values, outliers)})"


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

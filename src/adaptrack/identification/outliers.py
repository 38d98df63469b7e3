"""Samples of a log that no sensor measured: beyond what a car can have, alone among their neighbours, of a stuck gyro.

A value is alone when it lies outside the range of its neighbours (some at either end of it left out) by several times
that range, by many times the noise of its signal, and by a good part of all that the signal does; or when it does so
above both of those next to it, several times as far as others step, which a steep flank does not hide. (F. R. Hampel,
J. American Statistical Association 69 (1974) 383-393, has the median of the neighbours and their deviation from it:
that finds outliers in a sharp manoeuvre, too.)
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

ABSURD, ABSURD_YAW = 1e3, 1e5
"""SI units, rad: no speed, rate, acceleration or angle of a car is as large; a heading counts all turns."""
SMALLEST: Mapping[str, float] = {
    "command": 0.05, "speed": 1.0, "yaw_rate": 0.05, "vy": 0.5, "acceleration": 1.0, "yaw": 0.05, "wheel": 0.05,
}  # fmt: skip
"""SI units, by which an outlier lies outside at least."""
RANGES, NOISES, EXTENT, EXTENT_OF_COMMANDS = 3.0, 10.0, 0.2, 2.0
"""By how much it does: ranges of its neighbours; standard deviations of the noise, or steps of a quantised signal; all
that the signal does. A command is no measurement: what is in the log was sent, unless it is far from all."""
LONGEST, LONGEST_HELD = 0.1, 2.0
"""s, of outliers in a row; of one value that is held, which counts as one sample."""
NEIGHBOURS, PASSES = 5, 10
"""To either side, at least; how often what is left is searched again."""
MOST = 0.05
"""Share of a signal from which on the column is wrong, not the sample: outliers then hide each other."""
UNDERSTEER, ANSWERED, TURNED = 0.003, 1.0, 0.25
"""rad s^2/m, of an ordinary car; s, in which a car has answered its steering; share of all that the steering asks for,
by which it changes under a gyro that is stuck."""


def find_outliers(name: str, time: Array, values: Array) -> Rows:
    """(n,) which samples of a signal are infinite, absurd or alone.

    Raises
    ------
    InvalidInput
        When they are a large share of it.
    """
    most = ABSURD_YAW if name == "yaw" else ABSURD
    found = np.abs(values) >= most
    for _ in range(PASSES):
        rows = np.flatnonzero(np.isfinite(values) & ~found)
        if rows.size <= 2 * NEIGHBOURS:
            break
        left = np.unwrap(values[rows]) if name == "yaw" else values[rows]
        alone = rows[_alone(name, time[rows], left)]
        found[alone] = True
        if not alone.size:
            break
    share = found.sum() / max(int((~np.isnan(values)).sum()), 1)
    if share > MOST:
        raise InvalidInput(
            f"log: {100 * share:.0f} % of {name} are outliers (the first: {_first(time, values, found)}): check its "
            f"column (--columns {name}=NAME) and its unit (--units)."
        )
    return found


def find_stuck(time: Array, yaw_rate: Array, steering: Array, speed: Array, wheelbase: float) -> Rows:
    """(n,) where the yaw rate holds one value for long although the car is steered.

    What the steering asks for, v delta/(L + K v^2), is compared with all that it asks for, so its unit does not matter.
    """
    expected = speed * steering / (wheelbase + UNDERSTEER * speed**2)
    known, found = np.flatnonzero(np.isfinite(yaw_rate)), np.zeros(time.size, bool)
    if not known.size or not np.isfinite(expected).any():
        return found
    levels = np.unique(yaw_rate[known])
    steps = float(np.diff(levels).min() / (levels[-1] - levels[0])) if levels.size > 1 else 0.0
    least = max(TURNED, 3.0 * steps) * (np.nanmax(expected) - np.nanmin(expected))
    for first, last in zip(*_runs(yaw_rate[known]), strict=True):
        start, end = time[known[first]], time[known[last]]
        if end - start >= LONGEST_HELD:
            under = expected[(time >= start) & (time <= end - ANSWERED) & np.isfinite(expected)]
            if under.size and np.ptp(under) > least:
                found[known[first : last + 1]] = True
    return found


def said_of(name: str, time: Array, values: Array, found: Rows) -> str:
    """A note on the outliers of a signal."""
    count = int(found.sum())
    what = "sample is an outlier" if count == 1 else "samples are outliers"
    return f"{name}: {count} {what}, left out (the first: {_first(time, values, found)})"


def _first(time: Array, values: Array, found: Rows) -> str:
    row = int(np.flatnonzero(found)[0])
    return f"{values[row]:.4g} at {time[row]:.4g} s"


def _runs(values: Array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """First and last rows of each stretch of one value."""
    first = np.flatnonzero(np.append(True, values[1:] != values[:-1]))
    return first, np.append(first[1:], values.size) - 1


def _alone(name: str, time: Array, values: Array) -> Rows:
    """(n,) whether a value is far from those before and after it; one that is held counts once."""
    first, last = _runs(values)
    x, held = values[first], time[last] - time[first]
    if x.size <= 2 * NEIGHBOURS:
        return np.zeros(values.size, bool)
    trimmed = 1 + max(1, round(LONGEST / float(np.median(np.diff(time[first])))))
    size = min(2 * max(NEIGHBOURS, math.ceil(2.5 * trimmed)) + 1, x.size - 1)
    low, high = (rank_filter(x, rank, size=size, mode="mirror") for rank in (trimmed, -1 - trimmed))
    noise = float(np.median(np.abs(np.diff(x, 3)))) / 0.6745 / math.sqrt(20.0)
    step = float(np.diff(np.unique(x)).min())
    extent = (EXTENT_OF_COMMANDS if name == "command" else EXTENT) * float(high.max() - low.min())
    least = max(SMALLEST[name], NOISES * max(noise, step), extent)
    beyond = np.maximum(x - high, low - x)
    alone = (beyond > least) & (beyond > RANGES * (high - low))
    alone[1:-1] |= _spikes(np.diff(x), trimmed, size, least)
    return np.repeat(alone & (held <= LONGEST_HELD), last - first + 1)


def _spikes(steps: Array, trimmed: int, size: int, least: float) -> Rows:
    """(n - 2,) whether a value rises above, or falls below, both of those next to it, by more than steps about it do.

    steps: (n - 1,) from each value to the next.
    """
    usual = rank_filter(np.abs(steps), -1 - 2 * trimmed, size=size, mode="mirror")
    height = np.where(steps[:-1] * steps[1:] < 0.0, np.minimum(np.abs(steps[:-1]), np.abs(steps[1:])), 0.0)
    return (height > least) & (height > RANGES * np.maximum(usual[:-1], usual[1:]))

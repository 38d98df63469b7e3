"""A long log in fewer samples: means of neighbouring samples, and the stretches with most lateral acceleration."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from adaptrack.identification.log import SIGNALS, Log

Array = NDArray[np.float64]

MAX_SAMPLES = 15_000
"""Samples up to which a log is used as it is: a fit takes half a minute."""
PERIOD, STRETCH = 0.05, 30.0
"""s, between the samples of a longer log, at most; of its stretches."""


def condensed(log: Log) -> Log:
    """The log in at most `MAX_SAMPLES` samples, with a note where it had more.

    A command is averaged over the time for which the new one is held, other signals about the new instant, so that
    neither moves against the other.
    """
    rows = int(PERIOD / log.period + 1e-6)
    if log.samples <= MAX_SAMPLES:
        return log
    if rows > 1:
        note = f"{log.samples} samples: means of {rows} each are used"
        log = replace(_averaged(log, rows), notes=(*log.notes, note))
    if log.samples <= MAX_SAMPLES:
        return log
    driven, chosen = log.driven, _most_turning(log)
    note = f"of {driven:.0f} s of driving, the {chosen.driven:.0f} s with most lateral acceleration are used"
    return replace(chosen, notes=(*chosen.notes, note))


def _averaged(log: Log, rows: int) -> Log:
    """A log with means of some rows each."""
    first, signals = _first_of_groups(log.begins, rows), {}
    segment = np.cumsum(log.begins)
    for name in SIGNALS:
        shift = 0 if name == "command" and log.commanded else rows // 2
        total, count = np.zeros(first.size), np.zeros(first.size)
        for offset in range(rows):
            place = np.clip(first + offset - shift, 0, log.samples - 1)
            value = getattr(log, name)[place]
            present = np.isfinite(value) & (segment[place] == segment[first])
            total, count = total + np.where(present, value, 0.0), count + present
        signals[name] = np.where(count > 0, total / np.maximum(count, 1), np.nan)
    return replace(log, time=log.time[first], begins=log.begins[first], **signals)


def _first_of_groups(begins: NDArray[np.bool_], rows: int) -> NDArray[np.int64]:
    """First row of each group of rows; groups begin anew with each segment."""
    start = np.maximum.accumulate(np.where(begins, np.arange(begins.size), 0))
    return np.flatnonzero((np.arange(begins.size) - start) % rows == 0)


def _most_turning(log: Log) -> Log:
    """The stretches with the largest mean square of the lateral acceleration, `MAX_SAMPLES` in all."""
    number = np.cumsum(log.begins) * 1_000_000 + np.floor(log.time / STRETCH).astype(np.int64)
    _, stretch, sizes = np.unique(number, return_inverse=True, return_counts=True)
    sideways = np.nan_to_num(log.speed * log.yaw_rate)
    order = np.argsort(-np.bincount(stretch, sideways**2) / sizes, kind="stable")
    chosen = order[np.cumsum(sizes[order]) <= MAX_SAMPLES]
    rows = np.flatnonzero(np.isin(stretch, chosen))
    begins = log.begins[rows] | (np.diff(rows, prepend=-2) > 1)
    signals = {name: getattr(log, name)[rows] for name in SIGNALS}
    return replace(log, time=log.time[rows], begins=begins, **signals)

"""A long log in fewer samples: means of neighbouring samples, and the stretches with most lateral acceleration."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from adaptrack.identification.log import LOG_SIGNALS, Log

Array = NDArray[np.float64]

MAX_SAMPLES, SHORTENED = 15_000, 10_000
"""Samples up to which a log is used as it is, and at most of a shortened one, whose fit takes up to 45 s."""
MEAN_PERIOD, STRETCH_LENGTH = 0.05, 30.0
"""s, between the samples of a longer log, at most; of its stretches."""


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
    first = _group_starts(log.begins, rows)
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


def _group_starts(begins: NDArray[np.bool_], rows: int) -> NDArray[np.int64]:
    """First row of each group of rows; groups begin anew with each segment."""
    start = np.maximum.accumulate(np.where(begins, np.arange(begins.size), 0))
    return np.flatnonzero((np.arange(begins.size) - start) % rows == 0)


def _select_turning(log: Log) -> Log:
    """The stretches with the largest mean square of the lateral acceleration, `SHORTENED` samples in all."""
    number = np.cumsum(log.begins) * 1_000_000 + np.floor(log.time / STRETCH_LENGTH).astype(np.int64)
    _, stretch, sizes = np.unique(number, return_inverse=True, return_counts=True)
    sideways = np.nan_to_num(log.speed * log.yaw_rate)
    order = np.argsort(-np.bincount(stretch, sideways * sideways) / sizes, kind="stable")
    stretches = order[np.cumsum(sizes[order]) <= SHORTENED]
    rows = np.flatnonzero(np.isin(stretch, stretches))
    begins = log.begins[rows] | (np.diff(rows, prepend=-2) > 1)
    signals: dict[str, Any] = {name: getattr(log, name)[rows] for name in LOG_SIGNALS}
    return replace(log, time=log.time[rows], begins=begins, **signals)

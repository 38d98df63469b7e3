"""What a loop gave a tracker and what it answered, written while it runs, as a log that `identify` reads."""

from __future__ import annotations

import io
import logging
import math
import os
from collections import deque
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TextIO

from adaptrack.base.errors import InvalidInput, StorageError
from adaptrack.base.files import check_replaceable, write_atomically
from adaptrack.core.maths import portable
from adaptrack.core.tracker.signals import MEASURED, TRACKER_SAMPLE, TrackerSample

LOGGED = MEASURED + TRACKER_SAMPLE._fields[TRACKER_SAMPLE.grade + 1 :]
"""Signals in a log: all but times, those of a schedule and those of the speed control."""
LOG_NAMES = dict(zip(MEASURED[-3:], ("vy", "acceleration", "wheel"), strict=True))
"""Names of columns that differ from those of the signals."""
LOG_COLUMNS = ("time", "command", *(LOG_NAMES.get(name, name) for name in LOGGED), "called", "answer", "offset")
"""A row is a sample, at its own time, with the command that was in force then; behind it what the call was: its time,
the command that it answered, the distance from the path. SI units."""
CHUNK, MAX_LATENESS = 1.0, 1.0
"""s, between two writes, and that a sample may be late to be put where it belongs in time."""
_log = logging.getLogger("adaptrack")


class Recorder:
    """Writes rows to `path`, .csv or .parquet.

    Rows are appended as text once a second, to the file itself or, for Parquet, to ``PATH.csv`` beside it, of which
    `close` makes the Parquet file in one step. So a loop that is killed leaves all but its last two seconds behind, as
    a CSV file; the next recorder to the same path puts that one aside as ``NAME-1.csv``.

    Raises
    ------
    InvalidInput
        When the suffix is another one.
    StorageError
        When the file cannot be written.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        if self.path.suffix not in (".csv", ".parquet"):
            raise InvalidInput(f"Tracker: record = {str(path)!r}: must end in .parquet or .csv.")
        is_csv = self.path.suffix == ".csv"
        self._journal = self.path if is_csv else self.path.with_name(self.path.name + ".csv")
        self._rows: list[tuple[float, ...]] = []
        self._commands: deque[tuple[float, float]] = deque([(-math.inf, math.nan)], maxlen=400)
        self._written = self._due = -math.inf
        check_replaceable(os.path.realpath(self._journal))
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            if not is_csv and self._journal.exists():
                names = (self.path.with_name(f"{self.path.stem}-{number}.csv") for number in range(1, 10_000))
                self._journal.replace(next(name for name in names if not name.exists()))  # left by a killed loop
            self._stream: TextIO | None = self._journal.open("w", encoding="utf-8", newline="\n")
            self._stream.write(",".join(LOG_COLUMNS) + "\n")
            self._stream.flush()
        except OSError as error:
            raise StorageError(f"Tracker: record = {str(path)!r}: cannot be written: {error.strerror}.") from error

    def add(self, sample: Sequence[float], answer: float, offset: float) -> None:
        """Take a call: its row of `TRACKER_SAMPLE`, the command (rad) that it answered, the distance (m) from the path.

        The pose is carried to the time of the motion, which is that of the row.
        """
        call = _at_motion_time(TrackerSample(*map(float, sample)))
        time, call_time = call.motion_time if math.isfinite(call.motion_time) else call.now, call.now
        if call_time < self._due - 10.0 * CHUNK:  # the clock was set back
            self._write(math.inf)
            self._commands.clear()
            self._written = -math.inf
        self._commands.append((call_time, answer))
        command = next((angle for since, angle in reversed(self._commands) if since <= time + 1e-6), math.nan)
        self._rows.append((time, command, *(getattr(call, name) for name in LOGGED), call_time, answer, offset))
        if not call_time < self._due:
            self._due = call_time + CHUNK
            self._write(call_time - MAX_LATENESS)

    def _write(self, until: float) -> None:
        """Append the rows up to a time (s) in their order; what repeats a time, or comes too late, is left out."""
        if self._stream is None:
            return
        ready = sorted(row for row in self._rows if row[0] <= until)
        self._rows = [row for row in self._rows if row[0] > until]
        lines = []
        for row in ready:
            if row[0] > self._written + 1e-6:
                self._written = row[0]
                lines.append(",".join("" if math.isnan(value) else repr(value) for value in row) + "\n")
        try:
            self._stream.write("".join(lines))
            self._stream.flush()
        except OSError as error:
            _log.warning("adaptrack: %s cannot be written any more: %s.", self._journal, error.strerror)
            self._stream = None

    def close(self) -> None:
        """Write what is left; of a Parquet file, make it. A second call does nothing.

        Raises StorageError when the Parquet file cannot be written; the CSV file stays.
        """
        if self._stream is None:
            return
        self._write(math.inf)
        if self._stream is not None:
            self._stream.close()
        self._stream = None
        if self._journal == self.path:
            return
        import pyarrow
        import pyarrow.csv
        import pyarrow.parquet

        floats = pyarrow.csv.ConvertOptions(column_types=dict.fromkeys(LOG_COLUMNS, pyarrow.float64()))
        content = io.BytesIO()
        pyarrow.parquet.write_table(pyarrow.csv.read_csv(self._journal, convert_options=floats), content)
        write_atomically(self.path, content.getvalue())
        self._journal.unlink()


def _at_motion_time(call: Any) -> Any:
    """Carry the pose of a sample to the time of its motion by speed and yaw rate; an unknown yaw rate counts as 0."""
    time = call.motion_time - call.t
    if not abs(time) > 0.0:
        return call
    turned = time * call.yaw_rate if math.isfinite(call.yaw_rate) else 0.0
    middle, way = call.yaw + 0.5 * turned, time * call.speed
    x, y = call.x + way * portable.cos(middle), call.y + way * portable.sin(middle)
    return call._replace(x=x, y=y, yaw=call.yaw + turned)

"""The table in a log file: columns of numbers, instants or text, and the units in a row below their names."""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from adaptrack.base.errors import InvalidInput
from adaptrack.base.files import read_arrow_table, read_bytes, table_lines
from adaptrack.core.maths.portable import product
from adaptrack.drive.trajectory import TRAJECTORY_FORMAT, Trajectory
from adaptrack.scenario.profile import list_profiles, load_profile

Array = NDArray[np.float64]
CellArray = NDArray[Any]
"""(n,) float64, whole numbers, datetime64[ns], or text where most cells are no numbers."""

_NOTHING = ("", "nan", "NaN", "NA", "null")
_NUMBER = re.compile(r"[-+]?(\d+[.,]?\d*|[.,]\d+)([eE][-+]?\d+)?|[-+]?(nan|inf)", re.IGNORECASE)
_CLOCK = re.compile(r"(\d{1,2}):(\d{2}):(\d{2}(?:[.,]\d+)?)")
_PER_UNIT = {1.0: 1_000_000_000, 1e-3: 1_000_000, 1e-6: 1_000, 1e-9: 1}
"""ns in a unit of so many s."""


class LogTable(NamedTuple):
    """Columns of one length by their names."""

    columns: dict[str, CellArray]
    units: dict[str, str]
    """column -> its cell in the row of units below the names"""
    computation: float = 0.0
    """s, of the dead time that lies in the controller's computation, where the file tells"""


def load_table(path: Path) -> LogTable:
    """Load the table in a CSV or Parquet file, or in one of `Trajectory.save`.

    Raises
    ------
    StorageError
        When the file cannot be read.
    InvalidInput
        When it holds no table.
    """
    content = read_bytes(path)
    return _parquet(path, content) if content[:4] == b"PAR1" else _csv(path, content)


def find_origin(times: CellArray, factor: float) -> int:
    """ns, the first of times that are whole numbers or instants; 0 for others.

    factor: s, the unit of whole numbers
    """
    if times.dtype.kind == "M":
        times, factor = _nanoseconds(times)[~np.isnat(times)], 1e-9
    return int(times[0]) * _PER_UNIT[factor] if times.dtype.kind in "iu" and times.size else 0


def seconds(times: CellArray, factor: float, origin: int) -> Array:
    """Times in s since an origin (ns), which is taken off before whole numbers beyond 2^53 are rounded.

    factor: s, the unit of the times; instants have their own.
    """
    if times.dtype.kind == "M":
        return np.where(np.isnat(times), np.nan, seconds(_nanoseconds(times), 1e-9, origin))
    base, remainder = divmod(origin, _PER_UNIT[factor])
    if times.dtype.kind not in "iu" or abs(base) >= 2**62:
        return np.asarray(times * factor - 1e-9 * origin, dtype=np.float64)
    return np.asarray((times - base) * factor - 1e-9 * remainder, dtype=np.float64)


def _nanoseconds(instants: CellArray) -> NDArray[np.int64]:
    """Instants in ns."""
    return instants.astype("datetime64[ns]").astype(np.int64)


def parse_instants(text: CellArray) -> CellArray:
    """Times of day in s, or instants, from text in ISO 8601; the text where a cell is neither."""
    try:
        dates = [datetime.fromisoformat(cell.strip().replace(",", ".")) for cell in text]
        utc = [date if date.tzinfo else date.replace(tzinfo=UTC) for date in dates]
        return np.array([date.astimezone(UTC).replace(tzinfo=None) for date in utc], dtype="datetime64[ns]")
    except ValueError:
        clocks = [_CLOCK.fullmatch(cell.strip()) for cell in text]
    hands = [(match[1], match[2], match[3].replace(",", ".")) for match in clocks if match]
    if len(hands) < text.size:
        return text
    return product(np.array(hands, dtype=np.float64), np.array([3600.0, 60.0, 1.0]))


def _parquet(path: Path, content: bytes) -> LogTable:
    table = read_arrow_table(content, str(path))
    if any(TRAJECTORY_FORMAT.encode() in value for value in (table.schema.metadata or {}).values()):
        run = Trajectory.load(path)
        names = {"time": run.t, "command": run.command, "speed": run.vx, "yaw_rate": run.yaw_rate,
                 "wheel": run.steering, "acceleration": run.lateral_acceleration}  # fmt: skip
        if "requested_force" in run.diagnostics:
            names["force_command"] = run.diagnostics["requested_force"]
        return LogTable(
            {name: np.asarray(values, dtype=np.float64) for name, values in names.items()}, {}, _computation(run)
        )
    return LogTable({name: _read_cells(table.column(i)) for i, name in enumerate(table.column_names)}, {})


def _computation(run: Trajectory) -> float:
    """s, delay of the profile that a trajectory was driven in, where it is a shipped one."""
    name = getattr(run, "meta", {}).get("profile")
    return load_profile(name).delay * float(getattr(run, "period", 0.0)) if name in list_profiles() else 0.0


def _csv(path: Path, content: bytes) -> LogTable:
    import pyarrow
    import pyarrow.csv

    numbered, remarks = table_lines(str(path), content, "replace")
    lines = [line for _, line in numbered]
    if lines and _NUMBER.fullmatch(re.split(r"[,;|\t]", lines[0])[0].strip()):  # the names stand in a remark above
        lines[:0] = [text for number, text in remarks if number < numbered[0][0]][-1:]
    if len(lines) < 2:
        raise InvalidInput(f"{path}: a header and rows of numbers are needed.")
    delimiter = max(",;\t|", key=lines[0].count)
    units = _read_units(lines, delimiter)
    if units:
        del lines[1]
    point = "," if delimiter == ";" and "." not in lines[1] else "."
    try:
        table = pyarrow.csv.read_csv(
            pyarrow.BufferReader("\n".join(lines).encode()),
            # Without threads: one that still reads after an error, while Python exits, would abort the process.
            read_options=pyarrow.csv.ReadOptions(use_threads=False),
            parse_options=pyarrow.csv.ParseOptions(delimiter=delimiter),
            convert_options=pyarrow.csv.ConvertOptions(decimal_point=point, null_values=list(_NOTHING)),
        )
    except pyarrow.ArrowException as error:
        raise InvalidInput(f"{path}: not a table: {error}.") from None
    names = [name.strip().strip('"') for name in table.column_names]
    columns = {name: _read_cells(table.column(i)) for i, name in enumerate(names)}
    return LogTable(columns, dict(zip(names, units, strict=False)))


def _read_units(lines: Sequence[str], delimiter: str) -> list[str]:
    """The cells below the names where none of them is a number, but cells of the next row are; else none."""
    rows = [[cell.strip().strip('"').strip() for cell in line.split(delimiter)] for line in lines[1:3]]
    if len(rows) < 2 or len(rows[0]) < 2 or any(map(_NUMBER.fullmatch, rows[0])):
        return []
    return rows[0] if any(map(_NUMBER.fullmatch, rows[1])) and not any(map(_looks_like_time, rows[0])) else []


def _looks_like_time(cell: str) -> bool:
    return bool(re.match(r"\d{4}-\d\d-\d\d|\d{1,2}:\d\d", cell))


def _read_cells(column: Any) -> CellArray:
    """An Arrow column as an array; text of which most is numbers as these, the rest as NaN."""
    import pyarrow

    kind = column.type
    if pyarrow.types.is_duration(kind):
        nanoseconds = column.cast(pyarrow.duration("ns")).cast(pyarrow.int64())
        column, kind = nanoseconds.cast(pyarrow.timestamp("ns")), pyarrow.timestamp("ns")
    if pyarrow.types.is_timestamp(kind) or pyarrow.types.is_date(kind):
        return column.cast(pyarrow.timestamp("ns"), safe=False).to_numpy().astype("datetime64[ns]")
    if pyarrow.types.is_integer(kind) and not column.null_count:
        return np.asarray(column.to_numpy())
    if pyarrow.types.is_string(kind) or pyarrow.types.is_large_string(kind) or pyarrow.types.is_time(kind):
        text = np.array([str(cell.as_py() or "") for cell in column])
        numbers = np.array([float(cell) if _NUMBER.fullmatch(cell.strip()) else np.nan for cell in text])
        return numbers if np.isfinite(numbers).mean() > 0.5 else text
    try:
        return np.asarray(column.cast(pyarrow.float64(), safe=False).to_numpy(), dtype=np.float64)
    except (pyarrow.ArrowException, ValueError):
        return np.full(len(column), np.nan)

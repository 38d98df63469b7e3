"""Logs from files: CSV, Parquet, own trajectories; columns by name, units from names or as given."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from adaptrack.base.checked import reals
from adaptrack.base.errors import InvalidInput, did_you_mean
from adaptrack.base.files import read_arrow_table, read_bytes, table_lines
from adaptrack.core.maths.portable import Array, product
from adaptrack.drive.trajectory import TRAJECTORY_FORMAT, Trajectory
from adaptrack.identification.log import HOLE_PERIODS, LEAST_GAP, find_samples, hold_values, unwrapped
from adaptrack.scenario.profile import list_profiles, load_profile

CellArray = NDArray[Any]
"""(n,) float64, whole numbers, datetime64[ns], or text where most cells are no numbers."""
Source = str | os.PathLike[str] | Mapping[str, object]
"""A log: a file, or arrays by name."""

SIGNAL_COLUMNS: Mapping[str, tuple[str, tuple[str, ...]]] = {
    "time": ("time", ("time", "t", "timestamp", "timestamps", "stamp", "seconds", "sec")),
    "command": ("angle", (
        "command", "steering_command", "steer_command", "steering_cmd", "steer_cmd", "delta_cmd", "cmd_steering",
        "steering_wheel_command", "u", "cmd", "command_steering_angle", "desired_steering_angle",
    )),
    "wheel": ("angle", (
        "wheel", "wheel_angle", "road_wheel_angle", "steering", "steering_angle", "steer", "steer_angle", "delta",
        "front_wheel_angle",
    )),
    "steering_wheel": (
        "angle", ("steering_wheel_angle", "steering_wheel", "swa", "hand_wheel_angle", "handwheel_angle")
    ),
    "speed": ("speed", (
        "speed", "vx", "v_x", "velocity", "v", "ego_speed", "vehicle_speed", "v_ego", "longitudinal_velocity",
    )),
    "yaw_rate": ("yaw_rate", (
        "yaw_rate", "yawrate", "r", "gyro_z", "gyroz", "wz", "omega_z", "omega", "psi_dot", "dpsi",
        "angular_velocity_z",
    )),
    "vy": ("speed", ("vy", "v_y", "lateral_velocity")),
    "acceleration": ("acceleration", (
        "acceleration", "lateral_acceleration", "ay", "a_y", "acc_y", "accy", "accel_y", "acceleration_y", "a_lat",
    )),
    "acceleration_command": ("acceleration", (
        "acceleration_command", "acceleration_cmd", "accel_command", "accel_cmd", "acc_cmd", "desired_acceleration",
        "requested_acceleration", "target_acceleration",
    )),
    "force_command": (
        "force", ("force_command", "force_cmd", "requested_force", "desired_force", "wheel_force_command")
    ),
    "throttle": ("pedal", ("throttle", "throttle_pedal", "accelerator", "accelerator_pedal", "gas", "gas_pedal")),
    "brake": ("pedal", ("brake", "brake_pedal")),
    "longitudinal_acceleration": ("acceleration", (
        "longitudinal_acceleration", "ax", "a_x", "acc_x", "accx", "accel_x", "acceleration_x", "a_long",
    )),
    "yaw": ("angle", ("yaw", "psi", "heading", "yaw_angle")),
    "x": ("length", ("x", "pos_x", "position_x", "east")),
    "y": ("length", ("y", "pos_y", "position_y", "north")),
}  # fmt: skip
"""Dimension of each signal, and names by which its column is known, without their unit."""
HELD_SIGNALS = ("command", "acceleration_command", "force_command", "throttle", "brake")
"""Commands and pedals: each is in force until the next one."""
_UNITS: Mapping[str, Mapping[str, float]] = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "angle": {"rad": 1.0, "deg": math.pi / 180.0},
    "yaw_rate": {"rad/s": 1.0, "deg/s": math.pi / 180.0},
    "speed": {"m/s": 1.0, "km/h": 1 / 3.6, "mph": 0.44704},
    "acceleration": {"m/s^2": 1.0, "g": 9.80665},
    "force": {"N": 1.0, "kN": 1e3},
    "pedal": {"-": 1.0, "%": 0.01},
    "length": {"m": 1.0},
}
_SHORT = {
    "deg": "deg", "degree": "deg", "degrees": "deg", "rad": "rad", "radps": "rad/s", "rad_s": "rad/s",
    "rad/s": "rad/s", "degps": "deg/s", "dps": "deg/s", "deg_s": "deg/s", "deg/s": "deg/s", "degs": "deg/s",
    "deg_per_s": "deg/s", "deg_sec": "deg/s", "deg_per_sec": "deg/s", "deg/sec": "deg/s",
    "degrees_per_second": "deg/s", "rads": "rad/s", "rad_per_s": "rad/s", "rad_sec": "rad/s", "rad_per_sec": "rad/s",
    "rad/sec": "rad/s", "kmh": "km/h", "kph": "km/h", "km_h": "km/h", "kmph": "km/h", "km/h": "km/h", "mph": "mph",
    "mps": "m/s", "m_s": "m/s", "m/s": "m/s", "ms": "ms", "us": "us", "ns": "ns", "s": "s", "g": "g",
    "m/s^2": "m/s^2", "m/s2": "m/s^2", "mps2": "m/s^2", "m_s2": "m/s^2", "m": "m",
    "%": "%", "pct": "%", "percent": "%",
}  # fmt: skip
"""Units as column names have them."""
NEEDED_SIGNALS = ("speed", "yaw_rate", "command", "wheel", "steering_wheel")
"""Signals, beside the time, whose columns must hold numbers."""
LEAST_WRAP = 0.8
"""Least jump of an angle that wraps, in turns: between two samples it turns by less than the rest."""
_NOTHING = ("", "nan", "NaN", "NA", "null")
_NUMBER = re.compile(r"[-+]?(\d+[.,]?\d*|[.,]\d+)([eE][-+]?\d+)?|[-+]?(nan|inf)", re.IGNORECASE)
_CLOCK = re.compile(r"(\d{1,2}):(\d{2}):(\d{2}(?:[.,]\d+)?)")
_TIME = re.compile(r"\d{4}-\d\d-\d\d|\d{1,2}:\d\d")
_PER_UNIT = {1.0: 1_000_000_000, 1e-3: 1_000_000, 1e-6: 1_000, 1e-9: 1}
"""ns in a unit of so many s."""
_AT_STEERING_WHEEL = re.compile(r"steering_?wheel|swa$|hand_?wheel")


class LogTable(NamedTuple):
    """Columns of one length by their names."""

    columns: dict[str, CellArray]
    units: dict[str, str]
    """column -> its cell in the row of units below the names"""
    run: Trajectory | None = None
    """from `Trajectory.save`"""


@dataclass(frozen=True)
class Reading:
    """How the columns of a log are to be understood; what is left out is guessed from their names, and said.

    Raises
    ------
    InvalidInput
        When a signal or unit is unknown.
    """

    columns: Mapping[str, str] = field(default_factory=dict)
    """signal -> column"""
    units: Mapping[str, str] = field(default_factory=dict)
    """signal -> unit; under ``""`` one for all angles and rates: deg"""
    flip: tuple[str, ...] = ()
    """signals that are positive to the right in the log"""
    steering_ratio: float | Literal["fit"] | None = None
    """-, of the logged steering angles over those of the road wheels; ``"fit"``: to be found; None: to be found for
    columns whose name says that they are angles of the steering wheel, 1 for others"""
    clocks: Mapping[str, str] = field(default_factory=dict)
    """signal -> column of its own times; those of the others are in ``time``"""
    late: Mapping[str, float] = field(default_factory=dict)
    """signal -> s by which its values are older than their times say; negative: younger"""

    def __post_init__(self) -> None:
        for name in (*self.columns, *(u for u in self.units if u), *self.flip, *self.clocks, *self.late):
            if name not in SIGNAL_COLUMNS:
                raise InvalidInput(f"identify: no signal is named {name!r}. {did_you_mean(name, SIGNAL_COLUMNS)}")
        for name, unit in self.units.items():
            if not name and unit not in ("deg", "rad"):
                raise InvalidInput(f"identify: units = {unit!r}: deg or rad for all, or signal=unit.")
            if name and _SHORT.get(unit, unit) not in _UNITS[SIGNAL_COLUMNS[name][0]]:
                raise InvalidInput(
                    f"identify: {name} in {unit!r}: must be {' or '.join(_UNITS[SIGNAL_COLUMNS[name][0]])}."
                )
        for name, late in self.late.items():
            if not abs(reals(f"identify: late[{name!r}]", late)) <= 10.0:
                raise InvalidInput(f"identify: {name} is late by {late!r}: must be within 10 s.")
        ratio = self.steering_ratio
        if ratio not in (None, "fit") and not (isinstance(ratio, int | float) and 0.1 <= ratio <= 100.0):
            raise InvalidInput(f"identify: steering ratio {ratio!r}: must be from 0.1 to 100, or fit.")


@dataclass(frozen=True, eq=False)
class Columns:
    """Columns of a log in SI units, as they were understood."""

    values: dict[str, Array]
    notes: tuple[str, ...]
    source: str
    computation: float = 0.0
    """s, of the dead time that lies in the controller's computation, where the log tells"""
    commanded: bool = True
    """whether ``command``, where it is, is one, rather than a measured angle of the steering wheel"""
    ratio_unknown: bool = False
    """whether ``command`` is an angle of the steering wheel, whose ratio is to be found"""
    ratio: float = 1.0
    """-, by which steering angles were divided"""
    run: Trajectory | None = None
    """where the log is one of `Trajectory.save`"""


def read_logs(logs: Source | Sequence[Source], reading: Reading | None = None) -> list[Columns]:
    """The signals of a log, or of several; errors as `read_columns`, and when there is none."""
    sources = [logs] if isinstance(logs, str | os.PathLike | Mapping) else list(logs)
    if not sources:
        raise InvalidInput("log: give one at least.")
    return [read_columns(source, reading or Reading()) for source in sources]


def read_columns(source: Source, reading: Reading) -> Columns:
    """The signals of a log: a .csv or .parquet file, one of `Trajectory.save`, or arrays by name.

    Raises StorageError when the file cannot be read, and InvalidInput when it is no table of numbers, or names columns
    that it does not have.
    """
    where = "log" if isinstance(source, Mapping) else os.fspath(source)
    if isinstance(source, Mapping):
        table = _table_from_arrays(source)
    else:
        content = read_bytes(source)
        table = (_parquet if content[:4] == b"PAR1" else _csv)(Path(source), content)
    mapping, notes = _assign_columns(table.columns, reading, where)
    origin = _read_times(table, mapping.get("time"), reading, where)
    values = {}
    for signal, column in mapping.items():
        unit, factor = _unit(signal, column, reading, table.units)
        sign = -1.0 if signal in reading.flip or (signal == "steering_wheel" and "wheel" in reading.flip) else 1.0
        cells = table.columns[column]
        if signal == "time":
            values[signal] = _seconds(cells, factor, origin)
        elif cells.dtype.kind in "fiu":
            values[signal] = cells * factor * sign
        elif signal in NEEDED_SIGNALS or signal in reading.columns:
            remedy = f"name another one: --columns {signal}=NAME."
            raise InvalidInput(_text_refusal(where, signal, column, cells) + remedy)
        else:
            notes.append(f"{signal} is left out: the column {column!r} holds no numbers")
            continue
        if factor != 1.0 or sign < 0.0:
            notes.append(f"{signal} is read from {column!r} in {unit}" + (", flipped" if sign < 0.0 else ""))
    for signal in [name for name in ("command", "wheel", "steering_wheel") if name in values]:
        values[signal] = _without_turns(signal, values[signal], notes)
    clocks = {
        signal: _seconds(table.columns[column], _unit("time", column, reading, table.units)[1], origin)
        for signal, column in reading.clocks.items()
    }
    _on_one_clock(values, clocks, reading.late, notes)
    values = _without_repeats(values, notes)
    commanded, unknown = _at_road_wheels(values, mapping, reading.steering_ratio, notes)
    if "time" in values:
        values["time"] = values["time"] - values["time"][np.isfinite(values["time"])][:1].sum()
    stated_ratio = reading.steering_ratio
    ratio = float(stated_ratio) if isinstance(stated_ratio, int | float) else 1.0
    late = 0.0 if table.run is None else _computation(table.run)
    return Columns(values, tuple(notes), where, late, commanded, unknown, ratio, table.run)


def _table_from_arrays(source: Mapping[str, object]) -> LogTable:
    """Arrays by name as a table: whole numbers and instants as they are, other numbers as float64."""
    columns: dict[str, CellArray] = {}
    for name, values in source.items():
        cells = values if isinstance(values, np.ndarray) else reals(f"log: column {str(name)!r}", values)
        plain = cells.dtype.kind in "iuM" and not isinstance(values, np.ma.MaskedArray)
        columns[str(name)] = cells if plain else reals(f"log: column {str(name)!r}", values)
    if any(cells.ndim != 1 for cells in columns.values()):
        raise InvalidInput("log: the columns must be vectors.")
    return LogTable(columns, {})


def _read_times(table: LogTable, time: str | None, reading: Reading, where: str) -> int:
    """Read text in the columns of times as instants; the origin (ns) of all of them.

    time: the column of the log's times
    """
    clocks = [time, *reading.clocks.values()] if time is not None else [*reading.clocks.values()]
    for column in clocks:
        if column not in table.columns:
            raise InvalidInput(f"{where}: has no column {column!r}. {did_you_mean(column, table.columns)}")
        cells = table.columns[column]
        if cells.dtype.kind == "U":
            table.columns[column] = _parse_instants(cells)
        if table.columns[column].dtype.kind == "U":
            remedy = "give seconds, ISO 8601 (2024-05-01T10:00:00.05), or name another column: --columns time=NAME."
            raise InvalidInput(_text_refusal(where, "time", column, cells) + remedy)
    if not clocks:
        return 0
    return _find_origin(table.columns[clocks[0]], _unit("time", clocks[0], reading, table.units)[1])


def _text_refusal(where: str, signal: str, column: str, cells: CellArray) -> str:
    """The first half of a sentence on a column without numbers."""
    return f"{where}: {signal} is the column {column!r}, which holds no numbers (its first cell: {str(cells[0])!r}); "


def _on_one_clock(
    values: dict[str, Array], clocks: Mapping[str, Array], late: Mapping[str, float], notes: list[str]
) -> None:
    """Give every signal its values at the log's times; without any, those are the times of the yaw rate."""
    if "time" not in values and "yaw_rate" in clocks:
        values["time"] = clocks["yaw_rate"]
    time = values.get("time")
    if time is None:
        return
    for signal in [name for name in values if name != "time"]:
        clock = clocks.get(signal, time)
        if values[signal].size != clock.size:
            raise InvalidInput(
                f"log: {signal} has {values[signal].size} values and {clock.size} times: vectors of one length are "
                f"needed, or a clock of its own (--clock {signal}=COLUMN)."
            )
        if signal in clocks or signal in late:
            values[signal] = _resampled(signal, time, clock - late.get(signal, 0.0), values[signal])
            earlier = f"{late.get(signal, 0.0):g} s earlier than stamped"
            notes.append(f"{signal} is read {'at the times of its own clock' if signal in clocks else earlier}")


def _resampled(signal: str, time: Array, clock: Array, values: Array) -> Array:
    """A signal at other times: a command as it is held, others on straight lines, and no sample used twice.

    A signal slower than the log's times has a value only at that which is nearest to each of its samples, but the
    speed, which the model needs everywhere. NaN where no sample is near.
    """
    is_finite = np.isfinite(clock) & np.isfinite(values)
    clock, first = np.unique(clock[is_finite], return_index=True)
    values = values[is_finite][first]
    out = np.full(time.size, np.nan)
    ask = np.isfinite(time)
    if clock.size < 2:
        return out
    period = float(np.median(np.diff(clock)))
    hole = max(HOLE_PERIODS * period, LEAST_GAP)
    if signal == "yaw":
        values = np.unwrap(values)
    at = time[ask]
    if signal in HELD_SIGNALS:
        out[ask] = hold_values(at, clock, values, hole)
        return out
    before = np.clip(np.searchsorted(clock, at + 1e-9, side="right") - 1, 0, clock.size - 1)
    after = np.minimum(before + 1, clock.size - 1)
    near = (at >= clock[0]) & (at <= clock[-1]) & (clock[after] - clock[before] <= hole)
    if signal != "speed" and period > 1.5 * float(np.median(np.diff(at))):
        nearest = np.clip(np.searchsorted(0.5 * (at[1:] + at[:-1]), clock), 0, at.size - 1)
        near &= np.isin(np.arange(at.size), nearest)
    out[ask] = np.where(near, np.interp(at, clock, values), np.nan)
    return out


def _without_turns(signal: str, angle: Array, notes: list[str]) -> Array:
    """A steering angle that wraps, without its jumps by a turn: of 2 pi, or of 360 where its unit is left out."""
    x = angle[np.isfinite(angle)]
    for turn in (2.0 * math.pi, 360.0):
        jumps = np.abs(np.diff(x)) > LEAST_WRAP * turn
        if jumps.any() and np.ptp(x) <= 1.01 * turn:
            notes.append(f"{signal} jumps by a turn {int(jumps.sum())} times: it is unwrapped")
            out = unwrapped(angle, turn)
            return np.asarray(out - turn * np.round(np.nanmedian(out) / turn))
    return angle


def _without_repeats(values: dict[str, Array], notes: list[str]) -> dict[str, Array]:
    """Measured signals without the values that a faster raster repeats or interpolates; rows without news are dropped.

    Values between two samples measure nothing, but would count as measurements without noise.
    """
    time = values.get("time")
    if time is None:
        return values
    news, filled = np.zeros(time.size, bool), False
    for signal in [name for name in values if name not in ("time", *HELD_SIGNALS)]:
        sampled, words = find_samples(time, values[signal])
        news |= sampled
        if words:
            filled = True
            values[signal] = np.where(sampled, values[signal], math.nan)
            notes.append(f"{signal} {words}: the others are left out")
    for signal in [name for name in values if filled and name in HELD_SIGNALS]:
        news |= np.append(True, np.diff(values[signal]) != 0.0)
    return {name: column[news] for name, column in values.items()} if filled else values


def _at_road_wheels(
    values: dict[str, Array], mapping: Mapping[str, str], ratio: float | Literal["fit"] | None, notes: list[str]
) -> tuple[bool, bool]:  # fmt: skip
    """Turn steering angles into those of the road wheels; whether there is a command, whether its ratio is unknown.

    A measured angle of a steering wheel whose ratio is to be found takes the place of the command.
    """
    if ratio == "fit" and "command" not in values and "steering_wheel" not in values and "wheel" in values:
        values["steering_wheel"] = values.pop("wheel")
    turned = values.pop("steering_wheel", None)
    if isinstance(ratio, int | float):
        for signal in ("command", "wheel"):
            if signal in values and (signal == "command" or turned is None):
                values[signal] = values[signal] / ratio
        if turned is not None and "wheel" not in values:
            values["wheel"] = turned / ratio
        return True, False
    if "command" in values:
        if turned is not None:
            notes.append("the angle of the steering wheel is left out beside a command: --steering-ratio R uses it")
        return True, ratio == "fit" or bool(_AT_STEERING_WHEEL.search(_plain(mapping["command"])[0]))
    if turned is None:
        return True, False
    values["command"] = turned
    return False, True


def _plain(column: str) -> tuple[str, str]:
    """The name of a column without its unit, and the unit; the latter may be empty."""
    name = re.sub(r"(?<=[a-z])(?=[A-Z][a-z]|[A-Z]$)", "_", column.strip()).lower()
    bracket = re.search(r"[\[(]\s*([^\])]+?)\s*[\])]\s*$", name)
    if bracket:
        return re.sub(r"[^a-z0-9]+", "_", name[: bracket.start()]).strip("_"), _SHORT.get(
            bracket[1].replace("²", "2").replace("°", "deg"), ""
        )
    name = re.sub(r"[^a-z0-9]+", "_", name).strip("_")
    for ending in sorted(_SHORT, key=len, reverse=True):
        if name.endswith("_" + ending) and len(name) > len(ending) + 1:
            return name[: -len(ending) - 1], _SHORT[ending]
    return name, ""


def _assign_columns(table: Mapping[str, CellArray], reading: Reading, where: str) -> tuple[dict[str, str], list[str]]:
    """Signal -> column: those that are given, then those whose name is known."""
    for column in reading.columns.values():
        if column not in table:
            raise InvalidInput(f"{where}: has no column {column!r}. {did_you_mean(column, table)}")
    mapping, notes = dict(reading.columns), list[str]()
    plain = {column: _plain(column)[0] for column in table}
    for signal, (_, names) in SIGNAL_COLUMNS.items():
        unused = [column for column in table if signal not in mapping and column not in mapping.values()]
        match = next((column for name in names for column in unused if plain[column] == name), None)
        if match is not None:
            mapping[signal] = match
            if match != signal:
                notes.append(f"guessed: {signal} is the column {match!r}")
    if "wheel" in mapping and "steering_wheel" not in mapping and _AT_STEERING_WHEEL.search(plain[mapping["wheel"]]):
        mapping["steering_wheel"] = mapping.pop("wheel")
    return mapping, notes


def _unit(signal: str, column: str, reading: Reading, row: Mapping[str, str]) -> tuple[str, float]:
    """The unit of a column and its factor to SI: as requested, else in its name, else in the row of units."""
    dimension = SIGNAL_COLUMNS[signal][0]
    units = _UNITS[dimension]
    stated_unit = reading.units.get(signal)
    if stated_unit is None and signal == "steering_wheel":
        stated_unit = reading.units.get("wheel")
    if stated_unit is None and "" in reading.units and dimension in ("angle", "yaw_rate"):
        stated_unit = reading.units[""] + ("/s" if signal == "yaw_rate" else "")
    if stated_unit is None:
        stated_unit = _plain(column)[1] or _unit_from_row(signal, column, row.get(column, ""))
        if dimension == "yaw_rate" and stated_unit in ("deg", "rad"):
            stated_unit += "/s"
        elif dimension == "angle":  # degs: degrees
            stated_unit = stated_unit.removesuffix("/s")
    stated_unit = _SHORT.get(stated_unit, stated_unit)
    unit = stated_unit if stated_unit in units else next(iter(units))
    return unit, units[unit]


def _unit_from_row(signal: str, column: str, cell: str) -> str:
    """The unit in the row of units; empty where its cell is."""
    text = cell.strip("[]() ").lower().replace("²", "2").replace("°", "deg")
    unit = _SHORT.get(text, _SHORT.get(re.sub(r"[^a-z0-9]+", "_", text).strip("_"), ""))
    if text not in ("", "-") and not unit:
        options = " or ".join(_UNITS[SIGNAL_COLUMNS[signal][0]])
        raise InvalidInput(f"log: {signal} is the column {column!r} in {cell!r}: say --units {signal}={options}.")
    return unit


# -- tables in files --------------------------------------------------------------------------------------------------
def _find_origin(times: CellArray, factor: float) -> int:
    """ns, the first of times that are whole numbers or instants; 0 for others.

    factor: s, the unit of whole numbers
    """
    if times.dtype.kind == "M":
        times, factor = _nanoseconds(times)[~np.isnat(times)], 1e-9
    return int(times[0]) * _PER_UNIT[factor] if times.dtype.kind in "iu" and times.size else 0


def _seconds(times: CellArray, factor: float, origin: int) -> Array:
    """Times in s since an origin (ns), which is taken off before whole numbers beyond 2^53 are rounded.

    factor: s, the unit of the times; instants have their own.
    """
    if times.dtype.kind == "M":
        return np.where(np.isnat(times), np.nan, _seconds(_nanoseconds(times), 1e-9, origin))
    base, remainder = divmod(origin, _PER_UNIT[factor])
    if times.dtype.kind not in "iu" or abs(base) >= 2**62:
        return np.asarray(times * factor - 1e-9 * origin, dtype=np.float64)
    return np.asarray((times - base) * factor - 1e-9 * remainder, dtype=np.float64)


def _nanoseconds(instants: CellArray) -> NDArray[np.int64]:
    """Instants in ns."""
    return instants.astype("datetime64[ns]").astype(np.int64)


def _parse_instants(text: CellArray) -> CellArray:
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
        return LogTable({name: np.asarray(values, dtype=np.float64) for name, values in names.items()}, {}, run)
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
    return rows[0] if any(map(_NUMBER.fullmatch, rows[1])) and not any(map(_TIME.match, rows[0])) else []


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

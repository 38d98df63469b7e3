"""Scenarios: reference, speed, friction and wind of a test drive as functions of time, and their samples."""

from __future__ import annotations

import csv
import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Self

import numpy as np
from numpy.typing import ArrayLike
from pydantic import BeforeValidator, Field, model_validator

from adaptrack.base import files
from adaptrack.base.checked import Positive, checked, reals
from adaptrack.base.errors import ConfigError, InvalidInput, did_you_mean
from adaptrack.base.files import Record, as_tuples, build
from adaptrack.base.limits import DURATION, PERIODS, check_limit
from adaptrack.core.maths.portable import Array
from adaptrack.scenario import shapes
from adaptrack.scenario.shapes import Constant, Knots, Method, Patch, Shape, Signal, Wind
from adaptrack.scenario.signals import Signals, instants

CONTROL_PERIOD = 0.1
"""Control period of the published MPC (s)."""

_MIRRORED = " (mirrored)"
FRICTION_COLUMNS = (
    ("friction",),
    ("friction_left", "friction_right"),
    ("friction_front_left", "friction_front_right", "friction_rear_left", "friction_rear_right"),
)
"""The three choices of friction columns: one for all wheels, one per side, or one per wheel."""

_ALL_COLUMNS = ("t", "y_ref", "speed", "wind_x", "wind_y", *(name for names in FRICTION_COLUMNS for name in names))
_ROAD_COLUMNS = {"x", "y", "x_m", "y_m"}


class Scenario(Record):
    """Test drive on a straight road: the reference and speed to follow, the friction and the wind.

    Each signal is a function of time (`adaptrack.scenario.shapes`). A signal may also be given as a number or as a
    table of a scenario file. Conventions: x forward, y left, SI units, radians.

    Raises
    ------
    InvalidInput
        When a value is not allowed, the speed becomes negative or the friction leaves (0, 3] during the run.
    """

    name: str = Field(min_length=1)
    description: str = ""
    source: str = ""  # origin of the signals
    duration: float = Field(gt=0.0, description="duration of the drive, s")
    windows: dict[str, Annotated[float, Field(gt=0.0)]] = Field(
        default_factory=dict, description="durations of parts of the drive by name, s"
    )
    reference: Signal = Field(description="lateral position to follow, m")
    speed: Signal = Field(description="longitudinal speed to follow, m/s")
    friction: Annotated[tuple[Shape, ...], BeforeValidator(shapes.as_friction)] = Field(
        description="friction coefficient: one for all wheels, [left, right], or one per wheel"
    )
    friction_patches: Annotated[tuple[Patch, ...], BeforeValidator(shapes.as_patches)] = Field(
        default=(), description="stretches with a different friction; where several overlap, the last one applies"
    )
    wind: Annotated[Wind, BeforeValidator(shapes.as_wind)] = Field(
        default=Wind(), description="wind velocity in the world frame, m/s"
    )
    wind_gain: float = Field(default=1.0, description="factor on the wind")
    bank: Signal | None = Field(
        default=None, description="bank angle of the road, rad, positive if it pulls the car to the left"
    )
    grade: Signal | None = Field(default=None, description="grade dz/ds of the road, positive uphill")
    start_y: float | None = Field(
        default=None, description="lateral position at the start, m; by default that of the reference"
    )
    start_heading: float = Field(default=0.0, description="rad, heading at the start, positive to the left")

    if TYPE_CHECKING:  # type checkers: shapes may be given as numbers and tables

        def __init__(self, **values: Any) -> None: ...

    @model_validator(mode="after")
    def _check_signals(self) -> Self:
        check_limit("duration", self.duration, DURATION)
        self.sample(self.duration / 1000.0)
        return self

    # ---- the signals as functions of time

    def reference_at(self, t: ArrayLike) -> Array:
        """The lateral reference y_ref (m) at the times `t` (s), in the shape of `t`."""
        return self.reference.at(t)

    def speed_at(self, t: ArrayLike) -> Array:
        """The speed reference (m/s) at the times `t` (s)."""
        return self.speed.at(t)

    def friction_at(self, t: ArrayLike) -> Array:
        """Friction coefficients (..., 4) of front-left, front-right, rear-left, rear-right at the times `t` (s)."""
        t = np.asarray(t, dtype=np.float64)
        frictions = [shape.at(t) for shape in self.friction]
        wheels = {1: (0, 0, 0, 0), 2: (0, 1, 0, 1), 4: (0, 1, 2, 3)}[len(frictions)]
        friction = np.stack([frictions[k] for k in wheels], axis=-1)
        for patch in self.friction_patches:
            inside = (t >= patch.start) & (t < patch.end)
            for wheel in shapes.WHEELS[patch.wheels]:
                friction[..., wheel] = np.where(inside, patch.friction, friction[..., wheel])
        return friction

    def wind_at(self, t: ArrayLike) -> Array:
        """Wind vectors (..., 2) along world X and Y (m/s) at the times `t` (s), multiplied by `wind_gain`."""
        return self.wind_gain * self.wind.at(t)

    def bank_at(self, t: ArrayLike) -> Array:
        """The bank angle of the road (rad) at the times `t` (s), in the shape of `t`."""
        return np.zeros(np.shape(t)) if self.bank is None else self.bank.at(t)

    def grade_at(self, t: ArrayLike) -> Array:
        """The grade dz/ds of the road, positive uphill, at the times `t` (s), in the shape of `t`."""
        return np.zeros(np.shape(t)) if self.grade is None else self.grade.at(t)

    @property
    def initial_y(self) -> float:
        """Lateral position at the start (m): `start_y`, by default the reference at t = 0."""
        return float(self.reference.at(0.0)) if self.start_y is None else self.start_y

    def start_pose(self) -> tuple[float, float, float]:
        """Return x (m), y (m) and yaw (rad) of the car at the start."""
        return 0.0, self.initial_y, self.start_heading

    @checked
    def sample(self, period: Annotated[Positive, "s"] = CONTROL_PERIOD) -> Signals:
        """Sample the signals at the instants k * period, k = 0..n, with n = round(duration/period) control periods.

        Raises
        ------
        InvalidInput
            When the drive has no control period or too many, or when a sampled value is invalid (see `Signals`).
        """
        ratio = self.duration / period
        n = round(min(ratio, 2.0 * PERIODS.most))
        if not 1 <= n <= PERIODS.most:
            raise InvalidInput(
                f"scenario {self.name!r} lasts {self.duration!r} s: {ratio:.3g} periods of {period!r} s; "
                f"1 to {PERIODS.most:,} are possible ({PERIODS.reason})."
            )
        t = instants(n, period)
        return Signals(
            period, t, self.reference_at(t), self.speed_at(t), self.friction_at(t), self.wind_at(t), self.bank_at(t),
            grade=self.grade_at(t),
        )  # fmt: skip

    # ---- variants

    def mirrored(self) -> Scenario:
        """Return the scenario with left and right exchanged; mirroring twice returns the original scenario."""
        is_mirrored = self.name.endswith(_MIRRORED)
        pairs = {1: (0,), 2: (1, 0), 4: (1, 0, 3, 2)}[len(self.friction)]
        return self.replace(
            name=self.name.removesuffix(_MIRRORED) if is_mirrored else self.name + _MIRRORED,
            reference=self.reference.scaled(-1.0),
            friction=tuple(self.friction[k] for k in pairs),
            friction_patches=tuple(patch.mirrored() for patch in self.friction_patches),
            wind=self.wind.mirrored(),
            bank=None if self.bank is None else self.bank.scaled(-1.0),
            start_y=None if self.start_y is None else 0.0 - self.start_y,
            start_heading=0.0 - self.start_heading,
        )

    def with_duration(self, duration: float) -> Scenario:
        """Return the scenario with a new duration (s); signals keep their last value after their last knot."""
        return self.replace(duration=duration)

    def with_window(self, name: str) -> Scenario:
        """Return the scenario with one of the durations named in `windows`."""
        if name not in self.windows:
            hint = did_you_mean(str(name), self.windows) if self.windows else "It has no windows; give a duration."
            raise InvalidInput(f"scenario {self.name!r} has no window {name!r}. {hint}")
        return self.replace(duration=self.windows[name])

    # ---- from and to arrays and files

    @classmethod
    @checked
    def from_arrays(
        cls,
        t: ArrayLike,
        y_ref: ArrayLike,
        speed: ArrayLike,
        friction: ArrayLike,
        wind: ArrayLike = 0.0,
        *,
        name: str = "arrays",
        reference_method: Method = "linear",
        **fields: Any,
    ) -> Scenario:
        """Build a scenario from samples, joined by straight lines; its time starts at the first sample.

        Parameters
        ----------
        t : (n,) array
            Increasing times, s.
        y_ref, speed : (n,) array or number
            Lateral reference (m) and speed (m/s).
        friction : (n,), (n, 2), (n, 4) array or number
            Coefficient of all wheels, of [left, right], or of [front-left, front-right, rear-left, rear-right].
        wind : (n,) or (n, 2) array or number
            Lateral wind velocity, or its components along world X and Y (m/s).
        reference_method : "linear", "pchip" or "cubic"
            Interpolation of the reference between its samples, see `Knots`.
        **fields
            Further fields of `Scenario`, such as `start_y`; `duration` defaults to that of the samples.

        Raises
        ------
        InvalidInput
            When lengths differ, a value is NaN or infinite, or the time does not increase.
        """
        times = reals("t", t)
        if times.ndim != 1 or times.size < 2:
            raise InvalidInput(f"t has shape {times.shape}; give a list of at least two times.")
        if not np.isfinite(times).all():
            raise InvalidInput(f"t[{np.flatnonzero(~np.isfinite(times))[0]}] is not finite.")
        if (np.diff(times) <= 0.0).any():
            k = int(np.argmax(np.diff(times) <= 0.0)) + 1
            raise InvalidInput(f"t[{k}] = {times[k]} s does not come after t[{k - 1}] = {times[k - 1]} s.")
        times = times - times[0]
        friction_columns = _columns("friction", friction, times, (1, 2, 4))
        wind_columns = _columns("wind", wind, times, (1, 2))
        values: dict[str, Any] = {
            "name": name,
            "duration": float(times[-1]),
            "reference": _columns("y_ref", y_ref, times, (1,), reference_method)[0],
            "speed": _columns("speed", speed, times, (1,))[0],
            "friction": friction_columns,
            "wind": wind_columns[0] if len(wind_columns) == 1 else wind_columns,
        }
        return cls(**(values | fields))

    @classmethod
    @checked
    def from_csv(cls, path: str | os.PathLike[str], **fields: Any) -> Scenario:
        """Build a scenario from a CSV table with the columns t, y_ref, speed, friction, wind_y and optionally wind_x.

        The column ``friction`` may be replaced by ``friction_left`` and ``friction_right``, or by one column per wheel
        (``friction_front_left``, ...). Empty lines and lines that start with # are skipped. `fields` are those of
        `from_arrays`.

        Raises
        ------
        StorageError
            When the file cannot be read.
        ConfigError
            When the table is invalid; the message names the line and the remedy.
        """
        columns = _read_table(path)
        wheels = next(names for names in FRICTION_COLUMNS if names[0] in columns)
        winds = [name for name in ("wind_x", "wind_y") if name in columns]
        friction, wind = (np.stack([columns[name] for name in names], axis=-1) for names in (wheels, winds))
        signals = columns["t"], columns["y_ref"], columns["speed"], friction, wind
        try:
            return cls.from_arrays(*signals, **({"name": Path(path).stem} | fields))
        except InvalidInput as error:
            raise ConfigError(f"{os.fspath(path)}: {error}") from None

    @classmethod
    @checked
    def from_toml(cls, path: str | os.PathLike[str]) -> Scenario:
        """Load a scenario from a TOML file (docs/driving.md); without the key ``name``, it is named after the file.

        Raises
        ------
        StorageError
            When the file cannot be read.
        ConfigError
            When values are invalid; the message lists each key with its value and the allowed values.
        """
        return build(cls, {"name": Path(path).stem} | files.read_toml(path), path)

    def to_dict(self) -> dict[str, Any]:
        """Return the entries of the scenario's TOML file as plain Python values; `None` marks entries that it omits."""
        friction = [shape.table() for shape in self.friction]
        tables = {
            "reference": self.reference.table(),
            "speed": self.speed.table(),
            "friction": friction[0] if len(friction) == 1 else friction,
            "friction_patches": [dict(patch) for patch in self.friction_patches] or None,
            "wind": self.wind.table(),
            "windows": dict(self.windows) or None,
        }
        optional = {"bank": self.bank, "grade": self.grade}
        tables |= {name: signal.table() for name, signal in optional.items() if signal is not None}
        names = [name for name in type(self).model_fields if name not in optional or name in tables]
        return {name: tables.get(name, getattr(self, name)) for name in names}

    def to_toml(self, path: str | os.PathLike[str]) -> None:
        """Write the scenario to a TOML file that `load_scenario` reads back unchanged; a failed write changes no file.

        Raises
        ------
        StorageError
            When the file cannot be written.
        """
        remarks = {name: field.description for name, field in type(self).model_fields.items() if field.description}
        text = files.dump_toml(self.to_dict(), remarks)
        # One point per line, where tomli-w would write one number per line.
        rows = re.sub(r"\[\n\s*([-+.,\w\s]*?),?\n\s*\]", lambda row: f"[{' '.join(row[1].split())}]", text)
        files.write_atomically(path, rows.encode())


def _columns(
    name: str, values: ArrayLike, times: Array, widths: Sequence[int], method: Method = "linear"
) -> list[Shape]:
    """Return one shape per column of `values`, whose rows belong to `times` (s); a number becomes a constant."""
    array = reals(name, values)
    if not np.isfinite(array).all():
        where = np.argwhere(~np.isfinite(array))[0]
        raise InvalidInput(f"{name}{[int(k) for k in where] or ''} is not finite.")
    if array.ndim == 0:
        return [Constant(value=float(array))]
    columns = array[:, np.newaxis] if array.ndim == 1 else array
    if columns.ndim != 2 or columns.shape[0] != times.size or columns.shape[1] not in widths:
        expected = ", ".join(f"({times.size}, {width})" if width > 1 else f"({times.size},)" for width in widths)
        raise InvalidInput(f"{name} has shape {array.shape}; with {times.size} times it must be {expected}.")
    return [Knots(points=as_tuples(np.stack([times, column], axis=-1)), method=method) for column in columns.T]


# -- tables in CSV files ----------------------------------------------------------------------------------------------
def _read_table(path: str | os.PathLike[str]) -> dict[str, Array]:
    """Read the columns of a scenario's CSV file (see `Scenario.from_csv`) into arrays by name."""
    where = os.fspath(path)
    numbered, _ = files.table_lines(where, files.read_bytes(path), "strict")
    try:
        lines = [(line, [cell.strip() for cell in row]) for line, text in numbered for row in csv.reader([text])]
    except csv.Error as error:
        raise ConfigError(f"{where}: not a CSV file: {error}.") from error
    lines = [(line, row) for line, row in lines if any(row)]
    if not lines:
        raise ConfigError(f"{where}: empty; its first line must name the columns.")
    (first, header), rows = lines[0], lines[1:]
    _check_header(f"{where}, line {first}", header)
    if len(rows) < 2:
        raise ConfigError(f"{where}: at least two rows of numbers are needed; there are {len(rows)}.")
    table = np.empty((len(rows), len(header)))
    for k, (line, row) in enumerate(rows):
        if len(row) != len(header):
            raise ConfigError(f"{where}, line {line}: {len(row)} cells, but the header has {len(header)} columns.")
        table[k] = [_number(f"{where}, line {line}", name, cell) for name, cell in zip(header, row, strict=True)]
    t = table[:, header.index("t")]
    is_unsorted = np.diff(t) <= 0.0
    if is_unsorted.any():
        k = int(is_unsorted.argmax())
        raise ConfigError(
            f"{where}, line {rows[k + 1][0]}: t = {float(t[k + 1])!r} does not come after "
            f"t = {float(t[k])!r} in line {rows[k][0]}; sort the rows by time and remove repetitions."
        )
    return {name: table[:, j].copy() for j, name in enumerate(header)}


def _check_header(where: str, header: list[str]) -> None:
    """Raise ConfigError unless the header in a line of a file names the columns of a scenario."""
    if len(header) == 1 and ";" in header[0]:
        raise ConfigError(f"{where}: the columns are separated by ';'; write ',' between them and '.' in numbers.")
    doubled = [name for name in header if header.count(name) > 1]
    if doubled:
        raise ConfigError(f"{where}: the column {doubled[0]!r} appears twice; remove one.")
    if "t" not in header and (_ROAD_COLUMNS & {name.lower() for name in header} or all(map(files.is_number, header))):
        raise ConfigError(
            f"{where}: the table holds points of a road, but a scenario needs the time t: to drive along the road, use "
            "RoadDrive(load_road(FILE), speed)."
        )
    for name in header:
        if name not in _ALL_COLUMNS:
            raise ConfigError(f"{where}: unknown column {name!r}. {did_you_mean(name, _ALL_COLUMNS)}")
    ways = [names for names in FRICTION_COLUMNS if set(names) & set(header)]
    if len(ways) > 1:
        raise ConfigError(
            f"{where}: the friction is given twice, by {ways[0][0]!r} and by {ways[1][0]!r}; keep one of them."
        )
    expected = ["t", "y_ref", "speed", *(ways or FRICTION_COLUMNS)[0], "wind_y"]
    missing = [name for name in expected if name not in header]
    if missing:
        raise ConfigError(f"{where}: column {missing[0]!r} is missing; the columns must be {', '.join(expected)}.")


def _number(where: str, name: str, cell: str) -> float:
    """Return the number in a cell of the column `name`, or raise ConfigError if the column cannot hold it."""
    number = files.finite_number(cell)
    if number is None:
        raise ConfigError(f"{where}: {name} = {cell!r} is not a finite number; correct it or remove the row.")
    if name == "speed" and number < 0.0:
        raise ConfigError(f"{where}: speed = {cell!r} must be >= 0 m/s.")
    if name.startswith("friction") and not 0.0 < number <= shapes.HIGHEST_FRICTION:
        raise ConfigError(f"{where}: {name} = {cell!r} must be a coefficient such as 0.8, > 0 and at most 3.")
    return number

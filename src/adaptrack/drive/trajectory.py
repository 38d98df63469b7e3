"""One closed-loop run, control period by control period, and its file (Parquet, with provenance)."""

from __future__ import annotations

import dataclasses
import json
import math
import os
import platform
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray

from adaptrack import __version__
from adaptrack.base.checked import Positive, checked
from adaptrack.base.errors import ConfigError, InvalidInput, MissingExtra
from adaptrack.base.files import (
    Damaged,
    ParquetColumn,
    check_texts,
    decode_parquet,
    encode_parquet,
    read_bytes,
    write_atomically,
)
from adaptrack.base.presentation import figure_of, html_of
from adaptrack.core.library import kernels_hash

if TYPE_CHECKING:
    from adaptrack.road import Road

Array = NDArray[Any]

TRAJECTORY_FORMAT = "adaptrack trajectory"
"""The word by which a Parquet file says that it holds a trajectory of ours."""

TRAJECTORY_FORMAT_VERSION = 2
"""Raised whenever a column is added, dropped, renamed or changes its unit."""

_WHEELS = ("front_left", "front_right", "rear_left", "rear_right")


@dataclass(frozen=True)
class StoredArray:
    """How one array of a trajectory is stored."""

    name: str
    """The attribute of `Trajectory`."""
    unit: str
    """SI; ``-`` for pure numbers."""
    kind: Literal["real", "whole", "truth"] = "real"
    """``float64``, ``int64`` or ``bool``."""
    parts: tuple[str, ...] = ()
    """For an array of shape (n, m): the m suffixes of its columns in a file."""

    @property
    def dtype(self) -> np.dtype:
        """The element type that a `Trajectory` holds and a file stores."""
        return np.dtype({"real": np.float64, "whole": np.int64, "truth": np.bool_}[self.kind])

    @property
    def stored_names(self) -> tuple[str, ...]:
        """The names of its columns in a file."""
        return tuple(f"{self.name}_{part}" for part in self.parts) or (self.name,)


TRAJECTORY_COLUMNS = (
    StoredArray("t", "s"),
    StoredArray("X", "m"),
    StoredArray("Y", "m"),
    StoredArray("psi", "rad"),
    StoredArray("vx", "m/s"),
    StoredArray("vy", "m/s"),
    StoredArray("yaw_rate", "rad/s"),
    StoredArray("steering", "rad"),
    StoredArray("command", "rad"),
    StoredArray("command_change", "rad"),
    StoredArray("y_ref", "m"),
    StoredArray("v_ref", "m/s"),
    StoredArray("friction", "-", parts=_WHEELS),
    StoredArray("wind", "m/s", parts=("x", "y")),
    StoredArray("lateral_acceleration", "m/s^2"),
    StoredArray("held", "-", "truth"),
    StoredArray("step_time", "s"),
)
"""The arrays that every `Trajectory` has, in the order of its fields and of a file's columns."""

_NAMED = ("tuning", "diagnostics", "road")


@checked
@dataclass(frozen=True, eq=False)
class Trajectory:
    """Signals at the n control instants t = k Ts, k = 0..n-1, of one run.

    ISO 8855: x forward, y left, yaw and steering positive to the left. Arrays are read-only views, float64 unless
    said otherwise. A run that failed may hold NaN from some step on.

    Raises
    ------
    InvalidInput
        When arrays differ in length or have a wrong shape or type, times are not one positive `period` apart, or `meta`
        cannot be written as JSON. The message names the array.
    """

    t: Array
    """(n,) s, since the start of the scenario."""
    X: Array
    """(n,) m, position of the centre of gravity in the world."""
    Y: Array
    """(n,) m, likewise; what the controller makes follow `y_ref`."""
    psi: Array
    """(n,) rad, heading, not wrapped."""
    vx: Array
    """(n,) m/s, forward velocity in the body frame."""
    vy: Array
    """(n,) m/s, leftward velocity in the body frame."""
    yaw_rate: Array
    """(n,) rad/s."""
    steering: Array
    """(n,) rad, angle that the road wheels have at t: the actuator's answer to earlier commands."""
    command: Array
    """(n,) rad, u(k): the angle that the controller asks for during the period that begins at t."""
    command_change: Array
    """(n,) rad, Δu(k) = u(k) − u(k−1)."""
    y_ref: Array
    """(n,) m, lateral reference at t."""
    v_ref: Array
    """(n,) m/s, speed reference at t."""
    friction: Array
    """(n, 4) front-left, front-right, rear-left, rear-right."""
    wind: Array
    """(n, 2) m/s, velocity of the air in the world: along +X, along +Y (the paper's v_w)."""
    lateral_acceleration: Array
    """(n,) m/s², at the centre of gravity, in the body frame."""
    held: Array
    """(n,) bool, whether a safe steering angle was held for want of a usable solution."""
    step_time: Array
    """(n,) s, wall-clock time of the control step; NaN when it was not measured."""
    period: Annotated[Positive, "s"]
    """The control period Ts."""
    tuning: Mapping[str, Array] = field(default_factory=dict)
    """Name -> (n,), each float64, int64 or bool: what the controller was tuned to at each instant.

    An MPC's: ``Np`` and ``Nc`` (int64, horizons in control periods), ``Q`` (1/m², weight of the tracking error) and
    ``R`` (1/rad², weight of the moves).
    """
    diagnostics: Mapping[str, Array] = field(default_factory=dict)
    """Name -> (n,), each float64, int64 or bool: what the controller says of each step.

    An MPC's: ``qp_status`` (int64, as `qp.QPStatus`: 0 solved, 1 capped, 2 infeasible, 3 not convex, 4 not finite),
    ``qp_iterations`` (int64, of the solver that gave the answer), ``qp_residual`` (largest KKT residual of the answer;
    NaN when there was none), ``at_limit`` (int64, sum of 1 (Δu), 2 (u) and 4 (y) for the limits that were active) and
    ``dead_reckoning`` (s, for which the estimator had taken in no position; 0 where one was).
    """
    road: Mapping[str, Array] = field(default_factory=dict)
    """Signals relative to a curved road, empty without one: ``station`` (m, arc length of the car's foot on the centre
    line, over all laps), ``offset`` (m, from the centre line, positive to the left), ``heading_error`` (rad in (−π, π],
    against the road) and ``curvature`` (1/m, of the road there)."""
    units: Mapping[str, str] = field(default_factory=dict)
    """The units of named arrays, such as ``{"tuning.Q": "1/m^2"}``; ``-`` where left out."""
    failed: str | None = None
    """Why the loop that drove it ended the run, by the name that `failure.Reason` gives it; None when it did not."""
    failed_at: float = math.nan
    """s, when it did; NaN when it did not."""
    meta: dict[str, Any] = field(default_factory=dict)
    """Provenance, see `provenance`; anything that JSON can hold."""

    def __post_init__(self) -> None:
        steps = np.size(self.t)
        if not steps:
            raise InvalidInput("trajectory: it must hold at least one control instant, `t` is empty.")
        for column in TRAJECTORY_COLUMNS:
            object.__setattr__(self, column.name, _checked(column, getattr(self, column.name), steps))
        if not (np.isfinite(self.t[0]) and np.allclose(np.diff(self.t), self.period, rtol=1e-6, atol=0.0)):
            raise InvalidInput(f"trajectory: the times `t` must be finite and one period ({self.period:g} s) apart.")
        for name in _NAMED:
            object.__setattr__(self, name, _storable_arrays(name, getattr(self, name), steps))
        object.__setattr__(self, "units", _units(self))
        if (self.failed is None) != math.isnan(self.failed_at):
            raise InvalidInput("trajectory: `failed` and `failed_at` go together: the reason and the time, or neither.")
        object.__setattr__(self, "failed", None if self.failed is None else str(self.failed))
        object.__setattr__(self, "failed_at", float(self.failed_at))
        object.__setattr__(self, "meta", _as_json(self.meta))

    def __len__(self) -> int:
        """The number n of control periods."""
        return int(self.t.size)

    def __repr__(self) -> str:
        title = ", ".join(filter(None, (self.name_of("scenario"), self.name_of("controller")))) or "no provenance"
        return f"<Trajectory of {len(self)} control periods of {self.period:g} s: {title}>"

    @property
    def duration(self) -> float:
        """s, n Ts: the time that the n control periods cover."""
        return len(self) * self.period

    @property
    def error(self) -> Array:
        """(n,) m, Y − y_ref, on a curved road offset − y_ref: positive when the vehicle is to the left."""
        return (self.road["offset"] if self.road else self.Y) - self.y_ref

    @property
    def reference_heading(self) -> Array:
        """(n,) rad, atan2(dy_ref/dt, v_x): the heading at which the reference is followed without sideslip.

        The derivative is by central differences over the samples. A vehicle that rolls backwards counts as standing.
        """
        if len(self) < 2:
            return np.zeros(len(self))
        return np.arctan2(np.gradient(self.y_ref, self.t), np.maximum(self.vx, 0.0))

    @property
    def heading_error(self) -> Array:
        """(n,) rad in (−π, π], ψ − `reference_heading`, on a curved road against the road and that: positive when the
        vehicle points to the left of its path.
        """
        difference = (self.road["heading_error"] if self.road else self.psi) - self.reference_heading
        return -np.remainder(np.pi - difference, 2.0 * np.pi) + np.pi

    def name_of(self, entry: str) -> str:
        """The name under which `meta` knows the ``"scenario"``, ``"plant"``, ...; empty when it says nothing."""
        value = self.meta.get(entry)
        if isinstance(value, dict):
            value = value.get("name")
        return "" if value is None else str(value)

    def between(self, start: float = 0.0, end: float = float("inf")) -> Self:
        """The control periods that begin at start <= t < end [s]; times keep their values.

        Raises
        ------
        InvalidInput
            When none does.
        """
        rounding = 1e-6 * self.period
        inside = (self.t >= start - rounding) & (self.t < end - rounding)
        if not inside.any():
            raise InvalidInput(
                f"trajectory: no control period begins in [{start:g}, {end:g}) s; "
                f"this one covers [{self.t[0]:g}, {self.t[-1] + self.period:g}) s."
            )
        changes: dict[str, Any] = {c.name: getattr(self, c.name)[inside] for c in TRAJECTORY_COLUMNS}
        changes |= {name: {k: values[inside] for k, values in getattr(self, name).items()} for name in _NAMED}
        if self.failed_at > changes["t"][-1] + self.period + rounding:  # not within this window
            changes |= {"failed": None, "failed_at": math.nan}
        return dataclasses.replace(self, **changes)

    def columns(self) -> dict[str, Array]:
        """The arrays by the names that they have in a file (``tuning.Np``), each of shape (n,)."""
        columns: dict[str, Array] = {}
        for column in TRAJECTORY_COLUMNS:
            values = getattr(self, column.name)
            columns |= dict(zip(column.stored_names, values.T if column.parts else (values,), strict=True))
        for name in _NAMED:
            columns |= {f"{name}.{key}": values for key, values in getattr(self, name).items()}
        return columns

    def to_pandas(self) -> Any:
        """`columns` as a pandas DataFrame, a row a control instant; units in its ``attrs["units"]``.

        Raises
        ------
        MissingExtra
            When pandas is not installed.
        """
        try:
            import pandas
        except ImportError:
            raise MissingExtra("Trajectory.to_pandas needs pandas: python -m pip install pandas") from None
        frame = pandas.DataFrame(self.columns())
        frame.attrs["units"] = self._column_units()
        return frame

    def plot(self, road: Road | None = None) -> Any:
        """The run as a matplotlib figure (``.savefig("run.png")``): signals over time; along a road where one is given.

        With a road: from above, the driven line coloured by the offset, and offset, steering and speed along it.

        Raises
        ------
        InvalidInput
            When fewer than two instants lie beside the road.
        """
        return figure_of(self, road)

    def _repr_html_(self) -> str:
        """The run in a notebook: its measures and its picture."""
        return html_of(self)

    def _column_units(self) -> dict[str, str]:
        """The unit of each of `columns`."""
        return {name: column.unit for column in TRAJECTORY_COLUMNS for name in column.stored_names} | dict(self.units)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the trajectory as Parquet: the file appears whole or not at all.

        Raises
        ------
        StorageError
            When that fails; an older file at `path` is then untouched.
        """
        units = self._column_units()
        stored = [ParquetColumn(name, units[name], values) for name, values in self.columns().items()]
        metadata = {
            "adaptrack": __version__,
            "period": self.period,
            "units": dict(self.units),
            "failed": self.failed,
            "failed_at": None if self.failed is None else self.failed_at,
            "meta": self.meta,
        }
        write_atomically(path, encode_parquet(TRAJECTORY_FORMAT, TRAJECTORY_FORMAT_VERSION, stored, metadata))

    @classmethod
    @checked
    def load(cls, path: str | os.PathLike[str]) -> Self:
        """Read what `save` wrote, bit for bit.

        Raises
        ------
        StorageError
            When the file is missing, damaged, not a trajectory, or of another format version; the message says which.
        """
        required = [name for column in TRAJECTORY_COLUMNS for name in column.stored_names]
        remedy = "run the simulation again or use the release that wrote it"
        columns, metadata = decode_parquet(
            read_bytes(path), path, TRAJECTORY_FORMAT, TRAJECTORY_FORMAT_VERSION, remedy, required
        )
        try:
            fields: dict[str, Any] = {
                c.name: _joined([columns.pop(name) for name in c.stored_names]) for c in TRAJECTORY_COLUMNS
            }
            fields |= {name: {} for name in _NAMED}
            for stored, values in columns.items():
                name, _, key = stored.partition(".")
                fields[name][key] = values
            fields |= metadata | {"failed_at": math.nan if metadata["failed_at"] is None else metadata["failed_at"]}
            del fields["adaptrack"]
            return cls(**fields)
        except (KeyError, TypeError, ValueError, AttributeError) as error:  # InvalidInput is a ValueError
            raise Damaged(f"{os.fspath(path)}: damaged, or edited by another program: {error}") from error


@dataclass(frozen=True)
class Origin:
    """Scenario, plant and controller of a run: a name each, or a table with ``name`` and the parameters in use."""

    scenario: Any
    plant: Any
    tyre: Any
    vehicle: Any
    profile: str
    seed: int | None
    """of the sensor noise"""
    preview: bool
    """whether the controller knew the reference ahead"""
    controller: Any
    tuning: Any


def provenance(origin: Origin, created: str | datetime, **entries: Any) -> dict[str, Any]:
    """Return the provenance of a result for the `meta` of a `Trajectory`: its origin and the software versions.

    `created` is the caller's clock, so that nothing here depends on the time of day. `more` adds entries (``moves``,
    ``qp_solver``, ``command``, ...).
    """
    return {
        **vars(origin),
        **entries,
        "versions": {
            "adaptrack": __version__,
            "python": platform.python_version(),
            "numpy": np.__version__,
            "kernels": kernels_hash(),
        },
        "created": created.isoformat() if isinstance(created, datetime) else created,
    }


def _checked(column: StoredArray, values: Any, steps: int) -> Array:
    """`values` as a read-only array of the column's type and shape."""
    shape = (steps, len(column.parts)) if column.parts else (steps,)
    array = np.asarray(values)
    if array.shape != shape:
        raise InvalidInput(
            f"trajectory: `{column.name}` must have the shape {shape}, one row per time in `t`; it has {array.shape}."
        )
    if not np.can_cast(array.dtype, column.dtype, casting="safe"):
        with np.errstate(invalid="ignore"):
            exact = array.dtype.kind in "biuf" and np.array_equal(array.astype(column.dtype), array)
        if not exact:
            raise InvalidInput(f"trajectory: `{column.name}` must hold {column.dtype} values, it holds {array.dtype}.")
    view = np.ascontiguousarray(array, dtype=column.dtype).view()
    view.flags.writeable = False
    return view


def _storable_arrays(group: str, groups: Mapping[str, Any], steps: int) -> Mapping[str, Array]:
    """Arrays by name, each of one of the types that a file stores."""
    kinds: dict[str, Literal["real", "whole", "truth"]] = {"f": "real", "i": "whole", "u": "whole", "b": "truth"}
    arrays = {}
    for name, values in groups.items():
        if not re.fullmatch(r"[A-Za-z]\w*", name, re.ASCII):
            raise InvalidInput(f"trajectory: {group}: {name!r} must be a name of letters, digits and _.")
        kind = kinds.get(np.asarray(values).dtype.kind)
        if kind is None:
            raise InvalidInput(f"trajectory: `{group}[{name!r}]` must hold numbers or truth values.")
        arrays[name] = _checked(StoredArray(f"{group}[{name!r}]", "-", kind), values, steps)
    return arrays


def _units(run: Trajectory) -> Mapping[str, str]:
    """The unit of each named array, by the name that it has in a file."""
    names = [f"{group}.{name}" for group in _NAMED for name in getattr(run, group)]
    unknown = sorted(set(run.units) - set(names))
    if unknown:
        raise InvalidInput(f"trajectory: `units` names {unknown[0]!r}, which this run does not hold.")
    return {name: str(run.units.get(name, "-")) for name in names}


def _as_json(meta: Mapping[str, Any]) -> dict[str, Any]:
    """`meta` as JSON would give it back, so that a saved and a loaded trajectory hold the same."""
    for key, value in meta.items():
        try:
            json.dumps(value)
        except (TypeError, ValueError, RecursionError) as error:
            raise InvalidInput(f"trajectory: `meta[{key!r}]` cannot be written as JSON: {error}.") from None
    try:
        check_texts("trajectory: `meta`", meta)
    except ConfigError as error:
        raise InvalidInput(str(error)) from None
    return json.loads(json.dumps(dict(meta)))


def _joined(columns: list[Array]) -> Array:
    return np.stack(columns, axis=1) if len(columns) > 1 else columns[0]

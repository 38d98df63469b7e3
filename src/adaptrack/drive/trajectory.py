"""Signals of one closed-loop run at its control instants, and their Parquet file with provenance."""

from __future__ import annotations

import dataclasses
import json
import math
import os
import platform
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from datetime import datetime
from typing import TYPE_CHECKING, Annotated, Any, Self, get_type_hints

import numpy as np
from numpy.typing import NDArray

from adaptrack import __version__
from adaptrack.base import files
from adaptrack.base.checked import Positive, checked
from adaptrack.base.errors import ConfigError, InvalidInput, MissingExtra
from adaptrack.base.presentation import figure_of, html_of
from adaptrack.core.library import kernels_hash
from adaptrack.core.maths import portable

if TYPE_CHECKING:
    from adaptrack.road import Road

Array = NDArray[Any]

TRAJECTORY_FORMAT = "adaptrack trajectory"
"""Metadata entry that marks a Parquet file as a trajectory of adaptrack."""

TRAJECTORY_FORMAT_VERSION = 2
"""Version of the file format; it increases when a column is added, removed or renamed, or changes its unit."""

_REAL, _WHOLE, _TRUTH = np.dtype(np.float64), np.dtype(np.int64), np.dtype(np.bool_)
_WHEELS = ("front_left", "front_right", "rear_left", "rear_right")


@dataclass(frozen=True)
class StoredArray:
    """Storage of one array of a trajectory."""

    unit: str
    """SI unit; ``-`` for dimensionless quantities."""
    dtype: np.dtype = _REAL
    """Element type: ``float64``, ``int64`` or ``bool``."""
    parts: tuple[str, ...] = ()
    """Suffixes of the m columns in a file, for an array (n, m)."""
    name: str = ""
    """The attribute of `Trajectory`."""

    @property
    def stored_names(self) -> tuple[str, ...]:
        """Names of the columns in a file."""
        return tuple(f"{self.name}_{part}" for part in self.parts) or (self.name,)


_ARRAY_GROUPS = ("tuning", "diagnostics", "road")


@checked
@dataclass(frozen=True, eq=False)
class Trajectory:
    """Signals of one run at the n control instants t = k Ts, k = 0..n-1.

    Signs are those of ISO 8855: x forward, y left, yaw and steering positive to the left. Arrays are read-only and
    float64 unless a field states another type. After a failure, the remaining samples may be NaN.

    Raises
    ------
    InvalidInput
        When arrays differ in length or have a wrong shape or type, times are not one positive `period` apart, or `meta`
        cannot be written as JSON. The message names the array.
    """

    t: Annotated[Array, StoredArray("s")]
    """Time since the start of the scenario (s), (n,)."""
    X: Annotated[Array, StoredArray("m")]
    """World x coordinate of the centre of gravity (m), (n,)."""
    Y: Annotated[Array, StoredArray("m")]
    """World y coordinate of the centre of gravity (m), (n,)."""
    psi: Annotated[Array, StoredArray("rad")]
    """Yaw angle, not wrapped (rad), (n,)."""
    vx: Annotated[Array, StoredArray("m/s")]
    """Longitudinal velocity in the body frame (m/s), (n,)."""
    vy: Annotated[Array, StoredArray("m/s")]
    """Lateral velocity in the body frame, positive to the left (m/s), (n,)."""
    yaw_rate: Annotated[Array, StoredArray("rad/s")]
    """Yaw rate (rad/s), (n,)."""
    steering: Annotated[Array, StoredArray("rad")]
    """Angle of the road wheels at t, after the steering actuator (rad), (n,)."""
    command: Annotated[Array, StoredArray("rad")]
    """Steering command u(k): requested road-wheel angle for the period that begins at t (rad), (n,)."""
    command_change: Annotated[Array, StoredArray("rad")]
    """Change of the command Δu(k) = u(k) − u(k−1) (rad), (n,)."""
    y_ref: Annotated[Array, StoredArray("m")]
    """Lateral reference: world y coordinate to follow, or offset from the road to follow (m), (n,)."""
    v_ref: Annotated[Array, StoredArray("m/s")]
    """Speed reference at its time (m/s), (n,); a driver on a road follows ``road["planned_speed"]``."""
    friction: Annotated[Array, StoredArray("-", parts=_WHEELS)]
    """Friction coefficients of front-left, front-right, rear-left and rear-right wheel, (n, 4)."""
    wind: Annotated[Array, StoredArray("m/s", parts=("x", "y"))]
    """Wind velocity along world X and Y (m/s), (n, 2)."""
    lateral_acceleration: Annotated[Array, StoredArray("m/s^2")]
    """Lateral acceleration of the centre of gravity in the body frame (m/s²), (n,)."""
    held: Annotated[Array, StoredArray("-", _TRUTH)]
    """Whether the controller had no usable solution and kept a safe steering angle, bool (n,)."""
    step_time: Annotated[Array, StoredArray("s")]
    """Computation time of the control step (s), (n,); NaN if not measured."""
    period: Annotated[Positive, "s"]
    """Control period Ts (s)."""
    tuning: Mapping[str, Array] = field(default_factory=dict)
    """Tuning of the controller at each instant by name; arrays (n,) of float64, int64 or bool.

    An MPC has ``Np`` and ``Nc`` (int64, horizons in control periods), ``Q`` (1/m², weight of the tracking error) and
    ``R`` (1/rad², weight of the moves).
    """
    diagnostics: Mapping[str, Array] = field(default_factory=dict)
    """Diagnostics of the control steps by name; arrays (n,) of float64, int64 or bool.

    An MPC has:

    - ``qp_status``, int64 as in `qp.QPStatus`: 0 solved, 1 stopped at the iteration limit, 2 infeasible, 3 not convex,
      4 not finite;
    - ``qp_iterations``, int64: number of iterations of the QP solver;
    - ``qp_residual``: largest KKT residual of the solution, NaN without a solution;
    - ``at_limit``, int64: sum of 1 (Δu), 2 (u) and 4 (y) for the active limits;
    - ``dead_reckoning``: time since the last position measurement (s), 0 at instants with a measurement.

    A drive with a speed controller has:

    - ``requested_acceleration`` (m/s²) and ``requested_force`` (N at the wheels, positive forward, less what holds the
      car at rest), ``longitudinal_acceleration`` (m/s²) of the car;
    - ``target_speed`` where the request acts, ``governed_speed`` of the car's cell of the path (m/s);
    - ``grip_used``, ``friction_low``, ``friction_high``, ``friction_age``: as in `SpeedCommand`;
    - ``speed_state``, ``limited_by``: places in `SpeedState` and `SpeedLimit`, from 0.
    """
    road: Mapping[str, Array] = field(default_factory=dict)
    """Signals relative to the centre line of a road, arrays (n,) by name; empty for a scenario without a road.

    - ``station``: arc length of the point nearest to the car, over all laps (m);
    - ``offset``: offset of the car, positive to the left (m);
    - ``heading_error``: yaw relative to the road, in (−π, π] (rad);
    - ``curvature``: curvature of the road at the nearest point (1/m);
    - ``planned_speed``: speed planned for the nearest point (m/s).
    """
    units: Mapping[str, str] = field(default_factory=dict)
    """Units of the arrays in `tuning`, `diagnostics` and `road` by name, such as ``{"tuning.Q": "1/m^2"}``."""
    failed: str | None = None
    """Reason why the simulation ended the run early (`failure.Reason`); None for a complete run."""
    failed_at: float = math.nan
    """Time at which the simulation ended the run (s); NaN for a complete run."""
    meta: dict[str, Any] = field(default_factory=dict)
    """Provenance (see `provenance`), as values that JSON can represent."""

    def __post_init__(self) -> None:
        steps = np.size(self.t)
        if not steps:
            raise InvalidInput("trajectory: it must hold at least one control instant, `t` is empty.")
        for column in TRAJECTORY_COLUMNS:
            object.__setattr__(self, column.name, _checked(column, getattr(self, column.name), steps))
        if not (np.isfinite(self.t[0]) and np.allclose(np.diff(self.t), self.period, rtol=1e-6, atol=0.0)):
            raise InvalidInput(f"trajectory: the times `t` must be finite and one period ({self.period:g} s) apart.")
        for name in _ARRAY_GROUPS:
            object.__setattr__(self, name, _storable_arrays(name, getattr(self, name), steps))
        object.__setattr__(self, "units", _units(self))
        if (self.failed is None) != math.isnan(self.failed_at):
            raise InvalidInput("trajectory: `failed` and `failed_at` go together: the reason and the time, or neither.")
        object.__setattr__(self, "failed", None if self.failed is None else str(self.failed))
        object.__setattr__(self, "failed_at", float(self.failed_at))
        object.__setattr__(self, "meta", _as_json(self.meta))

    def __len__(self) -> int:
        """Number n of control periods."""
        return int(self.t.size)

    def __repr__(self) -> str:
        title = ", ".join(filter(None, (self.name_of("scenario"), self.name_of("controller")))) or "no provenance"
        return f"<Trajectory of {len(self)} control periods of {self.period:g} s: {title}>"

    @property
    def duration(self) -> float:
        """Duration n Ts of the run (s)."""
        return len(self) * self.period

    @property
    def error(self) -> Array:
        """Lateral error (m), (n,): Y − y_ref, or offset − y_ref on a road; positive to the left of the reference."""
        return (self.road["offset"] if self.road else self.Y) - self.y_ref

    @property
    def reference_heading(self) -> Array:
        """Heading of the reference, atan2(dy_ref/dt, v_x) (rad), (n,).

        The derivative is computed by central differences. Negative speeds are replaced by 0.
        """
        if len(self) < 2:
            return np.zeros(len(self))
        return portable.atan2(np.gradient(self.y_ref, self.t), np.maximum(self.vx, 0.0))

    @property
    def heading_error(self) -> Array:
        """Heading error in (−π, π], positive if the car points to the left of the reference (rad), (n,).

        It is the yaw angle, on a road the yaw angle relative to the road, minus `reference_heading`.
        """
        difference = (self.road["heading_error"] if self.road else self.psi) - self.reference_heading
        return -np.remainder(np.pi - difference, 2.0 * np.pi) + np.pi

    def name_of(self, entry: str) -> str:
        """Return the name of an entry of `meta` such as ``"scenario"`` or ``"plant"``; empty if it is missing."""
        value = self.meta.get(entry)
        if isinstance(value, dict):
            value = value.get("name")
        return "" if value is None else str(value)

    def between(self, start: float = 0.0, end: float = float("inf")) -> Self:
        """Return the part of the run with start <= t < end (s); its times keep their values.

        Raises
        ------
        InvalidInput
            When no control instant lies in the interval.
        """
        rounding = 1e-6 * self.period
        inside = (self.t >= start - rounding) & (self.t < end - rounding)
        if not inside.any():
            raise InvalidInput(
                f"trajectory: no control period begins in [{start:g}, {end:g}) s; "
                f"this one covers [{self.t[0]:g}, {self.t[-1] + self.period:g}) s."
            )
        changes: dict[str, Any] = {c.name: getattr(self, c.name)[inside] for c in TRAJECTORY_COLUMNS}
        changes |= {name: {k: values[inside] for k, values in getattr(self, name).items()} for name in _ARRAY_GROUPS}
        if self.failed_at > changes["t"][-1] + self.period + rounding:  # not within this window
            changes |= {"failed": None, "failed_at": math.nan}
        return dataclasses.replace(self, **changes)

    def columns(self) -> dict[str, Array]:
        """Return all columns (n,) by their names in a file, such as ``tuning.Np``."""
        columns: dict[str, Array] = {}
        for column in TRAJECTORY_COLUMNS:
            values = getattr(self, column.name)
            columns |= dict(zip(column.stored_names, values.T if column.parts else (values,), strict=True))
        for name in _ARRAY_GROUPS:
            columns |= {f"{name}.{key}": values for key, values in getattr(self, name).items()}
        return columns

    def to_pandas(self) -> Any:
        """Return `columns` as a pandas DataFrame with a row per control instant; ``attrs["units"]`` has the units.

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
        """Draw the run as a matplotlib figure, which ``.savefig("run.png")`` saves.

        Parameters
        ----------
        road
            Road of the drive. With a road, the figure shows the driven line from above, coloured by the offset, and the
            offset, steering and speed along the road. Without a road, it shows the signals over time.

        Raises
        ------
        InvalidInput
            When fewer than two instants have a position along the road.
        """
        return figure_of(self, road)

    def _repr_html_(self) -> str:
        """Return measures and picture of the run for a notebook."""
        return html_of(self)

    def _column_units(self) -> dict[str, str]:
        """Return the unit of each entry of `columns`."""
        return {name: column.unit for column in TRAJECTORY_COLUMNS for name in column.stored_names} | dict(self.units)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the trajectory to a Parquet file.

        Raises
        ------
        StorageError
            When the file cannot be written; an existing file stays unchanged.
        """
        units = self._column_units()
        stored = [files.ParquetColumn(name, units[name], values) for name, values in self.columns().items()]
        metadata = {
            "adaptrack": __version__,
            "period": self.period,
            "units": dict(self.units),
            "failed": self.failed,
            "failed_at": None if self.failed is None else self.failed_at,
            "meta": self.meta,
        }
        files.write_atomically(
            path, files.encode_parquet(TRAJECTORY_FORMAT, TRAJECTORY_FORMAT_VERSION, stored, metadata)
        )

    @classmethod
    @checked
    def load(cls, path: str | os.PathLike[str]) -> Self:
        """Read a trajectory from a file that `save` wrote; all values are identical.

        Raises
        ------
        StorageError
            When the file is missing, damaged, not a trajectory, or has a different format version.
        """
        required = [name for column in TRAJECTORY_COLUMNS for name in column.stored_names]
        remedy = "run the simulation again or use the release that wrote it"
        columns, metadata = files.decode_parquet(
            files.read_bytes(path, 8 * files.MAX_NUMBERS),
            path,
            TRAJECTORY_FORMAT,
            TRAJECTORY_FORMAT_VERSION,
            remedy,
            required,
        )
        try:
            fields: dict[str, Any] = {
                c.name: _joined([columns.pop(name) for name in c.stored_names]) for c in TRAJECTORY_COLUMNS
            }
            fields |= {name: {} for name in _ARRAY_GROUPS}
            for stored, values in columns.items():
                name, _, key = stored.partition(".")
                fields[name][key] = values
            fields |= metadata | {"failed_at": math.nan if metadata["failed_at"] is None else metadata["failed_at"]}
            del fields["adaptrack"]
            return cls(**fields)
        except (KeyError, TypeError, ValueError, AttributeError) as error:  # InvalidInput is a ValueError
            raise files.Damaged(f"{os.fspath(path)}: damaged, or edited by another program: {error}") from error


TRAJECTORY_COLUMNS = tuple(
    replace(mark, name=name)
    for name, hint in get_type_hints(Trajectory, include_extras=True).items()
    for mark in getattr(hint, "__metadata__", ())
    if isinstance(mark, StoredArray)
)
"""Arrays of every `Trajectory`, in the order of its fields and of the columns in a file."""


def provenance(created: str | datetime, **entries: Any) -> dict[str, Any]:
    """Return the provenance of a result for the `meta` of a `Trajectory`: its entries and the software versions.

    created: time of creation; an argument, so that the result does not depend on the system clock. entries: scenario,
    plant and controller of the run, each a name or a table with ``name`` and the parameters in use, and further
    entries, such as ``seed``, ``moves``, ``qp_solver`` or ``command``.
    """
    return {
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
    """Convert `values` to a read-only array with the type and shape of the column, or raise InvalidInput."""
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


def _storable_arrays(group: str, group_arrays: Mapping[str, Any], steps: int) -> Mapping[str, Array]:
    """Convert arrays by name to the types that a file can store, or raise InvalidInput."""
    dtypes, arrays = {"f": _REAL, "i": _WHOLE, "u": _WHOLE, "b": _TRUTH}, {}
    for name, values in group_arrays.items():
        if not re.fullmatch(r"[A-Za-z]\w*", name, re.ASCII):
            raise InvalidInput(f"trajectory: {group}: {name!r} must be a name of letters, digits and _.")
        dtype = dtypes.get(np.asarray(values).dtype.kind)
        if dtype is None:
            raise InvalidInput(f"trajectory: `{group}[{name!r}]` must hold numbers or truth values.")
        arrays[name] = _checked(StoredArray("-", dtype, name=f"{group}[{name!r}]"), values, steps)
    return arrays


def _units(run: Trajectory) -> Mapping[str, str]:
    """Return the unit of each array in `tuning`, `diagnostics` and `road` by its name in a file."""
    names = [f"{group}.{name}" for group in _ARRAY_GROUPS for name in getattr(run, group)]
    unknown = sorted(set(run.units) - set(names))
    if unknown:
        raise InvalidInput(f"trajectory: `units` names {unknown[0]!r}, which this run does not hold.")
    return {name: str(run.units.get(name, "-")) for name in names}


def _as_json(meta: Mapping[str, Any]) -> dict[str, Any]:
    """Convert `meta` to JSON and back, so that it equals the `meta` of a saved and loaded trajectory."""
    for key, value in meta.items():
        try:
            json.dumps(value)
        except (TypeError, ValueError, RecursionError) as error:
            raise InvalidInput(f"trajectory: `meta[{key!r}]` cannot be written as JSON: {error}.") from None
    try:
        files.check_texts("trajectory: `meta`", meta)
    except ConfigError as error:
        raise InvalidInput(str(error)) from None
    return json.loads(json.dumps(dict(meta)))


def _joined(columns: list[Array]) -> Array:
    return np.stack(columns, axis=1) if len(columns) > 1 else columns[0]

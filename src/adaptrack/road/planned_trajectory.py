"""Trajectories of planners: where a car is to be at which time; from arrays, files, ROS messages and CommonRoad."""

from __future__ import annotations

import operator
import os
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from adaptrack.base.checked import Finite, Positive, checked, reals
from adaptrack.base.errors import ConfigError, InvalidInput, did_you_mean
from adaptrack.base.files import finite_number, printable, read_bytes, table_lines
from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import Array
from adaptrack.core.planned import condition as kernel
from adaptrack.core.planned.records import NODE, POINT
from adaptrack.road.points import POINT_COLUMNS, bracketed_unit, plain_title, split_cells, split_header

PLANNED_COLUMNS = {
    "t": (("s",), ("t", "time", "t_s", "time_s", "time_from_start", "timestamp")),
    "x": (("m",), POINT_COLUMNS["x"]),
    "y": (("m",), POINT_COLUMNS["y"]),
    "yaw": (("rad",), ("yaw", "yaw_rad", "psi", "psi_rad", "heading", "heading_rad", "theta", "orientation")),
    "speed": (("m/s", "mps"), ("speed", "speed_mps", "v", "v_mps", "vx", "vx_mps", "velocity", "longitudinal_velocity",
                               "longitudinal_velocity_mps")),
    "acceleration": (("m/s^2", "m/s2", "mps2"), ("acceleration", "acceleration_mps2", "a", "ax", "ax_mps2",
                                                 "longitudinal_acceleration")),
    "curvature": (("1/m", "rad/m"), ("curvature", "kappa", "kappa_radpm")),
}  # fmt: skip
"""Spellings of the unit of each column of a file, and of its name. Columns of other names are left out."""
_REFUSALS = {
    kernel.BAD_NUMBER: "entry {k}: t = {t:g} s, x = {x:g} m, y = {y:g} m: must be finite, x and y within 1e8 m.",
    kernel.FALLING_TIME: "entry {k}: t = {t:g} s comes before that of the entry above: give times that never fall.",
    kernel.PLACE_JUMP: "entry {k}: the place jumps to x = {x:g} m, y = {y:g} m at t = {t:g} s: "
    "correct x, y (m) and t (s), or begin a new trajectory there.",
    kernel.WRONG_YAW: "entry {k}: yaw = {yaw:g} rad is more than 15 degrees off the direction of motion: give rad, "
    "0 along x and positive to the left, or None.",
    kernel.WRONG_SPEED: "entry {k}: from t = {t:g} s on, the speeds contradict the places and times: give speeds in "
    "m/s, or None to take them from the times.",
}


class PlannedState(NamedTuple):
    """Planned place (x, y in m) of the tracked point, and its speed (m/s): arrays of the shape of the times."""

    x: Array
    y: Array
    speed: Array


@checked
@dataclass(frozen=True, eq=False, repr=False)
class PlannedTrajectory:
    """A trajectory of a planner: places of the tracked point at times, and what else the planner states.

    Values that are all 0 or NaN count as unknown; so does NaN within others. Points within
    `adaptrack.core.planned.condition.MERGING_DISTANCE` are one place, with a time at rest if the car stays. All points
    in one place: the car stands. No points: the planner is silent. Unknown speeds follow from the times.

    Raises
    ------
    InvalidInput
        When lengths differ, a time or place is not finite, a time falls, the place jumps, the yaw is more than 15
        degrees off the direction of motion, or the speeds contradict the times; the message names the entry.
    """

    t: ArrayLike
    """(n,) s, after the stamp"""
    x: ArrayLike
    """(n,) m"""
    y: ArrayLike
    """(n,) m"""
    yaw: ArrayLike | None = None
    """(n,) rad, of the car"""
    speed: ArrayLike | None = None
    """(n,) m/s, along the car; the trajectory ends where it becomes negative"""
    acceleration: ArrayLike | None = None
    """(n,) m/s^2"""
    curvature: ArrayLike | None = None
    """(n,) 1/m, positive to the left"""
    stamp: Annotated[Finite, "s"] = 0.0
    """s, on the clock of the planner; 0: the time of arrival"""
    urgent: bool = False
    """whether it replaces the trajectory before at once, without a transition"""
    points: Array = field(init=False)
    """(n, 7) columns `adaptrack.core.planned.records.POINT`, NaN where a value is unknown"""
    nodes: Array = field(init=False)
    """(m, 5) columns `adaptrack.core.planned.records.NODE`: places with times and speeds, up to the first reversal"""
    reverse_ahead: bool = field(init=False)
    """whether the trajectory goes on backwards, which is not driven: the car stops there"""

    def __post_init__(self) -> None:
        columns: list[Array] = []
        for name in POINT._fields:
            values, is_optional = getattr(self, name), name not in ("t", "x", "y")
            is_missing = values is None and is_optional
            column = None if is_missing else np.array(reals(f"PlannedTrajectory: {name}", values))
            columns.append(np.full(columns[0].shape, np.nan) if column is None else column)
            if columns[-1].ndim != 1 or columns[-1].shape != columns[0].shape:
                raise InvalidInput(
                    f"PlannedTrajectory: {name} has shape {columns[-1].shape}, t {columns[0].shape}: give lists of one "
                    "length."
                )
            object.__setattr__(self, name, column)
        points = np.stack(columns, axis=-1)
        nodes = np.empty((2 * len(points) + 2, len(NODE)))
        status, entry, count = kernel.condition(points, 0.0, 0.0, nodes)
        if status in _REFUSALS:
            values = dict(zip(POINT._fields, points[entry].tolist(), strict=True))
            raise InvalidInput(f"PlannedTrajectory: {_REFUSALS[status].format(k=entry, **values)}")
        object.__setattr__(self, "points", points)
        object.__setattr__(self, "nodes", nodes[:count].copy())
        object.__setattr__(self, "reverse_ahead", status == kernel.REVERSE_AHEAD)

    def __repr__(self) -> str:
        if not len(self.nodes):
            return "<PlannedTrajectory: no points>"
        way = float(portable.hypot(*np.diff(self.nodes[:, :2], axis=0).T).sum())
        ahead = ", reverse ahead" if self.reverse_ahead else ""
        end = f"{self.nodes[0, NODE.speed]:.3g} to {self.nodes[-1, NODE.speed]:.3g} m/s"
        return f"<PlannedTrajectory: {len(self.points)} points, {self.duration:.3g} s, {way:.3g} m, {end}{ahead}>"

    @property
    def duration(self) -> float:
        """From the first to the last time, s."""
        times = self.points[:, POINT.t]
        return float(times[-1] - times[0]) if times.size else 0.0

    def at(self, t: ArrayLike) -> PlannedState:
        """Return the planned place and speed at times (s, after the stamp); beyond the ends those of the ends.

        Between two nodes the place is on a straight line. Without points all are NaN.
        """
        times = reals("PlannedTrajectory.at: t", t)
        if not len(self.nodes):
            return PlannedState(*np.full((3, *times.shape), np.nan))
        knots = self.nodes[:, [NODE.arrive, NODE.leave]].ravel()
        x, y, speed = (np.interp(times, knots, self.nodes[:, k].repeat(2)) for k in (NODE.x, NODE.y, NODE.speed))
        return PlannedState(x, y, speed)

    # ---- from files and messages
    @classmethod
    @checked
    def from_csv(
        cls, path: str | os.PathLike[str], *, stamp: Annotated[Finite, "s"] = 0.0, urgent: bool = False
    ) -> PlannedTrajectory:
        """Read a CSV file with the columns t (s), x, y (m) and optionally others of `PLANNED_COLUMNS`.

        Cells are separated as in files of roads (`adaptrack.road.points.read_points`). Units may stand in brackets
        behind the names. An empty cell is an unknown value.

        Raises
        ------
        StorageError
            When the file cannot be read.
        ConfigError
            When it is no trajectory; the message names the line or the entry, and the remedy.
        """
        where = os.fspath(path)
        header, rows = split_header(where, *table_lines(where, read_bytes(path), "strict"))
        places = _places_of_columns(header.where, header.titles)
        columns: dict[str, list[float]] = {name: [] for name in places}
        for line, text in rows:
            cells = split_cells(text)
            for name, place in places.items():
                cell = cells[place].replace(",", ".") if place < len(cells) else ""
                number = finite_number(cell)
                if number is None and (name in ("t", "x", "y") or cell.lower() not in ("", "nan")):
                    raise ConfigError(f"{where}, line {line}: {name} = {printable(cell)!r}: must be a finite number.")
                columns[name].append(np.nan if number is None else number)
        try:
            return cls(**columns, stamp=stamp, urgent=urgent)
        except InvalidInput as error:
            raise ConfigError(f"{where}: {error}") from None

    @classmethod
    def from_message(cls, message: Any, *, urgent: bool = False) -> PlannedTrajectory:
        """Convert a message of ROS 2, or any object with its attributes; ROS need not be installed.

        Messages are `autoware_planning_msgs/Trajectory`, with times after the header's stamp, and `nav_msgs/Trajectory`
        and `nav_msgs/Path`, with a stamp for each point.

        Raises
        ------
        InvalidInput
            When it has neither points nor poses, all times are the same, or it is no trajectory.
        """
        points = getattr(message, "points", getattr(message, "poses", None))
        if points is None:
            raise InvalidInput("from_message: the message has neither points nor poses: give a Trajectory or a Path.")
        stamp = _nanoseconds(message.header.stamp)
        if points and not hasattr(points[0], "time_from_start"):
            origin = stamp or _nanoseconds(points[0].header.stamp)
            times = [_nanoseconds(point.header.stamp) - origin for point in points]
        else:
            origin, times = stamp, [_nanoseconds(point.time_from_start) for point in points]
        if len(points) > 1 and len(set(times)) == 1:
            raise InvalidInput(
                "from_message: all points have the same time: give each a time_from_start or a stamp; a line without "
                "times is a path: Tracker.follow(path, plan)."
            )
        rows = [
            (
                1e-9 * time,
                point.pose.position.x,
                point.pose.position.y,
                _yaw_of(point.pose.orientation),
                _value(point, "longitudinal_velocity_mps", "velocity.linear.x"),
                _value(point, "acceleration_mps2", "acceleration.linear.x"),
            )
            for time, point in zip(times, points, strict=True)
        ]
        return cls(**_columns(rows), stamp=1e-9 * origin, urgent=urgent)

    @classmethod
    @checked
    def from_states(
        cls,
        states: Iterable[Any],
        time_step: Annotated[Positive, "s"],
        *,
        stamp: Annotated[Finite, "s"] = 0.0,
        urgent: bool = False,
    ) -> PlannedTrajectory:
        """Convert states of CommonRoad, or any objects with these attributes.

        They are `time_step`, a whole number, `position`, and optionally `orientation`, `velocity` and `acceleration`.

        Parameters
        ----------
        states
            A list, or a trajectory of CommonRoad with its `state_list`.
        time_step
            Duration of a time step (``dt`` of a CommonRoad scenario), s. Step 0 is the time of the stamp.
        """
        rows = [
            (time_step * state.time_step, *state.position[:2],
             *(_value(state, name) for name in ("orientation", "velocity", "acceleration")))
            for state in getattr(states, "state_list", states)
        ]  # fmt: skip
        return cls(**_columns(rows), stamp=stamp, urgent=urgent)


def _places_of_columns(where: str, titles: list[str]) -> dict[str, int]:
    """The place of each quantity's column; refuses files without t, x or y, doubled columns and other units."""
    places: dict[str, int] = {}
    for name, (units, names) in PLANNED_COLUMNS.items():
        matches = [k for k, title in enumerate(titles) if plain_title(title) in names]
        if len(matches) > 1 or (not matches and name in ("t", "x", "y")):
            hint = "there are two of them." if matches else did_you_mean(name, titles)
            raise ConfigError(f"{where}: the header must name one column {name!r} ({units[0]}): {hint}")
        for k in matches:
            places[name] = k
            if bracketed_unit(titles[k]) not in ("", *units):
                raise ConfigError(f"{where}: column {printable(titles[k])!r}: must be in {units[0]}; convert it.")
    return places


def _columns(rows: list[tuple[Any, ...]]) -> dict[str, Any]:
    """Rows of t, x, y, yaw, speed, acceleration as arrays by name."""
    return dict(zip(POINT._fields, np.array(rows, dtype=np.float64).reshape(-1, 6).T, strict=False))


def _nanoseconds(time: Any) -> int:
    """A `builtin_interfaces/Time` or `Duration`, ns."""
    return int(time.sec) * 10**9 + int(time.nanosec)


def _yaw_of(q: Any) -> float:
    """Yaw (rad) of a quaternion; NaN if it is 0, which states none."""
    if not any((q.x, q.y, q.z, q.w)):
        return np.nan
    return float(portable.atan2(2.0 * (q.w * q.z + q.x * q.y), q.w * q.w + q.x * q.x - q.y * q.y - q.z * q.z))


def _value(source: Any, *paths: str) -> float:
    """The first of some attributes, with dots between names, that exists; NaN without one."""
    for path in paths:
        try:
            value = operator.attrgetter(path)(source)
        except AttributeError:
            continue
        return np.nan if value is None else float(value)
    return np.nan

"""A road: its centre line by arc length, and what lies along it."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from adaptrack.base.checked import checked, reals
from adaptrack.base.errors import InvalidInput
from adaptrack.base.limits import MAX_GRADE, ROAD_LENGTH, check_limit
from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import Array
from adaptrack.core.planning import station_table as along_kernel
from adaptrack.core.roads import road as kernel
from adaptrack.core.roads.road import X, Y
from adaptrack.road.segments import MAX_COORDINATE, Points, Pose, Segment
from adaptrack.road.station_table import ALONG_QUANTITIES, Along, alongs
from adaptrack.road.table import Pieces, sequence, tabulate

MAX_JOINT_GAP, MAX_JOINT_KINK = 0.01, 0.01
"""Largest step of the position (m) and of the heading (rad) where elements meet: rounding in files, not geometry."""
JUMP = 1e-4
"""1/m, a change of curvature at one place that counts as a jump; a line through samples has smaller ones."""
HALF_LANE = Along.constant(1.75)
"""m, half of a lane of 3.5 m: the width to each side where nothing is said."""
DRY_FRICTION, LEVEL = Along.constant(0.9), Along.constant(0.0)
"""Default friction, as in the scenarios, and default bank and grade."""
AT_ORIGIN = Pose()
_RULES: dict[str, tuple[Callable[[Array], NDArray[np.bool_]], str]] = {
    "width_left": (lambda value: value > 0.0, "> 0"),
    "width_right": (lambda value: value > 0.0, "> 0"),
    "friction": (lambda value: (value > 0.0) & (value <= 3.0), "a coefficient > 0 such as 0.8, at most 3"),
    "bank": (lambda value: np.abs(value) < 1.4, "an angle in rad, below 1.4 to either side"),
    "grade": (
        lambda value: np.abs(value) <= MAX_GRADE,
        f"dz/ds, at most {MAX_GRADE} to either side; 5 per cent are 0.05: divide a grade in per cent by 100",
    ),
    "speed_limit": (lambda value: value > 0.0, "a speed > 0 m/s"),
}
"""What is allowed of the quantities along a road."""
_NO_LIMIT = along_kernel.AlongRecord(np.zeros(0), np.zeros(0), 0)


class Jump(NamedTuple):
    """A place at which the curvature jumps."""

    s: float
    """Station (m)."""
    before: float
    """Curvature before it (1/m)."""
    after: float
    """Curvature after it (1/m)."""


class Projection(NamedTuple):
    """Where points stand against a road, one entry or array each."""

    s: Array
    """m, arc length of the foot; on a closed road it goes on growing over the laps"""
    offset: Array
    """m, from the centre line to the point, positive to the left"""
    heading: Array
    """rad, of the road at the foot; continuous over the laps"""
    curvature: Array
    """1/m, of the road at the foot"""


@dataclass(frozen=True, eq=False)
class Road:
    """A centre line with continuous heading, and width, speed limit, friction, bank and grade along it.

    Its curvature may jump, as where a straight line meets an arc (`curvature_jumps`); `smooth_road` rounds it.
    An open road goes on straight before its start and after its end. On a closed one s may be any number, lap by lap.
    Conventions: x forward, y left, SI units, radians.

    Build one with `from_segments`, or with `fit_road`, `road_through`, `load_road` or `generate_road`.

    Raises
    ------
    InvalidInput
        When the centre line has a gap or a kink, a closed one does not meet its start, it is too long or too far away,
        or a value along it is not possible; the message says where and what to do.
    """

    name: str
    table: Pieces = field(repr=False)
    closed: bool = False
    width_left: Along = HALF_LANE
    """m, from the centre line to the left edge"""
    width_right: Along = HALF_LANE
    """m, from the centre line to the right edge"""
    speed_limit: Along | None = None
    """Speed limit along the road (m/s)."""
    friction: Along = DRY_FRICTION
    """coefficient of all wheels"""
    bank: Along = LEVEL
    """rad, positive where gravity pushes to the left"""
    grade: Along = LEVEL
    """dz/ds in the direction of the road, positive uphill; at most `MAX_GRADE` to either side"""
    notes: tuple[str, ...] = ()
    """Sentences of its reader on deviations and unused parts."""
    deviation: float = 0.0
    """m, largest distance from a point that the road was fitted to"""
    elements: tuple[Segment, ...] = field(default=(), repr=False)
    """Elements of the centre line; empty for a fitted line and for a lane beside elements."""

    def __post_init__(self) -> None:
        check_limit(f"road {self.name!r}: length", self.length, ROAD_LENGTH)
        farthest = float(np.abs(self.table.pieces[:, [X, Y]]).max())
        if not farthest <= MAX_COORDINATE:
            raise InvalidInput(
                f"road {self.name!r}: it has a coordinate of {farthest:.3g} m: at most {MAX_COORDINATE:g} m are "
                "allowed; correct it, or move the origin."
            )
        self._check_joints()
        for name, (allowed, rule) in _RULES.items():
            values: Along | None = getattr(self, name)
            try:
                if values is not None:
                    values.within(allowed, rule)
            except InvalidInput as error:
                raise InvalidInput(f"road {self.name!r}: {name} = {error}") from None

    def _check_joints(self) -> None:
        """Refuse gaps and kinks."""
        first, last = self.table.ends()
        after = np.arange(1, len(self.table.pieces) + 1) % len(self.table.pieces)
        count = after.size if self.closed else after.size - 1
        turn = first.heading[after] - last.heading
        kink = np.abs(turn - 2.0 * np.pi * np.round(turn / (2.0 * np.pi)))
        gap = portable.hypot(first.x[after] - last.x, first.y[after] - last.y)
        for is_broken, size, unit in (
            (gap > MAX_JOINT_GAP, gap, "m apart"),
            (kink > MAX_JOINT_KINK, kink, "rad of kink"),
        ):
            for k in np.flatnonzero(is_broken[:count])[:1]:
                where = "the end and the start" if k == after.size - 1 else f"s = {self.table.start[k + 1]:.2f} m"
                raise InvalidInput(
                    f"road {self.name!r}: {size[k]:.3g} {unit} at {where}; the centre line must be one curve without "
                    "kinks. Correct the elements, or fit a road to sampled points with fit_road."
                )

    def __repr__(self) -> str:
        kind = "a lap of" if self.closed else "open,"
        noted = f"; {'; '.join(self.notes)}" if self.notes else ""
        return f"<Road {self.name!r}: {kind} {self.length:.4g} m{noted}>"

    # ---- made of

    @classmethod
    @checked
    def from_segments(
        cls,
        segments: Sequence[Segment],
        *,
        start: Pose | tuple[float, float, float] = AT_ORIGIN,
        closed: bool = False,
        name: str = "road",
        **along: Any,
    ) -> Road:
        """A road of elements end to end, each with the heading with which the one before it ends.

        Parameters
        ----------
        segments : sequence of Line, Arc, Clothoid, Cubic
            One with a `start` of its own lies there; it must meet the one before it within 0.01 m and 0.01 rad.
        start : (x, y, heading)
            m, m, rad; of the first element, where it has none of its own.
        closed : bool
            Whether its end is its start; it then must meet it within 0.01 m and 0.01 rad.
        **along
            `width_left`, `width_right`, `speed_limit`, `friction`, `bank`, `grade`: a number, (arc lengths, values) or
            `Along`.

        Raises
        ------
        InvalidInput
            When there is no element, or as `Road`.
        """
        if not segments:
            raise InvalidInput("Road.from_segments: no segments; give at least one Line, Arc, Clothoid or Cubic.")
        table = sequence(tabulate(segments), Pose(*start), [segment.pose for segment in segments])
        first = segments[0]
        if first.start is None:
            first = first.replace(start=tuple(float(value) for value in start))
        return cls(name=name, table=table, closed=closed, elements=(first, *segments[1:]), **alongs(along))

    def to_toml(self, path: str | os.PathLike[str]) -> None:
        """Write the road as a TOML file, which `load_road` reads: the same to rounding.

        Raises
        ------
        StorageError
            When the file cannot be written.
        """
        from adaptrack.road.toml import write_road  # which reads roads

        write_road(path, self)

    # ---- geometry

    @property
    def length(self) -> float:
        """m, of the centre line; of one lap on a closed road."""
        return self.table.length

    @cached_property
    def turn(self) -> float:
        """rad, by which the heading grows in one lap: 2 pi, -2 pi, or 0 for a figure of eight; 0 on an open road."""
        if not self.closed:
            return 0.0
        first, last = self.table.at(0.0), self.table.at(self.length)
        return 2.0 * math.pi * round(float(last.heading - first.heading) / (2.0 * math.pi))

    def at(self, s: ArrayLike) -> Points:
        """The points of the centre line at the arc lengths `s` (m), any numbers, in the shape of `s`."""
        s = reals("Road.at: s", s)
        laps = np.floor(s / self.length) if self.closed else np.zeros_like(s)
        inside = np.clip(s - laps * self.length, 0.0, self.length)
        x, y, heading, curvature = self.table.at(inside)
        beyond = s - laps * self.length - inside
        straight = beyond != 0.0
        return Points(
            np.where(straight, x + beyond * portable.cos(heading), x),
            np.where(straight, y + beyond * portable.sin(heading), y),
            heading + laps * self.turn,
            np.where(straight, 0.0, curvature),
        )

    def along(self, name: str, s: ArrayLike) -> Array:
        """A quantity along the road at the arc lengths `s` (m); the speed limit is inf where there is none.

        name: `width_left`, `width_right`, `speed_limit`, `friction`, `bank` or `grade`.

        Raises
        ------
        InvalidInput
            For another name.
        """
        if name not in ALONG_QUANTITIES:
            raise InvalidInput(f"Road.along: {name!r}: must be one of {', '.join(ALONG_QUANTITIES)}.")
        values: Along | None = getattr(self, name)
        s = reals("Road.along: s", s)
        if values is None:
            return np.full(s.shape, np.inf)
        return values.at(s - np.floor(s / self.length) * self.length if self.closed else s)

    def edges(self, s: ArrayLike) -> tuple[Array, Array]:
        """The left and the right edge at the arc lengths `s`: two arrays (..., 2) of x, y (m)."""
        places = reals("Road.edges: s", s)
        edges = np.empty((places.size, 4))
        left, right = self.width_left.packed(), self.width_right.packed()
        along_kernel.road_edges(self.packed(), left, right, places.flatten(), edges)
        return edges[:, :2].reshape(*places.shape, 2), edges[:, 2:].reshape(*places.shape, 2)

    def curvature_jumps(self, least: float = JUMP) -> list[Jump]:
        """The places at which the curvature changes at once, by more than `least` (1/m)."""
        first, last = self.table.ends()
        after = np.roll(first.curvature, -1)
        count = after.size if self.closed else after.size - 1
        jumps = np.flatnonzero(np.abs(after - last.curvature)[:count] > least)
        return [Jump(float(self.table.start[k + 1]), float(last.curvature[k]), float(after[k])) for k in jumps]

    def project(self, x: ArrayLike, y: ArrayLike, near: ArrayLike | None = None) -> Projection:
        """The feet of points on the centre line.

        Parameters
        ----------
        x, y : array
            m, of one shape.
        near : array, optional
            m, the arc length where the foot was last. Of all places where the distance has a minimum the foot is then
            the one nearest to it in arc length: continuous in time, on the right branch where the road crosses itself,
            over any number of laps. Without it: the nearest foot of the whole road, 0 <= s < length on a closed one.

        Returns
        -------
        Projection
            Arrays in the shape of x. Beyond the ends of an open road the foot is on its straight continuation.

        Raises
        ------
        InvalidInput
            When a coordinate is not a finite number, shapes do not fit, or there is no foot within 400 m of `near`.
        """
        coordinates = [
            reals("Road.project: a coordinate", coordinate) for coordinate in (x, y, np.nan if near is None else near)
        ]
        try:
            columns = np.broadcast_arrays(*coordinates)
        except ValueError:
            raise InvalidInput("Road.project: x, y and near must have one shape.") from None
        rows = np.stack([column.ravel() for column in columns], axis=-1)
        if not np.isfinite(rows[:, : 2 if near is None else 3]).all():
            raise InvalidInput("Road.project: x, y and near must be finite; leave missing samples out.")
        feet = np.empty((len(rows), 4))
        kernel.project_all(self.packed(), rows, feet)
        for missing in np.flatnonzero(np.isnan(feet[:, 1]))[:1]:
            px, py, s = rows[missing]
            raise InvalidInput(
                f"Road.project: the point ({px:.6g}, {py:.6g}) has no foot within {kernel.REACH:g} m of near = {s:.6g} "
                "m along the road. Give the arc length of its last foot, or leave near out."
            )
        shape = columns[0].shape
        return Projection(*(feet[:, k].reshape(shape) for k in range(4)))

    def packed(self) -> Any:
        """The centre line as the record that `adaptrack.core.roads.road` reads; read-only."""
        return self._packed

    @cached_property
    def _packed(self) -> Any:
        return self.table.packed(self.closed)

    def route(self) -> Any:
        """The road with what lies along it as `adaptrack.core.planning` reads it; read-only."""
        limit = _NO_LIMIT if self.speed_limit is None else self.speed_limit.packed()
        return along_kernel.Route(self.packed(), self.friction.packed(), self.bank.packed(), limit, self.grade.packed())

    # ---- variants

    def replace(self, **changes: Any) -> Road:
        """A copy with other values: `name`, and what lies along the road as in `from_segments`."""
        return replace(self, **alongs(changes))

"""A drive along a road: which road, how fast, from where, in what wind."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any, Self

import numpy as np
from pydantic import Field

from adaptrack.base.checked import Count, Finite, Hint, Positive, checked
from adaptrack.base.errors import InvalidInput
from adaptrack.base.limits import PERIODS
from adaptrack.core.loop import SIGNAL
from adaptrack.core.planning import drive as kernel
from adaptrack.scenario.shapes import Shape, as_shape
from adaptrack.scenario.signals import Signals, instants
from adaptrack.scenario.surroundings import Wind, as_wind

if TYPE_CHECKING:
    from adaptrack.road.road import Road
    from adaptrack.road.speed import SpeedPlan


@checked
@dataclass(frozen=True, eq=False)
class RoadDrive:
    """A road to drive along, from its start to its end or for some laps, at a planned speed.

    The plan is kept in time, stops included. Where a car is early or late, friction, bank and grade are those of
    the place where it is. Conventions as for `Scenario`; offsets and headings count from the path, positive to the
    left.

    Raises
    ------
    InvalidInput
        When the plan is of another road or never arrives, or the road of several laps is open.
    """

    road: Road
    speed: SpeedPlan | float
    """a plan (`plan_speed`), or one speed (m/s)"""
    laps: Count = 1
    """of a closed road"""
    reference: Shape | float = 0.0
    """m, offset from the centre line to follow, over time"""
    wind: Wind | Any = 0.0
    """m/s, over time, in the world; what `Scenario` takes"""
    start_offset: Annotated[Finite, "m"] | None = None
    """at the start; None: on the reference"""
    start_heading: Annotated[
        Finite, Field(gt=-0.5 * math.pi, lt=0.5 * math.pi), "rad", Hint("within a right angle")
    ] = 0.0
    """at the start, against the road"""
    name: str = ""
    """the road's, when empty"""

    def __post_init__(self) -> None:
        from adaptrack.road.road import Road  # here: who loads a scenario without a road loads no roads
        from adaptrack.road.speed import SpeedPlan, constant_speed

        if not isinstance(self.road, Road):
            raise InvalidInput(f"RoadDrive: road = {self.road!r}: must be a Road; load_road(file) gives one.")
        plan = self.speed if isinstance(self.speed, SpeedPlan) else constant_speed(self.road, self.speed)
        if plan.closed != self.road.closed or not math.isclose(plan.s[-1], self.road.length, rel_tol=1e-9):
            raise InvalidInput("RoadDrive: speed: a plan of another road; plan_speed(road, ...) makes one.")
        if self.laps > 1 and not self.road.closed:
            raise InvalidInput(
                f"RoadDrive: laps = {self.laps}: the road {self.road.name!r} is open; leave laps out, or load its "
                "points with closed=True (--closed)."
            )
        if not math.isfinite(plan.duration):
            raise InvalidInput("RoadDrive: speed: the plan never arrives: its speed is 0 over a stretch.")
        changed = {
            "speed": plan,
            "reference": as_shape(self.reference),
            "wind": as_wind(self.wind),
            "name": self.name or self.road.name,
        }
        for field, value in changed.items():
            object.__setattr__(self, field, value)

    @property
    def plan(self) -> SpeedPlan:
        """The speed along the road."""
        return self.speed  # type: ignore[return-value]  # since __post_init__

    @property
    def duration(self) -> float:
        """s, of all laps, stops included."""
        return self.plan.duration * self.laps

    @property
    def length(self) -> float:
        """m, of all laps."""
        return self.road.length * self.laps

    @property
    def _offset(self) -> Shape:
        assert isinstance(self.reference, Shape)
        return self.reference

    @checked
    def sample(self, period: Annotated[Positive, "s"] = 0.1) -> Signals:
        """Sample the drive at the instants k·period until the end of the road (see `Signals`).

        Raises
        ------
        InvalidInput
            When the drive has no or too many control periods.
        """
        count = kernel.drive_periods(self.plan.duration, self.laps, period)
        if not 1 <= count <= PERIODS.most:
            raise InvalidInput(
                f"drive {self.name!r} lasts {self.duration:.6g} s: {count:,} periods of {period!r} s; 1 to "
                f"{PERIODS.most:,} are possible ({PERIODS.reason})."
            )
        t = instants(count, period)
        wind = self.wind.at(t)
        samples = np.empty((len(SIGNAL), count + 1))
        drive = kernel.RoadDriveRecord(
            self.road.route(), self.plan.packed(), period, self._offset.at(t), wind[:, 0].copy(), wind[:, 1].copy()
        )
        kernel.drive_along_road(drive, samples)
        wheels = samples[SIGNAL.friction_front_left : SIGNAL.friction_rear_right + 1]
        return Signals(
            period, t, samples[SIGNAL.y_ref], samples[SIGNAL.speed], wheels.T, wind, samples[SIGNAL.bank],
            samples[SIGNAL.station], samples[SIGNAL.acceleration], samples[SIGNAL.grade],
        )  # fmt: skip

    def start_pose(self) -> tuple[float, float, float]:
        """x, y (m) and yaw (rad) at the start."""
        offset = float(self._offset.at(0.0)) if self.start_offset is None else float(self.start_offset)
        pose = np.empty(3)
        kernel.drive_start(self.road.packed(), offset, self.start_heading, pose)
        x, y, yaw = pose.tolist()
        return x, y, yaw

    def replace(self, **changes: Any) -> Self:
        """A copy with other values."""
        return replace(self, **changes)

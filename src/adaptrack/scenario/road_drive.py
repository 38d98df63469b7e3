"""A test drive along a road: the road, the speed plan, the start pose and the wind."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any, Self

import numpy as np
from pydantic import Field

from adaptrack.base.checked import Count, Finite, Hint, Positive, checked
from adaptrack.base.errors import InvalidInput
from adaptrack.base.limits import PERIODS
from adaptrack.core.planning import drive as kernel
from adaptrack.core.simulation.world import SIGNAL
from adaptrack.scenario.shapes import Shape, Wind, as_shape, as_wind
from adaptrack.scenario.signals import Signals, instants

if TYPE_CHECKING:
    from adaptrack.road.road import Road
    from adaptrack.road.speed import SpeedPlan


@checked
@dataclass(frozen=True, eq=False)
class RoadDrive:
    """A test drive along a road at a planned speed, from its start to its end or for several laps.

    The reference position along the road is a function of time and includes the stops of the plan. A car may be ahead
    of or behind this position; it meets the friction, bank and grade of its actual position. Conventions are those
    of `Scenario`. Offsets and headings are relative to the road's centre line, positive to the left.

    Raises
    ------
    InvalidInput
        When the plan belongs to a different road or never reaches the end, or when an open road has several laps.
    """

    road: Road
    speed: SpeedPlan | float
    """Speed plan (`plan_speed`), or one constant speed (m/s)."""
    laps: Count = 1
    """Number of laps; more than one needs a closed road."""
    reference: Shape | float = 0.0
    """Desired offset from the centre line (m) as a function of time."""
    wind: Wind | Any = 0.0
    """Wind velocity in the world frame (m/s) as a function of time; same forms as `Scenario.wind`."""
    start_offset: Annotated[Finite, "m"] | None = None
    """Offset of the car from the centre line at the start (m); None for the reference there."""
    start_heading: Annotated[
        Finite, Field(gt=-0.5 * math.pi, lt=0.5 * math.pi), "rad", Hint("within a right angle")
    ] = 0.0
    """Heading of the car relative to the road at the start (rad)."""
    name: str = ""
    """Name of the drive; the road's name when empty."""

    def __post_init__(self) -> None:
        from adaptrack.road.road import Road  # a local import: scenarios without a road need no road package
        from adaptrack.road.speed import SpeedPlan, constant_speed

        if not isinstance(self.road, Road):
            raise InvalidInput(f"RoadDrive: road = {self.road!r}: must be a Road, such as load_road(file) returns.")
        plan = self.speed if isinstance(self.speed, SpeedPlan) else constant_speed(self.road, self.speed)
        if plan.closed != self.road.closed or not math.isclose(plan.s[-1], self.road.length, rel_tol=1e-9):
            raise InvalidInput(
                "RoadDrive: speed: the plan belongs to a different road; make one by plan_speed(road, ...)."
            )
        if self.laps > 1 and not self.road.closed:
            raise InvalidInput(
                f"RoadDrive: laps = {self.laps}: the road {self.road.name!r} is open; leave laps out, or load its "
                "points with closed=True (--closed)."
            )
        if not math.isfinite(plan.duration):
            raise InvalidInput(
                "RoadDrive: speed: the plan never reaches the end of the road: its speed is 0 over a stretch."
            )
        changed = {"speed": plan, "reference": as_shape(self.reference), "wind": as_wind(self.wind)}
        for field, value in (changed | {"name": self.name or self.road.name}).items():
            object.__setattr__(self, field, value)

    @property
    def plan(self) -> SpeedPlan:
        """Speed plan along the road."""
        return self.speed  # type: ignore[return-value]  # since __post_init__

    @property
    def duration(self) -> float:
        """Planned duration of all laps, including stops (s)."""
        return self.plan.duration * self.laps

    @property
    def length(self) -> float:
        """Length of all laps (m)."""
        return self.road.length * self.laps

    @property
    def _offset(self) -> Shape:
        assert isinstance(self.reference, Shape)
        return self.reference

    @checked
    def sample(self, period: Annotated[Positive, "s"] = 0.1) -> Signals:
        """Sample the drive at the control instants k * period until the end of the road (see `Signals`).

        Raises
        ------
        InvalidInput
            When the drive has no control period or too many.
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
        curvature = samples[SIGNAL.acceleration]  # `drive_along_road` stores the curvature in this row
        wheels = samples[SIGNAL.friction_front_left : SIGNAL.friction_rear_right + 1]
        return Signals(
            period, t, samples[SIGNAL.y_ref], samples[SIGNAL.speed], wheels.T, wind, samples[SIGNAL.bank],
            samples[SIGNAL.station], curvature, samples[SIGNAL.grade],
        )  # fmt: skip

    def start_pose(self) -> tuple[float, float, float]:
        """Return x (m), y (m) and yaw (rad) of the car at the start."""
        offset = float(self._offset.at(0.0)) if self.start_offset is None else float(self.start_offset)
        pose = np.empty(3)
        kernel.drive_start(self.road.packed(), offset, self.start_heading, pose)
        x, y, yaw = pose.tolist()
        return x, y, yaw

    def replace(self, **changes: Any) -> Self:
        """Return a copy with some fields changed."""
        return replace(self, **changes)

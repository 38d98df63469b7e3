"""A run along its road for the road from above and the replay: pose, offset, steering, speed."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Self

import numpy as np
from numpy.typing import NDArray

from adaptrack.base.checked import real
from adaptrack.base.errors import InvalidInput
from adaptrack.cars.outline import Outline
from adaptrack.cars.vehicle import Vehicle
from adaptrack.core.simulation.run import TRACE_SIGNALS
from adaptrack.drive.failure import find_failure
from adaptrack.drive.predicted_paths import PredictedPaths
from adaptrack.drive.trajectory import Trajectory
from adaptrack.road import Road
from adaptrack.road.road_ahead import foot_near

Array = NDArray[np.float64]
SPEED_SIGNALS = (
    "governed_speed", "longitudinal_acceleration", "grip_used", "friction_low", "friction_high", "friction",
)  # fmt: skip
"""Signals of a speed control that the replay shows, with the true friction."""


@dataclass(frozen=True)
class DrawnCar:
    """A car from above, about its centre of mass.

    Raises
    ------
    InvalidInput
        When a length is not positive.
    """

    outline: Outline
    lf: float
    """m, centre of mass to front axle"""
    lr: float
    """m, centre of mass to rear axle"""
    track_front: float
    """m, between the front wheels"""
    track_rear: float
    """m, between the rear wheels"""

    def __post_init__(self) -> None:
        for name in ("lf", "lr", "track_front", "track_rear"):
            if not 0.0 < real("DrawnCar", name, getattr(self, name)) < math.inf:
                raise InvalidInput(f"DrawnCar: {name} = {getattr(self, name)!r} m: must be positive and finite.")

    @classmethod
    def of(cls, car: Vehicle) -> Self:
        """The body and the axles of a car."""
        return cls(car.outline, car.lf, car.lr, car.track_front, car.track_rear)


DEFAULT_DRAWN_CAR = DrawnCar(Outline(2.15, 2.3, 1.8, ("length", "front_overhang", "width")), 1.3, 1.4, 1.55, 1.55)
"""The car that is drawn if none is specified."""


@dataclass(frozen=True, eq=False, kw_only=True)
class DriveRecord:
    """One drive along a road at n instants as finite arrays (n,), in SI units and radians, positive to the left."""

    road: Road
    shape: DrawnCar
    time: Array
    """s, growing"""
    station: Array
    """m, arc length of the foot; it keeps growing over the laps of a closed road"""
    x: Array
    """m, of the centre of mass"""
    y: Array
    """m, of the centre of mass"""
    yaw: Array
    """rad; wrapped or not"""
    speed: Array
    """m/s, forward"""
    offset: Array
    """m, e: from the centre line to the centre of mass"""
    steering: Array
    """rad, angle of the front wheels"""
    command: Array
    """rad, steering command of the controller"""
    planned_speed: Array
    """m/s, planned for the place of the car; the reference of the speed where this is not recorded"""
    speed_control: Mapping[str, Array] = field(default_factory=dict)
    """signals of a speed control by the names of `SPEED_SIGNALS`; empty without one"""
    failed: str = ""
    """Reason of the failure, to complete "the vehicle ..."; empty if the drive did not fail."""
    failed_at: float = math.nan
    """s, time of the failure; NaN if the drive did not fail"""
    predicted: PredictedPaths | None = None
    """the paths that the controller predicted; None if they were not recorded"""

    @classmethod
    def from_trajectory(
        cls,
        run: Trajectory,
        road: Road,
        car: Vehicle | DrawnCar = DEFAULT_DRAWN_CAR,
        predicted: PredictedPaths | None = None,
    ) -> Self:
        """A recorded run along its road, cut at the first instant that is not finite.

        Where the run knows its road (`Trajectory.road`) that is taken; otherwise its positions are
        projected onto the road, each from the foot of the one before it.

        Parameters
        ----------
        car
            What is drawn.
        predicted
            The paths that `simulate` kept: the replay draws them.

        Raises
        ------
        InvalidInput
            When fewer than two instants are finite.
        """
        run = on_road(run, road)
        signals = {
            "time": run.t, "station": run.road["station"], "x": run.X, "y": run.Y, "yaw": run.psi, "speed": run.vx,
            "offset": run.road["offset"], "steering": run.steering, "command": run.command,
            "planned_speed": run.road.get("planned_speed", run.v_ref),
        }  # fmt: skip
        finite = np.isfinite(np.stack(list(signals.values()))).all(axis=0)
        end = int(finite.argmin()) if not finite.all() else len(run)
        if end < 2:
            raise InvalidInput("a drive along a road must have at least two instants with finite numbers.")
        failed = find_failure(run)
        return cls(
            **{name: values[:end] for name, values in signals.items()}, speed_control=_speed_signals(run, end),
            road=road, shape=car if isinstance(car, DrawnCar) else DrawnCar.of(car),
            failed=failed.clause if failed else "", failed_at=failed.time if failed else math.nan,
            predicted=predicted or None,
        )  # fmt: skip

    def __len__(self) -> int:
        """The number n of instants."""
        return int(self.time.size)

    @property
    def p95_offset(self) -> float:
        """m, 95th percentile of |e|."""
        return float(np.percentile(np.abs(self.offset), 95.0))

    @property
    def max_offset(self) -> float:
        """m, largest |e|."""
        return float(np.abs(self.offset).max())


def _speed_signals(run: Trajectory, end: int) -> dict[str, Array]:
    """The signals of `SPEED_SIGNALS` up to an instant, those that are finite."""
    if "governed_speed" not in run.diagnostics:
        return {}
    signals = {"friction": run.friction.mean(axis=1), **run.diagnostics}
    columns = {name: np.asarray(signals[name][:end], dtype=float) for name in SPEED_SIGNALS}
    return {name: values for name, values in columns.items() if np.isfinite(values).all()}


def on_road(run: Trajectory, road: Road) -> Trajectory:
    """A run with its place on a road (`Trajectory.road`): its own, or the projection of its positions."""
    if run.road:
        return run
    feet = np.full((len(run), 4), np.nan)
    near = None
    for i, (x, y) in enumerate(zip(run.X, run.Y, strict=True)):
        if not np.isfinite(x + y):
            break
        foot = road.project(x, y) if near is None else foot_near(road, x, y, near)
        if not np.isfinite(foot.offset):
            break
        feet[i] = foot.s, foot.offset, foot.heading, foot.curvature
        near = float(foot.s)
    feet[:, 2] = np.remainder(run.psi - feet[:, 2] + np.pi, 2.0 * np.pi) - np.pi
    names = (*TRACE_SIGNALS._fields[TRACE_SIGNALS.station :], "curvature")
    return dataclasses.replace(run, road=dict(zip(names, feet.T, strict=True)))

"""A drive along a road as pages show it: where the car was, how far from the centre line, what was steered."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from adaptrack.base.checked import real
from adaptrack.base.errors import InvalidInput
from adaptrack.cars.outline import Outline
from adaptrack.cars.vehicle import Vehicle
from adaptrack.drive.failure import Failed
from adaptrack.drive.metrics import belief_shares, last_belief_state
from adaptrack.drive.predicted import PredictedPaths
from adaptrack.drive.trajectory import Trajectory
from adaptrack.road import Road, SpeedPlan
from adaptrack.road.ahead import foot_near

Array = NDArray[np.float64]

SIGNALS = (
    "time", "station", "x", "y", "yaw", "speed", "offset", "heading_error", "steering", "command",
    "lateral_acceleration",
)  # fmt: skip
"""The arrays that every record has."""


class Measure(NamedTuple):
    """A measure of a drive, a row of the page's table."""

    name: str
    value: float
    unit: str = ""


class Learnt(NamedTuple):
    """A quantity that a controller has learned while driving, (n,) each."""

    mean: Array
    low: Array
    """one standard deviation below"""
    high: Array
    truth: Array | None = None
    """in simulation"""


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
    """m"""
    track_rear: float
    """m"""

    def __post_init__(self) -> None:
        for name in ("lf", "lr", "track_front", "track_rear"):
            if not 0.0 < real("DrawnCar", name, getattr(self, name)) < math.inf:
                raise InvalidInput(f"DrawnCar: {name} = {getattr(self, name)!r} m: must be positive and finite.")

    @classmethod
    def of(cls, car: Vehicle) -> Self:
        """The body and the axles of a car."""
        return cls(car.outline, car.lf, car.lr, car.track_front, car.track_rear)


PASSENGER_CAR = DrawnCar(Outline(2.15, 2.3, 1.8, ("length", "front_overhang", "width")), 1.3, 1.4, 1.55, 1.55)
"""What is drawn where no car is given."""


@dataclass(frozen=True, eq=False, kw_only=True)
class DriveRecord:
    """One drive along a road: n instants, in SI units and radians, positive to the left; read-only arrays (n,).

    Raises
    ------
    InvalidInput
        When arrays differ in length, hold what is not finite, or time does not grow; the message names the array. Cut a
        drive where its numbers end; `from_trajectory` does.
    """

    road: Road
    shape: DrawnCar
    time: Array
    """s, growing"""
    station: Array
    """m, arc length of the foot; over the laps of a closed road it goes on growing"""
    x: Array
    """m, of the centre of mass"""
    y: Array
    """m, likewise"""
    yaw: Array
    """rad; wrapped or not"""
    speed: Array
    """m/s, forward"""
    offset: Array
    """m, e: from the centre line to the centre of mass"""
    heading_error: Array
    """rad, yaw minus the road's heading"""
    steering: Array
    """rad, angle of the front wheels"""
    command: Array
    """rad, angle that the controller asks for"""
    lateral_acceleration: Array
    """m/s²"""
    planned_speed: Array | None = None
    """m/s, at the same instants; None where none is known"""
    controller: str = ""
    car: str = ""
    profile: str = ""
    failed: str = ""
    """Why the drive failed, to complete "the vehicle ..."; empty for one that did not."""
    failed_at: float = math.nan
    """s; NaN for a drive that did not."""
    metrics: Sequence[Measure] = ()
    learned: Mapping[str, Learnt] = field(default_factory=dict)
    """what the controller has learned of its car, by name; empty for one that does not learn"""
    predicted: PredictedPaths | None = None
    """the paths that the controller predicted; None where none were kept"""
    belief: Mapping[str, float | str] = field(default_factory=dict)
    """how far that can be trusted: shares of time and the last state, as `Metrics` has them; empty likewise"""

    def __post_init__(self) -> None:
        n = np.size(self.time)
        if n < 2:
            raise InvalidInput("DriveRecord: a drive has at least two instants.")
        names = SIGNALS if self.planned_speed is None else (*SIGNALS, "planned_speed")
        for name in names:
            values = np.array(getattr(self, name), dtype=np.float64)
            if values.shape != (n,):
                raise InvalidInput(f"DriveRecord: `{name}` must have the shape {(n,)}; it has {values.shape}.")
            if not np.isfinite(values).all():
                raise InvalidInput(f"DriveRecord: `{name}` holds a value that is not finite: cut the drive before it.")
            values.flags.writeable = False
            object.__setattr__(self, name, values)
        if not (np.diff(self.time) > 0.0).all():
            raise InvalidInput("DriveRecord: `time` must grow from instant to instant.")
        if bool(self.failed) == math.isnan(self.failed_at):
            raise InvalidInput(
                "DriveRecord: `failed` and `failed_at` go together: the reason and the time, or neither."
            )

    @classmethod
    def from_trajectory(
        cls,
        run: Trajectory,
        road: Road,
        car: Vehicle | DrawnCar = PASSENGER_CAR,
        *,
        plan: SpeedPlan | None = None,
        failed: Failed | None = None,
        metrics: Sequence[Measure] = (),
        predicted: PredictedPaths | None = None,
    ) -> Self:
        """A recorded run beside its road, cut at the first instant that is not finite.

        Where the run knows its road (`Trajectory.road`) that is taken; otherwise its positions are
        projected onto the road, each from the foot of the one before it.

        Parameters
        ----------
        car : Vehicle or DrawnCar
            What is drawn.
        plan : SpeedPlan, optional
            The planned speed; the run's speed reference when left out.
        failed : Failed, optional
            As `find_failure` tells it; what the run itself says when left out.
        predicted : PredictedPaths, optional
            What `simulate` was given to keep the predicted paths in: the replay draws them.

        Raises
        ------
        InvalidInput
            When fewer than two instants are finite.
        """
        station, offset, heading_error = _beside(run, road)
        signals = {
            "time": run.t, "station": station, "x": run.X, "y": run.Y, "yaw": run.psi, "speed": run.vx,
            "offset": offset, "heading_error": heading_error, "steering": run.steering, "command": run.command,
            "lateral_acceleration": run.lateral_acceleration,
            "planned_speed": run.v_ref if plan is None else plan.at(station),
        }  # fmt: skip
        whole = np.isfinite(np.stack(list(signals.values()))).all(axis=0)
        end = int(whole.argmin()) if not whole.all() else len(run)
        failure = (failed.clause, failed.time) if failed else (run.failed or "", run.failed_at)
        last = last_belief_state(run)
        return cls(
            learned=_learned(run, end), belief={**belief_shares(run), "belief_state": last} if last else {},
            **{name: values[:end] for name, values in signals.items()},
            road=road, shape=car if isinstance(car, DrawnCar) else DrawnCar.of(car),
            controller=run.name_of("controller"), car=run.name_of("vehicle"), profile=run.name_of("profile"),
            failed=failure[0], failed_at=failure[1], metrics=metrics, predicted=predicted or None,
        )  # fmt: skip

    def __len__(self) -> int:
        """The number n of instants."""
        return int(self.time.size)

    @property
    def failed_station(self) -> float:
        """m, where it failed: the last place known up to then; NaN for a drive that did not."""
        if not self.failed:
            return math.nan
        return float(self.station[max(0, int(np.searchsorted(self.time, self.failed_at + 1e-9)) - 1)])

    @property
    def rms_offset(self) -> float:
        """m, root of the mean e² over the instants."""
        return float(np.sqrt(np.mean(self.offset**2)))

    @property
    def p95_offset(self) -> float:
        """m, 95th percentile of |e|."""
        return float(np.percentile(np.abs(self.offset), 95.0))

    @property
    def max_offset(self) -> float:
        """m, largest |e|."""
        return float(np.abs(self.offset).max())


def _beside(run: Trajectory, road: Road) -> tuple[Array, Array, Array]:
    """Station, offset and heading error of a run: its own, or by projection."""
    if run.road:
        return run.road["station"], run.road["offset"], run.road["heading_error"]
    feet = np.full((len(run), 3), np.nan)
    near = None
    for i, (x, y) in enumerate(zip(run.X, run.Y, strict=True)):
        if not np.isfinite(x + y):
            break
        foot = road.project(x, y) if near is None else foot_near(road, x, y, near)
        if not np.isfinite(foot.offset):
            break
        feet[i] = foot.s, foot.offset, foot.heading
        near = float(foot.s)
    turned = run.psi - feet[:, 2]
    return feet[:, 0], feet[:, 1], np.remainder(turned + np.pi, 2.0 * np.pi) - np.pi


LOGARITHMIC = ("stiffness", "balance", "friction")
"""Learned quantities whose standard deviation is that of the logarithm."""


def _learned(run: Trajectory, end: int) -> dict[str, Learnt]:
    """What a run says of each learned quantity up to an instant."""
    truth = {name: np.full(len(run), value) for name, value in run.meta.get("truth", {}).items()}
    if truth:
        truth["friction"] = run.friction.mean(axis=1)
    found = {}
    for key, mean in run.diagnostics.items():
        name = key.removeprefix("belief_")
        sigma = run.diagnostics.get(f"{key}_sigma")
        if name == key or sigma is None:
            continue
        if name in LOGARITHMIC:
            low, high = mean * np.exp(-sigma), mean * np.exp(sigma)
        else:
            low, high = mean - sigma, mean + sigma
        real_one = truth.get(name)
        found[name] = Learnt(mean[:end], low[:end], high[:end], None if real_one is None else real_one[:end])
    return found

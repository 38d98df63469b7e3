"""A simulated planner, and a tracker that follows it, as the controller of a simulated drive."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from operator import itemgetter
from typing import Annotated, Any, Literal, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from adaptrack.base.checked import Natural, NotNegative, Positive, checked
from adaptrack.base.errors import InvalidInput
from adaptrack.control.speed_control import SpeedCommand
from adaptrack.control.tracker import Tracker
from adaptrack.core.maths import portable
from adaptrack.core.tracker.signals import TRACKER_SAMPLE, sample_of
from adaptrack.drive.sampled_controller import SampledController
from adaptrack.road import SpeedPlan
from adaptrack.road.planned_trajectory import PlannedTrajectory
from adaptrack.scenario import RoadDrive, Scenario

Array = NDArray[np.float64]
BEHIND = 5.0
"""m, by which a trajectory of a planner that keeps to its line begins behind the car."""
SHORTEST_MERGE = 5.0
"""m, on which a trajectory from the pose of the car returns to the line, at least."""
AT_REST = 1.0
"""m, between the car and the place at which the plan stands, up to which a planner lets the stop go on."""
_ARGUMENTS = (*TRACKER_SAMPLE._fields[: TRACKER_SAMPLE.friction], "motion_time")
"""Signals that `Tracker.step` receives."""


class Emitted(NamedTuple):
    """Trajectory that arrives at a tracker, with its fallback."""

    trajectory: PlannedTrajectory
    fallback: PlannedTrajectory | None = None


class PlannerRun(Protocol):
    """A planner on its way through a drive."""

    def step(self, sample: Array) -> Sequence[Emitted]:
        """Return the trajectories that arrive at a control instant, in their order.

        sample: `core.tracker.signals.TRACKER_SAMPLE`, with the time ``now``.
        """
        ...


class Planner(Protocol):
    """A planner for simulated drives; `SimulatedPlanner` is that of this package."""

    def begin(self, drive: RoadDrive) -> PlannerRun:
        """Begin a drive from its start."""
        ...


@checked
@dataclass(frozen=True)
class SimulatedPlanner:
    """Planner that knows road and speed plan of a drive, and sends the next part of them, anew every `period`.

    Parameters
    ----------
    delay, jitter
        A trajectory arrives `delay` after its stamp, more or less by up to `jitter`; the first one arrives at once.
    start
        Where a trajectory begins. "line": on the road, with the times of the speed plan since the start of the drive.
        "pose": at the measured pose of the car, with the plan's speeds from there on. It returns to the road within
        `merge`, so that it hides the error of the steering.
    spacing
        Largest distance of the points.
    noise
        Standard deviation of x and y of each point, new in each trajectory.
    horizon
        Time that a trajectory covers.
    """

    period: Annotated[Positive, "s"] = 0.1
    delay: Annotated[NotNegative, "s"] = 0.0
    jitter: Annotated[NotNegative, "s"] = 0.0
    start: Literal["line", "pose"] = "line"
    spacing: Annotated[Positive, "m"] = 1.0
    noise: Annotated[NotNegative, "m"] = 0.0
    horizon: Annotated[Positive, "s"] = 4.0
    merge: Annotated[Positive, "s"] = 3.0
    seed: Natural = 0

    def begin(self, drive: RoadDrive) -> PlannerRun:
        """Begin a drive from its start."""
        return _Run(self, drive)


class _Pose(NamedTuple):
    """Measured place of a car: time (s), x, y (m), course (rad; NaN: unknown), speed (m/s), yaw rate (rad/s)."""

    t: float
    x: float
    y: float
    yaw: float
    drift: float
    speed: float
    yaw_rate: float

    def carried(self, time: float) -> _Pose:
        """Return the pose at a later time (s), if the car goes on as it did."""
        elapsed = time - self.t
        way, course = self.speed * elapsed, self.yaw + self.drift + 0.5 * self.yaw_rate * elapsed
        x, y = self.x + way * portable.cos(course), self.y + way * portable.sin(course)
        return self._replace(t=time, x=x, y=y, yaw=self.yaw + self.yaw_rate * elapsed)


class _Run:
    """A `SimulatedPlanner` on its way."""

    def __init__(self, planner: SimulatedPlanner, drive: RoadDrive) -> None:
        self._planner, self._drive, self._rng = planner, drive, np.random.default_rng(planner.seed)
        self._pose = _Pose(0.0, *drive.start_pose(), 0.0, float(drive.plan.speed[0]), 0.0)
        self._station, self._time, self._next = 0.0, 0.0, 0.0
        self._pending: list[tuple[float, PlannedTrajectory]] = []

    def step(self, sample: Array) -> Sequence[Emitted]:
        call, planner = sample_of(sample, 0), self._planner
        now = float(call.now) + 1e-9
        if math.isfinite(call.x) and math.isfinite(call.yaw):
            drift = call.lateral_velocity / max(call.speed, 1.0)
            yaw_rate = call.yaw_rate if math.isfinite(call.yaw_rate) else 0.0
            pose = (call.t, call.x, call.y, call.yaw, drift if math.isfinite(drift) else 0.0, call.speed, yaw_rate)
            self._pose = _Pose(*map(float, pose))
        while self._next <= now:
            late = max(planner.delay + planner.jitter * self._rng.uniform(-1.0, 1.0), 0.0)
            self._pending.append((self._next + late * (self._next > 0.0), self._plan(self._next)))
            self._next += planner.period
        self._pending.sort(key=itemgetter(0))
        arrived = [Emitted(trajectory) for arrival, trajectory in self._pending if arrival <= now]
        del self._pending[: len(arrived)]
        return arrived

    def _plan(self, stamp: float) -> PlannedTrajectory:
        """Plan from a time (s) on."""
        planner, road, plan = self._planner, self._drive.road, self._drive.plan
        pose = self._pose.carried(stamp)
        foot = road.project(pose.x, pose.y, near=self._station)
        self._station = float(foot.s)
        time, begin, merge = stamp, min(self._station, float(plan.motion(stamp)[0])) - BEHIND, 0.0
        if planner.start == "pose":
            begin, merge = self._station, max(planner.merge * pose.speed, SHORTEST_MERGE)
            rest, speed = plan.motion(self._time + planner.period)
            stands = speed == 0.0 and abs(rest - begin) < AT_REST
            time = self._time + planner.period if stands else float(arrival_times(plan, np.array([begin]))[0])
        self._time = time
        end = float(plan.motion(time + planner.horizon)[0])
        if not plan.closed:  # an open road goes on behind its end
            end += max(time + planner.horizon - plan.duration, 0.0) * float(plan.speed[-1])
        s = np.linspace(begin, max(end, begin), math.ceil(max(end - begin, 0.0) / planner.spacing) + 1)
        s, waits = _with_stops(plan, s)
        t = np.minimum(arrival_times(plan, s) + waits - time, planner.horizon)
        line, share = road.at(s), np.minimum((s - begin) / max(merge, SHORTEST_MERGE), 1.0)
        slope = merge * math.tan(pose.yaw + pose.drift - float(foot.heading)) if pose.drift else 0.0
        offset = (float(foot.offset) * (1.0 + 2.0 * share) + slope * share) * (1.0 - share) ** 2 * (merge > 0.0)
        x, y = line.x - offset * portable.sin(line.heading), line.y + offset * portable.cos(line.heading)
        noise = planner.noise * self._rng.standard_normal((2, s.size))
        turn = np.gradient(offset, s) if s.size > 1 and (np.diff(s) > 0.0).all() else np.zeros(s.size)
        return PlannedTrajectory(
            t if merge == 0.0 else np.maximum(t, 0.0), x + noise[0], y + noise[1],
            yaw=line.heading + np.arctan(turn), speed=plan.at(s), stamp=stamp,
        )  # fmt: skip


def arrival_times(plan: SpeedPlan, s: Array) -> Array:
    """Times (s) at which a plan arrives at places (m) from its start, over all laps or beyond an open road."""
    length = float(plan.s[-1])
    laps = np.floor(s / length) if plan.closed else np.zeros_like(s)
    place = s - laps * length
    after = np.clip(np.searchsorted(plan.s, place), 1, plan.s.size - 1)
    mean_speed = np.maximum(0.5 * (plan.at(place) + plan.speed[after]), 1e-6)
    return laps * plan.duration + plan.time[after] - (plan.s[after] - place) / mean_speed


def _with_stops(plan: SpeedPlan, s: Array) -> tuple[Array, Array]:
    """Add the stops of a plan to places (m), twice each; also return the time (s) waited between the two."""
    length = float(plan.s[-1])
    laps = np.arange(s[0] // length, s[-1] // length + 1) if plan.closed else np.zeros(1)
    stops = [(stop.s + lap * length, stop.seconds) for lap in laps for stop in plan.stops]
    stops = [(place, seconds) for place, seconds in stops if s[0] <= place <= s[-1]]
    places = [(place, 0.0) for place in s.tolist()] + [(place, wait) for place, seconds in stops for wait in (0.0, seconds)]
    return tuple(np.array(sorted(places)).T)


class Answer(NamedTuple):
    """Answer of a `PlannedController`."""

    angle: float
    """Steering command (rad)."""
    longitudinal: SpeedCommand
    diagnostics: dict[str, float]


class PlannedController(SampledController):
    """A tracker that follows a planner, as the controller of a simulated drive: it steers, and it moves the car.

    planner: None for a tracker that has its path and plan already. Raises `InvalidInput` for a tracker without a speed
    control, and at the begin of a drive that has no road.
    """

    diagnostic_names = ("late",)

    def __init__(self, tracker: Tracker, planner: Planner | None = None) -> None:
        self.tracker, self.planner, inner = tracker, planner, tracker.controller
        self.name, self.period, self.limits, self.vehicle = inner.name, tracker.period, inner.limits, inner.vehicle
        self._run: PlannerRun | None = None

    def describe(self) -> dict[str, Any]:
        return {**self.tracker.controller.describe(), "planner": repr(self.planner)}

    def reset(self) -> None:
        self.instant = 0
        self.tracker.engage()

    def begin(self, drive: Scenario | RoadDrive) -> None:
        """Begin a drive from its start."""
        if not isinstance(drive, RoadDrive):
            raise InvalidInput(f"planner: scenario {drive.name!r} has no road to plan along: give a RoadDrive.")
        self._run = None if self.planner is None else self.planner.begin(drive)

    def answer(self, sample: Array) -> Answer:
        for emitted in () if self._run is None else self._run.step(sample):
            self.tracker.follow(emitted.trajectory, emitted.fallback, now=float(sample[TRACKER_SAMPLE.now]))
        signals = dict(zip(TRACKER_SAMPLE._fields, sample.tolist(), strict=True))
        tracked = self.tracked = self.tracker.step(**{name: signals[name] for name in _ARGUMENTS})
        if tracked.longitudinal is None:
            raise InvalidInput("PlannedController: the tracker has no speed control: give it speed=SpeedControl(car).")
        return Answer(tracked.command, tracked.longitudinal, {"late": getattr(tracked, "late", math.nan)})

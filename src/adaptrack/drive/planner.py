"""Trackers as controllers of simulated drives, and a simulated planner that they follow."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, fields
from operator import itemgetter
from types import SimpleNamespace
from typing import Annotated, Any, Literal

import numpy as np

from adaptrack.base.checked import Finite, Natural, NotNegative, Positive, checked, within
from adaptrack.base.errors import InvalidInput
from adaptrack.base.files import is_number
from adaptrack.control.controllers import Controller
from adaptrack.control.following import Following
from adaptrack.control.speed_control import SpeedControl
from adaptrack.control.tracker import Tracker
from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import Array
from adaptrack.core.models.contract import MEASUREMENT
from adaptrack.core.tracker.signals import TRACKER_SAMPLE, sample_of
from adaptrack.road import SpeedPlan
from adaptrack.road.planned_trajectory import PlannedTrajectory
from adaptrack.road.road_ahead import RoadAhead
from adaptrack.scenario import RoadDrive, Scenario

Arrivals = Sequence[tuple[PlannedTrajectory, PlannedTrajectory | None]]
"""Trajectories that arrive at a control instant, each with its fallback or None, in their order."""
BACKWARD_LENGTH = 5.0
"""m, by which a trajectory on the road begins behind the car."""
SHORTEST_MERGE = 5.0
"""m, on which a trajectory from the pose of the car returns to the road, at least."""
PAUSE_DISTANCE, PAUSE_SPEED = 1.0, 1.0
"""m, between the car and its place by the time, and planned speed (m/s), up to which time passes, for a stop to end."""
_SIGNALS = (*TRACKER_SAMPLE._fields[: TRACKER_SAMPLE.friction], "motion_time")
"""Arguments of `Tracker.step`."""


@checked
@dataclass(frozen=True)
class SimulatedPlanner:
    """Planner that knows the road and the speed plan of a drive and sends the part ahead, anew every `period`.

    A trajectory arrives `delay` after its stamp, more or less by up to `jitter`; the first one arrives at once. It
    covers `horizon`, with points at most `spacing` apart. `noise` is the standard deviation of their x and y, new in
    each trajectory.

    start: "line": trajectories lie on the road, with the times of the plan since the start of the drive. "pose": they
    begin at the measured pose of the car at the stamp and return to the road within the time `merge`, with the speeds
    of the plan, so that they hide the offset of the car. Without a measured lateral velocity they begin parallel to the
    road, otherwise in the direction of motion.
    """

    period: Annotated[Finite, within(0.001, 1000.0), "s"] = 0.1
    delay: Annotated[NotNegative, "s"] = 0.0
    jitter: Annotated[NotNegative, "s"] = 0.0
    start: Literal["line", "pose"] = "line"
    spacing: Annotated[Finite, within(0.01, 1000.0), "m"] = 1.0
    noise: Annotated[NotNegative, "m"] = 0.0
    horizon: Annotated[Finite, within(0.01, 100.0), "s"] = 4.0
    merge: Annotated[Positive, "s"] = 3.0
    seed: Natural = 0

    def begin(self, drive: RoadDrive) -> PlannerRun:
        """Return a run, at the beginning of a drive."""
        return PlannerRun(self, drive)


def make_planner(text: str) -> SimulatedPlanner:
    """Return a planner with settings such as ``period=0.1,delay=0.3,start=pose``; raises `InvalidInput`."""
    names = [field.name for field in fields(SimulatedPlanner)]
    settings: dict[str, Any] = dict(entry.partition("=")[::2] for entry in text.replace(" ", "").split(",") if entry)
    if unknown := [name for name, value in settings.items() if name not in names or not value]:
        raise InvalidInput(f"planner {text!r}: {unknown[0]!r} must be NAME=VALUE, with a name of {', '.join(names)}.")
    for name, value in settings.items():  # other text remains, and the planner refuses it
        settings[name] = int(value) if value.isdecimal() else float(value) if is_number(value) else value
    try:
        return SimulatedPlanner(**settings)
    except InvalidInput as error:
        raise InvalidInput(f"planner {text!r}: {str(error).removeprefix('SimulatedPlanner: ')}") from None


class PlannerRun:
    """A `SimulatedPlanner` during a drive."""

    def __init__(self, planner: SimulatedPlanner, drive: RoadDrive) -> None:
        self._planner, self._drive, self._rng = planner, drive, np.random.default_rng(planner.seed)
        self._station, self._plan_time, self._next = 0.0, 0.0, 0.0
        self._sample = np.full(len(TRACKER_SAMPLE), math.nan)  # the last sample with a pose
        self._sample[: TRACKER_SAMPLE.yaw_rate] = 0.0, 0.0, *drive.start_pose(), drive.plan.speed[0]
        self._pending: list[tuple[float, PlannedTrajectory]] = []

    def step(self, sample: Array) -> Arrivals:
        """Return the arrivals at the time ``now`` of a sample (`core.tracker.signals.TRACKER_SAMPLE`)."""
        planner, end = self._planner, float(sample[TRACKER_SAMPLE.now]) + 1e-9
        if np.isfinite(sample[: TRACKER_SAMPLE.yaw_rate]).all():
            self._sample = sample
        while self._next <= end:
            delay = max(planner.delay + planner.jitter * self._rng.uniform(-1.0, 1.0), 0.0)
            self._pending.append((self._next + (delay if self._next > 0.0 else 0.0), self._plan(self._next)))
            self._next += planner.period
        self._pending.sort(key=itemgetter(0))
        arrivals = [(trajectory, None) for time, trajectory in self._pending if time <= end]
        del self._pending[: len(arrivals)]
        return arrivals

    def _plan(self, stamp: float) -> PlannedTrajectory:
        """Return a trajectory from a time (s) on."""
        planner, road, plan, sample = self._planner, self._drive.road, self._drive.plan, sample_of(self._sample, 0)
        elapsed, drift = stamp - sample.t, sample.lateral_velocity / max(sample.speed, 1.0)
        way, turn = sample.speed * elapsed, np.nan_to_num(sample.yaw_rate) * elapsed
        course = sample.yaw + np.nan_to_num(drift) + 0.5 * turn
        foot = road.project(sample.x + way * portable.cos(course), sample.y + way * portable.sin(course), self._station)
        self._station, merge = float(foot.s), max(planner.merge * float(sample.speed), SHORTEST_MERGE)
        if starts_at_pose := planner.start == "pose":
            begin, elapsed = self._station, self._plan_time + planner.period
            place, speed = plan.motion(elapsed)
            is_stopping = speed < PAUSE_SPEED and abs(place - begin) < PAUSE_DISTANCE
            time = elapsed if is_stopping else max(float(arrival_times(plan, np.array([begin]))[0]), self._plan_time)
        else:
            time, begin = stamp, min(self._station, float(plan.motion(stamp)[0])) - BACKWARD_LENGTH
            begin = begin if road.closed else max(begin, 0.0)
        self._plan_time = time
        s, pauses = self._places(begin, time + planner.horizon)
        t = np.minimum(arrival_times(plan, s) + pauses - time, planner.horizon)
        if starts_at_pose:
            is_ahead = (t > 0.0) | (np.arange(s.size) == 0)
            s, t = s[is_ahead], np.maximum(t[is_ahead], 0.0)
        line = road.at(s)
        x, y, yaw = line.x, line.y, line.heading
        if starts_at_pose:
            to_go = np.maximum(1.0 - (s - begin) / merge, 0.0)
            slope = portable.tan(sample.yaw + turn + drift - float(foot.heading)) if math.isfinite(drift) else 0.0
            growth = 2.0 * float(foot.offset) / merge + slope
            tangent = float(foot.offset) + growth * (s - begin)
            offset = tangent * to_go * to_go  # a cubic, that ends along the road
            slopes = growth * to_go * to_go - 2.0 * tangent * to_go / merge
            x, y = x - offset * portable.sin(yaw), y + offset * portable.cos(yaw)
            yaw = yaw + portable.atan(slopes)
        noise = planner.noise * self._rng.standard_normal((2, s.size))
        try:
            return PlannedTrajectory(t, x + noise[0], y + noise[1], yaw=yaw, speed=plan.at(s), stamp=stamp)
        except InvalidInput as error:
            flaw = str(error).removeprefix("PlannedTrajectory: ").rpartition(": ")[0]
            where = f"its trajectory at {stamp:.4g} s is impossible ({flaw})"
            raise InvalidInput(f"planner: {where}: choose less noise, or a smaller spacing.") from None

    def _places(self, begin: float, until: float) -> tuple[Array, Array]:
        """Return places (m) from one on, up to that of the plan at a time (s), and the pauses (s) made there before.

        A stop of the plan has two places, on arrival and after its pause.
        """
        plan, road = self._drive.plan, self._drive.road
        beyond = 0.0 if road.closed else max(until - plan.duration, 0.0) * float(plan.speed[-1])
        end = max(float(plan.motion(until)[0]) + beyond, begin)
        laps = np.arange(begin // road.length, end // road.length + 1) if road.closed else [0.0]
        stops = [(stop.s + lap * road.length, stop.seconds) for lap in laps for stop in plan.stops]
        even = np.linspace(begin, end, math.ceil((end - begin) / self._planner.spacing) + 1).tolist()
        pauses = [(s, pause) for s, seconds in stops for pause in (0.0, seconds) if begin <= s <= end]
        s, seconds = np.array(sorted([*((s, 0.0) for s in even), *pauses])).T
        return s, seconds


def arrival_times(plan: SpeedPlan, s: Array) -> Array:
    """Return the times (s) at which a plan arrives at places (m), over all laps, or beyond the end of an open road."""
    length = float(plan.s[-1])
    laps = np.floor(s / length) if plan.closed else np.zeros_like(s)
    place = s - laps * length
    after = np.clip(np.searchsorted(plan.s, place), 1, plan.s.size - 1)
    mean_speed = np.maximum(0.5 * (plan.at(place) + plan.speed[after]), 1e-6)
    return np.asarray(laps * plan.duration + plan.time[after] - (plan.s[after] - place) / mean_speed)


class _SimulatedTracker(Tracker):
    """A tracker whose computation time is that of the simulation, not that of this computer."""

    def _compare_computation(self, *_: object) -> None:
        pass


class SampledController(Controller):
    """Base of controllers that answer samples of a tracker: pose in the plane, motion, and the times of both."""

    period: float
    sees_all_sensors = True
    instant = 0
    """Index of the next control instant."""

    @abstractmethod
    def answer(self, sample: Array) -> Any:
        """Return the answer to a sample (`core.tracker.signals.TRACKER_SAMPLE`), as `Controller.step` does."""

    def step(
        self, state: Any, speed: float, reference: Any, variables: Any = None, road: RoadAhead | None = None
    ) -> Any:
        time, measured = self.instant * self.period, np.asarray(state, dtype=float)
        assert road is not None
        ages = measured[[MEASUREMENT.pose_age, MEASUREMENT.motion_age]]
        age, motion_age = np.where(np.isfinite(ages), ages, 0.0).tolist()
        foot = road.road.at(road.station - age * speed)
        offset, yaw = float(measured[MEASUREMENT.y]), float(foot.heading) + float(measured[MEASUREMENT.yaw])
        x, y = float(foot.x) - offset * portable.sin(foot.heading), float(foot.y) + offset * portable.cos(foot.heading)
        motion = [MEASUREMENT.yaw_rate, MEASUREMENT.vy, MEASUREMENT.lateral_acceleration, MEASUREMENT.wheel_angle]
        sample = np.full(len(TRACKER_SAMPLE), math.nan)
        sample[: TRACKER_SAMPLE.friction] = time - age, time, x, y, yaw, speed, *measured[motion]
        sample[TRACKER_SAMPLE.motion_time] = time - motion_age
        self.instant += 1
        return self.answer(sample)


class PlannedController(SampledController):
    """A `Tracker` that follows a planner, as the controller of a drive along a road: it steers and moves the car."""

    diagnostic_names = ("late",)
    requests_forces = True
    tracker: Tracker
    """Tracker of the present drive."""

    def __init__(self, controller: Controller, speed: SpeedControl, planner: SimulatedPlanner) -> None:
        self.controller, self.speed, self.planner = controller, speed, planner
        self.period, self.limits, self.vehicle = controller.period, controller.limits, controller.vehicle
        self.belief = None if controller.learner is not None else controller.belief

    @property
    def name(self) -> str:
        """Name of the controller behind the tracker."""
        return str(self.controller.name)

    def describe(self) -> dict[str, Any]:
        return {**self.controller.describe(), "planner": str(self.planner)}

    def make_tracker(self) -> Tracker:
        """Return a tracker at the start of a drive."""
        return _SimulatedTracker(self.controller, speed=self.speed, following=Following())

    def begin(self, drive: Scenario | RoadDrive) -> None:
        """Begin a drive; raises `InvalidInput` if it has no road."""
        if not isinstance(drive, RoadDrive):
            raise InvalidInput(f"planner: {drive.name!r} has no road along which to plan: give a road.")
        self.controller.reset()
        self.instant, self.tracker, self._run = 0, self.make_tracker(), self.planner.begin(drive)

    def answer(self, sample: Array) -> SimpleNamespace:
        signals = dict(zip(TRACKER_SAMPLE._fields, sample.tolist(), strict=True))
        for trajectory, fallback in self._run.step(sample):
            self.tracker.follow(trajectory, fallback=fallback, now=signals["now"])
        tracked = self.tracked = self.tracker.step(**{name: signals[name] for name in _SIGNALS})
        late = {"late": tracked.late}
        return SimpleNamespace(angle=tracked.command, longitudinal=tracked.longitudinal, diagnostics=late)

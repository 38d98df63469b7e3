"""Trajectory follower in the structure of Autoware's, in both modes, behind a simulated planner.

    controller = AutowareController(car, planner, profile="road", mode="temporal")
    run = adaptrack.simulate(adaptrack.DualTrack(car), controller, drive, profile="road")

Each trajectory replaces the one before as it is. The lateral MPC is the package's `KinematicMPC`, which has Autoware's
structure, weights and filter; the longitudinal PID is that of `autoware_speed`. The modes differ in their reference:

- spatial: the point of the trajectory that is nearest to the car; planned speeds belong to places;
- temporal: the point for the present time. Errors, curvatures and speeds are those of the trajectory from this time on;
  only the distance to a stop is still a way.

Source: the documentation of `autoware_mpc_lateral_controller` and of `autoware_pid_longitudinal_controller` with their
published parameters, and the descriptions of the pull requests that added the temporal mode (autowarefoundation/
autoware_universe #12886) and that let time alone choose the reference (tier4/autoware_universe #3138); Apache 2.0.
Written from these descriptions; no code is copied. Left out: the smoothing of paths, the removal of steering offsets,
and the watch over the age of messages, which belongs to a different node there. A missing pose is carried on with speed
and yaw rate.
"""

from __future__ import annotations

import math
from typing import Any, Literal, NamedTuple

import numpy as np

import adaptrack as at
from adaptrack.base.errors import InvalidInput
from adaptrack.cars.vehicle import Vehicle
from adaptrack.control.speed_control import SpeedCommand, SpeedState
from adaptrack.drive.planner import PlannedController
from adaptrack.road import Comfort, Road, SpeedPlan, Stop
from adaptrack.road.road_ahead import RoadAhead
from autoware_speed import AutowareFollower, AutowareSpeed

MERGED = 0.05
"""m, between points that count as one place."""
STAGES = 120
"""Control periods for which the MPC receives planned speeds."""
DEPARTURE = 0.5
"""m, to the next stop, beyond which a standing car drives on."""


class Followed(NamedTuple):
    """A trajectory as it is followed: its line, and arc lengths (m) and speeds (m/s) at times (s)."""

    road: Road
    plan: SpeedPlan
    t: Any
    s: Any
    speed: Any


class Tracked(NamedTuple):
    """Result of one call."""

    command: float
    longitudinal: SpeedCommand
    late: float = math.nan
    suspect: tuple[str, ...] = ()
    status: str = "ok"


class TemporalFollower(AutowareFollower):
    """The longitudinal controller with a reference speed by time; `reference`: times (s) and speeds (m/s)."""

    reference: tuple[Any, Any]
    time = 0.0

    def _follow(self, station: float, distance: float, speed: float) -> tuple[float, float]:
        """Planned speed (m/s) when a request acts, and acceleration (m/s^2): feed-forward and PID."""
        p = self.settings
        delay, (times, speeds) = p.delay_compensation_time, self.reference
        due = self.time + delay
        target, before, after = np.interp([due, due - 0.1, due + 0.1], times, speeds).tolist()
        error = target - max(speed + delay * float(np.mean(self._sent)), 0.0)
        self._error = p.lpf_vel_error_gain * self._error + (1.0 - p.lpf_vel_error_gain) * error
        if speed > p.current_vel_threshold_pid_integration and p.ki > 0.0:
            most = p.max_i_effort / p.ki
            self._integral = min(max(self._integral + self._error * self._period, -most), most)
        feedback = min(max(p.kp * self._error, -p.max_out), p.max_out) + p.ki * self._integral
        wanted = (after - before) / 0.2 + min(max(feedback, -p.max_out), p.max_out)
        return target, min(max(wanted, p.min_acc), p.max_acc)


class AutowareFollow:
    """Follows trajectories, called as a `Tracker` is."""

    def __init__(self, car: Vehicle, profile: str, mode: Literal["spatial", "temporal"]) -> None:
        self.mpc, self._mode = at.KinematicMPC(car, profile=profile, preview=True), mode
        self._settings, self._followed, self._angle = AutowareSpeed(car), None, 0.0
        self._follower: Any = None
        self._pose = (0.0, 0.0, 0.0, 0.0)

    def follow(self, trajectory: at.PlannedTrajectory, fallback: Any = None, now: float = 0.0) -> None:
        """Follow a trajectory from now on; one that is no line is left out."""
        given = trajectory.points
        kept = np.append(True, np.hypot(*np.diff(given[:, 1:3], axis=0).T) > MERGED)
        points, stamp = given[kept][:, 1:3], trajectory.stamp or now
        try:
            road = at.road_through(points)
        except InvalidInput:
            return
        length = np.append(0.0, np.cumsum(np.hypot(*np.diff(points, axis=0).T)))
        length *= road.length / length[-1]
        t, speed = given[kept, 0], np.minimum.reduceat(given[:, 4], np.flatnonzero(kept))  # a rest stays a rest
        plan = SpeedPlan(length, speed, t - t[0], float(t[-1] - t[0]), False, Comfort())
        place = length[np.cumsum(kept) - 1]
        self._followed = Followed(road, plan, stamp + given[:, 0], place, given[:, 4])
        kind = TemporalFollower if self._mode == "temporal" else AutowareFollower
        before, self._follower = self._follower, kind(self._settings, road, plan, self.mpc.period)
        self._follower._stops = [  # a planner leaves out the stops that are over
            stop for stop in self._follower._stops if stamp + np.interp(stop.s, length, t) + stop.seconds > now
        ]
        if before is not None:
            fresh = {"_path": road, "_plan": plan, "_stops": self._follower._stops, "_left_at": -math.inf}
            self._follower.__dict__.update(before.__dict__ | fresh)
            is_free = not fresh["_stops"] or fresh["_stops"][0].s - self._station_of(now) > DEPARTURE
            if before._state == SpeedState.STOPPED and is_free:
                self._follower._state = SpeedState.DRIVING
        if not self._follower._stops and self._follower._state == SpeedState.STOPPED:
            self._follower._stops = [Stop(road.length, math.inf)]

    def _station_of(self, now: float) -> float:
        """Arc length (m) of the car on the trajectory that is followed."""
        _, x, y, _ = self._pose
        return float(self._followed.road.project(x, y).s)

    def step(
        self, t: float, x: float, y: float, yaw: float, speed: float, yaw_rate: float, **signals: float
    ) -> Tracked:
        """Process one sample."""
        now, age = signals["now"], self.mpc.pose_age
        if not math.isfinite(x + y + yaw):
            began, x, y, yaw = self._pose
            t, turn = now - age, np.nan_to_num(yaw_rate) * (now - age - began)
            way = speed * (t - began)
            x, y, yaw = x + way * math.cos(yaw + 0.5 * turn), y + way * math.sin(yaw + 0.5 * turn), yaw + turn
        self._pose = (t, x, y, yaw)
        followed = self._followed
        if followed is None:
            raise InvalidInput("AutowareFollow: no trajectory yet.")
        road, foot = followed.road, followed.road.project(x, y)
        station, period = float(foot.s) + speed * (now - t), self.mpc.period
        if self._mode == "spatial":
            line, place, offset = road.at(foot.s), station, float(foot.offset)
            speeds = followed.plan.at(station + speed * period * np.arange(STAGES))
            speeds = np.maximum(speeds + speed - speeds[0], 0.0)
        else:
            line, place = road.at(np.interp(t, followed.t, followed.s)), float(np.interp(now, followed.t, followed.s))
            offset = float((y - line.y) * np.cos(line.heading) - (x - line.x) * np.sin(line.heading))
            speeds = np.interp(now + period * np.arange(STAGES), followed.t, followed.speed)
            self._follower.reference, self._follower.time = (followed.t, followed.speed), now
        turned = math.remainder(yaw - float(line.heading), 2.0 * math.pi)
        state = [signals["lateral_velocity"], turned, np.nan_to_num(yaw_rate), offset]
        state[0] = float(np.nan_to_num(state[0]))
        self._angle = self.mpc.step(state, speed, np.zeros(1), road=RoadAhead(road, place, speeds)).angle
        return Tracked(self._angle, self._follower.step(station, speed, yaw_rate))


class AutowareController(PlannedController):
    """The follower as the controller of a simulated drive behind a planner."""

    def __init__(self, car: Vehicle, planner: Any, *, profile: str, mode: Literal["spatial", "temporal"]) -> None:
        super().__init__(at.KinematicMPC(car, profile=profile, preview=True), at.SpeedControl(car), planner)
        self._of = car, profile, mode

    def make_tracker(self) -> Any:
        return AutowareFollow(*self._of)

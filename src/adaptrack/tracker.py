"""A controller in anybody's loop: samples with time stamps in, steering commands out.

The controller runs at instants of its own, one period apart. A call at any time belongs to the nearest of them; a
sample is carried there by its own motion (speed, yaw and yaw rate), by half a period at most, or keeps its age in whole
periods where the controller's filter takes late samples in. Instants without a call are gone through on the estimate,
with the command that was held.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from adaptrack.controllers import MPC, Controller
from adaptrack.errors import InvalidInput, real
from adaptrack.kalman import KalmanFilter
from adaptrack.road import Road, SpeedPlan
from adaptrack.road.ahead import RoadAhead

Array = NDArray[np.float64]
_log = logging.getLogger("adaptrack")

STANDING = 0.1
"""m/s: a slower car stands, and a faster one in reverse drives backwards."""
LONGEST_GAP = 2.0
"""s without a call, after which the tracker starts anew from the command held."""
LONGEST_CARRY = 0.3
"""s, by which a sample is carried at most by its own motion."""


class Status(StrEnum):
    """What a step was."""

    OK = "ok"
    ESTIMATED = "estimated"
    """no new position: the command is that of the estimate"""
    HELD = "held"
    """no position for too long, or no solution: the command before is held; stop the car, or steer by hand"""
    STANDING = "standing"
    """the car stands, its wheels stay at rest"""
    REVERSE = "reverse"
    """the car drives backwards, which no controller here can: the command before is held"""
    OFF_PATH = "off-path"
    """further from the path than `furthest`: the command is given all the same; stop the car, or give another path"""
    END = "end"
    """beyond the end of an open path: it goes on straight; stop the car, or give another path"""
    REPEATED = "repeated"
    """a call at the time of the one before, or an earlier one: the same command"""


class Tracked(NamedTuple):
    """What a step gives."""

    command: float
    """rad, angle of the road wheels to ask for, positive to the left"""
    status: Status
    offset: float
    """m, of the car from the path, positive to the left; NaN before the first position"""
    heading_error: float
    """rad, the car's heading less the path's"""
    station: float
    """m, arc length of the car's foot on the path, over all laps"""


@dataclass(frozen=True)
class _Sample:
    t: float
    x: float
    y: float
    yaw: float
    speed: float
    yaw_rate: float
    vy: float
    lateral_acceleration: float
    wheel_angle: float

    @property
    def posed(self) -> bool:
        return math.isfinite(self.t + self.x + self.y + self.yaw)


class _Pose(NamedTuple):
    x: float
    y: float
    yaw: float

    def carried(self, time: float, speed: float, yaw_rate: float) -> _Pose:
        """After a time (s) on an arc."""
        middle = self.yaw + 0.5 * time * yaw_rate
        way = time * speed
        return _Pose(self.x + way * math.cos(middle), self.y + way * math.sin(middle), self.yaw + time * yaw_rate)


class Tracker:
    """Makes a car follow a path, called whenever a sample comes.

    Parameters
    ----------
    controller : Controller
        An MPC, or any other that takes roads. A filter that takes late samples in (``KalmanFilter(oldest=...)``, as
        for profile `production`) uses what comes late best.
    path : Road
        From points, OpenDRIVE or segments.
    plan : SpeedPlan, optional
        The speed that is planned along it; without one the present speed is expected to stay.
    furthest : float
        m from the path, beyond which the status says so.

    Raises
    ------
    InvalidInput
        When an argument is none of these.
    """

    def __init__(
        self, controller: Controller, path: Road, *, plan: SpeedPlan | None = None, furthest: float = 10.0
    ) -> None:
        if not callable(getattr(controller, "step", None)) or not callable(getattr(controller, "applied", None)):
            raise InvalidInput(f"Tracker: controller = {controller!r}: must be a controller, such as MPC(car).")
        if not real("Tracker", "furthest", furthest) > 0.0:
            raise InvalidInput(f"Tracker: furthest = {furthest!r} m: must be positive.")
        self.controller: Any = controller
        self.furthest = float(furthest)
        self._late = 0
        if isinstance(controller, MPC) and isinstance(controller.estimator, KalmanFilter):
            self._late = controller.estimator.late(controller.model)
        self._warned = False
        self._set_path(path, plan)
        self.engage()

    def _set_path(self, path: Road, plan: SpeedPlan | None) -> None:
        if not isinstance(path, Road):
            raise InvalidInput(f"Tracker: path = {path!r}: must be a Road; Road.from_points(...) makes one.")
        if plan is not None and (not isinstance(plan, SpeedPlan) or abs(plan.s[-1] - path.length) > 1e-6):
            raise InvalidInput("Tracker: plan: must be a SpeedPlan of this path; plan_speed(path, ...) makes one.")
        self.path, self.plan = path, plan

    @property
    def period(self) -> float:
        """Control period (s)."""
        return float(self.controller.period)

    def engage(self, wheel_angle: float = 0.0) -> None:
        """Begin anew, from the angle (rad) that the wheels have: the first command is near it."""
        self.controller.reset()
        self.controller.applied(wheel_angle)
        self._command = float(wheel_angle)
        self._started = False
        self._last = -math.inf
        self._speed, self._yaw_rate = 0.0, 0.0
        self._pose, self._station, self._heading, self._turned = _Pose(math.nan, math.nan, math.nan), 0.0, 0.0, 0.0

    def follow(self, path: Road, plan: SpeedPlan | None = None) -> None:
        """Another path from now on; what the controller has learned of the car stays.

        Raises
        ------
        InvalidInput
            When it is no path.
        """
        before = self._beside(self._pose, self._station) if self._started else None
        self._set_path(path, plan)
        if before is None:
            return
        self._station = float(path.project(self._pose.x, self._pose.y).s)
        offset, heading_error = self._beside(self._pose, self._station)
        self._heading = float(path.at(self._station).heading)
        self.controller.change_path(_turn(heading_error - before[1]), offset - before[0])

    def step(
        self,
        t: float,
        x: float,
        y: float,
        yaw: float,
        speed: float,
        yaw_rate: float = math.nan,
        *,
        lateral_velocity: float = math.nan,
        lateral_acceleration: float = math.nan,
        wheel_angle: float | None = None,
        now: float | None = None,
    ) -> Tracked:
        """One call: the command for now.

        t: s, when the sample was taken; x, y: m; yaw: rad, wrapped or not; speed: m/s, negative backwards; yaw_rate:
        rad/s; lateral_velocity: m/s; lateral_acceleration: m/s^2, without the pull of a bank; wheel_angle: rad, of the
        road wheels: the first call begins from it; now: s, on the same clock, when later than t. What is not known is
        NaN; a call without a position is one as well.

        Raises
        ------
        InvalidInput
            When an argument is no number, or neither t nor now is finite.
        """
        numbers = [t, x, y, yaw, speed, yaw_rate, lateral_velocity, lateral_acceleration]
        angle = math.nan if wheel_angle is None else wheel_angle
        given = _Sample(*(real("Tracker.step", "a sample", each) for each in (*numbers, angle)))
        at = given.t if now is None else real("Tracker.step", "now", now)
        if not math.isfinite(at):
            raise InvalidInput(f"Tracker.step: t = {t!r}, now = {now!r}: the time of the call must be finite.")
        if self._started and at <= self._last:
            return self._told(Status.REPEATED)
        if math.isfinite(given.speed):
            self._speed = given.speed
        if self._speed < -STANDING:
            self._restart()
            return self._told(Status.REVERSE)
        if self._started and at - self._last > LONGEST_GAP:
            self._restart()
        if not self._started:
            return self._begin(at, given)
        return self._go_on(at, given)

    def _restart(self) -> None:
        """Forget the past but the command."""
        if self._started:
            speed = self._speed
            self.engage(self._command)
            self._speed = speed

    def _begin(self, at: float, given: _Sample) -> Tracked:
        if not given.posed:
            return self._told(Status.HELD)
        if math.isfinite(given.wheel_angle):
            self.controller.applied(given.wheel_angle)
            self._command = given.wheel_angle
        self._began, self._instant, self._started = at, 0, True
        rate = given.yaw_rate if math.isfinite(given.yaw_rate) else 0.0
        self._pose = _Pose(given.x, given.y, given.yaw).carried(at - given.t, max(given.speed, 0.0), rate)
        self._station = float(self.path.project(self._pose.x, self._pose.y).s)
        self._heading = float(self.path.at(self._station).heading)
        self._last = at
        return self._control(given)

    def _go_on(self, at: float, given: _Sample) -> Tracked:
        self._last = at
        instant = round((at - self._began) / self.period)
        if instant <= self._instant:  # sooner than half a period after the last one
            return self._told(self._status(True, False))
        while self._instant < instant - 1:
            self._advance(None)
            self._control(None)
            self.controller.applied(self._command_before)
            self._command = self._command_before
        self._advance(given)
        return self._control(given)

    def _advance(self, given: _Sample | None) -> None:
        """Where the car is at the next instant."""
        self._instant += 1
        pose = self._pose.carried(self.period, max(self._speed, 0.0), self._yaw_rate)
        if given is not None and given.posed:
            age = self._time - given.t
            rate = given.yaw_rate if math.isfinite(given.yaw_rate) else self._yaw_rate
            if -self.period <= age <= (self._late + 1) * self.period + LONGEST_CARRY:
                pose = _Pose(given.x, given.y, given.yaw).carried(age, max(self._speed, 0.0), rate)
        if given is not None and math.isfinite(given.yaw_rate):
            self._yaw_rate = given.yaw_rate
        elif given is None or not given.posed:
            self._yaw_rate = self._speed * float(self.path.at(self._station).curvature)
        self._pose = pose
        near = self._station + max(self._speed, 0.0) * self.period
        self._station = float(self.path.project(pose.x, pose.y, near=near).s)
        heading = float(self.path.at(self._station).heading)
        self._turned, self._heading = heading - self._heading, heading

    @property
    def _time(self) -> float:
        """s, of the present instant."""
        return self._began + self._instant * self.period

    def _control(self, given: _Sample | None) -> Tracked:
        """One step of the controller."""
        seen = np.array([math.nan] * 6 + [0.0, 0.0, self._turned])
        fresh = given is not None and self._take(given, seen)
        state = seen if isinstance(self.controller, MPC) else _for_law(seen)
        speed = max(self._speed, 0.0)
        ahead = RoadAhead(self.path, self._station, self._speeds(speed))
        answer = self.controller.step(state, speed, np.zeros(1), road=ahead)
        self._command_before = self._command
        self._command = float(getattr(answer, "angle", answer))
        return self._told(self._status(fresh, bool(getattr(answer, "held", False))))

    def _take(self, given: _Sample, seen: Array) -> bool:
        """Write what a sample says, at the instant nearest to it; whether it has a position that can be used."""
        seen[0], seen[2], seen[5] = given.vy, given.yaw_rate, given.lateral_acceleration
        seen[4] = given.wheel_angle
        if not given.posed:
            return False
        age = self._time - given.t
        periods = min(max(round(age / self.period), 0), self._late)
        carry = age - periods * self.period
        if carry > 0.75 * self.period:  # the position can be carried on, what moves the car is another by now
            seen[[0, 2, 4, 5]] = math.nan
            self._warn_of_late_samples(age)
        if not -self.period <= carry <= LONGEST_CARRY:
            seen[:6] = math.nan
            return False
        rate = given.yaw_rate if math.isfinite(given.yaw_rate) else self._yaw_rate
        speed = max(self._speed, 0.0)
        pose = _Pose(given.x, given.y, given.yaw).carried(carry, speed, rate)
        seen[3], seen[1] = self._beside(pose, self._station - speed * periods * self.period)
        seen[6] = seen[7] = periods * self.period
        return True

    def _warn_of_late_samples(self, age: float) -> None:
        if not self._warned:
            self._warned = True
            _log.warning(
                "adaptrack: a sample came %.3g s late, and the controller takes in none older than %.3g s: its "
                "position is carried on by its speed and yaw rate. Better: an MPC with "
                "estimator=KalmanFilter(..., oldest=%.2g).",
                age, self._late * self.period, 1.5 * age,
            )  # fmt: skip

    def _beside(self, pose: _Pose, near: float) -> tuple[float, float]:
        """Offset and heading error of a pose."""
        foot = self.path.project(pose.x, pose.y, near=near)
        return float(foot.offset), _turn(pose.yaw - float(foot.heading))

    def _speeds(self, speed: float) -> Array:
        """Expected at the next instants."""
        if self.plan is None:
            return np.array([speed])
        planned = self.plan.at(self._station + max(speed, STANDING) * self.period * np.arange(80))
        return np.maximum(planned + (speed - planned[0]), 0.0)

    def _status(self, fresh: bool, held: bool) -> Status:
        offset, _ = self._beside(self._pose, self._station)
        if held:
            return Status.HELD
        if self._speed < STANDING:
            return Status.STANDING
        if not abs(offset) <= self.furthest:
            return Status.OFF_PATH
        if not self.path.closed and self._station > self.path.length:
            return Status.END
        return Status.OK if fresh else Status.ESTIMATED

    def _told(self, status: Status) -> Tracked:
        offset, heading_error = math.nan, math.nan
        if self._started:
            offset, heading_error = self._beside(self._pose, self._station)
        return Tracked(self._command, status, offset, heading_error, self._station)

    def predicted_path(self) -> Array:
        """(Np, 2) m: where the MPC expects the car at the instants from behind its dead time on.

        Raises
        ------
        InvalidInput
            When the controller predicts nothing that could be asked for, or has not been called.
        """
        if not isinstance(self.controller, MPC) or not self._started:
            raise InvalidInput("Tracker.predicted_path: needs an MPC that has made a step.")
        time, lateral = self.controller.predicted_output()
        foot = self.path.at(self._station)
        cos, sin = math.cos(float(foot.heading)), math.sin(float(foot.heading))
        ahead = max(self._speed, 0.0) * time
        return np.stack([foot.x + ahead * cos - lateral * sin, foot.y + ahead * sin + lateral * cos], axis=-1)


def yaw_of(quaternion: Sequence[float] | ArrayLike) -> float:
    """Yaw (rad, in [-pi, pi]) of a quaternion (x, y, z, w) of any length but 0, as ROS messages hold it.

    Raises
    ------
    InvalidInput
        When it has not four finite numbers, or all are 0.
    """
    q = np.asarray(quaternion, dtype=np.float64)
    if q.shape != (4,) or not np.isfinite(q).all() or not q.any():
        raise InvalidInput(f"yaw_of: {quaternion!r}: must be four finite numbers x, y, z, w, not all 0.")
    x, y, z, w = q
    return math.atan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z)


def _for_law(seen: Array) -> Array:
    """What a law is given: v_y, yaw, yaw rate, y; it has no v_y sensor where there is none, and no yaw rate is 0."""
    state = seen[:4].copy()
    state[[0, 2]] = np.nan_to_num(state[[0, 2]])
    return state


def _turn(angle: float) -> float:
    """The angle in [-pi, pi]."""
    return math.remainder(angle, 2.0 * math.pi)

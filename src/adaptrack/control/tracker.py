"""A controller in anybody's loop: samples with time stamps in, steering commands out.

The controller runs at instants of its own, one period apart. A call at any time belongs to the nearest of them, and an
instant to the nearest call. A Kalman filter is given the age of a sample and takes it in where it belongs; what it
cannot take, and what any other controller is given, is carried to the instant by the car's own motion (speed and yaw
rate). Instants without a call are gone through on the estimate, with the command that was held.
"""

from __future__ import annotations

import logging
import math
import os
import weakref
from collections.abc import Sequence
from enum import StrEnum
from typing import Annotated, Any, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import InstanceOf

from adaptrack.base.checked import Bound, Finite, Hint, checked, real, reals
from adaptrack.base.errors import InvalidInput, shown
from adaptrack.cars.vehicle import Vehicle
from adaptrack.control.controllers import MPC, BeliefState, Controller, MPCCommand, command_of
from adaptrack.control.input_check import InputCheck
from adaptrack.control.kalman import KalmanFilter
from adaptrack.control.recording import Recorder
from adaptrack.road import Road, SpeedPlan
from adaptrack.road.ahead import RoadAhead, foot_near, foot_of_car

Array = NDArray[np.float64]
_log = logging.getLogger("adaptrack")

STANDING = 0.1
"""m/s: a slower car stands, and a faster one in reverse drives backwards."""
LONGEST_GAP = 2.0
"""s without a call, or a clock that jumps back by more: the tracker begins anew from the command held. A controller
without a Kalman filter goes on for so long without a position, too."""
LONGEST_CARRY = 0.3
"""s, by which a sample is carried at most by its own motion."""
LARGEST_JUMP, JUMPS = 10.0, 3
"""m, between a position and where the car was expected, beside half of the way since: such a position is left out;
when so many come one after the other, the car was moved, and the tracker begins anew."""
FURTHEST, ABSURD = 1e8, 1e3
"""m, from the origin; SI units: no position, and no speed, rate, acceleration or angle of a car is as large: what is
counts as not measured."""
ACROSS = 10.0
"""m of distance that a foot may be nearer for a path at right angles to the car, when a path is looked for its start.
"""
SHARE_OF_LAST = 0.2
"""Share of the last interval in the mean interval between calls."""


class Status(StrEnum):
    """What a step was."""

    OK = "ok"
    """a new position was used; a call between two instants has the status of the last one"""
    ESTIMATED = "estimated"
    """no new position, or none to be believed: the command is that of the estimate"""
    HELD = "held"
    """no position yet or for too long, or no solution: the command before is held; stop the car, or steer by hand"""
    STANDING = "standing"
    """the car stands, its wheels stay at rest"""
    REVERSE = "reverse"
    """the car drives backwards, which no controller here can: the wheels are left where they are"""
    OFF_PATH = "off-path"
    """further from the path than `furthest`, or without a foot on it within 400 m of the last one (the offset is then
    NaN): a command is given all the same; stop the car, or give another path"""
    END = "end"
    """beyond the end of an open path: it goes on straight; stop the car, or give another path"""
    SLIDING = "sliding"
    """the car slides or spins: its sideslip is beyond 8.5 degrees and more than a rolling turn has; a command is given
    all the same, by a model that knows no sliding; slow down"""
    REPEATED = "repeated"
    """a call at the time of the one before, or an earlier one: it is left out, the command is the same"""


class Tracked(NamedTuple):
    """What a step gives."""

    command: float
    """rad, angle of the road wheels to ask for, positive to the left"""
    status: Status
    offset: float
    """m, of the car from the path, positive to the left; NaN where there is no position to go by"""
    heading_error: float
    """rad, the car's heading less the path's; likewise"""
    station: float
    """m, arc length of the car's foot on the path, over all laps; likewise"""
    belief: BeliefState | None = None
    """how far what the controller learns can be trusted; None where nothing is learned"""
    suspect: tuple[str, ...] = ()
    """sentences on inputs that contradict each other, since the tracker engaged; see `control.input_check`"""


class _Pose(NamedTuple):
    x: float
    y: float
    yaw: float

    def carried(self, time: float, speed: float, yaw_rate: float) -> _Pose:
        """After a time (s) on an arc."""
        middle = self.yaw + 0.5 * time * yaw_rate
        way = time * speed
        return _Pose(self.x + way * math.cos(middle), self.y + way * math.sin(middle), self.yaw + time * yaw_rate)


class _Sample(NamedTuple):
    t: float
    pose: _Pose
    yaw_rate: float
    vy: float
    lateral_acceleration: float
    wheel_angle: float

    @property
    def posed(self) -> bool:
        return math.isfinite(self.t + sum(self.pose))


NOWHERE = _Pose(math.nan, math.nan, math.nan)
DOUBTFUL = {
    BeliefState.AT_BOUND: "a learned quantity is at the end of its range: the car may be another than was thought",
    BeliefState.CONTRADICTORY: "what is measured fits no car within what is believed",
}
"""States of the belief that are warned of, once each."""
_MOST = (FURTHEST, FURTHEST, FURTHEST, *(ABSURD,) * 5)


def _believable(value: float, most: float) -> float:
    """The value, NaN where no car can have it."""
    return value if abs(value) < most else math.nan


class Tracker:
    """Makes a car follow a path, called whenever a sample comes.

    Parameters
    ----------
    controller : Controller
        An MPC, or any other that takes roads, without a scheduler. A filter that takes late samples in
        (``KalmanFilter(oldest=...)``, as for profile `production`) uses what comes late best. One without a filter is
        given the v_y of a steady turn where none is measured.
    path : Road
        From points, OpenDRIVE or segments. On one that crosses itself the car begins on the branch in its direction.
    plan : SpeedPlan, optional
        The speed that is planned along it; without one the present speed is expected to stay.
    furthest : float
        From the path, beyond which the status says so.
    record : path, optional
        A file, .parquet or .csv, to which samples and commands are written as they come: a log that `identify`,
        `shadow` and `check-loop` read. `close`, or the end of a ``with`` block, completes it.

    Raises
    ------
    InvalidInput
        When the controller has a scheduler, or the plan is not of this path, or the record has another suffix.
    StorageError
        When the record cannot be written.
    """

    @checked
    def __init__(
        self,
        controller: Annotated[InstanceOf[Controller], Hint("such as MPC(car)")],
        path: Road,
        *,
        plan: SpeedPlan | None = None,
        furthest: Annotated[Bound, "m"] = 10.0,
        record: str | os.PathLike[str] | None = None,
    ) -> None:
        if controller.scheduler is not None:
            raise InvalidInput(
                "Tracker: the controller has a scheduler, and nobody here knows its scheduling variables: give a "
                "controller with a constant tuning."
            )
        self.controller: Any = controller
        self.furthest = furthest
        self._filtered = isinstance(controller, MPC) and isinstance(controller.estimator, KalmanFilter)
        self._late = controller.estimator.late(controller.model) if self._filtered else 0  # type: ignore[attr-defined]
        self._car = controller.vehicle
        self._warned = False
        self._doubted: set[int] = set()
        self._set_path(path, plan)
        self._recorder = None if record is None else Recorder(record)
        if self._recorder is not None:
            weakref.finalize(self, self._recorder.close)
        self.engage()

    def _set_path(self, path: Road, plan: SpeedPlan | None) -> None:
        if not isinstance(path, Road):
            raise InvalidInput(f"Tracker: path = {path!r}: must be a Road; fit_road(...) makes one.")
        if plan is not None and (not isinstance(plan, SpeedPlan) or abs(plan.s[-1] - path.length) > 1e-6):
            raise InvalidInput("Tracker: plan: must be a SpeedPlan of this path; plan_speed(path, ...) makes one.")
        self.path, self.plan = path, plan

    def __repr__(self) -> str:
        planned = "planned speed" if self.plan is not None else "no plan of the speed"
        return f"<Tracker of {self.path!r}, {planned}, by {self.controller!r}>"

    @property
    def period(self) -> float:
        """Control period (s)."""
        return float(self.controller.period)

    @checked
    def engage(self, wheel_angle: Annotated[Finite, "rad"] = 0.0) -> None:
        """Begin anew, from the angle that the wheels have: the first command is near it.

        What a controller has learned of its car stays; what was said of the inputs is forgotten.
        """
        self._check = InputCheck(self._car, self.period)
        self._engage(wheel_angle)

    def close(self) -> None:
        """Complete the record; nothing where there is none.

        Raises
        ------
        StorageError
            When it cannot be written.
        """
        if self._recorder is not None:
            self._recorder.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def _engage(self, wheel_angle: float) -> None:
        """Begin anew; the check of the inputs goes on."""
        self.controller.restart()
        self._hold(wheel_angle)
        self._started = False
        self._last, self._between = -math.inf, self.period
        self._tracked = Tracked(self._command, Status.HELD, *NOWHERE)
        self._answered: Tracked | None = None
        self._speed, self._yaw_rate = math.nan, 0.0
        self._pose, self._newest, self._jumps = NOWHERE, -math.inf, 0
        self._placed = NOWHERE, -math.inf
        self._station = self._heading = self._turned = 0.0

    def _hold(self, angle: float) -> None:
        """Let an angle (rad) be the command before, as far as the controller's limits go."""
        limits = self.controller.limits
        self._command = float(angle) if limits is None else min(max(float(angle), limits.angle[0]), limits.angle[1])
        self.controller.applied(self._command)

    def follow(self, path: Road, plan: SpeedPlan | None = None) -> None:
        """Another path from now on, with its plan; what the controller has learned of the car stays.

        The path had better begin behind the car, by the age of the oldest samples at least.

        Raises
        ------
        InvalidInput
            When it is no path.
        """
        before = self._beside(self._pose, self._station) if self._started else None
        self._set_path(path, plan)
        if before is None:
            return
        self._station = foot_of_car(path, *self._pose, ACROSS)
        offset, heading_error = self._beside(self._pose, self._station)
        self._heading = float(path.at(self._station).heading)
        if abs(offset - before[0]) < ABSURD:
            self.controller.change_path(_turn(heading_error - before[1]), offset - before[0])
        else:  # too far from one of them to say by how much
            self._restart()

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

        t: s, when the sample was taken; x, y: m, of the centre of mass; yaw: rad, wrapped or not; speed: m/s, negative
        backwards; yaw_rate: rad/s; lateral_velocity: m/s; lateral_acceleration: m/s^2, without the pull of a bank;
        wheel_angle: rad, of the road wheels: where it is given, the first command is near it; now: s, on the same
        clock, when later than t. What is not known is NaN; a call without a position is one as well. What no car can
        have (`FURTHEST`, `ABSURD`), and all but the speed of a sample that is `LONGEST_GAP` old, counts as not known.

        Raises
        ------
        InvalidInput
            When an argument is no number, or neither t nor now is finite.
        """
        numbers = [t, x, y, yaw, speed, yaw_rate, lateral_velocity, lateral_acceleration]
        numbers.append(math.nan if wheel_angle is None else wheel_angle)
        taken, *rest = (real("Tracker.step", "a sample", each) for each in numbers)
        at = taken if now is None else real("Tracker.step", "now", now)
        if not math.isfinite(at):
            raise InvalidInput(f"Tracker.step: t = {t!r}, now = {now!r}: the time of the call must be finite.")
        *where, forward, rate, vy, pull, angle = map(_believable, rest, _MOST)
        given = sample = _Sample(taken, _Pose(*where), rate, vy, pull, angle)
        if abs(at - taken) > LONGEST_GAP:
            given = _Sample(math.nan, NOWHERE, *(math.nan,) * 4)
        if self._started and self._last - LONGEST_GAP <= at <= self._last:
            return self._tracked._replace(status=Status.REPEATED)
        if math.isfinite(forward):
            self._speed = forward
        if self._started and (self._speed < -STANDING or abs(at - self._last) > LONGEST_GAP):
            self._restart()
        before = self._command
        tracked = self._go_on(at, given) if self._started else self._begin(at, given)
        tracked = self._tracked = self._checked(at, sample, forward, tracked, before)
        if self._recorder is not None:
            values = forward, rate, vy, pull, angle, *where
            self._recorder.add(taken, at, values, tracked.command, tracked.offset)
        return tracked

    def _checked(self, at: float, given: _Sample, speed: float, tracked: Tracked, before: float) -> Tracked:
        """What a step gives, with what contradictory inputs and sliding make of it; before: the last command (rad)."""
        check = self._check
        new = check.add(given.t, at, given.pose, speed, given.yaw_rate, given.vy, given.lateral_acceleration,
                        given.wheel_angle, tracked.command)  # fmt: skip
        for sentence in new:
            _log.warning("adaptrack: inputs contradict each other. %s", sentence)
        status = tracked.status
        if check.sliding and status in (Status.OK, Status.ESTIMATED, Status.REVERSE):
            status = Status.SLIDING
        if check.against_steering and tracked is not self._answered:  # steering on would drive it further away
            most = 0.5 * self.period if self.controller.limits is None else self.controller.limits.move[1]
            self._hold(before - min(max(before, -most), most))
            status = Status.HELD
        self._answered = tracked._replace(command=self._command, status=status, suspect=check.suspect)
        return self._answered

    def _restart(self) -> None:
        """Forget the past but the command and the speed."""
        speed = self._speed
        self._engage(self._command)
        self._speed = speed

    def _begin(self, at: float, given: _Sample) -> Tracked:
        """The first call, or one that is still no beginning."""
        if math.isfinite(given.wheel_angle):
            self._hold(given.wheel_angle)
        age = at - given.t
        if self._speed < -STANDING:
            return Tracked(self._command, Status.REVERSE, *NOWHERE)
        if not (given.posed and math.isfinite(self._speed) and -self.period <= age <= LONGEST_CARRY):
            return Tracked(self._command, Status.HELD, *NOWHERE)
        self._began = self._last = at
        self._instant, self._started, self._newest = 0, True, given.t
        self._placed = given.pose, given.t
        self._yaw_rate = given.yaw_rate if math.isfinite(given.yaw_rate) else 0.0
        self._pose = given.pose.carried(age, self._forward, self._yaw_rate)
        self._station = foot_of_car(self.path, *self._pose, ACROSS)
        self._heading = float(self.path.at(self._station).heading)
        return self._control(given._replace(t=at, pose=self._pose))

    def _go_on(self, at: float, given: _Sample) -> Tracked:
        """A call that follows others."""
        given = self._placed_anew(given)
        self._between += SHARE_OF_LAST * (min(at - self._last, self.period) - self._between)
        self._last = at
        instant = math.floor((at - self._began + 0.5 * self._between) / self.period)
        if instant <= self._instant:  # another call is nearer to the next instant
            return self._tracked
        if self._has_jumped(at, given):
            self._jumps += 1
            if self._jumps == JUMPS:
                self._restart()
                return self._begin(at, given)
            given = given._replace(pose=NOWHERE)
        elif given.posed:
            self._jumps = 0
        while self._instant < instant - 1:
            held = self._command
            self._advance(None)
            self._control(None)
            self._hold(held)
        self._advance(given)
        return self._control(given)

    def _placed_anew(self, given: _Sample) -> _Sample:
        """The sample, without a pose that is the one before under a later time stamp: a car that moves has another."""
        pose, t = self._placed
        if given.pose == pose and given.t > t and self._forward > STANDING:
            return given._replace(pose=NOWHERE)
        if given.posed:
            self._placed = given.pose, given.t
        return given

    def _has_jumped(self, at: float, given: _Sample) -> bool:
        """Whether a position is far from where the car was expected."""
        if not given.posed:
            return False
        since = at - self._time
        expected = self._pose.carried(since, self._forward, self._yaw_rate)
        found = given.pose.carried(at - given.t, self._forward, self._yaw_rate)
        distance = math.hypot(found.x - expected.x, found.y - expected.y)
        return distance > LARGEST_JUMP + 0.5 * self._forward * abs(since)

    @property
    def _forward(self) -> float:
        """m/s, the speed of a car that does not drive backwards."""
        return max(self._speed, 0.0)

    @property
    def _time(self) -> float:
        """s, of the present instant."""
        return self._began + self._instant * self.period

    def _advance(self, given: _Sample | None) -> None:
        """Where the car is at the next instant, by the latest sample and its motion since."""
        self._instant += 1
        if given is not None and math.isfinite(given.yaw_rate):
            self._yaw_rate = given.yaw_rate
        else:
            self._yaw_rate = self._forward * float(self.path.at(self._station).curvature)
        pose = self._pose.carried(self.period, self._forward, self._yaw_rate)
        if given is not None and given.posed and given.t > self._newest:
            age = self._time - given.t
            if -self.period <= age <= self._late * self.period + LONGEST_CARRY:
                pose = given.pose.carried(age, self._forward, self._yaw_rate)
        self._pose = pose
        foot = foot_near(self.path, pose.x, pose.y, self._station + self._forward * self.period)
        if math.isnan(foot.offset):
            self._turned = 0.0
            return
        self._station = float(foot.s)
        heading = float(self.path.at(self._station).heading)
        self._turned, self._heading = heading - self._heading, heading

    def _control(self, given: _Sample | None) -> Tracked:
        """One step of the controller."""
        measured, fresh = self._measurement(given)
        state = measured if isinstance(self.controller, MPC) else measured[:4]
        self._ahead = RoadAhead(self.path, self._station, self._speeds())
        answered = self.controller.step(state, self._forward, np.zeros(1), road=self._ahead)
        answer, belief = command_of(answered, self._command), self._belief_of(answered)
        self._command = answer.angle
        offset, heading_error = self._beside(self._pose, self._station)
        status = self._status(offset, fresh, answer.held)
        station = math.nan if math.isnan(offset) else self._station
        self._tracked = Tracked(self._command, status, offset, heading_error, station, belief)
        return self._tracked

    def _belief_of(self, answer: object) -> BeliefState | None:
        """The state of the belief, warned of where it is doubtful."""
        if not isinstance(answer, MPCCommand) or answer.belief_state is None:
            return None
        state, bound = answer.belief_state, answer.belief_at_bound
        if state in DOUBTFUL and state not in self._doubted:
            self._doubted.add(state)
            _log.warning("adaptrack: the belief about the car is in doubt: %s%s; drive slower, see docs/learning.md.",
                         DOUBTFUL[state], f" ({bound.replace('_', ' ')})" if bound else "")  # fmt: skip
        return state

    def _measurement(self, given: _Sample | None) -> tuple[Array, bool]:
        """What the controller is given (`models.MEASURED`), and whether a new position is among it."""
        measured = np.array([math.nan] * 6 + [0.0, 0.0, self._turned])
        fresh = given is not None and self._take(given, measured)
        if not self._filtered:
            drift = measured[0]
            measured[:6] = math.nan
            if self._time - self._newest <= LONGEST_GAP:
                known = drift if math.isfinite(drift) else _steady_drift(self._car, self._forward, self._yaw_rate)
                measured[0], measured[2] = known, self._yaw_rate
                measured[3], measured[1] = self._beside(self._pose, self._station)
        return measured, fresh

    def _take(self, given: _Sample, measured: Array) -> bool:
        """Write what a sample says and how old it is; whether it has a position that can be used."""
        period = self.period
        age = self._time - given.t if math.isfinite(given.t) else 0.0
        declared = min(max(age, -0.5 * period), (self._late + 0.499) * period)
        carry = age - declared
        if abs(carry) <= 0.25 * period:  # a position can be carried on, what moves the car is another by then
            measured[[0, 2, 4, 5]] = given.vy, given.yaw_rate, given.wheel_angle, given.lateral_acceleration
        elif given.posed:
            self._warn_of_late_samples(age)
        measured[6] = measured[7] = declared
        known = given.t <= self._newest and self._instant > 0
        if not (given.posed and -period <= carry <= LONGEST_CARRY) or (known and not self._late):
            return False
        if self._instant > 0:
            self._newest = max(self._newest, given.t)
        pose = given.pose.carried(carry, self._forward, self._yaw_rate)
        measured[3], measured[1] = self._beside(pose, self._station - self._forward * declared)
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
        """Offset and heading error of a pose; NaN where it has no foot."""
        foot = foot_near(self.path, pose.x, pose.y, near)
        if math.isnan(foot.offset):
            return math.nan, math.nan
        return float(foot.offset), _turn(pose.yaw - float(foot.heading))

    def _speeds(self) -> Array:
        """Expected at the next instants."""
        speed = self._forward
        if self.plan is None:
            return np.array([speed])
        planned = self.plan.at(self._station + max(speed, STANDING) * self.period * np.arange(80))
        return np.maximum(planned + (speed - planned[0]), 0.0)

    def _status(self, offset: float, fresh: bool, held: bool) -> Status:
        if math.isnan(offset):
            return Status.OFF_PATH
        if held:
            return Status.HELD
        if self._speed < STANDING:
            return Status.STANDING
        if not abs(offset) <= self.furthest:
            return Status.OFF_PATH
        if not self.path.closed and self._station > self.path.length:
            return Status.END
        return Status.OK if fresh else Status.ESTIMATED

    def predicted_path(self) -> Array:
        """(Np, 2) m: where the MPC expects the car at the instants from behind its dead time on, as of its last step.

        Raises
        ------
        InvalidInput
            When the controller is no `MPC`, or has not been called.
        """
        if not isinstance(self.controller, MPC) or not self._started:
            raise InvalidInput("Tracker.predicted_path: needs an MPC that has made a step.")
        time, lateral = self.controller.predicted_output()
        delay = time[0] / self.period - 1.0
        forward = max(self._forward, self.controller.speed_floor)
        offset = lateral - self._ahead.bend(time.size + 1, forward, delay, self.period)[1:]
        speeds = self._ahead.speeds
        way = np.concatenate([[0.0], np.cumsum(speeds) * self.period])
        last = self.period * speeds.size
        gone = np.interp(time, self.period * np.arange(way.size), way) + speeds[-1] * np.maximum(time - last, 0.0)
        foot = self._ahead.road.at(self._ahead.station + gone)
        return np.stack([foot.x - offset * np.sin(foot.heading), foot.y + offset * np.cos(foot.heading)], axis=-1)


def yaw_of(quaternion: Sequence[float] | ArrayLike) -> float:
    """Yaw (rad, in [-pi, pi]) of a quaternion (x, y, z, w) of any length but 0, as ROS messages hold it.

    Raises
    ------
    InvalidInput
        When it has not four finite numbers, or all are 0.
    """
    q = reals("yaw_of: quaternion", quaternion)
    if q.shape != (4,) or not np.isfinite(q).all() or not q.any():
        raise InvalidInput(f"yaw_of: {shown(quaternion)}: must be four finite numbers x, y, z, w, not all 0.")
    x, y, z, w = q
    return math.atan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z)


def _steady_drift(vehicle: Vehicle | None, speed: float, yaw_rate: float) -> float:
    """v_y (m/s) of a steady turn, (l_r - m l_f v^2/(2 C_r L)) r; 0 where the car is not known.

    R. Rajamani, *Vehicle Dynamics and Control*, 2nd ed., section 3.3: the slip of the rear axle.
    """
    if vehicle is None:
        return 0.0
    slip = vehicle.mass * vehicle.lf * speed**2 / (2.0 * vehicle.stiffness_rear * vehicle.wheelbase)
    return (vehicle.lr - slip) * yaw_rate


def _turn(angle: float) -> float:
    """The angle in [-pi, pi]."""
    return math.remainder(angle, 2.0 * math.pi)

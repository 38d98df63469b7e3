"""What the node does, without ROS: messages come in when they come, `tick` gives the command of each period."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

import adaptrack as at
from adaptrack.control.following import DrivenBy, Following, PlannerFollower, Verdict
from adaptrack.control.tracker import Tracked
from adaptrack.road import Comfort, SpeedPlan
from adaptrack.road.planned_trajectory import PlannedTrajectory
from adaptrack_ros.messages import Array, Motion, Sample, frame_of_motion, motion_of, points_of, sample_of, speeds_of

OK, WARN, ERROR = 0, 1, 2
"""Levels of a diagnostic_msgs/DiagnosticStatus."""
CLOCK_JUMP = 2.0
"""s: stamps that are older than the newest by more begin anew, as when a bag starts again."""
MOTION_MESSAGES = "geometry_msgs/TwistStamped", "nav_msgs/Odometry", "sensor_msgs/Imu"
"""Messages from which speed and yaw rate can come, of an Imu the yaw rate alone."""
POSE_MESSAGES = {
    "nav_msgs/Odometry": ("odometry", "odom"), "geometry_msgs/PoseStamped": ("pose", "pose"), "tf": ("transform", "tf"),
}  # fmt: skip
"""Sources of the pose: noun and topic. Only an odometry has a motion."""
DRIVE_MESSAGES = "ackermann_msgs/AckermannDriveStamped", "autoware_control_msgs/Control"
PATH_MESSAGES = "nav_msgs/Path", "autoware_planning_msgs/Trajectory"
STOPPING = {
    at.Status.HELD: "no position for 3 s, no solution, or a steering of the other sign",
    at.Status.REVERSE: "the car rolls backwards",
    at.Status.OFF_PATH: "the car is too far from the path",
    at.Status.END: "the car is beyond the end of the path",
}
"""Statuses on which the car is stopped, and what the diagnostics say."""
NO_PATH = "no path yet on topic path"
NO_PLANNER = "the planner is silent"
ON_FALLBACK = f"{NO_PLANNER}: the car follows the fallback"
FOLLOW = "path", "trajectory"
"""What is followed of the messages on the topic `path`."""
SHORT_STEP = 0.02
"""m, from a predicted point to the next, below which the yaw stays: the car hardly moves."""
LEAST_ACCELERATION = 0.01
"""m/s^2, smallest magnitude that is sent: 0 means as quickly as possible in an AckermannDrive."""


@dataclass(frozen=True)
class Parameters:
    """The node's parameters, as in config/follower.yaml."""

    vehicle: str = "midsize-sedan"
    """a car of adaptrack, or a file of `adaptrack identify`"""
    profile: str = "production"
    """control period, and the noise of the sensors: a name, or a file"""
    command_delay: float = 0.05
    """s, from a tick until the steering gets the command; its own dead time is the car's"""
    oldest_sample: float = 0.25
    """s; odometry up to this age is taken in where it belongs"""
    pose_message: str = "nav_msgs/Odometry"
    """one of `POSE_MESSAGES`: nav_msgs/Odometry on the topic `odom`, geometry_msgs/PoseStamped on `pose`, or tf"""
    map_frame: str = "map"
    """frame in which tf gives the pose of the base frame"""
    base_frame: str = "base_link"
    """frame of the car: child frame that the odometry must have, and frame of the motion"""
    base_ahead: float = 0.0
    """m, from the centre of the rear axle forwards to the origin of the base frame"""
    motion_message: str = ""
    """one of `MOTION_MESSAGES` on the topic `motion`, with stamps of its own; empty: the motion is that of `odom`"""
    drive_message: str = "ackermann_msgs/AckermannDriveStamped"
    """or autoware_control_msgs/Control, whose acceleration only a speed control requests"""
    path_message: str = "nav_msgs/Path"
    """or autoware_planning_msgs/Trajectory"""
    follow: str = "path"
    """or trajectory: the times of its points are followed as well, of a nav_msgs/Path the stamps of its poses"""
    path_latched: bool = False
    """whether the planner publishes with durability transient local"""
    top_speed: float = 10.0
    """m/s, beside what the bends allow; and beside the speeds of the path, where it has some; of a trajectory, which
    states its speeds, when the car is late"""
    stop_at_end: bool = True
    """plan to stand at the end of every path; not where the path has speeds"""
    acceleration: float = 1.5
    """m/s^2, how fast the speed may be changed"""
    speed_control: bool = False
    """control the speed: speed and acceleration of a command are then requests of adaptrack's speed control"""
    stop_deceleration: float = 3.0
    """m/s^2, of the safe command"""
    longest_silence: float = 0.3
    """s, age of the newest pose or speed from which on the car is stopped"""
    furthest: float = 3.0
    """m from the path, from which on the car is stopped"""

    def __post_init__(self) -> None:
        for name in ("top_speed", "acceleration", "stop_deceleration", "longest_silence", "furthest"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise at.InvalidInput(f"{name} = {getattr(self, name)!r}: must be positive and finite.")
        for name, messages in (
            ("pose_message", tuple(POSE_MESSAGES)), ("drive_message", DRIVE_MESSAGES), ("path_message", PATH_MESSAGES),
            ("motion_message", ("", *MOTION_MESSAGES)), ("follow", FOLLOW),
        ):  # fmt: skip
            if getattr(self, name) not in messages:
                names = ", ".join(message or "empty" for message in messages)
                raise at.InvalidInput(f"{name} = {getattr(self, name)!r}: must be one of {names}.")
        if self.pose_message != "nav_msgs/Odometry" and self.motion_message not in MOTION_MESSAGES[:2]:
            raise at.InvalidInput(
                f"pose_message = {self.pose_message!r} has no speed: give motion_message = {MOTION_MESSAGES[0]} or "
                f"{MOTION_MESSAGES[1]}."
            )


class Command(NamedTuple):
    """What is sent."""

    angle: float
    """rad, of the road wheels, positive to the left"""
    speed: float
    """m/s"""
    acceleration: float
    """m/s^2, > 0, how fast to change to it"""
    stopping: str = ""
    """why it is the safe command; empty when it is not"""
    angle_rate: float = 0.0
    """rad/s, of the angle since the command before"""
    request: float = math.nan
    """m/s^2, dv/dt of the speed control or the safe command; NaN: none"""


class Follower:
    """Follows the newest path by the newest odometry.

    Raises
    ------
    adaptrack.InvalidInput
        When a parameter is not possible, or names a car or profile that there is not.
    """

    def __init__(self, parameters: Parameters | None = None) -> None:
        self.parameters = p = parameters or Parameters()
        self.car = at.load_vehicle(p.vehicle)
        self.profile = at.load_profile(p.profile)
        self._tracker: at.Tracker | None = None
        self._points: Array = np.empty((0, 2))
        self._speeds: Array | None = None
        self._path_frame, self._pose_frame = "", ""
        self._fresh: Sample | None = None
        self._fresh_motion: Motion | None = None
        self._newest_motion, self._newest_speed = -math.inf, -math.inf
        self._newest, self._speed, self._braked = -math.inf, 0.0, -math.inf
        self._halted, self._engaged, self._angle = False, True, 0.0
        self._trouble: dict[str, str] = {}
        self._tracked: Tracked | None = None
        self._verdict: Verdict | None = None
        self._fallback: tuple[Any, float] | None = None  # message and time of arrival, until a trajectory takes it
        self._fallback_time, self._last_tick = -math.inf, -math.inf
        self._command = Command(0.0, 0.0, p.stop_deceleration, NO_PATH, request=-p.stop_deceleration)

    @property
    def period(self) -> float:
        """s, between ticks."""
        return float(self.profile.period)

    def controller(self) -> at.MPC:
        """A new controller of this car."""
        sensors = replace(at.KalmanFilter.from_profile(self.profile), oldest=self.parameters.oldest_sample)
        return at.MPC(self.car, profile=self.profile, computation=self.parameters.command_delay, estimator=sensors)

    def speed_control(self) -> at.SpeedControl | None:
        """The speed control of this car; None without the parameter. Whether a path ends in a stop, its plan says."""
        return at.SpeedControl(self.car, stop_at_end=False) if self.parameters.speed_control else None

    @property
    def following(self) -> Following | None:
        """How trajectories of the rear axle are followed; None where paths are."""
        if self.parameters.follow == "path":
            return None
        return Following(tracked_point="rear axle", comfort=self.comfort, speed_limit=self.parameters.top_speed)

    @property
    def comfort(self) -> Comfort:
        """Accelerations of a plan."""
        return Comfort(accelerate=self.parameters.acceleration, brake=self.parameters.acceleration)

    def warm_up(self) -> None:
        """Have everything compiled and loaded before the car moves: on a straight, with a controller of its own."""
        straight = np.stack([np.arange(50.0), np.zeros(50)], axis=-1)
        road, plan = self._planned(straight, None)
        tracker = at.Tracker(self.controller(), road, plan=plan, speed=self.speed_control())
        for k in range(3):
            tracker.step(k * self.period, 5.0 + k * self.period * 5.0, 0.1, 0.0, 5.0, 0.0)

    # -- what comes in ------------------------------------------------------------------------------------------------
    def pose(self, message: Any) -> None:
        """A message of `POSE_MESSAGES`, of tf a geometry_msgs/TransformStamped, in whatever order.

        One that cannot be used is left out, and the diagnostics say why.
        """
        try:
            self._check_frame(getattr(message, "child_frame_id", ""))
            sample = sample_of(message, self.parameters.base_ahead - self.car.lr)
        except at.InvalidInput as error:
            self.miss_pose(str(error))
            return
        self._trouble.pop("pose", None)
        self._pose_frame = message.header.frame_id
        if self._newest - CLOCK_JUMP <= sample.t <= self._newest:
            if self._fresh is None and sample.t < self._newest:
                self._fresh = sample  # overtaken by one that has been used; the filter takes it in where it belongs
            return
        self._fresh, self._newest = sample, sample.t
        if self._newest_speed == -math.inf and math.isfinite(sample.speed):
            self._speed = sample.speed

    def miss_pose(self, why: str) -> None:
        """Let the diagnostics say why there is no pose."""
        self._trouble["pose"] = why

    def _check_frame(self, frame: str) -> None:
        """Refuse a message about a frame that is not the base frame."""
        base = self.parameters.base_frame
        if frame and base and frame != base:
            raise at.InvalidInput(f"it is of frame {frame!r}, and base_frame is {base!r}")

    def motion(self, message: Any) -> None:
        """One of `MOTION_MESSAGES`; from the first one on the twist of the odometry is not used, but for its speed."""
        try:
            self._check_frame(frame_of_motion(message))
            motion = motion_of(message)
        except at.InvalidInput as error:
            self._trouble["motion"] = str(error)
            return
        self._trouble.pop("motion", None)
        if self._newest_motion - CLOCK_JUMP <= motion.t <= self._newest_motion:
            return
        self._fresh_motion, self._newest_motion = motion, motion.t
        if math.isfinite(motion.speed):
            self._speed, self._newest_speed = motion.speed, motion.t

    def path(self, message: Any, now: float | None = None) -> None:
        """A nav_msgs/Path or an autoware_planning_msgs/Trajectory; an empty one stops the car.

        One that cannot be driven is refused, the one before is followed on, and the diagnostics say why. now: s, of
        its arrival, for a trajectory; None: at the last tick.
        """
        if self.parameters.follow == "trajectory":
            self._follow_trajectory(message, self._last_tick if now is None else now)
            return
        points, speeds = points_of(message), speeds_of(message)
        self._halted = len(points) == 0
        if self._halted or self._is_known(points, speeds, message.header.frame_id):
            return
        try:
            road, plan = self._planned(points, speeds)
            if self._tracker is None:
                self._tracker = at.Tracker(
                    self.controller(), road, plan=plan, speed=self.speed_control(), furthest=self.parameters.furthest
                )
                self._tracker.engage(self._angle)
            else:
                self._tracker.follow(road, plan)
        except at.InvalidInput as error:
            self._trouble["path"] = str(error)
            return
        self._trouble.pop("path", None)
        self._points, self._speeds, self._path_frame = points, speeds, message.header.frame_id

    def fallback(self, message: Any, now: float) -> None:
        """Hold a fallback, a message as of `path` that ends at rest, for the next trajectory; now: s, of its arrival.

        Only the newest is held, and it is handed over once. One that cannot be used is left out then.
        """
        self._fallback = message, now

    def _take_fallback(self, stamp: float, frame: str, now: float) -> PlannedTrajectory | None:
        """The held fallback for a trajectory with a stamp (s) that arrives at a time (s); None: none is held.

        Raises
        ------
        adaptrack.InvalidInput
            When it is not possible, is stale, or is in a different frame than the trajectory.
        """
        if self._fallback is None:
            return None
        message, arrival = self._fallback
        if message.header.frame_id != frame:
            raise at.InvalidInput(f"it is in frame {message.header.frame_id!r}, the trajectory in {frame!r}")
        fallback = PlannedTrajectory.from_message(message)
        age = stamp - fallback.stamp if stamp > 0.0 and fallback.stamp > 0.0 else now - arrival
        if age > Following.oldest:
            raise at.InvalidInput(f"it is {Verdict.STALE}")
        PlannerFollower.check_fallback(fallback)
        return fallback

    def _follow_trajectory(self, message: Any, now: float) -> None:
        """Follow a trajectory by its times; an empty one is the silence of its planner."""
        frame, flaw = message.header.frame_id, ""
        try:
            if self._tracker is None:
                self._tracker = at.Tracker(
                    self.controller(), speed=self.speed_control(), following=self.following,
                    furthest=self.parameters.furthest,
                )  # fmt: skip
                self._tracker.engage(self._angle)
            trajectory, fallback = PlannedTrajectory.from_message(message), None
            try:
                fallback = self._take_fallback(trajectory.stamp, frame, now)
            except at.InvalidInput as error:
                flaw = str(error).removeprefix("Tracker.follow: fallback: ")
            self._verdict = self._tracker.follow(trajectory, fallback=fallback, now=now)
        except at.InvalidInput as error:
            self._trouble["path"] = str(error)
            return
        self._path_frame = frame
        self._trouble.pop("path", None)
        is_followed = self._verdict in (Verdict.TAKEN, Verdict.SAME)
        if not is_followed:
            self._trouble["path"] = f"it is {self._verdict}"
        if flaw:
            self._trouble["fallback"], self._fallback = flaw, None
        elif fallback is not None and is_followed:
            self._trouble.pop("fallback", None)
            self._fallback, self._fallback_time = None, now

    def engage(self, on: bool, wheel_angle: float = 0.0) -> None:
        """Begin to drive from the angle (rad) that the wheels have, or leave the car to somebody else."""
        self._engaged, self._angle = on, wheel_angle
        self._command = self._command._replace(angle=wheel_angle)
        if on and self._tracker is not None:
            self._tracker.engage(wheel_angle)

    def _is_known(self, points: Array, speeds: Array | None, frame: str) -> bool:
        """Whether the planner has only said the same again."""
        same = np.array_equal(points, self._points) and frame == self._path_frame
        if speeds is None or self._speeds is None:
            return same and speeds is self._speeds
        return same and np.array_equal(speeds, self._speeds)

    def _planned(self, points: Array, speeds: Array | None) -> tuple[at.Road, SpeedPlan]:
        """A path as a road, and the speed along it."""
        p, road = self.parameters, at.road_through(points)
        comfort = self.comfort
        if speeds is None:
            end = 0.0 if p.stop_at_end else None
            return road, at.plan_speed(road, self.car, comfort, end=end, top_speed=p.top_speed)
        if not (np.isfinite(speeds).all() and speeds.min() >= 0.0):
            raise at.InvalidInput("path: its speeds must be finite and >= 0 m/s: nothing here drives backwards.")
        way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
        s, v = way * (road.length / way[-1]), np.minimum(speeds, p.top_speed)
        stands = np.where(v[:-1] == 0.0, math.inf, 0.0)  # until another path
        stands[0] = 0.0
        with np.errstate(divide="ignore", invalid="ignore"):
            moving = np.where(np.diff(s) > 0.0, np.diff(s) / (0.5 * (v[1:] + v[:-1])), 0.0)
        time = np.concatenate([[0.0], np.cumsum(stands + moving)])
        return road, SpeedPlan(s, v, time, float(time[-1]), False, comfort)

    # -- what goes out ------------------------------------------------------------------------------------------------
    def tick(self, now: float) -> Command | None:
        """The command for now (s, on the clock of the stamps), once per period; None while somebody else drives."""
        fresh, self._fresh = self._fresh, None
        motion, self._fresh_motion = self._fresh_motion, None
        self._last_tick = now
        if not self._engaged:
            return None
        if self._tracker is None or self._tracker.path is None:
            self._command = self._stopped(NO_PATH)
            return self._command
        why = self._why_blind(now)
        if why or fresh is None:
            speed = self._braking_speed(now) if why else self._speed
            sample = Sample(now, math.nan, math.nan, math.nan, speed, math.nan)
        else:
            sample = fresh
        motion_time = None
        if self._newest_motion > -math.inf and not why:
            sample = sample._replace(speed=self._speed, yaw_rate=motion.yaw_rate if motion else math.nan)
            motion_time = motion.t if motion else None
        self._tracked = self._tracker.step(*sample, now=now, motion_time=motion_time)
        if self._tracked.status is not at.Status.REPEATED:
            self._angle = self._tracked.command
            why = why or STOPPING.get(self._tracked.status, "") or ("the path is empty" if self._halted else "")
            why = why or (NO_PLANNER if self._tracked.driven_by is DrivenBy.STOP else "")
            self._command = self._stopped(why) if why else self._going()
        return self._command

    def _why_blind(self, now: float) -> str:
        """Why pose and speed cannot be driven by; empty when they can."""
        noun, topic = POSE_MESSAGES[self.parameters.pose_message]
        if self._path_frame and self._pose_frame and self._path_frame != self._pose_frame:
            return f"the path is in frame {self._path_frame!r}, the {noun} in {self._pose_frame!r}"
        why = self._why_late(now - self._newest, noun, topic)
        if noun == "odometry" and self._newest_speed == -math.inf:  # its own speed
            return why
        return why or self._why_late(now - self._newest_speed, "speed", "motion")

    def _why_late(self, age: float, noun: str, topic: str) -> str:
        """Why the newest of some messages cannot be used at an age (s); empty when it can."""
        if age == math.inf:
            return f"no {noun} yet on topic {topic}"
        if age < -self.period:
            return f"the {noun}'s stamps are {-age:.3g} s ahead of this clock"
        return f"the newest {noun} is {age:.3g} s old" if age > self.parameters.longest_silence else ""

    def _braking_speed(self, now: float) -> float:
        """m/s that a car that obeys has while it is stopped without being noticed."""
        if not self._command.stopping or now < self._braked:
            self._braked = now
        return max(0.0, self._speed - self.parameters.stop_deceleration * (now - self._braked))

    def _stopped(self, why: str) -> Command:
        deceleration = self.parameters.stop_deceleration
        return self._command_of(0.0, deceleration, -deceleration)._replace(stopping=why)

    def _command_of(self, speed: float, acceleration: float, request: float = math.nan) -> Command:
        rate = (self._angle - self._command.angle) / self.period
        return Command(self._angle, speed, acceleration, angle_rate=rate, request=request)

    def _going(self) -> Command:
        """The request of the speed control; without one the speed planned one period ahead, and 0 from a stop on."""
        if self._tracked is None:
            return self._stopped(NO_PATH)
        request = self._tracked.longitudinal
        if request is not None:
            rate, standing = max(abs(request.acceleration), LEAST_ACCELERATION), self.parameters.acceleration
            stands = request.hold > 0.0 and request.target_speed == 0.0
            return self._command_of(
                request.target_speed, standing if request.hold > 0.0 else rate,
                -standing if stands else request.acceleration,
            )  # fmt: skip
        speed = self._tracked.target_speed
        return self._command_of(speed if math.isfinite(speed) else 0.0, self.parameters.acceleration)

    @property
    def path_frame(self) -> str:
        """The frame of the path that is followed."""
        return self._path_frame

    def predicted_path(self) -> Array:
        """(n, 4) where the controller expects the car's centre of mass: s after the last tick, x, y (m), yaw (rad).

        Empty where it expects nothing, and while the safe command is sent.
        """
        has_command = self._tracker is not None and not self._command.stopping
        points = self._tracker.predicted_path() if has_command else np.empty((0, 2))
        if len(points) == 0:
            return np.empty((0, 4))
        yaws, yaw = [], _direction(points[0], points[-1])
        for here, there in zip(points, [*points[1:], points[-1]], strict=True):
            if math.dist(here, there) > SHORT_STEP:
                yaw = _direction(here, there)
            yaws.append(yaw)
        return np.column_stack([self._tracker.controller.predicted_output()[0], points, yaws])

    @property
    def left_out(self) -> str:
        """Kinds of messages of which the newest was left out, and why; empty: none."""
        return "; ".join(f"{what} left out: {why}" for what, why in self._trouble.items())

    def diagnosis(self, now: float) -> tuple[int, str, dict[str, str]]:
        """Level, text and values for a diagnostic_msgs/DiagnosticStatus."""
        last, command = self._tracked, self._command
        values = {
            "status": str(last.status) if last else "",
            "offset (m)": f"{last.offset:.3f}" if last else "",
            "heading error (rad)": f"{last.heading_error:.4f}" if last else "",
            "station (m)": f"{last.station:.1f}" if last else "",
            "age of the pose (s)": f"{now - self._newest:.3f}",
            "steering angle (rad)": f"{command.angle:.4f}",
            "speed (m/s)": f"{command.speed:.2f}",
            "top speed until the car is learned (m/s)": f"{last.first_top_speed:.1f}" if last else "",
        }
        if self.parameters.follow == "trajectory":
            values["late (s)"] = f"{last.late:.2f}" if last and math.isfinite(last.late) else ""
            values["driven by"] = str(last.driven_by) if last else ""
            values["verdict"] = str(self._verdict or "")
            age = now - self._fallback_time
            values["age of the fallback (s)"] = f"{age:.3f}" if math.isfinite(age) else ""
        doubts = last.suspect if last else ()
        if self.parameters.motion_message and self._newest_motion == -math.inf and not command.stopping:
            doubts = (*doubts, "no motion yet on topic motion")
        if last and self._speed > last.first_top_speed:
            doubts = (*doubts, f"drive below {last.first_top_speed:.3g} m/s until the car is learned")
        if last and last.driven_by is DrivenBy.FALLBACK:
            doubts = (*doubts, ON_FALLBACK)
        trouble = "; ".join(filter(None, (self.left_out, *doubts)))
        if not self._engaged:
            return OK, "not engaged", values
        if command.stopping:
            return ERROR, "; ".join(filter(None, (f"stopping: {command.stopping}", trouble))), values
        return (WARN, trouble, values) if trouble else (OK, "following", values)


def _direction(here: Array, there: Array) -> float:
    """rad, from one point to another."""
    return math.atan2(there[1] - here[1], there[0] - here[0])

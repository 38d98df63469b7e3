"""From ROS messages to numbers, and back: no rclpy here, any object with the fields of the message will do.

Axes are those of REP 103: x forward, y left, angles positive to the left, SI units, radians.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import adaptrack as at

Array = NDArray[np.float64]


class Sample(NamedTuple):
    """What `Tracker.step` takes, of the centre of mass: s, m, m, rad, m/s, rad/s."""

    t: float
    x: float
    y: float
    yaw: float
    speed: float
    yaw_rate: float


class Motion(NamedTuple):
    """Motion with a stamp of its own: s, m/s (NaN: not measured), rad/s."""

    t: float
    speed: float
    yaw_rate: float


def seconds(stamp: Any) -> float:
    """s of a builtin_interfaces/Time; exact to 0.3 microseconds in this century."""
    return stamp.sec + 1e-9 * stamp.nanosec


def yaw_of(q: Any) -> float:
    """rad of a quaternion of any length; NaN of one that is 0 or not finite. To the bit that of the C++ node."""
    across, along = 2.0 * (q.w * q.z + q.x * q.y), q.w * q.w + q.x * q.x - q.y * q.y - q.z * q.z
    square = q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w
    return math.atan2(across, along) if 0.0 < square < math.inf else math.nan


def sample_of(message: Any, ahead: float) -> Sample:
    """The centre of mass by a message about a frame of the car that lies `ahead` (m) of it.

    message: nav_msgs/Odometry; or geometry_msgs/PoseStamped or TransformStamped, whose motion is NaN. On a rigid body
    v_x is the same all along the axis of the car, and so is the yaw rate.

    Raises
    ------
    adaptrack.InvalidInput
        When a number is not finite, or the quaternion is 0: a message that was never filled in.
    """
    if hasattr(message, "transform"):
        place, q = message.transform.translation, message.transform.rotation
    else:
        pose = getattr(message.pose, "pose", message.pose)
        place, q = pose.position, pose.orientation
    yaw = yaw_of(q)
    x, y = place.x - ahead * math.cos(yaw), place.y - ahead * math.sin(yaw)
    numbers = (seconds(message.header.stamp), x, y, yaw)
    motion: tuple[float, ...] = ()
    if hasattr(message, "twist"):
        motion = message.twist.twist.linear.x, message.twist.twist.angular.z
    if not all(map(math.isfinite, numbers + motion)):
        raise at.InvalidInput(f"{numbers + motion}: must be finite.")
    return Sample(*numbers, *(motion or (math.nan, math.nan)))


def motion_of(message: Any) -> Motion:
    """Motion in a geometry_msgs/TwistStamped or in the twist of a nav_msgs/Odometry; of a sensor_msgs/Imu the yaw rate.

    Raises
    ------
    adaptrack.InvalidInput
        When the yaw rate is not finite.
    """
    if hasattr(message, "angular_velocity"):
        speed, yaw_rate = math.nan, message.angular_velocity.z
    else:
        twist = getattr(message.twist, "twist", message.twist)
        speed, yaw_rate = twist.linear.x, twist.angular.z
    if not math.isfinite(yaw_rate):
        raise at.InvalidInput(f"motion: yaw rate {yaw_rate}: must be finite.")
    return Motion(seconds(message.header.stamp), speed, yaw_rate)


def frame_of_motion(message: Any) -> str:
    """Frame in which the motion of a message is given; empty for an Imu, whose yaw rate is the same in each."""
    if hasattr(message, "angular_velocity"):
        return ""
    return str(getattr(message, "child_frame_id", message.header.frame_id))


def points_of(message: Any) -> Array:
    """(n, 2) m: x, y of a nav_msgs/Path (`poses`) or an autoware_planning_msgs/Trajectory (`points`)."""
    places = message.points if hasattr(message, "points") else message.poses
    found = [(each.pose.position.x, each.pose.position.y) for each in places]
    return np.array(found, dtype=np.float64).reshape(-1, 2)


def speeds_of(message: Any) -> Array | None:
    """(n,) m/s at the points: of a Trajectory its own, of a Path those that its poses' stamps ask for; None without.

    The stamp of a pose is taken as the time at which the car shall be there, if the stamps grow from pose to pose.
    """
    if hasattr(message, "points"):
        return np.array([each.longitudinal_velocity_mps for each in message.points], dtype=np.float64)
    times = np.array([seconds(each.header.stamp) for each in message.poses])
    if times.size < 2 or not np.diff(times).min() > 0.0:
        return None
    way = np.hypot(*np.diff(points_of(message), axis=0).T)
    return np.interp(times, 0.5 * (times[1:] + times[:-1]), way / np.diff(times))


def fill_drive(message: Any, angle: float, speed: float, acceleration: float) -> None:
    """Write an ackermann_msgs/AckermannDriveStamped: rad, m/s, and how fast (m/s^2, > 0) to change to that speed.

    0 as the steering velocity and the jerk means as quickly as possible: the angles are within the steering's rate
    already.
    """
    drive = message.drive
    drive.steering_angle, drive.speed, drive.acceleration = float(angle), float(speed), float(acceleration)
    drive.steering_angle_velocity = drive.jerk = 0.0


def set_later(time: Any, stamp: Any, delay: float) -> None:
    """Write the builtin_interfaces/Time that is `delay` (s) after a stamp."""
    carry, time.nanosec = divmod(stamp.nanosec + round(1e9 * delay), 10**9)
    time.sec = stamp.sec + carry


def fill_path(message: Any, stamp: Any, frame: str, rows: Array, pose_stamped: Any) -> None:
    """Write a nav_msgs/Path of rows (n, 4): s after the stamp, x, y (m), yaw (rad); pose_stamped: class of a pose."""
    message.header.stamp, message.header.frame_id, message.poses = stamp, frame, []
    for delay, x, y, yaw in rows.tolist():
        pose = pose_stamped()
        pose.header.frame_id = frame
        set_later(pose.header.stamp, stamp, delay)
        pose.pose.position.x, pose.pose.position.y = x, y
        pose.pose.orientation.z, pose.pose.orientation.w = math.sin(0.5 * yaw), math.cos(0.5 * yaw)
        message.poses.append(pose)


def fill_control(message: Any, stamp: Any, period: float, command: Any) -> None:
    """Write an autoware_control_msgs/Control of a control period (s) by a `Command`.

    stamp: builtin_interfaces/Time; the state is expected a period later.
    """
    lateral, longitudinal = message.lateral, message.longitudinal
    for part in (message, lateral, longitudinal):
        part.stamp = stamp
        set_later(part.control_time, stamp, period)
    lateral.steering_tire_angle, lateral.steering_tire_rotation_rate = float(command.angle), float(command.angle_rate)
    lateral.is_defined_steering_tire_rotation_rate = True
    longitudinal.velocity, longitudinal.is_defined_acceleration = float(command.speed), math.isfinite(command.request)
    longitudinal.acceleration = float(command.request) if longitudinal.is_defined_acceleration else 0.0


def fill_status(status: Any, level: int, text: str, values: Mapping[str, str], key_value: Any) -> None:
    """Write a diagnostic_msgs/DiagnosticStatus; key_value: the class of its values. A `byte` is bytes in rclpy."""
    status.level, status.name, status.hardware_id, status.message = bytes([level]), "adaptrack: tracker", "", text
    status.values = [key_value(key=key, value=value) for key, value in values.items()]

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


def sample_of(odometry: Any, ahead: float) -> Sample:
    """The centre of mass in a nav_msgs/Odometry whose child frame lies `ahead` (m) of it.

    On a rigid body v_x is the same all along the axis of the car, and so is the yaw rate.

    Raises
    ------
    adaptrack.InvalidInput
        When a number is not finite, or the quaternion is 0: an odometry that was never filled in.
    """
    pose, twist = odometry.pose.pose, odometry.twist.twist
    q = pose.orientation
    yaw = at.yaw_of((q.x, q.y, q.z, q.w))
    x, y = pose.position.x - ahead * math.cos(yaw), pose.position.y - ahead * math.sin(yaw)
    sample = Sample(seconds(odometry.header.stamp), x, y, yaw, twist.linear.x, twist.angular.z)
    if not all(map(math.isfinite, sample)):
        raise at.InvalidInput(f"odometry: {sample}: must be finite.")
    return sample


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


def fill_status(status: Any, level: int, text: str, values: Mapping[str, str], key_value: Any) -> None:
    """Write a diagnostic_msgs/DiagnosticStatus; key_value: the class of its values. A `byte` is bytes in rclpy."""
    status.level, status.name, status.hardware_id, status.message = bytes([level]), "adaptrack: tracker", "", text
    status.values = [key_value(key=key, value=value) for key, value in values.items()]

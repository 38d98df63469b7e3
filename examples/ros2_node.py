"""A ROS 2 node that follows a path: nav_msgs/Odometry and nav_msgs/Path in, ackermann_msgs/AckermannDriveStamped out.

    python examples/ros2_node.py --ros-args -r odom:=/localization/odometry -r path:=/planning/path

`stamp`, `sample` and `points` need no ROS and are tested without it.
"""

from __future__ import annotations

import math
from typing import Any

import adaptrack as at

CAR = at.load_vehicle("midsize-sedan")  # or at.load_vehicle("my-car.toml")
BASE_LINK = -CAR.lr  # m, where the odometry's child frame is, ahead of the centre of mass: here the rear axle
STOP = (at.Status.HELD, at.Status.REVERSE, at.Status.OFF_PATH, at.Status.END)


def stamp(header: Any) -> float:
    """Seconds of a std_msgs/Header."""
    return header.stamp.sec + 1e-9 * header.stamp.nanosec


def sample(odometry: Any, ahead: float = 0.0) -> tuple[float, float, float, float, float, float]:
    """What `Tracker.step` takes of a nav_msgs/Odometry whose child frame lies `ahead` (m) of the centre of mass."""
    pose, twist = odometry.pose.pose, odometry.twist.twist
    q = pose.orientation
    yaw = at.yaw_of((q.x, q.y, q.z, q.w))
    x, y = pose.position.x - ahead * math.cos(yaw), pose.position.y - ahead * math.sin(yaw)
    return stamp(odometry.header), x, y, yaw, twist.linear.x, twist.angular.z


def points(path: Any) -> list[tuple[float, float]]:
    """x, y (m) of a nav_msgs/Path."""
    return [(each.pose.position.x, each.pose.position.y) for each in path.poses]


def main() -> None:
    """Spin until stopped."""
    import rclpy
    from ackermann_msgs.msg import AckermannDriveStamped
    from nav_msgs.msg import Odometry, Path

    rclpy.init()
    node = rclpy.create_node("adaptrack")
    output = node.create_publisher(AckermannDriveStamped, "drive", 1)
    mpc = at.MPC(CAR, profile="production")  # takes samples in that are up to some tenths of a second old
    trackers: list[at.Tracker] = []

    def follow(message: Path) -> None:
        road = at.Road.through(points(message))
        if trackers:
            trackers[0].follow(road)
        else:
            trackers.append(at.Tracker(mpc, road))

    def drive(message: Odometry) -> None:
        if not trackers:
            return
        now = 1e-9 * node.get_clock().now().nanoseconds
        told = trackers[0].step(*sample(message, BASE_LINK), now=now)
        answer = AckermannDriveStamped()
        answer.header.stamp = node.get_clock().now().to_msg()
        answer.drive.steering_angle = told.command
        answer.drive.speed = 0.0 if told.status in STOP else 10.0
        output.publish(answer)

    node.create_subscription(Path, "path", follow, 1)
    node.create_subscription(Odometry, "odom", drive, 1)
    rclpy.spin(node)


if __name__ == "__main__":
    main()

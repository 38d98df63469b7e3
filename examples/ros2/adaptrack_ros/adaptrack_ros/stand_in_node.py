"""A car and a planner in one node, to try the follower without either: a country road from adaptrack's generator."""

from __future__ import annotations

import rclpy
from ackermann_msgs.msg import AckermannDriveStamped
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry, Path
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data

import adaptrack as at
from adaptrack_ros.stand_in import StandInCar, window

PERIOD, PLANNING = 0.05, 0.5
"""s, between odometries and between paths"""


class StandInNode(Node):
    """Publishes odometry and the next 80 m of a road, obeys `drive`."""

    def __init__(self) -> None:
        super().__init__("adaptrack_stand_in")
        self._road, self._car = at.generate_road("country", seed=1, length=1500.0), StandInCar()
        start = self._road.at(10.0)
        self._car.place(float(start.x), float(start.y), float(start.heading), 0.0)
        self._s = 10.0
        self._odometry = self.create_publisher(Odometry, "odom", qos_profile_sensor_data)
        self._path = self.create_publisher(Path, "path", 1)
        self.create_subscription(AckermannDriveStamped, "drive", lambda message: self._car.obey(message.drive), 1)
        self.create_timer(PERIOD, self._move)
        self.create_timer(PLANNING, self._plan)

    def _move(self) -> None:
        self._car.advance(PERIOD)
        message = Odometry()
        message.header.stamp = self.get_clock().now().to_msg()
        message.header.frame_id, message.child_frame_id = "map", "base_link"
        self._car.fill_odometry(message)
        self._odometry.publish(message)

    def _plan(self) -> None:
        self._s = float(self._road.project(*self._car.state[:2], near=self._s).s)
        message = Path()
        message.header.stamp = self.get_clock().now().to_msg()
        message.header.frame_id = "map"
        for x, y in window(self._road, self._s):
            pose = PoseStamped()
            pose.pose.position.x, pose.pose.position.y = float(x), float(y)
            message.poses.append(pose)
        self._path.publish(message)


def main() -> None:
    """Spin until stopped."""
    rclpy.init()
    node = StandInNode()
    try:
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()

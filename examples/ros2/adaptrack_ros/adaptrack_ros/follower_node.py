"""The node: messages to `Follower`, its commands to the car. All that is decided is decided there."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import rclpy
from ackermann_msgs.msg import AckermannDriveStamped
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry, Path
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy, qos_profile_sensor_data
from sensor_msgs.msg import Imu
from std_msgs.msg import Bool

from adaptrack_ros.follower import Follower, Parameters
from adaptrack_ros.messages import fill_drive, fill_status

DIAGNOSTICS_PERIOD = 0.5
"""s"""
MOTION_TYPES = {"geometry_msgs/TwistStamped": TwistStamped, "nav_msgs/Odometry": Odometry, "sensor_msgs/Imu": Imu}


class FollowerNode(Node):
    """Subscribes, calls `Follower.tick` once per control period, publishes."""

    def __init__(self) -> None:
        super().__init__("adaptrack_follower")
        declared = {name: self.declare_parameter(name, value).value for name, value in asdict(Parameters()).items()}
        parameters = Parameters(**declared)
        self._follower, self._wheel_angle = Follower(parameters), 0.0
        self.get_logger().info("loading compiled code; after an installation this takes up to two minutes")
        self._follower.warm_up()
        self._drive = self.create_publisher(AckermannDriveStamped, "drive", 1)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self.create_subscription(Odometry, "odom", self._follower.odometry, qos_profile_sensor_data)
        if parameters.motion_message:
            kind = MOTION_TYPES[parameters.motion_message]
            self.create_subscription(kind, "motion", self._follower.motion, qos_profile_sensor_data)
        self.create_subscription(_path_type(parameters), "path", self._follower.path, _path_qos(parameters))
        self.create_subscription(AckermannDriveStamped, "wheel_angle", self._take_angle, qos_profile_sensor_data)
        self.create_subscription(Bool, "engage", self._engage, 1)
        self.create_timer(self._follower.period, self._tick)
        self.create_timer(DIAGNOSTICS_PERIOD, self._diagnose)
        self.get_logger().info("ready")

    @property
    def _now(self) -> float:
        """s, on the clock of the stamps: simulated where use_sim_time is set."""
        return 1e-9 * self.get_clock().now().nanoseconds

    def _take_angle(self, message: AckermannDriveStamped) -> None:
        self._wheel_angle = message.drive.steering_angle

    def _engage(self, message: Bool) -> None:
        self._follower.engage(message.data, self._wheel_angle)

    def _tick(self) -> None:
        command = self._follower.tick(self._now)
        if command is not None:
            message = AckermannDriveStamped()
            message.header.stamp = self.get_clock().now().to_msg()
            message.header.frame_id = self._follower.parameters.base_frame
            fill_drive(message, command.angle, command.speed, command.acceleration)
            self._drive.publish(message)

    def _diagnose(self) -> None:
        message, status = DiagnosticArray(), DiagnosticStatus()
        message.header.stamp = self.get_clock().now().to_msg()
        fill_status(status, *self._follower.diagnosis(self._now), KeyValue)
        message.status = [status]
        self._diagnostics.publish(message)


def _path_type(parameters: Parameters) -> Any:
    if parameters.path_message == "nav_msgs/Path":
        return Path
    from autoware_planning_msgs.msg import Trajectory

    return Trajectory


def _path_qos(parameters: Parameters) -> QoSProfile:
    """Reliable, the newest only; a latched one is given to those who come later, if both sides request it."""
    latched = DurabilityPolicy.TRANSIENT_LOCAL if parameters.path_latched else DurabilityPolicy.VOLATILE
    return QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=latched)


def main() -> None:
    """Spin until stopped."""
    rclpy.init()
    node = FollowerNode()
    try:
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()

"""The node: messages to `Follower`, its commands to the car. All that is decided is decided there."""

from __future__ import annotations

import sys
from dataclasses import asdict
from importlib import import_module
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy, qos_profile_sensor_data
from rclpy.time import Time
from std_msgs.msg import Bool

import adaptrack as at
from adaptrack_ros.follower import DRIVE_MESSAGES, OK, POSE_MESSAGES, Command, Follower, Parameters
from adaptrack_ros.messages import fill_control, fill_drive, fill_path, fill_status

DIAGNOSTICS_PERIOD, WARNING_PERIOD = 0.5, 2.0
"""s, between two diagnostics, and at least between two warnings in the log"""


class FollowerNode(Node):
    """Subscribes, calls `Follower.tick` once per control period, publishes."""

    def __init__(self) -> None:
        super().__init__("adaptrack_follower")
        declared = {name: self.declare_parameter(name, value).value for name, value in asdict(Parameters()).items()}
        parameters = Parameters(**declared)
        self._follower, self._wheel_angle = Follower(parameters), 0.0
        self.get_logger().info("loading compiled code; after an installation this takes up to two minutes")
        self._follower.warm_up()
        self._drive_type, self._look_up = message_type(parameters.drive_message), lambda: None
        self._drive = self.create_publisher(self._drive_type, "drive", 1)
        self._predicted_path = self.create_publisher(Path, "predicted_path", 1)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        if parameters.pose_message == "tf":
            self._listen_to_tf()
        else:
            topic = POSE_MESSAGES[parameters.pose_message][1]
            self._subscribe(parameters.pose_message, topic, self._follower.pose)
        if parameters.motion_message:
            self._subscribe(parameters.motion_message, "motion", self._follower.motion)
        self._subscribe(parameters.path_message, "path", self._take_path, _path_qos(parameters))
        if parameters.follow == "trajectory":
            self._subscribe(parameters.path_message, "fallback", self._take_fallback, _path_qos(parameters))
        self._subscribe(DRIVE_MESSAGES[0], "wheel_angle", self._take_angle)
        self.create_subscription(Bool, "engage", self._engage, 1)
        self.create_timer(self._follower.period, self._tick)
        self.create_timer(DIAGNOSTICS_PERIOD, self._diagnose)
        self.get_logger().info("ready")

    @property
    def _now(self) -> float:
        """s, on the clock of the stamps: simulated where use_sim_time is set."""
        return 1e-9 * self.get_clock().now().nanoseconds

    def _subscribe(self, message: str, topic: str, take: Any, qos: QoSProfile = qos_profile_sensor_data) -> None:
        self.create_subscription(message_type(message), topic, take, qos)

    def _listen_to_tf(self) -> None:
        """Take the newest pose of the base frame in the map at each tick."""
        from tf2_ros import Buffer, TransformException, TransformListener

        buffer, frames = Buffer(), (self._follower.parameters.map_frame, self._follower.parameters.base_frame)
        self._listener = TransformListener(buffer, self)

        def look_up() -> None:
            try:
                self._follower.pose(buffer.lookup_transform(*frames, Time()))
            except TransformException as error:
                self._follower.miss_pose(str(error))

        self._look_up = look_up

    def _take_path(self, message: Any) -> None:
        self._follower.path(message, self._now)
        self._warn(self._follower.left_out)

    def _take_fallback(self, message: Any) -> None:
        self._follower.fallback(message, self._now)

    def _take_angle(self, message: Any) -> None:
        self._wheel_angle = message.drive.steering_angle

    def _engage(self, message: Bool) -> None:
        self._follower.engage(message.data, self._wheel_angle)

    def _tick(self) -> None:
        self._look_up()
        command = self._follower.tick(self._now)
        if command is not None:
            self._publish(command)

    def _publish(self, command: Command) -> None:
        message, stamp = self._drive_type(), self.get_clock().now().to_msg()
        if self._follower.parameters.drive_message == DRIVE_MESSAGES[0]:
            message.header.stamp, message.header.frame_id = stamp, self._follower.parameters.base_frame
            fill_drive(message, command.angle, command.speed, command.acceleration)
        else:
            fill_control(message, stamp, self._follower.period, command)
        self._drive.publish(message)
        path = Path()
        fill_path(path, stamp, self._follower.path_frame, self._follower.predicted_path(), PoseStamped)
        self._predicted_path.publish(path)

    def _diagnose(self) -> None:
        message, status = DiagnosticArray(), DiagnosticStatus()
        message.header.stamp = self.get_clock().now().to_msg()
        level, text, values = self._follower.diagnosis(self._now)
        fill_status(status, level, text, values, KeyValue)
        message.status = [status]
        self._diagnostics.publish(message)
        self._warn("" if level == OK else text)

    def _warn(self, text: str) -> None:
        if text:
            self.get_logger().warning(text, throttle_duration_sec=WARNING_PERIOD)


def message_type(name: str) -> Any:
    """The class of a message, such as nav_msgs/Path.

    Raises
    ------
    adaptrack.InvalidInput
        When its package is not installed.
    """
    package, _, kind = name.partition("/")
    try:
        return getattr(import_module(f"{package}.msg"), kind)
    except ImportError:
        raise at.InvalidInput(
            f"{name}: package {package} is not installed: run sudo apt install "
            f"ros-$ROS_DISTRO-{package.replace('_', '-')}, or choose a different message."
        ) from None


def _path_qos(parameters: Parameters) -> QoSProfile:
    """Reliable, the newest only; a latched one is given to those who come later, if both sides request it."""
    latched = DurabilityPolicy.TRANSIENT_LOCAL if parameters.path_latched else DurabilityPolicy.VOLATILE
    return QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=latched)


def main() -> None:
    """Spin until stopped."""
    rclpy.init()
    try:
        node = FollowerNode()
    except at.InvalidInput as error:
        sys.exit(f"adaptrack_follower: {error}")
    try:
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()

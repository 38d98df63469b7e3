"""Stand-ins of ROS: messages with the fields of their definitions, and as much of rclpy as the nodes use."""

from __future__ import annotations

import importlib
import importlib.util
import math
import sys
from pathlib import Path
from types import ModuleType
from types import SimpleNamespace as Record

PACKAGE = Path(__file__).resolve().parent.parent / "examples" / "ros2" / "adaptrack_ros"


def package_module(name):
    """A module of the example's package."""
    if "adaptrack_ros" not in sys.modules:
        inside = PACKAGE / "adaptrack_ros"
        spec = importlib.util.spec_from_file_location(
            "adaptrack_ros", inside / "__init__.py", submodule_search_locations=[str(inside)]
        )
        module = importlib.util.module_from_spec(spec)
        sys.modules["adaptrack_ros"] = module
        spec.loader.exec_module(module)
    return importlib.import_module(f"adaptrack_ros.{name}")


def stamp(t=0.0):
    """builtin_interfaces/Time"""
    return Record(sec=math.floor(t), nanosec=round(1e9 * (t - math.floor(t))))


def header(t=0.0, frame="map"):
    """std_msgs/Header"""
    return Record(stamp=stamp(t), frame_id=frame)


def pose(x=0.0, y=0.0, yaw=0.0):
    """geometry_msgs/Pose"""
    turned = Record(x=0.0, y=0.0, z=math.sin(0.5 * yaw), w=math.cos(0.5 * yaw))
    return Record(position=Record(x=x, y=y, z=0.0), orientation=turned)


def odometry(t=0.0, x=0.0, y=0.0, yaw=0.0, speed=0.0, rate=0.0):
    """nav_msgs/Odometry"""
    vector = Record(x=speed, y=0.0, z=0.0)
    return Record(
        header=header(t), child_frame_id="base_link", pose=Record(pose=pose(x, y, yaw)),
        twist=Record(twist=Record(linear=vector, angular=Record(x=0.0, y=0.0, z=rate))),
    )  # fmt: skip


def pose_stamped(t=0.0, x=0.0, y=0.0, yaw=0.0):
    """geometry_msgs/PoseStamped"""
    return Record(header=header(t), pose=pose(x, y, yaw))


def transform_stamped(t=0.0, x=0.0, y=0.0, yaw=0.0):
    """geometry_msgs/TransformStamped"""
    there = pose(x, y, yaw)
    transform = Record(translation=there.position, rotation=there.orientation)
    return Record(header=header(t), child_frame_id="base_link", transform=transform)


def twist_stamped(t=0.0, speed=0.0, rate=0.0):
    """geometry_msgs/TwistStamped"""
    twist = Record(linear=Record(x=speed, y=0.0, z=0.0), angular=Record(x=0.0, y=0.0, z=rate))
    return Record(header=header(t, "base_link"), twist=twist)


def imu(t=0.0, rate=0.0):
    """sensor_msgs/Imu"""
    return Record(header=header(t, "imu"), angular_velocity=Record(x=0.0, y=0.0, z=rate))


def path(points, times=None, frame="map", t=0.0):
    """nav_msgs/Path"""
    times = [0.0] * len(points) if times is None else times
    poses = [
        Record(header=header(t, frame), pose=pose(float(x), float(y))) for (x, y), t in zip(points, times, strict=True)
    ]
    return Record(header=header(t, frame), poses=poses)


def trajectory(points, speeds, frame="map", times=None, yaws=None, t=0.0):
    """autoware_planning_msgs/Trajectory"""
    times, yaws = ([0.0] * len(points) if column is None else column for column in (times, yaws))
    places = [
        Record(time_from_start=stamp(time), pose=pose(float(x), float(y), yaw), longitudinal_velocity_mps=float(v),
               acceleration_mps2=0.0)
        for (x, y), v, time, yaw in zip(points, speeds, times, yaws, strict=True)
    ]  # fmt: skip
    return Record(header=header(t, frame), points=places)


def drive_stamped():
    """ackermann_msgs/AckermannDriveStamped"""
    drive = Record(steering_angle=0.0, steering_angle_velocity=0.0, speed=0.0, acceleration=0.0, jerk=0.0)
    return Record(header=header(), drive=drive)


def control():
    """autoware_control_msgs/Control"""
    lateral = {"steering_tire_angle": 0.0, "steering_tire_rotation_rate": 0.0}
    longitudinal = {"velocity": 0.0, "acceleration": 0.0, "jerk": 0.0, "is_defined_acceleration": False}
    return Record(
        stamp=stamp(),
        control_time=stamp(),
        lateral=Record(stamp=stamp(), control_time=stamp(), **lateral, is_defined_steering_tire_rotation_rate=False),
        longitudinal=Record(stamp=stamp(), control_time=stamp(), **longitudinal, is_defined_jerk=False),
    )


# -- as much of rclpy as the nodes use --------------------------------------------------------------------------------
class Network:
    """Time, timers and topics, by hand."""

    def __init__(self):
        self.now, self.timers, self.topics, self.sent, self.parameters = 1000.0, [], {}, {}, {}
        self.transform = None  # of tf, geometry_msgs/TransformStamped
        self.warnings = []

    def publish(self, topic, message):
        self.sent.setdefault(topic, []).append(message)
        for callback in self.topics.get(topic, []):
            callback(message)

    def run(self, duration):
        """Let time pass in steps of 10 ms, and call the timers that are due."""
        end = self.now + duration
        while self.now < end - 1e-9:
            self.now += 0.01
            for timer in self.timers:
                if self.now > timer.due - 1e-9:
                    timer.due += timer.period
                    timer.callback()


def fake_ros(monkeypatch):
    """Modules under the names that the nodes import; the network that joins them."""
    for name in ("follower_node", "stand_in_node"):  # bound to those of an earlier test
        sys.modules.pop(f"adaptrack_ros.{name}", None)
    network = Network()
    clock = Record(now=lambda: Record(nanoseconds=round(1e9 * network.now), to_msg=lambda: stamp(network.now)))

    class Node:
        def __init__(self, name):
            self.name = name

        def declare_parameter(self, name, value):
            return Record(value=network.parameters.get(name, value))

        def get_logger(self):
            def warning(text, throttle_duration_sec):
                network.warnings.append(text)

            return Record(info=lambda text: None, warning=warning)

        def get_clock(self):
            return clock

        def create_timer(self, period, callback):
            network.timers.append(Record(period=period, due=network.now + period, callback=callback))

        def create_publisher(self, kind, topic, qos):
            return Record(publish=lambda message: network.publish(topic, message))

        def create_subscription(self, kind, topic, callback, qos):
            network.topics.setdefault(topic, []).append(callback)

    class Buffer:
        def lookup_transform(self, target, source, time):
            if network.transform is None:
                raise LookupError(f"no transform from {source} to {target}")
            return network.transform

    durability = Record(TRANSIENT_LOCAL="latched", VOLATILE="volatile")
    modules = {
        "rclpy": {},
        "rclpy.executors": {"ExternalShutdownException": type("ExternalShutdownException", (Exception,), {})},
        "rclpy.node": {"Node": Node},
        "rclpy.qos": {
            "DurabilityPolicy": durability,
            "ReliabilityPolicy": Record(RELIABLE="reliable"),
            "QoSProfile": Record,
            "qos_profile_sensor_data": Record(depth=5),
        },
        "ackermann_msgs.msg": {"AckermannDriveStamped": drive_stamped},
        "diagnostic_msgs.msg": {
            "DiagnosticArray": lambda: Record(header=header(), status=[]),
            "DiagnosticStatus": lambda: Record(level=b"\0", name="", message="", hardware_id="", values=[]),
            "KeyValue": Record,
        },
        "geometry_msgs.msg": {"PoseStamped": pose_stamped, "TwistStamped": twist_stamped},
        "autoware_control_msgs.msg": {"Control": control},
        "rclpy.time": {"Time": lambda: None},
        "sensor_msgs.msg": {"Imu": imu},
        "tf2_ros": {
            "Buffer": Buffer,
            "TransformListener": lambda buffer, node: None,
            "TransformException": LookupError,
        },
        "nav_msgs.msg": {"Odometry": odometry, "Path": lambda: path([])},
        "std_msgs.msg": {"Bool": Record},
    }
    for name, content in modules.items():
        module = ModuleType(name)
        vars(module).update(content)
        monkeypatch.setitem(sys.modules, name, module)
        outer = name.rpartition(".")[0]
        if outer and outer not in sys.modules:
            monkeypatch.setitem(sys.modules, outer, ModuleType(outer))
    return network

"""The C++ node of the ROS 2 example without ROS: its logic behind the interface of the Python one, its shell too."""

import ctypes
from functools import cache

import numpy as np

import adaptrack as at
from exported import compile_export
from programs import find_program, run_program
from ros_messages import PACKAGE, package_module

follower, seconds = package_module("follower"), package_module("messages").seconds
CPP = PACKAGE.parent / "adaptrack_ros_cpp"
STAND_INS = PACKAGE.parents[2] / "tests" / "ros2"
HEADERS = (
    "rclcpp/rclcpp", "geometry_msgs/msg/pose_stamped", "geometry_msgs/msg/twist_stamped", "tf2_ros/buffer",
    "tf2_ros/transform_listener", "autoware_control_msgs/msg/control", "sensor_msgs/msg/imu",
    "nav_msgs/msg/odometry", "nav_msgs/msg/path", "std_msgs/msg/bool",
    "ackermann_msgs/msg/ackermann_drive_stamped", "diagnostic_msgs/msg/diagnostic_array",
    "autoware_planning_msgs/msg/trajectory",
)  # fmt: skip
STRICT = ("-std=c++17", "-Wall", "-Wextra", "-Wconversion", "-Wshadow", "-Wpedantic", "-Werror")
LIMITS = (
    "top_speed", "acceleration", "stop_deceleration", "longest_silence", "furthest", "base_ahead", "stop_at_end",
)  # fmt: skip


@cache
def controller(folder, speed_control=False, follow="path"):
    """The folder of the exported controller, and the objects of its C sources."""
    find_program("g++")
    package_module("export_controller").export(follower.Parameters(speed_control=speed_control, follow=follow), folder)
    return compile_export(folder)


def includes(folder):
    """Options under which the sources find their headers; messages and rclcpp are stand-ins."""
    for name in HEADERS:
        file = folder / "stand_ins" / f"{name}.{'h' if name.startswith('tf2_ros') else 'hpp'}"
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text('#include "ros.hpp"\n')
    places = folder / "include", CPP / "include", folder / "stand_ins", STAND_INS
    return [f"-I{place}" for place in places]


@cache
def shim(folder, speed_control=False, follow="path"):
    """The logic as a library."""
    file, level = folder / "follower.so", "-O0" if speed_control else "-O1"  # once with an optimiser's warnings
    sources = CPP / "src" / "follower.cpp", STAND_INS / "shim.cpp", *controller(folder, speed_control, follow)
    run_program("g++", *STRICT, level, "-shared", "-fPIC", *includes(folder), *sources, "-o", file)
    library = ctypes.CDLL(str(file))
    library.ros_make.restype = ctypes.c_void_p
    return library


@cache
def node(folder, follow="path"):
    """The node as a program, on stand-ins."""
    parts, library = controller(folder, follow=follow), folder / "node"
    with_all = "-DADAPTRACK_WITH_TRAJECTORY", "-DADAPTRACK_WITH_CONTROL", "-Dmain=node_main"
    options = [*STRICT, "-O0", *with_all, *includes(folder)]
    run_program("g++", *options, "-c", CPP / "src" / "follower_node.cpp", "-o", folder / "node.o")
    options.remove("-Dmain=node_main")
    sources = CPP / "src" / "follower.cpp", STAND_INS / "drive.cpp", folder / "node.o"
    run_program("g++", *options, *sources, *parts, "-o", library)
    return library


def numbers(values):
    return (ctypes.c_double * len(values))(*values)


class CppFollower:
    """The C++ class behind the interface of `adaptrack_ros.follower.Follower`."""

    def __init__(self, library, parameters=None, constants=None):
        self.parameters, self._library = parameters or follower.Parameters(), library
        why = ctypes.create_string_buffer(200)
        limits = numbers([float(getattr(self.parameters, name)) for name in LIMITS])
        size = ctypes.c_size_t(0 if constants is None else len(constants))
        names = (getattr(self.parameters, name).encode() for name in ("pose_message", "motion_message", "follow"))
        self._made = ctypes.c_void_p(library.ros_make(limits, *names, constants, size, why, ctypes.c_size_t(len(why))))
        if not self._made:
            raise at.InvalidInput(why.value.decode())

    def __del__(self):
        self._library.ros_drop(self._made)

    def pose(self, message):
        pose = getattr(message.pose, "pose", message.pose)
        q, place = pose.orientation, pose.position
        values = [seconds(message.header.stamp), place.x, place.y, q.x, q.y, q.z, q.w]
        frames = message.header.frame_id.encode(), getattr(message, "child_frame_id", "").encode()
        if not hasattr(message, "twist"):
            self._library.ros_pose(self._made, numbers(values), *frames)
            return
        values += [message.twist.twist.linear.x, message.twist.twist.angular.z]
        self._library.ros_odometry(self._made, numbers(values), *frames)

    def motion(self, message):
        module = package_module("messages")
        values, frame = module.motion_of(message), module.frame_of_motion(message).encode()
        self._library.ros_motion(self._made, *map(ctypes.c_double, values), frame)

    def path(self, message, time=None):
        if self.parameters.follow == "trajectory":
            self._send_trajectory(message, time)
            return
        if hasattr(message, "points"):
            rows = [(point.longitudinal_velocity_mps, point.pose) for point in message.points]
            give = self._library.ros_trajectory
        else:
            rows = [(seconds(pose.header.stamp), pose.pose) for pose in message.poses]
            give = self._library.ros_path
        flat = [value for first, pose in rows for value in (first, pose.position.x, pose.position.y)]
        give(self._made, numbers(flat), ctypes.c_size_t(len(rows)), message.header.frame_id.encode())

    def fallback(self, message, time):
        self._send_trajectory(message, time, is_fallback=True)

    def _send_trajectory(self, message, time, is_fallback=False):
        stamp, is_path = seconds(message.header.stamp), hasattr(message, "poses")
        rows = [
            (seconds(point.header.stamp) - stamp if is_path else seconds(point.time_from_start),
             point.pose.position.x, point.pose.position.y, point.pose.orientation.z, point.pose.orientation.w,
             getattr(point, "longitudinal_velocity_mps", 0.0), getattr(point, "acceleration_mps2", 0.0))
            for point in (message.poses if is_path else message.points)
        ]  # fmt: skip
        self._library.ros_planned(
            self._made, numbers(np.ravel(rows)), ctypes.c_size_t(len(rows)), ctypes.c_double(stamp),
            ctypes.c_double(time), int(is_path), int(is_fallback), message.header.frame_id.encode(),
        )  # fmt: skip

    def engage(self, on, wheel_angle=0.0):
        self._library.ros_engage(self._made, int(on), ctypes.c_double(wheel_angle))

    def tick(self, clock):
        command, why = numbers([0.0] * 5), ctypes.create_string_buffer(200)
        if not self._library.ros_tick(self._made, ctypes.c_double(clock), command, why, ctypes.c_size_t(len(why))):
            return None
        return follower.Command(*command[:3], why.value.decode(), *command[3:])

    def predicted_path(self):
        """(n, 5) of the poses of the predicted path behind a stamp of 0.9 s: ns, x, y, and z, w of the quaternion."""
        rows = np.zeros((200, 5))
        return rows[: self._library.ros_predicted_path(self._made, ctypes.c_void_p(rows.ctypes.data))]

    def control(self, command, stamp):
        """Numbers of the autoware_control_msgs/Control of a command: times (ns), then those of its parts."""
        values = numbers([command.angle, command.angle_rate, command.speed, command.request])
        times, parts = (ctypes.c_int64 * 6)(), numbers([0.0] * 6)
        self._library.ros_control(values, stamp.sec, ctypes.c_uint32(stamp.nanosec), times, parts)
        return list(times), list(parts)

    def diagnosis(self, clock):
        text = ctypes.create_string_buffer(2000)
        level = self._library.ros_diagnosis(self._made, ctypes.c_double(clock), text, ctypes.c_size_t(len(text)))
        summary, *values = text.value.decode().split("\n")
        return level, summary, dict(pair.split("=", 1) for pair in values)

    def times(self, points, rounds):
        """(rounds,) s each: an odometry with its tick, and another path."""
        rows = np.column_stack([np.zeros(len(points)), points]).ravel()
        ticks, paths = np.empty(rounds), np.empty(rounds)
        self._library.ros_time(
            self._made, numbers(rows), ctypes.c_size_t(len(points)), rounds, ctypes.c_void_p(ticks.ctypes.data),
            ctypes.c_void_p(paths.ctypes.data),
        )  # fmt: skip
        return ticks, paths

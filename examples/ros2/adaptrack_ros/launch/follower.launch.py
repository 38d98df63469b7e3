"""The follower, and with stand_in:=true a car and a planner for it."""

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

TOPICS = {
    name: name
    for name in ("odom", "pose", "motion", "path", "fallback", "drive", "predicted_path", "wheel_angle", "engage")
}


def generate_launch_description() -> LaunchDescription:
    """Arguments: params_file, package, stand_in, use_sim_time, and every topic by its own name."""
    share = get_package_share_directory("adaptrack_ros")
    arguments = [
        DeclareLaunchArgument("params_file", default_value=f"{share}/config/follower.yaml"),
        DeclareLaunchArgument("package", default_value="adaptrack_ros"),  # adaptrack_ros_cpp: the C++ node
        DeclareLaunchArgument("stand_in", default_value="false"),
        DeclareLaunchArgument("use_sim_time", default_value="false"),
        *(DeclareLaunchArgument(name, default_value=topic) for name, topic in TOPICS.items()),
    ]
    remapped = [(name, LaunchConfiguration(name)) for name in TOPICS]
    clock = {"use_sim_time": LaunchConfiguration("use_sim_time")}
    follower = Node(
        package=LaunchConfiguration("package"),
        executable="follower",
        name="adaptrack_follower",
        parameters=[LaunchConfiguration("params_file"), clock],
        remappings=remapped,
        output="screen",
    )
    stand_in = Node(
        package="adaptrack_ros",
        executable="stand_in",
        remappings=remapped,
        condition=IfCondition(LaunchConfiguration("stand_in")),
    )
    return LaunchDescription([*arguments, follower, stand_in])

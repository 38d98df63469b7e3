// From ROS messages to numbers, and back: any struct with the fields of the message will do.
//
// Axes are those of REP 103: x forward, y left, angles positive to the left, SI units, radians.
#ifndef ADAPTRACK_ROS_CPP_MESSAGES_HPP
#define ADAPTRACK_ROS_CPP_MESSAGES_HPP
#include "adaptrack_ros_cpp/follower.hpp"

#include <cmath>
#include <cstdint>
#include <vector>

namespace adaptrack_ros {

// s of a builtin_interfaces/Time; exact to 0.3 microseconds in this century.
template <class Time>
double seconds(const Time &stamp) {
    return stamp.sec + 1e-9 * stamp.nanosec;
}

// rad of a quaternion of any length; NaN of one that is 0 or not finite.
template <class Quaternion>
double yaw_of(const Quaternion &q) {
    const double across = 2.0 * (q.w * q.z + q.x * q.y), along = q.w * q.w + q.x * q.x - q.y * q.y - q.z * q.z;
    const double square = q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w;
    return square > 0.0 && std::isfinite(square) ? std::atan2(across, along) : NAN;
}

// The centre of mass by place and quaternion of a frame of the car that lies `ahead` (m) of it.
template <class Time, class Place, class Quaternion>
Sample sample_of(const Time &stamp, const Place &place, const Quaternion &q, double ahead) {
    const double yaw = yaw_of(q);
    return {seconds(stamp), place.x - ahead * std::cos(yaw), place.y - ahead * std::sin(yaw), yaw, NAN, NAN};
}

// The centre of mass in a nav_msgs/Odometry whose child frame lies `ahead` (m) of it. On a rigid body v_x is the same
// all along the axis of the car, and so is the yaw rate.
template <class Odometry>
Sample sample_of(const Odometry &odometry, double ahead) {
    const auto &pose = odometry.pose.pose;
    Sample sample = sample_of(odometry.header.stamp, pose.position, pose.orientation, ahead);
    sample.speed = odometry.twist.twist.linear.x, sample.yaw_rate = odometry.twist.twist.angular.z;
    return sample;
}

// Motion in a geometry_msgs/Twist with its stamp.
template <class Time, class Twist>
Motion motion_of(const Time &stamp, const Twist &twist) {
    return {seconds(stamp), twist.linear.x, twist.angular.z};
}

// Yaw rate in a sensor_msgs/Imu.
template <class Imu>
Motion motion_of_imu(const Imu &imu) {
    return {seconds(imu.header.stamp), NAN, imu.angular_velocity.z};
}

// x, y (m) of a nav_msgs/Path's `poses` or an autoware_planning_msgs/Trajectory's `points`, one behind the other.
template <class Places>
void points_of(const Places &places, std::vector<double> &points) {
    points.clear();
    for (const auto &each : places) {
        points.push_back(each.pose.position.x);
        points.push_back(each.pose.position.y);
    }
}

// m/s at the points of a nav_msgs/Path that the stamps of its poses ask for, if they grow from pose to pose: they are
// the times at which the car shall be there. None otherwise.
template <class Path>
void speeds_of_path(const Path &path, std::vector<double> &speeds) {
    const auto &poses = path.poses;
    speeds.clear();
    std::vector<double> middle, mean; // of the steps
    for (std::size_t k = 1; k < poses.size(); k++) {
        const double before = seconds(poses[k - 1].header.stamp), after = seconds(poses[k].header.stamp);
        if (!(after > before)) return;
        const auto &from = poses[k - 1].pose.position, &to = poses[k].pose.position;
        middle.push_back(0.5 * (after + before));
        mean.push_back(std::hypot(to.x - from.x, to.y - from.y) / (after - before));
    }
    for (std::size_t k = 0; k < poses.size() && !middle.empty(); k++) {
        if (k == 0 || k == mean.size()) {
            speeds.push_back(mean[k == 0 ? 0 : k - 1]);
            continue;
        }
        const double slope = (mean[k] - mean[k - 1]) / (middle[k] - middle[k - 1]);
        speeds.push_back(slope * (seconds(poses[k].header.stamp) - middle[k - 1]) + mean[k - 1]);
    }
}

// m/s, of an autoware_planning_msgs/Trajectory.
template <class Trajectory>
void speeds_of_trajectory(const Trajectory &trajectory, std::vector<double> &speeds) {
    speeds.clear();
    for (const auto &each : trajectory.points) speeds.push_back(each.longitudinal_velocity_mps);
}

#if ADAPTRACK_PLANNER
// ns of a builtin_interfaces/Time or Duration
template <class Time>
std::int64_t nanoseconds(const Time &time) {
    return 1000000000 * static_cast<std::int64_t>(time.sec) + time.nanosec;
}

// A point of a trajectory: its pose at a time (ns) after the stamp.
template <class Pose>
adaptrack_point point_of(const Pose &pose, std::int64_t time) {
    return {1e-9 * static_cast<double>(time), pose.position.x, pose.position.y, yaw_of(pose.orientation), NAN, NAN, NAN};
}

// The points of an autoware_planning_msgs/Trajectory; s, its stamp.
template <class Trajectory>
double trajectory_of(const Trajectory &trajectory, std::vector<adaptrack_point> &points) {
    points.clear();
    for (const auto &each : trajectory.points) {
        points.push_back(point_of(each.pose, nanoseconds(each.time_from_start)));
        points.back().speed = static_cast<double>(each.longitudinal_velocity_mps);
        points.back().acceleration = static_cast<double>(each.acceleration_mps2);
    }
    return 1e-9 * static_cast<double>(nanoseconds(trajectory.header.stamp));
}

// The poses of a nav_msgs/Path, whose stamps say when the car is to be there; s, its stamp or that of the first pose.
template <class Path>
double trajectory_of_path(const Path &path, std::vector<adaptrack_point> &points) {
    std::int64_t stamp = nanoseconds(path.header.stamp);
    points.clear();
    if (stamp == 0 && !path.poses.empty()) stamp = nanoseconds(path.poses.front().header.stamp);
    for (const auto &each : path.poses)
        points.push_back(point_of(each.pose, nanoseconds(each.header.stamp) - stamp));
    return 1e-9 * static_cast<double>(stamp);
}
#endif

// Write an ackermann_msgs/AckermannDrive. 0 as the steering velocity and the jerk means as quickly as possible: the
// angles are within the steering's rate already.
template <class Drive>
void fill_drive(const Command &command, Drive &drive) {
    drive.steering_angle = static_cast<float>(command.angle);
    drive.speed = static_cast<float>(command.speed);
    drive.acceleration = static_cast<float>(command.acceleration);
    drive.steering_angle_velocity = drive.jerk = 0.0F;
}

// The builtin_interfaces/Time that is `delay` (s) after a stamp.
template <class Time>
Time later(const Time &stamp, double delay) {
    const auto nanoseconds = static_cast<std::int64_t>(stamp.nanosec) + std::llround(1e9 * delay);
    Time time = stamp;
    time.sec += static_cast<std::int32_t>(nanoseconds / 1000000000);
    time.nanosec = static_cast<std::uint32_t>(nanoseconds % 1000000000);
    return time;
}

// Write a nav_msgs/Path of predicted places, whose times (s) count from a stamp.
template <class Path, class Time>
void fill_path(const std::vector<Sample> &places, const Time &stamp, const std::string &frame, Path &path) {
    path.header.stamp = stamp, path.header.frame_id = frame;
    path.poses.resize(places.size());
    for (std::size_t k = 0; k < places.size(); k++) {
        const Sample &place = places[k];
        auto &each = path.poses[k];
        each.header.stamp = later(stamp, place.t), each.header.frame_id = frame;
        each.pose.position.x = place.x, each.pose.position.y = place.y;
        each.pose.orientation.z = std::sin(0.5 * place.yaw), each.pose.orientation.w = std::cos(0.5 * place.yaw);
    }
}

// Write an autoware_control_msgs/Control of a control period (s), whose state is expected a period after the stamp.
template <class Control, class Time>
void fill_control(const Command &command, const Time &stamp, double period, Control &control) {
    const Time after = later(stamp, period);
    auto &lateral = control.lateral;
    auto &longitudinal = control.longitudinal;
    control.stamp = lateral.stamp = longitudinal.stamp = stamp;
    control.control_time = lateral.control_time = longitudinal.control_time = after;
    lateral.steering_tire_angle = static_cast<float>(command.angle);
    lateral.steering_tire_rotation_rate = static_cast<float>(command.angle_rate);
    lateral.is_defined_steering_tire_rotation_rate = true;
    longitudinal.velocity = static_cast<float>(command.speed);
    longitudinal.is_defined_acceleration = std::isfinite(command.request);
    longitudinal.acceleration = longitudinal.is_defined_acceleration ? static_cast<float>(command.request) : 0.0F;
}

// Write a diagnostic_msgs/DiagnosticStatus.
template <class Status>
void fill_status(const Diagnosis &diagnosis, Status &status) {
    status.level = static_cast<unsigned char>(diagnosis.level);
    status.name = "adaptrack: tracker";
    status.message = diagnosis.text;
    status.values.clear();
    for (const auto &[key, value] : diagnosis.values) {
        status.values.emplace_back();
        status.values.back().key = key;
        status.values.back().value = value;
    }
}

} // namespace adaptrack_ros
#endif

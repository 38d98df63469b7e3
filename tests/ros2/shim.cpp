// The follower behind C functions, its messages made of numbers: for tests that call it from Python.
#include "adaptrack_ros_cpp/follower.hpp"
#include "adaptrack_ros_cpp/messages.hpp"
#include "ros.hpp"

#include <chrono>
#include <cstring>
#include <exception>

using adaptrack_ros::Follower;

namespace {

builtin_interfaces::msg::Time stamp_of(double t) {
    return {static_cast<std::int32_t>(std::floor(t)), static_cast<std::uint32_t>(std::lround(1e9 * (t - std::floor(t))))};
}

void write(const std::string &text, char *to, std::size_t size) { std::snprintf(to, size, "%s", text.c_str()); }

nav_msgs::msg::Odometry odometry_of(const double *numbers) {
    nav_msgs::msg::Odometry made;
    made.header.stamp = stamp_of(numbers[0]);
    made.pose.pose.position.x = numbers[1], made.pose.pose.position.y = numbers[2];
    made.pose.pose.orientation = {numbers[3], numbers[4], numbers[5], numbers[6]};
    made.twist.twist.linear.x = numbers[7], made.twist.twist.angular.z = numbers[8];
    return made;
}

nav_msgs::msg::Path path_of(const double *rows, std::size_t count) {
    nav_msgs::msg::Path made;
    for (std::size_t k = 0; k < count; k++) {
        made.poses.emplace_back();
        made.poses.back().header.stamp = stamp_of(rows[3 * k]);
        made.poses.back().pose.position.x = rows[3 * k + 1], made.poses.back().pose.position.y = rows[3 * k + 2];
    }
    return made;
}

struct Handle {
    Follower follower;
    std::vector<double> points, speeds;

    void give(const nav_msgs::msg::Odometry &message, const std::string &frame, const std::string &child) {
        follower.pose(adaptrack_ros::sample_of(message, follower.base_ahead_of_mass()), frame, child);
    }
    void give(const nav_msgs::msg::Path &message, const std::string &frame) {
        adaptrack_ros::points_of(message.poses, points);
        adaptrack_ros::speeds_of_path(message, speeds);
        follower.path(points, speeds, frame);
    }
};

} // namespace

extern "C" {

// limits: top_speed, acceleration, stop_deceleration, longest_silence, furthest, base_ahead, stop_at_end
Handle *ros_make(const double *limits, const char *pose, const char *motion, const char *follow, const void *constants, std::size_t size, char *why, std::size_t why_size) {
    adaptrack_ros::Parameters p;
    p.top_speed = limits[0], p.acceleration = limits[1], p.stop_deceleration = limits[2];
    p.longest_silence = limits[3], p.furthest = limits[4], p.base_ahead = limits[5], p.stop_at_end = limits[6] > 0.5;
    p.pose_message = pose, p.motion_message = motion, p.follow = follow;
    if (constants == nullptr) constants = adaptrack_constants, size = ADAPTRACK_CONSTANTS_SIZE;
    try {
        return new Handle{{p, constants, size}, {}, {}};
    } catch (const std::exception &error) {
        write(error.what(), why, why_size);
        return nullptr;
    }
}
void ros_drop(Handle *made) { delete made; }

// t, x, y, the quaternion's x, y, z, w, speed, yaw rate
void ros_odometry(Handle *made, const double *numbers, const char *frame, const char *child) {
    made->give(odometry_of(numbers), frame, child);
}
// t, x, y, the quaternion's x, y, z, w
void ros_pose(Handle *made, const double *numbers, const char *frame, const char *child) {
    const geometry_msgs::msg::Quaternion turned{numbers[3], numbers[4], numbers[5], numbers[6]};
    const geometry_msgs::msg::Point place{numbers[1], numbers[2], 0.0};
    const double ahead = made->follower.base_ahead_of_mass();
    made->follower.pose(adaptrack_ros::sample_of(stamp_of(numbers[0]), place, turned, ahead), frame, child);
}
// t, speed (NaN: an Imu), yaw rate
void ros_motion(Handle *made, double t, double speed, double yaw_rate, const char *frame) {
    if (std::isnan(speed)) {
        sensor_msgs::msg::Imu imu;
        imu.header.stamp = stamp_of(t), imu.angular_velocity.z = yaw_rate;
        made->follower.motion(adaptrack_ros::motion_of_imu(imu));
    } else {
        geometry_msgs::msg::TwistStamped message;
        message.header.stamp = stamp_of(t), message.twist.linear.x = speed, message.twist.angular.z = yaw_rate;
        made->follower.motion(adaptrack_ros::motion_of(message.header.stamp, message.twist), frame);
    }
}
// rows: t, x, y
void ros_path(Handle *made, const double *rows, std::size_t count, const char *frame) {
    made->give(path_of(rows, count), frame);
}
// rows: speed, x, y
void ros_trajectory(Handle *made, const double *rows, std::size_t count, const char *frame) {
    autoware_planning_msgs::msg::Trajectory message;
    for (std::size_t k = 0; k < count; k++) {
        message.points.emplace_back();
        message.points.back().longitudinal_velocity_mps = static_cast<float>(rows[3 * k]);
        message.points.back().pose.position = {rows[3 * k + 1], rows[3 * k + 2], 0.0};
    }
    adaptrack_ros::points_of(message.points, made->points);
    adaptrack_ros::speeds_of_trajectory(message, made->speeds);
    made->follower.path(made->points, made->speeds, frame);
}
#if ADAPTRACK_PLANNER
// rows: t, x, y, the quaternion's z, w, speed, acceleration; of a nav_msgs/Path the first five
void ros_planned(Handle *made, const double *rows, std::size_t count, double stamp, double now, int is_path,
                 int is_fallback, const char *frame) {
    autoware_planning_msgs::msg::Trajectory message;
    nav_msgs::msg::Path path;
    std::vector<adaptrack_point> points;
    message.header.stamp = path.header.stamp = stamp_of(stamp);
    for (std::size_t k = 0; k < count; k++, rows += 7) {
        message.points.emplace_back();
        path.poses.emplace_back();
        auto &point = message.points.back();
        point.time_from_start = stamp_of(rows[0]), path.poses.back().header.stamp = stamp_of(stamp + rows[0]);
        point.pose = {{rows[1], rows[2], 0.0}, {0.0, 0.0, rows[3], rows[4]}}, path.poses.back().pose = point.pose;
        point.longitudinal_velocity_mps = static_cast<float>(rows[5]);
        point.acceleration_mps2 = static_cast<float>(rows[6]);
    }
    stamp = is_path ? adaptrack_ros::trajectory_of_path(path, points) : adaptrack_ros::trajectory_of(message, points);
    if (is_fallback)
        made->follower.fallback(points, stamp, now, frame);
    else
        made->follower.trajectory(points, stamp, now, frame);
}
#endif
void ros_engage(Handle *made, int on, double angle) { made->follower.engage(on != 0, angle); }

// command: angle, its rate, speed, request. times: ns, stamp and control time of the message and its two parts.
void ros_control(const double *command, std::int32_t sec, std::uint32_t nanosec, std::int64_t *times, double *parts) {
    autoware_control_msgs::msg::Control m;
    const adaptrack_ros::Command given{command[0], command[2], 0.0, {}, command[1], command[3]};
    adaptrack_ros::fill_control(given, builtin_interfaces::msg::Time{sec, nanosec}, Follower::period, m);
    for (const auto &time : {m.stamp, m.control_time, m.lateral.stamp, m.lateral.control_time, m.longitudinal.stamp,
                             m.longitudinal.control_time})
        *times++ = 1000000000 * static_cast<std::int64_t>(time.sec) + time.nanosec;
    parts[0] = m.lateral.steering_tire_angle, parts[1] = m.lateral.steering_tire_rotation_rate;
    parts[2] = m.lateral.is_defined_steering_tire_rotation_rate, parts[3] = m.longitudinal.velocity;
    parts[4] = m.longitudinal.acceleration, parts[5] = m.longitudinal.is_defined_acceleration;
}
// Whether there is a command: angle, speed, acceleration, rate of the angle, request, and why it is the safe one.
int ros_tick(Handle *made, double now, double *command, char *why, std::size_t size) {
    const adaptrack_ros::Command *found = made->follower.tick(now);
    if (found == nullptr) return 0;
    command[0] = found->angle, command[1] = found->speed, command[2] = found->acceleration;
    command[3] = found->angle_rate, command[4] = found->request;
    write(found->stopping, why, size);
    return 1;
}
// How many poses the predicted path has behind a stamp of 0.9 s: ns, x, y, z and w of each.
int ros_predicted_path(Handle *made, double *rows) {
    nav_msgs::msg::Path path;
    adaptrack_ros::fill_path(made->follower.predicted_path(), builtin_interfaces::msg::Time{0, 900000000}, "map", path);
    for (const auto &each : path.poses) {
        *rows++ = 1e9 * each.header.stamp.sec + each.header.stamp.nanosec;
        *rows++ = each.pose.position.x, *rows++ = each.pose.position.y;
        *rows++ = each.pose.orientation.z, *rows++ = each.pose.orientation.w;
    }
    return static_cast<int>(path.poses.size());
}
// The level; the text, then key=value in lines of their own.
int ros_diagnosis(Handle *made, double now, char *text, std::size_t size) {
    diagnostic_msgs::msg::DiagnosticStatus status;
    adaptrack_ros::fill_status(made->follower.diagnosis(now), status);
    std::string all = status.message;
    for (const auto &each : status.values) all += "\n" + each.key + "=" + each.value;
    write(all, text, size);
    return status.level;
}

// s, of `rounds` odometries with their ticks, and of as many paths that move on with the car along x: messages are
// decoded already, and commands are not yet encoded.
void ros_time(Handle *made, const double *rows, std::size_t count, int rounds, double *ticks, double *paths) {
    using clock = std::chrono::steady_clock;
    nav_msgs::msg::Path path = path_of(rows, count);
    for (int k = 0; k < rounds; k++) {
        const double t = 0.05 * k, y = 0.02 * (k * 7 % 5 - 2);
        const double numbers[] = {t, rows[1] + 10.0 + 5.0 * t, y, 0.0, 0.0, 0.0, 1.0, 5.0, 0.0};
        const nav_msgs::msg::Odometry message = odometry_of(numbers);
        const auto began = clock::now();
        made->give(path, "map");
        const auto there = clock::now();
        made->give(message, "map", "base_link");
        made->follower.tick(t);
        const auto done = clock::now();
        paths[k] = std::chrono::duration<double>(there - began).count();
        ticks[k] = std::chrono::duration<double>(done - there).count();
        for (auto &each : path.poses) each.pose.position.x += 0.25;
    }
}
}

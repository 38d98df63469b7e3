// Drives the node on stand-ins of rclcpp: a car without slip and a planner, 4 s; prints what came of it.
#include "adaptrack_ros_cpp/messages.hpp"
#include "ros.hpp"

int node_main(int argc, char **argv);

namespace {
using rclcpp::network;

builtin_interfaces::msg::Time stamp() { return rclcpp::Time(network.now); }

struct World {
    double x = 10.0, y = 0.3, yaw = 0.0, speed = 0.0, angle = 0.0;
    ackermann_msgs::msg::AckermannDriveStamped command;
    diagnostic_msgs::msg::DiagnosticArray status;
    nav_msgs::msg::Path predicted;
    int commands = 0;

    void move(double step) {
        angle += (command.drive.steering_angle - angle) * step / 0.15;
        speed += std::fmin(std::fmax(command.drive.speed - speed, -command.drive.acceleration * step),
                           command.drive.acceleration * step);
        x += step * speed * std::cos(yaw), y += step * speed * std::sin(yaw);
        yaw += step * speed * std::tan(angle) / 2.7;
    }
    void publish_pose_and_motion() const {
        const double z = std::sin(0.5 * yaw), w = std::cos(0.5 * yaw);
        geometry_msgs::msg::TwistStamped motion;
        motion.header = {stamp(), "base_link"};
        motion.twist.linear.x = speed, motion.twist.angular.z = speed * std::tan(angle) / 2.7;
        network.publish("motion", motion);
        if (network.parameters.at("pose_message") == "tf") {
            network.transform = std::make_shared<geometry_msgs::msg::TransformStamped>();
            *network.transform = {{stamp(), "map"}, "base_link", {{x, y, 0.0}, {0.0, 0.0, z, w}}};
        } else {
            geometry_msgs::msg::PoseStamped message;
            message.header = {stamp(), "map"};
            message.pose = {{x, y, 0.0}, {0.0, 0.0, z, w}};
            network.publish("pose", message);
        }
    }
    void publish_odometry() const {
        if (network.parameters.count("pose_message")) {
            publish_pose_and_motion();
            return;
        }
        nav_msgs::msg::Odometry message;
        message.header = {stamp(), "map"};
        message.child_frame_id = "base_link";
        message.pose.pose.position = {x, y, 0.0};
        message.pose.pose.orientation = {0.0, 0.0, std::sin(0.5 * yaw), std::cos(0.5 * yaw)};
        message.twist.twist.linear.x = speed, message.twist.twist.angular.z = speed * std::tan(angle) / 2.7;
        network.publish("odom", message);
    }
    // Places at 4 m/s, or with a rate of the speed (m/s^2) to rest, anew from the car on.
    void publish_planned(const std::string &topic, double rate) const {
        autoware_planning_msgs::msg::Trajectory message;
        message.header = {stamp(), "map"};
        for (int k = 0; k < 60; k++) {
            const double t = std::fmin(0.1 * k, rate < 0.0 ? -4.0 / rate : 6.0);
            message.points.emplace_back();
            message.points.back().time_from_start = {k / 10, 100000000u * static_cast<std::uint32_t>(k % 10)};
            message.points.back().pose.position.x = x + 4.0 * t + 0.5 * rate * t * t;
            message.points.back().longitudinal_velocity_mps = static_cast<float>(4.0 + rate * t);
        }
        network.publish(topic, message);
    }
    void publish_path() const {
        if (network.parameters.count("follow")) {
            publish_planned("fallback", -1.0);
            return publish_planned("path", 0.0);
        }
        if (network.parameters.count("path_message")) {
            autoware_planning_msgs::msg::Trajectory message;
            message.header.frame_id = "map";
            for (double s = 0.0; s < 90.0; s += 1.0) {
                message.points.emplace_back();
                message.points.back().pose.position.x = std::floor(x) - 5.0 + s;
                message.points.back().longitudinal_velocity_mps = 4.0F;
            }
            network.publish("path", message);
            return;
        }
        nav_msgs::msg::Path message;
        message.header.frame_id = "map";
        for (double s = 0.0; s < 90.0; s += 1.0) {
            message.poses.emplace_back();
            message.poses.back().pose.position.x = std::floor(x) - 5.0 + s;
        }
        network.publish("path", message);
    }
    void run(double seconds) {
        for (int k = 0; k < std::lround(seconds / 0.05); k++) {
            publish_odometry();
            if (k % (network.parameters.count("follow") ? 2 : 10) == 0) publish_path();
            network.run(0.05);
            move(0.05);
        }
    }
    void operator()() {
        if (network.parameters.count("drive_message"))
            network.listen<autoware_control_msgs::msg::Control>("drive", [this](const auto &message) {
                command.header = {message->stamp, "base_link"};
                command.drive.steering_angle = message->lateral.steering_tire_angle;
                command.drive.speed = message->longitudinal.velocity, command.drive.acceleration = 1.5F;
                commands++;
            });
        else
            network.listen<ackermann_msgs::msg::AckermannDriveStamped>("drive", [this](const auto &message) {
                command = *message;
                commands++;
            });
        network.listen<diagnostic_msgs::msg::DiagnosticArray>(
            "/diagnostics", [this](const auto &message) { status = *message; });
        network.listen<nav_msgs::msg::Path>("predicted_path", [this](const auto &message) { predicted = *message; });
        run(4.0);
        const auto &first = predicted.poses.at(0);
        std::printf("predicted=%zu\nfirst=%g\nafter=%g\npath_frame=%s\n", predicted.poses.size(),
                    first.pose.position.x - x, adaptrack_ros::seconds(first.header.stamp) - network.seconds(),
                    predicted.header.frame_id.c_str());
        std::printf("commands=%d\nspeed=%g\nstamp=%d\nframe=%s\nlevel=%d\nmessage=%s\noffset=%g\n", commands, speed,
                    command.header.stamp.sec, command.header.frame_id.c_str(), status.status.at(0).level,
                    status.status.at(0).message.c_str(), y);
        if (network.parameters.count("follow")) { // the planner falls silent
            for (int k = 0; k < 200; k++) {
                publish_odometry();
                network.run(0.05);
                move(0.05);
            }
            std::printf("at_rest=%g\nfallback_level=%d\nfallback_message=%s\n", speed, status.status.at(0).level,
                        status.status.at(0).message.c_str());
        }
        std_msgs::msg::Bool off;
        network.publish("engage", off);
        commands = 0;
        network.run(0.3);
        std::printf("disengaged=%d\n", commands);
    }
};
} // namespace

int main(int argc, char **argv) {
    for (int k = 1; k + 1 < argc; k += 2) network.parameters[argv[k]] = argv[k + 1];
    World world;
    network.world = [&world] { world(); };
    return node_main(argc, argv);
}

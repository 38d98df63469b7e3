// The node: messages to `Follower`, its commands to the car. All that is decided is decided there.
#include "adaptrack_ros_cpp/follower.hpp"
#include "adaptrack_ros_cpp/messages.hpp"

#include <ackermann_msgs/msg/ackermann_drive_stamped.hpp>
#ifdef ADAPTRACK_WITH_TRAJECTORY
#include <autoware_planning_msgs/msg/trajectory.hpp>
#endif
#include <diagnostic_msgs/msg/diagnostic_array.hpp>
#include <geometry_msgs/msg/twist_stamped.hpp>
#include <nav_msgs/msg/odometry.hpp>
#include <nav_msgs/msg/path.hpp>
#include <rclcpp/rclcpp.hpp>
#include <sensor_msgs/msg/imu.hpp>
#include <std_msgs/msg/bool.hpp>

#include <fstream>
#include <iterator>
#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

namespace adaptrack_ros {
namespace {

using ackermann_msgs::msg::AckermannDriveStamped;
using diagnostic_msgs::msg::DiagnosticArray;
using nav_msgs::msg::Odometry;
using nav_msgs::msg::Path;
using std_msgs::msg::Bool;

constexpr double diagnostics_period = 0.5; // s

Parameters declared(rclcpp::Node &node) {
    Parameters p;
    p.base_frame = node.declare_parameter("base_frame", p.base_frame);
    p.base_ahead = node.declare_parameter("base_ahead", p.base_ahead);
    p.top_speed = node.declare_parameter("top_speed", p.top_speed);
    p.stop_at_end = node.declare_parameter("stop_at_end", p.stop_at_end);
    p.acceleration = node.declare_parameter("acceleration", p.acceleration);
    p.stop_deceleration = node.declare_parameter("stop_deceleration", p.stop_deceleration);
    p.longest_silence = node.declare_parameter("longest_silence", p.longest_silence);
    p.furthest = node.declare_parameter("furthest", p.furthest);
    return p;
}

// Constants of a file, or those that are linked in where there is no name.
std::unique_ptr<Follower> made(const Parameters &parameters, const std::string &name) {
    if (name.empty()) return std::make_unique<Follower>(parameters, adaptrack_constants, ADAPTRACK_CONSTANTS_SIZE);
    std::ifstream file(name, std::ios::binary);
    const std::vector<char> bytes{std::istreambuf_iterator<char>(file), {}};
    return std::make_unique<Follower>(parameters, bytes.data(), bytes.size());
}

} // namespace

// Subscribes, calls `Follower::tick` once per control period, publishes.
class FollowerNode : public rclcpp::Node {
  public:
    FollowerNode() : Node("adaptrack_follower") {
        follower_ = made(declared(*this), declare_parameter("constants", std::string()));
        drive_ = create_publisher<AckermannDriveStamped>("drive", rclcpp::QoS(1));
        diagnostics_ = create_publisher<DiagnosticArray>("/diagnostics", rclcpp::QoS(10));
        odometry_ = create_subscription<Odometry>(
            "odom", rclcpp::SensorDataQoS(), [this](const Odometry::ConstSharedPtr &message) {
                follower_->odometry(sample_of(*message, follower_->base_ahead_of_mass()), message->header.frame_id,
                                    message->child_frame_id);
            });
        subscribe_to_motion(declare_parameter("motion_message", std::string()));
        subscribe_to_path(declare_parameter("path_message", std::string("nav_msgs/Path")),
                          declare_parameter("path_latched", false));
        wheel_angle_ = create_subscription<AckermannDriveStamped>(
            "wheel_angle", rclcpp::SensorDataQoS(),
            [this](const AckermannDriveStamped::ConstSharedPtr &message) { angle_ = message->drive.steering_angle; });
        engage_ = create_subscription<Bool>("engage", rclcpp::QoS(1), [this](const Bool::ConstSharedPtr &message) {
            follower_->engage(message->data, angle_);
        });
        const auto every = [this](double period, void (FollowerNode::*call)()) {
            return rclcpp::create_timer(this, get_clock(), rclcpp::Duration::from_seconds(period),
                                        [this, call] { (this->*call)(); });
        };
        timers_ = {every(Follower::period, &FollowerNode::tick), every(diagnostics_period, &FollowerNode::diagnose)};
        RCLCPP_INFO(get_logger(), "ready: adaptrack %s", adaptrack_version());
    }

  private:
    template <class Message, class Reader>
    void subscribe_to_motion_as(Reader read) {
        motion_ = create_subscription<Message>(
            "motion", rclcpp::SensorDataQoS(),
            [this, read](const typename Message::ConstSharedPtr &message) { follower_->motion(read(*message)); });
    }

    void subscribe_to_motion(const std::string &kind) {
        using geometry_msgs::msg::TwistStamped;
        using sensor_msgs::msg::Imu;
        if (kind == "geometry_msgs/TwistStamped")
            subscribe_to_motion_as<TwistStamped>([](const auto &m) { return motion_of(m.header.stamp, m.twist); });
        else if (kind == "nav_msgs/Odometry")
            subscribe_to_motion_as<Odometry>([](const auto &m) { return motion_of(m.header.stamp, m.twist.twist); });
        else if (kind == "sensor_msgs/Imu")
            subscribe_to_motion_as<Imu>([](const auto &m) { return motion_of_imu(m); });
        else if (!kind.empty())
            throw std::invalid_argument("motion_message = '" + kind +
                                        "': must be empty, geometry_msgs/TwistStamped, nav_msgs/Odometry or "
                                        "sensor_msgs/Imu.");
    }

    void subscribe_to_path(const std::string &kind, bool latched) {
        rclcpp::QoS qos(1); // reliable, the newest only; latched: given to those who come later, if both sides ask for it
        qos.reliable();
        if (latched) qos.transient_local();
        if (kind == "nav_msgs/Path") {
            path_ = create_subscription<Path>("path", qos, [this](const Path::ConstSharedPtr &message) {
                points_of(message->poses, points_);
                speeds_of_path(*message, speeds_);
                follower_->path(points_, speeds_, message->header.frame_id);
            });
            return;
        }
#ifdef ADAPTRACK_WITH_TRAJECTORY
        using autoware_planning_msgs::msg::Trajectory;
        if (kind == "autoware_planning_msgs/Trajectory") {
            path_ = create_subscription<Trajectory>("path", qos, [this](const Trajectory::ConstSharedPtr &message) {
                points_of(message->points, points_);
                speeds_of_trajectory(*message, speeds_);
                follower_->path(points_, speeds_, message->header.frame_id);
            });
            return;
        }
#endif
        throw std::invalid_argument("path_message = '" + kind +
                                    "': must be nav_msgs/Path, or autoware_planning_msgs/Trajectory where the node was "
                                    "built with it.");
    }

    // s, on the clock of the stamps: simulated where use_sim_time is set
    double seconds_now() { return 1e-9 * static_cast<double>(get_clock()->now().nanoseconds()); }

    void tick() {
        const Command *command = follower_->tick(seconds_now());
        if (command == nullptr) return;
        AckermannDriveStamped message;
        message.header.stamp = get_clock()->now();
        message.header.frame_id = follower_->parameters.base_frame;
        fill_drive(*command, message.drive);
        drive_->publish(message);
    }

    void diagnose() {
        DiagnosticArray message;
        message.header.stamp = get_clock()->now();
        message.status.emplace_back();
        fill_status(follower_->diagnosis(seconds_now()), message.status.back());
        diagnostics_->publish(message);
    }

    std::unique_ptr<Follower> follower_;
    double angle_ = 0.0;
    std::vector<double> points_, speeds_;
    rclcpp::Publisher<AckermannDriveStamped>::SharedPtr drive_;
    rclcpp::Publisher<DiagnosticArray>::SharedPtr diagnostics_;
    rclcpp::Subscription<Odometry>::SharedPtr odometry_;
    rclcpp::SubscriptionBase::SharedPtr motion_, path_;
    rclcpp::Subscription<AckermannDriveStamped>::SharedPtr wheel_angle_;
    rclcpp::Subscription<Bool>::SharedPtr engage_;
    std::vector<rclcpp::TimerBase::SharedPtr> timers_;
};

} // namespace adaptrack_ros

int main(int argc, char **argv) {
    rclcpp::init(argc, argv);
    rclcpp::spin(std::make_shared<adaptrack_ros::FollowerNode>());
    rclcpp::shutdown();
    return 0;
}

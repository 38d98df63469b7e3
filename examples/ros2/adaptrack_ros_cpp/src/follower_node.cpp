// The node: messages to `Follower`, its commands to the car. All that is decided is decided there.
#include "adaptrack_ros_cpp/follower.hpp"
#include "adaptrack_ros_cpp/messages.hpp"

#include <ackermann_msgs/msg/ackermann_drive_stamped.hpp>
#ifdef ADAPTRACK_WITH_CONTROL
#include <autoware_control_msgs/msg/control.hpp>
#endif
#ifdef ADAPTRACK_WITH_TRAJECTORY
#include <autoware_planning_msgs/msg/trajectory.hpp>
#endif
#include <diagnostic_msgs/msg/diagnostic_array.hpp>
#include <geometry_msgs/msg/pose_stamped.hpp>
#include <geometry_msgs/msg/twist_stamped.hpp>
#include <nav_msgs/msg/odometry.hpp>
#include <nav_msgs/msg/path.hpp>
#include <rclcpp/rclcpp.hpp>
#include <sensor_msgs/msg/imu.hpp>
#include <std_msgs/msg/bool.hpp>
#include <tf2_ros/buffer.h>
#include <tf2_ros/transform_listener.h>

#include <cstdio>
#include <exception>
#include <fstream>
#include <functional>
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
constexpr int warning_period = 2000;       // ms, at least between two warnings in the log

Parameters declared(rclcpp::Node &node) {
    Parameters p;
    p.pose_message = node.declare_parameter("pose_message", p.pose_message);
    p.motion_message = node.declare_parameter("motion_message", p.motion_message);
    p.follow = node.declare_parameter("follow", p.follow);
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
        publish_drive_as(declare_parameter("drive_message", std::string("ackermann_msgs/AckermannDriveStamped")));
        predicted_ = create_publisher<Path>("predicted_path", rclcpp::QoS(1));
        diagnostics_ = create_publisher<DiagnosticArray>("/diagnostics", rclcpp::QoS(10));
        subscribe_to_pose(follower_->parameters.pose_message, declare_parameter("map_frame", std::string("map")));
        subscribe_to_motion(follower_->parameters.motion_message);
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
    template <class Message>
    void publish_drive(std::function<void(const Command &, Message &)> fill) {
        const auto publisher = create_publisher<Message>("drive", rclcpp::QoS(1));
        send_ = [publisher, fill](const Command &command) {
            Message message;
            fill(command, message);
            publisher->publish(message);
        };
    }

    void publish_drive_as(const std::string &kind) {
        if (kind == "ackermann_msgs/AckermannDriveStamped")
            return publish_drive<AckermannDriveStamped>([this](const Command &command, auto &message) {
                message.header.stamp = get_clock()->now();
                message.header.frame_id = follower_->parameters.base_frame;
                fill_drive(command, message.drive);
            });
#ifdef ADAPTRACK_WITH_CONTROL
        if (kind == "autoware_control_msgs/Control")
            return publish_drive<autoware_control_msgs::msg::Control>([this](const Command &command, auto &message) {
                const builtin_interfaces::msg::Time stamp = get_clock()->now();
                fill_control(command, stamp, Follower::period, message);
            });
#endif
        throw std::invalid_argument("drive_message = '" + kind + "': must be ackermann_msgs/AckermannDriveStamped, or "
                                    "autoware_control_msgs/Control where the node was built with it.");
    }

    template <class Message, class Call>
    rclcpp::SubscriptionBase::SharedPtr subscribe(const std::string &topic, Call call) {
        return create_subscription<Message>(
            topic, rclcpp::SensorDataQoS(),
            [call](const typename Message::ConstSharedPtr &message) { call(*message); });
    }

    void subscribe_to_pose(const std::string &kind, const std::string &map) {
        const double ahead = follower_->base_ahead_of_mass();
        if (kind == "nav_msgs/Odometry") {
            pose_ = subscribe<Odometry>("odom", [this, ahead](const Odometry &m) {
                follower_->pose(sample_of(m, ahead), m.header.frame_id, m.child_frame_id);
            });
        } else if (kind == "tf") {
            buffer_ = std::make_unique<tf2_ros::Buffer>(get_clock());
            listener_ = std::make_unique<tf2_ros::TransformListener>(*buffer_);
            map_ = map;
        } else {
            using geometry_msgs::msg::PoseStamped;
            pose_ = subscribe<PoseStamped>("pose", [this, ahead](const PoseStamped &m) {
                follower_->pose(sample_of(m.header.stamp, m.pose.position, m.pose.orientation, ahead),
                                m.header.frame_id, {});
            });
        }
    }

    // Take the newest transform from the base frame to the map.
    void look_up_pose() try {
        const auto m = buffer_->lookupTransform(map_, follower_->parameters.base_frame, tf2::TimePointZero);
        follower_->pose(sample_of(m.header.stamp, m.transform.translation, m.transform.rotation,
                                  follower_->base_ahead_of_mass()),
                        m.header.frame_id, m.child_frame_id);
    } catch (const tf2::TransformException &error) {
        follower_->miss_pose(error.what());
    }

    void subscribe_to_motion(const std::string &kind) {
        using geometry_msgs::msg::TwistStamped;
        using sensor_msgs::msg::Imu;
        if (kind == "geometry_msgs/TwistStamped")
            motion_ = subscribe<TwistStamped>("motion", [this](const TwistStamped &m) {
                follower_->motion(motion_of(m.header.stamp, m.twist), m.header.frame_id);
            });
        else if (kind == "nav_msgs/Odometry")
            motion_ = subscribe<Odometry>("motion", [this](const Odometry &m) {
                follower_->motion(motion_of(m.header.stamp, m.twist.twist), m.child_frame_id);
            });
        else if (kind == "sensor_msgs/Imu")
            motion_ = subscribe<Imu>("motion", [this](const Imu &m) { follower_->motion(motion_of_imu(m)); });
    }

    void subscribe_to_path(const std::string &kind, bool latched) {
        rclcpp::QoS qos(1); // reliable, the newest only; latched: given to those who come later, if both sides ask for it
        qos.reliable();
        if (latched) qos.transient_local();
        if (kind == "nav_msgs/Path") {
#if ADAPTRACK_PLANNER
            if (follower_->parameters.follow == "trajectory")
                return subscribe_to_trajectories<Path>(qos, trajectory_of_path<Path>);
#endif
            path_ = create_subscription<Path>("path", qos, [this](const Path::ConstSharedPtr &message) {
                points_of(message->poses, points_);
                speeds_of_path(*message, speeds_);
                follower_->path(points_, speeds_, message->header.frame_id);
                warn(follower_->left_out());
            });
            return;
        }
#ifdef ADAPTRACK_WITH_TRAJECTORY
        using autoware_planning_msgs::msg::Trajectory;
        if (kind == "autoware_planning_msgs/Trajectory") {
#if ADAPTRACK_PLANNER
            if (follower_->parameters.follow == "trajectory")
                return subscribe_to_trajectories<Trajectory>(qos, trajectory_of<Trajectory>);
#endif
            path_ = create_subscription<Trajectory>("path", qos, [this](const Trajectory::ConstSharedPtr &message) {
                points_of(message->points, points_);
                speeds_of_trajectory(*message, speeds_);
                follower_->path(points_, speeds_, message->header.frame_id);
                warn(follower_->left_out());
            });
            return;
        }
#endif
        throw std::invalid_argument("path_message = '" + kind +
                                    "': must be nav_msgs/Path, or autoware_planning_msgs/Trajectory where the node was "
                                    "built with it.");
    }

#if ADAPTRACK_PLANNER
    // Trajectories and their fallbacks; decode: writes the points of a message and returns its stamp (s).
    template <class Message>
    void subscribe_to_trajectories(const rclcpp::QoS &qos,
                                   double (*decode)(const Message &, std::vector<adaptrack_point> &)) {
        const auto subscribe = [this, &qos, decode](const char *topic, auto take) {
            return create_subscription<Message>(
                topic, qos, [this, decode, take](const typename Message::ConstSharedPtr &message) {
                    const double stamp = decode(*message, planned_);
                    (*follower_.*take)(planned_, stamp, seconds_now(), message->header.frame_id);
                    warn(follower_->left_out());
                });
        };
        path_ = subscribe("path", &Follower::trajectory);
        fallback_ = subscribe("fallback", &Follower::fallback);
    }
#endif

    void warn(const std::string &text) {
        if (!text.empty()) RCLCPP_WARN_THROTTLE(get_logger(), *get_clock(), warning_period, "%s", text.c_str());
    }

    // s, on the clock of the stamps: simulated where use_sim_time is set
    double seconds_now() { return 1e-9 * static_cast<double>(get_clock()->now().nanoseconds()); }

    void tick() {
        if (buffer_) look_up_pose();
        const Command *command = follower_->tick(seconds_now());
        if (!command) return;
        send_(*command);
        const builtin_interfaces::msg::Time stamp = get_clock()->now();
        fill_path(follower_->predicted_path(), stamp, follower_->path_frame(), predicted_path_);
        predicted_->publish(predicted_path_);
    }

    void diagnose() {
        DiagnosticArray message;
        message.header.stamp = get_clock()->now();
        message.status.emplace_back();
        const Diagnosis diagnosis = follower_->diagnosis(seconds_now());
        fill_status(diagnosis, message.status.back());
        diagnostics_->publish(message);
        warn(diagnosis.level == Diagnosis::ok ? "" : diagnosis.text);
    }

    std::unique_ptr<Follower> follower_;
    double angle_ = 0.0;
    std::vector<double> points_, speeds_;
#if ADAPTRACK_PLANNER
    std::vector<adaptrack_point> planned_;
#endif
    std::function<void(const Command &)> send_;
    Path predicted_path_;
    rclcpp::Publisher<Path>::SharedPtr predicted_;
    std::unique_ptr<tf2_ros::Buffer> buffer_; // where the pose comes from tf
    std::unique_ptr<tf2_ros::TransformListener> listener_;
    std::string map_;
    rclcpp::Publisher<DiagnosticArray>::SharedPtr diagnostics_;
    rclcpp::SubscriptionBase::SharedPtr pose_, motion_, path_, fallback_;
    rclcpp::Subscription<AckermannDriveStamped>::SharedPtr wheel_angle_;
    rclcpp::Subscription<Bool>::SharedPtr engage_;
    std::vector<rclcpp::TimerBase::SharedPtr> timers_;
};

} // namespace adaptrack_ros

int main(int argc, char **argv) try {
    rclcpp::init(argc, argv);
    rclcpp::spin(std::make_shared<adaptrack_ros::FollowerNode>());
    rclcpp::shutdown();
    return 0;
} catch (const std::exception &error) {
    std::fprintf(stderr, "adaptrack_follower: %s\n", error.what());
    return 1;
}

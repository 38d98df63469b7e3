// Stand-ins of ROS 2: messages with the fields of their definitions, and as much of rclcpp as the node uses.
#ifndef ROS_STAND_IN_HPP
#define ROS_STAND_IN_HPP
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <functional>
#include <map>
#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

namespace builtin_interfaces::msg {
struct Time {
    std::int32_t sec = 0;
    std::uint32_t nanosec = 0;
};
using Duration = Time;
} // namespace builtin_interfaces::msg

namespace std_msgs::msg {
struct Header {
    builtin_interfaces::msg::Time stamp;
    std::string frame_id;
};
struct Bool {
    using ConstSharedPtr = std::shared_ptr<const Bool>;
    bool data = false;
};
} // namespace std_msgs::msg

namespace geometry_msgs::msg {
struct Vector3 {
    double x = 0.0, y = 0.0, z = 0.0;
};
using Point = Vector3;
struct Quaternion {
    double x = 0.0, y = 0.0, z = 0.0, w = 1.0;
};
struct Pose {
    Point position;
    Quaternion orientation;
};
struct Twist {
    Vector3 linear, angular;
};
struct TwistStamped {
    using ConstSharedPtr = std::shared_ptr<const TwistStamped>;
    std_msgs::msg::Header header;
    Twist twist;
};
struct PoseStamped {
    using ConstSharedPtr = std::shared_ptr<const PoseStamped>;
    std_msgs::msg::Header header;
    Pose pose;
};
struct Transform {
    Vector3 translation;
    Quaternion rotation;
};
struct TransformStamped {
    std_msgs::msg::Header header;
    std::string child_frame_id;
    Transform transform;
};
struct PoseWithCovariance {
    Pose pose;
};
struct TwistWithCovariance {
    Twist twist;
};
} // namespace geometry_msgs::msg

namespace sensor_msgs::msg {
struct Imu {
    using ConstSharedPtr = std::shared_ptr<const Imu>;
    std_msgs::msg::Header header;
    geometry_msgs::msg::Vector3 angular_velocity;
};
} // namespace sensor_msgs::msg

namespace nav_msgs::msg {
struct Odometry {
    using ConstSharedPtr = std::shared_ptr<const Odometry>;
    std_msgs::msg::Header header;
    std::string child_frame_id;
    geometry_msgs::msg::PoseWithCovariance pose;
    geometry_msgs::msg::TwistWithCovariance twist;
};
struct Path {
    using ConstSharedPtr = std::shared_ptr<const Path>;
    std_msgs::msg::Header header;
    std::vector<geometry_msgs::msg::PoseStamped> poses;
};
} // namespace nav_msgs::msg

namespace autoware_planning_msgs::msg {
struct TrajectoryPoint {
    builtin_interfaces::msg::Duration time_from_start;
    geometry_msgs::msg::Pose pose;
    float longitudinal_velocity_mps = 0.0F, acceleration_mps2 = 0.0F;
};
struct Trajectory {
    using ConstSharedPtr = std::shared_ptr<const Trajectory>;
    std_msgs::msg::Header header;
    std::vector<TrajectoryPoint> points;
};
} // namespace autoware_planning_msgs::msg

namespace ackermann_msgs::msg {
struct AckermannDrive {
    float steering_angle = 0.0F, steering_angle_velocity = 0.0F, speed = 0.0F, acceleration = 0.0F, jerk = 0.0F;
};
struct AckermannDriveStamped {
    using ConstSharedPtr = std::shared_ptr<const AckermannDriveStamped>;
    std_msgs::msg::Header header;
    AckermannDrive drive;
};
} // namespace ackermann_msgs::msg

namespace autoware_control_msgs::msg {
struct Lateral {
    builtin_interfaces::msg::Time stamp, control_time;
    float steering_tire_angle = 0.0F, steering_tire_rotation_rate = 0.0F;
    bool is_defined_steering_tire_rotation_rate = false;
};
struct Longitudinal {
    builtin_interfaces::msg::Time stamp, control_time;
    float velocity = 0.0F, acceleration = 0.0F, jerk = 0.0F;
    bool is_defined_acceleration = false, is_defined_jerk = false;
};
struct Control {
    using ConstSharedPtr = std::shared_ptr<const Control>;
    builtin_interfaces::msg::Time stamp, control_time;
    Lateral lateral;
    Longitudinal longitudinal;
};
} // namespace autoware_control_msgs::msg

namespace diagnostic_msgs::msg {
struct KeyValue {
    std::string key, value;
};
struct DiagnosticStatus {
    unsigned char level = 0;
    std::string name, message, hardware_id;
    std::vector<KeyValue> values;
};
struct DiagnosticArray {
    using ConstSharedPtr = std::shared_ptr<const DiagnosticArray>;
    std_msgs::msg::Header header;
    std::vector<DiagnosticStatus> status;
};
} // namespace diagnostic_msgs::msg

namespace rclcpp {

class Time {
  public:
    explicit Time(std::int64_t nanoseconds) : nanoseconds_(nanoseconds) {}
    std::int64_t nanoseconds() const { return nanoseconds_; }
    operator builtin_interfaces::msg::Time() const {
        return {static_cast<std::int32_t>(nanoseconds_ / 1000000000), static_cast<std::uint32_t>(nanoseconds_ % 1000000000)};
    }

  private:
    std::int64_t nanoseconds_;
};

class Duration {
  public:
    static Duration from_seconds(double seconds) { return Duration{seconds}; }
    double seconds;
};

class QoS {
  public:
    explicit QoS(std::size_t count) : depth(count) {}
    QoS &reliable() { return *this; }
    QoS &transient_local() {
        latched = true;
        return *this;
    }
    std::size_t depth;
    bool latched = false;
};
struct SensorDataQoS : QoS {
    SensorDataQoS() : QoS(5) {}
};

class TimerBase {
  public:
    using SharedPtr = std::shared_ptr<TimerBase>;
    double period, due;
    std::function<void()> call;
};

class SubscriptionBase {
  public:
    using SharedPtr = std::shared_ptr<SubscriptionBase>;
    virtual ~SubscriptionBase() = default;
};
template <class Message>
class Subscription : public SubscriptionBase {
  public:
    using SharedPtr = std::shared_ptr<Subscription>;
    std::function<void(const typename Message::ConstSharedPtr &)> call;
};

// Time, timers and topics, by hand.
struct Network {
    std::int64_t now = 1000000000000; // ns
    std::vector<TimerBase::SharedPtr> timers;
    std::map<std::string, std::vector<std::shared_ptr<SubscriptionBase>>> topics;
    std::map<std::string, std::string> parameters;
    std::shared_ptr<geometry_msgs::msg::TransformStamped> transform; // of tf
    std::function<void()> world; // what happens while the node spins

    double seconds() const { return 1e-9 * static_cast<double>(now); }
    // Let time pass in steps of 10 ms, and call the timers that are due.
    void run(double duration) {
        const std::int64_t end = now + std::llround(1e9 * duration);
        while (now < end) {
            now += 10000000;
            for (auto &timer : timers)
                if (seconds() > timer->due - 1e-9) {
                    timer->due += timer->period;
                    timer->call();
                }
        }
    }
    template <class Message>
    void publish(const std::string &topic, const Message &message) {
        for (auto &each : topics[topic])
            dynamic_cast<Subscription<Message> &>(*each).call(std::make_shared<const Message>(message));
    }
    template <class Message>
    std::shared_ptr<Subscription<Message>> listen(const std::string &topic,
                                                  std::function<void(const typename Message::ConstSharedPtr &)> call) {
        auto made = std::make_shared<Subscription<Message>>();
        made->call = std::move(call);
        topics[topic].push_back(made);
        return made;
    }
};
inline Network network;

template <class Message>
class Publisher {
  public:
    using SharedPtr = std::shared_ptr<Publisher>;
    std::string topic;
    void publish(const Message &message) { network.publish(topic, message); }
};

struct Clock {
    using SharedPtr = std::shared_ptr<Clock>;
    Time now() const { return Time(network.now); }
};
struct Logger {};

class Node {
  public:
    explicit Node(const std::string &) {}
    virtual ~Node() = default;
    Clock::SharedPtr get_clock() { return std::make_shared<Clock>(); }
    Logger get_logger() const { return {}; }
    std::string declare_parameter(const std::string &name, const std::string &value) {
        return network.parameters.count(name) ? network.parameters[name] : value;
    }
    double declare_parameter(const std::string &, double value) { return value; }
    bool declare_parameter(const std::string &, bool value) { return value; }
    template <class Message>
    typename Publisher<Message>::SharedPtr create_publisher(const std::string &topic, const QoS &) {
        return std::make_shared<Publisher<Message>>(Publisher<Message>{topic});
    }
    template <class Message, class Call>
    typename Subscription<Message>::SharedPtr create_subscription(const std::string &topic, const QoS &, Call call) {
        return network.listen<Message>(topic, std::move(call));
    }
};

template <class Call>
TimerBase::SharedPtr create_timer(Node *, const Clock::SharedPtr &, const Duration &period, Call call) {
    auto made = std::make_shared<TimerBase>(TimerBase{period.seconds, network.seconds() + period.seconds, call});
    network.timers.push_back(made);
    return made;
}
inline void init(int, char **) {}
inline void spin(const std::shared_ptr<Node> &) { network.world(); }
inline void shutdown() {}

} // namespace rclcpp

namespace tf2 {
constexpr int TimePointZero = 0;
using TransformException = std::runtime_error;
} // namespace tf2

namespace tf2_ros {
struct Buffer {
    explicit Buffer(const rclcpp::Clock::SharedPtr &) {}
    geometry_msgs::msg::TransformStamped lookupTransform(const std::string &target, const std::string &source, int) {
        if (rclcpp::network.transform) return *rclcpp::network.transform;
        throw tf2::TransformException("no transform from " + source + " to " + target);
    }
};
struct TransformListener {
    explicit TransformListener(Buffer &) {}
};
} // namespace tf2_ros

#define RCLCPP_INFO(logger, ...) (static_cast<void>(logger), std::printf(__VA_ARGS__), std::printf("\n"))
#define RCLCPP_WARN_THROTTLE(logger, clock, milliseconds, ...)                                                         \
    (static_cast<void>(clock), static_cast<void>(milliseconds), std::printf("warning="), RCLCPP_INFO(logger, __VA_ARGS__))
#endif

// What the node does, without ROS: messages come in when they come, `tick` gives the command of each period.
#ifndef ADAPTRACK_ROS_CPP_FOLLOWER_HPP
#define ADAPTRACK_ROS_CPP_FOLLOWER_HPP
#include "adaptrack.h"

#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <optional>
#include <string>
#include <utility>
#include <vector>

namespace adaptrack_ros {

// As in adaptrack_ros/config/follower.yaml; car, sensors and delays are in the exported constants.
struct Parameters {
    std::string pose_message = "nav_msgs/Odometry"; // on odom; geometry_msgs/PoseStamped on pose, or tf
    std::string motion_message;           // geometry_msgs/TwistStamped, nav_msgs/Odometry or sensor_msgs/Imu on motion
    std::string follow = "path";          // or trajectory: by its times, with an export for it
    std::string base_frame = "base_link"; // frame of the car: of the odometry's child and of the motion
    double base_ahead = 0.0;              // m, from the centre of the rear axle forwards to the origin of the base frame
    double top_speed = 10.0;              // m/s, beside what bends allow, and beside the path's speeds where it has some
    bool stop_at_end = true;              // plan to stand at the end of every path; not where the path has speeds
    double acceleration = 1.5;            // m/s^2, how fast the speed may be changed
    double stop_deceleration = 3.0;       // m/s^2, of the safe command
    double longest_silence = 0.3;         // s, age of the newest pose or speed from which on the car is stopped
    double furthest = 3.0;                // m from the path, from which on the car is stopped
};

// Of the centre of mass: s, m, m, rad, m/s, rad/s; speed and yaw rate are NaN in a pose without motion.
struct Sample {
    double t = NAN, x = NAN, y = NAN, yaw = NAN, speed = NAN, yaw_rate = NAN;
};

// Motion with a stamp of its own: s, m/s (NaN: not measured), rad/s.
struct Motion {
    double t = NAN, speed = NAN, yaw_rate = NAN;
};

// What is sent.
struct Command {
    double angle = 0.0;        // rad, of the road wheels, positive to the left
    double speed = 0.0;        // m/s
    double acceleration = 0.0; // m/s^2, > 0, how fast to change to it; of the speed control where it was exported
    std::string stopping;      // why it is the safe command; empty when it is not
    double angle_rate = 0.0;   // rad/s, of the angle since the command before
    double request = NAN;      // m/s^2, dv/dt of the speed control or the safe command; NaN: none
};

// For a diagnostic_msgs/DiagnosticStatus.
struct Diagnosis {
    enum Level { ok, warn, error };
    Level level;
    std::string text;
    std::vector<std::pair<std::string, std::string>> values;
};

// Follows the newest path by the newest odometry. Memory is allocated by paths that are longer than those before, and
// for texts; nothing is while all goes well.
class Follower {
  public:
    // Of exported constants. Throws std::invalid_argument for a parameter that is not possible, std::runtime_error for
    // constants that are none of this library.
    Follower(const Parameters &parameters, const void *constants, std::size_t size);
    Follower(const Follower &) = delete;
    Follower &operator=(const Follower &) = delete;

    const Parameters parameters;
    static constexpr double period = ADAPTRACK_PERIOD; // s, between ticks
    // m, of the base frame ahead of the centre of mass
    double base_ahead_of_mass() const { return parameters.base_ahead - ADAPTRACK_REAR_AXLE; }

    // A pose in a frame, in whatever order; one that cannot be used is left out, and the diagnostics say why.
    void pose(const Sample &sample, const std::string &frame, const std::string &child_frame);
    // Let the diagnostics say why there is no pose.
    void miss_pose(const std::string &why) { pose_trouble_ = why; }
    // From the first one on the twist of the odometry is not used, but for its speed where a motion has none.
    void motion(const Motion &motion, const std::string &frame = "");
    // A path through points x, y (m), one behind the other, and speeds (m/s) at them, or none; an empty one stops the
    // car. One that cannot be driven is refused, the one before is followed on, and the diagnostics say why.
    void path(const std::vector<double> &points, const std::vector<double> &speeds, const std::string &frame);
#if ADAPTRACK_PLANNER
    // A trajectory with a stamp (s) that arrives at a time (s); an empty one is the silence of its planner.
    void trajectory(const std::vector<adaptrack_point> &points, double stamp, double now, const std::string &frame);
    // Hold a fallback, which ends at rest, for the next trajectory. Only the newest is held, and it is handed over once.
    // One that cannot be used is left out then, and the diagnostics say why.
    void fallback(const std::vector<adaptrack_point> &points, double stamp, double now, const std::string &frame);
#endif
    // Begin to drive from the angle (rad) that the wheels have, or leave the car to somebody else.
    void engage(bool on, double wheel_angle = 0.0);
    // The command for now (s, on the clock of the stamps), once per period; none while somebody else drives.
    const Command *tick(double now);
    // Where the controller expects the centre of mass, without a motion: t is s after the last tick, yaw the direction
    // of the way. Empty where it expects nothing, and while the safe command is sent.
    const std::vector<Sample> &predicted_path();
    const std::string &path_frame() const { return path_frame_; }
    // Kinds of messages of which the newest was left out, and why; empty: none.
    std::string left_out() const;
    Diagnosis diagnosis(double now) const;

  private:
    // A path as a road, and the speed along it.
    struct Planned {
        std::vector<std::uint64_t> road;
        std::vector<double> s, speed; // m, m/s
#if ADAPTRACK_SPEED_CONTROL
        std::vector<std::uint64_t> plan;
        std::vector<double> stops, seconds; // m, s
        std::string make_plan();
#endif
        adaptrack_error follow(void *tracker) const;
        double speed_at(double place) const;
        double stop_beyond(double place) const;
    };

    std::string why_not(Planned &planned, const std::vector<double> &points, const std::vector<double> &speeds) const;
    void plan_speeds(Planned &planned) const;
    std::string wrong_frame(const std::string &frame) const;
    std::string why_blind(double now) const;
    std::string why_late(double age, const char *noun, const char *topic) const;
    std::string why_stopped() const;
    double braking_speed(double now);
    void command(double speed, double acceleration, double request, std::string stopping);
    void stop(std::string why);
    double target_speed(double station);
    void go();

    std::vector<std::uint64_t> tracker_;
    std::array<Planned, 2> paths_; // the one that is followed, and the next one
    std::size_t followed_ = 0;
    bool has_path_ = false, halted_ = false, engaged_ = true, stopping_ = false;
    double sample_speed_ = 0.0;      // m/s, of the last call
    double left_ = 0.0, next_ = 0.0; // m, where it began to drive along the path, and its next stop; NaN: a new path
#if ADAPTRACK_PLANNER
    std::string fallback_flaw(double stamp, double now, const std::string &frame) const;
    std::vector<std::uint64_t> planner_; // memory for trajectories
    bool has_begun_ = false;             // with the first trajectory
    std::optional<adaptrack_verdict> verdict_;
    struct {
        bool is_held = false;
        std::vector<adaptrack_point> points;
        double stamp = 0.0, now = 0.0; // s, of its arrival
        std::string frame;
    } fallback_; // until a trajectory takes it
    double fallback_time_ = -std::numeric_limits<double>::infinity(); // s, of the trajectory that took the last one
#endif
    std::vector<double> points_, speeds_;
    std::string path_frame_, pose_frame_, path_trouble_, pose_trouble_, motion_trouble_, fallback_trouble_;
    std::optional<Sample> fresh_;
    std::optional<Motion> fresh_motion_;
    double newest_ = -std::numeric_limits<double>::infinity(), speed_ = 0.0, braked_ = newest_, angle_ = 0.0;
    double newest_motion_ = newest_, newest_speed_ = newest_;
    std::optional<adaptrack_answer> answer_;
    adaptrack_error error_ = ADAPTRACK_OK;
    Command command_;
    std::vector<Sample> predicted_;
};

} // namespace adaptrack_ros
#endif

#include "adaptrack_ros_cpp/follower.hpp"

#include <algorithm>
#include <cstdio>
#include <stdexcept>

namespace adaptrack_ros {
namespace {

constexpr double clock_jump = 2.0; // s: stamps that are older than the newest by more begin anew, as of another bag
constexpr double lateral = 3.0;    // m/s^2, of planned speeds
// Of `SpeedTarget` in Python.
constexpr double standing = 0.1;  // m/s
constexpr double at_stop = 0.25;  // m, of a standing car from a stop that counts as reached
constexpr double overshot = 3.0;  // m, of a car that is stopping from the stop of another path that counts as the same
constexpr double jump = 20.0;     // m, beyond the last and the next stop: the car has been moved rather than driven
constexpr double short_step = 0.02; // m, to the next predicted point: below it the yaw stays, the car hardly moves
#if ADAPTRACK_SPEED_CONTROL
constexpr double least_acceleration = 0.01; // m/s^2: in an AckermannDrive 0 means as quickly as possible
#endif
constexpr const char *no_path = "no path yet on topic path";
#if ADAPTRACK_PLANNER
constexpr std::array verdicts{"taken", "same", "older", "stale", "early", "silent", "waiting", "unfit"};
constexpr std::array drivers{"nobody", "planner", "fallback", "stop"};
constexpr double oldest = 1.0; // s, of the stamp of a fallback relative to that of its trajectory
#endif
constexpr double nowhere = std::numeric_limits<double>::quiet_NaN();

template <class... Arguments>
std::string text_of(const char *format, Arguments... arguments) {
    std::array<char, 160> text{};
    std::snprintf(text.data(), text.size(), format, arguments...);
    return text.data();
}

bool is_finite(const Sample &each, bool has_motion) {
    return std::isfinite(each.t) && std::isfinite(each.x) && std::isfinite(each.y) && std::isfinite(each.yaw) &&
           (!has_motion || (std::isfinite(each.speed) && std::isfinite(each.yaw_rate)));
}

// Noun and topic of the pose.
std::pair<const char *, const char *> pose_words(const Parameters &p) {
    if (p.pose_message == "nav_msgs/Odometry") return {"odometry", "odom"};
    if (p.pose_message == "tf") return {"transform", "tf"};
    return {"pose", "pose"};
}

// Refuse messages that there are not, and a pose without a speed.
void check_messages(const Parameters &p) {
    const auto check = [](const char *name, const std::string &value, std::initializer_list<const char *> messages) {
        std::string names;
        for (const std::string message : messages) {
            if (message == value) return;
            names += (names.empty() ? "" : ", ") + (message.empty() ? "empty" : message);
        }
        throw std::invalid_argument(name + (" = '" + value + "': must be one of " + names + "."));
    };
    check("pose_message", p.pose_message, {"nav_msgs/Odometry", "geometry_msgs/PoseStamped", "tf"});
    check("motion_message", p.motion_message, {"", "geometry_msgs/TwistStamped", "nav_msgs/Odometry", "sensor_msgs/Imu"});
#if ADAPTRACK_PLANNER
    check("follow", p.follow, {"path", "trajectory"});
#else
    if (p.follow == "trajectory") throw std::invalid_argument("follow = 'trajectory': export the controller with it.");
    check("follow", p.follow, {"path"});
#endif
    if (p.pose_message != "nav_msgs/Odometry" && (p.motion_message.empty() || p.motion_message == "sensor_msgs/Imu"))
        throw std::invalid_argument("pose_message = '" + p.pose_message + "' has no speed: give motion_message = "
                                    "geometry_msgs/TwistStamped or nav_msgs/Odometry.");
}

double distance_of(const double *a, const double *b) { return std::hypot(b[0] - a[0], b[1] - a[1]); }

// rad, from one point to another.
double direction(const double *a, const double *b) { return std::atan2(b[1] - a[1], b[0] - a[0]); }

const char *status_name(adaptrack_status status) {
    static constexpr std::array names{"ok",      "estimated", "held",    "standing", "reverse",
                                      "off-path", "end",      "sliding", "repeated", "no-time"};
    const auto place = static_cast<std::size_t>(status);
    return place < names.size() ? names[place] : "";
}

} // namespace

Follower::Follower(const Parameters &given, const void *constants, std::size_t size) : parameters(given) {
    for (const auto &[name, value] : {std::pair{"top_speed", given.top_speed}, {"acceleration", given.acceleration},
                                      {"stop_deceleration", given.stop_deceleration},
                                      {"longest_silence", given.longest_silence}, {"furthest", given.furthest}})
        if (!(value > 0.0 && std::isfinite(value)))
            throw std::invalid_argument(text_of("%s = %g: must be positive and finite.", name, value));
    check_messages(given);
    if (!std::isfinite(given.base_ahead)) throw std::invalid_argument("base_ahead: must be finite.");
#if ADAPTRACK_SPEED_CONTROL
    if (given.top_speed > ADAPTRACK_TOP_SPEED)
        throw std::invalid_argument(text_of("top_speed = %g: the exported speed control drives up to %g m/s.",
                                            given.top_speed, ADAPTRACK_TOP_SPEED));
#endif
    tracker_.resize((adaptrack_size(constants, size) + 7) / 8);
    const adaptrack_error error = adaptrack_init(tracker_.data(), 8 * tracker_.size(), constants, size);
    if (error != ADAPTRACK_OK) throw std::runtime_error(text_of("constants: adaptrack error %d.", static_cast<int>(error)));
    stop(no_path);
}

// -- what comes in ---------------------------------------------------------------------------------------------------
// What is wrong with a message about a frame of the car; empty: nothing.
std::string Follower::wrong_frame(const std::string &frame) const {
    const std::string &base = parameters.base_frame;
    if (frame.empty() || base.empty() || frame == base) return {};
    return "it is of frame '" + frame + "', and base_frame is '" + base + "'";
}

void Follower::pose(const Sample &sample, const std::string &frame, const std::string &child_frame) {
    pose_trouble_ = wrong_frame(child_frame);
    if (pose_trouble_.empty() && !is_finite(sample, parameters.pose_message == "nav_msgs/Odometry"))
        pose_trouble_ = "its numbers must be finite";
    if (!pose_trouble_.empty()) return;
    pose_frame_ = frame;
    if (newest_ - clock_jump <= sample.t && sample.t <= newest_) {
        if (!fresh_ && sample.t < newest_)
            fresh_ = sample; // overtaken by one that has been used; the filter takes it in where it belongs
        return;
    }
    fresh_ = sample;
    newest_ = sample.t;
    if (std::isinf(newest_speed_) && std::isfinite(sample.speed)) speed_ = sample.speed;
}

void Follower::motion(const Motion &motion, const std::string &frame) {
    motion_trouble_ = wrong_frame(frame);
    if (motion_trouble_.empty() && !std::isfinite(motion.yaw_rate)) motion_trouble_ = "its yaw rate must be finite";
    if (!motion_trouble_.empty() || (newest_motion_ - clock_jump <= motion.t && motion.t <= newest_motion_)) return;
    fresh_motion_ = motion;
    newest_motion_ = motion.t;
    if (!std::isfinite(motion.speed)) return;
    speed_ = motion.speed;
    newest_speed_ = motion.t;
}

void Follower::path(const std::vector<double> &points, const std::vector<double> &speeds, const std::string &frame) {
    halted_ = points.empty();
    if (halted_ || (has_path_ && points == points_ && speeds == speeds_ && frame == path_frame_)) return;
    Planned &next = paths_[1 - followed_];
    path_trouble_ = why_not(next, points, speeds);
    if (!path_trouble_.empty()) return;
    adaptrack_error error = has_path_ ? ADAPTRACK_OK : adaptrack_engage(tracker_.data(), angle_, NAN);
    if (error == ADAPTRACK_OK) error = next.follow(tracker_.data());
    if (error != ADAPTRACK_OK) {
        path_trouble_ = text_of("adaptrack error %d", static_cast<int>(error));
        return;
    }
    followed_ = 1 - followed_;
    left_ = next_ = nowhere;
    has_path_ = true;
    points_ = points;
    speeds_ = speeds;
    path_frame_ = frame;
}

#if ADAPTRACK_PLANNER
void Follower::trajectory(const std::vector<adaptrack_point> &points, double stamp, double now,
                          const std::string &frame) {
    adaptrack_error error = ADAPTRACK_OK;
    if (!has_begun_) {
        planner_.resize(ADAPTRACK_PLANNER_SIZE / 8);
        error = adaptrack_engage(tracker_.data(), angle_, NAN);
        if (error == ADAPTRACK_OK) error = adaptrack_planner(tracker_.data(), planner_.data(), ADAPTRACK_PLANNER_SIZE);
        has_begun_ = error == ADAPTRACK_OK;
    }
    const adaptrack_trajectory planned = {points.data(), points.size(), stamp, now, 0};
    const adaptrack_trajectory fallback = {fallback_.points.data(), fallback_.points.size(), 0.0, now, 0};
    adaptrack_verdict verdict = ADAPTRACK_VERDICT_SILENT;
    std::size_t place = 0;
    const auto follow = [&](const adaptrack_trajectory *rest) {
        return adaptrack_follow_trajectory(tracker_.data(), &planned, rest, &verdict, &place);
    };
    std::string flaw = fallback_flaw(stamp, now, frame);
    const bool has_fallback = fallback_.is_held && flaw.empty();
    if (error == ADAPTRACK_OK) error = follow(has_fallback ? &fallback : nullptr);
    if (error != ADAPTRACK_OK && has_fallback) { // which of the two is not possible?
        flaw = text_of("point %zu: %s", place, adaptrack_error_name(error));
        error = follow(nullptr);
    }
    if (error != ADAPTRACK_OK) {
        path_trouble_ = text_of("point %zu: %s", place, adaptrack_error_name(error));
        return;
    }
    const bool is_followed = verdict == ADAPTRACK_VERDICT_TAKEN || verdict == ADAPTRACK_VERDICT_SAME;
    path_trouble_ = is_followed ? "" : text_of("it is %s", verdicts.at(static_cast<std::size_t>(verdict)));
    if (!flaw.empty() || (has_fallback && is_followed)) {
        if (flaw.empty()) fallback_time_ = now;
        fallback_trouble_ = std::move(flaw);
        fallback_.is_held = false;
    }
    has_path_ = has_path_ || verdict == ADAPTRACK_VERDICT_TAKEN;
    path_frame_ = frame;
    verdict_ = verdict;
}

void Follower::fallback(const std::vector<adaptrack_point> &points, double stamp, double now,
                        const std::string &frame) {
    fallback_.is_held = true;
    fallback_.points = points;
    fallback_.stamp = stamp, fallback_.now = now;
    fallback_.frame = frame;
}

// Why the held fallback does not fit a trajectory with a stamp (s) that arrives at a time (s); empty: no flaw.
std::string Follower::fallback_flaw(double stamp, double now, const std::string &frame) const {
    if (!fallback_.is_held) return {};
    if (fallback_.frame != frame) return "it is in frame '" + fallback_.frame + "', the trajectory in '" + frame + "'";
    const bool has_stamps = stamp > 0.0 && fallback_.stamp > 0.0;
    return (has_stamps ? stamp - fallback_.stamp : now - fallback_.now) > oldest ? "it is stale" : "";
}
#endif

void Follower::engage(bool on, double wheel_angle) {
    engaged_ = on;
    if (std::isfinite(wheel_angle)) angle_ = command_.angle = wheel_angle; // else as they were
    if (on && has_path_) error_ = adaptrack_engage(tracker_.data(), angle_, NAN);
}

// Why a path cannot be driven; empty when it can, and is written to `planned`.
std::string Follower::why_not(Planned &planned, const std::vector<double> &points,
                              const std::vector<double> &speeds) const {
    const std::size_t count = points.size() / 2;
    if (!speeds.empty() && speeds.size() != count) return "it needs a speed for each point, or none";
    for (const double speed : speeds)
        if (!(speed >= 0.0 && std::isfinite(speed)))
            return "its speeds must be finite and >= 0 m/s: nothing here drives backwards";
    std::size_t flaw = 0;
    adaptrack_error error = ADAPTRACK_TOO_SMALL;
    std::size_t words = (adaptrack_path_size(points.data(), count, 0) + 7) / 8;
    for (int round = 0; round < 4 && error == ADAPTRACK_TOO_SMALL; round++, words *= 2) { // sharp bends need more
        if (planned.road.size() < words) planned.road.resize(words);
        error = adaptrack_path(points.data(), count, 0, NAN, planned.road.data(), 8 * planned.road.size(), &flaw);
    }
    if (error != ADAPTRACK_OK)
        return text_of("point %zu: at least four points apart from each other, finite, no kink", flaw);
    planned.s.assign(1, 0.0);
    for (std::size_t k = 1; k < count; k++) { // ascending, also where a point comes twice
        const double s = planned.s.back();
        planned.s.push_back(std::max(s + distance_of(&points[2 * k - 2], &points[2 * k]), std::nextafter(s, s + 1.0)));
    }
    const double stretch = adaptrack_path_length(planned.road.data()) / planned.s.back();
    for (double &each : planned.s) each *= stretch;
    planned.speed.assign(count, parameters.top_speed);
    if (speeds.empty())
        plan_speeds(planned);
    else
        std::transform(speeds.begin(), speeds.end(), planned.speed.begin(),
                       [this](double speed) { return std::min(speed, parameters.top_speed); });
#if ADAPTRACK_SPEED_CONTROL
    return planned.make_plan();
#else
    return {};
#endif
}

#if ADAPTRACK_SPEED_CONTROL
// Make the plan of the speed control, with a stop wherever the speed is 0; why there is none, empty when there is.
std::string Follower::Planned::make_plan() {
    stops.clear();
    for (std::size_t k = 1; k + 1 < s.size(); k++)
        if (speed[k] == 0.0) stops.push_back(s[k]);
    seconds.assign(stops.size(), std::numeric_limits<double>::infinity()); // until another path comes
    adaptrack_speeds speeds{};
    speeds.s = s.data(), speeds.speed = speed.data(), speeds.count = s.size();
    speeds.stops = stops.data(), speeds.seconds = seconds.data(), speeds.stop_count = stops.size();
    plan.resize(std::max(plan.size(), (adaptrack_speed_plan_size(road.data(), &speeds) + 7) / 8));
    adaptrack_flaw flaw{};
    const adaptrack_error error = adaptrack_speed_plan(road.data(), &speeds, plan.data(), 8 * plan.size(), &flaw);
    return error == ADAPTRACK_OK ? std::string() : text_of("its speed at point %zu is not possible", flaw.index);
}

adaptrack_error Follower::Planned::follow(void *tracker) const {
    return adaptrack_follow_plan(tracker, road.data(), NAN, plan.data());
}
#else
adaptrack_error Follower::Planned::follow(void *tracker) const {
    const adaptrack_plan speeds = {s.data(), speed.data(), s.size()};
    return adaptrack_follow(tracker, road.data(), NAN, &speeds);
}
#endif

// The fastest speeds within `lateral` and `acceleration`: one pass forward, one backward over the square of the speed.
void Follower::plan_speeds(Planned &planned) const {
    const std::size_t count = planned.s.size();
    std::vector<double> &w = planned.speed;
    for (std::size_t k = 0; k < count; k++) {
        const double curvature = std::abs(adaptrack_path_curvature(planned.road.data(), planned.s[k]));
        w[k] = std::min(w[k] * w[k], lateral / std::max(curvature, 1e-9));
    }
    if (parameters.stop_at_end) w.back() = 0.0;
    const auto gain = [&](std::size_t k) { return 2.0 * parameters.acceleration * (planned.s[k] - planned.s[k - 1]); };
    for (std::size_t k = 1; k < count; k++) w[k] = std::min(w[k], w[k - 1] + gain(k));
    for (std::size_t k = count - 1; k > 0; k--) w[k - 1] = std::min(w[k - 1], w[k] + gain(k));
    for (double &each : w) each = std::sqrt(each);
}

double Follower::Planned::speed_at(double place) const {
    const auto after = std::upper_bound(s.begin(), s.end(), place);
    if (after == s.begin()) return speed.front();
    if (after == s.end()) return speed.back();
    const auto k = static_cast<std::size_t>(after - s.begin());
    const double low = speed[k - 1] * speed[k - 1], high = speed[k] * speed[k];
    return std::sqrt(low + (high - low) / (s[k] - s[k - 1]) * (place - s[k - 1]));
}

// -- what goes out ---------------------------------------------------------------------------------------------------
const Command *Follower::tick(double now) {
    std::optional<Sample> fresh;
    std::optional<Motion> motion;
    std::swap(fresh, fresh_);
    std::swap(motion, fresh_motion_);
    if (!engaged_) return nullptr;
    if (!has_path_) {
        stop(no_path);
        return &command_;
    }
    std::string why = why_blind(now);
    adaptrack_sample sample = ADAPTRACK_UNKNOWN;
    sample.now = now;
    if (why.empty() && fresh) {
        sample.t = fresh->t, sample.x = fresh->x, sample.y = fresh->y, sample.yaw = fresh->yaw;
        sample.speed = fresh->speed, sample.yaw_rate = fresh->yaw_rate;
    } else {
        sample.t = now;
        sample.speed = why.empty() ? speed_ : braking_speed(now);
    }
    if (std::isfinite(newest_motion_) && why.empty()) {
        sample.speed = speed_;
        sample.yaw_rate = motion ? motion->yaw_rate : NAN;
        if (motion) sample.motion_time = motion->t;
    }
    sample_speed_ = sample.speed;
    adaptrack_answer answer{};
    error_ = adaptrack_step(tracker_.data(), &sample, &answer);
    if (error_ == ADAPTRACK_OK) {
        answer_ = answer;
        if (answer.status == ADAPTRACK_STATUS_REPEATED) return &command_;
        angle_ = answer.command;
    }
    if (why.empty()) why = why_stopped();
    if (why.empty())
        go();
    else
        stop(std::move(why));
    return &command_;
}

// Why pose and speed cannot be driven by; empty when they can.
std::string Follower::why_blind(double now) const {
    const auto [noun, topic] = pose_words(parameters);
    if (!path_frame_.empty() && !pose_frame_.empty() && path_frame_ != pose_frame_)
        return "the path is in frame '" + path_frame_ + "', the " + noun + " in '" + pose_frame_ + "'";
    std::string why = why_late(now - newest_, noun, topic);
    const bool has_own_speed = parameters.pose_message == "nav_msgs/Odometry" && std::isinf(newest_speed_);
    return why.empty() && !has_own_speed ? why_late(now - newest_speed_, "speed", "motion") : why;
}

// Why the newest of some messages cannot be used at an age (s); empty when it can.
std::string Follower::why_late(double age, const char *noun, const char *topic) const {
    if (std::isinf(age)) return text_of("no %s yet on topic %s", noun, topic);
    if (age < -period) return text_of("the %s's stamps are %.3g s ahead of this clock", noun, -age);
    return age > parameters.longest_silence ? text_of("the newest %s is %.3g s old", noun, age) : std::string();
}

// Why the car is stopped after a step; empty when it is not.
std::string Follower::why_stopped() const {
    if (error_ != ADAPTRACK_OK) return text_of("adaptrack error %d", static_cast<int>(error_));
    if (answer_->status == ADAPTRACK_STATUS_HELD)
        return "no position for 3 s, no solution, or a steering of the other sign";
    if (answer_->status == ADAPTRACK_STATUS_REVERSE) return "the car rolls backwards";
    if (answer_->status == ADAPTRACK_STATUS_OFF_PATH || std::abs(answer_->offset) > parameters.furthest)
        return "the car is too far from the path";
    if (answer_->status == ADAPTRACK_STATUS_END) return "the car is beyond the end of the path";
#if ADAPTRACK_PLANNER
    if (answer_->driven_by == ADAPTRACK_DRIVEN_BY_STOP) return "the planner is silent";
#endif
    return halted_ ? "the path is empty" : "";
}

// m/s that a car that obeys has while it is stopped without being noticed.
double Follower::braking_speed(double now) {
    if (command_.stopping.empty() || now < braked_) braked_ = now;
    return std::max(0.0, speed_ - parameters.stop_deceleration * (now - braked_));
}

void Follower::command(double speed, double acceleration, double request, std::string stopping) {
    command_ = {angle_, speed, acceleration, std::move(stopping), (angle_ - command_.angle) / period, request};
}

void Follower::stop(std::string why) {
    command(0.0, parameters.stop_deceleration, -parameters.stop_deceleration, std::move(why));
}

// The speed that is planned where the car will be in one period, and 0 from a stop on until another path comes.
double Follower::target_speed(double station) {
    const Planned &planned = paths_[followed_];
    const double place = station + std::max(sample_speed_, 0.0) * period;
    if (!std::isfinite(place)) return 0.0;
    if (!(left_ - jump < station && station < next_ + jump)) {
        left_ = station;
        next_ = planned.stop_beyond(station - (stopping_ ? overshot : 0.0));
        if (next_ > station + overshot) stopping_ = false;
    }
    if (place >= next_ || (sample_speed_ < standing && station >= next_ - at_stop)) {
        stopping_ = true;
        return 0.0;
    }
    return planned.speed_at(std::max(place, left_ + std::min(at_stop, 0.5 * (next_ - left_))));
}

// m, of the first stop between the ends of the path that lies beyond a place; infinite without one.
double Follower::Planned::stop_beyond(double place) const {
    for (std::size_t k = 1; k + 1 < s.size(); k++)
        if (speed[k] == 0.0 && s[k] > place) return s[k];
    return std::numeric_limits<double>::infinity();
}

void Follower::go() {
#if ADAPTRACK_SPEED_CONTROL
    const double rate = std::max(std::abs(answer_->acceleration), least_acceleration);
    const bool stands = answer_->hold > 0.0 && answer_->target_speed <= 0.0;
    command(answer_->target_speed, answer_->hold > 0.0 ? parameters.acceleration : rate,
            stands ? -parameters.acceleration : answer_->acceleration, {});
#else
    double speed = parameters.follow == "path" ? target_speed(answer_->station) : 0.0;
#if ADAPTRACK_PLANNER
    if (std::isfinite(answer_->target_speed)) speed = answer_->target_speed;
#endif
    command(speed, parameters.acceleration, NAN, {});
#endif
}

const std::vector<Sample> &Follower::predicted_path() {
    std::array<double, 2 * ADAPTRACK_HORIZON> points{};
    std::size_t count = 0;
    double first = 0.0;
    predicted_.clear();
    if (!has_path_ || !command_.stopping.empty() ||
        adaptrack_predicted_path(tracker_.data(), points.data(), ADAPTRACK_HORIZON, &count, &first) != ADAPTRACK_OK ||
        count == 0)
        return predicted_;
    double yaw = direction(&points[0], &points[2 * count - 2]);
    for (std::size_t k = 0; k < count; k++) {
        const double *here = &points[2 * k], *there = &points[2 * std::min(k + 1, count - 1)];
        if (distance_of(here, there) > short_step) yaw = direction(here, there);
        predicted_.push_back({first + static_cast<double>(k) * period, here[0], here[1], yaw, NAN, NAN});
    }
    return predicted_;
}

std::string Follower::left_out() const {
    std::string all;
    for (const auto &[what, why] : {std::pair{"pose", &pose_trouble_}, {"motion", &motion_trouble_},
                                    {"path", &path_trouble_}, {"fallback", &fallback_trouble_}})
        if (!why->empty()) all += (all.empty() ? "" : "; ") + (what + (" left out: " + *why));
    return all;
}

Diagnosis Follower::diagnosis(double now) const {
    Diagnosis found{Diagnosis::ok, "following", {}};
    const auto number = [&](const char *format, double value) { return answer_ ? text_of(format, value) : std::string(); };
    found.values = {
        {"status", answer_ ? status_name(answer_->status) : ""},
        {"offset (m)", number("%.3f", answer_ ? answer_->offset : 0.0)},
        {"heading error (rad)", number("%.4f", answer_ ? answer_->heading_error : 0.0)},
        {"station (m)", number("%.1f", answer_ ? answer_->station : 0.0)},
        {"age of the pose (s)", text_of("%.3f", now - newest_)},
        {"steering angle (rad)", text_of("%.4f", command_.angle)},
        {"speed (m/s)", text_of("%.2f", command_.speed)},
        {"top speed until the car is learned (m/s)", number("%.1f", answer_ ? answer_->first_top_speed : 0.0)},
    };
#if ADAPTRACK_PLANNER
    if (parameters.follow == "trajectory") {
        const bool is_timed = answer_ && std::isfinite(answer_->late);
        found.values.emplace_back("late (s)", is_timed ? text_of("%.2f", answer_->late) : std::string());
        found.values.emplace_back("driven by", answer_ ? drivers.at(static_cast<std::size_t>(answer_->driven_by)) : "");
        found.values.emplace_back("verdict", verdict_ ? verdicts.at(static_cast<std::size_t>(*verdict_)) : "");
        found.values.emplace_back("age of the fallback (s)",
                                  std::isfinite(fallback_time_) ? text_of("%.3f", now - fallback_time_) : std::string());
    }
#endif
    std::vector<std::string> troubles;
    if (std::string text = left_out(); !text.empty()) troubles.push_back(std::move(text));
    if (answer_ && answer_->suspect != 0)
        troubles.push_back(text_of("inputs contradict each other: suspect = %lu",
                                   static_cast<unsigned long>(answer_->suspect)));
    if (!parameters.motion_message.empty() && std::isinf(newest_motion_) && command_.stopping.empty())
        troubles.push_back("no motion yet on topic motion");
    if (answer_ && speed_ > answer_->first_top_speed)
        troubles.push_back(text_of("drive below %.3g m/s until the car is learned", answer_->first_top_speed));
#if ADAPTRACK_PLANNER
    if (answer_ && answer_->driven_by == ADAPTRACK_DRIVEN_BY_FALLBACK)
        troubles.push_back("the planner is silent: the car follows the fallback");
#endif
    if (engaged_ && !command_.stopping.empty()) troubles.insert(troubles.begin(), "stopping: " + command_.stopping);
    std::string all;
    for (const std::string &each : troubles) all += (all.empty() ? "" : "; ") + each;
    if (!engaged_)
        found.text = "not engaged";
    else if (!all.empty())
        found.level = command_.stopping.empty() ? Diagnosis::warn : Diagnosis::error, found.text = all;
    return found;
}

} // namespace adaptrack_ros

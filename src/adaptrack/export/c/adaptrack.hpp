// adaptrack in C++17: a tracker and a path that own their memory and cannot be copied. No exceptions, no allocation.
#ifndef ADAPTRACK_HPP
#define ADAPTRACK_HPP
#include "adaptrack.h"

#include <array>
#include <cstddef>
#include <cstdint>
#include <limits>

namespace adaptrack {

using Error = adaptrack_error;
using Status = adaptrack_status;
using Answer = adaptrack_answer;
#if ADAPTRACK_SPEED_CONTROL
using Speeds = adaptrack_speeds;
using Flaw = adaptrack_flaw;
#else
using Plan = adaptrack_plan;
#endif
inline constexpr double unknown = std::numeric_limits<double>::quiet_NaN();
#if ADAPTRACK_PLANNER
using Trajectory = adaptrack_trajectory;
using Verdict = adaptrack_verdict;

// What is not given stays NaN.
struct Point : adaptrack_point {
    constexpr Point() noexcept : adaptrack_point{unknown, unknown, unknown, unknown, unknown, unknown, unknown} {}
};

// Memory for trajectories.
class Planner {
  public:
    Planner() noexcept = default;
    Planner(const Planner &) = delete;
    Planner &operator=(const Planner &) = delete;
    [[nodiscard]] void *data() noexcept { return memory_.data(); }

  private:
    alignas(ADAPTRACK_ALIGNMENT) std::array<std::uint64_t, ADAPTRACK_PLANNER_SIZE / 8> memory_{};
};
#endif

// What is not known stays NaN.
struct Sample : adaptrack_sample {
    constexpr Sample() noexcept : adaptrack_sample ADAPTRACK_UNKNOWN {}
};

// A path through points x, y, for as many words of 8 bytes; see adaptrack_path_size.
template <std::size_t Words>
class Path {
  public:
    Path() noexcept = default;
    Path(const Path &) = delete;
    Path &operator=(const Path &) = delete;
    // A tracker must not be following it.
    [[nodiscard]] Error through(const double *points, std::size_t count, bool closed = false,
                                std::size_t *flaw = nullptr, double noise = unknown) noexcept {
        return adaptrack_path(points, count, closed ? 1 : 0, noise, memory_.data(), 8 * Words, flaw);
    }
    [[nodiscard]] double length() const noexcept { return adaptrack_path_length(memory_.data()); }
    [[nodiscard]] double curvature(double s) const noexcept { return adaptrack_path_curvature(memory_.data(), s); }
    [[nodiscard]] const void *data() const noexcept { return memory_.data(); }

  private:
    alignas(ADAPTRACK_ALIGNMENT) std::array<std::uint64_t, Words> memory_{};
};

#if ADAPTRACK_SPEED_CONTROL
// A plan along a path, for as many words of 8 bytes; see adaptrack_speed_plan_size.
template <std::size_t Words>
class Plan {
  public:
    Plan() noexcept = default;
    Plan(const Plan &) = delete;
    Plan &operator=(const Plan &) = delete;
    // A tracker must not be following it.
    template <std::size_t PathWords>
    [[nodiscard]] Error along(const Path<PathWords> &path, const Speeds &speeds, Flaw *flaw = nullptr) noexcept {
        return adaptrack_speed_plan(path.data(), &speeds, memory_.data(), 8 * Words, flaw);
    }
    [[nodiscard]] const void *data() const noexcept { return memory_.data(); }

  private:
    alignas(ADAPTRACK_ALIGNMENT) std::array<std::uint64_t, Words> memory_{};
};
#endif

// A controller that follows a path, in so many bytes.
template <std::size_t Size = ADAPTRACK_SIZE>
class BasicTracker {
  public:
    BasicTracker() noexcept : BasicTracker(adaptrack_constants, ADAPTRACK_CONSTANTS_SIZE) {}
    BasicTracker(const void *constants, std::size_t size) noexcept
        : ready_(adaptrack_init(memory_.data(), Size, constants, size)) {}
    BasicTracker(const BasicTracker &) = delete;
    BasicTracker &operator=(const BasicTracker &) = delete;

    // Whether it was made; every other function says so as well.
    [[nodiscard]] Error ready() const noexcept { return ready_; }
    [[nodiscard]] Error load(const void *constants, std::size_t size) noexcept {
        return adaptrack_load(memory_.data(), constants, size);
    }
    [[nodiscard]] Error engage(double wheel_angle, double near = unknown) noexcept {
        return adaptrack_engage(memory_.data(), wheel_angle, near);
    }
    // Path and plan must outlive it, or the next call of this.
#if ADAPTRACK_SPEED_CONTROL
    template <std::size_t PathWords, std::size_t Words>
    [[nodiscard]] Error follow(const Path<PathWords> &path, const Plan<Words> &plan, double near = unknown) noexcept {
        return follow(path.data(), plan.data(), near);
    }
    [[nodiscard]] Error follow(const void *path, const void *plan, double near = unknown) noexcept {
        return adaptrack_follow_plan(memory_.data(), path, near, plan);
    }
#else
    template <std::size_t Words>
    [[nodiscard]] Error follow(const Path<Words> &path, const Plan *plan = nullptr, double near = unknown) noexcept {
        return adaptrack_follow(memory_.data(), path.data(), near, plan);
    }
    [[nodiscard]] Error follow(const void *path, const Plan *plan = nullptr, double near = unknown) noexcept {
        return adaptrack_follow(memory_.data(), path, near, plan);
    }
#endif
#if ADAPTRACK_PLANNER
    // It must outlive the tracker; see adaptrack_planner.
    [[nodiscard]] Error give(Planner &planner) noexcept {
        return adaptrack_planner(memory_.data(), planner.data(), ADAPTRACK_PLANNER_SIZE);
    }
    // Trajectory and fallback are copied.
    [[nodiscard]] Error follow(const Trajectory &trajectory, Verdict &verdict, const Trajectory *fallback = nullptr,
                               std::size_t *flaw = nullptr) noexcept {
        return adaptrack_follow_trajectory(memory_.data(), &trajectory, fallback, &verdict, flaw);
    }
#endif
    [[nodiscard]] Error step(const adaptrack_sample &sample, Answer &answer) noexcept {
        return adaptrack_step(memory_.data(), &sample, &answer);
    }
    // x and y (m), one behind the other, in memory for `room` points; see adaptrack_predicted_path.
    [[nodiscard]] Error predicted_path(double *points, std::size_t room, std::size_t &count, double &first) noexcept {
        return adaptrack_predicted_path(memory_.data(), points, room, &count, &first);
    }
    [[nodiscard]] std::size_t state_size() const noexcept { return adaptrack_state_size(memory_.data()); }
    [[nodiscard]] Error save(void *state, std::size_t size) noexcept {
        return adaptrack_save(memory_.data(), state, size);
    }
    [[nodiscard]] Error restore(const void *state, std::size_t size) noexcept {
        return adaptrack_restore(memory_.data(), state, size);
    }

  private:
    alignas(ADAPTRACK_ALIGNMENT) std::array<std::uint64_t, Size / 8> memory_{};
    Error ready_;
};
using Tracker = BasicTracker<>;

} // namespace adaptrack
#endif

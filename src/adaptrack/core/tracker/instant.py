"""A control instant of a call: what is measured there and the road ahead; then, of the answer, command and status."""

from __future__ import annotations

import math

from ..controllers.contract import wrapped
from ..estimators.kalman import SENSOR_COUNT
from ..input_check.call import check_call
from ..input_check.record import SAMPLE, memory_of
from ..kernel import inlined, local
from ..maths.exact import clip
from ..models.contract import MEASUREMENT
from ..roads.road import CLOSED, foot_near, point_at
from ..speed.plan import planned_speeds
from .pose import (
    PoseRow,
    carried,
    forward,
    has_position,
    hold,
    is_beyond,
    keep_pose,
    line,
    path_errors,
    pose_of,
    sampled_pose,
    time_of,
    write_tracked,
)
from .records import CONTROLLER_ANSWER, EXPECTED_SPEEDS, INSTANT, LONGEST_CARRY, LONGEST_GAP, REQUEST, STANDSTILL_SPEED
from .signals import (
    BEYOND_END,
    CAR_SLIDES,
    ESTIMATED,
    FOLLOWING,
    HELD,
    OFF_PATH,
    REVERSE,
    STANDS,
    TRACKED,
    TRACKER_SAMPLE,
)

_aligned = local(len(SAMPLE))
LATEST_POSE, LATEST_MOTION = 0.499, 0.999
"""Periods, by which a pose and a motion may be older than the last instant that a filter goes through anew."""
CARRIED = 0.25
"""Periods, by which what moves the car may be carried: by then it is another."""


@inlined
def begin_instant(tracker):
    """Go on to the next instant of a call: True and what the controller is given there; False when the call is over.

    Written are `measured`, `ahead`, `speeds` and, first of all to be done, `request`; at the end `tracked`. A
    controller that knows no sensors takes the first four of `measured`.
    """
    m = tracker.memory[0]
    if m.due == 0:
        _end(tracker, m)
        return False
    sampled = m.due == 1  # instants without a call are gone through on the estimate
    if m.first == 0:
        _advance(tracker, m, sampled)
    m.first = 0
    _measure(tracker, m, sampled)
    _expect_speeds(tracker, m)
    return True


@inlined
def _end(tracker, m):
    """The end of a call: what its inputs say of each other, and what it gives."""
    if m.rejection == 0:
        aligned = _aligned()
        _align(tracker.sample, aligned)
        tracker.tracked[TRACKED.suspect] = check_call(aligned, m.command, tracker.check)
        _judge(tracker, m)
    write_tracked(tracker, m)


@inlined
def _judge(tracker, m):
    """Let the status say that the car slides; take a command back while the car turns against it."""
    findings, move = memory_of(tracker.check.memory, 0), tracker.settings[0].move
    if findings.sliding > 0 and (m.status == FOLLOWING or m.status == ESTIMATED or m.status == REVERSE):
        m.status = CAR_SLIDES
    if findings.against_steering > 0 and m.answered > 0:  # steering on would drive it further away
        hold(tracker, m, m.command_before - clip(m.command_before, -move, move))
        m.status = HELD


@inlined
def _advance(tracker, m, sampled):
    """Where the car is at the next instant, by the latest sample and its motion since."""
    settings, centreline = tracker.settings[0], line(tracker)
    period, speed = settings.period, forward(m)
    m.instant += 1
    if sampled and math.isfinite(m.sample.yaw_rate):
        m.yaw_rate = m.sample.yaw_rate
    else:
        _, _, _, curvature = point_at(m.station, centreline)
        m.yaw_rate = speed * curvature
    pose = carried(pose_of(m), period, speed, m.yaw_rate)
    if sampled and has_position(m) and m.sample.t > m.newest:
        age = time_of(m, period) - m.sample.t
        if -period <= age <= settings.late * period + LONGEST_CARRY:
            pose = carried(sampled_pose(m), age, speed, m.yaw_rate)
    keep_pose(m, pose)
    station, offset, heading, _ = foot_near(pose.x, pose.y, m.station + speed * period, centreline)
    m.offset, m.heading_error, m.turned = offset, math.nan, 0.0
    if offset == offset:
        m.heading_error, m.turned = wrapped(pose.yaw - heading), heading - m.heading
        m.station, m.heading = station, heading


@inlined
def _measure(tracker, m, sampled):
    """Write what the controller is given (`MEASUREMENT`)."""
    settings, measured = tracker.settings[0], tracker.measured
    for i in range(SENSOR_COUNT):
        measured[i] = math.nan
    measured[MEASUREMENT.pose_age], measured[MEASUREMENT.motion_age], measured[MEASUREMENT.turned] = 0.0, 0.0, m.turned
    m.fresh = 1 if sampled and _take(tracker, m, measured) else 0
    if settings.filtered > 0:
        return
    drift = measured[MEASUREMENT.vy]
    for i in range(SENSOR_COUNT):
        measured[i] = math.nan
    if time_of(m, settings.period) - m.newest <= LONGEST_GAP:
        measured[MEASUREMENT.vy] = drift if math.isfinite(drift) else _steady_drift(m, settings)
        measured[MEASUREMENT.yaw_rate] = m.yaw_rate
        measured[MEASUREMENT.y], measured[MEASUREMENT.yaw] = m.offset, m.heading_error


@inlined
def _steady_drift(m, settings):
    """v_y (m/s) of a steady turn, (l_r - m l_f v^2/(2 C_r L)) r; 0 where the car is not known.

    R. Rajamani, *Vehicle Dynamics and Control*, 2nd ed., section 3.3: the slip of the rear axle.
    """
    speed = forward(m)
    return (settings.drift_arm - settings.drift_load * (speed * speed) / settings.drift_stiffness) * m.yaw_rate


@inlined
def _ages(t, most, m, period):
    """Return the age (s) of what was taken at a time (s), and the nearest age from -1/2 to `most` periods."""
    age = time_of(m, period) - t if math.isfinite(t) else 0.0
    return age, clip(age, -0.5 * period, most * period)


@inlined
def _align(sample, aligned):
    """Write the sample with its pose carried to the time of its motion: the inputs are compared at one time."""
    for i in range(SAMPLE.wheel_angle + 1):
        aligned[i] = sample[i]
    aligned[SAMPLE.longitudinal_acceleration] = sample[TRACKER_SAMPLE.longitudinal_acceleration]
    time = sample[TRACKER_SAMPLE.motion_time] - sample[TRACKER_SAMPLE.t]
    speed, yaw_rate = sample[TRACKER_SAMPLE.speed], sample[TRACKER_SAMPLE.yaw_rate]
    if time != 0.0 and abs(time) <= LONGEST_CARRY and math.isfinite(speed):
        pose = PoseRow(sample[TRACKER_SAMPLE.x], sample[TRACKER_SAMPLE.y], sample[TRACKER_SAMPLE.yaw])
        pose = carried(pose, time, speed, yaw_rate if math.isfinite(yaw_rate) else 0.0)
        aligned[SAMPLE.x], aligned[SAMPLE.y], aligned[SAMPLE.yaw] = pose.x, pose.y, pose.yaw
        aligned[SAMPLE.t] = sample[TRACKER_SAMPLE.motion_time]


@inlined
def _take(tracker, m, measured):
    """Write what the sample at hand says and how old it is; whether it has a position that can be used."""
    period, late = tracker.settings[0].period, tracker.settings[0].late
    age, declared = _ages(m.sample.t, late + LATEST_POSE, m, period)
    motion_age, declared_motion_age = _ages(m.sample.motion_time, late + LATEST_MOTION, m, period)
    carry = age - declared
    if max(age, motion_age) > (late + LATEST_MOTION + CARRIED) * period and has_position(m):
        tracker.request[REQUEST.late] = max(age, motion_age)
    if abs(motion_age - declared_motion_age) <= CARRIED * period:
        measured[MEASUREMENT.vy], measured[MEASUREMENT.yaw_rate] = m.sample.lateral_velocity, m.sample.yaw_rate
        measured[MEASUREMENT.wheel_angle] = m.sample.wheel_angle
        measured[MEASUREMENT.lateral_acceleration] = m.sample.lateral_acceleration
    measured[MEASUREMENT.pose_age], measured[MEASUREMENT.motion_age] = declared, declared_motion_age
    is_seen = m.sample.t <= m.newest and m.instant > 0
    if not (has_position(m) and -period <= carry <= LONGEST_CARRY) or (is_seen and late == 0):
        return False
    if m.instant > 0:
        m.newest = max(m.newest, m.sample.t)
    pose = carried(sampled_pose(m), carry, forward(m), m.yaw_rate)
    there = path_errors(tracker, pose, m.station - forward(m) * declared)
    measured[MEASUREMENT.y], measured[MEASUREMENT.yaw] = there.offset, there.heading_error
    return True


@inlined
def _expect_speeds(tracker, m):
    """Write the speeds that are expected at the next instants."""
    speed, speeds, ahead, plan = forward(m), tracker.speeds, tracker.ahead, tracker.plan
    ahead[INSTANT.speed], ahead[INSTANT.station], ahead[INSTANT.count] = speed, m.station, 1.0
    speeds[0] = speed
    if plan.s.size < 2:
        return
    step = max(speed, STANDSTILL_SPEED) * tracker.settings[0].period
    for i in range(EXPECTED_SPEEDS):
        speeds[i] = m.station + step * i
    lap = plan.s[plan.s.size - 1] if tracker.path.numbers[0, CLOSED] > 0.5 else 0.0
    planned_speeds(lap, plan.s, plan.speed, speeds)
    difference = speed - speeds[0]
    for i in range(EXPECTED_SPEEDS):
        speeds[i] = max(speeds[i] + difference, 0.0)
    ahead[INSTANT.count] = EXPECTED_SPEEDS


@inlined
def conclude_instant(tracker):
    """Take in the controller's answer (`tracker.answer`); a command that is no number holds the last one."""
    m, answer = tracker.memory[0], tracker.answer
    previous = m.command
    usable = math.isfinite(answer[CONTROLLER_ANSWER.command])
    m.command = answer[CONTROLLER_ANSWER.command] if usable else previous
    m.belief_state, m.belief_at_bound = (
        answer[CONTROLLER_ANSWER.belief_state],
        answer[CONTROLLER_ANSWER.belief_at_bound],
    )
    m.status, m.answered = _status(tracker, m, not usable or answer[CONTROLLER_ANSWER.held] > 0.5), 1
    m.due -= 1
    if m.due > 0:  # at an instant without a call nothing was sent
        hold(tracker, m, previous)


@inlined
def _status(tracker, m, is_held):
    """The status of an instant, one of `STATUS`."""
    if m.offset != m.offset:
        return OFF_PATH
    if is_held:
        return HELD
    if m.speed < STANDSTILL_SPEED:
        return STANDS
    if not abs(m.offset) <= tracker.settings[0].furthest:
        return OFF_PATH
    if is_beyond(tracker, m.station):
        return BEYOND_END
    return FOLLOWING if m.fresh > 0 else ESTIMATED

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
from . import pose, signals
from .records import EXPECTED_SPEEDS, LONGEST_CARRY, LONGEST_GAP, REQUEST, STANDSTILL_SPEED

_aligned = local(len(SAMPLE))
LATEST_POSE, LATEST_MOTION = 0.499, 0.999
"""Periods, by which a pose and a motion may be older than the last instant that a filter goes through anew."""
CARRIED = 0.25
"""Periods, by which what moves the car may be carried: by then it is another."""


@inlined
def begin_instant(tracker):
    """Go on to the next instant of a call: True and what the controller is given there; False when the call is over.

    It writes `measured` and `request`, which is to be done first; at the end `tracked`. A controller that knows no
    sensors takes the first four of `measured`.
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
    return True


@inlined
def _end(tracker, m):
    """The end of a call: what its inputs say of each other, and what it gives."""
    if m.rejection == 0:
        aligned = _aligned()
        _align(tracker.sample, aligned)
        tracker.tracked[signals.TRACKED.suspect] = check_call(aligned, m.command, tracker.check)
        _judge(tracker, m)
    pose.write_tracked(tracker, m)


@inlined
def _judge(tracker, m):
    """Let the status say that the car slides; take a command back while the car turns against it."""
    findings, move = memory_of(tracker.check.memory, 0), tracker.settings[0].move
    if findings.sliding > 0 and m.status in (signals.FOLLOWING, signals.ESTIMATED, signals.REVERSE):
        m.status = signals.CAR_SLIDES
    if findings.against_steering > 0 and m.answered > 0:  # steering on would drive it further away
        pose.hold(tracker, m, m.command_before - clip(m.command_before, -move, move))
        m.status = signals.HELD


@inlined
def _advance(tracker, m, sampled):
    """Where the car is at the next instant, by the latest sample and its motion since."""
    settings, centreline = tracker.settings[0], pose.line(tracker)
    period, speed = settings.period, pose.forward(m)
    m.instant += 1
    if sampled and math.isfinite(m.sample.yaw_rate):
        m.yaw_rate = m.sample.yaw_rate
    else:
        _, _, _, curvature = point_at(m.station, centreline)
        m.yaw_rate = speed * curvature
    m.x, m.y, m.yaw = pose.carried(m, period, speed, m.yaw_rate)
    if sampled and pose.has_position(m) and m.sample.t > m.newest:
        age = pose.time_of(m, period) - m.sample.t
        if -period <= age <= settings.late * period + LONGEST_CARRY:
            m.x, m.y, m.yaw = pose.carried(m.sample, age, speed, m.yaw_rate)
    station, offset, heading, _ = foot_near(m.x, m.y, m.station + speed * period, centreline)
    m.offset, m.heading_error, m.turned = offset, math.nan, 0.0
    if offset == offset:
        m.heading_error, m.turned = wrapped(m.yaw - heading), heading - m.heading
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
    if pose.time_of(m, settings.period) - m.newest <= LONGEST_GAP:
        measured[MEASUREMENT.vy] = drift if math.isfinite(drift) else _steady_drift(m, settings)
        measured[MEASUREMENT.yaw_rate] = m.yaw_rate
        measured[MEASUREMENT.y], measured[MEASUREMENT.yaw] = m.offset, m.heading_error


@inlined
def _steady_drift(m, settings):
    """v_y (m/s) of a steady turn, (l_r - m l_f v^2/(2 C_r L)) r; 0 where the car is not known.

    R. Rajamani, *Vehicle Dynamics and Control*, 2nd ed., section 3.3: the slip of the rear axle.
    """
    speed = pose.forward(m)
    return (settings.drift_arm - settings.drift_load * (speed * speed) / settings.drift_stiffness) * m.yaw_rate


@inlined
def _ages(t, most, m, period):
    """Return the age (s) of what was taken at a time (s), and the nearest age from -1/2 to `most` periods."""
    age = pose.time_of(m, period) - t if math.isfinite(t) else 0.0
    return age, clip(age, -0.5 * period, most * period)


@inlined
def _align(sample, aligned):
    """Write the sample with its pose carried to the time of its motion: the inputs are compared at one time."""
    for i in range(SAMPLE.wheel_angle + 1):
        aligned[i] = sample[i]
    call = signals.sample_of(sample, 0)
    aligned[SAMPLE.longitudinal_acceleration] = call.longitudinal_acceleration
    time, yaw_rate = call.motion_time - call.t, call.yaw_rate if math.isfinite(call.yaw_rate) else 0.0
    if time != 0.0 and abs(time) <= LONGEST_CARRY and math.isfinite(call.speed):
        aligned[SAMPLE.x], aligned[SAMPLE.y], aligned[SAMPLE.yaw] = pose.carried(call, time, call.speed, yaw_rate)
        aligned[SAMPLE.t] = call.motion_time


@inlined
def _take(tracker, m, measured):
    """Write what the sample at hand says and how old it is; whether it has a position that can be used."""
    period, late = tracker.settings[0].period, tracker.settings[0].late
    age, declared = _ages(m.sample.t, late + LATEST_POSE, m, period)
    motion_age, declared_motion_age = _ages(m.sample.motion_time, late + LATEST_MOTION, m, period)
    carry = age - declared
    if max(age, motion_age) > (late + LATEST_MOTION + CARRIED) * period and pose.has_position(m):
        tracker.request[REQUEST.late] = max(age, motion_age)
    if abs(motion_age - declared_motion_age) <= CARRIED * period:
        measured[MEASUREMENT.vy], measured[MEASUREMENT.yaw_rate] = m.sample.lateral_velocity, m.sample.yaw_rate
        measured[MEASUREMENT.wheel_angle] = m.sample.wheel_angle
        measured[MEASUREMENT.lateral_acceleration] = m.sample.lateral_acceleration
    measured[MEASUREMENT.pose_age], measured[MEASUREMENT.motion_age] = declared, declared_motion_age
    is_seen = m.sample.t <= m.newest and m.instant > 0
    if not (pose.has_position(m) and -period <= carry <= LONGEST_CARRY) or (is_seen and late == 0):
        return False
    if m.instant > 0:
        m.newest = max(m.newest, m.sample.t)
    x, y, yaw = pose.carried(m.sample, carry, pose.forward(m), m.yaw_rate)
    offset, heading_error = pose.path_errors(tracker, x, y, yaw, m.station - pose.forward(m) * declared)
    measured[MEASUREMENT.y], measured[MEASUREMENT.yaw] = offset, heading_error
    return True


@inlined
def expect_speeds(tracker, m):
    """Write the speeds (m/s) that are expected at the instants from now on; how many count: the last one holds."""
    speed, speeds, plan = pose.forward(m), tracker.speeds, tracker.plan
    speeds[0] = speed
    if plan.s.size < 2:
        return 1
    step = max(speed, STANDSTILL_SPEED) * tracker.settings[0].period
    for i in range(EXPECTED_SPEEDS):
        speeds[i] = m.station + step * i
    lap = plan.s[plan.s.size - 1] if tracker.path.numbers[0, CLOSED] > 0.5 else 0.0
    planned_speeds(lap, plan.s, plan.speed, speeds)
    difference = speed - speeds[0]
    for i in range(EXPECTED_SPEEDS):
        speeds[i] = max(speeds[i] + difference, 0.0)
    return EXPECTED_SPEEDS


@inlined
def conclude_instant(tracker, command, is_held):
    """Take in the controller's command (rad); one that is no number holds the last one. is_held: it is no new one."""
    m = tracker.memory[0]
    previous, usable = m.command, math.isfinite(command)
    m.command = command if usable else previous
    m.status, m.answered = _status(tracker, m, not usable or is_held), 1
    m.due -= 1
    if m.due > 0:  # at an instant without a call nothing was sent
        pose.hold(tracker, m, previous)


@inlined
def _status(tracker, m, is_held):
    """The status of an instant, one of `STATUS`."""
    if m.offset != m.offset:
        return signals.OFF_PATH
    if is_held:
        return signals.HELD
    if m.speed < STANDSTILL_SPEED:
        return signals.STANDS
    if not abs(m.offset) <= tracker.settings[0].furthest:
        return signals.OFF_PATH
    if pose.is_beyond(tracker, m.station):
        return signals.BEYOND_END
    return signals.FOLLOWING if m.fresh > 0 else signals.ESTIMATED

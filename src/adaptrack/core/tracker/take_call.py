"""A call: what it says, which control instants it goes through, and whether the tracker begins with it; another path
under way.
"""

from __future__ import annotations

import math

from ..controllers.contract import wrapped
from ..input_check.call import begin_check
from ..kernel import Place, copier, exported, float64, inlined, int64, local, void
from ..maths.bits import whole
from ..maths.exact import floor
from ..maths.exponential import hypot
from ..maths.trigonometric import cos, sin
from ..planned.clock import forget_planner
from . import pose, records, signals
from .records import LONGEST_GAP, REQUEST, STANDSTILL_SPEED, TrackerRecord
from .signals import TRACKER_SAMPLE

_used, _copy_sample = local(len(TRACKER_SAMPLE)), copier(signals.TrackerSample)


@exported(int64(float64, float64, Place(TrackerRecord)))
def tracker_engage(angle, near, tracker):
    """Begin anew, from the angle (rad) that the wheels have: the first command is near it. 1, or 0 if it is no number.

    near: m, the car's foot is looked for within 400 m of this arc length; NaN: on the whole path. After an angle that
    is no number the tracker is as it was.
    """
    if not math.isfinite(angle):
        return 0
    m = tracker.memory[0]
    pose.begin_anew(tracker, m, angle)
    pose.hint(m, near)
    m.answered, m.rejection = 0, 0
    tracker.request[REQUEST.late], tracker.tracked[signals.TRACKED.suspect] = math.nan, 0.0
    begin_check(tracker.check)
    if tracker.planned.memory.size > 0:
        forget_planner(tracker.planned.memory[0])
    pose.write_tracked(tracker, m)
    return 1


@exported(void(Place(TrackerRecord)))
def tracker_take(tracker):
    """Take in the call in `tracker.sample`, see TRACKER_SAMPLE."""
    m, sample, call = tracker.memory[0], tracker.sample, signals.sample_of(tracker.sample, 0)
    m.due, m.first, m.answered = 0, 0, 0
    tracker.request[REQUEST.late] = math.nan
    _leave_out_absurd(sample)
    if tracker.settings[0].sample_arm != 0.0:
        _move_to_centre_of_mass(tracker.settings[0].sample_arm, call)
    at = call.now if math.isfinite(call.now) else call.t
    m.rejection = _rejection(m, at)
    if m.rejection > 0:
        return
    call.now = at
    if not math.isfinite(call.motion_time):
        call.motion_time = call.t
    _keep(m, sample, at)
    if math.isfinite(call.speed):
        m.speed = call.speed
    if m.started > 0 and (m.speed < -STANDSTILL_SPEED or abs(at - m.last) > LONGEST_GAP):
        pose.restart(tracker, m)
    m.command_before = m.command
    if m.started > 0:
        _advance_to(tracker, m, at)
    else:
        _begin(tracker, m, at)


@inlined
def _leave_out_absurd(sample):
    """Let signals that no car can have be missing."""
    for i in range(len(TRACKER_SAMPLE)):
        if abs(sample[i]) >= signals.SAMPLE_LIMITS[i]:
            sample[i] = math.nan


@inlined
def _move_to_centre_of_mass(arm, call):
    """Replace the position (m) of a point that lies so far (m) ahead of the centre of mass by that of the latter."""
    call.x, call.y = call.x - arm * cos(call.yaw), call.y - arm * sin(call.yaw)


@inlined
def _rejection(m, at):
    """Why a call at a time (s) is left out; 0: it is not."""
    if not math.isfinite(at):
        return signals.NO_TIME
    if m.started > 0 and m.last - LONGEST_GAP <= at <= m.last:
        return signals.REPEATED
    return 0


@inlined
def _keep(m, sample, at):
    """Keep the sample of a call at a time (s) without the pose or the motion that is older than `LONGEST_GAP`."""
    used, pose_is_old = _used(), abs(at - sample[TRACKER_SAMPLE.t]) > LONGEST_GAP
    motion_is_old = abs(at - sample[TRACKER_SAMPLE.motion_time]) > LONGEST_GAP
    for i in range(len(TRACKER_SAMPLE)):
        is_of_pose = i == TRACKER_SAMPLE.t or TRACKER_SAMPLE.x <= i <= TRACKER_SAMPLE.yaw
        used[i] = math.nan if (pose_is_old if is_of_pose else motion_is_old) else sample[i]
    _copy_sample(signals.sample_of(used, 0), m.sample)


@inlined
def _begin(tracker, m, at):
    """The first call, or one that is still no beginning."""
    period = tracker.settings[0].period
    if math.isfinite(m.sample.wheel_angle):
        pose.hold(tracker, m, m.sample.wheel_angle)
    age = at - m.sample.t
    backwards = m.speed < -STANDSTILL_SPEED
    is_usable = pose.has_position(m) and math.isfinite(m.speed) and -period <= age <= records.LONGEST_CARRY
    if backwards or not is_usable or not pose.has_path(tracker):
        m.status, m.answered = signals.REVERSE if backwards else signals.HELD, 1
        m.belief_state, m.belief_at_bound = signals.NO_BELIEF, signals.NO_BELIEF
        m.offset = m.heading_error = math.nan
        return
    m.began = m.last = at
    m.instant, m.started, m.newest = 0, 1, m.sample.t
    m.placed_x, m.placed_y, m.placed_yaw, m.placed_t = m.sample.x, m.sample.y, m.sample.yaw, m.sample.t
    m.yaw_rate = m.sample.yaw_rate if math.isfinite(m.sample.yaw_rate) else 0.0
    m.x, m.y, m.yaw = pose.carried(m.sample, age, pose.forward(m), m.yaw_rate)
    pose.find_on_path(tracker, m)
    m.sample.t, m.sample.x, m.sample.y, m.sample.yaw = at, m.x, m.y, m.yaw
    m.due = m.first = 1


@inlined
def _advance_to(tracker, m, at):
    """Count the control instants up to a call that follows others."""
    period = tracker.settings[0].period
    _leave_out_if_placed_before(m)
    m.between += records.SHARE_OF_LAST * (min(at - m.last, period) - m.between)
    m.last = at
    instant = whole(floor((at - m.began + 0.5 * m.between) / period))
    if instant <= m.instant:  # another call is nearer to the next instant
        return
    if pose.has_position(m):
        m.jumps = m.jumps + 1 if _has_jumped(m, at, period) else 0
        if m.jumps == records.JUMPS:
            pose.restart(tracker, m)
            _begin(tracker, m, at)
            return
        if m.jumps > 0:
            m.sample.x = m.sample.y = m.sample.yaw = math.nan
    m.due = instant - m.instant


@inlined
def _leave_out_if_placed_before(m):
    """Leave out a pose that is the one before under a later time stamp: a car that moves has another."""
    is_repeated = m.sample.x == m.placed_x and m.sample.y == m.placed_y and m.sample.yaw == m.placed_yaw
    if is_repeated and m.sample.t > m.placed_t and pose.forward(m) > STANDSTILL_SPEED:
        m.sample.x = m.sample.y = m.sample.yaw = math.nan
    elif pose.has_position(m):
        m.placed_x, m.placed_y, m.placed_yaw, m.placed_t = m.sample.x, m.sample.y, m.sample.yaw, m.sample.t


@inlined
def _has_jumped(m, at, period):
    """Whether a position is far from where the car was expected."""
    since, speed = at - pose.time_of(m, period), pose.forward(m)
    expected_x, expected_y, _ = pose.carried(m, since, speed, m.yaw_rate)
    x, y, _ = pose.carried(m.sample, at - m.sample.t, speed, m.yaw_rate)
    return hypot(x - expected_x, y - expected_y) > records.LARGEST_JUMP + 0.5 * speed * abs(since)


@exported(void(float64, Place(TrackerRecord)))
def tracker_follow(near, tracker):
    """Go over to the path, and the plan, that `tracker` has now in place of another; what is learned of the car stays.

    near: m, the car's foot is looked for within 400 m of this arc length; NaN: on the whole path. The path had better
    begin behind the car, by the age of the oldest samples at least.
    """
    m = tracker.memory[0]
    pose.hint(m, near)
    m.due, m.predicted = 0, 0
    if m.started == 0:
        return
    if pose.has_path(tracker):
        _go_over(tracker, m)
    else:
        pose.restart(tracker, m)


@inlined
def _go_over(tracker, m):
    """Find the car on the path, and say by how much that moves it against the one before."""
    offset, heading_error = m.offset, m.heading_error
    pose.find_on_path(tracker, m)
    request, shifted = tracker.request, m.offset - offset
    if abs(shifted) < signals.MAX_SIGNAL:
        pending = request[REQUEST.change]  # 1: the controller has not heard yet of the path before
        request[REQUEST.turned] = wrapped(m.heading_error - heading_error) + pending * request[REQUEST.turned]
        request[REQUEST.shifted] = shifted + pending * request[REQUEST.shifted]
        request[REQUEST.change] = 1.0
    else:  # too far from one of them to say by how much
        pose.restart(tracker, m)

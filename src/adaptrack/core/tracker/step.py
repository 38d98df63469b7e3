"""A tracker around a compiled controller, and a speed control behind it: whole calls.

At a control instant of a call it writes what is measured and the road ahead; then it takes in the controller's answer.
"""

from __future__ import annotations

import math

from ..controllers.contract import wrapped
from ..controllers.part import COMMON_ANSWER, ControllerPart, apply_requests, control
from ..controllers.receding import predict_path
from ..estimators.kalman import SENSOR_COUNT
from ..estimators.learning import Beliefs
from ..input_check.call import check_call
from ..input_check.record import SAMPLE, memory_of
from ..kernel import Caller, Place, exported, float64, inlined, int64, local, record, several, vector, viewer, void
from ..loop import period_of
from ..maths.exact import clip
from ..models.contract import MEASUREMENT
from ..planned.timing import keep_time
from ..roads.road import CLOSED, foot_near, point_at
from ..scheduling.functions import VARIABLE_COLUMNS
from ..speed.plan import planned_speeds
from . import pose, signals
from .longitudinal import Longitudinal
from .records import EXPECTED_SPEEDS, LONGEST_CARRY, LONGEST_GAP, REQUEST, STANDSTILL_SPEED, TrackerRecord
from .take_call import tracker_take

LATEST_POSE, LATEST_MOTION = 0.499, 0.999
"""Periods, by which a pose and a motion may be older than the last instant that a filter goes through anew."""
ASIDE_TIME = 1.0
"""s, in which the reference comes to the path from beside it."""
CARRIED = 0.25
"""Periods, by which what moves the car may be carried: by then it is another."""

Tracking = record(
    "Tracking",
    (
        ("tracker", TrackerRecord),
        ("controller", ControllerPart),
        ("narrow_friction", int64),  # address of `longitudinal.narrow_tracked_friction`; 0: the friction stays
        ("control_speed", int64),  # address of `longitudinal.longitudinal_step`; 0: there is no speed control
        ("longitudinal", Longitudinal),  # empty without a speed control
    ),
)
"""A tracker with its controller, and with a speed control where it has one."""
_narrow_friction = Caller(void(Place(TrackerRecord), vector, Place(Longitudinal)))
_control_speed = Caller(void(Place(TrackerRecord), Place(Longitudinal)))
_reference, _aligned, _beliefs_at = local(1), local(len(SAMPLE)), viewer(Beliefs)


# -- arrive -----------------------------------------------------------------------------------------------------------
@inlined
def _arrive(slot, tracking):
    """Go on to the next instant of a call: True and what the controller is given there; False when the call is over.

    It writes `measured` and `request`, which is to be done first; at the end `tracked`. A controller that knows no
    sensors takes the first four of `measured`.
    """
    tracker, m = tracking.tracker, tracking.tracker.memory[0]
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
    m.aside -= m.aside * min(period / ASIDE_TIME, 1.0)
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
    friction = signals.sample_of(tracker.sample, 0).friction
    measured[MEASUREMENT.friction] = friction if friction > 0.0 else 0.0
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


# -- prepare and control ----------------------------------------------------------------------------------------------
@inlined
def _apply_requests(slot, tracking):
    apply_requests(slot, tracking.tracker.request, tracking.controller)


@inlined
def _prepare(slot, tracking):
    """Do what is asked of the controller, and narrow the friction."""
    _apply_requests(slot, tracking)
    if tracking.narrow_friction != 0:
        learned = tracking.controller.mpc.informed.learned[slot]
        _narrow_friction(tracking.narrow_friction, tracking.tracker, learned, tracking.longitudinal)
    return True


@inlined
def _expect_speeds(tracker, m):
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
def _write_variables(tracker):
    """Write what a schedule goes by; friction that is not known is the nominal one, such wind none."""
    sample, variables, m = signals.sample_of(tracker.sample, 0), tracker.variables, tracker.memory[0]
    nominal = tracker.settings[0].nominal_friction
    variables[VARIABLE_COLUMNS.speed], variables[VARIABLE_COLUMNS.y_ref] = pose.forward(m), 0.0
    variables[VARIABLE_COLUMNS.friction] = sample.friction if math.isfinite(sample.friction) else nominal
    variables[VARIABLE_COLUMNS.wind] = sample.wind if math.isfinite(sample.wind) else 0.0
    variables[VARIABLE_COLUMNS.change] = variables[VARIABLE_COLUMNS.acceleration] = 0.0
    variables[VARIABLE_COLUMNS.offset] = -m.offset


@inlined
def _control(slot, tracking):
    """The controller's step."""
    tracker, m, reference = tracking.tracker, tracking.tracker.memory[0], _reference()
    reference[0] = m.aside
    _write_variables(tracker)
    control(
        slot, tracker.variables, pose.forward(m), m.command, m.station, 0, tracker.measured, reference,
        tracker.speeds[: _expect_speeds(tracker, m)], tracker.path, tracking.controller,
    )  # fmt: skip


# -- depart -----------------------------------------------------------------------------------------------------------
@inlined
def _depart(slot, tracking):
    """Take in command, status and beliefs: the caller has them at the end of the call.

    A command that is no number holds the last one.
    """
    tracker, m, answer = tracking.tracker, tracking.tracker.memory[0], tracking.controller.answer[slot]
    previous, command = m.command, answer[COMMON_ANSWER.command]
    usable, beliefs = math.isfinite(command), tracking.controller.beliefs
    m.command = command if usable else previous
    m.belief_state, m.belief_at_bound, m.delay_sigma = signals.NO_BELIEF, signals.NO_BELIEF, 0.0
    if beliefs > 0:
        learned = _beliefs_at(answer, beliefs)
        m.belief_state, m.belief_at_bound = learned.belief_state, learned.belief_at_bound
        m.delay_sigma = learned.belief_delay_sigma
    m.status, m.answered = _status(tracker, m, not usable or answer[COMMON_ANSWER.held] > 0.5), 1
    m.predicted = 1
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


@inlined
def _keep_time(tracker):
    """Write lateness and target speed of a planned trajectory, and who drives; nothing without a planner."""
    planned, m, tracked = tracker.planned, tracker.memory[0], tracker.tracked
    if planned.memory.size == 0:
        tracked[signals.TRACKED.late] = math.nan
        return
    time = pose.time_of(m, tracker.settings[0].period)
    keep_time(time, tracked[signals.TRACKED.station], pose.forward(m), planned)
    tracked[signals.TRACKED.late] = planned.memory[0].late
    tracked[signals.TRACKED.driven_by] = planned.memory[0].driven_by


# -- whole calls ------------------------------------------------------------------------------------------------------
_drive_period = period_of(_arrive, _prepare, _control, _depart)


@exported(void(Place(Tracking)))
def tracker_step(tracking):
    """A call: the sample in `tracker.sample`, the answer in `tracker.tracked` and `longitudinal.memory`.

    It goes through all control instants since the last one; the speed control acts at the end.
    """
    tracker_take(tracking.tracker)
    while _drive_period(0, tracking):
        pass
    _apply_requests(0, tracking)
    _keep_time(tracking.tracker)
    if tracking.control_speed != 0:
        _control_speed(tracking.control_speed, tracking.tracker, tracking.longitudinal)


@exported(several(int64, float64)(Place(Tracking), vector))
def tracker_predict(tracking, points):
    """Write x and y (m), in turn, of where an MPC expects the car, as of the last control instant; see `predict_path`.

    It returns the number of points, and the time (s) from that instant to the first one. The number is 0 for other
    controllers, and before the first control instant on this path.
    """
    tracker, controller, m = tracking.tracker, tracking.controller, tracking.tracker.memory[0]
    if controller.plans == 0 or m.predicted == 0:
        return 0, math.nan
    speeds = tracker.speeds[: EXPECTED_SPEEDS if tracker.plan.s.size > 1 else 1]
    return predict_path(0, m.station, speeds, 0, tracker.path, controller.mpc, points)


@exported(void(Place(Tracking)))
def tracker_apply(tracking):
    """Do at once what a tracker asks of its controller; else its next call does it."""
    _apply_requests(0, tracking)

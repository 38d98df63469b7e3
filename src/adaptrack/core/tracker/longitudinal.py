"""Speed control behind a tracker: who brakes and when, by the status of the tracker, once a control instant."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..input_check.hypotheses import MISTAKES
from ..input_check.record import memory_of, report
from ..kernel import Place, exported, fields_of, inlined, packer, record, rows, vector, void
from ..layout import empty
from ..maths.bits import whole
from ..maths.exact import clip, square
from ..models.contract import MEASUREMENT
from ..planned.records import FALLBACK, PLANNER, STOP
from ..roads.road import foot_near, point_at
from ..speed import speed_control as control
from ..speed.friction import FrictionEstimate, begin_friction, narrow_friction
from ..speed.learning import SpeedBanks, begin_bank
from ..speed.path import MAX_PLAN_SPEED
from ..speed.speed_control import BLIND_GRACE, SPEED_REQUEST
from .pose import forward, has_position, line, time_of
from .records import TrackerRecord
from .signals import MAX_SIGNAL, TRACKED, sample_of

Longitudinal = record(
    "Longitudinal",
    (
        ("sample", rows(control.SPEED_SAMPLE)), ("memory", rows(control.SPEED_MEMORY)),
        ("settings", control.SpeedSettings), ("path", control.SpeedPath), ("banks", SpeedBanks), ("ahead", vector),
        ("friction", FrictionEstimate),
    ),
)  # fmt: skip
"""A speed control: sample and memory (1,), settings, plan, banks, the governed squares ahead (m^2/s^2), and the
estimate of the friction."""

_write_memory = packer(record("Requests", fields_of(SPEED_REQUEST)[: SPEED_REQUEST.friction_low]))


def no_speed_control() -> Any:
    """An empty `Longitudinal`."""
    return empty(Longitudinal)


FOLLOW, FOLLOW_SLOWLY, COMFORT_STOP, EMERGENCY_STOP, NO_ACTION = range(5)
"""Actions: follow the plan; follow it, but stand before the steering loses its estimate; stop with the deceleration of
comfort; stop with the largest deceleration that friction allows; keep the requests in force while the time is no newer,
but not for long."""
STATUS_ACTIONS = np.array(
    [
        (FOLLOW, FOLLOW_SLOWLY),  # ok
        (FOLLOW, FOLLOW_SLOWLY),  # estimated
        (COMFORT_STOP, EMERGENCY_STOP),  # held
        (FOLLOW, COMFORT_STOP),  # standing
        (COMFORT_STOP, COMFORT_STOP),  # reverse
        (COMFORT_STOP, COMFORT_STOP),  # off_path
        (FOLLOW, FOLLOW_SLOWLY),  # end
        (FOLLOW, FOLLOW_SLOWLY),  # sliding
        (NO_ACTION, NO_ACTION),  # repeated
        (NO_ACTION, NO_ACTION),  # no_time
    ]
)
"""By `core.tracker.records.STATUS`: the action with a position of the last `BLIND_GRACE` seconds, and without one."""
SHORTEST_PERIOD_SHARE = 0.9
"""Control periods between two steps of the speed control while there are no control instants."""
MAX_PERIODS = 40
"""Control periods between two steps, at most: after so many the filters restart."""
MAX_POSITION_AGE, EARLY_PERIODS = 0.5, 2.0
"""s, -: age up to which a position is carried; control periods by which a stamp may be too late."""
CALL_SMOOTHING = 0.2
"""Share of a new time between two calls in the usual one."""
SUSPECT_SCALE, KNOWN_SCALE_SIGMA = 0.05, 0.012
"""-: error of the scale of the speed from which it is reported; standard deviation from which it is known."""


@inlined
def _is_due(time, m, memory, period):
    """Whether the speed control steps in a call at a time (s): at control instants.

    Without a position since the beginning there are none, but calls of a period or more apart.
    """
    if m.started > 0:
        return m.answered > 0
    return abs(time - memory.time) >= SHORTEST_PERIOD_SHARE * period


@inlined
def _count_periods(time, m, memory, period):
    """Control periods since the last step of the speed control; place and speed restart where the instants did."""
    if m.started == 0:
        periods = whole(clip((time - memory.time) / period + 0.5, 1.0, MAX_PERIODS))
    else:
        periods = min(m.instant - memory.instant, MAX_PERIODS)
        if m.began != memory.began or m.instant < memory.instant:
            memory.is_changed, memory.is_placed, memory.pose_time, memory.speed_age = 1, 0, -math.inf, math.inf
            elapsed = (time - memory.time) / period  # behind a jump of the clock not to be believed
            periods = whole(elapsed + 0.5) if 1.0 <= elapsed <= MAX_PERIODS else 1
    memory.time, memory.began, memory.instant = time, m.began, m.instant
    return max(periods, 1)


@inlined
def _point_of(place, centreline):
    """Point (m, m) of a place (m) on a path; NaN without a place."""
    if not math.isfinite(place):
        return math.nan, math.nan
    x, y, _, _ = point_at(place, centreline)
    return x, y


@inlined
def _place_of(x, y, near, centreline):
    """Place (m) on a path that is next to a point (m, m) about an arc length (m); NaN without one."""
    if not math.isfinite(x):
        return math.nan
    station, offset, _, _ = foot_near(x, y, near, centreline)
    return station if offset == offset else math.nan


@inlined
def _change_places(station, centreline, memory):
    """Find the places of the car and of its stops on a path that has changed; station: m, of the car on it."""
    place = _place_of(memory.place_x, memory.place_y, station, centreline) if memory.is_placed > 0 else math.nan
    if place == place:
        shift, memory.station = place - memory.station, place
        memory.observed_place, memory.start_place = memory.observed_place + shift, memory.start_place + shift
        memory.pose_place += shift
    else:
        memory.is_placed = 0
    memory.stop_place = _place_of(memory.stop_x, memory.stop_y, station, centreline)
    memory.served_place = _place_of(memory.served_x, memory.served_y, station, centreline)


@inlined
def _note_places(centreline, memory):
    """Keep where the places of the car and of its stops are in the plane."""
    memory.place_x, memory.place_y = _point_of(memory.station, centreline)
    memory.stop_x, memory.stop_y = _point_of(memory.stop_place, centreline)
    memory.served_x, memory.served_y = _point_of(memory.served_place, centreline)


@inlined
def _write_sample(tracker, m, blind_time, action, sample, memory):
    """Write the sample of the speed control after a call of the tracker; blind_time: s, since the last position.

    Positions and speeds are those that the tracker lets pass; each counts once, at its age.
    """
    period, call = tracker.settings[0].period, sample_of(tracker.sample, 0)
    instant_time = time_of(m, period) if m.started > 0 else call.now
    is_blind = action in (FOLLOW_SLOWLY, EMERGENCY_STOP)
    sample.is_guided = 1.0 if action in (FOLLOW, FOLLOW_SLOWLY) else 0.0
    sample.blind_time = blind_time if is_blind else 0.0
    sample.station, sample.station_age = math.nan, 0.0
    sample.offset = m.offset if abs(m.offset) < MAX_SIGNAL else 0.0
    if m.started > 0 and has_position(m) and m.sample.t > memory.pose_time and m.offset == m.offset:
        memory.pose_time = m.sample.t
        age = clip(instant_time - m.sample.t, 0.0, MAX_POSITION_AGE)
        sample.station, sample.station_age = m.station - age * forward(m), age
    sample.speed = call.speed if abs(call.speed) <= MAX_PLAN_SPEED else math.nan
    age = instant_time - call.motion_time
    sample.speed_age = max(age, 0.0) if age > -EARLY_PERIODS * period else math.inf
    sample.yaw_rate, sample.acceleration = call.yaw_rate, call.longitudinal_acceleration
    sample.driver, sample.grade = 1.0 if call.driver > 0.5 else 0.0, call.grade


@inlined
def _keep_planned_time(planned, sample, memory):
    """Let the speed control keep the times of a planner's trajectory, and leave a place of rest by the time.

    A car that has neither a planner nor a fallback stops.
    """
    if planned.memory.size == 0:
        return
    planner_memory = planned.memory[0]
    sample.is_timed, sample.correction, sample.correction_limit = 0.0, 0.0, planner_memory.top_speed
    sample.rest_time = 0.0
    if planner_memory.driven_by == PLANNER or planner_memory.driven_by == FALLBACK:
        sample.is_timed, sample.correction = 1.0, planner_memory.correction
        sample.rest_time = planner_memory.rest_time
        memory.is_released = max(memory.is_released, planner_memory.is_leaving)
    elif planner_memory.driven_by == STOP:
        sample.is_guided = 0.0


@inlined
def write_requests(longitudinal, row, first):
    """Write SPEED_REQUEST to a row from a place on."""
    _write_memory(row, first, longitudinal.memory[0])
    friction = longitudinal.friction.memory[0]
    row[first + SPEED_REQUEST.friction_low], row[first + SPEED_REQUEST.friction_high] = friction.low, friction.high
    row[first + SPEED_REQUEST.friction_age] = friction.age


@inlined
def _report(check, memory):
    """Report a place that has jumped, and a scale of the speed that is far off."""
    inputs = memory_of(check.memory, 0)
    if memory.jump > 0.0:
        report(inputs, MISTAKES.position_drifts, memory.jump, 0.0, 0.0)
    if abs(memory.scale) > SUSPECT_SCALE and memory.p_scale < square(KNOWN_SCALE_SIGMA):
        report(inputs, MISTAKES.speed_unit, 1.0 + memory.scale, 0.0, 0.0)


@inlined
def _has_newer_time(time, is_newer, period, memory):
    """Whether a call has a newer time (s); keep the usual time between two calls, whatever their times."""
    if not is_newer:
        memory.repeats += 1
        return False
    interval = clip((time - memory.call_time) / (memory.repeats + 1), 0.0, period)
    if memory.call_interval > 0.0:
        interval = memory.call_interval + CALL_SMOOTHING * (interval - memory.call_interval)
    memory.call_time, memory.call_interval, memory.repeats = time, interval, 0
    return True


@inlined
def _stop_without_clock(longitudinal):
    """Stop in calls whose time sticks: once in as many of them as usually make a control period."""
    sample, memory, period = longitudinal.sample[0], longitudinal.memory[0], longitudinal.settings.period
    sticks = memory.repeats * memory.call_interval
    if sticks <= BLIND_GRACE or whole(sticks / period) == whole((sticks - memory.call_interval) / period):
        return
    sample.station = sample.speed = sample.yaw_rate = sample.acceleration = sample.grade = math.nan
    sample.is_guided, sample.periods, sample.blind_time = 0.0, 1.0, sticks
    speed_control_step(longitudinal)


@exported(void(Place(Longitudinal)))
def longitudinal_begin(longitudinal):
    """Begin without a place and a speed, and forget what was learned of drive, brakes and friction."""
    settings, banks, memory = longitudinal.settings, longitudinal.banks, longitudinal.memory[0]
    memory.speed_age, memory.direction, memory.time, memory.pose_time = math.inf, 1.0, -math.inf, -math.inf
    memory.stop_place = memory.served_place = memory.stop_x = memory.served_x = math.nan
    begin_bank(settings.drive_lag, settings.drive_dead_time, banks.drive)
    begin_bank(settings.brake_lag, settings.brake_dead_time, banks.brakes)
    banks.requests[:] = 0.0
    begin_friction(longitudinal.friction)


@exported(void(Place(Longitudinal)))
def speed_control_step(longitudinal):
    """One control period, see `speed_control`."""
    sample, memory, settings = longitudinal.sample[0], longitudinal.memory[0], longitudinal.settings
    control.speed_control(sample, settings, longitudinal.path, memory, longitudinal.banks, longitudinal.ahead)


@exported(void(Place(TrackerRecord), vector, Place(Longitudinal)))
def narrow_tracked_friction(tracker, learned, longitudinal):
    """Narrow the friction at a control instant of a tracker, before its controller steps.

    learned: memory of its learner, empty without one. At the first instant the filters begin again.
    """
    m = tracker.memory[0]
    if m.instant == 0:
        longitudinal.friction.memory[0].running = 0.0
    narrow_friction(tracker.measured, forward(m), m.command, learned, longitudinal)
    tracker.measured[MEASUREMENT.friction] = longitudinal.friction.memory[0].least


@exported(void(Place(TrackerRecord), Place(Longitudinal)))
def longitudinal_step(tracker, longitudinal):
    """Run the speed control after a call of the tracker, once a control instant.

    The requests are in `longitudinal.memory`, see `core.speed.speed_control.SPEED_MEMORY`. The speed is limited to the
    tracker's first top speed.
    """
    m, sample, memory = tracker.memory[0], longitudinal.sample[0], longitudinal.memory[0]
    time = sample_of(tracker.sample, 0).now
    blind_time = time - m.newest
    action = STATUS_ACTIONS[whole(tracker.tracked[TRACKED.status]), 0 if blind_time <= BLIND_GRACE else 1]
    if not _has_newer_time(time, action != NO_ACTION, longitudinal.settings.period, memory):
        _stop_without_clock(longitudinal)
        return
    if not _is_due(time, m, memory, longitudinal.settings.period):
        return
    sample.periods = float(_count_periods(time, m, memory, longitudinal.settings.period))
    sample.top_speed = tracker.tracked[TRACKED.first_top_speed]
    _write_sample(tracker, m, blind_time, action, sample, memory)
    _keep_planned_time(tracker.planned, sample, memory)
    if memory.is_changed > 0 and m.started > 0:
        _change_places(m.station, line(tracker), memory)
    speed_control_step(longitudinal)
    if memory.is_placed > 0 and m.started > 0:
        _note_places(line(tracker), memory)
    _report(tracker.check, memory)


@exported(void(Place(Longitudinal)))
def longitudinal_follow(longitudinal):
    """Go over to the plan that `longitudinal` has now; what was learned stays, and a stop of both plans is one stop."""
    longitudinal.memory[0].is_changed = 1


@exported(void(Place(Longitudinal)))
def longitudinal_release(longitudinal):
    """Let the car leave the stop at which it stands, whatever its time; at the end of a path it stays."""
    longitudinal.memory[0].is_released = 1


@exported(void(Place(Longitudinal)))
def longitudinal_acknowledge(longitudinal):
    """End a fault of brakes or drive, and the distrust of the measured speed; the car drives on."""
    control.acknowledge(longitudinal.memory[0])

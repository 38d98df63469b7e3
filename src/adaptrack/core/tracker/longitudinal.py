"""Speed control behind a tracker: who brakes and when, by the status of the tracker, once a control instant."""

from __future__ import annotations

import math

import numpy as np

from ..friction_estimate import FrictionEstimate, begin_friction, narrow_friction
from ..kernel import Place, exported, float64, inlined, record, rows, vector, void
from ..maths.bits import whole
from ..speed_control import BLIND_GRACE, OFF, SPEED_MEMORY, SPEED_SAMPLE, SpeedPath, SpeedSettings, speed_control
from ..speed_learning import SpeedBanks, begin_bank
from .records import INSTANT, MAX_SIGNAL, TRACKED, TRACKER_SAMPLE, TrackerRecord

Longitudinal = record(
    "Longitudinal",
    (
        ("sample", rows(SPEED_SAMPLE)), ("memory", rows(SPEED_MEMORY)), ("settings", SpeedSettings),
        ("path", SpeedPath), ("banks", SpeedBanks), ("ahead", vector), ("friction", FrictionEstimate),
    ),
)  # fmt: skip
"""A speed control: sample and memory (1,), settings, plan, banks, the governed squares ahead (m^2/s^2), and the
estimate of the friction."""

FOLLOW, FOLLOW_SLOWLY, COMFORT_STOP, EMERGENCY_STOP, NO_ACTION = range(5)
"""Actions: follow the plan; follow it, but stand before the steering loses its estimate; stop with the deceleration of
comfort; stop with the largest deceleration that friction allows; keep the requests in force."""
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


@inlined
def _is_due(time, m, memory, period):
    """Whether the speed control steps in a call at a time (s): at control instants.

    Without a position since the beginning there are none, but calls of a period or more apart.
    """
    if m.started > 0:
        return m.answered > 0
    return abs(time - memory.time) >= SHORTEST_PERIOD_SHARE * period


@inlined
def _write_sample(tracker, blind_time, action, sample, memory):
    """Write the sample of the speed control after a call of the tracker; blind_time: s, since the last position."""
    is_guided, is_blind = action in (FOLLOW, FOLLOW_SLOWLY), action in (FOLLOW_SLOWLY, EMERGENCY_STOP)
    sample.station = tracker.tracked[TRACKED.station] if is_guided else math.nan
    sample.blind_time = blind_time if is_blind else 0.0
    sample.speed, sample.yaw_rate = tracker.sample[TRACKER_SAMPLE.speed], tracker.sample[TRACKER_SAMPLE.yaw_rate]
    acceleration = tracker.sample[TRACKER_SAMPLE.longitudinal_acceleration]
    sample.acceleration = acceleration if abs(acceleration) < MAX_SIGNAL else math.nan
    sample.driver = 1.0 if tracker.sample[TRACKER_SAMPLE.driver] > 0.5 else 0.0
    sample.grade = tracker.sample[TRACKER_SAMPLE.grade]
    motion_t, t = tracker.sample[TRACKER_SAMPLE.motion_t], tracker.sample[TRACKER_SAMPLE.t]
    speed_time = motion_t if motion_t == motion_t else t
    sample.elapsed = speed_time - memory.speed_time if speed_time > memory.speed_time > -math.inf else 0.0
    memory.speed_time = speed_time


@exported(void(Place(Longitudinal)))
def longitudinal_begin(longitudinal):
    """Forget what was learned of drive, brakes and friction."""
    settings, banks = longitudinal.settings, longitudinal.banks
    begin_bank(settings.drive_lag, settings.drive_dead_time, banks.drive)
    begin_bank(settings.brake_lag, settings.brake_dead_time, banks.brakes)
    banks.requests[:] = 0.0
    begin_friction(longitudinal.friction)


@exported(void(Place(Longitudinal)))
def speed_control_step(longitudinal):
    """One control period, see `speed_control`."""
    sample, memory, settings = longitudinal.sample[0], longitudinal.memory[0], longitudinal.settings
    speed_control(sample, settings, longitudinal.path, memory, longitudinal.banks, longitudinal.ahead)


@exported(void(vector, float64, float64, vector, Place(Longitudinal)))
def narrow_friction_step(measured, speed, command, learned, longitudinal):
    """Narrow the friction before a step of the controller, see `narrow_friction`."""
    narrow_friction(measured, speed, command, learned, longitudinal)


@exported(void(Place(TrackerRecord), vector, Place(Longitudinal)))
def narrow_tracked_friction(tracker, learned, longitudinal):
    """Narrow the friction at a control instant of a tracker, before its controller steps.

    learned: memory of its learner, empty without one. At the first instant the filters begin again.
    """
    m = tracker.memory[0]
    if m.instant == 0:
        longitudinal.friction.memory[0].running = 0.0
    narrow_friction(tracker.measured, tracker.ahead[INSTANT.speed], m.command, learned, longitudinal)


@exported(void(Place(TrackerRecord), Place(Longitudinal)))
def longitudinal_step(tracker, longitudinal):
    """Run the speed control after a call of the tracker, once a control instant.

    The requests are in `longitudinal.memory`, see `core.speed_control.SPEED_MEMORY`. The speed is limited to the
    tracker's first top speed.
    """
    m, sample, memory = tracker.memory[0], longitudinal.sample[0], longitudinal.memory[0]
    time = tracker.sample[TRACKER_SAMPLE.now]
    blind_time = time - m.newest
    action = STATUS_ACTIONS[whole(tracker.tracked[TRACKED.status]), 0 if blind_time <= BLIND_GRACE else 1]
    if action == NO_ACTION or not _is_due(time, m, memory, longitudinal.settings.period):
        return
    memory.time = time
    sample.top_speed = tracker.tracked[TRACKED.first_top_speed]
    _write_sample(tracker, blind_time, action, sample, memory)
    speed_control_step(longitudinal)


@exported(void(Place(Longitudinal)))
def longitudinal_follow(longitudinal):
    """Go over to the plan that `longitudinal` has now; what was learned of drive and brakes stays."""
    longitudinal.memory[0].next_stop, longitudinal.memory[0].state = 0, OFF

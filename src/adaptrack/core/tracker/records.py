"""What a tracker is given, remembers and gives: records of numbers, and the arrays of a caller."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..controllers.contract import STANDSTILL_SPEED as STANDSTILL_SPEED
from ..controllers.part import REQUEST as REQUEST
from ..input_check.record import Check
from ..kernel import columns, record, rows, vector
from ..models.contract import MEASUREMENT
from ..road import Roads
from ..variables import VARIABLE_COLUMNS

LONGEST_GAP = 2.0
"""s without a call, or a clock that jumps back by more: the tracker begins anew from the command held. A controller
without a Kalman filter goes on for so long without a position, too."""
LONGEST_CARRY = 0.3
"""s, by which a sample is carried at most by its own motion."""
LARGEST_JUMP, JUMPS = 10.0, 3
"""m, between a position and where the car was expected, beside half of the way since: such a position is left out;
when so many come one after the other, the car was moved, and the tracker begins anew."""
MAX_POSITION, MAX_SIGNAL = 1e8, 1e3
"""m, from the origin; SI units: no position, and no speed, rate, acceleration or angle of a car is as large: what is
counts as not measured."""
ACROSS_PENALTY = 10.0
"""m of distance that a foot may be nearer for a path at right angles to the car, when a path is looked for its start.
"""
SHARE_OF_LAST = 0.2
"""Share of the last interval in the mean interval between calls."""
EXPECTED_SPEEDS = 80
"""Control instants for which speeds are expected."""

STATUS = columns(
    "ok",  # a new position was used
    "estimated",  # no new position, or none to be believed
    "held",  # no position yet or for too long, or no solution; stop the car
    "standing",  # the car stands
    "reverse",  # it drives backwards
    "off_path",  # it is far from the path, or has no foot on it; stop it
    "end",  # it is beyond the end of the path; stop it
    "sliding",  # it slides
    "repeated",  # a call at the time of the one before, or an earlier one: left out
    "no_time",  # a call without a time: left out
)
"""What a call was."""
FOLLOWING, ESTIMATED, HELD, STANDS, REVERSE, OFF_PATH, BEYOND_END, CAR_SLIDES, REPEATED, NO_TIME = STATUS
NO_BELIEF = -1.0
"""The state of a belief where nothing is learned."""

TRACKER_SETTINGS = record(
    "Settings",
    (
        "period",  # s, control period
        "angle_min", "angle_max",  # rad, rad: limits of the controller's command; infinite: none
        "move",  # rad, by which a command goes back at a call while the car turns against its steering
        "furthest",  # m, from the path, beyond which the car is off it
        "late",  # periods that the controller's filter goes through anew; 0: it takes nothing late
        "filtered",  # 1: the controller has a Kalman filter for what is missing, 0: it is given an estimate
        "drift_arm",  # m, l_r: v_y of a steady turn is (l_r - load v^2/stiffness) times the yaw rate
        "drift_load",  # kg m, m l_f
        "drift_stiffness",  # N m/rad, 2 C_r L
        "nominal_friction",  # of a road whose friction is not known, for schedules
        "first_top_speed",  # m/s, below which to drive until the controller has learned its car; infinite: no limit
    ),
    integers=("late", "filtered"),
)  # fmt: skip
"""Of a tracker and its controller, fixed over a drive."""

MEMORY = record(
    "Memory",
    (
        "command",  # rad, in force
        "command_before",  # rad, before the call at hand
        "started",  # 1 once there was a position
        "last",  # s, time of the last call
        "between",  # s, mean interval between calls
        "began",  # s, time of the first control instant
        "instant",  # the present control instant
        "due",  # instants still to be gone through in this call
        "first",  # 1: of these the first is the first of all
        "waiting",  # 1: for the controller's command
        "open",  # 1: the call is not over
        "status",  # of the last call that was not left out
        "rejection",  # REPEATED or NO_TIME of the call at hand, else 0
        "answered",  # 1: the call at hand gave a new command or status
        "fresh",  # 1: a new position is in the measurement
        "speed",  # m/s, last known, NaN: none yet
        "yaw_rate",  # rad/s
        "x", "y", "yaw",  # m, m, rad: of the car at the present instant
        "newest",  # s, time of the newest position that was used
        "jumps",  # positions in a row that have jumped
        "placed_x", "placed_y", "placed_yaw", "placed_t",  # m, m, rad, s: of the last position that was given
        "station", "heading",  # m, rad: of the car's foot on the path
        "turned",  # rad, heading of the path at the foot less that of a period ago
        "offset", "heading_error",  # m, rad: of the car against the path, NaN where it has no foot
        "near",  # m, about which a foot is looked for at the beginning; NaN: on the whole path
        "given_t", "given_x", "given_y", "given_yaw",  # s, m, m, rad: of the sample at hand as it is used
        "given_yaw_rate", "given_vy", "given_lateral_acceleration", "given_wheel_angle",  # rad/s, m/s, m/s^2, rad
        "given_motion_t",  # s, of the motion in the sample at hand
        "belief_state",  # of the controller's last step, as in TRACKED
        "belief_at_bound",  # likewise
        "ended_top_speed",  # m/s, first top speed that ended when the delay of the steering was learned; 0: none
    ),
    integers=(
        "started", "instant", "due", "first", "waiting", "open", "status", "rejection", "answered", "fresh", "jumps",
    ),
)  # fmt: skip
"""What a tracker remembers: all of it."""

TRACKER_SAMPLE = columns(
    "t",  # s, when the pose was taken, and the motion without a time of its own
    "now",  # s, of the call, on the same clock; NaN: t
    "x", "y",  # m, m: of the centre of mass
    "yaw",  # rad, wrapped or not
    "speed",  # m/s, negative backwards
    "yaw_rate",  # rad/s
    "vy",  # m/s, lateral velocity
    "lateral_acceleration",  # m/s^2, without the pull of a bank
    "wheel_angle",  # rad, of the road wheels: the first command is near it
    "friction",  # -, of the road, for a schedule; NaN: not known
    "wind",  # m/s, of the air to the left, for a schedule; NaN: not known
    "motion_t",  # s, when speed, yaw rate, v_y, lateral acceleration and wheel angle were taken; NaN: t
    "longitudinal_acceleration",  # m/s^2, dv/dt without gravity, for a speed control
    "driver",  # 1: a driver uses the pedals, for a speed control
    "grade",  # dz/ds under the car, measured, positive uphill, for a speed control; NaN: that of its plan
)  # fmt: skip
"""A call. What is not known is NaN; what no car can have is made NaN here."""

INSTANT = columns(
    "speed",  # m/s, of the car, never negative
    "station",  # m, of its foot on the path
    "count",  # of the expected speeds that count: the last one holds
)  # fmt: skip
"""What a controller is given at an instant, beside what is measured."""

CONTROLLER_ANSWER = columns(
    "command",  # rad; not finite: the last one is held
    "held",  # 1: it is no new one
    "belief_state",  # as in TRACKED
    "belief_at_bound",  # likewise
    "delay_sigma",  # s, standard deviation of the learned delay of the steering; 0 where nothing is learned
)  # fmt: skip
"""What a controller answers."""

TRACKED = columns(
    "command",  # rad, angle of the road wheels to ask for, positive to the left
    "status",  # see STATUS
    "offset",  # m, of the car from the path, positive to the left; NaN where there is no position to go by
    "heading_error",  # rad, the car's heading less the path's; likewise
    "station",  # m, arc length of the car's foot on the path, over all laps; likewise
    "belief_state",  # 0 learning, 1 settled, 2 at a bound, 3 contradictory; -1 where nothing is learned
    "belief_at_bound",  # 0, or 1 lag, 2 dead time, 3 stiffness, 4 balance, 5 bias: whose belief is at a bound
    "suspect",  # sum of 2^k for each of `input_check.record.MISTAKES` that was found in the inputs
    "first_top_speed",  # m/s, below which to drive until the controller has learned its car; infinite: no limit
)  # fmt: skip
"""What a call gives."""

PlanRecord = record("PlanRecord", (("s", vector), ("speed", vector)))
"""A planned speed (m/s) at arc lengths (m) from 0 to the path's; between them its square is straight. Empty: none."""

TrackerRecord = record(
    "TrackerRecord",
    (
        ("settings", rows(TRACKER_SETTINGS)),  # (1,)
        ("memory", rows(MEMORY)),  # (1,)
        ("sample", vector),  # (SAMPLE,)
        ("path", Roads),  # of one road; without pieces there is none yet
        ("plan", PlanRecord),
        ("measured", vector),  # (models.contract.MEASURED,)
        ("speeds", vector),  # (SPEEDS,) m/s, expected at the instants from now on
        ("ahead", vector),  # (AHEAD,)
        ("answer", vector),  # (ANSWER,)
        ("request", vector),  # (REQUEST,)
        ("tracked", vector),  # (TRACKED,)
        ("variables", vector),  # (variables.VARIABLES,) of a schedule
        ("check", Check),  # of the inputs
    ),
)
"""A tracker around any controller."""


def tracker(settings: Any, path: Any, plan: Any, check: Any) -> Any:
    """A tracker that has to engage first: SETTINGS (1,), a road alone as `Roads`, a `PlanRecord`, a `Check`."""
    sizes = (
        len(MEASUREMENT), EXPECTED_SPEEDS, len(INSTANT), len(CONTROLLER_ANSWER), len(REQUEST), len(TRACKED),
        len(VARIABLE_COLUMNS),
    )  # fmt: skip
    return TrackerRecord(
        settings, MEMORY.new(near=np.nan), np.full(len(TRACKER_SAMPLE), np.nan), path,
        plan, *(np.zeros(size) for size in sizes), check,
    )  # fmt: skip

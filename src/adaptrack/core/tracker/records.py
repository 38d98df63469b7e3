"""What a tracker is given, remembers and gives: records of numbers, and the arrays of a caller."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..controllers.contract import ANGLE_LIMITS
from ..controllers.contract import STANDSTILL_SPEED as STANDSTILL_SPEED
from ..controllers.part import REQUEST as REQUEST
from ..input_check.record import Check
from ..kernel import fields_of, record, rows, vector
from ..models.contract import MEASUREMENT, PERIOD_FIELD
from ..planned.records import Planned
from ..roads.road import Roads
from ..scheduling.functions import VARIABLE_COLUMNS
from .signals import TRACKED, TRACKER_SAMPLE, TrackerSample

LONGEST_GAP = 2.0
"""s without a call, or a clock that jumps back by more: the tracker begins anew from the command held. A controller
without a Kalman filter goes on for so long without a position, too."""
LONGEST_CARRY = 0.3
"""s, by which a sample is carried at most by its own motion."""
LARGEST_JUMP, JUMPS = 10.0, 3
"""m, between a position and where the car was expected, beside half of the way since: such a position is left out;
when so many come one after the other, the car was moved, and the tracker begins anew."""
ACROSS_PENALTY = 10.0
"""m of distance that a foot may be nearer for a path at right angles to the car, when a path is looked for its start.
"""
SHARE_OF_LAST = 0.2
"""Share of the last interval in the mean interval between calls."""
EXPECTED_SPEEDS = 80
"""Control instants for which speeds are expected."""

TRACKER_SETTINGS = record(
    "Settings",
    (
        PERIOD_FIELD,
        *ANGLE_LIMITS,  # of the controller's command
        "move",  # rad, by which a command goes back at a call while the car turns against its steering
        "sample_arm",  # m, from the centre of mass forwards to the point of the car whose x and y a sample has
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
        *fields_of(TRACKED)[: TRACKED.suspect],  # of the last call that was not left out
        "command_before",  # rad, before the call at hand
        "started",  # 1 once there was a position
        "last",  # s, time of the last call
        "between",  # s, mean interval between calls
        "began",  # s, time of the first control instant
        "instant",  # the present control instant
        "due",  # instants still to be gone through in this call
        "first",  # 1: of these the first is the first of all
        "rejection",  # REPEATED or NO_TIME of the call at hand, else 0
        "answered",  # 1: the call at hand gave a new command or status
        "fresh",  # 1: a new position is in the measurement
        "predicted",  # 1: the controller has predicted its way along this path
        "speed",  # m/s, last known, NaN: none yet
        "yaw_rate",  # rad/s
        "x", "y", "yaw",  # m, m, rad: of the car at the present instant
        "newest",  # s, time of the newest position that was used
        "jumps",  # positions in a row that have jumped
        "placed_x", "placed_y", "placed_yaw", "placed_t",  # m, m, rad, s: of the last position that was given
        "heading",  # rad, of the path at the car's foot
        "turned",  # rad, heading of the path at the foot less that of a period ago
        "near",  # m, about which a foot is looked for at the beginning; NaN: on the whole path
        ("sample", TrackerSample),  # the sample at hand as it is used
        "delay_sigma",  # s, standard deviation of the learned delay of the steering; 0 where nothing is learned
        "aside",  # m, of the reference to the left of the path: it decays
        "ended_top_speed",  # m/s, first top speed that ended when the delay of the steering was learned; 0: none
    ),
    integers=(
        "started", "instant", "due", "first", "status", "rejection", "answered", "fresh", "predicted",
        "jumps",
    ),
)  # fmt: skip
"""What a tracker remembers: all of it."""

PlanRecord = record("PlanRecord", (("s", vector), ("speed", vector)))
"""A planned speed (m/s) at arc lengths (m) from 0 to the path's; between them its square is straight. Empty: none."""

TrackerRecord = record(
    "TrackerRecord",
    (
        ("settings", rows(TRACKER_SETTINGS)),  # (1,)
        ("memory", rows(MEMORY)),  # (1,)
        ("sample", vector),  # (TRACKER_SAMPLE,)
        ("path", Roads),  # of one road; without pieces there is none yet
        ("plan", PlanRecord),
        ("measured", vector),  # (models.contract.MEASURED,)
        ("speeds", vector),  # (EXPECTED_SPEEDS,) m/s, expected at the instants from now on
        ("request", vector),  # (REQUEST,)
        ("tracked", vector),  # (TRACKED,)
        ("variables", vector),  # (variables.VARIABLES,) of a schedule
        ("check", Check),  # of the inputs
        ("planned", Planned),  # empty without a planner
    ),
)
"""A tracker around any controller."""


def tracker(settings: Any, path: Any, plan: Any, check: Any, planned: Any) -> Any:
    """A tracker that has to engage first: SETTINGS (1,), a road alone as `Roads`, `PlanRecord`, `Check`, `Planned`."""
    sizes = len(MEASUREMENT), EXPECTED_SPEEDS, len(REQUEST), len(TRACKED), len(VARIABLE_COLUMNS)
    return TrackerRecord(
        settings, MEMORY.new(near=np.nan), np.full(len(TRACKER_SAMPLE), np.nan), path,
        plan, *(np.zeros(size) for size in sizes), check, planned,
    )  # fmt: skip

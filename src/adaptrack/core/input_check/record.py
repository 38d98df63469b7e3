"""Records of the check of a loop's inputs: the car, and the memory of the check."""

from __future__ import annotations

from ..kernel import Row, columns, exported, fields_of, float64, inlined, int64, record, size_of, vector, viewer, void
from ..maths.bits import left
from ..models.car import CarRow
from ..tracker.signals import TRACKER_SAMPLE
from .hypotheses import ABOUT, BANKS, COMPARED, GRAMS_OF, SUBJECT_OF, SUBJECTS

TICK, WINDOW, TICKS, FEWEST = 0.095, 4, 9, 4
"""s, between two looks at the samples; looks that a window spans, that are kept, and that are needed to compare."""
LONGEST = 1.2
"""s, of a window; after a gap the comparison goes on behind it."""
SLOW, CRAWLING = 3.0, 1.5
"""m/s: below the first only commands and drifts of the pose are compared, below the second nothing."""
POSITION = 0.045
"""m, noise of a difference of two positions."""
REQUESTED, CLOSEST = 64, 0.02
"""Commands that are kept; s, between two of them: what comes sooner replaces the last one."""
COURSES = 10
"""Directions of motion that are kept, with the yaw."""
NUMBERS = 3
"""Measured numbers that go with a mistake, at most."""

SAMPLE = columns(
    *fields_of(TRACKER_SAMPLE)[: TRACKER_SAMPLE.wheel_angle + 1],
    TRACKER_SAMPLE.field_settings["longitudinal_acceleration"],
)
"""A call of the loop; NaN: not known."""
SUMMED = len(SAMPLE) - SAMPLE.speed
"""Signals of a sample from the speed on."""

Settings = record("Settings", (
    "period",  # s, of the loop; NaN: not known
    "known",  # 1 where the car is
    "lf", "lr",  # m, m: from the centre of mass to the axles
    "length", "gradient",  # m, s^2/m: a steady turn has the yaw rate angle speed/(length + gradient speed^2)
    "slip",  # s^2 m^-1 m: sideways speed by the slip of the rear tyres over yaw rate times speed^2
    "delay",  # s, specified lag and dead time from a command on; infinite: not specified, or learned
    "position_noise",  # m, standard deviation that the filter assumes; 0: without a filter
))  # fmt: skip
"""What a check knows of the loop and its car."""
settings_of = viewer(Settings)

T = columns("t", "time", "x", "y", "yaw", "speed", "turned", "way", "yaw_rate", "vy", "pull", "wheel", "forward")
"""The car at a look, and means and changes since the look before: turned (rad), of the yaw; way (m), by the speed."""
INTEGRAL = columns("t", "command", "turning", "limited_turning", "turning_times_4", "turning_times_57",
                   "angle", "limited_angle", "angle_times_4", "angle_times_57")  # fmt: skip
"""Of a call, its time, its command, and integrals of the turning and of the wheels' angle by each model (`BANKS`)."""
ERRORS = columns("scale", "mounting", "slip", "lever", "gyro", "speed_late", "yaw_late")
"""Honest errors of the sensors that are estimated: of the speed, relative; of the yaw (rad); of the slip of the rear
tyres (s^2/m); of the position, ahead of the centre of mass (m); offset of the yaw rate (rad/s); clocks (s)
of the speed and the yaw rate."""
MOVED = columns("time", "way", "turned", "sideways")
"""Since the last pose: s; m, by the speed; rad, by the yaw rate; m, by the lateral velocity."""
Memory = record("Memory", (
    ("suspect", int64),  # bits of `MISTAKES`: those named so far
    ("against_steering", int64),  # 1: the car turns against its commands
    ("sliding", int64),  # 1: the car slides
    "sideslip",  # rad; NaN: not known
    "skid",  # rad, sideslip beyond that of a rolling turn and the noise of positions; NaN: not known
    ("measured", (float64, len(SUBJECTS), NUMBERS)),  # what was measured where a mistake was named
    "now", "t", "begun_at", "tick",  # s: the last call, sample, beginning of the commands and look
    ("pose", (float64, 3)),  # of the last call
    ("last", (float64, SUMMED)),  # speed, yaw rate, v_y, lateral acceleration, wheel angle, longitudinal acceleration
    "summed", ("sums", (float64, SUMMED)),  # s since the last look, and their integrals
    ("tick_count", int64), ("ticks", (float64, TICKS, len(T))),  # looks, the last one at the end
    "command", ("wheels", (float64, BANKS)),  # rad; angle of the wheels by each model
    ("begun_with", (float64, 2)),  # turning and angle at the beginning
    ("request_count", int64), ("request", int64), ("requests", (float64, REQUESTED, len(INTEGRAL))),
    ("steps", int64), ("jumped", int64), ("askew", int64), ("degrees", int64), ("beyond", int64),  # in a row
    ("agreed", int64), ("confirmed", int64),  # looks at which positions move along the yaw; whether in bends, too
    "origin", "yaw_least", "yaw_most",  # rad
    ("course_count", int64), ("course", int64), ("courses", (float64, COURSES, 2)),
    "mounting", ("straight", int64),  # rad, of positions beside the yaw on the straight; looks
    ("slips", int64), "calm",  # looks at which the car slides; s, since it no longer does
    ("seconds", (float64, len(COMPARED))), ("count", (float64, len(COMPARED))),  # of each comparison, see `Finding`
    ("repeated", (int64, len(COMPARED))), ("usual", (int64, len(COMPARED))), ("label", (int64, len(COMPARED))),
    ("grams", (float64, sum(GRAMS_OF), 5, 5)),  # of the regressions
    ("placed", (float64, 3)), ("moved", (float64, len(MOVED))),  # last pose; motion since then
    ("errors", (float64, len(ERRORS))), ("covariance", (float64, len(ERRORS), len(ERRORS))),
    ("drifts", (float64, 2, 3)), ("honest_drifts", (float64, 2, 2)),  # m, m, rad; m, rad: in a short and a long time
    "pull",  # m/s^2, mean lateral acceleration
    ("steady", int64), ("drifting", int64),  # looks at which the pose did not drift; in a row at which it did
    ("late", int64),  # looks in a row at which the car turned later than specified
    "slow_speed", "slow_acceleration",  # m/s, m/s^2: speed and longitudinal acceleration, filtered alike
))  # fmt: skip
"""All that a check remembers."""
memory_of = viewer(Memory)
MEMORY_SIZE, SETTINGS_SIZE = size_of(Memory), size_of(Settings)

Check = record("Check", (("settings", vector), ("memory", vector)))
"""A check of the inputs of a loop: `Settings` and `Memory`, as numbers in a row."""


@inlined
def report(memory, mistake, a, b, c):
    """Report a mistake with the measured numbers, unless one of its subject was reported before."""
    subject = SUBJECT_OF[mistake]
    if memory.suspect & ABOUT[subject] == 0:
        memory.suspect |= left(1, mistake)
        memory.measured[subject, 0], memory.measured[subject, 1], memory.measured[subject, 2] = a, b, c


@inlined
def is_reported(memory, subject):
    """Whether a mistake of a subject was reported."""
    return memory.suspect & ABOUT[subject] != 0


@exported(void(Row(CarRow), float64, float64, float64, vector))
def check_settings(car, period, delay, position_noise, settings):
    """Write `Settings` of a car; mass NaN: an unknown car, of which only signs and units are compared.

    The turning is that of Rajamani, 2nd ed., section 3.3.
    """
    to = settings_of(settings, 0)
    to.period, to.delay, to.position_noise = period, delay, position_noise
    if car.mass > 0.0:
        to.known, to.lf, to.lr, to.length = 1.0, car.lf, car.lr, car.lf + car.lr
        to.gradient = 0.5 * car.mass / to.length * (car.lr / car.stiffness_front - car.lf / car.stiffness_rear)
        to.slip = 0.5 * car.mass * car.lf / (car.stiffness_rear * to.length)
    else:
        to.known, to.lf, to.lr, to.length, to.gradient, to.slip = 0.0, 1.3, 1.5, 2.8, 0.0, 0.0

"""Mistakes of inputs, the hypotheses that recognise them, and one weighted regression that judges every comparison.

A comparison is a regression y = b1 x1 + b2 x2 + b3 x3 + intercept. Some have alternatives, whose regressors differ:
delays of the steering, or shifts of a clock. A hypothesis is a triple (b1, b2, b3) and the alternatives that it is for;
it is honest, or belongs to a mistake. The checks of logs name the same mistakes (`identification.hypotheses`).

Each window adds the products of its regressors, divided by its noise, to a Gram matrix; old windows are forgotten. From
it follows the squared misfit of any hypothesis. A mistake is reported when it explains the windows better than every
honest value, by a multiple of twice the logarithm of the likelihood ratio (A. Wald, *Sequential Analysis*, 1947).

To recognise a further mistake, add it to `MISTAKE_TABLE`, and its hypotheses to those of a comparison.
"""

from __future__ import annotations

import itertools
import math
from typing import NamedTuple

import numpy as np

from ..kernel import columns, inlined, local
from ..maths.bits import whole
from ..maths.exact import clip
from ..maths.exponential import exp


class Mistake(NamedTuple):
    """A mistake of the inputs of a loop or of a log, and its words."""

    name: str
    subject: str
    """of each subject one mistake is reported"""
    evidence: str
    """format of what a loop measured; ``steered``: name of the steering signal"""
    meaning: str
    """format of the mistake in words"""
    remedy: str
    """for the caller of a loop"""
    option: str = ""
    """for the reader of a log: options of the commands; empty: the remedy"""

    def says(self, evidence: str, for_log: bool) -> str:
        """Return the sentence of a loop or of a log, with its evidence: a format."""
        return f"{evidence}: {self.meaning}; {self.option if for_log and self.option else self.remedy}."


def _mistakes(subject, evidence, *rows):
    """Mistakes of a subject that the same evidence shows; rows: their other fields."""
    return [Mistake(name, subject, evidence, *words) for name, *words in rows]


_LEFT, _METRES, _STAMPS = "give it positive to the left", "give m/s^2", "give each the time at which it was taken"
_CLOCKS_DIFFER = "their clocks differ by some 0.2 s, or one of them is late"
_TOO_LARGE = "the command seems to be sent in degrees, or at the steering wheel"
_ACTUATOR = "give the actuator radians at the road wheels"
MISTAKE_TABLE = (
    *_mistakes("time", "t: calls are {0:.3g} s apart by it, and the car moves {1:.2g} m at {2:.3g} m/s",
        ("time_in_milliseconds", "the time is in milliseconds", "give it in seconds", "--units time=ms"),
        ("time_in_microseconds", "the time is in microseconds", "give it in seconds", "--units time=us"),
        ("time_in_nanoseconds", "the time is in nanoseconds", "give it in seconds", "--units time=ns")),
    *_mistakes("speed", "speed: no car drives at {0:.3g} m/s",
        ("speed_of_no_car", "the speed seems to be in km/h", "give m/s", "--units speed=km/h")),
    *_mistakes("speed", "speed: the positions move at {0:.2f} times the speed",
        ("speed_in_km_h", "the speed is in km/h", "give m/s", "--units speed=km/h"),
        ("speed_in_miles_h", "the speed is in miles per hour", "give m/s", "--units speed=mph"),
        ("speed_unit", "the unit of speed or positions is wrong", "give m/s, along the car, and m", "check --units")),
    *_mistakes("speed_late", "speed and positions", ("speed_late", _CLOCKS_DIFFER, _STAMPS)),
    *_mistakes("course", "yaw and x, y: the direction of motion differs from yaw by {0:.0f} degrees",
        ("yaw_in_degrees", "yaw is in degrees", "give it in radians", "--units yaw=deg"),
        ("y_mirrored", "y is mirrored against yaw (a left-handed frame, such as NED?)",
         "give x, y, yaw and yaw_rate in axes with y and angles positive to the left"),
        ("yaw_from_north", "yaw is counted clockwise from north (y)", "give it anticlockwise from x: pi/2 - yaw"),
        ("yaw_from_north_in_degrees", "yaw is counted clockwise from north, in degrees", "give pi/2 - yaw pi/180"),
        ("yaw_quarter_too_large", "yaw is a quarter of a turn too large", "count it from x"),
        ("yaw_quarter_too_small", "yaw is a quarter of a turn too small", "count it from x"),
        ("yaw_half_turn_off", "yaw is half a turn off", "give the direction of the car's front"),
        ("frames_differ", "their frames differ", "count yaw from x towards y, in radians")),
    *_mistakes("course", "yaw: it changes 57 times as much as yaw_rate says",
        ("yaw_in_degrees_by_its_rate", "yaw is in degrees", "give it in radians", "--units yaw=deg")),
    *_mistakes("yaw_late", "yaw and yaw_rate", ("yaw_late", _CLOCKS_DIFFER, _STAMPS)),
    *_mistakes("yaw_rate", "yaw_rate: over half a second yaw changes by {0:.2g} rad, the yaw rate says {1:.2g} rad",
        ("yaw_rate_sign", "the sign of the yaw rate is inverted", _LEFT, "--flip yaw_rate"),
        ("yaw_rate_in_degrees", "the yaw rate is in degrees per second", "give rad/s", "--units yaw_rate=deg/s"),
        ("yaw_rate_unit", "the unit of the yaw rate is wrong", "give rad/s", "check --units"),
        ("yaw_rate_taken_for_degrees", "the yaw rate is taken for degrees per second", "it is in rad/s")),
    *_mistakes("lateral", "lateral_velocity: the positions move to the other side",
        ("lateral_velocity_sign", "the sign of the lateral velocity is inverted", _LEFT, "--flip vy")),
    *_mistakes("point", "x, y: they move sideways in bends",
        ("position_of_rear_axle", "they are positions of the rear axle",
         "give those of the centre of mass, {0:.2f} m ahead of it"),
        ("position_of_front_axle", "they are positions of the front axle",
         "give those of the centre of mass, {1:.2f} m behind it")),
    *_mistakes("pull", "lateral_acceleration: it is {0:.2g} m/s^2 where speed times yaw rate is {1:.2g} m/s^2",
        ("lateral_acceleration_sign", "the sign of the lateral acceleration is inverted", _LEFT, "--flip acceleration"),
        ("lateral_acceleration_in_g", "the lateral acceleration is in g", _METRES, "--units acceleration=g")),
    *_mistakes("wheel", "wheel_angle: it is {0:.2g} rad at a command of {1:.2g} rad",
        ("wheel_angle_sign", "the sign of the steering or of the wheel angle is inverted",
         "give both positive to the left", "--flip command or --flip wheel"),
        ("wheel_angle_in_degrees", "the wheel angle is in degrees", "give rad", "--units wheel=deg"),
        ("wheel_angle_of_steering_wheel", "the wheel angle is that of the steering wheel",
         "give that of the road wheels", "--columns steering_wheel=NAME")),
    *_mistakes("steering", "{steered}: the car turns to the other side",
        ("steering_sign", "the steering sign ({steered}) is inverted, or x, y, yaw, yaw_rate and the path are of a "
         "left-handed frame (such as NED)", "give commands and angles positive to the left",
         "--flip {steered} or --flip yaw_rate")),
    *_mistakes("steering", "command: the car hardly turns",
        ("command_too_small", "the command seems to be taken in degrees, or not at all", _ACTUATOR)),
    *_mistakes("steering", "command: the car turns many times as much", ("command_too_large", _TOO_LARGE, _ACTUATOR)),
    *_mistakes("pose", "x, y: within seconds they moved {0:.2g} m away from where speed and yaw lead",
        ("position_drifts", "the position drifts or has jumped", "check the localisation")),
    *_mistakes("pose", "yaw: within seconds it changed by {0:.2g} rad more than yaw_rate says",
        ("yaw_drifts", "yaw drifts or has jumped", "check the localisation")),
    *_mistakes("delay", "command: the car turns {0:.2f} s after it",
        ("steering_late", "the specified steering delay of {1:.2f} s is too short",
         "learn the delay, MPC(..., learning=Learning()), or specify the true one")),
    *_mistakes("forward", "longitudinal_acceleration: over seconds it is {0:.2g}, the speed changes by {1:.2g} m/s^2",
        ("longitudinal_acceleration_sign", "the sign of the longitudinal acceleration is inverted",
         "give it positive forward", "--flip longitudinal_acceleration"),
        ("longitudinal_acceleration_in_g", "the longitudinal acceleration is in g", _METRES,
         "--units longitudinal_acceleration=g"),
        ("longitudinal_acceleration_with_gravity", "the longitudinal acceleration contains gravity on slopes",
         "give dv/dt, without gravity", "do not use it as dv/dt")),
    *_mistakes("planner", "trajectories: they begin at the car, {0:.2g} m beside the line that earlier ones meant",
        ("plan_begins_at_car", "the planner plans from the measured pose, which hides the controller's error",
         "let it plan from the place that its last trajectory has for the present")),
)  # fmt: skip
MISTAKE_NAMED = {mistake.name: mistake for mistake in MISTAKE_TABLE}
MISTAKES = columns(*MISTAKE_NAMED)
"""Bits of `Memory.suspect`: mistakes of the inputs that are recognised."""
SUBJECTS = columns(*dict.fromkeys(mistake.subject for mistake in MISTAKE_TABLE))
SUBJECT_OF = tuple(SUBJECTS._fields.index(mistake.subject) for mistake in MISTAKE_TABLE)
"""The subject of each mistake."""
ABOUT = tuple(
    sum(1 << bit for bit, subject in enumerate(SUBJECT_OF) if subject == place) for place in range(len(SUBJECTS))
)
"""The bits of each subject."""
MOTION_BITS = ABOUT[SUBJECTS.speed] | ABOUT[SUBJECTS.course] | ABOUT[SUBJECTS.yaw_rate]
"""Mistakes that make steering and lateral motion look wrong, too."""
POSE_BITS = MOTION_BITS | ABOUT[SUBJECTS.speed_late] | ABOUT[SUBJECTS.yaw_late] | ABOUT[SUBJECTS.point]
"""Mistakes that make a pose look as if it drifted."""

# -- hypotheses -------------------------------------------------------------------------------------------------------
DEGREE = math.pi / 180.0
DELAYS, DELAY = 13, 0.05
"""How many delays between a command and the turning of the car are tried, and their distance (s)."""
BANKS = 4
"""Models of the wheels, each with all delays: behind a lag; of a limited rate; the same with commands that are 4 times
and 57 times as large as intended."""
THROWN = 2 * DELAYS
"""The first alternative of wheels that are thrown about by commands that are too large."""
SHIFTS, SHIFT = 13, 0.05
"""How many differences of the clocks of yaw and yaw rate are tried, about none, and their distance (s)."""
EVIDENCE, SURE = 12.0, 5.0
"""Twice the logarithm of the likelihood ratio by which a mistake must beat every honest value; the same where other
measurements point to the mistake."""
HYPOTHESIS = columns("label", "b1", "b2", "b3", "first", "end", "evidence")
"""A row of `HYPOTHESES`. label: 0 for an honest value, else 1 + the place in `MISTAKES`; it applies to the alternatives
from first to before end."""
_HONEST = -1
_ALL = (0, BANKS * DELAYS)
_HONEST_WHEELS = (0, THROWN)
_TIMES_4, _TIMES_57 = (THROWN, THROWN + DELAYS), (THROWN + DELAYS, BANKS * DELAYS)
_NONE, _ONE = (0.0,), (1.0,)
NEAR_ONE = (0.85, 0.95, 1.0, 1.05, 1.15)
GAINS = (0.25, 0.4, 0.6, 0.8, 1.0, 1.25, 1.6, 2.2, 3.2)
"""Honest ratios of the car's turning to that of a steady turn of the car file."""
_WIDE_GAINS = (0.02, 0.05, 0.1, *GAINS, 6.0, 12.0, 24.0, 50.0)
_SLIPS = (0.3, 0.6, 1.0, 1.6, 2.5)  # of the rear tyres, relative to those of the car file
_MIRRORED = 4.0  # evidence where the course turns against the yaw: nothing honest looks like it
_SWING = 1.5 * EVIDENCE  # a controller that begins to learn its car swings it, too
_CENTRE = SHIFTS // 2
_AGREE, _APART = 1, 3
"""Shifts up to which clocks agree, and from which they are apart."""


def _rows(label, *grids, alternatives=_ALL, evidence=EVIDENCE):
    """Every combination of b1, b2 and b3 from their grids, as rows of `HYPOTHESES`."""
    grids = (*grids, _NONE, _NONE)[:3]
    return [(1.0 + label, *values, *alternatives, evidence) for values in itertools.product(*grids)]


class InputComparison(NamedTuple):
    """A comparison of signals, and its hypotheses."""

    name: str
    signals: str
    """in words; empty: a part of a different comparison"""
    hypotheses: list[tuple[float, ...]]
    """rows of `HYPOTHESES`"""
    alternatives: int = 1
    overlap: float = 4.0
    """windows that share a sample"""
    intercept: float = 0.0
    """its standard deviation, in the unit of y"""
    before: float = 0.0
    """that of what was in force before the first command (x3 then; 0: x3 is a regressor like the others)"""
    needs_car: bool = False


_NEAR_CLOCKS = _rows(_HONEST, NEAR_ONE, (-0.06, -0.03, 0.0, 0.03, 0.06))  # gain; delay in s of a rate that is summed
_AGAINST = _rows(
    MISTAKES.steering_sign, (-0.4, -0.7, -1.0, -1.5, -2.5), _ONE, alternatives=_HONEST_WHEELS, evidence=1.3 * EVIDENCE
)
COMPARISON_TABLE = (
    InputComparison("way", "positions and speed", [
        *_NEAR_CLOCKS,
        *_rows(MISTAKES.speed_late, (0.95, 1.0, 1.05), (-0.25, -0.2, -0.15, 0.15, 0.2, 0.25)),
        *_rows(MISTAKES.speed_in_km_h, (1 / 3.6,)),
        *_rows(MISTAKES.speed_in_miles_h, (0.447,)),
        *_rows(MISTAKES.speed_unit, (0.1, 0.6, 1.6, 2.2, 3.6, 10.0)),
    ]),
    InputComparison("course", "positions and yaw", [
        *_rows(_HONEST, (0.35, 0.5, 0.7, 0.85, 1.0, 1.2)),
        *_rows(MISTAKES.y_mirrored, (-1.0,), evidence=_MIRRORED),
        *_rows(MISTAKES.yaw_in_degrees, (DEGREE,), evidence=_MIRRORED),
    ], intercept=0.012),
    InputComparison("turn", "yaw and yaw rate", [
        *_NEAR_CLOCKS,
        *_rows(MISTAKES.yaw_rate_sign, (-1.0,)),
        *_rows(MISTAKES.yaw_in_degrees_by_its_rate, (40.0, 57.3)),
        *_rows(MISTAKES.yaw_rate_in_degrees, (DEGREE,)),
        *_rows(MISTAKES.yaw_rate_unit, (0.1, 0.5, 2.0, 5.0, 10.0)),
    ]),
    InputComparison("pull", "lateral acceleration, speed and yaw rate", [
        *_rows(_HONEST, (0.5, 0.7, 1.0, 1.4, 1.8)),
        *_rows(MISTAKES.lateral_acceleration_sign, (-1.0,), evidence=5.0 * EVIDENCE),
        *_rows(MISTAKES.lateral_acceleration_in_g, (1 / 9.81,), evidence=5.0 * EVIDENCE),
    ], overlap=2.0, intercept=0.5),
    InputComparison("wheel", "command and wheel angle", [  # gain of what the commands ask for; what was before them
        *_rows(_HONEST, NEAR_ONE, _ONE, alternatives=_HONEST_WHEELS),
        *_rows(MISTAKES.wheel_angle_sign, (-1.0,), _ONE, alternatives=_HONEST_WHEELS),
        *_rows(MISTAKES.wheel_angle_in_degrees, (57.3,), _ONE, alternatives=_HONEST_WHEELS),
        *_rows(MISTAKES.wheel_angle_of_steering_wheel, (11.0, 14.0, 17.0, 20.0), _ONE, alternatives=_HONEST_WHEELS),
        *_rows(MISTAKES.command_too_small, (0.0, DEGREE, 0.0625, 0.25), _ONE, alternatives=_HONEST_WHEELS),
        *_rows(MISTAKES.command_too_large, (0.85, 1.0, 1.2), _ONE, alternatives=_TIMES_4),
        *_rows(MISTAKES.command_too_large, (0.7, 0.85, 1.0), _ONE, alternatives=_TIMES_57),
    ], BANKS * DELAYS, overlap=2.0, intercept=0.02, before=0.07),
    InputComparison("steering", "command and turning", [  # the same
        *_rows(_HONEST, GAINS, _ONE, alternatives=_HONEST_WHEELS),
        *_rows(MISTAKES.command_too_small, (0.0, DEGREE, 0.05), _ONE, alternatives=_HONEST_WHEELS, evidence=_SWING),
        *_rows(MISTAKES.command_too_large, (0.6, 0.8, 1.0, 1.25, 1.6), _ONE, alternatives=_TIMES_4, evidence=_SWING),
        *_rows(MISTAKES.command_too_large, GAINS[:7], _ONE, alternatives=_TIMES_57, evidence=_SWING),
        *_AGAINST,
    ], BANKS * DELAYS, overlap=2.0, intercept=0.06, before=0.07),
    InputComparison("point", "positions and yaw rate", [  # shares of lr and lf, ahead of the rear axle; slip
        *_rows(_HONEST, (0.75, 1.0, 1.25), _NONE, _SLIPS),
        *_rows(MISTAKES.position_of_rear_axle, _NONE, _NONE, _SLIPS),
        *_rows(MISTAKES.position_of_front_axle, _ONE, _ONE, _SLIPS),
    ], needs_car=True),
    InputComparison("lateral", "positions and lateral velocity", [  # gain of v_y; shares of lr and lf
        *_rows(_HONEST, (0.8, 1.0, 1.2), (-0.3, 0.0, 0.3)),
        *_rows(MISTAKES.lateral_velocity_sign, (-1.0,)),
        *_rows(MISTAKES.position_of_rear_axle, _ONE, (-1.0,)),
        *_rows(MISTAKES.position_of_front_axle, _ONE, _NONE, _ONE),
    ], needs_car=True),
    InputComparison("forward", "longitudinal acceleration and change of the speed", [  # signal less dv/dt, over dv/dt
        *_rows(_HONEST, (-0.2, -0.1, 0.0, 0.1, 0.2)),
        *_rows(MISTAKES.longitudinal_acceleration_sign, (-1.9, -2.0, -2.1), evidence=SURE),
        *_rows(MISTAKES.longitudinal_acceleration_in_g, (1 / 9.81 - 1.0,), evidence=SURE),
    ], overlap=50.0, intercept=0.3),
    InputComparison("clock", "", [
        *_rows(_HONEST, NEAR_ONE, alternatives=(_CENTRE - _AGREE, _CENTRE + _AGREE + 1)),
        *_rows(MISTAKES.yaw_late, NEAR_ONE[1:4], alternatives=(0, _CENTRE - _APART + 1)),
        *_rows(MISTAKES.yaw_late, NEAR_ONE[1:4], alternatives=(_CENTRE + _APART, SHIFTS)),
    ], SHIFTS),
)  # fmt: skip
_UNKNOWN_CAR = [*_rows(_HONEST, _WIDE_GAINS, _ONE, alternatives=_HONEST_WHEELS), *_AGAINST]
COMPARED = columns(*(comparison.name for comparison in COMPARISON_TABLE))
GRAMS_OF = tuple(comparison.alternatives for comparison in COMPARISON_TABLE)
"""Alternatives of each comparison."""
_TABLES = (*(comparison.hypotheses for comparison in COMPARISON_TABLE), _UNKNOWN_CAR)
HYPOTHESES = np.array([row for table in _TABLES for row in table])
FIRST = tuple(itertools.accumulate(map(len, _TABLES), initial=0))
"""Where the hypotheses of each comparison (`COMPARED`) begin; after them those of the steering of an unknown car."""
UNKNOWN_STEERING = len(COMPARED)
LEAST_EVIDENCE = tuple(
    min(row[HYPOTHESIS.evidence] for row in table if row[HYPOTHESIS.label] > 0.0) for table in _TABLES
)
FIRST_GRAM = tuple(itertools.accumulate(GRAMS_OF, initial=0))
"""Where the sums of each comparison's alternatives begin."""
RULE = columns("overlap", "intercept", "before")
RULES = np.array([[getattr(comparison, name) for name in RULE._fields] for comparison in COMPARISON_TABLE])

# -- regression -------------------------------------------------------------------------------------------------------
MEMORY = 12.0
"""s, after which a window counts 1/e."""
LOOKS = 2
"""Looks in a row at which there must be enough evidence."""
X1, X2, X3, Y, ONE = range(5)
REGRESSORS = 5
LATE_GAINS = 0.6, 1.6
"""Ratio of the car's turning to that of a steady turn, least and most, where the steering is later than specified."""
LOOSE = 2.5
"""How many times wider the intercept is for wheels that are thrown about."""

_square, _window = local(REGRESSORS, REGRESSORS), local(REGRESSORS)


@inlined
def start_window(memory, comparison, time):
    """Count a window of a comparison; return the share that is left of the earlier ones."""
    left = exp(-time / MEMORY)
    memory.seconds[comparison] += time
    memory.count[comparison] = memory.count[comparison] * left + 1.0
    return left


@inlined
def add_window(gram, left, weight, x1, x2, x3, y):
    """Add a window to the sums of one alternative; weight: the inverse of its noise."""
    window = _window()
    window[X1], window[X2], window[X3], window[Y], window[ONE] = x1, x2, x3, y, 1.0
    for i in range(REGRESSORS):
        for j in range(i, REGRESSORS):
            gram[i, j] = gram[j, i] = gram[i, j] * left + weight * weight * window[i] * window[j]


@inlined
def _eliminate(square, place, spread):
    """Fit the coefficient of a regressor, whose prior has the standard deviation spread, whatever the others are."""
    scale = 1.0 / (square[place, place] + 1.0 / (spread * spread))
    for i in range(REGRESSORS):
        for j in range(REGRESSORS):
            if i != place and j != place:
                square[i, j] -= square[i, place] * square[place, j] * scale


@inlined
def _reduce(memory, comparison, alternative, square):
    """Write the sums of an alternative without its intercept and what was before the first command."""
    gram = memory.grams[FIRST_GRAM[comparison] + alternative]
    square[:, :] = gram
    intercept, before = RULES[comparison, RULE.intercept], RULES[comparison, RULE.before]
    if before > 0.0:
        _eliminate(square, X3, before)
    if intercept > 0.0:
        _eliminate(square, ONE, intercept * LOOSE if alternative >= THROWN else intercept)


@inlined
def _misfit(square, row):
    """The squared misfit of a hypothesis."""
    b1, b2, b3 = HYPOTHESES[row, HYPOTHESIS.b1], HYPOTHESES[row, HYPOTHESIS.b2], HYPOTHESES[row, HYPOTHESIS.b3]
    return (
        b1 * (b1 * square[X1, X1] + 2.0 * (b2 * square[X1, X2] + b3 * square[X1, X3] - square[X1, Y]))
        + b2 * (b2 * square[X2, X2] + 2.0 * (b3 * square[X2, X3] - square[X2, Y]))
        + b3 * (b3 * square[X3, X3] - 2.0 * square[X3, Y])
        + square[Y, Y]
    )


@inlined
def _find_best(memory, comparison, hypotheses):
    """Squared misfits of the best honest value, noted in `usual`, and of the best mistake, and the row of this."""
    square = _square()
    first, end, alternatives = FIRST[hypotheses], FIRST[hypotheses + 1], GRAMS_OF[comparison]
    honest, best, mistake = math.inf, math.inf, first
    for alternative in range(alternatives):
        _reduce(memory, comparison, alternative, square)
        for row in range(first, end):
            if not HYPOTHESES[row, HYPOTHESIS.first] <= alternative < HYPOTHESES[row, HYPOTHESIS.end]:
                continue
            misfit = _misfit(square, row)
            if HYPOTHESES[row, HYPOTHESIS.label] > 0.0:
                if misfit < best:
                    best, mistake = misfit, row
            elif misfit < honest:
                honest, memory.usual[comparison] = misfit, (row - first) * alternatives + alternative
    return honest, best, mistake


@inlined
def judge(memory, comparison, hypotheses, factor, sure):
    """Compare all hypotheses; return 1 + the mistake that is now certain, or 0.

    hypotheses: the place of their table in `FIRST`; factor: on the evidence that is needed; sure: whether other
    measurements point to a mistake, so that `SURE` is enough.
    """
    overlap, alternatives, usual = RULES[comparison, RULE.overlap], GRAMS_OF[comparison], memory.usual[comparison]
    square = _square()
    _reduce(memory, comparison, usual % alternatives, square)
    least = SURE if sure else factor * LEAST_EVIDENCE[hypotheses]
    if _misfit(square, FIRST[hypotheses] + usual // alternatives) < least * overlap:  # no mistake can be better by it
        memory.repeated[comparison] = 0
        return memory.label[comparison]
    honest, best, mistake = _find_best(memory, comparison, hypotheses)
    label = whole(HYPOTHESES[mistake, HYPOTHESIS.label])
    sure = sure and label != 1 + MISTAKES.command_too_large
    enough = SURE if sure else factor * HYPOTHESES[mistake, HYPOTHESIS.evidence]
    better = (honest - best) / (overlap * max(1.0, best / memory.count[comparison]))
    memory.repeated[comparison] = memory.repeated[comparison] + 1 if better > enough else 0
    if memory.repeated[comparison] >= (1 if sure else LOOKS):
        memory.label[comparison] = label
    return memory.label[comparison]


@inlined
def honest_misfit(memory, comparison):
    """Squared misfit of the best honest value of a comparison without alternatives, per independent window."""
    square = _square()
    _reduce(memory, comparison, 0, square)
    return _misfit(square, FIRST[comparison] + memory.usual[comparison]) / RULES[comparison, RULE.overlap]


@inlined
def _least_misfit(memory, alternative, least, most, square):
    """The squared misfit of an alternative of the steering with the best gain from `least` to `most`."""
    _reduce(memory, COMPARED.steering, alternative, square)
    both = square[X1, X2] - square[X1, Y]
    gain = clip(-both / square[X1, X1], least, most) if square[X1, X1] > 0.0 else 1.0
    remainder = square[X2, X2] - 2.0 * square[X2, Y] + square[Y, Y]
    return gain * (gain * square[X1, X1] + 2.0 * both) + remainder


@inlined
def late_steering(memory, lag, latest):
    """Compare the delays of the steering up to `latest` (s) with longer ones; return the best longer one, 0: none.

    lag: s, that the models of the wheels add to the delays that are tried. A car that turns much less or more than
    its commands ask for has a different flaw, as has one that the longest delay explains best: it may not turn at all.
    """
    honest, late, delay, square = math.inf, math.inf, 0.0, _square()
    for alternative in range(THROWN):
        total = lag + DELAY * (alternative % DELAYS)
        if total <= latest:
            honest = min(honest, _least_misfit(memory, alternative, GAINS[0], GAINS[-1], square))
            continue
        misfit = _least_misfit(memory, alternative, LATE_GAINS[0], LATE_GAINS[1], square)
        if misfit < late:
            late, delay = misfit, total
    enough = EVIDENCE * RULES[COMPARED.steering, RULE.overlap]
    better = honest - late > enough * max(1.0, late / memory.count[COMPARED.steering])
    memory.late = memory.late + 1 if better and delay < lag + DELAY * (DELAYS - 1.5) else 0
    return delay if memory.late >= LOOKS else 0.0


@inlined
def compare(memory, comparison, x1, x2, x3, y, noise, time):
    """Add a window (s long) to a comparison without alternatives; return 1 + the mistake that is now certain, or 0."""
    left = start_window(memory, comparison, time)
    add_window(memory.grams[FIRST_GRAM[comparison]], left, 1.0 / noise, x1, x2, x3, y)
    return judge(memory, comparison, comparison, 1.0, False)

"""Positions against the yaw: the direction of motion, and mistakes of the frame."""

from __future__ import annotations

import math

import numpy as np

from ..controllers.contract import wrapped
from ..kernel import inlined
from .hypotheses import DEGREE
from .record import COMPARED, COURSES, MISTAKES, SUBJECTS, TICKS, T, say
from .regression import AGAIN, compare

GENTLE, ROUGH, STEEP = 2.5, 5.0, 6.0
"""m/s^2, lateral: of what says which point of the car is measured, of what says that frames differ, and by which the
course turns."""
MIRRORED = 4.0
"""Evidence that is needed where the course turns against the yaw: nothing honest looks like it."""
ASKEW, TURNED = 0.1, 0.3
"""rad: beside what sideslip explains, positions that move further beside the yaw are of another frame; that the yaw
must have changed before both are known to agree."""
_HALF_PI = 0.5 * math.pi
FRAMES = np.array([
    (DEGREE, 0.0), (-1.0, 0.0), (-1.0, _HALF_PI), (-DEGREE, _HALF_PI), (1.0, -_HALF_PI), (1.0, _HALF_PI),
    (1.0, math.pi),
])  # fmt: skip
"""What each mistake of the yaw, from `MISTAKES.yaw_in_degrees` on, makes the direction of motion: factor and angle."""


@inlined
def course_turns(own):
    """rad, by how much the direction of motion has changed lately."""
    count = own.course_count
    if count == 0:
        return 0.0
    oldest = (own.course + COURSES - count + 1) % COURSES
    return wrapped(own.courses[own.course, 0] - own.courses[oldest, 0])


@inlined
def explain_course(own):
    """Name what of yaw and positions is wrong, by what makes both agree."""
    mistake, least = MISTAKES.frames_differ, 0.25
    for k in range(FRAMES.shape[0]):
        most = 0.0
        for i in range(own.course_count):
            row = own.courses[i]
            most = max(most, abs(wrapped(row[0] - (FRAMES[k, 0] * row[1] + FRAMES[k, 1]))))
        if most < least:
            mistake, least = MISTAKES.yaw_in_degrees + k, most
    row = own.courses[own.course]
    say(own, SUBJECTS.course, mistake, wrapped(row[0] - row[1]) / DEGREE, 0.0, 0.0)


@inlined
def compare_course(aside, course, yaw, far, rate, own, settings):
    """The direction in which positions move against the yaw."""
    last = own.ticks[TICKS - 1]
    pull = abs(rate * last[T.speed])
    rolling = settings.lr * rate / last[T.speed]
    if math.isnan(own.origin):
        own.origin = yaw
    turned, gone = wrapped(yaw - own.origin), wrapped(course - own.origin)
    own.course = (own.course + 1) % COURSES
    own.course_count = min(own.course_count + 1, COURSES)
    own.courses[own.course, 0], own.courses[own.course, 1] = course, yaw
    if max(abs(turned), abs(gone)) < 1.5 and pull < STEEP:
        noise = 0.008 + 0.01 / far + 0.3 * abs(rolling) + 0.003 * pull
        if compare(own, COMPARED.course, turned, 0.0, 0.0, gone, noise, last[T.time], 4.0, 0.012, MIRRORED) > 0:
            explain_course(own)
    own.yaw_least, own.yaw_most = min(own.yaw_least, yaw), max(own.yaw_most, yaw)
    if abs(aside) < 0.2:
        own.agreed += 1
        if abs(turned) > TURNED:
            own.confirmed = 1
    beside = max(aside - max(rolling, 0.0), min(rolling, 0.0) - aside)
    known = own.agreed > (20 if own.yaw_most - own.yaw_least > TURNED else 60)
    usual = pull < ROUGH or own.agreed == 0
    askew = beside > ASKEW + 0.5 * abs(rolling) + 0.18 / far and usual and not known
    own.askew = own.askew + 1 if askew else 0
    if own.askew >= AGAIN:
        explain_course(own)

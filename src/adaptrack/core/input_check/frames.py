"""Positions against the yaw: the direction of motion, and mistakes of the frame."""

from __future__ import annotations

import math

import numpy as np

from ..controllers.contract import wrapped
from ..kernel import inlined
from .hypotheses import DEGREE
from .record import COMPARED, COURSES, MISTAKES, SUBJECTS, TICKS, T, report
from .regression import LOOKS, compare

GENTLE, ROUGH, STEEP = 2.5, 5.0, 6.0
"""m/s^2, lateral: of what says which point of the car is measured, of what says that frames differ, and by which the
course turns."""
ASKEW, TURNED = 0.1, 0.3
"""rad: beside what sideslip explains, positions that move further beside the yaw are of another frame; that the yaw
must have changed before both are known to agree."""
USUAL_NOISE = 0.03
"""m, of positions, for which the numbers below hold."""
_HALF_PI = 0.5 * math.pi
FRAMES = np.array([
    (DEGREE, 0.0), (-1.0, 0.0), (-1.0, _HALF_PI), (-DEGREE, _HALF_PI), (1.0, -_HALF_PI), (1.0, _HALF_PI),
    (1.0, math.pi),
])  # fmt: skip
"""What each mistake of the yaw, from `MISTAKES.yaw_in_degrees` on, makes the direction of motion: factor and angle."""


@inlined
def course_turns(memory):
    """rad, by how much the direction of motion has changed lately."""
    count = memory.course_count
    if count == 0:
        return 0.0
    oldest = (memory.course + COURSES - count + 1) % COURSES
    return wrapped(memory.courses[memory.course, 0] - memory.courses[oldest, 0])


@inlined
def explain_course(memory):
    """Name what of yaw and positions is wrong, by what makes both agree."""
    mistake, least = MISTAKES.frames_differ, 0.25
    for k in range(FRAMES.shape[0]):
        most = 0.0
        for i in range(memory.course_count):
            row = memory.courses[i]
            most = max(most, abs(wrapped(row[0] - (FRAMES[k, 0] * row[1] + FRAMES[k, 1]))))
        if most < least:
            mistake, least = MISTAKES.yaw_in_degrees + k, most
    row = memory.courses[memory.course]
    report(memory, SUBJECTS.course, mistake, wrapped(row[0] - row[1]) / DEGREE, 0.0, 0.0)


@inlined
def compare_course(aside, course, yaw, far, rate, memory, settings):
    """The direction in which positions move against the yaw."""
    last = memory.ticks[TICKS - 1]
    noises = max(settings.position_noise / USUAL_NOISE, 1.0)
    pull = abs(rate * last[T.speed])
    rolling = settings.lr * rate / last[T.speed]
    if math.isnan(memory.origin):
        memory.origin = yaw
    turned, gone = wrapped(yaw - memory.origin), wrapped(course - memory.origin)
    memory.course = (memory.course + 1) % COURSES
    memory.course_count = min(memory.course_count + 1, COURSES)
    memory.courses[memory.course, 0], memory.courses[memory.course, 1] = course, yaw
    if max(abs(turned), abs(gone)) < 1.5 and pull < STEEP:
        noise = 0.008 + 0.01 * noises / far + 0.3 * abs(rolling) + 0.003 * pull
        if compare(memory, COMPARED.course, turned, 0.0, 0.0, gone, noise, last[T.time]) > 0:
            explain_course(memory)
    memory.yaw_least, memory.yaw_most = min(memory.yaw_least, yaw), max(memory.yaw_most, yaw)
    if abs(aside) < 0.2:
        memory.agreed += 1
        if abs(turned) > TURNED:
            memory.confirmed = 1
    beside = max(aside - max(rolling, 0.0), min(rolling, 0.0) - aside)
    known = memory.agreed > (20 if memory.yaw_most - memory.yaw_least > TURNED else 60)
    usual = pull < ROUGH or memory.agreed == 0
    askew = beside > ASKEW + 0.5 * abs(rolling) + 0.18 * noises / far and usual and not known
    memory.askew = memory.askew + 1 if askew else 0
    if memory.askew >= LOOKS:
        explain_course(memory)

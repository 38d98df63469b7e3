"""What positions and speeds say of each other: the frame of the yaw, the point that is measured, the longitudinal
acceleration, and whether the car slides.
"""

from __future__ import annotations

import math

import numpy as np

from ..controllers.contract import wrapped
from ..kernel import inlined
from ..maths.exponential import hypot
from ..maths.trigonometric import atan2, sin
from .hypotheses import COMPARED, DEGREE, LOOKS, MISTAKES, MOTION_BITS, SUBJECTS, compare, honest_misfit
from .record import COURSES, POSITION, SLOW, TICK, TICKS, T, is_reported, report

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
    report(memory, mistake, wrapped(row[0] - row[1]) / DEGREE, 0.0, 0.0)


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


SLIDING, NOT_SLIDING, SKID = math.radians(8.5), math.radians(5.0), math.radians(4.5)
"""Sideslip from which the car slides, below which it no longer does, and of it what a rolling turn does not explain."""
RELEASE = 0.5
"""s, for which the sideslip must be small before the sliding is over."""


@inlined
def judge_sliding(memory, settings):
    """Whether the car slides, at a look."""
    last, middle, before = memory.ticks[TICKS - 1], memory.ticks[TICKS - 2], memory.ticks[TICKS - 3]
    unsure, looks = 0.0, 1
    if math.isfinite(last[T.vy]):
        memory.sideslip = atan2(last[T.vy], last[T.speed])
    else:
        east, north = last[T.x] - before[T.x], last[T.y] - before[T.y]
        way = hypot(east, north)
        known = way > 1.0 and memory.agreed > 10 and not is_reported(memory, SUBJECTS.course)
        unsure, looks = 1.5 * POSITION / max(way, 1e-3), 3  # a position that jumps is in two
        beside = wrapped(atan2(north, east) - (last[T.yaw] - 0.5 * (last[T.turned] + middle[T.turned])))
        memory.sideslip = beside - memory.mounting if known else math.nan
    measured = math.isfinite(last[T.yaw_rate])
    rate = last[T.yaw_rate] if measured else last[T.turned] / max(last[T.time], TICK)
    rolling = settings.lr * rate / last[T.speed]
    slip = abs(memory.sideslip) - unsure
    memory.skid = abs(memory.sideslip - rolling) - unsure
    if slip > SLIDING and memory.skid > SKID:
        memory.slips += 1
        memory.calm = 0.0
        if memory.slips >= looks:
            memory.sliding = 1
        return
    memory.slips = 0
    if memory.sliding > 0:
        memory.calm = 0.0 if slip > NOT_SLIDING else memory.calm + last[T.time]
        memory.sliding = 1 if memory.calm < RELEASE else 0


SMOOTHING = 2.5
"""s, time constant behind which both are compared."""
LOOK_SIGMA, LOOK_SIGMA_SHARE, DIFFERENCE_SIGMA = 0.03, 0.01, 0.1
"""m/s, -, m/s^2: standard deviations of the mean speed of a look, absolute and over the speed, and of a difference."""
GRAVITY_EVIDENCE = 8.0
"""Squared misfit of every honest value from which the signal contains gravity."""


@inlined
def compare_forward(memory):
    """Compare longitudinal acceleration and speed at a look, both filtered alike."""
    last, is_wrong = memory.ticks[TICKS - 1], is_reported(memory, SUBJECTS.speed)
    if last[T.speed] < SLOW or memory.tick_count < 3 or is_wrong or not math.isfinite(last[T.forward]):
        memory.slow_speed, memory.slow_acceleration = last[T.speed], 0.0
        return
    share = last[T.time] / (SMOOTHING + last[T.time])
    memory.slow_speed += share * (last[T.speed] - memory.slow_speed)
    memory.slow_acceleration += share * (last[T.forward] - memory.slow_acceleration)
    change = (last[T.speed] - memory.slow_speed) / SMOOTHING
    difference = memory.slow_acceleration - change
    noise = DIFFERENCE_SIGMA + (LOOK_SIGMA + LOOK_SIGMA_SHARE * last[T.speed]) / SMOOTHING
    label = compare(memory, COMPARED.forward, change, 0.0, 0.0, difference, noise, last[T.time])
    if label == 0 and honest_misfit(memory, COMPARED.forward) > GRAVITY_EVIDENCE:
        label = memory.label[COMPARED.forward] = 1 + MISTAKES.longitudinal_acceleration_with_gravity
    if label > 0:
        report(memory, label - 1, memory.slow_acceleration, change, 0.0)


@inlined
def compare_sideways(aside, far, time, rate, sideways_speed, memory, settings):
    """Compare how positions moved sideways in a window of a time (s): over a way (m), in a direction off the yaw (rad).

    rate: rad/s, of the car; sideways_speed: m/s, mean v_y, NaN where it is not known.
    """
    speed = far / time
    last = memory.ticks[TICKS - 1]
    if abs(rate) < 0.02 and abs(aside) < 0.1:
        memory.straight += 1
        memory.mounting += (aside - memory.mounting) / min(memory.straight, 100)
    wrong = memory.suspect & MOTION_BITS != 0
    if settings.known == 0.0 or memory.straight < 10 or wrong or not abs(rate * speed) < GENTLE or memory.sliding > 0:
        return
    sideways = speed * sin(aside - memory.mounting)
    noise = hypot(POSITION / time, 0.004 * speed)
    to_rear, to_front = settings.lr * rate, settings.lf * rate
    if math.isfinite(sideways_speed):
        label = compare(memory, COMPARED.lateral, sideways_speed, to_rear, to_front, sideways, noise, last[T.time])
    else:
        slip = -settings.slip * rate * speed * speed
        label = compare(memory, COMPARED.point, to_rear, to_front, slip, sideways, noise, last[T.time])
    if label > 0:
        report(memory, label - 1, settings.lr, settings.lf, 0.0)

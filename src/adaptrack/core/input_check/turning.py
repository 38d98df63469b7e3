"""Yaw, yaw rate, lateral acceleration, and what the steering does, against each other."""

from __future__ import annotations

import math

from ..controllers.contract import wrapped
from ..kernel import inlined
from ..maths.exact import clip
from .clocks import YAW
from .frames import ROUGH, course_turns, explain_course
from .hypotheses import DEGREE, UNKNOWN_STEERING
from .record import COMPARED, DELAY, DELAYS, INTEGRAL, MISTAKES, SUBJECTS, TICKS, T, named, say
from .regression import AGAIN, BANKS, EVIDENCE, add_delayed, begin_delayed, compare, compare_delayed
from .requests import back_to, left_of_beginning, requested

SOON, THROWN = 18.0, 18.0
"""Evidence of mistakes that nothing honest looks like, and of wheels that are thrown about."""
STEADY = 0.6
"""m/s^2 in a look, by which speed times yaw rate may change where it is compared with the lateral acceleration: a car
that is swung to and fro moves sideways as well."""
WHEEL, STEERING = 0, 1
"""Places of the comparisons with a delay."""


@inlined
def compare_turn(turned, rates, first, time, own):
    """The change of yaw against the yaw rate; first: the look with which the window begins."""
    last, before = own.ticks[TICKS - 1], own.ticks[TICKS - 2]
    change = last[T.yaw_rate] - own.ticks[first + 1, T.yaw_rate]
    noise = YAW + 0.003 * time
    label = compare(own, COMPARED.turn, rates, change, 0.0, turned, noise, last[T.time], 4.0, 0.0, EVIDENCE)
    rolled = last[T.yaw_rate] * last[T.time]
    in_degrees = wrapped(DEGREE * (last[T.yaw] - before[T.yaw]))
    gross = abs(last[T.turned] - rolled) > 0.1 and abs(in_degrees - rolled) < 0.03
    own.degrees = own.degrees + 1 if gross else 0
    if own.degrees > AGAIN:
        label = 1 + MISTAKES.yaw_in_degrees_by_its_rate
    if label == 0:
        return
    if label == 1 + MISTAKES.yaw_in_degrees_by_its_rate and own.confirmed > 0:
        label = 1 + MISTAKES.yaw_rate_taken_for_degrees
    if label == 1 + MISTAKES.yaw_late:
        say(own, SUBJECTS.yaw_late, MISTAKES.yaw_late, 0.0, 0.0, 0.0)
    elif label == 1 + MISTAKES.yaw_in_degrees_by_its_rate:
        say(own, SUBJECTS.course, MISTAKES.yaw_in_degrees_by_its_rate, 0.0, 0.0, 0.0)
    elif label == 1 + MISTAKES.yaw_rate_sign and course_turns(own) * turned < 0.0:
        explain_course(own)
    else:
        say(own, SUBJECTS.yaw_rate, label - 1, turned, rates, 0.0)


@inlined
def compare_pull(own):
    """Lateral acceleration against speed times yaw rate."""
    last, before = own.ticks[TICKS - 1], own.ticks[TICKS - 2]
    turning, pull = last[T.speed] * last[T.yaw_rate], last[T.pull]
    steady = abs(turning - last[T.speed] * before[T.yaw_rate]) < STEADY
    calm = steady and abs(turning) < ROUGH and own.sliding == 0  # a car that spins turns without it
    if math.isfinite(pull) and calm and not named(own, SUBJECTS.yaw_rate):
        enough = 5.0 * EVIDENCE
        label = compare(own, COMPARED.pull, turning, 0.0, 0.0, pull, 0.4, last[T.time], 2.0, 0.5, enough)
        if label > 0:
            say(own, SUBJECTS.pull, label - 1, pull, turning, 0.0)


@inlined
def _take(compared, place, y, noise, span, own):
    """Take a window of the wheels or of the turning into its comparison; whether all requests are against it."""
    last, before = own.ticks[TICKS - 1], own.ticks[TICKS - 3]
    sums, weight, against, end, start = own.delayed[place], 1.0 / (noise * noise), True, 0, 0
    left = begin_delayed(own, compared, sums, y, weight, last[T.time])
    for i in range(DELAYS):
        delay = DELAY * i
        share = left_of_beginning(last[T.t] - 0.5 * span - delay, own)
        end, start = back_to(last[T.t] - delay, end, own), back_to(before[T.t] - delay, start, own)
        mean = begun = 0.0
        for k in range(BANKS - 1, -1, -1):
            which = (INTEGRAL.angle if place == WHEEL else INTEGRAL.turning) + k
            mean = (
                requested(last[T.t] - delay, end, which, own) - requested(before[T.t] - delay, start, which, own)
            ) / span
            held = share if k == 0 else clip((own.begun_at + delay - before[T.t]) / span, 0.0, 1.0)
            begun = held * own.begun_with[1 if place == WHEEL else 0]
            add_delayed(sums, k * DELAYS + i, left, mean, begun, share, y, weight)
        against = against and (mean + begun) * y < 0.0
    return against


@inlined
def compare_steering(turned, rates, aside, own, settings):
    """The turning of the car, and its wheels, against the commands of some time ago."""
    last, middle, before = own.ticks[TICKS - 1], own.ticks[TICKS - 2], own.ticks[TICKS - 3]
    span = last[T.t] - before[T.t]
    wrong = named(own, SUBJECTS.course) or named(own, SUBJECTS.yaw_rate) or named(own, SUBJECTS.speed)
    if wrong or own.request_count < 3 or own.sliding > 0:
        return
    if math.isfinite(last[T.wheel]):
        wheel = (last[T.wheel] * last[T.time] + middle[T.wheel] * middle[T.time]) / span
        _take(COMPARED.wheel, WHEEL, wheel, 0.004, span, own)
        label = compare_delayed(
            own, COMPARED.wheel, COMPARED.wheel, own.delayed[WHEEL], 0.02, 0.05, EVIDENCE, EVIDENCE, EVIDENCE, False
        )
        if label > MISTAKES.steering_sign:
            say(own, SUBJECTS.steering, label - 1, 0.0, 0.0, 0.0)
        elif label > 0:
            say(own, SUBJECTS.wheel, label - 1, wheel, own.command, 0.0)
    rate = (last[T.yaw_rate] * last[T.time] + middle[T.yaw_rate] * middle[T.time]) / span
    if not math.isfinite(rate):
        rate = (last[T.turned] + middle[T.turned]) / span
    apart, most = abs(turned - rates), max(abs(turned), abs(rates))
    if not math.isfinite(rate) or apart > 0.015 + 0.3 * most or abs(aside) > 0.14:
        return
    against = _take(COMPARED.steering, STEERING, rate, 0.012 + 0.05 * abs(rate), span, own)
    sure = against and abs(rate) > 0.05 and not apart > 0.4 * most
    hypotheses = COMPARED.steering if settings.known > 0.0 else UNKNOWN_STEERING
    more = 3.0 if math.isfinite(last[T.wheel]) else 1.0  # wheels that are measured say it themselves
    label = compare_delayed(
        own,
        COMPARED.steering,
        hypotheses,
        own.delayed[STEERING],
        0.06,
        0.15,
        1.3 * EVIDENCE,
        more * SOON,
        more * THROWN,
        sure,
    )
    if label > 0:
        say(own, SUBJECTS.steering, label - 1, 0.0, 0.0, 0.0)
        if label == 1 + MISTAKES.steering_sign:
            own.against_steering = 1

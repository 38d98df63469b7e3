"""Yaw, yaw rate, lateral acceleration, and what the steering does, against each other."""

from __future__ import annotations

import math

from ..controllers.contract import wrapped
from ..kernel import inlined, local
from ..maths.exact import clip
from .hypotheses import (
    BANKS,
    COMPARED,
    DEGREE,
    DELAY,
    DELAYS,
    FIRST_GRAM,
    LOOKS,
    MISTAKES,
    MOTION_BITS,
    SHIFT,
    SHIFTS,
    SUBJECTS,
    UNKNOWN_STEERING,
    add_window,
    compare,
    judge,
    late_steering,
    start_window,
)
from .motion import ROUGH, SKID, course_turns, explain_course
from .record import INTEGRAL, TICKS, WINDOW, T, is_reported, report
from .requests import LAG, back_to, command_range, left_of_beginning, requested

YAW_NOISE = 0.005
"""rad, noise of a difference of two samples."""
STEADY = 0.6
"""m/s^2 in a look, by which speed times yaw rate may change where it is compared with the lateral acceleration: a car
that is swung to and fro moves sideways as well."""
REACTION, KINEMATIC, GRIP = 1.0, 12.0, 3.5
"""s, in which the wheels follow a command; m/s, up to which the car turns as its wheels stand, and m/s^2, up to which
it must."""
LEAST_GAIN, MOST_GAIN, SOFTNESS, OFFSET = 0.65, 1.6, 0.006, 0.03
"""Turning over that of the kinematic model: least, at rest, and most; s^2/m^2 m, by which understeer lowers the least;
rad, offset of the wheels."""
LATEST = 0.15
"""s, by which the yaw rate of a car may follow its wheels, so much later than the specified delay."""
_integrals = local(TICKS, 2)


@inlined
def compare_turn(turned, rates, first, time, memory):
    """The change of yaw against the yaw rate; first: the look with which the window begins."""
    last, before = memory.ticks[TICKS - 1], memory.ticks[TICKS - 2]
    change = last[T.yaw_rate] - memory.ticks[first + 1, T.yaw_rate]
    noise = YAW_NOISE + 0.003 * time
    label = compare(memory, COMPARED.turn, rates, change, 0.0, turned, noise, last[T.time])
    rolled = last[T.yaw_rate] * last[T.time]
    in_degrees = wrapped(DEGREE * (last[T.yaw] - before[T.yaw]))
    gross = abs(last[T.turned] - rolled) > 0.1 and abs(in_degrees - rolled) < 0.03
    memory.degrees = memory.degrees + 1 if gross else 0
    if memory.degrees > LOOKS:
        label = 1 + MISTAKES.yaw_in_degrees_by_its_rate
    if label == 0:
        return
    if label == 1 + MISTAKES.yaw_in_degrees_by_its_rate and memory.confirmed > 0:
        label = 1 + MISTAKES.yaw_rate_taken_for_degrees
    if label == 1 + MISTAKES.yaw_rate_sign and course_turns(memory) * turned < 0.0:
        explain_course(memory)
    else:
        report(memory, label - 1, turned, rates, 0.0)


@inlined
def compare_pull(memory):
    """Lateral acceleration against speed times yaw rate."""
    last, before = memory.ticks[TICKS - 1], memory.ticks[TICKS - 2]
    turning, pull = last[T.speed] * last[T.yaw_rate], last[T.pull]
    steady = abs(turning - last[T.speed] * before[T.yaw_rate]) < STEADY
    calm = steady and abs(turning) < ROUGH and memory.sliding == 0  # a car that spins turns without it
    if math.isfinite(pull) and calm and not is_reported(memory, SUBJECTS.yaw_rate):
        label = compare(memory, COMPARED.pull, turning, 0.0, 0.0, pull, 0.4, last[T.time])
        if label > 0:
            report(memory, label - 1, pull, turning, 0.0)


# -- clocks -----------------------------------------------------------------------------------------------------------
@inlined
def _interpolate(t, which, integrals, memory):
    """An integral at a time (s), a straight line between two looks."""
    i = TICKS - 2
    while i > 0 and memory.ticks[i, T.t] > t:
        i -= 1
    start, end = memory.ticks[i, T.t], memory.ticks[i + 1, T.t]
    return integrals[i, which] + (t - start) / (end - start) * (integrals[i + 1, which] - integrals[i, which])


@inlined
def compare_clocks(memory):
    """Compare the change of the yaw with the integral of the yaw rate of some time before or after."""
    if memory.tick_count < TICKS:
        return
    integrals = _integrals()
    for i in range(1, TICKS):
        row = memory.ticks[i]
        integrals[i, 0] = integrals[i - 1, 0] + row[T.turned]
        integrals[i, 1] = integrals[i - 1, 1] + row[T.yaw_rate] * row[T.time]
    start, end = memory.ticks[TICKS - 1 - WINDOW, T.t], memory.ticks[TICKS - 1, T.t]
    measured = math.isfinite(integrals[TICKS - 1, 0] + integrals[TICKS - 1, 1])
    if not measured or start - memory.ticks[0, T.t] < SHIFTS // 2 * SHIFT:
        return
    left = start_window(memory, COMPARED.clock, memory.ticks[TICKS - 1, T.time])
    for k in range(SHIFTS):
        late = SHIFT * (k - SHIFTS // 2)  # of the yaw rate
        of_yaw, of_rate = max(late, 0.0), max(-late, 0.0)
        y = _interpolate(end - of_yaw, 0, integrals, memory) - _interpolate(start - of_yaw, 0, integrals, memory)
        x = _interpolate(end - of_rate, 1, integrals, memory) - _interpolate(start - of_rate, 1, integrals, memory)
        add_window(memory.grams[FIRST_GRAM[COMPARED.clock] + k], left, 1.0 / YAW_NOISE, x, 0.0, 0.0, y)
    if judge(memory, COMPARED.clock, COMPARED.clock, 1.0, False) > 0:
        memory.label[COMPARED.turn] = 1 + MISTAKES.yaw_late
        report(memory, MISTAKES.yaw_late, 0.0, 0.0, 0.0)


# -- steering ---------------------------------------------------------------------------------------------------------
@inlined
def _add_delayed(memory, comparison, y, noise, span):
    """Add a window to a comparison with the commands, at all delays; return whether all requests are against y."""
    last, before = memory.ticks[TICKS - 1], memory.ticks[TICKS - 3]
    of_wheel = comparison == COMPARED.wheel
    integral, begun_with = INTEGRAL.angle if of_wheel else INTEGRAL.turning, memory.begun_with[1 if of_wheel else 0]
    left, against, end, start = start_window(memory, comparison, last[T.time]), True, 0, 0
    for i in range(DELAYS):
        delay = DELAY * i
        share = left_of_beginning(last[T.t] - 0.5 * span - delay, memory)
        until_then = clip((memory.begun_at + delay - before[T.t]) / span, 0.0, 1.0)
        end, start = back_to(last[T.t] - delay, end, memory), back_to(before[T.t] - delay, start, memory)
        for bank in range(BANKS):
            after = requested(last[T.t] - delay, end, integral + bank, memory)
            mean = (after - requested(before[T.t] - delay, start, integral + bank, memory)) / span
            begun = (share if bank == 0 else until_then) * begun_with
            gram = memory.grams[FIRST_GRAM[comparison] + bank * DELAYS + i]
            add_window(gram, left, 1.0 / noise, mean, begun, share, y)
            against = against and (bank > 0 or (mean + begun) * y < 0.0)
    return against


@inlined
def _compare_wheels(last, middle, span, memory):
    """Compare the wheels with the commands."""
    wheel = (last[T.wheel] * last[T.time] + middle[T.wheel] * middle[T.time]) / span
    _add_delayed(memory, COMPARED.wheel, wheel, 0.004, span)
    label = judge(memory, COMPARED.wheel, COMPARED.wheel, 1.0, False)
    if label > 0:
        report(memory, label - 1, wheel, memory.command, 0.0)


@inlined
def _compare_range(rate, last, memory, settings):
    """Report a car that turns much more or less than every command of the last second asks for, at low speed."""
    speed = last[T.speed]
    if settings.known == 0.0 or speed > KINEMATIC:
        return
    least, most = command_range(last[T.t] - REACTION, memory)
    gain = speed / settings.length
    low = LEAST_GAIN / (1.0 + SOFTNESS * speed * speed / settings.length)
    offset, grip = OFFSET * gain, GRIP / speed
    rolls = not memory.skid > SKID  # a car that slides may turn as fast as it likes
    too_large = rolls and (
        (most > 0.0 and rate > MOST_GAIN * gain * most + offset)
        or (least < 0.0 and rate < MOST_GAIN * gain * least - offset)
    )
    too_small = (least > 0.0 and -offset < rate < min(low * gain * least, grip) - offset) or (
        most < 0.0 and max(low * gain * most, -grip) + offset < rate < offset
    )
    memory.beyond = memory.beyond + 1 if too_large or too_small else 0
    if memory.beyond >= LOOKS:
        mistake = MISTAKES.command_too_large if too_large else MISTAKES.command_too_small
        report(memory, mistake, 0.0, 0.0, 0.0)


@inlined
def compare_steering(turned, rates, aside, memory, settings):
    """Compare the turning of the car, and its wheels, with the commands of some time ago."""
    last, middle, before = memory.ticks[TICKS - 1], memory.ticks[TICKS - 2], memory.ticks[TICKS - 3]
    span = last[T.t] - before[T.t]
    if memory.suspect & MOTION_BITS != 0 or memory.request_count < 3 or memory.sliding > 0:
        return
    has_wheel = math.isfinite(last[T.wheel])
    if has_wheel:
        _compare_wheels(last, middle, span, memory)
    rate = (last[T.yaw_rate] * last[T.time] + middle[T.yaw_rate] * middle[T.time]) / span
    if not math.isfinite(rate):
        rate = (last[T.turned] + middle[T.turned]) / span
    apart, most = abs(turned - rates), max(abs(turned), abs(rates))
    if not math.isfinite(rate) or apart > 0.015 + 0.3 * most or abs(aside) > 0.14:
        return
    _compare_range(rate, last, memory, settings)
    against = _add_delayed(memory, COMPARED.steering, rate, 0.012 + 0.05 * abs(rate), span)
    sure = against and abs(rate) > 0.05 and not apart > 0.4 * most
    hypotheses = COMPARED.steering if settings.known > 0.0 else UNKNOWN_STEERING
    label = judge(memory, COMPARED.steering, hypotheses, 3.0 if has_wheel else 1.0, sure)  # wheels that are measured
    is_skid = label == 1 + MISTAKES.command_too_large and memory.skid > SKID
    if label > 0 and not is_skid:  # show it themselves
        report(memory, label - 1, 0.0, 0.0, 0.0)
        if label == 1 + MISTAKES.steering_sign:
            memory.against_steering = 1
    elif label == 0 and settings.known > 0.0 and settings.delay < math.inf:
        delay = late_steering(memory, LAG, settings.delay + LATEST)
        if delay > 0.0:
            report(memory, MISTAKES.steering_late, delay, settings.delay, 0.0)

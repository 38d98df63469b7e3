"""The check of a loop's inputs, sample by sample.

What a loop measures is redundant: positions move along the yaw by the speed, the yaw changes by the yaw rate, the car
turns as its steering asks. Each such relation is a linear regression on windows of half a second; of its parameters
some are honest (1, a little beside it), some are known mistakes (-1, 57.3, 1/3.6, 0.2 s), see `hypotheses`.
"""

from __future__ import annotations

import math

from ..controllers.contract import wrapped
from ..kernel import Place, exported, float64, inlined, int64, vector, void
from ..maths.exponential import hypot
from ..maths.trigonometric import atan2
from .clocks import compare_clocks
from .frames import compare_course
from .place import compare_sideways
from .record import (
    COMPARED,
    LONGEST,
    MISTAKES,
    POSITION,
    SAMPLE,
    SLOW,
    SUBJECTS,
    TICK,
    TICKS,
    WINDOW,
    Check,
    T,
    memory_of,
    named,
    say,
    settings_of,
)
from .regression import AGAIN, EVIDENCE, compare
from .requests import go_on
from .sliding import judge_sliding
from .turning import compare_pull, compare_steering, compare_turn


@exported(void(Place(Check)))
def begin_check(check):
    """Forget all."""
    check.memory[:] = 0.0
    own = memory_of(check.memory, 0)
    own.now = own.t = own.tick = -math.inf
    own.origin = own.pose[0] = own.sideslip = math.nan
    own.yaw_least, own.yaw_most, own.course = math.inf, -math.inf, -1


# -- time -------------------------------------------------------------------------------------------------------------
@inlined
def _check_clock(sample, own, settings):
    """Steps between calls that are 1000 times too long for the way that the car has made."""
    step, speed = sample[SAMPLE.now] - own.now, sample[SAMPLE.speed]
    if math.isfinite(step) and step > 2.0 and abs(speed) > 1.0:
        way = hypot(sample[SAMPLE.x] - own.pose[0], sample[SAMPLE.y] - own.pose[1])
        wrong = step > (40.0 * settings.period if math.isfinite(settings.period) else 4.0)
        own.steps = own.steps + 1 if wrong and way < 0.02 * abs(speed) * step else 0
        if own.steps >= AGAIN:
            unit = MISTAKES.time_in_nanoseconds
            if step < 2e7:
                unit = MISTAKES.time_in_milliseconds if step < 2e4 else MISTAKES.time_in_microseconds
            say(own, SUBJECTS.time, unit, step, way, speed)
    elif step > 0.0:
        own.steps = 0
    if abs(speed) > 100.0:
        say(own, SUBJECTS.speed, MISTAKES.speed_of_no_car, speed, 0.0, 0.0)


# -- samples ----------------------------------------------------------------------------------------------------------
@inlined
def _begin_sums(t, own):
    own.summed, own.tick = 0.0, t
    for i in range(5):
        own.sums[i] = 0.0


@inlined
def _take(sample, own):
    """Take a sample in; whether it is time to look."""
    t = sample[SAMPLE.t]
    step, own.t = t - own.t, t
    goes_on = step < LONGEST
    for i in range(5):
        value = sample[SAMPLE.speed + i]
        if goes_on:
            own.sums[i] += 0.5 * (own.last[i] + value) * step
        own.last[i] = value
    if not goes_on:
        _begin_sums(t, own)
        own.tick_count = 1
        _write_tick(sample, math.nan, math.nan, own)
        own.ticks[TICKS - 1, T.speed] = sample[SAMPLE.speed]
        return False
    own.summed += step
    if t < own.tick + TICK:
        return False
    last = own.ticks[TICKS - 1]
    turned = wrapped(sample[SAMPLE.yaw] - last[T.yaw])
    way = own.sums[0]
    jumped = hypot(sample[SAMPLE.x] - last[T.x], sample[SAMPLE.y] - last[T.y]) > 2.5 * abs(way) + 0.5
    if jumped and own.jumped == 0:  # one that stays is a matter of units
        own.tick_count = 0
    own.jumped = 1 if jumped else 0
    own.tick_count = min(own.tick_count + 1, TICKS)
    for i in range(TICKS - 1):
        for j in range(len(T)):
            own.ticks[i, j] = own.ticks[i + 1, j]
    _write_tick(sample, turned, way, own)
    _begin_sums(t, own)
    return own.tick_count > 3


@inlined
def _write_tick(sample, turned, way, own):
    """Write the last look, with means since the one before; of a first one they are not known."""
    row, mean = own.ticks[TICKS - 1], 1.0 / own.summed if own.summed > 0.0 else math.nan
    row[T.t], row[T.time], row[T.turned], row[T.way] = sample[SAMPLE.t], own.summed, turned, way
    row[T.x], row[T.y], row[T.yaw] = sample[SAMPLE.x], sample[SAMPLE.y], sample[SAMPLE.yaw]
    row[T.speed] = own.sums[0] * mean
    for i in range(4):
        row[T.yaw_rate + i] = own.sums[1 + i] * mean


@inlined
def _look(own, settings):
    """Compare what there is."""
    count = min(WINDOW, own.tick_count - 1)
    start = TICKS - 1 - count
    first, last = own.ticks[start], own.ticks[TICKS - 1]
    time = last[T.t] - first[T.t]
    if time > LONGEST or last[T.speed] < SLOW:
        if last[T.speed] < SLOW:
            own.sliding = 0
        return
    turned = rates = way = sideways = mean_turn = 0.0
    for i in range(start + 1, TICKS):
        row = own.ticks[i]
        mean_turn += turned + 0.5 * row[T.turned]
        turned += row[T.turned]
        rates += row[T.yaw_rate] * row[T.time]
        way += row[T.way]
        sideways += row[T.vy] * row[T.time]
    east, north = last[T.x] - first[T.x], last[T.y] - first[T.y]
    far, course = hypot(east, north), atan2(north, east)
    yaw = first[T.yaw] + mean_turn / count
    aside = wrapped(course - yaw)
    rate = (rates if math.isfinite(rates) else turned) / time
    posed = math.isfinite(aside) and far > 1.0
    if posed:
        if abs(aside) < 0.3 or own.agreed == 0:
            _compare_way(far, way, last[T.speed] - first[T.speed], last[T.time], own)
        compare_course(aside, course, yaw, far, rate, own, settings)
    if math.isfinite(turned + rates) and not (posed and own.askew > 0):
        compare_turn(turned, rates, start, time, own)
        compare_clocks(own)
    if posed:
        compare_sideways(aside, far, time, rate, sideways / time, own, settings)
    compare_pull(own)
    compare_steering(turned, rates, aside, own, settings)
    judge_sliding(own, settings)


@inlined
def _compare_way(far, way, change, time, own):
    """The way that positions made against that of the speed."""
    label = compare(own, COMPARED.way, way, change, 0.0, far, POSITION, time, 4.0, 0.0, EVIDENCE)
    if label == 1 + MISTAKES.speed_late:
        say(own, SUBJECTS.speed_late, MISTAKES.speed_late, 0.0, 0.0, 0.0)
    elif label > 0:
        say(own, SUBJECTS.speed, label - 1, far / max(way, 1e-9), 0.0, 0.0)


# -- calls ------------------------------------------------------------------------------------------------------------
@exported(int64(vector, float64, Place(Check)))
def check_call(sample, command, check):
    """Take in a call, `SAMPLE`; the bits of the mistakes named so far. command: rad, in force from now on."""
    own, settings = memory_of(check.memory, 0), settings_of(check.settings, 0)
    t, now, speed = sample[SAMPLE.t], sample[SAMPLE.now], sample[SAMPLE.speed]
    if now < own.now - LONGEST:  # the clock was set back
        own.t = -math.inf
    _check_clock(sample, own, settings)
    if math.isfinite(speed):
        next_command = command if math.isfinite(command) else 0.0
        go_on(now, speed, sample[SAMPLE.yaw_rate], sample[SAMPLE.wheel_angle], next_command, own, settings)
    same = True
    for i in range(3):
        same = same and sample[SAMPLE.x + i] == own.pose[i]
        own.pose[i] = sample[SAMPLE.x + i]
    own.now = now
    moved = not same or speed < SLOW
    if t > own.t and math.isfinite(t + speed) and moved and not named(own, SUBJECTS.time) and _take(sample, own):
        _look(own, settings)
    return own.suspect

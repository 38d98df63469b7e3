"""The check of a loop's inputs, sample by sample.

The signals of a loop are redundant: positions move along the yaw by the speed, the yaw changes by the yaw rate, the car
turns as its steering asks, the speed changes by the longitudinal acceleration. Each such relation is a linear
regression on windows of half a second. Some parameters are honest (1 and close to it), others are those of a mistake
(-1, 57.3, 1/3.6, 0.2 s), see `hypotheses`.
"""

from __future__ import annotations

import math

from ..controllers.contract import wrapped
from ..kernel import Place, exported, float64, inlined, int64, vector, void
from ..maths.exponential import hypot
from ..maths.trigonometric import atan2
from .hypotheses import COMPARED, LOOKS, MISTAKES, SUBJECTS, compare
from .motion import compare_course, compare_forward, compare_sideways, judge_sliding
from .pose import begin_pose, compare_pose
from .record import (
    CRAWLING,
    FEWEST,
    LONGEST,
    POSITION,
    SAMPLE,
    SLOW,
    SUMMED,
    TICK,
    TICKS,
    WINDOW,
    Check,
    T,
    is_reported,
    memory_of,
    report,
    settings_of,
)
from .requests import advance_requests
from .turning import compare_clocks, compare_pull, compare_steering, compare_turn


@exported(void(Place(Check)))
def begin_check(check):
    """Forget everything."""
    check.memory[:] = 0.0
    memory = memory_of(check.memory, 0)
    memory.now = memory.t = memory.tick = -math.inf
    memory.origin = memory.pose[0] = memory.sideslip = memory.skid = math.nan
    begin_pose(memory)
    memory.yaw_least, memory.yaw_most, memory.course = math.inf, -math.inf, -1


# -- time -------------------------------------------------------------------------------------------------------------
@inlined
def _check_clock(sample, memory, settings):
    """Steps between calls that are 1000 times too long for the way that the car has made."""
    step, speed = sample[SAMPLE.now] - memory.now, sample[SAMPLE.speed]
    if math.isfinite(step) and step > 2.0 and abs(speed) > 1.0:
        way = hypot(sample[SAMPLE.x] - memory.pose[0], sample[SAMPLE.y] - memory.pose[1])
        wrong = step > (40.0 * settings.period if math.isfinite(settings.period) else 4.0)
        memory.steps = memory.steps + 1 if wrong and way < 0.02 * abs(speed) * step else 0
        if memory.steps >= LOOKS:
            unit = MISTAKES.time_in_nanoseconds
            if step < 2e7:
                unit = MISTAKES.time_in_milliseconds if step < 2e4 else MISTAKES.time_in_microseconds
            report(memory, unit, step, way, speed)
    elif step > 0.0:
        memory.steps = 0
    if abs(speed) > 100.0:
        report(memory, MISTAKES.speed_of_no_car, speed, 0.0, 0.0)


# -- samples ----------------------------------------------------------------------------------------------------------
@inlined
def _begin_sums(t, memory):
    memory.summed, memory.tick = 0.0, t
    memory.sums[:] = 0.0


@inlined
def _take(sample, memory):
    """Take in a sample; return whether a look is complete."""
    t = sample[SAMPLE.t]
    step, memory.t = t - memory.t, t
    goes_on = step < LONGEST
    for i in range(SUMMED):
        value = sample[SAMPLE.speed + i]
        if goes_on:
            memory.sums[i] += 0.5 * (memory.last[i] + value) * step
        memory.last[i] = value
    if not goes_on:
        _begin_sums(t, memory)
        memory.tick_count = 1
        _write_tick(sample, math.nan, math.nan, memory)
        memory.ticks[TICKS - 1, T.speed] = sample[SAMPLE.speed]
        begin_pose(memory)
        return False
    memory.summed += step
    if t < memory.tick + TICK:
        return False
    last = memory.ticks[TICKS - 1]
    turned = wrapped(sample[SAMPLE.yaw] - last[T.yaw])
    way = memory.sums[0]
    jumped = hypot(sample[SAMPLE.x] - last[T.x], sample[SAMPLE.y] - last[T.y]) > 2.5 * abs(way) + 0.5
    if jumped and memory.jumped == 0:  # one that stays is a matter of units
        memory.tick_count = 0
    memory.jumped = 1 if jumped else 0
    memory.tick_count = min(memory.tick_count + 1, TICKS)
    for i in range(TICKS - 1):
        memory.ticks[i, :] = memory.ticks[i + 1]
    _write_tick(sample, turned, way, memory)
    _begin_sums(t, memory)
    return True


@inlined
def _write_tick(sample, turned, way, memory):
    """Write the last look, with means since the one before; of a first one they are not known."""
    row, mean = memory.ticks[TICKS - 1], 1.0 / memory.summed if memory.summed > 0.0 else math.nan
    row[T.t], row[T.time], row[T.turned], row[T.way] = sample[SAMPLE.t], memory.summed, turned, way
    row[T.x], row[T.y], row[T.yaw] = sample[SAMPLE.x], sample[SAMPLE.y], sample[SAMPLE.yaw]
    row[T.speed] = memory.sums[0] * mean
    for i in range(SUMMED - 1):
        row[T.yaw_rate + i] = memory.sums[1 + i] * mean


@inlined
def _look(memory, settings):
    """Compare the signals of the last looks."""
    start = TICKS - 1 - min(WINDOW, memory.tick_count - 1)
    last = memory.ticks[TICKS - 1]
    if last[T.speed] < SLOW:
        memory.sliding, memory.skid = 0, math.nan
    compare_forward(memory)
    if last[T.speed] < CRAWLING:
        begin_pose(memory)
        return
    compare_pose(memory, settings)
    if memory.tick_count < FEWEST or last[T.t] - memory.ticks[start, T.t] > LONGEST:
        return
    turned = rates = 0.0
    for i in range(start + 1, TICKS):
        turned += memory.ticks[i, T.turned]
        rates += memory.ticks[i, T.yaw_rate] * memory.ticks[i, T.time]
    if last[T.speed] < SLOW:
        compare_steering(turned, rates, 0.0, memory, settings)
        return
    aside = _compare_positions(start, rates if math.isfinite(rates) else turned, memory, settings)
    if math.isfinite(turned + rates) and not (math.isfinite(aside) and memory.askew > 0):
        compare_turn(turned, rates, start, last[T.t] - memory.ticks[start, T.t], memory)
        compare_clocks(memory)
    judge_sliding(memory, settings)
    compare_pull(memory)
    compare_steering(turned, rates, aside, memory, settings)


@inlined
def _compare_positions(start, turning, memory, settings):
    """Compare how far and where positions moved; return by what angle (rad) off the yaw, NaN where that is unknown.

    start: the look with which the window begins; turning: rad, in the window.
    """
    first, last = memory.ticks[start], memory.ticks[TICKS - 1]
    time = last[T.t] - first[T.t]
    turned = way = sideways = mean_turn = 0.0
    for i in range(start + 1, TICKS):
        row = memory.ticks[i]
        mean_turn += turned + 0.5 * row[T.turned]
        turned += row[T.turned]
        way += row[T.way]
        sideways += row[T.vy] * row[T.time]
    east, north = last[T.x] - first[T.x], last[T.y] - first[T.y]
    far, course = hypot(east, north), atan2(north, east)
    yaw = first[T.yaw] + mean_turn / (TICKS - 1 - start)
    aside = wrapped(course - yaw)
    if not (math.isfinite(aside) and far > 1.0):
        return math.nan
    if abs(aside) < 0.3 or memory.agreed == 0:
        change = last[T.speed] - first[T.speed]
        label = compare(memory, COMPARED.way, way, change, 0.0, far, POSITION, last[T.time])
        if label > 0:
            report(memory, label - 1, far / max(way, 1e-9), 0.0, 0.0)
    compare_course(aside, course, yaw, far, turning / time, memory, settings)
    compare_sideways(aside, far, time, turning / time, sideways / time, memory, settings)
    return aside


# -- calls ------------------------------------------------------------------------------------------------------------
@exported(int64(vector, float64, Place(Check)))
def check_call(sample, command, check):
    """Take in a call, `SAMPLE`; return the bits of the mistakes so far. command: rad, in force from now on."""
    memory, settings = memory_of(check.memory, 0), settings_of(check.settings, 0)
    t, now, speed = sample[SAMPLE.t], sample[SAMPLE.now], sample[SAMPLE.speed]
    if now < memory.now - LONGEST:  # the clock was set back
        memory.t = -math.inf
    _check_clock(sample, memory, settings)
    if math.isfinite(speed):
        next_command = command if math.isfinite(command) else 0.0
        advance_requests(
            now, speed, sample[SAMPLE.yaw_rate], sample[SAMPLE.wheel_angle], next_command, memory, settings
        )
    same = True
    for i in range(3):
        same = same and sample[SAMPLE.x + i] == memory.pose[i]
        memory.pose[i] = sample[SAMPLE.x + i]
    memory.now = now
    moved = not same or speed < SLOW
    new = t > memory.t and math.isfinite(t + speed) and moved and not is_reported(memory, SUBJECTS.time)
    if new and _take(sample, memory):
        _look(memory, settings)
    return memory.suspect

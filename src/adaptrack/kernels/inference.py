"""The forward pass of schedulers: from a condition to Np, Nc, Q, R, with a guard.

Every scheduler is the same thing here: some entries of the condition, clipped to a domain, and one function of them
for each of the four slots - a constant, a small network, a fuzzy system or a table. It is packed into one array of
whole numbers (`layout`) and one of reals (`numbers`); the room that owns schedulers writes them, in the order in which
the functions below read them.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import types

from .abi import ROUTINE, float64, int64, int_vector, matrix, njit, record, vector
from .maths.elementary import clip

CONDITION = ("speed", "y_ref", "friction", "wind", "change", "acceleration", "offset")
"""What a scheduler may look at, see `mpc.Condition`."""
SLOTS = 4
"""Np, Nc, Q, R."""
SATURATED = 700.0
"""A neuron's input this far below zero gives 1e-304; further, the exponential would overflow."""
FARTHEST = 1e150
"""Widths from the centre at which a distance is held, so that its square is a number."""
NEGLIGIBLE = 50.0
"""A rule this much weaker than the strongest, by its logarithm, adds less than rounding does: e^-50 = 2e-22."""

CONSTANT, NETWORK, SUGENO, NEAREST, MULTILINEAR = range(5)
"""What fills a slot."""

INPUTS, GUARD = 0, 1
"""layout[INPUTS]: number D of inputs, 0 for no scheduler; layout[GUARD]: where the guard's part begins, 0 for none.
Then follow, for each slot, its kind and where its part of `layout` and `numbers` begins; then the D inputs' places in
CONDITION, then where the guard's part of `numbers` begins. `numbers` begins with the domain's D lows and D highs, then
decades (1: the value is a logarithm), lowest and highest for each slot."""
SLOT = 2
PLACES = SLOT + 3 * SLOTS

# What a scheduler remembers of each lane's run.
COUNTS = ("steps", "clipped", "broken", "rate_limited", "outside", "astray", "unstable", "fallback")
STEPS, CLIPPED, BROKEN, RATE_LIMITED, OUTSIDE, ASTRAY, UNSTABLE, FALLBACK, REST, HELD = range(10)
STATE = HELD + SLOTS + 1
"""Counts of steps: all; with an input clipped to the domain; with an input or output that is not a number; with the
change of tuning limited; with inputs far outside; too far from the reference; with the loop too near instability; on
the fallback. REST: steps of fallback still to go. HELD, ...: the last tuning, and 1 when there is one."""

Schedule = record("Schedule", ("layout", "numbers", "work", "state", "believed", "estimating", "estimates"))
SCHEDULE = types.NamedTuple((int_vector, vector, vector, matrix, vector, vector, matrix), Schedule)
"""layout, numbers: see INPUTS; work: scratch; state: (lanes, STATE). believed, estimating, estimates: the vehicle, the
settings and the memory of an estimator of friction and wind (see `estimation.estimate`); empty for none."""


def no_schedule() -> Any:
    """The plan of a run without a scheduler."""
    none = np.zeros(0)
    return Schedule(np.zeros(2, np.int64), none, none, np.zeros((0, STATE)), none, none, np.zeros((0, 0)))


_SLOT_FUNCTION = float64(vector, int_vector, int64, vector, int64, vector)


@njit(_SLOT_FUNCTION, **ROUTINE)
def network(x, layout, at, numbers, start, work):
    """A feed-forward net with sigmoid hidden layers and one output, eqs. (21)-(23).

    layout[at:]: number of layers, width of each from the inputs on, 1 for a ReLU at the output. numbers[start:]: low
    and 1/(high - low) of the inputs, each neuron's weights and bias, then the low and the span of the target. work: the
    neurons.
    """
    layers, inputs = layout[at], layout[at + 1]
    relu = layout[at + 2 + layers] == 1
    n = start + 2 * inputs
    for i in range(inputs):
        work[i] = (x[i] - numbers[start + i]) * numbers[start + inputs + i]
    before = 0
    out = 0.0
    for layer in range(layers):
        wide, next_wide = layout[at + 1 + layer], layout[at + 2 + layer]
        after = before + wide
        for j in range(next_wide):
            out = numbers[n + wide]
            for i in range(wide):
                out += numbers[n + i] * work[before + i]
            n += wide + 1
            if layer < layers - 1:
                work[after + j] = 1.0 / (1.0 + math.exp(min(-out, SATURATED)))
        before = after
    if relu:
        out = max(0.0, out)
    return numbers[n] + numbers[n + 1] * out


@njit(_SLOT_FUNCTION, **ROUTINE)
def sugeno(x, layout, at, numbers, start, work):
    """A first-order Sugeno system, eqs. (24)-(27), its strengths as logarithms up to the normalisation.

    layout[at:]: inputs D, functions M, rules R, then for each function its input and 1 for a bell, then for each rule
    its D functions (-1: any). numbers[start:]: 1/width, slope, centre of each function, then log weight, D slopes and
    the constant of each rule. work: M logarithms of memberships, then R of strengths.
    """
    inputs, functions, rules = layout[at], layout[at + 1], layout[at + 2]
    at += 3
    for m in range(functions):
        p = start + 3 * m
        distance = clip((x[layout[at + 2 * m]] - numbers[p + 2]) * numbers[p], -FARTHEST, FARTHEST)
        if layout[at + 2 * m + 1] == 0:
            work[m] = -0.5 * distance * distance
        elif distance == 0.0:
            work[m] = 0.0
        else:
            exponent = 2.0 * numbers[p + 1] * math.log(abs(distance))
            work[m] = -(max(exponent, 0.0) + math.log1p(math.exp(-abs(exponent))))
    at += 2 * functions
    start += 3 * functions
    strongest = -math.inf
    for r in range(rules):
        strength = numbers[start + r * (inputs + 2)]
        for d in range(inputs):
            m = layout[at + r * inputs + d]
            if m >= 0:
                strength += work[m]
        work[functions + r] = strength
        strongest = max(strongest, strength)
    total, weighted = 0.0, 0.0
    for r in range(rules):
        if work[functions + r] < strongest - NEGLIGIBLE:
            continue
        w = math.exp(work[functions + r] - strongest)
        n = start + r * (inputs + 2) + 1
        conclusion = numbers[n + inputs]
        for d in range(inputs):
            conclusion += numbers[n + d] * x[d]
        total += w
        weighted += w * conclusion
    return weighted / total


@njit(types.int64(float64, vector, int64, int64), **ROUTINE, forceinline=True)
def _cell(value, numbers, start, size):
    """The last node of an axis, of `size` ascending nodes from numbers[start] on, that is not above `value`."""
    low, high = 0, max(size - 2, 0)
    while low < high:
        middle = (low + high + 1) // 2
        if numbers[start + middle] <= value:
            low = middle
        else:
            high = middle - 1
    return low


@njit(_SLOT_FUNCTION, **ROUTINE)
def nearest(x, layout, at, numbers, start, work):
    """The value at the nearest node of a table; layout[at:]: D, sizes of the axes; numbers: the axes, the values."""
    inputs = layout[at]
    index, axis = 0, start
    for d in range(inputs):
        size = layout[at + 1 + d]
        i = _cell(x[d], numbers, axis, size)
        if i + 1 < size and x[d] - numbers[axis + i] > numbers[axis + i + 1] - x[d]:
            i += 1
        index = index * size + i
        axis += size
    return numbers[axis + index]


@njit(_SLOT_FUNCTION, **ROUTINE)
def multilinear(x, layout, at, numbers, start, work):
    """The multilinear interpolation of a table, packed as for `nearest`; work: 2 D reals."""
    inputs = layout[at]
    axis = start
    for d in range(inputs):
        size = layout[at + 1 + d]
        i = _cell(x[d], numbers, axis, size)
        work[d] = i
        work[inputs + d] = 0.0
        if size > 1:
            work[inputs + d] = clip((x[d] - numbers[axis + i]) / (numbers[axis + i + 1] - numbers[axis + i]), 0.0, 1.0)
        axis += size
    value = 0.0
    for corner in range(1 << inputs):
        index, weight = 0, 1.0
        for d in range(inputs):
            up = (corner >> d) & 1
            part = work[inputs + d]
            weight *= part if up == 1 else 1.0 - part
            index = index * layout[at + 1 + d] + min(int(work[d]) + up, layout[at + 1 + d] - 1)
        if weight > 0.0:
            value += weight * numbers[axis + index]
    return value


@njit(float64(int64, vector, int_vector, int64, vector, int64, vector), **ROUTINE)
def fill(kind, x, layout, at, numbers, start, work):
    """The value of one slot of `kind` at the inputs x."""
    if kind == NETWORK:
        return network(x, layout, at, numbers, start, work)
    if kind == SUGENO:
        return sugeno(x, layout, at, numbers, start, work)
    if kind == NEAREST:
        return nearest(x, layout, at, numbers, start, work)
    if kind == MULTILINEAR:
        return multilinear(x, layout, at, numbers, start, work)
    return numbers[start]


# -- the guard --------------------------------------------------------------------------------------------------------
# layout[at:]: 1 when a map of how near the loop is to instability follows, steps that a fallback lasts; then the map's
# layout as for `multilinear`, its axes being speed, friction, Np, Nc, log10 R/Q.
# numbers[start:]: the fallback (SLOTS); largest change per step of Np, Nc and log10 R/Q; how far outside the domain the
# inputs may be, in widths of it; the largest value of the map allowed; the largest offset over the friction allowed, in
# m; then the map.
GUARD_NUMBERS = SLOTS + 6
STAGES = 5
"""In how many stages a tuning gives way to the fallback."""


@njit(types.boolean(vector, vector, int_vector, int64, vector, int64, vector), **ROUTINE)
def _near_instability(condition, tuning, layout, at, numbers, start, work):
    """Whether the map says that the loop of a tuning is too near instability at this speed and friction."""
    if layout[at] == 0:
        return False
    x = work[-5:]
    x[0], x[1] = condition[0], condition[2]
    x[2], x[3], x[4] = tuning[0], tuning[1], math.log10(tuning[3] / tuning[2]) if tuning[2] > 0.0 else math.inf
    return not multilinear(x, layout, at + 2, numbers, start + GUARD_NUMBERS, work) <= numbers[start + SLOTS + 4]


@njit(types.void(float64, vector, vector, int64), **ROUTINE, forceinline=True)
def _towards(share, tuning, numbers, start):
    """Move a tuning a share of the way to the fallback: horizons in whole numbers, R/Q by its logarithm, Q as asked."""
    for s in range(2):
        tuning[s] = math.floor(tuning[s] + share * (numbers[start + s] - tuning[s]) + 0.5)
    tuning[1] = min(tuning[1], tuning[0])
    if tuning[2] > 0.0 and numbers[start + 2] > 0.0:
        ratio = tuning[3] / tuning[2]
        tuning[3] = tuning[2] * ratio * (numbers[start + 3] / numbers[start + 2] / ratio) ** share


@njit(types.void(vector, vector, int_vector, vector, vector, vector, types.boolean), **ROUTINE)
def guard(condition, tuning, layout, numbers, work, own, far):
    """Replace a tuning (SLOTS) by what may be trusted; own: the lane's state, far: inputs far outside the domain.

    What was asked of an untrusted input, or by what lets the car stray, is dropped for the fallback, for a while. Else
    the change since the last tuning is limited; and a tuning whose loop is too near instability gives way towards the
    fallback, as far as it must.
    """
    at, start = layout[GUARD], layout[PLACES + layout[INPUTS]]
    leeway = numbers[start + SLOTS + 5]
    astray = leeway < math.inf and not abs(condition[6]) <= leeway * condition[2]
    if far:
        own[OUTSIDE] += 1.0
    if astray:
        own[ASTRAY] += 1.0
    if far or astray:
        own[REST] = layout[at + 1]
    if own[REST] > 0.0:
        own[REST] -= 1.0
        own[FALLBACK] += 1.0
        for s in range(SLOTS):
            tuning[s] = numbers[start + s]
        return
    if own[HELD + SLOTS] > 0.5:
        # R/Q moves by R alone: Q is taken as asked
        limited = False
        for s in range(2):
            step = numbers[start + SLOTS + s]
            bounded = clip(tuning[s], own[HELD + s] - step, own[HELD + s] + step)
            limited = limited or bounded != tuning[s]
            tuning[s] = math.floor(bounded + 0.5)
        tuning[1] = min(tuning[1], tuning[0])
        if tuning[2] > 0.0 and own[HELD + 2] > 0.0:
            factor = 10.0 ** numbers[start + SLOTS + 2]
            last = own[HELD + 3] / own[HELD + 2]
            ratio = tuning[3] / tuning[2]
            bounded = clip(ratio, last / factor, last * factor)
            if bounded != ratio:
                limited = True
                tuning[3] = bounded * tuning[2]
        if limited:
            own[RATE_LIMITED] += 1.0
    if _near_instability(condition, tuning, layout, at, numbers, start, work):
        own[UNSTABLE] += 1.0
        for k in range(STAGES):
            _towards(1.0 / (STAGES - k), tuning, numbers, start)
            if not _near_instability(condition, tuning, layout, at, numbers, start, work):
                return
        own[FALLBACK] += 1.0
        for s in range(SLOTS):
            tuning[s] = numbers[start + s]


@njit(types.void(int64, vector, SCHEDULE, vector), **ROUTINE)
def schedule(lane, condition, plan, tuning):
    """Write the tuning (SLOTS) for a condition (see CONDITION); horizons whole, Nc <= Np, all within their bounds.

    Inputs are clipped to the domain. When one, or an output, is not a number, the guard takes its fallback; without a
    guard the tuning that is already there stays.
    """
    layout, numbers, work, own = plan.layout, plan.numbers, plan.work, plan.state[lane]
    inputs = layout[INPUTS]
    own[STEPS] += 1.0
    x = work[work.size - 5 - inputs : work.size - 5]
    clipped, far, broken = False, False, False
    slack = numbers[layout[PLACES + inputs] + SLOTS + 3] if layout[GUARD] > 0 else 0.0
    for d in range(inputs):
        value = condition[layout[PLACES + d]]
        low, high = numbers[d], numbers[inputs + d]
        x[d] = clip(value, low, high)
        broken = broken or not math.isfinite(value)
        clipped = clipped or abs(value - x[d]) > 0.0
        far = far or abs(value - x[d]) > slack * (high - low)
    if clipped:
        own[CLIPPED] += 1.0
    if not broken:
        for s in range(SLOTS):
            kind, at, start = layout[SLOT + 3 * s], layout[SLOT + 3 * s + 1], layout[SLOT + 3 * s + 2]
            value = fill(kind, x, layout, at, numbers, start, work)
            bounds = 2 * inputs + 3 * s
            if numbers[bounds] > 0.5:
                value = 10.0**value
            broken = broken or math.isnan(value)
            value = clip(value, numbers[bounds + 1], numbers[bounds + 2])
            work[work.size - 5 + s] = math.floor(value + 0.5) if s < 2 else value
    if broken:
        own[BROKEN] += 1.0
        if layout[GUARD] == 0:
            if own[HELD + SLOTS] > 0.5:
                for s in range(SLOTS):
                    tuning[s] = own[HELD + s]
            return
    else:
        for s in range(SLOTS):
            tuning[s] = work[work.size - 5 + s]
        tuning[1] = min(tuning[1], tuning[0])
    if layout[GUARD] > 0:
        guard(condition, tuning, layout, numbers, work, own, far or broken)
    for s in range(SLOTS):
        own[HELD + s] = tuning[s]
    own[HELD + SLOTS] = 1.0


@njit(types.void(matrix, SCHEDULE, matrix), **ROUTINE)
def schedule_all(conditions, plan, tunings):
    """Write the tuning (n, SLOTS) for each of many conditions (n, CONDITION), each as at the first step of a run."""
    for i in range(conditions.shape[0]):
        for j in range(STATE):
            plan.state[0, j] = 0.0
        schedule(0, conditions[i], plan, tunings[i])

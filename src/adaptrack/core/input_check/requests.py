"""The turning that the commands ask for: that of a steady turn, for several models of the wheels, and its integral."""

from __future__ import annotations

import math

from ..kernel import inlined
from ..maths.exact import clip
from ..maths.exponential import exp
from .hypotheses import BANKS
from .record import CLOSEST, CRAWLING, INTEGRAL, LONGEST, REQUESTED, SLOW

LAG = 0.15
"""s, between a command and the turning of the car, in addition to the delays that are tried."""
STEEP = 6.0
"""m/s^2, beyond which no car need turn as it is steered."""
RATE, LIMIT = 0.5, 0.52
"""rad/s, rad: what wheels of a limited rate do."""
FACTORS = (1.0, 1.0, 4.0, 180.0 / math.pi)
"""By which the wheels of each model follow a larger command than the one that was intended."""


@inlined
def _gain(speed, settings):
    """Yaw rate of a steady turn over the wheels' angle (1/s)."""
    length = settings.length
    return speed / max(length + settings.gradient * speed * speed, 0.5 * length)


@inlined
def _start_requests(now, speed, yaw_rate, wheel, command, memory, settings):
    """Begin with the first command; until then the car turned as it was measured to."""
    memory.request_count, memory.request = 1, 0
    row = memory.requests[0]
    row[:] = 0.0
    row[INTEGRAL.t], row[INTEGRAL.command] = now, command
    gain = _gain(max(speed, CRAWLING), settings)
    turning = yaw_rate if math.isfinite(yaw_rate) and speed > CRAWLING else command * gain
    angle = clip(wheel if math.isfinite(wheel) else turning / gain, -LIMIT, LIMIT)
    memory.begun_at, memory.command, memory.wheels[0] = now, command, 0.0
    memory.wheels[1:] = angle
    memory.begun_with[0], memory.begun_with[1] = turning, angle


@inlined
def advance_requests(now, speed, yaw_rate, wheel, command, memory, settings):
    """Go on with the requested turning to the time of a call; command: in force from now on."""
    step = now - memory.now
    if not 0.0 < step < LONGEST or memory.request_count == 0:
        _start_requests(now, speed, yaw_rate, wheel, command, memory, settings)
        return
    last = memory.request
    newest = memory.requests[last]
    apart = newest[INTEGRAL.t] - memory.requests[(last + REQUESTED - 1) % REQUESTED, INTEGRAL.t]
    if memory.request_count < 2 or apart >= CLOSEST:
        last = (last + 1) % REQUESTED
        memory.request, memory.request_count = last, min(memory.request_count + 1, REQUESTED)
    row, left = memory.requests[last], 1.0 - exp(-step / LAG)
    gain, most = _gain(speed, settings), STEEP / max(speed, SLOW)
    for bank in range(BANKS):
        angle = memory.wheels[bank]
        if bank == 0:
            memory.wheels[0] += (memory.command - angle) * left
        else:
            target = clip(FACTORS[bank] * memory.command, -LIMIT, LIMIT)
            memory.wheels[bank] += clip((target - angle) * left, -RATE * step, RATE * step)
        mean = 0.5 * (angle + memory.wheels[bank])
        turning, wheels = INTEGRAL.turning + bank, INTEGRAL.angle + bank
        row[turning] = newest[turning] + step * clip(gain * mean, -most, most)
        row[wheels] = newest[wheels] + step * mean
    row[INTEGRAL.t], row[INTEGRAL.command] = now, command
    memory.command = command


@inlined
def back_to(t, back, memory):
    """How many commands back the last one before a time (s) is, looked for from `back` on; the first one at least."""
    count, last, rows = memory.request_count, memory.request, memory.requests
    while back < count - 1 and rows[(last + REQUESTED - back) % REQUESTED, INTEGRAL.t] > t:
        back += 1
    return back


@inlined
def requested(t, back, which, memory):
    """An integral (`INTEGRAL`) at a time (s) behind the command that is so many back; ends hold."""
    last = memory.request
    row = memory.requests[(last + REQUESTED - back) % REQUESTED]
    if back == 0 or row[INTEGRAL.t] > t:
        return row[which]
    after = memory.requests[(last + REQUESTED - back + 1) % REQUESTED]
    return row[which] + (t - row[INTEGRAL.t]) / (after[INTEGRAL.t] - row[INTEGRAL.t]) * (after[which] - row[which])


@inlined
def command_range(t, memory):
    """(least, most) command (rad) in force at a time (s) or later; before the first one the wheels' angle counts."""
    angle = memory.begun_with[1]
    least, most = (angle, angle) if memory.begun_at > t else (math.inf, -math.inf)
    oldest = back_to(t, 0, memory)
    for back in range(1, oldest + 1):  # the newest one does not act yet
        command = memory.requests[(memory.request + REQUESTED - back) % REQUESTED, INTEGRAL.command]
        least, most = min(least, command), max(most, command)
    return least, most


@inlined
def left_of_beginning(t, memory):
    """How much of what was in force before the first command is left at a time (s)."""
    return exp(-max(t - memory.begun_at, 0.0) / LAG) if math.isfinite(t) else 0.0

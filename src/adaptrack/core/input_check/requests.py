"""What the commands ask of the car: the turning of a steady turn, behind a lag, and its integral."""

from __future__ import annotations

import math

from ..kernel import inlined
from ..maths.exact import clip
from ..maths.exponential import exp
from .record import CLOSEST, INTEGRAL, LONGEST, REQUESTED, SLOW

LAG = 0.15
"""s, between a command and the turning of the car, beside the delays that are tried."""
STEEP = 6.0
"""m/s^2, beyond which no car need turn as it is steered."""
DEGREES, RATE, LIMIT = 180.0 / math.pi, 0.5, 0.52
"""A command sent in degrees throws the wheels about: factor, and rate (rad/s) and angle (rad) that they can."""


@inlined
def _gain(speed, settings):
    """Yaw rate of a steady turn over the wheels' angle (1/s)."""
    length = settings.length
    return speed / max(length + settings.gradient * speed * speed, 0.5 * length)


@inlined
def go_on(now, speed, yaw_rate, wheel, command, own, settings):
    """Go on with what the commands ask for to the time of a call; command: in force from now on."""
    step = now - own.now
    if not 0.0 < step < LONGEST or own.request_count == 0:
        own.request_count, own.request = 1, 0
        row = own.requests[0]
        row[INTEGRAL.t] = now
        for i in range(1, len(INTEGRAL)):
            row[i] = 0.0
        gain = _gain(max(speed, SLOW), settings)
        turning = yaw_rate if math.isfinite(yaw_rate) and speed > SLOW else command * gain
        angle = clip(wheel if math.isfinite(wheel) else turning / gain, -LIMIT, LIMIT)
        own.begun_at, own.command, own.lagged, own.limited, own.thrown = now, command, 0.0, angle, angle
        own.begun_with[0], own.begun_with[1] = turning, angle
        return
    last = own.request
    newest = own.requests[last]
    apart = newest[INTEGRAL.t] - own.requests[(last + REQUESTED - 1) % REQUESTED, INTEGRAL.t]
    if own.request_count < 2 or apart >= CLOSEST:
        last = (last + 1) % REQUESTED
        own.request, own.request_count = last, min(own.request_count + 1, REQUESTED)
    row, lagged, limited, thrown = own.requests[last], own.lagged, own.limited, own.thrown
    left = 1.0 - exp(-step / LAG)
    own.lagged += (own.command - lagged) * left
    own.limited += clip((own.command - limited) * left, -RATE * step, RATE * step)
    own.thrown += clip(clip(DEGREES * own.command, -LIMIT, LIMIT) - thrown, -RATE * step, RATE * step)
    lagged, limited, thrown = 0.5 * (lagged + own.lagged), 0.5 * (limited + own.limited), 0.5 * (thrown + own.thrown)
    gain, most = _gain(speed, settings), STEEP / max(speed, SLOW)
    row[INTEGRAL.t] = now
    row[INTEGRAL.turning] = newest[INTEGRAL.turning] + step * clip(gain * lagged, -most, most)
    row[INTEGRAL.limited_turning] = newest[INTEGRAL.limited_turning] + step * clip(gain * limited, -most, most)
    row[INTEGRAL.thrown_turning] = newest[INTEGRAL.thrown_turning] + step * clip(gain * thrown, -most, most)
    row[INTEGRAL.angle] = newest[INTEGRAL.angle] + step * lagged
    row[INTEGRAL.limited_angle] = newest[INTEGRAL.limited_angle] + step * limited
    row[INTEGRAL.thrown_angle] = newest[INTEGRAL.thrown_angle] + step * thrown
    own.command = command


@inlined
def back_to(t, back, own):
    """How many commands back the last one before a time (s) is, looked for from `back` on; the first one at least."""
    count, last, rows = own.request_count, own.request, own.requests
    while back < count - 1 and rows[(last + REQUESTED - back) % REQUESTED, INTEGRAL.t] > t:
        back += 1
    return back


@inlined
def requested(t, back, which, own):
    """An integral (`INTEGRAL`) at a time (s) behind the command that is so many back; ends hold."""
    last = own.request
    row = own.requests[(last + REQUESTED - back) % REQUESTED]
    if back == 0 or row[INTEGRAL.t] > t:
        return row[which]
    after = own.requests[(last + REQUESTED - back + 1) % REQUESTED]
    return row[which] + (t - row[INTEGRAL.t]) / (after[INTEGRAL.t] - row[INTEGRAL.t]) * (after[which] - row[which])


@inlined
def left_of_beginning(t, own):
    """How much of what was in force before the first command is left at a time (s)."""
    return exp(-max(t - own.begun_at, 0.0) / LAG) if math.isfinite(t) else 0.0

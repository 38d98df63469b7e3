"""What the commands ask of the car: the turning of a steady turn, behind a lag, and its integral."""

from __future__ import annotations

import math

from ..kernel import inlined
from ..maths.exponential import exp
from .record import CLOSEST, LONGEST, REQUESTED, SLOW

LAG = 0.15
"""s, between a command and the turning of the car, beside the delays that are tried."""
STEEP = 6.0
"""m/s^2, beyond which no car need turn as it is steered."""


@inlined
def _gain(speed, settings):
    """Yaw rate of a steady turn over the wheels' angle (1/s)."""
    length = settings.length
    return speed / max(length + settings.gradient * speed * speed, 0.5 * length)


@inlined
def go_on(now, speed, command, own, settings):
    """Go on with what the commands ask for to the time of a call; command: in force from now on."""
    step = now - own.now
    if not 0.0 < step < LONGEST or own.request_count == 0:
        own.request_count, own.request = 1, 0
        row = own.requests[0]
        row[0], row[1], row[2] = now, 0.0, 0.0
        own.begun_at, own.command, own.lagged = now, command, 0.0
        own.begun_with[0], own.begun_with[1] = command * _gain(speed, settings), command
        return
    last = own.request
    newest = own.requests[last]
    before = own.lagged
    own.lagged += (own.command - before) * (1.0 - exp(-step / LAG))
    middle, most = 0.5 * (before + own.lagged), STEEP / max(speed, SLOW)
    rate = min(max(middle * _gain(speed, settings), -most), most)
    turning, angle = newest[1] + step * rate, newest[2] + step * middle
    apart = newest[0] - own.requests[(last + REQUESTED - 1) % REQUESTED, 0]
    if own.request_count < 2 or apart >= CLOSEST:
        last = (last + 1) % REQUESTED
        own.request, own.request_count = last, min(own.request_count + 1, REQUESTED)
    row = own.requests[last]
    row[0], row[1], row[2] = now, turning, angle
    own.command = command


@inlined
def asked(t, back, own):
    """Integrals of turning and angle at a time (s), and how many commands back it is; ends hold.

    back: where to begin to look, from the newest command.
    """
    count, last, rows = own.request_count, own.request, own.requests
    while back < count - 1 and rows[(last + REQUESTED - back) % REQUESTED, 0] > t:
        back += 1
    row = rows[(last + REQUESTED - back) % REQUESTED]
    if back == 0 or row[0] > t:
        return row[1], row[2], back
    after = rows[(last + REQUESTED - back + 1) % REQUESTED]
    share = (t - row[0]) / (after[0] - row[0])
    return row[1] + share * (after[1] - row[1]), row[2] + share * (after[2] - row[2]), back


@inlined
def left_of_beginning(t, own):
    """How much of what was in force before the first command is left at a time (s)."""
    return exp(-max(t - own.begun_at, 0.0) / LAG) if math.isfinite(t) else 0.0

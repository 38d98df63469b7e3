"""The moves that a curved road asks for: what the QP's free moves are counted from.

A linear single track follows y(t) with the wheel angle whose transfer function is the inverse of

    Y'' / delta = (Cf/m) (s^2 + b1 s + b0) / (s^2 + a1 s + a0)

(Rajamani, Vehicle Dynamics and Control, 2nd ed., 2012, eq. 2.45 gives the states). To first order in s that is the
steady angle, some time earlier:

    delta(t) = (L + K v^2)/v^2 Y''(t + T),   T = a1/a0 - b1/b0 = W v/(L + K v^2) - lr/v,
    W = ((Cf + Cr) Iz + (lf^2 Cf + lr^2 Cr) m)/(Cf Cr L),   K = m (lr Cr - lf Cf)/(L Cf Cr)

with Cf, Cr of an axle; a steering lag is taken out the same way, as so much time more. Y(t) is the road ahead in the
frame of its tangent, so Y'' is curvature times squared speed. With the moves of this angle known to the prediction, the
free moves and their weight are about what the car does beyond it, and a horizon longer than the free moves does not
straighten bends.
"""

from __future__ import annotations

import math
from typing import Any

from numba import types

from ..abi import INLINE, ROUTINE, int64, njit, record, vector
from ..maths.elementary import clip

TURNING = ("wheelbase", "understeer", "turning", "lr", "lag")
"""L (m), K (rad s^2/m), W (rad s^2/m), lr (m) and the steering's lag (s)."""
Turning = record("Turning", TURNING)
LEAST_GAIN = 0.3
"""L + K v^2 over L at least: near its critical speed an oversteering car needs hardly any angle."""
FURTHEST = 0.5
"""s, the largest T"""


def bend_size(horizon: int, period: float, turning: Any) -> int:
    """How far ahead (instants) the road has to be known."""
    return horizon + 1 + (math.ceil((float(turning[-1]) + FURTHEST) / period) + 2 if len(turning) else 0)


@njit(**INLINE)
def _asked(place, bend):
    """Y'' T^2 (m) at so many periods ahead, a straight line between instants; beyond what is known its end."""
    p = clip(place, 1.0, bend.size - 2.0)
    i = min(int(p), bend.size - 3)
    near = bend[i - 1] - 2.0 * bend[i] + bend[i + 1]
    far = bend[i] - 2.0 * bend[i + 1] + bend[i + 2]
    return near + (p - i) * (far - near)


@njit(**ROUTINE)
def road_moves(horizon, speed, settings, turning, bend, feed):
    """Write the moves (rad) that the road ahead asks for to feed[:horizon]; each within the limits on moves.

    bend: (m) at instants from the end of the dead time on, see `road.bend_ahead`.
    """
    wheelbase, understeer = turning[0], turning[1]
    period = settings.period
    gain = max(wheelbase + understeer * speed * speed, LEAST_GAIN * wheelbase)
    earlier = min(turning[4] + turning[2] * speed / gain - turning[3] / speed, turning[4] + FURTHEST) / period
    angle_per_shift = gain / (speed * period) ** 2
    before = _asked(earlier - 0.5, bend)
    for i in range(horizon):
        now = _asked(earlier + i + 0.5, bend)
        feed[i] = clip(angle_per_shift * (now - before), settings.move_min, settings.move_max)
        before = now


@njit(types.void(int64, vector, vector, vector), **ROUTINE)
def tell_moves(horizon, step, feed, error):
    """Take what known moves do to the outputs out of R_s - Y; step: (horizon,) response to a unit move."""
    for i in range(horizon):
        move = feed[i]
        if move != 0.0:
            for j in range(i, horizon):
                error[j] -= step[j - i] * move

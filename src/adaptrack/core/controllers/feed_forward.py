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

Tyres that pull less than linear ones (`models.path.lost`) ask for K times as much angle more. An estimator that knows
of this counts it as a push, which the prediction holds as it is now: these moves answer how it grows and falls along
the road, so the prediction is not told of them.
"""

from __future__ import annotations

import math
from typing import Any

from ..kernel import exported, inlined, int64, matrix, vector, void
from ..maths.bits import whole
from ..maths.exact import clip
from ..models.path import lost

TURNING = ("wheelbase", "understeer", "turning", "lr", "lag", "friction", "shape")
"""L (m), K (rad s^2/m), W (rad s^2/m), lr (m) and the steering's lag (s); of the tyres as the estimator takes them to
be, see `models.path.lost`, friction 0: linear."""
LEAST_GAIN = 0.3
"""L + K v^2 over L at least: near its critical speed an oversteering car needs hardly any angle."""
FURTHEST = 0.5
"""s, the largest T"""


def bend_size(horizon: int, period: float, turning: Any) -> int:
    """How far ahead (instants) the road has to be known."""
    return horizon + 1 + (math.ceil((float(turning[4]) + FURTHEST) / period) + 2 if len(turning) else 0)


@inlined
def _asked(place, bend):
    """Y'' T^2 (m) at so many periods ahead, a straight line between instants; beyond what is known its end."""
    p = clip(place, 1.0, bend.size - 2.0)
    i = min(whole(p), bend.size - 3)
    near = bend[i - 1] - 2.0 * bend[i] + bend[i + 1]
    far = bend[i] - 2.0 * bend[i + 1] + bend[i + 2]
    return near + (p - i) * (far - near)


@inlined
def _limit(count, most, wanted, work):
    """Replace wanted[:count] by the nearest values, in their largest difference, whose steps are at most `most`.

    They are the mean of the least bound from above and the largest one from below with such steps (E. J. McShane,
    Extension of range of functions, 1934): so a fast turn of the wheels begins before it is asked for.
    """
    for i in range(count):
        work[i] = wanted[i]
    for i in range(1, count):
        wanted[i] = max(wanted[i], wanted[i - 1] - most)
        work[i] = min(work[i], work[i - 1] + most)
    for i in range(count - 2, -1, -1):
        wanted[i] = max(wanted[i], wanted[i + 1] - most)
        work[i] = min(work[i], work[i + 1] + most)
    for i in range(count):
        wanted[i] = 0.5 * (wanted[i] + work[i])


@inlined
def road_moves(horizon, speed, settings, turning, bend, feed):
    """Write the moves (rad) that the road ahead asks for to feed[:2, :horizon]: what the prediction is told, and all.

    All are within the limits on moves. bend: (m) at instants from the end of the dead time on, see `road.bend_ahead`;
    feed: (3, > horizon).
    """
    wheelbase, understeer, period = turning[0], turning[1], settings.period
    steady = max(wheelbase + understeer * speed * speed, LEAST_GAIN * wheelbase)
    earlier = min(turning[4] + turning[2] * speed / steady - turning[3] / speed, turning[4] + FURTHEST) / period
    for i in range(horizon + 1):
        asked = _asked(earlier + i - 0.5, bend) / (period * period)
        feed[0, i] = -understeer * lost(asked, turning[5], turning[6]) if turning[5] > 0.0 else 0.0
        feed[1, i] = asked * steady / (speed * speed) + feed[0, i]
    _limit(horizon + 1, min(settings.move_max, -settings.move_min), feed[1], feed[2])
    for i in range(horizon):
        feed[1, i] = feed[1, i + 1] - feed[1, i]
        feed[0, i] = feed[1, i] - (feed[0, i + 1] - feed[0, i])


@exported(void(int64, vector, matrix, vector))
def tell_moves(horizon, step, feed, error):
    """Take what the moves feed[0] do to the outputs out of R_s - Y; step: (horizon,) response to a unit move."""
    for i in range(horizon):
        move = feed[0, i]
        if move != 0.0:
            for j in range(i, horizon):
                error[j] -= step[j - i] * move

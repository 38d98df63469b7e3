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

Tyres that pull less than linear ones (`models.saturation`) need K times as much angle more. An estimator that
knows of this counts it as a push, which the prediction holds as it is now: these moves answer how it grows and falls
along the road, so the prediction does not know of them.
"""

from __future__ import annotations

from ..kernel import exported, inlined, int64, record, vector, viewer, void
from ..maths.bits import whole
from ..maths.exact import ceil, clip
from ..models.path import saturation, turning_of

FeedForward = record(
    "FeedForward",
    (
        ("turning", vector, "turning"),  # `models.path.Turning`; empty: the moves know nothing of the road
        ("expected", vector, "road_moves"),  # (> Np,) rad, moves that the prediction knows
        ("moves", vector, "road_moves"),  # (> Np,) rad, all of them
        ("scratch", vector, "road_moves"),  # (> Np,)
    ),
)
"""The moves that the road ahead asks for; without entries where there are none."""
LEAST_GAIN = 0.3
"""L + K v^2 over L at least: near its critical speed an oversteering car needs hardly any angle."""
MAX_TURN_IN = 0.5
"""s, the largest T"""

Bend = record("Bend", ("before", "present", "after", "beyond"))
"""How far (m) the road lies to the left at four instants in a row."""
bend_at = viewer(Bend)


@inlined
def bend_size(horizon, period, turning, lag):
    """How far ahead (instants) the road has to be known; turning: numbers of `Turning`, lag: (s) that in it."""
    if turning == 0:
        return horizon + 1
    return horizon + 1 + whole(ceil((lag + MAX_TURN_IN) / period)) + 2


@inlined
def _requested(place, bend):
    """Y'' T^2 (m) at so many periods ahead, a straight line between instants; beyond what is known its end."""
    p = clip(place, 1.0, bend.size - 2.0)
    i = max(1, min(whole(p), bend.size - 3))  # a place that is no number has none
    y = bend_at(bend, i - 1)
    near = y.before - 2.0 * y.present + y.after
    curvature = y.present - 2.0 * y.after + y.beyond
    return near + (p - i) * (curvature - near)


@inlined
def _limit(count, most, requested, work):
    """Replace wanted[:count] by the nearest values, in their largest difference, whose steps are at most `most`.

    They are the mean of the least bound from above and the largest one from below with such steps (E. J. McShane,
    Extension of range of functions, 1934): so a fast turn of the wheels begins before it is needed.
    """
    work[:count] = requested[:count]
    for i in range(1, count):
        requested[i] = max(requested[i], requested[i - 1] - most)
        work[i] = min(work[i], work[i - 1] + most)
    for i in range(count - 2, -1, -1):
        requested[i] = max(requested[i], requested[i + 1] - most)
        work[i] = min(work[i], work[i + 1] + most)
    for i in range(count):
        requested[i] = 0.5 * (requested[i] + work[i])


@inlined
def road_moves(horizon, speed, settings, bend, feed):
    """Write the moves (rad) that the road ahead asks for to feed.moves, and of these what the prediction knows.

    All are within the limits on moves. bend: (m) at instants from the end of the dead time on, see `road.bend_ahead`;
    feed: `FeedForward`.
    """
    car, period = turning_of(feed.turning, 0), settings.period
    steady = max(car.wheelbase + car.understeer * speed * speed, LEAST_GAIN * car.wheelbase)
    earlier = min(car.lag + car.turning * speed / steady - car.lr / speed, car.lag + MAX_TURN_IN) / period
    expected, moves = feed.expected, feed.moves
    for i in range(horizon + 1):
        turn = _requested(earlier + i - 0.5, bend) / (period * period)
        expected[i] = -car.understeer * saturation(turn, car.friction, car.shape_factor) if car.friction > 0.0 else 0.0
        moves[i] = turn * steady / (speed * speed) + expected[i]
    _limit(horizon + 1, min(settings.move_max, -settings.move_min), moves, feed.scratch)
    for i in range(horizon):
        moves[i] = moves[i + 1] - moves[i]
        expected[i] = moves[i] - (expected[i + 1] - expected[i])


@inlined
def expect_move(i, move, horizon, step, error):
    """Take what a move (rad) at the i-th instant does to the outputs out of R_s - Y."""
    if move != 0.0:
        for j in range(i, horizon):
            error[j] -= step[j - i] * move


@exported(void(int64, vector, vector, vector))
def expect_moves(horizon, step, moves, error):
    """Take what moves (rad) do to the outputs out of R_s - Y; step: (horizon,) response to a unit move."""
    for i in range(horizon):
        expect_move(i, moves[i], horizon, step, error)

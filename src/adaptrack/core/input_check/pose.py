"""Poses that drift or jump: the position against dead reckoning, the yaw against the yaw rate, over 2 to 10 s.

Dead reckoning takes the speed, the yaw, and the lateral velocity (else the slip of a steady turn). Honest errors of the
sensors (`ERRORS`) are estimated by recursive least squares. What they leave unexplained is summed in two exponential
windows and compared with what honest sensors may sum up to. A slow drift from the beginning on looks like an honest
error of the sensors.
"""

from __future__ import annotations

import math

from ..controllers.contract import wrapped
from ..kernel import inlined, local
from ..maths.exact import sqrt
from ..maths.exponential import exp, hypot
from ..maths.trigonometric import cos, sin
from .hypotheses import MISTAKES, POSE_BITS
from .record import CRAWLING, ERRORS, MOVED, TICK, TICKS, T, report

SPREADS = (0.03, 0.015, 0.7, 0.3, 0.004, 0.1, 0.1)
"""Standard deviations of `ERRORS` at the beginning; that of the slip relative to the slip of the car file."""
ERROR_GROWTH = 1e-3
"""Growth of their variances, a second, relative to those at the beginning."""
DRIFT_TIMES = (1.5, 6.0)
"""s, time constants of the windows."""
POSITION_DRIFT, YAW_DRIFT = 0.25, 0.012
"""m, rad: drifts that are honest at any speed."""
POSITION_SIGMAS = 9.0
"""Honest drift over the noise of the positions that the filter assumes, which may be half of the true one."""
ALONG, SWING, HARD_SWING = 0.003, 0.01, 0.004
"""Honest drift relative to the way: always, and by what the lateral acceleration (m/s^2) differs from its mean over
`SWINGS` (s), and its square: the slip of a car that swings is not that of a steady turn."""
SWINGS = 1.0
MEASURED_SHARE = 0.4
"""Share of it where the lateral velocity is measured."""
TURNING, WANDERING = 0.03, 0.002
"""Honest drift of the yaw: relative to its change, and in rad/s."""
READY, DRIFTING_LOOKS = 30, 2
"""Looks without a drift before one can be told; looks in a row at which it must be there."""
_along, _across, _turn, _gains = (local(len(ERRORS)) for _ in range(4))


# -- honest errors ----------------------------------------------------------------------------------------------------
@inlined
def _let_errors_change(memory, settings, share):
    """Add a share of the variances at the beginning."""
    for i in range(len(ERRORS)):
        spread = SPREADS[i] * (settings.slip if i == ERRORS.slip else 1.0)
        memory.covariance[i, i] += share * (spread * spread)


@inlined
def _explain(memory, regressors, reading, noise):
    """Return what the honest errors leave of a reading, and their standard deviation; learn them from it."""
    gains = _gains()
    variance = 0.0
    for i in range(len(ERRORS)):
        reading -= memory.errors[i] * regressors[i]
        for j in range(len(ERRORS)):
            gains[i] += memory.covariance[i, j] * regressors[j]
        variance += gains[i] * regressors[i]
    for i in range(len(ERRORS)):
        share = gains[i] / (variance + noise * noise)
        memory.errors[i] += share * reading
        for j in range(len(ERRORS)):
            memory.covariance[i, j] -= share * gains[j]
    return reading, sqrt(max(variance, 0.0))


@inlined
def _mean_change(memory, which):
    """The change of a signal between two looks, a mean over all that are kept; 0 where it is unknown."""
    change = (memory.ticks[TICKS - 1, which] - memory.ticks[0, which]) / (TICKS - 1)
    return change if math.isfinite(change) and memory.tick_count == TICKS else 0.0


@inlined
def _explain_along(memory, way, distance):
    """The way of the positions along the car (m), against that by the speed."""
    by = _along()
    by[ERRORS.scale], by[ERRORS.speed_late] = way, _mean_change(memory, T.speed)
    return _explain(memory, by, distance - way, hypot(0.07, 0.01 * way))


@inlined
def _explain_across(memory, settings, time, way, rate, distance):
    """The way of the positions to the left (m), against that by the lateral velocity or a steady turn."""
    by, sideways = _across(), memory.moved[MOVED.sideways]
    by[ERRORS.mounting], by[ERRORS.lever] = way, rate * time
    if not math.isfinite(sideways):
        pull_way = rate * way * way / time
        by[ERRORS.slip] = -pull_way
        sideways = settings.lr * rate * time - settings.slip * pull_way
    return _explain(memory, by, distance - sideways, hypot(0.07, 0.01 * way))


@inlined
def _explain_turn(memory, time, turned):
    """The change of the yaw (rad), against that by the yaw rate."""
    rolled = memory.moved[MOVED.turned]
    if not math.isfinite(rolled):
        return 0.0, 0.0
    by = _turn()
    by[ERRORS.gyro], by[ERRORS.yaw_late] = time, _mean_change(memory, T.yaw_rate)
    return _explain(memory, by, turned - rolled, 0.01)


# -- drifts -----------------------------------------------------------------------------------------------------------
@inlined
def begin_pose(memory):
    """Forget the last pose."""
    memory.placed[0] = math.nan
    memory.moved[:] = 0.0


@inlined
def compare_pose(memory, settings):
    """Take in a look; report a pose that drifts or has jumped."""
    last, moved = memory.ticks[TICKS - 1], memory.moved
    moved[MOVED.time] += last[T.time]
    moved[MOVED.way] += last[T.way]
    moved[MOVED.turned] += last[T.yaw_rate] * last[T.time]
    moved[MOVED.sideways] += last[T.vy] * last[T.time]
    if not math.isfinite(last[T.x] + last[T.y] + last[T.yaw]):
        return
    time = moved[MOVED.time]
    if math.isfinite(memory.placed[0]) and time > 0.5 * TICK and moved[MOVED.way] > CRAWLING * time:
        _let_errors_change(memory, settings, 1.0 if memory.covariance[0, 0] == 0.0 else ERROR_GROWTH * time)
        if memory.sliding == 0:
            _sum_drifts(last, memory, settings)
            _judge_drifts(memory, settings)
        else:
            memory.drifts[:, :] = 0.0
    begin_pose(memory)
    memory.placed[0], memory.placed[1], memory.placed[2] = last[T.x], last[T.y], last[T.yaw]


@inlined
def _sum_drifts(last, memory, settings):
    """Add the motion since the last pose to the drifts, and what of it honest sensors may leave unexplained."""
    time, way = memory.moved[MOVED.time], memory.moved[MOVED.way]
    turned = wrapped(last[T.yaw] - memory.placed[2])
    east, north = last[T.x] - memory.placed[0], last[T.y] - memory.placed[1]
    ahead, left = cos(memory.placed[2] + 0.5 * turned), sin(memory.placed[2] + 0.5 * turned)
    rolled = memory.moved[MOVED.turned]
    rate = (rolled if math.isfinite(rolled) else turned) / time
    along, _ = _explain_along(memory, way, east * ahead + north * left)
    across, unsure_across = _explain_across(memory, settings, time, way, rate, north * ahead - east * left)
    swung, unsure_turn = _explain_turn(memory, time, turned)
    swing = rate * way / time - memory.pull
    memory.pull += swing * min(time / SWINGS, 1.0)
    honest = (ALONG + SWING * abs(swing) + HARD_SWING * swing * swing) * way + unsure_across
    if math.isfinite(memory.moved[MOVED.sideways]):
        honest *= MEASURED_SHARE
    for i in range(len(DRIFT_TIMES)):
        share = exp(-time / DRIFT_TIMES[i])
        drifts, honest_drifts = memory.drifts[i], memory.honest_drifts[i]
        drifts[0] = drifts[0] * share + along * ahead - across * left
        drifts[1] = drifts[1] * share + along * left + across * ahead
        drifts[2] = drifts[2] * share + swung
        honest_drifts[0] = honest_drifts[0] * share + honest
        honest_drifts[1] = honest_drifts[1] * share + TURNING * abs(turned) + WANDERING * time + unsure_turn


@inlined
def _judge_drifts(memory, settings):
    """Report a drift that is more than an honest one."""
    honest = max(POSITION_DRIFT, POSITION_SIGMAS * settings.position_noise)
    distance = angle = worst = worst_angle = 0.0
    for i in range(len(DRIFT_TIMES)):
        far, turned = hypot(memory.drifts[i, 0], memory.drifts[i, 1]), abs(memory.drifts[i, 2])
        distance, angle = max(distance, far), max(angle, turned)
        worst = max(worst, far / (honest + memory.honest_drifts[i, 0]))
        worst_angle = max(worst_angle, turned / (YAW_DRIFT + memory.honest_drifts[i, 1]))
    drifts = max(worst, worst_angle) > 1.0 and memory.slips == 0  # a car that begins to slide moves sideways, too
    memory.drifting = memory.drifting + 1 if drifts else 0
    memory.steady += 0 if drifts else 1
    if memory.drifting < DRIFTING_LOOKS or memory.steady < READY or memory.suspect & POSE_BITS != 0:
        return
    if worst_angle > 1.0:
        report(memory, MISTAKES.yaw_drifts, angle, 0.0, 0.0)
    else:
        report(memory, MISTAKES.position_drifts, distance, 0.0, 0.0)

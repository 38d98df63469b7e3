"""A Kalman filter on the path model: its state, two disturbances and the yaw-rate sensor's offset, behind a dead time.

    z = [x, d_y, d_r, b],   x(k+1) = A x(k) + B u(k) + G d(k) + noise,   d and b: random walks

The command of instant j acts from T_d = (m + s) T after it (m whole periods, a share s of one more). Between two
instants the filter carries z along with the commands that acted; what it hands to the controller is x at the time when
the new command begins to act, carried on through the commands already sent.

Each sensor is taken in by itself, as value = h z + noise, so one that is missing (not finite) is left out; an
innovation counts up to `bound` of its own standard deviations. A sample of a known age belongs to the control instant
next to the time at which it was taken: the filter keeps z of `late` periods ago and goes through the instants since
then anew at every step, with all that has arrived of them. What was taken a little before or after its instant is
compared with z carried there, psi - tau r and y - tau (v_y + v psi) + tau^2/2 v r. A sample that repeats the one before
to the last bit, from a sensor that has noise, is an old one and left out; not so a heading or position against a path
that has turned since: the car has turned with it.

A sensor that is stuck behind its own noise disagrees: the mean of its squared innovations over their variance, 1 for a
filter that is right, grows. Beyond `distrust` the sensor that disagrees the most is left out until it agrees again, one
at a time; the pose never, for nothing else says where the car is.

What a tyre slides away is not in the model: v_y and r drift by it, and an accelerometer disagrees. So the harder the
driving, the less of what the model cannot explain is called a push; and a push is no larger than what the tyres can
still answer, `grip` less what they pull in the model.

The offsets of an accelerometer (the pull of a banked road is one to it) and of the wheel-angle sensor are slow averages
of their innovations. Without a position for longer than `patience`, or with one that stays the same and disagrees with
the estimate by more than `bound` times its noise, the estimate is not finite: the controller holds.
"""

from __future__ import annotations

import math
from typing import Any

from ..kernel import exported, float64, inlined, int64, record, unpacker, vector, void
from ..maths.bits import whole
from ..maths.exact import clip, floor, sqrt, square
from ..maths.vectors import WIDTH, fma8, load, mul, splat, spread, store, sub, zeros
from ..models import path
from ..models.contract import MEASURED
from .contract import ESTIMATE

NUMBERS = (
    "period",  # s
    "whole", "share",  # dead time in periods: m, and the share s of one more, 0 <= s < 1
    "longest",  # whole periods of the longest dead time that there may be: so many commands are remembered
    "late",  # periods that are gone through anew at every step
    "bias",  # rad, by which the wheels turn beyond the command
    "bound",  # standard deviations up to which an innovation counts
    "patience",  # periods without a position after which there is no estimate
    "distrust", "trust",  # mean of squared innovations over their variance: left out beyond, taken back below
    "forgetting", "regaining",  # shares by which that mean moves with a sample, taken in or left out
    "settling",  # share of an innovation by which a sensor's offset moves
    "variance_vy", "variance_yaw", "variance_yaw_rate", "variance_y", "variance_wheel_angle",  # of sensors; inf: none
    "variance_lateral_acceleration",
    "drift_vy", "drift_yaw", "drift_yaw_rate", "drift_y", "drift_wheel_angle",  # variances that a period adds
    "drift_side", "drift_turn", "drift_both",  # likewise, of d_y and d_r, and their covariance
    "drift_bias",  # likewise, of the yaw-rate sensor's offset
    "sliding",  # s, squared, of what the tyres' sliding makes uncertain of each axle's force, over F^2/F_z
    "sliding_time",  # s, how long the model gets a force wrong at a time, as far as an accelerometer is concerned
    "grip", "least_spare",  # m/s^2, what tyres can pull at most, and what a disturbance may always be
    "friction", "shape",  # of the tyres, by which they pull less in a bend than linear ones
    "spread_side", "spread_turn", "spread_bias",  # variances of d_y, d_r and b before the first sample; b: 0, no offset
)  # fmt: skip
Numbers = record("Numbers", NUMBERS)
"""What the parameters begin with; those of the path model follow."""
_unpack = unpacker(Numbers)
SENSORS = 6
"""The first of `MEASURED`; their ages follow."""
_STATES = 5  # as many of them may be states
_VARIANCE, _DRIFT = NUMBERS.index("variance_vy"), NUMBERS.index("drift_vy")
WHOLE, SHARE, BIAS, VARIANCE, DRIFT_WHEELS = (
    NUMBERS.index(name) for name in ("whole", "share", "bias", "variance_vy", "drift_wheel_angle")
)
"""Places of what may be learned."""
UNKNOWN = 1e2
"""Variance of a state of which the first sample says nothing."""
FAR, FAR_TURNED, ASTRAY = 100.0, 10.0, 10
"""m, rad, by which a position or a heading is no outlier but the estimate wrong, when so many follow each other."""
LEAST_NOISE = (0.005, 0.0002, 0.001, 0.002, 0.0005, 0.02)
"""Of the sensors: with better ones the model's own errors limit the filter."""

# Memory, in rows of the vector width; matrices take eight rows.
_COUNT, _SPEED, _BLIND = 0, 1, 2  # steps; speed of the matrices; periods since a position was taken in
_OF_COMMAND = 3  # what the command adds to the lateral acceleration, where there is no lag
_SPARE = 5  # what the tyres can still answer, m/s^2
LEFT_OUT = 6
"""Place in the memory of what is left out: 1 + the sensor, 0: none."""
_LOST = 7  # m/s^2, what the tyres pull less than linear ones in the bend at hand
_FELT_ERROR = 4  # variance of the predicted lateral acceleration, by forces that the model gets wrong
_LAST = WIDTH  # samples of the step before, to tell repeated ones
_OFFSET = 2 * WIDTH  # of the sensors
_Z = 3 * WIDTH
_P = _Z + WIDTH  # covariance
_F = _P + WIDTH * WIDTH  # z(k+1) = F z(k) + ...
_FT = _F + WIDTH * WIDTH
_W = _FT + WIDTH * WIDTH  # scratch
_A_SHARE = _W + WIDTH * WIDTH  # rows of [A G] over the share s
_B_OLD = _A_SHARE + WIDTH * WIDTH  # of the command that acts first in a period
_B_NEW = _B_OLD + WIDTH  # of the one that acts then
_B = _B_NEW + WIDTH  # of a command over a whole period
_B_SHARE = _B + WIDTH  # over the share s
_FELT = _B_SHARE + WIDTH  # h of the accelerometer
_H = _FELT + WIDTH  # h of a sensor
_NEXT = _H + WIDTH  # scratch
_PAST_Z = _NEXT + WIDTH  # z and its covariance `late` periods before the last instant
_PAST_P = _PAST_Z + WIDTH
_DISAGREEMENT = _PAST_P + WIDTH * WIDTH  # mean of the squared innovations of each sensor over their variance
_ASTRAY = _DISAGREEMENT + SENSORS  # positions in a row that are `FAR` from the estimate
_RING = _DISAGREEMENT + WIDTH  # rows of samples, the latest instant first: the sensors, then tau of the pose
_TAU = SENSORS
_TURNED = SENSORS + 1  # rad, by how much the path has turned in the period before the instant


def memory_size(longest: int, late: int) -> int:
    """Numbers that the filter remembers, for a dead time of at most `longest` periods and a share."""
    return _RING + WIDTH * (late + 1) + longest + late + 2


def move_path(memory: Any, states: int, late: int, heading: float, offset: float) -> None:
    """Let heading (rad) and offset (m) of all that is remembered grow by so much: another path lies under the car."""
    for z in (_Z, _PAST_Z):
        memory[z + 1] += heading
        memory[z + states - 1] += offset
    for row in [_LAST, *range(_RING, _RING + WIDTH * (late + 1), WIDTH)]:
        memory[row + MEASURED.yaw] += heading
        memory[row + MEASURED.y] += offset


@inlined
def forget_speed(memory):
    """Let everything that depends on the speed, and on what the model believes, be formed anew."""
    memory[_SPEED] = math.nan


@inlined
def shift_bias(more, side, turn, memory):
    """Explain so much (rad) of the disturbances by a bias: per rad it pushes by `side` (m/s^2) and `turn` (rad/s^2)."""
    for z in (_Z, _PAST_Z):
        memory[z + 3] += more
        memory[z + _STATES] -= side * more
        memory[z + _STATES + 1] -= turn * more


@inlined
def _sent(p):
    """Where the commands that were sent begin, the latest first."""
    return _RING + WIDTH * (whole(p.late) + 1)


@inlined
def _place(sensor, n):
    """Which state a sensor reads, -1: none."""
    if sensor == MEASURED.y:
        return n - 1
    if sensor == MEASURED.wheel_angle:
        return 3 if n == 5 else -1
    return sensor if sensor < _STATES else -1


@exported(void(float64, int64, vector, vector))
def _form(speed, n, parameters, memory):
    """Everything that depends on the speed alone."""
    p, model = _unpack(parameters), parameters[len(NUMBERS) :]
    for i in range(n):
        memory[_B_OLD + i] = 0.0
    if p.share > 0.0:
        path.discretise_rows(speed, (1.0 - p.share) * p.period, model, WIDTH, memory, _F, _B_NEW)
        path.discretise_rows(speed, p.share * p.period, model, WIDTH, memory, _A_SHARE, _B_SHARE)
        for i in range(n):
            for j in range(n):
                memory[_B_OLD + i] += memory[_F + WIDTH * i + j] * memory[_B_SHARE + j]
    path.discretise_rows(speed, p.period, model, WIDTH, memory, _F, _B)
    if not p.share > 0.0:
        for i in range(n):
            memory[_B_NEW + i] = memory[_B + i]
    for i in range(n, WIDTH):
        memory[_F + WIDTH * i + i] = 1.0
    memory[_OF_COMMAND] = path.lateral_acceleration_row(speed, model, n, memory, _FELT)
    memory[_FELT + n] = 1.0
    for i in range(WIDTH):
        for j in range(WIDTH):
            memory[_FT + WIDTH * j + i] = memory[_F + WIDTH * i + j]
    memory[_SPEED] = speed


@inlined
def _carry(states, rows, memory):
    """z = (rows of F) z, for the states alone; the disturbances stay."""
    n = states
    for i in range(n):
        total = 0.0
        for j in range(n + path.DISTURBANCES):
            total += memory[rows + WIDTH * i + j] * memory[_NEXT + j]
        memory[_W + i] = total
    for i in range(n):
        memory[_NEXT + i] = memory[_W + i]


@inlined
def _add_command(n, column, command, memory):
    for i in range(n):
        memory[_NEXT + i] += memory[column + i] * command


@inlined
def _begin(n, p, parameters, measured, command, memory):
    """z and its covariance from the first sample."""
    for i in range(WIDTH):
        memory[_Z + i] = 0.0
        for j in range(WIDTH):
            memory[_P + WIDTH * i + j] = 0.0
    for i in range(n):
        memory[_P + WIDTH * i + i] = UNKNOWN
    if n == 5:
        memory[_Z + 3], memory[_P + WIDTH * 3 + 3] = command, parameters[_DRIFT + MEASURED.wheel_angle]
    for sensor in range(SENSORS):
        memory[_LAST + sensor] = measured[sensor]
        i, variance = _place(sensor, n), parameters[_VARIANCE + sensor]
        if i >= 0 and variance < math.inf and math.isfinite(measured[sensor]) and sensor != MEASURED.wheel_angle:
            memory[_Z + i], memory[_P + WIDTH * i + i] = measured[sensor], variance
    memory[_P + WIDTH * n + n], memory[_P + WIDTH * (n + 1) + n + 1] = p.spread_side, p.spread_turn
    if p.spread_bias > 0.0:
        memory[_P + WIDTH * (n + 2) + n + 2] = p.spread_bias
        memory[_P + WIDTH * 2 + 2] += p.spread_bias
    for i in range(whole(p.longest) + whole(p.late) + 2):
        memory[_sent(p) + i] = command
    for i in range(WIDTH * (whole(p.late) + 1)):
        memory[_RING + i] = math.nan
    for i in range(whole(p.late) + 1):
        memory[_RING + WIDTH * i + _TURNED] = 0.0
    _keep(_Z, _PAST_Z, memory)


@inlined
def _keep(source, target, memory):
    """Copy z and its covariance."""
    for i in range(WIDTH + WIDTH * WIDTH):
        memory[target + i] = memory[source + i]


@inlined
def is_repeated(sensor, last, variance, measured):
    """Whether a sample of a sensor is the one before, by its value."""
    posed = sensor == MEASURED.yaw or sensor == MEASURED.y
    moved = posed and measured[MEASURED.turned] != 0.0
    return measured[sensor] == last and variance > square(LEAST_NOISE[sensor]) and not moved


@inlined
def _sort_in(n, p, measured, parameters, memory):
    """Add the samples that have arrived to the instants at which they were taken."""
    late = whole(p.late)
    for i in range(WIDTH * (late + 1) - 1, WIDTH - 1, -1):
        memory[_RING + i] = memory[_RING + i - WIDTH]
    for i in range(WIDTH):
        memory[_RING + i] = math.nan
    memory[_RING + _TURNED] = measured[MEASURED.turned]
    memory[_BLIND] += 1.0
    for sensor in range(SENSORS):
        value, variance = measured[sensor], parameters[_VARIANCE + sensor]
        repeated = is_repeated(sensor, memory[_LAST + sensor], variance, measured)
        memory[_LAST + sensor] = value
        posed = sensor == MEASURED.yaw or sensor == MEASURED.y
        age = measured[MEASURED.pose_age] if posed else measured[MEASURED.motion_age]
        instants = floor(age / p.period + 0.5) if math.isfinite(age) else 0.0
        if not (math.isfinite(value) and variance < math.inf and 0.0 <= instants <= p.late):
            continue
        if repeated:
            if sensor == MEASURED.y and abs(value - memory[_Z + n - 1]) <= p.bound * sqrt(variance):
                memory[_BLIND] = 0.0
            continue
        row = _RING + WIDTH * whole(instants)
        memory[row + sensor] = value
        if posed:
            memory[row + _TAU] = age - instants * p.period if math.isfinite(age) else 0.0
        if sensor == MEASURED.y:
            memory[_BLIND] = 0.0


@inlined
def _lost_at(instant, p, memory):
    """What the tyres pull less than linear ones in the bend of an instant (m/s^2)."""
    turned = memory[_RING + WIDTH * instant + _TURNED]
    return path.lost(memory[_SPEED] * turned / p.period, p.friction, p.shape) if turned != 0.0 else 0.0


@inlined
def _turn(n, turned, p, memory):
    """Count heading and offset from where the path leads after a period in which it turns evenly."""
    if turned != 0.0:
        memory[_NEXT + 1] -= turned
        memory[_NEXT + n - 1] -= 0.5 * memory[_SPEED] * p.period * turned


@inlined
def _predict(n, size, instant, p, parameters, memory):
    """z and its covariance at an instant, so many before the present one, from a period earlier: F P F' + drift."""
    acting = _sent(p) + whole(p.whole) + instant
    for i in range(size):
        memory[_NEXT + i] = memory[_Z + i]
    memory[_LOST] = _lost_at(instant, p, memory)
    memory[_NEXT + n] += memory[_LOST]
    _carry(n, _F, memory)
    memory[_NEXT + n] = memory[_Z + n]
    _add_command(n, _B_OLD, memory[acting + 1] + p.bias, memory)
    _add_command(n, _B_NEW, memory[acting] + p.bias, memory)
    _turn(n, memory[_RING + WIDTH * instant + _TURNED], p, memory)
    for i in range(size):
        memory[_Z + i] = memory[_NEXT + i]
    for i in range(size):
        row = zeros()
        for k in range(size):
            row = fma8(spread(memory, _F + WIDTH * i + k), load(memory, _P + WIDTH * k), row)
        store(memory, _W + WIDTH * i, row)
    for i in range(size):
        row = zeros()
        for k in range(size):
            row = fma8(spread(memory, _W + WIDTH * i + k), load(memory, _FT + WIDTH * k), row)
        store(memory, _P + WIDTH * i, row)
    for sensor in range(_STATES):
        i = _place(sensor, n)
        if i >= 0:
            memory[_P + WIDTH * i + i] += parameters[_DRIFT + sensor]
    angle = memory[_Z + 3] if n == 5 else memory[acting]
    pull, of_vy, of_r, of_both = path.sliding(
        memory[_SPEED], memory[_Z], memory[_Z + 2], angle, parameters[len(NUMBERS) :]
    )
    share = p.sliding * p.period
    memory[_P] += share * of_vy
    memory[_P + WIDTH * 2 + 2] += share * of_r
    memory[_P + 2] += share * of_both
    memory[_P + WIDTH * 2] += share * of_both
    memory[_SPARE] = max(p.least_spare, p.grip - pull)
    memory[_FELT_ERROR] = p.sliding / (2.0 * p.sliding_time) * of_vy
    memory[_P + WIDTH * n + n] += p.drift_side
    memory[_P + WIDTH * (n + 1) + n + 1] += p.drift_turn
    memory[_P + WIDTH * n + n + 1] += p.drift_both
    memory[_P + WIDTH * (n + 1) + n] += p.drift_both
    if size > n + path.DISTURBANCES:
        memory[_P + WIDTH * (n + 2) + n + 2] += p.drift_bias


@inlined
def _reading(sensor, instant, n, tau, p, memory):
    """Write h of a sensor, tau (s) before an instant; what it reads beside h z."""
    for i in range(WIDTH):
        memory[_H + i] = 0.0
    speed = memory[_SPEED]
    if sensor == MEASURED.lateral_acceleration:
        for i in range(WIDTH):
            memory[_H + i] = memory[_FELT + i]
        return memory[_OF_COMMAND] * memory[_sent(p) + whole(p.whole) + instant] + _lost_at(instant, p, memory)
    memory[_H + _place(sensor, n)] = 1.0
    turning = memory[_RING + WIDTH * instant + _TURNED] / p.period
    if sensor == MEASURED.yaw:
        memory[_H + 2] = -tau
        return tau * turning
    if sensor == MEASURED.y:
        memory[_H], memory[_H + 1], memory[_H + 2] = -tau, -tau * speed, 0.5 * tau * tau * speed
        return -0.5 * tau * tau * speed * turning
    if sensor == MEASURED.yaw_rate and p.spread_bias > 0.0:
        memory[_H + n + 2] = 1.0
    return 0.0


@inlined
def _take_in(value, variance, left_out, size, p, memory):
    """A sensor that reads h z, with h in the scratch: z += K nu, P -= K (P h)', K = P h/(h' P h + R), unless left out.

    Its innovation nu, bounded, and nu^2/(h' P h + R), twice the square of that bound at the most.
    """
    read, row = 0.0, zeros()
    for i in range(size):
        share = memory[_H + i]
        if share != 0.0:
            read += share * memory[_Z + i]
            row = fma8(splat(share), load(memory, _P + WIDTH * i), row)
    store(memory, _W, row)
    scatter = variance
    for i in range(size):
        scatter += memory[_H + i] * memory[_W + i]
    reach = p.bound * sqrt(scatter)
    innovation = clip(value - read, -reach, reach)
    disagreement = min(square(value - read) / scatter, 2.0 * p.bound * p.bound)
    if left_out:
        return innovation, disagreement
    store(memory, _Z, fma8(splat(innovation / scatter), row, load(memory, _Z)))
    gains = mul(splat(1.0 / scatter), row)
    store(memory, _W, gains)
    for j in range(size):
        taken = mul(spread(memory, _W + j), row)
        store(memory, _P + WIDTH * j, sub(load(memory, _P + WIDTH * j), taken))
    return innovation, disagreement


@inlined
def _correct(n, size, instant, p, parameters, memory):
    """Take in the samples of an instant, so many before the present one."""
    row = _RING + WIDTH * instant
    for sensor in range(SENSORS):
        value = memory[row + sensor]
        if not math.isfinite(value) or (sensor == MEASURED.wheel_angle and n == 4):
            continue
        beside = _reading(sensor, instant, n, memory[row + _TAU], p, memory) + memory[_OFFSET + sensor]
        variance = parameters[_VARIANCE + sensor]
        if sensor == MEASURED.lateral_acceleration:
            variance += memory[_FELT_ERROR]
        left_out = memory[LEFT_OUT] == sensor + 1
        innovation, disagreement = _take_in(value - beside, variance, left_out, size, p, memory)
        if instant == p.late:  # every sample once
            share = p.regaining if left_out else p.forgetting
            memory[_DISAGREEMENT + sensor] += share * (disagreement - memory[_DISAGREEMENT + sensor])
        if left_out or instant > 0:
            continue
        if sensor == MEASURED.lateral_acceleration or sensor == MEASURED.wheel_angle:
            memory[_OFFSET + sensor] += p.settling * innovation


@inlined
def _choose_left_out(p, parameters, memory):
    """Leave out the redundant sensor that disagrees the most, beyond the bound; take it back once it agrees.

    Where the model is wrong the gyro disagrees at least as much as the others, and the heading does not; where the gyro
    is, the heading disagrees with it. A sensor without noise of its own is never left out: it is the model that errs.
    """
    worst, most = 0, p.distrust
    for sensor in range(SENSORS):
        found = memory[_DISAGREEMENT + sensor]
        if sensor == MEASURED.yaw_rate:
            found = memory[_DISAGREEMENT + MEASURED.yaw]
        elif found < memory[_DISAGREEMENT + MEASURED.yaw_rate] or sensor == MEASURED.yaw or sensor == MEASURED.y:
            continue
        if found > most and parameters[_VARIANCE + sensor] > square(LEAST_NOISE[sensor]):
            worst, most = sensor + 1, found
    out = whole(memory[LEFT_OUT])
    if out == 0:
        memory[LEFT_OUT] = float(worst)
    elif memory[_DISAGREEMENT + out - 1] < p.trust:
        memory[LEFT_OUT] = 0.0


@inlined
def _roll(n, p, memory):
    """x at the time when the new command begins to act, in the scratch."""
    waiting, sent = whole(p.whole), _sent(p)
    for i in range(n + path.DISTURBANCES):
        memory[_NEXT + i] = memory[_Z + i]
    memory[_NEXT + n] += memory[_LOST]
    if p.share > 0.0:
        _carry(n, _A_SHARE, memory)
        _add_command(n, _B_SHARE, memory[sent + waiting] + p.bias, memory)
    for j in range(waiting - 1, -1, -1):
        _carry(n, _F, memory)
        _add_command(n, _B, memory[sent + j] + p.bias, memory)


@inlined
def _go_on(n, size, p, parameters, memory):
    """From z of `late` periods before the last instant to the present one."""
    late = whole(p.late)
    first = min(late, whole(memory[_COUNT]) - 1)
    if late > 0:
        _keep(_PAST_Z, _Z, memory)
    for instant in range(first, -1, -1):
        _predict(n, size, instant, p, parameters, memory)
        _correct(n, size, instant, p, parameters, memory)
        most = memory[_SPARE] / max(abs(memory[_Z + n]), memory[_SPARE])
        memory[_Z + n] *= most
        memory[_Z + n + 1] *= most
        if late > 0 and instant == late:
            _keep(_Z, _PAST_Z, memory)
    _choose_left_out(p, parameters, memory)


@inlined
def _is_lost(memory):
    """Whether z or a variance is not finite."""
    total = 0.0
    for i in range(WIDTH):
        total += memory[_Z + i] + memory[_PAST_Z + i] + memory[_P + (WIDTH + 1) * i] + memory[_PAST_P + (WIDTH + 1) * i]
    return not math.isfinite(total)


@inlined
def _is_astray(n, measured, memory):
    """Whether position or heading have been elsewhere for so long that bounded innovations would not bring z back."""
    y, yaw = measured[MEASURED.y], measured[MEASURED.yaw]
    if math.isfinite(y) and math.isfinite(yaw) and memory[_COUNT] > 0.5:
        far = abs(y - memory[_Z + n - 1]) > FAR or abs(yaw - memory[_Z + 1]) > FAR_TURNED
        memory[_ASTRAY] = memory[_ASTRAY] + 1.0 if far else 0.0
    return memory[_ASTRAY] >= ASTRAY


@exported(ESTIMATE)
def kalman(speed, measured, command, a, b, parameters, memory, x, d):
    """See `contract.ESTIMATE`."""
    p, n = _unpack(parameters), x.size
    size = n + path.DISTURBANCES + (1 if p.spread_bias > 0.0 else 0)
    if speed != memory[_SPEED] and math.isfinite(speed):
        _form(speed, n, parameters, memory)
    if _is_lost(memory) or _is_astray(n, measured, memory):
        memory[:] = 0.0
        memory[_SPEED] = math.nan
        if math.isfinite(speed):
            _form(speed, n, parameters, memory)
    if memory[_COUNT] > 0.5:
        sent = _sent(p)
        for i in range(whole(p.longest) + whole(p.late) + 1, 0, -1):
            memory[sent + i] = memory[sent + i - 1]
        memory[sent] = command
        _sort_in(n, p, measured, parameters, memory)
        _go_on(n, size, p, parameters, memory)
    else:
        _begin(n, p, parameters, measured, command, memory)
    memory[_COUNT] += 1.0
    _roll(n, p, memory)
    known = memory[_BLIND] <= p.patience
    for i in range(n):
        x[i] = memory[_NEXT + i] if known else math.nan
        d[i] = (
            memory[_F + WIDTH * i + n] * (memory[_Z + n] + memory[_LOST])
            + memory[_F + WIDTH * i + n + 1] * memory[_Z + n + 1]
            + memory[_B + i] * p.bias
        )
    return memory[_BLIND] * p.period

"""A Kalman filter on the path model: its state, a lateral and a yaw disturbance, behind the dead time of the steering.

    z = [x, d_y, d_r],   x(k+1) = A x(k) + B u + G d(k) + noise,   d(k+1) = d(k) + noise

The command of instant j acts from T_d = (m + s) T after it (m whole periods, a share s of one more). Between two
instants the filter carries z along with the commands that acted; what it hands to the controller is x at the time when
the new command begins to act, carried on through the commands already sent. The noise of v_y and r grows with the force
of the axles, for what a tyre slides away is not in the model. Each sensor is taken in by itself, so one
that is missing (not finite) is left out; an innovation counts up to `bound` of its own standard deviations.
"""

from __future__ import annotations

import math

from numba import types

from ..abi import INLINE, ROUTINE, float64, int64, njit, record, unpacker, vector
from ..maths.elementary import clip
from ..maths.vectors import WIDTH, fma8, load, mul, splat, spread, store, sub, zeros
from ..models import path
from ..models.contract import MEASURED
from ..plants.forces import GRAVITY
from .contract import ESTIMATE

NUMBERS = (
    "period",  # s
    "whole", "share",  # dead time in periods: m, and the share s of one more, 0 <= s < 1
    "bound",  # standard deviations up to which an innovation counts
    "variance_vy", "variance_yaw", "variance_yaw_rate", "variance_y", "variance_wheel_angle",  # of sensors; inf: none
    "drift_vy", "drift_yaw", "drift_yaw_rate", "drift_y", "drift_wheel_angle",  # variances that a period adds
    "drift_side", "drift_turn", "drift_both",  # likewise, of d_y and d_r, and their covariance
    "spread_side", "spread_turn",  # variances of d_y and d_r before the first sample
    "sliding",  # s^0.5, how uncertain the force of an axle is, in its square over its load
)  # fmt: skip
Numbers = record("Numbers", NUMBERS)
"""What the parameters begin with; those of the path model follow."""
_unpack = unpacker(Numbers)
_SENSORS = len(MEASURED)
_VARIANCE, _DRIFT = NUMBERS.index("variance_vy"), NUMBERS.index("drift_vy")
SLOWEST = 3.0
"""m/s: slip angles are formed with at least this speed, for noise over a small one is no slip."""
UNKNOWN = 1e2
"""Variance of a state of which the first sample says nothing."""

# Memory, in rows of the vector width; matrices take eight rows.
_STARTED, _SPEED = 0, 1
_Z = WIDTH
_P = 2 * WIDTH  # covariance
_F = _P + WIDTH * WIDTH  # z(k+1) = F z(k) + ...
_FT = _F + WIDTH * WIDTH
_W = _FT + WIDTH * WIDTH  # scratch
_A_SHARE = _W + WIDTH * WIDTH  # rows of [A G] over the share s
_B_OLD = _A_SHARE + WIDTH * WIDTH  # of the command that acts first in a period
_B_NEW = _B_OLD + WIDTH  # of the one that acts then
_B = _B_NEW + WIDTH  # of a command over a whole period
_B_SHARE = _B + WIDTH  # over the share s
_NEXT = _B_SHARE + WIDTH  # scratch
_SENT = _NEXT + WIDTH  # commands sent, the latest first


def memory_size(whole: int) -> int:
    """Numbers that the filter remembers, for a dead time of `whole` periods and a share."""
    return _SENT + whole + 2


@njit(**INLINE)
def _place(sensor, n):
    """Which state a sensor reads, -1: none."""
    if sensor == MEASURED.y:
        return n - 1
    if sensor == MEASURED.wheel_angle:
        return 3 if n == 5 else -1
    return sensor


@njit(types.void(float64, int64, vector, vector), **ROUTINE)
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
    for i in range(n, n + path.DISTURBANCES):
        memory[_F + WIDTH * i + i] = 1.0
    for i in range(WIDTH):
        for j in range(WIDTH):
            memory[_FT + WIDTH * j + i] = memory[_F + WIDTH * i + j]
    memory[_SPEED] = speed


@njit(**INLINE)
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


@njit(**INLINE)
def _add_command(n, column, command, memory):
    for i in range(n):
        memory[_NEXT + i] += memory[column + i] * command


@njit(**INLINE)
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
    for sensor in range(_SENSORS):
        i, variance = _place(sensor, n), parameters[_VARIANCE + sensor]
        if i >= 0 and variance < math.inf and math.isfinite(measured[sensor]):
            memory[_Z + i], memory[_P + WIDTH * i + i] = measured[sensor], variance
    memory[_P + WIDTH * n + n], memory[_P + WIDTH * (n + 1) + n + 1] = p.spread_side, p.spread_turn
    memory[_STARTED] = 1.0


@njit(**INLINE)
def _sliding(slip, stiffness, load, p):
    """Variance (N^2 s^2) that a period adds to the impulse of an axle: (sliding F^2/F_z)^2 T, F = C alpha <= F_z.

    In the brush model an axle loses F^2/(3 mu F_z) to sliding, in first order (Pacejka, Tire and Vehicle Dynamics,
    3rd ed., section 3.2); mu is not known, and so neither is the loss.
    """
    force = min(stiffness * abs(slip), load)
    return (p.sliding * force * force / load) ** 2 * p.period


@njit(**INLINE)
def _add_sliding(speed, n, p, parameters, memory):
    """What the tyres' sliding adds to the covariance of v_y and r, at the slip of the predicted state."""
    c = path.unpack(parameters[len(NUMBERS) :])
    pace, weight = max(speed, SLOWEST), c.mass * GRAVITY / (c.lf + c.lr)
    angle = memory[_Z + 3] if n == 5 else memory[_SENT + int(p.whole)]
    vy, yaw_rate = memory[_Z + MEASURED.vy], memory[_Z + MEASURED.yaw_rate]
    front = _sliding(angle - (vy + c.lf * yaw_rate) / pace, 2.0 * c.stiffness_front, weight * c.lr, p)
    rear = _sliding((vy - c.lr * yaw_rate) / pace, 2.0 * c.stiffness_rear, weight * c.lf, p)
    side, turn = _P + WIDTH * MEASURED.vy, _P + WIDTH * MEASURED.yaw_rate
    both = (c.lf * front - c.lr * rear) / (c.mass * c.yaw_inertia)
    memory[side + MEASURED.vy] += (front + rear) / (c.mass * c.mass)
    memory[turn + MEASURED.yaw_rate] += (c.lf * c.lf * front + c.lr * c.lr * rear) / (c.yaw_inertia * c.yaw_inertia)
    memory[side + MEASURED.yaw_rate] += both
    memory[turn + MEASURED.vy] += both


@njit(**INLINE)
def _predict(n, p, parameters, memory):
    """z and its covariance at this instant from those at the last one: F P F' + drift."""
    size, whole = n + path.DISTURBANCES, int(p.whole)
    for i in range(size):
        memory[_NEXT + i] = memory[_Z + i]
    _carry(n, _F, memory)
    _add_command(n, _B_OLD, memory[_SENT + whole + 1], memory)
    _add_command(n, _B_NEW, memory[_SENT + whole], memory)
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
    for sensor in range(_SENSORS):
        i = _place(sensor, n)
        if i >= 0:
            memory[_P + WIDTH * i + i] += parameters[_DRIFT + sensor]
    memory[_P + WIDTH * n + n] += p.drift_side
    memory[_P + WIDTH * (n + 1) + n + 1] += p.drift_turn
    memory[_P + WIDTH * n + n + 1] += p.drift_both
    memory[_P + WIDTH * (n + 1) + n] += p.drift_both


@njit(**INLINE)
def _take_in(i, value, variance, bound, size, memory):
    """One sensor that reads state i: z += K nu, P -= K P_i."""
    scatter = memory[_P + WIDTH * i + i] + variance
    reach = bound * math.sqrt(scatter)
    innovation = clip(value - memory[_Z + i], -reach, reach)
    row = load(memory, _P + WIDTH * i)
    store(memory, _Z, fma8(splat(innovation / scatter), row, load(memory, _Z)))
    gains = mul(splat(1.0 / scatter), row)
    store(memory, _W, gains)
    for j in range(size):
        taken = mul(spread(memory, _W + j), row)
        store(memory, _P + WIDTH * j, sub(load(memory, _P + WIDTH * j), taken))


@njit(**INLINE)
def _remember(command, whole, memory):
    for i in range(whole + 1, 0, -1):
        memory[_SENT + i] = memory[_SENT + i - 1]
    memory[_SENT] = command


@njit(**INLINE)
def _roll(n, p, memory):
    """x at the time when the new command begins to act, in the scratch."""
    whole = int(p.whole)
    for i in range(n + path.DISTURBANCES):
        memory[_NEXT + i] = memory[_Z + i]
    if p.share > 0.0:
        _carry(n, _A_SHARE, memory)
        _add_command(n, _B_SHARE, memory[_SENT + whole], memory)
    for j in range(whole - 1, -1, -1):
        _carry(n, _F, memory)
        _add_command(n, _B, memory[_SENT + j], memory)


@njit(ESTIMATE, **ROUTINE)
def kalman(speed, measured, command, a, b, parameters, memory, x, d):
    """See `contract.ESTIMATE`."""
    p, n = _unpack(parameters), x.size
    whole = int(p.whole)
    if speed != memory[_SPEED] and math.isfinite(speed):
        _form(speed, n, parameters, memory)
    if memory[_STARTED] > 0.5:
        _remember(command, whole, memory)
        _predict(n, p, parameters, memory)
        _add_sliding(speed, n, p, parameters, memory)
    else:
        for i in range(whole + 2):
            memory[_SENT + i] = command
        _begin(n, p, parameters, measured, command, memory)
    for sensor in range(_SENSORS):
        i, variance = _place(sensor, n), parameters[_VARIANCE + sensor]
        if i >= 0 and variance < math.inf and math.isfinite(measured[sensor]):
            _take_in(i, measured[sensor], variance, p.bound, n + path.DISTURBANCES, memory)
    _roll(n, p, memory)
    for i in range(n):
        x[i] = memory[_NEXT + i]
        d[i] = memory[_F + WIDTH * i + n] * memory[_Z + n] + memory[_F + WIDTH * i + n + 1] * memory[_Z + n + 1]

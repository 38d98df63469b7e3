"""A user's plant: one right-hand side on plain vectors, integrated one vehicle after the other."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

from numba import types

from ..abi import INLINE, columns, njit, vector
from ..maths.elementary import clip
from .contract import ADVANCE, ENVIRONMENT, INPUT, MOTION, OBSERVE, STATE, CompiledPlant, input_at, state_at
from .forces import wheel_angle

RIGHT_HAND_SIDE = types.void(vector, vector, vector, vector, vector)
"""``right_hand_side(x, u, environment, p, dx)`` writes dx/dt.

x: at least (X, Y, yaw, v_x, v_y, yaw rate), then the plant's own states; u: steering angle of the front wheels
(rad), longitudinal force demanded at the wheels (N); environment: friction of the four wheels, wind along X and Y;
p: the plant's own parameters.
"""

ACTUATOR = columns("lag", "rate", "limit")
"""A user's parameters are packed behind these three of the steering: s, rad/s, rad."""
OWN = len(ACTUATOR)
"""Where the plant's own parameters begin."""
_X, _K1, _K2, _K3, _K4, _U, _AROUND = range(7)  # the rows of `work`


@njit(**INLINE)
def _read_inputs(parameters, block, slot, work):
    """Copy force and environment of a slot to scratch; returns the command within the steering's limit."""
    work[_U, 1] = block[input_at(INPUT.force, slot)]
    for j in range(ENVIRONMENT):
        work[_AROUND, j] = block[input_at(INPUT.friction_front_left + j, slot)]
    limit = parameters[ACTUATOR.limit]
    return clip(block[input_at(INPUT.command, slot)], -limit, limit)


@njit(**INLINE)
def _runge_kutta_step(right_hand_side, parameters, x0, angle, command, acceleration, h, work):
    """One step of a vehicle with states x0 (n,), which is advanced; returns the steering angle after it."""
    n = x0.size
    lag, fastest = parameters[ACTUATOR.lag], parameters[ACTUATOR.rate]
    x, u, around = work[_X, :n], work[_U, :2], work[_AROUND, :ENVIRONMENT]
    slope, rise = 0.0, 0.0
    for stage in range(4):
        reach = 0.0 if stage == 0 else (h if stage == 3 else 0.5 * h)
        for j in range(n):
            x[j] = x0[j] + reach * work[_K1 + max(stage - 1, 0), j] if stage > 0 else x0[j]
        u[0] = angle + reach * slope
        slope = clip((command - u[0]) / lag, -fastest, fastest) if lag > 0.0 else 0.0
        rise += slope * (h / 6.0 if stage == 0 or stage == 3 else h / 3.0)
        k = work[_K1 + stage, :n]
        right_hand_side(x, u, around, parameters[OWN:], k)
        if acceleration == acceleration:  # prescribed
            k[STATE.vx] = acceleration
    for j in range(n):
        x0[j] += h / 6.0 * (work[_K1, j] + 2.0 * work[_K2, j] + 2.0 * work[_K3, j] + work[_K4, j])
    return angle + rise


@njit(**INLINE)
def _advance(right_hand_side, parameters, block, states, work, slots, steps):
    """See `contract.ADVANCE`; steps: (substeps, h)."""
    substeps, h = steps
    for i in range(slots):
        command = _read_inputs(parameters, block, i, work)
        acceleration = block[input_at(INPUT.acceleration, i)]
        angle = block[state_at(STATE.steering, i)] if parameters[ACTUATOR.lag] > 0.0 else command
        for _ in range(substeps):
            angle = _runge_kutta_step(right_hand_side, parameters, states[i], angle, command, acceleration, h, work)
        for j in range(MOTION):
            block[state_at(j, i)] = states[i, j]
        block[state_at(STATE.steering, i)] = angle


@njit(**INLINE)
def _observe(right_hand_side, parameters, block, states, work, slot, seen):
    """See `contract.OBSERVE`."""
    n = states.shape[1]
    command = _read_inputs(parameters, block, slot, work)
    angle = wheel_angle(
        block[state_at(STATE.steering, slot)], command, parameters[ACTUATOR.lag], parameters[ACTUATOR.limit]
    )
    work[_U, 0] = angle
    x, slope = work[_X, :n], work[_K1, :n]
    for j in range(n):
        x[j] = states[slot, j]
    right_hand_side(x, work[_U, :2], work[_AROUND, :ENVIRONMENT], parameters[OWN:], slope)
    seen[0] = slope[STATE.vy] + x[STATE.vx] * x[STATE.yaw_rate] - block[input_at(INPUT.bank, slot)]
    seen[1] = angle


@lru_cache(maxsize=64)
def compile_plant(function: Any) -> CompiledPlant:
    """A user's right-hand side and its integration, compiled; numba's own error when it cannot be."""
    plain = getattr(function, "py_func", function)
    options: dict[str, Any] = {"nogil": True, "error_model": "numpy"}
    right_hand_side = njit(RIGHT_HAND_SIDE, **options)(plain)

    @njit(ADVANCE, **options)
    def advance(parameters, block, states, work, slots, substeps, h):
        _advance(right_hand_side, parameters, block, states, work, slots, (substeps, h))

    @njit(OBSERVE, **options)
    def observe(parameters, block, states, work, slot, seen):
        _observe(right_hand_side, parameters, block, states, work, slot, seen)

    return CompiledPlant(right_hand_side, advance, observe)

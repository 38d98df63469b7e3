"""Fixed-step Runge-Kutta integration of a batch of vehicles, and what it asks of a built-in plant.

Each plant's file hands in its own right-hand side and the tyre law as constants: the compiler builds a vectorised loop
of straight arithmetic for each law that is asked for.
"""

from __future__ import annotations

from ..kernel import fma, inlined
from .contract import GROUP, INPUT, INPUTS, SLOTS, STATE, STATES, input_at, state_at
from .forces import wheel_angle
from .parameters import unpack

_INPUT = STATES * SLOTS  # where a block's inputs begin


@inlined
def _step_along(x, h, k):
    """x + h k."""
    return (
        fma(h, k[0], x[0]),
        fma(h, k[1], x[1]),
        fma(h, k[2], x[2]),
        fma(h, k[3], x[3]),
        fma(h, k[4], x[4]),
        fma(h, k[5], x[5]),
        fma(h, k[6], x[6]),
        fma(h, k[7], x[7]),
        fma(h, k[8], x[8]),
        fma(h, k[9], x[9]),
        fma(h, k[10], x[10]),
        fma(h, k[11], x[11]),
        fma(h, k[12], x[12]),
    )


@inlined
def _rk4(right_hand_side, x, u, h, c, law):
    """One step of the classical fourth-order Runge-Kutta method."""
    k1 = right_hand_side(x, u, c, law)
    k2 = right_hand_side(_step_along(x, 0.5 * h, k1), u, c, law)
    k3 = right_hand_side(_step_along(x, 0.5 * h, k2), u, c, law)
    k4 = right_hand_side(_step_along(x, h, k3), u, c, law)
    x = _step_along(x, h / 6.0, k1)
    x = _step_along(x, h / 3.0, k2)
    x = _step_along(x, h / 3.0, k3)
    return _step_along(x, h / 6.0, k4)


@inlined
def _load(z, i):
    return (
        z[i],
        z[SLOTS + i],
        z[2 * SLOTS + i],
        z[3 * SLOTS + i],
        z[4 * SLOTS + i],
        z[5 * SLOTS + i],
        z[6 * SLOTS + i],
        z[7 * SLOTS + i],
        z[8 * SLOTS + i],
        z[9 * SLOTS + i],
        z[10 * SLOTS + i],
        z[11 * SLOTS + i],
        z[12 * SLOTS + i],
    )


@inlined
def _store(z, i, x):
    z[i] = x[0]
    z[SLOTS + i] = x[1]
    z[2 * SLOTS + i] = x[2]
    z[3 * SLOTS + i] = x[3]
    z[4 * SLOTS + i] = x[4]
    z[5 * SLOTS + i] = x[5]
    z[6 * SLOTS + i] = x[6]
    z[7 * SLOTS + i] = x[7]
    z[8 * SLOTS + i] = x[8]
    z[9 * SLOTS + i] = x[9]
    z[10 * SLOTS + i] = x[10]
    z[11 * SLOTS + i] = x[11]
    z[12 * SLOTS + i] = x[12]


@inlined
def _load_input(z, i):
    j = _INPUT + i
    return (
        z[j],
        z[SLOTS + j],
        z[2 * SLOTS + j],
        z[3 * SLOTS + j],
        z[4 * SLOTS + j],
        z[5 * SLOTS + j],
        z[6 * SLOTS + j],
        z[7 * SLOTS + j],
        z[8 * SLOTS + j],
        z[9 * SLOTS + j],
    )


@inlined
def _sweep(right_hand_side, block, slots, substeps, h, c, law):
    for _ in range(substeps):
        for i in range(slots):
            x = _load(block, i)
            u = _load_input(block, i)
            _store(block, i, _rk4(right_hand_side, x, u, h, c, law))


@inlined
def _fill_group(block, slots):
    """Copy slot 0 to the slots between the last vehicle and the next multiple of GROUP; returns that multiple."""
    whole = (slots + GROUP - 1) // GROUP * GROUP
    for i in range(slots, whole):
        for row in range(STATES + INPUTS):
            block[row * SLOTS + i] = block[row * SLOTS]
    return whole


@inlined
def advance_all(right_hand_side, parameters, block, slots, steps, law):
    """Advance the first `slots` vehicles of a built-in plant, see `contract.ADVANCE`; steps: (substeps, h)."""
    substeps, h = steps
    _sweep(right_hand_side, block, _fill_group(block, slots), substeps, h, unpack(parameters), law)


@inlined
def observe_one(right_hand_side, parameters, block, slot, seen, law):
    """Lateral acceleration and front-wheel angle of a built-in plant's vehicle, see `contract.OBSERVE`."""
    c = unpack(parameters)
    x = _load(block, slot)
    u = _load_input(block, slot)
    slope = right_hand_side(x, u, c, law)
    seen[0] = slope[STATE.vy] + x[STATE.vx] * x[STATE.yaw_rate] - u[INPUT.bank]
    command = block[input_at(INPUT.command, slot)]
    seen[1] = wheel_angle(block[state_at(STATE.steering, slot)], command, c.steering_lag, c.steering_limit)


@inlined
def slope_of(right_hand_side, x, u, parameters, dx, law):
    """Write dx/dt (STATES,) of a built-in plant at state x (STATES,) and input u (INPUTS,)."""
    state = (x[0], x[1], x[2], x[3], x[4], x[5], x[6], x[7], x[8], x[9], x[10], x[11], x[12])
    inputs = (u[0], u[1], u[2], u[3], u[4], u[5], u[6], u[7], u[8], u[9])
    slope = right_hand_side(state, inputs, unpack(parameters), law)
    dx[0], dx[1], dx[2], dx[3], dx[4], dx[5], dx[6] = slope[0:7]
    dx[7], dx[8], dx[9], dx[10], dx[11], dx[12] = slope[7:13]

"""A user's plant: one right-hand side on plain vectors, integrated one vehicle after the other.

One that is moved outside the kernels is `STEPPED`: whoever moves it writes its state to the batch.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np

from ..kernel import Caller, columns, exported, inlined, vector, void
from ..maths.exact import clip
from ..member import member
from ..physics.forces import wheel_angle
from . import contract
from .contract import ENVIRONMENT, OBSERVED, PLANT_STATE, CompiledPlant, state_at

RIGHT_HAND_SIDE = void(vector, vector, vector, vector, vector)
call_right_hand_side = Caller(RIGHT_HAND_SIDE)
"""``right_hand_side(x, u, environment, p, dx)`` writes dx/dt.

x: at least (X, Y, yaw, v_x, v_y, yaw rate), then the plant's own states; u: see `U`; environment: friction of the four
wheels, wind along X and Y (m/s), pull of the bank (m/s^2), and the grade of the road for a plant that takes it; p: the
plant's own parameters.
"""

U = columns(
    "steering",  # rad, angle of the front wheels
    "force",  # N, longitudinal, at the wheels, behind drive and brakes; 0 while the speed is prescribed
    "acceleration",  # m/s^2, prescribed dv_x/dt; NaN: none, the force acts
)
"""A right-hand side's input."""
USER_ACTUATOR = columns("lag", "rate", "limit", "grade")
"""A user's parameters are packed behind three of the steering (s, rad/s, rad) and 1 where the plant takes the grade."""
USER_PARAMETERS = len(USER_ACTUATOR)
"""Where the plant's own parameters begin."""
_X, _K1, _K2, _K3, _K4, _GIVEN, _AROUND = range(7)  # the rows of `work`


@inlined
def _read_inputs(parameters, block, slot, work):
    """Copy speed control and environment of a slot to scratch; returns the command within the steering's limit."""
    inputs, limit = contract.input_of(block, slot), parameters[USER_ACTUATOR.limit]
    work[_GIVEN, U.force], work[_GIVEN, U.acceleration] = inputs.force, inputs.acceleration
    for j in range(ENVIRONMENT):
        work[_AROUND, j] = block[contract.input_at(contract.PLANT_INPUT.friction_front_left + j, slot)]
    work[_AROUND, ENVIRONMENT] = inputs.grade
    return clip(inputs.command, -limit, limit)


@inlined
def _environment_size(parameters):
    """Number of entries of the environment that a right-hand side reads: with the grade if the plant takes it."""
    return ENVIRONMENT + (1 if parameters[USER_ACTUATOR.grade] > 0.0 else 0)


@inlined
def _runge_kutta_step(member, parameters, x0, angle, command, h, work):
    """One step of a vehicle with states x0 (n,), which is advanced; returns the steering angle after it."""
    n, acceleration = x0.size, work[_GIVEN, U.acceleration]
    lag, fastest = parameters[USER_ACTUATOR.lag], parameters[USER_ACTUATOR.rate]
    x, u, around = work[_X, :n], work[_GIVEN, : len(U)], work[_AROUND, : _environment_size(parameters)]
    k, slope, rise = work[_K1, :n], 0.0, 0.0
    for stage in range(4):
        reach = 0.0 if stage == 0 else (h if stage == 3 else 0.5 * h)
        for j in range(n):
            x[j] = x0[j] + reach * k[j] if stage > 0 else x0[j]
        u[U.steering] = angle + reach * slope
        slope = clip((command - u[U.steering]) / lag, -fastest, fastest) if lag > 0.0 else 0.0
        rise += slope * (h / 6.0 if stage == 0 or stage == 3 else h / 3.0)
        k = work[_K1 + stage, :n]
        call_right_hand_side(member, x, u, around, parameters[USER_PARAMETERS:], k)
        if acceleration == acceleration:  # prescribed
            k[PLANT_STATE.vx] = acceleration
    for j in range(n):
        x0[j] += h / 6.0 * (work[_K1, j] + 2.0 * work[_K2, j] + 2.0 * work[_K3, j] + work[_K4, j])
    return angle + rise


@exported(contract.ADVANCE, name="user_advance")
def advance(member, parameters, block, states, work, slots, substeps, h):
    """See `contract.ADVANCE`."""
    for i in range(slots):
        command = _read_inputs(parameters, block, i, work)
        angle = block[state_at(PLANT_STATE.steering, i)] if parameters[USER_ACTUATOR.lag] > 0.0 else command
        braked = contract.input_of(block, i).force < 0.0
        for _ in range(substeps):
            speed = states[i, PLANT_STATE.vx]
            angle = _runge_kutta_step(member, parameters, states[i], angle, command, h, work)
            if braked and speed >= 0.0 and states[i, PLANT_STATE.vx] < 0.0:
                states[i, PLANT_STATE.vx] = 0.0  # brakes do not push a car backwards
        for j in range(contract.MOTION_STATES):
            block[state_at(j, i)] = states[i, j]
        block[state_at(PLANT_STATE.steering, i)] = angle


@exported(contract.OBSERVE, name="user_observe")
def observe(member, parameters, block, states, work, slot, observed):
    """See `contract.OBSERVE`."""
    _, n = states.shape
    command = _read_inputs(parameters, block, slot, work)
    steering, limit = block[state_at(PLANT_STATE.steering, slot)], parameters[USER_ACTUATOR.limit]
    angle = wheel_angle(steering, command, parameters[USER_ACTUATOR.lag], limit)
    work[_GIVEN, U.steering] = angle
    x, slope = work[_X, :n], work[_K1, :n]
    x[:] = states[slot]
    around = work[_AROUND, : _environment_size(parameters)]
    call_right_hand_side(member, x, work[_GIVEN, : len(U)], around, parameters[USER_PARAMETERS:], slope)
    lateral = slope[PLANT_STATE.vy] + x[PLANT_STATE.vx] * x[PLANT_STATE.yaw_rate]
    observed[OBSERVED.lateral_acceleration] = lateral - contract.input_of(block, slot).bank
    observed[OBSERVED.wheel_angle] = angle


def layout_of(parameters: Mapping[str, Any]) -> Any:
    """The structured data type of nested parameters, all float64: ``p.tyre.shape`` for ``{"tyre": {"shape": ...}}``."""
    columns = [(name, layout_of(value) if isinstance(value, Mapping) else "f8") for name, value in parameters.items()]
    return np.dtype((np.record, np.dtype(columns)))


@lru_cache(maxsize=64)
def compile_plant(function: Any, layout: Any = None) -> CompiledPlant:
    """A user's right-hand side as a member, and its integration.

    layout: of the record (`layout_of`) as which the function takes its parameters; None: they are a vector.
    """
    plant_member = member(function, RIGHT_HAND_SIDE, viewed=layout)
    return CompiledPlant(plant_member, advance, observe, plant_member)


STEPPED_ACTUATOR = columns("lag", "limit")
"""Its parameters: those of the steering, s and rad."""
LATERAL_ACCELERATION = contract.MOTION_STATES
"""Its own states are the motion, then the lateral acceleration (m/s^2) over the last period."""


@exported(contract.OBSERVE, name="stepped_observe")
def observe_stepped(member, parameters, block, states, work, slot, observed):
    """See `contract.OBSERVE`."""
    observed[OBSERVED.lateral_acceleration] = states[slot, LATERAL_ACCELERATION]
    observed[OBSERVED.wheel_angle] = wheel_angle(
        block[state_at(PLANT_STATE.steering, slot)], contract.input_of(block, slot).command,
        parameters[STEPPED_ACTUATOR.lag], parameters[STEPPED_ACTUATOR.limit],
    )  # fmt: skip


STEPPED = CompiledPlant(right_hand_side=None, advance=None, observe=observe_stepped)

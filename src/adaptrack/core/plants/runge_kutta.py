"""Fixed-step Runge-Kutta integration of a batch of vehicles, and what it asks of a built-in plant.

Each plant's file hands in its own right-hand side and the tyre law as constants: the compiler builds a vectorised loop
of straight arithmetic for each law that is used.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

from ..kernel import exported, inlined, packer, stepper, unpacker, vector, void
from ..models.car import unpack
from ..physics.forces import stops, wheel_angle
from ..physics.tyre import TYRE_NAMES
from . import contract
from .contract import PLANT_STATE, SLOTS, PlantInput, PlantState

_along = stepper(PlantState)
_state, _input, _set_slope = unpacker(PlantState), unpacker(PlantInput), packer(PlantState)
_set_state = packer(PlantState, SLOTS)  # of a block


@inlined
def _runge_kutta_step(right_hand_side, x, u, h, c, law):
    """One step of the classical fourth-order Runge-Kutta method."""
    slope = right_hand_side(x, u, c, law)
    after = _along(x, h / 6.0, slope)
    slope = right_hand_side(_along(x, 0.5 * h, slope), u, c, law)
    after = _along(after, h / 3.0, slope)
    slope = right_hand_side(_along(x, 0.5 * h, slope), u, c, law)
    after = _along(after, h / 3.0, slope)
    slope = right_hand_side(_along(x, h, slope), u, c, law)
    return _along(after, h / 6.0, slope)


@inlined
def _sweep(right_hand_side, block, slots, steps, c, law):
    substeps, h = steps
    for _ in range(substeps):
        for i in range(slots):
            x, u = contract.state_of(block, i), contract.input_of(block, i)
            after = _runge_kutta_step(right_hand_side, x, u, h, c, law)
            _set_state(block, i, after)
            rests = stops(x.vx, after.vx, h, u, c)
            block[PLANT_STATE.vx * SLOTS + i] = 0.0 if rests else after.vx
            block[PLANT_STATE.vy * SLOTS + i] = 0.0 if rests else after.vy
            block[PLANT_STATE.yaw_rate * SLOTS + i] = 0.0 if rests else after.yaw_rate


@inlined
def _fill_group(block, slots):
    """Copy slot 0 to the slots between the last vehicle and the next multiple of GROUP; returns that multiple.

    A vehicle alone stays so: where registers hold two numbers, seven others would cost four times as much.
    """
    group = contract.GROUP
    padded_slots = slots if slots == 1 else (slots + group - 1) // group * group
    for i in range(slots, padded_slots):
        for row in range(contract.PLANT_STATES + contract.PLANT_INPUTS):
            block[row * SLOTS + i] = block[row * SLOTS]
    return padded_slots


def plants_on_tyres(name: str, right_hand_side: Any) -> Callable[[int], contract.CompiledPlant]:
    """A function that gives a built-in plant on tyres of a law (`physics.tyre`); those of all laws are made at once."""

    @cache
    def compiled(law: int) -> contract.CompiledPlant:
        before = f"{name}_{TYRE_NAMES[law]}"

        @exported(void(vector, vector, vector, vector), name=f"{before}_derivative")
        def derivative(x, u, parameters, dx):
            _set_slope(dx, 0, right_hand_side(_state(x), _input(u), unpack(parameters), law))

        @exported(contract.ADVANCE, name=f"{before}_advance")
        def advance(member, parameters, block, states, work, slots, substeps, h):
            _sweep(right_hand_side, block, _fill_group(block, slots), (substeps, h), unpack(parameters), law)

        @exported(contract.OBSERVE, name=f"{before}_observe")
        def observe(member, parameters, block, states, work, slot, observed):
            c = unpack(parameters)
            x, u = contract.state_of(block, slot), contract.input_of(block, slot)
            slope = right_hand_side(x, u, c, law)
            observed[contract.OBSERVED.lateral_acceleration] = slope.vy + x.vx * x.yaw_rate - u.bank
            angle = wheel_angle(x.steering, u.command, c.steering_lag, c.steering_limit)
            observed[contract.OBSERVED.wheel_angle] = angle

        return contract.CompiledPlant(derivative, advance, observe)

    for law in TYRE_NAMES:
        compiled(law)
    return compiled

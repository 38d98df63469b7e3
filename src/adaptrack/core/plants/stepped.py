"""A plant that is moved outside the kernels: whoever moves it writes its state to the batch."""

from __future__ import annotations

from ..kernel import columns, exported
from ..physics.forces import wheel_angle
from .contract import MOTION_STATES, OBSERVE, OBSERVED, PLANT_INPUT, PLANT_STATE, CompiledPlant, input_at, state_at

STEPPED_ACTUATOR = columns("lag", "limit")
"""Its parameters: those of the steering, s and rad."""
LATERAL_ACCELERATION = MOTION_STATES
"""Its own states are the motion, then the lateral acceleration (m/s^2) over the last period."""


@exported(OBSERVE, name="stepped_observe")
def observe(member, parameters, block, states, work, slot, observed):
    """See `contract.OBSERVE`."""
    observed[OBSERVED.lateral_acceleration] = states[slot, LATERAL_ACCELERATION]
    observed[OBSERVED.wheel_angle] = wheel_angle(
        block[state_at(PLANT_STATE.steering, slot)], block[input_at(PLANT_INPUT.command, slot)],
        parameters[STEPPED_ACTUATOR.lag], parameters[STEPPED_ACTUATOR.limit],
    )  # fmt: skip


STEPPED = CompiledPlant(right_hand_side=None, advance=None, observe=observe)

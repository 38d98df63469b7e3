"""What a plant is to the loop: how a batch of vehicles lies in memory, and the two functions that a plant gives.

Axes and signs (ISO 8855): x forward, y left, z up; yaw, steering and slip angles positive to the left.
The wind is the velocity of the air in the ground frame.

A batch has up to `SLOTS` slots, a vehicle in each. Its *block* is a flat vector: a row of `SLOTS` numbers for every
entry of `PLANT_STATE`, then for every entry of `PLANT_INPUT`. The constant row length lets the compiler prove that rows
do not overlap, so a loop over slots becomes vector instructions. A slot's arithmetic never depends on how many others
are in use: a run alone and a run in a batch agree to the last bit.

A plant with states of its own keeps all of them in ``states`` (SLOTS, n); the first six are copied to the block.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ..kernel import (
    Caller,
    address_of,
    columns,
    exported,
    float64,
    inlined,
    int64,
    matrix,
    record,
    unpacker,
    vector,
    void,
)
from ..layout import allocate

SLOTS = 32
"""Vehicles of a batch."""
GROUP = 8
"""Slots that are advanced together: between the last of several vehicles and the next multiple they are filled."""

PLANT_STATE = columns(
    "x", "y",  # m
    "yaw",  # rad
    "vx", "vy",  # m/s, body frame
    "yaw_rate",  # rad/s
    "slip_front_left", "slip_front_right", "slip_rear_left", "slip_rear_right",  # rad, relaxed slip angles
    "felt_ax", "felt_ay",  # m/s^2, accelerations as the wheel loads feel them
    "steering",  # rad, angle of the front wheels behind the actuator
)  # fmt: skip
"""Rows of a block: the state. What a plant does not use stays zero."""
PLANT_INPUT = columns(
    "command",  # rad, steering command
    "force",  # N, longitudinal, at the wheels: of the drive less that of the brakes
    "acceleration",  # m/s^2, prescribed dv_x/dt; NaN: none, the force acts
    "friction_front_left", "friction_front_right", "friction_rear_left", "friction_rear_right",
    "wind_x", "wind_y",  # m/s
    "bank",  # m/s^2, what the pull of a banked road adds to dv_y/dt, positive to the left
    "grade",  # -, dz/ds of the road along the car's x axis, positive uphill
    "brake",  # N, the part of the force that the brakes give, >= 0: it opposes motion and holds the car at rest
)  # fmt: skip
"""Rows of a block behind those of the state: the input, held over a control period."""
PlantState, PlantInput = record("PlantState", PLANT_STATE._fields), record("PlantInput", PLANT_INPUT._fields)
"""Of one vehicle; its slope is a `PlantState`, too."""
PLANT_STATES, PLANT_INPUTS = len(PLANT_STATE), len(PLANT_INPUT)
MOTION_STATES = 6
"""Every plant's states begin with X, Y, yaw, v_x, v_y, yaw rate."""
ENVIRONMENT = 7
"""Friction of the four wheels, both components of the wind and the bank: these rows of the input in a row."""
BLOCK_SIZE = (PLANT_STATES + PLANT_INPUTS) * SLOTS
"""Length of a block."""

ADVANCE = void(int64, vector, vector, matrix, matrix, int64, int64, float64)
"""``advance(member, parameters, block, states, work, slots, substeps, h)``: integrate the first ``slots`` vehicles over
``substeps`` steps of h (s), inputs held. parameters: the plant's own; work (7, >= max(n, STATES)): scratch."""
OBSERVE = void(int64, vector, vector, matrix, matrix, int64, vector)
"""``observe(member, parameters, block, states, work, slot, observed)``: write lateral acceleration (m/s^2) and
front-wheel angle (rad) of a vehicle under its present input to ``observed`` (2,)."""
OBSERVED = columns("lateral_acceleration", "wheel_angle")
"""What `observe` writes."""
_call_advance, _call_observe = Caller(ADVANCE), Caller(OBSERVE)


Vehicles = record(
    "Vehicles",
    (
        ("advance", int64),
        ("observe", int64),
        ("member", int64),
        ("parameters", vector, "plant_parameters"),
        ("block", vector, BLOCK_SIZE),
        ("states", matrix, SLOTS, "plant_states"),
        ("work", matrix, 7, "work_states"),
        ("start", matrix, "slots", "plant_states"),
    ),
)
"""A batch of vehicles: the addresses of its plant's functions and of a user's right-hand side (0: none), parameters,
block, own states, scratch, initial states."""


def vehicle_batch(compiled: Any, parameters: Any, start: Any) -> Any:
    """A batch of a `CompiledPlant`'s vehicles before their first period: initial states `start` (slots, n)."""
    slots, n = np.shape(start)
    sizes = {
        "slots": slots, "plant_parameters": len(parameters), "plant_states": n, "work_states": work_states(n)
    }  # fmt: skip
    vehicles = allocate(Vehicles, sizes)
    vehicles.parameters[:], vehicles.start[:] = parameters, start
    return vehicles._replace(**{name: address_of(getattr(compiled, name)) for name in ("advance", "observe", "member")})


@inlined
def work_states(states):
    """Columns of the scratch of vehicles whose plant has so many states."""
    return max(states, PLANT_STATES)


class CompiledPlant(NamedTuple):
    """The compiled functions and parameters of a plant."""

    right_hand_side: Any
    """of a user's plant, see `user.RIGHT_HAND_SIDE`; of a built-in one ``f(x, u, parameters, dx)`` on block entries"""
    advance: Any
    observe: Any
    member: Any = None
    """a user's right-hand side, which `advance` and `observe` call; None for a built-in plant"""


@inlined
def state_at(row, slot):
    """Where a state of a slot stands in a block."""
    return row * SLOTS + slot


@inlined
def input_at(row, slot):
    """Where an input of a slot stands in a block."""
    return (PLANT_STATES + row) * SLOTS + slot


state_of, _input_from = unpacker(PlantState, SLOTS), unpacker(PlantInput, SLOTS)
"""``state_of(block, slot)``: the state of a slot."""


@inlined
def input_of(block, slot):
    """The input of a slot."""
    return _input_from(block, PLANT_STATES * SLOTS + slot)


@inlined
def advance(slots, substeps, h, vehicles):
    """Move the first `slots` vehicles on by so many steps of h (s), under their present inputs."""
    v = vehicles
    _call_advance(v.advance, v.member, v.parameters, v.block, v.states, v.work, slots, substeps, h)


@inlined
def observe(slot, vehicles, observed):
    """Write `OBSERVED` of a vehicle under its present input to `observed`."""
    v = vehicles
    _call_observe(v.observe, v.member, v.parameters, v.block, v.states, v.work, slot, observed)


@inlined
def place_one(slot, start, block, states):
    """Set the state of one slot to its row of start (slots, n)."""
    for j in range(PLANT_STATES):
        block[state_at(j, slot)] = start[slot, j] if j < MOTION_STATES else 0.0
    states[slot, :] = start[slot]


@exported(void(int64, matrix, vector, matrix))
def place(slots, start, block, states):
    """Set the initial states: start (slots, n), beginning with X, Y, yaw, v_x, v_y, yaw rate; all else is zero."""
    block[:] = 0.0
    states[:, :] = 0.0
    for i in range(slots):
        place_one(i, start, block, states)

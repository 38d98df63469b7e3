"""Steering, sensor and limit data for the baseline controllers: those of the MPC that knows its car."""

from __future__ import annotations

import math

from adaptrack.base.checked import real
from adaptrack.base.errors import InvalidInput
from adaptrack.cars.vehicle import Steering, Vehicle
from adaptrack.control.controllers.belief import MOST_COMPUTATION, Belief, assumed_computation, belief_of, steering_rows
from adaptrack.control.controllers.informed import DEFAULT_PROFILE
from adaptrack.core.synthesis import belief as kernel
from adaptrack.scenario.profile import Profile, load_profile


def world_and_belief(
    where: str, vehicle: Vehicle, profile: str | Profile | None, belief: Steering | None, period: float | None,
    computation: float | None = None,
) -> tuple[Profile, float, Belief]:  # fmt: skip
    """The profile, the control period (s), and what is believed of the steering; arguments as for `MPC`.

    Each number of the steering is that of the caller, the car file or the profile, in this order, else
    `belief.ASSUMED_SOURCE`.

    Raises
    ------
    InvalidInput
        For a belief that is no `Steering`, or a period or computation time out of range.
    """
    car, world = vehicle, load_profile(DEFAULT_PROFILE if profile is None else profile)
    step = real(where, "period", world.period if period is None else period)
    if not 0.0 < step < math.inf:
        raise InvalidInput(f"{where}: period = {step!r} s: must be positive and finite.")
    seconds = None if computation is None else real(where, "computation", computation)
    if seconds is not None and not 0.0 <= seconds <= MOST_COMPUTATION:
        raise InvalidInput(f"{where}: computation = {seconds!r} s: must be from 0 to {MOST_COMPUTATION:g}.")
    computation_time = assumed_computation(seconds, world, step, uses_actuator=profile is not None)
    row = kernel.BeliefRow.new(1)[0]
    kernel.believe_steering(*steering_rows(car, belief, world, profile is not None), computation_time.value, row)
    return world, step, belief_of(row, car, world, computation_time)

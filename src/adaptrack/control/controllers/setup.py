"""Steering, sensor and limit data for the baseline controllers: those of the MPC that knows its car."""

from __future__ import annotations

from typing import Annotated

from adaptrack.base.checked import Finite, Positive, checked, within
from adaptrack.cars.vehicle import Steering, Vehicle
from adaptrack.control.controllers.belief import MOST_COMPUTATION, Belief, assumed_computation, belief_of, steering_rows
from adaptrack.control.controllers.informed import DEFAULT_PROFILE
from adaptrack.core.synthesis import belief as kernel
from adaptrack.scenario.profile import Profile, load_profile

PeriodArgument = Annotated[Positive, "s"]
ComputationArgument = Annotated[Finite, within(0.0, MOST_COMPUTATION), "s"]
"""The types of arguments."""


@checked
def world_and_belief(
    vehicle: Vehicle, profile: str | Profile | None, belief: Steering | None, period: PeriodArgument | None = None,
    computation: ComputationArgument | None = None,
) -> tuple[Profile, float, Belief]:  # fmt: skip
    """The profile, the control period (s), and what is believed of the steering; arguments as for `MPC`.

    Each number of the steering is that of the caller, the car file or the profile, in this order, else
    `belief.ASSUMED_SOURCE`.
    """
    world = load_profile(DEFAULT_PROFILE if profile is None else profile)
    step = world.period if period is None else period
    computation_time = assumed_computation(computation, world, step, uses_actuator=profile is not None)
    row = kernel.BeliefRow.new(1)[0]
    kernel.believe_steering(*steering_rows(vehicle, belief, world, profile is not None), computation_time.value, row)
    return world, step, belief_of(row, vehicle, world, computation_time)

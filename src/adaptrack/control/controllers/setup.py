"""Steering, sensor and limit data for the baseline controllers: those of the MPC that knows its car."""

from __future__ import annotations

import math
from typing import NamedTuple

from adaptrack.base.checked import real
from adaptrack.base.errors import InvalidInput
from adaptrack.cars.vehicle import Steering, Vehicle
from adaptrack.control.controllers.belief import MOST_COMPUTATION, Belief, assumed_computation, belief_of, steering_rows
from adaptrack.control.controllers.informed import DEFAULT_PROFILE
from adaptrack.control.controllers.limits import Limits
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


class LoopSetup(NamedTuple):
    """Steering, sensors and limits of the loop that a controller runs in."""

    belief: Belief
    """of the steering: caller, car file and profile in this order"""
    pose_age: float
    """s, how old yaw and y are when they arrive"""
    period: float
    """s, the control period"""
    preview: bool
    limits: Limits
    """by default those that follow from the belief"""

    @classmethod
    def of(
        cls, where: str, vehicle: Vehicle, profile: str | Profile | None, belief: Steering | None,
        period: float | None, preview: bool | None, limits: Limits | None, computation: float | None = None,
    ) -> LoopSetup:  # fmt: skip
        """For the controller called `where` in messages; arguments as for `MPC`, errors as for `world_and_belief`."""
        world, step, assumed = world_and_belief(where, vehicle, profile, belief, period, computation)
        return cls(
            belief=assumed,
            pose_age=world.pose_age if profile is not None else 0.0,
            period=step,
            preview=world.preview if preview is None else bool(preview),
            limits=assumed.bounds(step) if limits is None else limits,
        )

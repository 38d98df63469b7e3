"""The MPC that knows its car: a model with its steering, a Kalman filter for its sensors, one constant tuning."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

from adaptrack.controllers.limits import Limits
from adaptrack.controllers.mpc import MPC
from adaptrack.controllers.tuning import Tuning
from adaptrack.errors import InvalidInput, real
from adaptrack.kalman import Drifts, KalmanFilter
from adaptrack.limits import CONTROL_HORIZON, PREDICTION_HORIZON
from adaptrack.models import PathModel
from adaptrack.profile import Profile, load_profile
from adaptrack.vehicle import SteeringActuator, Vehicle

HORIZON, MOVES = 1.5, 0.5
"""s, over which the outputs are predicted and the command may change."""
LARGEST_CORRECTION = 0.25
"""m, lateral error that is corrected at once: a larger one would ask the tyres for more than they have."""
QUANTILE, TOLERATED_DELAY, MOST_CAUTION, USUAL_RATE = 0.95, 0.018, 16.0, 0.5
"""Of what a delay may be, the share that is not above what is believed; s, an error of the delay that doubles R; the
largest factor on R for it; rad/s, steering rate."""
LEAST_MOVE_WEIGHT = 4e-5
"""s^2, R/Q times the squared control period where the profile gives them none."""


def _checked(period: float) -> float:
    if not 0.0 < real("informed controller", "period", period) < math.inf:
        raise InvalidInput(f"informed controller: period = {period!r} s: must be positive and finite.")
    return float(period)


@dataclass(frozen=True)
class Uncertainty:
    """How far what is believed of the car may be wrong: by so much to either side.

    A delay that is believed too short loses the car, one that is believed too long costs little. So the controller
    believes the `QUANTILE` of what lag and dead time may be, its filter lets the wheels be where the model does not
    expect them, and the moves weigh more.

    Raises
    ------
    InvalidInput
        When a number is not allowed.
    """

    lag: float = 0.0
    """s, of the steering's lag"""
    dead_time: float = 0.0
    """s, of its dead time"""
    stiffness: float = 1.0
    """-, factor by which the cornering stiffness of an axle may be larger or smaller, >= 1"""
    mass: float = 0.0
    """-, share by which mass and yaw inertia may be larger or smaller, below 1"""

    def __post_init__(self) -> None:
        ranges = {"lag": (0.0, 1.0), "dead_time": (0.0, 1.0), "stiffness": (1.0, 4.0), "mass": (0.0, 0.9)}
        for name, (low, high) in ranges.items():
            if not low <= real("Uncertainty", name, getattr(self, name)) <= high:
                raise InvalidInput(f"Uncertainty: {name} = {getattr(self, name)!r}: must be from {low:g} to {high:g}.")

    def late(self, half: float) -> float:
        """What is added to a delay (s) that may be wrong by `half` (s), all values being equally likely."""
        return (2.0 * QUANTILE - 1.0) * half

    @property
    def caution(self) -> float:
        """By which R is multiplied."""
        delay = math.hypot(self.lag, self.dead_time) / TOLERATED_DELAY
        return min(1.0 + delay**2, MOST_CAUTION) * self.stiffness * (1.0 + self.mass)

    def widened(self, drifts: Drifts) -> Drifts:
        """Drifts of the filter: a delay that is wrong puts the wheels elsewhere, by the steering rate times it."""
        unknown = USUAL_RATE * (self.lag + self.dead_time)
        return replace(drifts, wheel_angle=math.hypot(drifts.wheel_angle, unknown))


def _declared(uncertainty: Uncertainty | None) -> Uncertainty:
    if uncertainty is None:
        return Uncertainty()
    if not isinstance(uncertainty, Uncertainty):
        raise InvalidInput(f"uncertainty = {uncertainty!r}: must be an Uncertainty(lag=..., dead_time=...).")
    return uncertainty


def _limits(actuator: SteeringActuator, period: float) -> Limits:
    """Of the moves by what the actuator does at its rate limit, and of the error that is corrected at once."""
    fastest = actuator.rate * period
    if not math.isfinite(fastest):
        return Limits(error=LARGEST_CORRECTION)
    return Limits(move=(-fastest, fastest), ahead=fastest + actuator.rate * actuator.lag, error=LARGEST_CORRECTION)


def informed_tuning(
    profile: str | Profile = "road", period: float | None = None, uncertainty: Uncertainty | None = None
) -> Tuning:
    """The constant tuning in a profile; period: control period (s), by default the profile's.

    R/Q is the weight that the profile itself gives to squared moves, times the caution of an uncertainty.
    """
    world = load_profile(profile)
    pace = _checked(world.period if period is None else period)
    weight = max(world.move_weight * world.period**2, LEAST_MOVE_WEIGHT) / pace**2
    weight *= _declared(uncertainty).caution
    horizon = min(max(2, round(HORIZON / pace)), int(PREDICTION_HORIZON.most))
    moves = min(max(1, round(MOVES / pace)), int(CONTROL_HORIZON.most))
    return Tuning(horizon, moves, 1.0, float(f"{weight:.6g}"))


def informed_mpc(
    vehicle: Vehicle,
    profile: str | Profile = "road",
    *,
    tuning: Tuning | None = None,
    period: float | None = None,
    steering: SteeringActuator | None = None,
    dead_time: float | None = None,
    drifts: Drifts | None = None,
    uncertainty: Uncertainty | None = None,
    **options: Any,
) -> MPC:
    """An `MPC` that models the lag and the dead time of its steering and estimates state and disturbances.

    vehicle: mass, inertia, axle distances and stiffness of the model; profile: the sensors and the computer that it
    runs on, whose period, preview, actuator and delay it believes unless told otherwise; tuning: `informed_tuning` by
    default; steering: its lag (s) is believed, and its rate (rad/s) bounds the moves; dead_time: from an instant until
    its command begins to act (s), the computer's time included; uncertainty: of what is believed, none by default (a
    tuning or drifts that are given stay as they are); options: of `MPC`.

    Raises
    ------
    InvalidInput
        For arguments that make no controller.
    """
    world = load_profile(profile)
    pace = _checked(world.period if period is None else period)
    actuator = world.steering if steering is None else steering
    delay = world.delay * pace if dead_time is None else dead_time
    if not isinstance(actuator, SteeringActuator):
        raise InvalidInput(f"steering = {steering!r}: must be a SteeringActuator(lag=..., rate=..., limit=...).")
    unsure = _declared(uncertainty)
    believed = actuator.replace(lag=actuator.lag + unsure.late(unsure.lag))
    options.setdefault("limits", _limits(believed, pace))
    options.setdefault("preview", world.preview)
    return MPC(
        vehicle,
        informed_tuning(world, pace, unsure) if tuning is None else tuning,
        period=pace,
        model=PathModel(vehicle, pace, believed.lag, delay + unsure.late(unsure.dead_time)),
        estimator=KalmanFilter.of_profile(world, unsure.widened(Drifts()) if drifts is None else drifts),
        **options,
    )

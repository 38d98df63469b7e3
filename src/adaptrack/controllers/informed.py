"""The MPC that knows its car: a model with its steering, a Kalman filter for its sensors, one constant tuning."""

from __future__ import annotations

import math
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
LEAST_MOVE_WEIGHT = 4e-5
"""s^2, R/Q times the squared control period where the profile gives them none."""


def _checked(period: float) -> float:
    if not 0.0 < real("informed controller", "period", period) < math.inf:
        raise InvalidInput(f"informed controller: period = {period!r} s: must be positive and finite.")
    return float(period)


def informed_tuning(profile: str | Profile = "road", period: float | None = None) -> Tuning:
    """The constant tuning in a profile; period: control period (s), by default the profile's.

    R/Q is the weight that the profile itself gives to squared moves.
    """
    world = load_profile(profile)
    pace = _checked(world.period if period is None else period)
    weight = max(world.move_weight * world.period**2, LEAST_MOVE_WEIGHT) / pace**2
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
    **options: Any,
) -> MPC:
    """An `MPC` that models the lag and the dead time of its steering and estimates state and disturbances.

    vehicle: mass, inertia, axle distances and stiffness of the model; profile: the sensors and the computer that it
    runs on, whose period, preview, actuator and dead time it believes unless told otherwise; tuning: `informed_tuning` by
    default; steering: its lag (s) is believed, and its rate (rad/s) bounds the moves; dead_time: from an instant until
    its command begins to act (s), the computer's time included; options: of `MPC`.

    Raises
    ------
    InvalidInput
        For arguments that make no controller.
    """
    world = load_profile(profile)
    pace = _checked(world.period if period is None else period)
    actuator = world.steering if steering is None else steering
    if not isinstance(actuator, SteeringActuator):
        raise InvalidInput(f"steering = {steering!r}: must be a SteeringActuator(lag=..., rate=..., limit=...).")
    delay = world.delay * pace + actuator.dead_time if dead_time is None else dead_time
    fastest = actuator.rate * pace
    if math.isfinite(fastest):
        options.setdefault("limits", Limits(move=(-fastest, fastest), ahead=actuator.rate * actuator.lag))
    options.setdefault("preview", world.preview)
    return MPC(
        vehicle,
        informed_tuning(world, pace) if tuning is None else tuning,
        period=pace,
        model=PathModel(vehicle, pace, actuator.lag, delay),
        estimator=KalmanFilter.of_profile(world, drifts),
        **options,
    )

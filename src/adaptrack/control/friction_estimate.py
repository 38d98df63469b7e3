"""Estimate of the friction that narrows the interval of a speed control while driving (`core.speed.friction`)."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from adaptrack.cars.vehicle import SteeringActuator, Vehicle, load_tyre, pack_plant
from adaptrack.control.controllers import Controller
from adaptrack.control.kalman import KalmanFilter
from adaptrack.core.models.car import LearnedRow
from adaptrack.core.models.contract import MEASUREMENT
from adaptrack.core.speed import friction as kernel

FRICTION_COUNT = 13
"""Coefficients of friction, evenly within the interval."""
LONGEST_STEERING_DELAY = 1.0
"""s, of the steering and the samples together, for which commands are remembered."""
ASSUMED_KNOWLEDGE = {
    "delay_sigma": 0.01, "stiffness": 1.0, "stiffness_sigma": 0.1, "balance": 1.0, "balance_sigma": 0.05, "bias": 0.0,
    "bias_sigma": 0.005,
}  # fmt: skip
"""Entries of `core.models.car.LearnedRow` where the car file states the car and no controller learns it.
"""
FRICTION_SENSORS = [MEASUREMENT.vy, MEASUREMENT.yaw_rate, MEASUREMENT.lateral_acceleration]
"""Sensors whose variances an estimate has."""


def friction_estimate(interval: tuple[float, float], car: Vehicle, period: float, controller: Controller | None) -> Any:
    """An estimate of the friction by the steering model of a controller (`core.speed.friction.FrictionEstimate`).

    It has no hypotheses where the friction is certain, and without a steering model. period: s, of the control.
    """
    low, high = interval
    belief = None if controller is None else controller.belief
    if controller is None or belief is None or not low < high:
        memory, bank = kernel.FRICTION_MEMORY.new(1), kernel.FRICTION_HYPOTHESIS.new(0)
        knowledge = _knowledge()
        nothing = np.zeros(0)
        return kernel.FrictionEstimate(memory, bank, nothing, nothing, period, nothing, low, high, knowledge)
    rate = belief.rate.value if belief.lag.value > 0.0 else math.inf  # a rate limit acts on a lag
    steering = SteeringActuator(**{**belief.steering, "rate": rate})
    knowledge = _knowledge(lag=belief.lag.value, dead_time=belief.delay, **ASSUMED_KNOWLEDGE)
    return kernel.FrictionEstimate(
        kernel.FRICTION_MEMORY.new(1), kernel.FRICTION_HYPOTHESIS.new(FRICTION_COUNT),
        np.zeros(math.ceil(LONGEST_STEERING_DELAY / period) + 1),
        pack_plant(car, load_tyre(car.tyre), steering), period, _variances(controller), low, high, knowledge,
    )  # fmt: skip


def _knowledge(**values: float) -> Any:
    """The car as assumed; zero where unspecified."""
    return LearnedRow(**dict.fromkeys(LearnedRow._fields, 0.0) | values)


def _variances(controller: Controller) -> NDArray[np.float64]:
    """(3,) of `FRICTION_SENSORS`, as the controller assumes them."""
    estimator = getattr(controller, "estimator", None)
    filtering = estimator if isinstance(estimator, KalmanFilter) else KalmanFilter()
    return filtering.variances()[FRICTION_SENSORS]

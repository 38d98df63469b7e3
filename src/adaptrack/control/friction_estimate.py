"""Friction of the road as an interval that a speed control narrows while driving (`core.friction_estimate`)."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from adaptrack.cars.vehicle import SteeringActuator, load_tyre, pack_plant
from adaptrack.control.controllers import Controller
from adaptrack.control.kalman import KalmanFilter
from adaptrack.control.speed_control import SpeedController
from adaptrack.core import friction_estimate as kernel
from adaptrack.core.estimators.learning import memory_of
from adaptrack.core.models.contract import MEASUREMENT

FRICTION_COUNT = 13
"""Coefficients of friction, evenly within the interval."""
LONGEST_STEERING_DELAY = 1.0
"""s, of the steering and the samples together, for which commands are remembered."""
STIFFNESS_SIGMA, BALANCE_SIGMA, BIAS_SIGMA, DELAY_SIGMA = 0.1, 0.05, 0.005, 0.01
"""-, -, rad, s: standard deviations of what a car file states and no controller learns."""


class FrictionEstimator:
    """Estimator of the friction interval of a speed control, called once a control period before it.

    It uses the steering model of the controller and, where the controller learns, its estimates with their
    uncertainty. A friction that is certain stays, as it does with a controller without a steering model and on linear
    tyres.
    """

    def __init__(self, speed: SpeedController, controller: Controller) -> None:
        self._speed = speed
        self._controller: Any = controller
        control, belief = speed.control, controller.belief
        low, high = control.friction_interval
        self.runs = low < high and belief is not None
        """whether the interval can become narrower"""
        steering = SteeringActuator.ideal()
        if belief is not None:
            steering = SteeringActuator(lag=belief.lag.value, rate=belief.rate.value, limit=belief.limit.value)
        car, period = control.car, controller.period
        self._estimate = kernel.FrictionEstimate(
            kernel.FRICTION_MEMORY.new(1), kernel.FRICTION_HYPOTHESIS.new(FRICTION_COUNT if self.runs else 1),
            np.zeros(math.ceil(LONGEST_STEERING_DELAY / period) + 1),
            pack_plant(car, load_tyre(car.tyre), steering), period, _variances(controller),
        )  # fmt: skip
        kernel.friction_begin(low, high, self._estimate)

    def step(self, measured: NDArray[np.float64], speed: float, command: float) -> None:
        """Take in a sample.

        measured: `core.models.contract.MEASUREMENT`; speed: m/s; command: rad, sent in the last period.
        """
        if not self.runs:
            return
        age = float(measured[MEASUREMENT.motion_age])
        sample = kernel.FrictionSample(
            speed=speed, yaw_rate=measured[MEASUREMENT.yaw_rate],
            lateral_acceleration=measured[MEASUREMENT.lateral_acceleration],
            lateral_velocity=measured[MEASUREMENT.vy], age=age if math.isfinite(age) else 0.0, command=command,
        )  # fmt: skip
        kernel.narrow_friction_step(sample, self._knowledge(), self._estimate, *self._speed.records)

    def restart(self) -> None:
        """Begin the filters of the motion again, as after a gap in time; the interval stays."""
        self._estimate.memory[0].running = 0.0

    @property
    def friction(self) -> float:
        """Mean of the friction within its interval."""
        return float(self._estimate.memory[0].friction)

    @property
    def interval(self) -> tuple[float, float]:
        """Low and high end of the friction."""
        memory = self._estimate.memory[0]
        return float(memory.low), float(memory.high)

    def _knowledge(self) -> Any:
        """Steering and tyres as the controller assumes or has learned them."""
        controller = self._controller
        if controller.learner is None:
            belief = controller.belief
            return kernel.SteeringKnowledge(
                lag=belief.lag.value, dead_time=belief.delay, delay_sigma=DELAY_SIGMA,
                stiffness=1.0, stiffness_sigma=STIFFNESS_SIGMA, balance=1.0, balance_sigma=BALANCE_SIGMA,
                bias=0.0, bias_sigma=BIAS_SIGMA,
            )  # fmt: skip
        learned = memory_of(controller._mpc.informed.learned[0], 0).beliefs
        names = {name: float(learned[f"belief_{name}"]) for name in kernel.SteeringKnowledge._fields}
        return kernel.SteeringKnowledge(**names)


def _variances(controller: Controller) -> NDArray[np.float64]:
    """(3,) of the sensors of lateral velocity, yaw rate and lateral acceleration, as the controller assumes them."""
    estimator = getattr(controller, "estimator", None)
    filtering = estimator if isinstance(estimator, KalmanFilter) else KalmanFilter()
    return filtering.variances()[[MEASUREMENT.vy, MEASUREMENT.yaw_rate, MEASUREMENT.lateral_acceleration]].copy()

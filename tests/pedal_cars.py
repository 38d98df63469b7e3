"""A car behind pedals whose force is not proportional to them."""

from __future__ import annotations

import math

import numpy as np

from adaptrack import Vehicle

DRIVE_LAG, DRIVE_DEAD_TIME, BRAKE_LAG, BRAKE_DEAD_TIME = 0.25, 0.16, 0.12, 0.08
"""s"""


class PedalCar:
    """Drive with creep and engine braking, progressive brakes, lags and dead times; steps of `step` (s)."""

    def __init__(self, vehicle: Vehicle, step: float) -> None:
        self._step, self._forces = step, [0.0, 0.0]
        drag = 0.5 * vehicle.air_density * vehicle.frontal_area * vehicle.drag_coefficient
        self._drag, self._rolling = drag / vehicle.mass, 9.81 * vehicle.rolling_resistance
        self._queues = [[0.0] * round(dead_time / step) for dead_time in (DRIVE_DEAD_TIME, BRAKE_DEAD_TIME)]

    def coasting(self, speed):
        """m/s^2, without a pedal: creep up to 2 m/s, engine braking above."""
        return np.interp(speed, (0.0, 1.0, 2.0, 4.0), (0.4, 0.2, 0.0, -0.35))

    def driving(self, throttle, speed):
        """m/s^2, of the throttle, in addition to coasting."""
        return np.minimum(4.2, 55.0 / np.maximum(speed, 1.0)) * np.power(throttle, 1.6)

    def braking(self, brake):
        """m/s^2, of the brake pedal."""
        return 7.5 * np.power(brake, 1.4)

    def acceleration(self, throttle: float, brake: float, speed: float) -> float:
        """m/s^2, in the step that begins now; a standing car stays where the brakes hold it."""
        for i, (pedal, lag) in enumerate(((throttle, DRIVE_LAG), (brake, BRAKE_LAG))):
            self._queues[i].append(pedal)
            late = self._queues[i].pop(0)
            target = float(self.braking(late) if i else self.driving(late, speed))
            self._forces[i] += (target - self._forces[i]) * (1.0 - math.exp(-self._step / lag))
        driving, braking = self._forces
        push = driving + float(self.coasting(speed))
        if speed <= 0.0:
            return max(push - braking, 0.0)
        resistance = self._rolling * min(1.0, 2.0 * speed) + self._drag * speed**2
        return max(push - braking - resistance, -speed / self._step)

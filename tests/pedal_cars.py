"""A car behind pedals whose force is not proportional to them."""

from __future__ import annotations

import math

import numpy as np

from adaptrack import Vehicle
from adaptrack.cars.pedals import PedalMap
from adaptrack.core.synthesis.speed import resistance

DRIVE_LAG, DRIVE_DEAD_TIME, BRAKE_LAG, BRAKE_DEAD_TIME = 0.25, 0.16, 0.12, 0.08
"""s"""


class PedalCar:
    """Drive with creep and engine braking, progressive brakes, lags and dead times; steps of `step` (s)."""

    def __init__(self, vehicle: Vehicle, step: float) -> None:
        self._mass, self._step, self._forces = vehicle.mass, step, [0.0, 0.0]
        names = ("air_density", "frontal_area", "drag_coefficient", "rolling_resistance")
        self._drag, self._rolling = resistance(*(getattr(vehicle, name) for name in names))
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

    @property
    def pedals(self) -> PedalMap:
        """The true map at many points."""
        speed, positions = np.linspace(0.0, 20.0, 41), np.linspace(0.0, 1.0, 41)
        force = [self._mass * (self.coasting(v) + self.driving(positions, v)) for v in speed]
        brake_force = self._mass * self.braking(positions)
        return PedalMap(speed=speed, throttle=positions, force=force, brake=positions, brake_force=brake_force)

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
        drag = self._rolling * min(1.0, 2.0 * speed) + self._drag * speed**2 / self._mass
        return max(push - braking - drag, -speed / self._step)

"""A car on a straight road behind drive and brakes with lags and dead times."""

from __future__ import annotations

import math

from adaptrack.cars.vehicle import BrakeActuator, DriveActuator

PERIOD = 0.05
"""s, of control."""


class PointMass:
    """Such a car, by Euler steps of 1 ms."""

    def __init__(
        self, speed: float, mass: float, drive: DriveActuator, brakes: BrakeActuator, slope: float = 0.0
    ) -> None:
        self.s, self.v, self._mass, self._slope = 0.0, speed, mass, slope
        self._actuators, self._forces = (drive, brakes), [0.0, 0.0]
        self._queues = [[0.0] * (1 + round(a.dead_time / 0.001)) for a in self._actuators]

    def move(self, force: float, hold: float, *, stuck_drive: float = 0.0, has_brakes: bool = True) -> None:
        for _ in range(round(PERIOD / 0.001)):
            for i, request in enumerate((max(force, stuck_drive), (max(-force, 0.0) + hold) * has_brakes)):
                self._queues[i].append(request * self._actuators[i].gain)
                target = self._queues[i].pop(0)
                self._forces[i] += (target - self._forces[i]) * 0.001 / max(self._actuators[i].lag, 0.001)
            push = self._forces[0] / self._mass - self._slope
            if self.v <= 0.0 and abs(push) <= self._forces[1] / self._mass:
                self.v = 0.0
                continue
            self.v += 0.001 * (push - math.copysign(self._forces[1] / self._mass, self.v if self.v else push))
            self.s += 0.001 * self.v

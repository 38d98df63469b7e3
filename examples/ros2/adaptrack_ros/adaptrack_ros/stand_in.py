"""A car and a planner that stand in for real ones, without ROS: adaptrack's dual track behind the messages."""

from __future__ import annotations

import math
from collections import deque
from typing import Any

import numpy as np

import adaptrack as at

STEP = 0.0125
"""s, of the integration"""
ENVIRONMENT = (1.0, 1.0, 1.0, 1.0, 0.0, 0.0)
"""Dry road, no wind."""
CREEP = 0.5
"""m/s: the tyres of the dual track are not for less; a slower car moves as a bicycle without slip."""


class StandInCar:
    """A car that obeys an AckermannDrive.

    vehicle: by default the midsize-sedan; delay: s from a command until the wheels begin to move, one `STEP` at least;
    lag: s and rate: rad/s, of the steering; base_ahead: m, of the base frame ahead of the rear axle.
    """

    def __init__(
        self,
        vehicle: str = "midsize-sedan",
        *,
        delay: float = 0.1,
        lag: float = 0.2,
        rate: float = 0.4,
        base_ahead: float = 0.0,
    ) -> None:
        self.car = at.load_vehicle(vehicle)
        self._plant = at.DualTrack(self.car)
        self._lag, self._rate = lag, rate
        self._ahead = base_ahead - self.car.lr
        self._sent: deque[float] = deque([0.0] * max(1, round(delay / STEP)))
        self.angle, self.time = 0.0, 0.0
        self._command = (0.0, 0.0, 0.0)
        self.place(0.0, 0.0, 0.0, 0.0)

    def place(self, x: float, y: float, yaw: float, speed: float) -> None:
        """Put the centre of mass there (m, rad), driving straight on (m/s)."""
        self.state = self._plant.initial_state([x, y, yaw, speed, 0.0, 0.0])
        self._command = (0.0, speed, 0.0)

    def obey(self, drive: Any) -> None:
        """Take an ackermann_msgs/AckermannDrive; it holds until the next one."""
        self._command = (drive.steering_angle, drive.speed, drive.acceleration)

    def advance(self, duration: float) -> None:
        """Drive on for so long (s)."""
        for _ in range(round(duration / STEP)):
            self._steer()
            if self.state[3] > CREEP:
                self._runge_kutta()
            else:
                self._roll()
            self.time += STEP

    def _steer(self) -> None:
        self._sent.append(self._command[0])
        change = (self._sent.popleft() - self.angle) * (1.0 - math.exp(-STEP / self._lag))
        self.angle += min(max(change, -self._rate * STEP), self._rate * STEP)

    def _demand(self) -> float:
        """m/s^2, towards the requested speed."""
        _, speed, acceleration = self._command
        most = acceleration if acceleration > 0.0 else 5.0  # 0 means as quickly as possible
        return float(min(max((speed - self.state[3]) / 0.3, -most), most))

    def _runge_kutta(self) -> None:
        inputs = (self.angle, 0.0, self._demand())

        def slope(x: np.ndarray) -> np.ndarray:
            return self._plant.derivative(x, inputs, ENVIRONMENT)

        x, h = self.state, STEP
        first = slope(x)
        second = slope(x + 0.5 * h * first)
        third = slope(x + 0.5 * h * second)
        self.state = x + h / 6.0 * (first + 2.0 * second + 2.0 * third + slope(x + h * third))

    def _roll(self) -> None:
        speed = max(0.0, float(self.state[3]) + STEP * self._demand())
        rate = speed * math.tan(self.angle) / self.car.wheelbase
        yaw = float(self.state[2])
        x, y = self.state[:2] + STEP * speed * np.array([math.cos(yaw), math.sin(yaw)])
        self.state = self._plant.initial_state([x, y, yaw + STEP * rate, speed, self.car.lr * rate, rate])

    def fill_odometry(self, message: Any) -> None:
        """Write the present motion into a nav_msgs/Odometry, stamp and frames left as they are."""
        x, y, yaw, vx, vy, rate = map(float, self.state[:6])
        pose, twist = message.pose.pose, message.twist.twist
        pose.position.x, pose.position.y = x + self._ahead * math.cos(yaw), y + self._ahead * math.sin(yaw)
        pose.orientation.z, pose.orientation.w = math.sin(0.5 * yaw), math.cos(0.5 * yaw)
        twist.linear.x, twist.linear.y, twist.angular.z = vx, vy + self._ahead * rate, rate


def window(road: at.Road, s: float, behind: float = 10.0, ahead: float = 80.0) -> np.ndarray:
    """(n, 2) m: what a planner publishes at arc length s, points a metre apart."""
    points = road.at(np.arange(max(0.0, s - behind), min(road.length, s + ahead), 1.0))
    return np.stack([points.x, points.y], axis=-1)

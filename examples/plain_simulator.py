"""A car in a simulator of one's own follows a path through points: python examples/plain_simulator.py"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

import adaptrack as at


@dataclass
class Bicycle:
    """A dynamic bicycle: linear tyres, a steering with lag and dead time."""

    x: float = 0.0
    y: float = 0.0
    yaw: float = 0.0
    speed: float = 15.0
    vy: float = 0.0
    yaw_rate: float = 0.0
    angle: float = 0.0  # rad, of the road wheels
    mass: float = 1575.0
    inertia: float = 2875.0
    lf: float = 1.2
    lr: float = 1.6
    front: float = 38e3  # N/rad, of an axle
    rear: float = 66e3
    lag: float = 0.15  # s
    dead_time: float = 0.05  # s
    sent: list[float] = field(default_factory=list)

    def step(self, command: float, dt: float) -> None:
        """Go on by a time (s), which is short against the lag."""
        self.sent.append(command)
        acting = self.sent.pop(0) if len(self.sent) * dt > self.dead_time else self.angle
        self.angle += (acting - self.angle) * dt / self.lag
        v = self.speed
        if abs(v) > 2.0:
            front = self.front * (self.angle - (self.vy + self.lf * self.yaw_rate) / v)
            rear = -self.rear * (self.vy - self.lr * self.yaw_rate) / v
            self.vy += ((front + rear) / self.mass - v * self.yaw_rate) * dt
            self.yaw_rate += (self.lf * front - self.lr * rear) / self.inertia * dt
        else:  # tyres that only roll
            self.yaw_rate = v * math.tan(self.angle) / (self.lf + self.lr)
            self.vy = self.lr * self.yaw_rate
        self.x += (v * math.cos(self.yaw) - self.vy * math.sin(self.yaw)) * dt
        self.y += (v * math.sin(self.yaw) + self.vy * math.cos(self.yaw)) * dt
        self.yaw += self.yaw_rate * dt


def main(seconds: float = 20.0) -> float:
    """Drive, and give the RMS (m) of the distance from the path."""
    s = np.arange(0.0, 400.0, 5.0)
    path = at.fit_road(np.stack([s, 15.0 * (1.0 - np.cos(s / 50.0))], axis=-1), name="through points")
    steering = at.Steering(lag=0.15, dead_time=0.05, rate=0.5)
    tracker = at.Tracker(at.MPC(at.load_vehicle("paper"), belief=steering), path)
    car, offsets, dt = Bicycle(), [], 0.001
    for k in range(round(seconds / dt)):
        if k % 50 == 0:  # 20 Hz
            out = tracker.step(k * dt, car.x, car.y, car.yaw, car.speed, car.yaw_rate)
            offsets.append(out.offset)
        car.step(out.command, dt)
    rms = float(np.sqrt(np.mean(np.square(offsets))))
    print(f"RMS {rms:.3f} m, at the end: {out.status}, {out.station:.0f} m along the path")
    return rms


if __name__ == "__main__":
    main()

"""A day of driving in one process: does the memory stay flat, and does the controller still drive?

    python benchmarks/soak.py [--hours 24] [--controller learning]

A tracker with the learning MPC drives laps of a closed country road at 20 Hz, on a single-track car of the script's own
(linear tyres, steering lag and dead time, noise, samples that are late or missing). After each simulated hour: resident
memory (MB), RMS and largest offset (m), time of a step, statuses. The exit code is 1 when the memory
has grown by more than 3 MB since the first hour, or when a call was held.
"""

from __future__ import annotations

import argparse
import gc
import math
import os
import sys
import time
from collections import Counter, deque
from pathlib import Path

import numpy as np

import adaptrack as at

PERIOD, SPEED, SUBSTEPS = 0.05, 15.0, 5
GROWTH = 3.0
"""MB since the first hour."""


class Car:
    """A single-track car with linear tyres (Rajamani, Vehicle Dynamics and Control, section 2.3) and its steering."""

    def __init__(self, vehicle: at.Vehicle, road: at.Road, lag: float = 0.15, dead_time: float = 0.05) -> None:
        place = road.at(0.0)
        self.x, self.y, self.yaw = float(place.x), float(place.y), float(place.heading)
        self.vy = self.rate = self.angle = 0.0
        self.vehicle, self.lag = vehicle, lag
        self.sent = deque([0.0] * round(dead_time / PERIOD))

    def drive(self, command: float) -> None:
        """One control period, by semi-implicit Euler steps."""
        self.sent.append(command)
        acting, v, h = self.sent.popleft(), self.vehicle, PERIOD / SUBSTEPS
        front, rear = 2.0 * v.stiffness_front, 2.0 * v.stiffness_rear
        for _ in range(SUBSTEPS):
            self.angle += (1.0 - math.exp(-h / self.lag)) * (acting - self.angle)
            f = front * (self.angle - (self.vy + v.lf * self.rate) / SPEED)
            r = -rear * (self.vy - v.lr * self.rate) / SPEED
            self.vy += h * ((f + r) / v.mass - SPEED * self.rate)
            self.rate += h * (v.lf * f - v.lr * r) / v.yaw_inertia
            self.yaw += h * self.rate
            self.x += h * (SPEED * math.cos(self.yaw) - self.vy * math.sin(self.yaw))
            self.y += h * (SPEED * math.sin(self.yaw) + self.vy * math.cos(self.yaw))


def resident() -> float:
    """MB of this process in memory."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def lap() -> at.Road:
    """A closed road of bends and straights, 1.1 km."""
    s = np.linspace(0.0, 2.0 * math.pi, 400, endpoint=False)
    radius = 150.0 + 20.0 * np.sin(3.0 * s) + 8.0 * np.cos(5.0 * s)
    return at.road_through(np.stack([radius * np.cos(s), radius * np.sin(s)], axis=-1), closed=True)


def make(kind: str, vehicle: at.Vehicle) -> at.MPC:
    """The controller."""
    if kind == "published":
        return at.published_mpc(vehicle, at.Tuning(35, 8, 1.0, 3000.0), period=PERIOD)
    return at.MPC(vehicle, profile="road", learning=at.Learning() if kind == "learning" else None)


def main() -> int:
    """The command."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--hours", type=float, default=24.0)
    parser.add_argument("--controller", choices=("learning", "informed", "published"), default="learning")
    chosen = parser.parse_args()
    vehicle, road = at.load_vehicle("paper"), lap()
    car, tracker = Car(vehicle, road), at.Tracker(make(chosen.controller, vehicle), road)
    rng, steps, begun, first, held = np.random.default_rng(1), round(3600.0 / PERIOD), time.monotonic(), math.nan, 0
    print("hour  resident MB  offset RMS, max (m)  us a step  statuses")
    for hour in range(math.ceil(chosen.hours)):
        count = min(steps, round(chosen.hours * steps) - hour * steps)
        statuses, squares, worst = Counter[str](), 0.0, 0.0
        for k in range(count):
            t = (hour * steps + k) * PERIOD
            noise = rng.normal(size=4) * (0.02, 0.02, 0.002, 0.005)
            there = (math.nan,) * 3 if k % 97 == 96 else (car.x + noise[0], car.y + noise[1], car.yaw + noise[2])
            told = tracker.step(t, *there, SPEED, car.rate + noise[3])
            statuses[told.status.value] += 1
            if math.isfinite(told.offset):
                squares += told.offset**2
                worst = max(worst, abs(told.offset))
            car.drive(told.command)
        gc.collect()
        now, rms = resident(), math.sqrt(squares / count)
        first = now if hour == 0 else first
        held += statuses["held"] + statuses["off-path"]
        each = (time.monotonic() - begun) / (hour * steps + count) * 1e6
        print(f"{hour + 1:4d}  {now:11.1f}  {rms:.4f}, {worst:.3f}  {each:.0f}  {dict(statuses)}", flush=True)
    growth = resident() - first
    print(f"memory has grown by {growth:.2f} MB since the first hour; {held} calls held or off the path")
    return int(growth > GROWTH or held > 0)


if __name__ == "__main__":
    sys.exit(main())

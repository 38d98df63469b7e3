"""The loop about a tracker in a synchronous CARLA world, and the log of a drive. Needs no CARLA."""

from __future__ import annotations

import csv
import math
import os
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from conversion import angle_of, pedals, sample_of, steer_of
from numpy.typing import NDArray

import adaptrack as at
from adaptrack.control.tracker import Tracked

PERIOD = 0.05
"""s, of a tick: fixed_delta_seconds"""
STOP = (at.Status.HELD, at.Status.REVERSE, at.Status.OFF_PATH, at.Status.END)
"""Statuses on which the car is braked."""
COLUMNS = ("time", "command", "wheel", "speed", "yaw_rate", "vy", "yaw", "x", "y")
"""Of a log, as `adaptrack identify` reads them; x and y are those of the vehicle's origin."""


@dataclass
class Car:
    """A vehicle of CARLA, and what must be known of it."""

    vehicle: Any
    """carla.Vehicle"""
    control: Any
    """the class carla.VehicleControl"""
    front_wheels: tuple[Any, Any]
    """carla.VehicleWheelLocation of the front wheels"""
    full_steer: float
    """rad, of the road wheels at a steer of 1"""
    ahead: float = 0.0
    """m, of the vehicle's origin ahead of the centre of mass"""

    def wheel_angle(self) -> float:
        """rad, measured, the mean of both front wheels."""
        return -math.radians(0.5 * sum(map(self.vehicle.get_wheel_steer_angle, self.front_wheels)))


def controller(vehicle: at.Vehicle, known: bool) -> at.MPC:
    """For ticks of `PERIOD`, whose commands act at once; known: whether the car's steering has been identified."""
    profile = at.load_profile("road").replace(name="carla", delay=0.0, period=PERIOD)
    return at.MPC(vehicle, profile=profile) if known else at.MPC(vehicle, profile=profile, belief="unknown")


def measured_full_steer(world: Any, car: Car, steer: float = 0.3, ticks: int = 40) -> float:
    """rad at a steer of 1, measured on the standing car; `car.full_steer` where the wheels are not given."""
    for _ in range(ticks):
        car.vehicle.apply_control(car.control(steer=steer, brake=1.0, hand_brake=True))
        world.tick()
    found = -car.wheel_angle() / steer
    return found if found > 0.01 else car.full_steer


def follow(world: Any, car: Car, tracker: at.Tracker, most: int = 100_000) -> Iterator[tuple[Tracked, dict]]:
    """Drive by the tracker's plan until the car stands at the end of its path; after each tick its answer, and a row.

    The command is given between two ticks and acts with the next one.
    """
    for _ in range(most):
        world.tick()
        t = world.get_snapshot().timestamp.elapsed_seconds
        sample = sample_of(t, car.vehicle, car.ahead)
        answer = tracker.step(*sample[:6], lateral_velocity=sample.lateral_velocity)
        stop = answer.status in STOP or not math.isfinite(answer.target_speed)
        wanted = 0.0 if stop else answer.target_speed
        throttle, brake = pedals(sample.speed, wanted)
        steer = steer_of(answer.command, car.full_steer)
        car.vehicle.apply_control(car.control(throttle=throttle, brake=brake, steer=steer))
        yield answer, _row(sample, car, steer)
        if sample.speed < 0.2 and (stop or answer.station > tracker.path.length - 3.0):
            return


def _row(sample: Any, car: Car, steer: float) -> dict[str, float]:
    x = sample.x + car.ahead * math.cos(sample.yaw)
    y = sample.y + car.ahead * math.sin(sample.yaw)
    command = angle_of(steer, car.full_steer)
    numbers = (command, car.wheel_angle(), sample.speed, sample.yaw_rate, sample.lateral_velocity, sample.yaw, x, y)
    return dict(zip(COLUMNS, (sample.t, *numbers), strict=True))


def columns_of(rows: list[dict[str, float]]) -> dict[str, NDArray[np.float64]]:
    """The rows of a drive as columns, without those of wheels that are never given (all 0)."""
    found = {name: np.array([row[name] for row in rows]) for name in COLUMNS}
    if not found["wheel"].any():
        del found["wheel"]
    return found


def write_log(log: dict[str, NDArray[np.float64]], path: str | os.PathLike[str]) -> None:
    """A CSV file for `adaptrack identify`."""
    with open(path, "w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(log)
        writer.writerows(zip(*(values.tolist() for values in log.values()), strict=True))

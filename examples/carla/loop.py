"""The loop about a tracker in a synchronous CARLA world, and the log of a drive. Needs no CARLA."""

from __future__ import annotations

import csv
import math
import os
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from conversion import angle_of, sample_of, steer_of
from numpy.typing import NDArray

import adaptrack as at
from adaptrack.control.speed_control import SpeedLimit
from adaptrack.control.tracker import Tracked
from adaptrack.road import SpeedPlan

PERIOD = 0.05
"""s, of a tick: fixed_delta_seconds"""
COLUMNS = ("time", "command", "wheel", "speed", "yaw_rate", "vy", "yaw", "x", "y", "throttle", "brake")
"""Of a log, as `adaptrack identify` reads them; x and y are those of the vehicle's origin."""
LEVELS = (0.3, 0.7, 0.15, 1.0, 0.45, 0.08, 0.85, 0.55)
"""Of the pedals, in the cycles of `PedalSteps`."""
STANDS = (SpeedLimit.PATH_END, SpeedLimit.FAULT)
"""Causes for which a car stands to the end."""


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


def tracker_of(vehicle: at.Vehicle, path: at.Road, plan: SpeedPlan, is_known: bool) -> at.Tracker:
    """A tracker for ticks of `PERIOD`, whose commands act at once; with speed control for a car that is identified.

    Raises
    ------
    adaptrack.InvalidInput
        When the car should be known, and has no pedal map.
    """
    profile = at.load_profile("road").replace(name="carla", delay=0.0, period=PERIOD)
    if not is_known:
        return at.Tracker(at.MPC(vehicle, profile=profile, belief="unknown"), path, plan=plan)
    if vehicle.pedals is None:
        raise at.InvalidInput(f"{vehicle.name} has no [pedals]: identify it from a log of `drive.py record`.")
    return at.Tracker(at.MPC(vehicle, profile=profile), path, plan=plan, speed=at.SpeedControl(vehicle))


class PedalSteps:
    """Pedals of a drive that identifies them: steps of the throttle, of no pedal and of the brake."""

    def __init__(self) -> None:
        self._until, self._step, self._pedals = -math.inf, -1, (0.0, 0.0)

    def pedals(self, time: float, speed: float, target_speed: float) -> tuple[float, float]:
        """Throttle and brake, 0 to 1, at a time (s) and a speed; target_speed: not to be exceeded (m/s)."""
        if speed > target_speed + 1.0 or target_speed < 1.0:
            return 0.0, 0.7
        throttle, brake = self._pedals
        if time >= self._until or (throttle > 0.0 and speed > target_speed) or (brake > 0.0 and speed < 0.5):
            self._step += 1
            cycle, part = divmod(self._step, 5)
            first, second, third = (LEVELS[(cycle + shift) % len(LEVELS)] for shift in (0, 3, 1))
            seconds, *self._pedals = (
                (2.5, first, 0.0), (1.5, second, 0.0), (1.5, 0.0, 0.0), (1.0 if cycle % 2 else 5.0, 0.0, 0.7 * third),
                (2.0, 0.0, 0.0),
            )[part]  # fmt: skip
            self._until = time + seconds
        return self._pedals[0], self._pedals[1]


def measured_full_steer(world: Any, car: Car, steer: float = 0.3, ticks: int = 40) -> float:
    """rad at a steer of 1, measured on the standing car; `car.full_steer` where the wheels are not given."""
    for _ in range(ticks):
        car.vehicle.apply_control(car.control(steer=steer, brake=1.0, hand_brake=True))
        world.tick()
    found = -car.wheel_angle() / steer
    return found if found > 0.01 else car.full_steer


def follow(world: Any, car: Car, tracker: at.Tracker, most: int = 100_000) -> Iterator[tuple[Tracked, dict]]:
    """Drive until the car stands at the end of its path; after each tick the tracker's answer, and a row of the log.

    The pedals are those of the tracker's speed control, or `PedalSteps` without one. The command is given between two
    ticks and acts with the next one.
    """
    steps = PedalSteps()
    for _ in range(most):
        world.tick()
        t = world.get_snapshot().timestamp.elapsed_seconds
        sample = sample_of(t, car.vehicle, car.ahead)
        answer = tracker.step(*sample[:6], lateral_velocity=sample.lateral_velocity)
        request, target_speed = answer.longitudinal, answer.target_speed if math.isfinite(answer.target_speed) else 0.0
        pedals = (request.throttle, request.brake) if request else steps.pedals(t, sample.speed, target_speed)
        steer = steer_of(answer.command, car.full_steer)
        car.vehicle.apply_control(car.control(throttle=pedals[0], brake=pedals[1], steer=steer))
        yield answer, _row(sample, car, steer, pedals)
        if sample.speed < 0.05 and (request.limited_by in STANDS if request else target_speed < 1.0):
            return


def _row(sample: Any, car: Car, steer: float, pedals: tuple[float, float]) -> dict[str, float]:
    x = sample.x + car.ahead * math.cos(sample.yaw)
    y = sample.y + car.ahead * math.sin(sample.yaw)
    command = angle_of(steer, car.full_steer)
    numbers = (command, car.wheel_angle(), sample.speed, sample.yaw_rate, sample.lateral_velocity, sample.yaw, x, y)
    return dict(zip(COLUMNS, (sample.t, *numbers, *pedals), strict=True))


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

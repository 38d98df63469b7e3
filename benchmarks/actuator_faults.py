"""How soon the speed control notices faults of brakes and drive, and how often it reports one of a healthy car.

    python benchmarks/actuator_faults.py [--healthy 600] [--faulty 100] [--seconds 60] [--seed 20270207]

Each car is a point mass. It draws the mass (0.75 to 1.25 of its file), gain (0.85 to 1.1), lag and dead time of drive
(0.1 to 0.45 s, 0.05 to 0.25 s) and brakes (0.06 to 0.25 s, 0.05 to 0.2 s), noise (to 0.03 m/s and 0.6 %) and age (to
0.15 s) of the speed, a wind with gusts, the planned speed (6 to 20 m/s) and its accelerations. The slope changes by up
to 18 % within 30 to 50 m, between -18 and 18 %. The map is flat, or has half of each slope, or has it up to 50 m
away. From a time between 20 and 35 s on, brakes lose all or half of their force, or the drive pulls with 2.5 to 5 m/s^2
whatever is requested. A fault of the brakes begins to count with a request beyond 1 m/s^2.
"""

from __future__ import annotations

import argparse
import math
from collections import deque
from typing import Any, NamedTuple

import numpy as np

from adaptrack import SpeedControl, load_vehicle
from adaptrack.control.speed_control import SpeedController, SpeedLimit
from adaptrack.core.physics.forces import GRAVITY
from adaptrack.road import Comfort, Line, Road, Stop, plan_speed

CAR = load_vehicle("midsize-sedan")
PERIOD, STEP = 0.05, 0.01
"""s: control period; time step of the car."""
LENGTH = 3000.0
"""m, of the road."""
STEEPEST = 0.18
FAULTS = (SpeedLimit.BRAKE_FAULT, SpeedLimit.DRIVE_FAULT)
KINDS = {"brakes without force": (0.0, 0.0), "brakes with half of their force": (0.5, 0.0), "stuck drive": (1.0, 1.0)}
"""By name: share of the brake force that is left; whether the drive pulls."""
OBSERVED_TIME = 30.0
"""s after a report, during which a car must not set off again."""


class Actuator:
    """A force behind dead time, gain and lag."""

    def __init__(self, rng: np.random.Generator, lag: tuple[float, float], dead_time: tuple[float, float]) -> None:
        self.lag, self._gain, self.force = rng.uniform(*lag), rng.uniform(0.85, 1.1), 0.0
        self._requests = deque([0.0] * (1 + round(rng.uniform(*dead_time) / STEP)))

    def target(self, request: float) -> float:
        """Force (N) that the actuator approaches."""
        self._requests.append(request)
        return self._gain * self._requests.popleft()


class Car:
    """A point mass on slopes and in wind, with brakes that may lose force and a drive that may pull."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.s, self.v, self.slope = 0.0, 0.0, 0.0
        self.mass = CAR.mass * rng.uniform(0.75, 1.25)
        self.drive, self.brakes = Actuator(rng, (0.1, 0.45), (0.05, 0.25)), Actuator(rng, (0.06, 0.25), (0.05, 0.2))
        self._wind, self._gust, self._noise = rng.normal(0.0, 4.0), 0.0, rng
        self._drag = 0.5 * CAR.air_density * CAR.frontal_area * CAR.drag_coefficient

    def move(self, force: float, hold: float, brake_share: float, pull: float) -> None:
        """Move for a step behind requests (N); brake_share: of the brake force that is left; pull: m/s^2."""
        self._gust += -self._gust * STEP / 2.0 + 2.0 * math.sqrt(STEP) * self._noise.normal()
        target = max(self.drive.target(max(force, 0.0)), pull * self.mass)
        power = CAR.engine_power / max(self.v, 1.0)
        self.drive.force += (min(target, CAR.traction_limit, power) - self.drive.force) * STEP / self.drive.lag
        target = brake_share * min(self.brakes.target(max(-force, 0.0) + hold), CAR.brake_limit)
        self.brakes.force += (target - self.brakes.force) * STEP / self.brakes.lag
        air = self.v + self._wind + self._gust
        free = (self.drive.force - self._drag * air * abs(air)) / self.mass - GRAVITY * math.sin(math.atan(self.slope))
        friction = self.brakes.force / self.mass + 0.01 * GRAVITY
        if self.v == 0.0 and abs(free) <= friction:
            return
        after = self.v + STEP * (free - math.copysign(friction, self.v or free))
        self.v = 0.0 if self.v * after < 0.0 and abs(free) <= friction else after
        self.s += STEP * self.v


class Slopes(NamedTuple):
    """Grade along the road, and that of the map: s (m), dz/ds, and both of the map."""

    s: np.ndarray
    grade: np.ndarray
    map_s: np.ndarray
    map_grade: np.ndarray


def draw_slopes(rng: np.random.Generator) -> Slopes:
    """Slopes that change by up to 18 % within 30 to 50 m, beside those of the map."""
    s, grade = [0.0, 30.0], [0.0, 0.0]
    while s[-1] < LENGTH:
        s += [s[-1] + rng.uniform(30.0, 50.0)]
        grade += [float(np.clip(grade[-1] + rng.uniform(-STEEPEST, STEEPEST), -STEEPEST, STEEPEST))]
        s += [s[-1] + rng.uniform(10.0, 100.0)]
        grade += [grade[-1]]
    places, grades = np.array(s), np.array(grade)
    way = rng.integers(3)
    if way == 0:
        return Slopes(places, grades, places[:2], np.zeros(2))
    if way == 1:
        return Slopes(places, grades, places, 0.5 * grades)
    return Slopes(
        places, grades, np.maximum(places + np.where(places > 0.0, rng.uniform(-29.0, 50.0), 0.0), 0.0), grades
    )


class Drive(NamedTuple):
    """A drive: the time of the first report (s; NaN: none) and its cause, the way from the fault to it (m)."""

    report: float
    cause: SpeedLimit | None
    way: float
    sets_off: bool
    """whether the car drives on after the report although the fault is still there"""
    speed_error: float
    """m/s, RMS of the speed against its target"""


def drive_one(seed: tuple[int, ...], seconds: float, brake_share: float, pulls: float, make: Any) -> Drive:
    """Drive a car; brake_share, pulls: see `KINDS`; make: `SpeedController`."""
    rng = np.random.default_rng(seed)
    slopes, car = draw_slopes(rng), Car(rng)
    noise, noise_share = rng.uniform(0.0, 0.03), rng.uniform(0.0, 0.006)
    age, begin = round(rng.uniform(0.0, 0.15) / STEP), rng.uniform(20.0, 35.0)
    pull, top_speed = rng.uniform(2.5, 5.0), rng.uniform(6.0, 20.0)
    comfort = Comfort(accelerate=rng.uniform(1.0, 2.0), brake=rng.uniform(1.5, 3.0))
    places = np.cumsum(rng.uniform(60.0, 250.0, 40))
    road = Road.from_segments([Line(length=LENGTH + 600.0)], name="straight")
    road = road.replace(grade=(np.minimum(slopes.map_s, LENGTH + 600.0), slopes.map_grade))
    plan = plan_speed(road, CAR, comfort, stops=[Stop(s, 1.0) for s in places[places < LENGTH]], top_speed=top_speed)
    controller = make(SpeedControl(CAR), road, plan, PERIOD)
    history, errors = deque([(0.0, 0.0)] * (age + 1), maxlen=age + 1), []
    is_healthy, clock, way, report, cause, sets_off = (
        brake_share == 1.0 and pulls == 0.0, math.inf, 0.0, math.nan, None, False,
    )  # fmt: skip
    fault = False
    t = 0.0
    for k in range(round(seconds / PERIOD) if is_healthy else round((begin + 90.0) / PERIOD)):
        t = k * PERIOD
        fault = fault or (not is_healthy and t >= begin and car.v > 3.0)
        s, v = history[0]
        request = controller.step(s, v + (noise + noise_share * v) * rng.normal(), 0.0)
        if (
            fault
            and clock == math.inf
            and (pulls or (max(-request.force, 0.0) + request.hold > CAR.mass and car.v > 0.3))
        ):
            clock, way = t, car.s
        if math.isnan(report) and request.limited_by in FAULTS:
            report, cause, way = t, request.limited_by, car.s - way
        elif not math.isnan(report) and fault:
            sets_off = sets_off or request.limited_by not in FAULTS
        if (is_healthy and not math.isnan(report)) or t > report + OBSERVED_TIME or car.s > LENGTH:
            break
        if t > 20.0:
            errors.append(request.target_speed - car.v)
        for _ in range(round(PERIOD / STEP)):
            car.slope = float(np.interp(car.s, slopes.s, slopes.grade))
            car.move(request.force, request.hold, brake_share if fault else 1.0, pull if fault and pulls else 0.0)
            history.append((car.s, car.v))
    return Drive(
        report if is_healthy else report - clock, cause, way, sets_off,
        float(np.sqrt(np.mean(np.square(errors or [0.0])))),
    )  # fmt: skip


def main() -> None:
    """Drive the cars and print the reports."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--healthy", type=int, default=600)
    parser.add_argument("--faulty", type=int, default=100)
    parser.add_argument("--seconds", type=float, default=60.0, help="of a healthy drive")
    parser.add_argument("--seed", type=int, default=20270207)
    arguments = parser.parse_args()
    drives = [
        drive_one((arguments.seed, 0, k), arguments.seconds, 1.0, 0.0, SpeedController)
        for k in range(arguments.healthy)
    ]
    if drives:
        false = [(k, drive.cause, round(drive.report, 2)) for k, drive in enumerate(drives) if drive.cause]
        errors = np.array([drive.speed_error for drive in drives])
        print(
            f"healthy: {len(false)} of {len(drives)} drives report a fault {false[:8]}; "
            f"speed RMS {errors.mean():.3f} m/s"
        )
    for number, (name, (share, pulls)) in enumerate(KINDS.items(), 1):
        drives = [
            drive_one((arguments.seed, number, k), 0.0, share, pulls, SpeedController) for k in range(arguments.faulty)
        ]
        early = [k for k, drive in enumerate(drives) if drive.report < 0.0]
        times = np.array([drive.report for drive in drives if drive.cause and drive.report >= 0.0])
        ways = np.array([drive.way for drive in drives if drive.cause and drive.report >= 0.0])
        wanted = SpeedLimit.DRIVE_FAULT if pulls else SpeedLimit.BRAKE_FAULT
        print(f"{name}: {times.size} of {len(drives)} reported, {len(early)} before the fault; after (s) median "
              f"{np.median(times):.2f}, 90 % {np.quantile(times, 0.9):.2f}, longest {times.max():.2f}; way (m) median "
              f"{np.median(ways):.1f}, longest {ways.max():.1f}; with this cause "
              f"{sum(drive.cause is wanted for drive in drives)}, set off again "
              f"{sum(drive.sets_off for drive in drives)}")  # fmt: skip
        print(
            "   missed", [k for k, drive in enumerate(drives) if not drive.cause], "late",
            [(k, round(d.report, 2)) for k, d in enumerate(drives) if d.report > 2.0],
        )  # fmt: skip


if __name__ == "__main__":
    main()

"""How well the speed control follows a plan and stops, behind drive and brakes that it does not know.

    python benchmarks/longitudinal.py [--cars 200] [--driver control|naive|autoware] [--smooth-plan] [--seed 20261126]

Each car draws lag (to 0.6 s), dead time (to 0.4 s) and gain (0.85 to 1.1) of drive and of brakes, a mass of 0.85 to 1.4
times the one in its file, and a slope of -10 to 10 % from 300 m on, all from the seed. It drives 900 m at up to
15 m/s with stops at 250 and 600 m. --driver: the speed control, the naive driver of the simulation, or Autoware's
structure with its published parameters (the plug-in `autoware_speed` in examples/plugins/, in PYTHONPATH).
--smooth-plan: 1 m/s^2 and 1 m/s^3 at most, as Autoware's planner has it, instead of 1.5 and 2 m/s^2 without a limit of
jerk.
"""

from __future__ import annotations

import argparse
from importlib import import_module
from typing import Any

import numpy as np

from adaptrack import MPC, DualTrack, RoadDrive, SpeedControl, load_vehicle, simulate
from adaptrack.cars.vehicle import BrakeActuator, DriveActuator
from adaptrack.drive.world import Driver
from adaptrack.road import Comfort, Line, Road, Stop, plan_speed

STOPS = (250.0, 600.0)
CAR = load_vehicle("midsize-sedan")
SETTLED = 20.0
"""s, after which the error of the speed counts."""


DRIVERS = {
    "control": (SpeedControl, "speed control, nothing known"), "naive": (lambda car: Driver(), "naive driver"),
    "autoware": (lambda car: import_module("autoware_speed").AutowareSpeed(car), "Autoware's structure, as published"),
}  # fmt: skip
"""Factories that take the car of the file, and what the table calls them."""


def drive_one(
    rng: np.random.Generator, seed: int, driver: Any, is_smooth: bool
) -> tuple[float, list[float], list[float], list[float]]:
    """RMS error of the speed (m/s), and of each stop error, largest jerk in the last metre (m/s^3), way back (m)."""
    delays = [{"lag": rng.uniform(0.0, 0.6), "dead_time": rng.uniform(0.0, 0.4), "gain": rng.uniform(0.85, 1.1)}
              for _ in range(2)]  # fmt: skip
    mass, grade = rng.uniform(0.85, 1.4), rng.uniform(-0.1, 0.1)
    road = Road.from_segments([Line(length=900.0)], name="straight")
    road = road.replace(grade=([0.0, 300.0, 320.0, 900.0], [0.0, 0.0, grade, grade]))
    comfort = Comfort(accelerate=1.0, brake=1.0, jerk=1.0) if is_smooth else Comfort(accelerate=1.5, brake=2.0)
    plan = plan_speed(road, CAR, comfort, stops=[Stop(s, 3.0) for s in STOPS], top_speed=15.0)
    car = CAR.replace(
        mass=CAR.mass * mass, yaw_inertia=CAR.yaw_inertia * mass, drive=DriveActuator(**delays[0]),
        brakes=BrakeActuator(**delays[1]),
    )  # fmt: skip
    run = simulate(
        DualTrack(car), MPC(CAR, profile="road"), RoadDrive(road, plan), profile="road", driver=driver, seed=seed
    )
    s, speed, jerk = run.road["station"], run.vx, np.zeros(run.vx.size)
    mean_acceleration = (speed[4:] - speed[:-4]) / (4 * run.period)  # over 0.2 s
    jerk[4:-4] = np.abs(mean_acceleration[4:] - mean_acceleration[:-4]) / (4 * run.period)
    planned = plan.at(s)
    counted = (run.t > SETTLED) & (planned > 1.0)
    errors, jerks, back = [], [], []
    for stop in STOPS:
        stands = np.flatnonzero((speed < 0.01) & (np.abs(s - stop) < 8.0))
        if not stands.size:
            errors.append(np.inf)
            continue
        errors.append(float(s[stands[0]] - stop))
        last_metre = (s > stop - 1.0) & (np.arange(s.size) < stands[0])
        jerks.append(float(jerk[last_metre].max(initial=0.0)))
        back.append(float(s[stands[0]] - s[stands[0] :].min()))
    return float(np.sqrt(np.mean((speed - planned)[counted] ** 2))), errors, jerks, back


def main() -> None:
    """Drive the cars and print quantiles."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cars", type=int, default=200)
    parser.add_argument("--driver", choices=list(DRIVERS), default="control")
    parser.add_argument("--smooth-plan", action="store_true", help="1 m/s^2 and 1 m/s^3 at most")
    parser.add_argument("--seed", type=int, default=20261126)
    arguments = parser.parse_args()
    rng = np.random.default_rng(arguments.seed)
    make_driver, title = DRIVERS[arguments.driver]
    runs = [drive_one(rng, seed, make_driver(CAR), arguments.smooth_plan) for seed in range(arguments.cars)]
    speed = np.array([run[0] for run in runs])
    errors, jerks, back = (np.array([value for run in runs for value in run[i]]) for i in (1, 2, 3))
    print(f"{arguments.cars} cars, {title}")
    print(f"speed RMS (m/s) after {SETTLED:.0f} s: mean {speed.mean():.3f}, 95 % {np.quantile(speed, 0.95):.3f}, "
          f"largest {speed.max():.3f}")  # fmt: skip
    print(f"stops (m): within 0.15 m {100 * np.mean(np.abs(errors) < 0.15):.0f} %, median {np.median(errors):+.3f}, "
          f"95 % {np.quantile(np.abs(errors), 0.95):.3f}, largest {np.abs(errors).max():.3f}")  # fmt: skip
    print(f"jerk over 0.2 s in the last metre (m/s^3): median {np.median(jerks):.2f}, "
          f"95 % {np.quantile(jerks, 0.95):.2f}, largest {np.max(jerks):.2f}, "
          f"at most 2.5 at {100 * np.mean(np.array(jerks) <= 2.5):.0f} %")  # fmt: skip
    print(f"rolled back at most {back.max():.3f} m")


if __name__ == "__main__":
    main()

"""What drive forces cost near the grip: cars lost, errors and distance lost with prescribed speed and with drivers.

    python benchmarks/near_the_grip.py [--cars van ...] [--profile road]    0.8 and 0.98 of the grip, 16 roads
    python benchmarks/near_the_grip.py --friction 0.9 0.78 0.69             plans for 0.9 on these true frictions
    python benchmarks/near_the_grip.py --comfort                            J with forces over prescribed, 4 m/s^2

Roads and seeds are those of `ROADS` and `SEEDS`, written down before the first run. The controller is the informed one,
which knows its car; plan and driver know the friction.
"""

from __future__ import annotations

import argparse
import math

import numpy as np

from adaptrack import MPC, DualTrack, Perception, RoadDrive, load_vehicle, rollout_batch, simulate
from adaptrack.control.speed_control import SpeedControl
from adaptrack.drive.world import Driver
from adaptrack.road import Comfort, Road, generate_road, plan_speed

CARS = ("midsize-sedan", "van", "sports-car", "compact-ev")
ROADS = [(kind, seed) for kind in ("lap", "mountain", "country", "town") for seed in (11, 12, 13, 14)]
COMFORT_ROADS, SEEDS = [(kind, seed) for kind, seed in ROADS if seed < 14], (1, 2, 3)
SHARES = (0.8, 0.98)
LENGTH = 2000.0
DRIVERS = {
    "prescribed": lambda car: None,
    "by place": lambda car: Driver(guard=math.inf),
    "with guard": lambda car: Driver(),
    "speed control": lambda car: SpeedControl(car, friction=0.9),
    "0.65 to 0.9": lambda car: SpeedControl(car, friction=(0.65, 0.9)),
}
"""Last: a speed control that knows an interval of the friction."""


def _road(kind: str, seed: int) -> Road:
    return generate_road(kind, seed, LENGTH).replace(speed_limit=None)


def near_the_grip(car_name: str, share: float, profile: str, friction: float) -> None:
    """Print a row for each driver: cars lost, RMS and largest error (m), distance lost (%); friction: the true one."""
    car = load_vehicle(car_name)
    controller, roads = MPC(car, profile=profile), [_road(*road) for road in ROADS]
    plans = [plan_speed(road, car, Comfort(lateral=20.0, grip_share=share)) for road in roads]
    peaks = [
        np.abs(plan.at(plan.s) ** 2 * road.at(plan.s).curvature).max() for road, plan in zip(roads, plans, strict=True)
    ]
    print(f"{car_name}, {share:g} of the grip, {profile}, friction {friction:g}: "
          f"plans reach {min(peaks):.2f} to {max(peaks):.2f} m/s^2 sideways")  # fmt: skip
    for label, make_driver in DRIVERS.items():
        runs = [
            simulate(
                DualTrack(car), controller, RoadDrive(road.replace(friction=friction), plan), profile=profile,
                driver=make_driver(car), seed=1, perception=Perception(friction=0.9),
            )
            for road, plan in zip(roads, plans, strict=True)
        ]  # fmt: skip
        kept = [run for run in runs if run.failed is None]
        rms = np.sqrt(np.mean([np.mean(run.error**2) for run in kept])) if kept else math.nan
        largest = max((np.abs(run.error).max() for run in kept), default=math.nan)
        lost_distance = [1.0 - run.road["station"][-1] / (road.length - run.vx[-1] * run.period)
                         for run, road in zip(runs, roads, strict=True) if run.failed is None]  # fmt: skip
        print(f"  {label:12} lost {len(runs) - len(kept):2} of {len(runs)}; RMS {rms:.3f}, largest {largest:.2f} m; "
              f"distance lost {100 * np.mean(lost_distance):.2f} %", flush=True)  # fmt: skip


def price_of_forces(car_name: str, profile: str) -> None:
    """Print the geometric mean, with its 95 % interval over roads and seeds, of J with forces over prescribed speed."""
    car, logarithms = load_vehicle(car_name), []
    for kind, seed in COMFORT_ROADS:
        road = _road(kind, seed)
        drive = RoadDrive(road, plan_speed(road, car, Comfort(lateral=4.0)))
        costs = [
            rollout_batch(
                DualTrack(car), MPC(car, profile=profile), drive, profile=profile, driver=driver,
                scenario_indices=np.zeros(len(SEEDS), int), seeds=SEEDS,
            ).cost(3.0)
            for driver in (None, Driver())
        ]  # fmt: skip
        logarithms.append(np.log(costs[1] / costs[0]))
    ratios = np.array(logarithms).mean(axis=1)  # seeds of a road belong together
    half_width = 1.96 * ratios.std(ddof=1) / math.sqrt(ratios.size)
    low, middle, high = np.exp(ratios.mean() + half_width * np.array([-1.0, 0.0, 1.0]))
    print(f"{car_name}, {profile}: J with forces over prescribed {middle:.3f} [{low:.3f}, {high:.3f}]", flush=True)


def main() -> None:
    """Measure what the command line names."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cars", nargs="+", default=CARS)
    parser.add_argument("--profile", default="road")
    parser.add_argument("--friction", nargs="+", type=float, default=[0.9], help="true frictions; assumed are 0.9")
    parser.add_argument("--comfort", action="store_true", help="at 4 m/s^2: J with forces over prescribed speed")
    arguments = parser.parse_args()
    for car in arguments.cars:
        if arguments.comfort:
            price_of_forces(car, arguments.profile)
        else:
            for share in SHARES:
                for friction in arguments.friction:
                    near_the_grip(car, share, arguments.profile, friction)


if __name__ == "__main__":
    main()

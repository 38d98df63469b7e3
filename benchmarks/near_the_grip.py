"""What drive forces cost near the grip: cars lost, errors and distance lost with prescribed speed and with drivers.

    python benchmarks/near_the_grip.py [--cars van ...] [--profile road]    0.8 and 0.98 of the grip, 16 roads
    python benchmarks/near_the_grip.py --friction 0.9 0.78 0.69             plans for 0.9 on these true frictions
    python benchmarks/near_the_grip.py --friction 0.69 --drivers "low told" "0.65 to 0.9" "shape told" "told 0.69"
    python benchmarks/near_the_grip.py --ways sheet soft --drivers "0.65 to 0.9"    controllers that do not know the car
    python benchmarks/near_the_grip.py --honest --profile production-bus --seeds 400 401    at 4 m/s^2, friction 0.9
    python benchmarks/near_the_grip.py --comfort                            J with forces over prescribed, 4 m/s^2

Roads and seeds are those of `ROADS` and `SEEDS`, written down before the first run. The controller is the informed one,
which knows its car, or one of `WAYS`; the plan, of the true car, and the driver assume a friction of 0.9.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterable, Sequence
from itertools import product

import numpy as np

from adaptrack import MPC, DualTrack, Learning, Perception, RoadDrive, load_vehicle, rollout_batch, simulate
from adaptrack.cars.data_sheet import vehicle_from_data_sheet
from adaptrack.cars.vehicle import Vehicle
from adaptrack.control.speed_control import SpeedControl
from adaptrack.drive.trajectory import Trajectory
from adaptrack.drive.world import Driver
from adaptrack.road import Comfort, Road, generate_road, plan_speed

CARS = ("midsize-sedan", "van", "sports-car", "compact-ev")
KINDS = ("lap", "mountain", "country", "town")
ROADS = [(kind, seed) for kind in KINDS for seed in (11, 12, 13, 14)]
COMFORT_ROADS, SEEDS = [(kind, seed) for kind, seed in ROADS if seed < 14], (1, 2, 3)
SHARES = (0.8, 0.98)
LENGTH = 2000.0
DRIVERS = {
    "prescribed": lambda car: None, "by place": lambda car: Driver(guard=math.inf),
    "with guard": lambda car: Driver(), "speed control": lambda car: SpeedControl(car, friction=0.9),
    "0.65 to 0.9": lambda car: SpeedControl(car, friction=(0.65, 0.9)),
    "shape told": lambda car: SpeedControl(car, friction=(0.65, 0.9), tyre_shape="file"),
    "low told": lambda car: SpeedControl(car, friction=0.65),
    **{f"told {friction:g}": lambda car, friction=friction: SpeedControl(car, friction=friction)
       for friction in (0.69, 0.78)},
}  # fmt: skip
"""From the interval on: speed controls that know an interval of the friction, the same with the shape of the tyre's
curve, its low end alone, and the truth: no estimate of the friction loses less way."""
STIFFNESS_ERROR = 1.6


def _wrong_stiffness(car: Vehicle, factor: float) -> Vehicle:
    return car.replace(stiffness_front=factor * car.stiffness_front, stiffness_rear=factor * car.stiffness_rear)


WAYS = {
    "known": (lambda car: car, False),
    "sheet": (lambda car: vehicle_from_data_sheet(car.name, car.mass, car.wheelbase), True),
    "soft": (lambda car: _wrong_stiffness(car, 1.0 / STIFFNESS_ERROR), False),
    "stiff": (lambda car: _wrong_stiffness(car, STIFFNESS_ERROR), False),
    "soft-learning": (lambda car: _wrong_stiffness(car, 1.0 / STIFFNESS_ERROR), True),
    "stiff-learning": (lambda car: _wrong_stiffness(car, STIFFNESS_ERROR), True),
}
"""The car as controller and speed control assume it, and whether they learn it with the steering; others know the
steering from the profile. soft, stiff: tyres whose stiffness is assumed wrong by a factor."""


def _road(kind: str, seed: int) -> Road:
    return generate_road(kind, seed, LENGTH).replace(speed_limit=None)


def _lost_distance(run: Trajectory, road: Road) -> float:
    """Share of the road that the car is behind its plan at the end."""
    return 1.0 - float(run.road["station"][-1] / (road.length - run.vx[-1] * run.period))


def near_the_grip(
    car_name: str, share: float, profile: str, friction: float, way: str = "known",
    drivers: Iterable[str] = DRIVERS, places: Sequence[tuple[str, int]] = ROADS, noise: Sequence[int] = (1,),
) -> None:  # fmt: skip
    """Print a row for each driver: cars lost, RMS and largest error (m), distance lost (%).

    friction: the true one; way: of `WAYS`; places: kinds and seeds of the roads; noise: seeds of the sensors.
    """
    car, (perception, learns) = load_vehicle(car_name), WAYS[way]
    known_car, roads = perception(car), [_road(*place) for place in places]
    controller = MPC(known_car, profile=profile, **{"learning": Learning()} if learns else {})
    plans = [plan_speed(road, car, Comfort(lateral=20.0, grip_share=share)) for road in roads]
    peaks = [
        np.abs(plan.at(plan.s) ** 2 * road.at(plan.s).curvature).max() for road, plan in zip(roads, plans, strict=True)
    ]
    print(f"{car_name}, {way}, {share:g} of the grip, {profile}, friction {friction:g}: "
          f"plans reach {min(peaks):.2f} to {max(peaks):.2f} m/s^2 sideways")  # fmt: skip
    for label in drivers:
        runs = [
            simulate(
                DualTrack(car), controller, RoadDrive(road.replace(friction=friction), plan), profile=profile,
                driver=DRIVERS[label](known_car), seed=seed, perception=Perception(friction=0.9),
            )
            for seed, (road, plan) in product(noise, zip(roads, plans, strict=True))
        ]  # fmt: skip
        kept = [run for run in runs if run.failed is None]
        rms = np.sqrt(np.mean([np.mean(run.error**2) for run in kept])) if kept else math.nan
        largest = max((np.abs(run.error).max() for run in kept), default=math.nan)
        lost_distance = [_lost_distance(run, road) for run, road in zip(runs, len(noise) * roads, strict=True)
                         if run.failed is None]  # fmt: skip
        print(f"  {label:12} lost {len(runs) - len(kept):2} of {len(runs)}; RMS {rms:.3f}, largest {largest:.2f} m; "
              f"distance lost {100 * np.mean(lost_distance):.2f} %", flush=True)  # fmt: skip


def honest_drives(car_name: str, profile: str, seeds: Sequence[int]) -> None:
    """Print for speed controls on dry roads planned for 4 m/s^2: failures, distance lost (%), strongest request.

    seeds: of roads and sensors.
    """
    car = load_vehicle(car_name)
    controller, roads = MPC(car, profile=profile), [(_road(kind, seed), seed) for kind in KINDS for seed in seeds]
    for label in ("speed control", "0.65 to 0.9"):
        failures, lost, braking = 0, [], 0.0
        for road, seed in roads:
            drive = RoadDrive(road, plan_speed(road, car, Comfort(lateral=4.0)))
            run = simulate(DualTrack(car), controller, drive, profile=profile, driver=DRIVERS[label](car), seed=seed)
            failures += run.failed is not None
            lost.append(100.0 * _lost_distance(run, road))
            braking = min(braking, np.nanmin(run.diagnostics["requested_acceleration"]))
        print(f"{car_name}, {profile}, {label:13} failed {failures} of {len(roads)}; "
              f"distance lost {np.mean(lost):.2f} %, at most {max(lost):.2f} %; "
              f"braking requested at most {-braking:.2f} m/s^2", flush=True)  # fmt: skip


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
    parser.add_argument("--shares", nargs="+", type=float, default=SHARES, help="of the grip, in the plan")
    parser.add_argument("--ways", nargs="+", default=["known"], choices=WAYS, help="what controller and driver know")
    parser.add_argument("--drivers", nargs="+", default=tuple(DRIVERS)[:5], choices=DRIVERS)
    parser.add_argument("--seeds", nargs="+", type=int, default=(11, 12, 13, 14), help="of the roads")
    parser.add_argument("--noise", nargs="+", type=int, default=(1,), help="seeds of the sensors")
    parser.add_argument("--honest", action="store_true", help="speed controls at 4 m/s^2 on dry roads")
    parser.add_argument("--comfort", action="store_true", help="at 4 m/s^2: J with forces over prescribed speed")
    arguments = parser.parse_args()
    if arguments.comfort:
        for car in arguments.cars:
            price_of_forces(car, arguments.profile)
        return
    if arguments.honest:
        for car in arguments.cars:
            honest_drives(car, arguments.profile, arguments.seeds)
        return
    places = list(product(KINDS, arguments.seeds))
    for way, car, share, friction in product(arguments.ways, arguments.cars, arguments.shares, arguments.friction):
        near_the_grip(car, share, arguments.profile, friction, way, arguments.drivers, places, arguments.noise)


if __name__ == "__main__":
    main()

"""What the default controller does with a steering that it does not know, or knows wrongly.

    python benchmarks/unknown_steering.py [--drives 48]

Random drives in the profile `road` (noise), the true lag and delay behind them changed: geometric mean of
J = mean e^2 + 3 mean (change of command)^2 (a failed run counts 25 m^2), and the failed runs. Then random cars whose
steering is not that of the profile that is named, known by mass and wheelbase: believing the profile, and learning.
"""

from __future__ import annotations

import argparse
import itertools
import logging
import math
from typing import Any

import numpy as np

import adaptrack as at
from adaptrack.identification import random_car

FAILED = 25.0
CARS = {"paper": "magic-formula", "midsize-sedan": None}
LAGS = (0.0, 0.05, 0.1, 0.2, 0.35, 0.45)
BELIEVED = (0.05, 0.1, 0.15, 0.2, 0.25, 0.35)


def driven(plant: at.Plant, mpc: at.MPC, profile: at.Profile, drives: list[at.Scenario]) -> str:
    """J and the failed runs."""
    count = len(drives)
    found = at.rollout_batch(plant, mpc, drives, which=np.arange(count), profile=profile, seeds=np.arange(count))
    failed = np.array([reason is not None for reason in found.failed])
    cost = np.where(failed, FAILED, found.cost(profile.move_weight))
    return f"{math.exp(np.log(cost).mean()):.5f} ({failed.sum()})"


def in_another_world(name: str, number: int, learning: at.Learning | None) -> float:
    """J of a random car on a drive of its own; the controller is given a profile's name and the data sheet."""
    made = random_car(7_200_000 + number, profile=name)
    sheet = at.vehicle_from_data_sheet("sheet", made.vehicle.mass, made.vehicle.wheelbase)
    mpc, plant = at.MPC(sheet, profile=name, learning=learning), at.DualTrack(made.vehicle, made.tyre)
    run = at.rollout(plant, mpc, at.random_drive(7_300_000 + number), profile=made.profile, seed=number)
    return FAILED if run.failed else float(np.mean(run.error**2) + 3.0 * np.mean(run.command_change**2))


def main() -> None:
    """Drive both cars and print a row each."""
    ask = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ask.add_argument("--drives", type=int, default=48)
    logging.getLogger("adaptrack").setLevel(logging.ERROR)  # what is believed wrongly is wanted here
    drives: list[Any] = [at.random_drive(5_200_000 + number) for number in range(ask.parse_args().drives)]
    road = at.load_profile("road")
    print("nothing known of the steering; true lag", *LAGS)
    for name, tyre in CARS.items():
        car = at.load_vehicle(name).replace(steering=None)
        for delay, learning in itertools.product((0.0, 1.0), (None, "auto")):
            row = []
            for lag in LAGS:
                actuator = at.SteeringActuator(lag=lag, rate=road.steering.rate if lag else math.inf)
                plant, mpc = at.DualTrack(car, tyre, steering=actuator), at.MPC(car, learning=learning)
                row.append(driven(plant, mpc, road.replace(delay=delay), drives))
            how = "not learning" if learning is None else "learning"
            print(f"{name}, {delay:g} periods of delay, {how}:", *row, flush=True)
    print("lag told wrongly, true 0.15 s; believed", *BELIEVED)
    for name, tyre in CARS.items():
        car = at.load_vehicle(name).replace(steering=None)
        for words, limits in (("moves bounded", None), ("not bounded", at.Limits())):
            row = []
            for lag in BELIEVED:
                mpc = at.MPC(car, profile=road, belief=at.Steering(lag=lag), limits=limits)
                row.append(driven(at.DualTrack(car, tyre), mpc, road, drives))
            print(f"{name}, {words}:", *row, flush=True)
    print("the profile that is named is not the car's; 100 cars")
    methods = {
        "believing the profile": None,
        "learning": at.Learning(),
        "learning, 4 hypotheses of the dead time": at.Learning(dead_times=4),
    }
    for profile, (words, learning) in itertools.product(("road", "production"), methods.items()):
        cost = np.array([in_another_world(profile, number, learning) for number in range(100)])
        print(f"{profile}, {words}: {math.exp(np.log(cost).mean()):.5f} ({(cost == FAILED).sum()})", flush=True)


if __name__ == "__main__":
    main()

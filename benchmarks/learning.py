"""Random cars that nobody has measured: the controller that learns them, beside the same told the truth, and others.

    python benchmarks/learning.py [--cars 200] [--seed 1] [--profile road] [--only NAME ...] [--json]

A car is the paper's or the saloon, log-uniform about it: mass and inertia x.6-1.6, stiffness x.5-2.5, front over rear
x.85-1.18; its steering has .05-.35 s of lag, 0-.25 s of dead time and a bias within +-.02 rad (uniform), its sensors
x.3-3 the noise of the profile. The controllers believe the middle of these ranges, and those that can are told them.

Each car drives for 180 s (random_drive). J = mean e^2 + w mean (change of command)^2 with the profile's w, by minutes;
a minute of a failed run counts 25 m^2. The truth is told in a world without the bias, which is a command from which a
known bias has been taken since before the start. Ratios: geometric means over the cars whose drive the truth survives.
"""

from __future__ import annotations

import argparse
import json
import math
from typing import Any, NamedTuple

import numpy as np

import adaptrack as at
from adaptrack.cars.vehicle import Steering, Tyre, load_tyre
from adaptrack.control.controllers import Learning, Uncertainty, get_controller
from adaptrack.drive.batch import Batch
from adaptrack.scenario import random_drive
from adaptrack.scenario.profile import Profile, load_profile

FAILED, MINUTE, MINUTES, DRIVES = 25.0, 60.0, 3, 31_000_000
MASS, STIFFNESS, BALANCE, NOISE = (0.6, 1.6), (0.5, 2.5), (0.85, 1.18), (0.3, 3.0)
LAG, DEAD_TIME, BIAS = (0.05, 0.35), (0.0, 0.25), 0.02
NOISES = ("vy", "yaw", "yaw_rate", "y", "wheel_angle", "lateral_acceleration")
MIDDLE = Steering(lag=sum(LAG) / 2, dead_time=sum(DEAD_TIME) / 2)
TOLD = Uncertainty(
    lag=LAG[1] - sum(LAG) / 2, dead_time=DEAD_TIME[1] - sum(DEAD_TIME) / 2,
    stiffness=math.sqrt(STIFFNESS[1] / STIFFNESS[0]), mass=math.sqrt(MASS[1] / MASS[0]) - 1.0,
)  # fmt: skip


class Car(NamedTuple):
    """A random car."""

    number: int
    base: at.Vehicle
    body: at.Vehicle
    """as it is, matched to its tyre"""
    tyre: Tyre
    world: Profile


def _scaled(car: at.Vehicle, mass: float, front: float, rear: float) -> at.Vehicle:
    return car.replace(
        mass=car.mass * mass, yaw_inertia=car.yaw_inertia * mass, stiffness_front=car.stiffness_front * front,
        stiffness_rear=car.stiffness_rear * rear,
    )  # fmt: skip


def random_car(number: int, seed: int, profile: Profile) -> Car:
    """One of the cars that the page speaks of."""
    rng = np.random.default_rng((seed, number))

    def factor(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    base = at.load_vehicle(("paper", "midsize-sedan")[number % 2])
    mass, stiffness, balance = factor(*MASS), factor(*STIFFNESS), factor(*BALANCE)
    lag, dead_time, bias = (float(rng.uniform(*ends)) for ends in (LAG, DEAD_TIME, (-BIAS, BIAS)))
    noise = factor(*NOISE)
    wanted = _scaled(base, mass, stiffness * math.sqrt(balance), stiffness / math.sqrt(balance))
    tyre = load_tyre(base.tyre)
    front, rear = wanted.stiffness_factors(tyre)
    tyre = tyre.replace(stiffness_front=tyre.stiffness_front / front, stiffness_rear=tyre.stiffness_rear / rear)
    noises = {f"noise_{name}": noise * getattr(profile, f"noise_{name}") for name in NOISES}
    steering = profile.steering.replace(lag=lag, dead_time=dead_time, bias=bias)
    return Car(number, base, wanted.matched_to(tyre), tyre, profile.replace(**noises, steering=steering))


def middle(base: at.Vehicle) -> at.Vehicle:
    """What is believed of a car."""
    mass, stiffness = math.sqrt(MASS[0] * MASS[1]), math.sqrt(STIFFNESS[0] * STIFFNESS[1])
    return _scaled(base, mass, stiffness, stiffness).replace(steering=MIDDLE)


def contenders(car: Car, profile: Profile) -> dict[str, tuple[Any, Profile]]:
    """Name -> (controller, world)."""
    without = car.world.replace(steering=car.world.steering.replace(bias=0.0))
    believed, sampled = middle(car.base), {"period": profile.period, "preview": profile.preview}
    given = {"profile": profile, "belief": MIDDLE, "uncertainty": TOLD}
    return {
        "told the truth": (at.MPC(car.body, profile=without, belief=Steering(**_steering(without))), without),
        "learning": (at.MPC(believed, **given, learning=Learning()), car.world),
        "not learning": (at.MPC(believed, **given), car.world),
        "told all but the bias": (at.MPC(car.body, profile=without, belief=Steering(**_steering(without))), car.world),
        **{name: (get_controller(name, believed, **sampled), car.world) for name in ("lqr", "pure-pursuit")},
    }


def _steering(world: Profile) -> dict[str, float]:
    return {name: getattr(world.steering, name) for name in ("lag", "dead_time", "rate", "limit")}


def costs(car: Car, controller: Any, world: Profile) -> tuple[np.ndarray, bool]:
    """J of each minute, and whether the drive failed."""
    drive = random_drive(DRIVES + 4 * car.number, MINUTE * MINUTES)
    batch = Batch(at.DualTrack(car.body, car.tyre), controller, [drive], world)
    segment = round(MINUTE / world.period)
    runs = batch.run(
        np.zeros(1, np.int64), batch.tuning[None], np.array([4 * car.number]), 1, segment=segment,
        weight=world.move_weight,
    )  # fmt: skip
    found = runs.segments[0] / segment
    return np.where(np.isfinite(found), found, FAILED), bool(runs.has_failed[0])


def compared(name: str, cost: np.ndarray, failed: np.ndarray, truth: np.ndarray, lost: np.ndarray) -> dict[str, Any]:
    """A contender beside the truth: cost (cars, minutes), failed (cars,)."""
    ratio = np.log(cost / truth)[~lost]
    late = np.log(cost[:, 1:].mean(axis=1) / truth[:, 1:].mean(axis=1))[~lost]
    return {
        "contender": name, "J": float(np.exp(np.log(cost).mean())), "first": float(np.exp(ratio[:, 0].mean())),
        "first_p90": float(np.exp(np.quantile(ratio[:, 0], 0.9))), "late": float(np.exp(late.mean())),
        "late_worst": float(np.exp(late.max())), "failed": int(failed.sum()),
        "failed_where_truth_survives": int((failed & ~lost).sum()), "cars": len(cost),
    }  # fmt: skip


def main() -> None:
    """Drive the cars with each contender, print a row each."""
    ask = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ask.add_argument("--cars", type=int, default=200)
    ask.add_argument("--seed", type=int, default=1)
    ask.add_argument("--profile", default="road")
    ask.add_argument("--only", nargs="*", default=None, help="contenders beside the truth")
    ask.add_argument("--json", action="store_true")
    given = ask.parse_args()
    profile = load_profile(given.profile)
    found: dict[str, list[tuple[np.ndarray, bool]]] = {}
    for number in range(given.cars):
        car = random_car(number, given.seed, profile)
        for name, (controller, world) in contenders(car, profile).items():
            if given.only is None or name in (*given.only, "told the truth"):
                found.setdefault(name, []).append(costs(car, controller, world))
    truth, lost = (np.array(each) for each in zip(*found["told the truth"], strict=True))
    rows = []
    for name, runs in found.items():
        cost, failed = (np.array(each) for each in zip(*runs, strict=True))
        rows.append({"profile": given.profile, **compared(name, cost, failed, truth, lost)})
    for row in rows if not given.json else ():
        print(
            f"{row['contender']:22s} J {row['J']:.5f}  0-60 s x{row['first']:.3f} (p90 {row['first_p90']:.2f})  "
            f"60-180 s x{row['late']:.3f} (worst {row['late_worst']:.2f})  failed {row['failed']} of {row['cars']}, "
            f"{row['failed_where_truth_survives']} where the truth survives"
        )
    if given.json:
        print(json.dumps(rows))


if __name__ == "__main__":
    main()

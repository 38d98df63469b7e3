"""Drives with a controller whose belief about the car is wrong, within what it was told of its uncertainty.

    python benchmarks/wrong_beliefs.py [--drives 100] [--vehicle paper midsize-sedan] [--json]

The world is the profile `road` and the car as it ships. A case tells the controller another lag, dead time, stiffness
or mass, and by how much it may be wrong; nothing is tuned for a case. The last cases tell it all four, at all corners.
J = mean e^2 + w mean (change of command)^2 with the profile's w, geometric mean; a failed run counts 25 m^2.
"""

from __future__ import annotations

import argparse
import itertools
import json
from typing import Any

import numpy as np

import adaptrack as at
from adaptrack.control.controllers import Uncertainty
from adaptrack.drive.batch import rollout_batch
from adaptrack.scenario import random_drive
from adaptrack.scenario.profile import load_profile

FAILED = 25.0
WORLD = load_profile("road")
DRIVES = 21_000_000
TOLD = Uncertainty(lag=0.1, dead_time=0.05, stiffness=1.6, mass=0.3)
EXACT = {"lag": 0.0, "dead_time": 0.0, "stiffness": 1.0, "mass": 1.0}
"""True value against the one believed: added to a delay (s), factor on stiffness and mass."""
INSIDE = {
    "lag": (-0.1, -0.05, 0.0, 0.05, 0.1),
    "dead_time": (-0.05, 0.0, 0.05),
    "stiffness": (1 / 1.6, 1 / 1.25, 1.0, 1.25, 1.6),
    "mass": (0.7, 0.85, 1.0, 1.15, 1.3),
}


def believing(car: at.Vehicle, wrong: dict[str, float], uncertainty: Uncertainty) -> at.MPC:
    """The controller that believes what differs from the truth by `wrong`."""
    off = EXACT | wrong
    believed = car.replace(
        mass=car.mass / off["mass"], yaw_inertia=car.yaw_inertia / off["mass"],
        stiffness_front=car.stiffness_front / off["stiffness"], stiffness_rear=car.stiffness_rear / off["stiffness"],
    )  # fmt: skip
    late = WORLD.delay * WORLD.period - off["dead_time"]  # in all, the computation included
    steering = WORLD.steering.replace(lag=WORLD.steering.lag - off["lag"], dead_time=late)
    return at.MPC(believed, profile=WORLD.replace(delay=0, steering=steering), uncertainty=uncertainty)


def cases() -> list[tuple[str, dict[str, float], Uncertainty]]:
    """Label, what is wrong, what the controller is told of it."""
    alone = [
        (f"{name} {'x' if EXACT[name] else '+'} {value:.3g}", {name: value}, Uncertainty(**{name: getattr(TOLD, name)}))
        for name, values in INSIDE.items()
        for value in values
    ]
    ends = [(values[0], values[-1]) for values in INSIDE.values()]
    corners = [dict(zip(INSIDE, corner, strict=True)) for corner in itertools.product(*ends)]
    together = [("all four: " + ", ".join(f"{v:.3g}" for v in corner.values()), corner, TOLD) for corner in corners]
    return [("exact, told so", {}, Uncertainty()), *alone, ("all four: exact", {}, TOLD), *together]


def judge(plant: Any, mpc: at.MPC, drives: list[Any]) -> dict[str, float]:
    """J, its 99th percentile and the failed runs."""
    runs = rollout_batch(plant, mpc, drives, profile=WORLD, seeds=np.arange(len(drives)))
    failed = np.array([reason is not None for reason in runs.failed])
    cost = np.where(failed, FAILED, runs.cost(WORLD.move_weight))
    return {
        "J": float(np.exp(np.log(cost).mean())), "p99": float(np.percentile(cost, 99)), "failed": int(failed.sum()),
        "runs": len(drives),
    }  # fmt: skip


def main() -> None:
    """Print a row for each car and case."""
    ask = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ask.add_argument("--drives", type=int, default=100)
    ask.add_argument("--vehicle", nargs="+", default=["paper", "midsize-sedan"])
    ask.add_argument("--json", action="store_true")
    given = ask.parse_args()
    drives, found = [random_drive(DRIVES + number) for number in range(given.drives)], []
    for name in given.vehicle:
        car = at.load_vehicle(name)
        plant = at.DualTrack(car)
        for label, wrong, uncertainty in cases():
            row = {"vehicle": name, "case": label, **judge(plant, believing(car, wrong, uncertainty), drives)}
            found.append(row)
            if not given.json:
                print(
                    f"{name:14s} {label:38s} J {row['J']:.5f}  p99 {row['p99']:.4f}  {row['failed']} of {row['runs']} "
                    "failed", flush=True,
                )  # fmt: skip
    if given.json:
        print(json.dumps(found))


if __name__ == "__main__":
    main()

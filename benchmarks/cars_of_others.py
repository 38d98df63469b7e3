"""Random drives of cars that nobody here wrote: CommonRoad's vehicles 1 to 3, as single-track drift and as multi-body.

    python benchmarks/cars_of_others.py [--drives 100] [--vehicle 1 2 3] [--profile road production] [--json]

Needs the extra `plants`. Each car is driven by the default `MPC(car, profile=...)`, which knows its data sheet; nothing
is tuned for it. Drives: changing speed (4 to 27 m/s), friction, side wind with gusts, curves, lane changes.
J = mean e^2 + w mean (change of command)^2 with the profile's w, geometric mean; a failed run counts 25 m^2. Beside it
the paper's car (dual track) on the same drives. `ratio` is J over that of the paper's car.
"""

from __future__ import annotations

import argparse
import json
import time
from typing import Any

import numpy as np
from what_pays import FAILED

import adaptrack as at
from adaptrack.drive.batch import rollout_batch
from adaptrack.peers.commonroad_plants import CARS, MODELS, commonroad_plant, commonroad_vehicle
from adaptrack.scenario import random_drive

DRIVES = 23_000_000


def judge(plant: Any, car: at.Vehicle, profile: at.Profile, drives: list[Any]) -> dict[str, Any]:
    """J, its 99th percentile, the largest error and the failed runs, by reason."""
    begun = time.perf_counter()
    runs = rollout_batch(plant, at.MPC(car, profile=profile), drives, profile=profile, seeds=np.arange(len(drives)))
    failed = np.array([reason is not None for reason in runs.failed])
    cost = np.where(failed, FAILED, runs.cost(profile.move_weight))
    return {
        "J": float(np.exp(np.log(cost).mean())), "p99": float(np.percentile(cost, 99)),
        "largest_error": float(np.max(runs.max_abs_error)), "failed": int(failed.sum()), "runs": len(drives),
        "why": [f"drive {DRIVES + i}: {runs.failed[i]} at {runs.failed_at[i]:.1f} s" for i in np.flatnonzero(failed)],
        "seconds": time.perf_counter() - begun,
    }  # fmt: skip


def main() -> None:
    """Print a row for each profile, model and car."""
    ask = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ask.add_argument("--drives", type=int, default=100)
    ask.add_argument("--vehicle", nargs="+", type=int, default=list(CARS), choices=list(CARS))
    ask.add_argument("--profile", nargs="+", default=["road", "production"])
    ask.add_argument("--json", action="store_true")
    given = ask.parse_args()
    drives, found = [random_drive(DRIVES + number) for number in range(given.drives)], []
    paper = at.load_vehicle("paper")
    cars = [("paper, dual-track", at.DualTrack(paper), paper)]
    cars += [
        (f"{number} {CARS[number]}, {model}", commonroad_plant(model, number), commonroad_vehicle(number))
        for model in MODELS
        for number in given.vehicle
    ]
    for name in given.profile:
        profile = at.load_profile(name)
        for label, plant, car in cars:
            row = {"profile": name, "car": label, **judge(plant, car, profile, drives)}
            row["ratio"] = row["J"] / next(each["J"] for each in [*found, row] if each["profile"] == name)
            found.append(row)
            if not given.json:
                print(
                    f"{name:10s} {label:32s} J {row['J']:.6f}  ratio {row['ratio']:.2f}  p99 {row['p99']:.5f}  "
                    f"largest error {row['largest_error']:.2f} m  {row['failed']} of {row['runs']} failed  "
                    f"{row['seconds']:.0f} s", *row["why"], flush=True, sep="\n  " if row["why"] else "",
                )  # fmt: skip
    if given.json:
        print(json.dumps(found))


if __name__ == "__main__":
    main()

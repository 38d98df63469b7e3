"""What a car's own best constant tuning and filter win over the defaults of the controller that knows its car.

    python benchmarks/own_constant.py [--vehicle van] [--profile road] [--training 32] [--drives 100] [--json]

Every constant of a grid is driven on training drives with the default filter, then the best one with other drifts; the
winner and the defaults are judged on fresh drives. J as in what_pays.py, geometric mean.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
from what_pays import FAILED, costs

import adaptrack as at
from adaptrack.control.kalman import Drifts, KalmanFilter
from adaptrack.drive.batch import rollout_batch
from adaptrack.scenario import random_drive
from adaptrack.scenario.profile import load_profile

TRAINING, JUDGED = 7_000_000, 9_500_000
GRID = tuple(product((20, 30, 45), (5, 10, 15), (1.0,), (0.7, 1.0, 1.5, 2.0, 3.0, 4.5, 7.0, 10.0)))
FACTORS = (0.5, 0.7, 1.4, 2.0)


def best_constant(plant: Any, mpc: Any, drives: list[Any], profile: Any) -> tuple[at.Tuning, float]:
    """The constant with the least geometric mean of J over the drives, and that."""
    many = np.repeat(np.array(GRID), len(drives), axis=0)
    which = np.tile(np.arange(len(drives)), len(GRID))
    found = rollout_batch(plant, mpc, drives, many, which=which, profile=profile, seeds=which)
    lost = np.array([reason is not None for reason in found.failed])
    cost = np.where(lost, FAILED, found.mse + profile.move_weight * found.mean_squared_move)
    means = np.exp(np.log(cost).reshape(len(GRID), -1).mean(axis=1))
    Np, Nc, Q, R = GRID[int(means.argmin())]
    return at.Tuning(Np, Nc, Q, R), float(means.min())


def best_drifts(plant: Any, car: Any, tuning: at.Tuning, drives: list[Any], profile: Any) -> Drifts:
    """The drifts of the filter, one after the other, that are best with a constant."""

    def mean(drifts: Drifts) -> float:
        mpc = at.MPC(car, profile=profile, estimator=KalmanFilter.of_profile(profile, drifts))
        return float(np.log(costs(plant, mpc, tuning, drives, profile, 0)[0]).mean())

    best = Drifts()
    least = mean(best)
    for name in ("vy", "yaw_rate", "side", "turn", "wind", "sliding"):
        for factor in FACTORS:
            tried = replace(best, **{name: factor * getattr(Drifts(), name)})
            found = mean(tried)
            if found < least:
                best, least = tried, found
    return best


def main() -> None:
    """Print the defaults, the car's own constant, and its own constant and filter."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--vehicle", default="van")
    parser.add_argument("--profile", default="road")
    parser.add_argument("--training", type=int, default=32)
    parser.add_argument("--drives", type=int, default=100)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    car, profile = at.load_vehicle(options.vehicle), load_profile(options.profile)
    plant, default = at.DualTrack(car), at.MPC(car, profile=profile)
    training = [random_drive(TRAINING + number) for number in range(options.training)]
    drives = [random_drive(JUDGED + number) for number in range(options.drives)]
    tuning, _ = best_constant(plant, default, training, profile)
    drifts = best_drifts(plant, car, tuning, training, profile)
    own = at.MPC(car, profile=profile, estimator=KalmanFilter.of_profile(profile, drifts))
    rows = []
    for name, mpc, each in (
        ("defaults", default, default.tuning), ("own constant", default, tuning), ("and own filter", own, tuning),
    ):  # fmt: skip
        cost, lost = costs(plant, mpc, each, drives, profile, 60_000)
        rows.append({
            "controller": name, "Np": each.Np, "Nc": each.Nc, "R": each.R, "J": float(np.exp(np.log(cost).mean())),
            "failed": int(lost.sum()), "drives": len(drives),
        })  # fmt: skip
    rows[-1]["drifts"] = {name: value for name, value in vars(drifts).items() if value != getattr(Drifts(), name)}
    if options.json:
        print(json.dumps({"rows": rows}))
        return
    for row in rows:
        print(", ".join(f"{key} {value:.3g}" if key == "J" else f"{key} {value}" for key, value in row.items()))


if __name__ == "__main__":
    main()

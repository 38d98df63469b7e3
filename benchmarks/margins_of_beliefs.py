"""What the certificate foretells: constants of the informed controller that believes a wrong car, and random drives.

    python benchmarks/margins_of_beliefs.py [--drives 100] [--search] [--vehicle paper] [--json]

The car is the true one; lag, dead time, stiffness or mass are told wrong. For each constant: the least modulus margin
of its loop, driving straight at 4 to 30 m/s; J = mean e^2 + w mean (change of command)^2 with the weight of the profile
`road`, geometric mean, where a failed run counts 25 m^2; and how many drives failed. With --search instead: of 120
constants those that bear every usual mismatch of the true car with a margin of 0.02, the best on 32 drives first.
"""

from __future__ import annotations

import argparse
import json
from itertools import product
from typing import Any

import numpy as np

import adaptrack as at
from adaptrack.analysis.linearisation import laws, linear_plants, sampled, usual_mismatches
from adaptrack.analysis.stability import modulus_margin
from adaptrack.control.controllers import informed_tuning
from adaptrack.scenario.profile import load_profile
from adaptrack.tuning.runs import random_drive_runs

FIRST, NOISE = 9_200_000, 5
"""Number of the first drive, and noise seed; nothing was tuned on them."""
SPEEDS = (4.0, 8.0, 12.0, 16.0, 20.0, 25.0, 30.0)
CAUTIOUS = at.Tuning(30, 5, 1.0, 10.0)
"""What --search finds for the paper's car."""
LEAST = 0.02
"""Modulus margin that --search asks for with every mismatch."""


def beliefs(car: Any, profile: Any) -> dict[str, Any]:
    """Controllers, each of which was told one thing wrong, by what it was told."""
    period = profile.period

    def told(stiffness: float = 1.0, mass: float = 1.0, lag: float = 0.0, dead_time: float = 0.0) -> Any:
        own = car.replace(
            mass=mass * car.mass, yaw_inertia=mass * car.yaw_inertia,
            stiffness_front=stiffness * car.stiffness_front, stiffness_rear=stiffness * car.stiffness_rear,
        )  # fmt: skip
        steering = profile.steering.replace(lag=profile.steering.lag + lag, dead_time=max(dead_time, 0.0))
        world = profile.replace(steering=steering, delay=0 if dead_time < 0.0 else profile.delay)
        return at.MPC(own, profile=world)

    return {
        "as it is": told(), "lag -0.1 s": told(lag=-0.1), "lag +0.1 s": told(lag=0.1),
        "dead time -1 period": told(dead_time=-period), "dead time +1 period": told(dead_time=period),
        "stiffness x 1.6": told(stiffness=1.6), "stiffness / 1.6": told(stiffness=1.0 / 1.6),
        "mass x 1.3": told(mass=1.3), "mass x 0.7": told(mass=0.7),
    }  # fmt: skip


def row(name: str, mpc: Any, plant: Any, tuning: at.Tuning, drives: int) -> dict[str, Any]:
    """One belief and one constant."""
    runs = random_drive_runs(plant, mpc, range(FIRST, FIRST + drives), profile="road")
    costs = runs.drive(tuning, [NOISE])[:, 0]
    counted = np.where(np.isfinite(costs), costs, runs.failed_cost)
    margin = [
        modulus_margin(sampled(plant, mpc.period, v, profile="road"), laws(mpc, v, tuning.as_array()))[0]
        for v in SPEEDS
    ]
    return {
        "believed": name, "Nc": tuning.Nc, "R": tuning.R, "modulus_margin": round(float(min(margin)), 3),
        "J": float(np.exp(np.log(counted).mean())), "failed": int(np.isinf(costs).sum()), "drives": drives,
    }  # fmt: skip


def search(car: Any, plant: Any) -> list[dict[str, Any]]:
    """Constants that bear every mismatch, the best on drives first; the last row says how many there were."""
    mpc = at.MPC(car, profile="road")
    grid = product((20, 30, 45, 60), (1, 2, 3, 5, 10), (1.0,), (3.0, 10.0, 30.0, 100.0, 300.0, 1000.0))
    tried = np.array(list(grid), dtype=float)
    least = np.full(len(tried), np.inf)
    for v in SPEEDS:
        law = laws(mpc, v, tried)
        for linear in linear_plants(plant, mpc.period, "road", None, usual_mismatches(mpc.period)):
            least = np.minimum(least, modulus_margin(linear(v, 0.9), law))
    runs = random_drive_runs(plant, mpc, range(FIRST - 100, FIRST - 68), profile="road")
    rows = [
        {"Np": int(Np), "Nc": int(Nc), "R": R, "modulus_margin": round(float(margin), 3),
         "J": float(np.exp(np.log(runs.costs(np.array([Np, Nc, Q, R]), [NOISE])).mean()))}
        for (Np, Nc, Q, R), margin in zip(tried.tolist(), least, strict=True) if margin >= LEAST
    ]  # fmt: skip
    counts = {"tried": len(tried), "stable": int((least > 0.0).sum()), "with_margin": len(rows)}
    return [*sorted(rows, key=lambda each: each["J"]), counts]


def main() -> None:
    """Print a row for each belief and constant, or what --search finds."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--drives", type=int, default=100)
    parser.add_argument("--vehicle", default="paper")
    parser.add_argument("--search", action="store_true")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    car = at.load_vehicle(options.vehicle)
    plant = at.DualTrack(car)
    rows = (
        search(car, plant)
        if options.search
        else [
            row(name, mpc, plant, tuning, options.drives)
            for name, mpc in beliefs(car, load_profile("road")).items()
            for tuning in (informed_tuning("road"), CAUTIOUS)
        ]
    )
    if options.json:
        print(json.dumps({"rows": rows}))
        return
    for each in rows:
        print(", ".join(f"{key} {value:.3g}" if key == "J" else f"{key} {value}" for key, value in each.items()))


if __name__ == "__main__":
    main()

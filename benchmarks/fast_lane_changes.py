"""What a schedule of its tuning could earn for the informed controller in fast lane changes in a gust.

Drives the paper's car above 24 m/s with its default constant, with the schedules that are named, with the one tuning of
a grid that is best for such runs, and with the best tuning of the grid for each run. Both are chosen on other noise
than they are judged by, the one tuning on other runs as well.
"""

from __future__ import annotations

import argparse
import itertools

import numpy as np

from adaptrack.cars.plant import DualTrack
from adaptrack.cars.vehicle import load_vehicle
from adaptrack.comparison.statistics import geometric_mean, ratio
from adaptrack.control.controllers import MPC
from adaptrack.control.scheduling import load_scheduler
from adaptrack.tuning.operating_points import sobol
from adaptrack.tuning.runs import operating_point_runs

GRID = list(itertools.product((20.0, 30.0, 45.0), (5.0, 10.0, 15.0), (1.0,), (1.0, 3.0, 6.0, 12.0, 25.0)))
"""Np, Nc, Q, R"""


def main() -> None:
    """Print a row for each contender: J over that of the default constant, with its 95 % interval, and failures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--profile", default="road")
    parser.add_argument("--runs", type=int, default=200)
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--slowest", type=float, default=24.0, help="m/s")
    parser.add_argument("--schedulers", nargs="*", default=[], help="names or files")
    options = parser.parse_args()
    car = load_vehicle("paper")
    mpc = MPC(car, profile=options.profile)
    box = {"speed": (options.slowest, 30.0), "y_ref": (-7.0, 7.0), "friction": (0.3, 1.0), "wind": (-30.0, 30.0)}

    def runs(seed: int):
        return operating_point_runs(DualTrack(car), mpc, sobol(options.runs, box, seed=seed), options.profile)

    judged, others = runs(20_000 + options.seed), runs(30_000 + options.seed)
    fresh, used = (900_001, 900_002, 900_003, 900_004), (810_001, 810_002)
    constant = GRID[int(np.argmin([np.log(others.costs(row, used)).mean() for row in GRID]))]
    by_run = np.stack([judged.costs(row, used) for row in GRID], axis=1)
    contenders = {
        "default constant": mpc.tuning,
        "best constant of such runs": constant,
        **{each.name: each for each in map(load_scheduler, options.schedulers)},
        "best of the grid for each run": np.array(GRID)[by_run.argmin(axis=1)],
    }
    costs = {name: judged.costs(policy, fresh) for name, policy in contenders.items()}
    print(
        f"{options.profile}, {options.runs} lane changes above {options.slowest:g} m/s;",
        f"constant of such runs {constant}",
    )
    for name, cost in costs.items():
        over = ratio(cost, costs["default constant"])
        failed = int((cost >= judged.failed_cost / len(fresh)).sum())
        print(f"{name:32} J {geometric_mean(cost):.5f}  {over.mean:.3f} [{over.low:.3f}, {over.high:.3f}]  {failed}")


if __name__ == "__main__":
    main()

"""Random drives of every shipped car, each in its own domain, by the controller with nothing but its defaults.

    python benchmarks/shipped_cars.py [--drives 100] [--profile road production] [--vehicle van] [--sheet] [--json]

J = mean e^2 + w mean (change of command)^2 in m^2, geometric mean over the drives that did not fail, with its 95 %
interval. --sheet: the controller knows mass and wheelbase of the car alone, the rest is estimated.
"""

from __future__ import annotations

import argparse
import json
from typing import Any

import numpy as np

import adaptrack as at
from adaptrack.base.statistics import geometric_mean
from adaptrack.cars.data_sheet import MASSES
from adaptrack.scenario.profile import load_profile
from adaptrack.tuning.runs import random_drive_runs

FIRST = 51_000_000
"""Number of the first drive: nothing was tuned on these."""


def measure(name: str, profile: str, count: int, sheet: bool) -> dict[str, Any]:
    """A row: failures and J of one car in one profile."""
    car = at.load_vehicle(name)
    known = at.vehicle_from_data_sheet(name, car.mass, car.wheelbase) if sheet else car
    mpc = at.MPC(known, profile=profile)
    runs = random_drive_runs(at.DualTrack(car), mpc, range(FIRST, FIRST + count), profile=profile)
    costs = runs.drive(mpc, [60_000])[:, 0]
    driven = costs[np.isfinite(costs)]
    rng = np.random.default_rng(0)
    means = np.exp([np.log(rng.choice(driven, driven.size)).mean() for _ in range(1000)]) if driven.size else [np.nan]
    low, high = np.quantile(means, (0.025, 0.975))
    return {
        "car": name, "profile": profile, "drives": count, "failed": count - driven.size,
        "J": float(geometric_mean(driven)) if driven.size else float("nan"), "low": float(low), "high": float(high),
        "worst": float(driven.max()) if driven.size else float("nan"),
        "R": mpc.tuning.R, "move_weight": load_profile(profile).move_weight,
    }  # fmt: skip


def main() -> None:
    """Print a row for each car and profile."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--drives", type=int, default=100)
    parser.add_argument("--profile", nargs="+", default=["road", "production"])
    parser.add_argument("--vehicle", nargs="+", default=at.list_vehicles())
    parser.add_argument("--sheet", action="store_true", help="know mass and wheelbase alone")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    cars = [name for name in options.vehicle if not options.sheet or at.load_vehicle(name).mass >= MASSES[0]]
    rows = [measure(name, profile, options.drives, options.sheet) for profile in options.profile for name in cars]
    if options.json:
        print(json.dumps({"rows": rows}))
        return
    print(f"{'car':14} {'profile':11} {'failed':>9}  {'J, 95 % interval (m^2)':30} {'worst':>8} {'R':>6}")
    for row in rows:
        interval = f"{row['J']:.5f} [{row['low']:.5f}, {row['high']:.5f}]"
        failed = f"{row['failed']} of {row['drives']}"
        print(f"{row['car']:14} {row['profile']:11} {failed:>9}  {interval:30} {row['worst']:8.5f} {row['R']:6.3g}")


if __name__ == "__main__":
    main()

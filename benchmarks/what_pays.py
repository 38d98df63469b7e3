"""What each part of the controller that knows its car is worth: one constant per row, the best of a few weights.

    python benchmarks/what_pays.py [--drives 200] [--changes 200] [--profile road] [--vehicle paper] [--json]

J = mean e^2 + w mean (change of command)^2 with the profile's w; a failed run counts 25 m^2. Every row is given the
R that is best for it on training drives, and judged on others.
"""

from __future__ import annotations

import argparse
import json
from typing import Any

import numpy as np

import adaptrack as at
from adaptrack.control.kalman import Drifts, KalmanFilter, SensorNoise
from adaptrack.control.models import PathModel
from adaptrack.drive.batch import rollout_batch
from adaptrack.scenario import load_scenario, random_drive
from adaptrack.scenario.profile import load_profile

FAILED = 25.0
TRAINING, JUDGED = 7_000_000, 8_000_000
STILL = {"drifts": Drifts(side=0.0, turn=0.0, wind=0.0), "spread": (0.0, 0.0)}


def lane_changes(count: int, seed: int) -> list[Any]:
    """Lane changes in a gust, over the paper's speeds and more slippery roads."""
    rng = np.random.default_rng(seed)
    return [
        load_scenario(
            "lane-change", amplitude=float(rng.uniform(-7, 7)), speed=float(rng.uniform(4, 27)),
            friction=float(rng.uniform(0.3, 1.0)), gust=float(rng.uniform(-30, 30)),
        )
        for _ in range(count)
    ]  # fmt: skip


def costs(plant: Any, mpc: Any, tuning: at.Tuning, runs: list[Any], profile: Any, seed: int) -> Any:
    """J of each run (runs,), and which failed."""
    count = len(runs)
    found = rollout_batch(
        plant, mpc, runs, np.tile(tuning.as_array(), (count, 1)), which=np.arange(count), profile=profile,
        seeds=seed + np.arange(count),
    )  # fmt: skip
    failed = np.array([reason is not None for reason in found.failed])
    return np.where(failed, FAILED, found.mse + profile.move_weight * found.mean_squared_move), failed


def rows(car: Any, profile: Any) -> dict[str, tuple[Any, list[at.Tuning], Any]]:
    """Name -> (controller, tunings to choose from, profile that it drives in)."""
    period, lag, late = profile.period, profile.steering.lag, profile.delay * profile.period
    knowing = [at.Tuning(30, 10, 1.0, r) for r in (1.0, 2.0, 3.0, 7.0, 16.0, 64.0, 256.0, 1000.0)]
    blind = [at.Tuning(50, 8, 1.0, r) for r in (300.0, 1000.0, 3000.0, 1e4, 3e4, 5e4, 1e5)]

    def filtered(lag: float, late: float, **options: Any) -> Any:
        return at.MPC(
            car, period=period, preview=profile.preview, model=PathModel(car, period, lag, late),
            estimator=KalmanFilter(SensorNoise(*profile.noise), **options),
        )  # fmt: skip

    quiet = profile.replace(noise_vy=0.0, noise_yaw=0.0, noise_yaw_rate=0.0, noise_y=0.0)
    exact = at.MPC(
        car, period=period, preview=profile.preview, model=PathModel(car, period, lag, late),
        estimator=KalmanFilter.of_profile(quiet, Drifts(side=3.0, turn=6.0)),
    )  # fmt: skip
    return {
        "published (increments)": (at.published_mpc(car, period=period, preview=profile.preview), blind, profile),
        "filter": (filtered(0.0, 0.0, **STILL), [*knowing, *blind], profile),
        "+ lag": (filtered(lag, 0.0, **STILL), knowing, profile),
        "+ dead time": (filtered(lag, late, **STILL), knowing, profile),
        "+ disturbances": (filtered(lag, late), knowing, profile),
        "its default constant": (at.MPC(car, profile=profile), [at.MPC(car, profile=profile).tuning], profile),
        "exact sensors": (exact, [at.Tuning(30, 10, 1.0, r) for r in (0.1, 0.3, 1.0)], quiet),
    }


def main() -> None:
    """Choose a weight for each row, judge it, print the table."""
    ask = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ask.add_argument("--drives", type=int, default=200)
    ask.add_argument("--changes", type=int, default=200)
    ask.add_argument("--profile", default="road")
    ask.add_argument("--vehicle", default="paper")
    ask.add_argument("--json", action="store_true")
    given = ask.parse_args()
    car, profile = at.load_vehicle(given.vehicle), load_profile(given.profile)
    plant = at.DualTrack(car, "magic-formula") if given.vehicle == "paper" else at.DualTrack(car)
    training = [random_drive(TRAINING + number) for number in range(64)]
    drives = [random_drive(JUDGED + number) for number in range(given.drives)]
    changes = lane_changes(given.changes, 3)
    found = []
    for name, (mpc, tunings, world) in rows(car, profile).items():
        trained = [np.log(costs(plant, mpc, each, training, world, 0)[0]).mean() for each in tunings]
        best = tunings[int(np.argmin(trained))]
        row: dict[str, Any] = {"row": name, "R": best.R}
        for kind, runs in (("drives", drives), ("lane_changes", changes)):
            cost, failed = costs(plant, mpc, best, runs, world, 50_000)
            logs = np.log(cost)
            half = 1.96 * logs.std(ddof=1) / np.sqrt(len(logs))
            row[kind] = {
                "J": float(np.exp(logs.mean())), "low": float(np.exp(logs.mean() - half)),
                "high": float(np.exp(logs.mean() + half)), "p99": float(np.percentile(cost, 99)),
                "failed": int(failed.sum()), "runs": len(runs),
            }  # fmt: skip
        found.append(row)
        if not given.json:
            text = "  ".join(
                f"{kind.replace('_', ' ')} J {row[kind]['J']:.5f} [{row[kind]['low']:.5f}, {row[kind]['high']:.5f}] "
                f"p99 {row[kind]['p99']:.4f}, {row[kind]['failed']} of {row[kind]['runs']} failed"
                for kind in ("drives", "lane_changes")
            )
            print(f"{name:24s} R {best.R:8g}  {text}", flush=True)
    if given.json:
        print(json.dumps(found))


if __name__ == "__main__":
    main()

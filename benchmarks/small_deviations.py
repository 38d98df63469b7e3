"""Does the linear loop tell the truth? Its verdict against simulated small deviations, for random tunings and cars.

    python benchmarks/small_deviations.py [--samples 2000] [--cars 8] [--vehicle paper] [--seed 1] [--json]

Each sample is a tuning at a speed and friction: the car drives straight, without noise, from 1 micrometre off its
reference, in the nonlinear closed loop with its compiled controller. It is stable when the deviation of its last
quarter is smaller than that of the quarter before. The first car is the one that the controller believes in; the
others differ from it in lag, dead time, stiffness and mass. False stable: the linear loop is stable, and the deviation
grows.
"""

from __future__ import annotations

import argparse
import json
from typing import Any

import numpy as np

import adaptrack as at
from adaptrack.analysis.linearisation import Mismatch, laws, linear_estimator, sampled
from adaptrack.analysis.stability import loops, radii
from adaptrack.scenario import Scenario, Wind
from adaptrack.scenario.profile import load_profile
from adaptrack.tuning.runs import RunSet

OFFSET, QUARTER = 1e-6, 1200
"""m; control periods in a quarter of a run: long, for the slowest oscillations take a minute."""
RATIOS = {"published": (0.0, 6.0), "informed": (-4.0, 4.0)}
"""log10 of R/Q of the tunings: from mostly unstable to sound."""
QUIET = {name: 0.0 for name in ("noise_vy", "noise_yaw", "noise_yaw_rate", "noise_y")}


def controllers(car: Any, profile: Any) -> dict[str, Any]:
    """By name."""
    return {"published": at.published_mpc(car, period=profile.period), "informed": at.MPC(car, profile=profile)}


def mismatch(rng: np.random.Generator, number: int, period: float) -> Mismatch:
    """How a car differs from the belief: the first not at all."""
    if number == 0:
        return Mismatch()
    return Mismatch(
        lag=float(rng.uniform(-0.1, 0.1)), dead_time=-period * float(rng.integers(0, 2)),
        stiffness=1.6 ** float(rng.uniform(-1.0, 1.0)), mass=float(rng.uniform(0.7, 1.3)),
    )  # fmt: skip


def tunings(rng: np.random.Generator, count: int, ratio: tuple[float, float]) -> Any:
    """Random tunings (count, 4)."""
    Np = rng.integers(3, 61, count)
    return np.column_stack([
        Np, np.minimum(rng.integers(1, 21, count), Np), np.ones(count), 10.0 ** rng.uniform(*ratio, count)
    ]).astype(float)  # fmt: skip


def certified(car: Any, mpc: Any, profile: Any, asked: Any, places: Any) -> Any:
    """Spectral radius of each sample's linear loop."""
    found = []
    for (speed, friction), tuning in zip(places.tolist(), asked, strict=True):
        body = sampled(car, mpc.period, speed, friction=friction, profile=profile)
        found.append(float(radii(loops(body, laws(mpc, speed, tuning, linear_estimator(mpc, speed))))[0]))
    return np.array(found)


def simulated(car: Any, mpc: Any, profile: Any, asked: Any, places: Any) -> tuple[Any, Any]:
    """Whether the deviation of each sample grows, and its rate per period (NaN where it is not small any more)."""
    runs = [
        Scenario(
            name="small", duration=4 * QUARTER * mpc.period, reference=0.0, speed=speed, friction=friction,
            wind=Wind(y=0.0), start_y=OFFSET,
        )
        for speed, friction in places.tolist()
    ]  # fmt: skip
    squares = RunSet(car, mpc, runs, profile, segment=QUARTER).segments(asked, 0, np.arange(len(runs)))[:, :4]
    sizes = np.sqrt(np.where(np.isfinite(squares), squares, np.inf) / QUARTER)
    large, gone = sizes[:, 3] > 100.0 * OFFSET, sizes[:, 3] < 1e-9 * OFFSET
    with np.errstate(invalid="ignore", divide="ignore"):
        rate = np.where(large | gone, np.nan, (sizes[:, 3] / sizes[:, 2]) ** (1.0 / QUARTER))
    return large | (~gone & ~(rate < 1.0)), rate


def check(name: str, vehicle: str, samples: int, cars: int, seed: int) -> dict[str, Any]:
    """The counts for one controller in the profile `road`."""
    rng, car, told = np.random.default_rng(seed), at.load_vehicle(vehicle), load_profile("road")
    mpc, radius, grows, rate = controllers(car, told)[name], [], [], []
    for number in range(cars):
        count = samples // cars
        by = mismatch(rng, number, told.period)
        world = told.replace(**QUIET, delay=told.delay + round(by.dead_time / told.period))
        true_car = by.true_car(at.DualTrack(car), world)
        asked = tunings(rng, count, RATIOS[name])
        places = np.column_stack([rng.uniform(3.0, 30.0, count), rng.uniform(0.3, 1.0, count)])
        radius.append(certified(true_car, mpc, world, asked, places))
        for kept, found in zip((grows, rate), simulated(true_car, mpc, world, asked, places), strict=True):
            kept.append(found)
    r, grew, seen = np.concatenate(radius), np.concatenate(grows), np.concatenate(rate)
    wrong = (r < 1.0) == grew
    slow = np.isfinite(seen)
    return {
        "controller": name,
        "samples": len(r),
        "stable": int((r < 1.0).sum()),
        "false_stable": int((wrong & grew).sum()),
        "false_unstable": int((wrong & ~grew).sum()),
        "radii_of_wrong": np.round(np.sort(r[wrong]), 5).tolist(),
        "rates_compared": int(slow.sum()),
        "rate_off_by_p99": float(np.quantile(np.abs(seen - r)[slow], 0.99)) if slow.any() else None,
    }


def main() -> None:
    """Print a row for each controller."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--samples", type=int, default=2000)
    parser.add_argument("--cars", type=int, default=8)
    parser.add_argument("--vehicle", default="paper")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", action="store_true")
    asked = parser.parse_args()
    rows = [check(name, asked.vehicle, asked.samples, asked.cars, asked.seed) for name in RATIOS]
    if asked.json:
        print(json.dumps({"rows": rows}))
        return
    for row in rows:
        print(", ".join(f"{key} {value}" for key, value in row.items()))


if __name__ == "__main__":
    main()

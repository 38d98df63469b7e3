"""Control steps per second of the environments of 64 cars beside `rollout_batch`, in turns.

    python benchmarks/gym_speed.py [--cars 64] [--rounds 5] [--threads 1] [--json]

The paper's car on a generated road in the profile `road`. The rows `rollout_batch` drive whole runs without Python
between the steps; those of the environments come back to Python at every step (tuning: every 10 control periods). Only
`step` is timed, not the policy. Medians over the rounds; a ratio is that of the same round.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from typing import Any

import numpy as np

import adaptrack as at
from adaptrack.gym import MPCTuningVectorEnv, PathTrackingEnv, PathTrackingVectorEnv, Task

ROAD, LENGTH = "country:1", 1000.0
GAINS = np.array([-0.03, -0.4, 0, 0, 0, 0, 0, *[0] * 5, 0, 0, 2.9, 0, 0])
"""Of a law that stays on the road."""


def whole_runs(controller: str, cars: int, threads: int) -> Callable[[], float]:
    """Control steps per second of `rollout_batch`."""
    profile, car = at.load_profile("road"), at.load_vehicle("paper")
    drive = Task(road=ROAD, length=LENGTH).drive(0, car)
    plant = at.get_plant("dual-track", car)
    made = at.get_controller(controller, car, profile=profile, period=profile.period, preview=True)

    def rate() -> float:
        begun = time.perf_counter()
        done = at.rollout_batch(
            plant, made, drive, which=np.zeros(cars, int), profile=profile, seeds=np.arange(cars), threads=threads
        )
        return float(done.steps.sum() / (time.perf_counter() - begun))

    return rate


def stepped(envs: Any, policy: Callable[[Any], Any], steps: int, periods: int) -> Callable[[], float]:
    """The same of an environment; periods: of a step."""
    cars = getattr(envs, "num_envs", 1)

    def rate() -> float:
        seen, spent, over = envs.reset(seed=1)[0], 0.0, False
        for _ in range(steps):
            if cars == 1 and over:
                seen, _ = envs.reset()
            action = policy(seen)
            begun = time.perf_counter()
            seen, _, terminated, truncated, _ = envs.step(action)
            spent += time.perf_counter() - begun
            over = bool(np.any(terminated | truncated))
        return cars * steps * periods / spent

    return rate


def measure(cars: int, rounds: int, threads: int) -> dict[str, Any]:
    """Medians over the rounds, and of the ratios within them."""
    task: dict[str, Any] = {"road": ROAD, "length": LENGTH}
    tuning = MPCTuningVectorEnv(cars, threads=threads, **task)
    own = tuning.tunings
    middle = 0.5 * (own.low[2] + own.high[2])
    actions = np.tile(own.action(30, 10, middle), (cars, 1))  # the informed controller's own
    rates = {
        "rollout_batch, informed MPC": whole_runs("informed", cars, threads),
        "rollout_batch, pure pursuit": whole_runs("pure-pursuit", cars, threads),
        "PathTracking, vector": stepped(
            PathTrackingVectorEnv(cars, threads=threads, **task), lambda seen: (seen @ GAINS)[:, None], 600, 1
        ),
        "MPCTuning, vector": stepped(tuning, lambda seen: actions, 60, 10),
        "PathTracking, vector, random cars": stepped(
            PathTrackingVectorEnv(cars, threads=threads, random_cars=True, **task),
            lambda seen: (seen @ GAINS)[:, None], 300, 1,
        ),
        "PathTracking, one car": stepped(PathTrackingEnv(**task), lambda seen: [seen @ GAINS], 600, 1),
    }  # fmt: skip
    for each in rates.values():
        each()  # warm
    found = [{name: each() for name, each in rates.items()} for _ in range(rounds)]
    base = "rollout_batch, informed MPC"
    ratios = {name: float(np.median([row[name] / row[base] for row in found])) for name in rates}
    return {
        "cars": cars, "threads": threads, "rounds": rounds,
        "control_steps_per_s": {name: float(np.median([row[name] for row in found])) for name in rates},
        "ratio_to_informed_rollout": ratios,
    }  # fmt: skip


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cars", type=int, default=64)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    made = measure(options.cars, options.rounds, options.threads)
    if options.json:
        print(json.dumps(made, indent=2))
    else:
        for name, value in made["control_steps_per_s"].items():
            print(f"{name:36} {value:12,.0f} control steps/s   {made['ratio_to_informed_rollout'][name]:6.2f}")

"""What late, missing, jittered and re-ordered samples cost a tracker: on a bicycle that is not ours, 15 m/s, 20 Hz.

    .venv/bin/python benchmarks/foreign_loop.py --seeds 3

RMS of the distance (m) from a country road over all noise seeds, and its ratio to that of exact samples: with the
filter of profile `road`, that takes nothing late; the same that takes samples up to 0.25 s old; that of `production`.
"""

from __future__ import annotations

import argparse
import logging
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

import adaptrack as at

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))
from foreign_loop import drive, on_road, window

CAR = at.load_vehicle("paper")
ROAD = at.generate_road("country", seed=1, length=1500.0)
STEERING = at.Steering(lag=0.15, dead_time=0.0, rate=0.5)
CHANNELS = {
    "exact, 20 Hz": {},
    "intervals of 20 to 90 ms": {"jitter": (0.02, 0.09)},
    "every seventh missing": {"missing": 7},
    "yaw wrapped": {"wrapped": True},
    "0.1 s late": {"late": 0.1},
    "0.05 to 0.15 s late, re-ordered": {"late": 0.1, "reorder": 0.05},
    "every fifth repeated": {"repeat": 5},
    "100 Hz": {"period": 0.01},
    "path planned anew every 0.1 s": {"before_call": None},
}
TOGETHER = ("jitter", "missing", "wrapped", "late", "reorder", "repeat")
CHANNELS["all that is wrong together"] = {
    name: value for each in CHANNELS.values() for name, value in each.items() if name in TOGETHER
}
FILTERS = {"road, none late": ("road", 0.0), "road, 0.25 s": ("road", 0.25), "production, 0.35 s": ("production", 0.35)}


def tracker(profile: str, oldest: float, path: at.Road) -> at.Tracker:
    """With the filter of a profile that takes samples up to an age (s)."""
    sensors = replace(at.KalmanFilter.from_profile(at.load_profile(profile)), oldest=oldest)
    return at.Tracker(at.MPC(CAR, profile=profile, estimator=sensors, belief=STEERING), path)


def plan(t: float, car, tracker: at.Tracker) -> None:
    """A planner's path at every second call."""
    if round(t / 0.05) % 2 == 0:
        tracker.follow(window(ROAD, float(ROAD.project(car.x, car.y, near=15.0 * t + 10.0).s)))


def rms(kind: tuple[str, float], channel: dict, seeds: int) -> float:
    """Over all seeds."""
    planned = "before_call" in channel
    path = window(ROAD, 10.0) if planned else ROAD
    more = channel | ({"before_call": plan} if planned else {})
    found = [
        drive(tracker(*kind, path), ROAD, 40.0, car=on_road(ROAD, s=10.0), seed=1 + seed, **more).rms
        for seed in range(seeds)
    ]
    return float(np.sqrt(np.mean(np.square(found))))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=3)
    seeds = parser.parse_args().seeds
    logging.getLogger("adaptrack").setLevel(logging.ERROR)
    print("| samples |", " | ".join(FILTERS), "|")
    exact: dict[str, float] = {}
    for name, channel in CHANNELS.items():
        row = {kind: rms(values, channel, seeds) for kind, values in FILTERS.items()}
        exact = exact or row
        print(f"| {name} |", " | ".join(f"{v:.4f} ({v / exact[k]:.2f})" for k, v in row.items()), "|", flush=True)


if __name__ == "__main__":
    main()

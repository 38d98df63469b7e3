"""What the two nodes of the ROS 2 example take from a decoded message to a decoded answer; see their README.

    python benchmarks/ros2.py [--rounds 2000]

The logic without ROS: an odometry and the tick behind it, and a path of 60 and of 500 points, 1 m apart, that moves on
with the car. Microseconds. It needs gcc and g++, and kernels built with --export.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
import ros_cpp
from ros_messages import odometry, package_module, path

COUNTS = (60, 500)


def main() -> None:
    """Measure all, print JSON."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--rounds", type=int, default=2000)
    rounds = parser.parse_args().rounds
    found: dict[str, dict[str, Any]] = {"python": {}, "c++": {}}
    with tempfile.TemporaryDirectory() as folder:
        library = ros_cpp.shim(Path(folder), "-std=c++17", "-O2")
        for count in COUNTS:
            points = np.stack([np.arange(float(count)), np.zeros(count)], axis=-1)
            ticks, paths = ros_cpp.CppFollower(library).times(points, rounds)
            found["c++"] |= {f"odometry and tick, path of {count}": _said(ticks), f"path of {count}": _said(paths)}
            ticks, paths = _python(points, rounds)
            found["python"] |= {f"odometry and tick, path of {count}": _said(ticks), f"path of {count}": _said(paths)}
    print(json.dumps(found, indent=1))


def _python(points: NDArray[np.float64], rounds: int) -> tuple[list[float], list[float]]:
    made, ticks, paths = package_module("follower").Follower(), [], []
    for k in range(rounds):
        t = 0.05 * k
        way, here = (
            path(points + np.array([0.25 * k, 0.0])),
            odometry(t, 10.0 + 5.0 * t, 0.02 * (k * 7 % 5 - 2), speed=5.0),
        )
        began = time.perf_counter()
        made.path(way)
        there = time.perf_counter()
        made.odometry(here)
        made.tick(t)
        ticks.append(time.perf_counter() - there)
        paths.append(there - began)
    return ticks, paths


def _said(seconds: Any) -> dict[str, float]:
    """Median, 99th percentile and least, in microseconds, behind the first ones."""
    micro = 1e6 * np.asarray(seconds)[20:]
    return {
        "p50": round(float(np.median(micro)), 1), "p99": round(float(np.percentile(micro, 99)), 1),
        "least": round(float(micro.min()), 1),
    }  # fmt: skip


if __name__ == "__main__":
    main()

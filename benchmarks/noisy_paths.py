"""What noise of a planner's points costs a car that drives along them: mean speed, distance from the road, swerving.

    .venv/bin/python benchmarks/noisy_paths.py [--seeds 2] [--exact]

A bicycle that is not ours drives behind drive and brakes with a lag of 0.15 s, at the speeds that its planner has from
the true road. The planner publishes points 1 m apart with white noise, once for the whole road, or anew every second
from 10 m behind the car to 150 m ahead. Table: mean speed over that of points without noise; RMS of the distance (m)
from the true road, points without noise first; largest lateral acceleration (m/s^2) beyond that of points without
noise. --exact: paths go through the points, as without smoothing.

Roads: generated ones at up to 20 m/s and 4 m/s^2. Bends: hairpins of 5, 7 and 10 m at 4 m/s^2 whose curvature rises
over as many metres, chicanes of 3.5 m in 63 and 75 m at 30 m/s, lane changes of 3.5 m in 3 and 5 s at 10 to 30 m/s.
"""

from __future__ import annotations

import argparse
import logging
import math
import sys
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import adaptrack as at
from adaptrack.road import Comfort, SpeedPlan
from adaptrack.road.road_ahead import foot_near

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))
from core.test_path_noise import hairpin, swerve
from foreign_loop import DT, NOISE, on_road

CAR = at.load_vehicle("paper")
STEERING = at.Steering(lag=0.15, dead_time=0.05, rate=0.5)
NOISES = (0.0, 0.02, 0.05, 0.1)
START, BEHIND, AHEAD, RUN = 20.0, 10.0, 150.0, 200.0
LAG = 0.15


class Drive(NamedTuple):
    """A drive along a path: speed (m/s), RMS distance from the true road (m), lateral acceleration (m/s^2)."""

    speed: float
    distance: float
    lateral: float


def bends() -> dict[str, tuple[at.Road, float]]:
    """Roads with a sharp bend behind a straight, and the speed (m/s) there."""
    bends = {f"hairpin {radius:.0f} m": (hairpin(radius), 12.0) for radius in (5.0, 7.0, 10.0)}
    for length in (63.0, 75.0):
        bends[f"chicane {length:.0f} m"] = swerve((80.0, length, 1.0), (90.0 + length, length, -1.0)), 30.0
    for speed in (10.0, 15.0, 20.0, 30.0):
        for seconds in (3.0, 5.0):
            bends[f"lane {speed:.0f} m/s {seconds:.0f} s"] = swerve((80.0, seconds * speed, 1.0)), speed
    run = np.arange(1.0, RUN)[:, np.newaxis]
    return {
        name: (at.road_through(np.concatenate([points, points[-1] + run * (points[-1] - points[-2])])), speed)
        for name, (points, speed) in bends.items()
    }


def planned_path(road: at.Road, plan: SpeedPlan, begin: float, end: float, noise: Any, exact: bool) -> Any:
    """Path and plan that a planner publishes between two arc lengths (m); noise: standard deviation (m), generator."""
    s = np.arange(max(begin, 0.0), min(end, road.length - 0.01))
    points = np.stack(road.at(s)[:2], axis=-1)
    path = at.road_through(points + noise[0] * noise[1].standard_normal(points.shape), noise=0.0 if exact else None)
    place, speed = (s - s[0]) * (path.length / (s[-1] - s[0])), plan.at(s)
    time = np.concatenate([[0.0], np.cumsum(2.0 * np.diff(place) / (speed[1:] + speed[:-1]))])
    return path, SpeedPlan(place, speed, time, float(time[-1]), False, plan.comfort)


def drive(road: at.Road, plan: SpeedPlan, noise: float, anew: bool, exact: bool, seed: int) -> Drive:
    """Drive along the road to 100 m before its end; infinite distance where the car leaves it."""
    points, sensors = np.random.default_rng((seed, 1)), np.random.default_rng((seed, 2))
    begin, end = (START - BEHIND, START + AHEAD) if anew else (0.0, road.length)
    path, path_plan = planned_path(road, plan, begin, end, (noise, points), exact)
    tracker = at.Tracker(
        at.MPC(CAR, belief=STEERING, profile="road", computation=0.0), path, plan=path_plan, speed=at.SpeedControl(CAR)
    )
    car, near, force = on_road(road, s=START, speed=float(plan.at(START))), START, 0.0
    tracker.engage(wheel_angle=car.angle)
    offsets, lateral, k = [], [], 0
    while near < road.length - 100.0:
        if anew and k % 500 == 0 and k > 0:
            path, path_plan = planned_path(road, plan, near - BEHIND, near + AHEAD, (noise, points), exact)
            tracker.follow(path, plan=path_plan)
        if k % 25 == 0:
            sample = np.array([car.x, car.y, car.yaw, car.speed, car.yaw_rate]) + NOISE * sensors.standard_normal(5)
            out = tracker.step(k * DT, *map(float, sample))
        force += (out.longitudinal.force - force) * DT / LAG
        car.speed = max(car.speed + DT * (force - out.longitudinal.hold) / car.mass, 0.05)
        car.step(out.command, DT)
        k += 1
        if k % 10 == 0:
            foot = foot_near(road, car.x, car.y, near)
            near = float(foot.s)
            offsets.append(float(foot.offset))
            lateral.append(car.speed * car.yaw_rate)
            if not abs(offsets[-1]) < 3.0:
                return Drive(math.nan, math.inf, math.nan)
    means = np.convolve(lateral, np.full(5, 0.2), mode="valid")  # over 0.1 s
    return Drive(
        (near - START) / (k * DT), float(np.sqrt(np.mean(np.square(offsets)))), float(np.abs(means[25:]).max())
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--exact", action="store_true")
    options = parser.parse_args()
    logging.getLogger("adaptrack").setLevel(logging.ERROR)
    cases = {
        kind: (at.generate_road(kind, seed=1, length=900.0), 20.0) for kind in ("country", "mountain", "town", "lap")
    }
    print("| road | path |", " | ".join(f"{noise:g} m: speed, RMS, lateral" for noise in NOISES), "|")
    for name, (road, speed) in (cases | bends()).items():
        comfort = Comfort(lateral=4.0 if name in cases or "hairpin" in name else 10.0)
        plan = at.plan_speed(road, comfort=comfort, top_speed=speed)
        for anew in (False, True):
            rows = [
                [drive(road, plan, noise, anew, options.exact, k) for k in range(options.seeds)] for noise in NOISES
            ]
            cells = []
            for row in rows:
                ratio = np.mean([a.speed / b.speed for a, b in zip(row, rows[0], strict=True)])
                more = max(a.lateral - b.lateral for a, b in zip(row, rows[0], strict=True))
                cells.append(f"{ratio:.3f} {np.mean([one.distance for one in row]):.3f} {more:+.2f}")
            print(f"| {name} | {'anew' if anew else 'once'} |", " | ".join(cells), "|", flush=True)


if __name__ == "__main__":
    main()

"""Roads that are driven: RMS and largest offset, failures, by kind of road, car, profile and lateral acceleration.

    python benchmarks/roads_driven.py gate [--length 4200] [--profile road] [--car paper --car midsize-sedan]
    python benchmarks/roads_driven.py files ROAD.csv... [--car ...]

`gate`: four kinds of generated roads, six of each, dry at 4 and 7 m/s^2 and on friction 0.5 at 3.5 m/s^2, with the
default controller. `files`: the same on roads from files, such as centre lines of race tracks.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import dataclass

import numpy as np

from adaptrack.base.errors import InvalidInput
from adaptrack.cars.plant import DualTrack
from adaptrack.cars.vehicle import load_vehicle
from adaptrack.control.controllers import MPC
from adaptrack.drive.simulate import rollout
from adaptrack.road import Comfort, Road, generate_road, load_road, plan_speed
from adaptrack.scenario import RoadDrive

KINDS, SEEDS = ("motorway", "country", "town", "mountain"), range(6)
DRIVEN = ((4.0, 0.9), (7.0, 0.9), (3.5, 0.5))
"""Lateral acceleration that the speed is planned for (m/s^2), and friction."""


@dataclass
class Summary:
    """What drives of one kind came to."""

    squares: float = 0.0
    instants: int = 0
    largest: float = 0.0
    failed: int = 0
    drives: int = 0
    metres: float = 0.0
    worst: float = 0.0

    def add(self, run, length: float) -> None:
        error = run.error[np.isfinite(run.error)]
        self.squares += float(np.sum(error**2))
        self.instants += error.size
        self.largest = max(self.largest, float(np.abs(error).max()))
        self.worst = max(self.worst, float(np.sqrt(np.mean(error**2))))
        self.failed += run.failed is not None
        self.drives += 1
        self.metres += length

    def merge(self, other: Summary) -> None:
        for name in ("squares", "instants", "failed", "drives", "metres"):
            setattr(self, name, getattr(self, name) + getattr(other, name))
        self.largest, self.worst = max(self.largest, other.largest), max(self.worst, other.worst)

    def __str__(self) -> str:
        rms = math.sqrt(self.squares / max(self.instants, 1))
        return (
            f"RMS {rms:.4f} m, of the worst road {self.worst:.4f}, max |e| {self.largest:.3f} m, "
            f"{self.failed} of {self.drives} failed, {self.metres / 1e3:.1f} km"
        )


def drive_all(roads: list[Road], car_name: str, profile: str, lateral: float) -> Summary:
    """Drive roads with the default controller of a car, at the speed planned for a lateral acceleration."""
    car, found = load_vehicle(car_name), Summary()
    for number, road in enumerate(roads):
        try:
            plan = plan_speed(road, car, Comfort(lateral=lateral), top_speed=100.0)
        except InvalidInput as error:
            print(f"  {road.name}: {error}")
            continue
        run = rollout(
            DualTrack(car), MPC(car, profile=profile), RoadDrive(road, plan), profile=profile, seed=1000 + number
        )
        if run.failed:
            print(f"  {road.name}, {car_name}: {run.failed} at {run.failed_at:.1f} s")
        found.add(run, road.length)
    return found


def measure(arguments: argparse.Namespace, groups: dict[str, list[Road]]) -> None:
    """Print a row for each group of roads, car, profile and surface, and one for all groups together."""
    for profile in arguments.profile:
        for car in arguments.car:
            for lateral, friction in DRIVEN:
                total = Summary()
                label = f"{profile:10s} {car:14s} {lateral} m/s2, friction {friction}"
                for name, roads in groups.items():
                    summary = drive_all([road.replace(friction=friction) for road in roads], car, profile, lateral)
                    print(f"{label}, {name:14s} {summary}", flush=True)
                    total.merge(summary)
                print(f"{label}, {'all':14s} {total}", flush=True)


def main() -> None:
    """Measure what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=("gate", "files"))
    parser.add_argument("roads", nargs="*")
    parser.add_argument("--length", type=float, default=4200.0, help="m, of each road")
    parser.add_argument("--profile", action="append")
    parser.add_argument("--car", action="append")
    arguments = parser.parse_args()
    arguments.profile = arguments.profile or ["road"]
    arguments.car = arguments.car or ["paper", "midsize-sedan"]
    if arguments.what == "gate":
        groups = {kind: [generate_road(kind, seed, arguments.length) for seed in SEEDS] for kind in KINDS}
    else:
        groups = {road.name: [road] for road in map(load_road, arguments.roads)}
    measure(arguments, groups)


if __name__ == "__main__":
    main()

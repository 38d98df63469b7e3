"""Roads that are driven: RMS and largest offset, failures, by kind of road, car, profile and lateral acceleration.

    python benchmarks/roads_driven.py gate [--length 4200] [--profile road] [--car paper --car midsize-sedan]
    python benchmarks/roads_driven.py files ROAD.csv... [--car ...]
    python benchmarks/roads_driven.py hairpin
    python benchmarks/roads_driven.py speed

`gate`: four kinds of generated roads, six of each, dry at 4 and 7 m/s^2 and on friction 0.5 at 3.5 m/s^2, with the
default controller. `files`: the same on roads from files, such as centre lines of race tracks. `hairpin`: the
controllers in a hairpin of 15 m radius and on laps. `speed`: control steps a second on a curved and a straight road.
"""

from __future__ import annotations

import argparse
import math
import time
from dataclasses import dataclass

import numpy as np

from adaptrack.base.errors import InvalidInput
from adaptrack.cars.plant import DualTrack
from adaptrack.cars.vehicle import load_vehicle
from adaptrack.control.controllers import LQR, MPC, PurePursuit, Stanley
from adaptrack.drive.batch import rollout_batch
from adaptrack.drive.simulate import rollout
from adaptrack.road import Arc, Comfort, Line, Road, generate_road, load_road, plan_speed
from adaptrack.scenario import RoadDrive, Scenario

KINDS, SEEDS = ("motorway", "country", "town", "mountain"), range(6)
DRIVEN = ((4.0, 0.9), (7.0, 0.9), (3.5, 0.5))
"""Lateral acceleration that the speed is planned for (m/s^2), and friction."""


@dataclass
class Found:
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

    def __str__(self) -> str:
        rms = math.sqrt(self.squares / max(self.instants, 1))
        return (
            f"RMS {rms:.4f} m, of the worst road {self.worst:.4f}, max |e| {self.largest:.3f} m, "
            f"{self.failed} of {self.drives} failed, {self.metres / 1e3:.1f} km"
        )


def drive_all(roads: list[Road], car_name: str, profile: str, lateral: float) -> Found:
    """Drive roads with the default controller of a car, at the speed planned for a lateral acceleration."""
    car, found = load_vehicle(car_name), Found()
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


def gate(arguments: argparse.Namespace) -> None:
    """All generated roads."""
    for profile in arguments.profile:
        for car in arguments.car:
            for lateral, friction in DRIVEN:
                total = []
                for kind in KINDS:
                    roads = [generate_road(kind, seed, arguments.length, friction=friction) for seed in SEEDS]
                    total.append(drive_all(roads, car, profile, lateral))
                    print(
                        f"{profile:10s} {car:14s} {lateral} m/s2, friction {friction}, {kind:9s} {total[-1]}",
                        flush=True,
                    )
                both = Found()
                for each in total:
                    both.squares += each.squares
                    both.instants += each.instants
                    both.failed += each.failed
                    both.drives += each.drives
                    both.metres += each.metres
                    both.largest = max(both.largest, each.largest)
                    both.worst = max(both.worst, each.worst)
                print(f"{profile:10s} {car:14s} {lateral} m/s2, friction {friction}, all       {both}", flush=True)


def files(arguments: argparse.Namespace) -> None:
    """Roads from files."""
    loaded = [load_road(path) for path in arguments.roads]
    for profile in arguments.profile:
        for car in arguments.car:
            for lateral, friction in DRIVEN:
                found = Found()
                for road in loaded:
                    one = drive_all([road.replace(friction=friction)], car, profile, lateral)
                    print(
                        f"{profile:10s} {car:14s} {lateral} m/s2, friction {friction}, {road.name:14s} {one}",
                        flush=True,
                    )
                    for name in ("squares", "instants", "failed", "drives", "metres"):
                        setattr(found, name, getattr(found, name) + getattr(one, name))
                    found.largest, found.worst = max(found.largest, one.largest), max(found.worst, one.worst)
                print(
                    f"{profile:10s} {car:14s} {lateral} m/s2, friction {friction}, all            {found}", flush=True
                )


def hairpin(arguments: argparse.Namespace) -> None:
    """Four controllers in a hairpin and on laps."""
    bend = Road.from_segments(
        [Line(length=60.0), Arc(length=15.0 * math.pi, curvature=1 / 15), Line(length=60.0)], name="hairpin"
    )
    lap = generate_road("lap", 3, 2000.0)
    car = load_vehicle("paper")
    drives = [
        RoadDrive(bend, 6.0),
        RoadDrive(lap, plan_speed(lap, car, Comfort(lateral=4.0)), laps=10, name="lap, 10 times"),
    ]
    for profile in ("paper", "road", "production"):
        laws = [MPC(car, profile=profile, period=0.05)]
        laws += [law(car, period=0.05, preview=True) for law in (LQR, PurePursuit, Stanley)]
        for drive in drives:
            for law in laws:
                run = rollout(DualTrack(car), law, drive, profile=profile, seed=1)
                found = Found()
                found.add(run, drive.length)
                print(f"{profile:10s} {drive.name:14s} {law.name:32s} {found}", flush=True)


def speed(arguments: argparse.Namespace) -> None:
    """Control steps a second, curved against straight."""
    car = load_vehicle("paper")
    road = generate_road("country", 1, 4000.0)
    drive = RoadDrive(road, plan_speed(road, car, Comfort(lateral=4.0)))
    signals = drive.sample(0.05)
    straight = Scenario.from_arrays(signals.t, np.zeros(signals.n + 1), signals.speed, 0.9, name="straight")
    mpc, runs, ratios = MPC(car, profile="road"), 1024, []
    print(f"{runs * signals.n:,} control steps each, one thread")
    for _ in range(7):
        pace = []
        for test in (drive, straight):
            began = time.process_time()
            found = rollout_batch(
                DualTrack(car), mpc, test, which=np.zeros(runs, int), seeds=np.arange(runs), profile="road", threads=1
            )
            pace.append(found.steps.sum() / (time.process_time() - began))
        ratios.append(pace[0] / pace[1])
        print(f"curved {pace[0]:,.0f}, straight {pace[1]:,.0f} steps per CPU s: {ratios[-1]:.3f}", flush=True)
    print(f"median ratio of {len(ratios)}: {np.median(ratios):.3f}")


def main() -> None:
    """Measure what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=("gate", "files", "hairpin", "speed"))
    parser.add_argument("roads", nargs="*")
    parser.add_argument("--length", type=float, default=4200.0, help="m, of each road")
    parser.add_argument("--profile", action="append")
    parser.add_argument("--car", action="append")
    arguments = parser.parse_args()
    arguments.profile = arguments.profile or ["road"]
    arguments.car = arguments.car or ["paper", "midsize-sedan"]
    {"gate": gate, "files": files, "hairpin": hairpin, "speed": speed}[arguments.what](arguments)


if __name__ == "__main__":
    main()

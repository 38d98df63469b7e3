"""What the softer rear axle in the prediction does: drives in pairs, this version against another checkout.

    python benchmarks/softer_rear.py SUITE [SUITE ...] --write FILE         drive suites, one JSON line a drive
    python benchmarks/softer_rear.py --compare BEFORE AFTER                 geometric means of ratios by suite and car
    python benchmarks/softer_rear.py --stability                            margins in steady turns
    OTHER/.venv/bin/python benchmarks/softer_rear.py SUITE --write BEFORE   the other version, with its own Python

Both drives of a pair have the same road, plan and noise. The grip of a car is its largest steady lateral acceleration
on a friction of 0.9, load transfer included; a plan reaches a share of it. Seeds were written down before the first
run: fresh roads 301 to 310, noise 1 to 3 (lap 5 of the suite `lap5`: noise 1 to 100).

A drive *swings* where, in a bend of constant demand (+-10 %) for at least 3 s, the amplitude of the lateral
acceleration (less the demand) between 0.5 and 3 Hz exceeds 0.5 m/s^2 in the last third and 1.5 times that of the first.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy import signal

import adaptrack as at
from adaptrack.analysis import linearisation
from adaptrack.analysis.stability import margins
from adaptrack.core.controllers import informed
from adaptrack.core.physics.forces import GRAVITY
from adaptrack.core.synthesis.car import usable_friction
from adaptrack.road import Comfort
from adaptrack.road.speed import packed, steering_limit

FRICTION = 0.9
CARS = ("midsize-sedan", "van", "sports-car", "compact-ev")
ROADS = [("lap" if seed % 2 else "mountain", seed) for seed in range(301, 311)]
NOISE = (1, 2, 3)
GENTLE = 4.0  # m/s^2
DRIVE = ("suite", "car", "road", "noise", "lateral")
"""What names a drive in a file."""
JUMP_AT, JUMP_TO = 700.0, 0.7  # m, share of the friction behind it


def grip(car: at.Vehicle, friction: float = FRICTION) -> float:
    """Return the largest steady lateral acceleration (m/s^2)."""
    return GRAVITY * float(usable_friction(packed(car), steering_limit(car), friction))


@cache
def planned(car_name: str, kind: str, seed: int, lateral: float, along: tuple[tuple[str, Any], ...]) -> at.RoadDrive:
    """Return a road with its plan, which reaches a lateral acceleration (m/s^2)."""
    road = at.generate_road(kind, seed=seed, **dict(along))
    return at.RoadDrive(road, at.plan_speed(road, at.load_vehicle(car_name), Comfort(lateral=lateral)))


def drive(
    suite: str, car_name: str, kind: str, seed: int, noise: int, lateral: float, believed: at.Vehicle | None = None,
    profile: str = "road", dead_time: float | None = None, friction: float | tuple[float, float] = FRICTION,
    learns: bool = False, along: tuple[tuple[str, Any], ...] = (), guarded: bool = False, jumps: bool = False,
) -> dict[str, Any]:  # fmt: skip
    """Drive once; believed: the car as controller and speed control have it.

    guarded: a `Driver` in place of the speed control; jumps: the plan does not know that the friction is lower from
    `JUMP_AT` on.
    """
    car, world = at.load_vehicle(car_name), at.load_profile(profile)
    if dead_time is not None:
        world = world.replace(steering=world.steering.model_copy(update={"dead_time": dead_time}))
    known = believed or car
    controller = at.MPC(known, profile=world, **({"learning": at.Learning()} if learns else {}))
    driver = at.Driver() if guarded else at.SpeedControl(known, friction=friction)
    task = planned(car_name, kind, seed, lateral, along)
    if jumps:
        friction_along = (0.0, JUMP_AT, JUMP_AT + 1.0), (FRICTION, FRICTION, JUMP_TO * FRICTION)
        task = at.RoadDrive(task.road.replace(friction=friction_along), task.plan)
    begin = time.process_time()
    run = at.simulate(at.DualTrack(car), controller, task, profile=world, driver=driver, seed=noise)
    error, moves = np.asarray(run.error), np.asarray(run.command_change)
    return {
        "suite": suite, "car": car_name + (" sheet" if learns and believed else ""), "road": f"{kind} {seed}",
        "noise": noise, "lateral": lateral, "lost": run.failed, "rms": float(np.sqrt(np.nanmean(error**2))),
        "largest": float(np.nanmax(np.abs(error))), "moves": float(np.sqrt(np.nanmean(moves**2))),
        "cost": float(np.nanmean(error**2 + 3.0 * moves**2)), "swings": swings(run, task),
        "seconds": time.process_time() - begin,
    }  # fmt: skip


def swings(run: Any, task: at.RoadDrive) -> bool:
    """Return whether the lateral acceleration swings with a growing amplitude in a bend of constant demand."""
    lateral, speed = np.asarray(run.lateral_acceleration), np.asarray(run.vx)
    count = int(np.isfinite(lateral).sum())
    least = round(3.0 / run.period)
    if count < 2 * least:
        return False
    station = np.asarray(run.road["station"])[:count]
    demand = speed[:count] ** 2 * np.asarray(task.road.at(station).curvature)
    band = signal.butter(2, (0.5, 3.0), "bandpass", fs=1.0 / run.period, output="sos")
    swing = signal.sosfiltfilt(band, lateral[:count] - demand)  # the bend's own beginning and end are no swing
    k = 0
    while k + least <= count:
        end = k + 1
        while end < count and abs(demand[end] - demand[k]) <= 0.1 * abs(demand[k]):
            end += 1
        if end - k >= least and abs(demand[k]) > 1.0:
            third = (end - k) // 3
            first, last = (
                math.sqrt(2.0) * float(np.std(part)) for part in (swing[k : k + third], swing[end - third : end])
            )
            if last > max(0.5, 1.5 * first):
                return True
            k = end
        else:
            k += max((end - k) // 4, 1)
    return False


def sheet(car_name: str) -> at.Vehicle:
    """Return what a data sheet tells about a car."""
    car = at.load_vehicle(car_name)
    return at.vehicle_from_data_sheet(car.name, car.mass, car.wheelbase)


def over_roads(
    name: str, share: float, *, noise: tuple[int, ...] = NOISE, cars: tuple[str, ...] = CARS, count: int = 10,
    make: Callable[[str], dict[str, Any]] = lambda car: {},
) -> Iterator[dict[str, Any]]:  # fmt: skip
    """Drives of cars on the fresh roads, planned to a share of the grip."""
    for car in cars:
        for kind, seed in ROADS[:count]:
            for number in noise:
                lateral = round(share * grip(at.load_vehicle(car)), 2)
                yield {
                    "suite": name,
                    "car_name": car,
                    "kind": kind,
                    "seed": seed,
                    "noise": number,
                    "lateral": lateral,
                    **make(car),
                }


def sheets(name: str, share: float) -> Iterator[dict[str, Any]]:
    """Drives of a data sheet that learns."""
    return over_roads(name, share, cars=CARS[:1], make=lambda car: {"believed": sheet(car), "learns": True})


def near(share: float, name: str) -> Iterator[dict[str, Any]]:
    """Known cars and a data sheet that learns."""
    yield from over_roads(name, share)
    yield from sheets(name, share)


def gentle(name: str = "gentle") -> Iterator[dict[str, Any]]:
    """200 drives at up to 4 m/s^2."""
    for item in over_roads(name, 0.78, noise=(1, 2, 3, 4, 5)):
        yield item | {"lateral": GENTLE}


def lap5(name: str = "lap5") -> Iterator[dict[str, Any]]:
    """The lap on which the loop once swung off the road."""
    for number in range(1, 101):
        yield {"suite": name, "car_name": "midsize-sedan", "kind": "lap", "seed": 5, "noise": number, "lateral": 7.0}


def delays(name: str = "delays") -> Iterator[dict[str, Any]]:
    """Steering that is later."""
    for dead_time in (0.1, 0.2, 0.3, 0.4):
        yield from over_roads(name, 0.7, noise=(1,), count=4, make=lambda car, late=dead_time: {"dead_time": late})


def wrong_file(name: str, front: float, rear: float) -> Iterator[dict[str, Any]]:
    """Cars whose file has stiffness that is wrong by these factors."""

    def believed(car_name: str) -> dict[str, Any]:
        car = at.load_vehicle(car_name)
        stiffness = {"stiffness_front": front * car.stiffness_front, "stiffness_rear": rear * car.stiffness_rear}
        return {"believed": car.replace(**stiffness)}

    return over_roads(name, 0.78, noise=(1,), make=believed)


def slippery(name: str = "slippery") -> Iterator[dict[str, Any]]:
    """Half of the friction, and the speed control knows it."""
    low = FRICTION / 2.0
    for item in short(name):
        lateral = round(0.78 * grip(at.load_vehicle(item["car_name"]), low), 2)
        yield item | {"lateral": lateral, "friction": low, "along": (("friction", low),)}


def learner(name: str, share: float) -> Iterator[dict[str, Any]]:
    """Known cars whose steering and tyres are learned all the same."""
    return over_roads(name, share, noise=(1,), count=6, make=lambda car: {"learns": True})


def short(name: str, share: float = 0.78, **options: Any) -> Iterator[dict[str, Any]]:
    """One noise seed on six roads."""
    return over_roads(name, share, noise=(1,), count=6, make=lambda car: options)


SUITES: dict[str, Callable[[], Iterator[dict[str, Any]]]] = {
    "near .78": partial(near, 0.78, "near .78"),
    "near .88": partial(near, 0.88, "near .88"),
    "near .95": partial(near, 0.95, "near .95"),
    "lap5": lap5,
    "gentle": gentle,
    "soft file": partial(wrong_file, "soft file", 0.7, 0.7),
    "stiff file": partial(wrong_file, "stiff file", 1.4, 1.4),
    "balance +": partial(wrong_file, "balance +", 1.05, 0.955),
    "balance -": partial(wrong_file, "balance -", 0.955, 1.05),
    "friction -": partial(short, "friction -", friction=0.81),
    "friction +": partial(short, "friction +", friction=0.99),
    "interval": partial(short, "interval", friction=(0.65, 0.9)),
    "production": partial(short, "production", profile="production"),
    "delays": delays,
    "bank": partial(short, "bank", along=(("bank", 0.05),)),
    "jump": partial(short, "jump", share=0.6, friction=(0.5, 0.9), jumps=True),
    "slippery": slippery,
    "learner": partial(learner, "learner", 0.78),
    "learner .88": partial(learner, "learner .88", 0.88),
    "driver": partial(over_roads, "driver", 0.78, noise=(1,), make=lambda car: {"guarded": True}),
}  # fmt: skip


def run_suites(names: list[str], output: Path) -> None:
    """Drive suites; append a line for each drive."""
    drives = [item for name in names for item in SUITES[name]()]
    begin = time.monotonic()
    with output.open("a") as file:
        for count, item in enumerate(drives, 1):
            file.write(json.dumps(drive(**item)) + "\n")
            file.flush()
            left = (time.monotonic() - begin) / count * (len(drives) - count)
            print(f"\r{count} of {len(drives)}, {left:.0f} s left ", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)


def compare(before: Path, after: Path) -> None:
    """Print a row for each suite and car: drives lost, and geometric means of ratios over drives that both kept."""
    runs = [
        {(*(line[name] for name in DRIVE), number): line for number, line in _numbered(file)}
        for file in (before, after)
    ]  # fmt: skip
    pairs: dict[tuple[str, str], list[tuple[dict[str, Any], dict[str, Any]]]] = defaultdict(list)
    for key in runs[0].keys() & runs[1].keys():
        for group in ((key[0], key[1]), (key[0], "all")):
            pairs[group].append((runs[0][key], runs[1][key]))
    columns = "suite", "car", "drives", "lost", "new losses", "RMS", "largest", "moves", "cost", "worst pair", "swings"
    print(*columns, "largest where it swung", sep=" | ")
    for (suite, car), group in sorted(pairs.items()):
        kept = [pair for pair in group if pair[0]["lost"] is None and pair[1]["lost"] is None]
        ratio = {name: float(np.exp(np.mean([math.log(b[name] / a[name]) for a, b in kept]))) if kept else math.nan
                 for name in ("rms", "largest", "moves", "cost")}  # fmt: skip
        lost = [sum(pair[i]["lost"] is not None for pair in group) for i in (0, 1)]
        swinging = [sum(pair[i]["swings"] for pair in group) for i in (0, 1)]
        new = sum(a["lost"] is None and b["lost"] is not None for a, b in group)
        worst = max((b["largest"] / a["largest"] for a, b in kept), default=math.nan)
        swung = [math.log(b["largest"] / a["largest"]) for a, b in kept if a["swings"]]
        largest = f"{math.exp(np.mean(swung)):.3f}" if swung else "-"
        ratios = " | ".join(f"{value:.3f}" for value in ratio.values())
        print(f"{suite} | {car} | {len(group)} | {lost[0]} -> {lost[1]} | {new} | {ratios} | {worst:.2f} | "
              f"{swinging[0]} -> {swinging[1]} | {largest}")  # fmt: skip


def stability(profile: str = "road") -> None:
    """Print the spectral radius and delay margin (ms) over speed and lateral acceleration, without and with the slope.

    The plant, a dual track, and the gains of the filter are those of the steady turn.
    """
    world = at.load_profile(profile).without_sample_ages
    print("car | v (m/s) | a_y/grip | slope | radius | delay margin (ms) | over that on a straight")
    for name in CARS:
        car = at.load_vehicle(name)
        plant, mpc = at.DualTrack(car), at.MPC(car, profile=world)
        for speed in (10.0, 15.0, 20.0, 25.0, 30.0):
            estimator, straight = linearisation.EstimatorAt(mpc, speed), math.nan
            for share in (0.0, 0.2, 0.4, 0.6, 0.7, 0.8, 0.88, 0.95):
                try:
                    turn = linearisation.steady_turn(plant, speed, share * grip(car), FRICTION)
                except at.InvalidInput:
                    continue  # more than its steering or its tyres allow
                sampled = linearisation.sampled_about(plant, mpc.period, turn, world)
                gains = estimator.with_turn_gains(turn.measured(plant, mpc.period), turn.steering)
                slope = informed.rear_slope(share * grip(car), FRICTION)
                before, after = (
                    margins(sampled, linearisation.laws(mpc, speed, mpc.tuning.as_array(), gains, s), mpc.period)
                    for s in (1.0, slope)
                )
                straight = 1e3 * float(before.delay[0]) if share == 0.0 else straight
                radii, delays = ([float(getattr(m, key)[0]) for m in (before, after)] for key in ("radius", "delay"))
                print(f"{name} | {speed:g} | {share:g} | {slope:.2f} | {radii[0]:.3f} -> {radii[1]:.3f} | "
                      f"{1e3 * delays[0]:.0f} -> {1e3 * delays[1]:.0f} | {1e3 * delays[1] / straight:.2f}",
                      flush=True)  # fmt: skip


def _numbered(file: Path) -> Iterator[tuple[int, dict[str, Any]]]:
    """Lines of a file; drives that differ only in what no line states are numbered."""
    seen: dict[tuple[Any, ...], int] = defaultdict(int)
    for text in file.read_text().splitlines():
        line = json.loads(text)
        key = tuple(line[name] for name in DRIVE)
        seen[key] += 1
        yield seen[key], line


def main() -> None:
    """Drive or compare."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("suites", nargs="*", choices=[[], *SUITES], help="which drives")
    parser.add_argument("--write", type=Path, help="JSON lines")
    parser.add_argument("--compare", type=Path, nargs=2, metavar=("BEFORE", "AFTER"))
    parser.add_argument("--stability", action="store_true", help="margins of the linear loop in steady turns")
    arguments = parser.parse_args()
    if arguments.compare:
        compare(*arguments.compare)
    elif arguments.stability:
        stability()
    elif arguments.write:
        run_suites(arguments.suites or list(SUITES), arguments.write)
    else:
        parser.error("give --write FILE or --compare BEFORE AFTER")


if __name__ == "__main__":
    main()

"""Circuits of the user's own: which drives fail at the planned speed, where, and how long a lap takes.

    python benchmarks/circuits.py FOLDER --out after.json [--against before.json]
    python benchmarks/circuits.py FOLDER --no-holds --out before.json
    python benchmarks/circuits.py FOLDER --domain [--no-holds]
    python benchmarks/circuits.py --made 20 --longest 10

FOLDER holds centre lines as CSV files (`load_road`). Each is planned at 4 and at 7 m/s^2 sideways and driven once
around with the informed controller, in `road` and `production`, three noise seeds, two cars. Speeds end at 100 m/s, for
the roads have no limit and the domain of most cars' files ends at 27 m/s; with `--domain` they end with that.
`--no-holds` leaves out what the controller can hold (`holdable_speed`). `--made` drives random rows of straights and
bends instead: on those, with other seeds, the rule of `holdable.min_transient_margin` was chosen, not on circuits.
`--against` compares lap times, over the circuits on which the other file has no failure.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import numpy as np

from adaptrack.base.errors import InvalidInput
from adaptrack.base.limits import MAX_SPEED
from adaptrack.cars.plant import DualTrack
from adaptrack.cars.vehicle import load_vehicle
from adaptrack.control.controllers import MPC
from adaptrack.drive.batch import rollout_batch
from adaptrack.road import Arc, Clothoid, Comfort, Line, Road, load_road, plan_speed
from adaptrack.scenario import RoadDrive

SEEDS = (81_001, 81_002, 81_003)
"""Of the judged runs; nothing was chosen on them, nor on the circuits."""
LATERAL = (4.0, 7.0)
"""m/s^2"""
CARS, PROFILES = ("midsize-sedan", "van"), ("road", "production")
ALLOWED = {4.0: 1.01, 7.0: 1.03}
"""Lap time over that of before, at most, at each lateral acceleration."""


MADE_SEEDS = (5, 6)
"""Of the drives along made roads."""


def made(seed: int) -> Road:
    """A row of straights of 50 to 900 m and bends of 15 to 300 m radius, 5 km long, with clothoids between."""
    rng, segments, length = np.random.default_rng(seed), [], 0.0
    while length < 5000.0:
        straight = float(np.exp(rng.uniform(np.log(50.0), np.log(900.0))))
        k = float(rng.choice([-1.0, 1.0]) / np.exp(rng.uniform(np.log(15.0), np.log(300.0))))
        ramp = float(np.clip(rng.uniform(0.3, 1.0) / abs(k), 15.0, 80.0))
        arc = max(float(rng.uniform(0.3, 2.6)) / abs(k) - ramp, 5.0)
        segments += [
            Line(length=straight), Clothoid(length=ramp, start_curvature=0.0, end_curvature=k),
            Arc(length=arc, curvature=k), Clothoid(length=ramp, start_curvature=k, end_curvature=0.0),
        ]  # fmt: skip
        length += straight + 2.0 * ramp + arc
    return Road.from_segments(segments, name=f"made {seed}")


def drive(road: Road, car_name: str, profile: str, lateral: float, options: argparse.Namespace) -> dict:
    """A plan and its drives; failures are told with their place and speed."""
    car = load_vehicle(car_name)
    mpc, plant = MPC(car, profile=profile), DualTrack(car)
    given = {} if options.domain else {"top_speed": MAX_SPEED.most}
    if options.holds:
        from adaptrack.analysis.holdable import holdable_speed  # the checkout before has none

        given["holds"] = holdable_speed(car, mpc, profile, longest=options.longest)
    row = {"circuit": road.name, "car": car_name, "profile": profile, "lateral": lateral}
    try:
        plan = plan_speed(road, car, Comfort(lateral=lateral), **given)
    except InvalidInput as error:
        return row | {"error": str(error), "failed": len(options.seed), "lap": float("nan"), "places": []}
    found = rollout_batch(
        plant, mpc, RoadDrive(road, plan), scenario_indices=np.zeros(len(options.seed), int),
        seeds=np.array(options.seed),
        profile=profile, threads=1,
    )  # fmt: skip
    places = []
    for at, why in zip(found.failed_at, found.failed, strict=True):
        if why is not None:
            station, speed = plan.motion(at)
            places.append([round(float(station)), round(float(speed), 1), str(why)])
    worst = float(np.where(np.isfinite(found.max_abs_error), found.max_abs_error, np.inf).max())
    return row | {
        "lap": plan.duration, "fastest": float(plan.speed.max()), "failed": len(places), "places": places,
        "max_error": worst,
    }  # fmt: skip


def table(rows: list[dict]) -> None:
    """Failures and lap times of each car, profile and lateral acceleration."""
    print("car            profile     m/s2  circuits failed  drives failed  laps together (s)  largest |e| (m)")
    for key in dict.fromkeys((row["car"], row["profile"], row["lateral"]) for row in rows):
        some = [row for row in rows if (row["car"], row["profile"], row["lateral"]) == key]
        bad = [row for row in some if row["failed"]]
        together = sum(row["lap"] for row in some)
        worst = max(row.get("max_error", np.inf) for row in some)
        drives = sum(row["failed"] for row in some)
        print(
            f"{key[0]:14s} {key[1]:10s} {key[2]:5.1f}  {len(bad):4d} of {len(some)}      {drives:6d}         "
            f"{together:10.1f}         {worst:.2f}"
        )
        for row in bad:
            print(f"    {row['circuit']}: {row.get('error') or row['places']}")


def against(rows: list[dict], before: list[dict]) -> None:
    """Lap times over those of before, on the circuits on which nobody failed then, in either profile."""

    def key(row: dict) -> tuple:
        return row["circuit"], row["car"], row["lateral"]

    whole = {key(row): True for row in before}
    for row in before:
        whole[key(row)] &= row["failed"] == 0
    laps = {(*key(row), row["profile"]): row["lap"] for row in before}
    print("car            profile     m/s2  circuits  lap over before: all together, median, largest")
    for of in dict.fromkeys((row["car"], row["profile"], row["lateral"]) for row in rows):
        some = [
            (row["lap"], laps[*key(row), of[1]], row["circuit"])
            for row in rows
            if (row["car"], row["profile"], row["lateral"]) == of and whole.get(key(row), False)
        ]
        if not some:
            continue
        ratios = np.array([after / then for after, then, _ in some])
        total = sum(each[0] for each in some) / sum(each[1] for each in some)
        over = int((ratios > ALLOWED.get(of[2], 1.0)).sum())
        print(
            f"{of[0]:14s} {of[1]:10s} {of[2]:5.1f}  {len(some):8d}  {total:.4f}, {np.median(ratios):.4f}, "
            f"{ratios.max():.4f} ({some[int(ratios.argmax())][2]}); {over} longer than allowed"
        )


def main() -> None:
    """Drive them all."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, nargs="?")
    parser.add_argument("--made", type=int, default=0, metavar="N", help="so many made roads instead of a folder")
    parser.add_argument("--longest", type=float, default=10.0, help="of `holdable_speed`")
    parser.add_argument("--out", type=Path)
    parser.add_argument("--against", type=Path)
    parser.add_argument("--car", action="append")
    parser.add_argument("--profile", action="append")
    parser.add_argument("--lateral", type=float, action="append")
    parser.add_argument("--seed", type=int, action="append")
    parser.add_argument("--circuit", action="append", help="name of a file without .csv")
    parser.add_argument("--domain", action="store_true", help="speeds end with the domain of the car")
    parser.add_argument("--no-holds", dest="holds", action="store_false", help="as without `holdable_speed`")
    options = parser.parse_args()
    options.seed = options.seed or list(MADE_SEEDS if options.made else SEEDS)
    if options.made:
        roads = [made(seed) for seed in range(options.made)]
    else:
        files = sorted(options.folder.glob("*.csv")) if options.folder else []
        roads = [load_road(each) for each in files if not options.circuit or each.stem in options.circuit]
    if not roads:
        parser.error(f"{options.folder}: no .csv files.")
    began, rows = time.process_time(), []
    for car in options.car or CARS:
        for profile in options.profile or PROFILES:
            for lateral in options.lateral or LATERAL:
                rows += [drive(road, car, profile, lateral, options) for road in roads]
    print(f"{len(roads)} circuits, {sum(road.length for road in roads) / 1e3:.1f} km; seeds {options.seed}")
    table(rows)
    if options.out:
        options.out.write_text(json.dumps(rows, indent=1))
    if options.against:
        against(rows, json.loads(options.against.read_text()))
    print(f"{time.process_time() - began:.0f} CPU s")


if __name__ == "__main__":
    main()

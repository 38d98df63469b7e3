"""Roads as measured: the foot of points, positions, speed plans, fits of noisy records; see docs/roads.md.

    python benchmarks/roads.py [--points 10000] [--xodr FILE ...] [--json]

Every figure is the largest error against a reference that shares nothing with the package but the road itself: closed
forms and adaptive quadrature, a search for the nearest point millimetre by millimetre, a known road.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from adaptrack.base.errors import AdaptrackError
from adaptrack.cars.vehicle import load_vehicle
from adaptrack.core import path
from adaptrack.road import (
    Arc,
    Clothoid,
    Comfort,
    Cubic,
    Line,
    Road,
    fit_road,
    generate_road,
    load_road,
    plan_speed,
)
from adaptrack.road.table import tabulate

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from references.road import beside, coarse_samples, end_of, figure_of_eight, nearest_by_search

NOISE = 0.5
"""m, independent error of each coordinate of the record."""


def main() -> None:
    """Measure all, print JSON."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--points", type=int, default=10_000, help="for the projection, over 20 roads")
    parser.add_argument("--xodr", nargs="*", default=[], help="OpenDRIVE files to read whole")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    found = {
        "paths": paths(),
        "positions": positions(),
        "projection": projection(options.points),
        "speed": speed(),
        "records": records(),
        "dense records": dense_records(),
        "opendrive": [opendrive(each) for each in options.xodr],
    }
    print(json.dumps(found, indent=None if options.json else 1))


def paths() -> dict[str, dict[str, float]]:
    """The kernel that makes a path of a planner's points, 1 m apart: bytes, and time on one core."""
    found = {}
    for count in (60, 500, 2000):
        s = np.arange(float(count))
        points = np.stack([s, 8.0 * np.sin(s / 25.0)], axis=-1)
        memory, times = np.empty(path.path_words(points, False)), []
        for _ in range(400):
            began = time.perf_counter()
            _, pieces = path.path_through(points, False, memory)
            times.append(time.perf_counter() - began)
        line, _ = path.line_in(memory)
        found[f"{count} points"] = {
            "memory (bytes)": memory.nbytes,
            "path (bytes)": 8 * path.words_of(pieces, path.cells_of(line.numbers[0])),
            "median (us)": round(1e6 * float(np.median(times)), 1),
            "least (us)": round(1e6 * min(times), 1),
        }
    return found


def positions() -> dict[str, float]:
    """Ends of 200 lines, arcs and clothoids against quadrature (m), points of 50 cubics against their formula (m)."""
    rng = np.random.default_rng(1)
    worst = {"line, arc, clothoid (m)": 0.0, "cubic (m)": 0.0, "curvature of clothoids (1/m)": 0.0}
    for _ in range(200):
        length, (k0, k1) = (
            float(rng.uniform(1.0, 200.0)),
            rng.uniform(-0.1, 0.1, 2) * rng.choice([0.0, 1.0], 2, p=[0.3, 0.7]),
        )
        (table,) = tabulate([Clothoid(length=length, start_curvature=k0, end_curvature=k1)])
        end, exact = table.at(length), end_of(k0, (k1 - k0) / length, length)
        s = rng.uniform(0.0, length, 100)
        bend = np.abs(table.at(s).curvature - (k0 + (k1 - k0) * s / length)).max()
        _raise(worst, "line, arc, clothoid (m)", math.hypot(end.x - exact[0], end.y - exact[1]))
        _raise(worst, "curvature of clothoids (1/m)", bend)
    p = np.linspace(0.0, 1.0, 2001)
    for _ in range(50):
        x, y = (0.0, *rng.uniform([20, -5, -5], [60, 5, 5])), (0.0, *rng.uniform(-20, 20, 3))
        (table,) = tabulate([Cubic(x=x, y=y)])
        nodes, weights = np.polynomial.legendre.leggauss(12)
        half = 0.5 * (p[1] - p[0])
        q = (p[:-1] + half)[:, np.newaxis] + half * nodes
        slope = [c[1] + 2 * c[2] * q + 3 * c[3] * q * q for c in (x, y)]
        s = np.concatenate([[0.0], np.cumsum(half * (np.hypot(*slope) @ weights))])
        at = table.at(np.minimum(s, table.length))
        exact = [c[1] * p + c[2] * p**2 + c[3] * p**3 for c in (x, y)]
        _raise(worst, "cubic (m)", np.hypot(at.x - exact[0], at.y - exact[1]).max())
    return worst


def projection(count: int) -> dict[str, float]:
    """Feet of points on 20 roads against the nearest point of a search in steps of 1 mm."""
    rng = np.random.default_rng(2)
    roads = [
        generate_road(kind, seed, 2000.0) for kind in ("motorway", "country", "town", "mountain") for seed in range(4)
    ]
    roads += [generate_road("lap", seed, 2000.0) for seed in range(2)]
    roads += [Road.from_segments(figure_of_eight(Arc, Line), closed=True)]
    roads += [fit_road(np.stack(roads[5].at(np.arange(0.0, roads[5].length, 5.0))[:2], axis=-1))]
    worst = {"roads": len(roads), "points": 0, "closed roads": sum(road.closed for road in roads)}
    worst |= {"t.(p - c) (m)": 0.0, "distance beyond the search's (m)": 0.0, "arc length from the search's (m)": 0.0}
    seconds = 0.0
    for road in roads:
        s = rng.uniform(0.0, road.length, count // len(roads))
        reach = np.minimum(10.0, 0.95 / np.maximum(np.abs(road.at(s).curvature), 1e-9))  # short of the evolute
        x, y = beside(road, s, rng.uniform(-1.0, 1.0, s.size) * reach)
        begun = time.perf_counter()
        feet = road.project(x, y)
        seconds += time.perf_counter() - begun
        place = road.at(feet.s)
        ahead = (place.x - x) * np.cos(place.heading) + (place.y - y) * np.sin(place.heading)
        _raise(worst, "t.(p - c) (m)", np.abs(ahead).max())
        samples = coarse_samples(road)
        for i in range(s.size):
            found, distance = nearest_by_search(road, x[i], y[i], samples=samples)
            worst["points"] += 1
            if 0.0 < feet.s[i] < road.length:
                _raise(worst, "distance beyond the search's (m)", abs(feet.offset[i]) - distance)
                apart = abs(found - feet.s[i])
                tied = abs(abs(feet.offset[i]) - distance) < 1e-6  # two feet equally far are both right
                apart = min(apart, road.length - apart) if road.closed else apart
                _raise(worst, "arc length from the search's (m)", 0.0 if tied and apart > 1.0 else apart)
    near = np.tile(s, 200)
    begun = time.perf_counter()
    road.project(np.tile(x, 200), np.tile(y, 200), near=near + 0.5)
    return {
        **worst, "whole road (us)": 1e6 * seconds / worst["points"],
        "near the last foot (us)": 1e6 * (time.perf_counter() - begun) / near.size,
    }  # fmt: skip


def speed() -> list[dict[str, float]]:
    """Time of plans at 1 m against that at 0.05 m, and how far limits are exceeded in between."""
    car, comfort, rows = load_vehicle("midsize-sedan"), Comfort(lateral=4.0), []
    for kind in ("country", "town", "mountain", "lap"):
        road = generate_road(kind, 1, 2000.0)
        plan, fine = plan_speed(road, car, comfort), plan_speed(road, car, comfort, spacing=0.05)
        s = np.linspace(0.0, road.length, 50_001)[:-1]
        over = float((plan.at(s) ** 2 * np.abs(road.at(s).curvature)).max() / 4.0 - 1.0)
        rows.append(
            {
                "road": kind,
                "time over fine (%)": 100.0 * (plan.duration / fine.duration - 1.0),
                "over (%)": 100.0 * over,
            }
        )
    return rows


def records() -> list[dict[str, float]]:
    """A record at 1 Hz with an error of 0.5 m in each coordinate, of a known road driven at its planned speed."""
    rows = []
    for kind in ("country", "mountain", "town", "motorway"):
        road = generate_road(kind, 1, 5000.0)
        plan = plan_speed(road, None, Comfort(lateral=2.5))
        s = np.interp(np.arange(0.0, plan.duration, 1.0), plan.time, plan.s)
        points = np.stack(road.at(s)[:2], axis=-1) + NOISE * np.random.default_rng(3).standard_normal((s.size, 2))
        fitted = fit_road(points, max_deviation=3.0)
        samples = coarse_samples(fitted)
        true = max(nearest_by_search(fitted, *point, samples=samples)[1] for point in points)
        error = fitted.project(*road.at(np.linspace(0.0, road.length, 2000)[20:-20])[:2]).offset
        rows.append({
            "road": kind, "points": len(points), "stated (m)": fitted.deviation, "by search (m)": true,
            "from the true road, rms (m)": float(np.sqrt(np.mean(error**2))), "largest (m)": float(np.abs(error).max()),
        })  # fmt: skip
    return rows


def dense_records() -> list[dict[str, float]]:
    """Points 1.3 m apart with white noise, nothing asked for: the plan and the line, the worst of five seeds."""
    rows, car = [], load_vehicle("midsize-sedan")
    for kind, length in (("country", 2500.0), ("lap", 2840.0)):
        road = generate_road(kind, 1, length)
        points = np.stack(road.at(np.arange(0.0, road.length, 1.3))[:2], axis=-1)
        whole, checked = plan_speed(road, car).duration, road.at(np.linspace(0.005, 0.995, 4000) * road.length)
        for noise in (0.0, 0.02, 0.05, 0.1, 0.15, 0.2, 0.5, 1.0, 2.0):
            worst = {"plan over the road's (%)": 0.0, "line from the road's (m)": 0.0, "fit (s)": 0.0}
            for seed in range(5):
                record = points + noise * np.random.default_rng(seed).standard_normal(points.shape)
                begun = time.perf_counter()
                fitted = fit_road(record, speed_limit=road.speed_limit)
                _raise(worst, "fit (s)", time.perf_counter() - begun)
                slower = 100.0 * (plan_speed(fitted, car).duration / whole - 1.0)
                _raise(worst, "plan over the road's (%)", abs(slower))
                _raise(worst, "line from the road's (m)", np.abs(fitted.project(checked.x, checked.y).offset).max())
            rows.append({"road": kind, "points": len(points), "noise (m)": noise, **worst})
    return rows


def opendrive(path: str) -> dict[str, object]:
    """How many roads of a file are read, and the first reason why one is not."""
    names = [str(road.get("id")) for road in ElementTree.parse(path).getroot().iter("road") if road.find("planView")]
    read, reasons = 0, []
    for name in names:
        try:
            load_road(path, road=name)
            read += 1
        except AdaptrackError as error:
            reasons.append(str(error).removeprefix(path)[:160])
    return {"file": Path(path).name, "roads": len(names), "read": read, "refused": reasons}


def _raise(worst: dict[str, float], key: str, value: float) -> None:
    worst[key] = max(worst[key], float(value))


if __name__ == "__main__":
    main()

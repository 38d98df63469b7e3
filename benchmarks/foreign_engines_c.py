"""The exported C library drives the cars of `foreign_engines.py`, steering and speed, beside the tracker in Python.

    PYTHONPATH=src:DIR python benchmarks/foreign_engines_c.py [--engine mujoco pybullet] [--seeds 3]

Roads, stops and cars are those of `foreign_engines.py --speed-control`; a road is fitted through points 2 m apart, as
the library does. Each call goes to the library, whose answer moves the car, and to a `Tracker`: the number of calls
whose command or requests differ in any bit is printed last. Needs gcc.
"""

from __future__ import annotations

import argparse
import copy
import struct
import sys
import tempfile
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from foreign_engines import DELAYS, DWELL, ENGINES, STOPS, Trip, car_sheet, controllers, drive, line, stop_trips

import adaptrack as at
from adaptrack.control.tracker import Status
from adaptrack.export.c_library import export_c
from adaptrack.road.speed import Stop

sys.path[:0] = [str(Path(__file__).parents[1] / "tests" / folder) for folder in ("", "export")]
import test_export_speed as export_speed  # noqa: E402

import exported  # noqa: E402

SPACING, LENGTH = 2.0, 900.0
"""m, of the points of a path, and m, its largest length"""


class CTracker:
    """A tracker of the C library with the interface of `Tracker`, and its twin in Python.

    library: of the controller; points: of the path, (n, 2).
    """

    def __init__(self, library: Any, points: Any, trip: Trip, twin: at.Tracker) -> None:
        self.twin, self.calls, self.differences = twin, 0, 0
        export_speed.PATH, export_speed.PLAN = trip.road, trip.plan
        self.tracker, self.path = export_speed.CSpeedTracker(library), exported.CPath(library.c, points)
        self.plan = export_speed.CPlan(library.c, self.path)
        errors = self.tracker.error, self.path.error, self.plan.error, self.tracker.follow(self.path, self.plan)
        if any(errors):
            raise RuntimeError(f"{trip.name}: tracker, path, plan, follow: the library returned the codes {errors}")

    def step(self, t: float, *motion: float, lateral_velocity: float) -> Any:
        """Result of the library for a sample of `Tracker.step`."""
        answer = self.tracker.step([t, t, *motion, lateral_velocity])
        result = self.twin.step(t, *motion, lateral_velocity=lateral_velocity)
        numbers = [answer.command, *(getattr(answer, name) for name in export_speed.SPEED_REQUEST._fields[:5])]
        expected = [result.command, *result.longitudinal[:5]]
        self.calls += 1
        self.differences += struct.pack("6d", *numbers) != struct.pack("6d", *expected)
        return SimpleNamespace(command=answer.command, status=list(Status)[answer.status], longitudinal=answer)


def fit_road(trip: Trip) -> tuple[Trip, Any]:
    """The trip on a road through points, and the points (n, 2)."""
    length = min(trip.road.length, LENGTH)
    places = trip.road.at(np.linspace(0.0, length, round(length / SPACING) + 1))
    points = np.ascontiguousarray(np.stack([places.x, places.y], axis=-1))
    road = at.road_through(points).replace(grade=(trip.road.grade.s, trip.road.grade.value))
    stops = [Stop(min(s, road.length), DWELL) for s in STOPS]
    top_speed = float(trip.plan.speed.max())
    plan = at.plan_speed(road, car_sheet(), trip.plan.comfort, stops=stops, top_speed=top_speed)
    return replace(trip, road=road, plan=plan), points


def main() -> None:
    """Print a row for each run, and what is lost and what differs in all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--engine", nargs="+", default=["mujoco", "pybullet"], choices=list(ENGINES))
    parser.add_argument("--seeds", type=int, default=3, help="of the noise on each road")
    options = parser.parse_args()
    rows: list[dict[str, Any]] = []
    calls = differences = 0
    for name in options.engine:
        engine, speed_control = ENGINES[name](), at.SpeedControl(car_sheet())
        for trip, points in map(fit_road, stop_trips(1)):
            for label in ("learning", "delay told"):
                with tempfile.TemporaryDirectory() as folder:
                    controller = controllers(DELAYS[name])[label]
                    export_c(controller, folder, road=trip.road, plan=trip.plan, speed=speed_control)
                    library = exported.Exported(Path(folder), controller)
                for k in range(options.seeds):
                    twin = at.Tracker(copy.deepcopy(controller), trip.road, plan=trip.plan, speed=speed_control)
                    tracker = CTracker(library, points, trip, twin)
                    row = {"engine": name, "road": trip.name, "seed": trip.seed + k, "controller": label}
                    run = replace(trip, seed=trip.seed + k)
                    rows.append(row | drive(engine, DELAYS[name], tracker, run, speed_control) | {"learned": None})
                    calls, differences = calls + tracker.calls, differences + tracker.differences
                    print(line(rows[-1]), flush=True)
    errors = np.abs([row["stops"] for row in rows])
    print(f"{sum(row['lost'] is not None for row in rows)} of {len(rows)} lost")
    print(f"largest RMS error of the speed: {max(row['speed'] for row in rows):.3f} m/s")
    print(f"{int(np.sum(errors <= 0.2))} of {errors.size} stops within 0.2 m, largest error {errors.max():.3f} m")
    print(f"{differences} of {calls} calls differ from Python")


if __name__ == "__main__":
    main()

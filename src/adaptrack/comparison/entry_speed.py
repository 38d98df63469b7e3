"""ISO 3888 in closed loop: a controller drives a car through the cones; its highest clean entry speed; its tuning.

At every entry speed of a grid the car follows the line of `driven_line`, off the throttle from the first cones on, once
for each seed of the sensor noise; the worst drive counts.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from adaptrack.base.errors import InvalidInput
from adaptrack.cars.plant import Plant
from adaptrack.cars.vehicle import Vehicle
from adaptrack.comparison.config import load_setting
from adaptrack.comparison.lane_change import (
    CleanSpeed,
    Clearance,
    Track,
    clearance,
    coasting_plan,
    driven_line,
    iso_3888_1,
    iso_3888_2,
    scan_speeds,
)
from adaptrack.control.controllers import Controller
from adaptrack.drive.batch import Batch
from adaptrack.road import Road
from adaptrack.scenario import RoadDrive
from adaptrack.scenario.profile import Profile

Array = NDArray[np.float64]

ENTRY_SEEDS = (0, 1, 2)
"""Of the sensor noise, for the entry speed."""
TUNING_SEEDS = (100, 101, 102)
"""Others, for the tuning."""
POSES_PER_PERIOD = 5
"""Parts of a control period at which the place of the car is interpolated."""

SEARCHED: dict[str, dict[str, tuple[float, ...]]] = {
    "informed": {"Np": (20.0, 30.0, 40.0), "Nc": (10.0, 20.0), "R": (0.3, 1.0, 3.0, 10.0)},
    "lqr": {
        "q_heading": (100.0, 300.0, 1000.0, 3000.0),
        "r": (10.0, 30.0, 100.0, 300.0, 1000.0, 3000.0),
        "preview_time": (0.1, 0.15, 0.2, 0.25, 0.3, 0.4),
    },
    "pure-pursuit": {
        "lookahead_time": (0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 1.0),
        "lookahead_min": (2.0, 3.0, 4.0, 5.0, 6.0),
    },
    "stanley": {
        "gain": (0.5, 1.0, 2.0, 4.0, 8.0, 16.0),
        "yaw_rate_gain": (0.0, 0.05, 0.1, 0.2),
        "dead_time": (0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4),
    },
}
"""What `tune_for_track` tries, by the controller's registered name: all combinations of these tuning entries."""


@dataclass(frozen=True, eq=False)
class LaneChangeTest:
    """A car before a track of cones, in a profile.

    Raises
    ------
    InvalidInput
        When the car does not fit between the cones (by its methods).
    """

    car: Vehicle
    plant: Plant
    track: Track
    profile: Profile
    friction: float = 0.9
    _roads: dict[float, Road] = field(default_factory=dict, repr=False)

    def entering_at(self, speed: float) -> RoadDrive:
        """The drive that enters at a speed (m/s)."""
        if speed not in self._roads:
            road = driven_line(self.track, self.car, speed, self.friction)
            self._roads[speed] = road.replace(friction=self.friction)
        road = self._roads[speed]
        return RoadDrive(road, coasting_plan(self.track, road, self.car, speed))

    def drive(self, controller: Controller, speed: float, tunings: Array, seeds: Sequence[int]) -> Array:
        """Drive with every tuning and seed: (tunings, seeds, places, 3) of x (m), y (m), yaw (rad).

        Compiled. The places between the control instants are cubic in time, from poses and velocities; NaN where the
        run has failed.

        Parameters
        ----------
        speed
            m/s, on entry.
        tunings : (tunings, entries) array
            Of the controller's named entries.
        """
        batch = Batch(self.plant, controller, [self.entering_at(speed)], self.profile)
        rows = np.repeat(batch.checked_tunings(tunings), len(seeds), axis=0)
        seeded = np.tile(np.array(seeds, dtype=np.int64), len(tunings))
        outcome = batch.run(np.zeros(len(rows), np.int64), rows, seeded, 1, traced=True)
        poses = [refined_poses(states, controller.period) for states in outcome.trace.state]
        return np.array(poses).reshape(len(tunings), len(seeds), -1, 3)

    def margins(self, controller: Controller, speed: float, tunings: Array, seeds: Sequence[int]) -> list[Clearance]:
        """The margins to the cones, of the worst seed for each tuning; arguments as for `drive`."""
        worst = []
        for runs in self.drive(controller, speed, tunings, seeds):
            margins = [clearance(self.track, self.car.outline, *poses.T) for poses in runs]
            worst.append(min(margins, key=lambda margin: margin.least))
        return worst


def refined_poses(states: Array, period: float) -> Array:
    """(m, 3) x (m), y (m), yaw (rad) from states (n, >= 6) x, y, yaw, v_x, v_y, yaw rate, a period (s) apart.

    Between two instants each is the cubic with the values and the rates of both ends (Hermite).
    """
    x, y, yaw, vx, vy, rate = states[:, :6].T
    poses = np.stack([x, y, yaw], axis=-1)
    sine, cosine = np.sin(yaw), np.cos(yaw)
    slopes = period * np.stack([vx * cosine - vy * sine, vx * sine + vy * cosine, rate], axis=-1)
    t = (np.arange(POSES_PER_PERIOD) / POSES_PER_PERIOD)[:, None, None]
    before = (1.0 + 2.0 * t) * (1.0 - t) ** 2 * poses[:-1] + t * (1.0 - t) ** 2 * slopes[:-1]
    after = t**2 * (3.0 - 2.0 * t) * poses[1:] + t**2 * (t - 1.0) * slopes[1:]
    inner = np.swapaxes(before + after, 0, 1).reshape(-1, 3)
    return np.concatenate([inner, poses[-1:]])


def tunings_to_try(name: str, controller: Controller) -> Array:
    """(tunings, entries): the controller's own tuning, and with the entries of `SEARCHED` in its place.

    Raises
    ------
    InvalidInput
        For a controller whose search is not known.
    """
    if name not in SEARCHED:
        raise InvalidInput(f"no search for controller {name!r}: one of {', '.join(SEARCHED)}.")
    names, default = list(controller.tuning_names), controller.packed_tuning()
    tunings = [default]
    for values in itertools.product(*SEARCHED[name].values()):
        tuning = default.copy()
        tuning[[names.index(entry) for entry in SEARCHED[name]]] = values
        tunings.append(tuning)
    return np.array(tunings)


def tune_for_track(test: LaneChangeTest, name: str, controller: Controller, speed: float) -> tuple[Array, Clearance]:
    """The tuning with the largest margin of its worst drive at one entry speed, and that margin.

    All of `tunings_to_try`, with the noise of `TUNING_SEEDS`.

    Parameters
    ----------
    name
        The controller's registered name.
    speed
        m/s, on entry.

    Raises
    ------
    InvalidInput
        For a controller whose search is not known.
    """
    tunings = tunings_to_try(name, controller)
    margins = test.margins(controller, speed, tunings, TUNING_SEEDS)
    best = int(np.argmax([margin.least for margin in margins]))
    return tunings[best], margins[best]


@dataclass(frozen=True, eq=False)
class EntrySpeed:
    """How fast one controller enters a track and stays clean."""

    test: LaneChangeTest
    name: str
    """the controller's"""
    tuned: bool
    """for this track, by `tune_for_track`; else its defaults"""
    tuning: dict[str, float]
    scan: CleanSpeed
    poses: Array
    """(seeds, places, 3) x (m), y (m), yaw (rad) at `scan.speed`, or at the lowest speed where none is clean"""

    @property
    def row(self) -> dict[str, Any]:
        """Row for tables and JSON; speeds in km/h, margins in m, None where there is no value."""
        margins = self.scan.clearances.get(self.scan.speed)
        lowest = self.scan.clearances[min(self.scan.clearances)]
        return {
            "vehicle": self.test.car.name,
            "profile": self.test.profile.name,
            "controller": self.name,
            "tuned": self.tuned,
            "clean": _kmh(self.scan.speed),
            "failing": _kmh(self.scan.failing),
            "highest_clean": _kmh(self.scan.highest),
            "margin": None if margins is None else margins.least,
            "lowest_margin": lowest.least if math.isfinite(lowest.least) else None,
            "tuning": self.tuning,
            "margins": [
                {"speed": _kmh(speed), "least": margin.least if math.isfinite(margin.least) else None}
                for speed, margin in sorted(self.scan.clearances.items())
            ],
        }


def _kmh(speed: float) -> float | None:
    return round(3.6 * speed, 6) if math.isfinite(speed) else None


def entry_speed(
    test: LaneChangeTest, name: str, controller: Controller, speeds: Sequence[float], tuning: Array | None = None
) -> EntrySpeed:
    """The highest clean entry speed of a controller, of the worst of `ENTRY_SEEDS`, see `scan_speeds`.

    Parameters
    ----------
    speeds
        m/s, increasing: the grid.
    tuning : (entries,) array, optional
        By default the controller's own.

    Raises
    ------
    InvalidInput
        When the speeds do not increase from above 0, or the parts do not fit each other.
    """
    row = controller.packed_tuning() if tuning is None else tuning
    scan = scan_speeds(lambda speed: test.margins(controller, speed, row[None], ENTRY_SEEDS)[0], speeds)
    drive_speed = scan.speed if math.isfinite(scan.speed) else min(scan.clearances)
    names: Sequence[str] = controller.tuning_names
    return EntrySpeed(
        test, name, tuning is not None, dict(zip(names, row.tolist(), strict=True)), scan,
        test.drive(controller, drive_speed, row[None], ENTRY_SEEDS)[0],
    )  # fmt: skip


class _Grid(NamedTuple):
    """Track and entry speeds of a lane change."""

    track: Callable[[float], Track]
    """from the car's width (m)"""
    speeds: tuple[float, ...]
    """km/h, tried from the lowest up"""
    tuned_at: float
    """km/h, speed that the tuning was searched at"""


LANE_CHANGES = {
    "iso3888-1": _Grid(iso_3888_1, tuple(range(60, 171, 2)), 80.0),
    "iso3888-2": _Grid(iso_3888_2, tuple(range(24, 91)), 45.0),
}
"""By name: the double lane change and the obstacle avoidance."""
DEFAULT_CONTROLLERS = ("informed", "lqr", "pure-pursuit", "stanley")
"""The default controllers of `compare_entry_speeds`."""


def compare_entry_speeds(
    lane_change: str, cars: Sequence[str], profiles: Sequence[str], controllers: Sequence[str] | None = None, *,
    tuned: bool = True, progress: Callable[[str, int, int], None] | None = None,
) -> Iterator[EntrySpeed]:  # fmt: skip
    """`entry_speed` of controllers on cars in profiles, with their default tuning and tuned for the track.

    lane_change: one of `LANE_CHANGES`; cars: see `load_setting`; controllers: registered names, by default
    `DEFAULT_CONTROLLERS`; tuned: whether those in `SEARCHED` are also tuned; progress: called with (work, done, total).

    Raises
    ------
    AdaptrackError
        When a name is unknown, or a plant is not compiled.
    """
    grid = LANE_CHANGES[lane_change]
    speeds = [speed / 3.6 for speed in grid.speeds]
    settings = [load_setting(car, profile) for profile in dict.fromkeys(profiles) for car in dict.fromkeys(cars)]
    names = list(dict.fromkeys(controllers or DEFAULT_CONTROLLERS))
    for i, setting in enumerate(settings):
        if not isinstance(setting.plant, Plant):
            raise InvalidInput(f"{setting.car.name}: a lane change needs a compiled plant, not one in Python.")
        test = LaneChangeTest(setting.car, setting.plant, grid.track(setting.car.outline.width), setting.profile)
        for k, name in enumerate(names):
            if progress is not None:
                progress(f"{setting.car.name}, {name}", i * len(names) + k, len(settings) * len(names))
            controller = setting.controller(name)
            yield entry_speed(test, name, controller, speeds)
            if tuned and name in SEARCHED:
                tuning, _ = tune_for_track(test, name, controller, grid.tuned_at / 3.6)
                yield entry_speed(test, name, controller, speeds, tuning)

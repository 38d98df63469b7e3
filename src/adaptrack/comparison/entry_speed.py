"""Lane changes of ISO 3888 in closed loop: the highest entry speed at which a controller touches no cone.

At every entry speed of a grid the car follows the line of `driven_line` and coasts from the first cones on. It drives
once with each seed of the sensor noise; the worst drive counts.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

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
from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import Array
from adaptrack.drive.batch import Batch
from adaptrack.road import Road
from adaptrack.scenario import RoadDrive
from adaptrack.scenario.profile import Profile

ENTRY_SEEDS = (0, 1, 2)
"""Noise seeds of the drives that determine the entry speed."""
TUNING_SEEDS = (100, 101, 102)
"""Noise seeds of the drives that determine the tuning."""
POSES_PER_PERIOD = 5
"""Number of interpolated poses of the car in each control period."""

SEARCH_GRIDS: dict[str, dict[str, tuple[float, ...]]] = {
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
"""Values of tuning entries, by registered name of the controller. `tune_for_track` tries all their combinations."""


@dataclass(frozen=True, eq=False)
class LaneChangeTest:
    """Lane change of a car on a track of cones, in a profile.

    Raises
    ------
    InvalidInput
        When a method finds that the car does not fit between the cones.
    """

    car: Vehicle
    plant: Plant
    track: Track
    profile: Profile
    friction: float = 0.9
    """Friction coefficient of the road."""

    def entering_at(self, speed: float) -> RoadDrive:
        """Return the drive through the track with an entry speed (m/s)."""
        road = _driven_road(self.track, self.car, speed, self.friction)
        return RoadDrive(road, coasting_plan(self.track, road, self.car, speed))

    def drive(self, controller: Controller, speed: float, tunings: Array, seeds: Sequence[int]) -> Array:
        """Drive through the track at an entry speed (m/s) with every tuning and noise seed of a compiled controller.

        The tunings (tunings, entries) are in the order of `tuning_names`. The result (tunings, seeds, poses, 3)
        contains x (m), y (m), yaw (rad), interpolated by `refined_poses`, with NaN after a failure.
        """
        batch = Batch(self.plant, controller, [self.entering_at(speed)], self.profile)
        rows = np.repeat(batch.controller.checked_tunings(tunings), len(seeds), axis=0)
        noise_seeds = np.tile(np.array(seeds, dtype=np.int64), len(tunings))
        outcome = batch.run(np.zeros(len(rows), np.int64), rows, noise_seeds, 1, traced=True)
        poses = [refined_poses(states, controller.period) for states in outcome.trace.state]
        return np.array(poses).reshape(len(tunings), len(seeds), -1, 3)

    def margins(self, controller: Controller, speed: float, tunings: Array, seeds: Sequence[int]) -> list[Clearance]:
        """Return the clearance of the worst drive of each tuning; arguments as for `drive`."""
        worst = []
        for runs in self.drive(controller, speed, tunings, seeds):
            margins = [clearance(self.track, self.car.outline, *poses.T) for poses in runs]
            worst.append(min(margins, key=lambda margin: margin.least))
        return worst


@lru_cache(maxsize=512)
def _driven_road(track: Track, car: Vehicle, speed: float, friction: float) -> Road:
    """Return the road along `driven_line`, which all profiles and controllers share."""
    return driven_line(track, car, speed, friction).replace(friction=friction)


def refined_poses(states: Array, period: float) -> Array:
    """Interpolate poses between control instants, a period (s) apart, by cubic Hermite splines.

    The states are x, y, yaw, v_x, v_y, yaw rate, ... at n instants, (n, 6 or more), in SI units. The result (m, 3)
    contains x (m), y (m), yaw (rad) at `POSES_PER_PERIOD` instants in each period and at the last instant.
    """
    x, y, yaw, vx, vy, rate = states[:, :6].T
    poses = np.stack([x, y, yaw], axis=-1)
    sine, cosine = portable.sin(yaw), portable.cos(yaw)
    slopes = period * np.stack([vx * cosine - vy * sine, vx * sine + vy * cosine, rate], axis=-1)
    t = (np.arange(POSES_PER_PERIOD) / POSES_PER_PERIOD)[:, None, None]
    before = (1.0 + 2.0 * t) * portable.square(1.0 - t) * poses[:-1] + t * portable.square(1.0 - t) * slopes[:-1]
    after = t * t * (3.0 - 2.0 * t) * poses[1:] + t * t * (t - 1.0) * slopes[1:]
    inner = np.swapaxes(before + after, 0, 1).reshape(-1, 3)
    return np.concatenate([inner, poses[-1:]])


def tunings_to_try(name: str, controller: Controller) -> Array:
    """Return the tuning of a controller, followed by its variants with the values of `SEARCH_GRIDS`.

    The tunings (tunings, entries) are in the order of `tuning_names`. name: registered name of the controller. Raises
    InvalidInput for a controller without an entry in `SEARCH_GRIDS`.
    """
    if name not in SEARCH_GRIDS:
        raise InvalidInput(f"no search for controller {name!r}: one of {', '.join(SEARCH_GRIDS)}.")
    names, variants = list(controller.tuning_names), list(itertools.product(*SEARCH_GRIDS[name].values()))
    tunings = np.tile(controller.packed_tuning(), (1 + len(variants), 1))
    tunings[1:, [names.index(entry) for entry in SEARCH_GRIDS[name]]] = variants
    return tunings


def tune_for_track(test: LaneChangeTest, name: str, controller: Controller, speed: float) -> tuple[Array, Clearance]:
    """Return the tuning with the largest clearance in its worst drive at one entry speed (m/s), and that clearance.

    The candidates are those of `tunings_to_try`, each driven with the noise seeds `TUNING_SEEDS`. name: registered name
    of the controller. Errors as `tunings_to_try`.
    """
    tunings = tunings_to_try(name, controller)
    margins = test.margins(controller, speed, tunings, TUNING_SEEDS)
    best = int(np.argmax([margin.least for margin in margins]))
    return tunings[best], margins[best]


@dataclass(frozen=True, eq=False)
class EntrySpeed:
    """Highest clean entry speed of one controller on a track."""

    test: LaneChangeTest
    name: str
    """Name of the controller."""
    tuned: bool
    """Whether the tuning is that of `tune_for_track`; otherwise it is the default."""
    tuning: dict[str, float]
    """Tuning entries by name."""
    scan: CleanSpeed
    """Clearances at all entry speeds."""
    poses: Array
    """Poses x (m), y (m), yaw (rad) at `scan.speed`, or at the lowest speed if none is clean, (seeds, poses, 3)."""

    @property
    def row(self) -> dict[str, Any]:
        """The row for tables and JSON: speeds in km/h, clearances in m, None for missing values."""
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
    """Return the highest clean entry speed of a controller, in the worst of the drives with `ENTRY_SEEDS`.

    Parameters
    ----------
    test
        Car, plant, track and profile.
    name
        Name of the controller for the result.
    controller
        The controller itself.
    speeds
        Entry speeds to drive (m/s), increasing, see `scan_speeds`.
    tuning
        Tuning in the order of `tuning_names`, (entries,); None for the controller's default.

    Raises
    ------
    InvalidInput
        For speeds that are not positive and increasing, or a controller that cannot drive the car in the profile.
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
    """Function that returns the track for the width of a car (m)."""
    speeds: tuple[float, ...]
    """Entry speeds (km/h), increasing."""
    tuned_at: float
    """Entry speed of the search for a tuning (km/h)."""


LANE_CHANGES = {
    "iso3888-1": _Grid(iso_3888_1, tuple(range(60, 171, 2)), 80.0),
    "iso3888-2": _Grid(iso_3888_2, tuple(range(24, 91)), 45.0),
}
"""Tracks and entry speeds of the double lane change (part 1) and the obstacle avoidance (part 2), by name."""
DEFAULT_CONTROLLERS = ("informed", "lqr", "pure-pursuit", "stanley")
"""The default controllers of `compare_entry_speeds`."""


def compare_entry_speeds(
    lane_change: str, cars: Sequence[str], profiles: Sequence[str], controllers: Sequence[str] | None = None, *,
    tuned: bool = True, progress: Callable[[str, int, int], None] | None = None,
) -> Iterator[EntrySpeed]:  # fmt: skip
    """Yield the `entry_speed` of every controller with every car in every profile.

    Parameters
    ----------
    lane_change
        One of `LANE_CHANGES`.
    cars, profiles
        Cars and profiles in the form of `load_setting`.
    controllers
        Registered names; None for `DEFAULT_CONTROLLERS`.
    tuned
        Whether controllers in `SEARCH_GRIDS` also drive with the result of `tune_for_track`.
    progress
        Function called with (car and controller, combinations done, combinations in all).

    Raises
    ------
    AdaptrackError
        For an unknown name, or a plant that is stepped in Python.
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
            if tuned and name in SEARCH_GRIDS:
                tuning, _ = tune_for_track(test, name, controller, grid.tuned_at / 3.6)
                yield entry_speed(test, name, controller, speeds, tuning)

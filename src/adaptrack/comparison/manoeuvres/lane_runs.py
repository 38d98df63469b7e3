"""Driving the manoeuvres that start beside a path, or meet a step of curvature, in closed loop; their measures."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from adaptrack.cars.outline import Outline
from adaptrack.cars.plant import Plant
from adaptrack.comparison.manoeuvres.start_states import LaneStart
from adaptrack.control.controllers import Controller
from adaptrack.drive.failure import find_failure
from adaptrack.drive.path_metrics import PathMetrics, PathRecord, path_metrics
from adaptrack.drive.simulate import rollout
from adaptrack.scenario import RoadDrive
from adaptrack.scenario.profile import Profile

BAND = 0.1
"""m: a car has settled when its offset stays within it. Ours."""
LAST = 2.0
"""s, at the end of a drive, of which the mean offset is taken."""


@dataclass(frozen=True)
class LaneRun:
    """How one controller drove a manoeuvre, in the worst of its seeds for each measure."""

    start: LaneStart
    metrics: PathMetrics | None
    """of the seed that came furthest out; None when it failed at once"""
    largest_corner: float
    """m, of the outermost corner from the middle of the lane; inf when a drive failed"""
    largest_offset: float
    """m, |e|"""
    crossing: float
    """m, how far e came to the other side of the path than it first was on"""
    settling_time: float
    """s, from which on |e| is within `BAND`; NaN when it does not stay there, or a drive failed"""
    last_offset: float
    """m, mean e over the last `LAST` s, the largest magnitude"""
    largest_acceleration: float
    """m/s^2, sideways"""
    failed: str | None

    @property
    def passed(self) -> bool:
        """Whether no corner passed the limit."""
        return self.failed is None and self.largest_corner <= self.start.limit

    @property
    def row(self) -> dict[str, Any]:
        """By name, for tables and JSON; what is not finite is None."""
        values = {
            "largest_corner": self.largest_corner,
            "limit": self.start.limit,
            "largest_offset": self.largest_offset,
            "crossing": self.crossing,
            "settling_time": self.settling_time,
            "last_offset": self.last_offset,
            "largest_acceleration": self.largest_acceleration,
        }
        plain: dict[str, Any] = {name: each if math.isfinite(each) else None for name, each in values.items()}
        measures = None if self.metrics is None else self.metrics.to_dict()
        return plain | {"passed": self.passed, "failed": self.failed, "metrics": measures}


def drive_lane_start(
    start: LaneStart, plant: Plant, controller: Controller, outline: Outline, profile: Profile,
    seeds: Sequence[int] = (0, 1, 2),
) -> LaneRun:  # fmt: skip
    """Drive a manoeuvre of `start_states`, compiled, once for each seed of the sensor noise.

    Raises
    ------
    InvalidInput
        When the parts do not fit each other, or one of them needs Python at every step.
    """
    drive = RoadDrive(start.road, start.speed, start_offset=start.offset, start_heading=start.heading_error)
    records: list[PathRecord] = []
    failed = None
    for seed in seeds:
        run = rollout(plant, controller, drive, profile=profile, seed=seed)
        found, record = find_failure(run), PathRecord.from_trajectory(run)
        failed = found.reason if found is not None else failed
        if record is not None:
            records.append(record)
    measured = [path_metrics(each, outline) for each in records]
    worst = max(measured, key=lambda each: each.max_corner, default=None)
    unusable = failed is not None or worst is None
    return LaneRun(
        start=start,
        metrics=worst,
        largest_corner=math.inf if unusable or worst is None else worst.max_corner,
        largest_offset=max((each.max_offset for each in measured), default=math.inf),
        crossing=max((crossing(each) for each in records), default=math.inf),
        settling_time=math.nan if unusable else float(np.max([settling_time(each) for each in records])),
        last_offset=max((last_offset(each) for each in records), key=abs, default=math.inf),
        largest_acceleration=max((each.max_acceleration for each in measured), default=math.inf),
        failed=failed,
    )


def settling_time(record: PathRecord, band: float = BAND) -> float:
    """The time (s) from which on |e| <= band (m) to the end; NaN when not at the end."""
    outside = np.flatnonzero(np.abs(record.offset) > band)
    if outside.size == 0:
        return 0.0
    last = int(outside[-1])
    return math.nan if last + 1 >= record.t.size else float(record.t[last + 1] - record.t[0])


def crossing(record: PathRecord) -> float:
    """How far (m) e came to the side of the path on which it was not when it was largest; 0: never there."""
    side = math.copysign(1.0, record.offset[np.argmax(np.abs(record.offset))])
    return max(0.0, float(np.max(-side * record.offset)))


def last_offset(record: PathRecord, last: float = LAST) -> float:
    """The mean e (m) over the last seconds."""
    return float(np.mean(record.offset[record.t >= record.t[-1] - last]))

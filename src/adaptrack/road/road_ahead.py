"""Roads as the kernels read them, and the road ahead of a car as a controller sees it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import Any

import numpy as np

from adaptrack.base.checked import real, reals
from adaptrack.base.errors import InvalidInput, format_value
from adaptrack.core.maths.portable import Array
from adaptrack.core.roads import road as kernel
from adaptrack.core.roads.path import cells_of
from adaptrack.road.road import Projection, Road


def pack_roads(roads: Sequence[Road | None]) -> Any:
    """The roads of scenarios, None for a straight one, as `core.roads.road.Roads`; equal ones are kept once."""
    packed = list(dict.fromkeys(road for road in roads if road is not None))
    of = np.array([-1 if road is None else packed.index(road) for road in roads], np.int64)
    numbers = np.zeros((len(packed), len(kernel.LINE_NUMBERS)))
    tables = [(np.zeros(0), np.zeros((0, kernel.PIECE_COLUMNS)), np.zeros(0))]
    places = np.zeros(3)
    for k, road in enumerate(packed):
        line, cells = road.packed(), cells_of(road.length)
        headings = np.empty(cells + 1)
        kernel.headings_along(line, headings)
        numbers[k] = (*line.numbers, places[0], places[1], len(line.pieces), places[2], road.length / cells)
        tables.append((line.start, line.pieces, headings))
        places += [len(table) for table in tables[-1]]
    return kernel.Roads(of, numbers, *map(np.concatenate, zip(*tables, strict=True)))


@lru_cache(maxsize=16)
def stacked(road: Road | None) -> Any:
    """A road alone as `core.roads.road.Roads`; None: a straight one."""
    return pack_roads([road])


def foot_near(road: Road, x: float, y: float, near: float) -> Projection:
    """The foot of one point, as numbers, as by `Road.project`; the offset is NaN where there is none about `near`."""
    foot = np.empty((1, 4))
    kernel.project_all(road.packed(), np.array([[x, y, near]]), foot)
    return Projection(*foot[0].tolist())


@dataclass(frozen=True, eq=False)
class RoadAhead:
    """The road from the foot of a car on: what a controller sees of it.

    Raises
    ------
    InvalidInput
        When the station is not finite or the speeds are empty or not finite.
    """

    road: Road
    station: float
    """m, arc length of the foot"""
    speeds: Array
    """(n,) m/s, at which the road will be passed, now and at the control instants that follow; the last one holds"""

    def __post_init__(self) -> None:
        if not isinstance(self.road, Road):
            raise InvalidInput(f"RoadAhead: road = {format_value(self.road)}: must be a Road.")
        station, speeds = real("RoadAhead", "station", self.station), np.atleast_1d(reals("speeds", self.speeds))
        if not math.isfinite(station):
            raise InvalidInput(f"RoadAhead: station = {self.station!r} m: must be finite.")
        if speeds.ndim != 1 or not speeds.size or not np.isfinite(speeds).all():
            raise InvalidInput("RoadAhead: speeds must be finite numbers (m/s), one for each instant.")
        object.__setattr__(self, "station", station)
        object.__setattr__(self, "speeds", np.ascontiguousarray(speeds))

    @property
    def packed(self) -> Any:
        """The centre line, the foot and the speeds, `core.roads.road.RoadAheadRecord`."""
        return kernel.RoadAheadRecord(self.road.packed(), self.station, self.speeds)

    def bend(self, count: int, speed: float, delay: float, period: float) -> Array:
        """(count,) m, how far the road lies to the left of its tangent here: after `delay` periods, then every period.

        speed: m/s, of the model; delay: in periods; period: s; see `core.roads.road.bend_ahead`.
        """
        curvatures = np.zeros(count)
        kernel.bend_ahead(self.station, self.speeds, speed, delay, period, 0, stacked(self.road), curvatures)
        return curvatures

    def points(self, offsets: Array, speed: float, delay: float, period: float) -> Array:
        """(n, 2) m, where a car will be at so many offsets (n,) m from the road: 1, 2, ... periods after the delay.

        Other arguments as for `bend`.
        """
        coordinates = np.zeros(2 * len(offsets))
        kernel.points_ahead(self.station, self.speeds, speed, delay, period, self.road.packed(), offsets, coordinates)
        return coordinates.reshape(-1, 2)


@cache
def straight() -> Any:
    """`core.roads.road.RoadAheadRecord` of a straight road."""
    line = kernel.Centreline(np.zeros(0), np.zeros((0, kernel.PIECE_COLUMNS)), np.zeros(0))
    return kernel.RoadAheadRecord(line, 0.0, np.zeros(0))

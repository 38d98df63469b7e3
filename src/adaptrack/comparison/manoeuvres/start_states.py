"""Manoeuvres that are a road and a state to start from: a step of curvature, lane drift, lane recovery."""

from __future__ import annotations

import math
from dataclasses import dataclass

from adaptrack.base.checked import real
from adaptrack.base.errors import InvalidInput
from adaptrack.cars.outline import Outline
from adaptrack.drive.path_metrics import LANE_WIDTH
from adaptrack.road import Arc, Line, Road

BEFORE = 50.0
"""m, straight road before a step of curvature."""
BEND_ACCELERATION = 3.0
"""m/s^2, in the arc behind a step of curvature, where no speed is given."""
DRIFT_SPEED = 20.0
"""m/s, 72 km/h: the speed of Euro NCAP's tests of lane support."""
BEYOND = 0.3
"""m, by which the outline may pass the edge of its lane after a drift."""


@dataclass(frozen=True)
class LaneStart:
    """A drive that starts off the middle of its lane.

    The criterion is how far the outermost corner may be from the middle of the lane at any time:
    `path_metrics.PathMetrics.max_corner` must not be larger than `limit`.
    """

    name: str
    road: Road
    speed: float
    """m/s"""
    offset: float
    """m, of the centre of mass from the middle of the lane at the start, positive to the left"""
    heading_error: float
    """rad, at the start"""
    limit: float
    """m, largest distance of the outermost corner from the middle of the lane that passes"""
    source: str
    """whose speed and limit these are"""

    @property
    def start(self) -> tuple[float, float, float]:
        """x (m), y (m) and yaw (rad) of the centre of mass at the start of the road."""
        pose = self.road.at(0.0)
        heading = float(pose.heading)
        return (
            float(pose.x) - self.offset * math.sin(heading),
            float(pose.y) + self.offset * math.cos(heading),
            heading + self.heading_error,
        )


def curvature_step(radius: float, *, left: bool = True, turn: float = math.pi / 2.0) -> Road:
    """A straight line of 50 m that meets an arc: curvature jumps from 0 to 1/R. Ours; no standard asks for it.

    radius: m; turn: rad, of the arc.

    Raises
    ------
    InvalidInput
        When a value is not positive and finite.
    """
    for name, value in (("radius", radius), ("turn", turn)):
        if not 0.0 < real("curvature_step", name, value) < math.inf:
            raise InvalidInput(f"curvature_step: {name} = {value!r}: must be positive and finite.")
    curvature = (1.0 if left else -1.0) / radius
    return Road.from_segments(
        [Line(length=BEFORE), Arc(length=turn * radius, curvature=curvature)], name=f"curvature-step-{radius:g}m"
    )


def curvature_step_start(radius: float = 50.0, *, speed: float | None = None) -> LaneStart:
    """A car that meets a step of curvature, on the path. Ours: it passes when no corner leaves a lane of 3.5 m.

    radius: m; speed: m/s, by default that of 3 m/s^2 in the arc.

    Raises
    ------
    InvalidInput
        When a value is not positive and finite.
    """
    road = curvature_step(radius)
    entry = math.sqrt(BEND_ACCELERATION * radius) if speed is None else real("curvature_step", "speed", speed)
    if not 0.0 < entry < math.inf:
        raise InvalidInput(f"curvature_step: speed = {speed!r} m/s: must be positive and finite.")
    return LaneStart("curvature-step", road, entry, 0.0, 0.0, 0.5 * LANE_WIDTH, "ours")


def lane_drift(
    outline: Outline, lateral_speed: float = 0.5, *, speed: float = DRIFT_SPEED, lane_width: float = LANE_WIDTH
) -> LaneStart:
    """A car that drifts out of its lane to the left: its front left corner is at the edge when control begins.

    After Euro NCAP's tests of lane keeping (Test Protocol, Lane Support Systems, version 2.0.2, November 2018): not
    more than 0.3 m beyond the line. The protocol could be read in its table of contents only; the 0.3 m are from a
    report about it, 72 km/h and lateral speeds of 0.2 to 0.5 m/s by memory. There the outer edge of a front wheel
    counts, here the corner of the outline. Ours: control begins at the edge.

    Parameters
    ----------
    lateral_speed, speed
        m/s
    lane_width
        m

    Raises
    ------
    InvalidInput
        When the lateral speed is not positive and below the speed, or the car is wider than the lane.
    """
    if not 0.0 < real("lane_drift", "lateral_speed", lateral_speed) < real("lane_drift", "speed", speed) < math.inf:
        raise InvalidInput(f"lane_drift: lateral_speed = {lateral_speed!r} m/s: must be above 0 and below {speed!r}.")
    turned = math.asin(lateral_speed / speed)
    reach = float(outline.corner_offsets(0.0, turned)[0])
    offset = 0.5 * real("lane_drift", "lane_width", lane_width) - reach
    if offset <= 0.0:
        raise InvalidInput(f"lane_drift: lane_width = {lane_width!r} m: the car needs more than {2 * reach:.2f} m.")
    road = Road.from_segments([Line(length=20.0 * speed)], width_left=0.5 * lane_width, width_right=0.5 * lane_width)
    return LaneStart(
        "lane-drift",
        road.replace(name="lane-drift"),
        speed,
        offset,
        turned,
        0.5 * lane_width + BEYOND,
        "after Euro NCAP Lane Support Systems 2.0.2 (2018), as reported",
    )


def lane_recovery(
    outline: Outline, offset: float = 1.0, heading_error: float = math.radians(20.0), *, speed: float = 10.0
) -> LaneStart:
    """A car that engages beside its path, pointing away from it. Ours: it passes when no corner leaves a 7 m road.

    offset: m, positive to the left; heading_error: rad; speed: m/s.

    Raises
    ------
    InvalidInput
        When the speed is not positive.
    """
    if not 0.0 < real("lane_recovery", "speed", speed) < math.inf:
        raise InvalidInput(f"lane_recovery: speed = {speed!r} m/s: must be positive and finite.")
    half = 2.0 * LANE_WIDTH
    road = Road.from_segments([Line(length=20.0 * speed)], width_left=half, width_right=half)
    return LaneStart("lane-recovery", road.replace(name="lane-recovery"), speed, offset, heading_error, half, "ours")

"""What a learning agent observes at a control instant: what the sensors give, and the road ahead."""

from __future__ import annotations

import math

from ..kernel import Place, columns, exported, inlined, record, vector, void
from ..maths.bits import whole
from ..maths.exact import clip, floor
from ..models.contract import MEASUREMENT
from ..roads.road import line_of, point_at
from .run import RunRecord
from .world import SIGNAL

OBSERVATION = columns(
    "offset",  # m, measured y less y_ref
    "heading_error", "yaw_rate", "speed", "wheel_angle",  # rad, rad/s, m/s, rad, as measured
    "command",  # rad, the last one
    "pose_age",  # s, how old offset and heading error are
)  # fmt: skip
"""Columns of an observation; then, at each distance ahead, by how much (m) the reference will have moved to the left
when the car comes there at its present speed, and the curvature (1/m) of the road there."""
MIN_APPROACH_SPEED = 1.0
"""m/s, the speed at least with which the car is taken to come to what lies ahead."""

ObservationSpace = record("ObservationSpace", (("distances", vector), ("low", vector), ("high", vector)))
"""Distances (m) of the preview; bounds of all columns, to which an observation is clipped."""


@inlined
def keep(value, row, column):
    """Write a value; one that is missing leaves that before."""
    if math.isfinite(value):
        row[column] = value


@inlined
def bounded(row, space):
    """Clip a row to its bounds."""
    for j in range(row.size):
        row[j] = clip(row[j], space.low[j], space.high[j])


@inlined
def write_observation(slot, run, space, row):
    """Write the observation of a slot to a row, from what is measured.

    The row holds the observation of the instant before, zeros at the first one.
    """
    drive, scenario, period = run.memory.drives[slot], run.inputs.scenario[slot], run.settings.period
    measured = run.measured[slot]
    references, road = run.inputs.signals[scenario, SIGNAL.y_ref], run.inputs.roads.of[scenario]
    k, last = drive.instant, references.size - 1
    y_ref = references[k]
    posed = math.isfinite(measured[MEASUREMENT.y]) and math.isfinite(measured[MEASUREMENT.yaw])
    row[OBSERVATION.pose_age] = measured[MEASUREMENT.pose_age] if posed else row[OBSERVATION.pose_age] + period
    keep(measured[MEASUREMENT.y] - y_ref, row, OBSERVATION.offset)
    keep(measured[MEASUREMENT.yaw], row, OBSERVATION.heading_error)
    keep(measured[MEASUREMENT.yaw_rate], row, OBSERVATION.yaw_rate)
    keep(measured[MEASUREMENT.wheel_angle], row, OBSERVATION.wheel_angle)
    keep(drive.speed, row, OBSERVATION.speed)
    row[OBSERVATION.command] = drive.command
    count = space.distances.size
    for j in range(count):
        instant = k + space.distances[j] / (max(row[OBSERVATION.speed], MIN_APPROACH_SPEED) * period)
        near = min(whole(instant), last)
        reference, following = references[near], references[min(near + 1, last)]
        row[len(OBSERVATION) + j] = reference + (instant - floor(instant)) * (following - reference) - y_ref
        curvature = 0.0
        if road >= 0:
            _, _, _, curvature = point_at(drive.station_estimate + space.distances[j], line_of(road, run.inputs.roads))
        keep(curvature, row, len(OBSERVATION) + count + j)
    bounded(row, space)


@exported(void(Place(RunRecord), Place(ObservationSpace), vector))
def write_one_observation(run, space, row):
    """`write_observation`, of the only slot."""
    write_observation(0, run, space, row)

"""What a learning agent sees at a control instant: what the sensors give, and the road ahead."""

from __future__ import annotations

import math

from .kernel import (
    Place,
    columns,
    cube,
    exported,
    float64,
    inlined,
    int64,
    int_vector,
    matrix,
    record,
    rows,
    vector,
    void,
)
from .loop import SETTINGS, SIGNAL, Memory
from .maths.bits import whole
from .maths.exact import clip, floor
from .models.contract import MEASURED
from .road import Roads, line_of, point_at

SEEN = columns(
    "offset",  # m, measured y less y_ref
    "heading_error", "yaw_rate", "speed", "wheel_angle",  # rad, rad/s, m/s, rad, as measured
    "command",  # rad, the last one
    "pose_age",  # s, how old offset and heading error are
)  # fmt: skip
"""Columns of what is seen; then, at each distance ahead, by how much (m) the reference will have moved to the left when
the car comes there at its present speed, and the curvature (1/m) of the road there."""
SLOWEST = 1.0
"""m/s, the speed at least with which the car is taken to come to what lies ahead."""

Scene = record("Scene", (("settings", rows(SETTINGS)), ("signals", cube), ("roads", Roads), ("scenario", int_vector)))
"""The world, samples and roads of the scenarios, and which of them each slot drives."""

Sight = record("Sight", (("distances", vector), ("low", vector), ("high", vector)))
"""Distances (m) at which one looks ahead; bounds of all columns, to which what is seen is clipped."""


@inlined
def keep(value, row, column):
    """Write a value; one that is missing leaves that before."""
    if math.isfinite(value):
        row[column] = value


@inlined
def bounded(row, sight):
    """Clip a row to its bounds."""
    for j in range(row.size):
        row[j] = clip(row[j], sight.low[j], sight.high[j])


@inlined
def see(k, slot, speed, measured, scene, memory, sight, seen):
    """Write the row of `seen` of a slot at instant k, from what is measured; speed: m/s, as measured.

    The row holds what was seen an instant before, zeros at the first one.
    """
    own, scenario, row = memory.own[slot], scene.scenario[slot], seen[slot]
    period, last = scene.settings[0].period, scene.signals.shape[2] - 1
    y_ref = scene.signals[scenario, SIGNAL.y_ref, k]
    posed = math.isfinite(measured[MEASURED.y]) and math.isfinite(measured[MEASURED.yaw])
    row[SEEN.pose_age] = measured[MEASURED.pose_age] if posed else row[SEEN.pose_age] + period
    keep(measured[MEASURED.y] - y_ref, row, SEEN.offset)
    keep(measured[MEASURED.yaw], row, SEEN.heading_error)
    keep(measured[MEASURED.yaw_rate], row, SEEN.yaw_rate)
    keep(measured[MEASURED.wheel_angle], row, SEEN.wheel_angle)
    keep(speed, row, SEEN.speed)
    row[SEEN.command] = own.command
    count = sight.distances.size
    for j in range(count):
        instant = k + sight.distances[j] / (max(row[SEEN.speed], SLOWEST) * period)
        near = min(whole(instant), last)
        reference = scene.signals[scenario, SIGNAL.y_ref, near]
        following = scene.signals[scenario, SIGNAL.y_ref, min(near + 1, last)]
        row[len(SEEN) + j] = reference + (instant - floor(instant)) * (following - reference) - y_ref
        curvature = 0.0
        if scene.roads.of[scenario] >= 0:
            _, _, _, curvature = point_at(
                own.station + sight.distances[j], line_of(scene.roads.of[scenario], scene.roads)
            )
        keep(curvature, row, len(SEEN) + count + j)
    bounded(row, sight)


@exported(void(int64, int64, float64, vector, Scene, Place(Memory), Place(Sight), matrix))
def see_one(k, slot, speed, measured, scene, memory, sight, seen):
    """`see`, for Python."""
    see(k, slot, speed, measured, scene, memory, sight, seen)

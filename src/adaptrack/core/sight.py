"""What a learning agent sees at a control instant: what the sensors give, and the road ahead."""

from __future__ import annotations

import math

from .kernel import Place, columns, exported, inlined, record, vector, void
from .loop import SIGNAL
from .maths.bits import whole
from .maths.exact import clip, floor
from .models.contract import MEASURED
from .period import Loop
from .road import line_of, point_at

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
def see(slot, measured, run, sight, row):
    """Write the row of what is seen of a slot, from what is measured.

    The row holds what was seen an instant before, zeros at the first one.
    """
    own, scenario, period = run.memory.own[slot], run.given.scenario[slot], run.settings.period
    references, road = run.given.signals[scenario, SIGNAL.y_ref], run.given.roads.of[scenario]
    k, last = own.instant, references.size - 1
    y_ref = references[k]
    posed = math.isfinite(measured[MEASURED.y]) and math.isfinite(measured[MEASURED.yaw])
    row[SEEN.pose_age] = measured[MEASURED.pose_age] if posed else row[SEEN.pose_age] + period
    keep(measured[MEASURED.y] - y_ref, row, SEEN.offset)
    keep(measured[MEASURED.yaw], row, SEEN.heading_error)
    keep(measured[MEASURED.yaw_rate], row, SEEN.yaw_rate)
    keep(measured[MEASURED.wheel_angle], row, SEEN.wheel_angle)
    keep(own.speed, row, SEEN.speed)
    row[SEEN.command] = own.command
    count = sight.distances.size
    for j in range(count):
        instant = k + sight.distances[j] / (max(row[SEEN.speed], SLOWEST) * period)
        near = min(whole(instant), last)
        reference, following = references[near], references[min(near + 1, last)]
        row[len(SEEN) + j] = reference + (instant - floor(instant)) * (following - reference) - y_ref
        curvature = 0.0
        if road >= 0:
            _, _, _, curvature = point_at(own.station + sight.distances[j], line_of(road, run.given.roads))
        keep(curvature, row, len(SEEN) + count + j)
    bounded(row, sight)


@exported(void(Place(Loop), Place(Sight), vector))
def see_one(run, sight, row):
    """`see`, of the only slot."""
    see(0, run.measured, run, sight, row)

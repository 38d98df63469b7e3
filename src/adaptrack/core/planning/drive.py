"""A drive along a road at the control instants: the samples that a run reads, and where it begins."""

from __future__ import annotations

from ..kernel import exported, float64, inlined, int64, matrix, record, vector, void
from ..maths.bits import ROUNDER, whole
from ..maths.exact import floor
from ..maths.trigonometric import cos, sin
from ..physics.forces import GRAVITY
from ..roads.road import Centreline, point_at
from ..simulation.world import SIGNAL
from ..speed.plan import SpeedPlanRecord, motion_at
from .station_table import Route, on_lap, value_at

LOOK_AHEAD = 3.0
"""s, how far ahead the scheduling variables `change` and `acceleration` look."""
MIN_INSTANTS = 2
"""Instants that they look ahead at least: a second derivative needs three."""

RoadDriveRecord = record(
    "RoadDriveRecord",
    (
        ("route", Route), ("plan", SpeedPlanRecord), ("period", float64), ("reference", vector), ("wind_x", vector),
        ("wind_y", vector),
    ),
)  # fmt: skip
"""A drive along a road from its start. period: s; reference: m, offset from the centre line to follow; wind: m/s, in
the world: of each a number for every instant, or one for all."""


@exported(int64(float64, int64, float64))
def drive_periods(duration, laps, period):
    """How many whole control periods (s) laps of a duration (s) last; their samples are one more."""
    return whole(floor(duration * laps / period)) if period > 0.0 else 0


@inlined
def instant(k, period):
    """s: k/f where the period is 1/f, f whole, so that the third is 0.3 s, not 0.30000000000000004."""
    rate = 1.0 / period
    near = (rate + ROUNDER) - ROUNDER
    return k / near if near >= 1.0 and 1.0 / near == period else k * period


@exported(void(float64, vector))
def drive_instants(period, times):
    """Write the instants 0, 1, ... (s)."""
    for k in range(times.size):
        times[k] = instant(k, period)


@inlined
def _value_at(values, k):
    """The value at an instant, of one for each or one for all."""
    return values[k] if values.size > 1 else values[0]


@exported(void(RoadDriveRecord, matrix))
def drive_along_road(drive, samples):
    """Write what happens at the instants 0, 1, ... to `SIGNAL`'s rows of samples, as `complete_samples` reads them."""
    _, count = samples.shape
    for k in range(count):
        station, speed = motion_at(instant(k, drive.period), drive.plan)
        place = on_lap(station, drive.route.line)
        _, _, _, curvature = point_at(station, drive.route.line)
        friction = value_at(place, drive.route.friction)
        samples[SIGNAL.y_ref, k], samples[SIGNAL.speed, k] = _value_at(drive.reference, k), speed
        for wheel in range(4):
            samples[SIGNAL.friction_front_left + wheel, k] = friction
        samples[SIGNAL.wind_x, k], samples[SIGNAL.wind_y, k] = _value_at(drive.wind_x, k), _value_at(drive.wind_y, k)
        samples[SIGNAL.bank, k], samples[SIGNAL.station, k] = value_at(place, drive.route.bank), station
        samples[SIGNAL.acceleration, k], samples[SIGNAL.grade, k] = curvature, value_at(place, drive.route.grade)


@exported(void(vector))
def bank_pull(banks):
    """Replace banks (rad) by the pull of the road to the left (m/s^2)."""
    for k in range(banks.size):
        banks[k] = GRAVITY * sin(banks[k])


# -- what lies ahead --------------------------------------------------------------------------------------------------
@inlined
def _reference_at(k, reference):
    """m, at an instant; beyond the last one it goes straight on."""
    last = reference.size - 1
    if k <= last:
        return reference[k]
    return reference[last] + (reference[last] - reference[last - 1] if last > 0 else 0.0) * (k - last)


@exported(void(float64, vector, vector, vector))
def reference_ahead(period, reference, change, acceleration):
    """Write the scheduling variables `change` (m) and `acceleration` (m/s^2) at the first instants.

    The largest |y(t + s) - y(t)|, and the largest second difference of y over the period squared, up to `LOOK_AHEAD`
    from an instant. reference: y (m) at the instants; beyond its end it goes straight on.
    """
    ahead = max(MIN_INSTANTS, whole((LOOK_AHEAD / period + ROUNDER) - ROUNDER))
    for k in range(change.size):
        first, second = _reference_at(k, reference), _reference_at(k + 1, reference)
        largest, bend, slope = abs(second - first), 0.0, second - first
        for j in range(2, ahead + 1):
            other = _reference_at(k + j, reference)
            largest = max(largest, abs(other - first))
            bend = max(bend, abs(other - second - slope))
            second, slope = other, other - second
        change[k], acceleration[k] = largest, bend / (period * period)


@exported(void(float64, matrix))
def complete_samples(period, samples):
    """Complete samples of which bank (rad), grade and, as `acceleration`, the road's curvature (1/m) are given.

    Banks become their pull (m/s^2). Friction and wind are known as they are, the mean of the wheels and to the side.
    Acceleration ahead is that of the reference and, beside it, v^2 |curvature|.
    """
    bank_pull(samples[SIGNAL.bank])
    _, count = samples.shape
    lateral = samples[SIGNAL.known_friction]  # until it is written
    for k in range(count):
        lateral[k] = abs(samples[SIGNAL.acceleration, k]) * (samples[SIGNAL.speed, k] * samples[SIGNAL.speed, k])
    reference_ahead(period, samples[SIGNAL.y_ref], samples[SIGNAL.change], samples[SIGNAL.acceleration])
    for k in range(count):
        samples[SIGNAL.acceleration, k] += lateral[k]
        friction = 0.0
        for wheel in range(4):
            friction += samples[SIGNAL.friction_front_left + wheel, k]
        samples[SIGNAL.known_friction, k] = friction / 4.0
        samples[SIGNAL.known_wind, k] = samples[SIGNAL.wind_y, k]


@exported(void(RoadDriveRecord, matrix))
def drive_samples(drive, samples):
    """Write a drive's samples (`SIGNAL`, n + 1)."""
    drive_along_road(drive, samples)
    complete_samples(drive.period, samples)


@exported(void(Centreline, float64, float64, vector))
def drive_start(line, offset, turned, pose):
    """Write x, y (m) and yaw (rad) at the start of a road: an offset (m) to the left of it, turned (rad) against it."""
    x, y, heading, _ = point_at(0.0, line)
    pose[0], pose[1], pose[2] = x - offset * sin(heading), y + offset * cos(heading), heading + turned

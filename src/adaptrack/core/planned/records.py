"""Records of a planner that is followed: points, nodes, settings and memory."""

from __future__ import annotations

from ..kernel import Field, columns, matrix, record, rows, vector

POINT = columns(
    Field("t", "s", 0.0, "time of arrival after the stamp; never decreases"),
    Field("x", "m", 0.0, "of the tracked point"),
    Field("y", "m", 0.0, "of the tracked point"),
    Field("yaw", "rad", float("nan"), "of the car; NaN: unknown"),
    Field("speed", "m/s", float("nan"), "along the car, negative backwards; NaN: unknown"),
    Field("acceleration", "m/s^2", float("nan"), "dv/dt; NaN: unknown"),
    Field("curvature", "1/m", float("nan"), "of the path, positive to the left; NaN: unknown"),
)
"""A point of a planned trajectory, as the planner specifies it."""

NODE = columns(
    "x", "y",  # m, of the centre of mass
    "arrive", "leave",  # s, on the tracker's clock: times of arrival and departure, which differ at a rest
    "speed",  # m/s
)  # fmt: skip
"""A place of a conditioned trajectory, at least `condition.MERGING_DISTANCE` from the next."""

PlannedSpeeds = record("PlannedSpeeds", (("s", vector), ("speed", vector), ("arrive", vector), ("leave", vector)))
"""Speeds and times of a trajectory at ascending arc lengths (m) of its path. The square of the speed (m/s) is linear
between them; arrivals and departures are in s on the tracker's clock. Empty: no trajectory."""

PLANNED_SETTINGS = record("PlannedSettings", (
    Field("silence", "s", 0.5, "time without an accepted trajectory, after which the planner counts as silent",
          "(0, 60]"),
    Field("oldest", "s", 1.0, "largest age of a stamp on arrival; older trajectories are refused", "(0, 60]"),
    Field("fallback_age", "s", 3.0, "largest age of a fallback", "(0, 600]"),
    Field("catch_up", "1/s", 0.4, "speed correction for each metre between the car and its planned place; 0: lateness "
          "is ignored", "[0, 1]"),
    Field("speed_limit", "m/s", float("nan"), "largest speed to catch up; unknown: the largest planned speed nearby",
          "(0, 100]"),
    Field("clock_offset", "s", float("nan"), "tracker's clock minus planner's clock; unknown: 0 while stamps are in "
          "the accepted range, else the least delay of arrivals", "(-inf, inf)"),
    Field("tracked_arm", "m", 0.0, "from the centre of mass forwards to the tracked point"),
    Field("period", "s", 0.05, "control period"),
))  # fmt: skip
"""Settings for following a planner."""

(NOBODY, PLANNER, FALLBACK, STOP) = range(4)
"""Source of the motion: no trajectory yet; the planner; its fallback; a stop along the last trajectory."""

PLANNED_MEMORY = record(
    "PlannedMemory",
    (
        "driven_by",  # `NOBODY`, `PLANNER`, `FALLBACK` or `STOP`
        "late",  # s, lateness of the car; negative: early; NaN: unknown place or time
        "correction",  # m/s, to add to the planned speeds so that the car reaches its place for the time
        "top_speed",  # m/s, largest speed to catch up
        "target_speed",  # m/s, planned one period ahead, corrected; NaN: unknown place
        "debt",  # s, lateness that is accepted: the times of the trajectory count so much later
        "is_leaving",  # 1: the time to leave the present place of rest has come
        "rest_time",  # s, until then; 0: the trajectory does not rest here; infinite at its end
        # clock of the planner:
        "clock_offset",  # s, tracker's clock minus planner's, estimated from arrivals; NaN: that of the settings
        "stamp",  # s, of the last trajectory, on the planner's clock
        "arrival",  # s, of the last trajectory, on the tracker's clock
        "other_stamps", "other_offset",  # -, s: stamps in a row that agree with a new clock, and its offset
        "checksum",  # of the points of the last trajectory
        # replans:
        "disagreed",  # trajectories in a row that disagree with the followed line
        "returned",  # trajectories in a row that fit the car, since the planner fell silent
        # start of the trajectory, see `meant_line`:
        "meant_offset", "given_offset",  # m, of the car from the intended line; mean size of that from new ones
        "hidden",  # s, for which both have contradicted each other
        "far_count",  # number of places in `far`
    ),
    integers=("driven_by", "is_leaving", "other_stamps", "disagreed", "returned", "far_count"),
)  # fmt: skip
"""Memory of a tracker for its planner."""

Planned = record(
    "Planned",
    (
        ("settings", rows(PLANNED_SETTINGS)),  # (1,); empty: there is no planner
        ("memory", rows(PLANNED_MEMORY)),  # (1,); empty: there is no planner
        ("speeds", PlannedSpeeds),  # of the followed trajectory
        ("points", matrix),  # (n, 3) x, y and arc length (m) of the points of its path
        ("far", vector),  # m, x and y of places of the intended line, see `meant_line`
    ),
)
"""A planner that is followed: settings, memory and the followed trajectory."""

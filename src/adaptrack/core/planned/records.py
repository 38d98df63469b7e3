"""What a tracker knows, remembers and answers of a planner: records of numbers."""

from __future__ import annotations

from ..kernel import Field, columns, matrix, record, rows, vector

GIVEN = columns(
    Field("t", "s", 0.0, "when the car is to be there, after the stamp; never falls"),
    Field("x", "m", 0.0, "of the tracked point"),
    Field("y", "m", 0.0, "of the tracked point"),
    Field("yaw", "rad", float("nan"), "of the car; NaN: not given"),
    Field("speed", "m/s", float("nan"), "along the car, negative backwards; NaN: not given"),
    Field("acceleration", "m/s^2", float("nan"), "dv/dt; NaN: not given"),
    Field("curvature", "1/m", float("nan"), "of the path, positive to the left; NaN: not given"),
)
"""A point of a planned trajectory, as it is given."""

NODE = columns(
    "x",
    "y",  # m, of the centre of mass
    "arrive",
    "leave",  # s, on the tracker's clock: they differ where the car is to stand
    "speed",  # m/s
)  # fmt: skip
"""A place of a conditioned trajectory. Places are at least `condition.MERGING_DISTANCE` apart."""

PlannedSpeeds = record("PlannedSpeeds", (("s", vector), ("speed", vector), ("arrive", vector), ("leave", vector)))
"""What a trajectory asks for along its path: ascending arc lengths (m), speeds (m/s) between which the square is
straight, and when to arrive there and to leave (s, on the tracker's clock). Empty: no trajectory."""

PLANNED_SETTINGS = record("PlannedSettings", (
    Field("silence", "s", 0.5, "without a trajectory that is accepted, after which the planner counts as silent",
          "(0, 60]"),
    Field("oldest", "s", 1.0, "age of a stamp on arrival, from which on a trajectory is refused", "(0, 60]"),
    Field("fallback_age", "s", 3.0, "age from which on a fallback is stale", "(0, 600]"),
    Field("catch_up", "1/s", 0.4, "gain on the way between the car and its place by the time; 0: lateness is ignored",
          "[0, 1]"),
    Field("speed_limit", "m/s", float("nan"), "that catching up never exceeds; unknown: the largest planned speed near "
          "the place", "(0, 100]"),
    Field("clock_offset", "s", float("nan"), "to add to the planner's stamps for the tracker's clock; unknown: 0 while "
          "stamps are in time, else the least delay of arrivals", "(-inf, inf)"),
    Field("tracked_arm", "m", 0.0, "from the centre of mass forwards to the point that follows the path"),
    Field("position_noise", "m", 0.0, "standard deviation of a measured position"),
    Field("period", "s", 0.05, "control period"),
))  # fmt: skip
"""How a planner is followed."""

(NOBODY, PLANNER, FALLBACK, STOP) = range(4)
"""Who drives: no trajectory yet; the planner; its fallback; nobody, so that the car stops along the last trajectory."""

PLANNED_MEMORY = record(
    "PlannedMemory",
    (
        "driven_by",  # one of the above
        "late",  # s, by which the car is behind the trajectory; negative: early; NaN: without a place or a time
        "correction",  # m/s, of the planned speeds, towards the place that the time asks for
        "top_speed",  # m/s, that catching up never exceeds
        "target_speed",  # m/s, planned one period ahead, corrected; NaN: no place to go by
        "debt",  # s, of lateness that is no longer made up for: the times of the trajectory count so much later
        "is_leaving",  # 1: the time to leave the present place of rest has come
        # clock of the planner:
        "clock_offset",  # s, to add to its stamps, where it is found from arrivals; NaN: that of the settings
        "stamp",  # s, of the last trajectory that was taken, on its own clock
        "arrival",  # s, of it
        "other_stamps", "other_offset",  # -, s: stamps in a row that fit another clock, and its offset
        "checksum",  # of its points
        # replans:
        "disagreed",  # trajectories in a row that do not agree with the line that is followed
        "returned",  # fresh trajectories in a row since the planner fell silent
        # where the trajectory begins, see `meant_line`:
        "meant_offset", "given_offset",  # m, of the car from the line that earlier ones meant, and from this one
        "hidden",  # s, for which they have contradicted each other
        "far_count",  # places in `far`
    ),
    integers=("driven_by", "is_leaving", "other_stamps", "disagreed", "returned", "far_count"),
)  # fmt: skip
"""What a tracker remembers of a planner."""

Planned = record(
    "Planned",
    (
        ("settings", rows(PLANNED_SETTINGS)),  # (1,); empty: there is no planner
        ("memory", rows(PLANNED_MEMORY)),  # likewise
        ("speeds", PlannedSpeeds),  # of the trajectory that is followed
        ("points", matrix),  # (n, 3) x, y, and arc length (m) of the points through which its path was made
        ("far", vector),  # x, y (m) of places that earlier trajectories meant, one behind the other
    ),
)
"""A planner that is followed."""

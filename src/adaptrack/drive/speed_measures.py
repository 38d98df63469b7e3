"""Measures of how a car followed the speed plan of a road, and of its stops."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from adaptrack.core.maths import portable
from adaptrack.core.public import GRAVITY, STANDING_SPEED
from adaptrack.drive.failure import MIN_JUDGED_SPEED
from adaptrack.drive.signal_statistics import finite_length, mean_square, r79
from adaptrack.drive.trajectory import Trajectory
from adaptrack.road import Road, SpeedPlan

SPEED_MEASURES = {
    "time_lost": "s", "way_driven": "-", "speed_error": "m/s", "longitudinal_jerk": "m/s^3", "used_grip": "-",
    "stop_error": "m",
}  # fmt: skip
"""Measures of `speed_measures` with their units."""
STOP_DISTANCE = 8.0
"""Largest distance from a stop at which a standing car stops for it, and error of a stop that is passed (m)."""


class StopMeasure(NamedTuple):
    """A stop of the plan that the car reached."""

    place: float
    """Station of the stop (m), over all laps."""
    seconds: float
    """Planned time at rest (s)."""
    error: float
    """Station where the car first stood minus that of the stop (m); NaN: it passed without standing."""
    stood: float
    """Time at rest (s)."""


def speed_measures(run: Trajectory, road: Road, plan: SpeedPlan) -> dict[str, Any]:
    """Return how a car followed the speed plan of a road, up to the end of its run or its failure.

    Returns
    -------
    dict
        None for a measure that does not exist:

        - `time_lost`: delay at the place where the run ends (s);
        - `way_driven`: distance at the end of the run, relative to the planned distance;
        - `speed_error`: RMS of the difference from the speed planned for the place (m/s), where this is 1 m/s or more;
        - `longitudinal_jerk`: largest longitudinal jerk by UN R79 (m/s^3);
        - `used_grip`: largest acceleration of the centre of gravity divided by true friction times gravity;
        - `stop_error`: largest distance from a stop at which the car first stood (m), `STOP_DISTANCE` without standing.
    """
    end = finite_length(run.road["station"], run.vx, run.lateral_acceleration)
    if end < 2:
        return dict.fromkeys(SPEED_MEASURES)
    t, station, speed = run.t[:end], run.road["station"][:end], run.vx[:end]
    planned_speed = plan.at(station)
    is_judged = planned_speed >= MIN_JUDGED_SPEED
    acceleration = np.gradient(speed, t) - run.vy[:end] * run.yaw_rate[:end]
    grip = GRAVITY * road.along("friction", station)
    laps, place = divmod(float(station[-1]), road.length) if road.closed else (0.0, float(station[-1]))
    planned_time = laps * plan.duration + float(np.interp(place, plan.s, plan.time))
    stop_errors = [STOP_DISTANCE if math.isnan(stop.error) else abs(stop.error) for stop in measure_stops(run, plan)]
    return {
        "time_lost": float(t[-1] - planned_time),
        "way_driven": float(station[-1] / plan.motion(t[-1])[0]),
        "speed_error": math.sqrt(mean_square((speed - planned_speed)[is_judged])) if is_judged.any() else None,
        "longitudinal_jerk": r79(t, acceleration)[1],
        "used_grip": float(np.max(portable.hypot(acceleration, run.lateral_acceleration[:end]) / grip)),
        "stop_error": max(stop_errors, default=None),
    }


def measure_stops(run: Trajectory, plan: SpeedPlan) -> list[StopMeasure]:
    """Return the stops of a plan that the car reached on all laps, by place."""
    end = finite_length(run.road["station"], run.vx, run.lateral_acceleration)
    if not end or not plan.stops:
        return []
    station, speed, length, stops = run.road["station"][:end], run.vx[:end], float(plan.s[-1]), []
    for lap in range(max(1, math.ceil(station[-1] / length)) if plan.closed else 1):
        for stop in plan.stops:
            place = stop.s + lap * length
            is_standing = (speed < STANDING_SPEED) & (np.abs(station - place) < STOP_DISTANCE)
            stood = float(np.count_nonzero(is_standing)) * run.period
            if is_standing.any():
                stops.append(StopMeasure(place, stop.seconds, float(station[is_standing.argmax()]) - place, stood))
            elif station[-1] > place + STOP_DISTANCE:
                stops.append(StopMeasure(place, stop.seconds, math.nan, stood))
    return stops

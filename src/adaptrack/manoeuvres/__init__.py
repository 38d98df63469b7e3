"""Manoeuvres of the standards: open-loop tests of a plant, lane-change tracks, start states beside a path."""

from adaptrack.manoeuvres.lane_change import (
    TRACKS,
    CleanSpeed,
    Clearance,
    Gate,
    Track,
    clearance,
    coasting_plan,
    highest_clean_speed,
    iso_3888_1,
    iso_3888_2,
    track_road,
)
from adaptrack.manoeuvres.open_loop import Motion, Surroundings, drive_open_loop
from adaptrack.manoeuvres.sine_with_dwell import SineWithDwell, sine_with_dwell
from adaptrack.manoeuvres.start_states import LaneStart, curvature_step, lane_drift, lane_recovery
from adaptrack.manoeuvres.steady_circle import SteadyCircle, steady_circle
from adaptrack.manoeuvres.transient import FrequencyResponse, StepSteer, frequency_response, step_steer

__all__ = [
    "TRACKS",
    "CleanSpeed",
    "Clearance",
    "FrequencyResponse",
    "Gate",
    "LaneStart",
    "Motion",
    "SineWithDwell",
    "SteadyCircle",
    "StepSteer",
    "Surroundings",
    "Track",
    "clearance",
    "coasting_plan",
    "curvature_step",
    "drive_open_loop",
    "frequency_response",
    "highest_clean_speed",
    "iso_3888_1",
    "iso_3888_2",
    "lane_drift",
    "lane_recovery",
    "sine_with_dwell",
    "steady_circle",
    "step_steer",
    "track_road",
]

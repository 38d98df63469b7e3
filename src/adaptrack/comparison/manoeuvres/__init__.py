"""Manoeuvres of the standards: open-loop tests of a plant, lane-change tracks, start states beside a path."""

from adaptrack.comparison.manoeuvres.entry_speed import (
    EntrySpeed,
    LaneChangeTest,
    entry_speed,
    entry_speeds,
    tune_for_track,
)
from adaptrack.comparison.manoeuvres.lane_change import (
    TRACKS,
    CleanSpeed,
    Clearance,
    Gate,
    Track,
    clearance,
    coasting_plan,
    driven_line,
    highest_clean_speed,
    iso_3888_1,
    iso_3888_2,
    scan_speeds,
    track_road,
)
from adaptrack.comparison.manoeuvres.lane_runs import LaneRun, drive_lane_start
from adaptrack.comparison.manoeuvres.open_loop import Motion, Surroundings, drive_open_loop
from adaptrack.comparison.manoeuvres.sine_with_dwell import SineWithDwell, sine_with_dwell
from adaptrack.comparison.manoeuvres.start_states import (
    LaneStart,
    curvature_step,
    curvature_step_start,
    lane_drift,
    lane_recovery,
)
from adaptrack.comparison.manoeuvres.steady_circle import SteadyCircle, steady_circle
from adaptrack.comparison.manoeuvres.transient import FrequencyResponse, StepSteer, frequency_response, step_steer

__all__ = [
    "TRACKS",
    "CleanSpeed",
    "Clearance",
    "EntrySpeed",
    "FrequencyResponse",
    "Gate",
    "LaneChangeTest",
    "LaneRun",
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
    "curvature_step_start",
    "drive_lane_start",
    "drive_open_loop",
    "driven_line",
    "entry_speed",
    "entry_speeds",
    "frequency_response",
    "highest_clean_speed",
    "iso_3888_1",
    "iso_3888_2",
    "lane_drift",
    "lane_recovery",
    "scan_speeds",
    "sine_with_dwell",
    "steady_circle",
    "step_steer",
    "track_road",
    "tune_for_track",
]

"""Scenarios: reference, speed, friction and wind of a test drive. Load them by name or file, or build them."""

from adaptrack.scenario.library import list_scenarios, load_scenario, scenario_options
from adaptrack.scenario.random_drives import random_drive
from adaptrack.scenario.road_drive import RoadDrive
from adaptrack.scenario.scenario import CONTROL_PERIOD, Scenario
from adaptrack.scenario.shapes import (
    SHAPE_TYPES,
    Constant,
    Gust,
    Knots,
    LaneChange,
    Patch,
    Shape,
    Sine,
    Step,
    Sum,
    TanhSteps,
    Wind,
    as_shape,
)
from adaptrack.scenario.signals import Signals

__all__ = [
    "CONTROL_PERIOD", "SHAPE_TYPES",
    "Constant", "Gust", "Knots", "LaneChange", "Patch", "RoadDrive", "Scenario", "Shape", "Signals", "Sine", "Step",
    "Sum", "TanhSteps", "Wind",
    "as_shape", "list_scenarios", "load_scenario", "random_drive", "scenario_options",
]  # fmt: skip

"""Roads: a centre line by arc length, what lies along it, and how fast a car can drive it."""

from adaptrack.road.axle_path import convert_axle_path
from adaptrack.road.check import Finding, check_road, smallest_radius
from adaptrack.road.fit import fit_road, road_through, smooth_road
from adaptrack.road.generate import ROAD_KINDS, generate_road
from adaptrack.road.load import load_road
from adaptrack.road.opendrive import read_opendrive
from adaptrack.road.road import Jump, Projection, Road
from adaptrack.road.segments import Arc, Clothoid, Cubic, Line, Points, Pose
from adaptrack.road.speed import Comfort, SpeedPlan, Stop, plan_speed
from adaptrack.road.station_table import Along

__all__ = [
    "ROAD_KINDS",
    "Along", "Arc", "Clothoid", "Comfort", "Cubic", "Finding", "Jump", "Line", "Points", "Pose", "Projection", "Road",
    "SpeedPlan", "Stop",
    "check_road", "convert_axle_path", "fit_road", "generate_road", "load_road", "plan_speed", "read_opendrive",
    "road_through", "smallest_radius", "smooth_road",
]  # fmt: skip

"""Follow a planner: settings, verdicts on its trajectories, and their conversion to a road with a plan."""

from __future__ import annotations

import math
from enum import StrEnum
from typing import Any, Literal, NamedTuple

import numpy as np

from adaptrack.base.errors import InvalidInput
from adaptrack.cars.vehicle import Vehicle
from adaptrack.control.controllers import Controller
from adaptrack.control.settings import RecordSettings
from adaptrack.core.kernel import OK, fields_of
from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import Array
from adaptrack.core.planned import condition, records
from adaptrack.core.planned.clock import VERDICT
from adaptrack.core.planned.meant_line import FAR_PLACES
from adaptrack.core.planned.records import NODE
from adaptrack.core.roads.path import line_in
from adaptrack.core.tracker import planner as kernel
from adaptrack.road import Comfort, Line, Road, SpeedPlan, Stop, convert_axle_path
from adaptrack.road.axle_path import Axle
from adaptrack.road.planned_trajectory import PlannedTrajectory
from adaptrack.road.speed import DEFAULT_COMFORT
from adaptrack.road.table import Pieces


class Verdict(StrEnum):
    """Verdict on a trajectory."""

    TAKEN = "taken"
    SAME = "same"
    OLDER = "older"
    STALE = "stale"
    EARLY = "early"
    SILENT = "silent"
    WAITING = "waiting"
    UNFIT = "unfit"


class DrivenBy(StrEnum):
    """Source that decides where the car goes and how fast."""

    NOBODY = "nobody"
    """no trajectory yet, or a path without times"""
    PLANNER = "planner"
    """the newest trajectory of the planner"""
    FALLBACK = "fallback"
    """the trajectory to rest that the planner has sent for the case of its silence"""
    STOP = "stop"
    """the tracker: the car stops along its last trajectory"""


VERDICTS, DRIVERS = tuple(Verdict), tuple(DrivenBy)
_VERDICT_LINES = (f"- `{field.name}`: {field.meaning}" for field in fields_of(VERDICT))
Verdict.__doc__ = "\n".join(["Verdict on a trajectory.", "", *_VERDICT_LINES])
WHO_DRIVES = (
    ("trajectories arrive", "any", DrivenBy.PLANNER, "as the trajectory does"),
    ("silence", "valid", DrivenBy.FALLBACK, "at rest at the end of the fallback; the car stays there"),
    ("silence", "stale, unfit, none", DrivenBy.STOP, "comfort stop along the last trajectory; the car stays there"),
    ("one or two arrive again", "any", "as before", "as before"),
    ("the third in a row", "any", DrivenBy.PLANNER, "as the trajectory does"),
    ("a driver at the pedals", "any", "as before", "the requests follow the driver, then the rows above"),
    ("no position", "any", "as before", "the speeds go on over the way driven; then as without a planner"),
    ("a path is followed", "any", DrivenBy.NOBODY, "as the path does"),
    ("`engage`", "any", DrivenBy.PLANNER, "along the last trajectory; silence counts from then on"),
)
"""Rows of docs/planner.md and of the C header: the event, the fallback then, who drives, and how that ends."""


CarPoint = Literal["centre of mass"] | Axle
"""Point of the car to which positions refer."""


def arm_of(name: str, point: str, car: Vehicle | None) -> float:
    """Distance (m) from the centre of mass forwards to a point of a car; raises `InvalidInput` for an unknown car."""
    if point == "centre of mass":
        return 0.0
    if car is None:
        raise InvalidInput(
            f"{name} = {point!r}: the controller has no car whose axles are known; use a controller with "
            "a car, or give the centre of mass."
        )
    return -car.lr if point == "rear axle" else car.lf


class Following(RecordSettings, record=records.PLANNED_SETTINGS):
    """Settings for following paths and the trajectories of a planner.

    `tracked_point` is the point of the car that follows them. All other settings are for trajectories: `comfort` limits
    the accelerations that reduce lateness, and those of stops without a fallback.
    """

    tracked_point: CarPoint = "centre of mass"
    comfort: Comfort = DEFAULT_COMFORT


class FollowedPlan(NamedTuple):
    """Speeds (m/s) at arc lengths (m) along the path of a trajectory, with its stops, for a speed control."""

    s: Array
    speed: Array
    stops: tuple[Stop, ...]
    comfort: Comfort


class TrajectoryAnswer(NamedTuple):
    """Verdict on a trajectory, with its line and plan."""

    verdict: Verdict
    arrival: Any
    """of the trajectory, `core.tracker.planner.Arrival`"""
    road: Road | None = None
    """line of the trajectory; None: it is not followed"""
    plan: FollowedPlan | None = None


class PlannerFollower:
    """Converter of trajectories for a tracker, with the newest trajectory and the fallback."""

    def __init__(self, following: Following, controller: Controller) -> None:
        self.following, self._car = following, controller.vehicle
        arm = arm_of("tracked_point", following.tracked_point, controller.vehicle)
        settings = records.PLANNED_SETTINGS.new(1)
        settings[0] = following.row
        settings["tracked_arm"], settings["period"] = arm, controller.period
        memory, speeds = records.PLANNED_MEMORY.new(1), records.PlannedSpeeds(*(np.zeros(0),) * 4)
        self.planned = records.Planned(settings, memory, speeds, np.zeros((0, 3)), np.zeros(2 * FAR_PLACES))
        self.fallback: tuple[PlannedTrajectory, float] | None = None
        """fallback and its time of arrival (s)"""

    def convert_path(self, path: Road, plan: SpeedPlan | None) -> tuple[Road, SpeedPlan | None]:
        """The path and plan of the centre of mass where the tracked point follows a path and plan."""
        point = self.following.tracked_point
        return (path, plan) if point == "centre of mass" else convert_axle_path(path, plan, self._car, point)

    def standing_plan(self) -> tuple[Road, FollowedPlan]:
        """A path of a metre and its plan, for a speed control before the first trajectory."""
        plan = FollowedPlan(np.array([0.0, 1.0]), np.full(2, 0.1), (), self.following.comfort)
        return Road.from_segments([Line(length=1.0)]), plan

    def fresh_fallback(self, time: float) -> PlannedTrajectory | None:
        """The fallback at a time (s); None if there is none or it is stale."""
        if self.fallback is None or time - self.fallback[1] > self.following.fallback_age:
            return None
        return self.fallback[0]

    @staticmethod
    def check_fallback(fallback: PlannedTrajectory) -> None:
        """Refuse a fallback that does not end at rest."""
        if not len(fallback.nodes) or fallback.nodes[-1, NODE.leave] < math.inf:
            raise InvalidInput("Tracker.follow: fallback: it must end at rest, with a speed of 0 at its last point.")

    def take(
        self, trajectory: PlannedTrajectory, time: float, role: int, friction: float, tracker: Any
    ) -> TrajectoryAnswer:
        """Convert a trajectory that arrives at a time (s) for a tracker (resident).

        friction: low end of the estimate, for a fallback; NaN: unknown. Raises InvalidInput when the trajectory is
        impossible.
        """
        rows = trajectory.points
        length = float(portable.hypot(*np.diff(rows[:, 1:3], axis=0).T).sum())
        buffer = np.empty(kernel.trajectory_words(len(rows), len(self.planned.points), length))
        parts = np.empty(len(kernel.PARTS), np.int64)
        arrival = kernel.Arrival(trajectory.stamp, time, role, int(trajectory.urgent))
        verdict, status, _ = kernel.take_trajectory(rows, arrival, friction, tracker, buffer, parts)
        if status not in (OK, condition.REVERSE_AHEAD):
            raise InvalidInput(f"Tracker.follow: {trajectory!r}: no line can be made of its places: they fold back.")
        if VERDICTS[verdict] is not Verdict.TAKEN:
            return TrajectoryAnswer(VERDICTS[verdict], arrival)
        point_count, place_count, stop_count, speeds_at, room, stops_at, path_at = parts.tolist()
        speeds = records.PlannedSpeeds(*buffer[speeds_at : speeds_at + 4 * room].reshape(4, room)[:, :place_count])
        self.planned = self.planned._replace(speeds=speeds, points=buffer[: 3 * point_count].reshape(point_count, 3))
        line, _ = line_in(buffer[path_at:])
        road = Road(name="trajectory", table=Pieces(line.start.copy(), line.pieces.copy()), closed=False)
        stops = tuple(Stop(s, math.inf) for s in buffer[stops_at : stops_at + stop_count].tolist())
        plan = FollowedPlan(speeds.s, speeds.speed, stops, self.following.comfort)
        return TrajectoryAnswer(Verdict.TAKEN, arrival, road, plan)

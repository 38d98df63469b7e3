"""Following a planner: how its trajectories are taken in, and what is followed of them."""

from __future__ import annotations

import math
from enum import StrEnum
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from adaptrack.base.errors import InvalidInput
from adaptrack.cars.vehicle import Vehicle
from adaptrack.control.controllers import Controller
from adaptrack.control.settings import RecordSettings
from adaptrack.core.kernel import OK
from adaptrack.core.maths import portable
from adaptrack.core.planned import condition, records
from adaptrack.core.planned.meant_line import FAR_PLACES
from adaptrack.core.planned.records import NODE
from adaptrack.core.roads.path import line_in
from adaptrack.core.tracker import planner as kernel
from adaptrack.road import Comfort, Line, Road, Stop
from adaptrack.road.planned_trajectory import PlannedTrajectory
from adaptrack.road.speed import DEFAULT_COMFORT
from adaptrack.road.table import Pieces

Array = NDArray[np.float64]


class Verdict(StrEnum):
    """What became of a trajectory."""

    TAKEN = "taken"
    """it is followed"""
    SAME = "same"
    """it is the one that is followed, with a new stamp"""
    OLDER = "older"
    """its stamp is older than that of the one that is followed"""
    STALE = "stale"
    """its stamp is older than `Following.oldest`, or of another clock"""
    EARLY = "early"
    """its stamp lies more than 0.1 s in the future, or is of another clock"""
    SILENT = "silent"
    """it has no points"""
    WAITING = "waiting"
    """the planner was silent: it drives again after three trajectories in a row that begin at the car"""
    UNFIT = "unfit"
    """a fallback does not begin at the car, or asks for more grip than is assumed"""


class DrivenBy(StrEnum):
    """Who decides where the car goes and how fast."""

    NOBODY = "nobody"
    """no trajectory yet, or a path without times"""
    PLANNER = "planner"
    FALLBACK = "fallback"
    """the trajectory that the planner has left for this case; it ends at rest"""
    STOP = "stop"
    """nobody: the car stops along its last trajectory"""


VERDICTS, DRIVERS = tuple(Verdict), tuple(DrivenBy)
WHO_DRIVES = (
    ("trajectories arrive", "any", DrivenBy.PLANNER, "as the trajectory does"),
    ("silence", "valid", DrivenBy.FALLBACK, "at rest at the end of the fallback; the car stays there"),
    ("silence", "stale, unfit, none", DrivenBy.STOP, "comfort stop along the last trajectory; the car stays there"),
    ("one or two arrive again", "any", "as before", "as before"),
    ("the third in a row", "any", DrivenBy.PLANNER, "as the trajectory does"),
    ("a driver at the pedals", "any", "as before", "the requests follow the driver, then the rows above"),
    ("no position", "any", "as before", "the speeds go on over the way driven; then as without a planner"),
    ("a path is followed", "any", DrivenBy.NOBODY, "as the path does"),
)
"""Rows of docs/planner.md and of the C header: the event, the fallback then, who drives, and how that ends."""


CarPoint = Literal["centre of mass", "rear axle", "front axle"]
"""A point of the car whose places are given."""


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
    """How a planner's trajectories are followed.

    `tracked_point` is the point of the car whose places a trajectory states; `comfort` limits the accelerations that
    make up for lateness, and stops without a fallback.
    """

    tracked_point: CarPoint = "centre of mass"
    comfort: Comfort = DEFAULT_COMFORT


class FollowedPlan(NamedTuple):
    """Speeds along the path of a trajectory, as a speed control takes them."""

    s: Array
    speed: Array
    stops: tuple[Stop, ...]
    comfort: Comfort


class Taken(NamedTuple):
    """What became of a trajectory, and what is followed of it."""

    verdict: Verdict
    arrival: Any
    """`core.tracker.planner.Arrival`"""
    road: Road | None = None
    """its line; None: it is not followed"""
    plan: FollowedPlan | None = None


class PlannerFollower:
    """Takes in trajectories for a tracker, and keeps the newest one and its fallback."""

    def __init__(self, following: Following, controller: Controller) -> None:
        self.following, arm = following, arm_of("tracked_point", following.tracked_point, controller.vehicle)
        settings = records.PLANNED_SETTINGS.new(1)
        settings[0] = following.row
        settings["tracked_arm"], settings["position_noise"] = arm, controller.position_noise
        settings["period"] = controller.period
        memory, speeds = records.PLANNED_MEMORY.new(1), records.PlannedSpeeds(*(np.zeros(0),) * 4)
        self.planned = records.Planned(settings, memory, speeds, np.zeros((0, 3)), np.zeros(2 * FAR_PLACES))
        self.fallback: tuple[PlannedTrajectory, float] | None = None
        """a fallback, and when it arrived (s)"""

    def standing_plan(self) -> tuple[Road, FollowedPlan]:
        """A path of a metre and its plan, for a speed control before the first trajectory."""
        plan = FollowedPlan(np.array([0.0, 1.0]), np.full(2, 0.1), (), self.following.comfort)
        return Road.from_segments([Line(length=1.0)]), plan

    def fresh_fallback(self, now: float) -> PlannedTrajectory | None:
        """The fallback, unless there is none, or it is stale at a time (s)."""
        if self.fallback is None or now - self.fallback[1] > self.following.fallback_age:
            return None
        return self.fallback[0]

    @staticmethod
    def check_fallback(fallback: PlannedTrajectory) -> None:
        """Refuse a fallback that does not end at rest."""
        if not len(fallback.nodes) or fallback.nodes[-1, NODE.leave] < math.inf:
            raise InvalidInput("Tracker.follow: fallback: it must end at rest, with a speed of 0 at its last point.")

    def take(self, trajectory: PlannedTrajectory, now: float, role: int, friction: float, tracker: Any) -> Taken:
        """Take a trajectory in at a time (s), for a tracker (resident); friction: low end now, for a fallback.

        Raises
        ------
        InvalidInput
            When the trajectory is impossible.
        """
        given, kept = trajectory.given, len(self.planned.points)
        length = float(portable.hypot(*np.diff(given[:, 1:3], axis=0).T).sum())
        memory = np.empty(kernel.trajectory_words(len(given), kept, length))
        parts = np.empty(len(kernel.PARTS), np.int64)
        arrival = kernel.Arrival(trajectory.stamp, now, role, int(trajectory.urgent))
        verdict, status, _ = kernel.take_trajectory(given, arrival, friction, tracker, memory, parts)
        if status not in (OK, condition.REVERSE_AHEAD):
            raise InvalidInput(f"Tracker.follow: {trajectory!r}: no line can be made of its places: they fold back.")
        if VERDICTS[verdict] is not Verdict.TAKEN:
            return Taken(VERDICTS[verdict], arrival)
        points, speeds, stops, speeds_at, room, stops_at, path_at = parts.tolist()
        columns = (memory[speeds_at + k * room :][:speeds] for k in range(4))
        self.planned = self.planned._replace(
            speeds=records.PlannedSpeeds(*columns), points=memory[: 3 * points].reshape(points, 3)
        )
        line, _ = line_in(memory[path_at:])
        road = Road(name="trajectory", table=Pieces(line.start.copy(), line.pieces.copy()), closed=False)
        standing = tuple(Stop(s, math.inf) for s in memory[stops_at:][:stops].tolist())
        plan = FollowedPlan(self.planned.speeds.s, self.planned.speeds.speed, standing, self.following.comfort)
        return Taken(Verdict.TAKEN, arrival, road, plan)

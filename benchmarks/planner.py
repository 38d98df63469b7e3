"""Drives behind a planner whose trajectories do not fit: what each kind of mismatch costs against one fixed path.

    python benchmarks/planner.py [--cases i ii ... ix swerve] [--drives 10] [--cars sedan van sheet] [--profiles road]
    python benchmarks/planner.py --tracker before      each trajectory as a new path and plan, without its times
    python benchmarks/planner.py --tracker autoware-spatial | autoware-temporal     with examples/plugins in PYTHONPATH

Seed 5711 reports (roads, sensors and planners of all drives follow from it); seeds 5700 to 5710 were for choosing. Each
drive of a car and profile has its own road, in turn of a country, a town and mountains, at up to 15 m/s. The controller
of `sheet` knows mass and wheelbase of the sedan alone, and learns. RMS: root mean square of the offset from the line
that was meant (m), from 3 s on; in brackets over that of the informed MPC along one fixed path with the same noise. Of
other measures the table has the mean over the drives and, in brackets, the largest.
"""

from __future__ import annotations

import argparse
import logging
import math
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import cache, partial
from importlib import import_module
from itertools import product
from typing import Any, NamedTuple

import numpy as np

import adaptrack as at
from adaptrack.base.errors import InvalidInput
from adaptrack.cars.data_sheet import vehicle_from_data_sheet
from adaptrack.control.following import Following
from adaptrack.control.kalman import Drifts
from adaptrack.core.planned.records import POINT
from adaptrack.core.planned.timing import LIMIT_TIME, LIMIT_WAY
from adaptrack.core.tracker.signals import TRACKER_SAMPLE
from adaptrack.drive.planner import Arrivals, PlannedController, SimulatedPlanner, arrival_times
from adaptrack.road import Arc, Comfort, Line, Road, SpeedPlan, plan_speed
from adaptrack.road.planned_trajectory import PlannedTrajectory
from adaptrack.road.speed import constant_speed

REPORTED_SEED = 5711
SECONDS, TOP_SPEED, SETTLED = 45.0, 15.0, 3.0  # s, m/s, s
KINDS, LENGTH = ("country", "town", "mountain"), 400.0
"""Of generated roads; m."""
COMFORT = Comfort(lateral=2.5, accelerate=1.5, brake=2.0)
CARS = {"sedan": "midsize-sedan", "van": "van", "sheet": "midsize-sedan"}
PROFILES = ("road", "production")
EVENT = 15.0
"""s, at which a planner falls silent or brakes."""
HARD_BRAKING, FALLBACK_BRAKING = 6.0, 2.5  # m/s^2
PLANNERS_APART, BEHIND_CLOCK = 0.3, 2.0  # m, s
HIGHER_LIMIT = 18.0
"""m/s, up to which a car may catch up."""
SLOWEST = 0.3
"""m/s, to which a hesitating planner slows down."""
BEND_RADIUS, BEND_SPEED, WIND = 60.0, 10.0, 12.0  # m, m/s, m/s
STEERING_BIAS = 0.02  # rad
SWERVE, SWERVE_SECONDS = 1.0, 1.5  # m, s
LEAST_OFFSET, OFFSET_SECONDS, DETECTION = 0.15, 3.0, 5.0
"""m, s: a true offset from the line that was meant that is to be reported; s, within which."""
REST, ARRIVED = 0.05, 0.05
"""m/s, below which a car stands; m, before the place where it ends, from which it has arrived."""


# -- cars and roads ---------------------------------------------------------------------------------------------------
class Group(NamedTuple):
    """A car as the controller knows it, and a profile."""

    car: str
    profile: str

    @property
    def vehicle(self) -> at.Vehicle:
        """The true car."""
        return at.load_vehicle(CARS[self.car])

    @property
    def known(self) -> at.Vehicle:
        """What the controller knows of it."""
        car = self.vehicle
        return vehicle_from_data_sheet(car.name, car.mass, car.wheelbase) if self.car == "sheet" else car

    def controller(self, with_drifts: bool = True) -> at.MPC:
        """The controller; with_drifts: whether its estimator estimates bias and side force."""
        learning = {"learning": at.Learning()} if self.car == "sheet" else {}
        mpc = at.MPC(self.known, profile=self.profile, **learning)
        if with_drifts:
            return mpc
        plain = replace(mpc.estimator, drifts=Drifts(side=0.0, turn=0.0, wind=0.0), spread=(0.0, 0.0))
        return at.MPC(self.known, profile=self.profile, estimator=plain, **learning)


@cache
def winding(seed: int, is_slow: bool = False) -> at.RoadDrive:
    """A road with its plan; is_slow: one that twice falls to `SLOWEST`."""
    car = at.load_vehicle("midsize-sedan")
    road = at.generate_road(KINDS[seed % len(KINDS)], seed=seed, length=LENGTH)
    if is_slow:
        s = np.array([0.0, 149.0, 150.0, 151.0, 152.0, 299.0, 300.0, 301.0, 302.0, road.length])
        limit = np.full(s.size, TOP_SPEED)
        limit[[2, 3, 6, 7]] = SLOWEST
        road = road.replace(speed_limit=(s, limit))
    else:
        road = road.replace(speed_limit=None)
    return at.RoadDrive(road, plan_speed(road, car, COMFORT, top_speed=TOP_SPEED))


@cache
def bend(turn: int, wind: float = 0.0) -> at.RoadDrive:
    """A straight and a long bend to one side (-1 or 1), or with a side wind (m/s) a straight alone."""
    length = SECONDS * BEND_SPEED
    elements = [Line(length=80.0 if turn else length)]
    if turn:
        elements.append(Arc(length=length - 80.0, curvature=turn / BEND_RADIUS))
    road = Road.from_segments(elements, name="bend")
    return at.RoadDrive(road, constant_speed(road, BEND_SPEED), wind=wind)


@cache
def swerving(side: int) -> at.RoadDrive:
    """A straight at 12 m/s with a swerve of `SWERVE` to one side (-1 or 1)."""
    s = np.arange(0.0, 300.0, 0.5)
    u = np.clip((s - 120.0) / (SWERVE_SECONDS * 12.0), 0.0, 1.0)
    y = side * SWERVE * (10.0 * u**3 - 15.0 * u**4 + 6.0 * u**5)
    road = at.road_through(np.stack([s, y], axis=-1), noise=0.0, name="swerve")
    return at.RoadDrive(road, constant_speed(road, 12.0))


Arrival = tuple[PlannedTrajectory, PlannedTrajectory | None]
"""A trajectory and its fallback."""


# -- planners ---------------------------------------------------------------------------------------------------------
def changed(trajectory: PlannedTrajectory, **changes: Any) -> PlannedTrajectory:
    """Return a trajectory with other values."""
    values = dict(zip(POINT._fields, trajectory.points.T, strict=True))
    return PlannedTrajectory(**values | {"stamp": trajectory.stamp, "urgent": trajectory.urgent} | changes)


@dataclass
class Changed:
    """A planner of which each trajectory is changed as it arrives.

    change: function of a trajectory, the time of its arrival (s), and the drive; None is silence.
    """

    planner: SimulatedPlanner
    change: Callable[[PlannedTrajectory, float, at.RoadDrive], Arrival | None]

    def begin(self, drive: at.RoadDrive) -> Changed:
        """Begin a drive."""
        self._run, self._drive = self.planner.begin(drive), drive
        return self

    def step(self, sample: Any) -> Arrivals:
        """Return the trajectories that arrive."""
        now = float(sample[TRACKER_SAMPLE.now])
        changed = [self.change(trajectory, now, self._drive) for trajectory, _ in self._run.step(sample)]
        return [arrival for arrival in changed if arrival is not None]


def in_turn(trajectory: PlannedTrajectory, now: float, drive: at.RoadDrive) -> Arrival:
    """Two planners in turn, each beside the line."""
    side = 0.5 * PLANNERS_APART * (-1.0) ** round(trajectory.stamp / 0.1)
    _, x, y, yaw, *_ = trajectory.points.T
    return changed(trajectory, x=x - side * np.sin(yaw), y=y + side * np.cos(yaw)), None


def ahead_of_car(trajectory: PlannedTrajectory, now: float, drive: at.RoadDrive) -> Arrival:
    """A planner whose clock has gone on before the drive began."""
    return changed(trajectory, t=trajectory.points[:, 0] - BEHIND_CLOCK), None


def stop_from(drive: at.RoadDrive, stamp: float, begin: float, deceleration: float) -> PlannedTrajectory:
    """A trajectory along the line that brakes from the planned speed at a time (s) of the plan on."""
    begin = min(begin, drive.plan.duration)
    place, speed = map(float, drive.plan.motion(begin))
    before = np.arange(float(drive.plan.motion(stamp)[0]) - 5.0, place - 0.1, 1.0)
    t = np.append(np.arange(0.0, speed / deceleration, 0.1), speed / deceleration)
    s, v = place + speed * t - 0.5 * deceleration * t * t, np.maximum(speed - deceleration * t, 0.0)
    t = np.concatenate([arrival_times(drive.plan, before), begin + t, begin + t[-1:] + 4.0])
    s, v = np.concatenate([before, s, s[-1:]]), np.concatenate([drive.plan.at(before), v, [0.0]])
    line = drive.road.at(s)
    return PlannedTrajectory(t - stamp, line.x, line.y, yaw=line.heading, speed=v, stamp=stamp)


def silent_for(seconds: float, has_fallback: bool) -> Callable[..., Arrival | None]:
    """A planner that falls silent, with or without a fallback beside each of its trajectories."""

    def change(trajectory: PlannedTrajectory, now: float, drive: at.RoadDrive) -> Arrival | None:
        if EVENT <= now < EVENT + seconds - 0.1 - 1e-6:  # from the last arrival before to the next one
            return None
        stamp = trajectory.stamp
        return trajectory, stop_from(drive, stamp, stamp + 1.0, FALLBACK_BRAKING) if has_fallback else None

    return change


def braking(trajectory: PlannedTrajectory, now: float, drive: at.RoadDrive) -> Arrival:
    """A planner that brakes at once."""
    if now < EVENT:
        return trajectory, None
    stop = stop_from(drive, EVENT, EVENT, HARD_BRAKING)
    return changed(stop, t=stop.points[:, 0] - (trajectory.stamp - EVENT), stamp=trajectory.stamp), None


# -- trackers ---------------------------------------------------------------------------------------------------------
class PathTracker:
    """The way before: each trajectory is a path through its points with its speeds, whatever its times."""

    def __init__(self, controller: Any, speed: at.SpeedControl) -> None:
        self.controller, self.period, self._speed = controller, controller.period, speed
        self.engage()

    def engage(self) -> None:
        """Begin again, without a path."""
        self._tracker: Any = None

    def follow(self, trajectory: PlannedTrajectory, fallback: Any = None, now: float = 0.0) -> None:
        """Follow a trajectory; what cannot be a path is left out."""
        points = trajectory.points[:, 1:3]
        kept = np.append(True, np.hypot(*np.diff(points, axis=0).T) > 0.05)
        try:
            path = at.road_through(points[kept])
            length = np.append(0.0, np.cumsum(np.hypot(*np.diff(points[kept], axis=0).T)))
            t, speed = trajectory.points[kept, 0], np.minimum.reduceat(trajectory.points[:, 4], np.flatnonzero(kept))
            plan = SpeedPlan(
                length * path.length / length[-1], speed, t - t[0], float(t[-1] - t[0]), False, COMFORT
            )  # fmt: skip
            if self._tracker is None:
                self._tracker = at.Tracker(self.controller, path, plan=plan, speed=self._speed)
            else:
                self._tracker.follow(path, plan)
        except InvalidInput:
            if self._tracker is None:
                raise

    def step(self, **signals: float) -> Any:
        """One call."""
        return self._tracker.step(**signals)


class WatchedController(PlannedController):
    """A controller that notes what its tracker suspects and who drives; its tracker is one of `TRACKERS`."""

    kind = "planned"

    def make_tracker(self) -> Any:
        """Return a tracker at the start of a drive."""
        self.suspected: list[tuple[float, str]] = []
        self.driven_by: list[str] = []
        return TRACKERS[self.kind](self)

    def answer(self, sample: Any) -> Any:
        """Answer, and note."""
        answer = super().answer(sample)
        now, known = float(sample[TRACKER_SAMPLE.now]), {text for _, text in self.suspected}
        self.suspected += [(now, text) for text in self.tracked.suspect if text not in known]
        self.driven_by.append(str(getattr(self.tracked, "driven_by", "")))
        return answer


@dataclass
class FixedPath:
    """No planner: the drive's road and plan as one path of the tracker."""

    def begin(self, drive: at.RoadDrive) -> FixedPath:
        """Begin a drive."""
        return self

    def step(self, sample: Any) -> Arrivals:
        """Nothing arrives."""
        return []


def autoware(mode: str) -> Callable[[WatchedController], Any]:
    """Autoware's structure in a mode."""
    return lambda controller: import_module("autoware_follow").AutowareFollow(
        controller.speed.car, controller.profile, mode
    )


TRACKERS: dict[str, Callable[[WatchedController], Any]] = {
    "autoware-spatial": autoware("spatial"),
    "autoware-temporal": autoware("temporal"),
    "before": lambda controller: PathTracker(controller.controller, controller.speed),
    "planned": lambda controller: at.Tracker(
        controller.controller, speed=controller.speed, following=controller.following
    ),
    "fixed": lambda controller: at.Tracker(
        controller.controller, controller.drive.road, plan=controller.drive.plan, speed=controller.speed
    ),
}


class DirectBraking(WatchedController):
    """A controller that requests the same deceleration directly, as soon as the planner would."""

    def answer(self, sample: Any) -> Any:
        """Answer with the request."""
        answer = super().answer(sample)
        if sample[TRACKER_SAMPLE.now] < EVENT:
            return answer
        force = -HARD_BRAKING * self.vehicle.mass
        stands = sample[TRACKER_SAMPLE.speed] < 0.2
        request = answer.longitudinal._replace(
            acceleration=-HARD_BRAKING, force=0.0 if stands else force, hold=-force if stands else 0.0
        )
        answer.longitudinal = request
        return answer


class Driven(NamedTuple):
    """A drive."""

    run: Any
    controller: WatchedController
    drive: at.RoadDrive

    @property
    def lost(self) -> bool:
        """Whether the car failed."""
        return self.run.failed is not None

    @property
    def offset(self) -> Any:
        """m, from the line that was meant, from `SETTLED` on."""
        return self.run.road["offset"][self.run.t >= SETTLED]

    @property
    def late(self) -> float:
        """s, by which the car is late where it ends; a car that stands there has arrived before."""
        station = self.run.road["station"]
        end = np.flatnonzero(station >= np.nanmax(station) - ARRIVED)[0]
        return float(self.run.t[end] - arrival_times(self.drive.plan, station[[end]])[0])


def drive(
    group: Group, road_drive: at.RoadDrive, planner: Any, seed: int, tracker: str, *, with_drifts: bool = True,
    kind: type[WatchedController] = WatchedController, following: Following | None = None, bias: float = 0.0,
) -> Driven:  # fmt: skip
    """Simulate a drive; planner: None for one fixed path; bias: rad, of the wheels beyond the command."""
    controller = kind(group.controller(with_drifts), at.SpeedControl(group.known), planner or FixedPath())
    controller.drive, controller.profile, controller.following = road_drive, group.profile, following or Following()
    controller.kind = "fixed" if planner is None else tracker
    profile = at.load_profile(group.profile)
    profile = profile.replace(steering=profile.steering.replace(bias=bias))
    run = at.simulate(at.DualTrack(group.vehicle), controller, road_drive, profile=profile, seed=seed)
    return Driven(run, controller, road_drive)


@cache
def fixed(group: Group, road_drive: at.RoadDrive, seed: int) -> Driven:
    """The same drive along one fixed path."""
    return drive(group, road_drive, None, seed, "")


@cache
def heard(group: Group, road_drive: at.RoadDrive, seed: int, tracker: str) -> Driven:
    """The same drive behind a planner on the line."""
    return drive(group, road_drive, SimulatedPlanner(seed=seed), seed, tracker)


# -- cases ------------------------------------------------------------------------------------------------------------
def root_mean_square(values: Any) -> float:
    """Root mean square of the numbers that are finite."""
    finite = np.asarray(values)[np.isfinite(values)]
    return float(np.sqrt(np.mean(np.square(finite)))) if finite.size else math.nan


def compare(driven: Driven, reference: Driven) -> dict[str, float]:
    """Measures of a drive beside the one along a fixed path."""
    moves = [np.diff(d.run.command[d.run.t >= SETTLED]) for d in (driven, reference)]
    commands = [root_mean_square(d.run.command[d.run.t >= SETTLED]) for d in (driven, reference)]
    return {
        "lost": driven.lost, "rms": root_mean_square(driven.offset), "fixed rms": root_mean_square(reference.offset),
        "command": commands[0] / commands[1], "moves": root_mean_square(moves[0]) / root_mean_square(moves[1]),
        "late": driven.late, "fixed late": reference.late, "met": math.isfinite(condition_begins(driven)),
        "false": bool(driven.controller.suspected) and math.isinf(condition_begins(driven)),
    }  # fmt: skip


def mismatch(
    planner: SimulatedPlanner, change: Callable[..., Arrival | None] | None = None, *, is_slow: bool = False
) -> Callable[[Group, int, str], dict[str, float]]:
    """A case on winding roads whose planner differs."""

    def measure(group: Group, seed: int, tracker: str) -> dict[str, float]:
        road_drive = winding(seed, is_slow)
        own = replace(planner, seed=seed)
        driven = drive(group, road_drive, own if change is None else Changed(own, change), seed, tracker)
        return compare(driven, fixed(group, road_drive, seed))

    return measure


def hidden_offset(group: Group, seed: int, tracker: str) -> dict[str, float]:
    """A planner that starts from the pose: what is left in a bend, in side wind and with a bias, and its detection."""
    measures: dict[str, float] = {"lost": 0.0, "met": 0.0, "detected": 0.0, "false": 0.0}
    side = 1 if seed % 2 else -1
    for name, road_drive, bias in (("bend", bend(side), 0.0), ("wind", bend(0, side * WIND), 0.0),
                                   ("bias", bend(0), side * STEERING_BIAS)):  # fmt: skip
        for with_drifts in (True, False):
            planner = SimulatedPlanner(start="pose", seed=seed)
            driven = drive(group, road_drive, planner, seed, tracker, with_drifts=with_drifts, bias=bias)
            last = driven.run.road["offset"][driven.run.t > SECONDS - 15.0]
            measures[f"{name}{'' if with_drifts else ', plain'}"] = abs(float(np.nanmean(last)))
            measures["lost"] += driven.lost
            begun = condition_begins(driven)
            said = driven.controller.suspected[0][0] if driven.controller.suspected else math.inf
            measures["met"] += math.isfinite(begun)
            measures["detected"] += math.isfinite(begun) and said <= begun + DETECTION
            measures["false"] += not math.isfinite(begun) and math.isfinite(said)
    return measures


def condition_begins(driven: Driven) -> float:
    """Time (s) at which the true offset has exceeded `LEAST_OFFSET` for `OFFSET_SECONDS`; inf: never."""
    beyond, count = np.abs(driven.run.road["offset"]) > LEAST_OFFSET, 0
    for now, is_beyond in zip(driven.run.t, beyond, strict=True):
        count = count + 1 if is_beyond else 0
        if count * driven.run.period >= OFFSET_SECONDS:
            return float(now)
    return math.inf


def excess(driven: Driven, limit: float | None) -> float:
    """Largest speed (m/s) beyond a limit (m/s); None: the largest planned speed near the place, as for a tracker."""
    s, plan = driven.run.road["station"], driven.drive.plan
    way = np.maximum(LIMIT_TIME * plan.at(s), LIMIT_WAY)
    near = np.max([plan.at(s + share * way) for share in np.linspace(-1.0, 1.0, 101)], axis=0)
    return float(np.nanmax(driven.run.vx - (near if limit is None else limit)))


def behind(limit: float | None) -> Callable[[Group, int, str], dict[str, float]]:
    """A planner that is 2 s ahead at the start: lateness at the end, and the speed beyond what may be driven.

    limit: m/s, up to which a tracker may catch up; None: the largest planned speed near the place.
    """

    def measure(group: Group, seed: int, tracker: str) -> dict[str, float]:
        road_drive, following = winding(seed), Following(speed_limit=limit)
        planner = Changed(SimulatedPlanner(seed=seed), ahead_of_car)
        driven = drive(group, road_drive, planner, seed, tracker, following=following)
        reference = fixed(group, road_drive, seed)
        row = compare(driven, reference)
        row["late"] += BEHIND_CLOCK
        return row | {"too fast": excess(driven, limit), "fixed too fast": excess(reference, limit)}

    return measure


def silence(seconds: float, has_fallback: bool) -> Callable[[Group, int, str], dict[str, float]]:
    """A planner that falls silent."""

    def measure(group: Group, seed: int, tracker: str) -> dict[str, float]:
        road_drive = winding(seed)
        planner = Changed(SimulatedPlanner(seed=seed), silent_for(seconds, has_fallback))
        driven = drive(group, road_drive, planner, seed, tracker)
        reference = heard(group, road_drive, seed, tracker)
        after = driven.run.t >= EVENT
        stands = driven.run.vx < REST
        first = driven.run.t[after & stands]
        return {
            "lost": driven.lost, "slower": float(np.nanmax(reference.run.vx[after] - driven.run.vx[after])),
            "at rest": bool((after & stands).any()), "after": float(first[0] - EVENT) if first.size else math.nan,
            "stays": bool(stands[np.isfinite(driven.run.vx)][-1]),
            "offset": float(np.nanmax(np.abs(driven.run.road["offset"][after]))),
        }  # fmt: skip

    return measure


def braked(group: Group, seed: int, tracker: str) -> dict[str, float]:
    """A planner that brakes at once: stopping way over that of the same request sent directly."""
    road_drive, ways, lost = winding(seed), [], False
    for planner, kind in ((Changed(SimulatedPlanner(seed=seed), braking), WatchedController), (None, DirectBraking)):
        driven = drive(group, road_drive, planner, seed, tracker, kind=kind)
        s, after = driven.run.road["station"], driven.run.t >= EVENT
        stands = np.flatnonzero(after & (driven.run.vx < REST))
        ways.append(s[stands[0]] - s[after][0] if stands.size else math.inf)
        lost |= driven.lost
    return {"lost": lost, "way": ways[0], "direct way": ways[1], "way ratio": ways[0] / ways[1]}


def swerve(group: Group, seed: int, tracker: str) -> dict[str, float]:
    """A swerve: how much later than along a fixed path the car has made half of it."""
    road_drive, times = swerving(1 if seed % 2 else -1), []
    offsets: list[float] = []
    for planner in (SimulatedPlanner(seed=seed), None):
        driven = drive(group, road_drive, planner, seed, tracker)
        half = driven.run.t[np.abs(driven.run.Y) > 0.5 * SWERVE]
        times.append(float(half[0]) if half.size else math.inf)
        offsets.append(float(np.nanmax(np.abs(driven.run.road["offset"]))))
    return {"lost": driven.lost, "delay": times[0] - times[1], "largest": offsets[0], "fixed largest": offsets[1]}


CASES: dict[str, Callable[[Group, int, str], dict[str, float]]] = {
    "i": mismatch(SimulatedPlanner()),
    "ii": hidden_offset,
    "ii-road": mismatch(SimulatedPlanner(start="pose")),
    "iii": mismatch(SimulatedPlanner(start="pose", delay=0.3, jitter=0.05)),
    "iv": mismatch(SimulatedPlanner(), in_turn),
    "v": mismatch(SimulatedPlanner(), is_slow=True),
    "vi": behind(HIGHER_LIMIT),
    "vi-default": behind(None),
    "vii": mismatch(SimulatedPlanner(spacing=1.0, noise=0.05)),
    **{
        f"viii-{name}{'' if has_fallback else '-none'}": silence(seconds, has_fallback)
        for name, seconds in (("0.5", 0.5), ("3", 3.0), ("good", math.inf)) for has_fallback in (True, False)
    },
    "ix": braked,
    "swerve": swerve,
}  # fmt: skip
SUMMED = ("lost", "met", "detected", "false", "at rest", "stays")
"""Measures that are counted; of others the table has the mean, then the largest."""


def cell(name: str, rows: Sequence[dict[str, float]]) -> str:
    """Text of a measure over the drives of a group."""
    values = np.array([row[name] for row in rows], dtype=float)
    if name in SUMMED:
        return f"{name} {values.sum():.0f}"
    if name == "rms":
        fixed_values = np.array([row["fixed rms"] for row in rows])
        ratio = root_mean_square(values) / root_mean_square(fixed_values)
        return f"RMS {root_mean_square(values):.3f} m ({ratio:.2f})"
    return f"{name} {np.mean(values):.2f} ({values[np.argmax(np.abs(values))]:.2f})"


def measured(name: str, group: Group, seed: int, tracker: str) -> dict[str, float] | str:
    """Measures of a drive of a case, or why it was refused."""
    logging.getLogger("adaptrack").setLevel(logging.ERROR)
    try:
        return CASES[name](group, seed, tracker)
    except InvalidInput as error:
        return str(error)


def main() -> None:
    """Print a row for each case, car and profile."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", nargs="+", default=list(CASES), metavar="CASE", help=", ".join(CASES))
    parser.add_argument("--drives", type=int, default=10, help="of each car and profile")
    parser.add_argument("--seed", type=int, default=REPORTED_SEED)
    parser.add_argument("--cars", nargs="+", default=list(CARS), choices=CARS)
    parser.add_argument("--profiles", nargs="+", default=PROFILES)
    parser.add_argument("--tracker", default="planned", choices=TRACKERS)
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    arguments = parser.parse_args()
    names = [name for name in CASES if name in arguments.cases or name.partition("-")[0] in arguments.cases]
    with ProcessPoolExecutor(arguments.jobs) as pool:
        for name, car, profile in product(names, arguments.cars, arguments.profiles):
            seeds = [100 * arguments.seed + k for k in range(arguments.drives)]
            one = partial(measured, name, Group(car, profile), tracker=arguments.tracker)
            answers = list(pool.map(one, seeds))
            rows = [answer for answer in answers if isinstance(answer, dict)]
            refusals = [answer for answer in answers if isinstance(answer, str)]
            text = "; ".join(cell(key, rows) for key in rows[0] if key != "fixed rms") if rows else ""
            refused = f"; {len(refusals)} refused: {refusals[0]}" if refusals else ""
            print(f"{name:14} {car:5} {profile:10} {text}{refused}", flush=True)


if __name__ == "__main__":
    main()

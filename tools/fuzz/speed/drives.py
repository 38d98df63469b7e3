"""A random drive: car, paths with their plans, slopes, sensors, orders of calls, and faults of the sensors."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from adaptrack.base.errors import InvalidInput
from adaptrack.cars.vehicle import BrakeActuator, DriveActuator, Vehicle, load_vehicle
from adaptrack.control.controllers import MPC, Controller, Learning, PurePursuit
from adaptrack.control.speed_control import SpeedControl
from adaptrack.core.physics.forces import GRAVITY
from adaptrack.road import Comfort, Road, SpeedPlan, Stop, plan_speed, road_through
from tools.fuzz.inputs import Array, Rng, choose
from tools.fuzz.speed.faults import CROSS, LISTS, VISIBLE, SensorFault

PERIOD = 0.05
"""s, control period of all controllers."""
TOP_SPEED = 27.0
"""m/s, of all plans at most: it sizes the exported library."""
CARS = ("midsize-sedan", "van", "compact-ev", "sports-car", "small-car")
SHARES = {"healthy": 0.4, "visible": 0.22, "cross": 0.2, "hidden": 0.08, "double": 0.1}
"""Of the drives, by what fails."""
STEEP = 0.12
"""dz/ds, of most slopes at most; three in ten of the unmapped ones reach to twice as much."""


class Variant(NamedTuple):
    """What decides on the sizes of an exported library."""

    controller: str
    knows_delays: bool
    friction: float | tuple[float, float]


VARIANTS = {
    Variant("pure-pursuit", False, 0.9): 0.35, Variant("pure-pursuit", True, 0.6): 0.15,
    Variant("default", False, (0.65, 0.9)): 0.25, Variant("default", True, 0.9): 0.15,
    Variant("learning", False, (0.65, 0.9)): 0.1,
}  # fmt: skip
"""And their shares of the drives."""


class TrueCar(NamedTuple):
    """The car that is driven."""

    mass: float  # kg
    drive_gain: float
    drive_lag: float  # s
    drive_dead_time: float  # s
    brake_gain: float
    brake_lag: float  # s
    brake_dead_time: float  # s
    friction: float


class Sensors(NamedTuple):
    """Noise and lateness of what is measured."""

    age: float  # s
    jitter: float  # s, of the age, and of the calls
    period: float  # s, between two samples; 0: one for each call
    noise: float  # m
    is_signed: bool  # whether the speed is negative backwards
    has_grade: bool
    has_acceleration: bool

    @property
    def kind(self) -> str:
        """`prompt`, `late` or `slow`."""
        return "slow" if self.period > 0.0 else "late" if self.age > 0.0 else "prompt"


class Route(NamedTuple):
    """A path and its plan."""

    points: Array
    road: Road
    plan: SpeedPlan


class Event(NamedTuple):
    """Something besides the calls: `follow`, `engage`, `release`, `driver`, `gap`."""

    time: float  # s
    name: str
    number: float = 0.0
    """number of the route, target speed of the driver (m/s)"""
    duration: float = 0.0  # s, of a driver or a gap


class Episode(NamedTuple):
    """A fault for some time."""

    start: float  # s
    end: float  # s
    name: str
    fault: SensorFault
    size: float


@dataclass
class Drive:
    """A drive as drawn from a seed and its number."""

    seed: int
    number: int
    kind: str
    """key of `SHARES`"""
    variant: Variant
    car: Vehicle
    true_car: TrueCar
    sensors: Sensors
    routes: list[Route]
    grade: tuple[Array, Array]
    """s (m) and dz/ds of the true road, along the first route"""
    start: tuple[float, float]
    """station (m) and speed (m/s)"""
    clock: float
    """s, of the first call"""
    steps: int
    comfort: Comfort
    events: list[Event] = field(default_factory=list)
    episodes: list[Episode] = field(default_factory=list)

    @property
    def fault(self) -> str:
        """Names of the faults."""
        return " and ".join(dict.fromkeys(episode.name for episode in self.episodes)) or "none"

    @cached_property
    def speed_control(self) -> SpeedControl:
        """The speed control under test."""
        true, knows = self.true_car, self.variant.knows_delays
        drive = DriveActuator(lag=true.drive_lag, dead_time=true.drive_dead_time) if knows else None
        brakes = BrakeActuator(lag=true.brake_lag, dead_time=true.brake_dead_time) if knows else None
        return SpeedControl(self.car, self.variant.friction, drive=drive, brakes=brakes)

    def controller(self) -> Controller:
        """Make the controller that steers."""
        car: Any = self.car
        return {
            "pure-pursuit": lambda: PurePursuit(car, period=PERIOD),
            "default": lambda: MPC(car, profile="road", computation=0.0),
            "learning": lambda: MPC(car, belief="unknown", learning=Learning()),
        }[self.variant.controller]()


def draw_drive(seed: int, number: int) -> Drive:
    """Draw a drive."""
    rng = np.random.default_rng([seed, number])
    kind = str(rng.choice(list(SHARES), p=list(SHARES.values())))
    variants = list(VARIANTS)
    variant = variants[int(rng.choice(len(variants), p=list(VARIANTS.values())))]
    car = load_vehicle(choose(rng, CARS))
    if variant.controller == "learning":  # what is learned has sizes that depend on the car
        car = load_vehicle(CARS[0])
    true_car = _true_car(rng, variant, car)
    comfort = Comfort(
        accelerate=float(rng.uniform(0.3, 0.8) if rng.random() < 0.1 else rng.uniform(0.8, 2.5)),
        brake=float(rng.uniform(2.0, 4.0)), lateral=float(rng.uniform(1.5, 3.0)),
        jerk=1.5 if rng.random() < 0.15 else math.inf,
    )  # fmt: skip
    steps = int(rng.integers(1000, 2200))
    points, closed = _points(rng)
    map_grade, true_grade = _grades(rng, points, closed, _climbing_reserve(car, true_car))
    routes = _routes(rng, points, closed, map_grade, car, comfort)
    road = routes[0].road
    speed = 0.0
    station = float(rng.uniform(0.0, 5.0))
    if rng.random() < 0.3:
        station = float(rng.uniform(0.0, 0.4 * road.length))
        speed = float(rng.uniform(0.3, 1.0) * routes[0].plan.at(station))
    drive = Drive(
        seed, number, kind, variant, car, true_car, _sensors(rng, kind), routes, true_grade, (station, speed),
        choose(rng, (0.0, 1000.0, 1.7e9)), steps, comfort,
    )  # fmt: skip
    if rng.random() < 0.5:
        drive.events = _events(rng, drive)
    drive.episodes = draw_episodes(rng, kind, steps * PERIOD)
    if any(name in drive.fault for name in ("acceleration sign", "acceleration in g")):
        drive.sensors = drive.sensors._replace(has_acceleration=True)
    if "speed sign" in drive.fault:
        drive.sensors = drive.sensors._replace(is_signed=True)
    return drive


# -- the car ----------------------------------------------------------------------------------------------------------
def _true_car(rng: Rng, variant: Variant, car: Vehicle) -> TrueCar:
    low, high = variant.friction if isinstance(variant.friction, tuple) else (variant.friction, variant.friction)
    knows = variant.knows_delays
    return TrueCar(
        mass=car.mass * float(rng.uniform(0.85, 1.3)),
        drive_gain=float(rng.uniform(0.85, 1.1)),
        drive_lag=float(rng.uniform(0.0, 0.4)), drive_dead_time=float(rng.uniform(0.0, 0.2 if knows else 0.25)),
        brake_gain=float(rng.uniform(0.85, 1.1)),
        brake_lag=float(rng.uniform(0.0, 0.3)), brake_dead_time=float(rng.uniform(0.0, 0.2 if knows else 0.25)),
        friction=float(rng.uniform(low, high)) if low < high else low * float(rng.uniform(1.0, 1.1)),
    )  # fmt: skip


def _climbing_reserve(car: Vehicle, true_car: TrueCar) -> float:
    """Steepest dz/ds that the true car starts on, with a reserve of 0.5 m/s^2."""
    push = min(true_car.drive_gain * car.traction_limit / true_car.mass, 0.45 * true_car.friction * GRAVITY)
    return max((push - 0.5) / GRAVITY - car.rolling_resistance, 0.0)


# -- the path ---------------------------------------------------------------------------------------------------------
def _points(rng: Rng) -> tuple[Array, bool]:
    """Points of a path, about 2 m apart, and whether it is a lap."""
    kind = choose(rng, ("open", "open", "open", "lap", "short lap", "eight", "crossing"))
    if kind in ("lap", "short lap", "eight"):
        return _lap(rng, kind), True
    if kind == "open":
        length = float(rng.uniform(150.0, 800.0))
        s = np.arange(0.0, length, 1.0)
        curvature = sum(
            (float(rng.uniform(-1.0, 1.0)) * np.sin(s / float(rng.uniform(15.0, 60.0)) + float(rng.uniform(0.0, 6.3)))
            for _ in range(3)), np.zeros(s.size)
        ) / 3.0 * float(rng.uniform(0.0, 0.04))  # fmt: skip
    else:  # a bend of 270 degrees between two straights, which cross
        radius, straight = float(rng.uniform(18.0, 30.0)), float(rng.uniform(60.0, 100.0))
        turn, ramp = 1.5 * math.pi, 15.0
        bend = turn * radius + ramp
        s = np.arange(0.0, 2.0 * straight + bend, 1.0)
        inside = np.minimum(s - straight, straight + bend - s) / ramp
        curvature = np.clip(inside, 0.0, 1.0) / radius
    heading = np.cumsum(curvature) + float(rng.uniform(-math.pi, math.pi))
    points = np.cumsum(np.stack([np.cos(heading), np.sin(heading)], axis=-1), axis=0)
    return np.ascontiguousarray(points[::2]) + rng.uniform(-300.0, 300.0, size=2), False


def _lap(rng: Rng, kind: str) -> Array:
    if kind == "eight":
        width = float(rng.uniform(50.0, 90.0))
        angle = np.linspace(0.0, 2.0 * math.pi, 2000, endpoint=False)
        dense = np.stack([width * np.sin(angle), width * np.sin(angle) * np.cos(angle)], axis=-1)
    else:
        radius = float(rng.uniform(30.0, 90.0) if kind == "lap" else rng.uniform(10.0, 14.0))
        angle = np.linspace(0.0, 2.0 * math.pi, 2000, endpoint=False)
        waves = [(float(rng.uniform(0.0, 0.06)), float(rng.uniform(0.0, 6.3))) for _ in range(2)]
        wave = sum(size * np.cos((k + 2) * angle + phase) for k, (size, phase) in enumerate(waves))
        distance = radius * (1.0 + (wave if kind == "lap" else 0.0))
        dense = np.stack([distance * np.cos(angle), distance * np.sin(angle)], axis=-1)
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(dense, axis=0, append=dense[:1]).T))])
    places = np.linspace(0.0, way[-1], max(12, round(way[-1] / 2.0)), endpoint=False)
    columns = [np.interp(places, way, np.append(column, column[0])) for column in dense.T]
    return np.ascontiguousarray(np.stack(columns, axis=-1))


def _grades(rng: Rng, points: Array, closed: bool, climb: float) -> tuple[Any, tuple[Array, Array]]:
    """Grade of the map (as `Road.replace` takes it) and the true one, both by arc length (m)."""
    length = float(np.hypot(*np.diff(points, axis=0).T).sum())
    count = max(2, round(length / float(rng.uniform(50.0, 120.0))))
    s, level = np.linspace(0.0, length, count + 1), np.zeros(count + 1)
    kind = choose(rng, ("level", "mapped", "mapped", "unmapped", "unmapped", "wrongly mapped"))
    steep = min(STEEP * (2.0 if kind == "unmapped" and rng.random() < 0.3 else 1.0), climb)
    hills = rng.uniform(-steep, steep, size=count + 1)
    if kind == "unmapped" and rng.random() < 0.5:
        hills[:] = hills[0]
    if closed:
        hills[-1] = hills[0]
    if kind == "level":
        return (s, level), (s, level)
    if kind == "mapped":
        return (s, hills), (s, hills)
    if kind == "unmapped":
        return (s, level), (s, hills)
    return (s, hills), (s, hills * float(choose(rng, (-0.5, 0.5, 1.5 if 1.5 * steep < climb else 0.7))))


# -- the plans --------------------------------------------------------------------------------------------------------
def _routes(rng: Rng, points: Array, closed: bool, grade: Any, car: Vehicle, comfort: Comfort) -> list[Route]:
    """The first route, one with other stops and speeds, and, of an open path, the part behind its first third."""
    routes = []
    for k in range(2 if closed else 3):
        part, along = points, grade
        if k == 2:
            first = len(points) // 3
            part = np.ascontiguousarray(points[first:])
            shift = float(np.hypot(*np.diff(points[: first + 1], axis=0).T).sum())
            along = (np.maximum(grade[0] - shift, 0.0) + 1e-6 * np.arange(grade[0].size), grade[1])
        for steepness in (1.0, 0.5, 0.0):
            road = road_through(part, closed=closed).replace(grade=(along[0], steepness * along[1]))
            try:
                plan = _plan(rng, road, car, comfort)
            except InvalidInput:
                continue
            routes.append(Route(part, road, plan))
            break
    return routes


def _plan(rng: Rng, road: Road, car: Vehicle, comfort: Comfort) -> SpeedPlan:
    top_speed = float(rng.uniform(3.0, 8.0) if rng.random() < 0.4 else rng.uniform(8.0, 20.0))
    stops = _stops(rng, road)
    ends = {} if road.closed else {"start": 0.0 if rng.random() < 0.5 else None, "end": choose(rng, (0.0, None))}
    plan = plan_speed(road, car, comfort, stops=stops, top_speed=top_speed, **ends)
    inner = [stop for stop in plan.stops if stop.s < road.length]
    if inner and rng.random() < 0.1:
        k = int(np.flatnonzero(plan.s == inner[-1].s)[0])
        time = plan.time.copy()
        time[k + 1 :] = math.inf
        plan = replace(plan, time=time)
    return plan


def _stops(rng: Rng, road: Road) -> list[Stop]:
    """No stop, one, several, several near each other, one at the start, one at the end."""
    length = road.length
    kind = choose(rng, ("none", "one", "one", "several", "several", "near", "start", "end"))
    if kind == "none":
        places: list[float] = []
    elif kind == "near":
        first = float(rng.uniform(0.3, 0.7)) * length
        places = [first + k * float(rng.uniform(0.6, 8.0)) for k in range(int(rng.integers(2, 4)))]
    elif kind == "start":
        places = [float(rng.uniform(0.0, 8.0)), 0.6 * length]
    elif kind == "end":
        places = [length] if not road.closed else [0.0]
    else:
        places = rng.uniform(0.1, 0.95, size=1 if kind == "one" else int(rng.integers(2, 6))).tolist()
        places = [place * length for place in places]
    seconds = [float(choose(rng, (0.0, 1.0, 2.0, 3.0, 5.0))) for _ in places]
    pairs = sorted(zip(places, seconds, strict=True))
    apart = [pair for k, pair in enumerate(pairs) if k == 0 or pair[0] - pairs[k - 1][0] > 0.3]
    return [Stop(place, time) for place, time in apart if 0.0 <= place <= length]


# -- calls and faults -------------------------------------------------------------------------------------------------
def _sensors(rng: Rng, kind: str) -> Sensors:
    is_prompt = rng.random() < 0.6
    slow = 0.0 if is_prompt or rng.random() < 0.6 else float(choose(rng, (0.1, 0.2)))
    return Sensors(
        age=0.0 if is_prompt else float(rng.uniform(0.02, 0.12)),
        jitter=0.0 if rng.random() < 0.5 else float(rng.uniform(0.0, 0.03)),
        period=slow, noise=float(choose(rng, (0.01, 0.02, 0.05, 0.1))), is_signed=bool(rng.random() < 0.7),
        has_grade=bool(rng.random() < 0.2), has_acceleration=bool(rng.random() < 0.3),
    )  # fmt: skip


def _events(rng: Rng, drive: Drive) -> list[Event]:
    """Calls in an odd order, sorted by their time."""
    events, end = [], drive.steps * PERIOD
    for _ in range(int(rng.integers(1, 5))):
        kind = choose(rng, ("engage", "same", "same", "follow", "release", "driver", "driver", "gap", "gap"))
        at = float(rng.uniform(2.0, end - 25.0))
        if kind == "same":  # a planner that repeats its plan
            count = int(rng.integers(4, 120))
            events += [Event(at + 0.5 * k, "follow", -1.0) for k in range(count)]
        elif kind == "follow":
            events.append(Event(at, "follow", float(rng.integers(len(drive.routes)))))
        elif kind == "driver":
            top = float(drive.routes[0].plan.speed.max())
            target = choose(rng, (0.0, 0.5 * top, top, -1.0, 1.2 * top))
            events.append(Event(at, "driver", target, float(rng.uniform(0.5, 8.0) if target >= 0.0 else 4.0)))
        elif kind == "gap":
            events.append(Event(at, "gap", 0.0, float(rng.uniform(0.15, 3.0))))
        else:
            events.append(Event(at, kind))
    return sorted(events)


def draw_episodes(rng: Rng, kind: str, end: float) -> list[Episode]:
    """When which sensor fails in a drive of a list; end: s, of the drive."""
    if kind == "healthy":
        return []
    if kind == "double":
        names = [choose(rng, list({**VISIBLE, **CROSS})) for _ in range(2)]
        start = float(rng.uniform(4.0, 0.5 * end))
        return [_episode(rng, {**VISIBLE, **CROSS}, name, start + float(rng.uniform(0.0, 2.0)), end) for name in names]
    faults = LISTS[kind]
    name = choose(rng, list(faults))
    starts = rng.uniform(2.0, 0.7 * end, size=int(rng.integers(1, 4)))
    episodes: list[Episode] = []
    for start in np.sort(starts).tolist():
        if not episodes or start > episodes[-1].end + 1.0:
            episodes.append(_episode(rng, faults, name, start, end))
    return episodes


def _episode(rng: Rng, faults: dict[str, SensorFault], name: str, start: float, end: float) -> Episode:
    fault = faults[name]
    ranges = ((0.05, 0.3), (0.3, 1.0), (1.0, 5.0), (5.0, 20.0), (1e3, 1e3))
    duration = float(rng.uniform(*choose(rng, ranges)))
    if fault.lasts:
        start, duration = 0.0, 1e3
    return Episode(start, start + duration, name, fault, float(choose(rng, fault.sizes)))

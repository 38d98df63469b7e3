"""A drive that travels with an exported controller: what was measured, and what the tracker answered here.

First the controller drives a simulated car. Then a car that obeys nobody moves along the end of the path, where two
bends are tighter than the car can turn: limits act, samples are late, missing, wrong or far from the path, and a
learner meets a car that contradicts it. So a constant that is damaged changes an answer.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from adaptrack.base.errors import InvalidInput
from adaptrack.cars.plant import Plant, SteppedPlant
from adaptrack.control.controllers import Controller
from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import Array
from adaptrack.core.tracker.signals import MEASURED, TRACKED
from adaptrack.core.tracker.signals import TRACKER_SAMPLE as CALL
from adaptrack.drive.failure import find_failure
from adaptrack.drive.planner import SampledController
from adaptrack.drive.simulate import simulate
from adaptrack.export.tracking import SpeedPart, Twin
from adaptrack.road import Along, Road, SpeedPlan, Stop, plan_speed, road_through
from adaptrack.road.speed import constant_speed
from adaptrack.scenario import RoadDrive
from adaptrack.scenario.profile import Profile

RECORDED_SPACING = 5.0
"""m, between the points of the path: what a planner would send."""
RECORDED_LOOKAHEAD = 10.0
"""s, at the highest speed, that the path goes on behind the end of the record."""
STOP_PLACE, STOP_SECONDS = 100.0, 1.5
"""m, s: of the stop, with a speed control."""
HILL_LENGTH, HILL_GRADE = 80.0, 0.05
"""m, -: length and steepest grade of the hills of a level road, with a speed control."""
SLOWER = (1.0, 0.7, 0.5, 0.35)
"""Factors on the highest planned speed of the simulated drive: a car that leaves the road drives again, more slowly."""
DRIVEN_SHARE = 0.4
"""Share of the record that the controller drives."""
MOST_ANGLE = 1.2
"""rad, of the wheels of any car"""
BEND_SPACING = 0.25
"""m, between the points of the two tight bends."""


MAX_OFFSET = 20.0
"""m, from the path, at most"""
BEND_SPEED = 2.5
"""m/s, the planned speed in them."""


class RecordedStretch(NamedTuple):
    """A part of the record with a car that moves along the path by itself."""

    seconds: float
    start: float
    """m, from the beginning of the tight bends; NaN: where the stretch before ended"""
    speed: float
    """m/s, at first"""
    acceleration: float = 0.0
    """m/s^2, along the path"""
    offset: float = 0.0
    """m, amplitude of a weave about the path; inf: just beyond the furthest"""
    wave: float = 4.0
    """s, its period"""
    noise: float = 1.0
    """factor on the noise of all sensors"""
    age: float = 0.0
    """s, the samples' largest"""
    missing: float = 0.0
    """share of numbers that are missing"""
    faults: Mapping[str, tuple[float, float]] = MappingProxyType({})
    """factor on numbers of the sample and what is added to them, in the first half of each wave; by their names"""
    without: tuple[str, ...] = ()
    """numbers that are missing throughout"""
    driver: bool = False
    """whether a driver uses the pedals"""


STRETCHES = (
    RecordedStretch(2.0, -10.0, 8.0, -2.0, age=0.25, missing=0.1),
    RecordedStretch(8.0, 1.0, 2.5, offset=0.05, wave=0.5),
    RecordedStretch(0.5, 11.0, -1.0),
    RecordedStretch(1.5, 11.0, 1.0),
    RecordedStretch(0.5, 19.0, -1.0),
    RecordedStretch(1.5, 19.0, 1.0),
    RecordedStretch(4.0, -60.0, 12.0, offset=0.8, wave=1.5, age=0.4, missing=0.2),
    RecordedStretch(
        6.0,
        -100.0,
        15.0,
        wave=1.0,
        faults={"yaw_rate": (1.0, 0.3), "lateral_velocity": (1.0, 1.0), "wheel_angle": (1.0, 0.1)},
    ),
    RecordedStretch(3.0, -80.0, 15.0, wave=0.7, faults={"lateral_acceleration": (1.0, 3.0), "yaw": (1.0, 0.1)}),
    RecordedStretch(2.0, -50.0, 20.0, without=("x", "y")),
    RecordedStretch(2.0, -40.0, 3.0, -1.5, driver=True),
    RecordedStretch(3.0, -40.0, 8.0, offset=math.inf, wave=6.0),
    RecordedStretch(2.0, -20.0, 5.0),
)
"""What the record goes through behind the simulated drive."""
SENSOR_NOISE = (0.02, 0.02, 0.003, 0.02, 0.005, 0.02, 0.05, 0.002)
"""Standard deviations of `MEASURED`."""


class RecordedPlan(NamedTuple):
    """Speed along the recorded path."""

    s: Array
    """m, every `RECORDED_SPACING`"""
    speed: Array
    """Speed at these places (m/s)."""
    stops: tuple[Stop, ...] = ()


@dataclass(frozen=True, eq=False)
class Recorded:
    """A path through points, a planned speed along it, calls, and answers."""

    points: Array
    """(n, 2) m"""
    path: Road
    """the path through them, with its grade"""
    plan: RecordedPlan
    samples: Array
    """(calls, columns of a `core.tracker.signals.TRACKER_SAMPLE`)"""
    answers: Array
    """(calls, columns), see `Twin.call`"""
    driven_calls: int
    """calls of the simulated drive, the first ones"""
    failed: str = ""
    """when and why the car failed, in words; empty where it did not"""


def record_drive(
    controller: Controller,
    plant: Plant | SteppedPlant,
    road: Road,
    plan: SpeedPlan,
    profile: Profile,
    seconds: float = 60.0,
    furthest: float = 10.0,
    speed: SpeedPart | None = None,
) -> Recorded:
    """Drive the beginning of a road with a controller behind a tracker, then `STRETCHES`; keep what went in and out.

    The road is driven through points `RECORDED_SPACING` apart, at a speed planned as `plan` is; profile: of the
    sensors; furthest: m, from the path, as of the exported tracker; speed: the speed control behind it: the drive then
    has a stop, and hills where the road is level. A command takes effect a period after its sample if the controller
    assumes such a computation time, else at once. A controller that learns its steering drives below
    `Learner.first_top_speed`. Where the car leaves the road at planned speeds, the drive is repeated more slowly
    (`SLOWER`). Raises InvalidInput when the controller cannot be tracked, or the road is too short to be driven.
    """
    length = min(road.length, float(plan.speed.max()) * (DRIVEN_SHARE * seconds + RECORDED_LOOKAHEAD))
    points = _points(road, length)
    path = road_through(points, name=road.name)
    points = np.concatenate([points, _bends(path, _tightest(controller))])
    full_path = road_through(points, name=road.name)
    if speed is not None:
        grade = _hills(road, length)
        path, full_path = path.replace(grade=grade), full_path.replace(grade=grade)
    if controller.belief is not None:
        profile = profile.replace(delay=float(controller.belief.computation.value > 0.5 * controller.period))
    control = None if speed is None else speed.control
    is_steady = float(np.ptp(plan.speed)) == 0.0
    for factor in SLOWER[:1] if is_steady else SLOWER:
        planned = _plan(controller, path, plan, speed, factor)
        recorded_plan = _extended(planned, full_path.length)
        twin = Twin(controller, full_path, recorded_plan, furthest, speed)
        driver = _Driver(controller, twin, DRIVEN_SHARE * seconds)
        run = simulate(plant, driver, RoadDrive(path, planned), profile=profile, driver=control)
        failure = find_failure(run)
        if failure is None or failure.time >= DRIVEN_SHARE * seconds:
            failed = ""
            break
        failed = f"at {failure.time:.1f} s the vehicle {failure.clause}"
    calls = len(driver.samples)
    if calls == 0:
        raise InvalidInput(f"export: the road {road.name!r} is too short to be driven.")
    weaves = [stretch._replace(offset=min(stretch.offset, 1.005 * min(furthest, MAX_OFFSET))) for stretch in STRETCHES]
    for sample in _wild(weaves, full_path, path.length, controller, driver.samples[-1][1], np.random.default_rng(0)):
        driver.call(sample)
    return Recorded(points, full_path, recorded_plan, np.array(driver.samples), np.array(driver.answers), calls, failed)


def _wild(
    stretches: Sequence[RecordedStretch],
    path: Road,
    bends: float,
    controller: Controller,
    time: float,
    rng: np.random.Generator,
) -> Iterator[Array]:
    """Samples of a car that goes through stretches, from a time (s) on; bends: m along the path."""
    s, period, car = 0.0, controller.period, controller.vehicle
    for stretch in stretches:
        s, speed = s if math.isnan(stretch.start) else bends + stretch.start, stretch.speed
        for k in range(round(stretch.seconds / period)):
            time, s = time + period, min(max(s + speed * period, 0.0), path.length - 1.0)
            speed = max(speed + stretch.acceleration * period, min(stretch.speed, 0.0))
            foot, turn = path.at(s), 2.0 * math.pi * k * period / stretch.wave
            offset, yaw = stretch.offset * portable.sin(turn), float(foot.heading)
            yaw += stretch.offset / stretch.wave * portable.cos(turn)
            yaw_rate = speed * float(foot.curvature)
            values = [
                float(foot.x) - offset * portable.sin(foot.heading),
                float(foot.y) + offset * portable.cos(foot.heading),
                yaw, speed, yaw_rate, 0.5 * car.lr * yaw_rate, speed * yaw_rate,
                portable.atan((car.lf + car.lr) * float(foot.curvature)),
            ]  # fmt: skip
            for i, (name, deviation) in enumerate(zip(MEASURED, SENSOR_NOISE, strict=True)):
                factor, step = stretch.faults.get(name, (1.0, 0.0)) if portable.sin(turn) > 0.0 else (1.0, 0.0)
                values[i] = factor * values[i] + step + deviation * stretch.noise * rng.normal()
            sample = np.full(len(CALL), math.nan)
            sample[: CALL.friction] = time - stretch.age * rng.random(), time, *values
            sample[CALL.friction : CALL.motion_time] = 0.4 + 0.5 * rng.random(), 5.0 * rng.normal()
            sample[CALL.motion_time] = 0.5 * (sample[CALL.t] + time)
            sample[CALL.longitudinal_acceleration] = stretch.acceleration + 0.1 * rng.normal()
            sample[CALL.driver], sample[CALL.grade] = float(stretch.driver), 0.03 * rng.normal()
            sample[CALL.x :][rng.random(len(CALL) - CALL.x) < stretch.missing] = math.nan
            sample[[getattr(CALL, name) for name in stretch.without]] = math.nan
            yield sample


def _plan(controller: Controller, path: Road, plan: SpeedPlan, speed: SpeedPart | None, factor: float) -> SpeedPlan:
    """The speed that the simulated car drives: as a plan is.

    Its highest speed is that of the plan or that at which learning begins, the lower one, times a factor.
    """
    is_steady, car = float(np.ptp(plan.speed)) == 0.0, controller.vehicle
    learner = getattr(controller, "learner", None)
    top_speed = factor * min(float(plan.speed.max()), math.inf if learner is None else learner.first_top_speed)
    if speed is not None:
        stop = Stop(min(STOP_PLACE, 0.5 * path.length), STOP_SECONDS)
        return plan_speed(path, speed.control.car, plan.comfort, stops=[stop], top_speed=top_speed)
    if is_steady or car is None:
        return constant_speed(path, top_speed)
    return plan_speed(path, car, plan.comfort, top_speed=None if top_speed == plan.speed.max() else top_speed)


def _hills(road: Road, length: float) -> Along:
    """The grade of the beginning of a road, or of hills where it is level."""
    s = np.linspace(0.0, length, max(2, math.ceil(length / RECORDED_SPACING)))
    grade = road.along("grade", s)
    return Along.through(s, grade if grade.any() else HILL_GRADE * portable.sin(2.0 * np.pi * s / HILL_LENGTH))


def _extended(plan: SpeedPlan, length: float) -> RecordedPlan:
    """The speed at fewer places, and slow in the bends up to a length (m)."""
    last = float(plan.s[-1])
    s = np.linspace(0.0, last, max(2, math.ceil(last / RECORDED_SPACING)))
    places, speeds = [*s, last + RECORDED_SPACING, length], [*plan.at(s), BEND_SPEED, BEND_SPEED]
    return RecordedPlan(np.array(places), np.array(speeds), tuple(plan.stops))


def _tightest(controller: Controller) -> float:
    """1/m, curvature of a bend that asks for a little more than the largest wheel angle."""
    most = min(*map(abs, controller.limits.angle), MOST_ANGLE)
    return 1.15 * most / (controller.vehicle.lf + controller.vehicle.lr)


def _points(road: Road, length: float) -> Array:
    """Points of the beginning of a road."""
    along = road.at(np.linspace(0.0, length, max(4, math.ceil(length / RECORDED_SPACING)) + 1))
    return np.stack([along.x, along.y], axis=-1)


def _bends(path: Road, tightest: float) -> Array:
    """Points of a bend to the left and one to the right of a curvature (1/m), behind the end of a path."""
    end = path.at(path.length)
    curvature = np.interp(
        np.arange(0.0, 25.0, BEND_SPACING), [5, 10, 12, 13, 18, 20, 20.5], tightest * np.array([0, 1, 1, 0, -1, -1, 0])
    )
    heading = float(end.heading) + BEND_SPACING * np.cumsum(curvature)
    steps = BEND_SPACING * np.stack([portable.cos(heading), portable.sin(heading)], axis=-1)
    return np.array([float(end.x), float(end.y)]) + np.cumsum(steps, axis=0)


class _Driver(SampledController):
    """A tracker as the controller of a simulated drive; what it is given and gives is kept."""

    def __init__(self, controller: Controller, twin: Twin, seconds: float) -> None:
        self.period, self.limits, self.vehicle = controller.period, controller.limits, controller.vehicle
        self._twin, self._seconds = twin, seconds
        self.samples: list[Array] = []
        self.answers: list[Array] = []

    def answer(self, sample: Array) -> float:
        return self.call(sample) if sample[CALL.now] < self._seconds else 0.0

    def call(self, sample: Array) -> float:
        """Keep a call, and return its command (rad)."""
        answer = self._twin.call(sample)
        self.samples.append(sample)
        self.answers.append(answer)
        return float(answer[TRACKED.command])

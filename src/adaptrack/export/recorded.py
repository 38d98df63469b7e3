"""A drive that travels with an exported controller: what was measured, and what the tracker answered here."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from adaptrack.base.errors import InvalidInput
from adaptrack.cars.plant import Plant, SteppedPlant
from adaptrack.control.controllers import Controller
from adaptrack.core.models.contract import MEASURED
from adaptrack.core.tracker.records import SAMPLE as CALL
from adaptrack.core.tracker.records import TRACKED
from adaptrack.drive.failure import find_failure
from adaptrack.drive.simulate import simulate
from adaptrack.export.tracking import Twin
from adaptrack.road import Road, SpeedPlan, plan_speed, road_through
from adaptrack.road.ahead import RoadAhead
from adaptrack.road.speed import constant_speed
from adaptrack.scenario import RoadDrive
from adaptrack.scenario.profile import Profile

Array = NDArray[np.float64]
SPACING = 5.0
"""m, between the points of the path: what a planner would send."""
AHEAD = 10.0
"""s, at the highest speed, that the path goes on behind the end of the record."""
SAMPLE = CALL._fields[:10]
"""Columns of `Recorded.samples`; friction and wind are not known."""
ANSWER = TRACKED._fields[:5]
"""Columns of `Recorded.answers`: command, status, offset, heading error, station."""


@dataclass(frozen=True, eq=False)
class Recorded:
    """A path through points, a planned speed along it, calls, and answers."""

    points: Array
    """(n, 2) m"""
    closed: bool
    plan: SpeedPlan
    """every `SPACING`; of it the tracker knows place and speed"""
    samples: Array
    """(calls, SAMPLE)"""
    answers: Array
    """(calls, ANSWER)"""
    failed: str = ""
    """when and why the car failed, in words; empty where it did not"""


def record_drive(
    controller: Controller,
    plant: Plant | SteppedPlant,
    road: Road,
    plan: SpeedPlan,
    profile: Profile,
    seconds: float = 60.0,
    seed: int = 0,
) -> Recorded:
    """Drive the beginning of a road with a controller behind a tracker, and keep what went in and out.

    The road is driven through points `SPACING` apart, at a speed planned as `plan` is; profile: of the sensors. A
    command takes effect a period after its sample if the controller assumes such a computation time, else at once.

    Raises
    ------
    InvalidInput
        When the controller cannot be tracked, or the drive ends before its first instant.
    """
    points, closed = _points(road, seconds, float(plan.speed.max()))
    path = road_through(points, closed=closed, name=road.name)
    steady = float(np.ptp(plan.speed)) == 0.0
    car = getattr(controller, "vehicle", None)
    planned = (
        constant_speed(path, float(plan.speed[0])) if steady or car is None else plan_speed(path, car, plan.comfort)
    )
    driver = _Driver(controller, path, _thinned(planned), seconds)
    if controller.belief is not None:
        profile = profile.replace(delay=float(controller.belief.computation.value > 0.5 * controller.period))
    run = simulate(plant, driver, RoadDrive(path, planned), profile=profile, seed=seed)
    found = find_failure(run)
    failed = f"at {found.time:.1f} s the vehicle {found.clause}" if found is not None and found.time < seconds else ""
    if not driver.samples:
        raise InvalidInput(f"export: the road {road.name!r} is too short to be driven.")
    return Recorded(points, closed, driver.plan, np.array(driver.samples), np.array(driver.answers), failed)


def _thinned(plan: SpeedPlan) -> SpeedPlan:
    """The speed at fewer places."""
    s = np.linspace(0.0, float(plan.s[-1]), max(2, math.ceil(float(plan.s[-1]) / SPACING)))
    return replace(plan, s=s, speed=plan.at(s))


def _points(road: Road, seconds: float, fastest: float) -> tuple[Array, bool]:
    """Points of the beginning of a road, and whether they make a lap."""
    length = min(road.length, fastest * (seconds + AHEAD))
    closed = road.closed and length == road.length
    count = max(4, math.ceil(length / SPACING))
    along = road.at(np.linspace(0.0, length, count + 1)[: count if closed else count + 1])
    return np.stack([along.x, along.y], axis=-1), closed


class _Driver(Controller):
    """A tracker as the controller of a simulated drive; what it is given and gives is kept."""

    period: float
    sees_all_sensors = True

    def __init__(self, controller: Controller, path: Road, plan: SpeedPlan, seconds: float) -> None:
        self.period, self.limits, self.vehicle = controller.period, controller.limits, controller.vehicle
        self.plan, self._twin = plan, Twin(controller, path, plan)
        self._instant, self._seconds = 0, seconds
        self.samples: list[tuple[float, ...]] = []
        self.answers: list[tuple[float, ...]] = []

    def step(
        self, state: Any, speed: float, reference: Any, variables: Any = None, road: RoadAhead | None = None
    ) -> float:
        now, measured = self._instant * self.period, np.asarray(state, dtype=float)
        assert road is not None
        age = float(measured[MEASURED.pose_age])
        age = age if math.isfinite(age) else 0.0
        foot = road.road.at(road.station - age * speed)
        offset, yaw = float(measured[MEASURED.y]), float(foot.heading) + float(measured[MEASURED.yaw])
        x, y = float(foot.x) - offset * math.sin(foot.heading), float(foot.y) + offset * math.cos(foot.heading)
        rest = [float(measured[i]) for i in (MEASURED.yaw_rate, MEASURED.vy, MEASURED.lateral_acceleration)]
        sample = (now - age, now, x, y, yaw, float(speed), *rest, float(measured[MEASURED.wheel_angle]))
        found = self._twin.call(sample)
        if now < self._seconds:
            self.samples.append(sample)
            self.answers.append(tuple(found[:5].tolist()))
        self._instant += 1
        return float(found[TRACKED.command])

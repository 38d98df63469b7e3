"""How hard a car can corner, against the plant that is driven."""

from __future__ import annotations

import math

import numpy as np
import pytest

import adaptrack as at
from adaptrack.road import Arc, Clothoid, Comfort, Line
from adaptrack.road.speed import cornering_limit, steering_limit

BENDS = np.linspace(0.0, 0.15, 20)


@pytest.mark.parametrize("name", at.list_vehicles())
def test_less_friction_and_tighter_bends_leave_less_and_a_plan_asks_for_no_more(name):
    car, road = at.load_vehicle(name), at.generate_road("mountain", 2, 1500.0)
    dry, wet = cornering_limit(car, BENDS, 0.9), cornering_limit(car, BENDS, 0.5)
    assert np.all(np.diff(dry) <= 0.05)  # the grid of accelerations
    assert np.all(wet < dry)
    assert dry[0] < 1.05 * 0.9 * 9.81  # a lightly loaded tyre has a little more
    tightest = math.tan(min(steering_limit(car), 1.5)) / car.wheelbase
    assert cornering_limit(car, [1.01 * tightest], [0.9])[0] == 0.0
    assert cornering_limit(car, [0.5 * tightest], [0.9])[0] > 1.0
    plan = at.plan_speed(road, car, Comfort(lateral=20.0))
    bend = np.abs(road.at(plan.s).curvature)
    assert np.all(plan.speed**2 * bend <= 0.9 * cornering_limit(car, bend, np.full(bend.shape, 0.9)) + 0.05)


@pytest.mark.compiled
@pytest.mark.parametrize(
    "name", [name for name in at.list_vehicles() if name != "model-car"]
)  # 20 m/s is not its world
def test_below_the_limit_the_plant_holds_a_circle_and_above_it_does_not(name):
    car, radius = at.load_vehicle(name), 50.0
    limit = cornering_limit(car, [1 / radius], [0.9])[0]
    circle = at.Road.from_segments(
        [Line(length=30.0), Clothoid(length=60.0, start_curvature=0.0, end_curvature=1 / radius),
         Arc(length=350.0, curvature=1 / radius)], name="circle", friction=0.9,
    )  # fmt: skip
    speeds = [math.sqrt(share * limit * radius) for share in (0.9, 1.15)]
    below, lost = (
        at.rollout(at.DualTrack(car), at.MPC(car, profile="road"), at.RoadDrive(circle, speed), profile="road")
        for speed in speeds
    )
    assert below.failed is None
    assert np.abs(below.error).max() < 0.25
    assert lost.failed is not None or np.abs(lost.error).max() > 0.5

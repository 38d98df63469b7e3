"""A loop that regulates the speed itself stands at the stops of its plan, for their time, and drives on."""

import math

import numpy as np
import pytest

from adaptrack.cars.vehicle import load_vehicle
from adaptrack.control.controllers import Stanley
from adaptrack.control.tracker import SpeedTarget, Status, Tracker
from adaptrack.road import Arc, Line, Road, SpeedPlan, Stop, plan_speed

CAR = load_vehicle("midsize-sedan")
STRAIGHT = Road.from_segments([Line(length=200.0)], speed_limit=12.0)
LAP = Road.from_segments([Arc(length=200.0, curvature=2.0 * math.pi / 200.0)], closed=True, speed_limit=8.0)
PERIOD = 0.05


def drive(target, seconds, lag=0.3, place=0.0, speed=0.0, replan=None):
    """Rows of time, place and speed of a car whose speed follows the target with a lag (s)."""
    rows = []
    for k in range(round(seconds / PERIOD)):
        if replan is not None and k % 2 == 0:
            target.follow(replan)
        goal = target.at(k * PERIOD, place, speed, PERIOD)
        speed = max(speed + (goal - speed) * PERIOD / lag, 0.0) if goal > 0.0 or speed > 0.05 else 0.0
        place += speed * PERIOD
        rows.append((k * PERIOD, place, speed))
    return np.array(rows)


def stands(rows):
    """Places (m) at which the car stood, and for how long (s)."""
    still = rows[:, 2] < 0.1
    runs = np.split(rows, np.flatnonzero(np.diff(still)) + 1)
    return [(run[0, 1], len(run) * PERIOD) for run in runs if run[0, 2] < 0.1 and len(run) > 4]


@pytest.mark.parametrize("lag", [0.05, 0.3])
def test_a_car_stands_at_every_stop_for_its_time_and_drives_on(lag):
    plan = plan_speed(STRAIGHT, CAR, start=0.0, end=0.0, stops=[Stop(60.0, 3.0), 60.1, Stop(120.0, 1.0)])
    *halts, last = stands(drive(SpeedTarget(plan), 60.0, lag))
    assert [place for place, _ in halts] == pytest.approx([60.0, 120.0], abs=0.5)
    assert [time for _, time in halts] == pytest.approx([3.0, 1.0], abs=0.6)
    assert last[0] == pytest.approx(200.0, abs=0.5)


def test_a_lap_has_its_stops_on_every_lap():
    plan = plan_speed(LAP, CAR, stops=[Stop(0.0, 1.0), Stop(150.0, 2.0)])
    halts = stands(drive(SpeedTarget(plan), 120.0, place=10.0, speed=5.0))
    assert [place for place, _ in halts][:4] == pytest.approx([150.0, 200.0, 350.0, 400.0], abs=0.6)


def test_a_plan_that_is_followed_again_keeps_its_stop_although_the_car_is_beyond_it():
    """A planner that says the same ten times a second; the car overshoots the stop by its lag."""
    plan = plan_speed(STRAIGHT, CAR, start=0.0, stops=[Stop(60.0, 1e9)])
    rows = drive(SpeedTarget(plan), 60.0, lag=0.3, replan=plan)
    assert 59.5 < rows[-1, 1] < 60.9
    plan_without = plan_speed(STRAIGHT, CAR, start=0.0)
    target = SpeedTarget(plan)
    assert target.at(0.0, 59.95, 0.0, PERIOD) == 0.0
    target.follow(plan_without)
    assert target.at(0.1, 60.05, 0.0, PERIOD) > 0.0


def test_the_stops_of_a_plan_are_those_that_it_was_made_with():
    plan = plan_speed(LAP, CAR, stops=[Stop(150.0, 2.0), 0.0])
    assert plan.stops == [Stop(0.0, 0.0), Stop(pytest.approx(150.0), pytest.approx(2.0))]
    assert plan_speed(STRAIGHT, CAR, end=0.0).stops == []
    still = SpeedPlan(np.array([0.0, 5.0, 9.0]), np.array([2.0, 0.0, 0.0]), np.array([0.0, 5.0, math.inf]),
                      math.inf, False, plan.comfort)  # fmt: skip
    assert still.stops == [Stop(5.0, math.inf)]


def test_a_tracker_has_the_target_speed_of_its_plan_and_0_at_a_stop():
    plan = plan_speed(STRAIGHT, CAR, stops=[Stop(60.0, 1.0)])
    tracker = Tracker(Stanley(CAR, period=PERIOD), STRAIGHT, plan=plan)
    answer = tracker.step(0.0, 20.0, 0.0, 0.0, 10.0)
    assert answer.target_speed == pytest.approx(float(plan.at(20.5)))
    targets = [tracker.step(PERIOD * k, 60.05, 0.0, 0.0, 0.0).target_speed for k in range(80, 120)]
    assert set(targets[:20]) == {0.0}
    assert targets[-1] > 0.5
    assert math.isnan(tracker.step(9.0, *(math.nan,) * 4).target_speed)
    tracker.follow(STRAIGHT)
    assert math.isnan(tracker.step(9.1, 61.0, 0.0, 0.0, 0.0).target_speed)
    assert tracker.step(9.2, 62.0, 0.0, 0.0, 5.0).status is Status.OK

"""Autoware's follower behind a planner: what tells its two modes apart."""

import numpy as np
import pytest

import adaptrack as at
from adaptrack.drive.planner import SimulatedPlanner
from adaptrack.road import Arc, Comfort, Line, Stop, plan_speed
from adaptrack.road.planned_trajectory import PlannedTrajectory
from autoware_follow import AutowareController, AutowareFollow

CAR = at.load_vehicle("midsize-sedan")


def line(x, speed, stamp=10.0):
    """A trajectory along the x axis through places that are ahead of or behind a car at 0."""
    x = np.asarray(x, dtype=float)
    return PlannedTrajectory((x - x[0]) / speed, x, np.zeros_like(x), speed=np.full(x.size, speed), stamp=stamp)


def command(mode, time, y=0.3):
    """The steering command (rad) of a car at x = 0, beside a line that bends to the left from x = 30 m on."""
    follow = AutowareFollow(CAR, "road", mode)
    x = np.linspace(-10.0, 60.0, 71)
    bent = 0.5 * 0.02 * np.maximum(x - 30.0, 0.0) ** 2
    t = (x + 10.0) / 10.0
    follow.follow(PlannedTrajectory(t, x, bent, speed=np.full(x.size, 10.0), stamp=10.0), now=10.0)
    signals = {"lateral_velocity": 0.0, "now": time}
    return [follow.step(time, 0.0, y, 0.0, 10.0, 0.0, **signals).command for _ in range(3)][-1]


def test_on_time_both_modes_steer_alike_and_an_error_in_time_moves_only_the_temporal_one():
    assert command("temporal", 11.0) == pytest.approx(command("spatial", 11.0), abs=1e-6)
    assert command("spatial", 14.0) == pytest.approx(command("spatial", 11.0), abs=1e-9)
    assert command("temporal", 14.0) > command("temporal", 11.0) + 0.01  # the reference is 30 m ahead, in the bend


@pytest.mark.parametrize("mode", ["spatial", "temporal"])
def test_a_missing_pose_is_carried_on_with_speed_and_yaw_rate(mode):
    follow = AutowareFollow(CAR, "road", mode)
    follow.follow(line(np.linspace(-10.0, 60.0, 71), 10.0), now=10.0)
    signals = {"lateral_velocity": 0.0}
    follow.step(11.0, 0.0, 0.2, 0.0, 10.0, 0.0, now=11.0, **signals)
    follow.step(11.0, np.nan, np.nan, np.nan, 10.0, 0.0, now=11.05, **signals)
    assert follow._pose[1:3] == pytest.approx((0.5, 0.2))


@pytest.mark.compiled
@pytest.mark.parametrize("mode", ["spatial", "temporal"])
def test_a_car_keeps_to_the_line_of_its_planner_stands_at_the_stop_and_goes_on(mode):
    road = at.Road.from_segments([Line(length=100.0), Arc(length=150.0, curvature=0.01)])
    plan = plan_speed(road, CAR, Comfort(accelerate=1.0, brake=1.0), top_speed=10.0, stops=[Stop(100.0, 3.0)])
    controller = AutowareController(CAR, SimulatedPlanner(), profile="road", mode=mode)
    run = at.simulate(at.DualTrack(CAR), controller, at.RoadDrive(road, plan), profile="road", seed=3)
    assert run.failed is None
    assert np.abs(run.road["offset"]).max() < 0.5
    stands = run.vx < 0.01
    assert 1.0 < run.period * stands.sum() < 6.0
    assert np.abs(run.road["station"][stands] - 100.0).max() < 1.5
    assert run.road["station"][-1] > 200.0

"""A tracker whose path is that of an axle, in a loop with a car that rolls without slipping."""

import math

import numpy as np
import pytest

import adaptrack as at
from adaptrack.control.following import Following
from adaptrack.control.tracker import AT_STOP
from adaptrack.road import Arc, Clothoid, Comfort, Line, Road, Stop
from adaptrack.road.speed import constant_speed
from foreign_loop import drive, on_road

pytestmark = pytest.mark.kernels

CAR = at.load_vehicle("paper")
AXLES = {"rear axle": -CAR.lr, "front axle": CAR.lf}
PERIOD, LAG = 0.05, 0.15
RADIUS = 12.0
ENTRY = Clothoid(length=12.0, start_curvature=0.0, end_curvature=1.0 / RADIUS)
BEND = Road.from_segments([Line(length=10.0), ENTRY, Arc(length=60.0, curvature=1.0 / RADIUS)])


def make_tracker(path, point, **options):
    steering = at.Steering(lag=LAG, dead_time=0.0, rate=0.5)
    controller = at.MPC(CAR, profile="road", computation=0.0, belief=steering)
    return at.Tracker(controller, path, following=Following(tracked_point=point), **options)


def axle_on(road, axle, yaw):
    """(x, y, yaw) of the rear axle of a car whose axle is at the start of a road."""
    place, back = road.at(0.0), 0.0 if axle == "rear axle" else CAR.wheelbase
    return float(place.x) - back * math.cos(yaw), float(place.y) - back * math.sin(yaw), yaw


def roll(tracker, start, seconds, speed=None):
    """Drive from a pose of the rear axle at a speed (m/s); None: as the speed control requests.

    (n, 4): x, y (m) of the rear axle, yaw (rad) and speed (m/s) at the calls; and their results.
    """
    (x, y, yaw), angle, v, states, results = start, 0.0, speed or 0.0, [], []
    for k in range(round(seconds / PERIOD)):
        rate = v * math.tan(angle) / CAR.wheelbase
        centre = x + CAR.lr * math.cos(yaw), y + CAR.lr * math.sin(yaw)
        out = tracker.step(PERIOD * k, *centre, yaw, v, rate, lateral_velocity=CAR.lr * rate)
        states.append((x, y, yaw, v))
        results.append(out)
        for _ in range(25):
            step = PERIOD / 25.0
            angle += step / LAG * (out.command - angle)
            if (request := out.longitudinal) is not None:
                v = max(v + step * (request.acceleration - request.hold / CAR.mass), 0.0)
            yaw += step * v * math.tan(angle) / CAR.wheelbase
            x, y = x + step * v * math.cos(yaw), y + step * v * math.sin(yaw)
    return np.array(states), results


def axle_of(states, axle):
    """x and y (m) of an axle."""
    x, y, yaw, _ = states.T
    ahead = 0.0 if axle == "rear axle" else CAR.wheelbase
    return x + ahead * np.cos(yaw), y + ahead * np.sin(yaw)


@pytest.mark.compiled
@pytest.mark.parametrize("axle", AXLES)
def test_the_tracked_axle_runs_along_the_path_in_a_steady_turn(axle):
    states, _ = roll(make_tracker(BEND, axle), axle_on(BEND, axle, 0.0), 38.0, speed=2.0)
    steady = states[-200:]
    assert np.abs(BEND.project(*axle_of(steady, axle)).offset).max() < 0.005


@pytest.mark.compiled
def test_without_conversion_the_rear_axle_runs_inside_by_l_r_squared_over_twice_the_radius():
    states, _ = roll(make_tracker(BEND, "centre of mass"), axle_on(BEND, "rear axle", 0.0), 38.0, speed=2.0)
    inside = BEND.project(*axle_of(states[-200:], "rear axle")).offset
    np.testing.assert_allclose(inside, CAR.lr**2 / (2.0 * RADIUS), rtol=0.05)


@pytest.mark.compiled
def test_a_lap_is_driven_by_the_rear_axle_from_its_second_round_on():
    lap = Road.from_segments([Arc(length=2.0 * math.pi * RADIUS, curvature=1.0 / RADIUS)], closed=True)
    states, results = roll(make_tracker(lap, "rear axle"), (0.0, 0.0, 0.0), 80.0, speed=2.0)
    assert np.abs(lap.project(*axle_of(states[-500:], "rear axle")).offset).max() < 0.005
    assert results[-1].station == pytest.approx(160.0 * math.hypot(1.0, CAR.lr / RADIUS), rel=0.01)


@pytest.mark.compiled
@pytest.mark.parametrize("axle", AXLES)
def test_a_tracked_axle_whose_tyres_slip_runs_along_a_path_with_a_plan(axle):
    """At 2.9 m/s^2 the rear axle slips outwards by 5 cm; without a plan the tracker does not know the speed."""
    ramp = Clothoid(length=30.0, start_curvature=0.0, end_curvature=0.02)
    road, arm = Road.from_segments([Line(length=20.0), ramp, Arc(length=250.0, curvature=0.02)]), AXLES[axle]
    places = []

    def note_axle(t, car, tracker):
        places.append((car.x + arm * math.cos(car.yaw), car.y + arm * math.sin(car.yaw)))

    tracker = make_tracker(road, axle, plan=constant_speed(road, 12.0))
    drive(tracker, road, 23.0, car=on_road(road, speed=12.0), noise=(0.0,) * 5, before_call=note_axle)
    offset = road.project(*np.transpose(places)).offset
    assert np.abs(offset[-100:]).max() < 0.002
    assert np.abs(offset).max() < 0.02


@pytest.mark.compiled
@pytest.mark.parametrize("axle", AXLES)
def test_the_tracked_axle_stops_at_the_stop_and_at_the_end(axle):
    plan = at.plan_speed(BEND, CAR, Comfort(lateral=1.0), top_speed=4.0, stops=[Stop(40.0, 3.0)], start=0.0, end=0.0)
    tracker = make_tracker(BEND, axle, plan=plan, speed=at.SpeedControl(CAR))
    states, results = roll(tracker, axle_on(BEND, axle, 0.0), 60.0)
    station, stands = BEND.project(*axle_of(states, axle)).s, states[:, 3] < 1e-3
    at_stop = stands & (np.abs(station - 40.0) < 5.0)
    assert at_stop.sum() * PERIOD == pytest.approx(3.0, abs=1.0)
    assert np.abs(station[at_stop] - 40.0).max() < AT_STOP
    missed = np.array([out.station for out in results])[at_stop] - tracker.plan.stops[0].s
    np.testing.assert_allclose(station[at_stop] - 40.0, missed, atol=0.01)
    assert station[-1] == pytest.approx(BEND.length, abs=AT_STOP)


def test_a_path_that_is_followed_later_is_one_of_the_tracked_point_too():
    tracker = make_tracker(BEND, "rear axle")
    path, other = tracker.path, at.generate_road("country", seed=2, length=200.0)
    tracker.follow(other)
    assert tracker.path.at(0.0).x == pytest.approx(float(other.at(0.0).x) + CAR.lr, abs=0.05)
    tracker.follow(BEND)
    np.testing.assert_array_equal(tracker.path.table.pieces, path.table.pieces)


def test_a_path_that_the_axle_cannot_follow_is_refused_and_the_one_before_is_kept():
    tracker = make_tracker(BEND, "rear axle")
    path = tracker.path
    with pytest.raises(at.InvalidInput, match="below the wheelbase"):
        tracker.follow(Road.from_segments([Line(length=10.0), Arc(length=3.0, curvature=0.5)]))
    assert tracker.path is path

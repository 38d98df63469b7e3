"""Paths of an axle and their plans, converted to those of the centre of mass."""

import math

import numpy as np
import pytest

import adaptrack as at
from adaptrack.base.errors import InvalidInput
from adaptrack.road import Along, Arc, Clothoid, Line, Road, Stop, convert_axle_path, road_through
from adaptrack.road.axle_path import AXLE_PATH_SPACING, MAX_ROUNDING
from adaptrack.road.speed import constant_speed

CAR = at.load_vehicle("paper")
ARMS = {"rear axle": -CAR.lr, "front axle": CAR.lf}
RADIUS = 12.0


def circle(sign=1.0, **along):
    return Road.from_segments([Arc(length=2.0 * math.pi * RADIUS, curvature=sign / RADIUS)], closed=True, **along)


def centre_radius(axle):
    """Radius (m) on which the centre of mass of a rolling car moves while its axle moves on a circle."""
    rear = RADIUS if axle == "rear axle" else math.sqrt(RADIUS**2 - CAR.wheelbase**2)
    return math.hypot(rear, CAR.lr)


def shifted(road, arm):
    """Points at `arm` (m) ahead of a road along its heading, (n,) x and y."""
    place = road.at(np.linspace(0.0, road.length, 4001))
    return place.x + arm * np.cos(place.heading), place.y + arm * np.sin(place.heading)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("axle", ARMS)
def test_an_axle_on_a_circle_leads_the_centre_of_mass_along_a_concentric_circle(axle, sign):
    path, radius = convert_axle_path(circle(sign), None, CAR, axle)[0], centre_radius(axle)
    place = path.at(np.linspace(0.0, path.length, 400))
    assert path.closed
    assert path.length == pytest.approx(2.0 * math.pi * radius, abs=1e-5)
    np.testing.assert_allclose(np.hypot(place.x, place.y - sign * RADIUS), radius, atol=1e-6)
    np.testing.assert_allclose(place.curvature, sign / radius, rtol=2e-4)


@pytest.mark.parametrize("axle", ARMS)
def test_slip_at_the_planned_speed_turns_the_car_into_the_bend(axle):
    """The rear tyres carry their share l_f / wheelbase of m v^2 / radius at the slip angle."""
    lap, speed = circle(), 4.0
    slip = CAR.mass * speed**2 / RADIUS * CAR.lf / CAR.wheelbase / (2.0 * CAR.stiffness_rear)
    to_path = slip if axle == "rear axle" else slip - math.asin(CAR.wheelbase / RADIUS)  # rad, from the path to the yaw
    radius = math.sqrt(RADIUS**2 + ARMS[axle] ** 2 + 2.0 * RADIUS * ARMS[axle] * math.sin(to_path))
    place = convert_axle_path(lap, constant_speed(lap, speed), CAR, axle)[0].at([0.0, 20.0, 40.0])
    np.testing.assert_allclose(np.hypot(place.x, place.y - RADIUS), radius, atol=1e-6)
    assert abs(radius - centre_radius(axle)) > 0.01


@pytest.mark.parametrize("axle", ARMS)
def test_a_straight_line_and_its_plan_move_by_the_arm(axle):
    road = Road.from_segments([Line(length=80.0)])
    plan = at.plan_speed(road, CAR, stops=[Stop(30.0, 2.0)], start=0.0, end=0.0)
    path, moved = convert_axle_path(road, plan, CAR, axle)
    np.testing.assert_allclose(path.at([0.0, 80.0])[:2], [[-ARMS[axle], 80.0 - ARMS[axle]], [0.0, 0.0]], atol=1e-9)
    for name in ("s", "speed", "time"):
        np.testing.assert_allclose(getattr(moved, name), getattr(plan, name), atol=1e-9)


def test_a_line_through_the_front_axle_of_a_car_converts_as_that_through_its_rear_axle():
    rear = at.generate_road("country", seed=3, length=800.0)
    front = road_through(np.stack(shifted(rear, CAR.wheelbase), axis=-1), noise=0.0)
    path, other = (
        convert_axle_path(road, None, CAR, axle)[0] for road, axle in ((rear, "rear axle"), (front, "front axle"))
    )
    place = path.at(np.linspace(0.0, path.length, 2000))
    foot = other.project(place.x, place.y)
    assert np.abs(foot.offset).max() < 1e-6
    np.testing.assert_allclose(foot.curvature, place.curvature, atol=1e-5)


def test_the_curvature_of_a_converted_clothoid_is_the_analytic_one():
    end = 1.0 / RADIUS
    road = Road.from_segments([Line(length=10.0), Clothoid(length=20.0, start_curvature=0.0, end_curvature=end)])
    path = convert_axle_path(road, None, CAR, "rear axle")[0]
    s = np.linspace(12.0, 28.0, 200)
    k, rate = road.at(s).curvature, end / 20.0
    stretch = np.hypot(1.0, CAR.lr * k)
    place = road.at(s)
    x, y = place.x + CAR.lr * np.cos(place.heading), place.y + CAR.lr * np.sin(place.heading)
    expected = (k + CAR.lr * rate / stretch**2) / stretch
    np.testing.assert_allclose(path.project(x, y).curvature, expected, atol=5e-4 * end)


@pytest.mark.parametrize("radius", [6.0, 20.0, 50.0])
def test_jumps_of_curvature_are_rounded_within_the_bound(radius):
    road = Road.from_segments([Line(length=30.0), Arc(length=1.5 * radius, curvature=1.0 / radius), Line(length=30.0)])
    path = convert_axle_path(road, None, CAR, "rear axle")[0]
    # The rear axle of a car whose centre of mass follows the converted path trails it, as an axle 2 l_r behind would
    # trail a front axle: dpsi/ds = sin(course - psi)/l_r.
    s = np.linspace(0.0, path.length, 20001)
    place, psi, rear = path.at(s), 0.0, []
    for k in range(s.size):
        rear.append((place.x[k] - CAR.lr * math.cos(psi), place.y[k] - CAR.lr * math.sin(psi)))
        psi += (s[1] - s[0]) / CAR.lr * math.sin(place.heading[k] - psi)
    offset = road.project(*np.transpose(rear)).offset
    assert 0.2 * MAX_ROUNDING < np.abs(offset).max() < 1.2 * MAX_ROUNDING
    assert not path.curvature_jumps()
    assert "jumps of curvature" in path.notes[-1]


@pytest.mark.parametrize("axle", ARMS)
def test_planned_speeds_are_those_of_the_centre_of_mass_and_times_do_not_change(axle):
    lap = circle()
    plan = at.plan_speed(lap, CAR, top_speed=1.0, stops=[Stop(20.0, 2.0)])
    moved, stretch = convert_axle_path(lap, plan, CAR, axle)[1], centre_radius(axle) / RADIUS
    np.testing.assert_allclose(moved.speed, stretch * plan.speed, rtol=2e-4)
    np.testing.assert_allclose(moved.s, stretch * plan.s, rtol=2e-4)
    np.testing.assert_allclose(moved.time, plan.time, atol=0.01)
    assert moved.duration == pytest.approx(plan.duration, abs=0.01)


def test_stops_last_as_long_in_a_bend_that_tightens():
    road = Road.from_segments([Clothoid(length=40.0, start_curvature=0.0, end_curvature=1.0 / RADIUS)])
    stops = [Stop(25.3, 4.0), Stop(30.0, 0.0), Stop(35.0, math.inf)]
    plan = at.plan_speed(road, CAR, top_speed=1.0, stops=stops, start=0.0, end=0.0)
    path, moved = convert_axle_path(road, plan, CAR, "rear axle")
    assert [stop.seconds for stop in moved.stops] == [stop.seconds for stop in plan.stops]
    place = path.at([stop.s for stop in moved.stops])
    axle = road.at([stop.s for stop in plan.stops])
    x, y = axle.x + CAR.lr * np.cos(axle.heading), axle.y + CAR.lr * np.sin(axle.heading)
    np.testing.assert_allclose([place.x, place.y], [x, y], atol=2e-3)


@pytest.mark.parametrize("axle", ARMS)
def test_what_lies_along_a_lap_stays_where_it_is(axle):
    """A slippery sector that lies across the seam, a limit that rises linearly, and edges."""
    length = 2.0 * math.pi * RADIUS
    friction = Along(s=(0.0, 10.0, length - 10.0), value=(0.4, 0.9, 0.4), kind="steps")
    lap = circle(friction=friction, speed_limit=((0.0, 0.5 * length, length), (5.0, 10.0, 5.0)), width_left=2.0)
    path = convert_axle_path(lap, None, CAR, axle)[0]
    s = np.linspace(0.0, path.length, 500, endpoint=False)
    place = path.at(s)
    foot = lap.project(place.x, place.y)
    np.testing.assert_allclose(path.along("speed_limit", s), lap.along("speed_limit", foot.s), atol=0.1)
    edge = np.minimum(np.abs(foot.s - 10.0), np.abs(foot.s - length + 10.0)) > AXLE_PATH_SPACING
    np.testing.assert_array_equal(path.along("friction", s)[edge], lap.along("friction", foot.s)[edge])
    left, _ = path.edges(s)
    np.testing.assert_allclose(np.hypot(left[:, 0], left[:, 1] - RADIUS), RADIUS - 2.0, atol=1e-6)


@pytest.mark.parametrize("axle", ARMS)
def test_a_bend_tighter_than_the_wheelbase_is_refused(axle):
    road = Road.from_segments([Line(length=10.0), Arc(length=3.0, curvature=-0.5)])
    with pytest.raises(InvalidInput, match=rf"path of the {axle}: its radius at s = 1.* below the wheelbase of 2.8 m"):
        convert_axle_path(road, None, CAR, axle)


def test_a_plan_of_another_road_and_an_unknown_axle_are_refused():
    road, other = (Road.from_segments([Line(length=length)]) for length in (40.0, 50.0))
    with pytest.raises(InvalidInput, match="plan: must be a SpeedPlan of this road"):
        convert_axle_path(road, at.plan_speed(other, CAR), CAR, "rear axle")
    with pytest.raises(InvalidInput, match="rear axle"):
        convert_axle_path(road, None, CAR, "rear")

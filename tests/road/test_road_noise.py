"""Recorded roads: noise is told from road, outliers from both, and what a bound did to a road is said."""

import math

import numpy as np
import pytest
from scipy.interpolate import BSpline

from adaptrack.base.errors import InvalidInput
from adaptrack.cars.vehicle import load_vehicle
from adaptrack.road import check_road, fit_road, generate_road, plan_speed, road_through
from adaptrack.road.smoothing import Smoother

CAR = load_vehicle("midsize-sedan")
STEP = 1.3
"""m, from point to point"""


def recorded(kind="country", noise=0.0, seed=0, step=STEP, length=900.0):
    """A generated road, and points of it (n, 2) with independent errors."""
    true = generate_road(kind, seed=1, length=length)
    points = np.stack(true.at(np.arange(0.0, true.length, step))[:2], axis=-1)
    return true, points + noise * np.random.default_rng(seed).standard_normal(points.shape)


def away(road, true):
    """m, the largest distance of the true centre line from a road, but for its ends."""
    return np.abs(road.project(*true.at(np.linspace(0.01, 0.99, 400) * true.length)[:2]).offset).max()


# -- noise ------------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(("kind", "noise"), [("country", 0.2), ("country", 0.5), ("lap", 0.2)])
def test_a_record_with_noise_is_planned_as_the_road_that_it_is_of(kind, noise):
    true, points = recorded(kind, noise)
    road = fit_road(points, speed_limit=true.speed_limit)
    assert plan_speed(road, CAR).duration == pytest.approx(plan_speed(true, CAR).duration, rel=0.03)
    assert away(road, true) < 1.2 * noise
    assert 3.0 * noise < road.deviation < 6.0 * noise  # the noise of 700 points, not a bound on it
    assert not any("bound" in note or "outliers" in note for note in road.notes)


def test_points_without_noise_are_met_whatever_the_distance_between_them():
    for step in (STEP, 15.0):
        true, points = recorded("town", step=step)
        road = fit_road(points)
        assert road.deviation <= 0.5
        assert away(road, true) < (0.02 if step == STEP else 1.5)
        assert road.curvature_jumps() == []
        assert not any("outliers" in note for note in road.notes)


def test_a_road_has_no_more_pieces_than_its_smoothness_asks_for():
    _, points = recorded(noise=0.2)
    assert len(fit_road(points).elements) < len(points) / 3
    assert len(fit_road(recorded()[1]).elements) > len(points) / 2


@pytest.mark.parametrize("closed", [False, True])
@pytest.mark.parametrize("scale", [3.0, 40.0])
def test_the_curve_is_the_least_of_the_sum_that_it_is_said_to_minimise(closed, scale):
    rng = np.random.default_rng(2)
    length, n, spacing = 120.0, 80, 2.0
    places = np.sort(rng.uniform(0.0, length, n))
    angle = 2.0 * math.pi * places / length
    points = 20.0 * np.stack([np.cos(angle), np.sin(angle)], axis=-1) + 0.3 * rng.standard_normal((n, 2))
    smoother = Smoother(points, places, length, closed, spacing)
    count = math.ceil(length / max(spacing, scale / 10.0))
    knot = length / count
    basis = BSpline.design_matrix(places, knot * np.arange(-3, count + 4), 3).toarray()
    rough = np.diff(np.eye(count + 3), 3, axis=0) / knot**2.5
    if closed:  # the last three coefficients are the first three
        once = np.eye(count)[np.arange(count + 3) % count]
        basis, rough = basis @ once, rough @ once
    weight = (scale / (2.0 * math.pi)) ** 6 * n / length
    hat = np.linalg.solve(basis.T @ basis + weight * rough.T @ rough, basis.T)
    piece = np.minimum((places / knot).astype(int), count - 1)
    p = places / knot - piece
    curve = np.einsum("nij,nj->ni", smoother.powers(scale)[piece], p[:, np.newaxis] ** np.arange(4))
    np.testing.assert_allclose(curve, basis @ hat @ points, atol=1e-8)
    assert smoother.score(scale).used == pytest.approx(np.trace(basis @ hat))


# -- outliers ---------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("noise", [0.0, 0.1])
@pytest.mark.parametrize("kind", ["town", "lap"])
def test_a_few_points_metres_off_the_road_are_left_out_and_named(kind, noise):
    true, points = recorded(kind, noise)
    outliers = {150: 3.0, 300: 8.0, 301: 8.0, 302: 8.0, 450: -500.0}
    for row, metres in outliers.items():
        heading = float(true.at(row * STEP).heading)
        points[row] += metres * np.array([-math.sin(heading), math.cos(heading)])
    road = fit_road(points, width_left=np.arange(float(len(points))) + 1.0)
    note = next(note for note in road.notes if "outliers" in note)
    assert note.startswith(f"5 of {len(points)} points left out")
    assert all(f"at point {row} (" in note for row in outliers)
    assert f"{len(points) - 5} points; largest deviation" in road.notes[-1]
    assert road.deviation < 0.01 + 6.0 * noise
    assert away(road, true) < 0.02 + 2.0 * noise
    assert float(road.along("width_left", road.project(*true.at(450.0 * STEP)[:2]).s)) == pytest.approx(451.0, abs=1.0)


def test_a_corner_of_one_point_is_no_outlier():
    rng = np.random.default_rng(0)
    straight = np.arange(0.0, 300.0, 5.0)
    corner = np.concatenate(
        [np.stack([straight, 0.0 * straight], axis=-1), np.stack([0.0 * straight + 300.0, straight], axis=-1)]
    )
    road = fit_road(corner + 0.02 * rng.standard_normal(corner.shape))
    assert not any("outliers" in note for note in road.notes)
    assert road.deviation <= 0.5


# -- what is said of bounds -------------------------------------------------------------------------------------------
def test_a_bound_that_chose_the_smoothing_and_the_ripple_that_it_makes_are_said():
    true, points = recorded(noise=0.2)
    free = fit_road(points, speed_limit=true.speed_limit)
    bound = fit_road(points, speed_limit=true.speed_limit, max_deviation=0.5)
    assert bound.deviation <= 0.5
    assert any("the bound of 0.5 m on the deviation, not the noise of 0.2 m, chose" in note for note in bound.notes)
    slow, fast = plan_speed(bound, CAR), plan_speed(free, CAR)
    ripple = next(finding for finding in check_road(bound, CAR, slow) if finding.kind == "ripple")
    assert ripple.drivable
    assert ripple.value < 0.5 * ripple.limit
    assert slow.duration > 2.0 * fast.duration
    assert check_road(free, CAR, fast) == []


@pytest.mark.parametrize("kind", ["town", "mountain", "lap"])
def test_the_bends_of_a_road_are_no_ripple(kind):
    true, points = recorded(kind)
    for road in (true, road_through(points, closed=true.closed, speed_limit=true.speed_limit)):
        assert "ripple" not in {finding.kind for finding in check_road(road, CAR, plan_speed(road, CAR))}


def test_a_bound_within_the_noise_that_no_curve_keeps_is_refused_with_both():
    with pytest.raises(InvalidInput, match=r"within max_deviation = 0\.5 m of the points, which scatter by 1.9 m; one"):
        fit_road(recorded(noise=2.0, length=500.0)[1], max_deviation=0.5)


# -- what is no record ------------------------------------------------------------------------------------------------
def arc(row=0, point=(0.0, 0.0), scale=1.0):
    """Points of a bend with another one in their place."""
    points = scale * np.stack([np.arange(60.0), 0.01 * np.arange(60.0) ** 2], axis=-1)
    points[row] = point
    return points


@pytest.mark.parametrize(("points", "words"), [
    (arc(30, (1e308, 9.0)), "point 30 has a coordinate of 1e[+]308 m"),
    (arc(30, (30.0, -1e160)), "point 30 has a coordinate of -1e[+]160 m"),
    (arc(31, (1e5, 9.0)), "point 30 is 1e[+]05 m from the next one"),
    (arc(30, (math.nan, 9.0)), "point 30 is not finite"),
    (arc(scale=1e-6), "make a line of .* are x and y in metres"),
    (np.zeros((9, 2)), "all points are the same"),
    (np.zeros((3, 2)), "n >= 4"),
])  # fmt: skip
def test_points_that_are_no_road_in_metres_are_refused_with_the_point(points, words):
    for make in (fit_road, road_through):
        with pytest.raises(InvalidInput, match=words):
            make(points)

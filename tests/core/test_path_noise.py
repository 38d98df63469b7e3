"""The noise of the points of a path: estimated, smoothed, and left alone where there is none."""

import math

import numpy as np
import pytest

import adaptrack as at
from adaptrack.control.speed_control import SpeedController
from adaptrack.core.roads import noise as path_noise
from adaptrack.core.roads import path
from adaptrack.road import ROAD_KINDS, Comfort

pytestmark = pytest.mark.kernels

NOISES = (0.02, 0.05, 0.1)
ANGLES = np.linspace(0.0, 2.0 * math.pi, 240, endpoint=False)
RING = np.stack([40.0 * np.cos(ANGLES) + 3.0 * np.cos(3.0 * ANGLES), 30.0 * np.sin(ANGLES)], axis=-1)


def noise_of(points, closed=False):
    return path_noise.noise_of(np.ascontiguousarray(points), closed, np.empty(len(points)))


def with_noise(points, noise, seed=0):
    return points + noise * np.random.default_rng(seed).standard_normal(points.shape)


def points_of(road, step=1.0):
    return np.stack(road.at(np.arange(0.0, road.length - 0.5 * step, step))[:2], axis=-1)


def hairpin(radius):
    """Points 1 m apart of a turn by 180 degrees whose curvature rises and falls over as many metres as its radius."""
    ds, arc = 0.01, (math.pi - 1.0) * radius
    s = np.arange(0.0, 80.0 + arc + 2.0 * radius, ds)
    ramps = np.cumsum([40.0, radius, arc, radius])
    heading = np.cumsum(np.interp(s, ramps, [0.0, 1.0, 1.0, 0.0])) * ds / radius
    return ds * np.cumsum(np.stack([np.cos(heading), np.sin(heading)], axis=-1), axis=0)[::100]


def swerve(*changes, width=3.5):
    """Points 1 m apart of changes of lane: where each begins, its length (m), and to which side."""
    x = np.arange(0.0, 340.0)
    y = np.zeros_like(x)
    for start, length, side in changes:
        share = np.clip((x - start) / length, 0.0, 1.0)
        y += side * width * (share - np.sin(2.0 * math.pi * share) / (2.0 * math.pi))
    return np.stack([x, y], axis=-1)


FEATURES = {
    "hairpin of 5 m": (hairpin(5.0), 4.5),
    "hairpin of 10 m": (hairpin(10.0), 6.3),
    "chicane at 30 m/s": (swerve((80.0, 70.0, 1.0), (160.0, 70.0, -1.0)), 30.0),
    "lane change in 3 s at 10 m/s": (swerve((80.0, 30.0, 1.0)), 10.0),
    "lane change in 3 s at 30 m/s": (swerve((80.0, 90.0, 1.0)), 30.0),
}


def largest_curvature(road):
    return np.abs(road.at(np.arange(5.0, road.length - 5.0, 0.25)).curvature).max()


@pytest.mark.compiled
# -- points without noise ---------------------------------------------------------------------------------------------
@pytest.mark.parametrize("kind", ROAD_KINDS)
@pytest.mark.parametrize("step", [0.2, 1.0, 5.0])
def test_points_of_a_road_have_no_noise_and_stay_to_the_bit(kind, step):
    points = points_of(at.generate_road(kind, seed=1, length=300.0), step)
    assert noise_of(points) == 0.0
    road = at.road_through(points)
    assert road.notes == ()
    assert road.table.pieces.tobytes() == at.road_through(points, noise=0.0).table.pieces.tobytes()


@pytest.mark.parametrize("name", FEATURES)
def test_points_of_sharp_bends_have_no_noise(name):
    assert noise_of(FEATURES[name][0]) == 0.0


def test_a_point_far_beside_the_others_is_no_noise():
    points = swerve()
    points[40] += (-0.5, 1.0)
    assert noise_of(points) == 0.0


# -- noise ------------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("closed", [False, True])
@pytest.mark.parametrize("noise", [0.003, *NOISES])
def test_white_noise_is_estimated(noise, closed):
    assert noise_of(with_noise(RING, noise), closed) == pytest.approx(noise, rel=0.2)


def test_noise_of_a_planner_s_twenty_points_is_seldom_missed():
    estimates = [noise_of(with_noise(RING[:20], 0.05, seed)) for seed in range(20)]
    assert np.count_nonzero(estimates) >= 18
    assert np.mean(estimates) == pytest.approx(0.05, rel=0.2)


def test_a_specified_noise_makes_the_path_of_the_same_estimated_one():
    points = with_noise(RING[:60], 0.05)
    estimated, specified = at.road_through(points), at.road_through(points, noise=noise_of(points))
    assert estimated.table.pieces.tobytes() == specified.table.pieces.tobytes()
    memory = np.empty(path.path_words(points, False))
    assert path.path_through(points, False, math.nan, memory)[0] == path.OK
    assert path.line_in(memory)[0].pieces.tobytes() == specified.table.pieces.tobytes()


def test_the_noise_and_the_largest_distance_from_the_points_are_reported():
    points = with_noise(RING[:60], 0.05)
    road = at.road_through(points, noise=0.05)
    assert road.deviation == pytest.approx(np.abs(road.project(*points.T).offset).max(), rel=1e-6)
    assert road.notes == (f"noise of 0.05 m (given) smoothed: up to {road.deviation:.2g} m from a point",)
    assert "(estimated)" in at.road_through(points).notes[0]


@pytest.mark.compiled
@pytest.mark.parametrize("noise", NOISES)
def test_the_curvature_of_a_noisy_straight_is_negligible(noise):
    """v^2 times its noise is below 0.5 m/s^2 at 30 m/s; through the points it is 4 noises."""
    points = with_noise(swerve(), noise)
    s = np.arange(20.0, 320.0)
    assert np.std(at.road_through(points).at(s).curvature) * 30.0**2 < 0.5
    assert np.std(at.road_through(points, noise=0.0).at(s).curvature) > 2.0 * noise


@pytest.mark.compiled
def test_a_path_of_less_noise_is_nearer_to_the_points():
    points = with_noise(RING, 0.05)
    deviations = [at.road_through(points, noise=noise).deviation for noise in (1e-9, 1e-6, 1e-3, 0.05)]
    assert deviations == sorted(deviations)
    assert deviations[0] < 1e-3


@pytest.mark.compiled
@pytest.mark.parametrize("closed", [False, True])
def test_noisy_points_near_to_each_other_make_the_path_of_the_kernel(closed):
    for seed in range(20):
        rng = np.random.default_rng(seed)
        rows = rng.integers(5, 230, 6)
        points = with_noise(RING, 0.05, seed)
        points = np.insert(points, rows, points[rows] + 0.05 * rng.standard_normal((6, 2)), axis=0)
        memory = np.empty(3 * path.path_words(points, closed))
        assert path.path_through(points, closed, math.nan, memory)[0] == path.OK
        pieces = path.line_in(memory)[0].pieces
        assert pieces.tobytes() == at.road_through(points, closed=closed).table.pieces.tobytes()


@pytest.mark.compiled
def test_a_lap_is_the_same_wherever_it_begins():
    points = with_noise(RING, 0.05)
    lap, turned = at.road_through(points, closed=True), at.road_through(np.roll(points, 90, axis=0), closed=True)
    assert turned.length == pytest.approx(lap.length, abs=1e-9)
    foot = lap.project(*turned.at(np.linspace(0.0, turned.length, 500))[:2])
    assert np.abs(foot.offset).max() < 1e-9


@pytest.mark.compiled
def test_a_noisy_path_far_from_the_origin_is_the_same_path():
    points = with_noise(RING, 0.05)
    near, there = at.road_through(points), at.road_through(points + 2.0**20)
    s = np.linspace(0.0, near.length, 300)
    assert np.abs(there.at(s).x - 2.0**20 - near.at(s).x).max() < 1e-6


def test_any_noise_leaves_a_path_or_a_status(rng):
    """Of points in all numbers and of all spreads, also where the noise is far beyond what they are apart."""
    for count in (4, 5, 7, 20):
        for noise in (1e-12, 1.0, 1e6, 1e300, math.inf):
            for closed in (False, True):
                points = np.cumsum(rng.normal(1.0, 0.4, (count, 2)), axis=0)
                memory = np.empty(4 * path.path_words(points, closed))
                status, _ = path.path_through(points, closed, noise, memory)
                assert status in (path.OK, path.TOO_SHORT, path.PATH_KINK, path.TOO_SMALL)


# -- what drives along it ---------------------------------------------------------------------------------------------
@pytest.mark.compiled
@pytest.mark.parametrize("name", FEATURES)
def test_the_peak_of_the_curvature_is_lowered_by_no_more_than_the_noise_asks_for(name):
    """By 3 % at noise of 0.02 and 0.05 m, 5 % at 0.1 m."""
    points, _ = FEATURES[name]
    true = largest_curvature(at.road_through(points))
    for noise, share in zip(NOISES, (0.03, 0.03, 0.05), strict=True):
        assert largest_curvature(at.road_through(points, noise=noise)) > (1.0 - share) * true


@pytest.mark.compiled
@pytest.mark.parametrize("name", [name for name in FEATURES if "hairpin" not in name])
def test_noise_raises_the_lateral_acceleration_by_half_a_metre_per_second_squared_at_most(name):
    points, speed = FEATURES[name]
    true = largest_curvature(at.road_through(points))
    for noise in NOISES[:2]:
        for seed in range(5):
            curvature = largest_curvature(at.road_through(with_noise(points, noise, seed)))
            assert speed**2 * (curvature - true) < 0.5


def mean_governed_speed(road, top_speed):
    """m/s, of a car at the speeds that the governor allows on a path; the plan is not limited by bends."""
    plan = at.plan_speed(road, comfort=Comfort(lateral=50.0), top_speed=top_speed)
    controller = SpeedController(at.SpeedControl(at.load_vehicle("midsize-sedan"), friction=0.6), road, plan, 0.05)
    speeds = []
    for station in np.arange(0.0, road.length - 5.0, 2.0):
        controller.step(station, top_speed, math.nan)
        speeds.append(math.sqrt(controller.record.ahead[0]))
    return 1.0 / np.mean(1.0 / np.array(speeds))


@pytest.mark.compiled
@pytest.mark.parametrize("kind", ["mountain", "town", "lap"])
def test_the_governor_lets_a_car_drive_noisy_points_as_fast_as_clean_ones(kind):
    """Mean speed within 5 % at noise of 0.02 and 0.05 m, 10 % at 0.1 m; through the points less than two thirds."""
    points = points_of(at.generate_road(kind, seed=1, length=400.0))
    clean = mean_governed_speed(at.road_through(points), 18.0)
    for noise, share in zip(NOISES, (0.05, 0.05, 0.1), strict=True):
        noisy = with_noise(points, noise)
        assert mean_governed_speed(at.road_through(noisy), 18.0) == pytest.approx(clean, rel=share)
        assert mean_governed_speed(at.road_through(noisy, noise=0.0), 18.0) < 0.67 * clean

"""A road is geometry: its points are those of closed forms, and a point's foot on it is the nearest one."""

import math

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.spatial import cKDTree

from adaptrack.base.errors import InvalidInput, UnknownName
from adaptrack.core.roads import road as kernel
from adaptrack.road import ROAD_KINDS, Along, Arc, Clothoid, Cubic, Line, Pose, Road, generate_road, road_through
from adaptrack.road.opendrive_lanes import line_at_offset
from adaptrack.road.table import joined, placed, tabulate
from references.road import beside, coarse_samples, end_of, exact_points, feet_by_search, figure_of_eight

pytestmark = pytest.mark.kernels

BEND = Clothoid(length=60.0, start_curvature=0.0, end_curvature=0.05)
CUBIC = Cubic(x=(0.0, 40.0, 5.0, -8.0), y=(0.0, 0.0, 25.0, -12.0))


def eight():
    return Road.from_segments(figure_of_eight(Arc, Line), closed=True, name="eight")


# -- positions --------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("segment", [
    Line(length=123.4),
    Arc(length=200.0, curvature=0.04),
    Arc(length=150.0, curvature=-0.11),
    BEND,
    Clothoid(length=90.0, start_curvature=0.06, end_curvature=-0.03),
    Clothoid(length=500.0, start_curvature=-1e-3, end_curvature=-1.0001e-3),
    Clothoid(length=40.0, start_curvature=0.2, end_curvature=1.0),
], ids=lambda segment: segment.kind)  # fmt: skip
def test_lines_arcs_and_clothoids_lie_where_closed_forms_and_quadrature_say(segment):
    (table,) = tabulate([segment])
    s = np.linspace(0.0, segment.length, 301)
    np.testing.assert_allclose(table.at(s), exact_points(segment, s), rtol=0, atol=2e-9)  # Fresnel, near an arc
    k0, k1 = segment.curvatures
    assert np.abs(table.at(s).curvature - (k0 + (k1 - k0) * s / segment.length)).max() < 1e-14
    end = end_of(k0, (k1 - k0) / segment.length, segment.length)
    last = table.at(segment.length)
    assert (float(last.x), float(last.y)) == pytest.approx(end, abs=1e-9)


def test_a_parametric_cubic_lies_where_its_coefficients_say_at_its_arc_length():
    (table,) = tabulate([CUBIC])
    for p in np.linspace(0.0, 1.0, 23):
        speed = lambda q: math.hypot(40.0 + 10.0 * q - 24.0 * q * q, 50.0 * q - 36.0 * q * q)  # noqa: E731
        s = quad(speed, 0.0, p, epsabs=1e-13)[0]
        point = table.at(min(s, table.length))
        exact = (40.0 * p + 5.0 * p**2 - 8.0 * p**3, 25.0 * p**2 - 12.0 * p**3)
        bend = (40.0 + 10.0 * p - 24.0 * p * p) * (50.0 - 72.0 * p) - (50.0 * p - 36.0 * p * p) * (10.0 - 48.0 * p)
        assert (float(point.x), float(point.y)) == pytest.approx(exact, abs=1e-9)
        assert float(point.curvature) == pytest.approx(bend / speed(p) ** 3, abs=1e-9)


def test_a_line_beside_a_clothoid_is_its_parallel():
    """By samples: within 1 mm, and 1 % of the curvature."""
    (base,) = tabulate([BEND])
    for offset in (2.0, -3.5):
        side, s, parallel = line_at_offset(base, [(0.0, np.array([offset, 0.0, 0.0, 0.0]))])
        x, _, heading, curvature = exact_points(BEND, s)
        assert np.abs(parallel - (s - offset * 0.05 * s**2 / 120.0)).max() < 1e-3
        exact = curvature / (1.0 - offset * curvature)
        np.testing.assert_allclose(side.at(parallel).curvature, exact, rtol=0.01, atol=1e-6)
        np.testing.assert_allclose(side.at(parallel).x, x - offset * np.sin(heading), atol=1e-3)


def test_the_curvature_beside_a_road_is_the_change_of_its_heading_where_the_distance_changes():
    (base,) = tabulate([Clothoid(length=80.0, start_curvature=-0.01, end_curvature=0.03)])
    laws = np.array([[1.0, 0.02, -1e-3, 1e-5], [1.0, -0.013, 1e-3, -2e-5]])
    side, base_s, places = line_at_offset(base, [(0.0, laws[0]), (30.0, laws[1])])
    s, h = np.linspace(1.0, side.length - 1.0, 200), 1e-4
    s = s[np.abs(s - np.interp(30.0, base_s, places)) > 1.0]  # but where the polynomial changes
    before, after = side.at(s - h), side.at(s + h)
    np.testing.assert_allclose((after.heading - before.heading) / (2 * h), side.at(s).curvature, rtol=0.01, atol=1e-5)
    assert np.abs(np.hypot(after.x - before.x, after.y - before.y) / (2 * h) - 1.0).max() < 1e-8


def test_a_lane_beyond_the_centre_of_curvature_and_a_cusp_are_refused():
    (arc,) = tabulate([Arc(length=10.0, curvature=0.1)])
    with pytest.raises(InvalidInput, match="centre of curvature"):
        line_at_offset(arc, [(0.0, np.array([11.0, 0.0, 0.0, 0.0]))])
    with pytest.raises(InvalidInput, match="cusp"):
        tabulate([Cubic(x=(0.0, 0.0, 1.0, 0.0), y=(0.0, 0.0, 0.0, 1.0))])


# -- roads ------------------------------------------------------------------------------------------------------------
def test_elements_follow_one_another_and_jumps_of_curvature_are_reported():
    road = Road.from_segments([Line(length=50.0), Arc(length=30.0, curvature=0.05), BEND.replace(start_curvature=0.05)])
    (jump,) = road.curvature_jumps()
    assert (jump.s, jump.before, jump.after) == pytest.approx((50.0, 0.0, 0.05), abs=1e-12)
    s = np.linspace(0.0, road.length, 5001)
    points = road.at(s)
    assert np.abs(np.diff(points.x) ** 2 + np.diff(points.y) ** 2 - np.diff(s) ** 2).max() < 1e-6
    assert np.abs(np.diff(points.heading)).max() < 0.06 * np.diff(s).max()


def test_an_open_road_goes_on_straight_and_a_closed_one_around():
    road = Road.from_segments([BEND], start=(5.0, -2.0, 1.0))
    end = road.at(road.length)
    beyond = road.at(road.length + 7.0)
    assert float(beyond.x) == pytest.approx(float(end.x + 7.0 * np.cos(end.heading)))
    assert float(beyond.curvature) == 0.0
    np.testing.assert_allclose(road.at(-3.0)[:2], [5.0 - 3.0 * math.cos(1.0), -2.0 - 3.0 * math.sin(1.0)])
    circle = Road.from_segments([Arc(length=40.0 * math.pi, curvature=0.05)], closed=True)
    assert circle.turn == pytest.approx(2.0 * math.pi)
    for s in (-300.0, -1.0, 17.0, 5000.0):
        exact = exact_points(Arc(length=1.0, curvature=0.05), np.array(s))
        np.testing.assert_allclose(circle.at(s), exact, atol=1e-9)


@pytest.mark.parametrize(("make", "words"), [
    (lambda: Road.from_segments([]), "no segments"),
    (lambda: Road.from_segments([Line(length=10.0)], closed=True), "10 m apart at the end and the start"),
    (lambda: Road.from_segments([Line(length=10.0)], friction=0.0), "friction"),
    (lambda: Road.from_segments([Line(length=10.0)], bank=2.0), "angle in rad"),
    (lambda: Road.from_segments([Line(length=10.0)], width_left="wide"), "width_left"),
    (lambda: Road.from_segments([Line(length=10.0)], speed_limit=([0.0, 0.0], [1.0, 2.0])), "increase"),
    (lambda: Line(length=-1.0), "length"),
    (lambda: two_lines((10.0, 0.5, 0.0)), "0.5 m apart at s = 10.00 m"),
    (lambda: two_lines((10.0, 0.0, 0.1)), "0.1 rad of kink"),
    (lambda: generate_road("mountains"), "Did you mean 'mountain'"),
    (lambda: generate_road("town", seed=-1), "seed"),
    (lambda: generate_road("town", width_left=-1.0), "> 0"),
    (lambda: road_through([(0.0, 0.0), (1.0, 0.0), (1.0, 0.0), (2.0, 0.0)]), "3 points lie apart.*at least 4"),
    (lambda: Road.from_segments([Line(length=10.0)]).project(math.nan, 0.0), "finite"),
    (lambda: Road.from_segments([Line(length=10.0)]).along("colour", 0.0), "width_left"),
])  # fmt: skip
def test_what_is_no_road_is_refused_with_a_reason(make, words):
    with pytest.raises((InvalidInput, UnknownName), match=words):
        make()


def two_lines(pose):
    """A road of two lines of 10 m, the second from a pose."""
    tables = tabulate([Line(length=10.0), Line(length=10.0)])
    return Road(name="lines", table=joined([tables[0], placed(tables[1], Pose(*pose))]))


def test_what_lies_along_a_road_is_linear_or_in_steps_and_repeats_on_a_lap():
    limit = Along(s=(0.0, 30.0), value=(20.0, 10.0), kind="steps")
    road = eight().replace(speed_limit=limit, friction=([0.0, 100.0], [1.0, 0.5]))
    assert road.along("speed_limit", [29.999, 30.0, road.length + 1.0]).tolist() == [20.0, 10.0, 20.0]
    assert float(road.along("friction", 50.0 + 2 * road.length)) == pytest.approx(0.75)
    assert float(eight().along("speed_limit", 3.0)) == math.inf
    assert limit.least([0.0, 31.0], [40.0, 50.0]).tolist() == [10.0, 10.0]


def test_edges_are_at_their_widths_on_the_normal():
    road = Road.from_segments([BEND], width_left=3.0, width_right=2.0)
    left, right = road.edges(np.linspace(0.0, 60.0, 30))
    feet_left, feet_right = road.project(*left.T), road.project(*right.T)
    np.testing.assert_allclose(feet_left.offset, 3.0, atol=1e-9)
    np.testing.assert_allclose(feet_right.offset, -2.0, atol=1e-9)


# -- projection -------------------------------------------------------------------------------------------------------
def test_three_laps_of_a_road_that_crosses_itself_are_followed_without_a_jump():
    road = eight()
    s = np.arange(0.0, 3.0 * road.length, 0.7)
    offset = 2.0 * np.sin(s / 9.0)
    x, y = beside(road, s, offset)
    near = 0.0
    for k in range(s.size):
        foot = road.project(x[k], y[k], near=near)
        near = float(foot.s)
        assert near == pytest.approx(s[k], abs=1e-9)
        assert float(foot.offset) == pytest.approx(offset[k], abs=1e-9)
    assert near > 2.9 * road.length


def test_the_heading_goes_on_over_the_laps_of_a_closed_road():
    road = generate_road("lap", seed=3, length=600.0)
    s = np.array([0.25, 1.25, 10.25, -2.75]) * road.length
    x, y = beside(road, s, 1.0)
    foot = road.project(x, y, near=s + 0.5)
    np.testing.assert_allclose(foot.heading - foot.heading[0], np.array([0.0, 1.0, 10.0, -3.0]) * road.turn, atol=1e-9)


def test_the_seam_of_a_closed_road_is_its_beginning():
    for road in (generate_road("lap", seed=seed, length=1500.0) for seed in range(2)):
        seam = road.at([0.0, road.length, 2.0 * road.length])
        assert road.project(seam.x, seam.y).s == pytest.approx(0.0, abs=1e-8)


def test_past_both_ends_the_foot_is_on_the_straight_continuation():
    road = Road.from_segments([BEND])
    end = road.at(road.length)
    along = np.array([np.cos(end.heading), np.sin(end.heading)])
    point = np.array([end.x, end.y]) + 12.0 * along + 3.0 * np.array([-along[1], along[0]])
    for near in (None, road.length - 1.0):
        foot = road.project(*point, near=near)
        assert (float(foot.s), float(foot.offset)) == pytest.approx((road.length + 12.0, 3.0), abs=1e-9)
        assert float(foot.curvature) == 0.0
    foot = road.project(-4.0, -1.0)
    assert (float(foot.s), float(foot.offset)) == pytest.approx((-4.0, -1.0), abs=1e-9)


def test_a_point_without_a_foot_within_reach_is_refused_by_its_place():
    road = Road.from_segments([Line(length=2000.0)])
    with pytest.raises(InvalidInput, match=r"\(1500, 2\) has no foot within 400 m of near = 0 m"):
        road.project([3.0, 1500.0], [2.0, 2.0], near=0.0)
    assert float(road.project(1500.0, 2.0, near=1150.0).offset) == pytest.approx(2.0)


def around(road, furthest, count, rng):
    """Points up to so far from places of a road, and arc lengths up to 30 m from these places."""
    s = rng.uniform(0.0, road.length, count)
    distance, angle = furthest * np.sqrt(rng.uniform(size=count)), rng.uniform(0.0, 2.0 * math.pi, count)
    place = road.at(s)
    return place.x + distance * np.cos(angle), place.y + distance * np.sin(angle), s + rng.uniform(-30.0, 30.0, count)


TIGHT = Road.from_segments(
    [Line(length=150.0), Arc(length=math.pi / 0.1, curvature=0.1), Line(length=150.0)], name="tight"
)
ROUND = Road.from_segments([Arc(length=120.0 * math.pi, curvature=1 / 60)], closed=True, name="round")


@pytest.mark.compiled
@pytest.mark.parametrize("road", [TIGHT, ROUND, "mountain"], ids=["tight", "round", "mountain"])
def test_the_foot_is_the_minimum_of_distance_nearest_in_arc_length(road, rng):
    road = generate_road(road, seed=2, length=2000.0) if isinstance(road, str) else road
    for furthest in (15.0, 100.0):
        x, y, near = around(road, furthest, 150, rng)
        foot = road.project(x, y, near=near)
        assert np.isfinite(foot.offset).all()
        expected = feet_by_search(road, x, y, near)
        assert (np.abs(foot.s - near) <= np.abs(expected - near) + 1e-6).all()
        for side in (-1.0, 1.0):
            p = road.at(foot.s + 1e-5 * side)
            assert (side * ((p.x - x) * np.cos(p.heading) + (p.y - y) * np.sin(p.heading)) >= 0.0).all()


@pytest.mark.compiled
@pytest.mark.parametrize("kind", [*ROAD_KINDS, "eight", "cubic", "tight", "round"])
def test_no_place_of_a_road_is_nearer_to_a_point_than_its_foot(kind, rng):
    roads = {"eight": eight(), "cubic": Road.from_segments([CUBIC, Line(length=20.0)]), "tight": TIGHT, "round": ROUND}
    road = roads[kind] if kind in roads else generate_road(kind, seed=5, length=1200.0)
    for furthest in (5.0, 1000.0):
        x, y, _ = around(road, furthest, 100, rng)
        foot = road.project(x, y)
        assert np.isfinite(foot.offset).all()
        place = road.at(foot.s)
        ahead = (place.x - x) * np.cos(place.heading) + (place.y - y) * np.sin(place.heading)
        assert np.abs(ahead).max() <= 1e-9 * furthest
        end = road.at(foot.s if road.closed else np.clip(foot.s, 0.0, road.length))
        _, px, py = coarse_samples(road, 0.05)
        least = np.hypot(px - x[:, np.newaxis], py - y[:, np.newaxis]).min(axis=1)
        assert (np.hypot(end.x - x, end.y - y) <= least + 1e-9).all()


def test_every_place_of_a_circle_is_a_foot_of_its_centre():
    for near in (None, 10.0, -1000.0):
        foot = ROUND.project(0.0, 60.0, near=near)
        assert float(foot.offset) == pytest.approx(60.0, abs=1e-9)
    assert abs(float(foot.s) + 1000.0) <= 400.0


def test_kernels_and_the_table_agree_on_points_headings_and_the_bound_of_the_curvature(rng):
    for road in (TIGHT, ROUND, eight(), Road.from_segments([CUBIC, Line(length=20.0)])):
        headings, s = np.empty(200), rng.uniform(-2.0 * road.length, 3.0 * road.length, 50)
        kernel.headings_along(road.packed(), headings)
        assert np.array_equal(headings, road.at(np.linspace(0.0, road.length, 200)).heading)
        points = np.empty((s.size, 4))
        kernel.points_at(road.packed(), s, points)
        np.testing.assert_allclose(points.T, road.at(s), rtol=0, atol=1e-10)
        most = np.abs(road.at(np.arange(0.0, road.length, 0.1)).curvature).max()
        assert most <= road.packed().numbers[kernel.MOST_CURVATURE] * (1.0 + 1e-12) <= 2.0 * most


def test_where_rounding_left_a_kink_the_foot_is_the_corner_or_beside_it():
    road = two_lines((10.0, 0.0, 0.008))
    foot = road.project([10.0, 10.0], [-20.0, 20.0], near=[9.0, 9.0])
    assert float(foot.s[0]) == pytest.approx(10.0, abs=1e-9)  # outside: the corner is nearest
    x, y = road.at(foot.s[1])[:2]
    assert math.hypot(x - 10.0, y - 20.0) <= 20.0


# -- generated --------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("kind", ROAD_KINDS)
def test_a_generated_road_is_of_its_kind_and_its_seed(kind):
    road, again, other = (generate_road(kind, seed, length=1500.0) for seed in (1, 1, 2))
    assert np.array_equal(road.table.pieces, again.table.pieces)
    assert road.length != other.length
    assert 1300.0 < road.length < 4500.0
    assert road.curvature_jumps() == []
    size = ROAD_KINDS[kind]
    tightest = min(size.radius[0], size.tight_radius[0] or math.inf)
    assert 1.0 / np.abs(road.at(np.arange(0.0, road.length, 0.5)).curvature).max() >= tightest * (1.0 - 1e-9)
    assert road.closed is (kind == "lap")


@pytest.mark.parametrize("length", [2_500.0, 20_000.0])
def test_a_mountain_road_keeps_off_itself(length):
    """Drawn whole, and grown bend by bend."""
    road = generate_road("mountain", 1, length=length)
    assert length <= road.length < length + 500.0
    assert road.curvature_jumps() == []
    s = np.arange(0.0, road.length, 1.0)
    points = road.at(s)
    near = cKDTree(np.stack(points[:2], axis=-1)).query_pairs(6.0, output_type="ndarray")
    assert np.abs(s[near[:, 0]] - s[near[:, 1]]).max() < 40.0
    assert (np.abs(points.curvature) > 1.0 / 15.5).sum() > 0.02 * length  # hairpins are left in it

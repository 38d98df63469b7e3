"""Roads through recorded points: their tables, their noise and outliers, gaps between them, what bounds do to them."""

import math

import numpy as np
import pytest
from scipy.interpolate import BSpline

import adaptrack as at
from adaptrack.base.errors import ConfigError, InvalidInput
from adaptrack.road import check_road, fit_road, generate_road, load_road, plan_speed, road_through
from adaptrack.road.points import read_points
from adaptrack.road.smoothing import Smoother
from adaptrack.road.speed import speed_limit_plan
from references.road import coarse_samples, nearest_by_search

CAR = at.load_vehicle("midsize-sedan")
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


# -- points far apart -------------------------------------------------------------------------------------------------
def circuit(seed, noise):
    """Points (n, 2) of a closed circuit of arcs and straight lines, with points on the arcs only; its length (m)."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(4, 11))
    angle = (np.arange(n) + rng.uniform(-0.3, 0.3, n)) * 2.0 * np.pi / n
    corners = rng.uniform(0.5, 1.2, n) * rng.uniform(300.0, 900.0) * np.exp(1j * angle)
    step = rng.uniform(3.0, 12.0)
    arcs, length = [], 0.0
    for k in range(n):
        back, ahead = corners[k] - corners[k - 1], corners[(k + 1) % n] - corners[k]
        turn = float(np.angle(ahead / back))
        radius = min(rng.uniform(15.0, 80.0), 0.45 * min(abs(back), abs(ahead)) / math.tan(0.5 * abs(turn)))
        start = corners[k] - radius * math.tan(0.5 * abs(turn)) * back / abs(back)
        centre = start + 1j * math.copysign(radius, turn) * back / abs(back)
        phi = np.linspace(0.0, turn, max(3, math.ceil(radius * abs(turn) / step)) + 1)
        arcs.append(centre + (start - centre) * np.exp(1j * phi))
        length += radius * abs(turn)
    length += sum(abs(arcs[k][0] - arcs[k - 1][-1]) for k in range(n))
    line = np.roll(np.concatenate(arcs), -int(rng.integers(0, 10)))
    points = np.stack([line.real, line.imag], axis=-1)
    return points + noise * rng.standard_normal(points.shape), length


@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_a_circuit_with_points_in_its_bends_only_keeps_its_length(noise):
    for seed in range(5):
        points, length = circuit(seed, noise)
        road = fit_road(points)
        assert road.closed, seed
        assert road.length == pytest.approx(length, rel=5e-3), seed
        assert any("the road is a guess there" in note for note in road.notes), seed


def test_between_two_points_a_road_makes_no_detour_or_the_points_are_named():
    roads = refusals = 0
    for seed in range(5, 15):
        rng = np.random.default_rng(seed)
        heading = np.cumsum(rng.normal(0.0, 0.6, 24))
        steps = 20.0 * rng.exponential(1.0, 24) ** 2
        points = np.cumsum(steps[:, np.newaxis] * np.stack([np.cos(heading), np.sin(heading)], axis=-1), axis=0)
        try:
            road = fit_road(points, closed=False)
        except InvalidInput as error:
            refusals += "between point" in str(error)
            continue
        roads += 1
        samples = coarse_samples(road)
        s = [nearest_by_search(road, *point, samples=samples)[0] for point in points]
        straight = np.hypot(*np.diff(points, axis=0).T)
        if (np.diff(s) > 0.0).all():  # else it crosses itself, and the nearest place need not be that of the point
            assert (np.diff(s) < 1.6 * straight + 2.0 * road.deviation + 0.01).all(), seed
    assert roads > 2
    assert refusals


def line(road, spacing, aside=0.0, part=(0.0, 1.0)):
    """Points beside a road, (n, 2)."""
    s = np.arange(part[0] * road.length, part[1] * road.length, spacing)
    place = road.at(s)
    return np.stack([place.x - aside * np.sin(place.heading), place.y + aside * np.cos(place.heading)], axis=-1)


COUNTRY, TOWN = generate_road("country", seed=3, length=600.0), generate_road("town", seed=5, length=500.0)
STRAIGHT = np.stack([np.arange(100.0), np.zeros(100)], axis=-1)
TWO_PIECES = {
    "edges": (line(COUNTRY, 1.0, 3.5), line(COUNTRY, 1.0, -3.5)),
    "outline": (line(COUNTRY, 1.0, 3.5), line(COUNTRY, 1.0, -3.5)[::-1]),
    "two streets": (line(COUNTRY, 2.0), line(TOWN, 2.0) + np.array([300.0, -400.0])),
    "far away": (line(COUNTRY, 2.0), line(TOWN, 2.0) + np.array([5000.0, 5000.0])),
    "aside": (STRAIGHT, STRAIGHT + np.array([100.0, 50.0])),
    "second reversed": (line(COUNTRY, 2.0, part=(0.0, 0.4)), line(COUNTRY, 2.0, part=(0.6, 1.0))[::-1]),
}


@pytest.mark.parametrize("name", TWO_PIECES)
def test_two_pieces_in_a_row_are_refused_at_the_point_behind_which_the_second_begins(name):
    first, second = TWO_PIECES[name]
    with pytest.raises(InvalidInput, match=f"behind point {len(first) - 1} a second piece begins"):
        fit_road(np.concatenate([first, second]))


def test_a_gap_to_which_both_ends_lead_is_bridged_and_noted():
    true = generate_road("country", seed=3, length=600.0)
    points = np.concatenate([line(true, 2.0, part=(0.0, 0.5)), line(true, 2.0, part=(0.52, 1.0))])
    road = fit_road(points)
    offset = road.project(*true.at(np.linspace(0.01, 0.99, 300) * true.length)[:2]).offset
    assert np.abs(offset).max() < 0.2
    assert any("there are no points for 2" in note for note in road.notes)
    straight = fit_road(np.concatenate([STRAIGHT, STRAIGHT + np.array([300.0, 0.0])]))
    assert straight.length == pytest.approx(399.0, abs=0.01)
    assert not any("no points" in note for note in fit_road(line(true, 2.0)).notes)


def test_a_gap_in_a_file_is_named_by_its_lines(tmp_path):
    path = tmp_path / "pieces.csv"
    path.write_text(
        "x,y\n" + "".join(f"{x},{y}\n" for x, y in np.concatenate([STRAIGHT, STRAIGHT + np.array([100.0, 50.0])]))
    )
    with pytest.raises(ConfigError, match="behind line 101 a second piece begins, 50"):
        load_road(path)
    path.write_text(
        "x,y\n" + "".join(f"{x},{y}\n" for x, y in np.concatenate([STRAIGHT, STRAIGHT + np.array([300.0, 0.0])]))
    )
    assert any("behind line 101 there are no points for 201 m" in note for note in load_road(path).notes)


@pytest.mark.parametrize(("radius", "spacing"), [(3.8, 0.1), (1.0, 0.02), (3.0, 1.0), (40.0, 5.0)])
def test_a_lap_of_any_size_is_closed_and_three_quarters_of_it_are_not(radius, spacing):
    angle = np.arange(0.0, 2.0 * np.pi, spacing / radius)
    circle = radius * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    road = fit_road(circle)
    assert road.closed
    assert road.length == pytest.approx(2.0 * np.pi * radius, rel=2e-3)
    assert not fit_road(circle[: 3 * angle.size // 4]).closed


# -- tables as spreadsheets, recorders and ROS write them -------------------------------------------------------------
S = np.arange(0.0, 61.0)
X, Y = S, 20.0 * (1.0 - np.cos(S / 40.0))


def table(path, header, *columns, mark=","):
    path.write_text(
        header + "".join(mark.join(f"{value:.6f}" for value in row) + "\n" for row in np.broadcast(*columns))
    )
    return path


@pytest.mark.parametrize(("above", "mark"), [
    ("sep=;\nx;y\n", ";"),
    ('"sep=;"\nx;y\n', ";"),
    ("SEP=,\nx,y\n", ","),
    ("% x, y\n", ","),
    ("% a waypoint file\n% x_m y_m\n", " "),
    ("// x,y\n", ","),
    ("%time,wp_x,wp_y\n", ","),
    ("%time,field.pose.pose.position.x,field.pose.pose.position.y\n", ","),
    ("easting,northing\n", ","),
    ("Easting (m);Northing (m)\n", ";"),
    ("utm_x\tutm_y\n", "\t"),
    ("x|y\n", "|"),
    ("", ";"),
])  # fmt: skip
def test_names_and_marks_above_the_numbers_are_read(tmp_path, above, mark):
    columns = (0.1 * S, X, Y) if "time" in above else (X, Y)
    read = read_points(table(tmp_path / "a.csv", above, *columns, mark=mark))
    np.testing.assert_allclose(read.points, np.stack([X, Y], axis=-1), atol=1e-6)
    assert read.lines[0] == above.count("\n") + 1


def test_remarks_between_and_below_the_numbers_are_left_out(tmp_path):
    path = table(tmp_path / "a.csv", "x,y\n", X, Y)
    path.write_text(path.read_text().replace("30.000000,", "// a pause\n%\n30.000000,", 1) + "# end\n")
    assert len(read_points(path).points) == S.size


def test_four_columns_without_names_are_widths_where_they_can_be(tmp_path):
    widths = read_points(table(tmp_path / "track.csv", "", X, Y, 3.0, 4.0))
    assert any("read as x, y, width to the right, width to the left" in note for note in widths.notes)


@pytest.mark.parametrize("name", ["width_right", "width_left"])
def test_widths_below_zero_all_along_are_distances(tmp_path, name):
    road = load_road(table(tmp_path / "a.csv", f"x,y,{name}\n", X, Y, -5.0))
    np.testing.assert_allclose(road.along(name, [0.0, 30.0]), 5.0)
    assert f"{name} is below 0 all along: read as distances" in road.notes


def test_a_recorded_drive_begins_and_ends_at_a_standstill(tmp_path):
    standing = np.zeros(4)
    x, y = (np.concatenate([np.full(4, values[0]), values, np.full(4, values[-1])]) for values in (X, Y))
    speed = np.concatenate([standing, np.sqrt(3.0 * np.minimum(S, S[-1] - S)), standing])
    road = load_road(table(tmp_path / "a.csv", "x,y,speed\n", x, y, speed), speed_column="speed")
    assert road.length == pytest.approx(np.hypot(np.diff(X), np.diff(Y)).sum(), rel=1e-3)
    assert any("speed 0 at the start or the end" in note for note in road.notes)
    plan = speed_limit_plan(road)
    inside = np.arange(5.0, 55.0)
    np.testing.assert_allclose(
        plan.at(inside), np.interp(inside, road.speed_limit.s, road.speed_limit.value), rtol=2e-3
    )
    # From and to rest at 1.5 m/s^2 the way takes 2 sqrt(L/1.5) s.
    assert plan.duration == pytest.approx(2.0 * math.sqrt(60.0 / 1.5), rel=0.15)


NO_WIDTHS = "the last two of four columns without a header are no widths"
NO_METRES = "in millimetres or centimetres; convert them to metres"
LONG, WAVE = np.arange(0.0, 1000.0, 2.0), 40.0 * np.sin(np.arange(0.0, 1000.0, 2.0) / 80.0)


@pytest.mark.parametrize(("header", "columns", "words"), [
    ("", (X, Y, 84.0, 8.0), NO_WIDTHS),  # a height
    ("", (X, Y, 0.0, 8.0), NO_WIDTHS),
    ("", (X, Y, -1.0, 8.0), NO_WIDTHS),
    ("", (X, Y, 3.0, 35.0), NO_WIDTHS),  # a speed
    ("x,y,width_right\n", (X, Y, 5.0 * np.cos(S / 10.0)), "width_right = -"),
    ("x,y,width_left\n", (X, Y, 5.0 * np.cos(S / 10.0)), "width_left = -"),
    ("x,y,speed\n", (X, Y, np.where(S == 1, 0.0, 8.0)), "line 3: speed = 0: must be > 0"),
    ("x,y,speed\n", (X, Y, np.where(S == 30, 0.0, 8.0)), "line 32: speed = 0: must be > 0"),
    ("x,y,speed\n", (X, Y, 0.0), "line 2: speed = 0"),
    ("x,y\n", (100.0 * LONG, 100.0 * WAVE), NO_METRES),
    ("x,y\n", (1000.0 * LONG, 1000.0 * WAVE), NO_METRES),
])  # fmt: skip
def test_a_table_that_is_no_road_in_metres_is_refused(tmp_path, header, columns, words):
    options = {"speed_column": "speed"} if "speed" in header else {}
    with pytest.raises(ConfigError, match=words):
        load_road(table(tmp_path / "a.csv", header, *columns), **options)


def test_a_column_of_speeds_is_named_with_its_option(tmp_path):
    path = table(tmp_path / "line.csv", "# s_m; x_m; y_m; vx_mps\n", S, X, Y, 8.0, mark=";")
    assert "to drive at the speeds of a column: --speed-column vx_mps" in load_road(path).notes
    assert not any("--speed-column" in note for note in load_road(path, speed_column="vx_mps").notes)
    in_kmh = table(tmp_path / "kmh.csv", "x,y,speed_kmh\n", X, Y, 30.0)
    assert load_road(in_kmh).notes[-1] == "columns left out: speed_kmh"


def test_a_road_in_metres_is_none_in_millimetres(tmp_path):
    assert load_road(table(tmp_path / "a.csv", "x,y\n", LONG, WAVE)).length < 2000.0


def test_a_long_road_with_points_far_apart_is_none_in_millimetres(tmp_path):
    s = np.arange(0.0, 6e4, 60.0)
    assert load_road(table(tmp_path / "a.csv", "x,y\n", s, 800.0 * np.sin(s / 2000.0))).length > 6e4

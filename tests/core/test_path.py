"""The kernel that makes a centre line of points: through all of them, smooth, and nothing but a status for others."""

import itertools
import math

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from adaptrack.core.roads import path
from adaptrack.core.roads import road as kernel
from adaptrack.road import road_through
from adaptrack.road.road_ahead import pack_roads
from adaptrack.road.table import points_on_pieces

pytestmark = pytest.mark.kernels

BENDS = np.stack([60.0 * np.linspace(0.0, 5.0, 24), 25.0 * np.sin(np.linspace(0.0, 5.0, 24))], axis=-1)
TURNS = np.linspace(0.0, 2.0 * math.pi, 14, endpoint=False)
OVAL = np.stack([50.0 * np.cos(TURNS), 20.0 * np.sin(TURNS)], axis=-1)
FEW = [(0.0, 0.0), (1.0, 0.1), (2.0, 0.4), (3.0, 0.5), (4.0, 0.2)]


def make_path(points, closed=False):
    """Status, number of pieces or of a point, and the memory, filled with what is no number before."""
    points = np.array(points, dtype=np.float64)
    memory = np.full(max(path.path_words(points, closed), 999), np.nan)
    return *path.path_through(points, closed, 0.0, memory), memory


def line_of(points, closed=False):
    status, count, memory = make_path(points, closed)
    line, _ = path.line_in(memory)
    assert (status, count) == (path.OK, len(line.pieces))
    return line


def spline_of(points, closed):
    """SciPy's spline, and its parameter at the points."""
    ring = np.concatenate([points, points[:1]]) if closed else points
    places = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(ring, axis=0).T))])
    return CubicSpline(places, ring, bc_type="periodic" if closed else "not-a-knot"), places


@pytest.mark.parametrize(("points", "closed"), [(BENDS, False), (FEW, False), (FEW[:4], False), (OVAL, True)])
def test_a_path_is_the_cubic_spline_of_scipy_at_its_arc_length(points, closed):
    """Place to 1e-10 m, heading to 1e-9 rad, curvature to 1e-8; arc lengths by Gauss's quadrature of the speed."""
    points = np.array(points)
    road = road_through(points, closed=closed)
    spline, places = spline_of(points, closed)
    cuts = np.unique(np.concatenate([np.linspace(a, b, 9) for a, b in itertools.pairwise(places)]))
    nodes, weights = np.polynomial.legendre.leggauss(16)
    half = 0.5 * np.diff(cuts)[:, np.newaxis]
    speeds = np.linalg.norm(spline(cuts[:-1, np.newaxis] + half * (1.0 + nodes), 1), axis=-1)
    s = np.concatenate([[0.0], np.cumsum((half * weights * speeds).sum(axis=1))])
    assert road.length == pytest.approx(s[-1], rel=1e-11)
    positions, (dx, dy), (ddx, ddy) = road.at(np.minimum(s, road.length)), spline(cuts, 1).T, spline(cuts, 2).T
    assert np.abs(np.stack([positions.x, positions.y], axis=-1) - spline(cuts)).max() < 1e-10
    assert np.abs(np.sin(positions.heading - np.arctan2(dy, dx))).max() < 1e-9
    assert positions.curvature == pytest.approx((dx * ddy - dy * ddx) / np.hypot(dx, dy) ** 3, rel=1e-8, abs=1e-9)


def test_a_memory_holds_what_controllers_read_of_a_road():
    """Numbers, pieces and headings as `pack_roads` has them, to the bit."""
    for points, closed in ((BENDS, False), (OVAL, True)):
        _, _, memory = make_path(points, closed)
        (start, pieces, numbers), headings = path.line_in(memory)
        road = road_through(points, closed=closed)
        packed = pack_roads([road])
        for ours, theirs in zip((numbers, start, pieces, headings), packed[1:], strict=True):
            assert ours.tobytes() == theirs.tobytes()
        assert numbers[kernel.LAP_TURN] == pytest.approx(2.0 * math.pi if closed else 0.0)
        assert np.abs(road.at(np.linspace(0.0, road.length, 500)).curvature).max() <= numbers[kernel.MOST_CURVATURE]


def test_a_path_far_from_the_origin_is_the_same_path():
    near, there = line_of(BENDS), line_of(BENDS + 2.0**20)
    assert np.abs(there.start - near.start).max() < 1e-6
    assert (
        np.abs(there.pieces[:, kernel.ALONG_COEFFICIENTS :] - near.pieces[:, kernel.ALONG_COEFFICIENTS :]).max() < 1e-6
    )


# -- points that count as one -----------------------------------------------------------------------------------------
SINE = np.stack([np.arange(60.0), 5.0 * np.sin(np.arange(60.0) / 30.0)], axis=-1)


def sine_with(row, *offsets):
    """The points of a sine with others behind one of them, at offsets (m) from it."""
    return np.insert(SINE, row + 1, SINE[row] + np.array(offsets), axis=0)


@pytest.mark.parametrize(("points", "repetitions"), [
    (sine_with(20, (-1e-4, 1e-3)), [21]),  # a planner's stop point
    (sine_with(20, (0.0, 0.0), (0.05, -0.03), (0.0, 0.0)), [21, 22, 23]),  # a stop point at a seam, repeated
    (np.concatenate([SINE[:1] - 0.003, SINE]), [1]),
    (np.concatenate([SINE, SINE[-1:] + 0.003]), [59]),
    (np.repeat(SINE, 2, axis=0), [*range(1, 119, 2), 118]),
])  # fmt: skip
def test_a_point_nearer_to_another_than_its_error_is_repetitions_and_named(points, repetitions):
    """The road stays within the error of its points, without the loop that turns by it."""
    road, smooth = road_through(points), road_through(SINE)
    foot = smooth.project(*road.at(np.linspace(0.0, road.length, 2000))[:2])
    assert np.abs(foot.offset).max() < 5e-3
    assert np.abs(road.at(np.linspace(0.0, road.length, 5000)).curvature).max() < 0.012  # 0.16 m is 6.2/m
    s = np.linspace(1.0, road.length - 1.0, 3000)
    assert np.abs(road.at(s).heading - smooth.at(s).heading).max() < 2e-3
    rows = np.empty(len(points))
    count = path.points_apart(points, False, rows)
    assert sorted(set(range(len(points))) - set(rows[:count].astype(int))) == sorted(repetitions)
    (note,) = road.notes
    assert note.startswith(f"{len(repetitions)} of {len(points)} points left out")
    assert f"point {repetitions[0]} (" in note


@pytest.mark.parametrize("error", [(0.0, 0.0), (0.003, -0.002), (-0.002, 0.004)])
def test_a_lap_whose_last_point_repeats_the_first_one_is_the_lap_without_it(error):
    ring = np.concatenate([OVAL, OVAL[:1] + np.array(error)])
    assert line_of(ring, closed=True).pieces.tobytes() == line_of(OVAL, closed=True).pieces.tobytes()


@pytest.mark.parametrize("spacing", [1e-3, 0.05, 1.0, 300.0])
def test_a_path_with_even_steps_keeps_its_points_however_dense(spacing):
    points = spacing * SINE
    rows = np.empty(len(points))
    assert path.points_apart(points, False, rows) == len(points)
    assert np.abs(road_through(points).project(*points.T).offset).max() < 1e-9 * max(spacing, 1.0)


def test_points_that_are_denser_in_a_bend_stay():
    """Steps of 5 m and, over more than a tenth of that, of 0.2 m; a pair that is more than 0.2 m apart."""
    s = np.concatenate([np.arange(0.0, 50.0, 5.0), np.arange(50.0, 52.0, 0.2), [52.0, 57.0, 57.25, 62.0, 67.0]])
    points = np.stack([s, 0.002 * s * s], axis=-1)
    assert path.points_apart(points, False, np.empty(len(s))) == len(s)


# -- what is no path --------------------------------------------------------------------------------------------------
def bends_with(row, value):
    points = BENDS.copy()
    points[row] = value
    return points


@pytest.mark.parametrize(("points", "status", "where"), [
    (FEW[:3], path.TOO_FEW, 3),
    (np.zeros((0, 2)), path.TOO_FEW, 0),
    (np.zeros((9, 1)), path.TOO_FEW, 9),
    (bends_with(5, math.nan), path.POINT_NOT_FINITE, 5),
    (bends_with(5, -math.inf), path.POINT_NOT_FINITE, 5),
    (bends_with(5, 1e9), path.POINT_TOO_FAR, 5),
    (bends_with(5, 2e4), path.POINT_TOO_FAR, 4),
    (np.repeat(BENDS[:3], 4, axis=0), path.TOO_FEW, 3),
    (np.zeros((9, 2)), path.TOO_FEW, 1),
    (1e-5 * BENDS, path.TOO_SHORT, 0),
    ([(3.0 - abs(k), 0.0) for k in range(-3, 4)], path.PATH_KINK, 3),
])  # fmt: skip
def test_what_makes_no_path_has_a_status_and_a_place(points, status, where):
    assert make_path(points)[:2] == (status, where)


def test_no_number_outside_of_a_memory_is_touched_and_too_small_a_one_is_said():
    points = np.array(FEW)
    size = path.path_words(points, False)
    statuses = []
    for words in [*range(0, 60), *range(60, size + 1, 23), size]:
        around = np.full(words + 20, 7.0)
        status, _ = path.path_through(points, False, 0.0, around[10 : 10 + words])
        statuses.append(status)
        assert (around[:10] == 7.0).all()
        assert (around[10 + words :] == 7.0).all()
    assert set(statuses) == {path.TOO_SMALL, path.OK}
    assert statuses == sorted(statuses, reverse=True)


def test_any_points_have_a_status_and_paths_go_through_theirs(rng):
    """Random walks of all scales, with jumps, repetitions, huge and missing numbers."""
    statuses = set()
    for _ in range(60):
        count = int(rng.integers(0, 12))
        points = np.cumsum(rng.normal(0.5, 10.0 ** rng.uniform(-4, 3), (count, 2)), axis=0)
        if count and rng.random() < 0.5:
            points[rng.integers(count)] = rng.choice([math.nan, math.inf, 1e300, -1e9, 0.0, points[0, 0]], 2)
        closed = bool(rng.random() < 0.3)
        status, line_length, memory = make_path(points, closed)
        statuses.add(status)
        if status == path.OK:
            line, _ = path.line_in(memory)
            assert all(np.isfinite(array).all() for array in line)
            assert (np.diff(line.start) > 0.0).all()
            first = points_on_pieces(line.pieces, -np.ones(line_length))
            gaps = np.hypot(first.x[:, np.newaxis] - points[:, 0], first.y[:, np.newaxis] - points[:, 1]).min(axis=0)
            assert gaps[:-1].max() < 1e-7
    assert {path.OK, path.TOO_FEW} < statuses

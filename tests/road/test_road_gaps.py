"""Points far apart: what a fitted road is between them, and what counts as two pieces."""

import math

import numpy as np
import pytest

from adaptrack.base.errors import ConfigError, InvalidInput
from adaptrack.road import fit_road, generate_road, load_road
from references.road import coarse_samples, nearest_by_search


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

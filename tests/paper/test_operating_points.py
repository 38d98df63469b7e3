"""Conditions: the authors' grid, even samples of a box, and left-right twins that are computed once."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from adaptrack.base.errors import InvalidInput
from adaptrack.paper.operating_points import (
    PAPER_GRID,
    POINT_COORDINATES,
    POINT_NAMES,
    Grid,
    PaperGrid,
    canonical,
    check_operating_points,
    fold,
    mirrored,
    sobol,
)

BOX = {"speed": (3.0, 30.0), "y_ref": (-15.0, 15.0), "friction": (0.3, 1.0), "wind": (-30.0, 30.0)}
ONE = {"speed": [10.0], "y_ref": [2.0], "friction": [0.9], "wind": [0.0]}

some_conditions = st.lists(
    st.tuples(
        st.sampled_from([3.0, 10.0]),
        st.sampled_from([-2.0, -1.0, -0.0, 0.0, 1.0, 2.0]),
        st.sampled_from([0.5, 0.9]),
        st.sampled_from([-6.0, -0.0, 0.0, 6.0]),
    ),
    min_size=1,
    max_size=30,
)


def test_the_papers_grid_has_its_6435_conditions_in_the_published_order():
    rows = PaperGrid().rows()
    assert rows.shape == (6435, 4) == (9 * 13 * 5 * 11, len(POINT_COORDINATES))
    order = ("y_ref", "speed", "friction", "wind")  # the last changes fastest
    combinations = itertools.product(*(PAPER_GRID[name] for name in order))
    expected = np.array(list(combinations))[:, [order.index(name) for name in POINT_NAMES]]
    np.testing.assert_array_equal(rows, expected)
    assert len(np.unique(rows, axis=0)) == 6435
    assert sorted(set(rows[:, 0])) == [3, 5, 7, 9, 11, 13, 15, 17, 19, 21, 23, 25, 27]
    assert sorted(set(rows[:, 3])) == list(range(-30, 31, 6))


def test_the_papers_grid_needs_5005_swarms_because_two_amplitudes_have_twins():
    # Of its nine references only 14 and 2 m stand on both sides: 2 x 13 x 5 x 11 twins.
    rows = PaperGrid().rows()
    twins = fold(rows)
    assert len(twins.representatives) == 6435 - 2 * 13 * 5 * 11 == 5005
    assert (rows != rows[twins.representatives[twins.family]]).any(axis=1).sum() == 1430


def one(changes):
    return Grid(**ONE | changes).rows()


def box(sides):
    return sobol(10, sides)


@pytest.mark.parametrize(("make", "argument", "message"), [
    (one, {"speed": []}, r"Grid: speed = \[\]: must be"),
    (one, {"wind": 3.0}, "Grid: wind = 3.0: must be a valid tuple"),
    (one, {"wind": ["x"]}, r"Grid: wind\[0\] = 'x': must be a valid number"),
    (one, {"y_ref": [1.0, 2.0, 1.0]}, "y_ref: a level is given twice"),
    (one, {"speed": [float("nan")]}, r"speed\[0\] = nan: must be a finite number"),
    (one, {"speed": [-5.0]}, r"speed = -5 in row 0: must be in \[1, 100\] m/s"),
    (box, {**BOX, "speed": (30.0, 3.0)}, r"speed = \[30, 3\] is empty"),
    (box, {**BOX, "speed": (30.0, float("nan"))}, r"speed\[1\] = nan: must be a finite number"),
    (box, {**BOX, "friction": (0.0, 1.0)}, r"friction = \[0, 1\]: must be within"),
    (box, {**BOX, "wind": (-3.0,)}, "Box: wind: missing"),
    (box, {"speed": (1.0, 2.0), "winds": (0.0, 1.0)}, "(?s)y_ref: missing.*wind: missing.*winds: unknown"),
    (check_operating_points, [], "operating points"),
    (check_operating_points, [1.0, 2.0, 3.0, 4.0], "operating points"),
    (check_operating_points, [[1.0, 2.0, 3.0]], "operating points"),
    (check_operating_points, "text", "operating points"),
])  # fmt: skip
def test_a_grid_a_box_and_points_that_make_no_sense_are_refused_with_the_quantity(make, argument, message):
    with pytest.raises(InvalidInput, match=message):
        make(argument)


def test_a_sobol_sample_depends_on_its_seed_alone_and_begins_with_the_shorter_one():
    np.testing.assert_array_equal(sobol(100, BOX, 7), sobol(1000, BOX, 7)[:100])
    assert not (sobol(100, BOX, 7) == sobol(100, BOX, 8)).any()


def test_a_sobol_sample_fills_the_box_more_evenly_than_chance(rng):
    from scipy.stats import qmc

    points = sobol(512, BOX, 3)
    low, high = np.array([BOX[name] for name in POINT_NAMES]).T
    assert ((points >= low) & (points <= high)).all()
    assert qmc.discrepancy((points - low) / (high - low)) < 0.5 * qmc.discrepancy(rng.random((512, 4)))
    for column in ((points - low) / (high - low)).T:  # each of 16 slices holds its share, 32
        np.testing.assert_array_equal(np.histogram(column, 16, (0, 1))[0], 32)


def test_mirroring_leaves_speed_and_friction_and_makes_no_negative_zero():
    image = mirrored([[10.0, 0.0, 0.9, -6.0], [20.0, 3.0, 0.5, 0.0]])
    np.testing.assert_array_equal(image, [[10.0, 0.0, 0.9, 6.0], [20.0, -3.0, 0.5, 0.0]])
    assert not np.signbit(image[0, 1])
    assert not np.signbit(image[1, 3])


@given(some_conditions)
def test_folding_can_be_undone_and_leaves_no_twin(rows):
    rows = check_operating_points(rows)
    twins = fold(rows)
    represented = rows[twins.representatives]
    first, image = represented[twins.family], mirrored(represented)[twins.family]
    assert ((rows == first).all(axis=1) | (rows == image).all(axis=1)).all()
    assert (np.diff(twins.representatives) > 0).all()
    families = {frozenset({tuple(a), tuple(b)}) for a, b in zip(represented, mirrored(represented), strict=True)}
    assert len(families) == len(represented)  # no two of them are twins
    for i, row in enumerate(rows):  # the first of a family represents it
        family = [k for k in range(len(rows)) if (rows[k] == row).all() or (mirrored(rows[k : k + 1])[0] == row).all()]
        assert twins.representatives[twins.family[i]] == family[0]


@given(some_conditions)
def test_twins_share_one_canonical_condition(rows):
    np.testing.assert_array_equal(canonical(rows), canonical(mirrored(rows)))
    assert (canonical(rows)[:, 1] >= 0).all()

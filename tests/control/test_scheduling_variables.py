"""The scheduling variables are defined once, and what a scheduler answers is read or refused."""

import math

import numpy as np
import pytest

import adaptrack as at
from adaptrack.control.scheduling import VARIABLES, read_tuning, reference_preview
from adaptrack.control.scheduling.variables import complete


def test_every_variable_has_a_label_a_unit_and_a_range():
    assert tuple(VARIABLES) == at.SchedulingVariables._fields
    for variable in VARIABLES.values():
        assert variable.label
        assert variable.unit
        assert variable.meaning
        assert variable.low < variable.high


def test_what_may_be_left_out_at_the_end_is_zero():
    assert complete([15.0, 1.0, 0.8, 3.0]) == at.SchedulingVariables(15.0, 1.0, 0.8, 3.0, 0.0, 0.0, 0.0)
    assert complete(np.arange(7.0)) == at.SchedulingVariables(*range(7))
    assert complete(all_given := at.SchedulingVariables(*range(7))) is all_given


@pytest.mark.parametrize(
    "values",
    [[], [15.0, 1.0, 0.8], np.zeros(8), None, 15.0, "1234", ["15"] * 7, [10**400] * 7, np.zeros((4, 4))],
    ids=str,
)
def test_missing_variables_and_what_is_no_number_are_refused(values):
    with pytest.raises(at.InvalidInput, match="need 7 numbers, speed, y_ref"):
        complete(values)


# -- the reference ahead ----------------------------------------------------------------------------------------------
def test_the_preview_is_that_of_the_reference_and_nothing_else():
    t = 0.05 * np.arange(400)
    change, acceleration = reference_preview(2.0 * t, 0.05, len(t))  # straight on, beyond the end too
    np.testing.assert_allclose(change, 6.0, atol=1e-9)
    np.testing.assert_allclose(acceleration, 0.0, atol=1e-9)
    bend = 0.5 * 1.5 * np.maximum(t - 10.0, 0.0) ** 2
    change, acceleration = reference_preview(bend, 0.05, len(t))
    assert acceleration[t < 6.9].max() == 0.0
    np.testing.assert_allclose(acceleration[(t > 7.2) & (t < 16.0)], 1.5, rtol=1e-6)
    assert change[200] == pytest.approx(0.5 * 1.5 * 3.0**2)  # at 10 s
    np.testing.assert_array_equal(reference_preview(-bend, 0.05, len(t)), (change, acceleration))


# -- answers ----------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    "answer", [at.Tuning(30, 5, 1.0, 10.0), (30, 5, 1, 10.0), [30, 5, 1.0, 10], np.array([30.0, 5, 1, 10])]
)
def test_a_tuning_and_four_numbers_are_an_answer(answer):
    read = read_tuning(answer)
    assert read == (30.0, 5.0, 1.0, 10.0)
    assert all(type(value) is float for value in read)


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (None, "answered None"),
        (30.0, "answered 30.0"),
        ("tune", "must be a number"),
        ("tuning", "answered 'tuning'"),
        ((30, 5, 1.0), "must be a Tuning or the numbers Np, Nc, Q, R"),
        ((30, 5, 1.0, 10.0, 0.0), "must be a Tuning or the numbers"),
        ((30, 5, 1.0, None), "R = None"),
        ((30, 5, True, 1.0), "Q = True"),
        ((30, 5, 1.0, [10.0]), "must be a number"),
        ((30, 5, math.nan, 10.0), "must be finite"),
        ((30, 5, 1.0, math.inf), "must be finite"),
        ((10**400, 5, 1.0, 10.0), "must be finite"),
        (np.zeros((4, 4)), "must be a number"),
    ],
    ids=range(13),
)  # fmt: skip
def test_nonsense_is_no_answer(answer, message):
    with pytest.raises(at.InvalidInput, match=message):
        read_tuning(answer)

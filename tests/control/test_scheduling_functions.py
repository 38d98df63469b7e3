"""Every kind of function keeps one contract: what it packs is what it predicts, moves and saves.

The scheduling variables are defined once, and what a scheduler answers is read or refused.
"""

import math
from dataclasses import dataclass

import numpy as np
import pytest

import adaptrack as at
from adaptrack.control.scheduling import (
    VARIABLES,
    Function,
    Number,
    Table,
    read_tuning,
    reference_preview,
    register_function,
)
from adaptrack.control.scheduling.functions import load_function
from adaptrack.control.scheduling.variables import complete
from small_models import random_network, random_sugeno, random_table

KINDS = ("number", "network", "sugeno", "table")
every_kind = pytest.mark.parametrize("kind", KINDS)


# -- shifts -----------------------------------------------------------------------------------------------------------
def functions(rng):
    return {
        "number": Number(4.25), "network": random_network(rng, 2), "sugeno": random_sugeno(rng, 2),
        "table": random_table(rng, 2, "multilinear"),
    }  # fmt: skip


def test_a_kind_that_nobody_registered_is_refused_with_those_that_are_known():
    for kind in ("spline", None, ["number"]):
        with pytest.raises(at.InvalidInput, match="unknown kind of function"):
            load_function({"kind": kind})


def test_a_kind_of_ones_own_is_driven_saved_and_loaded(tmp_path):
    """Any function that packs itself as one that the kernels know."""

    @register_function
    @dataclass(frozen=True)
    class Ramp(Function):
        """A straight line between two points."""

        x: tuple[float, float]
        y: tuple[float, float]
        kind = "test-ramp"
        n_inputs = 1

        def predict(self, x):
            return np.interp(x[:, 0], self.x, self.y)

        def pack(self):
            return Table((np.array(self.x),), np.array(self.y)).pack()

        def shifted(self, by):
            return Ramp(self.x, tuple(number + by for number in self.y))

        def blended(self, share, value):
            return Ramp(self.x, tuple((1.0 - share) * number + share * value for number in self.y))

        def save(self):
            return {"x": self.x, "y": self.y}

        @classmethod
        def load(cls, saved):
            return cls(tuple(saved["x"]), tuple(saved["y"]))

    ramp = Ramp((0.0, 30.0), (20.0, 50.0))
    schedule = at.Learned({"Np": ramp, "Nc": 5, "log10_ratio": 2.0}, ("speed",), [[0.0, 30.0]])
    at.check_scheduler(schedule)
    schedule.save(tmp_path / "one.json")
    again = at.load_scheduler(tmp_path / "one.json")
    assert again.tuning["Np"].function == ramp
    assert again([10.0, 0.0, 0.8, 0.0]) == (30.0, 5.0, 1.0, 100.0)
    with pytest.raises(at.InvalidInput, match="another kind of function is named 'test-ramp'"):
        register_function(type("Other", (Number,), {"kind": "test-ramp"}))


@every_kind
def test_a_function_is_shifted_by_a_number_or_goes_a_share_of_the_way_to_one_everywhere(kind, rng):
    function, x = functions(rng)[kind], rng.normal(size=(50, 2)) * 3.0
    before = function.predict(x)
    for by in (3.0, -1.5, 0.15, 0.0):
        np.testing.assert_allclose(function.shifted(by).predict(x) - before, by, rtol=0, atol=1e-9)
    for share in (0.0, 0.3, 1.0):
        expected = before + share * (7.0 - before)
        np.testing.assert_allclose(function.blended(share, 7.0).predict(x), expected, rtol=1e-12, atol=1e-9)


# -- variables and answers --------------------------------------------------------------------------------------------
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

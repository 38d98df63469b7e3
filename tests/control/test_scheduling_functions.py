"""Every kind of function keeps one contract: what it packs is what it predicts, moves and saves."""

from dataclasses import dataclass

import numpy as np
import pytest

import adaptrack as at
from adaptrack.control.scheduling import Function, Number, Table, register_function
from adaptrack.control.scheduling.functions import load_function
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

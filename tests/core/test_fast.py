"""The branch-free arctangent, sine and cosine are those of libm, to a few units in the last place."""

import math

import numpy as np
import pytest

from adaptrack.core.kernel import INTERPRETED, float64
from adaptrack.core.maths import fast
from adaptrack.core.member import member

pytestmark = pytest.mark.kernels


def compiled(kernel, count=1):
    """A function of so many real numbers, compiled unless kernels are interpreted: its multiply-add rounds once."""
    return kernel if INTERPRETED else member(kernel.function, float64(*[float64] * count))


arctangent, arctangent_of_ratio = compiled(fast.fast_arctangent), compiled(fast.fast_arctangent_of_ratio, 2)
cosine, sine = compiled(fast.fast_cosine), compiled(fast.fast_sine)

CLAIMED = 4e-15  # the relative error that the module promises


def magnitudes(rng, low, high, count):
    """Numbers of both signs, spread evenly over the orders of magnitude from 10**low to 10**high."""
    return (10.0 ** rng.uniform(low, high, count) * rng.choice([-1.0, 1.0], count)).tolist()


def worst_relative_error(ours, libm, arguments):
    return max(abs(ours(x) - libm(x)) / abs(libm(x)) for x in arguments)


def test_the_arctangent_is_that_of_libm_over_every_magnitude(rng):
    near_the_seams = [
        sign * seam * (1.0 + offset)
        for seam in (math.tan(math.pi / 8), 1.0, math.tan(3 * math.pi / 8))
        for offset in np.linspace(-1e-3, 1e-3, 201).tolist()
        for sign in (-1.0, 1.0)
    ]
    arguments = magnitudes(rng, -300, 300, 2000) + magnitudes(rng, -3, 3, 10000) + near_the_seams
    assert worst_relative_error(arctangent, math.atan, arguments) < CLAIMED


def test_the_arctangent_of_a_ratio_divides_as_libm_does(rng):
    for y, x in zip(magnitudes(rng, -8, 8, 3000), np.abs(magnitudes(rng, -8, 8, 3000)).tolist(), strict=True):
        assert arctangent_of_ratio(y, x) == pytest.approx(math.atan2(y, x), rel=1e-14, abs=0)


@pytest.mark.compiled  # the interpreter's multiply-add rounds twice
@pytest.mark.parametrize(
    ("ours", "libm", "shift"), [(sine, math.sin, 0.0), (cosine, math.cos, 0.5)], ids=["sine", "cosine"]
)
def test_sine_and_cosine_are_those_of_libm_below_a_hundred_thousand_radians(ours, libm, shift, rng):
    near_zeros = [(k + shift) * math.pi * (1.0 + 1e-12) for k in range(1, 30000, 17)]
    arguments = magnitudes(rng, -300, 0, 1000) + rng.uniform(-1e5, 1e5, 10000).tolist() + near_zeros
    assert worst_relative_error(ours, libm, arguments) < CLAIMED


def test_sine_and_cosine_are_those_of_libm_within_a_few_turns(rng):
    for x in rng.uniform(-4 * math.pi, 4 * math.pi, 10000).tolist() + magnitudes(rng, -300, 0, 100):
        assert sine(x) == pytest.approx(math.sin(x), rel=0, abs=1e-14)
        assert cosine(x) == pytest.approx(math.cos(x), rel=0, abs=1e-14)


def test_not_a_number_stays_not_a_number():
    assert math.isnan(arctangent(math.nan))
    assert math.isnan(arctangent_of_ratio(1.0, math.nan))


@pytest.mark.compiled
def test_the_sine_of_no_finite_number_is_not_a_number():
    for x in (math.nan, math.inf, -math.inf):
        assert math.isnan(sine(x))
        assert math.isnan(cosine(x))

"""Eight lanes behave like arrays of eight, compiled or not."""

import math

import numpy as np
import pytest
from numba import njit

from adaptrack.kernels.maths import vectors as simd
from adaptrack.kernels.maths.vectors import LANES


@njit
def _every_operation(A, out):
    a, b, c = simd.load(A, 0, 0), simd.load(A, 1, 0), simd.load(A, 2, 0)
    simd.store(out, 0, 0, simd.add(a, b))
    simd.store(out, 1, 0, simd.sub(a, b))
    simd.store(out, 2, 0, simd.mul(a, b))
    simd.store(out, 3, 0, simd.div(a, b))
    simd.store(out, 4, 0, simd.fma8(a, b, c))
    simd.store(out, 5, 0, simd.larger(a, b))
    simd.store(out, 6, 0, simd.lesser(a, b))
    simd.store(out, 7, 0, simd.where_positive(a, b, c))
    simd.store(out, 8, 0, simd.splat(A[1, 2]))
    simd.store(out, 9, 0, simd.spread(A, 1, 2))
    simd.store(out, 10, 0, simd.zeros())
    simd.store(out, 11, 0, simd.with_lane(a, 3, 7.5))
    simd.store(out, 12, 0, simd.with_lane(a, 9, 7.5))
    simd.store(out, 13, 0, simd.first_lanes(a, 3))
    simd.store(out, 14, 0, simd.last_lanes(a, 3))
    simd.store(out, 15, 0, simd.column(A, 5, 3, 4))
    simd.store(
        out, 16, 0,
        simd.totals(
            simd.load(A, 0, 8), simd.load(A, 1, 8), simd.load(A, 2, 8), simd.load(A, 3, 8),
            simd.load(A, 4, 8), simd.load(A, 5, 8), simd.load(A, 6, 8), simd.load(A, 7, 8),
        ),
    )  # fmt: skip
    return simd.total(a), simd.largest(a), simd.smallest(a), simd.first_equal(a, A[0, 5]), simd.first_equal(a, 99.0)


def test_each_operation_equals_numpy(rng):
    A = rng.normal(size=(8, 16))
    out = np.zeros((17, LANES))
    total, largest, smallest, found, absent = _every_operation(A, out)
    a, b, c = A[:3, :LANES]
    lane = np.arange(LANES)
    expected = [
        a + b, a - b, a * b, a / b, a * b + c, np.maximum(a, b), np.minimum(a, b), np.where(a > 0, b, c),
        np.full(LANES, A[1, 2]), np.full(LANES, A[1, 2]), np.zeros(LANES), np.where(lane == 3, 7.5, a), a,
        np.where(lane < 3, a, 0.0), np.where(lane >= 3, a, 0.0),
        np.concatenate([A[3:5, 4], np.zeros(6)]), A[:, 8:].sum(axis=1),
    ]  # fmt: skip
    np.testing.assert_allclose(out, expected, rtol=1e-14, atol=1e-14)
    assert math.isclose(total, a.sum(), abs_tol=1e-14)
    assert (largest, smallest, found, absent) == (a.max(), a.min(), 5, LANES)


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_lane_that_is_not_finite_is_noticed(value):
    @njit
    def ask(A):
        return simd.all_below_infinity(simd.load(A, 0, 0))

    A = np.zeros((1, LANES))
    A[0, 3] = -math.inf
    assert ask(A)
    A[0, 6] = value
    assert not ask(A)


def test_rows_are_padded_to_a_multiple_of_eight():
    assert [simd.padded(n) for n in (0, 1, 8, 9, 16)] == [0, 8, 8, 16, 16]

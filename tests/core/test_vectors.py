"""Vectors of eight behave like arrays of eight, compiled or not."""

import math

import numpy as np
import pytest

from adaptrack.core.kernel import inlined
from adaptrack.core.maths import vectors
from adaptrack.core.maths.vectors import VECTOR_WIDTH

pytestmark = pytest.mark.kernels


@inlined
def _every_operation(A, out):
    a, b, c = vectors.load(A, 0, 0), vectors.load(A, 1, 0), vectors.load(A, 2, 0)
    vectors.store(out, 0, 0, vectors.add(a, b))
    vectors.store(out, 1, 0, vectors.sub(a, b))
    vectors.store(out, 2, 0, vectors.mul(a, b))
    vectors.store(out, 3, 0, vectors.div(a, b))
    vectors.store(out, 4, 0, vectors.fma8(a, b, c))
    vectors.store(out, 5, 0, vectors.larger(a, b))
    vectors.store(out, 6, 0, vectors.lesser(a, b))
    vectors.store(out, 7, 0, vectors.where_positive(a, b, c))
    vectors.store(out, 8, 0, vectors.splat(A[1, 2]))
    vectors.store(out, 9, 0, vectors.spread(A, 1, 2))
    vectors.store(out, 10, 0, vectors.zeros())
    vectors.store(out, 11, 0, vectors.with_entry(a, 3, 7.5))
    vectors.store(out, 12, 0, vectors.with_entry(a, 9, 7.5))
    vectors.store(out, 13, 0, vectors.keep_first(a, 3))
    vectors.store(out, 14, 0, vectors.keep_last(a, 3))
    vectors.store(out, 15, 0, vectors.column(A, 5, 3, 4))
    vectors.store(
        out, 16, 0,
        vectors.totals((
            vectors.load(A, 0, 8), vectors.load(A, 1, 8), vectors.load(A, 2, 8), vectors.load(A, 3, 8),
            vectors.load(A, 4, 8), vectors.load(A, 5, 8), vectors.load(A, 6, 8), vectors.load(A, 7, 8),
        )),
    )  # fmt: skip
    return (
        vectors.total(a), vectors.largest(a), vectors.smallest(a), vectors.first_equal(a, A[0, 5]),
        vectors.first_equal(a, 99.0),
    )  # fmt: skip


def test_each_operation_equals_numpy(rng):
    A = rng.normal(size=(8, 16))
    out = np.zeros((17, VECTOR_WIDTH))
    total, largest, smallest, finite, absent = _every_operation(A, out)
    a, b, c = A[:3, :VECTOR_WIDTH]
    entry = np.arange(VECTOR_WIDTH)
    expected = [
        a + b, a - b, a * b, a / b, a * b + c, np.maximum(a, b), np.minimum(a, b), np.where(a > 0, b, c),
        np.full(VECTOR_WIDTH, A[1, 2]), np.full(VECTOR_WIDTH, A[1, 2]), np.zeros(VECTOR_WIDTH),
        np.where(entry == 3, 7.5, a), a,
        np.where(entry < 3, a, 0.0), np.where(entry >= 3, a, 0.0),
        np.concatenate([A[3:5, 4], np.zeros(6)]), A[:, 8:].sum(axis=1),
    ]  # fmt: skip
    np.testing.assert_allclose(out, expected, rtol=1e-14, atol=1e-14)
    assert math.isclose(total, a.sum(), abs_tol=1e-14)
    assert (largest, smallest, finite, absent) == (a.max(), a.min(), 5, VECTOR_WIDTH)


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_an_entry_that_is_not_finite_is_noticed(value):
    ask = inlined(lambda A: vectors.all_below_infinity(vectors.load(A, 0, 0)))

    A = np.zeros((1, VECTOR_WIDTH))
    A[0, 3] = -math.inf
    assert ask(A)
    A[0, 6] = value
    assert not ask(A)

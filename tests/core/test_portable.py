"""Mathematics of arrays by the kernels: values, linear algebra, and no dependence on how a matrix lies in memory;
vectors of eight.
"""

import math
from fractions import Fraction

import numpy as np
import pytest
import scipy.linalg

from adaptrack.core.kernel import inlined
from adaptrack.core.maths import portable, vectors
from adaptrack.core.maths.vectors import VECTOR_WIDTH
from adaptrack.road.segments import NODES, WEIGHTS

pytestmark = pytest.mark.kernels


def drawn(*shape):
    return np.random.default_rng(1).normal(size=shape)


@pytest.mark.parametrize(("name", "low", "high"), [
    ("exp", -700, 700), ("log", 1e-300, 9), ("log10", 0.1, 9), ("log1p", -0.9, 9), ("expm1", -20, 20),
    ("sin", -9, 9), ("cos", -9, 9), ("tan", -9, 9), ("tanh", -9, 9), ("logistic", -699, 40),
])  # fmt: skip
def test_a_function_of_an_array_has_the_values_of_numpys_and_of_numbers(name, low, high):
    x, function = np.linspace(low, high, 60).reshape(5, 12), getattr(portable, name)
    expected = 1.0 / (1.0 + np.exp(-x)) if name == "logistic" else getattr(np, name)(x)
    np.testing.assert_allclose(function(x), expected, rtol=1e-15, atol=1e-15)
    assert function(float(x[1, 2])) == function(x)[1, 2]


def test_functions_of_two_numbers_broadcast():
    x, y = np.array([[3.0], [5.0]]), np.array([4.0, 12.0, -1.0])
    np.testing.assert_allclose(portable.hypot(x, y), np.hypot(x, y), rtol=1e-15)
    np.testing.assert_allclose(portable.atan2(x, y), np.arctan2(x, y), rtol=1e-15)
    np.testing.assert_allclose(portable.power(x, y), x**y, rtol=1e-15)
    assert portable.hypot(2.0, 3.0, 6.0) == pytest.approx(7.0, rel=1e-15)
    assert portable.power(10, 3) == pytest.approx(1000.0, rel=1e-14)


def test_geometric_steps_begin_and_end_exactly():
    values = portable.geomspace(1e-3, np.pi, 50)
    assert (values[0], values[-1]) == (1e-3, np.pi)
    np.testing.assert_allclose(values[1:] / values[:-1], (np.pi / 1e-3) ** (1 / 49), rtol=1e-14)


def test_complex_numbers_turn_and_multiply_as_in_the_plane():
    z, w = drawn(7) + 1j * drawn(7)[::-1], portable.direction(drawn(7))
    np.testing.assert_allclose(portable.times(z, w), z * w, rtol=1e-15)
    np.testing.assert_allclose(portable.magnitude(portable.times(z, w)), np.abs(z), rtol=1e-15)


@pytest.mark.parametrize(
    ("left", "right"), [((3, 4), (4, 2)), ((4,), (4, 2)), ((3, 4), (4,)), ((4,), (4,)), ((5, 3, 4), (4, 2)),
                        ((2, 1, 3, 4), (5, 4, 1))],
)  # fmt: skip
def test_a_product_is_that_of_matmul_summed_from_the_first_term_on(left, right):
    a, b = drawn(*left), drawn(*right)
    product = portable.product(a, b)
    assert product.shape == np.matmul(a, b).shape
    np.testing.assert_allclose(product, np.matmul(a, b), rtol=1e-13, atol=1e-15)
    assert (portable.product(np.asfortranarray(a), np.asfortranarray(b)) == product).all()
    np.testing.assert_allclose(portable.product(a, 1j * b), 1j * product, rtol=1e-15)
    row, column = a.reshape(-1, 4)[0], b.reshape(-1, right[-1] if len(right) > 1 else 1)[:4, 0]
    if left == (4,) and right == (4,):
        assert product == ((row[0] * column[0] + row[1] * column[1]) + row[2] * column[2]) + row[3] * column[3]


def test_sizes_that_do_not_fit_are_refused():
    with pytest.raises(ValueError, match="inner sizes"):
        portable.product(np.eye(3), np.eye(4))


def test_equations_are_solved_to_their_residual_and_singular_ones_are_refused():
    a, b = drawn(6, 9, 9), drawn(9, 2)
    x = portable.solve(a, b)
    assert np.abs(a @ x - b).max() < 1e-12 * np.abs(x).max()
    exchanged = np.array([[0.0, 1.0], [2.0, 0.0]])  # no pivot without an exchange of rows
    assert portable.solve(exchanged, np.array([3.0, 4.0])).tolist() == [2.0, 3.0]
    assert portable.inverse(exchanged).tolist() == [[0.0, 0.5], [1.0, 0.0]]
    with pytest.raises(np.linalg.LinAlgError):
        portable.solve(np.ones((2, 2)), np.ones(2))


def test_least_squares_leave_a_residual_at_right_angles_to_every_column():
    a, b = drawn(30, 5), drawn(30)
    assert np.abs(a.T @ (b - a @ portable.least_squares(a, b))).max() < 1e-13
    r = portable.triangle(a)
    assert np.tril(r, -1).any() == np.False_
    np.testing.assert_allclose(r.T @ r, a.T @ a, atol=1e-13)


def test_the_exponential_is_that_of_a_rotation_and_of_scipy():
    turn = np.array([[0.0, -2.5], [2.5, 0.0]])
    rotation = [[np.cos(2.5), -np.sin(2.5)], [np.sin(2.5), np.cos(2.5)]]
    np.testing.assert_allclose(portable.exponential_of(turn), rotation, atol=1e-15)
    stiff = np.diag([-1e3, -2.0, 0.0]) + np.triu(drawn(3, 3))
    np.testing.assert_allclose(portable.exponential_of(stiff), scipy.linalg.expm(stiff), rtol=1e-11, atol=1e-14)
    assert (portable.exponential_of(np.zeros((3, 3))) == np.eye(3)).all()


def test_the_spectral_radius_is_the_largest_eigenvalue_whatever_the_units_of_the_states():
    a = drawn(8, 12, 12)
    units = np.diag(10.0 ** np.arange(-6, 6))
    expected = np.abs(np.linalg.eigvals(a)).max(axis=-1)
    np.testing.assert_allclose(portable.spectral_radius(a), expected, rtol=1e-12)
    np.testing.assert_allclose(portable.spectral_radius(units @ a @ np.linalg.inv(units)), expected, rtol=1e-10)
    special = np.array([[[0.0, 1.0], [0.0, 0.0]], [[1.0, 5.0], [0.0, 1.0]], [[0.0, -0.5], [0.5, 0.0]]])
    assert portable.spectral_radius(special) == pytest.approx([0.0, 1.0, 0.5], abs=1e-12)


def test_eigenvectors_of_a_symmetric_matrix_make_it_again():
    a = drawn(8, 8)
    a = a + a.T
    values, vectors = portable.eigen(a)
    np.testing.assert_allclose(vectors * values @ vectors.T, a, atol=1e-13)
    np.testing.assert_allclose(vectors.T @ vectors, np.eye(8), atol=1e-14)
    flat = np.outer(a[0], a[0])  # of rank 1
    np.testing.assert_allclose(portable.pseudo_inverse(flat), np.linalg.pinv(flat), atol=1e-13)


def test_a_factor_of_bands_solves_as_the_whole_matrix():
    bands = np.vstack([0.2 * drawn(2, 9), 3.0 + np.abs(drawn(1, 9))])
    whole_numbers = sum(np.diag(bands[2 - k, k:], k) for k in range(3))
    whole_numbers = whole_numbers + np.triu(whole_numbers, 1).T
    x = portable.banded_solve(portable.banded_factor(bands), drawn(9, 4))
    np.testing.assert_allclose(whole_numbers @ x, drawn(9, 4), atol=1e-14)
    with pytest.raises(np.linalg.LinAlgError):
        portable.banded_factor(-bands)


def test_the_quadrature_of_clothoids_is_exact_to_degree_31():
    for degree in range(32):
        assert abs(float((WEIGHTS * NODES**degree).sum()) - Fraction(1 + (-1) ** degree, degree + 1)) < 5e-16


# -- vectors ----------------------------------------------------------------------------------------------------------
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

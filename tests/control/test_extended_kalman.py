"""The steps of the extended Kalman filter are those of the textbook, for any number of states."""

import numpy as np
import pytest

from adaptrack.core.estimators import extended_kalman as kernel
from adaptrack.core.maths.vectors import padded

pytestmark = pytest.mark.kernels

carry, scatter, bounded, correct = kernel.carry, kernel.scatter, kernel.bounded, kernel.correct
every_size = pytest.mark.parametrize(("n", "m"), [(5, 2), (8, 8)])


def wide(matrix):
    """Its rows padded with zeros."""
    rows = np.zeros((*matrix.shape[:-1], padded(matrix.shape[-1])))
    rows[..., : matrix.shape[-1]] = matrix
    return rows


def covariance(n, rng):
    """(n, n) symmetric and positive definite."""
    root = rng.normal(size=(n, n))
    return root @ root.T + 0.1 * np.eye(n)


@every_size
def test_a_covariance_is_carried_by_the_jacobian_on_both_sides(n, m, rng):
    F = np.diag(rng.uniform(0.5, 1.0, n))
    F[:m] = rng.normal(size=(m, n))
    before = covariance(n, rng)
    P = wide(before)
    carry(wide(F[:m]), wide(np.diag(F)), P, wide(np.zeros((m, n))))
    np.testing.assert_allclose(P[:, :n], F @ before @ F.T, rtol=1e-12, atol=1e-12)
    assert not P[:, n:].any()


@every_size
def test_a_measurement_corrects_as_josephs_form_does(n, m, rng):
    before, x, h, noise, innovation = covariance(n, rng), rng.normal(size=n), rng.normal(size=n), 0.3, 0.7
    h[m:] = 0.0
    P, z, cross = wide(before), wide(x), wide(np.zeros(n))
    s = scatter(noise, wide(h), P, cross)
    gain = before @ h / (h @ before @ h + noise)
    left = np.eye(n) - np.outer(gain, h)
    assert s == pytest.approx(h @ before @ h + noise, rel=1e-13)
    np.testing.assert_allclose(cross[:n], before @ h, rtol=1e-12, atol=1e-12)
    correct(innovation, s, cross, z, P)
    np.testing.assert_allclose(z[:n], x + gain * innovation, rtol=1e-12, atol=1e-12)
    joseph = left @ before @ left.T + noise * np.outer(gain, gain)
    np.testing.assert_allclose(P[:, :n], joseph, rtol=1e-11, atol=1e-11)
    assert not P[:, n:].any()
    assert not z[n:].any()


@every_size
def test_a_covariance_stays_positive_definite_and_symmetric_to_the_bit(n, m, rng):
    F = np.diag(rng.uniform(0.9, 1.0, n))
    F[:m] += 0.1 * rng.normal(size=(m, n))
    P, x, cross, scratch = wide(covariance(n, rng)), wide(np.zeros(n)), wide(np.zeros(n)), wide(np.zeros((m, n)))
    for k in range(300):
        carry(wide(F[:m]), wide(np.diag(F)), P, scratch)
        P[range(n), range(n)] += 1e-4
        for i in range(0, n, 2):
            h = wide(np.eye(n)[i] + 0.1 * np.eye(n)[k % n])
            correct(0.1, scatter(1e-3, h, P, cross), cross, x, P)
        np.testing.assert_array_equal(P[:, :n], P[:, :n].T)
        assert np.linalg.eigvalsh(P[:, :n])[0] > 0.0


def test_an_innovation_counts_up_to_so_many_standard_deviations():
    assert bounded(1.0, 0.04, 5.0) == 1.0
    assert bounded(1.1, 0.04, 5.0) == pytest.approx(1.0)
    assert bounded(-9.0, 0.04, 5.0) == pytest.approx(-1.0)

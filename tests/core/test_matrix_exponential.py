"""The functions phi_k of small matrices are those of their definition, at every size of the matrix."""

import math

import mpmath as mp
import numpy as np
import pytest

from adaptrack.core.maths import matrix_exponential as kernel

pytestmark = pytest.mark.kernels

WIDTH = 8
phi_functions, integrals = kernel.phi_functions, kernel.integrals
every_size = pytest.mark.parametrize("n", [2, 3, 4])
every_norm = pytest.mark.parametrize("norm", [1e-8, 1e-3, 0.4, 3.0, 40.0, 1e4])


def padded(z):
    return np.hstack([z, np.zeros((len(z), WIDTH - len(z)))])


def phi(z):
    """phi_0 .. phi_3 (4, n, n) as the kernel computes them."""
    n = len(z)
    phis = np.full((4, n, WIDTH), np.nan)
    phi_functions(padded(z), *phis)
    assert (phis[:, :, n:] == 0.0).all()
    return phis[:, :, :n]


def damped(n, norm, seed=0):
    """A matrix of a norm (1) whose eigenvalues have negative real parts: its exponential stays finite."""
    rng = np.random.default_rng(seed)
    root, turning = rng.normal(size=(2, n, n))
    z = -root @ root.T + turning - turning.T
    return z * (norm / np.abs(z).sum(axis=0).max())


def exact(z):
    """The same from the exponential of a block matrix with 60 digits (Higham, Functions of Matrices, eq. 10.11)."""
    n = len(z)
    with mp.workdps(60):
        block = mp.zeros(4 * n)
        for i in range(n):
            for j in range(n):
                block[i, j] = mp.mpf(float(z[i, j]))
            for k in range(3):
                block[k * n + i, (k + 1) * n + i] = 1
        exponential = mp.expm(block)
        return np.array([[[float(exponential[i, k * n + j]) for j in range(n)] for i in range(n)] for k in range(4)])


@every_size
@every_norm
def test_they_are_the_blocks_of_a_larger_exponential(n, norm):
    z = damped(n, norm)
    for k, (block, expected) in enumerate(zip(phi(z), exact(z), strict=True)):
        assert np.abs(block - expected).max() <= 2e-14 * np.abs(expected).max(), k


def test_of_what_is_not_finite_they_are_no_numbers():
    for value in (math.inf, -math.inf, math.nan):
        assert np.isnan(phi(np.array([[value, 1.0], [0.0, -1.0]]))).any()


def test_integrals_of_a_decay_are_those_of_its_primitive():
    rates, time = np.array([-0.5, -3.0, -40.0]), 0.3
    s = np.full((4, 3, WIDTH), np.nan)
    integrals(padded(np.diag(rates)), time, *s)
    decay = np.exp(rates * time)
    once = (decay - 1.0) / rates
    twice = (once - time) / rates
    thrice = (twice - time**2 / 2) / rates
    for integral, expected in zip(s, (decay, once, twice, thrice), strict=True):
        np.testing.assert_allclose(integral[:, :3], np.diag(expected), rtol=1e-12, atol=1e-18)

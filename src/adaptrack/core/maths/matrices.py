"""Small matrices: products, linear equations, triangles, eigenvalues, bands. Sums run in the order of the indices."""

from __future__ import annotations

import math

from ..kernel import cube, exported, inlined, int64, matrix, vector, void
from .exact import sqrt
from .exponential import exp, log

REGULAR = -1
"""What kernels that factorise return where nothing is singular."""
SQUARINGS = 52
"""Of a matrix whose spectral radius is asked for: the norm of A^(2^k), to the power of 2^-k, is it to rounding."""
SWEEPS = 30
"""Of Jacobi's rotations, at most: they converge quadratically, in six or so."""


@inlined
def product(a, b, c):
    """C = A B: (m, k), (k, n), (m, n)."""
    for i in range(a.shape[0]):
        c[i, :] = 0.0
        for k in range(a.shape[1]):
            factor = a[i, k]
            for j in range(b.shape[1]):
                c[i, j] += factor * b[k, j]


@exported(void(cube, cube, cube))
def multiply_matrices(a, b, c):
    """C = A B for each of n pairs: (n, m, k), (n, k, p), (n, m, p)."""
    for i in range(a.shape[0]):
        product(a[i], b[i], c[i])


@inlined
def largest_pivot(a, k):
    """The row from k on with the largest entry in column k; the first of several."""
    pivot = k
    for i in range(k + 1, a.shape[0]):
        if abs(a[i, k]) > abs(a[pivot, k]):
            pivot = i
    return pivot


@inlined
def swap_rows(a, i, k):
    """Exchange two rows."""
    for j in range(a.shape[1]):
        a[i, j], a[k, j] = a[k, j], a[i, j]


@inlined
def take_off(a, i, factor, k, first):
    """Row i less a multiple of row k, from a column on."""
    for j in range(first, a.shape[1]):
        a[i, j] -= factor * a[k, j]


@inlined
def _solve(a, b):
    n = a.shape[0]
    for k in range(n):
        pivot = largest_pivot(a, k)
        if a[pivot, k] == 0.0:
            return False
        if pivot != k:
            swap_rows(a, pivot, k)
            swap_rows(b, pivot, k)
        for i in range(k + 1, n):
            factor = a[i, k] / a[k, k]
            take_off(a, i, factor, k, k + 1)
            take_off(b, i, factor, k, 0)
    for k in range(n - 1, -1, -1):
        for j in range(b.shape[1]):
            b[k, j] /= a[k, k]
        for i in range(k):
            take_off(b, i, a[i, k], k, 0)
    return True


@exported(int64(cube, cube))
def solve_equations(a, b):
    """Overwrite B by the X of A X = B for each of n pairs, by elimination with row exchanges; A is overwritten too.

    Returns the first that is singular, or `REGULAR`.
    """
    for i in range(a.shape[0]):
        if not _solve(a[i], b[i]):
            return i
    return REGULAR


@exported(void(matrix))
def triangularise(columns):
    """Overwrite the columns (n, m) of A by those of the triangle R of A = Q R, by Householder's reflections."""
    n, m = columns.shape[0], columns.shape[1]
    for k in range(min(m, n)):
        square = 0.0
        for i in range(k, m):
            square += columns[k, i] * columns[k, i]
        if square == 0.0:
            continue
        norm = math.copysign(sqrt(square), columns[k, k])
        columns[k, k] += norm
        for j in range(k + 1, n):
            along = 0.0
            for i in range(k, m):
                along += columns[k, i] * columns[j, i]
            along /= norm * columns[k, k]
            for i in range(k, m):
                columns[j, i] -= along * columns[k, i]
        columns[k, k] = -norm
        columns[k, k + 1 :] = 0.0


@exported(void(cube, cube, vector))
def write_spectral_radii(a, work, radii):
    """Write the spectral radius of each of n matrices (n, m, m), by squaring; they are overwritten. work: (2, m, m)."""
    m = a.shape[1]
    for matrix_number in range(a.shape[0]):
        work[0, :, :] = a[matrix_number]
        logarithm, share = 0.0, 1.0
        for squaring in range(SQUARINGS):
            present, then = work[squaring % 2], work[(squaring + 1) % 2]
            norm = 0.0
            for i in range(m):
                for j in range(m):
                    if not abs(present[i, j]) <= norm:  # also NaN
                        norm = abs(present[i, j])
            logarithm += share * log(norm)
            if not 0.0 < norm < math.inf:
                break
            for i in range(m):
                for j in range(m):
                    present[i, j] /= norm
            product(present, present, then)
            share *= 0.5
        radii[matrix_number] = exp(logarithm)


@exported(void(matrix, matrix))
def diagonalise(a, vectors):
    """Rotate a symmetric A (n, n) until it is diagonal, A = V D V'; V is written to `vectors` (Jacobi 1846)."""
    n = a.shape[0]
    for i in range(n):
        for j in range(n):
            vectors[i, j] = 1.0 if i == j else 0.0
    for _ in range(SWEEPS):
        neighbour = 0.0
        for i in range(n):
            for j in range(i + 1, n):
                if abs(a[i, j]) <= 1e-17 * (abs(a[i, i]) + abs(a[j, j])):
                    continue
                neighbour += 1.0
                half = 0.5 * (a[j, j] - a[i, i]) / a[i, j]
                t = math.copysign(1.0, half) / (abs(half) + sqrt(1.0 + half * half))
                c = 1.0 / sqrt(1.0 + t * t)
                s = t * c
                for k in range(n):
                    a[k, i], a[k, j] = c * a[k, i] - s * a[k, j], s * a[k, i] + c * a[k, j]
                    vectors[k, i], vectors[k, j] = (
                        c * vectors[k, i] - s * vectors[k, j],
                        s * vectors[k, i] + c * vectors[k, j],
                    )
                for k in range(n):
                    a[i, k], a[j, k] = c * a[i, k] - s * a[j, k], s * a[i, k] + c * a[j, k]
        if neighbour == 0.0:
            break


@exported(int64(matrix))
def factor_bands(bands):
    """Overwrite a positive definite matrix by Cholesky's factor U, A = U'U.

    bands (w + 1, n): element (i, j), i <= j <= i + w, at [w + i - j, j]. Returns the first row that is not positive
    definite, or `REGULAR`.
    """
    w, n = bands.shape[0] - 1, bands.shape[1]
    for j in range(n):
        first = max(0, j - w)
        for i in range(first, j + 1):
            left = bands[w + i - j, j]
            for k in range(max(first, i - w), i):
                left -= bands[w + k - i, i] * bands[w + k - j, j]
            if i < j:
                bands[w + i - j, j] = left / bands[w, i]
            elif not left > 0.0:
                return j
            else:
                bands[w, j] = sqrt(left)
    return REGULAR


@exported(void(matrix, matrix))
def solve_bands(factor, b):
    """Overwrite B (n, m) by the X of U'U X = B, with the factor of `factor_bands`."""
    w, n = factor.shape[0] - 1, factor.shape[1]
    for j in range(n):
        for k in range(max(0, j - w), j):
            take_off(b, j, factor[w + k - j, j], k, 0)
        for i in range(b.shape[1]):
            b[j, i] /= factor[w, j]
    for j in range(n - 1, -1, -1):
        for k in range(j + 1, min(n, j + w + 1)):
            take_off(b, j, factor[w + j - k, k], k, 0)
        for i in range(b.shape[1]):
            b[j, i] /= factor[w, j]

"""NumPy's mathematics with the same bits on every processor: elementary functions, products, linear equations.

NumPy's own functions choose their code by the processor's vector unit, BLAS and LAPACK likewise, and the C library's by
whether it has a fused multiply-add. Here the kernels compute (`core.maths`). Not needed for `+ - * /`, `sqrt`, `abs`,
rounding, comparisons, sums and means of real numbers, `cumsum`, `interp`: their bits are the same in NumPy. A power
`x**2` is only so for arrays: for numbers it is the C library's.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import reduce
from typing import Any, Protocol, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..kernel import exported, int64, matrix, vector, void, written
from . import exact, exponential, fast, matrices, trigonometric

Array = NDArray[np.float64]
LinAlgError = np.linalg.LinAlgError

_ARGUMENTS = {
    fast.fast_arctangent_of_ratio: "x, y", trigonometric.asin: "x", trigonometric.atan: "x",
    trigonometric.atan2: "x, y", exact.ceil: "x", trigonometric.cos: "x", fast.fast_cosine: "x", exponential.exp: "x",
    exact.floor: "x", exact.fmod: "x, y", exponential.hypot: "x, y", exponential.log: "x", exponential.log10: "x",
    exponential.log1p: "x", exact.modulo: "x, y", exponential.power: "x, y", trigonometric.sin: "x",
    fast.fast_sine: "x", exact.soft_ceil: "x", exact.soft_floor: "x", exact.soft_fma: "x, y, z", exact.soft_sqrt: "x",
    exact.sqrt: "x", trigonometric.tan: "x", exponential.tanh: "x",
}  # fmt: skip
"""The elementary functions and the names of their arguments; a function has the number of its place."""
FUNCTION_NAMES = tuple(function.__name__ for function in _ARGUMENTS)
_value_of = written(
    "value_of", "function, x, y, z",
    [f"if function == {i}: return {f.__name__}({names})" for i, (f, names) in enumerate(_ARGUMENTS.items())]
    + ["return nan"],
    **{function.__name__: function for function in _ARGUMENTS},
)  # fmt: skip


@exported(void(int64, matrix, vector), name="elementary_values")
def elementary_values(function, at, values):
    """Write the values of the function with this index in `FUNCTION_NAMES`; at (3, n): its arguments x, y and z."""
    for i in range(values.size):
        values[i] = _value_of(function, at[0, i], at[1, i], at[2, i])


_NUMBER = float, int, np.floating


class _OfOne(Protocol):
    @overload
    def __call__(self, x: float, /) -> float: ...
    @overload
    def __call__(self, x: ArrayLike, /) -> Array: ...


class _OfTwo(Protocol):
    @overload
    def __call__(self, x: float, y: float, /) -> float: ...
    @overload
    def __call__(self, x: ArrayLike, y: ArrayLike, /) -> Array: ...


def _elementwise(kernel: Callable[..., float]) -> Any:
    """A kernel of one or two numbers, for arrays of them too, which broadcast."""
    number = FUNCTION_NAMES.index(kernel.__name__)

    def function(*arguments: Any) -> Any:
        if all(isinstance(x, _NUMBER) for x in arguments):
            return kernel(*map(float, arguments))
        arrays = np.broadcast_arrays(*(np.asarray(x, dtype=np.float64) for x in arguments))
        at, values = np.zeros((3, arrays[0].size)), np.empty(arrays[0].size)
        for row, x in zip(at, arrays, strict=False):
            row[:] = x.ravel()
        elementary_values(number, at, values)
        return values.reshape(arrays[0].shape)

    return function


exp: _OfOne = _elementwise(exponential.exp)
log: _OfOne = _elementwise(exponential.log)
log10: _OfOne = _elementwise(exponential.log10)
log1p: _OfOne = _elementwise(exponential.log1p)
tanh: _OfOne = _elementwise(exponential.tanh)
sin: _OfOne = _elementwise(trigonometric.sin)
cos: _OfOne = _elementwise(trigonometric.cos)
tan: _OfOne = _elementwise(trigonometric.tan)
atan: _OfOne = _elementwise(trigonometric.atan)
atan2: _OfTwo = _elementwise(trigonometric.atan2)
_hypot: _OfTwo = _elementwise(exponential.hypot)
power: _OfTwo = _elementwise(exponential.power)


def hypot(*components: Any) -> Any:
    """The root of the sum of the squares of components."""
    return reduce(_hypot, components)


def expm1(x: Any) -> Any:
    """exp(x) - 1, without the loss of digits near 0: below 1 it is 2 t/(1 - t) with t = tanh(x/2)."""
    t = tanh(0.5 * np.minimum(x, 1.0))
    return np.where(np.less(x, 1.0), 2.0 * t / (1.0 - t), exp(x) - 1.0)


def logistic(x: Array) -> Array:
    """1/(1 + exp(-x))."""
    return 1.0 / (1.0 + exp(np.minimum(-x, 700.0)))


def direction(angle: Any) -> Any:
    """exp(i angle) for angles in rad."""
    return cos(angle) + 1j * sin(angle)


def times(z: Any, w: Any) -> Any:
    """z w of complex numbers, which NumPy fuses where the processor can."""
    return (z.real * w.real - z.imag * w.imag) + 1j * (z.real * w.imag + z.imag * w.real)


def magnitude(z: Any) -> Any:
    """|z| of complex numbers."""
    return hypot(z.real, z.imag)


def square(x: Any) -> Any:
    """x x; `x**2` of a number is the C library's power."""
    return x * x


def geomspace(first: float, last: float, count: int) -> Array:
    """Numbers from `first` to `last`, both positive, at equal ratios."""
    values = exp(np.linspace(log(float(first)), log(float(last)), count))
    values[:1], values[1:][-1:] = first, last
    return values


# -- matrices ---------------------------------------------------------------------------------------------------------
def product(a: ArrayLike, b: Any) -> Any:
    """The matrix product of `np.matmul`, each sum in the order of its terms; b may be complex."""
    if np.iscomplexobj(b):
        return product(a, np.real(b)) + 1j * product(a, np.imag(b))
    left, right = np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64)
    row, column = left.ndim == 1, right.ndim == 1
    left, right = left[None] if row else left, right[:, None] if column else right
    if left.shape[-1] != right.shape[-2]:
        raise ValueError(f"a product of matrices {left.shape} and {right.shape}: the inner sizes must be equal.")
    outer = np.broadcast_shapes(left.shape[:-2], right.shape[:-2])
    out = np.empty((math.prod(outer), left.shape[-2], right.shape[-1]))
    matrices.multiply_matrices(_stacked(left, outer), _stacked(right, outer), out)
    out = out.reshape(*outer, *out.shape[1:])
    out = out[..., 0, :] if row else out
    return out[..., 0] if column else out


def solve(a: ArrayLike, b: ArrayLike) -> Array:
    """The X of A X = B for matrices (..., n, n) and (..., n, m) or a vector (n,). Raises `LinAlgError` if singular."""
    left, right = np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64)
    vector = right.ndim == 1
    right = right[:, None] if vector else right
    outer = np.broadcast_shapes(left.shape[:-2], right.shape[:-2])
    x = _stacked(right, outer).copy()
    if matrices.solve_equations(_stacked(left, outer).copy(), x) != matrices.REGULAR:
        raise LinAlgError("Singular matrix")
    return x.reshape(right.shape[0]) if vector else x.reshape(*outer, *right.shape[-2:])


def inverse(a: Array) -> Array:
    """The inverse of a matrix (n, n). Raises `LinAlgError` if singular."""
    return solve(a, np.eye(len(a)))


def triangle(a: Array) -> Array:
    """R of A = Q R, (n, n), of a matrix (m, n) with m >= n."""
    columns = np.array(a.T, dtype=np.float64, order="C")
    matrices.triangularise(columns)
    return columns.T[: len(columns)]


def least_squares(a: Array, b: Array) -> Array:
    """The x (n,) of the least |A x - b| for A (m, n) of full rank. Raises `LinAlgError` if it is not."""
    r, n = triangle(np.pad(np.column_stack([a, b]), ((0, 1), (0, 0)))), a.shape[1]
    return solve(r[:n, :n], r[:n, n])


def exponential_of(a: Array) -> Array:
    """exp(A) of a matrix (n, n), by scaling, 18 terms of the series, and squaring."""
    norm = float(np.abs(a).sum(axis=0).max())
    halvings = max(0, math.frexp(norm)[1] + 1)
    scaled, unit = a * 2.0**-halvings, np.eye(len(a))
    result = unit
    for k in range(18, 0, -1):
        result = unit + product(scaled, result) / k
    for _ in range(halvings):
        result = product(result, result)
    return result


def spectral_radius(a: Array) -> Array:
    """The largest magnitude of the eigenvalues of each matrix (..., n, n)."""
    stack, radii = _stacked(a, a.shape[:-2]).copy(), np.empty(math.prod(a.shape[:-2]))
    matrices.write_spectral_radii(stack, np.empty((2, *a.shape[-2:])), radii)
    return radii.reshape(a.shape[:-2])


def eigen(a: Array) -> tuple[Array, Array]:
    """Eigenvalues (n,) and eigenvectors, the columns of (n, n), of a symmetric matrix."""
    turned, vectors = np.array(a, dtype=np.float64, order="C"), np.empty(a.shape)
    matrices.diagonalise(turned, vectors)
    return np.diag(turned).copy(), vectors


def pseudo_inverse(a: Array) -> Array:
    """The pseudo-inverse of a symmetric matrix: eigenvalues below 1e-15 of the largest count as zero."""
    values, vectors = eigen(a)
    counts = np.abs(values) > 1e-15 * np.abs(values).max(initial=0.0)
    return product(vectors * np.where(counts, 1.0 / np.where(counts, values, 1.0), 0.0), vectors.T)


def banded_factor(bands: Array) -> Array:
    """Cholesky's factor of upper bands (w + 1, n), see `maths.matrices`. Raises `LinAlgError` if there is none."""
    factor = np.array(bands, dtype=np.float64, order="C")
    if matrices.factor_bands(factor) != matrices.REGULAR:
        raise LinAlgError("not positive definite")
    return factor


def banded_solve(factor: Array, b: Array) -> Array:
    """The X (n, m) of U'U X = B with the factor of `banded_factor`."""
    x = np.array(b, dtype=np.float64, order="C")
    matrices.solve_bands(factor, x)
    return x


def _stacked(a: Array, outer: tuple[int, ...]) -> Array:
    integer_power = np.ascontiguousarray(np.broadcast_to(a, (*outer, *a.shape[-2:])))
    return integer_power.reshape(math.prod(outer), *a.shape[-2:])

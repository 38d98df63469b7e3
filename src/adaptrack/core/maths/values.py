"""Values of the elementary functions at many points, to compare them with a different processor, or for a table.

A function has the number of its place in `FUNCTION_NAMES`.
"""

from __future__ import annotations

from ..kernel import exported, int64, matrix, vector, void, written
from .exact import ceil, floor, fmod, modulo, soft_ceil, soft_floor, soft_fma, soft_sqrt, sqrt
from .exponential import exp, hypot, log, log1p, log10, power, tanh
from .fast import fast_arctangent_of_ratio, fast_cosine, fast_sine
from .trigonometric import asin, atan, atan2, cos, sin, tan

_ARGUMENTS = {
    fast_arctangent_of_ratio: "x, y", asin: "x", atan: "x", atan2: "x, y", ceil: "x", cos: "x", fast_cosine: "x",
    exp: "x", floor: "x", fmod: "x, y", hypot: "x, y", log: "x", log10: "x", log1p: "x", modulo: "x, y",
    power: "x, y", sin: "x", fast_sine: "x", soft_ceil: "x", soft_floor: "x", soft_fma: "x, y, z", soft_sqrt: "x",
    sqrt: "x", tan: "x", tanh: "x",
}  # fmt: skip
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

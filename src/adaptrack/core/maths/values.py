"""Values of the elementary functions at many points, for whoever compares them: another processor, a table, a figure.

`FUNCTION_NAMES` counts them; those of a kernel's own loop are called there.
"""

from __future__ import annotations

from ..kernel import exported, int64, matrix, vector, void
from .exact import ceil, floor, fmod, modulo, soft_ceil, soft_floor, soft_fma, soft_sqrt, sqrt
from .exponential import exp, hypot, log, log1p, log10, power, tanh
from .fast import fast_arctangent_of_ratio, fast_cosine, fast_sine
from .trigonometric import asin, atan, atan2, cos, sin, tan

FUNCTION_NAMES = (
    "fast_arctangent_of_ratio", "asin", "atan", "atan2", "ceil", "cos", "fast_cosine", "exp", "floor", "fmod",
    "hypot", "log", "log10", "log1p", "modulo", "power", "sin", "fast_sine", "soft_ceil", "soft_floor", "soft_fma",
    "soft_sqrt", "sqrt", "tan", "tanh",
)  # fmt: skip


@exported(void(int64, matrix, vector), name="elementary_values")
def elementary_values(function, at, values):
    """Write the values of the function with this index in `FUNCTION_NAMES`; at (3, n): its arguments x, y and z."""
    for i in range(values.size):
        x, y, z = at[0, i], at[1, i], at[2, i]
        if function == 0:
            value = fast_arctangent_of_ratio(x, y)
        elif function == 1:
            value = asin(x)
        elif function == 2:
            value = atan(x)
        elif function == 3:
            value = atan2(x, y)
        elif function == 4:
            value = ceil(x)
        elif function == 5:
            value = cos(x)
        elif function == 6:
            value = fast_cosine(x)
        elif function == 7:
            value = exp(x)
        elif function == 8:
            value = floor(x)
        elif function == 9:
            value = fmod(x, y)
        elif function == 10:
            value = hypot(x, y)
        elif function == 11:
            value = log(x)
        elif function == 12:
            value = log10(x)
        elif function == 13:
            value = log1p(x)
        elif function == 14:
            value = modulo(x, y)
        elif function == 15:
            value = power(x, y)
        elif function == 16:
            value = sin(x)
        elif function == 17:
            value = fast_sine(x)
        elif function == 18:
            value = soft_ceil(x)
        elif function == 19:
            value = soft_floor(x)
        elif function == 20:
            value = soft_fma(x, y, z)
        elif function == 21:
            value = soft_sqrt(x)
        elif function == 22:
            value = sqrt(x)
        elif function == 23:
            value = tan(x)
        else:
            value = tanh(x)
        values[i] = value

"""The elementary functions of the package, under the names of C's: kernels call these and never the system's library.

Each is at most one unit in the last place off (`benchmarks/elementary.py` measures it) and never raises. What they are
made of gives the same bits on every processor.
"""

from __future__ import annotations

from .exact import fmod, modulo, soft_ceil, soft_floor, soft_fma, soft_sqrt
from .exponential import exp, hypot, log, log1p, log10, power, tanh
from .trigonometric import asin, atan, atan2, cos, sin, tan

__all__ = [
    "asin",
    "atan",
    "atan2",
    "cos",
    "exp",
    "fmod",
    "hypot",
    "log",
    "log1p",
    "log10",
    "modulo",
    "power",
    "sin",
    "soft_ceil",
    "soft_floor",
    "soft_fma",
    "soft_sqrt",
    "tan",
    "tanh",
]

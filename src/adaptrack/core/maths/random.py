"""Counted random numbers: a draw is a hash of its seed and counters, so it has no state, no order and no thread.

The n-th output of a SplitMix64 generator (Steele, Lea & Flood, *Fast splittable pseudorandom number generators*,
OOPSLA 2014) is a mixing function of ``state + n*golden``: any element of the sequence can be had directly. Counters are
taken in one after the other, the output for one being the state for the next.

Bits are unsigned 64-bit integers in compiled code and plain integers with the compiler switched off; the draws are the
same to the last bit.
"""

from __future__ import annotations

import math

import numpy as np

from ..kernel import exported, float64, inlined, int64
from .exact import sqrt
from .exponential import log
from .trigonometric import cos

GOLDEN = 0x9E3779B97F4A7C15
"""2^64 over the golden ratio, odd: the step of the counter."""

_FIRST, _SECOND = 0xBF58476D1CE4E5B9, 0x94D049BB133111EB
_ALL_BITS = 0xFFFFFFFFFFFFFFFF
_UNIT = 2.0**-53
_FOR_NORMALS, _FOR_UNIFORMS = 1, 2  # two families of draws from the same seed


def _output_in_python(state, n):
    z = (int(state) + int(n) * GOLDEN) & _ALL_BITS
    z = ((z ^ (z >> 30)) * _FIRST) & _ALL_BITS
    z = ((z ^ (z >> 27)) * _SECOND) & _ALL_BITS
    return z ^ (z >> 31)


def _unit_in_python(bits):
    return float(bits >> 11) * _UNIT


def _output(state, n):
    """The n-th output of SplitMix64 started at `state`: its finaliser mixes 64 bits one to one."""
    z = np.uint64(state) + np.uint64(n) * np.uint64(GOLDEN)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(_FIRST)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(_SECOND)
    return z ^ (z >> np.uint64(31))


def _unit(bits):
    """The upper 53 bits as a number in [0, 1)."""
    return float(bits >> np.uint64(11)) * _UNIT


output = inlined(_output, interpreted=_output_in_python)
unit = inlined(_unit, interpreted=_unit_in_python)


@exported(float64(int64, int64, int64, int64, int64))
def counted_uniform(seed, stream, a, b, c):
    """A number uniform in [0, 1), a multiple of 2^-53, that depends on its five counters only."""
    state = output(_FOR_UNIFORMS, seed)
    state = output(state, stream)
    state = output(state, a)
    state = output(state, b)
    return unit(output(state, c))


@exported(float64(int64, int64, int64))
def counted_normal(seed, instant, channel):
    """A standard normal number that depends on its three counters only (Box and Muller 1958, on two uniforms)."""
    state = output(_FOR_NORMALS, seed)
    state = output(state, instant)
    u = unit(output(state, 2 * channel + 1)) + _UNIT  # (0, 1]
    v = unit(output(state, 2 * channel + 2))
    return sqrt(-2.0 * log(u)) * cos(2.0 * math.pi * v)

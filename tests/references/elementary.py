"""The elementary functions of the kernels with an oracle (mpmath, 240 bits) and classes of arguments for each."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from typing import Any, NamedTuple

import mpmath as mp
import numpy as np

from adaptrack.core.maths import exact, exponential, trigonometric

PRECISION = 240  # bits
HARDEST = 6381956970095103 * 2.0**797  # of all doubles the one nearest to a multiple of pi/2, relative to its size
Arguments = Callable[[np.random.Generator, int], tuple[np.ndarray, ...]]


def anything(rng: np.random.Generator, count: int) -> np.ndarray:
    """Finite doubles, evenly over all bit patterns."""
    x = rng.integers(-(2**63), 2**63, 2 * count).view(np.float64)
    return x[np.isfinite(x)][:count]


def positive(rng: np.random.Generator, count: int) -> np.ndarray:
    """Finite positive doubles, evenly over all bit patterns."""
    return np.abs(anything(rng, count))


def even(low: float, high: float) -> Callable[[np.random.Generator, int], np.ndarray]:
    """Evenly from low to high."""
    return lambda rng, count: rng.uniform(low, high, count)


def scales(low: float, high: float, signs: tuple[float, ...] = (-1.0, 1.0)) -> Any:
    """Evenly over the orders of magnitude from 2^low to 2^high."""
    return lambda rng, count: 2.0 ** rng.uniform(low, high, count) * rng.choice(signs, count)


def right_angles(rng: np.random.Generator, count: int) -> np.ndarray:
    """The doubles nearest to multiples of pi/2, and the hardest of all."""
    multiples = [float(k * mp.pi / 2) for k in rng.integers(1, 10 ** rng.integers(1, 17, count - 2))]
    return np.array([*multiples, HARDEST, -HARDEST])


def near_one(rng: np.random.Generator, count: int) -> np.ndarray:
    """1 and a little more or less."""
    return 1.0 + scales(-53, -1)(rng, count)


def of(*draws: Any) -> Arguments:
    """One class of arguments, from one generator for each."""
    return lambda rng, count: tuple(generate(rng, count) for generate in draws)


def powers_at(low: float, high: float) -> Arguments:
    """x of any size and y such that log2(x^y) is between low and high."""

    def arguments(rng: np.random.Generator, count: int) -> tuple[np.ndarray, ...]:
        x = positive(rng, count)
        x = np.where(np.abs(np.log2(x)) < 1e-9, 2.0, x)
        return x, rng.uniform(low, high, count) / np.log2(x)

    return arguments


class Function(NamedTuple):
    """A function, its oracle and the arguments that it is tried with, by kind."""

    kernel: Any
    oracle: Callable[..., Any]
    arguments: dict[str, Arguments]


CIRCULAR = {
    "any": of(anything), "a turn": of(even(-4.0, 4.0)), "below 1e5": of(even(-1e5, 1e5)),
    "above 1e5": of(scales(16, 60)), "right angles": of(right_angles), "tiny": of(scales(-1074, -5)),
}  # fmt: skip
LOGARITHMIC = {
    "any": of(positive), "near 1": of(near_one), "0.5 to 2": of(even(0.5, 2.0)),
    "subnormal": of(scales(-1074, -1022, (1.0,))),
}  # fmt: skip
TWO = {
    "any": of(anything, anything), "alike": of(even(-1.0, 1.0), even(-1.0, 1.0)),
    "apart": of(scales(-60, 60), scales(-60, 60)), "subnormal": of(scales(-1074, -1000), scales(-1074, -1000)),
    "huge": of(scales(1000, 1023), scales(1000, 1023)),
}  # fmt: skip
FUNCTIONS = {
    "sin": Function(trigonometric.sin, mp.sin, CIRCULAR),
    "cos": Function(trigonometric.cos, mp.cos, CIRCULAR),
    "tan": Function(trigonometric.tan, mp.tan, CIRCULAR),
    "asin": Function(trigonometric.asin, mp.asin, {
        "any": of(even(-1.0, 1.0)),
        "near 1": of(lambda rng, n: 1.0 - scales(-53, -1, (1.0,))(rng, n)),
        "tiny": of(scales(-1074, 0)),
    }),
    "atan": Function(trigonometric.atan, mp.atan, {
        "any": of(anything),
        "below 3": of(even(-3.0, 3.0)),
        "at the seams": of(
            lambda rng, n: rng.choice([2.0**0.5 - 1.0, 1.0, 2.0**0.5 + 1.0], n) * (1.0 + scales(-50, -5)(rng, n))
        ),
        "subnormal": of(scales(-1074, -1020)),
    }),
    "atan2": Function(trigonometric.atan2, mp.atan2, TWO),
    "exp": Function(exponential.exp, mp.exp, {
        "any": of(even(-745.2, 709.8)),
        "below 1": of(even(-1.0, 1.0)),
        "tiny": of(scales(-1074, -1)),
        "subnormal result": of(even(-745.2, -708.0)),
        "near overflow": of(even(709.0, 709.79)),
    }),
    "log": Function(exponential.log, mp.log, LOGARITHMIC),
    "log10": Function(exponential.log10, mp.log10, LOGARITHMIC),
    "log1p": Function(exponential.log1p, mp.log1p, {
        "any": of(positive),
        "below 1": of(even(-1.0, 1.0)),
        "tiny": of(scales(-1074, -1)),
        "near -1": of(lambda rng, n: scales(-52, -1, (1.0,))(rng, n) - 1.0),
    }),
    "tanh": Function(exponential.tanh, mp.tanh, {
        "any": of(even(-23.0, 23.0)), "below 1": of(even(-1.0, 1.0)), "tiny": of(scales(-1074, 0)),
    }),
    "hypot": Function(exponential.hypot, mp.hypot, TWO),
    "power": Function(exponential.power, mp.power, {
        "any": powers_at(-1080.0, 1024.1),
        "near overflow": powers_at(1000.0, 1024.0),
        "subnormal result": powers_at(-1075.0, -1022.0),
        "near 1": of(near_one, scales(0, 9)),
        "decades": of(lambda rng, n: np.full(n, 10.0), even(-323.0, 308.0)),
    }),
    "fmod": Function(exact.fmod, operator.mod, {}),
    "modulo": Function(exact.modulo, operator.mod, {}),
    "soft_sqrt": Function(exact.soft_sqrt, mp.sqrt, {}),
    "soft_floor": Function(exact.soft_floor, mp.floor, {}),
}  # fmt: skip


def ulps(value: float, exact: Any) -> float:
    """The error of a value in units in the last place of the exact result; what is beyond 2^1024 counts as 2^1024."""
    if value != value or mp.isnan(exact):
        return 0.0 if value != value and mp.isnan(exact) else math.inf
    if exact == 0:
        return 0.0 if value == 0.0 else math.inf
    limit = mp.mpf(2) ** 1024
    clipped, exact = min(max(mp.mpf(value), -limit), limit), min(max(exact, -limit), limit)
    exponent = min(max(int(mp.frexp(exact)[1]) - 1, -1022), 1023)
    return float(abs(clipped - exact) / mp.mpf(2) ** (exponent - 52))


def worst(function: Function, entry: Callable[..., float], arguments: tuple[np.ndarray, ...]) -> tuple[float, Any]:
    """The largest error among these arguments, and where it is."""
    with mp.workprec(PRECISION):
        points = list(zip(*(column.tolist() for column in arguments), strict=True))
        return max((ulps(entry(*at), function.oracle(*map(mp.mpf, at))), at) for at in points)

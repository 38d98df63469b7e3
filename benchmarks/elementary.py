"""How exact and how fast the elementary functions of the kernels are, beside those of the system's library.

    python benchmarks/elementary.py [--json] [--count 20000] [--seed 1] [--only sin cos]

For each function and class of arguments: the largest error found, in units in the last place of the exact result
(mpmath, 240 bits). For each function: the time of a call in a loop over an array, and that of the library's function in
the same loop.
"""

from __future__ import annotations

import argparse
import json
import math
import operator
import platform
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import mpmath as mp
import numba
import numpy as np

from adaptrack.core.kernel import INTERPRETED, Exported, inlined
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


def of(*each: Any) -> Arguments:
    """One class of arguments, from one generator for each."""
    return lambda rng, count: tuple(generate(rng, count) for generate in each)


def powers_at(low: float, high: float) -> Arguments:
    """x of any size and y such that log2(x^y) is between low and high."""

    def arguments(rng: np.random.Generator, count: int) -> tuple[np.ndarray, ...]:
        x = positive(rng, count)
        x = np.where(np.abs(np.log2(x)) < 1e-9, 2.0, x)
        return x, rng.uniform(low, high, count) / np.log2(x)

    return arguments


@dataclass(frozen=True)
class Function:
    """A function, its oracle and what it is tried with."""

    kernel: Any
    oracle: Callable[..., Any]
    arguments: dict[str, Arguments]
    usual: Arguments
    """for the time of a call"""
    library: str = ""
    """the same of the system's library, an expression in x and y"""
    arity: int = 1


CIRCULAR = {
    "any": of(anything),
    "a turn": of(even(-4.0, 4.0)),
    "below 1e5": of(even(-1e5, 1e5)),
    "above 1e5": of(scales(16, 60)),
    "right angles": of(right_angles),
    "tiny": of(scales(-1074, -5)),
}
LOGARITHMIC = {
    "any": of(positive),
    "near 1": of(near_one),
    "0.5 to 2": of(even(0.5, 2.0)),
    "subnormal": of(scales(-1074, -1022, (1.0,))),
}
TWO = {
    "any": of(anything, anything),
    "alike": of(even(-1.0, 1.0), even(-1.0, 1.0)),
    "apart": of(scales(-60, 60), scales(-60, 60)),
    "subnormal": of(scales(-1074, -1000), scales(-1074, -1000)),
    "huge": of(scales(1000, 1023), scales(1000, 1023)),
}
TURN, ONE_TO_THREE = of(even(-3.0, 3.0)), even(0.1, 3.0)
FUNCTIONS = {
    "sin": Function(trigonometric.sin, mp.sin, CIRCULAR, TURN, "math.sin(x)"),
    "cos": Function(trigonometric.cos, mp.cos, CIRCULAR, TURN, "math.cos(x)"),
    "tan": Function(trigonometric.tan, mp.tan, CIRCULAR, TURN, "math.tan(x)"),
    "asin": Function(
        trigonometric.asin,
        mp.asin,
        {
            "any": of(even(-1.0, 1.0)),
            "near 1": of(lambda rng, n: 1.0 - scales(-53, -1, (1.0,))(rng, n)),
            "tiny": of(scales(-1074, 0)),
        },
        of(even(-1.0, 1.0)),
        "math.asin(x)",
    ),
    "atan": Function(
        trigonometric.atan,
        mp.atan,
        {
            "any": of(anything),
            "below 3": of(even(-3.0, 3.0)),
            "at the seams": of(
                lambda rng, n: rng.choice([2.0**0.5 - 1.0, 1.0, 2.0**0.5 + 1.0], n) * (1.0 + scales(-50, -5)(rng, n))
            ),
            "subnormal": of(scales(-1074, -1020)),
        },
        TURN,
        "math.atan(x)",
    ),
    "atan2": Function(trigonometric.atan2, mp.atan2, TWO, of(even(-3.0, 3.0), even(-3.0, 3.0)), "math.atan2(x, y)", 2),
    "exp": Function(
        exponential.exp,
        mp.exp,
        {
            "any": of(even(-745.2, 709.8)),
            "below 1": of(even(-1.0, 1.0)),
            "tiny": of(scales(-1074, -1)),
            "subnormal result": of(even(-745.2, -708.0)),
            "near overflow": of(even(709.0, 709.79)),
        },
        TURN,
        "math.exp(x)",
    ),
    "log": Function(exponential.log, mp.log, LOGARITHMIC, of(ONE_TO_THREE), "math.log(x)"),
    "log10": Function(exponential.log10, mp.log10, LOGARITHMIC, of(ONE_TO_THREE), "math.log10(x)"),
    "log1p": Function(
        exponential.log1p,
        mp.log1p,
        {
            "any": of(positive),
            "below 1": of(even(-1.0, 1.0)),
            "tiny": of(scales(-1074, -1)),
            "near -1": of(lambda rng, n: scales(-52, -1, (1.0,))(rng, n) - 1.0),
        },
        of(ONE_TO_THREE),
        "math.log1p(x)",
    ),
    "tanh": Function(
        exponential.tanh,
        mp.tanh,
        {"any": of(even(-23.0, 23.0)), "below 1": of(even(-1.0, 1.0)), "tiny": of(scales(-1074, 0))},
        TURN,
        "math.tanh(x)",
    ),
    "hypot": Function(exponential.hypot, mp.hypot, TWO, of(even(-3.0, 3.0), even(-3.0, 3.0)), "math.hypot(x, y)", 2),
    "power": Function(
        exponential.power,
        mp.power,
        {
            "any": powers_at(-1080.0, 1024.1),
            "near overflow": powers_at(1000.0, 1024.0),
            "subnormal result": powers_at(-1075.0, -1022.0),
            "near 1": of(near_one, scales(0, 9)),
            "decades": of(lambda rng, n: np.full(n, 10.0), even(-323.0, 308.0)),
        },
        of(ONE_TO_THREE, even(-3.0, 3.0)),
        "x ** y",
        2,
    ),
    "fmod": Function(exact.fmod, operator.mod, {}, of(even(0.0, 30.0), ONE_TO_THREE), "np.fmod(x, y)", 2),
    "modulo": Function(exact.modulo, operator.mod, {}, of(even(-30.0, 30.0), ONE_TO_THREE), "x % y", 2),
    "soft_fma": Function(
        inlined(lambda x, y: exact.soft_fma(x, y, 1.1)), None, {}, of(even(0.0, 3.0), ONE_TO_THREE), "x * y + 1.1", 2
    ),
    "soft_sqrt": Function(exact.soft_sqrt, mp.sqrt, {}, of(ONE_TO_THREE), "math.sqrt(x)"),
    "soft_floor": Function(exact.soft_floor, mp.floor, {}, TURN, "np.floor(x)"),
}


def ulps(value: float, exact: Any) -> float:
    """The error of a value in units in the last place of the exact result; what is beyond 2^1024 counts as 2^1024."""
    if value != value or mp.isnan(exact):
        return 0.0 if value != value and mp.isnan(exact) else math.inf
    if exact == 0:
        return 0.0 if value == 0.0 else math.inf
    limit = mp.mpf(2) ** 1024
    found, exact = min(max(mp.mpf(value), -limit), limit), min(max(exact, -limit), limit)
    exponent = min(max(int(mp.frexp(exact)[1]) - 1, -1022), 1023)
    return float(abs(found - exact) / mp.mpf(2) ** (exponent - 52))


def worst(function: Function, entry: Callable[..., float], arguments: tuple[np.ndarray, ...]) -> tuple[float, Any]:
    """The largest error among these arguments, and where it is."""
    with mp.workprec(PRECISION):
        points = list(zip(*(each.tolist() for each in arguments), strict=True))
        return max((ulps(entry(*at), function.oracle(*map(mp.mpf, at))), at) for at in points)


def nanoseconds(kernel: Any, arity: int, arguments: tuple[np.ndarray, ...]) -> float:
    """The time of a call in a loop over an array of 1024, the least of seven."""
    if arity == 1:

        @numba.njit(error_model="numpy")
        def loop(x, out, turns):
            for _ in range(turns):
                for i in range(x.size):
                    out[i] = kernel(x[i])
    else:

        @numba.njit(error_model="numpy")
        def loop(x, y, out, turns):
            for _ in range(turns):
                for i in range(x.size):
                    out[i] = kernel(x[i], y[i])

    out, turns, times = np.empty(arguments[0].size), 300, []
    loop(*arguments, out, 1)
    for _ in range(7):
        start = time.perf_counter()
        loop(*arguments, out, turns)
        times.append(time.perf_counter() - start)
    return 1e9 * min(times) / turns / out.size


def entry_of(function: Function) -> Callable[..., float]:
    """What Python may call."""
    kernel = function.kernel
    if INTERPRETED or isinstance(kernel, Exported):
        return kernel
    return numba.njit(lambda *arguments: kernel(*arguments), error_model="numpy")


def measured(name: str, count: int, seed: int) -> dict[str, Any]:
    """The errors by class and the times of one function."""
    function, rng = FUNCTIONS[name], np.random.default_rng(seed)
    entry = entry_of(function)
    errors = {each: worst(function, entry, make(rng, count)) for each, make in function.arguments.items()}
    usual = function.usual(rng, 1024)
    variables = "x" if function.arity == 1 else "x, y"
    library = eval(f"lambda {variables}: {function.library}", {"math": math, "np": np})
    return {
        "error_ulp": {each: error for each, (error, _) in errors.items()},
        "at": {each: at for each, (_, at) in errors.items()},
        "ns": nanoseconds(function.kernel, function.arity, usual),
        "library_ns": nanoseconds(numba.njit(library, error_model="numpy"), function.arity, usual),
    }


def main(arguments: list[str] | None = None) -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--count", type=int, default=20000, help="arguments of each class")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", nargs="+", choices=list(FUNCTIONS), default=list(FUNCTIONS))
    options = parser.parse_args(arguments)
    result = {}
    for name in options.only:
        result[name] = one = measured(name, options.count, options.seed)
        if not options.json:
            errors = ", ".join(f"{each} {error:.3f}" for each, error in one["error_ulp"].items())
            print(f"{name:10} {one['ns']:7.2f} ns, library {one['library_ns']:7.2f} ns   {errors}", flush=True)
    if options.json:
        about = {
            "count": options.count,
            "seed": options.seed,
            "machine": platform.machine(),
            "numba": numba.__version__,
        }
        print(json.dumps({**about, "functions": result}))
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""Are the kernels of this build those of another library, to the bit? Which of them does a check call?

    python benchmarks/kernels_against.py numbers LIBRARY [--count N]
    python benchmarks/kernels_against.py called [WORKLOAD ...] [--tests PATH ...]

LIBRARY: a file ``kernels-*.so`` of another state of the repository, or of another compiler, for this processor.
`numbers` compares every exported kernel that takes numbers only, and some of arrays. Other kernels are compared by the
workloads and commands of `against_release.py`. `called` does workloads and tests with the library that checks every
index (``python -m adaptrack.core.build --check``), and names the kernels that they never call.
"""

from __future__ import annotations

import argparse
import copy
import ctypes
import math
import os
import struct
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

SPECIAL = (0.0, -0.0, 1.0, -1.0, math.inf, -math.inf, math.nan, 5e-324, -5e-324, 2.0**-1022, 1e308, 2.0**52, 2.0**53)
MIN_MAGNITUDES = {"reduced_right_angle": 2.0**-6}
"""The smallest magnitude of the arguments of kernels that do not take every number."""


def random_number(rng: np.random.Generator) -> float:
    """A number of any kind: special, of random bits, of an ordinary size, whole."""
    kind = rng.random()
    if kind < 0.15:
        return float(rng.choice(SPECIAL))
    if kind < 0.4:
        return float(struct.unpack("d", rng.bytes(8))[0])
    if kind < 0.8:
        return float(rng.normal() * 10.0 ** rng.integers(-3, 4))
    return float(rng.integers(-50, 50)) / 4.0


def libraries(other: str) -> tuple[Any, Any]:
    """The library at a path, and that of this processor."""
    from adaptrack.core import library

    name = os.environ.get("ADAPTRACK_PROCESSOR") or library.processor()
    own = library.verified_file(library.manifest()["libraries"][name])
    print(f"{Path(other).name} and {own.name}")
    return ctypes.CDLL(other), ctypes.CDLL(str(own))


def random_arguments(kernel: Any, rng: np.random.Generator) -> list[Any]:
    """Arguments of a kernel of numbers, or of a kernel of arrays that no workload calls; empty for all others."""
    from adaptrack.core.controllers.mpc import MPCSettings, MPCSizes
    from adaptrack.core.estimators.learning_method import LearningMethod
    from adaptrack.core.kernel import Scalar, boolean, float64, void

    name, signature = kernel.name, kernel.signature
    if name == "soft_fma8":
        return [np.array([random_number(rng) for _ in range(8)]) for _ in range(4)]
    if name in ("path_parts", "heading_count"):
        return [rng.uniform(0.0, 300.0, 64)]
    if name == "tyre_forces":
        wheels = np.column_stack([rng.normal(0.0, 0.1, 50), rng.uniform(0.0, 8e3, 50), rng.integers(0, 2, 50)])
        return [rng.uniform(0.1, 5.0, 40), rng.uniform(0.1, 1.0), np.ascontiguousarray(wheels), np.zeros(50)]
    if name == "usual_method":
        return [LearningMethod.new(1)[0]]
    if name == "mpc_sizes":
        rows = [kind.new(1)[0] for kind in (MPCSettings, MPCSizes)]
        for row in rows:
            for field in row.dtype.names:
                row[field] = rng.integers(0, 40)
        return [*rows, np.zeros((200, 4), np.int64)]
    if signature.returns == (void,) or not all(isinstance(kind, Scalar) for kind in signature.arguments):
        return []
    return [random_number(rng) if kind == float64 else int(rng.integers(0, 2 if kind == boolean else 60))
            for kind in signature.arguments]  # fmt: skip


def answer(kernel: Any, function: Any, arguments: Sequence[Any]) -> bytes:
    """The bits that a kernel answers and leaves in its arrays; every NaN is one."""
    from adaptrack.core.kernel import float64, void

    words = [
        word for kind, value in zip(kernel.signature.types, arguments, strict=True) for word in kind.convert(value)
    ]
    kinds = [kind for kind in kernel.signature.returns if kind != void]
    room = ctypes.create_string_buffer(8 * len(kinds))
    layout = "".join("d" if kind == float64 else "q" for kind in kinds)
    if len(kinds) > 1:
        function(*words, ctypes.addressof(room))
        numbers = struct.unpack(layout, room.raw)
    else:
        numbers = (function(*words),)[: len(kinds)]
    bits = struct.pack(layout, *(math.nan if number != number else number for number in numbers))
    return bits + b"".join(np.nan_to_num(value, nan=-7.0).tobytes() if value.dtype == float else value.tobytes()
                           for value in arguments if hasattr(value, "tobytes"))  # fmt: skip


def compare(other: str, count: int) -> int:
    """Print which kernels of `random_arguments` differ; return how many do."""
    from adaptrack.core.build.sources import kernels_of

    both = libraries(other)
    compared = different = 0
    for name, kernel in sorted(kernels_of().items()):
        rng, low = np.random.default_rng(len(name)), MIN_MAGNITUDES.get(name, 0.0)
        functions = [kernel.signature.prototype((f"adaptrack_{name}", library)) for library in both]
        samples = [random_arguments(kernel, rng) for _ in range(count)]
        samples = [sample for sample in samples if sample and not any(_is_below(x, low) for x in sample)]
        compared += bool(samples)
        for sample in samples:
            answers = {answer(kernel, function, copy.deepcopy(sample)) for function in functions}
            if len(answers) > 1:
                print(f"{name}{tuple(sample)} differs")
                different += 1
                break
    print(f"{compared - different} of {compared} kernels are identical to the bit, {count} arguments each")
    return different


def _is_below(value: Any, low: float) -> bool:
    """Whether a number is not to be given to a kernel that takes magnitudes from `low` on."""
    return low > 0.0 and not low <= abs(value) < math.inf


def report_calls(workloads: Sequence[str], tests: Sequence[str]) -> int:
    """Do workloads and tests; print the kernels that they did not call, return how many these are."""
    from adaptrack.core import library

    os.environ["ADAPTRACK_PROCESSOR"] = f"{library.processor()}-checked"
    if tests:
        import pytest

        pytest.main(["-q", "-p", "no:cacheprovider", "--ignore=tests/core/test_build.py", *tests])
    if workloads:
        sys.path.append(str(Path(__file__).resolve().parent))
        from answers import WORKLOADS

        import adaptrack

        for name in workloads:
            print(name, sum(1 for _ in WORKLOADS[name](adaptrack)), "arrays", flush=True)
    loaded = library.loaded()
    assert isinstance(loaded, library.Library), loaded
    calls = {name: ctypes.c_int64.in_dll(loaded.functions, f"calls_of_{name}").value for name in loaded.kernels}
    never = sorted(name for name, count in calls.items() if not count)
    print(f"{len(calls) - len(never)} of {len(calls)} kernels were called; not called: {', '.join(never) or 'none'}")
    return len(never)


def main() -> int:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("what", choices=["numbers", "called"])
    parser.add_argument("names", nargs="*", help="a library; or workloads of answers.py")
    parser.add_argument("--count", type=int, default=4000, help="of arguments for each kernel")
    parser.add_argument("--tests", nargs="*", default=[], help="paths of tests")
    options = parser.parse_args()
    if options.what == "called":
        return report_calls(options.names, options.tests)
    if len(options.names) != 1:
        parser.error("numbers: name one library")
    (other,) = options.names
    return compare(other, options.count)


if __name__ == "__main__":
    sys.exit(1 if main() else 0)

"""C sources of the kernels that an export calls, and the options with which every compiler gives the same bits."""

from __future__ import annotations

from collections.abc import Iterable

from adaptrack.core.build.c_files import SOFT_KERNELS, c_files, texts
from adaptrack.core.kernel import EXPORTED

EXACT_OPTIONS = (
    "-ffp-contract=off", "-fno-tree-slp-vectorize", "-fno-strict-aliasing", "-fwrapv", "-fno-math-errno",
    "-fno-trapping-math",
)  # fmt: skip
"""Each operation rounds once, in the order in which it is written. GCC up to 12 fuses pairs of operations unless the
second option is given. Records lie in arrays of numbers, and whole numbers wrap. The last two are for speed."""


def kernel_sources(names: Iterable[str]) -> dict[str, str]:
    """C sources of kernels and of all that they call, by the names of the files."""
    return texts(c_files({name: EXPORTED[name] for name in (*names, *SOFT_KERNELS)}))

"""C sources of the kernels that an export calls, and the options with which every compiler gives the same bits."""

from __future__ import annotations

from collections.abc import Iterable

from adaptrack.core.build.c_files import SOFT_KERNELS, c_files, texts
from adaptrack.core.build.compile import CLANG_EXACT_OPTIONS
from adaptrack.core.kernel import EXPORTED

EXACT_OPTIONS = (*CLANG_EXACT_OPTIONS, "-fno-tree-slp-vectorize")
"""Options with which every compiler gives the same bits: GCC up to 12 fuses pairs of operations without the last one.
"""


def kernel_sources(names: Iterable[str]) -> dict[str, str]:
    """C sources of kernels and of all that they call, by the names of the files."""
    return texts(c_files({name: EXPORTED[name] for name in (*names, *SOFT_KERNELS)}))

"""Inlined kernels have no entry for Python: a test calls them through one."""

import numba

from adaptrack.core.build import numba_functions as numba_functions  # numba learns what a kernel is
from adaptrack.core.kernel import INTERPRETED


def entry(kernel):
    """A function that Python may call in place of an inlined kernel."""
    if INTERPRETED:
        return kernel
    return numba.njit(lambda *arguments: kernel(*arguments), error_model="numpy")

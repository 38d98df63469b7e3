"""The scheduling variables, in the order in which kernels are given them; see `scheduling.variables`."""

from __future__ import annotations

from ..kernel import columns

VARIABLE_NAMES = ("speed", "y_ref", "friction", "wind", "change", "acceleration", "offset")
VARIABLE_COLUMNS = columns(*VARIABLE_NAMES)

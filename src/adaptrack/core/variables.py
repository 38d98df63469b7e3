"""The scheduling variables, in the order in which kernels are given them; see `scheduling.variables`."""

from __future__ import annotations

from .kernel import columns

NAMES = ("speed", "y_ref", "friction", "wind", "change", "acceleration", "offset")
VARIABLES = columns(*NAMES)

"""Cells of maps over two quantities."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Cells(NamedTuple):
    """A number for each cell of a grid over two quantities."""

    x_edges: Array
    y_edges: Array
    values: Array
    """(y cells, x cells), NaN where there is none"""


def edges_around(levels: Array) -> Array:
    """Edges of the cells around levels, in order; a level alone has a tenth of itself on either side."""
    if len(levels) == 1:
        return np.asarray(levels[0] + np.array([-1.0, 1.0]) * (0.1 * abs(float(levels[0])) or 0.5))
    middles = (levels[1:] + levels[:-1]) / 2.0
    first, last = np.diff(levels)[[0, -1]] / 2.0
    return np.concatenate([[levels[0] - first], middles, [levels[-1] + last]])

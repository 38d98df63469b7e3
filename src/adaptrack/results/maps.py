"""Heat maps over the speed and one more quantity: their cells, their colours, the bar that explains them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colorbar import Colorbar
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from adaptrack.results import style

Array = NDArray[np.float64]

COLOURS = "cividis"
"""The colour map: sequential, alike for all common colour visions, and in grey."""


class Cells(NamedTuple):
    """A number for each cell of a grid over two quantities."""

    x_edges: Array
    y_edges: Array
    values: Array
    """(y cells, x cells), NaN where there is none"""


@dataclass(frozen=True)
class Heat:
    """A heat map: its cells, what stands beside them, and how numbers become colours."""

    cells: Cells
    label: str
    """of the y axis; the x axis is the speed [m/s]"""
    norm: Normalize
    whole: bool = False
    """Whether only whole numbers are written beside the bar."""
    extend: str = "neither"
    """Where values lie beyond the colours: "min", "max", "both"."""
    colours: str = COLOURS
    smooth: bool = False
    """One image of equal cells instead of a shape for each: for a fine grid, which then stays a small file."""

    def draw(self, axes: Axes) -> None:
        """The cells; without the bar, which may be common to several maps."""
        x, y, values = self.cells
        if self.smooth:
            box = (x[0], x[-1], y[0], y[-1])
            axes.imshow(
                values, self.colours, self.norm, aspect="auto", interpolation="none", origin="lower", extent=box,
            )  # fmt: skip
        else:
            axes.pcolormesh(
                x, y, np.ma.masked_invalid(values), cmap=self.colours, norm=self.norm, edgecolor="face", linewidth=0.3,
                antialiased=True,
            )  # fmt: skip
        axes.grid(False)
        axes.margins(0.0)
        axes.set_xlabel("Speed (m/s)")
        axes.set_ylabel(self.label)
        axes.yaxis.set_major_locator(MaxNLocator(nbins=6, steps=style.ROUND))

    def show(self, axes: Axes) -> None:
        """Draw it with its bar, for a panel of the page."""
        self.draw(axes)
        box = axes.get_position()
        axes.set_position((box.x0, box.y0, 0.83 * box.width, box.height))  # room for the bar and its numbers
        figure = axes.get_figure()
        assert isinstance(figure, Figure)
        self.bar(figure, cax=axes.inset_axes((1.03, 0.0, 0.035, 1.0)))

    def bar(self, figure: Figure, **place: Any) -> Colorbar:
        """The bar of its colours, for print; place: what `Figure.colorbar` takes for that."""
        low, high = self.norm.vmin, self.norm.vmax
        assert low is not None
        assert high is not None
        logarithmic = isinstance(self.norm, LogNorm)
        linear = MaxNLocator(nbins=5, integer=self.whole, steps=style.ROUND if self.whole else [1, 2, 2.5, 5, 10])
        bar = figure.colorbar(
            ScalarMappable(self.norm, self.colours),
            ticks=style.log_ticks(low, high) if logarithmic else linear,
            extend=self.extend,
            **place,
        )
        bar.formatter = style.PLAIN
        bar.ax.minorticks_off()
        bar.ax.tick_params(labelsize=7.5)
        bar.outline.set_linewidth(0.5)
        return bar


def norm_of(values: Iterable[Array]) -> Normalize:
    """Colours from the lowest to the highest of all values."""
    everything = np.concatenate([each.ravel() for each in values])
    low, high = float(np.nanmin(everything)), float(np.nanmax(everything))
    return Normalize(low, high) if high > low else Normalize(low - 0.5, high + 0.5)


def edges_around(levels: Array) -> Array:
    """Edges of the cells around levels, in order; a level alone has a tenth of itself on either side."""
    if len(levels) == 1:
        return np.asarray(levels[0] + np.array([-1.0, 1.0]) * (0.1 * abs(float(levels[0])) or 0.5))
    middles = (levels[1:] + levels[:-1]) / 2.0
    first, last = np.diff(levels)[[0, -1]] / 2.0
    return np.concatenate([[levels[0] - first], middles, [levels[-1] + last]])

"""Colours and line styles of all pictures; maps, scales, keys and dots with intervals on matplotlib's axes.

Importing this module does not load matplotlib: results are made also where nothing is drawn.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from adaptrack.base.result import Panel, Picture
from adaptrack.core.maths import portable
from adaptrack.results.words import data_text, legible, number

if TYPE_CHECKING:
    from matplotlib.axes import Axes as Axes  # other modules name this type without loading matplotlib
    from matplotlib.colors import Colormap
    from matplotlib.ticker import FixedLocator
    from numpy.typing import ArrayLike, NDArray

INK = "#1d2733"
"""Colour of text, ticks and the reference path."""
MUTED = "#66717e"
"""Colour of frames and of lines in the background."""
PALE = "#dce1e7"
"""Colour of grid lines and of the road's surface."""
SERIES = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
"""Colours of contenders from the set of Okabe and Ito, which colour-blind readers can distinguish."""
DASHED, LONG_DASHES, DOTTED, DASH_DOT = (0, (4, 2)), (0, (5, 1.5)), (0, (1.5, 1.5)), (0, (5, 1.5, 1, 1.5))
"""Line styles in matplotlib's notation: offset and dash lengths in line widths."""

Stroke = Mapping[str, Any]
"""Colour and line style of the lines of one contender, the same in every picture: keyword arguments of matplotlib."""
REFERENCE_STROKE: Stroke = {"color": INK, "linestyle": DASHED}
"""Stroke of the reference path."""
SHARED_STROKE: Stroke = {"color": INK, "linestyle": "-"}
"""Stroke of signals that all runs share (gust, friction)."""
BACKGROUND_STROKE: Stroke = {"color": MUTED, "linestyle": "-"}
"""Stroke of lines behind the main curves."""

TICK_STEPS = (1, 2, 5, 10)
"""Steps between the ticks of an axis, times a power of ten: whole numbers stay whole."""


BAND: Mapping[str, Any] = {"alpha": 0.2, "linewidth": 0.0}
"""Look of the area between two curves, for `fill_between`."""


def strokes(labels: Iterable[str]) -> dict[str, Stroke]:
    """Return one stroke per distinct label, in order; strokes repeat after three times the number of colours."""
    styles, n = ("-", LONG_DASHES, DOTTED), len(SERIES)
    return {
        label: {"color": SERIES[i % n], "linestyle": styles[i // n % len(styles)]}
        for i, label in enumerate(dict.fromkeys(labels))
    }


# -- keys and scales --------------------------------------------------------------------------------------------------
def add_line_key(axes: Axes, entries: Iterable[tuple[str, Any]]) -> None:
    """Add a key of line styles in ink, at the right above the panel, level with its title."""
    from matplotlib.lines import Line2D

    handles = [Line2D([], [], color=INK, linestyle=dashes, label=name, linewidth=1.2) for name, dashes in entries]
    axes.legend(handles=handles, loc="lower right", bbox_to_anchor=(1.0, 1.015), ncols=len(handles), columnspacing=1.2)


def include_y(axes: Axes, *values: float) -> tuple[float, float]:
    """Extend the y axis to some values and return its ends."""
    bottom, top = axes.get_ylim()
    axes.set_ylim(min(bottom, *values), max(top, *values))
    return axes.get_ylim()


def name_rows(axes: Axes, names: Sequence[str]) -> None:
    """Write names at 0, 1, 2, ... on the y axis, downwards, in place of numbers."""
    axes.set_yticks(range(len(names)), names)
    axes.set_ylim(len(names) - 0.4, -0.6)
    axes.grid(axis="y", visible=False)


def write_plainly(value: float, _: Any = None) -> str:
    """Write a number of an axis as readers do, not as a power of ten."""
    return f"{value:g}".replace("-", "−")


def log_ticks(low: float, high: float) -> FixedLocator:
    """Round numbers on a logarithmic axis, more of them where it is short."""
    from matplotlib.ticker import FixedLocator, MaxNLocator

    if high <= 2.0 * low:
        ticks = np.asarray(MaxNLocator(nbins=5, steps=TICK_STEPS).tick_values(low, high))
    else:
        dense, sparse, powers_only = (1.0, 1.5, 2.0, 3.0, 5.0, 7.0), (1.0, 2.0, 5.0), (1.0,)
        decades = portable.log10(high / low)
        decade = dense if decades < 1.5 else sparse if decades < 3.5 else powers_only
        powers = portable.power(10.0, np.arange(np.floor(portable.log10(low)), np.ceil(portable.log10(high)) + 1.0))
        ticks = np.outer(powers, decade).ravel()
    return FixedLocator(ticks[(ticks >= 0.999 * low) & (ticks <= 1.001 * high)].tolist())


def set_log_scale(axes: Axes, axis_name: Literal["x", "y"], limits: tuple[float, float] | None = None) -> None:
    """Make an axis logarithmic, with numbers that can be read also where it spans less than a decade.

    limits: its ends; those of its curves if None. Very small and very large numbers are written as powers of ten.
    """
    axes.set(**{f"{axis_name}scale": "log"})
    axis = axes.xaxis if axis_name == "x" else axes.yaxis
    low, high = limits or axis.get_view_interval()
    axes.set(**{f"{axis_name}lim": (low, high)})
    axis.set_major_locator(log_ticks(low, high))
    axis.minorticks_off()
    if low >= 1e-4 and high < 1e6:
        axis.set_major_formatter(write_plainly)


def add_degrees(axes: Axes) -> None:
    """Add a scale in degrees at the right of a y axis in radians, once the panel is drawn."""
    from matplotlib.ticker import MaxNLocator

    figure = axes.get_figure()
    if figure is not None and figure.get_layout_engine() is None:  # room for it
        box = axes.get_position()
        axes.set_position((box.x0, box.y0, 0.9 * box.width, box.height))
    right = axes.secondary_yaxis("right", functions=(np.degrees, np.radians))
    right.yaxis.set_major_locator(MaxNLocator(nbins=5, steps=TICK_STEPS))
    right.set_ylabel("(°)", labelpad=1.0)


# -- colours of numbers -----------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class ColourScale:
    """A scale from numbers to colours, and the bar that explains it."""

    low: float
    high: float
    label: str = ""
    log: bool = False
    integer: bool = False
    """Whether only whole numbers are written beside the bar."""
    colours: Literal["cividis", "cividis_r", "deviation"] = "cividis"
    """Colours from low to high: dark to bright, bright to dark, or `deviation_colours`."""
    beyond: Literal["neither", "min", "max", "both"] = "neither"
    """Which ends of the scale some values exceed."""

    @property
    def look(self) -> dict[str, Any]:
        """The scale as keyword arguments of matplotlib's images and collections."""
        from matplotlib.colors import LogNorm, Normalize

        norm = LogNorm(self.low, self.high) if self.log else Normalize(self.low, self.high)
        return {"cmap": deviation_colours() if self.colours == "deviation" else self.colours, "norm": norm}


def deviation_colours() -> Colormap:
    """Blue, amber, red: visible on light and on dark ground."""
    from matplotlib.colors import LinearSegmentedColormap

    return LinearSegmentedColormap.from_list("deviation", ["#3b8fd0", "#8f9db0", "#e69f00", "#e2600c", "#c4231c"])


def edges_around(levels: NDArray[np.float64]) -> NDArray[np.float64]:
    """Edges of the cells around levels, in order; a level alone has a tenth of itself on either side."""
    if len(levels) == 1:
        return np.asarray(levels[0] + np.array([-1.0, 1.0]) * (0.1 * abs(float(levels[0])) or 0.5))
    middles = (levels[1:] + levels[:-1]) / 2.0
    first, last = np.diff(levels)[[0, -1]] / 2.0
    return np.concatenate([[levels[0] - first], middles, [levels[-1] + last]])


def speed_map(
    title: str, edges: Sequence[ArrayLike] | NDArray[np.float64], cells: ArrayLike, scale: ColourScale, label: str,
    words: str, *, image: bool = False, crosses: tuple[ArrayLike, ArrayLike] = ((), ()),
) -> Panel:  # fmt: skip
    """A panel of values over the speed and a second quantity, with the scale's bar.

    edges: of the cells along the speed (m/s) and the second quantity; cells: values (second quantity, speeds), NaN
    where there is none; label: of the second quantity; words: description for screen readers; image: whether to draw
    one image of equal cells, a small file for a fine grid; crosses: marked speeds and values of the second quantity.
    """
    x, y, values = (np.asarray(array, dtype=float) for array in (edges[0], edges[1], cells))

    def draw(axes: Axes) -> None:
        from matplotlib.ticker import MaxNLocator

        if image:
            box = (x[0], x[-1], y[0], y[-1])
            axes.imshow(values, aspect="auto", interpolation="none", origin="lower", extent=box, **scale.look)
        else:
            edge: dict[str, Any] = {"edgecolor": "face", "linewidth": 0.3, "antialiased": True}
            axes.pcolormesh(x, y, np.ma.masked_invalid(values), **scale.look, **edge)
        axes.grid(False)
        axes.margins(0.0)
        axes.yaxis.set_major_locator(MaxNLocator(nbins=6, steps=TICK_STEPS))
        _add_bar(axes, scale)
        look: dict[str, Any] = {"color": SERIES[1], "markersize": 4.5, "markeredgewidth": 1.5, "zorder": 5}
        axes.plot(*crosses, "x", scalex=False, scaley=False, **look)
        axes.set(xlabel="Speed (m/s)", ylabel=label)

    return Panel(title, draw, words)


def draw_coloured_line(axes: Axes, x: ArrayLike, y: ArrayLike, values: ArrayLike, scale: ColourScale) -> None:
    """Draw a line through points (n + 1,), each piece in the colour of its value (n,), and add the scale's bar."""
    from matplotlib.collections import LineCollection

    line = np.stack([np.asarray(x, dtype=float), np.asarray(y, dtype=float)], axis=-1)
    pieces = list(np.stack([line[:-1], line[1:]], axis=1))
    coloured = LineCollection(pieces, **scale.look, linewidths=2.0, capstyle="round", zorder=3)
    coloured.set_array(np.asarray(values, dtype=float))
    axes.add_collection(coloured)
    axes.margins(0.06)
    _add_bar(axes, scale)


def _add_bar(axes: Axes, scale: ColourScale) -> None:
    """Add the bar of a scale beside its axes: within their own box where other panels align with them."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.ticker import MaxNLocator

    figure: Any = axes.get_figure()
    if figure.get_layout_engine() is None:
        box = axes.get_position()
        axes.set_position((box.x0, box.y0, 0.83 * box.width, box.height))  # room for the bar and its numbers
        place: dict[str, Any] = {"cax": axes.inset_axes((1.03, 0.0, 0.035, 1.0))}
    else:
        place = {"ax": axes, "shrink": 0.9, "aspect": 30, "pad": 0.02}
    linear = MaxNLocator(nbins=5, integer=scale.integer, steps=TICK_STEPS if scale.integer else [1, 2, 2.5, 5, 10])
    ticks = log_ticks(scale.low, scale.high) if scale.log else linear
    bar = figure.colorbar(ScalarMappable(**scale.look), ticks=ticks, extend=scale.beyond, label=scale.label, **place)
    bar.ax.yaxis.set_major_formatter(write_plainly)
    bar.ax.minorticks_off()
    bar.ax.tick_params(labelsize=7.5)
    bar.outline.set_linewidth(0.5)


# -- dots with intervals ----------------------------------------------------------------------------------------------
PICTURE_WIDTH = 5.2
"""inch, of the picture: its letters can be read on a telephone and are not too large beside a verdict"""
_ROW_HEIGHT, _AXIS_HEIGHT, _MIN_HEIGHT = 0.21, 0.75, 1.6
"""inch: of a name, of the axis with its label, of the whole picture"""
MAX_DOTS = 14
"""Names that fit a first screen."""
EDGE_RATIO = 3.0
"""Ratio to the median above which a dot is drawn at the edge."""
_NAME_LETTERS = 40
"""Letters of a name beside the axis."""


class Dot(NamedTuple):
    """A number with its interval."""

    name: str
    value: float
    low: float = math.nan
    """Lower end of the interval; NaN if unknown."""
    high: float = math.nan
    colour: str = SERIES[0]
    failed: bool = False
    """Drawn as a cross."""


def dots_picture(
    name: str, caption: str, charts: Sequence[tuple[Sequence[Dot], str, str]], *, level: float | None = None,
    key: Sequence[tuple[str, Stroke]] = (), file: str = "",
) -> Picture:  # fmt: skip
    """A picture of dots from the top down; the caption also explains crosses, arrows and omitted dots.

    charts: for each panel the dots, the label of the axis, and the words before the numbers in the description; level:
    where an upright line is drawn. An axis is logarithmic where its dots span more than a factor of five.
    """
    panels = [_dots_panel(*chart, [] if level is None else [level]) for chart in charts]
    dots = charts[-1][0]
    height = max(_MIN_HEIGHT, _AXIS_HEIGHT + _ROW_HEIGHT * len(_first_dots(dots)[0]))
    columns = min(2, len(panels))
    return Picture(name, caption + caption_notes(dots), panels, key, file, columns, height, (PICTURE_WIDTH, height))


def _dots_panel(dots: Sequence[Dot], label: str, words: str, levels: Sequence[float]) -> Panel:
    rows, edge = _first_dots(dots)

    def draw(axes: Axes) -> None:
        for level in levels:
            axes.axvline(level, linewidth=0.9, **BACKGROUND_STROKE)
        for row, dot in enumerate(rows):
            _draw_dot(axes, dot, row, edge)
        low, high, log = _limits(rows, edge, levels)
        axes.set(xlabel=label, xlim=(low, high))
        if log:
            set_log_scale(axes, "x", (low, high))
        name_rows(axes, [data_text(legible(dot.name, _NAME_LETTERS)) for dot in rows])

    return Panel("", draw, f"{words}. {'; '.join(map(_describe, rows))}.")


def _draw_dot(axes: Axes, dot: Dot, row: int, edge: float) -> None:
    if dot.value > edge:
        text = f"{number(dot.value)}{', failed' if dot.failed else ''} "
        place = axes.get_yaxis_transform()
        axes.text(0.965, row, text, color=INK, fontsize=7.5, ha="right", va="center", transform=place)
        axes.plot(0.985, row, ">", color=INK, markersize=5.0, transform=place)
        return
    if dot.low < dot.high:
        axes.plot([dot.low, dot.high], [row, row], color=dot.colour, linewidth=2.2, alpha=0.55)
    axes.plot(dot.value, row, "X" if dot.failed else "o", color=dot.colour, markersize=5.0, zorder=5)


def caption_notes(dots: Sequence[Dot]) -> str:
    """The sentences of a caption that explain crosses, arrows and omitted dots."""
    rows, edge = _first_dots(dots)
    near = [dot for dot in rows if dot.value <= edge]
    notes = [
        (any(dot.failed for dot in near), "Cross: failed runs."),
        (len(near) < len(rows), "Arrow: beyond the axis."),
        (len(rows) < len(dots), f"The first {len(rows)} of {len(dots)}; the table has all."),
    ]
    return "".join(f" {note}" for applies, note in notes if applies)


def _first_dots(dots: Sequence[Dot]) -> tuple[list[Dot], float]:
    """As many finite dots as fit (the page's table has all), and the value above which a dot would flatten them."""
    rows = [dot for dot in dots if math.isfinite(dot.value)][:MAX_DOTS]
    return rows, EDGE_RATIO * float(np.median([dot.value for dot in rows])) if rows else math.inf


def _limits(dots: Sequence[Dot], edge: float, levels: Sequence[float]) -> tuple[float, float, bool]:
    """The ends of the axis, and whether it is logarithmic."""
    near = [dot for dot in dots if dot.value <= edge]
    ends = [end for dot in near for end in (dot.value, dot.low, min(dot.high, edge)) if math.isfinite(end)]
    ends += levels
    low, high = min(ends, default=0.0), max(ends, default=1.0)
    if low > 0.0 and high > 5.0 * low:
        return low / 1.15, high * 1.15, True
    margin = 0.06 * (high - low) or 0.1 * abs(high) or 1.0
    return low - margin, high + margin, False


def _describe(dot: Dot) -> str:
    interval = f", {number(dot.low)} to {number(dot.high)}" if dot.low < dot.high else ""
    return f"{dot.name}: {number(dot.value)}{interval}{', failed' if dot.failed else ''}"

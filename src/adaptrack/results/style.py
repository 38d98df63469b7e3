"""How every picture looks: colours, type, grid; and how a figure becomes PNG or SVG. No pyplot, no global state."""

from __future__ import annotations

import io
import re
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, Literal

import matplotlib as mpl
import numpy as np
from cycler import cycler
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import AutoLocator, FixedLocator, FuncFormatter, MaxNLocator, NullLocator

from adaptrack.base.result import Colour, Dash, Stroke
from adaptrack.base.text import printable
from adaptrack.results.words import data_text as data_text

INK = "#1d2733"
"""Text, ticks, and the reference that controllers follow."""

MUTED = "#66717e"
"""Frames, and what stands in the background."""

GRID = "#dce1e7"
"""Grid lines."""

SERIES = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
"""One colour per controller: Okabe and Ito's set, distinguished with any common colour vision (tested)."""

_THEME = {INK: "ink", MUTED: "muted", GRID: "grid"} | {colour: f"series-{i}" for i, colour in enumerate(SERIES)}
"""The CSS variable behind each colour that a page may redefine."""

_THEMED = re.compile("|".join(_THEME), re.IGNORECASE)

PAGE_WIDTH = 7.2
"""inch, of a full figure: the text width of a two-column paper."""

PANEL_SIZE = (4.5, 2.55)
"""inch, of a panel on the page."""

PNG_DPI = 200
"""Dots per inch of the PNG files."""

RC: Any = {
    "font.family": "DejaVu Sans",  # ships with matplotlib: the same picture on every machine
    "font.size": 8.5,
    "text.color": INK,
    "mathtext.fontset": "dejavusans",
    "axes.titlesize": 9.0,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.titlepad": 6.0,
    "axes.labelsize": 8.5,
    "axes.labelcolor": INK,
    "axes.edgecolor": MUTED,
    "axes.linewidth": 0.7,
    "axes.facecolor": "none",
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.xmargin": 0.0,
    "axes.ymargin": 0.08,
    "axes.formatter.limits": (-4, 5),
    "axes.prop_cycle": cycler(color=SERIES),
    "grid.color": GRID,
    "grid.linewidth": 0.6,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "xtick.labelsize": 8.0,
    "ytick.labelsize": 8.0,
    "xtick.major.size": 3.0,
    "ytick.major.size": 3.0,
    "xtick.major.width": 0.7,
    "ytick.major.width": 0.7,
    "ytick.minor.size": 1.8,
    "ytick.minor.width": 0.5,
    "lines.linewidth": 1.3,
    "lines.solid_capstyle": "round",
    "lines.solid_joinstyle": "round",
    "lines.dash_capstyle": "butt",
    "legend.frameon": False,
    "legend.fontsize": 8.0,
    "legend.handlelength": 1.8,
    "legend.columnspacing": 1.6,
    "legend.handletextpad": 0.6,
    "legend.borderaxespad": 0.0,
    "figure.facecolor": "white",
    "figure.constrained_layout.use": True,
    "savefig.facecolor": "white",
    "svg.fonttype": "none",  # text stays text: it can be searched, copied and read aloud
    "svg.hashsalt": "adaptrack",  # and has the same bytes whenever it is written
}
"""The settings that differ from matplotlib's own."""

FONTS = "DejaVu Sans, Verdana, Geneva, sans-serif"
"""Of the text in pictures on pages: what they were laid out with, and others that are as wide."""

ROUND = (1, 2, 5, 10)
"""Steps between the ticks of an axis, times a power of ten: whole numbers stay whole."""

PLAIN = FuncFormatter(lambda value, _: f"{value:g}".replace("-", "−"))
"""Writes the numbers of an axis as readers do, not as powers of ten."""


_HEX = {"ink": INK, "muted": MUTED, "grid": GRID} | {f"series-{i}": colour for i, colour in enumerate(SERIES)}
DASHES: Mapping[Dash, Any] = {
    "solid": "-", "dashed": (0, (4, 2)), "long": (0, (5, 1.5)), "dotted": (0, (1.5, 1.5)),
    "dash-dot": (0, (5, 1.5, 1, 1.5)),
}  # fmt: skip
"""Line styles as matplotlib takes them, in widths of the line."""


def hex_of(colour: Colour) -> str:
    """A colour by its name; one in CSS's notation as it is."""
    return _HEX.get(colour, colour)


@contextmanager
def styled() -> Iterator[None]:
    """matplotlib's defaults with `RC` on top, whatever the user's own settings are, for the length of a block."""
    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(RC)
        yield


class ShownFigure(Figure):
    """A figure that a notebook shows by itself, without pyplot."""

    def _repr_png_(self) -> bytes:
        return png(self)


def panel_figure(draw: Callable[[Axes], None]) -> Figure:
    """A figure of one panel, for the page; axes and labels of all such figures align."""
    width, height = PANEL_SIZE
    left, right, bottom, top = 0.74, 0.1, 0.45, 0.28  # inch
    box = {"left": left / width, "right": 1 - right / width, "bottom": bottom / height, "top": 1 - top / height}
    with styled(), mpl.rc_context({"figure.constrained_layout.use": False}):
        figure = Figure(figsize=PANEL_SIZE)
        axes = figure.subplots(gridspec_kw=box)
        draw(axes)
        axes.yaxis.set_label_coords(-0.6 / (width - left - right), 0.5)
    return figure


def legend_above(figure: Figure, key: Sequence[tuple[str, Stroke]]) -> None:
    """A legend in rows above all panels, where it covers nothing."""
    key = [(data_text(label), stroke) for label, stroke in key]
    handles = [
        Line2D([], [], color=hex_of(stroke.colour), linestyle=DASHES[stroke.dash], linewidth=1.6, label=label)
        for label, stroke in key
    ]

    def width(columns: int) -> int:
        """In letters; a legend is filled column by column."""
        rows = -(-len(key) // columns)
        return sum(9 + max(len(label) for label, _ in key[i : i + rows]) for i in range(0, len(key), rows))

    columns = next((n for n in (5, 4, 3) if width(n) <= 105), 2)
    figure.legend(handles=handles, loc="outside upper center", ncols=min(len(handles), columns))


def line_key(axes: Axes, entries: Iterable[tuple[str, Stroke]]) -> None:
    """A key of line styles in ink, at the right above the panel, level with its title."""
    handles = [
        Line2D([], [], color=INK, linestyle=DASHES[stroke.dash], label=name, linewidth=1.2) for name, stroke in entries
    ]
    axes.legend(handles=handles, loc="lower right", bbox_to_anchor=(1.0, 1.015), ncols=len(handles), columnspacing=1.2)


def log_ticks(low: float, high: float) -> FixedLocator:
    """Round numbers on a logarithmic axis, more of them where it is short."""
    if high <= 2.0 * low:
        ticks = np.asarray(MaxNLocator(nbins=5, steps=ROUND).tick_values(low, high))
    else:
        many, few, fewest = (1.0, 1.5, 2.0, 3.0, 5.0, 7.0), (1.0, 2.0, 5.0), (1.0,)
        decades = np.log10(high / low)
        decade = many if decades < 1.5 else few if decades < 3.5 else fewest
        powers = 10.0 ** np.arange(np.floor(np.log10(low)), np.ceil(np.log10(high)) + 1.0)
        ticks = np.outer(powers, decade).ravel()
    return FixedLocator(ticks[(ticks >= 0.999 * low) & (ticks <= 1.001 * high)].tolist())


def logarithmic(axes: Axes, which: Literal["x", "y"], limits: tuple[float, float] | None = None) -> None:
    """Make an axis logarithmic, with numbers that can be read also where it spans less than a decade.

    limits: its ends; those that its curves ask for when left out. Very small and very large numbers are written as
    powers of ten.
    """
    axes.set(**{f"{which}scale": "log"})
    axis = axes.xaxis if which == "x" else axes.yaxis
    low, high = limits or axis.get_view_interval()
    axes.set(**{f"{which}lim": (low, high)})
    axis.set_major_locator(log_ticks(low, high))
    axis.set_minor_locator(NullLocator())
    if low >= 1e-4 and high < 1e6:
        axis.set_major_formatter(PLAIN)


def degrees_at_the_right(axes: Axes) -> None:
    """A second scale for angles in radians, once the panel is drawn."""
    figure = axes.get_figure()
    if figure is not None and figure.get_layout_engine() is None:  # room for it
        box = axes.get_position()
        axes.set_position((box.x0, box.y0, 0.9 * box.width, box.height))
    beside = axes.secondary_yaxis("right", functions=(np.degrees, np.radians))
    beside.yaxis.set_major_locator(MaxNLocator(nbins=5, steps=ROUND))
    beside.set_ylabel("(°)", labelpad=1.0)


def png(figure: Figure) -> bytes:
    """The figure as a PNG file."""
    buffer = io.BytesIO()
    _save(figure, buffer, format="png", dpi=PNG_DPI, metadata={"Software": None})
    return buffer.getvalue()


def _save(figure: Figure, to: io.BytesIO | io.StringIO, **how: Any) -> None:
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            if type(axis.get_major_locator()) is AutoLocator:
                axis.set_major_locator(MaxNLocator("auto", steps=ROUND))
    with styled(), warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing")  # a name in a script that the font does not have
        if figure.get_layout_engine() is None:  # otherwise the ticks are not yet what they will be
            for axes in figure.axes:
                _settle_titles(axes)
        figure.savefig(to, **how)


def _settle_titles(axes: Axes) -> None:
    """Keep the titles where they are, unless the y axis has a factor (1e6) above it that they have to avoid.

    matplotlib looks for that at every draw, which takes a third of it.
    """
    formatter = axes.yaxis.get_major_formatter()
    formatter.set_locs(axes.yaxis.get_majorticklocs().tolist())
    if not formatter.get_offset():
        axes.set_title(axes.get_title("center"), loc="center", y=1.0)


def inline_svg(figure: Figure, prefix: str, description: str) -> str:
    """The figure as an ``<svg>`` element for a page: transparent, described, following the page's colour theme.

    Ids get `prefix`, so that several pictures can share a page. Each colour of this style becomes
    ``var(--ink, ...)``, ``var(--grid, ...)``, ``var(--series-0, ...)``, for the page to redefine.
    """
    buffer = io.StringIO()
    _save(figure, buffer, format="svg", transparent=True, metadata={"Date": None, "Creator": None})
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL)
    text = re.sub(r"<[^>]*>", lambda tag: _tag(tag[0], prefix), text)  # between tags stands what is to be read
    text = re.sub(r"\n\s*", "\n", text)
    root = f'<svg role="img" aria-label="{_attribute(printable(description))}" font-family="{FONTS}"'
    return text.replace("<svg", root, 1).strip()


def _tag(text: str, prefix: str) -> str:
    """A tag of matplotlib's SVG as a page has it: ids apart from other pictures', themed colours, the page's fonts."""
    text = re.sub(r'\s(?:xmlns(?::\w+)?|version)="[^"]*"', "", text)
    text = re.sub(r'\bid="([^"]+)"', rf'id="{prefix}-\1"', text)
    text = re.sub(r"url\(#([^)]+)\)", rf"url(#{prefix}-\1)", text)
    text = re.sub(r'xlink:href="#([^"]+)"', rf'href="#{prefix}-\1"', text)
    text = text.replace(" font-family: 'DejaVu Sans';", "")
    return _THEMED.sub(lambda colour: themed(colour[0].lower()), text)


def themed(colour: str) -> str:
    """A colour of this style for CSS: the variable that a page may redefine, and the colour itself."""
    return f"var(--{_THEME[colour]}, {colour})"


def _attribute(text: str) -> str:
    return text.replace("&", "&amp;").replace('"', "&quot;").replace("<", "&lt;")

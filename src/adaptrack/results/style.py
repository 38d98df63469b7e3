"""Pictures as matplotlib figures in one style, as PNG or SVG. No pyplot, no global state."""

from __future__ import annotations

import html
import io
import re
import string
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib as mpl
from cycler import cycler
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import AutoLocator, MaxNLocator

from adaptrack.base.presentation import printable
from adaptrack.base.result import Panel, Picture
from adaptrack.results.marks import INK, MUTED, PALE, SERIES, TICK_STEPS, Stroke
from adaptrack.results.words import data_text, plain

_THEME = {INK: "ink", MUTED: "muted", PALE: "grid"} | {colour: f"series-{i}" for i, colour in enumerate(SERIES)}
"""The CSS variable behind each colour that a page may redefine."""

_THEMED = re.compile("|".join(_THEME), re.IGNORECASE)

PAGE_WIDTH = 7.2
"""inch, width of a full figure: the text width of a two-column paper"""

PANEL_SIZE = (4.5, 2.55)
"""inch, width and height of a panel on the page"""

PNG_DPI = 200
"""Dots per inch of the PNG files."""

_SHEET = Path(__file__).parent / "templates" / "style.mplstyle"
RC: Any = {
    **mpl.rc_params_from_file(_SHEET, use_default_template=False),
    **dict.fromkeys(("text.color", "axes.labelcolor", "xtick.labelcolor", "ytick.labelcolor"), INK),
    **dict.fromkeys(("axes.edgecolor", "xtick.color", "ytick.color"), MUTED),
    "grid.color": PALE,
    "axes.prop_cycle": cycler(color=SERIES),
}
"""The settings that differ from matplotlib's own: the style sheet, with the colours of `marks`."""

FONTS = "DejaVu Sans, Verdana, Geneva, sans-serif"
"""Fonts of the text in pictures on pages: the one of the layout, and others that are as wide."""


@contextmanager
def styled() -> Iterator[None]:
    """Use matplotlib's defaults with `RC` on top within a block, whatever the user's settings are."""
    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(RC)
        yield


class ShownFigure(Figure):
    """A figure that a notebook shows by itself, without pyplot."""

    def _repr_png_(self) -> bytes:
        return png(self)


def legend_above(figure: Figure, key: Sequence[tuple[str, Stroke]]) -> None:
    """Add a legend in rows above all panels."""
    key = [(data_text(label), stroke) for label, stroke in key]
    handles = [Line2D([], [], **stroke, linewidth=1.6, label=label) for label, stroke in key]

    def width(columns: int) -> int:
        """The width of the legend in letters; it is filled column by column."""
        rows = -(-len(key) // columns)
        return sum(9 + max(len(label) for label, _ in key[i : i + rows]) for i in range(0, len(key), rows))

    columns = next((n for n in (5, 4, 3) if width(n) <= 105), 2)
    figure.legend(handles=handles, loc="outside upper center", ncols=min(len(handles), columns))


def png(figure: Figure) -> bytes:
    """The figure as a PNG file."""
    buffer = io.BytesIO()
    _save(figure, buffer, format="png", dpi=PNG_DPI, metadata={"Software": None})
    return buffer.getvalue()


def _save(figure: Figure, to: io.BytesIO | io.StringIO, **options: Any) -> None:
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            if type(axis.get_major_locator()) is AutoLocator:
                axis.set_major_locator(MaxNLocator("auto", steps=TICK_STEPS))
    with styled(), warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing")  # a name in a script that the font does not have
        if figure.get_layout_engine() is None:  # otherwise the ticks are not yet what they will be
            for axes in figure.axes:
                _settle_titles(axes)
        figure.savefig(to, **options)


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
    root = f'<svg role="img" aria-label="{html.escape(printable(description))}" font-family="{FONTS}"'
    return text.replace("<svg", root, 1).strip()


def _tag(text: str, prefix: str) -> str:
    """Adapt a tag of matplotlib's SVG to a page: unique ids, themed colours, the page's fonts."""
    text = re.sub(r'\s(?:xmlns(?::\w+)?|version)="[^"]*"', "", text)
    text = re.sub(r'\bid="([^"]+)"', rf'id="{prefix}-\1"', text)
    text = re.sub(r"url\(#([^)]+)\)", rf"url(#{prefix}-\1)", text)
    text = re.sub(r'xlink:href="#([^"]+)"', rf'href="#{prefix}-\1"', text)
    text = text.replace(" font-family: 'DejaVu Sans';", "")
    return _THEMED.sub(lambda colour: themed(colour[0].lower()), text)


def themed(colour: str) -> str:
    """A colour of this style for CSS: the variable that a page may redefine, and the colour itself."""
    return f"var(--{_THEME[colour]}, {colour})"


# -- pictures ---------------------------------------------------------------------------------------------------------
def panel_figure(panel: Panel, size: tuple[float, float] | None = None) -> Figure:
    """Draw one panel for the page; all panels without a size (inch) have their axes at the same place."""
    width, height = size or PANEL_SIZE
    left, right, bottom, top = 0.74, 0.1, 0.45, 0.28  # inch
    box = {"left": left / width, "right": 1 - right / width, "bottom": bottom / height, "top": 1 - top / height}
    with styled(), mpl.rc_context({"figure.constrained_layout.use": size is not None}):
        figure = ShownFigure(figsize=(width, height))
        axes = figure.subplots(gridspec_kw=None if size else box)
        _show(axes, panel, panel.title)
        if size is None:
            axes.yaxis.set_label_coords(-0.6 / (width - left - right), 0.5)
    return figure


def describe_panel(panel: Panel) -> str:
    """The alternative text of a panel."""
    return plain(f"{panel.title}. {panel.description}" if panel.title else panel.description)


def print_figure(picture: Picture) -> Figure:
    """Draw all panels of a picture in one figure, for print; labels that neighbours share are written once."""
    panels, columns = picture.panels, min(picture.columns, len(picture.panels))
    rows = -(-len(panels) // columns)
    heights = [max(panel.height for panel in panels[i * columns : (i + 1) * columns]) for i in range(rows)]
    with styled():
        figure = ShownFigure(figsize=(PAGE_WIDTH, picture.row_height * sum(heights)))
        axes = list(figure.subplots(rows, columns, squeeze=False, height_ratios=heights).flat)
        for i, panel in enumerate(panels):
            letter = "" if len(panels) == 1 else f"({string.ascii_lowercase[i]})"
            _show(axes[i], panel, f"{letter} {panel.title}".strip())
        _share_labels(axes[: len(panels)], columns)
        for spare in axes[len(panels) :]:
            spare.remove()
        figure.align_ylabels(axes[: len(panels)])
        if picture.key:
            legend_above(figure, picture.key)
    return figure


def _show(axes: Axes, panel: Panel, title: str) -> None:
    axes.set_title(title)
    panel.draw(axes)


def _share_labels(axes: Sequence[Axes], columns: int) -> None:
    x_labels, y_labels = [ax.get_xlabel() for ax in axes], [ax.get_ylabel() for ax in axes]
    for i, ax in enumerate(axes):
        if i % columns and y_labels[i] == y_labels[i - 1]:
            ax.set_ylabel("")
        if i + columns < len(axes) and x_labels[i] == x_labels[i + columns]:
            ax.set_xlabel("")

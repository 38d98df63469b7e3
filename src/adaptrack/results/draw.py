"""Pictures of a result as matplotlib figures: a panel for the page, all panels of a picture for print."""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from adaptrack.base.result import Panel, Picture
from adaptrack.results import style
from adaptrack.results.words import lettered, plain


def panel_figure(panel: Panel, size: tuple[float, float] | None = None) -> Figure:
    """Draw one panel for the page; all panels without a size (inch) have their axes at the same place."""
    if size is not None:
        with style.styled():
            figure = style.ShownFigure(figsize=size)
            _show(figure.subplots(), panel, panel.title)
        return figure
    width, height = style.PANEL_SIZE
    left, right, bottom, top = 0.74, 0.1, 0.45, 0.28  # inch
    box = {"left": left / width, "right": 1 - right / width, "bottom": bottom / height, "top": 1 - top / height}
    with style.styled(), mpl.rc_context({"figure.constrained_layout.use": False}):
        figure = style.ShownFigure(figsize=style.PANEL_SIZE)
        axes = figure.subplots(gridspec_kw=box)
        _show(axes, panel, panel.title)
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
    with style.styled():
        figure = style.ShownFigure(figsize=(style.PAGE_WIDTH, picture.row_height * sum(heights)))
        axes = list(figure.subplots(rows, columns, squeeze=False, height_ratios=heights).flat)
        for i, panel in enumerate(panels):
            _show(axes[i], panel, panel.title if len(panels) == 1 else lettered(i, panel.title))
        _share_labels(axes[: len(panels)], columns)
        for spare in axes[len(panels) :]:
            spare.remove()
        figure.align_ylabels(axes[: len(panels)])
        if picture.key:
            style.legend_above(figure, picture.key)
    return figure


def picture_png(picture: Picture) -> bytes:
    """All panels of a picture as a PNG file."""
    return style.png(print_figure(picture))


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

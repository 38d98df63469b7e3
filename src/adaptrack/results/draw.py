"""Pictures of a result as matplotlib figures: a panel for the page, all panels of a picture for print."""

from __future__ import annotations

from collections.abc import Sequence
from functools import singledispatch
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import Colormap, LinearSegmentedColormap, LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Polygon as Patch
from matplotlib.ticker import FixedFormatter, FixedLocator, MaxNLocator

from adaptrack.base.result import (
    Axis,
    Bars,
    Callout,
    ColouredLine,
    Dots,
    Guide,
    Heading,
    HeatMap,
    Mark,
    Panel,
    Picture,
    Polygon,
    Polyline,
    Remark,
    Ribbon,
    Scale,
    Stripe,
    Stroke,
)
from adaptrack.results import style
from adaptrack.results.words import lettered, plain

DEVIATION = LinearSegmentedColormap.from_list("deviation", ["#3b8fd0", "#8f9db0", "#e69f00", "#e2600c", "#c4231c"])
"""Blue, amber, red; visible on light and on dark ground."""

_MARKERS: dict[str, dict[str, Any]] = {
    "dot": {"marker": "o"},
    "ring": {"marker": "o", "fillstyle": "none"},
    "square": {"marker": "s", "fillstyle": "none"},
    "cross": {"marker": "x", "markeredgewidth": 1.5},
    "heavy cross": {"marker": "X"},
    "triangle": {"marker": "^"},
    "arrow": {"marker": ">"},
    "point": {"marker": "."},
}


_LEVEL_NAMES = 4
"""Names along an x axis that stand level; more stand upright."""


def panel_figure(panel: Panel, size: tuple[float, float] | None = None) -> Figure:
    """A panel alone, for the page; those without a size [inch] are drawn alike, so that their axes align."""
    if size is None:
        return style.panel_figure(lambda axes: show(axes, panel))
    with style.styled():
        figure = style.ShownFigure(figsize=size)
        show(figure.subplots(), panel)
    return figure


def described(panel: Panel) -> str:
    """The alternative text of a panel."""
    return plain(f"{panel.title}. {panel.description}" if panel.title else panel.description)


def print_figure(picture: Picture) -> Figure:
    """All panels of a picture in one figure, for print: what neighbours have on their axes alike is written once."""
    panels, columns = picture.for_print, min(picture.columns, len(picture.for_print))
    rows = -(-len(panels) // columns)
    alone = len(panels) == 1
    heights = [max(each.height for each in panels[i * columns : (i + 1) * columns]) for i in range(rows)]
    with style.styled():
        figure = style.ShownFigure(figsize=(style.PAGE_WIDTH, picture.row_height * sum(heights)))
        axes = list(figure.subplots(rows, columns, squeeze=False, height_ratios=heights).flat)
        for i, (panel, ax) in enumerate(zip(panels, axes, strict=False)):
            show(ax, panel, panel.title if alone else lettered(i, panel.title))
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


def _share_labels(axes: Sequence[Axes], columns: int) -> None:
    across, up = [ax.get_xlabel() for ax in axes], [ax.get_ylabel() for ax in axes]
    for i, ax in enumerate(axes):
        if i % columns and up[i] == up[i - 1]:
            ax.set_ylabel("")
        if i + columns < len(axes) and across[i] == across[i + columns]:
            ax.set_xlabel("")


def show(axes: Axes, panel: Panel, title: str | None = None) -> None:
    """Draw a panel on axes, under its title or another."""
    for mark in panel.marks:
        draw(mark, axes)
    for which, axis in (("x", panel.x), ("y", panel.y)):
        _scale(axes, which, axis)
    for mark in panel.marks:
        if isinstance(mark, Dots) and mark.at_edge:
            _draw_at_edge(mark, axes)
    if panel.to_scale:
        axes.set_aspect("equal", adjustable="datalim")
    axes.set_title(panel.title if title is None else title)
    if panel.remark:
        axes.set_title(panel.remark, loc="right", fontsize=7.5, fontweight="normal", color=style.MUTED)
    if panel.key:
        style.line_key(axes, panel.key)
    if panel.y.degrees:
        style.degrees_at_the_right(axes)


# -- axes -------------------------------------------------------------------------------------------------------------
def _scale(axes: Axes, which: Any, axis: Axis) -> None:
    """Label, limits and ticks of an axis."""
    axes.set(**{f"{which}label": axis.label})
    if axis.margin is not None:
        (axes.set_xmargin if which == "x" else axes.set_ymargin)(axis.margin)
        axes.autoscale_view()
    own = axes.xaxis if which == "x" else axes.yaxis
    if axis.names:
        own.set_major_locator(FixedLocator(range(len(axis.names))))
        own.set_major_formatter(FixedFormatter(list(axis.names)))
        ends = (-0.4, len(axis.names) - 0.6) if which == "x" else (len(axis.names) - 0.4, -0.6)
        axes.set(**{f"{which}lim": ends})
        axes.grid(axis=which, visible=which == "x")
        if which == "x" and len(axis.names) > _LEVEL_NAMES:
            axes.tick_params(axis="x", labelrotation=90.0)
        return
    low, high = sorted(own.get_view_interval())
    low, high = min([low, *axis.include]), max([high, *axis.include])
    if axis.most is not None:
        low, high = max(low, -axis.most), min(high, axis.most)
    low, high = axis.low if axis.low is not None else low, axis.high if axis.high is not None else high
    changed = bool(axis.include) or any(each is not None for each in (axis.low, axis.high, axis.most))
    if axis.log:
        style.logarithmic(axes, which, (low, high) if changed else None)
    elif changed:
        axes.set(**{f"{which}lim": (low, high)})
    if axis.whole:
        own.set_major_locator(MaxNLocator(integer=True, nbins=6, steps=style.ROUND))


# -- marks ------------------------------------------------------------------------------------------------------------
@singledispatch
def draw(mark: Mark, axes: Axes) -> None:
    """Draw a mark on axes.

    Raises
    ------
    TypeError
        When nothing draws its type.
    """
    raise TypeError(f"nothing draws {type(mark).__name__}.")


@draw.register
def _(mark: Polyline, axes: Axes) -> None:
    look = _line(mark.stroke) | ({"marker": "o", "markersize": 3.5} if mark.markers else {})
    look |= {
        "linewidth": mark.width,
        "alpha": mark.opacity,
        "drawstyle": f"steps-{mark.steps}" if mark.steps else "default",
    }
    axes.plot(np.asarray(mark.x), np.asarray(mark.y), **look)


@draw.register
def _(mark: Dots, axes: Axes) -> None:
    if mark.at_edge:
        return
    look: dict[str, Any] = {"color": style.hex_of(mark.colour), "linestyle": "", "markersize": mark.size, "zorder": 5}
    look |= {"alpha": mark.opacity} | _MARKERS[mark.marker]
    axes.plot(np.asarray(mark.x), np.asarray(mark.y), scalex=mark.scales, scaley=mark.scales, **look)


def _draw_at_edge(mark: Dots, axes: Axes) -> None:
    (left, right), (bottom, top) = sorted(axes.get_xlim()), sorted(axes.get_ylim())
    x, y = np.clip(np.asarray(mark.x), left, right), np.clip(np.asarray(mark.y), bottom, top)
    look: dict[str, Any] = {"color": style.hex_of(mark.colour), "linestyle": "", "markersize": mark.size}
    look |= {"clip_on": False}
    axes.plot(x, y, scalex=False, scaley=False, **(_MARKERS[mark.marker] | {"markeredgewidth": 1.8}), **look)


@draw.register
def _(mark: Ribbon, axes: Axes) -> None:
    low, high = np.asarray(mark.low, dtype=float), np.asarray(mark.high, dtype=float)
    known = (np.isfinite(low) & np.isfinite(high)).tolist()
    axes.fill_between(
        np.asarray(mark.x), low, high, where=known, color=style.hex_of(mark.colour), alpha=0.2, linewidth=0.0
    )


@draw.register
def _(mark: Guide, axes: Axes) -> None:
    across = axes.axvline if mark.across == "x" else axes.axhline
    for at in mark.at:
        across(at, linewidth=mark.width, **_line(mark.stroke))


@draw.register
def _(mark: Stripe, axes: Axes) -> None:
    across = axes.axvspan if mark.across == "x" else axes.axhspan
    across(mark.low, mark.high, color=style.hex_of(mark.colour), alpha=mark.opacity, linewidth=0.0)


@draw.register
def _(mark: Bars, axes: Axes) -> None:
    edges = np.asarray(mark.edges, dtype=float)
    width = np.diff(edges)
    start = edges[:-1] + 0.5 * (1.0 - mark.fill) * width
    axes.bar(start, np.asarray(mark.heights), mark.fill * width, align="edge", color=style.hex_of(mark.colour))
    axes.grid(False, axis="x")


@draw.register
def _(mark: HeatMap, axes: Axes) -> None:
    x, y, values = (np.asarray(each, dtype=float) for each in (mark.x_edges, mark.y_edges, mark.values))
    colours: dict[str, Any] = {"cmap": _map(mark.scale), "norm": _norm(mark.scale)}
    if mark.image:
        box = (x[0], x[-1], y[0], y[-1])
        axes.imshow(values, aspect="auto", interpolation="none", origin="lower", extent=box, **colours)
    else:
        look: dict[str, Any] = {"edgecolor": "face", "linewidth": 0.3, "antialiased": True}
        axes.pcolormesh(x, y, np.ma.masked_invalid(values), **colours, **look)
    axes.grid(False)
    axes.margins(0.0)
    axes.yaxis.set_major_locator(MaxNLocator(nbins=6, steps=style.ROUND))
    _bar(axes, mark.scale)


@draw.register
def _(mark: ColouredLine, axes: Axes) -> None:
    line = np.stack([np.asarray(mark.x, dtype=float), np.asarray(mark.y, dtype=float)], axis=-1)
    pieces = list(np.stack([line[:-1], line[1:]], axis=1))
    strokes = LineCollection(
        pieces, cmap=_map(mark.scale), norm=_norm(mark.scale), linewidths=2.0, capstyle="round", zorder=3
    )
    strokes.set_array(np.asarray(mark.values, dtype=float))
    axes.add_collection(strokes)
    axes.margins(0.06)
    _bar(axes, mark.scale)


@draw.register
def _(mark: Polygon, axes: Axes) -> None:
    colours = [style.hex_of(each) if each else "none" for each in (mark.edge, mark.ground)]
    points = np.stack([np.asarray(mark.x, dtype=float), np.asarray(mark.y, dtype=float)], axis=-1)
    look = {"edgecolor": colours[0], "facecolor": colours[1], "linewidth": mark.width, "alpha": mark.opacity}
    axes.add_patch(Patch(points, closed=True, zorder=1, **look))
    axes.autoscale_view()


@draw.register
def _(mark: Remark, axes: Axes) -> None:
    if mark.at_right:
        edge = axes.get_yaxis_transform()
        axes.text(0.965, mark.y, mark.text, color=style.INK, fontsize=7.5, ha="right", va="center", transform=edge)
        axes.plot(0.985, mark.y, ">", color=style.INK, markersize=5.0, transform=edge)
        return
    axes.annotate(mark.text, (mark.x, mark.y), mark.offset, textcoords="offset points", fontsize=8.0)


@draw.register
def _(mark: Callout, axes: Axes) -> None:
    colour = style.hex_of(mark.colour)
    axes.annotate(
        mark.text, (mark.x, mark.y), mark.place, ha="right" if mark.at_left else "left", va="center", fontsize=6.5,
        color=colour, arrowprops={"arrowstyle": "-", "color": colour, "linewidth": 0.4, "shrinkB": 2},
    )  # fmt: skip


@draw.register
def _(mark: Heading, axes: Axes) -> None:
    axes.annotate("", mark.end, mark.start, arrowprops={"arrowstyle": "-|>", "color": style.INK, "linewidth": 1.5})


# -- looks ------------------------------------------------------------------------------------------------------------
def _line(stroke: Stroke) -> dict[str, Any]:
    return {"color": style.hex_of(stroke.colour), "linestyle": style.DASHES[stroke.dash]}


def _map(scale: Scale) -> str | Colormap:
    if scale.colours == "deviation":
        return DEVIATION
    return "cividis_r" if scale.reversed else "cividis"


def _norm(scale: Scale) -> Normalize:
    return LogNorm(scale.low, scale.high) if scale.log else Normalize(scale.low, scale.high)


def _bar(axes: Axes, scale: Scale) -> None:
    """The bar of a scale beside its axes: within their own box where other panels align with them."""
    figure = axes.get_figure()
    assert isinstance(figure, Figure)
    if figure.get_layout_engine() is None:
        box = axes.get_position()
        axes.set_position((box.x0, box.y0, 0.83 * box.width, box.height))  # room for the bar and its numbers
        place: dict[str, Any] = {"cax": axes.inset_axes((1.03, 0.0, 0.035, 1.0))}
    else:
        place = {"ax": axes, "shrink": 0.9, "aspect": 30, "pad": 0.02}
    linear = MaxNLocator(nbins=5, integer=scale.whole, steps=style.ROUND if scale.whole else [1, 2, 2.5, 5, 10])
    ticks = style.log_ticks(scale.low, scale.high) if scale.log else linear
    bar = figure.colorbar(
        ScalarMappable(_norm(scale), _map(scale)), ticks=ticks, extend=scale.beyond, label=scale.label, **place
    )
    bar.formatter = style.PLAIN
    bar.ax.minorticks_off()
    bar.ax.tick_params(labelsize=7.5)
    bar.outline.set_linewidth(0.5)


def shades(colours: int) -> list[str]:
    """So many colours of the deviation, from none to the largest, as CSS has them."""
    from matplotlib.colors import to_hex

    return [to_hex(DEVIATION(share)) for share in np.linspace(0.0, 1.0, colours)]

"""A dot and its interval for each of several names, one below the other: the main number of a page."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from adaptrack.base.result import BACKGROUND_STROKE, INK, SERIES, Panel
from adaptrack.results.marks import draw_dots, name_rows, set_log_scale
from adaptrack.results.words import data_text, legible, number

if TYPE_CHECKING:
    from matplotlib.axes import Axes

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


def dots_panel(
    dots: Sequence[Dot], label: str, words: str = "", level: float | None = None
) -> tuple[Panel, tuple[float, float]]:
    """The dots from the top down on one axis, which is logarithmic where they span more than a factor of five.

    label: of the axis; words: before the numbers in the alternative text; level: where an upright line is drawn.
    Returns the panel and its size on the page (inch).
    """
    rows = _first_dots(dots)
    edge = _edge(rows)

    def draw(axes: Axes) -> None:
        if level is not None:
            axes.axvline(level, linewidth=0.9, **BACKGROUND_STROKE.look)
        for row, dot in enumerate(rows):
            _draw_dot(axes, dot, row, edge)
        low, high, log = _limits(rows, [] if level is None else [level])
        axes.set_xlabel(label)
        if log:
            set_log_scale(axes, "x", (low, high))
        else:
            axes.set_xlim(low, high)
        name_rows(axes, [data_text(legible(dot.name, _NAME_LETTERS)) for dot in rows])

    panel = Panel("", draw, f"{words or label}. {'; '.join(map(_describe, rows))}.")
    return panel, (PICTURE_WIDTH, max(_MIN_HEIGHT, _AXIS_HEIGHT + _ROW_HEIGHT * len(rows)))


def _draw_dot(axes: Axes, dot: Dot, row: int, edge: float) -> None:
    if dot.value > edge:
        text = f"{number(dot.value)}{', failed' if dot.failed else ''} "
        place = axes.get_yaxis_transform()
        axes.text(0.965, row, text, color=INK, fontsize=7.5, ha="right", va="center", transform=place)
        axes.plot(0.985, row, ">", color=INK, markersize=5.0, transform=place)
        return
    if dot.low < dot.high:
        axes.plot([dot.low, dot.high], [row, row], color=dot.colour, linewidth=2.2, alpha=0.55)
    draw_dots(axes, [dot.value], [row], dot.colour, "X" if dot.failed else "o")


def caption_notes(dots: Sequence[Dot]) -> str:
    """The sentences of a caption that explain crosses, arrows and omitted dots."""
    rows = _first_dots(dots)
    near = [dot for dot in rows if dot.value <= _edge(rows)]
    notes = [
        (any(dot.failed for dot in near), "Cross: failed runs."),
        (len(near) < len(rows), "Arrow: beyond the axis."),
        (len(rows) < len(dots), f"The first {len(rows)} of {len(dots)}; the table has all."),
    ]
    return "".join(f" {note}" for applies, note in notes if applies)


def _first_dots(dots: Sequence[Dot]) -> list[Dot]:
    """As many finite dots as fit; the page's table has all."""
    return [dot for dot in dots if math.isfinite(dot.value)][:MAX_DOTS]


def _edge(dots: Sequence[Dot]) -> float:
    """The value above which a dot would flatten all others: `EDGE_RATIO` times the median."""
    return EDGE_RATIO * float(np.median([dot.value for dot in dots])) if dots else math.inf


def _limits(dots: Sequence[Dot], levels: Sequence[float]) -> tuple[float, float, bool]:
    """The ends of the axis, and whether it is logarithmic."""
    edge = _edge(dots)
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

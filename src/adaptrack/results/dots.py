"""A dot and its interval for each of several names, one below the other: the main number of a page."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes

from adaptrack.results import style
from adaptrack.results.page import Drawing
from adaptrack.results.words import legible, number, plain

WIDTH = 5.2
"""inch, of the picture: its letters can be read on a telephone and are not too large beside a verdict"""
_ROW, _ABOVE_AND_BELOW, _LEAST = 0.21, 0.75, 1.6
"""inch: of a name, of the axis with its label, of the whole picture"""
MOST = 14
"""Names that fit a first screen."""
FAR = 3.0
"""times the median: a dot beyond is drawn at the edge"""
_LETTERS = 40
"""of a name beside the axis"""


class Dot(NamedTuple):
    """A number and what is known of it."""

    name: str
    value: float
    low: float = math.nan
    """of the interval; NaN where none is known"""
    high: float = math.nan
    colour: str = style.SERIES[0]
    failed: bool = False
    """Drawn as a cross."""
    other: float = math.nan
    """A second number, drawn as a ring: what the first is held against."""


def dots_drawing(
    dots: Sequence[Dot], label: str, words: str = "", *, level: float | None = None,
    band: tuple[float, float] | None = None,
) -> Drawing:  # fmt: skip
    """The dots from the top down on one axis, which is logarithmic where they span more than a factor of five.

    label: of the axis; words: before the numbers in the alternative text; level: where an upright line is drawn; band:
    what is shaded.
    """
    shown = _most_telling(dots)
    far = _far(shown)

    def draw(axes: Axes) -> None:
        for place, dot in enumerate(shown):
            if dot.value > far:
                _draw_far(axes, dot, place)
                continue
            if dot.low < dot.high:
                axes.plot([dot.low, dot.high], [place, place], color=dot.colour, linewidth=2.2, alpha=0.55)
            if math.isfinite(dot.other):
                axes.plot(dot.other, place, "o", color=style.INK, markersize=6.5, fillstyle="none")
            axes.plot(dot.value, place, "X" if dot.failed else "o", color=dot.colour, markersize=5.0)
        if band is not None:
            axes.axvspan(*band, color=style.MUTED, alpha=0.15, linewidth=0.0)
        if level is not None:
            axes.axvline(level, color=style.MUTED, linewidth=0.9)
        names = [style.data_text(legible(dot.name, _LETTERS)) for dot in shown]
        axes.set_yticks(np.arange(len(names)), names)
        axes.set_ylim(len(names) - 0.4, -0.6)
        axes.grid(axis="y", visible=False)
        _scale(axes, shown, [each for each in (level, *(band or ())) if each is not None])
        axes.set_xlabel(label)

    with style.styled():
        figure = style.ShownFigure(figsize=(WIDTH, max(_LEAST, _ABOVE_AND_BELOW + _ROW * len(shown))))
        draw(figure.subplots())
    return Drawing(figure, plain(f"{words or label}. {'; '.join(map(_in_words, shown))}."))


def notes(dots: Sequence[Dot]) -> str:
    """What a caption adds on the marks: crosses, arrows, and which dots are left out."""
    shown = _most_telling(dots)
    near = [dot for dot in shown if dot.value <= _far(shown)]
    words = [
        (any(dot.failed for dot in near), "Cross: failed runs."),
        (len(near) < len(shown), "Arrow: beyond the axis."),
        (len(shown) < len(dots), f"The first {len(shown)} of {len(dots)}; the table has all."),
    ]
    return "".join(f" {each}" for holds, each in words if holds)


def _most_telling(dots: Sequence[Dot]) -> list[Dot]:
    """As many as fit, finite; of the rest the page's table tells."""
    return [dot for dot in dots if math.isfinite(dot.value)][:MOST]


def _far(dots: Sequence[Dot]) -> float:
    """Beyond which a dot would flatten all the rest: `FAR` times the median."""
    return FAR * float(np.median([dot.value for dot in dots])) if dots else math.inf


def _draw_far(axes: Axes, dot: Dot, place: int) -> None:
    """At the edge, with its number."""
    edge = axes.get_yaxis_transform()
    axes.plot(0.985, place, ">", color=dot.colour, markersize=5.0, transform=edge)
    words = f"{number(dot.value)}{', failed' if dot.failed else ''} "
    axes.text(0.965, place, words, color=style.INK, fontsize=7.5, ha="right", va="center", transform=edge)


def _scale(axes: Axes, dots: Sequence[Dot], also: Sequence[float]) -> None:
    far = _far(dots)
    near = [dot for dot in dots if dot.value <= far]
    ends = [end for dot in near for end in (dot.value, dot.low, min(dot.high, far), dot.other) if math.isfinite(end)]
    ends += also
    low, high = min(ends, default=0.0), max(ends, default=1.0)
    if low > 0.0 and high > 5.0 * low:
        style.logarithmic(axes, "x", (low / 1.15, high * 1.15))
    else:
        margin = 0.06 * (high - low) or 0.1 * abs(high) or 1.0
        axes.set_xlim(low - margin, high + margin)


def _in_words(dot: Dot) -> str:
    interval = f", {number(dot.low)} to {number(dot.high)}" if dot.low < dot.high else ""
    beside = f", beside {number(dot.other)}" if math.isfinite(dot.other) else ""
    return f"{dot.name}: {number(dot.value)}{interval}{beside}{', failed' if dot.failed else ''}"

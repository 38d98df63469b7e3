"""A dot and its interval for each of several names, one below the other: the main number of a page."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from adaptrack.base.result import Axis, Dots, Guide, Mark, Panel, Polyline, Remark, Stripe, Stroke
from adaptrack.results.words import data_text, legible, number

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
    colour: str = "series-0"
    failed: bool = False
    """Drawn as a cross."""
    other: float = math.nan
    """A second number, drawn as a ring: what the first is held against."""


def dots_panel(
    dots: Sequence[Dot], label: str, words: str = "", *, level: float | None = None,
    band: tuple[float, float] | None = None,
) -> tuple[Panel, tuple[float, float]]:  # fmt: skip
    """The dots from the top down on one axis, which is logarithmic where they span more than a factor of five.

    label: of the axis; words: before the numbers in the alternative text; level: where an upright line is drawn; band:
    what is shaded. Returns the panel and its size on the page [inch].
    """
    shown = _most_telling(dots)
    far = _far(shown)
    marks: list[Mark] = [] if band is None else [Stripe("x", *band)]
    marks += [] if level is None else [Guide("x", [level], width=0.9)]
    for place, dot in enumerate(shown):
        if dot.value > far:
            marks.append(Remark(0.0, place, f"{number(dot.value)}{', failed' if dot.failed else ''} ", at_right=True))
            continue
        if dot.low < dot.high:
            marks.append(Polyline([dot.low, dot.high], [place, place], Stroke(dot.colour), 2.2, opacity=0.55))
        if math.isfinite(dot.other):
            marks.append(Dots([dot.other], [place], "ink", "ring", 6.5))
        marks.append(Dots([dot.value], [place], dot.colour, "heavy cross" if dot.failed else "dot"))
    low, high, log = _ends(shown, [each for each in (level, *(band or ())) if each is not None])
    names = [data_text(legible(dot.name, _LETTERS)) for dot in shown]
    panel = Panel(
        "", Axis(label, low, high, log=log), Axis(names=names), marks,
        f"{words or label}. {'; '.join(map(_in_words, shown))}.",
    )  # fmt: skip
    return panel, (WIDTH, max(_LEAST, _ABOVE_AND_BELOW + _ROW * len(shown)))


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


def _ends(dots: Sequence[Dot], also: Sequence[float]) -> tuple[float, float, bool]:
    """The ends of the axis, and whether it is logarithmic."""
    far = _far(dots)
    near = [dot for dot in dots if dot.value <= far]
    ends = [end for dot in near for end in (dot.value, dot.low, min(dot.high, far), dot.other) if math.isfinite(end)]
    ends += also
    low, high = min(ends, default=0.0), max(ends, default=1.0)
    if low > 0.0 and high > 5.0 * low:
        return low / 1.15, high * 1.15, True
    margin = 0.06 * (high - low) or 0.1 * abs(high) or 1.0
    return low - margin, high + margin, False


def _in_words(dot: Dot) -> str:
    interval = f", {number(dot.low)} to {number(dot.high)}" if dot.low < dot.high else ""
    beside = f", beside {number(dot.other)}" if math.isfinite(dot.other) else ""
    return f"{dot.name}: {number(dot.value)}{interval}{beside}{', failed' if dot.failed else ''}"

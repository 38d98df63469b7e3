"""The picture of a comparison: each contender's cost over the reference's."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from adaptrack.base.result import MUTED, SERIES, Picture
from adaptrack.comparison.table import Comparison
from adaptrack.results.dots import Dot, caption_notes, dots_panel
from adaptrack.results.words import data_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_ADAPTIVE, _CONSTANT, _HINDSIGHT = SERIES[0], SERIES[1], MUTED
"""Colours of contenders that adapt their tuning, that keep one, and that need hindsight."""


def ratios_picture(comparison: Comparison, called: Callable[[str], str]) -> Picture:
    """Each contender's cost over the reference's, with its 95 % interval; called: names contenders as tables do."""
    dots = _dots(comparison, called)
    label = f"Cost / {called(comparison.reference)}"
    panel, size = dots_panel(dots, data_text(label), f"{label}, geometric mean and 95 % interval", level=1.0)
    caption = (
        f"{label}, geometric mean with its 95 % interval. Blue: adapts its tuning; orange: keeps one; grey: needs "
        f"hindsight.{caption_notes(dots)}"
    )
    return Picture("verdict", caption, [panel], size=size)


def comparison_figure(comparison: Comparison) -> Figure:
    """Each contender's cost over the reference's, with its 95 % interval."""
    from adaptrack.results.draw import panel_figure

    picture = ratios_picture(comparison, str)
    return panel_figure(picture.panels[0], picture.size)


def _dots(comparison: Comparison, called: Callable[[str], str]) -> list[Dot]:
    """A dot for each contender, the cheapest first; the reference only if there is no other."""
    rows = sorted(comparison.rows(), key=lambda row: row["regret_geomean"])
    return [
        Dot(called(row["contender"]), row["regret_geomean"], row["regret_low"], row["regret_high"],
            _colour(comparison, row["contender"]), row["failures"] > 0)
        for row in rows if row["contender"] != comparison.reference
    ] or [Dot(called(comparison.reference), 1.0)]  # fmt: skip


def _colour(comparison: Comparison, contender: str) -> str:
    role = comparison.role(contender)
    return _HINDSIGHT if role.hindsight else _ADAPTIVE if role.adapts else _CONSTANT

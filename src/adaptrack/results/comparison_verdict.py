"""What opens the page on a comparison: who is best, how sure that is, against what, and all ratios in a picture."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from matplotlib.figure import Figure

from adaptrack.comparison.table import Comparison
from adaptrack.results import style
from adaptrack.results.dots import Dot, dots_drawing, notes
from adaptrack.results.page import Drawing, Picture, Terms, Verdict
from adaptrack.results.words import counted, few, listed, number, ratio_with_interval

LISTED = 4
"""Contenders in the box, beside the picture of all."""
_ADAPTIVE, _CONSTANT, _HINDSIGHT = style.SERIES[0], style.SERIES[1], style.MUTED
"""Colours of what adapts its tuning, of what keeps one, and of what needs hindsight."""


def comparison_verdict(
    comparison: Comparison, noun: str, best: Sequence[str], called: Callable[[str], str], further: Sequence[str] = ()
) -> Verdict:
    """The verdict on a comparison.

    noun: what a run is; best: the cheapest contender that needs no hindsight, and those level with it; called: a
    contender in tables; further: sentences on other runs of the page.
    """
    rows = sorted(comparison.rows(), key=lambda row: row["regret_geomean"])
    first, *level = best
    others = few([called(each) for each in level], "other", 2)
    text = f"On {counted(rows[0]['runs'], noun)} {called(first)} costs least{f', level with {others}' * bool(level)}."
    judged = [row for row in rows if _is_listed(comparison, row["contender"])]
    entries = [(called(row["contender"]), ratio_with_interval(row, " times")) for row in judged[:LISTED]]
    failed = [f"{called(row['contender'])} in {number(row['failures'])}" for row in rows if row["failures"]]
    entries += [
        ("Against", f"{called(comparison.reference)}, on the same {noun}s"),
        ("Failed", f"{listed(failed[:3])}{' and others' if len(failed) > 3 else ''}" if failed else "none"),
        ("How sure", f"95 % bootstrap intervals over {counted(rows[0]['runs'], noun)}"),
        *(("Also", words) for words in further),
    ]
    dots, label = _dots(comparison, called), f"Cost / {called(comparison.reference)}"
    caption = (
        f"{label}, geometric mean with its 95 % interval. Blue: adapts its tuning; orange: keeps one; grey: needs "
        f"hindsight.{notes(dots)}"
    )
    drawing = _drawing(comparison, called)
    return Verdict(text, Terms(entries), Picture(caption, [drawing]))


def comparison_figure(comparison: Comparison) -> Figure:
    """Each contender's cost over the reference's, with its 95 % interval."""
    return _drawing(comparison, str).figure


def _drawing(comparison: Comparison, called: Callable[[str], str]) -> Drawing:
    label = f"Cost / {called(comparison.reference)}"
    words = f"{label}, geometric mean and 95 % interval"
    return dots_drawing(_dots(comparison, called), style.data_text(label), words, level=1.0)


def _dots(comparison: Comparison, called: Callable[[str], str]) -> list[Dot]:
    """The cheapest first; the reference only where it is alone."""
    rows = sorted(comparison.rows(), key=lambda row: row["regret_geomean"])
    return [
        Dot(called(row["contender"]), row["regret_geomean"], row["regret_low"], row["regret_high"],
            _colour(comparison, row["contender"]), row["failures"] > 0)
        for row in rows if row["contender"] != comparison.reference
    ] or [Dot(called(comparison.reference), 1.0)]  # fmt: skip


def _is_listed(comparison: Comparison, who: str) -> bool:
    """All but the reference, what needs hindsight, and what has a guard without it."""
    return who != comparison.reference and comparison.role(who).deployable


def _colour(comparison: Comparison, who: str) -> str:
    role = comparison.role(who)
    return _HINDSIGHT if role.hindsight else _ADAPTIVE if role.adapts else _CONSTANT

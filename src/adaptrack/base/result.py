"""The answer to a question: one sentence, tables of named columns, notes, and pictures as functions that draw.

A function that answers a question returns a `Result`. Console, JSON, notebook and page are renderings of it in
`adaptrack.results`. A table holds numbers and words.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

Row = Mapping[str, Any]
"""Column -> value: a number, words, a pair (lowest, highest), or None where there is none."""


# -- tables -----------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Column:
    """A named column of a table."""

    name: str
    """Key of the entry in each row, also in JSON."""
    title: str
    """Its heading; two lines where there is no unit."""
    unit: str = ""
    show: int | Literal["percent", "whole", "degrees", "power", "given"] = 4
    """Significant digits; or percent: a share 0..1; whole: no fraction; degrees: rad, with degrees in brackets; power:
    a power of ten; given: a number from elsewhere, with as many digits as it has."""
    meaning: str = ""
    """In one line, for the reader who does not know the quantity."""


@dataclass(frozen=True)
class ResultTable:
    """Rows of values under named columns; several tables may show columns of the same rows."""

    name: str
    title: str
    columns: Sequence[Column]
    rows: Sequence[Row]
    note: str = ""
    group: str = ""
    """The entry of a row whose value stands above all rows that share it; such rows are neighbours."""
    best: frozenset[tuple[int, str]] = frozenset()
    """(row, column) of the values that are the best of their kind."""
    alert: frozenset[tuple[int, str]] = frozenset()
    """(row, column) of the values that must not be missed, such as a failure."""
    brief: bool = False
    """Whether the console prints it."""


def where(rows: Sequence[Row], columns: Iterable[str], holds: Any) -> frozenset[tuple[int, str]]:
    """(row, column) of the entries that a function of the row accepts, for `ResultTable.best` and `alert`."""
    names = tuple(columns)
    return frozenset((i, name) for i, row in enumerate(rows) if holds(row) for name in names)


# -- pictures ---------------------------------------------------------------------------------------------------------
INK = "#1d2733"
"""Colour of text, ticks and the reference that controllers follow."""
MUTED = "#66717e"
"""Colour of frames and of lines in the background."""
PALE = "#dce1e7"
"""Colour of grid lines and of the road's surface."""
SERIES = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
"""Colours of contenders: Okabe and Ito's set, distinct with any common colour vision."""

Dash = Literal["solid", "dashed", "long", "dotted", "dash-dot"]
DASHES: Mapping[Dash, Any] = {
    "solid": "-", "dashed": (0, (4, 2)), "long": (0, (5, 1.5)), "dotted": (0, (1.5, 1.5)),
    "dash-dot": (0, (5, 1.5, 1, 1.5)),
}  # fmt: skip
"""Line styles in matplotlib's notation: offset and lengths in widths of the line."""


@dataclass(frozen=True)
class Stroke:
    """The colour and dash of the lines of one contender, in every picture of a result."""

    colour: str = SERIES[0]
    dash: Dash = "solid"

    @property
    def look(self) -> dict[str, Any]:
        """The stroke as keyword arguments of matplotlib's lines."""
        return {"color": self.colour, "linestyle": DASHES[self.dash]}


REFERENCE_STROKE = Stroke(INK, "dashed")
"""Stroke of the reference that controllers follow."""
SHARED_STROKE = Stroke(INK)
"""Stroke of signals that all runs share (gust, friction)."""
BACKGROUND_STROKE = Stroke(MUTED)
"""Stroke of lines behind the main curves."""

_ROUNDS: tuple[Dash, ...] = ("solid", "long", "dotted")


def strokes(labels: Iterable[str]) -> dict[str, Stroke]:
    """One stroke per distinct label, in the order given; they stay distinct for three times as many as `SERIES`."""
    return {
        label: Stroke(SERIES[i % len(SERIES)], _ROUNDS[i // len(SERIES) % len(_ROUNDS)])
        for i, label in enumerate(dict.fromkeys(labels))
    }


@dataclass(frozen=True)
class Panel:
    """A drawing on one pair of axes."""

    title: str
    draw: Callable[[Any], object]
    """Draws the curves on matplotlib's axes (`matplotlib.axes.Axes`) and sets their labels, limits and scales."""
    description: str
    """The alternative text is the title followed by it."""
    height: float = 1.0
    """Height relative to the other panels of a picture with one column."""


@dataclass(frozen=True)
class Picture:
    """Panels that flow into one or two columns, with a legend."""

    name: str
    caption: str
    panels: Sequence[Panel]
    key: Sequence[tuple[str, Stroke]] = ()
    file: str = ""
    """The name of its PNG file for print; empty for none."""
    columns: int = 2
    """Number of columns in the PNG file."""
    row_height: float = 2.25
    """inch, height of a row in the PNG file"""
    size: tuple[float, float] | None = None
    """inch, width and height of a panel on the page; the common size if None"""


# -- the result -------------------------------------------------------------------------------------------------------
@dataclass(frozen=True, kw_only=True)
class Result:
    """An answer with the numbers that support it."""

    kind: str
    """Which question is answered: identification, certificate, drive, ...; it names the page's template."""
    title: str
    answer: str
    """The answer in one sentence."""
    record: Mapping[str, Any]
    """Everything by name, as JSON takes it: numbers, words, None, lists and mappings of these."""
    tables: Sequence[ResultTable] = ()
    notes: Sequence[str] = ()
    """Further sentences that the reader must know."""
    pictures: Sequence[Picture] = ()
    failed: bool = False
    """Whether the answer is a failure."""
    headline: str = ""
    """The failure, to stand before the title; empty without one."""
    values: Mapping[str, Any] = field(default_factory=dict)
    """Named numbers and words for the page's template, in addition to `record`."""
    command: str = ""
    """The command line that repeats it."""
    created: str = ""
    next_step: str = ""
    """Suggestion for the next command."""

    def table(self, name: str) -> ResultTable:
        """A table by its name."""
        return next(table for table in self.tables if table.name == name)

    def picture(self, name: str) -> Picture:
        """A picture by its name."""
        return next(picture for picture in self.pictures if picture.name == name)


def strict(value: Any) -> Any:
    """A value as strict JSON takes it: None for numbers that are not finite, lists for arrays and tuples."""
    if isinstance(value, Mapping):
        return {str(key): strict(entry) for key, entry in value.items()}
    if hasattr(value, "tolist"):
        return strict(value.tolist())
    if isinstance(value, list | tuple):
        return [strict(entry) for entry in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value

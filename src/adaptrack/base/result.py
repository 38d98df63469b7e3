"""The answer to a question, as plain data: an answer in words, tables of named columns, notes, pictures.

A function that answers a question returns a `Result`; console, JSON, notebook and page are renderings of it in
`adaptrack.results`. Nothing here knows how a table is printed or a picture drawn: values are numbers, words and arrays,
colours and dashes have names.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

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
Colour: TypeAlias = str
"""ink, muted, grid, or series-0 ... series-5: a page has them for light and dark."""
Dash = Literal["solid", "dashed", "long", "dotted", "dash-dot"]

SERIES = tuple(f"series-{i}" for i in range(6))
"""The colours of what is compared, distinct with any common colour vision."""


@dataclass(frozen=True)
class Stroke:
    """How the lines of one contender are drawn, in every picture of a result."""

    colour: Colour = SERIES[0]
    dash: Dash = "solid"


REFERENCE = Stroke("ink", "dashed")
"""Of what is to be followed."""
NEUTRAL = Stroke("ink")
"""Of what all share (gust, friction)."""
BACKGROUND = Stroke("muted")
"""Of what lies under the rest."""

_ROUNDS: tuple[Dash, ...] = ("solid", "long", "dotted")


def strokes(labels: Iterable[str]) -> dict[str, Stroke]:
    """One stroke per distinct label, in the order given; they stay distinct for three times as many as `SERIES`."""
    return {
        label: Stroke(SERIES[i % len(SERIES)], _ROUNDS[i // len(SERIES) % len(_ROUNDS)])
        for i, label in enumerate(dict.fromkeys(labels))
    }


@dataclass(frozen=True)
class Polyline:
    """Points that are joined by a line."""

    x: ArrayLike
    y: ArrayLike
    stroke: Stroke = Stroke()
    width: float = 1.3
    """pt"""
    steps: Literal["", "pre", "post"] = ""
    """Where a value holds: up to its place, or from there on; empty: joined by straight lines."""
    markers: bool = False
    """A dot at every point."""
    opacity: float = 1.0


@dataclass(frozen=True)
class Dots:
    """Points that stand alone."""

    x: ArrayLike
    y: ArrayLike
    colour: Colour = SERIES[0]
    marker: Literal["dot", "ring", "square", "cross", "heavy cross", "triangle", "arrow", "point"] = "dot"
    size: float = 5.0
    """pt"""
    at_edge: bool = False
    """Those beyond the axes are drawn at their edge."""
    scales: bool = True
    """Whether the axes make room for them."""
    opacity: float = 1.0


@dataclass(frozen=True)
class Ribbon:
    """The area between two curves."""

    x: ArrayLike
    low: ArrayLike
    high: ArrayLike
    colour: Colour = SERIES[0]


@dataclass(frozen=True)
class Guide:
    """Straight lines across the whole panel."""

    across: Literal["x", "y"]
    """The axis that they cross: x stands upright, y lies."""
    at: Sequence[float]
    stroke: Stroke = BACKGROUND
    width: float = 0.8
    """pt"""


@dataclass(frozen=True)
class Stripe:
    """A shaded part of an axis, across the whole panel."""

    across: Literal["x", "y"]
    low: float
    high: float
    colour: Colour = "muted"
    opacity: float = 0.15


@dataclass(frozen=True)
class Bars:
    """Upright bars from zero."""

    edges: ArrayLike
    """(n + 1,)"""
    heights: ArrayLike
    """(n,)"""
    colour: Colour = SERIES[0]
    fill: float = 0.9
    """Share of the width."""


@dataclass(frozen=True)
class Scale:
    """From numbers to colours, dark to bright; the bar that explains it."""

    low: float
    high: float
    label: str = ""
    log: bool = False
    whole: bool = False
    """Whether only whole numbers are written beside the bar."""
    reversed: bool = False
    """Whether low values are bright."""
    colours: Literal["even", "deviation"] = "even"
    """even: cividis, also for the colour-blind and in grey; deviation: blue, amber, red."""
    beyond: Literal["neither", "min", "max", "both"] = "neither"
    """Where values lie beyond the colours."""


@dataclass(frozen=True)
class HeatMap:
    """A colour for each cell of a grid over two quantities."""

    x_edges: ArrayLike
    y_edges: ArrayLike
    values: ArrayLike
    """(y cells, x cells), NaN where there is none"""
    scale: Scale
    image: bool = False
    """One image of equal cells instead of a shape for each: for a fine grid, which then stays a small file."""


@dataclass(frozen=True)
class ColouredLine:
    """A line in the plane, each piece in the colour of its value."""

    x: ArrayLike
    """(n + 1,)"""
    y: ArrayLike
    values: ArrayLike
    """(n,)"""
    scale: Scale


@dataclass(frozen=True)
class Polygon:
    """A closed outline: filled where it has a ground."""

    x: ArrayLike
    y: ArrayLike
    edge: Colour = ""
    ground: Colour = ""
    width: float = 0.6
    """pt, of the edge"""
    opacity: float = 1.0


@dataclass(frozen=True)
class Remark:
    """Words beside a point."""

    x: float
    y: float
    text: str
    offset: tuple[float, float] = (5.0, 5.0)
    """pt, to the right and up"""
    at_right: bool = False
    """At the panel's right edge, level with y: for what lies beyond."""


@dataclass(frozen=True)
class Callout:
    """Words that stand apart from their point, level with another height and joined to the point by a thin line."""

    x: float
    y: float
    text: str
    place: tuple[float, float]
    """Where they begin, on the axes; where they end, if they stand on the left."""
    colour: Colour = "ink"
    at_left: bool = False


@dataclass(frozen=True)
class Heading:
    """An arrow."""

    start: tuple[float, float]
    end: tuple[float, float]


Mark: TypeAlias = (
    Polyline | Dots | Ribbon | Guide | Stripe | Bars | HeatMap | ColouredLine | Polygon | Remark | Callout | Heading
)


@dataclass(frozen=True)
class Axis:
    """What is along an axis, and how far it goes."""

    label: str = ""
    low: float | None = None
    """Its end; from what is drawn where left out."""
    high: float | None = None
    log: bool = False
    whole: bool = False
    """Whether only whole numbers have a tick."""
    names: Sequence[str] = ()
    """Words at 0, 1, 2, ... in place of numbers; downwards on the y axis."""
    degrees: bool = False
    """Radians, with a second scale in degrees."""
    include: Sequence[float] = ()
    """Values that lie on it in any case."""
    most: float | None = None
    """No end is farther than this from zero."""
    margin: float | None = None
    """Share of its length beside what is drawn."""


@dataclass(frozen=True)
class Panel:
    """What is drawn on one pair of axes."""

    title: str
    x: Axis
    y: Axis
    marks: Sequence[Mark]
    description: str
    """With the title, its alternative text."""
    remark: str = ""
    """Small words above it, at the right."""
    key: Sequence[tuple[str, Stroke]] = ()
    """Names of dashes, above it at the right."""
    to_scale: bool = False
    """Whether both axes have the same scale."""
    height: float = 1.0
    """In a picture of one column, over that of the others."""


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
    """of that file"""
    row_height: float = 2.25
    """inch, of that file"""
    size: tuple[float, float] | None = None
    """inch, on the page, of a single panel; all that are drawn alike where left out"""
    print_panels: Sequence[Panel] | None = None
    """Of that file, where they are others."""

    @property
    def for_print(self) -> Sequence[Panel]:
        """The panels of the file."""
        return self.panels if self.print_panels is None else self.print_panels


# -- the result -------------------------------------------------------------------------------------------------------
@dataclass(frozen=True, kw_only=True)
class Result:
    """An answer with what it rests on."""

    kind: str
    """Which question is answered: identification, certificate, drive, ...; it names the page's template."""
    title: str
    answer: str
    """The answer in one sentence."""
    record: Mapping[str, Any]
    """Everything by name, as JSON takes it: numbers, words, None, lists and mappings of these."""
    tables: Sequence[ResultTable] = ()
    notes: Sequence[str] = ()
    """Sentences on what the reader must know beside."""
    pictures: Sequence[Picture] = ()
    failed: bool = False
    """Whether the answer is one that nobody wants."""
    headline: str = ""
    """The failure, to stand before the title; empty without one."""
    values: Mapping[str, Any] = field(default_factory=dict)
    """Named numbers and words that pages tell in sentences, beside `record`."""
    command: str = ""
    """The command line that makes it again."""
    created: str = ""
    next_step: str = ""
    """Suggestion for the next command."""

    def table(self, name: str) -> ResultTable:
        """A table by its name."""
        return next(each for each in self.tables if each.name == name)

    def picture(self, name: str) -> Picture:
        """A picture by its name."""
        return next(each for each in self.pictures if each.name == name)


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

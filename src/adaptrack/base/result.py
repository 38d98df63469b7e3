"""Results of commands: a one-sentence answer, tables, notes, and pictures as drawing functions.

`adaptrack.results` renders a `Result` as console output, JSON, notebook output and HTML page.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

Row = Mapping[str, Any]
"""Value by column name: a number, text, a pair (lowest, highest), or None for a missing value."""


# -- tables -----------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Column:
    """A named column of a table."""

    name: str
    """Key of the entry in each row, also in JSON."""
    title: str
    """Heading. A column without a unit may use two lines, since the unit takes the second line."""
    unit: str = ""
    show: int | Literal["percent", "whole", "degrees", "power", "given"] = 4
    """Number of significant digits, or a format:

    - "percent": a share between 0 and 1, in %;
    - "whole": no decimals;
    - "degrees": an angle in rad, followed by degrees in brackets;
    - "power": a power of ten;
    - "given": all digits of the number.
    """
    meaning: str = ""
    """Explanation of the quantity in one line."""


@dataclass(frozen=True)
class ResultTable:
    """Rows of values under named columns. Several tables may show different columns of the same rows."""

    name: str
    title: str
    columns: Sequence[Column]
    rows: Sequence[Row]
    note: str = ""
    group: str = ""
    """Name of a column that groups the rows: its value becomes a heading above each group of consecutive rows."""
    best: frozenset[tuple[int, str]] = frozenset()
    """(row index, column name) of each best value."""
    alert: frozenset[tuple[int, str]] = frozenset()
    """(row index, column name) of each value that needs attention, such as a failure."""
    brief: bool | Sequence[str] = False
    """Whether the brief console output contains this table, or the names of the columns that it has there."""


def select_entries(
    rows: Sequence[Row], columns: Iterable[str], condition: Callable[..., Any]
) -> frozenset[tuple[int, str]]:
    """Return all pairs (row index, column name) of the given columns and the rows that fulfil a condition.

    The result serves as `ResultTable.best` or `ResultTable.alert`.
    """
    names = tuple(columns)
    return frozenset((i, name) for i, row in enumerate(rows) if condition(row) for name in names)


def best_entries(
    rows: Sequence[Row], picks: Mapping[str, Callable[..., Any]], group: str = "", competes: Callable[[Row], Any] = bool
) -> frozenset[tuple[int, str]]:
    """Return all pairs (row index, column name) of the best values; a column with one value only has none.

    picks: for each column the function that picks its best value, min or max; group: name of a column, rows with the
    same value in it compete with each other, all rows if empty; competes: condition that rows must fulfil.
    """
    best = set()
    for name, pick in picks.items():
        competing = [(i, row) for i, row in enumerate(rows) if competes(row) and row.get(name) is not None]
        for i, row in competing if len({row[name] for _, row in competing}) > 1 else ():
            rivals = [other[name] for _, other in competing if other.get(group) == row.get(group)]
            best |= {(i, name)} if row[name] == pick(rivals) else set()
    return frozenset(best)


# -- pictures ---------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Panel:
    """One pair of axes in a picture."""

    title: str
    draw: Callable[[Any], object]
    """Function that draws on a `matplotlib.axes.Axes` and sets labels, limits and scales."""
    description: str
    """Description for screen readers, who hear the title first."""
    height: float = 1.0
    """Height relative to the other panels of a picture with one column."""


@dataclass(frozen=True)
class Picture:
    """Panels in one or two columns with a common legend."""

    name: str
    caption: str
    panels: Sequence[Panel]
    key: Sequence[tuple[str, Mapping[str, Any]]] = ()
    """Legend: label and line of each contender; a line is its `color` and `linestyle` as matplotlib names them."""
    file: str = ""
    """Name of the PNG file for print; empty if none is written."""
    columns: int = 2
    """Number of columns in the PNG file."""
    row_height: float = 2.25
    """Height of a row in the PNG file (inch)."""
    size: tuple[float, float] | None = None
    """Width and height of a panel on the HTML page (inch); None for the default size."""


# -- the result -------------------------------------------------------------------------------------------------------
@dataclass(frozen=True, kw_only=True)
class Result:
    """Result of a command: an answer with the numbers that support it."""

    kind: str
    """Kind of result ("identification", "certificate", "drive", ...), which is also the name of the page template."""
    title: str
    answer: str
    """The answer in one sentence."""
    record: Mapping[str, Any]
    """Content of the JSON output: numbers, text, None, lists and mappings of these."""
    tables: Sequence[ResultTable] = ()
    notes: Sequence[str] = ()
    """Remarks on the answer, one sentence each."""
    pictures: Sequence[Picture] = ()
    failed: bool = False
    """Whether the answer reports a failure."""
    headline: str = ""
    """Failure in a few words, printed before the title; empty if there is none."""
    values: Mapping[str, Any] = field(default_factory=dict)
    """Numbers and text by name for the page template, in addition to `record`."""
    command: str = ""
    """Command line that repeats the computation."""
    created: str = ""
    """Date and time of the computation."""
    next_step: str = ""
    """Suggestion for the next command."""

    def table(self, name: str) -> ResultTable:
        """Return the table with this name."""
        return next(table for table in self.tables if table.name == name)


def strict(value: Any) -> Any:
    """Return a value for strict JSON: numbers that are not finite become None, arrays and tuples become lists."""
    if isinstance(value, Mapping):
        return {str(key): strict(entry) for key, entry in value.items()}
    if hasattr(value, "tolist"):
        return strict(value.tolist())
    if isinstance(value, list | tuple):
        return [strict(entry) for entry in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def to_json(result: Result) -> str:
    """The record of a result as one line of strict JSON: null for what is not finite."""
    return json.dumps(strict(result.record), allow_nan=False)

"""A result on the console: its answer, its brief tables, its notes and what to do next. Names are data: no markup."""

from __future__ import annotations

import itertools
import os
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from adaptrack.base.presentation import printable
from adaptrack.base.result import Column, Result, ResultTable, Row

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

PLAIN_WIDTH = 140
"""Width in letters if standard output is not a terminal; every table of numbers fits 80."""
_NAME, _WRAPPED = 40, 16
"""Letters: longest name that is not wrapped; least width of a last column of text, which may wrap."""


def print_result(result: Result, page: Path | None = None) -> None:
    """Print the answer, the brief tables, the notes, the path of the page and the next step."""
    say(result.answer)
    for table in result.tables:
        if table.brief and table.rows:
            names = [column.name for column in table.columns] if table.brief is True else table.brief
            print_table(replace(table, columns=[column for column in table.columns if column.name in names]))
            if table.note:
                say(table.note)
    for note in result.notes:
        say(f"Note: {note}")
    if page is not None:
        say(f"Page: {page}")
    if result.next_step:
        say(result.next_step)


def say(text: str, aside: bool = False) -> None:
    """Print a line on standard output; aside: on standard error, because standard output is for JSON."""
    print(printable(text, keep="\n"), file=sys.stderr if aside else sys.stdout)


def say_failed(text: str, aside: bool = False) -> None:
    """Print a line that begins with FAILED, in red on a terminal with colours."""
    from rich.text import Text

    line = Text.assemble(("FAILED", "bold red"), " ", printable(text, keep="\n"))
    _console(aside).print(line, soft_wrap=True)


def written(value: Any, column: Column) -> str:
    """Format an entry of a table; "-" for None."""
    if value is None:
        return "-"
    if isinstance(value, tuple):
        return " to ".join(written(end, column) for end in value)
    if column.show == "percent":
        return f"{100.0 * value:.0f}"
    if column.show == "whole":
        return f"{value:,.0f}"
    if isinstance(value, float):
        return f"{value:.{column.show if isinstance(column.show, int) else 3}g}"
    return printable(str(value), keep="\n")


def print_table(table: ResultTable) -> None:
    """Print a table with a line of titles and units, and the name of each group; numbers are aligned to the right.

    Columns that are too many for the width go below, beside the names again: no number is cut or left out.
    """
    from rich.text import Text

    console = _console()
    console.print(Text(printable(table.title, keep="\n")))
    for name, group in itertools.groupby(table.rows, lambda row: row.get(table.group)):
        rows = list(group)
        if name is not None:
            console.print(Text(printable(str(name))))
        for part in _parts(table.columns, rows, console.width):
            console.print(_grid(part, rows))
            console.print()


def _grid(columns: Sequence[Column], rows: Sequence[Row]) -> Table:
    from rich import box
    from rich.table import Table
    from rich.text import Text

    grid = Table(box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False, padding=(0, 1, 0, 0))
    for column in columns:
        numbers = all(isinstance(row[column.name], int | float | None) for row in rows)
        least = min(_NAME, _needed(column, rows)) if column is columns[0] else None
        grid.add_column(
            Text(_heading(column)), overflow="fold", justify="right" if numbers else "left", min_width=least
        )
    for row in rows:
        grid.add_row(*(Text(written(row[column.name], column)) for column in columns))
    return grid


def _parts(columns: Sequence[Column], rows: Sequence[Row], width: int) -> list[list[Column]]:
    """Split columns into tables that fit the width; each begins with the first column and has at least one more."""
    names, *value_columns = columns
    first = min(_NAME, _needed(names, rows))
    parts: list[list[Column]] = [[names]]
    used = first
    for i, column in enumerate(value_columns):
        is_text = any(isinstance(row[column.name], str) for row in rows)
        last = i == len(value_columns) - 1 and len(parts) == 1  # text at the end of a line may wrap
        needed = min(_needed(column, rows), _WRAPPED if last and is_text else _NAME) + 2
        if used + needed > width and len(parts[-1]) > 1:
            parts.append([names])
            used = first
        parts[-1].append(column)
        used += needed
    return parts


def _needed(column: Column, rows: Sequence[Row]) -> int:
    """The width of a column in letters."""
    return max(map(len, [*_heading(column).split("\n"), *(written(row[column.name], column) for row in rows)]))


def _heading(column: Column) -> str:
    return f"{column.title}\n({column.unit})" if column.unit else column.title


def _console(aside: bool = False) -> Console:
    """The console for rich text; with NO_COLOR set it writes no escape codes, while rich alone would keep bold."""
    from rich.console import Console

    colours: Literal["auto"] | None = None if os.environ.get("NO_COLOR") else "auto"
    stream = sys.stderr if aside else sys.stdout
    width = None if stream.isatty() or "COLUMNS" in os.environ else PLAIN_WIDTH
    return Console(file=stream, width=width, color_system=colours, highlight=False)

"""What commands print: tables, lists, JSON and one's progress. Names are data: no markup in them is read."""

from __future__ import annotations

import json
import os
import sys
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

from adaptrack.base.progress import Work, now_and_then, showing
from adaptrack.base.progress import duration as duration

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

Rows = Sequence[Mapping[str, Any]]

WIDE = 140
"""Columns of text where standard output is no terminal; every table of numbers fits 80."""
_NAME, _WRAPPED = 40, 16
"""Letters of a column of names that stay whole; least of one of text at the end of a line, which may wrap."""


class Column(NamedTuple):
    """A column of a table; a title may have two lines where there is no unit."""

    key: str
    """of the row's entry"""
    title: str
    unit: str = ""
    show: Callable[[Any], str] | None = None
    """how an entry is written; by default `written`"""


# -- text -------------------------------------------------------------------------------------------------------------
def say(text: str, aside: bool = False) -> None:
    """A line on standard output; aside: on standard error, where standard output is for JSON."""
    print(printable(text), file=sys.stderr if aside else sys.stdout)


def say_failed(text: str, aside: bool = False) -> None:
    """A line that begins with the word FAILED: red on a terminal with colours, plain anywhere else."""
    from rich.text import Text

    line = Text.assemble(("FAILED", "bold red"), " ", printable(text))
    _console(aside).print(line, soft_wrap=True)


def say_json(values: Any) -> None:
    """One strict JSON object."""
    print(json.dumps(values, allow_nan=False))


def printable(text: str) -> str:
    """The text with control characters, and what is no character at all, written as escapes."""
    from adaptrack.base.files import printable as escaped

    return escaped(text, keep="\n")


def written(value: Any) -> str:
    """A table's entry: four significant digits, "-" for nothing."""
    if value is None:
        return "-"
    return f"{value:.4g}" if isinstance(value, float) else printable(str(value))


def digits(count: int) -> Callable[[Any], str]:
    """Writes numbers with so many significant digits."""
    return lambda value: f"{value:.{count}g}" if isinstance(value, float) else written(value)


def whole(value: Any) -> str:
    """Writes a number without its fraction."""
    return "-" if value is None else f"{value:,.0f}"


def percent(value: Any) -> str:
    """Writes a share in per cent."""
    return "-" if value is None else f"{100.0 * value:.0f}"


# -- tables -----------------------------------------------------------------------------------------------------------
def table(title: str, columns: Sequence[Column], rows: Rows) -> None:
    """A table with a line of titles and units; numbers stand to the right.

    Columns that are too many for the width go below, beside the names again: no number is cut or left out.
    """
    from rich.text import Text

    console = _console()
    console.print(Text(printable(title)))
    for part in _parts(columns, rows, console.width):
        console.print(_grid(part, rows))
        console.print()


def _grid(columns: Sequence[Column], rows: Rows) -> Table:
    from rich import box
    from rich.table import Table
    from rich.text import Text

    made = Table(box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False, padding=(0, 1, 0, 0))
    for column in columns:
        known = [row[column.key] for row in rows if row[column.key] is not None]
        numbers = all(isinstance(value, int | float) for value in known)
        least = min(_NAME, max(map(len, map(str, known)), default=0)) if column is columns[0] else None
        made.add_column(_heading(column), overflow="fold", justify="right" if numbers else "left", min_width=least)
    for row in rows:
        made.add_row(*(Text((column.show or written)(row[column.key])) for column in columns))
    return made


def _parts(columns: Sequence[Column], rows: Rows, width: int) -> list[list[Column]]:
    """The columns of each table, the first of all in each: as many as fit, or one at least."""
    names, *others = columns
    first = min(_NAME, _needed(names, rows))
    parts: list[list[Column]] = [[names]]
    used = first
    for i, column in enumerate(others):
        last = i == len(others) - 1 and len(parts) == 1  # text at the end of a line may wrap
        needed = min(_needed(column, rows), _WRAPPED if last and _is_text(column, rows) else _NAME) + 2
        if used + needed > width and len(parts[-1]) > 1:
            parts.append([names])
            used = first
        parts[-1].append(column)
        used += needed
    return parts


def _needed(column: Column, rows: Rows) -> int:
    """Letters of the widest line."""
    lines = [*_heading(column).plain.split("\n"), *((column.show or written)(row[column.key]) for row in rows)]
    return max(map(len, lines))


def _is_text(column: Column, rows: Rows) -> bool:
    return any(isinstance(row[column.key], str) for row in rows)


def _heading(column: Column) -> Text:
    from rich.text import Text

    return Text(f"{column.title}\n({column.unit})" if column.unit else column.title)


def _console(aside: bool = False) -> Console:
    """Where rich text goes; with NO_COLOR set it writes no escape codes at all, where rich alone keeps bold."""
    from rich.console import Console

    colours: Literal["auto"] | None = None if os.environ.get("NO_COLOR") else "auto"
    stream = sys.stderr if aside else sys.stdout
    return Console(file=stream, width=_width(aside), color_system=colours, highlight=False)


def _width(aside: bool = False) -> int | None:
    stream = sys.stderr if aside else sys.stdout
    return None if stream.isatty() or "COLUMNS" in os.environ else WIDE


def listing(title: str, rows: Rows, as_json: bool) -> None:
    """Rows that need no choice of columns."""
    if as_json:
        say_json({"rows": rows})
    elif rows:
        table(title, [Column(key, key.replace("_", " ")) for key in rows[0]], rows)


def flat(title: str, values: Mapping[str, Any], as_json: bool) -> None:
    """Names and values."""
    if as_json:
        say_json(values)
    else:
        listing(title, [{"what": key.replace("_", " "), "value": value} for key, value in values.items()], False)


# -- progress ---------------------------------------------------------------------------------------------------------
Show = Callable[[str, int, int], None]
"""show(what is done, steps done, steps in all)"""


@contextmanager
def progress(label: str, total: int = 1) -> Iterator[Show]:
    """Progress on standard error: a bar on a terminal, else a line now and then. Yields the function that tells it.

    label, total: see `base.progress.Work`. Where something else is on show already, nothing is shown.
    """
    work = Work(label, total)
    with showing(work) as alone:
        if not alone:
            yield work.update
            return
        with _bar(work) if sys.stderr.isatty() else _lines(work) as update:
            yield update


@contextmanager
def _bar(work: Work) -> Iterator[Show]:
    from rich.console import Console
    from rich.progress import BarColumn, Progress, ProgressColumn, SpinnerColumn, Task, TextColumn, TimeElapsedColumn
    from rich.text import Text

    class Left(ProgressColumn):
        def render(self, task: Task) -> Text:
            left = work.left()
            return Text("" if left is None else f"{duration(left)} left")

    columns = (
        SpinnerColumn(), TextColumn("{task.description}", markup=False), BarColumn(20), TimeElapsedColumn(), Left()
    )  # fmt: skip
    # Records of the logger, such as that a kernel is compiled, appear above the bar.
    with Progress(*columns, console=Console(file=sys.stderr), transient=True, redirect_stdout=False) as bar:
        task = bar.add_task(printable(work.label), total=None)  # no total: the bar only moves to and fro

        def update(label: str, done: int, steps: int) -> None:
            work.update(label, done, steps)
            bar.update(task, description=printable(label), completed=work.share, total=1.0 if work.share else None)

        yield update


@contextmanager
def _lines(work: Work) -> Iterator[Show]:
    over = threading.Event()

    def tell() -> None:
        print(f"adaptrack: {printable(work.line())}", file=sys.stderr, flush=True)

    teller = threading.Thread(target=now_and_then, args=(over, tell), daemon=True)
    teller.start()
    try:
        yield work.update
    finally:
        over.set()
        teller.join()

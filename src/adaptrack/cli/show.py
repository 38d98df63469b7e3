"""Output of commands: text, tables, JSON and progress. Markup in names is printed as plain text."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from adaptrack.base.presentation import printable as escaped
from adaptrack.base.progress import TrackedWork, Update, reported, shown_progress
from adaptrack.base.progress import duration as duration
from adaptrack.base.result import Column, Result, ResultTable, Row, to_json
from adaptrack.results.console import print_result, print_table, say, say_failed

__all__ = ["Column", "say", "say_failed"]


# -- text and tables --------------------------------------------------------------------------------------------------
def say_result(result: Result, as_json: bool, out: Path | None = None, png: bool = True) -> None:
    """Write the page of a result, with PNG files, to the folder `out`, if there is one; print the result."""
    page = None
    if out is not None:
        from adaptrack.results.page import write_result  # matplotlib, which a result without a page does not need

        with progress("write the page"):
            page = write_result(out, result, png=png)
    if as_json:
        print(to_json(result))
        if page is not None:
            say(f"Page: {page}", aside=True)
    else:
        print_result(result, page)


def say_json(values: Any) -> None:
    """Print a strict JSON object."""
    print(json.dumps(values, allow_nan=False))


printable = partial(escaped, keep="\n")
"""Return a text with control and invalid characters as escape sequences."""


def table(title: str, columns: Sequence[Column], rows: Sequence[Row]) -> None:
    """Print a table, see `results.console.print_table`."""
    print_table(ResultTable("", title, columns, rows))


def listing(title: str, rows: Sequence[Row], as_json: bool) -> None:
    """Print rows with all their entries as columns."""
    if as_json:
        say_json({"rows": rows})
    elif rows:
        table(title, [Column(key, key.replace("_", " ")) for key in rows[0]], rows)


# -- files -----------------------------------------------------------------------------------------------------
@contextmanager
def replacing(*files: Path, aside: bool = False) -> Iterator[None]:
    """Keep files that the `with` block replaces by other content, and say where, see `base.files.keep_replaced`."""
    from adaptrack.base.files import keep_replaced  # NumPy, which --help does not need

    with keep_replaced(*files) as kept:
        yield
    say_backups(kept, aside)


def say_backups(files: Sequence[Path], aside: bool = False) -> None:
    """Print where the previous content of replaced files is; nothing without any."""
    if files:
        say(f"The previous content is in {', '.join(map(str, files))}", aside=aside)


# -- progress ---------------------------------------------------------------------------------------------------------
def progress(label: str, total: int = 1) -> AbstractContextManager[Update]:
    """Show progress of a `with` block on standard error; the block gets the function that updates it.

    A terminal shows a bar, other outputs a line at intervals. Nested progress is not shown. label, total: see
    `base.progress.TrackedWork`. Inside another computation that shows its progress nothing is shown.
    """
    display = _bar if sys.stderr.isatty() else partial(reported, report=_print_line)
    return shown_progress(TrackedWork(label, total), display)


@contextmanager
def _bar(work: TrackedWork) -> Iterator[Update]:
    from rich.console import Console
    from rich.progress import BarColumn, Progress, ProgressColumn, SpinnerColumn, Task, TextColumn, TimeElapsedColumn
    from rich.text import Text

    class Left(ProgressColumn):
        def render(self, task: Task) -> Text:
            left = work.time_left()
            return Text("" if left is None else f"{duration(left)} left")

    columns = (
        SpinnerColumn(), TextColumn("{task.description}", markup=False), BarColumn(20), TimeElapsedColumn(), Left()
    )  # fmt: skip
    # Records of the logger, such as that a kernel is compiled, appear above the bar.
    with Progress(*columns, console=Console(file=sys.stderr), transient=True, redirect_stdout=False) as bar:
        task = bar.add_task(printable(work.label), total=None)  # without a total, the bar only moves back and forth

        def update(label: str, steps_done: int, steps: int) -> None:
            work.update(label, steps_done, steps)
            bar.update(task, description=printable(label), completed=work.share, total=1.0 if work.share else None)

        yield update


def _print_line(work: TrackedWork) -> None:
    print(f"adaptrack: {printable(work.status_line())}", file=sys.stderr, flush=True)

"""What `adaptation` and `evaluate-schedules` show: how schedulers compare."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from adaptrack.base.errors import InvalidInput
from adaptrack.cli import options, show

if TYPE_CHECKING:
    from adaptrack.comparison.table import Comparison
    from adaptrack.studies.adapt import Adapted


def scheduler_files(given: Sequence[str]) -> list[str]:
    """Of names, files and folders of schedulers: names and files.

    Raises
    ------
    InvalidInput
        When a folder holds none.
    """
    found: list[str] = []
    for name in given:
        folder = Path(name)
        files = sorted(str(path) for path in folder.glob("*.json")) if folder.is_dir() else [name]
        if not files:
            raise InvalidInput(f"--schedulers {name}: there is no scheduler (*.json) in this folder.")
        found += files
    return found


def main_table(made: Adapted) -> tuple[Comparison, str] | None:
    """The comparison that decides, and what a run of it is: the drives, else the operating points, else a test."""
    for tables, noun in ((made.drives, "drive"), (made.operating_points, "operating point")):
        if "exact" in tables:
            return tables["exact"], noun
    return (next(iter(made.tests.values())), "test") if made.tests else None


def answer(made: Adapted) -> str:
    """The first line: whether a schedule is worth it."""
    from adaptrack.results.comparison_answers import of_schedules

    table = main_table(made)
    return "Nothing was driven." if table is None else of_schedules(*table)


def worthy_schedule(made: Adapted) -> str | None:
    """The schedule that is worth having, by its name; None where no one is."""
    from adaptrack.results.comparison_answers import best_constant, best_schedule, is_worth

    table = main_table(made)
    best = None if table is None else best_schedule(table[0])
    if table is None or best is None:
        return None
    return best if is_worth(table[0].ratio(best, best_constant(table[0]))) else None


def write_page(out: Path, made: Adapted) -> Path:
    """The page about a comparison."""
    from adaptrack.results.comparison import comparison_result
    from adaptrack.results.page import write_result

    with show.progress("write the page"):
        return write_result(out, comparison_result(
            operating_points=made.operating_points, drives=made.drives, tests=made.tests, schedules=made.schedules,
            histories=made.histories, command=options.command_line(),
        ))  # fmt: skip


def print_comparison(made: Adapted, as_json: bool) -> None:
    """The rows of all views: operating points and drives by how friction and wind are known, tests by their name."""
    from adaptrack.results.comparison import console_tables, view_rows
    from adaptrack.results.console import print_tables

    views = {"operating points": made.operating_points, "drives": made.drives, "tests": made.tests}
    if as_json:
        show.say_json({"rows": view_rows(views)})
    else:
        print_tables(console_tables(views))

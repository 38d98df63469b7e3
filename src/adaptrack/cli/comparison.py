"""What `adapt` and `evaluate` both show: how schedulers compare."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from adaptrack.cli import options, show
from adaptrack.cli.show import Column

if TYPE_CHECKING:
    from adaptrack.adapt import Adapted

COLUMNS = (
    Column("scheduler", "scheduler"),
    Column("cost_geomean", "cost J", "m²", show.digits(3)),
    Column("regret_geomean", "regret\nmean", "", show.digits(4)),
    Column("interval", "95 %\ninterval"),
    Column("regret_p99", "99th\nperc.", "", show.digits(3)),
    Column("regret_worst", "worst", "", show.digits(3)),
    Column("failures", "runs\nfailed"),
)


def write_page(out: Path, made: Adapted) -> Path:
    """The page about a comparison."""
    from adaptrack.report.ladder import write_ladder

    with show.progress("write the page"):
        return write_ladder(
            out,
            conditions=made.conditions.get("exact"),
            drives=made.drives.get("exact"),
            perceptions=made.conditions,
            drive_perceptions=made.drives,
            tests=made.tests,
            schedules=made.schedules,
            histories=made.histories,
            command=options.command_line(),
        )


def print_comparison(made: Adapted, as_json: bool) -> None:
    """The rows of all views: operating points and drives by how friction and wind are known, tests by their name."""
    views: dict[str, Mapping[str, Any]] = {"conditions": made.conditions, "drives": made.drives, "tests": made.tests}
    if as_json:
        show.say_json({"rows": _rows(views)})
        return
    for view, ladders in views.items():
        for name, ladder in ladders.items():
            rows = [{**row, "interval": f"{row['regret_low']:.3g}-{row['regret_high']:.3g}"} for row in ladder.rows()]
            show.table(f"{view}, {name}: {len(ladder.where)} runs, regret to {ladder.reference}", COLUMNS, rows)


def _rows(views: Mapping[str, Mapping[str, Any]]) -> list[dict[str, Any]]:
    from adaptrack.evaluate.ladder import finite

    return [
        {"view": view, "scenario" if view == "tests" else "told": name, "reference": ladder.reference, **row}
        for view, ladders in views.items()
        for name, ladder in ladders.items()
        for row in finite(ladder.rows())
    ]

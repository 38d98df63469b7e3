"""What `adapt` and `evaluate` both show: how schedulers compare."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from adaptrack.cli import options, show
from adaptrack.cli.show import Column

if TYPE_CHECKING:
    from adaptrack.learning.adaptation.config import AdaptationConfig
    from adaptrack.studies.adapt import Adapted

COLUMNS = (
    Column("contender", "contender"),
    Column("cost_geomean", "cost J", "m²", show.digits(3)),
    Column("regret_geomean", "regret\nmean", "", show.digits(4)),
    Column("interval", "95 %\ninterval"),
    Column("regret_worst", "worst", "", show.digits(3)),
    Column("failures", "runs\nfailed"),
)


def study(config: str | None, controller: str | None, profile: str | None) -> AdaptationConfig:
    """The adaptation that the options ask for: a configuration for a controller and a profile, or what ships for both.

    Without any of them: the informed controller in the profile `road`.
    """
    from adaptrack.learning.adaptation.config import find_adaptation, load_adaptation

    if config is None:
        return load_adaptation(find_adaptation(str(controller or "informed"), profile or "road"))
    return load_adaptation(config, controller=None if controller is None else str(controller), profile=profile)


def write_page(out: Path, made: Adapted) -> Path:
    """The page about a comparison."""
    from adaptrack.results.comparison import write_comparison

    with show.progress("write the page"):
        return write_comparison(
            out,
            operating_points=made.operating_points,
            drives=made.drives,
            tests=made.tests,
            schedules=made.schedules,
            histories=made.histories,
            command=options.command_line(),
        )


def print_comparison(made: Adapted, as_json: bool) -> None:
    """The rows of all views: operating points and drives by how friction and wind are known, tests by their name."""
    views: dict[str, Mapping[str, Any]] = {
        "operating points": made.operating_points, "drives": made.drives, "tests": made.tests
    }  # fmt: skip
    if as_json:
        show.say_json({"rows": _rows(views)})
        return
    for view, comparisons in views.items():
        for name, each in comparisons.items():
            rows = [{**row, "interval": f"{row['regret_low']:.3g}-{row['regret_high']:.3g}"} for row in each.rows()]
            show.table(f"{view}, {name}: {len(each.where)} runs, regret to {each.reference}", COLUMNS, rows)


def _rows(views: Mapping[str, Mapping[str, Any]]) -> list[dict[str, Any]]:
    from adaptrack.comparison.table import finite

    return [
        {"view": view, "scenario" if view == "tests" else "known_as": name, "reference": each.reference, **row}
        for view, comparisons in views.items()
        for name, each in comparisons.items()
        for row in finite(each.rows())
    ]

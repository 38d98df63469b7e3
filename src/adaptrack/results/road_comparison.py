"""The result of contenders that drove the same roads: the table, the cost on each road, who failed where."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from adaptrack.base.result import Axis, Column, Panel, Picture, Polyline, Result, ResultTable, Row, strokes, where
from adaptrack.comparison.table import Comparison
from adaptrack.comparison.views import road_rows
from adaptrack.results.comparison_answers import on_roads
from adaptrack.results.dots import Dot, dots_panel, notes
from adaptrack.results.words import counted, data_text, few, number

CONSOLE = (
    Column("contender", "contender"),
    Column("cost_mean", "mean J", "m²", 3),
    Column("cost_geomean", "geomean", "m²", 3),
    Column("regret_geomean", "ratio", "", 3),
    Column("interval", "95 %\ninterval"),
    Column("rms_error", "RMS e", "m", 3),
    Column("p95_error", "p95 |e|", "m", 3),
    Column("max_corner_error", "corner |e|", "m", 3),
    Column("failures", "runs\nfailed"),
)
LISTED = 5
"""Contenders in the box that opens the page."""
LEAST_ROADS = 6
"""Fewer than that say little about other roads."""
MOST_LISTED = 3
"""Failed runs of a contender that the console shows; page and JSON have all."""

FAILED = (
    Column("contender", "contender"),
    Column("road", "road"),
    Column("seed", "noise\nseed"),
    Column("at", "failed at", "s", 3),
    Column("because", "the vehicle"),
)


def road_comparison_result(
    made: Comparison, *, title: str, record: Mapping[str, Any] | None = None, notes: Sequence[str] = (),
    command: str = "", next_step: str = "",
) -> Result:  # fmt: skip
    """Contenders on the same roads as a result.

    Parameters
    ----------
    title
        Car, profile and roads.
    record
        What JSON says beside the rows, such as the car and the profile.
    notes
        What the reader must know beside, such as who was left out, and why.
    command
        The command line that makes it again.
    next_step
        What to do next, with the command.
    """
    rows = road_rows(made)
    shown = f"{title}, {counted(len(made.seeds), 'noise seed')}; ratio to {made.reference}"
    ranked = sorted(rows, key=lambda row: row["regret_geomean"])
    return Result(
        kind="road-comparison",
        title=f"{few(made.costs, 'contender')}: {title}",
        answer=on_roads(made),
        record=dict(record or {}) | {"rows": rows},
        tables=[_contenders(made, rows), *_failed_runs(rows), *console_tables(made, rows, shown)],
        notes=notes,
        pictures=[_ratios(made, ranked), _costs(made)],
        values={
            "listed": ranked[:LISTED], "reference": made.reference, "roads": len(made.roads),
            "failures": sum(row["failures"] for row in rows), "runs": sum(row["runs"] for row in rows),
        },
        command=command,
        next_step=next_step,
    )  # fmt: skip


# -- tables -----------------------------------------------------------------------------------------------------------
def _contenders(made: Comparison, rows: Sequence[Row]) -> ResultTable:
    columns = (
        Column("contender", "Contender"), Column("cost_geomean", "Cost J", "geometric mean, m²", 3),
        Column("regret_geomean", "Cost", f"/ {made.reference}", 3), Column("interval", "95 % interval", show=3),
        Column("rms_error", "RMS |e|", "m", 3), Column("p95_error", "p95 |e|", "m", 3),
        Column("max_corner_error", "Corner", "largest, m", 3),
        Column("failures", "Failed", f"of {number(rows[0]['runs'])}"),
    )  # fmt: skip
    shown = [{**row, "interval": (row["regret_low"], row["regret_high"])} for row in rows]
    over = f"the {len(made.roads)} roads" if len(made.roads) > 1 else "the noise seeds of this one road"
    note = (
        "J: mean e² plus the profile's weight of steering; a failed run counts as "
        f"{made.failure.distance**2:g} m². Interval: bootstrap over {over}. Errors count until a run's end "
        "or failure; corner: the outermost corner of the body beyond half its width."
    )
    return ResultTable("contenders", "Contenders on the same roads", columns, shown, note,
                       alert=where(shown, ["failures"], lambda row: row["failures"] > 0))  # fmt: skip


def _failed_runs(rows: Sequence[Row]) -> list[ResultTable]:
    shown = [{"contender": row["contender"], **each} for row in rows for each in row["failed"]]
    return [ResultTable("failed", "Failed runs", FAILED, shown)] if shown else []


def console_tables(made: Comparison, rows: Sequence[Row], title: str) -> list[ResultTable]:
    """What the console shows of contenders on roads, and their first failed runs; rows: `views.road_rows`."""
    shown = [{**row, "interval": f"{row['regret_low']:.3g}-{row['regret_high']:.3g}"} for row in rows]
    count = len(made.table(made.reference))
    if len(made.roads) == 1:
        note = f"Interval: bootstrap over the {count} noise seeds of this one road; it says nothing about others."
    else:
        note = f"Interval: bootstrap over the {count} roads{'; they are few' if count < LEAST_ROADS else ''}."
    tables = [ResultTable("console", title, CONSOLE, shown, note, brief=True)]
    failed = [{"contender": row["contender"], **each} for row in rows for each in row["failed"][:MOST_LISTED]]
    if failed:
        more = [
            f"{row['contender']}: {counted(len(row['failed']) - MOST_LISTED, 'more run')} failed."
            for row in rows if len(row["failed"]) > MOST_LISTED
        ]  # fmt: skip
        tables.append(ResultTable("console failed", "Failed runs", FAILED, failed, " ".join(more), brief=True))
    return tables


# -- pictures ---------------------------------------------------------------------------------------------------------
def _ratios(made: Comparison, ranked: Sequence[Row]) -> Picture:
    dots = [
        Dot(row["contender"], row["regret_geomean"], row["regret_low"], row["regret_high"], failed=row["failures"] > 0)
        for row in ranked
    ]
    label = f"Cost J / that of {made.reference}"
    panel, size = dots_panel(dots, data_text(label), label, level=1.0)
    return Picture("verdict", f"{label}, with 95 % intervals.{notes(dots)}", [panel], size=size)


def _costs(made: Comparison) -> Picture:
    """Cost of each contender on each road; of one road, with each noise seed."""
    own, alone = strokes(made.costs), len(made.roads) == 1
    names = [f"seed {seed}" for seed in made.seeds] if alone else made.roads
    marks = [
        Polyline(np.arange(len(names)), costs, own[contender], 0.8, markers=True)
        for contender, costs in made.costs.items()
    ]
    words = [
        f"{contender}: {number(costs.min())} to {number(costs.max())} m²" for contender, costs in made.costs.items()
    ]
    panel = Panel(
        "Cost", Axis(names=[data_text(each) for each in names]), Axis("Cost J (m²)", log=True), marks,
        f"{'; '.join(words)}.",
    )  # fmt: skip
    caption = "Cost J with each noise seed." if alone else "Cost J on each road, mean over the noise seeds."
    return Picture("costs", caption, [panel], list(own.items()), "costs.png", 1, 4.0, (5.2, 3.0))

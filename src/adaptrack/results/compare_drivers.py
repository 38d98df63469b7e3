"""Result of `compare` with drivers: each measure of steering and speed by itself, without a rank."""

from __future__ import annotations

import math
from collections.abc import Sequence

from adaptrack.base.result import Column, Picture, Result, ResultTable, Row, select_entries, strokes
from adaptrack.comparison.run import Compared
from adaptrack.comparison.table import driver_rows
from adaptrack.results.compare import best_cells, comparison_record, failure_tables
from adaptrack.results.dots import Dot, caption_notes, dots_panel
from adaptrack.results.words import counted, listed, slug

DRIVER_COLUMNS = (
    Column("failures", "failed", "runs", meaning="failed runs"),
    Column("time_lost", "late", "s", 2, "mean delay at the end of a run"),
    Column("speed_error", "speed", "m/s", 2, "RMS difference from the speed planned for the place"),
    Column("rms_error", "path", "m", 2, "RMS distance from the centre line"),
    Column("longitudinal_jerk", "jerk", "m/s³", 2, "largest longitudinal jerk of a run (UN R79), 95 % of the runs"),
    Column("used_grip", "grip", "-", 2, "largest acceleration divided by true friction times gravity"),
    Column("stop_error", "stop", "m", 2, "largest distance from a stop at which a car stood; 8 m: it did not stand"),
)


def compare_drivers_result(compared: Compared, *, command: str = "", next_step: str = "") -> Result:
    """The result of a comparison of drivers; arguments as for `compare_result`."""
    task = compared.task
    rows = {condition: driver_rows(comparison) for condition, comparison in compared.profile_comparisons.items()}
    meanings = " ".join(f"{column.title}: {column.meaning}." for column in DRIVER_COLUMNS)
    return Result(
        kind="compare-drivers",
        title=f"{counted(len(task.contenders), 'controller')} with {counted(len(task.drivers), 'driver')} on "
        f"{counted(len(task.cars), 'car')} and {counted(len(task.roads), 'road')}",
        answer="\n".join(_headline(condition, rows[condition]) for condition in rows),
        record=comparison_record(compared, rows),
        tables=[*(table for name in rows for table in _tables(name, rows[name])), *failure_tables(compared)],
        notes=[
            "Smaller is better in every column, and no column outranks another. All columns but the first describe the "
            f"runs that did not fail. {meanings}",
            f"Cars: {listed(task.cars)}. Roads: {listed(task.roads)}. Noise seeds: {listed([*map(str, task.seeds)])}.",
        ],
        pictures=[_picture(condition, rows[condition]) for condition in rows],
        command=command,
        next_step=next_step,
    )


def _headline(condition: str, rows: Sequence[Row]) -> str:
    failed, runs = (sum(row[name] for row in rows) for name in ("failures", "runs"))
    return f"Profile {condition}: {failed} of {counted(runs, 'run')} failed."


def _tables(condition: str, rows: Sequence[Row]) -> list[ResultTable]:
    """A table of the drivers for each controller, or of the controllers if there is one driver."""
    name, group = ("controller", "driver") if len({row["driver"] for row in rows}) == 1 else ("driver", "controller")
    tables = []
    for member in dict.fromkeys(row[group] for row in rows):
        table_rows = [{**row, "label": row[name]} for row in rows if row[group] == member]
        columns = [column for column in DRIVER_COLUMNS if any(row[column.name] is not None for row in table_rows)]
        complete_rows = [dict.fromkeys(row) if row["failures"] else row for row in table_rows]
        tables.append(
            ResultTable(
                f"{condition} {member}",
                f"Profile {condition}, {group} {member}; {counted(table_rows[0]['runs'], 'run')} each",
                [Column("label", name), *columns], table_rows,
                best=best_cells(complete_rows, {column.name: min for column in columns}),
                alert=select_entries(table_rows, ["failures"], lambda row: row["failures"] > 0), brief=True,
            )
        )  # fmt: skip
    return tables


def _picture(condition: str, rows: Sequence[Row]) -> Picture:
    """A panel for each measure with a dot for each driver, in the colour of the controller."""
    colours, panels = strokes(row["controller"] for row in rows), []
    for column in [column for column in DRIVER_COLUMNS if any(row[column.name] for row in rows)]:
        values = [math.nan if row[column.name] is None else row[column.name] for row in rows]
        dots = [
            Dot(row["driver"], value, colour=colours[row["controller"]].colour, failed=row["failures"] > 0)
            for row, value in zip(rows, values, strict=True)
        ]
        panel, size = dots_panel(dots, f"{column.title} ({column.unit})", f"{column.meaning} ({column.unit})")
        panels.append(panel)
    caption = f"Profile {condition}. Smaller is better in every panel.{caption_notes(dots)}"
    return Picture(condition, caption, panels, [*colours.items()], f"drivers-{slug(condition)}.png", 2, size[1], size)

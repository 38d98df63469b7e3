"""Result of `compare` with drivers: each measure of steering and speed by itself, without a rank."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from adaptrack.base.result import Column, Panel, Picture, Result, ResultTable, Row, select_entries, strokes
from adaptrack.comparison.run import Compared
from adaptrack.comparison.table import Comparison
from adaptrack.comparison.views import driver_rows
from adaptrack.results.compare import comparison_record, failure_tables
from adaptrack.results.marks import draw_dots, name_rows
from adaptrack.results.words import counted, data_text, listed, number

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PERCENT = ("time_lost", "used_grip")
"""Measures that tables and pictures show in percent."""
DRIVER_COLUMNS = (
    Column("failed", "failed", meaning="failed runs of all runs"),
    Column("time_lost", "late", "%", 2, "mean time lost, relative to the planned time"),
    Column("speed_error", "speed", "m/s", 2, "RMS difference from the speed planned for the place"),
    Column("rms_error", "path", "m", 2, "RMS distance from the road's centre line"),
    Column("longitudinal_jerk", "jerk", "m/s³", 2, "95th percentile of the longitudinal jerk, mean of the runs"),
    Column("used_grip", "grip", "%", 3, "largest acceleration, relative to true friction times gravity"),
    Column("stop_error", "stop", "m", 2, "largest distance from a stop at which a car stood"),
    Column("missed_stops", "missed", "", "whole", "stops that were passed without standing"),
)
PANELS = {
    "failures": "Failed runs",
    "time_lost": "Time lost (%)",
    "speed_error": "RMS speed error (m/s)",
    "rms_error": "RMS path error (m)",
    "longitudinal_jerk": "Longitudinal jerk (m/s³)",
    "used_grip": "Largest used grip (%)",
    "stop_error": "Largest stop error (m)",
}
"""Label of the axis by measure, in the order of the panels."""
_ROW, _SPREAD = 0.42, 0.8
"""Height of a row (inch), and its share that the dots of one driver take."""


def compare_drivers_result(compared: Compared, *, command: str = "", next_step: str = "") -> Result:
    """The result of a comparison of drivers; arguments as for `compare_result`."""
    task, comparisons = compared.task, compared.profile_comparisons
    rows = {key: driver_rows(comparison) for key, comparison in comparisons.items()}
    columns = " ".join(f"{column.title}: {column.meaning}." for column in _columns(rows))
    return Result(
        kind="compare-drivers",
        title=f"{counted(len(task.contenders), 'controller')} with {counted(len(task.drivers), 'driver')} on "
        f"{counted(len(task.cars), 'car')} and {counted(len(task.roads), 'road')}",
        answer="\n".join(_headline(key, table_rows) for key, table_rows in rows.items()),
        record=comparison_record(compared, rows),
        tables=[*_tables(rows), *failure_tables(compared)],
        notes=[
            "Smaller is better in every column, and no column outranks another. All but the first describe the runs "
            f"that did not fail. {columns}",
            f"Cars: {listed(task.cars)}. Roads: {listed(task.roads)}. Noise seeds: {listed([*map(str, task.seeds)])}.",
        ],
        pictures=[_picture(comparisons, rows)],
        command=command,
        next_step=next_step,
    )


def _headline(key: str, rows: Sequence[Row]) -> str:
    failed, runs = (sum(row[name] for row in rows) for name in ("failures", "runs"))
    return f"Profile {key}: {number(failed)} of {number(runs)} runs failed."


def _shown(row: Row, measure: str) -> Any:
    """Return the value of a measure as tables and pictures show it."""
    return row[measure] if row[measure] is None or measure not in PERCENT else 100.0 * row[measure]


# -- tables -----------------------------------------------------------------------------------------------------------
def _columns(rows: Mapping[str, Sequence[Row]]) -> list[Column]:
    """Return the columns of all tables: without measures of stops if there are none, or none was missed."""
    return [
        column
        for column in DRIVER_COLUMNS
        if column.name == "failed" or any(
            row[column.name] is not None and (row[column.name] or column.name != "missed_stops")
            for table_rows in rows.values()
            for row in table_rows
        )
    ]  # fmt: skip


def _tables(rows: Mapping[str, Sequence[Row]]) -> Iterator[ResultTable]:
    """Yield a table of the drivers for each profile and controller; with one driver a table of the controllers."""
    columns = _columns(rows)
    is_one_driver = len({row["driver"] for table_rows in rows.values() for row in table_rows}) == 1
    name, group = ("controller", "driver") if is_one_driver else ("driver", "controller")
    for key, all_rows in rows.items():
        for title in dict.fromkeys(row[group] for row in all_rows):
            table_rows = [
                {
                    **row, **{measure: _shown(row, measure) for measure in PERCENT}, "label": row[name],
                    "failed": f"{row['failures']}/{row['runs']}",
                }
                for row in all_rows if row[group] == title
            ]  # fmt: skip
            yield ResultTable(
                f"{key} {title}", f"Profile {key}, {group} {title}", [Column("label", name), *columns], table_rows,
                best=_best_cells(table_rows, columns), brief=True,
                alert=select_entries(table_rows, ["failed"], lambda row: row["failures"] > 0),
            )  # fmt: skip


def _best_cells(rows: Sequence[Row], columns: Sequence[Column]) -> frozenset[tuple[int, str]]:
    """Return (row, column) of the smallest values among the rows without a failure."""
    cells = set()
    for column in columns[1:]:
        values = {i: row[column.name] for i, row in enumerate(rows) if not row["failures"]}
        finite = [value for value in values.values() if value is not None]
        if finite and min(finite) < max(finite):
            cells |= {(i, column.name) for i, value in values.items() if value == min(finite)}
    return frozenset(cells)


# -- the picture ------------------------------------------------------------------------------------------------------
def _picture(comparisons: Mapping[str, Comparison], rows: Mapping[str, Sequence[Row]]) -> Picture:
    """A panel for each measure: a row for each driver, colours for profile, friction and controller."""
    groups: dict[str, list[tuple[Comparison, Row]]] = {}
    for key, comparison in comparisons.items():
        for row in rows[key]:
            groups.setdefault(f"{row['controller']}, {key}", []).append((comparison, row))
    drivers = list(dict.fromkeys(row["driver"] for group in groups.values() for _, row in group))
    panels = [
        Panel("", partial(_draw, measure, label, groups, drivers), _describe(measure, label, groups))
        for measure, label in PANELS.items()
        if any(row[measure] is not None for group in groups.values() for _, row in group)
    ]
    caption = "Dot: one run that did not fail. Bar: the value of the table. Smaller is better in every panel."
    height = 0.7 + _ROW * len(drivers)
    return Picture("drivers", caption, panels, list(strokes(groups).items()), "drivers.png", 2, height, (4.5, height))


Groups = Mapping[str, Sequence[tuple[Comparison, Row]]]
"""Rows of one controller in one profile, with their comparison, by label."""


def _draw(measure: str, label: str, groups: Groups, drivers: Sequence[str], axes: Axes) -> None:
    for i, (stroke, group) in enumerate(zip(strokes(groups).values(), groups.values(), strict=True)):
        for comparison, row in group:
            place = drivers.index(row["driver"]) + _SPREAD * ((i + 0.5) / len(groups) - 0.5)
            if measure != "failures":
                values = comparison.of(row["label"], measure)[comparison.of(row["label"], "failed") == 0.0]
                values = values * (100.0 if measure in PERCENT else 1.0)
                draw_dots(axes, values, np.full(values.size, place), stroke.colour, size=1.6, alpha=0.4)
            if row[measure] is not None:
                half, value = 0.5 * _SPREAD / len(groups), _shown(row, measure)
                axes.plot([value, value], [place - half, place + half], color=stroke.colour, linewidth=2.0)
    axes.set(xlabel=label)
    name_rows(axes, [data_text(driver) for driver in drivers])


def _describe(measure: str, label: str, groups: Groups) -> str:
    values = [
        f"{row['driver']}, {name}: {number(_shown(row, measure))}" for name, group in groups.items() for _, row in group
    ]
    return f"{label}. {'; '.join(values)}."

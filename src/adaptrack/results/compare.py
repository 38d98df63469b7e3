"""Result of `compare`: ranking in each profile, error and steering effort, failed runs, and entry speeds."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from adaptrack.base.result import Column, Panel, Picture, Result, ResultTable, Row, best_entries, select_entries
from adaptrack.comparison.config import about_contender
from adaptrack.comparison.run import Compared
from adaptrack.comparison.table import Comparison, driver_rows, standing_rows
from adaptrack.control.controllers import about_controller
from adaptrack.core.maths import portable
from adaptrack.results import marks
from adaptrack.results.words import counted, data_text, listed, number, slug, span

_OURS, _PAPERS_COLOUR, _OTHERS = marks.SERIES[0], marks.SERIES[1], marks.MUTED
"""Colours of our controllers, the paper's, and all others."""
COLOURS = "Blue: ours; orange: the paper's; grey: others."
_PAPERS = ("as-written", "as-released", "nn", "anfis", "published")
_ROW = 0.19
"""Height of a row in pictures with a row per controller (inch)."""
MAX_FAILED_RUNS = 10
"""Largest number of failed runs in the table on console and page."""

CONTENDER_COLUMNS = (
    Column("label", "Controller"),
    Column("rank", "Rank"),
    Column("rms_ratio", "RMS error", "ratio", 3),
    Column("rms_interval", "95 % interval", "ratio", 3),
    Column("cost_ratio", "Cost J", "ratio", 3),
    Column("cost_interval", "95 % interval", "ratio", 3),
    Column("rms_error", "RMS error", "m", 2),
    Column("p95_error", "95 % error", "m", 2),
    Column("max_corner", "Max. corner error", "m", 2),
    Column("steering_rate", "RMS steering rate", "rad/s", 2),
    Column("acceleration", "Lateral acceleration", "m/s²", 2),
    Column("entry_speed", "Entry speed ISO 3888-2", "km/h", 2),
    Column("failures", "Failed", "runs"),
    Column("runs", "Total", "runs"),
)
BEST_VALUES = {
    **dict.fromkeys(("rms_ratio", "cost_ratio", "rms_error", "p95_error", "max_corner", "failures"), min),
    "entry_speed": max,
}
"""The function that picks the best value of a column."""
RANKING_COLUMNS = (
    Column("label", "controller"),
    Column("rank", "rank"),
    Column("rms", "RMS error\nratio, 95 %"),
    Column("cost_ratio", "cost J\nratio", "", 3),
    Column("rms_error", "RMS error", "m", 2),
    Column("failed", "failed"),
    Column("entry_speed", "entry", "km/h", "whole", "highest clean entry speed into ISO 3888-2"),
)
FAILED_RUN_COLUMNS = (
    Column("label", "Controller"),
    Column("car", "Car"),
    Column("profile", "Profile"),
    Column("road", "Road"),
    Column("seed", "Seed"),
    Column("reason", "Reason"),
    Column("failed_at", "Time", "s", 3),
)
LEFT_OUT_COLUMNS = (
    Column("contender", "Controller"),
    Column("where", "Profile: cars"),
    Column("why", "Reason"),
)


def compare_result(compared: Compared) -> Result:
    """The result of a comparison; its record holds a row of each contender in each profile, and every cell."""
    comparisons, task = compared.profile_comparisons, compared.task
    rows = {profile: profile_rows(compared, profile) for profile in comparisons}
    last = list(comparisons)[-1]
    cars = counted(len(set(compared.columns["car"])), "car")
    return Result(
        kind="compare",
        title=f"{counted(len(task.contenders), 'controller')} on {cars} and {counted(len(task.roads), 'road')}",
        answer="\n".join(headline(profile, ranking) for profile, ranking in rows.items()),
        record=comparison_record(compared, rows),
        tables=[
            *(contender_table(profile, ranking) for profile, ranking in rows.items()),
            *(console_table(profile, ranking, comparisons[profile]) for profile, ranking in rows.items()),
            *failure_tables(compared),
        ],
        pictures=[_ratios(last, rows[last], comparisons[last].reference), _work(rows), *_entry_speeds(compared)],
        values={
            "profiles": list(rows), "reference": comparisons[last].reference, "task": task, "colours": COLOURS,
            "contenders": [(name, about_contender(name).words) for name in task.contenders],
        },
    )  # fmt: skip


def headline(profile: str, rows: Sequence[Row]) -> str:
    """Name the controller with the smallest RMS error, and count the failed runs; rows: from `standing_rows`."""
    failed, runs = (sum(row[key] for row in rows) for key in ("failures", "runs"))
    best = f"smallest RMS error {number(rows[0]['rms_error'])} m, {rows[0]['label']}"
    return f"Profile {profile}: {best}; {number(failed)} of {number(runs)} runs failed."


def contender_colour(contender: str) -> str:
    """The colour of a controller in every picture of the page."""
    return _PAPERS_COLOUR if contender in _PAPERS else _OURS if about_controller(contender).ours else _OTHERS


def profile_rows(compared: Compared, profile: str) -> list[dict[str, Any]]:
    """The rows of a profile, see `views.standing_rows`, with the mean entry speed over the cars (km/h)."""
    speeds, rows = compared.entry_speeds(profile), []
    for row in standing_rows(compared.profile_comparisons[profile]):
        by_car = speeds.get(row["label"], {})
        rows.append({**row, "entry_speed": 3.6 * sum(by_car.values()) / len(by_car) if by_car else None})
    return rows


def comparison_record(compared: Compared, rows: Mapping[str, Sequence[Row]]) -> dict[str, Any]:
    """The JSON record of a comparison; rows: of each profile."""
    return {
        "name": compared.task.name,
        "profiles": dict(rows),
        "failed_runs": compared.failed_runs,
        "left_out": [{**cell.entries, "why": why} for cell, why in compared.left_out.items()],
        "cells": [
            {**cell.entries, **{key: value for key, value in result.items() if key != "rows"}}
            for cell, result in compared.cells.items()
        ],
    }


# -- tables -----------------------------------------------------------------------------------------------------------
def contender_table(profile: str, rows: Sequence[Row]) -> ResultTable:
    """All contenders in a profile, for the page; columns without a value are left out."""
    table_rows = [
        {**row, "rms_interval": (row["rms_low"], row["rms_high"]), "cost_interval": (row["cost_low"], row["cost_high"])}
        for row in rows
    ]
    columns = [column for column in CONTENDER_COLUMNS if any(row[column.name] is not None for row in table_rows)]
    failed = select_entries(table_rows, ["failures"], lambda row: row["failures"] > 0)
    best = best_entries(table_rows, BEST_VALUES)
    return ResultTable(profile, f"Controllers in profile {profile}", columns, table_rows, best=best, alert=failed)


def console_table(profile: str, rows: Sequence[Row], comparison: Comparison) -> ResultTable:
    """All contenders in a profile, for the console."""
    table_rows = [
        {
            "entry_speed": None, **row, "failed": f"{row['failures']}/{row['runs']}",
            "rms": f"{row['rms_ratio']:.3g} [{row['rms_low']:.2g}-{row['rms_high']:.2g}]",
        }
        for row in rows
    ]  # fmt: skip
    columns = [column for column in RANKING_COLUMNS if any(row[column.name] is not None for row in table_rows)]
    numbers = (len(comparison.cars), "car"), (len(comparison.roads), "road"), (len(comparison.seeds), "noise seed")
    size = ", ".join(counted(n, noun) for n, noun in numbers)
    title = f"Profile {profile}: {size}; ratios to {comparison.reference}"
    return ResultTable(f"console {profile}", title, columns, table_rows, brief=True)


def failure_tables(compared: Compared) -> list[ResultTable]:
    """Failed runs by car, the first failed runs if a run failed, and contenders that were left out."""
    runs, tables = compared.failed_runs, [_failures_by_car(compared)]
    note = f"The first {MAX_FAILED_RUNS} of {number(len(runs))}; --json has all." if len(runs) > MAX_FAILED_RUNS else ""
    if runs:
        first = runs[:MAX_FAILED_RUNS]
        tables.append(ResultTable("failed runs", "Failed runs", FAILED_RUN_COLUMNS, first, note, brief=True))
    return tables + _left_out_table(compared)


def _failures_by_car(compared: Compared) -> ResultTable:
    """Failed runs of each contender with each car."""
    cars = list(dict.fromkeys(compared.columns["car"].tolist()))
    rows, runs_of_car = [], dict[str, list[int]]()
    for profile, table in compared.profile_comparisons.items():
        for contender in table.contenders:
            row: dict[str, Any] = {"label": contender, "profile": f"Profile {profile}"}
            for car in cars:
                runs = table.of(contender, "failed")[table.cars.index(car)] if car in table.cars else np.empty(0)
                count = int(np.isfinite(runs).sum())
                row[car] = int(np.nansum(runs)) if count else None
                runs_of_car.setdefault(car, []).extend([count] if count else [])
            rows.append(row)
    columns = [
        Column(car, car.partition("/")[0], f"of {span(np.array(runs_of_car[car], dtype=float))}") for car in cars
    ]
    alert = frozenset((i, car) for i, row in enumerate(rows) for car in cars if row[car])
    return ResultTable(
        "failures", "Failed runs by car", [Column("label", "Controller"), *columns], rows, "", "profile", alert=alert
    )


def _left_out_table(compared: Compared) -> list[ResultTable]:
    """Contenders that do not fit a car or a profile, if there are any."""
    cars: dict[tuple[str, str, str], list[str]] = {}
    for cell, why in compared.left_out.items():
        cars.setdefault((cell.with_driver(cell.contender), cell.condition, why), []).append(cell.car)
    rows = [
        {"contender": contender, "where": f"{profile}: {', '.join(names)}", "why": why}
        for (contender, profile, why), names in cars.items()
    ]
    return [ResultTable("left out", "Left out", LEFT_OUT_COLUMNS, rows, brief=True)] if rows else []


# -- pictures ---------------------------------------------------------------------------------------------------------
def _ratios(profile: str, rows: Sequence[Row], reference: str) -> Picture:
    """A dot and its interval for each contender, the best first."""
    dots = [
        marks.Dot(row["label"], row["rms_ratio"], row["rms_low"], row["rms_high"], contender_colour(row["contender"]),
            row["failures"] > 0)
        for row in rows
    ]  # fmt: skip
    label = f"RMS error / RMS error of {reference}"
    caption = f"Profile {profile}: {label}, with 95 % intervals. {COLOURS}"
    return marks.dots_picture("verdict", caption, [(dots, data_text(label), label)], level=1.0, file="ratios.png")


def _work(rows: Mapping[str, Sequence[Row]]) -> Picture:
    """RMS error over the steering rate of the tuned contenders, a panel for each profile."""
    panels = []
    for profile, ranking in rows.items():
        tuned = [row for row in ranking if row["tuning"] != "default"] or ranking
        errors = (
            f"{row['contender']}: {number(row['rms_error'])} m, {number(row['steering_rate'])} rad/s" for row in tuned
        )
        panels.append(Panel(f"Profile {profile}", partial(_draw_work, rows=tuned), f"{'; '.join(errors)}."))
    return Picture("work", "", panels, (), "work.png", 2, 3.0)


def _draw_work(axes: marks.Axes, rows: Sequence[Row]) -> None:
    rates, errors = [row["steering_rate"] for row in rows], [row["rms_error"] for row in rows]
    for row, rate, error, height in zip(rows, rates, errors, _label_heights(errors), strict=True):
        colour, at_left = contender_colour(row["contender"]), rate > max(rates) / 1.5  # far right: named on its left
        axes.plot(rate, error, "o", color=colour, markersize=5.0, zorder=5)
        axes.annotate(
            data_text(row["contender"]), (rate, error), (rate / 1.06 if at_left else 1.06 * rate, height),
            ha="right" if at_left else "left", va="center", fontsize=6.5, color=colour,
            arrowprops={"arrowstyle": "-", "color": colour, "linewidth": 0.4, "shrinkB": 2},
        )  # fmt: skip
    axes.set(xlabel="Steering rate (rad/s)", ylabel="RMS error (m)")
    marks.set_log_scale(axes, "x", (0.8 * min(rates), 1.6 * max(rates)))
    marks.set_log_scale(axes, "y", (0.8 * min(errors), 1.6 * max(errors)))


def _label_heights(values: Sequence[float]) -> list[float]:
    """Heights of labels on a logarithmic axis: those of the values, moved up where one would cover another."""
    logs = portable.log(values)
    gap = 0.055 * (np.ptp(logs) + portable.log(2.0))  # the axis is twice as long as its values reach
    order = np.argsort(logs)
    heights = logs.copy()
    for below, above in itertools.pairwise(order):
        heights[above] = max(heights[above], heights[below] + gap)
    return portable.exp(heights).tolist()


def _entry_speeds(compared: Compared) -> list[Picture]:
    speeds = {profile: compared.entry_speeds(profile) for profile in compared.profile_comparisons}
    panels = [
        _entry_panel(table, profile, speeds[profile])
        for profile, table in compared.profile_comparisons.items()
        if speeds[profile]
    ]
    height = 0.75 + _ROW * max(map(len, speeds.values()), default=0)
    return [Picture("entry", "", panels, (), "entry.png", 1, height, (5.2, height))] if panels else []


def _entry_panel(table: Comparison, profile: str, speeds: Mapping[str, Mapping[str, float]]) -> Panel:
    rows = [(contender, 3.6 * np.array(list(cars.values()))) for contender, cars in speeds.items()]
    rows.sort(key=lambda row: -float(np.mean(row[1])))

    def draw(axes: marks.Axes) -> None:
        for place, (contender, values) in enumerate(rows):
            colour, mean = contender_colour(table.role(contender).controller), float(values.mean())
            axes.plot(values, np.full(len(values), place), "o", color=colour, markersize=3.5, alpha=0.6, zorder=5)
            axes.plot([mean, mean], [place - 0.35, place + 0.35], color=colour, linewidth=2.0)
        fastest = max(float(values.max()) for _, values in rows) or 1.0
        axes.set(xlabel=f"Entry speed (km/h), profile {profile}", xlim=(-0.02 * fastest, 1.04 * fastest))
        marks.name_rows(axes, [data_text(contender) for contender, _ in rows])

    best, values = rows[0]
    mean = number(float(values.mean()))
    return Panel("", draw, f"Entry speeds in profile {profile}; highest mean: {best}, {mean} km/h.")


# -- drivers ----------------------------------------------------------------------------------------------------------
DRIVER_COLUMNS = (
    Column("failures", "failed", "runs", meaning="failed runs"),
    Column("time_lost", "late", "s", 2, "mean delay at the end of a run"),
    Column("speed_error", "speed", "m/s", 2, "RMS difference from the speed planned for the place"),
    Column("rms_error", "path", "m", 2, "RMS distance from the centre line"),
    Column("longitudinal_jerk", "jerk", "m/s³", 2, "largest longitudinal jerk of a run (UN R79), 95 % of the runs"),
    Column("used_grip", "grip", "-", 2, "largest acceleration divided by true friction times gravity"),
    Column("stop_error", "stop", "m", 2, "largest distance from a stop at which a car stood; 8 m: it did not stand"),
)


def compare_drivers_result(compared: Compared) -> Result:
    """The result of a comparison of drivers; its record is that of `compare_result`."""
    task = compared.task
    rows = {condition: driver_rows(comparison) for condition, comparison in compared.profile_comparisons.items()}
    meanings = " ".join(f"{column.title}: {column.meaning}." for column in DRIVER_COLUMNS)
    return Result(
        kind="compare-drivers",
        title=f"{counted(len(task.contenders), 'controller')} with {counted(len(task.drivers), 'driver')} on "
        f"{counted(len(task.cars), 'car')} and {counted(len(task.roads), 'road')}",
        answer="\n".join(
            f"Profile {condition}: {sum(row['failures'] for row in drivers)} of "
            f"{counted(sum(row['runs'] for row in drivers), 'run')} failed."
            for condition, drivers in rows.items()
        ),
        record=comparison_record(compared, rows),
        tables=[*(table for name in rows for table in _driver_tables(name, rows[name])), *failure_tables(compared)],
        notes=[
            "Smaller is better in every column, and no column outranks another. All columns but the first describe the "
            f"runs that did not fail. {meanings}",
            f"Cars: {listed(task.cars)}. Roads: {listed(task.roads)}. Noise seeds: {listed([*map(str, task.seeds)])}.",
        ],
        pictures=[_drivers_picture(condition, rows[condition]) for condition in rows],
    )


def _driver_tables(condition: str, rows: Sequence[Row]) -> list[ResultTable]:
    """A table of the drivers for each controller, or of the controllers if there is one driver."""
    name, group = ("controller", "driver") if len({row["driver"] for row in rows}) == 1 else ("driver", "controller")
    tables = []
    for member in dict.fromkeys(row[group] for row in rows):
        table_rows = [{**row, "label": row[name]} for row in rows if row[group] == member]
        columns = [column for column in DRIVER_COLUMNS if any(row[column.name] is not None for row in table_rows)]
        tables.append(
            ResultTable(
                f"{condition} {member}",
                f"Profile {condition}, {group} {member}; {counted(table_rows[0]['runs'], 'run')} each",
                [Column("label", name), *columns], table_rows,
                best=best_entries(
                    table_rows, {column.name: min for column in columns}, competes=lambda row: not row["failures"]
                ),
                alert=select_entries(table_rows, ["failures"], lambda row: row["failures"] > 0), brief=True,
            )
        )  # fmt: skip
    return tables


def _drivers_picture(condition: str, rows: Sequence[Row]) -> Picture:
    """A panel for each measure with a dot for each driver, in the colour of the controller."""
    colours, charts = marks.strokes(row["controller"] for row in rows), []
    for column in [column for column in DRIVER_COLUMNS if any(row[column.name] for row in rows)]:
        values = [math.nan if row[column.name] is None else row[column.name] for row in rows]
        dots = [
            marks.Dot(row["driver"], value, colour=colours[row["controller"]]["color"], failed=row["failures"] > 0)
            for row, value in zip(rows, values, strict=True)
        ]
        charts.append((dots, f"{column.title} ({column.unit})", f"{column.meaning} ({column.unit})"))
    caption, file = f"Profile {condition}. Smaller is better in every panel.", f"drivers-{slug(condition)}.png"
    return marks.dots_picture(condition, caption, charts, key=[*colours.items()], file=file)


# -- costs of contenders ----------------------------------------------------------------------------------------------
def ratios_picture(comparison: Comparison, called: Callable[[str], str]) -> Picture:
    """Each contender's cost over the reference's, the cheapest first; called: names contenders as tables do.

    The reference itself is drawn only if there is no other contender.
    """
    dots = []
    for row in sorted(comparison.rows(), key=lambda row: row["regret_geomean"]):
        role, interval = comparison.role(row["contender"]), (row["regret_low"], row["regret_high"])
        colour = marks.MUTED if role.hindsight else marks.SERIES[0 if role.adapts else 1]
        if row["contender"] != comparison.reference:
            name, failed = called(row["contender"]), row["failures"] > 0
            dots.append(marks.Dot(name, row["regret_geomean"], *interval, colour, failed))
    dots = dots or [marks.Dot(called(comparison.reference), 1.0)]
    label = f"Cost / {called(comparison.reference)}"
    caption = (
        f"{label}, geometric mean with its 95 % interval. Blue: adapts its tuning; orange: keeps one; grey: needs "
        "hindsight."
    )
    words = f"{label}, geometric mean and 95 % interval"
    return marks.dots_picture("verdict", caption, [(dots, data_text(label), words)], level=1.0)

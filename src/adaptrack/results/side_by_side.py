"""The result of a side-by-side: who is first where, error against steering work, failures by car, entry speeds."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from adaptrack.base.result import (
    SERIES,
    Axis,
    Callout,
    Column,
    Dots,
    Mark,
    Panel,
    Picture,
    Polyline,
    Result,
    ResultTable,
    Row,
    Stroke,
    where,
)
from adaptrack.comparison.run import Compared
from adaptrack.comparison.table import Comparison
from adaptrack.comparison.views import standing_rows
from adaptrack.control.controllers import about_controller
from adaptrack.results.comparison_answers import on_cars
from adaptrack.results.dots import Dot, dots_panel, notes
from adaptrack.results.words import counted, data_text, number, span

OURS, PAPER, OTHERS = SERIES[0], SERIES[1], "muted"
"""Colours of our controllers, the paper's, and all others."""
COLOURS = "Blue: ours; orange: the paper's; grey: others."
_PAPERS = ("as-written", "as-released", "nn", "anfis")
_ROW = 0.19
"""inch, of a row of a picture with a row for each contender"""

CONTENDERS = (
    Column("label", "Contender"),
    Column("rank", "Rank"),
    Column("rms_ratio", "RMS error", "ratio", 3),
    Column("rms_interval", "95 %", "of the ratio", 3),
    Column("cost_ratio", "Cost J", "ratio", 3),
    Column("cost_interval", "95 %", "of the ratio", 3),
    Column("rms_error", "RMS", "m", 2),
    Column("p95_error", "p95", "m", 2),
    Column("max_corner", "Corner", "m", 2),
    Column("steering_rate", "Steering", "rad/s", 2),
    Column("acceleration", "Lateral", "m/s²", 2),
    Column("entry_speed", "3888-2", "km/h", 2),
    Column("failures", "Failed", "runs"),
    Column("runs", "Of", "runs"),
)
CONSOLE = (
    Column("label", "contender"),
    Column("rank", "rank"),
    Column("rms", "RMS e\nratio, 95 %"),
    Column("cost_ratio", "J\nratio", "", 3),
    Column("rms_error", "RMS e", "m", 2),
    Column("failed", "failed"),
    Column("entry_speed", "3888-2", "km/h", "whole"),
)


def side_by_side_result(made: Compared, *, command: str = "", next_step: str = "") -> Result:
    """A side-by-side as a result; its record holds a row of each contender in each profile, and every cell.

    command: the command line that makes it again; next_step: what to do next, with the command.
    """
    tables = made.by_profile
    rows = {profile: profile_rows(made, profile) for profile in tables}
    last = list(tables)[-1]
    return Result(
        kind="side-by-side",
        title=f"Side by side, {made.task.name}: {counted(len(made.task.contenders), 'contender')}, {_driven(made)}",
        answer="\n".join(on_cars(profile, each) for profile, each in tables.items()),
        record=_record(made, rows),
        tables=[
            *(_contenders(profile, rows[profile], each) for profile, each in tables.items()),
            _failed_by_car(made),
            *(_console_table(made, profile, rows[profile]) for profile in tables),
        ],
        notes=_left_out_briefly(made),
        pictures=[_ratios(last, rows[last], tables[last].reference), _work(rows), *_entry_speeds(made)],
        values={
            "profiles": {profile: _standing(rows[profile], each) for profile, each in tables.items()},
            "reference": next(iter(tables.values())).reference, "task": made.task, "driven": _driven(made),
            "ours": _counts([row for each in rows.values() for row in each if _is_ours(row)]),
            "left_out": _left_out(made),
            "contenders": [(name, about_controller(name).words) for name in made.task.contenders],
        },
        command=command,
        next_step=next_step,
    )  # fmt: skip


def colour_of(contender: str) -> str:
    """Of a contender in every picture of the page."""
    return PAPER if contender in _PAPERS else OURS if about_controller(contender).ours else OTHERS


def profile_rows(made: Compared, profile: str) -> list[dict[str, Any]]:
    """The rows of a profile, see `views.standing_rows`, with the mean entry speed over the cars (km/h)."""
    speeds, rows = made.entry_speeds(profile), []
    for row in standing_rows(made.by_profile[profile]):
        entered = speeds.get(row["label"], {})
        rows.append({**row, "entry_speed": 3.6 * sum(entered.values()) / len(entered) if entered else None})
    return rows


def _record(made: Compared, rows: Mapping[str, Sequence[Row]]) -> dict[str, Any]:
    return {
        "name": made.task.name,
        "profiles": dict(rows),
        "left_out": [{**vars(cell), "why": why} for cell, why in made.left_out.items()],
        "absent": made.absent,
        "cells": [
            {**vars(cell), **{k: v for k, v in each.items() if k != "rows"}} for cell, each in made.cells.items()
        ],
    }


# -- what the page says -----------------------------------------------------------------------------------------------
def _driven(made: Compared) -> str:
    return f"{counted(len(set(made.columns['car'])), 'car')}, {counted(len(made.task.roads), 'road')}"


def _is_ours(row: Row) -> bool:
    return about_controller(row["contender"]).ours


def _counts(rows: Sequence[Row]) -> dict[str, int]:
    return {"failures": sum(row["failures"] for row in rows), "runs": sum(row["runs"] for row in rows)}


def _standing(rows: Sequence[Row], table: Comparison) -> dict[str, Any]:
    """Who is first in the RMS error, who is level with it, and the best of the others' controllers."""
    ours, others = [row for row in rows if _is_ours(row)], [row for row in rows if not _is_ours(row)]
    return {
        "first": [row["label"] for row in rows if row["rank"] == 1], "reference": table.reference,
        "other": min(others, key=lambda row: row["rms_ratio"], default=None),
        "ours_failed": sum(row["failures"] for row in ours) if ours else None,
    }  # fmt: skip


def _left_out(made: Compared) -> list[dict[str, Any]]:
    """What was left out and why: a contender in a profile, with its cars, or a whole car."""
    found: dict[tuple[str, str], list[str]] = {}
    for cell, why in made.left_out.items():
        found.setdefault((f"{cell.contender}, profile {cell.profile}", why), []).append(cell.car.partition("/")[0])
    left = [{"what": what, "why": why, "cars": cars} for (what, why), cars in found.items()]
    return left + [{"what": car, "why": why, "cars": []} for car, why in made.absent.items()]


def _left_out_briefly(made: Compared) -> list[str]:
    """For the console: each car, and each contender with the first of the reasons."""
    found: dict[str, list[str]] = {}
    for cell, why in made.left_out.items():
        found.setdefault(cell.contender, []).append(why)
    lines = [f"left out, {car}: {why}" for car, why in made.absent.items()]
    for name, reasons in found.items():
        more = f" And {counted(len(set(reasons)) - 1, 'reason')} more on the page." if len(set(reasons)) > 1 else ""
        lines.append(f"left out in {counted(len(reasons), 'cell')}, {name}: {reasons[0]}{more}")
    return lines


# -- tables -----------------------------------------------------------------------------------------------------------
def _contenders(profile: str, rows: Sequence[Row], table: Comparison) -> ResultTable:
    shown = [
        {**row, "rms_interval": (row["rms_low"], row["rms_high"]), "cost_interval": (row["cost_low"], row["cost_high"])}
        for row in rows
    ]
    note = (
        f"Ratios to {table.reference}: geometric means over cars and roads of means over the noise seeds; cars and "
        "roads are drawn anew in each resample of the interval. A failed run counts as an error of 5 m, and as 25 m² "
        "in J = mean e² + weight of the profile × mean (change of command)². Rank: 1 + the number of others whose "
        "ratio to it has an interval below 1. RMS, p95 (median of the runs) and largest corner error count until a "
        "run's end or failure. Steering: RMS rate of the command. Lateral: largest acceleration of a run as UN R79 "
        "evaluates it, 95th percentile of the runs. 3888-2: highest clean entry speed into the obstacle avoidance, "
        "mean over the cars."
    )
    return ResultTable(profile, f"Contenders in profile {profile}", CONTENDERS, shown, note,
                       alert=where(shown, ["failures"], lambda row: row["failures"] > 0))  # fmt: skip


def _console_table(made: Compared, profile: str, rows: Sequence[Row]) -> ResultTable:
    table = made.by_profile[profile]
    shown = [
        {
            **row, "rms": f"{row['rms_ratio']:.3g} [{row['rms_low']:.2g}-{row['rms_high']:.2g}]",
            "failed": f"{row['failures']}/{row['runs']}",
        }
        for row in rows
    ]  # fmt: skip
    sizes = ((len(table.cars), "car"), (len(table.roads), "road"), (len(made.task.seeds), "noise seed"))
    title = f"{profile}: {', '.join(counted(n, what) for n, what in sizes)}; ratio to {table.reference}"
    return ResultTable(f"console {profile}", title, CONSOLE, shown, brief=True)


def _failed_by_car(made: Compared) -> ResultTable:
    """Failed runs of each contender with each car."""
    cars = list(dict.fromkeys(made.columns["car"].tolist()))
    rows, driven = [], dict[str, list[int]]()
    for profile, table in made.by_profile.items():
        for contender in table.contenders:
            row: dict[str, Any] = {"label": contender, "profile": f"Profile {profile}"}
            for car in cars:
                runs = table.of(contender, "failed")[table.cars.index(car)] if car in table.cars else np.empty(0)
                count = int(np.isfinite(runs).sum())
                row[car] = int(np.nansum(runs)) if count else None
                driven.setdefault(car, []).extend([count] if count else [])
            rows.append(row)
    columns = [Column(car, car.partition("/")[0], f"of {span(np.array(driven[car], dtype=float))}") for car in cars]
    return ResultTable("failed", "Failed runs", [Column("label", "Contender"), *columns], rows, "", "profile",
                       alert=frozenset((i, car) for i, row in enumerate(rows) for car in cars if row[car]))  # fmt: skip


# -- pictures ---------------------------------------------------------------------------------------------------------
def _ratios(profile: str, rows: Sequence[Row], reference: str) -> Picture:
    """A dot and its interval for each contender, the best first."""
    dots = [
        Dot(row["label"], row["rms_ratio"], row["rms_low"], row["rms_high"], colour_of(row["contender"]),
            row["failures"] > 0)
        for row in rows
    ]  # fmt: skip
    label = f"RMS error / that of {reference}"
    caption = f"Profile {profile}: {label}, with 95 % intervals. {COLOURS}"
    panel, size = dots_panel(dots, data_text(label), label, level=1.0)
    return Picture("verdict", caption + notes(dots), [panel], (), "ratios.png", 1, size[1], size)


def _work(rows: Mapping[str, Sequence[Row]]) -> Picture:
    caption = (
        "RMS error against the RMS rate of the steering command; below and to the left is better. Tuned contenders. "
        + COLOURS
    )
    panels = [_work_panel(profile, each) for profile, each in rows.items()]
    return Picture("work", caption, panels, (), "work.png", 2, 3.0)


def _work_panel(profile: str, every: Sequence[Row]) -> Panel:
    rows = [row for row in every if row["tuning"] != "default"] or every
    rates, errors = [row["steering_rate"] for row in rows], [row["rms_error"] for row in rows]
    marks: list[Mark] = []
    for row, rate, error, height in zip(rows, rates, errors, _apart(errors), strict=True):
        colour, at_left = colour_of(row["contender"]), rate > max(rates) / 1.5  # far right: named on its left
        place = (rate / 1.06 if at_left else 1.06 * rate, height)
        marks += [
            Dots([rate], [error], colour),
            Callout(rate, error, data_text(row["contender"]), place, colour, at_left),
        ]
    words = [f"{row['contender']}: {number(row['rms_error'])} m, {number(row['steering_rate'])} rad/s" for row in rows]
    return Panel(
        f"Profile {profile}", Axis("Steering rate (rad/s)", 0.8 * min(rates), 1.6 * max(rates), log=True),
        Axis("RMS error (m)", 0.8 * min(errors), 1.6 * max(errors), log=True), marks, f"{'; '.join(words)}.",
    )  # fmt: skip


def _apart(values: Sequence[float]) -> list[float]:
    """Heights of labels on a logarithmic axis: those of the values, moved up where one would cover another."""
    logs = np.log(values)
    gap = 0.055 * (np.ptp(logs) + math.log(2.0))  # the axis is twice as long as its values reach
    order = np.argsort(logs)
    heights = logs.copy()
    for below, above in itertools.pairwise(order):
        heights[above] = max(heights[above], heights[below] + gap)
    return [float(each) for each in np.exp(heights)]


def _entry_speeds(made: Compared) -> list[Picture]:
    found = {profile: made.entry_speeds(profile) for profile in made.by_profile}
    panels = [_entry_panel(made.by_profile[profile], profile, each) for profile, each in found.items() if each]
    caption = (
        "Highest clean entry speed into the obstacle avoidance of ISO 3888-2, of the worst of three noise seeds; a dot "
        f"for each car, at 0 where no speed was clean, and a bar at their mean. {COLOURS}"
    )
    height = 0.75 + _ROW * max((len(each) for each in found.values()), default=0)
    return [Picture("entry", caption, panels, (), "entry.png", 1, height, (5.2, height))] if panels else []


def _entry_panel(table: Comparison, profile: str, speeds: Mapping[str, Mapping[str, float]]) -> Panel:
    rows = sorted(speeds.items(), key=lambda each: -float(np.mean(list(each[1].values()))))
    marks: list[Mark] = []
    for place, (contender, cars) in enumerate(rows):
        values, colour = 3.6 * np.array(list(cars.values())), colour_of(table.role(contender).controller)
        mean = float(values.mean())
        marks.append(Dots(values, np.full(len(values), place), colour, size=3.5, opacity=0.6))
        marks.append(Polyline([mean, mean], [place - 0.35, place + 0.35], Stroke(colour), 2.0))
    fastest = 3.6 * max(max(cars.values()) for _, cars in rows) or 1.0
    best, cars = rows[0]
    return Panel(
        "", Axis(f"Entry speed (km/h), profile {profile}", -0.02 * fastest, 1.04 * fastest),
        Axis(names=[data_text(contender) for contender, _ in rows]), marks,
        f"Entry speeds in profile {profile}; highest mean: {best}, {number(3.6 * float(np.mean(list(cars.values()))))} "
        "km/h.",
    )  # fmt: skip

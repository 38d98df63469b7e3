"""The page of a side-by-side: who is first where, error against steering work, failures by car, entry speeds."""

from __future__ import annotations

import itertools
import math
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from adaptrack.comparison.table import Comparison
from adaptrack.comparison.views import standing_rows
from adaptrack.control.controllers import about_controller
from adaptrack.results import style
from adaptrack.results.dots import Dot, dots_drawing, notes
from adaptrack.results.page import (
    Cell,
    Drawing,
    Head,
    Panel,
    Picture,
    Section,
    Table,
    Terms,
    Verbatim,
    Verdict,
    printed,
    write_page,
)
from adaptrack.results.words import counted, listed, number, plain
from adaptrack.studies.compare import Compared

OURS, PAPER, OTHERS = style.SERIES[0], style.SERIES[1], style.MUTED
"""Colours of our controllers, the paper's, and all others."""
COLOURS = "Blue: ours; orange: the paper's; grey: others."
_PAPERS = ("as-written", "as-released", "nn", "anfis")
_SHOWN = ("rms_error", "p95_error", "max_corner", "steering_rate", "acceleration")
_ROW = 0.19
"""inch, of a row of a picture with a row for each contender"""


def write_side_by_side(out_dir: str | os.PathLike[str], made: Compared, *, command: str) -> Path:
    """Write the page and its pictures into `out_dir`; return the page's path.

    command: the command line that makes it again.

    Raises
    ------
    StorageError
        When the files cannot be written.
    """
    tables = made.by_profile
    sections = [
        Section("The result", [_verdict(made, tables)]),
        *(Section(f"Profile {profile}", [_table(made, profile, each)]) for profile, each in tables.items()),
        Section("Error against steering work", [_work(tables)]),
        Section("Failed runs by car", [_failures(made)]),
        *_entry_speeds(made),
        *_left_out(made),
        Section("How it was made", [*_how(made), "This command makes it again:", Verbatim(command)]),
    ]
    title = f"Side by side, {made.task.name}: {counted(len(made.task.contenders), 'contender')}, {_driven(made)}"
    return write_page(out_dir, sections, title=title)


def colour_of(contender: str) -> str:
    """Of a contender in every picture of the page."""
    return PAPER if contender in _PAPERS else OURS if about_controller(contender).ours else OTHERS


# -- the first screen -------------------------------------------------------------------------------------------------
def _driven(made: Compared) -> str:
    return f"{counted(len(set(made.columns['car'])), 'car')}, {counted(len(made.task.roads), 'road')}"


def _verdict(made: Compared, tables: dict[str, Comparison]) -> Verdict:
    ours = [row for each in tables.values() for row in standing_rows(each) if _is_ours(row)]
    total, runs = sum(row["failures"] for row in ours), sum(row["runs"] for row in ours)
    entries = [
        *((f"Profile {profile}", _first(each)) for profile, each in tables.items()),
        ("Against", f"{next(iter(tables.values())).reference}; same noise, and {number(made.task.budget)} "
                    "closed loops of tuning for each"),
        ("How sure", f"95 % intervals over {_driven(made)}; {counted(len(made.task.seeds), 'noise seed')}"),
    ]  # fmt: skip
    text = f"Ours failed in {number(total)} of {number(runs)} runs."
    profile, table = list(tables.items())[-1]
    return Verdict(text, Terms(entries), _ratios(profile, table))


def _is_ours(row: dict[str, Any]) -> bool:
    return about_controller(row["contender"]).ours


def _first(table: Comparison) -> str:
    """Who is first in the RMS error, who cannot be told from it, and how the best of the others stands."""
    rows = standing_rows(table)
    first = [row for row in rows if row["rank"] == 1]
    ours, others = [row for row in rows if _is_ours(row)], [row for row in rows if not _is_ours(row)]
    words = f"{listed([row['label'] for row in first])} first"
    if others:
        best = min(others, key=lambda row: row["rms_ratio"])
        words += (
            f"; best of the others: {best['label']}, {number(best['rms_ratio'])} "
            f"[{number(best['rms_low'])}, {number(best['rms_high'])}] times the error of {table.reference}, "
            f"{best['failures']} of {best['runs']} runs failed"
        )
    if ours and others:
        words += f"; ours failed in {sum(row['failures'] for row in ours)}"
    return f"{words}."


def _ratios(profile: str, table: Comparison) -> Picture:
    """A dot and its interval for each contender, the best first."""
    dots = [
        Dot(row["label"], row["rms_ratio"], row["rms_low"], row["rms_high"], colour_of(row["contender"]),
            row["failures"] > 0)
        for row in standing_rows(table)
    ]  # fmt: skip
    label = f"RMS error / that of {table.reference}"
    caption = f"Profile {profile}: {label}, with 95 % intervals. {COLOURS}"
    return Picture(
        caption + notes(dots), [dots_drawing(dots, style.data_text(label), label, level=1.0)], file="ratios.png"
    )


def _named(axes: Axes, labels: Sequence[str]) -> None:
    """Rows from the top, each with its name."""
    axes.set_yticks(np.arange(len(labels)), [style.data_text(label) for label in labels])
    axes.set_ylim(len(labels) - 0.4, -0.6)
    axes.grid(axis="y", visible=False)


def _tall(draw: Callable[[Axes], None], rows: int, words: str) -> Drawing:
    """A panel with a row of text for each of its rows."""
    with style.styled():
        figure = style.ShownFigure(figsize=(5.2, 0.75 + _ROW * rows))
        draw(figure.subplots())
    return Drawing(figure, plain(words))


# -- tables -----------------------------------------------------------------------------------------------------------
def _table(made: Compared, profile: str, table: Comparison) -> Table:
    reference, speeds = table.reference, made.entry_speeds(profile)
    heads = [
        Head("Contender", is_text=True), Head("Rank"), Head("RMS error", "ratio [95 %]"),
        Head("Cost J", "ratio [95 %]"),
        Head("RMS", "m"), Head("p95", "m"), Head("Corner", "m"), Head("Steering", "rad/s"), Head("Lateral", "m/s²"),
        Head("3888-2", "km/h"), Head("Failed", "runs"),
    ]  # fmt: skip
    body: list[Sequence[Cell | str] | str] = []
    for row in standing_rows(table):
        entered = list(speeds.get(row["label"], {}).values())
        body.append([
            row["label"], number(row["rank"]), _with_interval(row, "rms"), _with_interval(row, "cost"),
            *(number(row[name], 2) for name in _SHOWN),
            number(3.6 * float(np.mean(entered)), 2) if entered else "–",
            Cell(f"{number(row['failures'])} of {number(row['runs'])}", warn=row["failures"] > 0),
        ])  # fmt: skip
    note = (
        f"Ratios to {reference}: geometric means over cars and roads of means over the noise seeds; cars and roads are "
        "drawn anew in each resample of the interval. A failed run counts as an error of 5 m, and as 25 m² in J = mean "
        "e² + weight of the profile × mean (change of command)². Rank: 1 + the number of others whose ratio to it has "
        "an interval below 1. RMS, p95 (median of the runs) and largest corner error count until a run's end or "
        "failure. Steering: RMS rate of the command. Lateral: largest acceleration of a run as UN R79 evaluates it, "
        "95th percentile of the runs. "
        "3888-2: highest clean entry speed into the obstacle avoidance, mean over the cars."
    )
    return Table(f"Contenders in profile {profile}", heads, body, note)


def _with_interval(row: dict[str, Any], measure: str) -> str:
    low, mean, high = (number(row[f"{measure}_{which}"]) for which in ("low", "ratio", "high"))
    return f"{mean} [{low}, {high}]"


# -- pictures ---------------------------------------------------------------------------------------------------------
def _panels(tables: dict[str, Comparison], panel: Callable[[str, Comparison], Panel]) -> list[Panel]:
    return [panel(profile, each) for profile, each in tables.items()]


def _work(tables: dict[str, Comparison]) -> Picture:
    panels = _panels(tables, _work_panel)
    caption = (
        "RMS error against the RMS rate of the steering command; below and to the left is better. Tuned contenders. "
        + COLOURS
    )
    return Picture(caption, [each.drawing() for each in panels], (), "work.png", lambda: printed(panels, 2, 3.0))


def _work_panel(profile: str, table: Comparison) -> Panel:
    rows = [row for row in standing_rows(table) if row["tuning"] != "default"]
    rows = rows or standing_rows(table)

    def draw(axes: Axes) -> None:
        heights = _apart([row["rms_error"] for row in rows])
        right = max(row["steering_rate"] for row in rows) / 1.5  # labels of what lies beyond stand on its left
        for row, height in zip(rows, heights, strict=True):
            colour, at = colour_of(row["contender"]), (row["steering_rate"], row["rms_error"])
            axes.plot(*at, "o", color=colour, markersize=5)
            axes.annotate(
                style.data_text(row["contender"]), at, xytext=(at[0] * (1 / 1.06 if at[0] > right else 1.06), height),
                ha="right" if at[0] > right else "left", va="center", fontsize=6.5, color=colour,
                arrowprops={"arrowstyle": "-", "color": colour, "linewidth": 0.4, "shrinkB": 2},
            )  # fmt: skip
        for which in ("x", "y"):
            values = [row["steering_rate" if which == "x" else "rms_error"] for row in rows]
            style.logarithmic(axes, which, (0.8 * min(values), 1.6 * max(values)))
        axes.set(xlabel="Steering rate (rad/s)", ylabel="RMS error (m)")

    words = [f"{row['contender']}: {number(row['rms_error'])} m, {number(row['steering_rate'])} rad/s" for row in rows]
    return Panel(f"Profile {profile}", draw, f"{'; '.join(words)}.")


def _apart(values: Sequence[float]) -> list[float]:
    """Heights of labels on a logarithmic axis: those of the values, moved up where one would cover another."""
    logs = np.log(values)
    gap = 0.055 * (np.ptp(logs) + math.log(2.0))  # the axis is twice as long as its values reach
    order = np.argsort(logs)
    heights = logs.copy()
    for below, above in itertools.pairwise(order):
        heights[above] = max(heights[above], heights[below] + gap)
    return [float(each) for each in np.exp(heights)]


def _failures(made: Compared) -> Table:
    """Failed runs of each contender with each car."""
    cars = list(dict.fromkeys(made.columns["car"].tolist()))
    heads = [Head("Contender", is_text=True), *(Head(car.partition("/")[0]) for car in cars)]
    body: list[Sequence[Cell | str] | str] = []
    for profile, table in made.by_profile.items():
        body.append(f"Profile {profile}")
        for who in table.contenders:
            body.append([who, *(_failed(table, who, car) for car in cars)])
    return Table("Failed runs", heads, body)


def _failed(table: Comparison, who: str, car: str) -> Cell:
    """Of how many runs with a car."""
    runs = table.of(who, "failed")[table.cars.index(car)] if car in table.cars else np.empty(0)
    driven, failed = int(np.isfinite(runs).sum()), int(np.nansum(runs))
    return Cell(f"{number(failed)} of {driven}" if driven else "–", warn=failed > 0)


def _entry_speeds(made: Compared) -> list[Section]:
    found = {profile: made.entry_speeds(profile) for profile in made.by_profile}
    found = {profile: each for profile, each in found.items() if each}
    if not found:
        return []
    drawings = [_entry_drawing(made.by_profile[profile], profile, each) for profile, each in found.items()]
    caption = (
        "Highest clean entry speed into the obstacle avoidance of ISO 3888-2, of the worst of three noise seeds; a dot "
        f"for each car, at 0 where no speed was clean, and a bar at their mean. {COLOURS}"
    )
    return [Section("Entry speeds, ISO 3888-2", [Picture(caption, drawings, file="entry.png")])]


def _entry_drawing(table: Comparison, profile: str, speeds: dict[str, dict[str, float]]) -> Drawing:
    rows = sorted(speeds.items(), key=lambda each: -float(np.mean(list(each[1].values()))))

    def draw(axes: Axes) -> None:
        for place, (who, cars) in enumerate(rows):
            values, colour = 3.6 * np.array(list(cars.values())), colour_of(table.role(who).controller)
            axes.plot(values, np.full(len(values), place), "o", color=colour, markersize=3.5, alpha=0.6)
            axes.plot([values.mean()] * 2, [place - 0.35, place + 0.35], color=colour, linewidth=2.0)
        _named(axes, [who for who, _ in rows])
        fastest = 3.6 * max(max(cars.values()) for _, cars in rows) or 1.0
        axes.set_xlim(-0.02 * fastest, 1.04 * fastest)
        axes.set_xlabel(f"Entry speed (km/h), profile {profile}")

    best, cars = rows[0]
    mean = 3.6 * float(np.mean(list(cars.values())))
    return _tall(draw, len(rows), f"Entry speeds in profile {profile}; highest mean: {best}, {number(mean)} km/h.")


# -- the rest ---------------------------------------------------------------------------------------------------------
def _left_out(made: Compared) -> list[Section]:
    found: dict[str, list[str]] = {}
    for cell, why in made.left_out.items():
        found.setdefault(f"{cell.contender}, profile {cell.profile}: {why}", []).append(cell.car.partition("/")[0])
    told = [(why.partition(": ")[0], f"{why.partition(': ')[2]} ({listed(cars)})") for why, cars in found.items()]
    told += [(car, why) for car, why in made.absent.items()]
    return [Section("Left out", [Terms(told)])] if told else []


def _how(made: Compared) -> list[Any]:
    task = made.task
    words = [(name, about_controller(name).words) for name in task.contenders]
    return [
        "All know the road ahead. Those that know the car are told its file and, of the steering, what the profile "
        "says, which is the truth; informed-from-sheet is told mass and wheelbase alone.",
        Terms(words, "The contenders"),
        Terms(
            [
                ("cars", listed(task.cars)), ("roads", listed(task.roads)),
                ("roads of the search", listed(task.training)),
                ("noise seeds", listed([str(each) for each in task.seeds])),
                ("closed loops of a search", number(task.budget)),
            ],
            "Cars, roads, seeds",
        ),
    ]  # fmt: skip

"""The page on contenders that drove the same roads: the table, the cost on each road, who failed where."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from adaptrack.comparison.table import Comparison
from adaptrack.comparison.views import road_rows
from adaptrack.results import style
from adaptrack.results.comparison_answers import on_roads
from adaptrack.results.dots import Dot, dots_drawing, notes
from adaptrack.results.page import (
    Cell,
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
from adaptrack.results.words import few, number, ratio_with_interval


def write_road_comparison(out_dir: str | os.PathLike[str], made: Comparison, *, title: str, command: str) -> Path:
    """Write the page and its picture into `out_dir`; return the page's path.

    Parameters
    ----------
    title
        Car, profile and roads.
    command
        The command line that makes it again.

    Raises
    ------
    StorageError
        When the files cannot be written.
    """
    rows = road_rows(made)
    sections = [
        Section("Verdict", [_verdict(made, rows)]),
        Section("Compared", [_table(made, rows), _picture(made)]),
        *_failures(rows),
        Section("How it was made", ["This command makes it again:", Verbatim(command)]),
    ]
    return write_page(out_dir, sections, title=f"{few(made.costs, 'contender')}: {title}")


def _verdict(made: Comparison, rows: Sequence[dict[str, Any]]) -> Verdict:
    failed, runs = (sum(row[key] for row in rows) for key in ("failures", "runs"))
    over = f"{len(made.roads)} roads" if len(made.roads) > 1 else "the noise seeds of this one road"
    entries = [
        (row["contender"], f"{_ratio(row, made.reference)}, RMS |e| {number(row['rms_error'])} m")
        for row in sorted(rows, key=lambda row: row["regret_geomean"])[:5]
    ]
    entries += [
        (
            "Against",
            f"cost of {made.reference}; {number(failed)} of {number(runs)} runs failed",
        ),
        ("How sure", f"95 % intervals, bootstrap over {over}"),
    ]
    dots = [
        Dot(row["contender"], row["regret_geomean"], row["regret_low"], row["regret_high"], failed=row["failures"] > 0)
        for row in sorted(rows, key=lambda row: row["regret_geomean"])
    ]
    label = f"Cost J / that of {made.reference}"
    caption = f"{label}, with 95 % intervals.{notes(dots)}"
    drawing = dots_drawing(dots, style.data_text(label), label, level=1.0)
    return Verdict(on_roads(made), Terms(entries), Picture(caption, [drawing]), False)


def _ratio(row: dict[str, Any], reference: str) -> str:
    return "the reference" if row["contender"] == reference else ratio_with_interval(row, " times")


def _table(made: Comparison, rows: Sequence[dict[str, Any]]) -> Table:
    reference = made.reference
    heads = [
        Head("Contender", is_text=True), Head("Cost J", "geometric mean, m²"), Head("Cost", f"/ {reference}"),
        Head("95 % interval"), Head("RMS |e|", "m"), Head("p95 |e|", "m"), Head("Corner", "largest, m"),
        Head("Failed", f"of {number(rows[0]['runs'])}"),
    ]  # fmt: skip
    body: list[list[Cell | str]] = [
        [
            row["contender"], number(row["cost_geomean"]), number(row["regret_geomean"]),
            f"{number(row['regret_low'])} to {number(row['regret_high'])}",
            *(number(row[name]) for name in ("rms_error", "p95_error", "max_corner_error")),
            Cell(number(row["failures"]), warn=row["failures"] > 0),
        ]
        for row in rows
    ]  # fmt: skip
    over = f"the {len(made.roads)} roads" if len(made.roads) > 1 else "the noise seeds of this one road"
    note = (
        "J: mean e² plus the profile's weight of steering; a failed run counts as "
        f"{made.failure.distance**2:g} m². Interval: bootstrap over {over}. Errors count until a run's end "
        "or failure; corner: the outermost corner of the body beyond half its width."
    )
    return Table("Contenders on the same roads", heads, body, note)


def _picture(made: Comparison) -> Picture:
    """Cost of each contender on each road."""
    strokes = style.strokes(made.costs)
    labels = made.roads if len(made.roads) > 1 else [f"seed {seed}" for seed in made.seeds]

    def draw(axes: Axes) -> None:
        places = np.arange(len(labels))
        for who, costs in made.costs.items():
            stroke = strokes[who]
            axes.plot(places, costs, "o", color=stroke.colour, linestyle=stroke.dash, linewidth=0.8, markersize=5)
        axes.set_yscale("log")
        axes.set_xticks(places, [style.data_text(label) for label in labels], rotation=90 if len(labels) > 4 else 0)
        axes.set_xlim(-0.5, len(labels) - 0.5)
        axes.set_ylabel("Cost J (m²)")

    key = [(who, strokes[who]) for who in made.costs]
    words = [f"{who}: {number(costs.min())} to {number(costs.max())} m²" for who, costs in made.costs.items()]
    alone = len(made.roads) == 1
    panel = Panel("Cost", draw, f"{'; '.join(words)}.")
    caption = "Cost J with each noise seed." if alone else "Cost J on each road, mean over the noise seeds."
    return Picture(caption, [panel.drawing()], key, "costs.png", lambda: printed([panel], 1, 4.0, key))


def _failures(rows: Sequence[dict[str, Any]]) -> list[Section]:
    told = [
        (
            f"{row['contender']}, {each['road']}, seed {each['seed']}",
            f"at {each['at']:.1f} s the vehicle {each['because']}",
        )
        for row in rows
        for each in row["failed"]
    ]
    return [Section("Failed runs", [Terms(told)])] if told else []

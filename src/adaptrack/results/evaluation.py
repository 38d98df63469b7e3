"""The result of an evaluation of schedules: their costs on operating points, drives and the paper's tests."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from adaptrack.base.result import Column, Picture, Result, ResultTable, Row, best_entries, select_entries, strict
from adaptrack.base.statistics import binned_geometric_mean
from adaptrack.comparison.table import Comparison
from adaptrack.control.scheduling import VARIABLES, Schedule, SchedulingVariables
from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import Array
from adaptrack.paper.evaluation import BEST_CONSTANT, POINT_OPTIMUM
from adaptrack.results.compare import ratios_picture
from adaptrack.results.marks import ColourScale, speed_map
from adaptrack.results.words import counted, data_text, number, plain, span, title_of

Views = Mapping[str, Mapping[str, Comparison]]
"""Comparisons on "operating points" and "drives" by the knowledge of friction and wind ("exact", "noisy", ...), and on
"tests" by the test."""

CONTENDER_LABELS = {
    "nn": "NN-MPC", "anfis": "ANFIS-MPC", BEST_CONSTANT: "Best constant", "look-up": "Look-up table",
    POINT_OPTIMUM: "Optimum per operating point",
}  # fmt: skip
NOUNS = {"operating points": "operating point", "drives": "drive", "tests": "run"}
EVALUATION_COLUMNS = (
    Column("label", "Contender"),
    Column("cost_geomean", "Cost", "m²", 3),
    Column("regret_geomean", "Regret", "", 4),
    Column("interval", "95 %\ninterval", "", 3),
    Column("regret_p90", "Regret\n90 %", "", 3),
    Column("regret_worst", "Regret\nworst", "", 3),
    Column("failures", "Runs\nfailed"),
    Column("fallback", "Fallback", "% of steps", "percent"),
)
MAPPED = (BEST_CONSTANT, "look-up", "nn", "anfis")
"""Contenders with a map of their regret."""
CEILING = 10.0
"""Higher regrets share a colour."""
CELL_POINTS, MIN_CELLS, MAX_CELLS = 6, 4, 12
"""Operating points that a cell of a map holds on average, and the number of cells along an axis."""
SURFACE_NODES = (64, 44)
"""Number of nodes of a learned surface along its two axes."""
OUTPUT_LABELS = (("$N_p$", "periods"), ("$N_c$", "periods"), (r"$\log_{10} R/Q$", "R/Q in m²/rad²"))


def evaluation_result(views: Views, schedules: Mapping[str, Schedule]) -> Result:
    """An evaluation of schedules as a result; its record holds one row for each contender in each view.

    schedules: by contender; the networks and fuzzy systems are drawn.
    """
    view = next(name for name in ("drives", "operating points", "tests") if views.get(name))
    comparison = next(iter(views[view].values()))
    points = views.get("operating points", {}).get("exact")
    learned = {name: replace(schedules[name], guard=None) for name in ("nn", "anfis") if name in schedules}
    maps = [] if points is None or len(points.where) < CELL_POINTS * MIN_CELLS * MIN_CELLS else [regret_maps(points)]
    return Result(
        kind="evaluation",
        title="Evaluation of schedules",
        answer=headline(comparison, NOUNS[view]),
        record={"rows": view_rows(views)},
        tables=[_table(name, comparisons) for name, comparisons in views.items() if comparisons],
        pictures=[
            ratios_picture(comparison, contender_label), *maps, *([surfaces_picture(learned)] if learned else [])
        ],
        values={
            "runs": counted(_runs(comparison), NOUNS[view]), "reference": contender_label(comparison.reference),
            "views": [name for name in views if views[name]], "ceiling": f"{CEILING:g}",
            "failed_cost": f"{portable.square(comparison.failure.distance):g}",
        },
    )  # fmt: skip


def headline(comparison: Comparison, noun: str) -> str:
    """The cost of the best schedule over that of the best constant."""
    runs = counted(_runs(comparison), noun)
    best = min(comparison.adaptive, key=lambda name: comparison.mean_ratio(name, BEST_CONSTANT), default=BEST_CONSTANT)
    ratio = comparison.ratio(best, BEST_CONSTANT)
    return (
        f"{contender_label(best)}: {number(ratio.mean)} times the cost of the best constant on {runs} "
        f"(95 % interval {number(ratio.low)} to {number(ratio.high)})."
    )


def contender_label(contender: str) -> str:
    """The label of a contender in tables and pictures."""
    return CONTENDER_LABELS.get(contender, contender)


def _runs(comparison: Comparison) -> int:
    return len(comparison.table(comparison.reference))


# -- tables -----------------------------------------------------------------------------------------------------------
def view_rows(views: Views) -> list[dict[str, Any]]:
    """One row for each contender in each view; constant_...: its cost over that of the best constant."""
    return strict(
        [
            {
                "view": view,
                "scenario" if view == "tests" else "perception": name,
                "reference": comparison.reference,
                **row,
                "constant_geomean": ratio.mean,
                "constant_low": ratio.low,
                "constant_high": ratio.high,
            }
            for view, comparisons in views.items()
            for name, comparison in comparisons.items()
            for row in comparison.rows()
            for ratio in [comparison.ratio(row["contender"], BEST_CONSTANT)]
        ]
    )


def _table(view: str, comparisons: Mapping[str, Comparison]) -> ResultTable:
    """The contenders of a view, in groups by the knowledge of friction and wind or by test."""
    rows = [_row(comparison, row, name) for name, comparison in comparisons.items() for row in comparison.rows()]
    picks = {"cost_geomean": min, "regret_geomean": min}
    best = best_entries(rows, picks, "group", lambda row: not row["hindsight"])
    columns = [column for column in EVALUATION_COLUMNS if any(row[column.name] is not None for row in rows)]
    several = "group" if len(comparisons) > 1 else ""
    first = next(iter(comparisons.values()))
    runs = "the paper's two" if view == "tests" else counted(_runs(first), NOUNS[view])
    title = f"{title_of(view)}: {runs}, regret to {contender_label(first.reference).lower()}"
    failed = select_entries(rows, ["failures"], lambda row: row["failures"] > 0)
    return ResultTable(view, title, columns, rows, "", several, best, failed, brief=True)


def _row(comparison: Comparison, row: Row, group: str) -> dict[str, Any]:
    contender = row["contender"]
    single = contender == comparison.reference or row["runs"] == 1
    interval = None if single else (row["regret_low"], row["regret_high"])
    return {
        **row, "label": contender_label(contender), "group": title_of(group), "interval": interval,
        "hindsight": comparison.role(contender).hindsight, "fallback": row.get("fallback"),
    }  # fmt: skip


# -- pictures ---------------------------------------------------------------------------------------------------------
def regret_maps(comparison: Comparison) -> Picture:
    """The regret of the main contenders over speed and friction, and over speed and the lateral reference."""
    speed, y_ref, friction = comparison.where[:, 0], np.abs(comparison.where[:, 1]), comparison.where[:, 2]
    quantities = {"friction": (friction, "Friction (–)"), "lateral reference": (y_ref, r"$|y_\mathrm{ref}|$ (m)")}
    contenders = [name for name in MAPPED if name in comparison.contenders and name != comparison.reference]
    count = int(np.clip(math.sqrt(len(speed) / CELL_POINTS), MIN_CELLS, MAX_CELLS))
    maps = {
        (name, quantity): binned_geometric_mean(comparison.regret(name), speed, values, count)
        for name in contenders
        for quantity, (values, _) in quantities.items()
    }
    means = np.concatenate([values.ravel() for _, _, values in maps.values()])
    low, high = min(1.0, float(np.nanmin(means))), float(np.nanmax(means))
    beyond = "max" if high > CEILING else "neither"
    scale = ColourScale(low, max(min(high, CEILING), 1.2 * low), log=True, beyond=beyond)  # type: ignore[arg-type]
    panels = [
        speed_map(data_text(contender_label(name)), edges, cells, scale, quantities[quantity][1],
                  f"Geometric mean regret over speed and {quantity}: {span(cells)}.")
        for (name, quantity), (*edges, cells) in maps.items()
    ]  # fmt: skip
    return Picture("maps", "", panels, file="regret-map.png", row_height=1.75)


def surfaces_picture(schedules: Mapping[str, Schedule]) -> Picture:
    """The tuning of schedules without guard over speed and their second input."""
    surfaces = {name: _surface(schedule) for name, schedule in schedules.items()}
    panels = []
    for k, (symbol, unit) in enumerate(OUTPUT_LABELS):
        scale = shared_scale([surface[..., k] for surface in surfaces.values()], integer=k < 2)
        for name, schedule in schedules.items():
            axis = VARIABLES[schedule.inputs[1]]
            title, cells = f"{data_text(contender_label(name))}: {symbol} ({unit})", surfaces[name][..., k]
            words = f"{plain(symbol)} over speed and {axis.label.lower()}: {span(cells)}."
            edges = schedule.domain[:2]
            panels.append(speed_map(title, edges, cells, scale, f"{axis.label} ({axis.unit})", words, image=True))
    columns = len(schedules) if len(schedules) > 1 else len(OUTPUT_LABELS)
    return Picture("surfaces", "", panels, file="surfaces.png", columns=columns, row_height=2.1)


def shared_scale(values: Sequence[Array], integer: bool) -> ColourScale:
    """A scale from the lowest to the highest value, with half a unit on either side if all are equal."""
    everything = np.concatenate([part.ravel() for part in values])
    low, high = float(np.nanmin(everything)), float(np.nanmax(everything))
    margin = 0.0 if high > low else 0.5
    return ColourScale(low - margin, high + margin, integer=integer)


def _surface(schedule: Schedule) -> Array:
    """(nodes of the second input, nodes of speed, 3) outputs, the other inputs in the middle of their domain."""
    columns, rows = SURFACE_NODES
    points = np.tile(schedule.domain.mean(axis=1), (rows, columns, 1))
    (slowest, fastest), (low, high) = schedule.domain[:2].tolist()
    points[..., 0] = np.linspace(slowest, fastest, columns)
    points[..., 1] = np.linspace(low, high, rows)[:, np.newaxis]
    Np, Nc, Q, R = tune_at(schedule, points.reshape(rows * columns, -1)).T
    return np.column_stack([Np, Nc, portable.log10(R / Q)]).reshape(rows, columns, 3)


def tune_at(schedule: Schedule, points: Array) -> Array:
    """The tuning of a schedule at values of its inputs (n, inputs), a row each."""
    variables = np.zeros((len(points), len(SchedulingVariables._fields)))
    variables[:, [SchedulingVariables._fields.index(name) for name in schedule.inputs]] = points
    return schedule.batch(variables)

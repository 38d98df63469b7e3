"""Result of a data set of tuned operating points: ranges, optimum, costs, and how flat the optimum is.

Statistics are over the operating points that a swarm searched, as in `data_set_summary.describe`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from adaptrack.base.result import Column, Panel, Picture, Result, ResultTable, Row
from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import Array
from adaptrack.paper.campaign_config import STANDARD_ROW
from adaptrack.paper.data_set import DataSet, describe
from adaptrack.results import marks
from adaptrack.results.words import number, span

BINS = 12
"""Bins along an axis whose values are not levels."""
MAX_LEVELS = 15
"""Largest number of distinct values that each get a bin."""
BARS = 28

QUANTILE_COLUMNS = (
    Column("lowest", "Lowest", show=3),
    Column("p10", "P10", show=3),
    Column("p50", "Median", show=3),
    Column("p90", "P90", show=3),
    Column("highest", "Highest", show=3),
)
RANGE_COLUMNS = (
    Column("quantity", "Quantity"),
    Column("unit", "Unit"),
    Column("lowest", "Lowest", show=3),
    Column("highest", "Highest", show=3),
    Column("levels", "Distinct values"),
)
OPTIMUM_COLUMNS = (Column("target", "Target"), *QUANTILE_COLUMNS, Column("at_a_bound", "At a bound", "%", "percent"))
FLATNESS_COLUMNS = (
    Column("within", "Within", "% of best", "percent"),
    *(Column(column.name, column.title, "%", "percent") for column in QUANTILE_COLUMNS),
)


@dataclass(frozen=True)
class TuningTarget:
    """A number of the best tuning, with its values for a picture."""

    label: str
    values: Array
    """(n,) value of each operating point"""
    standard: float
    integer: bool = False


def dataset_result(dataset: DataSet) -> Result:
    """A data set as a result; its record is the summary of `data_set_summary.describe`."""
    summary = describe(dataset)
    gain = summary["costs"]["standard_over_best_geomean"]
    return Result(
        kind="dataset",
        title=f"Data set {dataset.name}",
        answer=f"{dataset.name}: {number(len(dataset))} operating points; standard tuning over the best: "
        f"{'unknown' if gain is None else number(gain)} (geometric mean of the costs).",
        record=summary,
        tables=_tables(summary),
        pictures=_pictures(dataset),
        notes=["Only R/Q changes the control law: Q and R alone are where a swarm stopped along a line of equal cost."],
        command=dataset.command,
    )  # fmt: skip


def _pictures(dataset: DataSet) -> list[Picture]:
    """Pictures of gain, optimum and spread; none if every run failed."""
    rows = comparable_rows(dataset)
    if rows is None:
        return []
    return [
        Picture("gain", "Cost of the standard tuning over the swarm's best, by speed: median and quartiles.",
                [gain_panel(rows)], file="gain.png"),
        Picture("optimum", "The best tuning over the operating points: each cell is a median.",
                optimum_maps(rows), file="optimum.png", columns=3),
        Picture("targets", "How often each value is the best. Dashed: the standard tuning.",
                [histogram(target) for target in targets(rows)], file="targets.png", columns=3),
    ]  # fmt: skip


def comparable_rows(dataset: DataSet) -> DataSet | None:
    """The rows that a swarm searched and whose costs can be compared; None without any."""
    chosen = dataset.computed & dataset.comparable
    return dataset.rows(chosen) if chosen.any() else None


# -- tables -----------------------------------------------------------------------------------------------------------
def _tables(summary: dict[str, Any]) -> list[ResultTable]:
    names = (Column("name", "Name"), Column("value", "Value"))
    scalars = {key: value for key, value in summary.items() if not isinstance(value, dict | list)}
    optimum = [_without_logarithm(row) for row in summary["optimum"]]
    return [
        ResultTable("data set", "Data set", names, _named_rows(scalars), brief=True),
        ResultTable("costs", "Costs", names, _named_rows(summary["costs"]), brief=True),
        ResultTable("ranges", "Ranges of the operating points", RANGE_COLUMNS, summary["ranges"], brief=True,
                    note="Positive is to the left, also for wind."),
        ResultTable("optimum", "The best tunings", OPTIMUM_COLUMNS, optimum, brief=True,
                    note="Np, Nc in control periods, Q in 1/m², R in 1/rad²."),
        ResultTable("flatness", "Share of the library whose cost is near the best", FLATNESS_COLUMNS,
                    summary["flatness"], brief=True),
    ]  # fmt: skip


def _named_rows(values: dict[str, Any]) -> list[Row]:
    return [{"name": name.replace("_", " "), "value": value} for name, value in values.items()]


def _without_logarithm(row: Row) -> Row:
    if not row["target"].startswith("log "):
        return row
    values = {column.name: row[column.name] for column in QUANTILE_COLUMNS}
    linear = {name: None if value is None else float(portable.exp(value)) for name, value in values.items()}
    return {**row, **linear, "target": row["target"].removeprefix("log ")}


# -- panels -----------------------------------------------------------------------------------------------------------
def targets(rows: DataSet) -> list[TuningTarget]:
    """Horizons and R/Q of the best tunings."""
    Np, Nc, Q, R = STANDARD_ROW
    return [
        TuningTarget("$N_p$ (periods)", rows.tunings[:, 0], Np, integer=True),
        TuningTarget("$N_c$ (periods)", rows.tunings[:, 1], Nc, integer=True),
        TuningTarget(r"$\log_{10} R/Q$ (m²/rad²)", portable.log10(rows.ratios), float(portable.log10(R / Q))),
    ]


def histogram(target: TuningTarget) -> Panel:
    """A histogram of the best values of a target."""
    values = np.append(target.values, target.standard)
    low, high = float(values.min()), float(values.max())
    if target.integer:
        edges = np.arange(low - 0.5, high + 1.0, max(1, round((high - low) / BARS)))
    else:
        edges = np.linspace(low, high + 1e-9, BARS + 1)
    counts, _ = np.histogram(target.values, edges)

    def draw(axes: marks.Axes) -> None:
        shares = 100.0 * counts / target.values.size
        axes.bar((edges[:-1] + edges[1:]) / 2.0, shares, 0.9 * np.diff(edges), color=marks.SERIES[0])
        axes.grid(False, axis="x")
        axes.axvline(target.standard, linewidth=1.0, **marks.REFERENCE_STROKE)
        axes.set(xlabel=target.label, ylabel="Operating points (%)")
        axes.margins(x=0.03)

    return Panel(target.label, draw, f"Share of the operating points in percent; values {span(target.values)}.")


def gain_panel(rows: DataSet) -> Panel:
    """Cost of the standard tuning over the cost of the swarm's best, by speed."""
    speed, gain = rows.operating_points[:, 0], rows.standard_costs / rows.costs
    bins = _bin_numbers(speed, _bin_edges(speed))
    by_bin = [bins == chosen for chosen in np.unique(bins)]
    middles = [float(np.median(speed[members])) for members in by_bin]
    low, median, high = np.array([np.quantile(gain[members], (0.25, 0.5, 0.75)) for members in by_bin]).T

    def draw(axes: marks.Axes) -> None:
        axes.axhline(1.0, linewidth=0.7, **marks.BACKGROUND_STROKE)
        axes.fill_between(middles, low, high, color=marks.SERIES[0], **marks.BAND)
        axes.plot(middles, median, color=marks.SERIES[0], marker="o", markersize=3.5)
        axes.set(xlabel="Speed (m/s)", ylabel="Cost ratio (–)")
        axes.margins(x=0.02)
        bottom, top = marks.include_y(axes, 1.0)
        marks.set_log_scale(axes, "y", (bottom if bottom > 0.0 else min(1.0, low.min()) / 1.1, top))

    description = f"Cost of the standard tuning over the swarm's best, by speed: medians {span(median)}."
    return Panel("Standard over best", draw, description)


def optimum_maps(rows: DataSet) -> list[Panel]:
    """Medians of each target over speed and lateral reference, then over speed and friction."""
    across = {
        r"$|y_\mathrm{ref}|$ (m)": np.abs(rows.operating_points[:, 1]),
        "Friction (–)": rows.operating_points[:, 2],
    }
    return [_map(rows, target, label, values) for label, values in across.items() for target in targets(rows)]


def _map(rows: DataSet, target: TuningTarget, label: str, values: Array) -> Panel:
    speed = rows.operating_points[:, 0]
    x_edges, y_edges = _bin_edges(speed), _bin_edges(values)
    columns, lines = _bin_numbers(speed, x_edges), _bin_numbers(values, y_edges)
    medians = np.full((len(y_edges) - 1, len(x_edges) - 1), np.nan)
    for line, column in set(zip(lines.tolist(), columns.tolist(), strict=True)):
        medians[line, column] = np.median(target.values[(lines == line) & (columns == column)])
    low, high = float(target.values.min()), float(target.values.max())
    scale = marks.ColourScale(low, high if high > low else low + 1.0, integer=target.integer)

    return marks.speed_map(target.label, (x_edges, y_edges), medians, scale, label, f"Medians {span(medians)}.")


def _bin_edges(values: Array) -> Array:
    """Edges around each of a few levels, else of equal widths."""
    levels = np.unique(values)
    return marks.edges_around(levels) if len(levels) <= MAX_LEVELS else np.linspace(levels[0], levels[-1], BINS + 1)


def _bin_numbers(values: Array, edges: Array) -> NDArray[np.int64]:
    return np.clip(np.searchsorted(edges, values, side="right") - 1, 0, len(edges) - 2)

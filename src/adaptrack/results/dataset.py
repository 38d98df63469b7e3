"""The result on a data set of tuned operating points: its optimum in pictures, what explains it, how flat it is.

Statistics are over those that a swarm searched, as in `dataset.describe`: left-right twins would count twice.
"""

from __future__ import annotations

import json
import os
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from adaptrack.base.errors import InvalidInput
from adaptrack.base.result import (
    REFERENCE,
    Axis,
    Bars,
    Column,
    Guide,
    HeatMap,
    Mark,
    Panel,
    Picture,
    Polyline,
    Result,
    ResultTable,
    Ribbon,
    Scale,
    Stroke,
    strokes,
    where,
)
from adaptrack.base.statistics import ratio
from adaptrack.results.answers import of_dataset
from adaptrack.results.maps import Cells, edges_around
from adaptrack.results.notebook import html
from adaptrack.results.words import counted, number, percent, span
from adaptrack.results.words import describe as in_words
from adaptrack.tuning.config import STANDARD
from adaptrack.tuning.dataset import DataSet, describe, flatness

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]
Summary = Mapping[str, Any]

_CELLS, _LEAST_CELLS, _PER_CELL = 12, 4, 4
"""Bins along an axis whose values are not a few levels: at most, at least; and operating points of a cell, about."""

_LEVELS = 15
"""Up to this many distinct values are levels, each with a bin of its own."""

_BARS = 28
_WEAK, _STRONG = 0.15, 0.5
"""R^2 below which a target counts as hardly explained, and from which as largely explained."""

_QUANTITIES = {"speed": "Speed", "y_ref": "Lateral reference", "friction": "Friction", "wind": "Side wind"}
_LISTED = ("vehicle", "tyre", "plant", "profile", "scenario", "duration", "move_weight", "noise_seeds")

_STANDARD = "Standard tuning"
_SWARM = "Swarm's best"
_LIBRARY = "Library's best"
_STROKES = strokes((_STANDARD, _SWARM, _LIBRARY))
_UNITS = {"duration": " s a run", "move_weight": " m²/rad²"}

RANGES = (
    Column("label", "Quantity"),
    Column("unit", "Unit"),
    Column("lowest", "Lowest", show=3),
    Column("highest", "Highest", show=3),
    Column("levels", "Distinct values"),
)
OPTIMUM = (
    Column("target", "Target"),
    Column("lowest", "Lowest", show=3),
    Column("p10", "P10", show=3),
    Column("p50", "Median", show=3),
    Column("p90", "P90", show=3),
    Column("highest", "Highest", show=3),
    Column("at_a_bound", "At a bound", "%", "percent"),
    Column("r2", "R²", show=2),
)
FLATNESS = (
    Column("limit", "Within"),
    Column("mean", "Mean", "%", "percent"),
    Column("lowest", "Lowest", "%", "percent"),
    Column("p10", "P10", "%", "percent"),
    Column("p50", "Median", "%", "percent"),
    Column("p90", "P90", "%", "percent"),
    Column("highest", "Highest", "%", "percent"),
)


@dataclass(frozen=True)
class _Target:
    """A part of the optimum, as pictures show it."""

    name: str
    symbol: str
    unit: str
    values: Array
    """(n,)"""
    standard: float
    whole: bool = False
    decades: bool = False

    @property
    def label(self) -> str:
        return f"{self.symbol} ({self.unit})"


def dataset_result(dataset: DataSet, summary: Summary | None = None) -> Result:
    """A data set as a result; its record is what `adaptrack.tuning.dataset.describe` says of it.

    Parameters
    ----------
    summary
        That description; computed when left out, which takes some seconds.
    """
    summary = _summary(dataset) if summary is None else summary
    rows = dataset.rows(dataset.computed)
    found = rows.rows(kept) if (kept := np.isfinite(rows.costs)).any() else None
    both = _compared(rows)
    worth = ratio(rows.standard_costs[both], rows.costs[both]) if both.any() else None
    return Result(
        kind="dataset",
        title=_title(dataset, summary),
        answer=of_dataset(summary),
        record=summary,
        tables=[*_tables(dataset, summary), *_console_tables(summary)],
        pictures=[
            *([Picture("verdict", "How many times the swarm's best the standard tuning costs, by speed: median, band "
                       "between the quartiles.", [_gain(rows, both, "Standard tuning over the swarm's best")])]
              if both.any() else []),
            *(_optimum(found, summary) if found is not None else []),
            *_costs(rows),
            *(_convergence(found) if found is not None else []),
            *_flatness(dataset, summary),
        ],
        values={
            "summary": summary, "costs": summary["costs"], "worth": worth, "compared": int(both.sum()),
            "command": dataset.command,
            "near": [row for row in summary["flatness"] if row["p50"] is not None], "searched": len(rows),
            "about": [(key.replace("_", " ").capitalize(), in_words(summary[key]) + _UNITS.get(key, ""))
                      for key in _LISTED if summary.get(key) is not None],
            "standard": "/".join(f"{value:g}" for value in STANDARD), "library": len(dataset.library),
            "swarms": None if found is None else _generations(found), "explained": explained(summary),
            "provenance": json.dumps(dataset.provenance, indent=1, ensure_ascii=False),
            "identity": in_words(summary["identity"]),
            "versions": [(name, in_words(version)) for name, version in summary["versions"].items()],
        },
    )  # fmt: skip


def write_dataset_report(out_dir: str | os.PathLike[str], dataset: DataSet, *, summary: Summary | None = None) -> Path:
    """Write the page on a data set and its PNG files into `out_dir`; return the page's path.

    Parameters
    ----------
    summary
        What `adaptrack.tuning.dataset.describe` said of it; computed when left out, which takes some seconds.

    Raises
    ------
    StorageError
        When the files cannot be written, see `page.write_result`.
    """
    from adaptrack.results.page import write_result

    return write_result(out_dir, dataset_result(dataset, summary))


def dataset_figure(dataset: DataSet) -> Figure:
    """How often each tuning is the best, and how many times the best the standard tuning costs, by speed.

    Raises
    ------
    InvalidInput
        When no swarm found a tuning with which the run did not fail.
    """
    from adaptrack.results.draw import print_figure

    rows = dataset.rows(dataset.computed)
    found = rows.rows(np.isfinite(rows.costs))
    if not len(found):
        raise InvalidInput(f"data set {dataset.name!r}: no swarm found a tuning, so there is nothing to draw.")
    panels = [
        _histogram(each, (float(each.values.min()), float(each.values.max())))
        for each in _targets(found) if each.name in ("Np", "Nc", "log R/Q")
    ]  # fmt: skip
    both = _compared(found)
    if both.any():
        panels.append(_gain(found, both, "Standard over the best"))
    return print_figure(Picture("dataset", "", panels, row_height=2.1))


def dataset_html(dataset: DataSet) -> str:
    """What a notebook shows of a data set."""
    searched = dataset.rows(dataset.computed)
    rows = {
        "Operating points": f"{number(len(dataset))}, {number(len(searched))} of them searched by swarms",
        "Library": counted(len(dataset.library), "common tuning"),
        **{
            _QUANTITIES[name]: span(values)
            for name, values in zip(_QUANTITIES, dataset.operating_points.T, strict=True)
        },
        "Failed with every tuning": number(int((~np.isfinite(searched.costs)).sum())),
    }
    figure = dataset_figure(dataset) if np.isfinite(searched.costs).any() else None
    return html(f"Data set {dataset.name}", rows, figure, "The best tunings, and what they are worth")


def _summary(dataset: DataSet) -> Summary:
    with warnings.catch_warnings():
        if not len(dataset.library):  # shares of nothing are not numbers, which numpy warns of
            warnings.simplefilter("ignore", RuntimeWarning)
        from adaptrack.learning.boosting import explained_shares  # here: scikit-learn takes a second to load

        return describe(dataset, explained_shares(dataset))


def _title(dataset: DataSet, summary: Summary) -> str:
    about = [f"{key} {summary[key]}" for key in ("vehicle", "profile") if isinstance(summary.get(key), str)]
    about += [str(summary["scenario"])] if isinstance(summary.get("scenario"), str) else []
    return f"Data set {dataset.name}: {', '.join(about)}" if about else f"Data set {dataset.name}"


# -- tables -----------------------------------------------------------------------------------------------------------
def _tables(dataset: DataSet, summary: Summary) -> list[ResultTable]:
    ranges = [
        {**row, "label": _QUANTITIES.get(row["quantity"], row["quantity"]), "unit": row["unit"].replace("-", "–")}
        for row in summary["ranges"]
    ]
    optimum = []
    for row in summary["optimum"]:
        logarithmic = row["target"].startswith("log ")
        values = {key: row[key] for key in ("lowest", "p10", "p50", "p90", "highest")}
        shown = {key: float(np.exp(v)) if logarithmic and v is not None else v for key, v in values.items()}
        optimum.append({**row, **shown, "target": row["target"].removeprefix("log ")})
    near = [{**row, "limit": f"{100 * row['within']:g} %"} for row in summary["flatness"] if row["mean"] is not None]
    weak = where(optimum, ["r2"], lambda row: row["r2"] is not None and row["r2"] < _WEAK)
    return [
        ResultTable("ranges", "Ranges of the operating points", RANGES, ranges,
                    "Positive is to the left, also for wind."),
        ResultTable("optimum", "The optimum, and how much of it the operating points explain", OPTIMUM, optimum,
                    "Np, Nc in control periods, Q in 1/m², R in 1/rad². P10 and P90: a tenth of all points lies below, "
                    f"above. R²: {summary['learner']}; for Q, R and R/Q of the logarithm.", alert=weak),
        ResultTable("flatness", "Share of the library whose cost is near the best", FLATNESS, near,
                    f"Of {counted(summary['library'], 'tuning')}, at each operating point; the best is the lowest cost "
                    "known there, the swarm's or the library's."),
    ]  # fmt: skip


def _console_tables(summary: Summary) -> list[ResultTable]:
    """What was described, as it is: names and values, then a table for each part."""
    names = (Column("what", "what"), Column("value", "value"))
    scalars = {key: value for key, value in summary.items() if not isinstance(value, dict | list)}
    parts: list[tuple[str, Any]] = [(str(summary["name"]), scalars)]
    parts += [(key.replace("_", " "), value) for key, value in summary.items() if isinstance(value, dict | list)]
    tables = []
    for title, value in parts:
        if isinstance(value, dict):
            rows = [{"what": what.replace("_", " "), "value": entry} for what, entry in value.items()]
            tables.append(ResultTable(f"console {title}", title, names, rows, brief=True))
        elif value and isinstance(value[0], dict):
            columns = [Column(key, key.replace("_", " ")) for key in value[0]]
            tables.append(ResultTable(f"console {title}", title, columns, value, brief=True))
    return tables


# -- what the page says -----------------------------------------------------------------------------------------------
def explained(summary: Summary) -> dict[str, list[str]]:
    """The targets that operating points largely, partly and hardly explain; empty where that is not known."""
    known = {row["target"].removeprefix("log "): row["r2"] for row in summary["optimum"] if row["r2"] is not None}
    groups = {
        "largely explained": [name for name, r2 in known.items() if r2 >= _STRONG],
        "partly explained": [name for name, r2 in known.items() if _WEAK <= r2 < _STRONG],
        "hardly explained, if at all": [name for name, r2 in known.items() if r2 < _WEAK],
    }
    return {words: names for words, names in groups.items() if names}


def _above(found: DataSet) -> Array | None:
    """Lower quartile, median, upper quartile of each generation's cost over the last, (3, n); None without traces."""
    last = found.traces[:, -1:].astype(np.float64) if found.traces.shape[1] else np.empty((0, 1))
    usable = np.flatnonzero(np.isfinite(last[:, 0]) & (last[:, 0] > 0.0)) if last.size else np.empty(0, int)
    if not usable.size:
        return None
    return _quantiles(found.traces[usable].astype(np.float64) / last[usable], (0.25, 0.5, 0.75))


def _generations(found: DataSet) -> dict[str, Any] | None:
    """How far the median swarm is above its last cost, after the first and half of the generations."""
    above = _above(found)
    if above is None:
        return None
    middle, half = above[1], above.shape[1] // 2
    later = (half + 1, _percent_above(middle[half])) if len(middle) > 2 else None
    return {"first": _percent_above(middle[0]), "later": later}


def _percent_above(ratio: float) -> str:
    if not np.isfinite(ratio):
        return "infinitely far above"
    return f"{number(ratio)} times" if ratio >= 2.0 else f"{percent(max(ratio - 1.0, 0.0))} % above"


def _range_of(values: Array) -> str:
    return f"{span(values)}, median {number(float(np.median(values)))}" if values.size else "none"


def _targets(found: DataSet) -> list[_Target]:
    Np, Nc, Q, R = found.tunings.T
    np_, nc, q, r = STANDARD
    return [
        _Target("Np", "$N_p$", "periods", Np, np_, whole=True),
        _Target("Nc", "$N_c$", "periods", Nc, nc, whole=True),
        _Target("log R/Q", r"$\log_{10} R/Q$", "R/Q in m²/rad²", np.log10(R / Q), np.log10(r / q)),
        _Target("log Q", "$Q$", "1/m²", Q, q, decades=True),
        _Target("log R", "$R$", "1/rad²", R, r, decades=True),
    ]


def _limits(summary: Summary, target: _Target) -> tuple[float, float]:
    """The lowest and the highest value of a target that occurs."""
    row = next(row for row in summary["optimum"] if row["target"] == target.name)
    if not target.name.startswith("log"):
        return float(row["lowest"]), float(row["highest"])
    scale = 1.0 if target.decades else 1.0 / np.log(10.0)
    low, high = scale * row["lowest"], scale * row["highest"]
    return (float(np.exp(low)), float(np.exp(high))) if target.decades else (float(low), float(high))


def _edges(values: Array) -> Array:
    """Edges of bins: around each of a few levels, else of equal widths."""
    levels = np.unique(values)
    if len(levels) > _LEVELS:
        cells = int(np.clip(np.sqrt(len(values) / _PER_CELL), _LEAST_CELLS, _CELLS))
        return np.linspace(levels[0], levels[-1], cells + 1)
    return edges_around(levels)


def _bins(values: Array, edges: Array) -> NDArray[np.int64]:
    return np.clip(np.searchsorted(edges, values, side="right") - 1, 0, len(edges) - 2)


def _binned(found: DataSet, other: Array, target: _Target) -> Cells:
    speed = found.operating_points[:, 0]
    x_edges, y_edges = _edges(speed), _edges(other)
    columns, rows = _bins(speed, x_edges), _bins(other, y_edges)
    medians = np.full((len(y_edges) - 1, len(x_edges) - 1), np.nan)
    for row, column in set(zip(rows.tolist(), columns.tolist(), strict=True)):
        medians[row, column] = np.median(target.values[(rows == row) & (columns == column)])
    return Cells(x_edges, y_edges, medians)


def _positive(values: Array) -> Array:
    """What has a place on a logarithmic axis, in order."""
    return np.sort(values[np.isfinite(values) & (values > 0.0)])


def _quantiles(values: Array, levels: Sequence[float]) -> Array:
    """Down the columns, without averaging two neighbours: one of them may be infinite."""
    return np.asarray(np.quantile(values, levels, axis=0, method="inverted_cdf"))


def _compared(rows: DataSet) -> NDArray[np.bool_]:
    """Where the standard tuning and the swarm's best have costs whose ratio means something."""
    standard, best = rows.standard_costs, rows.costs
    return np.isfinite(standard) & (standard > 0) & np.isfinite(best) & (best > 0)


# -- pictures ---------------------------------------------------------------------------------------------------------
def _gain(rows: DataSet, both: NDArray[np.bool_], title: str) -> Panel:
    """How many times the swarm's best the standard tuning costs, by speed."""
    speed, gain = rows.operating_points[both, 0], rows.standard_costs[both] / rows.costs[both]
    edges = _edges(speed)
    bins = _bins(speed, edges)
    which = np.unique(bins)
    middles = np.array([np.median(speed[bins == b]) for b in which])
    low, middle, high = np.stack([_quantiles(gain[bins == b], (0.25, 0.5, 0.75)) for b in which], axis=1)
    marks = [Guide("y", [1.0], width=0.7), *_band(middles, low, middle, high)]
    return Panel(
        title, Axis("Speed (m/s)", margin=0.02), _ratios("Cost ratio (–)", float(low.min()), float(high.max())), marks,
        f"Cost of the standard tuning over the swarm's best, by speed: {_range_of(gain)}.",
    )  # fmt: skip


def _optimum(found: DataSet, summary: Summary) -> list[Picture]:
    targets = _targets(found)
    maps = [target for target in targets if target.name in ("Np", "Nc", "log R/Q")]
    over = {
        "lateral reference": (np.abs(found.operating_points[:, 1]), r"$|y_\mathrm{ref}|$ (m)"),
        "friction": (found.operating_points[:, 2], "Friction (–)"),
    }
    panels: dict[tuple[str, str], Panel] = {}
    for target in maps:
        cells = {other: _binned(found, values, target) for other, (values, _) in over.items()}
        everything = np.concatenate([each.values.ravel() for each in cells.values()])
        low, high = float(np.nanmin(everything)), float(np.nanmax(everything))
        low, high = (low, high) if high > low else (low - 0.5, high + 0.5)
        for other, (_, label) in over.items():
            own = cells[other]
            heat = HeatMap(own.x_edges, own.y_edges, own.values, Scale(low, high, whole=target.whole))
            text = f"Median over speed and {other}: {span(own.values)}."
            panels[target.name, other] = Panel(target.label, Axis("Speed (m/s)"), Axis(label), [heat], text)
    caption = (
        "The best tuning over the operating points. Each cell is the median over all that lie in it, whatever their "
        "other two numbers; empty cells hold none. Both maps of a target have the same colours."
    )
    tuning = zip(("Np", "Nc", "Q", "R"), STANDARD, strict=True)
    spread = "How often each value is the best. Dashed: the standard tuning, " + ", ".join(
        f"{name} = {value:g}" for name, value in tuning
    )
    return [
        Picture("optimum", caption, list(panels.values()), file="optimum.png", columns=3,
                print_panels=[panels[target.name, other] for other in over for target in maps]),
        Picture("targets", f"{spread}.", [_histogram(each, _limits(summary, each)) for each in targets],
                file="targets.png", columns=3, row_height=1.75),
    ]  # fmt: skip


def _costs(rows: DataSet) -> list[Picture]:
    curves = {_STANDARD: rows.standard_costs, _SWARM: rows.costs}
    if len(rows.library):
        curves[_LIBRARY] = rows.landscape.min(axis=1).astype(np.float64)
    usable = {name: values for name, values in curves.items() if _positive(values).size}
    if not usable:
        return []
    panels = [cumulative(usable)]
    both = _compared(rows)
    if both.any():
        panels.append(_gain(rows, both, "Standard over optimum"))
    caption = (
        "Left: the share of operating points that cost at most so much; further left is better. A curve that ends "
        "below 100 % failed in the rest. Right: how many times the optimum the standard tuning costs, by speed: "
        "median, with a band from the lower to the upper quartile."
    )
    return [Picture("cost", caption, panels, [(name, _STROKES[name]) for name in usable], "cost.png", row_height=2.4)]


def cumulative(costs: Mapping[str, Array]) -> Panel:
    """The share of operating points that cost at most so much."""
    marks: list[Mark] = []
    for i, (name, values) in enumerate(costs.items()):
        placed = _positive(values)
        share = 100.0 * ((values <= 0.0).sum() + np.arange(1, placed.size + 1)) / values.size
        width = 1.3 + (0.9 if i == 1 else 0.0)  # the library's best may lie on the swarm's
        marks.append(Polyline(placed, share, _STROKES[name], width, "post"))
    ranges = " ".join(f"{name}: {_range_of(_positive(values))}." for name, values in costs.items())
    return Panel(
        "Cost of one run", Axis("Cost (m²)", log=True), Axis("Operating points (%)", 0.0, 103.0), marks,
        f"Share of the operating points that cost at most so much, over the cost in m², logarithmic. {ranges}",
    )  # fmt: skip


def _convergence(found: DataSet) -> list[Picture]:
    """How the swarms came to their last cost; nothing for a set without traces."""
    above = _above(found)
    if above is None:
        return []
    low, middle, high = above
    finite = high[np.isfinite(high)]
    panel = Panel(
        "Convergence of the swarms", Axis("Generation (–)", whole=True, margin=0.02),
        _ratios("Cost over last (–)", 1.0, float(finite.max()) if finite.size else 1.0),
        _band(np.arange(1, len(middle) + 1), low, middle, high),
        f"Lowest cost so far over the last, by generation, logarithmic: median from {number(middle[0])} to 1.",
    )  # fmt: skip
    caption = (
        "Lowest cost up to each generation, over that of the last: median and quartiles over the operating points."
    )
    return [Picture("convergence", caption, [panel], file="convergence.png")]


def _flatness(dataset: DataSet, summary: Summary) -> list[Picture]:
    """At how many operating points how much of the library is near the best; nothing where that is not known."""
    if not len(dataset.library):
        return []
    shares = {row["within"]: flatness(dataset, row["within"]) for row in summary["flatness"]}
    if not any(share.size for share in shares.values()):
        return []
    own = strokes(f"within {100 * within:g} %" for within in shares)
    marks: list[Mark] = []
    for stroke, share in zip(own.values(), shares.values(), strict=True):
        x = 100.0 * np.concatenate([[0.0], np.sort(share)])
        reached = 100.0 * np.concatenate([[1.0], np.arange(share.size, 0, -1) / max(share.size, 1)])
        marks.append(Polyline(x, reached, stroke, steps="pre"))
    ranges = " ".join(f"{name}: {_range_of(100 * s)} %." for name, s in zip(own, shares.values(), strict=True))
    panel = Panel(
        "Tunings that are nearly as good", Axis("At least so much of the library (%)", 0.0, 100.0),
        Axis("Operating points (%)", 0.0, 103.0), marks,
        f"Share of the operating points over the share of the library that is near the best. {ranges}",
    )  # fmt: skip
    caption = "At how many operating points at least so much of the library is near the best; further right is flatter."
    return [Picture("flatness", caption, [panel], list(own.items()), "flatness.png", row_height=2.6)]


def _histogram(target: _Target, limits: tuple[float, float]) -> Panel:
    low, high = min(limits[0], target.standard), max(limits[1], target.standard)
    edges: Array
    if target.whole:
        step = max(1, round((high - low) / _BARS))
        edges = np.arange(low - 0.5, high + step + 0.5, step)
    elif target.decades:
        edges = np.geomspace(low, high * (1.0 + 1e-9), _BARS + 1) if high > low else np.array([low / 2, low * 2])
    else:
        edges = np.linspace(low, high + 1e-9, _BARS + 1) if high > low else np.array([low - 0.5, low + 0.5])
    counts, _ = np.histogram(np.clip(target.values, edges[0], edges[-1]), edges)
    return Panel(
        target.symbol, Axis(target.label, log=target.decades, margin=0.03), Axis("Operating points (%)"),
        [Bars(edges, 100.0 * counts / target.values.size), Guide("x", [target.standard], REFERENCE, 1.0)],
        f"Share of the operating points in percent; {_range_of(target.values)}.",
    )  # fmt: skip


def _band(x: NDArray[Any], low: Array, middle: Array, high: Array) -> list[Mark]:
    """A median with its quartiles; what is infinite is left out."""
    return [Ribbon(x, low, high), Polyline(x, middle, Stroke(), markers=len(x) <= 30)]


def _ratios(label: str, low: float, high: float) -> Axis:
    """A logarithmic axis of ratios from `low` to `high`, with 1 on it."""
    low, high = min(low, 1.0), max(high, 1.0)
    margin = max(float(high / low) ** 0.06, 1.001)
    return Axis(label, low / margin, high * margin, log=True)

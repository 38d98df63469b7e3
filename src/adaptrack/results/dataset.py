"""The report on a data set of tuned operating points: its optimum in pictures, what explains it, how flat it is.

Statistics are over those that a swarm searched, as in `dataset.describe`: left-right twins would count twice.
"""

from __future__ import annotations

import json
import os
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from adaptrack.base.errors import InvalidInput
from adaptrack.comparison.statistics import ratio
from adaptrack.results import style
from adaptrack.results.maps import Cells, Heat, edges_around, norm_of
from adaptrack.results.notebook import html
from adaptrack.results.page import (
    Cell,
    Head,
    Item,
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
from adaptrack.results.words import counted, lettered, listed, number, percent, span
from adaptrack.results.words import describe as in_words
from adaptrack.tuning.config import STANDARD
from adaptrack.tuning.dataset import DataSet, describe, flatness

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
_STROKES = style.strokes((_STANDARD, _SWARM, _LIBRARY))
_SPREAD = style.Stroke(style.SERIES[0])


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


def write_dataset_report(out_dir: str | os.PathLike[str], dataset: DataSet, *, summary: Summary | None = None) -> Path:
    """Write the page on a data set and its PNG files into `out_dir`; return the page's path.

    Parameters
    ----------
    summary
        What `adaptrack.tuning.dataset.describe` said of it; computed when left out, which takes some seconds.

    Raises
    ------
    InvalidInput
        When no operating point of the data set was searched by a swarm.
    StorageError
        When the files cannot be written, see `page.write_page`.
    """
    told = _summary(dataset) if summary is None else summary
    rows = dataset.rows(dataset.computed)
    found = rows.rows(kept) if (kept := np.isfinite(rows.costs)).any() else None
    sections = [
        *_opening(rows, told),
        _contents(dataset, told),
        *([_optimum(found, told)] if found is not None else []),
        _costs(rows, told),
        *(_convergence(found) if found is not None else []),
        _explained(told),
        _flatness(dataset, told),
        _provenance(dataset, told),
    ]
    return write_page(out_dir, sections, title=_title(dataset, told), lead=[_in_short(told)])


def dataset_figure(dataset: DataSet) -> Figure:
    """How often each tuning is the best, and how many times the best the standard tuning costs, by speed.

    Raises
    ------
    InvalidInput
        When no swarm found a tuning with which the run did not fail.
    """
    rows = dataset.rows(dataset.computed)
    found = rows.rows(np.isfinite(rows.costs))
    if not len(found):
        raise InvalidInput(f"data set {dataset.name!r}: no swarm found a tuning, so there is nothing to draw.")
    panels = [
        _histogram(each, (float(each.values.min()), float(each.values.max())))
        for each in _targets(found) if each.name in ("Np", "Nc", "log R/Q")
    ]  # fmt: skip
    kept = (found.costs > 0.0) & np.isfinite(found.standard_costs)
    if kept.any():
        gain = found.standard_costs[kept] / found.costs[kept]
        panels.append(
            Panel("Standard over the best", partial(_draw_gain, found.operating_points[kept, 0], gain), _range_of(gain))
        )
    return printed(panels, 2, 2.1)


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


def _title(dataset: DataSet, told: Summary) -> str:
    about = [f"{key} {told[key]}" for key in ("vehicle", "profile") if isinstance(told.get(key), str)]
    about += [str(told["scenario"])] if isinstance(told.get("scenario"), str) else []
    return f"Data set {dataset.name}: {', '.join(about)}" if about else f"Data set {dataset.name}"


# -- the first screen -------------------------------------------------------------------------------------------------
def _opening(rows: DataSet, told: Summary) -> list[Section]:
    """What tuning each operating point is worth; nothing where no such ratio is known."""
    both = np.isfinite(rows.standard_costs) & (rows.standard_costs > 0) & np.isfinite(rows.costs) & (rows.costs > 0)
    if not both.any():
        return []
    worth = ratio(rows.standard_costs[both], rows.costs[both])
    costs = told["costs"]
    near = [row for row in told["flatness"] if row["p50"] is not None]
    entries = [
        ("Swarms", f"{number(told['computed'])} operating points, {number(told['evaluations'])} closed-loop runs"),
        ("Against", f"the standard tuning, {'/'.join(f'{value:g}' for value in STANDARD)} (Np/Nc/Q/R)"),
        ("How sure", f"{number(worth.low)} to {number(worth.high)}: 95 % bootstrap interval over "
                     f"{counted(int(both.sum()), 'operating point')} without a failure"),
        ("Failed", f"standard tuning in {number(costs['failed_by_the_standard'])}, swarm's best in "
                   f"{number(costs['failed_by_the_swarm'])}"),
    ]  # fmt: skip
    if near:
        share, within = percent(near[-1]["p50"]), f"{100 * near[-1]['within']:g}"
        entries.append(
            ("How flat", f"{share} % of {counted(told['library'], 'tuning')} cost within {within} % of the best")
        )
    text = f"The standard tuning costs {number(worth.mean)} times the best that swarms found, in the geometric mean."
    gain = rows.standard_costs[both] / rows.costs[both]
    panel = Panel(
        "Standard tuning over the swarm's best", partial(_draw_gain, rows.operating_points[both, 0], gain),
        f"Cost ratio by speed: {_range_of(gain)}.",
    )  # fmt: skip
    caption = "How many times the swarm's best the standard tuning costs, by speed: median, band between the quartiles."
    return [Section("Verdict", [Verdict(text, Terms(entries), Picture(caption, [panel.drawing()]))])]


# -- sections ---------------------------------------------------------------------------------------------------------
def _in_short(told: Summary) -> str:
    gain = told["costs"]["standard_over_best_geomean"]
    paid = f" The standard tuning costs {number(gain)} times as much, in the geometric mean." if gain else ""
    return (
        f"{counted(told['operating_points'], 'operating point')}, at each the best tuning that a swarm found for "
        f"the MPC, and the cost of {counted(told['library'], 'common tuning')}.{paid}"
    )


def _contents(dataset: DataSet, told: Summary) -> Section:
    """What the set is, the command that makes it again, the ranges."""
    twins = told["operating_points"] - told["computed"]
    mirrored = f" The other {number(twins)} are left-right twins, whose rows are copies." if twins else ""
    words = (
        "An operating point is a speed, a lateral reference, a friction and a side wind. "
        f"Swarms searched {number(told['computed'])} of them, with {number(told['evaluations'])} closed-loop "
        f"evaluations of {number(told['control_steps'])} control steps in all.{mirrored} "
        "Pictures and tables below count only operating points that were searched."
    )
    body = [
        [
            _QUANTITIES.get(row["quantity"], row["quantity"]),
            row["unit"].replace("-", "–"),
            number(row["lowest"]),
            number(row["highest"]),
            number(row["levels"]),
        ]
        for row in told["ranges"]
    ]
    heads = [Head("Quantity", is_text=True), Head("Unit", is_text=True), Head("Lowest"), Head("Highest")]
    ranges = Table(
        "Ranges of the operating points",
        [*heads, Head("Distinct values")],
        body,
        "Positive is to the left, also for wind.",
    )
    entries = [
        (key.replace("_", " ").capitalize(), in_words(told[key])) for key in _LISTED if told.get(key) is not None
    ]
    units = {"Duration": " s a run", "Move weight": " m²/rad²"}
    terms = Terms([(name, value + units.get(name, "")) for name, value in entries])
    again: list[Item] = ["This command makes the data set again:", Verbatim(dataset.command)]
    return Section("What it is", [words, *again, *([terms] if entries else []), ranges])


def _optimum(found: DataSet, told: Summary) -> Section:
    targets = _targets(found)
    maps = [target for target in targets if target.name in ("Np", "Nc", "log R/Q")]
    over = {
        "lateral reference": (np.abs(found.operating_points[:, 1]), r"$|y_\mathrm{ref}|$ (m)"),
        "friction": (found.operating_points[:, 2], "Friction (–)"),
    }
    labels = {t.name: t.label for t in maps}
    cells = {(t.name, other): _binned(found, values, t) for t in maps for other, (values, _) in over.items()}
    norms = {t.name: norm_of(cells[t.name, other].values for other in over) for t in maps}
    heats = {
        (t.name, other): Heat(cells[t.name, other], label, norms[t.name], t.whole)
        for t in maps
        for other, (_, label) in over.items()
    }
    panels = [
        Panel(labels[name], heat.show, f"Median over speed and {other}: {span(heat.cells.values)}.")
        for (name, other), heat in heats.items()
    ]
    heat = Picture(
        "The best tuning over the operating points. Each cell is the median over all that lie in it, whatever their "
        "other two numbers; empty cells hold none. Both maps of a target have the same colours.",
        [panel.drawing() for panel in panels],
        file="optimum.png",
        print_figure=lambda: _heat_figure(
            list(labels.values()), [[heats[name, other] for name in labels] for other in over]
        ),
    )
    bars = [_histogram(target, _limits(told, target)) for target in targets]
    spread = Picture(
        "How often each value is the best. Dashed: the standard tuning, "
        f"{listed([f'{name} = {value:g}' for name, value in zip(('Np', 'Nc', 'Q', 'R'), STANDARD, strict=True)])}.",
        [bar.drawing() for bar in bars],
        file="targets.png",
        print_figure=lambda: printed(bars, columns=3, height=1.75),
    )
    words = (
        "The horizons Np and Nc are in control periods. Of the weights, only R/Q changes the control law: Q and R "
        "alone are where the swarm happened to stop along a line of equal cost."
    )
    return Section("The optimum", [words, heat, spread])


def _costs(rows: DataSet, told: Summary) -> Section:
    costs = told["costs"]
    items: list[Item] = [_costs_in_words(costs, len(rows), len(rows.library))]
    curves = {_STANDARD: rows.standard_costs, _SWARM: rows.costs}
    if len(rows.library):
        curves[_LIBRARY] = rows.landscape.min(axis=1).astype(np.float64)
    usable = {name: values for name, values in curves.items() if _positive(values).size}
    if usable:
        panels = [
            Panel(
                "Cost of one run",
                partial(_draw_cumulative, usable),
                "Share of the operating points that cost at most so much, over the cost in m², logarithmic. "
                + " ".join(f"{name}: {_range_of(_positive(values))}." for name, values in usable.items()),
            )
        ]
        both = np.isfinite(rows.standard_costs) & (rows.standard_costs > 0) & np.isfinite(rows.costs) & (rows.costs > 0)
        if both.any():
            gain = rows.standard_costs[both] / rows.costs[both]
            panels.append(
                Panel(
                    "Standard over optimum",
                    partial(_draw_gain, rows.operating_points[both, 0], gain),
                    f"Cost of the standard tuning over the swarm's best, by speed: {_range_of(gain)}.",
                )
            )
        key = [(name, _STROKES[name]) for name in usable]
        items.append(
            Picture(
                "Left: the share of operating points that cost at most so much; further left is better. A curve "
                "that ends below 100 % failed in the rest. Right: how many times the optimum the standard tuning "
                "costs, by speed: median, with a band from the lower to the upper quartile.",
                [panel.drawing() for panel in panels],
                key,
                "cost.png",
                lambda: printed(panels, len(panels), 2.4, key),
            )
        )
    return Section("What the optimum is worth", items)


def _convergence(found: DataSet) -> list[Section]:
    """How the swarms came to their last cost; nothing for a set without traces."""
    last = found.traces[:, -1:].astype(np.float64) if found.traces.shape[1] else np.empty((0, 1))
    usable = np.flatnonzero(np.isfinite(last[:, 0]) & (last[:, 0] > 0.0)) if last.size else np.empty(0, int)
    if not usable.size:
        return []
    above = found.traces[usable].astype(np.float64) / last[usable]
    low, middle, high = _quantiles(above, (0.25, 0.5, 0.75))
    half = len(middle) // 2
    panel = Panel(
        "Convergence of the swarms",
        partial(_draw_convergence, low, middle, high),
        f"Lowest cost so far over the last, by generation, logarithmic: median from {number(middle[0])} to 1.",
    )
    words = f"After the first generation the median swarm is {_percent_above(middle[0])} its last cost"
    if len(middle) > 2:
        words += f", after generation {half + 1} it is {_percent_above(middle[half])} that"
    words += (
        ". A curve that is flat well before its end has had generations enough for what this swarm can find; that says "
        "nothing about optima that it never saw."
    )
    caption = (
        "Lowest cost up to each generation, over that of the last: median and quartiles over the operating points."
    )
    return [Section("Convergence", [words, Picture(caption, [panel.drawing()], file="convergence.png")])]


def _explained(told: Summary) -> Section:
    body: list[list[Cell | str]] = []
    for row in told["optimum"]:
        name, logarithmic = row["target"].removeprefix("log "), row["target"].startswith("log ")
        values = [row[key] for key in ("lowest", "p10", "p50", "p90", "highest")]
        shown = [np.exp(v) if logarithmic and v is not None else v for v in values]
        bound = "–" if row["at_a_bound"] is None else percent(row["at_a_bound"])
        body.append([name, *map(number, shown), bound, _r2(row["r2"])])
    heads = [Head("Target", is_text=True), Head("Lowest"), Head("P10"), Head("Median"), Head("P90"), Head("Highest")]
    table = Table(
        "The optimum, and how much of it the operating points explain",
        [*heads, Head("At a bound", "%"), Head("R²")],
        body,
        "Np, Nc in control periods, Q in 1/m², R in 1/rad². P10 and P90: a tenth of all points lies below, above. "
        f"R²: {told['learner']}; for Q, R and R/Q of the logarithm.",
    )
    return Section("What the operating points explain", [_explained_in_words(told), table])


def _flatness(dataset: DataSet, told: Summary) -> Section:
    title = "How flat the optimum is"
    shares = (
        {row["within"]: flatness(dataset, row["within"]) for row in told["flatness"]} if len(dataset.library) else {}
    )
    if not any(share.size for share in shares.values()):
        missing = "no library was evaluated" if not len(dataset.library) else "the run failed with every tuning"
        return Section(title, [f"Not known: {missing}."])
    rows = [row for row in told["flatness"] if row["mean"] is not None]
    body = [
        [
            f"{100 * row['within']:g} %",
            *(percent(row[key]) for key in ("mean", "lowest", "p10", "p50", "p90", "highest")),
        ]
        for row in rows
    ]
    heads = [Head("Within"), *(Head(text, "%") for text in ("Mean", "Lowest", "P10", "Median", "P90", "Highest"))]
    table = Table(
        "Share of the library whose cost is near the best",
        heads,
        body,
        f"Of {counted(told['library'], 'tuning')}, at each operating point; the best is the lowest cost known there, "
        "the swarm's or the library's.",
    )
    strokes = style.strokes(f"within {100 * within:g} %" for within in shares)
    panel = Panel(
        "Tunings that are nearly as good",
        partial(_draw_shares, dict(zip(strokes, shares.values(), strict=True)), strokes),
        "Share of the operating points over the share of the library that is near the best. "
        + " ".join(f"{name}: {_range_of(100 * s)} %." for name, s in zip(strokes, shares.values(), strict=True)),
    )
    caption = "At how many operating points at least so much of the library is near the best; further right is flatter."
    wide = rows[-1]
    words = (
        f"In the median over operating points, {percent(wide['p50'])} % of the library costs at most "
        f"{100 * wide['within']:g} % more than the best tuning known. Where many tunings are that close, which of them "
        "comes out best says little, and a model loses little by a wrong one; where few are, the tuning matters."
    )
    key = list(strokes.items())
    picture = Picture(caption, [panel.drawing()], key, "flatness.png", lambda: printed([panel], 1, 2.6, key))
    return Section(title, [words, table, picture])


def _provenance(dataset: DataSet, told: Summary) -> Section:
    entries = [("Identity", in_words(told["identity"]))]
    entries += [(name, in_words(version)) for name, version in told["versions"].items()]
    record = json.dumps(dataset.provenance, indent=1, ensure_ascii=False)
    return Section("Provenance", [Terms(entries), Verbatim(record, "The full record of the campaign")])


# -- words ------------------------------------------------------------------------------------------------------------
def _costs_in_words(costs: Summary, n: int, library: int) -> str:
    gain, middle, high = (
        costs[key]
        for key in ("standard_over_best_geomean", "swarm_behind_the_best_known_p50", "swarm_behind_the_best_known_p90")
    )
    sentences = ["The cost is the mean square tracking error, plus the weight of steering activity where there is one."]
    if gain:
        sentences.append(f"The standard tuning costs {number(gain)} times the swarm's best (geometric mean).")
    if library and middle is not None and high is not None:
        sentences.append(
            "Against the lowest cost known, be it the swarm's or a library tuning's, the swarm's best is "
            f"{percent(middle)} % behind in the median, and {percent(high)} % or more in the worst tenth of them."
        )
    failed = [
        f"{who} in {number(costs[key])}"
        for key, who in (
            ("failed_by_the_standard", "the standard tuning"),
            ("failed_by_the_swarm", "the swarm's best"),
            ("failed_by_all", "every tuning"),
        )
        if costs[key]
    ]
    of = f"of {counted(n, 'operating point')}"
    none = f"Neither of the two failed in any {of}."
    sentences.append(f"The run failed with {listed(failed)} {of}." if failed else none)
    if costs["library_failed"]:
        sentences.append(f"Of all runs of the library, {percent(costs['library_failed'])} % failed.")
    return " ".join(sentences)


def _explained_in_words(told: Summary) -> str:
    known = {row["target"].removeprefix("log "): row["r2"] for row in told["optimum"] if row["r2"] is not None}
    meaning = (
        "R² says how well a strong learner predicts the optimum of operating points that it has not seen: 1 means "
        "perfectly, 0 no better than the mean of all. Near 0 the tuning at which a swarm stops carries no signal: "
        "whatever learns from it learns noise, and should learn from the costs of the library instead."
    )
    if not known:
        return f"{meaning} Here the operating points are too few to tell."
    groups = (
        ("largely explained", [name for name, r2 in known.items() if r2 >= _STRONG]),
        ("partly explained", [name for name, r2 in known.items() if _WEAK <= r2 < _STRONG]),
        ("hardly explained, if at all", [name for name, r2 in known.items() if r2 < _WEAK]),
    )
    said = "; ".join(f"{words}: {listed(names)}" for words, names in groups if names)
    return f"{meaning} {said[:1].upper() + said[1:]}."


def _r2(value: float | None) -> Cell:
    return Cell("–") if value is None else Cell(f"{value:.2f}".replace("-", "−"), warn=value < _WEAK)


def _percent_above(ratio: float) -> str:
    if not np.isfinite(ratio):
        return "infinitely far above"
    return f"{number(ratio)} times" if ratio >= 2.0 else f"{percent(max(ratio - 1.0, 0.0))} % above"


def _range_of(values: Array) -> str:
    return f"{span(values)}, median {number(float(np.median(values)))}" if values.size else "none"


# -- numbers ----------------------------------------------------------------------------------------------------------
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


def _limits(told: Summary, target: _Target) -> tuple[float, float]:
    """The lowest and the highest value of a target that occurs."""
    row = next(row for row in told["optimum"] if row["target"] == target.name)
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


# -- drawing ----------------------------------------------------------------------------------------------------------
def _heat_figure(titles: Sequence[str], rows: Sequence[Sequence[Heat]]) -> Figure:
    """The maps of each target in one column, with their bar below it."""
    columns = len(titles)
    with style.styled():
        figure, axes = style.grid_figure(len(rows), columns, 2.25)
        for i, (heat, ax) in enumerate(zip([heat for row in rows for heat in row], axes, strict=True)):
            heat.draw(ax)
            ax.set_title(lettered(i, titles[i] if i < columns else ""))
            if i % columns:
                ax.set_ylabel("")
            if i < len(axes) - columns:
                ax.set_xlabel("")
        for j, heat in enumerate(rows[0]):
            heat.bar(figure, ax=axes[j::columns], location="bottom", aspect=28, shrink=0.95, pad=0.02)
    return figure


def _histogram(target: _Target, limits: tuple[float, float]) -> Panel:
    text = f"Share of the operating points in percent; {_range_of(target.values)}."
    return Panel(target.symbol, partial(_draw_histogram, target, limits), text)


def _draw_histogram(target: _Target, limits: tuple[float, float], axes: Axes) -> None:
    low, high = min(limits[0], target.standard), max(limits[1], target.standard)
    edges: Array
    if target.whole:
        step = max(1, round((high - low) / _BARS))
        edges = np.arange(low - 0.5, high + step + 0.5, step)
    elif target.decades:
        axes.set_xscale("log")
        edges = np.geomspace(low, high * (1.0 + 1e-9), _BARS + 1) if high > low else np.array([low / 2, low * 2])
    else:
        edges = np.linspace(low, high + 1e-9, _BARS + 1) if high > low else np.array([low - 0.5, low + 0.5])
    inside = np.clip(target.values, edges[0], edges[-1])
    weights = np.full(inside.size, 100.0 / inside.size)
    axes.hist(inside, edges.tolist(), weights=weights, color=_SPREAD.colour, rwidth=0.9)
    axes.axvline(target.standard, color=style.REFERENCE.colour, linestyle=style.REFERENCE.dash, linewidth=1.0)
    axes.grid(False, axis="x")
    axes.set_xmargin(0.03)
    axes.autoscale(axis="x")
    axes.set_xlabel(target.label)
    axes.set_ylabel("Operating points (%)")


def _draw_cumulative(costs: Mapping[str, Array], axes: Axes) -> None:
    for i, (name, values) in enumerate(costs.items()):
        placed = _positive(values)
        share = 100.0 * ((values <= 0.0).sum() + np.arange(1, placed.size + 1)) / values.size
        stroke = _STROKES[name]
        width = 1.3 + (0.9 if i == 1 else 0.0)  # the library's best may lie on the swarm's
        axes.step(placed, share, where="post", color=stroke.colour, linestyle=stroke.dash, linewidth=width)
    axes.set_ylim(0.0, 103.0)
    style.logarithmic(axes, "x")
    axes.set_xlabel("Cost (m²)")
    axes.set_ylabel("Operating points (%)")


def _draw_gain(speed: Array, gain: Array, axes: Axes) -> None:
    edges = _edges(speed)
    bins = _bins(speed, edges)
    which = np.unique(bins)
    middles = np.array([np.median(speed[bins == b]) for b in which])
    low, middle, high = np.stack([_quantiles(gain[bins == b], (0.25, 0.5, 0.75)) for b in which], axis=1)
    axes.axhline(1.0, color=style.MUTED, linewidth=0.7)
    _band(axes, middles, low, middle, high)
    _ratio_axis(axes, float(low.min()), float(high.max()))
    axes.set_xlabel("Speed (m/s)")
    axes.set_ylabel("Cost ratio (–)")


def _draw_convergence(low: Array, middle: Array, high: Array, axes: Axes) -> None:
    generation = np.arange(1, len(middle) + 1)
    _band(axes, generation, low, middle, high)
    finite = high[np.isfinite(high)]
    _ratio_axis(axes, 1.0, float(finite.max()) if finite.size else 1.0)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, steps=style.ROUND))
    axes.set_xlabel("Generation (–)")
    axes.set_ylabel("Cost over last (–)")


def _draw_shares(shares: Mapping[str, Array], strokes: Mapping[str, style.Stroke], axes: Axes) -> None:
    for name, share in shares.items():
        x = 100.0 * np.concatenate([[0.0], np.sort(share)])
        reached = 100.0 * np.concatenate([[1.0], np.arange(share.size, 0, -1) / max(share.size, 1)])
        axes.step(x, reached, where="pre", color=strokes[name].colour, linestyle=strokes[name].dash)
    axes.set_xlim(0.0, 100.0)
    axes.set_ylim(0.0, 103.0)
    axes.set_xlabel("At least so much of the library (%)")
    axes.set_ylabel("Operating points (%)")


def _band(axes: Axes, x: NDArray[Any], low: Array, middle: Array, high: Array) -> None:
    """A median with its quartiles; what is infinite is left out."""
    mark = "o" if len(x) <= 30 else ""
    axes.fill_between(x, low, high, where=np.isfinite(high).tolist(), color=_SPREAD.colour, alpha=0.22, linewidth=0)
    axes.plot(x, middle, color=_SPREAD.colour, marker=mark, markersize=3.0)
    axes.set_xmargin(0.02)


def _ratio_axis(axes: Axes, low: float, high: float) -> None:
    """A logarithmic axis of ratios from `low` to `high`, with 1 on it."""
    low, high = min(low, 1.0), max(high, 1.0)
    margin = max(float(high / low) ** 0.06, 1.001)
    style.logarithmic(axes, "y", (low / margin, high * margin))

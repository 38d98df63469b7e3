"""Pictures of a comparison, as plain data: ratios, regret over the domain, run by run; what was learned, and how."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from adaptrack.base.result import (
    BACKGROUND,
    SERIES,
    Axis,
    Guide,
    HeatMap,
    Mark,
    Panel,
    Picture,
    Polyline,
    Scale,
    Stroke,
)
from adaptrack.base.statistics import binned_geometric_mean, regret_percentiles
from adaptrack.comparison.table import Comparison
from adaptrack.control.scheduling import Schedule
from adaptrack.control.scheduling.sensitivity import outputs_of
from adaptrack.results.comparison_words import (
    MAPPED,
    OPTIMUM,
    few_strokes,
    label_of,
    runs_of,
    strokes_of,
)
from adaptrack.results.dots import Dot, dots_panel, notes
from adaptrack.results.words import INPUTS, data_text, number, span

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]
Checks = Sequence[Mapping[str, Any]]
"""What `improve` noted of a schedule after some of its rounds."""

OUTPUTS = (("$N_p$", "periods"), ("$N_c$", "periods"), (r"$\log_{10} R/Q$", "R/Q in m²/rad²"))
CEILING = 10.0
"""Regrets above this share a colour."""
PER_CELL, LEAST_CELLS, MOST_CELLS = 6, 4, 12
"""Operating points that a cell of a map holds at least, on average; the least and the most cells along its axes."""
MAPPED_RUNS = PER_CELL * LEAST_CELLS**2
"""Operating points from which maps are drawn."""
_CURVE = 400
"""Points of a distribution's curve."""
NODES = (64, 44)
"""of a learned surface, along its axes"""
_OTHERS = "All others"
_ADAPTIVE, _CONSTANT, _HINDSIGHT = SERIES[0], SERIES[1], "muted"
"""Colours of what adapts its tuning, of what keeps one, and of what needs hindsight."""


# -- ratios -----------------------------------------------------------------------------------------------------------
def ratios_picture(comparison: Comparison, called: Callable[[str], str]) -> Picture:
    """Each contender's cost over the reference's, with its 95 % interval; called: a contender in tables."""
    dots = _dots(comparison, called)
    label = f"Cost / {called(comparison.reference)}"
    panel, size = dots_panel(dots, data_text(label), f"{label}, geometric mean and 95 % interval", level=1.0)
    caption = (
        f"{label}, geometric mean with its 95 % interval. Blue: adapts its tuning; orange: keeps one; grey: needs "
        f"hindsight.{notes(dots)}"
    )
    return Picture("verdict", caption, [panel], size=size)


def comparison_figure(comparison: Comparison) -> Figure:
    """Each contender's cost over the reference's, with its 95 % interval."""
    from adaptrack.results.draw import panel_figure

    picture = ratios_picture(comparison, str)
    return panel_figure(picture.panels[0], picture.size)


def _dots(comparison: Comparison, called: Callable[[str], str]) -> list[Dot]:
    """The cheapest first; the reference only where it is alone."""
    rows = sorted(comparison.rows(), key=lambda row: row["regret_geomean"])
    return [
        Dot(called(row["contender"]), row["regret_geomean"], row["regret_low"], row["regret_high"],
            _colour(comparison, row["contender"]), row["failures"] > 0)
        for row in rows if row["contender"] != comparison.reference
    ] or [Dot(called(comparison.reference), 1.0)]  # fmt: skip


def _colour(comparison: Comparison, contender: str) -> str:
    role = comparison.role(contender)
    return _HINDSIGHT if role.hindsight else _ADAPTIVE if role.adapts else _CONSTANT


# -- over the domain --------------------------------------------------------------------------------------------------
def regret_maps(comparison: Comparison) -> Picture | None:
    """The regret of the main contenders over speed and friction, and over speed and the reference.

    None where none of them drove, or too few operating points (`MAPPED_RUNS`) for cells that hold several.
    """
    contenders = [contender for contender in comparison.of_kind(*MAPPED) if contender != comparison.reference]
    if not contenders or runs_of(comparison) < MAPPED_RUNS:
        return None
    speed, y_ref, friction = comparison.where[:, 0], np.abs(comparison.where[:, 1]), comparison.where[:, 2]
    over = {"friction": (friction, "Friction (–)"), "lateral reference": (y_ref, r"$|y_\mathrm{ref}|$ (m)")}
    found = {
        (contender, name): mean_regret(comparison.regret(contender), speed, y)
        for contender in contenders
        for name, (y, _) in over.items()
    }
    means = np.concatenate([values.ravel() for _, _, values in found.values()])
    low, high = min(1.0, float(np.nanmin(means))), float(np.nanmax(means))
    beyond = high > CEILING
    scale = Scale(low, max(min(high, CEILING), 1.2 * low), log=True, beyond="max" if beyond else "neither")
    panels = [
        Panel(
            data_text(label_of(contender)), Axis("Speed (m/s)"), Axis(over[name][1]),
            [HeatMap(speeds, others, values, scale)],
            f"Geometric mean regret over speed and {name}: {span(values)}.",
        )
        for (contender, name), (speeds, others, values) in found.items()
    ]  # fmt: skip
    caption = (
        "Regret over the domain: geometric mean of all operating points in a cell, whatever their other two numbers; "
        "left over friction, right over the size of the reference. All maps share one logarithmic scale of colours"
        f"{f', which ends at {CEILING:g}' if beyond else ''}."
    )
    return Picture("maps", caption, panels, file="regret-map.png", row_height=1.75)


def mean_regret(regret: Array, x: Array, y: Array) -> tuple[Array, Array, Array]:
    """Edges of cells along x and y, and (y cells, x cells) the geometric mean of the regret in each."""
    cells = int(np.clip(math.sqrt(len(regret) / PER_CELL), LEAST_CELLS, MOST_CELLS))
    return binned_geometric_mean(regret, x, y, cells)


# -- run by run -------------------------------------------------------------------------------------------------------
def spread_picture(compared: Mapping[str, Comparison]) -> Picture | None:
    """The distribution of what single runs cost, by what a run is; None where nobody drove beside a reference."""
    several = {noun: each for noun, each in compared.items() if len(each.costs) > 1}
    if not several:
        return None
    drawn = {noun: _drawn(each) for noun, each in several.items()}
    kinds = {contender: several[noun].role(contender).kind for noun, whom in drawn.items() for contender in whom}
    own = few_strokes(kinds, [contender for each in several.values() for contender in each.best])
    panels = [_spread_panel(each, noun, drawn[noun], own) for noun, each in several.items()]
    caption = (
        "Share of the runs that cost at most so many times the reference, which is the upright line: further left is "
        "better. What lies far out is cut off."
    )
    key = [(label_of(contender), stroke) for contender, stroke in own.items() if stroke != BACKGROUND]
    key += [(_OTHERS, BACKGROUND)] if BACKGROUND in own.values() else []
    return Picture("spread", caption, panels, key, "spread.png", row_height=2.8)


def _drawn(comparison: Comparison) -> list[str]:
    """All but the reference; beside what has a guard, the same without it is hard to see."""
    others = [contender for contender in comparison.costs if contender != comparison.reference]
    return [contender for contender in others if not comparison.role(contender).kind.endswith(" unguarded")]


def _spread_panel(comparison: Comparison, noun: str, contenders: Sequence[str], own: Mapping[str, Stroke]) -> Panel:
    ratios = {contender: comparison.regret(contender) for contender in contenders}
    spread = {contender: regret_percentiles(regret) for contender, regret in ratios.items()}
    described = " ".join(
        f"{label_of(contender)}: median {number(each['p50'])}, nine tenths below {number(each['p90'])}."
        for contender, each in spread.items()
    )
    over = "Regret (–)" if comparison.reference == OPTIMUM else f"Cost / {comparison.reference} (–)"
    ends = [0.9, 1.1, *(np.clip(np.median(values), 0.1, CEILING) for values in ratios.values())]
    for contender in contenders:
        if comparison.role(contender).kind in MAPPED:
            ends += np.clip(np.quantile(ratios[contender], (0.005, 0.97)), 0.05, 5.0 * CEILING).tolist()
    marks: list[Mark] = [Guide("x", [1.0], width=0.7)]
    marks += [_distribution(values, own[contender]) for contender, values in ratios.items()]
    return Panel(
        f"{noun.capitalize()}s",
        Axis(data_text(over), float(min(ends)), float(max(ends)), log=True),
        Axis(f"{noun.capitalize()}s (%)", 0.0, 103.0),
        marks,
        f"{over}, logarithmic, and the share below. {described}",
    )


def _distribution(values: Array, stroke: Stroke) -> Polyline:
    """The share of values up to each."""
    levels = np.linspace(0.0, 1.0, min(len(values), _CURVE) + 1)[1:]
    placed = np.quantile(values, levels, method="inverted_cdf")
    x, y = np.concatenate([placed[:1], placed]), 100.0 * np.concatenate([[0.0], levels])
    return Polyline(x, y, stroke, steps="post")


# -- what was learned -------------------------------------------------------------------------------------------------
def surfaces_picture(drawn: Mapping[str, Schedule], other: Mapping[str, str]) -> Picture:
    """The tuning over speed and another input; drawn: schedules without guard, by contender; other: that input."""
    surfaces = {name: _surface(schedule, other[name]) for name, schedule in drawn.items()}
    panels = []
    for k, (symbol, unit) in enumerate(OUTPUTS):
        scale = shared_scale([surface[..., k] for surface in surfaces.values()], whole=k < 2)
        for name, schedule in drawn.items():
            values, beside = surfaces[name][..., k], other[name]
            heat = HeatMap(_domain(schedule, "speed"), _domain(schedule, beside), values, scale, image=True)
            panels.append(Panel(
                f"{data_text(label_of(name))}: {symbol} ({unit})", Axis("Speed (m/s)"), Axis(axis_of(beside)), [heat],
                f"Over speed and {INPUTS[beside][0].lower()}: {span(values)}.",
            ))  # fmt: skip
    caption = (
        "The learned tuning over speed and the input that moves it most beside the speed, with the other inputs in the "
        "middle of their domain and without the guard. Pictures of the same number share their colours."
    )
    columns = len(drawn) if len(drawn) > 1 else len(OUTPUTS)
    return Picture("surfaces", caption, panels, file="surfaces.png", columns=columns, row_height=2.1)


def shared_scale(values: Sequence[Array], whole: bool) -> Scale:
    """From the lowest to the highest of all values; half a unit on either side where they are one number."""
    everything = np.concatenate([each.ravel() for each in values])
    low, high = float(np.nanmin(everything)), float(np.nanmax(everything))
    return Scale(low, high, whole=whole) if high > low else Scale(low - 0.5, high + 0.5, whole=whole)


def axis_of(name: str) -> str:
    """An input of schedules with its unit."""
    return "{} ({})".format(*INPUTS[name])


def _surface(schedule: Schedule, other: str) -> Array:
    """(nodes of `other`, nodes of speed, 3) the tuning, the remaining inputs in the middle of their domain."""
    columns, rows = NODES
    x = np.broadcast_to(schedule.domain.mean(axis=1), (rows, columns, len(schedule.inputs))).copy()
    x[..., schedule.inputs.index("speed")] = np.linspace(*_domain(schedule, "speed"), columns)
    x[..., schedule.inputs.index(other)] = np.linspace(*_domain(schedule, other), rows)[:, np.newaxis]
    return outputs_of(schedule, x.reshape(-1, x.shape[-1])).reshape(rows, columns, 3)


def _domain(schedule: Schedule, name: str) -> tuple[float, float]:
    low, high = schedule.domain[schedule.inputs.index(name)].tolist()
    return (low, high) if high > low else (low - 0.5, high + 0.5)


def learning_picture(histories: Mapping[str, Checks], kinds: Mapping[str, str], progress: str) -> Picture:
    """How the cost of the held-out runs fell; by contender, with their kinds; progress: the same in words."""
    own = strokes_of(kinds)
    costs = {name: [(check["round"], math.exp(check["score"])) for check in checks]
             for name, checks in histories.items()}  # fmt: skip
    failing = {name: [(check["round"], check["failed"]) for check in checks] for name, checks in histories.items()}
    panels = [
        _rounds("Cost of the held-out runs", "Cost (m²)", costs, own, f"Geometric mean over the rounds. {progress}")
    ]
    if any(check["failed"] for checks in histories.values() for check in checks):
        counts = " ".join(f"{label_of(name)}: {line[0][1]:g} to {line[-1][1]:g}." for name, line in failing.items())
        panels.append(_rounds("Held-out runs that failed", "Failed runs (–)", failing, own,
                              f"Number over the rounds. {counts}"))  # fmt: skip
    caption = "What held-out runs cost after each check, in the geometric mean; the schedule with the lowest was kept."
    key = [(label_of(contender), stroke) for contender, stroke in own.items()]
    return Picture("learning", caption, panels, key, "learning.png", row_height=2.8)


def _rounds(
    title: str, label: str, lines: Mapping[str, Sequence[tuple[float, float]]], own: Mapping[str, Stroke], words: str
) -> Panel:
    whole = all(value == round(value) for line in lines.values() for _, value in line)
    marks = [
        Polyline([at for at, _ in line], [value for _, value in line], own[name], markers=True)
        for name, line in lines.items()
    ]
    return Panel(title, Axis("Round (–)", whole=True, margin=0.03), Axis(label, whole=whole), marks, words)

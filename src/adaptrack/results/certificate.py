"""The page on a certificate: stability and margins of a scheduler's loop over its whole operating domain."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from numpy.typing import NDArray

from adaptrack.analysis.certify import DRIVING, Certificate, Driving, Sweep, extremes
from adaptrack.analysis.stability import Margins
from adaptrack.control.scheduling import SchedulingVariables
from adaptrack.results import style
from adaptrack.results.maps import COLOURS, Cells, Heat, edges_around
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
    write_page,
)
from adaptrack.results.words import INPUTS, number, percent, span

Array = NDArray[np.float64]

_UNSTABLE = style.SERIES[1]
_WORST = 8
_HEADS = (
    Head("Points"), Head("Unstable"), Head("Largest radius"), Head("Least gain margin up"),
    Head("Largest gain margin down"), Head("Least delay margin", "ms"), Head("Least modulus margin"),
)  # fmt: skip
"""Of the columns of `_row` behind the first."""
_STROKES: dict[Driving, style.Stroke] = {
    "straight": style.Stroke(style.SERIES[0]),
    "turn": style.Stroke(style.SERIES[1], (0, (5, 1.5))),
}
_NAMES: dict[Driving, str] = {"straight": "driving straight", "turn": "in a hard turn"}


class _Quantity(NamedTuple):
    """A quantity over speed and friction, as pictures show it."""

    title: str
    low: float
    high: float
    """what the colours span at most; what lies beyond has the colour of the end"""
    whole: bool = False
    fine: bool = False
    """whether low values are the good ones: their colours are turned round, so that dark is always bad"""

    log: bool = False
    """whether a colour is a factor: low values are then told apart like high ones"""

    @property
    def norm(self) -> Normalize:
        """From numbers to colours."""
        return LogNorm(self.low, self.high) if self.log else Normalize(self.low, self.high)

    @property
    def colours(self) -> str:
        return f"{COLOURS}_r" if self.fine else COLOURS

    def around(self, values: Array) -> _Quantity:
        """With colours that tell these values apart: from their 2nd to their 98th percentile, within its bounds."""
        finite = values[np.isfinite(values)]
        if not finite.size:
            return self
        low, high = np.clip(np.percentile(finite, (2.0, 98.0)), self.low, self.high)
        least = 0.1 * high if self.log else 0.02 * (self.high - self.low)  # equal values have one colour
        if high - low < least:
            low, high = max(self.low, low - least), min(self.high, high + least)
        return self._replace(low=float(low), high=float(high))


_RADIUS = _Quantity("Spectral radius (–)", 0.8, 1.02, fine=True)
_MODULUS = _Quantity("Modulus margin (–)", 0.0, 1.0)
_UP = _Quantity("Gain margin up (factor)", 1.0, 20.0, log=True)
_DOWN = _Quantity("Gain margin down (factor)", 0.0, 1.0, fine=True)
_DELAY = _Quantity("Delay margin (ms)", 1.0, 1000.0, log=True)


class _Map(NamedTuple):
    """One panel: a heat map, and crosses in cells where the loop is unstable."""

    title: str
    heat: Heat
    crosses: tuple[Array, Array]
    """speed [m/s] and friction of each"""
    description: str

    def show(self, axes: Axes) -> None:
        self.heat.show(axes)
        self.cross(axes)

    def cross(self, axes: Axes) -> None:
        axes.plot(*self.crosses, "x", color=_UNSTABLE, markersize=4.5, markeredgewidth=1.3, scalex=False, scaley=False)


def write_certificate(out_dir: str | os.PathLike[str], certificate: Certificate, *, command: str = "") -> Path:
    """Write the page on a certificate and its PNG files into `out_dir`; return the page's path.

    Raises
    ------
    StorageError
        When the files cannot be written, see `page.write_page`.
    """
    opening = Section("Verdict", [_opening(certificate)])
    sections = [
        opening,
        _analysis(certificate, command),
        _margins(certificate),
        _tunings(certificate),
        _worst(certificate),
    ]
    if certificate.mismatched:
        sections.insert(2, _mismatched(certificate))
    return write_page(out_dir, sections, title=_title(certificate), lead=[certificate.verdict])


def _title(found: Certificate) -> str:
    return f"Certificate of {found.scheduler}: {found.plant}, profile {found.profile}"


# -- the first screen -------------------------------------------------------------------------------------------------
def _opening(found: Certificate) -> Verdict:
    n, bad = len(found.points), int(found.counted.unstable.sum())
    worst, turn = extremes(found.counted.straight), int(found.counted.unstable_in_turn.sum())
    entries = [
        ("Least margins", f"modulus {number(worst['modulus_margin'])}, delay {number(1000.0 * worst['delay'])} ms, "
                          f"gain up {number(worst['gain_up'])} times"),
        ("In a hard turn", f"unstable at {number(turn)}, which does not decide"),
        ("Over", f"speed {span(found.speeds)} m/s, friction {span(found.frictions)}"),
        ("Loop", f"{found.plant}, {found.tyre} tyres, profile {found.profile}"),
        ("Against", _against(found)),
        ("How sure", "a linear analysis at these points: nothing between them, nothing at the limits of the steering"),
    ]  # fmt: skip
    text = f"Stable at all {number(n)} points driving straight." if found.passed else (
        f"Unstable at {number(bad)} of {number(n)} points driving straight."
    )  # fmt: skip
    panel = Panel(
        "Modulus margin over the speed", lambda axes: _draw_margins(found, axes),
        f"Driving straight at least {number(worst['modulus_margin'])}.",
    )  # fmt: skip
    key = [(_capital(_NAMES[driving]), stroke) for driving, stroke in _STROKES.items()]
    caption = (
        "Smallest distance of the loop gain from −1; unstable below 0. Line: the least of all frictions and other "
        "scheduling variables; band: up to the largest."
    )
    return Verdict(text, Terms(entries), Picture(caption, [panel.drawing()], key), not found.passed)


def _against(found: Certificate) -> str:
    if found.mismatched:
        bad = sum(bool((margins.radius >= 1.0).any()) for margins in found.mismatched.values())
        return f"{number(len(found.mismatched))} cars that differ from what is believed: unstable with {number(bad)}"
    if found.guarded is not None:
        return f"without the guard: unstable at {number(int(found.bare.unstable.sum()))}"
    return "the car as the controller believes it"


def _draw_margins(found: Certificate, axes: Axes) -> None:
    for driving, stroke in _STROKES.items():
        margin = found.cells(getattr(found.counted, driving).modulus_margin).reshape(len(found.speeds), -1)
        low, high = margin.min(axis=1), margin.max(axis=1)
        axes.fill_between(found.speeds, low, high, color=stroke.colour, alpha=0.18, linewidth=0.0)
        mark = "o" if len(found.speeds) < 12 else ""
        axes.plot(found.speeds, low, color=stroke.colour, linestyle=stroke.dash, marker=mark, markersize=3.5)
    axes.axhline(0.0, color=style.INK, linewidth=0.9)
    axes.set_xlabel("Speed (m/s)")
    axes.set_ylabel("Modulus margin (–)")


# -- sections ---------------------------------------------------------------------------------------------------------
def _analysis(found: Certificate, command: str) -> Section:
    words = (
        "At every point the linear closed loop with the scheduler's tuning is analysed: plant, steering lag, dead "
        "time, estimator and the law of the MPC far from its limits. It is linearised about driving straight, which "
        "decides, and about a steady turn as hard as driving gets at that speed and friction, where tyres are softer."
    )
    meaning = (
        "Spectral radius: largest magnitude of the loop's eigenvalues over one control period; stable below 1. Gain "
        "margins: factors on the steering command, up and down, at which the loop becomes unstable. Delay margin: the "
        "additional delay at which it does. Modulus margin: the smallest distance of the loop gain from −1, which "
        "bounds all other margins; 0 at the stability limit, negative for an unstable loop."
    )
    heads = [Head("Scheduler", is_text=True), *_HEADS]
    rows: list[list[Cell | str] | str] = []
    for driving in DRIVING:
        rows += [_capital(_NAMES[driving]), *(_row(name, getattr(sweep, driving)) for name, sweep in _sweeps(found))]
    items: list[Item] = [words, meaning, Table("The worst of every margin, over all points", heads, rows)]
    if found.guarded is not None:
        items.append(f"The guard changes the tuning at {percent(found.fallback.mean())} % of them.")
    return Section("All margins", [*items, *([Verbatim(command)] if command else [])])


def _mismatched(found: Certificate) -> Section:
    words = "Driving straight, with a car that differs from the one that the controller was told of, in one thing each."
    heads = [Head("True car", is_text=True), *_HEADS]
    rows = [_row(name, margins) for name, margins in found.mismatched.items()]
    return Section("Another car", [words, Table("The worst of every margin, over all points", heads, rows)])


def _row(name: str, margins: Margins) -> list[Cell | str]:
    worst, bad = extremes(margins), int((margins.radius >= 1.0).sum())
    return [
        name,
        number(len(margins.radius)),
        Cell(number(bad), warn=bad > 0),
        Cell(number(worst["radius"], 4), warn=bad > 0),
        number(worst["gain_up"]),
        number(worst["gain_down"]),
        number(1000.0 * worst["delay"]),
        number(worst["modulus_margin"]),
    ]


def _margins(found: Certificate) -> Section:
    items: list[Item] = []
    for (name, sweep), file in zip(_sweeps(found), ("margins", "margins-bare"), strict=False):
        for driving in DRIVING:
            maps, unstable = _margin_maps(found, getattr(sweep, driving))
            crosses = " A cross marks a cell with an unstable point." if unstable else ""
            title = f"{name}, {_NAMES[driving]}"
            caption = (
                f"{title}. The worst over all other scheduling variables; dark is bad, on a scale of each map's own."
                f"{crosses}"
            )
            picture = _picture(maps, caption, f"{file}{'-turn' if driving == 'turn' else ''}.png", title)
            items += [f"{title}:", picture]
    return Section("Margins", items)


def _margin_maps(found: Certificate, margins: Margins) -> tuple[list[_Map], bool]:
    """The maps of one way of driving, and whether any of its points is unstable."""
    bad = np.asarray(found.cells(margins.radius >= 1.0).max(axis=2))
    drawn = [
        (_RADIUS, found.cells(margins.radius).max(axis=2)),
        (_MODULUS, found.cells(margins.modulus_margin).min(axis=2)),
        (_UP, found.cells(margins.gain_up).min(axis=2)),
        (_DOWN, found.cells(margins.gain_down).max(axis=2)),
        (_DELAY, 1000.0 * found.cells(margins.delay).min(axis=2)),
    ]
    return [_map(found, quantity.around(values), values, bad) for quantity, values in drawn], bool(bad.any())


def _tunings(found: Certificate) -> Section:
    Np, Nc, Q, R = found.counted.tunings.T
    with np.errstate(divide="ignore"):
        ratio = np.log10(R) - np.log10(Q)
    maps = []
    for symbol, values, whole in (("$N_p$ (periods)", Np, True), ("$N_c$ (periods)", Nc, True),
                                  (r"$\log_{10} R/Q$ (R/Q in m²/rad²)", ratio, False)):  # fmt: skip
        cells = np.median(found.cells(values), axis=2)
        finite = cells[np.isfinite(cells)]
        low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 0.0)
        middle, span = (low + high) / 2.0, max(high - low, 2.0 if whole else 0.2)
        maps.append(_map(found, _Quantity(symbol, middle - span / 2.0, middle + span / 2.0, whole), cells))
    caption = "The scheduler's tuning: median over all other scheduling variables."
    if found.guarded is not None:
        share = 100.0 * found.cells(found.fallback).mean(axis=2)
        maps.append(_map(found, _Quantity("On the fallback (%)", 0.0, 100.0), share))
        caption = f"{caption[:-1]}, the guard's fallback included where it acts; and how often it does."
    return Section("Tunings", [_picture(maps, caption, "tunings.png")])


def _worst(found: Certificate) -> Section:
    names = SchedulingVariables._fields
    varied = [
        name
        for name in INPUTS
        if name not in ("speed", "friction") and np.ptp(found.points[:, names.index(name)]) > 0.0
    ]
    heads = [
        Head("Speed", "m/s"),
        Head("Friction"),
        *(Head(*INPUTS[name]) for name in varied),
        *(Head(text) for text in ("Np", "Nc")),
        Head("R/Q", "m²/rad²"),
        *(Head(text) for text in ("Radius", "Gain up", "Gain down")),
        Head("Delay", "ms"),
        Head("Modulus margin"),
    ]
    body: list[list[Cell | str] | str] = []
    for name, sweep in _sweeps(found):
        for driving in DRIVING:
            points = found.worst_points(_WORST, sweep, driving)
            body += [f"{name}, {_NAMES[driving]}", *(_point(point, varied) for point in points)]
    return Section("The worst points", [Table("The points with the smallest modulus margin", heads, body)])


def _point(point: Mapping[str, Any], varied: Sequence[str]) -> list[Cell | str]:
    up, down, delay = (math.inf if point[name] is None else point[name] for name in ("gain_up", "gain_down", "delay"))
    return [
        *(number(point[name]) for name in ("speed", "friction", *varied)),
        *(number(int(point[name])) for name in ("Np", "Nc")),
        number(point["R"] / point["Q"] if point["Q"] > 0.0 else math.inf),
        Cell(number(point["radius"], 4), warn=point["radius"] >= 1.0),
        *(number(value) for value in (up, down, 1000.0 * delay, point["modulus_margin"])),
    ]


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def _sweeps(found: Certificate) -> list[tuple[str, Sweep]]:
    if found.guarded is None:
        return [("Without a guard", found.bare)]
    return [("With the guard", found.guarded), ("Without the guard", found.bare)]


# -- drawing ----------------------------------------------------------------------------------------------------------
def _map(found: Certificate, quantity: _Quantity, values: Array, unstable: NDArray[np.bool_] | None = None) -> _Map:
    """values, unstable: (speeds, frictions)."""
    (low, high), ends = (float(values.min()), float(values.max())), (quantity.low, quantity.high)
    slack = 1e-9 * (quantity.high - quantity.low)
    below, above = low < quantity.low - slack, high > quantity.high + slack
    heat = Heat(
        Cells(edges_around(found.speeds), edges_around(found.frictions), np.clip(values, *ends).T),
        "Friction (–)",
        quantity.norm,
        whole=quantity.whole,
        extend="both" if below and above else "min" if below else "max" if above else "neither",
        colours=quantity.colours,
    )
    i, j = np.nonzero(np.zeros(values.shape, bool) if unstable is None else unstable)
    text = f"{number(low)} to {number(high)}."
    return _Map(quantity.title, heat, (found.speeds[i], found.frictions[j]), text)


def _picture(maps: Sequence[_Map], caption: str, file: str, title: str = "") -> Picture:
    panels = [Panel(each.title, each.show, each.description).drawing() for each in maps]
    return Picture(caption, panels, file=file, print_figure=lambda: _print(maps, title))


def _print(maps: Sequence[_Map], title: str) -> Figure:
    columns = 3 if len(maps) != 4 else 2
    with style.styled():
        figure, axes = style.grid_figure(-(-len(maps) // columns), columns, 2.0)
        for shown, ax in zip(maps, axes, strict=False):
            ax.set_title(shown.title)
            shown.heat.draw(ax)
            shown.cross(ax)
            shown.heat.bar(figure, ax=ax, shrink=0.95)
        for spare in axes[len(maps) :]:
            spare.remove()
        if title:
            figure.suptitle(title, x=0.01, ha="left")
    return figure

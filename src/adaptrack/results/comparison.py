"""The page on a comparison: what contenders cost on operating points and drives that nobody trained on.

Every judgement on the page is chosen by the numbers of the runs behind it.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from adaptrack.comparison.contenders import shown_as
from adaptrack.comparison.statistics import (
    Ratio,
    binned_geometric_mean,
    geometric_mean,
    importance,
    outputs_of,
    regret_percentiles,
)
from adaptrack.comparison.table import Comparison
from adaptrack.control.scheduling import Schedule
from adaptrack.results import style
from adaptrack.results.comparison_verdict import comparison_verdict
from adaptrack.results.maps import Cells, Heat, norm_of
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
    printed,
    write_page,
)
from adaptrack.results.words import INPUTS, counted, few, listed, number, percent, span, title_of

Array = NDArray[np.float64]
Comparisons = Mapping[str, Comparison]
Rows = Mapping[str, Mapping[str, Any]]
Histories = Mapping[str, list[dict[str, Any]]]
Strokes = Mapping[str, style.Stroke]
Value: TypeAlias = "float | int | str | Cell | None"
"""Of a table: a number, a count of failed runs, words, a finished cell, or nothing."""

CONSTANT, SPEED, OPTIMUM, HINDSIGHT = "best constant", "speed only", "optimum", "per-drive constant"
LEARNED = ("nn", "anfis")
MAPPED = (CONSTANT, SPEED, "look-up", *LEARNED)
"""The contenders whose regret is drawn over the domain."""

_NAMES = {
    "nn": ("NN-MPC", "NN-MPC", "networks fill the slots of the tuning; they learned from the cost of driving."),
    "anfis": ("ANFIS-MPC", "ANFIS-MPC", "neuro-fuzzy systems fill the slots; they learned in the same way."),
    CONSTANT: (
        "Best constant",
        "the best constant",
        "the one tuning that a search found best for all such runs.",
    ),
    SPEED: ("Speed only", "the speed-only schedule", "a network of the speed alone that learned in the same way."),
    "look-up": ("Look-up table", "the look-up table", "tunings at the nodes of a grid over its inputs."),
    "standard": ("Standard MPC", "the standard MPC", "the tuning of the paper's table, for everything."),
    "paper recipe nn": ("NN, paper's recipe", "the paper's recipe for NN", "learned the swarms' best tunings."),
    "paper recipe anfis": ("ANFIS, paper's recipe", "the paper's recipe for ANFIS", "likewise."),
    "default constant": ("Default constant", "the default constant", "the tuning that the controller has by itself."),
    "published": (
        "Published",
        "the published controller",
        "the paper's, with the best constant that was found for it on drives.",
    ),
    HINDSIGHT: (
        "Best constant of each drive",
        "the best constant of each drive",
        "of many constants the one that turns out best on that drive, which nobody can know before.",
    ),
    OPTIMUM: (
        "Optimum of each operating point",
        "the optimum of each operating point",
        "what a search on that point alone found, with noise of its own.",
    ),
    "speed look-up": ("Look-up table of the speed", "the look-up table of the speed", "as schedules made by hand are."),
    "best constant of operating points": (
        "Best constant of operating points",
        "the best constant of operating points",
        "the one tuning that is best on single lane changes.",
    ),
    "nn unguarded": ("NN-MPC, unguarded", "NN-MPC without its guard", "the same networks alone."),
    "anfis unguarded": ("ANFIS-MPC, unguarded", "ANFIS-MPC without its guard", "the same systems alone."),
}
"""By kind: its name in tables and in a sentence where no file gives it one, and what it is; in the strokes' order."""

_OUTPUTS = (("$N_p$", "periods"), ("$N_c$", "periods"), (r"$\log_{10} R/Q$", "R/Q in m²/rad²"))
_COUNTS = {
    "clipped": "Input clipped",
    "rate_limited": "Change limited",
    "broken": "Not a number",
    "outside": "Fallback begun, input outside",
    "off_reference": "Fallback begun, off the reference",
    "unstable": "Gave way, near instability",
    "fallback": "On the fallback",
}
_OTHERS = "All others"
_SPREAD = {"regret_p50": "P50", "regret_p90": "P90", "regret_p99": "P99", "regret_worst": "Worst"}
_BOLD = "Bold: the lowest of its column, but for what needs hindsight; no contender beside itself. "
_CEILING = 10.0
"""Regrets above this share a colour."""
_PER_CELL, _LEAST_CELLS, _MOST_CELLS = 6, 4, 12
"""Operating points that a cell of a map holds at least, on average; the least and the most cells along its axes."""
_CURVE = 400
"""Points of a distribution's curve."""
_NODES = (64, 44)
"""of a learned surface, along its axes"""


class _Compared(NamedTuple):
    """A comparison, its rows, and what one of its runs is."""

    comparison: Comparison
    rows: Rows
    noun: str

    def column(self, key: str) -> dict[str, Value]:
        return {name: row[key] for name, row in self.rows.items()}

    def intervals(self) -> dict[str, Value]:
        return {name: _between(row) for name, row in self.rows.items() if name != self.comparison.reference}


def write_comparison(
    out_dir: str | os.PathLike[str],
    *,
    operating_points: Comparisons,
    drives: Comparisons,
    tests: Comparisons,
    schedules: Mapping[str, Schedule],
    histories: Histories,
    command: str,
    notes: Sequence[str] = (),
) -> Path:
    """Write the page and its PNG files into `out_dir`; return the page's path.

    Parameters
    ----------
    operating_points, drives
        By how friction and wind are known: "exact", "noisy", "lagged", "estimated", "withheld", ... The exact one is
        compared in full; `where` of the operating points: speed, y_ref, friction, wind.
    tests
        The paper's tests, by the scenario's name.
    schedules
        By kind of contender; what "nn" and "anfis" learned is drawn.
    histories
        By kind of contender, what `improve` noted of its rounds.
    command
        The command line that makes it again.
    notes
        Limits of what was shown; a paragraph each.

    Raises
    ------
    StorageError
        When the files cannot be written, see `page.write_page`.
    """
    known = {"operating point": operating_points, "drive": drives}
    compared = [_compared(found["exact"], noun) for noun, found in known.items() if "exact" in found]
    opening = _opening(compared, tests)
    sections = [
        *opening,
        *(_on_operating_points(each) if each.noun == "operating point" else _on_drives(each) for each in compared),
        *_spread(compared),
        *_perceived(known),
        *_tested(tests),
        *_learned(schedules),
        *_learning(histories, {kind: shown_as(kind, schedules) for kind in histories}),
        *_interventions(compared),
        *([Section("Limits", list(notes))] if notes else []),
        Section("How it was made", ["This command makes it again:", Verbatim(command)]),
    ]
    said = [" ".join(filter(None, (standing(*each), against_constant(*each), failures(*each)))) for each in compared]
    said += [knowledge(found, noun) for noun, found in known.items()]
    words = [each for each in (*said, on_tests(tests)) if each]
    words = words or ["Nothing was driven: there are no costs to compare."]
    sections.insert(len(opening) + len(compared), Section("In words", words))
    return write_page(out_dir, sections, title=_title(compared, tests))


def _opening(compared: Sequence[_Compared], tests: Comparisons) -> list[Section]:
    """The verdict: on the drives, else on the operating points, else on the first of the paper's tests."""
    main = [
        *reversed(compared),
        *(_compared(each, f"{title_of(n).lower()} run") for n, each in tests.items()),
    ]
    if not main:
        return []
    (comparison, _, noun), *others = main
    further = [
        f"on {counted(_runs(other.comparison), other.noun)}: {_label(other.comparison.best[0])}" for other in others[:2]
    ]
    return [Section("Verdict", [comparison_verdict(comparison, noun, comparison.best, _label, further)])]


def _title(compared: Sequence[_Compared], tests: Comparisons) -> str:
    """The controller and what was driven."""
    comparisons = [*(each.comparison for each in compared), *tests.values()]
    controllers = dict.fromkeys(each.role(who).controller for each in comparisons for who in each.costs)
    driven = [counted(_runs(each.comparison), each.noun) for each in compared]
    driven += ["the paper's tests"] if tests else []
    if not driven:
        return "What adaptation pays"
    return f"What adaptation pays: {few(controllers, 'controller', 2)}, {listed(driven)}"


def _compared(comparison: Comparison, noun: str) -> _Compared:
    return _Compared(comparison, {row["contender"]: row for row in comparison.rows()}, noun)


# -- judgements, chosen by the numbers --------------------------------------------------------------------------------
def standing(comparison: Comparison, rows: Rows, noun: str) -> str:
    """Which contender is best, and how it and the learned ones stand to reference, best constant and speed only."""
    first, *level = comparison.best
    head = f"On {counted(_runs(comparison), noun)} that nobody trained on, {_said(first)} is best"
    sentences = [f"{head}, level with {listed([_said(each) for each in level])}." if level else f"{head}."]
    against = [each for each in (comparison.reference, CONSTANT) if each in comparison.costs]
    against = list(dict.fromkeys([*against, *comparison.of_kind(SPEED)]))
    for who in dict.fromkeys((first, *comparison.of_kind(*LEARNED))):
        others = [other for other in against if other != who]
        if not others:
            continue
        ratios = [f"{number(comparison.mean_ratio(who, other))} times {_said(other)}" for other in others]
        if who != first:
            sentences.append(f"{_said(who)} costs {listed(ratios)}.")
            continue
        if others[0] == comparison.reference:
            ratios[0] += f" (95 % interval {_between(rows[who])})"
        sentences.append(f"In the geometric mean it costs {listed(ratios)}.")
        if comparison.reference == OPTIMUM:
            p90, worst = (f"{number(rows[who][f'regret_{key}'])} times the optimum" for key in ("p90", "worst"))
            sentences.append(f"On a tenth of the {noun}s it costs {p90} or more, at worst {worst}.")
    return " ".join(sentences)


def against_constant(comparison: Comparison, rows: Rows, noun: str) -> str:
    """Which adaptive contenders do not beat the best constant."""
    if CONSTANT not in comparison.costs or not comparison.adaptive:
        return ""
    beside = {who: comparison.ratio(who, CONSTANT) for who in comparison.adaptive}
    unbeaten = [_unbeaten(_said(who), it) for who, it in beside.items() if it.verdict != "cheaper"]
    if unbeaten:
        return f"Not every adaptive controller beats the best constant on these {noun}s: {listed(unbeaten)}."
    return f"Every adaptive controller beats the best constant on these {noun}s."


def failures(comparison: Comparison, rows: Rows, noun: str) -> str:
    """Who failed, and how often."""
    failed = {who: row["failures"] for who, row in rows.items()}
    total = counted(_runs(comparison), noun)
    if not any(failed.values()):
        return f"No controller failed in any of {total}."
    named = listed([f"{_said(who)} in {number(count)}" for who, count in failed.items() if count])
    return f"Failed: {named} of {total}{'' if all(failed.values()) else '; no other'}."


def knowledge(perceptions: Comparisons, noun: str) -> str:
    """What it costs the learned contenders not to know friction and wind exactly; empty where they are."""
    clauses, unbeaten, failed, compared = [], [], [], False
    for who in dict.fromkeys(who for each in perceptions.values() for who in each.of_kind(*LEARNED)):
        known = {name: comparison for name, comparison in perceptions.items() if who in comparison.costs}
        if not set(known) - {"exact"}:
            continue
        means = {name: geometric_mean(comparison.regret(who)) for name, comparison in known.items()}
        worst = max(means, key=lambda name: means[name])
        chosen: dict[str, str] = {name: name for name in ("exact", "estimated", "withheld") if name in means}
        chosen.setdefault(worst, f"{worst}, the worst")
        parts = listed([f"{number(means[name])} ({how})" for name, how in chosen.items()])
        clauses.append(f"{_said(who)} costs {parts} times {_said(next(iter(known.values())).reference)}")
        beside = {
            name: comparison.ratio(who, CONSTANT) for name, comparison in known.items() if CONSTANT in comparison.costs
        }
        unbeaten += [_unbeaten(f"{_said(who)}, {name},", it) for name, it in beside.items() if it.verdict != "cheaper"]
        compared |= bool(beside)
        counts = {name: int((comparison.failures[who] > 0.0).sum()) for name, comparison in known.items()}
        failed += [f"{_said(who)} in {count} ({name})" for name, count in counts.items() if count]
    sentences = [f"By how friction and wind are known on these {noun}s, {'; '.join(clauses)}."] if clauses else []
    if unbeaten:
        sentences.append(f"The best constant is not always beaten: {listed(unbeaten)}.")
    elif compared:
        sentences.append("However they are known, the best constant costs more.")
    if failed:
        sentences.append(f"Failed: {listed(failed)} of the {noun}s.")
    return " ".join(sentences)


def on_tests(tests: Comparisons) -> str:
    """How the learned contenders do on the paper's tests, and what hindsight would reach there."""
    sentences = []
    for name, comparison in tests.items():
        if CONSTANT not in comparison.costs:
            continue
        beside = {who: comparison.ratio(who, CONSTANT) for who in comparison.of_kind(*LEARNED)}
        known_after = [who for who in comparison.costs if comparison.role(who).hindsight]
        floor = [comparison.mean_ratio(who, CONSTANT) for who in known_after]
        if not beside:
            continue
        costs = listed([f"{_said(who)} costs {number(it.mean)} times" for who, it in beside.items()])
        said = [f"On the paper's {title_of(name).lower()} {costs} the best constant"]
        said += [f"the best tuning in hindsight costs {number(min(floor))} times"] if floor else []
        level = [_said(who) for who, it in beside.items() if it.verdict != "cheaper"]
        said += [f"{listed(level)} {'does' if len(level) == 1 else 'do'} not beat it"] if level else []
        failed = [_said(who) for who in beside if comparison.failures[who].any()]
        said += [f"{listed(failed)} failed"] if failed else []
        sentences.append(f"{'; '.join(said)}.")
    return " ".join(sentences)


def _unbeaten(who: str, it: Ratio) -> str:
    how = "is level with it" if it.verdict == "level" else "costs more"
    return f"{who} {how} ({number(it.mean)} times, {number(it.low)} to {number(it.high)})"


# -- sections ---------------------------------------------------------------------------------------------------------
def _on_operating_points(found: _Compared) -> Section:
    comparison = found.comparison
    words = (
        f"Regret is the cost over that of {_said(comparison.reference)} on the same operating point. Costs are means "
        "over noise that neither tuning nor learning has met; a failed run counts as "
        f"{_failed_cost(comparison)} m²."
    )
    if comparison.reference == OPTIMUM:
        words += " The optimum was chosen on other noise, so a regret somewhat below 1 can occur."
    columns = {
        Head("Regret", "geometric mean"): found.column("regret_geomean"),
        Head("95 % interval"): found.intervals(),
        **{Head(text): found.column(key) for key, text in _SPREAD.items()},
        Head("Failed", f"of {number(_runs(comparison))}"): found.column("failures"),
    }
    table = _table("Regret on single operating points", columns, comparison, _BOLD + _failed(comparison))
    return Section("Operating points", [words, table, _meanings(comparison), *_maps(comparison)])


def _on_drives(found: _Compared) -> Section:
    comparison = found.comparison
    words = (
        "A drive is a random road: speed that varies, patches of other friction, gusts, lane changes and curves. Costs "
        f"are means over noise that neither tuning nor learning has met; a failed drive counts as "
        f"{_failed_cost(comparison)} m²."
    )
    over = f"/ {comparison.reference}"
    columns = {
        Head("Cost", "geometric mean, m²"): found.column("cost_geomean"),
        Head("Cost", over): found.column("regret_geomean"),
        Head("95 % interval", over): found.intervals(),
        Head("P90", over): found.column("regret_p90"),
        Head("Worst", over): found.column("regret_worst"),
        Head("Cost", "/ speed only"): _ratios(comparison, *comparison.of_kind(SPEED)),
        Head("Failed", f"of {number(_runs(comparison))}"): found.column("failures"),
    }
    table = _table("Cost of long drives", columns, comparison, _BOLD + _failed(comparison))
    return Section("Drives", [words, table, _meanings(comparison)])


def _meanings(comparison: Comparison) -> Terms:
    kinds = {who: _kind(comparison, who) for who in comparison.costs}
    told = [(_label(who), _NAMES[kind][2]) for who, kind in kinds.items() if kind in _NAMES]
    return Terms(told, "What the contenders are")


def _maps(comparison: Comparison) -> list[Item]:
    """The regret of the main contenders over speed and friction, and over speed and the reference."""
    contenders = [who for who in comparison.of_kind(*MAPPED) if who != comparison.reference]
    if not contenders:
        return []
    least = _PER_CELL * _LEAST_CELLS**2
    if _runs(comparison) < least:
        return [f"Maps of the regret over the domain need {number(least)} operating points or more."]
    speed, y_ref, friction = comparison.where[:, 0], np.abs(comparison.where[:, 1]), comparison.where[:, 2]
    over = {"friction": (friction, "Friction (–)"), "lateral reference": (y_ref, r"$|y_\mathrm{ref}|$ (m)")}
    grids = {
        (r, name): _mean_regret(comparison.regret(r), speed, y) for r in contenders for name, (y, _) in over.items()
    }
    means = np.concatenate([grid.values.ravel() for grid in grids.values()])
    low, high = min(1.0, float(np.nanmin(means))), float(np.nanmax(means))
    norm = LogNorm(low, max(min(high, _CEILING), 1.2 * low))
    beyond = "max" if high > _CEILING else "neither"
    heats = {(who, name): Heat(grid, over[name][1], norm, extend=beyond) for (who, name), grid in grids.items()}
    panels = [
        Panel(_label(who), heat.show, f"Geometric mean regret over speed and {name}: {span(heat.cells.values)}.")
        for (who, name), heat in heats.items()
    ]
    with style.styled():
        figure, axes = style.grid_figure(len(over), len(contenders), 1.75)
        for ax, (who, name) in zip(axes, ((who, name) for name in over for who in contenders), strict=True):
            heats[who, name].draw(ax)
            first_row, first_column = ax in axes[: len(contenders)], who == contenders[0]
            ax.set_title(_label(who) if first_row else "")
            ax.set_xlabel("" if first_row else "Speed (m/s)")
            ax.set_ylabel(over[name][1] if first_column else "")
        bar = next(iter(heats.values())).bar(figure, ax=axes, location="bottom", aspect=50, shrink=0.7, pad=0.02)
        bar.set_label("Regret (–)")
    caption = (
        "Regret over the domain: geometric mean of all operating points in a cell, whatever their other two numbers; "
        "left over friction, right over the size of the reference. All maps share one logarithmic scale of colours"
        f"{f', which ends at {_CEILING:g}' if high > _CEILING else ''}."
    )
    return [Picture(caption, [panel.drawing() for panel in panels], file="regret-map.png", print_figure=lambda: figure)]


def _spread(compared: Sequence[_Compared]) -> list[Section]:
    """The distribution of what single runs cost."""
    compared = [each for each in compared if len(each.comparison.costs) > 1]
    if not compared:
        return []
    drawn = [_drawn(each.comparison) for each in compared]
    kinds = {who: _kind(each.comparison, who) for each, whom in zip(compared, drawn, strict=True) for who in whom}
    strokes = _few_strokes(kinds, [who for each in compared for who in each.comparison.best])
    panels = []
    for (comparison, _, noun), contenders in zip(compared, drawn, strict=True):
        ratios = {who: comparison.regret(who) for who in contenders}
        spread = {who: regret_percentiles(regret) for who, regret in ratios.items()}
        described = " ".join(
            f"{_label(who)}: median {number(each['p50'])}, nine tenths below {number(each['p90'])}."
            for who, each in spread.items()
        )
        over = "Regret (–)" if comparison.reference == OPTIMUM else f"Cost / {comparison.reference} (–)"
        main = [who for who in contenders if _kind(comparison, who) in MAPPED]
        draw = partial(_draw_distribution, ratios, strokes, main, (over, f"{noun.capitalize()}s (%)"))
        panels.append(Panel(f"{noun.capitalize()}s", draw, f"{over}, logarithmic, and the share below. {described}"))
    caption = (
        "Share of the runs that cost at most so many times the reference, which is the upright line: further left is "
        "better. What lies far out is cut off."
    )
    strokes = {who: each for who, each in strokes.items() if each != style.BACKGROUND} | (
        {_OTHERS: style.BACKGROUND} if style.BACKGROUND in strokes.values() else {}
    )
    return [Section("Run by run", [_picture(caption, panels, strokes, "spread.png")])]


def _drawn(comparison: Comparison) -> list[str]:
    """All but the reference; beside what has a guard, the same without it is hard to see."""
    others = [who for who in comparison.costs if who != comparison.reference]
    return [who for who in others if not _kind(comparison, who).endswith(" unguarded")]


def _perceived(known: Mapping[str, Comparisons]) -> list[Section]:
    """What not knowing friction and wind exactly costs the contenders that look at them; known: by what a run is."""
    tables = [_perceived_table(noun, comparisons) for noun, comparisons in known.items() if _lookers(comparisons)]
    words = (
        "Cars measure neither friction nor wind. Here schedulers know them otherwise than as they are; the "
        "runs of a table are the same in every row."
    )
    return [Section("What a car really knows", [words, *tables])] if tables else []


def _lookers(perceptions: Comparisons) -> list[str]:
    """The contenders that may look at friction and wind, where those are not known exactly."""
    others = [comparison for name, comparison in perceptions.items() if name != "exact"]
    looking = (who for each in others for who in each.adaptive if each.role(who).kind != SPEED)
    return list(dict.fromkeys(looking))


def _perceived_table(noun: str, perceptions: Comparisons) -> Table:
    first = next(iter(perceptions.values()))
    exact = perceptions["exact"].costs if "exact" in perceptions else {}
    over = f"/ {first.reference}"
    heads = [Head("Friction and wind", is_text=True), Head("Cost", over), Head("P90", over), Head("Worst", over)]
    heads += [Head("Cost", "/ best constant")] if first.reference != CONSTANT else []
    heads += [Head("Cost", "/ exact"), Head("Failed", f"of {number(_runs(first))}")]
    body: list[Sequence[Cell | str] | str] = []
    for who in _lookers(perceptions):
        body.append(_label(who))
        for name, comparison in perceptions.items():
            if who not in comparison.costs:
                continue
            regret = comparison.regret(who)
            spread = regret_percentiles(regret)
            cells: list[Value] = [geometric_mean(regret), spread["p90"], spread["worst"]]
            cells += [_ratios(comparison, CONSTANT).get(who)] if first.reference != CONSTANT else []
            cells.append(geometric_mean(comparison.costs[who] / exact[who]) if who in exact else None)
            cells.append(int((comparison.failures[who] > 0.0).sum()))
            body.append([title_of(name), *map(_cell, cells)])
    caption = f"Imperfect knowledge of friction and wind: {noun}s"
    return Table(caption, heads, body, f"Cost: geometric mean. {_failed(first)}")


def _tested(tests: Comparisons) -> list[Section]:
    if not tests:
        return []
    heads = [Head("Contender", is_text=True), Head("Cost", "m²"), Head("Cost", "/ best constant")]
    heads += [Head("Cost", "/ speed only"), Head("Failed", "% of noise seeds")]
    body: list[Sequence[Cell | str] | str] = []
    for name, comparison in tests.items():
        means: dict[str, Value] = {who: geometric_mean(costs) for who, costs in comparison.costs.items()}
        shares = {who: float(each.mean()) for who, each in comparison.failures.items()}
        failed: dict[str, Value] = {who: Cell(percent(share), warn=share > 0.0) for who, share in shares.items()}
        columns = [means, _ratios(comparison, CONSTANT), _ratios(comparison, *comparison.of_kind(SPEED)), failed]
        body += [title_of(name), *_body(columns, comparison)]
    words = "The signals of the paper's two tests, on the plant, the sensors and the actuator of the road profile."
    return [Section("The paper's tests", [words, Table("Cost on the paper's tests", heads, body, _BOLD.strip())])]


def _learned(schedules: Mapping[str, Schedule]) -> list[Section]:
    """The tuning over speed and the input that matters most beside it, without the guard."""
    drawn = {
        shown_as(kind, schedules): replace(schedules[kind], guard=None)
        for kind in LEARNED
        if kind in schedules and "speed" in schedules[kind].inputs and len(schedules[kind].inputs) > 1
    }
    if not drawn:
        return []
    shares = {name: importance(schedule) for name, schedule in drawn.items()}
    inputs = dict.fromkeys(each for share in shares.values() for each in share)
    total = {each: sum(share.get(each, 0.0) for share in shares.values()) for each in inputs}
    other = {n: max((i for i in shares[n] if i != "speed"), key=lambda i: total[i]) for n in drawn}
    surfaces = {name: _surface(schedule, other[name]) for name, schedule in drawn.items()}
    heats: dict[tuple[str, int], Heat] = {}
    for k in range(len(_OUTPUTS)):
        norm = norm_of(surface[..., k] for surface in surfaces.values())
        for name, schedule in drawn.items():
            speed, beside = (np.array(_domain(schedule, each)) for each in ("speed", other[name]))
            cells = Cells(speed, beside, surfaces[name][..., k])
            heats[name, k] = Heat(cells, _axis(other[name]), norm, whole=k < 2, smooth=True)
    panels = [
        Panel(
            f"{_label(name)}: {_OUTPUTS[k][0]} ({_OUTPUTS[k][1]})",
            heat.show,
            f"Over speed and {INPUTS[other[name]][0].lower()}: {span(heat.cells.values)}.",
        )
        for (name, k), heat in heats.items()
    ]
    with style.styled():
        figure, axes = style.grid_figure(len(drawn), len(_OUTPUTS), 2.1)
        order = list(drawn)
        for ax, (name, k) in zip(axes, sorted(heats, key=lambda key: order.index(key[0])), strict=True):
            heats[name, k].draw(ax)
            ax.set_title(f"{_label(name)}: {_OUTPUTS[k][0]}")
            ax.set_ylabel("" if k else _axis(other[name]))
            heats[name, k].bar(figure, ax=ax, aspect=22)
    caption = (
        "The learned tuning over speed and the input that moves it most beside the speed, with the other inputs in the "
        "middle of their domain and without the guard. Pictures of the same number share their colours."
    )
    table = Table(
        "What moves the tuning",
        [Head("Input", is_text=True), *(Head(_label(name), "%") for name in shares)],
        [
            [_axis(each), *(percent(share[each]) if each in share else "–" for share in shares.values())]
            for each in sorted(inputs, key=lambda each: -total[each])
        ],
        "Share of the variance over the domain in which an input has a part, alone or with others (total Sobol index), "
        "mean over Np, Nc and log R/Q; parts that inputs have together count for each of them.",
    )
    drawings = [panel.drawing() for panel in panels]
    picture = Picture(caption, drawings, file="surfaces.png", print_figure=lambda: figure)
    return [Section("What was learned", [picture, table])]


def _learning(histories: Histories, names: Mapping[str, str]) -> list[Section]:
    """How the cost of the held-out runs fell; names: of the contenders, by kind."""
    shown = {names[kind]: history for kind, history in histories.items() if history}
    if not shown:
        return []
    strokes = _strokes({names[kind]: kind for kind, history in histories.items() if history})
    costs = {name: [(check["round"], math.exp(check["score"])) for check in checks] for name, checks in shown.items()}
    failing = {name: [(check["round"], check["failed"]) for check in checks] for name, checks in shown.items()}
    words = [_progress_of(name, costs[name], shown[name]) for name in shown]
    draw = partial(_draw_learning, costs, strokes, "Cost (m²)")
    panels = [Panel("Cost of the held-out runs", draw, f"Geometric mean over the rounds. {' '.join(words)}")]
    if any(check["failed"] for checks in shown.values() for check in checks):
        draw = partial(_draw_learning, failing, strokes, "Failed runs (–)")
        counts = " ".join(f"{_label(n)}: {line[0][1]:g} to {line[-1][1]:g}." for n, line in failing.items())
        panels.append(Panel("Held-out runs that failed", draw, f"Number over the rounds. {counts}"))
    caption = "What held-out runs cost after each check, in the geometric mean; the schedule with the lowest was kept."
    return [Section("How it was learned", [" ".join(words), _picture(caption, panels, strokes, "learning.png")])]


def _progress_of(name: str, costs: Sequence[tuple[float, float]], history: Sequence[Mapping[str, Any]]) -> str:
    """From where to where learning went, and whether it was still going."""
    kept = min(range(len(costs)), key=lambda i: costs[i][1])
    (first, high), (best_round, low) = costs[0], costs[kept]
    failed = f"; {history[kept]['failed']:g} of them fail" if history[kept]["failed"] else ""
    fell = f"{number(high)} m² after round {first:g} and {number(low)} m² after round {best_round:g}"
    kept_how = ", the last, so more rounds may help" if 0 < kept == len(costs) - 1 else ", which was kept"
    return f"With {_said(name)} the held-out runs cost {fell}{kept_how}{failed}."


def _interventions(compared: Sequence[_Compared]) -> list[Section]:
    """How often inputs were clipped, and how often the guard stepped in."""
    body: list[Sequence[Cell | str] | str] = []
    for each in compared:
        counted = {who: counts for who, counts in each.comparison.overall.items() if counts}
        body += [f"{each.noun.capitalize()}s"] if counted else []
        for who, counts in counted.items():
            body.append([_label(who), *(percent(counts[key]) if key in counts else "–" for key in _COUNTS)])
    if not body:
        return []
    heads = [Head("Contender", is_text=True), *(Head(text, "% of steps") for text in _COUNTS.values())]
    note = "With the first of the noise seeds. Clipped: held within the domain that the schedule was made for."
    return [Section("What the guard did", [Table("Interventions", heads, body, note)])]


# -- tables -----------------------------------------------------------------------------------------------------------
def _table(caption: str, columns: Mapping[Head, Mapping[str, Value]], comparison: Comparison, note: str) -> Table:
    """A row for each contender; columns that are empty are left out, and the lowest number of each is bold."""
    shown = {head: values for head, values in columns.items() if values}
    return Table(caption, [Head("Contender", is_text=True), *shown], _body(list(shown.values()), comparison), note)


def _body(columns: Sequence[Mapping[str, Value]], comparison: Comparison) -> list[list[Cell | str]]:
    def hindsight(who: str) -> bool:
        return comparison.role(who).hindsight

    contenders = list(comparison.costs)
    body: list[list[Cell | str]] = [[_label(who)] for who in contenders]
    for values in columns:
        judged = (v for who, v in values.items() if not hindsight(who) and isinstance(v, float))
        least = min(judged, default=None)
        for row, who in zip(body, contenders, strict=True):
            itself = values.get(who) == 1.0  # a ratio of a contender to itself is no achievement
            row.append(_cell(values.get(who), not hindsight(who) and not itself and values.get(who) == least))
    return body


def _cell(value: Value, strong: bool = False) -> Cell:
    if isinstance(value, str | Cell):
        return value if isinstance(value, Cell) else Cell(value)
    return Cell(number(value), strong=strong and isinstance(value, float), warn=isinstance(value, int) and value > 0)


# -- numbers ----------------------------------------------------------------------------------------------------------
def _surface(schedule: Schedule, other: str) -> Array:
    """(nodes of `other`, nodes of speed, 3) the tuning, the remaining inputs in the middle of their domain."""
    columns, rows = _NODES
    x = np.broadcast_to(schedule.domain.mean(axis=1), (rows, columns, len(schedule.inputs))).copy()
    x[..., schedule.inputs.index("speed")] = np.linspace(*_domain(schedule, "speed"), columns)
    x[..., schedule.inputs.index(other)] = np.linspace(*_domain(schedule, other), rows)[:, np.newaxis]
    return outputs_of(schedule, x.reshape(-1, x.shape[-1])).reshape(rows, columns, 3)


def _domain(schedule: Schedule, name: str) -> tuple[float, float]:
    low, high = schedule.domain[schedule.inputs.index(name)].tolist()
    return (low, high) if high > low else (low - 0.5, high + 0.5)


def _mean_regret(regret: Array, x: Array, y: Array) -> Cells:
    cells = int(np.clip(math.sqrt(len(regret) / _PER_CELL), _LEAST_CELLS, _MOST_CELLS))
    return Cells(*binned_geometric_mean(regret, x, y, cells))


def _ratios(comparison: Comparison, other: str = "") -> dict[str, Value]:
    """By contender, the geometric mean of its cost over that of `other`; empty without that one."""
    return {who: comparison.mean_ratio(who, other) for who in comparison.costs} if other in comparison.costs else {}


def _failed_cost(comparison: Comparison) -> str:
    return f"{comparison.failure.distance**2:g}"


def _failed(comparison: Comparison) -> str:
    """When a run has failed."""
    rule = comparison.failure
    return (
        f"Failed: more than {rule.distance:g} m off the reference, or spun (sideslip above "
        f"{math.degrees(rule.sideslip):.0f} degrees), with any of the noise seeds."
    )


def _runs(comparison: Comparison) -> int:
    return len(comparison.costs[comparison.reference])


# -- words ------------------------------------------------------------------------------------------------------------
def _label(who: str) -> str:
    """A contender in tables: one that is called as its file stays as it is."""
    return _NAMES[who][0] if who in _NAMES else who


def _kind(comparison: Comparison, who: str) -> str:
    return comparison.role(who).kind


def _said(who: str) -> str:
    """A contender inside a sentence."""
    return _NAMES[who][1] if who in _NAMES else who


def _between(row: Mapping[str, Any]) -> str:
    """The interval of a contender's regret, with as many digits as tell its ends apart."""
    low, high = row["regret_low"], row["regret_high"]
    digits = 3 if number(low) != number(high) else 4
    return f"{number(low, digits)} to {number(high, digits)}"


def _axis(name: str) -> str:
    return "{} ({})".format(*INPUTS[name])


def _strokes(kinds: Mapping[str, str]) -> dict[str, style.Stroke]:
    """The strokes of contenders (by name, with their kinds), alike in all pictures.

    The paper's recipe is dashed, in its model's colour.
    """
    of_kinds = {who: kind if kind in _NAMES else who for who, kind in kinds.items()}
    known = style.strokes([*_NAMES, *dict.fromkeys(of_kinds.values())])
    return {who: known[kind] for who, kind in of_kinds.items()}


def _few_strokes(kinds: Mapping[str, str], first: Sequence[str]) -> dict[str, style.Stroke]:
    """Strokes of contenders in a picture of all: a colour each for as many as there are colours, the rest in grey.

    kinds: by contender; first: who has a colour in any case where there are enough. Then come the main kinds.
    """
    order = {kind: i for i, kind in enumerate(_NAMES)}
    ranked = sorted(kinds, key=lambda who: (kinds[who] not in MAPPED, who not in first))
    shown = sorted(ranked[: len(style.SERIES)], key=lambda who: order.get(kinds[who], len(order)))
    return style.strokes(shown) | {who: style.BACKGROUND for who in kinds if who not in shown}


# -- drawing ----------------------------------------------------------------------------------------------------------
def _draw_distribution(
    ratios: Mapping[str, Array], strokes: Strokes, main: Sequence[str], labels: tuple[str, str], axes: Axes
) -> None:
    """main: those whose spread decides what is shown; labels: of the axes."""
    axes.axvline(1.0, color=style.MUTED, linewidth=0.7)
    for who, values in ratios.items():
        levels = np.linspace(0.0, 1.0, min(len(values), _CURVE) + 1)[1:]
        placed = np.quantile(values, levels, method="inverted_cdf")
        x, y = np.concatenate([placed[:1], placed]), 100.0 * np.concatenate([[0.0], levels])
        axes.step(x, y, where="post", color=strokes[who].colour, linestyle=strokes[who].dash)
    shown = [0.9, 1.1, *(np.clip(np.median(values), 0.1, _CEILING) for values in ratios.values())]
    for who in main:
        shown += np.clip(np.quantile(ratios[who], (0.005, 0.97)), 0.05, 5.0 * _CEILING).tolist()
    style.logarithmic(axes, "x", (min(shown), max(shown)))
    axes.set_ylim(0.0, 103.0)
    axes.set_xlabel(labels[0])
    axes.set_ylabel(labels[1])


def _draw_learning(
    lines: Mapping[str, Sequence[tuple[float, float]]], strokes: Strokes, label: str, axes: Axes
) -> None:
    for name, line in lines.items():
        stroke = strokes[name]
        axes.plot(*np.transpose(line), color=stroke.colour, linestyle=stroke.dash, marker="o", markersize=3.0)
    axes.set_xmargin(0.03)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, steps=style.ROUND))
    if all(value == round(value) for line in lines.values() for _, value in line):
        axes.yaxis.set_major_locator(MaxNLocator(nbins=5, integer=True, steps=style.ROUND))
    axes.set_xlabel("Round (–)")
    axes.set_ylabel(label)


def _picture(caption: str, panels: Sequence[Panel], strokes: Strokes, file: str) -> Picture:
    """Panels with a common legend, side by side in print."""
    key = [(_label(who), stroke) for who, stroke in strokes.items()]
    drawings = [panel.drawing() for panel in panels]
    return Picture(caption, drawings, key, file, lambda: printed(panels, len(panels), 2.8, key))

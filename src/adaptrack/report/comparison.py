"""The page on the ladder: what every way of tuning costs on conditions and drives that nobody trained on.

Every judgement on the page is chosen by the numbers of the runs behind it.
"""

from __future__ import annotations

import math
import os
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from adaptrack.closed_loop import LOST_BEYOND, LOST_COST
from adaptrack.evaluate.ladder import Ladder
from adaptrack.mpc import Condition
from adaptrack.report import style
from adaptrack.report.maps import Cells, Heat, norm_of
from adaptrack.report.page import Cell, Head, Panel, Picture, Section, Table, Terms, Verbatim, printed, write_page
from adaptrack.report.words import INPUTS, counted, listed, number, percent, span, title_of
from adaptrack.schedule import Schedule

Array = NDArray[np.float64]
Ladders = Mapping[str, Ladder]
Rows = Mapping[str, Mapping[str, Any]]
Histories = Mapping[str, list[dict[str, Any]]]
Strokes = Mapping[str, style.Stroke]
Value: TypeAlias = "float | int | str | Cell | None"
"""Of a table: a number, a count of lost runs, words, a finished cell, or nothing."""

CONSTANT, SPEED, OPTIMUM, HINDSIGHT = "best constant", "speed only", "optimum", "per-drive constant"
LEARNED = ("nn", "anfis")
MAPPED = (CONSTANT, SPEED, "look-up", *LEARNED)
"""The rungs whose regret is drawn over the domain."""
FIXED = ("standard", CONSTANT, OPTIMUM, HINDSIGHT)
"""The rungs that do not change the tuning while driving."""
_UNKNOWABLE = (OPTIMUM, HINDSIGHT)

_RUNGS = {
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
    HINDSIGHT: (
        "Best constant of each drive",
        "the best constant of each drive",
        "of many constants the one that turns out best on that drive, which nobody can know before.",
    ),
    OPTIMUM: (
        "Optimum of each condition",
        "the optimum of each condition",
        "what a search on that condition alone found, with noise of its own.",
    ),
    "speed look-up": ("Look-up table of the speed", "the look-up table of the speed", "as schedules made by hand are."),
    "best constant of conditions": (
        "Best constant of conditions",
        "the best constant of conditions",
        "the one tuning that is best on single lane changes.",
    ),
    "nn unguarded": ("NN-MPC, unguarded", "NN-MPC without its guard", "the same networks alone."),
    "anfis unguarded": ("ANFIS-MPC, unguarded", "ANFIS-MPC without its guard", "the same systems alone."),
}
"""By rung: its name in tables, in a sentence, and what it is; their order gives the strokes."""

_OUTPUTS = (("$N_p$", "periods"), ("$N_c$", "periods"), (r"$\log_{10} R/Q$", "R/Q in m²/rad²"))
_COUNTS = {
    "clipped": "Input clipped",
    "rate_limited": "Change limited",
    "broken": "Not a number",
    "outside": "Fallback begun, input outside",
    "astray": "Fallback begun, offset too large",
    "unstable": "Gave way, near instability",
    "fallback": "On the fallback",
}
_SPREAD = {"regret_p50": "P50", "regret_p90": "P90", "regret_p99": "P99", "regret_worst": "Worst"}
_BOLD = "Bold: the lowest of its column, but for what needs hindsight. "
_LOST = f"Lost: more than {LOST_BEYOND:g} m off the reference, or spun, with any of the noise seeds."

_CEILING = 10.0
"""Regrets above this share a colour."""
_PER_CELL, _MOST_CELLS = 6, 12
"""Conditions that a cell of a map holds at least, on average; and the most cells along one of its axes."""
_CURVE = 400
"""Points of a distribution's curve."""
_NODES = (64, 44)
"""of a learned surface, along its axes"""


class Ratio(NamedTuple):
    """Geometric mean of one rung's cost over another's on the same runs, and its 95 % interval."""

    mean: float
    low: float
    high: float

    @property
    def verdict(self) -> str:
        """cheaper, dearer, or level: the interval holds 1."""
        return "cheaper" if self.high < 1.0 else "dearer" if self.low > 1.0 else "level"


class _Told(NamedTuple):
    """A ladder, its rows, and what one of its runs is."""

    ladder: Ladder
    rows: Rows
    noun: str

    def column(self, key: str) -> dict[str, Value]:
        return {rung: row[key] for rung, row in self.rows.items()}

    def intervals(self) -> dict[str, Value]:
        return {rung: _between(row) for rung, row in self.rows.items() if rung != self.ladder.reference}


def write_ladder(
    out_dir: str | os.PathLike[str],
    *,
    conditions: Ladder | None,
    drives: Ladder | None,
    perceptions: Ladders,
    drive_perceptions: Ladders | None = None,
    tests: Ladders,
    schedules: Mapping[str, Schedule],
    histories: Histories,
    command: str,
    notes: Sequence[str] = (),
) -> Path:
    """Write the page and its PNG files into `out_dir`; return the page's path.

    Parameters
    ----------
    conditions, drives
        What every rung costs on single conditions (`where`: speed, y_ref, friction, wind) and on long drives.
    perceptions
        The conditions with friction and wind told "exact", "noisy", "lagged", "estimated", "withheld", ...; where
        `conditions` is None and no `drive_perceptions` are given, these are taken to be drives.
    drive_perceptions
        The drives, likewise.
    tests
        The paper's tests, by the scenario's name.
    schedules
        By rung; what "nn" and "anfis" learned is drawn.
    histories
        By rung, what `closed_loop.improve` noted of its rounds.
    command
        The command line that makes it again.
    notes
        Limits of what was shown; a paragraph each.

    Raises
    ------
    StorageError
        When the files cannot be written, see `page.write_page`.
    """
    climbed = [
        _Told(ladder, {row["scheduler"]: row for row in ladder.rows()}, noun)
        for ladder, noun in ((conditions, "condition"), (drives, "drive"))
        if ladder is not None
    ]
    known = {"condition": perceptions, "drive": drive_perceptions or {}}
    if conditions is None and not drive_perceptions:
        known = {"drive": perceptions}
    sections = [
        *(_on_conditions(told) if told.noun == "condition" else _on_drives(told) for told in climbed),
        *_spread(climbed),
        *_perceived(known),
        *_tested(tests),
        *_learned(schedules),
        *_learning(histories),
        *_interventions(climbed),
        *([Section("Limits", list(notes))] if notes else []),
        Section("How it was made", ["This command makes it again:", Verbatim(command)]),
    ]
    said = [" ".join(filter(None, (standing(*told), against_constant(*told), losses(*told)))) for told in climbed]
    said += [knowledge(ladders, noun) for noun, ladders in known.items()]
    lead = [words for words in (*said, on_tests(tests)) if words]
    lead = lead or ["Nothing was driven: there are no costs to compare."]
    return write_page(out_dir, sections, title="What adaptation pays", lead=lead)


# -- judgements, chosen by the numbers --------------------------------------------------------------------------------
def ratio(ladder: Ladder, rung: str, other: str) -> Ratio:
    """The cost of `rung` over that of `other`, run by run; the interval is that of a normal mean of the logarithms."""
    logs = np.log(ladder.costs[rung] / ladder.costs[other])
    mean = float(logs.mean())
    half = 1.96 * float(logs.std(ddof=1)) / math.sqrt(len(logs)) if len(logs) > 1 else 0.0
    return Ratio(math.exp(mean), math.exp(mean - half), math.exp(mean + half))


def best(ladder: Ladder) -> list[str]:
    """The cheapest rung that needs no hindsight, then those level with it."""
    ranked = sorted(_judged(ladder), key=lambda rung: _geomean(ladder.costs[rung]))
    return ranked[:1] + [rung for rung in ranked[1:] if ratio(ladder, rung, ranked[0]).verdict == "level"]


def standing(ladder: Ladder, rows: Rows, noun: str) -> str:
    """Which rung is best, and how it and the learned ones stand to the reference, the best constant and speed only."""
    first, *level = best(ladder)
    head = f"On {counted(_runs(ladder), noun)} that nobody trained on, {_said(first)} is best"
    sentences = [f"{head}, level with {listed([_said(rung) for rung in level])}." if level else f"{head}."]
    against = [other for other in dict.fromkeys((ladder.reference, CONSTANT, SPEED)) if other in ladder.costs]
    for rung in dict.fromkeys((first, *LEARNED)):
        others = [other for other in against if other != rung]
        if rung not in ladder.costs or not others:
            continue
        told = [f"{number(ratio(ladder, rung, other).mean)} times {_said(other)}" for other in others]
        if rung != first:
            sentences.append(f"{_said(rung)} costs {listed(told)}.")
            continue
        if others[0] == ladder.reference:
            told[0] += f" (95 % interval {_between(rows[rung])})"
        sentences.append(f"In the geometric mean it costs {listed(told)}.")
        if ladder.reference == OPTIMUM:
            p90, worst = (f"{number(rows[rung][f'regret_{key}'])} times the optimum" for key in ("p90", "worst"))
            sentences.append(f"On a tenth of the {noun}s it costs {p90} or more, at worst {worst}.")
    return " ".join(sentences)


def against_constant(ladder: Ladder, rows: Rows, noun: str) -> str:
    """Which adaptive rungs do not beat the best constant."""
    if CONSTANT not in ladder.costs or not adaptive(ladder):
        return ""
    beside = {rung: ratio(ladder, rung, CONSTANT) for rung in adaptive(ladder)}
    failed = [_unbeaten(_said(rung), it) for rung, it in beside.items() if it.verdict != "cheaper"]
    if failed:
        return f"Not every adaptive controller beats the best constant on these {noun}s: {listed(failed)}."
    return f"Every adaptive controller beats the best constant on these {noun}s."


def losses(ladder: Ladder, rows: Rows, noun: str) -> str:
    """Who lost the car, and how often."""
    lost = {rung: row["failures"] for rung, row in rows.items()}
    total = counted(_runs(ladder), noun)
    if not any(lost.values()):
        return f"No controller lost the car in any of {total}."
    told = listed([f"{_said(rung)} in {number(count)}" for rung, count in lost.items() if count])
    return f"The car was lost by {told} of {total}{'' if all(lost.values()) else '; by no other'}."


def knowledge(perceptions: Ladders, noun: str) -> str:
    """What it costs the learned rungs not to know friction and wind exactly; empty where nothing else was told."""
    clauses, failed, lost, compared = [], [], [], False
    for rung in LEARNED:
        known = {name: ladder for name, ladder in perceptions.items() if rung in ladder.costs}
        if not set(known) - {"exact"}:
            continue
        means = {name: _geomean(ladder.regret(rung)) for name, ladder in known.items()}
        worst = max(means, key=lambda name: means[name])
        chosen: dict[str, str] = {name: name for name in ("exact", "estimated", "withheld") if name in means}
        chosen.setdefault(worst, f"{worst}, the worst")
        parts = listed([f"{number(means[name])} ({how})" for name, how in chosen.items()])
        clauses.append(f"{_said(rung)} costs {parts} times {_said(next(iter(known.values())).reference)}")
        beside = {name: ratio(ladder, rung, CONSTANT) for name, ladder in known.items() if CONSTANT in ladder.costs}
        failed += [_unbeaten(f"{_said(rung)}, {name},", it) for name, it in beside.items() if it.verdict != "cheaper"]
        compared |= bool(beside)
        counts = {name: int((ladder.failures[rung] > 0.0).sum()) for name, ladder in known.items()}
        lost += [f"{_said(rung)} in {count} ({name})" for name, count in counts.items() if count]
    sentences = [f"By how friction and wind are known on these {noun}s, {'; '.join(clauses)}."] if clauses else []
    if failed:
        sentences.append(f"The best constant is not always beaten: {listed(failed)}.")
    elif compared:
        sentences.append("However they are known, the best constant costs more.")
    if lost:
        sentences.append(f"The car was lost by {listed(lost)} of the {noun}s.")
    return " ".join(sentences)


def on_tests(tests: Ladders) -> str:
    """How the learned rungs do on the paper's tests, and what hindsight would reach there."""
    sentences = []
    for name, ladder in tests.items():
        if CONSTANT not in ladder.costs:
            continue
        beside = {rung: ratio(ladder, rung, CONSTANT) for rung in LEARNED if rung in ladder.costs}
        floor = [ratio(ladder, rung, CONSTANT).mean for rung in _UNKNOWABLE if rung in ladder.costs]
        if not beside:
            continue
        costs = listed([f"{_said(rung)} costs {number(it.mean)} times" for rung, it in beside.items()])
        told = [f"On the paper's {title_of(name).lower()} {costs} the best constant"]
        told += [f"the best tuning in hindsight costs {number(min(floor))} times"] if floor else []
        failed = [_said(rung) for rung, it in beside.items() if it.verdict != "cheaper"]
        told += [f"{listed(failed)} {'does' if len(failed) == 1 else 'do'} not beat it"] if failed else []
        lost = [_said(rung) for rung in beside if ladder.failures[rung].any()]
        told += [f"{listed(lost)} lost the car"] if lost else []
        sentences.append(f"{'; '.join(told)}.")
    return " ".join(sentences)


def _unbeaten(who: str, it: Ratio) -> str:
    how = "is level with it" if it.verdict == "level" else "costs more"
    return f"{who} {how} ({number(it.mean)} times, {number(it.low)} to {number(it.high)})"


def adaptive(ladder: Ladder) -> list[str]:
    """The rungs that change the tuning while driving."""
    return [rung for rung in ladder.costs if rung not in FIXED]


# -- sections ---------------------------------------------------------------------------------------------------------
def _on_conditions(told: _Told) -> Section:
    ladder = told.ladder
    words = (
        f"Regret is the cost over that of {_said(ladder.reference)} on the same condition. Costs are means over noise "
        f"that neither tuning nor learning has met; a lost run counts as {LOST_COST:g} m²."
    )
    if ladder.reference == OPTIMUM:
        words += " The optimum was chosen on other noise, so a regret somewhat below 1 can occur."
    columns = {
        Head("Regret", "geometric mean"): told.column("regret_geomean"),
        Head("95 % interval"): told.intervals(),
        **{Head(text): told.column(key) for key, text in _SPREAD.items()},
        Head("Lost", f"of {number(_runs(ladder))}"): told.column("failures"),
    }
    table = _table("Regret on single conditions", columns, ladder.costs, _BOLD + _LOST)
    return Section("Conditions", [words, table, _meanings(ladder), *_maps(ladder)])


def _on_drives(told: _Told) -> Section:
    ladder = told.ladder
    words = (
        "A drive is a random road: speed that varies, patches of other friction, gusts, lane changes and curves. Costs "
        f"are means over noise that neither tuning nor learning has met; a lost drive counts as {LOST_COST:g} m²."
    )
    over = f"/ {ladder.reference}"
    columns = {
        Head("Cost", "geometric mean, m²"): told.column("cost_geomean"),
        Head("Cost", over): told.column("regret_geomean"),
        Head("95 % interval", over): told.intervals(),
        Head("P90", over): told.column("regret_p90"),
        Head("Worst", over): told.column("regret_worst"),
        Head("Cost", "/ speed only"): _ratios(ladder, SPEED),
        Head("Lost", f"of {number(_runs(ladder))}"): told.column("failures"),
    }
    table = _table("Cost of long drives", columns, ladder.costs, _BOLD + _LOST)
    return Section("Drives", [words, table, _meanings(ladder)])


def _meanings(ladder: Ladder) -> Terms:
    return Terms([_RUNGS[rung][::2] for rung in ladder.costs if rung in _RUNGS], "What the rungs are")


def _maps(ladder: Ladder) -> list[Picture]:
    """The regret of the main rungs over speed and friction, and over speed and the reference."""
    rungs = [rung for rung in MAPPED if rung in ladder.costs and rung != ladder.reference]
    if not rungs:
        return []
    speed, y_ref, friction = ladder.where[:, 0], np.abs(ladder.where[:, 1]), ladder.where[:, 2]
    over = {"friction": (friction, "Friction (–)"), "lateral reference": (y_ref, r"$|y_\mathrm{ref}|$ (m)")}
    grids = {(r, name): _mean_regret(ladder.regret(r), speed, y) for r in rungs for name, (y, _) in over.items()}
    means = np.concatenate([grid.values.ravel() for grid in grids.values()])
    low, high = min(1.0, float(np.nanmin(means))), float(np.nanmax(means))
    norm = LogNorm(low, max(min(high, _CEILING), 1.2 * low))
    beyond = "max" if high > _CEILING else "neither"
    heats = {(rung, name): Heat(grid, over[name][1], norm, extend=beyond) for (rung, name), grid in grids.items()}
    panels = [
        Panel(_label(rung), heat.show, f"Geometric mean regret over speed and {name}: {span(heat.cells.values)}.")
        for (rung, name), heat in heats.items()
    ]
    with style.styled():
        figure, axes = style.grid_figure(len(over), len(rungs), 1.75)
        for ax, (rung, name) in zip(axes, ((rung, name) for name in over for rung in rungs), strict=True):
            heats[rung, name].draw(ax)
            first_row, first_column = ax in axes[: len(rungs)], rung == rungs[0]
            ax.set_title(_label(rung) if first_row else "")
            ax.set_xlabel("" if first_row else "Speed (m/s)")
            ax.set_ylabel(over[name][1] if first_column else "")
        bar = next(iter(heats.values())).bar(figure, ax=axes, location="bottom", aspect=50, shrink=0.7, pad=0.02)
        bar.set_label("Regret (–)")
    caption = (
        "Regret over the domain: geometric mean of all conditions in a cell, whatever their other two numbers; left "
        "over friction, right over the size of the reference. All maps share one logarithmic scale of colours"
        f"{f', which ends at {_CEILING:g}' if high > _CEILING else ''}."
    )
    return [Picture(caption, [panel.drawing() for panel in panels], file="regret-map.png", print_figure=figure)]


def _spread(climbed: Sequence[_Told]) -> list[Section]:
    """The distribution of what single runs cost."""
    climbed = [told for told in climbed if len(told.ladder.costs) > 1]
    if not climbed:
        return []
    drawn = [
        [rung for rung in told.ladder.costs if rung != told.ladder.reference and not rung.endswith(" unguarded")]
        for told in climbed
    ]  # beside what has a guard, the same without it is hard to see
    strokes = _strokes(rung for rungs in drawn for rung in rungs)
    panels = []
    for (ladder, _, noun), rungs in zip(climbed, drawn, strict=True):
        ratios = {rung: ladder.regret(rung) for rung in rungs}
        quantiles = {rung: [number(float(np.quantile(it, q))) for q in (0.5, 0.9)] for rung, it in ratios.items()}
        told = " ".join(f"{_label(r)}: median {p50}, nine tenths below {p90}." for r, (p50, p90) in quantiles.items())
        over = "Regret (–)" if ladder.reference == OPTIMUM else f"Cost / {ladder.reference} (–)"
        draw = partial(_draw_distribution, ratios, strokes, over, f"{noun.capitalize()}s (%)")
        panels.append(Panel(f"{noun.capitalize()}s", draw, f"{over}, logarithmic, and the share below. {told}"))
    caption = (
        "Share of the runs that cost at most so many times the reference, which is the upright line: further left is "
        "better. What lies far out is cut off."
    )
    return [Section("Run by run", [_picture(caption, panels, strokes, "spread.png")])]


def _perceived(known: Mapping[str, Ladders]) -> list[Section]:
    """What not knowing friction and wind exactly costs the rungs that look at them; known: by what a run is."""
    tables = [_perceived_table(noun, ladders) for noun, ladders in known.items() if _lookers(ladders)]
    words = (
        "Cars measure neither friction nor wind. Here schedulers are told them in other ways than as they are; the "
        "runs of a table are the same in every row."
    )
    return [Section("What a car really knows", [words, *tables])] if tables else []


def _lookers(perceptions: Ladders) -> list[str]:
    """The rungs that may look at friction and wind, where those are told otherwise than as they are."""
    told = (rung for name, ladder in perceptions.items() if name != "exact" for rung in adaptive(ladder))
    return [rung for rung in dict.fromkeys(told) if rung != SPEED]


def _perceived_table(noun: str, perceptions: Ladders) -> Table:
    first = next(iter(perceptions.values()))
    exact = perceptions["exact"].costs if "exact" in perceptions else {}
    over = f"/ {first.reference}"
    heads = [Head("Friction and wind", is_text=True), Head("Cost", over), Head("P90", over), Head("Worst", over)]
    heads += [Head("Cost", "/ best constant")] if first.reference != CONSTANT else []
    heads += [Head("Cost", "/ exact"), Head("Lost", f"of {number(_runs(first))}")]
    body: list[Sequence[Cell | str] | str] = []
    for rung in _lookers(perceptions):
        body.append(_label(rung))
        for name, ladder in perceptions.items():
            if rung not in ladder.costs:
                continue
            regret = ladder.regret(rung)
            cells: list[Value] = [_geomean(regret), math.exp(np.percentile(np.log(regret), 90)), float(regret.max())]
            cells += [_ratios(ladder, CONSTANT).get(rung)] if first.reference != CONSTANT else []
            cells.append(_geomean(ladder.costs[rung] / exact[rung]) if rung in exact else None)
            cells.append(int((ladder.failures[rung] > 0.0).sum()))
            body.append([title_of(name), *map(_cell, cells)])
    caption = f"Imperfect knowledge of friction and wind: {noun}s"
    return Table(caption, heads, body, f"Cost: geometric mean. {_LOST}")


def _tested(tests: Ladders) -> list[Section]:
    if not tests:
        return []
    heads = [Head("Rung", is_text=True), Head("Cost", "m²"), Head("Cost", "/ best constant")]
    heads += [Head("Cost", "/ speed only"), Head("Lost", "% of noise seeds")]
    body: list[Sequence[Cell | str] | str] = []
    for name, ladder in tests.items():
        means: dict[str, Value] = {rung: _geomean(costs) for rung, costs in ladder.costs.items()}
        shares = {rung: float(each.mean()) for rung, each in ladder.failures.items()}
        lost: dict[str, Value] = {rung: Cell(percent(share), warn=share > 0.0) for rung, share in shares.items()}
        columns = [means, _ratios(ladder, CONSTANT), _ratios(ladder, SPEED), lost]
        body += [title_of(name), *_body(columns, ladder.costs)]
    words = "The signals of the paper's two tests, on the plant, the sensors and the actuator of the road profile."
    return [Section("The paper's tests", [words, Table("Cost on the paper's tests", heads, body, _BOLD.strip())])]


def _learned(schedules: Mapping[str, Schedule]) -> list[Section]:
    """The tuning over speed and the input that matters most beside it, without the guard."""
    drawn = {
        name: replace(schedules[name], guard=None)
        for name in LEARNED
        if name in schedules and "speed" in schedules[name].inputs and len(schedules[name].inputs) > 1
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
        for ax, (name, k) in zip(axes, sorted(heats, key=lambda key: LEARNED.index(key[0])), strict=True):
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
    return [Section("What was learned", [Picture(caption, drawings, file="surfaces.png", print_figure=figure), table])]


def _learning(histories: Histories) -> list[Section]:
    """How the cost of the held-out runs fell."""
    told = {name: history for name, history in histories.items() if history}
    if not told:
        return []
    strokes = _strokes(told)
    costs = {name: [(check["round"], math.exp(check["score"])) for check in checks] for name, checks in told.items()}
    losses = {name: [(check["round"], check["lost"]) for check in checks] for name, checks in told.items()}
    words = [_course(name, costs[name], told[name]) for name in told]
    draw = partial(_draw_learning, costs, strokes, "Cost (m²)")
    panels = [Panel("Cost of the held-out runs", draw, f"Geometric mean over the rounds. {' '.join(words)}")]
    if any(check["lost"] for checks in told.values() for check in checks):
        draw = partial(_draw_learning, losses, strokes, "Lost runs (–)")
        counts = " ".join(f"{_label(n)}: {line[0][1]:g} to {line[-1][1]:g}." for n, line in losses.items())
        panels.append(Panel("Held-out runs lost", draw, f"Number over the rounds. {counts}"))
    caption = "What held-out runs cost after each check, in the geometric mean; the schedule with the lowest was kept."
    return [Section("How it was learned", [" ".join(words), _picture(caption, panels, strokes, "learning.png")])]


def _course(name: str, costs: Sequence[tuple[float, float]], history: Sequence[Mapping[str, Any]]) -> str:
    """From where to where learning went, and whether it was still going."""
    kept = min(range(len(costs)), key=lambda i: costs[i][1])
    (first, high), (best_round, low) = costs[0], costs[kept]
    lost = f"; it loses {history[kept]['lost']:g} of them" if history[kept]["lost"] else ""
    fell = f"{number(high)} m² after round {first:g} and {number(low)} m² after round {best_round:g}"
    kept_how = ", the last, so more rounds may help" if 0 < kept == len(costs) - 1 else ", which was kept"
    return f"With {_said(name)} the held-out runs cost {fell}{kept_how}{lost}."


def _interventions(climbed: Sequence[_Told]) -> list[Section]:
    """How often inputs were clipped, and how often the guard stepped in."""
    body: list[Sequence[Cell | str] | str] = []
    for told in climbed:
        counted = {rung: counts for rung, counts in told.ladder.counts.items() if counts}
        body += [f"{told.noun.capitalize()}s"] if counted else []
        for rung, counts in counted.items():
            body.append([_label(rung), *(percent(counts[key]) if key in counts else "–" for key in _COUNTS)])
    if not body:
        return []
    heads = [Head("Rung", is_text=True), *(Head(text, "% of steps") for text in _COUNTS.values())]
    note = "With the first of the noise seeds. Clipped: held within the domain that the schedule was made for."
    return [Section("What the guard did", [Table("Interventions", heads, body, note)])]


# -- tables -----------------------------------------------------------------------------------------------------------
def _table(caption: str, columns: Mapping[Head, Mapping[str, Value]], rungs: Collection[str], note: str) -> Table:
    """A row for each rung; columns that are empty are left out, and the lowest number of each is bold."""
    shown = {head: values for head, values in columns.items() if values}
    return Table(caption, [Head("Rung", is_text=True), *shown], _body(list(shown.values()), rungs), note)


def _body(columns: Sequence[Mapping[str, Value]], rungs: Collection[str]) -> list[list[Cell | str]]:
    body: list[list[Cell | str]] = [[_label(rung)] for rung in rungs]
    for values in columns:
        judged = (v for rung, v in values.items() if rung not in _UNKNOWABLE and isinstance(v, float))
        least = min(judged, default=None)
        for row, rung in zip(body, rungs, strict=True):
            row.append(_cell(values.get(rung), rung not in _UNKNOWABLE and values.get(rung) == least))
    return body


def _cell(value: Value, strong: bool = False) -> Cell:
    if isinstance(value, str | Cell):
        return value if isinstance(value, Cell) else Cell(value)
    return Cell(number(value), strong=strong and isinstance(value, float), warn=isinstance(value, int) and value > 0)


# -- numbers ----------------------------------------------------------------------------------------------------------
def importance(schedule: Schedule, samples: int = 512, seed: int = 0) -> dict[str, float]:
    """In how much of the tuning's variance over the domain each input has a part: total Sobol index, 0..1.

    The mean over Np, Nc and log10 R/Q, by the estimator of M. J. W. Jansen, "Analysis of variance designs for model
    output" (1999).
    """
    rng = np.random.default_rng((seed, 0x50B0))
    low, high = schedule.domain.T
    x = rng.uniform(low, high, (samples, len(low)))
    here = _tuning(schedule, x)
    variance = here.var(axis=0)
    found = {}
    for i, name in enumerate(schedule.inputs):
        moved = x.copy()
        moved[:, i] = rng.uniform(low[i], high[i], samples)
        change = ((_tuning(schedule, moved) - here) ** 2).mean(axis=0) / 2.0
        found[name] = float(np.mean(np.divide(change, variance, out=np.zeros(3), where=variance > 0.0)))
    return found


def _tuning(schedule: Schedule, x: Array) -> Array:
    """(n, 3) Np, Nc and log10 R/Q at inputs (n, D)."""
    rows = np.zeros((len(x), len(Condition._fields)))
    rows[:, [Condition._fields.index(name) for name in schedule.inputs]] = x
    Np, Nc, Q, R = schedule.batch(rows).T
    return np.column_stack([Np, Nc, np.log10(R / Q)])


def _surface(schedule: Schedule, other: str) -> Array:
    """(nodes of `other`, nodes of speed, 3) the tuning, the remaining inputs in the middle of their domain."""
    columns, rows = _NODES
    x = np.broadcast_to(schedule.domain.mean(axis=1), (rows, columns, len(schedule.inputs))).copy()
    x[..., schedule.inputs.index("speed")] = np.linspace(*_domain(schedule, "speed"), columns)
    x[..., schedule.inputs.index(other)] = np.linspace(*_domain(schedule, other), rows)[:, np.newaxis]
    return _tuning(schedule, x.reshape(-1, x.shape[-1])).reshape(rows, columns, 3)


def _domain(schedule: Schedule, name: str) -> tuple[float, float]:
    low, high = schedule.domain[schedule.inputs.index(name)].tolist()
    return (low, high) if high > low else (low - 0.5, high + 0.5)


def _mean_regret(regret: Array, x: Array, y: Array) -> Cells:
    cells = int(np.clip(math.sqrt(len(regret) / _PER_CELL), 2, _MOST_CELLS))
    x_edges, y_edges = (np.histogram_bin_edges(values, cells) for values in (x, y))
    count = np.histogram2d(y, x, (y_edges, x_edges))[0]
    total = np.histogram2d(y, x, (y_edges, x_edges), weights=np.log(regret))[0]
    return Cells(x_edges, y_edges, np.exp(np.divide(total, count, out=np.full(count.shape, np.nan), where=count > 0.0)))


def _geomean(values: Array) -> float:
    return float(np.exp(np.log(values).mean()))


def _ratios(ladder: Ladder, other: str) -> dict[str, Value]:
    """By rung, the geometric mean of its cost over that of `other`; empty without that one."""
    return {rung: ratio(ladder, rung, other).mean for rung in ladder.costs} if other in ladder.costs else {}


def _judged(ladder: Ladder) -> list[str]:
    """The rungs that need no hindsight, where there are such."""
    return [rung for rung in ladder.costs if rung not in _UNKNOWABLE] or [ladder.reference]


def _runs(ladder: Ladder) -> int:
    return len(ladder.costs[ladder.reference])


# -- words ------------------------------------------------------------------------------------------------------------
def _label(rung: str) -> str:
    return _RUNGS[rung][0] if rung in _RUNGS else rung[:1].upper() + rung[1:]


def _said(rung: str) -> str:
    """A rung inside a sentence."""
    return _RUNGS[rung][1] if rung in _RUNGS else rung


def _between(row: Mapping[str, Any]) -> str:
    """The interval of a rung's regret, with as many digits as tell its ends apart."""
    low, high = row["regret_low"], row["regret_high"]
    digits = 3 if number(low) != number(high) else 4
    return f"{number(low, digits)} to {number(high, digits)}"


def _axis(name: str) -> str:
    return "{} ({})".format(*INPUTS[name])


def _strokes(rungs: Iterable[str]) -> dict[str, style.Stroke]:
    """The strokes of these rungs, alike in all pictures: the paper's recipe is dashed, in the colour of its model."""
    given = dict.fromkeys(rungs)
    return {rung: stroke for rung, stroke in style.strokes([*_RUNGS, *given]).items() if rung in given}


# -- drawing ----------------------------------------------------------------------------------------------------------
def _draw_distribution(ratios: Mapping[str, Array], strokes: Strokes, label: str, shares: str, axes: Axes) -> None:
    axes.axvline(1.0, color=style.MUTED, linewidth=0.7)
    for rung, values in ratios.items():
        levels = np.linspace(0.0, 1.0, min(len(values), _CURVE) + 1)[1:]
        placed = np.quantile(values, levels, method="inverted_cdf")
        x, y = np.concatenate([placed[:1], placed]), 100.0 * np.concatenate([[0.0], levels])
        axes.step(x, y, where="post", color=strokes[rung].colour, linestyle=strokes[rung].dash)
    shown = [0.9, 1.1, *(np.clip(np.median(values), 0.1, _CEILING) for values in ratios.values())]
    for rung in set(ratios) & set(MAPPED):
        shown += np.clip(np.quantile(ratios[rung], (0.005, 0.97)), 0.05, 5.0 * _CEILING).tolist()
    style.logarithmic(axes, "x", (min(shown), max(shown)))
    axes.set_ylim(0.0, 103.0)
    axes.set_xlabel(label)
    axes.set_ylabel(shares)


def _draw_learning(
    lines: Mapping[str, Sequence[tuple[float, float]]], strokes: Strokes, label: str, axes: Axes
) -> None:
    for name, line in lines.items():
        stroke = strokes[name]
        axes.plot(*np.transpose(line), color=stroke.colour, linestyle=stroke.dash, marker="o", markersize=3.0)
    axes.set_xmargin(0.03)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, steps=[1, 2, 5, 10]))
    if all(value == round(value) for line in lines.values() for _, value in line):
        axes.yaxis.set_major_locator(MaxNLocator(nbins=5, integer=True))
    axes.set_xlabel("Round (–)")
    axes.set_ylabel(label)


def _picture(caption: str, panels: Sequence[Panel], strokes: Strokes, file: str) -> Picture:
    """Panels with a common legend, side by side in print."""
    key = [(_label(rung), stroke) for rung, stroke in strokes.items()]
    drawings = [panel.drawing() for panel in panels]
    return Picture(caption, drawings, key, file, printed(panels, len(panels), 2.8, key))

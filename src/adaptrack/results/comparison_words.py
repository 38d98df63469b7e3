"""What the page on a comparison says of contenders: their names and strokes, and sentences chosen by the numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from adaptrack.base.result import BACKGROUND, SERIES, Stroke, strokes
from adaptrack.base.statistics import Ratio, geometric_mean
from adaptrack.comparison.table import Comparison
from adaptrack.results.words import counted, listed, number, title_of

Comparisons = Mapping[str, Comparison]
Rows = Mapping[str, Mapping[str, Any]]

CONSTANT, SPEED, OPTIMUM, HINDSIGHT = "best constant", "speed only", "optimum", "per-drive constant"
LEARNED = ("nn", "anfis")
MAPPED = (CONSTANT, SPEED, "look-up", *LEARNED)
"""The contenders whose regret is drawn over the domain."""

NAMES = {
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


# -- judgements, chosen by the numbers --------------------------------------------------------------------------------
def standing(comparison: Comparison, rows: Rows, noun: str) -> str:
    """Which contender is best, and how it and the learned ones stand to reference, best constant and speed only."""
    first, *level = comparison.best
    head = f"On {counted(runs_of(comparison), noun)} that nobody trained on, {phrase_of(first)} is best"
    sentences = [f"{head}, level with {listed([phrase_of(each) for each in level])}." if level else f"{head}."]
    against = [each for each in (comparison.reference, CONSTANT) if each in comparison.costs]
    against = list(dict.fromkeys([*against, *comparison.of_kind(SPEED)]))
    for contender in dict.fromkeys((first, *comparison.of_kind(*LEARNED))):
        others = [other for other in against if other != contender]
        if not others:
            continue
        ratios = [f"{number(comparison.mean_ratio(contender, other))} times {phrase_of(other)}" for other in others]
        if contender != first:
            sentences.append(f"{phrase_of(contender)} costs {listed(ratios)}.")
            continue
        if others[0] == comparison.reference:
            ratios[0] += f" (95 % interval {interval(rows[contender])})"
        sentences.append(f"In the geometric mean it costs {listed(ratios)}.")
        if comparison.reference == OPTIMUM:
            p90, worst = (f"{number(rows[contender][f'regret_{key}'])} times the optimum" for key in ("p90", "worst"))
            sentences.append(f"On a tenth of the {noun}s it costs {p90} or more, at worst {worst}.")
    return " ".join(sentences)


def against_constant(comparison: Comparison, rows: Rows, noun: str) -> str:
    """Which adaptive contenders do not beat the best constant."""
    if CONSTANT not in comparison.costs or not comparison.adaptive:
        return ""
    beside = {contender: comparison.ratio(contender, CONSTANT) for contender in comparison.adaptive}
    unbeaten = [_unbeaten(phrase_of(contender), it) for contender, it in beside.items() if it.verdict != "cheaper"]
    if unbeaten:
        return f"Not every adaptive controller beats the best constant on these {noun}s: {listed(unbeaten)}."
    return f"Every adaptive controller beats the best constant on these {noun}s."


def failures(comparison: Comparison, rows: Rows, noun: str) -> str:
    """Who failed, and how often."""
    failed = {contender: row["failures"] for contender, row in rows.items()}
    total = counted(runs_of(comparison), noun)
    if not any(failed.values()):
        return f"No controller failed in any of {total}."
    named = listed([f"{phrase_of(contender)} in {number(count)}" for contender, count in failed.items() if count])
    return f"Failed: {named} of {total}{'' if all(failed.values()) else '; no other'}."


def knowledge(perceptions: Comparisons, noun: str) -> str:
    """What it costs the learned contenders not to know friction and wind exactly; empty where they are."""
    clauses, unbeaten, failed, compared = [], [], [], False
    for contender in dict.fromkeys(contender for each in perceptions.values() for contender in each.of_kind(*LEARNED)):
        known = {name: comparison for name, comparison in perceptions.items() if contender in comparison.costs}
        if not set(known) - {"exact"}:
            continue
        means = {name: geometric_mean(comparison.regret(contender)) for name, comparison in known.items()}
        worst = max(means, key=lambda name: means[name])
        chosen: dict[str, str] = {name: name for name in ("exact", "estimated", "withheld") if name in means}
        chosen.setdefault(worst, f"{worst}, the worst")
        parts = listed([f"{number(means[name])} ({how})" for name, how in chosen.items()])
        clauses.append(f"{phrase_of(contender)} costs {parts} times {phrase_of(next(iter(known.values())).reference)}")
        beside = {
            name: comparison.ratio(contender, CONSTANT)
            for name, comparison in known.items()
            if CONSTANT in comparison.costs
        }
        unbeaten += [
            _unbeaten(f"{phrase_of(contender)}, {name},", it) for name, it in beside.items() if it.verdict != "cheaper"
        ]
        compared |= bool(beside)
        counts = {name: int((comparison.failures[contender] > 0.0).sum()) for name, comparison in known.items()}
        failed += [f"{phrase_of(contender)} in {count} ({name})" for name, count in counts.items() if count]
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
        beside = {contender: comparison.ratio(contender, CONSTANT) for contender in comparison.of_kind(*LEARNED)}
        known_after = [contender for contender in comparison.costs if comparison.role(contender).hindsight]
        floor = [comparison.mean_ratio(contender, CONSTANT) for contender in known_after]
        if not beside:
            continue
        costs = listed([f"{phrase_of(contender)} costs {number(it.mean)} times" for contender, it in beside.items()])
        said = [f"On the paper's {title_of(name).lower()} {costs} the best constant"]
        said += [f"the best tuning in hindsight costs {number(min(floor))} times"] if floor else []
        level = [phrase_of(contender) for contender, it in beside.items() if it.verdict != "cheaper"]
        said += [f"{listed(level)} {'does' if len(level) == 1 else 'do'} not beat it"] if level else []
        failed = [phrase_of(contender) for contender in beside if comparison.failures[contender].any()]
        said += [f"{listed(failed)} failed"] if failed else []
        sentences.append(f"{'; '.join(said)}.")
    return " ".join(sentences)


def _unbeaten(contender: str, it: Ratio) -> str:
    how = "is level with it" if it.verdict == "level" else "costs more"
    return f"{contender} {how} ({number(it.mean)} times, {number(it.low)} to {number(it.high)})"


def progress_of(name: str, costs: Sequence[tuple[float, float]], history: Sequence[Mapping[str, Any]]) -> str:
    """From where to where learning went, and whether it was still going."""
    kept = min(range(len(costs)), key=lambda i: costs[i][1])
    (first, high), (best_round, low) = costs[0], costs[kept]
    failed = f"; {history[kept]['failed']:g} of them fail" if history[kept]["failed"] else ""
    fell = f"{number(high)} m² after round {first:g} and {number(low)} m² after round {best_round:g}"
    kept_how = ", the last, so more rounds may help" if 0 < kept == len(costs) - 1 else ", which was kept"
    return f"With {phrase_of(name)} the held-out runs cost {fell}{kept_how}{failed}."


# -- words ------------------------------------------------------------------------------------------------------------
def label_of(contender: str) -> str:
    """A contender in tables: one that is called as its file stays as it is."""
    return NAMES[contender][0] if contender in NAMES else contender


def phrase_of(contender: str) -> str:
    """A contender inside a sentence."""
    return NAMES[contender][1] if contender in NAMES else contender


def interval(row: Mapping[str, Any]) -> str:
    """The interval of a contender's regret, with as many digits as tell its ends apart."""
    low, high = row["regret_low"], row["regret_high"]
    digits = 3 if number(low) != number(high) else 4
    return f"{number(low, digits)} to {number(high, digits)}"


def runs_of(comparison: Comparison) -> int:
    """How many runs each contender drove, of which every one has a cost."""
    return len(comparison.costs[comparison.reference])


def strokes_of(kinds: Mapping[str, str]) -> dict[str, Stroke]:
    """The strokes of contenders (by name, with their kinds), alike in all pictures.

    The paper's recipe is dashed, in its model's colour.
    """
    of_kinds = {contender: kind if kind in NAMES else contender for contender, kind in kinds.items()}
    known = strokes([*NAMES, *dict.fromkeys(of_kinds.values())])
    return {contender: known[kind] for contender, kind in of_kinds.items()}


def few_strokes(kinds: Mapping[str, str], first: Sequence[str]) -> dict[str, Stroke]:
    """Strokes of contenders in a picture of all: a colour each for as many as there are colours, the rest in grey.

    kinds: by contender; first: who has a colour in any case where there are enough. Then come the main kinds.
    """
    order = {kind: i for i, kind in enumerate(NAMES)}
    ranked = sorted(kinds, key=lambda contender: (kinds[contender] not in MAPPED, contender not in first))
    shown = sorted(ranked[: len(SERIES)], key=lambda contender: order.get(kinds[contender], len(order)))
    return strokes(shown) | {contender: BACKGROUND for contender in kinds if contender not in shown}

"""The result of a comparison: what contenders cost on operating points and drives that nobody trained on.

Every judgement on the page is chosen by the numbers of the runs behind it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from adaptrack.base.result import Column, Result, ResultTable, Row, where
from adaptrack.base.statistics import geometric_mean, regret_percentiles
from adaptrack.comparison.contenders import shown_as
from adaptrack.comparison.table import Comparison, finite
from adaptrack.control.scheduling import Schedule
from adaptrack.control.scheduling.sensitivity import importance
from adaptrack.results.comparison_answers import of_schedules
from adaptrack.results.comparison_pictures import (
    MAPPED_RUNS,
    Checks,
    axis_of,
    learning_picture,
    ratios_picture,
    regret_maps,
    spread_picture,
    surfaces_picture,
)
from adaptrack.results.comparison_words import (
    CONSTANT,
    LEARNED,
    MAPPED,
    NAMES,
    OPTIMUM,
    SPEED,
    Comparisons,
    against_constant,
    failures,
    knowledge,
    label_of,
    on_tests,
    phrase_of,
    progress_of,
    runs_of,
    standing,
)
from adaptrack.results.words import counted, few, listed, number, title_of

Shares = Mapping[str, Mapping[str, float]]
"""By contender and input, the share of the tuning's variance that has to do with it."""

LISTED = 4
"""Contenders in the box that opens the page, beside the picture of all."""
_BOLD = "Bold: the lowest of its column, but for what needs hindsight; no contender beside itself. "

_LABEL = Column("label", "Contender")
_SPREAD = (
    Column("regret_p50", "P50", show=3),
    Column("regret_p90", "P90", show=3),
    Column("regret_p99", "P99", show=3),
    Column("regret_worst", "Worst", show=3),
)
COUNTS = (
    Column("clipped", "Input clipped", "% of steps", "percent"),
    Column("rate_limited", "Change limited", "% of steps", "percent"),
    Column("broken", "Not a number", "% of steps", "percent"),
    Column("outside", "Fallback begun, input outside", "% of steps", "percent"),
    Column("off_reference", "Fallback begun, off the reference", "% of steps", "percent"),
    Column("unstable", "Gave way, near instability", "% of steps", "percent"),
    Column("fallback", "On the fallback", "% of steps", "percent"),
)
CONSOLE = (
    Column("contender", "contender"),
    Column("cost_geomean", "cost J", "m²", 3),
    Column("regret_geomean", "regret\nmean", "", 4),
    Column("interval", "95 %\ninterval"),
    Column("regret_worst", "worst", "", 3),
    Column("failures", "runs\nfailed"),
)


def comparison_result(
    *,
    operating_points: Comparisons,
    drives: Comparisons,
    tests: Comparisons,
    schedules: Mapping[str, Schedule],
    histories: Mapping[str, Checks],
    command: str = "",
    notes: Sequence[str] = (),
) -> Result:
    """A comparison of schedules as a result; its record holds a row of every contender in every view.

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
    """
    known = {"operating point": operating_points, "drive": drives}
    exact = {noun: found["exact"] for noun, found in known.items() if "exact" in found}
    deciding = [*((each, noun) for noun, each in reversed(exact.items())),
                *((each, f"{title_of(name).lower()} run") for name, each in tests.items())]  # fmt: skip
    learned = _learned(schedules)
    shares = {name: importance(schedule) for name, schedule in learned.items()}
    checks = {shown_as(kind, schedules): (kind, history) for kind, history in histories.items() if history}
    progress = _progress({name: history for name, (_, history) in checks.items()})
    pictures = [
        *([ratios_picture(deciding[0][0], label_of)] if deciding else []),
        *_drawn([regret_maps(exact["operating point"])] if "operating point" in exact else []),
        *_drawn([spread_picture(exact)]),
        *([surfaces_picture(learned, _moving_most(shares))] if learned else []),
        *([learning_picture({name: history for name, (_, history) in checks.items()},
                            {name: kind for name, (kind, _) in checks.items()}, progress)] if checks else []),
    ]  # fmt: skip
    views = {"operating points": operating_points, "drives": drives, "tests": tests}
    return Result(
        kind="comparison",
        title=_title(exact, tests),
        answer=of_schedules(*deciding[0]) if deciding else "Nothing was driven: there are no costs to compare.",
        record={"rows": view_rows(views)},
        tables=[*_tables(known, exact, tests, shares), *console_tables(views)],
        notes=notes,
        pictures=pictures,
        values={
            "main": _main(deciding) if deciding else None,
            "points": _about(exact.get("operating point")), "drives": _about(exact.get("drive")),
            "judgements": _judgements(known, exact, tests), "mapped_runs": MAPPED_RUNS, "progress": progress,
        },
        command=command,
    )  # fmt: skip


def _drawn(pictures: Iterable[Any]) -> list[Any]:
    return [each for each in pictures if each is not None]


# -- rows of all views ------------------------------------------------------------------------------------------------
def view_rows(views: Mapping[str, Comparisons]) -> list[dict[str, Any]]:
    """A row of each contender in each view: how friction and wind are known, or a test's name."""
    return [
        {"view": view, "scenario" if view == "tests" else "known_as": name, "reference": each.reference, **row}
        for view, comparisons in views.items()
        for name, each in comparisons.items()
        for row in finite(each.rows())
    ]


def console_tables(views: Mapping[str, Comparisons]) -> list[ResultTable]:
    """What the console shows: a table for each view."""
    tables = []
    for view, comparisons in views.items():
        for name, each in comparisons.items():
            rows = [{**row, "interval": f"{row['regret_low']:.3g}-{row['regret_high']:.3g}"} for row in each.rows()]
            title = f"{view}, {name}: {len(each.where)} runs, regret to {each.reference}"
            tables.append(ResultTable(f"console {view} {name}", title, CONSOLE, rows, brief=True))
    return tables


# -- what the page says -----------------------------------------------------------------------------------------------
def _title(exact: Comparisons, tests: Comparisons) -> str:
    """The controller and what was driven."""
    comparisons = [*exact.values(), *tests.values()]
    controllers = dict.fromkeys(each.role(contender).controller for each in comparisons for contender in each.costs)
    driven = [counted(runs_of(each), noun) for noun, each in exact.items()]
    driven += ["the paper's tests"] if tests else []
    if not driven:
        return "What adaptation pays"
    return f"What adaptation pays: {few(controllers, 'controller', 2)}, {listed(driven)}"


def _main(deciding: Sequence[tuple[Comparison, str]]) -> dict[str, Any]:
    """Of the comparison that decides: the drives, else the operating points, else the first of the paper's tests."""
    (comparison, noun), *others = deciding
    rows = sorted(comparison.rows(), key=lambda row: row["regret_geomean"])
    for row in rows:
        row["label"] = label_of(row["contender"])
    best, *level = (label_of(each) for each in comparison.best)
    return {
        "noun": noun, "runs": runs_of(comparison), "best": best, "level": level,
        "reference": label_of(comparison.reference),
        "listed": [row for row in rows if row["contender"] != comparison.reference
                   and comparison.role(row["contender"]).deployable][:LISTED],
        "failed": [row for row in rows if row["failures"]],
        "others": [{"runs": runs_of(each), "noun": what, "best": label_of(each.best[0])} for each, what in others[:2]],
    }  # fmt: skip


def _about(comparison: Comparison | None) -> dict[str, Any] | None:
    """What the section on operating points, or on drives, says beside its table."""
    if comparison is None:
        return None
    kinds = {contender: comparison.role(contender).kind for contender in comparison.costs}
    return {
        "reference_phrase": phrase_of(comparison.reference), "optimum": comparison.reference == OPTIMUM,
        "failed_cost": f"{comparison.failure.distance**2:g}",
        "meanings": [(label_of(contender), NAMES[kind][2]) for contender, kind in kinds.items() if kind in NAMES],
        "mapped": any(contender != comparison.reference for contender in comparison.of_kind(*MAPPED)),
    }  # fmt: skip


def _judgements(known: Mapping[str, Comparisons], exact: Comparisons, tests: Comparisons) -> list[str]:
    """A paragraph for each view, on knowledge of friction and wind, and on the paper's tests."""
    paragraphs = []
    for noun, each in exact.items():
        rows = {row["contender"]: row for row in each.rows()}
        said = [standing(each, rows, noun), against_constant(each, rows, noun), failures(each, rows, noun)]
        paragraphs.append(" ".join(filter(None, said)))
    paragraphs += [knowledge(found, noun) for noun, found in known.items()]
    return [words for words in (*paragraphs, on_tests(tests)) if words]


def _progress(histories: Mapping[str, Checks]) -> str:
    costs = {name: [(check["round"], math.exp(check["score"])) for check in checks]
             for name, checks in histories.items()}  # fmt: skip
    return " ".join(progress_of(name, costs[name], checks) for name, checks in histories.items())


# -- tables -----------------------------------------------------------------------------------------------------------
def _tables(
    known: Mapping[str, Comparisons], exact: Comparisons, tests: Comparisons, shares: Shares
) -> list[ResultTable]:
    return [
        *([_regret_table(exact["operating point"])] if "operating point" in exact else []),
        *([_cost_table(exact["drive"])] if "drive" in exact else []),
        *(_knowledge_table(noun, found) for noun, found in known.items() if _lookers(found)),
        *([_tests_table(tests)] if tests else []),
        *([_importance_table(shares)] if shares else []),
        *_interventions(exact),
    ]


def _regret_table(comparison: Comparison) -> ResultTable:
    columns = [
        _LABEL, Column("regret_geomean", "Regret", "geometric mean", 3), Column("interval", "95 % interval", show=3),
        *_SPREAD, Column("failures", "Failed", f"of {number(runs_of(comparison))}"),
    ]  # fmt: skip
    return _judged("regret", "Regret on single operating points", columns, comparison)


def _cost_table(comparison: Comparison) -> ResultTable:
    over = f"/ {comparison.reference}"
    columns = [
        _LABEL, Column("cost_geomean", "Cost", "geometric mean, m²", 3), Column("regret_geomean", "Cost", over, 3),
        Column("interval", "95 % interval", over, 3), Column("regret_p90", "P90", over, 3),
        Column("regret_worst", "Worst", over, 3), Column("over_speed", "Cost", "/ speed only", 3),
        Column("failures", "Failed", f"of {number(runs_of(comparison))}"),
    ]  # fmt: skip
    return _judged("cost", "Cost of long drives", columns, comparison)


def _judged(name: str, title: str, columns: Sequence[Column], comparison: Comparison) -> ResultTable:
    """A row for each contender; columns that are empty are left out, and the lowest number of each is bold."""
    rows = _rows(comparison)
    shown = [each for each in columns if any(row[each.name] is not None for row in rows)]
    best = lowest(rows, [each.name for each in shown])
    failed = where(rows, ["failures"], lambda row: row["failures"] > 0)
    return ResultTable(name, title, shown, rows, _BOLD + _when_failed(comparison), best=best, alert=failed)


def _when_failed(comparison: Comparison) -> str:
    rule = comparison.failure
    return (
        f"Failed: more than {rule.distance:g} m off the reference, or spun (sideslip above "
        f"{math.degrees(rule.sideslip):.0f} degrees), with any of the noise seeds."
    )


def _rows(comparison: Comparison) -> list[dict[str, Any]]:
    """A row for each contender, with its cost over that of the best constant and of the speed-only schedule."""
    speed, constant = (_ratios(comparison, *comparison.of_kind(SPEED)), _ratios(comparison, CONSTANT))
    return [
        {
            **row, "label": label_of(row["contender"]), "hindsight": comparison.role(row["contender"]).hindsight,
            "interval": None if row["contender"] == comparison.reference else (row["regret_low"], row["regret_high"]),
            "over_speed": speed.get(row["contender"]), "over_constant": constant.get(row["contender"]),
        }
        for row in comparison.rows()
    ]  # fmt: skip


def _ratios(comparison: Comparison, other: str = "") -> dict[str, float]:
    """By contender, the geometric mean of its cost over that of `other`; empty without that one."""
    return (
        {contender: comparison.mean_ratio(contender, other) for contender in comparison.costs}
        if other in comparison.costs
        else {}
    )


def lowest(rows: Sequence[Row], names: Iterable[str]) -> frozenset[tuple[int, str]]:
    """(row, column) of the lowest numbers; a ratio of a contender to itself is no achievement, nor is hindsight."""
    found = set()
    for name in names:
        judged = {i: row[name] for i, row in enumerate(rows) if isinstance(row[name], float) and not row["hindsight"]}
        least = min(judged.values(), default=None)
        found |= {(i, name) for i, value in judged.items() if value == least and value != 1.0}
    return frozenset(found)


def _lookers(perceptions: Comparisons) -> list[str]:
    """The contenders that may look at friction and wind, where those are not known exactly."""
    others = [comparison for name, comparison in perceptions.items() if name != "exact"]
    looking = (contender for each in others for contender in each.adaptive if each.role(contender).kind != SPEED)
    return list(dict.fromkeys(looking))


def _knowledge_table(noun: str, perceptions: Comparisons) -> ResultTable:
    """What not knowing friction and wind exactly costs the contenders that look at them."""
    first = next(iter(perceptions.values()))
    exact = perceptions["exact"].costs if "exact" in perceptions else {}
    over = f"/ {first.reference}"
    columns = [
        Column("known", "Friction and wind"), Column("cost", "Cost", over, 3), Column("p90", "P90", over, 3),
        Column("worst", "Worst", over, 3),
        *([Column("over_constant", "Cost", "/ best constant", 3)] if first.reference != CONSTANT else []),
        Column("over_exact", "Cost", "/ exact", 3), Column("failures", "Failed", f"of {number(runs_of(first))}"),
    ]  # fmt: skip
    rows = []
    for contender in _lookers(perceptions):
        for name, comparison in perceptions.items():
            if contender not in comparison.costs:
                continue
            regret = comparison.regret(contender)
            rows.append({
                "contender": label_of(contender), "known": title_of(name), "cost": geometric_mean(regret),
                **regret_percentiles(regret), "over_constant": _ratios(comparison, CONSTANT).get(contender),
                "over_exact": geometric_mean(comparison.costs[contender] / exact[contender])
                if contender in exact else None,
                "failures": int((comparison.failures[contender] > 0.0).sum()),
            })  # fmt: skip
    title = f"Imperfect knowledge of friction and wind: {noun}s"
    return ResultTable(f"knowledge of {noun}s", title, columns, rows, f"Cost: geometric mean. {_when_failed(first)}",
                       "contender", alert=where(rows, ["failures"], lambda row: row["failures"] > 0))  # fmt: skip


def _tests_table(tests: Comparisons) -> ResultTable:
    rows: list[dict[str, Any]] = []
    best: set[tuple[int, str]] = set()
    for name, comparison in tests.items():
        own = [
            {**row, "test": title_of(name), "failed": float(comparison.failures[row["contender"]].mean())}
            for row in _rows(comparison)
        ]
        best |= {(len(rows) + i, column) for i, column in
                 lowest(own, ("cost_geomean", "over_constant", "over_speed"))}  # fmt: skip
        rows += own
    columns = (
        _LABEL, Column("cost_geomean", "Cost", "m²", 3), Column("over_constant", "Cost", "/ best constant", 3),
        Column("over_speed", "Cost", "/ speed only", 3), Column("failed", "Failed", "% of noise seeds", "percent"),
    )  # fmt: skip
    return ResultTable("tests", "Cost on the paper's tests", columns, rows, _BOLD.strip(), "test", frozenset(best),
                       where(rows, ["failed"], lambda row: row["failed"] > 0.0))  # fmt: skip


def _interventions(exact: Comparisons) -> list[ResultTable]:
    """How often inputs were clipped, and how often the guard stepped in."""
    names = [each.name for each in COUNTS]
    rows = [
        {"label": label_of(contender), "view": f"{noun.capitalize()}s"} | {name: counts.get(name) for name in names}
        for noun, comparison in exact.items()
        for contender, counts in comparison.overall.items() if counts
    ]  # fmt: skip
    note = "With the first of the noise seeds. Clipped: held within the domain that the schedule was made for."
    return [ResultTable("interventions", "Interventions", (_LABEL, *COUNTS), rows, note, "view")] if rows else []


# -- what was learned -------------------------------------------------------------------------------------------------
def _learned(schedules: Mapping[str, Schedule]) -> dict[str, Schedule]:
    """What learned over the speed and more, without its guard, by contender."""
    return {
        shown_as(kind, schedules): replace(schedules[kind], guard=None)
        for kind in LEARNED
        if kind in schedules and "speed" in schedules[kind].inputs and len(schedules[kind].inputs) > 1
    }


def _total(shares: Shares) -> dict[str, float]:
    """By input, the sum of its shares over the contenders."""
    inputs = dict.fromkeys(each for share in shares.values() for each in share)
    return {each: sum(share.get(each, 0.0) for share in shares.values()) for each in inputs}


def _moving_most(shares: Shares) -> dict[str, str]:
    """By contender, the input beside the speed that moves the tunings of all most."""
    total = _total(shares)
    return {name: max((i for i in share if i != "speed"), key=lambda i: total[i]) for name, share in shares.items()}


def _importance_table(shares: Shares) -> ResultTable:
    total = _total(shares)
    columns = [Column("input", "Input"), *(Column(name, label_of(name), "%", "percent") for name in shares)]
    rows = [
        {"input": axis_of(each)} | {name: share.get(each) for name, share in shares.items()}
        for each in sorted(total, key=lambda each: -total[each])
    ]
    note = (
        "Share of the variance over the domain in which an input has a part, alone or with others (total Sobol index), "
        "mean over Np, Nc and log R/Q; parts that inputs have together count for each of them."
    )
    return ResultTable("importance", "What moves the tuning", columns, rows, note)

"""The result of the paper's experiment: what came out as published, what the gain is made of, who wins where.

Every judgement is chosen by the numbers of the run behind it.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from adaptrack.base.result import (
    SERIES,
    Axis,
    Column,
    Panel,
    Picture,
    Polyline,
    Result,
    ResultTable,
    Stroke,
    strokes,
)
from adaptrack.results.dots import Dot, dots_panel
from adaptrack.results.drive import Run, drive_result
from adaptrack.results.knowing import knowing_picture, knowing_table
from adaptrack.results.words import capital, listed, number, title_of
from adaptrack.studies.reproduce import LEARNED, Reproduction

Row = Mapping[str, Any]

AGREES = 0.25
"""A mean square error within this of the paper's counts as reproduced."""

LEVEL = 0.02
"""Two mean square errors that differ relatively by less count as level."""

NAMES = {
    "standard-as-released": "Standard MPC as released",
    "standard-as-written": "Standard MPC as written",
    "table-constant": "Constant of the paper's table",
    "best-constant": "Best constant of the data",
    "lookup": "Look-up table",
    "nn": "NN-MPC",
    "anfis": "ANFIS-MPC",
    "best-in-hindsight": "Best constant in hindsight",
    "standard": "Standard MPC",
}
MOVES = {"laguerre 0.95": "Laguerre 0.95", "laguerre 0.75": "Laguerre 0.75", "pulse": "pulses"}

CONFIGURATIONS = {"released": "As released", "same-moves": "The same moves for all"}

CONSOLE = (
    Column("controller", "controller"),
    Column("moves", "moves"),
    Column("mse", "MSE", "m²"),
    Column("paper_mse", "paper", "m²"),
    Column("ratio", "ratio", "", 3),
    Column("failed_at", "failed at", "s"),
)
LEARNING = (
    Column("slot", "Target"),
    Column("r2", "R²", "hold-out", 3),
    Column("ceiling_r2", "R²", "ceiling", 3),
    Column("rmse", "RMSE", "hold-out", 3),
    Column("ceiling_rmse", "RMSE", "ceiling", 3),
    Column("dead_share", "Dead outputs", "% of rows", "percent"),
    Column("parameters", "Parameters"),
    Column("seconds", "Training", "s", 3),
)
SHARES = (
    Column("name", "Controller"),
    Column("gain", "Gain", "factor", 3),
    Column("pole", "by the pole", "factor", 3),
    Column("adaptation", "by adaptation", "factor", 3),
    Column("pole_percent", "Pole", "% of log gain"),
    Column("adaptation_percent", "Adaptation", "% of log gain"),
)


def reproduction_result(made: Reproduction, command: str = "") -> Result:
    """The paper's experiment as a result, with its runs; command: the command line that makes it again."""
    runs = drive_result(
        [Run(run, label=NAMES[label]) for label, run in made.runs],
        title="The paper, reproduced: standard, NN- and ANFIS-MPC on both tests", command=command,
    )  # fmt: skip
    near, far = reproduced(made.rows, "released")
    within = f"{100 * AGREES:g} %"
    same = against(made.rows, "same-moves", "standard-as-written").partition(" (")[0]
    tables = [
        *(_configuration_table(made.rows, name) for name in CONFIGURATIONS), _statements(made),
        knowing_table(made.knowing), _ablation_table(made), _shares_table(made.shares), *_learned(made),
    ]  # fmt: skip
    pictures = [_verdict(near, far), knowing_picture(made.knowing), _ablation_picture(made.ablation)]
    failed = sum(row["failed"] for row in made.rows)
    return replace(
        runs,
        kind="reproduction",
        answer=f"{len(near)} of {len(near) + len(far)} mean square errors of the paper come out within {within}.",
        record=made.as_json(),
        tables=[*runs.tables, *tables, *_console_tables(made)],
        pictures=[*runs.pictures[1:], *pictures],
        failed=not near,
        notes=[
            f"{failed or 'none'} of the {len(made.rows)} runs failed",
            f"{made.seconds:.0f} s, of which {made.training_seconds:.0f} s learning",
        ],
        values={
            **runs.values, "made": made, "constant": made.constant, "within": within, "same": capital(same),
            "outcomes": {name: _outcomes(made.rows, name) for name in CONFIGURATIONS},
            "preview": preview_or_adaptation(made.rows), "pole": pole_or_adaptation(made.shares),
            "introduction": in_short(made),
            "tuning": _tuning(made), "noise": _unexplained(made.learning), "elsewhere": _elsewhere(made),
            "ahead": f"{100 * (made.constant.cost / made.constant.swarm_cost - 1.0):.1f}",
            "reproduced": listed([
                f"{len(close)} of {len(close) + len(away)} ({title.lower()})"
                for title, (close, away) in ((title, reproduced(made.rows, name))
                                             for name, title in CONFIGURATIONS.items())
            ]),
        },
    )  # fmt: skip


def write_reproduction(out_dir: str | os.PathLike[str], made: Reproduction, *, command: str = "") -> Path:
    """Write the page and its PNG files into `out_dir`; return the page's path.

    command: the command line that makes it again.

    Raises
    ------
    StorageError
        When the files cannot be written, see `page.write_result`.
    """
    from adaptrack.results.page import write_result

    return write_result(out_dir, reproduction_result(made, command))


def _verdict(near: Sequence[Row], far: Sequence[Row]) -> Picture:
    dots = [
        Dot(f"{NAMES[row['controller']].removesuffix(' as released')}, {_test(row['scenario'])}", row["ratio"],
            failed=row["failed"], colour=SERIES[0 if row in near else 1])
        for row in (*near, *far) if row["ratio"] is not None
    ]  # fmt: skip
    caption = f"Our mean square error over the paper's; shaded: within {100 * AGREES:g} %."
    band = (1.0 - AGREES, 1.0 + AGREES)
    panel, size = dots_panel(dots, "MSE, ours / the paper's", caption, level=1.0, band=band)
    return Picture("verdict", caption, [panel], size=size)


# -- judgements, chosen by the numbers --------------------------------------------------------------------------------
def in_short(made: Reproduction) -> list[str]:
    """The outcome in a few paragraphs."""
    introduction = [
        f"{agreement(made.rows, 'released')} {pole_or_adaptation(made.shares)}".strip(),
        "The same moves for all: " + against(made.rows, "same-moves", "standard-as-written"),
        "The comparison with the paper comes first. The figures after it show the released configuration without "
        "preview; what the gain is made of and what was learned come last.",
    ]
    if made.quick:
        introduction.append(
            f"This was a quick run: the models learned for fewer epochs, from {number(made.learned_from)} of the "
            f"{number(made.operating_points)} operating points. The figures that count are those of the run without "
            "--quick."
        )
    return introduction


def reproduced(rows: Iterable[Row], configuration: str) -> tuple[list[Row], list[Row]]:
    """The runs whose mean square error is near the paper's, and those where it is not."""
    compared = [row for row in rows if row["configuration"] == configuration and row["paper_mse"] is not None]
    near = [row for row in compared if row["ratio"] is not None and abs(row["ratio"] - 1.0) <= AGREES]
    return near, [row for row in compared if row not in near]


def agreement(rows: Iterable[Row], configuration: str) -> str:
    """How many of the paper's mean square errors come out, and which do not."""
    near, far = reproduced(rows, configuration)
    if not near and not far:
        return "None of these runs compares with the paper's."
    count = f"{len(near) or 'none'} of the {len(near) + len(far)}" if far else f"all {len(near)}"
    title = CONFIGURATIONS[configuration]
    sentence = f"{title}: {count} mean square errors of the paper come out within {100 * AGREES:g} %"
    outliers = [f"{NAMES[row['controller']]}, {_test(row['scenario'])}: {number(row['ratio'])} times" for row in far]
    return f"{sentence}; not {listed(outliers)} the paper's." if outliers else f"{sentence}."


def pole_or_adaptation(shares: Sequence[Row]) -> str:
    """Where the gain of the adaptive controllers over the standard MPC comes from."""
    known = [row for row in shares if row["pole_share"] is not None]
    if not known:
        return ""
    worse = [f"{NAMES[row['controller']]} on the {_test(row['scenario'])}" for row in known if row["gain"] <= 1.0]
    if worse:
        return f"There is no gain over the standard MPC to explain with {listed(worse)}."
    pole = [row["pole_share"] for row in known]
    helped = [row["adaptation"] > 1.0 + LEVEL for row in known]
    harmed = [row["adaptation"] < 1.0 - LEVEL for row in known]
    if all(harmed):
        part = "adaptation takes some of it back in every case"
    elif all(helped):
        part = f"adaptation is {_percents(row['adaptation_share'] for row in known)}"
    elif not any(helped) and not any(harmed):
        part = "adaptation makes no difference"
    else:
        part = f"adaptation helps in {sum(helped)} and harms in {sum(harmed)} of {len(known)} cases"
    whole = " (so more than all)" if min(pole) > 1.0 else ""
    return (
        "The adaptive controllers move by another pole than the standard one, which the paper does not mention. That "
        f"pole alone accounts for {_percents(pole)} of their gain, by its logarithm{whole}; {part}."
    )


def against(rows: Iterable[Row], configuration: str, other: str) -> str:
    """Whether the learned controllers track better than `other` without preview, with the numbers."""
    found = _by_test(rows, configuration)
    won = {
        model: [test for test, runs in found.items() if _compare(runs[model], runs[other]) == "better than"]
        for model in LEARNED
    }
    if not any(won.values()):
        sentence = (
            f"neither NN-MPC nor ANFIS-MPC tracks better than {_said(other)} on {_tests(found, found, 'either test')}"
        )
    elif all(len(tests) == len(found) for tests in won.values()):
        sentence = f"both NN-MPC and ANFIS-MPC track better than {_said(other)} on {_tests(found, found)}"
    else:
        nn, anfis = (_tests(won[model], found) for model in LEARNED)
        sentence = f"NN-MPC tracks better than {_said(other)} on {nn}, ANFIS-MPC on {anfis}"
    numbers = [
        f"{listed([_mse(runs[model]) for model in LEARNED])} against {_mse(runs[other])} m² on the {_test(test)}"
        for test, runs in found.items()
    ]
    return f"{sentence} ({'; '.join(numbers)})."


def winners(rows: Sequence[Row], configuration: str) -> str:
    """Which controller tracks best on each test, without and with preview."""
    parts = []
    for preview, how in ((False, "without"), (True, "with")):
        found = _by_test(rows, configuration, preview)
        best: dict[str, list[str]] = {}
        for test, runs in found.items():
            kept = {name: run["mse"] for name, run in runs.items() if not run["failed"]}
            if kept:
                best.setdefault(min(kept, key=lambda name: kept[name]), []).append(test)
        sentence = [f"{_said(name)} on {_tests(tests, found)}" for name, tests in best.items()]
        parts.append(f"{how} preview {listed(sentence) if sentence else 'no controller keeps the car'}")
    return f"Smallest error: {'; '.join(parts)}."


def failures(rows: Sequence[Row], configuration: str) -> list[str]:
    """A sentence on each run that failed."""
    return [
        f"Failed: {_said(row['controller'])} on the {_test(row['scenario'])} {'with' if row['preview'] else 'without'} "
        f"preview, at {row['failed_at']:.1f} s; the vehicle {row['failed_because']}."
        for row in rows
        if row["configuration"] == configuration and row["failed"]
    ]


def preview_or_adaptation(rows: Sequence[Row]) -> str:
    """What preview is worth beside adaptation: factors of the standard MPC's mean square error, as released."""
    blind, seeing = (_by_test(rows, "released", preview) for preview in (False, True))
    parts = []
    for test, runs in blind.items():
        standard, ahead = runs["standard-as-released"], seeing[test]["standard-as-released"]
        adaptive = [runs[name] for name in LEARNED if not runs[name]["failed"]]
        if standard["failed"] or ahead["failed"] or not adaptive:
            continue
        gain = standard["mse"] / min(run["mse"] for run in adaptive)
        parts.append(f"{_factor(standard['mse'] / ahead['mse'])} ({_factor(gain)}) on the {_test(test)}")
    if not parts:
        return ""
    return (
        "Preview, a planner's reference known over the horizon, lowers the mean square error of the standard MPC as "
        f"released by a factor of {listed(parts)}; in brackets what the better adaptive controller gains without it."
    )


# -- tables -----------------------------------------------------------------------------------------------------------
def _console_tables(made: Reproduction) -> list[ResultTable]:
    """A table for each configuration and test, without and with preview."""
    groups: dict[tuple[str, str, bool], list[Row]] = {}
    for row in made.rows:
        groups.setdefault((row["configuration"], row["scenario"], row["preview"]), []).append(row)
    return [
        ResultTable(f"console {name} {test} {preview}", f"{name}, {test}, with{'' if preview else 'out'} preview",
                    CONSOLE, rows, brief=True)
        for (name, test, preview), rows in groups.items()
    ]  # fmt: skip


def _outcomes(rows: Sequence[Row], configuration: str) -> list[str]:
    """Who wins, who failed, and how the learned ones stand to two constants."""
    compared = [against(rows, configuration, other) for other in ("standard-as-written", "best-constant")]
    return [" ".join([winners(rows, configuration), *failures(rows, configuration)]), *map(capital, compared)]


class _Errors:
    """Mean square errors as the entries of a table, with their marks."""

    def __init__(self) -> None:
        self.rows: list[dict[str, Any]] = []
        self.best: set[tuple[int, str]] = set()
        self.failed: set[tuple[int, str]] = set()

    def add(self, row: dict[str, Any]) -> None:
        """A row of the table, to which errors are written next."""
        self.rows.append(row)

    def write(self, column: str, run: Row, rivals: Mapping[str, Row]) -> None:
        """The MSE of a run; marked when it is the smallest of its rivals that did not fail, and when it failed."""
        place = (len(self.rows) - 1, column)
        self.rows[-1][column] = f"{number(run['mse'])} (failed)" if run["failed"] else run["mse"]
        if run["failed"]:
            self.failed.add(place)
        elif run in rivals.values() and run["mse"] == min(
            each["mse"] for each in rivals.values() if not each["failed"]
        ):
            self.best.add(place)

    def table(self, name: str, title: str, columns: Sequence[Column], note: str, group: str = "") -> ResultTable:
        """The table of what was written."""
        return ResultTable(name, title, columns, self.rows, note, group, frozenset(self.best), frozenset(self.failed))


def _configuration_table(rows: Sequence[Row], configuration: str) -> ResultTable:
    blind, seeing = (_by_test(rows, configuration, preview) for preview in (False, True))
    columns = [Column("name", "Controller"), Column("moves", "Moves")]
    for test in blind:
        columns += [
            Column(f"mse {test}", title_of(test), "MSE, m²", 3), Column(f"paper {test}", "Paper", "m²", "given"),
            Column(f"ratio {test}", "Ours", "/ paper", 3), Column(f"preview {test}", "Preview", "MSE, m²", 3),
        ]  # fmt: skip
    errors = _Errors()
    for name, some in next(iter(blind.values())).items():
        errors.add({"name": NAMES[name], "moves": MOVES[some["moves"]]})
        for test in blind:
            run, ahead = blind[test][name], seeing[test][name]
            errors.rows[-1] |= {f"paper {test}": run["paper_mse"], f"ratio {test}": run["ratio"]}
            errors.write(f"mse {test}", run, blind[test])
            errors.write(f"preview {test}", ahead, seeing[test])
    note = "Bold: the smallest of its column that did not fail."
    return errors.table(configuration, "Mean square tracking error", columns, note)


def _ablation_table(made: Reproduction) -> ResultTable:
    moves = list(dict.fromkeys(row["moves"] for row in made.ablation))
    columns = [Column("name", "Tuning"), *(Column(f"mse {each}", MOVES[each], "MSE, m²", 3) for each in moves)]
    columns += [Column(f"better {each}", MOVES[each], f"better of {made.constant.candidates}") for each in moves]
    errors = _Errors()
    for test, rows in _grouped(made.ablation, "scenario").items():
        runs = {each: {row["controller"]: row for row in rows if row["moves"] == each} for each in moves}
        for name in next(iter(runs.values())):
            hindsight = name == "best-in-hindsight"
            errors.add({"name": NAMES[name], "test": title_of(test)})
            for each in moves:
                judged = {key: row for key, row in runs[each].items() if key != "best-in-hindsight"}
                errors.write(f"mse {each}", runs[each][name], judged)
                errors.rows[-1][f"better {each}"] = None if hindsight else runs[each][name]["constants_better"]
    note = (
        "Bold: the smallest of its column, but for hindsight. Better: how many constants of the library track better "
        "with the same moves."
    )
    return errors.table("ablation", "Moves and tuning, apart", columns, note, "test")


def _shares_table(shares: Sequence[Row]) -> ResultTable:
    rows = [
        {**row, "name": NAMES[row["controller"]], "test": title_of(row["scenario"])}
        | {f"{key}_percent": None if row[f"{key}_share"] is None else round(100 * row[f"{key}_share"])
           for key in ("pole", "adaptation")}
        for row in shares
    ]  # fmt: skip
    note = (
        "Gain: MSE of the standard MPC (pole 0.95, the table's constant) over that of the adaptive one (pole 0.75). "
        "Its two steps, pole and adaptation, can be taken in either order; each factor is the geometric mean of "
        "both. Below 1 it makes tracking worse."
    )
    return ResultTable("shares", "The gain over the standard MPC, split", SHARES, rows, note, "test")


def _ablation_picture(ablation: Sequence[Row]) -> Picture:
    names = list(dict.fromkeys(row["controller"] for row in ablation))
    own = strokes(sorted(names, key=("table-constant", *LEARNED).__contains__, reverse=True))
    panels = []
    for test, rows in _grouped(ablation, "scenario").items():
        moves = list(dict.fromkeys(row["moves"] for row in rows))
        said = "; ".join(
            f"{NAMES[name]}: "
            + ", ".join(f"{_mse(row)} with {row['moves']}" for row in rows if row["controller"] == name)
            for name in names
        )
        panels.append(
            Panel(
                title_of(test), Axis(names=[MOVES[each] for each in moves]), Axis("MSE (m²)", log=True),
                [_errors_by(rows, name, moves, stroke) for name, stroke in own.items()],
                f"Mean square error, {title_of(test)}. {said}.",
            )
        )  # fmt: skip
    key = [(NAMES[name], stroke) for name, stroke in own.items()]
    return Picture("ablation", "Mean square error by moves and by tuning; failed runs are left out.", panels, key)


def _errors_by(rows: Sequence[Row], name: str, moves: Sequence[str], stroke: Stroke) -> Polyline:
    kept = [row for row in rows if row["controller"] == name and not row["failed"]]
    return Polyline([moves.index(row["moves"]) for row in kept], [row["mse"] for row in kept], stroke, markers=True)


def _learned(made: Reproduction) -> list[ResultTable]:
    inputs = [key for key in made.domain[0] if key not in ("scenario", "any")]
    return [
        ResultTable(
            "learning", "What the models learned", LEARNING,
            [{**row, "name": NAMES[row["model"]]} for row in made.learning],
            "R² and RMSE on operating points that were held out; ceiling: a strong regressor on the same rows; dead: "
            "rows at which the ReLU holds the output at the target's lowest value.", "name",
        ),
        ResultTable(
            "domain", "Inputs outside the domain of the data",
            [Column("test", "Test"), *(Column(key, key, "% of steps", "percent") for key in [*inputs, "any"])],
            [{**row, "test": title_of(row["scenario"])} for row in made.domain],
            "Such inputs are clipped to the domain before a scheduler sees them.",
        ),
        *_elsewhere_table(made),
    ]  # fmt: skip


def _unexplained(learning: Sequence[Row]) -> list[str]:
    """The targets that the operating points do not explain."""
    ceilings = {row["slot"]: row["ceiling_r2"] for row in learning}
    return [slot for slot, r2 in ceilings.items() if r2 is not None and r2 < 0.1]


def _elsewhere(made: Reproduction) -> dict[str, str] | None:
    """Where what is best on the data is not best on the tests; None where it is."""
    constant, found = made.constant, _by_test(made.rows, "same-moves")
    worse = [
        test
        for test, runs in found.items()
        if _compare(runs["best-constant"], runs["standard-as-written"]) == "worse than"
    ]
    if not worse or constant.cost >= constant.standard_cost:
        return None
    numbers = [f"{_mse(found[t]['best-constant'])} against {_mse(found[t]['standard-as-written'])} m²" for t in worse]
    return {"tests": _tests(worse, found), "numbers": listed(numbers)}


def _elsewhere_table(made: Reproduction) -> list[ResultTable]:
    """From the constant of the paper's table to the best of the data, an entry at a time."""
    if _elsewhere(made) is None:
        return []
    found = _by_test(made.rows, "same-moves")

    def of(name: str, errors: Iterable[Any]) -> dict[str, Any]:
        return {"name": name} | dict(zip(found, errors, strict=True))

    swapped = [
        of(f"with its {rows[0]['changed']}, {number(rows[0]['constant'])} instead of {number(rows[0]['table'])}",
           [row["mse"] for row in rows])
        for rows in _grouped(made.swaps, "changed").values()
    ]  # fmt: skip
    rows = [
        of(NAMES["table-constant"], [_error(runs["standard-as-written"]) for runs in found.values()]),
        *swapped,
        of(NAMES["best-constant"], [_error(runs["best-constant"]) for runs in found.values()]),
    ]
    columns = [Column("name", "Tuning"), *(Column(test, title_of(test), "MSE, m²", 3) for test in found)]
    title = "From the constant of the paper's table to the best of the data, same moves"
    return [ResultTable("elsewhere", title, columns, rows)]


def _statements(made: Reproduction) -> ResultTable:
    tests = list(_by_test(made.rows, "released"))
    standards = {"released": "standard-as-released", "same-moves": "standard-as-written"}

    def better(runs: Mapping[str, Row], configuration: str) -> tuple[str, str]:
        standard = runs[standards[configuration]]
        verdicts = {_compare(runs[name], standard) for name in LEARNED}
        said = f"{_mse(runs['nn'])}, {_mse(runs['anfis'])} against {_mse(standard)} m²"
        return ("yes" if verdicts == {"better than"} else "no"), said

    def first(runs: Mapping[str, Row], configuration: str) -> tuple[str, str]:
        verdict = _compare(runs["nn"], runs["anfis"])
        return _ANSWERS[verdict], f"{_mse(runs['nn'])} against {_mse(runs['anfis'])} m²"

    def smooth(runs: Mapping[str, Row], configuration: str) -> tuple[str, str]:
        nn, anfis = (math.sqrt(runs[name]["steering_activity"]) for name in LEARNED)
        return _ANSWERS[_order(anfis, nn)], f"{number(anfis)} against {number(nn)} rad"

    statements: dict[str, Callable[[Mapping[str, Row], str], tuple[str, str]]] = {
        "Both adaptive controllers track better than the standard MPC": better,
        "NN-MPC tracks better than ANFIS-MPC": first,
        "ANFIS-MPC steers more smoothly than NN-MPC (RMS move)": smooth,
    }
    columns = [Column("statement", "The paper says")]
    columns += [
        Column(f"{name} {test}", f"{title}: {_test(test)}") for name, title in CONFIGURATIONS.items() for test in tests
    ]
    rows: list[dict[str, Any]] = []
    denied: list[tuple[int, str]] = []
    for i, (statement, judge) in enumerate(statements.items()):
        rows.append({"statement": statement})
        for configuration in CONFIGURATIONS:
            for test, runs in _by_test(made.rows, configuration).items():
                answer, said = judge(runs, configuration)
                rows[-1][f"{configuration} {test}"] = f"{answer}: {said}"
                denied += [(i, f"{configuration} {test}")] if answer == "no" else []
    note = (
        "Against the standard MPC as released, and as written where all have the same moves; level: within "
        f"{100 * LEVEL:g} %. That ANFIS-MPC is demanding is measured by experiments/curse-of-dimensionality."
    )
    return ResultTable("statements", "Do they hold here?", columns, rows, note, alert=frozenset(denied))


# -- small words ------------------------------------------------------------------------------------------------------
def _by_test(rows: Iterable[Row], configuration: str, preview: bool = False) -> dict[str, dict[str, Row]]:
    """Test -> controller -> its run."""
    found: dict[str, dict[str, Row]] = {}
    for row in rows:
        if row["configuration"] == configuration and row["preview"] is preview:
            found.setdefault(row["scenario"], {})[row["controller"]] = row
    return found


def _grouped(rows: Iterable[Row], key: str) -> dict[str, list[Row]]:
    found: dict[str, list[Row]] = {}
    for row in rows:
        found.setdefault(row[key], []).append(row)
    return found


def _compare(one: Row, other: Row) -> str:
    """`one` beside `other`: better than, worse than, level with; a failed run is worse than one that did not."""
    if one["failed"] or other["failed"]:
        return "level with" if one["failed"] and other["failed"] else "worse than" if one["failed"] else "better than"
    return _order(one["mse"], other["mse"])


def _order(one: float, other: float) -> str:
    """Two numbers of which the smaller is better."""
    return (
        "better than" if one < other * (1.0 - LEVEL) else "worse than" if one > other * (1.0 + LEVEL) else "level with"
    )


_ANSWERS = {"better than": "yes", "worse than": "no", "level with": "level"}


def _error(row: Row) -> Any:
    return "failed" if row["failed"] else row["mse"]


def _mse(row: Row) -> str:
    return "failed" if row["failed"] else number(row["mse"])


def _said(name: str) -> str:
    """A controller inside a sentence."""
    return NAMES[name] if name in LEARNED else f"the {NAMES[name][:1].lower()}{NAMES[name][1:]}"


def _test(name: str) -> str:
    return title_of(name).lower()


def _tests(names: Iterable[str], of: Iterable[str], all_two: str = "both tests") -> str:
    """Some of the tests, inside a sentence."""
    some, every = list(names), list(of)
    if len(every) == 2 and len(some) != 1:
        return all_two if some else "neither test"
    return f"the {listed([_test(name) for name in some])}" if some else "none"


def _tuning(made: Reproduction) -> str:
    tuning = made.constant.tuning
    return f"{tuning.Np}/{tuning.Nc}/{tuning.Q:.3g}/{tuning.R:.3g}"


def _factor(value: float) -> str:
    return number(float(f"{value:.2g}"), 2)


def _percents(values: Iterable[float]) -> str:
    rounded = sorted(round(100.0 * value) for value in values)
    low, high = rounded[0], rounded[-1]
    text = f"{low} %" if low == high else f"{low} to {high} %"
    return text.replace("-", "−")

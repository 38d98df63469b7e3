"""The page on the paper's experiment: what came out as published, what the gain is made of, who wins where.

Every judgement on the page is chosen by the numbers of the run behind it.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes

from adaptrack.results import style
from adaptrack.results.dots import Dot, dots_drawing
from adaptrack.results.knowing import in_a_sentence, knowing_section
from adaptrack.results.page import Cell, Drawing, Head, Item, Picture, Section, Table, Terms, Verdict
from adaptrack.results.runs import Run, write_report
from adaptrack.results.words import listed, number, percent, title_of
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

CONFIGURATIONS = {
    "released": (
        "As released",
        "What the authors published: single track with the tyre of constant stiffness; the standard MPC moves by "
        "Laguerre functions with the pole 0.95, the adaptive ones with 0.75, and clamps hold what they learned. The "
        "best constant and the look-up table have the pole of the adaptive controllers.",
    ),
    "same-moves": (
        "The same moves for all",
        "What the paper describes: dual track on the Magic Formula tyre, the moves of eq. (10) for everybody, so "
        "that the controllers differ by their tuning alone; learned values are held within the bounds of the search, "
        "nothing else. The controller as released stands beside them with its own moves.",
    ),
}


def write_reproduction(out_dir: str | os.PathLike[str], made: Reproduction, *, command: str = "") -> Path:
    """Write the page and its PNG files into `out_dir`; return the page's path.

    command: the command line that makes it again.

    Raises
    ------
    StorageError
        When the files cannot be written, see `page.write_page`.
    """
    runs = [Run(run, label=NAMES[label]) for label, run in made.runs]
    return write_report(
        out_dir,
        runs,
        title="The paper, reproduced: standard, NN- and ANFIS-MPC on both tests",
        command=command,
        lead=in_short(made),
        first=[Section("Verdict", [_verdict(made)]), _both(made), _statements(made), knowing_section(made.knowing)],
        more=[_gain(made), _learning(made), _limits(made)],
    )


# -- the first screen -------------------------------------------------------------------------------------------------
def _verdict(made: Reproduction) -> Verdict:
    near, far = reproduced(made.rows, "released")
    text = f"{len(near)} of {len(near) + len(far)} mean square errors of the paper come out within {100 * AGREES:g} %."
    dots = [
        Dot(f"{NAMES[row['controller']].removesuffix(' as released')}, {_test(row['scenario'])}", row["ratio"],
            failed=row["failed"], colour=style.SERIES[0 if row in near else 1])
        for row in (*near, *far) if row["ratio"] is not None
    ]  # fmt: skip
    same = against(made.rows, "same-moves", "standard-as-written").partition(" (")[0]
    entries = [
        ("Against", "the errors that the paper prints, controllers as released, without preview"),
        ("Same moves", f"{same[:1].upper()}{same[1:]}."),
        (
            "How sure",
            "profile paper has no noise: every run repeats to the bit; what is learned depends on the data set",
        ),
    ]
    if made.quick:
        entries.append(("Quick", "the models learned for fewer epochs from fewer operating points"))
    caption = f"Our mean square error over the paper's; shaded: within {100 * AGREES:g} %."
    drawing = dots_drawing(dots, "MSE, ours / the paper's", caption, level=1.0, band=(1.0 - AGREES, 1.0 + AGREES))
    return Verdict(text, Terms(entries), Picture(caption, [drawing]), not near)


# -- judgements, chosen by the numbers --------------------------------------------------------------------------------
def in_short(made: Reproduction) -> list[str]:
    """The outcome in a few paragraphs."""
    lead = [
        f"{agreement(made.rows, 'released')} {pole_or_adaptation(made.shares)}".strip(),
        "The same moves for all: " + against(made.rows, "same-moves", "standard-as-written"),
        in_a_sentence(made.knowing),
        "The comparison with the paper comes first. The figures after it show the released configuration without "
        "preview; what the gain is made of and what was learned come last.",
    ]
    if made.quick:
        lead.append(
            f"This was a quick run: the models learned for fewer epochs, from {number(made.learned_from)} of the "
            f"{number(made.operating_points)} operating points. The figures that count are those of the run without "
            "--quick."
        )
    return lead


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
    title = CONFIGURATIONS[configuration][0]
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


# -- sections ---------------------------------------------------------------------------------------------------------
def _both(made: Reproduction) -> Section:
    items: list[Item] = []
    for configuration, (title, words) in CONFIGURATIONS.items():
        compared = [against(made.rows, configuration, other) for other in ("standard-as-written", "best-constant")]
        outcome = [
            " ".join([winners(made.rows, configuration), *failures(made.rows, configuration)]),
            *(clause[:1].upper() + clause[1:] for clause in compared),
        ]
        items.append(Section(title, [words, _configuration_table(made.rows, configuration), *outcome]))
    sentence = preview_or_adaptation(made.rows)
    return Section("All controllers", [*items, *([Section("Preview", [sentence])] if sentence else [])])


def _configuration_table(rows: Sequence[Row], configuration: str) -> Table:
    blind, seeing = (_by_test(rows, configuration, preview) for preview in (False, True))
    heads = [Head("Controller", is_text=True), Head("Moves", is_text=True)]
    for test in blind:
        heads += [
            Head(title_of(test), "MSE, m²"),
            Head("Paper", "m²"),
            Head("Ours", "/ paper"),
            Head("Preview", "MSE, m²"),
        ]
    body = []
    for name, some in next(iter(blind.values())).items():
        cells: list[Cell | str] = [NAMES[name], MOVES[some["moves"]]]
        for test in blind:
            run, ahead = blind[test][name], seeing[test][name]
            paper = "–" if run["paper_mse"] is None else f"{run['paper_mse']:g}"
            cells += [_cell(run, blind[test]), paper, number(run["ratio"]), _cell(ahead, seeing[test])]
        body.append(cells)
    return Table("Mean square tracking error", heads, body, "Bold: the smallest of its column that did not fail.")


def _gain(made: Reproduction) -> Section:
    constant = made.constant
    words = (
        "The same plant as released, without preview, every kind of moves with every way to tune. The constant of "
        f"the paper's table is 35/8/10/0.01 (Np/Nc/Q/R). The best constant of the data, {_tuning(made)}, has the "
        "lowest geometric mean of its cost over all operating points among the "
        f"{constant.candidates} of a common library; that took {number(constant.runs)} closed-loop runs, and the "
        f"swarms that the models learned from took {number(constant.swarm_runs)}. In hindsight: the tuning of the "
        "library that happens to be the best on that run."
    )
    items: list[Item] = [words, _ablation_picture(made.ablation), _ablation_table(made), _shares_table(made.shares)]
    sentence = pole_or_adaptation(made.shares)
    return Section("Where the gain comes from", [*items, *([sentence] if sentence else [])])


def _ablation_table(made: Reproduction) -> Table:
    moves = list(dict.fromkeys(row["moves"] for row in made.ablation))
    heads = [Head("Tuning", is_text=True), *(Head(MOVES[each], "MSE, m²") for each in moves)]
    heads += [Head(MOVES[each], f"better of {made.constant.candidates}") for each in moves]
    body: list[Sequence[Cell | str] | str] = []
    for test, rows in _grouped(made.ablation, "scenario").items():
        body.append(title_of(test))
        columns = {each: {row["controller"]: row for row in rows if row["moves"] == each} for each in moves}
        for name in next(iter(columns.values())):
            judged = {
                each: {key: row for key, row in column.items() if key != "best-in-hindsight"}
                for each, column in columns.items()
            }
            cells = [_cell(columns[each][name], judged[each]) for each in moves]
            counts = [str(columns[each][name]["constants_better"]) for each in moves]
            body.append([NAMES[name], *cells, *(counts if name in judged[moves[0]] else ["–"] * len(moves))])
    note = (
        "Bold: the smallest of its column, but for hindsight. Better: how many constants of the library track better "
        "with the same moves."
    )
    return Table("Moves and tuning, apart", heads, body, note)


def _shares_table(shares: Sequence[Row]) -> Table:
    heads = [Head("Controller", is_text=True), Head("Gain", "factor"), Head("by the pole", "factor")]
    heads += [Head("by adaptation", "factor"), Head("Pole", "% of log gain"), Head("Adaptation", "% of log gain")]
    body: list[Sequence[Cell | str] | str] = []
    for test, rows in _grouped(shares, "scenario").items():
        body.append(title_of(test))
        for row in rows:
            factors = [number(row[key]) for key in ("gain", "pole", "adaptation")]
            parts = ["–" if row[key] is None else f"{100 * row[key]:.0f}" for key in ("pole_share", "adaptation_share")]
            body.append([NAMES[row["controller"]], *factors, *(part.replace("-", "−") for part in parts)])
    note = (
        "Gain: MSE of the standard MPC (pole 0.95, the table's constant) over that of the adaptive one (pole 0.75). "
        "Its two steps, pole and adaptation, can be taken in either order; each factor is the geometric mean of "
        "both. Below 1 it makes tracking worse."
    )
    return Table("The gain over the standard MPC, split", heads, body, note)


def _ablation_picture(ablation: Sequence[Row]) -> Picture:
    names = list(dict.fromkeys(row["controller"] for row in ablation))
    strokes = style.strokes(sorted(names, key=("table-constant", *LEARNED).__contains__, reverse=True))
    panels = []
    for test, rows in _grouped(ablation, "scenario").items():
        sentence = "; ".join(
            f"{NAMES[name]}: "
            + ", ".join(f"{_mse(row)} with {row['moves']}" for row in rows if row["controller"] == name)
            for name in names
        )
        draw = partial(_draw_ablation, rows=rows, strokes=strokes, title=title_of(test))
        panels.append(Drawing(style.panel_figure(draw), f"Mean square error, {title_of(test)}. {sentence}."))
    key = [(NAMES[name], stroke) for name, stroke in strokes.items()]
    return Picture("Mean square error by moves and by tuning; failed runs are left out.", panels, key)


def _draw_ablation(axes: Axes, rows: Sequence[Row], strokes: Mapping[str, style.Stroke], title: str) -> None:
    moves = list(dict.fromkeys(row["moves"] for row in rows))
    for name, stroke in strokes.items():
        kept = [row for row in rows if row["controller"] == name and not row["failed"]]
        places, values = [moves.index(row["moves"]) for row in kept], [row["mse"] for row in kept]
        axes.plot(places, values, "o", color=stroke.colour, linestyle=stroke.dash, markersize=4)
    axes.set_title(title)
    axes.set_ylabel("MSE (m²)")
    style.logarithmic(axes, "y")
    axes.set_xticks(range(len(moves)), [MOVES[each] for each in moves])
    axes.set_xlim(-0.25, len(moves) - 0.75)


def _learning(made: Reproduction) -> Section:
    constant = made.constant
    heads = [Head("Target", is_text=True), Head("R²", "hold-out"), Head("R²", "ceiling"), Head("RMSE", "hold-out")]
    heads += [Head("RMSE", "ceiling"), Head("Dead outputs", "% of rows"), Head("Parameters"), Head("Training", "s")]
    body: list[Sequence[Cell | str] | str] = []
    for model, rows in _grouped(made.learning, "model").items():
        body.append(NAMES[model])
        body += [
            [
                row["slot"],
                *(number(row[key]) for key in ("r2", "ceiling_r2", "rmse", "ceiling_rmse")),
                "–" if row["dead_share"] is None else percent(row["dead_share"]),
                number(row["parameters"]),
                number(row["seconds"]),
            ]
            for row in rows
        ]
    table = Table(
        "What the models learned",
        heads,
        body,
        "R² and RMSE on operating points that were held out; ceiling: a strong regressor on the same rows; dead: rows "
        "at which the ReLU holds the output at the target's lowest value.",
    )
    inputs = [key for key in made.domain[0] if key not in ("scenario", "any")]
    domain = Table(
        "Inputs outside the domain of the data",
        [Head("Test", is_text=True), *(Head(name, "% of steps") for name in [*inputs, "any"])],
        [[title_of(row["scenario"]), *(percent(row[key]) for key in [*inputs, "any"])] for row in made.domain],
        "Such inputs are clipped to the domain before a scheduler sees them.",
    )
    ahead = constant.cost / constant.swarm_cost - 1.0
    words = (
        f"Both models learn the best tunings of {number(made.learned_from)} operating points of the data set "
        f"{made.data}. On those the best constant costs {100 * ahead:.1f} % more than the best tuning of each "
        "(geometric mean): about as much as perfect adaptation could gain there. The paper's table costs "
        f"{number(constant.standard_cost / constant.cost)} times the best constant."
    )
    return Section("What was learned", [words, table, *_poorly(made.learning), domain, *_elsewhere(made)])


def _poorly(learning: Sequence[Row]) -> list[str]:
    """A paragraph on the targets that the operating points do not explain, if there are any."""
    ceilings = {row["slot"]: row["ceiling_r2"] for row in learning}
    noise = [slot for slot, r2 in ceilings.items() if r2 is not None and r2 < 0.1]
    if not noise:
        return []
    return [
        f"Not even the strong regressor explains a tenth of the variance of {listed(noise)}: where the optimum is "
        "flat, the best value that a swarm happens to find is noise, and a model learns its mean."
    ]


def _elsewhere(made: Reproduction) -> list[Item]:
    """A paragraph and a table on what is best on the data and not on the tests, if it is so."""
    constant, found = made.constant, _by_test(made.rows, "same-moves")
    worse = [
        test
        for test, runs in found.items()
        if _compare(runs["best-constant"], runs["standard-as-written"]) == "worse than"
    ]
    if not worse or constant.cost >= constant.standard_cost:
        return []
    numbers = [f"{_mse(found[t]['best-constant'])} against {_mse(found[t]['standard-as-written'])} m²" for t in worse]
    sentence = (
        "What is best on the data is not best on the tests: with the same moves, the constant that beats the table's "
        f"on the data tracks worse than it on {_tests(worse, found)} ({listed(numbers)})."
    )
    if made.data_test == "step":
        sentence += (
            " The operating points of the data are steps of the reference, as in the paper; the tests are slow ramps. "
            "What the models learn from the steps they bring to the ramps."
        )
    swapped = {
        f"with its {rows[0]['changed']}, {number(rows[0]['constant'])} instead of {number(rows[0]['table'])}": [
            number(row["mse"]) for row in rows
        ]
        for rows in _grouped(made.swaps, "changed").values()
    }
    table = Table(
        "From the constant of the paper's table to the best of the data, same moves",
        [Head("Tuning", is_text=True), *(Head(title_of(test), "MSE, m²") for test in found)],
        [
            [NAMES["table-constant"], *(_mse(runs["standard-as-written"]) for runs in found.values())],
            *([name, *errors] for name, errors in swapped.items()),
            [NAMES["best-constant"], *(_mse(runs["best-constant"]) for runs in found.values())],
        ],
    )
    return [sentence, table]


def _statements(made: Reproduction) -> Section:
    tests = list(_by_test(made.rows, "released"))
    heads = [Head("The paper says", is_text=True)]
    heads += [
        Head(f"{CONFIGURATIONS[name][0]}: {_test(test)}", is_text=True) for name in CONFIGURATIONS for test in tests
    ]
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

    statements = {
        "Both adaptive controllers track better than the standard MPC": better,
        "NN-MPC tracks better than ANFIS-MPC": first,
        "ANFIS-MPC steers more smoothly than NN-MPC (RMS move)": smooth,
    }
    body = []
    for statement, judge in statements.items():
        cells: list[Cell | str] = [statement]
        for configuration in CONFIGURATIONS:
            for runs in _by_test(made.rows, configuration).values():
                answer, said = judge(runs, configuration)
                cells.append(Cell(f"{answer}: {said}", warn=answer == "no"))
        body.append(cells)
    note = (
        "Against the standard MPC as released, and as written where all have the same moves; level: within "
        f"{100 * LEVEL:g} %. That ANFIS-MPC is demanding is measured by experiments/curse-of-dimensionality."
    )
    return Section("The paper's statements", [Table("Do they hold here?", heads, body, note)])


def _limits(made: Reproduction) -> Section:
    counts = {name: tuple(map(len, reproduced(made.rows, name))) for name in CONFIGURATIONS}
    outcome = listed(
        [f"{near} of {near + far} ({CONFIGURATIONS[name][0].lower()})" for name, (near, far) in counts.items()]
    )
    return Section(
        "What the paper leaves open",
        [
            "The paper describes a dual track on Pacejka tyres and the moves of eq. (10); its authors published a "
            f"constant tyre stiffness and Laguerre moves. Both are run here. Within {100 * AGREES:g} % of the paper's "
            f"mean square errors come {outcome}.",
            "It does not give its data, its networks and rules, the window of its errors or the signals of its "
            f"tests. Here the models learn from the data set {made.data}, made with the paper's swarm on our plant; "
            "the signals are piecewise linear copies of those that the authors published; the windows, 28 s and 200 "
            "s, are those that match the paper's errors. Friction and wind are known to the scheduler exactly, and "
            "the speed follows its profile.",
        ],
    )


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


def _mse(row: Row) -> str:
    return "failed" if row["failed"] else number(row["mse"])


def _cell(row: Row, column: Mapping[str, Row]) -> Cell:
    """The MSE of a run; bold when it is the smallest of its column."""
    kept = [each["mse"] for each in column.values() if not each["failed"]]
    text = number(row["mse"]) + (" (failed)" if row["failed"] else "")
    return Cell(
        text, strong=not row["failed"] and row in column.values() and row["mse"] == min(kept), warn=row["failed"]
    )


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

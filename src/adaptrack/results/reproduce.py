"""Result of the paper's experiment: its mean square errors and figures first, then the parts of the gain in tables."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

from adaptrack.base.result import Column, Picture, Result, ResultTable, Row
from adaptrack.drive.trajectory import Trajectory
from adaptrack.paper.reproduce import PAPER_TESTS, Reproduction
from adaptrack.results import drive
from adaptrack.results.marks import strokes
from adaptrack.results.run_pictures import conditions_picture, speed_picture, tracking_picture
from adaptrack.results.words import number, title_of

MSE_TOLERANCE = 0.25
"""A mean square error counts as reproduced when it differs from the paper's by at most this share."""

CONTROLLER_TITLES = {
    "standard": "Standard MPC",
    "standard-as-released": "Standard MPC as released",
    "standard-as-written": "Standard MPC as written",
    "table-constant": "Constant of the paper's table",
    "best-constant": "Best constant of the data",
    "lookup": "Look-up table",
    "nn": "NN-MPC",
    "anfis": "ANFIS-MPC",
    "best-in-hindsight": "Best constant in hindsight",
    "road-constant": "Standard MPC, constant tuned in road",
    "road-nn": "Guarded NN-MPC, learned in road",
    "informed": "Informed MPC",
}
MOVE_TITLES = {"laguerre 0.95": "Laguerre 0.95", "laguerre 0.75": "Laguerre 0.75", "pulse": "pulses"}
CONFIGURATIONS = {"released": "As released", "same-moves": "The same moves for all"}
FIGURES = {"triple-lane-change": (7, 8), "general-trajectory": (9, 10)}
"""Numbers of the paper's figures on the conditions and on the tracking of each test."""

PUBLISHED_COLUMNS = (
    Column("name", "Test and controller"),
    Column("mse", "Ours", "m²", 3),
    Column("paper_mse", "Paper", "m²", "given"),
    Column("ratio", "Ours", "/ paper", 3),
)
LEARNING_COLUMNS = (
    Column("slot", "Target"),
    Column("r2", "R²", "hold-out", 3),
    Column("ceiling_r2", "R²", "ceiling", 3),
    Column("rmse", "RMSE", "hold-out", 3),
    Column("ceiling_rmse", "RMSE", "ceiling", 3),
    Column("dead_share", "Dead outputs", "% of rows", "percent"),
    Column("parameters", "Parameters"),
    Column("seconds", "Training", "s", 3),
)
SHARE_COLUMNS = (
    Column("name", "Controller"),
    Column("gain", "Gain", "factor", 3),
    Column("pole", "by the pole", "factor", 3),
    Column("adaptation", "by adaptation", "factor", 3),
    Column("pole_percent", "Pole", "% of log gain"),
    Column("adaptation_percent", "Adaptation", "% of log gain"),
)


def reproduction_result(reproduction: Reproduction) -> Result:
    """The paper's experiment as a result."""
    published = [row for row in _select(reproduction.rows, "released") if row["paper_mse"] is not None]
    near = [row for row in published if row["ratio"] is not None and abs(row["ratio"] - 1.0) <= MSE_TOLERANCE]
    failed = sum(row["failed"] for row in reproduction.rows)
    return Result(
        kind="reproduction",
        title="The paper, reproduced: standard, NN- and ANFIS-MPC on both tests",
        answer=f"{len(near)} of the paper's {len(published)} mean square errors come out within "
        f"{100 * MSE_TOLERANCE:g} %.",
        record=reproduction.as_json(),
        tables=[
            _published_table(published),
            *(_configuration_table(reproduction.rows, name) for name in CONFIGURATIONS),
            _ablation_table(reproduction),
            _shares_table(reproduction.shares),
            _swaps_table(reproduction),
            _informed_table(reproduction.knowing),
            *_learning_tables(reproduction),
        ],
        pictures=list(_paper_figures(reproduction.runs)),
        failed=not near,
        notes=[
            f"{failed} of the {len(reproduction.rows)} runs failed",
            f"{reproduction.seconds:.0f} s, of which {reproduction.training_seconds:.0f} s learning",
        ],
        values={
            "reproduction": reproduction,
            "tuning": "/".join(f"{value:.3g}" for value in reproduction.constant.tuning.as_array()),
            "records": json.dumps([run.meta for _, run in reproduction.runs], indent=1, ensure_ascii=False),
        },
        created=max(str(run.meta.get("created", "")) for _, run in reproduction.runs),
    )  # fmt: skip


# -- the paper's figures ----------------------------------------------------------------------------------------------
def _paper_figures(labelled: Sequence[tuple[str, Trajectory]]) -> Iterable[Picture]:
    """Figures 6 to 10 in their order."""
    runs = {
        test: {CONTROLLER_TITLES[name]: run for name, run in labelled if run.name_of("scenario") == test}
        for test in PAPER_TESTS
    }
    colours = strokes(CONTROLLER_TITLES[name] for name, _ in labelled)
    speeds = {f"({letter}) {title_of(test)}": runs[test] for letter, test in zip("ab", PAPER_TESTS, strict=True)}
    yield replace(speed_picture(speeds, colours), name="figure-6", file="figure-6.png")
    for test, (conditions, tracking) in FIGURES.items():
        yield conditions_picture(runs[test], colours, f"figure-{conditions}")
        yield tracking_picture(runs[test], colours, f"figure-{tracking}")


# -- tables -----------------------------------------------------------------------------------------------------------
errors_table = partial(drive.errors_table, competes=lambda run: run["controller"] != "best-in-hindsight")
"""A table of mean square errors; the best in hindsight is never in bold."""


def _published_table(published: Sequence[Row]) -> ResultTable:
    """The paper's six mean square errors beside ours."""
    names = [CONTROLLER_TITLES[run["controller"]].removesuffix(" as released") for run in published]
    rows = [{**run, "name": f"{title_of(run['scenario'])}, {name}"} for run, name in zip(published, names, strict=True)]
    return ResultTable("published", "Mean square tracking errors", PUBLISHED_COLUMNS, rows, brief=True)


def _configuration_table(rows: Sequence[Row], configuration: str) -> ResultTable:
    columns = [Column("name", "Controller"), Column("moves", "Moves")]
    for test in PAPER_TESTS:
        columns += [Column(f"blind {test}", title_of(test), "MSE, m²", 3),
                    Column(f"preview {test}", "with preview", "MSE, m²", 3)]  # fmt: skip
    by_controller: dict[str, dict[str, Any]] = {}
    for preview, word in ((False, "blind"), (True, "preview")):
        for run in _select(rows, configuration, preview):
            row = by_controller.setdefault(
                run["controller"], {"name": CONTROLLER_TITLES[run["controller"]], "moves": MOVE_TITLES[run["moves"]]}
            )
            row[f"{word} {run['scenario']}"] = run
    return errors_table(configuration, CONFIGURATIONS[configuration], columns, list(by_controller.values()))


def _ablation_table(reproduction: Reproduction) -> ResultTable:
    moves = list(dict.fromkeys(run["moves"] for run in reproduction.ablation))
    columns = [Column("name", "Tuning"), *(Column(f"mse {name}", MOVE_TITLES[name], "MSE, m²", 3) for name in moves)]
    candidates = reproduction.constant.candidates
    columns += [Column(f"better {name}", MOVE_TITLES[name], f"better of {candidates}") for name in moves]
    rows: dict[tuple[str, str], dict[str, Any]] = {}
    for run in reproduction.ablation:
        names = {"name": CONTROLLER_TITLES[run["controller"]], "test": title_of(run["scenario"])}
        row = rows.setdefault((run["scenario"], run["controller"]), names)
        better = None if run["controller"] == "best-in-hindsight" else run["constants_better"]
        row |= {f"mse {run['moves']}": run, f"better {run['moves']}": better}
    return errors_table("ablation", "Every kind of moves with every tuning", columns, list(rows.values()), "test")


def _shares_table(shares: Sequence[Row]) -> ResultTable:
    rows = [
        {**row, "name": CONTROLLER_TITLES[row["controller"]], "test": title_of(row["scenario"]),
         "pole_percent": _percent(row["pole_share"]), "adaptation_percent": _percent(row["adaptation_share"])}
        for row in shares
    ]  # fmt: skip
    return ResultTable("shares", "The gain over the standard MPC, split", SHARE_COLUMNS, rows, group="test")


def _percent(share: float | None) -> int | None:
    return None if share is None else round(100.0 * share)


def _swaps_table(reproduction: Reproduction) -> ResultTable:
    """From the constant of the paper's table to the best of the data, a number at a time."""
    blind = {(run["controller"], run["scenario"]): run["mse"] for run in _select(reproduction.rows, "same-moves")}

    def ends(controller: str, name: str) -> dict[str, Any]:
        return {"name": CONTROLLER_TITLES[name], **{test: blind[controller, test] for test in PAPER_TESTS}}

    changed: dict[str, dict[str, Any]] = {}
    for swap in reproduction.swaps:
        name = f"with {swap['changed']} = {number(swap['constant'])} instead of {number(swap['table'])}"
        changed.setdefault(name, {"name": name})[swap["scenario"]] = swap["mse"]
    rows = [ends("standard-as-written", "table-constant"), *changed.values(), ends("best-constant", "best-constant")]
    columns = [Column("name", "Tuning"), *(Column(test, title_of(test), "MSE, m²", 3) for test in PAPER_TESTS)]
    return ResultTable("swaps", "From the table's constant to the best of the data, same moves", columns, rows)


def _informed_table(runs: Sequence[Row]) -> ResultTable:
    columns = [Column("name", "Controller")]
    for test in PAPER_TESTS:
        columns += [Column(f"mse {test}", title_of(test), "MSE, m²", 3),
                    Column(f"rate {test}", "Steering", "RMS, rad/s", 3)]  # fmt: skip
    rows: dict[tuple[str, str], dict[str, Any]] = {}
    for run in runs:
        names = {"name": CONTROLLER_TITLES[run["controller"]], "profile": f"Profile {run['profile']}"}
        row = rows.setdefault((run["profile"], run["controller"]), names)
        row |= {f"mse {run['scenario']}": run, f"rate {run['scenario']}": run["rms_rate"]}
    return errors_table("informed", "A model of the steering", columns, list(rows.values()), "profile")


def _learning_tables(reproduction: Reproduction) -> list[ResultTable]:
    inputs = [key for key in reproduction.domain[0] if key != "scenario"]
    return [
        ResultTable(
            "learning", "The learned functions", LEARNING_COLUMNS,
            [{**row, "name": CONTROLLER_TITLES[row["model"]]} for row in reproduction.learning],
            group="name",
        ),
        ResultTable(
            "domain", "Inputs outside the domain of the data",
            [Column("test", "Test"), *(Column(key, key, "% of steps", "percent") for key in inputs)],
            [{**row, "test": title_of(row["scenario"])} for row in reproduction.domain],
        ),
    ]  # fmt: skip


def _select(rows: Iterable[Row], configuration: str, preview: bool = False) -> list[Row]:
    return [row for row in rows if row["configuration"] == configuration and row["preview"] is preview]

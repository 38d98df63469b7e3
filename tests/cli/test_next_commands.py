"""Commands that commands propose: each exists, keeps the options that the command was given, and runs."""

from __future__ import annotations

import ast
import re
import shlex
import shutil
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
import pytest
from tests.cars.test_tyre_file import BOOK, tir
from tests.identification.test_drive_identification import _log as accelerating
from tests.identification.test_identification import driven
from tests.project.test_snippets import parse

import adaptrack.cli
from adaptrack.cars.vehicle import load_vehicle
from adaptrack.cli import compare, logs
from adaptrack.cli.next_step import drive_words
from adaptrack.comparison import table
from adaptrack.paper import adaptation
from adaptrack.tuning.constant import ConstantTuning
from small_data import small

FOLDER = Path(adaptrack.cli.__file__).parent
OTHER_COMMANDS = {"make", "page"}  # first words of proposals that are no command of this program
CAR = ("--vehicle", "compact-ev")
VAN = ("--vehicle", "van", "--profile", "road")
STANLEY = ("--controller", "stanley", "--seeds", "1")
LOG = ("--columns", "yaw_rate=gyro", "--units", "yaw_rate=deg/s", "--flip", "yaw_rate")
SHORT = ("drive", "town", "--length", "300", *CAR)
SHORT_SEARCH = (
    "--length", "300", "--controller", "stanley", "--runs", "40", "--plant", "single-track", "--out", "tuned",
)  # fmt: skip
TOO_FAST = ("--lateral-acceleration", "4", "--start-offset", "1.9", "--controller", "stanley")


class Proposal(NamedTuple):
    """A command whose last line proposes another one."""

    reason: str
    command: tuple[str, ...]
    options: tuple[str, ...] = ()
    """Words of the command that the proposal must keep."""
    starts: str = ""
    runs: bool = True
    """Whether the proposed command is short enough to run here; otherwise it must parse."""
    slow: bool = False


PROPOSALS = [
    Proposal(
        "to keep the car",
        ("car", "--mass", "1500", "--wheelbase", "2.7", "--drive", "rear"),
        ("--mass", "1500", "--wheelbase", "2.7", "--drive", "rear"),
        "car",
    ),
    Proposal("to keep the car", ("car", "van", "--tir", "book.tir"), ("van", "--tir", "book.tir"), "car"),
    Proposal(
        "to learn the estimated values while driving",
        ("car", "--mass", "1500", "--wheelbase", "2.7", "--out", "mine.toml"),
        ("mine.toml",),
        "drive",
    ),
    Proposal("to drive it", ("car", "van"), ("van",), "drive"),
    Proposal(
        "to keep the car",
        ("identify", "log.csv", "--car", "compact-ev", *LOG, "--page", "page.html"),
        ("log.csv", *LOG),
        "identify",
        slow=True,
    ),
    Proposal(
        "to keep the car",
        ("identify", "accelerating.csv", "--car", "compact-ev", "--longitudinal"),
        ("--longitudinal",),
        "identify",
    ),
    Proposal(
        "to drive it",
        ("identify", "accelerating.csv", "--car", "compact-ev", "--longitudinal", "--out", "mine.toml"),
        ("mine.toml",),
        "drive",
    ),
    Proposal(
        "to drive it",
        ("identify", "log.csv", "--car", "compact-ev", *LOG, "--out", "mine.toml", "--page", "page.html"),
        ("mine.toml",),
        "drive",
        slow=True,
    ),
    Proposal(
        "to see the contradictions on a page",
        ("identify", "log.csv", "other.csv", "--car", "compact-ev", *LOG),
        ("log.csv", "other.csv", *LOG),
        "identify",
    ),
    Proposal(
        "to write the car anyway",
        ("identify", "log.csv", "other.csv", "--car", "compact-ev", *LOG, "--page", "page.html"),
        ("log.csv", "other.csv", *LOG),
        "identify",
    ),
    Proposal(
        "to find signals that contradict each other",
        ("identify", "scaled.csv", "--car", "compact-ev", *LOG, "--page", "page.html"),
        ("scaled.csv", *LOG),
        "check-loop",
    ),
    Proposal("to see the estimates over time", ("shadow", "log.csv", *CAR, *LOG), ("log.csv", *CAR, *LOG), "shadow"),
    Proposal("to keep the car", ("shadow", "log.csv", *CAR, *LOG, "--out", "page"), ("log.csv", *LOG), "identify"),
    Proposal("to leave out the contradictory signals", ("shadow", "wrong.csv", *CAR), ("wrong.csv", *CAR), "shadow"),
    Proposal("to identify the car", ("check-loop", "log.csv", *CAR, *LOG), ("log.csv", *LOG), "identify"),
    Proposal("to see the drive on a page", (*SHORT, "--learn"), (*SHORT, "--learn"), "drive"),
    Proposal("to drive a road", ("drive", "step", "-o", "duration=1.0", *CAR, "--out", "page"), CAR, "drive"),
    Proposal(
        "to drive with another seed of the noise",
        (*SHORT, "--speed-control", "--out", "page"),
        (*SHORT, "--speed-control"),
        "drive",
    ),
    Proposal(
        "to tune * for this road",
        (*SHORT, "--road-seed", "2", "--profile", "road", "--out", "page"),
        ("town:2", "--length", "300.0", "compact-ev", "--profile", "road"),
        "tune",
        runs=False,
    ),
    Proposal(
        "to test the tuning with different noise",
        (*SHORT, "--tuning", "tuning.toml", "--out", "page"),
        ("town", "--length", "300.0", "--tuning", "tuning.toml"),
        "compare",
        runs=False,
    ),
    Proposal(
        "to certify the scheduler",
        (*SHORT[:-2], "--scheduler", "road-nn", "--profile", "road", "--out", "page"),
        ("road-nn", "--profile", "road"),
        "certify",
        runs=False,
    ),
    Proposal(
        "to stay in the lane, drive more slowly",
        ("drive", "town", "--length", "300", *CAR, *TOO_FAST),
        ("--length", "300", *CAR, "--controller", "stanley"),
        "drive",
    ),
    Proposal(
        "to stay in the lane, drive more slowly",
        ("drive", "motorway", "--length", "300", *CAR, "--speed", "30", "--start-offset", "1.9"),
        ("--length", "300", *CAR, "--start-offset", "1.9"),
        "drive",
    ),
    Proposal(
        "to check it at lower speed",
        ("road", "check", "town", *CAR, "--speed", "20", "--length", "300"),
        ("town", *CAR, "--length", "300"),
        "road check",
    ),
    Proposal(
        "to drive it",
        ("road", "check", "town", *CAR, "--road-seed", "2", "--length", "300"),
        ("town", *CAR, "--road-seed", "2", "--length", "300.0"),
        "drive",
    ),
    Proposal(
        "to see the places that cannot be driven",
        (*SHORT, "--speed", "40", "--controller", "stanley"),
        ("town", *CAR, "--speed", "40.0", "--length", "300.0"),
        "road check",
    ),
    Proposal(
        "to certify cars that differ from their model",
        ("certify", *CAR, "--speed", "10", "12", "--friction", "0.8", "0.9"),
        (*CAR, "--speed", "10", "12", "--friction", "0.8", "0.9"),
        "certify",
        runs=False,
    ),
    Proposal(
        "to see the margins on a page",
        ("certify", *CAR, "--speed", "10", "11", "--friction", "0.8", "0.9", "--mismatch"),
        (*CAR, "--speed", "10", "11", "--mismatch"),
        "certify",
        runs=False,
        slow=True,
    ),
    Proposal(
        "to drive it",
        ("certify", *CAR, "--speed", "10", "11", "--friction", "0.8", "0.9", "--mismatch", "--out", "page"),
        CAR,
        "drive",
        slow=True,
    ),
    Proposal(
        "to find the speeds and frictions with a stable tuning",
        ("certify", "road-nn", *CAR, "--plant", "single-track", "--speed", "29", "30", "--friction", "0.3", "0.31"),
        (*CAR, "--plant", "single-track", "--speed", "29.0", "30.0", "--friction", "0.3", "0.31"),
        "certify",
    ),
    Proposal("use one", ("list", "drivers"), (), "compare", runs=False),
    Proposal(
        "drive it",
        ("compare", "town:2@2", "--length", "300", *VAN, *STANLEY, "--budget", "0"),
        ("--road-seed", "2", "--lateral-acceleration", "2", "--length", "300.0", *VAN, "--controller", "stanley"),
        "drive town",
    ),
    Proposal(
        "drive with the speed control",
        ("compare", "town", "--length", "800", "--driver", "speed-control", *VAN, *STANLEY),
        VAN,
        "drive town",
    ),
    Proposal(
        "drive a road",
        ("compare", "--lane-change", "iso3888-1", "--vehicle", "van", "--controller", "stanley", "--budget", "0"),
        ("--vehicle", "van"),
        "drive",
    ),
    Proposal(
        "drive with it",
        ("tune", "van", "--road", "town:2", *SHORT_SEARCH),
        ("--road-seed", "2", "--length", "300.0", "--plant", "single-track", "--vehicle", "van"),
        "drive town",
    ),
    Proposal(
        "to verify that it matches Python", ("export", "c", "--out", "my controller", *CAR), (), "make", slow=True
    ),
    Proposal("to drive, open it in a browser", ("export", "page", "--out", "page.html"), (), "page", slow=True),
    Proposal(
        "to train a schedule on this data set",
        ("paper", "campaign", "paper-grid"),
        ("paper-grid",),
        "paper train",
        runs=False,
    ),
    Proposal(
        "to see whether its loops are stable",
        ("paper", "train", "--data", "small.parquet", "--model", "anfis", "--out", "fuzzy.json"),
        ("fuzzy.json",),
        "certify",
        runs=False,
    ),
    Proposal(
        "to evaluate them on long drives",
        ("paper", "evaluate", "--operating-points", "1", "--seed", "3", "--perception", "noisy"),
        ("--operating-points", "1", "--seed", "3", "--perception", "noisy", "--drives", "200"),
        "paper evaluate",
        runs=False,
        slow=True,
    ),
    Proposal(
        "to train as long as the paper",
        ("paper", "reproduce", "--quick", "--data", "small.parquet", "--seed", "3", "--out", "quick"),
        ("--data", "small.parquet", "--seed", "3", "--out", "quick-whole"),
        "paper reproduce",
        runs=False,
        slow=True,
    ),
]
ALONE = {
    "tune it for a road": "test_the_winner_that_was_tuned_is_tuned_on_the_first_road_and_car",
    "to identify the car from the log": "test_a_log_whose_beliefs_are_doubted_is_identified_with_its_columns",
    "to evaluate them on new runs": "test_adapted_schedules_are_evaluated_on_their_campaign_and_profile",
}
"""Proposals of long commands, by the tests of their own."""


@cache
def reasons() -> frozenset[str]:
    """Reasons of all proposals in the source of the commands; an inserted word is ``*``."""
    texts = set()
    for file in FOLDER.glob("*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            called = getattr(node.func, "id", "") if isinstance(node, ast.Call) else ""
            if isinstance(node, ast.FunctionDef) and node.name == "_next_step":
                values = [part.value for part in ast.walk(node) if isinstance(part, ast.Return)]
                texts |= {_text(value.elts[0]) for value in values if isinstance(value, ast.Tuple)}
            elif called in ("choose_step", "next_line", "say_next"):
                values = [part.elts[1] for part in node.args if isinstance(part, ast.Tuple)] or node.args[:1]
                texts |= {_text(value) for value in values if isinstance(value, ast.Constant | ast.JoinedStr)}
            elif called == "add_command":
                texts |= {_text(part.elts[0]) for part in ast.walk(node) if isinstance(part, ast.Tuple)}
    return frozenset(texts)


def _text(node: ast.expr) -> str:
    if isinstance(node, ast.JoinedStr):
        return "".join(part.value if isinstance(part, ast.Constant) else "*" for part in node.values)
    return node.value


def test_each_kind_of_proposal_is_tested_here():
    assert reasons() - {proposal.reason for proposal in PROPOSALS} - set(ALONE) == set()
    assert set(ALONE.values()) <= set(globals())


def _save(path: Path, **columns: np.ndarray) -> None:
    np.savetxt(path, np.column_stack(list(columns.values())), delimiter=",", header=",".join(columns), comments="")


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the files of the commands."""
    folder = tmp_path_factory.mktemp("files")
    for name, seed, late in (("log", 1, 0), ("other", 2, 3)):
        log = driven(40.0, seed)
        command = np.append(log["command"][late:], log["command"][:1].repeat(late))
        gyro = -np.degrees(log["yaw_rate"])
        _save(folder / f"{name}.csv", time=log["time"], speed=log["speed"], command=command, gyro=gyro)
    doubled = {"command": 0.4 * log["command"], "gyro": gyro}
    _save(folder / "scaled.csv", time=log["time"], speed=log["speed"], **doubled)
    _save(
        folder / "wrong.csv", **{key: log[key] for key in ("time", "speed", "command", "yaw_rate")}, vy=-log["vy"] + 1.0
    )
    _save(folder / "accelerating.csv", **accelerating())
    tir(folder / "book.tir", BOOK)
    small().save(folder / "small.parquet")
    car = load_vehicle("compact-ev")
    car.to_toml(folder / "mine.toml")
    ConstantTuning(
        controller="stanley", vehicle="compact-ev", profile="road", period=0.05,
        tuning={"gain": 2.0, "softening": 1.0, "yaw_rate_gain": 0.1, "dead_time": 0.2},
    ).to_toml(folder / "tuning.toml")  # fmt: skip
    return folder


def _last_proposal(output: str) -> tuple[str, list[str]]:
    """Reason and words of the last line of an output."""
    line = output.strip().splitlines()[-1]
    match = re.fullmatch(r"Next, (.*?): (.*)", line)
    assert match is not None, output
    return match[1], shlex.split(match[2])


@pytest.mark.parametrize(
    "proposal",
    [pytest.param(case, marks=[pytest.mark.slow] if case.slow else [], id=f"{case.command[0]}: {case.reason}")
     for case in PROPOSALS],
)  # fmt: skip
def test_a_proposed_command_keeps_the_options_and_runs(proposal, run_command, files, tmp_path, monkeypatch) -> None:
    shutil.copytree(files, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    code, output, err = run_command(*proposal.command)
    assert code in (0, 1, 3), err
    reason, (program, *words) = _last_proposal(output)
    assert re.fullmatch(re.escape(proposal.reason).replace(r"\*", ".*"), reason), output
    if program != "adaptrack":
        assert proposal.starts in OTHER_COMMANDS
        assert program == "make" or Path(program).is_file()
        return
    assert " ".join(words).startswith(proposal.starts), words
    assert set(proposal.options) <= set(words), words
    if proposal.runs:
        code, output, err = run_command(*words)
        assert code in (0, 1, 3), f"{words}: {err}"
    else:
        parse(words)


def test_the_winner_that_was_tuned_is_tuned_on_the_first_road_and_car(monkeypatch) -> None:
    monkeypatch.setattr(table, "standing_rows", lambda comparison: [{"contender": "lqr", "tuning": "tuned"}])
    task = SimpleNamespace(cars=("van/single-track",), roads=("town:2@3",), drivers=(), profiles=("road",))
    settings = compare.CompareOptions(plugin=["json"])
    reason, line = compare._next_step(settings, SimpleNamespace(task=task, profile_comparisons={"road": None}))
    assert reason == "tune it for a road"
    words = "--plant single-track --controller lqr --profile road --plugin json --out tuned"
    assert line == f"adaptrack tune van --road town:2@3 {words}"
    parse(shlex.split(line)[1:])


@pytest.mark.parametrize(("road", "words"), [
    ("country:3@6", ["country", "--road-seed", "3", "--lateral-acceleration", "6", "--length", "300.0"]),
    ("my road.csv", ["my road.csv"]),
    ("random-drive:3", ["country"]),
    ("double-lane-change", ["double-lane-change"]),
])  # fmt: skip
def test_a_road_of_a_comparison_is_driven_with_its_seed_comfort_and_length(road, words) -> None:
    assert drive_words(road, 300.0) == words


def test_a_log_whose_beliefs_are_doubted_is_identified_with_its_columns() -> None:
    columns = logs.ColumnOptions(columns=["yaw_rate=gyro"], units=["yaw_rate=deg/s"])
    options = logs.ShadowOptions(log=[Path("log.csv")], vehicle="van", log_columns=columns, out=Path("page"))
    reason, line = logs._after_shadow(options, SimpleNamespace(spoiling=(), believable=False))
    assert reason == "to identify the car from the log"
    assert line == "adaptrack identify log.csv --car van --columns yaw_rate=gyro --units yaw_rate=deg/s"
    parse(shlex.split(line)[1:])


def test_adapted_schedules_are_evaluated_on_their_campaign_and_profile(run_command, monkeypatch, tmp_path) -> None:
    monkeypatch.setattr(adaptation, "adapt", lambda *arguments, **settings: {})
    command = ("paper", "adapt", "road-sobol", "--profile", "production", "--out", tmp_path / "mine")
    code, output, err = run_command(*command)
    assert code == 0, err
    reason, (_, *words) = _last_proposal(output)
    assert reason == "to evaluate them on new runs"
    assert words == ["paper", "evaluate", str(tmp_path / "mine"), "--campaign", "road-sobol", "--profile", "production"]
    parse(words)


def test_a_log_that_is_checked_without_a_car_proposes_nothing(run_command, monkeypatch, files) -> None:
    monkeypatch.chdir(files)
    code, output, err = run_command("check-loop", "log.csv", *LOG)
    assert code == 0, err
    assert "Next, " not in output

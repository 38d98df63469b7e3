"""Commands that commands propose: each exists, keeps the options that the command was given, and runs."""

from __future__ import annotations

import re
import shlex
from functools import partial
from itertools import takewhile
from pathlib import Path
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
import pytest
from tests.cars.test_tyre_file import BOOK, tir
from tests.identification.test_drive_identification import _log as accelerating
from tests.identification.test_identification import driven
from tests.project.test_snippets import parse

import adaptrack as at
from adaptrack.analysis.certify import certify
from adaptrack.analysis.feasibility import feasibility
from adaptrack.base.result import Result
from adaptrack.cli import compare
from adaptrack.cli.next_step import NEXT_STEPS, drive_words, next_line
from adaptrack.comparison import table
from adaptrack.comparison.entry_speed import LANE_CHANGES
from adaptrack.paper import adaptation
from adaptrack.road import Line, Road
from adaptrack.tuning.constant import ConstantTuning
from small_data import small

OTHER_COMMANDS = {"export c", "export page"}  # what follows them is no command of this program
CAR = ("--vehicle", "compact-ev")
VAN = ("--vehicle", "van", "--profile", "road")
STANLEY = ("--controller", "stanley", "--seeds", "1")
LOG = ("--columns", "yaw_rate=gyro", "--units", "yaw_rate=deg/s", "--flip", "yaw_rate")
SHEET = ("--mass", "1500", "--wheelbase", "2.7", "--drive", "rear")
IDENTIFY = ("identify", "log.csv", "--car", "compact-ev", *LOG)
CONTRADICTORY = ("identify", "log.csv", "other.csv", "--car", "compact-ev", *LOG)
ACCELERATING = ("identify", "accelerating.csv", "--car", "compact-ev", "--longitudinal")
CERTIFY = ("certify", *CAR, "--speed", "10", "11", "--friction", "0.8", "0.9")
SHORT = ("drive", "town", "--length", "300", *CAR)
SHORT_SEARCH = (
    "--length", "300", "--controller", "stanley", "--runs", "40", "--plant", "single-track", "--out", "tuned",
)  # fmt: skip
TOO_FAST = ("--lateral-acceleration", "4", "--start-offset", "1.9", "--controller", "stanley")


class Proposal(NamedTuple):
    """A command whose last line suggests another one."""

    phrase: str
    """That of the table, with ``*`` for a fact."""
    command: tuple[str, ...]
    options: tuple[str, ...] = ()
    """Words of the command that the proposal must keep."""
    runs: bool = True
    """Whether the proposed command is short enough to run here; otherwise it must parse."""
    slow: bool = False


PROPOSALS = [
    Proposal("keep the car", ("car", *SHEET), SHEET),
    Proposal("keep the car", ("car", "van", "--tir", "book.tir"), ("van", "--tir", "book.tir")),
    Proposal("learn the estimated values while driving", ("car", *SHEET, "--out", "my-car.toml"), ("my-car.toml",)),
    Proposal("drive it", ("car", "van"), ("van",)),
    Proposal("keep the car", (*IDENTIFY, "--page", "page.html"), ("log.csv", *LOG), slow=True),
    Proposal("keep the car", ACCELERATING, ("--longitudinal",)),
    Proposal("drive it", (*ACCELERATING, "--out", "my-car.toml"), ("my-car.toml",)),
    Proposal("drive it", (*IDENTIFY, "--page", "page.html", "--out", "my-car.toml"), ("my-car.toml",), slow=True),
    Proposal("see the contradictions on a page", CONTRADICTORY, ("log.csv", "other.csv", *LOG)),
    Proposal("write the car anyway", (*CONTRADICTORY, "--page", "identified.html"), ("log.csv", "other.csv", *LOG)),
    Proposal(
        "find signals that contradict each other",
        ("identify", "scaled.csv", "--car", "compact-ev", *LOG, "--page", "page.html"),
        ("scaled.csv", *LOG),
    ),
    Proposal("see the estimates over time", ("shadow", "log.csv", *CAR, *LOG), ("log.csv", *CAR, *LOG)),
    Proposal("keep the car", ("shadow", "log.csv", *CAR, *LOG, "--out", "shadow"), ("log.csv", *LOG)),
    Proposal("leave out the contradictory signals", ("shadow", "wrong.csv", *CAR), ("wrong.csv", *CAR)),
    Proposal("identify the car", ("check-loop", "log.csv", *CAR, *LOG), ("log.csv", *LOG)),
    Proposal("see the drive on a page", (*SHORT, "--learn"), (*SHORT, "--learn")),
    Proposal("drive a road", ("drive", "step", "-o", "duration=1.0", *CAR, "--out", "page"), CAR),
    Proposal(
        "drive with a different seed of the noise",
        (*SHORT, "--speed-control", "--out", "page"),
        (*SHORT, "--speed-control"),
    ),
    Proposal(
        "tune the * controller for this road",
        (*SHORT, "--road-seed", "2", "--profile", "road", "--out", "page"),
        ("town:2", "--length", "300.0", "compact-ev", "--profile", "road"),
        runs=False,
    ),
    Proposal(
        "test the tuning with different noise",
        (*SHORT, "--tuning", "tuning.toml", "--out", "page"),
        ("town", "--length", "300.0", "--tuning", "tuning.toml"),
        runs=False,
    ),
    Proposal(
        "certify the scheduler",
        (*SHORT[:-2], "--scheduler", "road-nn", "--profile", "road", "--out", "page"),
        ("road-nn", "--profile", "road"),
        runs=False,
    ),
    Proposal(
        "drive more slowly to stay in the lane",
        ("drive", "town", "--length", "300", *CAR, *TOO_FAST),
        ("--length", "300", *CAR, "--controller", "stanley"),
    ),
    Proposal(
        "drive more slowly to stay in the lane",
        ("drive", "motorway", "--length", "300", *CAR, "--speed", "30", "--start-offset", "1.9"),
        ("--length", "300", *CAR, "--start-offset", "1.9"),
    ),
    Proposal(
        "check it at lower speed",
        ("road", "check", "town", *CAR, "--speed", "20", "--length", "300"),
        ("town", *CAR, "--length", "300"),
    ),
    Proposal("see the places that cannot be driven", ("road", "check", "narrow.toml", *CAR), ("narrow.toml", *CAR)),
    Proposal(
        "drive it",
        ("road", "check", "town", *CAR, "--road-seed", "2", "--length", "300"),
        ("town", *CAR, "--road-seed", "2", "--length", "300.0"),
    ),
    Proposal(
        "see the places that cannot be driven",
        (*SHORT, "--speed", "40", "--controller", "stanley"),
        ("town", *CAR, "--speed", "40.0", "--length", "300.0"),
    ),
    Proposal("certify cars that differ from their model", CERTIFY, CERTIFY, runs=False),
    Proposal(
        "see the margins on a page",
        (*CERTIFY, "--mismatch"),
        (*CAR, "--speed", "10", "11", "--mismatch"),
        runs=False,
        slow=True,
    ),
    Proposal("drive it", (*CERTIFY, "--mismatch", "--out", "page"), CAR, slow=True),
    Proposal(
        "find the speeds and frictions with a stable tuning",
        ("certify", "road-nn", *CAR, "--plant", "single-track", "--speed", "29", "30", "--friction", "0.3", "0.31"),
        (*CAR, "--plant", "single-track", "--speed", "29.0", "30.0", "--friction", "0.3", "0.31"),
    ),
    Proposal("use one", ("list", "drivers"), (), runs=False),
    Proposal(
        "drive it",
        ("compare", "town:2@2", "--length", "300", *VAN, *STANLEY, "--budget", "0"),
        (
            "town",
            "--road-seed",
            "2",
            "--lateral-acceleration",
            "2",
            "--length",
            "300.0",
            *VAN,
            "--controller",
            "stanley",
        ),
    ),
    Proposal(
        "drive with the speed control",
        ("compare", "town", "--length", "800", "--driver", "speed-control", *VAN, *STANLEY),
        ("town", *VAN),
    ),
    Proposal(
        "drive a road",
        ("compare", "--lane-change", "iso3888-1", "--vehicle", "van", "--controller", "stanley", "--budget", "0"),
        ("--vehicle", "van"),
    ),
    Proposal(
        "drive with the tuning",
        ("tune", "van", "--road", "town:2", *SHORT_SEARCH),
        ("town", "--road-seed", "2", "--length", "300.0", "--plant", "single-track", "--vehicle", "van"),
    ),
    Proposal("verify that it matches Python", ("export", "c", "--out", "my controller", *CAR), (), slow=True),
    Proposal("open the page in a browser to drive", ("export", "page", "--out", "page.html"), (), slow=True),
    Proposal("train a schedule on this data set", ("paper", "campaign", "paper-grid"), ("paper-grid",), runs=False),
    Proposal(
        "certify the schedule",
        ("paper", "train", "--data", "small.parquet", "--model", "anfis", "--out", "fuzzy.json"),
        ("fuzzy.json",),
        runs=False,
    ),
    Proposal(
        "evaluate the schedules on long drives",
        ("paper", "evaluate", "--operating-points", "1", "--seed", "3", "--perception", "noisy"),
        ("--operating-points", "1", "--seed", "3", "--perception", "noisy", "--drives", "200"),
        runs=False,
        slow=True,
    ),
    Proposal(
        "train as long as the paper",
        ("paper", "reproduce", "--quick", "--data", "small.parquet", "--seed", "3", "--out", "quick"),
        ("--data", "small.parquet", "--seed", "3", "--out", "quick-whole"),
        runs=False,
        slow=True,
    ),
]
ALONE = {
    ("compare", "tune it for a road"): "test_the_winner_that_was_tuned_is_tuned_on_the_first_road_and_car",
    ("shadow", "identify the car from the log"): "test_a_log_whose_beliefs_are_doubted_is_identified_with_its_columns",
    ("paper adapt", "evaluate the schedules on new runs"):
        "test_adapted_schedules_are_evaluated_on_their_campaign_and_profile",
    ("paper reproduce", "drive a road"): "test_the_whole_experiment_is_followed_by_a_drive",
    ("road plot", "drive it"): "test_a_picture_of_a_road_is_followed_by_a_drive_along_it",
}  # fmt: skip
"""Suggestions of the table that have tests of their own: after which command, and the phrase."""


def _table_entry(proposal: Proposal) -> tuple[str, str]:
    """The entry of `NEXT_STEPS` that a proposal tests: its command, such as ``road check``, and its phrase."""
    names = [name for name in NEXT_STEPS if set(name.split()) <= set(proposal.command)]
    return max(names, key=len), proposal.phrase


def test_each_suggestion_of_the_table_is_tested_here():
    table = {(after, re.sub(r"\{\w+\}", "*", phrase)) for after, steps in NEXT_STEPS.items() for _, phrase, _ in steps}
    assert table == set(map(_table_entry, PROPOSALS)) | set(ALONE)
    assert set(ALONE.values()) <= set(globals())


def _save(path: Path, **columns: np.ndarray) -> None:
    np.savetxt(path, np.column_stack(list(columns.values())), delimiter=",", header=",".join(columns), comments="")


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the files of the commands."""
    folder = tmp_path_factory.mktemp("files")
    for name, seed, late in (("log", 1, 0), ("other", 2, 3)):
        log = driven(25.0, seed)
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
    Road.from_segments([Line(length=50.0)], width_left=0.6, width_right=0.6).to_toml(folder / "narrow.toml")
    ConstantTuning(
        controller="stanley", vehicle="compact-ev", profile="road", period=0.05,
        tuning={"gain": 2.0, "softening": 1.0, "yaw_rate_gain": 0.1, "dead_time": 0.2},
    ).to_toml(folder / "tuning.toml")  # fmt: skip
    return folder


def _last_proposal(output: str) -> tuple[str, list[str]]:
    """Phrase and words of the last line of an output."""
    line = output.strip().splitlines()[-1]
    match = re.fullmatch(r"Next: (.*?): (.*)", line)
    assert match is not None, output
    return match[1], shlex.split(match[2])


@pytest.fixture(scope="module")
def outcomes() -> dict[tuple[str, ...], tuple[int, str, str]]:
    """Exit code, output and errors of each command line that ran; what one row suggests is often another row."""
    return {}


@pytest.fixture
def run_once(run_command, files, outcomes, monkeypatch):
    """Run a command line on coarse grids, in the folder of the files, unless it ran before."""
    monkeypatch.chdir(files)
    monkeypatch.setattr("adaptrack.analysis.certify.certify", partial(certify, levels=(3, 2)))
    nodes = ((20.0, 60.0), (1.0, 4.0), (0.0, 3.0))
    monkeypatch.setattr("adaptrack.analysis.feasibility.feasibility", partial(feasibility, nodes=nodes))
    monkeypatch.setitem(LANE_CHANGES, "iso3888-1", LANE_CHANGES["iso3888-1"]._replace(speeds=(60, 80)))

    def run(*words):
        if words not in outcomes:
            outcomes[words] = run_command(*words)
        return outcomes[words]

    return run


@pytest.mark.parametrize(
    "proposal",
    [pytest.param(case, marks=[pytest.mark.slow] if case.slow else [], id=f"{case.command[0]}: {case.phrase}")
     for case in PROPOSALS],
)  # fmt: skip
def test_a_proposed_command_keeps_the_options_and_runs(proposal, run_once) -> None:
    after, _ = _table_entry(proposal)
    code, output, err = run_once(*proposal.command)
    assert code in (0, 1, 3), err
    phrase, (program, *words) = _last_proposal(output)
    assert re.fullmatch(re.escape(proposal.phrase).replace(r"\*", ".*"), phrase), output
    if program != "adaptrack":
        assert after in OTHER_COMMANDS
        assert program == "make" or Path(program).is_file()
        return
    (line,) = (line for _, name, line in NEXT_STEPS[after] if re.sub(r"\{\w+\}", "*", name) == proposal.phrase)
    start = list(takewhile(lambda word: word[0].isalpha(), line.split()))[1:]
    if line.startswith("again"):
        start = [proposal.command[0]]
    assert words[: len(start)] == start, line
    assert set(proposal.options) <= set(words), words
    if proposal.runs:
        code, output, err = run_once(*words)
        assert code in (0, 1, 3), f"{words}: {err}"
    else:
        parse(words)


def _parsed(line: str) -> tuple[str, str]:
    """Phrase and command line of a suggestion, which must parse."""
    phrase, words = _last_proposal(line)
    parse(words[1:])
    return phrase, shlex.join(words)


def test_the_winner_that_was_tuned_is_tuned_on_the_first_road_and_car(monkeypatch) -> None:
    monkeypatch.setattr(table, "standing_rows", lambda comparison: [{"contender": "lqr", "tuning": "tuned"}])
    task = SimpleNamespace(cars=("van/single-track",), roads=("town:2@3",), drivers=(), profiles=("road",))
    settings = compare.CompareOptions(plugin=["json"])
    facts = compare._facts(settings, SimpleNamespace(task=task, profile_comparisons={"road": None}))
    words = "--plant single-track --controller lqr --profile road --plugin json --out tuned"
    expected = f"adaptrack tune van --road town:2@3 {words}"
    assert _parsed(next_line("compare", **facts)) == ("tune it for a road", expected)


@pytest.mark.parametrize(("road", "words"), [
    ("country:3@6", ["country", "--road-seed", "3", "--lateral-acceleration", "6", "--length", "300.0"]),
    ("my road.csv", ["my road.csv"]),
    ("random-drive:3", ["country"]),
    ("double-lane-change", ["double-lane-change"]),
])  # fmt: skip
def test_a_road_of_a_comparison_is_driven_with_its_seed_comfort_and_length(road, words) -> None:
    assert drive_words(road, 300.0) == words


def test_a_log_whose_beliefs_are_doubted_is_identified_with_its_columns(run_command, files, monkeypatch) -> None:
    monkeypatch.chdir(files)
    report = SimpleNamespace(spoiling=(), believable=False)
    monkeypatch.setattr(at, "shadow", lambda *logs, **options: report)
    result = Result(kind="any", title="Any", answer="Any.", record={})
    monkeypatch.setattr("adaptrack.results.shadow.shadow_result", lambda report: result)
    command = ("shadow", "log.csv", "--vehicle", "van", "--columns", "yaw_rate=gyro", "--units", "yaw_rate=deg/s")
    code, output, err = run_command(*command, "--out", "page")
    assert code == 3, err
    line = "adaptrack identify log.csv --car van --columns yaw_rate=gyro --units yaw_rate=deg/s"
    assert _parsed(output) == ("identify the car from the log", line)


def test_adapted_schedules_are_evaluated_on_their_campaign_and_profile(run_command, monkeypatch, tmp_path) -> None:
    monkeypatch.setattr(adaptation, "adapt", lambda *arguments, **settings: {})
    command = ("paper", "adapt", "road-sobol", "--profile", "production", "--out", tmp_path / "mine")
    code, output, err = run_command(*command)
    assert code == 0, err
    phrase, (_, *words) = _last_proposal(output)
    assert phrase == "evaluate the schedules on new runs"
    assert words == ["paper", "evaluate", str(tmp_path / "mine"), "--campaign", "road-sobol", "--profile", "production"]
    parse(words)


def test_the_whole_experiment_is_followed_by_a_drive(run_command, monkeypatch, tmp_path) -> None:
    result = Result(kind="any", title="Any", answer="Any.", record={})
    monkeypatch.setattr("adaptrack.paper.reproduce.reproduce", lambda *arguments, **settings: None)
    monkeypatch.setattr("adaptrack.results.reproduce.reproduction_result", lambda reproduction: result)
    code, output, err = run_command("paper", "reproduce", "--out", tmp_path / "paper")
    assert code == 0, err
    assert _parsed(output) == ("drive a road", "adaptrack drive country --out drive")


def test_a_log_that_is_checked_without_a_car_proposes_nothing(run_command, monkeypatch, files) -> None:
    monkeypatch.chdir(files)
    code, output, err = run_command("check-loop", "log.csv", *LOG)
    assert code == 0, err
    assert "Next: " not in output


def test_a_picture_of_a_road_is_followed_by_a_drive_along_it(run_command, files, monkeypatch) -> None:
    monkeypatch.chdir(files)
    code, output, err = run_command("road", "plot", "town", *CAR, "--length", "300")
    assert code == 0, err
    assert _parsed(output) == ("drive it", "adaptrack drive town --vehicle compact-ev --length 300.0")

"""The commands around schedulers: paper adapt, paper evaluate, certify, paper train."""

from __future__ import annotations

import json
import shutil
import sys
from dataclasses import replace
from functools import partial
from html import unescape

import pytest

from adaptrack import cli
from adaptrack.analysis.certify import certify
from adaptrack.analysis.feasibility import feasibility
from adaptrack.base.errors import AdaptrackError
from adaptrack.control.controllers import Tuning
from adaptrack.control.controllers.informed import informed_tuning
from adaptrack.control.scheduling import Constant
from adaptrack.paper import adaptation, evaluation, learning_task
from small_chain import EFFORT, learned, write

CERTIFIED = {"scheduler", "plant", "tyre", "profile", "passed", "points", "unstable", "unstable_without_guard",
             "unstable_in_turn", "verdict", "straight", "turn", "rows"}  # fmt: skip


def run(monkeypatch, capsys, *arguments):
    """(exit code, standard output, standard error) of one command."""
    monkeypatch.setattr(sys, "argv", ["adaptrack", *map(str, arguments)])
    code = cli.main()
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def strict(text):
    """JSON without NaN and infinity, which are none."""
    return json.loads(text, parse_constant=lambda name: pytest.fail(f"{name} is no JSON"))


@pytest.fixture
def places(tmp_path):
    """Files that commands are given: a campaign, a scheduler, a damaged one, a file where a folder should be."""
    pond = write(tmp_path)
    Constant(Tuning(38, 4, 1.0, 8000.0), name="mine").save(tmp_path / "mine.json")
    (tmp_path / "damaged.json").write_text((tmp_path / "mine.json").read_text().replace("8000", "80"))
    (tmp_path / "file").write_text("")
    replace(Constant(Tuning()), made_for={"car": "van"}).save(tmp_path / "vans.json")
    return {
        "pond": pond, "mine": tmp_path / "mine.json", "damaged": tmp_path / "damaged.json",
        "file": tmp_path / "file", "out": tmp_path / "out", "vans": tmp_path / "vans.json",
    }  # fmt: skip


# -- what is wrong is said --------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("command", "words"),
    [
        ("tune van", ["--out"]),
        ("paper adapt road-sobl --out {out}", ["no campaign is named 'road-sobl'", "Did you mean 'road-sobol'"]),
        ("paper adapt nowhere.toml --out {out}", ["nowhere.toml", "cannot be read"]),
        ("paper adapt paper-grid --out {out}", ["paper-grid", "Sobol"]),
        ("paper adapt {pond} --out {file}/out", ["cannot be written"]),
        ("paper adapt {pond} --out {out} --workers 0", ["workers = 0"]),
        ("paper evaluate {out}", ["fallback.json", "cannot be read"]),
        ("paper evaluate --campaign road-sobl", ["Did you mean 'road-sobol'"]),
        ("paper evaluate --scheduler road-n", ["no scheduler is named 'road-n'", "Did you mean"]),
        ("paper evaluate --scheduler nowhere.json", ["nowhere.json", "cannot be read"]),
        ("paper evaluate --scheduler {damaged}", ["damaged.json", "checksum"]),
        ("paper evaluate --scheduler {vans}", ["'vans'", "car 'van', not 'paper'", "adaptrack paper adapt"]),
        ("paper evaluate --scheduler {mine} --scheduler {mine}", ["has this name already", "rename"]),
        ("paper evaluate --operating-points 0", ["--operating-points = 0"]),
        ("paper evaluate --operating-points 99999999999", ["99999999999"]),
        ("paper evaluate --drives many", ["--drives", "integer"]),
        ("paper evaluate --seed -1", ["--seed"]),
        ("paper evaluate --known-as nosy", ["'nosy'", "noisy", "withheld"]),
        ("paper evaluate --out {file}/out", ["cannot be written"]),
        ("certify --controller informd", ["'informd'", "Did you mean 'informed'"]),
        ("certify {mine} --feasible", ["--feasible", "leave out the scheduler"]),
        ("certify --feasible --out {out}", ["--feasible", "--out"]),
        ("certify --feasible --speed 9 5", ["speed = (9.0, 5.0)", "low <= high"]),
        ("certify road-n", ["no scheduler is named 'road-n'", "Did you mean"]),
        ("certify nowhere.json", ["nowhere.json", "cannot be read"]),
        ("certify {damaged}", ["damaged.json", "checksum"]),
        ("certify {mine} --vehicle papr", ["Did you mean 'paper'"]),
        ("certify {mine} --tyre magic", ["no tyre is named 'magic'", "'magic-formula'"]),
        ("certify {mine} --profile raod", ["raod"]),
        ("certify {mine} --out {file}/out", ["cannot be written"]),
        ("paper train --model nn --out {out}/nn.json", ["--data"]),
        ("paper train --data nowhere.parquet --model nn --out {out}/nn.json", ["nowhere.parquet"]),
        ("paper train --data paper-grid --model nn --targets both --out {out}/nn.json", ["both"]),
        ("list --jason", ["--jason"]),
    ],
)
def test_a_wrong_argument_gives_one_clear_message_and_exit_code_2(monkeypatch, capsys, places, command, words):
    for module in (learning_task, evaluation):
        monkeypatch.setattr(module, "operating_point_runs", lambda *given, **more: pytest.fail("it went to work"))
    before = places["file"].stat().st_size
    code, out, err = run(monkeypatch, capsys, *(part.format(**places) for part in command.split()))
    assert code == 2
    assert out == ""
    assert "Traceback" not in err
    assert all(word in err for word in words), err
    assert places["file"].stat().st_size == before


@pytest.mark.parametrize("command", ["paper adapt", "paper evaluate", "certify", "paper train"])
def test_help_names_the_options_and_loads_no_numerics(run_python, command):
    options = {
        "paper adapt": ["--out", "CAMPAIGN", "--workers"],
        "paper evaluate": ["--scheduler", "--operating-points", "--known-as", "--tests"],
        "certify": ["--profile", "--vehicle", "--feasible", "--mismatch", "--out"],
        "paper train": ["--data", "--model", "--targets"],
    }[command]  # fmt: skip
    shown = "--help-all" if command in ("paper adapt", "paper evaluate", "certify") else "--help"
    code = (
        "import sys; from adaptrack import cli; "
        f"sys.argv = 'adaptrack {command} {shown}'.split(); assert cli.main() == 0; assert 'numpy' not in sys.modules"
    )
    text = run_python(code=code)
    assert all(option in text for option in ["Usage: adaptrack", "--json", *options])


@pytest.mark.parametrize("command", ["paper adapt", "paper evaluate", "paper reproduce"])
def test_help_says_that_failed_runs_are_counted_and_the_exit_code_is_0(monkeypatch, capsys, command):
    code, out, _ = run(monkeypatch, capsys, *command.split(), "--help")
    assert code == 0
    assert all(words in " ".join(out.split()) for words in ("Failed runs", "they are counted", "the exit code is 0"))


# -- what is right is done --------------------------------------------------------------------------------------------
@pytest.mark.compiled
def test_adapt_reads_a_finished_folder_and_evaluate_compares_its_schedules(
    monkeypatch, capsys, tmp_path, tmp_path_factory, places
):
    chain = learned(tmp_path_factory.getbasetemp())
    folder = shutil.copytree(chain.folder, tmp_path / "adapted")
    monkeypatch.setattr(adaptation, "adapt", partial(adaptation.adapt, effort=EFFORT))
    monkeypatch.setattr(adaptation, "improve", lambda *given, **more: pytest.fail("it learned again"))
    code, out, err = run(monkeypatch, capsys, "paper", "adapt", chain.file, "--out", folder, "--json")
    assert code == 0, err
    told = strict(out)
    assert told["schedulers"] == str(folder / "schedulers")
    assert [row["contender"] for row in told["rows"]] == ["nn", "anfis"]

    monkeypatch.setattr("adaptrack.results.style.PNG_DPI", 20)
    monkeypatch.setattr("adaptrack.results.evaluation.SURFACE_NODES", (9, 7))
    page = tmp_path / "page"
    command = ("paper", "evaluate", folder, "--campaign", chain.file, "--operating-points", 4, "--drives", 1, "--tests",
               "--known-as", "noisy", "--scheduler", places["mine"])  # fmt: skip
    code, out, err = run(monkeypatch, capsys, *command, "--out", page, "--json")
    assert code == 0, err
    rows = strict(out)["rows"]
    assert {row["view"] for row in rows} == {"operating points", "drives", "tests"}
    exact = {row["contender"]: row for row in rows if row.get("known_as") == "exact" and row["view"] != "drives"}
    assert set(exact) == {"best constant", "look-up", "nn", "anfis", "mine", "optimum"}
    assert all(row["regret_worst"] >= row["regret_p90"] >= row["regret_p50"] > 0.0 for row in exact.values())
    assert "adaptrack paper evaluate" in (page / "index.html").read_text()
    code, out, err = run(monkeypatch, capsys, *command[:5], "--drives", 1)
    assert code == 0, err
    assert "times the cost of the best constant on 1 drive" in out
    assert "Drives: 1 drive, regret to best constant" in out


def test_certify_passes_a_sound_scheduler(monkeypatch, capsys, places):
    monkeypatch.setattr("adaptrack.base.progress.FIRST_PAUSE", 1e6)  # no progress, however slow the machine
    code, out, err = run(monkeypatch, capsys, "certify", places["mine"], "--json")
    told = strict(out)
    assert code == 0, err
    assert told.keys() >= CERTIFIED
    assert (told["scheduler"], told["profile"], told["passed"], told["unstable"]) == ("mine", "road", True, 0)
    assert told["points"] == 28 * 5
    assert [row["driving"] for row in told["rows"]] == 140 * ["straight"] + 140 * ["turn"]
    assert {row["Np"] for row in told["rows"]} == {38.0}
    assert err == ""


def test_certify_refuses_an_unstable_scheduler_with_exit_code_1_and_the_place(monkeypatch, capsys, places):
    Constant(Tuning(), name="table").save(places["mine"])
    code, out, err = run(monkeypatch, capsys, "certify", places["mine"], "--json")
    told = strict(out)
    assert code == 1
    assert (told["passed"], told["unstable"] > 0) == (False, True)
    assert told["unstable"] == sum(row["unstable"] for row in told["rows"] if row["driving"] == "straight")
    assert told["unstable_in_turn"] == sum(row["unstable"] for row in told["rows"] if row["driving"] == "turn")
    assert f"FAILED {told['verdict']} The worst: " in err
    assert f"unstable at {told['unstable']} of 140 points of the operating domain driving straight" in err
    unstable = [row for row in told["rows"] if row["unstable"] and row["driving"] == "straight"]
    assert any(f"The worst: {row['speed']:g} m/s on friction {row['friction']:g}" in err for row in unstable)
    assert float(err.partition("spectral radius ")[2].split(".\n")[0]) >= 1.0
    assert "Np = 35, Nc = 8, Q = 10, R = 0.01" in err


def test_certify_writes_the_page_and_prints_the_points_nearest_to_instability(monkeypatch, capsys, places):
    monkeypatch.setattr("adaptrack.results.style.PNG_DPI", 20)
    monkeypatch.setattr("adaptrack.analysis.certify.certify", partial(certify, levels=(4, 2)))
    code, out, err = run(monkeypatch, capsys, "certify", places["mine"], "--out", places["out"])
    assert code == 0, err
    assert "Passed: the closed loop is stable at all 8 points of the operating domain driving straight" in out
    assert "mine, driving straight (the verdict): the points nearest to instability" in out
    assert "Passed" in (places["out"] / "index.html").read_text()
    assert list(places["out"].glob("*.png"))


def test_certify_says_the_same_on_the_console_in_the_json_and_on_the_page(monkeypatch, capsys, places):
    monkeypatch.setattr("adaptrack.results.style.PNG_DPI", 20)
    monkeypatch.setattr("adaptrack.analysis.certify.certify", partial(certify, levels=(4, 2)))
    Constant(Tuning(30, 10, 1.0, 600.0), name="mine").save(places["mine"])
    told = strict(run(monkeypatch, capsys, "certify", places["mine"], "--json")[1])
    code, out, err = run(monkeypatch, capsys, "certify", places["mine"], "--out", places["out"])
    assert told["unstable_in_turn"] > told["unstable"]  # else there was nothing to confuse
    assert code == (0 if told["passed"] else 1)
    assert told["verdict"] in out + err
    assert f"unstable at {told['unstable_in_turn']} of them in a hard turn, which does not decide" in told["verdict"]
    assert told["verdict"] in unescape((places["out"] / "index.html").read_text())
    rows = [line.split() for line in out.splitlines() if line.startswith(("straight", "turn"))]
    assert [row[0] for row in rows] == 5 * ["straight"] + 5 * ["turn"]


def test_certify_without_a_scheduler_is_about_the_constant_of_the_controller_that_knows_its_car(monkeypatch, capsys):
    monkeypatch.setattr("adaptrack.analysis.certify.certify", partial(certify, levels=(3, 2)))
    code, out, err = run(monkeypatch, capsys, "certify", "--mismatch", "--json")
    told = strict(out)
    assert code == 0, err
    assert (told["model"], told["estimator"], told["passed"], told["points"]) == ("path", "kalman", True, 6)
    assert {row["R"] for row in told["rows"]} == {informed_tuning("road").R}
    assert len(told["mismatched"]) == 8
    code, out, err = run(monkeypatch, capsys, "certify", "--mismatch", "--speed", 20, 20)
    assert code == 0, err
    assert told["mismatched"][0]["mismatch"] in out
    assert "stable at all 2 points" in " ".join(out.split())


def test_certify_names_what_no_tuning_can_hold_with_exit_code_1(monkeypatch, capsys):
    few = partial(feasibility, nodes=((20.0, 60.0), (1.0, 4.0), (4.0, 5.0)), margin=0.3)
    monkeypatch.setattr("adaptrack.analysis.feasibility.feasibility", few)
    asked = ("certify", "--feasible", "--controller", "standard", "--vehicle", "midsize-sedan", "--speed", 10, 30)
    code, out, err = run(monkeypatch, capsys, *asked, "--json")
    told = strict(out)
    assert (code, told["passed"]) == (1, False)
    assert f"FAILED {told['verdict']}" in err
    assert "Infeasible: no tuning holds the loop" in told["verdict"]
    code, out, err = run(monkeypatch, capsys, *asked[:-2], 9, 10)
    assert code == 0, err
    assert "Feasible: at every point of 9 to 10 m/s on friction 0.3 to 1" in " ".join(out.split())
    assert "The best tuning at each speed and friction" in out


def test_every_error_of_the_package_becomes_one_message(monkeypatch, capsys):
    def fail(*given, **more):
        raise AdaptrackError("no way")

    monkeypatch.setattr("adaptrack.paper.campaign_config.load_campaign", fail)
    code, out, err = run(monkeypatch, capsys, "paper", "evaluate")
    assert (code, out, err) == (2, "", "adaptrack: no way\n")

"""The commands around schedulers: paper adapt, paper evaluate, certify, paper train."""

from __future__ import annotations

import json
import re
import shutil
from functools import partial
from html import unescape

import pytest

from adaptrack.analysis.certify import certify
from adaptrack.analysis.feasibility import feasibility
from adaptrack.control.controllers import Tuning
from adaptrack.control.controllers.informed import informed_tuning
from adaptrack.control.scheduling import Constant
from adaptrack.paper import adaptation
from small_chain import EFFORT, learned

CERTIFIED = {"scheduler", "plant", "tyre", "profile", "passed", "points", "unstable", "unstable_without_guard",
             "unstable_in_turn", "verdict", "straight", "turn", "rows"}  # fmt: skip


def strict(text):
    """JSON without NaN and infinity, which are none."""
    return json.loads(text, parse_constant=lambda name: pytest.fail(f"{name} is no JSON"))


@pytest.fixture
def mine(tmp_path):
    """The file of a sound schedule."""
    Constant(Tuning(38, 4, 1.0, 8000.0), name="mine").save(tmp_path / "mine.json")
    return tmp_path / "mine.json"


@pytest.mark.compiled
def test_adapt_reads_a_finished_folder_and_evaluate_compares_its_schedules(
    output_of, monkeypatch, tmp_path, tmp_path_factory, mine
):
    chain = learned(tmp_path_factory.getbasetemp())
    folder = shutil.copytree(chain.folder, tmp_path / "adapted")
    monkeypatch.setattr(adaptation, "adapt", partial(adaptation.adapt, effort=EFFORT))
    monkeypatch.setattr(adaptation, "improve", lambda *arguments, **settings: pytest.fail("it learned again"))
    result = strict(output_of("paper", "adapt", chain.file, "--out", folder, "--json"))
    assert result["schedulers"] == str(folder / "schedulers")
    assert [row["contender"] for row in result["rows"]] == ["nn", "anfis"]

    monkeypatch.setattr("adaptrack.results.evaluation.SURFACE_NODES", (9, 7))
    page = tmp_path / "page"
    command = ("paper", "evaluate", folder, "--campaign", chain.file, "--operating-points", 4, "--drives", 1, "--tests",
               "--perception", "noisy", "--scheduler", mine)  # fmt: skip
    rows = strict(output_of(*command, "--out", page, "--json"))["rows"]
    assert {row["view"] for row in rows} == {"operating points", "drives", "tests"}
    exact = {row["contender"]: row for row in rows if row.get("perception") == "exact" and row["view"] != "drives"}
    assert set(exact) == {"best constant", "look-up", "nn", "anfis", "mine", "optimum"}
    assert all(row["regret_worst"] >= row["regret_p90"] >= row["regret_p50"] > 0.0 for row in exact.values())
    assert "adaptrack paper evaluate" in (page / "index.html").read_text()
    out = output_of(*command[:5], "--drives", 1)
    assert "times the cost of the best constant on 1 drive" in out
    assert "Drives: 1 drive, regret to best constant" in out


@pytest.fixture
def few_points(monkeypatch):
    """Certificates of eight points."""
    monkeypatch.setattr("adaptrack.analysis.certify.certify", partial(certify, levels=(4, 2)))


def test_certify_passes_a_sound_scheduler_and_prints_the_points_nearest_to_instability(
    output_of, few_points, tmp_path, mine
):
    result = strict(output_of("certify", mine, "--json"))
    assert result.keys() >= CERTIFIED
    assert (result["scheduler"], result["profile"], result["passed"], result["unstable"]) == ("mine", "road", True, 0)
    assert [row["driving"] for row in result["rows"]] == 8 * ["straight"] + 8 * ["turn"]
    assert {row["Np"] for row in result["rows"]} == {38.0}
    out = output_of("certify", mine, "--out", tmp_path / "page")
    assert "Passed: the closed loop is stable at all 8 points of the operating domain driving straight" in out
    assert "mine: points with the smallest modulus margin" in out
    assert "Passed" in (tmp_path / "page" / "index.html").read_text()
    assert list((tmp_path / "page").glob("*.png"))


def test_certify_refuses_an_unstable_scheduler_with_exit_code_1_and_the_place(run_command, few_points, mine):
    Constant(Tuning(), name="table").save(mine)
    code, out, err = run_command("certify", mine, "--json")
    result = strict(out)
    assert (code, result["passed"]) == (1, False)
    assert f"FAILED {result['verdict']} Worst: " in err
    assert f"unstable at {result['unstable']} of 8 points of the operating domain driving straight" in err
    unstable = [row for row in result["rows"] if row["unstable"] and row["driving"] == "straight"]
    assert result["unstable"] == len(unstable) > 0
    assert any(f"Worst: {row['speed']:g} m/s on friction {row['friction']:g}" in err for row in unstable)
    assert float(err.partition("spectral radius ")[2].split(".\n")[0]) >= 1.0
    assert "Np = 35, Nc = 8, Q = 10, R = 0.01" in err


def test_certify_says_the_same_on_the_console_in_the_json_and_on_the_page(run_command, few_points, tmp_path, mine):
    Constant(Tuning(30, 10, 1.0, 600.0), name="mine").save(mine)
    result = strict(run_command("certify", mine, "--json")[1])
    code, out, err = run_command("certify", mine, "--out", tmp_path / "page")
    assert result["unstable_in_turn"] > result["unstable"]  # else there was nothing to confuse
    assert code == (0 if result["passed"] else 1)
    assert result["verdict"] in out + err
    assert (
        f"unstable at {result['unstable_in_turn']} of them in a hard turn, which does not change the verdict"
        in result["verdict"]
    )
    assert result["verdict"] in unescape((tmp_path / "page" / "index.html").read_text())
    _, *parts = re.split(r"Without a guard, (driving straight|in a hard turn)\n", out)
    assert parts[::2] == ["driving straight", "in a hard turn"]
    assert [len(re.findall(r"^ *[\d.]+ +[\d.]+ +30 +10 ", part, re.MULTILINE)) for part in parts[1::2]] == [8, 8]


def test_certify_without_a_scheduler_is_about_the_constant_of_the_controller_that_knows_its_car(output_of, monkeypatch):
    monkeypatch.setattr("adaptrack.analysis.certify.certify", partial(certify, levels=(3, 2)))
    result = strict(output_of("certify", "--mismatch", "--json"))
    assert (result["model"], result["estimator"], result["passed"], result["points"]) == ("path", "kalman", True, 6)
    assert {row["R"] for row in result["rows"]} == {informed_tuning("road").R}
    assert len(result["mismatched"]) == 8
    out = output_of("certify", "--mismatch", "--speed", 20, 20)
    assert result["mismatched"][0]["mismatch"] in out
    assert "stable at all 2 points" in " ".join(out.split())


def test_certify_names_what_no_tuning_can_hold_with_exit_code_1(run_command, output_of, monkeypatch):
    few = partial(feasibility, nodes=((20.0, 60.0), (1.0, 4.0), (4.0, 5.0)), margin=0.3)
    monkeypatch.setattr("adaptrack.analysis.feasibility.feasibility", few)
    command = ("certify", "--feasible", "--controller", "standard", "--vehicle", "midsize-sedan", "--speed", 10, 30)
    code, out, err = run_command(*command, "--json")
    result = strict(out)
    assert (code, result["passed"]) == (1, False)
    assert f"FAILED {result['verdict']}" in err
    assert "Infeasible: no tuning holds the loop" in result["verdict"]
    out = output_of(*command[:-2], 9, 10)
    assert "Feasible: at every point of 9 to 10 m/s on friction 0.3 to 1" in " ".join(out.split())
    assert "Tuning with the largest modulus margin at each speed and friction" in out

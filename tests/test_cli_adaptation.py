"""The commands around schedulers: adapt, evaluate, certify, schedulers, train."""

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
from adaptrack.base.errors import AdaptrackError, InvalidInput
from adaptrack.cli import comparison as shown
from adaptrack.comparison import evaluate
from adaptrack.control.controllers import Tuning, published_mpc, registry
from adaptrack.control.controllers.informed import informed_tuning
from adaptrack.control.scheduling import Constant
from adaptrack.learning.adaptation import config as configuration
from adaptrack.learning.adaptation import recipes, splits
from adaptrack.studies.adapt import shipped
from small_chain import learned, write

EVALUATED = {"view", "known_as", "reference", "contender", "controller", "runs", "cost_geomean", "regret_geomean",
             "regret_low", "regret_high", "regret_p50", "regret_p90", "regret_p99", "regret_worst", "failures",
            }  # fmt: skip
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
    """Files that commands are given: an adaptation, a scheduler, a damaged one, a file where a folder should be."""
    tiny = write(tmp_path)
    grid = write(tmp_path / "grid", campaign="paper-grid")
    Constant(Tuning(38, 4, 1.0, 8000.0), name="mine").save(tmp_path / "mine.json")
    (tmp_path / "damaged.json").write_text((tmp_path / "mine.json").read_text().replace("8000", "80"))
    (tmp_path / "file").write_text("")
    replace(Constant(Tuning()), made_for={"car": "van"}).save(tmp_path / "vans.json")
    return {
        "tiny": tiny, "grid": grid, "mine": tmp_path / "mine.json", "damaged": tmp_path / "damaged.json",
        "file": tmp_path / "file", "out": tmp_path / "out", "vans": tmp_path / "vans.json",
    }  # fmt: skip


# -- what is wrong is said --------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("command", "words"),
    [
        ("tune van", ["--out"]),
        ("adaptation raod --out {out}", ["no adaptation is named 'raod'", "Did you mean 'road'"]),
        ("adaptation nowhere.toml --out {out}", ["nowhere.toml", "cannot be read"]),
        ("adaptation {grid} --out {out}", ["paper-grid", "Sobol"]),
        ("adaptation {tiny} --out {file}/out", ["cannot be written"]),
        ("adaptation {tiny} --out {out} --workers 0", ["workers = 0"]),
        ("evaluate-schedules --config raod", ["Did you mean 'road'"]),
        ("evaluate-schedules --schedulers road-n", ["no scheduler is named 'road-n'", "Did you mean"]),
        ("evaluate-schedules --schedulers nowhere.json", ["nowhere.json", "cannot be read"]),
        ("evaluate-schedules --schedulers {damaged}", ["damaged.json", "checksum"]),
        ("evaluate-schedules --conditions sobol", ["'sobol'", "write sobol:N"]),
        ("evaluate-schedules --conditions grid:8", ["'grid:8'", "write sobol:N"]),
        ("evaluate-schedules --conditions sobol:0", ["'sobol:0'", "write sobol:N"]),
        ("evaluate-schedules --conditions sobol:-4", ["'sobol:-4'", "write sobol:N"]),
        ("evaluate-schedules --conditions sobol:8.5", ["'sobol:8.5'", "write sobol:N"]),
        ("evaluate-schedules --conditions sobol:99999999999", ["99999999999"]),
        ("evaluate-schedules --drives 0", ["--drives"]),
        ("evaluate-schedules --drives many", ["--drives", "integer"]),
        ("evaluate-schedules --seed -1", ["--seed"]),
        (
            "evaluate-schedules --config road --schedulers {vans}",
            ["'vans'", "car 'van', not 'paper'", "adaptrack adaptation"],
        ),
        ("evaluate-schedules --out {file}/out", ["cannot be written"]),
        ("evaluate-schedules --contender standrd", ["no contender is named 'standrd'", "Did you mean 'standard'"]),
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
        ("train --model nn --out {out}/nn.json", ["--data"]),
        ("train --data nowhere.parquet --model nn --out {out}/nn.json", ["nowhere.parquet"]),
        ("train --data paper-grid --model nn --targets both --out {out}/nn.json", ["both"]),
        ("list --jason", ["--jason"]),
    ],
)
def test_a_wrong_argument_gives_one_clear_message_and_exit_code_2(monkeypatch, capsys, places, command, words):
    for module in (splits, evaluate):
        monkeypatch.setattr(module, "operating_point_runs", lambda *given, **more: pytest.fail("it went to work"))
    before = places["file"].stat().st_size
    code, out, err = run(monkeypatch, capsys, *(part.format(**places) for part in command.split()))
    assert code == 2
    assert out == ""
    assert "Traceback" not in err
    assert all(word in err for word in words), err
    assert places["file"].stat().st_size == before


@pytest.mark.parametrize("what", [("--conditions", "sobol:8"), ("--drives", "1"), ("--tests",)])
def test_an_unknown_way_of_knowing_is_told_before_anything_is_driven(monkeypatch, capsys, places, what):
    for name in ("optimum", "compare", "per_run_best"):
        monkeypatch.setattr(evaluate, name, lambda *given, **more: pytest.fail("it went to work"))
    config = write(places["out"], name="road")
    code, out, err = run(monkeypatch, capsys, "evaluate-schedules", "--config", config, *what, "--told", "nosy")
    assert code == 2
    assert out == ""
    assert all(word in err for word in ("'nosy'", "noisy", "withheld"))


def test_a_number_must_be_written_in_digits(monkeypatch, capsys):
    code, _, err = run(monkeypatch, capsys, "evaluate-schedules", "--conditions", "sobol:²")
    assert code == 2
    assert "write sobol:N" in err


def test_a_folder_stands_for_the_schedulers_in_it(tmp_path):
    (tmp_path / "empty").mkdir()
    with pytest.raises(InvalidInput, match=r"no scheduler.*in this folder"):
        shown.scheduler_files([str(tmp_path / "empty")])
    for name in ("b", "a"):
        Constant(Tuning()).save(tmp_path / f"{name}.json")
    assert shown.scheduler_files([str(tmp_path)]) == [str(tmp_path / "a.json"), str(tmp_path / "b.json")]
    assert shown.scheduler_files(["road-nn"]) == ["road-nn"]


def test_the_drives_of_ones_own_configuration_ask_for_its_best_constant(monkeypatch, capsys, places):
    monkeypatch.setattr(evaluate, "random_drive_runs", lambda *given, **more: None)
    code, _, err = run(monkeypatch, capsys, "evaluate-schedules", "--config", places["tiny"], "--drives", "1")
    assert code == 2
    assert "best constant" in err


@pytest.mark.parametrize("command", ["adaptation", "evaluate-schedules", "certify", "train"])
def test_help_names_the_options_and_loads_no_numerics(run_python, command):
    options = {
        "adaptation": ["--out", "ADAPTATION", "--workers"],
        "evaluate-schedules": ["--schedulers", "--conditions", "--told", "sobol:N"],
        "certify": ["--profile", "--vehicle", "--feasible", "--mismatch", "--out"],
        "train": ["--data", "--model", "--targets"],
    }[command]  # fmt: skip
    shown = "--help-all" if command in ("adaptation", "evaluate-schedules", "certify") else "--help"
    code = (
        "import sys; from adaptrack import cli; "
        f"sys.argv = ['adaptrack', '{command}', '{shown}']; assert cli.main() == 0; assert 'numpy' not in sys.modules"
    )
    text = run_python(code=code)
    assert all(option in text for option in ["Usage: adaptrack", "--json", *options])


@pytest.mark.parametrize("command", ["adaptation", "evaluate-schedules", "reproduce"])
def test_help_says_that_failed_runs_are_counted_and_the_exit_code_is_0(monkeypatch, capsys, command):
    code, out, _ = run(monkeypatch, capsys, command, "--help")
    assert code == 0
    assert all(words in " ".join(out.split()) for words in ("Failed runs", "they are counted", "the exit code is 0"))


# -- what is right is done --------------------------------------------------------------------------------------------
@pytest.mark.compiled
def test_evaluate_compares_what_ships_and_what_is_given_with_the_optimum(monkeypatch, capsys, places):
    config = write(places["out"], name="road")
    arguments = [
        "evaluate-schedules",
        "--config",
        config,
        "--schedulers",
        places["mine"],
        "--conditions",
        "sobol:8",
        "--json",
    ]
    code, out, err = run(monkeypatch, capsys, *arguments, "--told", "noisy", "--profile", "road")
    assert code == 0, err
    rows = strict(out)["rows"]
    assert all(row.keys() >= EVALUATED for row in rows)
    assert {(row["view"], row["reference"], row["runs"]) for row in rows} == {("operating points", "optimum", 8)}
    exact = {row["contender"]: row for row in rows if row["known_as"] == "exact"}
    hidden = {"fallback", "best constant on drives"}
    files = {f"road-{kind.replace(' ', '-')}": kind for kind in shipped("road")}
    named = {kind if kind == "best constant" else name: kind for name, kind in files.items()}
    kinds = set(shipped("road")) - hidden
    assert {row["kind"] for row in exact.values()} == {"standard", "optimum", "", *kinds}
    assert set(exact) == {"standard", "optimum", "mine", *(name for name, kind in named.items() if kind in kinds)}
    assert exact["optimum"]["regret_worst"] == 1.0
    assert all(row["regret_worst"] >= row["regret_p90"] >= row["regret_p50"] > 0.0 for row in exact.values())
    assert {row["kind"] for row in rows if row["known_as"] == "noisy"} == {*evaluate.PERCEIVING, "optimum"}
    again = strict(run(monkeypatch, capsys, *arguments)[1])["rows"]
    assert again == list(exact.values())
    others = strict(run(monkeypatch, capsys, *arguments, "--seed", "8")[1])["rows"]
    assert others[0]["contender"] == again[0]["contender"]
    assert others[-1]["cost_geomean"] != again[-1]["cost_geomean"]


@pytest.mark.compiled
def test_evaluate_judges_drives_by_the_best_constant_and_prints_a_table(monkeypatch, capsys, places):
    config = write(places["out"], name="road")
    code, out, err = run(
        monkeypatch, capsys, "evaluate-schedules", "--config", config, "--schedulers", places["mine"], "--drives", "1"
    )
    assert code == 0, err
    first = {line.split("  ")[0] for line in out.splitlines()}
    assert {"standard", "best constant", "road-nn", "road-anfis", "mine"} <= first
    assert "drives, exact: 1 runs, regret to best constant" in out
    assert "operating points, exact" not in out


@pytest.mark.compiled
def test_adapt_goes_on_with_a_folder_and_tells_schedulers_report_and_rows(
    monkeypatch, capsys, tmp_path, tmp_path_factory
):
    chain = learned(tmp_path_factory.getbasetemp())
    out = shutil.copytree(chain.folder, tmp_path / "out")
    monkeypatch.setattr("adaptrack.results.style.PNG_DPI", 20)
    monkeypatch.setattr("adaptrack.results.comparison_pictures.NODES", (9, 7))
    monkeypatch.setattr(evaluate, "per_run_best", lambda runs, rows, seeds: rows[:1].repeat(len(runs), axis=0))
    monkeypatch.setattr(recipes, "improve", lambda *given, **more: pytest.fail("it learned again"))
    config = chain.folder.parent / "tiny.toml"
    code, printed, err = run(monkeypatch, capsys, "adaptation", config, "--out", out, "--json")
    assert code == 0, err
    rows = strict(printed)["rows"]
    assert {row["view"] for row in rows} == {"operating points", "drives", "tests"}
    assert all(row.keys() >= EVALUATED - {"known_as"} for row in rows)
    assert all(("known_as" in row) == (row["view"] != "tests") for row in rows)
    assert {row["runs"] for row in rows if row["view"] != "tests"} == {8}
    assert str(out / "schedulers") in err
    assert (out / "index.html").exists()
    assert "adaptrack adaptation" in (out / "index.html").read_text()


def test_certify_passes_a_sound_scheduler(monkeypatch, capsys, places):
    monkeypatch.setattr("adaptrack.base.progress.FIRST", 1e6)  # no progress, however slow the machine
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

    monkeypatch.setattr(configuration, "load_adaptation", fail)
    code, out, err = run(monkeypatch, capsys, "evaluate-schedules")
    assert (code, out, err) == (2, "", "adaptrack: no way\n")


@pytest.mark.compiled
def test_evaluate_drives_a_registered_contender_by_name(monkeypatch, capsys, places):
    monkeypatch.setattr(registry._registry, "factories", dict(registry._registry.factories))
    cautious = Tuning(40, 4, 1.0, 1e5)
    registry.register_controller("cautious", lambda vehicle, period: published_mpc(vehicle, cautious, period=period))
    config = write(places["out"], name="road")
    arguments = (
        "evaluate-schedules",
        "--config",
        config,
        "--conditions",
        "sobol:8",
        "--contender",
        "cautious",
        "--json",
    )
    code, out, err = run(monkeypatch, capsys, *arguments)
    assert code == 0, err
    rows = {row["contender"]: row for row in strict(out)["rows"]}
    assert rows["cautious"]["controller"] == "standard MPC (pulse)"
    assert rows["cautious"]["regret_geomean"] > 0.0

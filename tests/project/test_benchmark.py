"""Benchmarks run and print their figures; the programs that compare two states find what differs."""

import json
import math
import shlex
import subprocess
import sys

import numpy as np
import pytest
from benchmarks import against_release
from benchmarks.planted_faults import read_faults
from tools import bench

import adaptrack as at


@pytest.mark.compiled
@pytest.mark.parametrize(
    ("name", "figure"),
    [("step", "ratio_to_python_daqp"), ("rollout", "ratio_to_python_daqp"), ("tracker", "informed, python_p50_us"),
     ("controllers", "published, paper, compiled_p50_us")],
)  # fmt: skip
def test_a_benchmark_prints_its_figures(name, figure, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["bench", name, "--count", "1", "--json"])
    bench.main()
    assert 0.0 < json.loads(capsys.readouterr().out)[figure] < math.inf


def test_the_numpy_baseline_finds_the_moves_of_the_compiled_controller():
    car = at.load_vehicle("paper")
    plain, mpc = bench.PlainController(car, at.Tuning()), at.published_mpc(car)
    for state in ([0.0, 0.0, 0.0, 0.0], [0.05, 0.01, 0.02, 0.3], [0.02, 0.03, -0.01, 0.9]):
        commands = [controller.step(np.array(state), 20.0, np.array([3.0])) for controller in (plain, mpc)]
        assert commands[0].angle == pytest.approx(commands[1].angle, abs=1e-7)


QUICK = (
    "against_release.py . --only arrays/road-geometry --folder {folder}",
    "circuits.py --made 1 --no-holds --car midsize-sedan --profile road --lateral 4 --seed 5",
    "code_figures.py --table", "estimating.py --runs 1", "foreign_loop.py --seeds 1", "holding.py --drives 3",
    "late_samples.py late --drives 1", "learned_belief.py --train 28 --test 4",
    "planner.py --cases swerve --drives 1 --cars sedan", "population.py --cars 10",
    "roads_driven.py gate --length 300 --car paper", "tuned_cars.py --vehicle van --profile road",
    "unknown_cars.py --cars 2 --profile road", "wrong_inputs.py honest --drives 1",
)  # fmt: skip
"""Benchmarks with the arguments of their quick form."""


def run_benchmark(command, project):
    script, *arguments = shlex.split(command)
    command = [sys.executable, f"benchmarks/{script}", *arguments]
    return subprocess.run(command, cwd=project, capture_output=True, text=True, check=False)


@pytest.mark.compiled
@pytest.mark.slow
@pytest.mark.parametrize("command", QUICK, ids=lambda command: command.split(".py")[0])
def test_the_quick_form_of_a_benchmark_prints_its_table(command, project, tmp_path):
    process = run_benchmark(command.format(folder=tmp_path), project)
    assert process.returncode == 0, process.stderr
    assert process.stdout.strip()


@pytest.mark.compiled
@pytest.mark.slow
@pytest.mark.parametrize("option", ["", "--speed-control --seeds 1", "--worlds 1"])
def test_a_car_in_an_engine_that_is_not_ours_is_driven(option, project):
    pytest.importorskip("mujoco", reason="needs mujoco: see benchmarks/foreign_engines.py")
    process = run_benchmark(f"foreign_engines.py --engine mujoco --only learning --seconds 3 {option}", project)
    assert process.returncode == 0, process.stderr


@pytest.mark.compiled
@pytest.mark.slow
def test_the_log_of_a_car_is_identified_from_its_description(project, tmp_path):
    run = at.rollout(at.DualTrack(at.load_vehicle("paper")), at.MPC(at.load_vehicle("paper"), profile="road"),
                     at.random_drive(3, 60.0), profile="road")  # fmt: skip
    columns = {"time": run.t, "command": run.command, "speed": run.vx, "yaw_rate": run.yaw_rate}
    rows = np.column_stack(list(columns.values()))
    np.savetxt(tmp_path / "log.csv", rows, delimiter=",", header=",".join(columns), comments="")
    (tmp_path / "log.toml").write_text(
        'name = "a car"\nsource = "simulated"\nlicence = "MIT"\nlogs = ["log.csv"]\nmass = 1575\nwheelbase = 2.8\n'
    )
    process = run_benchmark(f"real_logs.py {tmp_path / 'log.toml'} --json", project)
    (row,) = json.loads(process.stdout)
    assert "estimates" in row["identify"]


# -- two states of the repository -------------------------------------------------------------------------------------
@pytest.mark.parametrize("fault", read_faults(), ids=lambda fault: f"{fault.number} {fault.file}")
def test_the_line_of_a_planted_fault_stands_in_its_file_once(fault, project):
    assert fault.line(project) is not None


ANSWER = {"exit code": 0, "answer": {"rows": [{"cost": 0.25, "name": "a"}, {"cost": None, "name": "b"}], "seconds": 3}}


def lines(other, answer):
    return list(against_release.compare(json.loads(json.dumps(other)), json.loads(json.dumps(answer))))


def test_equal_answers_are_one_line_and_times_do_not_count():
    assert lines(ANSWER, {**ANSWER, "answer": {**ANSWER["answer"], "seconds": 4}}) == [
        "5 of 5 values are identical to the bit"
    ]


def test_a_last_digit_is_found_with_its_size():
    (summary, difference) = lines({"rows": [1.0, 2.0]}, {"rows": [1.0, 2.0 + 2**-51]})
    assert summary.startswith("1 of 2")
    assert difference == "  /rows/*: 1 differ, by at most 4.4e-16, relative 2.2e-16"


@pytest.mark.parametrize(("old", "new"), [(1, True), (0.0, None), ("a", "b"), (0, 0.0)])
def test_values_of_another_kind_differ(old, new):
    assert len(lines({"x": old}, {"x": new})) == 2


def test_what_one_side_lacks_is_named_with_its_side():
    (_, *difference) = lines({"a": 1, "b": 2}, {"a": 1, "c": 2})
    assert difference == ["  /b: only in the other", "  /c: only in this tree"]


def test_an_answer_that_is_missing_counts_as_a_difference(tmp_path, capsys):
    (tmp_path / "lists-names.json").write_text("{}")
    assert against_release.report(tmp_path, tmp_path / "none", [("lists", "names")]) == 1
    assert "no " in capsys.readouterr().out


def test_every_question_has_a_name_of_its_own_as_a_file():
    files = [f"{group}-{name}" for group, name in against_release.questions(())]
    assert len(files) == len(set(files))
    assert list(against_release.questions(["drive/lap"])) == [("drive", "lap")]
